"""The simulated autopilot as a MAVLink peer without I/O: what PX4 v1.16 does on its onboard link."""

import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import asin, atan2, cos, degrees, hypot, isfinite, nan, pi, radians
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.codec import Codec, Frame
from swingd.model.actions import SwingReport
from swingd.model.events import LandedState
from swingd.model.parameters import Parameters
from swingd.sim.autopilot import Answer, Autopilot, NavState
from swingd.sim.cascade import Axes, TrajectorySetpoint, yaw_of
from swingd.sim.plant import DT_S, Plant, Quaternion, Truth, rotation_matrix
from swingd.sim.px4_parameters import Px4Parameters
from swingd.sim.sensors import Battery, Sensors

SYSTEM_ID = 1
COMPONENT_ID = 1
GROUND_STATION_SYSTEM_ID = 255
GROUND_STATION_COMPONENT_ID = 190

_RECEIVE_DELAY_STEPS = 2  # PX4 reads its link in a thread of its own
_EARLY_PROBABILITY = 0.118  # PX4's sending thread runs before the newest sample is out: 250 Hz asked gives 224 Hz
_LOOP_DELAY_US = 1500
_REBOOT_S = 3.0
_FORCE_MAGIC = 21196.0
_REPORTS_MAX = 200_000

_HOME_LATITUDE_DEG = 47.397742
_HOME_LONGITUDE_DEG = 8.545594
_HOME_ALTITUDE_M = 488.0
_EARTH_RADIUS_M = 6371000.0
_MAGNETIC_NED_GAUSS = (0.21, 0.012, 0.43)

_MASK_FORCE = mavlink.POSITION_TARGET_TYPEMASK_FORCE_SET
_MASK_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_MASK_YAW_RATE = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE

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
_RESULT: dict[Answer, int] = {
    Answer.ACCEPTED: mavlink.MAV_RESULT_ACCEPTED,
    Answer.REJECTED: mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    Answer.DENIED: mavlink.MAV_RESULT_DENIED,
}
_LANDED = {
    LandedState.UNKNOWN: mavlink.MAV_LANDED_STATE_UNDEFINED,
    LandedState.ON_GROUND: mavlink.MAV_LANDED_STATE_ON_GROUND,
    LandedState.IN_AIR: mavlink.MAV_LANDED_STATE_IN_AIR,
    LandedState.TAKING_OFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    LandedState.LANDING: mavlink.MAV_LANDED_STATE_LANDING,
}
_HEALTHY = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
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
    mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: 0.0,
}
"""PX4's onboard link; 0 is off until asked for."""


@dataclass(slots=True)
class CompanionLog:
    """What a companion computer told the simulated autopilot."""

    reports: deque[SwingReport] = field(default_factory=lambda: deque(maxlen=_REPORTS_MAX))
    """What was published as DEBUG_FLOAT_ARRAY ``SWING``."""
    status_texts: deque[tuple[float, int, str]] = field(default_factory=lambda: deque(maxlen=1000))
    """Time, severity and text of each STATUSTEXT."""
    heartbeat_t_s: float = nan
    """Time of the last HEARTBEAT, nan before the first."""
    setpoints: int = 0
    """Setpoints that were understood."""
    setpoints_refused: int = 0
    """Setpoints with a frame or mask that PX4 refuses."""


@dataclass(slots=True)
class _Stream:
    """One outgoing message and its rate."""

    build: Callable[[], Any]
    interval_us: int
    last_us: int = -(10**9)
    data_us: int = -1
    """Stamp of what was sent last."""


class SimulatedAutopilot:
    """PX4 with a multirotor and a slung load, seen from its MAVLink link.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, payload, cable, thrust curve and simulation.
    px4_parameters : mapping, optional
        PX4's own parameters other than the defaults, by name.

    Raises
    ------
    ConfigurationError
        If the cable cannot be simulated.
    KeyError
        If a PX4 parameter is unknown.

    Notes
    -----
    Deterministic: the same parameters and the same bytes at the same times give the same frames.
    """

    def __init__(self, parameters: Parameters, px4_parameters: Mapping[str, float] | None = None) -> None:
        simulation = parameters.simulation
        self.px4 = Px4Parameters({"MIS_TAKEOFF_ALT": simulation.takeoff_altitude_m, **(px4_parameters or {})})
        """PX4's parameters."""
        self.plant = Plant(parameters)
        """The truth."""
        self.battery = Battery(simulation)
        self.autopilot = Autopilot(parameters, self.px4)
        """Modes and control loops."""
        self.companion = CompanionLog()
        """What was received from companions."""
        self._parameters = parameters
        self._sensors = Sensors(simulation)
        self._sensed = self._sensors.step(self.plant.state, self.plant.output)
        self._random = np.random.default_rng((simulation.seed, 3))
        self._early: list[bool] = []
        self._codec = Codec(SYSTEM_ID, COMPONENT_ID)
        self._ground_station = Codec(GROUND_STATION_SYSTEM_ID, GROUND_STATION_COMPONENT_ID)
        self._inbox: deque[tuple[int, Frame]] = deque()
        self._outbox: list[bytes] = []
        self._steps = 0
        self._boot_step = 0
        self._silent_until_step = 0
        self._params_to_send: deque[int] = deque()
        self._param_names = sorted(self.px4)
        self._heartbeat_us = -(10**9)
        self._data_us = 0
        self._streams = self._default_streams()
        self._handlers: dict[int, Callable[[Frame, Any], None]] = {
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command_long,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command_int,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_param_list,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_param_read,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._on_param_set,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_mission_list,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY: self._on_debug_array,
            mavlink.MAVLINK_MSG_ID_STATUSTEXT: self._on_status_text,
        }

    @property
    def t_s(self) -> float:
        """Simulated time since the start [s]; a reboot does not set it back."""
        return self._steps * DT_S

    @property
    def t_boot_s(self) -> float:
        """Simulated time since the autopilot's boot [s], which its stamps count."""
        return (self._steps - self._boot_step) * DT_S

    def truth(self) -> Truth:
        """Describe the present instant; its time is the autopilot's boot time."""
        return self.plant.truth(self.t_boot_s)

    def receive(self, data: bytes) -> None:
        """Take bytes from the link; they take effect when PX4 would have read them, 8 ms later. Never raises."""
        due = self._steps + _RECEIVE_DELAY_STEPS
        for frame in self._codec.receive(data):
            self._inbox.append((due, frame))

    def advance(self, t_s: float) -> list[bytes]:
        """Simulate up to ``t_s`` (see `t_s`) and return the frames that were sent on the way, in order."""
        target = round(t_s / DT_S)
        while self._steps < target:
            self._step()
        frames, self._outbox = self._outbox, []
        return frames

    def send_to_companion(self, message: Any) -> None:
        """Put a message of pymavlink on the link as a ground station behind the autopilot would (system 255)."""
        self._outbox.append(self._ground_station.encode(message))

    def reboot(self) -> None:
        """Restart the autopilot: silence for 3 s, then a clock from zero and default streams; parameters stay."""
        self.autopilot = Autopilot(self._parameters, self.px4)
        self._boot_step = self._steps
        self._silent_until_step = self._steps + round(_REBOOT_S / DT_S)
        self._inbox.clear()
        self._params_to_send.clear()
        self._streams = self._default_streams()
        self._heartbeat_us = -(10**9)
        self._data_us = 0
        self._codec = Codec(SYSTEM_ID, COMPONENT_ID)

    # ------------------------------------------------------------------ time

    def _step(self) -> None:
        """One IMU sample: read the link, fly, send what is due."""
        self._steps += 1
        inbox = self._inbox
        while inbox and inbox[0][0] <= self._steps:
            self._handle(inbox.popleft()[1])
        early = self._is_early()
        if early:
            self._send_due()
        autopilot = self.autopilot
        voltage_v = self.battery.voltage_v
        rotors = autopilot.step(self._sensed)
        armed = autopilot.armed
        self.plant.step(rotors, voltage_v, spinning=armed)
        self.battery.step(DT_S, armed=armed)
        self._sensed = self._sensors.step(self.plant.state, self.plant.output)
        self._data_us = self._now_us()
        if not early:
            self._send_due()

    def _send_due(self) -> None:
        """One turn of PX4's sending thread; it sends what is due and newer than what it sent before."""
        if self._steps < self._silent_until_step:
            return
        now_us, data_us = self._now_us(), self._data_us
        if now_us - self._heartbeat_us >= 1_000_000:
            self._heartbeat_us = now_us
            self._send(self._heartbeat())
        for stream in self._streams.values():
            interval_us = stream.interval_us
            if interval_us <= 0:
                continue
            since_us = now_us - stream.last_us
            if since_us > interval_us - 3 * _LOOP_DELAY_US // 10 and data_us > stream.data_us:
                # PX4's rule: keep the average rate as long as the loop keeps up, else start anew from here.
                stream.last_us = stream.last_us + interval_us if 1.5 * interval_us > since_us else now_us
                stream.data_us = data_us
                self._send(stream.build())
        for _ in range(min(2, len(self._params_to_send))):
            self._send_param(self._params_to_send.popleft())

    def _is_early(self) -> bool:
        if not self._early:
            self._early = (self._random.random(1024) < _EARLY_PROBABILITY).tolist()
        return self._early.pop()

    def _now_us(self) -> int:
        return (self._steps - self._boot_step) * round(DT_S * 1e6)

    def _data_ms(self) -> int:
        return self._data_us // 1000

    def _send(self, message: Any) -> None:
        self._outbox.append(self._codec.encode(message))

    # --------------------------------------------------------------- streams

    def _default_streams(self) -> dict[int, _Stream]:
        builders: dict[int, Callable[[], Any]] = {
            mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: self._highres_imu,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude_quaternion,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: self._attitude_target,
            mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: self._servo_output,
            mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: self._actuator_output,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._position_target,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery_status,
        }
        return {
            msg_id: _Stream(builders[msg_id], round(1e6 / rate_hz) if rate_hz > 0.0 else 0)
            for msg_id, rate_hz in _DEFAULT_RATES_HZ.items()
        }

    def _heartbeat(self) -> Any:
        autopilot = self.autopilot
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

    def _highres_imu(self) -> Any:
        sensed = self._sensed
        acc, gyro = sensed.imu_acc_frd_mps2, sensed.imu_gyro_frd_radps
        rotation = rotation_matrix(*sensed.ned_from_frd)
        n, e, d = _MAGNETIC_NED_GAUSS
        mag = [rotation[0][i] * n + rotation[1][i] * e + rotation[2][i] * d for i in range(3)]
        altitude = _HOME_ALTITUDE_M - sensed.pos_ned_m[2]
        pressure = 1013.25 * (1.0 - 2.25577e-5 * altitude) ** 5.25588 if altitude < 20000.0 else 50.0
        return mavlink.MAVLink_highres_imu_message(self._data_us, *acc, *gyro, *mag, pressure, 0.0, altitude, 15.0, 63)

    def _attitude(self) -> Any:
        sensed = self._sensed
        roll, pitch, yaw = euler_rad(sensed.ned_from_frd)
        return mavlink.MAVLink_attitude_message(self._data_ms(), roll, pitch, yaw, *sensed.rates_frd_radps)

    def _attitude_quaternion(self) -> Any:
        sensed = self._sensed
        return mavlink.MAVLink_attitude_quaternion_message(
            self._data_ms(), *sensed.ned_from_frd, *sensed.rates_frd_radps
        )

    def _local_position(self) -> Any:
        sensed = self._sensed
        return mavlink.MAVLink_local_position_ned_message(self._data_ms(), *sensed.pos_ned_m, *sensed.vel_ned_mps)

    def _attitude_target(self) -> Any:
        autopilot = self.autopilot
        return mavlink.MAVLink_attitude_target_message(
            round(1e3 * autopilot.attitude_sp_t_s),
            0,
            autopilot.attitude_sp,
            *autopilot.rates_sp_frd_radps,
            autopilot.thrust_sp,
        )

    def _pwm(self) -> list[int]:
        autopilot = self.autopilot
        if not autopilot.armed:
            return [900] * 4
        return [1000 + round(1000.0 * rotor) for rotor in autopilot.rotors]

    def _servo_output(self) -> Any:
        return mavlink.MAVLink_servo_output_raw_message(
            round(1e6 * self.autopilot.outputs_t_s), 0, *self._pwm(), *([900] * 12)
        )

    def _actuator_output(self) -> Any:
        actuators = [float(pwm) for pwm in self._pwm()] + [900.0] * 12 + [0.0] * 16
        return mavlink.MAVLink_actuator_output_status_message(round(1e6 * self.autopilot.outputs_t_s), 16, actuators)

    def _position_target(self) -> Any:
        setpoint = self.autopilot.setpoint
        values = [
            value if value is not None else nan
            for group in (setpoint.pos_ned_m, setpoint.vel_ned_mps, setpoint.acc_ned_mps2)
            for value in group
        ]
        yaw = setpoint.yaw_rad if setpoint.yaw_rad is not None else nan
        yaw_rate = setpoint.yaw_rate_radps if setpoint.yaw_rate_radps is not None else nan
        return mavlink.MAVLink_position_target_local_ned_message(
            self._data_ms(), mavlink.MAV_FRAME_LOCAL_NED, 0, *values, yaw, yaw_rate
        )

    def _vfr_hud(self) -> Any:
        sensed = self._sensed
        vel = sensed.vel_ned_mps
        return mavlink.MAVLink_vfr_hud_message(
            0.0,
            hypot(vel[0], vel[1]),
            round(degrees(yaw_of(sensed.ned_from_frd))) % 360,
            round(100.0 * self.autopilot.thrust_sp),
            _HOME_ALTITUDE_M - sensed.pos_ned_m[2],
            -vel[2],
        )

    def _global_position(self) -> Any:
        sensed = self._sensed
        pos, vel = sensed.pos_ned_m, sensed.vel_ned_mps
        lat, lon, alt_mm = _geodetic(pos)
        return mavlink.MAVLink_global_position_int_message(
            self._data_ms(),
            lat,
            lon,
            alt_mm,
            _int32(1000.0 * (self.autopilot.home_ned_m[2] - pos[2])),
            _int16(100.0 * vel[0]),
            _int16(100.0 * vel[1]),
            _int16(100.0 * vel[2]),
            round(100.0 * (degrees(yaw_of(sensed.ned_from_frd)) % 360.0)) % 36000,
        )

    def _gps_raw(self) -> Any:
        sensed = self._sensed
        lat, lon, alt_mm = _geodetic(sensed.pos_ned_m)
        vel = sensed.vel_ned_mps
        course = degrees(atan2(vel[1], vel[0])) % 360.0
        return mavlink.MAVLink_gps_raw_int_message(
            self._data_us,
            mavlink.GPS_FIX_TYPE_3D_FIX,
            lat,
            lon,
            alt_mm,
            90,
            90,
            min(65534, round(100.0 * hypot(vel[0], vel[1]))),
            round(100.0 * course) % 36000,
            12,
        )

    def _sys_status(self) -> Any:
        battery = self.battery
        return mavlink.MAVLink_sys_status_message(
            _HEALTHY,
            _HEALTHY,
            _HEALTHY,
            100,
            min(65534, round(1000.0 * battery.voltage_v)),
            -1,
            round(100.0 * battery.remaining),
            *(0, 0, 0, 0, 0, 0),
        )

    def _battery_status(self) -> Any:
        battery = self.battery
        # The whole pack stands in the first cell's field, as PX4 does without cell voltages.
        voltages = [min(65534, round(1000.0 * battery.voltage_v))] + [65535] * 9
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            32767,
            voltages,
            -1,
            -1,
            -1,
            round(100.0 * battery.remaining),
            0,
            mavlink.MAV_BATTERY_CHARGE_STATE_OK,
        )

    def _extended_sys_state(self) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(
            mavlink.MAV_VTOL_STATE_UNDEFINED, _LANDED[self.autopilot.landed_state]
        )

    def _system_time(self) -> Any:
        return mavlink.MAVLink_system_time_message(0, self._data_ms())

    def _home_position(self) -> Any:
        home = self.autopilot.home_ned_m
        lat, lon, alt_mm = _geodetic(home)
        return mavlink.MAVLink_home_position_message(
            lat, lon, alt_mm, *home, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, self._data_us
        )

    def _autopilot_version(self) -> Any:
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES, _VERSION, _VERSION, _VERSION, 1, *([[0] * 8] * 3), 0, 0, 4987896448
        )

    # ---------------------------------------------------------------- inputs

    def _handle(self, frame: Frame) -> None:
        handler = self._handlers.get(frame.msg_id)
        if handler is None or (frame.system_id == SYSTEM_ID and frame.component_id == COMPONENT_ID):
            return
        message = frame.message
        if message is None:
            return
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if system not in (0, SYSTEM_ID) or component not in (0, COMPONENT_ID):
            return
        handler(frame, message)

    def _on_heartbeat(self, frame: Frame, message: Any) -> None:
        self.companion.heartbeat_t_s = self.t_boot_s

    def _on_debug_array(self, frame: Frame, message: Any) -> None:
        report = swing_message.decode(message)
        if report is not None:
            self.companion.reports.append(report)

    def _on_status_text(self, frame: Frame, message: Any) -> None:
        self.companion.status_texts.append((self.t_boot_s, int(message.severity), _text(message.text)))

    def _on_timesync(self, frame: Frame, message: Any) -> None:
        if message.tc1 == 0:
            self._send(mavlink.MAVLink_timesync_message(self._now_us() * 1000, message.ts1))

    def _on_mission_list(self, frame: Frame, message: Any) -> None:
        self._send(mavlink.MAVLink_mission_count_message(frame.system_id, frame.component_id, 0, message.mission_type))

    def _on_setpoint(self, frame: Frame, message: Any) -> None:
        setpoint = setpoint_of(message, self._sensed.ned_from_frd)
        if setpoint is None:
            self.companion.setpoints_refused += 1
            return
        self.companion.setpoints += 1
        self.autopilot.offboard_setpoint(setpoint)

    # ------------------------------------------------------------ parameters

    def _send_param(self, index: int) -> None:
        name = self._param_names[index]
        value = self.px4[name]
        if self.px4.is_int(name):
            # PX4 puts the integer's bytes into the float field.
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
            kind = mavlink.MAV_PARAM_TYPE_INT32
        else:
            kind = mavlink.MAV_PARAM_TYPE_REAL32
        self._send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self._param_names), index))

    def _on_param_list(self, frame: Frame, message: Any) -> None:
        self._params_to_send = deque(range(len(self._param_names)))

    def _on_param_read(self, frame: Frame, message: Any) -> None:
        index = int(message.param_index)
        if index < 0:
            name = _text(message.param_id)
            if name not in self.px4:
                return
            index = self._param_names.index(name)
        if index < len(self._param_names):
            self._send_param(index)

    def _on_param_set(self, frame: Frame, message: Any) -> None:
        name = _text(message.param_id)
        if name not in self.px4:
            return
        value = float(message.param_value)
        is_int = self.px4.is_int(name)
        kind = mavlink.MAV_PARAM_TYPE_INT32 if is_int else mavlink.MAV_PARAM_TYPE_REAL32
        if message.param_type == kind:
            if is_int:
                (value,) = struct.unpack("<i", struct.pack("<f", value))
            self.px4.set(name, value)
        self._send_param(self._param_names.index(name))

    # -------------------------------------------------------------- commands

    def _ack(self, frame: Frame, command: int, result: int) -> None:
        self._send(mavlink.MAVLink_command_ack_message(command, result, 0, 0, frame.system_id, frame.component_id))

    def _on_set_mode(self, frame: Frame, message: Any) -> None:
        custom = int(message.custom_mode)
        self._request_mode(custom >> 16 & 0xFF, custom >> 24 & 0xFF)

    def _on_command_int(self, frame: Frame, message: Any) -> None:
        params = (
            message.param1,
            message.param2,
            message.param3,
            message.param4,
            message.x * 1e-7,
            message.y * 1e-7,
            message.z,
        )
        self._on_command(frame, int(message.command), params)

    def _on_command_long(self, frame: Frame, message: Any) -> None:
        params = (
            message.param1,
            message.param2,
            message.param3,
            message.param4,
            message.param5,
            message.param6,
            message.param7,
        )
        self._on_command(frame, int(message.command), params)

    def _on_command(self, frame: Frame, command: int, params: tuple[float, ...]) -> None:
        result = self._execute(command, params)
        self._ack(frame, command, result)
        if result == mavlink.MAV_RESULT_ACCEPTED and command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            self.reboot()

    def _execute(self, command: int, p: tuple[float, ...]) -> int:
        """Do what a command asks and give its MAV_RESULT."""
        autopilot = self.autopilot
        if command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            force = p[1] == _FORCE_MAGIC
            if p[0] == 1.0:
                return _RESULT[autopilot.arm()]
            return _RESULT[autopilot.disarm(force=force)] if p[0] == 0.0 else int(mavlink.MAV_RESULT_DENIED)
        if command == mavlink.MAV_CMD_DO_SET_MODE:
            return self._request_mode(_integer(p[1]), _integer(p[2]))
        if command == mavlink.MAV_CMD_NAV_TAKEOFF:
            height = p[6] - _HOME_ALTITUDE_M + autopilot.home_ned_m[2] if isfinite(p[6]) else None
            return _RESULT[autopilot.take_off(height)]
        if command == mavlink.MAV_CMD_NAV_LAND:
            return _RESULT[autopilot.request_mode(NavState.LAND)]
        if command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return _RESULT[autopilot.request_mode(NavState.RTL)]
        if command == mavlink.MAV_CMD_DO_REPOSITION:
            return self._reposition(p)
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(p)
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return self._request_message(_integer(p[0]))
        if command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return self._request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            if autopilot.armed or p[0] != 1.0:
                return int(mavlink.MAV_RESULT_DENIED)
            return int(mavlink.MAV_RESULT_ACCEPTED)
        return int(mavlink.MAV_RESULT_UNSUPPORTED)

    def _request_mode(self, main: int, sub: int) -> int:
        mode = _MODE_OF.get((main, sub if main == _AUTO else 0))
        if mode is None:
            # Modes that need a remote control, which this vehicle does not have, and unknown ones.
            return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        return _RESULT[self.autopilot.request_mode(mode)]

    def _reposition(self, p: tuple[float, ...]) -> int:
        north = east = down = None
        if isfinite(p[4]) and isfinite(p[5]) and abs(p[4]) <= 90.0 and abs(p[5]) <= 180.0 and (p[4] or p[5]):
            north = radians(p[4] - _HOME_LATITUDE_DEG) * _EARTH_RADIUS_M
            east = radians(p[5] - _HOME_LONGITUDE_DEG) * _EARTH_RADIUS_M * cos(radians(_HOME_LATITUDE_DEG))
        if isfinite(p[6]):
            down = _HOME_ALTITUDE_M - p[6]
        return _RESULT[self.autopilot.reposition((north, east, down), p[3] if isfinite(p[3]) else None)]

    def _set_interval(self, p: tuple[float, ...]) -> int:
        stream = self._streams.get(_integer(p[0]))
        if stream is None or not isfinite(p[1]):
            return int(mavlink.MAV_RESULT_FAILED)
        interval_us = round(p[1])
        if interval_us == 0:
            rate_hz = _DEFAULT_RATES_HZ[_integer(p[0])]
            stream.interval_us = round(1e6 / rate_hz) if rate_hz > 0.0 else 0
        else:
            stream.interval_us = max(interval_us, 0)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _request_message(self, msg_id: int) -> int:
        stream = self._streams.get(msg_id)
        if stream is not None:
            self._send(stream.build())
        elif msg_id == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self._send(self._autopilot_version())
        else:
            return int(mavlink.MAV_RESULT_DENIED)
        return int(mavlink.MAV_RESULT_ACCEPTED)


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
    pos = _axes((message.x, message.y, message.z), mask, 0)
    vel = _axes((message.vx, message.vy, message.vz), mask, 3)
    acc = _axes((message.afx, message.afy, message.afz), mask, 6)
    if message.coordinate_frame == mavlink.MAV_FRAME_BODY_NED:
        pos = (None, None, None)
        x, y, z = vel
        if x is None or y is None or z is None:
            vel = (None, None, None)
        else:
            yaw = yaw_of(ned_from_frd)
            rotation = ((cos(yaw), cos(yaw + 0.5 * pi)), (cos(yaw - 0.5 * pi), cos(yaw)))
            vel = (rotation[0][0] * x + rotation[0][1] * y, rotation[1][0] * x + rotation[1][1] * y, z)
        x, y, z = acc
        if x is None or y is None or z is None:
            acc = (None, None, None)
        else:
            rows = rotation_matrix(*ned_from_frd)
            turned = [row[0] * x + row[1] * y + row[2] * z for row in rows]
            acc = (turned[0], turned[1], turned[2])
    elif message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
        return None
    if all(value is None for value in pos + vel + acc):
        return None
    if mask & _MASK_FORCE and any(value is not None for value in acc):
        return None
    yaw_sp = None if mask & _MASK_YAW or not isfinite(message.yaw) else float(message.yaw)
    rate_sp = None if mask & _MASK_YAW_RATE or not isfinite(message.yaw_rate) else float(message.yaw_rate)
    return TrajectorySetpoint(pos, vel, acc, yaw_sp, rate_sp)


def euler_rad(q: Quaternion) -> tuple[float, float, float]:
    """Roll, pitch and yaw (3-2-1) of an attitude."""
    w, x, y, z = q
    return (
        atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
        yaw_of(q),
    )


def _axes(values: tuple[float, float, float], mask: int, shift: int) -> Axes:
    """Components that are meant, None for the others."""
    n, e, d = (
        None if mask >> (shift + i) & 1 or not isfinite(value) else float(value) for i, value in enumerate(values)
    )
    return (n, e, d)


def _geodetic(pos_ned_m: tuple[float, float, float]) -> tuple[int, int, int]:
    """Latitude and longitude [1e-7 deg] and altitude [mm] of a local position, on a sphere."""
    lat = _HOME_LATITUDE_DEG + degrees(pos_ned_m[0] / _EARTH_RADIUS_M)
    lon = _HOME_LONGITUDE_DEG + degrees(pos_ned_m[1] / _EARTH_RADIUS_M / cos(radians(_HOME_LATITUDE_DEG)))
    return _int32(lat * 1e7), _int32(lon * 1e7), _int32(1000.0 * (_HOME_ALTITUDE_M - pos_ned_m[2]))


def _int32(value: float) -> int:
    return max(-(2**31), min(2**31 - 1, round(value)))


def _int16(value: float) -> int:
    return max(-(2**15), min(2**15 - 1, round(value)))


def _integer(value: float) -> int:
    """Whole number in a command's float, -1 if it is none."""
    return int(value) if isfinite(value) and value == int(value) else -1


def _text(value: Any) -> str:
    """Text of a message's character field."""
    raw = value if isinstance(value, bytes) else str(value).encode("utf-8", "replace")
    return raw.split(b"\x00", 1)[0].decode("utf-8", "replace")
