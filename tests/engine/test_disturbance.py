"""Position hold in wind, in virtual time: the disturbance is estimated and leaned against without knowing the load."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from swingd.model.parameters import Disturbance, Mode, Parameters
from swingd.pipeline.payload_state import PayloadState

from .flight import Flight, inline, local_setpoint

WIND_NED_MPS = (4.0, 3.0, 0.0)
DRAG_N_PER_MPS = 0.35
LOAD_KG = 0.6
LENGTHS_M = (1.5, 3.0)
OBSERVE = Disturbance(source="es_lkf")
EXACT = {"gnss_vel_noise_mps": 0.0, "gnss_pos_noise_m": 0.0, "attitude_noise_rad": 0.0, "acc_bias_mps2": 0.0}
"""An autopilot that knows its own motion: what it gets wrong moves the vehicle too, and no force is to blame."""


def truth(length_m: float = 1.5) -> Parameters:
    """A vehicle with drag and twice the load that swingd is told of."""
    base = Parameters()
    return inline(
        replace(
            base,
            vehicle=replace(base.vehicle, drag_n_per_mps=DRAG_N_PER_MPS),
            payload=replace(base.payload, mass_kg=LOAD_KG),
            cable=replace(base.cable, length_m=length_m),
        ),
        **EXACT,
    )


def believed(flown: Parameters, disturbance: Disturbance = OBSERVE) -> Parameters:
    """Without drag, with half of the load."""
    return replace(
        flown,
        vehicle=replace(flown.vehicle, drag_n_per_mps=0.0),
        payload=replace(flown.payload, mass_kg=0.5 * LOAD_KG),
        disturbance=disturbance,
    )


def holding(flight: Flight) -> Flight:
    """In the air, an application's position has been held in calm air for long."""
    north, east, down = (float(value) for value in flight.peer.truth().pos_ned_m)
    flight.connect().setpoint = local_setpoint(pos=(north, east, down), yaw_rad=0.0)
    return flight.run(0.5).enter_offboard().run(15.0)


@pytest.fixture(scope="module")
def taken_off() -> dict[float, Flight]:
    """In the air, observing, by the cable's length; only to be forked."""
    flown = {length_m: truth(length_m) for length_m in LENGTHS_M}
    return {length_m: Flight(flown[length_m], believed(flown[length_m])).take_off() for length_m in LENGTHS_M}


@pytest.fixture(scope="module")
def leaning() -> Flight:
    """Holding, feeding forward from the start; only to be forked."""
    flown = truth()
    return holding(Flight(flown, believed(flown, replace(OBSERVE, feed_forward=True))).take_off())


def in_wind(flight: Flight, duration_s: float = 20.0) -> tuple[float, float, float]:
    """RMS and largest horizontal error of the position from the wind's beginning [m], RMS of the swing [deg]."""
    place = np.array(flight.peer.truth().pos_ned_m[:2])
    flight.forget()
    flight.peer.plant.set_wind(WIND_NED_MPS)
    flight.run(duration_s)
    errors = np.array([np.hypot(*(np.array(t.pos_ned_m[:2]) - place)) for t in flight.truths])
    angles = np.degrees([[t.xi_rad, t.zeta_rad] for t in flight.truths])
    swing = np.linalg.norm(angles - angles[-500:].mean(axis=0), axis=1)
    return float(np.sqrt((errors**2).mean())), float(errors.max()), float(np.sqrt((swing**2).mean()))


@pytest.mark.parametrize("length_m", LENGTHS_M)
def test_in_wind_with_an_unknown_load_the_position_error_is_halved_and_the_swing_no_larger(
    taken_off: dict[float, Flight], length_m: float
) -> None:
    without = holding(taken_off[length_m].fork())
    forward = without.fork()
    forward.engine.change_parameters(
        forward.t_s, believed(truth(length_m), replace(OBSERVE, feed_forward=True)), "feed-forward on"
    )
    forward.run(2.0)
    without.run(2.0)
    rms_off_m, peak_off_m, swing_off_deg = in_wind(without)
    rms_on_m, peak_on_m, swing_on_deg = in_wind(forward)
    print(
        f"{length_m} m: position RMS {rms_off_m:.3f} -> {rms_on_m:.3f} m, "
        f"largest {peak_off_m:.3f} -> {peak_on_m:.3f} m, swing RMS {swing_off_deg:.2f} -> {swing_on_deg:.2f} deg"
    )
    assert rms_on_m <= 0.5 * rms_off_m
    assert peak_on_m <= 0.6 * peak_off_m
    assert swing_on_deg <= swing_off_deg
    assert all(not any(report.feed_forward_acc_ned_mps2) for report in without.reports)
    north, east, _ = forward.reports[-1].feed_forward_acc_ned_mps2
    assert north < -0.3, "into the wind, which blows to the north-east"
    assert east < -0.2
    assert not forward.engine.pipeline.feed_forward_withheld_by


def test_the_estimate_is_cable_wind_and_drag_together() -> None:
    flown = truth()
    # Calibrated by half of the load, the thrust is a tenth too small, and with it every force.
    measured = replace(believed(flown), thrust=replace(flown.thrust, scale_rate_per_s=0.0))
    flight = holding(Flight(flown, measured).take_off())
    in_wind(flight, 15.0)
    force_n = np.mean([r.disturbance.force_ned_n for r in flight.reports[-300:] if r.disturbance], axis=0)
    drag = DRAG_N_PER_MPS * np.array(WIND_NED_MPS)
    swing = np.mean([t.zeta_rad for t in flight.truths[-750:]]), np.mean([t.xi_rad for t in flight.truths[-750:]])
    pull = LOAD_KG * 9.80665 * np.array([math.tan(swing[0]), -math.tan(swing[1]), 1.0])
    assert force_n[:2] == pytest.approx((drag + pull)[:2], abs=0.08)
    assert force_n[2] == pytest.approx(pull[2], abs=0.25), "with what the thrust curve gets wrong"


def test_it_leaves_without_a_load_too(leaning: Flight) -> None:
    flight = leaning.fork()
    flight.peer.plant.release()
    flight.run(3.0)
    assert flight.engine.pipeline.payload is not PayloadState.ATTACHED
    assert flight.engine.pipeline.withheld_by
    in_wind(flight, 10.0)
    assert flight.engine.pipeline.feed_forward_withheld_by == ()
    assert flight.reports[-1].feed_forward_acc_ned_mps2[0] < -0.3
    assert flight.reports[-1].correction_acc_ned_mps2 == (0.0, 0.0, 0.0)
    assert flight.setpoints[-1][1].acc_ned_mps2[0] == pytest.approx(flight.reports[-1].feed_forward_acc_ned_mps2[0])


def test_switched_off_it_fades_and_an_application_that_ends_takes_it_along(leaning: Flight) -> None:
    flight = leaning.fork()
    in_wind(flight, 5.0)
    silent = flight.fork()
    flight.forget()
    flight.engine.switch_correction(flight.t_s, False)
    flight.run(2.0)
    sizes = [math.hypot(*r.feed_forward_acc_ned_mps2) for r in flight.reports]
    assert sizes[0] > 0.3
    assert max(abs(a - b) for a, b in pairwise(sizes)) < 0.05, "no step"
    assert sizes[-1] == 0.0
    assert "switched off" in flight.engine.pipeline.feed_forward_withheld_by
    silent.applications[0].setpoint = None
    silent.run(1.5)
    silent.forget()
    silent.run(0.5)
    assert silent.setpoints == []


def test_in_mode_shadow_it_is_estimated_and_published_alone() -> None:
    flown = truth()
    on = replace(OBSERVE, feed_forward=True)
    flight = holding(Flight(flown, replace(believed(flown, on), mode=Mode.SHADOW)).take_off())
    in_wind(flight, 5.0)
    disturbance = flight.reports[-1].disturbance
    assert disturbance is not None
    assert disturbance.doubt == ""
    assert disturbance.force_ned_n[0] > 0.5
    assert flight.engine.pipeline.feed_forward_withheld_by == ("mode shadow",)
    assert flight.setpoints == []


def test_on_the_ground_nothing_is_told() -> None:
    flown = truth()
    flight = Flight(flown, believed(flown, replace(OBSERVE, feed_forward=True))).run(6.0)
    disturbance = flight.reports[-1].disturbance
    assert disturbance is not None
    assert disturbance.force_ned_n == (0.0, 0.0, 0.0)
    assert disturbance.doubt == "disturbance settling"
    assert "on ground" in flight.engine.pipeline.feed_forward_withheld_by


def test_a_change_of_its_noise_leaves_the_swings_estimate_alone(taken_off: dict[float, Flight]) -> None:
    flight = taken_off[1.5].fork()
    resets = sum(flight.engine.pipeline.resets.values())
    flight.engine.change_parameters(flight.t_s, believed(truth(), replace(OBSERVE, force_noise=1.5)), "noise")
    flight.run(0.5)
    assert sum(flight.engine.pipeline.resets.values()) == resets
    assert flight.reports[-1].disturbance is not None
    assert flight.reports[-1].disturbance.doubt == "disturbance settling"
