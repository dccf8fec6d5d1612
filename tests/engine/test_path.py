"""Mode path, in virtual time: the load is led along waypoints, by order and within the envelope."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

import swingd
from swingd.config.loader import parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.model.actions import Health
from swingd.model.events import SetpointUse
from swingd.model.parameters import Mode, Parameters, Path, SimulatedKind, Waypoint
from swingd.pipeline.path import PathState
from swingd.record.event_log import EventLogWriter
from swingd.replay import replay
from swingd.sim import geodesy
from swingd.sim.autopilot import NavState
from swingd.sim.missions import MissionItem

from .flight import Flight, FloatArray, errors_m, hold, state

SIDE_M = 20.0
SQUARE = (Waypoint(SIDE_M), Waypoint(SIDE_M, SIDE_M), Waypoint(0.0, SIDE_M), Waypoint())
PAUSE, ABORT = mavlink.MAV_CMD_DO_PAUSE_CONTINUE, mavlink.MAV_CMD_USER_2


def path(*waypoints: Waypoint, **changes: float | str) -> Parameters:
    """Mode path through places of the load."""
    flown = Path(**changes)  # type: ignore[arg-type]
    return replace(hold(), mode=Mode.PATH, waypoints=waypoints, path=flown)


def order(flight: Flight, command: int, param1: float) -> int:
    """Give swingd an order from a ground station behind an endpoint; return the answer."""
    ground = flight.applications[0] if flight.applications else flight.connect()
    ground.heard()
    ground.send(mavlink.MAVLink_command_long_message(1, 191, command, 0, param1, 0, 0, 0, 0, 0, 0))
    flight.run(0.1)
    answers = [f.message for f in ground.heard() if f.msg_id == mavlink.MAVLINK_MSG_ID_COMMAND_ACK]
    return int(next(answer.result for answer in answers if answer.command == command))


def upload(flight: Flight, *places: tuple[float, float, float]) -> None:
    """Upload a mission as a ground station behind an endpoint does: north, east, altitude above home."""
    ground = flight.connect()
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, len(places), 0))
    frame, command = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_CMD_NAV_WAYPOINT
    for _ in range(100):
        flight.run(0.05)
        for heard in ground.heard():
            if heard.msg_id == mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT and heard.target_component == 190:
                north_m, east_m, up_m = places[heard.message.seq]
                lat, lon, _ = geodesy.global_of((north_m, east_m, 0.0))
                at = (round(lat * 1e7), round(lon * 1e7), up_m)
                ground.send(
                    mavlink.MAVLink_mission_item_int_message(
                        1, 1, heard.message.seq, frame, command, 0, 1, 0.0, 0.0, 0.0, 0.0, *at, 0
                    )
                )
            elif heard.msg_id == mavlink.MAVLINK_MSG_ID_MISSION_ACK and heard.target_component == 190:
                assert heard.message.type == mavlink.MAV_MISSION_ACCEPTED
                return
    raise AssertionError("no end of the upload")


def load_m(flight: Flight) -> FloatArray:
    """(n, 3) where the load was."""
    return np.array([truth.load_pos_ned_m for truth in flight.truths])


def speed_mps(flight: Flight) -> float:
    return math.hypot(*flight.peer.truth().load_vel_ned_mps)


def led(flight: Flight) -> list[float]:
    """When accelerations were sent that lead the load."""
    motion = SetpointUse.POS | SetpointUse.VEL | SetpointUse.ACC
    return [t_s for t_s, setpoint in flight.setpoints if setpoint.use & motion == SetpointUse.ACC]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> File:
    return tmp_path_factory.mktemp("path") / "flight.swingd"


@pytest.fixture(scope="module")
def square(recording: File) -> Flight:
    """The whole square, with a pause on the way, recorded."""
    parameters = path(*SQUARE)
    log = EventLogWriter(recording, swingd.__version__, parameters_to_json(parameters))
    flight = Flight(parameters, log=log).take_off()
    flight.run_until_healthy(5.0).enter_offboard()
    flight.run_while(lambda: state(flight) is not PathState.ARRIVED, 60.0)
    flight.run(4.0)
    assert order(flight, PAUSE, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    flight.run(0.5)
    assert order(flight, PAUSE, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    flight.run(0.5)
    log.close()
    return flight


@pytest.fixture(scope="module")
def north() -> Flight:
    """The first seconds of the first leg; only to be looked at and forked."""
    flight = Flight(path(*SQUARE)).take_off()
    flight.run_until_healthy(5.0).enter_offboard()
    return flight.run(4.0)


@pytest.fixture
def on_the_way(north: Flight) -> Callable[[], Flight]:
    """Makes flights that lead the load north on the first leg."""
    return north.fork


def test_the_load_follows_the_square(square: Flight) -> None:
    begun_s = led(square)[0]
    arrived_s = next(t_s for t_s, text in square.texts if text.endswith("the load is held"))
    assert 80.0 / 2.0 < arrived_s - begun_s < 48.0, "80 m at 2 m/s"
    times = np.array([truth.t_boot_s for truth in square.truths])
    load = load_m(square)
    start = load[np.searchsorted(times, begun_s)]
    corners = start + np.array([(0.0, 0.0, 0.0), *((w.north_m, w.east_m, w.down_m) for w in SQUARE)])
    level, down = errors_m(load[(times >= begun_s) & (times < arrived_s)], corners)
    assert np.sqrt(np.mean(level**2)) < 0.6
    assert level.max() < 1.2
    assert np.sqrt(np.mean(down**2)) < 0.25
    assert math.dist(load[-1][:2], corners[-1][:2]) < 0.8
    assert math.degrees(square.chi_rad(arrived_s + 4.0, math.inf).max()) < 5.0, "held without a swing"


def test_progress_is_told(square: Flight) -> None:
    texts = [text for _, text in square.texts if text.startswith("path")]
    assert texts[0] == "path leading: waypoint 1 of 4"
    assert [text.split(",")[0].split(";")[0] for text in texts[1:5]] == [
        f"path: waypoint {k} of 4" for k in range(1, 5)
    ]
    assert texts[4].endswith("the load is held")
    assert "path paused" in texts
    progress = square.engine.pipeline.path
    assert progress is not None
    assert (progress.waypoint, progress.waypoints) == (4, 4)


def test_its_recording_replays_byte_for_byte(square: Flight, recording: File) -> None:
    run = replay(recording, None, parameters_from_json)
    assert run.frames_sent > 4000
    assert run.frames_differing == 0, run.first_difference


def test_to_the_north_it_first_asks_for_north_and_the_load_trails(north: Flight) -> None:
    begun_s = led(north)[0]
    first = [s.acc_ned_mps2 for t_s, s in north.setpoints if begun_s <= t_s < begun_s + 0.3]
    assert max(acc[0] for acc in first) > 1.0
    assert max(abs(acc[1]) for acc in first) < 0.5
    swing = [t for t in north.truths if begun_s + 0.5 < t.t_boot_s < begun_s + 1.5]
    assert min(math.degrees(t.zeta_rad) for t in swing) < -4.0, "the nose points north, and the load hangs behind"
    assert north.peer.truth().load_vel_ned_mps[0] == pytest.approx(2.0, abs=0.3)
    assert north.health is Health.ACTIVE
    assert north.engine.pipeline.withheld_by == ("the load is led along its path",)


def test_a_pause_holds_the_load_and_continuing_goes_on(on_the_way: Callable[[], Flight]) -> None:
    flight = on_the_way()
    asked_at = load_m(flight.run(0.1))[-1]
    assert order(flight, PAUSE, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    flight.run(6.0)
    place = load_m(flight)[-1]
    assert speed_mps(flight) < 0.4
    assert math.dist(place[:2], asked_at[:2]) < 3.5, "within a second's way and what the law needs besides"
    flight.run(3.0)
    assert math.dist(load_m(flight)[-1][:2], place[:2]) < 0.5
    assert state(flight) is PathState.PAUSED
    assert order(flight, PAUSE, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    flight.run(4.0)
    assert flight.peer.truth().load_vel_ned_mps[0] == pytest.approx(2.0, abs=0.4), "north again, on the same leg"
    assert state(flight) is PathState.LEADING


def test_an_abort_holds_the_vehicle_and_forgets_the_progress(on_the_way: Callable[[], Flight]) -> None:
    flight = on_the_way()
    assert order(flight, ABORT, 0.0) == mavlink.MAV_RESULT_ACCEPTED
    flight.forget()
    flight.run(6.0)
    assert led(flight) == []
    assert len(flight.setpoints) == pytest.approx(600, abs=10), "velocities of zero, corrected, go on"
    assert flight.nav_state is NavState.OFFBOARD
    assert math.hypot(*flight.peer.truth().vel_ned_mps) < 0.3
    assert state(flight) is PathState.ABORTED
    assert order(flight, PAUSE, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    flight.run(1.0)
    assert led(flight), "anew from the first waypoint"


def test_switching_the_correction_off_ends_the_leading(on_the_way: Callable[[], Flight]) -> None:
    flight = on_the_way()
    flight.engine.switch_correction(flight.t_s, False)
    flight.forget()
    flight.run(4.0)
    assert led(flight) == []
    assert math.hypot(*flight.peer.truth().vel_ned_mps) < 0.4
    assert state(flight) is PathState.INTERRUPTED


def test_leaving_offboard_ends_it_and_entering_goes_on(on_the_way: Callable[[], Flight]) -> None:
    flight = on_the_way()
    flight.leave_offboard()
    flight.run(1.1)
    flight.forget()
    flight.run(8.0)
    assert led(flight) == [], "known within a heartbeat"
    assert flight.nav_state is NavState.LOITER
    flight.enter_offboard()
    flight.run(3.0)
    assert led(flight)
    assert state(flight) is PathState.LEADING
    assert flight.peer.truth().load_vel_ned_mps[0] > 1.0


def test_a_lost_load_is_not_led(on_the_way: Callable[[], Flight]) -> None:
    flight = on_the_way()
    lost_s = flight.t_s
    flight.peer.plant.release()
    flight.run(6.0)
    assert max(led(flight)) < lost_s + 1.0
    assert flight.nav_state is NavState.OFFBOARD
    truth = flight.peer.truth()
    assert math.hypot(*truth.vel_ned_mps) < 0.3, "the vehicle stands"
    assert truth.pos_ned_m[2] < -4.0
    assert state(flight) is PathState.INTERRUPTED


def test_no_acceleration_stays_when_the_telemetry_ends(on_the_way: Callable[[], Flight]) -> None:
    """GIVEN accelerations lead the load WHEN nothing is heard any more THEN the last word is to stand."""
    flight = on_the_way()
    flight.spoil = lambda _t_s, _frames: []
    silent_s = flight.t_s
    flight.forget()
    flight.run(3.0)
    t_s, last = flight.setpoints[-1]
    assert t_s < silent_s + 0.2
    assert last.use & SetpointUse.VEL == SetpointUse.VEL
    assert not last.use & SetpointUse.ACC
    assert last.vel_ned_mps == (0.0, 0.0, 0.0)
    assert flight.nav_state is not NavState.OFFBOARD, "the autopilot's own failsafe has acted"


def test_a_load_far_from_its_path_is_not_led_until_it_is_told_to(on_the_way: Callable[[], Flight]) -> None:
    flight = on_the_way()
    place = flight.engine.parameters
    flight.engine.change_parameters(flight.t_s, replace(place, path=replace(place.path, error_max_m=0.5)), "")
    flight.peer.plant.kick((0.0, 3.0, 0.0))
    flight.run(3.0)
    assert any(text.startswith("path interrupted: the load is 0.5 m off its path") for _, text in flight.texts)
    flight.forget()
    flight.run(4.0)
    assert led(flight) == []
    reasons = flight.engine.pipeline.path_withheld_by
    assert reasons == ("interrupted: it goes on when it is continued or OFFBOARD is entered",)
    assert order(flight, PAUSE, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    flight.run(1.0)
    assert led(flight)


def test_the_load_is_led_along_the_mission_that_was_uploaded() -> None:
    flight = Flight(path(source="mission"))
    flight.run(2.0)
    assert flight.engine.pipeline.path_withheld_by[-1] == "the autopilot has no mission"
    upload(flight, (8.0, 0.0, 5.5), (8.0, 8.0, 5.5))
    flight.run(1.0)
    assert flight.texts[-1][1] == "path: 2 waypoints of the mission"
    flight.take_off().run_until_healthy(5.0).enter_offboard()
    flight.run_while(lambda: state(flight) is not PathState.ARRIVED, 30.0)
    flight.run(5.0)
    assert load_m(flight)[-1] == pytest.approx((8.0, 8.0, -5.5), abs=0.7)
    told_s = [t_s for t_s, text in flight.texts if text.endswith("of the mission")]
    assert len(told_s) <= 2, "once more at most, from where home was set at arming"
    assert max(told_s) < led(flight)[0]
    assert mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT in flight.sent_ids


def test_a_mission_of_other_items_is_refused_by_name() -> None:
    flight = Flight(path(source="mission"))
    take_off = MissionItem(3, mavlink.MAV_CMD_NAV_TAKEOFF, 1, 1, (0.0, 0.0, 0.0, 0.0), 0, 0, 5.0)
    flight.peer._face.missions._store(mavlink.MAV_MISSION_TYPE_MISSION, [take_off])
    flight.run(3.0)
    problem = "mission item 0: MAV_CMD_NAV_TAKEOFF given; expected nothing but MAV_CMD_NAV_WAYPOINT"
    assert f"path: {problem}" in [text for _, text in flight.texts]
    assert flight.engine.pipeline.path_withheld_by[-1] == problem


def test_copter_holds_and_is_not_led() -> None:
    parameters = path(*SQUARE)
    simulation = replace(parameters.simulation, autopilot=SimulatedKind.ARDUPILOT)
    flight = Flight(replace(parameters, simulation=simulation)).take_off()
    flight.run_until_healthy(10.0).enter_offboard().run(2.0)
    assert led(flight) == []
    assert flight.setpoints
    assert "only PX4 can be led along a path" in flight.engine.pipeline.path_withheld_by
