"""The unit's ExecStart under its user and in its sandbox, with the compiled filter flying."""

import contextlib
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

import swingd.pipeline  # noqa: F401  (compiles the filter, once)
from swingd.core._jit import _cache_folder

from .live_flight import live_flight
from .sandbox import Unit, sandboxed, why_not

pytestmark = [pytest.mark.live, pytest.mark.alone]

PROJECT = Path(__file__).resolve().parents[2]
KEPT = (PROJECT, Path(sys.prefix), Path(sys.base_prefix))
PROBE = """\
import ctypes, json, mmap, os, socket
libc = ctypes.CDLL(None, use_errno=True)
def tried(what):
    try:
        what()
    except OSError as error:
        return os.strerror(error.errno)
    return "done"
def call(*arguments):
    if libc.syscall(*arguments) < 0:
        raise OSError(ctypes.get_errno(), "")
print(json.dumps({
    "uid": os.getuid(), "groups": os.getgroups(), "home": sorted(os.listdir("/home")),
    "write /usr": tried(lambda: open("/usr/swingd", "w")),
    "write /etc": tried(lambda: open("/etc/swingd/new", "w")),
    "write state": tried(lambda: open("/var/lib/swingd/probe", "w")),
    "mode": oct(os.stat("/var/lib/swingd/probe").st_mode & 0o777),
    "write /proc/sys": tried(lambda: open("/proc/sys/kernel/hostname", "w")),
    "become root": tried(lambda: os.setuid(0)),
    "packet socket": tried(lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW)),
    "udp socket": tried(lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)),
    "new namespace": tried(lambda: call(272, 0x10000000)),
    "mount": tried(lambda: call(165, b"tmpfs", b"/tmp", b"tmpfs", 0, 0)),
    "real time": tried(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))),
    "first process": tried(lambda: open("/proc/1/status")),
    "code written to memory": tried(lambda: mmap.mmap(-1, 4096, prot=7)),
}))
"""


@pytest.fixture(scope="module")
def unit() -> Unit:
    if reason := why_not():
        pytest.skip(reason)
    return Unit.of((PROJECT / "systemd" / "swingd.service").read_text(encoding="utf-8"))


def test_the_sandbox_of_these_tests_denies_what_the_units_does(unit: Unit, tmp_path: Path) -> None:
    configuration = tmp_path / "swingd.yaml"
    configuration.write_text("mode: shadow\n", encoding="utf-8")
    command = sandboxed(
        unit,
        [sys.executable, "-c", PROBE],
        KEPT,
        {"swingd/swingd.yaml": configuration},
        Path(_cache_folder()),
        {},
    )
    probed = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False)
    assert probed.returncode == 0, probed.stderr
    told = json.loads(probed.stdout)
    assert told.pop("uid") > 0
    assert len(told.pop("groups")) <= 1
    assert [name for name in told.pop("home") if Path("/home", name) not in (*KEPT, *KEPT[0].parents)] == []
    denied, read_only, hidden = "Operation not permitted", "Read-only file system", "No such file or directory"
    assert told == {
        "write /usr": read_only,
        "write /etc": read_only,
        "write state": "done",
        "mode": "0o600",
        "write /proc/sys": read_only,
        "become root": denied,
        "packet socket": denied,
        "udp socket": "done",
        "new namespace": denied,
        "mount": denied,
        "real time": denied,
        "first process": hidden,
        "code written to memory": "done",
    }


class Manager:
    """Stands for systemd behind an abstract notify socket, whose queue is short."""

    def __init__(self, name: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(f"\0{name}")
        self._socket.setblocking(False)
        self._told = b""

    def told(self) -> bytes:
        """Everything since `forget`."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._told += self._socket.recv(4096) + b"\n"
        return self._told

    def forget(self) -> None:
        self._told = b""

    def close(self) -> None:
        self._socket.close()


def test_the_units_command_flies_in_its_sandbox(unit: Unit, tmp_path: Path) -> None:
    """GIVEN the unit's user and limits WHEN its ExecStart runs THEN READY=1 comes, and a flight is corrected."""
    name = f"swingd-test-{os.getpid()}"
    with contextlib.closing(Manager(name)) as manager, live_flight(speed=2.0) as flight:
        configuration = tmp_path / "swingd.yaml"
        configuration.write_text(
            f"mode: inline\nlink: {{autopilot: 'udpin://127.0.0.1:{flight.autopilot_port}'}}\n"
            f"endpoints: [{{url: 'udpout://127.0.0.1:{flight.application.port}'}}]\n",
            encoding="utf-8",
        )
        command = shlex.split(unit.one("ExecStart").replace("/opt/swingd/venv", sys.prefix))
        told_by_systemd = {"NOTIFY_SOCKET": f"@{name}", "WATCHDOG_USEC": str(10**6 * int(unit.one("WatchdogSec")))}
        daemon = flight.start(
            command=sandboxed(
                unit, command, KEPT, {"swingd/swingd.yaml": configuration}, Path(_cache_folder()), told_by_systemd
            )
        )
        flight.folders = (Path(f"/proc/{daemon.pid}/root/run/swingd"),)
        flight.until(manager.told)
        assert manager.told().startswith(b"READY=1\n")

        status = dict(line.split(":", 1) for line in Path(f"/proc/{daemon.pid}/status").read_text("utf-8").splitlines())
        assert "0" not in status["Uid"].split()
        assert {int(status[name], 16) for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")} == {0}
        assert (status["NoNewPrivs"].strip(), status["Seccomp"].strip()) == ("1", "2")

        flight.fly()
        flight.until(lambda: b"STATUS=mode inline, active" in manager.told())
        flight.until(lambda: flight.status()["filter"]["steps"] > 300)
        flight.until(lambda: flight.status()["health"]["state"] == "active")
        condition = flight.status()
        print(f"in the sandbox: {condition['filter']}, latency {condition['latency_ms']}")
        assert condition["filter"]["rate_hz"] == pytest.approx(100.0, rel=0.1)
        flight.application.send(
            mavlink.MAVLink_param_set_message(1, 191, b"SWG_DAMPING", 0.6, mavlink.MAV_PARAM_TYPE_REAL32)
        )
        state = Path(f"/proc/{daemon.pid}/root/var/lib/swingd")
        flight.until(lambda: list(state.glob("*.json")))

        # As ExecReload does; the configuration is judged by a process of its own, in the same sandbox.
        assert b"WATCHDOG=1" in manager.told()
        manager.forget()
        daemon.send_signal(signal.SIGHUP)
        flight.until(lambda: any(line["event"] == "configuration read again" for line in flight.lines))
        told = manager.told()
        assert told.index(b"RELOADING=1\nMONOTONIC_USEC=") < told.index(b"READY=1")
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(10.0) == 0
        assert b"STOPPING=1" in manager.told()
