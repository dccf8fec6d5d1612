"""PX4's side of the simulator interface: what arrives there, and what motor outputs do."""

import asyncio
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.errors import LinkOpenError
from swingd.sim import geodesy
from swingd.sim.hil.px4 import Px4Simulator, run_px4
from swingd.sim.hil.px4_battery import BATTERY_PORT
from swingd.sim.outlets import Outside

from .rigs import iris

ARMED = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
HOVER = 0.62
"""Throttle of each rotor that about carries vehicle and load."""
INSTANCE = 63
"""Of the tests of real sockets: away from the ports of whoever flies on this machine."""


def outputs(codec: Codec, rotors: Sequence[float], mode: int = ARMED) -> bytes:
    controls = [*rotors, *(0.0 for _ in range(16 - len(rotors)))]
    return codec.encode(mavlink.MAVLink_hil_actuator_controls_message(0, controls, mode, 1))


class Bench:
    """A simulator, and the messages that it sends."""

    def __init__(self, **simulation: Any) -> None:
        self.simulator = Px4Simulator(iris(**simulation))
        self.codec = Codec(1, 1)

    def fly(self, seconds: float, rotors: Sequence[float] | None = None) -> list[Any]:
        if rotors is not None:
            assert self.simulator.receive(outputs(self.codec, rotors))
        sent = b"".join(self.simulator.advance() for _ in range(round(seconds * 250)))
        return [frame.message for frame in self.codec.receive(sent)]


def of(messages: Iterable[Any], name: str) -> list[Any]:
    return [message for message in messages if message.get_type() == name]


def test_a_vehicle_that_stands_measures_gravity_field_and_pressure() -> None:
    messages = Bench().fly(2.0)
    sensors = of(messages, "HIL_SENSOR")
    assert [sensor.time_usec for sensor in sensors] == [4000 * (i + 1) for i in range(500)]
    last = sensors[-1]
    assert (last.xacc, last.yacc, last.zacc) == pytest.approx((0.0, 0.0, -9.80665), abs=0.01)
    assert (last.xgyro, last.ygyro, last.zgyro) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    slow = [sensor for sensor in sensors if sensor.fields_updated & 0b1_1100_0000]
    assert len(slow) == 100
    assert {sensor.fields_updated for sensor in sensors} == {0b111111, 0b1_1011_1111_1111}
    field = np.mean([[sensor.xmag, sensor.ymag, sensor.zmag] for sensor in slow], axis=0)
    assert field == pytest.approx((0.21475, 0.00797, 0.42817), abs=0.001), "nose to the north"
    heights = [44330.77 * (1.0 - (sensor.abs_pressure / 1013.25) ** 0.190263) for sensor in slow]
    assert np.mean(heights) == pytest.approx(geodesy.ALTITUDE_M, abs=0.1)


def test_fixes_come_ten_times_a_second_and_the_truth_fifty_times() -> None:
    messages = Bench().fly(2.1)
    fixes, states = of(messages, "HIL_GPS"), of(messages, "HIL_STATE_QUATERNION")
    assert len(fixes) == 20
    assert len(states) == 105
    for message in (fixes[-1], states[-1]):
        assert message.lat == pytest.approx(geodesy.LATITUDE_DEG * 1e7, abs=2)
        assert message.lon == pytest.approx(geodesy.LONGITUDE_DEG * 1e7, abs=2)
        assert message.alt == pytest.approx(geodesy.ALTITUDE_M * 1e3, abs=20)
    assert states[-1].attitude_quaternion == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-3)
    assert states[-1].zacc == pytest.approx(-1000, abs=2), "mG"


def test_a_fix_shows_the_motion_of_8_ms_before() -> None:
    bench = Bench()
    messages = bench.fly(3.0, [0.9] * 4)
    down_mps = {state.time_usec: state.vz for state in of(messages, "HIL_STATE_QUATERNION")}
    times = sorted(down_mps)
    fix = of(messages, "HIL_GPS")[-1]
    then = np.interp(fix.time_usec - 8_000, times, [down_mps[t] for t in times])
    now = np.interp(fix.time_usec, times, [down_mps[t] for t in times])
    assert fix.vd == pytest.approx(then, abs=2)
    assert abs(now - then) > 4, "cm/s; the vehicle gathers speed"


@pytest.mark.parametrize(
    ("rotors", "axis", "sign"),
    [
        ((0.55, 0.65, 0.65, 0.55), "rollspeed", 1.0),  # the left rotors lift: roll right
        ((0.65, 0.55, 0.65, 0.55), "pitchspeed", 1.0),  # the front rotors lift: nose up
        ((0.65, 0.65, 0.55, 0.55), "yawspeed", 1.0),  # the counter-clockwise rotors pull: nose right
    ],
)
def test_motor_outputs_are_numbered_as_px4_numbers_them(rotors: Sequence[float], axis: str, sign: float) -> None:
    bench = Bench()
    bench.simulator.plant.place((0.0, 0.0, -20.0), rotors=HOVER)
    state = of(bench.fly(0.1, rotors), "HIL_STATE_QUATERNION")[-1]
    rates = {name: getattr(state, name) for name in ("rollspeed", "pitchspeed", "yawspeed")}
    assert sign * rates[axis] > 0.1
    assert max(rates, key=lambda name: abs(rates[name])) == axis


def test_thrust_follows_arming_and_voltage() -> None:
    bench = Bench()
    bench.fly(0.5, [HOVER] * 4)
    full = bench.simulator.truth().thrust_n
    assert full > 10.0
    bench.simulator.voltage_v *= 0.9
    bench.fly(0.5)
    assert bench.simulator.truth().thrust_n == pytest.approx(0.81 * full, rel=0.01), "voltage exponent 2"
    bench.simulator.receive(outputs(bench.codec, [HOVER] * 4, mode=1))
    bench.fly(1.0)
    assert not bench.simulator.armed
    assert bench.simulator.truth().thrust_n == pytest.approx(0.0, abs=0.1)


def test_outputs_out_of_range_are_the_nearest_possible() -> None:
    bench = Bench()
    bench.fly(0.2, [math.nan, -3.0, 2.0, math.inf])
    assert bench.simulator.truth().rotor_commands == (0.0, 0.0, 1.0, 0.0)


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=400))
def test_bytes_of_a_link_never_raise(data: bytes) -> None:
    Px4Simulator(iris()).receive(data)


class Px4:
    """The autopilot's end of the simulator's connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self._codec = Codec(1, 1)

    @classmethod
    async def connect(cls) -> "Px4":
        async with asyncio.timeout(10.0):
            while True:
                try:
                    return cls(*await asyncio.open_connection("127.0.0.1", 4560 + INSTANCE))
                except OSError:
                    await asyncio.sleep(0.02)

    async def samples(self, seconds: float) -> int:
        """How many samples arrive within a time; -1: the connection was closed."""
        count = 0
        try:
            async with asyncio.timeout(seconds):
                while data := await self._reader.read(65536):
                    count += len(of((frame.message for frame in self._codec.receive(data)), "HIL_SENSOR"))
                return -1
        except TimeoutError:
            return count

    def answer(self) -> None:
        self._writer.write(outputs(self._codec, [0.2] * 4))

    async def close(self) -> None:
        self._writer.close()
        await self._writer.wait_closed()


@pytest.mark.live
async def test_it_waits_for_px4_sample_by_sample_and_takes_its_battery(tmp_path: Path) -> None:
    said: list[str] = []
    truth = tmp_path / "truth.csv"
    run = asyncio.create_task(run_px4(iris(), instance=INSTANCE, outside=Outside(truth_file=truth), say=said.append))
    px4 = await Px4.connect()
    assert await px4.samples(0.3) > 10, "while PX4 boots its clock must go on"
    px4.answer()
    await px4.samples(0.1)
    assert await px4.samples(0.3) == 0, "a sample that is not answered is the last"
    for _ in range(5):
        px4.answer()
        assert await px4.samples(0.05) == 1
    battery, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        asyncio.DatagramProtocol, remote_addr=("127.0.0.1", BATTERY_PORT + INSTANCE)
    )
    cells_mv = [3800, 3800, 3800, 3800, *(65535 for _ in range(6))]
    battery.sendto(Codec(1, 1).encode(mavlink.MAVLink_battery_status_message(0, 0, 0, 2000, cells_mv, -1, -1, -1, 50)))
    for _ in range(3):
        px4.answer()
        await px4.samples(0.05)
    with pytest.raises(LinkOpenError, match=str(4560 + INSTANCE)):
        await run_px4(iris(), instance=INSTANCE)
    await px4.close()
    battery.close()
    async with asyncio.timeout(5.0):
        simulator = await run
    assert simulator.voltage_v == pytest.approx(15.2)
    assert said[-1] == "PX4 closed the connection"
    stamps = [float(line.split(",")[0]) for line in truth.read_text().splitlines()[1:]]
    assert np.diff(stamps) == pytest.approx(0.008), "no gap in the simulated time"
