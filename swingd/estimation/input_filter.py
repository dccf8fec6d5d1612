"""Matched filters of an estimator's inputs: force and acceleration alike, with a delay that is known."""

import math
from collections.abc import Sequence

import numpy as np

from swingd.core import input_filter as kernels
from swingd.core.status import Status
from swingd.estimation.base import inputs_valid
from swingd.model.errors import ConfigurationError
from swingd.model.estimate import FloatArray

BUTTERWORTH = math.sqrt(0.5)
GAP_SAMPLES = 5.0
"""After an interval of so many samples, or longer, the filter begins anew."""
RATE_TOLERANCE = 0.02
"""The sections are designed anew where the interval differs by more than this share from the one before."""
NYQUIST_SHARE_MAX = 0.9
"""Of half the rate: corners from there on are none."""


class MatchedFilter:
    """Low-pass and notches, the same for force and acceleration, so that their difference stays in phase.

    What comes out is `delay_s` old: the estimate that it feeds is to be carried ahead by that. White noise keeps its
    density below the corner, so that the density an estimator assumes stays right.

    Parameters
    ----------
    rate_hz : float
        At which samples come [Hz]; each interval's own length counts as well.
    low_pass_hz : float
        Corner of a Butterworth low-pass of second order; infinite: none.
    notches_hz : sequence of (float, float)
        Centre and width of each notch.

    Raises
    ------
    ConfigurationError
        If a frequency is not positive or not well below half of the rate.
    """

    def __init__(
        self, rate_hz: float, low_pass_hz: float = math.inf, notches_hz: Sequence[tuple[float, float]] = ()
    ) -> None:
        highest = 0.5 * NYQUIST_SHARE_MAX * rate_hz
        wanted = [("low-pass", low_pass_hz)] if math.isfinite(low_pass_hz) else []
        wanted += [("notch", centre) for centre, _ in notches_hz]
        for kind, frequency_hz in wanted:
            if not 0.0 < frequency_hz < highest:
                raise ConfigurationError(f"{kind} at {frequency_hz:g} Hz; expected 0 < Hz < {highest:g}")
        for centre_hz, width_hz in notches_hz:
            if not 0.0 < width_hz <= centre_hz:
                raise ConfigurationError(
                    f"notch at {centre_hz:g} Hz: width {width_hz:g} Hz; expected 0 < width <= centre"
                )
        self._low_pass_hz = low_pass_hz
        self._notches_hz = tuple(notches_hz)
        count = len(wanted)
        self._sections = np.empty((count, kernels.Section.SIZE))
        self._first = np.zeros((count, 6))
        self._second = np.zeros((count, 6))
        self._values = np.empty(6)
        self._design(1.0 / rate_hz)
        self._started = False

    @property
    def delay_s(self) -> float:
        """How old what comes out is, for signals below the corner."""
        return self._delay_s

    def reset(self) -> None:
        """Begin anew with the next sample, as if it had been there for ever."""
        self._started = False

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float) -> tuple[Status, FloatArray, FloatArray]:
        """Filter one interval's means.

        Parameters
        ----------
        force_n, acc_mps2 : (3,)
            In a frame that does not turn.
        dt_s : float
            Length of the interval [s].

        Returns
        -------
        Status, (3,), (3,)
            ``OK`` and the filtered inputs, or ``INPUT_INVALID`` and the inputs as they came: nothing was done.
        """
        if not inputs_valid(force_n, acc_mps2, dt_s):
            return Status.INPUT_INVALID, force_n, acc_mps2
        if dt_s >= GAP_SAMPLES * self._dt_s:
            self._started = False
        elif abs(dt_s / self._dt_s - 1.0) > RATE_TOLERANCE and self._realisable(dt_s):
            self._design(dt_s)
        self._values[:3] = force_n
        self._values[3:] = acc_mps2
        if not self._started:
            kernels.settle(self._first, self._second, self._sections, self._values)
            self._started = True
        kernels.advance(self._values, self._first, self._second, self._sections)
        return Status.OK, self._values[:3].copy(), self._values[3:].copy()

    def _realisable(self, dt_s: float) -> bool:
        highest = max([f for f in (self._low_pass_hz,) if math.isfinite(f)] + [c for c, _ in self._notches_hz] + [0.0])
        return highest < 0.5 * NYQUIST_SHARE_MAX / dt_s

    def _design(self, dt_s: float) -> None:
        rate_hz, row = 1.0 / dt_s, 0
        if math.isfinite(self._low_pass_hz):
            kernels.low_pass(self._sections[row], self._low_pass_hz, BUTTERWORTH, rate_hz)
            row += 1
        for centre_hz, width_hz in self._notches_hz:
            kernels.notch(self._sections[row], centre_hz, width_hz, rate_hz)
            row += 1
        self._dt_s = dt_s
        self._delay_s = float(kernels.delay_samples(self._sections)) * dt_s
