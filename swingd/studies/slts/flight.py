"""One flight of the study: a path, the compiled closed loop, and what it left behind."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.multirotor import Rotor
from swingd.core.path_following import PathTerm
from swingd.core.slts_flight import NOISE_PER_STEP, WHITE_PER_STEP, fly
from swingd.core.slts_flight_layout import Feedback, SltsFlightLog, SltsFlightParam
from swingd.estimation.acceleration_model import NOTHING_LEARNED, Prepared
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.studies.slts.cases import Scenario

DT_S = 0.002
"""Step of the plant: Runge-Kutta at 500 Hz."""
OUTER_EVERY = 5
"""Filters and path following at 100 Hz."""
_FAILED = {-1: "the plant diverged", -2: "a filter failed", -3: "the path following failed"}


@dataclass(frozen=True, slots=True)
class Flight:
    """The log of one flight."""

    scenario: Scenario
    log: FloatArray
    """(n, SltsFlightLog.SIZE)"""

    def column(self, first: int, count: int = 1) -> FloatArray:
        """Return one column (n,), or ``count`` of them (n, count)."""
        return self.log[:, first] if count == 1 else self.log[:, first : first + count]

    def term(self, first: PathTerm, count: int = 3) -> FloatArray:
        """Return a term of the path following."""
        return self.column(SltsFlightLog.TERMS + first, count)

    @property
    def t_s(self) -> FloatArray:
        """(n,)"""
        return self.column(SltsFlightLog.T)


def run(scenario: Scenario, seed: int, gp: Prepared = NOTHING_LEARNED, feedback: Feedback = Feedback.GP_EKF) -> Flight:
    """Fly a scenario once.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Of sensors, camera and gusts, >= 0.
    gp : Prepared
        Of the GP-EKF; the plain EKF flies along.
    feedback : Feedback
        What the loop is closed on.

    Raises
    ------
    StudyError
        If anything diverges, or the last waypoint is not reached.
    """
    rows = round(scenario.duration_max_s / (DT_S * OUTER_EVERY))
    steps = rows * OUTER_EVERY
    sensors_seed, camera_seed, gusts_seed = np.random.SeedSequence(seed).spawn(3)
    noise = np.random.default_rng(sensors_seed).standard_normal((steps, NOISE_PER_STEP))
    gusts = steps if scenario.turbulence_6m_mps > 0.0 else 1
    white = np.random.default_rng(gusts_seed).standard_normal((gusts, WHITE_PER_STEP))
    camera = _pictures(scenario, np.random.default_rng(camera_seed))
    vehicle = scenario.vehicle
    rotors = vehicle.rotor_table()
    weaker = rotors.copy()
    weaker[:, Rotor.THRUST] *= scenario.thrust_factor
    load = np.array(scenario.start_ned_m or scenario.waypoints_ned_m[0])
    stretch_m = vehicle.load_mass_kg * GRAVITY_MPS2 / vehicle.cable_stiffness_n_per_m
    load[2] -= vehicle.hook_frd_m[2] + vehicle.cable_length_m + stretch_m
    x = vehicle.hovering((float(load[0]), float(load[1]), float(load[2])), scenario.yaw_rad, 0.0, 0.0)
    log = np.full((rows, SltsFlightLog.SIZE), np.nan)
    written = int(
        fly(
            log, x, vehicle.packed(), weaker, rotors, vehicle.allocation(), _flight_parameters(scenario, feedback),
            scenario.path.packed(), scenario.filters.packed(gp.load_share),
            np.array(scenario.waypoints_ned_m, dtype=float),
            gp.Z, gp.weights, gp.K_inv, gp.inv_sq_scales, gp.signal_var, noise, camera, white,
        )
    )  # fmt: skip
    if written < 0:
        raise StudyError(f"{scenario.name}, seed {seed}: {_FAILED[written]}")
    if written == rows:
        raise StudyError(f"{scenario.name}, seed {seed}: not at the last waypoint after {scenario.duration_max_s:g} s")
    return Flight(scenario, log[:written])


def _flight_parameters(scenario: Scenario, feedback: Feedback) -> FloatArray:
    vehicle, attitude, sensors = scenario.vehicle, scenario.attitude, scenario.sensors
    index = SltsFlightParam
    inertia = vehicle.inertia_kg_m2[0][0]
    # A small turn is half of e_r: b_r gives half of the stiffness.
    b_r = 0.5 * inertia * attitude.frequency_radps**2
    return _pack(
        index.SIZE,
        {
            index.DT: DT_S,
            index.OUTER_EVERY: OUTER_EVERY,
            index.FEEDBACK: feedback,
            index.YAW: scenario.yaw_rad,
            index.STOP_AFTER: scenario.hold_s,
            index.BELIEVED_LAG: vehicle.rotor_lag_s,
            index.BELIEVED_DENSITY_RATIO: vehicle.density_ratio(scenario.waypoints_ned_m[0][2]),
            index.ROTOR_THRUST_MAX: vehicle.rotor_thrust_max_n,
            index.B_R: b_r,
            index.B_OMEGA: 2.0 * attitude.damping * inertia * attitude.frequency_radps,
            index.RATE_D_LAG: 0.05,
            index.WIND: scenario.wind_ned_mps,
            index.TURBULENCE_WIND: scenario.turbulence_6m_mps,
            index.SPAN: 0.5,
            index.LOAD_SPAN: 0.15,
            index.TILT_STD: sensors.tilt_std_rad,
            index.TILT_TIME: sensors.tilt_time_s,
            index.GYRO_STD: sensors.gyro_radps,
            index.ACC_STD: sensors.acc_mps2,
            index.ACC_BIAS: sensors.acc_bias_frd_mps2,
            index.POS_STD: sensors.pos_std_m,
            index.VEL_STD: sensors.vel_std_mps,
            index.GNSS_TIME: sensors.gnss_time_s,
            index.GNSS_SMOOTHING: sensors.gnss_smoothing_s,
            index.GNSS_EVERY: round(1.0 / (sensors.gnss_hz * DT_S)),
            index.GNSS_DELAY: round(sensors.gnss_delay_s / DT_S),
            index.CAMERA_PERIOD: 1.0 / sensors.camera_hz,
            index.CAMERA_DELAY: round(sensors.camera_delay_s / DT_S),
            index.CAMERA_STD: sensors.camera_std_m,
            index.CAMERA_STD_SHARE: sensors.camera_std_share,
            index.CAMERA_HALF_ANGLE: sensors.camera_half_angle_rad,
            index.FILTER_POS_STD: scenario.pos_std_m,
            index.FILTER_VEL_STD: scenario.vel_std_mps,
            index.P0: np.square(scenario.filters.initial_std),
        },
    )


def _pack(size: int, values: Mapping[int, Any]) -> FloatArray:
    packed = np.full(size, np.nan)
    for first, value in values.items():
        flat = np.atleast_1d(np.asarray(value, dtype=float))
        packed[first : first + flat.size] = flat
    assert not np.isnan(packed).any()
    return packed


def _pictures(scenario: Scenario, generator: np.random.Generator) -> FloatArray:
    """Whether each picture is taken, and its noise; dropouts begin at random and last as long as given."""
    sensors = scenario.sensors
    count = round(scenario.duration_max_s * sensors.camera_hz) + 1
    camera = np.empty((count, 4))
    camera[:, 1:] = generator.standard_normal((count, 3))
    camera[:, 0] = 1.0
    # Between two dropouts an exponential time passes, such that they take their share.
    mean_between_s = sensors.dropout_s * (1.0 / sensors.dropout_share - 1.0) if sensors.dropout_share > 0.0 else inf
    t_s = generator.exponential(mean_between_s)
    while t_s < scenario.duration_max_s:
        first = round(t_s * sensors.camera_hz)
        camera[first : first + round(sensors.dropout_s * sensors.camera_hz), 0] = 0.0
        t_s += sensors.dropout_s + generator.exponential(mean_between_s)
    return camera
