"""Configurations that were found valid before, in a form that loads without pydantic and YAML.

An entry belongs to the bytes of the file, the overrides, the version and the code that judges them, so that it needs no
rule for when it is out of date: whatever changes, there is no entry yet. What a file said that a key names is compared.
"""

import contextlib
import hashlib
import json
import os
import stat
from collections.abc import Sequence
from pathlib import Path

import swingd
from swingd.config.gp_model import is_current
from swingd.config.plain import parameters_to_json, restore
from swingd.config.source import Source, read_source
from swingd.model.parameters import Parameters

ENTRIES_MAX = 32
"""Entries that are kept; the ones longest unused go."""

_ENTRY_BYTES_MAX = 8 * 1024 * 1024
_PREFIX = "configuration-"
_JUDGES = (
    "config/*.py",
    "control/*.py",
    "core/constants.py",
    "estimation/acceleration_model.py",
    "link/url.py",
    "model/*.py",
)
"""What decides whether a configuration is valid and what it means, below the package."""


def load_cached(path: Path | str | None = None, overrides: Sequence[str] = ()) -> Parameters:
    """Give what `swingd.config.loader.load_parameters` gives, quickly if it was given before.

    Entries lie in ``$XDG_CACHE_HOME/swingd``, by default ``~/.cache/swingd``. One that is damaged, or that somebody
    else could have written, is not used; where none can be written, nothing is kept.

    Parameters
    ----------
    path : Path or str, optional
        Configuration file; None reads no file.
    overrides : sequence of str
        ``KEY=VALUE`` each.

    Returns
    -------
    swingd.model.parameters.Parameters
        Complete, within all bounds, and consistent.

    Raises
    ------
    ConfigurationError
        As the loader does.
    """
    source = read_source(path, overrides)
    entry = _entry(source)
    parameters = None if entry is None else _read(entry)
    if parameters is None or not is_current(parameters, source.folder_of("gp_ekf.model")):
        # Imported here, because it brings pydantic, YAML and numpy.
        from swingd.config.loader import load_source

        parameters = load_source(source)
        if entry is not None:
            # The next start is slower, no more.
            with contextlib.suppress(OSError):
                _write(entry, parameters)
    return parameters


def _entry(source: Source) -> Path | None:
    """Give the file that belongs to ``source``; None where there is no place for one."""
    bases = os.environ.get("XDG_CACHE_HOME", ""), os.path.join(os.path.expanduser("~"), ".cache")
    base = next(filter(os.path.isabs, bases), None)
    if base is None:
        return None
    package = Path(__file__).parent.parent
    identity = hashlib.sha256(repr((swingd.__version__, source.content, source.overrides)).encode())
    try:
        for pattern in _JUDGES:
            for file in sorted(package.glob(pattern)):
                identity.update(file.read_bytes())
    except OSError:
        return None
    return Path(base, "swingd", f"{_PREFIX}{identity.hexdigest()}.json")


def _read(entry: Path) -> Parameters | None:
    """Give what an entry holds; None if there is none, or none to be believed."""
    try:
        with open(entry, "rb", opener=_open_existing) as file:
            status = os.fstat(file.fileno())
            is_own = status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            if not (stat.S_ISREG(status.st_mode) and is_own):
                return None
            content = file.read(_ENTRY_BYTES_MAX)
            with contextlib.suppress(OSError):
                os.utime(file.fileno())
        checksum, _, text = content.partition(b"\n")
        if checksum != _checksum(entry, text):
            return None
        parameters: Parameters = restore(Parameters, json.loads(text))
    except (OSError, ValueError, RecursionError):
        return None
    return parameters


def _open_existing(path: str, flags: int) -> int:
    # A pipe in its place must not stop the start.
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK)


def _write(entry: Path, parameters: Parameters) -> None:
    folder = entry.parent
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    text = parameters_to_json(parameters).encode()
    # Whole or not at all, also when two starts write the same entry or the power fails.
    unfinished = folder / f"{_PREFIX}{os.getpid()}.unfinished"
    unfinished.unlink(missing_ok=True)
    with open(unfinished, "xb", opener=lambda path, flags: os.open(path, flags, 0o600)) as file:
        file.write(_checksum(entry, text) + b"\n" + text)
    unfinished.replace(entry)
    _prune(folder)


def _prune(folder: Path) -> None:
    """Remove the entries longest unused, and what an interrupted start left."""
    ages = []
    for file in folder.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            ages.append((file.stat().st_mtime_ns, file))
    for _, file in sorted(ages)[:-ENTRIES_MAX]:
        file.unlink(missing_ok=True)


def _checksum(entry: Path, text: bytes) -> bytes:
    """Tie a text to the entry it was written for, so that another one under its name is noticed."""
    return hashlib.sha256(entry.name.encode() + b"\n" + text).hexdigest().encode()
