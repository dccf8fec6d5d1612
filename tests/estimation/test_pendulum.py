"""The open-loop pendulum as an estimator."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.estimation import Pendulum
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Cable, Estimator, Parameters

L = 1.8
DT_S = 0.01
FORCE = np.zeros(3)


def pendulum(damping_ratio=0.03, high_pass_hz=0.0):
    parameters = dataclasses.replace(Parameters(), cable=Cable(L), estimator=Estimator(damping_ratio=damping_ratio))
    return Pendulum(parameters, high_pass_hz)


def acceleration(t):
    return np.array([1.5 * math.sin(2.0 * t), 0.8 * math.cos(1.1 * t), 0.5])


@pytest.mark.parametrize("high_pass_hz", [0.0, 0.1])
def test_against_scipy(high_pass_hz):
    """Piecewise constant acceleration, SciPy from step to step; the high-pass as its own differential equation."""
    estimator = pendulum(high_pass_hz=high_pass_hz)
    stiffness = GRAVITY_MPS2 / L
    damping = 2.0 * 0.03 * math.sqrt(stiffness)
    corner = 2.0 * math.pi * high_pass_hz
    y, slow = np.zeros(4), np.zeros(3)
    for k in range(150):
        acc = acceleration(k * DT_S)
        slow = slow + (1.0 - math.exp(-corner * DT_S)) * (acc - slow)
        passed = acc - slow if high_pass_hz else acc

        def rate(_t, y, passed=passed):
            drive = np.array([passed[1], -passed[0]]) / L
            return np.concatenate([y[2:], -stiffness * y[:2] - damping * y[2:] + drive])

        y = solve_ivp(rate, (0.0, DT_S), y, rtol=1e-9, atol=1e-12).y[:, -1]
        assert estimator.step(FORCE, acc, DT_S) is Status.OK
    estimate = estimator.estimate()
    np.testing.assert_allclose(estimate.x[:4], y, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        estimate.x_rate, np.concatenate([y[2:], -stiffness * y[:2] - damping * y[2:]]), rtol=1e-6
    )


def test_high_pass_removes_a_steady_acceleration():
    with_pass, without = pendulum(0.3, high_pass_hz=0.2), pendulum(0.3)
    for _ in range(3000):
        for estimator in (with_pass, without):
            estimator.step(FORCE, np.array([1.0, 0.0, 0.0]), DT_S)
    assert abs(with_pass.estimate().x[1]) < 1e-3
    assert without.estimate().x[1] == pytest.approx(-1.0 / GRAVITY_MPS2, rel=0.01)


def test_signs_in_words():
    """Accelerating forward leaves the load behind (zeta < 0), to the right leaves it to the left (xi > 0)."""
    estimator = pendulum()
    for _ in range(30):
        estimator.step(FORCE, np.array([1.0, 1.0, 0.0]), DT_S)
    xi, zeta = estimator.estimate().x[:2]
    assert xi > math.radians(1.0)
    assert zeta == pytest.approx(-xi)


def test_coasting_swings_on_without_acceleration_and_reset_begins_anew():
    one, other = pendulum(), pendulum()
    for estimator in (one, other):
        for _ in range(50):
            estimator.step(FORCE, np.array([1.0, 0.0, 0.0]), DT_S)
    one.coast(FORCE, 0.3)
    other.step(FORCE, np.zeros(3), 0.3)
    np.testing.assert_array_equal(one.estimate().x, other.estimate().x)
    one.reset(ResetReason.GAP)
    assert not one.estimate().x.any()
    assert one.resets[ResetReason.GAP] == 1


def test_the_estimate_knows_no_force_and_says_how_unsure_it_is():
    estimate = pendulum().estimate()
    assert estimate.nis == 0.0
    assert (np.diag(estimate.P)[:4] > 0.0).all()
    assert estimate.tension_n == pytest.approx(Parameters().payload.mass_kg * GRAVITY_MPS2)
