"""Whether a correction may leave, and its one ramp."""

import itertools
from dataclasses import fields, replace
from enum import Enum
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.model.events import FlightMode
from swingd.model.parameters import Control, Mode
from swingd.pipeline.envelope import Conditions, Fade, Part, may_leave, withheld_by
from swingd.pipeline.payload_state import PayloadState

KINDS: dict[str, type[Enum]] = {"mode": Mode, "flight_mode": FlightMode, "payload": PayloadState}
DOMAINS: dict[str, tuple[Any, ...]] = {
    field.name: tuple(KINDS.get(field.name, (False, True))) for field in fields(Conditions)
} | {"disturbance": ("", "disturbance settling")}
SWING_ALONE = {
    "payload": tuple(PayloadState),
    **dict.fromkeys(("finite", "settled", "certain", "consistent", "recovered"), (False, True)),
}
"""What the feed-forward of the disturbance does not depend on: it needs neither load nor cable."""

YES: dict[str, Any] = dict.fromkeys(DOMAINS, True)
GOOD = Conditions(
    **YES | {"mode": Mode.HOLD, "flight_mode": FlightMode.OFFBOARD, "payload": PayloadState.ATTACHED, "disturbance": ""}
)
STREAMING = (Mode.HOLD, Mode.INLINE)


def test_every_combination() -> None:
    combinations = [Conditions(*values) for values in itertools.product(*DOMAINS.values())]
    assert len(combinations) == 3 * 3 * len(PayloadState) * 2**14
    swing = {conditions for conditions in combinations if may_leave(Part.SWING, conditions)}
    assert swing == {
        replace(GOOD, mode=mode, disturbance=doubt, sound=sound)
        for mode in STREAMING
        for doubt in DOMAINS["disturbance"]
        for sound in DOMAINS["sound"]
    }
    disturbance = {conditions for conditions in combinations if may_leave(Part.DISTURBANCE, conditions)}
    assert disturbance == {
        replace(GOOD, mode=mode, **dict(zip(SWING_ALONE, values, strict=True)))
        for mode in STREAMING
        for values in itertools.product(*SWING_ALONE.values())
    }


@pytest.mark.parametrize(("fade_in_s", "fade_out_s"), [(1.0, 0.5), (0.0, 0.5), (2.0, 0.0), (0.0, 0.0)])
def test_the_ramps_take_their_time(fade_in_s: float, fade_out_s: float) -> None:
    fade = Fade(Control(fade_in_s=fade_in_s, fade_out_s=fade_out_s))
    up = [fade.update(True, 0.01) for _ in range(300)]
    assert up.index(1.0) + 1 == pytest.approx(max(1, round(fade_in_s / 0.01)), abs=1)
    down = [fade.update(False, 0.01) for _ in range(300)]
    assert down.index(0.0) + 1 == pytest.approx(max(1, round(fade_out_s / 0.01)), abs=1)


@given(
    st.floats(0.0, 10.0), st.floats(0.0, 5.0), st.lists(st.tuples(st.booleans(), st.floats(0.001, 0.5)), max_size=100)
)
def test_the_fade_stays_within_its_slope(fade_in_s: float, fade_out_s: float, steps: list[tuple[bool, float]]) -> None:
    fade = Fade(Control(fade_in_s=fade_in_s, fade_out_s=fade_out_s))
    for allowed, dt_s in steps:
        before = fade.value
        after = fade.update(allowed, dt_s)
        assert 0.0 <= after <= 1.0
        assert (after >= before) if allowed else (after <= before)
        ramp_s = fade_in_s if allowed else fade_out_s
        assert abs(after - before) * ramp_s <= dt_s * (1.0 + 1e-9)


@pytest.mark.parametrize("part", Part)
@pytest.mark.parametrize("name", DOMAINS)
def test_what_withholds_a_part_is_named_once_for_each_condition(name: str, part: Part) -> None:
    for value in DOMAINS[name]:
        conditions = replace(GOOD, **{name: value})
        assert len(withheld_by(part, conditions)) == (not may_leave(part, conditions))


def test_everything_that_withholds_a_correction_is_named() -> None:
    assert withheld_by(Part.SWING, replace(GOOD, enabled=False, armed=False)) == ("switched off", "not armed")


def test_other_ramps_are_taken_where_the_fade_stands() -> None:
    fade = Fade(Control(fade_in_s=1.0, fade_out_s=1.0))
    for _ in range(50):
        fade.update(True, 0.01)
    fade.configure(Control(fade_in_s=0.1, fade_out_s=0.1))
    assert fade.value == pytest.approx(0.5)
    assert fade.update(False, 0.01) == pytest.approx(0.4)


def test_a_cut_is_at_once() -> None:
    fade = Fade(Control())
    for _ in range(200):
        fade.update(True, 0.01)
    fade.cut()
    assert fade.value == 0.0
    assert fade.update(True, 0.01) == pytest.approx(0.01), "and the next entry begins at the ramp's foot"
