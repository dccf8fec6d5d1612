"""The swing angles of a cable whose horizontal part is known, as `swingd.core.slts` has it."""

from math import cos, sin, sqrt

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel
from swingd.core.linalg import multiply, multiply_transposed
from swingd.core.tether_ukf import swing_angles

_STEP = 1e-6
"""Of the central differences, relative to the cable and to cable over second."""


@kernel(VOID(VEC, VEC))
def _angles(swing_out, direction):
    """`swing_angles` of the horizontal part of the cable's unit vector, hook to load, and of its derivative, (4,)."""
    x, y, x_rate, y_rate = direction[0], direction[1], direction[2], direction[3]
    z = sqrt(max(1.0 - x * x - y * y, 1e-12))
    whole = np.array((x, y, z, x_rate, y_rate, -(x * x_rate + y * y_rate) / z))
    swing_angles(swing_out, whole)


@kernel(VOID(VEC, VEC, MAT, VEC, MAT, F8, F8))
def swing(swing_out, rate_out, P_out, relative, P, length_m, to_level_rad):
    """Swing angles with their derivative and covariance.

    Parameters
    ----------
    swing_out, rate_out : (4,), written
        xi, zeta [rad], their rates [rad/s]; and the time derivative of all four.
    P_out : (4, 4), written
        Covariance of ``swing_out``, by its Jacobian.
    relative : (6,)
        r, v and v' of the vehicle relative to the load, north and east: [m], [m/s], [m/s^2].
    P : (4, 4)
        Covariance of r and v.
    length_m : float
    to_level_rad : float
        By how much vectors of ned are turned to be vectors of the level frame.
    """
    # The unit vector reaches the other way, from the vehicle to the load.
    c, s = -cos(to_level_rad) / length_m, -sin(to_level_rad) / length_m
    direction, direction_rate = np.empty(4), np.empty(4)
    for i in range(0, 4, 2):
        direction[i] = c * relative[i] - s * relative[i + 1]
        direction[i + 1] = s * relative[i] + c * relative[i + 1]
        direction_rate[i] = c * relative[i + 2] - s * relative[i + 3]
        direction_rate[i + 1] = s * relative[i + 2] + c * relative[i + 3]
    _angles(swing_out, direction)
    turn = np.zeros((4, 4))
    for i in range(0, 4, 2):
        turn[i, i], turn[i, i + 1], turn[i + 1, i], turn[i + 1, i + 1] = c, -s, s, c
    jacobian, beyond, before, near = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4)
    for j in range(4):
        near[:] = direction
        near[j] = direction[j] + _STEP
        _angles(beyond, near)
        near[j] = direction[j] - _STEP
        _angles(before, near)
        for i in range(4):
            jacobian[i, j] = (beyond[i] - before[i]) / (2.0 * _STEP)
    for i in range(4):
        rate_out[i] = 0.0
        for j in range(4):
            rate_out[i] += jacobian[i, j] * direction_rate[j]
    whole, half = np.empty((4, 4)), np.empty((4, 4))
    multiply(whole, jacobian, turn)
    multiply(half, whole, P)
    multiply_transposed(P_out, half, whole)
