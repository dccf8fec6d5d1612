"""From the autopilot's streams to the filter's grid: IMU averages, and the attitude and heading that belong to them."""

import math
from dataclasses import dataclass

import numpy as np

from swingd.model.estimate import FloatArray
from swingd.model.events import Attitude, Imu

GYRO_RATE_TIME_CONSTANT_S = 0.01
"""Low-pass on the derivative of the body rates."""
GAP_SHARE = 3.0
"""An interval longer than this times the usual one has lost samples."""
_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ATTITUDE_AGE_MAX_S = 0.15
"""How far an attitude is carried ahead by the body rates."""
TILT_JUMP_RAD = math.radians(4.0)
"""The same of roll or pitch: with it the thrust, and the cable's force that is felt, turn at once."""
YAW_JUMP_RAD = math.radians(3.0)
"""A change of yaw between two attitudes that the gyro does not explain is a reset of the autopilot's estimate."""


def wrap_pi(angle_rad: float) -> float:
    """Return the angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


@dataclass(frozen=True, slots=True)
class ImuInterval:
    """Mean of the inertial samples of one filter step."""

    t_boot_s: float
    """End of the interval: the last sample's stamp."""
    t_mean_s: float
    """Mean of the samples' stamps."""
    dt_s: float
    """Since the end of the interval before."""
    missing_s: float
    """Part of it from which samples are missing; 0 in a steady stream."""
    acc_frd: FloatArray
    """(3,) mean specific force [m/s^2]."""
    gyro_frd: FloatArray
    """(3,) mean body rates [rad/s]."""
    gyro_rate_frd: FloatArray
    """(3,) derivative of the body rates, low-passed [rad/s^2]."""


class ImuSampler:
    """Averages the IMU stream down to the filter's rate; a slower stream passes sample by sample.

    Parameters
    ----------
    rate_hz : float
        Filter steps per second.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._sum = _NOTHING
        self._stamp_sum_s = 0.0
        self._count = 0
        self._sample_s = 0.25 * self._period_s
        self._typical_s = self._period_s
        self._last_stamp_s = math.nan
        self._end_s = math.nan
        self._due_s = math.nan
        self._gyro = np.zeros(3)
        self._gyro_rate = np.zeros(3)

    def reset(self) -> None:
        """Forget every sample; the next one begins the first interval."""
        self._clear()
        self._last_stamp_s = self._end_s = self._due_s = math.nan
        self._gyro_rate[:] = 0.0

    def accepts(self, imu: Imu) -> bool:
        """Whether a sample is finite and newer than the last one."""
        if not math.isfinite(imu.t_boot_s + sum(imu.acc_frd_mps2) + sum(imu.gyro_frd_radps)):
            return False
        return not imu.t_boot_s <= self._last_stamp_s

    def add(self, imu: Imu) -> ImuInterval | None:
        """Take one sample that `accepts` agrees to; return the interval that it completes."""
        stamp_s = imu.t_boot_s
        if math.isnan(self._end_s):
            self._end_s = self._last_stamp_s = stamp_s
            self._due_s = stamp_s + self._period_s
            self._gyro[:] = imu.gyro_frd_radps
            return None
        spacing_s = stamp_s - self._last_stamp_s
        self._last_stamp_s = stamp_s
        self._sample_s += 0.05 * (min(spacing_s, self._period_s) - self._sample_s)
        if spacing_s > GAP_SHARE * self._typical_s:
            # A mean over both sides of a gap belongs to no time.
            self._clear()
        # Plain numbers: this runs at the IMU's rate, where small arrays would cost more than all the rest.
        a, b, c = imu.acc_frd_mps2
        p, q, r = imu.gyro_frd_radps
        sum_a, sum_b, sum_c, sum_p, sum_q, sum_r = self._sum
        self._sum = (sum_a + a, sum_b + b, sum_c + c, sum_p + p, sum_q + q, sum_r + r)
        self._stamp_sum_s += stamp_s
        self._count += 1
        # Half a sample early is nearer to the grid than half a sample late.
        if stamp_s < self._due_s - 0.5 * self._sample_s:
            return None
        dt_s = stamp_s - self._end_s
        mean = np.array(self._sum) / self._count
        gyro = np.array(imu.gyro_frd_radps)
        mean_s = self._stamp_sum_s / self._count
        missing_s = dt_s - self._typical_s if dt_s > GAP_SHARE * self._typical_s else 0.0
        self._typical_s += 0.05 * (min(dt_s, 2.0 * self._typical_s) - self._typical_s)
        if missing_s == 0.0:
            blend = dt_s / (dt_s + GYRO_RATE_TIME_CONSTANT_S)
            # From end to end: the mean derivative of the very interval whose mean acceleration it goes with.
            slope = (gyro - self._gyro) / dt_s
            self._gyro_rate = self._gyro_rate + blend * (slope - self._gyro_rate)
        else:
            self._gyro_rate = np.zeros(3)
        interval = ImuInterval(stamp_s, mean_s, dt_s, missing_s, mean[:3], mean[3:], self._gyro_rate)
        self._gyro = gyro
        self._end_s = stamp_s
        self._due_s += self._period_s
        if abs(self._due_s - stamp_s - self._period_s) > self._period_s:
            self._due_s = stamp_s + self._period_s
        self._clear()
        return interval

    def _clear(self) -> None:
        self._sum = _NOTHING
        self._stamp_sum_s = 0.0
        self._count = 0


@dataclass(frozen=True, slots=True)
class Tilt:
    """Attitude at one instant."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    """In the autopilot's NED."""
    level_yaw_rad: float
    """In the filter's frame that does not turn."""
    level_yaw_rate_radps: float


class AttitudeTracker:
    """The attitude at any instant near the last one received, and the heading in a frame that does not turn.

    The heading is the integral of the yaw rate that the gyro shows: when the autopilot's yaw estimate is reset, the
    vehicle has not moved, and nothing of the filter's state needs to turn.
    """

    def __init__(self) -> None:
        self._last: Attitude | None = None
        self._before: Attitude | None = None
        self._level_yaw_rad = 0.0
        self._gyro_yaw_rad = 0.0
        self._gyro_yaw_at_last_rad = 0.0
        self._gyro_is_whole = True
        self._yaw_jump_rad = 0.0
        self._gyro_tilt_rad: tuple[float, float] | None = None
        self._tilt_before_rad = (0.0, 0.0)
        self._tilt_jumped = False

    def reset(self) -> None:
        """Forget every attitude; the filter's frame stays."""
        self._last = self._before = None

    def add(self, attitude: Attitude) -> None:
        """Take one attitude."""
        if (
            self._last is not None
            and self._gyro_is_whole
            and attitude.t_boot_s - self._last.t_boot_s < ATTITUDE_AGE_MAX_S
        ):
            turned = self._gyro_yaw_rad - self._gyro_yaw_at_last_rad
            jump = wrap_pi(attitude.yaw_rad - self._last.yaw_rad - turned)
            tilt_jumped = self._tilt_jumps(attitude)
            if abs(jump) > YAW_JUMP_RAD:
                self._yaw_jump_rad += jump
            self._tilt_jumped |= tilt_jumped
            if abs(jump) > YAW_JUMP_RAD or tilt_jumped:
                # Interpolating across a reset would give an attitude that never was.
                self._last = None
        if self._gyro_tilt_rad is not None or self._last is None or not self._gyro_is_whole:
            # Else no interval has shown yet what was turned since.
            self._tilt_before_rad, self._gyro_tilt_rad = (attitude.roll_rad, attitude.pitch_rad), None
        self._gyro_yaw_at_last_rad = self._gyro_yaw_rad
        self._gyro_is_whole = True
        self._before, self._last = self._last, attitude

    def _tilt_jumps(self, attitude: Attitude) -> bool:
        """Whether roll or pitch has changed, and by what the gyro does not explain."""
        if self._gyro_tilt_rad is None:
            return False
        (rolled, pitched), (roll, pitch) = self._gyro_tilt_rad, self._tilt_before_rad
        changes = ((wrap_pi(attitude.roll_rad - roll), rolled), (attitude.pitch_rad - pitch, pitched))
        # A gyro that tells of a turn which the attitude did not make is no reset.
        return any(min(abs(change), abs(change - turned)) > TILT_JUMP_RAD for change, turned in changes)

    def take_yaw_jump(self) -> float:
        """Return by how much the autopilot's yaw was reset since the last call [rad]."""
        jump, self._yaw_jump_rad = self._yaw_jump_rad, 0.0
        return jump

    def take_tilt_jump(self) -> bool:
        """Return whether the autopilot's roll or pitch was reset since the last call."""
        jumped, self._tilt_jumped = self._tilt_jumped, False
        return jumped

    def at(self, interval: ImuInterval) -> Tilt | None:
        """Return the attitude at the middle of an IMU interval; None where none is fresh enough."""
        last = self._last
        if last is None:
            return None
        ahead_s = interval.t_mean_s - last.t_boot_s
        p, q, r = interval.gyro_frd.tolist()
        s_roll, c_roll = math.sin(last.roll_rad), math.cos(last.roll_rad)
        c_pitch = max(math.cos(last.pitch_rad), 0.05)
        turn = q * s_roll + r * c_roll
        yaw_rate = turn / c_pitch
        self._level_yaw_rad = wrap_pi(self._level_yaw_rad + yaw_rate * interval.dt_s)
        self._gyro_yaw_rad += yaw_rate * interval.dt_s
        roll_rate = p + turn * math.tan(last.pitch_rad)
        pitch_rate = q * c_roll - r * s_roll
        rolled, pitched = self._gyro_tilt_rad or (0.0, 0.0)
        self._gyro_tilt_rad = (rolled + roll_rate * interval.dt_s, pitched + pitch_rate * interval.dt_s)
        if interval.missing_s > 0.0:
            # What was turned in a gap is a guess; held against the attitude it would look like a reset of the yaw.
            self._gyro_is_whole = False
        if abs(ahead_s) > ATTITUDE_AGE_MAX_S:
            return None
        before = self._before
        if ahead_s < 0.0 and before is not None and before.t_boot_s < last.t_boot_s:
            share = max(ahead_s / (last.t_boot_s - before.t_boot_s), -1.0)
            roll = last.roll_rad + share * wrap_pi(last.roll_rad - before.roll_rad)
            pitch = last.pitch_rad + share * (last.pitch_rad - before.pitch_rad)
            yaw = last.yaw_rad + share * wrap_pi(last.yaw_rad - before.yaw_rad)
        else:
            roll = last.roll_rad + ahead_s * roll_rate
            pitch = last.pitch_rad + ahead_s * pitch_rate
            yaw = last.yaw_rad + ahead_s * yaw_rate
        # The integral stands at the interval's end, the attitude at its middle.
        level_yaw = self._level_yaw_rad - yaw_rate * (interval.t_boot_s - interval.t_mean_s)
        return Tilt(roll, pitch, wrap_pi(yaw), level_yaw, yaw_rate)
