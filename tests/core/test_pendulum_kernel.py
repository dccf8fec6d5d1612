"""The linear pendulum against SciPy: exact for a constant acceleration, whatever the step."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swingd.core import pendulum

LENGTH_M = 1.7
STIFFNESS = 9.80665 / LENGTH_M


@pytest.mark.parametrize("damping_ratio", [0.0, 0.02, 0.5])
@pytest.mark.parametrize("dt_s", [1e-3, 0.01, 1.0])
def test_exact_for_a_constant_acceleration(damping_ratio, dt_s):
    x = np.array([0.2, -0.1, 0.4, 0.7])
    acc = np.array([1.2, -0.8, 3.0])
    damping = 2.0 * damping_ratio * math.sqrt(STIFFNESS)

    def rate(_t, y):
        drive = np.array([acc[1], -acc[0]]) / LENGTH_M
        return np.concatenate([y[2:], -STIFFNESS * y[:2] - damping * y[2:] + drive])

    exact = solve_ivp(rate, (0.0, dt_s), x, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    pendulum.step(x, acc, dt_s, STIFFNESS, damping_ratio, 1.0 / LENGTH_M)
    np.testing.assert_allclose(x, exact, rtol=1e-9, atol=1e-11)


def test_an_interval_may_be_divided():
    whole, parts = np.array([0.2, -0.1, 0.4, 0.7]), np.array([0.2, -0.1, 0.4, 0.7])
    acc = np.array([0.3, 0.5, 0.0])
    pendulum.step(whole, acc, 0.3, STIFFNESS, 0.05, 1.0 / LENGTH_M)
    for _ in range(10):
        pendulum.step(parts, acc, 0.03, STIFFNESS, 0.05, 1.0 / LENGTH_M)
    np.testing.assert_allclose(parts, whole, rtol=1e-11)


def test_signs_in_words():
    """Accelerating forward leaves the load behind (zeta < 0), to the right leaves it to the left (xi > 0)."""
    x = np.zeros(4)
    pendulum.step(x, np.array([1.0, 1.0, 0.0]), 0.1, STIFFNESS, 0.0, 1.0 / LENGTH_M)
    assert x[0] > 0.0 > x[1]
    assert x[2] > 0.0 > x[3]
