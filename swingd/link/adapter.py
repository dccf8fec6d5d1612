"""Between MAVLink and the model: frames become events, actions become messages; no I/O, no clock of its own."""

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.codec import Codec, Frame
from swingd.link.setpoints import (
    ACC_MAX_MPS2,
    FORCE_BIT,
    POS_MAX_M,
    SETPOINT_IDS,
    USE_MASK,
    VEL_MAX_MPS,
    YAW,
    YAW_MAX_RAD,
    YAW_RATE,
    YAW_RATE_MAX_RADPS,
    GeodeticPoint,
    VehicleView,
    meet,
    pack,
)
from swingd.link.stamps import Drop, Stamps
from swingd.link.streams import StreamRequests
from swingd.model.actions import (
    Action,
    ClockRequest,
    Health,
    Heartbeat,
    Setpoint,
    StatusText,
    StreamRequest,
    SwingReport,
    VoltageCompensationRequest,
)
from swingd.model.errors import ConfigurationError
from swingd.model.events import (
    AppSetpoint,
    Attitude,
    AutopilotKind,
    AutopilotState,
    Battery,
    Event,
    FlightMode,
    Imu,
    Landed,
    LandedState,
    LocalPosition,
    Motors,
    RoundTrip,
    SetpointUse,
    Stream,
    Throttle,
    UnmetSetpoint,
    Vec3,
    VoltageCompensation,
)
from swingd.model.parameters import Link, ShaperName, Thrust

__all__ = ["AutopilotAdapter", "AutopilotId", "Drop"]

_BY_NAME = -1
_CLOCK_REQUESTS_KEPT = 64
_POS_N, _VEL_N, _ACC_N = SetpointUse.POS_N.value, SetpointUse.VEL_N.value, SetpointUse.ACC_N.value

_PREFERRED_FOR_S = 1.0
_BATTERY_FOR_S = 5.0
_ASK_EVERY_S = 5.0
_REMOTE_CONTROL_HZ = 5.0
_REMOTE_CONTROL_SILENT_S = 1.0

_GYRO_MAX_RADPS = 200.0
_ANGLE_MAX_RAD = 2.0 * math.pi + 1e-3
_MPS2_PER_MG = 9.80665e-3

_IMU_IDS: tuple[int, ...] = (
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
    mavlink.MAVLINK_MSG_ID_RAW_IMU,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU,
)
"""The messages that can carry the IMU of an ArduPilot, the best first."""

_CHUNK = 50
_CHUNKS_MAX = 255

_COPTERS = frozenset(
    {
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_HELICOPTER,
        mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_TRICOPTER,
        mavlink.MAV_TYPE_DODECAROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
    }
)
_PX4_MAIN_MODE_OFFBOARD = 6
_COPTER_GUIDED = 4

_LANDED = {
    mavlink.MAV_LANDED_STATE_ON_GROUND: LandedState.ON_GROUND,
    mavlink.MAV_LANDED_STATE_IN_AIR: LandedState.IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF: LandedState.TAKING_OFF,
    mavlink.MAV_LANDED_STATE_LANDING: LandedState.LANDING,
}
_MAV_STATES = {
    Health.INIT: mavlink.MAV_STATE_BOOT,
    Health.READY: mavlink.MAV_STATE_STANDBY,
    Health.ACTIVE: mavlink.MAV_STATE_ACTIVE,
    Health.DEGRADED: mavlink.MAV_STATE_CRITICAL,
    Health.FAULT: mavlink.MAV_STATE_EMERGENCY,
}
_VOLTAGE_COMPENSATION = {AutopilotKind.PX4: "MC_BAT_SCALE_EN", AutopilotKind.ARDUPILOT: "MOT_BAT_VOLT_MAX"}
"""The parameter that is not zero where the autopilot scales its outputs with the voltage."""


@dataclass(frozen=True, slots=True)
class AutopilotId:
    """The autopilot that is served."""

    system_id: int
    component_id: int
    kind: AutopilotKind


@dataclass(slots=True)
class _State:
    """What is known of one life of the autopilot; void after its restart."""

    driven: tuple[int, ...]
    view: VehicleView = field(default_factory=VehicleView)
    imu_t_mono_s: list[float | None] = field(default_factory=lambda: [None] * len(_IMU_IDS))
    """Last arrival of each message that can carry the IMU, the best first."""
    attitude_t_mono_s: float = -math.inf
    attitude_target_t_mono_s: float = -math.inf
    actuator_t_mono_s: float = -math.inf
    battery_t_mono_s: float = -math.inf
    battery_0_t_mono_s: float = -math.inf
    remote_control_t_mono_s: float = -math.inf
    asked_t_mono_s: float = -math.inf


class AutopilotAdapter:
    """Turns received frames into events and actions into messages.

    Parameters
    ----------
    link : Link
        ``system_id`` 0 serves the first autopilot heard, and stays with it.
    thrust : Thrust
        ``motor_output_min``, ``motor_output_max`` and ``motor_count`` normalise the motor outputs.

    Raises
    ------
    ConfigurationError
        If ``motor_output_min`` equals ``motor_output_max``.

    Notes
    -----
    Received frames never raise. `Stamps` puts all samples on one boot clock; `StreamRequests` knows which message
    carries a stream on which autopilot. Of several messages that carry the same, only the best that comes is used.
    """

    def __init__(self, link: Link, thrust: Thrust) -> None:
        self.configure_motors(thrust)
        self.codec = Codec(link.system_id or 1, link.component_id)
        self.autopilot: AutopilotId | None = None
        """The autopilot that is served; None until its HEARTBEAT is heard."""
        self.drops: Counter[Drop] = Counter()
        """What was not used, by reason."""
        self.received: Counter[Stream] = Counter()
        """Samples that became events."""
        self._system_id_wanted = link.system_id
        self._component_id = link.component_id
        self._wants_remote_control = link.rc_channel != 0
        self._stamps = Stamps(self.drops, self.received, self._restarted)
        self._requests = StreamRequests()
        self._clock_requests: deque[int] = deque(maxlen=_CLOCK_REQUESTS_KEPT)
        self._t_mono_s = 0.0
        self._text_id = 0
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

    def _anew(self) -> _State:
        return _State(driven=tuple(range(self._motor_count)))

    def _restarted(self) -> None:
        self._state = self._anew()
        self._requests.restarted()

    # ------------------------------------------------------------------------------------------------ receiving

    def receive(self, t_mono_s: float, data: bytes) -> list[Event]:
        """`take` the frames that received bytes, cut anywhere, complete."""
        return self.take(t_mono_s, self.codec.receive(data))

    def take(self, t_mono_s: float, frames: Sequence[Frame]) -> list[Event]:
        """Take received frames and return their events in the order of arrival; never raises.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at the arrival [s].
        frames : sequence of Frame
            What came from the autopilot's side, whoever sent it, and what is addressed to swingd itself.
        """
        self._t_mono_s = t_mono_s
        events: list[Event] = []
        for frame in frames:
            handler = _HANDLERS.get(frame.msg_id)
            if handler is None:
                continue
            autopilot = self.autopilot
            if autopilot is None and frame.msg_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                autopilot = self._discover(frame)
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                if autopilot is not None:
                    self._reference(t_mono_s, frame, events)
            elif (
                autopilot is not None
                and frame.system_id == autopilot.system_id
                and frame.component_id == autopilot.component_id
            ):
                self._requests.heard(frame.msg_id)
                handler(self, t_mono_s, frame, events)
            else:
                self.drops[Drop.OTHER_SENDER] += 1
        return events

    def app_setpoint(
        self, t_mono_s: float, frame: Frame, source: int, shaper: ShaperName = ShaperName.NONE
    ) -> AppSetpoint | UnmetSetpoint | None:
        """Say what an application's frame, addressed to the autopilot, means to the correction; never raises.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at its arrival [s].
        frame : Frame
            Any; only those of `swingd.link.setpoints.SETPOINT_IDS` mean something.
        source : int
            Who sent it, see `AppSetpoint`.
        shaper : ShaperName
            How this source's setpoints are to be shaped.

        Returns
        -------
        AppSetpoint
            A setpoint in LOCAL_NED, as this autopilot reads the frame at this instant.
        UnmetSetpoint
            The frame takes the place of what the autopilot follows, and no correction can meet it.
        None
            The frame changes nothing of what the autopilot follows: it is to pass.
        """
        if self.autopilot is None or frame.msg_id not in SETPOINT_IDS:
            return None
        return meet(self.autopilot.kind, frame.message, self._state.view, t_mono_s, source, shaper)

    def _discover(self, frame: Frame) -> AutopilotId | None:
        if frame.component_id != mavlink.MAV_COMP_ID_AUTOPILOT1 or frame.system_id == 0:
            return None
        if self._system_id_wanted not in (0, frame.system_id):
            return None
        heartbeat = frame.message
        if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_INVALID or heartbeat.type in (
            mavlink.MAV_TYPE_GCS,
            mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        ):
            return None
        kind = {
            mavlink.MAV_AUTOPILOT_PX4: AutopilotKind.PX4,
            mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: AutopilotKind.ARDUPILOT,
        }.get(heartbeat.autopilot, AutopilotKind.OTHER)
        self.autopilot = AutopilotId(frame.system_id, frame.component_id, kind)
        self.codec.system_id = frame.system_id
        self._requests.serve(kind)
        return self.autopilot

    def _heartbeat(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        assert self.autopilot is not None
        message = frame.message
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        mode = FlightMode.UNKNOWN
        if message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            offboard: bool | None = None
            if self.autopilot.kind is AutopilotKind.PX4:
                offboard = message.custom_mode >> 16 & 0xFF == _PX4_MAIN_MODE_OFFBOARD
            elif self.autopilot.kind is AutopilotKind.ARDUPILOT and message.type in _COPTERS:
                offboard = message.custom_mode == _COPTER_GUIDED
            if offboard is not None:
                mode = FlightMode.OFFBOARD if offboard else FlightMode.OTHER
        if not armed and not self._motor_count:
            self._state.driven = ()
        events.append(AutopilotState(t_mono_s, armed, mode, self.autopilot.kind))

    def _imu(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        assert self.autopilot is not None
        m = frame.message
        # ArduPilot gives its primary sensor, whose number need not be 0.
        if (m.id == 0 or self.autopilot.kind is AutopilotKind.ARDUPILOT) and self._is_imu(t_mono_s, frame.msg_id):
            self._emit_imu(t_mono_s, (m.xacc, m.yacc, m.zacc), (m.xgyro, m.ygyro, m.zgyro), m.time_usec, events)

    def _raw_imu(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if m.id == 0 and self._is_imu(t_mono_s, frame.msg_id):
            self._emit_imu(t_mono_s, *_scaled(m), m.time_usec, events)

    def _scaled_imu(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        if self._is_imu(t_mono_s, frame.msg_id):
            m = frame.message
            self._emit_imu(t_mono_s, *_scaled(m), m.time_boot_ms * 1000, events)

    def _is_imu(self, t_mono_s: float, msg_id: int) -> bool:
        """Whether samples are taken from this message: only from the best that comes, so that two never mix."""
        assert self.autopilot is not None
        if self.autopilot.kind is not AutopilotKind.ARDUPILOT:
            # RAW_IMU of others is in units of its own, and their HIGHRES_IMU always comes.
            return msg_id == _IMU_IDS[0]
        last_s = self._state.imu_t_mono_s
        rank = _IMU_IDS.index(msg_id)
        last_s[rank] = t_mono_s
        for better in range(rank):
            if self._requests.denied(_IMU_IDS[better]):
                continue
            better_s = last_s[better]
            if better_s is None:
                # Whether it comes is not known yet.
                better_s = last_s[better] = t_mono_s
            if t_mono_s - better_s < _PREFERRED_FOR_S:
                return False
        return True

    def _emit_imu(self, t_mono_s: float, acc: Vec3, gyro: Vec3, time_usec: int, events: list[Event]) -> None:
        if self._plausible(acc, ACC_MAX_MPS2) and self._plausible(gyro, _GYRO_MAX_RADPS):
            t_boot_s = self._stamps.usec(Stream.IMU, t_mono_s, time_usec, events)
            if t_boot_s is not None:
                events.append(Imu(t_mono_s, t_boot_s, acc, gyro))

    def _attitude(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if self._plausible((m.roll, m.pitch, m.yaw), _ANGLE_MAX_RAD):
            t_boot_s = self._stamps.ms(Stream.ATTITUDE, t_mono_s, m.time_boot_ms, events)
            if t_boot_s is not None:
                self._state.attitude_t_mono_s = t_mono_s
                self._emit_attitude(Attitude(t_mono_s, t_boot_s, m.roll, m.pitch, m.yaw), events)

    def _attitude_quaternion(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        if t_mono_s - self._state.attitude_t_mono_s < _PREFERRED_FOR_S:
            return
        m = frame.message
        w, x, y, z = q = (m.q1, m.q2, m.q3, m.q4)
        if not self._plausible(q, 1.1):
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

    def _attitude_target(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if not m.type_mask & mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE and all(map(math.isfinite, m.q)):
            self._state.view.heading_sp = (t_mono_s, _yaw_rad(*m.q))
        if m.type_mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
            return
        if not self._plausible((m.thrust,), math.inf):
            return
        if not -0.01 <= m.thrust <= 1.01:
            self.drops[Drop.IMPOSSIBLE] += 1
            return
        t_boot_s = self._stamps.ms(Stream.THROTTLE, t_mono_s, m.time_boot_ms, events)
        if t_boot_s is not None:
            self._state.attitude_target_t_mono_s = t_mono_s
            events.append(Throttle(t_mono_s, t_boot_s, max(0.0, min(1.0, m.thrust))))

    def _vfr_hud(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        """Take ArduPilot's throttle, a whole percent without a stamp, as a last resort."""
        assert self.autopilot is not None
        if (
            self.autopilot.kind is not AutopilotKind.ARDUPILOT
            or t_mono_s - self._state.attitude_target_t_mono_s < _PREFERRED_FOR_S
        ):
            return
        throttle = frame.message.throttle * 1e-2
        if throttle > 1.0:
            self.drops[Drop.IMPOSSIBLE] += 1
            return
        t_boot_s = self._stamps.arrival(Stream.THROTTLE, t_mono_s)
        if t_boot_s is not None:
            events.append(Throttle(t_mono_s, t_boot_s, throttle))

    def _actuator_output_status(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        outputs = self._motor_outputs(m.actuator)
        if outputs is not None:
            self._state.actuator_t_mono_s = t_mono_s
        if outputs:
            t_boot_s = self._stamps.usec(Stream.MOTORS, t_mono_s, m.time_usec, events)
            if t_boot_s is not None:
                events.append(Motors(t_mono_s, t_boot_s, outputs))

    def _servo_output_raw(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        if t_mono_s - self._state.actuator_t_mono_s < _PREFERRED_FOR_S:
            return
        m = frame.message
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

    def _battery_status(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
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

    def _sys_status(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        if t_mono_s - self._state.battery_t_mono_s < _BATTERY_FOR_S:
            return
        voltage_mv = frame.message.voltage_battery
        if voltage_mv != 0xFFFF:
            self._emit_battery(t_mono_s, voltage_mv, events)

    def _emit_battery(self, t_mono_s: float, voltage_mv: int, events: list[Event]) -> bool:
        if voltage_mv == 0:
            self.drops[Drop.IMPOSSIBLE] += 1
            return False
        self.received[Stream.BATTERY] += 1
        events.append(Battery(t_mono_s, voltage_mv * 1e-3))
        return True

    def _local_position(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        pos = (m.x, m.y, m.z)
        vel = (m.vx, m.vy, m.vz)
        if self._plausible(pos, POS_MAX_M) and self._plausible(vel, VEL_MAX_MPS):
            t_boot_s = self._stamps.ms(Stream.LOCAL_POSITION, t_mono_s, m.time_boot_ms, events)
            if t_boot_s is not None:
                self._state.view.local = local = LocalPosition(t_mono_s, t_boot_s, pos, vel)
                events.append(local)

    def _gps_global_origin(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        self._state.view.origin = self._geodetic_point(frame.message) or self._state.view.origin

    def _home_position(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        self._state.view.home = self._geodetic_point(frame.message) or self._state.view.home

    def _geodetic_point(self, m: Any) -> GeodeticPoint | None:
        if abs(m.latitude) > 900_000_000 or abs(m.longitude) > 1_800_000_000:
            self.drops[Drop.IMPOSSIBLE] += 1
            return None
        return GeodeticPoint(m.latitude, m.longitude, m.altitude)

    def _rc_channels(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        self._state.remote_control_t_mono_s = t_mono_s

    def _extended_sys_state(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        self.received[Stream.LANDED_STATE] += 1
        events.append(Landed(t_mono_s, _LANDED.get(frame.message.landed_state, LandedState.UNKNOWN)))

    def _system_time(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        self._stamps.relate_unix(t_mono_s, m.time_unix_usec, m.time_boot_ms)

    def _command_ack(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if m.command != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL or m.result == mavlink.MAV_RESULT_IN_PROGRESS:
            return
        if m.target_system not in (0, self.codec.system_id) or m.target_component not in (0, self._component_id):
            return
        refused = self._requests.acknowledged(t_mono_s, m.result)
        if refused is not None:
            events.append(refused)

    def _timesync(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        # The autopilot's own requests (tc1 = 0) are not answered: a companion that answers badly spoils its clock.
        if m.tc1 != 0 and m.ts1 in self._clock_requests:
            self._clock_requests.remove(m.ts1)
            events.append(RoundTrip(t_mono_s, max(t_mono_s - m.ts1 * 1e-9, 0.0)))

    def _param_value(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        assert self.autopilot is not None
        m = frame.message
        if m.param_id == _VOLTAGE_COMPENSATION.get(self.autopilot.kind):
            # PX4 sends integers as the bits of a float: zero is zero in both, and the only value that means no.
            events.append(VoltageCompensation(t_mono_s, m.param_value != 0.0))

    def _reference(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        """Take the reference of mode ``hold``: a setpoint addressed to swingd, in LOCAL_NED."""
        m = frame.message
        if m.target_system != self.codec.system_id or m.target_component != self._component_id:
            return
        if m.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or m.type_mask & FORCE_BIT:
            self.drops[Drop.SETPOINT_FRAME] += 1
            return
        use = ~m.type_mask & USE_MASK

        def used(x: float, y: float, z: float, bit: int) -> Vec3:
            return (x if use & bit else 0.0), (y if use & bit << 1 else 0.0), (z if use & bit << 2 else 0.0)

        pos = used(m.x, m.y, m.z, _POS_N)
        vel = used(m.vx, m.vy, m.vz, _VEL_N)
        acc = used(m.afx, m.afy, m.afz, _ACC_N)
        yaw_rad = m.yaw if use & YAW else 0.0
        yaw_rate_radps = m.yaw_rate if use & YAW_RATE else 0.0
        if (
            self._plausible(pos, POS_MAX_M)
            and self._plausible(vel, VEL_MAX_MPS)
            and self._plausible(acc, ACC_MAX_MPS2)
            and self._plausible((yaw_rad,), YAW_MAX_RAD)
            and self._plausible((yaw_rate_radps,), YAW_RATE_MAX_RADPS)
        ):
            events.append(AppSetpoint(t_mono_s, SetpointUse(use), pos, vel, acc, yaw_rad, yaw_rate_radps))

    def _plausible(self, values: tuple[float, ...], limit: float) -> bool:
        for value in values:
            if not -limit <= value <= limit or value - value != 0.0:
                self.drops[Drop.IMPOSSIBLE if math.isfinite(value) else Drop.NOT_FINITE] += 1
                return False
        return True

    # ------------------------------------------------------------------------------------------------- sending

    def tick(self, t_mono_s: float) -> list[Any]:
        """Return the messages by which the adapter asks for what it needs itself; to be called at some 20 Hz.

        Until it knows them, it asks for the origin of the local frame and for home, which setpoints in global frames
        depend on; and for the remote control where one switches the correction.
        """
        autopilot, state = self.autopilot, self._state
        if autopilot is None or t_mono_s - state.asked_t_mono_s < _ASK_EVERY_S:
            return []
        state.asked_t_mono_s = self._t_mono_s = t_mono_s
        messages: list[Any] = []
        if state.view.origin is None:
            messages.append(_message_request(autopilot, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN))
        if state.view.home is None:
            messages.append(_message_request(autopilot, mavlink.MAVLINK_MSG_ID_HOME_POSITION))
        if self._wants_remote_control and t_mono_s - state.remote_control_t_mono_s > _REMOTE_CONTROL_SILENT_S:
            messages += self._request_messages(autopilot, StreamRequest(Stream.REMOTE_CONTROL, _REMOTE_CONTROL_HZ))
        return messages

    def encode(self, action: Action) -> bytes | None:
        """Pack the `messages` of an action with the sequence numbers of `codec`; None if there are none."""
        return b"".join(map(self.codec.encode, self.messages(action))) or None

    def messages(self, action: Action) -> list[Any]:
        """Return the messages that an action becomes, as pymavlink's objects; none (counted) if it cannot be sent.

        Before an autopilot is known only the heartbeat leaves. A setpoint with a used component that is not finite, or
        that the autopilot would read otherwise, does not leave at all.
        """
        if isinstance(action, Heartbeat):
            return [
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                    mavlink.MAV_AUTOPILOT_INVALID,
                    0,
                    swing_message.HEALTH_CODES[action.health],
                    _MAV_STATES[action.health],
                    3,
                )
            ]
        autopilot = self.autopilot
        messages: list[Any] = []
        if autopilot is not None:
            match action:
                case Setpoint():
                    setpoint = pack(autopilot.kind, autopilot.system_id, autopilot.component_id, action)
                    messages = [] if setpoint is None else [setpoint]
                case SwingReport():
                    if math.isfinite(action.t_boot_s) and action.t_boot_s >= 0.0:
                        messages = [swing_message.encode(action)]
                case StatusText():
                    messages = self._text_messages(action)
                case StreamRequest():
                    messages = self._request_messages(autopilot, action)
                case ClockRequest():
                    messages = self._clock_request_messages(action)
                case VoltageCompensationRequest():
                    messages = _parameter_read_messages(autopilot)
        if not messages:
            self.drops[Drop.OUTGOING] += 1
        return messages

    def _text_messages(self, action: StatusText) -> list[Any]:
        text = action.text.replace("\0", " ").encode("utf-8", errors="replace")[: _CHUNK * _CHUNKS_MAX]
        if len(text) <= _CHUNK:
            return [mavlink.MAVLink_statustext_message(int(action.severity), text)]
        self._text_id = self._text_id % 0xFFFF + 1
        # A zero byte ends the text: a last chunk that is full is followed by an empty one.
        chunks = [text[i : i + _CHUNK] for i in range(0, len(text) + 1, _CHUNK)]
        return [
            mavlink.MAVLink_statustext_message(int(action.severity), chunk, self._text_id, number)
            for number, chunk in enumerate(chunks)
        ]

    def _request_messages(self, autopilot: AutopilotId, action: StreamRequest) -> list[Any]:
        if not math.isfinite(action.rate_hz):
            return []
        ids = autopilot.system_id, autopilot.component_id
        return [self._requests.request(self._t_mono_s, *ids, action.stream, action.rate_hz)]

    def _clock_request_messages(self, action: ClockRequest) -> list[Any]:
        if not math.isfinite(action.t_mono_s):
            return []
        asked_ns = round(action.t_mono_s * 1e9)
        self._clock_requests.append(asked_ns)
        return [mavlink.MAVLink_timesync_message(0, asked_ns)]


def _parameter_read_messages(autopilot: AutopilotId) -> list[Any]:
    name = _VOLTAGE_COMPENSATION.get(autopilot.kind)
    if name is None:
        return []
    return [
        mavlink.MAVLink_param_request_read_message(autopilot.system_id, autopilot.component_id, name.encode(), _BY_NAME)
    ]


def _message_request(autopilot: AutopilotId, msg_id: int) -> Any:
    return mavlink.MAVLink_command_long_message(
        autopilot.system_id,
        autopilot.component_id,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        0,
        float(msg_id),
        *(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )


def _scaled(m: Any) -> tuple[Vec3, Vec3]:
    """Specific force [m/s^2] and rates [rad/s] of ArduPilot's RAW_IMU or SCALED_IMU, which are in mG and mrad/s."""
    acc = (m.xacc * _MPS2_PER_MG, m.yacc * _MPS2_PER_MG, m.zacc * _MPS2_PER_MG)
    return acc, (m.xgyro * 1e-3, m.ygyro * 1e-3, m.zgyro * 1e-3)


def _yaw_rad(w: float, x: float, y: float, z: float) -> float:
    """Heading of an attitude quaternion, of any length."""
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


_SERVO_FIELDS = tuple(f"servo{i}_raw" for i in range(1, 17))

_Handler = Callable[[AutopilotAdapter, float, Frame, list[Event]], None]
_HANDLERS: dict[int, _Handler] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: AutopilotAdapter._heartbeat,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: AutopilotAdapter._imu,
    mavlink.MAVLINK_MSG_ID_RAW_IMU: AutopilotAdapter._raw_imu,
    mavlink.MAVLINK_MSG_ID_SCALED_IMU: AutopilotAdapter._scaled_imu,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: AutopilotAdapter._vfr_hud,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: AutopilotAdapter._gps_global_origin,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: AutopilotAdapter._home_position,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: AutopilotAdapter._rc_channels,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: AutopilotAdapter._attitude,
    mavlink.MAVLINK_MSG_ID_PARAM_VALUE: AutopilotAdapter._param_value,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: AutopilotAdapter._timesync,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: AutopilotAdapter._attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: AutopilotAdapter._attitude_target,
    mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: AutopilotAdapter._actuator_output_status,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: AutopilotAdapter._servo_output_raw,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: AutopilotAdapter._battery_status,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: AutopilotAdapter._sys_status,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: AutopilotAdapter._local_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: AutopilotAdapter._extended_sys_state,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: AutopilotAdapter._system_time,
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK: AutopilotAdapter._command_ack,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: AutopilotAdapter._reference,
}
