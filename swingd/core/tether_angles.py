"""The tether UKF as its paper has it, on inclination and azimuth: the comparison for `swingd.core.tether_ukf`.

States theta, theta', phi, phi' of (12) in the vehicle's heading frame, x along its nose, z down; phi from x to y, so
that phi = phi_b + pi/2 with the phi_b of (1). The frame turns: the vehicle's yaw rate and acceleration enter. Undefined
at theta = 0: there 1 / sin(theta) is held at 1 / `SIN_MIN`, and a state that passes through is turned to the other
side.

Equations of Y. Ohira, A. Asignacion, S. Suzuki, Payload state estimation for cooperative manipulation using multiple
UAVs. Misprints that matter here: (2) must have +cos(theta); (10), (11) must use -F_s; (14) must read a_0 = a_d + a_rel;
the force in (6), (7), (17) stands for the pivot's acceleration and enters with the wrong sign.
"""

from enum import IntEnum
from math import atan2, cos, hypot, pi, sin

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.linalg import cholesky
from swingd.core.status import Status


class TetherAngle(IntEnum):
    """Offsets into the state (12)."""

    THETA = 0
    THETA_RATE = 1
    PHI = 2
    PHI_RATE = 3
    SIZE = 4


class TetherModel(IntEnum):
    """What accelerates the tether."""

    PRINTED = 0
    """(17) to the letter: drives the estimate away from the truth."""
    PIVOT = 1
    """(6), (7) below an accelerating pivot, signs put right: a load of its own."""
    RANDOM = 2
    """(13), the discrete Wiener process acceleration model: a load that others hold as well."""


SIN_MIN = 1e-2
"""Smallest sine of the inclination that divides anything."""
POINTS = 8

_T = TetherAngle
_OK = int(Status.OK)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)
_PRINTED = int(TetherModel.PRINTED)
_PIVOT = int(TetherModel.PIVOT)


@kernel(F8(F8))
def _divisor(sine):
    return max(sine, SIN_MIN) if sine >= 0.0 else min(sine, -SIN_MIN)


@kernel(F8(F8))
def _wrapped(angle):
    return angle - 2.0 * pi * np.floor((angle + pi) / (2.0 * pi))


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, F8, F8, I8, I8))
def angle_rates(x_rate_out, x, force, rel_acc, turn, inv_length, mass_kg, model, rotating):
    """Right side of (17) or of what it should be.

    Parameters
    ----------
    x_rate_out : (4,), written
    x : (4,)
        theta [rad], its rate, phi, its rate.
    force : (3,)
        ``PRINTED``: thrust R_f F_f less m a_d [N]; ``PIVOT``: acceleration a_d of the vehicle [m/s^2]. Heading frame.
    rel_acc : (3,)
        ``PRINTED``: a_rel of the step before, (15), (16) [m/s^2]; not used by the others.
    turn : (2,)
        Yaw rate [rad/s] and acceleration [rad/s^2] of the vehicle. ``RANDOM`` leaves the acceleration to the noise, as
        the azimuth of a load that turns with its vehicles stays; the rate enters the rotating terms.
    inv_length, mass_kg : float
        1 / l [1/m]; m of (17): the vehicle's.
    model : TetherModel
    rotating : int
        1: with the centrifugal and Coriolis terms of (6), (7); 0: without, as (17).
    """
    s, c = sin(x[_T.THETA]), cos(x[_T.THETA])
    s_phi, c_phi = sin(x[_T.PHI]), cos(x[_T.PHI])
    along_theta, along_phi = 0.0, 0.0
    if model == _PRINTED:
        fx, fy, fz = force[0] + mass_kg * rel_acc[0], force[1] + mass_kg * rel_acc[1], force[2] + mass_kg * rel_acc[2]
        share = inv_length / mass_kg
    else:
        fx, fy, fz = -force[0], -force[1], -force[2]
        share = inv_length
    theta_acc, phi_acc = 0.0, 0.0
    if model in (_PRINTED, _PIVOT):
        along_theta = fx * c * c_phi + fy * c * s_phi - fz * s
        along_phi = -fx * s_phi + fy * c_phi
        theta_acc = -GRAVITY_MPS2 * inv_length * s + share * along_theta
        phi_acc = share * along_phi / _divisor(s) - turn[1]
    if rotating == 1:
        phi_rate = x[_T.PHI_RATE] + turn[0]
        theta_acc += phi_rate * phi_rate * s * c
        phi_acc -= 2.0 * x[_T.THETA_RATE] * phi_rate * c / _divisor(s)
    x_rate_out[_T.THETA] = x[_T.THETA_RATE]
    x_rate_out[_T.THETA_RATE] = theta_acc
    x_rate_out[_T.PHI] = x[_T.PHI_RATE]
    x_rate_out[_T.PHI_RATE] = phi_acc


@kernel(VOID(VEC, VEC, VEC, F8))
def relative_acceleration(acc_out, x, x_rate, length_m):
    """a_rel of (15), (16), with the u_r that belongs to (3), (4); heading frame, as (3,) [m/s^2]."""
    s, c = sin(x[_T.THETA]), cos(x[_T.THETA])
    s_phi, c_phi = sin(x[_T.PHI]), cos(x[_T.PHI])
    a_r = -length_m * x[_T.THETA_RATE] * x[_T.THETA_RATE]
    a_theta = length_m * x_rate[_T.THETA_RATE]
    a_phi = length_m * x_rate[_T.PHI_RATE] * s
    acc_out[0] = a_r * s * c_phi + a_theta * c * c_phi - a_phi * s_phi
    acc_out[1] = a_r * s * s_phi + a_theta * c * s_phi + a_phi * c_phi
    acc_out[2] = a_r * c - a_theta * s


@kernel(VOID(VEC, VEC))
def observed_angles(angles_out, force):
    """(10), (11) of the pull -F_s on the vehicle, heading frame: theta in [0, pi] and phi in (-pi, pi], (2,) [rad]."""
    angles_out[0] = atan2(hypot(force[0], force[1]), force[2])
    angles_out[1] = atan2(force[1], force[0])


@kernel(VOID(VEC, MAT))
def _unfold(x, P):
    """Give a tether that swung through the vertical, theta < 0, as one with theta > 0 on the other side."""
    if x[_T.THETA] < 0.0:
        x[_T.THETA] = -x[_T.THETA]
        x[_T.THETA_RATE] = -x[_T.THETA_RATE]
        x[_T.PHI] += pi
        for i in range(2):
            for j in range(2, 4):
                P[i, j] = -P[i, j]
                P[j, i] = -P[j, i]
    x[_T.PHI] = _wrapped(x[_T.PHI])


@kernel(I8(VEC, MAT, VEC, VEC, VEC, VEC, VEC, F8, F8, F8, I8, I8))
def predict(x, P, rel_acc, force, turn, rates, sigma, dt_s, inv_length, mass_kg, model, rotating):
    """Carry mean and covariance over one interval, (13)-(21).

    Parameters
    ----------
    x, P : (4,), (4, 4), changed
        Untouched unless ``OK``.
    rel_acc : (3,), changed
        a_rel of the step before on entry, of this one on return; see `angle_rates`.
    force, turn : (3,), (2,)
        See `angle_rates`.
    rates : (4,), written
        Right side at the mean before the step.
    sigma : (2,)
        Deviations of the noise accelerations of theta and phi, (18), (19) [rad/s^2].
    dt_s : float
        T_s [s].
    inv_length, mass_kg, model, rotating
        See `angle_rates`.

    Returns
    -------
    Status
        ``OK``, ``NOT_POSITIVE`` or ``NOT_FINITE``.
    """
    L = np.empty((4, 4))
    if cholesky(L, P) != _OK:
        return _NOT_POSITIVE
    points = np.empty((POINTS, 4))
    mean = np.zeros(4)
    k1, k2, k3, k4, trial = np.empty(4), np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    for k in range(POINTS):
        column, sign = k // 2, 1.0 - 2.0 * (k % 2)
        at = points[k]
        for i in range(4):
            at[i] = x[i] + 2.0 * sign * L[i, column]
        angle_rates(k1, at, force, rel_acc, turn, inv_length, mass_kg, model, rotating)
        for i in range(4):
            trial[i] = at[i] + 0.5 * dt_s * k1[i]
        angle_rates(k2, trial, force, rel_acc, turn, inv_length, mass_kg, model, rotating)
        for i in range(4):
            trial[i] = at[i] + 0.5 * dt_s * k2[i]
        angle_rates(k3, trial, force, rel_acc, turn, inv_length, mass_kg, model, rotating)
        for i in range(4):
            trial[i] = at[i] + dt_s * k3[i]
        angle_rates(k4, trial, force, rel_acc, turn, inv_length, mass_kg, model, rotating)
        for i in range(4):
            at[i] += dt_s / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
            mean[i] += at[i] / POINTS
    angle_rates(rates, x, force, rel_acc, turn, inv_length, mass_kg, model, rotating)
    P_next = np.empty((4, 4))
    total = 0.0
    for i in range(4):
        for j in range(i + 1):
            entry = 0.0
            for k in range(POINTS):
                entry += (points[k, i] - mean[i]) * (points[k, j] - mean[j]) / POINTS
            if i // 2 == j // 2:
                gain_i = 0.5 * dt_s * dt_s if i % 2 == 0 else dt_s
                gain_j = 0.5 * dt_s * dt_s if j % 2 == 0 else dt_s
                entry += gain_i * gain_j * sigma[i // 2] * sigma[i // 2]
            P_next[i, j] = entry
            P_next[j, i] = entry
            total += abs(entry)
        total += abs(mean[i])
    if not np.isfinite(total):
        return _NOT_FINITE
    if inv_length > 0.0:
        relative_acceleration(rel_acc, x, rates, 1.0 / inv_length)
    x[:] = mean
    P[:, :] = P_next
    _unfold(x, P)
    return _OK


@kernel(I8(VEC, MAT, VEC, VEC))
def correct(x, P, angles, R_diag):
    """Correct the state by the observed angles: K = P_xy P_yy^-1, the azimuth's innovation taken the short way round.

    Parameters
    ----------
    x, P : (4,), (4, 4), changed
        Untouched unless ``OK``.
    angles : (2,)
        See `observed_angles`.
    R_diag : (2,)
        Their variances [rad^2].

    Returns
    -------
    Status
        ``OK``, ``NOT_POSITIVE`` or ``NOT_FINITE``.
    """
    s_00, s_11, s_10 = P[0, 0] + R_diag[0], P[2, 2] + R_diag[1], P[2, 0]
    determinant = s_00 * s_11 - s_10 * s_10
    if not (s_00 > 0.0 and determinant > 0.0):
        return _NOT_POSITIVE
    nu_0, nu_1 = angles[0] - x[_T.THETA], _wrapped(angles[1] - x[_T.PHI])
    K = np.empty((4, 2))
    left, x_next, P_next = np.empty((4, 4)), np.empty(4), np.empty((4, 4))
    total = 0.0
    for i in range(4):
        K[i, 0] = (P[i, 0] * s_11 - P[i, 2] * s_10) / determinant
        K[i, 1] = (P[i, 2] * s_00 - P[i, 0] * s_10) / determinant
        x_next[i] = x[i] + K[i, 0] * nu_0 + K[i, 1] * nu_1
        total += abs(x_next[i])
        for j in range(4):
            left[i, j] = P[i, j] - K[i, 0] * P[0, j] - K[i, 1] * P[2, j]
    for i in range(4):
        for j in range(i + 1):
            entry = left[i, j] - left[i, 0] * K[j, 0] - left[i, 2] * K[j, 1]
            entry += K[i, 0] * R_diag[0] * K[j, 0] + K[i, 1] * R_diag[1] * K[j, 1]
            P_next[i, j] = entry
            P_next[j, i] = entry
            total += abs(entry)
    if not np.isfinite(total):
        return _NOT_FINITE
    x[:] = x_next
    P[:, :] = P_next
    _unfold(x, P)
    return _OK


@kernel(VOID(VEC, VEC))
def direction(direction_out, x):
    """u_r of (2) with its sign put right: unit vector from the vehicle to the load, heading frame, (3,)."""
    s = sin(x[_T.THETA])
    direction_out[0] = s * cos(x[_T.PHI])
    direction_out[1] = s * sin(x[_T.PHI])
    direction_out[2] = cos(x[_T.THETA])
