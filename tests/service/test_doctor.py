"""The examination before a flight, on real sockets against the simulated autopilot."""

import asyncio
import random
import socket
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ports import udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec, cut_frames
from swingd.link.preflight import Advice, AdviceSeverity, carrier
from swingd.model import parameters as model_parameters
from swingd.model.errors import ConfigurationError, LinkOpenError, LinkUrlError
from swingd.model.events import AutopilotKind, Stream
from swingd.model.parameters import Endpoint, Mode, Parameters, ThrustSource
from swingd.service.daemon import Daemon
from swingd.service.diagnosis import Diagnosis, StreamReport
from swingd.service.doctor import Examination, examine
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

pytestmark = pytest.mark.live

SECONDS = 3.6
"""The streams are asked for after 1.2 s, and measured over 2."""
GOOD = {"COM_OBL_RC_ACT": 5, "COM_RCL_EXCEPT": 4, "MPC_THR_HOVER": 0.68}
SAID = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_TIMESYNC,
    mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
}
ASKED = {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}
KEY = bytes(range(32))


def linked(port: int, mode: Mode = Mode.HOLD, kind: AutopilotKind = AutopilotKind.PX4) -> Parameters:
    base = Parameters(mode=mode)
    face = model_parameters.SimulatedKind(kind.value)
    return replace(
        base,
        link=replace(base.link, autopilot=f"udpin://127.0.0.1:{port}"),
        simulation=replace(base.simulation, autopilot=face, mavlink=f"udpout://127.0.0.1:{port}", mavlink_bind_port=0),
    )


class Recorder:
    """Keeps what the simulated autopilot hears."""

    def __init__(self, peer: SimulatedAutopilot) -> None:
        self.messages: list[Any] = []
        receive, codec = peer.receive, Codec(1, 1)

        def heard(data: bytes) -> None:
            self.messages += [frame.message for frame in codec.receive(data)]
            receive(data)

        peer.receive = heard  # type: ignore[method-assign]


@asynccontextmanager
async def flying(
    parameters: Parameters, peer: SimulatedAutopilot, on_step: Callable[[SimulatedAutopilot], None] | None = None
) -> AsyncIterator[None]:
    task = asyncio.create_task(run_simulation(parameters, peer=peer, on_step=on_step))
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def examined(
    parameters: Parameters, values: Mapping[str, float] | None = None, seconds: float = SECONDS, **options: Any
) -> Diagnosis:
    peer = SimulatedAutopilot(parameters, GOOD if values is None else values, **options)
    async with flying(parameters, peer):
        return await examine(parameters, seconds)


def streams(diagnosis: Diagnosis) -> dict[Stream, StreamReport]:
    return {stream.stream: stream for stream in diagnosis.streams}


def dangers(diagnosis: Diagnosis) -> list[Advice]:
    return [finding for finding in diagnosis.findings if finding.severity is AdviceSeverity.DANGER]


@pytest.mark.alone
async def test_a_vehicle_on_the_ground_is_ready_and_everything_is_measured() -> None:
    port = udp_port()
    parameters = linked(port)
    peer = SimulatedAutopilot(parameters, GOOD)
    recorder = Recorder(peer)
    offsets: list[float] = []
    shares: list[float] = []
    async with flying(parameters, peer, lambda peer: offsets.append(peer.t_boot_s - time.monotonic())):
        diagnosis = await examine(parameters, SECONDS, shares.append)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
            listener.bind(("127.0.0.1", port))
            listener.setblocking(False)
            rest = b""
            until_s = time.monotonic() + 1.0
            while time.monotonic() < until_s:
                await asyncio.sleep(0.02)
                with suppress(BlockingIOError):
                    while True:
                        rest += listener.recv(65536)

    assert diagnosis.ready
    assert diagnosis.findings == ()
    autopilot = diagnosis.autopilot
    assert autopilot is not None
    assert (autopilot.system_id, autopilot.kind, autopilot.version) == (1, AutopilotKind.PX4, "1.16.0")
    assert (autopilot.armed, autopilot.in_air, autopilot.remote_control) == (False, False, False)

    link = diagnosis.link
    assert (link.lost_frames, link.garbage_bytes, link.refused_frames) == (0, 0, 0)
    assert (link.signed, link.swingd_running, link.senders) == (False, False, ("1/1",))
    assert 500 < link.frames_per_s < 1000

    got = streams(diagnosis)
    assert got[Stream.IMU].got_hz == pytest.approx(224.0, rel=0.1)
    assert (got[Stream.IMU].asked_hz, got[Stream.IMU].message, got[Stream.IMU].verdict) == (250, "HIGHRES_IMU", "good")
    assert got[Stream.BATTERY].got_hz == pytest.approx(10.0, abs=1.0)
    assert (got[Stream.MOTORS].got_hz, got[Stream.MOTORS].verdict) == (0.0, "idle")
    assert {stream.verdict for stream in diagnosis.streams} == {"good", "idle"}

    clock = diagnosis.clock
    assert clock.answered > 0.8 * clock.asked > 20
    assert clock.round_trip_p50_s is not None
    assert clock.round_trip_p99_s is not None
    assert 0.004 < clock.round_trip_p50_s <= clock.round_trip_p99_s < 0.2, "it reads its link 8 ms late"
    assert clock.offset_s == pytest.approx(sorted(offsets)[len(offsets) // 2], abs=0.03)
    assert clock.offset_spread_s is not None
    assert clock.offset_spread_s < 0.03

    thrust = diagnosis.thrust
    assert thrust.voltage_v == pytest.approx(16.2, abs=0.05)
    assert thrust.expected_nominal == pytest.approx(0.6812, abs=1e-4)
    assert (thrust.measured, thrust.autopilot_hover) == (None, pytest.approx(0.68))

    assert diagnosis.values["COM_OBL_RC_ACT"] == 5
    assert diagnosis.values["MPC_XY_VEL_P_ACC"] == pytest.approx(1.8)
    assert diagnosis.values["SER_TEL2_BAUD"] == 921600
    assert not set(diagnosis.missing) & set(diagnosis.values)

    assert {message.get_msgId() for message in recorder.messages} == SAID
    assert {m.command for m in recorder.messages if m.get_type() == "COMMAND_LONG"} == ASKED
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in recorder.messages} == {(1, 192)}
    assert not peer.companion.setpoints

    assert diagnosis.streams_restored
    imu_frames = [raw for raw in cut_frames(rest) if raw[7] == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU]
    assert len(imu_frames) == pytest.approx(50, abs=6), "the onboard link's default"
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < 0.1
    assert 0.9 < shares[-1] <= 1.0


async def test_a_default_px4_is_not_ready_and_the_reason_comes_first() -> None:
    diagnosis = await examined(linked(udp_port()), {})
    assert not diagnosis.ready
    assert [danger.name for danger in dangers(diagnosis)] == ["COM_OBL_RC_ACT"]
    assert diagnosis.findings[0].name == "COM_OBL_RC_ACT"
    assert {finding.name for finding in diagnosis.findings} == {"COM_OBL_RC_ACT", "COM_RCL_EXCEPT", "MPC_THR_HOVER"}


async def test_a_copter_is_read_by_its_own_rules() -> None:
    values = {"PSC_VELXY_P": 3.0, "GUID_TIMEOUT": 3.0}
    diagnosis = await examined(linked(udp_port(), kind=AutopilotKind.ARDUPILOT), values)
    assert diagnosis.autopilot is not None
    assert diagnosis.autopilot.kind is AutopilotKind.ARDUPILOT
    assert diagnosis.values["PSC_VELXY_P"] == 3.0
    assert diagnosis.values["SERIAL1_BAUD"] == 57
    assert "autopilot.velocity_p: 3" in " ".join(finding.remedy for finding in diagnosis.findings)
    got = streams(diagnosis)
    assert got[Stream.IMU].got_hz == pytest.approx(200.0, rel=0.1)
    assert got[Stream.IMU].verdict == "good"
    assert diagnosis.ready


def hovering(parameters: Parameters) -> SimulatedAutopilot:
    """A peer that has taken off."""
    peer = SimulatedAutopilot(parameters, GOOD)
    codec = Codec(255, 190)
    nan = float("nan")
    peer.advance(2.0)
    takeoff = (mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0.0, 0.0, 0.0, nan, nan, nan, nan)
    for command in (takeoff, (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, *([0.0] * 6))):
        peer.receive(codec.encode(mavlink.MAVLink_command_long_message(1, 1, *command)))
    peer.advance(30.0)
    return peer


async def test_in_the_air_the_hover_is_measured_and_the_streams_are_left_alone() -> None:
    parameters = linked(udp_port())
    peer = hovering(parameters)
    recorder = Recorder(peer)
    async with flying(parameters, peer):
        diagnosis = await examine(parameters, SECONDS)
    assert diagnosis.autopilot is not None
    assert (diagnosis.autopilot.armed, diagnosis.autopilot.in_air) == (True, True)
    thrust = diagnosis.thrust
    assert thrust.measured_source is ThrustSource.MOTORS
    assert thrust.measured == pytest.approx(thrust.expected_now, abs=0.02)
    assert thrust.scale == pytest.approx(1.0, abs=0.05)
    assert streams(diagnosis)[Stream.MOTORS].verdict == "good"
    assert not diagnosis.streams_restored
    assert "left raised" in [finding.value for finding in diagnosis.findings]
    intervals = [
        m.param2
        for m in recorder.messages
        if m.get_type() == "COMMAND_LONG" and m.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    ]
    assert intervals
    assert all(interval > 0.0 for interval in intervals)
    assert diagnosis.ready


async def test_whoever_interrupts_it_leaves_the_streams_as_they_were() -> None:
    parameters = linked(udp_port())
    peer = SimulatedAutopilot(parameters, GOOD)
    recorder = Recorder(peer)
    async with flying(parameters, peer):
        task = asyncio.create_task(examine(parameters, 60.0))
        await asyncio.sleep(2.5)
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await asyncio.sleep(0.1)
    last: dict[int, float] = {}
    for message in recorder.messages:
        if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            last[int(message.param1)] = message.param2
    assert last.keys() >= {carrier(AutopilotKind.PX4, stream) for stream in (Stream.IMU, Stream.THROTTLE)}
    assert set(last.values()) == {0.0}


async def test_without_an_imu_it_is_not_ready() -> None:
    imu = carrier(AutopilotKind.PX4, Stream.IMU)
    diagnosis = await examined(linked(udp_port()), without={imu})
    assert streams(diagnosis)[Stream.IMU].verdict == "refused"
    (danger,) = dangers(diagnosis)
    assert danger.name == "imu"
    assert "MAV_RESULT" in danger.meaning


async def test_a_link_that_loses_frames_is_told_by_gaps_and_rates() -> None:
    """Every second frame is lost on the way."""
    parameters = linked(udp_port())
    inlet = udp_port()
    loop = asyncio.get_running_loop()
    dice = random.Random(1)

    class Relay(asyncio.DatagramProtocol):
        def datagram_received(self, data: bytes, addr: Any) -> None:
            # Random, for a rule would hit the same streams again and again.
            if dice.random() < 0.5:
                relay.sendto(data, ("127.0.0.1", port))

    port = int(parameters.link.autopilot.rpartition(":")[2])
    relay, _ = await loop.create_datagram_endpoint(Relay, local_addr=("127.0.0.1", inlet))
    lossy = replace(parameters, simulation=replace(parameters.simulation, mavlink=f"udpout://127.0.0.1:{inlet}"))
    try:
        async with flying(lossy, SimulatedAutopilot(lossy, GOOD)):
            diagnosis = await examine(parameters, SECONDS)
    finally:
        relay.close()
    assert diagnosis.link.autopilot_frames > 100
    share = diagnosis.link.lost_frames / (diagnosis.link.lost_frames + diagnosis.link.autopilot_frames)
    assert share == pytest.approx(0.5, abs=0.07)
    findings = {finding.name: finding for finding in diagnosis.findings}
    assert "frames lost" in findings["link"].value
    # This way nothing that is said gets through: requests, TIMESYNC and parameters.
    assert findings["latency"].severity is AdviceSeverity.WARNING
    assert "none read" in findings["parameters"].value
    assert findings["imu"].severity is AdviceSeverity.DANGER
    assert streams(diagnosis)[Stream.IMU].verdict == "slow"


async def test_silence_says_what_to_check() -> None:
    parameters = linked(udp_port())
    begun_s = time.monotonic()
    diagnosis = await examine(parameters, 1.0)
    assert 1.0 < time.monotonic() - begun_s < 2.0
    assert diagnosis.autopilot is None
    assert diagnosis.streams == ()
    (finding,) = diagnosis.findings
    assert (finding.severity, finding.name, finding.value) == (AdviceSeverity.DANGER, "link", "silent")
    assert parameters.link.autopilot.rpartition(":")[2] in finding.remedy
    assert not diagnosis.ready


@asynccontextmanager
async def talking(port: int, make: Callable[[], bytes]) -> AsyncIterator[None]:
    """Somebody who sends at 100 Hz and hears nothing."""

    async def talk() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while True:
                sender.sendto(make(), ("127.0.0.1", port))
                await asyncio.sleep(0.01)

    task = asyncio.create_task(talk())
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def test_garbage_is_called_so() -> None:
    port = udp_port()
    dice = random.Random(7)
    async with talking(port, lambda: dice.randbytes(40)):
        diagnosis = await examine(linked(port), 1.0)
    (finding,) = diagnosis.findings
    assert finding.name == "link"
    assert "not MAVLink" in finding.meaning
    assert "baud" in finding.remedy


async def test_garbage_between_frames_is_counted() -> None:
    port = udp_port()
    parameters = linked(port)
    dice = random.Random(7)
    peer = SimulatedAutopilot(parameters, GOOD)
    advance = peer.advance

    def dirty(t_s: float) -> list[bytes]:
        return [dice.randbytes(12) + frame for frame in advance(t_s)]

    peer.advance = dirty  # type: ignore[method-assign]
    async with flying(parameters, peer):
        diagnosis = await examine(parameters, SECONDS)
    assert diagnosis.link.garbage_bytes == pytest.approx(12 * diagnosis.link.frames, rel=0.02)
    # One false start in 256 has a checksum that some unknown message could have, and takes what follows with it.
    assert diagnosis.link.lost_frames < 0.01 * diagnosis.link.frames
    assert [finding.name for finding in diagnosis.findings] == ["link"]
    assert diagnosis.ready


async def test_a_ground_station_alone_is_no_autopilot() -> None:
    port = udp_port()
    codec = Codec(255, 190)
    async with talking(port, lambda: codec.encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))):
        diagnosis = await examine(linked(port), 1.0)
    (finding,) = diagnosis.findings
    assert (finding.name, finding.value) == ("autopilot", "heard: 255/190")


async def test_another_system_than_the_configured_one_is_named() -> None:
    parameters = linked(udp_port())
    parameters = replace(parameters, link=replace(parameters.link, system_id=7))
    diagnosis = await examined(parameters, seconds=1.5)
    (finding,) = diagnosis.findings
    assert (finding.value, finding.meaning) == ("heard: system 1", "the configuration serves system 7 only")
    assert "link.system_id = 1" in finding.remedy


async def test_a_signing_autopilot_wants_a_key(tmp_path: Path) -> None:
    """Examined without a key, with its own and with another one, at the same time."""
    signing = {"signing_key": KEY, "signing_start_unix_s": time.time()}

    def with_key(key: bytes) -> Parameters:
        path = tmp_path / key.hex()[:8]
        path.write_text(key.hex())
        path.chmod(0o600)
        parameters = linked(udp_port())
        return replace(parameters, link=replace(parameters.link, key_file=str(path)))

    without, own, other = await asyncio.gather(
        *(examined(parameters, **signing) for parameters in (linked(udp_port()), with_key(KEY), with_key(KEY[::-1])))
    )
    assert without.link.signed
    assert "signing" in {danger.name for danger in dangers(without)}
    assert own.link.signed
    assert own.findings == ()
    assert [danger.name for danger in dangers(other)][:1] == ["signing"]
    assert "another key" in dangers(other)[0].meaning


async def test_a_key_that_cannot_be_read_is_a_configuration_error(tmp_path: Path) -> None:
    parameters = linked(udp_port())
    with pytest.raises(ConfigurationError, match="cannot be read"):
        await examine(replace(parameters, link=replace(parameters.link, key_file=str(tmp_path / "none"))), 1.0)


async def test_a_link_that_is_not_understood_is_an_error() -> None:
    parameters = linked(udp_port())
    with pytest.raises(LinkUrlError, match="carrier-pigeon"):
        await examine(replace(parameters, link=replace(parameters.link, autopilot="carrier-pigeon://x")), 1.0)


@pytest.mark.parametrize(
    ("endpoints", "way"),
    [
        ((), "udpout://127.0.0.1:14541"),
        ((Endpoint(url="udpin://127.0.0.1:15001"),), "udpout://127.0.0.1:15001"),
        ((Endpoint(url="udpout://10.0.0.9:14550"), Endpoint(url="tcpin://:5790")), "tcpout://127.0.0.1:5790"),
    ],
)
async def test_a_port_that_is_taken_says_how_to_go_through_swingd(endpoints: tuple[Endpoint, ...], way: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        parameters = replace(linked(holder.getsockname()[1]), endpoints=endpoints)
        with pytest.raises(LinkOpenError, match=f"already in use.*--autopilot {way}"):
            await examine(parameters, 1.0)


async def test_through_a_running_swingd_it_only_looks() -> None:
    parameters = linked(udp_port())
    endpoint = udp_port()
    served = replace(parameters, endpoints=(Endpoint(url=f"udpin://127.0.0.1:{endpoint}"),))
    peer = SimulatedAutopilot(parameters, GOOD)
    recorder = Recorder(peer)
    daemon = Daemon(served)
    running = asyncio.create_task(daemon.run())
    try:
        async with flying(parameters, peer):
            await asyncio.sleep(4.0)
            way = replace(parameters, link=replace(parameters.link, autopilot=f"udpout://127.0.0.1:{endpoint}"))
            diagnosis = await examine(way, SECONDS)
    finally:
        daemon.stop()
        await running
    assert diagnosis.link.swingd_running
    assert "1/191" in diagnosis.link.senders
    assert not diagnosis.streams_restored
    assert [finding.value for finding in diagnosis.findings] == ["as swingd asked"]
    assert streams(diagnosis)[Stream.IMU].verdict == "good"
    assert diagnosis.values["COM_OBL_RC_ACT"] == 5
    assert diagnosis.clock.answered > 0
    own = [m for m in recorder.messages if m.get_srcComponent() == 192]
    assert {m.command for m in own if m.get_type() == "COMMAND_LONG"} == {mavlink.MAV_CMD_REQUEST_MESSAGE}


def test_it_is_never_swingds_own_component() -> None:
    base = Parameters()
    assert Examination(base, 0.0).component_id == 192
    assert Examination(replace(base, link=replace(base.link, component_id=192)), 0.0).component_id == 193


def test_nothing_that_arrives_raises_and_a_late_frame_is_no_loss() -> None:
    """Any message of the dialect's, from the autopilot and from others, with the fields that pymavlink gives."""
    examination = Examination(Parameters(), 0.0)
    sender = Codec(1, 1)
    receiver = Codec(1, 192)
    heartbeat = sender.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))
    frames = [sender.encode(mavlink.MAVLink_attitude_message(10 * i, *([0.0] * 6))) for i in range(1, 6)]
    late = [heartbeat, *frames[:3], frames[4], frames[3]]
    examination.receive(0.1, receiver.receive(b"".join(late)))
    dice = random.Random(3)
    for msg_id, message_class in mavlink.mavlink_map.items():
        size = message_class.unpacker.size
        head = bytes((0xFD, size, 0, 0, 6, 1, 1)) + msg_id.to_bytes(3, "little")
        body = head + dice.randbytes(size)
        crc = mavlink.x25crc(body[1:])
        crc.accumulate(bytes((message_class.crc_extra,)))
        examination.receive(0.2, receiver.receive(body + crc.crc.to_bytes(2, "little")))
    assert receiver.counters.bad_checksums == 0
    examination.tick(0.3)
    diagnosis = examination.diagnosis(1000, 0, 0)
    assert diagnosis.link.frames == 6 + len(mavlink.mavlink_map)
    assert diagnosis.link.lost_frames == 1, "the gap before the late frame"
