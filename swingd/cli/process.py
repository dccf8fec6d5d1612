"""What commands need of their process, without the command line's library: `run` starts before it is loaded."""

import asyncio
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from swingd.model.errors import ConfigurationError, LinkUrlError, SwingdError

EXIT_CONFIG = os.EX_CONFIG
"""What cannot heal by starting again; a supervisor should not try."""
EXIT_FAILURE = 1
EXIT_CODES = "Exit codes: 0 done, 2 wrong usage, 78 wrong configuration, 1 any other failure."


def report(error: SwingdError) -> int:
    """Write an expected error on standard error; return the exit code."""
    print(f"swingd: {error}", file=sys.stderr)
    return exit_code(error)


def exit_code(error: SwingdError) -> int:
    """Exit code that an expected error ends a command with."""
    return EXIT_CONFIG if isinstance(error, ConfigurationError | LinkUrlError) else EXIT_FAILURE


def check_output(path: Path | None, option: str, inputs: tuple[Path | None, ...] = (), keep: bool = False) -> None:
    """Refuse a file that could not be written in the end, before any work is done.

    Parameters
    ----------
    path : Path or None
        The file; None is no file.
    option : str
        How the user gave it.
    inputs : paths
        Files that are read: writing over one of them would destroy it.
    keep : bool
        Refuse to replace an existing file.

    Raises
    ------
    ConfigurationError
        If it cannot be written, or must not be.
    """
    if path is None:
        return
    folder = path.resolve().parent
    if not folder.is_dir():
        raise ConfigurationError(f"{option}: {path}: there is no folder {folder}")
    if path.is_dir():
        raise ConfigurationError(f"{option}: {path} is a folder; expected a file")
    if any(given is not None and given.exists() and path.exists() and path.samefile(given) for given in inputs):
        raise ConfigurationError(f"{option}: {path} is read by this command; expected another file")
    if keep and path.is_file():
        raise ConfigurationError(f"{option}: {path} exists; expected a new file, a flight is not overwritten")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise ConfigurationError(f"{option}: {path} cannot be written: permission denied")


def announce_compilation(module: str = "swing_ekf", what: str = "the filter", seconds: str = "twenty") -> None:
    """Say so on standard error where a module of `swingd.core` will be compiled first."""
    from swingd.core._jit import is_compiled

    if not is_compiled(module):
        print(f"compiling {what}, once for this version: some {seconds} seconds", file=sys.stderr)


def end_on_signals() -> None:
    """Let SIGTERM and SIGHUP unwind like Ctrl-C, so that processes are ended and temporary files removed."""

    def end(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, end)


def event_loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Return uvloop's factory where it is installed, else None for asyncio's own."""
    try:
        import uvloop
    except ImportError:
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory
