"""What a kernel answers."""

from enum import IntEnum


class Status(IntEnum):
    """Outcome of one filter step or measurement."""

    OK = 0
    GATED = 1
    """The measurement was left out by the innovation gate; the prediction stands."""
    NOT_CONVERGED = 2
    """An iteration did not converge; nothing was written."""
    NOT_FINITE = 3
    """A result is not finite; nothing was written."""
    NOT_POSITIVE = 4
    """A covariance is not positive definite; nothing was written."""
    INPUT_INVALID = 5
    """An input is not finite or out of its range; nothing was written."""
    TOO_LATE = 6
    """The measurement is older than what the filter remembers; nothing was written."""
