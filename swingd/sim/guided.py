"""Copter's GUIDED mode: targets are approached within acceleration and jerk, and forgotten when they stop coming."""

from dataclasses import dataclass
from math import atan2, copysign, hypot, pi, radians, sqrt

from swingd.model.events import Vec3
from swingd.sim.cascade import AttitudeSetpoint, TrajectorySetpoint, attitude_from_thrust
from swingd.sim.copter_parameters import CopterParameters

_ZERO: Vec3 = (0.0, 0.0, 0.0)
_YAW_SLEW_RADPS = radians(60.0)
_YAW_FOLLOWS_ABOVE = 0.05  # of WPNAV_SPEED


@dataclass(frozen=True, slots=True)
class GuidedTarget:
    """What GUIDED was told, local ned; nothing at all means to stop here and now."""

    pos_ned_m: Vec3 | None = None
    vel_ned_mps: Vec3 | None = None
    acc_ned_mps2: Vec3 | None = None
    yaw_rad: float | None = None
    yaw_rate_radps: float | None = None
    yaw_is_relative: bool = False
    """``yaw_rad`` counts from the heading that is being flown."""

    @property
    def kind(self) -> tuple[bool, bool, bool]:
        """Which groups it has; each kind is a submode of its own."""
        moves = self.vel_ned_mps is not None
        return (self.pos_ned_m is not None, moves, not moves and self.acc_ned_mps2 is not None)


class Guided:
    """Copter's submodes position, velocity, acceleration, path and angle.

    Parameters
    ----------
    parameters : CopterParameters
        Limits and GUID_TIMEOUT; changes are taken over at the next step.

    Notes
    -----
    What is flown is a state of its own (`pos_ned_m`, `vel_ned_mps`, `acc_ned_mps2`) that follows the target by nested
    square-root laws: distance to velocity, velocity to acceleration, acceleration within the jerk. Between two messages
    a path or velocity target moves on by its own derivatives.
    """

    def __init__(self, parameters: CopterParameters) -> None:
        self._parameters = parameters
        self._target = GuidedTarget()
        self._attitude: AttitudeSetpoint | None = None
        self._target_pos = [0.0, 0.0, 0.0]
        self._target_vel = [0.0, 0.0, 0.0]
        self._told_s = float("-inf")
        self._yaw_rad = 0.0
        self._yaw_goal_rad = 0.0
        self._yaw_rate_radps = 0.0
        self._yaw_follows = False
        self.pos_ned_m = [0.0, 0.0, 0.0]
        """Position that is flown now."""
        self.vel_ned_mps = [0.0, 0.0, 0.0]
        """Its derivative."""
        self.acc_ned_mps2 = [0.0, 0.0, 0.0]
        """Its second derivative."""

    def start(self, pos_ned_m: Vec3, vel_ned_mps: Vec3, yaw_rad: float) -> None:
        """Begin at a state and stop there."""
        self.acc_ned_mps2 = [0.0, 0.0, 0.0]
        self._restart(pos_ned_m, vel_ned_mps, yaw_rad)

    def tell(self, target: GuidedTarget, t_s: float, pos_ned_m: Vec3, vel_ned_mps: Vec3, yaw_rad: float) -> None:
        """Take a target at time ``t_s``; another kind than before begins at the vehicle's state."""
        if target.kind != self._target.kind or self._attitude is not None:
            self._restart(pos_ned_m, vel_ned_mps, self._yaw_rad if self._attitude is None else yaw_rad)
        if target.kind == (False, False, False):
            return
        self._target = target
        self._told_s = t_s
        self._target_pos = list(target.pos_ned_m or _ZERO)
        self._target_vel = list(target.vel_ned_mps or _ZERO)
        self._yaw_follows = target.yaw_rad is None and target.yaw_rate_radps is None
        self._yaw_rate_radps = 0.0 if target.yaw_is_relative else target.yaw_rate_radps or 0.0
        if target.yaw_rad is not None:
            self._yaw_goal_rad = target.yaw_rad + (self._yaw_rad if target.yaw_is_relative else 0.0)
        else:
            self._yaw_goal_rad = self._yaw_rad

    def tell_attitude(self, setpoint: AttitudeSetpoint, t_s: float) -> None:
        """Take an attitude with a climb rate or a thrust at time ``t_s``."""
        self._attitude = setpoint
        self._told_s = t_s

    def attitude(self, t_s: float, yaw_rad: float) -> AttitudeSetpoint | None:
        """Attitude that is flown instead of a position, if one was told last; level and no climb after the timeout."""
        if self._attitude is not None and self._is_stale(t_s):
            self._attitude = AttitudeSetpoint(attitude_from_thrust((0.0, 0.0, -1.0), yaw_rad))
            self._told_s = float("inf")
        return self._attitude

    def step(self, dt_s: float, t_s: float) -> TrajectorySetpoint:
        """Move on by one interval and give what the position loop follows."""
        target = self._target
        acc = target.acc_ned_mps2 or _ZERO
        is_place = target.kind == (True, False, False)
        accelerates = target.kind == (False, False, True)
        if self._is_stale(t_s):
            self._target_vel = [0.0, 0.0, 0.0]
            acc = _ZERO
            self._yaw_rate_radps = 0.0
            accelerates = False
        self._move(dt_s)
        parameters = self._parameters
        acc_max, acc_max_z = (max(0.01 * parameters[f"WPNAV_ACCEL{name}"], 0.1) for name in ("", "_Z"))
        jerk, jerk_z = (max(parameters[f"PSC_JERK_{name}"], 0.1) for name in ("XY", "Z"))
        speed, up, down = (0.01 * parameters[f"WPNAV_SPEED{name}"] for name in ("", "_UP", "_DN"))
        wanted = list(acc)
        if not accelerates:
            vel = list(self._target_vel)
            if target.pos_ned_m is not None:
                away = [self._target_pos[i] - self.pos_ned_m[i] for i in range(3)]
                if is_place:
                    speed, up, down = _along(away, speed, up, down)
                n, e = _approach(away[0], away[1], 0.5 * jerk / acc_max, 0.5 * acc_max, speed)
                d, _ = _approach(away[2], 0.0, 0.5 * jerk_z / acc_max_z, 0.5 * acc_max_z, down if away[2] > 0 else up)
                vel = [vel[0] + n, vel[1] + e, vel[2] + d]
            error = [vel[i] - self.vel_ned_mps[i] for i in range(3)]
            n, e = _approach(error[0], error[1], jerk / acc_max, jerk, acc_max)
            d, _ = _approach(error[2], 0.0, jerk_z / acc_max_z, jerk_z, acc_max_z)
            wanted = [wanted[0] + n, wanted[1] + e, wanted[2] + d]
        self._accelerate(wanted, jerk * dt_s, jerk_z * dt_s)
        for i in range(3):
            self._target_pos[i] += (self._target_vel[i] + 0.5 * acc[i] * dt_s) * dt_s
            self._target_vel[i] += acc[i] * dt_s
        yaw_rate = self._turn(dt_s)
        p, v, a = self.pos_ned_m, self.vel_ned_mps, self.acc_ned_mps2
        return TrajectorySetpoint((p[0], p[1], p[2]), (v[0], v[1], v[2]), (a[0], a[1], a[2]), self._yaw_rad, yaw_rate)

    def _restart(self, pos_ned_m: Vec3, vel_ned_mps: Vec3, yaw_rad: float) -> None:
        """Begin anew in flight: the acceleration goes on, or a stream of stops would never brake."""
        self.pos_ned_m, self.vel_ned_mps = list(pos_ned_m), list(vel_ned_mps)
        self._target = GuidedTarget(vel_ned_mps=_ZERO)
        self._attitude = None
        self._target_vel = [0.0, 0.0, 0.0]
        self._yaw_rad = self._yaw_goal_rad = yaw_rad
        self._yaw_rate_radps = 0.0
        self._yaw_follows = False

    def _is_stale(self, t_s: float) -> bool:
        return t_s - self._told_s > max(self._parameters["GUID_TIMEOUT"], 0.1)

    def _move(self, dt_s: float) -> None:
        pos, vel, acc = self.pos_ned_m, self.vel_ned_mps, self.acc_ned_mps2
        for i in range(3):
            pos[i] += (vel[i] + 0.5 * acc[i] * dt_s) * dt_s
            vel[i] += acc[i] * dt_s

    def _accelerate(self, wanted: list[float], change: float, change_z: float) -> None:
        acc = self.acc_ned_mps2
        n, e = wanted[0] - acc[0], wanted[1] - acc[1]
        size = hypot(n, e)
        scale = change / size if size > change else 1.0
        acc[0] += n * scale
        acc[1] += e * scale
        acc[2] += max(-change_z, min(change_z, wanted[2] - acc[2]))

    def _turn(self, dt_s: float) -> float:
        """Turn the heading towards its goal and give the rate of it."""
        before = self._yaw_rad
        if self._yaw_follows:
            # WP_YAW_BEHAVIOR: the nose looks ahead.
            n, e = self.vel_ned_mps[0], self.vel_ned_mps[1]
            if self._parameters["WP_YAW_BEHAVIOR"] and hypot(n, e) > (
                _YAW_FOLLOWS_ABOVE * 0.01 * self._parameters["WPNAV_SPEED"]
            ):
                self._yaw_goal_rad = atan2(e, n)
        else:
            self._yaw_goal_rad += self._yaw_rate_radps * dt_s
        error = _wrapped(self._yaw_goal_rad - self._yaw_rad)
        limit = _YAW_SLEW_RADPS * dt_s
        self._yaw_rad = _wrapped(self._yaw_rad + max(-limit, min(limit, error)))
        return _wrapped(self._yaw_rad - before) / dt_s


def _approach(n: float, e: float, gain: float, derivative_max: float, limit: float) -> tuple[float, float]:
    """Rate that brings an error to zero: in proportion near it, further off as its derivative allows."""
    size = hypot(n, e)
    if size < 1e-9:
        return 0.0, 0.0
    linear = derivative_max / (gain * gain)
    rate = gain * size if size <= linear else sqrt(2.0 * derivative_max * (size - 0.5 * linear))
    scale = min(rate, limit) / size
    return n * scale, e * scale


def _along(away: list[float], speed: float, up: float, down: float) -> tuple[float, float, float]:
    """Speeds that keep to the straight line to a place."""
    across, vertical = hypot(away[0], away[1]), abs(away[2])
    distance = hypot(across, vertical)
    if distance < 1e-6:
        return speed, up, down
    limit = down if away[2] > 0.0 else up
    fastest = min(
        speed * distance / across if across > 1e-6 * distance else float("inf"),
        limit * distance / vertical if vertical > 1e-6 * distance else float("inf"),
    )
    return fastest * across / distance, fastest * vertical / distance, fastest * vertical / distance


def _wrapped(angle: float) -> float:
    """Angle within -pi..pi."""
    wrapped = (angle + pi) % (2.0 * pi) - pi
    return copysign(pi, angle) if wrapped == -pi else wrapped
