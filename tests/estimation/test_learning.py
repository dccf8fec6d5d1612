"""A cable or a load that is not as configured is learned in flight."""

import dataclasses
import math

import numpy as np
import pytest
from engine.flight import hold
from faults.scenarios import fly, hovering
from hypothesis import given
from hypothesis import strategies as st

from swingd.core import swing_ekf as kernels
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.estimation import SwingEkf
from swingd.estimation.swing_ekf import KEEPS_MODEL, PARAMETER_MAX, trusted
from swingd.model.estimate import ResetReason

from .rig import DT_S, EXACT, ML, L, M, parameters

TRUTH_STEPS = 4


def pushed(t_s, payload_kg=ML):
    """Force of a vehicle that is pushed about and keeps the swing going [N]."""
    return np.array([2.0 * math.sin(1.3 * t_s), 1.5 * math.cos(0.9 * t_s), -(M + payload_kg) * GRAVITY_MPS2])


def motion(length_m, payload_kg, duration_s, seed=0, noise_mps2=0.05):
    """Force and measured acceleration of each step, and the swing after it, by Runge-Kutta on the model."""
    rng = np.random.default_rng(seed)
    f, F, h, H = np.empty(7), np.empty((7, 7)), np.empty(3), np.empty((3, 7))

    def rate(x):
        kernels.dynamics(f, F, x, u, M, length_m)
        return f.copy()

    x = np.array([0.2, -0.15, 0.0, 0.0, 0.0, 0.0, 0.0])
    dt_s = DT_S / TRUTH_STEPS
    for k in range(round(duration_s / DT_S)):
        u = pushed(k * DT_S, payload_kg)
        acc = np.zeros(3)
        for _ in range(TRUTH_STEPS):
            k1 = rate(x)
            k2 = rate(x + 0.5 * dt_s * k1)
            kernels.observation(h, H, x + 0.5 * dt_s * k1, u, M, payload_kg, length_m)
            acc += h / TRUTH_STEPS
            k3 = rate(x + 0.5 * dt_s * k2)
            x = x + dt_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(x + dt_s * k3))
        yield u, acc + rng.normal(0.0, noise_mps2, 3), x


def flown(ekf, steps, from_s=10.0, **known):
    """The estimate at the end, and the error of the angles from then on [deg]."""
    errors = []
    for k, (u, acc, x) in enumerate(steps):
        ekf.step(u, acc, DT_S, **known)
        if k * DT_S >= from_s:
            errors.append(ekf.estimate().x[:2] - x[:2])
    return ekf.estimate(), math.degrees(np.sqrt(np.mean(np.square(errors))))


@pytest.fixture(scope="module")
def normal_deg():
    return flown(SwingEkf(parameters()), motion(L, ML, 20.0))[1]


@pytest.mark.parametrize(("length", "mass"), [(0.8, 1.0), (1.2, 1.0), (1.0, 0.8), (1.0, 1.2), (1.2, 0.8)])
def test_the_true_model_is_found(normal_deg, length, mass):
    """GIVEN a cable or a load as configured times these WHEN it swings THEN both are known after twenty seconds."""
    true_length_m, true_kg = length * L, mass * ML
    estimate, error_deg = flown(SwingEkf(parameters()), motion(true_length_m, true_kg, 20.0))
    learned = estimate.learned
    assert learned.length_m == pytest.approx(true_length_m, rel=0.02)
    assert learned.payload_mass_kg == pytest.approx(true_kg, rel=0.08)
    assert abs(learned.length_m - true_length_m) < 3.0 * learned.length_std_m
    assert abs(learned.payload_mass_kg - true_kg) < 3.0 * learned.payload_mass_std_kg
    _, ignorant_deg = flown(SwingEkf(parameters(**EXACT)), motion(true_length_m, true_kg, 20.0))
    assert error_deg < 0.75 * ignorant_deg
    assert error_deg < 3.0 * normal_deg


def test_a_model_that_is_right_stays_as_configured(normal_deg):
    exact, exact_deg = flown(SwingEkf(parameters(**EXACT)), motion(L, ML, 20.0))
    assert (exact.learned.length_m, exact.learned.payload_mass_kg) == (L, ML)
    assert (exact.learned.length_std_m, exact.learned.payload_mass_std_kg) == (0.0, 0.0)
    assert normal_deg == pytest.approx(exact_deg, rel=0.05)


def test_without_swing_nothing_is_learned():
    ekf = SwingEkf(parameters())
    rng = np.random.default_rng(4)
    for _ in range(2000):
        ekf.step(np.array([0.0, 0.0, -(M + ML) * GRAVITY_MPS2]), rng.normal(0.0, 0.05, 3), DT_S)
    learned = ekf.estimate().learned
    assert learned.length_m == pytest.approx(L, rel=0.01)
    assert learned.length_std_m > 0.9 * 0.15 * L


def test_from_a_thrust_that_the_model_made_nothing_is_learned():
    estimate, _ = flown(SwingEkf(parameters()), motion(1.2 * L, ML, 10.5), thrust_known=False)
    assert estimate.learned.length_m == L
    assert estimate.learned.payload_mass_kg == ML


@pytest.mark.parametrize("reason", list(ResetReason))
def test_what_is_kept_when_the_estimate_begins_anew(reason):
    ekf = SwingEkf(parameters())
    before = flown(ekf, motion(1.2 * L, ML, 10.5))[0].learned
    ekf.reset(reason)
    after = ekf.estimate().learned
    if reason in KEEPS_MODEL:
        assert after == before
    else:
        assert (after.length_m, after.payload_mass_kg) == (L, ML)
        assert after.length_std_m == pytest.approx(0.15 * L)


def test_a_cable_twice_as_long_is_not_chased_beyond_the_bound():
    learned = flown(SwingEkf(parameters(cable_length_std=0.5)), motion(2.5 * L, ML, 15.0))[0].learned
    assert learned.length_m <= L * math.exp(PARAMETER_MAX) * (1.0 + 1e-12)
    assert math.isfinite(learned.payload_mass_kg)


@given(st.floats(-1.0, 1.0), st.floats(1e-3, 0.2))
def test_what_is_acted_on_is_nothing_or_a_part_of_what_was_learned(learned, feigned):
    acted_on = trusted(learned, feigned)
    if abs(learned) <= feigned:
        assert acted_on == 0.0
    else:
        assert 0.0 <= acted_on / learned <= 1.0
        assert abs(learned - acted_on) <= feigned


def test_vibration_of_a_real_quad_costs_less_than_half_of_what_it_did() -> None:
    """GIVEN 7 m/s^2 RMS of vibration WHEN the vehicle manoeuvres THEN the estimate is good to 1.5 deg."""
    truth = hold(vibration_hz=130.0)
    errors = []
    for acc_noise_max in (2.0, 1e-6):
        estimator = dataclasses.replace(truth.estimator, acc_noise_max=acc_noise_max)
        flight = hovering(truth, dataclasses.replace(truth, estimator=estimator))
        errors.append(fly(flight, ["vibration 5 0..8.5"]).rmse_deg(2.5, 10.0))
    adapted_deg, as_before_deg = errors
    assert adapted_deg < 1.5
    assert adapted_deg < 0.5 * as_before_deg
