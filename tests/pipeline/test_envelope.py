"""Whether a correction may leave, and its one ramp."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.model.actions import Health
from swingd.model.events import FlightMode
from swingd.model.parameters import Control, Mode
from swingd.pipeline.envelope import Conditions, Fade, may_correct, withheld_by
from swingd.pipeline.payload_state import PayloadState

EVERY = list(
    itertools.product(Mode, (False, True), (False, True), FlightMode, PayloadState, Health, (False, True)),
)


def test_every_combination() -> None:
    allowed = {values for values in EVERY if may_correct(Conditions(*values))}
    assert len(EVERY) == 3 * 2 * 2 * 3 * len(PayloadState) * 5 * 2
    assert allowed == {
        (mode, True, True, FlightMode.OFFBOARD, PayloadState.ATTACHED, health, True)
        for mode in (Mode.HOLD, Mode.INLINE)
        for health in (Health.READY, Health.ACTIVE)
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


def test_what_withholds_a_correction_is_named_exactly_where_one_is_withheld() -> None:
    for values in EVERY:
        conditions = Conditions(*values)
        assert bool(withheld_by(conditions)) is not may_correct(conditions), conditions


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
