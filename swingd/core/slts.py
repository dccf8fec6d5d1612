"""Slung load transport system: a vehicle over a point load on a rigid cable, in the load's position and the cable's.

The dynamics (1)-(4) of the GP-EKF paper. Frame ned. l = (r, -s) with s = sqrt(l^2 - r.r) reaches from the load to the
vehicle, so r and v = r' are the vehicle *relative to the load*, projected on the level plane: a vehicle that
accelerates north leads its load, r north of zero. l' = B v with B = (1; r^T / s).

The mass matrix of (4) need not be inverted: with the cable's unit vector q = l / l, the pull per mass
y = f_b / m_b - f_p / m_p that parts the two and kappa = |B v|^2,

    v'   = y_xy - (r / l) a          a = q.y + kappa / l
    v_p' = g + f_p / m_p + m_b / (m_b + m_p) a q

and the cable's tension is m_b m_p / (m_b + m_p) a, negative where a real cable would be slack.
"""

from enum import IntEnum
from math import sqrt

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status

NUM_STATES = 10
NUM_INPUTS = 6
"""Force on the vehicle, force on the load, ned, 3 each."""
REACH_MAX = 0.95
"""|r| over the cable's length; beyond it (72 deg) r does not describe the cable well any more."""

_OK = int(Status.OK)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NOT_FINITE = int(Status.NOT_FINITE)


class SltsState(IntEnum):
    """Offsets into the state, SI units."""

    LOAD_POS = 0
    """x_p, ned, 3."""
    REL_POS = 3
    """r, vehicle relative to the load, north and east."""
    LOAD_VEL = 5
    """v_p, ned, 3."""
    REL_VEL = 8
    """v, north and east."""


_S = SltsState


@kernel(VOID(VEC, MAT, VEC, F8))
def cable(cable_out, B_out, r, length_m):
    """Cable's vector l and the projection B of (1).

    Parameters
    ----------
    cable_out : (3,), written
        From the load to the vehicle, ned [m].
    B_out : (3, 2), written
    r : (2,)
        [m], |r| < length_m; checked by the caller.
    length_m : float
    """
    s = sqrt(length_m * length_m - r[0] * r[0] - r[1] * r[1])
    cable_out[0], cable_out[1], cable_out[2] = r[0], r[1], -s
    B_out[0, 0], B_out[0, 1] = 1.0, 0.0
    B_out[1, 0], B_out[1, 1] = 0.0, 1.0
    B_out[2, 0], B_out[2, 1] = r[0] / s, r[1] / s


@kernel(VOID(MAT, MAT, VEC, F8, F8, F8))
def mass_and_coriolis(M_out, C_out, x, mass_kg, payload_mass_kg, length_m):
    """M and C of (4), for the velocities (v_p, v).

    Parameters
    ----------
    M_out, C_out : (5, 5), written
    x : (10,)
        See `SltsState`.
    mass_kg, payload_mass_kg, length_m : float
    """
    rx, ry = x[_S.REL_POS], x[_S.REL_POS + 1]
    vx, vy = x[_S.REL_VEL], x[_S.REL_VEL + 1]
    s = sqrt(length_m * length_m - rx * rx - ry * ry)
    along = (rx * vx + ry * vy) / (s * s)
    B = np.zeros((3, 2))
    B[0, 0] = B[1, 1] = 1.0
    B[2, 0], B[2, 1] = rx / s, ry / s
    # Only the third row of B changes: (v + r (r.v) / s^2) / s.
    B_rate = np.array(((vx + rx * along) / s, (vy + ry * along) / s))
    M_out[:, :] = 0.0
    C_out[:, :] = 0.0
    for i in range(3):
        M_out[i, i] = mass_kg + payload_mass_kg
    for j in range(2):
        C_out[2, 3 + j] = mass_kg * B_rate[j]
        for i in range(3):
            M_out[i, 3 + j] = mass_kg * B[i, j]
            M_out[3 + j, i] = mass_kg * B[i, j]
        for k in range(2):
            C_out[3 + j, 3 + k] = mass_kg * B[2, j] * B_rate[k]
            for i in range(3):
                M_out[3 + j, 3 + k] += mass_kg * B[i, j] * B[i, k]


@kernel(I8(VEC, VEC, VEC, VEC, F8, F8, F8))
def acceleration(acc_out, x, force, load_force, mass_kg, payload_mass_kg, length_m):
    """v_p' and v' of (3).

    Parameters
    ----------
    acc_out : (6,), written
        v_p' ned, 3, v' 2 [m/s^2], and the cable's tension [N]. Untouched unless ``OK``.
    x : (10,)
        See `SltsState`.
    force : (3,)
        On the vehicle without weight and cable, ned [N]: thrust f_L = -T R_ned_from_frd e_z, and d_b.
    load_force : (3,)
        On the load without weight and cable, ned [N]: d_p.
    mass_kg, payload_mass_kg, length_m : float

    Returns
    -------
    Status
        ``NOT_CONVERGED`` if |r| is beyond `REACH_MAX`, ``NOT_FINITE``.
    """
    rx, ry = x[_S.REL_POS], x[_S.REL_POS + 1]
    vx, vy = x[_S.REL_VEL], x[_S.REL_VEL + 1]
    r2 = rx * rx + ry * ry
    if not np.isfinite(r2):
        return _NOT_FINITE
    if r2 > REACH_MAX * REACH_MAX * length_m * length_m:
        return _NOT_CONVERGED
    s = sqrt(length_m * length_m - r2)
    yx = force[0] / mass_kg - load_force[0] / payload_mass_kg
    yy = force[1] / mass_kg - load_force[1] / payload_mass_kg
    yz = force[2] / mass_kg - load_force[2] / payload_mass_kg
    across = rx * vx + ry * vy
    kappa = vx * vx + vy * vy + across * across / (s * s)
    a = (rx * yx + ry * yy - s * yz + kappa) / length_m
    share = mass_kg / (mass_kg + payload_mass_kg) * a / length_m
    if not np.isfinite(a):
        return _NOT_FINITE
    acc_out[0] = load_force[0] / payload_mass_kg + share * rx
    acc_out[1] = load_force[1] / payload_mass_kg + share * ry
    acc_out[2] = load_force[2] / payload_mass_kg - share * s + GRAVITY_MPS2
    acc_out[3] = yx - rx / length_m * a
    acc_out[4] = yy - ry / length_m * a
    acc_out[5] = payload_mass_kg * share * length_m
    return _OK


@kernel(VOID(MAT, MAT, VEC, VEC, VEC, F8, F8, F8))
def jacobians(A_out, G_out, x, force, load_force, mass_kg, payload_mass_kg, length_m):
    """Derivatives of the state's rate by the state and by both forces.

    Parameters
    ----------
    A_out : (10, 10), written
    G_out : (10, 6), written
        By ``force``, then by ``load_force``; the rows of the positions are zero.
    x, force, load_force, mass_kg, payload_mass_kg, length_m
        As in `acceleration`, which has accepted them.
    """
    rx, ry = x[_S.REL_POS], x[_S.REL_POS + 1]
    vx, vy = x[_S.REL_VEL], x[_S.REL_VEL + 1]
    L = length_m
    s2 = L * L - rx * rx - ry * ry
    s = sqrt(s2)
    yx = force[0] / mass_kg - load_force[0] / payload_mass_kg
    yy = force[1] / mass_kg - load_force[1] / payload_mass_kg
    yz = force[2] / mass_kg - load_force[2] / payload_mass_kg
    along = (rx * vx + ry * vy) / s2
    kappa = vx * vx + vy * vy + along * along * s2
    a = (rx * yx + ry * yy - s * yz + kappa) / L
    share = mass_kg / (mass_kg + payload_mass_kg)
    q = (rx / L, ry / L, -s / L)
    a_d_r = (
        (yx + rx / s * yz + 2.0 * along * (vx + along * rx)) / L,
        (yy + ry / s * yz + 2.0 * along * (vy + along * ry)) / L,
    )
    a_d_v = (2.0 * (vx + along * rx) / L, 2.0 * (vy + along * ry) / L)
    A_out[:, :] = 0.0
    G_out[:, :] = 0.0
    for i in range(3):
        A_out[_S.LOAD_POS + i, _S.LOAD_VEL + i] = 1.0
        for j in range(2):
            A_out[_S.LOAD_VEL + i, _S.REL_POS + j] = share * q[i] * a_d_r[j]
            A_out[_S.LOAD_VEL + i, _S.REL_VEL + j] = share * q[i] * a_d_v[j]
        for j in range(3):
            G_out[_S.LOAD_VEL + i, j] = share / mass_kg * q[i] * q[j]
            G_out[_S.LOAD_VEL + i, 3 + j] = -share / payload_mass_kg * q[i] * q[j]
        G_out[_S.LOAD_VEL + i, 3 + i] += 1.0 / payload_mass_kg
    for i in range(2):
        A_out[_S.REL_POS + i, _S.REL_VEL + i] = 1.0
        A_out[_S.LOAD_VEL + i, _S.REL_POS + i] += share * a / L
        A_out[_S.LOAD_VEL + 2, _S.REL_POS + i] += share * a * -q[i] / q[2] / L
        A_out[_S.REL_VEL + i, _S.REL_POS + i] = -a / L
        for j in range(2):
            A_out[_S.REL_VEL + i, _S.REL_POS + j] -= q[i] * a_d_r[j]
            A_out[_S.REL_VEL + i, _S.REL_VEL + j] = -q[i] * a_d_v[j]
        for j in range(3):
            G_out[_S.REL_VEL + i, j] = -q[i] * q[j] / mass_kg
            G_out[_S.REL_VEL + i, 3 + j] = q[i] * q[j] / payload_mass_kg
        G_out[_S.REL_VEL + i, i] += 1.0 / mass_kg
        G_out[_S.REL_VEL + i, 3 + i] -= 1.0 / payload_mass_kg
