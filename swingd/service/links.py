"""The daemon's links: one transport each, with a port for every peer."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from swingd.link.codec import Frame, cut_frames
from swingd.link.port import Port, PortCounters
from swingd.link.router import AUTOPILOT, port_of
from swingd.link.signing import key_is_exposed, read_key
from swingd.link.transport import Transport, TransportCounters, TransportState, open_transport
from swingd.link.url import LOOPBACK, LinkUrl, parse_url
from swingd.model.parameters import Endpoint, Parameters

PEERS_MAX = 16
"""Applications and ground stations that one waiting endpoint serves at a time."""
DATAGRAM_MAX_BYTES = 1400
"""What belongs together leaves together, within what networks and PX4's receiver take in one datagram."""


OnFrames = Callable[[int, list[Frame]], None]
OnPort = Callable[[int, bool], None]
OnState = Callable[[str, TransportState, str], None]


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """One link as configured; its key has been read."""

    name: str
    url: LinkUrl
    key: bytes | None
    exposed_key: Path | None
    """The key's file, where others than its owner may read it."""
    system_ids: frozenset[int]
    endpoint: int | None
    """Number of the endpoint, from 0; None for the autopilot's side."""


def settings_of(parameters: Parameters) -> list[LinkSettings]:
    """Return every link of a configuration, the autopilot's first.

    Raises
    ------
    LinkUrlError
        If a URL is not understood.
    ConfigurationError
        If a key cannot be read.
    """

    def settings(name: str, url: LinkUrl, key_file: str, ids: Sequence[int], endpoint: int | None) -> LinkSettings:
        path = None if key_file == "none" else Path(key_file)
        key = None if path is None else read_key(path)
        exposed = path if path is not None and key_is_exposed(path) else None
        return LinkSettings(name, url, key, exposed, frozenset(ids), endpoint)

    def endpoint_settings(number: int, endpoint: Endpoint) -> LinkSettings:
        url = parse_url(endpoint.url, default_host=LOOPBACK)
        return settings(f"endpoint {number + 1}", url, endpoint.key_file, endpoint.system_ids, number)

    link = parameters.link
    return [
        settings("autopilot", parse_url(link.autopilot), link.key_file, (), None),
        *(endpoint_settings(number, endpoint) for number, endpoint in enumerate(parameters.endpoints)),
    ]


class Link:
    """A transport and the ports of its peers.

    Parameters
    ----------
    settings : LinkSettings
        Where to, and who may speak.
    on_frames : callable
        ``on_frames(port, frames)`` gets what may pass.
    on_port : callable
        ``on_port(port, present)``: a peer behind an endpoint came or went.
    on_state : callable
        ``on_state(name, state, reason)``: the link opened, broke, or waits.
    """

    def __init__(self, settings: LinkSettings, on_frames: OnFrames, on_port: OnPort, on_state: OnState) -> None:
        self.settings = settings
        self._on_frames = on_frames
        self._on_port = on_port
        self._on_state = on_state
        number = 0 if settings.endpoint is None else settings.endpoint + 1
        self._template = Port(settings.key, number, settings.system_ids, time.time)
        self._ports: dict[int, Port] = {}
        self._transport: Transport | None = None

    async def open(self) -> None:
        """Open the transport.

        Raises
        ------
        LinkOpenError
            If the link cannot work as asked for.
        """
        settings = self.settings
        self._transport = await open_transport(
            settings.url,
            self._received,
            on_peer=self._peer,
            on_state=lambda state, reason: self._on_state(settings.name, state, reason),
            peers_max=1 if settings.endpoint is None else PEERS_MAX,
        )

    async def close(self) -> None:
        """Close the transport."""
        if self._transport is not None:
            await self._transport.close()

    @property
    def counters(self) -> PortCounters:
        """What its ports have seen."""
        return self._template.counters

    @property
    def traffic(self) -> tuple[int, int]:
        """Bytes sent and received."""
        return self.transport_counters.bytes_out, self.transport_counters.bytes_in

    @property
    def state(self) -> TransportState:
        """Where its transport stands; one that could not be opened yet waits."""
        return TransportState.WAITING if self._transport is None else self._transport.state

    @property
    def transport_counters(self) -> TransportCounters:
        """What its transport has seen."""
        return TransportCounters() if self._transport is None else self._transport.counters

    @property
    def backlog_bytes(self) -> int:
        """What waits for the one peer of the autopilot's side."""
        return 0 if self._transport is None else self._transport.backlog_bytes()

    def _number(self, peer: int) -> int:
        endpoint = self.settings.endpoint
        return AUTOPILOT if endpoint is None else port_of(endpoint, peer)

    def _peer(self, peer: int, present: bool) -> None:
        if present:
            self._ports[peer] = self._template.for_peer()
        else:
            self._ports.pop(peer, None)
        if self.settings.endpoint is not None:
            self._on_port(self._number(peer), present)

    def _received(self, peer: int, data: bytes) -> None:
        port = self._ports.get(peer)
        if port is None:
            port = self._ports[peer] = self._template.for_peer()
        frames = port.receive(data)
        if frames:
            self._on_frames(self._number(peer), frames)

    def send(self, peer: int, frames: Sequence[bytes]) -> None:
        """Send frames to a peer, as few datagrams as possible."""
        transport = self._transport
        if transport is None:
            return
        # One datagram for what belongs together: a system call costs more than a frame.
        sealed = self._template.seal(b"".join(frames))
        if len(sealed) <= DATAGRAM_MAX_BYTES:
            transport.send(sealed, peer)
            return
        block: list[bytes] = []
        size = 0
        for frame in cut_frames(sealed):
            if block and size + len(frame) > DATAGRAM_MAX_BYTES:
                transport.send(b"".join(block), peer)
                block, size = [], 0
            block.append(frame)
            size += len(frame)
        transport.send(b"".join(block), peer)
