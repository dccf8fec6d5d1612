"""ArduPilot's side of the JSON interface: what it reads in the answers, and what its motor outputs do."""

import asyncio
import json
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.errors import LinkOpenError
from swingd.sim.hil.ardupilot import SILENCE_S, SIMULATOR_PORT, ArdupilotSimulator, run_ardupilot
from swingd.sim.hil.ardupilot_mavlink import MAVLINK_PORT
from swingd.sim.outlets import Outside

from .rigs import iris

HOVER = 1620
"""Pulse width of each rotor that about carries vehicle and load [us]."""
STOPPED = (1000, 1000, 1000, 1000)
INSTANCE = 63
"""Of the tests of real sockets: away from the ports of whoever flies on this machine."""


def outputs(frame: int, pulses_us: Sequence[int], rate_hz: int = 1200, channels: int = 16) -> bytes:
    """A packet of ArduPilot's motor outputs; what it does not drive is 0."""
    magic = {16: 18458, 32: 29569}[channels]
    return struct.pack(f"<HHI{channels}H", magic, rate_hz, frame, *pulses_us, *(0,) * (channels - len(pulses_us)))


class Bench:
    """A simulator, and an ArduPilot that asks it."""

    def __init__(self, rate_hz: int = 1200, **simulation: Any) -> None:
        self.simulator = ArdupilotSimulator(iris(**simulation))
        self.rate_hz = rate_hz
        self.frame = 0

    def ask(self, pulses_us: Sequence[int] = STOPPED, **packet: Any) -> dict[str, Any]:
        answer = self.simulator.receive(outputs(self.frame, pulses_us, self.rate_hz, **packet))
        assert answer is not None
        self.frame += 1
        fields: dict[str, Any] = json.loads(answer)
        return fields

    def fly(self, seconds: float, pulses_us: Sequence[int] = STOPPED) -> list[dict[str, Any]]:
        answers = []
        end = self.simulator.t_boot_s + seconds
        while self.simulator.t_boot_s < end - 1e-9:
            answers.append(self.ask(pulses_us))
        return answers


def test_a_vehicle_that_stands_feels_gravity_at_the_origin() -> None:
    last = Bench().fly(1.0)[-1]
    assert last["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -9.80665], abs=0.01)
    assert last["imu"]["gyro"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    assert last["position"] == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
    assert last["velocity"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    assert last["quaternion"] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-3), "nose to the north"


def test_the_answers_are_the_truth() -> None:
    bench = Bench()
    bench.simulator.plant.place((3.0, -2.0, -20.0), (1.0, 0.5, -0.2), yaw_rad=0.7, zeta_rad=0.4, rotors=0.6)
    last = bench.fly(0.5, (1640, 1600, 1610, 1620))[-1]
    truth = bench.simulator.truth()
    assert last["position"] == pytest.approx(truth.pos_ned_m)
    assert last["velocity"] == pytest.approx(truth.vel_ned_mps)
    assert last["quaternion"] == pytest.approx(truth.ned_from_frd)
    assert last["imu"]["accel_body"] == pytest.approx(truth.specific_force_frd_mps2)
    assert last["imu"]["gyro"] == pytest.approx(truth.rates_frd_radps, abs=0.01)
    assert last["battery"]["voltage"] == pytest.approx(bench.simulator.battery.voltage_v, abs=1e-4)


FOUND_BY_ARDUPILOT = [
    ("", "timestamp"),
    ("imu", "gyro"),
    ("imu", "accel_body"),
    ("", "position"),
    ("", "quaternion"),
    ("", "velocity"),
    ("", "no_time_sync"),
    ("battery", "voltage"),
]
NOT_SENT = [*(f"rng_{i}" for i in range(1, 7)), "rc", "windvane", "airspeed", "attitude", "latitude", "no_lockstep"]


def test_ardupilot_s_search_for_words_finds_the_same_as_a_json_parser() -> None:
    """It takes the first place where a section's name stands, the key's first behind it, numbers at a fixed offset."""
    simulator = ArdupilotSimulator(iris(acc_noise_mps2=0.1, gyro_noise_radps=0.01))
    for frame in range(50):
        answer = simulator.receive(outputs(frame, (1900, 1500, 1400, 1700)))
        assert answer is not None
        text = answer.decode("ascii")
        assert text.startswith("\n")
        assert text.endswith("\n")
        assert text.count("\n") == 2, "a line of its own"
        fields = json.loads(text)
        for section, key in FOUND_BY_ARDUPILOT:
            at = text.index(section) + len(section) + 1 if section else 1
            at = text.index(key, at) + len(key) + 2
            expected = fields[section][key] if section else fields[key]
            if isinstance(expected, list):
                body = re.match(r"\[([^]]*)\]", text[at:])
                assert body is not None
                assert [float(number) for number in body[1].split(", ")] == expected
            else:
                number = re.match(r"[-+0-9.e]+", text[at:])
                assert number is not None
                assert float(number[0]) == expected
        assert fields["no_time_sync"] == 1
        assert fields["no_time_sync"] is not True, "ArduPilot reads the word true as 0"
        assert not [word for word in NOT_SENT if word in text]


@pytest.mark.parametrize(
    ("rate_hz", "parts"), [(100, 1), (250, 1), (400, 2), (800, 4), (1000, 4), (1200, 5), (5000, 20), (65535, 20)]
)
def test_ardupilot_s_clock_is_the_truth_s_whatever_rate_it_asks_for(rate_hz: int, parts: int) -> None:
    """ArduPilot adds the time between answers to a clock of whole microseconds, and cuts what is over."""
    bench = Bench(rate_hz)
    clock_us, last_s = 0, 0.0
    for _ in range(600):
        stamp_s = bench.ask()["timestamp"]
        clock_us = int(clock_us + (stamp_s - last_s) * 1e6)
        last_s = stamp_s
        assert clock_us == round(bench.simulator.t_boot_s * 1e6)
    assert bench.simulator.t_boot_s == pytest.approx(600 * 0.004 / parts)
    assert bench.simulator.plant.t_s == pytest.approx(bench.simulator.t_boot_s)
    assert bench.simulator.steps == 600 // parts


@pytest.mark.parametrize(
    ("pulses_us", "axis", "sign"),
    [
        ((1550, 1650, 1650, 1550), 0, 1.0),  # the left rotors lift: roll right
        ((1650, 1550, 1650, 1550), 1, 1.0),  # the front rotors lift: nose up
        ((1650, 1650, 1550, 1550), 2, 1.0),  # the counter-clockwise rotors pull: nose right
    ],
)
def test_motors_are_numbered_as_copter_numbers_a_quad_x(pulses_us: Sequence[int], axis: int, sign: float) -> None:
    """Front right, rear left (both turn counter-clockwise), front left, rear right."""
    bench = Bench()
    bench.simulator.plant.place((0.0, 0.0, -20.0), rotors=0.6)
    rates = bench.fly(0.1, pulses_us)[-1]["imu"]["gyro"]
    assert sign * rates[axis] > 0.1
    assert int(np.argmax(np.abs(rates))) == axis


def test_thrust_follows_pulse_width_and_the_reported_voltage() -> None:
    bench = Bench(battery_full_v=16.2, battery_empty_v=14.2, battery_drain_s=100.0)
    bench.fly(0.5)
    assert not bench.simulator.spinning
    assert bench.simulator.truth().thrust_n == 0.0
    assert bench.simulator.battery.voltage_v == 16.2, "a pack drains while rotors turn"
    bench.fly(0.5, [HOVER] * 4)
    assert bench.simulator.spinning
    full = bench.simulator.truth().thrust_n
    assert full == pytest.approx(37.376 * 0.62**2 + 7.4752 * 0.62 + 0.37376, rel=0.01)
    assert bench.simulator.voltage_v == bench.simulator.battery.voltage_v == pytest.approx(16.19)
    bench.simulator.reported_v = 0.9 * bench.simulator.voltage_v
    bench.fly(0.5, [HOVER] * 4)
    assert bench.simulator.truth().thrust_n == pytest.approx(0.81 * full, rel=0.01), "voltage exponent 2"
    bench.fly(0.5)
    assert bench.simulator.truth().thrust_n == 0.0


def test_pulses_out_of_range_are_the_nearest_possible() -> None:
    bench = Bench()
    bench.ask((0, 900, 65535, 1500), channels=32)
    assert bench.simulator.truth().rotor_commands == (0.0, 0.0, 1.0, 0.5)


def test_a_repeated_frame_gets_the_same_answer_and_takes_no_time() -> None:
    bench = Bench(acc_noise_mps2=0.1)
    first = bench.simulator.receive(outputs(0, STOPPED))
    t_s = bench.simulator.t_boot_s
    assert bench.simulator.receive(outputs(0, STOPPED) * 3) == first
    assert bench.simulator.t_boot_s == t_s
    both = bench.simulator.receive(outputs(1, STOPPED) + outputs(2, STOPPED))
    assert both is not None
    assert json.loads(both)["timestamp"] == pytest.approx(3 * t_s, abs=1e-6), "datagrams that waited come joined"


def test_an_ardupilot_that_begins_anew_gets_no_answer() -> None:
    bench = Bench()
    bench.fly(0.1)
    assert not bench.simulator.late
    assert bench.simulator.receive(outputs(0, STOPPED)) is None
    assert bench.simulator.restarted
    assert bench.simulator.receive(outputs(1, STOPPED)) is None


def test_an_ardupilot_that_had_begun_with_another_simulation_is_noticed() -> None:
    simulator = ArdupilotSimulator(iris())
    assert simulator.receive(outputs(1234, STOPPED)) is not None
    assert simulator.late
    assert not simulator.restarted


def test_noise_keeps_its_density_whatever_the_rate() -> None:
    def deviations(rate_hz: int) -> Any:
        answers = Bench(rate_hz, acc_noise_mps2=0.1, gyro_noise_radps=0.01).fly(3.0)
        samples = np.array([[*answer["imu"]["accel_body"], *answer["imu"]["gyro"]] for answer in answers])
        per_step = len(samples) // 750
        return samples.reshape(750, per_step, 6).mean(axis=1)[125:].std(axis=0)

    for rate_hz in (250, 1200):
        assert deviations(rate_hz) == pytest.approx([0.1] * 3 + [0.01] * 3, rel=0.12)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=100), st.binary(min_size=38, max_size=38).map(b"\x1a\x48".__add__))))
def test_bytes_of_a_link_never_raise(datagrams: list[bytes]) -> None:
    simulator = ArdupilotSimulator(iris())
    for datagram in datagrams:
        simulator.receive(datagram)


class Ardupilot:
    """The autopilot's end: motor outputs over UDP, answered one by one, and MAVLink on SERIAL2."""

    def __init__(self) -> None:
        self.codec = Codec(8, 1)
        self.heard: list[Any] = []
        self.frame = -1
        self._answers: asyncio.Queue[bytes] = asyncio.Queue()
        self._writer: asyncio.StreamWriter | None = None

    async def __aenter__(self) -> "Ardupilot":
        queue = self._answers

        class Inbox(asyncio.DatagramProtocol):
            def datagram_received(self, data: bytes, _address: Any) -> None:
                queue.put_nowait(data)

        loop = asyncio.get_running_loop()
        self.udp, _ = await loop.create_datagram_endpoint(
            Inbox, remote_addr=("127.0.0.1", SIMULATOR_PORT + 10 * INSTANCE)
        )
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", MAVLINK_PORT + 10 * INSTANCE)
        return self

    async def __aexit__(self, *_: object) -> None:
        self.udp.close()
        if self._writer is not None:
            self._writer.close()
        self._server.close()
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        writer.write(self.codec.encode(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)))
        while data := await reader.read(4096):
            self.heard += [frame.message for frame in self.codec.receive(data) if frame.message is not None]

    def report(self, voltage_v: float) -> None:
        cells_mv = [round(1e3 * voltage_v), *(65535 for _ in range(9))]
        self.tell(mavlink.MAVLink_battery_status_message(0, 0, 0, 2000, cells_mv, -1, -1, -1, 50))

    def tell(self, message: Any) -> None:
        assert self._writer is not None
        self._writer.write(self.codec.encode(message))

    async def ask(self, frame: int | None = None) -> bytes:
        """Send the next frame, or this one; return the answer, or nothing within 0.2 s."""
        self.frame = self.frame + 1 if frame is None else frame
        self.udp.sendto(outputs(self.frame, STOPPED))
        try:
            async with asyncio.timeout(0.2):
                return await self._answers.get()
        except TimeoutError:
            return b""


@pytest.mark.live
async def test_it_answers_frame_by_frame_and_makes_ardupilot_report_its_battery(tmp_path: Path) -> None:
    said: list[str] = []
    truth = tmp_path / "truth.csv"
    parameters = iris(battery_full_v=15.9)
    async with asyncio.timeout(20.0), Ardupilot() as ardupilot:
        run = asyncio.create_task(
            run_ardupilot(parameters, instance=INSTANCE, outside=Outside(truth_file=truth), say=said.append)
        )
        while not await ardupilot.ask(0):
            pass
        with pytest.raises(LinkOpenError, match=str(SIMULATOR_PORT + 10 * INSTANCE)):
            await run_ardupilot(parameters, instance=INSTANCE)
        for _ in range(250):
            assert await ardupilot.ask()
        again = await ardupilot.ask(ardupilot.frame)
        assert json.loads(again)["timestamp"] == pytest.approx(251 * 0.0008, abs=1e-4)
        while not ardupilot.heard:
            assert await ardupilot.ask()
        request = ardupilot.heard.pop(0)
        assert (request.command, request.param1) == (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 147)
        for _ in range(5):
            ardupilot.report(12.6)
        while len(ardupilot.heard) < 3:
            assert await ardupilot.ask()
        assert [ardupilot.heard.pop(0).param_id for _ in range(2)] == ["FRAME_CLASS", "FRAME_TYPE"]
        change = ardupilot.heard.pop(0)
        assert (change.target_system, change.param_id) == (8, "SIM_BATT_VOLTAGE")
        assert change.param_value == pytest.approx(15.9)
        for _ in range(20):
            ardupilot.report(15.89)
        for _ in range(20):
            assert await ardupilot.ask()
        assert ardupilot.heard == [], "near enough"
        for frame_type, warnings in ((1.0, 0), (0.0, 1), (0.0, 1)):
            ardupilot.tell(mavlink.MAVLink_param_value_message(b"FRAME_TYPE", frame_type, 2, 1000, 65535))
            for _ in range(20):
                assert await ardupilot.ask()
            assert len([text for text in said if "FRAME_TYPE" in text]) == warnings
        assert await ardupilot.ask(0) == b""
        simulator = await run
    assert simulator.voltage_v == pytest.approx(15.89)
    assert said[1] == "ArduPilot is there"
    assert said[-1] == "ArduPilot began anew: start the simulation anew as well"
    stamps = [float(line.split(",")[0]) for line in truth.read_text().splitlines()[1:]]
    assert stamps[0] == 0.004
    assert np.diff(stamps) == pytest.approx(0.008), "no gap in the simulated time"


@pytest.mark.live
async def test_silence_is_told_of_once_and_waited_through() -> None:
    said: list[str] = []
    async with asyncio.timeout(20.0), Ardupilot() as ardupilot:
        run = asyncio.create_task(run_ardupilot(iris(speed=100.0), instance=INSTANCE, duration_s=0.02, say=said.append))
        while not await ardupilot.ask(0):
            pass
        await asyncio.sleep(2.2 * SILENCE_S)
        assert [text for text in said if "silent" in text] == [
            "ArduPilot has been silent for 1 s of real time at 0.0 s"
        ]
        while not run.done():
            await ardupilot.ask()
        assert (await run).t_boot_s == pytest.approx(0.02)
