"""What makes a correction distrusted: growth, a limit, a vehicle that does not follow it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from swingd.control.base import Vec2
from swingd.model.parameters import Parameters
from swingd.pipeline.correction import Push
from swingd.pipeline.damping_watch import GAIN_MIN, DampingWatch, Motion

DT_S = 0.01
PARAMETERS = Parameters()
OMEGA = math.sqrt(9.80665 / PARAMETERS.cable.length_m)
PERIOD_S = 2.0 * math.pi / OMEGA
STILL = Motion(
    dt_s=DT_S,
    load_m=(0.0, 0.0),
    load_rate_mps=(0.0, 0.0),
    vel_mps=(0.0, 0.0),
    vel_ref_mps=(0.0, 0.0),
    acc_ref_mps2=(0.0, 0.0),
    lean_mps2=(0.0, 0.0),
    tilt_acc_mps2=(0.0, 0.0),
    heading_rad=0.0,
    push=Push((0.1, 0.0)),
    limited=False,
)


def swing(t_s: float, begin_mps: float, growth_per_period: float) -> tuple[Vec2, Vec2]:
    """Displacement and velocity of a swing to the north whose amplitude changes by a factor each period."""
    rate = math.log(growth_per_period) / PERIOD_S
    amplitude = begin_mps * math.exp(rate * t_s)
    s, c = math.sin(OMEGA * t_s), math.cos(OMEGA * t_s)
    return (amplitude / OMEGA * s, 0.0), (amplitude * (c + rate / OMEGA * s), 0.0)


def fly_swing(watch: DampingWatch, periods: float, begin_mps: float, growth_per_period: float) -> float | None:
    """Return when it was distrusted, in periods."""
    for k in range(round(periods * PERIOD_S / DT_S)):
        load_m, rate_mps = swing(k * DT_S, begin_mps, growth_per_period)
        watch.update(replace(STILL, load_m=load_m, load_rate_mps=rate_mps))
        if watch.distrust:
            return k * DT_S / PERIOD_S
    return None


def test_a_swing_that_grows_over_two_periods_is_distrusted() -> None:
    watch = DampingWatch(PARAMETERS)
    at = fly_swing(watch, 6.0, 0.4, 1.4)
    assert at is not None
    assert 2.0 <= at <= 2.6
    assert watch.distrust == "the swing has grown over two periods"


@pytest.mark.parametrize(("begin_mps", "growth"), [(0.4, 1.0), (2.0, 0.5), (0.4, 1.1), (0.02, 1.4)])
def test_a_swing_that_stays_falls_or_is_small_is_not(begin_mps: float, growth: float) -> None:
    assert fly_swing(DampingWatch(PARAMETERS), 5.0, begin_mps, growth) is None


@pytest.mark.parametrize("payload_share", [0.15, 0.3])
def test_leaning_against_the_loads_own_pull_explains_no_growth(payload_share: float) -> None:
    watch = DampingWatch(PARAMETERS)
    for k in range(round(6.0 * PERIOD_S / DT_S)):
        load_m, rate_mps = swing(k * DT_S, 0.4, 1.3)
        lean = (-9.8 * payload_share * load_m[0] / PARAMETERS.cable.length_m, 0.0)
        motion = replace(STILL, load_m=load_m, load_rate_mps=rate_mps, lean_mps2=lean, tilt_acc_mps2=lean)
        watch.update(motion)
    assert watch.distrust == "the swing has grown over two periods"


def test_a_swing_that_the_reference_excites_is_explained() -> None:
    """An application that pumps the swing at its own frequency; the uncorrected load does the same below the twin."""
    grown = {}
    for pumped in (True, False):
        watch = DampingWatch(PARAMETERS)
        load, rate, vel, acc = 0.0, 0.0, 0.0, 0.0
        for k in range(round(5.0 * PERIOD_S / DT_S)):
            wanted = 0.6 * math.sin(OMEGA * k * DT_S)
            acc += DT_S / 0.12 * (1.8 * (wanted - vel) - acc)
            vel += DT_S * acc
            rate += DT_S * (-OMEGA * OMEGA * load - acc)
            load += DT_S * rate
            watch.update(
                replace(
                    STILL,
                    load_m=(load, 0.0),
                    load_rate_mps=(rate, 0.0),
                    vel_mps=(vel, 0.0),
                    vel_ref_mps=(wanted if pumped else 0.0, 0.0),
                    tilt_acc_mps2=(acc if pumped else 0.0, 0.0),
                )
            )
        grown[pumped] = watch.distrust
    assert grown == {True: "", False: "the swing has grown over two periods"}


def test_a_whole_period_at_a_limit_is_distrusted() -> None:
    watch = DampingWatch(PARAMETERS)
    steps = round(PERIOD_S / DT_S)
    for _ in range(3):
        for _ in range(steps - 2):
            watch.update(replace(STILL, limited=True))
        watch.update(STILL)
        assert not watch.distrust, "it left the limit in between"
    for _ in range(steps + 2):
        watch.update(replace(STILL, limited=True))
    assert watch.distrust == "it has sat at a limit for a whole period"


def fly_push(watch: DampingWatch, gain: float, axis: int, heading_rad: float = 0.0, seed: int = 1) -> str:
    """Push at the swing's frequency along an axis of the nose; the tilt answers 0.1 s later, in noise and a trim."""
    noise = np.random.default_rng(seed).normal(0.0, 0.1, (600, 2))
    along = (math.cos(heading_rad + axis * math.pi / 2.0), math.sin(heading_rad + axis * math.pi / 2.0))
    for k in range(600):
        size, answer = (0.8 * math.sin(OMEGA * t_s) for t_s in (k * DT_S, max(k - 10, 0) * DT_S))
        tilt = (
            gain * answer * along[0] + 0.5 + noise[k, 0],
            gain * answer * along[1] - 0.3 + noise[k, 1],
        )
        push = Push((size * along[0], size * along[1]))
        watch.update(replace(STILL, push=push, tilt_acc_mps2=tilt, heading_rad=heading_rad))
    return watch.distrust


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("heading_rad", [0.0, 1.0, -2.5])
def test_a_vehicle_that_answers_the_wrong_way_is_found_on_either_axis(axis: int, heading_rad: float) -> None:
    assert fly_push(DampingWatch(PARAMETERS), -1.0, axis, heading_rad).startswith("the vehicle answers it by -")
    assert fly_push(DampingWatch(PARAMETERS), 0.0, axis, heading_rad).startswith("the vehicle answers it by ")


@pytest.mark.parametrize("gain", [GAIN_MIN + 0.2, 0.7, 1.0, 1.5])
def test_a_vehicle_that_answers_is_trusted(gain: float) -> None:
    assert [fly_push(DampingWatch(PARAMETERS), gain, axis, seed=seed) for axis in (0, 1) for seed in range(3)] == [
        ""
    ] * 6


def test_only_enabling_ends_a_distrust() -> None:
    watch = DampingWatch(PARAMETERS)
    assert fly_push(watch, -1.0, 0)
    watch.rest()
    watch.configure(PARAMETERS)
    assert watch.distrust
    watch.enabled()
    assert not watch.distrust
    assert fly_push(watch, 1.0, 0) == ""


def test_what_was_seen_before_a_rest_counts_no_more() -> None:
    watch = DampingWatch(PARAMETERS)
    for _ in range(5):
        assert fly_swing(watch, 1.9, 0.5, 1.5) is None
        watch.rest()
