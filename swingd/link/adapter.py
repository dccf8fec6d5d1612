"""Between MAVLink and the model: frames become events, actions become messages; no I/O, no clock of its own."""

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.camera_reader import CameraReader
from swingd.link.codec import Frame, Framer
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
    VehicleView,
    meet,
    pack,
    used,
)
from swingd.link.stamps import Drop
from swingd.link.streams import StreamRequests
from swingd.link.telemetry import TELEMETRY_IDS, Telemetry
from swingd.model.actions import (
    Action,
    ClockRequest,
    Health,
    Heartbeat,
    Setpoint,
    StatusText,
    StreamRequest,
    SwingReport,
)
from swingd.model.events import (
    AppSetpoint,
    AutopilotKind,
    AutopilotState,
    Event,
    FlightMode,
    LoadSighting,
    RoundTrip,
    SetpointUse,
    Stream,
    UnmetSetpoint,
)
from swingd.model.parameters import Link, ShaperName, Thrust

__all__ = ["AutopilotAdapter", "AutopilotId", "Drop"]

_CLOCK_REQUESTS_KEPT = 64

_ASK_EVERY_S = 5.0
_REMOTE_CONTROL_HZ = 5.0
_REMOTE_CONTROL_SILENT_S = 1.0

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

_MAV_STATES = {
    Health.INIT: mavlink.MAV_STATE_BOOT,
    Health.READY: mavlink.MAV_STATE_STANDBY,
    Health.ACTIVE: mavlink.MAV_STATE_ACTIVE,
    Health.DEGRADED: mavlink.MAV_STATE_CRITICAL,
    Health.FAULT: mavlink.MAV_STATE_EMERGENCY,
}


@dataclass(frozen=True, slots=True)
class AutopilotId:
    """The autopilot that is served."""

    system_id: int
    component_id: int
    kind: AutopilotKind

    def is_sender_of(self, frame: Frame) -> bool:
        """Whether a frame comes from this autopilot itself, not from another component of its system."""
        return frame.system_id == self.system_id and frame.component_id == self.component_id


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
    Received frames never raise. `Telemetry` reads the autopilot's samples, `StreamRequests` knows which message carries
    a stream on which autopilot, and `swingd.link.setpoints` how each autopilot reads a setpoint.
    """

    def __init__(self, link: Link, thrust: Thrust) -> None:
        self.autopilot: AutopilotId | None = None
        """The autopilot that is served; None until its HEARTBEAT is heard."""
        self._requests = StreamRequests()
        self._telemetry = Telemetry(thrust, self._requests)
        self.drops: Counter[Drop] = self._telemetry.drops
        """What was not used, by reason."""
        self.received: Counter[Stream] = self._telemetry.received
        """Samples that became events."""
        self.system_id = link.system_id or 1
        """The system that swingd is a component of: the autopilot's, once it is known."""
        self._camera = CameraReader(self.drops)
        self._framer = Framer()
        self._system_id_wanted = link.system_id
        self._component_id = link.component_id
        self._wants_remote_control = link.rc_channel != 0
        self._clock_requests: deque[int] = deque(maxlen=_CLOCK_REQUESTS_KEPT)
        self._t_mono_s = 0.0
        self._text_id = 0
        self._asked_t_mono_s = self._remote_control_t_mono_s = -math.inf

    @property
    def view(self) -> VehicleView:
        """What the autopilot told of itself since it started, as far as its reading of setpoints depends on it."""
        return self._telemetry.view

    def configure_motors(self, thrust: Thrust) -> None:
        """Take how motor outputs are normalised.

        Raises
        ------
        ConfigurationError
            If ``motor_output_min`` equals ``motor_output_max``.
        """
        self._telemetry.configure_motors(thrust)

    # ------------------------------------------------------------------------------------------------ receiving

    def receive(self, t_mono_s: float, data: bytes) -> list[Event]:
        """`take` the frames that received bytes, cut anywhere, complete."""
        return self.take(t_mono_s, self._framer.receive(data))

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
            if handler is None and frame.msg_id not in TELEMETRY_IDS:
                continue
            autopilot = self.autopilot
            if autopilot is None and frame.msg_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                autopilot = self._discover(frame)
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                if autopilot is not None:
                    self._reference(t_mono_s, frame, events)
            elif autopilot is not None and autopilot.is_sender_of(frame):
                self._requests.heard(frame.msg_id)
                if handler is None:
                    self._telemetry.take(t_mono_s, frame, events)
                else:
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
        return meet(self.autopilot.kind, frame.message, self._telemetry.view, t_mono_s, source, shaper)

    def sighting(self, t_mono_s: float, frame: Frame) -> LoadSighting | None:
        """Return what a camera's LANDING_TARGET of the load says; None (counted) where it cannot be used; never raises.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at its arrival [s].
        frame : Frame
            LANDING_TARGET, from whatever side.
        """
        return self._camera.take(t_mono_s, frame, self._telemetry)

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
        self.system_id = frame.system_id
        self._telemetry.kind = kind
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
        if not armed:
            self._telemetry.disarmed()
        events.append(AutopilotState(t_mono_s, armed, mode, self.autopilot.kind))

    def _rc_channels(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        self._remote_control_t_mono_s = t_mono_s

    def _command_ack(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        m = frame.message
        if m.command != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL or m.result == mavlink.MAV_RESULT_IN_PROGRESS:
            return
        if m.target_system not in (0, self.system_id) or m.target_component not in (0, self._component_id):
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

    def awaits_clock(self, frame: Frame) -> bool:
        """Whether a TIMESYNC answers one of the requests made here, whoever else may hear it."""
        message = frame.message
        return message is not None and message.tc1 != 0 and message.ts1 in self._clock_requests

    def _reference(self, t_mono_s: float, frame: Frame, events: list[Event]) -> None:
        """Take the reference of mode ``hold``: a setpoint addressed to swingd, in LOCAL_NED."""
        m = frame.message
        is_plausible = self._telemetry.is_plausible
        if m.target_system != self.system_id or m.target_component != self._component_id:
            return
        if m.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or m.type_mask & FORCE_BIT:
            self.drops[Drop.SETPOINT_FRAME] += 1
            return
        use = ~m.type_mask & USE_MASK
        pos = used((m.x, m.y, m.z), use)
        vel = used((m.vx, m.vy, m.vz), use >> 3)
        acc = used((m.afx, m.afy, m.afz), use >> 6)
        yaw_rad = m.yaw if use & YAW else 0.0
        yaw_rate_radps = m.yaw_rate if use & YAW_RATE else 0.0
        if (
            is_plausible(pos, POS_MAX_M)
            and is_plausible(vel, VEL_MAX_MPS)
            and is_plausible(acc, ACC_MAX_MPS2)
            and is_plausible((yaw_rad,), YAW_MAX_RAD)
            and is_plausible((yaw_rate_radps,), YAW_RATE_MAX_RADPS)
        ):
            events.append(AppSetpoint(t_mono_s, SetpointUse(use), pos, vel, acc, yaw_rad, yaw_rate_radps))

    # ------------------------------------------------------------------------------------------------- sending

    def tick(self, t_mono_s: float) -> list[Any]:
        """Return the messages by which the adapter asks for what it needs itself; to be called at some 20 Hz.

        Until it knows them, it asks for the origin of the local frame and for home, which setpoints in global frames
        depend on; and for the remote control where one switches the correction.
        """
        autopilot, view = self.autopilot, self._telemetry.view
        if autopilot is None or t_mono_s - self._asked_t_mono_s < _ASK_EVERY_S:
            return []
        self._asked_t_mono_s = self._t_mono_s = t_mono_s
        messages: list[Any] = []
        if view.origin is None:
            messages.append(_message_request(autopilot, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN))
        if view.home is None:
            messages.append(_message_request(autopilot, mavlink.MAVLINK_MSG_ID_HOME_POSITION))
        if self._wants_remote_control and t_mono_s - self._remote_control_t_mono_s > _REMOTE_CONTROL_SILENT_S:
            messages += self._request_messages(autopilot, StreamRequest(Stream.REMOTE_CONTROL, _REMOTE_CONTROL_HZ))
        return messages

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


def _message_request(autopilot: AutopilotId, msg_id: int) -> Any:
    return mavlink.MAVLink_command_long_message(
        autopilot.system_id,
        autopilot.component_id,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        0,
        float(msg_id),
        *(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )


_Handler = Callable[[AutopilotAdapter, float, Frame, list[Event]], None]
_HANDLERS: dict[int, _Handler] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: AutopilotAdapter._heartbeat,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: AutopilotAdapter._timesync,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: AutopilotAdapter._rc_channels,
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK: AutopilotAdapter._command_ack,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: AutopilotAdapter._reference,
}
