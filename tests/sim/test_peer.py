"""What goes over the link: streams, acknowledgements, parameters, and bytes of every kind."""

import struct
from collections import Counter
from itertools import product
from math import degrees, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.codec import Codec
from swingd.model.actions import Health, SwingReport
from swingd.model.parameters import Parameters
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.px4 import setpoint_of
from swingd.sim.telemetry import euler_rad

from .rigs import Application, iris, velocity

LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture
def app() -> Application:
    application = Application(iris(acc_noise_mps2=0.1))
    application.keep = True
    return application


def rates(app: Application, duration_s: float) -> dict[str, float]:
    app.messages.clear()
    app.run(duration_s)
    counts = Counter(message.get_type() for _, message in app.messages)
    return {name: count / duration_s for name, count in counts.items()}


def test_default_rates_are_those_of_the_onboard_link(app: Application) -> None:
    app.run(1.0)
    measured = rates(app, 20.0)
    expected = {
        "HIGHRES_IMU": 50,
        "ATTITUDE": 100,
        "ATTITUDE_QUATERNION": 50,
        "LOCAL_POSITION_NED": 30,
        "ATTITUDE_TARGET": 10,
        "SERVO_OUTPUT_RAW": 10,
        "SYS_STATUS": 5,
        "EXTENDED_SYS_STATE": 5,
        "BATTERY_STATUS": 0.5,
        "HEARTBEAT": 1,
    }
    assert {name: measured[name] for name in expected} == pytest.approx(expected, rel=0.03)
    assert "ACTUATOR_OUTPUT_STATUS" not in measured
    assert "STATUSTEXT" not in measured


@pytest.mark.parametrize(("asked_hz", "imu_hz", "attitude_hz"), [(100, 100, 100), (200, 125, 125), (250, 224, 219)])
def test_requested_rates_come_out_as_on_px4(
    app: Application, asked_hz: float, imu_hz: float, attitude_hz: float
) -> None:
    for msg_id in (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, mavlink.MAVLINK_MSG_ID_ATTITUDE):
        app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msg_id, 1e6 / asked_hz)
    app.run(0.5)
    measured = rates(app, 10.0)
    assert measured["HIGHRES_IMU"] == pytest.approx(imu_hz, rel=0.03)
    assert measured["ATTITUDE"] == pytest.approx(attitude_hz, rel=0.03)
    stamps = [message.time_usec for message in app.of_type("HIGHRES_IMU")]
    gaps = np.diff(stamps)
    assert min(gaps) >= 4000
    assert max(gaps) <= 16000
    if asked_hz == 100:
        assert set(gaps) == {4000, 8000, 12000, 16000}


def test_intervals_can_be_switched_off_and_reset(app: Application) -> None:
    imu = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, imu, -1.0)
    app.run(0.2)
    assert "HIGHRES_IMU" not in rates(app, 1.0)
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, imu, 0.0)
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS, 20000.0)
    app.run(0.2)
    measured = rates(app, 2.0)
    assert measured["HIGHRES_IMU"] == pytest.approx(50, rel=0.03)
    assert measured["ACTUATOR_OUTPUT_STATUS"] == pytest.approx(50, rel=0.03)


@pytest.mark.parametrize(
    ("params", "result"),
    [
        ((mavlink.MAVLINK_MSG_ID_RAW_IMU, 10000.0), 4),
        ((mavlink.MAVLINK_MSG_ID_HEARTBEAT, 10000.0), 4),
        ((mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 100000.0), 0),
        ((nan, 10000.0), 4),
        ((mavlink.MAVLINK_MSG_ID_ATTITUDE, nan), 4),
    ],
)
def test_intervals_are_answered_as_px4_does(app: Application, params: tuple[float, float], result: int) -> None:
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, *params)
    app.run(0.1)
    assert app.acks() == {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: [result]}


def test_unknown_commands_are_unsupported(app: Application) -> None:
    app.command(mavlink.MAV_CMD_DO_PARACHUTE, 1.0)
    app.run(0.1)
    assert app.acks() == {mavlink.MAV_CMD_DO_PARACHUTE: [mavlink.MAV_RESULT_UNSUPPORTED]}
    ack = app.of_type("COMMAND_ACK")[0]
    assert (ack.target_system, ack.target_component) == (1, 191)


def test_messages_can_be_requested(app: Application) -> None:
    for msg_id in (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, mavlink.MAVLINK_MSG_ID_HOME_POSITION, 12345):
        app.command(mavlink.MAV_CMD_REQUEST_MESSAGE, msg_id)
    app.run(0.1)
    version = app.of_type("AUTOPILOT_VERSION")[0]
    assert version.flight_sw_version >> 8 == 0x011000
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    assert app.of_type("HOME_POSITION")
    assert app.acks() == {mavlink.MAV_CMD_REQUEST_MESSAGE: [0, 0, mavlink.MAV_RESULT_DENIED]}


def test_parameters_are_listed_read_and_set(app: Application) -> None:
    app.send(mavlink.MAVLink_param_request_list_message(1, 1))
    app.run(2.0)
    values = app.of_type("PARAM_VALUE")
    assert len(values) == len(app.peer.px4) == values[0].param_count
    assert [value.param_index for value in values] == list(range(len(values)))
    by_name = {value.param_id: value for value in values}
    assert by_name["MPC_XY_VEL_P_ACC"].param_value == pytest.approx(1.8)
    action = by_name["COM_OBL_RC_ACT"]
    assert action.param_type == mavlink.MAV_PARAM_TYPE_INT32
    assert {"COM_OF_LOSS_T", "COM_RCL_EXCEPT", "MPC_XY_VEL_MAX", "MPC_ACC_HOR", "MPC_TILTMAX_AIR", "MPC_THR_HOVER",
            "THR_MDL_FAC", "MPC_USE_HTE", "MC_BAT_SCALE_EN", "MAV_2_RATE", "SER_TEL2_BAUD", "IMU_INTEG_RATE"} <= set(
        by_name
    )  # fmt: skip

    app.messages.clear()
    as_float = struct.unpack("<f", struct.pack("<i", 5))[0]
    app.send(
        mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", as_float, mavlink.MAV_PARAM_TYPE_INT32),
        mavlink.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 2.5, mavlink.MAV_PARAM_TYPE_REAL32),
        mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_P", nan, mavlink.MAV_PARAM_TYPE_REAL32),
        mavlink.MAVLink_param_set_message(1, 1, b"MPC_Z_P", as_float, mavlink.MAV_PARAM_TYPE_INT32),
        mavlink.MAVLink_param_set_message(1, 1, b"NOT_THERE", 1.0, mavlink.MAV_PARAM_TYPE_REAL32),
        mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_THR_HOVER", -1),
        mavlink.MAVLink_param_request_read_message(1, 1, b"", 0),
        mavlink.MAVLink_param_request_read_message(1, 1, b"", 32000),
        mavlink.MAVLink_param_request_read_message(1, 1, b"NOT_THERE", -1),
    )
    app.run(0.1)
    assert app.peer.px4["COM_OBL_RC_ACT"] == 5
    assert app.peer.px4["COM_OF_LOSS_T"] == 2.5
    assert app.peer.px4["MPC_XY_P"] == 0.95
    assert app.peer.px4["MPC_Z_P"] == 1.0
    answers = [value.param_id for value in app.of_type("PARAM_VALUE")]
    assert answers == ["COM_OBL_RC_ACT", "COM_OF_LOSS_T", "MPC_XY_P", "MPC_Z_P", "MPC_THR_HOVER", "BAT1_N_CELLS"]


def test_changed_gains_are_flown(app: Application) -> None:
    app.peer.px4.set("MPC_XY_VEL_MAX", 1.0)
    app.take_off()
    app.offboard(lambda t_s: velocity(3.0, 0.0))
    rows = app.run(8.0)
    assert np.mean([row.vel_ned_mps[0] for row in rows[-500:]]) == pytest.approx(1.0, abs=0.1)


def test_heartbeats_carry_px4s_modes(app: Application) -> None:
    app.run(1.5)
    beat = app.of_type("HEARTBEAT")[-1]
    assert beat.autopilot == mavlink.MAV_AUTOPILOT_PX4
    assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    app.take_off()
    beat = app.of_type("HEARTBEAT")[-1]
    assert beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert beat.custom_mode == 4 << 16 | 3 << 24
    app.offboard()
    app.run(1.1)
    beat = app.of_type("HEARTBEAT")[-1]
    assert (beat.custom_mode, beat.base_mode) == (393216, 145)  # as recorded from PX4 v1.16
    app.setpoint = None
    app.run(2.1)
    beat = app.of_type("HEARTBEAT")[-1]
    assert beat.custom_mode == 4 << 16 | 6 << 24
    assert beat.system_status == mavlink.MAV_STATE_CRITICAL


def test_timesync_and_missions_are_answered(app: Application) -> None:
    app.run(0.1)
    app.send(mavlink.MAVLink_timesync_message(0, 987654321), mavlink.MAVLink_timesync_message(5, 6))
    app.send(mavlink.MAVLink_mission_request_list_message(1, 1, mavlink.MAV_MISSION_TYPE_FENCE))
    app.run(0.1)
    (sync,) = app.of_type("TIMESYNC")
    assert sync.ts1 == 987654321
    assert 0.1e9 < sync.tc1 < 0.2e9
    (count,) = app.of_type("MISSION_COUNT")
    assert (count.count, count.mission_type) == (0, mavlink.MAV_MISSION_TYPE_FENCE)
    assert (count.target_system, count.target_component) == (1, 191)


def test_what_is_meant_for_others_is_left_alone(app: Application) -> None:
    app.send(
        mavlink.MAVLink_command_long_message(2, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0),
    )
    app.run(0.5)
    assert not app.peer.autopilot.armed
    assert app.acks() == {}


def test_published_data_are_those_of_the_vehicle(app: Application) -> None:
    app.take_off()
    app.offboard(lambda t_s: velocity(1.0, 0.0, yaw=0.5))
    app.run(8.0)
    truth = app.peer.truth()
    attitude = app.of_type("ATTITUDE")[-1]
    assert attitude.yaw == pytest.approx(truth.yaw_rad, abs=0.02)
    position = app.of_type("LOCAL_POSITION_NED")[-1]
    assert (position.x, position.y, position.z) == pytest.approx(truth.pos_ned_m, abs=0.1)
    assert (position.vx, position.vy, position.vz) == pytest.approx(truth.vel_ned_mps, abs=0.05)
    globe = app.of_type("GLOBAL_POSITION_INT")[-1]
    assert globe.relative_alt * 1e-3 == pytest.approx(8.0, abs=0.2)
    assert (globe.lat * 1e-7 - 47.397742) * 111194.9 == pytest.approx(truth.pos_ned_m[0], abs=0.3)
    assert app.of_type("EXTENDED_SYS_STATE")[-1].landed_state == mavlink.MAV_LANDED_STATE_IN_AIR
    battery = app.of_type("BATTERY_STATUS")[-1]
    assert battery.voltages[0] * 1e-3 == pytest.approx(app.peer.battery.voltage_v, abs=0.05)
    assert app.of_type("SYS_STATUS")[-1].voltage_battery == pytest.approx(battery.voltages[0], abs=50)
    imu = [(m.xacc, m.yacc, m.zacc) for m in app.of_type("HIGHRES_IMU")[-100:]]
    assert np.mean(imu, axis=0)[2] == pytest.approx(-(truth.thrust_n - truth.tension_n) / 1.5, abs=0.15)
    target = app.of_type("ATTITUDE_TARGET")[-1]
    servo = app.of_type("SERVO_OUTPUT_RAW")[-1]
    pwm = [servo.servo1_raw, servo.servo2_raw, servo.servo3_raw, servo.servo4_raw]
    assert (np.mean(pwm) - 1000.0) / 1000.0 == pytest.approx(target.thrust, abs=0.01)


def test_motor_outputs_are_off_while_disarmed(app: Application) -> None:
    app.run(0.5)
    assert app.of_type("SERVO_OUTPUT_RAW")[-1].servo1_raw == 900


def test_stamps_are_older_than_the_state_they_show_as_on_px4() -> None:
    """IMU and attitude stamped t show the state 6 to 8 ms before."""
    app = Application(iris())
    app.keep = True
    for msg_id in (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, mavlink.MAVLINK_MSG_ID_ATTITUDE):
        app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msg_id, 4000.0)
    app.take_off()
    app.offboard(lambda t_s: velocity(2.0 if t_s % 2.0 < 1.0 else -2.0, 0.0))
    app.messages.clear()
    rows = app.run(8.0)
    t = np.array([row.t_boot_s for row in rows])
    pitch = np.array([euler_rad(row.ned_from_frd)[1] for row in rows])
    rate = np.array([row.rates_frd_radps[1] for row in rows])

    def best_delay_ms(stamps: Any, values: Any, truth: Any) -> float:
        inside = (stamps > t[20]) & (stamps < t[-1])
        delays = np.arange(0.0, 0.016, 0.0005)
        errors = [np.sum((np.interp(stamps[inside] - d, t, truth) - values[inside]) ** 2) for d in delays]
        return float(delays[int(np.argmin(errors))] * 1e3)

    attitudes = app.of_type("ATTITUDE")
    stamps = np.array([m.time_boot_ms * 1e-3 for m in attitudes])
    assert 6.0 <= best_delay_ms(stamps, np.array([m.pitch for m in attitudes]), pitch) <= 8.0
    imus = app.of_type("HIGHRES_IMU")
    stamps = np.array([m.time_usec * 1e-6 for m in imus])
    assert 6.0 <= best_delay_ms(stamps, np.array([m.ygyro for m in imus]), rate) <= 8.0


def test_ground_station_frames_reach_the_companion(app: Application) -> None:
    app.run(0.1)
    app.messages.clear()
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 191, 1, 0xDC7, 0, 0, 0, 1.5, 0, 0, 0, 0, 0, 0, 0
    )
    app.peer.send_to_companion(message)
    app.run(0.01)
    (got,) = app.of_type("SET_POSITION_TARGET_LOCAL_NED")
    assert (got.get_srcSystem(), got.get_srcComponent(), got.target_component, got.vx) == (255, 190, 191, 1.5)


def test_what_the_companion_publishes_is_kept(app: Application) -> None:
    zero = (0.0, 0.0, 0.0)
    report = SwingReport(0.09, 0.1, -0.2, 0.0, 0.0, zero, 0.01, 0.01, 20.0, 1.0, 2.0, zero, zero, Health.READY)
    app.run(0.1)
    app.send(
        swing_message.encode(report),
        mavlink.MAVLink_debug_float_array_message(1000, b"OTHER", 1, [0.0] * 58),
        mavlink.MAVLink_statustext_message(4, b"thrust scale at its limit"),
        mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3),
    )
    app.run(0.1)
    (got,) = app.peer.companion.reports
    assert (got.t_boot_s, got.xi_rad, got.zeta_rad) == pytest.approx((0.09, 0.1, -0.2))
    assert [text for _, _, text in app.peer.companion.status_texts] == ["thrust scale at its limit"]
    assert 0.1 < app.peer.companion.heartbeat_t_s < 0.12


def test_reboot_is_silent_and_sets_the_clock_back(app: Application) -> None:
    app.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, 4000.0)
    app.peer.px4.set("COM_OF_LOSS_T", 2.0)
    app.run(5.0)
    app.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    app.run(0.1)
    app.messages.clear()
    app.run(2.5)
    assert app.messages == []
    app.run(2.5)
    imu = app.of_type("HIGHRES_IMU")
    assert 2.9e6 < imu[0].time_usec < 3.1e6
    assert len(imu) / 2.1 == pytest.approx(50.0, rel=0.1)  # default rates again
    assert app.peer.px4["COM_OF_LOSS_T"] == 2.0


def test_the_same_bytes_give_the_same_frames() -> None:
    def fly() -> list[bytes]:
        peer = SimulatedAutopilot(Parameters())
        codec = Codec(1, 191)
        frames = peer.advance(1.0)
        peer.receive(codec.encode(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)))
        peer.receive(codec.encode(mavlink.MAVLink_command_long_message(1, 1, 22, 0, 0, 0, 0, 0, 0, 0, nan)))
        return frames + peer.advance(10.0)

    first = fly()
    assert len(first) > 2000
    assert first == fly()


def test_chunks_of_time_do_not_matter() -> None:
    whole, parts = SimulatedAutopilot(Parameters()), SimulatedAutopilot(Parameters())
    frames = whole.advance(2.0)
    assert frames == [frame for i in range(1, 21) for frame in parts.advance(0.1 * i)]


# ------------------------------------------------------------------ setpoints


def message_of(frame: int, mask: int, values: Any = None) -> Any:
    numbers = values if values is not None else [float(i + 1) for i in range(11)]
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *numbers)


def test_every_mask_in_local_ned_ignores_exactly_its_axes() -> None:
    for mask in range(512):
        setpoint = setpoint_of(message_of(mavlink.MAV_FRAME_LOCAL_NED, mask), LEVEL)
        expected = [None if mask >> i & 1 else float(i + 1) for i in range(9)]
        if mask == 511:
            assert setpoint is None
            continue
        assert setpoint is not None
        assert [*setpoint.pos_ned_m, *setpoint.vel_ned_mps, *setpoint.acc_ned_mps2] == expected
        assert (setpoint.yaw_rad, setpoint.yaw_rate_radps) == (10.0, 11.0)


@pytest.mark.parametrize("mask", [1 << 10, 1 << 11, 3 << 10])
def test_yaw_and_yaw_rate_can_be_ignored(mask: int) -> None:
    setpoint = setpoint_of(message_of(mavlink.MAV_FRAME_LOCAL_NED, mask), LEVEL)
    assert setpoint is not None
    assert setpoint.yaw_rad == (None if mask & 1 << 10 else 10.0)
    assert setpoint.yaw_rate_radps == (None if mask & 1 << 11 else 11.0)


def test_in_body_ned_one_ignored_axis_drops_its_group() -> None:
    for mask in range(512):
        setpoint = setpoint_of(message_of(mavlink.MAV_FRAME_BODY_NED, mask), LEVEL)
        vel = None if mask >> 3 & 7 else (4.0, 5.0, 6.0)
        acc = None if mask >> 6 & 7 else (7.0, 8.0, 9.0)
        if vel is None and acc is None:
            assert setpoint is None
            continue
        assert setpoint is not None
        assert setpoint.pos_ned_m == (None, None, None)
        assert setpoint.vel_ned_mps == (pytest.approx(vel) if vel else (None, None, None))
        assert setpoint.acc_ned_mps2 == (pytest.approx(acc) if acc else (None, None, None))


def test_in_body_ned_velocity_turns_by_yaw_and_acceleration_by_the_attitude() -> None:
    half = np.radians(30.0) / 2.0
    pitched = (np.cos(half), 0.0, np.sin(half), 0.0)
    setpoint = setpoint_of(message_of(mavlink.MAV_FRAME_BODY_NED, 0, [0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0]), pitched)
    assert setpoint is not None
    assert setpoint.vel_ned_mps == pytest.approx((1.0, 0.0, 0.0))
    assert setpoint.acc_ned_mps2 == pytest.approx((np.cos(2 * half), 0.0, -np.sin(2 * half)))
    east = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
    setpoint = setpoint_of(message_of(mavlink.MAV_FRAME_BODY_NED, 0, [0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0]), east)
    assert setpoint is not None
    assert setpoint.vel_ned_mps == pytest.approx((-2.0, 1.0, 3.0))


@pytest.mark.parametrize("frame", [0, 3, 6, 7, 9, 12, 255])
def test_other_frames_are_refused(frame: int) -> None:
    assert setpoint_of(message_of(frame, 0), LEVEL) is None


def test_force_is_refused() -> None:
    assert setpoint_of(message_of(1, mavlink.POSITION_TARGET_TYPEMASK_FORCE_SET), LEVEL) is None


@pytest.mark.parametrize("bad", [nan, float("inf"), float("-inf")])
def test_numbers_that_are_none_count_as_ignored(bad: float) -> None:
    setpoint = setpoint_of(message_of(1, 0, [bad, bad, -8.0, *[0.0] * 6, bad, bad]), LEVEL)
    assert setpoint is not None
    assert setpoint.pos_ned_m == (None, None, -8.0)
    assert setpoint.yaw_rad is None
    assert setpoint.yaw_rate_radps is None


# ----------------------------------------------------------------- rough input


@given(data=st.binary(max_size=600))
@settings(max_examples=60, deadline=None)
def test_no_bytes_can_raise(data: bytes) -> None:
    peer = SimulatedAutopilot(iris())
    peer.receive(data)
    assert peer.advance(0.1)


@given(
    command=st.sampled_from([400, 176, 22, 21, 20, 192, 511, 512, 520, 246, 31010]),
    params=st.lists(st.floats(width=32), min_size=7, max_size=7),
)
@settings(max_examples=150, deadline=None)
def test_no_command_can_raise(command: int, params: list[float]) -> None:
    peer = SimulatedAutopilot(iris())
    codec = Codec(1, 191)
    peer.receive(codec.encode(mavlink.MAVLink_command_long_message(1, 1, command, 0, *params)))
    frames = peer.advance(0.3)
    kinds = [frame.msg_id for raw in frames for frame in Codec(1, 191).receive(raw)]
    assert mavlink.MAVLINK_MSG_ID_COMMAND_ACK in kinds


@given(values=st.lists(st.floats(width=32), min_size=11, max_size=11), mask=st.integers(0, 65535))
@settings(max_examples=40, deadline=None)
def test_no_setpoint_can_make_the_simulation_blow_up(values: list[float], mask: int) -> None:
    app = Application(iris())
    app.peer.plant.place((0.0, 0.0, -30.0), rotors=0.58)
    app.peer.autopilot.arm()
    app.offboard(lambda t_s: message_of(1, mask, values))
    app.run(1.0)
    assert np.isfinite(app.peer.plant.state).all()


def test_euler_angles_match_the_attitude() -> None:
    for roll, pitch, yaw in product((-0.5, 0.2), (-0.7, 0.4), (-3.0, 1.0)):
        c, s = np.cos(np.array([roll, pitch, yaw]) / 2), np.sin(np.array([roll, pitch, yaw]) / 2)
        q = (
            c[0] * c[1] * c[2] + s[0] * s[1] * s[2],
            s[0] * c[1] * c[2] - c[0] * s[1] * s[2],
            c[0] * s[1] * c[2] + s[0] * c[1] * s[2],
            c[0] * c[1] * s[2] - s[0] * s[1] * c[2],
        )
        assert np.degrees(euler_rad(q)) == pytest.approx([degrees(roll), degrees(pitch), degrees(yaw)])
