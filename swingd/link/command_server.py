"""What turns the correction on and off: commands addressed to swingd, and a switch on the remote control; no I/O."""

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.link.status_text import RefusalLimiter

SWITCH_COMMAND = mavlink.MAV_CMD_USER_1
"""Switches the correction: ``param1`` 1 on, 0 off."""
RETRY_WITHIN_S = 10.0
"""An attempt with a confirmation count repeats a command of this age at most."""
RC_ON_ABOVE_US = 1600
RC_OFF_BELOW_US = 1400

_SENDERS_KEPT = 16
_RC_MIN_US, _RC_MAX_US = 500, 2500


@dataclass(frozen=True, slots=True)
class CommandReply:
    """What follows from one frame."""

    messages: tuple[Any, ...] = ()
    """pymavlink's messages to send to the system and component that they name."""
    switch: bool | None = None
    """The correction is to be on or off; None if nothing is said about it."""
    refusal: str | None = None
    """Why a command was denied, for pilot and log; rate-limited."""


_NOTHING = CommandReply()


class CommandServer:
    """Answers COMMAND_LONG and COMMAND_INT.

    Parameters
    ----------
    system_id, component_id : int
        Who swingd is, 1..255; ``system_id`` may be set later, when the autopilot is known.

    Notes
    -----
    Only what names this system and component is looked at: a command to everybody is the autopilot's. All but
    `SWITCH_COMMAND` is answered by UNSUPPORTED, requests for messages included: ground stations ask every component
    whether it manages a gimbal, until it answers; applications take anybody's AUTOPILOT_VERSION for the autopilot's.

    An attempt with a confirmation count that repeats a command already carried out is only acknowledged again, so that
    it does not undo what somebody else has switched since. What arrives can never raise.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self._refusals = RefusalLimiter()
        self._done: OrderedDict[tuple[int, int], tuple[float, bool]] = OrderedDict()

    def handle(self, t_mono_s: float, frame: Frame) -> CommandReply:
        """Take one frame, whatever it is and whoever sent it; never raises.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock at its arrival [s].
        frame : Frame
            One that this side may act upon; access is the caller's to judge.
        """
        if frame.msg_id not in (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT):
            return _NOTHING
        if frame.target_system != self.system_id or frame.target_component != self.component_id:
            return _NOTHING
        message = frame.message
        if message.command != SWITCH_COMMAND:
            return CommandReply((_ack(frame, message, mavlink.MAV_RESULT_UNSUPPORTED),))
        if message.param1 not in (0.0, 1.0):
            text = f"MAV_CMD_USER_1: param1 {message.param1:g} given; expected 1 (correction on) or 0 (off)"
            return CommandReply(
                (_ack(frame, message, mavlink.MAV_RESULT_DENIED),), refusal=self._refusals.offer(t_mono_s, text)
            )
        enabled = message.param1 == 1.0
        sender = (frame.system_id, frame.component_id)
        done_s, done = self._done.get(sender, (-math.inf, None))
        is_retry = getattr(message, "confirmation", 0) > 0 and done is enabled and t_mono_s - done_s < RETRY_WITHIN_S
        if not is_retry:
            self._done[sender] = (t_mono_s, enabled)
            self._done.move_to_end(sender)
            if len(self._done) > _SENDERS_KEPT:
                self._done.popitem(last=False)
        return CommandReply(
            (_ack(frame, message, mavlink.MAV_RESULT_ACCEPTED),),
            switch=None if is_retry else enabled,
        )


def _ack(frame: Frame, message: Any, result: int) -> Any:
    return mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, frame.system_id, frame.component_id)


class RcSwitch:
    """A channel of the remote control as a switch for the correction.

    Parameters
    ----------
    channel : int
        1..18; 0 for none.

    Notes
    -----
    Only a change of position says something, so that the ground may switch as well. The first reading is a change to
    where it stands if that is off, and says nothing if it is on: a pilot who begins with the switch off has it off,
    and a switch left on turns nothing on. Between the two thresholds, and without a signal, it stays where it was.
    """

    def __init__(self, channel: int) -> None:
        self._field = f"chan{channel}_raw" if channel else ""
        self._channel = channel
        self._position: bool | None = None

    def handle(self, frame: Frame) -> bool | None:
        """Take a frame of the autopilot; give True (on) or False (off) when the switch was moved, else None.

        Parameters
        ----------
        frame : Frame
            Any; only RC_CHANNELS is looked at. Never raises.
        """
        if not self._channel or frame.msg_id != mavlink.MAVLINK_MSG_ID_RC_CHANNELS:
            return None
        message = frame.message
        width_us = getattr(message, self._field)
        # 0 and 65535 mean no signal, and so does a count that does not reach the channel.
        if message.chancount < self._channel or not _RC_MIN_US <= width_us <= _RC_MAX_US:
            return None
        if width_us > RC_ON_ABOVE_US:
            position = True
        elif width_us < RC_OFF_BELOW_US:
            position = False
        else:
            return None
        before, self._position = self._position, position
        if position is before or (before is None and position):
            return None
        return position
