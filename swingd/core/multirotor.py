"""Truth of the studies: a rigid multirotor with any number of propellers, an elastic cable and a load with drag.

Thrust and torque of each propeller are k Omega^2 scaled with the air's density (Drones 2023, 7, 654, (15)); what it
feels along its disc comes from blade elements (`swingd.core.rotor`). Rotor speeds follow their commands with a
first-order lag. Drag of the frame acts at the centre of pressure, the cable at the hook, both off the centre of mass.
"""

from enum import IntEnum
from math import sqrt

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel
from swingd.core.atmosphere import air_density
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.rotation import matrix, normalise, quaternion_rate
from swingd.core.rotor import BLADE_SIZE, induced_velocity, inplane_loads


class MultirotorState(IntEnum):
    """Offsets into the state vector, SI units; ned is inertial, frd the body with its origin at the vehicle's CG."""

    POS = 0
    """Vehicle's CG, ned, 3."""
    VEL = 3
    """ned, 3."""
    QUAT = 6
    """ned_from_frd, scalar first, 4."""
    RATE = 10
    """Body rates, frd, 3."""
    LOAD_POS = 13
    """ned, 3."""
    LOAD_VEL = 16
    """ned, 3."""
    ENERGY = 19
    """Mechanical energy that the motors delivered [J], the integral of (21)."""
    OMEGA = 20
    """Speed of each rotor [rad/s]; as many as there are."""


class MultirotorInput(IntEnum):
    """Offsets into the inputs, held over a step."""

    WIND = 0
    """Velocity of the air at the vehicle, ned, 3."""
    GUST_RATE = 3
    """Rotation of the air at the vehicle, frd, 3 [rad/s]."""
    LOAD_WIND = 6
    """Velocity of the air at the load, ned, 3."""
    OMEGA = 9
    """Commanded speed of each rotor [rad/s]."""


class MultirotorOutput(IntEnum):
    """Offsets into what an evaluation of the derivative reports."""

    SPECIFIC_FORCE = 0
    """At the IMU, frd, 3 [m/s^2]."""
    AERO_FORCE = 3
    """Frame drag and in-plane forces of the rotors, ned, 3 [N]: f_a of (2)."""
    CABLE = 6
    """From the hook to the load, ned, 3 [m]."""
    CABLE_RATE = 9
    """Its derivative, ned, 3 [m/s]."""
    TENSION = 12
    """[N]"""
    THRUST = 13
    """Of all rotors [N]."""
    SHAFT_POWER = 14
    """Of all motors [W]."""
    SIZE = 15


class MultirotorParam(IntEnum):
    """Offsets into the parameters, SI units; places are from the CG, frd."""

    MASS = 0
    INERTIA = 1
    """Matrix about the frd axes, row by row, 9."""
    INERTIA_INV = 10
    """Its inverse, 9."""
    HOOK = 19
    CENTRE_OF_PRESSURE = 22
    IMU = 25
    DRAG_AREA = 28
    """Of the frame along the frd axes, 3 [m^2]."""
    ROTOR_LAG = 31
    REFERENCE_DENSITY = 32
    """At which the rotors' coefficients were measured [kg/m^3]."""
    ORIGIN_ALTITUDE = 33
    """Of the ned origin above sea level [m]."""
    LOAD_MASS = 34
    LOAD_DRAG_AREA = 35
    """Drag coefficient times area [m^2]."""
    CABLE_LENGTH = 36
    CABLE_STIFFNESS = 37
    CABLE_DAMPING = 38
    BLADE = 39
    """Geometry of the propellers' blades, see `swingd.core.rotor`."""
    SIZE = 39 + BLADE_SIZE


class Rotor(IntEnum):
    """Columns of the table of rotors, one row each."""

    PLACE = 0
    """Hub, frd, 3 [m]."""
    SPIN = 3
    """+1: counter-clockwise seen from above, its torque turns the body clockwise; -1: the other way."""
    THRUST = 4
    """[N/(rad/s)^2] at the reference density."""
    TORQUE = 5
    """[N m/(rad/s)^2] at the reference density."""
    SIZE = 6


_S = MultirotorState
_U = MultirotorInput
_Y = MultirotorOutput
_P = MultirotorParam
_R = Rotor


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, VEC, MAT))
def multirotor_derivative(x_dot, y, inflow, x, u, p, rotors):
    """Write the time derivative of the state and what acts at this instant.

    Parameters
    ----------
    x_dot : (MultirotorState.OMEGA + n,), written
    y : (MultirotorOutput.SIZE,), written
    inflow : (n,), changed
        Induced velocity at each rotor [m/s]: where its search begins, and what it found.
    x : (MultirotorState.OMEGA + n,)
        State; the quaternion need not be of unit length.
    u : (MultirotorInput.OMEGA + n,)
    p : (MultirotorParam.SIZE,)
    rotors : (n, Rotor.SIZE)
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix(x[_S.QUAT], x[_S.QUAT + 1], x[_S.QUAT + 2], x[_S.QUAT + 3])
    vn, ve, vd = x[_S.VEL], x[_S.VEL + 1], x[_S.VEL + 2]
    wx, wy, wz = x[_S.RATE], x[_S.RATE + 1], x[_S.RATE + 2]
    mass = p[_P.MASS]
    density = air_density(p[_P.ORIGIN_ALTITUDE] - x[_S.POS + 2])
    gamma = density / p[_P.REFERENCE_DENSITY]
    blade = p[_P.BLADE : _P.SIZE]

    # Through the air: the CG's velocity and the rotation, in the body.
    an, ae, ad = vn - u[_U.WIND], ve - u[_U.WIND + 1], vd - u[_U.WIND + 2]
    ax = r00 * an + r10 * ae + r20 * ad
    ay = r01 * an + r11 * ae + r21 * ad
    az = r02 * an + r12 * ae + r22 * ad
    gx, gy, gz = wx - u[_U.GUST_RATE], wy - u[_U.GUST_RATE + 1], wz - u[_U.GUST_RATE + 2]

    # Frame drag at the centre of pressure.
    px, py, pz = p[_P.CENTRE_OF_PRESSURE], p[_P.CENTRE_OF_PRESSURE + 1], p[_P.CENTRE_OF_PRESSURE + 2]
    bx, by, bz = ax + gy * pz - gz * py, ay + gz * px - gx * pz, az + gx * py - gy * px
    k = -0.5 * density * sqrt(bx * bx + by * by + bz * bz)
    fx = k * p[_P.DRAG_AREA] * bx
    fy = k * p[_P.DRAG_AREA + 1] * by
    fz = k * p[_P.DRAG_AREA + 2] * bz
    mx, my, mz = py * fz - pz * fy, pz * fx - px * fz, px * fy - py * fx

    thrust = 0.0
    power = 0.0
    loads = np.empty(3)
    for i in range(rotors.shape[0]):
        omega = x[_S.OMEGA + i]
        px, py, pz = rotors[i, _R.PLACE], rotors[i, _R.PLACE + 1], rotors[i, _R.PLACE + 2]
        spin = rotors[i, _R.SPIN]
        t = gamma * rotors[i, _R.THRUST] * omega * omega
        q = gamma * rotors[i, _R.TORQUE] * omega * omega
        thrust += t
        power += q * omega
        mx -= py * t
        my += px * t
        mz += spin * q
        bx, by, bz = ax + gy * pz - gz * py, ay + gz * px - gx * pz, az + gx * py - gy * px
        inplane = sqrt(bx * bx + by * by)
        # Up through the air means air down through the disc.
        inflow[i] = induced_velocity(inflow[i], -bz, inplane, omega, density, blade)
        if inplane > 1e-9:
            inplane_loads(loads, inflow[i] - bz, inplane, omega, density, blade)
            ex, ey = bx / inplane, by / inplane
            sx = -loads[0] * ex - spin * loads[1] * ey
            sy = -loads[0] * ey + spin * loads[1] * ex
            fx += sx
            fy += sy
            mx -= pz * sy + spin * loads[2] * ex
            my += pz * sx - spin * loads[2] * ey
            mz += px * sy - py * sx
        x_dot[_S.OMEGA + i] = (u[_U.OMEGA + i] - omega) / p[_P.ROTOR_LAG]
    x_dot[_S.ENERGY] = power
    y[_Y.AERO_FORCE] = r00 * fx + r01 * fy + r02 * fz
    y[_Y.AERO_FORCE + 1] = r10 * fx + r11 * fy + r12 * fz
    y[_Y.AERO_FORCE + 2] = r20 * fx + r21 * fy + r22 * fz
    fz -= thrust
    fn = r00 * fx + r01 * fy + r02 * fz
    fe = r10 * fx + r11 * fy + r12 * fz
    fd = r20 * fx + r21 * fy + r22 * fz

    # Load.
    ln, le, ld = x[_S.LOAD_VEL], x[_S.LOAD_VEL + 1], x[_S.LOAD_VEL + 2]
    load_mass = p[_P.LOAD_MASS]
    an, ae, ad = ln - u[_U.LOAD_WIND], le - u[_U.LOAD_WIND + 1], ld - u[_U.LOAD_WIND + 2]
    k = -0.5 * density * p[_P.LOAD_DRAG_AREA] * sqrt(an * an + ae * ae + ad * ad)
    ln_force, le_force, ld_force = k * an, k * ae, k * ad

    # Cable: a spring that only pulls, from the hook to the load.
    hx, hy, hz = p[_P.HOOK], p[_P.HOOK + 1], p[_P.HOOK + 2]
    cn = x[_S.LOAD_POS] - x[_S.POS] - (r00 * hx + r01 * hy + r02 * hz)
    ce = x[_S.LOAD_POS + 1] - x[_S.POS + 1] - (r10 * hx + r11 * hy + r12 * hz)
    cd = x[_S.LOAD_POS + 2] - x[_S.POS + 2] - (r20 * hx + r21 * hy + r22 * hz)
    bx, by, bz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
    un = ln - vn - (r00 * bx + r01 * by + r02 * bz)
    ue = le - ve - (r10 * bx + r11 * by + r12 * bz)
    ud = ld - vd - (r20 * bx + r21 * by + r22 * bz)
    y[_Y.CABLE], y[_Y.CABLE + 1], y[_Y.CABLE + 2] = cn, ce, cd
    y[_Y.CABLE_RATE], y[_Y.CABLE_RATE + 1], y[_Y.CABLE_RATE + 2] = un, ue, ud
    length = sqrt(cn * cn + ce * ce + cd * cd)
    stretch = length - p[_P.CABLE_LENGTH]
    tension = 0.0
    if stretch > 0.0:
        cn, ce, cd = cn / length, ce / length, cd / length
        tension = p[_P.CABLE_STIFFNESS] * stretch + p[_P.CABLE_DAMPING] * (cn * un + ce * ue + cd * ud)
        tension = max(0.0, tension)
        tn, te, td = tension * cn, tension * ce, tension * cd
        ln_force -= tn
        le_force -= te
        ld_force -= td
        fn += tn
        fe += te
        fd += td
        tx = r00 * tn + r10 * te + r20 * td
        ty = r01 * tn + r11 * te + r21 * td
        tz = r02 * tn + r12 * te + r22 * td
        mx += hy * tz - hz * ty
        my += hz * tx - hx * tz
        mz += hx * ty - hy * tx

    # Rigid body with products of inertia.
    J = p[_P.INERTIA : _P.INERTIA + 9]
    hx = J[0] * wx + J[1] * wy + J[2] * wz
    hy = J[3] * wx + J[4] * wy + J[5] * wz
    hz = J[6] * wx + J[7] * wy + J[8] * wz
    mx -= wy * hz - wz * hy
    my -= wz * hx - wx * hz
    mz -= wx * hy - wy * hx
    J = p[_P.INERTIA_INV : _P.INERTIA_INV + 9]
    dwx = J[0] * mx + J[1] * my + J[2] * mz
    dwy = J[3] * mx + J[4] * my + J[5] * mz
    dwz = J[6] * mx + J[7] * my + J[8] * mz
    an, ae, ad = fn / mass, fe / mass, fd / mass
    x_dot[_S.POS], x_dot[_S.POS + 1], x_dot[_S.POS + 2] = vn, ve, vd
    x_dot[_S.VEL], x_dot[_S.VEL + 1], x_dot[_S.VEL + 2] = an, ae, ad + GRAVITY_MPS2
    quaternion_rate(x_dot[_S.QUAT : _S.QUAT + 4], x[_S.QUAT : _S.QUAT + 4], wx, wy, wz)
    x_dot[_S.RATE], x_dot[_S.RATE + 1], x_dot[_S.RATE + 2] = dwx, dwy, dwz
    x_dot[_S.LOAD_POS], x_dot[_S.LOAD_POS + 1], x_dot[_S.LOAD_POS + 2] = ln, le, ld
    x_dot[_S.LOAD_VEL] = ln_force / load_mass
    x_dot[_S.LOAD_VEL + 1] = le_force / load_mass
    x_dot[_S.LOAD_VEL + 2] = ld_force / load_mass + GRAVITY_MPS2

    y[_Y.TENSION], y[_Y.THRUST], y[_Y.SHAFT_POWER] = tension, thrust, power
    # Specific force at the IMU: the CG's, plus what the rotation adds at its place.
    px, py, pz = p[_P.IMU], p[_P.IMU + 1], p[_P.IMU + 2]
    bx, by, bz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
    y[_Y.SPECIFIC_FORCE] = r00 * an + r10 * ae + r20 * ad + dwy * pz - dwz * py + wy * bz - wz * by
    y[_Y.SPECIFIC_FORCE + 1] = r01 * an + r11 * ae + r21 * ad + dwz * px - dwx * pz + wz * bx - wx * bz
    y[_Y.SPECIFIC_FORCE + 2] = r02 * an + r12 * ae + r22 * ad + dwx * py - dwy * px + wx * by - wy * bx


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, VEC, MAT, F8))
def multirotor_step(x, x_dot, y, inflow, u, p, rotors, dt_s):
    """Advance the state by one classical Runge-Kutta step, in place.

    Parameters
    ----------
    x : (n_x,), read and written
        State; the quaternion is normalised at the end.
    x_dot, y : written
        Derivative and outputs at the *beginning* of the step.
    inflow, u, p, rotors
        As for `multirotor_derivative`.
    dt_s : float
        Step [s].
    """
    size = x.shape[0]
    trial, k, x_end = np.empty(size), np.empty(size), np.empty(size)
    y_stage = np.empty(y.shape[0])
    multirotor_derivative(x_dot, y, inflow, x, u, p, rotors)
    for i in range(size):
        trial[i] = x[i] + 0.5 * dt_s * x_dot[i]
        x_end[i] = x[i] + dt_s / 6.0 * x_dot[i]
    multirotor_derivative(k, y_stage, inflow, trial, u, p, rotors)
    for i in range(size):
        trial[i] = x[i] + 0.5 * dt_s * k[i]
        x_end[i] += dt_s / 3.0 * k[i]
    multirotor_derivative(k, y_stage, inflow, trial, u, p, rotors)
    for i in range(size):
        trial[i] = x[i] + dt_s * k[i]
        x_end[i] += dt_s / 3.0 * k[i]
    multirotor_derivative(k, y_stage, inflow, trial, u, p, rotors)
    for i in range(size):
        x[i] = x_end[i] + dt_s / 6.0 * k[i]
    normalise(x[_S.QUAT : _S.QUAT + 4])
