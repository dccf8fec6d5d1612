"""A flight in memory: the engine alone, with the simulator, and replayed."""

import math
import time
from dataclasses import dataclass
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

import swingd
from swingd.config.loader import parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.engine import Engine
from swingd.link.codec import Codec, Frame, cut_frames
from swingd.link.port import Port
from swingd.link.router import AUTOPILOT, Router, port_of
from swingd.model.parameters import Mode, Parameters
from swingd.record.event_log import EventLogWriter
from swingd.replay import replay
from swingd.sim.lockstep import EngineCompanion, Lockstep
from swingd.sim.peer import SimulatedAutopilot

from .result import Result, cost, quickest


@dataclass(frozen=True)
class Flight:
    """What an engine received."""

    parameters: Parameters
    received: list[tuple[float, bytes]]
    """Time and bytes."""
    wall_s: float

    def run(self, engine: Engine) -> None:
        engine.join(0.0)
        companion = EngineCompanion(engine)
        for t_s, data in self.received:
            companion(t_s, data)


def fly(duration_s: float) -> Flight:
    """Take off in lockstep, hover, and measure how long that takes."""
    parameters = Parameters(mode=Mode.HOLD)
    peer = SimulatedAutopilot(parameters)
    engine = Engine(parameters)
    engine.join(0.0)
    companion = EngineCompanion(engine)
    pilot = Codec(255, 190)
    received: list[tuple[float, bytes]] = []
    start_s = 2.0

    def on_step(t_s: float) -> None:
        nonlocal start_s
        if t_s >= start_s:
            start_s = math.inf
            for command, first in ((mavlink.MAV_CMD_NAV_TAKEOFF, 0.0), (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)):
                params = (first, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan)
                peer.receive(pilot.encode(mavlink.MAVLink_command_long_message(1, 1, command, 0, *params)))

    def noted(t_s: float, data: bytes) -> bytes:
        received.append((t_s, data))
        return companion(t_s, data)

    begin_s = time.perf_counter()
    Lockstep(peer, noted, on_step).run_until(duration_s)
    return Flight(parameters, received, time.perf_counter() - begin_s)


def bench_engine(flight: Flight) -> list[Result]:
    """The whole engine over a flight, against pymavlink parsing the same bytes and doing nothing with them."""
    splitter = Codec(255, 190)
    imu_frames = sum(
        frame.msg_id == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
        for _, data in flight.received
        for frame in splitter.receive(data)
    )
    frames = splitter.counters.frames

    def own() -> None:
        flight.run(Engine(flight.parameters))

    def theirs() -> None:
        parser = mavlink.MAVLink(None)
        for _, data in flight.received:
            parser.parse_buffer(data)

    own_s, their_s = quickest(own, theirs, rounds=3)
    duration_s = flight.received[-1][0]
    return [
        cost(f"engine: per IMU frame ({frames / imu_frames:.1f} messages)", own_s / imu_frames,
              "pymavlink parsing alone", their_s / imu_frames),
        Result("engine: share of a core in flight", 100.0 * own_s / duration_s, "%", "pymavlink parsing alone",
               100.0 * their_s / duration_s, their_s / own_s),
    ]  # fmt: skip


def bench_lockstep(flight: Flight) -> Result:
    """Simulator and engine together against real time."""
    speed = flight.received[-1][0] / flight.wall_s
    return Result("lockstep: simulated PX4 and engine", speed, "x real time", "real time", 1.0, speed)


def bench_replay(flight: Flight, folder: Path) -> Result:
    """A recording of the flight against real time, its comparison byte for byte included."""
    path = folder / "bench.swingd"
    log = EventLogWriter(path, swingd.__version__, parameters_to_json(flight.parameters))
    flight.run(Engine(flight.parameters, log=log))
    log.close()
    run = replay(path, None, parameters_from_json)
    assert run.frames_differing == 0
    (wall_s,) = quickest(lambda: replay(path, None, parameters_from_json), rounds=2)
    speed = flight.received[-1][0] / wall_s
    return Result("replay: a recording", speed, "x real time", "real time", 1.0, speed)


def bench_frame(flight: Flight) -> list[Result]:
    """What one frame costs on its way to an endpoint, while no filter looks at it."""
    raws = [frame for _, data in flight.received for frame in cut_frames(data)]
    endpoint = port_of(0, 0)

    def port() -> list[list[Frame]]:
        autopilot_side = Port(None, 0, frozenset(), time.time)
        return [autopilot_side.receive(raw) for raw in raws]

    frames = port()

    def route() -> None:
        router = Router()
        router.open(endpoint)
        for frame in frames:
            router.route(AUTOPILOT, frame[0])

    def engine() -> None:
        engine = Engine(flight.parameters)
        engine.open_port(0.0, endpoint)
        # Frames remember what was decoded.
        for t_s, frame in enumerate(port()):
            engine.receive(1e-3 * t_s, AUTOPILOT, frame)

    def theirs() -> None:
        parser = mavlink.MAVLink(None)
        for raw in raws:
            parser.parse_buffer(raw)

    port_s, route_s, engine_s, their_s = (each_s / len(raws) for each_s in quickest(port, route, engine, theirs))
    return [
        cost("frame: Port.receive", port_s, "pymavlink's parser", their_s),
        cost("frame: Router.route", route_s, "pymavlink's parser", their_s),
        cost("frame: Engine.receive, no pipeline", engine_s - port_s, "pymavlink's parser", their_s),
    ]
