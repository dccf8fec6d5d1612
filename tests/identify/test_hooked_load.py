"""The kernel of the fit against a second formulation."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from identify.flights import FloatArray
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.hooked_load import pull_per_mass

DT_S = 0.04
START = np.array([0.3, -0.2, 0.4, 0.9])


def shaken(t_s: FloatArray) -> FloatArray:
    """Specific force of a hook that is accelerated, (n, 3)."""
    t = np.atleast_1d(t_s)
    acc = np.stack([2.0 * np.sin(1.3 * t), 1.5 * np.cos(0.9 * t), 1.0 * np.sin(2.1 * t)], axis=-1)
    return acc - [0.0, 0.0, GRAVITY_MPS2]


def pull(force: FloatArray, start: FloatArray, length_m: float, damping_ratio: float) -> FloatArray:
    out = np.empty(force.shape)
    pull_per_mass(out, np.ascontiguousarray(force), start, DT_S, length_m, damping_ratio)
    return out


def test_agrees_with_swing_angles_integrated_by_scipy() -> None:
    """Lagrange's equations of (xi, zeta) below an accelerated hook, of the pair of angles and not of a vector."""
    length_m = 1.7
    t = np.arange(0.0, 12.0, DT_S)

    def slope(t_s: float, x: FloatArray) -> list[float]:
        xi, zeta, xi_rate, zeta_rate = x
        s = shaken(np.array([t_s]))[0]
        n_d_xi = np.array([0.0, -math.cos(xi), -math.sin(xi)])
        n_d_zeta = np.array([math.cos(zeta), math.sin(xi) * math.sin(zeta), -math.cos(xi) * math.sin(zeta)])
        return [
            xi_rate,
            zeta_rate,
            -(n_d_xi @ s) / (length_m * math.cos(zeta)) + 2.0 * xi_rate * zeta_rate * math.tan(zeta),
            -(n_d_zeta @ s) / length_m - xi_rate**2 * math.sin(zeta) * math.cos(zeta),
        ]

    zeta = math.asin(START[0])
    xi = math.asin(-START[1] / math.cos(zeta))
    zeta_rate = START[2] / math.cos(zeta)
    xi_rate = -(START[3] - math.sin(xi) * math.sin(zeta) * zeta_rate) / (math.cos(xi) * math.cos(zeta))
    exact = solve_ivp(slope, (0.0, t[-1]), [xi, zeta, xi_rate, zeta_rate], t_eval=t, rtol=1e-10, atol=1e-10).y
    n = np.stack([np.sin(exact[1]), -np.sin(exact[0]) * np.cos(exact[1]), np.cos(exact[0]) * np.cos(exact[1])], axis=-1)
    speed2 = exact[3] ** 2 + (exact[2] * np.cos(exact[1])) ** 2
    expected = (length_m * speed2 - (n * shaken(t)).sum(-1))[:, None] * n
    # The kernel takes the force as linear between the samples.
    np.testing.assert_allclose(pull(shaken(t), START, length_m, 0.0), expected, atol=0.03)
    assert np.abs(np.arctan2(n[:, 0], n[:, 2])).max() > 0.5


def test_small_swing_has_the_period_and_the_damping_of_the_textbook() -> None:
    length_m, damping_ratio = 2.0, 0.05
    t = np.arange(0.0, 20.0, DT_S)
    force = np.tile([0.0, 0.0, -GRAVITY_MPS2], (len(t), 1))
    omega = math.sqrt(GRAVITY_MPS2 / length_m)
    damped = omega * math.sqrt(1.0 - damping_ratio**2)
    start = np.array([1e-3, 0.0, 0.0, 0.0])
    course = np.exp(-damping_ratio * omega * t) * (
        np.cos(damped * t) + damping_ratio * omega / damped * np.sin(damped * t)
    )
    along = pull(force, start, length_m, damping_ratio)
    np.testing.assert_allclose(along[:, 0] / GRAVITY_MPS2, 1e-3 * course, atol=2e-7)
    np.testing.assert_allclose(along[:, 2], GRAVITY_MPS2, rtol=1e-4)


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.3, -0.8, 0.5]])
def test_a_tilted_frame_tilts_everything_alike(axis: list[float]) -> None:
    """Why an attitude that is wrong by a constant costs nothing."""
    t = np.arange(0.0, 8.0, DT_S)
    turn = Rotation.from_rotvec(0.1 * np.array(axis))
    n = np.array([START[0], START[1], math.sqrt(1.0 - START[0] ** 2 - START[1] ** 2)])
    rate = np.array([START[2], START[3], -(n[0] * START[2] + n[1] * START[3]) / n[2]])
    start = np.concatenate([turn.apply(n)[:2], turn.apply(rate)[:2]])
    turned = pull(turn.apply(shaken(t)), start, 1.5, 0.02)
    np.testing.assert_allclose(turned, turn.apply(pull(shaken(t), START, 1.5, 0.02)), atol=1e-9)
