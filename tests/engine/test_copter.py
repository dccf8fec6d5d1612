"""The same engine with a Copter: GUIDED takes the place of OFFBOARD, and the masks and streams are ArduPilot's."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.model.actions import Health
from swingd.model.events import SetpointUse
from swingd.model.parameters import SimulatedKind
from swingd.sim.autopilot import NavState

from .flight import Application, Flight, hold, inline, local_setpoint, uncorrected

Make = Callable[[], Flight]

HOVER = local_setpoint(vel=(0.0, 0.0, 0.0), yaw_rad=0.0)
VELOCITY = SetpointUse.VEL | SetpointUse.YAW
GUID_TIMEOUT_S = 3.0
"""Copter's default."""
HIGHRES_IMU = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
COPTER = {"autopilot": SimulatedKind.ARDUPILOT}


@pytest.fixture(scope="session")
def taken_off_copter() -> Flight:
    """Mode hold: taken off in GUIDED, with all records since the start."""
    return Flight(hold(**COPTER)).take_off()


@pytest.fixture(scope="session")
def _inline() -> Flight:
    """Mode inline: an application hovers through swingd, correction active."""
    flight = Flight(inline(**COPTER)).take_off()
    flight.connect().setpoint = HOVER
    return flight.run(3.0)


@pytest.fixture
def held(taken_off_copter: Flight) -> Make:
    return taken_off_copter.fork


@pytest.fixture
def flying(_inline: Flight) -> Make:
    return _inline.fork


def rms_deg(flight: Flight, begin_s: float, duration_s: float) -> float:
    return math.degrees(float(np.sqrt(np.mean(flight.chi_rad(begin_s, begin_s + duration_s) ** 2))))


def directly(flight: Flight) -> Flight:
    """Let the application of a flight talk to the autopilot itself from now on."""
    flight.applications[0] = Application(flight, None, (245, 190))
    flight.applications[0].setpoint = HOVER
    # Until swingd's own repetition has ended.
    return flight.run(0.2)


# ---------------------------------------------------------------------------------------------------------- estimate


def test_its_streams_arrive_once_each_at_the_rates_that_it_grants(taken_off_copter: Flight) -> None:
    adapter = taken_off_copter.engine.adapter
    assert adapter.drops == {}, "no stamp comes twice"
    rates = {stream.value: count / taken_off_copter.t_s for stream, count in adapter.received.items()}
    assert rates["imu"] == pytest.approx(200.0, rel=0.05), "250 Hz are asked of PX4; Copter grants 200"
    assert rates["attitude"] == pytest.approx(100.0, rel=0.05)
    assert rates["throttle"] == pytest.approx(100.0, rel=0.05)
    assert not any("asked" in text for _, text in taken_off_copter.texts)


def test_without_highres_imu_another_message_carries_the_estimate() -> None:
    flight = Flight(inline(**COPTER), without={HIGHRES_IMU}).take_off()
    application = flight.connect(direct=True)
    application.setpoint = HOVER
    flight.run(2.0)
    assert flight.health is Health.READY
    flight.forget()
    begin_s = flight.peer.t_boot_s
    application.setpoint = local_setpoint(vel=(2.0, 0.0, 0.0), yaw_rad=0.0)
    flight.run(4.0)
    assert rms_deg(flight, begin_s, 4.0) > 8.0
    assert flight.rmse_deg(begin_s) < 0.6
    assert not any("imu" in text for _, text in flight.texts), "nothing to complain about"


# -------------------------------------------------------------------------------------------------------------- hold


def test_a_take_off_in_guided_is_not_cut_short(taken_off_copter: Flight) -> None:
    """Copter ends a take-off at the first setpoint that comes; swingd is ready long before it has arrived."""
    ready_s = next(t_s for t_s, text in taken_off_copter.texts if text == "swingd ready")
    first_s = taken_off_copter.setpoints[0][0]
    height_m = {round(truth.t_boot_s, 3): -truth.pos_ned_m[2] for truth in taken_off_copter.truths}
    assert height_m[round(ready_s, 3)] < 5.0
    assert first_s > ready_s + 0.5
    assert height_m[round(first_s, 3)] > 5.2


def test_hold_flies_in_guided_and_keeps_altitude_and_heading(held: Make) -> None:
    flight = held().run(5.0)
    begin = flight.peer.truth()
    assert flight.nav_state is NavState.GUIDED
    assert flight.health is Health.ACTIVE
    flight.forget()
    flight.reference = (2.0, -1.0, 0.0)
    flight.run(6.0)
    times = [t_s for t_s, _ in flight.setpoints]
    assert max(b - a for a, b in itertools.pairwise(times)) < 0.03
    # Copter takes a velocity as a whole or not at all: the altitude is held by its third component.
    assert {setpoint.use for _, setpoint in flight.setpoints} <= {VELOCITY, VELOCITY | SetpointUse.ACC}
    assert any(setpoint.vel_ned_mps[2] != 0.0 for _, setpoint in flight.setpoints)
    truth = flight.peer.truth()
    assert truth.vel_ned_mps[:2] == pytest.approx((2.0, -1.0), abs=0.3)
    assert abs(truth.pos_ned_m[2] - begin.pos_ned_m[2]) < 0.4
    assert abs(math.remainder(truth.yaw_rad - begin.yaw_rad, 2.0 * math.pi)) < 0.1, "the nose does not follow the path"
    assert flight.peer.companion.setpoints_refused == 0


def test_hold_damps_what_guided_leaves(held: Make) -> None:
    swings = {}
    for enabled in (True, False):
        flight = held()
        flight.engine.switch_correction(flight.t_s, enabled)
        flight.run(1.0)
        begin_s = flight.peer.t_boot_s
        flight.reference = (3.0, 0.0, 0.0)
        flight.run(8.0)
        swings[enabled] = rms_deg(flight, begin_s, 8.0)
        assert flight.rmse_deg(begin_s) < 0.6
    assert swings[False] > 8.0
    assert swings[True] <= 0.6 * swings[False]


# ------------------------------------------------------------------------------------------------------------ inline


def test_a_velocity_step_of_an_application_is_damped(flying: Make) -> None:
    rms = {}
    for name, flight in (("direct", directly(flying())), ("through", flying())):
        begin_s = flight.peer.t_boot_s
        flight.applications[0].setpoint = local_setpoint(vel=(3.0, 0.0, 0.0), yaw_rad=0.0)
        flight.run(12.0)
        assert flight.nav_state is NavState.GUIDED
        assert flight.peer.truth().vel_ned_mps[0] == pytest.approx(3.0, abs=0.4)
        rms[name] = rms_deg(flight, begin_s, 12.0)
    # 0.47 with Copter's default PSC_JERK_XY of 5 m/s^3, by which it also limits the correction.
    assert rms["through"] <= 0.5 * rms["direct"]


def test_only_swingds_setpoints_reach_it_and_it_refuses_none(flying: Make) -> None:
    flight = flying()
    senders: list[int] = []

    def note(frame: object) -> bool:
        if getattr(frame, "msg_id", None) == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            senders.append(getattr(frame, "component_id", 0))
        return False

    flight.withhold = note
    flight.run(1.0)
    assert set(senders) == {191}
    assert len(senders) == pytest.approx(100, abs=3)
    assert flight.peer.companion.setpoints_refused == 0


@pytest.mark.parametrize("through", [False, True])
def test_an_application_that_dies_leaves_a_vehicle_that_stops(flying: Make, through: bool) -> None:
    flight = flying() if through else directly(flying())
    flight.applications[0].setpoint = local_setpoint(vel=(3.0, 0.0, 0.0), yaw_rad=0.0)
    flight.run(5.0)
    flight.applications[0].setpoint = None
    flight.forget()
    silent_s = flight.peer.t_boot_s
    flight.run_while(lambda: (flight.peer.autopilot.setpoint.acc_ned_mps2[0] or 0.0) > -0.5, 5.0)
    brakes_s = flight.peer.t_boot_s - silent_s
    assert GUID_TIMEOUT_S - 0.1 < brakes_s <= GUID_TIMEOUT_S + (0.6 if through else 0.2)
    if through:
        assert max(t_s for t_s, _ in flight.setpoints) - silent_s <= 0.2, "three intervals of 50 ms"
    flight.run(3.0)
    assert flight.nav_state is NavState.GUIDED
    assert math.hypot(*flight.peer.truth().vel_ned_mps) < 0.5


def test_a_position_alone_passes_untouched_and_is_flown_as_it_would_be(flying: Make) -> None:
    """Copter approaches a place by a path of its own, and a stream of swingd's would make it begin anew each time."""
    places = {}
    for name, flight in (("direct", directly(flying())), ("through", flying())):
        begin = flight.peer.truth().pos_ned_m
        flight.applications[0].setpoint = local_setpoint(pos=(begin[0] + 5.0, begin[1], begin[2]), yaw_rad=0.0)
        flight.forget()
        passed: list[bytes] = []

        def note(frame: object, passed: list[bytes] = passed) -> bool:
            if getattr(frame, "component_id", 0) == 190:
                passed.append(getattr(frame, "raw", b""))
            return False

        flight.withhold = note
        flight.run(6.0)
        places[name] = np.subtract(flight.peer.truth().pos_ned_m, begin)
        if name == "through":
            assert flight.setpoints == []
            assert len(passed) == 120
            assert len(set(passed)) == 120, "each once"
    assert places["through"] == pytest.approx(places["direct"], abs=0.3)
    assert places["through"][0] > 4.0


@pytest.mark.parametrize("what", ["path", "accelerated velocity"])
def test_what_moves_on_between_two_setpoints_moves_on_through_swingd(what: str, flying: Make) -> None:
    """Copter carries a target on by its own derivatives until the next comes; repeated, it must not be held back."""
    ends = {}
    hovering = flying()
    hovering.engine.change_parameters(hovering.t_s, uncorrected(hovering.engine.parameters), "")
    hovering.run(0.5)
    for name, flight in (("direct", directly(hovering.fork())), ("through", hovering.run(0.2))):
        application = flight.applications[0]
        begin, begin_s = flight.peer.truth().pos_ned_m, flight.t_s
        flight.forget()
        for _ in range(20):  # at 5.6 Hz, nearly as slow as is corrected
            t_s = flight.t_s - begin_s
            if what == "path":
                place = (begin[0] + 4.0 * t_s, begin[1], begin[2])
                message = local_setpoint(pos=place, vel=(4.0, 0.0, 0.0), yaw_rad=0.0)
            else:
                message = local_setpoint(vel=(0.8 * t_s, 0.0, 0.0), acc=(0.8, 0.0, 0.0), yaw_rad=0.0)
            application.setpoint = None
            application.send(message)
            flight.run(0.18)
        ends[name] = np.subtract(flight.peer.truth().pos_ned_m, begin)
        assert len(flight.setpoints) == (pytest.approx(360, abs=30) if name == "through" else 0)
    assert ends["direct"][0] > 4.0
    assert ends["through"] == pytest.approx(ends["direct"], abs=0.05)
