"""Asks an autopilot for parameters by name, with patience; no I/O, no clock of its own."""

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotId
from swingd.model.events import AutopilotKind

ATTEMPTS = 4
"""Requests for one name before it counts as missing."""
FIRST_WAIT_S = 0.2
"""Patience with the first request; each further one has twice as much [s]."""
OUTSTANDING_MAX = 4
"""Names that may be waited for at a time: a slow link has room for little more."""
ANSWER_S = 0.25
"""A request that was not answered for longer keeps its patience, but no longer its place [s]."""

_BY_NAME = -1
_NAME_BYTES = 16
_FLOAT = struct.Struct("<f")
_PARAM_ERROR: Any = getattr(mavlink, "MAVLink_param_error_message", None)
"""Younger than the oldest pymavlink that serves."""

# PX4 puts the bytes of an integer into the float; the bytes of the smaller types come first.
_BITS = {
    mavlink.MAV_PARAM_TYPE_UINT8: struct.Struct("<B"),
    mavlink.MAV_PARAM_TYPE_INT8: struct.Struct("<b"),
    mavlink.MAV_PARAM_TYPE_UINT16: struct.Struct("<H"),
    mavlink.MAV_PARAM_TYPE_INT16: struct.Struct("<h"),
    mavlink.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
    mavlink.MAV_PARAM_TYPE_INT32: struct.Struct("<i"),
}


@dataclass(slots=True)
class _Asked:
    attempts: int = 0
    asked_s: float = -math.inf
    due_s: float = -math.inf


class ParameterReader:
    """Reads named parameters of one autopilot by PARAM_REQUEST_READ.

    Parameters
    ----------
    autopilot : AutopilotId
        Whom to ask, and how it encodes integers.
    names : iterable of str
        What to ask for, each at most 16 characters of ASCII.

    Raises
    ------
    ValueError
        If a name cannot be asked for.

    Notes
    -----
    An autopilot of today answers nothing for a name that it does not know, as if the link had lost the request. So
    every name is asked for `ATTEMPTS` times, with more patience each time, and the names that were asked for less often
    go first: what is unknown keeps nobody waiting.
    """

    def __init__(self, autopilot: AutopilotId, names: Iterable[str]) -> None:
        self.values: dict[str, float] = {}
        """What was answered, integers as whole numbers; the order is that of the answers."""
        self.missing: set[str] = set()
        """Names that the autopilot does not know, or whose answers were all lost."""
        self._autopilot = autopilot
        self._waiting: dict[str, _Asked] = {}
        for name in names:
            if not (name.isascii() and 0 < len(name) <= _NAME_BYTES):
                raise ValueError(f"{name!r}: expected a parameter's name, 1 to {_NAME_BYTES} characters of ASCII")
            self._waiting[name] = _Asked()

    @property
    def done(self) -> bool:
        """Whether every name is among `values` or `missing`."""
        return not self._waiting

    def tick(self, t_mono_s: float) -> list[Any]:
        """Return the requests that are due, as pymavlink's messages; to be called at some 20 Hz.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock [s].
        """
        for name, asked in list(self._waiting.items()):
            if asked.attempts >= ATTEMPTS and t_mono_s >= asked.due_s:
                del self._waiting[name]
                self.missing.add(name)
        outstanding = sum(t_mono_s - asked.asked_s < ANSWER_S for asked in self._waiting.values())
        due = [name for name, asked in self._waiting.items() if asked.attempts < ATTEMPTS and t_mono_s >= asked.due_s]
        due.sort(key=lambda name: self._waiting[name].attempts)
        messages: list[Any] = []
        for name in due[: max(OUTSTANDING_MAX - outstanding, 0)]:
            asked = self._waiting[name]
            asked.asked_s = t_mono_s
            asked.due_s = t_mono_s + FIRST_WAIT_S * 2**asked.attempts
            asked.attempts += 1
            messages.append(
                mavlink.MAVLink_param_request_read_message(
                    self._autopilot.system_id, self._autopilot.component_id, name.encode(), _BY_NAME
                )
            )
        return messages

    def take(self, message: Any) -> None:
        """Take a decoded message, any; what is no answer of this autopilot is left alone. Never raises.

        Values come in unasked too, when a ground station reads or sets them: the last one holds.
        """
        if message is None or (message.get_srcSystem(), message.get_srcComponent()) != (
            self._autopilot.system_id,
            self._autopilot.component_id,
        ):
            return
        if isinstance(message, mavlink.MAVLink_param_value_message):
            name = _text(message.param_id)
            if name in self._waiting or name in self.values or name in self.missing:
                self._waiting.pop(name, None)
                value = self._value(message)
                if math.isfinite(value):
                    self.missing.discard(name)
                    self.values[name] = value
                elif name not in self.values:
                    self.missing.add(name)
        elif _PARAM_ERROR is not None and isinstance(message, _PARAM_ERROR):
            name = _text(message.param_id)
            if self._waiting.pop(name, None) is not None:
                self.missing.add(name)

    def _value(self, message: Any) -> float:
        value = float(message.param_value)
        bits = _BITS.get(message.param_type)
        if bits is None or self._autopilot.kind is not AutopilotKind.PX4:
            return value
        return float(bits.unpack_from(_FLOAT.pack(value))[0])


def _text(value: Any) -> str:
    raw = value if isinstance(value, bytes) else str(value).encode("utf-8", "replace")
    return raw.split(b"\x00", 1)[0].decode("ascii", "replace")
