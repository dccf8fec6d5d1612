"""Body, level and heading frame: against SciPy's rotations, finite differences and the words of the convention."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.two_point_masses import model
from swingd.core import level, swing_ekf
from swingd.core.swing_ekf import GRAVITY_MPS2

SEEDS = range(10)
M, ML, L = 1.5, 0.3, 1.5


def rotation(roll, pitch, yaw):
    out = np.full((3, 3), np.nan)
    level.level_from_frd(out, roll, pitch, yaw)
    return out


def filter_inputs(acc, gyro, gyro_rate, R, vel=(0, 0, 0), hook=(0, 0, 0), imu=(0, 0, 0), thrust=0.0, drag=(0.0, 0.0)):
    z, u = np.empty(3), np.empty(3)
    vectors = [np.array(vector, dtype=float) for vector in (acc, gyro, gyro_rate)]
    rest = [np.array(vector, dtype=float) for vector in (vel, hook, imu)]
    level.filter_inputs(z, u, *vectors, R, *rest, thrust, M, *drag, GRAVITY_MPS2)
    return z, u


def direction(xi, zeta):
    return np.array([math.sin(zeta), -math.sin(xi) * math.cos(zeta), math.cos(xi) * math.cos(zeta)])


def in_heading(x, x_rate=None, P=None, lead_s=0.0, yaw=0.0, yaw_rate=0.0):
    """xi, zeta, rates, deviations; then the level frame's horizontal direction and its rate."""
    angles, vector = np.empty(6), np.empty(4)
    x_rate = np.zeros(4) if x_rate is None else np.asarray(x_rate, dtype=float)
    P = np.zeros((2, 2)) if P is None else np.ascontiguousarray(P)
    level.swing_in_heading(angles, vector, np.asarray(x, dtype=float), x_rate, P, lead_s, yaw, yaw_rate)
    return angles, vector


def angles_of(n):
    return np.array([math.atan2(-n[1], n[2]), math.asin(n[0])])


@pytest.mark.parametrize("seed", SEEDS)
def test_level_from_frd_is_the_321_rotation(seed):
    roll, pitch, yaw = np.random.default_rng(seed).uniform(-1.5, 1.5, 3) * [2.0, 1.0, 2.0]
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(rotation(roll, pitch, yaw), expected, atol=1e-14)


def test_rotation_in_words():
    """Nose down: thrust pushes forward. Right side down: to the right. Nose to the right: forward is right."""
    up = np.array([0.0, 0.0, -1.0])
    assert (rotation(0.0, -0.2, 0.0) @ up)[0] > 0.1
    assert (rotation(0.2, 0.0, 0.0) @ up)[1] > 0.1
    np.testing.assert_allclose(rotation(0.0, 0.0, 0.5 * math.pi) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("seed", SEEDS)
def test_filter_inputs_against_a_plain_formulation(seed):
    rng = np.random.default_rng(seed)
    acc, gyro, gyro_rate, vel = rng.normal(size=(4, 3)) * [[10.0], [3.0], [20.0], [4.0]]
    hook, imu = rng.normal(size=(2, 3)) * 0.3
    thrust, drag, drag_vertical = 17.0, 0.35, 0.1
    turn = Rotation.from_euler("ZYX", rng.uniform(-1.0, 1.0, 3))

    def relative(point):
        return np.cross(gyro_rate, point) + np.cross(gyro, np.cross(gyro, point))

    z, u = filter_inputs(acc, gyro, gyro_rate, turn.as_matrix(), vel, hook, imu, thrust, drag=(drag, drag_vertical))
    at_hook = acc - relative(imu) + relative(hook)
    np.testing.assert_allclose(z, turn.apply(at_hook) + np.array([0.0, 0.0, GRAVITY_MPS2]), rtol=1e-12, atol=1e-12)
    drag_body = -np.array([drag, drag, drag_vertical]) * turn.inv().apply(vel)
    body = np.array([0.0, 0.0, -thrust]) + drag_body + M * relative(hook)
    np.testing.assert_allclose(u, turn.apply(body), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_hook_and_imu_off_the_centre_are_the_same_filter(seed):
    """A rigid body with the load on a hook off its centre, by its Lagrangian: exact inputs satisfy f and h."""
    rng = np.random.default_rng(seed)
    gyro, gyro_rate = rng.normal(size=3) * 2.0, rng.normal(size=3) * 10.0
    hook, imu = np.array([0.02, -0.01, 0.2]), np.array([0.05, 0.03, -0.04])
    R = Rotation.from_euler("ZYX", rng.uniform(-0.5, 0.5, 3)).as_matrix()
    x = np.concatenate([rng.uniform(-0.8, 0.8, 2), rng.uniform(-2.0, 2.0, 2), np.zeros(3)])
    thrust = 1.1 * (M + ML) * GRAVITY_MPS2

    def relative(point):
        return np.cross(gyro_rate, point) + np.cross(gyro, np.cross(gyro, point))

    force = R @ [0.0, 0.0, -thrust]
    truth = model().accelerations(x, force, M, ML, L, r_rate2=tuple(R @ relative(hook)))
    acc_centre = truth[:3] - R @ relative(hook)
    acc_imu = R.T @ (acc_centre - [0.0, 0.0, GRAVITY_MPS2]) + relative(imu)

    z, u = filter_inputs(acc_imu, gyro, gyro_rate, R, hook=hook, imu=imu, thrust=thrust)
    f, F, h, H = np.empty(7), np.empty((7, 7)), np.empty(3), np.empty((3, 7))
    swing_ekf.dynamics(f, F, x, u, M, L)
    swing_ekf.observation(h, H, x, u, M, ML, L)
    np.testing.assert_allclose(z, truth[:3], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(h, z, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(f[2:4], truth[3:], rtol=1e-9, atol=1e-9)
    # Left out, the hook costs metres per second squared here: the test can fail.
    z_centre, _ = filter_inputs(acc_imu, gyro, gyro_rate, R, imu=imu, thrust=thrust)
    assert np.linalg.norm(z_centre - z) > 0.3


def test_swing_in_heading_without_yaw_is_the_state():
    angles, vector = in_heading([0.3, -0.2, 0.7, -0.4])
    np.testing.assert_allclose(angles[:4], [0.3, -0.2, 0.7, -0.4], atol=1e-14)
    np.testing.assert_allclose(vector[:2], direction(0.3, -0.2)[:2], atol=1e-15)


@pytest.mark.parametrize("seed", SEEDS)
def test_heading_rates_are_the_derivatives_of_the_heading_angles(seed):
    """The load swings, the vehicle yaws: numerically differentiated, with SciPy's rotation."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(-0.7, 0.7, 2), rng.uniform(-2.0, 2.0, 2)])
    x_rate = np.concatenate([x[2:], rng.uniform(-3.0, 3.0, 2)])
    yaw, yaw_rate = rng.uniform(-math.pi, math.pi), rng.uniform(-2.0, 2.0)

    def at(t):
        xi, zeta = x[:2] + t * x_rate[:2] + 0.5 * t * t * x_rate[2:]
        return angles_of(Rotation.from_euler("z", yaw + yaw_rate * t).inv().apply(direction(xi, zeta)))

    angles, vector = in_heading(x, x_rate, yaw=yaw, yaw_rate=yaw_rate)
    h = 1e-5
    np.testing.assert_allclose(angles[:2], at(0.0), atol=1e-12)
    np.testing.assert_allclose(angles[2:4], (at(h) - at(-h)) / (2.0 * h), rtol=1e-6, atol=1e-7)
    ahead, behind = (direction(*(x[:2] + t * x[2:])) for t in (h, -h))
    np.testing.assert_allclose(vector[2:], (ahead - behind)[:2] / (2.0 * h), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("seed", SEEDS)
def test_lead_is_the_state_a_little_later(seed):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(-0.6, 0.6, 2), rng.uniform(-2.0, 2.0, 2)])
    x_rate = np.concatenate([x[2:], rng.uniform(-3.0, 3.0, 2)])
    yaw, yaw_rate, lead_s = 0.7, 1.3, 0.02
    later = np.concatenate([x[:2] + lead_s * x[2:] + 0.5 * lead_s**2 * x_rate[2:], x[2:] + lead_s * x_rate[2:]])
    ahead = in_heading(x, x_rate, lead_s=lead_s, yaw=yaw, yaw_rate=yaw_rate)
    expected = in_heading(later, yaw=yaw + lead_s * yaw_rate, yaw_rate=yaw_rate)
    for got, wanted in zip(ahead, expected, strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-13)


def test_signs_in_words():
    """Load ahead: zeta > 0. Load to the left: xi > 0. Nose turned to the load on the right: the load is ahead."""
    ahead, left = np.array([0.0, 0.3, 0.0, 0.0]), np.array([0.3, 0.0, 0.0, 0.0])
    assert direction(*ahead[:2])[0] > 0.0
    assert direction(*left[:2])[1] < 0.0
    right = -left
    angles, _ = in_heading(right, yaw=0.5 * math.pi)
    np.testing.assert_allclose(angles[:2], [0.0, 0.3], atol=1e-15)


def test_a_still_load_seen_from_a_turning_vehicle_moves_but_has_no_rate_in_the_level_frame():
    """Yawing at 1 rad/s: the angles change, the vector that the damping law takes does not."""
    angles, vector = in_heading([0.2, 0.1, 0.0, 0.0], yaw=0.4, yaw_rate=1.0)
    assert np.abs(angles[3]) > 0.2
    np.testing.assert_array_equal(vector[2:], [0.0, 0.0])
    for yaw_rate in (0.0, 1.0, -3.0):
        swinging = in_heading([0.2, 0.1, 0.5, 0.4], yaw=0.4, yaw_rate=yaw_rate)[1]
        np.testing.assert_array_equal(swinging, in_heading([0.2, 0.1, 0.5, 0.4])[1])


def test_the_pair_of_angles_is_not_a_vector():
    """Turning xi and zeta as if they were one is wrong by more than a degree at large swing."""
    xi, zeta, yaw = 0.6, 0.6, 0.8
    angles, _ = in_heading([xi, zeta, 0.0, 0.0], yaw=yaw)
    np.testing.assert_allclose(angles[:2], angles_of(Rotation.from_euler("z", -yaw).apply(direction(xi, zeta))))
    lateral_right = -xi
    ahead = math.cos(yaw) * zeta + math.sin(yaw) * lateral_right
    assert abs(ahead - angles[1]) > math.radians(1.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_deviations_against_the_unscented_and_sampled_transform(seed):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(-0.6, 0.6, 2), np.zeros(2)])
    root = rng.normal(size=(2, 2)) * 0.01
    P, yaw = root @ root.T, rng.uniform(-math.pi, math.pi)
    angles, _ = in_heading(x, P=P, yaw=yaw)
    samples = x[:2] + rng.normal(size=(4000, 2)) @ root.T
    turned = Rotation.from_euler("z", -yaw).apply(np.array([direction(*sample) for sample in samples]))
    sampled = np.array([angles_of(n) for n in turned]).std(axis=0)
    # The deviation of 4000 samples is known to 1.1 %.
    np.testing.assert_allclose(angles[4:], sampled, rtol=0.05)


def test_deviations_by_finite_differences():
    x, P, yaw = np.array([0.5, -0.4, 0.0, 0.0]), np.array([[2e-4, 5e-5], [5e-5, 1e-4]]), 1.1
    J = np.empty((2, 2))
    for column in range(2):
        step = np.zeros(4)
        step[column] = 1e-6
        J[:, column] = (in_heading(x + step, yaw=yaw)[0] - in_heading(x - step, yaw=yaw)[0])[:2] / 2e-6
    np.testing.assert_allclose(in_heading(x, P=P, yaw=yaw)[0][4:], np.sqrt(np.diag(J @ P @ J.T)), rtol=1e-7)


@pytest.mark.parametrize(
    ("xi", "zeta"), [(0.0, 1.5), (1.5, 0.0), (math.pi / 2, math.pi / 2), (math.nan, 0.0), (0.0, math.inf)]
)
def test_swing_in_heading_never_raises(xi, zeta):
    angles, _ = in_heading([xi, zeta, 1.0, 1.0], P=np.eye(2), yaw=0.3, yaw_rate=1.0)
    assert np.isfinite(angles).all() == (math.isfinite(xi) and math.isfinite(zeta))
