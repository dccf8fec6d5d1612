"""Loads that are released, set down, picked up, weighed or missing, on the whole engine."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from swingd.model.actions import Health
from swingd.model.parameters import MassUse, Parameters
from swingd.pipeline.payload_state import PayloadState
from swingd.sim.autopilot import NavState

from .flight import Flight, hold, inline, local_setpoint

SEEN_S = 1.0
FADED_S = 1.5


def corrections_mps2(flight: Flight, begin_s: float) -> float:
    """Largest acceleration correction from then on."""
    return max(math.hypot(*r.correction_acc_ned_mps2) for r in flight.reports if r.t_boot_s >= begin_s)


def state_after_release(flight: Flight) -> PayloadState:
    """Release the load; hold what must follow, and return what it is taken for."""
    flight.peer.plant.release()
    flight.forget()
    begin_s = flight.t_s
    flight.run(SEEN_S)
    state = flight.engine.pipeline.payload
    flight.run(2.0)
    assert flight.engine.pipeline.payload is state
    assert flight.health is Health.INIT
    assert corrections_mps2(flight, begin_s + FADED_S) == 0.0
    assert sum(state.value in text for _, text in flight.texts) >= 1
    told = [text for _, text in flight.texts if text.startswith(f"{state.value}: ")]
    assert len(told) == 1, "told once, with the reason"
    return state


def climb(flight: Flight) -> None:
    flight.reference = (0.0, 0.0, -2.5)
    flight.run(1.0)


def cruise(flight: Flight) -> None:
    flight.reference = (4.0, 0.0, 0.0)
    flight.run(3.0)


def swing(flight: Flight) -> None:
    flight.kick(1.5, 0.0)
    flight.run(0.6)


def blow(flight: Flight) -> None:
    flight.peer.plant.set_wind((6.0, -2.0, 0.0))
    flight.peer.plant.set_gusts(2.0, 1.0, seed=3)
    flight.run(4.0)


@pytest.mark.parametrize("before", [None, climb, cruise, swing, blow], ids=lambda f: f.__name__ if f else "hover")
def test_a_release_is_seen_within_a_second_and_the_correction_faded(
    hovering: Callable[[], Flight], before: Callable[[Flight], None] | None
) -> None:
    flight = hovering()
    if before is not None:
        before(flight)
    assert flight.engine.pipeline.payload is PayloadState.ATTACHED
    assert state_after_release(flight) is PayloadState.RELEASED


def test_a_release_is_seen_while_the_scale_is_being_found() -> None:
    """The thrust is 10 % less than the curve says, and the battery loses 20 % of it in 40 s, which nobody tells."""
    truth = hold(thrust_factor=0.9, battery_full_v=16.2, battery_empty_v=14.5, battery_drain_s=40.0)
    told = replace(truth, thrust=replace(truth.thrust, voltage_exponent=0.0))
    flight = Flight(truth, told).take_off().enter_offboard()
    scale = flight.reports[-1].thrust_scale
    flight.run(3.0)
    assert scale - flight.reports[-1].thrust_scale > 0.005, "it is being found"
    assert not any("release" in text or "set down" in text for _, text in flight.texts), "and no sag was a release"
    assert flight.peer.truth().thrust_factor < 0.84
    assert state_after_release(flight) is PayloadState.RELEASED


def test_falling_and_climbing_hard_with_a_load_is_no_release() -> None:
    limits = {
        "MPC_ACC_DOWN_MAX": 9.5,
        "MPC_ACC_UP_MAX": 6.0,
        "MPC_THR_MIN": 0.0,
        "MPC_Z_VEL_MAX_DN": 6.0,
        "MPC_Z_VEL_MAX_UP": 6.0,
        "MPC_Z_VEL_P_ACC": 12.0,
    }
    flight = Flight(hold(takeoff_altitude_m=8.0), px4=limits).take_off().enter_offboard()
    flight.forget()
    for down_mps in (-5.0, 0.0, -5.0, 0.0, 0.0):
        flight.reference = (0.0, 0.0, down_mps)
        flight.run(1.2)
    down = np.array([truth.acc_ned_mps2[2] for truth in flight.truths])
    assert down.min() < -5.0, "it did climb hard"
    assert 0.004 * np.count_nonzero(down > 8.5) > 0.3, "and fell freely"
    assert min(truth.tension_n for truth in flight.truths) == 0.0
    assert flight.engine.pipeline.payload is PayloadState.ATTACHED
    assert not any(text.startswith("load") for _, text in flight.texts), flight.texts


def test_a_load_that_is_set_down_and_lifted_again_is_weighed(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    flight.reference = (0.0, 0.0, 1.2)
    flight.run_while(lambda: flight.peer.truth().taut, 6.0)
    flight.run(0.9)
    assert flight.engine.pipeline.payload is PayloadState.TOUCHED_DOWN
    flight.reference = (0.0, 0.0, 0.0)
    flight.run(2.0)
    assert flight.health is Health.INIT
    assert (flight.reports[-1].xi_rad, flight.reports[-1].zeta_rad) == pytest.approx((0.0, 0.0), abs=1e-6)
    flight.reference = (0.0, 0.0, -1.0)
    flight.run_while(lambda: not flight.peer.truth().taut, 6.0)
    flight.run(1.0)
    assert flight.engine.pipeline.payload is PayloadState.ATTACHED
    flight.run(2.0)
    flight.reference = (0.0, 0.0, 0.0)
    flight.run(4.0)
    report = flight.reports[-1]
    assert report.payload_mass_kg == pytest.approx(0.3, abs=0.03)
    assert report.payload_mass_std_kg is not None
    assert abs(report.payload_mass_kg - 0.3) < 3.0 * report.payload_mass_std_kg


@pytest.mark.parametrize("use", [MassUse.REPORT, MassUse.USE])
def test_a_heavier_load_picked_up_in_flight_is_weighed_and_used_where_that_is_wanted(use: MassUse) -> None:
    """The thrust is 8 % more than the curve says: against the curve alone the load would weigh 0.26 kg."""
    truth = hold(thrust_factor=1.08)
    truth = replace(truth, payload=replace(truth.payload, estimate_mass=use))
    flight = Flight(truth)
    flight.peer.plant.release()
    flight.take_off()
    flight.peer.plant.set_load_mass(0.5)
    flight.peer.plant.hook()
    flight.run(1.0)
    assert flight.engine.pipeline.payload is PayloadState.ATTACHED
    flight.run_until_healthy(3.0)
    flight.enter_offboard().run(4.0)
    mass = flight.engine.pipeline.payload_mass
    assert mass.mass_kg == pytest.approx(0.5, abs=0.02)
    resets = sum(flight.engine.pipeline.resets.values())
    told = [text for _, text in flight.texts if "kg by thrust" in text]
    assert len(told) == 1
    assert told[0].endswith("now used") is (use is MassUse.USE)
    flight.run(3.0)
    flight.forget()
    flight.kick(1.2, -0.8)
    flight.run(6.0)
    assert sum(flight.engine.pipeline.resets.values()) == resets, "begun anew once at most"
    assert flight.health is Health.ACTIVE


@pytest.mark.parametrize("factor", [1.0, 0.88])
def test_without_a_load_there_is_no_swing_and_no_correction(factor: float) -> None:
    """With the thrust curve 12 % wrong the vehicle seems to carry almost what the load weighs."""
    truth = inline(thrust_factor=factor, wind_ned_mps=(4.0, 2.0, 0.0), gust_std_mps=1.0, takeoff_altitude_m=4.0)
    flight = Flight(truth, inline(takeoff_altitude_m=4.0))
    flight.peer.plant.release()
    flight.take_off()
    application = flight.connect()
    application.setpoint = local_setpoint(vel=(3.0, -2.0, -1.0))
    flight.run(0.5).enter_offboard().run(1.5)
    assert flight.nav_state is NavState.OFFBOARD
    application.setpoint = local_setpoint(vel=(0.0, 0.0, 1.0))
    flight.run(2.0)
    swing = np.array([[report.xi_rad, report.zeta_rad] for report in flight.reports])
    assert np.degrees(np.sqrt(np.mean(swing**2))) < 1.0
    assert corrections_mps2(flight, 0.0) == 0.0
    assert flight.engine.pipeline.payload is PayloadState.SLACK
    assert flight.engine.pipeline.payload_mass.mass_kg is None


def test_a_take_off_with_a_slack_cable_estimates_from_the_lift_on(taken_off: Flight) -> None:
    parameters = Parameters()
    taut_s = next(truth.t_boot_s for truth in taken_off.truths if truth.tension_n > 2.0)
    told_s = next(t_s for t_s, text in taken_off.texts if text.startswith("load attached"))
    assert 0.0 < told_s - taut_s < SEEN_S
    before = [report for report in taken_off.reports if report.t_boot_s < taut_s]
    assert {(report.xi_rad, report.zeta_rad) for report in before} == {(0.0, 0.0)}
    assert taken_off.reports[-1].payload_mass_kg in (None, pytest.approx(parameters.payload.mass_kg, abs=0.03))
