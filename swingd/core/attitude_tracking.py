"""Almost globally stable attitude tracking, (12) of the GP-EKF paper (Roza and Maggiore 2014)."""

from math import acos, sin

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel


@kernel(VOID(VEC, MAT, VEC, MAT, VEC, VEC, MAT, F8, F8))
def tracking_torque(torque_out, R, rate, R_d, rate_d, rate_d_rate, J, b_r, b_omega):
    """Torque that drives attitude and rate to those wanted.

    Parameters
    ----------
    torque_out : (3,), written
        frd [N m].
    R, rate : (3, 3), (3,)
        ned_from_frd, body rates frd [rad/s].
    R_d, rate_d, rate_d_rate : (3, 3), (3,), (3,)
        Wanted: ned_from_frd, rates and their derivative in the wanted body's axes [rad/s], [rad/s^2].
    J : (3, 3)
        Inertia [kg m^2].
    b_r, b_omega : float
        [N m], [N m s], > 0.

    Notes
    -----
    With R~ = R_d^T R, w~ = w - R~^T w_d and e_r = sum e_i x R~ e_i the loop is J w~' = -b_w w~ - b_r e_r - w~ x J w~:
    the energy 1/2 w~.J w~ + b_r (3 - tr R~) loses b_w |w~|^2. e_r is twice a small rotation's vector.
    """
    off = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            off[i, j] = R_d[0, i] * R[0, j] + R_d[1, i] * R[1, j] + R_d[2, i] * R[2, j]
    wanted, wanted_rate, error = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        wanted[i] = off[0, i] * rate_d[0] + off[1, i] * rate_d[1] + off[2, i] * rate_d[2]
        wanted_rate[i] = off[0, i] * rate_d_rate[0] + off[1, i] * rate_d_rate[1] + off[2, i] * rate_d_rate[2]
        error[i] = rate[i] - wanted[i]
    ahead = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        ahead[i] = error[j] * wanted[k] - error[k] * wanted[j] - wanted_rate[i]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        Je_j = J[j, 0] * error[0] + J[j, 1] * error[1] + J[j, 2] * error[2]
        Je_k = J[k, 0] * error[0] + J[k, 1] * error[1] + J[k, 2] * error[2]
        Jw_j = J[j, 0] * rate[0] + J[j, 1] * rate[1] + J[j, 2] * rate[2]
        Jw_k = J[k, 0] * rate[0] + J[k, 1] * rate[1] + J[k, 2] * rate[2]
        torque_out[i] = (
            -b_omega * error[i]
            - b_r * (off[k, j] - off[j, k])
            - (error[j] * Je_k - error[k] * Je_j)
            + (rate[j] * Jw_k - rate[k] * Jw_j)
            - (J[i, 0] * ahead[0] + J[i, 1] * ahead[1] + J[i, 2] * ahead[2])
        )


@kernel(VOID(VEC, MAT, MAT, F8))
def rate_between(rate_out, R_before, R_after, dt_s):
    """Constant body rate that turns one attitude into another, (R^T R')^v of (12) over an interval.

    Parameters
    ----------
    rate_out : (3,), written
        frd [rad/s].
    R_before, R_after : (3, 3)
        ned_from_frd, less than half a turn apart.
    dt_s : float
        > 0.
    """
    turn = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            turn[i, j] = (
                R_before[0, i] * R_after[0, j] + R_before[1, i] * R_after[1, j] + R_before[2, i] * R_after[2, j]
            )
    angle = acos(min(max(0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0), -1.0), 1.0))
    scale = 0.5 / dt_s
    if angle > 1e-4:
        scale *= angle / sin(angle)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rate_out[i] = scale * (turn[k, j] - turn[j, k])
