"""Whether the load hangs on the cable, as far as the thrust tells."""

from enum import Enum

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import LandedState
from swingd.model.parameters import Parameters

LIFTED_SHARE = 0.5
"""Share of the load's weight that the cable must carry to count as lifted."""
LIFTED_FOR_S = 0.15
SUPPORT_TIME_CONSTANT_S = 0.1
ASSUMED_AFTER_S = 5.0
"""A thrust curve that is 15 % low never shows the load; in the air for this long, it is taken to hang."""
FLYING_SHARE = 0.6
"""Share of the vehicle's weight that the thrust must carry to count as flying."""
FORCE_TIME_CONSTANT_S = 0.5


class PayloadState(Enum):
    """Where the load is."""

    ON_GROUND = "on ground"
    """The vehicle stands, or nothing is known yet."""
    LIFTING = "lifting"
    """The vehicle flies; the cable is not taut yet."""
    ATTACHED = "attached"


class PayloadWatch:
    """Tells when the load is lifted, and the disturbance force that the vehicle felt before."""

    def __init__(self, parameters: Parameters) -> None:
        self._mass_kg = parameters.vehicle.mass_kg
        self._payload_mass_kg = parameters.payload.mass_kg
        self.state = PayloadState.ON_GROUND
        self._support_n = 0.0
        self._carried_s = 0.0
        self._lifting_s = 0.0
        self._force_n = (0.0, 0.0)

    @property
    def force_n(self) -> tuple[float, float, float] | None:
        """Horizontal disturbance while the cable was slack, level frame [N]; None where that was too short to tell."""
        if self._lifting_s < FORCE_TIME_CONSTANT_S:
            return None
        return (*self._force_n, 0.0)

    def grounded(self) -> None:
        """The vehicle stands or is disarmed."""
        self.state = PayloadState.ON_GROUND
        self._support_n = self._carried_s = self._lifting_s = 0.0
        self._force_n = (0.0, 0.0)

    def update(
        self,
        dt_s: float,
        force_n: tuple[float, float, float],
        acc_level: tuple[float, float, float],
        known: bool,
        landed: LandedState,
    ) -> bool:
        """Take one filter step; return whether the load was lifted in it.

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
        """
        if self.state is PayloadState.ATTACHED:
            return False
        if self.state is PayloadState.ON_GROUND:
            if known and -force_n[2] < FLYING_SHARE * self._mass_kg * GRAVITY_MPS2:
                return False
            if not known and landed is LandedState.ON_GROUND:
                return False
            self.state = PayloadState.LIFTING
            return False
        self._lifting_s += dt_s
        # What holds the vehicle down besides its own weight.
        support_n = self._mass_kg * (acc_level[2] - GRAVITY_MPS2) - force_n[2]
        self._support_n += dt_s / (dt_s + SUPPORT_TIME_CONSTANT_S) * (support_n - self._support_n)
        lifted = self._support_n > LIFTED_SHARE * self._payload_mass_kg * GRAVITY_MPS2
        self._carried_s = self._carried_s + dt_s if lifted else 0.0
        if not lifted:
            blend = dt_s / (dt_s + FORCE_TIME_CONSTANT_S)
            x, y = self._force_n
            self._force_n = (
                x + blend * (self._mass_kg * acc_level[0] - force_n[0] - x),
                y + blend * (self._mass_kg * acc_level[1] - force_n[1] - y),
            )
        if not known or self._carried_s > LIFTED_FOR_S or self._lifting_s > ASSUMED_AFTER_S:
            self.state = PayloadState.ATTACHED
            return True
        return False
