"""The pilot of the demonstration: take-off, OFFBOARD, velocity steps; knows the vehicle by MAVLink only."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.events import Vec3
from swingd.sim.autopilot import NavState
from swingd.sim.peer import SimulatedAutopilot

PILOT_SYSTEM_ID = 255
PILOT_COMPONENT_ID = 190
REFERENCE_PERIOD_S = 0.1
RETRY_S = 1.0
_SWINGD_COMPONENT_ID = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
_OFFBOARD_MAIN_MODE = 6
_VELOCITY_MASK = 0b0000_1101_1100_0111  # velocity alone


class Phase(Enum):
    """Where the flight stands."""

    WAIT = "waiting for swingd"
    CLIMB = "take-off"
    SETTLE = "settling"
    ENTER = "entering OFFBOARD"
    STEPS = "velocity steps"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Step:
    """One velocity step of the manoeuvre."""

    t_boot_s: float
    """When it was commanded, on the autopilot's clock [s]."""
    vel_ned_mps: Vec3


class Pilot:
    """Flies one manoeuvre on a simulated autopilot; to be called before each step of the simulation.

    Parameters
    ----------
    peer : SimulatedAutopilot
        The autopilot; its link is the only way in, its truth only tells when the climb is over.
    steps_ned_mps : sequence of vectors
        The reference velocities, one after another.
    step_s : float
        Time for each of them [s].
    settle_s : float
        Hover before OFFBOARD, and again before the first step [s].
    """

    def __init__(
        self, peer: SimulatedAutopilot, steps_ned_mps: tuple[Vec3, ...], step_s: float = 22.0, settle_s: float = 6.0
    ) -> None:
        self._peer = peer
        self._codec = Codec(PILOT_SYSTEM_ID, PILOT_COMPONENT_ID)
        self._wanted = steps_ned_mps
        self._step_s = step_s
        self._settle_s = settle_s
        self.phase = Phase.WAIT
        self.steps: list[Step] = []
        """The steps that were commanded so far."""
        self._since_s = 0.0
        self._tried_s = -RETRY_S
        self._sent_s = -REFERENCE_PERIOD_S

    @property
    def duration_s(self) -> float:
        """About how long the flight takes [s]."""
        return 16.0 + 2.0 * self._settle_s + self._step_s * len(self._wanted)

    def __call__(self, t_s: float) -> None:
        """Do what is due at ``t_s`` [s]."""
        _PHASES[self.phase](self, t_s)

    def _enter(self, phase: Phase, t_s: float) -> None:
        self.phase, self._since_s, self._tried_s = phase, t_s, -RETRY_S

    def _due(self, t_s: float) -> bool:
        if t_s - self._tried_s < RETRY_S:
            return False
        self._tried_s = t_s
        return True

    def _command(self, command: int, *params: float) -> None:
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        self._peer.receive(self._codec.encode(mavlink.MAVLink_command_long_message(1, 1, command, 0, *padded)))

    def _wait(self, t_s: float) -> None:
        # Its first word of health says that the filter is loaded; heartbeats come long before, as it forwards first.
        heard = (text for _, _, text in self._peer.companion.status_texts)
        if t_s > 2.0 and any(text.startswith("swingd ") for text in heard):
            self._enter(Phase.CLIMB, t_s)

    def _climb(self, t_s: float) -> None:
        truth = self._peer.truth()
        if self._due(t_s) and truth.grounded:
            self._command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, *(math.nan for _ in range(4)))
            self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        if -truth.pos_ned_m[2] > 0.95 * self._peer.px4["MIS_TAKEOFF_ALT"]:
            self._enter(Phase.SETTLE, t_s)

    def _settle(self, t_s: float) -> None:
        if t_s - self._since_s > self._settle_s:
            self._enter(Phase.ENTER, t_s)

    def _offboard(self, t_s: float) -> None:
        if self._peer.autopilot.nav_state is NavState.OFFBOARD:
            if t_s - self._since_s > self._settle_s:
                self._enter(Phase.STEPS, t_s)
            return
        self._since_s = t_s
        if self._due(t_s):
            flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            self._command(mavlink.MAV_CMD_DO_SET_MODE, flags, _OFFBOARD_MAIN_MODE)

    def _fly(self, t_s: float) -> None:
        index = int((t_s - self._since_s) / self._step_s)
        if index >= len(self._wanted):
            self._enter(Phase.DONE, t_s)
            return
        vel = self._wanted[index]
        if index == len(self.steps):
            self.steps.append(Step(self._peer.t_boot_s, vel))
            self._sent_s = -REFERENCE_PERIOD_S
        if t_s - self._sent_s >= REFERENCE_PERIOD_S - 1e-9:
            self._sent_s = t_s
            self._peer.send_to_companion(
                mavlink.MAVLink_set_position_target_local_ned_message(
                    0, 1, _SWINGD_COMPONENT_ID, mavlink.MAV_FRAME_LOCAL_NED, _VELOCITY_MASK,
                    0.0, 0.0, 0.0, *vel, 0.0, 0.0, 0.0, 0.0, 0.0,
                )
            )  # fmt: skip

    def _done(self, t_s: float) -> None:
        pass


_PHASES: dict[Phase, Callable[[Pilot, float], None]] = {
    Phase.WAIT: Pilot._wait,
    Phase.CLIMB: Pilot._climb,
    Phase.SETTLE: Pilot._settle,
    Phase.ENTER: Pilot._offboard,
    Phase.STEPS: Pilot._fly,
    Phase.DONE: Pilot._done,
}
