"""The Fading Gaussian Deterministic Filter (FGDF), the linear baseline of Drones 2023, 7, 654, (22)-(26).

A Kalman filter on the swing of a hovering vehicle, without process noise: what keeps its gain open is that the
covariance is divided by the fading factor in every step, so that old measurements are forgotten with a memory of
dt / (1 - beta). It measures the cable's direction as what the vehicle's acceleration does not owe to thrust and
weight, which takes wind for the load's pull, and knows no disturbance.

States xi, zeta, their rates (`swingd.core.swing_ekf.State`); level frame, x forward, y right, z down. The linearised
model is that of (8) with the hovering thrust M g in the stiffness and the horizontal force as input:

    xi''   = -omega^2 xi   + u_y / (m L)
    zeta'' = -omega^2 zeta - u_x / (m L)        omega^2 = (g / L) (m + m_l) / m
"""

import math

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status

NUM_STATES = 4
FORCE_MIN_SHARE = 1e-12
"""Of the vehicle's weight: a smaller cable force is rounding and has no direction."""

_OK = int(Status.OK)
_GATED = int(Status.GATED)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_POSITIVE = int(Status.NOT_POSITIVE)


@kernel(VOID(MAT, MAT, F8, F8, F8, F8))
def transition(Phi_out, Gamma_out, mass_kg, payload_mass_kg, length_m, dt_s):
    """State transition Phi = exp(A dt) and control input Gamma = A^-1 (Phi - I) B in closed form.

    Parameters
    ----------
    Phi_out : (4, 4), written
    Gamma_out : (4, 2), written
        For the horizontal force (u_x, u_y), held over the interval.
    mass_kg, payload_mass_kg : float
        Vehicle without load, load as the filter assumes it [kg].
    length_m : float
        Cable [m].
    dt_s : float
        Interval [s].

    Notes
    -----
    Equations (22)-(24), (26) of Drones 2023, 7, 654. Misprints there: in (24) -0.0088 must be -0.0076 (the entry of
    the other axis, 0.008, is its rounding), in (26) 2.64 must be 2.631.
    """
    omega = math.sqrt(GRAVITY_MPS2 / length_m * (mass_kg + payload_mass_kg) / mass_kg)
    c, s = math.cos(omega * dt_s), math.sin(omega * dt_s)
    half = math.sin(0.5 * omega * dt_s)
    per_inertia = 1.0 / (mass_kg * length_m)
    # (1 - cos) / omega^2 without the cancellation.
    angle_d_force = 2.0 * half * half / (omega * omega) * per_inertia
    rate_d_force = s / omega * per_inertia
    Phi_out[:, :] = 0.0
    Gamma_out[:, :] = 0.0
    for i in range(2):
        Phi_out[i, i] = c
        Phi_out[i, i + 2] = s / omega
        Phi_out[i + 2, i] = -omega * s
        Phi_out[i + 2, i + 2] = c
    # A push to the right leaves the load to the left (xi > 0), a push forward leaves it behind (zeta < 0).
    Gamma_out[0, 1] = angle_d_force
    Gamma_out[2, 1] = rate_d_force
    Gamma_out[1, 0] = -angle_d_force
    Gamma_out[3, 0] = -rate_d_force


@kernel(VOID(VEC, VEC, VEC, F8))
def cable_force(force_out, u, z, mass_kg):
    """Force on the vehicle that thrust and weight do not account for: f_l = m z - m g e_z - u.

    Parameters
    ----------
    force_out : (3,), written
        Level frame [N]; with a hanging load it points along the cable, hook to load.
    u : (3,)
        Thrust and known forces on the vehicle, level frame [N].
    z : (3,)
        Inertial acceleration of the hook, level frame [m/s^2].
    mass_kg : float
        Vehicle without load [kg].
    """
    for i in range(3):
        force_out[i] = mass_kg * z[i] - u[i]
    force_out[2] -= mass_kg * GRAVITY_MPS2


@kernel(I8(VEC, VEC, VEC, F8))
def synthetic_angles(angles_out, u, z, mass_kg):
    """Swing angles that the cable force shows: zeta = asin(f_x / |f|), xi = atan2(-f_y, f_z).

    Parameters
    ----------
    angles_out : (2,), written
        xi in (-pi, pi], beyond +-pi/2 where the force does not pull the vehicle down, and zeta in [-pi/2, pi/2] [rad].
        Untouched unless ``OK``.
    u, z, mass_kg
        As in `cable_force`.

    Returns
    -------
    Status
        ``GATED`` where the force vanishes and has no direction, ``NOT_FINITE``.
    """
    f_x = mass_kg * z[0] - u[0]
    f_y = mass_kg * z[1] - u[1]
    f_z = mass_kg * (z[2] - GRAVITY_MPS2) - u[2]
    across = math.hypot(f_y, f_z)
    size = math.hypot(f_x, across)
    if not np.isfinite(size):
        return _NOT_FINITE
    if size <= FORCE_MIN_SHARE * mass_kg * GRAVITY_MPS2:
        return _GATED
    angles_out[0] = math.atan2(-f_y, f_z)
    # The arcsine of the paper, well conditioned up to +-pi/2.
    angles_out[1] = math.atan2(f_x, across)
    return _OK


@kernel(I8(VEC, MAT, VEC, VEC, F8, F8))
def correct(x, E, nis_out, angles, angle_var, nis_gate):
    """Correct the state by measured angles, H of (25) and R = angle_var I2.

    Parameters
    ----------
    x, E : (4,), (4, 4), changed
        State and error covariance at the instant of the measurement; untouched unless ``OK``.
    nis_out : (1,), written
        Normalised innovation squared, 2 degrees of freedom.
    angles : (2,)
        Measured xi, zeta [rad].
    angle_var : float
        Variance of one sample of either angle [rad^2], > 0.
    nis_gate : float
        A measurement above it is left out; infinite: none is.

    Returns
    -------
    Status
        ``OK``, ``GATED``, ``NOT_POSITIVE`` or ``NOT_FINITE``.

    Notes
    -----
    The covariance is updated in Joseph's form on one triangle, so that it stays symmetric and positive definite however
    long the filter runs.
    """
    s_00, s_10, s_11 = E[0, 0] + angle_var, E[1, 0], E[1, 1] + angle_var
    determinant = s_00 * s_11 - s_10 * s_10
    if not (s_00 > 0.0 and determinant > 0.0):
        return _NOT_POSITIVE
    nu_xi, nu_zeta = angles[0] - x[0], angles[1] - x[1]
    nis = (s_11 * nu_xi * nu_xi - 2.0 * s_10 * nu_xi * nu_zeta + s_00 * nu_zeta * nu_zeta) / determinant
    if not np.isfinite(nis):
        return _NOT_FINITE
    nis_out[0] = nis
    if nis > nis_gate:
        return _GATED
    K = np.empty((4, 2))
    less = np.empty((4, 4))
    for i in range(4):
        K[i, 0] = (E[i, 0] * s_11 - E[i, 1] * s_10) / determinant
        K[i, 1] = (E[i, 1] * s_00 - E[i, 0] * s_10) / determinant
        x[i] += K[i, 0] * nu_xi + K[i, 1] * nu_zeta
        for j in range(4):
            less[i, j] = E[i, j] - K[i, 0] * E[0, j] - K[i, 1] * E[1, j]
    for i in range(4):
        for j in range(i + 1):
            E[i, j] = (
                less[i, j]
                - less[i, 0] * K[j, 0]
                - less[i, 1] * K[j, 1]
                + angle_var * (K[i, 0] * K[j, 0] + K[i, 1] * K[j, 1])
            )
            E[j, i] = E[i, j]
    return _OK


@kernel(I8(VEC, MAT, VEC, MAT, MAT, F8))
def predict(x, E, u, Phi, Gamma, fading):
    """Carry the state over one interval: x = Phi x + Gamma u, E = Phi E Phi^T / beta.

    Parameters
    ----------
    x, E : (4,), (4, 4), changed
        From the interval's start to its end; untouched unless ``OK``.
    u : (>= 2,)
        Force on the vehicle over the interval, level frame [N].
    Phi, Gamma : (4, 4), (4, 2)
        See `transition`.
    fading : float
        beta, 0 < beta <= 1, of this interval; 1 forgets nothing.

    Returns
    -------
    Status
        ``OK`` or ``NOT_FINITE``.
    """
    x_next = np.empty(4)
    product = np.empty((4, 4))
    E_next = np.empty((4, 4))
    size = 0.0
    for i in range(4):
        x_next[i] = Gamma[i, 0] * u[0] + Gamma[i, 1] * u[1]
        for k in range(4):
            x_next[i] += Phi[i, k] * x[k]
        for j in range(4):
            product[i, j] = 0.0
            for k in range(4):
                product[i, j] += Phi[i, k] * E[k, j]
    for i in range(4):
        size += abs(x_next[i])
        for j in range(i + 1):
            total = 0.0
            for k in range(4):
                total += product[i, k] * Phi[j, k]
            E_next[i, j] = total / fading
            size += abs(E_next[i, j])
    if not np.isfinite(size):
        return _NOT_FINITE
    for i in range(4):
        x[i] = x_next[i]
        for j in range(i + 1):
            E[i, j] = E_next[i, j]
            E[j, i] = E_next[i, j]
    return _OK


@kernel(I8(VEC, MAT, VEC, VEC, VEC, MAT, MAT, F8, F8, F8, F8))
def step(x, E, nis_out, u, z, Phi, Gamma, angle_var, fading, mass_kg, nis_gate):
    """One cycle of the filter: correct by what was measured at t_k, then predict to t_k+1.

    Parameters
    ----------
    x, E : (4,), (4, 4), changed
        A priori estimate of t_k before, of t_k+1 = t_k + dt after: the estimate has the same age as that of a filter
        which integrates over the interval. To be ignored unless the answer is ``OK`` or ``GATED``.
    nis_out : (1,), written
        Normalised innovation squared at t_k, 2 degrees of freedom; 0 where there was none.
    u : (3,)
        Thrust and known forces on the vehicle at t_k, held until t_k+1, level frame [N].
    z : (3,)
        Inertial acceleration of the hook at t_k, level frame [m/s^2].
    Phi, Gamma : (4, 4), (4, 2)
        Of dt, see `transition`.
    angle_var : float
        Variance of one sample of the synthetic angles [rad^2], > 0.
    fading : float
        beta, 0 < beta <= 1.
    mass_kg : float
        Vehicle without load [kg].
    nis_gate : float
        See `correct`; the paper gates nothing, which is an infinite gate.

    Returns
    -------
    Status
        ``OK``; ``GATED``, predicted only, where the gate or a vanishing cable force left the measurement out;
        ``NOT_POSITIVE`` or ``NOT_FINITE``.

    Notes
    -----
    Section 4.1 of Drones 2023, 7, 654: E(k+1)^- = Phi E(k)^+ Phi^T / beta, no process noise. Neither estimate nor gain
    depends on the size of ``angle_var`` once the initial covariance is forgotten: it scales E alone.
    """
    angles = np.empty(2)
    nis_out[0] = 0.0
    measured = synthetic_angles(angles, u, z, mass_kg)
    if measured == _OK:
        measured = correct(x, E, nis_out, angles, angle_var, nis_gate)
    if measured != _OK and measured != _GATED:
        return measured
    status = predict(x, E, u, Phi, Gamma, fading)
    return measured if status == _OK else status
