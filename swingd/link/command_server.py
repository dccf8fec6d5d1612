"""Commands addressed to swingd, and the remote control's switch: the correction on and off, a path's orders; no I/O."""

import math
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.link.status_text import RefusalLimiter
from swingd.model.events import PathOrder

SWITCH_COMMAND = mavlink.MAV_CMD_USER_1
"""Switches the correction: ``param1`` 1 on, 0 off."""
PATH_COMMANDS = {
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: {0.0: PathOrder.PAUSE, 1.0: PathOrder.CONTINUE},
    mavlink.MAV_CMD_USER_2: {0.0: PathOrder.ABORT},
}
"""Orders to mode `path`, by command and ``param1``."""
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
    order: PathOrder | None = None
    """What a path is to do; None if nothing is said about it."""
    refusal: str | None = None
    """Why a command was denied, for pilot and log; rate-limited."""


_NOTHING = CommandReply()
_MEANINGS: dict[int, Mapping[float, bool | PathOrder]] = {SWITCH_COMMAND: {1.0: True, 0.0: False}, **PATH_COMMANDS}
_NAMES = {
    SWITCH_COMMAND: "MAV_CMD_USER_1",
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: "MAV_CMD_DO_PAUSE_CONTINUE",
    mavlink.MAV_CMD_USER_2: "MAV_CMD_USER_2",
}
_EXPECTED = {
    SWITCH_COMMAND: "1 (correction on) or 0 (off)",
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: "0 (pause) or 1 (continue)",
    mavlink.MAV_CMD_USER_2: "0 (abort the path)",
}


class CommandServer:
    """Answers COMMAND_LONG and COMMAND_INT.

    Parameters
    ----------
    system_id, component_id : int
        Who swingd is, 1..255; ``system_id`` may be set later, when the autopilot is known.

    Notes
    -----
    Only what names this system and component is looked at: a command to everybody is the autopilot's. All but
    `SWITCH_COMMAND` and `PATH_COMMANDS` is answered by UNSUPPORTED, requests for messages included: ground stations
    ask every component whether it manages a gimbal, until it answers; applications take anybody's AUTOPILOT_VERSION
    for the autopilot's.

    An attempt with a confirmation count that repeats a command already carried out is only acknowledged again, so that
    it does not undo what somebody else has switched since. What arrives can never raise.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self._refusals = RefusalLimiter()
        self.leads = False
        """Whether mode `path` is on, so that there is something to pause; to be kept up to date by the caller."""
        self._done: OrderedDict[tuple[int, int, int], tuple[float, bool | PathOrder]] = OrderedDict()

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
        meanings = _MEANINGS.get(message.command)
        if meanings is None:
            return CommandReply((_ack(frame, message, mavlink.MAV_RESULT_UNSUPPORTED),))
        meaning = meanings.get(message.param1)
        text = None
        if meaning is None:
            text = f"{_NAMES[message.command]}: param1 {message.param1:g} given; expected {_EXPECTED[message.command]}"
        elif isinstance(meaning, PathOrder) and not self.leads:
            text = f"{_NAMES[message.command]}: mode path is not on; expected it, or the autopilot as the target"
        if meaning is None or text is not None:
            denied = _ack(frame, message, mavlink.MAV_RESULT_DENIED)
            return CommandReply((denied,), refusal=self._refusals.offer(t_mono_s, text or ""))
        accepted = (_ack(frame, message, mavlink.MAV_RESULT_ACCEPTED),)
        sender = (frame.system_id, frame.component_id, message.command)
        done_s, done = self._done.get(sender, (-math.inf, None))
        if getattr(message, "confirmation", 0) > 0 and done is meaning and t_mono_s - done_s < RETRY_WITHIN_S:
            return CommandReply(accepted)
        self._done[sender] = (t_mono_s, meaning)
        self._done.move_to_end(sender)
        if len(self._done) > _SENDERS_KEPT:
            self._done.popitem(last=False)
        if isinstance(meaning, PathOrder):
            return CommandReply(accepted, order=meaning)
        return CommandReply(accepted, switch=meaning)


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
