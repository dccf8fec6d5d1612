"""The configuration read again while swingd runs: what of it holds at once, and what only a restart takes over."""

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from swingd.config.plain import restore
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import CONTENT_OF, Endpoint, Parameters

READ_TIMEOUT_S = 15.0

_AT_START = ("autopilot", "system_id", "component_id", "key_file", "rc_channel")
"""Keys of ``link`` that links and servers are made of."""
_READER = """\
import contextlib, json, os, sys
with contextlib.suppress(OSError):  # a sandbox may deny it
    os.nice(10)
from swingd.config.loader import load_parameters
from swingd.config.plain import parameters_to_json
from swingd.model.errors import ConfigurationError
path, overrides = json.loads(sys.argv[1])
try:
    print(parameters_to_json(load_parameters(path, overrides)))
except ConfigurationError as error:
    sys.exit(str(error))
"""


def read_configuration(path: Path | None, overrides: Sequence[str]) -> Parameters:
    """Load a configuration in a process of its own: judging one takes longer than a forwarding process may wait.

    Raises
    ------
    ConfigurationError
        As the loader does, or if that process does not answer.
    """
    given = json.dumps([None if path is None else str(path.absolute()), list(overrides)])
    try:
        done = subprocess.run(
            [sys.executable, "-c", _READER, given],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=READ_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ConfigurationError(f"the configuration cannot be read: {error}") from None
    if done.returncode:
        raise ConfigurationError(done.stderr.strip() or f"reading the configuration ended with {done.returncode}")
    parameters: Parameters = restore(Parameters, json.loads(done.stdout))
    return parameters


@dataclass(frozen=True, slots=True)
class Change:
    """From the parameters that hold to those of a configuration that was read again."""

    parameters: Parameters
    """What can hold at once: the new parameters, with the old ones where a restart is needed."""
    taken: tuple[str, ...]
    """Dotted keys that change at once."""
    waiting: tuple[str, ...]
    """Dotted keys that change with a restart."""

    @classmethod
    def between(cls, now: Parameters, new: Parameters) -> "Change":
        """Compare; links and endpoints stay as they were opened."""
        link = replace(new.link, **{name: getattr(now.link, name) for name in _AT_START})
        parameters = replace(
            new, link=link, endpoints=_endpoints(now.endpoints, new.endpoints), simulation=now.simulation
        )
        # What is simulated is nothing to the daemon.
        waiting = (key for key in _differing(parameters, new) if not key.startswith("simulation."))
        return cls(parameters, tuple(dict.fromkeys(_differing(now, parameters))), tuple(waiting))


def _endpoints(now: tuple[Endpoint, ...], new: tuple[Endpoint, ...]) -> tuple[Endpoint, ...]:
    """Keep the links of endpoints; how their setpoints are shaped can change, where each is the same as before."""
    if [endpoint.url for endpoint in now] != [endpoint.url for endpoint in new]:
        return now
    return tuple(replace(old, shaper=other.shaper) for old, other in zip(now, new, strict=True))


def _differing(one: Any, other: Any, path: str = "") -> Iterator[str]:
    """Give the dotted keys of what differs; a list that has another length is one key."""
    if is_dataclass(one):
        for field in fields(one):
            name = field.metadata.get(CONTENT_OF, field.name)
            key = f"{path}.{name}" if path else name
            yield from _differing(getattr(one, field.name), getattr(other, field.name), key)
    elif isinstance(one, tuple) and len(one) == len(other) and any(map(is_dataclass, one)):
        for place, (mine, theirs) in enumerate(zip(one, other, strict=True), 1):
            yield from _differing(mine, theirs, f"{path}.{place}")
    elif one != other:
        yield path
