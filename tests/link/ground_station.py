"""A ground station's side of the parameter and command protocols, packed by pymavlink."""

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec, Frame

SYSTEM, COMPONENT = 1, 191
GROUND = (255, 190)
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


def frame(message: Any, sender: tuple[int, int] = GROUND) -> Frame:
    """The message as a frame that came over a link."""
    (received,) = Codec(1, 1).receive(Codec(*sender).encode(message))
    return received


def on_the_wire(message: Any) -> Any:
    """The message as a peer decodes it."""
    return frame(message, (SYSTEM, COMPONENT)).message


def request_list(system: int = SYSTEM, component: int = COMPONENT) -> Any:
    return mavlink.MAVLink_param_request_list_message(system, component)


def request_read(name: str = "", index: int = -1, system: int = SYSTEM, component: int = COMPONENT) -> Any:
    return mavlink.MAVLink_param_request_read_message(system, component, name.encode(), index)


def param_set(name: str, value: float, kind: int = REAL32, system: int = SYSTEM, component: int = COMPONENT) -> Any:
    return mavlink.MAVLink_param_set_message(system, component, name.encode(), value, kind)


def command_long(
    command: int, param1: float = 0.0, confirmation: int = 0, system: int = SYSTEM, component: int = COMPONENT
) -> Any:
    return mavlink.MAVLink_command_long_message(system, component, command, confirmation, param1, 0, 0, 0, 0, 0, 0)


def command_int(command: int, param1: float = 0.0, system: int = SYSTEM, component: int = COMPONENT) -> Any:
    return mavlink.MAVLink_command_int_message(system, component, 0, command, 0, 0, param1, 0, 0, 0, 0, 0, 0)
