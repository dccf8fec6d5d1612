"""The paper's filter on inclination and azimuth: its corrected equations, and what is wrong with the printed ones."""

import math

import numpy as np
import pytest

from swingd.core import tether_angles as angles
from swingd.core import tether_ukf as sphere
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status
from swingd.core.tether_angles import TetherModel

L, M = 1.2, 1.64
NO_TURN = np.zeros(2)
NOTHING = np.zeros(3)


def rates(x, force, model, rotating, rel_acc=NOTHING, turn=NO_TURN):
    out = np.empty(4)
    angles.angle_rates(out, x, force, rel_acc, turn, 1.0 / L, M, int(model), int(rotating))
    return out


@pytest.mark.parametrize("model", [TetherModel.PIVOT, TetherModel.RANDOM])
def test_with_the_rotating_terms_it_is_the_motion_on_the_sphere(model):
    x, a = np.array([0.6, 0.7, -1.9, 1.3]), np.array([0.8, -1.2, 0.5])
    found = rates(x, a, model, rotating=True)
    s, c = math.sin(x[0]), math.cos(x[0])
    e_theta = np.array([c * math.cos(x[2]), c * math.sin(x[2]), -s])
    e_phi = np.array([-math.sin(x[2]), math.cos(x[2]), 0.0])
    n = np.array([s * math.cos(x[2]), s * math.sin(x[2]), c])
    on_sphere, acc = np.concatenate([n, x[1] * e_theta + s * x[3] * e_phi, np.zeros(5)]), np.empty(3)
    sphere.acceleration(acc, on_sphere, a, 1.0 / L if model is TetherModel.PIVOT else 0.0)
    assert found[1] == pytest.approx(acc @ e_theta + x[3] ** 2 * s * c)
    assert found[3] == pytest.approx((acc @ e_phi - 2.0 * x[1] * x[3] * c) / s)


def test_what_the_paper_neglects_is_centrifugal_and_coriolis():
    x, a = np.array([0.6, 0.7, -1.9, 1.3]), np.array([0.8, -1.2, 0.5])
    neglected = rates(x, a, TetherModel.PIVOT, True) - rates(x, a, TetherModel.PIVOT, False)
    s, c = math.sin(x[0]), math.cos(x[0])
    np.testing.assert_allclose(neglected, [0.0, x[3] ** 2 * s * c, 0.0, -2.0 * x[1] * x[3] * c / s])


def test_in_a_turning_heading_frame_the_azimuth_s_absolute_rate_counts():
    x, a, turn = np.array([0.6, 0.7, -1.9, 1.3]), np.array([0.8, -1.2, 0.5]), np.array([0.4, 0.9])
    absolute = x + np.array([0.0, 0.0, 0.0, turn[0]])
    seen, true = rates(x, a, TetherModel.PIVOT, True, turn=turn), rates(absolute, a, TetherModel.PIVOT, True)
    np.testing.assert_allclose(seen[[1, 3]], true[[1, 3]] - [0.0, turn[1]])


def exact_inputs(x, x_rate, a):
    """Thrust less m a_d of a vehicle whose cable pulls along u_r: -T u_r - m g e_z, whatever its acceleration."""
    n = np.empty(3)
    angles.direction(n, x)
    tension = 2.5
    thrust = M * a - M * GRAVITY_MPS2 * np.array([0.0, 0.0, 1.0]) - tension * n
    return thrust - M * a


def test_the_printed_model_with_exact_inputs_repeats_the_last_acceleration():
    x, a = np.array([0.4, 0.3, 0.7, -0.2]), np.array([0.5, 0.2, -0.1])
    last = np.array([0.3, 0.9, -0.2, 0.6])
    rel_acc = np.empty(3)
    angles.relative_acceleration(rel_acc, x, last, L)
    found = rates(x, exact_inputs(x, last, a), TetherModel.PRINTED, False, rel_acc)
    assert found[1] == pytest.approx(last[1])
    assert found[3] == pytest.approx(last[3])


def test_the_printed_model_drives_an_error_away_where_it_should_pull_it_in():
    truth, a = np.array([0.4, 0.0, 0.7, 0.0]), NOTHING
    force = exact_inputs(truth, truth, a)
    for error in (-0.1, 0.1):
        wrong = truth + np.array([error, 0.0, 0.0, 0.0])
        assert error * rates(wrong, force, TetherModel.PRINTED, False)[1] > 0.0
        assert error * (rates(wrong, a, TetherModel.PIVOT, False) - rates(truth, a, TetherModel.PIVOT, False))[1] < 0.0


def test_a_load_ahead_is_at_azimuth_0_and_one_on_the_right_at_90_deg():
    seen, n = np.empty(2), np.empty(3)
    for force, wanted in (
        ((1.0, 0.0, 1.0), (45.0, 0.0)),
        ((0.0, 1.0, 1.0), (45.0, 90.0)),
        ((-1.0, 0.0, 1.0), (45.0, 180.0)),
    ):
        angles.observed_angles(seen, np.array(force))
        assert np.degrees(seen) == pytest.approx(wanted)
        angles.direction(n, np.array([seen[0], 0.0, seen[1], 0.0]))
        np.testing.assert_allclose(n, np.array(force) / np.linalg.norm(force), atol=1e-12)


def predicted(x, P, model, rotating, steps, a=NOTHING):
    rel_acc, out = np.zeros(3), np.empty(4)
    for _ in range(steps):
        status = angles.predict(
            x, P, rel_acc, a, NO_TURN, out, np.array([0.01, 0.01]), 0.01, 1.0 / L, M, int(model), int(rotating)
        )
        assert status == Status.OK
    return x


def test_away_from_the_vertical_both_filters_agree():
    P = np.diag([1e-6, 1e-6, 1e-6, 1e-6])
    x = predicted(np.array([0.5, 0.1, 0.3, 0.8]), P.copy(), TetherModel.PIVOT, True, 60)
    s = math.sin(0.5)
    on_sphere = np.empty(11)
    sphere.hang(on_sphere)
    c = math.cos(0.5)
    n = [s * math.cos(0.3), s * math.sin(0.3), c]
    e_theta, e_phi = (
        np.array([c * math.cos(0.3), c * math.sin(0.3), -s]),
        np.array([-math.sin(0.3), math.cos(0.3), 0.0]),
    )
    on_sphere[:] = [*n, *(0.1 * e_theta + s * 0.8 * e_phi), *e_theta, 0.0, 0.0]
    cov = np.diag([1e-6] * 4 + [1e-12] * 2)
    for _ in range(60):
        sphere.predict(on_sphere, cov, NOTHING, 1.0 / L, 1e-4, 0.0, 0.01)
    n_angles = np.empty(3)
    angles.direction(n_angles, x)
    np.testing.assert_allclose(n_angles, on_sphere[:3], atol=2e-4)


def test_random_acceleration_is_the_wiener_model():
    P = np.diag([1e-3, 2e-3, 3e-3, 4e-3])
    start = P.copy()
    x = predicted(np.array([0.5, 0.1, 0.3, -0.2]), P, TetherModel.RANDOM, False, 1)
    np.testing.assert_allclose(x, [0.501, 0.1, 0.298, -0.2])
    F = np.eye(4)
    F[0, 1] = F[2, 3] = 0.01
    gamma = np.array([[5e-5, 0.0], [0.01, 0.0], [0.0, 5e-5], [0.0, 0.01]])
    np.testing.assert_allclose(P, F @ start @ F.T + 1e-4 * gamma @ gamma.T, atol=1e-15)


def test_correction_is_kalman_s_and_takes_the_azimuth_the_short_way_round():
    x, P = np.array([0.5, 0.1, 3.1, -0.2]), np.diag([1e-2, 2e-2, 3e-2, 4e-2])
    P[0, 1] = P[1, 0] = 5e-3
    P[2, 3] = P[3, 2] = 1e-2
    H, R = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]]), np.diag([0.02, 0.05])
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    wanted, cov = x + K @ [0.1, 0.2 * math.pi], P - K @ H @ P
    assert angles.correct(x, P, np.array([0.6, 3.1 - 1.8 * math.pi]), np.diag(R).copy()) == Status.OK
    wanted[2] = math.remainder(wanted[2], 2.0 * math.pi)
    np.testing.assert_allclose(x, wanted)
    np.testing.assert_allclose(P, cov, atol=1e-15)


def test_a_tether_that_swings_through_the_vertical_comes_out_on_the_other_side():
    P = np.diag([1e-4, 1e-4, 1e-4, 1e-4])
    P[0, 2] = P[2, 0] = 5e-5
    x = predicted(np.array([0.004, -1.0, 0.3, 0.0]), P, TetherModel.RANDOM, False, 1)
    assert x[0] == pytest.approx(0.006)
    assert x[1] == pytest.approx(1.0)
    assert x[2] == pytest.approx(0.3 - math.pi)
    assert P[0, 2] == pytest.approx(-5e-5, rel=0.1)
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_what_it_cannot_do_is_said_and_changes_nothing():
    x, P = np.array([0.5, 0.1, 3.1, -0.2]), np.eye(4)
    before, rel_acc, out = x.copy(), np.zeros(3), np.empty(4)
    bad = np.full(3, np.nan)
    arguments = (NO_TURN, out, np.zeros(2), 0.01, 1.0 / L, M, int(TetherModel.PIVOT), 0)
    assert angles.predict(x, P, rel_acc, bad, *arguments) == Status.NOT_FINITE
    assert angles.predict(x, -P, rel_acc, NOTHING, *arguments) == Status.NOT_POSITIVE
    assert angles.correct(x, P, np.array([np.nan, 0.0]), np.ones(2)) == Status.NOT_FINITE
    assert angles.correct(x, P, np.zeros(2), -2.0 * np.ones(2)) == Status.NOT_POSITIVE
    np.testing.assert_array_equal(x, before)
