"""Setpoints of applications, resolved into LOCAL_NED as the autopilot that they are meant for reads them.

The readings are those of PX4 v1.16 and Copter 4.7. They differ in nearly everything: PX4 ignores single axes, Copter
whole groups; PX4 turns a BODY acceleration by the full attitude, Copter by the heading; Copter takes BODY positions as
offsets, PX4 does not use them; PX4 drops what it does not accept, Copter stops.
"""

import math
import struct
from dataclasses import dataclass
from enum import Enum
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.swing_message import float32
from swingd.model.actions import Setpoint
from swingd.model.events import (
    AppSetpoint,
    Attitude,
    AutopilotKind,
    LocalPosition,
    SetpointUse,
    UnmetSetpoint,
    Vec3,
)
from swingd.model.parameters import ShaperName

# Plain integers: arithmetic with flags costs a microsecond each.
FORCE_BIT = 0x200
"""POSITION_TARGET_TYPEMASK_FORCE_SET."""
USE_MASK = 0xDFF
"""The bits of a type mask that say what is ignored."""
POS, VEL, ACC = SetpointUse.POS.value, SetpointUse.VEL.value, SetpointUse.ACC.value
YAW, YAW_RATE = SetpointUse.YAW.value, SetpointUse.YAW_RATE.value
MOTION = POS | VEL | ACC
_POS_D, _VEL_NE = SetpointUse.POS_D.value, SetpointUse.VEL_N.value | SetpointUse.VEL_E.value

COPTER_COMBINATIONS = frozenset({POS, POS | VEL, POS | VEL | ACC, VEL, VEL | ACC, ACC})
"""The groups that Copter follows together; anything else makes it stop."""
COPTER_VEL_MAX_MPS = 1000.0
"""A faster component makes Copter stop."""

FRESH_S = 0.25
"""An attitude or a position older than this does not say how the autopilot reads a setpoint now [s]."""
HOME_AGREES_M = 0.25
"""PX4 takes the altitude above home with the wrong sign of home above the origin: it matters if they differ by more."""

POS_MAX_M = 1e7
VEL_MAX_MPS = 1e3
ACC_MAX_MPS2 = 1e3
YAW_MAX_RAD = 1e3
YAW_RATE_MAX_RADPS = 200.0

_PX4_EARTH_RADIUS_M = 6371000.0
_COPTER_M_PER_1E7_DEG = math.radians(1e-7) * 6378100.0
_COPTER_LONGITUDE_SCALE_MIN = 0.01
_FLOAT32 = struct.Struct("<f")
_ZERO: Vec3 = (0.0, 0.0, 0.0)

_COPTER_OFFSET = frozenset(
    {mavlink.MAV_FRAME_LOCAL_OFFSET_NED, mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED}
)
_COPTER_BODY = frozenset({mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED})
_COPTER_ABSOLUTE = frozenset({mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT})
_COPTER_ABOVE_HOME = frozenset({mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
_COPTER_ABOVE_TERRAIN = frozenset({mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT, mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT})

SETPOINT_IDS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
        mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET,
        mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
        mavlink.MAVLINK_MSG_ID_COMMAND_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_ITEM,
        mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    }
)
"""The messages by which an application can ask an autopilot to follow something else."""

_COPTER_COMMANDS = frozenset(
    {
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_NAV_VTOL_TAKEOFF,
        mavlink.MAV_CMD_DO_REPOSITION,
        mavlink.MAV_CMD_CONDITION_YAW,
    }
)
_COPTER_GUIDED_ITEMS = (2, 3)


class Unmet(Enum):
    """Why a setpoint is not resolved."""

    REJECTED = "rejected"
    """The autopilot does not take it and goes on with what it follows."""
    STOPS = "stops"
    """The autopilot (Copter) answers it by stopping."""
    UNRESOLVED = "unresolved"
    """The autopilot may well follow it, but what it will make of it cannot be told here."""


@dataclass(frozen=True, slots=True)
class GeodeticPoint:
    """A point as GPS_GLOBAL_ORIGIN and HOME_POSITION give it."""

    lat_1e7_deg: int
    lon_1e7_deg: int
    alt_amsl_mm: int


@dataclass(slots=True)
class VehicleView:
    """What one life of an autopilot told of itself, as far as its reading of setpoints depends on it."""

    attitude: Attitude | None = None
    heading_sp: tuple[float, float] | None = None
    """Arrival [s] and yaw [rad] of the last attitude setpoint: what Copter's relative yaw counts from."""
    local: LocalPosition | None = None
    origin: GeodeticPoint | None = None
    """Origin of the local frame."""
    home: GeodeticPoint | None = None

    def fresh_attitude(self, t_mono_s: float) -> Attitude | None:
        """Return the attitude, or None if there is none or it is too old."""
        attitude = self.attitude
        return attitude if attitude is not None and t_mono_s - attitude.t_mono_s <= FRESH_S else None

    def position_ned_m(self, t_mono_s: float) -> Vec3 | None:
        """Return the position, carried on with its velocity to the present, or None if it is not known or too old."""
        local = self.local
        if local is None:
            return None
        age_s = t_mono_s - local.t_mono_s
        if age_s > FRESH_S:
            return None
        (n, e, d), (vn, ve, vd) = local.pos_ned_m, local.vel_ned_mps
        return n + vn * age_s, e + ve * age_s, d + vd * age_s

    def yaw_sp_rad(self, t_mono_s: float) -> float | None:
        """Return the heading that the autopilot holds, or else the one that it has, or None if neither is fresh."""
        if self.heading_sp is not None and t_mono_s - self.heading_sp[0] <= FRESH_S:
            return self.heading_sp[1]
        attitude = self.fresh_attitude(t_mono_s)
        return None if attitude is None else attitude.yaw_rad


def resolve(
    kind: AutopilotKind,
    message: Any,
    view: VehicleView,
    t_mono_s: float,
    source: int = 0,
    shaper: ShaperName = ShaperName.NONE,
) -> AppSetpoint | Unmet:
    """Resolve a setpoint into LOCAL_NED as an autopilot reads it at this instant.

    Parameters
    ----------
    kind : AutopilotKind
        Whose reading.
    message : SET_POSITION_TARGET_LOCAL_NED or SET_POSITION_TARGET_GLOBAL_INT
        pymavlink's object, any values.
    view : VehicleView
        What the autopilot told of itself.
    t_mono_s : float
        This instant [s].
    source, shaper
        Taken over into the result.

    Returns
    -------
    AppSetpoint or Unmet
        A setpoint that, sent in LOCAL_NED, makes the autopilot follow what the original would, all its used components
        finite and within what can be flown; or why there is none.
    """
    read = _READINGS.get((kind, message.get_msgId()))
    if read is None:
        return Unmet.UNRESOLVED
    values = read(message, view, t_mono_s)
    if isinstance(values, Unmet):
        return values
    use, pos, vel, acc, yaw_rad, yaw_rate_radps = values
    if not (
        _within(pos, POS_MAX_M)
        and _within(vel, VEL_MAX_MPS)
        and _within(acc, ACC_MAX_MPS2)
        and -YAW_MAX_RAD <= yaw_rad <= YAW_MAX_RAD
        and -YAW_RATE_MAX_RADPS <= yaw_rate_radps <= YAW_RATE_MAX_RADPS
    ):
        return Unmet.UNRESOLVED
    return AppSetpoint(t_mono_s, SetpointUse(use), pos, vel, acc, yaw_rad, yaw_rate_radps, source, shaper)


def replaces_setpoint(kind: AutopilotKind, message: Any) -> bool:
    """Whether a message other than a position target makes the autopilot follow something else in OFFBOARD or GUIDED.

    Copter takes commands and single mission items as targets in GUIDED; what is sent afterwards takes their place, so
    nothing must be repeated behind them. PX4 leaves OFFBOARD for all of these.
    """
    msg_id = message.get_msgId()
    if msg_id == mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET:
        return True
    if msg_id == mavlink.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET:
        return kind is not AutopilotKind.ARDUPILOT
    if kind is not AutopilotKind.ARDUPILOT:
        return False
    if msg_id in (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT):
        return message.command in _COPTER_COMMANDS
    if msg_id in (mavlink.MAVLINK_MSG_ID_MISSION_ITEM, mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT):
        return message.current in _COPTER_GUIDED_ITEMS
    return False


def meet(
    kind: AutopilotKind, message: Any, view: VehicleView, t_mono_s: float, source: int, shaper: ShaperName
) -> AppSetpoint | UnmetSetpoint | None:
    """Say what a message of `SETPOINT_IDS`, addressed to the autopilot, means to the correction.

    Returns
    -------
    AppSetpoint
        A correction can meet it.
    UnmetSetpoint
        It takes the place of what the autopilot follows, and no correction can meet it.
    None
        It changes nothing of what the autopilot follows.
    """
    if message.get_msgId() in _POSITION_TARGETS:
        result = resolve(kind, message, view, t_mono_s, source, shaper)
        if isinstance(result, AppSetpoint):
            return result
        return None if result is Unmet.REJECTED else UnmetSetpoint(t_mono_s, source)
    return UnmetSetpoint(t_mono_s, source) if replaces_setpoint(kind, message) else None


def pack(kind: AutopilotKind, system_id: int, component_id: int, setpoint: Setpoint) -> Any | None:
    """Return the SET_POSITION_TARGET_LOCAL_NED of a setpoint, or None if it must not be sent.

    It must not if a used component is not finite, if it asks for no motion, or if Copter, which follows whole groups
    only, would stop instead.
    """
    use = setpoint.use.value
    axes = (*setpoint.pos_ned_m, *setpoint.vel_ned_mps, *setpoint.acc_ned_mps2)
    values = [value if use >> bit & 1 else 0.0 for bit, value in enumerate(axes)]
    values.append(setpoint.yaw_rad if use & YAW else 0.0)
    values.append(setpoint.yaw_rate_radps if use & YAW_RATE else 0.0)
    if not use & MOTION or not all(map(math.isfinite, (setpoint.t_boot_s, *values))):
        return None
    if kind is AutopilotKind.ARDUPILOT and (
        use & MOTION not in COPTER_COMBINATIONS or not _within((values[3], values[4], values[5]), COPTER_VEL_MAX_MPS)
    ):
        return None
    return mavlink.MAVLink_set_position_target_local_ned_message(
        round(setpoint.t_boot_s * 1e3) & 0xFFFFFFFF,
        system_id,
        component_id,
        mavlink.MAV_FRAME_LOCAL_NED,
        ~use & USE_MASK,
        *map(float32, values),
    )


# ---------------------------------------------------------------------------------------------------------------- PX4

_Values = tuple[int, Vec3, Vec3, Vec3, float, float]
"""Use, position [m], velocity [m/s], acceleration [m/s^2], yaw [rad], yaw rate [rad/s]; zero where not used."""


def _px4_local(message: Any, view: VehicleView, t_mono_s: float) -> _Values | Unmet:
    use = _px4_asked(message, (message.x, message.y, message.z))
    pos = vel = acc = _ZERO
    frame = message.coordinate_frame
    if frame == mavlink.MAV_FRAME_LOCAL_NED:
        pos = used((message.x, message.y, message.z), use)
        vel = used((message.vx, message.vy, message.vz), use >> 3)
        acc = used((message.afx, message.afy, message.afz), use >> 6)
    elif frame == mavlink.MAV_FRAME_BODY_NED:
        # Positions are not used; a bit that ignores an axis drops the group; NaN spreads through the rotation.
        use &= ~POS
        if message.type_mask & VEL:
            use &= ~VEL
        elif use & _VEL_NE != _VEL_NE:
            use &= ~_VEL_NE
        if use & ACC != ACC:
            use &= ~ACC
        if use & (VEL | ACC):
            attitude = view.fresh_attitude(t_mono_s)
            if attitude is None:
                return _px4_force(message, use) or Unmet.UNRESOLVED
            vel = used((*_turned(message.vx, message.vy, attitude.yaw_rad), message.vz), use >> 3)
            if use & ACC:
                acc = _rotated((message.afx, message.afy, message.afz), attitude)
    else:
        return Unmet.REJECTED
    return _px4_force(message, use) or (use, pos, vel, acc, *_yaws(message, use))


def _px4_global(message: Any, view: VehicleView, t_mono_s: float) -> _Values | Unmet:
    use = _px4_asked(message, (0.0, 0.0, message.alt))
    pos = _ZERO
    # The frame is looked at for a position only, and only all three axes are one.
    if message.type_mask & POS:
        use &= ~POS
    else:
        frame = message.coordinate_frame
        if frame == mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT:
            return Unmet.UNRESOLVED
        if frame not in (mavlink.MAV_FRAME_GLOBAL_INT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT):
            return Unmet.REJECTED
        refused = _px4_force(message, use)
        if refused is not None:
            return refused
        origin, home = view.origin, view.home
        if origin is None:
            return Unmet.UNRESOLVED
        origin_alt_m = origin.alt_amsl_mm * 1e-3
        down_m = origin_alt_m - message.alt
        if frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT:
            if home is None or abs(home.alt_amsl_mm * 1e-3 - origin_alt_m) > HOME_AGREES_M:
                return Unmet.UNRESOLVED
            down_m = home.alt_amsl_mm * 1e-3 - message.alt - origin_alt_m
        if not use & _POS_D:
            down_m = 0.0
        pos = (*azimuthal_equidistant(origin, message.lat_int, message.lon_int), down_m)
    vel = used((message.vx, message.vy, message.vz), use >> 3)
    acc = used((message.afx, message.afy, message.afz), use >> 6)
    return _px4_force(message, use) or (use, pos, vel, acc, *_yaws(message, use))


def _px4_asked(message: Any, pos: Vec3) -> int:
    """What a message asks for, axis by axis: neither ignored by its mask nor NaN."""
    use: int = ~message.type_mask & USE_MASK
    values = (*pos, message.vx, message.vy, message.vz, message.afx, message.afy, message.afz)
    for bit, value in enumerate(values):
        if value != value:
            use &= ~(1 << bit)
    if message.yaw != message.yaw:
        use &= ~YAW
    if message.yaw_rate != message.yaw_rate:
        use &= ~YAW_RATE
    return use


def _px4_force(message: Any, use: int) -> Unmet | None:
    """Tell whether PX4 rejects what asks for no motion, or for a force."""
    refused = not use & MOTION or (message.type_mask & FORCE_BIT and use & ACC)
    return Unmet.REJECTED if refused else None


def azimuthal_equidistant(origin: GeodeticPoint, lat_1e7_deg: int, lon_1e7_deg: int) -> tuple[float, float]:
    """North and east [m] of a point, as PX4 projects it."""
    lat0, lat = math.radians(origin.lat_1e7_deg * 1e-7), math.radians(lat_1e7_deg * 1e-7)
    d_lon = math.radians(lon_1e7_deg * 1e-7) - math.radians(origin.lon_1e7_deg * 1e-7)
    cos_arc = math.sin(lat0) * math.sin(lat) + math.cos(lat0) * math.cos(lat) * math.cos(d_lon)
    arc = math.acos(max(-1.0, min(1.0, cos_arc)))
    sin_arc = math.sin(arc)
    scale_m = _PX4_EARTH_RADIUS_M * (arc / sin_arc if sin_arc > 0.0 else 1.0)
    north = math.cos(lat0) * math.sin(lat) - math.sin(lat0) * math.cos(lat) * math.cos(d_lon)
    return scale_m * north, scale_m * math.cos(lat) * math.sin(d_lon)


# ------------------------------------------------------------------------------------------------------------- Copter


def _copter_local(message: Any, view: VehicleView, t_mono_s: float) -> _Values | Unmet:
    frame = message.coordinate_frame
    use = _copter_asked(message)
    vel_in = (message.vx, message.vy, message.vz)
    if frame != mavlink.MAV_FRAME_LOCAL_NED and frame not in _COPTER_OFFSET:
        return Unmet.STOPS
    if _copter_stops(message, use, vel_in):
        return Unmet.STOPS
    pos = (message.x, message.y, message.z) if use & POS else _ZERO
    vel = vel_in if use & VEL else _ZERO
    acc = (message.afx, message.afy, message.afz) if use & ACC else _ZERO
    yaw_rad, yaw_rate_radps = _yaws(message, use)
    if frame in _COPTER_BODY:
        attitude = view.fresh_attitude(t_mono_s)
        if attitude is None:
            return Unmet.UNRESOLVED
        pos, vel, acc = ((*_turned(x, y, attitude.yaw_rad), z) for x, y, z in (pos, vel, acc))
        if use & YAW:
            # Relative to the heading that it holds; a yaw rate beside it is not used.
            yaw_sp_rad = view.yaw_sp_rad(t_mono_s)
            if yaw_sp_rad is None or not math.isfinite(yaw_rad):
                return Unmet.UNRESOLVED
            yaw_rad = math.remainder(yaw_sp_rad + yaw_rad, 2.0 * math.pi)
            yaw_rate_radps = 0.0
            use &= ~YAW_RATE
    if use & POS and frame in _COPTER_OFFSET:
        here = view.position_ned_m(t_mono_s)
        if here is None:
            return Unmet.UNRESOLVED
        pos = (pos[0] + here[0], pos[1] + here[1], pos[2] + here[2])
    return use, pos, vel, acc, yaw_rad, yaw_rate_radps


def _copter_global(message: Any, view: VehicleView, t_mono_s: float) -> _Values | Unmet:
    frame = message.coordinate_frame
    use = _copter_asked(message)
    vel_in = (message.vx, message.vy, message.vz)
    if _copter_stops(message, use, vel_in):
        return Unmet.STOPS
    pos = _ZERO
    if use & POS:
        if abs(message.lat_int) > 900_000_000 or abs(message.lon_int) > 1_800_000_000:
            return Unmet.STOPS
        if frame in _COPTER_ABOVE_TERRAIN:
            return Unmet.STOPS if use & VEL else Unmet.UNRESOLVED
        if frame not in _COPTER_ABSOLUTE and frame not in _COPTER_ABOVE_HOME:
            return Unmet.STOPS
        origin, home = view.origin, view.home
        if origin is None or not abs(message.alt) <= POS_MAX_M:
            return Unmet.UNRESOLVED
        alt_cm = math.trunc(*_FLOAT32.unpack(_FLOAT32.pack(message.alt * 100.0)))
        if frame in _COPTER_ABOVE_HOME:
            if home is None:
                return Unmet.UNRESOLVED
            alt_cm += round(home.alt_amsl_mm / 10)
        down_m = (round(origin.alt_amsl_mm / 10) - alt_cm) * 1e-2
        pos = (*_flat_earth(origin, message.lat_int, message.lon_int), down_m)
        # An acceleration beside position and velocity is not used.
        use &= ~ACC
    vel = vel_in if use & VEL else _ZERO
    acc = (message.afx, message.afy, message.afz) if use & ACC else _ZERO
    return use, pos, vel, acc, *_yaws(message, use)


def _copter_asked(message: Any) -> int:
    """What a message asks for: a group is meant only as a whole."""
    mask = message.type_mask
    use: int = ~mask & (YAW | YAW_RATE)
    for group in (POS, VEL, ACC):
        if not mask & group:
            use |= group
    return use


def _copter_stops(message: Any, use: int, vel: Vec3) -> bool:
    """Tell whether Copter stops whatever the frame."""
    if use & MOTION not in COPTER_COMBINATIONS:
        return True
    if message.type_mask & FORCE_BIT and use & ACC:
        return True
    return bool(use & VEL) and not _within(vel, COPTER_VEL_MAX_MPS)


def _flat_earth(origin: GeodeticPoint, lat_1e7_deg: int, lon_1e7_deg: int) -> tuple[float, float]:
    """North and east [m] of a point, as Copter's Location counts them."""
    d_lon = lon_1e7_deg - origin.lon_1e7_deg
    if d_lon > 1_800_000_000:
        d_lon -= 3_600_000_000
    elif d_lon < -1_800_000_000:
        d_lon += 3_600_000_000
    middle_rad = math.radians((lat_1e7_deg + origin.lat_1e7_deg) * 0.5e-7)
    scale = max(math.cos(middle_rad), _COPTER_LONGITUDE_SCALE_MIN)
    return (lat_1e7_deg - origin.lat_1e7_deg) * _COPTER_M_PER_1E7_DEG, d_lon * _COPTER_M_PER_1E7_DEG * scale


# ------------------------------------------------------------------------------------------------------------- common


def used(values: Vec3, use: int) -> Vec3:
    """Return three components, zero where the lowest three bits of ``use`` say that they are not used."""
    x, y, z = values
    return (x if use & 1 else 0.0), (y if use & 2 else 0.0), (z if use & 4 else 0.0)


def _yaws(message: Any, use: int) -> tuple[float, float]:
    return (message.yaw if use & YAW else 0.0), (message.yaw_rate if use & YAW_RATE else 0.0)


def _within(values: Vec3, limit: float) -> bool:
    """Whether all three are finite and not beyond a limit."""
    x, y, z = values
    return -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit


def _turned(x: float, y: float, yaw_rad: float) -> tuple[float, float]:
    """Forward and right as north and east."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return c * x - s * y, s * x + c * y


def _rotated(v_frd: Vec3, attitude: Attitude) -> Vec3:
    """Turn a vector of the body into NED by the full attitude."""
    x, y, z = v_frd
    cr, sr = math.cos(attitude.roll_rad), math.sin(attitude.roll_rad)
    cp, sp = math.cos(attitude.pitch_rad), math.sin(attitude.pitch_rad)
    y, z = cr * y - sr * z, sr * y + cr * z
    x, z = cp * x + sp * z, cp * z - sp * x
    return (*_turned(x, y, attitude.yaw_rad), z)


_POSITION_TARGETS = (
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
)
_READINGS = {
    (AutopilotKind.PX4, _POSITION_TARGETS[0]): _px4_local,
    (AutopilotKind.PX4, _POSITION_TARGETS[1]): _px4_global,
    (AutopilotKind.ARDUPILOT, _POSITION_TARGETS[0]): _copter_local,
    (AutopilotKind.ARDUPILOT, _POSITION_TARGETS[1]): _copter_global,
}
