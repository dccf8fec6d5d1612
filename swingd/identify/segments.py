"""From the streams of a flight to the stretches over which a pendulum is fitted."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.level import level_from_frd
from swingd.model.estimate import FloatArray
from swingd.model.events import Attitude, Imu, LocalPosition
from swingd.model.parameters import Vehicle

RATE_HZ = 25.0
"""Of the samples that are fitted: each is the mean over its interval, whatever the stream's rate."""
GAP_S = 0.15
"""Longest time without a sample of any stream that is bridged."""
GAP_SAMPLES = 5.0
"""The same, in usual intervals of the stream."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of flight with its measurements, evenly sampled."""

    t_boot_s: FloatArray
    """(n,) middle of each sample."""
    felt_level_mps2: FloatArray
    """(n, 3) specific force of the hook in a level frame that does not turn."""
    side_force_frd_n: FloatArray
    """(n, 2) force on the vehicle across the thrust's axis, body x and y: the cable's pull, drag, wind."""
    side_from_level: FloatArray
    """(n, 2, 3) rotation of level components to body x and y."""
    side_vel_frd_mps: FloatArray
    """(n, 2) velocity over ground along body x and y; zero where the log has none."""

    @property
    def dt_s(self) -> float:
        """Between samples."""
        return 1.0 / RATE_HZ


@dataclass(frozen=True, slots=True)
class _Stream:
    """Samples at increasing times."""

    t_s: FloatArray
    values: FloatArray

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return (n, m) values, linear between the samples."""
        return np.column_stack([np.interp(t_s, self.t_s, column) for column in self.values.T])

    def means(self, edges_s: FloatArray) -> FloatArray:
        """Return (n - 1, m) exact means of the linear course between the edges."""
        steps = 0.5 * (self.values[1:] + self.values[:-1]) * np.diff(self.t_s)[:, None]
        integral = np.vstack([np.zeros(self.values.shape[1]), np.cumsum(steps, axis=0)])
        # Linear between the samples: exact at them, and the rest is far above any swing.
        means: FloatArray = np.diff(_Stream(self.t_s, integral).at(edges_s), axis=0) / np.diff(edges_s)[:, None]
        return means

    def gaps(self) -> list[tuple[float, float]]:
        """Return where samples are missing."""
        spacing = np.diff(self.t_s)
        longest = max(GAP_S, GAP_SAMPLES * float(np.median(spacing))) if len(spacing) else 0.0
        return [(float(self.t_s[i]), float(self.t_s[i + 1])) for i in np.flatnonzero(spacing > longest)]


class FlightRecord:
    """The streams of one flight, ready to be cut into segments of any length.

    Parameters
    ----------
    imu, attitudes : sequence of Imu, Attitude
        In the order of their arrival.
    positions : sequence of LocalPosition
        May be empty: then the drag of the vehicle is not told from the load's pull.
    vehicle : Vehicle
        Mass, and where hook and IMU are.

    Notes
    -----
    Where the autopilot's clock went back, the longest piece counts.
    """

    def __init__(
        self,
        imu: Sequence[Imu],
        attitudes: Sequence[Attitude],
        positions: Sequence[LocalPosition],
        vehicle: Vehicle,
    ) -> None:
        acc = _stream((sample.t_boot_s, sample.acc_frd_mps2) for sample in imu)
        gyro = _stream((sample.t_boot_s, sample.gyro_frd_radps) for sample in imu)
        self._attitude = _stream((a.t_boot_s, (a.roll_rad, a.pitch_rad, a.yaw_rad)) for a in attitudes)
        if len(self._attitude.t_s):
            self._attitude.values[:, ::2] = np.unwrap(self._attitude.values[:, ::2], axis=0)
        self._velocity = _stream((position.t_boot_s, position.vel_ned_mps) for position in positions)
        self._mass_kg = vehicle.mass_kg
        self.has_velocity = len(self._velocity.t_s) > 1
        """Whether the log tells the velocity."""
        centre, hook = acc.values, acc.values
        offsets = np.array([vehicle.imu_frd_m, vehicle.hook_frd_m])
        if offsets.any() and len(acc.t_s) > 1:
            gyro_rate = np.gradient(gyro.values, gyro.t_s, axis=0)
            at_imu, at_hook = (_point_acceleration(gyro.values, gyro_rate, offset) for offset in offsets)
            centre = acc.values - at_imu
            hook = centre + at_hook
        self._centre_frd = _Stream(acc.t_s, centre)
        self._hook_level = _Stream(acc.t_s, hook)
        if len(acc.t_s) and len(self._attitude.t_s):
            turned = np.einsum("nij,nj->ni", self._level_from_frd(acc.t_s), hook)
            self._hook_level = _Stream(acc.t_s, turned)

    def cut(self, hanging: Iterable[tuple[float, float]], length_m: float, periods: float) -> list[Segment]:
        """Cut the time in which the load hangs into segments.

        Parameters
        ----------
        hanging : pairs of float
            Begin and end of each stretch in which it does [s, boot time].
        length_m : float
            Cable, whose period is the measure.
        periods : float
            Shortest segment in periods of the pendulum; a shorter stretch is left out.
        """
        period_s = 2.0 * math.pi * math.sqrt(length_m / GRAVITY_MPS2)
        segments = []
        for begin_s, end_s in self._whole(hanging):
            count = int((end_s - begin_s) / (periods * period_s))
            edges_s = np.linspace(begin_s, end_s, count + 1) if count else np.empty(0)
            segments += [self._segment(a, b) for a, b in itertools.pairwise(edges_s.tolist())]
        return segments

    def _whole(self, stretches: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
        """Return the parts of the stretches in which no stream has a gap."""
        streams = [self._centre_frd, self._attitude] + ([self._velocity] if self.has_velocity else [])
        if any(len(stream.t_s) < 2 for stream in streams):
            return []
        first_s, last_s = max(stream.t_s[0] for stream in streams), min(stream.t_s[-1] for stream in streams)
        parts = [(max(begin_s, first_s), min(end_s, last_s)) for begin_s, end_s in stretches]
        for lost_s, back_s in (gap for stream in streams for gap in stream.gaps()):
            parts = [
                piece
                for begin_s, end_s in parts
                for piece in ((begin_s, min(end_s, lost_s)), (max(begin_s, back_s), end_s))
            ]
        return [(begin_s, end_s) for begin_s, end_s in parts if end_s > begin_s]

    def _segment(self, begin_s: float, end_s: float) -> Segment:
        edges_s = begin_s + np.arange(int((end_s - begin_s) * RATE_HZ) + 1) / RATE_HZ
        t_s = 0.5 * (edges_s[1:] + edges_s[:-1])
        side_from_level = np.ascontiguousarray(self._level_from_frd(t_s)[:, :, :2].transpose(0, 2, 1))
        velocity = self._velocity.at(t_s) if self.has_velocity else np.zeros((len(t_s), 3))
        return Segment(
            t_boot_s=t_s,
            felt_level_mps2=self._hook_level.means(edges_s),
            side_force_frd_n=self._mass_kg * self._centre_frd.means(edges_s)[:, :2],
            side_from_level=side_from_level,
            side_vel_frd_mps=np.einsum("nij,nj->ni", side_from_level, velocity),
        )

    def _level_from_frd(self, t_s: FloatArray) -> FloatArray:
        """Return (n, 3, 3) rotations."""
        rotations = np.empty((len(t_s), 3, 3))
        for rotation, (roll, pitch, yaw) in zip(rotations, self._attitude.at(t_s), strict=True):
            level_from_frd(rotation, roll, pitch, yaw)
        return rotations


def _stream(samples: Iterable[tuple[float, Sequence[float]]]) -> _Stream:
    """Take the finite samples of the autopilot's longest life, each newer than the one before."""
    rows = np.array([(t_s, *values) for t_s, values in samples], dtype=float).reshape(-1, 4)
    rows = rows[np.isfinite(rows).all(axis=1)]
    lives = np.split(rows, np.flatnonzero(np.diff(rows[:, 0]) < -1.0) + 1)
    rows = max(lives, key=len)
    newest = np.maximum.accumulate(rows[:, 0])
    rows = rows[np.diff(newest, prepend=-np.inf) > 0.0]
    return _Stream(rows[:, 0], rows[:, 1:])


def _point_acceleration(gyro: FloatArray, gyro_rate: FloatArray, point: FloatArray) -> FloatArray:
    """Acceleration of a body-fixed point relative to the centre of gravity, body axes."""
    return np.asarray(np.cross(gyro_rate, point) + np.cross(gyro, np.cross(gyro, point)))
