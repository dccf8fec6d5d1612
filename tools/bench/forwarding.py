"""The daemon between an autopilot and its endpoints, on loopback UDP, beside another router doing the same.

Each round starts a fresh process, lets it forward a hover of the simulated autopilot as that paces it, one frame a
datagram, and then as many frames as it can while the hover goes on. The other router is mavlink-router where
``mavlink-routerd`` is on the path or named by ``$MAVLINK_ROUTERD``, else the plain relay beside this file.

In a hover every frame finds the processor's caches as others have left them: it costs several times what it does at
saturation, or in the cases that run from memory.
"""

import contextlib
import math
import os
import select
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import CHECKSUM_BYTES, Encoder, checksum, cut_frames

from .result import Result, smaller_is_better

HOST = "127.0.0.1"
READY_WITHIN_S = 120.0
"""The first run of a version compiles the filter."""
STARTS = 5
IN_FLIGHT = 64
"""Frames that are on their way at saturation: what the sockets' buffers hold safely."""
STALLED_S = 0.3
OTHER_SYSTEM_ID = 2
_SYSTEM_AT = 5
_SO_TIMESTAMPNS = 35  # of Linux; the socket module does not name it


@dataclass(frozen=True)
class Sent:
    """One frame and when it is due."""

    due_s: float
    frame: bytes


@dataclass(frozen=True)
class Plan:
    """One round: the hover's frames before anything is measured, while it is, and while the router is saturated."""

    settling: Sequence[Sent]
    hovering: Sequence[Sent]
    flooded: Sequence[Sent]
    filler: Sequence[bytes]
    """The same as if from another vehicle, which concerns nobody but the endpoints."""


@dataclass(frozen=True)
class Measured:
    """One router in one round."""

    latencies_us: list[float]
    """From the autopilot's send to the arrival at an endpoint's socket, every frame at every endpoint; in order."""
    cpu_percent: float
    """Of a core, hovering."""
    frames_per_s: float
    """Forwarded at saturation in a second of the processor."""


class Router:
    """A program that forwards, and how to know that it is ready.

    Parameters
    ----------
    name : str
        For people.
    command : callable
        ``command(folder, port, endpoints)``: how it is started, with an empty folder, the autopilot's port and those of
        the endpoints.
    ready : bytes
        What it writes when it is.
    """

    def __init__(self, name: str, command: Callable[[Path, int, Sequence[int]], list[str]], ready: bytes = b"") -> None:
        self.name = name
        self._command = command
        self._ready = ready

    @contextlib.contextmanager
    def run(self, ends: "Ends") -> Iterator[tuple[psutil.Process, float]]:
        """Run it between the ends; give the process, ready, and the time from its start to the first frame [s]."""
        with tempfile.TemporaryDirectory(prefix="swingd-bench-") as name:
            folder = Path(name)
            log = folder / "log"
            command = self._command(folder, ends.router_port, ends.ports)
            # What a ground station of this machine has set stays away, and nothing is left behind.
            environment = {**os.environ, "XDG_STATE_HOME": name, "PYTHONPATH": name}
            ends.forget()
            begin_s = time.monotonic()
            with log.open("wb") as file:
                process = subprocess.Popen(command, stdout=file, stderr=file, env=environment)
            try:
                forwarded_s = math.inf
                while math.isinf(forwarded_s) or self._ready not in log.read_bytes():
                    ends.say_hello()
                    if math.isinf(forwarded_s) and ends.have_heard():
                        forwarded_s = time.monotonic() - begin_s
                    if process.poll() is not None or time.monotonic() > begin_s + READY_WITHIN_S:
                        raise RuntimeError(f"{self.name} does not forward; it said:\n{log.read_text()}")
                yield psutil.Process(process.pid), forwarded_s
            finally:
                process.kill()
                process.wait()


def _swingd(_folder: Path, port: int, endpoints: Sequence[int]) -> list[str]:
    urls = [part for end in endpoints for part in ("--endpoint", f"udpout://{HOST}:{end}")]
    return [sys.executable, "-m", "swingd", "run", "--autopilot", f"udpin://{HOST}:{port}", *urls]


def _swingd_alone(folder: Path, port: int, endpoints: Sequence[int]) -> list[str]:
    # Whatever is wrong with an installation, the daemon forwards.
    (folder / "numba.py").write_text('raise ImportError("left out")\n', encoding="utf-8")
    return _swingd(folder, port, endpoints)


def _relay(_folder: Path, port: int, endpoints: Sequence[int]) -> list[str]:
    return [sys.executable, str(Path(__file__).with_name("relay.py")), str(port), *map(str, endpoints)]


def _mavlink_router(program: str) -> Router:
    def command(folder: Path, port: int, endpoints: Sequence[int]) -> list[str]:
        # Only this file, and not the system's; an empty one is refused.
        settings = folder / "router.conf"
        settings.write_text("[General]\nTcpServerPort = 0\n", encoding="utf-8")
        ends = [part for end in endpoints for part in ("-e", f"{HOST}:{end}")]
        return [program, "-c", str(settings), *ends, f"{HOST}:{port}"]

    return Router("mavlink-router", command)


DAEMON = Router("swingd", _swingd)
JOINED = Router("filter joined", _swingd, b"estimating")
ALONE = Router("filter not joined", _swingd_alone, b"cannot be loaded")
RELAY = Router("plain UDP relay", _relay)


def other_router() -> Router:
    """The peer."""
    program = os.environ.get("MAVLINK_ROUTERD") or shutil.which("mavlink-routerd")
    return RELAY if program is None else _mavlink_router(program)


class Ends:
    """The autopilot's socket and those of the endpoints."""

    def __init__(self, endpoints: int) -> None:
        self._autopilot = _socket()
        self._endpoints = [_socket() for _ in range(endpoints)]
        self._all = [self._autopilot, *self._endpoints]
        with _socket() as probe:
            self.router_port: int = probe.getsockname()[1]
        self.ports: list[int] = [end.getsockname()[1] for end in self._endpoints]
        self._hello = Encoder(1, 1)
        self.forget()

    def __enter__(self) -> "Ends":
        return self

    def __exit__(self, *_: object) -> None:
        for end in self._all:
            end.close()

    def forget(self) -> None:
        """Forget what has arrived."""
        self._arrived: list[list[tuple[int, bytes]]] = [[] for _ in self._endpoints]
        self._counted = [(0, 0)] * len(self._endpoints)

    def say_hello(self) -> None:
        """Say the autopilot's heartbeat, and give the router a moment to pass it on."""
        self._send(self._hello.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3)))
        self._receive(0.002)

    def have_heard(self) -> bool:
        """Whether every endpoint has heard the autopilot."""
        return all(
            any(frame[_SYSTEM_AT : _SYSTEM_AT + 2] == b"\x01\x01" for _, data in arrived for frame in cut_frames(data))
            for arrived in self._arrived
        )

    def play(self, begin_s: float, traffic: Sequence[Sent], filler: Sequence[bytes] = ()) -> dict[bytes, int]:
        """Send each frame when it is due, and between them as much filler as passes.

        Parameters
        ----------
        begin_s : float
            When 0 of the traffic's clock is, on the monotonic clock [s].
        traffic : sequence of Sent
            In order.
        filler : sequence of bytes
            Frames of `OTHER_SYSTEM_ID`, sent again and again.

        Returns
        -------
        dict
            When each frame of the traffic was sent [ns since 1970].
        """
        sent: dict[bytes, int] = {}
        written = lost = most = 0
        moved_s = time.monotonic()
        for one in traffic:
            while (left_s := begin_s + one.due_s - (now_s := time.monotonic())) > 0.0:
                if not filler:
                    self._receive(left_s)
                    continue
                self._receive(0.0)
                passed = self.passed()
                if passed > most:
                    most, moved_s = passed, now_s
                elif now_s - moved_s > STALLED_S:
                    lost, moved_s = written - passed, now_s
                for _ in range(IN_FLIGHT - (written - passed - lost)):
                    self._send(filler[written % len(filler)])
                    written += 1
            sent[one.frame] = time.time_ns()
            self._send(one.frame)
        return sent

    def passed(self) -> int:
        """Frames of the filler that came to every endpoint."""
        for number, arrived in enumerate(self._arrived):
            read, count = self._counted[number]
            count += sum(
                frame[_SYSTEM_AT] == OTHER_SYSTEM_ID for _, data in arrived[read:] for frame in cut_frames(data)
            )
            self._counted[number] = len(arrived), count
        return min(count for _, count in self._counted)

    def latencies_us(self, sent: dict[bytes, int]) -> list[float]:
        """How long frames took to each endpoint's socket [us], in order.

        Raises
        ------
        RuntimeError
            If more than one in a hundred is missing.
        """
        latencies_us = sorted(
            1e-3 * (arrived_ns - sent[frame])
            for arrived in self._arrived
            for arrived_ns, data in arrived
            for frame in cut_frames(data)
            if frame in sent
        )
        expected = len(self._endpoints) * len(sent)
        if len(latencies_us) < 0.99 * expected:
            raise RuntimeError(f"{len(latencies_us)} frames arrived where {expected} were expected")
        return latencies_us

    def _send(self, frame: bytes) -> None:
        # Where nobody waits yet the system says so at the next frame.
        with contextlib.suppress(ConnectionRefusedError):
            self._autopilot.sendto(frame, (HOST, self.router_port))

    def _receive(self, wait_s: float) -> None:
        """Take what has arrived, or else what arrives first within a time."""
        for end in select.select(self._all, (), (), wait_s)[0]:
            with contextlib.suppress(BlockingIOError):
                while True:
                    data, ancillary, _, _ = end.recvmsg(65536, 64)
                    if end is not self._autopilot:
                        # The kernel's time: when this process comes to read it says nothing about the router.
                        seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
                        self._arrived[self._endpoints.index(end)].append((seconds * 10**9 + nanoseconds, data))


def _socket() -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    end.bind((HOST, 0))
    end.setblocking(False)
    return end


def plan(received: Sequence[tuple[float, bytes]], settling_s: float, hovering_s: float, flooded_s: float) -> Plan:
    """Divide the end of a flight, as it was received step by step."""
    end_s = received[-1][0]
    begin_s = end_s - settling_s - hovering_s - flooded_s
    frames = [Sent(t_s - begin_s, frame) for t_s, data in received if t_s > begin_s for frame in cut_frames(data)]

    def between(low_s: float, high_s: float) -> list[Sent]:
        return [one for one in frames if low_s <= one.due_s < high_s]

    hover_s, flood_s = settling_s, settling_s + hovering_s
    filler = [_of_another_system(one.frame) for one in frames]
    return Plan(between(0.0, hover_s), between(hover_s, flood_s), between(flood_s, math.inf), filler)


def _of_another_system(frame: bytes) -> bytes:
    changed = frame[:_SYSTEM_AT] + bytes((OTHER_SYSTEM_ID,)) + frame[_SYSTEM_AT + 1 : -CHECKSUM_BYTES]
    msg_id = int.from_bytes(frame[7:10], "little")
    return changed + checksum(changed, mavlink.mavlink_map[msg_id].crc_extra)


def measure(router: Router, endpoints: int, plan: Plan) -> Measured:
    """Run one round of one router."""
    with Ends(endpoints) as ends, router.run(ends) as (process, _):
        begin_s = time.monotonic()
        ends.play(begin_s, plan.settling)
        cpu_s, t_s = _cpu_s(process), time.monotonic()
        sent = ends.play(begin_s, plan.hovering)
        cpu_percent = 100.0 * (_cpu_s(process) - cpu_s) / (time.monotonic() - t_s)
        frames_per_s = 0.0
        if endpoints:
            cpu_s = _cpu_s(process)
            ends.play(begin_s, plan.flooded, plan.filler)
            frames_per_s = (ends.passed() + len(plan.flooded)) / (_cpu_s(process) - cpu_s)
        return Measured(ends.latencies_us(sent), cpu_percent, frames_per_s)


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def bench_forwarding(plan: Plan, endpoint_counts: Sequence[int], rounds: int) -> list[Result]:
    """Latency and processor time in a hover, frames per second at saturation."""
    results: list[Result] = []
    other = other_router()
    for endpoints in endpoint_counts:
        # Without endpoints there is nothing to forward, and nothing but the flight to measure.
        routers = [JOINED, ALONE, other] if endpoints else [JOINED, other]
        measured: dict[Router, list[Measured]] = {router: [] for router in routers}
        for _ in range(rounds):
            for router in routers:
                measured[router].append(measure(router, endpoints, plan))
        theirs = measured.pop(other)
        for router, own in measured.items():
            name = f"forward to {endpoints}, {router.name}"
            if not endpoints:
                name = "forward to none"
            results += _results(name, own, other.name, theirs)
    return results


def _results(name: str, own: Sequence[Measured], other: str, theirs: Sequence[Measured]) -> list[Result]:
    def row(what: str, unit: str, figure: Callable[[Measured], float]) -> Result:
        values = (min(figure(one) for one in rounds) for rounds in (own, theirs))
        return smaller_is_better(f"{name}: {what}", next(values), unit, other, next(values))

    results = [row("share of a core", "%", lambda one: one.cpu_percent)]
    if own[0].latencies_us:
        results.append(row("latency p50", "us", lambda one: one.latencies_us[len(one.latencies_us) // 2]))
        results.append(row("latency p99", "us", lambda one: one.latencies_us[len(one.latencies_us) * 99 // 100]))
        per_s, their_per_s = (max(one.frames_per_s for one in rounds) for rounds in (own, theirs))
        results.append(Result(f"{name}: saturated", per_s, "frames/s", other, their_per_s, per_s / their_per_s))
    return results


def bench_start() -> Result:
    """From the start of the process to the first frame that it forwarded, against an interpreter that does nothing."""
    own_s = their_s = math.inf
    with Ends(1) as ends:
        for _ in range(STARTS):
            with DAEMON.run(ends) as (_, forwarded_s):
                own_s = min(own_s, forwarded_s)
            begin_s = time.monotonic()
            subprocess.run([sys.executable, "-c", "pass"], check=True)
            their_s = min(their_s, time.monotonic() - begin_s)
    return smaller_is_better("start: to the first forwarded frame", own_s, "s", "bare interpreter", their_s)
