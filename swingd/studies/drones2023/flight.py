"""One flight of the study: a scenario, the compiled closed loop, and what it left behind."""

from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np

from swingd.core.slung_flight import (
    NOISE_PER_SAMPLE,
    WHITE_PER_STEP,
    Feedback,
    FlightLog,
    FlightParam,
    Law,
    fly,
)
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.model.events import Vec3
from swingd.studies.drones2023.vehicles import Autopilot, Vehicle

DT_S = 0.002
"""Step of the plant: Runge-Kutta at 500 Hz."""


@dataclass(frozen=True, slots=True)
class Sensors:
    """White noise per sample, and the accelerometer's bias."""

    attitude_rad: float
    rate_radps: float
    acc_mps2: float
    acc_bias_frd_mps2: Vec3
    pos_xy_m: float
    pos_z_m: float
    vel_xy_mps: float
    vel_z_mps: float


@dataclass(frozen=True, slots=True)
class Filters:
    """Both filters' settings."""

    load_mass_kg: float
    """As the filters assume it."""
    ekf_initial_var: tuple[float, ...]
    """7 variances."""
    ekf_process_noise: tuple[float, ...]
    """7 densities."""
    ekf_measurement_noise: float
    ekf_scheme: int
    """-1: Runge-Kutta of mean and covariance, else a `swingd.core.swing_ekf.Scheme`."""
    fgdf_initial_var: tuple[float, float, float, float]
    fgdf_angle_var: float
    fgdf_fading: float
    every: int
    """Steps of the plant between two of the filters', a multiple of the autopilot's."""


@dataclass(frozen=True, slots=True)
class Wind:
    """Steady wind, and turbulence along an axis of its own."""

    steady_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    at_6m_mps: float = 0.0
    """Sets the turbulence's strength; 0: none."""
    to_rad: float = 0.0
    """Direction that the wind of the turbulence blows to."""
    field_speed_mps: float = 10.0
    """Added to the vehicle's speed through the frozen field."""
    span_m: float = 1.0
    load_span_m: float = 1.0


@dataclass(frozen=True, slots=True)
class LawSettings:
    """What answers the swing, and what it listens to."""

    law: Law = Law.NONE
    feedback: Feedback = Feedback.EKF
    kp: float = 0.0
    """Of (16) [m/s^2/rad]; of the placed law, times the cable's length [m/s^2]."""
    kd: float = 0.0
    washout_s: float = inf
    leak_s: float = 1.0
    acc_max_mps2: float = inf
    jerk_max_mps3: float = inf
    vel_max_mps: float = inf
    pos_max_m: float = inf


@dataclass(frozen=True, slots=True)
class Scenario:
    """A manoeuvre of one vehicle."""

    name: str
    vehicle: Vehicle
    autopilot: Autopilot
    sensors: Sensors
    filters: Filters
    start_ned_m: Vec3
    references: tuple[tuple[float, float, float, float], ...]
    """Time [s], position [m] or velocity [m/s]."""
    by_velocity: bool
    duration_max_s: float
    control_every: int
    """Steps of the plant between two of the autopilot's."""
    yaw_rad: float = 0.0
    swing_rad: tuple[float, float] = (0.0, 0.0)
    """xi, zeta at the start."""
    wind: Wind = field(default_factory=Wind)
    accept_radius_m: float = 0.0
    stop_distance_m: float = inf
    stop_chi_rad: float = 0.0
    stop_for_s: float = inf
    stop_after_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Flight:
    """The log of one flight."""

    scenario: Scenario
    law: LawSettings
    log: FloatArray
    """(n, FlightLog.SIZE)"""
    finished: bool
    """Whether the stop criterion ended it."""

    def column(self, first: FlightLog, count: int = 1) -> FloatArray:
        """Return one column (n,), or ``count`` of them (n, count)."""
        return self.log[:, first] if count == 1 else self.log[:, first : first + count]

    @property
    def t_s(self) -> FloatArray:
        """(n,)"""
        return self.column(FlightLog.T)

    @property
    def duration_s(self) -> float:
        """Manoeuvre time t_m."""
        return float(self.log[-1, FlightLog.T])


def run(scenario: Scenario, law: LawSettings, seed: int) -> Flight:
    """Fly a scenario once.

    Parameters
    ----------
    scenario : Scenario
    law : LawSettings
    seed : int
        Of sensors and gusts, >= 0; the same seed gives every law the same weather and the same noise.

    Raises
    ------
    StudyError
        If a filter or the plant diverges.
    """
    samples = round(scenario.duration_max_s / (DT_S * scenario.control_every)) + 1
    sensors_seed, gusts_seed = np.random.SeedSequence(seed).spawn(2)
    noise = np.random.default_rng(sensors_seed).standard_normal((samples, NOISE_PER_SAMPLE))
    gusts = samples * scenario.control_every if scenario.wind.at_6m_mps > 0.0 else 1
    white = np.random.default_rng(gusts_seed).standard_normal((gusts, WHITE_PER_STEP))
    log = np.empty((samples, FlightLog.SIZE))
    vehicle = scenario.vehicle
    x = vehicle.hovering(scenario.start_ned_m, scenario.yaw_rad, *scenario.swing_rad)
    rows = int(
        fly(
            log,
            x,
            vehicle.packed(),
            vehicle.rotor_table(),
            vehicle.allocation(),
            scenario.autopilot.packed(vehicle, scenario.start_ned_m[2]),
            _packed(scenario, law),
            np.array(scenario.references, dtype=float),
            noise,
            white,
        )
    )
    if rows < 0:
        raise StudyError(f"{scenario.name}, seed {seed}: the flight diverged; expected every state to stay finite")
    return Flight(scenario, law, log[:rows].copy(), rows < samples)


def _packed(scenario: Scenario, law: LawSettings) -> FloatArray:
    s, filters, wind, vehicle = scenario.sensors, scenario.filters, scenario.wind, scenario.vehicle
    values: dict[FlightParam, Any] = {
        FlightParam.DT: DT_S,
        FlightParam.CONTROL_EVERY: scenario.control_every,
        FlightParam.FILTER_EVERY: filters.every,
        FlightParam.YAW: scenario.yaw_rad,
        FlightParam.BY_VELOCITY: scenario.by_velocity,
        FlightParam.ACCEPT_RADIUS: scenario.accept_radius_m,
        FlightParam.STOP_DISTANCE: scenario.stop_distance_m,
        FlightParam.STOP_CHI: scenario.stop_chi_rad,
        FlightParam.STOP_FOR: scenario.stop_for_s,
        FlightParam.STOP_AFTER: scenario.stop_after_s,
        FlightParam.WIND: wind.steady_ned_mps,
        FlightParam.TURBULENCE_WIND: wind.at_6m_mps,
        FlightParam.TURBULENCE_TO: wind.to_rad,
        FlightParam.TURBULENCE_SPEED: wind.field_speed_mps,
        FlightParam.SPAN: wind.span_m,
        FlightParam.LOAD_SPAN: wind.load_span_m,
        FlightParam.ATTITUDE_STD: s.attitude_rad,
        FlightParam.RATE_STD: s.rate_radps,
        FlightParam.ACC_STD: s.acc_mps2,
        FlightParam.ACC_BIAS: s.acc_bias_frd_mps2,
        FlightParam.POS_STD_XY: s.pos_xy_m,
        FlightParam.POS_STD_Z: s.pos_z_m,
        FlightParam.VEL_STD_XY: s.vel_xy_mps,
        FlightParam.VEL_STD_Z: s.vel_z_mps,
        FlightParam.LAW: law.law,
        FlightParam.FEEDBACK: law.feedback,
        FlightParam.KP: law.kp,
        FlightParam.KD: law.kd,
        FlightParam.WASHOUT: law.washout_s,
        FlightParam.LEAK: law.leak_s,
        FlightParam.ACC_MAX: law.acc_max_mps2,
        FlightParam.JERK_MAX: law.jerk_max_mps3,
        FlightParam.VEL_MAX: law.vel_max_mps,
        FlightParam.POS_MAX: law.pos_max_m,
        FlightParam.FILTER_MASS: vehicle.mass_kg,
        FlightParam.FILTER_LOAD_MASS: filters.load_mass_kg,
        FlightParam.FILTER_LENGTH: vehicle.cable_length_m,
        FlightParam.EKF_P0: filters.ekf_initial_var,
        FlightParam.EKF_Q: filters.ekf_process_noise,
        FlightParam.EKF_R: filters.ekf_measurement_noise,
        FlightParam.EKF_SCHEME: filters.ekf_scheme,
        FlightParam.FGDF_E0: filters.fgdf_initial_var,
        FlightParam.FGDF_R: filters.fgdf_angle_var,
        FlightParam.FGDF_FADING: filters.fgdf_fading,
    }
    packed = np.full(FlightParam.SIZE, np.nan)
    for first, value in values.items():
        flat = np.atleast_1d(np.asarray(value, dtype=float))
        packed[first : first + flat.size] = flat
    assert not np.isnan(packed).any()
    return packed
