"""``swingd status``: what it prints, and what it exits with."""

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.engine import Engine
from swingd.model.actions import Health
from swingd.model.parameters import Camera, Estimator, Mode, Parameters, Waypoint
from swingd.service.condition import Standing, condition
from swingd.service.links import Link, settings_of
from swingd.service.meter import Meter
from swingd.service.status import StatusServer

pytestmark = pytest.mark.live

SWINGD = [sys.executable, "-m", "swingd"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where this test's daemons answer, and nobody else's."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    monkeypatch.setattr("swingd.service.status.SYSTEM_FOLDER", tmp_path / "none")
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


@contextlib.contextmanager
def answering(
    health: Health, reason: str = "", configuration: Path | None = None, parameters: Parameters | None = None
) -> Iterator[StatusServer]:
    """Answer as a daemon does whose health is this."""
    parameters = parameters or Parameters()
    engine = Engine(parameters)
    engine.join(0.0)
    links = [Link(settings, lambda *_: None, lambda *_: None, lambda *_: None) for settings in settings_of(parameters)]

    def answer() -> dict[str, Any]:
        standing = Standing(health, reason, 100.0)
        return condition(223.0, 0.0, configuration, standing, engine, links, Meter(), None)

    server = StatusServer(configuration)
    loop, opened, ended = asyncio.new_event_loop(), threading.Event(), asyncio.Event()

    async def serve() -> None:
        server.open(answer)
        opened.set()
        await ended.wait()
        server.close()

    thread = threading.Thread(target=lambda: (loop.run_until_complete(serve()), loop.close()))
    thread.start()
    assert opened.wait(5.0)
    try:
        yield server
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(5.0)


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["status", *arguments])


@pytest.mark.parametrize(
    ("health", "code"),
    [(Health.INIT, 0), (Health.READY, 0), (Health.ACTIVE, 0), (Health.DEGRADED, 1), (Health.FAULT, 1)],
)
def test_the_exit_code_is_the_health(folder: Path, health: Health, code: int) -> None:
    with answering(health, "measurements and model disagree"):
        page, answer = run(), run("--json")
    assert (page.exit_code, answer.exit_code) == (code, code)
    assert f"{health.value} for 2 min 3 s: measurements and model disagree" in page.stdout
    assert json.loads(answer.stdout)["health"]["state"] == health.value


def test_the_page_names_what_withholds_the_correction_and_every_input(folder: Path) -> None:
    with answering(Health.INIT):
        page = run().stdout
    assert "off: mode shadow; not armed;" in page
    assert "autopilot     none heard" in page
    row = next(line for line in page.splitlines() if line.startswith("local position"))
    assert row.split() == ["local", "position", "50", "Hz", "0", "Hz", "never"]
    assert all(len(line) <= 120 for line in page.splitlines())


def test_the_page_tells_how_far_a_path_has_come_and_why_the_load_is_not_led(folder: Path) -> None:
    waiting = Parameters(mode=Mode.PATH, waypoints=(Waypoint(20.0), Waypoint(20.0, 5.0)))
    with answering(Health.INIT, parameters=waiting):
        page, answer = run().stdout, json.loads(run("--json").stdout)
    assert "path          waiting, waypoint 1 of 2; not led: not armed; flight mode is unknown;" in page
    assert answer["path"]["state"] == "waiting"
    assert answer["path"]["remaining_m"] is None
    with answering(Health.INIT):
        assert json.loads(run("--json").stdout)["path"] is None


def test_the_page_tells_which_filter_runs_and_whether_a_camera_sees_the_load(folder: Path) -> None:
    seen = Parameters(estimator=Estimator(name="gp-ekf"), camera=Camera(source="landing_target"))
    with answering(Health.INIT, parameters=seen):
        page, answer = run().stdout, json.loads(run("--json").stdout)
    assert "camera        no LANDING_TARGET of the load yet" in page
    assert "filter        gp-ekf, " in page
    assert answer["camera"] == {"got_hz": 0.0, "age_s": None, "unused": 0}
    with answering(Health.INIT):
        assert json.loads(run("--json").stdout)["camera"] is None


def test_nobody_there_is_said_clearly(folder: Path) -> None:
    for arguments in ([], ["x500"], ["-c", "x500.yaml"], ["--pid", "1"], ["--json"]):
        result = run(*arguments)
        assert result.exit_code == 3
        assert result.stdout == ""
        assert "no swingd runs" in result.stderr
    assert "by x500.yaml" in run("-c", "x500.yaml").stderr


def test_several_are_named_and_one_is_chosen(folder: Path) -> None:
    one, other = Path("/etc/swingd/x500.yaml"), Path("/etc/swingd/iris.yaml")
    with answering(Health.READY, configuration=one), answering(Health.FAULT, configuration=other):
        several = run()
        assert several.exit_code == 2
        assert f"swingd status x500 --pid {os.getpid()}" in several.stderr
        assert [run("x500").exit_code, run("iris").exit_code, run("-c", str(other)).exit_code] == [0, 1, 1]
        assert run("x500", "-c", str(one)).exit_code == 2


def test_a_socket_that_nobody_listens_at_is_nobody(folder: Path) -> None:
    with answering(Health.READY) as server:
        copy = server.path.with_name("left.1.sock")
        os.link(server.path, copy)
    result = run()
    assert result.exit_code == 3
    assert "no swingd answers" in result.stderr


def test_watching_goes_on_over_a_restart_until_ctrl_c(folder: Path) -> None:
    watching = subprocess.Popen([*SWINGD, "status", "--watch", "--json"], stdout=subprocess.PIPE, text=True)
    assert watching.stdout is not None
    try:
        with answering(Health.READY):
            states = [json.loads(watching.stdout.readline())["health"]["state"]]
        time.sleep(0.2)
        with answering(Health.DEGRADED):
            states.append(json.loads(watching.stdout.readline())["health"]["state"])
            watching.send_signal(signal.SIGINT)
            assert watching.wait(5.0) == 1, "as it was last"
    finally:
        watching.kill()
        watching.wait()
        watching.stdout.close()
    assert states == ["ready", "degraded"]
