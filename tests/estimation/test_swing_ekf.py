"""The swing EKF as an object: tracking, sub-steps, gaps, gate, resets, bad inputs."""

import dataclasses
import math

import numpy as np
import pytest
from core.two_point_masses import model
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from swingd.core.level import filter_inputs
from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2, State
from swingd.estimation import Fgdf, Pendulum, SwingEkf, make_estimator
from swingd.estimation.base import INTERVAL_MAX_S
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Cable, Estimator, Integrator, Parameters, Payload, Vehicle

from .rig import DT_S, EXACT, HOVER, ML, STILL, L, M, faults, parameters


def at_rest(ekf):
    """Whether it has just begun anew."""
    estimate = ekf.estimate()
    return not estimate.x.any() and estimate.nis == 0.0


class Flight:
    """A rigid body with prescribed pitch and thrust, the load on its hook: the Lagrangian's motion at 100 Hz."""

    def __init__(self, hook_frd, pitch_rad, duration_s=8.0, swing=(0.3, -0.25)):
        self.hook_frd = np.array(hook_frd)
        self._pitch = pitch_rad
        # The step ends at k dt; its means are those of its middle, to second order in dt.
        self.times = np.arange(round(duration_s / DT_S)) * DT_S
        start = np.array([*swing, 0.0, 0.0])
        self.swing = solve_ivp(
            lambda t, y: np.concatenate([y[2:], self._accelerations(t, y)[3:]]),
            (0.0, duration_s),
            start,
            t_eval=np.concatenate([self.times, self.times + 0.5 * DT_S])[
                np.argsort(np.concatenate([self.times, self.times + 0.5 * DT_S]))
            ],
            method="DOP853",
            rtol=1e-9,
            atol=1e-10,
        ).y.T

    def attitude(self, t):
        """Pitch, its rate and acceleration [rad, rad/s, rad/s^2]."""
        h = 1e-4
        before, now, after = self._pitch(t - h), self._pitch(t), self._pitch(t + h)
        return now, (after - before) / (2.0 * h), (after - 2.0 * now + before) / h**2

    def _relative(self, t):
        """Acceleration of the hook relative to the centre, level frame."""
        pitch, rate, rate2 = self.attitude(t)
        gyro, gyro_rate = np.array([0.0, rate, 0.0]), np.array([0.0, rate2, 0.0])
        body = np.cross(gyro_rate, self.hook_frd) + np.cross(gyro, np.cross(gyro, self.hook_frd))
        return Rotation.from_euler("y", pitch).apply(body)

    def _force(self, t):
        return Rotation.from_euler("y", self.attitude(t)[0]).apply([0.0, 0.0, HOVER[2]])

    def _accelerations(self, t, swing):
        x = np.concatenate([swing, np.zeros(3)])
        return model().accelerations(x, self._force(t), M, ML, L, r_rate2=tuple(self._relative(t)))

    def inputs(self, hook_frd):
        """Acceleration and force of each step as a filter with this hook would compute them from an exact IMU."""
        for k, t in enumerate(self.times):
            middle = t + 0.5 * DT_S
            pitch, rate, rate2 = self.attitude(middle)
            R = np.ascontiguousarray(Rotation.from_euler("y", pitch).as_matrix())
            centre = self._accelerations(middle, self.swing[2 * k + 1])[:3] - self._relative(middle)
            z, u = np.empty(3), np.empty(3)
            specific = R.T @ (centre - [0.0, 0.0, GRAVITY_MPS2])
            gyro, gyro_rate = np.array([0.0, rate, 0.0]), np.array([0.0, rate2, 0.0])
            hook, zero = np.array(hook_frd), np.zeros(3)
            filter_inputs(z, u, specific, gyro, gyro_rate, R, zero, hook, zero, -HOVER[2], M, 0.0, 0.0, GRAVITY_MPS2)
            yield z, u

    def rmse_deg(self, hook_frd, from_s=4.0):
        """Error of the swing angles after settling, without the numerical damping of backward Euler."""
        ekf = SwingEkf(parameters(integrator=Integrator.IMPLICIT_MIDPOINT))
        errors = []
        for k, (z, u) in enumerate(self.inputs(hook_frd)):
            assert ekf.step(u, z, DT_S) in (Status.OK, Status.GATED)
            if self.times[k] > from_s and 2 * k + 2 < len(self.swing):
                errors.append(ekf.estimate().x[:2] - self.swing[2 * k + 2, :2])
        return float(np.degrees(np.sqrt(np.mean(np.square(errors)))))


def pitching(t):
    """What a vehicle does that answers the swing and is shaken besides [rad]."""
    return 0.15 * math.sin(2.0 * t) + 0.03 * math.sin(11.0 * t)


HOOK = (0.0, 0.0, 0.2)


@pytest.fixture(scope="module")
def flight_off_centre():
    return Flight(HOOK, pitching)


def test_exact_inputs_give_the_swing():
    """GIVEN a swing unknown to the filter WHEN it sees exact inputs THEN it finds the angles."""
    assert Flight((0.0, 0.0, 0.0), pitching).rmse_deg((0.0, 0.0, 0.0)) < 0.15


def test_hook_off_the_centre_costs_nothing_where_it_is_known(flight_off_centre):
    known = flight_off_centre.rmse_deg(HOOK)
    at_centre = Flight((0.0, 0.0, 0.0), pitching).rmse_deg((0.0, 0.0, 0.0))
    assert known < 1.2 * at_centre
    assert flight_off_centre.rmse_deg((0.0, 0.0, 0.0)) > 3.0 * known


@pytest.mark.parametrize("integrator", list(Integrator))
def test_every_integrator_tracks(integrator):
    flight = Flight((0.0, 0.0, 0.0), pitching, duration_s=4.0)
    ekf = SwingEkf(parameters(integrator=integrator))
    for z, u in flight.inputs((0.0, 0.0, 0.0)):
        assert ekf.step(u, z, DT_S) is Status.OK
    np.testing.assert_allclose(ekf.estimate().x[:2], flight.swing[-1, :2], atol=math.radians(1.5))


def test_signs_in_words():
    """GIVEN rest WHEN the vehicle accelerates forward and to the right THEN the load trails behind and to the left."""
    ekf = SwingEkf(parameters())
    f = np.array([3.0, 3.0, 0.0])
    swing = solve_ivp(
        lambda _t, y: model().dynamics(np.concatenate([y, np.zeros(3)]), HOVER + f, M, ML, L)[:4],
        (0.0, 1.0),
        np.zeros(4),
        t_eval=np.arange(100) * DT_S,
        rtol=1e-8,
    ).y.T
    for state in swing:
        acc = model().observation(np.concatenate([state, np.zeros(3)]), HOVER + f, M, ML, L)
        ekf.step(HOVER + f, acc, DT_S)
    x = ekf.estimate().x
    assert x[State.ZETA] < math.radians(-5.0)
    assert x[State.XI] > math.radians(5.0)


def test_a_wind_on_the_vehicle_is_a_force_not_a_swing():
    """GIVEN a load that hangs still WHEN a steady force is missing in the inputs THEN it is found."""
    ekf = SwingEkf(parameters())
    wind = np.array([1.0, -0.7, 0.4])
    # The vehicle leans against the wind: what is known of the force is all but the wind.
    for _ in range(800):
        ekf.step(HOVER - wind, STILL, DT_S)
    estimate = ekf.estimate()
    np.testing.assert_allclose(estimate.x[State.FORCE_X :], wind, atol=0.02)
    np.testing.assert_allclose(estimate.x[:2], 0.0, atol=math.radians(0.5))
    assert estimate.tension_n == pytest.approx(ML * GRAVITY_MPS2, rel=0.02)


def test_estimate_rate_is_the_models():
    ekf = SwingEkf(parameters())
    ekf.step(HOVER + np.array([2.0, 1.0, 0.0]), np.array([0.4, 0.2, 0.1]), DT_S)
    estimate = ekf.estimate()
    expected = model().dynamics(estimate.x, HOVER + np.array([2.0, 1.0, 0.0]), M, ML, L)[:4]
    np.testing.assert_allclose(estimate.x_rate, expected, rtol=1e-9, atol=1e-12)


def test_estimate_is_a_copy():
    ekf = SwingEkf(parameters())
    before = ekf.estimate()
    x, P = before.x.copy(), before.P.copy()
    ekf.step(HOVER + np.array([2.0, 1.0, 0.0]), STILL, DT_S)
    np.testing.assert_array_equal(before.x, x)
    np.testing.assert_array_equal(before.P, P)


def test_an_interval_is_divided_at_max_step():
    """A long interval is as many steps of max_step, and the same as a filter fed step by step."""
    whole, parts = (SwingEkf(parameters(max_step_s=step_s, **EXACT)) for step_s in (0.0025, 0.1))
    force, acc = HOVER + np.array([2.0, -1.0, 0.5]), np.array([0.6, -0.4, 0.2])
    whole.step(force, acc, 0.01)
    for _ in range(4):
        parts.step(force, acc, 0.0025)
    np.testing.assert_allclose(whole.estimate().x, parts.estimate().x, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(whole.estimate().P, parts.estimate().P, rtol=1e-12, atol=1e-14)


def test_nis_of_an_interval_does_not_depend_on_its_division():
    values = []
    for max_step_s in (0.0005, 0.0025, 0.01, 0.1):
        ekf = SwingEkf(parameters(max_step_s=max_step_s))
        ekf.step(HOVER + np.array([2.0, -1.0, 0.5]), np.array([0.6, -0.4, 0.2]), DT_S)
        values.append(ekf.estimate().nis)
    np.testing.assert_allclose(values, values[0], rtol=1e-12)
    assert values[0] > 0.1


def test_numerical_damping_follows_max_step():
    """omega^2 step / 2 of the filter's own step, whatever the interval."""
    omega2 = GRAVITY_MPS2 / L * (M + ML) / M
    for max_step_s in (0.0025, 0.01):
        ekf = SwingEkf(parameters(max_step_s=max_step_s))
        # A push sets the swing going; then it is left alone.
        ekf.coast(HOVER + np.array([0.5, 0.0, 0.0]), 0.3)
        amplitudes = []
        for _ in range(2):
            x = ekf.estimate().x
            amplitudes.append(math.hypot(x[State.ZETA], x[State.ZETA_RATE] / math.sqrt(omega2)))
            ekf.coast(HOVER, 1.0)
        assert -math.log(amplitudes[1] / amplitudes[0]) == pytest.approx(0.5 * omega2 * max_step_s, rel=0.03)


def test_coasting_is_the_prediction():
    """Without measurement the state follows f, the covariance grows, and there is no innovation."""
    ekf = SwingEkf(parameters(integrator=Integrator.RK4))
    force = HOVER + np.array([1.0, -0.5, 0.2])
    before = ekf.estimate().P
    ekf.step(force, STILL, DT_S)
    assert ekf.estimate().nis > 0.0
    start = ekf.estimate().x
    ekf.coast(force, 0.2)
    exact = solve_ivp(lambda _t, y: model().dynamics(y, force, M, ML, L), (0.0, 0.2), start, rtol=1e-10, atol=1e-12)
    estimate = ekf.estimate()
    np.testing.assert_allclose(estimate.x, exact.y[:, -1], rtol=1e-7, atol=1e-9)
    assert estimate.nis == 0.0
    assert estimate.P[State.FORCE_X, State.FORCE_X] < before[State.FORCE_X, State.FORCE_X] * 1.05
    ekf.coast(force, 0.2)
    assert (np.diag(ekf.estimate().P)[4:] > np.diag(estimate.P)[4:]).all()
    assert not faults(ekf)


def test_a_gated_measurement_is_left_out():
    one, other = (SwingEkf(parameters(nis_gate=20.0)) for _ in range(2))
    for ekf in (one, other):
        for _ in range(100):
            assert ekf.step(HOVER, STILL, DT_S) is Status.OK
    before = one.estimate().P
    assert one.step(HOVER, np.array([60.0, 0.0, 0.0]), DT_S) is Status.GATED
    assert other.step(HOVER, np.array([0.0, -90.0, 20.0]), DT_S) is Status.GATED
    np.testing.assert_array_equal(one.estimate().x, other.estimate().x)
    np.testing.assert_array_equal(one.estimate().P, other.estimate().P)
    assert (np.diag(one.estimate().P)[4:] > np.diag(before)[4:]).all()
    assert one.estimate().nis > 20.0


def test_reset_by_angle():
    """A force that tips the cable past the horizontal, by a filter that is sure of it: no hanging load does that."""
    ekf = SwingEkf(parameters(swing_std_init_rad=0.01, swing_rate_std_init_radps=0.01, force_std_init=0.01))
    for _ in range(200):
        ekf.coast(HOVER + np.array([0.0, 40.0, 0.0]), DT_S)
        if faults(ekf):
            break
    assert faults(ekf) == {ResetReason.ANGLE: 1}
    assert at_rest(ekf)


def test_reset_by_covariance():
    """Coasting for long in calm air: the angles stay, but nothing is known of them."""
    ekf = SwingEkf(parameters(force_noise=5.0))
    for _ in range(1000):
        ekf.coast(HOVER, DT_S)
        if faults(ekf):
            break
    assert faults(ekf) == {ResetReason.COVARIANCE: 1}
    assert at_rest(ekf)


def test_reset_by_innovation_after_a_second_of_rejected_measurements():
    ekf = SwingEkf(parameters())
    for _ in range(200):
        ekf.step(HOVER, STILL, DT_S)
    answers = [ekf.step(HOVER, np.array([80.0, 0.0, 0.0]), DT_S) for _ in range(102)]
    first = answers.index(Status.NOT_CONVERGED)
    assert set(answers[:first]) == {Status.GATED}
    assert first * DT_S == pytest.approx(1.0, abs=2.0 * DT_S)
    assert faults(ekf) == {ResetReason.INNOVATION: 1}


def test_a_good_measurement_ends_the_count_of_rejected_ones():
    ekf = SwingEkf(parameters())
    for _ in range(200):
        ekf.step(HOVER, STILL, DT_S)
    for _ in range(5):
        for _ in range(50):
            assert ekf.step(HOVER, np.array([80.0, 0.0, 0.0]), DT_S) is Status.GATED
        assert ekf.step(HOVER, STILL, DT_S) is Status.OK
    assert not faults(ekf)


def test_reset_by_numerics():
    """A step that no division makes solvable."""
    ekf = SwingEkf(parameters())
    assert ekf.step(np.array([9e8, 9e8, 9e8]), STILL, DT_S) not in (Status.OK, Status.GATED, Status.INPUT_INVALID)
    assert faults(ekf) == {ResetReason.NUMERICS: 1}
    assert at_rest(ekf)
    for _ in range(10):
        assert ekf.step(HOVER, STILL, DT_S) is Status.OK
    assert np.isfinite(ekf.estimate().x_rate).all()


def test_reset_from_outside_counts_its_reason_and_takes_the_force():
    ekf = SwingEkf(parameters())
    start = ekf.estimate().P
    for _ in range(100):
        ekf.step(HOVER + np.array([2.0, 0.0, 0.0]), STILL, DT_S)
    ekf.reset(ResetReason.GAP)
    assert at_rest(ekf)
    np.testing.assert_array_equal(ekf.estimate().P, start)
    ekf.reset(ResetReason.LIFT, (1.0, -2.0, 0.0))
    np.testing.assert_array_equal(ekf.estimate().x, [0, 0, 0, 0, 1.0, -2.0, 0.0])
    P = ekf.estimate().P
    assert (np.diag(P)[4:6] < np.diag(start)[4:6]).all()
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert faults(ekf) == {ResetReason.GAP: 1, ResetReason.LIFT: 1}


BAD = [math.nan, math.inf, -math.inf, 1e12]


@pytest.mark.parametrize("make", [SwingEkf, Fgdf, Pendulum])
@pytest.mark.parametrize("bad", BAD)
def test_an_invalid_measurement_leaves_the_estimate(make, bad):
    estimator = make(parameters())
    estimator.step(HOVER + np.array([2.0, 1.0, 0.0]), np.array([0.4, 0.2, 0.1]), DT_S)
    before = estimator.estimate()
    assert estimator.step(HOVER, np.array([0.0, bad, 0.0]), DT_S) is Status.INPUT_INVALID
    for dt_s in (0.0, -DT_S, math.nan, math.inf, 2.0 * INTERVAL_MAX_S):
        assert estimator.step(HOVER, STILL, dt_s) is Status.INPUT_INVALID
        estimator.coast(HOVER, dt_s)
    after = estimator.estimate()
    for name in ("x", "x_rate", "P"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert not faults(estimator)


@pytest.mark.parametrize("bad", BAD)
def test_an_invalid_force_leaves_the_estimate(bad):
    ekf = SwingEkf(parameters())
    before = ekf.estimate()
    assert ekf.step(np.array([bad, 0.0, -15.0]), STILL, DT_S) is Status.INPUT_INVALID
    ekf.coast(np.array([bad, 0.0, -15.0]), DT_S)
    after = ekf.estimate()
    np.testing.assert_array_equal(after.x_rate, before.x_rate)
    assert after.tension_n == before.tension_n
    assert not faults(ekf)


ANY = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-1e3, 1e3)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    steps=st.lists(
        st.tuples(hnp.arrays(float, 3, elements=ANY), hnp.arrays(float, 3, elements=ANY), st.floats(-1.0, 0.2) | ANY),
        max_size=6,
    ),
    estimator=st.builds(
        Estimator,
        name=st.sampled_from(["swing_ekf", "fgdf", "pendulum"]),
        integrator=st.sampled_from(list(Integrator)),
        max_step_s=st.floats(0.01, 0.1),
        acc_noise=st.floats(1e-6, 100.0),
        force_noise=st.floats(1e-6, 100.0),
        swing_rate_noise=st.floats(1e-6, 100.0),
        nis_gate=st.floats(5.0, 1e4),
        fgdf_memory_s=st.floats(0.1, 1000.0),
        fgdf_angle_noise_rad=st.floats(1e-4, 3.0),
    ),
    masses=st.tuples(st.floats(0.05, 2000.0), st.floats(0.005, 2000.0)),
    length_m=st.floats(0.1, 200.0),
)
def test_no_input_and_no_parameter_raises_and_the_estimate_stays_finite(steps, estimator, masses, length_m):
    made = make_estimator(
        dataclasses.replace(
            Parameters(),
            vehicle=Vehicle(masses[0]),
            payload=Payload(masses[1]),
            cable=Cable(length_m),
            estimator=estimator,
        )
    )
    for force, acc, dt_s in steps:
        made.step(force, acc, dt_s)
        made.coast(force, dt_s)
        estimate = made.estimate()
        for array in (estimate.x, estimate.x_rate, estimate.P, estimate.nis, estimate.tension_n):
            assert np.isfinite(array).all()


def test_make_estimator_takes_the_name():
    assert isinstance(make_estimator(parameters(name="swing_ekf")), SwingEkf)
    assert isinstance(make_estimator(parameters(name="pendulum")), Pendulum)
