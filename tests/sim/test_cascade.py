"""The loops by themselves."""

from math import hypot, pi, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.core.slung_plant import GRAVITY
from swingd.sim.cascade import (
    AttitudeControl,
    HoverThrust,
    PositionControl,
    RateControl,
    TrajectorySetpoint,
    attitude_from_thrust,
    mix,
    yaw_of,
)
from swingd.sim.plant import rotation_matrix
from swingd.sim.px4_parameters import DEFAULTS, Px4Parameters

ZERO = (0.0, 0.0, 0.0)
REST = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
unit = st.floats(-1.0, 1.0)


def position_control(**changes: float) -> PositionControl:
    control = PositionControl(Px4Parameters(changes))
    control.tilt_max_rad = radians(45.0)
    return control


@given(thrust=st.floats(0.0, 1.0), roll=unit, pitch=unit, yaw=unit)
def test_the_mixer_stays_within_the_motors(thrust: float, roll: float, pitch: float, yaw: float) -> None:
    rotors, saturated = mix(thrust, (roll, pitch, yaw))
    assert all(0.0 <= rotor <= 1.0 for rotor in rotors)
    # Without airmode attitude never adds thrust.
    assert sum(rotors) <= 4.0 * thrust + 1e-9
    assert all(
        sign in (0, (value > 0.0) - (value < 0.0)) for sign, value in zip(saturated, (roll, pitch, yaw), strict=True)
    )


@given(thrust=st.floats(0.4, 0.6), roll=st.floats(-0.1, 0.1), pitch=st.floats(-0.1, 0.1), yaw=st.floats(-0.1, 0.1))
def test_the_mixer_gives_what_is_asked_for_inside_the_limits(
    thrust: float, roll: float, pitch: float, yaw: float
) -> None:
    rotors, saturated = mix(thrust, (roll, pitch, yaw))
    front_right, rear_left, front_left, rear_right = rotors
    half = np.sqrt(0.5)
    assert np.mean(rotors) == pytest.approx(thrust)
    assert (rear_left + front_left - front_right - rear_right) / (4.0 * half) == pytest.approx(roll, abs=1e-12)
    assert (front_right + front_left - rear_left - rear_right) / (4.0 * half) == pytest.approx(pitch, abs=1e-12)
    assert (front_right + rear_left - front_left - rear_right) / 4.0 == pytest.approx(yaw, abs=1e-12)
    assert saturated == (0, 0, 0)


@given(n=unit, e=unit, yaw=st.floats(-3.1, 3.1))
def test_attitude_points_up_along_the_thrust_and_ahead_along_the_yaw(n: float, e: float, yaw: float) -> None:
    thrust = (n, e, -1.0)
    q = attitude_from_thrust(thrust, yaw)
    assert np.linalg.norm(q) == pytest.approx(1.0)
    rows = np.array(rotation_matrix(*q))
    assert -rows[:, 2] == pytest.approx(np.array(thrust) / np.linalg.norm(thrust))
    assert np.cos(yaw_of(q) - yaw) == pytest.approx(1.0, abs=1e-9) or hypot(n, e) > 0.0
    # The nose stays in the vertical plane of the yaw: no component to the right of it.
    assert rows[:, 0] @ np.array([-np.sin(yaw), np.cos(yaw), 0.0]) == pytest.approx(0.0, abs=1e-9)


def test_acceleration_setpoint_is_added_after_the_velocity_pid() -> None:
    plain, fed = position_control(), position_control()
    state = (ZERO, (0.5, 0.0, 0.0), (0.1, 0.0, 0.0))
    setpoint = TrajectorySetpoint(vel_ned_mps=(1.0, 0.0, 0.0))
    assert plain.update(0.01, *state, setpoint)
    assert plain.acc_sp[0] == pytest.approx(1.8 * 0.5 - 0.2 * 0.1)
    fed_setpoint = TrajectorySetpoint(vel_ned_mps=(1.0, 0.0, 0.0), acc_ned_mps2=(0.7, 0.0, None))
    assert fed.update(0.01, *state, fed_setpoint)
    assert fed.acc_sp[0] == pytest.approx(plain.acc_sp[0] + 0.7)
    # Small tilt: the thrust's direction gives the acceleration.
    assert -fed.thrust_sp[0] / fed.thrust_sp[2] * GRAVITY == pytest.approx(fed.acc_sp[0])


def test_position_and_velocity_add_up_with_priority_to_the_position() -> None:
    control = position_control(MPC_XY_VEL_MAX=5.0)
    setpoint = TrajectorySetpoint(pos_ned_m=(2.0, 0.0, -1.0), vel_ned_mps=(1.0, 0.0, 0.0))
    assert control.update(0.01, *REST, setpoint)
    assert control.vel_sp == pytest.approx((0.95 * 2.0 + 1.0, 0.0, -1.0))
    far = TrajectorySetpoint(pos_ned_m=(4.0, 0.0, 0.0), vel_ned_mps=(0.0, 50.0, 0.0))
    assert control.update(0.01, *REST, far)
    north, east, _ = control.vel_sp
    assert north == pytest.approx(3.8)
    assert hypot(north or 0.0, east or 0.0) == pytest.approx(5.0)


@given(
    p=st.tuples(unit, unit),
    v=st.tuples(st.floats(-30, 30), st.floats(-30, 30)),
    limit=st.floats(0.5, 12.0),
)
def test_the_horizontal_speed_is_limited(p: tuple[float, float], v: tuple[float, float], limit: float) -> None:
    control = position_control(MPC_XY_VEL_MAX=limit)
    setpoint = TrajectorySetpoint(pos_ned_m=(20 * p[0], 20 * p[1], 0.0), vel_ned_mps=(v[0], v[1], 0.0))
    assert control.update(0.01, *REST, setpoint)
    assert hypot(control.vel_sp[0] or 0.0, control.vel_sp[1] or 0.0) <= limit * (1.0 + 1e-9)


@given(acc=st.tuples(st.floats(-40, 40), st.floats(-40, 40), st.floats(-20, 20)))
def test_thrust_respects_tilt_size_and_the_vertical_first(acc: tuple[float, float, float]) -> None:
    control = position_control()
    assert control.update(0.01, *REST, TrajectorySetpoint(acc_ned_mps2=acc))
    n, e, d = control.thrust_sp
    assert np.linalg.norm((n, e, d)) <= 1.0 + 1e-9
    assert d < 0.0
    assert hypot(n, e) <= -d * np.tan(radians(45.0)) * (1.0 + 1e-6)


def test_integrators_do_not_wind_up_while_the_tilt_is_saturated() -> None:
    control = position_control()
    setpoint = TrajectorySetpoint(vel_ned_mps=(12.0, 0.0, 0.0))
    for _ in range(2000):
        control.update(0.01, *REST, setpoint)
    assert abs(control._integral[0]) < 12.0
    # It leaves the saturation as soon as the error changes its sign.
    control.update(0.01, ZERO, (13.0, 0.0, 0.0), ZERO, setpoint)
    assert control.acc_sp[0] < GRAVITY


def test_hover_thrust_changes_without_a_step_of_thrust() -> None:
    control = position_control()
    setpoint = TrajectorySetpoint(vel_ned_mps=(0.0, 0.0, -0.2))
    control.update(0.01, *REST, setpoint)
    before = control.thrust_sp[2]
    control.update_hover_thrust(0.6)
    control.update(0.01, *REST, setpoint)
    assert control.thrust_sp[2] == pytest.approx(before, abs=0.01)


@pytest.mark.parametrize(
    "setpoint",
    [
        TrajectorySetpoint(),
        TrajectorySetpoint(vel_ned_mps=(1.0, None, 0.0)),
        TrajectorySetpoint(vel_ned_mps=(1.0, 0.0, None)),
        TrajectorySetpoint(pos_ned_m=(None, 1.0, 0.0), vel_ned_mps=(0.0, 0.0, 0.0)),
    ],
)
def test_setpoints_that_leave_an_axis_open_or_split_a_pair_are_refused(setpoint: TrajectorySetpoint) -> None:
    assert not position_control().update(0.01, *REST, setpoint)


@pytest.mark.parametrize("angle", [0.05, -0.3])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_attitude_control_turns_the_short_way(axis: int, angle: float) -> None:
    control = AttitudeControl(Px4Parameters())
    q_sp = [np.cos(angle / 2), 0.0, 0.0, 0.0]
    q_sp[1 + axis] = np.sin(angle / 2)
    rates = control.update((1.0, 0.0, 0.0, 0.0), (q_sp[0], q_sp[1], q_sp[2], q_sp[3]), 0.0)
    gain = (6.5, 6.5, 2.8)[axis]
    assert rates[axis] == pytest.approx(gain * angle, rel=0.02)
    assert max(abs(rates[i]) for i in range(3) if i != axis) < 1e-9
    opposite = control.update((1.0, 0.0, 0.0, 0.0), (-q_sp[0], -q_sp[1], -q_sp[2], -q_sp[3]), 0.0)
    assert opposite == pytest.approx(rates)


def test_attitude_control_survives_upside_down() -> None:
    rates = AttitudeControl(Px4Parameters()).update((0.0, 1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0)
    assert np.isfinite(rates).all()
    assert hypot(rates[0], rates[1]) > 1.0


def test_rate_control_scales_with_the_vehicle_and_stops_integrating_on_the_ground() -> None:
    px4 = Px4Parameters()
    light = RateControl(px4, (148.0, 148.0, 51.0), 250.0)
    heavy = RateControl(px4, (74.0, 74.0, 25.5), 250.0)
    for _ in range(100):
        a = light.update(0.004, ZERO, (0.5, 0.0, 0.0), landed=True)
        b = heavy.update(0.004, ZERO, (0.5, 0.0, 0.0), landed=True)
    assert a[0] == pytest.approx(0.15 * 0.5)
    assert b[0] == pytest.approx(2.0 * a[0])
    for _ in range(100):
        c = light.update(0.004, ZERO, (0.5, 0.0, 0.0), landed=False)
    assert c[0] == pytest.approx(0.15 * 0.5 + 0.2 * 0.5 * 0.4, rel=0.02)
    light.saturated = (1, 0, 0)
    c = light.update(0.004, ZERO, (0.5, 0.0, 0.0), landed=False)
    assert light.update(0.004, ZERO, (0.5, 0.0, 0.0), landed=False)[0] == pytest.approx(c[0], rel=1e-9)


def test_hover_thrust_is_learnt_from_the_vertical_acceleration() -> None:
    px4 = Px4Parameters()
    estimator = HoverThrust(px4)
    random = np.random.default_rng(5)
    true = 0.62
    for i in range(6000):
        thrust = 0.6 + 0.05 * np.sin(2.0 * pi * 0.3 * i * 0.008)
        acc_up = GRAVITY * (thrust / true - 1.0) + 0.3 * random.standard_normal()
        estimator.update(0.008, acc_up, thrust)
    assert estimator.valid
    assert estimator.value == pytest.approx(true, abs=0.01)


def test_parameters_keep_their_type_and_refuse_what_is_not_finite() -> None:
    px4 = Px4Parameters({"COM_OBL_RC_ACT": 5.0})
    assert isinstance(px4["COM_OBL_RC_ACT"], int)
    assert not px4.set("COM_OF_LOSS_T", float("nan"))
    assert px4["COM_OF_LOSS_T"] == DEFAULTS["COM_OF_LOSS_T"]
    assert not px4.set("NOT_A_PARAMETER", 1.0)
    with pytest.raises(KeyError, match="NOT_A_PARAMETER"):
        Px4Parameters({"NOT_A_PARAMETER": 1.0})
