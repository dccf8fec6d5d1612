"""Shaping and damping together on the simulated autopilot: neither works against the other."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from swingd.model.actions import Health
from swingd.model.parameters import Cable, Endpoint, Parameters, Payload, ShaperName, Vehicle
from swingd.sim.autopilot import NavState

from .flight import Flight, FloatArray, hold, inline, local_setpoint

WINDOW_S = 12.0
HOVER = local_setpoint(vel=(0.0, 0.0, 0.0))


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def change(flight: Flight, *, shaper: ShaperName, damping: bool, enabled: bool = True) -> Flight:
    """Choose what meets the reference; without damping the shaped reference alone."""
    known = flight.engine.pipeline.parameters
    control = replace(known.control, enabled=enabled)
    if not damping:
        control = replace(control, law="payload", payload_kp_mps2_per_rad=0.0, payload_kd_mps2_per_radps=0.0)
    changed = replace(known, control=control, hold=replace(known.hold, shaper=shaper))
    flight.engine.change_parameters(flight.t_s, changed, "")
    flight.reference = (0.0, 0.0, 0.0)
    return flight.run(1.5)


def step(flight: Flight, speed_mps: float, duration_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time since a velocity step to the north, total swing [deg] and velocity error over it."""
    flight.forget()
    flight.reference = (speed_mps, 0.0, 0.0)
    flight._reference_s = flight.t_s
    begin_s = flight.peer.t_boot_s
    flight.run(duration_s)
    t = np.array([truth.t_boot_s for truth in flight.truths]) - begin_s
    swing = np.degrees([truth.chi_rad for truth in flight.truths])
    velocity = np.array([truth.vel_ned_mps[:2] for truth in flight.truths])
    return t, swing, np.hypot(velocity[:, 0] - speed_mps, velocity[:, 1])


def test_the_steps_of_the_demonstration(hovering: Callable[[], Flight]) -> None:
    """0, 3, 0 m/s, judged over 12 s after each step against the same application without swingd."""
    figures = {}
    for name, shaper, enabled in (("direct", ShaperName.NONE, False), ("shaped", ShaperName.ZV, True)):
        flight = change(hovering(), shaper=shaper, damping=True, enabled=enabled)
        swings, errors, settled = [], [], []
        for speed_mps in (3.0, 0.0):
            t, swing, error = step(flight, speed_mps, 20.0 if speed_mps else WINDOW_S)
            swings.append(swing[t < WINDOW_S])
            errors.append(error[t < WINDOW_S])
            settled.append(float(t[swing > 2.0].max()))
        figures[name] = rms(np.concatenate(swings)), rms(np.concatenate(errors)), max(settled)
        assert flight.nav_state is NavState.OFFBOARD
    assert figures["shaped"][0] <= 0.35 * figures["direct"][0]
    assert figures["shaped"][1] <= 1.65 * figures["direct"][1]
    assert figures["shaped"][2] <= 3.0
    assert figures["direct"][2] > 10.0


def believed(vehicle_kg: float, payload_kg: float, length_m: float) -> Parameters:
    return replace(Parameters(), vehicle=Vehicle(vehicle_kg), payload=Payload(payload_kg), cable=Cable(length_m))


def other_length(ratio: float) -> tuple[Parameters, Parameters]:
    return Parameters(), believed(2.0, 0.3, 1.5 * ratio)


def windy() -> Parameters:
    parameters = believed(2.0, 0.3, 1.5)
    return replace(parameters, simulation=replace(parameters.simulation, wind_ned_mps=(-2.8, 2.8, 0.0)))


CASES = {
    "light vehicle": (believed(1.5, 0.3, 1.5),) * 2,
    "long": (believed(2.0, 0.5, 3.0),) * 2,
    "heavy": (believed(2.0, 1.0, 1.5),) * 2,
    "short": (believed(2.0, 0.2, 0.8),) * 2,
    "wind": (windy(),) * 2,
    "believed longer": other_length(1.2),
    "believed shorter": other_length(0.8),
}


@pytest.mark.parametrize("case", CASES)
def test_together_they_are_no_worse_than_either_alone(case: str) -> None:
    """Of the swing and the velocity error that are left once the planned motion is over, and over the whole step."""
    truth, known = CASES[case]
    took_off = Flight(hold(truth), hold(known)).take_off().enter_offboard().run(4.0)
    over_s = 1.5 + math.pi * math.sqrt(truth.cable.length_m / 9.80665) + 0.5
    whole, left, slower, off_course, given = {}, {}, {}, {}, {}
    for name, shaper, damping in (
        ("damped", ShaperName.NONE, True),
        ("shaped", ShaperName.ZV, False),
        ("both", ShaperName.ZV, True),
    ):
        flight = change(took_off.fork(), shaper=shaper, damping=damping)
        t, swing, error = step(flight, 3.0, over_s + 4.5)
        assert flight.health is Health.ACTIVE
        assert flight.nav_state is NavState.OFFBOARD
        whole[name], left[name] = rms(swing), rms(swing[t > over_s])
        slower[name], off_course[name] = rms(error), rms(error[t > over_s])
        times = np.array([report.t_boot_s for report in flight.reports]) - flight.truths[0].t_boot_s
        given[name] = rms(np.hypot(*flight.correction_mps2())[times < over_s])
    # What the load swings in hover, more where the filter knows it badly, and the error of the autopilot's velocity.
    noise_deg, noise_mps = (0.3 if known == truth else 0.7), 0.1
    assert whole["both"] <= min(whole["damped"], whole["shaped"]) + noise_deg
    assert left["both"] <= min(left["damped"], left["shaped"]) + noise_deg
    assert off_course["both"] <= min(off_course["damped"], off_course["shaped"]) + noise_mps
    assert slower["both"] <= slower["shaped"] + 0.05
    assert given["both"] < 0.2 * given["damped"], "the law has nothing against what is planned"


# ---- an application behind an endpoint


@pytest.fixture(scope="module")
def applied() -> dict[ShaperName, Flight]:
    """In OFFBOARD through swingd, by the endpoint's shaper."""
    flights = {}
    for shaper in (ShaperName.NONE, ShaperName.ZV):
        flight = Flight(replace(inline(), endpoints=(Endpoint(shaper=shaper),))).take_off()
        flight.connect().setpoint = HOVER
        flights[shaper] = flight.run(0.5).enter_offboard().run(2.0)
        assert flight.health is Health.ACTIVE
    return flights


def test_a_position_is_approached_without_swing_and_met(applied: dict[ShaperName, Flight]) -> None:
    swings, miss = {}, {}
    for shaper, flight in ((shaper, flight.fork()) for shaper, flight in applied.items()):
        truth = flight.peer.truth()
        north, east, down = truth.pos_ned_m
        flight.applications[0].setpoint = local_setpoint(pos=(north + 4.0, east - 2.0, down), yaw_rad=truth.yaw_rad)
        begin_s = flight.peer.t_boot_s
        flight.run(12.0)
        swings[shaper] = math.degrees(rms(flight.chi_rad(begin_s, begin_s + 12.0)))
        end = flight.setpoints[-1][1]
        assert end.yaw_rad == pytest.approx(truth.yaw_rad, abs=1e-6)
        assert end.pos_ned_m[2] == pytest.approx(down, abs=1e-6)
        miss[shaper] = math.dist(end.pos_ned_m[:2], (north + 4.0, east - 2.0))
        past = max(setpoint.pos_ned_m[0] for t_s, setpoint in flight.setpoints if setpoint.pos_ned_m[0]) - north - 4.0
        assert past < 0.3, "not passed by far"
    assert swings[ShaperName.ZV] < 0.8 * swings[ShaperName.NONE]
    assert miss[ShaperName.ZV] < miss[ShaperName.NONE] + 0.05


def test_only_the_endpoint_that_wants_it_is_shaped(applied: dict[ShaperName, Flight]) -> None:
    first = {}
    for shaper, flight in ((shaper, flight.fork()) for shaper, flight in applied.items()):
        flight.applications[0].setpoint = local_setpoint(vel=(0.0, 2.0, 0.5))
        flight.forget()
        flight.run(0.3)
        first[shaper] = flight.setpoints[-1][1]
    assert first[ShaperName.NONE].vel_ned_mps[1] == pytest.approx(2.0, abs=0.1)
    assert first[ShaperName.ZV].vel_ned_mps[1] < 0.5
    assert first[ShaperName.ZV].vel_ned_mps[2] == pytest.approx(0.5), "the vertical is not shaped"


def test_where_the_correction_ends_the_application_has_the_vehicle(applied: dict[ShaperName, Flight]) -> None:
    """In the middle of a shaped motion: within the fade to what is asked for, then its own frames."""
    flight = applied[ShaperName.ZV].fork()
    flight.applications[0].setpoint = local_setpoint(vel=(3.0, 0.0, 0.0))
    flight.run(0.6)
    flight.forget()
    flight.engine.switch_correction(flight.t_s, False)
    flight.run(1.0)
    speeds = np.array([setpoint.vel_ned_mps[0] for _, setpoint in flight.setpoints])
    assert speeds[0] < 1.2
    assert speeds[-1] == pytest.approx(3.0, abs=0.15), "faded to what is asked for"
    fade_out_s = flight.engine.pipeline.parameters.control.fade_out_s
    assert np.diff(speeds).max() < 3.0 * 3.0 * 0.01 / fade_out_s, "a ramp and no step"
    assert len(speeds) == pytest.approx(100.0 * fade_out_s, abs=3)
    assert flight.peer.autopilot.setpoint.vel_ned_mps[0] == 3.0
    assert flight.peer.autopilot.setpoint.acc_ned_mps2[0] is None, "its own frame"
