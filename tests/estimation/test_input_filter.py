"""Matched filters: in phase, delay told and made up for, lines taken out, nothing at the start, bad inputs."""

import math

import numpy as np
import pytest
from scipy.signal import butter, group_delay, iirnotch, lfilter

from swingd.core import input_filter as kernels
from swingd.core.status import Status
from swingd.estimation.input_filter import MatchedFilter
from swingd.estimation.tether_direction import TetherDirection
from swingd.model.errors import ConfigurationError

RATE_HZ = 100.0
DT_S = 1.0 / RATE_HZ


def through(matched, signal, dt_s=DT_S):
    """The first force's course of a signal, (n,)."""
    out = []
    for value in signal:
        status, force, _ = matched.step(np.array([value, 0.0, 0.0]), np.zeros(3), dt_s)
        assert status is Status.OK
        out.append(force[0])
    return np.array(out)


def test_sections_are_scipy_s():
    section = np.empty(5)
    kernels.low_pass(section, 8.0, math.sqrt(0.5), RATE_HZ)
    b, a = butter(2, 8.0, fs=RATE_HZ)
    np.testing.assert_allclose(section, [*b, *a[1:]], rtol=1e-12)
    kernels.notch(section, 20.0, 4.0, RATE_HZ)
    turn = 2.0 * np.pi * 20.0 / RATE_HZ
    zeros, poles = np.roots([section[0], section[1], section[2]]), np.roots([1.0, section[3], section[4]])
    np.testing.assert_allclose(np.sort_complex(zeros), np.sort_complex(np.exp([1j * turn, -1j * turn])), atol=1e-12)
    assert (np.abs(poles) < 1.0).all()
    narrow = np.empty(5)
    kernels.notch(narrow, 20.0, 2.0, RATE_HZ)
    b, a = iirnotch(20.0, 10.0, fs=RATE_HZ)
    np.testing.assert_allclose(narrow, [*b, *a[1:]], rtol=1e-12)


def test_filtering_is_scipy_s_from_rest():
    rng = np.random.default_rng(1)
    signal = np.concatenate([[0.0], rng.normal(size=300)])
    b, a = butter(2, 8.0, fs=RATE_HZ)
    np.testing.assert_allclose(through(MatchedFilter(RATE_HZ, 8.0), signal), lfilter(b, a, signal), atol=1e-12)


def test_force_and_acceleration_stay_in_phase():
    """What is subtracted later passes the same filter: the filtered difference is the difference of the filtered."""
    rng = np.random.default_rng(2)
    both, alone = MatchedFilter(RATE_HZ, 5.0, [(20.0, 4.0)]), MatchedFilter(RATE_HZ, 5.0, [(20.0, 4.0)])
    for _ in range(300):
        force, acc = rng.normal(size=3), rng.normal(size=3)
        _, f, a = both.step(force, acc, DT_S)
        _, difference, _ = alone.step(1.5 * acc - force, np.zeros(3), DT_S)
        np.testing.assert_allclose(1.5 * a - f, difference, atol=1e-12)


@pytest.mark.parametrize(("corner", "notches"), [(3.0, []), (8.0, [(20.0, 5.0)]), (math.inf, [(15.0, 5.0)])])
def test_the_delay_told_is_that_of_slow_signals(corner, notches):
    matched = MatchedFilter(RATE_HZ, corner, notches)
    b, a = np.array([1.0]), np.array([1.0])
    for row in matched._sections:
        b, a = np.convolve(b, row[:3]), np.convolve(a, [1.0, *row[3:]])
    _, delay = group_delay((b, a), [2.0 * np.pi * 0.05 / RATE_HZ])
    assert matched.delay_s == pytest.approx(delay[0] / RATE_HZ, rel=0.01)
    # A ramp arrives late by just that.
    ramp = 2.0 * np.arange(2000) * DT_S
    assert ramp[-1] - through(matched, ramp)[-1] == pytest.approx(2.0 * matched.delay_s, rel=1e-6)


def test_an_estimate_carried_over_the_delay_is_on_time():
    """A tether that swings at 0.4 Hz, its inputs 70 ms late: made up for, the error is a tenth."""
    matched, omega, size = MatchedFilter(RATE_HZ, 3.0), 2.0 * math.pi * 0.4, 0.2
    tether = TetherDirection(math.inf, 20.0, 0.1, 1.0)
    late, on_time = [], []
    for k in range(1000):
        angle = size * math.sin(omega * k * DT_S)
        _, force, _ = matched.step(np.array([math.sin(angle), 0.0, math.cos(angle)]), np.zeros(3), DT_S)
        assert tether.predict(np.zeros(3), DT_S) is Status.OK
        assert tether.correct(force, 1e-6 * np.eye(3)) is Status.OK
        late.append(math.asin(tether.direction[0]) - angle)
        on_time.append(math.asin(tether.ahead(matched.delay_s).direction[0]) - angle)
    assert matched.delay_s == pytest.approx(0.075, abs=0.005)
    assert np.std(late[200:]) == pytest.approx(size * omega * matched.delay_s / math.sqrt(2.0), rel=0.1)
    assert np.std(on_time[200:]) < 0.15 * np.std(late[200:])


def test_looking_ahead_does_not_change_what_looks():
    tether = TetherDirection(1.2, 0.1, 0.1, 0.1)
    tether.reset(np.array([0.3, 0.0, 1.0]))
    before, cov = tether.direction, tether.error_cov
    later = tether.ahead(0.1)
    assert later.direction[0] < before[0]
    np.testing.assert_array_equal(tether.direction, before)
    np.testing.assert_array_equal(tether.error_cov, cov)


def test_a_notch_takes_out_its_line_and_leaves_the_swing():
    t_s = np.arange(1000) * DT_S
    swing, line = np.sin(2.0 * np.pi * 0.5 * t_s), 3.0 * np.sin(2.0 * np.pi * 20.0 * t_s)
    matched = MatchedFilter(RATE_HZ, notches_hz=[(20.0, 4.0)])
    out = through(matched, swing + line)
    shift = np.sin(2.0 * np.pi * 0.5 * (t_s - matched.delay_s))
    assert np.abs(out[300:] - shift[300:]).max() < 0.01


def test_it_begins_as_if_the_first_sample_had_been_there_for_ever_and_anew_after_a_gap():
    matched = MatchedFilter(RATE_HZ, 2.0, [(20.0, 4.0)])
    np.testing.assert_allclose(through(matched, np.full(50, 7.0)), 7.0)
    _, force, _ = matched.step(np.array([-3.0, 0.0, 0.0]), np.zeros(3), 0.2)
    assert force[0] == pytest.approx(-3.0)
    matched.step(np.array([5.0, 0.0, 0.0]), np.zeros(3), DT_S)
    matched.reset()
    assert matched.step(np.array([1.0, 0.0, 0.0]), np.zeros(3), DT_S)[1][0] == pytest.approx(1.0)


def test_another_rate_gives_the_same_filter():
    slow, fast = MatchedFilter(RATE_HZ, 4.0), MatchedFilter(RATE_HZ, 4.0)
    t_s = np.arange(400) * DT_S
    signal = np.sin(2.0 * np.pi * 1.0 * t_s)
    a = through(slow, signal)
    b = through(fast, np.sin(2.0 * np.pi * 1.0 * np.arange(800) * 0.5 * DT_S), 0.5 * DT_S)
    assert fast.delay_s == pytest.approx(slow.delay_s, rel=0.02)
    np.testing.assert_allclose(b[400::2], a[200:], atol=0.02)


@pytest.mark.parametrize(
    ("low_pass_hz", "notches", "said"),
    [
        (0.0, [], "low-pass at 0 Hz; expected 0 < Hz < 45"),
        (46.0, [], "low-pass at 46 Hz; expected"),
        (math.inf, [(60.0, 1.0)], "notch at 60 Hz; expected"),
        (math.inf, [(20.0, 0.0)], "notch at 20 Hz: width 0 Hz; expected"),
    ],
)
def test_frequencies_that_cannot_be_are_refused(low_pass_hz, notches, said):
    with pytest.raises(ConfigurationError, match=said):
        MatchedFilter(RATE_HZ, low_pass_hz, notches)


def test_bad_inputs_are_answered_and_change_nothing():
    matched, same = MatchedFilter(RATE_HZ, 4.0), MatchedFilter(RATE_HZ, 4.0)
    for each in (matched, same):
        each.step(np.ones(3), np.ones(3), DT_S)
    bad = np.array([math.nan, 0.0, 0.0])
    assert matched.step(bad, np.ones(3), DT_S)[0] is Status.INPUT_INVALID
    assert matched.step(np.ones(3), np.ones(3), 0.0)[0] is Status.INPUT_INVALID
    np.testing.assert_array_equal(
        matched.step(np.zeros(3), np.ones(3), DT_S)[1], same.step(np.zeros(3), np.ones(3), DT_S)[1]
    )


def test_without_filters_it_passes_everything():
    matched = MatchedFilter(RATE_HZ)
    assert matched.delay_s == 0.0
    np.testing.assert_array_equal(matched.step(np.arange(3.0), np.ones(3), DT_S)[1], np.arange(3.0))
