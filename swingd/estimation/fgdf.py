"""The Fading Gaussian Deterministic Filter of Drones 2023, 7, 654, as an object with state: the linear baseline."""

import math

import numpy as np

from swingd.core import fgdf as kernels
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status
from swingd.estimation.base import fault_of, inputs_valid
from swingd.model.estimate import FloatArray, ResetReason, SwingEstimate
from swingd.model.parameters import Parameters


class Fgdf:
    """Four states, xi, zeta and their rates, measured by the angles that the cable force shows, (22)-(26).

    It knows no disturbance: wind on the vehicle is taken for the load's pull, and the force that is told is zero. The
    fading factor is exp(-dt / ``estimator.fgdf_memory_s``), so that what is forgotten does not depend on the filter's
    rate. Force and acceleration are means over an interval and belong to its middle: there the state is corrected,
    with half of the interval predicted before and half after.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, payload, cable and estimator.
    """

    def __init__(self, parameters: Parameters) -> None:
        estimator = parameters.estimator
        self._mass_kg = parameters.vehicle.mass_kg
        self._payload_mass_kg = parameters.payload.mass_kg
        self._length_m = parameters.cable.length_m
        self._memory_s = estimator.fgdf_memory_s
        self._angle_var = estimator.fgdf_angle_noise_rad**2
        self._nis_gate = estimator.nis_gate
        self._E_init = np.diag([estimator.swing_std_init_rad**2] * 2 + [estimator.swing_rate_std_init_radps**2] * 2)
        self._x = np.zeros(kernels.NUM_STATES)
        self._E = self._E_init.copy()
        self._Phi = np.empty((kernels.NUM_STATES, kernels.NUM_STATES))
        self._Gamma = np.empty((kernels.NUM_STATES, 2))
        self._angles = np.empty(2)
        self._force = np.zeros(3)
        self._weight = np.array([0.0, 0.0, self._payload_mass_kg * GRAVITY_MPS2])
        self._cable_force = self._weight.copy()
        self._nis = np.zeros(1)
        self._gated_s = 0.0
        self.resets = dict.fromkeys(ResetReason, 0)

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float, *, thrust_known: bool = True) -> Status:
        """Advance over one interval; see `SwingEstimator.step`."""
        if not inputs_valid(force_n, acc_mps2, dt_s):
            return Status.INPUT_INVALID
        self._force[:] = force_n
        kernels.cable_force(self._cable_force, self._force, acc_mps2, self._mass_kg)
        status = self._advance(acc_mps2, dt_s)
        if status not in (Status.OK, Status.GATED):
            self.reset(ResetReason.NUMERICS)
            return status
        self._gated_s = self._gated_s + dt_s if status is Status.GATED else 0.0
        reason = fault_of(self._x, self._E, self._gated_s)
        if reason is not None:
            self.reset(reason)
            return Status.NOT_CONVERGED
        return status

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Predict over an interval without a measurement."""
        if not inputs_valid(force_n, force_n, dt_s):
            return
        self._force[:] = force_n
        self._nis[0] = 0.0
        if self._predict(dt_s) is not Status.OK:
            self.reset(ResetReason.NUMERICS)
        elif (reason := fault_of(self._x, self._E, self._gated_s)) is not None:
            self.reset(reason)

    def estimate(self) -> SwingEstimate:
        """Return the state after the last step; the tension is the measured cable force along the estimated cable."""
        xi, zeta, xi_rate, zeta_rate = self._x.tolist()
        per_inertia = 1.0 / (self._mass_kg * self._length_m)
        stiffness = GRAVITY_MPS2 * (self._mass_kg + self._payload_mass_kg) * per_inertia
        x_rate = np.array(
            [
                xi_rate,
                zeta_rate,
                -stiffness * xi + per_inertia * self._force[1],
                -stiffness * zeta - per_inertia * self._force[0],
            ]
        )
        along = np.array([math.sin(zeta), -math.sin(xi) * math.cos(zeta), math.cos(xi) * math.cos(zeta)])
        P = np.zeros((7, 7))
        P[:4, :4] = self._E
        return SwingEstimate(
            np.concatenate([self._x, np.zeros(3)]), x_rate, P, float(self._nis[0]), float(along @ self._cable_force)
        )

    def reset(self, reason: ResetReason, force_n: tuple[float, float, float] | None = None) -> None:
        """Begin anew with the load at rest below; there is no state for a disturbance measured before."""
        self.resets[reason] += 1
        self._x[:] = 0.0
        self._E[:] = self._E_init
        self._cable_force[:] = self._weight
        self._nis[0] = 0.0
        self._gated_s = 0.0

    def _advance(self, acc_mps2: FloatArray, dt_s: float) -> Status:
        """Predict to the middle of the interval, correct, and predict to its end."""
        self._nis[0] = 0.0
        status = self._predict(0.5 * dt_s)
        if status is not Status.OK:
            return status
        measured = Status(kernels.synthetic_angles(self._angles, self._force, acc_mps2, self._mass_kg))
        if measured is Status.OK:
            measured = Status(
                kernels.correct(self._x, self._E, self._nis, self._angles, self._angle_var, self._nis_gate)
            )
        if measured not in (Status.OK, Status.GATED):
            return measured
        status = self._predict(0.5 * dt_s)
        return measured if status is Status.OK else status

    def _predict(self, dt_s: float) -> Status:
        kernels.transition(self._Phi, self._Gamma, self._mass_kg, self._payload_mass_kg, self._length_m, dt_s)
        fading = math.exp(-dt_s / self._memory_s)
        return Status(kernels.predict(self._x, self._E, self._force, self._Phi, self._Gamma, fading))
