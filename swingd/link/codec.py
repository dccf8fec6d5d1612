"""MAVLink frames from bytes and bytes from messages, without I/O.

The bytes are framed here and only those messages are decoded that somebody looks at: a daemon that receives 800 frames
a second consumes half of them. Decoding and packing use pymavlink's message classes; its parser is not used, because
it checks no frame of an unknown id, drops the bytes of a false start, and can be told by an environment variable to
ignore checksums.
"""

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from fastcrc import crc16
from pymavlink.dialects.v20 import common as mavlink

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
HEADER_V1 = 6
HEADER_V2 = 10
CHECKSUM_BYTES = 2
SIGNATURE_BYTES = 13
FLAG_SIGNED = 0x01
_PAYLOAD_MAX = 255
_SEQUENCE_AT = 4
"""Of a MAVLink 2 frame."""
_MAGIC = re.compile(rb"[\xfd\xfe]")


def _crc_table() -> tuple[int, ...]:
    """CRC-16/MCRF4XX of each byte, starting from zero."""
    return tuple(crc16.mcrf4xx(bytes([byte]), 0) for byte in range(256))


_CRC_OF = _crc_table()
_BYTE_OF_CRC = {crc: byte for byte, crc in enumerate(_CRC_OF)}


def checksum_seed(frame: bytes) -> int | None:
    """Seed (CRC extra) that makes the checksum of a frame right, whether its id is known or not.

    Parameters
    ----------
    frame : bytes
        One whole frame without signature.

    Returns
    -------
    int or None
        The only such seed, 0..255; None where no seed does.
    """
    crc = crc16.mcrf4xx(frame[1:-CHECKSUM_BYTES], 0xFFFF)
    wanted = frame[-2] | frame[-1] << 8
    byte = _BYTE_OF_CRC.get(wanted ^ crc >> 8)
    return None if byte is None else byte ^ crc & 0xFF


def cut_frames(frames: bytes) -> Iterator[bytes]:
    """Cut whole frames that were joined; a rest that begins no frame comes last, as it is."""
    at, size = 0, len(frames)
    while at < size:
        end = size
        if size - at >= 3 and frames[at] == MAGIC_V2:
            end = at + HEADER_V2 + frames[at + 1] + CHECKSUM_BYTES
            end += SIGNATURE_BYTES if frames[at + 2] & FLAG_SIGNED else 0
        elif size - at >= 3 and frames[at] == MAGIC_V1:
            end = at + HEADER_V1 + frames[at + 1] + CHECKSUM_BYTES
        yield frames[at:end]
        at = end


def checksum(frame: bytes, seed: int) -> bytes:
    """Checksum over everything behind the magic of a frame that ends with its payload, as it stands on the wire."""
    crc: int = crc16.mcrf4xx(frame[1:] + bytes((seed,)), 0xFFFF)
    return crc.to_bytes(CHECKSUM_BYTES, "little")


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


def _target_offsets(message_class: Any) -> tuple[int, int] | None:
    """Offsets of ``target_system`` and ``target_component`` in the payload; beyond every payload where not there."""
    names = message_class.ordered_fieldnames
    if "target_system" not in names:
        return None
    sizes = [struct.calcsize("<" + part) for part in re.findall(r"\d*[a-zA-Z]", message_class.unpacker.format)]
    offsets = {name: sum(sizes[:i]) for i, name in enumerate(names)}
    return offsets["target_system"], offsets.get("target_component", _PAYLOAD_MAX)


_TARGETS = {i: offsets for i, c in mavlink.mavlink_map.items() if (offsets := _target_offsets(c)) is not None}
ADDRESSED_IDS = frozenset(_TARGETS)
"""The messages that say for whom they are."""


@dataclass(slots=True)
class Frame:
    """One MAVLink frame with a good checksum, as it came."""

    raw: bytes
    """The whole frame, signature included, fit to be passed on untouched."""
    msg_id: int
    system_id: int
    component_id: int
    _message: Any = field(default=None, init=False, repr=False, compare=False)

    @property
    def is_v2(self) -> bool:
        """Whether it is a MAVLink 2 frame."""
        return self.raw[0] == MAGIC_V2

    @property
    def signed(self) -> bool:
        """Whether it carries a signature, good or not."""
        raw = self.raw
        return raw[0] == MAGIC_V2 and bool(raw[2] & FLAG_SIGNED)

    @property
    def has_target(self) -> bool:
        """Whether its message is addressed; one that has no target, or an unknown id, is for everybody."""
        return self.msg_id in _TARGETS

    @property
    def target_system(self) -> int:
        """System that it is addressed to; 0 for all, and where the message has no such field."""
        offsets = _TARGETS.get(self.msg_id)
        return 0 if offsets is None else self._payload_byte(offsets[0])

    @property
    def target_component(self) -> int:
        """Component that it is addressed to; 0 for all, and where the message has no such field."""
        offsets = _TARGETS.get(self.msg_id)
        return 0 if offsets is None else self._payload_byte(offsets[1])

    def _payload_byte(self, offset: int) -> int:
        raw = self.raw
        if offset >= raw[1]:
            return 0  # MAVLink 2 cuts trailing zeros; MAVLink 1 has no extension fields
        return raw[(HEADER_V2 if raw[0] == MAGIC_V2 else HEADER_V1) + offset]

    @property
    def message(self) -> Any:
        """The message as pymavlink's object, decoded at the first look; None for ids unknown to the dialect."""
        if self._message is None:
            self._message = self._decode()
        return self._message

    def _decode(self) -> Any:
        decoder = _decoder(self.msg_id)
        if decoder is None:
            return None
        raw = self.raw
        start = HEADER_V2 if raw[0] == MAGIC_V2 else HEADER_V1
        message = decoder(raw[start : start + raw[1]])
        header = message.get_header()
        header.srcSystem = self.system_id
        header.srcComponent = self.component_id
        header.seq = raw[4] if raw[0] == MAGIC_V2 else raw[2]
        header.mlen = raw[1]
        return message


@dataclass(slots=True)
class FramingCounters:
    """What a framer has seen since it was made."""

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


class Framer:
    """Frames out of received bytes.

    Parameters
    ----------
    counters : FramingCounters, optional
        Where to count, for several framers that count together; else a new one.

    Notes
    -----
    The frames do not depend on how the stream is cut into chunks. After a false start the search goes on at the next
    byte, so garbage never hides a good frame. The checksum of an id that the dialect does not know is checked as far
    as possible: some seed must make it right, which random bytes pass once in 256.
    Signatures are passed on, not checked.
    """

    def __init__(self, counters: FramingCounters | None = None) -> None:
        self.counters = FramingCounters() if counters is None else counters
        self._pending = b""

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
                    if flags != FLAG_SIGNED:
                        counters.unknown_flags += 1
                        counters.garbage_bytes += 1
                        at += 1
                        continue
                    signature = SIGNATURE_BYTES
                header = HEADER_V2
            else:
                header = HEADER_V1
            checked = header + data[at + 1]
            whole = checked + CHECKSUM_BYTES + signature
            if left < whole:
                break
            raw = data[at : at + whole]
            if header == HEADER_V2:
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


class Encoder:
    """Bytes out of messages, numbered for one receiver: it counts the gaps in the sequence as losses of the link.

    Parameters
    ----------
    system_id, component_id : int
        Sender of the frames, 1..255; both may be set later.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self.sent = 0
        """Frames packed."""
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

    @component_id.setter
    def component_id(self, value: int) -> None:
        self._packer.srcComponent = value

    def encode(self, message: Any) -> bytes:
        """Pack one of pymavlink's messages as an unsigned MAVLink 2 frame with the next sequence number.

        Raises
        ------
        struct.error, OverflowError
            If a field does not fit its type: the caller's error, nothing that a link can cause.
        """
        packer = self._packer
        raw: bytes = message.pack(packer)
        packer.seq = (packer.seq + 1) & 0xFF
        self.sent += 1
        return raw

    def number(self, frame: bytes) -> bytes:
        """Return what `encode` would of the same message: a tenth of the work where several receivers get it.

        Parameters
        ----------
        frame : bytes
            Packed by an `Encoder` of the same sender.
        """
        packer = self._packer
        numbered = frame[:_SEQUENCE_AT] + bytes((packer.seq,)) + frame[_SEQUENCE_AT + 1 : -CHECKSUM_BYTES]
        packer.seq = (packer.seq + 1) & 0xFF
        self.sent += 1
        return numbered + checksum(numbered, _CRC_EXTRA[frame[7] | frame[8] << 8 | frame[9] << 16])


class Codec(Framer, Encoder):
    """Both directions of one link.

    Parameters
    ----------
    system_id, component_id : int
        Sender of what is encoded, 1..255; both may be set later.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        Framer.__init__(self)
        Encoder.__init__(self, system_id, component_id)
