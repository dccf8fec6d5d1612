"""Runge-Kutta integration of the swing EKF's mean and covariance, the scheme of Drones 2023, 7, 654, section 4.1.

Apart from `swingd.core.swing_ekf` so that what flies does not wait for its compilation.
"""

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.status import Status
from swingd.core.swing_ekf import dynamics, observation

_OK = int(Status.OK)
_NOT_FINITE = int(Status.NOT_FINITE)


@kernel(VOID(VEC, MAT, VEC, MAT, VEC, VEC, VEC, VEC, F8, F8, F8))
def _coupled_rate(x_rate_out, P_rate_out, x, P, u, z, Q_diag, R_diag, mass_kg, payload_mass_kg, length_m):
    """Right sides of (10) and (12), with the gain (11) of this instant."""
    F = np.empty((7, 7))
    H = np.empty((3, 7))
    h = np.empty(3)
    K = np.empty((7, 3))
    dynamics(x_rate_out, F, x, u, mass_kg, length_m)
    observation(h, H, x, u, mass_kg, payload_mass_kg, length_m)
    for i in range(7):
        for j in range(3):
            total = 0.0
            for k in range(7):
                total += P[i, k] * H[j, k]
            K[i, j] = total / R_diag[j]
            x_rate_out[i] += K[i, j] * (z[j] - h[j])
    for i in range(7):
        for j in range(i + 1):
            total = Q_diag[i] if i == j else 0.0
            if i < 2:
                total += P[i + 2, j]
            elif i < 4:
                for k in range(7):
                    total += F[i, k] * P[k, j]
            if j < 2:
                total += P[i, j + 2]
            elif j < 4:
                for k in range(7):
                    total += P[i, k] * F[j, k]
            for k in range(3):
                total -= K[i, k] * R_diag[k] * K[j, k]
            P_rate_out[i, j] = total
            P_rate_out[j, i] = total


@kernel(I8(VEC, MAT, VEC, VEC, VEC, VEC, F8, F8, F8, F8))
def rk4_step(x, P, u, z, Q_diag, R_diag, dt_s, mass_kg, payload_mass_kg, length_m):
    """Carry mean and covariance over one interval by the classical Runge-Kutta method, in place.

    (10), (11) and (12) as one system of differential equations, the gain renewed in every stage. Explicit: it needs a
    step short against the filter's own time constants, where `swingd.core.swing_ekf.step` takes any.

    Parameters
    ----------
    x, P : (7,), (7, 7), changed
        Mean and covariance; left as they were where the answer is not ``OK``.
    u, z : (3,)
        As for `swingd.core.swing_ekf.step`, held over the interval.
    Q_diag, R_diag, dt_s, mass_kg, payload_mass_kg, length_m
        As for `swingd.core.swing_ekf.step`.

    Returns
    -------
    Status
        ``OK`` or ``NOT_FINITE``.
    """
    x_rate, x_trial, x_end = np.empty(7), x.copy(), x.copy()
    P_rate, P_trial, P_end = np.empty((7, 7)), P.copy(), P.copy()
    for weight, ahead in ((1.0 / 6.0, 0.5), (1.0 / 3.0, 0.5), (1.0 / 3.0, 1.0), (1.0 / 6.0, 0.0)):
        _coupled_rate(x_rate, P_rate, x_trial, P_trial, u, z, Q_diag, R_diag, mass_kg, payload_mass_kg, length_m)
        for i in range(7):
            x_end[i] += dt_s * weight * x_rate[i]
            x_trial[i] = x[i] + dt_s * ahead * x_rate[i]
            for j in range(7):
                P_end[i, j] += dt_s * weight * P_rate[i, j]
                P_trial[i, j] = P[i, j] + dt_s * ahead * P_rate[i, j]
    total = 0.0
    for i in range(7):
        total += abs(x_end[i])
        for j in range(7):
            total += abs(P_end[i, j])
    if not np.isfinite(total):
        return _NOT_FINITE
    x[:] = x_end
    P[:, :] = P_end
    return _OK
