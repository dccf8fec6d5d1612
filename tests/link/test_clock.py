import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.link.clock import RemoteClock, Verdict, unwrap

GOOD = Verdict.GOOD


def settled(offset_s: float = 100.0, until_s: float = 2.0, rate_hz: float = 100.0) -> RemoteClock:
    clock = RemoteClock()
    for i in range(int(until_s * rate_hz)):
        assert clock.judge(i / rate_hz, offset_s + i / rate_hz) is GOOD
    return clock


def test_jitter_drift_and_stalls_of_the_link_are_no_clock_jumps():
    rng = random.Random(1)
    clock = RemoteClock()
    t_arrival_s = 0.0
    for i in range(20_000):
        t_s = i * 0.01
        stall_s = max(0.0, 40.7 - t_s) if 40.0 < t_s < 40.7 else 0.0
        t_arrival_s = max(t_arrival_s, t_s + 0.002 + rng.expovariate(200.0) + stall_s)
        assert clock.judge(t_arrival_s, 5.0 + t_s * (1.0 + 1e-4)) is GOOD


def test_one_wild_stamp_changes_nothing():
    clock = settled()
    assert clock.judge(2.0, 1e6) is Verdict.AHEAD
    assert clock.judge(2.01, 102.01) is GOOD


def test_wild_stamps_between_good_ones_never_become_the_clock():
    clock = settled()
    for i in range(500):
        t_s = 2.0 + i * 0.01
        assert clock.judge(t_s, 100.0 + t_s) is GOOD
        assert clock.judge(t_s, 5000.0 + t_s) is Verdict.AHEAD


@pytest.mark.parametrize("new_offset_s", [-2.0, 98.5, 110.0, 1e5])
def test_a_clock_that_stays_changed_is_believed_after_a_moment(new_offset_s):
    clock = settled()
    verdicts = [clock.judge(2.0 + i * 0.01, new_offset_s + 2.0 + i * 0.01) for i in range(60)]
    assert verdicts.count(Verdict.RESTART) == 1
    at = verdicts.index(Verdict.RESTART)
    assert 25 <= at <= 35
    assert clock.step_s == pytest.approx(new_offset_s - 100.0, abs=1e-9)
    assert set(verdicts[at + 1 :]) == {GOOD}


def test_a_frozen_clock_is_late_and_never_believed():
    clock = settled()
    verdicts = {clock.judge(2.0 + i * 0.01, 101.99) for i in range(110, 1000)}
    assert verdicts == {Verdict.LATE}


def test_a_backlog_delivered_at_once_is_late_and_then_good():
    clock = settled()
    verdicts = [clock.judge(7.0, 102.0 + i * 0.01) for i in range(500)]
    assert verdicts[0] is Verdict.LATE
    assert verdicts[-1] is GOOD
    assert Verdict.RESTART not in verdicts


@pytest.mark.parametrize("speed", [0.1, 0.5, 2.0, 20.0])
def test_a_simulator_at_another_speed_is_followed(speed):
    clock = RemoteClock()
    assert {clock.judge(i * 0.01 / speed, i * 0.01) for i in range(3000)} == {GOOD}


@given(st.integers(0, 10**12), st.integers(0, 2**32 - 1))
def test_a_wrapped_stamp_is_found_near_the_expected_time(true_ms, error_ms):
    error_ms = error_ms % 1000 - 500
    found_s = unwrap(true_ms % 2**32 * 1e-3, (true_ms + error_ms) * 1e-3, 2**32 * 1e-3)
    assert found_s == pytest.approx(true_ms * 1e-3, abs=1e-3)
