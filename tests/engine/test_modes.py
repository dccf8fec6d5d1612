"""What leaves for the autopilot, and when: no mode but OFFBOARD is corrected, nothing arms, nothing asks for a mode."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.model.actions import Health
from swingd.model.events import SetpointUse
from swingd.model.parameters import Mode
from swingd.sim.autopilot import NavState

from .flight import QUESTIONS, SAID, Flight, hold

ACC = SetpointUse.ACC_N | SetpointUse.ACC_E
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


def step(flight: Flight) -> None:
    """Ask for another velocity, which makes the load swing."""
    flight.reference = (0.0, 0.0, 0.0) if flight.reference == (3.0, -2.0, 0.0) else (3.0, -2.0, 0.0)


def test_in_shadow_no_setpoint_ever_leaves() -> None:
    flight = Flight(replace(hold(), mode=Mode.SHADOW))
    flight.reference = (2.0, 0.0, 0.0)
    flight.take_off()
    assert flight.health is Health.READY
    flight.kick(1.0, 0.5)
    flight.enter_offboard()
    assert flight.nav_state is not NavState.OFFBOARD, "nobody streams setpoints"
    assert flight.setpoints == []
    assert flight.sent_ids - QUESTIONS == SAID - {SETPOINT}
    assert flight.peer.companion.setpoints == 0


def test_from_ready_on_the_reference_is_streamed_whatever_the_mode(taken_off: Flight) -> None:
    assert taken_off.nav_state is NavState.LOITER
    ready_s = next(report.t_boot_s for report in taken_off.reports if report.health is Health.READY)
    times = [t_s for t_s, _ in taken_off.setpoints]
    assert times[0] == pytest.approx(ready_s, abs=0.02)
    assert max(b - a for a, b in itertools.pairwise([*times, taken_off.t_s])) < 0.05
    assert taken_off.sent_ids - QUESTIONS == SAID
    swinging = taken_off.fork()
    swinging.kick(1.5, -1.0)
    swinging.run(2.0)
    assert swinging.health is Health.READY
    for _, setpoint in taken_off.setpoints + swinging.setpoints:
        assert not setpoint.use & ACC, "no correction outside of OFFBOARD, however much it swings"
        assert setpoint.vel_ned_mps == (0.0, 0.0, 0.0)
    assert all(report.correction_acc_ned_mps2 == (0.0, 0.0, 0.0) for report in swinging.reports)


def test_each_entry_of_offboard_begins_at_zero(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    control = flight.engine.pipeline.parameters.control
    for _ in range(2):
        step(flight)
        flight.run(1.0)
        assert flight.health is Health.ACTIVE
        corrected = [setpoint for _, setpoint in flight.setpoints if setpoint.use & ACC]
        assert max(math.hypot(*setpoint.acc_ned_mps2) for setpoint in corrected) > 0.5
        step(flight)
        flight.run(0.5)
        flight.leave_offboard()
        flight.run(1.2)
        assert flight.nav_state is NavState.LOITER
        assert flight.health is Health.READY, "seen within a heartbeat"
        flight.forget()
        flight.run(0.3)
        assert not any(setpoint.use & ACC for _, setpoint in flight.setpoints)
        flight.forget()
        flight.enter_offboard()
        assert flight.nav_state is NavState.OFFBOARD
        corrected = [setpoint for _, setpoint in flight.setpoints if setpoint.use & ACC]
        assert corrected
        for k, setpoint in enumerate(corrected[:40]):
            ramp = 0.0101 * (k + 1) / control.fade_in_s
            assert math.hypot(*setpoint.acc_ned_mps2) <= ramp * control.acc_max_mps2 + 0.01
            # Half of the ramp's square is its integral; the velocity carries the ramp once more.
            assert math.hypot(*setpoint.vel_ned_mps) <= 0.5 * ramp**2 * control.fade_in_s * control.acc_max_mps2 + 1e-3
        flight.forget()


def test_the_user_switches_the_correction(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    step(flight)
    flight.run(0.8)
    flight.engine.switch_correction(flight.t_s, False)
    flight.forget()
    flight.run(1.0)
    assert flight.health is Health.READY
    sizes = [math.hypot(*report.correction_acc_ned_mps2) for report in flight.reports]
    fade_s = flight.engine.pipeline.parameters.control.fade_out_s
    assert sizes[0] > 0.5
    assert max(sizes[round(fade_s / 0.01) + 2 :]) == 0.0
    assert max(abs(b - a) for a, b in itertools.pairwise(sizes)) < 0.3
    assert len(flight.setpoints) == pytest.approx(100, abs=3), "the reference goes on"
    flight.engine.switch_correction(flight.t_s, True)
    flight.run(2.0)
    assert flight.health is Health.ACTIVE


def test_landing_and_disarming_end_the_stream() -> None:
    flight = Flight(hold(takeoff_altitude_m=3.0)).take_off()
    assert flight.setpoints
    flight.command(mavlink.MAV_CMD_NAV_LAND)
    flight.run_while(lambda: flight.peer.autopilot.armed, 40.0)
    flight.run(1.5)
    flight.forget()
    flight.run(2.0)
    assert flight.setpoints == []
    assert flight.health is Health.INIT


def test_new_parameters_in_flight_keep_the_vehicle_in_offboard(hovering: Callable[[], Flight]) -> None:
    """The estimate begins anew, but the stream that the autopilot lives on does not end."""
    flight = hovering()
    step(flight)
    flight.run(0.6)
    changed = flight.engine.pipeline.parameters
    flight.forget()
    flight.engine.change_parameters(flight.t_s, replace(changed, payload=replace(changed.payload, mass_kg=0.35)), "")
    flight.run(5.0)
    times = [t_s for t_s, _ in flight.setpoints]
    assert max(b - a for a, b in itertools.pairwise(times)) < 0.1
    assert flight.nav_state is NavState.OFFBOARD
    healths = [report.health for report in flight.reports]
    assert healths[0] is Health.INIT
    assert healths[-1] is Health.ACTIVE
    settling = [report for report in flight.reports if report.health is Health.INIT]
    fade_s = changed.control.fade_out_s
    faded = [report for report in settling if report.t_boot_s > settling[0].t_boot_s + fade_s]
    assert len(faded) > 100
    assert all(report.correction_acc_ned_mps2 == (0.0, 0.0, 0.0) for report in faded)


def test_the_state_is_told_without_a_flood(taken_off: Flight) -> None:
    flight = taken_off.fork().enter_offboard().run(1.5)
    told = [text for _, text in taken_off.texts + flight.texts]
    assert [text for text in told if text.startswith("swingd")] == [
        "swingd init: vehicle on ground",
        "swingd init: cable slack",
        "swingd init: the estimate is settling",
        "swingd ready",
        "swingd active",
    ]
    said = [text for _, _, text in flight.peer.companion.status_texts]
    assert [text for text in said if text.startswith("swingd")] == [text for text in told if text.startswith("swingd")]
    assert any(text.startswith("preflight: COM_OBL_RC_ACT is 0") for text in said), "what is dangerous is told as well"
    assert flight.t_s - flight.peer.companion.heartbeat_t_s < 1.1
    received_hz = len(flight.peer.companion.reports) / flight.t_s
    assert received_hz == pytest.approx(50.0, rel=0.1)
