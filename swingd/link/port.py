"""One side of swingd: received bytes to the frames that may pass, and bytes to what may leave; no I/O."""

from collections.abc import Callable
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame, Framer, FramingCounters, cut_frames
from swingd.link.signing import Signing, Verdict

UNSIGNED_PASSES = frozenset({mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_RADIO_STATUS})
"""Messages that a port with a key takes without signature."""


@dataclass(slots=True)
class PortCounters:
    """What the ports of one endpoint have seen since the first of them was made."""

    accepted: int = 0
    """Frames that passed."""
    unsigned: int = 0
    """Frames refused because they carry no signature."""
    wrong_signature: int = 0
    """Frames refused because their signature is of another key or of other content."""
    old_timestamp: int = 0
    """Frames refused because they were heard before, or are older than what was heard."""
    system_not_allowed: int = 0
    """Frames refused because of the system that sent them."""
    framing: FramingCounters = field(default_factory=FramingCounters)

    @property
    def refused(self) -> int:
        """Whole frames that did not pass."""
        return self.unsigned + self.wrong_signature + self.old_timestamp + self.system_not_allowed


class Port:
    """Framing, access and signing of one peer.

    Parameters
    ----------
    key : bytes or None
        Secret key of MAVLink 2 signing, 32 bytes (`swingd.link.signing.read_key`). With a key only frames with a good
        signature and a new timestamp pass. Without signature pass RADIO_STATUS, because radios hold no key, and
        HEARTBEAT, because it tells who is there and commands nothing; MAVLink 1 cannot be signed. Without a key
        signatures are neither checked nor made.
    link_id : int
        Link id of the signatures made here, 0..255.
    system_ids : frozenset of int
        Systems whose frames pass, whatever they say, radios' included; empty: all.
    clock : callable
        Time now [s since 1970-01-01 UTC]; see `swingd.link.signing.Signing`.

    Raises
    ------
    ValueError
        If the key or the link id has another size.
    """

    def __init__(self, key: bytes | None, link_id: int, system_ids: frozenset[int], clock: Callable[[], float]) -> None:
        self._begin(None if key is None else Signing(key, link_id, clock), system_ids, PortCounters())

    def _begin(self, signing: Signing | None, system_ids: frozenset[int], counters: PortCounters) -> None:
        self.counters = counters
        self._signing = signing
        self._system_ids = system_ids
        self._framer = Framer(counters.framing)

    def for_peer(self) -> "Port":
        """Port for another peer of the same endpoint.

        It begins a byte stream of its own and shares all else: what one peer has sent cannot be sent again from
        another address or connection, and the counters count for all.
        """
        port = Port.__new__(Port)
        port._begin(self._signing, self._system_ids, self.counters)
        return port

    def receive(self, data: bytes) -> list[Frame]:
        """Take the next bytes from the peer and return the frames that may pass; never raises."""
        frames = self._framer.receive(data)
        if self._signing is not None or self._system_ids:
            frames = [frame for frame in frames if self._may_pass(frame)]
        self.counters.accepted += len(frames)
        return frames

    def _may_pass(self, frame: Frame) -> bool:
        counters = self.counters
        if self._system_ids and frame.system_id not in self._system_ids:
            counters.system_not_allowed += 1
            return False
        if self._signing is None:
            return True
        if not frame.signed:
            passes = frame.msg_id in UNSIGNED_PASSES
            counters.unsigned += not passes
            return passes
        verdict = self._signing.check(frame.raw)
        counters.wrong_signature += verdict is Verdict.WRONG_SIGNATURE
        counters.old_timestamp += verdict is Verdict.OLD_TIMESTAMP
        return verdict is Verdict.GOOD

    def seal(self, frames: bytes) -> bytes:
        """Sign what leaves for the peer, where there is a key.

        Parameters
        ----------
        frames : bytes
            One whole frame, or several joined.

        Returns
        -------
        bytes
            The frames with a signature each; those that have one already, whoever made it, and MAVLink 1 as they are.
        """
        signing = self._signing
        return frames if signing is None else b"".join(map(signing.sign, cut_frames(frames)))
