"""The simulated autopilot on a real link, in real time or faster."""

from collections.abc import Callable, Iterable, Mapping

from swingd.link.transport import Transport, open_transport
from swingd.model.parameters import Parameters
from swingd.sim.faults import Fault
from swingd.sim.outlets import Outlets, Outside, open_outlets
from swingd.sim.pace import Pace
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import DT_S


async def run_simulation(
    parameters: Parameters,
    *,
    peer: SimulatedAutopilot | None = None,
    autopilot_parameters: Mapping[str, float] | None = None,
    outside: Outside | None = None,
    faults: Iterable[Fault] = (),
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
    outside : Outside, optional
        What of the simulation is open to the world besides its links; by default nothing.
    faults : iterable of Fault
        What goes wrong, by the peer's time.
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
        If a link is not understood or cannot be opened.
    ConfigurationError
        If the vehicle cannot be simulated.
    SwingdError
        If the truth file cannot be written.
    """
    if peer is None:
        peer = SimulatedAutopilot(parameters, autopilot_parameters)
    peer.faults.inject(*faults)
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

    try:
        if simulation.ground_station != "none":
            links.append(await open_transport(simulation.ground_station, receiver(1), queue_bytes=1 << 16))
        async with open_outlets(peer.plant, outside or Outside(), peer.faults) as outlets:
            await _fly(peer, Pace(simulation.speed), send, outlets, duration_s, on_step)
    finally:
        for link in links:
            await link.close()
    return peer


async def _fly(
    peer: SimulatedAutopilot,
    pace: Pace,
    send: Callable[[bytes], None],
    outlets: Outlets,
    duration_s: float | None,
    on_step: Callable[[SimulatedAutopilot], None] | None,
) -> None:
    """Step the peer when its time comes and send its frames, one datagram each as PX4 does."""
    end_s = None if duration_s is None else peer.t_s + duration_s
    while end_s is None or peer.t_s < end_s - 0.5 * DT_S:
        await pace.due()
        if on_step is not None:
            on_step(peer)
        for frame in peer.advance(peer.t_s + DT_S):
            send(frame)
        outlets.after_step(peer.truth)
