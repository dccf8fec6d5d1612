"""The truth and the console on real files, sockets and terminals."""

import asyncio
import contextlib
import csv
import errno
import json
import os
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from swingd.core.slung_plant import PlantState
from swingd.model.errors import LinkOpenError, LinkUrlError, SwingdError
from swingd.sim.outlets import CONSOLE_CLIENTS_MAX, LINE_MAX_BYTES, Outlets, Outside, open_outlets
from swingd.sim.pace import CATCH_UP_MAX_S, Pace
from swingd.sim.plant import DT_S, Plant
from swingd.sim.truth import COLUMNS, truth_row

from .rigs import iris

pytestmark = pytest.mark.live


@pytest.fixture
def plant() -> Plant:
    made = Plant(iris())
    made.place((1.0, -2.0, -20.0), xi_rad=0.1, zeta_rad=-0.2, rotors=0.5)
    return made


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(2.0)
        yield made


def url_of(receiver: socket.socket) -> str:
    return f"udp://127.0.0.1:{receiver.getsockname()[1]}"


def step(plant: Plant, outlets: Outlets, count: int) -> None:
    for _ in range(count):
        plant.step((0.5,) * 4, 16.2, spinning=True)
        outlets.after_step(plant.truth)


# The truth


async def test_every_fifth_step_is_a_json_object_of_the_truth(plant: Plant, receiver: socket.socket) -> None:
    async with open_outlets(plant, Outside(truth_url=url_of(receiver))) as outlets:
        step(plant, outlets, 1)
        expected = truth_row(plant.truth())
        step(plant, outlets, 10)
    found = [json.loads(receiver.recv(65536)) for _ in range(3)]
    assert [one["t_boot_s"] for one in found] == [0.004, 0.024, 0.044]
    assert tuple(found[0]) == COLUMNS
    assert tuple(found[0].values()) == pytest.approx(expected, rel=1e-5, abs=1e-9)
    assert found[0]["swing_lateral_rad"] == pytest.approx(0.1, abs=0.01)
    receiver.setblocking(False)
    with pytest.raises(BlockingIOError):
        receiver.recv(65536)


async def test_an_object_fits_into_one_ethernet_frame_and_has_null_for_what_is_not(
    plant: Plant, receiver: socket.socket
) -> None:
    plant.set_wind((-1.0 / 3.0, 2.0 / 3.0, -1.0 / 7.0))
    plant.kick((1.0 / 3.0, -1e-5 / 3.0, 0.0))
    plant.release()
    async with open_outlets(plant, Outside(truth_url=url_of(receiver))) as outlets:
        step(plant, outlets, 1)
    data = receiver.recv(65536)
    assert len(data) < 1400
    found = json.loads(data, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    assert found["swing_lateral_rad"] is None
    assert found["swing_longitudinal_rate_rad_s"] is None
    assert found["attached"] == 0.0


async def test_file_and_stream_keep_their_own_rates(plant: Plant, receiver: socket.socket, tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    async with open_outlets(plant, Outside(truth_file=path, truth_url=url_of(receiver))) as outlets:
        step(plant, outlets, 20)
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["t_boot_s"]) for row in rows] == pytest.approx([0.004 + 0.008 * i for i in range(10)])
    assert [json.loads(receiver.recv(65536))["t_boot_s"] for _ in range(4)] == [0.004, 0.024, 0.044, 0.064]
    assert float(rows[0]["load_kg"]) == 0.3
    assert float(rows[0]["cable_m"]) == 1.5


async def test_nothing_is_described_where_nobody_asks(plant: Plant) -> None:
    async with open_outlets(plant, Outside()) as outlets:
        outlets.after_step(lambda: pytest.fail("the truth was made for nobody"))
        assert outlets.console_port is None


async def test_a_stream_that_nobody_hears_disturbs_nobody(plant: Plant, receiver: socket.socket) -> None:
    """The port is closed: the system answers with ICMP, which a later send reports."""
    url = url_of(receiver)
    receiver.close()
    async with open_outlets(plant, Outside(truth_url=url)) as outlets:
        for _ in range(10):
            step(plant, outlets, 5)
            await asyncio.sleep(0.002)


async def test_a_stream_goes_to_ipv6_too(plant: Plant) -> None:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind(("::1", 0))
        except OSError as error:
            if error.errno != errno.EADDRNOTAVAIL:
                raise
            pytest.skip("no IPv6 here")
        receiver.settimeout(2.0)
        async with open_outlets(plant, Outside(truth_url=f"udp://[::1]:{receiver.getsockname()[1]}")) as outlets:
            step(plant, outlets, 1)
        assert json.loads(receiver.recv(65536))["t_boot_s"] == 0.004


@pytest.mark.parametrize(
    "url",
    ["", "9870", "127.0.0.1:9870", "udp://", "udp://host", "udp://:9870", "udp://host:0", "udp://host:65536",
     "udp://host:x", "udpout://host:1", "tcp://host:1", "udp://host:1/x", "udp://[::1:9870", "udp://a@host:1"],
)  # fmt: skip
async def test_a_url_that_is_none_is_named(plant: Plant, url: str) -> None:
    with pytest.raises(LinkUrlError) as caught:
        async with open_outlets(plant, Outside(truth_url=url)):
            pytest.fail("it was taken")
    assert repr(url) in str(caught.value)
    assert "expected udp://HOST:PORT" in str(caught.value)


async def test_an_unknown_host_is_named(plant: Plant) -> None:
    with pytest.raises(LinkOpenError, match=r"truth stream udp://nowhere.invalid:9870: "):
        async with open_outlets(plant, Outside(truth_url="udp://nowhere.invalid:9870")):
            pytest.fail("it was found")


async def test_a_file_that_cannot_be_opened_is_named(plant: Plant, tmp_path: Path) -> None:
    path = tmp_path / "no" / "truth.csv"
    with pytest.raises(SwingdError, match=f"truth file {path}: No such file"):
        async with open_outlets(plant, Outside(truth_file=path)):
            pytest.fail("it was opened")


@pytest.mark.parametrize("count", [2, 2000], ids=["at the end", "on the way"])
async def test_a_full_disk_is_named(plant: Plant, count: int) -> None:
    with pytest.raises(SwingdError, match="truth file /dev/full: No space left on device"):
        async with open_outlets(plant, Outside(truth_file=Path("/dev/full"))) as outlets:
            step(plant, outlets, count)


async def test_each_way_in_and_out_is_told(plant: Plant, receiver: socket.socket) -> None:
    said: list[str] = []
    url = url_of(receiver)
    async with open_outlets(plant, Outside(truth_url=url, console=0, say=said.append)) as outlets:
        assert said == [
            f"truth, 50 times a simulated second, to {url}",
            f"commands: TCP port {outlets.console_port} of 127.0.0.1; help lists them",
        ]


# The console


class Client:
    """One who speaks to the console."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def read(self) -> str:
        async with asyncio.timeout(5.0):
            return (await self.reader.readline()).decode()

    async def ask(self, data: bytes) -> str:
        self.writer.write(data)
        return await self.read()


@contextlib.asynccontextmanager
async def client_of(outlets: Outlets) -> AsyncIterator[Client]:
    reader, writer = await asyncio.open_connection("127.0.0.1", outlets.console_port)
    try:
        yield Client(reader, writer)
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


@pytest.fixture
async def outlets(plant: Plant) -> AsyncIterator[Outlets]:
    async with open_outlets(plant, Outside(console=0)) as opened:
        yield opened


async def test_one_line_in_gives_one_line_out(plant: Plant, outlets: Outlets) -> None:
    async with client_of(outlets) as client:
        assert await client.ask(b"wind 4 0\n") == "ok wind 4 0 0 m/s\n"
        assert await client.ask(b"mass 0.5\r\n") == "ok load 0.5 kg\n"
        assert await client.ask(b"nonsense\n") == (await client.ask(b"nonsense\n"))
    assert plant.truth().wind_ned_mps == (4.0, 0.0, 0.0)
    assert plant.load_mass_kg == 0.5


async def test_lines_come_in_pieces_and_in_heaps(outlets: Outlets) -> None:
    async with client_of(outlets) as client:
        for piece in (b"wi", b"nd 1", b" 2"):
            client.writer.write(piece)
            await asyncio.sleep(0.01)
        assert await client.ask(b"3\nmass 1\nmass 2\nma") == "ok wind 1 23 0 m/s\n"
        assert await client.read() == "ok load 1 kg\n"
        assert await client.read() == "ok load 2 kg\n"
        assert await client.ask(b"ss 3\n") == "ok load 3 kg\n"


async def test_half_a_line_at_the_end_is_not_obeyed(plant: Plant, outlets: Outlets) -> None:
    async with client_of(outlets) as client:
        client.writer.write(b"mass 1\nmass 12")
        client.writer.write_eof()
        assert await client.read() == "ok load 1 kg\n"
        assert await client.read() == ""
    assert plant.load_mass_kg == 1.0


async def test_bytes_that_are_no_text_and_lines_that_do_not_end_are_answered(outlets: Outlets) -> None:
    async with client_of(outlets) as client:
        assert (await client.ask(bytes(range(128, 256)) + b"\0\xff\n")).startswith("error: ")
        assert (await client.ask(b"\n")).startswith("error: no command given")
        too_long = f"error: line too long; expected at most {LINE_MAX_BYTES} bytes\n"
        assert await client.ask(b"mass 7 " * 20_000 + b"\n") == too_long
        assert await client.ask(b"x" * (LINE_MAX_BYTES + 1) + b"\nmass 1\n") == too_long
        assert await client.read() == "ok load 1 kg\n"
        assert await client.ask(b" " * (LINE_MAX_BYTES - 6) + b"mass 2\n") == "ok load 2 kg\n"


async def test_who_never_reads_is_not_heard_any_more_and_holds_nobody_up(plant: Plant, outlets: Outlets) -> None:
    """GIVEN a client that only writes WHEN its answers cannot leave THEN no more of its lines are obeyed."""
    with socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect(("127.0.0.1", outlets.console_port))
        deaf.setblocking(False)
        obeyed, since = 0.0, time.monotonic()
        async with asyncio.timeout(20.0):
            while obeyed == 0.0 or time.monotonic() - since < 0.2:
                with contextlib.suppress(BlockingIOError):
                    deaf.send(b"help\nkick 0.001 0\n" * 100)
                await asyncio.sleep(0)
                if plant.state[PlantState.LOAD_VEL] != obeyed:
                    obeyed, since = plant.state[PlantState.LOAD_VEL], time.monotonic()
        async with client_of(outlets) as client:
            assert await client.ask(b"mass 0.4\n") == "ok load 0.4 kg\n"


async def test_a_flood_of_lines_leaves_the_loop_to_the_simulation(plant: Plant, outlets: Outlets) -> None:
    async with client_of(outlets) as client:
        client.writer.write(b"".join(b"kick 0.01 0\n" for _ in range(500)))
        kicks = [0]
        async with asyncio.timeout(5.0):
            while kicks[-1] < 500:
                await asyncio.sleep(0)
                kicks.append(round(plant.state[PlantState.LOAD_VEL] / 0.01))
    assert max(after - before for before, after in pairwise(kicks)) == 1


async def test_many_clients_are_served_and_one_too_many_is_told(outlets: Outlets) -> None:
    async with contextlib.AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(client_of(outlets)) for _ in range(CONSOLE_CLIENTS_MAX)]
        answers = await asyncio.gather(*(client.ask(b"mass %d\n" % (i + 1)) for i, client in enumerate(clients)))
        assert answers == [f"ok load {i + 1} kg\n" for i in range(CONSOLE_CLIENTS_MAX)]
        async with client_of(outlets) as late:
            assert (await late.read()) == f"error: {CONSOLE_CLIENTS_MAX} clients are here already; expected fewer\n"
            assert (await late.read()) == ""
    async with asyncio.timeout(5.0):
        while True:
            async with client_of(outlets) as client:
                if (await client.ask(b"mass 1\n")).startswith("ok"):
                    break
            await asyncio.sleep(0.01)


async def test_a_client_that_resets_leaves_no_trace(outlets: Outlets) -> None:
    for _ in range(CONSOLE_CLIENTS_MAX + 1):
        with socket.socket() as rude:
            rude.connect(("127.0.0.1", outlets.console_port))
            rude.send(b"status\n" * 100)
            rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        await asyncio.sleep(0.02)
    async with client_of(outlets) as client:
        assert await client.ask(b"mass 1\n") == "ok load 1 kg\n"


async def test_the_end_closes_the_port_and_every_client(plant: Plant) -> None:
    async with contextlib.AsyncExitStack() as stack:
        async with open_outlets(plant, Outside(console=0)) as outlets:
            port = outlets.console_port
            client = await stack.enter_async_context(client_of(outlets))
            assert await client.ask(b"mass 1\n") == "ok load 1 kg\n"
        assert await client.read() == ""
    async with open_outlets(plant, Outside(console=port)) as outlets:
        assert outlets.console_port == port


async def test_a_port_that_is_taken_is_named(plant: Plant, outlets: Outlets) -> None:
    port = outlets.console_port
    with pytest.raises(LinkOpenError, match=rf"console on 127\.0\.0\.1, TCP port {port}: .*in use"):
        async with open_outlets(plant, Outside(console=port)):
            pytest.fail("it was opened twice")


# The keyboard


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A terminal as standard input; gives the end where the person sits."""
    person, process = os.openpty()
    with os.fdopen(process, "r") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield person
    os.close(person)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(5.0):
        while not condition():
            await asyncio.sleep(0.005)


async def test_what_is_typed_is_obeyed_and_answered(
    plant: Plant, terminal: int, capsys: pytest.CaptureFixture[str]
) -> None:
    async with open_outlets(plant, Outside(keyboard=True)):
        os.write(terminal, b"mass 0.7\nwind 1")
        await until(lambda: plant.load_mass_kg == 0.7)
        os.write(terminal, b" 2\nfoo\n")
        await until(lambda: plant.truth().wind_ned_mps == (1.0, 2.0, 0.0))
        await asyncio.sleep(0.05)
    assert capsys.readouterr().out.splitlines()[:2] == ["ok load 0.7 kg", "ok wind 1 2 0 m/s"]


async def test_the_end_of_input_ends_only_the_keyboard(plant: Plant, terminal: int) -> None:
    async with open_outlets(plant, Outside(keyboard=True, console=0)) as outlets:
        os.write(terminal, b"\x04")
        await asyncio.sleep(0.05)
        async with client_of(outlets) as client:
            assert await client.ask(b"mass 0.5\n") == "ok load 0.5 kg\n"


async def test_a_standard_input_that_is_no_terminal_is_left_alone(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pipe may carry what is not meant for the simulation."""
    out, into = os.pipe()
    os.write(into, b"mass 0.5\n")
    with os.fdopen(out, "r") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        async with open_outlets(plant, Outside(keyboard=True)):
            await asyncio.sleep(0.05)
        assert plant.load_mass_kg == 0.3
        os.close(into)
        assert stdin.read() == "mass 0.5\n"


# The pace


async def run_for(pace: Pace, duration_s: float) -> int:
    loop = asyncio.get_running_loop()
    end_s, steps = loop.time() + duration_s, 0
    while loop.time() < end_s:
        await pace.due()
        steps += 1
    return steps


@pytest.mark.alone
async def test_the_factor_is_what_was_achieved_lately() -> None:
    pace = Pace(5.0)
    assert pace.factor == 0.0
    assert await run_for(pace, 0.5) * DT_S == pytest.approx(2.5, rel=0.2)
    assert pace.factor == pytest.approx(5.0, rel=0.2)
    # A simulation that needs 2 ms for its step of 4 ms cannot run five times as fast as time.
    for _ in range(1000):
        await pace.due()
        time.sleep(0.002)
    assert 1.0 < pace.factor < 2.5


@pytest.mark.alone
async def test_a_stall_is_caught_up_in_part() -> None:
    pace = Pace(1.0)
    await run_for(pace, 0.1)
    time.sleep(1.0)
    assert (await run_for(pace, 0.1)) * DT_S == pytest.approx(CATCH_UP_MAX_S + 0.1, abs=0.06)
    assert pace.factor < 0.7
