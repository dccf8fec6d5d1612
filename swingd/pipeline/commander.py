"""From the estimate to the setpoint: what is asked for, the correction, and whether it may leave."""

import math
from dataclasses import dataclass

from swingd.control import make_law
from swingd.control.base import Vec2
from swingd.model.actions import Action, Health, PassSetpoint, Setpoint, Severity, StatusText
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.estimate import FloatArray
from swingd.model.events import (
    AppSetpoint,
    AutopilotKind,
    AutopilotState,
    FlightMode,
    LocalPosition,
    Mission,
    PathOrder,
    SetpointUse,
    UnmetSetpoint,
)
from swingd.model.parameters import Hold, Mode, Parameters
from swingd.pipeline.application import REPEAT_MAX_S, ApplicationStream
from swingd.pipeline.correction import NO_PUSH, Correction, Push, turn
from swingd.pipeline.damping_watch import DampingWatch, Motion
from swingd.pipeline.disturbance_feed_forward import DisturbanceFeedForward
from swingd.pipeline.envelope import CORRECTIONS, Conditions, Fade, Part, may_leave, withheld_by
from swingd.pipeline.feed_forward import FeedForward
from swingd.pipeline.health import HEARTBEAT_LATE_S, LATE_S, Evidence
from swingd.pipeline.merge import ACC_XY, POS_XY, VEL_XY, Reference, carried, is_correctable, merge, reference_of
from swingd.pipeline.path import POSITION_LATE_S, PathInputs, PathProgress, PathReference, load_motion
from swingd.pipeline.payload_state import PayloadState
from swingd.pipeline.reference import POSITION_AGE_MAX_S, HoldReference

TEXT_EVERY_S = 5.0
STEADY_S = 1.0
"""Before a meeting begins, filter steps must have come without a gap of `LATE_S` for this long: telemetry that comes in
bursts would change hands many times a second."""
APPLICATION_FOR_S = 0.5
"""In mode `hold`: an application that has sent a setpoint within this time commands alone."""
POSITION_GAIN_PER_S = 1.0
"""Of the autopilot's position loop: MPC_XY_P, PSC_POSXY_P."""
STREAM_LOST_S = 1.0
"""PX4's COM_OF_LOSS_T by default."""


@dataclass(frozen=True, slots=True)
class Situation:
    """One filter step, as far as commanding depends on it."""

    t_boot_s: float
    dt_s: float
    gap: bool
    """Whether samples were missing in this step."""
    yaw_rad: float
    level_yaw_rad: float
    """Heading in the level frame, which does not turn."""
    direction: Vec2
    """Horizontal direction of the cable in the level frame [rad at small angles]."""
    direction_rate_per_s: Vec2
    tilt_acc_mps2: Vec2
    """Horizontal acceleration that the tilted thrust makes, in the level frame."""
    evidence: Evidence
    health: Health
    taking_off: bool
    """By the autopilot's own word."""
    lift_n: float
    """Vertical part of the thrust, up [N]."""
    disturbance: DisturbanceEstimate | None
    """None where none is estimated."""
    path: PathInputs | None = None
    """None where no load is to be led."""


class Commander:
    """Reference, law, correction and envelope, for the modes that send setpoints.

    In mode `hold` the stream of setpoints is swingd's own. So it is in mode `path`, which leads the load by
    accelerations while it may, and else holds with a reference velocity of zero as mode `hold` does. In mode `inline`
    it is an application's: while a correction may leave, each of its setpoints is consumed and sent on at the filter's
    rate with the correction in it; at any other time it passes as it came.

    Parameters
    ----------
    parameters : Parameters
        Mode, limits, and what the law is computed from.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._enabled = parameters.control.enabled
        self._parameters = parameters
        self._law = make_law(parameters)
        self._hold = HoldReference(_hold_of(parameters))
        self._path = PathReference(parameters)
        self._application = ApplicationStream()
        self._feed_forward = FeedForward(parameters)
        self._correction = Correction(parameters.control)
        self._disturbance = DisturbanceFeedForward(parameters)
        self._fades = {part: Fade(parameters.control) for part in CORRECTIONS}
        self._watch = DampingWatch(parameters)
        self._ground_down_m = 0.0
        self._t_mono_s = -math.inf
        self._state: AutopilotState | None = None
        self._position: LocalPosition | None = None
        self._stepped_s = -math.inf
        self._willing = False
        self._meeting = False
        self._streaming = False
        self._streamed_s = -math.inf
        self._told_s = -math.inf
        self._steady_since_s = math.inf
        self._talked_s = -math.inf
        self._unsent: AppSetpoint | None = None
        """Consumed, and not sent yet."""
        self._t_boot_s = 0.0
        self.push: Push = NO_PUSH
        """What the last step added against the swing, along north and east."""
        self.feed_forward_mps2: Vec2 = (0.0, 0.0)
        """What it added against the disturbance, along north and east."""

    def configure(self, parameters: Parameters) -> None:
        """Take other parameters; what is being commanded goes on, so that the vehicle does not jump."""
        if parameters.control.enabled and not self._enabled:
            self._watch.enabled()
        self._enabled = parameters.control.enabled
        if parameters.mode is not self._parameters.mode:
            self.drop()
            self._path.restart()
        self._parameters = parameters
        self._law = make_law(parameters)
        self._hold.configure(_hold_of(parameters))
        self._path.configure(parameters)
        self._feed_forward.configure(parameters)
        self._correction.configure(parameters.control)
        self._disturbance.configure(parameters)
        for fade in self._fades.values():
            fade.configure(parameters.control)
        self._watch.configure(parameters)

    @property
    def active(self) -> bool:
        """Whether the setpoints lead the load, or have a correction in them, of the swing or the disturbance."""
        return self._fade > 0.0 or self._path.leading

    @property
    def damps(self) -> bool:
        """Whether the correction of the swing is in the setpoints, one that fades included."""
        return self._fades[Part.SWING].value > 0.0

    @property
    def _fade(self) -> float:
        """Of the part that is given most of."""
        return max(fade.value for fade in self._fades.values())

    @property
    def path(self) -> PathProgress:
        """How far the path of mode `path` has come."""
        return self._path.progress

    def order(self, order: PathOrder) -> str | None:
        """Take an order to mode `path`; return what is to be told, None in any other mode."""
        return self._path.order(order) if self._parameters.mode is Mode.PATH else None

    def set_mission(self, mission: Mission) -> str:
        """Take the autopilot's mission; return what is to be told."""
        return self._path.set_mission(mission.waypoints_ned_m, mission.problem)

    def take_texts(self) -> list[str]:
        """Return what the path has to tell since the last call."""
        return self._path.take_texts()

    @property
    def law_acts(self) -> bool:
        """Whether the law asks for anything with these parameters."""
        return self._law.acts

    @property
    def refused_references(self) -> int:
        """References from outside that mode `hold` did not take."""
        return self._hold.refused

    @property
    def flight_mode(self) -> FlightMode:
        """The mode, where it was reported lately."""
        return self._flight_mode

    @property
    def distrust(self) -> str:
        """Why the correction is off until it is enabled again; empty where it need not be."""
        return self._watch.distrust

    def conditions(
        self,
        evidence: Evidence,
        health: Health,
        disturbance: DisturbanceEstimate | None,
        *,
        gap: bool = False,
    ) -> Conditions:
        """Everything that decides whether a correction may leave; ``gap`` where this step lacks samples."""
        return Conditions(
            mode=self._parameters.mode,
            enabled=self._enabled,
            trusted=not self._watch.distrust,
            armed=self._armed,
            flight_mode=self._flight_mode,
            high=self._is_high(),
            asked=self._asked(),
            payload=evidence.payload,
            fresh=evidence.fresh and not gap,
            finite=evidence.finite,
            settled=evidence.settled,
            certain=evidence.certain,
            consistent=evidence.consistent,
            link=evidence.link and evidence.heartbeat,
            recovered=health in (Health.READY, Health.ACTIVE),
            disturbance=self._disturbance_doubt(evidence, health, disturbance),
            led=self._path.leading,
            # An acceleration would stay with Copter for GUID_TIMEOUT when swingd ends, and its jerk is limited.
            path=self._path.doubt if self._kind is AutopilotKind.PX4 else "only PX4 can be led along a path",
        )

    def _disturbance_doubt(self, evidence: Evidence, health: Health, disturbance: DisturbanceEstimate | None) -> str:
        """Why a disturbance may not be leaned against besides what holds for every part; empty where it may."""
        if not self._parameters.disturbance.feed_forward:
            return "feed-forward switched off"
        if self._kind is not AutopilotKind.PX4:
            # Copter takes an acceleration for the derivative of its target: a steady one would move the target away.
            return "only PX4 leans by an acceleration"
        if health is Health.FAULT:
            return "health is fault"
        if evidence.payload is PayloadState.ON_GROUND:
            return "on ground"
        return "no disturbance is estimated" if disturbance is None else disturbance.doubt

    def _is_high(self) -> bool:
        """Whether the vehicle is high enough above where it was armed; where that is not known, above its origin."""
        height_min_m = self._parameters.control.height_min_m
        if height_min_m <= 0.0:
            return True
        position = self._position
        if position is None or self._t_mono_s - position.t_mono_s > POSITION_AGE_MAX_S:
            return False
        return self._ground_down_m - position.pos_ned_m[2] >= height_min_m

    # ---- what is known

    def advance_clock(self, t_mono_s: float) -> None:
        """Note the host's time of the event that is being handled [s]."""
        self._t_mono_s = t_mono_s

    def add_position(self, position: LocalPosition) -> None:
        """Take the vehicle's position."""
        self._position = position
        self._hold.add_position(position)

    def turn(self, yaw_jump_rad: float) -> None:
        """The autopilot's yaw was reset."""
        self._hold.turn(yaw_jump_rad)

    def autopilot_restarted(self) -> None:
        """Positions mean nothing any more."""
        self._position = None
        self._hold.restarted()
        self._path.restart()
        self._application.end()
        self._unsent = None
        self.drop()

    def set_state(self, state: AutopilotState) -> None:
        """Take the autopilot's arming and mode."""
        if state.mode is FlightMode.OFFBOARD and self._state is not None and self._state.mode is FlightMode.OTHER:
            self._path.go_on()
        self._state = state
        if not state.armed and self._position is not None:
            self._ground_down_m = self._position.pos_ned_m[2]
        if state.mode is not FlightMode.OFFBOARD:
            self.drop()

    def switch(self, enabled: bool) -> bool:
        """Enable or disable the correction; return whether that changed anything. It ends a distrust of the damping."""
        changed = enabled != self._enabled or (enabled and bool(self._watch.distrust))
        self._enabled = enabled
        if enabled and changed:
            self._watch.enabled()
        return changed

    def land(self) -> None:
        """The vehicle stands or is disarmed: nothing is commanded."""
        self._streaming = False
        self.drop()
        self._path.restart()

    def drop(self) -> None:
        """Nothing follows the setpoints any more, or nobody asks: begin from zero the next time."""
        self._willing = self._meeting = False
        for fade in self._fades.values():
            fade.cut()
        self._feed_forward.drop()
        self._disturbance.cut()
        self._correction.reset()
        self._watch.rest()
        self._path.rest()
        self.push = NO_PUSH
        self.feed_forward_mps2 = (0.0, 0.0)

    # ---- what is asked for

    def take(self, setpoint: AppSetpoint) -> list[Action]:
        """Take an application's setpoint: an empty answer means that it is met, and must not pass as well."""
        if setpoint.source == 0:
            return self._take_reference(setpoint)
        if self._parameters.mode is not Mode.INLINE:
            return [PassSetpoint(), *self._give_way()]
        application = self._application
        application.take(setpoint)
        if (self._willing or self._meeting) and self._t_mono_s - self._stepped_s < LATE_S and self._asked():
            if not self._meeting:
                self._meeting = True
                application.met()
            self._unsent = setpoint
            return []
        if self._meeting:
            self.drop()
        self._unsent = None  # what passes takes its place
        actions: list[Action] = [PassSetpoint()]
        if application.is_contested(self._t_mono_s) and self._may_tell():
            text = "two applications send setpoints: both pass uncorrected"
            actions.append(StatusText(Severity.WARNING, text))
        return actions

    def leave(self, _other: UnmetSetpoint) -> None:
        """The application asks for something that no correction meets: what it asked for before is void."""
        self._application.end()
        self._unsent = None
        if self._meeting:
            self.drop()
        self._give_way()

    def _give_way(self) -> list[Action]:
        """In modes `hold` and `path`: an application commands by itself, and two must not talk at a time."""
        self._talked_s = self._t_mono_s
        mode = self._parameters.mode
        if mode not in (Mode.HOLD, Mode.PATH) or not self._may_tell():
            return []
        text = f"an application sends setpoints: mode {mode.value} is silent; inline corrects them"
        return [StatusText(Severity.WARNING, text)]

    def _take_reference(self, setpoint: AppSetpoint) -> list[Action]:
        if self._parameters.mode is not Mode.HOLD or self._hold.set(setpoint) or not self._may_tell():
            return []
        text = "reference refused: expected a velocity, with or without yaw, and nothing else"
        return [StatusText(Severity.WARNING, text)]

    def _may_tell(self) -> bool:
        if self._t_mono_s - self._told_s < TEXT_EVERY_S:
            return False
        self._told_s = self._t_mono_s
        return True

    def _asked(self) -> bool:
        """Whether there is something to correct."""
        if self._parameters.mode is not Mode.INLINE:
            return self._t_mono_s - self._talked_s > APPLICATION_FOR_S
        setpoint = self._application.setpoint
        return (
            setpoint is not None
            and self._application.holds(self._t_mono_s)
            and is_correctable(setpoint.use, self._kind)
        )

    @property
    def _kind(self) -> AutopilotKind:
        return self._state.kind if self._state is not None else AutopilotKind.OTHER

    @property
    def _armed(self) -> bool:
        return self._state is not None and self._state.armed

    @property
    def _flight_mode(self) -> FlightMode:
        """The mode, where it was reported lately."""
        state = self._state
        if state is None or self._t_mono_s - state.t_mono_s > HEARTBEAT_LATE_S:
            return FlightMode.UNKNOWN
        return state.mode

    # ---- the command

    def step(self, now: Situation) -> Setpoint | None:
        """Answer one filter step with the setpoint that is to be sent, if any."""
        self._t_boot_s = now.t_boot_s
        setpoint = self._step(now)
        if setpoint is not None:
            self._unsent = None
        elif not self._meeting:
            setpoint = self._owed()
        return setpoint

    def _owed(self) -> Setpoint | None:
        """What was consumed and never sent, when the meeting has ended: as it was asked for."""
        unsent, self._unsent = self._unsent, None
        if unsent is None or self._t_mono_s - unsent.t_mono_s > REPEAT_MAX_S:
            return None
        return _setpoint(self._t_boot_s, reference_of(unsent))

    def _step(self, now: Situation) -> Setpoint | None:
        if self._t_mono_s - self._stepped_s > LATE_S:
            self._steady_since_s = self._t_mono_s
        self._stepped_s = self._t_mono_s
        mode = self._parameters.mode
        if mode in (Mode.HOLD, Mode.PATH) and now.taking_off and self._kind is AutopilotKind.ARDUPILOT:
            # Copter takes off in GUIDED, and the first setpoint would end that wherever the vehicle is.
            self.drop()
            return None
        if now.path is not None:
            self._path.observe(self._t_mono_s, self._load_motion(now, now.path), now.path, now.dt_s)
        conditions = self.conditions(now.evidence, now.health, now.disturbance, gap=now.gap)
        allowed = may_leave(Part.SWING, conditions)
        against_disturbance = may_leave(Part.DISTURBANCE, conditions)
        self._willing = (allowed or against_disturbance) and self._t_mono_s - self._steady_since_s > STEADY_S
        if mode is Mode.INLINE:
            if not self._meeting:
                self.push = NO_PUSH
                self._lean(now, fade=0.0)
                return None
            if not self._application.holds(self._t_mono_s):
                # The application is silent: from here on so is swingd, and the autopilot's own failsafe acts.
                self.drop()
                return None
        fade = self._fades[Part.SWING].update(allowed, now.dt_s, harmful=bool(self._watch.distrust))
        reference = self._inline_reference() if mode is Mode.INLINE else self._hold_reference(now)
        if reference is None:
            # Nothing is streamed, so nothing rises unseen: the first setpoint would be a step.
            self._fades[Part.DISTURBANCE].cut()
            against_disturbance = False
        lean = self._lean(now, self._fades[Part.DISTURBANCE].update(against_disturbance, now.dt_s))
        led = self._led(reference, conditions)
        if led is not None:
            reference = led
        elif reference is not None:
            reference = self._shaped(reference, fade, now.dt_s)
        elif mode is Mode.INLINE:
            return None
        wanted = self._wanted(now) if allowed else None
        push = self._correction.update(wanted, fade, now.dt_s)
        if mode is Mode.INLINE:
            freshness = self._application.freshness(self._t_mono_s, now.dt_s)
            push = push.scaled(freshness)
            lean = (freshness * lean[0], freshness * lean[1])
        self._watch_damping(now, reference, push, lean)
        self.push = push.turned(now.yaw_rad - now.level_yaw_rad) if push is not NO_PUSH else push
        if reference is None:
            return None
        self.feed_forward_mps2 = lean
        return _setpoint(now.t_boot_s, merge(reference, self.push.leaning(lean), self._kind))

    def _led(self, hold: Reference | None, conditions: Conditions) -> Reference | None:
        """What leads the load, with the heading of what holds; None where the load may not be led."""
        if self._parameters.mode is not Mode.PATH:
            return None
        reasons = withheld_by(Part.PATH, conditions)
        acc = self._path.lead(self._t_mono_s) if hold is not None and not reasons else None
        if hold is None or acc is None:
            self._path.rest(reasons[0] if reasons else "")
            return None
        self._feed_forward.drop()
        self._hold.follow()
        return Reference(SetpointUse.ACC | SetpointUse.YAW, acc_ned_mps2=acc, yaw_rad=hold.yaw_rad)

    def _load_motion(self, now: Situation, inputs: PathInputs) -> FloatArray | None:
        """The load's state, see `load_motion`; None where the vehicle's position is late."""
        position = self._position
        if position is None:
            return None
        age_s = now.t_boot_s - position.t_boot_s
        if abs(age_s) > POSITION_LATE_S:
            return None
        to_ned_rad = now.yaw_rad - now.level_yaw_rad
        direction, rate = turn(now.direction, to_ned_rad), turn(now.direction_rate_per_s, to_ned_rad)
        return load_motion(position, age_s, direction, rate, inputs, self._parameters.cable.length_m)

    def _lean(self, now: Situation, fade: float) -> Vec2:
        """Follow the disturbance; return the acceleration against it, north and east."""
        self.feed_forward_mps2 = (0.0, 0.0)
        return self._disturbance.update(now.disturbance, now.lift_n, fade, now.dt_s)

    def _watch_damping(self, now: Situation, reference: Reference | None, push: Push, lean: Vec2) -> None:
        """See whether the push does what it is for."""
        position = self._position
        if reference is None or push == NO_PUSH or position is None:
            self._watch.rest()
            return
        length_m = self._parameters.cable.length_m
        to_level_rad = now.level_yaw_rad - now.yaw_rad
        use = reference.use
        vel = reference.vel_ned_mps[:2] if use & VEL_XY else (0.0, 0.0)
        if use & POS_XY:
            (n, e), (place_n, place_e) = reference.pos_ned_m[:2], position.pos_ned_m[:2]
            vel = (vel[0] + POSITION_GAIN_PER_S * (n - place_n), vel[1] + POSITION_GAIN_PER_S * (e - place_e))
        acc = reference.acc_ned_mps2[:2] if use & ACC_XY else (0.0, 0.0)
        self._watch.update(
            Motion(
                dt_s=now.dt_s,
                load_m=(length_m * now.direction[0], length_m * now.direction[1]),
                load_rate_mps=(length_m * now.direction_rate_per_s[0], length_m * now.direction_rate_per_s[1]),
                vel_mps=turn(position.vel_ned_mps[:2], to_level_rad),
                vel_ref_mps=turn(vel, to_level_rad) if use & (VEL_XY | POS_XY) else None,
                acc_ref_mps2=turn(acc, to_level_rad),
                lean_mps2=turn(lean, to_level_rad),
                tilt_acc_mps2=now.tilt_acc_mps2,
                heading_rad=now.level_yaw_rad,
                push=push,
                limited=self._correction.limited or (bool(use & POS_XY) and self._correction.displaced),
            )
        )

    def _wanted(self, now: Situation) -> Vec2:
        """What the law asks for, in the level frame; it sees the swing in the heading frame.

        It answers what differs from the swing that the shaped reference plans, or else it would fight the plan.
        """
        estimated = (turn(vector, -now.level_yaw_rad) for vector in (now.direction, now.direction_rate_per_s))
        planned = (turn(vector, -now.yaw_rad) for vector in self._feed_forward.swing)
        ahead, rate = ((e[0] - p[0], e[1] - p[1]) for e, p in zip(estimated, planned, strict=True))
        return turn(self._law.acceleration(ahead, rate), now.level_yaw_rad)

    def _shaped(self, reference: Reference, fade: float, dt_s: float) -> Reference:
        """Shape what is asked for, the way whoever asks is to be shaped."""
        shaper, age_s = self._parameters.hold.shaper, 0.0
        setpoint = self._application.setpoint
        if self._parameters.mode is Mode.INLINE and setpoint is not None:
            shaper = setpoint.shaper
            if self._kind is not AutopilotKind.ARDUPILOT:
                # An ArduPilot's has been carried to the present already.
                age_s = self._t_mono_s - setpoint.t_mono_s
        position = self._position
        known = position is not None and self._t_mono_s - position.t_mono_s < POSITION_AGE_MAX_S
        return self._feed_forward.update(
            reference,
            shaper,
            kind=self._kind,
            fade=fade,
            dt_s=dt_s,
            age_s=age_s,
            place_m=position.pos_ned_m[:2] if position is not None and known else None,
        )

    def _inline_reference(self) -> Reference | None:
        """The application's setpoint; None once the correction has faded, so that its next one passes as it comes."""
        setpoint = self._application.setpoint
        if setpoint is None or (self._fade <= 0.0 and not self._willing):
            self.drop()
            return None
        return carried(reference_of(setpoint), self._t_mono_s - setpoint.t_mono_s, self._kind)

    def _hold_reference(self, now: Situation) -> Reference | None:
        if now.health is Health.READY and self._armed:
            self._streaming = True
        elif not self._armed or self._t_mono_s - self._streamed_s > STREAM_LOST_S:
            # Where the stream was interrupted for so long, the autopilot's failsafe has acted: it begins anew at READY.
            self._streaming = False
        mode = self._parameters.mode
        if not self._streaming or now.health is Health.FAULT or mode not in (Mode.HOLD, Mode.PATH):
            return None
        if not self._asked():
            return None
        self._streamed_s = self._t_mono_s
        return self._hold.at(self._t_mono_s, self._flight_mode, now.yaw_rad, self._kind)

    def tick(self, health: Health) -> Setpoint | None:
        """Notice what does not happen any more."""
        late = self._t_mono_s - self._stepped_s > LATE_S
        stop = self._stop() if late and self._path.leading else None
        if health is Health.FAULT or (self._meeting and late):
            # No setpoint of swingd's leaves any more: there is nothing to fade.
            self.drop()
        return stop if stop is not None or self._meeting else self._owed()

    def _stop(self) -> Setpoint:
        """No acceleration may stay with the autopilot when nothing is known any more: it is to stand."""
        self._path.rest("IMU or attitude late")
        yaw_rad = self._hold.yaw_rad
        use = SetpointUse.VEL if yaw_rad is None else SetpointUse.VEL | SetpointUse.YAW
        return _setpoint(self._t_boot_s, Reference(use, yaw_rad=yaw_rad or 0.0))


def _hold_of(parameters: Parameters) -> Hold:
    """The reference that holds: mode `path` stands where it does not lead."""
    return Hold() if parameters.mode is Mode.PATH else parameters.hold


def _setpoint(t_boot_s: float, reference: Reference) -> Setpoint:
    return Setpoint(
        t_boot_s=t_boot_s,
        use=reference.use,
        pos_ned_m=reference.pos_ned_m,
        vel_ned_mps=reference.vel_ned_mps,
        acc_ned_mps2=reference.acc_ned_mps2,
        yaw_rad=reference.yaw_rad,
        yaw_rate_radps=reference.yaw_rate_radps,
    )
