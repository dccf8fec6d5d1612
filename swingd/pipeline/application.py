"""The stream of an application's setpoints: whose, how often, and for how long one of them holds."""

from collections import deque
from itertools import pairwise

from swingd.model.events import AppSetpoint

SLOWEST_S = 0.2
"""A stream with a longer mean interval is not corrected: 5 Hz."""
JITTER_SHARE = 0.02
"""By which it may be longer, so that an application of just 5 Hz is not taken for a slower one now and then."""
REPEAT_MAX_S = 0.5
REPEAT_INTERVALS = 3.0
"""A setpoint is repeated for this many of the stream's longest interval, at most `REPEAT_MAX_S`."""
FRESH_SHARE = 0.5
"""Of that time: from here on the correction fades, to be gone at `FADED_SHARE`."""
FADED_SHARE = 0.9
RECOVERY_S = 0.3
"""Time in which the correction returns with a stream that had faltered."""
WINDOW_S = 2.0
ARRIVALS_MIN = 3
ARRIVALS_MAX = 1024
CONTEST_S = 1.0
"""Two sources within this time contest the vehicle."""


class ApplicationStream:
    """What one application asks for, and whether it still asks."""

    def __init__(self) -> None:
        self._setpoint: AppSetpoint | None = None
        self._arrivals: deque[float] = deque(maxlen=ARRIVALS_MAX)
        self._contested_s = float("-inf")
        self._freshness = 1.0
        self.repeat_s = 0.0
        """How long the last setpoint may be repeated; 0 for a stream that is too slow or too young to be corrected."""

    def take(self, setpoint: AppSetpoint) -> None:
        """Take the next setpoint, of whatever source."""
        last = self._setpoint
        now_s = setpoint.t_mono_s
        if last is not None and last.source != setpoint.source:
            if now_s - last.t_mono_s < CONTEST_S:
                self._contested_s = now_s
            self._arrivals.clear()
        if self._arrivals and now_s - self._arrivals[-1] > REPEAT_MAX_S:
            self._arrivals.clear()
        self._setpoint = setpoint
        self._arrivals.append(now_s)
        while self._arrivals[0] < now_s - WINDOW_S:
            self._arrivals.popleft()
        self.repeat_s = _repeat_s(list(self._arrivals))

    def end(self) -> None:
        """The application asks for something else now."""
        self._setpoint = None
        self._arrivals.clear()
        self.repeat_s = 0.0

    @property
    def setpoint(self) -> AppSetpoint | None:
        """What was asked for last; None where nothing was, or something else since."""
        return self._setpoint

    def is_contested(self, t_mono_s: float) -> bool:
        """Whether two sources send setpoints: none of them is corrected."""
        return t_mono_s - self._contested_s < CONTEST_S

    def holds(self, t_mono_s: float) -> bool:
        """Whether the last setpoint is still meant, by an application that can be corrected."""
        last = self._setpoint
        return last is not None and not self.is_contested(t_mono_s) and t_mono_s - last.t_mono_s < self.repeat_s

    def freshness(self, t_mono_s: float, dt_s: float) -> float:
        """Return the share of the correction that an ageing setpoint takes, 1 to 0; to be called at each step."""
        share = 0.0
        if self._setpoint is not None and self.repeat_s > 0.0:
            age = (t_mono_s - self._setpoint.t_mono_s) / self.repeat_s
            share = min(1.0, max(0.0, (FADED_SHARE - age) / (FADED_SHARE - FRESH_SHARE)))
        self._freshness = min(share, self._freshness + dt_s / RECOVERY_S)
        return self._freshness

    def met(self) -> None:
        """A correction begins: nothing has faltered yet."""
        self._freshness = 1.0


def _repeat_s(arrivals_s: list[float]) -> float:
    """Judge a stream by its arrivals; the longest interval counts, so that a jittering stream is not taken for dead."""
    intervals = len(arrivals_s) - 1
    if intervals < ARRIVALS_MIN - 1 or arrivals_s[-1] - arrivals_s[0] > SLOWEST_S * (1.0 + JITTER_SHARE) * intervals:
        return 0.0
    longest_s = max(after - before for before, after in pairwise(arrivals_s))
    return min(REPEAT_MAX_S, REPEAT_INTERVALS * longest_s)
