"""Swings that begin without the vehicle's doing, under a filter that has settled, and links that delay."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from swingd.model.actions import Health
from swingd.model.events import Landed, LandedState
from swingd.pipeline.payload_state import PayloadState

from .flight import Flight


def late_swing_deg(flight: Flight, begin_s: float) -> float:
    chi = flight.chi_rad(begin_s + 5.0, begin_s + 10.0)
    return math.degrees(float(np.sqrt(np.mean(chi * chi))))


@pytest.fixture(scope="module")
def settled(_hovering: Flight) -> dict[bool, Flight]:
    """Hovering for 8 s more, by whether the correction is on; only to be forked."""
    flights = {enabled: _hovering.fork() for enabled in (True, False)}
    for enabled, flight in flights.items():
        flight.engine.switch_correction(flight.t_s, enabled)
        flight.run(8.0)
    return flights


@pytest.mark.parametrize("kick", [(1.0, 0.0), (0.0, -1.0), (0.7, 0.7)], ids=str)
def test_a_kicked_load_is_seen_and_damped(settled: dict[bool, Flight], kick: tuple[float, float]) -> None:
    swings = {}
    for enabled in (True, False):
        flight = settled[enabled].fork()
        begin_s = flight.t_s
        flight.kick(*kick)
        flight.run(10.0)
        swings[enabled] = late_swing_deg(flight, begin_s)
        assert math.degrees(flight.chi_rad(begin_s, begin_s + 2.0).max()) > 8.0, "the kick is a real one"
        assert flight.rmse_deg(begin_s + 4.0) < 2.0, "the filter has learnt it"
    assert swings[True] < 0.5 * swings[False]


def delayed(flight: Flight, delay_s: float) -> None:
    """Delay everything that the autopilot sends by ``delay_s`` from now on."""
    waiting: deque[tuple[float, bytes]] = deque()

    def spoil(t_s: float, frames: list[bytes]) -> list[bytes]:
        waiting.extend((t_s + delay_s, frame) for frame in frames)
        due = []
        while waiting and waiting[0][0] <= t_s:
            due.append(waiting.popleft()[1])
        return due

    flight.spoil = spoil


@pytest.mark.parametrize("delay_s", [0.3, 0.4])
def test_a_link_that_becomes_slow_ends_the_correction_before_it_drives_the_load(
    hovering: Callable[[], Flight], delay_s: float
) -> None:
    peaks = {}
    for enabled in (True, False):
        flight = hovering()
        flight.engine.switch_correction(flight.t_s, enabled)
        delayed(flight, delay_s)
        flight.run(2.0)
        flight.forget()
        begin_s = flight.t_s
        flight.reference = (3.0, 0.0, 0.0)
        flight.run(10.0)
        peaks[enabled] = flight.chi_rad(begin_s, begin_s + 10.0).max()
        if enabled:
            assert flight.health is Health.DEGRADED
            assert flight.reports[-1].correction_acc_ned_mps2 == (0.0, 0.0, 0.0)
    assert peaks[True] < 1.2 * peaks[False]


def test_a_single_false_word_of_the_land_detector_changes_nothing(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    before = dict(flight.engine.pipeline.resets)
    flight.engine.pipeline.step(Landed(flight.t_s, LandedState.ON_GROUND))
    flight.run(3.0)
    assert flight.health is Health.ACTIVE
    assert flight.engine.pipeline.resets == before


def test_a_released_load_ends_estimate_and_correction(hovering: Callable[[], Flight]) -> None:
    flight = hovering()
    flight.peer.plant.release()
    flight.run(1.5)
    assert flight.engine.pipeline._payload.state is PayloadState.RELEASED
    assert flight.health is Health.INIT
    assert flight.reports[-1].correction_acc_ned_mps2 == (0.0, 0.0, 0.0)
    flight.run(10.0)
    assert flight.engine.pipeline._payload.state is PayloadState.RELEASED
    assert abs(flight.reports[-1].thrust_scale - 1.0) < 0.02, "the calibration did not swallow the load"
