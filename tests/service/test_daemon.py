"""The daemon on real links against the simulated autopilot, in one event loop."""

import asyncio
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest
import uvloop
from ports import udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.config.loader import parameters_from_json
from swingd.link.codec import Codec
from swingd.model.actions import Health
from swingd.model.errors import LinkOpenError, LinkUrlError
from swingd.model.parameters import Mode, Parameters
from swingd.record.event_log import EventLogReader, RecordKind
from swingd.replay import replay
from swingd.service.daemon import Daemon
from swingd.service.meter import Summary
from swingd.sim.autopilot import NavState
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

pytestmark = pytest.mark.live

LOOPS = {"asyncio": asyncio.new_event_loop, "uvloop": uvloop.new_event_loop}


def linked(autopilot: str, mavlink_url: str, speed: float) -> Parameters:
    base = Parameters(mode=Mode.HOLD)
    return replace(
        base,
        link=replace(base.link, autopilot=autopilot),
        simulation=replace(
            base.simulation, mavlink=mavlink_url, mavlink_bind_port=0, speed=speed, takeoff_altitude_m=4.0
        ),
    )


class Pilot:
    """Takes off, and asks for OFFBOARD as soon as setpoints come; called before each step of the simulation."""

    def __init__(self, done: Callable[[], None]) -> None:
        self._codec = Codec(255, 190)
        self._done = done
        self._asked_s = 0.0
        self._offboard_s: float | None = None

    def _command(self, peer: SimulatedAutopilot, number: int, *params: float) -> None:
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        peer.receive(self._codec.encode(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)))

    def __call__(self, peer: SimulatedAutopilot) -> None:
        if peer.autopilot.nav_state is NavState.OFFBOARD:
            self._offboard_s = peer.t_s if self._offboard_s is None else self._offboard_s
            if peer.t_s > self._offboard_s + 4.0:
                self._done()
            return
        if peer.t_s < self._asked_s + 1.0:
            return
        self._asked_s = peer.t_s
        if not peer.autopilot.armed and peer.t_s > 2.0:
            self._command(peer, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, *(float("nan") for _ in range(4)))
            self._command(peer, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        elif peer.companion.setpoints > 50:
            self._command(peer, mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)


async def fly(parameters: Parameters, record: Path | None = None) -> tuple[Summary, SimulatedAutopilot]:
    """Run daemon and simulator until the vehicle has been in OFFBOARD for 4 s."""
    daemon = Daemon(parameters, record)
    peer = SimulatedAutopilot(parameters)
    simulation = None
    try:
        ready = asyncio.Event()
        served = asyncio.create_task(daemon.run(ready.set))
        await asyncio.wait([served, waiting := asyncio.create_task(ready.wait())], return_when="FIRST_COMPLETED")
        waiting.cancel()
        simulation = asyncio.create_task(run_simulation(parameters, peer=peer, on_step=Pilot(daemon.stop)))
        async with asyncio.timeout(60.0):
            return await served, peer
    finally:
        if simulation is not None:
            simulation.cancel()
            with suppress(asyncio.CancelledError):
                await simulation


def judge(summary: Summary, peer: SimulatedAutopilot) -> None:
    assert summary.filter_hz == pytest.approx(100.0, rel=0.05)
    assert summary.setpoints > 400
    assert abs(peer.companion.setpoints - summary.setpoints) < 20, "but for what was on its way at the end"
    assert peer.companion.setpoints_refused == 0
    texts = [text for _, _, text in peer.companion.status_texts]
    assert "swingd init: vehicle on ground" in texts
    assert summary.latency_ms_p50 is not None
    assert 0.0 < summary.latency_ms_p50 < 30.0
    reports = peer.companion.reports
    assert len(reports) > 500
    assert sum(report.health is Health.ACTIVE for report in reports) > 100, "in OFFBOARD for 4 s"
    assert not any(report.health is Health.FAULT for report in reports)


@pytest.mark.alone
@pytest.mark.parametrize("loop", LOOPS)
def test_it_flies_over_udp_and_records_what_it_did(loop: str, tmp_path: Path) -> None:
    port = udp_port()
    parameters = linked(f"udpin://127.0.0.1:{port}", f"udpout://127.0.0.1:{port}", 4.0)
    record = tmp_path / "flight.swingd"
    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        summary, peer = runner.run(fly(parameters, record))
    judge(summary, peer)
    assert parameters_from_json(EventLogReader(record).configuration) == parameters
    run = replay(record, None, parameters_from_json)
    assert run.frames_sent > 1000
    assert run.frames_differing == 0, run.first_difference
    assert len(run.reports) == summary.filter_steps


@contextmanager
def null_modem() -> Iterator[tuple[str, str, Callable[[asyncio.AbstractEventLoop], None]]]:
    """Two serial devices joined back to back; the third value joins them in a running loop."""
    masters, slaves = zip(os.openpty(), os.openpty(), strict=True)

    def join(loop: asyncio.AbstractEventLoop) -> None:
        for source, target in (masters, masters[::-1]):
            os.set_blocking(source, False)

            def carry(source: int = source, target: int = target) -> None:
                with suppress(BlockingIOError, OSError):
                    os.write(target, os.read(source, 4096))

            loop.add_reader(source, carry)

    try:
        yield os.ttyname(slaves[0]), os.ttyname(slaves[1]), join
    finally:
        for fd in (*masters, *slaves):
            os.close(fd)


@pytest.mark.alone
@pytest.mark.parametrize("loop", LOOPS)
def test_it_flies_over_a_serial_line(loop: str) -> None:
    with null_modem() as (near, far, join):
        parameters = linked(f"serial://{near}:921600", f"serial://{far}:921600", 4.0)

        async def session() -> tuple[Summary, SimulatedAutopilot]:
            join(asyncio.get_running_loop())
            return await fly(parameters)

        with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
            summary, peer = runner.run(session())
    judge(summary, peer)


async def test_without_an_autopilot_it_waits_and_says_who_it_is() -> None:
    """A peer that only listens hears heartbeats of system 1, component 191, and nothing else."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.setblocking(False)
        port = listener.getsockname()[1]
        base = Parameters()
        daemon = Daemon(replace(base, link=replace(base.link, autopilot=f"udpout://127.0.0.1:{port}")))
        served = asyncio.create_task(daemon.run())
        await asyncio.sleep(1.3)
        daemon.stop()
        summary = await served
        data = b""
        with suppress(BlockingIOError):
            while True:
                data += listener.recv(4096)
    frames = Codec(255, 190).receive(data)
    assert len(frames) == 2
    assert {(f.msg_id, f.system_id, f.component_id) for f in frames} == {(mavlink.MAVLINK_MSG_ID_HEARTBEAT, 1, 191)}
    assert (summary.filter_steps, summary.setpoints) == (0, 0)


async def test_a_port_in_use_is_an_error_and_leaves_a_whole_recording(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        url = f"udpin://127.0.0.1:{holder.getsockname()[1]}"
        base = Parameters()
        record = tmp_path / "none.swingd"
        with pytest.raises(LinkOpenError, match="already in use"):
            await Daemon(replace(base, link=replace(base.link, autopilot=url)), record).run()
    assert {entry.kind for entry in EventLogReader(record)} <= {RecordKind.PORT_OPENED}


async def test_a_link_that_is_not_understood_is_an_error() -> None:
    base = Parameters()
    with pytest.raises(LinkUrlError, match="carrier-pigeon"):
        await Daemon(replace(base, link=replace(base.link, autopilot="carrier-pigeon://x"))).run()
