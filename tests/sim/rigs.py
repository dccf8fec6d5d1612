"""Vehicles and rigs that the tests of the simulator share."""

import copy
import copyreg
import functools
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.parameters import Cable, Parameters, Payload, SimulatedKind, Simulation, Thrust, Vehicle
from swingd.sim.lockstep import Lockstep
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import DT_S, Truth

# Lets a flight be copied: pymavlink's packer keeps compiled formats.
copyreg.pickle(struct.Struct, lambda compiled: (struct.Struct, (compiled.format,)))  # type: ignore[arg-type]

QUIET: dict[str, Any] = {
    "acc_noise_mps2": 0.0,
    "gyro_noise_radps": 0.0,
    "acc_bias_mps2": 0.0,
    "attitude_noise_rad": 0.0,
    "gnss_vel_noise_mps": 0.0,
    "gnss_pos_noise_m": 0.0,
}


def iris(load_kg: float = 0.3, length_m: float = 1.5, **simulation: Any) -> Parameters:
    """The 1.5 kg quadrotor that PX4 v1.16 was measured on, without noise."""
    return Parameters(
        vehicle=Vehicle(mass_kg=1.5, drag_n_per_mps=0.35, drag_vertical_n_per_mps=0.1),
        payload=Payload(mass_kg=load_kg),
        cable=Cable(length_m=length_m),
        thrust=Thrust(quadratic_n=37.376, linear_n=7.4752, offset_n=0.37376),
        simulation=Simulation(
            vehicle_inertia_kg_m2=(0.029125, 0.029125, 0.055225), arm_m=0.2555, **{**QUIET, **simulation}
        ),
    )


def with_vehicle(parameters: Parameters, **changes: Any) -> Parameters:
    return replace(parameters, vehicle=replace(parameters.vehicle, **changes))


def as_copter(parameters: Parameters) -> Parameters:
    """The same vehicle behind Copter's face."""
    return replace(parameters, simulation=replace(parameters.simulation, autopilot=SimulatedKind.ARDUPILOT))


def copter_sitl(load_kg: float, length_m: float) -> Parameters:
    """The 3 kg quadrotor of ArduPilot's SITL with a load, without noise."""
    parameters = iris(load_kg, length_m)
    return as_copter(
        replace(
            parameters,
            vehicle=replace(parameters.vehicle, mass_kg=3.0),
            thrust=Thrust(quadratic_n=82.0, linear_n=16.5, offset_n=0.8),
            simulation=replace(parameters.simulation, vehicle_inertia_kg_m2=(0.064, 0.064, 0.121)),
        )
    )


def velocity(
    north: float, east: float, *, down_m: float | None = -8.0, acc: tuple[float, float] | None = None, yaw: float = 0.0
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED: horizontal velocity, altitude held, optional acceleration."""
    mask = 1 | 2 | 32 | 256 | 2048
    if down_m is None:
        mask |= 4
    if acc is None:
        mask |= 64 | 128
    a = acc or (0.0, 0.0)
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, mask, 0.0, 0.0, down_m or 0.0, north, east, 0.0, a[0], a[1], 0.0, yaw, 0.0
    )


class Application:
    """A companion in lockstep: sends commands at once and setpoints at 50 Hz, keeps the frames that come."""

    def __init__(
        self, parameters: Parameters, autopilot_parameters: dict[str, float] | None = None, **options: Any
    ) -> None:
        self.peer = SimulatedAutopilot(parameters, autopilot_parameters, **options)
        self.codec = Codec(1, 191)
        self.ground = Codec(255, 190)
        self.setpoint: Callable[[float], Any] | None = None
        self.messages: list[tuple[float, Any]] = []
        self.truths: list[Truth] = []
        self.keep = False
        self._out: list[Any] = []
        self._steps = 0
        self.lockstep = Lockstep(self.peer, self._companion)

    def _companion(self, t_s: float, data: bytes) -> bytes:
        self._steps += 1
        if self.keep:
            self.messages += [(t_s, frame.message) for frame in self.codec.receive(data)]
        self.truths.append(self.peer.truth())
        messages, self._out = self._out, []
        if self.setpoint is not None and self._steps % 5 == 0:
            messages.append(self.setpoint(t_s))
        return b"".join(self.codec.encode(message) for message in messages)

    @property
    def t_s(self) -> float:
        return self.peer.t_s

    def send(self, *messages: Any) -> None:
        self._out += messages

    def command(self, command: int, *params: float) -> None:
        p = [*params, *([0.0] * (7 - len(params)))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *p))

    def run(self, duration_s: float) -> list[Truth]:
        """Fly on and return the truth of each step."""
        self.truths = []
        self.lockstep.run_until(self.t_s + duration_s)
        return self.truths

    def acks(self) -> dict[int, list[int]]:
        """Results of the commands that were answered while ``keep`` was set."""
        out: dict[int, list[int]] = {}
        for _, message in self.messages:
            if message.get_type() == "COMMAND_ACK":
                out.setdefault(message.command, []).append(message.result)
        return out

    def of_type(self, name: str) -> list[Any]:
        return [message for _, message in self.messages if message.get_type() == name]

    def take_off(self) -> None:
        """Climb to MIS_TAKEOFF_ALT, 8 m, and come to rest."""
        self.run(0.5)
        self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, float("nan"))
        self.run(18.0)

    def offboard(self, setpoint: Callable[[float], Any] | None = None) -> None:
        """Enter OFFBOARD at rest."""
        self.setpoint = setpoint or (lambda t_s: velocity(0.0, 0.0))
        self.run(0.2)
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6, 0)
        self.run(0.1)

    def take_off_guided(self, height_m: float = 8.0) -> None:
        """Copter: climb in GUIDED and come to rest."""
        self.run(0.5)
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
        self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self.run(0.1)
        self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
        self.run(10.0 + height_m)


@functools.cache
def _in_the_air(parameters: Parameters, released: bool) -> Application:
    app = Application(parameters)
    if released:
        app.peer.plant.release()
    app.take_off()
    app.truths = []
    return app


def in_the_air(parameters: Parameters, *, released: bool = False) -> Application:
    """A flight of its own that has taken off, without a load where it was released before; flown once for all."""
    return copy.deepcopy(_in_the_air(parameters, released))


def steps(duration_s: float) -> int:
    return round(duration_s / DT_S)
