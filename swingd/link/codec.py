"""MAVLink frames from bytes and bytes from messages, without I/O.

The bytes are framed here and only those messages are decoded that somebody looks at: a daemon that receives 800 frames
a second consumes half of them. Decoding and packing use pymavlink's message classes; its parser is not used, because
it checks no frame of an unknown id, drops the bytes of a false start, and can be told by an environment variable to
ignore checksums.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fastcrc import crc16
from pymavlink.dialects.v20 import common as mavlink

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
_HEADER_V1 = 6
_HEADER_V2 = 10
_CHECKSUM = 2
_SIGNATURE = 13
_FLAG_SIGNED = 0x01
_MAGIC = re.compile(rb"[\xfd\xfe]")


def _crc_table() -> tuple[int, ...]:
    """CRC-16/MCRF4XX of each byte, starting from zero."""
    return tuple(crc16.mcrf4xx(bytes([byte]), 0) for byte in range(256))


_CRC_OF = _crc_table()
_BYTE_OF_CRC = {crc: byte for byte, crc in enumerate(_CRC_OF)}


class _Decoder:
    """Turns the payload of one message id into pymavlink's message object."""

    __slots__ = ("_build", "_fields", "_size", "_unpack")

    def __init__(self, message_class: Any) -> None:
        self._build = message_class
        self._unpack = message_class.unpacker.unpack
        self._size = message_class.unpacker.size
        lengths = message_class.lengths
        fields = [(sum(lengths[:order]), lengths[order]) for order in message_class.orders]
        in_order = fields == [(i, 1) for i in range(len(fields))] and "s" not in message_class.unpacker.format
        self._fields: list[tuple[int, int]] | None = None if in_order else fields

    def __call__(self, payload: bytes) -> Any:
        # MAVLink 2 cuts trailing zeros and newer peers append fields.
        size = self._size
        if len(payload) < size:
            payload = payload.ljust(size, b"\x00")
        values = self._unpack(payload if len(payload) == size else payload[:size])
        if self._fields is None:
            return self._build(*values)
        arguments: list[Any] = []
        for start, length in self._fields:
            value = values[start]
            if isinstance(value, bytes):
                arguments.append(value.rstrip(b"\x00"))
            elif length == 1:
                arguments.append(value)
            else:
                arguments.append(list(values[start : start + length]))
        return self._build(*arguments)


_CRC_EXTRA: dict[int, int] = {msg_id: c.crc_extra for msg_id, c in mavlink.mavlink_map.items()}
_DECODERS: dict[int, _Decoder] = {}


def _decoder(msg_id: int) -> _Decoder | None:
    decoder = _DECODERS.get(msg_id)
    if decoder is None and msg_id in _CRC_EXTRA:
        decoder = _DECODERS[msg_id] = _Decoder(mavlink.mavlink_map[msg_id])
    return decoder


@dataclass(frozen=True, slots=True)
class Frame:
    """One MAVLink frame with a good checksum, as it came."""

    raw: bytes
    """The whole frame, signature included, fit to be passed on untouched."""
    msg_id: int
    system_id: int
    component_id: int

    @property
    def message(self) -> Any:
        """The message as pymavlink's object, a fresh one at each access; None for ids unknown to the dialect."""
        decoder = _decoder(self.msg_id)
        if decoder is None:
            return None
        raw = self.raw
        start = _HEADER_V2 if raw[0] == MAGIC_V2 else _HEADER_V1
        message = decoder(raw[start : start + raw[1]])
        header = message.get_header()
        header.srcSystem = self.system_id
        header.srcComponent = self.component_id
        header.seq = raw[4] if raw[0] == MAGIC_V2 else raw[2]
        header.mlen = raw[1]
        return message


@dataclass(slots=True)
class CodecCounters:
    """What a codec has seen since it was made."""

    frames: int = 0
    """Frames with a good checksum, ids unknown to the dialect included."""
    unknown_ids: int = 0
    """Frames among them whose id the dialect does not know."""
    garbage_bytes: int = 0
    """Bytes that belong to no frame."""
    bad_checksums: int = 0
    """Starts of a frame whose checksum was wrong."""
    unknown_flags: int = 0
    """Starts of a frame with incompatibility flags that are not understood."""
    sent: int = 0
    """Frames packed."""


class Codec:
    """One end of a MAVLink link: frames out of received bytes, bytes out of messages.

    Parameters
    ----------
    system_id, component_id : int
        What `encode` signs its frames with, 1..255; both may be set later.

    Notes
    -----
    The frames do not depend on how the stream is cut into chunks. After a false start the search goes on at the next
    byte, so garbage never hides a good frame. The checksum of an id that the dialect does not know is checked as far
    as possible: some seed must make it right, which random bytes pass once in 256.
    Signatures are passed on, not checked.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self.counters = CodecCounters()
        self._pending = b""
        self._packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    @property
    def system_id(self) -> int:
        """System that `encode` sends as."""
        return int(self._packer.srcSystem)

    @system_id.setter
    def system_id(self, value: int) -> None:
        self._packer.srcSystem = value

    @property
    def component_id(self) -> int:
        """Component that `encode` sends as."""
        return int(self._packer.srcComponent)

    def receive(self, data: bytes) -> list[Frame]:
        """Take the next bytes of the stream and return the frames that they complete; never raises.

        At most 291 bytes (one frame and its start) are kept back for the next call.
        """
        if self._pending:
            data = self._pending + data
        counters = self.counters
        frames: list[Frame] = []
        find: Callable[..., re.Match[bytes] | None] = _MAGIC.search
        crc_of = _CRC_OF
        size = len(data)
        at = 0
        while True:
            if at < size and data[at] != MAGIC_V2 and data[at] != MAGIC_V1:
                match = find(data, at)
                start = match.start() if match else size
                counters.garbage_bytes += start - at
                at = start
            left = size - at
            if left < 3:
                break
            signature = 0
            if data[at] == MAGIC_V2:
                flags = data[at + 2]
                if flags:
                    if flags != _FLAG_SIGNED:
                        counters.unknown_flags += 1
                        counters.garbage_bytes += 1
                        at += 1
                        continue
                    signature = _SIGNATURE
                header = _HEADER_V2
            else:
                header = _HEADER_V1
            checked = header + data[at + 1]
            whole = checked + _CHECKSUM + signature
            if left < whole:
                break
            raw = data[at : at + whole]
            if header == _HEADER_V2:
                msg_id = raw[7] | raw[8] << 8 | raw[9] << 16
                system_id = raw[5]
                component_id = raw[6]
            else:
                msg_id = raw[5]
                system_id = raw[3]
                component_id = raw[4]
            crc = crc16.mcrf4xx(raw[1:checked], 0xFFFF)
            wanted = raw[checked] | raw[checked + 1] << 8
            seed = _CRC_EXTRA.get(msg_id)
            if seed is None:
                good = wanted ^ crc >> 8 in _BYTE_OF_CRC
                counters.unknown_ids += good
            else:
                good = crc >> 8 ^ crc_of[(crc ^ seed) & 0xFF] == wanted
            if not good:
                counters.bad_checksums += 1
                counters.garbage_bytes += 1
                at += 1
                continue
            frames.append(Frame(raw, msg_id, system_id, component_id))
            at += whole
        counters.frames += len(frames)
        self._pending = data[at:]
        return frames

    def encode(self, message: Any) -> bytes:
        """Pack one of pymavlink's messages as MAVLink 2 with the next sequence number.

        Raises
        ------
        struct.error, OverflowError
            If a field does not fit its type: the caller's error, nothing that a link can cause.
        """
        packer = self._packer
        raw: bytes = message.pack(packer)
        packer.seq = (packer.seq + 1) & 0xFF
        self.counters.sent += 1
        return raw
