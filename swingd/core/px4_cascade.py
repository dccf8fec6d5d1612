"""A compiled cascade shaped on PX4's: position P, velocity PID, thrust vector, attitude P, body rate PID, allocation.

The structure is PX4's; gains, masses and rotors are the caller's. One update is one sample of the sensors.
"""

from enum import IntEnum
from math import atan2, cos, sin, sqrt

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.level import level_from_frd
from swingd.core.multirotor import Rotor


class CascadeParam(IntEnum):
    """Offsets into the parameters."""

    POS_P_XY = 0
    """[1/s]"""
    POS_P_Z = 1
    VEL_P_XY = 2
    """[1/s]"""
    VEL_I_XY = 3
    """[1/s^2]"""
    VEL_D_XY = 4
    """[1]"""
    VEL_P_Z = 5
    VEL_I_Z = 6
    VEL_D_Z = 7
    VEL_D_LAG = 8
    """Time constant of the low-pass on the velocity's derivative [s]."""
    SPEED_XY_MAX = 9
    """[m/s]"""
    SPEED_UP_MAX = 10
    SPEED_DOWN_MAX = 11
    TILT_MAX = 12
    """[rad]"""
    ATT_P_TILT = 13
    """Of roll and pitch [1/s]."""
    ATT_P_YAW = 14
    RATE_MAX = 15
    """[rad/s]"""
    RATE_P_TILT = 16
    """Angular acceleration per rate of roll and pitch [1/s]."""
    RATE_P_YAW = 17
    RATE_I = 18
    """[1/s^2]"""
    RATE_D_TILT = 19
    """Of roll and pitch [1]."""
    RATE_D_LAG = 20
    """[s]"""
    WEIGHT = 21
    """Thrust that hovers, load included: what the hover thrust estimate has learnt [N]."""
    INERTIA = 22
    """About the frd axes, 3 [kg m^2]."""
    DENSITY_RATIO = 25
    """Air's density over the one of the rotors' coefficients, as far as the autopilot knows it."""
    ROTOR_THRUST_MAX = 26
    """Largest thrust of one rotor [N]."""
    SIZE = 27


class CascadeState(IntEnum):
    """Offsets into the memory; zeros at the start."""

    VEL_INTEGRAL = 0
    """ned, 3 [m/s^2]."""
    VEL_SLOW = 3
    """Low-passed velocity, ned, 3."""
    RATE_INTEGRAL = 6
    """frd, 3 [rad/s^2]."""
    RATE_SLOW = 9
    """Low-passed rates, frd, 3."""
    SIZE = 12


class CascadeInput(IntEnum):
    """Offsets into one sample of measurements and references."""

    POS = 0
    """ned, 3."""
    VEL = 3
    """ned, 3."""
    EULER = 6
    """Roll, pitch, yaw."""
    RATE = 9
    """frd, 3."""
    POS_SP = 12
    """Wanted position, ned, 3; not used in velocity control."""
    VEL_SP = 15
    """Wanted velocity, added to what the position asks for, ned, 3."""
    ACC_SP = 18
    """Acceleration added to what the velocity asks for, ned, 3."""
    YAW_SP = 21
    BY_VELOCITY = 22
    """1: velocity control, else position control."""
    SIZE = 23


_C = CascadeParam
_M = CascadeState
_I = CascadeInput


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, MAT, MAT, F8))
def cascade_update(omega_out, acc_out, s, i, c, allocation, rotors, dt_s):
    """Give the speed of every rotor for one sample.

    Parameters
    ----------
    omega_out : (n,), written
        Commanded rotor speeds [rad/s].
    acc_out : (3,), written
        What the velocity controller asks for, without ``ACC_SP``, ned [m/s^2].
    s : (CascadeState.SIZE,), changed
    i : (CascadeInput.SIZE,)
    c : (CascadeParam.SIZE,)
    allocation : (n, 4)
        Thrust of each rotor per total thrust [1] and per roll, pitch and yaw moment [1/m].
    rotors : (n, Rotor.SIZE)
        See `swingd.core.multirotor`.
    dt_s : float
        Since the last update [s].
    """
    # Position.
    vn, ve, vd = i[_I.VEL_SP], i[_I.VEL_SP + 1], i[_I.VEL_SP + 2]
    if i[_I.BY_VELOCITY] < 0.5:
        vn += c[_C.POS_P_XY] * (i[_I.POS_SP] - i[_I.POS])
        ve += c[_C.POS_P_XY] * (i[_I.POS_SP + 1] - i[_I.POS + 1])
        vd += c[_C.POS_P_Z] * (i[_I.POS_SP + 2] - i[_I.POS + 2])
    speed = sqrt(vn * vn + ve * ve)
    if speed > c[_C.SPEED_XY_MAX]:
        vn *= c[_C.SPEED_XY_MAX] / speed
        ve *= c[_C.SPEED_XY_MAX] / speed
    vd = min(max(vd, -c[_C.SPEED_UP_MAX]), c[_C.SPEED_DOWN_MAX])

    # Velocity.
    vel_sp = (vn, ve, vd)
    for j in range(3):
        slope = (i[_I.VEL + j] - s[_M.VEL_SLOW + j]) / c[_C.VEL_D_LAG]
        s[_M.VEL_SLOW + j] += dt_s * slope
        p, d = (c[_C.VEL_P_XY], c[_C.VEL_D_XY]) if j < 2 else (c[_C.VEL_P_Z], c[_C.VEL_D_Z])
        acc_out[j] = p * (vel_sp[j] - i[_I.VEL + j]) + s[_M.VEL_INTEGRAL + j] - d * slope
    an, ae, ad = acc_out[0] + i[_I.ACC_SP], acc_out[1] + i[_I.ACC_SP + 1], acc_out[2] + i[_I.ACC_SP + 2]

    # Thrust vector: the horizontal acceleration sets the tilt as if the vertical were gravity alone.
    across = sqrt(an * an + ae * ae)
    tilt = atan2(across, GRAVITY_MPS2)
    tilt_given = min(tilt, c[_C.TILT_MAX])
    share = 1.0
    if tilt > tilt_given:
        share = sin(tilt_given) / cos(tilt_given) * GRAVITY_MPS2 / across
    for j in range(3):
        # While the tilt is limited the horizontal integrators stop where they are.
        if j == 2 or share == 1.0:
            gain = c[_C.VEL_I_XY] if j < 2 else c[_C.VEL_I_Z]
            s[_M.VEL_INTEGRAL + j] += gain * (vel_sp[j] - i[_I.VEL + j]) * dt_s
    s[_M.VEL_INTEGRAL + 2] = min(max(s[_M.VEL_INTEGRAL + 2], -GRAVITY_MPS2), GRAVITY_MPS2)
    zn, ze, zd = -an * share, -ae * share, GRAVITY_MPS2
    norm = sqrt(zn * zn + ze * ze + zd * zd)
    zn, ze, zd = zn / norm, ze / norm, zd / norm
    thrust = max(c[_C.WEIGHT] * (1.0 - ad / GRAVITY_MPS2) / zd, 0.1 * c[_C.WEIGHT])

    # Attitude: the rotation from the measured to the wanted frame, about the body's axes.
    moment = np.empty(3)
    cy, sy = cos(i[_I.YAW_SP]), sin(i[_I.YAW_SP])
    xn, xe, xd = cy * zd, sy * zd, -cy * zn - sy * ze
    norm = sqrt(xn * xn + xe * xe + xd * xd)
    xn, xe, xd = xn / norm, xe / norm, xd / norm
    yn, ye, yd = ze * xd - zd * xe, zd * xn - zn * xd, zn * xe - ze * xn
    R = np.empty((3, 3))
    level_from_frd(R, i[_I.EULER], i[_I.EULER + 1], i[_I.EULER + 2])
    # Vector part of the rotation, half the antisymmetric part of its matrix: exact to third order of the angle.
    across_x = R[0, 2] * yn + R[1, 2] * ye + R[2, 2] * yd - (R[0, 1] * zn + R[1, 1] * ze + R[2, 1] * zd)
    across_y = R[0, 0] * zn + R[1, 0] * ze + R[2, 0] * zd - (R[0, 2] * xn + R[1, 2] * xe + R[2, 2] * xd)
    across_z = R[0, 1] * xn + R[1, 1] * xe + R[2, 1] * xd - (R[0, 0] * yn + R[1, 0] * ye + R[2, 0] * yd)
    moment[0], moment[1], moment[2] = 0.5 * across_x, 0.5 * across_y, 0.5 * across_z

    # Body rates.
    for j in range(3):
        gain = c[_C.ATT_P_YAW] if j == 2 else c[_C.ATT_P_TILT]
        wanted = min(max(gain * moment[j], -c[_C.RATE_MAX]), c[_C.RATE_MAX])
        error = wanted - i[_I.RATE + j]
        slope = (i[_I.RATE + j] - s[_M.RATE_SLOW + j]) / c[_C.RATE_D_LAG]
        s[_M.RATE_SLOW + j] += dt_s * slope
        p, d = (c[_C.RATE_P_YAW], 0.0) if j == 2 else (c[_C.RATE_P_TILT], c[_C.RATE_D_TILT])
        moment[j] = c[_C.INERTIA + j] * (p * error + s[_M.RATE_INTEGRAL + j] - d * slope)
        s[_M.RATE_INTEGRAL + j] += c[_C.RATE_I] * error * dt_s

    # Allocation.
    for j in range(omega_out.shape[0]):
        t = allocation[j, 0] * thrust + allocation[j, 1] * moment[0]
        t += allocation[j, 2] * moment[1] + allocation[j, 3] * moment[2]
        t = min(max(t, 0.0), c[_C.ROTOR_THRUST_MAX])
        omega_out[j] = sqrt(t / (c[_C.DENSITY_RATIO] * rotors[j, Rotor.THRUST]))
