"""The fading filter against SciPy's matrix exponential and Riccati solver, a plain Kalman filter and the Lagrangian."""

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are
from scipy.stats import chi2

from swingd.core import fgdf
from swingd.core.fgdf import GRAVITY_MPS2
from swingd.core.status import Status
from tests.core.two_point_masses import model

OCTAROTOR = (70.0, 90.0, 15.0)
"""Vehicle, load as assumed, cable of Drones 2023, 7, 654, section 4.1 (Table 1)."""
X500 = (2.0, 0.192, 1.9)
"""Of section 4.2."""
R = 2.465e-4
H = np.eye(2, 4)
OPEN = math.inf


def transition(vehicle, dt_s):
    Phi, Gamma = np.full((4, 4), np.nan), np.full((4, 2), np.nan)
    fgdf.transition(Phi, Gamma, *vehicle, dt_s)
    return Phi, Gamma


def linearised(vehicle):
    """A and B at hover by central differences of the two point masses, and the hovering thrust."""
    m, ml, L = vehicle
    hover = np.array([0.0, 0.0, -(m + ml) * GRAVITY_MPS2])
    e = 1e-4

    def rate(y):
        return model().dynamics(np.concatenate([y[:4], y[4:], [0.0]]), hover, m, ml, L)[:4]

    scale = np.array([1.0] * 4 + [m * L] * 2)
    columns = [(rate(e * s * d) - rate(-e * s * d)) / (2.0 * e * s) for s, d in zip(scale, np.eye(6), strict=True)]
    jacobian = np.array(columns).T
    return jacobian[:, :4], jacobian[:, 4:]


def force_and_acceleration(vehicle, x, lean=(0.0, 0.0)):
    """Thrust tilted by ``lean`` and the acceleration that the two point masses then have."""
    m, ml, L = vehicle
    weight = (m + ml) * GRAVITY_MPS2
    u = np.array([weight * lean[0], weight * lean[1], -weight])
    return u, model().observation(np.concatenate([x, np.zeros(3)]), u, m, ml, L)


# ---- model


@pytest.mark.parametrize("vehicle", [OCTAROTOR, X500])
@pytest.mark.parametrize("dt_s", [1e-3, 0.004, 0.01, 0.5])
def test_the_transition_is_that_of_the_two_point_masses_at_hover(vehicle, dt_s):
    A, B = linearised(vehicle)
    Phi, Gamma = transition(vehicle, dt_s)
    exact = expm(np.block([[A, B], [np.zeros((2, 6))]]) * dt_s)
    np.testing.assert_allclose(Phi, exact[:4, :4], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(Gamma, exact[:4, 4:], rtol=1e-6, atol=1e-9 * np.abs(Gamma).max())
    np.testing.assert_allclose(Gamma, np.linalg.solve(A, (Phi - np.eye(4)) @ B), rtol=1e-5, atol=1e-12)


def test_the_papers_matrices_with_their_misprints_named():
    """(22)-(24), case 3, and (26), the X500, to the digits that are printed."""
    A, B = linearised(OCTAROTOR)
    assert A[2, 0] == pytest.approx(-1.4943, abs=5e-5)
    assert B[2, 1] * 1e4 == pytest.approx(9.524, abs=5e-4)
    assert B[3, 0] * 1e4 == pytest.approx(-9.524, abs=5e-4)
    Phi, Gamma = transition(OCTAROTOR, 0.004)
    np.testing.assert_allclose(
        Phi, [[1, 0, 0.004, 0], [0, 1, 0, 0.004], [-0.006, 0, 1, 0], [0, -0.006, 0, 1]], atol=5e-5
    )
    assert Gamma[0] * 1e6 == pytest.approx([0.0, 0.0076], abs=5e-5)
    assert Gamma[1] * 1e6 == pytest.approx([-0.0076, 0.0], abs=5e-5)
    assert Gamma[2] * 1e6 == pytest.approx([0.0, 3.81], abs=5e-3)
    assert Gamma[3] * 1e6 == pytest.approx([-3.81, 0.0], abs=5e-3)
    assert abs(Gamma[1, 0] * 1e6 + 0.0088) > 1e-3  # printed
    Phi, Gamma = transition(X500, 0.01)
    np.testing.assert_allclose(Phi, [[1, 0, 0.01, 0], [0, 1, 0, 0.01], [-0.057, 0, 1, 0], [0, -0.057, 0, 1]], atol=5e-4)
    assert Gamma[:2] * 1e3 == pytest.approx(np.array([[0.0, 0.013], [-0.013, 0.0]]), abs=5e-4)
    assert Gamma[2:] * 1e3 == pytest.approx(np.array([[0.0, 2.631], [-2.631, 0.0]]), abs=5e-4)
    assert abs(Gamma[2, 1] * 1e3 - 2.64) > 5e-3  # printed


def test_signs_in_words():
    """A thrust forward leaves the load behind (zeta < 0), one to the right leaves it to the left (xi > 0)."""
    _, Gamma = transition(X500, 0.01)
    forward, right = Gamma @ [1.0, 0.0], Gamma @ [0.0, 1.0]
    assert (forward[[1, 3]] < 0.0).all()
    assert (right[[0, 2]] > 0.0).all()
    assert not forward[[0, 2]].any()
    assert not right[[1, 3]].any()


# ---- synthetic angles


@given(
    x=st.tuples(*[st.floats(-1.2, 1.2)] * 2, *[st.floats(-2.0, 2.0)] * 2),
    lean=st.tuples(*[st.floats(-0.3, 0.3)] * 2),
)
@settings(max_examples=60, deadline=None)
def test_the_cable_force_points_along_a_taut_cable(x, lean):
    m, ml, L = X500
    u, z = force_and_acceleration(X500, np.array(x), lean)
    s_xi, c_xi, s_zeta, c_zeta = math.sin(x[0]), math.cos(x[0]), math.sin(x[1]), math.cos(x[1])
    n = np.array([s_zeta, -s_xi * c_zeta, c_xi * c_zeta])
    force, angles = np.empty(3), np.empty(2)
    fgdf.cable_force(force, u, z, m)
    tension_n = -ml / (m + ml) * (n @ u) + m * ml * L / (m + ml) * (x[3] ** 2 + (x[2] * c_zeta) ** 2)
    np.testing.assert_allclose(force, tension_n * n, atol=1e-10)
    if tension_n > 0.01:
        assert Status(fgdf.synthetic_angles(angles, u, z, m)) is Status.OK
        np.testing.assert_allclose(angles, x[:2], atol=1e-9)


def test_the_angles_are_the_papers_formulas_in_all_four_quadrants():
    m = X500[0]
    for f in np.random.default_rng(3).normal(size=(50, 3)):
        angles = np.empty(2)
        u = m * np.array([0.0, 0.0, -GRAVITY_MPS2]) - f  # at rest
        assert Status(fgdf.synthetic_angles(angles, u, np.zeros(3), m)) is Status.OK
        assert angles == pytest.approx([math.atan2(-f[1], f[2]), math.asin(f[0] / np.linalg.norm(f))], abs=1e-10)


def test_a_vanishing_or_infinite_cable_force_has_no_angles():
    m = X500[0]
    angles = np.array([7.0, 8.0])
    free_fall = np.array([0.0, 0.0, GRAVITY_MPS2])
    u = np.zeros(3)
    assert Status(fgdf.synthetic_angles(angles, u, free_fall, m)) is Status.GATED
    hover = np.array([0.0, 0.0, -m * GRAVITY_MPS2])
    rounding = np.array([0.0, 0.0, 1e-15])
    assert Status(fgdf.synthetic_angles(angles, hover, rounding, m)) is Status.GATED
    assert Status(fgdf.synthetic_angles(angles, np.array([0.0, math.nan, 0.0]), free_fall, m)) is Status.NOT_FINITE
    assert Status(fgdf.synthetic_angles(angles, u, np.array([math.inf, 0.0, 0.0]), m)) is Status.NOT_FINITE
    assert angles.tolist() == [7.0, 8.0]


# ---- filter


def random_case(rng):
    """State, covariance with correlations, force and acceleration."""
    root = rng.normal(size=(4, 4)) * [[0.1], [0.1], [0.3], [0.3]]
    x = rng.normal(size=4) * [0.2, 0.2, 0.5, 0.5]
    u, z = force_and_acceleration(X500, rng.normal(size=4) * 0.2, rng.normal(size=2) * 0.05)
    return x, root @ root.T + 1e-6 * np.eye(4), u, z + rng.normal(size=3) * 0.05


@pytest.mark.parametrize("seed", range(5))
def test_against_a_plain_kalman_filter_with_a_fading_memory(seed):
    rng = np.random.default_rng(seed)
    m, beta = X500[0], 0.996
    x, E, u, z = random_case(rng)
    expected_x, expected_E = x.copy(), E.copy()
    Phi, Gamma = transition(X500, 0.01)
    nis = np.empty(1)
    for _ in range(30):
        _, _, u, z = random_case(rng)
        f = m * z - [0.0, 0.0, m * GRAVITY_MPS2] - u
        nu = [math.atan2(-f[1], f[2]), math.asin(f[0] / np.linalg.norm(f))] - H @ expected_x
        S = H @ expected_E @ H.T + R * np.eye(2)
        K = expected_E @ H.T @ np.linalg.inv(S)
        expected_nis = nu @ np.linalg.inv(S) @ nu
        expected_x = Phi @ (expected_x + K @ nu) + Gamma @ u[:2]
        expected_E = Phi @ (np.eye(4) - K @ H) @ expected_E @ Phi.T / beta
        assert Status(fgdf.step(x, E, nis, u, z, Phi, Gamma, R, beta, m, OPEN)) is Status.OK
        np.testing.assert_allclose(x, expected_x, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(E, expected_E, rtol=1e-8, atol=1e-13)
        assert nis[0] == pytest.approx(expected_nis, rel=1e-9)


@pytest.mark.parametrize(("vehicle", "dt_s", "beta"), [(OCTAROTOR, 0.004, 0.998), (X500, 0.01, 0.996)])
def test_the_covariance_settles_on_the_solution_of_its_riccati_equation(vehicle, dt_s, beta):
    """Symmetric and positive definite, without drift: Phi / sqrt(beta) has all its poles outside."""
    Phi, Gamma = transition(vehicle, dt_s)
    expected = solve_discrete_are((Phi / math.sqrt(beta)).T, H.T, np.zeros((4, 4)), R * np.eye(2))
    u, z = force_and_acceleration(vehicle, np.zeros(4))
    x, E, nis = np.zeros(4), 1e-7 * np.eye(4), np.empty(1)
    for _ in range(int(20.0 / (1.0 - beta))):
        assert fgdf.step(x, E, nis, u, z, Phi, Gamma, R, beta, vehicle[0], OPEN) == Status.OK
    np.testing.assert_allclose(E, expected, rtol=1e-6, atol=1e-9 * expected.max())
    assert np.array_equal(E, E.T)
    assert np.linalg.eigvalsh(E).min() > 0.0
    settled = E.copy()
    for _ in range(5000):
        fgdf.step(x, E, nis, u, z, Phi, Gamma, R, beta, vehicle[0], OPEN)
    np.testing.assert_allclose(E, settled, rtol=1e-6, atol=1e-12 * settled.max())


def test_the_size_of_the_noise_scales_the_covariance_alone():
    rng = np.random.default_rng(0)
    Phi, Gamma = transition(X500, 0.01)
    estimates = [(np.zeros(4), factor * 1e-4 * np.eye(4), np.empty(1), factor * R) for factor in (1.0, 40.0)]
    for _ in range(50):
        _, _, u, z = random_case(rng)
        for x, E, nis, angle_var in estimates:
            fgdf.step(x, E, nis, u, z, Phi, Gamma, angle_var, 0.996, X500[0], OPEN)
    (x, E, nis, _), (x_40, E_40, nis_40, _) = estimates
    np.testing.assert_allclose(x_40, x, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(E_40, 40.0 * E, rtol=1e-9, atol=1e-16)
    assert nis_40[0] == pytest.approx(nis[0] / 40.0)


def test_nis_is_chi_square_where_nothing_is_forgotten():
    """On its own linear model and noise, with beta = 1: 800 samples of 2 degrees of freedom."""
    rng = np.random.default_rng(1)
    Phi, Gamma = transition(X500, 0.01)
    P = np.diag([0.01, 0.01, 0.04, 0.04])
    x, E, nis = np.zeros(4), P.copy(), np.empty(1)
    true = rng.multivariate_normal(np.zeros(4), P)
    total = 0.0
    for k in range(800):
        u = np.array([math.sin(0.02 * k), math.cos(0.03 * k), 0.0])
        assert fgdf.correct(x, E, nis, true[:2] + rng.normal(size=2) * math.sqrt(R), R, OPEN) == Status.OK
        total += nis[0]
        assert fgdf.predict(x, E, u, Phi, Gamma, 1.0) == Status.OK
        true = Phi @ true + Gamma @ u[:2]
    low, high = chi2.interval(0.999, 1600)
    assert low < total < high
    nees = (x - true) @ np.linalg.solve(E, x - true)
    assert nees < chi2.ppf(0.999, 4)


def test_a_gated_or_absent_measurement_leaves_the_prediction():
    rng = np.random.default_rng(2)
    Phi, Gamma = transition(X500, 0.01)
    m, beta = X500[0], 0.996
    x, E, u, z = random_case(rng)
    predicted_x, predicted_E = Phi @ x + Gamma @ u[:2], Phi @ E @ Phi.T / beta
    gated_x, gated_E, nis = x.copy(), E.copy(), np.empty(1)
    assert Status(fgdf.step(gated_x, gated_E, nis, u, z, Phi, Gamma, R, beta, m, 1e-9)) is Status.GATED
    np.testing.assert_allclose(gated_x, predicted_x, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(gated_E, predicted_E, rtol=1e-12, atol=1e-15)
    assert nis[0] > 1e-9
    falling = u / m + [0.0, 0.0, GRAVITY_MPS2]
    assert Status(fgdf.step(x, E, nis, u, falling, Phi, Gamma, R, beta, m, OPEN)) is Status.GATED
    np.testing.assert_allclose(x, predicted_x, rtol=1e-12, atol=1e-15)
    assert nis[0] == 0.0


def test_what_cannot_be_corrected_or_predicted_is_said_and_left_alone():
    Phi, Gamma = transition(X500, 0.01)
    u, z = force_and_acceleration(X500, np.zeros(4))
    for x, E, expected in (
        (np.zeros(4), -np.eye(4), Status.NOT_POSITIVE),
        (np.zeros(4), np.full((4, 4), math.nan), Status.NOT_POSITIVE),
        (np.array([math.nan, 0.0, 0.0, 0.0]), np.eye(4), Status.NOT_FINITE),
        (np.array([0.0, 0.0, math.inf, 0.0]), np.eye(4), Status.NOT_FINITE),
        (np.zeros(4), np.diag([1.0, 1.0, 1e308, 1.0]) * 1.7, Status.NOT_FINITE),
    ):
        nis = np.empty(1)
        before = x.copy(), E.copy()
        assert Status(fgdf.step(x, E, nis, u, z, Phi, Gamma, R, 0.9, X500[0], OPEN)) is expected
        if expected is Status.NOT_POSITIVE:
            np.testing.assert_array_equal(x, before[0])
            np.testing.assert_array_equal(E, before[1])
    x, E = np.array([0.0, 0.0, math.inf, 0.0]), np.eye(4)
    assert Status(fgdf.predict(x, E, u, Phi, Gamma, 1.0)) is Status.NOT_FINITE
    assert x.tolist() == [0.0, 0.0, math.inf, 0.0]
    np.testing.assert_array_equal(E, np.eye(4))


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs compiled kernels")
def test_only_contiguous_arrays_of_doubles():
    Phi, Gamma = np.empty((4, 4)), np.empty((4, 2))
    with pytest.raises(TypeError):
        fgdf.transition(Phi.astype(np.float32), Gamma, *X500, 0.01)
    with pytest.raises(TypeError):
        fgdf.transition(np.empty((4, 8))[:, ::2], Gamma, *X500, 0.01)
