"""The paper's own estimator on a vehicle's measurements: the UKF on inclination and azimuth, (12)-(21)."""

from dataclasses import dataclass

import numpy as np

from swingd.core import tether_angles as kernels
from swingd.core.status import Status
from swingd.core.tether_angles import TetherModel
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray

ANGLE_STD_INIT_RAD = 0.1
RATE_STD_INIT_RADPS = 0.1


@dataclass(frozen=True, slots=True)
class AngleNoise:
    """Design parameters as Tables 1 and 2 print them."""

    sigma_theta: float
    """Deviation of the noise acceleration of the inclination [rad/s^2]."""
    sigma_phi: float
    """Of the azimuth."""
    var_theta: float
    """R, variance of one observed inclination [rad^2]."""
    var_phi: float


@dataclass(frozen=True, slots=True)
class AngleTrack:
    """What the filter says at the end of each sample."""

    state: FloatArray
    """(n, 4) theta, its rate, azimuth from the nose to the right, its rate; nan from where the filter failed on."""
    direction: FloatArray
    """(n, 3) unit vector from the vehicle to the load, heading frame."""
    observed: FloatArray
    """(n, 2) inclination and azimuth that the cable force shows, heading frame."""


def track(
    thrust_n: FloatArray,
    acc_mps2: FloatArray,
    cable_n: FloatArray,
    yaw_rad: FloatArray,
    noise: AngleNoise,
    model: TetherModel,
    rotating: bool,
    length_m: float,
    mass_kg: float,
    dt_s: float,
) -> AngleTrack:
    """Run the filter over a flight.

    Parameters
    ----------
    thrust_n, acc_mps2, cable_n : (n, 3)
        Thrust R_f F_f, acceleration a_d of the vehicle and pull -F_s of the cable on it, of each sample, in its heading
        frame.
    yaw_rad : (n,)
        Heading of the vehicle.
    noise : AngleNoise
    model : TetherModel
    rotating : bool
        With the centrifugal and Coriolis terms.
    length_m, mass_kg, dt_s : float
        Tether, vehicle, sample.

    Raises
    ------
    StudyError
        If the filter fails on another model than the printed one, whose failing is its result.
    """
    n = cable_n.shape[0]
    observed, state, direction = np.empty((n, 2)), np.full((n, 4), np.nan), np.full((n, 3), np.nan)
    for row in range(n):
        kernels.observed_angles(observed[row], np.ascontiguousarray(cable_n[row]))
    x = np.array([observed[0, 0], 0.0, observed[0, 1], 0.0])
    P = np.diag([ANGLE_STD_INIT_RAD**2, RATE_STD_INIT_RADPS**2] * 2)
    sigma, R = np.array([noise.sigma_theta, noise.sigma_phi]), np.array([noise.var_theta, noise.var_phi])
    relative, rates = np.zeros(3), np.empty(4)
    driving = thrust_n - mass_kg * acc_mps2 if model is TetherModel.PRINTED else acc_mps2
    driving = np.ascontiguousarray(driving)
    yaw_rate = np.gradient(np.unwrap(yaw_rad), dt_s)
    turn = np.ascontiguousarray(np.column_stack([yaw_rate, np.gradient(yaw_rate, dt_s)]))
    for row in range(n):
        way = (sigma, dt_s, 1.0 / length_m, mass_kg, int(model), int(rotating))
        status = Status(kernels.predict(x, P, relative, driving[row], turn[row], rates, *way))
        if status is Status.OK:
            status = Status(kernels.correct(x, P, observed[row], R))
        if status is not Status.OK:
            if model is TetherModel.PRINTED:
                break
            raise StudyError(f"the filter on angles failed in sample {row}: {status.name}; expected OK")
        state[row] = x
        kernels.direction(direction[row], x)
    return AngleTrack(state, direction, observed)
