"""Speed of the parts, each as a ratio to a peer of the same run, so that the figures mean something on any machine.

Every case is timed in alternation with its peer and the quickest of the rounds counts. ``--json`` prints one object.
"""

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common as mavlink
from rich.console import Console
from rich.table import Table
from scipy.linalg import solve_continuous_are

import swingd
from swingd.config.loader import parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.core import swing_ekf as kernels
from swingd.core.status import Status
from swingd.engine import Engine
from swingd.link.codec import Codec
from swingd.model.parameters import Mode, Parameters
from swingd.record.event_log import EventLogWriter
from swingd.replay import replay
from swingd.sim.lockstep import EngineCompanion, Lockstep
from swingd.sim.peer import SimulatedAutopilot

FloatArray = npt.NDArray[np.float64]
ROUNDS = 5
FLIGHT_S = 30.0


@dataclass(frozen=True)
class Result:
    """One part against its peer."""

    name: str
    value: float
    unit: str
    peer: str
    peer_value: float
    ratio: float
    """How many times better than the peer; below 1 it is worse."""


def quickest(*functions: Callable[[], object], rounds: int = ROUNDS) -> list[float]:
    """Shortest time of each function [s], run in alternation so that a busy machine troubles all alike."""
    best = [math.inf] * len(functions)
    for _ in range(rounds):
        for i, function in enumerate(functions):
            begin_s = time.perf_counter()
            function()
            best[i] = min(best[i], time.perf_counter() - begin_s)
    return best


# ---- parts

# The model's formulas as the interpreter runs them: numba keeps them behind a kernel, unless it is switched off.
_dynamics: Callable[..., None] = getattr(kernels.dynamics, "py_func", kernels.dynamics)
_observation: Callable[..., float] = getattr(kernels.observation, "py_func", kernels.observation)


def bench_codec(count: int) -> Result:
    """Parse a stream of HIGHRES_IMU as it arrives, a frame at a time."""
    sender = Codec(1, 1)
    fields = (0.1, -0.2, -9.8, 0.01, 0.02, -0.03, 0.2, 0.0, 0.4, 950.0, 0.0, 488.0, 15.0, 63)
    frames = [sender.encode(mavlink.MAVLink_highres_imu_message(4000 * k, *fields)) for k in range(count)]

    def own() -> float:
        codec = Codec(255, 190)
        return sum((float(frame.message.zacc) for raw in frames for frame in codec.receive(raw)), 0.0)

    def theirs() -> float:
        parser = mavlink.MAVLink(None)
        return sum((float(message.zacc) for raw in frames for message in parser.parse_buffer(raw) or ()), 0.0)

    assert own() == theirs()
    own_s, their_s = quickest(own, theirs)
    return _cost("codec: parse HIGHRES_IMU", own_s / count, "pymavlink's parser", their_s / count)


class NumpyStep:
    """The filter's step written with NumPy and SciPy: the same model, Newton by `solve`, Riccati by SciPy."""

    def __init__(self, Q: FloatArray, R: FloatArray, mass_kg: float, payload_mass_kg: float, length_m: float) -> None:
        self._Q, self._R_inv = np.diag(Q), np.diag(1.0 / R)
        self._mass_kg, self._payload_mass_kg, self._length_m = mass_kg, payload_mass_kg, length_m

    def _model(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        f, F, h, H = np.empty(7), np.empty((7, 7)), np.empty(3), np.empty((3, 7))
        _dynamics(f, F, x, u, self._mass_kg, self._length_m)
        _observation(h, H, x, u, self._mass_kg, self._payload_mass_kg, self._length_m)
        return f, F, h, H

    def __call__(
        self, x: FloatArray, P: FloatArray, u: FloatArray, z: FloatArray, dt_s: float
    ) -> tuple[FloatArray, FloatArray]:
        _, F, _, H = self._model(x, u)
        A = F - np.eye(7) / (2.0 * dt_s)
        P_new = solve_continuous_are(A.T, H.T, self._Q + P / dt_s, np.linalg.inv(self._R_inv))
        K = P_new @ H.T @ self._R_inv
        new = x.copy()
        for _ in range(kernels.NEWTON_MAX):
            f, F, h, H = self._model(new, u)
            residual = new - x - dt_s * (f + K @ (z - h))
            step = np.linalg.solve(np.eye(7) - dt_s * (F - K @ H), residual)
            new -= step
            if np.abs(step).max() < kernels.NEWTON_TOLERANCE:
                break
        return new, P_new


def bench_filter(count: int) -> Result:
    """One step of the swing EKF."""
    mass_kg, payload_mass_kg, length_m, dt_s = 2.0, 0.3, 1.5, 0.0025
    Q = np.array([1e-8, 1e-8, 4e-4, 4e-4, 0.25, 0.25, 0.25])
    R = np.array([3.6e-3, 3.6e-3, 0.04])
    x = np.array([0.2, -0.1, 0.5, 0.3, 0.4, -0.2, 0.1])
    P = np.diag([0.01, 0.01, 0.05, 0.05, 0.5, 0.5, 0.5])
    u = np.array([0.5, -0.3, -22.4])
    z = np.array([0.3, -0.2, 0.1])
    x_out, P_out, nis = np.empty(7), np.empty((7, 7)), np.empty(1)
    peer = NumpyStep(Q, R, mass_kg, payload_mass_kg, length_m)

    def own() -> None:
        for _ in range(count):
            status = kernels.step(
                x_out, P_out, nis, x, P, u, z, Q, R, dt_s, dt_s, mass_kg, payload_mass_kg, length_m, 1e9, 0
            )
            assert status == Status.OK

    peers = max(count // 50, 1)

    def theirs() -> None:
        for _ in range(peers):
            peer(x, P, u, z, dt_s)

    own()
    x_peer, P_peer = peer(x, P, u, z, dt_s)
    # The ratio only means something where both compute the same.
    assert np.allclose(x_out, x_peer, rtol=1e-8, atol=1e-10)
    assert np.allclose(P_out, P_peer, rtol=1e-6, atol=1e-10)
    own_s, their_s = quickest(own, theirs)
    return _cost("filter: one step", own_s / count, "NumPy and SciPy", their_s / peers)


# ---- the whole


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
        _cost(f"engine: per IMU frame ({frames / imu_frames:.1f} messages)", own_s / imu_frames,
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


def _cost(name: str, own_s: float, peer: str, peer_s: float) -> Result:
    return Result(name, 1e6 * own_s, "us", peer, 1e6 * peer_s, peer_s / own_s)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every case and print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--quick", action="store_true", help="shorter runs, rougher figures")
    options = parser.parse_args(arguments)
    count, flight_s = (500, 6.0) if options.quick else (4000, FLIGHT_S)
    results = [bench_codec(count), bench_filter(count)]
    flight = fly(flight_s)
    results += [*bench_engine(flight), bench_lockstep(flight)]
    with tempfile.TemporaryDirectory() as folder:
        results.append(bench_replay(flight, Path(folder)))
    if options.json:
        print(json.dumps({"swingd": swingd.__version__, "results": [asdict(result) for result in results]}))
        return 0
    table = Table("part", "here", "peer of the same run", "there", "times better")
    for result in results:
        table.add_row(
            result.name,
            f"{result.value:.3g} {result.unit}",
            result.peer,
            f"{result.peer_value:.3g} {result.unit}",
            f"{result.ratio:.2f}",
        )
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
