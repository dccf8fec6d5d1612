"""structlog, one line per event: pretty on a terminal, JSON with a journald priority elsewhere."""

import sys
from typing import Any

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
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        wrapper_class=structlog.make_filtering_bound_logger("info"),
    )


def level_of(severity: Severity) -> str:
    """Return the name of structlog's method for a severity."""
    return _METHODS[severity]


def _priority_prefix(_logger: Any, method: str, line: Any) -> str:
    return f"<{_PRIORITIES.get(method, 6)}>{line}"
