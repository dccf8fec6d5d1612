"""Truth of the simulator: a rigid quadrotor and a point load on an elastic cable that can go slack.

On purpose another model than the filter's: the filter knows a rigid cable and two point masses, this one a spring with
damping that only pulls, a winch, a body with inertia and four rotors that lag, ground under both, and air that moves.
"""

from enum import IntEnum
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from swingd.core._jit import F8, I8, VEC, VOID, kernel
from swingd.core.rotation import matrix, normalise, quaternion_rate

Vector = NDArray[np.float64]

GRAVITY = 9.80665


class PlantState(IntEnum):
    """Offsets into the state vector, SI units; ned is inertial, frd the body with its origin at the vehicle's CG."""

    POS = 0
    """Vehicle's CG, ned, 3."""
    VEL = 3
    """ned, 3."""
    QUAT = 6
    """ned_from_frd, scalar first, 4."""
    RATE = 10
    """Body rates frd, 3."""
    ROTOR = 13
    """Throttle to which each rotor's present speed belongs, 0..1, 4."""
    LOAD_POS = 17
    """ned, 3."""
    LOAD_VEL = 20
    """ned, 3."""
    CABLE_LENGTH = 23
    """Unstretched, from the hook to the load's centre of mass [m]."""
    SIZE = 24


class PlantInput(IntEnum):
    """Offsets into the inputs, held over a step."""

    COMMAND = 0
    """Throttle commanded to each rotor, 0..1, 4."""
    THRUST_FACTOR = 4
    """True thrust over the curve's: voltage, wear; 0 stops the rotors."""
    ATTACHED = 5
    """1 while the cable connects both bodies, else 0."""
    WIND = 6
    """Velocity of the air, ned, 3."""
    CABLE_RATE = 9
    """What a winch adds to the unstretched cable [m/s]."""
    SIZE = 10


class PlantOutput(IntEnum):
    """Offsets into what a step reports beside the state."""

    TENSION = 0
    """Cable tension at the end of the step [N]."""
    THRUST = 1
    """Sum of the rotors' thrust at the end of the step [N]."""
    ACC = 2
    """Acceleration of the vehicle's CG at the end of the step, ned, 3."""
    SPECIFIC_FORCE = 5
    """Specific force at the IMU, mean over the step, frd, 3."""
    MEAN_RATE = 8
    """Body rates, mean over the step, frd, 3."""
    GROUND_FORCE = 11
    """Normal force of the ground on the vehicle at the end of the step [N]."""
    LOAD_GROUND_FORCE = 12
    """Normal force of the ground on the load at the end of the step [N]."""
    SIZE = 13


class PlantParam(IntEnum):
    """Offsets into the parameters, SI units."""

    MASS = 0
    INERTIA = 1
    """About the frd axes, 3."""
    HOOK = 4
    """Hook from the CG, frd, 3."""
    IMU = 7
    """IMU from the CG, frd, 3."""
    ROTOR_XY = 10
    """Forward and right coordinate of each rotor, 8."""
    ROTOR_SPIN = 18
    """Yaw moment over thrust of each rotor, positive about down [m], 4."""
    CURVE = 22
    """Thrust of all rotors together: quadratic, linear, offset [N], 3."""
    LAG_UP = 25
    LAG_DOWN = 26
    DRAG = 27
    """Drag over speed along the forward, right and down axes [N/(m/s)], 3."""
    RATE_DRAG = 30
    """Moment over body rate [N m/(rad/s)]."""
    LOAD_MASS = 31
    LOAD_DRAG = 32
    """Half of the air density times drag coefficient times area [N/(m/s)^2]."""
    CABLE_STIFFNESS = 33
    CABLE_DAMPING = 34
    GROUND_DOWN = 35
    """Down coordinate of the ground [m]."""
    LEG = 36
    """Height of the CG over the feet [m]; the feet are under the rotors."""
    GROUND_FREQUENCY = 37
    """Of each body's bounce on the springs under it [rad/s]."""
    GROUND_FRICTION = 38
    """Coulomb coefficient."""
    SIZE = 39


_S = PlantState
_U = PlantInput
_Y = PlantOutput
_P = PlantParam

_SLIP_SPEED = 0.05  # m/s: below this the friction is viscous, so that it has no corner


@kernel(VOID(VEC, VEC, VEC, VEC, VEC))
def slung_plant_derivative(x_dot: Vector, y: Vector, x: Vector, u: Vector, p: Vector) -> None:
    """Write the time derivative of the state and the forces that act at this instant.

    Parameters
    ----------
    x_dot : (PlantState.SIZE,), written
        Derivative of ``x``.
    y : (PlantOutput.SIZE,), written
        Forces and accelerations at this instant; ``MEAN_RATE`` gets the rates themselves.
    x : (PlantState.SIZE,)
        State; the quaternion need not be of unit length.
    u : (PlantInput.SIZE,)
        Inputs.
    p : (PlantParam.SIZE,)
        Parameters.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix(x[_S.QUAT], x[_S.QUAT + 1], x[_S.QUAT + 2], x[_S.QUAT + 3])
    vn, ve, vd = x[_S.VEL], x[_S.VEL + 1], x[_S.VEL + 2]
    wx, wy, wz = x[_S.RATE], x[_S.RATE + 1], x[_S.RATE + 2]
    mass = p[_P.MASS]

    # Rotors: thrust along -down, moments of thrust and spin.
    thrust = 0.0
    mx = -p[_P.RATE_DRAG] * wx
    my = -p[_P.RATE_DRAG] * wy
    mz = -p[_P.RATE_DRAG] * wz
    for i in range(4):
        s = x[_S.ROTOR + i]
        f = u[_U.THRUST_FACTOR] * 0.25 * ((p[_P.CURVE] * s + p[_P.CURVE + 1]) * s + p[_P.CURVE + 2])
        thrust += f
        mx -= p[_P.ROTOR_XY + 2 * i + 1] * f
        my += p[_P.ROTOR_XY + 2 * i] * f
        mz += p[_P.ROTOR_SPIN + i] * f
        command = min(max(u[_U.COMMAND + i], 0.0), 1.0)
        lag = p[_P.LAG_UP] if command > s else p[_P.LAG_DOWN]
        x_dot[_S.ROTOR + i] = (command - s) / lag

    # Drag in body axes on the velocity through the air.
    an, ae, ad = vn - u[_U.WIND], ve - u[_U.WIND + 1], vd - u[_U.WIND + 2]
    fx = -p[_P.DRAG] * (r00 * an + r10 * ae + r20 * ad)
    fy = -p[_P.DRAG + 1] * (r01 * an + r11 * ae + r21 * ad)
    fz = -p[_P.DRAG + 2] * (r02 * an + r12 * ae + r22 * ad) - thrust
    fn = r00 * fx + r01 * fy + r02 * fz
    fe = r10 * fx + r11 * fy + r12 * fz
    fd = r20 * fx + r21 * fy + r22 * fz

    # Load: drag and ground.
    ln, le, ld = x[_S.LOAD_VEL], x[_S.LOAD_VEL + 1], x[_S.LOAD_VEL + 2]
    load_mass = p[_P.LOAD_MASS]
    an, ae, ad = ln - u[_U.WIND], le - u[_U.WIND + 1], ld - u[_U.WIND + 2]
    k = -p[_P.LOAD_DRAG] * sqrt(an * an + ae * ae + ad * ad)
    gn, ge, gd = k * an, k * ae, k * ad
    w0 = p[_P.GROUND_FREQUENCY]
    load_normal = 0.0
    depth = x[_S.LOAD_POS + 2] - p[_P.GROUND_DOWN]
    if depth > 0.0:
        load_normal = max(0.0, load_mass * (w0 * w0 * depth + 1.4 * w0 * ld))
        k = p[_P.GROUND_FRICTION] * load_normal / max(sqrt(ln * ln + le * le), _SLIP_SPEED)
        gn -= k * ln
        ge -= k * le
        gd -= load_normal

    # Cable: spring and damper that only pull, from the hook to the load.
    tension = 0.0
    if u[_U.ATTACHED] > 0.5:
        hx, hy, hz = p[_P.HOOK], p[_P.HOOK + 1], p[_P.HOOK + 2]
        cn = x[_S.LOAD_POS] - x[_S.POS] - (r00 * hx + r01 * hy + r02 * hz)
        ce = x[_S.LOAD_POS + 1] - x[_S.POS + 1] - (r10 * hx + r11 * hy + r12 * hz)
        cd = x[_S.LOAD_POS + 2] - x[_S.POS + 2] - (r20 * hx + r21 * hy + r22 * hz)
        length = sqrt(cn * cn + ce * ce + cd * cd)
        stretch = length - x[_S.CABLE_LENGTH]
        if stretch > 0.0:
            cn, ce, cd = cn / length, ce / length, cd / length
            bx, by, bz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
            speed = (
                cn * (ln - vn - (r00 * bx + r01 * by + r02 * bz))
                + ce * (le - ve - (r10 * bx + r11 * by + r12 * bz))
                + cd * (ld - vd - (r20 * bx + r21 * by + r22 * bz))
                - u[_U.CABLE_RATE]
            )
            tension = max(0.0, p[_P.CABLE_STIFFNESS] * stretch + p[_P.CABLE_DAMPING] * speed)
            tn, te, td = tension * cn, tension * ce, tension * cd
            gn -= tn
            ge -= te
            gd -= td
            fn += tn
            fe += te
            fd += td
            tx = r00 * tn + r10 * te + r20 * td
            ty = r01 * tn + r11 * te + r21 * td
            tz = r02 * tn + r12 * te + r22 * td
            mx += hy * tz - hz * ty
            my += hz * tx - hx * tz
            mz += hx * ty - hy * tx

    # Four feet under the rotors.
    normal = 0.0
    leg = p[_P.LEG]
    for i in range(4):
        px, py = p[_P.ROTOR_XY + 2 * i], p[_P.ROTOR_XY + 2 * i + 1]
        depth = x[_S.POS + 2] + r20 * px + r21 * py + r22 * leg - p[_P.GROUND_DOWN]
        if depth > 0.0:
            bx, by, bz = wy * leg - wz * py, wz * px - wx * leg, wx * py - wy * px
            sn = vn + r00 * bx + r01 * by + r02 * bz
            se = ve + r10 * bx + r11 * by + r12 * bz
            sd = vd + r20 * bx + r21 * by + r22 * bz
            push = max(0.0, 0.25 * mass * (w0 * w0 * depth + 1.4 * w0 * sd))
            k = p[_P.GROUND_FRICTION] * push / max(sqrt(sn * sn + se * se), _SLIP_SPEED)
            tn, te, td = -k * sn, -k * se, -push
            fn += tn
            fe += te
            fd += td
            normal += push
            tx = r00 * tn + r10 * te + r20 * td
            ty = r01 * tn + r11 * te + r21 * td
            tz = r02 * tn + r12 * te + r22 * td
            mx += py * tz - leg * ty
            my += leg * tx - px * tz
            mz += px * ty - py * tx

    # Rigid body.
    ix, iy, iz = p[_P.INERTIA], p[_P.INERTIA + 1], p[_P.INERTIA + 2]
    dwx = (mx - (iz - iy) * wy * wz) / ix
    dwy = (my - (ix - iz) * wz * wx) / iy
    dwz = (mz - (iy - ix) * wx * wy) / iz
    an, ae, ad = fn / mass, fe / mass, fd / mass
    x_dot[_S.POS], x_dot[_S.POS + 1], x_dot[_S.POS + 2] = vn, ve, vd
    x_dot[_S.VEL], x_dot[_S.VEL + 1], x_dot[_S.VEL + 2] = an, ae, ad + GRAVITY
    quaternion_rate(x_dot[_S.QUAT : _S.QUAT + 4], x[_S.QUAT : _S.QUAT + 4], wx, wy, wz)
    x_dot[_S.RATE], x_dot[_S.RATE + 1], x_dot[_S.RATE + 2] = dwx, dwy, dwz
    x_dot[_S.LOAD_POS], x_dot[_S.LOAD_POS + 1], x_dot[_S.LOAD_POS + 2] = ln, le, ld
    x_dot[_S.LOAD_VEL] = gn / load_mass
    x_dot[_S.LOAD_VEL + 1] = ge / load_mass
    x_dot[_S.LOAD_VEL + 2] = gd / load_mass + GRAVITY
    x_dot[_S.CABLE_LENGTH] = u[_U.CABLE_RATE]

    y[_Y.TENSION] = tension
    y[_Y.THRUST] = thrust
    y[_Y.ACC], y[_Y.ACC + 1], y[_Y.ACC + 2] = an, ae, ad + GRAVITY
    # Specific force at the IMU: the CG's, plus what the rotation adds at its place.
    px, py, pz = p[_P.IMU], p[_P.IMU + 1], p[_P.IMU + 2]
    bx, by, bz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
    y[_Y.SPECIFIC_FORCE] = r00 * an + r10 * ae + r20 * ad + dwy * pz - dwz * py + wy * bz - wz * by
    y[_Y.SPECIFIC_FORCE + 1] = r01 * an + r11 * ae + r21 * ad + dwz * px - dwx * pz + wz * bx - wx * bz
    y[_Y.SPECIFIC_FORCE + 2] = r02 * an + r12 * ae + r22 * ad + dwx * py - dwy * px + wx * by - wy * bx
    y[_Y.MEAN_RATE], y[_Y.MEAN_RATE + 1], y[_Y.MEAN_RATE + 2] = wx, wy, wz
    y[_Y.GROUND_FORCE] = normal
    y[_Y.LOAD_GROUND_FORCE] = load_normal


@kernel(VOID(VEC, VEC, VEC, VEC, F8, I8))
def slung_plant_step(x: Vector, y: Vector, u: Vector, p: Vector, dt_s: float, substeps: int) -> None:
    """Integrate one step by ``substeps`` classical Runge-Kutta steps, in place.

    Parameters
    ----------
    x : (PlantState.SIZE,), read and written
        State; the quaternion is normalised at the end.
    y : (PlantOutput.SIZE,), written
        Outputs at the end of the step; specific force and rates are means over it.
    u : (PlantInput.SIZE,)
        Inputs, held.
    p : (PlantParam.SIZE,)
        Parameters.
    dt_s : float
        Whole step [s].
    substeps : int
        At least 1; the caller keeps the fastest of cable and ground inside the method's stability.
    """
    h = dt_s / substeps
    size = x.shape[0]
    k1 = np.empty(size)
    k2 = np.empty(size)
    k3 = np.empty(size)
    k4 = np.empty(size)
    trial = np.empty(size)
    mean = np.zeros(6)
    for _ in range(substeps):
        slung_plant_derivative(k1, y, x, u, p)
        for i in range(6):
            mean[i] += 0.5 * y[_Y.SPECIFIC_FORCE + i]
        for i in range(size):
            trial[i] = x[i] + 0.5 * h * k1[i]
        slung_plant_derivative(k2, y, trial, u, p)
        for i in range(size):
            trial[i] = x[i] + 0.5 * h * k2[i]
        slung_plant_derivative(k3, y, trial, u, p)
        for i in range(size):
            trial[i] = x[i] + h * k3[i]
        slung_plant_derivative(k4, y, trial, u, p)
        for i in range(size):
            x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        for i in range(6):
            mean[i] += 0.5 * y[_Y.SPECIFIC_FORCE + i]
    normalise(x[_S.QUAT : _S.QUAT + 4])
    slung_plant_derivative(k1, y, x, u, p)
    for i in range(6):
        y[_Y.SPECIFIC_FORCE + i] = mean[i] / substeps
