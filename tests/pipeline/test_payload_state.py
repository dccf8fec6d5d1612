"""When the load counts as lifted."""

import pytest

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import LandedState
from swingd.model.parameters import Parameters
from swingd.pipeline.payload_state import ASSUMED_AFTER_S, LIFTED_FOR_S, PayloadState, PayloadWatch

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
) -> int:
    """Hover-like flight: the acceleration is what thrust, cable and a push make of it; return how often it lifted."""
    acc = (wind_n[0] / 2.0, wind_n[1] / 2.0, GRAVITY_MPS2 + (cable_n - thrust_n) / 2.0)
    return sum(
        watch.update(DT_S, (0.0, 0.0, -thrust_n), acc, known, landed) for _ in range(max(1, round(duration_s / DT_S)))
    )


def test_standing_with_idle_motors_is_on_the_ground() -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, 20.0, 0.5 * VEHICLE_N) == 0
    assert watch.state is PayloadState.ON_GROUND


def test_the_load_is_lifted_when_the_cable_carries_it() -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, 2.0, VEHICLE_N) == 0
    assert watch.state is PayloadState.LIFTING
    assert fly(watch, LIFTED_FOR_S, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == 0, "not at the first tug"
    assert fly(watch, 0.2, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == 1
    assert watch.state is PayloadState.ATTACHED
    assert fly(watch, 10.0, VEHICLE_N) == 0, "told once"


def test_a_jerk_of_the_cable_does_not_count() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 0.5, VEHICLE_N)
    for _ in range(10):
        fly(watch, 0.05, VEHICLE_N, cable_n=LOAD_N)
        fly(watch, 0.25, VEHICLE_N)
    assert watch.state is PayloadState.LIFTING


def test_a_curve_that_never_shows_the_load_does_not_keep_it_on_the_ground() -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, ASSUMED_AFTER_S - 0.1, VEHICLE_N) == 0
    assert fly(watch, 0.3, VEHICLE_N) == 1


def test_without_a_thrust_stream_the_land_detector_tells() -> None:
    watch = PayloadWatch(Parameters())
    assert fly(watch, 5.0, VEHICLE_N + LOAD_N, known=False, landed=LandedState.ON_GROUND) == 0
    assert watch.state is PayloadState.ON_GROUND
    assert fly(watch, 0.05, VEHICLE_N + LOAD_N, known=False, landed=LandedState.IN_AIR) == 1


def test_the_push_before_the_lift_is_remembered() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 3.0, VEHICLE_N, wind_n=(1.4, -0.7))
    assert watch.force_n == pytest.approx((1.4, -0.7, 0.0), rel=0.02)


def test_a_lift_too_quick_to_feel_the_push_knows_none() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 0.2, VEHICLE_N, wind_n=(1.4, -0.7))
    assert watch.force_n is None


def test_landing_begins_anew() -> None:
    watch = PayloadWatch(Parameters())
    fly(watch, 1.0, VEHICLE_N, wind_n=(1.0, 0.0))
    fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N)
    watch.grounded()
    assert watch.state is PayloadState.ON_GROUND
    assert watch.force_n is None
    fly(watch, 0.5, VEHICLE_N)
    assert fly(watch, 1.0, VEHICLE_N + LOAD_N, cable_n=LOAD_N) == 1
