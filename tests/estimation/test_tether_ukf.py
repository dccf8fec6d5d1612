"""The tether UKF as an object: NEES and NIS, tracking, the vertical, wind, gate, resets, bad inputs."""

import math

import numpy as np
import pytest
from core.two_point_masses import model
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from swingd.core import tether_ukf as kernels
from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.estimation.tether_direction import TetherDirection
from swingd.estimation.tether_ukf import TetherUkf
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Estimator

from .rig import DT_S, HOVER, ML, STILL, L, M, faults, parameters

RUNS = 50
STEPS = 300


def bounds(dof, count, probability=0.999):
    tail = 0.5 * (1.0 - probability)
    return chi2.ppf([tail, 1.0 - tail], dof * count) / count


def consistency(seed, length_m, start, held=False, trust=1.0):
    """Fly the filter's own model with its own noise; NEES once a second, NIS of every step."""
    rng = np.random.default_rng(seed)
    density, angle_std, rate_std, force_std = 0.15, 0.15, 0.4, 0.5
    pull_density, pull_std = (0.3, 0.5) if held else (0.0, 1e-6)
    tether = TetherDirection(length_m, density, angle_std, rate_std, pull_density, pull_std)
    tether.reset(np.array(start))
    truth, mean = np.empty(11), np.empty(11)
    kernels.moved(truth, tether._x, rng.normal(size=6) * np.repeat([angle_std, rate_std, pull_std], 2))
    cov = force_std**2 * np.diag([1.0, 1.0, 2.0])
    nees, nis, error, moved = [], [], np.empty(6), np.empty(11)
    for k in range(STEPS):
        a = np.array([2.0 * math.sin(0.05 * k), 1.5 * math.cos(0.03 * k), 0.5 * math.sin(0.02 * k)])
        kernels.swing_on(truth, a, 1.0 / length_m, DT_S)
        noise = rng.normal(size=2) * density / math.sqrt(DT_S)
        drift = rng.normal(size=2) * pull_density * math.sqrt(DT_S)
        kernels.moved(moved, truth, np.concatenate([0.5 * DT_S**2 * noise, DT_S * noise, drift]))
        truth[:] = moved
        assert tether.predict(a, DT_S) is Status.OK
        force = 3.0 * truth[:3] + rng.normal(size=3) * np.sqrt(np.diag(cov))
        assert tether.correct(force, trust * cov) is Status.OK
        nis.append(tether.nis)
        if (k + 1) % 100 == 0:
            mean[:] = tether._x
            kernels.error_to(error, mean, truth)
            free = 6 if held else 4
            nees.append(error[:free] @ np.linalg.solve(tether.error_cov[:free, :free], error[:free]))
    return nees, nis


@pytest.mark.parametrize(
    ("length_m", "start", "held"),
    [
        (1.2, (0.0, 0.0, 1.0), False),
        (1.2, (0.0, 0.3, 1.0), True),
        (math.inf, (0.0, 0.0, 1.0), False),
        (math.inf, (0.0, 0.5, 1.0), False),
    ],
)
def test_nees_and_nis_below_a_moving_vehicle_and_with_a_held_end_through_the_vertical(length_m, start, held):
    runs = [consistency(seed, length_m, start, held) for seed in range(RUNS)]
    nees = np.array([run[0] for run in runs])
    low, high = bounds(6 if held else 4, RUNS)
    assert ((low < nees.mean(axis=0)) & (nees.mean(axis=0) < high)).all(), nees.mean(axis=0)
    nis = np.array([run[1] for run in runs])[:, 50:]
    # A force of 3 N with 0.5 N of noise: its direction's own curvature is a few percent.
    assert nis.mean() == pytest.approx(2.0, rel=0.06)


def test_a_filter_that_trusts_too_much_fails_the_same_bounds():
    nees = np.array([consistency(seed, 1.2, (0.0, 0.0, 1.0), trust=0.05)[0] for seed in range(10)])
    assert nees.mean() > bounds(4, nees.size)[1]


def test_the_pull_of_others_is_found_where_they_hold_the_load_aside():
    tether = TetherDirection(1.2, 0.1, 0.1, 0.1, 0.3, 0.5)
    for _ in range(2000):
        assert tether.predict(STILL, DT_S) is Status.OK
        assert tether.correct(np.array([0.0, 0.6, 3.0]), 0.01 * np.eye(3)) is Status.OK
    np.testing.assert_allclose(tether.pull_mps2, [0.0, 0.2 * GRAVITY_MPS2], atol=1e-3)
    np.testing.assert_allclose(tether.rate, 0.0, atol=1e-4)


def pushed(t):
    """Thrust of a vehicle that leans to and fro."""
    return HOVER + np.array([0.8 * math.sin(1.7 * t), 0.6 * math.cos(1.3 * t), 0.3 * math.sin(2.1 * t)])


@pytest.fixture(scope="module")
def swing():
    exact = solve_ivp(
        lambda t, y: model().dynamics(np.concatenate([y, np.zeros(3)]), pushed(t), M, ML, L)[:4],
        (0.0, 12.0),
        [0.12, -0.1, 0.0, 0.0],
        rtol=1e-9,
        atol=1e-11,
        dense_output=True,
    )
    return exact.sol


def inputs(swing, middle_s):
    x = np.concatenate([swing(middle_s), np.zeros(3)])
    return pushed(middle_s), model().observation(x, pushed(middle_s), M, ML, L)


def test_it_finds_a_swing_that_was_not_announced_and_its_rates(swing):
    ukf, errors = TetherUkf(parameters()), []
    for k in range(1200):
        assert ukf.step(*inputs(swing, (k + 0.5) * DT_S), DT_S) is Status.OK
        errors.append(ukf.estimate().x[:4] - swing((k + 1) * DT_S))
    errors = np.array(errors)
    assert np.degrees(np.abs(errors[600:, :2])).max() < 0.1
    assert np.degrees(np.abs(errors[600:, 2:])).max() < 0.3
    assert ukf.estimate().P.shape == (7, 7)
    assert not ukf.estimate().x[4:].any()


def test_it_needs_no_mass_of_the_load(swing):
    light, heavy = (TetherUkf(parameters()) for _ in range(2))
    heavy._weight_n *= 3.0
    for k in range(300):
        for ukf in (light, heavy):
            ukf.step(*inputs(swing, (k + 0.5) * DT_S), DT_S)
    np.testing.assert_array_equal(light.estimate().x, heavy.estimate().x)


def test_the_tension_is_that_of_the_cable(swing):
    ukf = TetherUkf(parameters())
    assert ukf.estimate().tension_n == pytest.approx(ML * GRAVITY_MPS2)
    for k in range(800):
        u, z = inputs(swing, (k + 0.5) * DT_S)
        ukf.step(u, z, DT_S)
    assert ukf.estimate().tension_n == pytest.approx(np.linalg.norm(M * z - [0.0, 0.0, M * GRAVITY_MPS2] - u), rel=1e-3)


def test_at_rest_at_the_vertical_it_stays_there():
    ukf = TetherUkf(parameters())
    for _ in range(3000):
        assert ukf.step(HOVER, STILL, DT_S) is Status.OK
    estimate = ukf.estimate()
    np.testing.assert_allclose(estimate.x, 0.0, atol=1e-12)
    assert np.linalg.eigvalsh(estimate.P[:4, :4]).min() > 0.0
    assert np.isfinite(ukf.tether.spherical()).all()


def test_wind_on_the_vehicle_is_taken_for_the_load():
    wind_n, ukf = 1.0, TetherUkf(parameters())
    for _ in range(2000):
        ukf.step(HOVER + np.array([wind_n, 0.0, 0.0]), STILL, DT_S)
    assert 0.0 < -ukf.estimate().x[1] < math.atan(wind_n / (ML * GRAVITY_MPS2))
    assert ukf.estimate().x[4] == 0.0


def test_coasting_keeps_swinging_and_widens_the_covariance(swing):
    ukf = TetherUkf(parameters())
    for k in range(600):
        ukf.step(*inputs(swing, (k + 0.5) * DT_S), DT_S)
    before = ukf.estimate()
    ukf.coast(HOVER, 0.5)
    after = ukf.estimate()
    assert after.nis == 0.0
    assert before.nis >= 0.0
    # An oscillator's angle and rate take turns; their volume only grows.
    assert np.linalg.det(after.P[:4, :4]) > 1.1 * np.linalg.det(before.P[:4, :4])
    ukf.coast(np.full(3, np.nan), 0.5)
    np.testing.assert_array_equal(ukf.estimate().x, after.x)


def test_the_derivative_is_that_of_the_prediction(swing):
    ukf = TetherUkf(parameters())
    for k in range(300):
        ukf.step(*inputs(swing, (k + 0.5) * DT_S), DT_S)
    before = ukf.estimate()
    ukf.coast(HOVER, 1e-5)
    np.testing.assert_allclose((ukf.estimate().x[:4] - before.x[:4]) / 1e-5, before.x_rate, atol=1e-3)


@pytest.mark.parametrize(
    ("force", "acc", "dt_s"),
    [
        (np.array([math.nan, 0.0, 0.0]), STILL, DT_S),
        (HOVER, np.array([0.0, math.inf, 0.0]), DT_S),
        (HOVER, np.array([0.0, 1e10, 0.0]), DT_S),
        (HOVER, STILL, 0.0),
        (HOVER, STILL, -0.1),
        (HOVER, STILL, math.nan),
        (HOVER, STILL, 11.0),
    ],
)
def test_bad_inputs_are_answered_and_change_nothing(force, acc, dt_s):
    ukf = TetherUkf(parameters())
    ukf.step(HOVER, np.array([0.3, 0.1, 0.0]), DT_S)
    before = ukf.estimate()
    assert ukf.step(force, acc, dt_s) is Status.INPUT_INVALID
    np.testing.assert_array_equal(ukf.estimate().x, before.x)
    assert faults(ukf) == {}


def side(force_n):
    """Acceleration of a hovering vehicle whose cable pulls with ``force_n`` to the right beside the load's weight."""
    return np.array([0.0, force_n / M, 0.0])


def test_a_wild_measurement_is_gated_and_too_many_begin_anew():
    ukf = TetherUkf(parameters(acc_noise=0.01, acc_noise_vertical=0.01))
    for _ in range(500):
        ukf.step(HOVER, STILL, DT_S)
    wild = side(4.0 * ML * GRAVITY_MPS2)
    assert ukf.step(HOVER, wild, DT_S) is Status.GATED
    assert ukf.estimate().nis > Estimator().nis_gate
    answers = [ukf.step(HOVER, wild, DT_S) for _ in range(110)]
    assert Status.NOT_CONVERGED in answers
    assert faults(ukf) == {ResetReason.INNOVATION: 1}


def test_no_cable_force_is_no_measurement():
    ukf = TetherUkf(parameters())
    assert ukf.step(STILL, np.array([0.0, 0.0, GRAVITY_MPS2]), DT_S) is Status.GATED
    assert ukf.estimate().nis == 0.0


def test_a_swing_beyond_what_hangs_begins_anew():
    ukf = TetherUkf(parameters(acc_noise=0.01, acc_noise_vertical=0.01, nis_gate=1e4))
    answers = [ukf.step(HOVER + np.array([0.0, 60.0, 0.0]), side(0.0), DT_S) for _ in range(400)]
    assert Status.NOT_CONVERGED in answers
    assert ResetReason.ANGLE in faults(ukf)


def test_an_interval_of_seconds_is_divided():
    ukf, fine = TetherUkf(parameters()), TetherUkf(parameters())
    for each in (ukf, fine):
        each.step(HOVER, np.array([1.0, 0.5, 0.0]), DT_S)
    ukf.coast(HOVER, 1.0)
    for _ in range(100):
        fine.coast(HOVER, 0.01)
    np.testing.assert_allclose(ukf.estimate().x, fine.estimate().x, atol=5e-4)
    np.testing.assert_allclose(ukf.estimate().P, fine.estimate().P, rtol=0.05, atol=1e-3)


def test_a_reset_forgets():
    ukf = TetherUkf(parameters())
    ukf.step(HOVER, np.array([1.0, 0.5, 0.0]), DT_S)
    ukf.reset(ResetReason.GAP)
    assert not ukf.estimate().x.any()
    assert faults(ukf) == {ResetReason.GAP: 1}
