"""The shaper: within its limits, exact in the end, silent for the swing, and without a jump whatever happens to it."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swingd.model.parameters import Cable, Estimator, Parameters, ShaperName, Shaping
from swingd.pipeline.shaping import WINDOW_MAX_S, Motion, Shaper, Target

LENGTH_M = 1.5
OMEGA = math.sqrt(9.80665 / LENGTH_M)
PERIOD_S = 2.0 * math.pi / OMEGA
SHAPERS = (ShaperName.ZV, ShaperName.ZVD, ShaperName.EI)
FloatArray = np.ndarray


def shaped(length_m: float = LENGTH_M, damping_ratio: float = 0.0, **limits: float) -> Parameters:
    return replace(
        Parameters(),
        cable=Cable(length_m),
        estimator=Estimator(damping_ratio=damping_ratio),
        shaping=Shaping(**limits),
    )


def intervals(seed: int, mean_s: float) -> Iterator[float]:
    """Steps of a filter that jitter, with a gap now and then."""
    random = np.random.default_rng(seed)
    while True:
        yield mean_s * float(random.uniform(0.4, 1.6)) if random.random() > 0.01 else 15.0 * mean_s


class Record:
    """What a shaper gave."""

    def __init__(self, shaper: Shaper, seed: int = 0, mean_s: float = 0.01) -> None:
        self.shaper = shaper
        self.t_s = 0.0
        self.t: list[float] = []
        self.motions: list[Motion] = []
        self._dt = intervals(seed, mean_s)

    def follow(self, target: Target, duration_s: float, place_m: tuple[float, float] | None = None) -> "Record":
        end_s = self.t_s + duration_s
        while self.t_s < end_s:
            dt_s = next(self._dt)
            self.t_s += dt_s
            self.t.append(self.t_s)
            self.motions.append(self.shaper.update(target, dt_s, place_m))
        return self

    def __getattr__(self, name: str) -> FloatArray:
        return np.array([getattr(motion, name) for motion in self.motions]).T

    @property
    def times(self) -> FloatArray:
        return np.array(self.t)


def pendulum(record: Record, omega: float) -> FloatArray:
    """Amplitude of an undamped load below the motion, as a displacement [m], at each instant."""
    amplitudes = []
    load = rate = 0.0
    t = record.times
    acc = np.r_[0.0, record.acc_mps2[0]]
    for k, dt_s in enumerate(np.diff(t, prepend=0.0)):
        # Exact for an acceleration that changes straight over the interval, as the shaper's does but for its kinks.
        a0, slope = acc[k], (acc[k + 1] - acc[k]) / dt_s
        base, base_rate = -a0 / omega**2, -slope / omega**2
        c, s = math.cos(omega * dt_s), math.sin(omega * dt_s)
        off, off_rate = load - base, rate - base_rate
        load = base + base_rate * dt_s + off * c + off_rate / omega * s
        rate = base_rate - off * omega * s + off_rate * c
        amplitudes.append(math.hypot(load, rate / omega))
    return np.array(amplitudes)


NORTH = Target((3.0, 0.0))
FINE_S = 0.001
"""Interval for the pendulum below the motion, which is integrated over the recorded instants."""


@pytest.mark.parametrize("name", SHAPERS)
@pytest.mark.parametrize("acc_max", [0.5, 2.0, 20.0])
def test_a_velocity_step_leaves_an_ideal_load_hanging_still(name: ShaperName, acc_max: float) -> None:
    shaper = Shaper(shaped(acc_max_mps2=acc_max, jerk_max_mps3=50.0), name)
    record = Record(shaper, mean_s=FINE_S).follow(Target((0.0, 0.0)), 1.0).follow(NORTH, 12.0)
    assert shaper.ended
    unshaped_m = 3.0 / OMEGA
    tolerated = 0.05 if name is ShaperName.EI else 1e-3
    assert pendulum(record, OMEGA)[-1] <= tolerated * unshaped_m
    assert record.vel_mps[0][-1] == pytest.approx(3.0, abs=1e-12)


@pytest.mark.parametrize("off", [0.8, 1.2])
@pytest.mark.parametrize(("name", "left"), [(ShaperName.ZV, 0.310), (ShaperName.ZVD, 0.097), (ShaperName.EI, 0.052)])
def test_a_load_that_is_off_by_a_fifth_keeps_its_published_share(name: ShaperName, left: float, off: float) -> None:
    """Of what a step without slew would leave: the slew and the mean only take away from it."""
    shaper = Shaper(shaped(acc_max_mps2=20.0, jerk_max_mps3=1000.0), name)
    record = Record(shaper, mean_s=FINE_S).follow(NORTH, 8.0)
    share = pendulum(record, off * OMEGA)[-1] / (3.0 / (off * OMEGA))
    assert share <= left
    if name is not ShaperName.EI:
        assert share > 0.85 * left


def test_the_natural_damping_is_in_the_impulses() -> None:
    """A damped load that hangs still afterwards takes a first impulse that is larger than the last."""
    record = Record(Shaper(shaped(damping_ratio=0.1, acc_max_mps2=20.0, jerk_max_mps3=1000.0), ShaperName.ZV))
    record.follow(NORTH, 5.0)
    between = record.vel_mps[0][np.searchsorted(record.times, 0.25 * PERIOD_S)]
    decay = math.exp(-0.1 * math.pi / math.sqrt(1.0 - 0.01))
    assert between == pytest.approx(3.0 / (1.0 + decay), rel=1e-6)


# ---- limits and derivatives

speeds = st.floats(-12.0, 12.0)
velocities = st.builds(Target, st.tuples(speeds, speeds))
places = st.builds(
    Target, st.just((0.0, 0.0)) | st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), st.tuples(speeds, speeds)
)
limits = st.fixed_dictionaries(
    {
        "acc_max_mps2": st.floats(0.1, 20.0),
        "jerk_max_mps3": st.floats(0.1, 1000.0),
        "vel_max_mps": st.floats(0.1, 50.0),
    }
)


@settings(deadline=None, max_examples=60)
@given(
    limits,
    st.sampled_from(list(ShaperName)),
    st.lists(st.tuples(velocities | places, st.floats(0.02, 4.0)), min_size=1, max_size=8),
    st.integers(0, 2**16),
)
def test_limits_are_never_exceeded(
    given_limits: dict[str, float], name: ShaperName, pieces: list[tuple[Target, float]], seed: int
) -> None:
    record = Record(Shaper(shaped(**given_limits), name), seed)
    for target, duration_s in pieces:
        record.follow(target, duration_s, (1.0, -2.0))
    acc, dt = record.acc_mps2, np.diff(record.times)
    slack = 1.0 + 1e-6
    assert np.hypot(*acc).max() <= given_limits["acc_max_mps2"] * slack + 1e-9
    jerk = np.hypot(*np.diff(acc, axis=1)) / dt
    assert jerk.max(initial=0.0) <= given_limits["jerk_max_mps3"] * slack + 1e-6
    assert np.hypot(*record.jerk_mps3).max() <= given_limits["jerk_max_mps3"] * slack + 1e-6
    fastest = max(
        [given_limits["vel_max_mps"] if any(target.pos_m for target, _ in pieces) else 0.0]
        + [math.hypot(*target.vel_mps) for target, _ in pieces]
    )
    assert np.hypot(*record.vel_mps).max() <= fastest * slack + 1e-9


@pytest.mark.parametrize("name", list(ShaperName))
def test_velocity_and_acceleration_are_the_derivatives_of_the_position(name: ShaperName) -> None:
    record = Record(Shaper(shaped(), name), 3, FINE_S)
    record.follow(NORTH, 1.7).follow(Target((-1.0, 2.0)), 0.8)
    record.follow(Target((0.0, 0.0), (4.0, 4.0)), 6.0, (1.0, 1.0))
    dt = np.diff(record.times)
    placed = np.searchsorted(record.times, 2.55)
    for value, rate, begin in ((record.pos_m, record.vel_mps, placed), (record.vel_mps, record.acc_mps2, 0)):
        mean = 0.5 * (rate[:, 1:] + rate[:, :-1])
        wrong = np.abs(np.diff(value, axis=1) / dt - mean)[:, begin:]
        # Where the acceleration kinks within an interval the trapezoid is off by up to a quarter of jerk times dt.
        assert (wrong / dt[begin:]).max() <= 0.25 * 2.0 * 25.0
        assert wrong.mean() < 2e-4


# ---- positions


@pytest.mark.parametrize("name", list(ShaperName))
@pytest.mark.parametrize("goal", [(4.0, -2.0), (0.003, 0.0), (-60.0, 25.0)])
def test_a_position_is_met_exactly(name: ShaperName, goal: tuple[float, float]) -> None:
    shaper = Shaper(shaped(), name)
    shaper.begin(Target((0.0, 0.0), (10.0, 5.0)))
    goal = (10.0 + goal[0], 5.0 + goal[1])
    record = Record(shaper, 5).follow(Target((0.0, 0.0), goal), 30.0)
    assert record.motions[0].pos_m == pytest.approx((10.0, 5.0), abs=1e-3)
    assert record.motions[-1].pos_m == pytest.approx(goal, abs=1e-9)
    assert record.motions[-1].vel_mps == (0.0, 0.0)
    assert record.motions[-1].acc_mps2 == (0.0, 0.0)
    assert shaper.ended
    along = (record.pos_m.T - (10.0, 5.0)) @ (
        np.subtract(goal, (10.0, 5.0)) / np.hypot(*np.subtract(goal, (10.0, 5.0)))
    )
    distance_m = math.dist(goal, (10.0, 5.0))
    assert along.max() <= distance_m + 1e-3, "not passed"


@pytest.mark.parametrize("name", SHAPERS)
def test_the_way_to_a_position_leaves_an_ideal_load_hanging_still(name: ShaperName) -> None:
    shaper = Shaper(shaped(), name)
    shaper.begin(Target((0.0, 0.0), (0.0, 0.0)))
    record = Record(shaper, 5, FINE_S).follow(Target((0.0, 0.0), (6.0, 0.0)), 16.0)
    peak_m = pendulum(record, OMEGA).max()
    assert peak_m > 0.1
    assert pendulum(record, OMEGA)[-1] < (0.2 if name is ShaperName.EI else 2e-3) * peak_m


def test_a_position_after_velocities_is_approached_from_where_the_vehicle_is() -> None:
    shaper = Shaper(shaped(), ShaperName.ZV)
    record = Record(shaper).follow(NORTH, 8.0)
    before = record.motions[-1]
    record.follow(Target((0.0, 0.0), (120.0, 7.0)), 0.05, (100.0, 7.0))
    first = record.motions[-1]
    assert first.pos_m == pytest.approx((100.0, 7.0), abs=0.5)
    assert first.vel_mps == pytest.approx(before.vel_mps, abs=0.05)
    record.follow(Target((0.0, 0.0), (120.0, 7.0)), 30.0, (104.0, 6.0))
    assert record.motions[-1].pos_m == pytest.approx((120.0, 7.0), abs=1e-9), "where it is now no longer matters"


def test_a_moving_position_is_followed() -> None:
    shaper = Shaper(shaped(), ShaperName.ZV)
    shaper.begin(Target((0.0, 0.0), (0.0, 0.0)))
    dt_s = 0.01
    for k in range(2500):
        goal = Target((1.5, 0.0), (1.5 * k * dt_s, 0.0))
        motion = shaper.update(goal, dt_s, None)
    assert motion.vel_mps == pytest.approx((1.5, 0.0), abs=1e-6)
    # The impulses and the mean lie behind by their mean delay.
    behind_s = 0.25 * PERIOD_S + 0.5 * 2.0 * 2.0 / 25.0
    assert goal.pos_m is not None
    assert goal.pos_m[0] - motion.pos_m[0] == pytest.approx(1.5 * behind_s, abs=0.005)
    for _ in range(1500):
        motion = shaper.update(Target((0.0, 0.0), goal.pos_m), dt_s, None)
    assert motion.pos_m == pytest.approx(goal.pos_m, abs=1e-9)


def test_it_begins_where_what_is_asked_for_stands() -> None:
    shaper = Shaper(shaped(), ShaperName.EI)
    for target in (Target((2.0, -1.0)), Target((2.0, -1.0), (30.0, 40.0)), Target((0.0, 0.0), (-3.0, 8.0))):
        shaper.begin(target)
        assert shaper.ended
        motion = shaper.update(target, 1e-6, None)
        assert motion.vel_mps == pytest.approx(target.vel_mps, abs=1e-5)
        assert motion.acc_mps2 == pytest.approx((0.0, 0.0), abs=1e-5)
        if target.pos_m is not None:
            assert motion.pos_m == pytest.approx(target.pos_m, abs=1e-4)


# ---- other parameters on the way


@pytest.mark.parametrize("moment_s", [0.3, 1.0, 2.0, 6.0])
@pytest.mark.parametrize(
    ("before", "after"),
    [
        ((shaped(1.5), ShaperName.ZV), (shaped(1.8), ShaperName.ZV)),
        ((shaped(3.0), ShaperName.EI), (shaped(1.5), ShaperName.EI)),
        ((shaped(1.5), ShaperName.ZV), (shaped(1.5), ShaperName.ZVD)),
        ((shaped(1.5, acc_max_mps2=3.0), ShaperName.ZVD), (shaped(1.5, acc_max_mps2=1.0), ShaperName.ZVD)),
        ((shaped(1.5, acc_max_mps2=1.0), ShaperName.ZVD), (shaped(1.5, acc_max_mps2=3.0), ShaperName.ZVD)),
    ],
    ids=["longer", "shorter", "other", "gentler", "brisker"],
)
@pytest.mark.parametrize("goal", [None, (20.0, 0.0)], ids=["velocity", "position"])
def test_another_shaper_is_taken_without_a_jump(
    before: tuple[Parameters, ShaperName],
    after: tuple[Parameters, ShaperName],
    moment_s: float,
    goal: tuple[float, float] | None,
) -> None:
    shaper = Shaper(*before)
    target = NORTH if goal is None else Target((0.0, 0.0), goal)
    if goal is not None:
        shaper.begin(Target((0.0, 0.0), (0.0, 0.0)))
    record = Record(shaper, 7).follow(target, moment_s)
    shaper.configure(*after)
    record.follow(target, 40.0)
    dt = np.diff(record.times)
    # What the change adds stays a fraction of the limits themselves.
    acc_max = max(parameters.shaping.acc_max_mps2 for parameters, _ in (before, after))
    assert np.hypot(*record.acc_mps2).max() <= 1.5 * acc_max
    assert (np.hypot(*np.diff(record.vel_mps, axis=1)) / dt).max() <= 1.5 * acc_max
    assert (np.hypot(*np.diff(record.acc_mps2, axis=1)) / dt).max() <= 1.2 * before[0].shaping.jerk_max_mps3
    if goal is None:
        assert record.motions[-1].vel_mps == pytest.approx((3.0, 0.0), abs=1e-9)
    else:
        assert record.motions[-1].pos_m == pytest.approx(goal, abs=1e-9)
        assert (np.hypot(*np.diff(record.pos_m, axis=1)) / dt).max() <= 1.3 * before[0].shaping.vel_max_mps
    # From now on it is the other shaper.
    record.motions.clear()
    record.t.clear()
    fresh = Record(Shaper(*after), 8)
    step = Target((1.0, 0.0)) if goal is None else Target((0.0, 0.0), (24.0, 0.0))
    if goal is not None:
        fresh.shaper.begin(Target((0.0, 0.0), goal))
    else:
        fresh.shaper.begin(NORTH)
    for _ in range(500):
        one, other = shaper.update(step, 0.01, None), fresh.shaper.update(step, 0.01, None)
        assert one.vel_mps == pytest.approx(other.vel_mps, abs=1e-6)


@pytest.mark.parametrize("placed_first", [False, True])
def test_a_change_keeps_velocity_and_acceleration_the_derivatives(placed_first: bool) -> None:
    """Also where positions are asked for in the middle of it: the motion is then where the vehicle is, at its speed."""
    shaper = Shaper(shaped(3.0), ShaperName.ZVD)
    here, there = (50.0, 4.0), Target((0.0, 0.0), (58.0, 2.0))
    if placed_first:
        shaper.begin(Target((0.0, 0.0), here))
    record = Record(shaper, 11, FINE_S)
    record.follow(there if placed_first else NORTH, 1.4)
    shaper.configure(shaped(1.2), ShaperName.ZVD)
    record.follow(there if placed_first else NORTH, 1.1)
    changed = len(record.motions)
    record.follow(there, 25.0, here)
    if not placed_first:
        assert record.motions[changed].pos_m == pytest.approx(here, abs=0.02)
    dt = np.diff(record.times)
    for value, rate, begin in (
        (record.pos_m, record.vel_mps, 0 if placed_first else changed),
        (record.vel_mps, record.acc_mps2, 0),
    ):
        mean = 0.5 * (rate[:, 1:] + rate[:, :-1])
        wrong = np.abs(np.diff(value, axis=1) / dt - mean)[:, begin:]
        # In velocity the old and the new motion need not agree in place.
        assert wrong.mean() < 2e-4
        assert (wrong / dt[begin:]).max() <= 0.25 * 2.0 * 25.0
    assert record.motions[-1].pos_m == pytest.approx(there.pos_m, abs=1e-9)


def test_a_brisker_limit_waits_for_the_window_that_belongs_to_it() -> None:
    shaper = Shaper(shaped(1.5, acc_max_mps2=1.0), ShaperName.NONE)
    shaper.configure(shaped(1.5, acc_max_mps2=4.0), ShaperName.NONE)
    record = Record(shaper, 2).follow(NORTH, 0.3).follow(Target((-3.0, 0.0)), 0.5)
    assert np.hypot(*record.jerk_mps3).max() <= 1.05 * 25.0


def test_a_cruise_does_not_notice_a_longer_cable() -> None:
    shaper = Shaper(shaped(1.5), ShaperName.ZV)
    record = Record(shaper).follow(NORTH, 8.0)
    shaper.configure(shaped(2.5), ShaperName.ZV)
    record.motions.clear()
    record.follow(NORTH, 20.0)
    assert np.abs(record.vel_mps[0] - 3.0).max() < 1e-9


def test_changes_of_parameters_in_quick_succession_end_in_the_last() -> None:
    shaper = Shaper(shaped(1.5), ShaperName.ZV)
    record = Record(shaper)
    for length_m in (1.6, 2.0, 0.8, 1.2):
        shaper.configure(shaped(length_m), ShaperName.ZV)
        record.follow(NORTH, 0.5)
    record.follow(NORTH, 40.0)
    assert shaper.ended
    fresh = Shaper(shaped(1.2), ShaperName.ZV)
    fresh.begin(NORTH)
    for _ in range(300):
        one, other = (each.update(Target((0.0, 1.0)), 0.01, None) for each in (shaper, fresh))
        assert one.vel_mps == pytest.approx(other.vel_mps, abs=1e-6)


def test_what_is_remembered_is_bounded_by_the_longest_delay() -> None:
    """The longest cable, the softest jerk, 400 Hz, for five minutes."""
    slow = shaped(200.0, acc_max_mps2=20.0, jerk_max_mps3=0.1)
    shaper = Shaper(slow, ShaperName.ZVD)
    sizes = []
    for k in range(120_000):
        shaper.update(Target((2.0 * (k // 400 % 2), 0.0)), 0.0025, None)
        sizes.append(len(shaper._history._t))
    longest_s = 2.0 * math.pi * math.sqrt(200.0 / 9.80665) + WINDOW_MAX_S
    assert max(sizes) <= longest_s / 0.0025 + 1000
    assert max(sizes[-20000:]) <= max(sizes[:60000])
