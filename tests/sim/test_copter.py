"""The simulated autopilot behind Copter's face: streams, parameters, commands, targets, flight."""

import copy
from collections import Counter
from collections.abc import Callable
from math import cos, degrees, hypot, isfinite, log, nan, pi, radians, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.sim.autopilot import NavState
from swingd.sim.copter import attitude_target_of, global_target_of, local_target_of
from swingd.sim.geodesy import ALTITUDE_M
from swingd.sim.guided import GuidedTarget
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.telemetry import global_int

from .rigs import Application, as_copter, copter_sitl, iris

LOCAL, OFFSET, BODY, BODY_OFFSET = 1, 7, 8, 9
VELOCITY = 0b1101_1100_0111  # yaw rate ignored as well: the nose looks ahead
POSITION = 0b1101_1111_1000
HERE = (10.0, 20.0, -5.0)


@pytest.fixture
def app() -> Application:
    application = Application(as_copter(iris()))
    application.keep = True
    return application


def local_message(mask: int, frame: int = LOCAL, values: Any = None) -> Any:
    numbers = values if values is not None else [float(i + 1) for i in range(11)]
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *numbers)


def velocity_of(north: float, east: float = 0.0, frame: int = LOCAL) -> Callable[[float], Any]:
    return lambda t_s: local_message(VELOCITY, frame, [0, 0, 0, north, east, 0, 0, 0, 0, 0, 0])


def heartbeat(app: Application) -> None:
    app.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))


def mode(app: Application) -> int:
    return int(app.of_type("HEARTBEAT")[-1].custom_mode)


def speed(app: Application) -> float:
    vel = app.peer.truth().vel_ned_mps
    return hypot(vel[0], vel[1])


# --------------------------------------------------------------------- streams


def rates(app: Application, duration_s: float) -> dict[str, float]:
    app.messages.clear()
    app.run(duration_s)
    counts = Counter(message.get_type() for _, message in app.messages)
    return {name: count / duration_s for name, count in counts.items()}


def ask(app: Application, name: str, rate_hz: float) -> int:
    """Ask for a stream and give the result."""
    app.messages.clear()
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, getattr(mavlink, f"MAVLINK_MSG_ID_{name}"), 1e6 / rate_hz)
    app.run(0.1)
    return app.acks()[mavlink.MAV_CMD_SET_MESSAGE_INTERVAL][-1]


def test_little_is_sent_until_it_is_asked_for(app: Application) -> None:
    app.run(1.0)
    assert rates(app, 10.0) == pytest.approx(
        {"HEARTBEAT": 1, "SYS_STATUS": 1, "GPS_RAW_INT": 1, "GLOBAL_POSITION_INT": 1, "MISSION_CURRENT": 1}, abs=0.11
    )


STREAMS = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET",
           "BATTERY_STATUS", "VFR_HUD", "SERVO_OUTPUT_RAW", "LOCAL_POSITION_NED", "EXTENDED_SYS_STATE",
           "HOME_POSITION", "GPS_GLOBAL_ORIGIN", "SYSTEM_TIME")  # fmt: skip


@pytest.mark.parametrize("rate_hz", [10, 100, 200])
def test_what_is_asked_for_comes_at_that_rate(app: Application, rate_hz: float) -> None:
    for name in STREAMS:
        assert ask(app, name, rate_hz) == mavlink.MAV_RESULT_ACCEPTED
    measured = rates(app, 5.0)
    assert {name: measured[name] for name in STREAMS} == pytest.approx(dict.fromkeys(STREAMS, rate_hz), rel=0.01)
    if rate_hz == 100:
        for name, stamps in (
            ("HIGHRES_IMU", [message.time_usec for message in app.of_type("HIGHRES_IMU")]),
            ("ATTITUDE", [1000 * message.time_boot_ms for message in app.of_type("ATTITUDE")]),
        ):
            assert set(np.diff(stamps)) == {8000, 12000}, name


@pytest.mark.parametrize(("name", "rate_hz"), [
    ("HIGHRES_IMU", 400), ("ATTITUDE", 1000), ("ACTUATOR_OUTPUT_STATUS", 10), ("ODOMETRY", 10),
])  # fmt: skip
def test_what_copter_cannot_send_is_denied(app: Application, name: str, rate_hz: float) -> None:
    assert ask(app, name, rate_hz) == mavlink.MAV_RESULT_DENIED
    assert name not in rates(app, 1.0)


def test_streams_can_be_switched_off_and_set_back(app: Application) -> None:
    ask(app, "ATTITUDE", 50)
    ask(app, "SYS_STATUS", 20)
    ask(app, "ATTITUDE", -1e6)  # an interval of -1
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_SYS_STATUS, 0.0)
    app.run(0.1)
    measured = rates(app, 3.0)
    assert "ATTITUDE" not in measured
    assert measured["SYS_STATUS"] == pytest.approx(1.0, abs=0.4)
    app.messages.clear()
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, -2.0)
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, nan, 1e5)
    app.run(0.1)
    assert app.acks()[mavlink.MAV_CMD_SET_MESSAGE_INTERVAL] == [mavlink.MAV_RESULT_DENIED] * 2


def test_the_old_request_of_groups_is_understood(app: Application) -> None:
    app.run(0.1)
    app.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 20, 1))
    app.run(0.1)
    measured = rates(app, 2.0)
    assert measured["ATTITUDE"] == pytest.approx(20, rel=0.05)
    assert "VFR_HUD" not in measured
    app.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 4, 1))
    app.run(0.1)
    measured = rates(app, 5.0)
    assert {measured[name] for name in ("ATTITUDE", "VFR_HUD", "RAW_IMU", "LOCAL_POSITION_NED", "BATTERY_STATUS")} <= {
        3.8, 4.0, 4.2}  # fmt: skip
    app.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 4, 0))
    app.run(0.1)
    assert "ATTITUDE" not in rates(app, 2.0)


def test_imus_in_three_units_tell_the_same(app: Application) -> None:
    app = Application(as_copter(iris(acc_noise_mps2=1.0, gyro_noise_radps=0.5)))
    app.keep = True
    for name in ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU"):
        ask(app, name, 100)
    app.run(1.0)
    triples = list(zip(*(app.of_type(name)[-50:] for name in ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")), strict=True))
    assert len(triples) == 50
    for fine, raw, scaled in triples:
        assert fine.time_usec == raw.time_usec
        assert fine.time_usec // 1000 == scaled.time_boot_ms
        for coarse in (raw, scaled):
            acc = [coarse.xacc, coarse.yacc, coarse.zacc]
            assert acc == [round(a * 1000.0 / 9.80665) for a in (fine.xacc, fine.yacc, fine.zacc)]
            assert [coarse.xgyro, coarse.ygyro, coarse.zgyro] == [
                round(1000.0 * rate) for rate in (fine.xgyro, fine.ygyro, fine.zgyro)
            ]
            assert coarse.zmag == 430
            assert fine.zmag == pytest.approx(430_000.0)  # a million times gauss, as Copter has it


def test_the_throttle_is_a_whole_percent_and_unused_outputs_are_zero(app: Application) -> None:
    for name in ("VFR_HUD", "ATTITUDE_TARGET", "SERVO_OUTPUT_RAW"):
        ask(app, name, 50)
    app.take_off_guided(3.0)
    hud, target, servo = (app.of_type(name)[-1] for name in ("VFR_HUD", "ATTITUDE_TARGET", "SERVO_OUTPUT_RAW"))
    assert isinstance(hud.throttle, int)
    assert hud.throttle == pytest.approx(100.0 * target.thrust, abs=2.0)
    assert 40 < hud.throttle < 75
    assert [getattr(servo, f"servo{i}_raw") for i in (5, 9, 16)] == [0, 0, 0]
    assert 1300 < servo.servo1_raw < 1800


def test_timesync_is_answered(app: Application) -> None:
    app.run(0.5)
    app.send(mavlink.MAVLink_timesync_message(0, 123456))
    app.run(0.02)
    (answer,) = app.of_type("TIMESYNC")
    assert answer.ts1 == 123456
    assert answer.tc1 == pytest.approx(0.512e9, abs=0.01e9)


def test_status_texts_reach_those_who_send_a_heartbeat(app: Application) -> None:
    app.run(0.1)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    app.run(0.2)
    assert not app.of_type("STATUSTEXT")
    heartbeat(app)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(0.1)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    app.run(0.1)
    assert [text.text for text in app.of_type("STATUSTEXT")] == ["Arming motors", "Disarming motors"]


def test_imu_can_be_missing() -> None:
    app = Application(as_copter(iris()), without={mavlink.MAVLINK_MSG_ID_HIGHRES_IMU})
    app.keep = True
    app.run(0.1)
    assert ask(app, "HIGHRES_IMU", 100) == mavlink.MAV_RESULT_DENIED
    assert ask(app, "RAW_IMU", 100) == mavlink.MAV_RESULT_ACCEPTED
    app.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HIGHRES_IMU)
    measured = rates(app, 1.0)
    assert measured["RAW_IMU"] == pytest.approx(100, rel=0.03)
    assert "HIGHRES_IMU" not in measured
    assert app.acks() == {mavlink.MAV_CMD_REQUEST_MESSAGE: [mavlink.MAV_RESULT_FAILED]}


# ------------------------------------------------------------------ parameters


def test_every_parameter_travels_as_a_float(app: Application) -> None:
    app.run(0.1)
    app.messages.clear()
    app.send(mavlink.MAVLink_param_request_list_message(1, 1))
    app.run(2.0)
    values = {value.param_id: value for value in app.of_type("PARAM_VALUE")}
    assert len(values) == len(app.peer.parameters) == values["GUID_TIMEOUT"].param_count
    assert {value.param_index for value in values.values()} == set(range(len(values)))
    assert {name: (values[name].param_value, values[name].param_type) for name in (
        "GUID_TIMEOUT", "WPNAV_ACCEL", "MOT_BAT_VOLT_MAX", "DISARM_DELAY", "RTL_ALT", "ANGLE_MAX"
    )} == {
        "GUID_TIMEOUT": (3.0, mavlink.MAV_PARAM_TYPE_REAL32),
        "WPNAV_ACCEL": (250.0, mavlink.MAV_PARAM_TYPE_REAL32),
        "MOT_BAT_VOLT_MAX": (0.0, mavlink.MAV_PARAM_TYPE_REAL32),
        "DISARM_DELAY": (10.0, mavlink.MAV_PARAM_TYPE_INT8),
        "RTL_ALT": (1500.0, mavlink.MAV_PARAM_TYPE_INT32),
        "ANGLE_MAX": (3000.0, mavlink.MAV_PARAM_TYPE_INT16),
    }  # fmt: skip


def test_parameters_are_read_and_set_whatever_type_is_given(app: Application) -> None:
    app.run(0.1)
    app.messages.clear()
    for name, value in ((b"GUID_TIMEOUT", 1.5), (b"RTL_ALT", 2000.4), (b"DISARM_DELAY", 1000.0), (b"PSC_POSXY_P", nan),
                        (b"NOT_THERE", 1.0)):  # fmt: skip
        app.send(mavlink.MAVLink_param_set_message(1, 1, name, value, mavlink.MAV_PARAM_TYPE_UINT8))
    app.send(mavlink.MAVLink_param_request_read_message(1, 1, b"PSC_POSXY_P", -1))
    app.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NOT_THERE", -1))
    app.run(0.1)
    assert [(value.param_id, value.param_value, value.param_index) for value in app.of_type("PARAM_VALUE")] == [
        ("GUID_TIMEOUT", 1.5, 65535),
        ("RTL_ALT", 2000.0, 65535),
        ("DISARM_DELAY", 127.0, 65535),
        ("PSC_POSXY_P", 1.0, 65535),
    ]
    assert app.peer.parameters["GUID_TIMEOUT"] == 1.5
    assert app.peer.px4["RTL_RETURN_ALT"] == 20.0


# -------------------------------------------------------------------- commands


def test_it_looks_like_copter(app: Application) -> None:
    app.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    app.run(0.1)
    beat = app.of_type("HEARTBEAT")[0]
    assert (beat.type, beat.autopilot, beat.custom_mode, beat.base_mode, beat.system_status) == (2, 3, 0, 0x51, 3)
    version = app.of_type("AUTOPILOT_VERSION")[0]
    assert version.flight_sw_version >> 16 == 0x0407
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    assert not version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE


@pytest.mark.parametrize(("custom", "result"), [(4, 0), (5, 0), (6, 0), (9, 0), (0, 0), (3, 4), (16, 4), (77, 4)])
def test_modes_on_the_ground(app: Application, custom: int, result: int) -> None:
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, custom)
    app.run(1.2)
    assert app.acks() == {mavlink.MAV_CMD_DO_SET_MODE: [result]}
    assert mode(app) == (custom if result == 0 else 0)


def test_set_mode_and_a_mode_that_is_not_custom(app: Application) -> None:
    app.send(mavlink.MAVLink_set_mode_message(1, 1, 4))
    app.run(1.1)
    assert mode(app) == 4
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 0, 9)
    app.run(1.1)
    assert app.acks() == {mavlink.MAV_CMD_DO_SET_MODE: [mavlink.MAV_RESULT_DENIED]}
    assert mode(app) == 4


@pytest.mark.parametrize(("custom", "result"), [(0, 0), (4, 0), (5, 0), (6, 4), (9, 4)])
def test_arming_depends_on_the_mode(app: Application, custom: int, result: int) -> None:
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, custom)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(0.1)
    assert app.acks()[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] == [result]
    assert app.peer.autopilot.armed is (result == 0)


def test_a_takeoff_needs_guided_arming_the_ground_and_a_height(app: Application) -> None:
    def take_off(height: float) -> int:
        app.messages.clear()
        app.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height)
        app.run(0.1)
        return app.acks()[mavlink.MAV_CMD_NAV_TAKEOFF][0]

    app.run(0.1)
    assert take_off(5.0) == 4
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(0.1)
    assert take_off(5.0) == 4
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    app.run(0.1)
    assert take_off(-1.0) == 4
    assert take_off(nan) == 4
    assert take_off(5.0) == 0
    app.run(15.0)
    assert app.peer.truth().pos_ned_m[2] == pytest.approx(-5.0, abs=0.15)
    assert take_off(9.0) == 4
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 0)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    app.run(0.1)
    assert app.acks()[mavlink.MAV_CMD_DO_SET_MODE] == [4]
    assert app.acks()[mavlink.MAV_CMD_COMPONENT_ARM_DISARM] == [4]
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0)
    app.run(0.1)
    assert not app.peer.autopilot.armed


def test_a_takeoff_in_another_altitude_frame_is_denied(app: Application) -> None:
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(0.1)
    for frame, result in ((mavlink.MAV_FRAME_GLOBAL, 2), (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, 0)):
        app.messages.clear()
        app.send(mavlink.MAVLink_command_int_message(1, 1, frame, 22, 0, 0, 0, 0, 0, 0, 0, 0, 5.0))
        app.run(0.1)
        assert app.acks() == {22: [result]}


def test_it_disarms_on_the_ground_by_itself(app: Application) -> None:
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(9.5)
    assert app.peer.autopilot.armed
    app.run(1.0)
    assert not app.peer.autopilot.armed


def test_a_reboot_goes_back_to_stabilize_and_few_streams(app: Application) -> None:
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    ask(app, "ATTITUDE", 50)
    app.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    app.run(5.0)
    app.messages.clear()
    app.run(2.0)
    assert mode(app) == 0
    assert not app.of_type("ATTITUDE")


# --------------------------------------------------------------------- targets


def oracle(mask: int, frame: int, yaw: float) -> GuidedTarget | None:
    """The rules in words: whole groups, four frames, four combinations."""
    pos = [1.0, 2.0, 3.0] if mask & 7 == 0 else None
    vel = [4.0, 5.0, 6.0] if mask >> 3 & 7 == 0 else None
    acc = [7.0, 8.0, 9.0] if mask >> 6 & 7 == 0 else None
    forces = mask >> 9 & 1
    allowed = {(1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 1, 0), (0, 1, 1), (0, 0, 1)}
    if (pos is not None, vel is not None, acc is not None) not in allowed or (forces and acc is not None):
        return None
    turn = np.array([[cos(yaw), -sin(yaw), 0.0], [sin(yaw), cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    if frame not in (BODY, BODY_OFFSET):
        turn = np.eye(3)

    def turned(group: list[float] | None, add: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
        return None if group is None else tuple(turn @ group + add)

    heads = None if mask >> 10 & 1 else 10.0
    rate = None if mask >> 11 & 1 else 11.0
    from_here = HERE if frame != LOCAL else (0.0, 0.0, 0.0)
    relative = frame in (BODY, BODY_OFFSET) and heads is not None
    return GuidedTarget(turned(pos, from_here), turned(vel), turned(acc), heads, rate, relative)


@pytest.mark.parametrize("frame", [LOCAL, OFFSET, BODY, BODY_OFFSET])
def test_every_mask_in_every_local_frame(frame: int) -> None:
    for mask in range(4096):
        got = local_target_of(local_message(mask, frame), HERE, 0.7)
        want = oracle(mask, frame, 0.7)
        assert (got is None) == (want is None), mask
        if got is None or want is None:
            continue
        for a, b in ((got.pos_ned_m, want.pos_ned_m), (got.vel_ned_mps, want.vel_ned_mps),
                     (got.acc_ned_mps2, want.acc_ned_mps2)):  # fmt: skip
            assert a == (None if b is None else pytest.approx(b))
        assert (got.yaw_rad, got.yaw_rate_radps, got.yaw_is_relative) == (
            want.yaw_rad,
            want.yaw_rate_radps,
            want.yaw_is_relative,
        )


@pytest.mark.parametrize("frame", [0, 2, 3, 5, 6, 12, 20, 255])
def test_other_local_frames_stop(frame: int) -> None:
    assert local_target_of(local_message(0, frame), HERE, 0.0) is None


@pytest.mark.parametrize("bad", [nan, float("inf"), 1001.0])
def test_velocities_that_are_none_stop(bad: float) -> None:
    assert local_target_of(local_message(VELOCITY, LOCAL, [0, 0, 0, bad, 0, 0, 0, 0, 0, 0, 0]), HERE, 0.0) is None


def global_message(mask: int, frame: int, alt: float = 500.0) -> Any:
    lat, lon, _ = global_int((30.0, -40.0, 0.0))
    return mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, frame, mask, lat, lon, alt, 1, 2, 3, 4, 5, 6, 7, 8
    )


@pytest.mark.parametrize(("frame", "down"), [(0, ALTITUDE_M - 500.0), (5, ALTITUDE_M - 500.0), (3, -502.0),
                                             (6, -502.0), (10, None), (11, None), (1, None)])  # fmt: skip
def test_global_positions_in_every_frame(frame: int, down: float | None) -> None:
    got = global_target_of(global_message(POSITION, frame), -2.0)
    if down is None:
        assert got is None
    else:
        assert got is not None
        assert got.pos_ned_m == pytest.approx((30.0, -40.0, down), abs=0.02)


def test_every_global_mask() -> None:
    for mask in range(4096):
        got, want = global_target_of(global_message(mask, 6), 0.0), oracle(mask, LOCAL, 0.0)
        assert (got is None) == (want is None), mask
        if got is None or want is None:
            continue
        assert (got.pos_ned_m is None, got.vel_ned_mps is None) == (want.pos_ned_m is None, want.vel_ned_mps is None)
        # Beside a global position and velocity Copter drops the acceleration.
        dropped = want.pos_ned_m is not None and want.vel_ned_mps is not None
        assert (got.acc_ned_mps2 is None) == (dropped or want.acc_ned_mps2 is None)
        assert not got.yaw_is_relative


@pytest.mark.parametrize(("mask", "q", "thrust", "climb"), [
    (0b111, (1.0, 0.0, 0.0, 0.0), 0.5, 0.0),
    (0b111, (1.0, 0.0, 0.0, 0.0), 1.0, 2.5),
    (0b000, (1.0, 0.0, 0.0, 0.0), 0.0, -1.5),
    (0b111, (1.0, 0.0, 0.0, 0.1), 0.5, None),
    (0b001, (1.0, 0.0, 0.0, 0.0), 0.5, None),
    (0b100_0111, (1.0, 0.0, 0.0, 0.0), 0.5, None),
    (0b1000_0000, (0.0, 0.0, 0.0, 0.0), 0.75, 1.25),
    (0b111, (1.0, 0.0, 0.0, 0.0), nan, None),
])  # fmt: skip
def test_attitudes_are_read_as_copter_does(
    mask: int, q: tuple[float, float, float, float], thrust: float, climb: float | None
) -> None:
    message = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, 0.1, 0.2, 0.3, thrust)
    got = attitude_target_of(message, (2.5, 1.5), thrust_is_thrust=False)
    if climb is None:
        assert got is None
        return
    assert got is not None
    assert got.thrust is None
    assert got.climb_mps == pytest.approx(climb)
    assert got.rates_frd_radps == ((0.0, 0.0, 0.0) if mask & 7 else pytest.approx((0.1, 0.2, 0.3)))
    as_thrust = attitude_target_of(message, (2.5, 1.5), thrust_is_thrust=True)
    assert as_thrust is not None
    assert as_thrust.thrust == pytest.approx(thrust)


# ---------------------------------------------------------------------- flight


@pytest.fixture(scope="module")
def _hovering() -> Application:
    application = Application(as_copter(iris(load_kg=0.005)))
    application.keep = True
    application.take_off_guided()
    application.truths = []
    return application


@pytest.fixture
def hovering(_hovering: Application) -> Application:
    return copy.deepcopy(_hovering)


def test_it_takes_off_and_stays_in_guided(hovering: Application) -> None:
    assert mode(hovering) == 4
    assert hovering.peer.autopilot.nav_state is NavState.GUIDED
    assert hovering.peer.truth().pos_ned_m[2] == pytest.approx(-8.0, abs=0.1)
    assert hovering.of_type("HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_ACTIVE


def test_velocities_are_followed_and_forgotten(hovering: Application) -> None:
    hovering.setpoint = velocity_of(3.0, 1.0)
    hovering.run(8.0)
    vel = hovering.peer.truth().vel_ned_mps
    assert vel[:2] == pytest.approx((3.0, 1.0), abs=0.1)
    assert hovering.peer.companion.setpoints > 300
    hovering.setpoint = None
    hovering.run(2.9)
    assert speed(hovering) == pytest.approx(hypot(3.0, 1.0), abs=0.1)
    hovering.run(0.7)
    assert speed(hovering) < 2.95  # braking since GUID_TIMEOUT
    hovering.run(6.0)
    assert speed(hovering) < 0.05
    place = hovering.peer.truth().pos_ned_m
    hovering.run(5.0)
    assert hovering.peer.truth().pos_ned_m == pytest.approx(place, abs=0.1)
    assert mode(hovering) == 4


def test_a_position_is_told_once(hovering: Application) -> None:
    hovering.send(local_message(POSITION, LOCAL, [20.0, -10.0, -12.0, *[0.0] * 8]))
    hovering.run(25.0)
    assert hovering.peer.truth().pos_ned_m == pytest.approx((20.0, -10.0, -12.0), abs=0.1)


@pytest.mark.parametrize(("frame", "moved"), [(OFFSET, (5.0, 2.0)), (BODY, (-2.0, 5.0)), (BODY_OFFSET, (-2.0, 5.0))])
def test_offsets_count_from_the_place_and_the_heading(
    hovering: Application, frame: int, moved: tuple[float, float]
) -> None:
    hovering.send(local_message(VELOCITY & ~0x400, LOCAL, [*[0.0] * 9, 0.5 * pi, 0.0]))
    hovering.run(3.0)
    before = hovering.peer.truth()
    assert before.yaw_rad == pytest.approx(0.5 * pi, abs=0.05)
    hovering.send(
        local_message(POSITION & ~0x400, frame, [5.0, 2.0, 0.0, *[0.0] * 6, 0.0 if frame != OFFSET else 1.57, 0])
    )
    hovering.run(15.0)
    after = hovering.peer.truth()
    north, east = (after.pos_ned_m[i] - before.pos_ned_m[i] for i in range(2))
    assert (north, east) == pytest.approx(moved, abs=0.3)
    assert after.yaw_rad == pytest.approx(0.5 * pi, abs=0.05)


def test_the_nose_looks_ahead_unless_told(hovering: Application) -> None:
    hovering.setpoint = velocity_of(0.0, 3.0)
    hovering.run(5.0)
    assert hovering.peer.truth().yaw_rad == pytest.approx(0.5 * pi, abs=0.05)


def test_what_is_invalid_stops_it(hovering: Application) -> None:
    hovering.setpoint = velocity_of(3.0)
    hovering.run(6.0)
    hovering.setpoint = lambda t_s: local_message(0, mavlink.MAV_FRAME_LOCAL_ENU)
    hovering.run(4.0)
    assert speed(hovering) < 1.0  # each of them begins the braking anew
    hovering.setpoint = None
    hovering.run(6.0)
    assert speed(hovering) < 0.05
    assert hovering.peer.companion.setpoints_refused >= 199


def test_targets_outside_of_guided_do_nothing(hovering: Application) -> None:
    hovering.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 5)
    hovering.setpoint = velocity_of(3.0)
    hovering.run(4.0)
    assert speed(hovering) < 0.1
    assert mode(hovering) == 5
    hovering.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    hovering.run(6.0)
    assert speed(hovering) > 2.5


def test_a_target_ends_a_takeoff(app: Application) -> None:
    app.run(0.2)
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.run(0.1)
    app.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 8.0)
    app.run(0.1)
    app.setpoint = velocity_of(0.0)
    app.run(5.0)
    assert app.peer.truth().grounded
    assert mode(app) == 4


def test_a_global_position_and_a_reposition_are_flown_to(hovering: Application) -> None:
    lat, lon, _ = global_int((15.0, 5.0, 0.0))
    message = mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, 6, POSITION, lat, lon, 10.0, *[0.0] * 8
    )  # fmt: skip
    hovering.send(message)
    hovering.run(20.0)
    assert hovering.peer.truth().pos_ned_m == pytest.approx((15.0, 5.0, -10.0), abs=0.3)
    lat, lon, _ = global_int((0.0, 0.0, 0.0))
    hovering.messages.clear()
    hovering.send(mavlink.MAVLink_command_int_message(1, 1, 6, 192, 0, 0, -1, 1, 0, 0, lat, lon, 8.0))
    hovering.run(20.0)
    assert hovering.acks() == {192: [0]}
    assert hovering.peer.truth().pos_ned_m == pytest.approx((0.0, 0.0, -8.0), abs=0.3)


def test_an_attitude_holds_the_altitude_and_goes_level_when_it_stops(hovering: Application) -> None:
    half = radians(-8.0) / 2.0
    message = mavlink.MAVLink_set_attitude_target_message(
        0, 1, 1, 0b111, (cos(half), 0.0, sin(half), 0.0), 0, 0, 0, 0.5
    )
    hovering.setpoint = lambda t_s: message
    hovering.run(3.0)
    truth = hovering.peer.truth()
    w, x, y, z = truth.ned_from_frd
    assert degrees(2.0 * (w * y - z * x)) == pytest.approx(-8.0, abs=1.0)
    assert truth.vel_ned_mps[0] > 2.5
    assert truth.pos_ned_m[2] == pytest.approx(-8.0, abs=0.4)
    hovering.setpoint = None
    hovering.run(5.0)
    w, x, y, z = hovering.peer.truth().ned_from_frd
    assert abs(degrees(2.0 * (w * y - z * x))) < 2.0
    climb = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0b111, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, 0.8)
    hovering.setpoint = lambda t_s: climb
    hovering.run(4.0)
    assert hovering.peer.truth().vel_ned_mps[2] == pytest.approx(-1.5, abs=0.2)


@pytest.mark.parametrize(("command", "custom"), [
    (mavlink.MAV_CMD_NAV_LAND, 9), (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, 6),
])  # fmt: skip
def test_it_lands_and_disarms_and_keeps_the_mode(hovering: Application, command: int, custom: int) -> None:
    hovering.send(local_message(POSITION, LOCAL, [6.0, 0.0, -8.0, *[0.0] * 8]))
    hovering.run(10.0)
    hovering.command(command)
    hovering.run(60.0)
    truth = hovering.peer.truth()
    assert truth.grounded
    assert not hovering.peer.autopilot.armed
    assert mode(hovering) == custom
    assert truth.pos_ned_m[0] == pytest.approx(0.0 if custom == 6 else 6.0, abs=1.2)


@pytest.mark.parametrize(("load_kg", "length_m", "period_s", "peak_deg", "rest_s"), [
    (1.0, 5.0, 4.9, 22.0, 20.0),
    (0.5, 3.0, None, None, 15.0),
])  # fmt: skip
def test_an_undamped_load_swings_as_under_the_real_copter(
    load_kg: float, length_m: float, period_s: float | None, peak_deg: float | None, rest_s: float
) -> None:
    """Copter SITL, GUIDED 4 -> 0 m/s; damping ratio measured there: 0.09 for the first load."""
    app = Application(copter_sitl(load_kg, length_m))
    app.take_off_guided(15.0)
    app.setpoint = velocity_of(4.0)
    app.run(20.0)
    app.setpoint = velocity_of(0.0)
    truths = app.run(40.0)
    swing = [degrees(hypot(truth.xi_rad, truth.zeta_rad)) for truth in truths]
    rest = max(i for i, angle in enumerate(swing) if angle > 2.0) * 0.004
    assert rest == pytest.approx(rest_s, rel=0.4)
    if period_s is None or peak_deg is None:
        return
    assert max(swing) == pytest.approx(peak_deg, rel=0.15)
    along = [degrees(truth.zeta_rad) for truth in truths]
    peaks = [i for i in range(1, len(along) - 1) if along[i - 1] < along[i] >= along[i + 1] and along[i] > 1.0]
    assert (peaks[1] - peaks[0]) * 0.004 == pytest.approx(period_s, rel=0.05)
    assert log(along[peaks[0]] / along[peaks[1]]) / (2.0 * pi) == pytest.approx(0.09, abs=0.02)


# ----------------------------------------------------------------- rough input


def test_the_same_bytes_give_the_same_frames() -> None:
    def fly() -> list[bytes]:
        peer = SimulatedAutopilot(as_copter(iris(acc_noise_mps2=0.1)))
        codec = Codec(1, 191)
        for number, *params in ((176, 1, 4), (400, 1), (511, 30, 10000.0), (511, 105, 5000.0)):
            padded = [*params, *[0.0] * (7 - len(params))]
            peer.receive(codec.encode(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)))
        frames = peer.advance(0.5)
        peer.receive(codec.encode(mavlink.MAVLink_command_long_message(1, 1, 22, 0, 0, 0, 0, 0, 0, 0, 5.0)))
        return frames + peer.advance(8.0)

    first = fly()
    assert len(first) > 2000
    assert first == fly()


@given(
    command=st.sampled_from([400, 176, 22, 21, 20, 192, 511, 512, 520, 410, 246, 300]),
    params=st.lists(st.floats(width=32), min_size=7, max_size=7),
    place=st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1)),
    frame=st.integers(0, 21),
)
@settings(max_examples=150, deadline=None)
def test_no_command_can_raise(command: int, params: list[float], place: tuple[int, int], frame: int) -> None:
    peer = SimulatedAutopilot(as_copter(iris()))
    codec = Codec(1, 191)
    peer.receive(codec.encode(mavlink.MAVLink_command_long_message(1, 1, command, 0, *params)))
    peer.receive(
        codec.encode(mavlink.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *params[:4], *place, params[6]))
    )
    acks = [frame.message for raw in peer.advance(0.3) for frame in Codec(1, 191).receive(raw)
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_COMMAND_ACK]  # fmt: skip
    assert [ack.command for ack in acks][:1] == [command]


@given(
    values=st.lists(st.floats(width=32), min_size=11, max_size=11),
    mask=st.integers(0, 65535),
    frame=st.sampled_from([LOCAL, OFFSET, BODY, BODY_OFFSET]),
)
@settings(max_examples=60, deadline=None)
def test_no_target_can_make_the_simulation_blow_up(values: list[float], mask: int, frame: int) -> None:
    app = Application(as_copter(iris()))
    app.peer.plant.place((0.0, 0.0, -30.0), rotors=0.58)
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    app.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    app.setpoint = lambda t_s: local_message(mask, frame, values)
    app.run(1.0)
    assert all(isfinite(value) for value in app.peer.plant.state)


@given(data=st.binary(max_size=600))
@settings(max_examples=40, deadline=None)
def test_no_bytes_can_raise(data: bytes) -> None:
    peer = SimulatedAutopilot(as_copter(iris()))
    peer.receive(data)
    assert peer.advance(0.1)
