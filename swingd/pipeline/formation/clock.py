"""A vehicle's boot clock as the host's clock shows it."""

import math

WINDOW_S = 10.0
"""What was measured counts for one to two of these; quartz drifts by less than a millisecond meanwhile."""
ONE_WAY_STD_S = 0.02
"""What the quickest delivery may have taken, where no answer tells."""
STAMP_STD_S = 5e-4
"""Stamps count milliseconds."""
ANSWER_WINDOW_S = 1.0
"""An answer that differs by more from what the stamps say is of another clock."""
ROUND_TRIP_MAX_S = 1.0


class Least:
    """Smallest value of the last one to two windows, with what belongs to it."""

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._now: tuple[float, float] = (math.inf, 0.0)
        self._before: tuple[float, float] = (math.inf, 0.0)
        self._begun_s = -math.inf

    def add(self, t_s: float, value: float, other: float = 0.0) -> None:
        """Take a value at a time."""
        self._turn(t_s)
        self._now = min(self._now, (value, other))

    def get(self, t_s: float) -> tuple[float, float] | None:
        """Return the smallest value and what belongs to it; None where none was taken lately."""
        self._turn(t_s)
        least = min(self._now, self._before)
        return None if math.isinf(least[0]) else least

    def _turn(self, t_s: float) -> None:
        elapsed_s = t_s - self._begun_s
        if elapsed_s < self._window_s:
            return
        self._before = self._now if elapsed_s < 2.0 * self._window_s else (math.inf, 0.0)
        self._now = (math.inf, 0.0)
        self._begun_s = t_s


class ClockOffset:
    """Estimates what must be added to a boot time to give the host's time.

    No delivery is quicker than instantaneous, so the least of arrival minus stamp bounds the offset from above; it is
    the offset plus the quickest delivery. An answer to a question bounds it from both sides: the quickest one, in the
    middle of its round trip, tells it within half of that.
    """

    def __init__(self) -> None:
        self._arrivals = Least(WINDOW_S)
        self._answers = Least(WINDOW_S)
        self._last: tuple[float, float] | None = None

    def arrived(self, t_mono_s: float, t_boot_s: float) -> None:
        """Take a stamp and its arrival."""
        self._arrivals.add(t_mono_s, t_mono_s - t_boot_s)

    def answered(self, t_mono_s: float, sent_s: float, t_boot_s: float) -> bool:
        """Take an answer; False if it cannot be one of this clock."""
        round_trip_s = t_mono_s - sent_s
        offset_s = 0.5 * (t_mono_s + sent_s) - t_boot_s
        known = self.offset(t_mono_s)
        if not 0.0 <= round_trip_s <= ROUND_TRIP_MAX_S:
            return False
        if known is not None and abs(offset_s - known[0]) > ANSWER_WINDOW_S:
            return False
        self._answers.add(t_mono_s, round_trip_s, offset_s)
        return True

    def offset(self, t_mono_s: float) -> tuple[float, float] | None:
        """Return offset and deviation [s]; the last ones while nothing is heard, None before anything was."""
        arrival, answer = self._arrivals.get(t_mono_s), self._answers.get(t_mono_s)
        if answer is not None:
            round_trip_s, offset_s = answer
            if arrival is not None and abs(offset_s - arrival[0]) <= 0.5 * round_trip_s:
                offset_s = min(offset_s, arrival[0])
            self._last = offset_s, math.hypot(round_trip_s / math.sqrt(12.0), STAMP_STD_S)
        elif arrival is not None:
            self._last = arrival[0], ONE_WAY_STD_S
        return self._last
