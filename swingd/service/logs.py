"""structlog, one line per event: pretty on a terminal, JSON with a journald priority elsewhere."""

import contextlib
import sys
from datetime import UTC, datetime
from typing import Any, TextIO, cast

from swingd.model.actions import Severity

_PRIORITIES = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}
_METHODS = {
    Severity.CRITICAL: "critical",
    Severity.ERROR: "error",
    Severity.WARNING: "warning",
    Severity.NOTICE: "info",
    Severity.INFO: "info",
}
_KEPT_MAX = 1000


class Log:
    """Lines with fields, kept until `open`: structlog brings rich with it, and forwarding must not wait for that.

    Parameters
    ----------
    under_journald : bool
        Prefix each line with its syslog priority, as journald reads it.
    """

    def __init__(self, under_journald: bool = False) -> None:
        self._under_journald = under_journald
        self._kept: list[tuple[str, str, dict[str, Any]]] = []
        self._logger: Any = None

    def open(self) -> None:
        """Load structlog, write what was kept, and write at once from now on."""
        if self._logger is None:
            self._logger = _logger(self._under_journald)
            for level, event, fields in self._kept:
                getattr(self._logger, level)(event, **fields)
            self._kept.clear()

    def write(self, level: str, event: str, **fields: Any) -> None:
        """Write a line; ``level`` is info, warning, error or critical."""
        fields["timestamp"] = datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
        if self._logger is not None:
            getattr(self._logger, level)(event, **fields)
        elif len(self._kept) < _KEPT_MAX:
            self._kept.append((level, event, fields))

    def info(self, event: str, **fields: Any) -> None:
        """Write a line of level info."""
        self.write("info", event, **fields)

    def warning(self, event: str, **fields: Any) -> None:
        """Write a line of level warning."""
        self.write("warning", event, **fields)

    def error(self, event: str, **fields: Any) -> None:
        """Write a line of level error."""
        self.write("error", event, **fields)


def level_of(severity: Severity) -> str:
    """Return the level of a severity."""
    return _METHODS[severity]


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
    return f"<{_PRIORITIES.get(method, 6)}>{line}"
