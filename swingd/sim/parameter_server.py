"""The PARAM protocol over a table, in the manner of PX4 or of ArduPilot."""

import struct
from collections import deque
from collections.abc import Callable
from math import isfinite
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.sim.copter_parameters import CopterParameters
from swingd.sim.parameter_table import ParameterTable

Send = Callable[[Any], None]

_AT_ONCE = 2
_NO_INDEX = 65535
_KINDS = {
    0: mavlink.MAV_PARAM_TYPE_REAL32,
    8: mavlink.MAV_PARAM_TYPE_INT8,
    16: mavlink.MAV_PARAM_TYPE_INT16,
    32: mavlink.MAV_PARAM_TYPE_INT32,
}


class ParameterServer:
    """PX4's manner: whole numbers travel as the bytes of an INT32 in the float field.

    Parameters
    ----------
    table : ParameterTable
        What is served.
    send : callable
        Takes each answer.
    """

    def __init__(self, table: ParameterTable, send: Send) -> None:
        self._table = table
        self._send = send
        self._names = sorted(table)
        self._index = {name: i for i, name in enumerate(self._names)}
        self._queue: deque[int] = deque()

    def list_all(self) -> None:
        """Answer PARAM_REQUEST_LIST, two values at each `tick`."""
        self._queue = deque(range(len(self._names)))

    def read(self, name: str, index: int) -> None:
        """Answer PARAM_REQUEST_READ by index, or by name where the index is negative; unknown ones are not answered."""
        if index < 0:
            if name in self._index:
                self._send_value(name)
        elif index < len(self._names):
            self._send_value(self._names[index])

    def write(self, name: str, value: float, kind: int) -> None:
        """Answer PARAM_SET with the value that holds then; unknown names are not answered."""
        if name not in self._index:
            return
        is_int = self._table.is_int(name)
        if kind == (mavlink.MAV_PARAM_TYPE_INT32 if is_int else mavlink.MAV_PARAM_TYPE_REAL32):
            if is_int:
                (value,) = struct.unpack("<i", struct.pack("<f", value))
            self._table.set(name, value)
        self._send_value(name)

    def tick(self) -> None:
        """Send what is queued."""
        for _ in range(min(_AT_ONCE, len(self._queue))):
            self._send_indexed(self._queue.popleft())

    def reset(self) -> None:
        """Forget what is queued, as a boot does."""
        self._queue.clear()

    def _send_value(self, name: str) -> None:
        self._send_indexed(self._index[name])

    def _send_indexed(self, index: int) -> None:
        name = self._names[index]
        value, kind = self._on_link(name)
        self._send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self._names), index))

    def _on_link(self, name: str) -> tuple[float, int]:
        """Value of the float field and the type beside it."""
        value = self._table[name]
        if self._table.is_int(name):
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
            return value, mavlink.MAV_PARAM_TYPE_INT32
        return value, mavlink.MAV_PARAM_TYPE_REAL32


class CopterParameterServer(ParameterServer):
    """ArduPilot's manner: every value travels as a float, and an answer outside of a list has no index."""

    def __init__(self, table: CopterParameters, send: Send) -> None:
        super().__init__(table, send)
        self._bits = {name: table.bits(name) for name in table if table.is_int(name)}

    def write(self, name: str, value: float, kind: int) -> None:
        """Answer PARAM_SET with the value that holds then; the type is not looked at."""
        if name not in self._index or not isfinite(value):
            return
        if name in self._bits:
            top = 2 ** (self._bits[name] - 1)
            value = max(-top, min(top - 1, round(value)))
        self._table.set(name, value)
        self._send_value(name)

    def _send_value(self, name: str) -> None:
        value, kind = self._on_link(name)
        self._send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self._names), _NO_INDEX))

    def _on_link(self, name: str) -> tuple[float, int]:
        return float(self._table[name]), _KINDS[self._bits.get(name, 0)]
