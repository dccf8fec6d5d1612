"""A load on a cable below a hook whose specific force was measured.

Seen from the hook, gravity and acceleration are one: with the specific force s = a - g of the hook, the cable's unit
vector n obeys

    n'' = -(s - n (n . s)) / L - |n'|^2 n - 2 zeta sqrt(g / L) n'

and the cable pulls with m_l (L |n'|^2 - n . s) along n. Neither gravity nor the autopilot's idea of the vertical is in
it: a level frame that is tilted by a constant angle tilts everything alike.
"""

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2


@kernel(VOID(MAT, MAT, VEC, F8, F8, F8))
def pull_per_mass(pull_out, force, start, dt_s, length_m, damping_ratio):
    """Let the load swing below a record of specific forces, and tell what the cable pulls the hook with.

    Parameters
    ----------
    pull_out : (n, 3), written
        Pull on the hook over the load's mass, at each sample [m/s^2]; its direction is the cable's.
    force : (n, 3)
        Specific force of the hook in a frame that does not turn, z down; linear between the samples [m/s^2].
    start : (4,)
        x and y of the cable's unit vector, and their derivatives [1/s], at the first sample; the load is below.
    dt_s : float
        Between samples [s].
    length_m : float
        Cable [m].
    damping_ratio : float
        Of the free swing below a hook at rest.

    Notes
    -----
    Classical Runge-Kutta, whose own damping at 25 samples a second is below 1e-5 of the critical one for 0.5 m.
    """
    decay_per_s = 2.0 * damping_ratio * np.sqrt(GRAVITY_MPS2 / length_m)
    n = np.empty(3)
    rate = np.empty(3)
    n[:2] = start[:2]
    rate[:2] = start[2:]
    n[2] = np.sqrt(max(1.0 - n[0] * n[0] - n[1] * n[1], 1e-4))
    rate[2] = -(n[0] * rate[0] + n[1] * rate[1]) / n[2]
    n_stage = np.empty(3)
    rate_stage = np.empty(3)
    felt = np.empty(3)
    n_d = np.zeros(3)
    rate_d = np.zeros(3)
    n_change = np.empty(3)
    rate_change = np.empty(3)
    last = force.shape[0] - 1
    for k in range(last + 1):
        n_s = n[0] * force[k, 0] + n[1] * force[k, 1] + n[2] * force[k, 2]
        speed2 = rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2]
        for i in range(3):
            pull_out[k, i] = (length_m * speed2 - n_s) * n[i]
        if k == last:
            return
        n_change[:] = 0.0
        rate_change[:] = 0.0
        for ahead, weight in ((0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0)):
            for i in range(3):
                felt[i] = force[k, i] + ahead * (force[k + 1, i] - force[k, i])
                n_stage[i] = n[i] + ahead * dt_s * n_d[i]
                rate_stage[i] = rate[i] + ahead * dt_s * rate_d[i]
            n_s = n_stage[0] * felt[0] + n_stage[1] * felt[1] + n_stage[2] * felt[2]
            speed2 = rate_stage[0] ** 2 + rate_stage[1] ** 2 + rate_stage[2] ** 2
            for i in range(3):
                n_d[i] = rate_stage[i]
                rate_d[i] = -(felt[i] - n_s * n_stage[i]) / length_m - speed2 * n_stage[i] - decay_per_s * rate_stage[i]
                n_change[i] += weight * dt_s * n_d[i]
                rate_change[i] += weight * dt_s * rate_d[i]
        for i in range(3):
            n[i] += n_change[i]
            rate[i] += rate_change[i]
