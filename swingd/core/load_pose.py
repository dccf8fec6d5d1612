"""Pose of a load that hangs on any number of tethers, by least squares over its anchors.

Horn's alignment of the anchors as seen (hook plus length times direction) with those of the drawing starts it [1]_;
Gauss-Newton then weighs what each tether tells for what it is: its length well, its direction less well. Attitude
angles that are known otherwise, such as the pitch from a winch, enter as measurements; what nothing tells is a status.

.. [1] B. K. P. Horn, Closed-form solution of absolute orientation using unit quaternions, J. Opt. Soc. Am. A 4 (1987).
"""

from enum import IntEnum
from math import asin, atan2, cos, pi, sin, sqrt

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.linalg import cholesky, cholesky_solve
from swingd.core.status import Status


class TetherRow(IntEnum):
    """Columns of what is known of each tether."""

    HOOK = 0
    """Upper end, ned, 3 [m]."""
    DIRECTION = 3
    """Unit vector to the load, ned, 3; not used unless told."""
    LENGTH = 6
    """[m]"""
    LENGTH_STD = 7
    """Hook's and anchor's position along the tether included [m], > 0; infinite: the length tells nothing."""
    ANCHOR = 8
    """Lower end on the load, from its CG, frd, 3 [m]."""
    TOLD = 11
    """1 where the direction is measured, else 0."""
    SIZE = 12


ITERATIONS_MAX = 60
STEP_CONVERGED = 1e-8
"""In deviations of the information's diagonal."""
STEP_ROUNDING = 1e-3
"""A step so small that no longer lowers the cost is rounding."""
TURN_MAX_RAD = 0.2
"""Of one iteration."""
PIVOT_MIN = 1e-8
"""Of the scaled information: below it a direction of the pose is told by nothing."""
SWEEPS_MAX = 40
COS_PITCH_MIN = 1e-3
UNKNOWN = 6

_R = TetherRow
_OK = int(Status.OK)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)


@kernel(VOID(MAT, F8, F8, F8))
def _turn(R, x, y, z):
    """R = R exp([x y z] cross), Rodrigues."""
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        s, c = 1.0, 0.5
    else:
        s, c = sin(angle) / angle, (1.0 - cos(angle)) / (angle * angle)
    w = (x, y, z)
    row = np.empty(3)
    for i in range(3):
        for j in range(3):
            row[j] = R[i, j]
        dot = row[0] * x + row[1] * y + row[2] * z
        cross = (row[1] * z - row[2] * y, row[2] * x - row[0] * z, row[0] * y - row[1] * x)
        for j in range(3):
            R[i, j] = cos(angle) * row[j] + s * cross[j] + c * dot * w[j]


@kernel(VOID(VEC, MAT))
def euler(angles_out, R):
    """Roll, pitch, yaw (3,) of a rotation matrix, 3-2-1."""
    angles_out[0] = atan2(R[2, 1], R[2, 2])
    angles_out[1] = asin(min(max(-R[2, 0], -1.0), 1.0))
    angles_out[2] = atan2(R[1, 0], R[0, 0])


@kernel(I8(MAT, MAT, MAT, VEC, MAT, F8))
def align(R_out, seen, drawn, weights, R_prior, prior_weight):
    """Rotation that takes points of the drawing to points as seen, each about its own weighted centre [1]_.

    Parameters
    ----------
    R_out : (3, 3), written
    seen, drawn : (n, 3)
    weights : (n,)
        Not negative.
    R_prior : (3, 3)
        Attitude that is chosen where the points leave a choice.
    prior_weight : float
        Of it [m^2], small against the points' spread; 0: none.

    Returns
    -------
    Status
        ``OK``; ``NOT_POSITIVE`` where the points leave a choice and nothing chooses; ``NOT_CONVERGED``.
    """
    n = seen.shape[0]
    M = np.zeros((3, 3))
    centre_seen, centre_drawn = np.zeros(3), np.zeros(3)
    total = 0.0
    for k in range(n):
        total += weights[k]
        for i in range(3):
            centre_seen[i] += weights[k] * seen[k, i]
            centre_drawn[i] += weights[k] * drawn[k, i]
    if not total > 0.0:
        return _NOT_POSITIVE
    size = 0.0
    for k in range(n):
        for i in range(3):
            for j in range(3):
                # Rows: drawing, columns: as seen, as in [1]_.
                M[i, j] += (
                    weights[k] / total
                    * (drawn[k, i] - centre_drawn[i] / total)
                    * (seen[k, j] - centre_seen[j] / total)
                )  # fmt: skip
    for i in range(3):
        for j in range(3):
            M[i, j] += prior_weight * R_prior[j, i]
            size += abs(M[i, j])
    if not np.isfinite(size):
        return _NOT_FINITE
    N = np.empty((4, 4))
    N[0, 0] = M[0, 0] + M[1, 1] + M[2, 2]
    N[0, 1] = M[1, 2] - M[2, 1]
    N[0, 2] = M[2, 0] - M[0, 2]
    N[0, 3] = M[0, 1] - M[1, 0]
    N[1, 1] = M[0, 0] - M[1, 1] - M[2, 2]
    N[1, 2] = M[0, 1] + M[1, 0]
    N[1, 3] = M[2, 0] + M[0, 2]
    N[2, 2] = -M[0, 0] + M[1, 1] - M[2, 2]
    N[2, 3] = M[1, 2] + M[2, 1]
    N[3, 3] = -M[0, 0] - M[1, 1] + M[2, 2]
    for i in range(4):
        for j in range(i):
            N[i, j] = N[j, i]
    # Jacobi's rotations: all eigenvectors, whatever the gaps.
    V = np.zeros((4, 4))
    for i in range(4):
        V[i, i] = 1.0
    for _ in range(SWEEPS_MAX):
        off = 0.0
        for i in range(4):
            for j in range(i):
                off += N[i, j] * N[i, j]
        if off <= 1e-30 * size * size:
            break
        for a in range(3):
            for b in range(a + 1, 4):
                if N[a, b] == 0.0:
                    continue
                half = 0.5 * atan2(2.0 * N[a, b], N[b, b] - N[a, a])
                c, s = cos(half), sin(half)
                for k in range(4):
                    N[k, a], N[k, b] = c * N[k, a] - s * N[k, b], s * N[k, a] + c * N[k, b]
                for k in range(4):
                    N[a, k], N[b, k] = c * N[a, k] - s * N[b, k], s * N[a, k] + c * N[b, k]
                    V[k, a], V[k, b] = c * V[k, a] - s * V[k, b], s * V[k, a] + c * V[k, b]
    best = 0
    for k in range(1, 4):
        if N[k, k] > N[best, best]:
            best = k
    gap = np.inf
    for k in range(4):
        if k != best:
            gap = min(gap, N[best, best] - N[k, k])
    if not gap > 1e-9 * size:
        return _NOT_POSITIVE
    w, x, y, z = V[0, best], V[1, best], V[2, best], V[3, best]
    R_out[0, 0], R_out[0, 1], R_out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R_out[1, 0], R_out[1, 1], R_out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R_out[2, 0], R_out[2, 1], R_out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return _OK


@kernel(F8(MAT, VEC, VEC, MAT, MAT, MAT, VEC, VEC))
def _normal_equations(A, b, p, R, rows, covs, angles, information):
    """Fill information matrix and right side (rotation about the load's axes, position); returns the cost."""
    A[:, :] = 0.0
    b[:] = 0.0
    cost = 0.0
    J, arm, d, unit = np.empty((3, UNKNOWN)), np.empty(3), np.empty(3), np.empty(3)
    e1, e2, j1, j2 = np.empty(3), np.empty(3), np.empty(UNKNOWN), np.empty(UNKNOWN)
    C = np.empty((2, 2))
    for k in range(rows.shape[0]):
        n = rows[k, _R.DIRECTION : _R.DIRECTION + 3]
        a = rows[k, _R.ANCHOR : _R.ANCHOR + 3]
        length2 = 0.0
        for i in range(3):
            arm[i] = R[i, 0] * a[0] + R[i, 1] * a[1] + R[i, 2] * a[2]
            d[i] = p[i] + arm[i] - rows[k, _R.HOOK + i]
            length2 += d[i] * d[i]
            # d of R exp(phi) a is R (phi x a).
            J[i, 0] = R[i, 2] * a[1] - R[i, 1] * a[2]
            J[i, 1] = R[i, 0] * a[2] - R[i, 2] * a[0]
            J[i, 2] = R[i, 1] * a[0] - R[i, 0] * a[1]
            for j in range(3):
                J[i, 3 + j] = 1.0 if i == j else 0.0
        length = sqrt(length2)
        for i in range(3):
            unit[i] = d[i] / length
        # Length.
        weight = 1.0 / rows[k, _R.LENGTH_STD] ** 2
        residual = length - rows[k, _R.LENGTH]
        cost += weight * residual * residual
        for i in range(UNKNOWN):
            j1[i] = unit[0] * J[0, i] + unit[1] * J[1, i] + unit[2] * J[2, i]
        for i in range(UNKNOWN):
            b[i] -= weight * residual * j1[i]
            for j in range(UNKNOWN):
                A[i, j] += weight * j1[i] * j1[j]
        if rows[k, _R.TOLD] < 0.5:
            continue
        # Direction: along two axes across the one measured.
        axis = 0
        for i in range(1, 3):
            if abs(n[i]) < abs(n[axis]):
                axis = i
        norm = sqrt(1.0 - n[axis] * n[axis])
        for i in range(3):
            e1[i] = ((1.0 if i == axis else 0.0) - n[axis] * n[i]) / norm
        for i in range(3):
            e2[i] = n[(i + 1) % 3] * e1[(i + 2) % 3] - n[(i + 2) % 3] * e1[(i + 1) % 3]
        r1 = unit[0] * e1[0] + unit[1] * e1[1] + unit[2] * e1[2]
        r2 = unit[0] * e2[0] + unit[1] * e2[1] + unit[2] * e2[2]
        for q in range(2):
            for r in range(2):
                left = e1 if q == 0 else e2
                right = e1 if r == 0 else e2
                entry = 0.0
                for i in range(3):
                    for j in range(3):
                        entry += left[i] * covs[3 * k + i, j] * right[j]
                C[q, r] = entry
        determinant = C[0, 0] * C[1, 1] - C[0, 1] * C[1, 0]
        for i in range(UNKNOWN):
            j1[i], j2[i] = 0.0, 0.0
            for m in range(3):
                j1[i] += (e1[m] - r1 * unit[m]) / length * J[m, i]
                j2[i] += (e2[m] - r2 * unit[m]) / length * J[m, i]
        w11, w22, w12 = C[1, 1] / determinant, C[0, 0] / determinant, -C[0, 1] / determinant
        cost += w11 * r1 * r1 + 2.0 * w12 * r1 * r2 + w22 * r2 * r2
        for i in range(UNKNOWN):
            b[i] -= j1[i] * (w11 * r1 + w12 * r2) + j2[i] * (w12 * r1 + w22 * r2)
            for j in range(UNKNOWN):
                A[i, j] += j1[i] * (w11 * j1[j] + w12 * j2[j]) + j2[i] * (w12 * j1[j] + w22 * j2[j])
    # Attitude angles that are known otherwise.
    found = np.empty(3)
    euler(found, R)
    s_r, c_r = sin(found[0]), cos(found[0])
    c_p = max(cos(found[1]), COS_PITCH_MIN)
    t_p = sin(found[1]) / c_p
    W = ((1.0, s_r * t_p, c_r * t_p), (0.0, c_r, -s_r), (0.0, s_r / c_p, c_r / c_p))
    for q in range(3):
        if information[q] > 0.0:
            residual = found[q] - angles[q]
            residual -= 2.0 * pi * np.floor((residual + pi) / (2.0 * pi))
            cost += information[q] * residual * residual
            for i in range(3):
                b[i] -= information[q] * residual * W[q][i]
                for j in range(3):
                    A[i, j] += information[q] * W[q][i] * W[q][j]
    return cost


@kernel(I8(VEC, MAT, MAT, VEC, MAT, MAT, VEC, VEC, MAT))
def solve(p_out, R_out, cov_out, cost_out, rows, covs, angles, information, R_start):
    """Find the pose that fits all tethers and known angles best.

    Parameters
    ----------
    p_out : (3,), written
        Load's CG, ned [m].
    R_out : (3, 3), written
        ned_from_frd of the load.
    cov_out : (6, 6), written
        Covariance of roll, pitch, yaw and position.
    cost_out : (1,), written
        Weighted sum of squares: chi-square, with 1 per length, 2 per direction, 1 per angle, less 6 degrees of freedom.
    rows : (n, TetherRow.SIZE)
    covs : (3 n, 3)
        Covariance of each unit vector that is told, of rank 2 across it.
    angles, information : (3,)
        Roll, pitch, yaw that are known otherwise, and 1 / variance; 0: not known.
    R_start : (3, 3)
        Attitude that the search begins from where the anchors leave a choice.

    Returns
    -------
    Status
        ``OK``; ``NOT_POSITIVE`` where tethers and angles together do not tell the whole pose: all anchors on one line
        without the angle about it, fewer than two tethers, no direction at all; ``NOT_CONVERGED``; ``NOT_FINITE``.
        Results are to be ignored unless ``OK``.
    """
    n = rows.shape[0]
    seen, drawn, weights = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    spread = 1e-6
    for k in range(n):
        variance = min(rows[k, _R.LENGTH_STD], rows[k, _R.LENGTH]) ** 2
        for i in range(3):
            seen[k, i] = rows[k, _R.HOOK + i] + rows[k, _R.LENGTH] * rows[k, _R.DIRECTION + i]
            drawn[k, i] = rows[k, _R.ANCHOR + i]
            variance += rows[k, _R.LENGTH] ** 2 * covs[3 * k + i, i]
            spread = max(spread, abs(drawn[k, i] - drawn[0, i]))
        weights[k] = 1.0 / variance if rows[k, _R.TOLD] > 0.5 else 0.0
    R = np.empty((3, 3))
    status = align(R, seen, drawn, weights, R_start, 1e-4 * spread * spread)
    if status != _OK:
        return status
    p = np.zeros(3)
    total = 0.0
    for k in range(n):
        total += weights[k]
        for i in range(3):
            turned = R[i, 0] * drawn[k, 0] + R[i, 1] * drawn[k, 1] + R[i, 2] * drawn[k, 2]
            p[i] += weights[k] * (seen[k, i] - turned)
    for i in range(3):
        p[i] /= total
    A, L, scaled = np.empty((UNKNOWN, UNKNOWN)), np.empty((UNKNOWN, UNKNOWN)), np.empty((UNKNOWN, UNKNOWN))
    b, step, scale = np.empty(UNKNOWN), np.empty(UNKNOWN), np.empty(UNKNOWN)
    R_trial, p_trial = np.empty((3, 3)), np.empty(3)
    A_trial, b_trial = np.empty((UNKNOWN, UNKNOWN)), np.empty(UNKNOWN)
    cost = _normal_equations(A, b, p, R, rows, covs, angles, information)
    converged = False
    for _ in range(ITERATIONS_MAX):
        if not np.isfinite(cost):
            return _NOT_FINITE
        for i in range(UNKNOWN):
            if not A[i, i] > 0.0:
                return _NOT_POSITIVE
            scale[i] = 1.0 / sqrt(A[i, i])
        for i in range(UNKNOWN):
            step[i] = b[i] * scale[i]
            for j in range(UNKNOWN):
                scaled[i, j] = A[i, j] * scale[i] * scale[j]
        if cholesky(L, scaled) != _OK:
            return _NOT_POSITIVE
        for i in range(UNKNOWN):
            if L[i, i] * L[i, i] < PIVOT_MIN:
                return _NOT_POSITIVE
        cholesky_solve(step, L)
        if converged:
            break
        # A far turn would leave the valley it starts in for the load's mirror image above its tethers.
        turn = sqrt((step[0] * scale[0]) ** 2 + (step[1] * scale[1]) ** 2 + (step[2] * scale[2]) ** 2)
        share = min(1.0, TURN_MAX_RAD / max(turn, 1e-300))
        better = False
        for _halving in range(12):
            for i in range(3):
                p_trial[i] = p[i] + share * step[3 + i] * scale[3 + i]
                for j in range(3):
                    R_trial[i, j] = R[i, j]
            _turn(R_trial, share * step[0] * scale[0], share * step[1] * scale[1], share * step[2] * scale[2])
            cost_trial = _normal_equations(A_trial, b_trial, p_trial, R_trial, rows, covs, angles, information)
            if cost_trial <= cost * (1.0 + 1e-12) + 1e-20:
                better = True
                break
            share *= 0.5
        size = 0.0
        for i in range(UNKNOWN):
            size = max(size, abs(step[i]))
        if not better:
            if size < STEP_ROUNDING:
                converged = True
                continue
            return _NOT_CONVERGED
        p[:], R[:, :], A[:, :], b[:], cost = p_trial, R_trial, A_trial, b_trial, cost_trial
        converged = size < STEP_CONVERGED
    if not converged:
        return _NOT_CONVERGED
    # Covariance, its rotation turned from the load's axes to roll, pitch, yaw.
    inverse, column = np.empty((UNKNOWN, UNKNOWN)), np.empty(UNKNOWN)
    for j in range(UNKNOWN):
        column[:] = 0.0
        column[j] = scale[j]
        cholesky_solve(column, L)
        for i in range(UNKNOWN):
            inverse[i, j] = column[i] * scale[i]
    found = np.empty(3)
    euler(found, R)
    s_r, c_r = sin(found[0]), cos(found[0])
    c_p = max(cos(found[1]), COS_PITCH_MIN)
    t_p = sin(found[1]) / c_p
    T = np.zeros((UNKNOWN, UNKNOWN))
    T[0, 0], T[0, 1], T[0, 2] = 1.0, s_r * t_p, c_r * t_p
    T[1, 1], T[1, 2] = c_r, -s_r
    T[2, 1], T[2, 2] = s_r / c_p, c_r / c_p
    for i in range(3, UNKNOWN):
        T[i, i] = 1.0
    for i in range(UNKNOWN):
        for j in range(UNKNOWN):
            entry = 0.0
            for q in range(UNKNOWN):
                for r in range(UNKNOWN):
                    entry += T[i, q] * inverse[q, r] * T[j, r]
            cov_out[i, j] = entry
    p_out[:], R_out[:, :] = p, R
    cost_out[0] = cost
    return _OK
