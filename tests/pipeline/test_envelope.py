"""Whether a correction may leave, and its one ramp."""

import itertools
import math
from collections.abc import Iterator
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
} | {"disturbance": ("", "disturbance settling"), "path": ("", "no waypoints")}
SWING_ALONE = {
    "payload": tuple(PayloadState),
    **dict.fromkeys(("finite", "settled", "certain", "consistent", "recovered"), (False, True)),
}
"""What the feed-forward of the disturbance does not depend on: it needs neither load nor cable."""

YES: dict[str, Any] = dict.fromkeys(DOMAINS, True)
GOOD = Conditions(
    **YES
    | {
        "mode": Mode.HOLD,
        "flight_mode": FlightMode.OFFBOARD,
        "payload": PayloadState.ATTACHED,
        "disturbance": "",
        "led": False,
        "path": "",
    }
)
STREAMING = (Mode.HOLD, Mode.INLINE, Mode.PATH)


class UndecidedError(Exception):
    """A decision depends on a condition that is not known yet."""


class Known:
    """Some conditions; whoever asks for another is told so."""

    def __init__(self, known: dict[str, Any]) -> None:
        self.__dict__.update(known)

    def __getattr__(self, name: str) -> Any:
        raise UndecidedError(name)


def decisions(part: Part) -> Iterator[tuple[dict[str, Any], bool]]:
    """Every decision with the conditions that it asked for; nothing else can have a say in it.

    What is asked for takes each of its values in turn, so that every combination of all conditions is in exactly one.
    """
    waiting: list[dict[str, Any]] = [{}]
    while waiting:
        known = waiting.pop()
        try:
            yield known, may_leave(part, Known(known))  # type: ignore[arg-type]
        except UndecidedError as undecided:
            (name,) = undecided.args
            waiting += [{**known, name: value} for value in DOMAINS[name]]


def every(**fixed: Any) -> Iterator[Conditions]:
    """All combinations in which some conditions are as given."""
    single = {name: (value,) for name, value in fixed.items()}
    return (Conditions(*values) for values in itertools.product(*{**DOMAINS, **single}.values()))


def leaving(part: Part) -> set[Conditions]:
    """All combinations of conditions in which a part may leave."""
    covered, leaves = 0, set()
    for asked, may in decisions(part):
        covered += math.prod(len(domain) for name, domain in DOMAINS.items() if name not in asked)
        assert may_leave(part, next(every(**asked))) is may
        leaves |= set(every(**asked)) if may else set()
    assert covered == 4 * 3 * len(PayloadState) * 2**15, "every combination"
    return leaves


def test_every_combination_of_what_a_correction_depends_on() -> None:
    paths, doubts = DOMAINS["path"], DOMAINS["disturbance"]
    assert leaving(Part.SWING) == {
        replace(GOOD, mode=mode, disturbance=doubt, path=path)
        for mode, doubt, path in itertools.product(STREAMING, doubts, paths)
    }
    assert leaving(Part.DISTURBANCE) == {
        replace(GOOD, mode=mode, path=path, **dict(zip(SWING_ALONE, values, strict=True)))
        for mode, path in itertools.product(STREAMING, paths)
        for values in itertools.product(*SWING_ALONE.values())
    }


def test_every_combination_of_what_a_path_depends_on() -> None:
    no_yes = (False, True)
    assert leaving(Part.PATH) == {
        replace(GOOD, mode=Mode.PATH, trusted=trusted, led=led, disturbance=doubt)
        for trusted, led, doubt in itertools.product(no_yes, no_yes, DOMAINS["disturbance"])
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
        good = replace(GOOD, mode=Mode.PATH) if part is Part.PATH else GOOD
        conditions = replace(good, **{name: value})
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
