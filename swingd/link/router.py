"""Which port a frame leaves through: MAVLink's routing rules, without I/O and without a clock."""

from collections import Counter, deque
from enum import Enum
from zlib import crc32

from swingd.link.codec import Frame

AUTOPILOT = 0
"""The port of the autopilot's side; every other port is a peer behind an endpoint."""
_SOURCES_MAX = 256
"""Components that one port may show; beyond it nothing more is learnt, so that no flood fills the memory."""
_ROUTES_MAX = 4096
_REMEMBERED = 128
"""Less than the 256 frames after which a component that says the same again and again repeats itself to the byte."""
_PEER_BITS = 24
_PEER_MASK = (1 << _PEER_BITS) - 1


def port_of(endpoint: int, peer: int) -> int:
    """Return the port of a peer behind an endpoint; both count, endpoints from 0."""
    return (endpoint + 1) << _PEER_BITS | (peer & _PEER_MASK)


def endpoint_of(port: int) -> int:
    """Return the number of the endpoint, from 0, that a port other than `AUTOPILOT` belongs to."""
    return (port >> _PEER_BITS) - 1


def peer_of(port: int) -> int:
    """Return the number of the peer at a port."""
    return port & _PEER_MASK


class Refusal(Enum):
    """Why a frame was not forwarded."""

    LOOP = "loop"
    """The same frame again, from a component that is heard through several ports."""
    NO_ROUTE = "no_route"
    """Addressed to a component that was never heard."""


class Router:
    """Learns where components are and tells where a frame goes.

    A frame without a target, or for system 0, goes to every port but those on which its sender is heard. Any other goes
    to the ports on which its target was heard: the system and, unless 0, the component. Nothing returns to the port
    that it came from. Who is heard through several ports, such as a ground station with two links, may close a loop:
    of its frames the same bytes pass once.
    """

    def __init__(self) -> None:
        self.refusals: Counter[Refusal] = Counter()
        """What was not forwarded, by reason."""
        self._sources: dict[int, set[int]] = {AUTOPILOT: set()}
        self._several: set[int] = set()
        self._routes: dict[tuple[int, int, int], tuple[int, ...]] = {}
        self._recent: deque[int] = deque(maxlen=_REMEMBERED)

    @property
    def ports(self) -> tuple[int, ...]:
        """Every open port, the autopilot's first."""
        return tuple(self._sources)

    def sources(self, port: int) -> int:
        """How many components were heard through a port."""
        return len(self._sources.get(port, ()))

    def open(self, port: int) -> None:
        """A peer is there; it gets what is broadcast even before it has said anything."""
        self._sources.setdefault(port, set())
        self._routes.clear()

    def close(self, port: int) -> None:
        """A peer is gone, and with it everything that was heard through it."""
        self._sources.pop(port, None)
        self._routes.clear()
        self._several = {source for source in self._several if self._places(source) > 1}

    def learn(self, port: int, frame: Frame) -> None:
        """Learn where the sender of a frame is, one that goes nowhere included."""
        source = frame.system_id << 8 | frame.component_id
        sources = self._sources.get(port)
        if sources is not None and source not in sources and len(sources) < _SOURCES_MAX:
            sources.add(source)
            self._routes.clear()
            if self._places(source) > 1:
                self._several.add(source)

    def route(self, port: int, frame: Frame) -> tuple[int, ...]:
        """Learn the sender of a frame that came through ``port``; return the ports that it goes to."""
        sources = self._sources.get(port)
        if sources is None:
            return ()
        source = frame.system_id << 8 | frame.component_id
        if source not in sources:
            self.learn(port, frame)
        if source in self._several and self._is_repeated(frame):
            self.refusals[Refusal.LOOP] += 1
            return ()
        system = frame.target_system
        if system == 0:
            key = (port, source, -1)
        else:
            key = (port, system, frame.target_component)
        ports = self._routes.get(key)
        if ports is None:
            if len(self._routes) >= _ROUTES_MAX:
                self._routes.clear()
            ports = self._routes[key] = self._find(key)
        if not ports and system:
            self.refusals[Refusal.NO_ROUTE] += 1
        return ports

    def _find(self, key: tuple[int, int, int]) -> tuple[int, ...]:
        port, who, component = key
        others = [(other, sources) for other, sources in self._sources.items() if other != port]
        if component < 0:
            return tuple(other for other, sources in others if who not in sources)
        if component == 0:
            return tuple(other for other, sources in others if any(source >> 8 == who for source in sources))
        return tuple(other for other, sources in others if who << 8 | component in sources)

    def _places(self, source: int) -> int:
        return sum(source in sources for sources in self._sources.values())

    def _is_repeated(self, frame: Frame) -> bool:
        mark = crc32(frame.raw)
        if mark in self._recent:
            return True
        self._recent.append(mark)
        return False
