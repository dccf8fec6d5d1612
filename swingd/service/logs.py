"""structlog, one line per event: pretty on a terminal, JSON elsewhere, with a priority where journald reads it."""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, TextIO, cast

from swingd.model.actions import Severity

REPEATS_MAX = 5
"""Lines of one event, of one link where it names one, within `WINDOW_S`; further ones are counted."""
WINDOW_S = 10.0
EVENTS_MAX = 256
"""Different events that are counted at a time: their texts may hold what others have sent."""
LINES_MAX = 100
"""Lines of any events within `WINDOW_S`; errors and worse are written beyond it."""

_PRIORITIES = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}
_METHODS = {
    Severity.CRITICAL: "critical",
    Severity.ERROR: "error",
    Severity.WARNING: "warning",
    Severity.NOTICE: "info",
    Severity.INFO: "info",
}
_KEPT_MAX = 1000


@dataclass(slots=True)
class _Window:
    """One event since it was written first, or all together."""

    begun_s: float
    level: str = "warning"
    event: str = "lines of many events"
    fields: dict[str, Any] = field(default_factory=dict)
    written: int = 0
    left_out: int = 0


class Log:
    """Lines with fields, kept until `open`: structlog brings rich with it, and forwarding must not wait for that.

    Parameters
    ----------
    under_journald : bool
        Prefix each line with its syslog priority, as journald reads it; see `journald_reads`.
    clock : callable, optional
        The host's monotonic clock [s].

    Notes
    -----
    Of one event `REPEATS_MAX` lines are written within `WINDOW_S`, then one that says how many were left out; of all
    together `LINES_MAX`. May be used from any thread.
    """

    def __init__(self, under_journald: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._under_journald = under_journald
        self._clock = clock
        self._lock = threading.Lock()
        self._kept: list[tuple[str, str, dict[str, Any]]] = []
        self._logger: Any = None
        self._windows: dict[tuple[str, Any], _Window] = {}
        self._all = _Window(clock())

    def open(self) -> None:
        """Load structlog, write what was kept, and write at once from now on."""
        if self._logger is not None:
            return
        logger = _logger(self._under_journald)
        with self._lock:
            self._logger = logger
            for level, event, fields in self._kept:
                getattr(logger, level)(event, **fields)
            self._kept.clear()

    def close(self) -> None:
        """Write whatever still waits, and how much was left out."""
        self.open()
        with self._lock:
            self._sum_up(float("inf"))

    def write(self, level: str, event: str, **fields: Any) -> None:
        """Write a line; ``level`` is info, warning, error or critical."""
        now_s = self._clock()
        with self._lock:
            self._sum_up(now_s)
            key = event, fields.get("link")
            window = self._windows.get(key)
            if window is None:
                if len(self._windows) >= EVENTS_MAX:
                    self._end(next(iter(self._windows)))
                link = {} if key[1] is None else {"link": key[1]}
                window = self._windows[key] = _Window(now_s, level, event, link)
            if window.written >= REPEATS_MAX:
                window.left_out += 1
                return
            window.written += 1
            if self._all.written >= LINES_MAX and _PRIORITIES[level] > _PRIORITIES["error"]:
                self._all.left_out += 1
                return
            self._all.written += 1
            self._emit(level, event, fields)

    def tick(self) -> None:
        """Let time pass: say how much was left out, where that has ended."""
        with self._lock:
            self._sum_up(self._clock())

    def info(self, event: str, **fields: Any) -> None:
        """Write a line of level info."""
        self.write("info", event, **fields)

    def warning(self, event: str, **fields: Any) -> None:
        """Write a line of level warning."""
        self.write("warning", event, **fields)

    def error(self, event: str, **fields: Any) -> None:
        """Write a line of level error."""
        self.write("error", event, **fields)

    def _sum_up(self, now_s: float) -> None:
        if now_s - self._all.begun_s >= WINDOW_S:
            ended, self._all = self._all, _Window(now_s)
            self._tell_left_out(ended)
        # In the order of their beginnings, as a dictionary keeps them.
        while self._windows:
            key = next(iter(self._windows))
            if now_s - self._windows[key].begun_s < WINDOW_S:
                return
            self._end(key)

    def _end(self, key: tuple[str, Any]) -> None:
        self._tell_left_out(self._windows.pop(key))

    def _tell_left_out(self, window: _Window) -> None:
        if window.left_out:
            self._emit(window.level, window.event, {**window.fields, "left_out": window.left_out})

    def _emit(self, level: str, event: str, fields: dict[str, Any]) -> None:
        fields["timestamp"] = datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
        if self._logger is not None:
            getattr(self._logger, level)(event, **fields)
        elif len(self._kept) < _KEPT_MAX:
            self._kept.append((level, event, fields))


def level_of(severity: Severity) -> str:
    """Return the level of a severity."""
    return _METHODS[severity]


def journald_reads(environment: Mapping[str, str], descriptor: int = 2) -> bool:
    """Whether what is written to a descriptor goes to the journal, after systemd.exec(5).

    ``JOURNAL_STREAM`` is handed on to processes whose output goes elsewhere: it names the stream that it is true of.
    """
    try:
        status = os.fstat(descriptor)
    except OSError:
        return False
    return environment.get("JOURNAL_STREAM", "") == f"{status.st_dev}:{status.st_ino}"


def with_priority(level: str, text: str) -> str:
    """Prefix every line of a text with the priority that journald reads."""
    return "\n".join(f"<{_PRIORITIES[level]}>{line}" for line in text.splitlines())


def _logger(under_journald: bool) -> Any:
    import structlog

    processors: list[Any] = [structlog.processors.add_log_level]
    if sys.stderr.isatty():
        processors.append(structlog.dev.ConsoleRenderer())
    else:
        processors.append(structlog.processors.JSONRenderer())
    if under_journald:
        processors.append(_priority_prefix)
    return structlog.wrap_logger(
        structlog.PrintLogger(cast(TextIO, _Unbreakable(sys.stderr))),
        processors=processors,
        wrapper_class=structlog.make_filtering_bound_logger("info"),
    )


class _Unbreakable:
    """A text stream whose reader may go away and whose disk may be full: a lost line must not end a flight."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError):
            return self._stream.write(text)
        return 0

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()


def _priority_prefix(_logger: Any, method: str, line: Any) -> str:
    return with_priority(method, str(line))
