"""The battery of a simulated autopilot, as that autopilot itself reports it."""

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.link.transport import Transport, open_transport

_SYSTEM_ID = 1
_COMPONENT_ID = mavlink.MAV_COMP_ID_PERIPHERAL
_INTERVAL_US = 100_000.0
_ASKED_EVERY_S = 5.0  # until it is answered; an autopilot does not listen before its boot is over
_UNKNOWN_MV = 0xFFFF


class ReportedBattery:
    """Follow the voltage that one autopilot reports.

    Notes
    -----
    The link is read, and asked for the battery more often than by default; no heartbeat is sent, so that the autopilot
    does not take this for a companion.
    """

    def __init__(self) -> None:
        self.voltage_v: float | None = None
        """Reported last [V]; None before the first report."""
        self._codec = Codec(_SYSTEM_ID, _COMPONENT_ID)
        self._link: Transport | None = None
        self._system_id: int | None = None
        self._ask_s = 0.0
        self._reports = 0

    async def connect(self, url: str) -> None:
        """Open the link to the autopilot.

        Raises
        ------
        LinkOpenError
            If the link cannot work, such as a port in use.
        """
        self._link = await open_transport(url, self._receive)

    async def close(self) -> None:
        """Stop listening."""
        if self._link is not None:
            await self._link.close()

    def ask(self, t_s: float) -> None:
        """Ask for frequent reports if it is time to; ``t_s`` is any clock that goes on [s]."""
        if self._system_id is None or self._reports > 2 or t_s < self._ask_s:
            return
        self._ask_s = t_s + _ASKED_EVERY_S
        self._send(
            mavlink.MAVLink_command_long_message(
                self._system_id,
                mavlink.MAV_COMP_ID_AUTOPILOT1,
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                0,
                mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
                _INTERVAL_US,
                *(0.0,) * 5,
            )
        )

    def _send(self, message: Any) -> None:
        if self._link is not None:
            self._link.send(self._codec.encode(message))

    def _receive(self, _peer: int, data: bytes) -> None:
        for frame in self._codec.receive(data):
            if frame.message is not None and frame.component_id == mavlink.MAV_COMP_ID_AUTOPILOT1:
                self._take(frame.system_id, frame.message)

    def _take(self, system_id: int, message: Any) -> None:
        match message.get_type():
            case "HEARTBEAT":
                self._system_id = system_id
            case "BATTERY_STATUS":
                cells_mv = [v for v in (*message.voltages, *message.voltages_ext) if 0 < v < _UNKNOWN_MV]
                if cells_mv:
                    self._reports += 1
                    self._hear(system_id, 1e-3 * sum(cells_mv))

    def _hear(self, _system_id: int, voltage_v: float) -> None:
        self.voltage_v = voltage_v
