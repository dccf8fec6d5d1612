"""What one vehicle of a formation says, its autopilot and the swingd beside it, and what it is asked for; no I/O."""

import math
from collections import Counter, deque
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.codec import Frame
from swingd.link.stamps import Drop
from swingd.link.streams import StreamRequests
from swingd.link.telemetry import Telemetry
from swingd.model.actions import Health
from swingd.model.events import AutopilotKind, AutopilotRestart, Event, Stream
from swingd.model.formation import (
    CableForce,
    CableSwing,
    ClockAnswer,
    DirectionSource,
    LocalOrigin,
    RiggedVehicle,
    VehicleEvent,
    WinchTurned,
)
from swingd.model.parameters import Thrust

AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
EARTH_RADIUS_M = {AutopilotKind.PX4: 6_371_000.0, AutopilotKind.ARDUPILOT: 6_378_100.0}
"""Of the sphere on which an autopilot maps degrees; others are taken for PX4."""
CLOCK_EVERY_S = 0.5
CLOCKS_AWAITED = 16
ASK_EVERY_S = 2.0
RATE_SHARE = 0.75
"""Of what was asked for: below it, it is asked for again."""

_TELEMETRY = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    }
)
_STREAMS = (Stream.ATTITUDE, Stream.LOCAL_POSITION)
_KINDS = {
    mavlink.MAV_AUTOPILOT_PX4: AutopilotKind.PX4,
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: AutopilotKind.ARDUPILOT,
}
_EVENTS = (*VehicleEvent.__args__,)


class FormationListener:
    """Reads the frames of one vehicle's system, and asks its autopilot for what is missing.

    Parameters
    ----------
    rig : RiggedVehicle
    stream_rate_hz : float
        Attitude and position to ask for; 0: nothing is asked but the clock and the origin [Hz].

    Notes
    -----
    Telemetry is that of component 1; SWING and the winch's value may come from any component of the system, with stamps
    of the same boot clock.
    """

    def __init__(self, rig: RiggedVehicle, stream_rate_hz: float) -> None:
        self.rig = rig
        self._rate_hz = stream_rate_hz
        self._requests = StreamRequests()
        self._telemetry = Telemetry(Thrust(), self._requests)
        self._origin: object = None
        self._clocks: deque[int] = deque(maxlen=CLOCKS_AWAITED)
        self._clock_s = -math.inf
        self._asked_s = -math.inf
        self._counted: Counter[Stream] = Counter()
        self.heard = False
        """Whether the autopilot has said anything."""

    @property
    def drops(self) -> Counter[Drop]:
        """Samples of the autopilot that were not used, by reason."""
        return self._telemetry.drops

    def receive(self, t_mono_s: float, frame: Frame) -> list[VehicleEvent]:
        """Take a frame of the system; return what it tells. Never raises."""
        msg_id = frame.msg_id
        if msg_id == mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY:
            return self._swing(t_mono_s, frame.message)
        if msg_id == mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT:
            return self._winch(t_mono_s, frame.message)
        if frame.component_id != AUTOPILOT_COMPONENT:
            return []
        if msg_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self.heard = True
            kind = self._telemetry.kind = _KINDS.get(frame.message.autopilot, AutopilotKind.OTHER)
            self._requests.serve(kind)
        elif msg_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
            return self._timesync(t_mono_s, frame.message)
        elif msg_id in _TELEMETRY:
            self.heard = True
            self._requests.heard(msg_id)
            events: list[Event] = []
            self._telemetry.take(t_mono_s, frame, events)
            told: list[VehicleEvent] = [event for event in events if isinstance(event, _EVENTS)]
            if any(isinstance(event, AutopilotRestart) for event in told):
                self._origin = None
                self._clocks.clear()
            return [*told, *self._new_origin(t_mono_s)]
        return []

    def messages(self, t_mono_s: float) -> list[Any]:
        """Return what is to be asked now; to be called at some 10 Hz."""
        messages: list[Any] = []
        if not self.heard:
            return messages
        if t_mono_s - self._clock_s >= CLOCK_EVERY_S:
            self._clock_s = t_mono_s
            sent_ns = round(t_mono_s * 1e9)
            self._clocks.append(sent_ns)
            messages.append(mavlink.MAVLink_timesync_message(0, sent_ns))
        elapsed_s = t_mono_s - self._asked_s
        if elapsed_s < ASK_EVERY_S:
            return messages
        self._asked_s = t_mono_s
        target = self.rig.system_id, AUTOPILOT_COMPONENT
        for stream in _STREAMS:
            came = self._telemetry.received[stream] - self._counted[stream]
            self._counted[stream] = self._telemetry.received[stream]
            if self._rate_hz > 0.0 and came < RATE_SHARE * self._rate_hz * elapsed_s:
                messages.append(self._requests.request(t_mono_s, *target, stream, self._rate_hz))
        if self.rig.origin_ned_m is None and self._telemetry.view.origin is None:
            wanted = float(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
            messages.append(
                mavlink.MAVLink_command_long_message(
                    *target, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, wanted, *(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                )
            )
        return messages

    def _swing(self, t_mono_s: float, message: Any) -> list[VehicleEvent]:
        report = swing_message.decode(message)
        if report is None:
            return []
        if self.rig.direction is DirectionSource.FORCE:
            force = report.disturbance
            # Where none is estimated there is nothing to be told.
            return (
                [] if force is None else [CableForce(t_mono_s, report.t_boot_s, force.force_ned_n, force.force_std_n)]
            )
        return [
            CableSwing(
                t_mono_s,
                report.t_boot_s,
                report.xi_rad,
                report.zeta_rad,
                report.xi_rate_radps,
                report.zeta_rate_radps,
                report.xi_std_rad,
                report.zeta_std_rad,
                Health(report.health),
            )
        ]

    def _winch(self, t_mono_s: float, message: Any) -> list[VehicleEvent]:
        if not self.rig.winch or _text(message.name) != self.rig.winch:
            return []
        return [WinchTurned(t_mono_s, message.time_boot_ms * 1e-3, message.value)]

    def _timesync(self, t_mono_s: float, message: Any) -> list[VehicleEvent]:
        # Questions of the autopilot (tc1 = 0) are not answered, answers to others are not ours.
        if message.tc1 <= 0 or message.ts1 not in self._clocks:
            return []
        self._clocks.remove(message.ts1)
        return [ClockAnswer(t_mono_s, message.ts1 * 1e-9, message.tc1 * 1e-9)]

    def _new_origin(self, t_mono_s: float) -> list[VehicleEvent]:
        origin = self._telemetry.view.origin
        if origin is None or origin == self._origin:
            return []
        self._origin = origin
        radius_m = EARTH_RADIUS_M.get(self._telemetry.kind, EARTH_RADIUS_M[AutopilotKind.PX4])
        lat_rad, lon_rad = math.radians(origin.lat_1e7_deg * 1e-7), math.radians(origin.lon_1e7_deg * 1e-7)
        return [LocalOrigin(t_mono_s, lat_rad, lon_rad, origin.alt_amsl_mm * 1e-3, radius_m)]


def _text(name: bytes | str) -> str:
    return name if isinstance(name, str) else name.decode("latin-1")
