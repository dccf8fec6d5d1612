"""What one vehicle of a formation says, and what it is asked for."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.codec import Encoder, Frame, Framer
from swingd.link.formation_listener import EARTH_RADIUS_M, FormationListener
from swingd.model.actions import Health, SwingReport
from swingd.model.events import Attitude, AutopilotKind, AutopilotRestart, LocalPosition
from swingd.model.formation import CableSwing, ClockAnswer, LocalOrigin, RiggedTether, RiggedVehicle, WinchTurned

RIG = RiggedVehicle(7, "udpin://:14600", (RiggedTether(1.0, (0.0, 0.0, 0.0)),), winch="WINCH")
NOTHING = (0.0, 0.0, 0.0)


class Line:
    """A listener and the frames of its vehicle."""

    def __init__(self, rig: RiggedVehicle = RIG, rate_hz: float = 50.0) -> None:
        self.listener = FormationListener(rig, rate_hz)
        self.framer = Framer()

    def say(self, t_s: float, message, component: int = 1):
        frames = self.framer.receive(Encoder(7, component).encode(message))
        return [event for frame in frames for event in self.listener.receive(t_s, frame)]

    def ask(self, t_s: float):
        return self.listener.messages(t_s)


def attitude(t_boot_s: float, yaw: float = 0.3):
    return mavlink.MAVLink_attitude_message(round(t_boot_s * 1e3), 0.1, 0.2, yaw, 0.0, 0.0, 0.0)


def position(t_boot_s: float):
    return mavlink.MAVLink_local_position_ned_message(round(t_boot_s * 1e3), 1.0, 2.0, -3.0, 0.1, 0.2, 0.3)


def heartbeat(autopilot: int = mavlink.MAV_AUTOPILOT_PX4):
    return mavlink.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3)


def swing(t_boot_s: float, health: Health = Health.READY, xi: float = 0.1):
    report = SwingReport(t_boot_s, xi, -0.2, 0.3, 0.4, NOTHING, 0.01, 0.02, 20.0, 1.0, 1.0, NOTHING, NOTHING, health)
    return swing_message.encode(report)


def origin(lat_1e7: int = 470000000):
    return mavlink.MAVLink_gps_global_origin_message(lat_1e7, 80000000, 400000)


def test_what_a_vehicle_tells_becomes_events() -> None:
    line = Line()
    line.say(10.0, heartbeat())
    (told,) = line.say(10.0, attitude(5.0))
    assert isinstance(told, Attitude)
    (told,) = line.say(10.0, position(5.0))
    assert isinstance(told, LocalPosition)
    assert told.pos_ned_m == (1.0, 2.0, -3.0)
    (told,) = line.say(10.0, swing(5.0), component=191)
    assert isinstance(told, CableSwing)
    assert (told.xi_rad, told.zeta_rad, told.xi_rate_radps) == pytest.approx((0.1, -0.2, 0.3))
    assert told.health is Health.READY
    (told,) = line.say(10.0, mavlink.MAVLink_named_value_float_message(5000, b"WINCH", 0.25), component=25)
    assert told == WinchTurned(10.0, 5.0, 0.25)
    assert line.say(10.0, mavlink.MAVLink_named_value_float_message(5000, b"OTHER", 0.25)) == []
    assert line.say(10.0, attitude(5.1), component=2) == []


@pytest.mark.parametrize(
    ("autopilot", "kind"),
    [
        (mavlink.MAV_AUTOPILOT_PX4, AutopilotKind.PX4),
        (mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, AutopilotKind.ARDUPILOT),
        (mavlink.MAV_AUTOPILOT_GENERIC, AutopilotKind.PX4),
    ],
)
def test_an_origin_is_told_once_until_it_changes(autopilot: int, kind: AutopilotKind) -> None:
    line = Line()
    line.say(10.0, heartbeat(autopilot))
    (told,) = line.say(10.0, origin())
    assert isinstance(told, LocalOrigin)
    assert told.lat_rad == pytest.approx(math.radians(47.0))
    assert told.alt_amsl_m == 400.0
    assert told.earth_radius_m == EARTH_RADIUS_M[kind]
    assert line.say(11.0, origin()) == []
    assert len(line.say(12.0, origin(470000100))) == 1


def test_a_reboot_is_told_and_the_origin_asked_for_again() -> None:
    line = Line()
    line.say(0.0, heartbeat())
    line.say(0.0, origin())
    for step in range(50):
        line.say(0.02 * step, attitude(100.0 + 0.02 * step))
    events = [event for step in range(50) for event in line.say(3.0 + 0.02 * step, attitude(0.5 + 0.02 * step))]
    assert sum(isinstance(event, AutopilotRestart) for event in events) == 1
    asked = [m.param1 for m in line.ask(5.0) if m.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_LONG]
    assert mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN in asked
    assert len(line.say(5.0, origin())) == 1


def test_nothing_is_asked_before_the_vehicle_is_heard_then_what_is_missing() -> None:
    line = Line()
    assert line.ask(0.0) == []
    line.say(0.0, heartbeat())
    asked = line.ask(0.1)
    kinds = [(m.get_type(), getattr(m, "command", 0), getattr(m, "param1", 0)) for m in asked]
    assert kinds == [
        ("TIMESYNC", 0, 0),
        ("COMMAND_LONG", mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE),
        ("COMMAND_LONG", mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
        ("COMMAND_LONG", mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN),
    ]
    assert all((m.target_system, m.target_component) == (7, 1) for m in asked[1:])
    assert line.ask(0.2) == []
    line.say(0.2, origin())
    for step in range(150):
        line.say(0.2 + 0.02 * step, attitude(0.02 * step))
        line.say(0.2 + 0.02 * step, position(0.02 * step))
    assert [m.get_type() for m in line.ask(3.2)] == ["TIMESYNC"]


def test_only_answers_to_own_questions_tell_the_clock() -> None:
    line = Line()
    line.say(1.0, heartbeat())
    question = line.ask(1.0)[0]
    assert line.say(1.1, mavlink.MAVLink_timesync_message(0, question.ts1)) == []
    assert line.say(1.1, mavlink.MAVLink_timesync_message(123, question.ts1 + 1)) == []
    (told,) = line.say(1.1, mavlink.MAVLink_timesync_message(50_000_000_000, question.ts1))
    assert told == ClockAnswer(1.1, 1.0, 50.0)
    assert line.say(1.2, mavlink.MAVLink_timesync_message(50_000_000_000, question.ts1)) == []


def test_numbers_that_are_none_are_dropped_and_counted() -> None:
    line = Line()
    assert line.say(1.0, attitude(1.0, math.nan)) == []
    assert sum(line.listener.drops.values()) == 1


@given(st.integers(0, 2**32), st.integers(0, 255), st.binary(max_size=255))
def test_no_frame_raises(at: int, component: int, payload: bytes) -> None:
    listener = FormationListener(RIG, 50.0)
    ids = sorted(mavlink.mavlink_map)
    msg_id = ids[at % len(ids)]
    raw = bytes((0xFD, len(payload), 0, 0, 0, 7, component, *msg_id.to_bytes(3, "little"))) + payload + b"\x00\x00"
    listener.receive(1.0, Frame(raw, msg_id, 7, component))
    listener.messages(1.0)
