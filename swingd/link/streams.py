"""Which message carries a stream on which autopilot, and what became of asking for it."""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.swing_message import float32
from swingd.model.events import AutopilotKind, Stream, StreamRefused

_MESSAGES: Mapping[Stream, tuple[int, ...]] = {
    Stream.IMU: (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,),
    Stream.ATTITUDE: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    Stream.THROTTLE: (mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,),
    Stream.MOTORS: (mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS, mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW),
    Stream.BATTERY: (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,),
    Stream.LOCAL_POSITION: (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,),
    Stream.LANDED_STATE: (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,),
    Stream.REMOTE_CONTROL: (mavlink.MAVLINK_MSG_ID_RC_CHANNELS,),
}
"""The messages that can carry a stream, the best first."""

_ARDUPILOT_MESSAGES: Mapping[Stream, tuple[int, ...]] = {
    **_MESSAGES,
    # Before 4.4 there is no HIGHRES_IMU; RAW_IMU is stamped in microseconds, SCALED_IMU in milliseconds.
    Stream.IMU: (
        mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
        mavlink.MAVLINK_MSG_ID_RAW_IMU,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU,
    ),
    Stream.THROTTLE: (mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET, mavlink.MAVLINK_MSG_ID_VFR_HUD),
    Stream.MOTORS: (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
}

ARDUPILOT_RATE_MAX_HZ = 200.0
"""ArduPilot delivers this and denies twice as much."""
SILENT_S = 1.5
"""A message that has not come so long after it was asked for is not going to [s]."""
_ACK_WITHIN_S = 3.0
_ACKS_AWAITED = 64


class StreamRequests:
    """Asks for streams by SET_MESSAGE_INTERVAL, one message at a time, and reads the answers.

    The best message of a stream is asked for first. Where the autopilot denies it, or stays silent, the next request
    asks for the next message; where all have failed, it begins anew.
    """

    def __init__(self) -> None:
        self._awaited: deque[tuple[int, Stream, float]] = deque(maxlen=_ACKS_AWAITED)
        self._messages = _MESSAGES
        self.restarted()

    def restarted(self) -> None:
        """Forget what was asked, denied and heard: the autopilot has."""
        self._asked_s: dict[int, float] = {}
        self._denied: set[int] = set()
        self._heard: set[int] = set()

    def serve(self, kind: AutopilotKind) -> None:
        """Ask as that autopilot understands."""
        self._messages = _ARDUPILOT_MESSAGES if kind is AutopilotKind.ARDUPILOT else _MESSAGES

    def heard(self, msg_id: int) -> None:
        """Note that a message came."""
        self._heard.add(msg_id)

    def denied(self, msg_id: int) -> bool:
        """Whether the autopilot denied a message."""
        return msg_id in self._denied

    def request(self, t_mono_s: float, system_id: int, component_id: int, stream: Stream, rate_hz: float) -> Any:
        """Return the COMMAND_LONG that asks for a stream.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock [s].
        system_id, component_id : int
            The autopilot.
        stream : Stream
            What is wanted.
        rate_hz : float
            Finite; 0 or less switches the message off [Hz].
        """
        msg_id = self._choose(t_mono_s, stream)
        if self._messages is _ARDUPILOT_MESSAGES:
            rate_hz = min(rate_hz, ARDUPILOT_RATE_MAX_HZ)
        self._asked_s.setdefault(msg_id, t_mono_s)
        self._awaited.append((msg_id, stream, t_mono_s))
        interval_us = 1e6 / rate_hz if rate_hz > 0.0 else -1.0
        return mavlink.MAVLink_command_long_message(
            system_id,
            component_id,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
            0,
            float(msg_id),
            float32(interval_us),
            *(0.0, 0.0, 0.0, 0.0, 0.0),
        )

    def acknowledged(self, t_mono_s: float, result: int) -> StreamRefused | None:
        """Take an answer to SET_MESSAGE_INTERVAL; return the refusal if no message of the stream is left to ask for.

        An answer does not say which message it is about; autopilots answer in the order of the requests.
        """
        awaited = self._awaited
        while awaited and t_mono_s - awaited[0][2] > _ACK_WITHIN_S:
            awaited.popleft()
        if not awaited:
            return None
        msg_id, stream, _ = awaited.popleft()
        if result == mavlink.MAV_RESULT_ACCEPTED:
            return None
        self._denied.add(msg_id)
        if any(other not in self._denied and self._is_hopeful(other) for other in self._messages[stream]):
            return None
        entry = mavlink.enums["MAV_RESULT"].get(result)
        name = mavlink.mavlink_map[msg_id].msgname
        return StreamRefused(t_mono_s, stream, f"{name}: {entry.name if entry else result}")

    def _choose(self, t_mono_s: float, stream: Stream) -> int:
        messages = self._messages[stream]
        for msg_id in messages:
            if msg_id not in self._denied and (
                self._is_hopeful(msg_id) or t_mono_s - self._asked_s.get(msg_id, -math.inf) < SILENT_S
            ):
                return msg_id
        for msg_id in messages:
            self._asked_s.pop(msg_id, None)
            self._denied.discard(msg_id)
        return messages[0]

    def _is_hopeful(self, msg_id: int) -> bool:
        """Whether a message has come, or was not asked for yet."""
        return msg_id in self._heard or msg_id not in self._asked_s
