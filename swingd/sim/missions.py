"""The MISSION protocol: lists of items are taken and given back; they are not flown."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.sim.parameter_server import Send

_CAPACITY: Mapping[int, int] = {
    mavlink.MAV_MISSION_TYPE_MISSION: 2000,
    mavlink.MAV_MISSION_TYPE_FENCE: 64,
    mavlink.MAV_MISSION_TYPE_RALLY: 32,
}
_FRAMES = frozenset(
    {
        mavlink.MAV_FRAME_GLOBAL,
        mavlink.MAV_FRAME_MISSION,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        mavlink.MAV_FRAME_GLOBAL_INT,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    }
)
_RETRY_US = 250_000
_TIMEOUT_US = 5_000_000
_CURRENT_US = 1_000_000
_NO_ITEMS = 65535


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One item, in the units of MISSION_ITEM_INT."""

    frame: int
    command: int
    current: int
    autocontinue: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float


class _Transfer(Enum):
    NONE = 0
    UPLOAD = 1
    DOWNLOAD = 2


class Missions:
    """Missions, fences and rally points of one autopilot; one transfer at a time, as PX4 does.

    Parameters
    ----------
    send : callable
        Takes each message.
    home : callable, optional
        Gives item 0 of every mission (Copter: the home position); without it items are given back as they came.
    """

    def __init__(self, send: Send, home: Callable[[], MissionItem] | None = None) -> None:
        self._send = send
        self._home = home
        self._items: dict[int, list[MissionItem]] = {kind: [] for kind in _CAPACITY}
        self._current = 0
        self._transfer = _Transfer.NONE
        self._partner = (0, 0)
        self._kind = mavlink.MAV_MISSION_TYPE_MISSION
        self._coming: list[MissionItem] = []
        self._count = 0
        self._asked_us = 0
        self._heard_us = 0
        self._told_us = -_CURRENT_US
        self._now_us = 0
        self._in_floats = False

    def items(self, kind: int = mavlink.MAV_MISSION_TYPE_MISSION) -> Sequence[MissionItem]:
        """Give the items that are stored."""
        return tuple(self._items[kind])

    def reset(self) -> None:
        """Break a transfer off, as a boot does; what is stored stays."""
        self._transfer = _Transfer.NONE
        self._asked_us = self._heard_us = self._now_us = 0
        self._told_us = -_CURRENT_US

    def handlers(self) -> dict[int, Callable[[Frame, Any], None]]:
        """What takes each message of the protocol."""
        return {
            mavlink.MAVLINK_MSG_ID_MISSION_COUNT: self._on_count,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM: self._on_item_of_floats,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._on_item,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_request_list,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST: self._on_request_of_floats,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._on_request,
            mavlink.MAVLINK_MSG_ID_MISSION_ACK: self._on_ack,
            mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: self._on_clear_all,
            mavlink.MAVLINK_MSG_ID_MISSION_SET_CURRENT: self._on_set_current,
        }

    def tick(self, now_us: int) -> None:
        """Tell the current item once a second, ask again for what does not come, give up after 5 s."""
        self._now_us = now_us
        if now_us - self._told_us >= _CURRENT_US:
            self._told_us = now_us
            self._send_current()
        if self._transfer is _Transfer.NONE:
            return
        if now_us - self._heard_us > _TIMEOUT_US:
            self._transfer = _Transfer.NONE
        elif self._transfer is _Transfer.UPLOAD and now_us - self._asked_us > _RETRY_US:
            self._ask()

    # ---------------------------------------------------------------- upload

    def _on_count(self, frame: Frame, message: Any) -> None:
        sender = (frame.system_id, frame.component_id)
        kind, count = int(message.mission_type), int(message.count)
        if self._transfer is not _Transfer.NONE:
            again = self._transfer is _Transfer.UPLOAD and sender == self._partner and not self._coming
            if not (again and kind == self._kind):
                self._ack(sender, mavlink.MAV_MISSION_ERROR, kind)
                return
        if kind not in _CAPACITY:
            self._ack(sender, mavlink.MAV_MISSION_UNSUPPORTED, kind)
        elif count > _CAPACITY[kind]:
            self._ack(sender, mavlink.MAV_MISSION_NO_SPACE, kind)
        elif count == 0:
            self._store(kind, [])
            self._ack(sender, mavlink.MAV_MISSION_ACCEPTED, kind)
        else:
            self._transfer = _Transfer.UPLOAD
            self._partner, self._kind, self._count = sender, kind, count
            self._coming = []
            self._heard_us = self._now_us
            self._ask()

    def _ask(self) -> None:
        self._asked_us = self._now_us
        ask = (
            mavlink.MAVLink_mission_request_message if self._in_floats else mavlink.MAVLink_mission_request_int_message
        )
        self._send(ask(*self._partner, len(self._coming), self._kind))

    def _on_item_of_floats(self, frame: Frame, message: Any) -> None:
        self._in_floats = True
        scale = 1.0 if int(message.frame) == mavlink.MAV_FRAME_MISSION else 1e7
        self._take(frame, message, _int32(message.x * scale), _int32(message.y * scale))

    def _on_item(self, frame: Frame, message: Any) -> None:
        self._in_floats = False
        self._take(frame, message, int(message.x), int(message.y))

    def _take(self, frame: Frame, message: Any, x: int, y: int) -> None:
        sender = (frame.system_id, frame.component_id)
        kind, seq = int(message.mission_type), int(message.seq)
        if self._transfer is not _Transfer.UPLOAD or sender != self._partner or kind != self._kind:
            # The last item again: its sender has missed the end.
            done = self._transfer is _Transfer.NONE and sender == self._partner and kind == self._kind
            last = done and seq + 1 == self._count == len(self._items[kind])
            self._ack(sender, mavlink.MAV_MISSION_ACCEPTED if last else mavlink.MAV_MISSION_ERROR, kind)
            return
        self._heard_us = self._now_us
        if seq != len(self._coming):
            return
        if int(message.frame) not in _FRAMES:
            self._transfer = _Transfer.NONE
            self._ack(sender, mavlink.MAV_MISSION_UNSUPPORTED_FRAME, kind)
            return
        params = (message.param1, message.param2, message.param3, message.param4)
        self._coming.append(
            MissionItem(
                int(message.frame),
                int(message.command),
                int(message.current),
                int(message.autocontinue),
                params,
                x,
                y,
                message.z,
            )
        )
        if len(self._coming) < self._count:
            self._ask()
            return
        self._transfer = _Transfer.NONE
        self._store(kind, self._coming)
        self._ack(sender, mavlink.MAV_MISSION_ACCEPTED, kind)

    def _store(self, kind: int, items: list[MissionItem]) -> None:
        self._items[kind] = items
        if kind == mavlink.MAV_MISSION_TYPE_MISSION:
            self._current = next((i for i, item in enumerate(items) if item.current), 0)

    # -------------------------------------------------------------- download

    def _on_request_list(self, frame: Frame, message: Any) -> None:
        sender = (frame.system_id, frame.component_id)
        kind = int(message.mission_type)
        if self._transfer is _Transfer.UPLOAD:
            return
        if kind not in _CAPACITY:
            self._ack(sender, mavlink.MAV_MISSION_UNSUPPORTED, kind)
            return
        items = self._items[kind]
        self._transfer = _Transfer.DOWNLOAD if items else _Transfer.NONE
        self._partner, self._kind, self._count = sender, kind, len(items)
        self._heard_us = self._now_us
        self._send(mavlink.MAVLink_mission_count_message(*sender, len(items), kind))

    def _on_request_of_floats(self, frame: Frame, message: Any) -> None:
        self._give(frame, message, in_floats=True)

    def _on_request(self, frame: Frame, message: Any) -> None:
        self._give(frame, message, in_floats=False)

    def _give(self, frame: Frame, message: Any, *, in_floats: bool) -> None:
        sender = (frame.system_id, frame.component_id)
        kind, seq = int(message.mission_type), int(message.seq)
        if self._transfer is not _Transfer.DOWNLOAD or sender != self._partner or kind != self._kind:
            return
        self._heard_us = self._now_us
        items = self._items[kind]
        if seq >= len(items):
            self._transfer = _Transfer.NONE
            self._ack(sender, mavlink.MAV_MISSION_ERROR, kind)
            return
        item = items[seq]
        if kind == mavlink.MAV_MISSION_TYPE_MISSION:
            if seq == 0 and self._home is not None:
                item = self._home()
            item = replace(item, current=int(seq == self._current))
        head = (*sender, seq, item.frame, item.command, item.current, item.autocontinue, *item.params)
        if in_floats:
            scale = 1.0 if item.frame == mavlink.MAV_FRAME_MISSION else 1e-7
            at = (item.x * scale, item.y * scale, item.z)
            self._send(mavlink.MAVLink_mission_item_message(*head, *at, kind))
        else:
            self._send(mavlink.MAVLink_mission_item_int_message(*head, item.x, item.y, item.z, kind))

    def _on_ack(self, frame: Frame, message: Any) -> None:
        if (frame.system_id, frame.component_id) != self._partner or int(message.mission_type) != self._kind:
            return
        if self._transfer is _Transfer.DOWNLOAD or int(message.type) == mavlink.MAV_MISSION_OPERATION_CANCELLED:
            self._transfer = _Transfer.NONE
        elif self._transfer is _Transfer.UPLOAD and int(message.type) == mavlink.MAV_MISSION_UNSUPPORTED:
            self._in_floats = not self._in_floats
            self._ask()

    # ----------------------------------------------------------------- others

    def _on_clear_all(self, frame: Frame, message: Any) -> None:
        sender = (frame.system_id, frame.component_id)
        kind = int(message.mission_type)
        if self._transfer is not _Transfer.NONE:
            return
        if kind != mavlink.MAV_MISSION_TYPE_ALL and kind not in _CAPACITY:
            self._ack(sender, mavlink.MAV_MISSION_UNSUPPORTED, kind)
            return
        for each in _CAPACITY if kind == mavlink.MAV_MISSION_TYPE_ALL else (kind,):
            self._store(each, [])
        self._ack(sender, mavlink.MAV_MISSION_ACCEPTED, kind)

    def _on_set_current(self, frame: Frame, message: Any) -> None:
        if self._transfer is _Transfer.NONE and int(message.seq) < len(self._items[mavlink.MAV_MISSION_TYPE_MISSION]):
            self._current = int(message.seq)
            self._send_current()

    def _send_current(self) -> None:
        count = len(self._items[mavlink.MAV_MISSION_TYPE_MISSION])
        state = mavlink.MISSION_STATE_NOT_STARTED if count else mavlink.MISSION_STATE_NO_MISSION
        self._send(mavlink.MAVLink_mission_current_message(self._current, count or _NO_ITEMS, state, 2))

    def _ack(self, to: tuple[int, int], result: int, kind: int) -> None:
        self._send(mavlink.MAVLink_mission_ack_message(*to, result, kind))


def _int32(value: float) -> int:
    return round(max(-(2.0**31), min(2.0**31 - 1, value))) if value == value else 0
