"""The autopilot's end of its link: framing, sequence numbers and, with a key, MAVLink 2 signing."""

from collections.abc import Collection
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import MAGIC_V2, Codec, Frame

KEY_BYTES = 32
_SIGNED = 0x01
_TICKS_PER_S = 100_000
_EPOCH_UNIX_S = 1_420_070_400  # signing counts from the beginning of 2015


class Wire:
    """Packs and frames as one component, and signs if it has a key.

    Parameters
    ----------
    system_id, component_id : int
        Who sends.
    key : bytes or None
        32 bytes: everything that is sent is signed, and what comes must be.
    start_unix_s : float
        Unix time of the start [s], for the signatures; 0 as of an autopilot without one, which takes the time of the
        first signed frame that it hears.
    pass_unsigned : collection of int
        Message ids that need no signature.

    Raises
    ------
    ValueError
        If the key has another length.
    """

    def __init__(
        self,
        system_id: int,
        component_id: int,
        key: bytes | None = None,
        start_unix_s: float = 0.0,
        pass_unsigned: Collection[int] = (),
    ) -> None:
        if key is not None and len(key) != KEY_BYTES:
            raise ValueError(f"signing key of {len(key)} bytes: expected {KEY_BYTES}")
        self._codec = Codec(system_id, component_id)
        self._packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._pass_unsigned = frozenset(pass_unsigned)
        self._start_ticks = max(0, round((start_unix_s - _EPOCH_UNIX_S) * _TICKS_PER_S))
        self._key = key
        if key is not None:
            self._packer.signing.secret_key = key
            self._packer.signing.sign_outgoing = True
            self._packer.signing.timestamp = self._start_ticks
        self.refused = 0
        """Frames without a signature, or with a wrong one."""

    def receive(self, data: bytes) -> list[Frame]:
        """Give the frames that are believed."""
        frames = self._codec.receive(data)
        if self._key is None:
            return frames
        believed = [frame for frame in frames if self._is_believed(frame)]
        self.refused += len(frames) - len(believed)
        return believed

    def encode(self, message: Any, t_s: float) -> bytes:
        """Pack a message at ``t_s`` since the start, with the next sequence number."""
        packer = self._packer
        if self._key is not None:
            packer.signing.timestamp = max(packer.signing.timestamp, self._start_ticks + round(t_s * _TICKS_PER_S))
        raw: bytes = message.pack(packer)
        packer.seq = (packer.seq + 1) & 0xFF
        return raw

    def restart(self) -> None:
        """Forget half a frame and the sequence number, as a boot does; the signing goes on."""
        self._codec = Codec(self._codec.system_id, self._codec.component_id)
        self._packer.seq = 0

    def _is_believed(self, frame: Frame) -> bool:
        raw = frame.raw
        if raw[0] == MAGIC_V2 and raw[2] & _SIGNED:
            good = self._packer.check_signature(bytearray(raw), frame.system_id, frame.component_id)
            return bool(good) or frame.msg_id in self._pass_unsigned
        return frame.msg_id in self._pass_unsigned
