"""PX4's reading of global and attitude setpoints, and what flies then."""

import itertools
from math import cos, degrees, hypot, isfinite, nan, radians, sin
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.sim.autopilot import NavState
from swingd.sim.geodesy import ALTITUDE_M, LATITUDE_DEG, LONGITUDE_DEG, global_of, local_of
from swingd.sim.px4 import attitude_setpoint_of, global_setpoint_of
from swingd.sim.telemetry import global_int

from .rigs import Application, iris

GLOBAL, RELATIVE, TERRAIN = (
    mavlink.MAV_FRAME_GLOBAL_INT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
)
PLACE = (12.0, -7.0, -20.0)


def global_message(mask: int, frame: int = GLOBAL, alt: float | None = None, **changes: float) -> Any:
    lat, lon, _ = global_int(PLACE)
    values = dict(zip(("vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), range(1, 9), strict=True))
    values = {name: float(value) for name, value in values.items()} | changes
    altitude = ALTITUDE_M - PLACE[2] if alt is None else alt
    return mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, frame, mask, lat, lon, altitude, *values.values()
    )


def attitude_message(
    mask: int = 0b111, q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0), thrust: float = 0.5,
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Any:  # fmt: skip
    return mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, *rates, thrust)


def pitched(angle: float) -> tuple[float, float, float, float]:
    return (cos(0.5 * angle), 0.0, sin(0.5 * angle), 0.0)


# --------------------------------------------------------------------- reading


def test_every_global_mask_drops_the_whole_position_but_single_axes_of_the_rest() -> None:
    for mask in range(512):
        setpoint = global_setpoint_of(global_message(mask), 0.0)
        pos = [None] * 3 if mask & 7 else list(PLACE)
        rest = [None if mask >> i & 1 else float(i - 2) for i in range(3, 9)]
        if all(value is None for value in pos + rest):
            assert setpoint is None
            continue
        assert setpoint is not None
        assert setpoint.pos_ned_m == (pytest.approx(PLACE, abs=0.01) if pos[0] is not None else (None, None, None))
        assert [*setpoint.vel_ned_mps, *setpoint.acc_ned_mps2] == rest
        assert (setpoint.yaw_rad, setpoint.yaw_rate_radps) == (7.0, 8.0)


def test_altitudes_count_from_the_sea_or_from_home() -> None:
    absolute = global_setpoint_of(global_message(0b1111111000, GLOBAL, 500.0), -3.0)
    relative = global_setpoint_of(global_message(0b1111111000, RELATIVE, 15.0), -3.0)
    assert absolute is not None
    assert relative is not None
    assert absolute.pos_ned_m[2] == pytest.approx(ALTITUDE_M - 500.0)
    assert relative.pos_ned_m[2] == pytest.approx(-18.0)


@pytest.mark.parametrize("frame", [0, 1, 3, 7, 8, 9, 10, TERRAIN, 255])
def test_a_position_in_another_frame_is_refused_but_a_velocity_has_none(frame: int) -> None:
    assert global_setpoint_of(global_message(0, frame), 0.0) is None
    velocity = global_setpoint_of(global_message(7, frame), 0.0)
    assert velocity is not None
    assert velocity.vel_ned_mps == (1.0, 2.0, 3.0)


def test_global_force_and_numbers_that_are_none() -> None:
    assert global_setpoint_of(global_message(1 << 9), 0.0) is None
    assert global_setpoint_of(global_message(1 << 9 | 0x1C0), 0.0) is not None
    setpoint = global_setpoint_of(global_message(0, vx=nan, yaw=nan), 0.0)
    assert setpoint is not None
    assert setpoint.vel_ned_mps == (None, 2.0, 3.0)
    assert setpoint.yaw_rad is None


@pytest.mark.parametrize(("mask", "attitude", "rates"), [
    (0b0000_0111, True, (0.0, 0.0, 0.0)),
    (0b0000_0011, True, (0.0, 0.0, 0.3)),
    (0b0000_0000, True, (0.0, 0.0, 0.3)),
    (0b1000_0000, False, (0.1, 0.2, 0.3)),
    (0b1000_0100, False, (0.1, 0.2, 0.0)),
])  # fmt: skip
def test_attitudes_and_rates_are_read_as_px4_does(mask: int, attitude: bool, rates: tuple[float, float, float]) -> None:
    setpoint = attitude_setpoint_of(attitude_message(mask, pitched(0.2), 0.4, (0.1, 0.2, 0.3)))
    assert setpoint is not None
    assert setpoint.ned_from_frd == (pytest.approx(pitched(0.2)) if attitude else None)
    assert setpoint.rates_frd_radps == pytest.approx(rates)
    assert setpoint.thrust == pytest.approx(0.4)


@pytest.mark.parametrize(
    "message",
    [
        attitude_message(0b1000_0001),
        attitude_message(0b1000_0111),
        attitude_message(q=(0.0, 0.0, 0.0, 0.0)),
        attitude_message(q=(nan, 0.0, 0.0, 0.0)),
        attitude_message(thrust=nan),
        attitude_message(0b0000_0011, rates=(0.0, 0.0, nan)),
    ],
)
def test_attitudes_that_are_none_are_refused(message: Any) -> None:
    assert attitude_setpoint_of(message) is None


def test_an_ignored_thrust_is_none() -> None:
    setpoint = attitude_setpoint_of(attitude_message(0b0100_0111, thrust=0.7))
    assert setpoint is not None
    assert setpoint.thrust == 0.0


def test_places_on_the_globe_and_in_the_local_frame_are_each_others_inverse() -> None:
    lat, lon, alt = global_of(PLACE)
    assert (*local_of(lat, lon), ALTITUDE_M - alt) == pytest.approx(PLACE, abs=1e-6)
    assert global_of((0.0, 0.0, 0.0)) == (LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M)


# ---------------------------------------------------------------------- flight


@pytest.fixture(scope="module")
def hovering() -> Application:
    application = Application(iris(takeoff_altitude_m=8.0))
    application.keep = True
    application.take_off()
    return application


def test_a_global_position_is_flown_to(hovering: Application) -> None:
    hovering.offboard(lambda t_s: global_message(0b1011_1111_1000, RELATIVE, 6.0, yaw=0.0))
    hovering.run(20.0)
    truth = hovering.peer.truth()
    assert hovering.peer.autopilot.nav_state is NavState.OFFBOARD
    assert (truth.pos_ned_m[0], truth.pos_ned_m[1]) == pytest.approx(PLACE[:2], abs=0.3)
    assert truth.pos_ned_m[2] == pytest.approx(hovering.peer.autopilot.home_ned_m[2] - 6.0, abs=0.2)


def test_an_attitude_hovers_tilts_and_turns() -> None:
    app = Application(iris(load_kg=0.005))
    app.take_off()
    thrust = app.peer.autopilot.hover_thrust
    app.offboard(lambda t_s: attitude_message(thrust=thrust))
    app.run(3.0)
    level = app.peer.truth()
    assert abs(level.vel_ned_mps[2]) < 0.6
    assert hypot(level.vel_ned_mps[0], level.vel_ned_mps[1]) < 0.3
    app.setpoint = lambda t_s: attitude_message(q=pitched(radians(-10.0)), thrust=thrust / cos(radians(10.0)))
    app.run(2.0)
    tilted = app.peer.truth()
    w, x, y, z = tilted.ned_from_frd
    assert degrees(2.0 * (w * y - z * x)) == pytest.approx(-10.0, abs=1.0)
    # g tan(10 deg) for two seconds, less drag and the time to tilt.
    assert 2.4 < tilted.vel_ned_mps[0] < 3.5
    app.setpoint = lambda t_s: attitude_message(0b1000_0000, thrust=thrust, rates=(0.0, 0.0, 0.5))
    before = app.peer.truth().yaw_rad
    app.run(2.0)
    assert app.peer.truth().yaw_rad - before == pytest.approx(1.0, abs=0.15)


def test_attitudes_that_stop_start_the_failsafe_and_positions_take_over_again() -> None:
    app = Application(iris(load_kg=0.005), {"COM_OBL_RC_ACT": 5})
    app.take_off()
    thrust = app.peer.autopilot.hover_thrust
    app.offboard(lambda t_s: attitude_message(q=pitched(radians(-5.0)), thrust=thrust))
    app.run(1.0)
    assert app.peer.autopilot.nav_state is NavState.OFFBOARD
    app.setpoint = None
    app.run(1.2)
    assert app.peer.autopilot.nav_state is NavState.LOITER
    app.run(10.0)
    assert hypot(*app.peer.truth().vel_ned_mps) < 0.1


def test_an_attitude_with_thrust_takes_off() -> None:
    app = Application(iris(load_kg=0.005))
    app.run(0.5)
    app.setpoint = lambda t_s: attitude_message(thrust=0.75)
    app.run(0.3)
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6, 0)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(3.0)
    assert app.peer.truth().pos_ned_m[2] < -1.0


@given(
    mask=st.integers(0, 255),
    q=st.lists(st.floats(width=32), min_size=4, max_size=4),
    rest=st.lists(st.floats(width=32), min_size=4, max_size=4),
)
@settings(max_examples=40, deadline=None)
def test_no_attitude_can_make_the_simulation_blow_up(mask: int, q: list[float], rest: list[float]) -> None:
    app = Application(iris())
    app.peer.plant.place((0.0, 0.0, -30.0), rotors=0.58)
    app.peer.autopilot.arm()
    app.offboard(lambda t_s: mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, *rest))
    app.run(1.0)
    assert all(isfinite(value) for value in app.peer.plant.state)


@given(
    mask=st.integers(0, 65535),
    frame=st.sampled_from([5, 6, 11, 1]),
    place=st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1)),
    values=st.lists(st.floats(width=32), min_size=9, max_size=9),
)
@settings(max_examples=40, deadline=None)
def test_no_global_setpoint_can_make_the_simulation_blow_up(
    mask: int, frame: int, place: tuple[int, int], values: list[float]
) -> None:
    app = Application(iris())
    app.peer.plant.place((0.0, 0.0, -30.0), rotors=0.58)
    app.peer.autopilot.arm()
    message = mavlink.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, *place, *values)
    app.offboard(lambda t_s: message)
    app.run(1.0)
    assert all(isfinite(value) for value in app.peer.plant.state)


# ------------------------------------------------------------ what is told besides


def test_origin_and_home_are_told_and_given_on_request() -> None:
    app = Application(iris())
    app.keep = True
    app.run(5.0)
    origins = app.of_type("GPS_GLOBAL_ORIGIN")
    assert len(origins) == pytest.approx(5, abs=1)
    assert (origins[0].latitude, origins[0].longitude, origins[0].altitude) == (473977420, 85455940, 488000)
    assert len(app.of_type("HOME_POSITION")) == pytest.approx(2.5, abs=1)
    app.messages.clear()
    app.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
    app.command(mavlink.MAV_CMD_GET_HOME_POSITION)
    app.run(0.02)
    assert app.of_type("GPS_GLOBAL_ORIGIN")
    assert app.of_type("HOME_POSITION")
    assert app.acks() == {mavlink.MAV_CMD_REQUEST_MESSAGE: [0], mavlink.MAV_CMD_GET_HOME_POSITION: [0]}


def test_a_remote_control_is_told_of_once_there_is_one() -> None:
    app = Application(iris())
    app.keep = True
    app.run(1.0)
    assert not app.of_type("RC_CHANNELS")
    app.peer.rc_channels = [1500, 1501, 1000, 1502, 1000, 1900]
    app.run(1.0)
    told = app.of_type("RC_CHANNELS")
    assert len(told) == pytest.approx(20, abs=1)
    last = told[-1]
    assert (last.chancount, last.chan3_raw, last.chan6_raw, last.chan7_raw) == (6, 1000, 1900, 65535)
    app.messages.clear()
    app.peer.rc_channels = None
    app.run(1.0)
    assert not app.of_type("RC_CHANNELS")


def test_messages_can_be_missing() -> None:
    imu = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
    app = Application(iris(), without=frozenset({imu}))
    app.keep = True
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, imu, 10000.0)
    app.command(mavlink.MAV_CMD_REQUEST_MESSAGE, imu)
    app.run(1.0)
    assert not app.of_type("HIGHRES_IMU")
    assert app.of_type("ATTITUDE")
    assert app.acks() == {
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: [mavlink.MAV_RESULT_FAILED],
        mavlink.MAV_CMD_REQUEST_MESSAGE: [mavlink.MAV_RESULT_DENIED],
    }


def test_parameters_of_others_are_left_to_them() -> None:
    app = Application(iris())
    app.keep = True
    app.run(0.1)
    app.messages.clear()
    for target in ((1, 191), (0, 0), (0, 1), (2, 1)):
        app.send(mavlink.MAVLink_param_request_read_message(*target, b"MPC_XY_P", -1))
    app.run(0.1)
    assert not app.of_type("PARAM_VALUE")
    app.send(mavlink.MAVLink_param_request_read_message(1, 0, b"MPC_XY_P", -1))
    app.run(0.1)
    assert [value.param_id for value in app.of_type("PARAM_VALUE")] == ["MPC_XY_P"]


def test_frames_that_come_back_are_not_obeyed_and_the_sequence_has_no_gap() -> None:
    app = Application(iris())
    app.run(0.1)
    echo = app.codec.__class__(1, 1)
    app.peer.receive(echo.encode(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)))
    frames = app.peer.advance(app.t_s + 3.0)
    assert not app.peer.autopilot.armed
    sequence = [raw[4] for raw in frames]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(sequence))
