"""The force on the vehicle besides thrust and weight: what is estimated of it, and what is set against it."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from swingd.core.constants import GRAVITY_MPS2
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.events import LocalPosition, Vec3
from swingd.model.parameters import Autopilot, Disturbance, Parameters
from swingd.pipeline.disturbance import POSITION_LATE_S, SETTLE_S, DisturbanceObserver
from swingd.pipeline.disturbance_feed_forward import DisturbanceFeedForward

DT_S = 0.01
MASS_KG = Parameters().vehicle.mass_kg
WEIGHT_N = MASS_KG * GRAVITY_MPS2
HOVER: Vec3 = (0.0, 0.0, -WEIGHT_N)
OBSERVED = replace(Parameters(), disturbance=Disturbance(source="es_lkf", feed_forward=True))
Force = Callable[[float], Vec3]


class Body:
    """A point mass under a thrust and a force that the observer does not know; exact over steps of constant force."""

    def __init__(self, late_s: float = 0.0, pos_std_m: float = 0.0, vel_std_mps: float = 0.0) -> None:
        self.observer, self.t_s, self.late_s = DisturbanceObserver(OBSERVED), 100.0, late_s
        self.std = (pos_std_m, vel_std_mps)
        self.pos, self.vel = np.array([3.0, -4.0, -20.0]), np.array([1.0, 0.5, -0.2])
        self._waiting: list[LocalPosition] = []
        self._random = np.random.default_rng(5)

    def fly(
        self, duration_s: float, force: Force, thrust: Vec3 = HOVER, *, known: bool = True, silent: bool = False
    ) -> None:
        for step in range(round(duration_s / DT_S)):
            acc = (np.add(thrust, force(self.t_s))) / MASS_KG + [0.0, 0.0, GRAVITY_MPS2]
            self.pos = self.pos + DT_S * self.vel + 0.5 * DT_S**2 * acc
            self.vel = self.vel + DT_S * acc
            self.t_s += DT_S
            if step % 2 == 0 and not silent:
                pos = self.pos + self.std[0] * self._random.standard_normal(3)
                vel = self.vel + self.std[1] * self._random.standard_normal(3)
                self._waiting.append(LocalPosition(self.t_s, self.t_s, tuple(pos.tolist()), tuple(vel.tolist())))
            while self._waiting and self._waiting[0].t_boot_s <= self.t_s - self.late_s + 1e-9:
                self.observer.add_position(self._waiting.pop(0))
            self.observer.step(self.t_s, DT_S, thrust, thrust_known=known)

    @property
    def told(self) -> DisturbanceEstimate:
        estimate = self.observer.estimate()
        assert estimate is not None
        return estimate


def constant(*force: float) -> Force:
    return lambda _t_s: (force[0], force[1], force[2])


def test_without_a_source_there_is_nothing_to_tell() -> None:
    observer = DisturbanceObserver(Parameters())
    observer.step(1.0, DT_S, HOVER, thrust_known=True)
    assert observer.estimate() is None


def test_wind_from_the_south_west_and_a_hanging_load_are_found_without_knowing_of_either() -> None:
    body = Body()
    load_n = 0.4 * GRAVITY_MPS2
    body.fly(3.0, constant(1.2, 0.7, load_n), (0.0, 0.0, -WEIGHT_N - load_n))
    assert body.told.force_ned_n == pytest.approx((1.2, 0.7, load_n), abs=1e-3), "to the north, to the east, down"
    assert body.told.doubt == ""


def test_the_estimate_is_as_good_as_it_says_where_the_force_walks_as_it_assumes() -> None:
    noise = OBSERVED.disturbance
    body = Body(pos_std_m=noise.pos_noise_m, vel_std_mps=noise.vel_noise_mps)
    walk, random = np.zeros(3), np.random.default_rng(2)
    shares = []
    for _ in range(3000):
        walk += OBSERVED.disturbance.force_noise * MASS_KG * math.sqrt(DT_S) * random.standard_normal(3)
        body.fly(DT_S, constant(*walk.tolist()))
        shares.append(np.subtract(body.told.force_ned_n, walk) / body.told.force_std_n)
    nees = np.mean(np.square(shares[300:]))
    # Some 60 independent samples an axis: half a second is forgotten.
    assert 0.75 < nees < 1.3
    assert body.told.doubt == ""


@pytest.mark.parametrize("late_s", [0.02, 0.06])
def test_a_late_position_does_not_pass_for_a_force(late_s: float) -> None:
    body = Body(late_s)
    body.fly(6.0, constant(0.0, 0.0, 0.0), (4.0, 0.0, -WEIGHT_N))
    assert abs(body.told.force_ned_n[0]) < 0.02, "a vehicle that speeds up by 2 m/s^2"


def test_a_swinging_load_is_followed() -> None:
    body = Body()
    omega = 2.0 * math.pi / 2.4
    errors = []
    for _ in range(1000):
        body.fly(DT_S, lambda t_s: (1.5 * math.sin(omega * t_s), 0.0, 0.0))
        errors.append(body.told.force_ned_n[0] - 1.5 * math.sin(omega * (body.t_s - DT_S)))
    assert np.std(errors[300:]) < 0.25 * 1.5 / math.sqrt(2.0)


@pytest.mark.parametrize(
    ("spoil", "doubt"),
    [
        (lambda body: body.fly(POSITION_LATE_S + 0.1, constant(0, 0, 0), silent=True), "position and velocity late"),
        (lambda body: body.fly(DT_S, constant(0, 0, 0), known=False), "thrust unknown"),
        (lambda body: body.observer.step(body.t_s, math.nan, HOVER, thrust_known=True), "disturbance settling"),
        (lambda body: body.observer.step(body.t_s, DT_S, (math.inf, 0, 0), thrust_known=True), "disturbance settling"),
        (lambda body: body.observer.reset(), "disturbance settling"),
    ],
)
def test_what_is_not_known_is_doubted_until_it_has_settled_again(spoil: Callable[[Body], None], doubt: str) -> None:
    body = Body()
    body.fly(SETTLE_S + 0.5, constant(1.0, 0.0, 0.0))
    assert body.told.doubt == ""
    spoil(body)
    assert body.told.doubt == doubt
    body.fly(0.5 * SETTLE_S, constant(1.0, 0.0, 0.0))
    assert body.told.doubt == "disturbance settling"
    body.fly(SETTLE_S, constant(1.0, 0.0, 0.0))
    assert body.told.doubt == ""
    assert body.told.force_ned_n[0] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("jump", [(30.0, 0.0), (0.0, 2.0)])
def test_a_position_or_velocity_that_the_autopilot_moves_is_a_doubt_and_no_force(jump: tuple[float, float]) -> None:
    body = Body()
    body.fly(3.0, constant(1.0, 0.0, 0.0))
    body.pos, body.vel = body.pos + jump[0], body.vel + jump[1]
    body.fly(0.1, constant(1.0, 0.0, 0.0))
    assert body.told.doubt == "disturbance settling"
    assert body.told.force_ned_n[0] == pytest.approx(1.0, abs=0.02)
    body.fly(SETTLE_S, constant(1.0, 0.0, 0.0))
    assert body.told.doubt == ""


def test_a_yaw_reset_turns_force_and_motion_with_the_autopilots_north() -> None:
    body = Body()
    body.fly(3.0, constant(1.0, 0.0, 0.0))
    body.observer.turn(math.pi / 2.0)
    assert body.told.force_ned_n == pytest.approx((0.0, 1.0, 0.0), abs=0.02), (
        "what was north of the old is east of the new"
    )


# ---- what is set against it

LIFT_N = 1.2 * WEIGHT_N


def leant(
    forward: DisturbanceFeedForward, force_n: tuple[float, float], duration_s: float, fade: float = 1.0, doubt: str = ""
) -> tuple[float, float]:
    estimate = DisturbanceEstimate((*force_n, 3.0), (0.1, 0.1, 0.1), doubt)
    acc = (0.0, 0.0)
    for _ in range(round(duration_s / DT_S)):
        acc = forward.update(estimate, LIFT_N, fade, DT_S)
    return acc


def settled() -> DisturbanceFeedForward:
    """Without wind so far, and given fully."""
    forward = DisturbanceFeedForward(OBSERVED)
    leant(forward, (0.0, 0.0), 1.0, fade=0.0)
    leant(forward, (0.0, 0.0), 1.0)
    return forward


def test_it_leans_into_the_wind_by_what_the_flown_thrust_makes_of_a_tilt() -> None:
    north, east = leant(settled(), (2.0, -1.0), 5.0)
    # The tilt is acc / g, its horizontal force lift times that.
    assert (LIFT_N * north / GRAVITY_MPS2, LIFT_N * east / GRAVITY_MPS2) == pytest.approx((-2.0, 1.0), abs=1e-6)


def test_what_the_autopilots_integrator_holds_already_is_not_leaned_against_again() -> None:
    forward = DisturbanceFeedForward(OBSERVED)
    leant(forward, (2.0, 0.0), 30.0, fade=0.0)
    assert leant(forward, (2.0, 0.0), 5.0) == pytest.approx((0.0, 0.0), abs=1e-9)
    north, _ = leant(forward, (0.0, 0.0), 5.0)
    assert north == pytest.approx(2.0 * GRAVITY_MPS2 / LIFT_N, abs=1e-6), "when the wind ends, it takes that back"


def test_without_an_integrator_all_of_it_is_leaned_against() -> None:
    forward = DisturbanceFeedForward(replace(OBSERVED, autopilot=Autopilot(velocity_i=0.0)))
    leant(forward, (2.0, 0.0), 30.0, fade=0.0)
    north, _ = leant(forward, (2.0, 0.0), 5.0)
    assert north == pytest.approx(-2.0 * GRAVITY_MPS2 / LIFT_N, abs=1e-6)


def test_it_keeps_its_limits_of_size_and_slew() -> None:
    forward = settled()
    before, largest = (0.0, 0.0), 0.0
    for _ in range(300):
        now = forward.update(DisturbanceEstimate((80.0, 60.0, 0.0), (0.1,) * 3, ""), LIFT_N, 1.0, DT_S)
        assert math.hypot(now[0] - before[0], now[1] - before[1]) <= OBSERVED.control.jerk_max_mps3 * DT_S + 1e-9
        before, largest = now, max(largest, math.hypot(*now))
    assert largest == pytest.approx(OBSERVED.disturbance.acc_max_mps2)


def test_in_doubt_the_last_of_it_fades_and_is_forgotten() -> None:
    forward = settled()
    given = leant(forward, (2.0, 0.0), 5.0)
    assert leant(forward, (-9.0, 0.0), 0.5, fade=0.5, doubt="late")[0] == pytest.approx(0.5 * given[0], rel=1e-6)
    assert leant(forward, (-9.0, 0.0), 0.1, fade=0.0, doubt="late") == (0.0, 0.0)
    assert leant(forward, (2.0, 0.0), 0.2) == pytest.approx((0.0, 0.0), abs=1e-9), "it begins from what is there then"


@pytest.mark.parametrize("lift_n", [0.2 * WEIGHT_N, 0.0, -5.0, math.nan])
def test_a_vehicle_without_thrust_tells_nothing_of_tilts(lift_n: float) -> None:
    forward = settled()
    estimate = DisturbanceEstimate((2.0, 0.0, 0.0), (0.1,) * 3, "")
    for _ in range(100):
        assert forward.update(estimate, lift_n, 1.0, DT_S) == (0.0, 0.0)


def test_after_a_cut_it_rises_from_zero_and_still_knows_what_is_held() -> None:
    forward = settled()
    given = leant(forward, (2.0, 0.0), 5.0)
    forward.cut()
    first = forward.update(DisturbanceEstimate((2.0, 0.0, 0.0), (0.1,) * 3, ""), LIFT_N, 1.0, DT_S)
    assert abs(first[0]) <= OBSERVED.control.jerk_max_mps3 * DT_S + 1e-9
    assert leant(forward, (2.0, 0.0), 3.0) == pytest.approx(given, abs=1e-3)
