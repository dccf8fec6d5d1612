"""MAVLink 2 signatures, without I/O: made, checked, and the key read from its file.

pymavlink's signing is the tests' oracle and not used here: it signs only what it packs itself, and it takes over the
timestamp of a frame before it has looked at the signature, so that one forged frame shuts the real sender out.
"""

import hashlib
import re
import stat
from collections.abc import Callable
from enum import Enum
from hmac import compare_digest
from pathlib import Path

from swingd.link.codec import CHECKSUM_BYTES, FLAG_SIGNED, HEADER_V2, MAGIC_V2, checksum, checksum_seed
from swingd.model.errors import ConfigurationError

KEY_BYTES = 32
EPOCH_UNIX_S = 1_420_070_400
"""Zero of the timestamps: 2015-01-01 00:00 UTC."""
TICKS_PER_S = 100_000
NEW_STREAM_AGE_TICKS = 60 * TICKS_PER_S
"""How much older than the own time the first timestamp of a stream may be."""

_TIMESTAMP_MAX = 2**48 - 1
_TIMESTAMP_BYTES = 6
_SIGNATURE_BYTES = 6
_STREAMS_MAX = 1024
_KEY_FILE_BYTES_MAX = 4096


class Verdict(Enum):
    """What a signature is worth."""

    GOOD = "good"
    WRONG_SIGNATURE = "wrong signature"
    """Made with another key, or the frame was changed."""
    OLD_TIMESTAMP = "old timestamp"
    """Genuine, but heard before or older than what was heard."""


class Signing:
    """Signs and checks with one key.

    Parameters
    ----------
    key : bytes
        The secret key, 32 bytes.
    link_id : int
        What tells the own signatures on this link from those on other links, 0..255.
    clock : callable
        Time now [s since 1970-01-01 UTC]. It may step in either direction and may be wrong, as on a board without a
        clock of its own: timestamps made here only increase, and follow a peer whose time is ahead.

    Notes
    -----
    A stream is a (link id, system, component); its timestamps must increase. A new one may begin at most a minute
    behind the own time, which is the later of the clock and of every good timestamp seen.
    """

    def __init__(self, key: bytes, link_id: int, clock: Callable[[], float]) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"signing key: {len(key)} bytes given, {KEY_BYTES} expected")
        if not 0 <= link_id <= 255:
            raise ValueError(f"signing link id: {link_id} given, 0..255 expected")
        self._keyed = hashlib.sha256(key)
        self._link_id = bytes((link_id,))
        self._clock = clock
        self._timestamp = 0  # last one that was made or accepted
        self._streams: dict[bytes, int] = {}
        self._forgotten = -1  # latest timestamp of the streams that the table had no room for

    def _now(self) -> int:
        return max(self._timestamp, int((self._clock() - EPOCH_UNIX_S) * TICKS_PER_S))

    def _signature(self, signed: bytes) -> bytes:
        digest = self._keyed.copy()
        digest.update(signed)
        return digest.digest()[:_SIGNATURE_BYTES]

    def sign(self, frame: bytes) -> bytes:
        """Sign one frame; content, sender and sequence number stay.

        Parameters
        ----------
        frame : bytes
            One whole frame.

        Returns
        -------
        bytes
            The frame with the signature. As it was if it has one already or cannot have one: MAVLink 1, a wrong
            checksum.
        """
        if len(frame) < HEADER_V2 + CHECKSUM_BYTES or frame[0] != MAGIC_V2 or frame[2] & FLAG_SIGNED:
            return frame
        seed = checksum_seed(frame)  # the frame itself tells the seed, also where the dialect does not know the id
        if seed is None:
            return frame
        self._timestamp = min(max(self._now(), self._timestamp + 1), _TIMESTAMP_MAX)
        signed = frame[:2] + bytes((frame[2] | FLAG_SIGNED,)) + frame[3:-CHECKSUM_BYTES]
        signed += checksum(signed, seed) + self._link_id + self._timestamp.to_bytes(_TIMESTAMP_BYTES, "little")
        return signed + self._signature(signed)

    def check(self, frame: bytes) -> Verdict:
        """Check one signed frame; a good one moves the time of its stream on.

        Parameters
        ----------
        frame : bytes
            One whole frame that carries a signature.
        """
        signed = frame[:-_SIGNATURE_BYTES]
        if not compare_digest(self._signature(signed), frame[-_SIGNATURE_BYTES:]):
            return Verdict.WRONG_SIGNATURE
        timestamp = int.from_bytes(signed[-_TIMESTAMP_BYTES:], "little")
        stream = signed[-_TIMESTAMP_BYTES - 1 : -_TIMESTAMP_BYTES] + frame[5:7]
        last = self._streams.get(stream)
        if last is None:
            last = max(self._now() - NEW_STREAM_AGE_TICKS - 1, self._forgotten)
        if timestamp <= last:
            return Verdict.OLD_TIMESTAMP
        if stream not in self._streams and len(self._streams) >= _STREAMS_MAX:
            self._forget_oldest()
        self._streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return Verdict.GOOD

    def _forget_oldest(self) -> None:
        """Make room without a way back: what was heard from the forgotten stream stays too old to be heard again."""
        oldest = min(self._streams, key=self._streams.__getitem__)
        self._forgotten = max(self._forgotten, self._streams.pop(oldest))


def read_key(path: Path) -> bytes:
    """Read a signing key: 64 hexadecimal digits, white space around them allowed.

    Returns
    -------
    bytes
        The key, 32 bytes.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or holds something else. The text does not show what it holds.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_KEY_FILE_BYTES_MAX).strip()
    except OSError as error:
        raise ConfigurationError(f"signing key {path}: cannot be read: {error.strerror or error}") from error
    if re.fullmatch(rb"[0-9a-fA-F]{%d}" % (2 * KEY_BYTES), text) is None:
        digits = len(re.findall(rb"[0-9a-fA-F]", text))
        raise ConfigurationError(
            f"signing key {path}: {len(text)} characters, {digits} of them hexadecimal digits; expected "
            f"{2 * KEY_BYTES} hexadecimal digits and nothing else, as 'openssl rand -hex {KEY_BYTES}' writes"
        )
    return bytes.fromhex(text.decode("ascii"))


def key_is_exposed(path: Path) -> bool:
    """Whether others than its owner may read or change the key's file; False where that cannot be told."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return bool(mode & (stat.S_IRWXG | stat.S_IRWXO))
