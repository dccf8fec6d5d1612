"""swingd's own parameters as a ground station sees them: a real pymavlink client, the daemon a process of its own."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from ports import udp_port
from pymavlink import mavutil

from swingd.model.ground_parameters import GROUND_PARAMETERS
from swingd.model.parameters import Parameters

pytestmark = pytest.mark.live

SWINGD = (1, 191)
Begin = Callable[..., "Client"]


class Client:
    """A ground station on one of the daemon's endpoints."""

    def __init__(self, port: int) -> None:
        self.link: Any = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255)

    def heard(self, kind: str, at_most_s: float = 10.0) -> Any:
        return self.link.recv_match(type=kind, blocking=True, timeout=at_most_s)

    def until_alive(self) -> None:
        for _ in range(100):
            self.link.mav.heartbeat_send(6, 8, 0, 0, 0)
            if self.heard("HEARTBEAT", 0.2) is not None:
                return
        raise AssertionError("no heartbeat of swingd")

    def list(self) -> dict[str, float]:
        self.link.mav.param_request_list_send(*SWINGD)
        values: dict[str, float] = {}
        while (message := self.heard("PARAM_VALUE", 3.0)) is not None:
            values[message.param_id] = message.param_value
            if len(values) == message.param_count:
                break
        return values

    def set(self, name: str, value: float) -> float:
        self.link.mav.param_set_send(*SWINGD, name.encode(), value, 9)
        answer = self.heard("PARAM_VALUE")
        assert answer.param_id == name
        return float(answer.param_value)


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Callable[[], tuple["subprocess.Popen[bytes]", Client]]]:
    """Starts the daemon with the same state each time."""
    port, running = udp_port(), []
    environment = {**os.environ, "STATE_DIRECTORY": str(tmp_path / "state")}
    config = tmp_path / "mine.yaml"
    config.write_text("payload:\n  mass_kg: 0.4\n", encoding="utf-8")

    def begin() -> tuple["subprocess.Popen[bytes]", Client]:
        command = [sys.executable, "-m", "swingd", "run", "-c", str(config)]
        links = ["--autopilot", f"udpin://127.0.0.1:{udp_port()}", "--endpoint", f"udpin://:{port}"]
        process = subprocess.Popen([*command, *links], env=environment, stderr=subprocess.DEVNULL)
        client = Client(port)
        running.append((process, client))
        client.until_alive()
        return process, client

    yield begin
    for process, client in running:
        process.kill()
        process.wait()
        client.link.close()


def test_a_client_lists_sets_and_is_refused_and_values_survive(
    daemon: Callable[[], tuple["subprocess.Popen[bytes]", Client]], tmp_path: Path
) -> None:
    process, client = daemon()
    values = client.list()
    defaults = Parameters()
    expected = {one.name: one.get(defaults) for one in GROUND_PARAMETERS}
    assert values == pytest.approx({**expected, "SWG_LOAD_MASS": 0.4}, rel=1e-6)
    assert client.set("SWG_DAMPING", 0.6) == pytest.approx(0.6)
    assert client.set("SWG_ENABLE", 0.0) == 0.0
    assert client.set("SWG_DAMPING", 3.0) == pytest.approx(0.6), "refused, and told what is so"

    process.send_signal(signal.SIGTERM)
    assert process.wait(10.0) == 0
    process, client = daemon()
    again = client.list()
    assert (again["SWG_DAMPING"], again["SWG_ENABLE"]) == (pytest.approx(0.6), 0.0)
    assert again["SWG_LOAD_MASS"] == pytest.approx(0.4)
    assert (tmp_path / "mine.yaml").read_text(encoding="utf-8") == "payload:\n  mass_kg: 0.4\n"


def test_the_correction_is_switched_by_command(
    daemon: Callable[[], tuple["subprocess.Popen[bytes]", Client]],
) -> None:
    _, client = daemon()
    for param1, result, enabled in ((0, 0, 0.0), (1, 0, 1.0), (2, 2, 1.0)):
        client.link.mav.command_long_send(*SWINGD, 31010, 0, param1, 0, 0, 0, 0, 0, 0)
        ack = client.heard("COMMAND_ACK")
        assert (ack.command, ack.result) == (31010, result)
        assert client.list()["SWG_ENABLE"] == enabled
