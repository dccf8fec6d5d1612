"""Unscented Kalman filter of a tether's direction on the sphere; (9)-(21) of [1]_ without their singularity.

[1]_ keeps inclination and azimuth, and the azimuth is undefined where the tether hangs straight down: there its rate,
its deviation and the terms with 1 / sin(theta) are without bounds. Here the state is a unit vector n from the vehicle
to the load with its derivative across it, as smooth at the vertical as anywhere else, and inclination and azimuth are
only reported. The error of a direction is two numbers in a basis (e1, e2) across n, the angle along the great circle
from the mean to the truth; that of a derivative is its difference after the true one was carried back along it. Sigma
points, mean and covariance are made of those.

    n'' = (f - n (n . f)) / l - |n'|^2 n          f = g e_z + d - a_p

is the tether below a pivot with the acceleration a_p: gravity, inertia, centrifugal and Coriolis terms of (6), (7)
with their signs put right. d is the horizontal pull over mass with which others hold the same load, or the wind on it:
a slow random walk, zero and certain for a load of its own in still air. With 1 / l = 0 it is the great circle, along
which only noise accelerates: the model (13).

Level frame that does not turn, x forward, y right, z down.

.. [1] Y. Ohira, A. Asignacion, S. Suzuki, Payload state estimation for cooperative manipulation using multiple UAVs.
"""

from enum import IntEnum
from math import atan2, cos, hypot, sin, sqrt

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.linalg import cholesky
from swingd.core.status import Status


class TetherState(IntEnum):
    """Offsets into the state, 11 numbers of which 6 are free."""

    DIRECTION = 0
    """n, from the vehicle to the load, 3."""
    RATE = 3
    """n' [1/s], across n, 3."""
    BASIS = 6
    """e1, across n, 3; e2 = n x e1. It moves with n without turning about it."""
    PULL = 9
    """d, x and y [m/s^2]."""
    SIZE = 11


NUM_ERRORS = 6
"""Angle along e1, e2 [rad], rate along them [1/s], pull along x, y [m/s^2]."""
POINTS = 2 * NUM_ERRORS
MEAN_ITERATIONS_MAX = 8
MEAN_TOLERANCE = 1e-12

_N = int(TetherState.DIRECTION)
_V = int(TetherState.RATE)
_E = int(TetherState.BASIS)
_D = int(TetherState.PULL)
_SIZE = int(TetherState.SIZE)
_OK = int(Status.OK)
_GATED = int(Status.GATED)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)
_SPREAD = sqrt(float(NUM_ERRORS))
"""Of the sigma points, in deviations: kappa = 0, no point in the middle and all weights alike."""


@kernel(VOID(VEC))
def straighten(x):
    """Make n and e1 of unit length and v and e1 normal to n, in place."""
    size = sqrt(x[_N] * x[_N] + x[_N + 1] * x[_N + 1] + x[_N + 2] * x[_N + 2])
    along_v, along_e = 0.0, 0.0
    for i in range(3):
        x[_N + i] /= size
        along_v += x[_N + i] * x[_V + i]
        along_e += x[_N + i] * x[_E + i]
    size = 0.0
    for i in range(3):
        x[_V + i] -= along_v * x[_N + i]
        x[_E + i] -= along_e * x[_N + i]
        size += x[_E + i] * x[_E + i]
    size = sqrt(size)
    for i in range(3):
        x[_E + i] /= size


@kernel(VOID(VEC))
def hang(x_out):
    """Write the tether at rest straight down, held by nobody else, (11,)."""
    x_out[:] = 0.0
    x_out[_N + 2] = 1.0
    x_out[_E] = 1.0


@kernel(VOID(VEC, VEC, VEC))
def _carry(w, a, b):
    """Carry w, normal to the unit vector a, along the great circle to the unit vector b, in place."""
    onto, share = 0.0, 1.0
    for i in range(3):
        onto += b[i] * w[i]
        share += a[i] * b[i]
    onto /= max(share, 1e-12)
    for i in range(3):
        w[i] -= onto * (a[i] + b[i])


@kernel(VOID(VEC, VEC, VEC))
def moved(x_out, x, error):
    """Give the state that differs from another by an error.

    Parameters
    ----------
    x_out : (11,), written
        Not ``x``.
    x : (11,)
    error : (6,)
        See `NUM_ERRORS`.
    """
    n, e1 = x[_N : _N + 3], x[_E : _E + 3]
    e2 = (n[1] * e1[2] - n[2] * e1[1], n[2] * e1[0] - n[0] * e1[2], n[0] * e1[1] - n[1] * e1[0])
    angle = hypot(error[0], error[1])
    c, s = cos(angle), (sin(angle) / angle if angle > 1e-9 else 1.0)
    for i in range(3):
        x_out[_N + i] = c * n[i] + s * (error[0] * e1[i] + error[1] * e2[i])
        x_out[_V + i] = x[_V + i] + error[2] * e1[i] + error[3] * e2[i]
        x_out[_E + i] = e1[i]
    x_out[_D], x_out[_D + 1] = x[_D] + error[4], x[_D + 1] + error[5]
    _carry(x_out[_V : _V + 3], n, x_out[_N : _N + 3])
    _carry(x_out[_E : _E + 3], n, x_out[_N : _N + 3])
    straighten(x_out)


@kernel(VOID(VEC, VEC, VEC))
def angle_to(angle_out, x, direction):
    """Angle from a state's direction to another along e1 and e2, the inverse of `moved`.

    Parameters
    ----------
    angle_out : (2,), written
        Its length is in [0, pi]; zero for the opposite direction, to which no great circle leads before others [rad].
    x : (11,)
    direction : (3,)
        Of any length but zero.
    """
    n, e1 = x[_N : _N + 3], x[_E : _E + 3]
    e2 = (n[1] * e1[2] - n[2] * e1[1], n[2] * e1[0] - n[0] * e1[2], n[0] * e1[1] - n[1] * e1[0])
    first, second, along = 0.0, 0.0, 0.0
    for i in range(3):
        first += direction[i] * e1[i]
        second += direction[i] * e2[i]
        along += direction[i] * n[i]
    across = hypot(first, second)
    size = hypot(across, along)
    if across > 1e-9 * size:
        scale = atan2(across, along) / across
    else:
        scale = 1.0 / size if along > 0.0 else 0.0
    angle_out[0], angle_out[1] = scale * first, scale * second


@kernel(VOID(VEC, VEC, VEC))
def error_to(error_out, x, other):
    """Error of a state against another (11,), the inverse of `moved`, as (6,)."""
    angle_to(error_out[:2], x, other[_N : _N + 3])
    n, e1 = x[_N : _N + 3], x[_E : _E + 3]
    e2 = (n[1] * e1[2] - n[2] * e1[1], n[2] * e1[0] - n[0] * e1[2], n[0] * e1[1] - n[1] * e1[0])
    back = other[_V : _V + 3].copy()
    _carry(back, other[_N : _N + 3], n)
    error_out[2], error_out[3] = 0.0, 0.0
    for i in range(3):
        error_out[2] += (back[i] - x[_V + i]) * e1[i]
        error_out[3] += (back[i] - x[_V + i]) * e2[i]
    error_out[4], error_out[5] = other[_D] - x[_D], other[_D + 1] - x[_D + 1]


@kernel(VOID(VEC, VEC, VEC, F8))
def acceleration(acc_out, x, pivot_acc, inv_length):
    """Give n'' of a tether below an accelerated pivot; see the module.

    Parameters
    ----------
    acc_out : (3,), written
        [1/s^2]
    x : (11,)
    pivot_acc : (3,)
        Inertial acceleration of the upper end [m/s^2].
    inv_length : float
        1 / l [1/m]; 0 for an end that others hold.
    """
    along, speed2 = 0.0, 0.0
    for i in range(3):
        felt = (GRAVITY_MPS2 if i == 2 else x[_D + i]) - pivot_acc[i]
        along += felt * x[_N + i]
        speed2 += x[_V + i] * x[_V + i]
    for i in range(3):
        felt = (GRAVITY_MPS2 if i == 2 else x[_D + i]) - pivot_acc[i]
        acc_out[i] = inv_length * (felt - along * x[_N + i]) - speed2 * x[_N + i]


@kernel(VOID(VEC, VEC, F8, F8))
def swing_on(x, pivot_acc, inv_length, dt_s):
    """Advance direction and rate by one classical Runge-Kutta step, the pivot's acceleration held, in place.

    The basis goes along, the pull stays. See `acceleration` for the arguments.
    """
    before = x[_N : _N + 3].copy()
    trial, end = x.copy(), x.copy()
    acc = np.empty(3)
    for weight, ahead in ((1.0 / 6.0, 0.5), (1.0 / 3.0, 0.5), (1.0 / 3.0, 1.0), (1.0 / 6.0, 0.0)):
        acceleration(acc, trial, pivot_acc, inv_length)
        for i in range(3):
            rate = trial[_V + i]
            end[_N + i] += dt_s * weight * rate
            end[_V + i] += dt_s * weight * acc[i]
            trial[_N + i] = x[_N + i] + dt_s * ahead * rate
            trial[_V + i] = x[_V + i] + dt_s * ahead * acc[i]
    size = sqrt(end[_N] ** 2 + end[_N + 1] ** 2 + end[_N + 2] ** 2)
    for i in range(3):
        x[_N + i] = end[_N + i] / size
        x[_V + i] = end[_V + i]
    _carry(x[_E : _E + 3], before, x[_N : _N + 3])
    straighten(x)


@kernel(I8(MAT, VEC, MAT))
def _spread(points_out, x, P):
    """Write the sigma points (12, 11) of a state; ``NOT_POSITIVE`` where the covariance has no root."""
    L = np.empty((NUM_ERRORS, NUM_ERRORS))
    if cholesky(L, P) != _OK:
        return _NOT_POSITIVE
    error = np.empty(NUM_ERRORS)
    for k in range(NUM_ERRORS):
        for sign in range(2):
            for i in range(NUM_ERRORS):
                error[i] = (1.0 - 2.0 * sign) * _SPREAD * L[i, k]
            moved(points_out[2 * k + sign], x, error)
    return _OK


@kernel(I8(VEC, MAT, VEC, F8, F8, F8, F8))
def predict(x, P, pivot_acc, inv_length, acc_var, pull_var, dt_s):
    """Carry mean and covariance over one interval by sigma points, (13), (18)-(21).

    Parameters
    ----------
    x, P : (11,), (6, 6), changed
        State and covariance of its error; untouched unless ``OK``.
    pivot_acc : (3,)
        See `acceleration`.
    inv_length : float
        See `acceleration`.
    acc_var : float
        Sigma of (19): variance of the acceleration along e1 and along e2 that is held over this interval [1/s^4].
        What reaches the covariance is Gamma Sigma Gamma^T with the Gamma of (20); a density q [1/s^3] is q / dt.
    pull_var : float
        What the pull's variance grows by over this interval, each axis [m^2/s^4].
    dt_s : float
        Interval [s], short against the pendulum's period; 0 changes nothing.

    Returns
    -------
    Status
        ``OK``, ``NOT_POSITIVE`` or ``NOT_FINITE``.

    Notes
    -----
    The mean is the one of the points on the sphere, found by going where their mean error vanishes.
    """
    points = np.empty((POINTS, _SIZE))
    if _spread(points, x, P) != _OK:
        return _NOT_POSITIVE
    for k in range(POINTS):
        swing_on(points[k], pivot_acc, inv_length, dt_s)
    mean = x.copy()
    swing_on(mean, pivot_acc, inv_length, dt_s)
    errors = np.empty((POINTS, NUM_ERRORS))
    shift, trial = np.empty(NUM_ERRORS), np.empty(_SIZE)
    for _ in range(MEAN_ITERATIONS_MAX):
        shift[:] = 0.0
        for k in range(POINTS):
            error_to(errors[k], mean, points[k])
            for i in range(NUM_ERRORS):
                shift[i] += errors[k, i] / POINTS
        size = 0.0
        for i in range(NUM_ERRORS):
            size = max(size, abs(shift[i]))
        if size < MEAN_TOLERANCE:
            break
        moved(trial, mean, shift)
        mean[:] = trial
    P_next = np.empty((NUM_ERRORS, NUM_ERRORS))
    total = 0.0
    for i in range(NUM_ERRORS):
        for j in range(i + 1):
            entry = 0.0
            for k in range(POINTS):
                entry += (errors[k, i] - shift[i]) * (errors[k, j] - shift[j]) / POINTS
            if i >= 4:
                entry += pull_var if i == j else 0.0
            elif (i - j) % 2 == 0:
                # Gamma Sigma Gamma^T: angle with angle, rate with rate, rate with the angle along the same axis.
                gain_i = 0.5 * dt_s * dt_s if i < 2 else dt_s
                gain_j = 0.5 * dt_s * dt_s if j < 2 else dt_s
                entry += gain_i * gain_j * acc_var
            P_next[i, j] = entry
            P_next[j, i] = entry
            total += abs(entry)
    for i in range(_SIZE):
        total += abs(mean[i])
    if not np.isfinite(total):
        return _NOT_FINITE
    x[:] = mean
    P[:, :] = P_next
    return _OK


@kernel(VOID(MAT, VEC, VEC, MAT))
def direction_noise(R_out, x, force, force_cov):
    """Covariance of a direction that a noisy force shows, along e1 and e2.

    Parameters
    ----------
    R_out : (2, 2), written
        [rad^2]
    x : (11,)
        Where the force is expected to point.
    force : (3,)
        As measured, not zero [N].
    force_cov : (3, 3)
        Of its noise [N^2].
    """
    n, e1 = x[_N : _N + 3], x[_E : _E + 3]
    basis = np.empty((2, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        basis[0, i] = e1[i]
        basis[1, i] = n[j] * e1[k] - n[k] * e1[j]
    size2 = force[0] * force[0] + force[1] * force[1] + force[2] * force[2]
    for a in range(2):
        for b in range(2):
            total = 0.0
            for i in range(3):
                for j in range(3):
                    total += basis[a, i] * force_cov[i, j] * basis[b, j]
            R_out[a, b] = total / size2


@kernel(I8(VEC, MAT, VEC, VEC, MAT, F8))
def correct(x, P, nis_out, direction, R, nis_gate):
    """Correct the state by a measured direction: that of the cable force, (9)-(11) with -F_s.

    Parameters
    ----------
    x, P : (11,), (6, 6), changed
        Untouched unless ``OK``.
    nis_out : (1,), written
        Normalised innovation squared, 2 degrees of freedom.
    direction : (3,)
        Any length but zero.
    R : (2, 2)
        Covariance along e1 and e2 [rad^2], positive definite.
    nis_gate : float
        A measurement above it is left out; infinite: none is.

    Returns
    -------
    Status
        ``OK``, ``GATED``, ``NOT_POSITIVE`` or ``NOT_FINITE``.

    Notes
    -----
    In these errors the measurement is the angle itself: P_xy and P_yy of the sigma points are columns of P, and
    K = P_xy P_yy^-1 needs none. The covariance keeps Joseph's form and goes along with the corrected mean.
    """
    nu = np.empty(2)
    angle_to(nu, x, direction)
    s_00, s_11 = P[0, 0] + R[0, 0], P[1, 1] + R[1, 1]
    s_10 = P[1, 0] + R[1, 0]
    determinant = s_00 * s_11 - s_10 * s_10
    if not (s_00 > 0.0 and determinant > 0.0):
        return _NOT_POSITIVE
    nis = (s_11 * nu[0] * nu[0] - 2.0 * s_10 * nu[0] * nu[1] + s_00 * nu[1] * nu[1]) / determinant
    if not np.isfinite(nis):
        return _NOT_FINITE
    nis_out[0] = nis
    if nis > nis_gate:
        return _GATED
    K = np.empty((NUM_ERRORS, 2))
    shift = np.empty(NUM_ERRORS)
    for i in range(NUM_ERRORS):
        K[i, 0] = (P[i, 0] * s_11 - P[i, 1] * s_10) / determinant
        K[i, 1] = (P[i, 1] * s_00 - P[i, 0] * s_10) / determinant
        shift[i] = K[i, 0] * nu[0] + K[i, 1] * nu[1]
    left, P_next = np.empty((NUM_ERRORS, NUM_ERRORS)), np.empty((NUM_ERRORS, NUM_ERRORS))
    for i in range(NUM_ERRORS):
        for j in range(NUM_ERRORS):
            left[i, j] = P[i, j] - K[i, 0] * P[0, j] - K[i, 1] * P[1, j]
    total = 0.0
    for i in range(NUM_ERRORS):
        for j in range(i + 1):
            entry = left[i, j] - left[i, 0] * K[j, 0] - left[i, 1] * K[j, 1]
            for a in range(2):
                for b in range(2):
                    entry += K[i, a] * R[a, b] * K[j, b]
            P_next[i, j] = entry
            P_next[j, i] = entry
            total += abs(entry)
    corrected = np.empty(_SIZE)
    moved(corrected, x, shift)
    for i in range(_SIZE):
        total += abs(corrected[i])
    if not np.isfinite(total):
        return _NOT_FINITE
    x[:] = corrected
    P[:, :] = P_next
    return _OK


@kernel(VOID(VEC, VEC))
def spherical(angles_out, x):
    """Inclination and azimuth as (12) has them.

    Parameters
    ----------
    angles_out : (4,), written
        theta in [0, pi] [rad], its rate, phi from x to y in (-pi, pi] [rad], its rate; 0 for azimuth and its rate
        where the tether is vertical: they mean nothing there.
    x : (11,)
    """
    across = hypot(x[_N], x[_N + 1])
    angles_out[0] = atan2(across, x[_N + 2])
    if across > 1e-12:
        angles_out[1] = (x[_N] * x[_V] + x[_N + 1] * x[_V + 1]) / across * x[_N + 2] - across * x[_V + 2]
        angles_out[2] = atan2(x[_N + 1], x[_N])
        angles_out[3] = (x[_N] * x[_V + 1] - x[_N + 1] * x[_V]) / (across * across)
    else:
        angles_out[1] = hypot(x[_V], x[_V + 1])
        angles_out[2], angles_out[3] = 0.0, 0.0


@kernel(VOID(VEC, VEC))
def swing_angles(swing_out, x):
    """xi, zeta [rad] and their rates [rad/s] of a state, as (4,); see `swingd.core.swing_ekf.State`."""
    across2 = x[_N + 1] * x[_N + 1] + x[_N + 2] * x[_N + 2]
    across2 = max(across2, 1e-12)
    swing_out[0] = atan2(-x[_N + 1], x[_N + 2])
    swing_out[1] = atan2(x[_N], sqrt(across2))
    swing_out[2] = (x[_N + 1] * x[_V + 2] - x[_N + 2] * x[_V + 1]) / across2
    swing_out[3] = x[_V] / sqrt(across2)


@kernel(VOID(VEC, VEC, VEC, F8))
def swing_rates(rate_out, x, pivot_acc, inv_length):
    """Time derivative of `swing_angles` by the model, as (4,); see `acceleration` for the arguments."""
    swing, acc = np.empty(4), np.empty(3)
    swing_angles(swing, x)
    acceleration(acc, x, pivot_acc, inv_length)
    y, z, y_rate, z_rate = x[_N + 1], x[_N + 2], x[_V + 1], x[_V + 2]
    across2 = max(y * y + z * z, 1e-12)
    across = sqrt(across2)
    across2_rate = 2.0 * (y * y_rate + z * z_rate)
    rate_out[0], rate_out[1] = swing[2], swing[3]
    rate_out[2] = (y * acc[2] - z * acc[1] - swing[2] * across2_rate) / across2
    rate_out[3] = (acc[0] - swing[3] * 0.5 * across2_rate / across) / across


@kernel(I8(MAT, VEC, MAT))
def swing_covariance(P_out, x, P):
    """Covariance (4, 4) of `swing_angles` by sigma points; ``NOT_POSITIVE`` where P has no root."""
    points = np.empty((POINTS, _SIZE))
    if _spread(points, x, P) != _OK:
        return _NOT_POSITIVE
    centre, swing = np.empty(4), np.empty((POINTS, 4))
    swing_angles(centre, x)
    P_out[:, :] = 0.0
    for k in range(POINTS):
        swing_angles(swing[k], points[k])
        for i in range(4):
            swing[k, i] -= centre[i]
        for i in range(4):
            for j in range(4):
                P_out[i, j] += swing[k, i] * swing[k, j] / POINTS
    return _OK
