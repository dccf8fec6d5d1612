"""A flight of the cooperative study as two vehicles tell it: frames with clocks, delays and frames of their own."""

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.core.cooperative_flight import CarrierLog, LoadLog
from swingd.estimation import make_estimator
from swingd.link import swing_message
from swingd.link.codec import Encoder, Framer
from swingd.link.formation_listener import FormationListener
from swingd.model.actions import Health, SwingReport
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.events import LocalPosition
from swingd.model.formation import (
    DirectionSource,
    FormationParameters,
    FormationReport,
    RiggedTether,
    RiggedVehicle,
    SharedLoad,
)
from swingd.model.parameters import Parameters
from swingd.pipeline.disturbance import DisturbanceObserver
from swingd.pipeline.formation import Formation
from swingd.pipeline.formation.geometry import cable_of
from swingd.studies.cooperative import vehicles as v
from swingd.studies.cooperative.cases import NOISE
from swingd.studies.cooperative.estimate import CALIBRATED_DEG
from swingd.studies.cooperative.flight import SAMPLE_S, Flight, rotations
from swingd.studies.cooperative.measure import Carrier, measure

SMOOTH_S = 0.15
"""An estimate of the cable's direction does not follow the tethers' ringing."""
ORIGINS_NED_M = ((0.0, 0.0, 0.0), (3.0, -7.0, 1.5))
"""Of the local frames, in the truth's."""
LAT_1E7, LON_1E7, ALT_MM = 473977418, 85455938, 488000
EARTH_RADIUS_M = 6_371_000.0


@dataclass(frozen=True)
class Telling:
    """How a vehicle tells."""

    boot_s: float = 100.0
    """Its boot clock when the flight begins; the host's then is 1000 s."""
    delay_s: float = 0.01
    jitter_s: float = 0.01
    every: int = 2
    """Samples of the flight, 10 ms each, between two frames of a stream."""
    pos_m: float = 0.005
    vel_mps: float = 0.02
    attitude_rad: float = 0.002
    swing_rad: float = 0.008
    swing_rate_radps: float = 0.02
    winch_m: float = 0.0002
    force_n: float = 0.05


HOST_S = 1000.0


def rig(flight: Flight, direction: DirectionSource = DirectionSource.SWING, **changes: Any) -> FormationParameters:
    """Describe the study's vehicles."""
    lean_rad = flight.scenario.lean_rad
    vehicles = tuple(
        RiggedVehicle(
            system_id=1 + c,
            link="udpin://:14601",
            tethers=tuple(
                RiggedTether(
                    v.TETHER_M, (ahead * v.EDGE_M / 2, v.SIDES[c] * v.HALF_SPAN_M, -v.ANCHOR_UP_M), 0.004, -ahead
                )
                for ahead in (1.0, -1.0)
            ),
            hook_frd_m=v.HOOK_FRD_M,
            pos_std_m=0.006,
            vel_std_mps=0.03,
            direction_std_rad=0.01,
            direction=direction,
            winch="WINCH",
        )
        for c in range(v.CARRIERS)
    )
    rows = tuple((v.winch_for(math.radians(deg), lean_rad), math.radians(deg)) for deg in CALIBRATED_DEG.tolist())
    load = SharedLoad(winch_pitch=rows, pitch_std_rad=0.03)
    return replace(FormationParameters(vehicles, load), **changes)


class Teller:
    """One vehicle's frames over a flight, in the order of arrival."""

    def __init__(
        self, flight: Flight, index: int, telling: Telling, seed: int, force: Any = None, swing: Any = None
    ) -> None:
        self.telling = telling
        self.index = index
        self.autopilot, self.swingd = Encoder(1 + index, 1), Encoder(1 + index, 191)
        rng = self._rng = np.random.default_rng([seed, index])
        n = flight.t_s.size
        origin = np.array(ORIGINS_NED_M[index])
        noise = rng.standard_normal
        self.pos = flight.carrier(index, CarrierLog.POS) - origin + telling.pos_m * noise((n, 3))
        self.vel = flight.carrier(index, CarrierLog.VEL) + telling.vel_mps * noise((n, 3))
        euler = flight.carrier(index, CarrierLog.EULER)
        self.euler = euler + telling.attitude_rad * noise((n, 3))
        xi_zeta = swing_of(flight, index) if swing is None else swing
        self.swing = xi_zeta + telling.swing_rad * noise((n, 2))
        self.swing_rate = np.gradient(xi_zeta, SAMPLE_S, axis=0) + telling.swing_rate_radps * noise((n, 2))
        self.force = (slow_force(flight, index) if force is None else force) + telling.force_n * noise((n, 3))
        self.winch = flight.winch_m(index) + telling.winch_m * noise(n)
        self.t_s = flight.t_s

    def arrival_s(self, t_s: float) -> float:
        """Host's time at which what is sent at a time of the flight arrives."""
        return HOST_S + t_s + self.telling.delay_s + self.telling.jitter_s * float(self._rng.exponential())

    def origin(self) -> Any:
        north, east, down = ORIGINS_NED_M[self.index]
        return mavlink.MAVLink_gps_global_origin_message(
            LAT_1E7 + round(math.degrees(north / EARTH_RADIUS_M) * 1e7),
            LON_1E7 + round(math.degrees(east / EARTH_RADIUS_M / math.cos(math.radians(LAT_1E7 * 1e-7))) * 1e7),
            ALT_MM - round(down * 1e3),
        )

    def sample(self, row: int, boot_s: float) -> list[tuple[Encoder, Any]]:
        """What is told of one sample, stamped with the boot clock."""
        t_boot_s = boot_s + float(self.t_s[row])
        ms = round(t_boot_s * 1e3)
        xi, zeta = self.swing[row].tolist()
        xi_rate, zeta_rate = self.swing_rate[row].tolist()
        nothing = (0.0, 0.0, 0.0)
        force = DisturbanceEstimate(tuple(self.force[row].tolist()), (0.05, 0.05, 0.05), "")
        report = SwingReport(
            t_boot_s,
            xi,
            zeta,
            xi_rate,
            zeta_rate,
            nothing,
            0.005,
            0.005,
            20.0,
            1.0,
            1.0,
            nothing,
            nothing,
            Health.READY,
            disturbance=force,
        )
        messages = [
            (self.autopilot, mavlink.MAVLink_attitude_message(ms, *self.euler[row].tolist(), 0.0, 0.0, 0.0)),
            (
                self.autopilot,
                mavlink.MAVLink_local_position_ned_message(ms, *self.pos[row].tolist(), *self.vel[row].tolist()),
            ),
            (self.swingd, swing_message.encode(report)),
            (self.autopilot, mavlink.MAVLink_named_value_float_message(ms, b"WINCH", float(self.winch[row]))),
        ]
        if row % 100 == 0:
            messages.append((self.autopilot, mavlink.MAVLink_heartbeat_message(2, 12, 128, 0, 4, 3)))
        if row % 500 == 0:
            messages.append((self.autopilot, self.origin()))
        return messages


def in_ned(carrier: Carrier) -> tuple[Any, Any]:
    """Thrust and acceleration (n, 3) of what a vehicle's sensors say."""
    heading = rotations(np.column_stack([np.zeros((carrier.yaw_rad.size, 2)), carrier.yaw_rad]))
    return tuple(np.einsum("nij,nj->ni", heading, vector) for vector in (carrier.thrust_n, carrier.acc_mps2))


def observed_forces(flight: Flight, seed: int, force_noise: float) -> list[Any]:
    """What the disturbance observer of each vehicle's swingd makes of its sensors."""
    base = Parameters()
    parameters = replace(
        base,
        vehicle=replace(base.vehicle, mass_kg=v.MASS_KG),
        disturbance=replace(base.disturbance, source="es_lkf", force_noise=force_noise),
    )
    found = []
    for index, carrier in enumerate(measure(flight, NOISE, seed)):
        rng = np.random.default_rng([seed, index, 9])
        observer = DisturbanceObserver(parameters)
        thrust, _ = in_ned(carrier)
        pos = flight.carrier(index, CarrierLog.POS) + 0.005 * rng.standard_normal(thrust.shape)
        vel = flight.carrier(index, CarrierLog.VEL) + 0.02 * rng.standard_normal(thrust.shape)
        rows = []
        for row, t_s in enumerate(flight.t_s.tolist()):
            if row % 2 == 0:
                told = LocalPosition(t_s, t_s, tuple(pos[row].tolist()), tuple(vel[row].tolist()))
                observer.add_position(told)
            observer.step(t_s + SAMPLE_S, SAMPLE_S, tuple(thrust[row].tolist()), thrust_known=True)
            rows.append(observer.estimate().force_ned_n)
        found.append(np.array(rows))
    return found


def pendulum_swings(flight: Flight, seed: int) -> list[Any]:
    """Swing angles (n, 2) that the fading-memory filter of each vehicle's swingd makes of its sensors."""
    base = Parameters()
    parameters = replace(
        base,
        vehicle=replace(base.vehicle, mass_kg=v.MASS_KG),
        payload=replace(base.payload, mass_kg=v.LOAD_MASS_KG / v.CARRIERS),
        cable=replace(base.cable, length_m=v.TETHER_M),
        estimator=replace(base.estimator, name="fgdf"),
    )
    found = []
    for carrier in measure(flight, NOISE, seed):
        estimator = make_estimator(parameters)
        thrust, acc = in_ned(carrier)
        level = []
        for row in range(flight.t_s.size):
            estimator.step(thrust[row], acc[row], SAMPLE_S)
            level.append(cable_of(estimator.estimate().x[:2])[0])
        heading = rotations(np.column_stack([np.zeros((carrier.yaw_rad.size, 2)), carrier.yaw_rad]))
        unit = np.einsum("nji,nj->ni", heading, np.array(level))
        found.append(np.column_stack([np.arctan2(-unit[:, 1], unit[:, 2]), np.arcsin(unit[:, 0])]))
    return found


@dataclass
class Outcome:
    """What came of a flight."""

    reports: list[FormationReport] = field(default_factory=list)
    formation: Formation | None = None
    listeners: list[FormationListener] = field(default_factory=list)


def slow_force(flight: Flight, index: int) -> Any:
    """Pull (n, 3) of a vehicle's tethers, ned, as slow as an estimate."""
    force = flight.carrier(index, CarrierLog.CABLE_FORCE)
    width = round(SMOOTH_S / SAMPLE_S) | 1
    kernel = np.hanning(width + 2)[1:-1]
    padded = np.pad(force, ((width // 2, width // 2), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(padded[:, k], kernel / kernel.sum(), mode="valid") for k in range(3)])


def swing_of(flight: Flight, index: int) -> Any:
    """Angles (n, 2) of the cable force on a vehicle, heading frame, as slow as an estimate."""
    slow = slow_force(flight, index)
    euler = flight.carrier(index, CarrierLog.EULER)
    heading = rotations(euler * np.array([0.0, 0.0, 1.0]))
    unit = np.einsum("nji,nj->ni", heading, slow / np.linalg.norm(slow, axis=1)[:, None])
    return np.column_stack([np.arctan2(-unit[:, 1], unit[:, 2]), np.arcsin(unit[:, 0])])


def fly_through(
    flight: Flight,
    parameters: FormationParameters,
    tellings: tuple[Telling, ...] = (Telling(), Telling(boot_s=73_000.0, delay_s=0.03)),
    *,
    until_s: float = math.inf,
    silent: tuple[int, float, float] | None = None,
    reboot: tuple[int, float] | None = None,
    answers: bool = True,
    forces: Sequence[Any] = (None, None),
    swings: Sequence[Any] = (None, None),
    seed: int = 1,
) -> Outcome:
    """Let listeners and formation hear a flight in virtual time.

    ``forces``, ``swings``: what is told instead of the truth. ``silent``: vehicle, from, to: nothing of it arrives.
    ``reboot``: vehicle, time: silent for 2 s, then another clock.
    """
    tellers = [Teller(flight, k, telling, seed, forces[k], swings[k]) for k, telling in enumerate(tellings)]
    outcome = Outcome(formation=Formation(parameters))
    outcome.listeners = [FormationListener(rig, parameters.stream_rate_hz) for rig in parameters.vehicles]
    framers = [Framer() for _ in tellers]
    queue: list[tuple[float, int, int, bytes]] = []
    count = 0
    tick_s = 1.0 / parameters.rate_hz
    next_tick_s = HOST_S
    for row, t_s in enumerate(flight.t_s.tolist()):
        if t_s > until_s:
            break
        for k, teller in enumerate(tellers):
            boot_s = teller.telling.boot_s
            if reboot is not None and reboot[0] == k and t_s >= reboot[1]:
                if t_s < reboot[1] + 2.0:
                    continue
                boot_s = -reboot[1]
            if silent is not None and silent[0] == k and silent[1] <= t_s < silent[2]:
                continue
            if row % teller.telling.every == 0:
                for encoder, message in teller.sample(row, boot_s):
                    count += 1
                    heapq.heappush(queue, (teller.arrival_s(t_s), count, k, encoder.encode(message)))
        now_s = HOST_S + t_s
        while queue and queue[0][0] <= now_s:
            arrived_s, _, k, raw = heapq.heappop(queue)
            for frame in framers[k].receive(raw):
                for event in outcome.listeners[k].receive(arrived_s, frame):
                    outcome.formation.take(k, event)
        if now_s >= next_tick_s:
            next_tick_s += tick_s
            for k, listener in enumerate(outcome.listeners):
                for message in listener.messages(now_s):
                    if answers and message.get_msgId() == mavlink.MAVLINK_MSG_ID_TIMESYNC:
                        teller = tellers[k]
                        there_s = teller.arrival_s(t_s) - HOST_S
                        boot_s = teller.telling.boot_s
                        if reboot is not None and reboot[0] == k and t_s >= reboot[1]:
                            boot_s = -reboot[1]
                        answer = mavlink.MAVLink_timesync_message(round((boot_s + there_s) * 1e9), message.ts1)
                        count += 1
                        raw = teller.autopilot.encode(answer)
                        heapq.heappush(queue, (teller.arrival_s(there_s), count, k, raw))
            outcome.reports.append(outcome.formation.step(now_s))
    return outcome


def truth_at(flight: Flight, report: FormationReport) -> tuple[Any, Any, Any]:
    """Position, Euler angles and velocity of the load at the instant of a report."""
    t_s = report.motion.t_mono_s - HOST_S
    return tuple(
        np.array([np.interp(t_s, flight.t_s, flight.load(first)[:, k]) for k in range(3)])
        for first in (LoadLog.POS, LoadLog.EULER, LoadLog.VEL)
    )
