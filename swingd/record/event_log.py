"""Every input of the daemon in one file, so that a flight can be run again; and what it sent, to compare.

Layout, little endian::

    magic       8 bytes   b"SWINGDEV"
    version     u16       2
    length      u32       of the header's text
    header      UTF-8     JSON object: "swingd" (version), "configuration" (text, resolved)
    crc32       u32       of all before

    then records:
    kind        u8        RecordKind
    t_mono_s    f64       the host's monotonic clock [s]
    length      u32       of the payload
    payload
    crc32       u32       of the record before it
"""

import json
import math
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from swingd.model.errors import LogFormatError, SwingdError

MAGIC = b"SWINGDEV"
VERSION = 2
_PREFIX = struct.Struct("<8sHI")
_RECORD = struct.Struct("<BdI")
_CRC = struct.Struct("<I")
_PORT = struct.Struct("<I")
_BLOCK_BYTES = 1 << 16
_PENDING_MAX_BYTES = 1 << 23
_PAYLOAD_MAX_BYTES = 1 << 24


class RecordKind(IntEnum):
    """What a record holds."""

    RECEIVED_AUTOPILOT = 1
    """Frames from the side of the autopilot, as one call delivered them."""
    RECEIVED_APPLICATION = 2
    """Frames from a peer behind an endpoint: u32 port, frames."""
    TICK = 3
    """The host's clock; no payload."""
    PARAMETERS = 4
    """New parameters, whole, as text."""
    CORRECTION = 5
    """The correction is switched; one byte, 1 or 0."""
    JOIN = 6
    """The pipeline joins; no payload."""
    PORT_OPENED = 7
    """A peer behind an endpoint is there: u32 port."""
    PORT_CLOSED = 8
    """A peer behind an endpoint is gone: u32 port."""
    MESSAGE = 9
    """The host tells something: one frame, whose sequence number means nothing."""
    SENT_AUTOPILOT = 17
    """One frame sent to the autopilot: output, not to be fed again."""
    SENT_APPLICATION = 18
    """One frame of swingd's own sent to a peer behind an endpoint: u32 port, frame; output, not to be fed again."""

    @property
    def is_output(self) -> bool:
        """Whether a replay compares the record instead of feeding it."""
        return self >= RecordKind.SENT_AUTOPILOT


@dataclass(frozen=True, slots=True)
class Record:
    """One thing that entered or left the daemon."""

    kind: RecordKind
    t_mono_s: float
    payload: bytes

    @property
    def port(self) -> int:
        """Port of a record of an endpoint, 0 where the payload is too short for one."""
        return _PORT.unpack_from(self.payload)[0] if len(self.payload) >= _PORT.size else 0

    @property
    def frames(self) -> bytes:
        """The frames of a record that has some."""
        endpoint = self.kind in (RecordKind.RECEIVED_APPLICATION, RecordKind.SENT_APPLICATION)
        return self.payload[_PORT.size :] if endpoint else self.payload

    @property
    def text(self) -> str:
        """The payload of a `RecordKind.PARAMETERS`."""
        return self.payload.decode("utf-8", errors="replace")

    @property
    def enabled(self) -> bool:
        """The payload of a `RecordKind.CORRECTION`."""
        return self.payload == b"\x01"


class EventLogError(SwingdError):
    """An event log cannot be begun; the text names the file and the reason."""


class EventLogWriter:
    """Append events to a file from a thread of its own; nothing that the disk does reaches the caller.

    When the disk is full, fails, or cannot keep up with 8 MiB waiting, the recording ends where it is (a log with a
    hole could not be replayed), `on_end` is called once, from the caller's thread, and what comes after is counted.

    Parameters
    ----------
    path : Path or str
        File to write; an existing one is replaced.
    swingd_version, configuration : str
        For the header; the configuration is opaque text, resolved so that it says everything.
    on_end : callable, optional
        Gets the reason when the recording ends before `close`.

    Raises
    ------
    EventLogError
        If the file cannot be created. No other method raises.
    """

    def __init__(
        self,
        path: Path | str,
        swingd_version: str,
        configuration: str,
        on_end: Callable[[str], None] | None = None,
    ) -> None:
        self.path = Path(path)
        self.records = 0
        """Records taken."""
        self.lost = 0
        """Records not taken, because the recording had ended."""
        self._on_end = on_end
        self._block = bytearray()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._changed = threading.Condition()
        self._closing = False
        self._ended = False
        self._failure: str | None = None
        text = json.dumps({"swingd": swingd_version, "configuration": configuration}).encode()
        header = _PREFIX.pack(MAGIC, VERSION, len(text)) + text
        try:
            self._file: BinaryIO = self.path.open("wb", buffering=0)
        except OSError as error:
            raise EventLogError(f"{path}: cannot be written: {error.strerror}") from error
        self._block += header + _CRC.pack(crc32(header))
        self._thread = threading.Thread(target=self._write_blocks, name="event-log", daemon=True)
        self._thread.start()

    def write(self, kind: RecordKind, t_mono_s: float, payload: bytes = b"") -> None:
        """Append a record; never raises and never waits for the disk."""
        if self._failure is not None and not self._ended:
            self._end(self._failure)
        if self._ended:
            self.lost += 1
            return
        record = _RECORD.pack(kind, t_mono_s, len(payload)) + payload
        self._block += record + _CRC.pack(crc32(record))
        self.records += 1
        if len(self._block) >= _BLOCK_BYTES:
            self.flush()

    def tick(self, t_mono_s: float) -> None:
        """Append a tick of the host's clock."""
        self.write(RecordKind.TICK, t_mono_s)

    def received(self, port: int, t_mono_s: float, frames: bytes) -> None:
        """Append frames that came through a port, 0 being the autopilot's."""
        if port == 0:
            self.write(RecordKind.RECEIVED_AUTOPILOT, t_mono_s, frames)
        else:
            self.write(RecordKind.RECEIVED_APPLICATION, t_mono_s, _PORT.pack(port) + frames)

    def sent(self, port: int, t_mono_s: float, frame: bytes) -> None:
        """Append a frame that leaves through a port, 0 being the autopilot's."""
        if port == 0:
            self.write(RecordKind.SENT_AUTOPILOT, t_mono_s, frame)
        else:
            self.write(RecordKind.SENT_APPLICATION, t_mono_s, _PORT.pack(port) + frame)

    def join(self, t_mono_s: float) -> None:
        """Append that the pipeline joins."""
        self.write(RecordKind.JOIN, t_mono_s)

    def port(self, t_mono_s: float, port: int, present: bool) -> None:
        """Append that a peer came or went."""
        self.write(RecordKind.PORT_OPENED if present else RecordKind.PORT_CLOSED, t_mono_s, _PORT.pack(port))

    def message(self, t_mono_s: float, frame: bytes) -> None:
        """Append what the host tells."""
        self.write(RecordKind.MESSAGE, t_mono_s, frame)

    def parameters(self, t_mono_s: float, text: str) -> None:
        """Append a change of the parameters, as text."""
        self.write(RecordKind.PARAMETERS, t_mono_s, text.encode("utf-8", errors="replace"))

    def correction(self, t_mono_s: float, enabled: bool) -> None:
        """Append a switch of the correction."""
        self.write(RecordKind.CORRECTION, t_mono_s, b"\x01" if enabled else b"\x00")

    def flush(self) -> None:
        """Hand what has been appended to the writing thread; call it about once a second."""
        if not self._block or self._ended:
            return
        with self._changed:
            if self._waiting_bytes + len(self._block) > _PENDING_MAX_BYTES:
                self._failure = self._failure or "the disk does not keep up"
            else:
                self._waiting.append(bytes(self._block))
                self._waiting_bytes += len(self._block)
                self._changed.notify()
            self._block.clear()

    def close(self, timeout_s: float = 5.0) -> None:
        """Write what is left, wait at most ``timeout_s`` for the disk, and close the file; may be called twice."""
        self.flush()
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)
        if not self._ended:
            self._ended = True
            if self._failure is not None:
                self._report(self._failure)

    def _end(self, reason: str) -> None:
        self._ended = True
        self._block.clear()
        self._report(reason)

    def _report(self, reason: str) -> None:
        if self._on_end is not None:
            self._on_end(f"{self.path}: recording ended: {reason}")

    def _write_blocks(self) -> None:
        with self._file:
            while True:
                with self._changed:
                    while not self._waiting and not self._closing:
                        self._changed.wait()
                    if not self._waiting:
                        return
                    block = self._waiting.popleft()
                try:
                    self._write_whole(block)
                except (OSError, ValueError) as error:
                    with self._changed:
                        reason = error.strerror if isinstance(error, OSError) else None
                        self._failure = reason or str(error)
                        self._waiting.clear()
                    return
                with self._changed:
                    self._waiting_bytes -= len(block)

    def _write_whole(self, block: bytes) -> None:
        rest = memoryview(block)
        while rest:
            rest = rest[self._file.write(rest) :]


class EventLogReader:
    """Iterate over the records of an event log.

    A truncated or damaged tail ends the log; what is left is counted in ``tail_bytes``.

    Raises
    ------
    LogFormatError
        If the file cannot be read, is no event log, or is of another version of the format.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            self._data = self.path.read_bytes()
        except OSError as error:
            raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from error
        data = self._data
        if data[:8] != MAGIC or len(data) < _PREFIX.size:
            raise LogFormatError(f"{path}: begins with {data[:8]!r}; expected an event log of swingd ({MAGIC!r})")
        _, version, length = _PREFIX.unpack_from(data)
        if version != VERSION:
            raise LogFormatError(f"{path}: event log of version {version}; expected {VERSION}")
        end = _PREFIX.size + length
        try:
            if _CRC.unpack_from(data, end)[0] != crc32(data[:end]):
                raise ValueError
            header = json.loads(data[_PREFIX.size : end])
            self.swingd_version = str(header["swingd"])
            self.configuration = str(header["configuration"])
        except (struct.error, ValueError, KeyError, TypeError):
            raise LogFormatError(f"{path}: the header is damaged; expected version and configuration") from None
        self._begin = end + _CRC.size
        self.tail_bytes = 0
        """Bytes at the end that are no whole record, once the iteration has reached them."""

    def __iter__(self) -> Iterator[Record]:
        self.tail_bytes = 0
        data = self._data
        at = self._begin
        while at < len(data):
            body = at + _RECORD.size
            if body > len(data):
                break
            kind, t_mono_s, length = _RECORD.unpack_from(data, at)
            end = body + length
            if length > _PAYLOAD_MAX_BYTES or end + _CRC.size > len(data):
                break
            if _CRC.unpack_from(data, end)[0] != crc32(data[at:end]):
                break
            try:
                record = Record(RecordKind(kind), t_mono_s, data[body:end])
            except ValueError:
                break
            if not math.isfinite(t_mono_s):
                break
            yield record
            at = end + _CRC.size
        self.tail_bytes = len(data) - at
