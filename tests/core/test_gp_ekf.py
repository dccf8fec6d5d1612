"""The GP-EKF's kernels: Jacobians, order of the step, Joseph's form against (27) corrected, noise."""

import numpy as np
import pytest

from swingd.core import gp_ekf, slts
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.gaussian_process import prepare
from swingd.core.gp_ekf import GpEkfParam, Source
from swingd.core.status import Status

MASS, PAYLOAD, LENGTH = 1.52, 0.5, 1.6
NOTHING = np.empty((0, 4)), np.empty((0, 2)), np.empty((0, 0)), np.ones((2, 4)), np.ones(2)


def some_process(features=4):
    rng = np.random.default_rng(1)
    Z = rng.uniform(-0.5, 0.5, (20, features))
    targets = np.column_stack([-0.8 * Z[:, 2] + 0.4 * Z[:, 0], -0.5 * Z[:, 3]])
    inv_sq, var = np.full((2, features), 1.0 / 0.6**2), np.full(2, 0.25)
    weights, K_inv = np.empty((20, 2)), np.empty((40, 20))
    assert prepare(weights, K_inv, Z, targets, inv_sq, var, np.full((20, 2), 0.01)) == Status.OK
    return Z, weights, K_inv, inv_sq, var


PROCESS = some_process()
WIDER = some_process(6)


def parameters(force_noise=0.25, load_noise=0.05, memory=0.3, gate=1e9):
    p = np.empty(GpEkfParam.SIZE)
    p[:] = [MASS, PAYLOAD, LENGTH, *[force_noise**2] * 3, load_noise**2, memory, gate, 1.0]
    return p


def some_state(seed):
    rng = np.random.default_rng(seed)
    x = 0.5 * rng.standard_normal(10)
    x[3:5] = rng.uniform(-0.4, 0.4, 2)
    return x


def hover(seed):
    return np.array([0.0, 0.0, -(MASS + PAYLOAD) * GRAVITY_MPS2]) + np.random.default_rng(seed).standard_normal(3)


def dynamics(x, force, process, share=1.0):
    rate, A, G, var = np.empty(10), np.empty((10, 10)), np.empty((10, 6)), np.empty(2)
    given = np.array([*force, MASS, PAYLOAD, LENGTH, share])
    assert gp_ekf.dynamics(rate, A, G, var, np.ascontiguousarray(x), given, *process) == Status.OK
    return rate, A, G, var


def some_covariance(seed, scale=0.1):
    half = scale * np.random.default_rng(seed).standard_normal((10, 10))
    return half @ half.T + 1e-3 * np.eye(10)


@pytest.mark.parametrize("process", [NOTHING, PROCESS, WIDER])
def test_jacobians_of_the_dynamics_are_the_differences(process):
    for seed in range(10):
        x, force = some_state(seed), hover(seed)
        _, A, G, _ = dynamics(x, force, process)
        e = 1e-6
        by_state = [
            (dynamics(x + e * d, force, process)[0] - dynamics(x - e * d, force, process)[0]) / (2.0 * e)
            for d in np.eye(10)
        ]
        by_force = [
            (dynamics(x, force + e * d, process)[0] - dynamics(x, force - e * d, process)[0]) / (2.0 * e)
            for d in np.eye(3)
        ]
        np.testing.assert_allclose(A, np.array(by_state).T, atol=1e-6)
        np.testing.assert_allclose(G[:, :3], np.array(by_force).T, atol=1e-6)


@pytest.mark.parametrize("process", [PROCESS, WIDER])
def test_what_is_learned_acts_on_the_load_and_leaves_the_vehicle_alone(process):
    x, force = some_state(1), hover(1)
    learned, _, _, var = dynamics(x, force, process)
    plain, _, _, none = dynamics(x, force, NOTHING)
    change = learned - plain
    np.testing.assert_array_equal(change[:5], 0.0)
    assert np.abs(change[8:]).min() > 1e-3
    np.testing.assert_allclose(change[5:7], -change[8:], atol=1e-12)
    assert change[7] == 0.0
    # An error on the vehicle leaves the load alone, and one on both divides.
    for share in (0.0, 0.4):
        change = dynamics(x, force, process, share)[0] - plain
        np.testing.assert_allclose(change[5:7], -share * change[8:], atol=1e-12)
    assert (var > 0.0).all()
    assert (none == 0.0).all()


def test_a_step_is_of_second_order_and_does_not_feed_the_swing():
    p, force = parameters(), np.array([0.0, 0.0, -(MASS + PAYLOAD) * GRAVITY_MPS2])

    def flown(dt_s, duration_s):
        x, P = np.zeros(10), 1e-4 * np.eye(10)
        x[3] = 0.3
        peak = 0.0
        for step in range(round(duration_s / dt_s)):
            assert gp_ekf.predict(x, P, force, dt_s, p, *NOTHING) == Status.OK
            if step * dt_s > duration_s - 2.5:
                peak = max(peak, abs(x[3]))
        return x, peak

    exact = flown(0.0005, 1.0)[0]
    coarse, fine = (np.abs(flown(dt_s, 1.0)[0] - exact).max() for dt_s in (0.01, 0.005))
    assert coarse / fine == pytest.approx(4.0, rel=0.15)
    # Euler's step would have made it exp(0.04 20) = 2.2 times as wide.
    assert flown(0.01, 20.0)[1] == pytest.approx(0.3, rel=0.02)


def test_covariance_of_a_step_is_that_of_many_samples():
    rng = np.random.default_rng(5)
    p, force = parameters(0.8, 0.2), hover(3)
    x0, P0 = some_state(4), some_covariance(6, 0.01)
    x0[3:5] *= 0.5
    x, P = x0.copy(), P0.copy()
    for _ in range(20):
        assert gp_ekf.predict(x, P, force, 0.01, p, *NOTHING) == Status.OK
    count = 3000
    ends = np.empty((count, 10))
    starts = rng.multivariate_normal(x0, P0, count)
    acc = np.empty(6)
    for i, state in enumerate(starts):
        y = state.copy()
        for noise in rng.standard_normal((20, 6)):
            pushed = force + 0.8 / np.sqrt(0.01) * noise[:3]
            slts.acceleration(acc, y, pushed, 0.2 / np.sqrt(0.01) * noise[3:], MASS, PAYLOAD, LENGTH)
            y = y + 0.01 * np.concatenate([y[5:] + 0.005 * acc[:5], acc[:5]])
        ends[i] = y
    sampled = np.cov(ends.T)
    scale = np.sqrt(np.diag(P))
    np.testing.assert_allclose(sampled / np.outer(scale, scale), P / np.outer(scale, scale), atol=0.1)


@pytest.mark.parametrize("source", list(Source))
def test_jacobian_of_every_measurement_is_the_difference(source):
    e = 1e-6
    for seed in range(10):
        x = some_state(seed)

        def observed(x, H=None):
            h = np.empty(3)
            gp_ekf.observe(h, np.empty((3, 10)) if H is None else H, np.ascontiguousarray(x), source, LENGTH)
            return h

        H = np.empty((3, 10))
        observed(x, H)
        expected = np.array([(observed(x + e * d) - observed(x - e * d)) / (2.0 * e) for d in np.eye(10)]).T
        np.testing.assert_allclose(H, expected, atol=1e-7)


def test_measurements_are_those_of_the_paper():
    x = some_state(3)
    ell, B, H = np.empty(3), np.empty((3, 2)), np.empty((3, 10))
    slts.cable(ell, B, x[3:5].copy(), LENGTH)
    expected = {Source.VEHICLE_POS: x[:3] + ell, Source.VEHICLE_VEL: x[5:8] + B @ x[8:], Source.REL_POS: ell}
    for source, value in expected.items():
        h = np.empty(3)
        gp_ekf.observe(h, H, x, source, LENGTH)
        np.testing.assert_allclose(h, value, atol=1e-12)


@pytest.mark.parametrize("source", list(Source))
def test_correction_is_that_of_27_with_its_signs_put_right(source):
    x, P, var = some_state(7), some_covariance(8), np.array([0.01, 0.02, 0.04])
    h, H = np.empty(3), np.empty((3, 10))
    gp_ekf.observe(h, H, x, source, LENGTH)
    z = h + np.array([0.05, -0.1, 0.02])
    W = H @ P @ H.T + np.diag(var)
    K = P @ H.T @ np.linalg.inv(W)
    expected = P - K @ H @ P - P @ H.T @ K.T + K @ W @ K.T
    x1, P1, nis = x.copy(), P.copy(), np.empty(1)
    assert gp_ekf.correct(x1, P1, nis, source, z, var, LENGTH, 1e9) == Status.OK
    np.testing.assert_allclose(x1, x + K @ (z - h), atol=1e-12)
    np.testing.assert_allclose(P1, expected, atol=1e-12)
    assert nis[0] == pytest.approx((z - h) @ np.linalg.solve(W, z - h))
    # As printed it would grow by what was measured.
    assert np.trace(P + K @ H @ P + P @ H.T @ K.T + K @ W @ K.T) > np.trace(P) > np.trace(P1)


def test_an_outlier_is_gated_and_changes_nothing():
    x, P, nis = some_state(1), some_covariance(2), np.empty(1)
    x0, P0 = x.copy(), P.copy()
    far = np.array([50.0, 0.0, 0.0])
    assert gp_ekf.correct(x, P, nis, Source.VEHICLE_POS, far, np.full(3, 0.01), LENGTH, 16.3) == Status.GATED
    np.testing.assert_array_equal(x, x0)
    np.testing.assert_array_equal(P, P0)
    assert nis[0] > 16.3


def test_long_intervals_are_divided_and_none_changes_nothing():
    p, force = parameters(), hover(2)
    x, P = some_state(2), some_covariance(3, 0.01)
    y, Q = x.copy(), P.copy()
    assert gp_ekf.predict(x, P, force, 0.05, p, *PROCESS) == Status.OK
    for _ in range(5):
        assert gp_ekf.predict(y, Q, force, 0.01, p, *PROCESS) == Status.OK
    np.testing.assert_allclose(x, y, atol=1e-12)
    np.testing.assert_allclose(P, Q, atol=1e-12)
    z = x.copy()
    assert gp_ekf.predict(x, P, force, 0.0, p, *PROCESS) == Status.OK
    np.testing.assert_array_equal(x, z)
