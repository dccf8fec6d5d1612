"""An application's setpoints on their way through swingd, in virtual time."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.model.actions import Health
from swingd.sim.autopilot import NavState

from .flight import Flight, inline, local_setpoint

HOVER = local_setpoint(vel=(0.0, 0.0, 0.0))
Make = Callable[[], Flight]


@pytest.fixture(scope="module")
def taken_off_inline() -> Flight:
    """In the air, without an application; only to be forked."""
    return Flight(inline()).take_off()


@pytest.fixture(scope="module")
def _inline(taken_off_inline: Flight) -> Flight:
    """In OFFBOARD through swingd for 3 s, correction active."""
    flight = taken_off_inline.fork()
    flight.connect().setpoint = HOVER
    return flight.run(0.5).enter_offboard().run(3.0)


@pytest.fixture
def flying(_inline: Flight) -> Make:
    return _inline.fork


def sent_setpoints(flight: Flight, duration_s: float) -> list[tuple[int, float]]:
    """Component and time of every setpoint that reaches the autopilot while the flight goes on."""
    seen: list[tuple[int, float]] = []
    receive = flight.peer.receive

    def noted(data: bytes) -> None:
        seen.extend(
            (frame.component_id, flight.t_s)
            for frame in flight.splitter().receive(data)
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
        )
        receive(data)

    flight.peer.receive = noted  # type: ignore[method-assign]
    flight.run(duration_s)
    flight.peer.receive = receive  # type: ignore[method-assign]
    return seen


def test_while_a_correction_may_leave_only_swingds_own_setpoints_do(flying: Make) -> None:
    flight = flying()
    assert flight.health is Health.ACTIVE
    seen = sent_setpoints(flight, 2.0)
    assert {component for component, _ in seen} == {191}
    assert len(seen) == pytest.approx(200, abs=4), "at the filter's rate"


def test_otherwise_only_the_applications_do(flying: Make) -> None:
    flight = flying()
    flight.engine.switch_correction(flight.t_s, False)
    flight.run(1.0)
    seen = sent_setpoints(flight, 2.0)
    assert {component for component, _ in seen} == {190}
    assert len(seen) == pytest.approx(40, abs=2), "at its own rate"
    flight.engine.switch_correction(flight.t_s, True)
    seen = sent_setpoints(flight, 2.0)
    assert {component for component, _ in seen[5:]} == {191}


def test_at_the_change_no_setpoint_is_sent_twice_and_none_is_missing(flying: Make) -> None:
    flight = flying()
    for enabled in (False, True, False):
        flight.engine.switch_correction(flight.t_s, enabled)
        seen = sent_setpoints(flight, 1.5)
        times = [t_s for _, t_s in seen]
        assert max(np.diff(times)) < 0.07
        order = [component for component, _ in seen]
        assert order == sorted(order, reverse=not enabled), "one change of hands, not two talkers"


def test_the_step_of_an_application_is_damped(taken_off_inline: Flight, flying: Make) -> None:
    rms: dict[str, float] = {}
    flight = flying()
    direct = taken_off_inline.fork()
    direct.connect(direct=True).setpoint = HOVER
    direct.run(0.5).enter_offboard().run(3.0)
    for name, one in (("direct", direct), ("through", flight)):
        assert one.nav_state is NavState.OFFBOARD
        begin_s = one.peer.t_boot_s
        one.applications[0].setpoint = local_setpoint(vel=(3.0, 0.0, 0.0))
        one.run(12.0)
        rms[name] = float(np.sqrt(np.mean(one.chi_rad(begin_s, begin_s + 12.0) ** 2)))
    assert rms["through"] < 0.45 * rms["direct"]


def test_a_position_setpoint_is_damped_and_met_exactly() -> None:
    # Errors of the autopilot's own position would hide how exactly.
    hovering = Flight(inline(gnss_pos_noise_m=0.0, gnss_vel_noise_mps=0.0)).take_off()
    hovering.connect().setpoint = HOVER
    hovering.run(0.5).enter_offboard().run(3.0)
    figures = {}
    for enabled in (False, True):
        flight = hovering.fork()
        flight.engine.switch_correction(flight.t_s, enabled)
        truth = flight.peer.truth()
        north, east, down = truth.pos_ned_m
        flight.applications[0].setpoint = local_setpoint(pos=(north + 4.0, east - 2.0, down), yaw_rad=truth.yaw_rad)
        begin_s = flight.peer.t_boot_s
        flight.run(12.0)
        swing = np.sqrt(np.mean(flight.chi_rad(begin_s, begin_s + 12.0) ** 2))
        flight.run(3.0).forget()
        flight.run(5.0)
        assert flight.nav_state is NavState.OFFBOARD
        away = np.array([truth.pos_ned_m[:2] for truth in flight.truths]) - (north + 4.0, east - 2.0)
        figures[enabled] = swing, np.sqrt(np.mean(np.sum(away**2, axis=1)))
    assert figures[True][0] < 0.6 * figures[False][0]
    assert figures[True][1] < 0.15
    assert figures[True][1] < figures[False][1] + 0.1


def test_silence_of_the_application_ends_swingds_setpoints_and_the_failsafe_acts(flying: Make) -> None:
    flight = flying()
    flight.kick(1.5, 0.0)
    flight.run(1.0)
    flight.applications[0].setpoint = None
    silent_s = flight.t_s
    seen = sent_setpoints(flight, 3.0)
    last_s = max(t_s for _, t_s in seen)
    assert last_s - silent_s <= 0.5
    assert last_s - silent_s <= 3 * 0.05 + 0.02, "three intervals of the application"
    corrections = [abs(complex(*r.correction_acc_ned_mps2[:2])) for r in flight.reports if r.t_boot_s > last_s - 0.015]
    assert corrections[0] < 0.05, "faded before"
    assert flight.nav_state is NavState.LOITER or flight.nav_state is NavState.DESCEND


def test_the_failsafe_acts_as_early_as_it_would(flying: Make) -> None:
    left_s = {}
    for through in (False, True):
        flight = flying()
        flight.engine.switch_correction(flight.t_s, through)
        flight.run(1.0)
        flight.applications[0].setpoint = None
        silent_s = flight.t_s
        flight.run_while(lambda flight=flight: flight.nav_state is NavState.OFFBOARD, 3.0)  # type: ignore[misc]
        left_s[through] = flight.t_s - silent_s
    assert left_s[True] - left_s[False] <= 0.5
    assert left_s[True] <= 1.0 + 0.6


def test_a_slow_stream_passes_uncorrected(flying: Make) -> None:
    flight = flying()
    flight.applications[0].period_s = 0.3
    flight.run(3.0)
    seen = sent_setpoints(flight, 3.0)
    assert {component for component, _ in seen} == {190}
    assert flight.nav_state is NavState.OFFBOARD


def test_an_attitude_setpoint_ends_the_repetition_at_once(flying: Make) -> None:
    flight = flying()
    flight.applications[0].setpoint = mavlink.MAVLink_set_attitude_target_message(
        0, 1, 1, 7, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.55
    )
    flight.run(0.06)
    assert sent_setpoints(flight, 1.0) == []


def test_two_applications_pass_and_are_told(flying: Make) -> None:
    flight = flying()
    flight.connect().setpoint = local_setpoint(vel=(0.0, 0.5, 0.0))
    flight.run(0.5)
    seen = sent_setpoints(flight, 3.0)
    assert {component for component, _ in seen} == {190}
    assert len(seen) == pytest.approx(120, abs=4)
    assert any("two applications" in text for _, text in flight.texts)


def test_without_a_filter_everything_passes() -> None:
    flight = Flight(inline(), joined=False)
    application = flight.connect()
    application.setpoint = HOVER
    flight.run(3.0)
    assert flight.peer.companion.setpoints == pytest.approx(60, abs=8)
    heard = {frame.msg_id for frame in application.heard()}
    assert {mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_ATTITUDE} <= heard


def test_a_filter_that_joins_in_flight_takes_over_when_it_is_settled() -> None:
    flight = Flight(inline(), joined=False)
    flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, *(math.nan for _ in range(4)))
    flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    flight.run(15.0)
    flight.connect().setpoint = HOVER
    flight.run(1.0).command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
    flight.run(2.0)
    assert flight.nav_state is NavState.OFFBOARD
    joined_s = flight.t_s
    flight.engine.join(joined_s)
    seen = sent_setpoints(flight, 12.0)
    assert flight.nav_state is NavState.OFFBOARD
    first_s = next(t_s for component, t_s in seen if component == 191)
    assert first_s - joined_s >= 2.0
    assert flight.health is Health.ACTIVE


@pytest.mark.parametrize("what", ["imu", "everything"])
def test_when_the_estimate_stalls_the_applications_setpoints_pass(flying: Make, what: str) -> None:
    flight = flying()
    flight.kick(1.0, 1.0)
    flight.run(0.5)

    def spoil(_t_s: float, frames: list[bytes]) -> list[bytes]:
        imu = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
        return [] if what == "everything" else [f for f in frames if flight.splitter().receive(f)[0].msg_id != imu]

    flight.spoil = spoil
    seen = sent_setpoints(flight, 2.0)
    times = [t_s for _, t_s in seen]
    assert max(np.diff(times)) < 0.2
    assert {component for component, t_s in seen if t_s > times[0] + 0.3} == {190}
    assert flight.nav_state is NavState.OFFBOARD


@pytest.fixture(scope="module")
def taken_off_without_correction() -> Flight:
    """In the air, with a correction of zero; only to be forked."""
    parameters = inline()
    control = replace(parameters.control, acc_max_mps2=0.0, vel_max_mps=0.0)
    return Flight(replace(parameters, control=control)).take_off()


@pytest.mark.parametrize("yaw_deg", [0.0, 60.0, -135.0])
def test_one_body_velocity_flies_as_it_would_directly(taken_off_without_correction: Flight, yaw_deg: float) -> None:
    """With a correction of zero a stream of BODY velocities takes the same path."""
    ends = []
    for direct in (True, False):
        flight = taken_off_without_correction.fork()
        application = flight.connect(direct=direct)
        application.setpoint = local_setpoint(vel=(0.0, 0.0, 0.0), yaw_rad=math.radians(yaw_deg))
        flight.run(0.5).enter_offboard().run(5.0)
        application.setpoint = local_setpoint(
            vel=(1.5, 0.5, 0.0), frame=mavlink.MAV_FRAME_BODY_NED, yaw_rad=math.radians(yaw_deg)
        )
        begin = flight.peer.truth().pos_ned_m
        flight.run(4.0)
        end = flight.peer.truth().pos_ned_m
        ends.append(np.subtract(end, begin))
        if not direct:
            assert {component for component, _ in sent_setpoints(flight, 0.5)} == {191}, "resolved and repeated"
    assert np.linalg.norm(ends[0]) > 4.0
    assert np.linalg.norm(ends[0] - ends[1]) < 0.1
