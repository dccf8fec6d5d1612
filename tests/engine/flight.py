"""A flight in virtual time: the whole engine against the simulated autopilot, with a link that can be spoiled."""

import copy
import copyreg
import math
import struct
from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common as mavlink

from swingd.engine import Engine
from swingd.link.codec import Codec, Frame, Framer
from swingd.link.port import Port
from swingd.model.actions import Action, Health, Setpoint, StatusText, SwingReport
from swingd.model.parameters import Mode, Parameters, SimulatedKind
from swingd.pipeline.path import PathState
from swingd.record.event_log import EventLogWriter
from swingd.sim.autopilot import NavState
from swingd.sim.lockstep import EngineCompanion, Lockstep
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import Truth

OWN_COMPONENT_ID = 191
REFERENCE_S = 0.1
SAID = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
    mavlink.MAVLINK_MSG_ID_STATUSTEXT,
}
"""What swingd says in mode hold; of commands only SET_MESSAGE_INTERVAL."""
QUESTIONS = {
    mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
    mavlink.MAVLINK_MSG_ID_PARAM_ERROR,
    mavlink.MAVLINK_MSG_ID_TIMESYNC,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
    mavlink.MAVLINK_MSG_ID_MISSION_ACK,
}
"""What it may ask besides, and say of its own parameters: nothing that changes the autopilot's state."""
COMMANDS = {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}
"""The commands that it gives."""
UNIX_START_S = 1.7e9

# Lets a flight be copied: pymavlink's packer keeps compiled formats.
copyreg.pickle(struct.Struct, lambda compiled: (struct.Struct, (compiled.format,)))  # type: ignore[arg-type]

Spoil = Callable[[float, list[bytes]], list[bytes]]
FloatArray = npt.NDArray[np.float64]


def hold(parameters: Parameters | None = None, **simulation: Any) -> Parameters:
    """Mode hold, a low take-off, and changes of the simulation."""
    parameters = parameters or Parameters()
    simulation = {"takeoff_altitude_m": 6.0, **simulation}
    return replace(parameters, mode=Mode.HOLD, simulation=replace(parameters.simulation, **simulation))


def inline(parameters: Parameters | None = None, **simulation: Any) -> Parameters:
    """Mode inline, otherwise as `hold`."""
    return replace(hold(parameters, **simulation), mode=Mode.INLINE)


def uncorrected(parameters: Parameters) -> Parameters:
    """The same with a correction of zero: setpoints are met, resolved and sent on, and nothing is added."""
    return replace(
        parameters, control=replace(parameters.control, acc_max_mps2=0.0, vel_max_mps=0.0, displacement_max_m=0.0)
    )


class Flight:
    """One vehicle, one engine, one clock.

    Every frame that the engine sends, on any flight, must be of a kind that can neither arm nor change a mode.

    Parameters
    ----------
    truth : Parameters
        What flies.
    parameters : Parameters, optional
        What swingd believes; the truth where not given.
    px4 : mapping, optional
        The autopilot's parameters, whichever it is, other than the defaults.
    log : EventLogWriter, optional
        Of the engine.
    joined : bool
        Whether the filter is there from the start.
    signing_key : bytes, optional
        The autopilot demands signatures of this key; the pilot's commands have them.
    signs : bool
        Whether swingd's side of that link has the key too.
    without : collection of int
        Messages that the autopilot does not have.
    """

    def __init__(
        self,
        truth: Parameters,
        parameters: Parameters | None = None,
        *,
        px4: dict[str, float] | None = None,
        log: EventLogWriter | None = None,
        joined: bool = True,
        signing_key: bytes | None = None,
        signs: bool = False,
        without: Collection[int] = (),
    ) -> None:
        self.peer = SimulatedAutopilot(truth, px4, signing_key=signing_key, without=without)
        self.is_copter = truth.simulation.autopilot is SimulatedKind.ARDUPILOT
        self._height_m = truth.simulation.takeoff_altitude_m
        self._pilot_port = Port(signing_key, 9, frozenset(), self._unix_s)
        self._port = Port(signing_key if signs else None, 0, frozenset(), self._unix_s)
        self.engine = Engine(parameters or truth, self._see, log, signing=signs)
        if joined:
            self.engine.join(0.0)
        self.companion = EngineCompanion(self.engine)
        self.lockstep = Lockstep(self.peer, self._companion, self._on_step)
        self.spoil: Spoil | None = None
        """Gets the time and the autopilot's frames of one step; returns what arrives."""
        self.deliver: Callable[[float, bytes], bytes] | None = None
        """Gets the time and what swingd sends to the autopilot; returns what arrives there."""
        self.withhold: Callable[[Frame], bool] | None = None
        """Gets every frame for the autopilot; says which ones do not reach it."""
        self.reference: tuple[float, float, float] | None = None
        """Velocity that an application repeats to swingd, NED [m/s]."""
        self._yaw: tuple[float, float, float] | None = None
        self.tlog: list[tuple[float, bytes]] | None = None
        self.frames_sent = 0
        self.applications: list[Application] = []
        self._pilot = Codec(255, 190)
        self._splitter = Codec(1, 1)
        self._checker = Codec(1, 1)
        self._reference_s = 0.0
        self.forget()

    def forget(self) -> None:
        """Drop what was recorded so far."""
        self.truths: list[Truth] = []
        self.reports: list[SwingReport] = []
        self.setpoints: list[tuple[float, Setpoint]] = []
        self.texts: list[tuple[float, str]] = []
        self.sent_ids: set[int] = set()

    def fork(self) -> "Flight":
        """Return an independent copy that flies on from here with empty records."""
        kept = self.truths, self.reports, self.setpoints, self.texts, self.sent_ids
        self.forget()
        fork = copy.deepcopy(self)
        self.truths, self.reports, self.setpoints, self.texts, self.sent_ids = kept
        return fork

    @staticmethod
    def splitter() -> Framer:
        """Frames of a whole piece of the stream."""
        return Framer()

    @property
    def t_s(self) -> float:
        return self.peer.t_s

    def _unix_s(self) -> float:
        return UNIX_START_S + self.peer.t_s

    @property
    def nav_state(self) -> NavState:
        return self.peer.autopilot.nav_state

    @property
    def health(self) -> Health:
        return self.engine.pipeline.health

    # ---- the loop

    def run(self, duration_s: float) -> "Flight":
        self.lockstep.run_until(self.t_s + duration_s)
        return self

    def run_while(self, condition: Callable[[], bool], at_most_s: float) -> "Flight":
        end_s = self.t_s + at_most_s
        while condition():
            assert self.t_s < end_s, f"{self.nav_state}, {self.health}, {self.texts}"
            self.run(0.1)
        return self

    def run_until_healthy(self, at_most_s: float) -> "Flight":
        return self.run_while(lambda: self.health not in (Health.READY, Health.ACTIVE), at_most_s)

    def connect(self, *, direct: bool = False, endpoint: int = 0, ids: tuple[int, int] = (245, 190)) -> "Application":
        """Let an application come: behind one of swingd's endpoints, or ``direct`` at the autopilot."""
        port = None if direct else self.companion.connect(self.t_s, endpoint, len(self.applications))
        application = Application(self, port, ids)
        self.applications.append(application)
        return application

    def _on_step(self, t_s: float) -> None:
        self.truths.append(self.peer.truth())
        for application in self.applications:
            application.step(t_s)
        if self.reference is not None and t_s >= self._reference_s:
            self._reference_s = t_s + REFERENCE_S
            mask = 0b0000_1101_1100_0111
            yaw_rad = 0.0
            if self._yaw is not None:
                mask &= ~mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
                yaw_rad, rate_radps, since_s = self._yaw
                yaw_rad = math.remainder(yaw_rad + rate_radps * (t_s - since_s), 2.0 * math.pi)
            self.peer.send_to_companion(
                mavlink.MAVLink_set_position_target_local_ned_message(
                    0, 1, 191, 1, mask, 0.0, 0.0, 0.0, *self.reference, 0.0, 0.0, 0.0, yaw_rad, 0.0
                )
            )

    def _companion(self, t_s: float, data: bytes) -> bytes:
        if self.spoil is not None:
            data = b"".join(self.spoil(t_s, [frame.raw for frame in self._splitter.receive(data)]))
        if self.tlog is not None:
            self.tlog += [(t_s, frame.raw) for frame in self._splitter.receive(data)]
        answer = self._port.seal(self.companion(t_s, b"".join(frame.raw for frame in self._port.receive(data))))
        self._check(answer)
        if self.withhold is not None:
            answer = b"".join(frame.raw for frame in self._splitter.receive(answer) if not self.withhold(frame))
        if self.deliver is not None:
            answer = self.deliver(t_s, answer)
        return answer

    def _check(self, answer: bytes) -> None:
        assert self.engine.failure is None, self.engine.failure
        for frame in self._checker.receive(answer):
            self.frames_sent += 1
            if frame.component_id != OWN_COMPONENT_ID:
                continue
            assert frame.msg_id in SAID | QUESTIONS, frame.message
            self.sent_ids.add(frame.msg_id)
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                assert frame.message.command in COMMANDS
            if frame.msg_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
                assert frame.message.tc1 == 0

    def _see(self, t_s: float, action: Action) -> None:
        if isinstance(action, SwingReport):
            self.reports.append(action)
        elif isinstance(action, Setpoint):
            self.setpoints.append((t_s, action))
        elif isinstance(action, StatusText):
            self.texts.append((t_s, action.text))

    # ---- the pilot

    def command(self, command: int, *params: float) -> None:
        """Send a command as a ground station would."""
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        message = mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded)
        self.peer.receive(self._pilot_port.seal(self._pilot.encode(message)))

    def take_off(self) -> "Flight":
        """Climb and wait until the estimate is good."""
        self.run(2.5)
        if self.is_copter:
            self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0)
            self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
            self.run(0.1)
            self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, self._height_m)
        else:
            self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, *(math.nan for _ in range(4)))
            self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self.run_while(lambda: -self.peer.truth().pos_ned_m[2] < 0.95 * self._height_m, 20.0)
        return self.run(3.0)

    def enter_offboard(self) -> "Flight":
        """Ask for OFFBOARD (Copter: GUIDED) as a pilot would and wait until swingd has seen it."""
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0 if self.is_copter else 6.0)
        return self.run(1.2)

    def leave_offboard(self) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0)

    def kick(self, ahead_mps: float, right_mps: float) -> None:
        """Give the load a blow, in the heading frame."""
        yaw = self.peer.truth().yaw_rad
        north = math.cos(yaw) * ahead_mps - math.sin(yaw) * right_mps
        east = math.sin(yaw) * ahead_mps + math.cos(yaw) * right_mps
        self.peer.plant.kick((north, east, 0.0))

    def turn(self, yaw_rad: float, rate_radps: float = 0.0) -> None:
        """Let the reference have a heading from now on."""
        self.reference = self.reference or (0.0, 0.0, 0.0)
        self._yaw = (yaw_rad, rate_radps, self.t_s)

    # ---- figures

    def chi_rad(self, begin_s: float, end_s: float) -> FloatArray:
        """True total swing in a window of the autopilot's clock."""
        return np.array([truth.chi_rad for truth in self.truths if begin_s <= truth.t_boot_s < end_s])

    def errors_deg(self, begin_s: float = 0.0, end_s: float = math.inf) -> FloatArray:
        """(2, n) estimated minus true xi, zeta over the reports of a window [deg]."""
        t = np.array([truth.t_boot_s for truth in self.truths])
        reports = [r for r in self.reports if begin_s <= r.t_boot_s < end_s and t[0] <= r.t_boot_s <= t[-1]]
        at = np.array([report.t_boot_s for report in reports])
        xi = np.interp(at, t, [truth.xi_rad for truth in self.truths])
        zeta = np.interp(at, t, [truth.zeta_rad for truth in self.truths])
        estimated = np.array([[report.xi_rad, report.zeta_rad] for report in reports]).T
        return np.degrees(estimated - np.array([xi, zeta]))

    def rmse_deg(self, begin_s: float = 0.0, end_s: float = math.inf) -> float:
        """Root of the mean over both axes."""
        return float(np.sqrt(np.mean(self.errors_deg(begin_s, end_s) ** 2)))

    def correction_mps2(self) -> FloatArray:
        """(2, n) acceleration correction of each report."""
        return np.array([report.correction_acc_ned_mps2[:2] for report in self.reports]).T


class Application:
    """An offboard application that repeats one setpoint at its own rate, over MAVLink alone.

    Parameters
    ----------
    flight : Flight
        Where it belongs.
    port : int or None
        Where it came to swingd; None where it talks to the autopilot itself.
    ids : (2,)
        Its system and component.
    """

    def __init__(self, flight: Flight, port: int | None, ids: tuple[int, int]) -> None:
        self._flight = flight
        self._codec = Codec(*ids)
        self.port = port
        self._due_s = 0.0
        self.seal: Callable[[bytes], bytes] = bytes
        """Signs what it sends."""
        self.period_s = 0.05
        self.setpoint: Any = None
        """The message that is repeated; None for silence."""

    def step(self, t_s: float) -> None:
        if self.setpoint is not None and t_s >= self._due_s - 1e-9:
            self._due_s = max(self._due_s, t_s - self.period_s) + self.period_s
            self.send(self.setpoint)

    def send(self, message: Any) -> bytes:
        """Send one message now; return its frame."""
        data = self.seal(self._codec.encode(message))
        if self.port is None:
            self._flight.peer.receive(data)
        else:
            self._flight.companion.application_sends(self._flight.t_s, self.port, data)
        return data

    def heard(self) -> list[Frame]:
        """Return what has come through the endpoint since the last call."""
        assert self.port is not None
        waiting = self._flight.companion.to_applications[self.port]
        frames = Framer().receive(b"".join(waiting))
        waiting.clear()
        return frames


def local_setpoint(
    *,
    pos: tuple[float | None, ...] = (None, None, None),
    vel: tuple[float | None, ...] = (None, None, None),
    acc: tuple[float | None, ...] = (None, None, None),
    yaw_rad: float | None = None,
    frame: int = mavlink.MAV_FRAME_LOCAL_NED,
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED to the autopilot; None is ignored."""
    values = [*pos, *vel, *acc]
    mask = sum(1 << bit for bit, value in enumerate(values) if value is None)
    mask |= mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
    mask |= mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE if yaw_rad is None else 0
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, *(value or 0.0 for value in values), yaw_rad or 0.0, 0.0
    )


def swing_energy(truth: Truth, length_m: float) -> float:
    """Of the load relative to the vehicle, per mass [J/kg]."""
    motion = np.subtract(truth.load_vel_ned_mps, truth.vel_ned_mps)
    return 0.5 * float(motion @ motion) + 9.80665 * length_m * (1.0 - math.cos(truth.chi_rad))


def errors_m(load: FloatArray, corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Horizontal and vertical distance from the nearest leg."""
    level, down = np.full(len(load), math.inf), np.zeros(len(load))
    for begin, end in pairwise(corners):
        leg = end - begin
        share = np.clip((load - begin) @ leg / (leg @ leg), 0.0, 1.0)
        away = load - begin - share[:, None] * leg
        nearer = np.hypot(away[:, 0], away[:, 1]) < level
        level[nearer], down[nearer] = np.hypot(away[nearer, 0], away[nearer, 1]), away[nearer, 2]
    return level, down


def state(flight: Flight) -> PathState:
    """How far its path has come."""
    progress = flight.engine.pipeline.path
    assert progress is not None
    return progress.state
