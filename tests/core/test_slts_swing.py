"""Swing angles of the slung load transport system: against the definitions of the swing EKF, and by differences."""

import numpy as np
import pytest

from swingd.core.slts_swing import swing
from swingd.core.swing_ekf import State

LENGTH_M = 1.6


def swing_of(relative, P=None, to_level_rad=0.0):
    x, rate, cov = np.empty(4), np.empty(4), np.empty((4, 4))
    swing(x, rate, cov, np.asarray(relative, dtype=float), np.eye(4) if P is None else P, LENGTH_M, to_level_rad)
    return x, rate, cov


def relative_of(xi, zeta, xi_rate, zeta_rate, step=1e-6):
    """r and v of a cable with these angles: it reaches the other way, so minus the unit vector times the length."""

    def direction(a, b):
        return np.array([np.sin(b), -np.sin(a) * np.cos(b)])

    r = -LENGTH_M * direction(xi, zeta)
    ahead, behind = (direction(xi + s * step * xi_rate, zeta + s * step * zeta_rate) for s in (1.0, -1.0))
    return np.concatenate([r, -LENGTH_M * (ahead - behind) / (2.0 * step), [0.0, 0.0]])


def test_a_vehicle_that_leads_its_load_north_has_the_load_behind():
    """Heading north: a load behind is zeta < 0; a vehicle east of its load has it on the left, xi > 0."""
    x, _, _ = swing_of([0.3, 0.2, 0.0, 0.0, 0.0, 0.0])
    assert x[State.ZETA] < 0.0 < x[State.XI]


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.3, -0.5), (0.4, -0.3, 1.0, 0.7), (-0.7, 0.6, -0.4, 1.2)])
def test_it_inverts_the_definition(angles):
    x, _, _ = swing_of(relative_of(*angles))
    np.testing.assert_allclose(x, angles, rtol=1e-7, atol=1e-8)


def test_its_derivative_is_that_of_the_motion():
    r, v, a = np.array([0.4, -0.2]), np.array([0.5, 0.8]), np.array([-1.0, 0.6])

    def at(t):
        return swing_of([*(r + v * t + 0.5 * a * t * t), *(v + a * t), *a])[0]

    step = 1e-5
    _, rate, _ = swing_of([*r, *v, *a])
    np.testing.assert_allclose(rate, (at(step) - at(-step)) / (2.0 * step), rtol=1e-6)


def test_its_covariance_is_that_of_samples():
    rng = np.random.default_rng(3)
    root = 1e-3 * rng.standard_normal((4, 4))
    relative = np.array([0.4, -0.2, 0.5, 0.8, 0.0, 0.0])
    samples = [swing_of(relative + np.append(root @ noise, [0.0, 0.0]), None, 0.7)[0]
               for noise in rng.standard_normal((20000, 4))]  # fmt: skip
    _, _, cov = swing_of(relative, root @ root.T, 0.7)
    np.testing.assert_allclose(np.cov(np.array(samples).T), cov, atol=0.03 * np.abs(cov).max())


def test_the_level_frame_turns_vectors_not_angles():
    """A frame whose x axis points east sees a vehicle that is east of its load ahead of it."""
    x, _, _ = swing_of([0.0, 0.3, 0.0, 0.4, 0.0, 0.0], to_level_rad=-np.pi / 2)
    straight, _, _ = swing_of([0.3, 0.0, 0.4, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(x, straight, atol=1e-12)


def test_a_cable_that_lies_flat_is_finite():
    for relative in ([LENGTH_M, 0.0, 1.0, 0.0, 0.0, 0.0], [1.2 * LENGTH_M, 1.2 * LENGTH_M, 0.0, 1.0, 0.0, 0.0]):
        x, rate, cov = swing_of(relative)
        assert np.isfinite(x).all()
        assert np.isfinite(rate).all()
        assert np.isfinite(cov).all()
