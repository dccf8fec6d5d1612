"""Extended-state linear Kalman filter (ES-LKF) of one axis, Escareno et al., ICINCO 2016, section 3.

One axis of a rotorcraft, forward, up or in pitch, is a mass under a known force and an unknown one:

    chi'' = (U + rho) / a - G                                         (28)

U is the known force [N] or torque [N m], a the mass [kg] or moment of inertia [kg m^2], G what accelerates without a
force (the weight, upwards), and rho whatever else acts: load, wind, errors of the model. rho is the third state, a
random walk (32), so that the filter needs to know nothing of what disturbs.
"""

from enum import IntEnum

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.linalg import invert, multiply, multiply_transposed, symmetrise
from swingd.core.status import Status

NUM_STATES = 3
DOUBLINGS_MAX = 60
"""The n-th doubling stands for 2**n steps of the filter."""
DOUBLING_TOLERANCE = 1e-14


class State(IntEnum):
    """Indices of the state; units are those of the axis."""

    POS = 0
    VEL = 1
    DISTURBANCE = 2


_POS = int(State.POS)
_VEL = int(State.VEL)
_OK = int(Status.OK)
_GATED = int(Status.GATED)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)


@kernel(VOID(MAT, VEC, MAT, F8, F8, F8))
def discretise(A_out, B_out, Q_out, inertia, process_density, dt_s):
    """Transition, input and process covariance of an interval over which the force is held, all exact.

    Parameters
    ----------
    A_out : (3, 3), written
        exp(A T), (41).
    B_out : (3,), written
        For the force U - a G, (42).
    Q_out : (3, 3), written
        Van Loan's integral (45) of noise that drives rho alone, M = (0, 0, 1).
    inertia : float
        a, mass [kg] or moment of inertia [kg m^2], > 0.
    process_density : float
        Of rho's random walk [N^2/s] or [(N m)^2/s], >= 0; Q_33 of the paper's Table 2.
    dt_s : float
        T [s].

    Notes
    -----
    Printed without its prime, (38) gives the state after the interval.
    """
    vel_d_rho = dt_s / inertia
    pos_d_rho = 0.5 * dt_s * vel_d_rho
    A_out[:, :] = 0.0
    for i in range(3):
        A_out[i, i] = 1.0
    A_out[0, 1] = dt_s
    A_out[0, 2] = pos_d_rho
    A_out[1, 2] = vel_d_rho
    B_out[0] = pos_d_rho
    B_out[1] = vel_d_rho
    B_out[2] = 0.0
    rho_var = process_density * dt_s
    Q_out[0, 0] = rho_var * pos_d_rho * pos_d_rho / 5.0
    Q_out[0, 1] = rho_var * pos_d_rho * vel_d_rho / 4.0
    Q_out[0, 2] = rho_var * pos_d_rho / 3.0
    Q_out[1, 1] = rho_var * vel_d_rho * vel_d_rho / 3.0
    Q_out[1, 2] = rho_var * vel_d_rho / 2.0
    Q_out[2, 2] = rho_var
    for i in range(3):
        for j in range(i):
            Q_out[i, j] = Q_out[j, i]


@kernel(I8(VEC, F8, MAT, VEC))
def predict_mean(x, force, A, B):
    """Carry the state over one interval: x = A x + B (U - a G).

    Parameters
    ----------
    x : (3,), changed
        From the interval's start to its end; untouched unless ``OK``.
    force : float
        U - a G, held over the interval.
    A, B : (3, 3), (3,)
        See `discretise`.

    Returns
    -------
    Status
        ``OK`` or ``NOT_FINITE``.
    """
    pos = x[0] + A[0, 1] * x[1] + A[0, 2] * x[2] + B[0] * force
    vel = x[1] + A[1, 2] * x[2] + B[1] * force
    if not np.isfinite(pos + vel + x[2]):
        return _NOT_FINITE
    x[0] = pos
    x[1] = vel
    return _OK


@kernel(I8(VEC, MAT, F8, MAT, VEC, MAT))
def predict(x, P, force, A, B, Q):
    """Carry state and covariance over one interval: x = A x + B (U - a G), P = A P A^T + Q.

    Parameters
    ----------
    x, P : (3,), (3, 3), changed
        From the interval's start to its end; untouched unless ``OK``.
    force : float
        U - a G, held over the interval.
    A, B, Q : (3, 3), (3,), (3, 3)
        See `discretise`.

    Returns
    -------
    Status
        ``OK`` or ``NOT_FINITE``.
    """
    product = np.empty((3, 3))
    P_next = np.empty((3, 3))
    multiply(product, A, P)
    multiply_transposed(P_next, product, A)
    size = 0.0
    for i in range(3):
        for j in range(3):
            P_next[i, j] += Q[i, j]
            size += abs(P_next[i, j])
    if not np.isfinite(size):
        return _NOT_FINITE
    status = predict_mean(x, force, A, B)
    if status != _OK:
        return status
    symmetrise(P_next)
    for i in range(3):
        for j in range(3):
            P[i, j] = P_next[i, j]
    return _OK


@kernel(I8(VEC, MAT, VEC, VEC, VEC, F8))
def judge(x, P, nis_out, z, var, nis_gate):
    """Compare a measurement with the prediction, changing neither.

    Parameters
    ----------
    x, P : (3,), (3, 3)
        A priori.
    nis_out : (1,), written
        Normalised innovation squared; as many degrees of freedom as are measured. Untouched if ``NOT_*``.
    z : (2,)
        Measured position and velocity; what is not measured must be a number all the same.
    var : (2,)
        Their variances, > 0; infinite: not measured.
    nis_gate : float
        Infinite: nothing is left out.

    Returns
    -------
    Status
        ``OK``, ``GATED``, ``NOT_POSITIVE`` or ``NOT_FINITE``.
    """
    nis = 0.0
    nu_vel = z[1] - x[1]
    vel_var = P[1, 1]
    if np.isfinite(var[0]):
        S = P[0, 0] + var[0]
        if not S > 0.0:
            return _NOT_POSITIVE
        nu_pos = z[0] - x[0]
        nis += nu_pos * nu_pos / S
        # What the position has already told of the velocity.
        nu_vel -= P[1, 0] / S * nu_pos
        vel_var -= P[1, 0] / S * P[1, 0]
    if np.isfinite(var[1]):
        S = vel_var + var[1]
        if not S > 0.0:
            return _NOT_POSITIVE
        nis += nu_vel * nu_vel / S
    if not np.isfinite(nis):
        return _NOT_FINITE
    nis_out[0] = nis
    return _GATED if nis > nis_gate else _OK


@kernel(I8(VEC, MAT, VEC, VEC, VEC, F8))
def correct(x, P, nis_out, z, var, nis_gate):
    """Correct by what is measured of position and velocity.

    Parameters
    ----------
    x, P : (3,), (3, 3), changed
        State and covariance at the instant of the measurement; untouched unless ``OK``.
    nis_out, z, var, nis_gate
        As in `judge`.

    Returns
    -------
    Status
        As `judge`.

    Notes
    -----
    The errors of both are independent, so that they are taken one after the other, each in Joseph's form.
    """
    status = judge(x, P, nis_out, z, var, nis_gate)
    if status != _OK:
        return status
    K = np.empty(3)
    less = np.empty((3, 3))
    for m in range(2):
        if not np.isfinite(var[m]):
            continue
        S = P[m, m] + var[m]
        nu = z[m] - x[m]
        for i in range(3):
            K[i] = P[i, m] / S
            x[i] += K[i] * nu
        for i in range(3):
            for j in range(3):
                less[i, j] = P[i, j] - K[i] * P[m, j]
        for i in range(3):
            for j in range(i + 1):
                P[i, j] = less[i, j] - less[i, m] * K[j] + var[m] * K[i] * K[j]
                P[j, i] = P[i, j]
    return _OK


@kernel(I8(VEC, MAT, VEC, VEC, VEC, F8, MAT))
def correct_by_gain(x, P, nis_out, z, var, nis_gate, K):
    """Correct by a gain that is known, of `steady_state`.

    Parameters
    ----------
    x : (3,), changed
        Untouched unless ``OK``.
    P, nis_out, z, var, nis_gate
        As in `judge`; both are measured.
    K : (3, 2)
        Gain.

    Returns
    -------
    Status
        As `judge`.
    """
    status = judge(x, P, nis_out, z, var, nis_gate)
    if status != _OK:
        return status
    nu_pos, nu_vel = z[0] - x[0], z[1] - x[1]
    for i in range(3):
        x[i] += K[i, 0] * nu_pos + K[i, 1] * nu_vel
    return _OK


@kernel(I8(MAT, MAT, MAT, MAT, MAT, VEC))
def steady_state(P_prior_out, P_out, K_out, A, Q, var):
    """Covariances and gain on which the filter settles, from the algebraic Riccati equation.

    Parameters
    ----------
    P_prior_out, P_out : (3, 3), written
        Before and after a correction.
    K_out : (3, 2), written
        Gain.
    A, Q : (3, 3)
        See `discretise`; the process density must be positive.
    var : (2,)
        Variances of position and velocity, > 0 and finite: from the velocity alone the position's never settles.

    Returns
    -------
    Status
        ``NOT_CONVERGED`` if nothing drives the disturbance: the gain then fades to zero. What is written is undefined
        unless ``OK``.

    Notes
    -----
    Structure-preserving doubling: after n rounds H is the covariance after 2**n steps from none. The states are scaled
    to their measurements' deviations and rho to its walk in one step; unscaled the entries differ by many orders.
    """
    scale = np.empty(3)
    scale[0] = np.sqrt(var[0])
    scale[1] = np.sqrt(var[1])
    scale[2] = np.sqrt(Q[2, 2])
    if not scale[2] > 0.0:
        return _NOT_CONVERGED
    # The filter's equation is the regulator's of A^T.
    F = np.empty((3, 3))
    G = np.zeros((3, 3))
    H = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            F[i, j] = A[j, i] * scale[i] / scale[j]
            H[i, j] = Q[i, j] / (scale[i] * scale[j])
    G[0, 0] = 1.0
    G[1, 1] = 1.0
    inner = np.empty((3, 3))
    inner_inv = np.empty((3, 3))
    product = np.empty((3, 3))
    term = np.empty((3, 3))
    F_next = np.empty((3, 3))
    G_term = np.empty((3, 3))
    for _ in range(DOUBLINGS_MAX):
        multiply(inner, G, H)
        for i in range(3):
            inner[i, i] += 1.0
        if invert(inner_inv, inner) != _OK:
            return _NOT_CONVERGED
        # F_next = F W F, G += F W G F^T, H += F^T H W F with W = (I + G H)^-1.
        multiply(product, F, inner_inv)
        multiply(F_next, product, F)
        multiply(term, product, G)
        multiply_transposed(G_term, term, F)
        multiply(product, H, inner_inv)
        multiply(term, product, F)
        size = 0.0
        settled = True
        for i in range(3):
            for j in range(3):
                product[i, j] = F[0, i] * term[0, j] + F[1, i] * term[1, j] + F[2, i] * term[2, j]
        for i in range(3):
            settled &= product[i, i] <= DOUBLING_TOLERANCE * H[i, i]
            for j in range(3):
                H[i, j] += product[i, j]
                G[i, j] += G_term[i, j]
                F[i, j] = F_next[i, j]
                size += abs(H[i, j])
        if not np.isfinite(size):
            return _NOT_CONVERGED
        symmetrise(H)
        symmetrise(G)
        if settled:
            break
    else:
        return _NOT_CONVERGED
    for i in range(3):
        for j in range(3):
            P_prior_out[i, j] = H[i, j] * scale[i] * scale[j]
            P_out[i, j] = P_prior_out[i, j]
    for column in range(2):
        # A correction by one unit of either innovation and none of the other.
        x = np.zeros(3)
        z = np.zeros(2)
        z[column] = 1.0
        P = P_prior_out.copy()
        status = correct(x, P, np.empty(1), z, var, np.inf)
        if status != _OK:
            return status
        for i in range(3):
            K_out[i, column] = x[i]
            for j in range(3):
                P_out[i, j] = P[i, j]
    return _OK
