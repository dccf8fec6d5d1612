"""``swingd run`` and ``swingd sim`` as processes of their own."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from ports import udp_port

from swingd.config.loader import parameters_from_json
from swingd.record.event_log import EventLogReader, RecordKind
from swingd.replay import replay

pytestmark = pytest.mark.live

Start = Callable[..., "subprocess.Popen[str]"]
SWINGD = "import sys; from swingd.cli.start import main; sys.argv[0] = 'swingd'; main()"


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts ``swingd`` with arguments; what still runs at the end is killed."""
    processes: list[subprocess.Popen[str]] = []

    def begin(*arguments: str) -> "subprocess.Popen[str]":
        process = subprocess.Popen(
            [sys.executable, "-c", SWINGD, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        processes.append(process)
        return process

    yield begin
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for(condition: Callable[[], bool], *processes: "subprocess.Popen[str]", at_most_s: float = 60.0) -> None:
    end_s = time.monotonic() + at_most_s
    while not condition():
        assert time.monotonic() < end_s
        assert all(process.poll() is None for process in processes)
        time.sleep(0.1)


def test_a_live_run_stops_at_sigterm_and_replays_byte_for_byte(start: Start, tmp_path: Path) -> None:
    port = udp_port()
    record, summary_file = tmp_path / "run.swingd", tmp_path / "summary.json"
    daemon = start(
        *("run", "--autopilot", f"udpin://127.0.0.1:{port}", "--set", "link.report_rate_hz=100"),
        *("--record", str(record), "--summary", str(summary_file)),
    )
    sim = start(
        *("sim", "--mavlink", f"udpout://127.0.0.1:{port}", "--speed", "3"),
        *("--set", "simulation.mavlink_bind_port=0"),
    )
    sent_kinds = (RecordKind.SENT_AUTOPILOT,)
    wait_for(
        lambda: (
            record.exists()
            and record.stat().st_size > 1000
            and sum(1 for entry in EventLogReader(record) if entry.kind in sent_kinds) > 1000
        ),
        daemon,
        sim,
    )
    daemon.send_signal(signal.SIGTERM)
    _, log = daemon.communicate(timeout=10.0)
    assert daemon.returncode == 0, log
    assert json.loads(log.splitlines()[0])["event"] == "serving"
    assert json.loads(log.splitlines()[-1])["event"] == "stopped"
    assert "autopilot found" in log
    sim.send_signal(signal.SIGINT)
    assert sim.wait(10.0) in (0, 130)

    summary = json.loads(summary_file.read_text(encoding="utf-8"))
    # The streams begin at the autopilot's own 50 Hz, and a busy machine loses datagrams at three times real time.
    assert 55.0 < summary["filter_hz"] < 102.0
    assert summary["filter_steps"] > 500
    assert summary["setpoints"] == 0, "shadow"
    assert 0.0 < summary["cpu_percent"] < 100.0
    run = replay(record, None, parameters_from_json)
    assert run.frames_sent > 1000
    assert run.frames_differing == 0, run.first_difference
    assert len(run.reports) == summary["filter_steps"]


def test_sigint_stops_as_cleanly(start: Start, tmp_path: Path) -> None:
    summary_file = tmp_path / "summary.json"
    daemon = start("run", "--autopilot", f"udpin://127.0.0.1:{udp_port()}", "--summary", str(summary_file))
    assert daemon.stderr is not None
    assert json.loads(daemon.stderr.readline())["event"] == "serving"
    daemon.send_signal(signal.SIGINT)
    assert daemon.wait(10.0) == 0
    assert json.loads(summary_file.read_text(encoding="utf-8"))["latency_ms_p50"] is None


@pytest.mark.parametrize(
    ("url", "code", "words"),
    [
        ("udpin://127.0.0.1:{port}", 1, "swingd: link udpin://127.0.0.1:{port} cannot be opened: "),
        ("serial:///dev/no-such-device:921600", 1, "/dev/no-such-device"),
        ("udp:nonsense", 78, "udp:nonsense"),
    ],
    ids=["port in use", "no device", "no URL"],
)
def test_a_link_that_cannot_be_opened_is_one_message(start: Start, url: str, code: int, words: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        process = start("run", "--autopilot", url.format(port=port))
        out, err = process.communicate(timeout=30.0)
    assert process.returncode == code
    assert out == ""
    assert words.format(port=port) in err
    messages = [line for line in err.splitlines() if not line.startswith("{")]
    assert messages[0].startswith("swingd: ")
    assert "Traceback" not in err


def test_under_journald_every_line_has_its_priority_errors_of_the_configuration_too(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("vehicle: {mass_kg: heavy}\ncable: {length_m: 0}\n", encoding="utf-8")
    log = tmp_path / "log"
    with log.open("wb") as journal:
        status = os.fstat(journal.fileno())
        environment = os.environ | {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        command = [sys.executable, "-m", "swingd", "run", "-c", str(wrong)]
        assert subprocess.run(command, stderr=journal, env=environment, timeout=30.0, check=False).returncode == 78
    lines = log.read_text(encoding="utf-8").splitlines()
    assert len(lines) >= 2
    assert {line[:3] for line in lines} == {"<3>"}
    assert "mass_kg" in lines[0] + lines[1]
