"""The seven-state swing EKF of Drones 2023, 7, 654: model (8), (9), its Jacobians (13) and the coupled step (10)-(12).

Two point masses joined by a massless rigid cable of length L, in a level frame that does not turn (x forward at the
alignment, y right, z down). With the cable's unit vector n(xi, zeta) = (sin zeta, -sin xi cos zeta, cos xi cos zeta),
the applied force w = u + fa and s = |dn/dt|^2, equation (9) is

    h = w / m + g e_z - m_l / (m M) n (n . w) + m_l L / M  n s

which is expanded term by term in the paper; the cable's tension is -m_l / M (n . w) + m m_l L / M s.
"""

from enum import IntEnum

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2 as GRAVITY_MPS2
from swingd.core.linalg import cholesky, cholesky_solve, invert, riccati_backward_euler
from swingd.core.status import Status


class State(IntEnum):
    """Index into the filter's state."""

    XI = 0
    """Lateral swing, rotation about x [rad]; positive: load to the left."""
    ZETA = 1
    """Longitudinal swing, rotation about y [rad]; positive: load ahead."""
    XI_RATE = 2
    ZETA_RATE = 3
    FORCE_X = 4
    """Disturbance force on the vehicle [N]."""
    FORCE_Y = 5
    FORCE_Z = 6


class Scheme(IntEnum):
    """Integration of the mean."""

    BACKWARD_EULER = 0
    IMPLICIT_MIDPOINT = 1
    RK4 = 2


NUM_STATES = 7
NEWTON_MAX = 12
NEWTON_TOLERANCE = 1e-11
ANGLE_MAX_RAD = 1.5
"""The angles are singular at pi/2; an estimate beyond this is no swing of a load that hangs."""

_OK = int(Status.OK)
_GATED = int(Status.GATED)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)
_MIDPOINT = int(Scheme.IMPLICIT_MIDPOINT)
_RK4 = int(Scheme.RK4)


@kernel(VOID(VEC, MAT, VEC, VEC, F8, F8))
def dynamics(f_out, F_out, x, u, mass_kg, length_m):
    """State derivative (8) and its Jacobian (A1)-(A13).

    Parameters
    ----------
    f_out : (7,), written
    F_out : (7, 7), written
    x : (7,)
        See `State`.
    u : (3,)
        Thrust and known forces on the vehicle, level frame [N].
    mass_kg : float
        Vehicle without load [kg].
    length_m : float
        Cable [m].
    """
    s_xi, c_xi = np.sin(x[0]), np.cos(x[0])
    s_zeta, c_zeta = np.sin(x[1]), np.cos(x[1])
    xi_rate, zeta_rate = x[2], x[3]
    w_x, w_y, w_z = u[0] + x[4], u[1] + x[5], u[2] + x[6]
    per_inertia = 1.0 / (mass_kg * length_m)
    tan_zeta = s_zeta / c_zeta
    across = w_y * c_xi + w_z * s_xi
    along = w_y * s_xi - w_z * c_xi

    f_out[0] = xi_rate
    f_out[1] = zeta_rate
    f_out[2] = across * per_inertia / c_zeta + 2.0 * xi_rate * zeta_rate * tan_zeta
    f_out[3] = -c_zeta * s_zeta * xi_rate * xi_rate - (w_x * c_zeta + along * s_zeta) * per_inertia
    f_out[4:] = 0.0

    F_out[:, :] = 0.0
    F_out[0, 2] = 1.0
    F_out[1, 3] = 1.0
    F_out[2, 0] = -along * per_inertia / c_zeta
    F_out[2, 1] = (across * per_inertia * s_zeta + 2.0 * xi_rate * zeta_rate) / (c_zeta * c_zeta)
    F_out[2, 2] = 2.0 * zeta_rate * tan_zeta
    F_out[2, 3] = 2.0 * xi_rate * tan_zeta
    F_out[2, 5] = c_xi * per_inertia / c_zeta
    F_out[2, 6] = s_xi * per_inertia / c_zeta
    F_out[3, 0] = -across * s_zeta * per_inertia
    F_out[3, 1] = (
        -(c_zeta * c_zeta - s_zeta * s_zeta) * xi_rate * xi_rate - (along * c_zeta - w_x * s_zeta) * per_inertia
    )
    F_out[3, 2] = -2.0 * c_zeta * s_zeta * xi_rate
    F_out[3, 4] = -c_zeta * per_inertia
    F_out[3, 5] = -s_xi * s_zeta * per_inertia
    F_out[3, 6] = c_xi * s_zeta * per_inertia


@kernel(F8(VEC, MAT, VEC, VEC, F8, F8, F8))
def observation(h_out, H_out, x, u, mass_kg, payload_mass_kg, length_m):
    """Acceleration of the hook (9) and its Jacobian (A14)-(A37).

    Parameters
    ----------
    h_out : (3,), written
        Inertial acceleration, level frame [m/s^2].
    H_out : (3, 7), written
    x, u
        As in `dynamics`.
    mass_kg, payload_mass_kg : float
        Vehicle and load [kg].
    length_m : float
        Cable [m].

    Returns
    -------
    float
        Tension of the cable [N]; negative where a real cable would be slack.
    """
    s_xi, c_xi = np.sin(x[0]), np.cos(x[0])
    s_zeta, c_zeta = np.sin(x[1]), np.cos(x[1])
    xi_rate, zeta_rate = x[2], x[3]
    total_kg = mass_kg + payload_mass_kg
    share = payload_mass_kg / (mass_kg * total_kg)
    centripetal = payload_mass_kg * length_m / total_kg
    w = (u[0] + x[4], u[1] + x[5], u[2] + x[6])
    n = (s_zeta, -s_xi * c_zeta, c_xi * c_zeta)
    n_d_xi = (0.0, -c_xi * c_zeta, -s_xi * c_zeta)
    n_d_zeta = (c_zeta, s_xi * s_zeta, -c_xi * s_zeta)
    n_w = n[0] * w[0] + n[1] * w[1] + n[2] * w[2]
    n_d_xi_w = n_d_xi[1] * w[1] + n_d_xi[2] * w[2]
    n_d_zeta_w = n_d_zeta[0] * w[0] + n_d_zeta[1] * w[1] + n_d_zeta[2] * w[2]
    speed2 = zeta_rate * zeta_rate + xi_rate * xi_rate * c_zeta * c_zeta
    along = centripetal * speed2 - share * n_w
    along_d_xi = -share * n_d_xi_w
    along_d_zeta = -2.0 * centripetal * xi_rate * xi_rate * c_zeta * s_zeta - share * n_d_zeta_w
    for i in range(3):
        h_out[i] = w[i] / mass_kg + n[i] * along
        H_out[i, 0] = n_d_xi[i] * along + n[i] * along_d_xi
        H_out[i, 1] = n_d_zeta[i] * along + n[i] * along_d_zeta
        H_out[i, 2] = n[i] * 2.0 * centripetal * xi_rate * c_zeta * c_zeta
        H_out[i, 3] = n[i] * 2.0 * centripetal * zeta_rate
        for j in range(3):
            H_out[i, 4 + j] = -share * n[i] * n[j]
        H_out[i, 4 + i] += 1.0 / mass_kg
    h_out[2] += GRAVITY_MPS2
    return mass_kg * along


@kernel(VOID(VEC, VEC, VEC, VEC, MAT, F8, F8, F8))
def _corrected_rate(rate_out, x, u, z, K, mass_kg, payload_mass_kg, length_m):
    """Right side of (10)."""
    F = np.empty((7, 7))
    H = np.empty((3, 7))
    h = np.empty(3)
    dynamics(rate_out, F, x, u, mass_kg, length_m)
    observation(h, H, x, u, mass_kg, payload_mass_kg, length_m)
    for i in range(7):
        for j in range(3):
            rate_out[i] += K[i, j] * (z[j] - h[j])


@kernel(I8(VEC, VEC, VEC, VEC, MAT, F8, F8, F8, F8))
def _implicit_mean(x_out, x, u, z, K, dt_s, mass_kg, payload_mass_kg, length_m):
    """Solve x1 = x + dt (f(x1, u) + K (z - h(x1, u))) by Newton's method with the analytic Jacobians."""
    f = np.empty(7)
    F = np.empty((7, 7))
    h = np.empty(3)
    H = np.empty((3, 7))
    J = np.empty((7, 7))
    J_inv = np.empty((7, 7))
    residual = np.empty(7)
    x_out[:] = x
    for _ in range(NEWTON_MAX):
        dynamics(f, F, x_out, u, mass_kg, length_m)
        observation(h, H, x_out, u, mass_kg, payload_mass_kg, length_m)
        for i in range(7):
            correction = 0.0
            for j in range(3):
                correction += K[i, j] * (z[j] - h[j])
            residual[i] = x_out[i] - x[i] - dt_s * (f[i] + correction)
            for k in range(7):
                gain = 0.0
                for j in range(3):
                    gain += K[i, j] * H[j, k]
                J[i, k] = -dt_s * (F[i, k] - gain)
            J[i, i] += 1.0
        if invert(J_inv, J) != _OK:
            return _NOT_CONVERGED
        size = 0.0
        for i in range(7):
            change = 0.0
            for k in range(7):
                change += J_inv[i, k] * residual[k]
            x_out[i] -= change
            size = max(size, abs(change) / (1.0 + abs(x_out[i])))
        if not np.isfinite(size):
            return _NOT_FINITE
        if size <= NEWTON_TOLERANCE:
            return _OK
    return _NOT_CONVERGED


@kernel(VOID(VEC, VEC, VEC, VEC, MAT, F8, F8, F8, F8))
def _rk4_mean(x_out, x, u, z, K, dt_s, mass_kg, payload_mass_kg, length_m):
    k = np.empty(7)
    stage = x.copy()
    x_out[:] = x
    for weight, ahead in ((1.0 / 6.0, 0.5), (1.0 / 3.0, 0.5), (1.0 / 3.0, 1.0), (1.0 / 6.0, 0.0)):
        _corrected_rate(k, stage, u, z, K, mass_kg, payload_mass_kg, length_m)
        for i in range(7):
            x_out[i] += dt_s * weight * k[i]
            stage[i] = x[i] + dt_s * ahead * k[i]


@kernel(I8(VEC, MAT, VEC, VEC, MAT, VEC, VEC, VEC, VEC, F8, F8, F8, F8, F8, F8, I8))
def step(
    x_out,
    P_out,
    nis_out,
    x,
    P,
    u,
    z,
    Q_diag,
    R_diag,
    dt_s,
    interval_s,
    mass_kg,
    payload_mass_kg,
    length_m,
    nis_gate,
    scheme,
):
    """Carry mean and covariance over one interval with the acceleration measured in it.

    Parameters
    ----------
    x_out, P_out : (7,), (7, 7), written
        Result; to be ignored unless the answer is ``OK`` or ``GATED``.
    nis_out : (1,), written
        Normalised innovation squared nu^T (H P H^T + R / interval)^-1 nu at the start of the step.
    x, P : (7,), (7, 7)
        Before the step.
    u : (3,)
        Mean thrust and known forces over the step, level frame [N].
    z : (3,)
        Mean inertial acceleration of the hook over the interval, level frame [m/s^2].
    Q_diag : (7,)
        Process noise densities.
    R_diag : (3,)
        Measurement noise densities [(m/s^2)^2 s]; as a density R multiplies by 1/dt where a discrete filter wants a
        covariance.
    dt_s : float
        Step [s], > 0.
    interval_s : float
        What ``z`` is the mean of [s]: the step, or a longer interval of which the step is a part. It weighs in the
        innovation alone; the correction takes ``z`` as a density and is the same however the interval is divided.
    mass_kg, payload_mass_kg, length_m : float
        Model.
    nis_gate : float
        A measurement above it is left out: a step with K = 0 and S = 0.
    scheme : Scheme
        Integration of the mean. The covariance is always backward Euler: with the implicit midpoint 2 P_half - P is
        indefinite after every reset.

    Returns
    -------
    Status
        ``OK``, ``GATED`` (predicted only), ``NOT_CONVERGED`` or ``NOT_POSITIVE`` (a smaller step may do), or
        ``NOT_FINITE``.

    Notes
    -----
    Equations (10)-(13) of Drones 2023, 7, 654. Backward Euler adds the numerical damping omega^2 dt / 2 to the swing,
    omega^2 = (g / L)(m + m_l) / m: 0.028 1/s for 2 kg, 0.192 kg, 1.9 m at 100 Hz, as large as real damping.
    """
    f = np.empty(7)
    F = np.empty((7, 7))
    h = np.empty(3)
    H = np.empty((3, 7))
    dynamics(f, F, x, u, mass_kg, length_m)
    observation(h, H, x, u, mass_kg, payload_mass_kg, length_m)

    nu = np.empty(3)
    weighted = np.empty(3)
    PHt = np.empty((7, 3))
    innovation_cov = np.empty((3, 3))
    factor = np.empty((3, 3))
    for i in range(7):
        for j in range(3):
            total = 0.0
            for k in range(7):
                total += P[i, k] * H[j, k]
            PHt[i, j] = total
    for i in range(3):
        nu[i] = z[i] - h[i]
        weighted[i] = nu[i]
        for j in range(3):
            total = 0.0
            for k in range(7):
                total += H[i, k] * PHt[k, j]
            innovation_cov[i, j] = total
        innovation_cov[i, i] += R_diag[i] / interval_s
    if cholesky(factor, innovation_cov) != _OK:
        return _NOT_POSITIVE
    cholesky_solve(weighted, factor)
    nis = nu[0] * weighted[0] + nu[1] * weighted[1] + nu[2] * weighted[2]
    nis_out[0] = nis
    if not np.isfinite(nis):
        return _NOT_FINITE
    gated = nis > nis_gate

    S = np.zeros((7, 7))
    Q = np.zeros((7, 7))
    for i in range(7):
        Q[i, i] = Q_diag[i]
        if not gated:
            for j in range(7):
                for k in range(3):
                    S[i, j] += H[k, i] * H[k, j] / R_diag[k]
    status = riccati_backward_euler(P_out, P, F, S, Q, dt_s)
    if status != _OK:
        return status
    K = np.zeros((7, 3))
    if not gated:
        for i in range(7):
            for j in range(3):
                for k in range(7):
                    K[i, j] += P_out[i, k] * H[j, k]
                K[i, j] /= R_diag[j]

    if scheme == _RK4:
        _rk4_mean(x_out, x, u, z, K, dt_s, mass_kg, payload_mass_kg, length_m)
    elif scheme == _MIDPOINT:
        # The midpoint is half a backward Euler step; the whole step mirrors it.
        status = _implicit_mean(x_out, x, u, z, K, 0.5 * dt_s, mass_kg, payload_mass_kg, length_m)
        if status != _OK:
            return status
        for i in range(7):
            x_out[i] = 2.0 * x_out[i] - x[i]
    else:
        status = _implicit_mean(x_out, x, u, z, K, dt_s, mass_kg, payload_mass_kg, length_m)
        if status != _OK:
            return status
    for i in range(7):
        if not np.isfinite(x_out[i]):
            return _NOT_FINITE
    return _GATED if gated else _OK
