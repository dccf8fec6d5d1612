"""The socket that says how a daemon is: who finds it, who may ask, and what no client can do to it."""

import asyncio
import contextlib
import json
import os
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from link.messages import imu, px4_heartbeat
from ports import udp_port

from swingd.engine import Engine
from swingd.link.codec import Encoder, Framer
from swingd.link.port import Port
from swingd.link.router import AUTOPILOT
from swingd.model.actions import Health
from swingd.model.parameters import Endpoint, Mode, Parameters
from swingd.service.condition import Standing, condition, health_of, refusals
from swingd.service.links import Link, settings_of
from swingd.service.meter import Meter
from swingd.service.state import configuration_name
from swingd.service.status import (
    ANSWER_KEPT_S,
    StatusError,
    StatusServer,
    StatusSocket,
    ask,
    runtime_folder,
    sockets,
)

pytestmark = pytest.mark.live

CONFIGURATION = Path("/etc/swingd/drone.yaml")


class Serving:
    """A status server in a loop of its own, for clients that block."""

    def __init__(self, answer: Callable[[], dict[str, Any]], configuration: Path | None, folder: Path) -> None:
        self.server = StatusServer(configuration, folder)
        self.others: tuple[int, ...] = ()
        self.problem: OSError | None = None
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        opened = threading.Event()

        async def serve() -> None:
            try:
                self.others = self.server.open(answer)
            except OSError as error:
                self.problem = error
            opened.set()
            await self._ended.wait()
            self.server.close()

        def run() -> None:
            self._loop.run_until_complete(serve())
            self._loop.close()

        self._thread = threading.Thread(target=run)
        self._thread.start()
        assert opened.wait(5.0)

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(5.0)


@contextlib.contextmanager
def serving(
    folder: Path, answer: Callable[[], dict[str, Any]] = dict, configuration: Path | None = CONFIGURATION
) -> Iterator[Serving]:
    with contextlib.closing(Serving(answer, configuration, folder)) as server:
        yield server


# -------------------------------------------------------------------------------------------------- the socket


def test_an_answer_is_one_object_and_the_end(tmp_path: Path) -> None:
    with serving(tmp_path, lambda: {"mode": "hold"}) as server:
        assert ask(server.server.path) == {"mode": "hold"}
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(server.server.path))
            assert client.makefile().read() == '{"mode": "hold"}\n'


def test_others_cannot_ask_and_the_folder_is_the_users(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with serving(folder) as server:
        assert stat.S_IMODE(server.server.path.stat().st_mode) == 0o660
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert list(folder.iterdir()) == [], "nothing is left behind"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to somebody else")
def test_a_folder_of_somebody_else_is_not_used(tmp_path: Path) -> None:
    """Among the temporary files anybody may have made it first."""
    folder = tmp_path / "run"
    folder.mkdir()
    os.chown(folder, 12345, 12345)
    with serving(folder) as server:
        if os.geteuid() != 12345:
            assert isinstance(server.problem, PermissionError)
            assert "belongs to another user" in str(server.problem)
    assert list(folder.iterdir()) == []


def test_a_link_in_its_place_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "elsewhere")
    with serving(tmp_path / "run") as server:
        assert isinstance(server.problem, PermissionError)
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_socket_of_a_killed_daemon_is_replaced_and_a_living_one_told_apart(tmp_path: Path) -> None:
    name = configuration_name(CONFIGURATION)
    dead = tmp_path / f"{name}.99999999.sock"
    foreign = tmp_path / "other.99999999.sock"
    for path in (dead, foreign):
        with socket.socket(socket.AF_UNIX) as killed:
            killed.bind(str(path))
    script = (
        "import asyncio, sys; from pathlib import Path; from swingd.service.status import StatusServer\n"
        "async def serve():\n"
        "    StatusServer(Path(sys.argv[1]), Path(sys.argv[2])).open(lambda: {'mode': 'first'})\n"
        "    print('open', flush=True); await asyncio.sleep(60)\n"
        "asyncio.run(serve())"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, str(CONFIGURATION), str(tmp_path)], stdout=subprocess.PIPE
    ) as first:
        assert first.stdout is not None
        first.stdout.readline()
        try:
            with serving(tmp_path, lambda: {"mode": "second"}) as server:
                assert server.others == (first.pid,)
                assert ask(server.server.path) == {"mode": "second"}
                assert ask(tmp_path / f"{name}.{first.pid}.sock") == {"mode": "first"}
                assert not dead.exists()
                assert foreign.exists(), "of another configuration"
        finally:
            first.kill()


@pytest.mark.parametrize("clients", [1, 300])
def test_clients_that_never_read_cost_nothing_that_stays(clients: int, tmp_path: Path) -> None:
    calls = []

    def answer() -> dict[str, Any]:
        calls.append(time.monotonic())
        return {"text": "x" * 8000}

    with serving(tmp_path, answer) as server, contextlib.ExitStack() as stack:
        begun_s = time.monotonic()
        held = [stack.enter_context(socket.socket(socket.AF_UNIX)) for _ in range(clients)]
        for client in held:
            client.connect(str(server.server.path))
        assert len(ask(server.server.path)["text"]) == 8000, "whoever comes after them is answered"
        elapsed_s = time.monotonic() - begun_s
        assert len(calls) <= 2 + elapsed_s / ANSWER_KEPT_S, "asking often costs no more"
        assert json.loads(held[-1].makefile().read())["text"]


def test_a_client_that_is_gone_before_it_is_answered_is_no_trouble(tmp_path: Path) -> None:
    with serving(tmp_path) as server:
        for _ in range(50):
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(str(server.server.path))
        assert ask(server.server.path) == {}


def test_a_path_too_long_for_a_socket_is_an_error_that_is_told(tmp_path: Path) -> None:
    folder = tmp_path / ("deep" * 30)
    with serving(folder) as server:
        assert "too long" in str(server.problem)


# ----------------------------------------------------------------------------------------------------- to find it


@pytest.mark.parametrize(
    ("configuration", "name"), [(CONFIGURATION, "drone"), (None, "default"), (Path("/a/my-iris.2.yaml"), "my-iris.2")]
)
def test_its_name_tells_configuration_and_process(configuration: Path | None, name: str, tmp_path: Path) -> None:
    found = StatusSocket.at(StatusServer(configuration, tmp_path).path)
    assert found is not None
    assert (found.name, found.pid) == (name, os.getpid())
    assert found.belongs_to(configuration)
    assert not found.belongs_to(Path("/home/drone.yaml"))
    assert not found.belongs_to(None) or configuration is None


@pytest.mark.parametrize("name", [".4711", "drone.sock", "drone.json", "drone.x.sock", ".sock"])
def test_other_files_are_none(name: str) -> None:
    assert StatusSocket.at(Path("/run/swingd") / name) is None


def test_folders_are_those_of_the_service_the_session_or_the_user(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/swingd/iris:/run/other")
    assert runtime_folder() == Path("/run/swingd/iris")
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert runtime_folder() == tmp_path / "swingd"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert runtime_folder() == tmp_path / f"swingd-{os.geteuid()}"


def test_services_are_found_by_their_folders(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As the units name them."""
    units = Path(__file__).resolve().parents[2] / "systemd"
    for unit, folder in (("swingd.service", "swingd"), ("swingd@.service", "swingd@%i")):
        assert f"RuntimeDirectory={folder}\n" in (units / unit).read_text(encoding="utf-8")
    monkeypatch.setattr("swingd.service.status.SYSTEM_FOLDER", tmp_path / "swingd")
    iris = Path("/etc/swingd/iris.yaml")
    with serving(tmp_path / "swingd"), serving(tmp_path / "swingd@iris", configuration=iris):
        assert {"drone", "iris"} <= {found.name for found in sockets()}


def test_every_daemon_of_the_user_is_found(tmp_path: Path) -> None:
    with serving(tmp_path), serving(tmp_path, configuration=None):
        assert {found.name for found in sockets(tmp_path) if found.path.parent == tmp_path} == {"drone", "default"}


# -------------------------------------------------------------------------------------------------------- to ask


def test_what_cannot_be_asked_says_why(tmp_path: Path) -> None:
    path = tmp_path / "drone.1.sock"
    with pytest.raises(StatusError, match="no swingd answers"):
        ask(path)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        with pytest.raises(StatusError, match="no swingd answers"):
            ask(path)
        listener.listen()
        with pytest.raises(StatusError, match=r"no answer within 0\.2 s; is the process stopped\?"):
            ask(path, 0.2)


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400", b"[1, 2]", b"\xff\xfe"])
def test_what_is_no_answer_is_named(answer: bytes, tmp_path: Path) -> None:
    path = tmp_path / "drone.1.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(StatusError, match="expected a JSON object"):
            ask(path)
        thread.join()


# ------------------------------------------------------------------------------------------------ what is told


def told(engine: Engine, standing: Standing) -> dict[str, Any]:
    links = [
        Link(settings, lambda *_: None, lambda *_: None, lambda *_: None) for settings in settings_of(Parameters())
    ]
    object_ = condition(20.0, 5.0, CONFIGURATION, standing, engine, links, Meter(), None)
    parsed: dict[str, Any] = json.loads(json.dumps(object_, allow_nan=False))
    return parsed


def test_before_the_filter_is_there_the_reason_says_so() -> None:
    engine = Engine(Parameters(mode=Mode.INLINE))
    assert health_of(engine) == (Health.INIT, "loading the filter; everything passes uncorrected")
    health, reason = health_of(engine, "ImportError: numba")
    assert health is Health.FAULT
    assert "ImportError: numba" in reason
    answer = told(engine, Standing(Health.INIT, "loading", 12.0))
    assert answer["health"] == {"state": "init", "reason": "loading", "for_s": 8.0}
    assert (answer["uptime_s"], answer["autopilot"], answer["inputs"]) == (15.0, None, [])
    assert answer["correction"] == {"on": False, "enabled": True, "withheld_by": ["no filter runs"]}


async def test_what_a_link_refuses_is_counted_by_its_reason(tmp_path: Path) -> None:
    """GIVEN an endpoint for one system with a key WHEN others send to it THEN each refusal has its reason."""
    key = tmp_path / "key"
    key.write_text("11" * 32 + "\n", encoding="ascii")
    key.chmod(0o600)
    port = udp_port()
    endpoint = Endpoint(url=f"udpin://127.0.0.1:{port}", key_file=str(key), system_ids=(245,))
    settings = settings_of(Parameters(endpoints=(endpoint,)))[1]
    link = Link(settings, lambda *_: None, lambda *_: None, lambda *_: None)
    await link.open()
    wrong = Port(bytes(32), 0, frozenset(), time.time)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (
            b"no frame",
            Encoder(1, 1).encode(imu(1.0)),
            Encoder(245, 1).encode(imu(1.0)),
            wrong.seal(Encoder(245, 1).encode(imu(1.0))),
        ):
            sender.sendto(data, ("127.0.0.1", port))
        async with asyncio.timeout(5.0):
            while len(refusals(Engine(Parameters()), [link])["access"]) < 3:
                await asyncio.sleep(0.01)
    counted = refusals(Engine(Parameters()), [link])
    await link.close()
    assert counted["access"] == {
        "endpoint 1 system_not_allowed": 1,
        "endpoint 1 unsigned": 1,
        "endpoint 1 wrong_signature": 1,
    }
    assert counted["framing"] == {"endpoint 1 garbage_bytes": len(b"no frame")}


def test_a_pipeline_that_failed_is_a_fault_with_its_reason() -> None:
    engine = Engine(Parameters())
    engine.join(0.0)
    engine.failure, engine._pipeline = "ZeroDivisionError: a bug", None
    health, reason = health_of(engine)
    assert (health, reason) == (Health.FAULT, "ZeroDivisionError: a bug; everything passes uncorrected")


def test_what_withholds_the_correction_and_what_was_refused_is_named() -> None:
    engine = Engine(replace(Parameters(), mode=Mode.SHADOW))
    engine.join(0.0)
    stranger = Framer().receive(Encoder(9, 9).encode(imu(1.0)))
    engine.receive(0.1, AUTOPILOT, stranger)
    engine.receive(0.2, AUTOPILOT, Framer().receive(Encoder(1, 1).encode(px4_heartbeat())))
    engine.receive(0.3, AUTOPILOT, Framer().receive(Encoder(9, 9).encode(imu(1.0))))
    answer = told(engine, Standing(*health_of(engine), 0.0))
    assert not answer["correction"]["on"]
    assert {"mode shadow", "not armed"} <= set(answer["correction"]["withheld_by"])
    assert answer["counters"]["drops"]["other_sender"] >= 1
    assert answer["counters"] == refusals(engine, []) | {"access": {}, "framing": {}, "unsent": {}}
    assert answer["autopilot"]["armed"] is False
    assert {one["stream"]: one["asked_hz"] for one in answer["inputs"]}["imu"] == 250.0
    assert all(one["age_s"] is None for one in answer["inputs"])
