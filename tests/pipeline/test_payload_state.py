"""When the load counts as lifted, and when as lost."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import LandedState
from swingd.model.parameters import Parameters, ThrustSource
from swingd.pipeline.payload_state import (
    LIFTED_FOR_S,
    LOST_FOR_S,
    SILENT_AFTER_S,
    TRANSITIONS,
    PayloadSample,
    PayloadState,
    PayloadWatch,
    Sign,
)

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
    altitude_m: float | None = None,
    vel_down_mps: float | None = None,
) -> list[PayloadState]:
    """Fly; the acceleration is what thrust, cable and a push make of it. Return the states that were told.

    The thrust that is believed is ``curve`` times the true one.
    """
    acc = (wind_n[0] / 2.0, wind_n[1] / 2.0, GRAVITY_MPS2 + (cable_n - thrust_n) / 2.0)
    vel: Any = None
    if climbing or vel_down_mps is not None:
        vel = (0.0, 0.0, -0.5 if vel_down_mps is None else vel_down_mps)
    sample = PayloadSample(
        dt_s=DT_S,
        force_n=(0.0, 0.0, -curve * thrust_n),
        lift_n=curve * thrust_n,
        acc_mps2=acc,
        body_down=(0.0, 0.0, 1.0),
        thrust_known=known,
        landed=landed,
        vel_mps=vel,
        altitude_m=altitude_m,
    )
    told = []
    for _ in range(max(1, round(duration_s / DT_S))):
        before = watch.state
        changed = watch.update(sample)
        assert changed == (watch.state is not before)
        if changed:
            assert watch.reason
            told.append(watch.state)
    return told


def carrying(parameters: Parameters | None = None) -> PayloadWatch:
    watch = PayloadWatch(parameters or Parameters())
    fly(watch, 1.0, VEHICLE_N)
    fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N)
    assert watch.state is PayloadState.ATTACHED
    return watch


def test_every_state_can_be_left_and_only_a_fall_loses_a_load() -> None:
    assert set(TRANSITIONS) == set(PayloadState)
    reached = {state for leads in TRANSITIONS.values() for state in leads.values()}
    assert reached == set(PayloadState) - {PayloadState.ON_GROUND}
    for state, leads in TRANSITIONS.items():
        assert leads, state
        for sign, target in leads.items():
            assert target is not state
            if target in (PayloadState.RELEASED, PayloadState.TOUCHED_DOWN):
                assert (state, sign) in ((PayloadState.ATTACHED, Sign.FALL), (PayloadState.ATTACHED, Sign.FALL_LOW))


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
    assert fly(watch, LOST_FOR_S, VEHICLE_N) == []
    assert fly(watch, 0.4, VEHICLE_N) == [PayloadState.RELEASED]
    assert fly(watch, 5.0 * SILENT_AFTER_S, VEHICLE_N) == []
    assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [PayloadState.ATTACHED], "and the next load as well"


@pytest.mark.parametrize("period_s", [0.2, 0.5, 1.2])
def test_a_load_that_swings_hard_is_not_lost(period_s: float) -> None:
    """Near slack for less than half of the time."""
    watch = carrying()
    for _ in range(round(20.0 / period_s)):
        assert fly(watch, 0.4 * period_s, VEHICLE_N, cable_n=0.05 * LOAD_N) == []
        assert fly(watch, 0.6 * period_s, VEHICLE_N + LOAD_N, cable_n=1.5 * LOAD_N) == []


def test_free_fall_is_no_release_and_a_hard_climb_no_second_load() -> None:
    watch = carrying()
    for _ in range(10):
        assert fly(watch, 1.0, 0.02 * VEHICLE_N, cable_n=0.02 * LOAD_N) == []
        assert fly(watch, 1.0, 1.6 * (VEHICLE_N + LOAD_N), cable_n=1.6 * LOAD_N) == []
        assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == []
    assert fly(watch, 0.8, 1.6 * VEHICLE_N) == [PayloadState.RELEASED], "a release in a climb is one"


@pytest.mark.parametrize(
    ("altitude_m", "vel_down_mps", "state"),
    [
        (12.0, 0.7, PayloadState.RELEASED),
        (3.0, 0.7, PayloadState.RELEASED),
        (1.6, 0.7, PayloadState.TOUCHED_DOWN),
        (1.6, 0.0, PayloadState.TOUCHED_DOWN),
        (None, 0.7, PayloadState.TOUCHED_DOWN),
        (None, 0.0, PayloadState.RELEASED),
        (None, None, PayloadState.RELEASED),
    ],
)
def test_a_load_that_is_lost_low_was_set_down(
    altitude_m: float | None, vel_down_mps: float | None, state: PayloadState
) -> None:
    """The origin of the altitude is anywhere: 100 m above the take-off."""
    watch = PayloadWatch(Parameters())
    at_m = None if altitude_m is None else altitude_m - 100.0
    fly(watch, 1.0, 0.1 * VEHICLE_N, altitude_m=-100.0, landed=LandedState.ON_GROUND)
    fly(watch, 1.5, VEHICLE_N, climbing=True, altitude_m=-99.0)
    fly(watch, 5.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, altitude_m=at_m, vel_down_mps=vel_down_mps)
    assert fly(watch, 1.0, VEHICLE_N, altitude_m=at_m, vel_down_mps=vel_down_mps) == [state]
    assert "0.2" in watch.reason
    assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, altitude_m=at_m) == [PayloadState.ATTACHED]


def test_who_joins_in_flight_and_sees_no_load_does_not_know() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 0.02, VEHICLE_N)
    assert fly(watch, SILENT_AFTER_S - 0.1, VEHICLE_N) == []
    assert fly(watch, 0.3, VEHICLE_N) == [PayloadState.UNKNOWN]
    assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == [PayloadState.ATTACHED], "until the thrust shows it"


@pytest.mark.parametrize("curve", [0.85, 1.0, 1.15])
def test_who_watches_a_take_off_without_a_load_knows_that_there_is_none(curve: float) -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 2.0, 0.1 * VEHICLE_N, curve=curve, landed=LandedState.ON_GROUND)
    assert fly(watch, 5.0, VEHICLE_N, climbing=True, curve=curve) == [PayloadState.SLACK]
    assert fly(watch, 60.0, VEHICLE_N, curve=curve) == []
    assert watch.mass.mass_kg is None


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
    """Without a motion of its own the swing shows nothing; what the thrust shows is the pull over what is felt of g.

    Both are smoothed: what was felt or pulled before may still count.
    """
    watch = PayloadWatch(Parameters())
    pulls, felts = [0.0], [0.0]
    for thrust_n, cable_n, known in pieces:
        told = fly(watch, 0.3, thrust_n, cable_n=cable_n, known=known)
        if known:
            pulls.append(cable_n)
            felts.append(thrust_n - cable_n)
        shown = max(pulls) * max(felts) > 0.0 or min(pulls) * min(felts) > 0.0
        assert PayloadState.ATTACHED not in told or shown


@pytest.mark.parametrize("curve", [0.85, 0.9, 1.1, 1.15])
def test_a_wrong_thrust_curve_neither_hides_nor_feigns_a_load_that_is_lifted(curve: float) -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, 1.5, VEHICLE_N, climbing=True, curve=curve) == [PayloadState.SLACK]
    assert fly(watch, 0.5, VEHICLE_N + LOAD_N, cable_n=LOAD_N, climbing=True, curve=curve) == [PayloadState.ATTACHED]
    assert fly(watch, 60.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, curve=curve) == []
    assert fly(watch, 1.0, VEHICLE_N, curve=curve) == [PayloadState.RELEASED], "the release is seen within a second"
    assert fly(watch, 60.0, VEHICLE_N, curve=curve) == []
    assert fly(watch, 0.5, VEHICLE_N + LOAD_N, cable_n=LOAD_N, curve=curve) == [PayloadState.ATTACHED]


@pytest.mark.parametrize("sag", [0.2, -0.2])
def test_a_sagging_battery_is_neither_a_release_nor_a_load(sag: float) -> None:
    """20 % of thrust over two minutes that the voltage curve does not know, with the load and then without."""
    watch = PayloadWatch(Parameters())
    fly(watch, 1.5, VEHICLE_N, climbing=True)
    fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N)
    assert watch.state is PayloadState.ATTACHED
    for k in range(120):
        assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, curve=1.0 - sag * k / 120.0) == []
    assert fly(watch, 1.0, VEHICLE_N, curve=1.0 - sag) == [PayloadState.RELEASED]
    for k in range(120):
        assert fly(watch, 1.0, VEHICLE_N, curve=1.0 - sag + sag * k / 120.0) == []


# ---- its mass


@pytest.mark.parametrize("curve", [0.88, 1.0, 1.12])
@pytest.mark.parametrize("load_kg", [0.2, 0.3, 0.9])
def test_a_load_is_weighed_against_the_scale_of_the_flight_without_it(curve: float, load_kg: float) -> None:
    watch = PayloadWatch(Parameters())
    load_n = load_kg * GRAVITY_MPS2
    fly(watch, 2.5, VEHICLE_N, climbing=True, curve=curve)
    fly(watch, 2.0, VEHICLE_N + load_n, cable_n=load_n, curve=curve, vel_down_mps=0.0)
    assert watch.state is PayloadState.ATTACHED
    assert "no quiet flight yet" in watch.mass.reason
    fly(watch, 6.0, VEHICLE_N + load_n, cable_n=load_n, curve=curve, vel_down_mps=0.0)
    assert watch.mass.mass_kg == pytest.approx(load_kg, abs=1e-3)
    assert watch.mass.std_kg is not None
    assert 0.004 < watch.mass.std_kg < 0.02
    weighed = watch.mass
    for k in range(30):
        sagged = (1.0 - 0.002 * k) * curve
        fly(watch, 1.0, VEHICLE_N + load_n, cable_n=load_n, curve=sagged, vel_down_mps=0.0)
    assert watch.mass is weighed, "once"
    fly(watch, 1.0, VEHICLE_N, curve=sagged, vel_down_mps=0.0)
    assert watch.mass.mass_kg is None


def test_without_a_flight_before_the_pick_up_the_mass_is_not_known() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 60.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, vel_down_mps=0.0)
    assert watch.state is PayloadState.ATTACHED
    assert watch.mass.mass_kg is None
    assert "look alike" in watch.mass.reason


@pytest.mark.parametrize("vel_down_mps", [None, 4.0])
def test_what_is_not_known_to_be_slow_is_not_weighed(vel_down_mps: float | None) -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 2.5, VEHICLE_N, climbing=True)
    fly(watch, 60.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N, vel_down_mps=vel_down_mps)
    assert watch.mass.mass_kg is None
    assert "no quiet flight yet" in watch.mass.reason
