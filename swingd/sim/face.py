"""What an autopilot looks like from its link; one face per kind of autopilot is derived from this."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from math import isfinite, nan
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.model.actions import SwingReport
from swingd.sim.cascade import Axes
from swingd.sim.missions import Missions
from swingd.sim.onboard import Onboard
from swingd.sim.parameter_server import ParameterServer, Send
from swingd.sim.parameter_table import ParameterTable
from swingd.sim.px4_parameters import Px4Parameters
from swingd.sim.streams import Streams

FORCE_MAGIC = 21196.0
"""Second parameter of a disarming that asks nobody."""

Handler = Callable[[Frame, Any], None]

_REPORTS_MAX = 200_000


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
    TEMPORARILY_REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    DENIED = mavlink.MAV_RESULT_DENIED
    UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
    FAILED = mavlink.MAV_RESULT_FAILED


@dataclass(slots=True)
class CompanionLog:
    """What companion computers and applications told the simulated autopilot."""

    reports: deque[SwingReport] = field(default_factory=lambda: deque(maxlen=_REPORTS_MAX))
    """What was published as DEBUG_FLOAT_ARRAY ``SWING``."""
    status_texts: deque[tuple[float, int, str]] = field(default_factory=lambda: deque(maxlen=1000))
    """Time, severity and text of each STATUSTEXT."""
    heartbeat_t_s: float = nan
    """Time of the last HEARTBEAT, nan before the first."""
    setpoints: int = 0
    """Setpoints and targets that were understood."""
    setpoints_refused: int = 0
    """Setpoints with a frame or mask that the autopilot refuses."""


@dataclass(frozen=True, slots=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT."""

    number: int
    params: tuple[float, float, float, float, float, float, float]
    """Places in degrees."""
    frame: int | None
    """Of a COMMAND_INT, None of a COMMAND_LONG."""


class Face(ABC):
    """Streams, parameters, missions, commands and setpoints of one kind of autopilot.

    Parameters
    ----------
    onboard : Onboard
        What is behind the face.
    companion : CompanionLog
        Where setpoints are counted.
    send : callable
        Takes each message that leaves.
    """

    parameters: ParameterTable
    """What the PARAM protocol shows."""
    loops: Px4Parameters
    """What the control loops obey."""
    parameter_server: ParameterServer
    streams: Streams
    missions: Missions
    early_probability: float = 0.0
    """How often the sending thread runs before the newest sample is out."""
    pass_unsigned: Collection[int] = ()
    """Message ids that need no signature where signing is demanded."""
    strangers: Collection[int] = ()
    """Message ids that are not taken if they are addressed to every system."""
    failed: Result = Result.FAILED
    """Answer to the request of a message that there is not."""

    def __init__(self, onboard: Onboard, companion: CompanionLog, send: Send) -> None:
        self.onboard = onboard
        self._companion = companion
        self._send = send

    @abstractmethod
    def heartbeat(self) -> Any:
        """Make the HEARTBEAT."""

    @abstractmethod
    def version(self) -> Any:
        """Make the AUTOPILOT_VERSION."""

    @abstractmethod
    def execute(self, command: Command) -> Result:
        """Do what a command of this autopilot asks, a reboot apart, and give its MAV_RESULT."""

    @abstractmethod
    def set_mode(self, base_mode: int, custom_mode: int) -> Result:
        """Do what SET_MODE asks and give the MAV_RESULT."""

    @abstractmethod
    def set_interval(self, msg_id: int, interval_us: float) -> Result:
        """Change a stream's interval and give the MAV_RESULT."""

    @abstractmethod
    def local_target(self, message: Any) -> bool:
        """Take SET_POSITION_TARGET_LOCAL_NED; False if it is refused."""

    @abstractmethod
    def global_target(self, message: Any) -> bool:
        """Take SET_POSITION_TARGET_GLOBAL_INT; False if it is refused."""

    @abstractmethod
    def attitude_target(self, message: Any) -> bool:
        """Take SET_ATTITUDE_TARGET; False if it is refused."""

    def boot(self) -> None:
        """Start anew; parameters and missions stay."""
        self.onboard.boot()
        self.streams.reset()
        self.parameter_server.reset()
        self.missions.reset()

    def tick(self) -> None:
        """Do what time asks for, before the streams."""
        self.missions.tick(self.onboard.now_us)

    def send_queued(self) -> None:
        """Send what waits behind the streams."""
        self.parameter_server.tick()

    def handlers(self) -> dict[int, Handler]:
        """What takes each message."""
        return {
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command_long,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT: self._on_command_int,
            mavlink.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_local_target,
            mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._on_global_target,
            mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._on_attitude_target,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_param_list,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_param_read,
            mavlink.MAVLINK_MSG_ID_PARAM_SET: self._on_param_set,
            **self.missions.handlers(),
        }

    # ---------------------------------------------------------------- inputs

    def _count(self, understood: bool) -> None:
        if understood:
            self._companion.setpoints += 1
        else:
            self._companion.setpoints_refused += 1

    def _on_local_target(self, frame: Frame, message: Any) -> None:
        self._count(self.local_target(message))

    def _on_global_target(self, frame: Frame, message: Any) -> None:
        self._count(self.global_target(message))

    def _on_attitude_target(self, frame: Frame, message: Any) -> None:
        self._count(self.attitude_target(message))

    def _on_param_list(self, frame: Frame, message: Any) -> None:
        self.parameter_server.list_all()

    def _on_param_read(self, frame: Frame, message: Any) -> None:
        self.parameter_server.read(text_of(message.param_id), int(message.param_index))

    def _on_param_set(self, frame: Frame, message: Any) -> None:
        self.parameter_server.write(text_of(message.param_id), float(message.param_value), int(message.param_type))

    def _on_set_mode(self, frame: Frame, message: Any) -> None:
        self.set_mode(int(message.base_mode), int(message.custom_mode))

    def _on_command_long(self, frame: Frame, message: Any) -> None:
        places = (message.param5, message.param6, message.param7)
        self._on_command(frame, message, places, None)

    def _on_command_int(self, frame: Frame, message: Any) -> None:
        places = (message.x * 1e-7, message.y * 1e-7, message.z)
        self._on_command(frame, message, places, int(message.frame))

    def _on_command(
        self, frame: Frame, message: Any, places: tuple[float, float, float], of_places: int | None
    ) -> None:
        params = (message.param1, message.param2, message.param3, message.param4, *places)
        command = Command(int(message.command), params, of_places)
        reboots = command.number == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
        if not reboots:
            result = self._common(command)
        elif self.onboard.autopilot.armed or params[0] != 1.0:
            result = Result.DENIED
        else:
            result = Result.ACCEPTED
        self._send(
            mavlink.MAVLink_command_ack_message(command.number, result, 0, 0, frame.system_id, frame.component_id)
        )
        if reboots and result == Result.ACCEPTED:
            self.reboot()

    def _common(self, command: Command) -> Result:
        """Commands that every autopilot understands alike, then its own."""
        p = command.params
        if command.number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self.set_interval(whole(p[0]), p[1])
        if command.number == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return self.request_message(whole(p[0]))
        if command.number == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return self.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if command.number == mavlink.MAV_CMD_GET_HOME_POSITION:
            return self.request_message(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
        return self.execute(command)

    def request_message(self, msg_id: int) -> Result:
        """Send a message once and give the MAV_RESULT."""
        stream = self.streams.get(msg_id)
        if stream is not None:
            message = stream.build()
        elif msg_id == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            message = self.version()
        else:
            return self.failed
        if message is None:
            return self.failed
        self._send(message)
        return Result.ACCEPTED

    reboot: Callable[[], None]
    """Set by the peer: silence, then `boot`."""


def available(builders: Mapping[int, Callable[[], Any]], without: Collection[int]) -> dict[int, Callable[[], Any]]:
    """Leave out the messages that this autopilot is not to have."""
    return {msg_id: build for msg_id, build in builders.items() if msg_id not in without}


def axes_of(values: tuple[float, float, float], mask: int, shift: int) -> Axes:
    """Components of one group of a type mask that are meant, None for the others."""
    n, e, d = (
        None if mask >> (shift + i) & 1 or not isfinite(value) else float(value) for i, value in enumerate(values)
    )
    return (n, e, d)


def whole(value: float) -> int:
    """Whole number in a command's float, -1 if it is none."""
    return int(value) if isfinite(value) and value == int(value) else -1


def text_of(value: Any) -> str:
    """Text of a message's character field."""
    raw = value if isinstance(value, bytes) else str(value).encode("utf-8", "replace")
    return raw.split(b"\x00", 1)[0].decode("utf-8", "replace")
