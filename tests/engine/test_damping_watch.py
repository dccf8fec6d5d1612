"""A correction that does harm: it ends before the swing is worse than without any."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec, Framer
from swingd.model.actions import Health

from .flight import OWN_COMPONENT_ID, Flight

Vec3 = tuple[float, float, float]
STEPS: tuple[Vec3, ...] = ((3.0, 0.0, 0.0), (0.0, 3.0, 0.0), (2.0, -1.5, 0.0))
WATCHED_S = 8.0


class Reversed:
    """Turns the lateral part of every correction around; the vehicle's nose points north."""

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self._splitter, self._codec = Framer(), Codec(1, OWN_COMPONENT_ID)

    def __call__(self, _t_s: float, data: bytes) -> bytes:
        frames = self._splitter.receive(data)
        for frame in frames:
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                asked = self._flight.reference[1] if self._flight.reference is not None else 0.0
                frame.message.vy = 2.0 * asked - frame.message.vy
                frame.message.afy = -frame.message.afy
        return b"".join(self._codec.encode(f.message) if f.component_id == OWN_COMPONENT_ID else f.raw for f in frames)


class Late:
    """Holds back everything for a time."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._waiting: list[tuple[float, bytes]] = []

    def __call__(self, t_s: float, data: bytes) -> bytes:
        self._waiting.append((t_s + self._delay_s, data))
        due = [waiting for at_s, waiting in self._waiting if at_s <= t_s]
        del self._waiting[: len(due)]
        return b"".join(due)


def step_peak_deg(flight: Flight, step_ned_mps: Vec3) -> float:
    """Largest true swing from the step on."""
    flight.forget()
    flight.reference = step_ned_mps
    flight.run(WATCHED_S)
    return math.degrees(max(truth.chi_rad for truth in flight.truths))


def distrusted(flight: Flight) -> list[str]:
    return [text for _, text in flight.texts if text.startswith("correction off until enabled again")]


@pytest.fixture(scope="module")
def uncorrected_deg(_hovering: Flight) -> dict[Vec3, float]:
    peaks = {}
    for step in STEPS:
        flight = _hovering.fork()
        flight.engine.switch_correction(flight.t_s, False)
        peaks[step] = step_peak_deg(flight.run(1.0), step)
    return peaks


@pytest.fixture(scope="module")
def reversed_laterally(_hovering: Flight) -> Flight:
    """Six seconds after the lateral sign has changed."""
    flight = _hovering.fork()
    flight.reference = (0.0, 0.0, 0.0)
    flight.deliver = Reversed(flight)
    flight.forget()
    return flight.run(6.0)


def test_a_reversed_axis_is_found_before_a_pilot_would_see_it(reversed_laterally: Flight) -> None:
    flight = reversed_laterally
    assert len(distrusted(flight)) == 1
    assert "the vehicle answers it by -" in distrusted(flight)[0]
    assert math.degrees(max(truth.chi_rad for truth in flight.truths)) < 5.0
    assert flight.health is Health.READY, "the estimate is good, only the correction is not"
    assert not flight.engine.pipeline.correcting


@pytest.mark.parametrize("step", STEPS)
def test_a_reversed_axis_never_makes_the_swing_worse(
    reversed_laterally: Flight, uncorrected_deg: dict[Vec3, float], step: Vec3
) -> None:
    flight = reversed_laterally.fork()
    flight.deliver = Reversed(flight)
    assert step_peak_deg(flight, step) < 1.2 * uncorrected_deg[step]
    assert flight.correction_mps2().any() == np.False_


@pytest.mark.parametrize("step", STEPS)
def test_an_axis_that_is_reversed_from_the_beginning_never_makes_the_swing_worse(
    taken_off: Flight, uncorrected_deg: dict[Vec3, float], step: Vec3
) -> None:
    """The first command comes a second after the correction has begun."""
    flight = taken_off.fork()
    flight.reference = (0.0, 0.0, 0.0)
    flight.deliver = Reversed(flight)
    flight.enter_offboard().run(1.0)
    assert step_peak_deg(flight, step) < 1.2 * uncorrected_deg[step]
    assert not flight.engine.pipeline.correcting


def test_a_diagonal_step_right_after_the_reversal_is_no_worse(
    hovering: Callable[[], Flight], uncorrected_deg: dict[Vec3, float]
) -> None:
    """The first moments of the step itself show that the vehicle answers the wrong way."""
    step = (2.0, -1.5, 0.0)
    flight = hovering()
    flight.reference = (0.0, 0.0, 0.0)
    flight.deliver = Reversed(flight)
    flight.run(1.0)
    assert distrusted(flight) == []
    assert step_peak_deg(flight, step) < 1.2 * uncorrected_deg[step]
    assert len(distrusted(flight)) == 1


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("length", [2.0, 0.5])
def test_a_cable_of_twice_or_half_the_length_never_makes_the_swing_worse(
    hovering: Callable[[], Flight], uncorrected_deg: dict[Vec3, float], length: float, step: Vec3
) -> None:
    flight = hovering()
    known = flight.engine.pipeline.parameters
    believed = replace(known, cable=replace(known.cable, length_m=length * known.cable.length_m))
    flight.engine.change_parameters(flight.t_s, believed, "")
    assert step_peak_deg(flight.run(4.0), step) < 1.2 * uncorrected_deg[step]


@pytest.mark.parametrize("step", STEPS)
def test_setpoints_that_come_late_never_make_the_swing_worse(
    hovering: Callable[[], Flight], uncorrected_deg: dict[Vec3, float], step: Vec3
) -> None:
    flight = hovering()
    flight.deliver = Late(0.15)
    assert step_peak_deg(flight.run(1.0), step) < 1.2 * uncorrected_deg[step]
    assert distrusted(flight) == []
    assert flight.health is Health.ACTIVE


def test_it_stays_off_until_it_is_enabled_again(reversed_laterally: Flight) -> None:
    flight = reversed_laterally.fork()
    flight.deliver = None
    flight.run(3.0)
    assert not flight.engine.pipeline.correcting
    assert "does harm; off until enabled again" in flight.engine.pipeline.withheld_by
    flight.engine.switch_correction(flight.t_s, True)
    flight.run(2.0)
    assert flight.engine.pipeline.correcting
    flight.forget()
    flight.reference = (0.0, 2.0, 0.0)
    flight.run(6.0)
    assert distrusted(flight) == []
    assert flight.health is Health.ACTIVE
