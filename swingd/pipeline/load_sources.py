"""What an estimator of the load is corrected by: the autopilot's position and velocity, and a camera's sightings."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from swingd.core.gp_ekf import Source
from swingd.core.level import level_from_frd
from swingd.core.status import Status
from swingd.estimation.base import LoadEstimator, LoadMeasurement
from swingd.model.estimate import FloatArray
from swingd.model.events import Attitude, LoadSighting, LocalPosition, SightingFrame, Vec3
from swingd.model.parameters import Parameters
from swingd.pipeline.sampling import wrap_pi

POSITION_EVERY_S = 0.03
"""Positions that come more often are left out: the autopilot's errors last for seconds, more would say little more."""
POSITION_SPAN_MAX_S = 0.2
REMEMBERED_S = 1.0
RATE_WINDOW_S = 2.0
APART_MAX_S = 0.15
"""Between two attitudes or positions that one is interpolated from, and from the newest on."""
REMEMBERED = 512
"""Of each, whatever the streams' rates."""


class _Stamped(Protocol):
    @property
    def t_boot_s(self) -> float: ...


_T = TypeVar("_T", bound=_Stamped)


@dataclass(frozen=True, slots=True)
class CameraState:
    """What is known of the camera that sees the load."""

    got_hz: float
    """Sightings a second, the unused ones included."""
    age_s: float | None
    """Since the last one; None before the first."""
    unused: int
    """Sightings that were not used: of a time without an attitude, too late, or gated."""


class LoadSources:
    """Turns what arrives into measurements of the hook and the load in ned, each with its own time.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, camera and the noises of gp_ekf.
    estimator : LoadEstimator
        Is corrected.
    before : LoadSources, optional
        What it has seen so far is known here too.
    """

    def __init__(self, parameters: Parameters, estimator: LoadEstimator, before: "LoadSources | None" = None) -> None:
        self._estimator = estimator
        self._camera = parameters.camera
        self._pos_noise, self._vel_noise = parameters.gp_ekf.pos_noise, parameters.gp_ekf.vel_noise
        self._hook_frd = np.array(parameters.vehicle.hook_frd_m)
        self._hook_ned: Vec3 = (0.0, 0.0, 0.0)
        self._hook_vel_ned: Vec3 = (0.0, 0.0, 0.0)
        self._sighted_s: deque[float] = deque(maxlen=REMEMBERED)
        self._unused = 0
        self._attitudes: deque[Attitude] = deque(maxlen=REMEMBERED)
        self._positions: deque[LocalPosition] = deque(maxlen=REMEMBERED)
        self._taken_s = -math.inf
        if before is not None:
            self._sighted_s, self._unused = before._sighted_s, before._unused
            self._attitudes, self._positions = before._attitudes, before._positions

    def reset(self) -> None:
        """The autopilot's clock began anew."""
        self._attitudes.clear()
        self._positions.clear()
        self._taken_s = -math.inf

    def turn(self, yaw_jump_rad: float) -> None:
        """The autopilot's yaw was reset: attitudes before it turn to another north."""
        if yaw_jump_rad != 0.0:
            self._estimator.turn(yaw_jump_rad)
            newest = self._attitudes.pop() if self._attitudes else None
            self._attitudes.clear()
            if newest is not None:
                self._attitudes.append(newest)

    def stand(self, t_boot_s: float, to_ned_rad: float, hook_ned_m: Vec3, hook_vel_ned_mps: Vec3) -> None:
        """Take how an interval ends: see `LoadEstimator.stand`, and where the hook is from the centre of gravity."""
        self._estimator.stand(t_boot_s, to_ned_rad)
        self._hook_ned, self._hook_vel_ned = hook_ned_m, hook_vel_ned_mps

    def add_attitude(self, attitude: Attitude) -> None:
        """Take an attitude, for the pictures of about its time."""
        _remember(self._attitudes, attitude)

    def add_position(self, position: LocalPosition) -> None:
        """Correct by the autopilot's position and velocity."""
        _remember(self._positions, position)
        since_s = position.t_boot_s - self._taken_s
        if since_s < POSITION_EVERY_S:
            return
        self._taken_s = position.t_boot_s
        span_s = min(since_s, POSITION_SPAN_MAX_S)
        for source, value, offset, density in (
            (Source.VEHICLE_POS, position.pos_ned_m, self._hook_ned, self._pos_noise),
            (Source.VEHICLE_VEL, position.vel_ned_mps, self._hook_vel_ned, self._vel_noise),
        ):
            std = density / math.sqrt(span_s)
            self._estimator.correct(LoadMeasurement(source, _sum(value, offset), (std, std, std), position.t_boot_s))

    def add_sighting(self, sighting: LoadSighting) -> None:
        """Correct by a camera's sighting, at the time of its picture."""
        self._sighted_s.append(sighting.t_mono_s)
        t_s = sighting.t_boot_s - self._camera.delay_s
        load = self._from_hook(sighting, t_s)
        if load is None:
            self._unused += 1
            return
        std = self._camera.noise_m + self._camera.noise_share * float(np.linalg.norm(load))
        north, east, down = (-load).tolist()
        measurement = LoadMeasurement(Source.REL_POS, (north, east, down), (std, std, std), t_s)
        if self._estimator.correct(measurement) is not Status.OK:
            self._unused += 1

    def camera(self, t_mono_s: float) -> CameraState | None:
        """Return what is known of the camera at a time of the host's clock [s]; None where there is to be none."""
        if self._camera.source == "none":
            return None
        lately = sum(t_mono_s - sighted_s < RATE_WINDOW_S for sighted_s in self._sighted_s)
        age_s = t_mono_s - self._sighted_s[-1] if self._sighted_s else None
        return CameraState(lately / RATE_WINDOW_S, age_s, self._unused)

    def _from_hook(self, sighting: LoadSighting, t_s: float) -> FloatArray | None:
        """Where the load was from the hook, ned [m]; None where the vehicle's attitude or place then is not known."""
        attitude = _near(self._attitudes, t_s)
        if attitude is None:
            return None
        (before, after), share = attitude
        yaw_rad = before.yaw_rad + share * wrap_pi(after.yaw_rad - before.yaw_rad)
        roll_rad = before.roll_rad + share * wrap_pi(after.roll_rad - before.roll_rad)
        pitch_rad = before.pitch_rad + share * (after.pitch_rad - before.pitch_rad)
        ned_from_frd = np.empty((3, 3))
        level_from_frd(ned_from_frd, roll_rad, pitch_rad, yaw_rad)
        if sighting.frame is SightingFrame.BODY_FRD:
            from_hook = np.add(self._camera.position_frd_m, sighting.position_m) - self._hook_frd
            seen: FloatArray = ned_from_frd @ from_hook
            return seen
        place = _near(self._positions, t_s)
        if place is None:
            return None
        (first, second), share = place
        vehicle = np.array(first.pos_ned_m) + share * np.subtract(second.pos_ned_m, first.pos_ned_m)
        absolute: FloatArray = np.array(sighting.position_m) - vehicle - ned_from_frd @ self._hook_frd
        return absolute


def _remember(kept: deque[_T], newest: _T) -> None:
    kept.append(newest)
    while newest.t_boot_s - kept[0].t_boot_s > REMEMBERED_S:
        kept.popleft()


def _near(kept: deque[_T], t_s: float) -> tuple[tuple[_T, _T], float] | None:
    """Give what was before and after a time, and how far between it lies; at most `APART_MAX_S` apart."""
    after: _T | None = None
    for one in reversed(kept):
        if one.t_boot_s <= t_s:
            last = after if after is not None else one
            span_s = last.t_boot_s - one.t_boot_s
            if max(span_s, t_s - one.t_boot_s) > APART_MAX_S:
                return None
            return (one, last), (t_s - one.t_boot_s) / span_s if span_s > 0.0 else 0.0
        after = one
    return None


def _sum(one: Vec3, other: Vec3) -> Vec3:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]
