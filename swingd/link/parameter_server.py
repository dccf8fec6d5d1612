"""swingd's side of MAVLink's parameter protocol, without I/O: lists, gives and sets what may change while it runs."""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.link.status_text import RefusalLimiter
from swingd.model.ground_parameters import BY_NAME, GROUND_PARAMETERS, GroundParameter
from swingd.model.parameters import Parameters

VALUES_PER_TICK = 2
"""PARAM_VALUEs between two ticks: at 20 Hz 1.5 kB/s, a quarter of a telemetry radio at 57600 baud."""

_BY_NAME = -1
_FLOAT = struct.Struct("<f")
_PARAM_ERROR: Any = getattr(mavlink, "MAVLink_param_error_message", None)
"""Younger than the oldest pymavlink that serves."""


class ParameterError(IntEnum):
    """MAV_PARAM_ERROR, of which older dialects know only a part."""

    DOES_NOT_EXIST = 1
    VALUE_OUT_OF_RANGE = 2
    TYPE_MISMATCH = 7


@dataclass(frozen=True, slots=True)
class ParameterReply:
    """What follows from one frame."""

    messages: tuple[Any, ...] = ()
    """pymavlink's messages to send: PARAM_VALUE to everybody, PARAM_ERROR to the system and component it names."""
    changed: Parameters | None = None
    """All parameters with the new value in place; None if nothing changed."""
    parameter: GroundParameter | None = None
    """The one that changed."""
    notice: str | None = None
    """What changed, for pilot and log."""
    refusal: str | None = None
    """Why something was not done, for pilot and log; rate-limited."""


_NOTHING = ParameterReply()


class ParameterServer:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET.

    Parameters
    ----------
    parameters : Parameters
        Where it begins.
    system_id, component_id : int
        Who swingd is, 1..255; ``system_id`` may be set later, when the autopilot is known.

    Notes
    -----
    Requests may be addressed to everybody (0); a PARAM_SET must name this system and component. A request that was not
    addressed to this component alone is never answered by an error: others may know what it asks for.

    At most `VALUES_PER_TICK` messages leave from one call of `tick` to the next; what is asked for beyond is a bit per
    parameter, so that no flood of requests makes anything grow, and errors are left out. What arrives can never raise.

    A value travels as a float of 32 bits: one that is read and written back unchanged is no change, and the nearest
    float to a bound is the bound. A new value is kept as the shortest decimal number that this float stands for,
    which is what its user typed.
    """

    def __init__(self, parameters: Parameters, system_id: int, component_id: int) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self._parameters = parameters
        self._due = [False] * len(GROUND_PARAMETERS)
        self._next = 0
        self._left = VALUES_PER_TICK
        self._refusals = RefusalLimiter()

    @property
    def parameters(self) -> Parameters:
        """All parameters as they stand."""
        return self._parameters

    def configure(self, parameters: Parameters) -> None:
        """Take parameters that were changed elsewhere; the following ticks announce what differs."""
        for parameter in GROUND_PARAMETERS:
            if parameter.get(parameters) != parameter.get(self._parameters):
                self._due[parameter.index] = True
        self._parameters = parameters

    def tick(self) -> tuple[Any, ...]:
        """Give messages that wait, the rest at the next ticks; to be called some 20 times a second."""
        self._left = VALUES_PER_TICK
        messages: list[Any] = []
        # Round robin: a request that is repeated for ever starves no other.
        for step in range(len(self._due)):
            index = (self._next + step) % len(self._due)
            if self._due[index]:
                if not self._left:
                    self._next = index
                    break
                messages.append(self._take(index))
        return tuple(messages)

    def handle(self, t_mono_s: float, frame: Frame) -> ParameterReply:
        """Take one frame, whatever it is and whoever sent it; never raises.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at its arrival [s].
        frame : Frame
            One that this side may act upon; access is the caller's to judge.
        """
        match frame.msg_id:
            case mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
                if self._is_asked(frame):
                    self._due = [True] * len(self._due)
            case mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                if self._is_asked(frame):
                    return self._read(frame)
            case mavlink.MAVLINK_MSG_ID_PARAM_SET:
                if self._is_named(frame):
                    return self._set(t_mono_s, frame)
        return _NOTHING

    def _is_asked(self, frame: Frame) -> bool:
        return frame.target_system in (0, self.system_id) and frame.target_component in (0, self.component_id)

    def _is_named(self, frame: Frame) -> bool:
        return frame.target_system == self.system_id and frame.target_component == self.component_id

    def _read(self, frame: Frame) -> ParameterReply:
        message = frame.message
        parameter: GroundParameter | None = None
        if message.param_index == _BY_NAME:
            parameter = BY_NAME.get(message.param_id)
        elif 0 <= message.param_index < len(GROUND_PARAMETERS):
            parameter = GROUND_PARAMETERS[message.param_index]
        if parameter is not None:
            return ParameterReply(self._answer(parameter))
        if self._is_named(frame):
            error = ParameterError.DOES_NOT_EXIST
            return ParameterReply(self._error(frame, message.param_id, message.param_index, error))
        return _NOTHING

    def _set(self, t_mono_s: float, frame: Frame) -> ParameterReply:
        message = frame.message
        parameter = BY_NAME.get(message.param_id)
        if parameter is None:
            error = ParameterError.DOES_NOT_EXIST
            return ParameterReply(
                self._error(frame, message.param_id, _BY_NAME, error),
                refusal=self._refusals.offer(t_mono_s, f"{printable(message.param_id)}: no such parameter"),
            )
        asked = float(message.param_value)
        problem: tuple[ParameterError, str] | None = None
        if message.param_type != mavlink.MAV_PARAM_TYPE_REAL32:
            problem = ParameterError.TYPE_MISMATCH, f"type {message.param_type} given; expected a float (9)"
        elif not _fits(parameter, asked):
            problem = ParameterError.VALUE_OUT_OF_RANGE, f"{asked:g} given; expected {parameter.expected}"
        if problem is not None:
            error, text = problem
            messages = self._error(frame, message.param_id, _BY_NAME, error)
            return ParameterReply(
                (*messages, *self._answer(parameter)),
                refusal=self._refusals.offer(t_mono_s, f"{parameter.name}: {text}"),
            )
        before = parameter.get(self._parameters)
        if asked == float32(before):
            return ParameterReply(self._answer(parameter))
        # Adding zero takes the sign from a negative one.
        value = min(max(shortest(asked), parameter.low), parameter.high) + 0.0
        self._parameters = parameter.put(self._parameters, value)
        unit = f" {parameter.unit}" if parameter.unit else ""
        return ParameterReply(
            self._answer(parameter),
            changed=self._parameters,
            parameter=parameter,
            notice=f"{parameter.name}: {before:g} to {value:g}{unit}, by {frame.system_id}/{frame.component_id}",
        )

    def _answer(self, parameter: GroundParameter) -> tuple[Any, ...]:
        """Give its value now, or leave it to the next ticks."""
        self._due[parameter.index] = True
        return (self._take(parameter.index),) if self._left else ()

    def _take(self, index: int) -> Any:
        self._left -= 1
        self._due[index] = False
        parameter = GROUND_PARAMETERS[index]
        return mavlink.MAVLink_param_value_message(
            parameter.name.encode(),
            parameter.get(self._parameters),
            mavlink.MAV_PARAM_TYPE_REAL32,
            len(GROUND_PARAMETERS),
            index,
        )

    def _error(self, frame: Frame, name: str, index: int, error: ParameterError) -> tuple[Any, ...]:
        if _PARAM_ERROR is None or not self._left:
            return ()
        self._left -= 1
        return (_PARAM_ERROR(frame.system_id, frame.component_id, name.encode("ascii", "replace"), index, int(error)),)


def _fits(parameter: GroundParameter, asked: float) -> bool:
    """Whether a float of 32 bits is within the bounds as such floats; no NaN is."""
    if parameter.is_switch:
        return asked in (0.0, 1.0)
    return float32(parameter.low) <= asked <= float32(parameter.high)


def float32(value: float) -> float:
    """Round to what a float of 32 bits holds."""
    rounded: float = _FLOAT.unpack(_FLOAT.pack(value))[0]
    return rounded


def shortest(value: float) -> float:
    """Give the decimal number with the fewest digits that becomes ``value`` as a float of 32 bits.

    Parameters
    ----------
    value : float
        Finite, and exact in 32 bits.
    """
    for digits in range(1, 9):
        short = float(f"{value:.{digits}g}")
        if float32(short) == value:
            return short
    return float(f"{value:.9g}")


def printable(text: str) -> str:
    """Give a name from a link in a form that a log or a screen may show."""
    return "".join(c if " " < c <= "~" else "?" for c in text)
