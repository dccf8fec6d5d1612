"""The whole engine between an autopilot, an application and a ground station."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from link.ground_station import command_int, command_long, param_set, request_list, request_read
from pymavlink.dialects.v20 import common as mavlink

import swingd
from swingd.config.loader import parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.link.codec import Codec, Frame
from swingd.link.port import Port
from swingd.model.actions import Health
from swingd.model.ground_parameters import BY_NAME, GROUND_PARAMETERS
from swingd.model.parameters import Mode, Parameters
from swingd.record.event_log import EventLogWriter
from swingd.replay import replay
from swingd.sim.autopilot import NavState

from .flight import Application, Flight, hold, inline, local_setpoint

KEY = bytes(range(32))
GROUND = (255, 190)
SWITCH = mavlink.MAV_CMD_USER_1
LOCAL_NED = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
HOVER = local_setpoint(vel=(0.0, 0.0, 0.0))
RC_CHANNEL = 7
RC_ON, RC_OFF = 1900, 1100
Make = Callable[[], "Flown"]


class Flown:
    """A flight in line with an application, and a ground station behind another endpoint."""

    def __init__(self, flight: Flight) -> None:
        self.flight = flight
        self.application, self.ground = flight.applications
        self.ground.heard()
        self.application.heard()
        flight.forget()

    def ask(self, message: Any, wait_s: float = 0.1) -> list[Any]:
        """Send a message of the ground station; return what swingd itself answers there, reports left out."""
        self.ground.heard()
        self.ground.send(message)
        self.flight.run(wait_s)
        return own(self.ground.heard())

    def correction_mps2(self) -> float:
        """Size of the correction at the end."""
        return math.hypot(*self.flight.reports[-1].correction_acc_ned_mps2)

    def senders(self, duration_s: float) -> list[int]:
        """Components whose setpoints reach the autopilot meanwhile."""
        return [frame.component_id for frame in to_autopilot(self.flight, duration_s) if frame.msg_id == LOCAL_NED]


def own(frames: list[Frame]) -> list[Any]:
    """What swingd itself says, but for what it says by itself all the time."""
    ignored = {mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY, mavlink.MAVLINK_MSG_ID_HEARTBEAT}
    return [frame.message for frame in frames if frame.component_id == 191 and frame.msg_id not in ignored]


def to_autopilot(flight: Flight, duration_s: float) -> list[Frame]:
    """Every frame that leaves for the autopilot while the flight goes on."""
    seen: list[Frame] = []

    def note(frame: Frame) -> bool:
        seen.append(frame)
        return False

    flight.withhold = note
    flight.run(duration_s)
    flight.withhold = None
    return seen


def connect(flight: Flight) -> Flight:
    """Let an application that hovers and a ground station come."""
    flight.connect().setpoint = HOVER
    flight.connect(endpoint=1, ids=GROUND).send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    return flight.run(0.5)


@pytest.fixture(scope="session")
def base() -> Flight:
    """In OFFBOARD through swingd, correction active, a remote control at hand; with the records since the start."""
    parameters = inline()
    parameters = replace(parameters, link=replace(parameters.link, rc_channel=RC_CHANNEL))
    flight = Flight(parameters)
    flight.peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [RC_ON]
    connect(flight.take_off()).enter_offboard().run(3.0)
    assert flight.health is Health.ACTIVE
    return flight


@pytest.fixture
def flown(base: Flight) -> Make:
    return lambda: Flown(base.fork())


# --------------------------------------------------------------------------------------------------------- parameters


def test_the_correction_is_switched_by_a_parameter_and_fades(flown: Make) -> None:
    one = flown()
    flight = one.flight
    one.application.setpoint = local_setpoint(vel=(3.0, 0.0, 0.0))
    flight.run(0.8)
    assert one.correction_mps2() > 0.5
    (answer,) = one.ask(param_set("SWG_ENABLE", 0.0), 0.02)[:1]
    assert (answer.param_id, answer.param_value, answer.param_index) == ("SWG_ENABLE", 0.0, BY_NAME["SWG_ENABLE"].index)
    assert one.correction_mps2() > 0.3, "it fades, it is not cut"
    flight.run(flight.engine.parameters.control.fade_out_s + 0.1)
    assert one.correction_mps2() == 0.0
    assert set(one.senders(0.5)) == {190}
    assert flight.engine.parameters.control.enabled is False
    one.ask(param_set("SWG_ENABLE", 1.0))
    assert set(one.senders(0.5)[5:]) == {191}
    assert any("SWG_ENABLE: 1 to 0, by 255/190" in text for _, text in flight.texts)
    assert flight.nav_state is NavState.OFFBOARD


def test_a_limit_that_is_set_holds_from_then_on(flown: Make) -> None:
    one = flown()
    one.ask(param_set("SWG_ACC_MAX", 0.4))
    one.flight.forget()
    one.flight.kick(1.5, 0.0)
    one.flight.run(2.0)
    sizes = [math.hypot(*report.correction_acc_ned_mps2) for report in one.flight.reports]
    assert max(sizes) == pytest.approx(0.4, rel=1e-3)
    assert one.flight.health is Health.ACTIVE, "the estimate goes on"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("SWG_ACC_MAX", 21.0, "SWG_ACC_MAX: 21 given; expected 0 to 20 m/s^2"),
        ("SWG_DAMPING", math.nan, "SWG_DAMPING: nan given; expected 0.05 to 0.95"),
        ("SWG_ENABLE", 0.5, "SWG_ENABLE: 0.5 given; expected 0 or 1"),
        ("SWG_NOTHING", 1.0, "SWG_NOTHING: no such parameter"),
    ],
)
def test_a_value_that_is_refused_is_answered_and_changes_nothing(
    flown: Make, name: str, value: float, words: str
) -> None:
    one = flown()
    before = one.flight.engine.parameters
    answers = one.ask(param_set(name, value))
    assert one.flight.engine.parameters == before
    assert one.flight.engine.pipeline.parameters == before
    assert {message.get_type() for message in answers} >= {"PARAM_ERROR", "STATUSTEXT"}
    if name in BY_NAME:
        (kept,) = [message for message in answers if message.get_type() == "PARAM_VALUE"]
        assert kept.param_value == pytest.approx(BY_NAME[name].get(before))
    assert [text for _, text in one.flight.texts if name in text] == [words]


def test_another_cable_begins_the_estimate_anew_and_the_application_flies_on(flown: Make) -> None:
    one = flown()
    flight = one.flight
    one.ask(param_set("SWG_CABLE_LEN", 1.6))
    assert flight.health is Health.INIT
    assert flight.engine.pipeline.parameters.cable.length_m == 1.6
    senders = one.senders(4.0)
    assert senders[0] == 191, "what is left of the correction fades first"
    assert 190 in senders
    assert senders[-1] == 191, "and comes back when the estimate has settled"
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.health is Health.ACTIVE


def test_how_often_is_reported_does_not_concern_the_estimate(flown: Make) -> None:
    one = flown()
    one.ask(param_set("SWG_REPORT_HZ", 10.0))
    assert one.flight.health is Health.ACTIVE
    one.ground.heard()
    one.flight.run(2.0)
    reports = [frame for frame in one.ground.heard() if frame.msg_id == mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY]
    assert len(reports) == pytest.approx(20, abs=1)


def test_every_parameter_is_listed_to_everybody_in_time(flown: Make) -> None:
    one = flown()
    one.ground.heard()
    one.ground.send(request_list())
    one.flight.run(1.0)
    for application in (one.ground, one.application):
        values = [m for m in own(application.heard()) if m.get_type() == "PARAM_VALUE"]
        assert [message.param_id for message in values] == [parameter.name for parameter in GROUND_PARAMETERS]
    (answer,) = one.ask(request_read("SWG_LOAD_MASS"))
    assert answer.param_value == pytest.approx(0.3)


# ------------------------------------------------------------------------------------------------------------ switches


@pytest.mark.parametrize("pack", [command_long, command_int])
def test_a_command_switches_and_its_sender_alone_is_told(flown: Make, pack: Callable[..., Any]) -> None:
    one = flown()
    one.application.heard()
    one.ground.heard()
    one.ground.send(pack(SWITCH, 0.0))
    passed = to_autopilot(one.flight, 1.0)
    assert not any(frame.system_id == 255 for frame in passed), "it is not the autopilot's business"
    (ack,) = [m for m in own(one.ground.heard()) if m.get_type() == "COMMAND_ACK"]
    assert (ack.command, ack.result) == (SWITCH, mavlink.MAV_RESULT_ACCEPTED)
    assert (ack.target_system, ack.target_component) == GROUND
    assert not any(m.get_type() == "COMMAND_ACK" for m in own(one.application.heard()))
    assert set(one.senders(0.5)) == {190}
    answers = one.ask(pack(SWITCH, 1.0))
    assert "SWG_ENABLE" in {m.param_id for m in answers if m.get_type() == "PARAM_VALUE"}, "the switch is shown"
    assert set(one.senders(0.5)[5:]) == {191}


@pytest.mark.parametrize(
    ("command", "param1", "result"),
    [
        (SWITCH, 0.5, mavlink.MAV_RESULT_DENIED),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_DO_SET_MODE, 1.0, mavlink.MAV_RESULT_UNSUPPORTED),
    ],
)
def test_no_other_command_does_anything(flown: Make, command: int, param1: float, result: int) -> None:
    one = flown()
    answers = one.ask(command_long(command, param1))
    assert [m.result for m in answers if m.get_type() == "COMMAND_ACK"] == [result]
    one.flight.run(0.5)
    assert one.flight.health is Health.ACTIVE
    assert one.flight.peer.autopilot.armed


def test_the_remote_control_switches(flown: Make) -> None:
    one = flown()
    peer = one.flight.peer
    peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [RC_OFF]
    one.flight.run(1.0)
    assert set(one.senders(0.3)) == {190}
    assert any(text == "correction off" for _, text in one.flight.texts)
    peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [1500]
    one.flight.run(0.5)
    assert set(one.senders(0.3)) == {190}, "between on and off it says nothing"
    peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [RC_ON]
    one.flight.run(1.0)
    assert set(one.senders(0.3)) == {191}


@pytest.mark.parametrize("last", ["parameter", "command", "remote control"])
@pytest.mark.parametrize("first", ["parameter", "command", "remote control"])
def test_the_last_who_moves_the_switch_counts(flown: Make, first: str, last: str) -> None:
    one = flown()

    def move(who: str, on: bool) -> None:
        if who == "parameter":
            one.ask(param_set("SWG_ENABLE", float(on)))
        elif who == "command":
            one.ask(command_long(SWITCH, float(on)))
        else:
            if on:
                # Its switch stood where it is to be moved to.
                one.flight.peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [RC_OFF]
                one.flight.run(0.5)
            one.flight.peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [RC_ON if on else RC_OFF]
            one.flight.run(0.5)

    move(first, on=False)
    one.flight.run(0.6)
    assert one.flight.health is Health.READY
    move(last, on=True)
    one.flight.run(0.3)
    assert one.flight.health is Health.ACTIVE
    assert one.ask(request_read("SWG_ENABLE"))[0].param_value == 1.0


def test_an_unrelated_parameter_does_not_move_the_switch(flown: Make) -> None:
    one = flown()
    one.ask(command_long(SWITCH, 0.0))
    one.ask(param_set("SWG_DAMPING", 0.4))
    one.flight.run(1.0)
    assert one.flight.health is Health.READY
    assert one.ask(request_read("SWG_ENABLE"))[0].param_value == 0.0


# --------------------------------------------------------------------------------------------------- what only passes


def test_a_ground_station_and_the_autopilot_talk_as_if_swingd_were_not_there(flown: Make) -> None:
    one = flown()
    flight, ground = one.flight, one.ground
    said: list[bytes] = []

    def listen(_t_s: float, frames: list[bytes]) -> list[bytes]:
        said.extend(frames)
        return frames

    flight.spoil = listen
    sent: list[bytes] = []
    heard: list[Frame] = []
    received: list[Frame] = []

    def speak(message: Any, wait_s: float = 0.3) -> list[Any]:
        sent.append(ground.send(message))
        received.extend(to_autopilot(flight, wait_s))
        answers = ground.heard()
        heard.extend(answers)
        return [frame.message for frame in answers if frame.component_id == 1]

    ground.heard()
    values = [m for m in speak(mavlink.MAVLink_param_request_list_message(1, 1), 1.5) if m.get_type() == "PARAM_VALUE"]
    assert len({message.param_index for message in values}) == values[0].param_count
    speak(mavlink.MAVLink_param_set_message(1, 1, b"MPC_TILTMAX_AIR", 40.0, mavlink.MAV_PARAM_TYPE_REAL32))
    assert flight.peer.parameters["MPC_TILTMAX_AIR"] == 40.0
    item = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_CMD_NAV_WAYPOINT)
    for message in (
        mavlink.MAVLink_mission_count_message(1, 1, 1),
        mavlink.MAVLink_mission_item_int_message(1, 1, 0, *item, 1, 1, 0, 0, 0, 0, 473977000, 85456000, 12.0),
    ):
        answers = [m.get_type() for m in speak(message)]
    assert "MISSION_ACK" in answers
    acks = speak(
        command_long(mavlink.MAV_CMD_REQUEST_MESSAGE, float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION), component=1)
    )
    assert {"COMMAND_ACK", "AUTOPILOT_VERSION"} <= {m.get_type() for m in acks}
    speak(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))

    assert [frame.raw for frame in received if frame.system_id == 255] == sent, "every byte of it, in order"
    mine = {raw for raw in said if is_for_swingd(flight, raw)}
    passed = [frame.raw for frame in heard if frame.component_id == 1]
    assert passed == [raw for raw in said if raw not in mine][: len(passed)]
    assert len(passed) >= len(said) - len(mine) - 5, "but for the last, on their way"
    assert set(one.senders(0.5)) == {191}, "the application flew on, corrected"


def is_for_swingd(flight: Flight, raw: bytes) -> bool:
    (frame,) = flight.splitter().receive(raw)
    if frame.msg_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
        return bool(frame.message.tc1 != 0)
    return (frame.target_system, frame.target_component) == (1, 191)


def test_in_shadow_every_setpoint_passes_as_it_came(flown: Make) -> None:
    one = flown()
    flight = one.flight
    flight.engine.change_parameters(flight.t_s, replace(flight.engine.parameters, mode=Mode.SHADOW), "")
    flight.run(0.2)
    one.application.setpoint = None
    sent = []
    flight.withhold = lambda frame: passed.append(frame.raw) or False if frame.msg_id == LOCAL_NED else False
    passed: list[bytes] = []
    for _ in range(20):
        sent.append(one.application.send(HOVER))
        flight.run(0.05)
    assert passed == sent
    assert flight.nav_state is NavState.OFFBOARD


def test_a_reference_of_mode_hold_is_taken_from_an_endpoint(taken_off: Flight) -> None:
    flight = taken_off.fork()
    application = flight.connect()
    reference = local_setpoint(vel=(1.5, -0.5, 0.0))
    reference.target_component = 191
    application.setpoint = reference
    flight.engine.switch_correction(flight.t_s, False)
    flight.run(0.2).enter_offboard().run(2.0)
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.setpoints[-1][1].vel_ned_mps[:2] == (1.5, -0.5)
    assert flight.peer.truth().vel_ned_mps[:2] == pytest.approx((1.5, -0.5), abs=0.4)
    assert not any(frame.component_id == 190 for frame in to_autopilot(flight, 0.5)), "it is for swingd alone"


def test_a_setpoint_for_another_vehicles_companion_is_not_swingds(taken_off: Flight) -> None:
    flight = taken_off.fork()
    other = flight.connect(endpoint=1, ids=(2, 191))
    other.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    reference = local_setpoint(vel=(1.5, 0.0, 0.0))
    reference.target_system, reference.target_component = 2, 191
    sent = flight.connect().send(reference)
    flight.run(0.1)
    assert sent in [frame.raw for frame in other.heard()]
    assert {setpoint.vel_ned_mps for _, setpoint in flight.setpoints} == {(0.0, 0.0, 0.0)}


# --------------------------------------------------------------------------------------------------- start and signing


def test_before_the_filter_is_there_a_heartbeat_says_so() -> None:
    flight = Flight(inline(), joined=False)
    application = flight.connect()
    flight.run(3.1)
    beats = [frame.message for frame in application.heard() if frame.component_id == 191 and frame.msg_id == 0]
    assert len(beats) == pytest.approx(3, abs=1)
    assert {(beat.system_status, beat.custom_mode) for beat in beats} == {(mavlink.MAV_STATE_BOOT, 0)}
    assert {beat.autopilot for beat in beats} == {mavlink.MAV_AUTOPILOT_INVALID}
    flight.engine.join(flight.t_s)
    flight.run(3.0)
    assert sum(f.component_id == 191 and f.msg_id == 0 for f in application.heard()) == pytest.approx(3, abs=1)


def signing_application(flight: Flight) -> Application:
    """An application that signs, as the autopilot demands."""
    application = flight.connect()
    port = Port(KEY, 5, frozenset(), lambda: 1.7e9 + flight.peer.t_s)
    application.seal = port.seal
    return application


def test_an_autopilot_that_demands_signatures_gets_the_applications_own_where_there_is_no_key() -> None:
    flight = Flight(inline(), signing_key=KEY)
    application = signing_application(flight)
    # swingd cannot ask for streams here.
    for msg_id in (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET):
        flight.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msg_id, 5000.0)
    flight.take_off()
    application.setpoint = HOVER
    flight.run(0.5).enter_offboard().run(1.0)
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.health is Health.READY, "it could correct"
    sent = [frame for frame in to_autopilot(flight, 1.0) if frame.msg_id == LOCAL_NED]
    assert {frame.component_id for frame in sent} == {190}
    assert len(sent) == pytest.approx(20, abs=1)
    told = [text for _, text in flight.texts if "demands signing" in text]
    assert told == ["the autopilot demands signing and link.key_file is none: setpoints pass uncorrected"]


def test_one_signed_frame_of_somebody_behind_the_autopilot_demands_nothing(flown: Make) -> None:
    one = flown()
    port = Port(KEY, 5, frozenset(), lambda: 1.7e9)
    message = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
    (frame,) = one.flight.splitter().receive(port.seal(Codec(254, 190).encode(message)))
    assert frame.signed
    one.flight.engine.receive(one.flight.t_s, 0, [frame])
    assert set(one.senders(0.5)) == {191}
    assert not any("demands signing" in text for _, text in one.flight.texts)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Flight]:
    """A signed flight in line: an application, a ground station that sets and switches, a remote control; recorded."""
    path = tmp_path_factory.mktemp("inline") / "flight.swingd"
    parameters = inline()
    link = replace(parameters.link, rc_channel=RC_CHANNEL, key_file="/etc/swingd/autopilot.key")
    parameters = replace(parameters, link=link)
    log = EventLogWriter(path, swingd.__version__, parameters_to_json(parameters))
    flight = Flight(parameters, log=log, signing_key=KEY, signs=True)
    flight.peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [RC_ON]
    signing_application(flight).setpoint = HOVER
    ground = flight.connect(endpoint=1, ids=GROUND)
    flight.take_off().enter_offboard().run(2.0)
    flight.applications[0].setpoint = local_setpoint(vel=(2.0, 0.0, 0.0))
    flight.run(1.0)
    for message in (
        param_set("SWG_ACC_MAX", 2.0),
        param_set("SWG_ACC_MAX", 99.0),
        command_long(SWITCH, 0.0),
        request_list(),
        command_long(SWITCH, 1.0),
        param_set("SWG_LOAD_MASS", 0.32),
    ):
        ground.send(message)
        flight.run(0.4)
    flight.peer.rc_channels = [1500] * (RC_CHANNEL - 1) + [RC_OFF]
    flight.run(0.5)
    flight.companion.disconnect(flight.t_s, ground.port or 0)
    flight.run(0.5)
    log.close()
    return path, flight


def test_with_the_key_it_corrects_and_nothing_is_refused(recorded: tuple[Path, Flight]) -> None:
    _, flight = recorded
    assert flight.nav_state is NavState.OFFBOARD
    assert flight.peer.refused_signatures == 0
    assert any(report.health is Health.ACTIVE for report in flight.reports)
    assert max(abs(report.correction_acc_ned_mps2[0]) for report in flight.reports) > 0.5
    assert not any("demands signing" in text for _, text in flight.texts)


def test_a_recorded_flight_in_line_replays_byte_for_byte(recorded: tuple[Path, Flight]) -> None:
    path, flight = recorded
    run = replay(path, None, parameters_from_json)
    assert run.frames_differing == 0, run.first_difference
    assert run.frames_sent > 2000
    assert run.reports == flight.reports


# ----------------------------------------------------------------------------------------------------------- preflight


def compensated(flight: Flight) -> bool:
    return flight.engine.pipeline._thrust.compensated


def test_what_the_autopilot_compensates_is_read_and_outlives_a_change_of_parameters() -> None:
    flight = Flight(hold(), px4={"MC_BAT_SCALE_EN": 1}).run(5.0)
    assert compensated(flight)
    parameters: Parameters = flight.engine.parameters
    heavier = replace(parameters, payload=replace(parameters.payload, mass_kg=0.4))
    flight.engine.change_parameters(flight.t_s, heavier, "")
    assert compensated(flight)
    # The autopilot may have been changed while it was restarted.
    flight.peer.parameters.set("MC_BAT_SCALE_EN", 0)
    flight.peer.reboot()
    flight.run(10.0)
    assert not compensated(flight)


def test_a_dangerous_loss_action_is_told_and_a_good_one_is_not(base: Flight) -> None:
    def told(flight: Flight) -> list[str]:
        return [text for _, text in flight.texts if "COM_OBL_RC_ACT" in text]

    assert len(told(base)) == 1
    assert "COM_OBL_RC_ACT = 5" in told(base)[0]
    assert not compensated(base)
    safe = Flight(hold(), px4={"COM_OBL_RC_ACT": 5}).run(6.0)
    assert told(safe) == []
