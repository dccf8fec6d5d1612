"""The MISSION protocol: what is uploaded comes back, and what goes wrong is answered."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from .rigs import Application, as_copter, iris

MISSION = mavlink.MAV_MISSION_TYPE_MISSION
FENCE = mavlink.MAV_MISSION_TYPE_FENCE


@pytest.fixture
def app() -> Application:
    application = Application(iris())
    application.keep = True
    application.run(0.1)
    return application


def item_of(seq: int, kind: int = MISSION, **changes: Any) -> dict[str, Any]:
    fields = {
        "target_system": 1,
        "target_component": 1,
        "seq": seq,
        "frame": mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        "command": mavlink.MAV_CMD_NAV_WAYPOINT,
        "current": int(seq == 0),
        "autocontinue": 1,
        "param1": 0.5 * seq,
        "param2": 1.0,
        "param3": 2.0,
        "param4": -0.25,
        "x": 473977420 + 1000 * seq,
        "y": 85455940 - 1000 * seq,
        "z": 10.5 + seq,
        "mission_type": kind,
    }
    return {**fields, **changes}


def upload(app: Application, items: list[dict[str, Any]], kind: int = MISSION) -> int:
    """Upload as a ground station does and give the MAV_MISSION_RESULT."""
    app.messages.clear()
    app.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), kind))
    for _ in range(len(items) + 2):
        app.run(0.02)
        acks = app.of_type("MISSION_ACK")
        if acks:
            assert acks[-1].mission_type == kind
            return int(acks[-1].type)
        request = app.of_type("MISSION_REQUEST_INT")[-1]
        assert (request.target_system, request.target_component) == (1, 191)
        app.send(mavlink.MAVLink_mission_item_int_message(**items[request.seq]))
    raise AssertionError("no MISSION_ACK")


def download(app: Application, kind: int = MISSION) -> list[dict[str, Any]]:
    app.messages.clear()
    app.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))
    app.run(0.02)
    (count,) = app.of_type("MISSION_COUNT")
    for seq in range(count.count):
        app.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq, kind))
        app.run(0.02)
    app.send(mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_ACCEPTED, kind))
    app.run(0.02)
    items = [message.to_dict() for message in app.of_type("MISSION_ITEM_INT")]
    for item in items:
        assert (item.pop("target_system"), item.pop("target_component")) == (1, 191)
        item.pop("mavpackettype")
    return items


def expected(items: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{name: value for name, value in item.items() if not name.startswith("target")} for item in items]


@pytest.mark.parametrize(("kind", "count"), [(MISSION, 7), (MISSION, 1), (FENCE, 4), (2, 3)])
def test_what_is_uploaded_comes_back(app: Application, kind: int, count: int) -> None:
    items = [item_of(seq, kind, current=int(seq == 2 and kind == MISSION)) for seq in range(count)]
    if count == 1:
        items[0]["current"] = 1
    assert upload(app, items, kind) == mavlink.MAV_MISSION_ACCEPTED
    assert download(app, kind) == expected(items)
    # Each kind is a list of its own.
    assert download(app, FENCE if kind != FENCE else MISSION) == []


def test_a_new_mission_takes_the_place_of_the_old_and_can_be_cleared(app: Application) -> None:
    upload(app, [item_of(seq) for seq in range(5)])
    upload(app, [item_of(seq, z=50.0) for seq in range(2)])
    assert download(app) == expected([item_of(seq, z=50.0) for seq in range(2)])
    upload(app, [item_of(seq, FENCE) for seq in range(3)], FENCE)
    app.send(mavlink.MAVLink_mission_clear_all_message(1, 1, MISSION))
    app.run(0.02)
    assert app.of_type("MISSION_ACK")[-1].type == mavlink.MAV_MISSION_ACCEPTED
    assert download(app) == []
    assert len(download(app, FENCE)) == 3
    app.send(mavlink.MAVLink_mission_clear_all_message(1, 1, mavlink.MAV_MISSION_TYPE_ALL))
    app.run(0.02)
    assert download(app, FENCE) == []
    assert upload(app, []) == mavlink.MAV_MISSION_ACCEPTED


def test_a_mission_survives_a_reboot_and_a_broken_upload_changes_nothing(app: Application) -> None:
    items = [item_of(seq) for seq in range(3)]
    upload(app, items)
    app.send(mavlink.MAVLink_mission_count_message(1, 1, 5, MISSION))
    app.run(0.1)
    app.send(mavlink.MAVLink_mission_item_int_message(**item_of(0, z=99.0)))
    app.run(0.1)
    app.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    app.run(3.5)
    assert download(app) == expected(items)


def test_what_does_not_come_is_asked_for_again_and_given_up(app: Application) -> None:
    app.send(mavlink.MAVLink_mission_count_message(1, 1, 2, MISSION))
    app.run(4.9)
    asked = app.of_type("MISSION_REQUEST_INT")
    assert {request.seq for request in asked} == {0}
    assert len(asked) == pytest.approx(4.9 / 0.252, abs=1)
    app.run(1.0)
    app.messages.clear()
    app.run(2.0)
    assert not app.of_type("MISSION_REQUEST_INT")
    assert upload(app, [item_of(0)]) == mavlink.MAV_MISSION_ACCEPTED


def test_only_the_partner_and_only_the_item_that_is_due_count(app: Application) -> None:
    app.send(mavlink.MAVLink_mission_count_message(1, 1, 2, MISSION))
    app.run(0.1)
    app.messages.clear()
    app.peer.receive(app.ground.encode(mavlink.MAVLink_mission_item_int_message(**item_of(0, z=1.0))))
    app.send(mavlink.MAVLink_mission_item_int_message(**item_of(1, z=2.0)))
    app.run(0.1)
    (ack,) = app.of_type("MISSION_ACK")
    assert (ack.target_system, ack.type) == (255, mavlink.MAV_MISSION_ERROR)
    app.peer.receive(app.ground.encode(mavlink.MAVLink_mission_count_message(1, 1, 3, MISSION)))
    for seq in range(2):
        app.send(mavlink.MAVLink_mission_item_int_message(**item_of(seq)))
        app.run(0.05)
    assert [(ack.target_system, ack.type) for ack in app.of_type("MISSION_ACK")][1:] == [(255, 1), (1, 0)]
    assert download(app) == expected([item_of(0), item_of(1)])


def test_the_last_item_again_is_acknowledged_again(app: Application) -> None:
    upload(app, [item_of(0), item_of(1)])
    app.messages.clear()
    app.send(mavlink.MAVLink_mission_item_int_message(**item_of(1)))
    app.run(0.05)
    assert [ack.type for ack in app.of_type("MISSION_ACK")] == [mavlink.MAV_MISSION_ACCEPTED]
    app.send(mavlink.MAVLink_mission_item_int_message(**item_of(0)))
    app.run(0.05)
    assert [ack.type for ack in app.of_type("MISSION_ACK")][1:] == [mavlink.MAV_MISSION_ERROR]


@pytest.mark.parametrize(
    ("kind", "count", "result"),
    [(MISSION, 3000, mavlink.MAV_MISSION_NO_SPACE), (FENCE, 65, mavlink.MAV_MISSION_NO_SPACE),
     (77, 1, mavlink.MAV_MISSION_UNSUPPORTED)],
)  # fmt: skip
def test_what_cannot_be_stored_is_refused(app: Application, kind: int, count: int, result: int) -> None:
    app.send(mavlink.MAVLink_mission_count_message(1, 1, count, kind))
    app.run(0.05)
    (ack,) = app.of_type("MISSION_ACK")
    assert (ack.type, ack.mission_type) == (result, kind)


def test_an_item_in_an_unknown_frame_ends_the_upload(app: Application) -> None:
    assert upload(app, [item_of(0), item_of(1, frame=mavlink.MAV_FRAME_LOCAL_ENU)]) == (
        mavlink.MAV_MISSION_UNSUPPORTED_FRAME
    )
    assert download(app) == []


def test_items_in_floats_come_back_in_floats_or_whole_numbers(app: Application) -> None:
    item = item_of(0, frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, x=47.25, y=8.5)
    app.send(mavlink.MAVLink_mission_count_message(1, 1, 1, MISSION))
    app.run(0.05)
    app.send(mavlink.MAVLink_mission_item_message(**item))
    app.run(0.05)
    (got,) = download(app)
    assert (got["x"], got["y"]) == (472500000, 85000000)
    app.send(mavlink.MAVLink_mission_request_list_message(1, 1, MISSION))
    app.run(0.05)
    app.send(mavlink.MAVLink_mission_request_message(1, 1, 0, MISSION))
    app.run(0.05)
    (floats,) = app.of_type("MISSION_ITEM")
    assert (floats.x, floats.y, floats.z) == (47.25, 8.5, 10.5)


def test_the_current_item_is_told_once_a_second_and_can_be_set(app: Application) -> None:
    app.run(3.0)
    told = app.of_type("MISSION_CURRENT")
    assert 3 <= len(told) <= 4
    assert (told[-1].seq, told[-1].total) == (0, 65535)
    upload(app, [item_of(seq) for seq in range(4)])
    app.send(mavlink.MAVLink_mission_set_current_message(1, 1, 3))
    app.send(mavlink.MAVLink_mission_set_current_message(1, 1, 4))
    app.run(1.1)
    told = app.of_type("MISSION_CURRENT")
    assert (told[-1].seq, told[-1].total) == (3, 4)
    assert [item["current"] for item in download(app)] == [0, 0, 0, 1]


def test_starting_a_mission_is_refused(app: Application) -> None:
    upload(app, [item_of(seq) for seq in range(2)])
    app.messages.clear()
    app.command(mavlink.MAV_CMD_MISSION_START)
    app.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 4)
    app.run(0.1)
    assert app.acks() == {
        mavlink.MAV_CMD_MISSION_START: [mavlink.MAV_RESULT_UNSUPPORTED],
        mavlink.MAV_CMD_DO_SET_MODE: [mavlink.MAV_RESULT_TEMPORARILY_REJECTED],
    }


def test_requests_to_everybody_are_not_for_px4(app: Application) -> None:
    app.messages.clear()
    app.send(
        mavlink.MAVLink_mission_request_list_message(0, 0, MISSION),
        mavlink.MAVLink_mission_request_list_message(1, 191, MISSION),
        mavlink.MAVLink_mission_request_list_message(1, 0, FENCE),
    )
    app.run(0.1)
    assert [count.mission_type for count in app.of_type("MISSION_COUNT")] == [FENCE]


def test_copter_puts_home_first() -> None:
    app = Application(as_copter(iris()))
    app.keep = True
    app.run(0.1)
    items = [item_of(seq, current=int(seq == 0)) for seq in range(3)]
    assert upload(app, items) == mavlink.MAV_MISSION_ACCEPTED
    got = download(app)
    assert got[1:] == expected(items)[1:]
    assert (got[0]["x"], got[0]["y"], got[0]["z"]) == (473977420, 85455940, 488.0)
