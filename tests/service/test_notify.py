"""What systemd is told: on a socket of the test's own, by the part alone, the daemon, and the process."""

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from link.messages import attitude, imu, px4_heartbeat
from ports import udp_port

from swingd.link.codec import Encoder
from swingd.model.actions import Action
from swingd.model.errors import ConfigurationError
from swingd.model.events import Event, Imu
from swingd.model.parameters import Parameters
from swingd.pipeline import Pipeline
from swingd.service.daemon import Daemon
from swingd.service.notify import Supervisor

WATCHDOG = "WATCHDOG=1"
PERIOD_S = 0.4
"""Of the tests' watchdog, fed every 0.1 s."""


class Manager:
    """Stands for systemd."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.setblocking(False)
        self.environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": str(round(1e6 * PERIOD_S))}

    def told(self) -> list[str]:
        """Lines since the last call."""
        lines = []
        with contextlib.suppress(BlockingIOError):
            while True:
                lines += self.socket.recv(4096).decode().split("\n")
        return lines


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path / "notify")
    with manager.socket:
        yield manager


@pytest.fixture
def supervisor(manager: Manager) -> Iterator[Supervisor]:
    supervisor = Supervisor.from_environment(manager.environment)
    assert supervisor is not None
    with contextlib.closing(supervisor):
        yield supervisor


# ---------------------------------------------------------------------------------------------------- the part


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"WATCHDOG_USEC": "5000000"}])
def test_without_a_socket_there_is_nobody_to_tell(environment: dict[str, str]) -> None:
    assert Supervisor.from_environment(environment) is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("NOTIFY_SOCKET", "run/notify"),
        ("NOTIFY_SOCKET", "@"),
        ("WATCHDOG_USEC", "5s"),
        ("WATCHDOG_USEC", "0"),
        ("WATCHDOG_USEC", "-5"),
        ("WATCHDOG_PID", "init"),
    ],
)
def test_what_systemd_never_sets_is_named(name: str, value: str) -> None:
    with pytest.raises(ConfigurationError, match=f"{name}: '{value}'; expected "):
        Supervisor.from_environment({"NOTIFY_SOCKET": "/run/notify", "WATCHDOG_USEC": "1"} | {name: value})


@pytest.mark.parametrize(
    ("changes", "fed"),
    [
        ({}, True),
        ({"WATCHDOG_PID": str(os.getpid())}, True),
        ({"WATCHDOG_PID": str(os.getpid() + 1)}, False),
        ({"WATCHDOG_USEC": ""}, False),
    ],
    ids=["any process", "this process", "another process", "no watchdog"],
)
def test_only_a_watchdog_of_this_process_is_fed(manager: Manager, changes: dict[str, str], fed: bool) -> None:
    supervisor = Supervisor.from_environment(manager.environment | changes)
    assert supervisor is not None
    with contextlib.closing(supervisor):
        supervisor.feed(1.0, 0, None)
    assert manager.told() == [WATCHDOG] * fed


@pytest.mark.parametrize(
    ("counts", "fed"),
    [
        ([(0, None), (0, None)], [True, True]),
        ([(10, None), (20, None)], [True, True]),
        ([(10, 4), (20, 8), (30, 12)], [True, True, True]),
        ([(10, 4), (20, 4), (30, 4), (40, 5)], [True, False, False, True]),
        ([(10, 4), (10, 4), (11, 4)], [True, True, False]),
        ([(10, None), (20, 3), (30, 3)], [True, True, False]),
    ],
    ids=["no autopilot", "no pipeline", "advances", "stands still, then advances", "no samples", "joins"],
)
def test_while_samples_come_only_what_the_pipeline_does_feeds(
    manager: Manager, supervisor: Supervisor, counts: list[tuple[int, int | None]], fed: list[bool]
) -> None:
    """GIVEN counts of samples and intervals WHEN each quarter of the period ends THEN progress decides."""
    answers = []
    for quarter, (samples, intervals) in enumerate(counts):
        for tick in range(2):
            supervisor.feed(100.0 + (quarter + 0.6 * tick) * PERIOD_S / 4, samples, intervals)
            told = manager.told()
            assert not (tick and told), "once a quarter"
            answers += [told == [WATCHDOG]] * (not tick)
    assert answers == fed


def test_a_status_is_one_line_and_told_when_it_changes(manager: Manager, supervisor: Supervisor) -> None:
    for text in ("mode inline, ready", "mode inline, ready", "fault: a\nbug\tof  many lines", "mode inline, ready"):
        supervisor.status(text)
    assert manager.told() == [
        "STATUS=mode inline, ready",
        "STATUS=fault: a bug of many lines",
        "STATUS=mode inline, ready",
    ]


def test_what_a_busy_manager_has_not_taken_is_said_again_but_no_old_feeding(
    manager: Manager, supervisor: Supervisor
) -> None:
    """GIVEN a manager that does not read WHEN it is told THEN nobody waits, and it later hears what still holds."""
    filler = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    filler.setblocking(False)
    with filler, contextlib.suppress(BlockingIOError):
        while True:
            filler.sendto(b"FILLER=1", manager.environment["NOTIFY_SOCKET"])
    begun_s = time.monotonic()
    supervisor.ready()
    supervisor.status("mode shadow, init")
    supervisor.status("mode shadow, ready")
    supervisor.feed(1.0, 0, None)
    assert time.monotonic() - begun_s < 1.0
    assert set(manager.told()) == {"FILLER=1"}
    supervisor.feed(1.01, 0, None)
    assert manager.told() == ["READY=1", "STATUS=mode shadow, ready"]


def test_a_reload_is_told_with_its_time_and_its_end_even_late(manager: Manager, supervisor: Supervisor) -> None:
    """GIVEN a manager that is told of a reload THEN by its time; one that was busy meanwhile hears the end alone."""
    before_us = time.monotonic_ns() // 1000
    supervisor.reloading()
    said, stamp = manager.told()
    assert said == "RELOADING=1"
    assert before_us <= int(stamp.removeprefix("MONOTONIC_USEC=")) <= time.monotonic_ns() // 1000
    supervisor.ready()
    assert manager.told() == ["READY=1"]

    filler = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    filler.setblocking(False)
    with filler, contextlib.suppress(BlockingIOError):
        while True:
            filler.sendto(b"FILLER=1", manager.environment["NOTIFY_SOCKET"])
    supervisor.reloading()
    supervisor.ready()
    manager.told()
    supervisor.feed(1.0, 0, None)
    assert manager.told() == ["READY=1", WATCHDOG]


def test_a_manager_that_is_gone_and_an_abstract_address_are_no_trouble() -> None:
    name = f"swingd-test-{os.getpid()}"
    supervisor = Supervisor(f"@{name}")
    with contextlib.closing(supervisor), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as abstract:
        supervisor.ready()
        abstract.bind(f"\0{name}")
        abstract.settimeout(5.0)
        supervisor.feed(1.0, 0, None)
        assert abstract.recv(64) == b"READY=1"


# -------------------------------------------------------------------------------------------------- the daemon


class Autopilot:
    """Speaks to the daemon's link as PX4 does."""

    def __init__(self) -> None:
        self.port = udp_port()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._encoder = Encoder(1, 1)
        self._begun_s = time.monotonic() - 100.0

    def speak(self, with_imu: bool = True, with_attitude: bool = True) -> None:
        t_boot_s = time.monotonic() - self._begun_s
        messages = [px4_heartbeat()]
        messages += [imu(t_boot_s)] * with_imu + [attitude(t_boot_s)] * with_attitude
        for message in messages:
            self._socket.sendto(self._encoder.encode(message), ("127.0.0.1", self.port))

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def autopilot() -> Iterator[Autopilot]:
    with contextlib.closing(Autopilot()) as autopilot:
        yield autopilot


@pytest.mark.live
@pytest.mark.parametrize("case", ["a bug", "no attitude"])
async def test_a_pipeline_that_ended_is_not_fed_for_and_one_that_lacks_an_input_is(
    case: str,
    manager: Manager,
    supervisor: Supervisor,
    autopilot: Autopilot,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """GIVEN an autopilot's IMU WHEN the pipeline fails THEN it is to be started again; only then."""
    step = Pipeline.step

    def broken(pipeline: Pipeline, event: Event) -> list[Action]:
        if isinstance(event, Imu) and pipeline.intervals >= 5:
            raise ZeroDivisionError("a bug")
        return step(pipeline, event)

    if case == "a bug":
        monkeypatch.setattr(Pipeline, "step", broken)
    parameters = replace(Parameters(), link=replace(Parameters().link, autopilot=f"udpin://127.0.0.1:{autopilot.port}"))
    daemon = Daemon(parameters, supervisor=supervisor)
    served = asyncio.create_task(daemon.run())
    told: list[str] = []

    async def speak_until(condition: Callable[[], bool], with_imu: bool = True) -> None:
        async with asyncio.timeout(40.0):
            while not condition():
                autopilot.speak(with_imu, with_attitude=case == "a bug")
                await asyncio.sleep(0.01)
                told.extend(manager.told())

    def within(seconds: float) -> Callable[[], bool]:
        end_s = time.monotonic() + seconds
        return lambda: time.monotonic() > end_s

    try:
        awaited = "STATUS=mode shadow, " + {
            "a bug": "fault: ZeroDivisionError: a bug; everything passes uncorrected",
            "no attitude": "init: waiting for the autopilot's attitude",
        }.get(case, "")
        await speak_until(lambda: awaited in told)
        assert told[0] == "READY=1"
        assert WATCHDOG in told
        await speak_until(within(0.25))  # the quarter in which it ended
        told.clear()
        await speak_until(within(2 * PERIOD_S))
        # On a busy machine a quarter may pass without samples, and is fed for then.
        assert (told.count(WATCHDOG) < 4) is (case == "a bug"), told
        await speak_until(within(0.25), with_imu=False)
        told.clear()
        await speak_until(within(PERIOD_S), with_imu=False)
        assert WATCHDOG in told, "nothing is waited for"
    finally:
        daemon.stop()
        await served
    assert manager.told()[-2:] == ["STOPPING=1", "STATUS=stopping"]


# ------------------------------------------------------------------------------------------------- the process


@pytest.fixture
def start(manager: Manager) -> Iterator[Callable[..., "subprocess.Popen[str]"]]:
    """Starts ``swingd run`` as systemd does; what still runs at the end is killed."""
    processes: list[subprocess.Popen[str]] = []

    def begin(*arguments: str) -> "subprocess.Popen[str]":
        processes.append(
            subprocess.Popen(
                [sys.executable, "-m", "swingd", "run", *arguments],
                stderr=subprocess.PIPE,
                text=True,
                env=os.environ | manager.environment,
            )
        )
        return processes[-1]

    yield begin
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.mark.live
def test_a_process_is_ready_when_it_forwards_is_fed_for_while_it_runs_and_says_when_it_stops(
    start: Callable[..., "subprocess.Popen[str]"], manager: Manager, autopilot: Autopilot
) -> None:
    told: list[str] = []

    def listen(condition: Callable[[], bool], at_most_s: float = 30.0) -> None:
        end_s = time.monotonic() + at_most_s
        while not condition():
            assert time.monotonic() < end_s, told
            assert process.poll() is None
            autopilot.speak()
            time.sleep(0.01)
            told.extend(manager.told())

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as application:
        application.bind(("127.0.0.1", 0))
        application.settimeout(10.0)
        process = start(
            *("--autopilot", f"udpin://127.0.0.1:{autopilot.port}"),
            *("--endpoint", f"udpout://127.0.0.1:{application.getsockname()[1]}"),
        )
        end_s = time.monotonic() + 30.0
        while not told:
            assert time.monotonic() < end_s
            told += manager.told()
            time.sleep(0.001)
        assert told[0] == "READY=1"
        # UDP keeps nothing for a link that is not open yet.
        autopilot.speak()
        assert application.recv(4096)

        listen(lambda: any("init: " in line for line in told))
        told.clear()
        listen(lambda: told.count(WATCHDOG) >= 3, 5.0)
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        manager.told()
        time.sleep(PERIOD_S)
        assert manager.told() == []
        process.send_signal(signal.SIGCONT)
        told.clear()
        listen(lambda: told.count(WATCHDOG) >= 2, 5.0)
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0
        assert manager.told()[-2:] == ["STOPPING=1", "STATUS=stopping"]


@pytest.mark.live
def test_a_wrong_configuration_is_never_ready_and_not_to_be_started_again(
    start: Callable[..., "subprocess.Popen[str]"], manager: Manager, tmp_path: Path
) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("vehicle:\n  mass_kg: heavy\n", encoding="utf-8")
    processes = [start("-c", str(wrong)), start("--autopilot", "serial:///dev/no-such-device:921600")]
    # A device may still come: that one is to be started again.
    assert [process.wait(30.0) for process in processes] == [78, 1]
    assert "READY=1" not in manager.told()
