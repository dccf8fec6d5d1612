"""The reference of mode path: the load's motion from the vehicle's, and how far a path has come."""

import math
from dataclasses import replace

import numpy as np
import pytest

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slts import SltsState
from swingd.model.events import LocalPosition, PathOrder
from swingd.model.parameters import Mode, Parameters, Path, Waypoint
from swingd.pipeline.path import (
    RESUME_WITHIN_S,
    STOP_S,
    PathInputs,
    PathReference,
    PathState,
    load_motion,
)

LENGTH_M = Parameters().cable.length_m
MASS_KG = Parameters().vehicle.mass_kg + Parameters().payload.mass_kg
DT_S = 0.01
HOVER = PathInputs(
    thrust_ned_n=(0.0, 0.0, -MASS_KG * GRAVITY_MPS2),
    thrust_known=True,
    specific_force_ned_mps2=(0.0, 0.0, -GRAVITY_MPS2),
    hook_ned_m=(0.0, 0.0, 0.0),
)
HERE = LocalPosition(10.0, 10.0, (5.0, -3.0, -8.0), (1.0, 0.5, 0.0))


def at(north_m: float = 0.0, east_m: float = 0.0, vel_n_mps: float = 0.0) -> np.ndarray:
    """The load below a vehicle at 8 m."""
    vehicle = LocalPosition(0.0, 0.0, (north_m, east_m, -8.0), (vel_n_mps, 0.0, 0.0))
    return load_motion(vehicle, 0.0, (0.0, 0.0), (0.0, 0.0), HOVER, LENGTH_M)


def parameters(**changes: str | float) -> Parameters:
    path = Path(**changes)  # type: ignore[arg-type]
    return replace(Parameters(), mode=Mode.PATH, path=path, waypoints=(Waypoint(20.0), Waypoint(20.0, 10.0)))


class Bench:
    """A reference that is told where the load is."""

    def __init__(self, flown: Parameters | None = None) -> None:
        self.reference, self.t_s = PathReference(flown or parameters()), 100.0

    def step(self, x: np.ndarray | None, inputs: PathInputs = HOVER) -> tuple[float, float, float] | None:
        self.t_s += DT_S
        self.reference.observe(self.t_s, x, inputs, DT_S)
        if self.reference.doubt:
            self.reference.rest(self.reference.doubt)
            return None
        return self.reference.lead(self.t_s)


def test_a_load_at_rest_hangs_below_the_vehicle_and_moves_with_it() -> None:
    x = load_motion(HERE, 0.0, (0.0, 0.0), (0.0, 0.0), HOVER, LENGTH_M)
    assert x[:3] == pytest.approx((5.0, -3.0, -8.0 + LENGTH_M))
    assert x[SltsState.LOAD_VEL : SltsState.LOAD_VEL + 3] == pytest.approx((1.0, 0.5, 0.0))


def test_a_load_that_hangs_to_the_north_has_the_vehicle_to_its_south() -> None:
    x = load_motion(HERE, 0.0, (0.3, 0.0), (0.2, 0.1), HOVER, LENGTH_M)
    assert x[SltsState.LOAD_POS] == pytest.approx(5.0 + 0.3 * LENGTH_M)
    assert x[SltsState.REL_POS] == pytest.approx(-0.3 * LENGTH_M)
    assert x[SltsState.REL_VEL + 1] == pytest.approx(-0.1 * LENGTH_M)
    later = load_motion(HERE, 0.0, (0.3 + 0.2e-6, 0.1e-6), (0.2, 0.1), HOVER, LENGTH_M)
    moved = (later[:3] - x[:3]) / 1e-6
    assert x[SltsState.LOAD_VEL : SltsState.LOAD_VEL + 3] - HERE.vel_ned_mps == pytest.approx(moved, abs=1e-5)


def test_a_late_position_is_carried_on_and_the_hook_is_where_it_is() -> None:
    speeding = replace(HOVER, specific_force_ned_mps2=(2.0, 0.0, -GRAVITY_MPS2), hook_ned_m=(0.0, 0.2, 0.1))
    x = load_motion(HERE, 0.1, (0.0, 0.0), (0.0, 0.0), speeding, LENGTH_M)
    assert x[:3] == pytest.approx((5.0 + 0.1 + 0.01, -3.0 + 0.05 + 0.2, -8.0 + 0.1 + LENGTH_M))
    assert x[SltsState.LOAD_VEL] == pytest.approx(1.2)


def test_waypoints_count_from_where_the_load_hangs_or_from_the_origin() -> None:
    for relative_to, remaining_m in (("start", 30.0), ("origin", math.dist((5, 0, -8 + LENGTH_M), (20, 0, 0)) + 10.0)):
        bench = Bench(parameters(relative_to=relative_to))
        acc = bench.step(at(5.0))
        assert acc is not None
        assert acc[0] > 0.5, "to the north"
        assert bench.reference.progress.remaining_m == pytest.approx(remaining_m)


def test_a_thrust_that_is_believed_wrong_moves_the_load_neither_up_nor_down() -> None:
    """The autopilot hovers at an acceleration of zero, whatever is believed of the thrust that this takes."""
    weak = replace(HOVER, thrust_ned_n=(0.0, 0.0, -0.9 * MASS_KG * GRAVITY_MPS2))
    bench = Bench(replace(parameters(), waypoints=(Waypoint(),)))
    bench.reference.order(PathOrder.ABORT)
    for _ in range(600):
        bench.step(at(), weak)
    bench.reference.order(PathOrder.CONTINUE)
    acc = bench.step(at(), weak)
    assert acc is not None
    assert acc == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_a_pause_aims_at_where_the_load_can_stop() -> None:
    bench = Bench()
    for _ in range(10):
        bench.step(at(vel_n_mps=2.0))
    assert bench.reference.order(PathOrder.PAUSE) == "path paused"
    for _ in range(600):
        there = bench.step(at(2.0 * STOP_S))
    beyond = bench.step(at(2.0 * STOP_S + 2.0))
    assert there is not None
    assert beyond is not None
    assert there[0] == pytest.approx(0.0, abs=0.05), "there it is to stay"
    assert beyond[0] < -0.5, "from beyond it is led back"
    assert bench.reference.progress.remaining_m is None


def test_an_interruption_goes_on_by_itself_or_waits() -> None:
    for silent_s, goes_on in ((RESUME_WITHIN_S - 0.5, True), (RESUME_WITHIN_S + 0.5, False)):
        bench = Bench()
        bench.step(at())
        bench.reference.take_texts()
        for _ in range(round(silent_s / DT_S)):
            assert bench.step(None) is None
        assert bench.reference.state is PathState.INTERRUPTED
        assert bench.reference.take_texts() == ["path interrupted: position and velocity late or out of range"]
        assert (bench.step(at()) is not None) is goes_on
        bench.reference.go_on()
        assert bench.step(at()) is not None
        assert bench.reference.state is PathState.LEADING


@pytest.mark.parametrize(
    ("inputs", "waypoints", "doubt"),
    [
        (replace(HOVER, thrust_known=False), (Waypoint(1.0),), "thrust unknown"),
        (HOVER, (), "no waypoints"),
    ],
)
def test_what_is_not_known_leads_nothing(inputs: PathInputs, waypoints: tuple[Waypoint, ...], doubt: str) -> None:
    bench = Bench(replace(parameters(), waypoints=waypoints))
    assert bench.step(at(), inputs) is None
    assert bench.reference.doubt == doubt


def test_a_place_that_is_no_number_leads_nothing() -> None:
    bench = Bench()
    assert bench.step(at()) is not None
    assert bench.step(at(math.nan)) is None
    assert bench.reference.state is PathState.INTERRUPTED


def test_other_waypoints_begin_a_path_anew_and_another_speed_does_not() -> None:
    bench = Bench()
    for metres in range(20):
        bench.step(at(float(metres)))
    assert bench.reference.progress.waypoint == 2
    bench.reference.configure(parameters(cruise_mps=1.0))
    bench.step(at(20.0, 1.0))
    assert bench.reference.progress.waypoint == 2
    bench.reference.configure(replace(parameters(), waypoints=(Waypoint(3.0), Waypoint(6.0))))
    bench.step(at(20.0, 1.0))
    assert bench.reference.progress.waypoint == 1


@pytest.mark.parametrize("north_m", [2e5, -1e30, math.nan])
def test_a_position_that_cannot_be_leads_nowhere_and_raises_nothing(north_m: float) -> None:
    bench = Bench()
    for _ in range(50):
        assert bench.step(at()) is not None
    assert bench.step(at(north_m)) is None
    assert bench.reference.doubt == "position and velocity late or out of range"
    assert bench.step(at()) is not None, "it goes on"
