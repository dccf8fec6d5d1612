"""The measurement noise as the innovation shows it: vibration enters R by itself."""

import math

from swingd.model.estimate import FloatArray

MEMORY_S = 0.5
"""Over which the innovation's variance is taken: vibration is believed, and forgotten, within a second or two."""
SLOW_HZ = 3.0
"""What the innovation does more slowly is no noise but an error of the model, a load of the wrong mass for one, a gust:
that is the disturbance's and the learning's to explain."""
SURPRISE_MAX = 9.0
"""What one sample may add, over the noise believed in so far: a single outlier is the gate's business."""
CHANCE = 0.5
"""Share of the configured density by which that of `MEMORY_S` exceeds it by chance."""


class MeasurementNoise:
    """Innovation-based densities of the measurement noise, axis by axis, never below the configured ones.

    The squares of the high-passed innovation, over `MEMORY_S`. The state's own error changes slowly and does not pass
    the high-pass, so that what is left is R / interval whatever the filter believes of itself.

    Parameters
    ----------
    R_diag : (3,)
        Configured densities, level frame [(m/s^2)^2 s].
    density_max : float
        The largest that an axis may be raised to; a configured one above it stays [(m/s^2)^2 s].
    """

    def __init__(self, R_diag: FloatArray, density_max: float) -> None:
        self._floor: list[float] = R_diag.tolist()
        self._ceiling = [max(floor, density_max) for floor in self._floor]
        self._last: list[list[float]] = []
        self.slow = [0.0] * 3
        """What is slow of the innovation, level frame [m/s^2]."""
        self._density = [0.0] * 3
        self.R_diag = R_diag.copy()
        """(3,) densities now [(m/s^2)^2 s]."""

    @property
    def inflation(self) -> float:
        """The largest ratio of a density to the configured one; 1 in normal flight."""
        densities: list[float] = self.R_diag.tolist()
        return max(now / floor for now, floor in zip(densities, self._floor, strict=True))

    def restart(self) -> None:
        """The filter began anew: its innovation jumps, the vibration stays."""
        self._last = []

    def update(self, innovation: FloatArray, dt_s: float) -> None:
        """Take the innovation of one interval, also of one that the gate will leave out.

        Parameters
        ----------
        innovation : (3,)
            Measured minus predicted mean acceleration over the interval, level frame [m/s^2].
        dt_s : float
            The interval [s].
        """
        values: list[float] = innovation.tolist()
        if not self._last:
            self._last, self.slow = [values, values], values.copy()
            return
        before, last = self._last
        self._last = [last, values]
        blend = dt_s / (dt_s + MEMORY_S)
        follow = -math.expm1(-2.0 * math.pi * SLOW_HZ * dt_s)
        for i, value in enumerate(values):
            # White noise minus its own first-order mean has more variance than alone.
            share = (1.0 - 0.5 * follow) * dt_s
            limit = math.sqrt(SURPRISE_MAX * max(self._density[i], self._floor[i]) / share)
            fast = value - self.slow[i]
            # The median: one outlier must not pass for a long and slow error.
            self.slow[i] += follow * (sorted((before[i], last[i], value))[1] - self.slow[i])
            fast = min(max(fast, -limit), limit)
            self._density[i] += blend * (share * fast * fast - self._density[i])
            self.R_diag[i] = min(max(self._density[i] - CHANCE * self._floor[i], self._floor[i]), self._ceiling[i])
