"""What the swing EKF's state owes to the parameters of its model, and what the innovation says of them.

Friedland's separate estimation of a bias [1]_: the filter of `swingd.core.swing_ekf` runs as if its parameters were
exact, the sensitivity V = dx/dp of its state is carried along, and a filter of the parameters alone takes what the
innovation says through it. For a linear filter that is the augmented filter, at the price of a few vectors.

The parameters p are the logarithms of cable length and load mass over those that the filter is run with.

References
----------
.. [1] B. Friedland, Treatment of bias in recursive filtering, IEEE Trans. Automatic Control 14 (1969) 359-367;
   for parameters in the dynamics see L. Ljung, IEEE Trans. Automatic Control 24 (1979) 36-50.
"""

from enum import IntEnum

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.linalg import cholesky, cholesky_solve, invert
from swingd.core.status import Status
from swingd.core.swing_ekf import dynamics, observation


class ModelParameter(IntEnum):
    """Index into the parameters."""

    LENGTH = 0
    """ln of the cable's length over the filter's [1]."""
    PAYLOAD_MASS = 1
    """ln of the load's mass over the filter's [1]."""


NUM_PARAMETERS = 2

_OK = int(Status.OK)
_GATED = int(Status.GATED)
_NOT_FINITE = int(Status.NOT_FINITE)


@kernel(VOID(MAT, MAT, VEC, VEC, F8, F8, F8))
def parameter_jacobians(f_d_p_out, h_d_p_out, x, u, mass_kg, payload_mass_kg, length_m):
    """Derivatives of (8) and (9) by the logarithms of cable length and load mass.

    The length divides the forces in (8) and stands before the square of the rates in (9); the load's mass is not in
    (8), and the cable's pull in (9) is proportional to m_l / M.

    Parameters
    ----------
    f_d_p_out, h_d_p_out : (7, 2), (3, 2), written
        Columns by `ModelParameter`.
    x, u, mass_kg, payload_mass_kg, length_m
        As for `swingd.core.swing_ekf.observation`.
    """
    s_xi, c_xi = np.sin(x[0]), np.cos(x[0])
    s_zeta, c_zeta = np.sin(x[1]), np.cos(x[1])
    w_x, w_y, w_z = u[0] + x[4], u[1] + x[5], u[2] + x[6]
    total_kg = mass_kg + payload_mass_kg
    per_inertia = 1.0 / (mass_kg * length_m)
    n = (s_zeta, -s_xi * c_zeta, c_xi * c_zeta)
    n_w = n[0] * w_x + n[1] * w_y + n[2] * w_z
    speed2 = x[3] * x[3] + x[2] * x[2] * c_zeta * c_zeta
    centripetal = payload_mass_kg * length_m / total_kg * speed2
    along = centripetal - payload_mass_kg / (mass_kg * total_kg) * n_w
    f_d_p_out[:, :] = 0.0
    f_d_p_out[2, 0] = -(w_y * c_xi + w_z * s_xi) * per_inertia / c_zeta
    f_d_p_out[3, 0] = (w_x * c_zeta + (w_y * s_xi - w_z * c_xi) * s_zeta) * per_inertia
    for i in range(3):
        h_d_p_out[i, 0] = n[i] * centripetal
        h_d_p_out[i, 1] = n[i] * along * mass_kg / total_kg


@kernel(I8(MAT, MAT, VEC, VEC, MAT, VEC, VEC, F8, I8, F8, F8, F8))
def carry_sensitivity(V_out, V, x_before, x, P, u, R_diag, dt_s, gated, mass_kg, payload_mass_kg, length_m):
    """Carry V = dx/dp over one step of the filter, by backward Euler as the step itself.

    V1 = V + dt (f_d_x V1 + f_d_p - K (h_d_x V1 + h_d_p)), with f, h at the step's end and its gain K, which is held:
    what it changes with the parameters meets innovations that are zero in the mean.

    Parameters
    ----------
    V_out, V : (7, 2)
        After (written) and before the step.
    x_before : (7,)
        State before the step; the gain's Jacobian is taken there.
    x, P : (7,), (7, 7)
        Result of the step.
    u, R_diag, dt_s, mass_kg, payload_mass_kg, length_m
        Of the step.
    gated : int
        1 where the step left its measurement out.

    Returns
    -------
    Status
        ``OK``, ``NOT_CONVERGED`` or ``NOT_FINITE``; V_out is then not to be used.
    """
    f = np.empty(7)
    F = np.empty((7, 7))
    h = np.empty(3)
    H = np.empty((3, 7))
    f_d_p = np.empty((7, 2))
    h_d_p = np.empty((3, 2))
    K = np.zeros((7, 3))
    if gated == 0:
        observation(h, H, x_before, u, mass_kg, payload_mass_kg, length_m)
        for i in range(7):
            for j in range(3):
                for k in range(7):
                    K[i, j] += P[i, k] * H[j, k]
                K[i, j] /= R_diag[j]
    dynamics(f, F, x, u, mass_kg, length_m)
    observation(h, H, x, u, mass_kg, payload_mass_kg, length_m)
    parameter_jacobians(f_d_p, h_d_p, x, u, mass_kg, payload_mass_kg, length_m)
    J = np.empty((7, 7))
    J_inv = np.empty((7, 7))
    for i in range(7):
        for k in range(7):
            gain = 0.0
            for j in range(3):
                gain += K[i, j] * H[j, k]
            J[i, k] = -dt_s * (F[i, k] - gain)
        J[i, i] += 1.0
    status = invert(J_inv, J)
    if status != _OK:
        return status
    right = np.empty((7, 2))
    for i in range(7):
        for p in range(2):
            rate = f_d_p[i, p]
            for j in range(3):
                rate -= K[i, j] * h_d_p[j, p]
            right[i, p] = V[i, p] + dt_s * rate
    size = 0.0
    for i in range(7):
        for p in range(2):
            total = 0.0
            for k in range(7):
                total += J_inv[i, k] * right[k, p]
            V_out[i, p] = total
            size += abs(total)
    return _OK if np.isfinite(size) else _NOT_FINITE


@kernel(I8(VEC, MAT, VEC, VEC, MAT, MAT, VEC, VEC, VEC, F8, F8, F8, F8, F8))
def learn(
    p, P_p, nu_out, x, P, V, u, z, R_diag, interval_s, mass_kg, payload_mass_kg, length_m, nis_gate
):  # fmt: skip
    """Take what the innovation of one interval says of the parameters.

    Parameters
    ----------
    p, P_p : (2,), (2, 2), changed where the answer is ``OK``
        Estimate of the parameters, relative to those that the filter is run with, and its covariance.
    nu_out : (3,), written
        Innovation of the filter as it is run, z - h, at the start of the interval [m/s^2].
    x, P, V : (7,), (7, 7), (7, 2)
        Before the interval.
    u, z, R_diag, interval_s, mass_kg, payload_mass_kg, length_m, nis_gate
        As for `swingd.core.swing_ekf.step`.

    Returns
    -------
    Status
        ``OK``, ``GATED`` where the innovation is larger than any parameters explain, ``NOT_POSITIVE`` or
        ``NOT_FINITE``.

    Notes
    -----
    With g = h_d_x V + h_d_p: nu - g p has the covariance g P_p g^T + H P H^T + R / interval.
    """
    h = np.empty(3)
    H = np.empty((3, 7))
    f_d_p = np.empty((7, 2))
    g = np.empty((3, 2))
    observation(h, H, x, u, mass_kg, payload_mass_kg, length_m)
    parameter_jacobians(f_d_p, g, x, u, mass_kg, payload_mass_kg, length_m)
    rest = np.empty(3)
    PHt = np.empty((7, 3))
    S = np.empty((3, 3))
    factor = np.empty((3, 3))
    for i in range(3):
        nu_out[i] = z[i] - h[i]
        rest[i] = nu_out[i]
        for q in range(2):
            for k in range(7):
                g[i, q] += H[i, k] * V[k, q]
            rest[i] -= g[i, q] * p[q]
    for k in range(7):
        for i in range(3):
            total = 0.0
            for j in range(7):
                total += P[k, j] * H[i, j]
            PHt[k, i] = total
    # (2, 3) covariance of parameters and innovation
    C = np.empty((2, 3))
    for q in range(2):
        for i in range(3):
            C[q, i] = P_p[q, 0] * g[i, 0] + P_p[q, 1] * g[i, 1]
    for i in range(3):
        for j in range(3):
            total = g[i, 0] * C[0, j] + g[i, 1] * C[1, j]
            for k in range(7):
                total += H[i, k] * PHt[k, j]
            S[i, j] = total
        S[i, i] += R_diag[i] / interval_s
    status = cholesky(factor, S)
    if status != _OK:
        return status
    weighted = rest.copy()
    cholesky_solve(weighted, factor)
    nis = rest[0] * weighted[0] + rest[1] * weighted[1] + rest[2] * weighted[2]
    if not np.isfinite(nis):
        return _NOT_FINITE
    if nis > nis_gate:
        return _GATED
    column = np.empty(3)
    shrunk = np.empty((2, 2))
    for q in range(2):
        for i in range(3):
            p[q] += C[q, i] * weighted[i]
            column[i] = C[q, i]
        cholesky_solve(column, factor)
        for r in range(2):
            shrunk[q, r] = P_p[q, r] - (C[r, 0] * column[0] + C[r, 1] * column[1] + C[r, 2] * column[2])
    for q in range(2):
        # A parameter that is known exactly, and rounding, leave a zero and never less.
        P_p[q, q] = max(shrunk[q, q], 0.0)
    P_p[0, 1] = P_p[1, 0] = 0.5 * (shrunk[0, 1] + shrunk[1, 0])
    return _OK
