"""f, h and their Jacobians: against finite differences, the Lagrangian, and the paper as printed."""

import math
from math import cos, sin

import numpy as np
import pytest

from core.two_point_masses import GRAVITY, model
from swingd.core import swing_ekf as kernels

STATES = range(20)


def random_case(seed):
    """State, force and model (m, ml, L) with large angles and rates."""
    rng = np.random.default_rng(seed)
    m = 10.0 ** rng.uniform(-1.0, 3.0)
    ml = m * rng.uniform(0.02, 2.0)
    L = 10.0 ** rng.uniform(-0.5, 1.7)
    omega = math.sqrt(GRAVITY / L)
    x = np.concatenate([rng.uniform(-1.3, 1.3, 2), rng.uniform(-2.0, 2.0, 2) * omega, rng.normal(0.0, 3.0, 3) * m])
    u = np.array([rng.normal(), rng.normal(), -rng.uniform(0.3, 2.0)]) * (m + ml) * GRAVITY
    return x, u, m, ml, L


def dynamics(x, u, m, L):
    f, F = np.empty(7), np.empty((7, 7))
    kernels.dynamics(f, F, x, u, m, L)
    return f, F


def observation(x, u, m, ml, L):
    h, H = np.empty(3), np.empty((3, 7))
    tension = kernels.observation(h, H, x, u, m, ml, L)
    return h, H, tension


def scale_of(x, u, m, L):
    """Typical change of each state: Jacobian entries of unlike units are compared through it."""
    omega = math.sqrt(GRAVITY / L)
    force = np.linalg.norm(u) + np.linalg.norm(x[4:])
    return np.array([1.0, 1.0, omega, omega, force, force, force]), force / m + omega**2 * L


@pytest.mark.parametrize("seed", STATES)
def test_model_is_the_lagrangians(seed):
    x, u, m, ml, L = random_case(seed)
    _, acceleration = scale_of(x, u, m, L)
    f, F = dynamics(x, u, m, L)
    h, H, _ = observation(x, u, m, ml, L)
    np.testing.assert_allclose(f, model().dynamics(x, u, m, ml, L), rtol=1e-10, atol=1e-9 * acceleration / L)
    np.testing.assert_allclose(h, model().observation(x, u, m, ml, L), rtol=1e-10, atol=1e-10 * acceleration)
    F_true, H_true = model().jacobians(x, u, m, ml, L)
    scale, _ = scale_of(x, u, m, L)
    np.testing.assert_allclose(F * scale, F_true * scale, rtol=1e-9, atol=1e-9 * acceleration / L)
    np.testing.assert_allclose(H * scale, H_true * scale, rtol=1e-9, atol=1e-9 * acceleration)


@pytest.mark.parametrize("seed", STATES)
def test_jacobians_are_central_differences(seed):
    x, u, m, ml, L = random_case(seed)
    scale, acceleration = scale_of(x, u, m, L)
    _, F = dynamics(x, u, m, L)
    _, H, _ = observation(x, u, m, ml, L)
    for column in range(7):
        step = np.zeros(7)
        step[column] = 1e-5 * scale[column]
        f_d = (dynamics(x + step, u, m, L)[0] - dynamics(x - step, u, m, L)[0]) / 2e-5
        h_d = (observation(x + step, u, m, ml, L)[0] - observation(x - step, u, m, ml, L)[0]) / 2e-5
        # tan(zeta) grows fast near its pole: the third derivative sets the error of the difference.
        np.testing.assert_allclose(F[:, column] * scale[column], f_d, rtol=1e-6, atol=1e-7 * acceleration / L)
        np.testing.assert_allclose(H[:, column] * scale[column], h_d, rtol=1e-6, atol=1e-7 * acceleration)


@pytest.mark.parametrize("seed", STATES)
def test_printed_equations(seed):
    """(8), (9) and the longest entries of Appendix A as the paper prints them."""
    x, u, m, ml, L = random_case(seed)
    scale, acceleration = scale_of(x, u, m, L)
    x1, x2, x3, x4, x5, x6, x7 = x
    u1, u2, u3 = u
    M = m + ml
    g = GRAVITY
    s1, c1, s2, c2 = sin(x1), cos(x1), sin(x2), cos(x2)
    f, F = dynamics(x, u, m, L)
    h, H, _ = observation(x, u, m, ml, L)

    f3 = (u2 * c1 + x6 * c1 + u3 * s1 + x7 * s1 + 2 * L * m * x3 * x4 * s2) / (L * m * c2)
    f4 = (L * m * c2 * s2 * x3**2 + u1 * c2 + x5 * c2 - u3 * c1 * s2 - x7 * c1 * s2 + u2 * s1 * s2 + x6 * s1 * s2) / (
        -L * m
    )
    np.testing.assert_allclose(f, [x3, x4, f3, f4, 0, 0, 0], rtol=1e-11, atol=1e-11 * acceleration / L)
    h1 = (
        u1 * m + x5 * m + u1 * ml * c2**2 + x5 * ml * c2**2 + L * m * ml * x4**2 * s2
        - u3 * ml * c1 * c2 * s2 - x7 * ml * c1 * c2 * s2 + u2 * ml * c2 * s1 * s2 + x6 * ml * c2 * s1 * s2
        + L * m * ml * x3**2 * c2**2 * s2
    )  # fmt: skip
    h2 = (
        u2 * m + x6 * m + u2 * ml + x6 * ml - u2 * ml * c2**2 - x6 * ml * c2**2 + u2 * ml * c1**2 * c2**2
        + x6 * ml * c1**2 * c2**2 + u3 * ml * c1 * c2**2 * s1 + x7 * ml * c1 * c2**2 * s1 + u1 * ml * c2 * s1 * s2
        + x5 * ml * c2 * s1 * s2 - L * m * ml * x4**2 * c2 * s1 - L * m * ml * x3**2 * c2**3 * s1
    )  # fmt: skip
    h3 = (
        u3 * m + x7 * m + u3 * ml + x7 * ml + g * m**2 + g * m * ml - u3 * ml * c1**2 * c2**2 - x7 * ml * c1**2 * c2**2
        + u2 * ml * c1 * c2**2 * s1 + x6 * ml * c1 * c2**2 * s1 - u1 * ml * c1 * c2 * s2 - x5 * ml * c1 * c2 * s2
        + L * m * ml * x4**2 * c1 * c2 + L * m * ml * x3**2 * c1 * c2**3
    )  # fmt: skip
    np.testing.assert_allclose(h, np.array([h1, h2, h3]) / (m * M), rtol=1e-11, atol=1e-11 * acceleration)

    F32 = 2 * x3 * x4 + (s2 * (u2 * c1 + x6 * c1 + u3 * s1 + x7 * s1 + 2 * L * m * x3 * x4 * s2)) / (L * m * c2**2)
    F42 = (
        u1 * s2 + x5 * s2 + L * m * x3**2 + u3 * c1 * c2 + x7 * c1 * c2 - u2 * c2 * s1 - x6 * c2 * s1
        - 2 * L * m * x3**2 * c2**2
    ) / (L * m)  # fmt: skip
    printed_F = {(3, 2): F32, (4, 1): -s2 * ((u2 + x6) * c1 + (u3 + x7) * s1) / (L * m), (4, 2): F42}
    H12 = -ml * (
        u1 * sin(2 * x2) + x5 * sin(2 * x2) - u3 * c1 - x7 * c1 + u2 * s1 + x6 * s1 + 2 * u3 * c1 * c2**2
        + 2 * x7 * c1 * c2**2 - 2 * u2 * c2**2 * s1 - 2 * x6 * c2**2 * s1 - 3 * L * m * x3**2 * c2**3
        + 2 * L * m * x3**2 * c2 - L * m * x4**2 * c2
    ) / (m * M)  # fmt: skip
    H21 = -ml * c2 * (
        u3 * c2 + x7 * c2 - u1 * c1 * s2 - x5 * c1 * s2 - 2 * u3 * c1**2 * c2 - 2 * x7 * c1**2 * c2
        + 2 * u2 * c1 * c2 * s1 + 2 * x6 * c1 * c2 * s1 + L * m * x4**2 * c1 + L * m * x3**2 * c1 * c2**2
    ) / (m * M)  # fmt: skip
    H22 = -ml * (
        u1 * s1 - x6 * sin(2 * x2) - u2 * sin(2 * x2) + x5 * s1 - 2 * u1 * c2**2 * s1 - 2 * x5 * c2**2 * s1
        + 2 * u2 * c1**2 * c2 * s2 + 2 * x6 * c1**2 * c2 * s2 + 2 * u3 * c1 * c2 * s1 * s2 + 2 * x7 * c1 * c2 * s1 * s2
        - L * m * x4**2 * s1 * s2 + 3 * L * m * x3**2 * s1 * s2 * (s2**2 - 1)
    ) / (m * M)  # fmt: skip
    H31 = ml * c2 * (
        u1 * s1 * s2 - x6 * c2 - u2 * c2 + x5 * s1 * s2 + 2 * u2 * c1**2 * c2 + 2 * x6 * c1**2 * c2
        + 2 * u3 * c1 * c2 * s1 + 2 * x7 * c1 * c2 * s1 - L * m * x4**2 * s1 - L * m * x3**2 * c2**2 * s1
    ) / (m * M)  # fmt: skip
    H32 = -(ml * c1 * (
        2 * u1 * c2**2 - x5 - u1 + 2 * x5 * c2**2 + L * m * x4**2 * s2 - 2 * u3 * c1 * c2 * s2 - 2 * x7 * c1 * c2 * s2
        + 2 * u2 * c2 * s1 * s2 + 2 * x6 * c2 * s1 * s2 + 3 * L * m * x3**2 * c2**2 * s2
    )) / (m * M)  # fmt: skip
    printed_H = {
        (1, 1): ml * sin(2 * x2) * ((u2 + x6) * c1 + (u3 + x7) * s1) / (2 * m * M),
        (1, 2): H12,
        (1, 3): 2 * L * ml * x3 * (s2 - s2**3) / M,
        (2, 1): H21,
        (2, 2): H22,
        (2, 6): (m + ml - ml * c2**2 + ml * c1**2 * c2**2) / (m * M),
        (3, 1): H31,
        (3, 2): H32,
        (3, 4): 2 * L * ml * x4 * c1 * c2 / M,
        (3, 7): (M - ml * c1**2 * c2**2) / (m * M),
    }
    for (row, column), entry in printed_F.items():
        assert F[row - 1, column - 1] * scale[column - 1] == pytest.approx(
            entry * scale[column - 1], rel=1e-10, abs=1e-10 * acceleration / L
        ), f"F{row}{column}"
    for (row, column), entry in printed_H.items():
        assert H[row - 1, column - 1] * scale[column - 1] == pytest.approx(
            entry * scale[column - 1], rel=1e-10, abs=1e-10 * acceleration
        ), f"H{row}{column}"


def accelerations_of_printed_matrices(x, u, m, ml, L, sign):
    """mu' of M mu' + C mu + G = tau with (5)-(7); ``sign`` is that of the second term of C's entry (3, 4)."""
    xi, zeta, xi_rate, zeta_rate = x[:4]
    s1, c1, s2, c2 = sin(xi), cos(xi), sin(zeta), cos(zeta)
    total = (m + ml) / (L * ml)
    M = L * ml * np.array(
        [
            [total, 0, 0, 0, c2],
            [0, total, 0, -c1 * c2, s1 * s2],
            [0, 0, total, -s1 * c2, -c1 * s2],
            [0, -c1 * c2, -s1 * c2, L * c2**2, 0],
            [c2, s1 * s2, -c1 * s2, 0, L],
        ]
    )  # fmt: skip
    C = np.zeros((5, 5))
    C[0, 4] = -zeta_rate * s2
    C[1, 3] = xi_rate * s1 * c2 + zeta_rate * c1 * s2
    C[1, 4] = xi_rate * c1 * s2 + zeta_rate * s1 * c2
    C[2, 3] = -xi_rate * c1 * c2 + sign * zeta_rate * s1 * s2
    C[2, 4] = xi_rate * s1 * s2 - zeta_rate * c1 * c2
    C[3, 3] = -L * zeta_rate * s2 * c2
    C[3, 4] = -L * xi_rate * s2 * c2
    C[4, 3] = L * xi_rate * s2 * c2
    G = GRAVITY * L * ml * np.array([0, 0, -total, s1 * c2, c1 * s2])
    tau = np.concatenate([u + x[4:], [0, 0]])
    mu = np.concatenate([np.zeros(3), x[2:4]])
    return np.linalg.solve(M, tau - L * ml * C @ mu - G)


@pytest.mark.parametrize("seed", STATES)
def test_erratum_1_the_sign_in_c(seed):
    """With the corrected C the printed matrices are the Lagrangian's; with the printed sign f would be another."""
    x, u, m, ml, L = random_case(seed)
    _, acceleration = scale_of(x, u, m, L)
    f, _ = dynamics(x, u, m, L)
    right = accelerations_of_printed_matrices(x, u, m, ml, L, sign=+1)
    np.testing.assert_allclose(right[3:], f[2:4], rtol=1e-9, atol=1e-9 * acceleration / L)
    wrong = accelerations_of_printed_matrices(x, u, m, ml, L, sign=-1)
    # The sign carries twice this force along z into the equations.
    error = 2.0 * ml * L * abs(x[2] * x[3] * sin(x[0]) * sin(x[1])) / ((m + ml) * L)
    assert np.linalg.norm(wrong[3:] - f[2:4]) > 0.05 * error > 1e-6 * acceleration / L


@pytest.mark.parametrize("seed", STATES)
def test_tension_is_the_force_that_is_missing_in_newtons_law(seed):
    x, u, m, ml, L = random_case(seed)
    h, _, tension = observation(x, u, m, ml, L)
    n = np.array([sin(x[1]), -sin(x[0]) * cos(x[1]), cos(x[0]) * cos(x[1])])
    cable = m * h - m * np.array([0, 0, GRAVITY]) - u - x[4:]
    np.testing.assert_allclose(cable, tension * n, rtol=1e-9, atol=1e-10 * np.linalg.norm(u))


def test_hover_is_an_equilibrium_that_swings_at_the_free_frequency():
    """Drones 2023, section 4.2: (g / L)(m + m_l) / m = 5.66 1/s^2 for 2 kg, 0.192 kg, 1.9 m."""
    m, ml, L = 2.0, 0.192, 1.9
    u = np.array([0.0, 0.0, -(m + ml) * GRAVITY])
    f, F = dynamics(np.zeros(7), u, m, L)
    h, _, tension = observation(np.zeros(7), u, m, ml, L)
    np.testing.assert_allclose(f, 0.0, atol=1e-15)
    np.testing.assert_allclose(h, 0.0, atol=1e-14)
    assert tension == pytest.approx(ml * GRAVITY)
    assert F[2, 0] == pytest.approx(-5.66, abs=5e-3)
    assert F[3, 1] == pytest.approx(F[2, 0])


def test_signs_in_words():
    """A vehicle that is pushed forward leaves its load behind; pushed to the right, it leaves it to the left."""
    hover = np.array([0.0, 0.0, -2.3 * GRAVITY])
    forward, _ = dynamics(np.zeros(7), hover + np.array([1.0, 0.0, 0.0]), 2.0, 1.5)
    right, _ = dynamics(np.zeros(7), hover + np.array([0.0, 1.0, 0.0]), 2.0, 1.5)
    assert forward[kernels.State.ZETA_RATE] < 0.0 == forward[kernels.State.XI_RATE]
    assert right[kernels.State.XI_RATE] > 0.0 == right[kernels.State.ZETA_RATE]
