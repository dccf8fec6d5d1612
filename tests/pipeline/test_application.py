"""The stream of an application's setpoints: how long one holds, and whose it is."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.model.events import AppSetpoint, SetpointUse
from swingd.pipeline.application import (
    ARRIVALS_MAX,
    CONTEST_S,
    FADED_SHARE,
    FRESH_SHARE,
    RECOVERY_S,
    REPEAT_MAX_S,
    WINDOW_S,
    ApplicationStream,
)

ONE, OTHER = 0x01FF42, 0x02FF42


def setpoint(t_s: float, source: int = ONE) -> AppSetpoint:
    zero = (0.0, 0.0, 0.0)
    return AppSetpoint(t_s, SetpointUse.VEL, zero, (1.0, 0.0, 0.0), zero, 0.0, 0.0, source)


def stream(*times_s: float) -> ApplicationStream:
    application = ApplicationStream()
    for t_s in times_s:
        application.take(setpoint(t_s))
    return application


def steady(interval_s: float, count: int = 30, begin_s: float = 100.0) -> tuple[ApplicationStream, float]:
    """A stream without jitter, and the time of its last setpoint."""
    times = [begin_s + k * interval_s for k in range(count)]
    return stream(*times), times[-1]


# ------------------------------------------------------------------------------------------------------- how it repeats


@pytest.mark.parametrize("rate_hz", [200.0, 50.0, 20.0, 10.0, 6.0])
def test_a_setpoint_is_repeated_for_three_intervals_and_half_a_second_at_most(rate_hz: float) -> None:
    application, last_s = steady(1.0 / rate_hz)
    repeat_s = min(REPEAT_MAX_S, 3.0 / rate_hz)
    assert application.repeat_s == pytest.approx(repeat_s)
    assert application.holds(last_s)
    assert application.holds(last_s + 0.99 * repeat_s)
    assert not application.holds(last_s + 1.01 * repeat_s)


@pytest.mark.parametrize("begin_s", [0.0, 0.1, 7.3, 1e5])
def test_five_a_second_is_enough_and_less_is_not(begin_s: float) -> None:
    enough, last_s = steady(0.2, begin_s=begin_s)
    assert enough.holds(last_s + 0.19)
    too_slow, last_s = steady(1.0 / 4.8, begin_s=begin_s)
    assert too_slow.repeat_s == 0.0
    assert not too_slow.holds(last_s)


def test_a_stream_of_five_a_second_that_jitters_is_corrected_throughout() -> None:
    application = ApplicationStream()
    for k in range(100):
        t_s = 0.2 * k + 0.01 * math.sin(7.0 * k)
        application.take(setpoint(t_s))
        assert application.repeat_s > 0.0 or k < 10, k


def test_the_longest_interval_counts_for_as_long_as_it_is_remembered() -> None:
    application, last_s = steady(0.05)
    application.take(setpoint(last_s + 0.14))
    assert application.repeat_s == pytest.approx(0.42)
    t_s = last_s + 0.14
    while t_s + 0.05 < last_s + WINDOW_S:
        t_s += 0.05
        application.take(setpoint(t_s))
        assert application.repeat_s == pytest.approx(0.42)
    for _ in range(2):
        t_s += 0.05
        application.take(setpoint(t_s))
    assert application.repeat_s == pytest.approx(0.15)


def test_a_young_stream_is_not_repeated_and_neither_is_one_after_a_pause() -> None:
    application = ApplicationStream()
    for t_s, repeated in ((1.0, False), (1.05, False), (1.10, True), (1.65, False), (1.70, False), (1.75, True)):
        application.take(setpoint(t_s))
        assert (application.repeat_s > 0.0) == repeated, t_s
        assert application.holds(t_s) == repeated


def test_what_is_asked_for_besides_ends_it() -> None:
    application, last_s = steady(0.05)
    application.end()
    assert application.setpoint is None
    assert application.repeat_s == 0.0
    assert not application.holds(last_s)
    application.take(setpoint(last_s + 0.05))
    assert not application.holds(last_s + 0.05), "it begins as a young one"


def test_before_anything_came_nothing_holds() -> None:
    application = ApplicationStream()
    assert application.setpoint is None
    assert not application.holds(0.0)
    assert not application.is_contested(0.0)
    assert application.freshness(0.0, 0.01) == 0.0


intervals = st.lists(st.floats(1e-4, 1.0), min_size=1, max_size=60)


@given(intervals)
def test_no_jitter_lets_a_setpoint_live_longer_than_it_may(gaps_s: list[float]) -> None:
    application, t_s, times = ApplicationStream(), 50.0, []
    for gap_s in gaps_s:
        t_s += gap_s
        times.append(t_s)
        application.take(setpoint(t_s))
        recent = [a for a in times if a >= t_s - WINDOW_S]
        longest_s = max((b - a for a, b in pairwise(recent)), default=math.inf)
        assert 0.0 <= application.repeat_s <= min(REPEAT_MAX_S, 3.0 * longest_s) + 1e-12
        if application.repeat_s:
            assert application.repeat_s >= min(REPEAT_MAX_S, 3.0 * gap_s) - 1e-12


def test_a_flood_is_not_kept() -> None:
    application, _ = steady(1e-5, 3 * ARRIVALS_MAX)
    assert len(application._arrivals) <= ARRIVALS_MAX
    assert application.repeat_s == pytest.approx(3e-5, rel=1e-3)


# ------------------------------------------------------------------------------------------------------- whose it is


def test_two_sources_within_a_second_contest_the_vehicle() -> None:
    application, last_s = steady(0.05)
    application.take(setpoint(last_s + 0.02, OTHER))
    assert application.is_contested(last_s + 0.02)
    assert not application.holds(last_s + 0.02)
    t_s = last_s + 0.02
    # The first goes on alone: no longer contested a second after the last change of hands.
    while t_s < last_s + 0.07 + CONTEST_S - 0.06:
        t_s += 0.05
        application.take(setpoint(t_s))
        assert application.is_contested(t_s)
        assert not application.holds(t_s)
    for _ in range(3):
        t_s += 0.05
        application.take(setpoint(t_s))
    assert not application.is_contested(t_s)
    assert application.holds(t_s)


def test_as_long_as_both_go_on_neither_holds() -> None:
    application = ApplicationStream()
    for k in range(200):
        t_s = 0.05 * k
        application.take(setpoint(t_s, ONE if k % 2 else OTHER))
        assert not application.holds(t_s)
        assert application.is_contested(t_s) == (k > 0)


def test_one_after_the_other_is_no_contest_but_begins_anew() -> None:
    application, last_s = steady(0.05)
    t_s = last_s + CONTEST_S
    application.take(setpoint(t_s, OTHER))
    assert not application.is_contested(t_s)
    assert application.repeat_s == 0.0


# ------------------------------------------------------------------------------------------------------- freshness


def test_the_correction_is_gone_before_the_repetition_ends() -> None:
    application, last_s = steady(0.1)
    repeat_s = application.repeat_s
    application.met()
    shares = [(k * 1e-3, application.freshness(last_s + k * 1e-3, 1e-3)) for k in range(round(repeat_s / 1e-3))]
    for age_s, share in shares:
        if age_s <= FRESH_SHARE * repeat_s:
            assert share == 1.0
        if age_s >= FADED_SHARE * repeat_s:
            assert share == 0.0
    steps = [a - b for (_, a), (_, b) in pairwise(shares)]
    assert min(steps) >= 0.0
    assert max(steps) <= 1e-3 / (repeat_s * (FADED_SHARE - FRESH_SHARE)) + 1e-9, "a ramp, no step"


def test_after_a_falter_the_correction_comes_back_gently() -> None:
    application, last_s = steady(0.1)
    application.met()
    assert application.freshness(last_s + 0.3, 0.01) == 0.0
    last_s += 0.3
    application.take(setpoint(last_s))
    shares = [application.freshness(last_s, 0.01) for _ in range(round(RECOVERY_S / 0.01) + 1)]
    assert shares[0] == pytest.approx(0.01 / RECOVERY_S)
    assert max(b - a for a, b in pairwise(shares)) <= 0.01 / RECOVERY_S + 1e-12
    assert shares[-1] == 1.0
    application.freshness(last_s + 0.3, 0.01)
    application.take(setpoint(last_s + 0.35))
    application.met()
    assert application.freshness(last_s + 0.35, 0.01) == 1.0, "another correction begins, which fades in by itself"


def test_a_steady_stream_is_always_fresh() -> None:
    for interval_s in (0.01, 0.05, 0.2):
        application, last_s = steady(interval_s)
        application.met()
        for k in range(1, 200):
            t_s = last_s + 0.01 * k
            while application.setpoint is not None and application.setpoint.t_mono_s + interval_s <= t_s:
                application.take(setpoint(application.setpoint.t_mono_s + interval_s))
            assert application.freshness(t_s, 0.01) == 1.0
