"""PX4's face: what PX4 v1.16 does on its onboard link."""

from collections.abc import Collection, Mapping
from math import cos, isfinite, pi, sqrt
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.model.parameters import Parameters
from swingd.sim import geodesy
from swingd.sim.autopilot import Answer, Autopilot, NavState
from swingd.sim.cascade import AttitudeSetpoint, Axes, TrajectorySetpoint, yaw_of
from swingd.sim.face import FORCE_MAGIC, Command, CompanionLog, Face, Result, available, axes_of, whole
from swingd.sim.missions import Missions
from swingd.sim.onboard import Onboard
from swingd.sim.parameter_server import ParameterServer, Send
from swingd.sim.plant import Quaternion, rotation_matrix
from swingd.sim.px4_parameters import Px4Parameters
from swingd.sim.streams import Streams
from swingd.sim.telemetry import Telemetry

_MASK_FORCE = mavlink.POSITION_TARGET_TYPEMASK_FORCE_SET
_MASK_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_MASK_YAW_RATE = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_NONE: Axes = (None, None, None)

# PX4's custom mode: main << 16 | sub << 24.
_MANUAL, _POSCTL, _AUTO, _OFFBOARD = 1, 3, 4, 6
_CUSTOM_MODE = {
    NavState.MANUAL: (_MANUAL, 0),
    NavState.POSCTL: (_POSCTL, 0),
    NavState.TAKEOFF: (_AUTO, 2),
    NavState.LOITER: (_AUTO, 3),
    NavState.RTL: (_AUTO, 5),
    NavState.LAND: (_AUTO, 6),
    NavState.OFFBOARD: (_OFFBOARD, 0),
    NavState.DESCEND: (_AUTO, 6),
}
_MODE_OF = {
    (_POSCTL, 0): NavState.POSCTL,
    (_AUTO, 2): NavState.TAKEOFF,
    (_AUTO, 3): NavState.LOITER,
    (_AUTO, 5): NavState.RTL,
    (_AUTO, 6): NavState.LAND,
    (_OFFBOARD, 0): NavState.OFFBOARD,
}
_RESULT: dict[Answer, Result] = {
    Answer.ACCEPTED: Result.ACCEPTED,
    Answer.REJECTED: Result.TEMPORARILY_REJECTED,
    Answer.DENIED: Result.DENIED,
}
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION = 1 << 24 | 16 << 16 | 0 << 8 | 255  # v1.16.0, release

_DEFAULT_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 50.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10.0,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 10.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 20.0,
}
"""PX4's onboard link; what is not named here is off until asked for."""


class Px4(Face):
    """PX4 v1.16.

    Parameters
    ----------
    parameters : Parameters
        The vehicle and the simulation.
    changes : mapping
        PX4's own parameters other than the defaults.
    companion : CompanionLog
        Where setpoints are counted.
    send : callable
        Takes each message that leaves.
    without : collection of int
        Message ids that this autopilot is not to have.
    """

    early_probability = 0.118  # 250 Hz asked gives 224 Hz
    pass_unsigned = (
        mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
        mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
        mavlink.MAVLINK_MSG_ID_COLLISION,
    )
    strangers = (
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_PARAM_SET,
        mavlink.MAVLINK_MSG_ID_MISSION_COUNT,
        mavlink.MAVLINK_MSG_ID_MISSION_ITEM,
        mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
        mavlink.MAVLINK_MSG_ID_MISSION_SET_CURRENT,
    )
    failed = Result.DENIED

    def __init__(
        self,
        parameters: Parameters,
        changes: Mapping[str, float],
        companion: CompanionLog,
        send: Send,
        without: Collection[int],
    ) -> None:
        table = Px4Parameters({"MIS_TAKEOFF_ALT": parameters.simulation.takeoff_altitude_m, **changes})
        super().__init__(Onboard(parameters, lambda: Autopilot(parameters, table)), companion, send)
        self.parameters = self.loops = table
        self.parameter_server = ParameterServer(table, send)
        self.missions = Missions(send)
        telemetry = Telemetry(self.onboard)
        builders = {
            mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: telemetry.highres_imu,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: telemetry.attitude,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: telemetry.attitude_quaternion,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: telemetry.local_position,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: telemetry.attitude_target,
            mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: telemetry.servo_output,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: telemetry.position_target,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: telemetry.vfr_hud,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: telemetry.global_position,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: telemetry.gps_raw,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: telemetry.sys_status,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: telemetry.extended_sys_state,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: telemetry.system_time,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: telemetry.home_position,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: telemetry.battery_status,
            mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: telemetry.actuator_output,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: telemetry.global_origin,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS: telemetry.rc_channels,
        }
        self.streams = Streams(available(builders, without), _DEFAULT_RATES_HZ)

    def heartbeat(self) -> Any:
        """Make the HEARTBEAT."""
        autopilot = self.onboard.autopilot
        main, sub = _CUSTOM_MODE[autopilot.nav_state]
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if main == _AUTO:
            base |= (
                mavlink.MAV_MODE_FLAG_AUTO_ENABLED
                | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
                | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
            )
        elif main == _OFFBOARD:
            base |= mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        else:
            base |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        state = mavlink.MAV_STATE_STANDBY
        if autopilot.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = mavlink.MAV_STATE_CRITICAL if autopilot.failsafe else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, base, main << 16 | sub << 24, state, 3
        )

    def version(self) -> Any:
        """Make the AUTOPILOT_VERSION."""
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES, _VERSION, _VERSION, _VERSION, 1, *([[0] * 8] * 3), 0, 0, 4987896448
        )

    def set_interval(self, msg_id: int, interval_us: float) -> Result:
        """Change a stream's interval; 0 is the default, a negative one switches off."""
        stream = self.streams.get(msg_id)
        if stream is None or not isfinite(interval_us):
            return Result.FAILED
        wanted_us = round(interval_us)
        stream.interval_us = stream.default_us if wanted_us == 0 else max(wanted_us, 0)
        return Result.ACCEPTED

    def set_mode(self, base_mode: int, custom_mode: int) -> Result:
        """Do what SET_MODE asks."""
        return self._request_mode(custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)

    def execute(self, command: Command) -> Result:
        """Do what a command asks and give its MAV_RESULT."""
        autopilot, p = self.onboard.autopilot, command.params
        if command.number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            if p[0] == 1.0:
                return _RESULT[autopilot.arm()]
            return _RESULT[autopilot.disarm(force=p[1] == FORCE_MAGIC)] if p[0] == 0.0 else Result.DENIED
        if command.number == mavlink.MAV_CMD_DO_SET_MODE:
            return self._request_mode(whole(p[1]), whole(p[2]))
        if command.number == mavlink.MAV_CMD_NAV_TAKEOFF:
            height = p[6] - geodesy.ALTITUDE_M + autopilot.home_ned_m[2] if isfinite(p[6]) else None
            return _RESULT[autopilot.take_off(height)]
        if command.number == mavlink.MAV_CMD_NAV_LAND:
            return _RESULT[autopilot.request_mode(NavState.LAND)]
        if command.number == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return _RESULT[autopilot.request_mode(NavState.RTL)]
        if command.number == mavlink.MAV_CMD_DO_REPOSITION:
            return self._reposition(p)
        return Result.UNSUPPORTED

    def local_target(self, message: Any) -> bool:
        """Take SET_POSITION_TARGET_LOCAL_NED; False if it is refused."""
        setpoint = setpoint_of(message, self.onboard.sensed.ned_from_frd)
        return self._take(setpoint)

    def global_target(self, message: Any) -> bool:
        """Take SET_POSITION_TARGET_GLOBAL_INT; False if it is refused."""
        return self._take(global_setpoint_of(message, self.onboard.autopilot.home_ned_m[2]))

    def attitude_target(self, message: Any) -> bool:
        """Take SET_ATTITUDE_TARGET; False if it is refused."""
        return self._take(attitude_setpoint_of(message))

    def _take(self, setpoint: TrajectorySetpoint | AttitudeSetpoint | None) -> bool:
        if setpoint is not None:
            self.onboard.autopilot.offboard_setpoint(setpoint)
        return setpoint is not None

    def _request_mode(self, main: int, sub: int) -> Result:
        mode = _MODE_OF.get((main, sub if main == _AUTO else 0))
        if mode is None:
            # Modes that need a remote control or a mission, neither of which is flown here, and unknown ones.
            return Result.TEMPORARILY_REJECTED
        return _RESULT[self.onboard.autopilot.request_mode(mode)]

    def _reposition(self, p: tuple[float, ...]) -> Result:
        north = east = down = None
        if isfinite(p[4]) and isfinite(p[5]) and abs(p[4]) <= 90.0 and abs(p[5]) <= 180.0 and (p[4] or p[5]):
            north, east = geodesy.local_of(p[4], p[5])
        if isfinite(p[6]):
            down = geodesy.ALTITUDE_M - p[6]
        return _RESULT[self.onboard.autopilot.reposition((north, east, down), p[3] if isfinite(p[3]) else None)]


def setpoint_of(message: Any, ned_from_frd: Quaternion) -> TrajectorySetpoint | None:
    """Read SET_POSITION_TARGET_LOCAL_NED as PX4 does.

    Parameters
    ----------
    message : SET_POSITION_TARGET_LOCAL_NED
        From the link; non-finite components count as ignored.
    ned_from_frd : (4,)
        The vehicle's attitude, for setpoints in BODY_NED.

    Returns
    -------
    TrajectorySetpoint or None
        None if PX4 refuses it: another frame than LOCAL_NED or BODY_NED, FORCE, or nothing asked for.

    Notes
    -----
    In LOCAL_NED every axis of every group may be ignored on its own. In BODY_NED an ignored axis drops its whole
    group, positions are not used, velocity is turned by yaw alone and acceleration by the full attitude.
    """
    mask = int(message.type_mask)
    pos = axes_of((message.x, message.y, message.z), mask, 0)
    vel = axes_of((message.vx, message.vy, message.vz), mask, 3)
    acc = axes_of((message.afx, message.afy, message.afz), mask, 6)
    if message.coordinate_frame == mavlink.MAV_FRAME_BODY_NED:
        pos = _NONE
        x, y, z = vel
        if x is None or y is None or z is None:
            vel = _NONE
        else:
            yaw = yaw_of(ned_from_frd)
            rotation = ((cos(yaw), cos(yaw + 0.5 * pi)), (cos(yaw - 0.5 * pi), cos(yaw)))
            vel = (rotation[0][0] * x + rotation[0][1] * y, rotation[1][0] * x + rotation[1][1] * y, z)
        x, y, z = acc
        if x is None or y is None or z is None:
            acc = _NONE
        else:
            rows = rotation_matrix(*ned_from_frd)
            turned = [row[0] * x + row[1] * y + row[2] * z for row in rows]
            acc = (turned[0], turned[1], turned[2])
    elif message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
        return None
    return _with_yaw(message, pos, vel, acc)


def global_setpoint_of(message: Any, home_down_m: float) -> TrajectorySetpoint | None:
    """Read SET_POSITION_TARGET_GLOBAL_INT as PX4 does.

    Parameters
    ----------
    message : SET_POSITION_TARGET_GLOBAL_INT
        From the link; non-finite components count as ignored.
    home_down_m : float
        Home in the local frame, for altitudes above it.

    Returns
    -------
    TrajectorySetpoint or None
        None if PX4 refuses it: a position in another frame than GLOBAL_INT or GLOBAL_RELATIVE_ALT_INT (an altitude
        above the terrain needs an estimate of it, which this vehicle does not have), FORCE, or nothing asked for.

    Notes
    -----
    One ignored axis drops the whole position, and the frame with it; velocity and acceleration are local ned and may
    be ignored by axis.
    """
    mask = int(message.type_mask)
    pos = _NONE
    if not mask & 0b111:
        if message.coordinate_frame == mavlink.MAV_FRAME_GLOBAL_INT:
            down = geodesy.ALTITUDE_M - message.alt
        elif message.coordinate_frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT:
            down = home_down_m - message.alt
        else:
            return None
        north, east = geodesy.local_of(message.lat_int * 1e-7, message.lon_int * 1e-7)
        pos = (north, east, down if isfinite(down) else None)
    vel = axes_of((message.vx, message.vy, message.vz), mask, 3)
    acc = axes_of((message.afx, message.afy, message.afz), mask, 6)
    return _with_yaw(message, pos, vel, acc)


def _with_yaw(message: Any, pos: Axes, vel: Axes, acc: Axes) -> TrajectorySetpoint | None:
    mask = int(message.type_mask)
    if all(value is None for value in pos + vel + acc):
        return None
    if mask & _MASK_FORCE and any(value is not None for value in acc):
        return None
    yaw_sp = None if mask & _MASK_YAW or not isfinite(message.yaw) else float(message.yaw)
    rate_sp = None if mask & _MASK_YAW_RATE or not isfinite(message.yaw_rate) else float(message.yaw_rate)
    return TrajectorySetpoint(pos, vel, acc, yaw_sp, rate_sp)


def attitude_setpoint_of(message: Any) -> AttitudeSetpoint | None:
    """Read SET_ATTITUDE_TARGET as PX4 does.

    Returns
    -------
    AttitudeSetpoint or None
        None if neither an attitude nor roll and pitch rates are given, or something that is used is not finite.

    Notes
    -----
    An ignored thrust is none. With an attitude only the yaw rate is used besides it.
    """
    mask = int(message.type_mask)
    ignored = [mask >> i & 1 for i in range(3)]
    rates = [
        0.0 if no else float(rate)
        for no, rate in zip(
            ignored, (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate), strict=True
        )
    ]
    thrust = 0.0 if mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE else float(message.thrust)
    if not all(isfinite(value) for value in (*rates, thrust)):
        return None
    if mask & mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE:
        if ignored[0] or ignored[1]:
            return None
        return AttitudeSetpoint(None, (rates[0], rates[1], rates[2]), thrust)
    norm = sqrt(sum(float(value) ** 2 for value in message.q))
    if not isfinite(norm) or norm < 1e-6:
        return None
    w, x, y, z = (float(value) / norm for value in message.q)
    return AttitudeSetpoint((w, x, y, z), (0.0, 0.0, rates[2]), thrust)
