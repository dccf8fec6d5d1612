"""The GP-EKF (19)-(27): slung load dynamics corrected by a Gaussian process, corrected by whatever source arrives.

State as `swingd.core.slts.SltsState`; the input is the force on the vehicle, thrust above all. What is learned is the
error of the relative acceleration v'. B_d of (14), which the paper does not print, depends on which body it pushes: an
error on the vehicle leaves the load alone, one on the load (its drag) is taken from v_p' as it is added to v', so that
the vehicle feels nothing of it. The share of the load is a number of the model. Errata: (19) means M^-1, (24) takes h
at the predicted state, and (27) is P - K H P - P H^T K^T + K W K^T, which is Joseph's form, used here.
"""

from enum import IntEnum
from math import sqrt

import numpy as np

from swingd.core import gaussian_process, slts
from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.linalg import cholesky, cholesky_solve, multiply, multiply_transposed
from swingd.core.slts import SltsState
from swingd.core.status import Status

NUM_STATES = slts.NUM_STATES
STEP_MAX_S = 0.01
"""A longer interval is divided."""


class Source(IntEnum):
    """What a measurement shows, (21); ned, 3 components each."""

    VEHICLE_POS = 1
    """h = x_p + l [m]."""
    VEHICLE_VEL = 2
    """h = v_p + B v [m/s]."""
    REL_POS = 3
    """h = l, the vehicle relative to the load [m]; a camera sees -l."""


class GpEkfParam(IntEnum):
    """Offsets into the parameters, SI units."""

    MASS = 0
    PAYLOAD_MASS = 1
    CABLE_LENGTH = 2
    FORCE_NOISE = 3
    """Variance density of the force on the vehicle, ned, 3 [N^2/Hz]: Q of (23)."""
    LOAD_FORCE_NOISE = 6
    """Variance density of the force on the load, every axis [N^2/Hz]."""
    MODEL_MEMORY = 7
    """For how long an error that the Gaussian process allows for keeps its sign [s]; its variance times that is the
    density of the noise that it gives v'."""
    NIS_GATE = 8
    """Of every source, 3 degrees of freedom."""
    LOAD_SHARE = 9
    """How much of what is learned acts on the load and not on the vehicle, 0..1."""
    SIZE = 10


_S = SltsState
_P = GpEkfParam
_OK = int(Status.OK)
_GATED = int(Status.GATED)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)
_VEHICLE_POS = int(Source.VEHICLE_POS)
_VEHICLE_VEL = int(Source.VEHICLE_VEL)
_REL_POS = int(Source.REL_POS)


@kernel(I8(VEC, MAT, MAT, VEC, VEC, VEC, MAT, MAT, MAT, MAT, VEC))
def dynamics(rate_out, A_out, G_out, model_var_out, x, force, Z, weights, K_inv, inv_sq_scales, signal_var):
    """Rate of the state (19), its Jacobians, and the variance of what is learned.

    Parameters
    ----------
    rate_out : (10,), written
    A_out, G_out : (10, 10), (10, 6), written
        By the state, (20) included, and by the forces on vehicle and load.
    model_var_out : (2,), written
        Of v' by the Gaussian process [(m/s^2)^2]; 0 without samples.
    x : (10,)
    force : (7,)
        Force on the vehicle, ned, 3 [N]; then mass and payload mass [kg], cable length [m] and the load's share.
    Z, weights, K_inv, inv_sq_scales, signal_var
        See `swingd.core.gaussian_process`; no rows: no Gaussian process.

    Returns
    -------
    Status
        As `swingd.core.slts.acceleration`.
    """
    mass, payload_mass, length = force[3], force[4], force[5]
    acc = np.empty(6)
    still = np.zeros(3)
    status = slts.acceleration(acc, x, force, still, mass, payload_mass, length)
    if status != _OK:
        return status
    slts.jacobians(A_out, G_out, x, force, still, mass, payload_mass, length)
    for i in range(5):
        rate_out[i] = x[_S.LOAD_VEL + i]
        rate_out[_S.LOAD_VEL + i] = acc[i]
    model_var_out[:] = 0.0
    if Z.shape[0] > 0:
        features = Z.shape[1]
        z = np.empty(features)
        mean = np.empty(2)
        J = np.empty((2, features))
        for i in range(2):
            z[i], z[2 + i] = x[_S.REL_POS + i], x[_S.REL_VEL + i]
            if features > 4:
                z[4 + i] = x[_S.LOAD_VEL + i]
        gaussian_process.predict(mean, model_var_out, J, z, Z, weights, K_inv, inv_sq_scales, signal_var)
        for i in range(2):
            rate_out[_S.REL_VEL + i] += mean[i]
            rate_out[_S.LOAD_VEL + i] -= force[6] * mean[i]
            for j in range(features):
                column = _S.REL_POS + j if j < 2 else (_S.REL_VEL + j - 2 if j < 4 else _S.LOAD_VEL + j - 4)
                A_out[_S.REL_VEL + i, column] += J[i, j]
                A_out[_S.LOAD_VEL + i, column] -= force[6] * J[i, j]
    return _OK


@kernel(I8(VEC, MAT, VEC, F8, VEC, MAT, MAT, MAT, MAT, VEC))
def predict(x, P, force, dt_s, p, Z, weights, K_inv, inv_sq_scales, signal_var):
    """Carry mean and covariance over an interval with the force held, (22), (23).

    Parameters
    ----------
    x, P : (10,), (10, 10), changed
        Not to be used any more unless ``OK``.
    force : (3,)
        On the vehicle without weight and cable, ned [N].
    dt_s : float
        >= 0; divided where it is longer than `STEP_MAX_S`.
    p : (GpEkfParam.SIZE,)
    Z, weights, K_inv, inv_sq_scales, signal_var
        See `swingd.core.gaussian_process`; no rows: no Gaussian process.

    Returns
    -------
    Status
        ``OK``, ``NOT_CONVERGED`` where the load left what r describes, ``NOT_FINITE``.

    Notes
    -----
    The paper's Euler step feeds the swing (omega^2 dt / 2 of its own, 0.04 1/s at 100 Hz); the second term of the
    series, A f dt^2 / 2, costs a product and leaves it alone. F = 1 + A dt + A^2 dt^2 / 2.
    """
    if dt_s <= 0.0:
        return _OK
    steps = int(np.ceil(dt_s / STEP_MAX_S - 1e-9))
    h = dt_s / steps
    u = np.empty(7)
    share = p[_P.LOAD_SHARE]
    u[6] = share
    for i in range(3):
        u[i] = force[i]
        u[3 + i] = p[_P.MASS + i]
    n = NUM_STATES
    rate = np.empty(n)
    A, F, product = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    G = np.empty((n, 6))
    model_var = np.empty(2)
    for _ in range(steps):
        status = dynamics(rate, A, G, model_var, x, u, Z, weights, K_inv, inv_sq_scales, signal_var)
        if status != _OK:
            return status
        multiply(F, A, A)
        for i in range(n):
            bend = 0.0
            for j in range(n):
                bend += A[i, j] * rate[j]
                F[i, j] = h * A[i, j] + 0.5 * h * h * F[i, j]
            F[i, i] += 1.0
            x[i] += h * (rate[i] + 0.5 * h * bend)
        multiply(product, F, P)
        multiply_transposed(P, product, F)
        # Noise enters the velocities, and the positions through them within the step.
        for i in range(5):
            for j in range(5):
                noise = 0.0
                for k in range(3):
                    noise += G[5 + i, k] * p[_P.FORCE_NOISE + k] * G[5 + j, k]
                    noise += G[5 + i, 3 + k] * p[_P.LOAD_FORCE_NOISE] * G[5 + j, 3 + k]
                # Rows 0, 1 are v_p' north and east, 3, 4 v'; what the process leaves open parts them.
                if i != 2 and j != 2 and i % 3 == j % 3:
                    parted = (1.0 if i >= 3 else -share) * (1.0 if j >= 3 else -share)
                    noise += parted * model_var[i % 3] * p[_P.MODEL_MEMORY]
                P[5 + i, 5 + j] += noise * h
                P[i, 5 + j] += 0.5 * noise * h * h
                P[5 + i, j] += 0.5 * noise * h * h
                P[i, j] += noise * h * h * h / 3.0
        size = 0.0
        for i in range(n):
            size += abs(x[i])
            for j in range(i):
                P[i, j] = 0.5 * (P[i, j] + P[j, i])
                P[j, i] = P[i, j]
            size += P[i, i]
        if not np.isfinite(size):
            return _NOT_FINITE
    return _OK


@kernel(VOID(VEC, MAT, VEC, I8, F8))
def observe(h_out, H_out, x, source, length_m):
    """Measurement and its Jacobian, (21).

    Parameters
    ----------
    h_out, H_out : (3,), (3, 10), written
    x : (10,)
        |r| < length_m.
    source : Source
    length_m : float
    """
    ell = np.empty(3)
    B = np.empty((3, 2))
    slts.cable(ell, B, x[_S.REL_POS : _S.REL_POS + 2], length_m)
    H_out[:, :] = 0.0
    if source == _VEHICLE_VEL:
        vx, vy = x[_S.REL_VEL], x[_S.REL_VEL + 1]
        s = -ell[2]
        along = (ell[0] * vx + ell[1] * vy) / (s * s)
        H_out[2, _S.REL_POS] = (vx + ell[0] * along) / s
        H_out[2, _S.REL_POS + 1] = (vy + ell[1] * along) / s
        for i in range(3):
            h_out[i] = x[_S.LOAD_VEL + i] + B[i, 0] * vx + B[i, 1] * vy
            H_out[i, _S.LOAD_VEL + i] = 1.0
            for j in range(2):
                H_out[i, _S.REL_VEL + j] = B[i, j]
        return
    absolute = source == _VEHICLE_POS
    for i in range(3):
        h_out[i] = ell[i]
        if absolute:
            h_out[i] += x[_S.LOAD_POS + i]
            H_out[i, _S.LOAD_POS + i] = 1.0
        for j in range(2):
            H_out[i, _S.REL_POS + j] = B[i, j]


@kernel(I8(VEC, MAT, VEC, I8, VEC, VEC, F8, F8))
def correct(x, P, nis_out, source, z, var, length_m, nis_gate):
    """Correct by one measurement, (24)-(27) in Joseph's form.

    Parameters
    ----------
    x, P : (10,), (10, 10), changed
        Predicted to the instant of the measurement; untouched unless ``OK``.
    nis_out : (1,), written
        Normalised innovation squared, 3 degrees of freedom.
    source : Source
    z, var : (3,)
        Measurement and the variance of each component.
    length_m : float
        Cable.
    nis_gate : float

    Returns
    -------
    Status
        ``OK``, ``GATED``, ``NOT_POSITIVE`` or ``NOT_FINITE``.
    """
    n = NUM_STATES
    h, H = np.empty(3), np.empty((3, n))
    observe(h, H, x, source, length_m)
    HP = np.empty((3, n))
    multiply(HP, H, P)
    W, L = np.empty((3, 3)), np.empty((3, 3))
    multiply_transposed(W, HP, H)
    for i in range(3):
        W[i, i] += var[i]
        h[i] = z[i] - h[i]
    if cholesky(L, W) != _OK:
        return _NOT_POSITIVE
    solved = h.copy()
    cholesky_solve(solved, L)
    nis = h[0] * solved[0] + h[1] * solved[1] + h[2] * solved[2]
    if not np.isfinite(nis):
        return _NOT_FINITE
    nis_out[0] = nis
    if nis > nis_gate:
        return _GATED
    K = np.empty((n, 3))
    column = np.empty(3)
    for i in range(n):
        for k in range(3):
            column[k] = HP[k, i]
        cholesky_solve(column, L)
        for k in range(3):
            K[i, k] = column[k]
            x[i] += K[i, k] * h[k]
    less, less_P = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            less[i, j] = 1.0 if i == j else 0.0
            for k in range(3):
                less[i, j] -= K[i, k] * H[k, j]
    multiply(less_P, less, P)
    multiply_transposed(P, less_P, less)
    for i in range(n):
        for j in range(i + 1):
            for k in range(3):
                P[i, j] += K[i, k] * var[k] * K[j, k]
            P[j, i] = P[i, j]
    r2 = x[_S.REL_POS] ** 2 + x[_S.REL_POS + 1] ** 2
    reach = slts.REACH_MAX * length_m
    if r2 > reach * reach:
        # A correction that throws the load out of the filter's reach brings it back to the edge.
        scale = reach / sqrt(r2)
        x[_S.REL_POS] *= scale
        x[_S.REL_POS + 1] *= scale
    return _OK
