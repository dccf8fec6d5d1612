"""A flat ground for ArduPilot, which asks for its terrain by MAVLink.

Its own slung payload stays "landed", and never hangs, until the height over the terrain is known.
"""

import asyncio
import contextlib

from pymavlink.dialects.v20 import common as mavlink

SYSTEM_ID = 254
RETRY_S = 0.5
REQUEST_US = 200_000
_CELLS = 16  # of one TERRAIN_DATA: four by four


class _Buffer:
    """Collects what MAVLink packs."""

    def __init__(self) -> None:
        self.data = b""

    def write(self, data: bytes) -> None:
        self.data += data


class FlatTerrain:
    """Answers an ArduPilot, without I/O."""

    def __init__(self, height_m: int) -> None:
        self._height_m = height_m
        self._out = _Buffer()
        self._mavlink = mavlink.MAVLink(self._out, SYSTEM_ID, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._mavlink.robust_parsing = True
        self._heard = False

    def hello(self) -> bytes:
        """Return what makes the other side speak."""
        self._mavlink.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        return self._take()

    def receive(self, data: bytes) -> bytes:
        """Return the answer to what was received."""
        for message in self._mavlink.parse_buffer(data) or []:
            # An ArduPilot that still boots forgets what it was asked for.
            if message.get_type() == "HEARTBEAT" and not self._heard:
                self._mavlink.command_long_send(
                    *(message.get_srcSystem(), message.get_srcComponent(), mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0),
                    *(mavlink.MAVLINK_MSG_ID_TERRAIN_REQUEST, REQUEST_US, 0, 0, 0, 0, 0),
                )
            if message.get_type() == "TERRAIN_REQUEST":
                self._heard = True
                place = (message.lat, message.lon, message.grid_spacing)
                for bit in range(56):
                    if message.mask >> bit & 1:
                        self._mavlink.terrain_data_send(*place, bit, [self._height_m] * _CELLS)
        return self._take()

    def _take(self) -> bytes:
        data, self._out.data = self._out.data, b""
        return data


async def serve_flat_terrain(port: int, height_m: int) -> None:
    """Answer the ArduPilot behind a TCP port of this machine until cancelled, from when it is there."""
    while True:
        with contextlib.suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                terrain = FlatTerrain(height_m)
                writer.write(terrain.hello())
                while data := await reader.read(4096):
                    writer.write(terrain.receive(data))
            finally:
                writer.close()
        await asyncio.sleep(RETRY_S)
