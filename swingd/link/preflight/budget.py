"""How many bytes a second the streams take that swingd asks for."""

from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.streams import ARDUPILOT_RATE_MAX_HZ, StreamRequests
from swingd.model.events import AutopilotKind, Stream

FRAME_BYTES = 12
"""MAVLink 2 around a payload, unsigned."""
OTHER_TRAFFIC = 1.2
"""What passes besides the streams asked for (the autopilot's own, commands, parameters), as a factor."""
BITS_PER_BYTE = 10
"""On a serial line: a start bit, eight of data, a stop bit."""
BAUD_RATES = (57600, 115200, 230400, 460800, 500000, 921600, 1500000, 2000000, 3000000)
"""What autopilots offer."""


@dataclass(frozen=True, slots=True)
class LinkBudget:
    """What the streams asked for need."""

    streams_bytes_per_s: float
    """The streams alone, with full payloads as an autopilot plans them."""
    needed_bytes_per_s: float
    """With `OTHER_TRAFFIC`."""

    @property
    def baud(self) -> int | None:
        """The slowest usual rate of a serial line that carries what is needed; None if none does."""
        return next((baud for baud in BAUD_RATES if baud / BITS_PER_BYTE >= self.needed_bytes_per_s), None)


def link_budget(kind: AutopilotKind, rates_hz: Mapping[Stream, float]) -> LinkBudget:
    """Add up the streams by the sizes of the messages that carry them.

    Parameters
    ----------
    kind : AutopilotKind
        Decides which message carries a stream.
    rates_hz : mapping
        What is asked for [Hz].
    """
    total = 0.0
    for stream, rate_hz in rates_hz.items():
        if kind is AutopilotKind.ARDUPILOT:
            rate_hz = min(rate_hz, ARDUPILOT_RATE_MAX_HZ)
        total += rate_hz * frame_bytes(carrier(kind, stream))
    return LinkBudget(total, OTHER_TRAFFIC * total)


def carrier(kind: AutopilotKind, stream: Stream) -> int:
    """Give the id of the message that is to carry a stream, the one that is asked for first."""
    requests = StreamRequests()
    requests.serve(kind)
    return int(requests.request(0.0, 1, 1, stream, 1.0).param1)


def frame_bytes(msg_id: int) -> int:
    """Give the size of a message's unsigned MAVLink 2 frame with its full payload."""
    return FRAME_BYTES + int(mavlink.mavlink_map[msg_id].unpacker.size)
