"""What the vehicle is asked to do before any correction."""

from swingd.model.events import AppSetpoint, AutopilotKind, FlightMode, LocalPosition, SetpointUse, Vec3
from swingd.model.parameters import Hold
from swingd.pipeline.merge import Reference
from swingd.pipeline.sampling import wrap_pi

POSITION_AGE_MAX_S = 0.5
"""An altitude older than this is not taken as the one to hold."""
ALTITUDE_P_PER_S = 1.0
"""Climb towards the held altitude over the distance to it, for an autopilot that takes no altitude with a velocity."""
ALTITUDE_SPEED_MAX_MPS = 0.5
_ZERO: Vec3 = (0.0, 0.0, 0.0)


class HoldReference:
    """A reference velocity, with the altitude and the heading of OFFBOARD's beginning."""

    def __init__(self, hold: Hold) -> None:
        self.configure(hold)
        self._set: AppSetpoint | None = None
        self._pos: LocalPosition | None = None
        self._altitude_d_m: float | None = None
        self._yaw_rad: float | None = None
        self._offboard = False
        self.refused = 0
        """References from outside that are not a plain velocity."""

    def configure(self, hold: Hold) -> None:
        """Take other parameters; what was set stays."""
        self._hold = hold

    def restarted(self) -> None:
        """The autopilot restarted: its positions mean nothing any more."""
        self._pos = None

    def add_position(self, position: LocalPosition) -> None:
        """Take the vehicle's position."""
        self._pos = position

    def set(self, setpoint: AppSetpoint) -> bool:
        """Take a reference from outside; return whether it was taken: it must give at least a horizontal velocity."""
        horizontal = SetpointUse.VEL_N | SetpointUse.VEL_E
        if setpoint.use & horizontal != horizontal or setpoint.use & (SetpointUse.POS | SetpointUse.ACC):
            self.refused += 1
            return False
        self._set = setpoint
        return True

    @property
    def yaw_rad(self) -> float | None:
        """The heading that is kept; None before the first reference."""
        return self._yaw_rad

    def follow(self) -> None:
        """The vehicle is led by something else: what is held from then on is the altitude where that ends."""
        if self._pos is not None:
            self._altitude_d_m = self._pos.pos_ned_m[2]

    def turn(self, yaw_jump_rad: float) -> None:
        """The autopilot's yaw was reset: keep the nose where it is."""
        if self._yaw_rad is not None:
            self._yaw_rad = wrap_pi(self._yaw_rad + yaw_jump_rad)

    def at(self, t_mono_s: float, mode: FlightMode, yaw_rad: float, kind: AutopilotKind) -> Reference:
        """Return the reference of this instant."""
        if self._set is not None and t_mono_s - self._set.t_mono_s > self._hold.setpoint_timeout_s:
            self._set = None
        known = self._pos
        fresh = known is not None and t_mono_s - known.t_mono_s < POSITION_AGE_MAX_S
        down_m = known.pos_ned_m[2] if known is not None and fresh else None
        offboard = mode is FlightMode.OFFBOARD
        if not offboard or not self._offboard:
            # Outside of OFFBOARD the stream follows the vehicle, so that entering it changes nothing.
            self._altitude_d_m = down_m
            self._yaw_rad = yaw_rad
        self._offboard = offboard
        vel = self._hold.vel_ned_mps
        if self._set is not None:
            given = self._set
            down = given.vel_ned_mps[2] if given.use & SetpointUse.VEL_D else 0.0
            vel = (given.vel_ned_mps[0], given.vel_ned_mps[1], down)
            if given.use & SetpointUse.YAW:
                self._yaw_rad = given.yaw_rad
        use = SetpointUse.VEL_N | SetpointUse.VEL_E | SetpointUse.YAW
        pos = _ZERO
        if not (self._hold.hold_altitude and vel[2] == 0.0 and self._altitude_d_m is not None):
            use |= SetpointUse.VEL_D
            self._altitude_d_m = down_m
        elif kind is AutopilotKind.ARDUPILOT:
            use |= SetpointUse.VEL_D
            climb = 0.0 if down_m is None else ALTITUDE_P_PER_S * (self._altitude_d_m - down_m)
            vel = (vel[0], vel[1], max(-ALTITUDE_SPEED_MAX_MPS, min(ALTITUDE_SPEED_MAX_MPS, climb)))
        else:
            use |= SetpointUse.POS_D
            pos = (0.0, 0.0, self._altitude_d_m)
        return Reference(use, pos, vel, yaw_rad=self._yaw_rad if self._yaw_rad is not None else yaw_rad)
