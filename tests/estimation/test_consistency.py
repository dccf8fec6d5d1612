"""NEES and NIS of the filter on its own model with exactly its own noise, within chi-square bounds."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from swingd.core import swing_ekf as kernels
from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.estimation import SwingEkf
from swingd.estimation.swing_ekf import ANGLE_NOISE_VAR
from swingd.model.parameters import Estimator, Integrator, Parameters, Payload, Vehicle

M, ML, L = 1.5, 0.3, 1.5
RUNS = 60
DURATION_S = 4.0
DT_S = 0.01
FINE = 4
"""Truth steps in one filter step; the filter divides its interval by as many."""
NOISE = Estimator(
    max_step_s=DT_S / FINE,
    swing_rate_noise=0.05,
    force_noise=0.2,
    acc_noise=0.06,
    acc_noise_vertical=0.1,
    swing_std_init_rad=0.15,
    swing_rate_std_init_radps=0.3,
    force_std_init=0.5,
    nis_gate=1e4,
    cable_length_std=0.0,
    payload_mass_std=0.0,
)


def truth_step(x, u, dt_s):
    """Classical Runge-Kutta on f; returns the next state and the mean of h over the step by Simpson's rule."""
    f, F, h, H = np.empty(7), np.empty((7, 7)), np.empty(3), np.empty((3, 7))

    def rate(at):
        kernels.dynamics(f, F, at, u, M, L)
        return f.copy()

    def acceleration(at):
        kernels.observation(h, H, at, u, M, ML, L)
        return h.copy()

    k1 = rate(x)
    k2 = rate(x + 0.5 * dt_s * k1)
    k3 = rate(x + 0.5 * dt_s * k2)
    middle = x + 0.5 * dt_s * k2
    after = x + dt_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(x + dt_s * k3))
    return after, (acceleration(x) + 4.0 * acceleration(middle) + acceleration(after)) / 6.0


def fly(seed, integrator, estimator=NOISE):
    """One run: NEES of the swing, NEES of the whole state (both once a second), NIS of each step."""
    rng = np.random.default_rng(seed)
    parameters = dataclasses.replace(
        Parameters(),
        vehicle=Vehicle(M),
        payload=Payload(ML),
        # The filter of the equations alone: what it learns from coherence is not in its covariance.
        estimator=dataclasses.replace(estimator, integrator=integrator, relearn_rad=0.0),
    )
    ekf = SwingEkf(parameters)
    start = np.diag(ekf.estimate().P)
    Q = np.array([ANGLE_NOISE_VAR] * 2 + [NOISE.swing_rate_noise**2] * 2 + [(NOISE.force_noise * M) ** 2] * 3)
    R = np.array([NOISE.acc_noise**2] * 2 + [NOISE.acc_noise_vertical**2])
    x = rng.normal(size=7) * np.sqrt(start)
    nees_swing, nees, nis = [], [], []
    fine_s = DT_S / FINE
    for k in range(round(DURATION_S / DT_S)):
        t = k * DT_S
        # A vehicle that is pushed about keeps the swing going and the model nonlinear.
        u = np.array([2.0 * math.sin(1.3 * t), 1.5 * math.cos(0.9 * t), -(M + ML) * GRAVITY_MPS2])
        acc = np.zeros(3)
        for _ in range(FINE):
            x, mean = truth_step(x, u, fine_s)
            x += rng.normal(size=7) * np.sqrt(Q * fine_s)
            acc += mean / FINE
        assert ekf.step(u, acc + rng.normal(size=3) * np.sqrt(R / DT_S), DT_S) is Status.OK
        estimate = ekf.estimate()
        nis.append(estimate.nis)
        if (k + 1) % 100 == 0:
            error = x - estimate.x
            nees.append(error @ np.linalg.solve(estimate.P, error))
            nees_swing.append(error[:4] @ np.linalg.solve(estimate.P[:4, :4], error[:4]))
    return nees_swing, nees, nis


def bounds(dof, count, probability=0.999):
    """Two-sided interval of the mean of ``count`` chi-square variables."""
    tail = 0.5 * (1.0 - probability)
    return chi2.ppf([tail, 1.0 - tail], dof * count) / count


@pytest.fixture(scope="module", params=[Integrator.BACKWARD_EULER, Integrator.IMPLICIT_MIDPOINT])
def runs(request):
    results = [fly(seed, request.param) for seed in range(RUNS)]
    return [np.array(series) for series in zip(*results, strict=True)]


def test_nees_of_the_swing(runs):
    low, high = bounds(4, RUNS)
    mean = runs[0].mean(axis=0)
    assert ((low < mean) & (mean < high)).all(), mean


def test_nees_of_the_whole_state(runs):
    low, high = bounds(7, RUNS)
    mean = runs[1].mean(axis=0)
    assert ((low < mean) & (mean < high)).all(), mean


def test_nis(runs):
    nis = runs[2]
    settled = nis[:, 100:]
    low, high = bounds(3, settled.size)
    assert low < settled.mean() < high, settled.mean()
    # Its whole distribution, not its mean alone.
    for probability in (0.5, 0.95, 0.99):
        share = (settled < chi2.ppf(probability, 3)).mean()
        assert share == pytest.approx(probability, abs=4.0 * math.sqrt(probability * (1 - probability) / settled.size))


def test_a_filter_that_trusts_too_much_fails_the_same_bounds():
    """The bounds can tell: a tenth of the accelerometer's density."""
    proud = dataclasses.replace(
        NOISE, acc_noise=0.1 * NOISE.acc_noise, acc_noise_vertical=0.1 * NOISE.acc_noise_vertical
    )
    results = [fly(seed, Integrator.BACKWARD_EULER, proud) for seed in range(4)]
    nees, nis = np.array([result[1] for result in results]), np.array([result[2] for result in results])
    assert nees.mean() > bounds(7, nees.size)[1]
    assert nis.mean() > bounds(3, nis.size)[1]
