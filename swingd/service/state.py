"""What a ground station has set, kept over a restart; the user's configuration file is never touched.

Light: read before the first frame is forwarded.
"""

import contextlib
import hashlib
import json
import math
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swingd.model.actions import Severity, StatusText
from swingd.model.ground_parameters import BY_KEY, GroundParameter
from swingd.model.parameters import Parameters

FORMAT = 1
BYTES_MAX = 1 << 20
"""A longer file is not a state file."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """One value that was set."""

    value: float
    configured: float
    """What the configuration, ``--set`` included, said when it was set."""


class StateFile:
    """The values set over MAVLink for one configuration.

    Parameters
    ----------
    configuration : Path or None
        The configuration file; None where there is none. Each has a state file of its own.
    on_note : callable
        Gets what the writer has to tell, from its thread; a RuntimeError of it is ignored.
    folder : Path, optional
        Where it lies instead of `state_folder`.

    Notes
    -----
    The file is replaced as a whole: after a power cut it holds the old values or the new ones. It is written by a
    thread that lives while there is something to write, so that `store` never waits; of values that come faster than
    the disk takes them the last are written. What could not be written stays in memory, is told, and is tried again
    with the next value and by `close`.
    """

    def __init__(
        self, configuration: Path | None, on_note: Callable[[StatusText], None], folder: Path | None = None
    ) -> None:
        self._configuration = None if configuration is None else configuration.absolute()
        self._on_note = on_note
        self._folder = state_folder() if folder is None else folder
        self._entries: dict[str, _Entry] = {}
        self._configured: Parameters | None = None
        self._lock = threading.Lock()
        self._text: str | None = None
        self._writer: threading.Thread | None = None

    @property
    def path(self) -> Path | None:
        """The state file; None if there is no home for it."""
        if self._folder is None:
            return None
        return self._folder / f"{configuration_name(self._configuration)}.json"

    def apply(self, parameters: Parameters) -> tuple[Parameters, tuple[StatusText, ...]]:
        """Read the file and put its values over those of the configuration; never raises.

        Parameters
        ----------
        parameters : Parameters
            As the configuration and ``--set`` have them. A value counts as long as they say of its key what they said
            when it was set; after that they win, and the value is forgotten.

        Returns
        -------
        parameters : Parameters
            What to fly with.
        notes : tuple of StatusText
            For the log: every value that differs from the configuration, and whatever was wrong.
        """
        notes: list[StatusText] = []
        return self._put_over(parameters, self._read(notes), notes)

    def reconfigure(self, parameters: Parameters) -> tuple[Parameters, tuple[StatusText, ...]]:
        """Put the values over those of a configuration that was read again; as `apply`, without reading the file."""
        return self._put_over(parameters, self._entries, [])

    def _put_over(
        self, parameters: Parameters, entries: dict[str, _Entry], notes: list[StatusText]
    ) -> tuple[Parameters, tuple[StatusText, ...]]:
        self._configured = parameters
        self._entries = {}
        overruled = False
        for key, entry in entries.items():
            parameter = BY_KEY[key]
            configured = parameter.get(parameters)
            if configured != entry.configured:
                overruled = True
                notes.append(
                    StatusText(
                        Severity.NOTICE,
                        f"{parameter.name}: {entry.value:g} was set by a ground station when {key} was "
                        f"{entry.configured:g}; it now is {configured:g} in the configuration, which counts",
                    )
                )
                continue
            try:
                parameters = parameter.put(parameters, entry.value)
            except ValueError as error:
                notes.append(StatusText(Severity.WARNING, f"state file {self.path}: {error}; left out"))
                continue
            self._entries[key] = entry
            notes.append(
                StatusText(
                    Severity.NOTICE,
                    f"{parameter.name}: {entry.value:g} as set by a ground station, not {configured:g} as configured",
                )
            )
        if overruled:
            # A configuration that is changed back later must not bring the value to life again.
            self._begin(self._content())
        return parameters, tuple(notes)

    def store(self, parameters: Parameters, *changed: GroundParameter) -> None:
        """Keep the values that ``changed`` have in ``parameters``; returns at once and never raises.

        A value that is the configuration's again is forgotten, so that the configuration counts from then on.
        """
        if self._configured is None:
            raise RuntimeError("StateFile.store comes after StateFile.apply")
        for parameter in changed:
            value, configured = parameter.get(parameters), parameter.get(self._configured)
            if value == configured:
                self._entries.pop(parameter.key, None)
            else:
                self._entries[parameter.key] = _Entry(value, configured)
        self._begin(self._content())

    def close(self, timeout_s: float = 2.0) -> None:
        """Wait until what was stored is written; once more try what could not be, were it while this waits."""
        for _ in range(2):
            with self._lock:
                text, writer = self._text, self._writer
            if text is not None and writer is None:
                self._begin(text)
            with self._lock:
                writer = self._writer
            if writer is not None:
                writer.join(timeout_s)

    # -------------------------------------------------------------------------------------------------- reading

    def _read(self, notes: list[StatusText]) -> dict[str, _Entry]:
        path = self.path
        if path is None:
            notes.append(StatusText(Severity.WARNING, "no folder for the state file: no home folder is known"))
            return {}
        try:
            with path.open("rb") as file:
                data = file.read(BYTES_MAX + 1)
            if len(data) > BYTES_MAX:
                raise ValueError(f"more than {BYTES_MAX} bytes long")
            content = json.loads(data)
            if not isinstance(content, dict) or content.get("format") != FORMAT:
                raise ValueError(f"not of format {FORMAT}")
            entries = content["set_by_ground_station"]
            if not isinstance(entries, dict):
                raise TypeError("no values in it")
        except FileNotFoundError:
            return {}
        except OSError as error:
            notes.append(StatusText(Severity.WARNING, f"state file {path} cannot be read: {error.strerror or error}"))
            return {}
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            notes.append(StatusText(Severity.WARNING, f"state file {path} is damaged and is not used: {error}"))
            return {}
        found: dict[str, _Entry] = {}
        for key, item in entries.items():
            entry = _entry(key, item)
            if entry is None:
                notes.append(StatusText(Severity.WARNING, f"state file {path}: {key!r} is not understood; left out"))
            else:
                found[key] = entry
        return found

    # -------------------------------------------------------------------------------------------------- writing

    def _content(self) -> str:
        entries = {
            key: {"value": _plain(BY_KEY[key], entry.value), "configured": _plain(BY_KEY[key], entry.configured)}
            for key, entry in self._entries.items()
        }
        content = {"format": FORMAT, "configuration": str(self._configuration), "set_by_ground_station": entries}
        return json.dumps(content, indent=2, allow_nan=False) + "\n"

    def _begin(self, text: str) -> None:
        with self._lock:
            self._text = text
            if self._writer is None:
                # A daemon: a disk that hangs must not keep the process from ending.
                self._writer = threading.Thread(target=self._write_all, name="swingd-state", daemon=True)
                self._writer.start()

    def _write_all(self) -> None:
        written: str | None = None
        while True:
            with self._lock:
                text = self._text
                if text is None or text == written:
                    self._text = self._writer = None
                    return
            try:
                self._write(text)
            except OSError as error:
                reason = error.strerror or str(error)
                text_told = (
                    f"state file {self.path} cannot be written: {reason}; what was set is lost at the next start"
                )
                # The event loop that it is handed to may have ended.
                with contextlib.suppress(RuntimeError):
                    self._on_note(StatusText(Severity.WARNING, text_told))
                with self._lock:
                    if self._text == text:
                        self._writer = None
                        return
            written = text

    def _write(self, text: str) -> None:
        path = self.path
        if path is None:
            raise OSError("no home folder is known")
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        new = path.with_name(path.name + ".new")
        try:
            # One left over from a power cut is overwritten.
            descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(new, path)
        except OSError:
            with contextlib.suppress(OSError):
                new.unlink(missing_ok=True)
            raise
        # The new name, too, has to survive a power cut; not every file system lets a folder be synchronised.
        with contextlib.suppress(OSError):
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def configuration_name(configuration: Path | None) -> str:
    """Name for what belongs to one configuration: two of the same file name are told apart by their folders."""
    if configuration is None:
        return "default"
    absolute = configuration.absolute()
    digest = hashlib.sha256(os.fsencode(absolute)).hexdigest()[:12]
    return f"{absolute.stem[:64]}-{digest}"


def state_folder() -> Path | None:
    """Folder of the state files; None if there is none.

    systemd's ``$STATE_DIRECTORY`` (the first of it), else ``swingd`` in ``$XDG_STATE_HOME`` or ``~/.local/state``.
    """
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given)
    home = os.environ.get("XDG_STATE_HOME", "")
    if os.path.isabs(home):
        return Path(home) / "swingd"
    try:
        return Path.home() / ".local" / "state" / "swingd"
    except RuntimeError:
        return None


def _entry(key: str, item: Any) -> _Entry | None:
    """Read one entry of the file; None if it is not one."""
    if key not in BY_KEY or not isinstance(item, dict):
        return None
    value = _number(BY_KEY[key], item.get("value"))
    configured = _number(BY_KEY[key], item.get("configured"))
    return None if value is None or configured is None else _Entry(value, configured)


def _number(parameter: GroundParameter, value: Any) -> float | None:
    if isinstance(value, bool) is not parameter.is_switch or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _plain(parameter: GroundParameter, value: float) -> float | bool:
    return bool(value) if parameter.is_switch else value
