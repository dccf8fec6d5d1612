"""Fixtures of all tests."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

PROJECT = Path(__file__).resolve().parent.parent


# The same examples on every machine, however slow it is; HYPOTHESIS_SEARCH=1 looks for new ones.
settings.register_profile("swingd", deadline=None, derandomize=not os.environ.get("HYPOTHESIS_SEARCH"))
settings.load_profile("swingd")

# A shell's background job ignores Ctrl-C and hands that on; the processes that the tests start must hear it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _own_state(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what daemons store and where they answer out of the user's folders, and those out of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("STATE_DIRECTORY", raising=False)
        patch.delenv("RUNTIME_DIRECTORY", raising=False)
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        yield


@pytest.fixture(scope="session")
def flight_data() -> Callable[[str], Path]:
    """Path of a file in the optional folder of independent flight data; skips the test where it is absent.

    The folder is ``$SWINGD_DATA``, or ``shared/data`` beside the project.
    """
    folder = Path(os.environ.get("SWINGD_DATA") or PROJECT.parent / "shared" / "data")

    def find(name: str) -> Path:
        path = folder / name
        if not path.exists():
            pytest.skip(f"no flight data: {name} is not in $SWINGD_DATA or the folder shared/data beside the project")
        return path

    return find
