"""A ``swingd run`` process in flight, in real time, between the simulated autopilot and an application."""

import asyncio
import contextlib
import json
import os
import resource
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from ports import udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Encoder
from swingd.model.parameters import Parameters
from swingd.service.status import StatusError, ask, sockets
from swingd.sim.autopilot import NavState
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

Daemon = subprocess.Popen[bytes]
SETPOINT_S = 0.05
NAN = float("nan")


class Application:
    """Sends one velocity at 20 Hz to whoever speaks to it."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self.heard: list[bytes] = []
        self._encoder = Encoder(245, 190)
        self._peer: tuple[str, int] | None = None

    def send(self, message: Any) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                data, self._peer = self.socket.recvfrom(65536)
                self.heard.append(data)
        if self._peer is not None:
            self.socket.sendto(self._encoder.encode(message), self._peer)

    async def hover(self) -> None:
        velocity = mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 0b1101_1100_0111, 0, 0, 0, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0
        )
        while True:
            self.send(velocity)
            await asyncio.sleep(SETPOINT_S)


class LiveFlight:
    """One vehicle, one application that hovers, and the daemons started between them.

    Parameters
    ----------
    speed : float
        Simulated over real time.
    folder : Path, optional
        Where every daemon records its flight, see `record`.
    """

    def __init__(self, speed: float = 1.0, folder: Path | None = None) -> None:
        self.autopilot_port = udp_port()
        self.application = Application()
        base = Parameters()
        parameters = replace(
            base,
            simulation=replace(
                base.simulation,
                mavlink=f"udpout://127.0.0.1:{self.autopilot_port}",
                mavlink_bind_port=0,
                takeoff_altitude_m=4.0,
                speed=speed,
            ),
        )
        self.peer = SimulatedAutopilot(parameters)
        self.arrivals: list[float] = []
        """Times of setpoints at the autopilot [s], the host's monotonic clock; of several in one step, one."""
        self.modes: set[NavState] = set()
        self.corrected: list[tuple[float, bool]] = []
        """Of every step: when, and whether what the autopilot follows has a correction in it."""
        self.is_corrected = False
        self.folders: tuple[Path, ...] = ()
        """Where the daemon's status socket is looked for, besides the usual places."""
        self.daemon: Daemon | None = None
        self.record: Path | None = None
        """What the present daemon records to."""
        self._folder = folder
        self._starts = 0
        self._log: list[bytes] = []
        self._parameters = parameters
        self._setpoints = 0
        self._loop = asyncio.new_event_loop()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._fly, daemon=True)
        self._thread.start()

    def _fly(self) -> None:
        async def fly() -> None:
            tasks = [
                asyncio.create_task(run_simulation(self._parameters, peer=self.peer, on_step=self._watch)),
                asyncio.create_task(self.application.hover()),
            ]
            while not self._ended.is_set() and not any(task.done() for task in tasks):
                await asyncio.sleep(0.02)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        self._loop.run_until_complete(fly())
        self._loop.close()

    def _watch(self, peer: SimulatedAutopilot) -> None:
        now_s = time.monotonic()
        if peer.companion.setpoints > self._setpoints:
            self._setpoints = peer.companion.setpoints
            self.arrivals.append(now_s)
        self.modes.add(peer.autopilot.nav_state)
        # The application asks for no acceleration at all.
        acc = getattr(peer.autopilot.setpoint, "acc_ned_mps2", (None, None, None))
        self.is_corrected = acc[0] is not None and peer.autopilot.nav_state is NavState.OFFBOARD
        self.corrected.append((now_s, self.is_corrected))

    # ---- the daemon

    def arguments(self, *options: str, endpoints: Sequence[str] = ()) -> list[str]:
        urls = [f"udpout://127.0.0.1:{self.application.port}", *endpoints]
        return [
            *(sys.executable, "-m", "swingd", "run", "--autopilot", f"udpin://127.0.0.1:{self.autopilot_port}"),
            *(option for url in urls for option in ("--endpoint", url)),
            *options,
        ]

    def start(
        self,
        *options: str,
        endpoints: Sequence[str] = (),
        environment: dict[str, str] | None = None,
        file_bytes_max: int | None = None,
        command: Sequence[str] | None = None,
    ) -> Daemon:
        """Start ``swingd run``, or another command that becomes it, without a terminal as a service has none."""

        def limit() -> None:
            assert file_bytes_max is not None
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes_max, file_bytes_max))

        self._starts += 1
        self.record = None
        if self._folder is not None and "--record" not in options:
            self.record = self._folder / f"{self._starts}.swingd"
            options = (*options, "--record", str(self.record))
        read, write = os.pipe()
        self._pump(read)
        self.daemon = subprocess.Popen(
            command or self.arguments(*options, endpoints=endpoints),
            stderr=write,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            env=os.environ | (environment or {}),
            # Between fork and exec of a process with threads as little as can be.
            preexec_fn=None if file_bytes_max is None else limit,
        )
        os.close(write)
        return self.daemon

    def _pump(self, read: int) -> None:
        """Keep the log outside of the process, whose files may be limited."""
        kept: list[bytes] = []
        self._log = kept

        def pump() -> None:
            with open(read, "rb") as pipe:
                # One by one: it is read meanwhile.
                while line := pipe.readline():
                    kept.append(line)

        threading.Thread(target=pump, daemon=True).start()

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The log of the present daemon, so far."""
        return [json.loads(line) for line in list(self._log) if line.startswith(b"{") and line.endswith(b"}\n")]

    def status(self) -> dict[str, Any]:
        """What the daemon says of itself."""
        assert self.daemon is not None
        (its_own,) = (found for found in sockets(*self.folders) if found.pid == self.daemon.pid)
        return ask(its_own.path)

    def until(self, condition: Callable[[], object], at_most_s: float = 30.0) -> None:
        end_s = time.monotonic() + at_most_s
        while not condition():
            last = [line["event"] for line in self.lines][-10:]
            assert time.monotonic() < end_s, last
            assert self._thread.is_alive(), "the simulation has ended"
            assert self.daemon is None or self.daemon.poll() is None or last[-1:] == ["stopped"], self._log
            time.sleep(0.01)

    # ---- the pilot

    def command(self, number: int, *params: float) -> None:
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        message = mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)
        self._loop.call_soon_threadsafe(self.application.send, message)

    def fly(self) -> None:
        """Take off, and wait until the correction acts in OFFBOARD."""
        self.until(lambda: self.peer.companion.setpoints > 3)
        self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, NAN)
        self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self.until(lambda: self.peer.truth().pos_ned_m[2] < -3.5)
        self.enter_offboard()
        self.until_correcting()

    def enter_offboard(self) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
        self.until(lambda: self.peer.autopilot.nav_state is NavState.OFFBOARD)

    def until_correcting(self, at_most_s: float = 30.0) -> None:
        """Wait until the present daemon says so and the autopilot follows what it sends."""

        def correcting() -> bool:
            try:
                return bool(self.status()["correction"]["on"]) and self.is_corrected
            except (ValueError, StatusError):
                return False  # it is just starting

        self.until(correcting, at_most_s)

    def forget(self) -> None:
        """Drop what was seen so far."""
        self.arrivals.clear()
        self.modes.clear()
        self.corrected.clear()
        self.application.heard.clear()

    def longest_gap_s(self, since_s: float, until_s: float) -> float:
        """Without a setpoint at the autopilot, between two instants of the host's monotonic clock [s]."""
        times = [since_s, *(t_s for t_s in self.arrivals if since_s < t_s < until_s), until_s]
        return max(b - a for a, b in pairwise(times))

    def close(self) -> None:
        self._ended.set()
        self._thread.join(10.0)
        if self.daemon is not None and self.daemon.poll() is None:
            self.daemon.kill()
            self.daemon.wait()
        self.application.socket.close()


@contextlib.contextmanager
def live_flight(speed: float = 1.0, folder: Path | None = None) -> Iterator[LiveFlight]:
    """Fly; at the end everything is stopped."""
    flight = LiveFlight(speed, folder)
    try:
        yield flight
    finally:
        flight.close()
