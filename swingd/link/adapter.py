"""Between MAVLink and the model: received bytes become events, actions become bytes; no I/O, no clock of its own."""

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.clock import AHEAD_S, LATE_S, RemoteClock, Verdict, unwrap
from swingd.link.codec import Codec, Frame
from swingd.link.swing_message import float32
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
    AutopilotRestart,
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
    StreamRefused,
    Throttle,
    Vec3,
    VoltageCompensation,
)
from swingd.model.parameters import Link, Thrust

_BY_NAME = -1
_CLOCK_REQUESTS_KEPT = 64
# Plain integers: arithmetic with flags costs a microsecond each.
_FORCE_BIT = 0x200
_USE_MASK = 0xDFF
_POS_N, _VEL_N, _ACC_N = SetpointUse.POS_N.value, SetpointUse.VEL_N.value, SetpointUse.ACC_N.value
_YAW, _YAW_RATE = SetpointUse.YAW.value, SetpointUse.YAW_RATE.value

# The boot clock is kept modulo the 32 bit of time_boot_ms; SERVO_OUTPUT_RAW.time_usec has 32 bit of microseconds.
_BOOT_PERIOD_US = 2**32 * 1000
_BOOT_PERIOD_S = _BOOT_PERIOD_US * 1e-6
_USEC32_PERIOD_S = 2**32 * 1e-6
_UNIX_MIN_US = 10**15
_UNIX_MAX_US = 10**16
_UNIX_LATCH_S = 1.0
_UNIX_STEP_S = 0.005

_PREFERRED_FOR_S = 1.0
_BATTERY_FOR_S = 5.0
_ACK_WITHIN_S = 3.0
_ACKS_AWAITED = 64

_ACC_MAX_MPS2 = 1000.0
_GYRO_MAX_RADPS = 200.0
_ANGLE_MAX_RAD = 2.0 * math.pi + 1e-3
_POS_MAX_M = 1e7
_VEL_MAX_MPS = 1e3
_YAW_MAX_RAD = 1e3

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
_REQUESTED: dict[Stream, tuple[int, ...]] = {
    Stream.IMU: (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,),
    Stream.ATTITUDE: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    Stream.THROTTLE: (mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,),
    Stream.MOTORS: (mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS, mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW),
    Stream.BATTERY: (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,),
    Stream.LOCAL_POSITION: (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,),
    Stream.LANDED_STATE: (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,),
}


_VOLTAGE_COMPENSATION = {AutopilotKind.PX4: "MC_BAT_SCALE_EN", AutopilotKind.ARDUPILOT: "MOT_BAT_VOLT_MAX"}
"""The parameter that is not zero where the autopilot scales its outputs with the voltage."""


class Drop(Enum):
    """Why something received or asked for was not used."""

    OTHER_SENDER = "other_sender"
    """A message that swingd consumes, from a system or component that it does not serve."""
    NOT_FINITE = "not_finite"
    """A field is NaN or infinite."""
    IMPOSSIBLE = "impossible"
    """A field is outside of what can be."""
    DUPLICATE = "duplicate"
    """The stamp of the stream's last sample again."""
    REORDERED = "reordered"
    """A stamp before the stream's last sample."""
    LATE = "late"
    """Delivered more than `swingd.link.clock.LATE_S` later than others."""
    AHEAD = "ahead"
    """A stamp of the future."""
    NO_CLOCK = "no_clock"
    """The stamp cannot be related to the boot clock yet."""
    SETPOINT_FRAME = "setpoint_frame"
    """An application's setpoint in another frame than LOCAL_NED, or as a force."""
    OUTGOING = "outgoing"
    """An action that cannot be sent: no autopilot known, or not finite."""


@dataclass(frozen=True, slots=True)
class AutopilotId:
    """The autopilot that is served."""

    system_id: int
    component_id: int
    kind: AutopilotKind


@dataclass(slots=True)
class _Request:
    """A stream's interval requests on their way."""

    stream: Stream
    t_mono_s: float
    unanswered: int
    accepted: bool = False


@dataclass(slots=True)
class _State:
    """What is known of one life of the autopilot; void after its restart."""

    driven: tuple[int, ...]
    clock: RemoteClock = field(default_factory=RemoteClock)
    unix: RemoteClock = field(default_factory=RemoteClock)
    unix_first_s: float | None = None
    unix_minus_boot_s: float | None = None
    last_s: dict[Stream, float] = field(default_factory=lambda: dict.fromkeys(Stream, -math.inf))
    attitude_t_mono_s: float = -math.inf
    actuator_t_mono_s: float = -math.inf
    battery_t_mono_s: float = -math.inf
    battery_0_t_mono_s: float = -math.inf


class AutopilotAdapter:
    """Turns received bytes into events and actions into bytes.

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
    Received bytes never raise, and the events do not depend on how the bytes are cut.

    Stamps: the boot clock is tracked by `RemoteClock` over all streams and counted on over the wrap of ``time_boot_ms``
    (49.7 days; 71.6 minutes for SERVO_OUTPUT_RAW), so ``t_boot_s`` only goes back with an `AutopilotRestart`. A
    ``time_usec`` that is a unix time (above 10^15 us, as MAVLink says) is turned into boot time by a difference that is
    latched once: from SYSTEM_TIME, else from a second of arrivals; a step of the unix clock latches anew.
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
        self._requests: deque[tuple[int, _Request]] = deque(maxlen=_ACKS_AWAITED)
        self._clock_requests: deque[int] = deque(maxlen=_CLOCK_REQUESTS_KEPT)
        self._t_mono_s = 0.0
        self._text_id = 0
        self._state = self._anew()

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
            What came from the autopilot's side, whoever sent it.
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
                    self._app_setpoint(t_mono_s, frame, events)
            elif (
                autopilot is not None
                and frame.system_id == autopilot.system_id
                and frame.component_id == autopilot.component_id
            ):
                handler(self, t_mono_s, frame, events)
            else:
                self.drops[Drop.OTHER_SENDER] += 1
        return events

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
        m = frame.message
        if m.id != 0:
            return
        acc = (m.xacc, m.yacc, m.zacc)
        gyro = (m.xgyro, m.ygyro, m.zgyro)
        if self._plausible(acc, _ACC_MAX_MPS2) and self._plausible(gyro, _GYRO_MAX_RADPS):
            t_boot_s = self._stamp_usec(Stream.IMU, t_mono_s, m.time_usec, events)
            if t_boot_s is not None:
                events.append(Imu(t_mono_s, t_boot_s, acc, gyro))

    def _attitude(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if self._plausible((m.roll, m.pitch, m.yaw), _ANGLE_MAX_RAD):
            t_boot_s = self._stamp_ms(Stream.ATTITUDE, t_mono_s, m.time_boot_ms, events)
            if t_boot_s is not None:
                self._state.attitude_t_mono_s = t_mono_s
                events.append(Attitude(t_mono_s, t_boot_s, m.roll, m.pitch, m.yaw))

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
        t_boot_s = self._stamp_ms(Stream.ATTITUDE, t_mono_s, m.time_boot_ms, events)
        if t_boot_s is not None:
            roll_rad = math.atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
            pitch_rad = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x) / norm)))
            yaw_rad = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
            events.append(Attitude(t_mono_s, t_boot_s, roll_rad, pitch_rad, yaw_rad))

    def _attitude_target(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if m.type_mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
            return
        if not self._plausible((m.thrust,), math.inf):
            return
        if not -0.01 <= m.thrust <= 1.01:
            self.drops[Drop.IMPOSSIBLE] += 1
            return
        t_boot_s = self._stamp_ms(Stream.THROTTLE, t_mono_s, m.time_boot_ms, events)
        if t_boot_s is not None:
            events.append(Throttle(t_mono_s, t_boot_s, max(0.0, min(1.0, m.thrust))))

    def _actuator_output_status(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        outputs = self._motor_outputs(m.actuator)
        if outputs is not None:
            self._state.actuator_t_mono_s = t_mono_s
        if outputs:
            t_boot_s = self._stamp_usec(Stream.MOTORS, t_mono_s, m.time_usec, events)
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
            t_boot_s = self._stamp_usec32(Stream.MOTORS, t_mono_s, m.time_usec)
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
        if self._plausible(pos, _POS_MAX_M) and self._plausible(vel, _VEL_MAX_MPS):
            t_boot_s = self._stamp_ms(Stream.LOCAL_POSITION, t_mono_s, m.time_boot_ms, events)
            if t_boot_s is not None:
                events.append(LocalPosition(t_mono_s, t_boot_s, pos, vel))

    def _extended_sys_state(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        self.received[Stream.LANDED_STATE] += 1
        events.append(Landed(t_mono_s, _LANDED.get(frame.message.landed_state, LandedState.UNKNOWN)))

    def _system_time(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        """Relate the autopilot's unix clock to its boot clock, where its stamps are unix times."""
        m = frame.message
        if self._state.unix_first_s is None or not _UNIX_MIN_US < m.time_unix_usec < _UNIX_MAX_US:
            return
        expected_s = self._expected_boot_s(t_mono_s)
        if expected_s is None:
            return
        boot_s = unwrap(m.time_boot_ms * 1e-3, expected_s, _BOOT_PERIOD_S)
        if not -LATE_S < boot_s - expected_s <= AHEAD_S:
            return
        difference_s = m.time_unix_usec * 1e-6 - boot_s
        known_s = self._state.unix_minus_boot_s
        if known_s is None or abs(difference_s - known_s) > _UNIX_STEP_S:
            self._state.unix_minus_boot_s = difference_s

    def _command_ack(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if m.command != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL or m.result == mavlink.MAV_RESULT_IN_PROGRESS:
            return
        if m.target_system not in (0, self.codec.system_id) or m.target_component not in (0, self._component_id):
            return
        # An acknowledgement does not say which message it is about; autopilots answer in the order of the requests.
        while self._requests and t_mono_s - self._requests[0][1].t_mono_s > _ACK_WITHIN_S:
            self._requests.popleft()
        if not self._requests:
            return
        msg_id, request = self._requests.popleft()
        request.unanswered -= 1
        request.accepted |= m.result == mavlink.MAV_RESULT_ACCEPTED
        if request.unanswered == 0 and not request.accepted:
            name = mavlink.mavlink_map[msg_id].msgname
            result = mavlink.enums["MAV_RESULT"].get(m.result)
            reason = f"{name}: {result.name if result else m.result}"
            events.append(StreamRefused(t_mono_s, request.stream, reason))

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

    def _app_setpoint(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if m.target_system != self.codec.system_id or m.target_component != self._component_id:
            return
        if m.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or m.type_mask & _FORCE_BIT:
            self.drops[Drop.SETPOINT_FRAME] += 1
            return
        use = ~m.type_mask & _USE_MASK

        def used(x: float, y: float, z: float, bit: int) -> Vec3:
            return (x if use & bit else 0.0), (y if use & bit << 1 else 0.0), (z if use & bit << 2 else 0.0)

        pos = used(m.x, m.y, m.z, _POS_N)
        vel = used(m.vx, m.vy, m.vz, _VEL_N)
        acc = used(m.afx, m.afy, m.afz, _ACC_N)
        yaw_rad = m.yaw if use & _YAW else 0.0
        yaw_rate_radps = m.yaw_rate if use & _YAW_RATE else 0.0
        if (
            self._plausible(pos, _POS_MAX_M)
            and self._plausible(vel, _VEL_MAX_MPS)
            and self._plausible(acc, _ACC_MAX_MPS2)
            and self._plausible((yaw_rad,), _YAW_MAX_RAD)
            and self._plausible((yaw_rate_radps,), _GYRO_MAX_RADPS)
        ):
            events.append(AppSetpoint(t_mono_s, SetpointUse(use), pos, vel, acc, yaw_rad, yaw_rate_radps))

    def _plausible(self, values: tuple[float, ...], limit: float) -> bool:
        for value in values:
            if not -limit <= value <= limit or value - value != 0.0:
                self.drops[Drop.IMPOSSIBLE if math.isfinite(value) else Drop.NOT_FINITE] += 1
                return False
        return True

    # ------------------------------------------------------------------------------------------------- stamps

    def _expected_boot_s(self, t_mono_s: float) -> float | None:
        offset_s = self._state.clock.offset_s
        return None if offset_s is None else t_mono_s + offset_s

    def _stamp_ms(self, stream: Stream, t_mono_s: float, stamp_ms: int, events: list[Event]) -> float | None:
        return self._stamp(stream, t_mono_s, stamp_ms * 1e-3, events)

    def _stamp_usec(self, stream: Stream, t_mono_s: float, stamp_us: int, events: list[Event]) -> float | None:
        if stamp_us < _UNIX_MIN_US:
            return self._stamp(stream, t_mono_s, stamp_us % _BOOT_PERIOD_US * 1e-6, events)
        if stamp_us >= _UNIX_MAX_US:
            self.drops[Drop.IMPOSSIBLE] += 1
            return None
        unix_s = stamp_us * 1e-6
        verdict = self._state.unix.judge(t_mono_s, unix_s)
        if verdict is Verdict.RESTART or self._state.unix_first_s is None:
            self._state.unix_first_s = t_mono_s
            self._state.unix_minus_boot_s = None
        if verdict in (Verdict.LATE, Verdict.AHEAD):
            self.drops[Drop.LATE if verdict is Verdict.LATE else Drop.AHEAD] += 1
            return None
        if (
            self._state.unix_minus_boot_s is None
            and t_mono_s - self._state.unix_first_s >= _UNIX_LATCH_S
            and self._state.unix.offset_s is not None
            and self._state.clock.offset_s is not None
        ):
            self._state.unix_minus_boot_s = self._state.unix.offset_s - self._state.clock.offset_s
        expected_s = self._expected_boot_s(t_mono_s)
        if self._state.unix_minus_boot_s is None or expected_s is None:
            self.drops[Drop.NO_CLOCK] += 1
            return None
        t_boot_s = unix_s - self._state.unix_minus_boot_s
        if not -LATE_S < t_boot_s - expected_s <= AHEAD_S:
            # One of the two clocks was set.
            self._state.unix_first_s = t_mono_s
            self._state.unix_minus_boot_s = None
        return self._in_order(stream, t_boot_s, expected_s)

    def _stamp_usec32(self, stream: Stream, t_mono_s: float, stamp_us: int) -> float | None:
        expected_s = self._expected_boot_s(t_mono_s)
        if expected_s is None:
            self.drops[Drop.NO_CLOCK] += 1
            return None
        return self._in_order(stream, unwrap(stamp_us * 1e-6, expected_s, _USEC32_PERIOD_S), expected_s)

    def _in_order(self, stream: Stream, t_boot_s: float, expected_s: float) -> float | None:
        """Judge a stamp that says nothing about the boot clock itself."""
        if not -LATE_S < t_boot_s - expected_s <= AHEAD_S:
            self.drops[Drop.LATE if t_boot_s < expected_s else Drop.AHEAD] += 1
            return None
        return self._next(stream, t_boot_s)

    def _stamp(self, stream: Stream, t_mono_s: float, stamp_s: float, events: list[Event]) -> float | None:
        """Return the boot time of a stamp [s], or None (counted) if its sample is not to be used."""
        expected_s = self._expected_boot_s(t_mono_s)
        t_boot_s = stamp_s if expected_s is None else unwrap(stamp_s, expected_s, _BOOT_PERIOD_S)
        verdict = self._state.clock.judge(t_mono_s, t_boot_s)
        if verdict is Verdict.GOOD:
            return self._next(stream, t_boot_s)
        if verdict is Verdict.RESTART:
            step_s = self._state.clock.step_s
            self._state = self._anew()
            self._state.clock.judge(t_mono_s, stamp_s)
            events.append(AutopilotRestart(t_mono_s, step_s))
            return self._next(stream, stamp_s)
        self.drops[Drop.LATE if verdict is Verdict.LATE else Drop.AHEAD] += 1
        return None

    def _next(self, stream: Stream, t_boot_s: float) -> float | None:
        step_s = t_boot_s - self._state.last_s[stream]
        if step_s < 5e-7:
            self.drops[Drop.DUPLICATE if step_s > -5e-7 else Drop.REORDERED] += 1
            return None
        self._state.last_s[stream] = t_boot_s
        self.received[stream] += 1
        return t_boot_s

    # ------------------------------------------------------------------------------------------------- sending

    def encode(self, action: Action) -> bytes | None:
        """Pack the `messages` of an action with the sequence numbers of `codec`; None if there are none."""
        return b"".join(map(self.codec.encode, self.messages(action))) or None

    def messages(self, action: Action) -> list[Any]:
        """Return the messages that an action becomes, as pymavlink's objects; none (counted) if it cannot be sent.

        Before an autopilot is known only the heartbeat leaves. A setpoint with a used component that is not finite does
        not leave at all.
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
                    messages = _setpoint_messages(autopilot, action)
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
        interval_us = 1e6 / action.rate_hz if action.rate_hz > 0.0 else -1.0
        msg_ids = _REQUESTED[action.stream]
        request = _Request(action.stream, self._t_mono_s, len(msg_ids))
        messages: list[Any] = []
        for msg_id in msg_ids:
            self._requests.append((msg_id, request))
            messages.append(
                mavlink.MAVLink_command_long_message(
                    autopilot.system_id,
                    autopilot.component_id,
                    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                    0,
                    float(msg_id),
                    float32(interval_us),
                    0.0,
                    0.0,
                    0.0,
                    0.0,
                    0.0,
                )
            )
        return messages

    def _clock_request_messages(self, action: ClockRequest) -> list[Any]:
        if not math.isfinite(action.t_mono_s):
            return []
        asked_ns = round(action.t_mono_s * 1e9)
        self._clock_requests.append(asked_ns)
        return [mavlink.MAVLink_timesync_message(0, asked_ns)]


def _setpoint_messages(autopilot: AutopilotId, setpoint: Setpoint) -> list[Any]:
    use = setpoint.use.value
    axes = (*setpoint.pos_ned_m, *setpoint.vel_ned_mps, *setpoint.acc_ned_mps2)
    values = [value if use >> bit & 1 else 0.0 for bit, value in enumerate(axes)]
    values.append(setpoint.yaw_rad if use & _YAW else 0.0)
    values.append(setpoint.yaw_rate_radps if use & _YAW_RATE else 0.0)
    if not use or not all(map(math.isfinite, (setpoint.t_boot_s, *values))):
        return []
    return [
        mavlink.MAVLink_set_position_target_local_ned_message(
            round(setpoint.t_boot_s * 1e3) & 0xFFFFFFFF,
            autopilot.system_id,
            autopilot.component_id,
            mavlink.MAV_FRAME_LOCAL_NED,
            ~use & _USE_MASK,
            *map(float32, values),
        )
    ]


def _parameter_read_messages(autopilot: AutopilotId) -> list[Any]:
    name = _VOLTAGE_COMPENSATION.get(autopilot.kind)
    if name is None:
        return []
    return [
        mavlink.MAVLink_param_request_read_message(autopilot.system_id, autopilot.component_id, name.encode(), _BY_NAME)
    ]


_SERVO_FIELDS = tuple(f"servo{i}_raw" for i in range(1, 17))

_Handler = Callable[[AutopilotAdapter, float, Frame, list[Event]], None]
_HANDLERS: dict[int, _Handler] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: AutopilotAdapter._heartbeat,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: AutopilotAdapter._imu,
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
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: AutopilotAdapter._app_setpoint,
}
