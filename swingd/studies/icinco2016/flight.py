"""One flight of the study: a scenario, the compiled closed loop, and what it left behind."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.planar_flight import NOISE_PER_SAMPLE, PlanarFlightLog, PlanarFlightParam, Reference, fly
from swingd.core.planar_rotorcraft import PlanarInput, PlanarParam, PlanarState
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.studies.icinco2016 import paper

STEPS = 2
"""Of the plant in a sample: Runge-Kutta at 200 Hz."""


@dataclass(frozen=True, slots=True)
class Gains:
    """Of both layers; kp [1/s^2], kd [1/s]."""

    kp: float
    kd: float
    kp_pitch: float
    kd_pitch: float


@dataclass(frozen=True, slots=True)
class Compensation:
    """In which layers the estimated disturbance is taken out."""

    translational: bool
    rotational: bool


@dataclass(frozen=True, slots=True)
class Scenario:
    """A task of one vehicle."""

    name: str
    gains: Gains
    circle_hz: float = 0.0
    """Turns of the circle in a second; 0: regulation to a point."""
    circle_height_m: float = 0.0
    """Of its centre."""
    torque_nm: float = 0.0
    """u_gamma from `paper.TORQUE_AT_S` on, on the rod from the airframe."""
    torque_for_s: float = 0.0
    hook_m: tuple[float, float] = (0.0, 0.0)
    """From the centre of gravity, forward and up."""
    initial_var: tuple[float, float, float] = (1e-3, 1e-3, 1.0)
    """P_0 of every axis."""
    tilt_max_rad: float = pi / 3.0
    up_min_share: float = 0.2
    """Least wanted force upwards over the vehicle's weight."""
    told_wanted: bool = False
    """Whether the filters are told the wanted force instead of the thrust as the vehicle leans."""


@dataclass(frozen=True, slots=True)
class Flight:
    """The log of one flight."""

    scenario: Scenario
    compensation: Compensation
    log: FloatArray
    """(n, PlanarFlightLog.SIZE)"""

    def column(self, first: int, count: int = 1) -> FloatArray:
        """Return one column (n,), or ``count`` of them (n, count)."""
        return self.log[:, first] if count == 1 else self.log[:, first : first + count]

    @property
    def t_s(self) -> FloatArray:
        """(n,)"""
        return self.column(PlanarFlightLog.T)

    @property
    def error_m(self) -> FloatArray:
        """True position minus wanted, x and z, (n, 2)."""
        return self.column(PlanarFlightLog.STATE, 2) - self.column(PlanarFlightLog.POS_SP, 2)


def run(scenario: Scenario, compensation: Compensation, seed: int) -> Flight:
    """Fly a scenario once.

    Parameters
    ----------
    scenario : Scenario
    compensation : Compensation
    seed : int
        Of the sensors' noise, >= 0; the same for every compensation.

    Raises
    ------
    StudyError
        If a filter or the plant diverges.
    """
    t_s: FloatArray = paper.DT_S * np.arange(round(paper.DURATION_S / paper.DT_S) + 1, dtype=float)
    reference = _reference(scenario, t_s)
    outside = np.zeros((t_s.size, PlanarInput.SIZE))
    acts = (t_s >= paper.TORQUE_AT_S) & (t_s < paper.TORQUE_AT_S + scenario.torque_for_s)
    outside[acts, PlanarInput.ROD_TORQUE] = scenario.torque_nm
    noise = np.random.default_rng(seed).standard_normal((t_s.size, NOISE_PER_SAMPLE))
    x = np.zeros(PlanarState.SIZE)
    if scenario.circle_hz > 0.0:
        x[PlanarState.X], x[PlanarState.Z] = reference[0, Reference.X], reference[0, Reference.Z]
    log = np.empty((t_s.size, PlanarFlightLog.SIZE))
    rows = fly(log, x, _vehicle(scenario), _described(scenario, compensation), reference, outside, noise)
    if rows < 0:
        raise StudyError(f"{scenario.name}, seed {seed}: the flight diverged; expected every state to stay finite")
    return Flight(scenario, compensation, log)


def _reference(scenario: Scenario, t_s: FloatArray) -> FloatArray:
    """Sample the point or the circle, and how the thrust that flies it undisturbed turns."""
    reference = np.zeros((t_s.size, Reference.SIZE))
    if scenario.circle_hz == 0.0:
        reference[:, Reference.X], reference[:, Reference.Z] = paper.TARGET_M
        return reference
    rate = 2.0 * pi * scenario.circle_hz
    s, c = paper.RADIUS_M * np.sin(rate * t_s), paper.RADIUS_M * np.cos(rate * t_s)
    reference[:, Reference.X : Reference.X + 3] = np.stack([s, rate * c, -rate * rate * s], axis=1)
    height = scenario.circle_height_m + c
    reference[:, Reference.Z : Reference.Z + 3] = np.stack([height, -rate * s, -rate * rate * c], axis=1)
    pitch = np.arctan2(reference[:, Reference.X + 2], reference[:, Reference.Z + 2] + GRAVITY_MPS2)
    pitch_rate = np.gradient(pitch, paper.DT_S)
    reference[:, Reference.PITCH_RATE] = pitch_rate
    reference[:, Reference.PITCH_RATE + 1] = np.gradient(pitch_rate, paper.DT_S)
    return reference


def _vehicle(scenario: Scenario) -> FloatArray:
    p = np.zeros(PlanarParam.SIZE)
    p[PlanarParam.MASS] = paper.MASS_KG
    p[PlanarParam.INERTIA] = paper.INERTIA_KG_M2
    p[PlanarParam.LOAD_MASS] = paper.LOAD_MASS_KG
    p[PlanarParam.ROD_LENGTH] = paper.ROD_LENGTH_M
    p[PlanarParam.HOOK : PlanarParam.HOOK + 2] = scenario.hook_m
    return p


def _described(scenario: Scenario, compensation: Compensation) -> FloatArray:
    gains = scenario.gains
    values: list[tuple[int, Sequence[float]]] = [
        (PlanarFlightParam.DT, [paper.DT_S]),
        (PlanarFlightParam.STEPS, [STEPS]),
        (PlanarFlightParam.GAINS, [gains.kp, gains.kd, gains.kp, gains.kd, gains.kp_pitch, gains.kd_pitch]),
        (PlanarFlightParam.COMPENSATE_TRANSLATION, [compensation.translational]),
        (PlanarFlightParam.COMPENSATE_ROTATION, [compensation.rotational]),
        (PlanarFlightParam.TILT_MAX, [scenario.tilt_max_rad]),
        (PlanarFlightParam.UP_MIN, [scenario.up_min_share * paper.MASS_KG * GRAVITY_MPS2]),
        (PlanarFlightParam.PROCESS_DENSITY, [paper.PROCESS_DENSITY] * 3),
        (PlanarFlightParam.INITIAL_VAR, scenario.initial_var),
        (PlanarFlightParam.POS_VAR, [paper.SENSOR_VAR] * 3),
        (PlanarFlightParam.VEL_VAR, [paper.SENSOR_VAR] * 3),
        (PlanarFlightParam.TOLD_WANTED, [scenario.told_wanted]),
    ]
    f = np.full(PlanarFlightParam.SIZE, np.nan)
    for first, numbers in values:
        f[first : first + len(numbers)] = numbers
    assert not np.isnan(f).any()
    return f
