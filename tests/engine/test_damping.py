"""The closed loop on the simulated autopilot: what the correction is for, and what it must not do."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from swingd.control.placed import design
from swingd.model.actions import Health
from swingd.sim.autopilot import NavState

from .flight import Flight, hold, swing_energy

LENGTH_M = 1.5
PERIOD_S = 2.0 * math.pi * math.sqrt(LENGTH_M / 9.80665)


def off(flight: Flight) -> Flight:
    flight.engine.switch_correction(flight.t_s, False)
    return flight


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def settle_s(flight: Flight, begin_s: float, limit_rad: float = math.radians(2.0)) -> float:
    """Time after which the swing stays below the limit to the end of the records."""
    above = [truth.t_boot_s for truth in flight.truths if truth.chi_rad > limit_rad and truth.t_boot_s > begin_s]
    return max(above, default=begin_s) - begin_s


def test_a_velocity_step_is_damped(hovering: Callable[[], Flight]) -> None:
    flights = {}
    for name, flight in (("on", hovering()), ("off", off(hovering()))):
        flight.run(1.0)
        flight.forget()
        begin_s = flight.t_s
        flight.reference = (3.0, 0.0, 0.0)
        flight.run(20.5)
        flights[name] = flight
    on, without = flights["on"], flights["off"]
    window = (begin_s, begin_s + 12.0)
    assert rms(on.chi_rad(*window)) <= 0.45 * rms(without.chi_rad(*window))
    assert settle_s(on, begin_s) <= 1.1 * PERIOD_S
    assert settle_s(without, begin_s) >= 5.0 * PERIOD_S
    for flight in (on, without):
        assert rms(flight.errors_deg()[0]) <= 1.0
        assert rms(flight.errors_deg()[1]) <= 1.0
    errors = [
        rms(np.array([truth.vel_ned_mps[:2] for truth in f.truths if truth.t_boot_s < window[1]]) - (3.0, 0.0))
        for f in (on, without)
    ]
    assert errors[0] <= 1.4 * errors[1]


@pytest.fixture(scope="module")
def turned(_hovering: Flight) -> dict[int, Flight]:
    """Hovering at several headings."""
    flights = {}
    for yaw_deg in (0, 60, -120):
        flight = _hovering.fork()
        flight.turn(math.radians(yaw_deg))
        flight.run(4.0 if yaw_deg else 0.1)
        assert math.degrees(flight.peer.truth().yaw_rad) == pytest.approx(yaw_deg, abs=3.0)
        flights[yaw_deg] = flight
    return flights


def energy_left(flight: Flight, kick: tuple[float, float], *, enabled: bool) -> float:
    """Share of the swing's energy that is left two periods after the estimate has become good."""
    flight.kick(*kick)
    known = flight.engine.pipeline.parameters
    changed = replace(known, control=replace(known.control, enabled=enabled))
    flight.engine.change_parameters(flight.t_s, changed, "")
    flight.run_until_healthy(4.0)
    first = swing_energy(flight.peer.truth(), LENGTH_M)
    flight.run(2.0 * PERIOD_S)
    return swing_energy(flight.truths[-1], LENGTH_M) / first


@pytest.fixture(scope="module")
def undamped(turned: dict[int, Flight]) -> dict[bool, float]:
    """Energy left without the correction, by whether the swing is longitudinal."""
    return {
        True: energy_left(turned[0].fork(), (1.0, 0.0), enabled=False),
        False: energy_left(turned[0].fork(), (0.0, 1.0), enabled=False),
    }


@pytest.mark.parametrize("yaw_deg", [0, 60, -120])
@pytest.mark.parametrize("kick", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)], ids=str)
def test_a_swing_in_any_direction_is_damped(
    turned: dict[int, Flight], undamped: dict[bool, float], yaw_deg: int, kick: tuple[float, float]
) -> None:
    """The load swings when the estimate begins; once that is good, two periods take nearly all of the energy."""
    left = energy_left(turned[yaw_deg].fork(), kick, enabled=True)
    assert left < 0.1
    assert left < 0.25 * undamped[abs(kick[0]) > 0.0]


def test_yawing_under_a_steady_swing_asks_for_no_correction(hovering: Callable[[], Flight]) -> None:
    """A steady acceleration to the north leaves the load behind, whatever the nose does meanwhile."""
    flights = {}
    for yaw_rate_radps in (0.0, 1.0):
        flight = hovering()
        flight.turn(0.0, yaw_rate_radps)
        flight.run(2.0)
        flight.forget()
        for k in range(60):
            flight.reference = (0.12 * k, 0.0, 0.0)
            flight.run(0.1)
        flights[yaw_rate_radps] = flight
    straight, turning = flights[0.0], flights[1.0]
    turned_rad = np.unwrap([truth.yaw_rad for truth in turning.truths])
    assert turned_rad[-1] - turned_rad[0] == pytest.approx(6.0, abs=0.3)
    swings_deg = np.degrees([math.acos(math.cos(r.xi_rad) * math.cos(r.zeta_rad)) for r in turning.reports])
    assert np.mean(swings_deg[200:]) > 3.0, "the filter sees a swing"
    assert np.ptp([report.xi_rad for report in turning.reports]) > math.radians(6.0), "it turns in the heading frame"
    assert turning.health is Health.ACTIVE
    asked = rms(turning.correction_mps2()[:, :590] - straight.correction_mps2()[:, :590])
    # A law in the heading frame asks for kd L times the yaw rate times the swing.
    kd_per_s = design(turning.engine.pipeline.parameters).kd_per_s
    assert asked < 0.15 * kd_per_s * LENGTH_M * 1.0 * math.radians(np.mean(swings_deg))


def test_a_hook_below_the_centre_of_gravity_costs_little() -> None:
    """The same flights with the same noise, the hook in place or 0.2 m below, told to the filter."""
    errors = {}
    for hook_down_m in (0.0, 0.2):
        squares = []
        for seed in (1, 2):
            parameters = hold(seed=seed)
            vehicle = replace(parameters.vehicle, hook_frd_m=(0.0, 0.0, hook_down_m))
            flight = Flight(replace(parameters, vehicle=vehicle)).take_off().enter_offboard()
            flight.forget()
            for reference in ((3.0, 0.0, 0.0), (0.0, 2.0, 0.0)):
                flight.reference = reference
                flight.run(5.0)
            squares.append(flight.rmse_deg() ** 2)
        errors[hook_down_m] = math.sqrt(np.mean(squares))
    assert errors[0.2] <= 1.2 * errors[0.0]


@pytest.mark.parametrize(("mass", "length"), [(0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2)])
def test_a_wrong_load_or_cable_stays_damped(hovering: Callable[[], Flight], mass: float, length: float) -> None:
    flight = hovering()
    known = flight.engine.pipeline.parameters
    believed = replace(
        known,
        payload=replace(known.payload, mass_kg=mass * known.payload.mass_kg),
        cable=replace(known.cable, length_m=length * known.cable.length_m),
    )
    flight.engine.change_parameters(flight.t_s, believed, "")
    flight.run(4.0)
    assert flight.health is Health.ACTIVE
    flight.reference = (2.0, -1.5, 0.0)
    begin_s = flight.t_s
    flight.forget()
    flight.run(4.0 * PERIOD_S)
    assert flight.nav_state is NavState.OFFBOARD
    assert settle_s(flight, begin_s, math.radians(3.0)) < 2.5 * PERIOD_S
    assert flight.health is Health.ACTIVE


def test_a_release_ends_in_no_wild_correction(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    scale = flight.reports[-1].thrust_scale if flight.reports else 1.0
    flight.run(2.0)
    scale = flight.reports[-1].thrust_scale
    flight.peer.plant.release()
    flight.forget()
    flight.run(8.0)
    assert abs(flight.reports[-1].thrust_scale - scale) < 0.01, "the calibration does not swallow it"
    assert flight.nav_state is NavState.OFFBOARD
    speed = max(math.hypot(*truth.vel_ned_mps[:2]) for truth in flight.truths)
    assert speed < 1.0
