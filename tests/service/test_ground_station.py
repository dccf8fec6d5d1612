"""Ground stations, pymavlink's own parameter client and MAVSDK's against swingd's servers over UDP."""

import asyncio
import contextlib
import itertools
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.param import ParamAsync, ParamError
from mavsdk.plugins.param import ProtocolVersion
from pymavlink import mavparm, mavutil

from swingd.link.codec import Codec
from swingd.link.command_server import CommandServer
from swingd.link.parameter_server import ParameterServer
from swingd.link.transport import open_transport
from swingd.model.actions import StatusText
from swingd.model.ground_parameters import BY_NAME, GROUND_PARAMETERS
from swingd.model.parameters import Parameters
from swingd.service.state import StateFile

pytestmark = pytest.mark.live

SYSTEM, COMPONENT = 1, 191
TICK_S = 0.05


@pytest.fixture(autouse=True)
def _mavlink_2(monkeypatch: pytest.MonkeyPatch) -> None:
    """PARAM_ERROR is beyond MAVLink 1's ids, which pymavlink's connections begin with."""
    monkeypatch.setenv("MAVLINK20", "1")


class Host:
    """The servers and the state file, joined as a daemon joins them."""

    def __init__(self, configured: Parameters, folder: Path) -> None:
        self.notes: list[StatusText] = []
        self.notices: list[str] = []
        self.refusals: list[str] = []
        self.lose: Callable[[Any], bool] = lambda _message: False
        self.state = StateFile(Path("/etc/swingd/drone.yaml"), self.notes.append, folder)
        parameters, _ = self.state.apply(configured)
        self.server = ParameterServer(parameters, SYSTEM, COMPONENT)
        self.commands = CommandServer(SYSTEM, COMPONENT)
        self.codec = Codec(SYSTEM, COMPONENT)
        self.port = 0

    @asynccontextmanager
    async def serving(self) -> AsyncIterator["Host"]:
        self.transport = await open_transport("udpin://127.0.0.1:0", self._received)
        self.port = self.transport.local_port or 0
        task = asyncio.create_task(self._tick())
        try:
            yield self
        finally:
            task.cancel()
            await asyncio.wait([task])
            await self.transport.close()
            self.state.close()
            assert task.cancelled()

    async def _tick(self) -> None:
        for ticks in itertools.count():
            if ticks % 5 == 0:
                self._send(mavutil.mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
            self._send(*self.server.tick())
            await asyncio.sleep(TICK_S)

    def _received(self, _peer: int, data: bytes) -> None:
        now_s = time.monotonic()
        for frame in self.codec.receive(data):
            reply = self.server.handle(now_s, frame)
            self._send(*reply.messages)
            if reply.changed is not None:
                assert reply.parameter is not None
                self.state.store(reply.changed, reply.parameter)
            self.notices += [reply.notice] if reply.notice else []
            self.refusals += [reply.refusal] if reply.refusal else []
            command = self.commands.handle(now_s, frame)
            self._send(*command.messages)
            if command.switch is not None:
                self.server.configure(BY_NAME["SWG_ENABLE"].put(self.server.parameters, float(command.switch)))

    def _send(self, *messages: Any) -> None:
        for message in messages:
            if not self.lose(message):
                self.transport.send(self.codec.encode(message))


class Client:
    """pymavlink's connection, which blocks: each call runs in a thread."""

    def __init__(self, port: int, component: int = COMPONENT) -> None:
        self.link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=255, source_component=190, dialect="common"
        )
        self.link.target_system = SYSTEM
        self.link.target_component = component

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()

    def hello(self) -> None:
        """Speak first, so that the other side knows where to answer, and wait for its heartbeat."""
        self.link.mav.heartbeat_send(6, 8, 0, 0, 4)
        assert self.link.recv_match(type="HEARTBEAT", blocking=True, timeout=5.0) is not None

    def collect(self, quiet_s: float = 0.5) -> dict[int, Any]:
        """PARAM_VALUEs by index until there is silence."""
        values: dict[int, Any] = {}
        while (message := self.link.recv_match(type="PARAM_VALUE", blocking=True, timeout=quiet_s)) is not None:
            values[message.param_index] = message
        return values

    def fetch(self, name: str) -> float | None:
        self.link.param_fetch_one(name)
        message = self.link.recv_match(
            type="PARAM_VALUE", condition=f"PARAM_VALUE.param_id == {name!r}", blocking=True, timeout=2.0
        )
        return None if message is None else message.param_value

    def flood(self) -> None:
        for _ in range(300):
            self.link.mav.param_request_list_send(SYSTEM, COMPONENT)
            self.link.mav.param_request_read_send(SYSTEM, COMPONENT, b"SWG_ENABLE", -1)

    def command(self, param1: float, confirmation: int = 0) -> Any:
        mav = mavutil.mavlink
        self.link.mav.command_long_send(SYSTEM, COMPONENT, mav.MAV_CMD_USER_1, confirmation, param1, 0, 0, 0, 0, 0, 0)
        return self.link.recv_match(type="COMMAND_ACK", blocking=True, timeout=2.0)


@pytest.mark.parametrize("component", [COMPONENT, 0], ids=["to swingd", "to all"])
async def test_a_client_lists_every_parameter_by_itself(tmp_path, component):
    async with Host(Parameters(), tmp_path).serving() as host:
        with Client(host.port, component) as client:
            await asyncio.to_thread(client.hello)
            begun_s = time.monotonic()
            client.link.param_fetch_all()
            values = await asyncio.to_thread(client.collect)
            took_s = time.monotonic() - begun_s - 0.5
    assert sorted(values) == list(range(len(GROUND_PARAMETERS)))
    for index, message in values.items():
        parameter = GROUND_PARAMETERS[index]
        assert message.param_id == parameter.name
        assert message.param_value == pytest.approx(parameter.get(Parameters()), rel=1e-6)
        assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, COMPONENT)
    assert took_s < 3.0


async def test_a_client_sets_reads_gets_refusals_and_finds_it_again_after_a_restart(tmp_path):
    known = mavparm.MAVParmDict()
    async with Host(Parameters(), tmp_path).serving() as host:
        with Client(host.port) as client:
            await asyncio.to_thread(client.hello)
            assert await asyncio.to_thread(known.mavset, client.link, "SWG_CABLE_LEN", 2.4)
            assert host.server.parameters.cable.length_m == 2.4
            assert await asyncio.to_thread(known.mavset, client.link, "SWG_ENABLE", 0)
            assert host.server.parameters.control.enabled is False
            # Refused: what stands is told, by the value and by a reason.
            await asyncio.to_thread(known.mavset, client.link, "SWG_DAMPING", 3.0, 1)
            assert await asyncio.to_thread(client.fetch, "SWG_DAMPING") == 0.5
            assert host.refusals == ["SWG_DAMPING: 3 given; expected 0.05 to 0.95"]
            # A name that is not there is an error for who asked.
            client.link.param_fetch_one("MPC_XY_VEL_MAX")
            error = await asyncio.to_thread(client.link.recv_match, type="PARAM_ERROR", blocking=True, timeout=2.0)
            assert (error.param_id, error.error) == ("MPC_XY_VEL_MAX", 1)
    assert host.notices == ["SWG_CABLE_LEN: 1.5 to 2.4 m, by 255/190", "SWG_ENABLE: 1 to 0, by 255/190"]
    assert host.notes == []
    # WHEN it starts again with the same configuration
    async with Host(Parameters(), tmp_path).serving() as host:
        with Client(host.port) as client:
            await asyncio.to_thread(client.hello)
            assert await asyncio.to_thread(client.fetch, "SWG_CABLE_LEN") == pytest.approx(2.4)
            assert await asyncio.to_thread(client.fetch, "SWG_ENABLE") == 0.0
    # AND with one that the user has changed
    changed = BY_NAME["SWG_CABLE_LEN"].put(Parameters(), 4.0)
    async with Host(changed, tmp_path).serving() as host:
        with Client(host.port) as client:
            await asyncio.to_thread(client.hello)
            assert await asyncio.to_thread(client.fetch, "SWG_CABLE_LEN") == 4.0
            assert await asyncio.to_thread(client.fetch, "SWG_ENABLE") == 0.0


async def test_a_ground_station_on_a_lossy_link_completes_its_list_by_index(tmp_path):
    """As QGroundControl: a list request to all once a heartbeat is seen, then what is missing in batches of ten."""
    host = Host(Parameters(), tmp_path)
    values_sent = itertools.count()

    def lose(message: Any) -> bool:
        """Two of three values of the first list, and every fourth of those that are asked for again."""
        if message.get_type() != "PARAM_VALUE":
            return False
        number = next(values_sent)
        return bool(number % 3 if number < len(GROUND_PARAMETERS) else number % 4 == 0)

    host.lose = lose
    async with host.serving():
        with Client(host.port, component=0) as client:
            await asyncio.to_thread(client.hello)
            client.link.param_fetch_all()
            values = await asyncio.to_thread(client.collect)
            assert 0 < len(values) < len(GROUND_PARAMETERS)
            count = next(iter(values.values())).param_count
            for _ in range(10):
                missing = [index for index in range(count) if index not in values]
                for index in missing[:10]:
                    client.link.mav.param_request_read_send(SYSTEM, COMPONENT, b"", index)
                values |= await asyncio.to_thread(client.collect) if missing else {}
    assert [values[index].param_id for index in range(count)] == [p.name for p in GROUND_PARAMETERS]


async def test_a_set_whose_answer_is_lost_succeeds_when_it_is_tried_again(tmp_path):
    host = Host(Parameters(), tmp_path)
    lost = iter([True])
    host.lose = lambda message: message.get_type() == "PARAM_VALUE" and next(lost, False)
    async with host.serving():
        with Client(host.port) as client:
            await asyncio.to_thread(client.hello)
            known = mavparm.MAVParmDict()
            assert await asyncio.to_thread(known.mavset, client.link, "SWG_LOAD_MASS", 0.45)
    assert host.server.parameters.payload.mass_kg == 0.45
    assert host.notices == ["SWG_LOAD_MASS: 0.3 to 0.45 kg, by 255/190"]


async def test_a_command_switches_is_acknowledged_and_the_parameter_follows(tmp_path):
    mav = mavutil.mavlink
    async with Host(Parameters(), tmp_path).serving() as host:
        with Client(host.port) as client:
            await asyncio.to_thread(client.hello)
            ack = await asyncio.to_thread(client.command, 0.0)
            assert (ack.command, ack.result) == (mav.MAV_CMD_USER_1, mav.MAV_RESULT_ACCEPTED)
            (announced,) = (await asyncio.to_thread(client.collect)).values()
            assert (announced.param_id, announced.param_value) == ("SWG_ENABLE", 0.0)
            assert (await asyncio.to_thread(client.command, 2.0)).result == mav.MAV_RESULT_DENIED
            assert await asyncio.to_thread(client.fetch, "SWG_ENABLE") == 0.0
            assert (await asyncio.to_thread(client.command, 1.0)).result == mav.MAV_RESULT_ACCEPTED
            assert await asyncio.to_thread(client.fetch, "SWG_ENABLE") == 1.0
    # What a pilot switches is not what a ground station has set.
    assert list(tmp_path.iterdir()) == []


async def test_a_flood_of_requests_is_answered_at_the_pace_and_a_value_set_meanwhile_is_confirmed(tmp_path):
    async with Host(Parameters(), tmp_path).serving() as host:
        with Client(host.port) as client:
            await asyncio.to_thread(client.hello)
            begun_s = time.monotonic()
            await asyncio.to_thread(client.flood)
            known = mavparm.MAVParmDict()
            # The value that the list gives meanwhile looks like a confirmation, and the socket may have been full.
            for _ in range(5):
                if host.server.parameters.control.washout_s != 9.0:
                    assert await asyncio.to_thread(known.mavset, client.link, "SWG_WASHOUT", 9.0)
            values = await asyncio.to_thread(client.collect)
            took_s = time.monotonic() - begun_s
    assert len(values) <= len(GROUND_PARAMETERS)
    assert host.server.parameters.control.washout_s == 9.0
    # Besides four heartbeats a second everything is paced.
    assert host.codec.sent <= (2 + 0.2) * (took_s / TICK_S + 10)


async def test_mavsdk_lists_reads_sets_and_hears_of_a_refusal(tmp_path):
    async with (
        Host(Parameters(), tmp_path).serving() as host,
        Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk,
    ):
        await mavsdk.add_any_connection(f"udpout://127.0.0.1:{host.port}")
        async with asyncio.timeout(10.0):
            while not (systems := await mavsdk.get_systems()):
                await asyncio.sleep(0.02)
        param = ParamAsync(systems[0])
        try:
            with contextlib.suppress(ParamError):  # it answers UNKNOWN and does what it is told
                await param.select_component(COMPONENT, ProtocolVersion.V1)
            listed = await param.get_all_params()
            assert {item.name: pytest.approx(item.value, rel=1e-6) for item in listed.float_params} == {
                parameter.name: parameter.get(Parameters()) for parameter in GROUND_PARAMETERS
            }
            assert (listed.int_params, listed.custom_params) == ([], [])
            await param.set_param_float("SWG_CABLE_LEN", 2.4)
            assert host.server.parameters.cable.length_m == 2.4
            assert await param.get_param_float("SWG_CABLE_LEN") == pytest.approx(2.4)
            with pytest.raises(ParamError):
                await param.set_param_float("SWG_DAMPING", 3.0)
            assert await param.get_param_float("SWG_DAMPING") == 0.5
            assert host.refusals == ["SWG_DAMPING: 3 given; expected 0.05 to 0.95"]
        finally:
            param.destroy()
