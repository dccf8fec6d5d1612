"""The autopilot's samples: its messages in their units and with their stamps become events in SI units on one clock."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.link.setpoints import ACC_MAX_MPS2, POS_MAX_M, VEL_MAX_MPS, GeodeticPoint, VehicleView
from swingd.link.stamps import Drop, Stamps
from swingd.link.streams import StreamRequests
from swingd.model.errors import ConfigurationError
from swingd.model.events import (
    Attitude,
    AutopilotKind,
    Battery,
    Event,
    Imu,
    Landed,
    LandedState,
    LocalPosition,
    Motors,
    Stream,
    Throttle,
    Vec3,
)
from swingd.model.parameters import Thrust

_PREFERRED_FOR_S = 1.0
_BATTERY_FOR_S = 5.0

_FROZEN_S = 0.1
"""An inertial reading that has not changed for longer is not one; coarse units may repeat it a few times."""
_GYRO_MAX_RADPS = 200.0
_ANGLE_MAX_RAD = 2.0 * math.pi + 1e-3
_MPS2_PER_MG = 9.80665e-3

_IMU_IDS: tuple[int, ...] = (
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
    mavlink.MAVLINK_MSG_ID_RAW_IMU,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU,
)
"""The messages that can carry the IMU of an ArduPilot, the best first."""

_LANDED = {
    mavlink.MAV_LANDED_STATE_ON_GROUND: LandedState.ON_GROUND,
    mavlink.MAV_LANDED_STATE_IN_AIR: LandedState.IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF: LandedState.TAKING_OFF,
    mavlink.MAV_LANDED_STATE_LANDING: LandedState.LANDING,
}


@dataclass(slots=True)
class _State:
    """What is known of one life of the autopilot; void after its restart."""

    driven: tuple[int, ...]
    view: VehicleView = field(default_factory=VehicleView)
    imu_t_mono_s: list[float | None] = field(default_factory=lambda: [None] * len(_IMU_IDS))
    """Last arrival of each message that can carry the IMU, the best first."""
    imu_reading: tuple[Vec3, Vec3] | None = None
    imu_changed_s: float = -math.inf
    """When it last differed from the one before."""
    attitude_t_mono_s: float = -math.inf
    attitude_target_t_mono_s: float = -math.inf
    actuator_t_mono_s: float = -math.inf
    battery_t_mono_s: float = -math.inf
    battery_0_t_mono_s: float = -math.inf


class Telemetry:
    """Turns the messages by which an autopilot describes itself into events.

    Parameters
    ----------
    thrust : Thrust
        ``motor_output_min``, ``motor_output_max`` and ``motor_count`` normalise the motor outputs.
    requests : StreamRequests
        Knows what the autopilot denied; told when it restarts.

    Raises
    ------
    ConfigurationError
        If ``motor_output_min`` equals ``motor_output_max``.

    Notes
    -----
    Of several messages that carry the same, only the best that comes is used.
    """

    def __init__(self, thrust: Thrust, requests: StreamRequests) -> None:
        self.configure_motors(thrust)
        self.kind = AutopilotKind.OTHER
        """Whose messages they are."""
        self.drops: Counter[Drop] = Counter()
        """What was not used, by reason."""
        self.received: Counter[Stream] = Counter()
        """Samples that became events."""
        self._requests = requests
        self._stamps = Stamps(self.drops, self.received, self._restarted)
        self._state = self._anew()

    @property
    def view(self) -> VehicleView:
        """What the autopilot told of itself since it started, as far as its reading of setpoints depends on it."""
        return self._state.view

    def configure_motors(self, thrust: Thrust) -> None:
        """Take how motor outputs are normalised.

        Raises
        ------
        ConfigurationError
            If ``motor_output_min`` equals ``motor_output_max``.
        """
        span = thrust.motor_output_max - thrust.motor_output_min
        if span == 0.0:
            raise ConfigurationError(
                f"thrust.motor_output_max: {thrust.motor_output_max} equals thrust.motor_output_min; "
                "expected the outputs that mean full and no thrust"
            )
        self._motor_min = thrust.motor_output_min
        self._motor_gain = 1.0 / span
        self._motor_low = min(thrust.motor_output_min, thrust.motor_output_max)
        self._motor_high = max(thrust.motor_output_min, thrust.motor_output_max)
        self._motor_count = thrust.motor_count

    @property
    def newest_s(self) -> float | None:
        """The autopilot's newest stamp [s]; None before its first."""
        return self._stamps.newest_s

    def disarmed(self) -> None:
        """Forget which outputs drive motors: they are found anew at the next arming."""
        if not self._motor_count:
            self._state.driven = ()

    def take(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        """Take a frame of the autopilot, one of `TELEMETRY_IDS`, and add its events; never raises."""
        _HANDLERS[frame.msg_id](self, t_mono_s, frame.message, events)

    def _anew(self) -> _State:
        return _State(driven=tuple(range(self._motor_count)))

    def _restarted(self) -> None:
        self._state = self._anew()
        self._requests.restarted()

    def _highres_imu(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        # ArduPilot gives its primary sensor, whose number need not be 0.
        if (m.id == 0 or self.kind is AutopilotKind.ARDUPILOT) and self._is_imu(t_mono_s, m.get_msgId()):
            self._emit_imu(t_mono_s, (m.xacc, m.yacc, m.zacc), (m.xgyro, m.ygyro, m.zgyro), m.time_usec, events)

    def _raw_imu(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if m.id == 0 and self._is_imu(t_mono_s, m.get_msgId()):
            self._emit_imu(t_mono_s, *_scaled(m), m.time_usec, events)

    def _scaled_imu(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if self._is_imu(t_mono_s, m.get_msgId()):
            self._emit_imu(t_mono_s, *_scaled(m), m.time_boot_ms * 1000, events)

    def _is_imu(self, t_mono_s: float, msg_id: int) -> bool:
        """Whether samples are taken from this message: only from the best that comes, so that two never mix."""
        if self.kind is not AutopilotKind.ARDUPILOT:
            # RAW_IMU of others is in units of its own, and their HIGHRES_IMU always comes.
            return msg_id == _IMU_IDS[0]
        last_s = self._state.imu_t_mono_s
        rank = _IMU_IDS.index(msg_id)
        last_s[rank] = t_mono_s
        best = True
        for better in range(rank):
            if self._requests.denied(_IMU_IDS[better]):
                continue
            better_s = last_s[better]
            if better_s is None:
                # Whether it comes is not known yet.
                better_s = last_s[better] = t_mono_s
            best &= t_mono_s - better_s >= _PREFERRED_FOR_S
        return best

    def _emit_imu(self, t_mono_s: float, acc: Vec3, gyro: Vec3, time_usec: int, events: list[Event]) -> None:
        if self.is_plausible(acc, ACC_MAX_MPS2) and self.is_plausible(gyro, _GYRO_MAX_RADPS):
            if self._is_frozen(t_mono_s, (acc, gyro)):
                self.drops[Drop.FROZEN] += 1
                return
            t_boot_s = self._stamps.usec(Stream.IMU, t_mono_s, time_usec, events)
            if t_boot_s is not None:
                events.append(Imu(t_mono_s, t_boot_s, acc, gyro))

    def _is_frozen(self, t_mono_s: float, reading: tuple[Vec3, Vec3]) -> bool:
        state = self._state
        if reading != state.imu_reading:
            state.imu_reading = reading
            state.imu_changed_s = t_mono_s
        return t_mono_s - state.imu_changed_s > _FROZEN_S

    def _attitude(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if self.is_plausible((m.roll, m.pitch, m.yaw), _ANGLE_MAX_RAD):
            t_boot_s = self._stamps.ms(Stream.ATTITUDE, t_mono_s, m.time_boot_ms, events)
            if t_boot_s is not None:
                self._state.attitude_t_mono_s = t_mono_s
                self._emit_attitude(Attitude(t_mono_s, t_boot_s, m.roll, m.pitch, m.yaw), events)

    def _attitude_quaternion(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if t_mono_s - self._state.attitude_t_mono_s < _PREFERRED_FOR_S:
            return
        w, x, y, z = q = (m.q1, m.q2, m.q3, m.q4)
        if not self.is_plausible(q, 1.1):
            return
        norm = w * w + x * x + y * y + z * z
        if not 0.9 < norm < 1.1:
            self.drops[Drop.IMPOSSIBLE] += 1
            return
        t_boot_s = self._stamps.ms(Stream.ATTITUDE, t_mono_s, m.time_boot_ms, events)
        if t_boot_s is not None:
            roll_rad = math.atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
            pitch_rad = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x) / norm)))
            yaw_rad = _yaw_rad(w, x, y, z)
            self._emit_attitude(Attitude(t_mono_s, t_boot_s, roll_rad, pitch_rad, yaw_rad), events)

    def _emit_attitude(self, attitude: Attitude, events: list[Event]) -> None:
        self._state.view.attitude = attitude
        events.append(attitude)

    def _attitude_target(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if not m.type_mask & mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE and all(map(math.isfinite, m.q)):
            self._state.view.heading_sp = (t_mono_s, _yaw_rad(*m.q))
        if m.type_mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
            return
        if not self.is_plausible((m.thrust,), math.inf):
            return
        if not -0.01 <= m.thrust <= 1.01:
            self.drops[Drop.IMPOSSIBLE] += 1
            return
        t_boot_s = self._stamps.ms(Stream.THROTTLE, t_mono_s, m.time_boot_ms, events)
        if t_boot_s is not None:
            self._state.attitude_target_t_mono_s = t_mono_s
            events.append(Throttle(t_mono_s, t_boot_s, max(0.0, min(1.0, m.thrust))))

    def _vfr_hud(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        """Take ArduPilot's throttle, a whole percent without a stamp, as a last resort."""
        if (
            self.kind is not AutopilotKind.ARDUPILOT
            or t_mono_s - self._state.attitude_target_t_mono_s < _PREFERRED_FOR_S
        ):
            return
        throttle = m.throttle * 1e-2
        if throttle > 1.0:
            self.drops[Drop.IMPOSSIBLE] += 1
            return
        t_boot_s = self._stamps.arrival(Stream.THROTTLE, t_mono_s)
        if t_boot_s is not None:
            events.append(Throttle(t_mono_s, t_boot_s, throttle))

    def _actuator_output_status(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        outputs = self._motor_outputs(m.actuator)
        if outputs is not None:
            self._state.actuator_t_mono_s = t_mono_s
        if outputs:
            t_boot_s = self._stamps.usec(Stream.MOTORS, t_mono_s, m.time_usec, events)
            if t_boot_s is not None:
                events.append(Motors(t_mono_s, t_boot_s, outputs))

    def _servo_output_raw(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if t_mono_s - self._state.actuator_t_mono_s < _PREFERRED_FOR_S:
            return
        if m.port != 0:
            return
        outputs = self._motor_outputs([getattr(m, name) for name in _SERVO_FIELDS])
        if outputs:
            t_boot_s = self._stamps.usec32(Stream.MOTORS, t_mono_s, m.time_usec)
            if t_boot_s is not None:
                events.append(Motors(t_mono_s, t_boot_s, outputs))

    def _motor_outputs(self, values: list[float]) -> tuple[float, ...] | None:
        """Return the driven outputs in 0..1, or None if one of them is not finite."""
        if not self._motor_count:
            low, high = self._motor_low, self._motor_high
            driven = tuple(i for i, value in enumerate(values) if low <= value <= high or i in self._state.driven)
            self._state.driven = driven
        outputs: list[float] = []
        for i in self._state.driven:
            x = (values[i] - self._motor_min) * self._motor_gain
            if not math.isfinite(x):
                self.drops[Drop.NOT_FINITE] += 1
                return None
            outputs.append(max(0.0, min(1.0, x)))
        return tuple(outputs)

    def _battery_status(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if m.id != 0 and t_mono_s - self._state.battery_0_t_mono_s < _BATTERY_FOR_S:
            return
        cells_mv = [v for v in m.voltages if v != 0xFFFF]
        cells_mv += [v for v in m.voltages_ext if v not in (0, 0xFFFF)]
        if not cells_mv:
            return
        if self._emit_battery(t_mono_s, sum(cells_mv), events):
            self._state.battery_t_mono_s = t_mono_s
            if m.id == 0:
                self._state.battery_0_t_mono_s = t_mono_s

    def _sys_status(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        if t_mono_s - self._state.battery_t_mono_s < _BATTERY_FOR_S:
            return
        voltage_mv = m.voltage_battery
        if voltage_mv != 0xFFFF:
            self._emit_battery(t_mono_s, voltage_mv, events)

    def _emit_battery(self, t_mono_s: float, voltage_mv: int, events: list[Event]) -> bool:
        if voltage_mv == 0:
            self.drops[Drop.IMPOSSIBLE] += 1
            return False
        self.received[Stream.BATTERY] += 1
        events.append(Battery(t_mono_s, voltage_mv * 1e-3))
        return True

    def _local_position(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        pos = (m.x, m.y, m.z)
        vel = (m.vx, m.vy, m.vz)
        if self.is_plausible(pos, POS_MAX_M) and self.is_plausible(vel, VEL_MAX_MPS):
            t_boot_s = self._stamps.ms(Stream.LOCAL_POSITION, t_mono_s, m.time_boot_ms, events)
            if t_boot_s is not None:
                self._state.view.local = local = LocalPosition(t_mono_s, t_boot_s, pos, vel)
                events.append(local)

    def _gps_global_origin(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        self._state.view.origin = self._geodetic_point(m) or self._state.view.origin

    def _home_position(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        self._state.view.home = self._geodetic_point(m) or self._state.view.home

    def _geodetic_point(self, m: Any) -> GeodeticPoint | None:
        if abs(m.latitude) > 900_000_000 or abs(m.longitude) > 1_800_000_000:
            self.drops[Drop.IMPOSSIBLE] += 1
            return None
        return GeodeticPoint(m.latitude, m.longitude, m.altitude)

    def _extended_sys_state(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        self.received[Stream.LANDED_STATE] += 1
        events.append(Landed(t_mono_s, _LANDED.get(m.landed_state, LandedState.UNKNOWN)))

    def _system_time(self, t_mono_s: float, m: Any, events: list[Event]) -> None:
        self._stamps.relate_unix(t_mono_s, m.time_unix_usec, m.time_boot_ms)

    def is_plausible(self, values: tuple[float, ...], limit: float) -> bool:
        """Whether all values are finite and not beyond a limit; counted if not."""
        for value in values:
            if not -limit <= value <= limit or value - value != 0.0:
                self.drops[Drop.IMPOSSIBLE if math.isfinite(value) else Drop.NOT_FINITE] += 1
                return False
        return True


def _scaled(m: Any) -> tuple[Vec3, Vec3]:
    """Specific force [m/s^2] and rates [rad/s] of ArduPilot's RAW_IMU or SCALED_IMU, which are in mG and mrad/s."""
    acc = (m.xacc * _MPS2_PER_MG, m.yacc * _MPS2_PER_MG, m.zacc * _MPS2_PER_MG)
    return acc, (m.xgyro * 1e-3, m.ygyro * 1e-3, m.zgyro * 1e-3)


def _yaw_rad(w: float, x: float, y: float, z: float) -> float:
    """Heading of an attitude quaternion, of any length."""
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


_SERVO_FIELDS = tuple(f"servo{i}_raw" for i in range(1, 17))

_HANDLERS: dict[int, Callable[[Telemetry, float, Any, list[Event]], None]] = {
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: Telemetry._highres_imu,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: Telemetry._raw_imu,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: Telemetry._scaled_imu,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: Telemetry._attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: Telemetry._attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: Telemetry._attitude_target,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: Telemetry._vfr_hud,
    mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: Telemetry._actuator_output_status,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: Telemetry._servo_output_raw,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Telemetry._battery_status,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Telemetry._sys_status,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: Telemetry._local_position,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: Telemetry._gps_global_origin,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Telemetry._home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Telemetry._extended_sys_state,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Telemetry._system_time,
}
TELEMETRY_IDS = frozenset(_HANDLERS)
"""The messages by which an autopilot describes itself."""
