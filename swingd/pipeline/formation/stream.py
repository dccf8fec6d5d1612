"""Samples of one quantity on a vehicle's boot clock, and what it was between and shortly after them."""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np

from swingd.model.estimate import FloatArray

KEPT_S = 2.0
KEPT_MAX = 1024
"""Samples, so that no flood fills the memory."""
SLOPE_S = 0.1
SLOPE_MAX_S = 0.3
"""Two samples further apart tell no rate."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A quantity at one instant."""

    value: FloatArray
    rate: FloatArray
    carried_s: float
    """How far it was carried on beyond the newest sample."""


class SampleStream:
    """Interpolates by cubic Hermite polynomials where rates are told, else linearly; carries on with the rate."""

    def __init__(self) -> None:
        self._t: deque[float] = deque(maxlen=KEPT_MAX)
        self._values: deque[FloatArray] = deque(maxlen=KEPT_MAX)
        self._rates: deque[FloatArray | None] = deque(maxlen=KEPT_MAX)

    @property
    def newest_s(self) -> float | None:
        """Boot time of the newest sample."""
        return self._t[-1] if self._t else None

    def clear(self) -> None:
        """Forget everything."""
        self._t.clear()
        self._values.clear()
        self._rates.clear()

    def add(self, t_boot_s: float, value: FloatArray, rate: FloatArray | None = None) -> bool:
        """Take a sample; False if it is not newer than the last."""
        if self._t and t_boot_s <= self._t[-1]:
            return False
        self._t.append(t_boot_s)
        self._values.append(value)
        self._rates.append(rate)
        while self._t[0] < t_boot_s - KEPT_S:
            self._t.popleft()
            self._values.popleft()
            self._rates.popleft()
        return True

    def at(self, t_boot_s: float) -> Reading | None:
        """Return the quantity at an instant; None before the oldest sample."""
        count = len(self._t)
        right = bisect_right(self._t, t_boot_s)
        if right == 0:
            return None
        last, rate = self._values[right - 1], self._rates[right - 1]
        if right == count:
            carried_s = t_boot_s - self._t[-1]
            if rate is None:
                rate = self._slope(count - 1) if count > 1 else np.zeros_like(last)
            return Reading(last + carried_s * rate, rate, carried_s)
        step_s = self._t[right] - self._t[right - 1]
        s = (t_boot_s - self._t[right - 1]) / step_s
        following, rate_after = self._values[right], self._rates[right]
        if rate is None or rate_after is None:
            return Reading(last + s * (following - last), self._slope(right), 0.0)
        value = (
            (1.0 + 2.0 * s) * (1.0 - s) ** 2 * last
            + s * s * (3.0 - 2.0 * s) * following
            + step_s * s * (1.0 - s) * ((1.0 - s) * rate - s * rate_after)
        )
        return Reading(value, rate + s * (rate_after - rate), 0.0)

    def _slope(self, right: int) -> FloatArray:
        """Rate from the samples of the last `SLOPE_S` before one, at least two: samples are noisy."""
        left = right - 1
        while left > 0 and self._t[right] - self._t[left - 1] <= SLOPE_S:
            left -= 1
        step_s = self._t[right] - self._t[left]
        between: FloatArray = self._values[right] - self._values[left]
        return between / step_s if step_s <= SLOPE_MAX_S else np.zeros_like(between)
