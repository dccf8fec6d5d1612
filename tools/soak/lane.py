"""One lane: a flight of many hours in a process of its own."""

import signal
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from time import perf_counter

from swingd.model.parameters import SimulatedKind

from .flight import Flight
from .pilot import Pilot
from .record import Lane
from .watch import Rule

AUTOPILOTS = (SimulatedKind.PX4, SimulatedKind.ARDUPILOT)
PIECE_S = 10.0


def fly(
    seed: int,
    autopilot: SimulatedKind,
    duration_s: float,
    tell: Callable[[object], None],
    estimator: str = "swing_ekf",
) -> Lane:
    """Fly one lane.

    Parameters
    ----------
    seed : int
        The same seed and autopilot give the same flight.
    autopilot : SimulatedKind
        What it looks like.
    duration_s : float
        Simulated time [s].
    tell : callable
        Gets each `Sample`, `Hour` and `Breach`, and in between the simulated time [s], so that the lane itself keeps
        nothing.
    estimator : str
        By name.

    Returns
    -------
    Lane
        Its end: samples and hours are with whoever was told.
    """
    begin_s = perf_counter()
    lane = Lane(seed, autopilot.value, duration_s)
    flight = Flight(seed, autopilot, tell, tell, estimator)
    pilot = Pilot(flight, seed)
    told = 0
    try:
        while flight.t_s < duration_s - 1e-6 and flight.engine.failure is None:
            flight.run_until(min(duration_s, flight.t_s + PIECE_S))
            for breach in flight.watch.breaches[told:]:
                tell(breach)
            told = len(flight.watch.breaches)
            tell(flight.t_s)
    except Exception:
        flight.watch.break_(flight.t_s, Rule.EXCEPTION, traceback.format_exc())
    flight.finish()
    lane.breaches, lane.breached = flight.watch.breaches, dict(flight.watch.breached)
    lane.manoeuvres, lane.faults = dict(pilot.manoeuvres), dict(pilot.faults)
    lane.flown_s, lane.wall_s = flight.t_s, perf_counter() - begin_s
    return lane


def fly_in_process(
    connection: Connection, seed: int, autopilot: SimulatedKind, duration_s: float, estimator: str
) -> None:
    """Fly one lane and tell everything through a connection, the `Lane` last; whoever listens ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection.send(fly(seed, autopilot, duration_s, connection.send, estimator))
    connection.close()
