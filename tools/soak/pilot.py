"""Who flies: sorties of random manoeuvres, with random wind, loads and faults."""

import math
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.model.parameters import Mode
from swingd.sim.autopilot import NavState
from swingd.sim.faults import Fault

from .flight import Flight

Program = Generator[float, None, None]
"""Yields how long it wants to wait [s]."""

FAULT_PROBABILITY = 0.35
"""Of at least one fault in the course of a manoeuvre."""
FAULT_S = (0.1, 10.0)
STRENGTHS: Mapping[str, tuple[float, float] | None] = {
    "loss": (0.02, 0.6),
    "gap": None,
    "duplicate": (0.1, 1.0),
    "reorder": (0.05, 1.0),
    "jitter": (0.02, 0.5),
    "delay": (0.02, 0.4),
    "corrupt": (0.01, 0.5),
    "nan": (0.01, 0.5),
    "clock": (-60.0, 60.0),
    "imu_frozen": None,
    "acc_bias": (-1.0, 1.0),
    "vibration": (3.0, 40.0),
    "voltage": (0.0, 40.0),
    "voltage_frozen": None,
    "sag": (0.02, 0.15),
    "attitude": (-0.2, 0.2),
    "yaw": (-1.5, 1.5),
    "reboot": None,
    "gust": (2.0, 12.0),
    "slack": (0.5, 4.0),
    "power": (0.05, 0.3),
    "rival": (-1.0, 1.0),
    "flood": (10.0, 1000.0),
}
"""Every kind of fault, from hardly felt to beyond what the vehicle survives."""
RARE = ("reboot",)
"""Drawn a fifth as often: each one ends the sortie on the ground."""

FAR_M = 150.0
LOW_M, HIGH_M = 3.5, 15.0
UPSIDE = math.cos(math.radians(70.0))
LOITER_OF_COPTER, LAND_TIMEOUT_S = 5.0, 60.0
VEL_MASK = 0b0000_1101_1100_0111
POS_MASK = 0b0000_1101_1111_1000
YAW_IGNORED = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE


class GroundedError(Exception):
    """The sortie has ended otherwise than by the pilot's will."""


class Pilot:
    """Flies without end; deterministic by its seed.

    Parameters
    ----------
    flight : Flight
        What it flies.
    seed : int
        Of its decisions.
    """

    def __init__(self, flight: Flight, seed: int) -> None:
        self.flight = flight
        self.manoeuvres: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self._random = np.random.default_rng((seed, 11))
        self._yaw_rad: float | None = None
        self._program = self._sorties()
        self._due_s = 0.0
        kinds = list(STRENGTHS)
        weights = np.array([0.2 if kind in RARE else 1.0 for kind in kinds])
        self._kinds, self._weights = kinds, weights / weights.sum()
        flight.on_step = self.step

    def step(self, t_s: float) -> None:
        """Do what is due."""
        while t_s >= self._due_s - 1e-9:
            self._due_s = t_s + max(next(self._program), 0.004)

    # ---- a sortie

    def _sorties(self) -> Program:
        yield 3.0
        while True:
            try:
                yield from self._take_off()
                for _ in range(self._whole(6, 25)):
                    yield from self._manoeuvre()
                yield from self._land()
                self.manoeuvres["landing"] += 1
            except GroundedError as why:
                self.manoeuvres[f"sortie ended: {why}"] += 1
            yield from self._prepare()

    def _take_off(self) -> Program:
        flight, plant = self.flight, self.flight.peer.plant
        flight.sorties += 1
        mode = Mode.HOLD if self._random.random() < 0.3 else Mode.INLINE
        if mode is not flight.engine.parameters.mode:
            flight.change(replace(flight.engine.parameters, mode=mode))
        height_m = flight.parameters.simulation.takeoff_altitude_m
        self._yaw_rad = None
        if flight.is_copter:
            self._set_mode(4.0)
            flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            yield 0.2
            flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m)
        else:
            flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, *(math.nan for _ in range(4)))
            flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        yield 0.5
        yield from self._while(lambda: -plant.state[2] < 0.9 * height_m, 30.0)
        yield from self._wait(3.0)
        flight.connect(self._whole(0, 4), 240)
        self._ask_velocity(0.0, 0.0)
        yield from self._wait(1.0)
        yield from self._offboard()

    def _land(self) -> Program:
        flight = self.flight
        flight.peer.faults.clear()
        flight.command(mavlink.MAV_CMD_NAV_LAND)
        autopilot = flight.peer.autopilot
        end_s = flight.t_s + LAND_TIMEOUT_S
        while autopilot.armed and flight.t_s < end_s:
            yield 0.1
        if autopilot.armed:
            raise GroundedError("no landing")

    def _prepare(self) -> Program:
        """On the ground: applications go, the weather calms down, and what lies wrongly is set up anew."""
        flight, plant, autopilot = self.flight, self.flight.peer.plant, self.flight.peer.autopilot
        flight.disconnect()
        flight.peer.faults.clear()
        plant.set_wind((0.0, 0.0, 0.0))
        plant.set_gusts(0.0)
        flight.switch_correction(True)
        flight.change(replace(flight.parameters, mode=flight.engine.parameters.mode))
        end_s = flight.t_s + 10.0
        while -plant.state[2] > 0.3 and not autopilot.armed and flight.t_s < end_s:
            yield 0.1
        if autopilot.armed or self._is_lost() or self._far_m() > 60.0:
            autopilot.disarm(force=True)
            yield 0.1
            plant.place((0.0, 0.0, -0.05))
            flight.peer.reboot()
            yield 5.0
        plant.set_load_mass(flight.parameters.payload.mass_kg)
        plant.set_cable_length(flight.parameters.cable.length_m)
        plant.hook()
        yield self._between(2.0, 20.0)

    # ---- waiting

    def _wait(self, duration_s: float) -> Program:
        yield from self._while(lambda: True, duration_s)

    def _while(self, condition: Callable[[], bool], at_most_s: float) -> Program:
        end_s = self.flight.t_s + at_most_s
        while condition() and self.flight.t_s < end_s - 1e-6:
            yield min(0.1, end_s - self.flight.t_s)
            if not self.flight.peer.autopilot.armed:
                raise GroundedError("disarmed")
            if self._is_lost():
                raise GroundedError("lost control")

    def _far_m(self) -> float:
        north, east = self.flight.peer.plant.state[:2]
        return math.hypot(north, east)

    def _is_lost(self) -> bool:
        """Upside down, or beyond where anybody would fly."""
        state = self.flight.peer.plant.state
        w, x, y, z = self.flight.peer.truth().ned_from_frd
        upright = w * w - x * x - y * y + z * z > UPSIDE
        return not (all(map(math.isfinite, state[:13])) and upright and self._far_m() < FAR_M and -state[2] < 60.0)

    # ---- manoeuvres

    def _manoeuvre(self) -> Program:
        flight = self.flight
        if self._random.random() < FAULT_PROBABILITY:
            for _ in range(1 + int(self._random.geometric(0.7)) // 2):
                self._inject()
        if not flight.follows:
            yield from self._offboard()
        offered: dict[str, tuple[float, Callable[[], Program]]] = {
            "velocity": (6.0, self._velocity),
            "yaw": (1.5, self._yaw),
            "kick": (1.0, self._kick),
            "wind": (1.0, self._wind),
            "silence": (1.0, self._silence),
            "rate": (0.7, self._rate),
            "correction off": (0.7, self._switch),
            "other mode": (0.5, self._leave_offboard),
            "reload": (0.5, self._reload),
            "release": (0.7, self._release),
            "winch": (0.4, self._winch),
            "hover": (1.0, lambda: self._wait(self._between(2.0, 15.0))),
        }
        if flight.engine.parameters.mode is Mode.INLINE:
            offered |= {"position": (4.0, self._position), "second application": (0.7, self._second)}
        weights = np.array([weight for weight, _ in offered.values()])
        name = list(offered)[self._random.choice(len(offered), p=weights / weights.sum())]
        self.manoeuvres[name] += 1
        yield from offered[name][1]()

    def _inject(self) -> None:
        flight = self.flight
        kind = self._kinds[self._random.choice(len(self._kinds), p=self._weights)]
        bounds = STRENGTHS[kind]
        strength = None if bounds is None else self._between(*bounds)
        begin_s = flight.t_s + self._between(0.0, 3.0)
        low, high = map(math.log, FAULT_S)
        flight.peer.faults.inject(Fault(kind, strength, begin_s, begin_s + math.exp(self._between(low, high))))
        self.faults[kind] += 1
        flight.faults += 1

    def _velocity(self) -> Program:
        speed, towards = self._between(0.5, 4.0), self._homewards()
        self._ask_velocity(speed * math.cos(towards), speed * math.sin(towards))
        yield from self._wait(self._between(1.5, 6.0))
        if self._random.random() < 0.5:
            self._ask_velocity(0.0, 0.0)
            yield from self._wait(self._between(2.0, 6.0))

    def _position(self) -> Program:
        distance, towards = self._between(1.0, 15.0), self._homewards()
        north, east = self.flight.peer.plant.state[:2]
        place = (north + distance * math.cos(towards), east + distance * math.sin(towards))
        self._ask(POS_MASK, (*place, -self._between(LOW_M, HIGH_M)), (0.0, 0.0, 0.0))
        yield from self._wait(self._between(4.0, 10.0))

    def _yaw(self) -> Program:
        self._yaw_rad = self._between(-math.pi, math.pi)
        self._ask_velocity(0.0, 0.0)
        yield from self._wait(self._between(2.0, 6.0))

    def _kick(self) -> Program:
        speed, towards = self._between(0.3, 2.0), self._between(-math.pi, math.pi)
        self.flight.peer.plant.kick((speed * math.cos(towards), speed * math.sin(towards), 0.0))
        yield from self._wait(self._between(2.0, 6.0))

    def _wind(self) -> Program:
        speed, towards = self._between(0.0, 8.0), self._between(-math.pi, math.pi)
        self.flight.peer.plant.set_wind((speed * math.cos(towards), speed * math.sin(towards), 0.0))
        self.flight.peer.plant.set_gusts(self._between(0.0, 2.0))
        yield from self._wait(self._between(3.0, 10.0))

    def _silence(self) -> Program:
        """The application stops and comes back, sometimes as another one."""
        flight, kept = self.flight, self.flight.applications[0].setpoint
        flight.applications[0].setpoint = None
        yield from self._wait(self._between(0.1, 3.0))
        if self._random.random() < 0.5:
            flight.disconnect()
            flight.connect(self._whole(0, 4), self._whole(241, 245))
        flight.applications[0].setpoint = kept
        yield from self._wait(1.0)

    def _rate(self) -> Program:
        """The application becomes slower or faster, too slow to be corrected included."""
        self.flight.applications[0].period_s = math.exp(self._between(math.log(0.01), math.log(0.4)))
        yield from self._wait(self._between(3.0, 8.0))
        self.flight.applications[0].period_s = 0.05

    def _second(self) -> Program:
        flight = self.flight
        second = flight.connect(self._whole(0, 4), 250)
        second.setpoint = flight.applications[0].setpoint
        yield from self._wait(self._between(0.2, 4.0))
        second.setpoint = None
        second.leave()
        flight.applications.remove(second)

    def _switch(self) -> Program:
        self.flight.switch_correction(False)
        yield from self._wait(self._between(1.0, 6.0))
        self.flight.switch_correction(True)

    def _leave_offboard(self) -> Program:
        if self.flight.is_copter:
            self._set_mode(LOITER_OF_COPTER)
        else:
            self._set_mode(4.0, 3.0)
        yield from self._wait(self._between(1.0, 8.0))
        yield from self._offboard()

    def _reload(self) -> Program:
        parameters = self.flight.engine.parameters
        control = replace(
            parameters.control,
            damping_ratio=self._between(0.2, 0.7),
            fade_in_s=self._between(0.2, 2.0),
            acc_max_mps2=self._between(1.0, 4.0),
        )
        noise = self._between(0.5, 2.0) * self.flight.parameters.estimator.acc_noise
        estimator = replace(parameters.estimator, acc_noise=noise) if self._random.random() < 0.5 else None
        self.flight.change(replace(parameters, control=control, estimator=estimator or parameters.estimator))
        yield from self._wait(self._between(1.0, 6.0))

    def _release(self) -> Program:
        """Let the load go; later hang one up that may weigh something else."""
        plant, mass_kg = self.flight.peer.plant, self.flight.parameters.payload.mass_kg
        plant.release()
        yield from self._wait(self._between(2.0, 12.0))
        plant.set_load_mass(mass_kg * self._between(0.7, 1.4))
        plant.hook()
        self.manoeuvres["pick-up"] += 1
        yield from self._wait(self._between(4.0, 12.0))

    def _winch(self) -> Program:
        length_m = self.flight.parameters.cable.length_m
        self.flight.peer.plant.set_cable_length(length_m * self._between(0.8, 1.2))
        yield from self._wait(self._between(3.0, 8.0))

    # ---- what is asked for

    def _offboard(self) -> Program:
        self._ask_velocity(0.0, 0.0)
        yield from self._wait(0.5)
        self._set_mode(4.0 if self.flight.is_copter else 6.0)
        yield from self._wait(1.5)
        if not self.flight.follows and self.flight.nav_state not in (NavState.LOITER, NavState.MANUAL):
            # A failsafe flies: it is not to end the sortie on the ground.
            self._set_mode(*((LOITER_OF_COPTER,) if self.flight.is_copter else (4.0, 3.0)))
            yield from self._wait(2.0)

    def _set_mode(self, *mode: float) -> None:
        self.flight.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, *mode)

    def _ask_velocity(self, north_mps: float, east_mps: float) -> None:
        height_m = -self.flight.peer.plant.state[2]
        down_mps = 0.7 if height_m > HIGH_M else -0.7 if height_m < LOW_M else 0.0
        self._ask(VEL_MASK, (0.0, 0.0, 0.0), (north_mps, east_mps, down_mps))

    def _ask(self, mask: int, pos: tuple[float, float, float], vel: tuple[float, float, float]) -> None:
        """Let the application ask for something from now on: of the autopilot, or of swingd in mode hold."""
        component = 191 if self.flight.engine.parameters.mode is Mode.HOLD else 1
        if self._yaw_rad is not None:
            mask &= ~YAW_IGNORED
        setpoint: Any = mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, component, 1, mask, *pos, *vel, 0.0, 0.0, 0.0, self._yaw_rad or 0.0, 0.0
        )
        self.flight.applications[0].setpoint = setpoint

    # ---- chance

    def _between(self, low: float, high: float) -> float:
        return float(self._random.uniform(low, high))

    def _whole(self, low: int, end: int) -> int:
        return int(self._random.integers(low, end))

    def _homewards(self) -> float:
        """A direction, away from home only as long as home is near [rad]."""
        if self._far_m() < 40.0:
            return self._between(-math.pi, math.pi)
        north, east = self.flight.peer.plant.state[:2]
        return math.atan2(-east, -north) + self._between(-0.5, 0.5)
