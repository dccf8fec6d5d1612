"""Where the load is, as the thrust tells it, and where that is silent, the swing."""

from dataclasses import dataclass
from enum import Enum

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import LandedState, Vec3
from swingd.model.parameters import Parameters, ThrustSource
from swingd.pipeline.payload_mass import ApparentMass, MassEstimate, SwingMass, Weighing

LIFTED_SHARE = 0.5
"""Share of the load's mass by which the thrust must rise to count as lifting it."""
LIFTED_FOR_S = 0.15
LOST_SHARE = 0.6
"""Share of what hangs by which the thrust must fall to count as having lost it: released, set down."""
LOST_FOR_S = 0.4
HANGING_SHARE_MAX = 1.5
"""Of the load's mass: more is not believed to hang, so that a lost load is missed whatever it was taken for."""
APPARENT_TIME_CONSTANT_S = 0.1
APPARENT_ATTACHED_TIME_CONSTANT_S = 0.3
"""Slower while the load hangs: a manoeuvre must not look like a release."""
LEVEL_TIME_CONSTANT_S = 3.0
"""Of the level against which rises and falls are judged: the thrust curve's error drifts with the battery."""
CLIMBING_S = 0.4
"""Of climbing with a slack cable, to know what the thrust curve's error feigns."""
CLIMB_MPS = 0.2
SETTLE_S = 2.0
"""For this long after a lift it is seen how much hangs; after a loss, the level without it is followed faster."""
SETTLING_TIME_CONSTANT_S = 0.5
SILENT_AFTER_S = 5.0
"""In the air for this long without a rise, where no take-off was watched that would have shown it, it may hang."""
FLYING_SHARE = 0.6
"""Share of the vehicle's weight that the thrust must carry to count as flying."""
FORCE_TIME_CONSTANT_S = 0.5
SWING_SHOWS_SHARE = 0.4
"""Share of the load's mass that the swing must show, three deviations below what it says."""
LOW_LENGTHS = 1.3
LOW_MARGIN_M = 0.5
"""A load that is lost below this many cable lengths, and a margin for the altitude's drift, was set down."""
SINK_MPS = 0.1
SINK_TIME_CONSTANT_S = 0.5


class PayloadState(Enum):
    """Where the load is."""

    ON_GROUND = "vehicle on ground"
    """Or nothing is known yet."""
    SLACK = "cable slack"
    """The vehicle flies and the cable carries nothing: the load is not lifted yet, or there is none."""
    UNKNOWN = "load unknown"
    """It may hang, but nothing has shown it: good enough to estimate, not to correct."""
    ATTACHED = "load attached"
    RELEASED = "load released"
    """It hung, and was lost in the air."""
    TOUCHED_DOWN = "load set down"
    """It hung, and its weight went to the ground."""

    @property
    def hangs(self) -> bool:
        """Whether there is a swing to estimate."""
        return self in (PayloadState.ATTACHED, PayloadState.UNKNOWN)


class Sign(Enum):
    """What is seen of the load; the value says it in words, with a mass where there is one."""

    FLIES = "nothing lifted yet"
    RISE = "thrust rose by {:.2g} kg"
    CARRIES = "thrust carries {:.2g} kg more"
    FALL = "thrust fell by {:.2g} kg"
    FALL_LOW = "thrust fell by {:.2g} kg near the ground"
    SWINGS = "the swing shows {:.2g} kg"
    SILENT = "joined in flight, no rise of thrust seen"
    UNTOLD = "no thrust stream to show it"
    PRESUMED = "thrust.source remark_1 presumes it"


_S = PayloadState
_EMPTY = {Sign.RISE: _S.ATTACHED, Sign.CARRIES: _S.ATTACHED, Sign.SWINGS: _S.ATTACHED}
TRANSITIONS: dict[PayloadState, dict[Sign, PayloadState]] = {
    _S.ON_GROUND: {Sign.FLIES: _S.SLACK, Sign.UNTOLD: _S.UNKNOWN, Sign.PRESUMED: _S.ATTACHED},
    _S.SLACK: {**_EMPTY, Sign.SILENT: _S.UNKNOWN},
    _S.UNKNOWN: _EMPTY,
    _S.RELEASED: _EMPTY,
    _S.TOUCHED_DOWN: _EMPTY,
    _S.ATTACHED: {Sign.FALL: _S.RELEASED, Sign.FALL_LOW: _S.TOUCHED_DOWN},
}
"""What follows a sign; any other changes nothing. Landing and disarming lead back to ``ON_GROUND`` from anywhere."""


@dataclass(frozen=True, slots=True)
class PayloadSample:
    """What one filter step shows of the load; level frame."""

    dt_s: float
    force_n: Vec3
    """Thrust and known drag, as the filter gets them [N]."""
    lift_n: float
    """Upward share of them by the thrust curve alone: without the calibrated scale, which might follow the load [N]."""
    acc_mps2: Vec3
    """Inertial acceleration of the hook [m/s^2]."""
    body_down: Vec3
    """Body's down axis, along which the thrust has no part in any other direction [1]."""
    thrust_known: bool
    """The thrust comes from a stream, not from Remark 1, which presumes a hanging load."""
    landed: LandedState
    """What the autopilot's land detector says."""
    vel_mps: Vec3 | None = None
    """Velocity of the vehicle over ground; None where it is not known [m/s]."""
    altitude_m: float | None = None
    """Of the vehicle, from whatever origin [m]."""

    @property
    def climbing(self) -> bool:
        """The vehicle is known to go up: it has left the ground."""
        return self.vel_mps is not None and self.vel_mps[2] < -CLIMB_MPS


class PayloadWatch:
    """Tells where the load is, why, and the disturbance force that the vehicle felt before the lift.

    The thrust tells by rises and falls of the mass that it seems to carry (`ApparentMass`) against a level that follows
    slow changes: a curve that is some percent wrong feigns a light load or hides it, a sagging battery looks like one
    that is set down slowly. What it does not tell, the swing may (`SwingMass`), but only that there is a load: one
    that does not swing looks like none.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._mass_kg = parameters.vehicle.mass_kg
        self._payload_mass_kg = parameters.payload.mass_kg
        self._length_m = parameters.cable.length_m
        self._presumed = parameters.thrust.source is ThrustSource.REMARK_1
        self._apparent = ApparentMass(self._mass_kg)
        self._swing = SwingMass(self._mass_kg, self._length_m)
        self._weighing = Weighing(self._mass_kg)
        self.grounded()

    @property
    def mass(self) -> MassEstimate:
        """The load's mass, or why it is not known."""
        return self._weighing.estimate

    @property
    def force_n(self) -> Vec3 | None:
        """Horizontal disturbance while the cable was slack, level frame [N]; None where that was too short to tell."""
        if self._slack_s < FORCE_TIME_CONSTANT_S:
            return None
        return (*self._force_n, 0.0)

    def grounded(self) -> None:
        """The vehicle stands or is disarmed."""
        self.state = PayloadState.ON_GROUND
        self.reason = ""
        """Why the state is what it is, in words."""
        self._stood = False
        self._ground_m: float | None = None
        self._apparent.reset()
        self._swing.reset()
        self._weighing.reset()
        self._level_kg = 0.0
        self._empty_kg = 0.0
        self._hanging_kg = self._payload_mass_kg
        self._attached_s = 0.0
        self._climbed_s = 0.0
        self._sink_mps = 0.0
        self._doubt_s = 0.0
        self._slack_s = 0.0
        self._force_n = (0.0, 0.0)

    def update(self, sample: PayloadSample) -> bool:
        """Take one filter step; return whether the state changed in it."""
        sign = self._look(sample)
        state = TRANSITIONS[self.state].get(sign[0]) if sign is not None else None
        if sign is None or state is None:
            return False
        self._enter(state)
        self.reason = sign[0].value.format(abs(sign[1]))
        return True

    def _look(self, sample: PayloadSample) -> tuple[Sign, float] | None:
        """Return what this step shows, with its mass [kg]."""
        if not sample.thrust_known:
            flies = sample.landed in (LandedState.IN_AIR, LandedState.TAKING_OFF)
            return (Sign.PRESUMED if self._presumed else Sign.UNTOLD, 0.0) if flies else None
        if self.state is PayloadState.ON_GROUND:
            if sample.lift_n >= FLYING_SHARE * self._mass_kg * GRAVITY_MPS2:
                return Sign.FLIES, 0.0
            self._stood, self._ground_m = True, sample.altitude_m
            return None
        if sample.vel_mps is not None:
            blend = sample.dt_s / (sample.dt_s + SINK_TIME_CONSTANT_S)
            self._sink_mps += blend * (sample.vel_mps[2] - self._sink_mps)
        self._swing.update(sample.dt_s, sample.force_n, sample.acc_mps2, sample.body_down)
        if self.state is PayloadState.ATTACHED or self._climbed_s > CLIMBING_S:
            # Before it has climbed, the ground may carry a part of the vehicle.
            self._weighing.update(sample.dt_s, sample.lift_n, sample.acc_mps2[2], sample.vel_mps, self._swing.value())
        return self._fall(sample) if self.state is PayloadState.ATTACHED else self._rise(sample)

    def _seem(self, sample: PayloadSample, time_constant_s: float) -> float:
        """Take the step into the apparent mass; return it [kg]."""
        return self._apparent.update(sample.dt_s, sample.lift_n, sample.acc_mps2[2], time_constant_s)

    def _fall(self, sample: PayloadSample) -> tuple[Sign, float] | None:
        """Whether the load is lost."""
        dt_s = sample.dt_s
        apparent_kg = self._seem(sample, APPARENT_ATTACHED_TIME_CONSTANT_S)
        self._level_kg += dt_s / (dt_s + LEVEL_TIME_CONSTANT_S) * (apparent_kg - self._level_kg)
        fallen_kg = self._level_kg - apparent_kg
        self._attached_s += dt_s
        if self._attached_s < SETTLE_S:
            blend = dt_s / (dt_s + SETTLING_TIME_CONSTANT_S)
            self._hanging_kg += blend * (apparent_kg - self._empty_kg - self._hanging_kg)
            # What a fault feigned just before must not make it so heavy that its fall is never seen.
            least_kg, most_kg = LIFTED_SHARE * self._payload_mass_kg, HANGING_SHARE_MAX * self._payload_mass_kg
            self._hanging_kg = min(max(self._hanging_kg, least_kg), most_kg)
        self._doubt_s = self._doubt_s + dt_s if fallen_kg > LOST_SHARE * self._hanging_kg else 0.0
        if self._doubt_s <= LOST_FOR_S:
            return None
        return (Sign.FALL_LOW if self._is_low(sample) else Sign.FALL), fallen_kg

    def _is_low(self, sample: PayloadSample) -> bool:
        """Whether the load reaches the ground; where its height is not known, whether it went down."""
        if self._ground_m is None or sample.altitude_m is None:
            return self._sink_mps > SINK_MPS
        return sample.altitude_m - self._ground_m < LOW_LENGTHS * self._length_m + LOW_MARGIN_M

    def _rise(self, sample: PayloadSample) -> tuple[Sign, float] | None:
        """Whether the load is lifted, or hangs as it seems."""
        dt_s, climbing = sample.dt_s, sample.climbing
        apparent_kg = self._seem(sample, APPARENT_TIME_CONSTANT_S)
        # On the way up the level without the load is found first; in the air, where it was not seen, it is taken for 0.
        on_the_way_up = climbing or sample.landed in (LandedState.ON_GROUND, LandedState.TAKING_OFF)
        found = self._climbed_s > CLIMBING_S
        level_kg = self._level_kg if found else 0.0
        risen_kg = apparent_kg - level_kg
        lifted = (found or not on_the_way_up) and risen_kg > LIFTED_SHARE * self._payload_mass_kg
        if not lifted and (climbing or found):
            if self._climbed_s == 0.0:
                self._level_kg = apparent_kg
            fast = climbing or self._slack_s < SETTLE_S
            tau_s = SETTLING_TIME_CONSTANT_S if fast else LEVEL_TIME_CONSTANT_S
            self._level_kg += dt_s / (dt_s + tau_s) * (apparent_kg - self._level_kg)
            self._climbed_s += dt_s if climbing else 0.0
        self._doubt_s = self._doubt_s + dt_s if lifted else 0.0
        if self._doubt_s > LIFTED_FOR_S:
            self._empty_kg = level_kg
            return (Sign.RISE if found else Sign.CARRIES), risen_kg
        if not self.state.hangs:
            self._slack_s += dt_s
            if not lifted:
                self._feel(sample)
        shown_kg, std_kg = self._swing.value()
        if shown_kg - 3.0 * std_kg > SWING_SHOWS_SHARE * self._payload_mass_kg:
            self._empty_kg = apparent_kg - shown_kg
            return Sign.SWINGS, shown_kg
        if self._slack_s > SILENT_AFTER_S and not (self._stood and found):
            return Sign.SILENT, 0.0
        return None

    def _feel(self, sample: PayloadSample) -> None:
        """Low-pass the push on the vehicle while nothing hangs."""
        blend = sample.dt_s / (sample.dt_s + FORCE_TIME_CONSTANT_S)
        x, y = self._force_n
        self._force_n = (
            x + blend * (self._mass_kg * sample.acc_mps2[0] - sample.force_n[0] - x),
            y + blend * (self._mass_kg * sample.acc_mps2[1] - sample.force_n[1] - y),
        )

    def _enter(self, state: PayloadState) -> None:
        if state is PayloadState.ATTACHED:
            # The jerk of the lift says nothing of the level with the load.
            self._level_kg = self._empty_kg + self._payload_mass_kg
            self._hanging_kg = self._payload_mass_kg
            self._attached_s = 0.0
            self._weighing.lifted()
        elif not state.hangs:
            lost = self.state is PayloadState.ATTACHED
            self._level_kg = self._apparent.value_kg
            self._climbed_s = 2.0 * CLIMBING_S if lost else 0.0
            self._slack_s = 0.0
            self._weighing.lost()
            self._force_n = (0.0, 0.0)
        self._doubt_s = 0.0
        self._swing.reset()
        self.state = state
