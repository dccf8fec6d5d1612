"""Copter's face: what ArduPilot's multirotors do on their link, as far as a companion or an application sees it."""

from collections.abc import Collection, Mapping
from math import cos, isfinite, sin, sqrt
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.model.events import Vec3
from swingd.model.parameters import Parameters
from swingd.sim import geodesy
from swingd.sim.autopilot import Answer, Autopilot, NavState
from swingd.sim.cascade import AttitudeSetpoint, yaw_of
from swingd.sim.copter_parameters import CopterParameters
from swingd.sim.face import FORCE_MAGIC, Command, CompanionLog, Face, Handler, Result, available, whole
from swingd.sim.guided import Guided, GuidedTarget
from swingd.sim.missions import MissionItem, Missions
from swingd.sim.onboard import Onboard
from swingd.sim.parameter_server import CopterParameterServer, Send
from swingd.sim.streams import CopterStreams
from swingd.sim.telemetry import CopterTelemetry, global_int

STABILIZE, AUTO, GUIDED, LOITER, RTL, LAND = 0, 3, 4, 5, 6, 9
"""Copter's mode numbers."""

_NAV_STATE = {
    STABILIZE: NavState.MANUAL,
    GUIDED: NavState.GUIDED,
    LOITER: NavState.LOITER,
    RTL: NavState.RTL,
    LAND: NavState.LAND,
}
_ARMABLE = (STABILIZE, GUIDED, LOITER)
_NAVIGATING = (GUIDED, LOITER, RTL)
_FASTEST_MS = 4  # at SCHED_LOOP_RATE 400
_SPEED_MAX = 1000.0
_THRUST_IS_THRUST = 8  # bit of GUID_OPTIONS
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION = 4 << 24 | 7 << 16  # 4.7.0, development

_DEFAULT_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 1.0,
}
"""What is not named here is off until asked for."""

_GROUPS: Mapping[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: (mavlink.MAVLINK_MSG_ID_RAW_IMU,),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (mavlink.MAVLINK_MSG_ID_SYS_STATUS, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: (
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS),
}
"""What REQUEST_DATA_STREAM switches together."""

_POS, _VEL, _ACC = 0b111, 0b111 << 3, 0b111 << 6
_FORCE = mavlink.POSITION_TARGET_TYPEMASK_FORCE_SET
_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_YAW_RATE = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_BODY_FRAMES = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)
_LOCAL_FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY_FRAMES)
_ABSOLUTE_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
_RELATIVE_FRAMES = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_STOP = GuidedTarget()


class Copter(Face):
    """Copter 4.7.

    Parameters
    ----------
    parameters : Parameters
        The vehicle and the simulation.
    changes : mapping
        Copter's own parameters other than the defaults.
    companion : CompanionLog
        Where setpoints are counted; a STATUSTEXT is sent once a heartbeat was heard.
    send : callable
        Takes each message that leaves.
    without : collection of int
        Message ids that this autopilot is not to have.
    """

    pass_unsigned = (mavlink.MAVLINK_MSG_ID_RADIO_STATUS,)

    def __init__(
        self,
        parameters: Parameters,
        changes: Mapping[str, float],
        companion: CompanionLog,
        send: Send,
        without: Collection[int],
    ) -> None:
        table = CopterParameters(changes)
        onboard = Onboard(parameters, lambda: Autopilot(parameters, table.loops, Guided(table)))
        super().__init__(onboard, companion, send)
        self._table = table
        self.parameters = table
        self.loops = table.loops
        self.parameter_server = CopterParameterServer(table, send)
        self.missions = Missions(send, self._home_item)
        self._mode = STABILIZE
        self._was_armed = False
        self.onboard.autopilot.request_mode(NavState.MANUAL)
        telemetry = CopterTelemetry(onboard)
        builders = {
            mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: telemetry.highres_imu,
            mavlink.MAVLINK_MSG_ID_RAW_IMU: telemetry.raw_imu,
            mavlink.MAVLINK_MSG_ID_SCALED_IMU: telemetry.scaled_imu,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: telemetry.attitude,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: telemetry.attitude_quaternion,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: telemetry.attitude_target,
            mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: telemetry.servo_output,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: telemetry.vfr_hud,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: telemetry.local_position,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: telemetry.position_target,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: telemetry.global_position,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: telemetry.gps_raw,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: telemetry.sys_status,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: telemetry.battery_status,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: telemetry.extended_sys_state,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: telemetry.system_time,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: telemetry.home_position,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: telemetry.global_origin,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS: telemetry.rc_channels,
        }
        self.streams = CopterStreams(available(builders, without), _DEFAULT_RATES_HZ)

    def boot(self) -> None:
        """Start anew; parameters and missions stay."""
        super().boot()
        self._mode = STABILIZE
        self._was_armed = False
        self.onboard.autopilot.request_mode(NavState.MANUAL)

    def tick(self) -> None:
        """Do what time asks for, before the streams."""
        super().tick()
        armed = self.onboard.autopilot.armed
        if armed is not self._was_armed:
            self._was_armed = armed
            self._say(mavlink.MAV_SEVERITY_INFO, "Arming motors" if armed else "Disarming motors")

    def handlers(self) -> dict[int, Handler]:
        """What takes each message."""
        return {**super().handlers(), mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self._on_request_data_stream}

    def heartbeat(self) -> Any:
        """Make the HEARTBEAT; the mode is the one that was asked for, whatever stage of it is flown."""
        autopilot = self.onboard.autopilot
        base = (
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        )
        if self._mode in _NAVIGATING:
            base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if autopilot.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        state = mavlink.MAV_STATE_STANDBY if autopilot.landed else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, self._mode, state, 3
        )

    def version(self) -> Any:
        """Make the AUTOPILOT_VERSION."""
        return mavlink.MAVLink_autopilot_version_message(_CAPABILITIES, _VERSION, 0, 0, 0, *([[0] * 8] * 3), 0, 0, 0)

    def set_interval(self, msg_id: int, interval_us: float) -> Result:
        """Change a stream's interval; 0 is the default, -1 switches off, faster than 250 Hz is denied."""
        stream = self.streams.get(msg_id)
        if stream is None or not isfinite(interval_us):
            return Result.DENIED
        wanted_us = int(interval_us)
        if wanted_us == 0:
            stream.interval_us = stream.default_us
        elif wanted_us == -1:
            stream.interval_us = 0
        elif wanted_us < 0:
            return Result.DENIED
        elif wanted_us < 1000 * _FASTEST_MS:
            self._say(mavlink.MAV_SEVERITY_INFO, f"Requested rate for message ID {msg_id} too fast")
            return Result.DENIED
        else:
            stream.interval_us = 1000 * min(wanted_us // 1000, 60_000)
        return Result.ACCEPTED

    def set_mode(self, base_mode: int, custom_mode: int) -> Result:
        """Change the mode; modes that need a pilot are refused in the air, missions are not flown."""
        if not base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return Result.DENIED
        autopilot = self.onboard.autopilot
        nav_state = _NAV_STATE.get(custom_mode)
        if nav_state is None or (custom_mode == STABILIZE and autopilot.armed and not autopilot.landed):
            return Result.FAILED
        if custom_mode != self._mode:
            autopilot.request_mode(nav_state)
            self._mode = custom_mode
        return Result.ACCEPTED

    def execute(self, command: Command) -> Result:
        """Do what a command asks and give its MAV_RESULT."""
        p = command.params
        if command.number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return self._arm_or_disarm(p[0], force=p[1] == FORCE_MAGIC)
        if command.number == mavlink.MAV_CMD_DO_SET_MODE:
            return self.set_mode(max(0, whole(p[0])), whole(p[1]))
        if command.number == mavlink.MAV_CMD_NAV_TAKEOFF:
            return self._take_off(command)
        if command.number == mavlink.MAV_CMD_NAV_LAND:
            return self.set_mode(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, LAND)
        if command.number == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return self.set_mode(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, RTL)
        if command.number == mavlink.MAV_CMD_DO_REPOSITION and command.frame is not None:
            return self._reposition(command)
        return Result.UNSUPPORTED

    def local_target(self, message: Any) -> bool:
        """Take SET_POSITION_TARGET_LOCAL_NED: what is invalid stops the vehicle."""
        sensed = self.onboard.sensed
        target = local_target_of(message, sensed.pos_ned_m, yaw_of(sensed.ned_from_frd))
        return self._take(target)

    def global_target(self, message: Any) -> bool:
        """Take SET_POSITION_TARGET_GLOBAL_INT: what is invalid stops the vehicle."""
        return self._take(global_target_of(message, self.onboard.autopilot.home_ned_m[2]))

    def attitude_target(self, message: Any) -> bool:
        """Take SET_ATTITUDE_TARGET: what is invalid stops the vehicle."""
        thrust_is_thrust = bool(int(self._table["GUID_OPTIONS"]) & _THRUST_IS_THRUST)
        climb = (0.01 * self._table["WPNAV_SPEED_UP"], 0.01 * self._table["WPNAV_SPEED_DN"])
        return self._take(attitude_target_of(message, climb, thrust_is_thrust=thrust_is_thrust))

    def _take(self, target: GuidedTarget | AttitudeSetpoint | None) -> bool:
        told = self.onboard.autopilot.guided_target(_STOP if target is None else target)
        return told and target is not None

    def _say(self, severity: int, text: str) -> None:
        if isfinite(self._companion.heartbeat_t_s):
            self._send(mavlink.MAVLink_statustext_message(severity, text.encode()[:50]))

    def _arm_or_disarm(self, wanted: float, *, force: bool) -> Result:
        autopilot = self.onboard.autopilot
        if wanted == 1.0:
            if not force and self._mode not in _ARMABLE:
                self._say(mavlink.MAV_SEVERITY_CRITICAL, "Arm: mode not armable")
                return Result.FAILED
            answer = autopilot.arm()
        elif wanted == 0.0:
            answer = autopilot.disarm(force=force)
        else:
            return Result.UNSUPPORTED
        return Result.ACCEPTED if answer is Answer.ACCEPTED else Result.FAILED

    def _take_off(self, command: Command) -> Result:
        if command.frame not in (None, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT):
            return Result.DENIED
        autopilot, height = self.onboard.autopilot, command.params[6]
        down = self.onboard.sensed.pos_ned_m[2]
        grounded = autopilot.armed and autopilot.landed and self._mode in (GUIDED, LOITER)
        if not grounded or not isfinite(height) or height <= autopilot.home_ned_m[2] - down:
            return Result.FAILED
        autopilot.take_off(height, _NAV_STATE[self._mode])
        return Result.ACCEPTED

    def _reposition(self, command: Command) -> Result:
        p = command.params
        changes_mode = whole(p[1]) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE if whole(p[1]) >= 0 else 0
        if self._mode != GUIDED and not changes_mode:
            return Result.DENIED
        place = _place_of(p[4], p[5], p[6], int(command.frame or 0), self.onboard.autopilot.home_ned_m[2])
        if place is None:
            return Result.DENIED
        self.set_mode(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, GUIDED)
        told = self.onboard.autopilot.guided_target(GuidedTarget(pos_ned_m=place))
        return Result.ACCEPTED if told else Result.FAILED

    def _home_item(self) -> MissionItem:
        lat, lon, alt_mm = global_int(self.onboard.autopilot.home_ned_m)
        waypoint = mavlink.MAV_CMD_NAV_WAYPOINT
        return MissionItem(mavlink.MAV_FRAME_GLOBAL, waypoint, 0, 1, (0.0, 0.0, 0.0, 0.0), lat, lon, 1e-3 * alt_mm)

    def _on_param_list(self, frame: Frame, message: Any) -> None:
        self._say(mavlink.MAV_SEVERITY_INFO, "ArduCopter V4.7.0-dev")
        super()._on_param_list(frame, message)

    def _on_request_data_stream(self, frame: Frame, message: Any) -> None:
        rate_hz = int(message.req_message_rate) if message.start_stop == 1 else 0
        wanted = int(message.req_stream_id)
        interval_us = 1000 * max(_FASTEST_MS, 1000 // rate_hz) if rate_hz > 0 else 0
        for group, msg_ids in _GROUPS.items():
            if wanted in (group, mavlink.MAV_DATA_STREAM_ALL):
                for stream in map(self.streams.get, msg_ids):
                    if stream is not None:
                        stream.interval_us = interval_us


def local_target_of(message: Any, pos_ned_m: Vec3, yaw_rad: float) -> GuidedTarget | None:
    """Read SET_POSITION_TARGET_LOCAL_NED as Copter does.

    Parameters
    ----------
    message : SET_POSITION_TARGET_LOCAL_NED
        From the link.
    pos_ned_m : (3,)
        The vehicle's position, which positions count from in every frame but LOCAL_NED.
    yaw_rad : float
        Its heading, by which everything is turned in the frames BODY_NED and BODY_OFFSET_NED.

    Returns
    -------
    GuidedTarget or None
        None if Copter stops at it: an unknown frame, FORCE, a velocity that is none, or groups that do not go
        together.

    Notes
    -----
    One ignored axis drops its whole group. Position alone, acceleration alone, and velocity with or without position
    and with or without acceleration go together.
    """
    if message.coordinate_frame not in _LOCAL_FRAMES:
        return None
    groups = _groups(message)
    if groups is None:
        return None
    uses_pos, vel, acc = groups
    turns = message.coordinate_frame in _BODY_FRAMES
    pos: Vec3 | None = None
    if uses_pos:
        pos = (float(message.x), float(message.y), float(message.z))
        if not all(map(isfinite, pos)):
            return None
        if turns:
            pos = _turned(pos, yaw_rad)
        if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
            pos = (pos[0] + pos_ned_m[0], pos[1] + pos_ned_m[1], pos[2] + pos_ned_m[2])
    if turns:
        vel = _turned(vel, yaw_rad) if vel is not None else None
        acc = _turned(acc, yaw_rad) if acc is not None else None
    return _target(message, pos, vel, acc, yaw_is_relative=turns)


def global_target_of(message: Any, home_down_m: float) -> GuidedTarget | None:
    """Read SET_POSITION_TARGET_GLOBAL_INT as Copter does.

    Parameters
    ----------
    message : SET_POSITION_TARGET_GLOBAL_INT
        From the link; velocity and acceleration are local ned.
    home_down_m : float
        Home in the local frame, for altitudes above it.

    Returns
    -------
    GuidedTarget or None
        None if Copter stops at it; an altitude above the terrain is one of these, as there is no terrain data.
    """
    groups = _groups(message)
    if groups is None:
        return None
    uses_pos, vel, acc = groups
    pos: Vec3 | None = None
    if uses_pos:
        frame = int(message.coordinate_frame)
        pos = _place_of(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt, frame, home_down_m)
        if pos is None:
            return None
        if vel is not None:
            acc = None  # what Copter passes on here is position and velocity
    return _target(message, pos, vel, acc, yaw_is_relative=False)


def attitude_target_of(
    message: Any, climb_mps: tuple[float, float], *, thrust_is_thrust: bool
) -> AttitudeSetpoint | None:
    """Read SET_ATTITUDE_TARGET as Copter does.

    Parameters
    ----------
    message : SET_ATTITUDE_TARGET
        From the link.
    climb_mps : (2,)
        Climb that a thrust of 1 stands for and descent that 0 stands for; 0.5 holds the altitude.
    thrust_is_thrust : bool
        The thrust is a thrust (bit 3 of GUID_OPTIONS).

    Returns
    -------
    AttitudeSetpoint or None
        None if Copter stops at it: no thrust, an attitude that is no unit quaternion, or some of the rates only.
    """
    mask = int(message.type_mask)
    if mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE or not isfinite(message.thrust):
        return None
    attitude = None
    if not mask & mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
        w, x, y, z = (float(value) for value in message.q)
        norm = sqrt(w * w + x * x + y * y + z * z)
        if not abs(norm - 1.0) < 1e-3:
            return None
        attitude = (w / norm, x / norm, y / norm, z / norm)
    rates = (0.0, 0.0, 0.0)
    if mask & 0b111 == 0:
        rates = (float(message.body_roll_rate), float(message.body_pitch_rate), float(message.body_yaw_rate))
    elif mask & 0b111 != 0b111:
        return None
    if not all(map(isfinite, rates)):
        return None
    if thrust_is_thrust:
        return AttitudeSetpoint(attitude, rates, max(0.0, min(1.0, float(message.thrust))))
    share = 2.0 * max(0.0, min(1.0, float(message.thrust))) - 1.0
    return AttitudeSetpoint(attitude, rates, None, share * climb_mps[0 if share > 0.0 else 1])


def _groups(message: Any) -> tuple[bool, Vec3 | None, Vec3 | None] | None:
    """Whether the position is used, the velocity and the acceleration; None if one of them cannot be."""
    mask = int(message.type_mask)
    vel = acc = None
    if not mask & _VEL:
        vel = (float(message.vx), float(message.vy), float(message.vz))
        if not all(abs(value) <= _SPEED_MAX for value in vel):
            return None
    if not mask & _ACC:
        acc = (float(message.afx), float(message.afy), float(message.afz))
        if mask & _FORCE or not all(abs(value) <= _SPEED_MAX for value in acc):
            return None
    return not mask & _POS, vel, acc


def _target(
    message: Any, pos: Vec3 | None, vel: Vec3 | None, acc: Vec3 | None, *, yaw_is_relative: bool
) -> GuidedTarget | None:
    mask = int(message.type_mask)
    if (pos is None and vel is None and acc is None) or (pos is not None and vel is None and acc is not None):
        return None
    yaw = None if mask & _YAW or not isfinite(message.yaw) else float(message.yaw)
    rate = None if mask & _YAW_RATE or not isfinite(message.yaw_rate) else float(message.yaw_rate)
    return GuidedTarget(pos, vel, acc, yaw, rate, yaw_is_relative and yaw is not None)


def _place_of(
    latitude_deg: float, longitude_deg: float, altitude_m: float, frame: int, home_down_m: float
) -> Vec3 | None:
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0 and isfinite(altitude_m)):
        return None
    if frame in _ABSOLUTE_FRAMES:
        down = geodesy.ALTITUDE_M - altitude_m
    elif frame in _RELATIVE_FRAMES:
        down = home_down_m - altitude_m
    else:
        return None
    return (*geodesy.local_of(latitude_deg, longitude_deg), down)


def _turned(vector: Vec3, yaw_rad: float) -> Vec3:
    """Turn from the heading's frame into ned."""
    c, s = cos(yaw_rad), sin(yaw_rad)
    return (c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2])
