"""When the load counts as lifted, and when as lost."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import LandedState
from swingd.model.parameters import Parameters, ThrustSource
from swingd.pipeline.payload_state import ASSUMED_AFTER_S, LIFTED_FOR_S, SLACK_FOR_S, PayloadState, PayloadWatch

DT_S = 0.01
VEHICLE_N = 2.0 * GRAVITY_MPS2
LOAD_N = 0.3 * GRAVITY_MPS2


def fly(
    watch: PayloadWatch,
    duration_s: float,
    thrust_n: float,
    *,
    cable_n: float = 0.0,
    wind_n: tuple[float, float] = (0.0, 0.0),
    known: bool = True,
    landed: LandedState = LandedState.IN_AIR,
    climbing: bool = False,
    curve: float = 1.0,
) -> list[PayloadState]:
    """Fly; the acceleration is what thrust, cable and a push make of it. Return the states that were told.

    The thrust that is believed is ``curve`` times the true one.
    """
    acc = (wind_n[0] / 2.0, wind_n[1] / 2.0, GRAVITY_MPS2 + (cable_n - thrust_n) / 2.0)
    told = []
    for _ in range(max(1, round(duration_s / DT_S))):
        before = watch.state
        changed = watch.update(DT_S, (0.0, 0.0, -curve * thrust_n), acc, known, landed, climbing)
        assert changed == (watch.state is not before)
        if changed:
            told.append(watch.state)
    return told


def carrying(parameters: Parameters | None = None) -> PayloadWatch:
    watch = PayloadWatch(parameters or Parameters())
    fly(watch, 1.0, VEHICLE_N)
    fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N)
    assert watch.state is PayloadState.ATTACHED
    return watch


def test_standing_with_idle_motors_is_on_the_ground() -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, 20.0, 0.5 * VEHICLE_N) == []
    assert watch.state is PayloadState.ON_GROUND


def test_the_load_is_lifted_when_the_cable_carries_it() -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, 2.0, VEHICLE_N) == [PayloadState.SLACK]
    assert fly(watch, LIFTED_FOR_S, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [], "not at the first tug"
    assert fly(watch, 0.2, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [PayloadState.ATTACHED]
    assert fly(watch, 30.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [], "told once"


def test_a_jerk_of_the_cable_does_not_count() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 0.5, VEHICLE_N)
    for _ in range(10):
        fly(watch, 0.05, VEHICLE_N, cable_n=LOAD_N)
        fly(watch, 0.25, VEHICLE_N)
    assert watch.state is PayloadState.SLACK


def test_a_release_is_seen_and_is_not_assumed_away() -> None:
    watch = carrying()
    assert fly(watch, SLACK_FOR_S, VEHICLE_N) == []
    assert fly(watch, 1.0, VEHICLE_N) == [PayloadState.SLACK]
    assert fly(watch, 5.0 * ASSUMED_AFTER_S, VEHICLE_N) == []
    assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [PayloadState.ATTACHED], "and the next load as well"


@pytest.mark.parametrize("period_s", [0.2, 0.5, 1.2])
def test_a_load_that_swings_hard_is_not_lost(period_s: float) -> None:
    """Near slack for less than half of the time."""
    watch = carrying()
    for _ in range(round(20.0 / period_s)):
        assert fly(watch, 0.4 * period_s, VEHICLE_N, cable_n=0.05 * LOAD_N) == []
        assert fly(watch, 0.6 * period_s, VEHICLE_N + LOAD_N, cable_n=1.5 * LOAD_N) == []


def test_a_curve_that_never_shows_the_load_lets_it_be_assumed_only() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 0.02, VEHICLE_N)
    assert fly(watch, ASSUMED_AFTER_S - 0.1, VEHICLE_N) == []
    assert fly(watch, 0.3, VEHICLE_N) == [PayloadState.UNKNOWN]
    assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [PayloadState.ATTACHED], "until the thrust shows it"


@pytest.mark.parametrize(
    ("source", "state"),
    [(ThrustSource.AUTO, PayloadState.UNKNOWN), (ThrustSource.REMARK_1, PayloadState.ATTACHED)],
)
def test_without_a_thrust_stream_the_land_detector_tells(source: ThrustSource, state: PayloadState) -> None:
    watch = PayloadWatch(replace(Parameters(), thrust=replace(Parameters().thrust, source=source)))
    for landed in (LandedState.ON_GROUND, LandedState.UNKNOWN):
        assert fly(watch, 5.0, VEHICLE_N + LOAD_N, known=False, landed=landed) == []
    assert fly(watch, 0.05, VEHICLE_N + LOAD_N, known=False, landed=LandedState.IN_AIR) == [state]


def test_the_push_before_the_lift_is_remembered() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 3.0, VEHICLE_N, wind_n=(1.4, -0.7))
    assert watch.force_n == pytest.approx((1.4, -0.7, 0.0), rel=0.02)


def test_a_lift_too_quick_to_feel_the_push_knows_none() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 0.2, VEHICLE_N, wind_n=(1.4, -0.7))
    assert watch.force_n is None


def test_landing_begins_anew() -> None:
    watch = carrying()
    watch.grounded()
    assert watch.state is PayloadState.ON_GROUND
    assert watch.force_n is None
    assert fly(watch, 0.5, VEHICLE_N) == [PayloadState.SLACK]
    assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [PayloadState.ATTACHED]


@given(st.lists(st.tuples(st.floats(0.0, 60.0), st.floats(-5.0, 20.0), st.booleans()), max_size=40))
def test_nothing_is_attached_that_the_thrust_did_not_show(pieces: list[tuple[float, float, bool]]) -> None:
    watch = PayloadWatch(Parameters())
    shown = False
    for thrust_n, cable_n, known in pieces:
        told = fly(watch, 0.3, thrust_n, cable_n=cable_n, known=known)
        shown |= known and cable_n > 0.4 * LOAD_N
        assert PayloadState.ATTACHED not in told or shown


@pytest.mark.parametrize("curve", [0.85, 0.9, 1.1, 1.15])
def test_a_wrong_thrust_curve_neither_hides_nor_feigns_a_load_that_is_lifted(curve: float) -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, 1.5, VEHICLE_N, climbing=True, curve=curve) == [PayloadState.SLACK]
    assert fly(watch, 0.5, VEHICLE_N + LOAD_N, cable_n=LOAD_N, climbing=True, curve=curve) == [PayloadState.ATTACHED]
    assert fly(watch, 60.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, curve=curve) == []
    assert fly(watch, 1.0, VEHICLE_N, curve=curve) == [PayloadState.SLACK], "the release is seen within a second"
    assert fly(watch, 60.0, VEHICLE_N, curve=curve) == []
    assert fly(watch, 0.5, VEHICLE_N + LOAD_N, cable_n=LOAD_N, curve=curve) == [PayloadState.ATTACHED]


def test_a_sagging_battery_is_no_release() -> None:
    """20 % of thrust over two minutes that the voltage curve does not know."""
    watch = carrying()
    for k in range(120):
        assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, curve=1.0 - 0.2 * k / 120.0) == []
