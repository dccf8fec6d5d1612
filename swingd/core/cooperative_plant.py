"""Truth of the cooperative study: several quadrotors, a rigid load, elastic tethers that only pull, winches.

Each tether runs from a point of a vehicle to a point of the load; a vehicle's winch lengthens some of its tethers
and shortens others. Every body has mass, inertia about its own axes and six degrees of freedom; rotors follow their
commands with a first-order lag. Another model than any estimator's: those know straight lines to one point each.
"""

from enum import IntEnum
from math import sqrt

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.multirotor import Rotor
from swingd.core.rotation import matrix, normalise, quaternion_rate


class BodyState(IntEnum):
    """Offsets into a body's part of the state, SI units; ned is inertial, frd the body's own axes from its CG."""

    POS = 0
    """ned, 3."""
    VEL = 3
    """ned, 3."""
    QUAT = 6
    """ned_from_frd, scalar first, 4."""
    RATE = 10
    """frd, 3."""
    SIZE = 13


class CarrierState(IntEnum):
    """Offsets into a vehicle's part of the state, after its `BodyState`."""

    OMEGA = 13
    """Rotor speeds, 4 [rad/s]."""
    WINCH = 17
    """What the winch has added to a tether with gain 1 [m]."""
    SIZE = 18


FIRST_CARRIER = int(BodyState.SIZE)
"""The load comes first in the state, then vehicle by vehicle."""


class LoadInput(IntEnum):
    """Offsets into the inputs: what the air does to the load."""

    FORCE = 0
    """ned, 3 [N]."""
    MOMENT = 3
    """frd, 3 [N m]."""
    SIZE = 6


class CarrierInput(IntEnum):
    """Offsets into a vehicle's part of the inputs, after the load's."""

    OMEGA = 0
    """Commanded rotor speeds, 4 [rad/s]."""
    WINCH_RATE = 4
    """[m/s]"""
    FORCE = 5
    """What the air adds to the drag, ned, 3 [N]."""
    SIZE = 8


class CarrierOutput(IntEnum):
    """Offsets into what is reported of a vehicle beside the state."""

    SPECIFIC_FORCE = 0
    """At the CG, frd, 3 [m/s^2]."""
    ACC = 3
    """Inertial acceleration of the CG, ned, 3 [m/s^2]."""
    CABLE_FORCE = 6
    """Pull of all its tethers on it, ned, 3 [N]."""
    THRUST = 9
    """Of all rotors [N]."""
    SIZE = 10


class CooperativeParam(IntEnum):
    """Offsets into the parameters; the vehicles are alike."""

    MASS = 0
    """Of a vehicle."""
    INERTIA = 1
    """About the frd axes, 3."""
    DRAG = 4
    """Of a vehicle over its speed [N/(m/s)]."""
    ROTOR_LAG = 5
    LOAD_MASS = 6
    LOAD_INERTIA = 7
    """About its frd axes, 3."""
    LOAD_DRAG = 10
    """Half of the air density times drag coefficient times area [N/(m/s)^2]."""
    LOAD_RATE_DRAG = 11
    """Moment over body rate [N m/(rad/s)]."""
    SIZE = 12


class Tether(IntEnum):
    """Columns of the table of tethers, one row each."""

    CARRIER = 0
    """Index of its vehicle."""
    HOOK = 1
    """On the vehicle, from its CG, frd, 3 [m]."""
    ANCHOR = 4
    """On the load, from its CG, frd, 3 [m]."""
    LENGTH = 7
    """Unstretched, with the winch at 0 [m]."""
    GAIN = 8
    """What the winch adds to it over what it turns: +1 or -1, 0 without winch."""
    STIFFNESS = 9
    """[N/m]"""
    DAMPING = 10
    """[N s/m]"""
    SIZE = 11


_B = BodyState
_C = CarrierState
_P = CooperativeParam
_T = Tether
_Y = CarrierOutput


@kernel(VOID(VEC, MAT, VEC, VEC))
def _turned(out, R, vector, offset):
    """Write R vector + offset."""
    for i in range(3):
        out[i] = offset[i] + R[i, 0] * vector[0] + R[i, 1] * vector[1] + R[i, 2] * vector[2]


@kernel(VOID(MAT, VEC))
def _attitude(R_out, q):
    """Rotation matrix of a quaternion."""
    r = matrix(q[0], q[1], q[2], q[3])
    for i in range(3):
        for j in range(3):
            R_out[i, j] = r[3 * i + j]


@kernel(VOID(VEC, MAT, VEC, VEC, VEC))
def _point_velocity(out, R, rate, place, vel):
    """Velocity, ned, of a point of a body: vel + R (rate x place)."""
    bx = rate[1] * place[2] - rate[2] * place[1]
    by = rate[2] * place[0] - rate[0] * place[2]
    bz = rate[0] * place[1] - rate[1] * place[0]
    for i in range(3):
        out[i] = vel[i] + R[i, 0] * bx + R[i, 1] * by + R[i, 2] * bz


@kernel(VOID(VEC, VEC, MAT, VEC, VEC))
def _push(force, moment, R, at, place):
    """Add a force (ned) that acts at a place (frd) to a body's force (ned) and moment (frd)."""
    fx = R[0, 0] * at[0] + R[1, 0] * at[1] + R[2, 0] * at[2]
    fy = R[0, 1] * at[0] + R[1, 1] * at[1] + R[2, 1] * at[2]
    fz = R[0, 2] * at[0] + R[1, 2] * at[1] + R[2, 2] * at[2]
    for i in range(3):
        force[i] += at[i]
    moment[0] += place[1] * fz - place[2] * fy
    moment[1] += place[2] * fx - place[0] * fz
    moment[2] += place[0] * fy - place[1] * fx


@kernel(VOID(VEC, VEC, VEC, VEC, F8, VEC))
def _body_rate(x_dot, x, force, moment, mass, inertia):
    """Derivative of a body's part of the state; gravity is added to the force."""
    for i in range(3):
        x_dot[_B.POS + i] = x[_B.VEL + i]
        x_dot[_B.VEL + i] = force[i] / mass
    x_dot[_B.VEL + 2] += GRAVITY_MPS2
    wx, wy, wz = x[_B.RATE], x[_B.RATE + 1], x[_B.RATE + 2]
    quaternion_rate(x_dot[_B.QUAT : _B.QUAT + 4], x[_B.QUAT : _B.QUAT + 4], wx, wy, wz)
    x_dot[_B.RATE] = (moment[0] - (inertia[2] - inertia[1]) * wy * wz) / inertia[0]
    x_dot[_B.RATE + 1] = (moment[1] - (inertia[0] - inertia[2]) * wz * wx) / inertia[1]
    x_dot[_B.RATE + 2] = (moment[2] - (inertia[1] - inertia[0]) * wx * wy) / inertia[2]


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, VEC, MAT, MAT))
def cooperative_derivative(x_dot, y, tensions, x, u, p, rotors, tethers):
    """Write the time derivative of the state and what acts at this instant.

    Parameters
    ----------
    x_dot : (BodyState.SIZE + n CarrierState.SIZE,), written
    y : (n CarrierOutput.SIZE,), written
        Of one vehicle after the other.
    tensions : (k,), written
        Of every tether [N]; 0 where it is slack.
    x : (BodyState.SIZE + n CarrierState.SIZE,)
        Load, then vehicles; quaternions need not be of unit length.
    u : (LoadInput.SIZE + n CarrierInput.SIZE,)
    p : (CooperativeParam.SIZE,)
    rotors : (4, Rotor.SIZE)
        Of each vehicle.
    tethers : (k, Tether.SIZE)
    """
    carriers = (x.shape[0] - FIRST_CARRIER) // _C.SIZE
    R_load, R = np.empty((3, 3)), np.empty((carriers, 3, 3))
    force, moment = np.zeros((carriers, 3)), np.zeros((carriers, 3))
    load_force, load_moment, cable_force = np.empty(3), np.empty(3), np.zeros((carriers, 3))
    load = x[: _B.SIZE]
    _attitude(R_load, load[_B.QUAT : _B.QUAT + 4])

    # Load: air.
    speed = sqrt(load[_B.VEL] ** 2 + load[_B.VEL + 1] ** 2 + load[_B.VEL + 2] ** 2)
    for i in range(3):
        load_force[i] = u[LoadInput.FORCE + i] - p[_P.LOAD_DRAG] * speed * load[_B.VEL + i]
        load_moment[i] = u[LoadInput.MOMENT + i] - p[_P.LOAD_RATE_DRAG] * load[_B.RATE + i]

    # Vehicles: rotors and air.
    for c in range(carriers):
        own = x[FIRST_CARRIER + c * _C.SIZE : FIRST_CARRIER + (c + 1) * _C.SIZE]
        own_dot = x_dot[FIRST_CARRIER + c * _C.SIZE : FIRST_CARRIER + (c + 1) * _C.SIZE]
        given = u[LoadInput.SIZE + c * CarrierInput.SIZE : LoadInput.SIZE + (c + 1) * CarrierInput.SIZE]
        _attitude(R[c], own[_B.QUAT : _B.QUAT + 4])
        thrust = 0.0
        for j in range(rotors.shape[0]):
            omega = own[_C.OMEGA + j]
            own_dot[_C.OMEGA + j] = (given[CarrierInput.OMEGA + j] - omega) / p[_P.ROTOR_LAG]
            pull = rotors[j, Rotor.THRUST] * omega * omega
            thrust += pull
            moment[c, 0] -= rotors[j, Rotor.PLACE + 1] * pull
            moment[c, 1] += rotors[j, Rotor.PLACE] * pull
            moment[c, 2] += rotors[j, Rotor.SPIN] * rotors[j, Rotor.TORQUE] * omega * omega
        own_dot[_C.WINCH] = given[CarrierInput.WINCH_RATE]
        for i in range(3):
            force[c, i] = given[CarrierInput.FORCE + i] - p[_P.DRAG] * own[_B.VEL + i] - thrust * R[c, i, 2]
        y[c * _Y.SIZE + _Y.THRUST] = thrust

    # Tethers: spring and damper that only pull.
    hook, anchor, hook_vel, anchor_vel = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    pull_on = np.empty(3)
    for k in range(tethers.shape[0]):
        c = int(tethers[k, _T.CARRIER])
        own = x[FIRST_CARRIER + c * _C.SIZE : FIRST_CARRIER + (c + 1) * _C.SIZE]
        gain = tethers[k, _T.GAIN]
        place, anchor_place = tethers[k, _T.HOOK : _T.HOOK + 3], tethers[k, _T.ANCHOR : _T.ANCHOR + 3]
        _turned(hook, R[c], place, own[_B.POS : _B.POS + 3])
        _turned(anchor, R_load, anchor_place, load[_B.POS : _B.POS + 3])
        length = sqrt((anchor[0] - hook[0]) ** 2 + (anchor[1] - hook[1]) ** 2 + (anchor[2] - hook[2]) ** 2)
        stretch = length - tethers[k, _T.LENGTH] - gain * own[_C.WINCH]
        tensions[k] = 0.0
        if stretch > 0.0:
            _point_velocity(hook_vel, R[c], own[_B.RATE : _B.RATE + 3], place, own[_B.VEL : _B.VEL + 3])
            _point_velocity(
                anchor_vel, R_load, load[_B.RATE : _B.RATE + 3], anchor_place, load[_B.VEL : _B.VEL + 3]
            )  # fmt: skip
            rate = -gain * u[LoadInput.SIZE + c * CarrierInput.SIZE + CarrierInput.WINCH_RATE]
            for i in range(3):
                rate += (anchor[i] - hook[i]) / length * (anchor_vel[i] - hook_vel[i])
            tension = max(0.0, tethers[k, _T.STIFFNESS] * stretch + tethers[k, _T.DAMPING] * rate)
            tensions[k] = tension
            for i in range(3):
                pull_on[i] = tension * (anchor[i] - hook[i]) / length
                cable_force[c, i] += pull_on[i]
            _push(force[c], moment[c], R[c], pull_on, place)
            for i in range(3):
                pull_on[i] = -pull_on[i]
            _push(load_force, load_moment, R_load, pull_on, anchor_place)

    # Bodies.
    _body_rate(
        x_dot[: _B.SIZE], load, load_force, load_moment, p[_P.LOAD_MASS], p[_P.LOAD_INERTIA : _P.LOAD_INERTIA + 3]
    )
    for c in range(carriers):
        first = FIRST_CARRIER + c * _C.SIZE
        own_dot = x_dot[first : first + _B.SIZE]
        _body_rate(
            own_dot, x[first : first + _B.SIZE], force[c], moment[c], p[_P.MASS], p[_P.INERTIA : _P.INERTIA + 3]
        )  # fmt: skip
        for i in range(3):
            y[c * _Y.SIZE + _Y.ACC + i] = own_dot[_B.VEL + i]
            y[c * _Y.SIZE + _Y.CABLE_FORCE + i] = cable_force[c, i]
            felt = 0.0
            for j in range(3):
                felt += R[c, j, i] * force[c, j] / p[_P.MASS]
            y[c * _Y.SIZE + _Y.SPECIFIC_FORCE + i] = felt


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, MAT, MAT, F8))
def cooperative_step(x, y, tensions, u, p, rotors, tethers, dt_s):
    """Advance the state by one classical Runge-Kutta step, in place; outputs are those at its beginning.

    See `cooperative_derivative` for the arguments.
    """
    size = x.shape[0]
    k1, k2, k3, k4, trial = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    later_y, later_tensions = np.empty(y.shape[0]), np.empty(tensions.shape[0])
    cooperative_derivative(k1, y, tensions, x, u, p, rotors, tethers)
    for i in range(size):
        trial[i] = x[i] + 0.5 * dt_s * k1[i]
    cooperative_derivative(k2, later_y, later_tensions, trial, u, p, rotors, tethers)
    for i in range(size):
        trial[i] = x[i] + 0.5 * dt_s * k2[i]
    cooperative_derivative(k3, later_y, later_tensions, trial, u, p, rotors, tethers)
    for i in range(size):
        trial[i] = x[i] + dt_s * k3[i]
    cooperative_derivative(k4, later_y, later_tensions, trial, u, p, rotors, tethers)
    for i in range(size):
        x[i] += dt_s / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
    normalise(x[_B.QUAT : _B.QUAT + 4])
    first = FIRST_CARRIER
    while first < size:
        normalise(x[first + _B.QUAT : first + _B.QUAT + 4])
        first += _C.SIZE
