"""Where a correction enters a setpoint, as each autopilot understands setpoints."""

import math
from dataclasses import dataclass, replace

from swingd.control.base import Vec2
from swingd.model.events import AppSetpoint, AutopilotKind, SetpointUse, Vec3
from swingd.pipeline.correction import NO_PUSH, Push

POS_XY = SetpointUse.POS_N | SetpointUse.POS_E
VEL_XY = SetpointUse.VEL_N | SetpointUse.VEL_E
ACC_XY = SetpointUse.ACC_N | SetpointUse.ACC_E
_ZERO: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Reference:
    """A setpoint in local NED before any correction; components outside ``use`` mean nothing."""

    use: SetpointUse
    pos_ned_m: Vec3 = _ZERO
    vel_ned_mps: Vec3 = _ZERO
    acc_ned_mps2: Vec3 = _ZERO
    yaw_rad: float = 0.0
    yaw_rate_radps: float = 0.0


def reference_of(setpoint: AppSetpoint) -> Reference:
    """Return what an application asks for."""
    return Reference(
        setpoint.use,
        setpoint.pos_ned_m,
        setpoint.vel_ned_mps,
        setpoint.acc_ned_mps2,
        setpoint.yaw_rad,
        setpoint.yaw_rate_radps,
    )


def is_correctable(use: SetpointUse, kind: AutopilotKind) -> bool:
    """Whether the autopilot flies a setpoint with these components in a way that a correction can enter.

    PX4 takes each axis on its own, but north and east of a group only together. ArduPilot takes whole groups, and
    approaches a position that stands alone by a path of its own, which a correction would only disturb.
    """
    if kind is AutopilotKind.PX4:
        pairs = (POS_XY, VEL_XY, ACC_XY)
        return _takes_whole(use, pairs) and any(use & pair for pair in pairs)
    if kind is AutopilotKind.ARDUPILOT:
        pos, vel, acc = groups = SetpointUse.POS, SetpointUse.VEL, SetpointUse.ACC
        return _takes_whole(use, groups) and bool(use & vel or (use & acc and not use & pos))
    return False


def _takes_whole(use: SetpointUse, groups: tuple[SetpointUse, ...]) -> bool:
    """Whether each group is used with all of its components or with none."""
    return all(use & group in (SetpointUse.NONE, group) for group in groups)


def merge(reference: Reference, push: Push, kind: AutopilotKind) -> Reference:
    """Add a correction to a correctable reference; without one it is returned as it is.

    An acceleration alone is not enough: the autopilot's velocity loop would take it for a disturbance, and so would the
    position loop a velocity alone. So every loop above the acceleration gets its consistent share.
    """
    if push == NO_PUSH:
        return reference
    use = reference.use
    whole = kind is AutopilotKind.ARDUPILOT
    pos, vel, acc = reference.pos_ned_m, reference.vel_ned_mps, reference.acc_ned_mps2
    has_pos, has_vel = bool(use & POS_XY), bool(use & VEL_XY)
    if has_pos:
        pos = _added(pos, push.pos_m)
    if has_pos or has_vel:
        vel = _added(vel if has_vel else (0.0, 0.0, vel[2]), push.vel_mps)
        use |= SetpointUse.VEL if whole else VEL_XY
    acc_n, acc_e, _ = acc if use & ACC_XY else _ZERO
    acc_d = acc[2] if use & SetpointUse.ACC_D else 0.0
    acc = (acc_n + push.acc_mps2[0], acc_e + push.acc_mps2[1], acc_d)
    use |= SetpointUse.ACC if whole else ACC_XY
    return Reference(use, pos, vel, acc, reference.yaw_rad, reference.yaw_rate_radps)


def carried(reference: Reference, age_s: float, kind: AutopilotKind) -> Reference:
    """Move a reference on as the autopilot would have, had it got it ``age_s`` ago [s].

    ArduPilot lets a target move by its own derivatives until the next one comes; one that is repeated as it was would
    be held back. PX4 flies what it was given last as it stands.
    """
    use = reference.use
    if kind is not AutopilotKind.ARDUPILOT:
        return reference
    pos, vel, yaw_rad = reference.pos_ned_m, reference.vel_ned_mps, reference.yaw_rad
    acc = reference.acc_ned_mps2 if use & SetpointUse.ACC else _ZERO
    if use & SetpointUse.VEL:
        if use & SetpointUse.POS:
            pos = _moved(pos, _moved(vel, acc, 0.5 * age_s), age_s)
        vel = _moved(vel, acc, age_s)
    if use & SetpointUse.YAW and use & SetpointUse.YAW_RATE:
        yaw_rad = math.remainder(yaw_rad + reference.yaw_rate_radps * age_s, 2.0 * math.pi)
    return replace(reference, pos_ned_m=pos, vel_ned_mps=vel, yaw_rad=yaw_rad)


def _moved(vector: Vec3, rate: Vec3, dt_s: float) -> Vec3:
    return vector[0] + rate[0] * dt_s, vector[1] + rate[1] * dt_s, vector[2] + rate[2] * dt_s


def _added(vector: Vec3, horizontal: Vec2) -> Vec3:
    return vector[0] + horizontal[0], vector[1] + horizontal[1], vector[2]
