"""Acceleration, velocity and displacement: consistent, bounded, without steady offset."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.control.base import Vec2
from swingd.model.parameters import Control
from swingd.pipeline.correction import NO_PUSH, Correction, Push
from swingd.pipeline.envelope import Fade

DT_S = 0.01
TINY = 1e-300
"""Subnormal numbers have no relative precision."""


def pair(push: Push) -> tuple[Vec2, Vec2]:
    return push.acc_mps2, push.vel_mps


CONTROL = Control()
WIDE = replace(CONTROL, acc_max_mps2=20.0, vel_max_mps=20.0, jerk_max_mps3=1000.0, displacement_max_m=50.0)


def swing(t_s: float, amplitude: float = 1.0, frequency_hz: float = 0.43) -> Vec2:
    phase = 2.0 * math.pi * frequency_hz * t_s
    return amplitude * math.cos(phase), 0.5 * amplitude * math.sin(phase)


def test_velocity_and_displacement_are_the_leaky_integrals_of_the_acceleration() -> None:
    correction = Correction(WIDE)
    x = y = u = v = 0.0
    for k in range(3000):
        push = correction.update(swing(DT_S * k), 1.0, DT_S)
        acc = push.acc_mps2
        kept = math.exp(-DT_S / WIDE.velocity_leak_s)
        x, y = kept * x + acc[0] * DT_S, kept * y + acc[1] * DT_S
        u, v = kept * u + x * DT_S, kept * v + y * DT_S
        assert push.vel_mps == pytest.approx((x, y), abs=1e-12)
        assert push.pos_m == pytest.approx((u, v), abs=1e-12)


def test_within_the_limits_a_swing_passes_with_the_washouts_phase_only() -> None:
    correction = Correction(WIDE)
    omega, washout_s = 2.0 * math.pi * 0.43, WIDE.washout_s
    errors = []
    for k in range(6000):
        acc, _ = pair(correction.update(swing(DT_S * k), 1.0, DT_S))
        # s Tw / (1 + s Tw) at the swing's frequency, once the start has died away.
        gain = complex(0.0, omega * washout_s) / complex(1.0, omega * washout_s)
        phase = omega * DT_S * k
        expected = abs(gain) * math.cos(phase + math.atan2(gain.imag, gain.real))
        errors.append(abs(acc[0] - expected))
    assert max(errors[-500:]) < 0.01


@pytest.mark.parametrize("wanted", [(1.0, 0.0), (-0.4, 2.5)])
def test_a_steady_swing_leaves_no_offset(wanted: Vec2) -> None:
    correction = Correction(CONTROL)
    first, _ = pair(correction.update(wanted, 1.0, 1.0))
    assert math.hypot(*first) > 0.8 * math.hypot(*wanted), "a swing at entry is answered"
    for _ in range(round(8.0 * CONTROL.washout_s / DT_S)):
        acc, vel = pair(correction.update(wanted, 1.0, DT_S))
    assert math.hypot(*acc) < 1e-3 * math.hypot(*wanted)
    assert math.hypot(*vel) < 0.01 * math.hypot(*wanted)


components = st.floats(-50.0, 50.0)
controls = st.builds(
    Control,
    velocity_leak_s=st.floats(0.2, 60.0),
    washout_s=st.floats(0.5, 120.0),
    acc_max_mps2=st.floats(0.0, 20.0),
    vel_max_mps=st.floats(0.0, 20.0),
    jerk_max_mps3=st.floats(0.1, 1000.0),
    displacement_max_m=st.floats(0.0, 50.0),
    fade_in_s=st.floats(0.0, 10.0),
    fade_out_s=st.floats(0.0, 5.0),
)


@given(
    controls,
    st.lists(st.tuples(st.tuples(components, components), st.booleans(), st.integers(1, 40)), max_size=25),
    st.floats(0.002, 0.05),
)
def test_size_slew_and_fade_are_bounded_whatever_is_wanted(
    control: Control, pieces: list[tuple[Vec2, bool, int]], dt_s: float
) -> None:
    correction, fade = Correction(control), Fade(control)
    before = (0.0, 0.0)
    for wanted, allowed, count in pieces:
        for _ in range(count):
            value = fade.update(allowed, dt_s)
            push = correction.update(wanted, value, dt_s)
            acc, vel = pair(push)
            assert math.hypot(*push.pos_m) <= value * control.displacement_max_m * (1.0 + 1e-9) + TINY
            slack = 1.0 + 1e-9
            assert math.hypot(*acc) <= control.acc_max_mps2 * slack + TINY
            assert math.hypot(*vel) <= value * control.vel_max_mps * slack + TINY
            if value == 0.0:
                assert push == NO_PUSH
            else:
                change = math.hypot(acc[0] - before[0], acc[1] - before[1])
                assert change <= control.jerk_max_mps3 * dt_s * slack + 1e-12
            before = acc


def test_ramping_out_ends_without_a_step() -> None:
    """With the default ramp the jerk limit leaves nothing over when the fade reaches zero."""
    correction, fade = Correction(CONTROL), Fade(CONTROL)
    before: Vec2 = (0.0, 0.0)
    biggest = 0.0
    for k in range(800):
        value = fade.update(k < 400, DT_S)
        acc, _ = pair(correction.update((4.0 * math.sin(0.03 * k), -3.0), value, DT_S))
        biggest = max(biggest, math.hypot(acc[0] - before[0], acc[1] - before[1]))
        before = acc
    assert biggest <= CONTROL.jerk_max_mps3 * DT_S + 1e-9
    assert before == (0.0, 0.0)


def test_it_starts_from_zero_after_a_break() -> None:
    correction = Correction(CONTROL)
    for k in range(500):
        correction.update(swing(DT_S * k, 3.0), 1.0, DT_S)
    correction.update((3.0, 0.0), 0.0, DT_S)
    again = Correction(CONTROL)
    for k in range(100):
        assert correction.update(swing(DT_S * k), 0.5, DT_S) == again.update(swing(DT_S * k), 0.5, DT_S)


def test_what_was_asked_last_is_faded_where_nothing_may_be_asked() -> None:
    """A doubtful estimate is not listened to while its last word is taken back."""
    correction, fade = Correction(CONTROL), Fade(CONTROL)
    for _ in range(200):
        before, _ = pair(correction.update((1.0, -0.5), fade.update(True, DT_S), DT_S))
    sizes = []
    for _ in range(60):
        acc, _ = pair(correction.update(None, fade.update(False, DT_S), DT_S))
        assert acc[0] * before[1] == pytest.approx(acc[1] * before[0], abs=1e-12), "along the same line"
        sizes.append(math.hypot(*acc))
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] == pytest.approx(math.hypot(*before), rel=0.1)
    assert sizes[-1] == 0.0


def test_other_limits_are_taken_where_the_correction_stands() -> None:
    correction = Correction(CONTROL)
    for _ in range(100):
        acc, vel = pair(correction.update((2.0, 0.0), 1.0, DT_S))
    correction.configure(replace(CONTROL, washout_s=100.0))
    again, vel_again = pair(correction.update((2.0, 0.0), 1.0, DT_S))
    assert again == pytest.approx(acc, abs=0.01)
    assert vel_again == pytest.approx(vel, abs=0.05)
