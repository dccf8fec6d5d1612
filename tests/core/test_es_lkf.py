"""The extended-state filter's kernels against SciPy's matrix exponential and Riccati solver, and filterpy."""

import math

import numba
import numpy as np
import pytest
from filterpy.common import van_loan_discretization
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from swingd.core import es_lkf
from swingd.core.status import Status

OPEN = math.inf
C = np.eye(2, 3)
TRANSLATION = (0.5, 1.0, 0.01)
"""Mass, process density, interval of Tables 1 and 2."""
ROTATION = (0.177, 1.0, 0.01)
AXES = [TRANSLATION, ROTATION, (70.0, 400.0, 0.004), (2.0, 0.01, 0.5), (0.02, 1e-4, 1e-3)]
VAR = np.array([1e-3, 1e-3])


def continuous(inertia):
    """A of (36), and what U - a G does."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / inertia], [0.0, 0.0, 0.0]])
    return A, np.array([0.0, 1.0 / inertia, 0.0])


def discrete(inertia, density, dt_s):
    A, B, Q = np.full((3, 3), np.nan), np.full(3, np.nan), np.full((3, 3), np.nan)
    es_lkf.discretise(A, B, Q, inertia, density, dt_s)
    return A, B, Q


def random_covariance(rng):
    root = rng.normal(size=(3, 3)) * [[0.1], [0.3], [1.0]]
    return root @ root.T + 1e-4 * np.eye(3)


# ---- model


@pytest.mark.parametrize(("inertia", "density", "dt_s"), AXES)
def test_transition_and_input_are_the_matrix_exponential(inertia, density, dt_s):
    A_c, B_c = continuous(inertia)
    A, B, _ = discrete(inertia, density, dt_s)
    exact = expm(np.block([[A_c, B_c[:, None]], [np.zeros((1, 4))]]) * dt_s)
    np.testing.assert_allclose(A, exact[:3, :3], rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(B, exact[:3, 3], rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize(("inertia", "density", "dt_s"), AXES)
def test_process_noise_is_van_loan_s(inertia, density, dt_s):
    """(45): exp of [[-A, M Q M^T], [0, A^T]] T holds the integral in its right upper block."""
    A_c, _ = continuous(inertia)
    noise = np.diag([0.0, 0.0, density])
    block = expm(np.block([[-A_c, noise], [np.zeros((3, 3)), A_c.T]]) * dt_s)
    _, _, Q = discrete(inertia, density, dt_s)
    np.testing.assert_allclose(Q, block[3:, 3:].T @ block[:3, 3:], rtol=1e-9, atol=1e-16 * Q.max())
    # filterpy takes the noise by its root.
    _, theirs = van_loan_discretization(A_c, np.array([[0.0], [0.0], [math.sqrt(density)]]), dt_s)
    np.testing.assert_allclose(Q, theirs, rtol=1e-9, atol=1e-16 * Q.max())


@given(
    x=st.tuples(st.floats(-10.0, 10.0), st.floats(-5.0, 5.0), st.floats(-3.0, 3.0)),
    force=st.floats(-20.0, 20.0),
    dt_s=st.floats(1e-3, 0.5),
)
@settings(max_examples=20)
def test_prediction_is_exact_for_a_held_force(x, force, dt_s):
    """(28) integrated by SciPy with a weight."""
    mass_kg, gravity_mps2 = 0.5, 9.81

    def rate(_t_s, y):
        return [y[1], (force + y[2]) / mass_kg - gravity_mps2, 0.0]

    exact = solve_ivp(rate, (0.0, dt_s), x, rtol=1e-10, atol=1e-12).y[:, -1]
    A, B, _ = discrete(mass_kg, 1.0, dt_s)
    y = np.array(x)
    assert es_lkf.predict_mean(y, force - mass_kg * gravity_mps2, A, B) == Status.OK
    np.testing.assert_allclose(y, exact, rtol=1e-8, atol=1e-9)


def test_two_halves_of_an_interval_are_the_whole():
    inertia, density, dt_s = TRANSLATION
    rng = np.random.default_rng(5)
    P = random_covariance(rng)
    x = rng.normal(size=3)
    x_halves, P_halves = x.copy(), P.copy()
    assert es_lkf.predict(x, P, 1.7, *discrete(inertia, density, dt_s)) == Status.OK
    for _ in range(2):
        assert es_lkf.predict(x_halves, P_halves, 1.7, *discrete(inertia, density, 0.5 * dt_s)) == Status.OK
    np.testing.assert_allclose(x_halves, x, rtol=1e-13)
    np.testing.assert_allclose(P_halves, P, rtol=1e-12)


# ---- filter


@pytest.mark.parametrize(("inertia", "density", "dt_s"), [TRANSLATION, ROTATION])
def test_against_filterpy(inertia, density, dt_s):
    rng = np.random.default_rng(2)
    A, B, Q = discrete(inertia, density, dt_s)
    theirs = KalmanFilter(dim_x=3, dim_z=2, dim_u=1)
    theirs.F, theirs.B, theirs.Q, theirs.H, theirs.R = A, B[:, None], Q, C, np.diag(VAR)
    P, x, nis = random_covariance(rng), rng.normal(size=3), np.empty(1)
    theirs.P, theirs.x = P.copy(), x[:, None].copy()
    for _ in range(300):
        force, z = rng.normal(), rng.normal(size=2)
        theirs.predict(u=np.array([[force]]))
        theirs.update(z[:, None])
        assert es_lkf.predict(x, P, force, A, B, Q) == Status.OK
        assert es_lkf.correct(x, P, nis, z, VAR, OPEN) == Status.OK
        np.testing.assert_allclose(x, theirs.x[:, 0], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(P, theirs.P, rtol=1e-7, atol=1e-12)
        assert nis[0] == pytest.approx((theirs.y.T @ theirs.SI @ theirs.y).item(), rel=1e-7)
    assert np.array_equal(P, P.T)


def test_velocity_alone_against_a_filter_with_one_measurement():
    """The position that is not measured is not looked at, and drifts with its variance."""
    rng = np.random.default_rng(3)
    A, B, Q = discrete(*TRANSLATION)
    H = np.array([[0.0, 1.0, 0.0]])
    P, x, nis = random_covariance(rng), rng.normal(size=3), np.empty(1)
    expected_P, expected_x = P.copy(), x.copy()
    for _ in range(200):
        vel = rng.normal()
        es_lkf.predict(x, P, 0.3, A, B, Q)
        assert es_lkf.correct(x, P, nis, np.array([1e6, vel]), np.array([math.inf, 1e-3]), OPEN) == Status.OK
        expected_x, expected_P = A @ expected_x + B * 0.3, A @ expected_P @ A.T + Q
        S = H @ expected_P @ H.T + 1e-3
        K = expected_P @ H.T / S
        nu = vel - H @ expected_x
        expected_x, expected_P = expected_x + K @ nu, (np.eye(3) - K @ H) @ expected_P
        np.testing.assert_allclose(x, expected_x, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(P, expected_P, rtol=1e-7, atol=1e-12)
        assert nis[0] == pytest.approx((nu @ nu / S).item(), rel=1e-7)
    # A huge variance is the same as none measured.
    y, P_huge = x.copy(), P.copy()
    es_lkf.correct(x, P, nis, np.array([0.0, 0.1]), np.array([math.inf, 1e-3]), OPEN)
    es_lkf.correct(y, P_huge, nis, np.array([0.0, 0.1]), np.array([1e12, 1e-3]), OPEN)
    np.testing.assert_allclose(y, x, rtol=1e-6, atol=1e-9)


def test_position_alone_measures_too():
    rng = np.random.default_rng(4)
    P, x, nis = random_covariance(rng), np.zeros(3), np.empty(1)
    before = P.copy()
    assert es_lkf.correct(x, P, nis, np.array([0.2, 99.0]), np.array([1e-3, math.inf]), OPEN) == Status.OK
    np.testing.assert_allclose(x, before[:, 0] / (before[0, 0] + 1e-3) * 0.2, rtol=1e-12)
    assert nis[0] == pytest.approx(0.04 / (before[0, 0] + 1e-3))


@pytest.mark.parametrize(("inertia", "density", "dt_s"), AXES)
@pytest.mark.parametrize("var", [VAR, np.array([4.0, 1e-4])])
def test_steady_state_solves_the_riccati_equation(inertia, density, dt_s, var):
    A, B, Q = discrete(inertia, density, dt_s)
    P_prior, P, K = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2))
    assert Status(es_lkf.steady_state(P_prior, P, K, A, Q, var)) is Status.OK
    # SciPy is given the scaled problem too: entries that differ by ten orders cost it as many digits.
    scale = np.diag([math.sqrt(var[0]), math.sqrt(var[1]), math.sqrt(Q[2, 2])])
    unscale = np.linalg.inv(scale)
    expected = scale @ solve_discrete_are((unscale @ A @ scale).T, C.T, unscale @ Q @ unscale, np.eye(2)) @ scale
    np.testing.assert_allclose(P_prior, expected, rtol=1e-7)
    S = C @ expected @ C.T + np.diag(var)
    np.testing.assert_allclose(K, expected @ C.T @ np.linalg.inv(S), rtol=1e-6)
    np.testing.assert_allclose(P, expected - K @ S @ K.T, rtol=1e-6, atol=1e-9 * np.abs(P).max())
    # The recursion stays where it is.
    x, stepped, nis = np.zeros(3), P.copy(), np.empty(1)
    for _ in range(100):
        es_lkf.predict(x, stepped, 0.0, A, B, Q)
        es_lkf.correct(x, stepped, nis, np.zeros(2), var, OPEN)
    np.testing.assert_allclose(stepped, P, rtol=1e-8)


def test_the_recursion_settles_on_the_steady_state():
    A, B, Q = discrete(*TRANSLATION)
    P_prior, settled, K = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2))
    es_lkf.steady_state(P_prior, settled, K, A, Q, VAR)
    x, P, nis = np.zeros(3), np.eye(3), np.empty(1)
    for _ in range(2000):
        es_lkf.predict(x, P, 0.0, A, B, Q)
        es_lkf.correct(x, P, nis, np.zeros(2), VAR, OPEN)
    np.testing.assert_allclose(P, settled, rtol=1e-9)
    # By the gain the same correction as by the covariance.
    z = np.array([0.03, -0.02])
    prior, by_gain = P_prior.copy(), np.zeros(3)
    es_lkf.correct(x := np.zeros(3), prior, nis, z, VAR, OPEN)
    by_covariance = nis[0]
    assert es_lkf.correct_by_gain(by_gain, P_prior, nis, z, VAR, OPEN, K) == Status.OK
    np.testing.assert_allclose(by_gain, x, rtol=1e-12)
    assert nis[0] == by_covariance


def test_a_disturbance_that_never_changes_has_no_steady_gain():
    A, _, Q = discrete(0.5, 0.0, 0.01)
    out = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2))
    assert Status(es_lkf.steady_state(*out, A, Q, VAR)) is Status.NOT_CONVERGED
    Q[2, 2] = math.nan
    assert Status(es_lkf.steady_state(*out, A, Q, VAR)) is Status.NOT_CONVERGED


# ---- gate and faults


def test_a_gated_measurement_changes_nothing():
    rng = np.random.default_rng(6)
    P, x, nis = random_covariance(rng), rng.normal(size=3), np.empty(1)
    before = x.copy(), P.copy()
    z = x[:2] + np.array([3.0, 0.0])
    assert Status(es_lkf.correct(x, P, nis, z, VAR, 9.0)) is Status.GATED
    assert nis[0] > 9.0
    np.testing.assert_array_equal(x, before[0])
    np.testing.assert_array_equal(P, before[1])
    gain = np.ones((3, 2))
    assert Status(es_lkf.correct_by_gain(x, P, nis, z, VAR, 9.0, gain)) is Status.GATED
    np.testing.assert_array_equal(x, before[0])
    assert Status(es_lkf.correct(x, P, nis, z, VAR, nis[0])) is Status.OK


def test_what_cannot_be_predicted_or_corrected_is_said_and_left_alone():
    A, B, Q = discrete(*TRANSLATION)
    nan, inf = math.nan, math.inf
    for x, P, force in (
        (np.array([nan, 0.0, 0.0]), np.eye(3), 0.0),
        (np.zeros(3), np.eye(3), inf),
        (np.zeros(3), np.diag([1.0, inf, 1.0]), 0.0),
    ):
        before = x.copy(), P.copy()
        assert Status(es_lkf.predict(x, P, force, A, B, Q)) is Status.NOT_FINITE
        np.testing.assert_array_equal(x, before[0])
        np.testing.assert_array_equal(P, before[1])
    for x, P, z, expected in (
        (np.zeros(3), -np.eye(3), np.zeros(2), Status.NOT_POSITIVE),
        (np.zeros(3), np.diag([1.0, -1.0, 1.0]), np.zeros(2), Status.NOT_POSITIVE),
        (np.zeros(3), np.full((3, 3), nan), np.zeros(2), Status.NOT_POSITIVE),
        (np.array([0.0, nan, 0.0]), np.eye(3), np.zeros(2), Status.NOT_FINITE),
        (np.zeros(3), np.eye(3), np.array([inf, 0.0]), Status.NOT_FINITE),
    ):
        nis = np.full(1, 7.0)
        before = x.copy(), P.copy()
        assert Status(es_lkf.correct(x, P, nis, z, VAR, OPEN)) is expected
        np.testing.assert_array_equal(x, before[0])
        np.testing.assert_array_equal(P, before[1])
        assert nis[0] == 7.0


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs compiled kernels")
def test_only_contiguous_arrays_of_doubles():
    A, B, Q = discrete(*TRANSLATION)
    with pytest.raises(TypeError):
        es_lkf.predict(np.zeros(3, np.float32), np.eye(3), 0.0, A, B, Q)
    with pytest.raises(TypeError):
        es_lkf.predict(np.zeros(3), np.eye(6)[::2, ::2], 0.0, A, B, Q)
