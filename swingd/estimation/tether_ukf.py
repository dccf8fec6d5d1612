"""The tether UKF of one vehicle as a swing estimator; equations in `swingd.core.tether_ukf`."""

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.fgdf import cable_force
from swingd.core.status import Status
from swingd.estimation.base import fault_of, inputs_valid
from swingd.estimation.tether_direction import TetherDirection
from swingd.model.estimate import FloatArray, ResetReason, SwingEstimate
from swingd.model.parameters import Parameters


class TetherUkf:
    """Direction of the cable, measured by the force that thrust and weight do not account for, (9)-(21).

    It needs neither the load's mass nor a model of its pull. It knows no disturbance: wind on the vehicle is taken for
    the load's pull, and the force that is told is zero. Force and acceleration are means over an interval and belong
    to its middle: there the state is corrected, with half of the interval predicted before and half after.

    The noise of the measured direction is what ``estimator.acc_noise`` and ``acc_noise_vertical`` make of the cable
    force, over its size; ``estimator.swing_rate_noise`` is the Sigma of (19) as a density.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, payload, cable and estimator.
    """

    def __init__(self, parameters: Parameters) -> None:
        estimator = parameters.estimator
        self._mass_kg = parameters.vehicle.mass_kg
        self._weight_n = parameters.payload.mass_kg * GRAVITY_MPS2
        across, down = estimator.acc_noise, estimator.acc_noise_vertical
        self._force_density = self._mass_kg**2 * np.diag([across**2, across**2, down**2])
        self._nis_gate = estimator.nis_gate
        self._tether = TetherDirection(
            parameters.cable.length_m,
            estimator.swing_rate_noise,
            estimator.swing_std_init_rad,
            estimator.swing_rate_std_init_radps,
        )
        self._acc = np.zeros(3)
        self._cable_force = np.array([0.0, 0.0, self._weight_n])
        self._gated_s = 0.0
        self._coasted = False
        self.resets = dict.fromkeys(ResetReason, 0)

    @property
    def tether(self) -> TetherDirection:
        """The cable's direction with inclination and azimuth."""
        return self._tether

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float, *, thrust_known: bool = True) -> Status:
        """Advance over one interval; see `SwingEstimator.step`."""
        if not inputs_valid(force_n, acc_mps2, dt_s):
            return Status.INPUT_INVALID
        self._acc[:] = acc_mps2
        self._coasted = False
        cable_force(self._cable_force, force_n, self._acc, self._mass_kg)
        measured = self._advance(dt_s)
        if measured not in (Status.OK, Status.GATED):
            self.reset(ResetReason.NUMERICS)
            return measured
        self._gated_s = self._gated_s + dt_s if measured is Status.GATED else 0.0
        return Status.NOT_CONVERGED if self._faulty() else measured

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Predict over an interval without a measurement, the acceleration held as it was last measured."""
        if not inputs_valid(force_n, force_n, dt_s):
            return
        self._coasted = True
        if self._tether.predict(self._acc, dt_s) is not Status.OK:
            self.reset(ResetReason.NUMERICS)
        else:
            self._faulty()

    def estimate(self) -> SwingEstimate:
        """Return the state after the last step; the tension is the measured cable force along the estimated cable."""
        swing, swing_rate, cov = self._tether.swing()
        P = np.zeros((7, 7))
        P[:4, :4] = cov
        nis = 0.0 if self._coasted else self._tether.nis
        tension_n = float(self._tether.direction @ self._cable_force)
        return SwingEstimate(np.concatenate([swing, np.zeros(3)]), swing_rate, P, nis, tension_n)

    def reset(self, reason: ResetReason, force_n: tuple[float, float, float] | None = None) -> None:
        """Begin anew with the load at rest below; there is no state for a disturbance measured before."""
        self.resets[reason] += 1
        self._tether.reset()
        self._acc[:] = 0.0
        self._cable_force[:] = (0.0, 0.0, self._weight_n)
        self._gated_s = 0.0

    def _advance(self, dt_s: float) -> Status:
        """Predict to the middle of the interval, correct, and predict to its end."""
        status = self._tether.predict(self._acc, 0.5 * dt_s)
        if status is not Status.OK:
            return status
        measured = self._tether.correct(self._cable_force, self._force_density / dt_s, self._nis_gate)
        if measured not in (Status.OK, Status.GATED):
            return measured
        status = self._tether.predict(self._acc, 0.5 * dt_s)
        return measured if status is Status.OK else status

    def _faulty(self) -> bool:
        swing, _, cov = self._tether.swing()
        reason = fault_of(swing, cov, self._gated_s)
        if reason is not None:
            self.reset(reason)
        return reason is not None
