"""The filter's Runge-Kutta step of mean and covariance against SciPy on (10)-(12) with the Lagrangian's model."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swingd.core import swing_ekf as kernels
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status
from swingd.core.swing_ekf_rk4 import rk4_step

from .two_point_masses import model

# The study's octarotor as its filter knows it, and the filter's settings (Drones 2023, 7, 654, section 4.1).
M, ML, L = 70.0, 90.0, 15.0
HOVER = np.array([0.0, 0.0, -(M + ML) * GRAVITY_MPS2])
Q_DIAG = np.array([1e-7, 1e-7, 1e-7, 1e-7, 1.0, 1.0, 1e-7])
R_DIAG = np.full(3, 3.6e-5)
P_START = np.diag([1e-6, 1e-6, 1e-6, 1e-6, 2.0, 2.0, 1e-5])
DT_S = 0.004

X = np.array([0.3, -0.2, 0.25, 0.15, 20.0, -10.0, 5.0])
U = HOVER + np.array([60.0, -40.0, 30.0])
Z = np.array([0.4, -0.3, 0.2])


def coupled(rng):
    """A covariance whose entries all matter, of the size of the study's."""
    root = rng.normal(size=(7, 7)) * np.array([0.01, 0.01, 0.01, 0.01, 1.0, 1.0, 0.01])[:, None]
    return root @ root.T + P_START


def rk4(x, P, u, z, dt_s=DT_S, count=1, Q=Q_DIAG, R=R_DIAG):
    x, P = x.copy(), P.copy()
    for _ in range(count):
        assert rk4_step(x, P, u, z, Q, R, dt_s, M, ML, L) == Status.OK
    return x, P


def rates(x, P, u, z):
    """Right sides of (10) and (12) with the gain (11), from the Lagrangian."""
    F, H = model().jacobians(x, u, M, ML, L)
    K = P @ H.T @ np.diag(1.0 / R_DIAG)
    x_rate = model().dynamics(x, u, M, ML, L) + K @ (z - model().observation(x, u, M, ML, L))
    P_rate = F @ P + P @ F.T - K @ np.diag(R_DIAG) @ K.T + np.diag(Q_DIAG)
    return x_rate, P_rate


def by_scipy(x, P, u, z, duration_s):
    def rate(_t, packed):
        x_rate, P_rate = rates(packed[:7], packed[7:].reshape(7, 7), u, z)
        return np.concatenate([x_rate, P_rate.ravel()])

    end = solve_ivp(rate, (0.0, duration_s), np.concatenate([x, P.ravel()]), method="DOP853", rtol=1e-10, atol=1e-14).y[
        :, -1
    ]
    return end[:7], end[7:].reshape(7, 7)


def test_a_short_step_is_the_differential_equation():
    """By a step that shrinks, so that not one entry of either rate is missed."""
    P = coupled(np.random.default_rng(1))
    x_rate, P_rate = rates(X, P, U, Z)
    dt_s = 1e-9
    x_end, P_end = rk4(X, P, U, Z, dt_s)
    np.testing.assert_allclose((x_end - X) / dt_s, x_rate, rtol=1e-4, atol=1e-5)
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    np.testing.assert_allclose((P_end - P) / dt_s / scale, P_rate / scale, rtol=1e-4, atol=1e-5)


def test_mean_and_covariance_are_scipys():
    duration_s = 0.04
    x, P = rk4(X, P_START, U, Z, count=round(duration_s / DT_S))
    x_expected, P_expected = by_scipy(X, P_START, U, Z, duration_s)
    np.testing.assert_allclose(x, x_expected, rtol=1e-5, atol=1e-8)
    scale = np.sqrt(np.outer(np.diag(P_expected), np.diag(P_expected)))
    np.testing.assert_allclose(P / scale, P_expected / scale, atol=1e-5)


def test_the_step_is_of_fourth_order():
    duration_s = 0.04
    x_exact, P_exact = by_scipy(X, P_START, U, Z, duration_s)
    errors = []
    for count in (4, 8, 16):
        x, P = rk4(X, P_START, U, Z, duration_s / count, count)
        errors.append([np.abs(x - x_exact).max(), np.abs(P - P_exact).max()])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.6)


def test_backward_euler_goes_the_same_way_as_its_steps_shrink():
    duration_s = 0.04
    x_rk4, P_rk4 = rk4(X, P_START, U, Z, count=round(duration_s / DT_S))
    errors = []
    for count in (400, 800):
        x, P, nis = X, P_START, np.empty(1)
        dt_s = duration_s / count
        for _ in range(count):
            x_out, P_out = np.empty(7), np.empty((7, 7))
            status = kernels.step(
                x_out, P_out, nis, x, P, U, Z, Q_DIAG, R_DIAG, dt_s, dt_s, M, ML, L, math.inf, 0
            )  # fmt: skip
            assert status == Status.OK
            x, P = x_out, P_out
        errors.append([np.abs(x - x_rk4).max(), np.abs(P - P_rk4).max()])
    assert max(errors[1]) < 0.03  # N, of a force estimate of 20
    np.testing.assert_allclose(np.array(errors[0]) / errors[1], 2.0, rtol=0.1)


def test_covariance_stays_symmetric_and_positive_definite_over_a_long_random_run():
    rng = np.random.default_rng(5)
    x, P = np.zeros(7), P_START.copy()
    for k in range(5000):
        push = np.array([40.0, 30.0, 20.0]) * np.sin(0.7 * k * DT_S + np.array([0.0, 1.0, 2.0]))
        z = model().observation(np.zeros(7), HOVER, M, ML, L) if k == 0 else push / (M + ML)
        z = z + 0.3 * rng.normal(size=3)
        u = HOVER + push + 10.0 * rng.normal(size=3)
        assert rk4_step(x, P, u, z, Q_DIAG, R_DIAG, DT_S, M, ML, L) == Status.OK
        if k % 50 == 0:
            np.testing.assert_array_equal(P, P.T)
            scale = 1.0 / np.sqrt(np.diag(P))
            assert np.linalg.eigvalsh(P * np.outer(scale, scale)).min() > 0.0
    assert np.abs(x[:2]).max() < 1.0


@pytest.mark.parametrize("where", ["x", "P", "u", "z", "dt"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_refused_and_changes_nothing(where, value):
    x, P, u, z = X.copy(), P_START.copy(), U.copy(), Z.copy()
    match where:
        case "x":
            x[4] = value
        case "P":
            P[2, 2] = value
        case "u":
            u[1] = value
        case "z":
            z[0] = value
    x_before, P_before = x.copy(), P.copy()
    dt_s = value if where == "dt" else DT_S
    assert rk4_step(x, P, u, z, Q_DIAG, R_DIAG, dt_s, M, ML, L) == Status.NOT_FINITE
    np.testing.assert_array_equal(x, x_before)
    np.testing.assert_array_equal(P, P_before)


def test_a_step_too_long_for_the_method_is_refused():
    """Explicit: far beyond the filter's time constants it runs away, and says so."""
    x, P = X.copy(), P_START.copy()
    statuses = {rk4_step(x, P, U, Z, Q_DIAG, R_DIAG, 10.0, M, ML, L) for _ in range(10)}
    assert Status.NOT_FINITE in statuses
    assert np.isfinite(x).all()
    assert np.isfinite(P).all()
