"""The baseline: a pendulum that only knows the measured acceleration."""

import math

import numpy as np

from swingd.core import pendulum as kernels
from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.estimation.base import inputs_valid
from swingd.model.estimate import FloatArray, ResetReason, SwingEstimate
from swingd.model.parameters import Parameters


class Pendulum:
    """Open-loop linear pendulum; knows no thrust and corrects nothing.

    Parameters
    ----------
    parameters : Parameters
        Cable, payload, vehicle and ``estimator.damping_ratio``.
    high_pass_hz : float
        Corner of a first-order high-pass on the acceleration; 0 switches it off.
    """

    def __init__(self, parameters: Parameters, high_pass_hz: float = 0.0) -> None:
        self._length_m = parameters.cable.length_m
        self._payload_mass_kg = parameters.payload.mass_kg
        self._damping_ratio = parameters.estimator.damping_ratio
        self._angle_var = parameters.estimator.swing_std_init_rad**2
        self._rate_var = parameters.estimator.swing_rate_std_init_radps**2
        self._high_pass_radps = 2.0 * math.pi * high_pass_hz
        self._x = np.zeros(7)
        self._acc_slow = np.zeros(3)
        self.resets = dict.fromkeys(ResetReason, 0)

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float, *, thrust_known: bool = True) -> Status:
        """Advance over one interval; the force is not used."""
        if not inputs_valid(acc_mps2, acc_mps2, dt_s):
            return Status.INPUT_INVALID
        acc = acc_mps2
        if self._high_pass_radps > 0.0:
            self._acc_slow += (1.0 - math.exp(-self._high_pass_radps * dt_s)) * (acc_mps2 - self._acc_slow)
            acc = acc_mps2 - self._acc_slow
        inv_length = 1.0 / self._length_m
        kernels.step(self._x[:4], acc, dt_s, GRAVITY_MPS2 * inv_length, self._damping_ratio, inv_length)
        return Status.OK

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Swing on without acceleration."""
        self.step(force_n, np.zeros(3), dt_s)

    def estimate(self) -> SwingEstimate:
        """Return the angles; nothing is known of the force, and the covariance is that of the start."""
        P = np.diag([self._angle_var] * 2 + [self._rate_var] * 2 + [0.0] * 3)
        stiffness = GRAVITY_MPS2 / self._length_m
        damping = 2.0 * self._damping_ratio * math.sqrt(stiffness)
        x_rate = np.concatenate([self._x[2:4], -stiffness * self._x[:2] - damping * self._x[2:4]])
        return SwingEstimate(self._x.copy(), x_rate, P, 0.0, self._payload_mass_kg * GRAVITY_MPS2)

    def reset(self, reason: ResetReason, force_n: tuple[float, float, float] | None = None) -> None:
        """Begin anew with the load at rest below."""
        self.resets[reason] += 1
        self._x[:] = 0.0
        self._acc_slow[:] = 0.0
