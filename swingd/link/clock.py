"""The autopilot's clock as it is seen through a link that delays, loses and reorders."""

from enum import Enum

AHEAD_S = 0.25
"""A stamp this far ahead of the quickest delivery so far is not believed at once [s]."""
LATE_S = 1.0
"""A stamp this far behind is too old to be used [s]."""
CONFIRM_S = 0.3
"""A new clock is believed when its stamps agree for this long [s]."""
CONFIRM_STAMPS = 5
"""... and are at least this many."""
RESTART_S = 1.0
"""A confirmed step above this is a restart, a smaller one the link's doing [s]."""
_LEAK_S = 0.5
_LEAK_STEP_MAX_S = 0.05


class Verdict(Enum):
    """What a clock says to a stamp."""

    GOOD = "good"
    LATE = "late"
    AHEAD = "ahead"
    RESTART = "restart"
    """The stamp is good, by a clock that began anew."""


class RemoteClock:
    """Judges stamps of a remote clock by the host's monotonic clock.

    The difference stamp - arrival is largest for the quickest delivery, so its upper envelope (slowly leaking, to
    follow drift, simulators that run at another speed and links that got slower) tells what a stamp ought to be.
    A stamp outside of the window around it is refused, but remembered: when stamps that agree with each other keep
    coming and none fits the old clock, the clock itself has changed. Hence one wild stamp changes nothing, and a reboot
    is seen after `CONFIRM_S`. A backlog that the link delivers at once is late, not a reboot: its stamps soon catch up.
    """

    __slots__ = ("_count", "_first_stamp_s", "_first_t_mono_s", "_other_s", "_t_mono_s", "offset_s", "step_s")

    def __init__(self) -> None:
        self.offset_s: float | None = None
        """Stamp minus ``t_mono_s`` at the quickest delivery [s]; None before the first stamp."""
        self.step_s = 0.0
        """Size of the last restart: new offset minus old [s]."""
        self._t_mono_s = 0.0
        self._other_s = 0.0
        self._count = 0
        self._first_stamp_s = 0.0
        self._first_t_mono_s = 0.0

    def judge(self, t_mono_s: float, stamp_s: float) -> Verdict:
        """Take the next stamp [s] and its time of arrival [s]."""
        sample_s = stamp_s - t_mono_s
        if self.offset_s is None:
            self.offset_s = sample_s
            self._t_mono_s = t_mono_s
            return Verdict.GOOD
        error_s = sample_s - self.offset_s
        if -LATE_S < error_s <= AHEAD_S:
            elapsed_s = min(max(t_mono_s - self._t_mono_s, 0.0), _LEAK_STEP_MAX_S)
            self.offset_s += error_s if error_s > 0.0 else error_s * elapsed_s / _LEAK_S
            self._t_mono_s = t_mono_s
            self._count = 0
            return Verdict.GOOD
        if self._count == 0 or abs(sample_s - self._other_s) > AHEAD_S:
            self._count = 1
            self._first_stamp_s = stamp_s
            self._first_t_mono_s = t_mono_s
        else:
            self._count += 1
        self._other_s = sample_s
        if (
            self._count >= CONFIRM_STAMPS
            and t_mono_s - self._first_t_mono_s >= CONFIRM_S
            and stamp_s - self._first_stamp_s > 0.01  # a frozen clock confirms nothing
        ):
            self.offset_s = sample_s
            self._t_mono_s = t_mono_s
            self._count = 0
            if abs(error_s) <= RESTART_S:
                return Verdict.GOOD
            self.step_s = error_s
            return Verdict.RESTART
        return Verdict.LATE if error_s < 0.0 else Verdict.AHEAD


def unwrap(stamp_s: float, expected_s: float, period_s: float) -> float:
    """The time nearest to ``expected_s`` that a counter of period ``period_s`` shows as ``stamp_s``."""
    return stamp_s + period_s * round((expected_s - stamp_s) / period_s)
