"""The simulated autopilot on a real link, in real time or faster."""

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TextIO

from swingd.link.transport import Transport, open_transport
from swingd.model.parameters import Parameters
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import DT_S
from swingd.sim.truth import TruthWriter

TRUTH_STEPS = 2
"""Simulation steps from one row of the truth file to the next: 125 Hz."""

_CATCH_UP_MAX_S = 0.2
_TRUTH_FILE_BUFFER = 1 << 16


async def run_simulation(
    parameters: Parameters,
    *,
    peer: SimulatedAutopilot | None = None,
    autopilot_parameters: Mapping[str, float] | None = None,
    truth_file: Path | None = None,
    duration_s: float | None = None,
    on_step: Callable[[SimulatedAutopilot], None] | None = None,
) -> SimulatedAutopilot:
    """Run a simulated autopilot on its link until cancelled or until ``duration_s`` of simulated time have passed.

    Parameters
    ----------
    parameters : Parameters
        ``simulation.mavlink`` is the link, ``simulation.mavlink_bind_port`` the local port of a ``udpout`` link,
        ``simulation.speed`` the simulated over the real time.
    peer : SimulatedAutopilot, optional
        One that exists already, to look into it while it runs; else a new one.
    autopilot_parameters : mapping, optional
        The autopilot's own parameters other than the defaults, for a new peer.
    truth_file : Path, optional
        CSV with the truth at 125 Hz, columns as in `swingd.sim.truth.COLUMNS`.
    duration_s : float, optional
        Simulated time to run [s].
    on_step : callable, optional
        Called in the loop before each 4 ms of simulated time.

    Returns
    -------
    SimulatedAutopilot
        The peer, after ``duration_s``.

    Raises
    ------
    LinkUrlError, LinkOpenError
        If the link is not understood or cannot be opened.
    ConfigurationError
        If the vehicle cannot be simulated.
    OSError
        If the truth file cannot be written.

    Notes
    -----
    The pace does not drift: each step is due at its own time from the start. After a stall (a suspended machine, a
    busy core) at most 0.2 s of real time is caught up, so that no burst of stale frames goes out; the rest is skipped.
    """
    if peer is None:
        peer = SimulatedAutopilot(parameters, autopilot_parameters)
    simulation = parameters.simulation
    links: list[Transport] = []

    def receiver(own: int) -> Callable[[int, bytes], None]:
        """What one link says is heard by the autopilot and by the other link, as PX4 forwards it."""

        def received(_peer: int, data: bytes) -> None:
            peer.receive(data)
            for number, link in enumerate(links):
                if number != own:
                    link.send(data)

        return received

    links.append(
        await open_transport(
            simulation.mavlink, receiver(0), local_port=simulation.mavlink_bind_port or None, queue_bytes=1 << 16
        )
    )

    def send(frame: bytes) -> None:
        for link in links:
            link.send(frame)

    file: TextIO | None = None
    try:
        if simulation.ground_station != "none":
            links.append(await open_transport(simulation.ground_station, receiver(1), queue_bytes=1 << 16))
        writer = None
        if truth_file is not None:
            file = truth_file.open("w", encoding="utf-8", newline="\n", buffering=_TRUTH_FILE_BUFFER)
            writer = TruthWriter(file)
        await _pace(peer, simulation.speed, send, duration_s, on_step, writer)
    finally:
        if file is not None:
            file.close()
        for link in links:
            await link.close()
    return peer


async def _pace(
    peer: SimulatedAutopilot,
    speed: float,
    send: Callable[[bytes], None],
    duration_s: float | None,
    on_step: Callable[[SimulatedAutopilot], None] | None,
    writer: TruthWriter | None,
) -> None:
    """Step the peer when its time comes and send its frames, one datagram each as PX4 does."""
    loop = asyncio.get_running_loop()
    end_s = None if duration_s is None else peer.t_s + duration_s
    steps = 0
    due_s = loop.time()
    while end_s is None or peer.t_s < end_s - 0.5 * DT_S:
        now_s = loop.time()
        if now_s < due_s:
            await asyncio.sleep(due_s - now_s)
            continue
        if now_s - due_s > _CATCH_UP_MAX_S:
            due_s = now_s - _CATCH_UP_MAX_S
        if on_step is not None:
            on_step(peer)
        for frame in peer.advance(peer.t_s + DT_S):
            send(frame)
        if writer is not None and steps % TRUTH_STEPS == 0:
            writer.write(peer.truth())
        steps += 1
        due_s += DT_S / speed
        if steps % 8 == 0:
            # Whoever shares the loop gets a turn even while this one is behind.
            await asyncio.sleep(0)
