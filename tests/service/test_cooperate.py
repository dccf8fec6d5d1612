"""`swingd cooperate` on real sockets, its command, and what it says on the wire."""

import asyncio
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from swingd.link import load_message
from swingd.link.codec import Frame, Framer
from swingd.link.load_message import quaternion_of
from swingd.model.actions import Health
from swingd.model.formation import LoadMotion
from swingd.record.tlog import TlogReader
from swingd.service.cooperate import Cooperation
from swingd.studies.cooperative.cases import EXPERIMENT
from swingd.studies.cooperative.flight import rotations, run
from tests.pipeline.formation_flight import Teller, Telling, fly_through, rig, truth_at
from tests.ports import udp_port

PROJECT = Path(__file__).resolve().parents[2]
ORIGIN = mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
FROM_S = 2.0
"""Of the flight: where the tellers begin."""


@pytest.fixture(scope="module")
def flight():
    return run(EXPERIMENT, 6)


class Vehicle:
    """Tells a flight in real time through a socket, and answers questions for its clock."""

    def __init__(self, flight, index: int, telling: Telling, port: int) -> None:
        self.teller = Teller(flight, index, telling, 1)
        self.address = ("127.0.0.1", port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.framer = Framer()
        self.begun_s = 0.0
        self.asked: list[int] = []

    async def tell(self, seconds: float) -> None:
        rows = self.teller.t_s
        every = self.teller.telling.every
        self.begun_s = time.monotonic()
        for row in range(round(FROM_S * 100), rows.size, every):
            due_s = self.begun_s + float(rows[row]) - FROM_S
            if due_s > self.begun_s + seconds:
                return
            while time.monotonic() < due_s:
                await asyncio.sleep(0.002)
                self.answer()
            for encoder, message in self.teller.sample(row, self.teller.telling.boot_s):
                self.socket.sendto(encoder.encode(message), self.address)
            if row % 50 == 0:
                self.socket.sendto(b"\xfd\x09garbage" + os.urandom(20), self.address)
                nan = mavlink.MAVLink_attitude_message(row * 10, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)
                self.socket.sendto(self.teller.autopilot.encode(nan), self.address)

    def answer(self) -> None:
        try:
            data = self.socket.recv(4096)
        except BlockingIOError:
            return
        for frame in self.framer.receive(data):
            self.asked.append(frame.msg_id)
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
                boot_s = self.teller.telling.boot_s + time.monotonic() - self.begun_s + FROM_S
                answer = mavlink.MAVLink_timesync_message(round(boot_s * 1e9), frame.message.ts1)
                self.socket.sendto(self.teller.autopilot.encode(answer), self.address)
            elif frame.msg_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG and frame.message.param1 == ORIGIN:
                self.socket.sendto(self.teller.autopilot.encode(self.teller.origin()), self.address)


async def listen(ground: socket.socket, framer: Framer, heard: list[Frame]) -> None:
    while True:
        heard += framer.receive(await asyncio.get_running_loop().sock_recv(ground, 65536))


@pytest.mark.live
async def test_two_vehicles_over_udp_give_the_pose_at_the_output_and_in_the_record(flight, tmp_path: Path) -> None:
    ports = udp_port(), udp_port()
    ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ground.bind(("127.0.0.1", 0))
    ground.setblocking(False)
    given = rig(flight)
    parameters = replace(
        given,
        vehicles=tuple(
            replace(one, link=f"udpin://127.0.0.1:{port}") for one, port in zip(given.vehicles, ports, strict=True)
        ),
        outputs=(f"udpout://127.0.0.1:{ground.getsockname()[1]}",),
    )
    tellings = Telling(), Telling(boot_s=73_000.0)
    vehicles = [
        Vehicle(flight, k, telling, port) for k, (telling, port) in enumerate(zip(tellings, ports, strict=True))
    ]
    heard: list[Frame] = []
    listening = asyncio.create_task(listen(ground, Framer(), heard))
    cooperation = Cooperation(parameters, record=tmp_path / "flight.tlog")
    serving = asyncio.create_task(cooperation.run())
    await asyncio.sleep(0.1)
    # The second one falls silent after 4 s, the first one goes on.
    await asyncio.gather(vehicles[0].tell(6.0), vehicles[1].tell(4.0))
    cooperation.stop()
    summary = await serving
    await asyncio.sleep(0.1)
    listening.cancel()
    for vehicle in vehicles:
        vehicle.socket.close()
        assert mavlink.MAVLINK_MSG_ID_ODOMETRY not in vehicle.asked
    ground.close()
    assert {(frame.system_id, frame.component_id) for frame in heard} == {(200, 191)}
    told = [report for frame in heard if (report := _load_pose(frame)) is not None]
    order = [report.health for report in told]
    changes = [health for health, before in zip(order, [None, *order], strict=False) if health is not before]
    assert changes == [Health.INIT, Health.READY, Health.DEGRADED, Health.FAULT]
    poses = [frame.message for frame in heard if frame.msg_id == mavlink.MAVLINK_MSG_ID_ODOMETRY]
    assert len(poses) == summary.poses
    good = [pose for pose in poses if pose.quality == 100]
    assert len(good) > 100
    assert order.count(Health.READY) == len(good)
    errors = []
    for pose in good:
        t_s = pose.time_usec * 1e-6 - vehicles[0].begun_s + FROM_S
        truth = [np.interp(t_s, flight.t_s, flight.load(1)[:, k]) for k in range(3)]
        errors.append(np.subtract((pose.x, pose.y, pose.z), truth))
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < 0.03).all()
    assert told[-1].values["vehicle_2_age_s"] > 1.0
    assert told[-1].values["vehicle_1_age_s"] < 0.3
    assert math.isnan(told[-1].values["pos_n_m"])
    assert told[-1].values["vehicle_1_clock_std_s"] < 0.01
    recorded = mavutil.mavlink_connection(str(tmp_path / "flight.tlog"), dialect="common")
    kinds = set()
    while (message := recorded.recv_match()) is not None:
        kinds.add((message.get_srcSystem(), message.get_type()))
    recorded.close()
    assert {(1, "LOCAL_POSITION_NED"), (2, "DEBUG_FLOAT_ARRAY"), (200, "ODOMETRY"), (200, "HEARTBEAT")} <= kinds
    assert sum(1 for _ in TlogReader(tmp_path / "flight.tlog")) > 1000


@pytest.mark.live
def test_the_command_says_whom_it_misses_and_ends_on_ctrl_c(tmp_path: Path) -> None:
    file = tmp_path / "two.yaml"
    text = (PROJECT / "configs" / "cooperate" / "two.yaml").read_text(encoding="utf-8")
    for port in (14601, 14602, 14550, 14555):
        text = text.replace(str(port), str(udp_port()))
    file.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "swingd", "cooperate", "-c", str(file), "--record", str(tmp_path / "x.tlog")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=PROJECT) as process:
        lines: list[dict[str, object]] = []
        for line in process.stderr:
            if not line.startswith("{"):
                continue
            lines.append(json.loads(line))
            if lines[-1]["event"] == "load pose init":
                process.send_signal(signal.SIGINT)
        code = process.wait(10.0)
    assert code == 0
    assert "system 2: no LOCAL_POSITION_NED" in str(lines[-2]["reason"])
    assert lines[-1]["event"] == "stopped"


def _load_pose(frame):
    if frame.msg_id != mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY:
        return None
    return load_message.decode(frame.message)


# ---- on the wire


def test_the_array_holds_what_its_layout_says(flight) -> None:
    report = fly_through(flight, rig(flight), until_s=2.0).reports[-1]
    assert report.health is Health.READY
    decoded = load_message.decode(load_message.load_pose(report))
    assert decoded.health is Health.READY
    values = decoded.values
    assert len(load_message.FIELDS) <= 58
    assert [values[name] for name in ("pos_n_m", "pos_e_m", "pos_d_m")] == pytest.approx(report.motion.pos_ned_m)
    assert values["yaw_rad"] == report.motion.yaw_rad
    assert values["vehicles_used"] == 2.0
    assert values["age_s"] == pytest.approx(report.t_mono_s - report.motion.t_mono_s)
    assert values["vehicle_2_age_s"] == pytest.approx(report.vehicles[1].age_s)
    assert values["vehicle_3_age_s"] == 0.0
    truth = truth_at(flight, report)[0]
    assert [values[name] for name in ("pos_n_m", "pos_e_m", "pos_d_m")] == pytest.approx(truth, abs=0.03)


def test_odometry_is_of_the_load_s_axes(flight) -> None:
    report = fly_through(flight, rig(flight), until_s=2.0).reports[-1]
    turned = rotations(np.array([[0.2, -0.4, 1.9]]))[0]
    cov = np.arange(36.0).reshape(6, 6)
    motion = replace(report.motion, ned_from_frd=turned, vel_ned_mps=turned @ np.array([1.0, 2.0, 3.0]), pose_cov=cov)
    assert isinstance(motion, LoadMotion)
    message = load_message.odometry(replace(report, motion=motion))
    assert (message.vx, message.vy, message.vz) == pytest.approx((1.0, 2.0, 3.0))
    w, x, y, z = message.q
    again = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert again == pytest.approx(turned)
    assert list(message.pose_covariance) == [cov[i, j] for i in range(6) for j in range(i, 6)]
    assert (message.frame_id, message.child_frame_id, message.quality) == (1, 12, 100)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_half_a_turn_has_a_quaternion(axis) -> None:
    unit = np.array(axis)
    w, *vector = quaternion_of(2.0 * np.outer(unit, unit) - np.eye(3))
    assert w == pytest.approx(0.0, abs=1e-9)
    assert np.abs(vector) == pytest.approx(np.abs(unit), abs=1e-9)
