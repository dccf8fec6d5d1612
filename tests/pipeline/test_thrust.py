"""Thrust from throttle, motors and voltage; its slow calibration."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import Battery, Motors, Throttle
from swingd.model.parameters import Parameters, Thrust, ThrustSource
from swingd.pipeline.thrust import FRESH_S, ScaleCalibration, ThrustModel

ZERO = (0.0, 0.0, 0.0)
CURVE = Thrust(quadratic_n=30.0, linear_n=6.0, offset_n=0.3, throttle_delay_s=0.0, motors_delay_s=0.0)
QUICK = replace(CURVE, motor_time_constant_s=0.0)


def model(thrust: Thrust = QUICK) -> ThrustModel:
    return ThrustModel(Parameters(thrust=thrust))


def curve_n(x: float) -> float:
    return 30.0 * x * x + 6.0 * x + 0.3


def thrust_n(thrust: ThrustModel, t_s: float, scale: float = 1.0) -> float:
    return thrust.read(t_s, scale, ZERO, ZERO).thrust_n


@pytest.mark.parametrize("throttle", [0.0, 0.25, 0.6, 1.0])
@pytest.mark.parametrize("scale", [0.8, 1.0, 1.2])
def test_the_curve(throttle: float, scale: float) -> None:
    thrust = model()
    thrust.add_throttle(Throttle(0.0, 1.0, throttle))
    reading = thrust.read(1.0, scale, ZERO, ZERO)
    assert reading.source is ThrustSource.THROTTLE
    assert reading.curve_n == pytest.approx(curve_n(throttle))
    assert reading.thrust_n == pytest.approx(scale * curve_n(throttle))


def test_motors_are_summed_after_the_curve() -> None:
    thrust = model()
    thrust.add_motors(Motors(0.0, 1.0, (0.2, 0.8, 0.5, 0.5)))
    expected_n = (curve_n(0.2) + curve_n(0.8) + 2.0 * curve_n(0.5)) / 4.0
    assert thrust_n(thrust, 1.0) == pytest.approx(expected_n)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_the_voltage_enters_with_its_exponent(exponent: float) -> None:
    thrust = model(replace(QUICK, voltage_exponent=exponent))
    thrust.add_throttle(Throttle(0.0, 1.0, 0.6))
    assert thrust_n(thrust, 1.0) == pytest.approx(curve_n(0.6)), "nominal before the first reading"
    thrust.add_battery(Battery(0.0, 14.0))
    assert thrust_n(thrust, 1.0) == pytest.approx(curve_n(0.6) * (14.0 / 16.2) ** exponent)


def test_the_voltage_is_low_passed() -> None:
    thrust = model(replace(QUICK, voltage_time_constant_s=0.5))
    thrust.add_battery(Battery(0.0, 16.0))
    for k in range(1, 11):
        thrust.add_battery(Battery(0.05 * k, 14.0))
    assert thrust.voltage_v == pytest.approx(14.0 + 2.0 * math.exp(-1.0))


@pytest.mark.parametrize("voltage_v", [0.0, 5.9, 61.0, 655.35, -1.0, math.inf, math.nan])
def test_implausible_voltages_are_refused(voltage_v: float) -> None:
    thrust = model()
    assert thrust.add_battery(Battery(0.0, 15.0))
    assert not thrust.add_battery(Battery(1.0, voltage_v))
    assert thrust.voltage_v == 15.0


def test_a_voltage_that_jumps_by_more_than_a_third_is_taken_once_it_stays() -> None:
    thrust = model(replace(QUICK, voltage_time_constant_s=0.5))
    assert thrust.add_battery(Battery(0.0, 15.0))
    taken_s = [0.1 * k for k in range(1, 130) if thrust.add_battery(Battery(0.1 * k, 30.0))]
    assert taken_s[0] == pytest.approx(10.1, abs=0.11)
    assert thrust.voltage_v == 30.0
    thrust = model(replace(QUICK, voltage_time_constant_s=0.5))
    thrust.add_battery(Battery(0.0, 15.0))
    assert not thrust.add_battery(Battery(9.0, 8.0))
    assert thrust.add_battery(Battery(9.1, 12.0)), "a sag under load"
    assert not thrust.add_battery(Battery(18.0, 8.0))
    assert not thrust.add_battery(Battery(19.5, 8.0)), "counted from the last good one on"


@pytest.mark.parametrize("tau_s", [0.02, 0.1])
def test_the_lag_is_the_exact_exponential(tau_s: float) -> None:
    thrust = model(replace(CURVE, motor_time_constant_s=tau_s))
    commands = [(0.0, 0.3), (0.013, 0.9), (0.025, 0.5), (0.060, 0.7)]
    x, x_t_s, command = 0.3, 0.0, 0.3
    for t_s, commanded in commands:
        thrust.add_throttle(Throttle(0.0, t_s, commanded))
        x = command + (x - command) * math.exp(-(t_s - x_t_s) / tau_s)
        x_t_s, command = t_s, commanded
        for ahead_s in (0.0, 0.004, 0.01):
            turning = command + (x - command) * math.exp(-ahead_s / tau_s)
            assert thrust_n(thrust, t_s + ahead_s) == pytest.approx(curve_n(turning), rel=1e-12)


def test_a_delay_shifts_the_thrust() -> None:
    prompt = model(replace(CURVE, motor_time_constant_s=0.05))
    delayed = model(replace(CURVE, motor_time_constant_s=0.05, throttle_delay_s=0.03))
    for thrust in (prompt, delayed):
        thrust.add_throttle(Throttle(0.0, 1.0, 0.2))
        thrust.add_throttle(Throttle(0.0, 1.01, 0.8))
    assert thrust_n(delayed, 1.06) == pytest.approx(thrust_n(prompt, 1.03))
    assert thrust_n(delayed, 1.06) < thrust_n(prompt, 1.06)


def test_motors_are_preferred_while_they_are_fresh() -> None:
    thrust = model()
    thrust.add_throttle(Throttle(0.0, 1.0, 0.9))
    thrust.add_motors(Motors(0.0, 1.0, (0.5,) * 4))
    assert thrust.read(1.0, 1.0, ZERO, ZERO).source is ThrustSource.MOTORS
    later_s = 1.0 + FRESH_S + 0.01
    assert thrust.source(later_s) is ThrustSource.REMARK_1
    thrust.add_throttle(Throttle(0.0, later_s, 0.9))
    assert thrust.source(later_s) is ThrustSource.THROTTLE
    assert thrust_n(thrust, later_s) == pytest.approx(curve_n(0.9))


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        (ThrustSource.AUTO, ThrustSource.MOTORS),
        (ThrustSource.MOTORS, ThrustSource.MOTORS),
        (ThrustSource.THROTTLE, ThrustSource.THROTTLE),
        (ThrustSource.REMARK_1, ThrustSource.REMARK_1),
    ],
)
def test_the_configuration_chooses_the_source(wanted: ThrustSource, expected: ThrustSource) -> None:
    thrust = model(replace(QUICK, source=wanted))
    thrust.add_throttle(Throttle(0.0, 1.0, 0.5))
    thrust.add_motors(Motors(0.0, 1.0, (0.5,) * 4))
    assert thrust.source(1.0) is expected


def test_remark_1_gives_the_weight_in_hover_and_the_tilt_of_a_push() -> None:
    thrust = model()
    weight_n = 2.3 * GRAVITY_MPS2
    assert thrust.read(0.0, 1.3, ZERO, ZERO).thrust_n == pytest.approx(weight_n), "no scale enters"
    pushed = thrust.read(0.0, 1.0, (1.5, 0.0, 0.0), (0.0, 2.0, 0.0))
    assert pushed.thrust_n == pytest.approx(math.hypot(2.0 * 1.5, 2.0, weight_n))
    assert pushed.curve_n == 0.0


def test_a_clock_reset_forgets_the_streams() -> None:
    thrust = model()
    thrust.add_motors(Motors(0.0, 100.0, (0.5,) * 4))
    thrust.add_throttle(Throttle(0.0, 100.0, 0.5))
    thrust.reset_clock()
    assert thrust.source(1.0) is ThrustSource.REMARK_1
    thrust.add_motors(Motors(0.0, 1.0, ()))
    assert thrust.source(1.0) is ThrustSource.REMARK_1, "no outputs are no source"


@given(
    st.lists(st.tuples(st.floats(0.0, 0.5), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8)), max_size=30),
    st.floats(-50.0, 60.0),
    st.floats(-30.0, 30.0),
)
def test_any_outputs_give_a_thrust_between_those_of_the_curve(
    outputs: list[tuple[float, list[float]]], quadratic_n: float, linear_n: float
) -> None:
    thrust = model(replace(CURVE, quadratic_n=quadratic_n, linear_n=linear_n))
    t_s = 0.0
    for step_s, values in outputs:
        t_s += step_s
        thrust.add_motors(Motors(0.0, t_s, tuple(values)))
        reading_n = thrust_n(thrust, t_s + 0.01)
        assert 0.0 <= reading_n <= abs(quadratic_n) + abs(linear_n) + 0.3 + 1e-9


# ---- calibration

WEIGHT_N = 2.3 * GRAVITY_MPS2
DT_S = 0.01
RATE_PER_S = 0.005


def hover(
    calibration: ScaleCalibration, duration_s: float, true_scale: float, *, quiet: bool = True, load: bool = True
) -> None:
    """Hover with a curve that is wrong by ``true_scale``, with the load or after its release."""
    weight_n = WEIGHT_N if load else 2.0 * GRAVITY_MPS2
    for _ in range(round(duration_s / DT_S)):
        before = calibration.scale
        calibration.update(DT_S, weight_n / true_scale, 1.0, 0.0, quiet)
        assert abs(calibration.scale - before) <= RATE_PER_S * DT_S + 1e-12


@pytest.mark.parametrize("true_scale", [0.85, 1.0, 1.12])
def test_a_wrong_curve_is_found_slowly(true_scale: float) -> None:
    calibration = ScaleCalibration(Parameters())
    error = abs(true_scale - 1.0)
    hover(calibration, 0.5 * error / RATE_PER_S, true_scale)
    assert abs(calibration.scale - 1.0) <= 0.5 * error + 1e-9
    hover(calibration, 0.5 * error / RATE_PER_S + 10.0, true_scale)
    assert calibration.scale == pytest.approx(true_scale, abs=0.003)
    assert not calibration.frozen


@pytest.mark.parametrize(("true_scale", "bound"), [(0.4, 0.75), (1.9, 1.25)])
def test_the_scale_stays_in_its_range(true_scale: float, bound: float) -> None:
    calibration = ScaleCalibration(Parameters())
    hover(calibration, 120.0, true_scale)
    assert calibration.scale == pytest.approx(bound, abs=1e-9)


def test_nothing_moves_outside_of_quiet_hover() -> None:
    calibration = ScaleCalibration(Parameters())
    hover(calibration, 60.0, 1.2, quiet=False)
    for _ in range(6000):
        calibration.update(DT_S, 0.1 * WEIGHT_N, 1.0, 0.0, True)
    assert calibration.scale == 1.0
    for _ in range(60):
        hover(calibration, 0.9, 1.2)
        hover(calibration, 0.1, 1.2, quiet=False)
    assert calibration.scale == 1.0, "a short rest is no hover"


def test_the_vertical_acceleration_and_the_tilt_are_accounted_for() -> None:
    calibration = ScaleCalibration(Parameters())
    for _ in range(1000):
        calibration.update(DT_S, 2.3 * (GRAVITY_MPS2 + 0.3) / 0.99, 0.99, -0.3, True)
    assert calibration.scale == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("disturbed_s", [0.0, 0.15, 1.5])
@pytest.mark.parametrize("true_scale", [0.95, 1.0, 1.1])
def test_a_release_freezes_it_before_it_is_swallowed(disturbed_s: float, true_scale: float) -> None:
    """The load is 15 % of the vehicle's weight; quiet may or may not end when it falls."""
    calibration = ScaleCalibration(Parameters())
    hover(calibration, 60.0, true_scale)
    before = calibration.scale
    hover(calibration, disturbed_s, true_scale, quiet=False)
    hover(calibration, 60.0, true_scale, load=False)
    assert calibration.frozen
    assert abs(calibration.scale - before) < 0.01
    calibration.restart()
    hover(calibration, 30.0, true_scale)
    assert not calibration.frozen
    assert calibration.scale == pytest.approx(true_scale, abs=0.01)


@pytest.mark.parametrize("duration_s", [60.0, 100.0, 300.0])
def test_a_slow_error_of_the_voltage_curve_is_followed(duration_s: float) -> None:
    calibration = ScaleCalibration(Parameters())
    hover(calibration, 10.0, 1.0)
    steps = round(duration_s)
    for k in range(steps):
        true_scale = 1.0 - 0.2 * (k + 1) / steps
        hover(calibration, 1.0, true_scale)
        assert not calibration.frozen
        assert calibration.scale == pytest.approx(true_scale, abs=0.02)


@given(
    st.lists(
        st.tuples(st.floats(0.0, 100.0), st.floats(-1.0, 1.0), st.floats(-30.0, 30.0), st.booleans(), st.booleans()),
        max_size=60,
    )
)
def test_whatever_comes_the_scale_is_slow_and_bounded(inputs: list[tuple[float, float, float, bool, bool]]) -> None:
    calibration = ScaleCalibration(Parameters())
    for curve, up_share, acc_down, quiet, restart in inputs:
        if restart:
            calibration.restart()
        for _ in range(150):
            before, frozen = calibration.scale, calibration.frozen
            calibration.update(DT_S, curve, up_share, acc_down, quiet)
            assert abs(calibration.scale - before) <= RATE_PER_S * DT_S + 1e-12
            assert 0.75 <= calibration.scale <= 1.25
            assert calibration.frozen >= frozen, "only a restart thaws"
            if frozen or not quiet:
                assert calibration.scale == before
