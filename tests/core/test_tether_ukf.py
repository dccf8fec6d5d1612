"""The tether's filter on the sphere: geometry, motion, linear limit, the vertical, bad numbers."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from swingd.core import tether_ukf as kernels
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status

STILL = np.zeros(3)
L = 1.3
DT_S = 0.01


def state(theta=0.0, phi=0.0, theta_rate=0.0, phi_rate=0.0):
    """The state at an inclination and azimuth with their rates."""
    s, c = math.sin(theta), math.cos(theta)
    e_theta = np.array([c * math.cos(phi), c * math.sin(phi), -s])
    e_phi = np.array([-math.sin(phi), math.cos(phi), 0.0])
    n = np.array([s * math.cos(phi), s * math.sin(phi), c])
    return np.concatenate([n, theta_rate * e_theta + s * phi_rate * e_phi, e_theta, np.zeros(2)])


def hanging():
    x = np.empty(11)
    kernels.hang(x)
    return x


def anywhere(rng):
    x = np.concatenate([rng.normal(size=3), rng.normal(size=3), rng.normal(size=3), rng.normal(size=2)])
    kernels.straighten(x)
    return x


def turned(x, angle):
    c, s = math.cos(angle), math.sin(angle)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.concatenate([R @ x[:3], R @ x[3:6], R @ x[6:9], R[:2, :2] @ x[9:]])


@pytest.mark.parametrize("seed", range(8))
def test_an_error_leads_there_and_back(seed):
    rng = np.random.default_rng(seed)
    x, error, back, moved = anywhere(rng), rng.uniform(-1.5, 1.5, 6), np.empty(6), np.empty(11)
    kernels.moved(moved, x, error)
    n, v, e = moved[:3], moved[3:6], moved[6:9]
    assert n @ n == pytest.approx(1.0)
    assert [n @ v, n @ e] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert math.acos(n @ x[:3]) == pytest.approx(np.hypot(*error[:2]))
    kernels.error_to(back, x, moved)
    np.testing.assert_allclose(back, error, atol=1e-9)


def test_a_rate_keeps_its_size_and_its_angle_to_the_great_circle_on_the_way():
    rng = np.random.default_rng(3)
    x, moved = anywhere(rng), np.empty(11)
    kernels.moved(moved, x, np.array([0.7, -0.4, 0.0, 0.0, 0.0, 0.0]))
    way = x[:3] * math.cos(0.0) - moved[:3]
    tangent_here = -(way - (way @ x[:3]) * x[:3])
    tangent_there = -(way - (way @ moved[:3]) * moved[:3])
    for here, there in ((x[3:6], moved[3:6]), (x[6:9], moved[6:9])):
        assert np.linalg.norm(here) == pytest.approx(np.linalg.norm(there))
        assert here @ tangent_here / np.linalg.norm(tangent_here) == pytest.approx(
            there @ tangent_there / np.linalg.norm(tangent_there)
        )


def test_motion_is_the_spherical_pendulum_below_an_accelerated_pivot():
    theta, phi, theta_rate, phi_rate = 0.7, -2.1, 0.8, 1.4
    a = np.array([1.1, -0.7, 0.4])
    x, acc = state(theta, phi, theta_rate, phi_rate), np.empty(3)
    kernels.acceleration(acc, x, a, 1.0 / L)
    s, c = math.sin(theta), math.cos(theta)
    e_theta = np.array([c * math.cos(phi), c * math.sin(phi), -s])
    e_phi = np.array([-math.sin(phi), math.cos(phi), 0.0])
    # (6), (7) with the pivot's acceleration and the right signs.
    theta_acc = (-GRAVITY_MPS2 * s - a @ e_theta) / L + phi_rate**2 * s * c
    phi_acc = -(a @ e_phi) / (L * s) - 2.0 * theta_rate * phi_rate * c / s
    assert acc @ e_theta == pytest.approx(theta_acc - phi_rate**2 * s * c)
    assert acc @ e_phi == pytest.approx(s * phi_acc + 2.0 * theta_rate * phi_rate * c)
    assert acc @ x[:3] == pytest.approx(-(x[3:6] @ x[3:6]))


def test_a_pivot_that_accelerates_forward_leaves_the_load_behind_and_to_the_right_leaves_it_to_the_left():
    ahead, right = hanging(), hanging()
    for _ in range(20):
        kernels.swing_on(ahead, np.array([2.0, 0.0, 0.0]), 1.0 / L, DT_S)
        kernels.swing_on(right, np.array([0.0, 2.0, 0.0]), 1.0 / L, DT_S)
    swing = np.empty(4)
    kernels.swing_angles(swing, ahead)
    assert swing[1] < 0.0
    assert swing[3] < 0.0
    kernels.swing_angles(swing, right)
    assert swing[0] > 0.0
    assert swing[2] > 0.0


def test_a_plane_swing_through_the_vertical_is_a_plane_pendulum():
    x = state(1.0, 0.6)
    exact = solve_ivp(
        lambda _t, y: [y[1], -GRAVITY_MPS2 / L * math.sin(y[0])], (0.0, 5.0), [1.0, 0.0], rtol=1e-11, atol=1e-12
    )
    for _ in range(500):
        kernels.swing_on(x, STILL, 1.0 / L, DT_S)
    angle = math.atan2(x[0] * math.cos(0.6) + x[1] * math.sin(0.6), x[2])
    assert angle == pytest.approx(exact.y[0, -1], abs=1e-5)
    assert x[0] * math.sin(0.6) - x[1] * math.cos(0.6) == pytest.approx(0.0, abs=1e-12)


def test_others_that_pull_to_the_right_hold_the_load_there():
    x = state(math.atan2(2.0, GRAVITY_MPS2), 0.5 * math.pi)
    x[10] = 2.0
    before = x.copy()
    for _ in range(200):
        kernels.swing_on(x, STILL, 1.0 / L, DT_S)
    np.testing.assert_allclose(x, before, atol=1e-9)


def test_energy_and_momentum_of_a_free_swing_stay():
    x = state(0.9, 0.3, 0.5, 1.7)

    def kept():
        return 0.5 * L**2 * (x[3:6] @ x[3:6]) - GRAVITY_MPS2 * L * x[2], x[0] * x[4] - x[1] * x[3]

    before = kept()
    for _ in range(1000):
        kernels.swing_on(x, STILL, 1.0 / L, DT_S)
    np.testing.assert_allclose(kept(), before, rtol=1e-6)


def test_a_held_end_goes_along_a_great_circle():
    x = state(0.5, 0.2, 0.4, -0.8)
    n, v = x[:3].copy(), x[3:6].copy()
    speed = np.linalg.norm(v)
    for _ in range(200):
        kernels.swing_on(x, np.array([3.0, 1.0, -2.0]), 0.0, DT_S)
    np.testing.assert_allclose(x[:3], math.cos(2.0 * speed) * n + math.sin(2.0 * speed) * v / speed, atol=1e-8)


def test_noise_enters_as_gamma_sigma_gamma():
    x, P = hanging(), 1e-8 * np.eye(6)
    assert kernels.predict(x, P, STILL, 0.0, 0.3**2, 4e-3, 0.05) == Status.OK
    gamma = np.array([[0.5 * 0.05**2, 0.0], [0.0, 0.5 * 0.05**2], [0.05, 0.0], [0.0, 0.05]])
    F = np.eye(4)
    F[0, 2] = F[1, 3] = 0.05
    np.testing.assert_allclose(
        P[:4, :4], F @ (1e-8 * np.eye(4)) @ F.T + gamma @ (0.09 * np.eye(2)) @ gamma.T, atol=1e-12
    )
    np.testing.assert_allclose(P[4:, 4:], (1e-8 + 4e-3) * np.eye(2), atol=1e-15)


def test_small_swings_are_those_of_a_linear_kalman_filter():
    """Direction, rate and the pull of others, each about x and y."""
    rng = np.random.default_rng(1)
    size = 1e-4
    x, P, nis = hanging(), np.diag([4.0, 4.0, 9.0, 9.0, 100.0, 100.0]) * size**2, np.zeros(1)
    A = np.zeros((8, 8))
    A[0, 2] = A[1, 3] = 1.0
    A[2, 0] = A[3, 1] = -GRAVITY_MPS2 / L
    A[2, 4] = A[3, 5] = 1.0 / L
    A[2, 6] = A[3, 7] = -1.0 / L
    Phi = expm(A * DT_S)
    gamma = np.vstack([0.5 * DT_S**2 * np.eye(2), DT_S * np.eye(2), np.zeros((2, 2))])
    Q, R = gamma @ gamma.T * (30.0 * size) ** 2, np.diag([9.0, 4.0]) * size**2
    Q[4:, 4:] = (3.0 * size) ** 2 * np.eye(2)
    mean, C = np.zeros(6), P.copy()
    for _ in range(300):
        acc = size * rng.normal(size=2)
        seen = size * 3.0 * rng.normal(size=2)
        kernels.predict(x, P, np.array([*acc, 0.0]), 1.0 / L, (30.0 * size) ** 2, (3.0 * size) ** 2, DT_S)
        kernels.correct(x, P, nis, np.array([*seen, 1.0]), R, np.inf)
        mean, C = Phi[:6, :6] @ mean + Phi[:6, 6:] @ acc, Phi[:6, :6] @ C @ Phi[:6, :6].T + Q
        K = C[:, :2] @ np.linalg.inv(C[:2, :2] + R)
        mean, C = mean + K @ (seen - mean[:2]), C - K @ C[:2]
    np.testing.assert_allclose(np.concatenate([x[:2], x[3:5], x[9:]]), mean, atol=1e-3 * np.abs(mean).max())
    np.testing.assert_allclose(P, C, rtol=1e-3, atol=1e-3 * size**2)


def test_it_does_not_matter_where_forward_is():
    """The basis across the tether is nobody's: a turned world gives the turned estimate, also through the vertical."""
    rng = np.random.default_rng(5)
    angle = 2.2
    x = state(0.3, 0.1, -1.0, 0.2)
    other = turned(x, angle)
    kernels.moved(other, other.copy(), np.zeros(6))
    P, P_other = np.diag([0.04, 0.02, 0.3, 0.1, 0.5, 0.5]), np.diag([0.04, 0.02, 0.3, 0.1, 0.5, 0.5])
    nis, nis_other = np.zeros(1), np.zeros(1)
    R = 0.02 * np.eye(2)
    for _ in range(200):
        acc, seen = rng.normal(size=3), np.array([0.0, 0.0, 1.0]) + 0.3 * rng.normal(size=3)
        for state_, cov, turn, told in ((x, P, 0.0, nis), (other, P_other, angle, nis_other)):
            c, s = math.cos(turn), math.sin(turn)
            T = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            assert kernels.predict(state_, cov, T @ acc, 1.0 / L, 1.0, 0.01, DT_S) == Status.OK
            assert kernels.correct(state_, cov, told, T @ seen, R, np.inf) == Status.OK
        assert nis[0] == pytest.approx(nis_other[0], rel=1e-6)
    np.testing.assert_allclose(np.delete(turned(x, angle), [6, 7, 8]), np.delete(other, [6, 7, 8]), atol=1e-8)
    np.testing.assert_allclose(P[:4, :4], P_other[:4, :4], atol=1e-8)


def test_it_passes_the_vertical_and_rests_there_without_harm():
    x, P, nis = state(0.4, 0.9), np.diag([0.01, 0.01, 0.05, 0.05, 1e-6, 1e-6]), np.zeros(1)
    truth = state(0.4, 0.9)
    R = 1e-3 * np.eye(2)
    for k in range(3000):
        kernels.swing_on(truth, STILL, 1.0 / L, DT_S)
        if k > 1500:
            truth = hanging()
        assert kernels.predict(x, P, STILL, 1.0 / L, 0.1, 0.0, DT_S) == Status.OK
        assert kernels.correct(x, P, nis, truth[:3].copy(), R, np.inf) == Status.OK
        assert np.linalg.eigvalsh(P).min() > 0.0
        assert P.max() < 1.0
    angles = np.empty(4)
    kernels.spherical(angles, x)
    assert angles[0] < 1e-3
    assert np.isfinite(angles).all()


@pytest.mark.parametrize("seed", range(4))
def test_reported_angles_and_rates_fit_each_other(seed):
    rng = np.random.default_rng(seed)
    x = state(rng.uniform(0.1, 1.0), rng.uniform(-3.0, 3.0), *rng.normal(size=2))
    a, h = rng.normal(size=3), 1e-6
    before, after = x.copy(), x.copy()
    kernels.swing_on(after, a, 1.0 / L, h)
    spherical = [np.empty(4), np.empty(4)]
    swing = [np.empty(4), np.empty(4)]
    for at, s, w in zip((before, after), spherical, swing, strict=True):
        kernels.spherical(s, at)
        kernels.swing_angles(w, at)
    slope = (spherical[1] - spherical[0]) / h
    np.testing.assert_allclose(slope[[0, 2]], spherical[0][[1, 3]], rtol=1e-4, atol=1e-4)
    rate = np.empty(4)
    kernels.swing_rates(rate, x, a, 1.0 / L)
    np.testing.assert_allclose((swing[1] - swing[0]) / h, rate, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(before[:3], [math.sin(swing[0][1]), -math.sin(swing[0][0]) * math.cos(swing[0][1]),
                                            math.cos(swing[0][0]) * math.cos(swing[0][1])])  # fmt: skip


def test_covariance_of_the_swing_is_that_of_many_draws():
    rng = np.random.default_rng(2)
    x = state(0.4, 1.0, 0.5, 0.5)
    root = np.tril(rng.normal(size=(6, 6))) * 0.03 + 0.03 * np.eye(6)
    P, found = root @ root.T, np.zeros((4, 4))
    assert kernels.swing_covariance(found, x, P) == Status.OK
    draws = np.empty((20000, 4))
    drawn = np.empty(11)
    for row in draws:
        kernels.moved(drawn, x, root @ rng.normal(size=6))
        kernels.swing_angles(row, drawn)
    np.testing.assert_allclose(found, np.cov(draws.T), atol=0.06 * found.max())


def test_direction_noise_is_the_force_s_across_the_tether():
    x, R = state(0.3, 0.5), np.empty((2, 2))
    cov = np.diag([0.04, 0.09, 0.5])
    force = 2.0 * x[:3]
    kernels.direction_noise(R, x, force, cov)
    basis = np.column_stack([x[6:9], np.cross(x[:3], x[6:9])])
    np.testing.assert_allclose(R, basis.T @ cov @ basis / 4.0)
    # Along it, noise tells nothing of the direction.
    kernels.direction_noise(R, x, force, np.outer(x[:3], x[:3]))
    np.testing.assert_allclose(R, 0.0, atol=1e-15)


def test_what_it_cannot_do_is_said_and_changes_nothing():
    x, P, nis = state(0.2, 0.1), np.diag([0.01, 0.01, 0.1, 0.1, 0.1, 0.1]), np.zeros(1)
    before = x.copy(), P.copy()
    R = 1e-4 * np.eye(2)
    far = np.array([1.0, 0.0, 0.0])
    assert kernels.correct(x, P, nis, far, R, 10.0) == Status.GATED
    assert nis[0] > 10.0
    assert kernels.correct(x, P, nis, np.array([math.nan, 0.0, 1.0]), R, np.inf) == Status.NOT_FINITE
    assert kernels.correct(x, P, nis, far, -np.eye(2), np.inf) == Status.NOT_POSITIVE
    assert kernels.predict(x, P, np.full(3, np.inf), 1.0 / L, 0.1, 0.0, DT_S) == Status.NOT_FINITE
    assert kernels.predict(x, P, np.full(3, np.nan), 1.0 / L, 0.1, 0.0, DT_S) == Status.NOT_FINITE
    np.testing.assert_array_equal(x, before[0])
    np.testing.assert_array_equal(P, before[1])
    assert kernels.predict(x, -P, STILL, 1.0 / L, 0.1, 0.0, DT_S) == Status.NOT_POSITIVE


def test_the_opposite_direction_is_no_crash():
    x, angle = hanging(), np.empty(2)
    kernels.angle_to(angle, x, np.array([0.0, 0.0, -3.0]))
    np.testing.assert_array_equal(angle, 0.0)
    kernels.angle_to(angle, x, np.array([1e-3, 0.0, -3.0]))
    assert angle[0] == pytest.approx(math.pi, abs=1e-3)
