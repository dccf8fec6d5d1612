"""What is done to the process in flight: asked, stopped, reloaded, frozen, killed, flooded, out of disk."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from ports import tcp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.config.loader import parameters_from_json
from swingd.link.codec import Encoder, Framer
from swingd.replay import replay
from swingd.service.daemon import HAND_BACK_SPARE_S
from swingd.service.status import ask, sockets
from swingd.sim.autopilot import NavState

from .live_flight import LiveFlight, live_flight

pytestmark = [pytest.mark.live, pytest.mark.alone]

FADE_OUT_S = 1.0
FLOOD_S = 3.0
CONFIGURATION = f"mode: inline\ncontrol: {{fade_out_s: {FADE_OUT_S}}}\n"
SWINGD = [sys.executable, "-m", "swingd"]


def restart_if_ended(flight: LiveFlight, configuration: Path, *options: str) -> None:
    """Let each test begin with the correction acting, however the one before has ended."""
    if flight.daemon is None or flight.daemon.poll() is not None:
        flight.start("-c", str(configuration), *options)
    if flight.peer.autopilot.nav_state is not NavState.OFFBOARD:
        if not flight.peer.autopilot.armed:
            flight.fly()
        else:
            flight.until(lambda: len(flight.arrivals) > 3)
            flight.enter_offboard()
    flight.until_correcting()


def heard(flight: LiveFlight) -> list[str]:
    """The pilot's texts at the application."""
    frames = Framer().receive(b"".join(list(flight.application.heard)))
    return [frame.message.text for frame in frames if frame.msg_id == mavlink.MAVLINK_MSG_ID_STATUSTEXT]


@pytest.fixture(scope="module")
def configuration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("configuration") / "drone.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def _flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveFlight]:
    with live_flight(folder=tmp_path_factory.mktemp("records")) as flight:
        yield flight


@pytest.fixture
def flight(_flight: LiveFlight, configuration: Path) -> LiveFlight:
    """One vehicle that hovers in OFFBOARD with the correction active."""
    configuration.write_text(CONFIGURATION, encoding="utf-8")
    restart_if_ended(_flight, configuration)
    # The correction has faded in.
    _flight.until(lambda: _flight.status()["health"]["state"] == "active" and _flight.status()["health"]["for_s"] > 1.2)
    _flight.forget()
    return _flight


def test_whoever_asks_is_told_how_it_is(flight: LiveFlight, configuration: Path) -> None:
    flight.until(lambda: flight.status()["payload"]["mass"]["mass_kg"] is not None)
    flight.until(lambda: flight.status()["health"]["state"] == "active")
    told = flight.status()
    assert (told["health"]["reason"], told["mode"]) == ("", "inline")
    assert told["configuration"] == str(configuration)
    assert told["autopilot"] == {"kind": "px4", "system_id": 1, "armed": True, "flight_mode": "offboard"}
    assert told["payload"]["state"] == "load attached"
    assert told["payload"]["mass"]["mass_kg"] == pytest.approx(0.3, rel=0.2)
    assert told["correction"] == {"on": True, "enabled": True, "withheld_by": []}
    assert told["filter"]["rate_hz"] == pytest.approx(100.0, rel=0.05)
    assert 0.0 < told["latency_ms"]["p50"] <= told["latency_ms"]["p99"]
    inputs = {one["stream"]: one for one in told["inputs"]}
    assert inputs["imu"]["asked_hz"] == 250.0
    assert inputs["imu"]["got_hz"] > 0.75 * 250.0
    assert inputs["imu"]["age_s"] < 0.2
    assert [link["state"] for link in told["links"]] == ["open", "open"]

    page = subprocess.run([*SWINGD, "status", "drone"], capture_output=True, text=True, timeout=20.0, check=False)
    assert page.returncode == 0, page.stderr
    assert "active for" in page.stdout
    assert "PX4, system 1, armed, follows setpoints" in page.stdout
    assert "payload       load attached: " in page.stdout
    by_file = [*SWINGD, "status", "-c", str(configuration), "--json"]
    answer = subprocess.run(by_file, capture_output=True, text=True, timeout=20.0, check=False)
    assert answer.returncode == 0
    assert json.loads(answer.stdout)["pid"] == told["pid"]


def test_sighup_takes_over_what_can_be_and_names_the_rest(flight: LiveFlight, configuration: Path) -> None:
    """GIVEN a flight WHEN the configuration is changed, twice, once wrongly THEN the stream of setpoints goes on."""
    assert flight.daemon is not None
    begun_s = time.monotonic()
    configuration.write_text("mode: inline\ncontrol: {damping_ratio: much}\n", encoding="utf-8")
    flight.daemon.send_signal(signal.SIGHUP)
    flight.until(lambda: any("is refused" in line["event"] for line in flight.lines))
    (refused,) = (line for line in flight.lines if "is refused" in line["event"])
    assert refused["level"] == "error"
    assert "damping_ratio" in refused["reason"]
    assert flight.status()["correction"]["on"]
    flight.until(lambda: "swingd: configuration refused, the old one stays" in heard(flight))

    configuration.write_text(
        CONFIGURATION.replace("}", ", damping_ratio: 0.4}") + "link: {rc_channel: 7}\n", encoding="utf-8"
    )
    flight.daemon.send_signal(signal.SIGHUP)
    flight.until(lambda: any("read again" in line["event"] for line in flight.lines))
    (taken,) = (line for line in flight.lines if "read again" in line["event"])
    assert taken["changed"] == ["control.damping_ratio"]
    (waiting,) = (line for line in flight.lines if "keys" in line)
    assert waiting["keys"] == ["link.rc_channel"]
    time.sleep(0.3)
    assert flight.daemon.poll() is None
    assert flight.modes == {NavState.OFFBOARD}
    assert flight.longest_gap_s(begun_s, time.monotonic()) < 0.5


def test_a_stop_of_one_second_is_outlived(flight: LiveFlight) -> None:
    """GIVEN the correction acting WHEN the process stands still for 1 s THEN it corrects again by itself."""
    assert flight.daemon is not None
    flight.daemon.send_signal(signal.SIGSTOP)
    time.sleep(1.0)
    begun_s = time.monotonic()
    flight.daemon.send_signal(signal.SIGCONT)
    flight.until(lambda: flight.arrivals and flight.arrivals[-1] > begun_s)
    passed_s = flight.arrivals[-1] - begun_s
    # PX4 takes 1 s without setpoints for a loss (COM_OF_LOSS_T): its failsafe may have acted, and the pilot decides.
    left = flight.modes - {NavState.OFFBOARD}
    if flight.peer.autopilot.nav_state is not NavState.OFFBOARD:
        flight.enter_offboard()
    flight.until_correcting(15.0)
    corrected_s = time.monotonic() - begun_s
    print(f"SIGSTOP 1 s: setpoints pass {passed_s:.3f} s after, correction {corrected_s:.2f} s after, left for {left}")
    assert passed_s < 0.5
    assert flight.daemon.poll() is None


def test_a_kill_leaves_a_short_gap_and_no_mode(flight: LiveFlight, configuration: Path) -> None:
    """GIVEN the correction acting WHEN swingd is killed and started again THEN the vehicle stays in OFFBOARD."""
    assert flight.daemon is not None
    begun_s = time.monotonic()
    flight.daemon.kill()
    flight.daemon.wait()
    flight.start("-c", str(configuration))
    flight.until(lambda: len(flight.arrivals) > 20)
    gap_s = flight.longest_gap_s(begun_s, time.monotonic())
    flight.until_correcting()
    print(f"SIGKILL: no setpoint for {gap_s:.3f} s, correction {time.monotonic() - begun_s:.2f} s after")
    assert gap_s < 0.9
    assert flight.modes == {NavState.OFFBOARD}
    flight.until(lambda: len([found for found in sockets() if found.name == "drone"]) == 1)
    flight.until(lambda: flight.status()["health"]["state"] == "active")


def test_sigterm_fades_and_hands_back_before_it_ends_and_its_record_is_whole(
    flight: LiveFlight, configuration: Path
) -> None:
    """GIVEN the correction acting WHEN SIGTERM comes THEN the application's own setpoints leave last, and it ends."""
    assert flight.daemon is not None
    assert flight.record is not None
    configuration.write_text(CONFIGURATION.replace("}", ", damping_ratio: 0.4}"), encoding="utf-8")
    flight.daemon.send_signal(signal.SIGHUP)
    flight.until(lambda: any("read again" in line["event"] for line in flight.lines))
    flight.until_correcting()
    begun_s = time.monotonic()
    flight.daemon.send_signal(signal.SIGTERM)
    assert flight.daemon.wait(10.0) == 0
    took_s = time.monotonic() - begun_s
    flight.until(lambda: any(line["event"] == "stopped" for line in flight.lines))
    faded = [t_s for t_s, corrected in flight.corrected if t_s > begun_s and not corrected]
    print(f"SIGTERM: faded {faded[0] - begun_s:.2f} s after, ended {took_s:.2f} s after, fade_out_s {FADE_OUT_S}")
    assert 0.8 * FADE_OUT_S < faded[0] - begun_s < FADE_OUT_S + HAND_BACK_SPARE_S
    assert took_s < FADE_OUT_S + HAND_BACK_SPARE_S + 1.0
    assert not flight.is_corrected, "the last setpoint is the application's own"
    assert flight.modes == {NavState.OFFBOARD}
    assert "swingd ends: nothing passes through it any more" in heard(flight)
    assert flight.daemon.pid not in {found.pid for found in sockets()}, "its socket is gone"
    run = replay(flight.record, None, parameters_from_json)
    assert run.frames_sent > 300
    assert run.frames_differing == 0, run.first_difference


def test_a_second_sigterm_does_not_wait_for_the_fade(flight: LiveFlight) -> None:
    assert flight.daemon is not None
    begun_s = time.monotonic()
    flight.daemon.send_signal(signal.SIGTERM)
    time.sleep(0.2)
    assert flight.daemon.poll() is None
    flight.daemon.send_signal(signal.SIGTERM)
    assert flight.daemon.wait(5.0) == 0
    assert time.monotonic() - begun_s < 0.2 + 0.5 * FADE_OUT_S


def test_a_full_disk_costs_the_recording_and_nothing_else(
    flight: LiveFlight, configuration: Path, tmp_path: Path
) -> None:
    """GIVEN a disk that takes 100 bytes WHEN swingd records and a ground station sets a value THEN it flies on."""
    assert flight.daemon is not None
    flight.daemon.kill()
    flight.daemon.wait()
    record = tmp_path / "flight.swingd"
    flight.start("-c", str(configuration), "--record", str(record), file_bytes_max=100)
    flight.until(lambda: any("recording ended" in line["event"] for line in flight.lines))
    flight.until_correcting()
    damping = mavlink.MAVLink_param_set_message(1, 191, b"SWG_DAMPING", 0.6, mavlink.MAV_PARAM_TYPE_REAL32)
    flight.application.send(damping)
    flight.until(lambda: any("cannot be written" in line["event"] for line in flight.lines))
    (ended,) = (line for line in flight.lines if "recording ended" in line["event"])
    (unkept,) = (line for line in flight.lines if "cannot be written" in line["event"])
    assert "File too large" in ended["reason"]
    assert "File too large" in unkept["event"]
    told = flight.status()
    assert told["correction"]["on"]
    assert told["recording"]["lost"] > 0
    assert flight.modes == {NavState.OFFBOARD}
    assert record.stat().st_size <= 100
    flight.daemon.send_signal(signal.SIGTERM)
    assert flight.daemon.wait(10.0) == 0


def test_an_endpoint_that_never_reads_and_a_flood_of_parameters_hold_up_nobody(
    flight: LiveFlight, configuration: Path
) -> None:
    """GIVEN the correction acting WHEN a peer never reads and another asks without end THEN all else goes on."""
    assert flight.daemon is not None
    flight.daemon.kill()
    flight.daemon.wait()
    port = tcp_port()
    flight.start("-c", str(configuration), endpoints=[f"tcpin://127.0.0.1:{port}"])
    flight.until(lambda: len(flight.arrivals) > 20)
    flight.until_correcting()
    process = psutil.Process(flight.daemon.pid)
    quiet = flight.status()["latency_ms"]
    encoder = Encoder(255, 190)
    lists = encoder.encode(mavlink.MAVLink_param_request_list_message(1, 191))
    with socket.socket() as deaf, socket.socket() as flooding:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect(("127.0.0.1", port))
        flooding.connect(("127.0.0.1", port))
        flooding.settimeout(0.0)
        memory = process.memory_info().rss
        flight.forget()
        begun_s = time.monotonic()
        sent = 0
        while time.monotonic() - begun_s < FLOOD_S:
            value = 0.3 + 0.0001 * (sent % 1000)
            flood = encoder.encode(
                mavlink.MAVLink_param_set_message(1, 191, b"SWG_DAMPING", value, mavlink.MAV_PARAM_TYPE_REAL32)
            )
            try:
                flooding.send(flood + lists)
                sent += 2
            except BlockingIOError:
                pass
            time.sleep(0.005)
        told = flight.status()
        grown = process.memory_info().rss - memory
        gap_s = flight.longest_gap_s(begun_s, time.monotonic())
        print(
            f"deaf TCP peer and {sent / FLOOD_S:.0f} parameter messages/s: +{grown / 1e6:.1f} MB, gap {gap_s:.3f} s, "
            f"p99 {quiet['p99']:.2f} -> {told['latency_ms']['p99']:.2f} ms, unsent {told['counters']['unsent']}"
        )
        assert told["counters"]["unsent"]["endpoint 2"] > 0
        assert grown < 8e6
        assert gap_s < 0.5
        assert flight.modes == {NavState.OFFBOARD}
        assert told["correction"]["on"]


def test_a_client_of_the_status_that_never_reads_holds_up_nobody(flight: LiveFlight) -> None:
    assert flight.daemon is not None
    (found,) = (found for found in sockets() if found.pid == flight.daemon.pid)
    process = psutil.Process(flight.daemon.pid)
    ask(found.path)
    handles, begun_s = process.num_fds(), time.monotonic()
    clients = [socket.socket(socket.AF_UNIX) for _ in range(200)]
    try:
        for client in clients:
            client.connect(str(found.path))
        time.sleep(0.5)
        assert process.num_fds() == handles, "each connection has been answered and closed"
        assert flight.longest_gap_s(begun_s, time.monotonic()) < 0.3
        assert json.loads(clients[0].recv(1 << 20))["pid"] == flight.daemon.pid, "and its answer waits for it"
    finally:
        for client in clients:
            client.close()


def test_who_closes_the_terminal_ends_it(tmp_path: Path) -> None:
    """GIVEN swingd in a terminal WHEN the terminal is closed THEN it ends, and reads no configuration instead."""
    log = (tmp_path / "log").open("wb")
    pid, terminal = os.forkpty()
    if pid == 0:
        os.dup2(log.fileno(), 2)
        os.execv(sys.executable, [*SWINGD, "run", "--autopilot", "udpin://127.0.0.1:0"])
    with log:
        end_s = time.monotonic() + 20.0
        while b"serving" not in (tmp_path / "log").read_bytes():
            assert time.monotonic() < end_s
            time.sleep(0.02)
        os.close(terminal)
        for _ in range(3):  # as a shell and the kernel both do
            os.kill(pid, signal.SIGHUP)
            time.sleep(0.02)
        while os.waitpid(pid, os.WNOHANG) == (0, 0):
            assert time.monotonic() < end_s
            time.sleep(0.02)
    assert b"stopped" in (tmp_path / "log").read_bytes()
    assert b"read again" not in (tmp_path / "log").read_bytes()
