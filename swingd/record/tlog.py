"""MAVLink telemetry logs (.tlog): for each frame its time of reception and its bytes."""

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from swingd.model.errors import LogFormatError

_STAMP = 8
_STAMP_MAX_US = 2**53
_MAGIC = frozenset((0xFD, 0xFE))


def _record_length(data: bytes, at: int) -> int | None:
    """Length of the record at ``at``, None if none begins there, 0 if its header is cut off."""
    frame = at + _STAMP
    if frame >= len(data):
        return 0
    magic = data[frame]
    if magic not in _MAGIC or int.from_bytes(data[at:frame], "big") > _STAMP_MAX_US:
        return None
    if frame + 3 > len(data):
        return 0
    if magic == 0xFE:
        return _STAMP + 8 + data[frame + 1]
    flags = data[frame + 2]
    if flags > 1:
        return None
    return _STAMP + 12 + data[frame + 1] + 13 * flags


class TlogReader:
    """Iterate over the frames of a .tlog, as ``(t_s, frame)``.

    ``t_s`` is the unix time of reception [s], ``frame`` the raw MAVLink frame; its checksum is not looked at. Garbage
    between records is skipped to the next place where a record is followed by another one, and a truncated tail ends
    the log; both are counted.

    Raises
    ------
    LogFormatError
        If the file cannot be read or holds no record at all.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            self._data = self.path.read_bytes()
        except OSError as error:
            raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from error
        self.garbage_bytes = 0
        """Bytes skipped so far in the current iteration."""
        self.truncated_bytes = 0
        """Bytes of an incomplete last record."""
        if next(iter(self), None) is None:
            raise LogFormatError(
                f"{path}: no MAVLink record found; expected a .tlog: 8 bytes of unix time in microseconds, "
                "most significant first, before each MAVLink frame"
            )

    def __iter__(self) -> Iterator[tuple[float, bytes]]:
        self.garbage_bytes = self.truncated_bytes = 0
        data = self._data
        size = len(data)
        at = 0
        while at < size:
            length = _record_length(data, at)
            end = at + length if length else size + 1
            if length is None or (end < size and _record_length(data, end) is None):
                following = self._resynchronise(at + 1)
                self.garbage_bytes += following - at
                at = following
                continue
            if end > size:
                self.truncated_bytes = size - at
                return
            yield int.from_bytes(data[at : at + _STAMP], "big") * 1e-6, data[at + _STAMP : end]
            at = end

    def _resynchronise(self, at: int) -> int:
        data = self._data
        while at < len(data):
            length = _record_length(data, at)
            if length and (at + length == len(data) or (at + length < len(data) and _record_length(data, at + length))):
                return at
            at += 1
        return len(data)


class TlogWriter:
    """Write frames to a .tlog that any ground station reads.

    Raises
    ------
    OSError
        From the constructor, `write` and `close`.
    """

    def __init__(self, path: Path | str) -> None:
        self._file = Path(path).open("wb")  # noqa: SIM115 (closed by close)

    def write(self, t_unix_s: float, frame: bytes) -> None:
        """Append one raw frame with its unix time of reception [s]."""
        self._file.write(round(t_unix_s * 1e6).to_bytes(_STAMP, "big") + frame)

    def close(self) -> None:
        """Write what is buffered and close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
