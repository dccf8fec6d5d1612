"""Pose of a load from its tethers: alignment and least squares against SciPy, covariance, degenerate cases."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from swingd.core import load_pose as kernels
from swingd.core.status import Status

R_ = kernels.TetherRow


def a_case(rng, tethers=5, noise=0.0, size=0.03):
    """Random load under random hooks; rows and covariances as `solve` takes them, and the true pose."""
    R = Rotation.from_euler("ZYX", [rng.uniform(-3.0, 3.0), rng.uniform(-0.8, 0.8), rng.uniform(-0.8, 0.8)]).as_matrix()
    p = rng.normal(size=3) * 3.0
    rows, covs = np.zeros((tethers, R_.SIZE)), np.zeros((3 * tethers, 3))
    for k, row in enumerate(rows):
        anchor = rng.normal(size=3) * [0.5, 0.4, 0.2]
        n = np.array([*rng.normal(size=2) * 0.4, 1.0])
        n /= np.linalg.norm(n)
        length = rng.uniform(0.8, 2.0)
        row[R_.HOOK : R_.HOOK + 3] = p + R @ anchor - length * n
        e1 = np.cross(n, [1.0, 0.0, 0.0])
        e1 /= np.linalg.norm(e1)
        across = np.column_stack([e1, np.cross(n, e1)])
        root = size * (np.tril(rng.normal(size=(2, 2)), -1) + np.diag(rng.uniform(0.5, 2.0, 2)))
        covs[3 * k : 3 * k + 3] = across @ root @ root.T @ across.T
        seen = n + noise * across @ root @ rng.normal(size=2)
        row[R_.DIRECTION : R_.DIRECTION + 3] = seen / np.linalg.norm(seen)
        row[R_.LENGTH_STD] = 0.3 * size
        row[R_.LENGTH] = length + noise * 0.3 * size * rng.normal()
        row[R_.ANCHOR : R_.ANCHOR + 3] = anchor
        row[R_.TOLD] = 1.0
    return rows, covs, p, R


def solved(rows, covs, angles=(0.0, 0.0, 0.0), information=(0.0, 0.0, 0.0), start=None):
    p, R, cov, cost = np.empty(3), np.empty((3, 3)), np.empty((6, 6)), np.empty(1)
    status = kernels.solve(
        p, R, cov, cost, rows, covs, np.array(angles), np.array(information), np.eye(3) if start is None else start
    )
    return Status(status), p, R, cov, cost[0]


@pytest.mark.parametrize("seed", range(6))
def test_alignment_is_scipy_s(seed):
    rng = np.random.default_rng(seed)
    drawn, weights = rng.normal(size=(6, 3)), rng.uniform(0.1, 2.0, 6)
    turn = Rotation.random(random_state=seed)
    seen = turn.apply(drawn) + 0.05 * rng.normal(size=(6, 3)) + 4.0
    R = np.empty((3, 3))
    assert kernels.align(R, seen, drawn, weights, np.eye(3), 0.0) == Status.OK
    centred = [points - np.average(points, axis=0, weights=weights) for points in (seen, drawn)]
    oracle, _ = Rotation.align_vectors(*centred, weights=weights)
    np.testing.assert_allclose(R, oracle.as_matrix(), atol=1e-9)


def test_two_points_leave_a_choice_that_the_prior_makes():
    drawn = np.array([[0.0, -0.2, 0.0], [0.0, 0.2, 0.0]])
    prior = Rotation.from_euler("ZYX", [0.3, 0.2, 0.1])
    seen = np.ascontiguousarray(prior.apply(drawn))
    R = np.empty((3, 3))
    assert kernels.align(R, seen, drawn, np.ones(2), np.eye(3), 0.0) == Status.NOT_POSITIVE
    assert kernels.align(R, seen, drawn, np.ones(2), prior.as_matrix(), 1e-6) == Status.OK
    np.testing.assert_allclose(R, prior.as_matrix(), atol=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_exact_tethers_give_the_exact_pose(seed):
    rows, covs, p_true, R_true = a_case(np.random.default_rng(seed))
    status, p, R, _, cost = solved(rows, covs)
    assert status is Status.OK
    np.testing.assert_allclose(p, p_true, atol=1e-8)
    np.testing.assert_allclose(R, R_true, atol=1e-8)
    assert cost == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_noisy_tethers_give_the_least_squares_pose(seed):
    rows, covs, p_true, R_true = a_case(np.random.default_rng(seed), noise=1.0, size=0.01)
    information = (0.0, 1.0 / 0.02**2, 0.0)
    pitch = -math.asin(R_true[2, 0]) + 0.01

    def residuals(q):
        R = R_true @ Rotation.from_rotvec(q[:3]).as_matrix()
        out = []
        for k, row in enumerate(rows):
            d = q[3:] + R @ row[R_.ANCHOR : R_.ANCHOR + 3] - row[:3]
            length = np.linalg.norm(d)
            out.append((length - row[R_.LENGTH]) / row[R_.LENGTH_STD])
            n = row[R_.DIRECTION : R_.DIRECTION + 3]
            basis = np.linalg.svd(n[None])[2][1:]
            root = np.linalg.cholesky(np.linalg.inv(basis @ covs[3 * k : 3 * k + 3] @ basis.T))
            out.extend(root.T @ basis @ (d / length))
        return np.array([*out, (-math.asin(R[2, 0]) - pitch) / 0.02])

    oracle = least_squares(residuals, np.concatenate([np.zeros(3), p_true]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    status, p, R, cov, cost = solved(rows, covs, (0.0, pitch, 0.0), information)
    assert status is Status.OK
    np.testing.assert_allclose(p, oracle.x[3:], atol=1e-6)
    np.testing.assert_allclose(R, R_true @ Rotation.from_rotvec(oracle.x[:3]).as_matrix(), atol=1e-6)
    assert cost == pytest.approx(2.0 * oracle.cost, rel=1e-6)
    information_matrix = oracle.jac.T @ oracle.jac
    np.testing.assert_allclose(cov[3:, 3:], np.linalg.inv(information_matrix)[3:, 3:], rtol=0.02, atol=1e-7)


def test_covariance_and_cost_are_those_of_many_draws():
    errors, costs = [], []
    for seed in range(400):
        rng = np.random.default_rng(1000 + seed)
        rows, covs, p_true, R_true = a_case(rng, noise=1.0, size=0.005)
        status, p, R, cov, cost = solved(rows, covs)
        assert status is Status.OK
        found, true = np.empty(3), np.empty(3)
        kernels.euler(found, R)
        kernels.euler(true, R_true)
        error = np.concatenate([found - true, p - p_true])
        error[:3] = np.remainder(error[:3] + math.pi, 2.0 * math.pi) - math.pi
        errors.append(error @ np.linalg.solve(cov, error))
        costs.append(cost)
    # Means of 400 chi-square variables with 6 and with 3 x 5 - 6 = 9 degrees of freedom.
    assert np.mean(errors) == pytest.approx(6.0, abs=4.0 * math.sqrt(12.0 / 400.0))
    assert np.mean(costs) == pytest.approx(9.0, abs=4.0 * math.sqrt(18.0 / 400.0))


def test_what_nothing_tells_is_said():
    rows, covs, _, _ = a_case(np.random.default_rng(1))
    one, two = (rows[:1].copy(), covs[:3].copy()), (rows[:2].copy(), covs[:6].copy())
    assert solved(*one)[0] is Status.NOT_POSITIVE
    # Two anchors tell nothing of the angle about their line.
    assert solved(*two)[0] is Status.NOT_POSITIVE
    line = rows.copy()
    R = Rotation.from_euler("x", 0.1).as_matrix()
    for k, row in enumerate(line):
        anchor = np.array([0.0, 0.2 * k - 0.4, -0.1])
        row[R_.ANCHOR : R_.ANCHOR + 3] = anchor
        row[:3] = R @ anchor - row[R_.LENGTH] * row[R_.DIRECTION : R_.DIRECTION + 3]
    assert solved(line, covs)[0] is Status.NOT_POSITIVE
    assert solved(line, covs, (0.0, 0.0, 0.0), (0.0, 1e4, 0.0))[0] is Status.OK


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_none_are_said(bad):
    rows, covs, _, _ = a_case(np.random.default_rng(1))
    rows[2, R_.HOOK] = bad
    assert solved(rows, covs)[0] in (Status.NOT_FINITE, Status.NOT_POSITIVE, Status.NOT_CONVERGED)
    rows, covs, _, _ = a_case(np.random.default_rng(1))
    covs[:] = 0.0
    assert solved(rows, covs)[0] in (Status.NOT_FINITE, Status.NOT_POSITIVE, Status.NOT_CONVERGED)
