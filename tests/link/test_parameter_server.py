import math
import struct
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link import parameter_server
from swingd.link.codec import Codec
from swingd.link.parameter_server import VALUES_PER_TICK, ParameterServer, shortest
from swingd.model.ground_parameters import BY_NAME, GROUND_PARAMETERS
from swingd.model.parameters import Parameters

from .ground_station import COMPONENT, SYSTEM, frame, on_the_wire, param_set, request_list, request_read

FLOATS_32 = st.integers(0, 2**32 - 1).map(lambda bits: struct.unpack("<f", struct.pack("<I", bits))[0])


def server(parameters: Parameters | None = None) -> ParameterServer:
    return ParameterServer(parameters or Parameters(), SYSTEM, COMPONENT)


def values_of(messages) -> dict[str, float]:
    return {m.param_id: m.param_value for m in map(on_the_wire, messages) if m.get_type() == "PARAM_VALUE"}


def errors_of(messages) -> list[tuple[str, int, int]]:
    received = map(on_the_wire, messages)
    return [(m.param_id, m.param_index, m.error) for m in received if m.get_type() == "PARAM_ERROR"]


def all_ticks(served: ParameterServer) -> list:
    messages: list = []
    while batch := served.tick():
        messages += batch
    return messages


# ------------------------------------------------------------------------------------------------------ listing


@pytest.mark.parametrize(("system", "component"), [(SYSTEM, COMPONENT), (SYSTEM, 0), (0, 0), (0, COMPONENT)])
def test_a_list_request_gives_every_parameter_once_paced(system, component):
    served = server()
    assert served.handle(0.0, frame(request_list(system, component))).messages == ()
    batches = []
    while batch := served.tick():
        batches.append([on_the_wire(message) for message in batch])
    assert all(len(batch) <= VALUES_PER_TICK for batch in batches)
    received = [message for batch in batches for message in batch]
    assert [m.param_index for m in received] == list(range(len(GROUND_PARAMETERS)))
    for message, parameter in zip(received, GROUND_PARAMETERS, strict=True):
        assert message.param_id == parameter.name
        assert message.param_count == len(GROUND_PARAMETERS)
        assert message.param_type == mavlink.MAV_PARAM_TYPE_REAL32
        assert message.param_value == pytest.approx(parameter.get(Parameters()), rel=1e-7)
    # 20 Hz: the whole list within a second of which a ground station waits several.
    assert len(batches) <= 20


@pytest.mark.parametrize(("system", "component"), [(SYSTEM, 1), (2, COMPONENT), (2, 0), (255, 190)])
def test_a_list_request_to_others_is_theirs(system, component):
    served = server()
    served.handle(0.0, frame(request_list(system, component)))
    assert served.tick() == ()


def test_the_list_gives_what_is_set_meanwhile_as_it_stands_when_it_leaves():
    served = server()
    served.handle(0.0, frame(request_list()))
    last = GROUND_PARAMETERS[-1]
    served.tick()
    assert served.handle(0.01, frame(param_set(last.name, 7.0))).changed is not None
    assert values_of(all_ticks(served))[last.name] == 7.0


def test_requests_are_for_the_system_that_swingd_belongs_to_by_then():
    served = server()
    served.system_id = 7
    assert served.handle(0.0, frame(request_read("SWG_ENABLE"))).messages == ()
    assert values_of(served.handle(0.0, frame(request_read("SWG_ENABLE", system=7))).messages) == {"SWG_ENABLE": 1.0}


# ------------------------------------------------------------------------------------------------------ reading


@pytest.mark.parametrize("parameter", GROUND_PARAMETERS, ids=lambda parameter: parameter.name)
def test_one_is_read_by_name_and_by_index(parameter):
    for request in (
        request_read(parameter.name),
        request_read(index=parameter.index),
        # With an index the name does not count.
        request_read("SWG_ENABLE", index=parameter.index, component=0),
    ):
        (message,) = server().handle(0.0, frame(request)).messages
        received = on_the_wire(message)
        assert (received.param_id, received.param_index) == (parameter.name, parameter.index)
        assert received.param_value == pytest.approx(parameter.get(Parameters()), rel=1e-7)


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("MPC_XY_VEL_MAX", -1),
        ("_HASH_CHECK", -1),
        ("", -1),
        ("swg_enable", -1),
        ("", 10_000),
        ("", -2),
        ("SWG_ENABLE", len(GROUND_PARAMETERS)),
    ],
)
def test_what_is_not_there_is_an_error_for_who_asked_only_here_and_silence_for_who_asked_all(name, index):
    reply = server().handle(0.0, frame(request_read(name, index)))
    assert errors_of(reply.messages) == [(name, index, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)]
    assert (reply.messages[0].target_system, reply.messages[0].target_component) == (255, 190)
    assert len(reply.messages) == 1
    assert server().handle(0.0, frame(request_read(name, index, component=0))).messages == ()
    assert server().handle(0.0, frame(request_read(name, index, system=0))).messages == ()


def test_without_the_error_message_in_the_dialect_there_is_silence(monkeypatch):
    monkeypatch.setattr(parameter_server, "_PARAM_ERROR", None)
    assert server().handle(0.0, frame(request_read("MPC_XY_VEL_MAX"))).messages == ()
    reply = server().handle(0.0, frame(param_set("SWG_DAMPING", 3.0)))
    assert values_of(reply.messages) == {"SWG_DAMPING": 0.5}


# ------------------------------------------------------------------------------------------------------ setting


def test_a_value_is_set_announced_and_told():
    served = server()
    reply = served.handle(1.0, frame(param_set("SWG_CABLE_LEN", 2.4)))
    assert reply.changed == replace(Parameters(), cable=replace(Parameters().cable, length_m=2.4))
    assert reply.changed is served.parameters
    assert reply.parameter is BY_NAME["SWG_CABLE_LEN"]
    assert reply.notice == "SWG_CABLE_LEN: 1.5 to 2.4 m, by 255/190"
    assert reply.refusal is None
    assert values_of(reply.messages) == {"SWG_CABLE_LEN": pytest.approx(2.4, rel=1e-7)}
    assert served.tick() == ()


def test_a_switch_is_set():
    served = server()
    reply = served.handle(1.0, frame(param_set("SWG_ENABLE", 0.0)))
    assert reply.changed is not None
    assert reply.changed.control.enabled is False
    assert served.handle(2.0, frame(param_set("SWG_ENABLE", 1.0))).changed == Parameters()


@pytest.mark.parametrize(("system", "component"), [(SYSTEM, 0), (0, 0), (0, COMPONENT), (SYSTEM, 1), (2, COMPONENT)])
def test_a_value_is_set_only_by_who_names_this_component(system, component):
    served = server()
    reply = served.handle(0.0, frame(param_set("SWG_CABLE_LEN", 2.4, system=system, component=component)))
    assert reply == type(reply)()
    assert served.parameters == Parameters()


@pytest.mark.parametrize(
    ("name", "value", "kind", "error", "refusal"),
    [
        ("SWG_DAMPING", 0.96, 9, 2, "SWG_DAMPING: 0.96 given; expected 0.05 to 0.95"),
        ("SWG_CABLE_LEN", 0.0, 9, 2, "SWG_CABLE_LEN: 0 given; expected 0.1 to 200 m"),
        ("SWG_CABLE_LEN", -math.inf, 9, 2, "SWG_CABLE_LEN: -inf given; expected 0.1 to 200 m"),
        ("SWG_LOAD_MASS", math.nan, 9, 2, "SWG_LOAD_MASS: nan given; expected 0.005 to 2000 kg"),
        ("SWG_ENABLE", 0.5, 9, 2, "SWG_ENABLE: 0.5 given; expected 0 or 1"),
        ("SWG_ENABLE", math.nan, 9, 2, "SWG_ENABLE: nan given; expected 0 or 1"),
        ("SWG_ENABLE", 1.0, 6, 7, "SWG_ENABLE: type 6 given; expected a float (9)"),
        ("SWG_CABLE_LEN", 2.0, 10, 7, "SWG_CABLE_LEN: type 10 given; expected a float (9)"),
        ("SWG_CABLE_LEN", 2.0, 0, 7, "SWG_CABLE_LEN: type 0 given; expected a float (9)"),
    ],
)
def test_what_cannot_be_set_is_answered_by_the_error_the_value_as_it_is_and_the_reason(
    name, value, kind, error, refusal
):
    served = server()
    reply = served.handle(0.0, frame(param_set(name, value, kind)))
    assert reply.changed is None
    assert reply.notice is None
    assert reply.refusal == refusal
    assert [m.get_type() for m in reply.messages] == ["PARAM_ERROR", "PARAM_VALUE"]
    assert errors_of(reply.messages) == [(name, -1, error)]
    assert values_of(reply.messages) == {name: pytest.approx(BY_NAME[name].get(Parameters()), rel=1e-7)}
    assert served.parameters == Parameters()


def test_an_unknown_name_cannot_be_set():
    served = server()
    reply = served.handle(0.0, frame(param_set("MPC_XY\x01\xff", 1.0)))
    assert reply.refusal == "MPC_XY???: no such parameter"
    assert [error for *_, error in errors_of(reply.messages)] == [mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST]
    assert served.parameters == Parameters()
    assert served.tick() == ()


def test_a_reason_is_told_once_while_the_ground_station_tries_again():
    served = server()
    told = [served.handle(t, frame(param_set("SWG_DAMPING", 3.0))).refusal for t in (0.0, 1.0, 2.0, 5.0)]
    assert [bool(text) for text in told] == [True, False, False, False]
    assert served.handle(6.0, frame(param_set("SWG_DAMPING", 4.0))).refusal
    assert not served.handle(6.9, frame(param_set("SWG_DAMPING", 5.0))).refusal
    assert served.handle(10.0, frame(param_set("SWG_DAMPING", 3.0))).refusal


@pytest.mark.parametrize("parameter", GROUND_PARAMETERS, ids=lambda parameter: parameter.name)
def test_what_is_read_and_written_back_is_no_change_at_the_bounds_either(parameter):
    for value in (parameter.low, parameter.high, parameter.get(Parameters())):
        parameters = parameter.put(Parameters(), value)
        served = server(parameters)
        (message,) = served.handle(0.0, frame(request_read(parameter.name))).messages
        read = on_the_wire(message).param_value
        reply = served.handle(0.1, frame(param_set(parameter.name, read)))
        assert (reply.changed, reply.refusal) == (None, None)
        # From elsewhere it is set to the bound itself, not to the float beside it.
        other = 1.0 - value if parameter.is_switch else parameter.low + 0.37 * (parameter.high - parameter.low)
        elsewhere = server(parameter.put(Parameters(), other))
        changed = elsewhere.handle(0.0, frame(param_set(parameter.name, read))).changed
        assert changed is not None
        assert parameter.get(changed) == value


@given(st.sampled_from(GROUND_PARAMETERS), FLOATS_32)
@example(BY_NAME["SWG_DAMPING"], math.nan)
@example(BY_NAME["SWG_VEH_DRAG"], -0.0)
@example(BY_NAME["SWG_VEH_DRAG"], 2.0**-149)
def test_any_float_is_stored_so_that_it_reads_the_same_or_refused(parameter, value):
    served = server()
    reply = served.handle(0.0, frame(param_set(parameter.name, value)))
    stored = parameter.get(served.parameters)
    assert parameter.low <= stored <= parameter.high
    assert values_of(reply.messages)[parameter.name] == struct.unpack("<f", struct.pack("<f", stored))[0]
    if reply.refusal is not None:
        assert served.parameters == Parameters()
    elif reply.changed is not None:
        assert values_of(reply.messages)[parameter.name] == value
        assert served.parameters == reply.changed != Parameters()
    else:
        assert value == values_of(reply.messages)[parameter.name]


@given(st.decimals(min_value="0.05", max_value="2000", places=3))
def test_a_number_is_kept_as_it_was_typed(number):
    reply = server().handle(0.0, frame(param_set("SWG_VEH_MASS", float(number))))
    assert (reply.changed or Parameters()).vehicle.mass_kg == float(number)


@given(FLOATS_32.filter(math.isfinite))
def test_the_shortest_number_is_the_same_float_and_no_longer_than_nine_digits(value):
    short = shortest(value)
    assert struct.pack("<f", short) == struct.pack("<f", value)
    assert short == float(f"{value:.9g}") or len(repr(short)) < len(f"{value:.9g}") + 4


# ------------------------------------------------------------------------------------- changes from elsewhere


def test_what_was_changed_elsewhere_is_announced_and_nothing_else():
    served = server()
    before = Parameters()
    after = replace(
        before,
        cable=replace(before.cable, length_m=3.0),
        control=replace(before.control, enabled=False),
        link=replace(before.link, imu_rate_hz=200.0),
    )
    served.configure(after)
    assert values_of(all_ticks(served)) == {"SWG_CABLE_LEN": 3.0, "SWG_ENABLE": 0.0}
    assert served.parameters == after
    served.configure(after)
    assert served.tick() == ()


# -------------------------------------------------------------------------------------------------- floods


REQUESTS = st.one_of(
    st.builds(request_list, st.sampled_from([0, SYSTEM]), st.sampled_from([0, COMPONENT])),
    st.builds(request_read, st.sampled_from([*BY_NAME, "X"]), st.integers(-1, 40)),
    st.builds(param_set, st.sampled_from([*BY_NAME, "X"]), FLOATS_32, st.integers(0, 11)),
)


@given(st.lists(st.lists(REQUESTS, max_size=30), max_size=8))
def test_no_flood_of_requests_makes_more_leave_than_the_pace_nor_anything_grow(rounds):
    served = server()
    codec = Codec(255, 190)
    for round_, requests in enumerate(rounds):
        sent = list(served.tick())
        for received in codec.receive(b"".join(map(codec.encode, requests))):
            sent += served.handle(0.05 * round_, received).messages
        assert len(sent) <= VALUES_PER_TICK
    # What remains is at most one value of each.
    rest = all_ticks(served)
    assert len(rest) <= len(GROUND_PARAMETERS)
    assert len(values_of(rest)) == len(rest)


def test_a_read_that_is_repeated_for_ever_starves_no_other():
    served = server()
    served.handle(0.0, frame(request_list()))
    seen: dict[str, float] = {}
    for tick in range(40):
        seen |= values_of(served.tick())
        for parameter in GROUND_PARAMETERS[:5]:
            served.handle(0.05 * tick, frame(request_read(parameter.name)))
    assert set(seen) == set(BY_NAME)


@given(st.sampled_from([20, 21, 23]), st.binary(min_size=0, max_size=60), st.booleans())
def test_any_payload_of_the_protocol_s_messages_is_borne(msg_id, payload, addressed):
    if addressed:
        # Both requests begin with the index or the target; a PARAM_SET with its value.
        start = {20: 2, 21: 0, 23: 4}[msg_id]
        payload = payload.ljust(start + 2, b"\x07")
        payload = payload[:start] + bytes([SYSTEM, COMPONENT]) + payload[start + 2 :]
    message_class = mavlink.mavlink_map[msg_id]
    packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    raw = mavlink.MAVLink_message(msg_id, message_class.msgname)._pack(packer, message_class.crc_extra, payload)
    (received,) = Codec(1, 1).receive(raw)
    served = server()
    reply = served.handle(0.0, received)
    for message in (*reply.messages, *all_ticks(served)):
        on_the_wire(message)
    for parameter in GROUND_PARAMETERS:
        assert parameter.low <= parameter.get(served.parameters) <= parameter.high


def test_other_messages_are_not_looked_at():
    served = server()
    assert served.handle(0.0, frame(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))).messages == ()
