"""One flight of the study: the load's trajectory, the vehicles' by inverse kinematics, and what it left behind."""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians, sqrt, tan

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.cooperative_flight import (
    GUST_PER_LOAD,
    NOISE_PER_CARRIER,
    CarrierLog,
    LoadLog,
    Reference,
    fly,
)
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.studies.cooperative import vehicles as v

DT_S = 0.001
"""Step of the plant."""
CONTROL_EVERY = 10
SAMPLE_S = DT_S * CONTROL_EVERY
"""Of autopilots, sensors and filters: 100 Hz."""

Course = Callable[[FloatArray], FloatArray]
"""Takes times (n,) and gives position (ned) and attitude (roll, pitch, yaw) of the load, (n, 6)."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """A manoeuvre of the load."""

    name: str
    title: str
    course: Course
    duration_s: float
    lean_rad: float = radians(12.0)
    """Of every tether, outwards: keeps the vehicles apart."""
    gust_force_n: float = 0.0
    """Deviation of the air's force on the load, each axis."""
    gust_moment_nm: float = 0.0
    gust_time_s: float = 0.4
    """Of its correlation."""
    pos_std_m: float = 0.0
    """White, of the position that the autopilots get."""
    vel_std_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class Flight:
    """Truth of one flight, a row for every sample."""

    scenario: Scenario
    log: FloatArray
    """(n, LoadLog.SIZE + 2 CarrierLog.SIZE)"""
    tensions_n: FloatArray
    """(n, 4)"""
    course: FloatArray
    """(n, 6) wanted position and attitude of the load."""

    @property
    def t_s(self) -> FloatArray:
        """(n,)"""
        return self.log[:, LoadLog.T]

    def load(self, first: LoadLog) -> FloatArray:
        """Return three columns of the load, (n, 3)."""
        return self.log[:, first : first + 3]

    def carrier(self, index: int, first: CarrierLog) -> FloatArray:
        """Return three columns of a vehicle, (n, 3)."""
        begin = LoadLog.SIZE + index * CarrierLog.SIZE + first
        return self.log[:, begin : begin + 3]

    def carrier_yaw_rad(self, index: int) -> FloatArray:
        """Return a vehicle's heading, (n,)."""
        return self.carrier(index, CarrierLog.EULER)[:, 2]

    def thrust_n(self, index: int) -> FloatArray:
        """Return a vehicle's thrust, mean over each sample, (n,)."""
        return self.log[:, LoadLog.SIZE + index * CarrierLog.SIZE + CarrierLog.THRUST]

    def winch_m(self, index: int) -> FloatArray:
        """Return what a vehicle's winch has turned, (n,)."""
        return self.log[:, LoadLog.SIZE + index * CarrierLog.SIZE + CarrierLog.WINCH]

    def hook_ned_m(self, index: int) -> FloatArray:
        """Return where a vehicle's tethers begin, (n, 3)."""
        rotation = rotations(self.carrier(index, CarrierLog.EULER))
        hook: FloatArray = self.carrier(index, CarrierLog.POS) + rotation @ np.array(v.HOOK_FRD_M)
        return hook

    def anchor_ned_m(self, index: int) -> FloatArray:
        """Return the middle between a vehicle's two anchors, (n, 3)."""
        place = np.array([0.0, v.SIDES[index] * v.HALF_SPAN_M, -v.ANCHOR_UP_M])
        anchor: FloatArray = self.load(LoadLog.POS) + rotations(self.load(LoadLog.EULER)) @ place
        return anchor

    def direction(self, index: int) -> FloatArray:
        """Return the unit vector from a vehicle's winch to the middle between its anchors, ned, (n, 3)."""
        line = self.anchor_ned_m(index) - self.hook_ned_m(index)
        unit: FloatArray = line / np.linalg.norm(line, axis=1, keepdims=True)
        return unit


def rotations(euler_rad: FloatArray) -> FloatArray:
    """Return the rotation matrices (n, 3, 3) of roll, pitch, yaw (n, 3)."""
    (s_r, s_p, s_y), (c_r, c_p, c_y) = np.sin(euler_rad).T, np.cos(euler_rad).T
    rows = [
        [c_p * c_y, s_r * s_p * c_y - c_r * s_y, c_r * s_p * c_y + s_r * s_y],
        [c_p * s_y, s_r * s_p * s_y + c_r * c_y, c_r * s_p * s_y - s_r * c_y],
        [-s_p, s_r * c_p, c_r * c_p],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def smooth(t_s: FloatArray, begin_s: float, duration_s: float) -> FloatArray:
    """Rise from 0 to 1 with speed and acceleration 0 at both ends (minimum jerk)."""
    s = np.clip((t_s - begin_s) / duration_s, 0.0, 1.0)
    rise: FloatArray = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    return rise


def references(course: FloatArray, lean_rad: float) -> FloatArray:
    """Place the vehicles over the load's course by inverse kinematics.

    Each winch's point stands where the load would be at rest with the wanted position and attitude, its tethers pulling
    outwards as those of a level load that lean by ``lean_rad``; velocity and acceleration are fed forward, the inward
    pull of the tethers as well.

    Parameters
    ----------
    course : (n, 6)
        Position (ned) and attitude of the load.
    lean_rad : float
        Of the tethers over a level load.

    Returns
    -------
    (n, 2 Reference.SIZE)
    """
    out = np.zeros((course.shape[0], v.CARRIERS * Reference.SIZE))
    pitches, index = np.unique(course[:, 4], return_inverse=True)
    winch = np.array([v.winch_for(float(pitch), lean_rad) for pitch in pitches])[index]
    shapes = [v.triangle(v.TETHER_M - w, v.TETHER_M + w) for w in winch.tolist()]
    under = np.array([shape.under(lean_rad) for shape in shapes])
    length = np.array(
        [sqrt((shape.ahead_m - shift) ** 2 + shape.height_m**2) for shape, shift in zip(shapes, under, strict=True)]
    )
    # A tether carries a quarter of the load's weight and stretches a little.
    weight_n = v.LOAD_MASS_KG * GRAVITY_MPS2
    length = length + 0.25 * weight_n / v.TETHER_STIFFNESS_N_PER_M
    # Statics in the plane across the heading: both pull outwards alike, the lower end carries more of the load.
    outward_n = 0.5 * weight_n * tan(lean_rad)
    more_right_n = -np.tan(course[:, 3]) * (v.ANCHOR_UP_M * weight_n / v.HALF_SPAN_M + 2.0 * outward_n)
    turned = rotations(course[:, 3:6])
    heading = rotations(np.column_stack([np.zeros((course.shape[0], 2)), course[:, 5]]))
    inward_mps2 = outward_n / (v.MASS_KG + 0.5 * v.LOAD_MASS_KG)
    for c in range(v.CARRIERS):
        side = v.SIDES[c]
        across = np.full_like(under, side * v.HALF_SPAN_M)
        anchor = course[:, :3] + np.einsum(
            "nij,nj->ni", turned, np.column_stack([under, across, np.full_like(under, -v.ANCHOR_UP_M)])
        )
        pull = np.column_stack(
            [np.zeros_like(under), np.full_like(under, side * outward_n), -0.5 * (weight_n + side * more_right_n)]
        )
        up = length[:, None] * pull / np.linalg.norm(pull, axis=1, keepdims=True)
        pos = anchor + np.einsum("nij,nj->ni", heading, up) - np.array(v.HOOK_FRD_M)
        vel = np.gradient(pos, SAMPLE_S, axis=0)
        block = out[:, c * Reference.SIZE : (c + 1) * Reference.SIZE]
        block[:, Reference.POS : Reference.POS + 3] = pos
        block[:, Reference.VEL : Reference.VEL + 3] = vel
        block[:, Reference.ACC : Reference.ACC + 3] = np.gradient(vel, SAMPLE_S, axis=0)
        block[:, Reference.ACC : Reference.ACC + 3] += heading @ np.array([0.0, side * inward_mps2, 0.0])
        block[:, Reference.YAW] = course[:, 5]
        block[:, Reference.WINCH] = winch
    return out


def run(scenario: Scenario, seed: int) -> Flight:
    """Fly a scenario once.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Of gusts and of what the autopilots get, >= 0.

    Raises
    ------
    StudyError
        If the flight diverges.
    """
    samples = round(scenario.duration_s / SAMPLE_S) + 1
    course = scenario.course(np.arange(samples, dtype=float) * SAMPLE_S)
    wanted = references(course, scenario.lean_rad)
    gust_seed, noise_seed = np.random.SeedSequence(seed).spawn(2)
    gusts = _gusts(np.random.default_rng(gust_seed), samples, scenario)
    noise = np.random.default_rng(noise_seed).standard_normal((samples, v.CARRIERS * NOISE_PER_CARRIER))
    begin = np.array([wanted[0, c * Reference.SIZE : c * Reference.SIZE + 3] for c in range(v.CARRIERS)])
    x = v.at_rest(begin, course[0, :3], float(course[0, 5]))
    log = np.empty((samples, LoadLog.SIZE + v.CARRIERS * CarrierLog.SIZE))
    tensions = np.empty((samples, 2 * v.CARRIERS))
    told = np.array([scenario.pos_std_m, scenario.vel_std_mps])
    machine = (v.parameters(), v.rotors(), v.tethers(), v.allocation(), v.cascade())
    rows = int(fly(log, tensions, x, *machine, wanted, gusts, noise, told, DT_S, CONTROL_EVERY))
    if rows < samples:
        raise StudyError(f"{scenario.name}, seed {seed}: the flight diverged; expected every state to stay finite")
    return Flight(scenario, log, tensions, course)


def wander(white: FloatArray, time_s: float) -> FloatArray:
    """Give Ornstein-Uhlenbeck processes of unit deviation (n, m) from standard normals, correlated over a time."""
    kept = float(np.exp(-SAMPLE_S / time_s))
    out = np.empty_like(white)
    out[0] = white[0]
    for row in range(1, white.shape[0]):
        out[row] = kept * out[row - 1] + sqrt(1.0 - kept * kept) * white[row]
    return out


def _gusts(rng: np.random.Generator, samples: int, scenario: Scenario) -> FloatArray:
    """Force and moment of the air on the load."""
    std = np.array([scenario.gust_force_n] * 3 + [scenario.gust_moment_nm] * 3)
    gusts: FloatArray = wander(rng.standard_normal((samples, GUST_PER_LOAD)), scenario.gust_time_s) * std
    return gusts
