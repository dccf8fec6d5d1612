"""Hierarchical control of a planar rotorcraft, Escareno et al., ICINCO 2016, section 4.

The outer layer asks for a force that moves the vehicle, the inner one turns the thrust there. Each layer takes out what
its filter says of the disturbance, (51)-(53) with the inertia multiplying:

    U = a (nu + G) - rho_hat,        nu = chi_d'' - kd (chi' - chi_d') - kp (chi - chi_d)
"""

from math import atan2, hypot, tan

from swingd.core._jit import F8, I8, VEC, kernel
from swingd.core.status import Status

_OK = int(Status.OK)
_GATED = int(Status.GATED)


@kernel(F8(F8, F8, F8, F8, F8, VEC, F8, F8))
def axis_force(pos, vel, pos_sp, vel_sp, acc_sp, gains, inertia, offset):
    """Force or torque that an undisturbed axis needs: a (nu + G), before rho_hat is taken out.

    Parameters
    ----------
    pos, vel : float
        As estimated [m, m/s] or [rad, rad/s].
    pos_sp, vel_sp, acc_sp : float
        Wanted, the last with its feed-forward chi_d''.
    gains : (2,)
        kp [1/s^2], kd [1/s].
    inertia : float
        a [kg] or [kg m^2].
    offset : float
        G, gravity on the vertical axis, else 0 [m/s^2].

    Returns
    -------
    float
        [N] or [N m]
    """
    return inertia * (acc_sp - gains[1] * (vel - vel_sp) - gains[0] * (pos - pos_sp) + offset)


@kernel(I8(VEC, F8, F8, F8, F8))
def thrust_and_pitch(out, u_x, u_z, u_z_min, tilt_max_rad):
    """Turn a wanted force into a thrust and the pitch that points it there, (54).

    Parameters
    ----------
    out : (2,), written
        T_d [N], theta_d [rad].
    u_x, u_z : float
        Wanted, forward and up [N].
    u_z_min : float
        > 0 [N].
    tilt_max_rad : float
        < pi/2.

    Returns
    -------
    Status
        ``GATED`` where the force was bounded: u_z to ``u_z_min`` at least, so that the thrust never has to point down,
        then u_x to what ``tilt_max_rad`` allows. Height comes first. Else ``OK``.

    Notes
    -----
    The law is singular at |theta| = pi/2 (remark 4.1).
    """
    status = _OK
    if u_z < u_z_min:
        u_z = u_z_min
        status = _GATED
    across_max = u_z * tan(tilt_max_rad)
    if abs(u_x) > across_max:
        u_x = across_max if u_x > 0.0 else -across_max
        status = _GATED
    out[0] = hypot(u_x, u_z)
    out[1] = atan2(u_x, u_z)
    return status
