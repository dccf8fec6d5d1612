"""Direction of one tether by the unscented filter on the sphere, whoever else holds the load."""

import copy
import math

import numpy as np

from swingd.core import tether_ukf as kernels
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status
from swingd.model.estimate import FloatArray

STEP_MAX_S = 0.02
"""Longer intervals are divided: a thirtieth of the period of a tether of 0.1 m."""
FORCE_MIN_N = 1e-9
"""A smaller cable force has no direction."""


PULL_STD_MIN_MPS2 = 1e-6
"""A pull that is certain still needs a root of its variance."""


class TetherDirection:
    """Unit vector from the vehicle to the load and its derivative, from the force that the cable shows.

    Finite and consistent through the vertical, where inclination and azimuth are not: see `swingd.core.tether_ukf`.

    Parameters
    ----------
    length_m : float
        Tether below a moving vehicle [m]; infinite for the random acceleration of (13) instead of a pendulum.
    acc_density : float
        Density of the noise acceleration across the tether [rad/s/sqrt(s)]: what the model leaves out.
    angle_std_init_rad, rate_std_init_radps : float
        Deviations of direction and rate at a start.
    pull_density : float
        Random walk of the pull with which others hold the same load, over its mass [m/s^2/sqrt(s)]; 0: nobody does.
    pull_std_init_mps2 : float
        Its deviation at a start.
    """

    def __init__(
        self,
        length_m: float,
        acc_density: float,
        angle_std_init_rad: float,
        rate_std_init_radps: float,
        pull_density: float = 0.0,
        pull_std_init_mps2: float = PULL_STD_MIN_MPS2,
    ) -> None:
        self._inv_length = 1.0 / length_m
        self._acc_var_s = acc_density**2
        self._pull_var_per_s = pull_density**2
        std = [angle_std_init_rad] * 2 + [rate_std_init_radps] * 2 + [max(pull_std_init_mps2, PULL_STD_MIN_MPS2)] * 2
        self._P_init = np.diag(np.square(std))
        self._x = np.empty(kernels.TetherState.SIZE)
        self._P = np.empty((kernels.NUM_ERRORS, kernels.NUM_ERRORS))
        self._R = np.empty((2, 2))
        self._nis = np.zeros(1)
        self._pivot_acc = np.zeros(3)
        self._scratch = np.empty(4)
        self.reset()

    def reset(self, direction: FloatArray | None = None) -> None:
        """Begin anew at rest, straight down or along ``direction`` (3,), held there by others."""
        kernels.hang(self._x)
        if direction is not None:
            error = np.zeros(kernels.NUM_ERRORS)
            kernels.angle_to(error[:2], self._x, direction)
            kernels.moved(self._x, self._x.copy(), error)
            if self._pull_var_per_s > 0.0:
                self._x[9:11] = GRAVITY_MPS2 / max(self._x[2], 0.1) * self._x[:2]
        self._P[:] = self._P_init
        self._nis[0] = 0.0
        self._pivot_acc[:] = 0.0

    def predict(self, pivot_acc: FloatArray, dt_s: float) -> Status:
        """Advance without a measurement.

        Parameters
        ----------
        pivot_acc : (3,)
            Mean inertial acceleration of the upper end, level frame [m/s^2]; not used with an infinite length.
        dt_s : float
            Interval [s], > 0.
        """
        self._pivot_acc[:] = pivot_acc
        steps = math.ceil(dt_s / STEP_MAX_S)
        step_s = dt_s / steps
        for _ in range(steps):
            status = Status(
                kernels.predict(
                    self._x, self._P, self._pivot_acc, self._inv_length, self._acc_var_s / step_s,
                    self._pull_var_per_s * step_s, step_s,
                )
            )  # fmt: skip
            if status is not Status.OK:
                return status
        return Status.OK

    def correct(self, force_n: FloatArray, force_cov: FloatArray, nis_gate: float = math.inf) -> Status:
        """Correct by a cable force.

        Parameters
        ----------
        force_n : (3,)
            Pull of the cable on the vehicle, level frame: along the tether, hook to load [N].
        force_cov : (3, 3)
            Covariance of its noise, positive definite [N^2].
        nis_gate : float
            A normalised innovation squared above it is left out.

        Returns
        -------
        Status
            ``OK``; ``GATED`` by the gate or where the force vanishes and has no direction; else a failure that left
            the state as it was.
        """
        self._nis[0] = 0.0
        if not math.hypot(*force_n) > FORCE_MIN_N:
            return Status.GATED
        kernels.direction_noise(self._R, self._x, force_n, force_cov)
        return Status(kernels.correct(self._x, self._P, self._nis, force_n, self._R, nis_gate))

    def ahead(self, dt_s: float) -> "TetherDirection":
        """Give the tether as it will be, the pivot's acceleration held: what a known delay of the inputs asks for."""
        later = copy.copy(self)
        later._x, later._P, later._pivot_acc = self._x.copy(), self._P.copy(), self._pivot_acc.copy()
        if dt_s > 0.0 and later.predict(self._pivot_acc, dt_s) is not Status.OK:
            return self
        return later

    @property
    def direction(self) -> FloatArray:
        """(3,) unit vector from the vehicle to the load, level frame."""
        return self._x[:3].copy()

    @property
    def rate(self) -> FloatArray:
        """(3,) its derivative [1/s]."""
        return self._x[3:6].copy()

    @property
    def direction_cov(self) -> FloatArray:
        """(3, 3) covariance of the unit vector, of rank 2, level frame."""
        nx, ny, nz, *_ = self._x.tolist()
        ex, ey, ez = self._x[6:9].tolist()
        across = np.array([[ex, ny * ez - nz * ey], [ey, nz * ex - nx * ez], [ez, nx * ey - ny * ex]])
        cov: FloatArray = across @ self._P[:2, :2] @ across.T
        return cov

    @property
    def error_cov(self) -> FloatArray:
        """(6, 6) covariance of angle and rate across the tether and of the pull of others."""
        return self._P.copy()

    @property
    def pull_mps2(self) -> FloatArray:
        """(2,) horizontal pull of others on the load over its mass, level frame."""
        return self._x[9:11].copy()

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last correction, 2 degrees of freedom; 0 before the first."""
        return float(self._nis[0])

    def spherical(self) -> tuple[float, float, float, float]:
        """Give inclination and azimuth with their rates, (12); azimuth from x to y, 0 where the tether is vertical."""
        kernels.spherical(self._scratch, self._x)
        theta, theta_rate, phi, phi_rate = self._scratch.tolist()
        return theta, theta_rate, phi, phi_rate

    def swing(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Give xi, zeta and their rates (4,), the derivative of that (4,), and their covariance (4, 4)."""
        swing, rate, cov = np.empty(4), np.empty(4), np.zeros((4, 4))
        kernels.swing_angles(swing, self._x)
        kernels.swing_rates(rate, self._x, self._pivot_acc, self._inv_length)
        kernels.swing_covariance(cov, self._x, self._P)
        return swing, rate, cov
