"""Forwarding before everything else: what is loaded by then, and a daemon that is killed in flight."""

import asyncio
import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from ports import udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Encoder, Framer
from swingd.model.parameters import Parameters
from swingd.sim.autopilot import NavState
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

pytestmark = pytest.mark.live

HEAVY = ("numpy", "numba", "pydantic", "rich", "typer", "structlog", "yaml", "scipy")
LOADING = """
import sys, time
heavy = {heavy!r}
seen = open({seen!r}, "w", buffering=1)
def watch(event, arguments):
    if event == "import" and arguments[0].split(".")[0] in heavy:
        seen.write(f"{{time.monotonic()}} {{arguments[0]}}\\n")
sys.addaudithook(watch)
sys.argv[0] = "swingd"
from swingd.cli.start import main
main()
"""


class Ends:
    """An autopilot's and an application's end of the daemon's links, on plain sockets."""

    def __init__(self) -> None:
        self.application = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.application.bind(("127.0.0.1", 0))
        self.application.settimeout(0.005)
        self.autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.autopilot_port = udp_port()
        self.arguments = (
            *("run", "--autopilot", f"udpin://127.0.0.1:{self.autopilot_port}"),
            *("--endpoint", f"udpout://127.0.0.1:{self.application.getsockname()[1]}"),
        )
        self._encoder = Encoder(1, 1)

    def until_forwarded(self, at_most_s: float) -> float:
        """Speak as an autopilot until the application hears it; return when that was on the monotonic clock [s]."""
        end_s = time.monotonic() + at_most_s
        while time.monotonic() < end_s:
            heartbeat = self._encoder.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))
            self.autopilot.sendto(heartbeat, ("127.0.0.1", self.autopilot_port))
            with contextlib.suppress(TimeoutError):
                frames = Framer().receive(self.application.recv(4096))
                if any(frame.component_id == 1 for frame in frames):
                    return time.monotonic()
        raise AssertionError("nothing was forwarded")


@pytest.fixture
def ends() -> Iterator[Ends]:
    ends = Ends()
    with ends.application, ends.autopilot:
        yield ends


def test_nothing_heavy_is_loaded_before_the_first_frame_is_forwarded(ends: Ends, tmp_path: Path) -> None:
    """GIVEN a configuration that was valid before WHEN the daemon starts THEN it forwards first, then loads."""
    seen = tmp_path / "imports"
    script = LOADING.format(heavy=HEAVY, seen=str(seen))
    for attempt in range(2):
        process = subprocess.Popen([sys.executable, "-c", script, *ends.arguments], stderr=subprocess.PIPE, text=True)
        try:
            forwarded_s = ends.until_forwarded(20.0)
            assert process.stderr is not None
            while "estimating" not in process.stderr.readline():
                assert process.poll() is None
        finally:
            process.terminate()
            process.communicate()
        loads = [(float(t_s), name) for t_s, name in map(str.split, seen.read_text().splitlines())]
        assert {"numpy", "numba"} <= {name for _, name in loads}, "the filter was loaded at last"
        if attempt:
            assert [name for t_s, name in loads if t_s < forwarded_s] == []


class Application:
    """Sends one velocity at 20 Hz to whoever speaks to it."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self._encoder = Encoder(245, 190)
        self._peer: tuple[str, int] | None = None

    def send(self, message: object) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                self._peer = self.socket.recvfrom(65536)[1]
        if self._peer is not None:
            self.socket.sendto(self._encoder.encode(message), self._peer)

    async def hover(self) -> None:
        velocity = mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 0b1101_1100_0111, 0, 0, 0, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0
        )
        while True:
            self.send(velocity)
            await asyncio.sleep(0.05)


@pytest.mark.alone
async def test_a_daemon_that_is_killed_in_flight_leaves_a_short_gap_and_no_mode(tmp_path: Path) -> None:
    """GIVEN an application in OFFBOARD through swingd WHEN swingd is killed and started again THEN it stays there."""
    application, autopilot = Application(), udp_port()
    base = Parameters()
    parameters = replace(
        base,
        simulation=replace(
            base.simulation,
            mavlink=f"udpout://127.0.0.1:{autopilot}",
            mavlink_bind_port=0,
            takeoff_altitude_m=4.0,
        ),
    )
    peer = SimulatedAutopilot(parameters)
    arrivals: list[float] = []
    modes: set[NavState] = set()
    setpoints = 0

    def watch(peer: SimulatedAutopilot) -> None:
        nonlocal setpoints
        if peer.companion.setpoints > setpoints:
            setpoints = peer.companion.setpoints
            arrivals.append(time.monotonic())
        modes.add(peer.autopilot.nav_state)

    def start() -> subprocess.Popen[bytes]:
        with (tmp_path / "log").open("ab") as log:
            return subprocess.Popen(
                [
                    *(sys.executable, "-m", "swingd", "run", "--set", "mode=inline"),
                    *("--autopilot", f"udpin://127.0.0.1:{autopilot}"),
                    *("--endpoint", f"udpout://127.0.0.1:{application.port}"),
                ],
                stderr=log,
            )

    async def until(condition: object, at_most_s: float = 40.0) -> None:
        async with asyncio.timeout(at_most_s):
            while not condition():  # type: ignore[operator]
                await asyncio.sleep(0.02)

    def active() -> bool:
        return b"swingd active" in (tmp_path / "log").read_bytes()

    daemon = start()
    tasks = [
        asyncio.create_task(run_simulation(parameters, peer=peer, on_step=watch)),
        asyncio.create_task(application.hover()),
    ]
    try:
        await until(lambda: peer.companion.setpoints > 3)
        takeoff = (mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0.0, 0.0, 0.0, *(float("nan") for _ in range(4)))
        arm = (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        offboard = (mavlink.MAV_CMD_DO_SET_MODE, 0, 1.0, 6.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        application.send(mavlink.MAVLink_command_long_message(1, 1, *takeoff))
        application.send(mavlink.MAVLink_command_long_message(1, 1, *arm))
        await until(lambda: peer.truth().pos_ned_m[2] < -3.5)
        application.send(mavlink.MAVLink_command_long_message(1, 1, *offboard))
        await until(lambda: peer.autopilot.nav_state is NavState.OFFBOARD)
        await until(active)

        modes.clear()
        arrivals.clear()
        daemon.send_signal(signal.SIGKILL)
        daemon.wait()
        (tmp_path / "log").write_bytes(b"")
        daemon = start()
        await until(lambda: arrivals and time.monotonic() - arrivals[0] > 3.0 and len(arrivals) > 50)
        await until(active)
        assert modes == {NavState.OFFBOARD}
        assert max(b - a for a, b in pairwise(arrivals)) < 1.0
    finally:
        daemon.kill()
        daemon.wait()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        application.socket.close()
