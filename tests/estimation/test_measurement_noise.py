"""Vibration enters the measurement noise by itself, and leaves it again."""

import math

import numpy as np
import pytest

from swingd.estimation.measurement_noise import MeasurementNoise
from swingd.estimation.swing_ekf import SwingEkf

from .rig import DT_S, EXACT, HOVER, parameters

FLOOR = np.array([3.6e-3, 3.6e-3, 0.04])
CEILING = 4.0


def fed(innovations, dt_s=DT_S, noise=None):
    """The noise after these innovations, and every R on the way."""
    noise = noise or MeasurementNoise(FLOOR, CEILING)
    history = []
    for innovation in innovations:
        noise.update(innovation, dt_s)
        history.append(noise.R_diag.copy())
    return noise, np.array(history)


def white(density, duration_s, dt_s=DT_S, seed=1):
    count = round(duration_s / dt_s)
    return np.random.default_rng(seed).normal(size=(count, 3)) * np.sqrt(np.asarray(density) / dt_s)


@pytest.mark.parametrize("dt_s", [0.004, 0.01, 0.02])
def test_white_noise_is_found_axis_by_axis_whatever_the_rate(dt_s):
    true = FLOOR * [100.0, 20.0, 1.0]
    _, history = fed(white(true, 60.0, dt_s), dt_s)
    settled = history[round(5.0 / dt_s) :].mean(axis=0)
    np.testing.assert_allclose(settled[:2], true[:2], rtol=0.1)
    assert settled[2] == pytest.approx(FLOOR[2], rel=0.02)


def test_noise_as_configured_changes_nothing():
    _, history = fed(white(FLOOR, 100.0))
    assert (history >= FLOOR).all()
    np.testing.assert_allclose(history.mean(axis=0), FLOOR, rtol=0.02)


def test_vibration_is_believed_within_a_second_and_forgotten_within_three():
    noise, history = fed(white(30.0 * FLOOR, 1.0))
    assert (history[-1] > 10.0 * FLOOR).all()
    assert noise.inflation == pytest.approx((history[-1] / FLOOR).max())
    _, after = fed(white(0.05 * FLOOR, 3.0, seed=2), noise=noise)
    assert (after[-1] == FLOOR).all()
    assert noise.inflation == 1.0


@pytest.mark.parametrize("frequency_hz", [0.0, 0.2, 0.5])
def test_what_is_slow_is_an_error_of_the_model_and_no_noise(frequency_hz):
    """A push or a wrong load of five deviations of the configured noise, at the frequencies of loads."""
    t = np.arange(0.0, 10.0, DT_S)
    slow = np.cos(2.0 * math.pi * frequency_hz * t)[:, None] * 5.0 * np.sqrt(FLOOR / DT_S)
    _, history = fed(slow)
    np.testing.assert_array_equal(history, np.broadcast_to(FLOOR, history.shape))


def test_a_single_outlier_changes_nothing():
    innovations = white(0.1 * FLOOR, 3.0)
    innovations[200] = 1e6
    _, history = fed(innovations)
    np.testing.assert_array_equal(history, np.broadcast_to(FLOOR, history.shape))


def test_the_bound_holds_and_a_configured_noise_above_it_stays():
    floor = np.array([1.0, 3.6e-3, 9.0])
    _, history = fed(white([1e4] * 3, 3.0), noise=MeasurementNoise(floor, CEILING))
    np.testing.assert_allclose(history.max(axis=0), [CEILING, CEILING, 9.0])


def test_a_filter_that_shakes_knows_it_and_stays_consistent():
    """GIVEN hover WHEN the accelerometer shakes by 5 m/s^2 THEN the NIS is that of three degrees of freedom."""

    def shaken(**estimator):
        ekf = SwingEkf(parameters(**EXACT, **estimator))
        rng = np.random.default_rng(5)
        nis, angle = [], []
        for k in range(1500):
            ekf.step(HOVER, rng.normal(0.0, 5.0 if k >= 300 else 0.05, 3), DT_S)
            nis.append(ekf.estimate().nis)
            angle.append(ekf.estimate().x[:2])
        return np.mean(nis[500:]), math.degrees(np.sqrt(np.mean(np.square(angle[500:])))), ekf

    nis, error_deg, ekf = shaken()
    assert 2.5 < nis < 3.5
    assert ekf.estimate().noise_inflation > 30.0
    believed_nis, believed_error_deg, _ = shaken(acc_noise_max=1e-6)
    assert believed_nis > 20.0
    assert error_deg < 0.5 * believed_error_deg
