"""``swingd doctor`` as a user runs it: page, JSON, exit codes."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from ports import udp_port

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
X500 = str(CONFIGS / "x500.yaml")

pytestmark = pytest.mark.live


@contextmanager
def simulation(port: int) -> Iterator[None]:
    """A simulated PX4 with its defaults, in a process of its own."""
    arguments = [
        "sim",
        "-c",
        X500,
        "--mavlink",
        f"udpout://127.0.0.1:{port}",
        "--set",
        "simulation.mavlink_bind_port=0",
    ]
    process = subprocess.Popen([sys.executable, "-m", "swingd", *arguments], stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def doctor(port: int, *arguments: str, home: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "swingd", "doctor", "--autopilot", f"udpin://127.0.0.1:{port}", *arguments]
    environment = {**os.environ, "XDG_STATE_HOME": str(home)}
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment, check=False)


def test_the_page_names_everything_and_ends_with_the_verdict(tmp_path: Path) -> None:
    port = udp_port()
    with simulation(port):
        found = doctor(port, "-c", X500, "--set", "mode=hold", "--seconds", "5", home=tmp_path)
    assert found.returncode == 1
    lines = found.stdout.splitlines()
    assert [line for line in lines if line[:1].strip() and not line.startswith("streams ")] == [
        "link",
        "autopilot",
        "time",
        "thrust and battery",
        "parameters",
        "advice",
        lines[-1],
    ]
    assert lines[-1] == "not ready for mode hold: COM_OBL_RC_ACT 0 (Position mode)"
    assert "  kind                PX4 1.16.0" in lines
    assert "  hover by the curve  66.2% at 16 V" in lines
    assert any(line.startswith("  imu ") and line.endswith("good              HIGHRES_IMU") for line in lines)
    assert any(line.startswith("  danger   COM_OBL_RC_ACT: 0 (Position mode)") for line in lines)
    assert "           -> COM_OBL_RC_ACT = 5 (Hold) or 4 (Land)" in lines
    assert all(line == line.rstrip() and len(line) <= 120 for line in lines)
    assert "\x1b" not in found.stdout, "no colours where no terminal is"


def test_json_is_one_object_and_0_means_ready(tmp_path: Path) -> None:
    port = udp_port()
    with simulation(port):
        found = doctor(port, "-c", X500, "--json", "--seconds", "4", home=tmp_path)
    assert found.returncode == 0, found.stderr
    assert found.stdout.count("\n") == 1
    object_ = json.loads(found.stdout)
    assert object_["ready"] is True
    assert object_["mode"] == "shadow"
    assert object_["autopilot"]["kind"] == "px4"
    assert {stream["stream"]: stream["verdict"] for stream in object_["streams"]}["imu"] == "good"
    assert object_["values"]["COM_OF_LOSS_T"] == 1.0
    assert {(finding["name"], finding["severity"]) for finding in object_["findings"]} >= {
        ("COM_OBL_RC_ACT", "warning")
    }


def test_silence_is_not_ready_and_says_what_to_check(tmp_path: Path) -> None:
    port, other_port = udp_port(), udp_port()
    with ThreadPoolExecutor() as pool:
        asked = pool.submit(doctor, other_port, "-c", X500, "--seconds", "4", "--json", home=tmp_path)
        found = doctor(port, "-c", X500, "--seconds", "4", home=tmp_path)
        as_json = asked.result()
    assert found.returncode == 1
    assert found.stdout.splitlines()[-1] == "not ready for mode shadow: link silent"
    assert f"send to UDP port {port} of this computer?" in found.stdout
    assert as_json.returncode == 1
    object_ = json.loads(as_json.stdout)
    assert (object_["ready"], object_["autopilot"], object_["link"]["bytes_in"]) == (False, None, 0)


def test_what_a_ground_station_has_set_is_judged_too(tmp_path: Path) -> None:
    """A mass that was set over MAVLink and that the curve cannot carry; looking does not make it forgotten."""
    from swingd.config.loader import load_parameters
    from swingd.model.ground_parameters import GROUND_PARAMETERS
    from swingd.service.state import StateFile

    mass = next(parameter for parameter in GROUND_PARAMETERS if parameter.name == "SWG_VEH_MASS")
    state = StateFile(Path(X500), lambda _note: None, tmp_path / "swingd")
    parameters, _ = state.apply(load_parameters(X500))
    changed = mass.put(parameters, 9.0)
    state.store(changed, mass)
    state.close()
    assert state.path is not None
    kept = state.path.read_bytes()
    port, other_port = udp_port(), udp_port()
    with simulation(port), simulation(other_port), ThreadPoolExecutor() as pool:
        asked = pool.submit(
            doctor, other_port, "-c", X500, "--set", "vehicle.mass_kg=2.1", "--seconds", "4", home=tmp_path
        )
        found = doctor(port, "-c", X500, "--json", "--seconds", "4", home=tmp_path)
        overruled = asked.result()
    assert overruled.returncode == 0
    assert "SWG_VEH_MASS" in overruled.stderr
    assert state.path.read_bytes() == kept
    assert found.returncode == 1
    assert "SWG_VEH_MASS" in found.stderr
    assert "hover" in {finding["name"] for finding in json.loads(found.stdout)["findings"]}


def test_a_taken_port_ends_with_1_and_the_way_round(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        found = doctor(holder.getsockname()[1], "-c", X500, home=tmp_path)
    assert found.returncode == 1
    assert found.stdout == ""
    assert "--autopilot udpout://127.0.0.1:14541" in found.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--set", "payload.mass_kg=heavy"], 78, "payload.mass_kg"),
        (["--autopilot", "pigeon://x"], 78, "pigeon://x"),
        (["--seconds", "1"], 2, "--seconds"),
    ],
)
def test_what_cannot_begin_has_its_own_code(arguments: list[str], code: int, words: str, tmp_path: Path) -> None:
    found = doctor(udp_port(), "-c", X500, *arguments, home=tmp_path)
    assert found.returncode == code
    assert words in found.stderr
    assert found.stdout == ""
