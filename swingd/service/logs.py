"""structlog, one line per event: pretty on a terminal, JSON with a journald priority elsewhere."""

import contextlib
import sys
from typing import Any, TextIO, cast

import structlog

from swingd.model.actions import Severity

_PRIORITIES = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}

_METHODS = {
    Severity.CRITICAL: "critical",
    Severity.ERROR: "error",
    Severity.WARNING: "warning",
    Severity.NOTICE: "info",
    Severity.INFO: "info",
}


def configure_logs(under_journald: bool = False) -> None:
    """Set structlog up for standard error.

    Parameters
    ----------
    under_journald : bool
        Prefix each line with its syslog priority, as journald reads it.
    """
    processors: list[Any] = [structlog.processors.add_log_level, structlog.processors.TimeStamper(fmt="iso", utc=True)]
    if sys.stderr.isatty():
        processors.append(structlog.dev.ConsoleRenderer())
    else:
        processors.append(structlog.processors.JSONRenderer())
    if under_journald:
        processors.append(_priority_prefix)
    structlog.configure(
        processors=processors,
        logger_factory=structlog.PrintLoggerFactory(cast(TextIO, _Unbreakable(sys.stderr))),
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


def level_of(severity: Severity) -> str:
    """Return the name of structlog's method for a severity."""
    return _METHODS[severity]


def _priority_prefix(_logger: Any, method: str, line: Any) -> str:
    return f"<{_PRIORITIES.get(method, 6)}>{line}"
