"""From PX4's jittered streams to the filter's grid, and the attitude that belongs to a step."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from swingd.model.events import Attitude, Imu
from swingd.pipeline.sampling import AttitudeTracker, ImuInterval, ImuSampler, wrap_pi

GRID_S = 0.004
"""PX4's IMU samples."""


def px4_stamps(rate_hz: float, duration_s: float, seed: int = 1) -> list[float]:
    """Stamps of a stream that PX4 thins out of its 250 Hz: whole samples, jittered around the mean interval."""
    random = np.random.default_rng(seed)
    stamps: list[int] = []
    for k in range(int(duration_s * rate_hz)):
        jitter = 0.0 if rate_hz >= 250.0 else random.uniform(-0.5, 0.5)
        stamp = round(k / rate_hz / GRID_S + jitter)
        stamps.append(max(stamp, stamps[-1] + 1) if stamps else stamp)
    return [GRID_S * stamp for stamp in stamps]


def imu(t_s: float, acc: tuple[float, float, float] = (0.0, 0.0, -9.8), gyro_z: float = 0.0) -> Imu:
    return Imu(t_s, t_s, acc, (0.0, 0.0, gyro_z))


def sample(stamps: list[float], sampler: ImuSampler | None = None) -> list[ImuInterval]:
    """Intervals of a stream whose acceleration tells the time of each sample."""
    sampler = sampler or ImuSampler(100.0)
    intervals = (sampler.add(imu(t, (t, 0.0, 0.0))) for t in stamps)
    return [interval for interval in intervals if interval is not None]


@pytest.mark.parametrize("rate_hz", [250.0, 224.0, 200.0, 125.0, 100.0])
def test_a_stream_at_least_as_fast_gives_the_filters_rate(rate_hz: float) -> None:
    intervals = sample(px4_stamps(rate_hz, 60.0))
    elapsed_s = intervals[-1].t_boot_s - intervals[0].t_boot_s
    assert (len(intervals) - 1) / elapsed_s == pytest.approx(100.0, rel=0.01)
    assert max(interval.dt_s for interval in intervals) <= 0.0241


@pytest.mark.parametrize("rate_hz", [50.0, 28.0])
def test_a_slower_stream_passes_sample_by_sample(rate_hz: float) -> None:
    stamps = px4_stamps(rate_hz, 30.0)
    intervals = sample(stamps)
    assert [interval.t_boot_s for interval in intervals] == stamps[1:]
    assert [interval.acc_frd[0] for interval in intervals] == stamps[1:]


@pytest.mark.parametrize("rate_hz", [250.0, 224.0, 200.0, 125.0, 100.0, 50.0, 28.0])
def test_every_sample_enters_one_mean(rate_hz: float) -> None:
    stamps = np.array(px4_stamps(rate_hz, 20.0))
    begin_s = stamps[0]
    for interval in sample(stamps.tolist()):
        inside = stamps[(stamps > begin_s) & (stamps <= interval.t_boot_s)]
        assert interval.acc_frd[0] == pytest.approx(inside.mean(), abs=1e-12)
        assert interval.t_mean_s == pytest.approx(inside.mean(), abs=1e-12)
        assert interval.dt_s == pytest.approx(interval.t_boot_s - begin_s, abs=1e-12)
        begin_s = interval.t_boot_s


@pytest.mark.parametrize("rate_hz", [250.0, 224.0, 125.0, 100.0, 50.0, 28.0])
def test_a_steady_stream_has_no_gap_and_a_gap_is_told_once(rate_hz: float) -> None:
    stamps = [t for t in px4_stamps(rate_hz, 20.0) if not 10.0 < t < 10.3]
    intervals = [interval for interval in sample(stamps) if interval.t_boot_s > 0.2]
    gaps = [interval for interval in intervals if interval.missing_s > 0.0]
    assert [round(gap.t_boot_s, 1) for gap in gaps] == [10.3]
    assert gaps[0].dt_s - 2.5 * max(1.0 / rate_hz, 0.01) < gaps[0].missing_s < gaps[0].dt_s
    assert not gaps[0].gyro_rate_frd.any()
    assert gaps[0].t_mean_s >= 10.3, "no sample from before the gap is in the mean"


@given(st.lists(st.floats(-0.05, 0.5), min_size=2, max_size=200), st.sampled_from([50.0, 100.0, 250.0]))
def test_time_only_runs_forward(steps: list[float], rate_hz: float) -> None:
    """Stamps that stand still or go back are left out, so no step has a length of zero or less."""
    sampler = ImuSampler(rate_hz)
    t_s = end_s = 0.0
    last_s = -math.inf
    for step in steps:
        t_s += step
        if not sampler.accepts(imu(t_s)):
            assert t_s <= last_s
            continue
        last_s = t_s
        interval = sampler.add(imu(t_s))
        if interval is not None:
            assert interval.dt_s > 0.0
            assert 0.0 <= interval.missing_s < interval.dt_s
            assert interval.t_boot_s > end_s or end_s == 0.0
            assert np.isfinite(interval.acc_frd).all()
            assert np.isfinite(interval.gyro_rate_frd).all()
            end_s = interval.t_boot_s


def test_the_derivative_of_the_rates_follows_a_ramp() -> None:
    sampler = ImuSampler(100.0)
    last = None
    for k in range(250):
        last = sampler.add(imu(GRID_S * k, gyro_z=3.0 * GRID_S * k)) or last
    assert last is not None
    assert last.gyro_rate_frd[2] == pytest.approx(3.0, rel=0.02)


def test_after_a_reset_the_first_sample_begins_anew() -> None:
    sampler = ImuSampler(100.0)
    sample(px4_stamps(250.0, 1.0), sampler)
    sampler.reset()
    intervals = sample([0.0, 0.005, 0.010, 0.015], sampler)
    assert [interval.t_boot_s for interval in intervals] == [0.010]
    assert intervals[0].acc_frd[0] == pytest.approx(0.0075)


# ---- attitude


def interval_at(
    t_mean_s: float, gyro: tuple[float, float, float] = (0.0, 0.0, 0.0), dt_s: float = 0.01, missing_s: float = 0.0
) -> ImuInterval:
    gyro_frd = np.array(gyro)
    return ImuInterval(t_mean_s + 0.004, t_mean_s, dt_s, missing_s, np.zeros(3), gyro_frd, np.zeros(3))


def attitude(t_s: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Attitude:
    return Attitude(t_s, t_s, roll, pitch, yaw)


def test_between_two_attitudes_is_interpolated() -> None:
    tracker = AttitudeTracker()
    tracker.add(attitude(1.00, 0.10, -0.2, 0.02))
    tracker.add(attitude(1.01, 0.20, -0.1, 0.04))
    tilt = tracker.at(interval_at(1.0075))
    assert tilt is not None
    assert (tilt.roll_rad, tilt.pitch_rad, tilt.yaw_rad) == pytest.approx((0.175, -0.125, 0.035))


angles = st.floats(-0.6, 0.6)
rates = st.floats(-1.5, 1.5)


@given(st.tuples(angles, angles, st.floats(-3.1, 3.1)), st.tuples(rates, rates, rates))
def test_beyond_the_last_attitude_the_body_rates_carry_it(
    start: tuple[float, float, float], gyro: tuple[float, float, float]
) -> None:
    tracker = AttitudeTracker()
    tracker.add(attitude(2.0, *start))
    tilt = tracker.at(interval_at(2.03, gyro))
    assert tilt is not None
    roll, pitch, yaw = start
    ned_from_frd = Rotation.from_euler("ZYX", (yaw, pitch, roll)) * Rotation.from_rotvec(0.03 * np.array(gyro))
    estimated = Rotation.from_euler("ZYX", (tilt.yaw_rad, tilt.pitch_rad, tilt.roll_rad))
    # First order in time: the error is of second order in the angle turned.
    assert (ned_from_frd.inv() * estimated).magnitude() < 1.5 * (0.03 * np.linalg.norm(gyro)) ** 2 + 1e-9


def test_yaw_is_interpolated_across_south() -> None:
    tracker = AttitudeTracker()
    tracker.add(attitude(1.00, yaw=math.pi - 0.01))
    tracker.add(attitude(1.01, yaw=-math.pi + 0.01))
    tilt = tracker.at(interval_at(1.005))
    assert tilt is not None
    assert abs(wrap_pi(tilt.yaw_rad - math.pi)) < 1e-9
    assert tracker.take_yaw_jump() == 0.0


@pytest.mark.parametrize("age_s", [-0.2, 0.16, 3.0])
def test_an_attitude_that_is_not_of_this_time_is_none(age_s: float) -> None:
    tracker = AttitudeTracker()
    assert tracker.at(interval_at(5.0)) is None
    tracker.add(attitude(5.0 - age_s))
    assert tracker.at(interval_at(5.0)) is None


class Turning:
    """A vehicle that yaws at a steady rate and streams at 100 Hz."""

    def __init__(self, yaw_rate_radps: float) -> None:
        self.tracker = AttitudeTracker()
        self.rate = yaw_rate_radps
        self.offset_rad = 0.0
        self.t_s = 0.0
        self.jumps: list[float] = []
        self.level_yaw_rad = 0.0

    def run(self, steps: int, *, attitudes: bool = True, intervals: bool = True, missing_s: float = 0.0) -> None:
        for _ in range(steps):
            self.t_s += 0.01
            if intervals:
                interval = interval_at(self.t_s - 0.004, (0.0, 0.0, self.rate), 0.01 + missing_s, missing_s)
                missing_s = 0.0
                tilt = self.tracker.at(interval)
                if tilt is not None:
                    self.level_yaw_rad = tilt.level_yaw_rad
            if attitudes:
                self.tracker.add(attitude(self.t_s, yaw=wrap_pi(self.rate * self.t_s + self.offset_rad)))
                jump = self.tracker.take_yaw_jump()
                if jump:
                    self.jumps.append(jump)


@pytest.mark.parametrize("yaw_rate_radps", [0.0, 1.0, -2.0])
def test_a_yaw_reset_without_gyro_is_told_once_and_leaves_the_level_frame(yaw_rate_radps: float) -> None:
    turning = Turning(yaw_rate_radps)
    turning.run(200)
    turning.offset_rad = math.pi / 2.0
    before_rad = turning.level_yaw_rad
    turning.run(50)
    assert turning.jumps == [pytest.approx(math.pi / 2.0, abs=1e-6)]
    assert wrap_pi(turning.level_yaw_rad - before_rad) == pytest.approx(wrap_pi(0.5 * yaw_rate_radps), abs=1e-6)


def test_turning_with_lost_attitudes_is_no_reset() -> None:
    random = np.random.default_rng(3)
    turning = Turning(1.5)
    for _ in range(1000):
        turning.run(1, attitudes=random.random() > 0.3)
    assert turning.jumps == []


def test_turning_through_a_gap_of_the_imu_is_no_reset() -> None:
    turning = Turning(1.0)
    turning.run(100)
    turning.run(30, intervals=False)
    turning.run(100, missing_s=0.3)
    assert turning.jumps == []
    assert turning.level_yaw_rad == pytest.approx(2.3, abs=0.02)


def test_turning_through_a_gap_of_both_is_no_reset() -> None:
    turning = Turning(1.0)
    turning.run(100)
    turning.run(12, intervals=False, attitudes=False)
    turning.run(100, missing_s=0.12)
    assert turning.jumps == []
    turning.offset_rad = 1.0
    turning.run(10)
    assert turning.jumps == [pytest.approx(1.0, abs=1e-6)], "after the gap a reset is seen again"


@given(st.floats(-1e3, 1e3))
def test_wrap(angle_rad: float) -> None:
    wrapped = wrap_pi(angle_rad)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle_rad) == pytest.approx(1.0)


class Rolling:
    """A vehicle that rolls to and fro at up to 1.5 rad/s and streams at 100 Hz."""

    def __init__(self) -> None:
        self.tracker = AttitudeTracker()
        self.t_s = 0.0
        self.offset_rad = 0.0
        self.jumps = 0

    def run(self, steps: int, lost: Callable[[], bool] = lambda: False) -> None:
        for _ in range(steps):
            self.t_s += 0.01
            rate = 1.5 * math.cos(5.0 * (self.t_s - 0.009))
            self.tracker.at(interval_at(self.t_s - 0.004, (rate, 0.0, 0.0), 0.01))
            if not lost():
                self.tracker.add(attitude(self.t_s, 0.3 * math.sin(5.0 * self.t_s) + self.offset_rad))
                self.jumps += self.tracker.take_tilt_jump()


def test_a_reset_of_the_tilt_is_told_once_and_a_manoeuvre_is_none() -> None:
    rolling = Rolling()
    random = np.random.default_rng(4)
    rolling.run(500, lost=lambda: bool(random.random() < 0.3))
    assert rolling.jumps == 0
    rolling.offset_rad = 0.1
    rolling.run(100)
    assert rolling.jumps == 1
