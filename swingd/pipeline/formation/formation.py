"""The load's pose from what several vehicles tell, at a steady rate, with its health.

Every vehicle is taken to one common instant. It lies so far in the past that the samples of all of them have come, as
far as the last seconds show; what still lacks then is carried on with its rate and believed the less.
"""

import math
from collections.abc import Mapping

import numpy as np

from swingd.core.status import Status
from swingd.estimation.cooperative_pose import CooperativePose, KnownAngles, LoadPose, WinchTable
from swingd.model.actions import Health
from swingd.model.formation import (
    VEHICLES_MIN,
    FormationParameters,
    FormationReport,
    LoadMotion,
    LocalOrigin,
    VehicleCondition,
    VehicleEvent,
)
from swingd.pipeline.formation.clock import Least
from swingd.pipeline.formation.geometry import offset_ned_m
from swingd.pipeline.formation.sights import Sighting, look, motion_of
from swingd.pipeline.formation.vehicle import VehicleInstant, VehicleTrack

SETTLE_S = 0.5
"""Without a doubt for so long, and it is good again."""
DELAY_WINDOW_S = 2.0
ADVANCE_MIN = 0.2
"""Of a tick: the instant of the pose never stands still nor goes back."""
CHI2_Z = 5.0
"""Deviations of a normal by which the residuals may exceed what they should be."""
SOON_S = 0.01
ORIGINS_MAX_M = 2000.0
"""Local frames whose origins lie further apart are turned against each other."""
_POSITION_FIRST = np.array([3, 4, 5, 0, 1, 2])


class Formation:
    """Several vehicles and their one load.

    Parameters
    ----------
    parameters : FormationParameters

    Raises
    ------
    ConfigurationError
        If the table of the winch is none.
    """

    def __init__(self, parameters: FormationParameters) -> None:
        self.parameters = parameters
        self.tracks = tuple(VehicleTrack(rig) for rig in parameters.vehicles)
        rows = parameters.load.winch_pitch
        self._table = WinchTable([row[0] for row in rows], [row[1] for row in rows]) if rows else None
        self._solver = CooperativePose()
        self._origin: LocalOrigin | None = None
        self._ages = [Least(DELAY_WINDOW_S) for _ in self.tracks]
        self._instant_s = -math.inf
        self._last_step_s = -math.inf
        self._health = Health.INIT
        self._doubted_s = -math.inf
        self._contradicted_s: float | None = None
        self._resets = 0
        self._begun = False
        self._known = False

    def take(self, vehicle: int, event: VehicleEvent) -> None:
        """Take what a vehicle, by its place in the configuration, tells; never raises."""
        track = self.tracks[vehicle]
        track.take(event)
        if self._origin is None and track.origin is not None and not self.parameters.origins_are_configured:
            self._origin = track.origin

    def refusals(self) -> Mapping[int, Mapping[str, int]]:
        """Count what was not used, by system id and reason."""
        return {
            track.rig.system_id: {reason.value: count for reason, count in track.refusals.items()}
            for track in self.tracks
        }

    def step(self, t_mono_s: float) -> FormationReport:
        """Give what is known now; to be called at the configured rate."""
        parameters = self.parameters
        newest = [track.newest_s(t_mono_s) for track in self.tracks]
        ages = [None if s is None else max(t_mono_s - s, 0.0) for s in newest]
        used = [k for k, age in enumerate(ages) if age is not None and age <= parameters.lost_s]
        doubts = self._doubts(ages)
        instant_s = self._advance(t_mono_s, ages, used)
        # One that was heard since shortly only begins after the instant.
        found = {k: now for k in used if (now := self.tracks[k].at(instant_s, t_mono_s)) is not None}
        motion, problem = None, ""
        silent = len(found) < VEHICLES_MIN
        if silent:
            problem = f"{len(found)} of {len(self.tracks)} vehicles heard, {VEHICLES_MIN} needed"
            problem += "".join(f"; {doubt}" for doubt in doubts)
        else:
            motion, problem = self._motion(t_mono_s, instant_s, found, doubts)
        health, reason = self._judge(t_mono_s, problem, doubts, silent)
        self._last_step_s = t_mono_s
        clocks = [track.clock(t_mono_s) for track in self.tracks]
        return FormationReport(
            t_mono_s=t_mono_s,
            health=health,
            reason=reason,
            motion=motion,
            vehicles=tuple(
                VehicleCondition(age, k in found, None if clock is None else clock[1], track.missing())
                for k, (track, age, clock) in enumerate(zip(self.tracks, ages, clocks, strict=True))
            ),
            resets=self._resets,
            origin=self._origin,
        )

    # ---- instant

    def _advance(self, t_mono_s: float, ages: list[float | None], used: list[int]) -> float:
        """Choose the instant of the pose."""
        if not used:
            return self._instant_s
        delay_s = 0.0
        for k in used:
            age = ages[k]
            assert age is not None
            self._ages[k].add(t_mono_s, -age)
            least = self._ages[k].get(t_mono_s)
            delay_s = max(delay_s, age if least is None else -least[0])
        wanted_s = t_mono_s - min(delay_s, self.parameters.late_s)
        tick_s = min(t_mono_s - self._last_step_s, 1.0)
        self._instant_s = min(max(wanted_s, self._instant_s + ADVANCE_MIN * tick_s), t_mono_s)
        return self._instant_s

    # ---- pose

    def _motion(
        self, t_mono_s: float, instant_s: float, found: Mapping[int, VehicleInstant], doubts: list[str]
    ) -> tuple[LoadMotion | None, str]:
        """Find pose and motion from the vehicles at one instant; or say why not."""
        sightings: list[Sighting] = []
        winches: list[tuple[float, float]] = []
        for k, now in found.items():
            track = self.tracks[k]
            offset = self._offset_ned_m(track)
            if offset is None:
                return None, f"system {track.rig.system_id}: its origin is over {ORIGINS_MAX_M:g} m from the others'"
            sighting = look(track.rig, now, offset)
            if sighting is None:
                return None, f"system {track.rig.system_id}: tethers of such lengths cannot be"
            sightings.append(sighting)
            if track.rig.winch:
                winches.append((now.winch, now.winch_rate))
        known, pitch_rate = self._known_angles(winches, doubts)
        if not self._known:
            # The search for the attitude begins with the vehicles' mean heading.
            yaws = np.array([sighting.instant.yaw_rad for sighting in sightings])
            self._solver.reset(math.atan2(float(np.sin(yaws).sum()), float(np.cos(yaws).sum())))
        status, pose = self._solver.solve([sight for one in sightings for sight in one.sights], known)
        if pose is None:
            return None, _WHY.get(status, "no pose fits what the vehicles tell")
        moving = motion_of(pose, sightings, known.roll_std_rad, known.pitch_std_rad, pitch_rate)
        if moving is None:
            return None, _WHY[Status.NOT_POSITIVE]
        self._contradictions(t_mono_s, pose, doubts)
        vel, rate, motion_cov = moving
        return LoadMotion(
            instant_s,
            pose.pos_ned_m,
            pose.ned_from_frd,
            pose.roll_rad,
            pose.pitch_rad,
            pose.yaw_rad,
            pose.cov[np.ix_(_POSITION_FIRST, _POSITION_FIRST)],
            vel,
            rate,
            motion_cov,
            pose.chi2,
            pose.dof,
        ), ""

    def _offset_ned_m(self, track: VehicleTrack) -> tuple[float, float, float] | None:
        if track.rig.origin_ned_m is not None:
            return track.rig.origin_ned_m
        assert track.origin is not None
        assert self._origin is not None
        offset = offset_ned_m(track.origin, self._origin)
        return offset if math.dist(offset, (0.0, 0.0, 0.0)) <= ORIGINS_MAX_M else None

    def _known_angles(self, winches: list[tuple[float, float]], doubts: list[str]) -> tuple[KnownAngles, float]:
        """Return what is known without the tethers, and the rate of the pitch that the winches give."""
        load = self.parameters.load
        pitch_rad, pitch_std, pitch_rate = load.pitch_rad, load.pitch_std_rad, 0.0
        if self._table is not None:
            winch, rate = (sum(values) / len(winches) for values in zip(*winches, strict=True)) if winches else (0, 0)
            status, pitch_rad = self._table.pitch_rad(0.0, winch)
            if status is Status.OK:
                ahead, soon_rad = self._table.pitch_rad(0.0, winch + SOON_S * rate)
                pitch_rate = (soon_rad - pitch_rad) / SOON_S if ahead is Status.OK else 0.0
            else:
                doubts.append(f"winch at {winch:.3g}, beyond its table")
                pitch_std = None
        known = KnownAngles(
            roll_rad=load.roll_rad,
            pitch_rad=pitch_rad,
            roll_std_rad=math.inf if load.roll_std_rad is None else load.roll_std_rad,
            pitch_std_rad=math.inf if pitch_std is None else pitch_std,
        )
        return known, pitch_rate

    # ---- health

    def _doubts(self, ages: list[float | None]) -> list[str]:
        doubts = []
        for track, age in zip(self.tracks, ages, strict=True):
            name = f"system {track.rig.system_id}"
            if age is None:
                doubts.append(f"{name}: no {', '.join(track.missing()) or 'sample'} heard")
            elif age > self.parameters.lost_s:
                doubts.append(f"{name}: lost")
            elif age > self.parameters.late_s:
                doubts.append(f"{name}: {track.oldest()} late")
            elif track.swing_health is Health.DEGRADED:
                doubts.append(f"{name}: its swingd is degraded")
        return doubts

    def _contradictions(self, t_mono_s: float, pose: LoadPose, doubts: list[str]) -> None:
        """Doubt residuals that are larger than the deviations allow for longer than `SETTLE_S`."""
        if pose.dof < 1:
            return
        spread = 2.0 / (9.0 * pose.dof)
        limit = pose.dof * (1.0 - spread + CHI2_Z * math.sqrt(spread)) ** 3  # Wilson and Hilferty
        if pose.chi2 <= limit:
            self._contradicted_s = None
            return
        if self._contradicted_s is None:
            self._contradicted_s = t_mono_s
        if self._health is not Health.READY:
            self._doubted_s = t_mono_s
        if t_mono_s - self._contradicted_s >= SETTLE_S:
            doubts.append(
                f"the vehicles contradict each other: chi-square {pose.chi2:.3g}, at most {limit:.3g} expected"
            )

    def _judge(self, t_mono_s: float, problem: str, doubts: list[str], silent: bool) -> tuple[Health, str]:
        """Worse at once, better after `SETTLE_S` without a doubt."""
        if problem:
            self._doubted_s = t_mono_s
            if self._known:
                self._known = False
                self._resets += 1
            self._health = Health.INIT if silent and not self._begun else Health.FAULT
            return self._health, problem
        self._known = True
        if doubts:
            self._doubted_s = t_mono_s
        settled = t_mono_s - self._doubted_s >= SETTLE_S
        if settled:
            self._begun = True
            self._health = Health.READY
            return self._health, ""
        if self._health is not Health.INIT or doubts:
            self._health = Health.DEGRADED if self._begun or doubts else Health.INIT
        return self._health, "; ".join(doubts) or "settling"


_WHY = {
    Status.NOT_POSITIVE: "tethers and known angles do not tell the whole pose",
    Status.INPUT_INVALID: "what the vehicles tell is out of range",
}
