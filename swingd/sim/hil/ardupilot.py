"""ArduPilot's external simulator: the JSON interface over UDP, in lockstep with ArduPilot's clock."""

import asyncio
from collections.abc import Callable, Sequence
from struct import Struct

from swingd.core.slung_plant import PlantState
from swingd.link.transport import open_transport
from swingd.model.errors import LinkOpenError
from swingd.model.events import Vec3
from swingd.model.parameters import Parameters
from swingd.sim.hil.ardupilot_mavlink import ArdupilotMavlink
from swingd.sim.hil.sensors import Imu
from swingd.sim.outlets import Outside, open_outlets
from swingd.sim.pace import Pace
from swingd.sim.plant import DT_S, Plant, Rotors, Truth
from swingd.sim.sensors import Battery

SIMULATOR_PORT = 9002
"""UDP port on which ArduPilot's instance 0 looks for its simulator; instance N looks at this + 10 N."""
SILENCE_S = 1.0
"""Real time after which an ArduPilot that asks for nothing is told of."""

_STEP_US = round(DT_S * 1e6)
_PARTS = tuple(parts for parts in range(1, 21) if _STEP_US % parts == 0)
"""Into how many equal parts of whole microseconds a step of the plant can be cut."""
_HEADER = Struct("<HHI")  # magic, frames per second, number of the frame
_CHANNELS = {18458: Struct("<16H"), 29569: Struct("<32H")}  # by magic: pulse widths [us]
# ArduPilot cuts the time between two answers to whole microseconds; a tenth more is what the cut may take.
_OVERTIME_US = 0.1


class ArdupilotSimulator:
    """Vehicle, load and IMU as ArduPilot sees them, without I/O.

    Parameters
    ----------
    parameters : Parameters
        ``vehicle``, ``payload``, ``cable``, ``thrust`` and ``simulation``. ``thrust.motor_output_min`` and
        ``motor_output_max`` are the pulse widths of no and full throttle.

    Raises
    ------
    ConfigurationError
        If the cable cannot be simulated.

    Notes
    -----
    ArduPilot says how often a second it wants to be answered (SIM_RATE_HZ, 1200); the answers come that often or a
    little more often, by equal parts of 4 ms. It makes GNSS, barometer, compass and their errors for itself, from the
    true motion; the IMU's noise, bias and vibration are those of ``simulation``.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.plant = Plant(parameters)
        """The truth."""
        self.battery = Battery(parameters.simulation)
        """The pack; it drains while the rotors turn."""
        self.reported_v: float | None = None
        """Voltage that ArduPilot reports [V]; the thrust follows it where it is known, else the pack's."""
        self._imu = Imu(parameters.simulation, self.plant)
        self._stopped_us = parameters.thrust.motor_output_min
        self._range_us = parameters.thrust.motor_output_max - parameters.thrust.motor_output_min
        self._spinning = False
        self._now_us = 0
        self._parts = 1
        self._answers = 0
        self._answer = b""
        self._frame: int | None = None
        self._late = False
        self._restarted = False

    @property
    def t_boot_s(self) -> float:
        """Simulated time [s]; it is ArduPilot's clock."""
        return 1e-6 * self._now_us

    @property
    def steps(self) -> int:
        """Whole steps of `DT_S` that are over."""
        return self._now_us // _STEP_US

    @property
    def spinning(self) -> bool:
        """Whether ArduPilot drives the motors: it is armed, or tests them."""
        return self._spinning

    @property
    def voltage_v(self) -> float:
        """Voltage that the thrust follows [V]."""
        return self.battery.voltage_v if self.reported_v is None else self.reported_v

    @property
    def late(self) -> bool:
        """Whether this ArduPilot had begun with another simulation, so that its clock is not the one of the truth."""
        return self._late

    @property
    def restarted(self) -> bool:
        """Whether ArduPilot began anew; nothing is answered from then on."""
        return self._restarted

    def truth(self) -> Truth:
        """Describe the present instant, stamped with ArduPilot's clock."""
        return self.plant.truth(self.t_boot_s)

    def receive(self, data: bytes) -> bytes | None:
        """Take one or more datagrams from ArduPilot, fly as they ask, and return the last one's answer; never raises.

        A frame that comes once more, because its answer was late or lost, gets the same answer and takes no time.
        Nothing is answered to what is not from ArduPilot, and nothing to an ArduPilot that began anew.
        """
        answer = None
        while len(data) >= _HEADER.size:
            magic, rate_hz, frame = _HEADER.unpack_from(data)
            channels = _CHANNELS.get(magic)
            size = _HEADER.size + (channels.size if channels else 0)
            if channels is None or len(data) < size:
                break
            answer = self._fly(rate_hz, frame, channels.unpack_from(data, _HEADER.size)[:4])
            data = data[size:]
        return answer

    def _fly(self, rate_hz: int, frame: int, pulses_us: tuple[int, ...]) -> bytes | None:
        if self._frame is None:
            self._late = frame > 0
        elif frame == self._frame:
            return self._answer
        elif frame < self._frame:
            self._restarted = True
        if self._restarted:
            return None
        self._frame = frame
        if self._now_us % _STEP_US == 0:
            self._parts = next((parts for parts in _PARTS if parts >= DT_S * rate_hz), _PARTS[-1])
        dt_s = DT_S / self._parts
        front_right, rear_left, front_left, rear_right = (
            min(max((pulse - self._stopped_us) / self._range_us, 0.0), 1.0) for pulse in pulses_us
        )
        rotors: Rotors = (front_right, rear_left, front_left, rear_right)
        self._spinning = any(throttle > 0.0 for throttle in rotors)
        self.battery.step(dt_s, armed=self._spinning)
        self.plant.step(rotors, self.voltage_v, spinning=self._spinning, dt_s=dt_s)
        self._now_us += _STEP_US // self._parts
        self._answers += 1
        self._answer = self._tell(*self._imu.read(dt_s))
        return self._answer

    def _tell(self, acc: Vec3, gyro: Vec3) -> bytes:
        # ArduPilot's parser looks for the keys as text, wants numbers for truth values and a line of its own.
        x, s = self.plant.state, PlantState
        stamp_s = 1e-6 * (self._now_us + _OVERTIME_US * self._answers)
        return (
            f'\n{{"timestamp":{stamp_s:.7f},'
            f'"imu":{{"gyro":{_array(gyro)},"accel_body":{_array(acc)}}},'
            f'"position":{_array(x[s.POS : s.POS + 3])},'
            f'"quaternion":{_array(x[s.QUAT : s.QUAT + 4])},'
            f'"velocity":{_array(x[s.VEL : s.VEL + 3])},'
            f'"battery":{{"voltage":{self.battery.voltage_v:.4f}}},'
            '"no_time_sync":1}\n'
        ).encode("ascii")


def _array(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"


async def run_ardupilot(
    parameters: Parameters,
    *,
    instance: int = 0,
    host: str = "127.0.0.1",
    outside: Outside | None = None,
    duration_s: float | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> ArdupilotSimulator:
    """Be the simulator of one ArduPilot SITL until that begins anew or ``duration_s`` of simulated time have passed.

    Parameters
    ----------
    parameters : Parameters
        ``simulation.speed`` is the simulated over the real time; ArduPilot's clock follows the simulated one, and
        SIM_SPEEDUP has no effect.
    instance : int
        ArduPilot's instance number, which shifts its ports.
    host : str
        Address to listen on.
    outside : Outside, optional
        What is shown and heard while it runs.
    duration_s : float, optional
        Simulated time to run from ArduPilot's first frame on [s].
    say : callable
        Gets a line of text when something happens that an operator wants to know.

    Returns
    -------
    ArdupilotSimulator
        In its last state.

    Raises
    ------
    LinkOpenError
        If the simulator's port is in use.
    ConfigurationError
        If the vehicle cannot be simulated.

    Notes
    -----
    Lockstep: ArduPilot waits for each answer, so that a slow machine makes a slow flight and not another one. The end
    of an ArduPilot cannot be seen, only its silence, which is waited through.
    """
    simulator = ArdupilotSimulator(parameters)
    answer = b""
    asked = asyncio.Event()

    def on_data(_peer: int, data: bytes) -> None:
        nonlocal answer
        due = simulator.receive(data)
        if due is not None:
            answer = due
        if due is not None or simulator.restarted:
            asked.set()

    url = f"udpin://{host}:{SIMULATOR_PORT + 10 * instance}"
    link = await open_transport(url, on_data)
    mavlink = ArdupilotMavlink()
    try:
        async with open_outlets(simulator.plant, outside or Outside()) as outlets:
            say(f"waiting for ArduPilot on {url}")
            await asked.wait()
            say("ArduPilot is there")
            if simulator.late:
                say("ArduPilot had begun with another simulation: its clock is not the truth's; start it anew")
            try:
                await mavlink.open(instance, link.peer_name(0).rpartition(":")[0])
            except LinkOpenError as error:
                say(f"ArduPilot may report another voltage than the simulation's: {error}")
            pace = Pace(parameters.simulation.speed)
            shown, silent, warned = 0, False, False
            while duration_s is None or shown < round(duration_s / DT_S):
                try:
                    async with asyncio.timeout(SILENCE_S):
                        await asked.wait()
                except TimeoutError:
                    if not silent:
                        say(f"ArduPilot has been silent for {SILENCE_S:g} s of real time at {simulator.t_boot_s:.1f} s")
                    silent = True
                    continue
                silent = False
                asked.clear()
                if simulator.restarted:
                    say("ArduPilot began anew: start the simulation anew as well")
                    break
                link.send(answer)
                if simulator.steps > shown:
                    shown = simulator.steps
                    simulator.reported_v = mavlink.voltage_v
                    mavlink.wanted_v = simulator.battery.voltage_v
                    mavlink.ask(simulator.t_boot_s)
                    if mavlink.other_frame and not warned:
                        say("ArduPilot does not fly a quad x: set FRAME_CLASS and FRAME_TYPE to 1 and start both anew")
                        warned = True
                    outlets.after_step(simulator.truth)
                    await pace.due()
    finally:
        await mavlink.close()
        await link.close()
    return simulator
