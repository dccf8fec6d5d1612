"""The fading filter as an object: tracking, its rate, the wind it cannot know, gate, resets."""

import math

import numpy as np
import pytest
from core.two_point_masses import model
from scipy.integrate import solve_ivp

from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.estimation import Fgdf, SwingEkf, make_estimator
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Estimator

from .rig import DT_S, HOVER, ML, STILL, L, M, faults, parameters


def pushed(t):
    """Thrust of a vehicle that leans to and fro."""
    return HOVER + np.array([0.8 * math.sin(1.7 * t), 0.6 * math.cos(1.3 * t), 0.3 * math.sin(2.1 * t)])


class Flight:
    """Two point masses under `pushed`: the swing at the ends of intervals, the acceleration in their middle."""

    def __init__(self, dt_s, duration_s=12.0, swing=(0.12, -0.1)):
        self.dt_s = dt_s
        self.ends = np.arange(1, round(duration_s / dt_s) + 1) * dt_s
        self._exact = solve_ivp(
            lambda t, y: model().dynamics(np.concatenate([y, np.zeros(3)]), pushed(t), M, ML, L)[:4],
            (0.0, duration_s),
            [*swing, 0.0, 0.0],
            rtol=1e-9,
            atol=1e-11,
            dense_output=True,
        ).sol

    def truth(self, t):
        return self._exact(t)

    def inputs(self, end_s):
        t = end_s - 0.5 * self.dt_s
        x = np.concatenate([self.truth(t), np.zeros(3)])
        return pushed(t), model().observation(x, pushed(t), M, ML, L)


@pytest.fixture(scope="module")
def flights():
    return {dt_s: Flight(dt_s) for dt_s in (0.004, 0.01)}


def test_it_finds_a_small_swing_that_was_not_announced_and_its_rates(flights):
    flight = flights[DT_S]
    fgdf = Fgdf(parameters())
    errors = []
    for end_s in flight.ends:
        assert fgdf.step(*flight.inputs(end_s), DT_S) is Status.OK
        errors.append(fgdf.estimate().x[:4] - flight.truth(end_s))
    true = np.array([flight.truth(t) for t in flight.ends])
    rms = np.sqrt(np.mean(np.square(errors)[len(errors) // 2 :], axis=0))
    assert (np.ptp(true, axis=0)[:2] > math.radians(10.0)).all()
    assert (rms[:2] < math.radians(0.25)).all(), np.degrees(rms)
    assert (rms[2:] < math.radians(0.7)).all(), np.degrees(rms)
    assert not faults(fgdf)


def test_the_estimate_belongs_to_the_end_of_the_interval():
    """Long intervals of a small free swing: a shift by half of one would show."""
    dt_s, amplitude = 0.08, 0.01
    omega = math.sqrt(GRAVITY_MPS2 / L * (M + ML) / M)
    fgdf = Fgdf(parameters())
    for k in range(1, 200):
        middle_s = (k - 0.5) * dt_s
        zeta = amplitude * math.cos(omega * middle_s)
        x = np.array([0.0, zeta, 0.0, -amplitude * omega * math.sin(omega * middle_s), 0.0, 0.0, 0.0])
        fgdf.step(HOVER, model().observation(x, HOVER, M, ML, L), dt_s)
    end_s = 199 * dt_s
    assert fgdf.estimate().x[[1, 3]] == pytest.approx(
        [amplitude * math.cos(omega * end_s), -amplitude * omega * math.sin(omega * end_s)], abs=2e-3 * amplitude
    )


def test_what_is_forgotten_does_not_depend_on_the_rate(flights):
    """Another fading factor at another rate: the same estimate, and an information that grows with the samples."""
    estimates = {}
    for dt_s, flight in flights.items():
        fgdf = Fgdf(parameters(rate_hz=1.0 / dt_s))
        for end_s in flight.ends:
            fgdf.step(*flight.inputs(end_s), dt_s)
        estimates[dt_s] = fgdf.estimate()
    fast, slow = estimates[0.004], estimates[0.01]
    assert fast.x == pytest.approx(slow.x, abs=2e-4)
    np.testing.assert_allclose(fast.P[:4, :4] / 0.004, slow.P[:4, :4] / 0.01, rtol=0.02, atol=0.02 * slow.P[3, 3])


@pytest.mark.parametrize("memory_s", [1.0, 4.0])
def test_a_longer_memory_weighs_measurements_less(memory_s):
    """A memory holds memory / dt samples, half of them tell the angle: 2 dt / memory of a sample's variance."""
    fgdf = Fgdf(parameters(fgdf_memory_s=memory_s, fgdf_angle_noise_rad=0.1))
    for _ in range(3000):
        fgdf.step(HOVER, STILL, DT_S)
    P = fgdf.estimate().P
    assert P[0, 0] == pytest.approx(2.0 * DT_S / memory_s * 0.1**2, rel=0.05)
    assert P[0, 0] == pytest.approx(P[1, 1])
    assert not P[4:].any()


def test_wind_on_the_vehicle_is_taken_for_the_load():
    """At rest, leaning into a headwind, over a load that hangs below: thrust feigns a little, the cable force much."""
    wind_n = 1.0
    u = HOVER + np.array([wind_n, 0.0, 0.0])
    fgdf, ekf = Fgdf(parameters()), SwingEkf(parameters())
    for _ in range(2000):
        fgdf.step(u, STILL, DT_S)
        ekf.step(u, STILL, DT_S)
    feigned = -fgdf.estimate().x[1]
    assert wind_n / ((M + ML) * GRAVITY_MPS2) < feigned < math.atan(wind_n / (ML * GRAVITY_MPS2))
    assert abs(ekf.estimate().x[1]) < 0.1 * feigned
    assert ekf.estimate().x[4] == pytest.approx(-wind_n, rel=0.05)
    assert not fgdf.estimate().x[4:].any()


def test_the_tension_is_that_of_the_cable(flights):
    flight = flights[DT_S]
    fgdf = Fgdf(parameters())
    assert fgdf.estimate().tension_n == pytest.approx(ML * GRAVITY_MPS2)
    for end_s in flight.ends[:800]:
        u, z = flight.inputs(end_s)
        fgdf.step(u, z, DT_S)
    tension_n = np.linalg.norm(M * z - [0.0, 0.0, M * GRAVITY_MPS2] - u)
    assert fgdf.estimate().tension_n == pytest.approx(tension_n, rel=1e-3)
    fgdf.reset(ResetReason.GAP)
    assert fgdf.estimate().tension_n == pytest.approx(ML * GRAVITY_MPS2)


def test_the_derivative_is_that_of_the_prediction(flights):
    fgdf = Fgdf(parameters())
    for end_s in flights[DT_S].ends[:300]:
        fgdf.step(*flights[DT_S].inputs(end_s), DT_S)
    before = fgdf.estimate()
    e = 1e-5
    fgdf.coast(pushed(flights[DT_S].ends[299] - 0.5 * DT_S), e)
    after = fgdf.estimate()
    np.testing.assert_allclose((after.x[:4] - before.x[:4]) / e, before.x_rate, atol=1e-4)
    assert after.nis == 0.0


def test_coasting_widens_the_covariance_until_nothing_is_known():
    fgdf = Fgdf(parameters())
    for _ in range(1000):
        fgdf.step(HOVER, STILL, DT_S)
    var = [fgdf.estimate().P[1, 1]]
    while not faults(fgdf):
        fgdf.coast(HOVER, 1.0)
        var.append(fgdf.estimate().P[1, 1])
        assert len(var) < 60
    assert faults(fgdf) == {ResetReason.COVARIANCE: 1}
    # Settled, the covariance is that of an oscillator of unknown phase: coasting only fades it.
    assert var[3] / var[0] == pytest.approx(math.exp(3.0 / Estimator().fgdf_memory_s), rel=0.1)


def side(force_n):
    """Acceleration of a hovering vehicle whose cable pulls with ``force_n`` to the right beside the load's weight."""
    return np.array([0.0, force_n / M, 0.0])


def test_a_wild_measurement_is_gated_and_too_many_begin_anew():
    fgdf = Fgdf(parameters(fgdf_angle_noise_rad=0.05))
    for _ in range(500):
        fgdf.step(HOVER, STILL, DT_S)
    assert fgdf.step(HOVER, side(4.0 * ML * GRAVITY_MPS2), DT_S) is Status.GATED
    assert fgdf.estimate().nis > Estimator().nis_gate
    assert not fgdf.estimate().x[:4].any()
    assert fgdf.step(HOVER, STILL, DT_S) is Status.OK
    answers = [fgdf.step(HOVER, side(4.0 * ML * GRAVITY_MPS2), DT_S) for _ in range(102)]
    assert answers[:99] == [Status.GATED] * 99
    assert Status.NOT_CONVERGED in answers[99:]
    assert faults(fgdf) == {ResetReason.INNOVATION: 1}


def test_no_cable_force_is_no_measurement():
    fgdf = Fgdf(parameters())
    falling = np.array([0.0, 0.0, GRAVITY_MPS2])
    assert fgdf.step(STILL, falling, DT_S) is Status.GATED
    assert fgdf.estimate().nis == 0.0
    assert fgdf.estimate().tension_n == 0.0


def test_a_swing_beyond_what_hangs_begins_anew():
    fgdf = Fgdf(parameters(fgdf_angle_noise_rad=3.0, swing_std_init_rad=1.0))
    u = HOVER + np.array([0.0, 40.0, 0.0])
    for _ in range(200):
        if fgdf.step(u, side(0.0), DT_S) is Status.NOT_CONVERGED:
            break
    assert faults(fgdf) == {ResetReason.ANGLE: 1}
    assert not fgdf.estimate().x.any()


def test_intervals_that_outlast_the_memory_by_far_begin_anew_instead_of_misleading():
    fgdf = Fgdf(parameters(fgdf_memory_s=0.1))
    assert fgdf.step(HOVER, side(0.1), 10.0) is Status.NOT_CONVERGED
    assert faults(fgdf) == {ResetReason.COVARIANCE: 1}
    assert fgdf.step(HOVER, STILL, DT_S) is Status.OK


def test_it_is_chosen_by_its_name():
    assert isinstance(make_estimator(parameters(name="fgdf")), Fgdf)
