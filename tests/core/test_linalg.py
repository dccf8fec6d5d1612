"""Small linear algebra against NumPy and SciPy, and the implicit Riccati step against its own equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov

from swingd.core import linalg, swing_ekf
from swingd.core.status import Status

SEEDS = range(8)


def random_spd(rng, n, spread=3.0):
    """Symmetric positive definite with eigenvalues over ``spread`` decades."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    A = (Q * 10.0 ** rng.uniform(-0.5 * spread, 0.5 * spread, n)) @ Q.T
    return np.ascontiguousarray(0.5 * (A + A.T))


def random_stable(rng, n):
    A = rng.normal(size=(n, n))
    return A - (np.linalg.eigvals(A).real.max() + rng.uniform(0.1, 2.0)) * np.eye(n)


def riccati(P, F, S, Q, dt_s):
    out = np.full_like(P, np.nan)
    return Status(linalg.riccati_backward_euler(out, P, F, S, Q, dt_s)), out


def filter_case(acc_noise=0.06, mass_kg=2.0, swinging=True):
    """P, F, S, Q of the swing EKF at its start, the load swinging or at rest below."""
    x = np.array([0.3, -0.2, 0.5, 0.4, 0.0, 0.0, 0.0]) * swinging
    u = mass_kg * np.array([1.0, 0.5, -11.0]) if swinging else mass_kg * np.array([0.0, 0.0, -1.15 * 9.80665])
    f, F, h, H = np.empty(7), np.empty((7, 7)), np.empty(3), np.empty((3, 7))
    swing_ekf.dynamics(f, F, x, u, mass_kg, 1.5)
    swing_ekf.observation(h, H, x, u, mass_kg, 0.15 * mass_kg, 1.5)
    S = H.T @ H / acc_noise**2
    Q = np.diag([1e-8] * 2 + [0.02**2] * 2 + [(0.25 * mass_kg) ** 2] * 3)
    P = np.diag([0.16] * 2 + [1.0] * 2 + [(1.5 * mass_kg) ** 2] * 3)
    return P, F, np.ascontiguousarray(S), Q


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("n", [1, 3, 7])
def test_cholesky_factors_and_solves(seed, n):
    rng = np.random.default_rng(seed)
    A, b = random_spd(rng, n), rng.normal(size=n)
    L = np.full((n, n), np.nan)
    garbage_above = np.ascontiguousarray(np.tril(A) + np.triu(np.full((n, n), np.nan), 1))
    assert linalg.cholesky(L, garbage_above) == Status.OK
    np.testing.assert_allclose(L, np.linalg.cholesky(A), rtol=1e-9, atol=1e-12)
    x = b.copy()
    linalg.cholesky_solve(x, L)
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-8)


@pytest.mark.parametrize(
    "A",
    [
        np.diag([1.0, -1e-9]),
        np.diag([1.0, 0.0]),
        np.array([[1.0, 0.0], [2.0, 1.0]]),
        np.diag([1.0, np.nan]),
        np.diag([np.inf, 1.0]),
        np.array([[1.0, 0.0], [np.nan, 1.0]]),
    ],
)
def test_cholesky_refuses_what_is_not_positive_definite(A):
    assert linalg.cholesky(np.empty((2, 2)), A) == Status.NOT_POSITIVE


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("n", [1, 2, 7])
def test_invert(seed, n):
    A = np.random.default_rng(seed).normal(size=(n, n))
    out = np.full((n, n), np.nan)
    assert linalg.invert(out, A.copy()) == Status.OK
    np.testing.assert_allclose(out, np.linalg.inv(A), rtol=1e-8, atol=1e-10)


def test_invert_pivots_and_refuses():
    out = np.empty((2, 2))
    assert linalg.invert(out, np.array([[0.0, 2.0], [1.0, 0.0]])) == Status.OK
    np.testing.assert_array_equal(out, [[0.0, 1.0], [0.5, 0.0]])
    for A in ([[1.0, 2.0], [2.0, 4.0]], [[0.0, 0.0], [0.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]], [[np.inf, 0], [0, 1]]):
        assert linalg.invert(out, np.array(A, dtype=float)) == Status.NOT_CONVERGED


@pytest.mark.parametrize("seed", SEEDS)
def test_products(seed):
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(3, 7)), rng.normal(size=(7, 4)), np.empty((3, 4))
    linalg.multiply(C, A, B)
    np.testing.assert_allclose(C, A @ B, rtol=1e-12, atol=1e-14)
    linalg.multiply_transposed(C, A, np.ascontiguousarray(B.T))
    np.testing.assert_allclose(C, A @ B, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("n", [2, 7])
def test_lyapunov(seed, n):
    rng = np.random.default_rng(seed)
    A, W = random_stable(rng, n), random_spd(rng, n)
    X = np.full((n, n), np.nan)
    shift = float(np.abs(np.linalg.eigvals(A)).mean())
    assert linalg.lyapunov(X, A, W, shift) == Status.OK
    expected = solve_continuous_lyapunov(A, -W)
    np.testing.assert_allclose(X, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_array_equal(X, X.T)


def test_lyapunov_resolves_each_state_in_its_own_unit():
    """A slow state in tiny units beside a fast one in huge units: both to full precision."""
    A, W = np.diag([-1e-3, -1e3]), np.diag([1e-16, 1e16])
    X = np.empty((2, 2))
    assert linalg.lyapunov(X, A, W, 1e2) == Status.OK
    np.testing.assert_allclose(np.diag(X), [0.5e-13, 0.5e13], rtol=1e-10)


@pytest.mark.parametrize("real", [1e-3, 0.5, 30.0])
def test_lyapunov_refuses_an_unstable_matrix(real):
    A = np.array([[real, 1.0], [-1.0, real]])
    assert linalg.lyapunov(np.empty((2, 2)), A, np.eye(2), 1.0) == Status.NOT_CONVERGED


@pytest.mark.parametrize("acc_noise", [0.06, 1e-2, 1e-3])
@pytest.mark.parametrize("dt_s", [1e-4, 2.5e-3, 0.01, 0.1, 1.0, 10.0])
def test_riccati_step_solves_its_implicit_equation(dt_s, acc_noise):
    P, F, S, Q = filter_case(acc_noise, swinging=dt_s < 5.0)
    status, out = riccati(P, F, S, Q, dt_s)
    assert status is Status.OK
    residual = P + dt_s * (F @ out + out @ F.T - out @ S @ out + Q) - out
    unit = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    assert np.abs(residual / unit).max() < 1e-9
    np.testing.assert_array_equal(out, out.T)
    assert np.linalg.eigvalsh(out / unit).min() > 0.0

    A = F - 0.5 / dt_s * np.eye(7)
    eigenvalues, vectors = np.linalg.eigh(S)
    factor = vectors[:, -3:] * np.sqrt(eigenvalues[-3:])
    expected = solve_continuous_are(A.T, factor, Q + P / dt_s, np.eye(3))
    np.testing.assert_allclose(out / unit, expected / unit, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_riccati_step_of_random_systems(seed):
    rng = np.random.default_rng(seed)
    n = 5
    F, P, Q = rng.normal(size=(n, n)), random_spd(rng, n, 1.0), random_spd(rng, n)
    H = rng.normal(size=(2, n))
    S = np.ascontiguousarray(H.T @ H)
    dt_s = 0.05
    status, out = riccati(P, F, S, Q, dt_s)
    assert status is Status.OK
    expected = solve_continuous_are((F - 0.5 / dt_s * np.eye(n)).T, H.T, Q + P / dt_s, np.eye(2))
    np.testing.assert_allclose(out, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("mass_kg", [0.05, 20.0, 2000.0])
def test_riccati_step_knows_no_units(mass_kg):
    """Force in N or in N per kg: the same covariance."""
    _, small = riccati(*filter_case(mass_kg=1.0), 0.01)
    status, out = riccati(*filter_case(mass_kg=mass_kg), 0.01)
    assert status is Status.OK
    T = np.diag([1.0] * 4 + [1.0 / mass_kg] * 3)
    np.testing.assert_allclose(T @ out @ T, small, rtol=1e-9, atol=1e-14)


def test_riccati_step_refuses_an_unstable_start():
    """F faster than the step without any measurement: the implicit equation has no positive solution."""
    P, Q, S = np.eye(3), np.eye(3), np.zeros((3, 3))
    F = np.diag([6.0, 0.0, -1.0])
    assert riccati(P, F, S, Q, 0.1)[0] is Status.NOT_CONVERGED
    assert riccati(P, F, S, Q, 0.05)[0] is Status.OK


def test_riccati_step_refuses_a_gain_that_does_not_stabilise():
    """A fast swing makes F itself unstable, and the first gain leaves it so over 10 s; a shorter step will do."""
    P, F, S, Q = filter_case()
    assert np.linalg.eigvals(F - 0.05 * np.eye(7) - P @ S).real.max() > 0.0
    assert riccati(P, F, S, Q, 10.0)[0] is Status.NOT_CONVERGED
    assert riccati(P, F, S, Q, 5.0)[0] is Status.OK


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("which", range(4))
def test_riccati_step_answers_what_is_not_finite(which, bad):
    matrices = [matrix.copy() for matrix in filter_case()]
    matrices[which][3, 3] = bad
    assert riccati(*matrices, 0.01)[0] is not Status.OK


def test_riccati_step_converges_to_the_differential_equation_with_first_order():
    P, F, S, Q = filter_case()
    P = riccati(P, F, S, Q, 0.5)[1]  # past the fast transient of the start
    duration = 0.4

    def rate(_t, flat):
        M = flat.reshape(7, 7)
        return (F @ M + M @ F.T - M @ S @ M + Q).ravel()

    exact = solve_ivp(rate, (0.0, duration), P.ravel(), method="DOP853", rtol=1e-11, atol=1e-14).y[:, -1].reshape(7, 7)
    unit = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    errors = []
    for steps in (100, 200, 400):
        current = P
        for _ in range(steps):
            status, current = riccati(current, F, S, Q, duration / steps)
            assert status is Status.OK
        errors.append(np.abs((current - exact) / unit).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.1)
    assert errors[-1] < 0.02
