"""PX4's external simulator: HIL sensor messages against motor outputs over TCP, in lockstep with PX4's clock."""

import asyncio
from collections.abc import Callable
from math import hypot, isfinite
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slung_plant import PlantOutput, PlantState
from swingd.link.codec import Codec
from swingd.link.transport import open_transport
from swingd.model.errors import LinkOpenError
from swingd.model.events import Vec3
from swingd.model.parameters import Parameters
from swingd.sim import geodesy
from swingd.sim.hil.px4_battery import Px4Battery
from swingd.sim.hil.sensors import TEMPERATURE_C, Air, Fix, RawSensors
from swingd.sim.outlets import Outside, open_outlets
from swingd.sim.pace import Pace
from swingd.sim.plant import DT_S, Plant, Rotors, Truth

SIMULATOR_PORT = 4560
"""TCP port on which PX4's instance 0 looks for its simulator; instance N looks at this + N."""
ANSWER_TIMEOUT_S = 1.0
"""Real time after which a PX4 that does not answer a sample gets the next one all the same."""

_SYSTEM_ID, _COMPONENT_ID = 1, 51  # as other simulators; PX4 does not look
_STEP_US = round(DT_S * 1e6)
_TRUTH_STEPS = 5
_HEARTBEAT_STEPS = 250
_INERTIAL = 0b111_111
_AIR = 0b1_1011_1100_0000  # magnetometer, absolute pressure, pressure altitude, temperature


def _throttle(output: float) -> float:
    """A motor output within 0..1; what is not a number drives nothing."""
    return min(max(output, 0.0), 1.0) if isfinite(output) else 0.0


class Px4Simulator:
    """Vehicle, load and sensors as PX4 sees them, without I/O.

    Parameters
    ----------
    parameters : Parameters
        ``vehicle``, ``payload``, ``cable``, ``thrust`` and ``simulation``.

    Raises
    ------
    ConfigurationError
        If the cable cannot be simulated.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.plant = Plant(parameters)
        """The truth."""
        self.voltage_v = parameters.thrust.voltage_nominal_v
        """Of the pack [V]; the thrust follows it."""
        self._sensors = RawSensors(parameters.simulation, self.plant)
        self._codec = Codec(_SYSTEM_ID, _COMPONENT_ID)
        self._rotors: Rotors = (0.0, 0.0, 0.0, 0.0)
        self._armed = False
        self._steps = 0

    @property
    def t_boot_s(self) -> float:
        """Simulated time [s]; it is PX4's clock."""
        return self._steps * DT_S

    @property
    def armed(self) -> bool:
        """Whether PX4 drives the motors."""
        return self._armed

    def truth(self) -> Truth:
        """Describe the present instant, stamped with PX4's clock."""
        return self.plant.truth(self.t_boot_s)

    def advance(self) -> bytes:
        """Fly 4 ms with the motor outputs received last; return the messages about the instant after."""
        self._steps += 1
        self.plant.step(self._rotors, self.voltage_v, spinning=self._armed)
        readings = self._sensors.read()
        messages = [self._inertial(readings.acc_frd_mps2, readings.gyro_frd_radps, readings.air)]
        if readings.gnss is not None:
            messages.append(self._gnss(readings.gnss))
        if self._steps % _TRUTH_STEPS == 0:
            messages.append(self._state())
        if self._steps % _HEARTBEAT_STEPS == 1:
            messages.append(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )
        return b"".join(map(self._codec.encode, messages))

    def receive(self, data: bytes) -> bool:
        """Take bytes from PX4; True if motor outputs were among them. Never raises."""
        answered = False
        for frame in self._codec.receive(data):
            if frame.msg_id != mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS or frame.message is None:
                continue
            answered = True
            self._armed = bool(frame.message.mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            front_right, rear_left, front_left, rear_right = map(_throttle, frame.message.controls[:4])
            self._rotors = (front_right, rear_left, front_left, rear_right)
        return answered

    @property
    def _now_us(self) -> int:
        return self._steps * _STEP_US

    def _inertial(self, acc: Vec3, gyro: Vec3, air: Air | None) -> Any:
        slow, fields = (0.0,) * 7, _INERTIAL
        if air is not None:
            slow = (*air.field_frd_gauss, air.pressure_hpa, 0.0, air.altitude_m, TEMPERATURE_C)
            fields |= _AIR
        return mavlink.MAVLink_hil_sensor_message(self._now_us, *acc, *gyro, *slow, fields)

    def _gnss(self, fix: Fix) -> Any:
        vn, ve, vd = fix.vel_ned_mps
        return mavlink.MAVLink_hil_gps_message(
            self._now_us,
            3,
            round(fix.latitude_deg * 1e7),
            round(fix.longitude_deg * 1e7),
            round(fix.altitude_m * 1e3),
            80,
            80,
            round(100.0 * hypot(vn, ve)),
            round(100.0 * vn),
            round(100.0 * ve),
            round(100.0 * vd),
            0xFFFF,
            12,
        )

    def _state(self) -> Any:
        """The vehicle's truth, which PX4 logs beside its estimates."""
        x, y, s = self.plant.state, self.plant.output, PlantState
        latitude_deg, longitude_deg, altitude_m = geodesy.global_of((x[s.POS], x[s.POS + 1], x[s.POS + 2]))
        return mavlink.MAVLink_hil_state_quaternion_message(
            self._now_us,
            x[s.QUAT : s.QUAT + 4],
            *x[s.RATE : s.RATE + 3],
            round(latitude_deg * 1e7),
            round(longitude_deg * 1e7),
            round(altitude_m * 1e3),
            *(round(100.0 * v) for v in x[s.VEL : s.VEL + 3]),
            0,
            0,
            *(round(y[PlantOutput.SPECIFIC_FORCE + i] / (1e-3 * GRAVITY_MPS2)) for i in range(3)),
        )


async def run_px4(
    parameters: Parameters,
    *,
    instance: int = 0,
    host: str = "127.0.0.1",
    outside: Outside | None = None,
    duration_s: float | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Px4Simulator:
    """Be the simulator of one real PX4 until it closes the connection or ``duration_s`` of simulated time have passed.

    Parameters
    ----------
    parameters : Parameters
        ``simulation.speed`` is the simulated over the real time; PX4's clock follows the simulated one.
    instance : int
        PX4's instance number, which shifts its ports.
    host : str
        Address to listen on.
    outside : Outside, optional
        What is shown and heard while it runs.
    duration_s : float, optional
        Simulated time to run from PX4's connection on [s].
    say : callable
        Gets a line of text when something happens that an operator wants to know.

    Returns
    -------
    Px4Simulator
        In its last state.

    Raises
    ------
    LinkOpenError
        If the simulator's port is in use.
    ConfigurationError
        If the vehicle cannot be simulated.

    Notes
    -----
    Lockstep: from PX4's first motor outputs on, a sample goes out when the one before was answered, so that a slow
    machine makes a slow flight and not another one. The pack's voltage is the one that PX4 itself reports.
    """
    simulator = Px4Simulator(parameters)
    present, answered = asyncio.Event(), asyncio.Event()
    # PX4 starts its outputs late in its boot; until then nothing answers, and its clock must go on.
    gone = in_step = False

    def on_peer(_peer: int, here: bool) -> None:
        nonlocal gone
        present.set()
        gone = gone or not here
        answered.set()

    def on_data(_peer: int, data: bytes) -> None:
        nonlocal in_step
        if simulator.receive(data):
            in_step = True
            answered.set()

    url = f"tcpin://{host}:{SIMULATOR_PORT + instance}"
    link = await open_transport(url, on_data, on_peer=on_peer, queue_bytes=1 << 16)
    battery = Px4Battery()
    try:
        async with open_outlets(simulator.plant, outside or Outside()) as outlets:
            say(f"waiting for PX4 on {url}")
            await present.wait()
            say("PX4 is there")
            try:
                await battery.open(instance)
            except LinkOpenError as error:
                say(f"the battery's voltage stays {simulator.voltage_v:g} V: {error}")
            pace = Pace(parameters.simulation.speed)
            while not gone and (duration_s is None or simulator.t_boot_s < duration_s - 0.5 * DT_S):
                await pace.due()
                answered.clear()
                if battery.voltage_v is not None:
                    simulator.voltage_v = battery.voltage_v
                link.send(simulator.advance())
                outlets.after_step(simulator.truth)
                battery.ask(simulator.t_boot_s)
                if not in_step:
                    continue
                try:
                    async with asyncio.timeout(ANSWER_TIMEOUT_S):
                        await answered.wait()
                except TimeoutError:
                    say(f"PX4 did not answer for {ANSWER_TIMEOUT_S:g} s of real time at {simulator.t_boot_s:.1f} s")
            if gone:
                say("PX4 closed the connection")
    finally:
        await battery.close()
        await link.close()
    return simulator
