"""The simulated autopilot in virtual time against a companion that is only a function."""

from collections import defaultdict
from collections.abc import Callable

from swingd.engine import TICK_S, Delivery, Engine
from swingd.link.codec import Framer, FramingCounters
from swingd.link.router import AUTOPILOT, port_of
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import DT_S

Companion = Callable[[float, bytes], bytes]
"""Gets the time [s] and the bytes that the autopilot sent since the last call, answers with bytes for the autopilot."""


class EngineCompanion:
    """An engine as the companion, with applications behind its endpoints, all in virtual time.

    Parameters
    ----------
    engine : Engine
        Joined by a pipeline or not.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.to_applications: defaultdict[int, list[bytes]] = defaultdict(list)
        """What left through each port besides the autopilot's; whoever is interested takes it from here."""
        self._framers: defaultdict[int, Framer] = defaultdict(Framer)
        self._to_autopilot: list[bytes] = []
        self._tick_s = 0.0

    def __call__(self, t_s: float, data: bytes) -> bytes:
        """Take what the autopilot sent and let time pass; return what goes to it."""
        self.deliver(self.engine.receive(t_s, AUTOPILOT, self._framers[AUTOPILOT].receive(data)))
        if t_s >= self._tick_s:
            self._tick_s += TICK_S
            self.deliver(self.engine.tick(t_s))
        answer, self._to_autopilot = self._to_autopilot, []
        return b"".join(answer)

    def connect(self, t_s: float, endpoint: int = 0, peer: int = 0) -> int:
        """Let an application come to an endpoint; return its port."""
        port = port_of(endpoint, peer)
        self.engine.open_port(t_s, port)
        return port

    def disconnect(self, t_s: float, port: int) -> None:
        """Let an application go."""
        self.engine.close_port(t_s, port)

    def application_sends(self, t_s: float, port: int, data: bytes) -> None:
        """Take what an application sends; what it causes leaves with the next call."""
        self.deliver(self.engine.receive(t_s, port, self._framers[port].receive(data)))

    def framing(self, port: int) -> FramingCounters:
        """Return what has become of the bytes that came through a port."""
        return self._framers[port].counters

    def deliver(self, deliveries: list[Delivery]) -> None:
        """Take what the engine was made to send; what is for the autopilot leaves with the next call."""
        for port, frame in deliveries:
            if port == AUTOPILOT:
                self._to_autopilot.append(frame)
            else:
                self.to_applications[port].append(frame)


class Lockstep:
    """Runs both sides on one clock, 4 ms at a time; deterministic, and as fast as the machine can.

    Parameters
    ----------
    peer : SimulatedAutopilot
        The autopilot's side.
    companion : callable
        The other side.
    on_step : callable, optional
        Called with the time [s] before each step: the place to command, kick, release or record.
    """

    def __init__(
        self, peer: SimulatedAutopilot, companion: Companion, on_step: Callable[[float], None] | None = None
    ) -> None:
        self.peer = peer
        self._companion = companion
        self._on_step = on_step

    def run_until(self, t_s: float) -> None:
        """Run until the peer's clock shows ``t_s`` [s]."""
        peer, companion, on_step = self.peer, self._companion, self._on_step
        while peer.t_s < t_s - 0.5 * DT_S:
            if on_step is not None:
                on_step(peer.t_s)
            frames = peer.advance(peer.t_s + DT_S)
            answer = companion(peer.t_s, b"".join(frames))
            if answer:
                peer.receive(answer)
