"""The autopilot's mission, read by the MISSION protocol and understood as places of the load; no I/O."""

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotId
from swingd.link.codec import Frame
from swingd.link.setpoints import GeodeticPoint, VehicleView, azimuthal_equidistant
from swingd.model.events import Mission, Vec3
from swingd.model.parameters import LEG_MIN_M, WAYPOINT_MAX_M

ITEMS_MAX = 200
"""Of a mission that is led along."""
RETRY_S = 0.5
TRIES = 8
"""Of one question; then the mission is given up until something asks for it anew."""
MISSION_IDS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_MISSION_COUNT,
        mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_ACK,
    }
)
"""What the autopilot answers by."""

_MISSION = mavlink.MAV_MISSION_TYPE_MISSION
_ABOVE_SEA = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
_ABOVE_HOME = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)


class MissionReader:
    """Reads the mission when it is told to, and whenever the autopilot confirms an upload to somebody.

    Parameters
    ----------
    component_id : int
        Who asks.
    """

    def __init__(self, component_id: int) -> None:
        self._component_id = component_id
        self.want()

    def want(self, not_before_s: float = -math.inf) -> None:
        """Read it from the beginning, not before a time of the host's monotonic clock [s]."""
        self._count: int | None = None
        self._items: list[Any] = []
        self._tries = 0
        self._asked_s = not_before_s - RETRY_S
        self._told = False
        self._problem = ""

    def _is_complete(self) -> bool:
        return self._count is not None and len(self._items) == self._count

    def tick(self, t_mono_s: float, autopilot: AutopilotId | None) -> list[Any]:
        """Return the question that is due; to be called at some 20 Hz."""
        if autopilot is None or self._problem or self._is_complete() or t_mono_s - self._asked_s < RETRY_S:
            return []
        if self._tries >= TRIES:
            self._problem = "the autopilot does not give its mission"
            return []
        return self._ask(t_mono_s, autopilot)

    def take(self, t_mono_s: float, autopilot: AutopilotId, frame: Frame) -> list[Any]:
        """Take a frame of the autopilot, one of `MISSION_IDS`; return what is to be sent in answer; never raises."""
        message = frame.message
        if message is None or message.mission_type != _MISSION:
            return []
        is_ours = message.target_system == autopilot.system_id and message.target_component == self._component_id
        if not is_ours:
            acknowledges = frame.msg_id == mavlink.MAVLINK_MSG_ID_MISSION_ACK
            if acknowledges and message.type == mavlink.MAV_MISSION_ACCEPTED:
                # Somebody has uploaded or cleared a mission.
                self.want()
            return []
        if self._problem or self._is_complete():
            return []
        if self._count is None and frame.msg_id == mavlink.MAVLINK_MSG_ID_MISSION_COUNT:
            if message.count > ITEMS_MAX:
                self._problem = f"a mission of {message.count} items; expected at most {ITEMS_MAX}"
                return []
            self._count = message.count
        elif (
            self._count is not None
            and frame.msg_id == mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT
            and message.seq == len(self._items)
        ):
            self._items.append(message)
        else:
            # Busy, or something else again: the question is repeated.
            return []
        self._tries = 0
        if self._is_complete():
            accepted = mavlink.MAV_MISSION_ACCEPTED
            return [mavlink.MAVLink_mission_ack_message(*_ids(autopilot), accepted, _MISSION)] if self._count else []
        return self._ask(t_mono_s, autopilot)

    def _ask(self, t_mono_s: float, autopilot: AutopilotId) -> list[Any]:
        self._asked_s = t_mono_s
        self._tries += 1
        if self._count is None:
            return [mavlink.MAVLink_mission_request_list_message(*_ids(autopilot), _MISSION)]
        return [mavlink.MAVLink_mission_request_int_message(*_ids(autopilot), len(self._items), _MISSION)]

    def read(self, t_mono_s: float, view: VehicleView) -> Mission | None:
        """Return what was read, or why it cannot be led along, once; None while it is not known.

        Places of a global frame wait until the origin of the local frame, and where they need it home, is known.
        """
        if self._told or not (self._problem or self._is_complete()):
            return None
        if self._problem:
            self._told = True
            return Mission(t_mono_s, (), self._problem)
        if self._items and view.origin is None:
            return None
        if view.home is None and any(item.frame in _ABOVE_HOME for item in self._items):
            return None
        self._told = True
        places: list[Vec3] = []
        for item in self._items:
            place = _place(item, view)
            if isinstance(place, str):
                return Mission(t_mono_s, (), f"mission item {item.seq}: {place}")
            if places and math.dist(places[-1], place) < LEG_MIN_M:
                return Mission(
                    t_mono_s, (), f"mission item {item.seq}: where the one before is; expected another place"
                )
            places.append(place)
        return Mission(t_mono_s, tuple(places), "" if places else "the autopilot has no mission")


def _ids(autopilot: AutopilotId) -> tuple[int, int]:
    return autopilot.system_id, autopilot.component_id


def _place(item: Any, view: VehicleView) -> Vec3 | str:
    """Return a place in local NED, or what is wrong with an item."""
    if item.command != mavlink.MAV_CMD_NAV_WAYPOINT:
        name = mavlink.enums["MAV_CMD"].get(item.command)
        return f"{name.name if name is not None else item.command} given; expected nothing but MAV_CMD_NAV_WAYPOINT"
    if item.param1 != 0.0 and item.param1 == item.param1:
        return f"a hold of {item.param1:g} s given; expected 0: the load stops at the last one only"
    origin, home = view.origin, view.home
    assert origin is not None
    if item.frame in _ABOVE_SEA:
        ground = GeodeticPoint(0, 0, 0)
    elif item.frame in _ABOVE_HOME and home is not None:
        ground = home
    else:
        return f"frame {item.frame} given; expected a global frame above sea or above home"
    if abs(item.x) > 900_000_000 or abs(item.y) > 1_800_000_000 or not abs(item.z) <= WAYPOINT_MAX_M:
        return "a place that cannot be"
    down_m = (origin.alt_amsl_mm - ground.alt_amsl_mm) * 1e-3 - item.z
    place = (*azimuthal_equidistant(origin, item.x, item.y), down_m)
    if max(map(abs, place)) > WAYPOINT_MAX_M:
        return f"more than {WAYPOINT_MAX_M:g} m from the origin"
    return place
