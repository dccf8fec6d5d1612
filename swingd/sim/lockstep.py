"""The simulated autopilot in virtual time against a companion that is only a function."""

from collections.abc import Callable

from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import DT_S

Companion = Callable[[float, bytes], bytes]
"""Gets the time [s] and the bytes that the autopilot sent since the last call, answers with bytes for the autopilot."""


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
