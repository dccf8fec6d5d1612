"""Whether the load hangs on the cable, as far as the thrust tells."""

from enum import Enum

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import LandedState
from swingd.model.parameters import Parameters, ThrustSource

LIFTED_SHARE = 0.5
"""Share of the load's weight by which the thrust must rise to count as lifting it."""
LIFTED_FOR_S = 0.15
SLACK_SHARE = 0.6
"""Share of the load's weight by which the thrust must fall to count as having lost it: released, set down."""
SLACK_FOR_S = 0.4
SUPPORT_TIME_CONSTANT_S = 0.1
SUPPORT_ATTACHED_TIME_CONSTANT_S = 0.3
"""Slower while the load hangs: a manoeuvre must not look like a release."""
LEVEL_TIME_CONSTANT_S = 5.0
"""Of the level against which a loss is judged: the thrust curve's error drifts with the battery."""
CLIMBING_S = 0.4
"""Of climbing with a slack cable, to know what the thrust curve's error feigns."""
ASSUMED_AFTER_S = 5.0
"""In the air for this long without a rise, which a take-off that was not watched does not show, the load may hang."""
FLYING_SHARE = 0.6
"""Share of the vehicle's weight that the thrust must carry to count as flying."""
FORCE_TIME_CONSTANT_S = 0.5


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


class PayloadWatch:
    """Tells when the load is lifted or lost, and the disturbance force that the vehicle felt before the lift."""

    def __init__(self, parameters: Parameters) -> None:
        self._mass_kg = parameters.vehicle.mass_kg
        self._payload_mass_kg = parameters.payload.mass_kg
        self._presumed = parameters.thrust.source is ThrustSource.REMARK_1
        self.grounded()

    @property
    def force_n(self) -> tuple[float, float, float] | None:
        """Horizontal disturbance while the cable was slack, level frame [N]; None where that was too short to tell."""
        if self._slack_s < FORCE_TIME_CONSTANT_S:
            return None
        return (*self._force_n, 0.0)

    def grounded(self) -> None:
        """The vehicle stands or is disarmed."""
        self.state = PayloadState.ON_GROUND
        self._was_attached = False
        self._support_n = 0.0
        self._level_n: float | None = None
        self._climbed_s = 0.0
        self._doubt_s = 0.0
        self._slack_s = 0.0
        self._force_n = (0.0, 0.0)

    def update(
        self,
        dt_s: float,
        force_n: tuple[float, float, float],
        acc_level: tuple[float, float, float],
        known: bool,
        landed: LandedState,
        climbing: bool,
    ) -> bool:
        """Take one filter step; return whether the state changed in it.

        Parameters
        ----------
        dt_s : float
            Interval [s].
        force_n : (3,)
            Thrust and known drag, level frame [N].
        acc_level : (3,)
            Inertial acceleration, level frame [m/s^2].
        known : bool
            The thrust comes from a stream, not from Remark 1, which presumes a hanging load.
        landed : LandedState
            What the autopilot's land detector says.
        climbing : bool
            The vehicle is known to go up: it has left the ground.
        """
        if not known:
            return self._without_thrust(landed)
        if self.state is PayloadState.ON_GROUND:
            if -force_n[2] < FLYING_SHARE * self._mass_kg * GRAVITY_MPS2:
                return False
            return self._become(PayloadState.SLACK)
        # What holds the vehicle down besides its own weight. A thrust curve that is some percent wrong feigns a light
        # load, or hides it: only rises and falls tell.
        support_n = self._mass_kg * (acc_level[2] - GRAVITY_MPS2) - force_n[2]
        attached = self.state is PayloadState.ATTACHED
        tau_s = SUPPORT_ATTACHED_TIME_CONSTANT_S if attached else SUPPORT_TIME_CONSTANT_S
        self._support_n += dt_s / (dt_s + tau_s) * (support_n - self._support_n)
        weight_n = self._payload_mass_kg * GRAVITY_MPS2
        if attached and self._level_n is not None:
            self._level_n += dt_s / (dt_s + LEVEL_TIME_CONSTANT_S) * (self._support_n - self._level_n)
            lost = self._support_n < self._level_n - SLACK_SHARE * weight_n
            self._doubt_s = self._doubt_s + dt_s if lost else 0.0
            return self._doubt_s > SLACK_FOR_S and self._become(PayloadState.SLACK)
        # On the way up the level without the load is found first; in the air, where it was not seen, it is taken for 0.
        on_the_way_up = climbing or landed in (LandedState.ON_GROUND, LandedState.TAKING_OFF)
        judged = self._climbed_s > CLIMBING_S or not on_the_way_up
        lifted = judged and self._support_n > self._slack_level_n() + LIFTED_SHARE * weight_n
        if climbing and not lifted:
            self._climbed_s += dt_s
            before_n = self._support_n if self._level_n is None else self._level_n
            self._level_n = before_n + dt_s / (dt_s + FORCE_TIME_CONSTANT_S) * (self._support_n - before_n)
        self._doubt_s = self._doubt_s + dt_s if lifted else 0.0
        if self._doubt_s > LIFTED_FOR_S:
            return self._become(PayloadState.ATTACHED)
        if self.state is PayloadState.SLACK:
            self._slack_s += dt_s
            if not lifted:
                blend = dt_s / (dt_s + FORCE_TIME_CONSTANT_S)
                x, y = self._force_n
                self._force_n = (
                    x + blend * (self._mass_kg * acc_level[0] - force_n[0] - x),
                    y + blend * (self._mass_kg * acc_level[1] - force_n[1] - y),
                )
            if self._slack_s > ASSUMED_AFTER_S and not self._was_attached:
                return self._become(PayloadState.UNKNOWN)
        return False

    def _without_thrust(self, landed: LandedState) -> bool:
        """Only the land detector tells; the load is known to hang where the configuration presumes it."""
        if self.state is not PayloadState.ON_GROUND or landed not in (LandedState.IN_AIR, LandedState.TAKING_OFF):
            return False
        return self._become(PayloadState.ATTACHED if self._presumed else PayloadState.UNKNOWN)

    def _slack_level_n(self) -> float:
        """What the thrust curve's error feigns without the load; 0 where that was not seen."""
        return self._level_n if self._level_n is not None and self._climbed_s > CLIMBING_S else 0.0

    def _become(self, state: PayloadState) -> bool:
        weight_n = self._payload_mass_kg * GRAVITY_MPS2
        if state is PayloadState.ATTACHED:
            # The jerk of the lift says nothing of the level with the load.
            self._level_n = self._slack_level_n() + weight_n
        elif state is PayloadState.SLACK:
            lost = self.state is PayloadState.ATTACHED and self._level_n is not None
            self._level_n = self._level_n - weight_n if lost and self._level_n is not None else None
            self._climbed_s = 2.0 * CLIMBING_S if lost else 0.0
            self._slack_s = 0.0
            self._force_n = (0.0, 0.0)
        self._was_attached |= state is PayloadState.ATTACHED
        self._doubt_s = 0.0
        self.state = state
        return True
