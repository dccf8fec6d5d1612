"""Two quadrotors, a box and four tethers: Table 1 of the paper, and what it does not print."""

from dataclasses import dataclass
from math import atan2, cos, sin, sqrt

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.cooperative_plant import (
    FIRST_CARRIER,
    BodyState,
    CarrierState,
    CooperativeParam,
    Tether,
)
from swingd.core.multirotor import Rotor
from swingd.core.px4_cascade import CascadeParam
from swingd.model.estimate import FloatArray

CARRIERS = 2
MASS_KG = 1.64
LOAD_MASS_KG = 0.5
BOX_M = (0.2, 0.4, 0.2)
"""Along the load's forward, right and down axes: a vehicle at each end of the long one."""
TETHER_M = 1.2
EDGE_M = BOX_M[0]
"""Between the two anchors of a vehicle."""
HALF_SPAN_M = 0.5 * BOX_M[1]
ANCHOR_UP_M = 0.5 * BOX_M[2]
"""Of the anchors over the load's CG."""
SIDES = (-1.0, 1.0)
"""Where each vehicle flies: left of the load, right of it."""

# What the paper does not print: parts of such vehicles.
INERTIA_KG_M2 = (0.016, 0.016, 0.028)
ARM_M = 0.22
ROTOR_THRUST_N_S2 = 1.2e-5
ROTOR_TORQUE_NM_S2 = 1.8e-7
ROTOR_THRUST_MAX_N = 11.0
ROTOR_LAG_S = 0.03
DRAG_N_PER_MPS = 0.15
HOOK_FRD_M = (0.0, 0.0, 0.05)
"""Both tethers of a vehicle leave its winch at one point."""
TETHER_STIFFNESS_N_PER_M = 1500.0
TETHER_DAMPING_NS_PER_M = 3.0
LOAD_DRAG_N_PER_MPS2 = 0.5 * 1.2 * 1.1 * 0.06
LOAD_RATE_DRAG_NM_PER_RADPS = 0.002


@dataclass(frozen=True, slots=True)
class Triangle:
    """The winch's point and the two anchors of a vehicle, in the plane of the two tethers."""

    ahead_m: float
    """Of the winch's point from the middle of the edge."""
    height_m: float
    """Of the winch's point over the edge."""

    @property
    def middle_m(self) -> float:
        """From the winch's point to the middle of the edge: the paper's tether."""
        return sqrt(self.ahead_m**2 + self.height_m**2)

    def under(self, lean_rad: float = 0.0) -> float:
        """Where the line from the winch's point to the load's CG meets the edge, from its middle [m].

        Two tethers from one point pull the load along lines through it, and at rest their sum passes the CG: there the
        force points, not to the middle.
        """
        return self.ahead_m * ANCHOR_UP_M / (self.height_m * cos(lean_rad) + ANCHOR_UP_M)

    def pitch_rad(self, lean_rad: float = 0.0) -> float:
        """Pitch of the load at rest below two such triangles that lean outwards."""
        return atan2(self.ahead_m, self.height_m * cos(lean_rad) + ANCHOR_UP_M)


def triangle(front_m: float, rear_m: float) -> Triangle:
    """Solve the triangle of front and rear tether."""
    ahead_m = (rear_m**2 - front_m**2) / (2.0 * EDGE_M)
    return Triangle(ahead_m, sqrt(front_m**2 - (0.5 * EDGE_M - ahead_m) ** 2))


def winch_for(pitch_rad: float, lean_rad: float) -> float:
    """Give what the winch must turn for a pitch of the load [m], by the secant method on `Triangle.pitch_rad`."""
    before, now = 0.0, 0.01
    error_before = -pitch_rad
    for _ in range(30):
        error = triangle(TETHER_M - now, TETHER_M + now).pitch_rad(lean_rad) - pitch_rad
        if abs(error) < 1e-13 or error == error_before:
            break
        before, now, error_before = now, now - error * (now - before) / (error - error_before), error
    return now


def parameters() -> FloatArray:
    """Return the plant's parameters, (CooperativeParam.SIZE,)."""
    x, y, z = BOX_M
    p = np.zeros(CooperativeParam.SIZE)
    p[CooperativeParam.MASS] = MASS_KG
    p[CooperativeParam.INERTIA : CooperativeParam.INERTIA + 3] = INERTIA_KG_M2
    p[CooperativeParam.DRAG] = DRAG_N_PER_MPS
    p[CooperativeParam.ROTOR_LAG] = ROTOR_LAG_S
    p[CooperativeParam.LOAD_MASS] = LOAD_MASS_KG
    p[CooperativeParam.LOAD_INERTIA : CooperativeParam.LOAD_INERTIA + 3] = (
        LOAD_MASS_KG / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
    )
    p[CooperativeParam.LOAD_DRAG] = LOAD_DRAG_N_PER_MPS2
    p[CooperativeParam.LOAD_RATE_DRAG] = LOAD_RATE_DRAG_NM_PER_RADPS
    return p


def rotors() -> FloatArray:
    """Return the rotors of a vehicle, (4, Rotor.SIZE): front right, rear left, front left, rear right."""
    reach = ARM_M / sqrt(2.0)
    table = np.zeros((4, Rotor.SIZE))
    places = ((1.0, 1.0, 1.0), (-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0))
    for row, (ahead, right, spin) in zip(table, places, strict=True):
        row[:] = [ahead * reach, right * reach, -0.02, spin, ROTOR_THRUST_N_S2, ROTOR_TORQUE_NM_S2]
    return table


def allocation() -> FloatArray:
    """Return each rotor's thrust per total thrust and per moment, (4, 4)."""
    effect = np.array(
        [
            [1.0, -r[Rotor.PLACE + 1], r[Rotor.PLACE], r[Rotor.SPIN] * r[Rotor.TORQUE] / r[Rotor.THRUST]]
            for r in rotors()
        ]
    ).T
    return np.ascontiguousarray(np.linalg.inv(effect))


def tethers() -> FloatArray:
    """Return the four tethers, (4, Tether.SIZE); a winch at +1 m would shorten the front ones by 1 m."""
    table = np.zeros((2 * CARRIERS, Tether.SIZE))
    for row, (carrier, ahead) in zip(table, ((c, a) for c in range(CARRIERS) for a in (1.0, -1.0)), strict=True):
        row[:] = [
            carrier, *HOOK_FRD_M, ahead * 0.5 * EDGE_M, SIDES[carrier] * HALF_SPAN_M, -ANCHOR_UP_M,
            TETHER_M, -ahead, TETHER_STIFFNESS_N_PER_M, TETHER_DAMPING_NS_PER_M,
        ]  # fmt: skip
    return table


def cascade() -> FloatArray:
    """Return the autopilot's gains and limits, (CascadeParam.SIZE,); tuned once for a vehicle of this size."""
    share_kg = MASS_KG + LOAD_MASS_KG / CARRIERS
    values = {
        CascadeParam.POS_P_XY: 1.2,
        CascadeParam.POS_P_Z: 1.5,
        CascadeParam.VEL_P_XY: 3.0,
        CascadeParam.VEL_I_XY: 0.6,
        CascadeParam.VEL_D_XY: 0.2,
        CascadeParam.VEL_P_Z: 5.0,
        CascadeParam.VEL_I_Z: 2.0,
        CascadeParam.VEL_D_Z: 0.0,
        CascadeParam.VEL_D_LAG: 0.05,
        CascadeParam.SPEED_XY_MAX: 3.0,
        CascadeParam.SPEED_UP_MAX: 2.0,
        CascadeParam.SPEED_DOWN_MAX: 1.5,
        CascadeParam.TILT_MAX: 0.6,
        CascadeParam.ATT_P_TILT: 7.0,
        CascadeParam.ATT_P_YAW: 3.0,
        CascadeParam.RATE_MAX: 3.5,
        CascadeParam.RATE_P_TILT: 22.0,
        CascadeParam.RATE_P_YAW: 8.0,
        CascadeParam.RATE_I: 1.0,
        CascadeParam.RATE_D_TILT: 0.3,
        CascadeParam.RATE_D_LAG: 0.01,
        CascadeParam.WEIGHT: share_kg * GRAVITY_MPS2,
        CascadeParam.DENSITY_RATIO: 1.0,
        CascadeParam.ROTOR_THRUST_MAX: ROTOR_THRUST_MAX_N,
    }
    packed = np.zeros(CascadeParam.SIZE)
    for index, value in values.items():
        packed[index] = value
    packed[CascadeParam.INERTIA : CascadeParam.INERTIA + 3] = INERTIA_KG_M2
    return packed


def at_rest(carriers_ned_m: FloatArray, load_ned_m: FloatArray, yaw_rad: float) -> FloatArray:
    """Return the plant's state with all bodies level and at rest, rotors carrying each vehicle's share.

    Parameters
    ----------
    carriers_ned_m : (2, 3)
        CGs of the vehicles.
    load_ned_m : (3,)
        CG of the load.
    yaw_rad : float
        Of all.
    """
    x = np.zeros(FIRST_CARRIER + CARRIERS * CarrierState.SIZE)
    x[BodyState.POS : BodyState.POS + 3] = load_ned_m
    share_n = (MASS_KG + LOAD_MASS_KG / CARRIERS) * GRAVITY_MPS2
    for c in range(CARRIERS):
        own = x[FIRST_CARRIER + c * CarrierState.SIZE : FIRST_CARRIER + (c + 1) * CarrierState.SIZE]
        own[BodyState.POS : BodyState.POS + 3] = carriers_ned_m[c]
        own[CarrierState.OMEGA : CarrierState.OMEGA + 4] = sqrt(0.25 * share_n / ROTOR_THRUST_N_S2)
        own[BodyState.QUAT], own[BodyState.QUAT + 3] = cos(0.5 * yaw_rad), sin(0.5 * yaw_rad)
    x[BodyState.QUAT], x[BodyState.QUAT + 3] = cos(0.5 * yaw_rad), sin(0.5 * yaw_rad)
    return x
