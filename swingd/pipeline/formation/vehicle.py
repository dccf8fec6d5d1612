"""One vehicle of several: its samples on one clock, and where its hook and cable are at an instant."""

import math
from collections import Counter
from dataclasses import dataclass
from enum import Enum

import numpy as np

from swingd.model.actions import Health
from swingd.model.estimate import FloatArray
from swingd.model.events import Attitude, AutopilotRestart, LocalPosition
from swingd.model.formation import (
    CableForce,
    CableSwing,
    ClockAnswer,
    DirectionSource,
    LocalOrigin,
    RiggedVehicle,
    VehicleEvent,
    WinchTurned,
)
from swingd.pipeline.formation.clock import ClockOffset
from swingd.pipeline.formation.geometry import cable_of, rotation_of
from swingd.pipeline.formation.stream import Reading, SampleStream

LATE_S = 1.0
"""A sample delivered so much later than the quickest is not used."""
AHEAD_S = 0.25
"""A stamp of the future: the clock is another one."""
VALUE_MAX = 1e6
SWING_MAX_RAD = 1.4
FORCE_MIN_N = 0.1
FORCE_DOWN_MIN = 0.2
"""Share of a cable's pull that is down: a cable that only pulls sideways holds nothing, and the ground pushes up."""
FORCE_STD_SHARE_MAX = 0.5
"""Of the force: beyond it the direction is not known."""
STD_MAX_RAD = 0.5
"""Of a swing angle; beyond it the estimator knows nothing."""
ACC_UNKNOWN_MPS2 = 3.0
SWING_ACC_UNKNOWN_RADPS2 = 5.0
ATTITUDE_RATE_UNKNOWN_RADPS = 0.5
"""What may happen unseen while a sample is carried on."""
SWING_RATE_PER_ANGLE = 2.5
"""Deviation of a rate over that of its angle, 1/s: what the estimators show on recorded flights."""


class Refusal(Enum):
    """Why something that a vehicle told was not used."""

    NOT_FINITE = "not_finite"
    IMPOSSIBLE = "impossible"
    OUT_OF_ORDER = "out_of_order"
    LATE = "late"
    AHEAD = "ahead"
    SWING_NOT_GOOD = "swing_not_good"
    """Its swingd is in fault or not ready, says that it knows nothing, or the force is none of a taut cable."""
    NO_CLOCK = "no_clock"
    """The autopilot has told no stamp yet."""
    OTHER_CLOCK = "other_clock"
    """An answer to TIMESYNC that is not of the boot clock, or came too late."""


@dataclass(frozen=True, slots=True)
class VehicleInstant:
    """One vehicle at one instant, its own local frame."""

    hook_ned_m: FloatArray
    hook_vel_ned_mps: FloatArray
    pos_var_m2: float
    """Of the hook's place, each axis."""
    vel_var_m2ps2: float
    direction_ned: FloatArray
    """(3,) from the hook along the cable force."""
    direction_rate_ned: FloatArray
    direction_cov: FloatArray
    """(3, 3)"""
    rate_var_radps2: float
    yaw_rad: float
    winch: float
    winch_rate: float
    """Per second."""


class VehicleTrack:
    """What one vehicle has told.

    Parameters
    ----------
    rig : RiggedVehicle
    """

    def __init__(self, rig: RiggedVehicle) -> None:
        self.rig = rig
        self.refusals: Counter[Refusal] = Counter()
        self.restarts = 0
        self.origin: LocalOrigin | None = None
        self.swing_health = Health.INIT
        self._refused = ""
        """Why the last estimate of the cable was not good; empty where it was, or none was heard."""
        by_force = rig.direction is DirectionSource.FORCE
        self._cable_name = "force in SWING" if by_force else "SWING"
        streams = ("LOCAL_POSITION_NED", "ATTITUDE", self._cable_name)
        self._streams = {name: SampleStream() for name in streams}
        if rig.winch:
            self._streams[f"winch {rig.winch}"] = SampleStream()
        self._position, self._attitude, self._cable, *winch = self._streams.values()
        self._winch = winch[0] if winch else None
        self._cable_var = np.zeros(2)
        self._angles: FloatArray | None = None
        self._clock = ClockOffset()

    def take(self, event: VehicleEvent) -> None:
        """Take what the vehicle tells; never raises, what cannot be used is counted."""
        match event:
            case LocalPosition(pos_ned_m=pos, vel_ned_mps=vel):
                if self._is_usable(event.t_mono_s, event.t_boot_s, (*pos, *vel), VALUE_MAX, tells_clock=True):
                    self._add(self._position, event.t_boot_s, np.array(pos), np.array(vel))
            case Attitude():
                angles = (event.roll_rad, event.pitch_rad, event.yaw_rad)
                if self._is_usable(event.t_mono_s, event.t_boot_s, angles, 7.0, tells_clock=True):
                    self._add_attitude(event.t_boot_s, np.array(angles))
            case CableSwing() if self.rig.direction is DirectionSource.SWING:
                self._take_swing(event)
            case CableForce() if self.rig.direction is DirectionSource.FORCE:
                self._take_force(event)
            case WinchTurned(winch=value):
                if self._winch is not None and self._is_usable(event.t_mono_s, event.t_boot_s, (value,), VALUE_MAX):
                    self._add(self._winch, event.t_boot_s, np.array([value]))
            case LocalOrigin():
                self._take_origin(event)
            case ClockAnswer(t_mono_s=t_mono_s, sent_s=sent_s, t_boot_s=t_boot_s):
                numbers = (t_mono_s, sent_s, t_boot_s)
                if not (all(map(math.isfinite, numbers)) and self._clock.answered(*numbers)):
                    self.refusals[Refusal.OTHER_CLOCK] += 1
            case AutopilotRestart():
                self._restart()

    def clock(self, t_mono_s: float) -> tuple[float, float] | None:
        """Return host's time minus boot time and its deviation [s]."""
        return self._clock.offset(t_mono_s)

    def missing(self) -> tuple[str, ...]:
        """Name what has not been heard."""
        missing = [self._told(name) for name, stream in self._streams.items() if stream.newest_s is None]
        if self.rig.origin_ned_m is None and self.origin is None:
            missing.append("GPS_GLOBAL_ORIGIN")
        return tuple(missing)

    def oldest(self) -> str:
        """Name the stream that was silent for longest."""
        heard = {name: stream.newest_s for name, stream in self._streams.items() if stream.newest_s is not None}
        return self._told(min(heard, key=lambda name: heard[name])) if heard else ""

    def _told(self, name: str) -> str:
        """Name a stream; an estimate that comes and is not good is not silent."""
        if name != self._cable_name or not self._refused:
            return name
        return f"good {name} ({self._refused})"

    def newest_s(self, t_mono_s: float) -> float | None:
        """Return the host's time of the oldest of its newest samples; None while one is missing."""
        clock = self.clock(t_mono_s)
        newest = [stream.newest_s for stream in self._streams.values() if stream.newest_s is not None]
        if clock is None or self.missing():
            return None
        return min(newest) + clock[0]

    def at(self, t_s: float, t_mono_s: float) -> VehicleInstant | None:
        """Return where it is at the host's time ``t_s``, looked at ``t_mono_s``; None before its samples begin."""
        clock = self.clock(t_mono_s)
        if clock is None:
            return None
        t_boot_s, clock_std_s = t_s - clock[0], clock[1]
        position, attitude, cable = (s.at(t_boot_s) for s in (self._position, self._attitude, self._cable))
        winch = None if self._winch is None else self._winch.at(t_boot_s)
        if position is None or attitude is None or cable is None or (self._winch is not None and winch is None):
            return None
        hook = np.array(self.rig.hook_frd_m)
        half_s = 0.01
        rotation = rotation_of(attitude.value)
        turning = rotation_of(attitude.value + half_s * attitude.rate) - rotation_of(
            attitude.value - half_s * attitude.rate
        )
        speed_mps = float(np.linalg.norm(position.rate))
        pos_var = (
            self.rig.pos_std_m**2
            + (speed_mps * clock_std_s) ** 2
            + (0.5 * ACC_UNKNOWN_MPS2 * position.carried_s**2) ** 2
            + float(hook @ hook) * (ATTITUDE_RATE_UNKNOWN_RADPS * attitude.carried_s) ** 2
        )
        direction, rate, cov = self._direction(attitude, cable)
        further_var = (
            self.rig.direction_std_rad**2
            + (float(np.linalg.norm(rate)) * clock_std_s) ** 2
            + (0.5 * SWING_ACC_UNKNOWN_RADPS2 * cable.carried_s**2) ** 2
        )
        rate_var = SWING_RATE_PER_ANGLE**2 * (further_var + float(np.diag(cov).max()))
        if self.rig.direction is DirectionSource.SWING:
            further_var += (ATTITUDE_RATE_UNKNOWN_RADPS * attitude.carried_s) ** 2 * (1.0 - float(direction[2]) ** 2)
        cov += further_var * (np.eye(3) - np.outer(direction, direction))
        return VehicleInstant(
            hook_ned_m=position.value + rotation @ hook,
            hook_vel_ned_mps=position.rate + turning @ hook / (2.0 * half_s),
            pos_var_m2=pos_var,
            vel_var_m2ps2=self.rig.vel_std_mps**2 + (ACC_UNKNOWN_MPS2 * position.carried_s) ** 2,
            direction_ned=direction,
            direction_rate_ned=rate,
            direction_cov=cov,
            rate_var_radps2=rate_var + (SWING_ACC_UNKNOWN_RADPS2 * cable.carried_s) ** 2,
            yaw_rad=float(attitude.value[2]),
            winch=0.0 if winch is None else float(winch.value[0]),
            winch_rate=0.0 if winch is None else float(winch.rate[0]),
        )

    def _direction(self, attitude: Reading, cable: Reading) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the cable's direction, its rate and the covariance that its estimator claims, ned."""
        if self.rig.direction is DirectionSource.FORCE:
            size_n = float(np.linalg.norm(cable.value))
            direction = cable.value / size_n
            project = np.eye(3) - np.outer(direction, direction)
            cov = project @ np.diag(self._cable_var) @ project / size_n**2
            return direction, project @ cable.rate / size_n, cov
        yaw_rad, yaw_rate = float(attitude.value[2]), float(attitude.rate[2])
        heading = rotation_of(np.array([0.0, 0.0, yaw_rad]))
        along, across = cable_of(cable.value)
        direction = heading @ along
        rate = heading @ (across @ cable.rate) + yaw_rate * np.array([-direction[1], direction[0], 0.0])
        spread = heading @ across
        return direction, rate, spread @ np.diag(self._cable_var) @ spread.T

    # ---- samples

    def _is_usable(
        self, t_mono_s: float, t_boot_s: float, values: tuple[float, ...], limit: float, *, tells_clock: bool = False
    ) -> bool:
        """Judge a sample; only the autopilot's own stamps tell its clock."""
        if not all(map(math.isfinite, (t_mono_s, t_boot_s, *values))):
            self.refusals[Refusal.NOT_FINITE] += 1
            return False
        if any(abs(value) > limit for value in values):
            self.refusals[Refusal.IMPOSSIBLE] += 1
            return False
        clock = self.clock(t_mono_s)
        if clock is None and not tells_clock:
            self.refusals[Refusal.NO_CLOCK] += 1
            return False
        if clock is not None:
            delivery_s = t_mono_s - t_boot_s - clock[0]
            if not -AHEAD_S <= delivery_s <= LATE_S:
                self.refusals[Refusal.LATE if delivery_s > 0.0 else Refusal.AHEAD] += 1
                return False
        if tells_clock:
            self._clock.arrived(t_mono_s, t_boot_s)
        return True

    def _add(self, stream: SampleStream, t_boot_s: float, value: FloatArray, rate: FloatArray | None = None) -> None:
        if not stream.add(t_boot_s, value, rate):
            self.refusals[Refusal.OUT_OF_ORDER] += 1

    def _add_attitude(self, t_boot_s: float, angles: FloatArray) -> None:
        if self._angles is not None:
            # Counted on over the turn, so that it can be interpolated.
            angles = angles + 2.0 * math.pi * np.round((self._angles - angles) / (2.0 * math.pi))
        self._angles = angles
        self._add(self._attitude, t_boot_s, angles)

    def _take_swing(self, event: CableSwing) -> None:
        angles, rates = (event.xi_rad, event.zeta_rad), (event.xi_rate_radps, event.zeta_rate_radps)
        stds = (event.xi_std_rad, event.zeta_std_rad)
        if not all(map(math.isfinite, (*angles, *rates, *stds))):
            self.refusals[Refusal.NOT_FINITE] += 1
            return
        self.swing_health = event.health
        self._refused = ""
        if event.health in (Health.INIT, Health.FAULT) or not all(0.0 <= std <= STD_MAX_RAD for std in stds):
            self._refuse(f"its swingd: {event.health.value}")
        elif max(map(abs, angles)) > SWING_MAX_RAD:
            self.refusals[Refusal.IMPOSSIBLE] += 1
        elif self._is_usable(event.t_mono_s, event.t_boot_s, (*angles, *rates, *stds), 100.0):
            self._cable_var = np.square(stds)
            self._add(self._cable, event.t_boot_s, np.array(angles), np.array(rates))

    def _take_force(self, event: CableForce) -> None:
        if not all(map(math.isfinite, (*event.force_ned_n, *event.force_std_n))):
            self.refusals[Refusal.NOT_FINITE] += 1
            return
        self.swing_health = Health.READY
        self._refused = ""
        size_n = math.hypot(*event.force_ned_n)
        if size_n < FORCE_MIN_N or event.force_ned_n[2] < FORCE_DOWN_MIN * size_n:
            self._refuse("the cable is not taut")
        elif max(map(abs, event.force_std_n)) > FORCE_STD_SHARE_MAX * size_n:
            self._refuse("it is not known well enough")
        elif self._is_usable(event.t_mono_s, event.t_boot_s, event.force_ned_n, VALUE_MAX):
            self._cable_var = np.square(event.force_std_n)
            self._add(self._cable, event.t_boot_s, np.array(event.force_ned_n))

    def _refuse(self, reason: str) -> None:
        self._refused = reason
        self.refusals[Refusal.SWING_NOT_GOOD] += 1

    def _take_origin(self, origin: LocalOrigin) -> None:
        numbers = (origin.lat_rad, origin.lon_rad, origin.alt_amsl_m, origin.earth_radius_m)
        if not all(map(math.isfinite, numbers)):
            self.refusals[Refusal.NOT_FINITE] += 1
            return
        before = self.origin
        self.origin = origin
        if before is not None and (before.lat_rad, before.lon_rad, before.alt_amsl_m) != numbers[:3]:
            # Positions before and after are of two frames.
            self._position.clear()

    def _restart(self) -> None:
        """Forget everything that belongs to the clock and the frame before."""
        self.restarts += 1
        for stream in self._streams.values():
            stream.clear()
        self._clock = ClockOffset()
        self._angles = None
        self.origin = None
