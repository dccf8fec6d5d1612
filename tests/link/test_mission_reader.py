"""The autopilot's mission, read against the simulated one, and what is refused of it."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotId
from swingd.link.codec import Codec, Frame
from swingd.link.mission_reader import ITEMS_MAX, MISSION_IDS, RETRY_S, TRIES, MissionReader
from swingd.link.setpoints import GeodeticPoint, VehicleView
from swingd.model.events import AutopilotKind, Mission
from swingd.sim import geodesy
from swingd.sim.missions import MissionItem, Missions

PX4 = AutopilotId(1, 1, AutopilotKind.PX4)
WAYPOINT = mavlink.MAV_CMD_NAV_WAYPOINT
ABOVE_HOME, ABOVE_SEA = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_FRAME_GLOBAL_INT
ORIGIN = GeodeticPoint(
    round(geodesy.LATITUDE_DEG * 1e7), round(geodesy.LONGITUDE_DEG * 1e7), round(geodesy.ALTITUDE_M * 1e3)
)
HOME = GeodeticPoint(ORIGIN.lat_1e7_deg, ORIGIN.lon_1e7_deg, ORIGIN.alt_amsl_mm + 2000)
VIEW = VehicleView(origin=ORIGIN, home=HOME)


def item(
    north_m: float,
    east_m: float,
    altitude_m: float,
    frame: int = ABOVE_HOME,
    command: int = WAYPOINT,
    hold_s: float = 0,
) -> MissionItem:
    latitude, longitude, _ = geodesy.global_of((north_m, east_m, 0.0))
    params = (hold_s, 0.0, 0.0, math.nan)
    return MissionItem(frame, command, 0, 1, params, round(latitude * 1e7), round(longitude * 1e7), altitude_m)


class Bench:
    """A reader before the simulated autopilot, on links that can lose frames."""

    def __init__(self, *items: MissionItem) -> None:
        self._sent: list[Any] = []
        self._missions = Missions(self._sent.append)
        self._missions._store(mavlink.MAV_MISSION_TYPE_MISSION, list(items))
        self._autopilot, self._swingd, self._ears = Codec(1, 1), Codec(1, 191), Codec(1, 1)
        self.reader, self.t_s, self.asked = MissionReader(191), 10.0, 0
        self.lost: Callable[[], bool] = lambda: False

    def hear(self, message: Any) -> None:
        """Let the reader hear something of the autopilot."""
        (frame,) = self._ears.receive(self._autopilot.encode(message))
        assert frame.msg_id in MISSION_IDS
        self._say(self.reader.take(self.t_s, PX4, frame))

    def _say(self, messages: list[Any]) -> None:
        for message in messages:
            self.asked += 1
            if self.lost():
                continue
            (frame,) = self._ears.receive(self._swingd.encode(message))
            self._missions.handlers()[frame.msg_id](frame, frame.message)
            answers, self._sent[:] = list(self._sent), []
            for answer in answers:
                if not self.lost():
                    self.hear(answer)

    def run(self, duration_s: float, view: VehicleView = VIEW) -> Mission | None:
        for _ in range(round(duration_s / 0.05)):
            self.t_s += 0.05
            self._say(self.reader.tick(self.t_s, PX4))
            found = self.reader.read(self.t_s, view)
            if found is not None:
                return found
        return None


def test_altitudes_above_home_and_above_sea_become_places_of_the_local_frame() -> None:
    bench = Bench(item(20.0, -5.0, 6.0), item(20.0, 15.0, geodesy.ALTITUDE_M + 9.0, ABOVE_SEA))
    found = bench.run(1.0)
    assert found is not None
    assert found.problem == ""
    first, second = found.waypoints_ned_m
    assert first == pytest.approx((20.0, -5.0, -8.0), abs=0.02), "home is 2 m above the origin"
    assert second == pytest.approx((20.0, 15.0, -9.0), abs=0.02)
    assert bench.run(5.0) is None, "told once"


def test_lost_frames_are_asked_for_again_and_silence_is_given_up() -> None:
    bench = Bench(*(item(10.0 * k, 0.0, 6.0) for k in range(1, 6)))
    losses = iter([True, False, True, False, False, False, True, False, True] + [False] * 100)
    bench.lost = lambda: next(losses)
    found = bench.run(5.0)
    assert found is not None
    assert len(found.waypoints_ned_m) == 5
    deaf = Bench(item(10.0, 0.0, 6.0))
    deaf.lost = lambda: True
    found = deaf.run(RETRY_S * (TRIES + 2))
    assert found is not None
    assert found.problem == "the autopilot does not give its mission"
    assert deaf.asked == TRIES
    deaf.lost = lambda: False
    assert deaf.run(5.0) is None
    deaf.reader.want()
    again = deaf.run(1.0)
    assert again is not None
    assert again.problem == ""


def test_an_upload_that_the_autopilot_confirms_to_somebody_is_read() -> None:
    bench = Bench(item(10.0, 0.0, 6.0))
    assert bench.run(1.0) is not None
    bench._missions._store(mavlink.MAV_MISSION_TYPE_MISSION, [item(30.0, 0.0, 6.0)])
    bench.hear(mavlink.MAVLink_mission_ack_message(255, 190, mavlink.MAV_MISSION_ERROR, 0))
    assert bench.run(1.0) is None
    bench.hear(mavlink.MAVLink_mission_ack_message(255, 190, mavlink.MAV_MISSION_ACCEPTED, 0))
    found = bench.run(1.0)
    assert found is not None
    assert found.waypoints_ned_m[0] == pytest.approx((30.0, 0.0, -8.0), abs=0.02)


def test_it_is_asked_for_when_it_is_wanted_and_not_before() -> None:
    bench = Bench(item(10.0, 0.0, 6.0))
    bench.reader.want(bench.t_s + 3.0)
    assert bench.run(2.9) is None
    assert bench.asked == 0
    assert bench.run(0.3) is not None


def test_it_waits_for_the_origin_and_for_home_where_it_needs_it() -> None:
    bench = Bench(item(10.0, 0.0, 6.0))
    assert bench.run(1.0, VehicleView()) is None
    assert bench.run(1.0, VehicleView(origin=ORIGIN)) is None
    assert bench.run(0.1) is not None
    assert Bench(item(10.0, 0.0, 500.0, ABOVE_SEA)).run(1.0, VehicleView(origin=ORIGIN)) is not None


@pytest.mark.parametrize(
    ("items", "problem"),
    [
        ([], "the autopilot has no mission"),
        (
            [item(0, 0, 6, command=mavlink.MAV_CMD_NAV_TAKEOFF), item(10, 0, 6)],
            "mission item 0: MAV_CMD_NAV_TAKEOFF given; expected nothing but MAV_CMD_NAV_WAYPOINT",
        ),
        (
            [item(10, 0, 6), item(0, 0, 0, command=mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)],
            "mission item 1: MAV_CMD_NAV_RETURN_TO_LAUNCH given; expected nothing but MAV_CMD_NAV_WAYPOINT",
        ),
        ([item(10, 0, 6, command=65535)], "mission item 0: 65535 given; expected nothing but MAV_CMD_NAV_WAYPOINT"),
        (
            [item(10, 0, 6, hold_s=5.0)],
            "mission item 0: a hold of 5 s given; expected 0: the load stops at the last one only",
        ),
        (
            [item(10, 0, 6, mavlink.MAV_FRAME_MISSION)],
            "mission item 0: frame 2 given; expected a global frame above sea or above home",
        ),
        ([item(10, 0, math.nan)], "mission item 0: a place that cannot be"),
        ([item(30_000, 0, 6)], "mission item 0: more than 10000 m from the origin"),
        ([item(10, 0, 6), item(10, 0, 6)], "mission item 1: where the one before is; expected another place"),
        ([item(10, 0, 6)] * (ITEMS_MAX + 1), f"a mission of {ITEMS_MAX + 1} items; expected at most {ITEMS_MAX}"),
    ],
)
def test_what_the_load_cannot_be_led_along_is_refused_by_name(items: list[MissionItem], problem: str) -> None:
    found = Bench(*items).run(2.0)
    assert found is not None
    assert (found.problem, found.waypoints_ned_m) == (problem, ())


@given(st.sampled_from(sorted(MISSION_IDS)), st.binary(max_size=40), st.booleans())
def test_any_payload_is_borne(msg_id: int, payload: bytes, asked: bool) -> None:
    message_class = mavlink.mavlink_map[msg_id]
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    raw = mavlink.MAVLink_message(msg_id, message_class.msgname)._pack(packer, message_class.crc_extra, payload)
    reader = MissionReader(191)
    if asked:
        reader.tick(1.0, PX4)
    frames: list[Frame] = Codec(1, 1).receive(raw)
    for frame in frames:
        assert len(reader.take(1.0, PX4, frame)) <= 1
        reader.read(1.0, VIEW)
