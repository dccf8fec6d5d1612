"""The autopilot's parameters, read once in each of its lives, and what they mean for a flight with a load."""

from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotId
from swingd.link.codec import Frame
from swingd.link.preflight.advice import Advice, advise, parameters_of, voltage_compensated
from swingd.link.preflight.reader import ParameterReader
from swingd.model.events import Stream
from swingd.model.parameters import Parameters

READ_IDS = frozenset({mavlink.MAVLINK_MSG_ID_PARAM_VALUE, getattr(mavlink, "MAVLINK_MSG_ID_PARAM_ERROR", 345)})
"""Messages that answer a request for a parameter."""


class Preflight:
    """Asks, keeps what is answered, and judges when nothing more is to be expected."""

    def __init__(self) -> None:
        self._reader: ParameterReader | None = None
        self._autopilot: AutopilotId | None = None
        self._judged = False

    def restart(self) -> None:
        """The autopilot began anew: its parameters may be others."""
        self._reader = None
        self._judged = False

    def tick(self, t_mono_s: float, autopilot: AutopilotId | None) -> list[Any]:
        """Return the requests that are due, as pymavlink's messages."""
        if autopilot is None:
            return []
        if self._reader is None:
            self._autopilot = autopilot
            self._reader = ParameterReader(autopilot, parameters_of(autopilot.kind))
        return self._reader.tick(t_mono_s)

    def take(self, frame: Frame) -> None:
        """Take an answer of the autopilot, one of `READ_IDS`."""
        if self._reader is not None:
            self._reader.take(frame.message)

    @property
    def voltage_compensated(self) -> bool | None:
        """Whether the autopilot compensates the voltage itself; None where that is not known yet."""
        if self._reader is None or self._autopilot is None:
            return None
        return voltage_compensated(self._autopilot.kind, self._reader.values)

    def judge(self, parameters: Parameters, rates_hz: Mapping[Stream, float]) -> list[Advice] | None:
        """Return the advice when every parameter has been answered or given up, once; else None.

        Parameters
        ----------
        parameters : Parameters
            swingd's own.
        rates_hz : mapping
            The streams that are asked for [Hz].
        """
        if self._judged or self._reader is None or self._autopilot is None or not self._reader.done:
            return None
        self._judged = True
        # Light code ends here: by now the filter is loaded, and numpy with it.
        from swingd.control.summary import hover_throttle

        hover = hover_throttle(parameters, parameters.thrust.voltage_nominal_v)
        return advise(self._autopilot.kind, self._reader.values, parameters, hover_throttle=hover, rates_hz=rates_hz)
