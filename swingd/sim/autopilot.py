"""A PX4-shaped autopilot: arming, modes, OFFBOARD and its loss, take-off, landing, over PX4's control loops.

Behind Copter's face the same loops fly, with GUIDED in the place of OFFBOARD.

Pure: no clock, no I/O. Time passes only through `Autopilot.step`, 4 ms at a time.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum
from math import copysign, exp, hypot, pi, radians, sqrt

from swingd.core.slung_plant import GRAVITY
from swingd.model.events import LandedState, Vec3
from swingd.model.parameters import Parameters
from swingd.sim.cascade import (
    AttitudeControl,
    AttitudeSetpoint,
    HoverThrust,
    PositionControl,
    RateControl,
    TrajectorySetpoint,
    attitude_from_thrust,
    mix,
    yaw_of,
)
from swingd.sim.guided import Guided, GuidedTarget
from swingd.sim.plant import DT_S, YAW_MOMENT_M, Quaternion, Rotors
from swingd.sim.px4_parameters import Px4Parameters
from swingd.sim.sensors import Sensed

_POSITION_STEPS = 2  # the position loop runs at 125 Hz
_ZERO: Vec3 = (0.0, 0.0, 0.0)


class NavState(Enum):
    """What the autopilot is doing; the names are PX4's."""

    MANUAL = "manual"
    POSCTL = "position"
    TAKEOFF = "takeoff"
    LOITER = "hold"
    RTL = "return"
    LAND = "land"
    OFFBOARD = "offboard"
    GUIDED = "guided"
    """Copter's."""
    DESCEND = "descend"
    """Failsafe: sink level, without any horizontal control."""


class Answer(Enum):
    """To a request."""

    ACCEPTED = "accepted"
    REJECTED = "temporarily rejected"
    DENIED = "denied"


class Takeoff(IntEnum):
    """Stage of PX4's smooth take-off."""

    DISARMED = 0
    SPOOLUP = 1
    READY = 2
    RAMPUP = 3
    FLIGHT = 4


# COM_OBL_RC_ACT without a remote control: the modes that need one end in a descent.
_LOSS_ACTION = {
    3: NavState.RTL,
    4: NavState.LAND,
    5: NavState.LOITER,
}
_DESCENT_THRESHOLD_MPS = 0.3
_PUSH_DOWN = TrajectorySetpoint(acc_ned_mps2=(0.0, 0.0, 100.0))
"""Not flying: an acceleration that asks for no thrust."""


class LandDetector:
    """PX4's three stages: ground contact, maybe landed, landed; each must hold a third of LNDMC_TRIG_TIME."""

    def __init__(self) -> None:
        self._held_s = [0.0, 0.0, 0.0]
        self.ground_contact = True
        self.maybe_landed = True
        self.landed = True

    def update(
        self,
        dt_s: float,
        px4: Px4Parameters,
        *,
        armed: bool,
        thrust: float,
        hover_thrust: float,
        hover_thrust_valid: bool,
        descending: bool,
        vel_ned_mps: Vec3,
        rates_frd_radps: Vec3,
    ) -> None:
        """Judge one sample; ``thrust`` is the collective that was commanded, ``descending`` is wanted, not seen."""
        if not armed:
            self.ground_contact = self.maybe_landed = self.landed = True
            return
        thrust_min = px4["MPC_THR_MIN"]
        wider = 2.5 if self.maybe_landed else 1.0
        share = 0.6 if hover_thrust_valid else 0.3
        low = thrust <= thrust_min + (hover_thrust - thrust_min) * share
        contact = (
            low
            and (descending or self.maybe_landed or self.landed)
            and abs(vel_ned_mps[2]) <= px4["LNDMC_Z_VEL_MAX"] * wider
            and hypot(vel_ned_mps[0], vel_ned_mps[1]) <= px4["LNDMC_XY_VEL_MAX"]
        )
        idle = thrust <= thrust_min + (hover_thrust - thrust_min) * 0.1
        still = hypot(rates_frd_radps[0], rates_frd_radps[1]) <= radians(px4["LNDMC_ROT_MAX"]) * wider
        trigger_s = px4["LNDMC_TRIG_TIME"] / 3.0
        self.ground_contact = self._hold(0, self.ground_contact, contact, dt_s, trigger_s)
        self.maybe_landed = self._hold(1, self.maybe_landed, self.ground_contact and idle and still, dt_s, trigger_s)
        self.landed = self._hold(2, self.landed, self.maybe_landed, dt_s, trigger_s)

    def _hold(self, stage: int, was: bool, now: bool, dt_s: float, trigger_s: float) -> bool:
        """Turn true after ``trigger_s``, false at once."""
        self._held_s[stage] = self._held_s[stage] + dt_s if now else 0.0
        return now and (was or self._held_s[stage] >= trigger_s - 1e-9)


class _Smoother:
    """Velocity, acceleration and jerk limited motion of one axis."""

    __slots__ = ("acc", "pos", "vel")

    def __init__(self) -> None:
        self.pos = self.vel = self.acc = 0.0

    def reset(self, pos: float, vel: float) -> None:
        self.pos, self.vel, self.acc = pos, vel, 0.0

    def step(self, dt_s: float, vel_target: float, acc_max: float, jerk_max: float) -> None:
        error = vel_target - self.vel
        size = abs(error)
        # Square root: the acceleration can still be taken back before the target; linear close to it.
        wanted = copysign(min(acc_max, sqrt(2.0 * jerk_max * size), 3.0 * size), error)
        change = jerk_max * dt_s
        self.acc += max(-change, min(change, wanted - self.acc))
        self.vel += self.acc * dt_s
        self.pos += self.vel * dt_s


def _approach_speed(distance: float, acc_max: float, jerk_max: float) -> float:
    """Speed from which one can stop within ``distance``, as PX4 computes it."""
    b = 4.0 * acc_max * acc_max / jerk_max
    return 0.5 * (sqrt(b * b + 8.0 * acc_max * distance) - b)


@dataclass(slots=True)
class _Stream:
    """The stream of external setpoints."""

    last_s: float = float("-inf")
    setpoint: TrajectorySetpoint | AttitudeSetpoint | None = None


class Autopilot:
    """Modes and loops of a PX4 multicopter without a remote control.

    Parameters
    ----------
    parameters : Parameters
        The vehicle that the rate loops are fitted to.
    px4 : Px4Parameters
        PX4's own parameters; changes are taken over at the next step.
    guided : Guided, optional
        Copter's GUIDED mode, which PX4 does not have.
    """

    def __init__(self, parameters: Parameters, px4: Px4Parameters, guided: Guided | None = None) -> None:
        self._px4 = px4
        self._guided = guided
        self._px4_version = px4.version
        self._position = PositionControl(px4)
        self._attitude = AttitudeControl(px4)
        self._rate = RateControl(px4, torque_gain_radps2(parameters), 1.0 / DT_S)
        self._hover = HoverThrust(px4)
        self._land = LandDetector()
        self._offboard = _Stream()
        self._axes = (_Smoother(), _Smoother(), _Smoother())
        self._steps = 0
        self._vel_last: Vec3 | None = None
        self._vel_dot = [0.0, 0.0, 0.0]
        self._takeoff = Takeoff.DISARMED
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._flew = False
        self._ramp = 0.0
        self._rates_thrust = 0.0
        self._tilt_limit_rad = radians(px4["MPC_TILTMAX_LND"])
        self._target: list[float] = [0.0, 0.0, 0.0]
        self._yaw_hold_rad = 0.0
        self._takeoff_height_m: float | None = None
        self._after_takeoff = NavState.LOITER
        self._rates_only: Vec3 | None = None
        self._wanted = NavState.LOITER
        self._needs_entry = True
        self._sensed = Sensed()

        self.armed = False
        self.nav_state = NavState.LOITER
        """What is flown now; a failsafe may differ from what was asked for."""
        self.home_ned_m: Vec3 = _ZERO
        self.setpoint = _PUSH_DOWN
        """What the position loop was told last."""
        self.attitude_sp: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.thrust_sp = 0.0
        """Collective thrust of the attitude setpoint, 0..1."""
        self.attitude_sp_t_s = 0.0
        """Sample that the attitude setpoint belongs to, on the autopilot's clock [s]."""
        self.rates_sp_frd_radps: Vec3 = _ZERO
        self.rotors: Rotors = (0.0, 0.0, 0.0, 0.0)
        """Outputs to the motors, 0..1."""
        self.outputs_t_s = 0.0
        """Sample that the outputs belong to, from which on they act [s]."""

    @property
    def t_s(self) -> float:
        """Time since boot [s]."""
        return self._steps * DT_S

    @property
    def hover_thrust(self) -> float:
        """Thrust that the position loop takes for hover, 0..1."""
        return self._position.hover_thrust

    @property
    def landed(self) -> bool:
        """What the land detector says."""
        return self._land.landed

    @property
    def landed_state(self) -> LandedState:
        """What is published of it."""
        if self._land.landed:
            return LandedState.ON_GROUND
        if self.nav_state is NavState.TAKEOFF:
            return LandedState.TAKING_OFF
        if self.nav_state is NavState.LAND:
            return LandedState.LANDING
        return LandedState.IN_AIR

    @property
    def offboard_available(self) -> bool:
        """Whether the stream of setpoints is fresh enough for OFFBOARD."""
        return self.setpoint_age_s < self._px4["COM_OF_LOSS_T"]

    @property
    def setpoint_age_s(self) -> float:
        """Time since the last external setpoint [s]; infinite before the first."""
        return self.t_s - self._offboard.last_s

    @property
    def failsafe(self) -> bool:
        """Whether what is flown is not what was asked for."""
        return self.nav_state is not self._wanted

    def arm(self) -> Answer:
        """Start the motors."""
        if not self.armed:
            self.armed = True
            self._armed_s = self._landed_s = 0.0
            self._flew = False
            self.home_ned_m = self._sensed.pos_ned_m
            self._needs_entry = True
        return Answer.ACCEPTED

    def disarm(self, *, force: bool = False) -> Answer:
        """Stop the motors; refused in the air unless forced."""
        if self.armed and not (self._land.landed or force):
            return Answer.DENIED
        self._stop()
        return Answer.ACCEPTED

    def request_mode(self, mode: NavState) -> Answer:
        """Change the mode; OFFBOARD needs a fresh stream of setpoints."""
        if mode is NavState.OFFBOARD and not self.offboard_available:
            return Answer.REJECTED
        if mode is NavState.DESCEND or (mode is NavState.GUIDED and self._guided is None):
            return Answer.DENIED
        self._wanted = mode
        self._enter(mode)
        return Answer.ACCEPTED

    def take_off(self, height_m: float | None = None, then: NavState = NavState.LOITER) -> Answer:
        """Climb to a height above home, MIS_TAKEOFF_ALT if None, and hold there in the mode ``then``."""
        self._takeoff_height_m = height_m
        self._after_takeoff = then
        return self.request_mode(NavState.TAKEOFF)

    def reposition(
        self, target_ned_m: tuple[float | None, float | None, float | None], yaw_rad: float | None
    ) -> Answer:
        """Fly to a place and hold there; None keeps an axis."""
        self.request_mode(NavState.LOITER)
        self._begin(self._sensed)
        for i, value in enumerate(target_ned_m):
            if value is not None:
                self._target[i] = value
        if yaw_rad is not None:
            self._yaw_hold_rad = yaw_rad
        return Answer.ACCEPTED

    def offboard_setpoint(self, setpoint: TrajectorySetpoint | AttitudeSetpoint) -> None:
        """Take one external setpoint: it keeps the stream alive, and is flown only while in OFFBOARD."""
        self._offboard.last_s = self.t_s
        if self.nav_state is NavState.OFFBOARD:
            self._offboard.setpoint = setpoint

    def guided_target(self, target: GuidedTarget | AttitudeSetpoint) -> bool:
        """Take one external target; False outside of GUIDED. It ends a take-off that has not come to its end."""
        guided = self._guided
        if guided is None or not self._is_guided:
            return False
        sensed = self._sensed
        yaw = yaw_of(sensed.ned_from_frd)
        if self.nav_state is NavState.TAKEOFF:
            self._enter(NavState.GUIDED)
            self._wanted = NavState.GUIDED
        if self._needs_entry:
            self._begin(sensed)
        if isinstance(target, AttitudeSetpoint):
            guided.tell_attitude(target, self.t_s)
        else:
            guided.tell(target, self.t_s, sensed.pos_ned_m, sensed.vel_ned_mps, yaw)
        return True

    @property
    def _is_guided(self) -> bool:
        return self.nav_state is NavState.GUIDED or (
            self.nav_state is NavState.TAKEOFF and self._after_takeoff is NavState.GUIDED
        )

    def step(self, sensed: Sensed) -> Rotors:
        """Run the loops that are due for one IMU sample and return the motors' outputs.

        From the inside out, as PX4's work queues do: each loop follows the setpoint that the loop around it published
        at an earlier sample, so that a change of the position loop reaches the motors two samples later.
        """
        self._sensed = sensed
        if self._px4.version != self._px4_version:
            self._reload()
        self.outputs_t_s = self.t_s
        if self.armed:
            torque = _ZERO
            if self._takeoff >= Takeoff.RAMPUP:
                torque = self._rate.update(
                    DT_S, sensed.gyro_frd_radps, self.rates_sp_frd_radps, landed=self._land.maybe_landed
                )
            self.rotors, self._rate.saturated = mix(self._rates_thrust, torque)
            yaw_rate = self.setpoint.yaw_rate_radps or 0.0
            self.rates_sp_frd_radps = self._rates_only or self._attitude.update(
                sensed.ned_from_frd, self.attitude_sp, yaw_rate
            )
            self._rates_thrust = self.thrust_sp
        else:
            self.rotors = (0.0, 0.0, 0.0, 0.0)
        if self._steps % _POSITION_STEPS == 0:
            self.attitude_sp_t_s = self.t_s
            self._slow(_POSITION_STEPS * DT_S, sensed)
        self._steps += 1
        return self.rotors

    def _reload(self) -> None:
        """Take over changed parameters."""
        px4 = self._px4
        self._px4_version = px4.version
        for loop in (self._position, self._attitude, self._rate, self._hover):
            loop.load(px4)

    def _stop(self) -> None:
        self.armed = False
        self._takeoff = Takeoff.DISARMED
        self.thrust_sp = self._rates_thrust = 0.0
        self._position.reset_integral()
        self._rate.reset_integral()
        if self._wanted in (NavState.LAND, NavState.TAKEOFF, NavState.RTL):
            self._wanted = NavState.LOITER
            self._enter(NavState.LOITER)

    def _slow(self, dt_s: float, sensed: Sensed) -> None:
        """Modes, land detector and the position loop."""
        px4 = self._px4
        self._differentiate(dt_s, sensed.vel_ned_mps)
        self._land.update(
            dt_s,
            px4,
            armed=self.armed,
            thrust=self.thrust_sp,
            hover_thrust=self._position.hover_thrust,
            hover_thrust_valid=self._hover.valid and self._takeoff is Takeoff.FLIGHT,
            descending=(self.setpoint.vel_ned_mps[2] or 0.0) > _DESCENT_THRESHOLD_MPS,
            vel_ned_mps=sensed.vel_ned_mps,
            rates_frd_radps=sensed.rates_frd_radps,
        )
        self._commander(dt_s)
        if not self.armed:
            self.attitude_sp = attitude_from_thrust(_ZERO, yaw_of(sensed.ned_from_frd))
            return
        setpoint = self._setpoint(dt_s, sensed)
        if isinstance(setpoint, AttitudeSetpoint):
            self._fly_attitude(dt_s, setpoint, sensed)
            return
        self._rates_only = None
        self._smooth_takeoff(dt_s, setpoint, sensed)
        flying = self._takeoff is Takeoff.FLIGHT
        position = self._position
        if not flying:
            if setpoint.acc_ned_mps2[2] is not None:
                setpoint = TrajectorySetpoint(
                    setpoint.pos_ned_m,
                    setpoint.vel_ned_mps,
                    (setpoint.acc_ned_mps2[0], setpoint.acc_ned_mps2[1], None),
                    setpoint.yaw_rad,
                    setpoint.yaw_rate_radps,
                )
            position.hover_thrust = px4["MPC_THR_HOVER"]
            self._hover.reset(px4["MPC_THR_HOVER"])
        elif px4["MPC_USE_HTE"] and not self._land.landed:
            self._hover.update(dt_s, sensed.acc_up_mps2, -position.thrust_sp[2])
            if self._hover.valid:
                position.update_hover_thrust(self._hover.value)
        self.setpoint = setpoint
        if self._takeoff < Takeoff.RAMPUP or (flying and self._land.ground_contact):
            setpoint = _PUSH_DOWN
            position.reset_integral()
        vel_dot = (self._vel_dot[0], self._vel_dot[1], self._vel_dot[2])
        if not position.update(dt_s, sensed.pos_ned_m, sensed.vel_ned_mps, vel_dot, setpoint):
            # PX4's answer to a setpoint that cannot be flown: stop.
            stop = TrajectorySetpoint(vel_ned_mps=_ZERO)
            position.update(dt_s, sensed.pos_ned_m, sensed.vel_ned_mps, vel_dot, stop)
        yaw = setpoint.yaw_rad
        if yaw is None:
            yaw = yaw_of(sensed.ned_from_frd)
        n, e, d = position.thrust_sp
        self.thrust_sp = sqrt(n * n + e * e + d * d)
        self.attitude_sp = attitude_from_thrust(position.thrust_sp, yaw)

    def _fly_attitude(self, dt_s: float, wanted: AttitudeSetpoint, sensed: Sensed) -> None:
        """Pass an attitude or body rates on; the thrust is given, or holds a climb rate."""
        px4, position = self._px4, self._position
        asks = wanted.thrust is not None or wanted.climb_mps > 0.0
        if self._armed_s >= px4["COM_SPOOLUP_TIME"] and (asks or not self._land.landed):
            self._takeoff = Takeoff.FLIGHT
        if self._takeoff is not Takeoff.FLIGHT:
            self._rates_only = None
            self.thrust_sp = 0.0
            return
        position.thrust_min = px4["MPC_THR_MIN"]
        position.speed_up_max_mps = px4["MPC_Z_VEL_MAX_UP"]
        down_mps = None if wanted.thrust is not None else -wanted.climb_mps
        self.setpoint = TrajectorySetpoint(
            vel_ned_mps=(None, None, down_mps), yaw_rate_radps=wanted.rates_frd_radps[2] or None
        )
        if wanted.thrust is not None:
            position.reset_integral()
            self.thrust_sp = max(0.0, min(1.0, wanted.thrust))
        else:
            climb = TrajectorySetpoint(vel_ned_mps=(None, None, down_mps), acc_ned_mps2=(0.0, 0.0, None))
            position.update(dt_s, sensed.pos_ned_m, sensed.vel_ned_mps, (0.0, 0.0, self._vel_dot[2]), climb)
            _, x, y, _ = sensed.ned_from_frd
            upright = 1.0 - 2.0 * (x * x + y * y)
            self.thrust_sp = min(1.0, -position.thrust_sp[2] / max(upright, 0.5))
        if wanted.ned_from_frd is not None:
            self.attitude_sp = wanted.ned_from_frd
            self._rates_only = None
        else:
            self.attitude_sp = sensed.ned_from_frd
            self._rates_only = wanted.rates_frd_radps

    def _differentiate(self, dt_s: float, vel: Vec3) -> None:
        """Low-passed derivative of the velocity, for the D term (MPC_VELD_LP)."""
        if self._vel_last is not None:
            alpha = 1.0 - exp(-2.0 * pi * self._px4["MPC_VELD_LP"] * dt_s)
            for i in range(3):
                derivative = (vel[i] - self._vel_last[i]) / dt_s
                self._vel_dot[i] += alpha * (derivative - self._vel_dot[i])
        self._vel_last = vel

    def _commander(self, dt_s: float) -> None:
        """Failsafe on loss of OFFBOARD, ends of modes, disarming."""
        if self._wanted is NavState.OFFBOARD:
            if self.offboard_available:
                flown = NavState.OFFBOARD
            else:
                flown = _LOSS_ACTION.get(int(self._px4["COM_OBL_RC_ACT"]), NavState.DESCEND)
            if self.armed and flown is not self.nav_state:
                self._enter(flown)
        if not self.armed:
            return
        self._armed_s += dt_s
        self._flew = self._flew or not self._land.landed
        self._landed_s = self._landed_s + dt_s if self._land.landed else 0.0
        wait_s = self._px4["COM_DISARM_LAND" if self._flew else "COM_DISARM_PRFLT"]
        if wait_s > 0.0 and self._landed_s > wait_s:
            self._stop()
            return
        if self.nav_state is NavState.TAKEOFF and self._takeoff is Takeoff.FLIGHT:
            if abs(self._sensed.pos_ned_m[2] - self._target[2]) < self._px4["NAV_MC_ALT_RAD"]:
                # The mode ends, its target stays.
                self._wanted = self.nav_state = self._after_takeoff
                if self._guided is not None and self.nav_state is NavState.GUIDED:
                    self._hand_over(self._guided)
        elif self.nav_state is NavState.RTL:
            self._return()

    def _return(self) -> None:
        """Climb, fly home, land."""
        pos = self._sensed.pos_ned_m
        home = self.home_ned_m
        away = hypot(home[0] - pos[0], home[1] - pos[1])
        if away < 1.0:
            self._wanted = NavState.LAND if self._wanted is NavState.RTL else self._wanted
            self._enter(NavState.LAND)
        elif abs(self._target[2] - pos[2]) < self._px4["NAV_MC_ALT_RAD"]:
            self._target[0], self._target[1] = home[0], home[1]

    def _hand_over(self, guided: Guided) -> None:
        """Let GUIDED finish a take-off."""
        north, east, down = self._axes
        pos, vel = (north.pos, east.pos, down.pos), (north.vel, east.vel, down.vel)
        yaw = self._yaw_hold_rad
        guided.start(pos, vel, yaw)
        target = (self._target[0], self._target[1], self._target[2])
        guided.tell(GuidedTarget(pos_ned_m=target, yaw_rad=yaw), self.t_s, pos, vel, yaw)

    def _enter(self, mode: NavState) -> None:
        """Begin a mode at the present state."""
        self.nav_state = mode
        self._offboard.setpoint = None
        self._needs_entry = True

    def _begin(self, sensed: Sensed) -> None:
        """Set the targets of the mode that begins now."""
        px4 = self._px4
        self._needs_entry = False
        pos, vel = sensed.pos_ned_m, sensed.vel_ned_mps
        for i in range(3):
            self._axes[i].reset(pos[i], vel[i] if not self._land.landed else 0.0)
        brake = 0.5 * hypot(vel[0], vel[1]) / px4["MPC_ACC_HOR"] + px4["MPC_ACC_HOR"] / px4["MPC_JERK_AUTO"] * 0.5
        moving = hypot(vel[0], vel[1]) > 0.3
        self._target[0] = pos[0] + (vel[0] * brake if moving else 0.0)
        self._target[1] = pos[1] + (vel[1] * brake if moving else 0.0)
        self._target[2] = pos[2] + 0.5 * vel[2] * abs(vel[2]) / px4["MPC_ACC_DOWN_MAX"]
        self._yaw_hold_rad = yaw_of(sensed.ned_from_frd)
        if self._guided is not None and self.nav_state is NavState.GUIDED:
            self._guided.start(pos, vel if not self._land.landed else _ZERO, self._yaw_hold_rad)
        if self.nav_state is NavState.TAKEOFF:
            height = self._takeoff_height_m
            self._target[2] = self.home_ned_m[2] - (px4["MIS_TAKEOFF_ALT"] if height is None else height)
        elif self.nav_state is NavState.RTL:
            far = hypot(self.home_ned_m[0] - pos[0], self.home_ned_m[1] - pos[1]) > 10.0
            if far:
                self._target[2] = min(pos[2], self.home_ned_m[2] - px4["RTL_RETURN_ALT"])

    def _setpoint(self, dt_s: float, sensed: Sensed) -> TrajectorySetpoint | AttitudeSetpoint:
        """What the present mode asks of the position loop."""
        px4 = self._px4
        if self._needs_entry:
            self._begin(sensed)
        if self.nav_state is NavState.OFFBOARD:
            return self._offboard.setpoint or TrajectorySetpoint(vel_ned_mps=_ZERO)
        if self._guided is not None and self.nav_state is NavState.GUIDED:
            return self._guided_setpoint(self._guided, dt_s, sensed)
        if self.nav_state is NavState.DESCEND:
            return TrajectorySetpoint(vel_ned_mps=(None, None, px4["MPC_LAND_SPEED"]), acc_ned_mps2=(0.0, 0.0, None))
        axes, target = self._axes, self._target
        acc_max, jerk = px4["MPC_ACC_HOR"], px4["MPC_JERK_AUTO"]
        away_d = target[2] - axes[2].pos
        limit = px4["MPC_Z_V_AUTO_DN"] if away_d > 0.0 else px4["MPC_Z_V_AUTO_UP"]
        if self.nav_state is NavState.TAKEOFF:
            limit = min(limit, px4["MPC_TKO_SPEED"])
        if self._takeoff < Takeoff.FLIGHT:
            # The ramp ends at this speed, and the motion goes on from it.
            for i in range(3):
                axes[i].reset(sensed.pos_ned_m[i], copysign(limit, away_d) if i == 2 else 0.0)
        away_n, away_e = target[0] - axes[0].pos, target[1] - axes[1].pos
        away = hypot(away_n, away_e)
        speed = min(px4["MPC_XY_CRUISE"], _approach_speed(away, acc_max, jerk), away * px4["MPC_XY_P"] * 2.0)
        scale = speed / away if away > 1e-6 else 0.0
        axes[0].step(dt_s, away_n * scale, acc_max, jerk)
        axes[1].step(dt_s, away_e * scale, acc_max, jerk)
        if self.nav_state is NavState.LAND:
            down = self._land_speed(sensed.pos_ned_m[2])
            axes[2].step(dt_s, down, px4["MPC_ACC_DOWN_MAX"], jerk)
            # On the ground the setpoint must not run away below it.
            axes[2].pos = min(axes[2].pos, sensed.pos_ned_m[2] + 2.0)
            return TrajectorySetpoint(
                (axes[0].pos, axes[1].pos, None),
                (axes[0].vel, axes[1].vel, axes[2].vel),
                (axes[0].acc, axes[1].acc, axes[2].acc),
                self._yaw_hold_rad,
            )
        acc_max = px4["MPC_ACC_DOWN_MAX"] if away_d > 0.0 else px4["MPC_ACC_UP_MAX"]
        speed = min(limit, _approach_speed(abs(away_d), acc_max, jerk), abs(away_d) * 2.0)
        axes[2].step(dt_s, copysign(speed, away_d), acc_max, jerk)
        if self._takeoff < Takeoff.FLIGHT:
            return TrajectorySetpoint(
                (axes[0].pos, axes[1].pos, None), (0.0, 0.0, copysign(limit, away_d)), yaw_rad=self._yaw_hold_rad
            )
        return TrajectorySetpoint(
            (axes[0].pos, axes[1].pos, axes[2].pos),
            (axes[0].vel, axes[1].vel, axes[2].vel),
            (axes[0].acc, axes[1].acc, axes[2].acc),
            self._yaw_hold_rad,
        )

    def _guided_setpoint(self, guided: Guided, dt_s: float, sensed: Sensed) -> TrajectorySetpoint | AttitudeSetpoint:
        """What GUIDED asks for; on the ground only an attitude that climbs is followed."""
        yaw = yaw_of(sensed.ned_from_frd)
        attitude = guided.attitude(self.t_s, yaw)
        if attitude is not None:
            return attitude
        if self._land.landed:
            guided.start(sensed.pos_ned_m, _ZERO, yaw)
        return guided.step(dt_s, self.t_s)

    def _land_speed(self, down_m: float) -> float:
        """Descent speed over the height above home: slower near the ground."""
        px4 = self._px4
        low, high = px4["MPC_LAND_ALT2"], px4["MPC_LAND_ALT1"]
        height = self.home_ned_m[2] - down_m
        share = 1.0 if high <= low else max(0.0, min(1.0, (height - low) / (high - low)))
        return px4["MPC_LAND_SPEED"] + share * (px4["MPC_Z_V_AUTO_DN"] - px4["MPC_LAND_SPEED"])

    def _smooth_takeoff(self, dt_s: float, setpoint: TrajectorySetpoint, sensed: Sensed) -> None:
        """PX4's take-off: spool up, then ramp the climb limit from 'no thrust' to the wanted speed."""
        px4, position = self._px4, self._position
        up = px4["MPC_TKO_SPEED"] if self.nav_state is NavState.TAKEOFF else px4["MPC_Z_VEL_MAX_UP"]
        if self._takeoff is Takeoff.DISARMED:
            self._takeoff = Takeoff.SPOOLUP
        if self._takeoff is Takeoff.SPOOLUP and self._armed_s >= px4["COM_SPOOLUP_TIME"]:
            self._takeoff = Takeoff.READY
        if self._takeoff is Takeoff.READY and self._wants_takeoff(setpoint, sensed.pos_ned_m[2]):
            self._takeoff = Takeoff.RAMPUP
            self._ramp = 0.0
        elif self._land.landed and (
            self._takeoff is Takeoff.FLIGHT or (self._takeoff is Takeoff.RAMPUP and self.nav_state is NavState.GUIDED)
        ):
            self._takeoff = Takeoff.READY
        initial = -GRAVITY / px4["MPC_Z_VEL_P_ACC"]
        speed_up = up
        if self._takeoff is Takeoff.RAMPUP:
            ramp_s = px4["MPC_TKO_RAMP_T"]
            self._ramp = self._ramp + dt_s / ramp_s if ramp_s > dt_s else 1.0
            speed_up = initial + min(self._ramp, 1.0) * (up - initial)
            if self._ramp >= 1.0:
                self._takeoff = Takeoff.FLIGHT
        elif self._takeoff < Takeoff.RAMPUP:
            speed_up = initial
        flying = self._takeoff is Takeoff.FLIGHT
        position.speed_up_max_mps = speed_up
        position.thrust_min = px4["MPC_THR_MIN"] if flying else 0.0
        wanted = radians(px4["MPC_TILTMAX_AIR"] if flying else px4["MPC_TILTMAX_LND"])
        slew = 0.2 * dt_s
        self._tilt_limit_rad += max(-slew, min(slew, wanted - self._tilt_limit_rad))
        position.tilt_max_rad = self._tilt_limit_rad

    def _wants_takeoff(self, setpoint: TrajectorySetpoint, down_m: float) -> bool:
        """Whether the mode wants to leave the ground."""
        if self.nav_state is NavState.TAKEOFF:
            return True
        if self.nav_state is NavState.OFFBOARD:
            p, v, a = setpoint.pos_ned_m[2], setpoint.vel_ned_mps[2], setpoint.acc_ned_mps2[2]
            return (p is not None and p < down_m) or (v is not None and v < 0.0) or (a is not None and a < 0.0)
        return self.nav_state is NavState.LOITER and self._target[2] < down_m - 0.5


def torque_gain_radps2(parameters: Parameters) -> Vec3:
    """Angular acceleration that full torque of PX4's mixer gives the vehicle near hover, about each body axis."""
    thrust, simulation = parameters.thrust, parameters.simulation
    weight = parameters.vehicle.mass_kg * GRAVITY
    a, b, c = thrust.quadratic_n, thrust.linear_n, thrust.offset_n
    if abs(a) > 1e-9:
        x = (-b + sqrt(max(b * b - 4.0 * a * (c - weight), 0.0))) / (2.0 * a)
    else:
        x = (weight - c) / b if b else 0.5
    slope = (2.0 * a * max(0.0, min(1.0, x)) + b) / 4.0
    offset = simulation.arm_m / sqrt(2.0)
    lean = 4.0 * sqrt(0.5) * offset * slope
    inertia = simulation.vehicle_inertia_kg_m2
    return (lean / inertia[0], lean / inertia[1], 4.0 * YAW_MOMENT_M * slope / inertia[2])
