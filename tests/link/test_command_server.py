import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.link.command_server import CommandServer, RcSwitch
from swingd.model.events import PathOrder

from .ground_station import COMPONENT, SYSTEM, command_int, command_long, frame, on_the_wire

USER_1 = mavlink.MAV_CMD_USER_1
ACCEPTED, DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED


def server() -> CommandServer:
    return CommandServer(SYSTEM, COMPONENT)


def ack_of(reply) -> tuple[int, int, int, int]:
    (message,) = reply.messages
    ack = on_the_wire(message)
    assert ack.get_type() == "COMMAND_ACK"
    return ack.command, ack.result, ack.target_system, ack.target_component


@pytest.mark.parametrize("make", [command_long, command_int])
@pytest.mark.parametrize(("param1", "enabled"), [(1.0, True), (0.0, False), (-0.0, False)])
def test_the_correction_is_switched_and_the_sender_gets_the_acknowledgement(make, param1, enabled):
    reply = server().handle(0.0, frame(make(USER_1, param1), (42, 7)))
    assert reply.switch is enabled
    assert ack_of(reply) == (USER_1, ACCEPTED, 42, 7)
    assert reply.refusal is None


@pytest.mark.parametrize("param1", [0.5, 2.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("make", [command_long, command_int])
def test_a_position_that_does_not_exist_is_denied_with_the_reason(make, param1):
    reply = server().handle(0.0, frame(make(USER_1, param1)))
    assert reply.switch is None
    assert ack_of(reply) == (USER_1, DENIED, 255, 190)
    assert reply.refusal == f"MAV_CMD_USER_1: param1 {param1:g} given; expected 1 (correction on) or 0 (off)"


@pytest.mark.parametrize(
    ("system", "component"), [(SYSTEM, 0), (0, 0), (0, COMPONENT), (SYSTEM, 1), (SYSTEM, 192), (2, COMPONENT)]
)
@pytest.mark.parametrize("make", [command_long, command_int])
def test_commands_to_others_and_to_all_are_not_answered(make, system, component):
    reply = server().handle(0.0, frame(make(USER_1, 1.0, system=system, component=component)))
    assert reply == type(reply)()


@pytest.mark.parametrize(
    "command",
    [
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
        mavlink.MAV_CMD_DO_SET_MODE,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_USER_3,
        65535,
        0,
    ],
)
@pytest.mark.parametrize("make", [command_long, command_int])
def test_everything_else_is_unsupported_and_moves_nothing(make, command):
    reply = server().handle(0.0, frame(make(command, 1.0)))
    assert ack_of(reply) == (command, UNSUPPORTED, 255, 190)
    assert reply.switch is None
    assert reply.refusal is None


@pytest.mark.parametrize("make", [command_long, command_int])
@pytest.mark.parametrize(
    ("command", "param1", "order"),
    [
        (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0, PathOrder.PAUSE),
        (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0, PathOrder.CONTINUE),
        (mavlink.MAV_CMD_USER_2, 0.0, PathOrder.ABORT),
    ],
)
def test_a_path_takes_orders_while_there_is_one(make, command, param1, order):
    served = server()
    reply = served.handle(0.0, frame(make(command, param1)))
    assert ack_of(reply)[:2] == (command, DENIED)
    assert reply.order is None
    assert "mode path is not on" in reply.refusal
    served.leads = True
    reply = served.handle(1.0, frame(make(command, param1)))
    assert ack_of(reply)[:2] == (command, ACCEPTED)
    assert (reply.order, reply.switch, reply.refusal) == (order, None, None)


@pytest.mark.parametrize("param1", [0.5, 2.0, -1.0, math.nan])
@pytest.mark.parametrize("command", [mavlink.MAV_CMD_DO_PAUSE_CONTINUE, mavlink.MAV_CMD_USER_2])
def test_an_order_that_does_not_exist_is_denied_with_the_reason(command, param1):
    served = server()
    served.leads = True
    reply = served.handle(0.0, frame(command_long(command, param1)))
    assert ack_of(reply)[1] == DENIED
    assert reply.order is None
    assert f"param1 {param1:g} given; expected 0 (" in reply.refusal


def test_a_repeated_order_does_not_undo_another_one():
    served = server()
    served.leads = True
    pause = command_long(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
    assert served.handle(0.0, frame(pause)).order is PathOrder.PAUSE
    on = command_long(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
    assert served.handle(0.5, frame(on, (1, 1))).order is PathOrder.CONTINUE
    again = command_long(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0, confirmation=1)
    reply = served.handle(1.0, frame(again))
    assert (ack_of(reply)[1], reply.order) == (ACCEPTED, None)


def test_an_attempt_that_is_repeated_is_acknowledged_again_and_switches_nothing_back():
    served = server()
    assert served.handle(0.0, frame(command_long(USER_1, 1.0))).switch is True
    # GIVEN the acknowledgement was lost, and meanwhile somebody else switched off
    assert served.handle(0.5, frame(command_long(USER_1, 0.0), (1, 1))).switch is False
    # WHEN the first one tries again
    reply = served.handle(1.0, frame(command_long(USER_1, 1.0, confirmation=1)))
    # THEN it hears that its command was carried out, and off it stays
    assert ack_of(reply)[1] == ACCEPTED
    assert reply.switch is None


def test_an_attempt_whose_predecessors_were_lost_is_carried_out():
    served = server()
    assert served.handle(0.0, frame(command_long(USER_1, 0.0, confirmation=2))).switch is False
    assert served.handle(1.0, frame(command_long(USER_1, 1.0, confirmation=1))).switch is True
    # A minute later it is not the same attempt any more.
    assert served.handle(61.0, frame(command_long(USER_1, 1.0, confirmation=1))).switch is True


def test_a_command_that_is_given_again_is_carried_out_again():
    served = server()
    assert [served.handle(t, frame(command_long(USER_1, 1.0))).switch for t in (0.0, 0.1)] == [True, True]


def test_many_senders_are_not_remembered_for_ever():
    served = server()
    for sender in range(1, 255):
        assert served.handle(0.0, frame(command_long(USER_1, 1.0), (sender, 190))).switch is True
    assert len(served._done) <= 16
    # The latest are.
    assert served.handle(0.1, frame(command_long(USER_1, 1.0, confirmation=1), (254, 190))).switch is None


def test_a_reason_is_told_once_while_the_sender_tries_again():
    served = server()
    told = [served.handle(t, frame(command_long(USER_1, 3.0))).refusal for t in (0.0, 2.0, 4.0)]
    assert [bool(text) for text in told] == [True, False, False]


@given(st.sampled_from([75, 76]), st.binary(max_size=40), st.booleans(), st.booleans())
def test_any_payload_of_a_command_is_borne(msg_id, payload, addressed, ours):
    layout = {75: (30, 28), 76: (30, 28)}[msg_id]
    payload = payload.ljust(33, b"\x00")
    if addressed:
        payload = payload[: layout[0]] + bytes([SYSTEM, COMPONENT]) + payload[layout[0] + 2 :]
    if ours:
        payload = payload[: layout[1]] + USER_1.to_bytes(2, "little") + payload[layout[1] + 2 :]
    message_class = mavlink.mavlink_map[msg_id]
    packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    raw = mavlink.MAVLink_message(msg_id, message_class.msgname)._pack(packer, message_class.crc_extra, payload)
    (received,) = Codec(1, 1).receive(raw)
    reply = server().handle(0.0, received)
    assert bool(reply.messages) == (addressed or received.message.target_component == COMPONENT)
    if reply.switch is not None:
        assert ack_of(reply) == (USER_1, ACCEPTED, 255, 190)


# ------------------------------------------------------------------------------------------- remote control


def rc(width_us: int, channel: int = 8, count: int = 18) -> mavlink.MAVLink_rc_channels_message:
    widths = [1500] * 18
    widths[channel - 1] = width_us
    return mavlink.MAVLink_rc_channels_message(0, count, *widths, 200)


def moves(*widths_us: int, channel: int = 8, count: int = 18) -> list[bool | None]:
    switch = RcSwitch(channel)
    return [switch.handle(frame(rc(width, channel, count), (1, 1))) for width in widths_us]


def test_the_switch_acts_when_it_is_moved_with_a_dead_band_between():
    assert moves(1000, 1390, 1410, 1500, 1590, 1610, 2000, 1590, 1410, 1390, 1000) == [
        False, None, None, None, None, True, None, None, None, False, None,
    ]  # fmt: skip


@pytest.mark.parametrize("width_us", [1400, 1401, 1500, 1599, 1600])
def test_between_the_thresholds_nothing_is_said(width_us):
    assert moves(width_us, 2000, width_us, 1000, width_us) == [None, None, None, False, None]


def test_a_switch_that_is_on_at_the_start_turns_nothing_on_until_it_was_off():
    assert moves(2000, 2000, 1000, 2000) == [None, None, False, True]


def test_a_switch_that_is_off_at_the_start_turns_off():
    assert moves(1000, 1000) == [False, None]


@pytest.mark.parametrize("nothing", [0, 65535, 100, 5000])
def test_no_signal_says_nothing_and_is_no_position(nothing):
    assert moves(nothing, 1000, nothing, 1000, nothing, 2000, nothing, 2000) == [
        None, False, None, None, None, True, None, None,
    ]  # fmt: skip


def test_a_channel_beyond_those_that_are_received_is_no_position():
    assert moves(1000, 2000, channel=8, count=7) == [None, None]
    assert moves(1000, 2000, channel=8, count=8) == [False, True]


@pytest.mark.parametrize("channel", range(1, 19))
def test_each_channel_is_the_one_that_was_asked_for(channel):
    assert moves(1000, 2000, channel=channel) == [False, True]
    other = RcSwitch(channel % 18 + 1)
    assert other.handle(frame(rc(1000, channel), (1, 1))) is None


def test_without_a_channel_nothing_is_looked_at():
    switch = RcSwitch(0)
    assert switch.handle(frame(rc(1000), (1, 1))) is None
    assert RcSwitch(8).handle(frame(command_long(USER_1, 1.0))) is None


@given(st.lists(st.integers(0, 65535)))
def test_moves_alternate_and_each_has_its_reading(widths_us):
    said = moves(*widths_us)
    positions = [move for move in said if move is not None]
    assert all(a is not b for a, b in pairwise(positions))
    for width_us, move in zip(widths_us, said, strict=True):
        assert move is not True or width_us > 1600
        assert move is not False or 0 < width_us < 1400
