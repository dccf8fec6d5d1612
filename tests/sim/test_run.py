"""The simulator on real sockets and real time."""

import asyncio
import contextlib
import csv
import socket
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ports import tcp_port, udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.errors import LinkOpenError, LinkUrlError
from swingd.model.parameters import Parameters
from swingd.sim.outlets import Outside
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation
from swingd.sim.truth import COLUMNS, truth_row

from .rigs import iris

pytestmark = pytest.mark.live


def on_link(parameters: Parameters, url: str, *, speed: float = 1.0, bind_port: int = 0) -> Parameters:
    simulation = replace(parameters.simulation, mavlink=url, mavlink_bind_port=bind_port, speed=speed)
    return replace(parameters, simulation=simulation)


class Client:
    """A UDP client of the simulator."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.codec = Codec(1, 191)
        self.autopilot: Any = None
        self.datagrams: list[tuple[float, bytes]] = []

    @property
    def url(self) -> str:
        return f"udpout://127.0.0.1:{self.socket.getsockname()[1]}"

    def drain(self) -> list[Any]:
        out = []
        with contextlib.suppress(BlockingIOError):
            while True:
                data, self.autopilot = self.socket.recvfrom(65536)
                self.datagrams.append((time.monotonic(), data))
                out += [frame.message for frame in self.codec.receive(data)]
        return out

    def send(self, message: Any) -> None:
        self.socket.sendto(self.codec.encode(message), self.autopilot)

    async def wait_for(self, name: str, timeout_s: float = 5.0) -> Any:
        async with asyncio.timeout(timeout_s):
            while True:
                for message in self.drain():
                    if message.get_type() == name:
                        return message
                await asyncio.sleep(0.005)


@pytest.fixture
async def client() -> AsyncIterator[Client]:
    made = Client()
    yield made
    made.socket.close()


@contextlib.asynccontextmanager
async def running(parameters: Parameters, **options: Any) -> AsyncIterator[SimulatedAutopilot]:
    peer = options.pop("peer", None) or SimulatedAutopilot(parameters)
    task = asyncio.create_task(run_simulation(parameters, peer=peer, **options))
    try:
        yield peer
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def test_a_client_on_udp_hears_asks_and_is_answered(client: Client) -> None:
    async with running(on_link(iris(), client.url, speed=2.0)) as peer:
        beat = await client.wait_for("HEARTBEAT")
        assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
        client.send(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        ack = await client.wait_for("COMMAND_ACK")
        assert (ack.command, ack.result) == (400, 0)
        assert peer.autopilot.armed
        client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_OF_LOSS_T", -1))
        assert (await client.wait_for("PARAM_VALUE")).param_value == 1.0
    # A datagram is a frame, as PX4 sends them.
    assert all(len(data) == data[1] + 12 for _, data in client.datagrams)


async def test_it_sends_from_the_port_that_was_asked_for(client: Client) -> None:
    port = udp_port()
    async with running(on_link(iris(), client.url, bind_port=port)):
        await client.wait_for("HEARTBEAT")
        assert client.autopilot[1] == port


@pytest.mark.alone
@pytest.mark.parametrize("speed", [1.0, 5.0])
async def test_the_pace_does_not_drift(client: Client, speed: float) -> None:
    async with running(on_link(iris(), client.url, speed=speed)) as peer:
        await client.wait_for("HEARTBEAT")
        start, t_start = time.monotonic(), peer.t_s
        await asyncio.sleep(1.0)
        passed = (time.monotonic() - start) * speed
        assert peer.t_s - t_start == pytest.approx(passed, abs=0.05 * speed)


@pytest.mark.alone
async def test_a_stall_is_not_followed_by_a_burst(client: Client) -> None:
    async with running(on_link(iris(), client.url)) as peer:
        await client.wait_for("HEARTBEAT")
        before = peer.t_s
        time.sleep(1.0)
        await asyncio.sleep(0.1)
        assert 0.2 < peer.t_s - before < 0.4


async def test_the_truth_is_written_and_the_end_is_clean(client: Client, tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    parameters = on_link(iris(), client.url, speed=10.0)
    peer = await run_simulation(parameters, outside=Outside(truth_file=path), duration_s=3.0)
    assert peer.t_s == pytest.approx(3.0, abs=0.005)
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    t = np.array([float(row["t_boot_s"]) for row in rows])
    assert len(t) == 375
    assert np.diff(t) == pytest.approx(0.008)
    last = dict(zip(COLUMNS, truth_row(peer.truth()), strict=True))
    assert float(rows[-1]["load_n_m"]) == pytest.approx(last["load_n_m"], abs=1e-3)
    assert rows[-1]["attached"] == "1"
    # The port is free again.
    await run_simulation(parameters, duration_s=0.1)


async def test_a_steering_hook_runs_with_the_simulation(client: Client) -> None:
    seen: list[float] = []
    parameters = on_link(iris(), client.url, speed=20.0)
    await run_simulation(parameters, duration_s=1.0, on_step=lambda peer: seen.append(peer.t_s))
    assert len(seen) == 250
    assert seen == sorted(seen)


async def test_a_port_in_use_is_named(client: Client) -> None:
    port = client.socket.getsockname()[1]
    with pytest.raises(LinkOpenError, match="udpin"):
        await run_simulation(on_link(iris(), f"udpin://127.0.0.1:{port}"), duration_s=0.1)


async def test_a_url_that_is_none_is_named() -> None:
    with pytest.raises(LinkUrlError, match="carrier-pigeon"):
        await run_simulation(on_link(iris(), "carrier-pigeon://loft"), duration_s=0.1)


async def test_it_serves_tcp_too() -> None:
    port = tcp_port()
    async with running(on_link(iris(), f"tcpin://127.0.0.1:{port}", speed=3.0)):
        await asyncio.sleep(0.1)
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        codec = Codec(1, 191)
        async with asyncio.timeout(5.0):
            while True:
                frames = codec.receive(await reader.read(4096))
                if any(frame.msg_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT for frame in frames):
                    break
        writer.close()
        await writer.wait_closed()
