"""Open-loop pendulum driven by the measured acceleration: the honest baseline of every swing estimate."""

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel


@kernel(VOID(VEC, VEC, F8, F8, F8, F8))
def step(x, acc_level, dt_s, stiffness_per_s2, damping_ratio, inv_length_per_m):
    """Advance xi, zeta and their rates over one interval of constant acceleration, exactly for the linear pendulum.

    Parameters
    ----------
    x : (4,), changed
        xi, zeta [rad], their rates [rad/s], level frame.
    acc_level : (>= 2,)
        Acceleration of the hook [m/s^2].
    dt_s : float
        Interval [s].
    stiffness_per_s2 : float
        g / L.
    damping_ratio : float
        0 <= ratio < 1.
    inv_length_per_m : float
        1 / L.
    """
    omega = np.sqrt(stiffness_per_s2)
    decay = damping_ratio * omega
    damped = omega * np.sqrt(1.0 - damping_ratio * damping_ratio)
    fall = np.exp(-decay * dt_s)
    c, s = fall * np.cos(damped * dt_s), fall * np.sin(damped * dt_s)
    for i in range(2):
        # Accelerating forward leaves the load behind (zeta < 0), to the right leaves it to the left (xi > 0).
        drive = acc_level[1] if i == 0 else -acc_level[0]
        rest = drive * inv_length_per_m / stiffness_per_s2
        angle, rate = x[i] - rest, x[2 + i]
        x[i] = rest + angle * c + (rate + decay * angle) / damped * s
        x[2 + i] = rate * c - (omega * omega * angle + decay * rate) / damped * s


@kernel(VOID(MAT, MAT, F8, F8, F8, F8))
def trajectory(swing_out, acc_level, dt_s, stiffness_per_s2, damping_ratio, inv_length_per_m):
    """Let the load swing from rest below a whole record of accelerations.

    Parameters
    ----------
    swing_out : (n, 4), written
        State at each sample; the first is at rest.
    acc_level : (n, >= 2)
        Acceleration of the hook from each sample to the next [m/s^2].
    dt_s, stiffness_per_s2, damping_ratio, inv_length_per_m : float
        As for `step`.
    """
    x = np.zeros(4)
    for row in range(swing_out.shape[0]):
        swing_out[row] = x
        step(x, acc_level[row], dt_s, stiffness_per_s2, damping_ratio, inv_length_per_m)
