"""Path following of a slung load, (5)-(11) of the GP-EKF paper, every term under the paper's symbol.

The load follows straight legs between waypoints at a cruise speed. Frame ned; r, v and l = (r, -s) are the vehicle
relative to the load (`swingd.core.slts`). With the load's velocity error s_p = v_p + zeta, the swing's s_mu = v + mu
and sigma = s_p + B s_mu, the vehicle's, the law is that of the energy

    E = 1/2 (s_p, s_mu)^T M (s_p, s_mu) + W.l + |W| l,      W = m_p g + d_T

of velocities and of the cable out of its equilibrium, whose rate is

    E' = -K0 |sigma|^2 - k_L (r - r_d).B^T W + m_p s_p.zeta' + sigma.f_b

The second term is never positive. F, the swing's error that the load's velocity is asked to give way to, makes
m_p s_p.zeta' damp s_p: with k_p = lambda = 0 it is m_p k_r s_p.B s_mu = m_p k_r (s_p.sigma - |s_p|^2), and
f_b = -m_p k_r s_p takes the mixed part away. k_p and lambda add terms of their own size that E alone does not judge.

What the paper prints otherwise: (7) has the wrong sign, for r is the vehicle relative to the load; in (10) f_b would
cancel f_0's zeta' and s_p is undefined; in (11) the vehicle would fly upside down.
"""

from enum import IntEnum
from math import cos, hypot, sin, sqrt, tan

import numpy as np

from swingd.core import slts
from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slts import REACH_MAX, SltsState
from swingd.core.status import Status


class PathParam(IntEnum):
    """Offsets into the parameters, SI units."""

    MASS = 0
    PAYLOAD_MASS = 1
    CABLE_LENGTH = 2
    CRUISE = 3
    """Speed along the path [m/s]."""
    LEAD = 4
    """A leg ends where less than this is left of it [m]."""
    K_P = 5
    """[1/s]"""
    K_L = 6
    """[1/s]"""
    K_0 = 7
    """[kg/s]"""
    K_R = 8
    """[1/s]"""
    LEAK = 9
    """lambda of F [1/s]."""
    LAMBDA_T = 10
    """[1/s]"""
    KAPPA = 11
    """[1/s]"""
    TILT_MAX = 12
    """Of f_v [rad]."""
    LIFT_MIN = 13
    """Vertical part of f_v [N]."""
    LIFT_MAX = 14
    SIZE = 15


class PathState(IntEnum):
    """Offsets into the memory."""

    LEG = 0
    """Index of the waypoint where the leg begins; that of the last one while the load is held there."""
    F = 1
    """F of (10), ned, 3 [m/s]."""
    D_B = 4
    """d_b of (9), ned, 3 [N]."""
    IMPULSE = 7
    """Integral of (8), ned, 3 [N s]."""
    SIZE = 10


class PathTerm(IntEnum):
    """Offsets into what an update reports, ned, 3 each unless said otherwise; forces in N."""

    E_P = 0
    """(5) [m]"""
    E_V = 3
    """(6) [m/s]"""
    R_D = 6
    """(7), 2 [m]."""
    MU = 8
    """(7), 2 [m/s]."""
    D_T = 10
    """(8): the load's disturbance, and what acts on the vehicle along the cable."""
    D_PERP = 13
    """(9): the vehicle's disturbance across the cable."""
    ZETA = 16
    """[m/s]"""
    ZETA_RATE = 19
    R = 22
    """B (v + mu) [m/s]."""
    S_P = 25
    """v_p + zeta [m/s]."""
    F_0 = 28
    F_A = 31
    F_B = 34
    F_T = 37
    F_V = 40
    """Thrust wanted, within the limits."""
    ENERGY = 43
    """E above, 1 [J]."""
    REMAINING = 44
    """Left of the leg, 1 [m]; 0 while the load is held."""
    SIZE = 45


_S = SltsState
_P = PathParam
_M = PathState
_T = PathTerm
_OK = int(Status.OK)
_NOT_CONVERGED = int(Status.NOT_CONVERGED)
_NOT_FINITE = int(Status.NOT_FINITE)


@kernel(VOID(VEC, VEC, VEC, MAT, VEC))
def momentum(momentum_out, x, p, B, ell):
    """Momentum of load and vehicle, (m_p + m_b) v_p + m_b B v, ned, 3 [N s]; B and ell by `swingd.core.slts.cable`."""
    slts.cable(ell, B, x[_S.REL_POS : _S.REL_POS + 2], p[_P.CABLE_LENGTH])
    for i in range(3):
        relative = B[i, 0] * x[_S.REL_VEL] + B[i, 1] * x[_S.REL_VEL + 1]
        momentum_out[i] = (p[_P.MASS] + p[_P.PAYLOAD_MASS]) * x[_S.LOAD_VEL + i] + p[_P.MASS] * relative


@kernel(I8(VEC, VEC, MAT, VEC))
def begin(state, x, waypoints, p):
    """Start on the first leg, without any disturbance known.

    Parameters
    ----------
    state : (PathState.SIZE,), written
    x : (10,)
        See `swingd.core.slts.SltsState`.
    waypoints : (k, 3)
        Of the load, ned [m], k >= 1.
    p : (PathParam.SIZE,)

    Returns
    -------
    Status
        ``NOT_CONVERGED`` where |r| is beyond the cable's reach.
    """
    if not hypot(x[_S.REL_POS], x[_S.REL_POS + 1]) <= REACH_MAX * p[_P.CABLE_LENGTH]:
        return _NOT_CONVERGED
    state[:] = 0.0
    momentum(state[_M.IMPULSE : _M.IMPULSE + 3], x, p, np.empty((3, 2)), np.empty(3))
    return _OK


@kernel(F8(VEC, VEC, VEC, MAT, VEC))
def _leg(e_p_out, n_out, state, waypoints, pos):
    """Cross-track error and direction of the leg, or the way to the last waypoint; gives what is left of the leg."""
    leg = int(state[_M.LEG])
    n_out[:] = 0.0
    for i in range(3):
        e_p_out[i] = pos[i] - waypoints[leg, i]
    if leg + 1 >= waypoints.shape[0]:
        return 0.0
    length = 0.0
    for i in range(3):
        n_out[i] = waypoints[leg + 1, i] - waypoints[leg, i]
        length += n_out[i] * n_out[i]
    length = sqrt(length)
    along = 0.0
    for i in range(3):
        n_out[i] /= length
        along += e_p_out[i] * n_out[i]
    for i in range(3):
        e_p_out[i] -= along * n_out[i]
    return length - along


@kernel(VOID(VEC, VEC))
def _limit(f_v, p):
    """Keep a wanted thrust within lift and tilt; the lift comes first."""
    f_v[2] = -min(max(-f_v[2], p[_P.LIFT_MIN]), p[_P.LIFT_MAX])
    level, level_max = hypot(f_v[0], f_v[1]), -f_v[2] * tan(p[_P.TILT_MAX])
    if level > level_max:
        f_v[0] *= level_max / level
        f_v[1] *= level_max / level


@kernel(I8(VEC, VEC, VEC, VEC, VEC, MAT, VEC, F8))
def update(terms_out, state, x, thrust, specific_force, waypoints, p, dt_s):
    """Give the thrust vector wanted, (10), and everything that it is made of.

    Parameters
    ----------
    terms_out : (PathTerm.SIZE,), written
    state : (PathState.SIZE,), changed
    x : (10,)
        Estimate, see `swingd.core.slts.SltsState`.
    thrust : (3,)
        f_L = -T R_ned_from_frd e_z as the vehicle is believed to give it now, ned [N].
    specific_force : (3,)
        Of the vehicle, a_b - g, ned [m/s^2].
    waypoints : (k, 3)
        Of the load, ned [m]; neighbours differ.
    p : (PathParam.SIZE,)
    dt_s : float
        Since the last update [s]; 0 at the first.

    Returns
    -------
    Status
        ``NOT_CONVERGED`` where |r| is beyond the cable's reach, ``NOT_FINITE``; the memory is untouched then.

    Notes
    -----
    A leg ends, and the next begins, where less than ``LEAD`` is left of it along its direction. After the last leg the
    load is held at the last waypoint: v_d = 0, and e_p is the whole way to it.
    """
    mass, payload_mass, L = p[_P.MASS], p[_P.PAYLOAD_MASS], p[_P.CABLE_LENGTH]
    k_l, k_r = p[_P.K_L], p[_P.K_R]
    size = 0.0
    for i in range(x.shape[0]):
        size += abs(x[i])
    for i in range(3):
        size += abs(thrust[i]) + abs(specific_force[i])
    if not np.isfinite(size):
        return _NOT_FINITE
    r, v = x[_S.REL_POS : _S.REL_POS + 2], x[_S.REL_VEL : _S.REL_VEL + 2]
    vel = x[_S.LOAD_VEL : _S.LOAD_VEL + 3]
    if hypot(r[0], r[1]) > REACH_MAX * L:
        return _NOT_CONVERGED
    ell, B, moving = np.empty(3), np.empty((3, 2)), np.empty(3)
    momentum(moving, x, p, B, ell)
    s = -ell[2]

    # (5), (6) on the leg that is flown.
    e_p, n = terms_out[_T.E_P : _T.E_P + 3], np.empty(3)
    remaining = _leg(e_p, n, state, waypoints, x[_S.LOAD_POS : _S.LOAD_POS + 3])
    while state[_M.LEG] + 1 < waypoints.shape[0] and remaining < p[_P.LEAD]:
        state[_M.LEG] += 1.0
        remaining = _leg(e_p, n, state, waypoints, x[_S.LOAD_POS : _S.LOAD_POS + 3])
    terms_out[_T.REMAINING] = remaining
    along = n[0] * vel[0] + n[1] * vel[1] + n[2] * vel[2]

    # (8), (9): 1 - q q^T is the projection of (9), and the cable's own force falls out of it.
    d_t, d_perp = terms_out[_T.D_T : _T.D_T + 3], terms_out[_T.D_PERP : _T.D_PERP + 3]
    felt = np.empty(3)
    for i in range(3):
        felt[i] = mass * specific_force[i] - thrust[i] - state[_M.D_B + i]
    pull = (felt[0] * ell[0] + felt[1] * ell[1] + felt[2] * ell[2]) / (L * L)
    blend = 1.0 - np.exp(-p[_P.KAPPA] * dt_s)
    d_along = 0.0
    for i in range(3):
        state[_M.D_B + i] += blend * (felt[i] - pull * ell[i])
        d_along += state[_M.D_B + i] * ell[i] / (L * L)
    across = 0.0
    for i in range(3):
        d_perp[i] = state[_M.D_B + i] - d_along * ell[i]
        weight = (mass + payload_mass) * GRAVITY_MPS2 if i == 2 else 0.0
        known = thrust[i] + d_perp[i] + weight
        # d_T is held in the integral as it is found, implicitly, which no step is too long for.
        d_t[i] = p[_P.LAMBDA_T] * (moving[i] - state[_M.IMPULSE + i] - known * dt_s) / (1.0 + p[_P.LAMBDA_T] * dt_s)
        state[_M.IMPULSE + i] += (known + d_t[i]) * dt_s
        across += d_t[i] * ell[i] / (L * L)

    # (7). Along the cable d_T may be a lack of thrust, and nothing there moves the equilibrium.
    W = np.empty(3)
    for i in range(3):
        W[i] = d_t[i] - across * ell[i]
    W[2] += payload_mass * GRAVITY_MPS2
    W_size = sqrt(W[0] * W[0] + W[1] * W[1] + W[2] * W[2])
    r_d, mu = terms_out[_T.R_D : _T.R_D + 2], terms_out[_T.MU : _T.MU + 2]
    for j in range(2):
        r_d[j] = -L * W[j] / W_size
        mu[j] = k_l * (r[j] - r_d[j])

    # (10).
    R, zeta, zeta_rate = (
        terms_out[_T.R : _T.R + 3],
        terms_out[_T.ZETA : _T.ZETA + 3],
        terms_out[_T.ZETA_RATE : _T.ZETA_RATE + 3],
    )
    across_v = (r[0] * v[0] + r[1] * v[1]) / (s * s)
    B_rate_mu = ((v[0] + r[0] * across_v) * mu[0] + (v[1] + r[1] * across_v) * mu[1]) / s
    energy = 0.0
    for i in range(3):
        R[i] = B[i, 0] * (v[0] + mu[0]) + B[i, 1] * (v[1] + mu[1])
        F_rate = k_r * R[i] - p[_P.LEAK] * state[_M.F + i]
        state[_M.F + i] += F_rate * dt_s
        v_d = p[_P.CRUISE] * n[i]
        terms_out[_T.E_V + i] = vel[i] - v_d
        zeta[i] = p[_P.K_P] * e_p[i] + state[_M.F + i] - v_d
        zeta_rate[i] = p[_P.K_P] * (vel[i] - along * n[i]) + F_rate
        s_p = vel[i] + zeta[i]
        mu_rate = k_l * (B[i, 0] * v[0] + B[i, 1] * v[1]) + (B_rate_mu if i == 2 else 0.0)
        weight = GRAVITY_MPS2 if i == 2 else 0.0
        terms_out[_T.S_P + i] = s_p
        terms_out[_T.F_0 + i] = -mass * (zeta_rate[i] + mu_rate)
        terms_out[_T.F_A + i] = -p[_P.K_0] * (s_p + R[i])
        terms_out[_T.F_B + i] = -payload_mass * k_r * s_p
        terms_out[_T.F_T + i] = -(mass + payload_mass) * weight - d_t[i] - d_perp[i]
        terms_out[_T.F_V + i] = (
            terms_out[_T.F_0 + i] + terms_out[_T.F_A + i] + terms_out[_T.F_B + i] + terms_out[_T.F_T + i]
        )
        energy += 0.5 * (payload_mass * s_p * s_p + mass * (s_p + R[i]) ** 2) + W[i] * ell[i]
    terms_out[_T.ENERGY] = energy + W_size * L
    _limit(terms_out[_T.F_V : _T.F_V + 3], p)
    return _OK


@kernel(VOID(MAT, VEC, F8))
def desired_attitude(R_out, f_v, yaw_rad):
    """Attitude whose thrust axis gives a wanted thrust, (11), with the nose towards a heading.

    Parameters
    ----------
    R_out : (3, 3), written
        ned_from_frd wanted; its columns are n_x, n_y, n_z = -f_v / |f_v|.
    f_v : (3,)
        ned [N], f_v_z < 0; checked by the caller.
    yaw_rad : float
    """
    size = sqrt(f_v[0] * f_v[0] + f_v[1] * f_v[1] + f_v[2] * f_v[2])
    zx, zy, zz = -f_v[0] / size, -f_v[1] / size, -f_v[2] / size
    xx, xy = cos(yaw_rad), sin(yaw_rad)
    xz = -(xx * zx + xy * zy) / zz
    size = sqrt(1.0 + xz * xz)
    xx, xy, xz = xx / size, xy / size, xz / size
    R_out[0, 0], R_out[1, 0], R_out[2, 0] = xx, xy, xz
    R_out[0, 1] = zy * xz - zz * xy
    R_out[1, 1] = zz * xx - zx * xz
    R_out[2, 1] = zx * xy - zy * xx
    R_out[0, 2], R_out[1, 2], R_out[2, 2] = zx, zy, zz
