"""The reference of mode ``path``: where the load is led, and the acceleration that leads it there."""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from swingd.control.path_following import PathFollower, PathSettings, PathTerm
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slts import NUM_STATES, SltsState
from swingd.core.status import Status
from swingd.model.estimate import FloatArray
from swingd.model.events import LocalPosition, PathOrder, Vec3
from swingd.model.parameters import LEG_MIN_M, Parameters

POSITION_LATE_S = 0.3
RESUME_WITHIN_S = 5.0
"""A path that was interrupted for longer waits until it is continued, or OFFBOARD is entered again."""
STOP_S = 1.0
"""A pause holds the load where it would be after this time at its speed."""
PLACE_MAX_M = 5e4
"""Of the load from the autopilot's origin, on every axis: a place beyond is taken for none."""
LIFT_TIME_CONSTANT_S = 1.0
LIFT_OFFSET_MAX_MPS2 = 3.0


@dataclass(frozen=True, slots=True)
class PathInputs:
    """What the law needs besides the load's motion, north, east, down."""

    thrust_ned_n: Vec3
    """As the vehicle is believed to give it, mean of this step."""
    thrust_known: bool
    """False where the thrust was inferred from a model of the load."""
    specific_force_ned_mps2: Vec3
    hook_ned_m: Vec3
    """From the centre of gravity."""


class PathState(Enum):
    """How far a path has come."""

    WAITING = "waiting"
    """It has not begun."""
    LEADING = "leading"
    """The load is on its way."""
    ARRIVED = "arrived"
    """The load is held at the last waypoint."""
    PAUSED = "paused"
    """The load is held on the way, by order."""
    INTERRUPTED = "interrupted"
    """The load may not be led: the vehicle holds, and the progress is kept."""
    ABORTED = "aborted"
    """By order: the vehicle holds, and the progress is lost."""


@dataclass(frozen=True, slots=True)
class PathProgress:
    """What is told of a path."""

    state: PathState
    waypoint: int
    """The next one, from 1."""
    waypoints: int
    remaining_m: float | None
    """Way left to the last waypoint; None where the load is not led."""


def load_motion(
    position: LocalPosition, age_s: float, direction: tuple[float, float], rate: tuple[float, float],
    inputs: PathInputs, length_m: float,
) -> FloatArray:  # fmt: skip
    """Return the load's state (10,), see `swingd.core.slts.SltsState`, from the vehicle's and the cable's.

    Parameters
    ----------
    position : LocalPosition
    age_s : float
        Of its stamp [s]; it is carried on by the acceleration that was felt.
    direction, rate : (2,)
        Horizontal part of the cable's unit vector and its derivative, north and east [1], [1/s].
    inputs : PathInputs
    length_m : float
        Of the cable [m].
    """
    n_n, n_e = direction
    n_d = math.sqrt(max(1.0 - n_n * n_n - n_e * n_e, 1e-6))
    n_d_rate = -(n_n * rate[0] + n_e * rate[1]) / n_d
    x = np.empty(NUM_STATES)
    acc = (*inputs.specific_force_ned_mps2[:2], inputs.specific_force_ned_mps2[2] + GRAVITY_MPS2)
    cable, cable_rate = (n_n, n_e, n_d), (*rate, n_d_rate)
    for i in range(3):
        vel = position.vel_ned_mps[i] + age_s * acc[i]
        pos = position.pos_ned_m[i] + age_s * (position.vel_ned_mps[i] + 0.5 * age_s * acc[i])
        x[SltsState.LOAD_POS + i] = pos + inputs.hook_ned_m[i] + length_m * cable[i]
        x[SltsState.LOAD_VEL + i] = vel + length_m * cable_rate[i]
    for i in range(2):
        x[SltsState.REL_POS + i] = -length_m * cable[i]
        x[SltsState.REL_VEL + i] = -length_m * cable_rate[i]
    return x


class PathReference:
    """Leads the load from where it hangs to the first waypoint, and on to the last, where it is held.

    The law's estimates of the disturbances run whenever the load's motion is known, so that a path begins with them.
    Whenever the load is led anew, after a pause or an interruption, a straight leg leads from where it then is to the
    next waypoint: it is never far from its path at the beginning.

    The autopilot takes an acceleration of zero for hovering, by a thrust of its own finding. What this differs by from
    the thrust that is believed here is learned (`LIFT_TIME_CONSTANT_S`) and taken off the vertical acceleration.

    Parameters
    ----------
    parameters : Parameters
    """

    def __init__(self, parameters: Parameters) -> None:
        self._mission: tuple[tuple[Vec3, ...], str] = ((), "the mission has not been read yet")
        self.doubt = ""
        """Why the load may not be led, as far as it depends on the path and what is known of the load."""
        self.leading = False
        """Whether the last step led the load."""
        self._texts: list[str] = []
        self._follower: PathFollower | None = None
        self._take(parameters)
        self.restart()

    def _take(self, parameters: Parameters) -> None:
        path, vehicle = parameters.path, parameters.vehicle
        self._path = path
        if path.source == "configuration":
            self._places: tuple[Vec3, ...] = tuple((w.north_m, w.east_m, w.down_m) for w in parameters.waypoints)
            self._missing = "no waypoints"
        else:
            self._places, self._missing = self._mission
        self._settings = PathSettings(
            vehicle.mass_kg, parameters.payload.mass_kg, parameters.cable.length_m, path.cruise_mps, path.lead_m,
            k_p=path.k_p_per_s, k_l=path.k_l_per_s, k_0_per_mass=path.k_0_per_s, k_r=path.k_r_per_s,
            tilt_max_rad=path.tilt_max_rad,
        )  # fmt: skip

    def configure(self, parameters: Parameters) -> None:
        """Take other parameters; other waypoints begin a path anew, anything else goes on towards the next one."""
        before = self._places, self._is_from_start
        self._take(parameters)
        if before != (self._places, self._is_from_start):
            self.restart()
        # Led anew by the next step, with the new settings.
        self.leading = False
        self._follower = None

    def set_mission(self, places: tuple[Vec3, ...], problem: str) -> str:
        """Take the autopilot's mission, and where there are no places the reason; return what is to be told.

        Another mission begins a path anew.
        """
        changed = places != self._mission[0]
        self._mission = places, problem
        if self._path.source != "mission":
            return ""
        self._places, self._missing = self._mission
        if changed:
            self.restart()
        return f"path: {problem}" if problem else f"path: {len(places)} waypoints of the mission" if changed else ""

    @property
    def _is_from_start(self) -> bool:
        return self._path.source == "configuration" and self._path.relative_to == "start"

    def restart(self) -> None:
        """Begin with the first waypoint the next time."""
        self._points: list[FloatArray] | None = None
        self._base = 0
        self._reached = 0
        self._paused = self._aborted = self._waits = False
        self.leading = False
        self._led_s: float | None = None
        self._follower = None
        self._x: FloatArray | None = None
        self._inputs: PathInputs | None = None
        self._offset_mps2 = 0.0
        self._sent_down_mps2 = 0.0

    # ---- orders

    def order(self, order: PathOrder) -> str:
        """Take an order; return what is to be told."""
        if order is PathOrder.ABORT:
            self._points = None
            self._base = self._reached = 0
            self._aborted, self._paused, self.leading = True, False, False
        else:
            self._paused = order is PathOrder.PAUSE
            if not self._paused:
                self.go_on()
            if self.leading:
                self._lead()
        return f"path {self.state.value}"

    def go_on(self) -> None:
        """By order, or because OFFBOARD is entered: an interrupted path goes on, an aborted one begins anew."""
        self._aborted = self._waits = False
        self._led_s = None

    # ---- the way

    def observe(self, t_mono_s: float, x: FloatArray | None, inputs: PathInputs, dt_s: float) -> None:
        """Take the load's motion, None where the vehicle's position is late; see whether it may be led."""
        if x is not None and not (abs(x[SltsState.LOAD_POS : SltsState.LOAD_POS + 3]) < PLACE_MAX_M).all():
            x = None  # no leg could be laid from there
        self._x, self._inputs = x, inputs
        if self._led_s is not None and t_mono_s - self._led_s > RESUME_WITHIN_S and not self._waits:
            self._waits = True
        self.doubt = self._doubted(inputs)
        if x is None or not inputs.thrust_known:
            self._follower = None
            return
        mass_kg = self._settings.total_mass_kg
        believed = inputs.thrust_ned_n[2] / mass_kg + GRAVITY_MPS2
        # Where the autopilot's own loops fly, they ask for about what the vehicle then does.
        asked = self._sent_down_mps2 if self.leading else inputs.specific_force_ned_mps2[2] + GRAVITY_MPS2
        blend = dt_s / (dt_s + LIFT_TIME_CONSTANT_S)
        offset = self._offset_mps2 + blend * (believed - asked - self._offset_mps2)
        self._offset_mps2 = min(max(offset, -LIFT_OFFSET_MAX_MPS2), LIFT_OFFSET_MAX_MPS2)
        if self._follower is None:
            self._follow([x[:3].copy()], x)
        follower = self._follower
        if follower is None:
            self.doubt = "the load's motion is beyond what a hanging load can do"
            return
        if not self._update(follower, x, dt_s):
            self._follower = None
            self.doubt = "the load's motion is beyond what a hanging load can do"
        elif self.leading and self._error_m > self._path.error_max_m:
            self._waits = True
            self.doubt = f"the load is {self._error_m:.1f} m off its path"

    @property
    def _error_m(self) -> float:
        assert self._follower is not None
        return float(np.linalg.norm(self._follower.term(PathTerm.E_P)))

    def _doubted(self, inputs: PathInputs) -> str:
        if not self._places:
            return self._missing
        if self._aborted:
            return "aborted: it begins anew when it is continued or OFFBOARD is entered"
        if self._waits:
            return "interrupted: it goes on when it is continued or OFFBOARD is entered"
        if not inputs.thrust_known:
            return "thrust unknown"
        return "position and velocity late or out of range" if self._x is None else ""

    def lead(self, t_mono_s: float) -> Vec3 | None:
        """Return the acceleration that leads the load now, ned [m/s^2]; only after an `observe` without a doubt."""
        if self._x is None:
            return None
        if not self.leading:
            self._lead()
        if self._follower is None:
            return None
        self._led_s = t_mono_s
        north, east, down = self._follower.acceleration_ned_mps2.tolist()
        self._sent_down_mps2 = down - self._offset_mps2
        self._tell_progress()
        return north, east, self._sent_down_mps2

    def rest(self, reason: str = "") -> None:
        """The load is not led in this step, for a reason in words where it is known."""
        if self.leading:
            self.leading = False
            self._texts.append(f"path {self.state.value}" + (f": {reason}" if reason else ""))

    def take_texts(self) -> list[str]:
        """Return what is to be told since the last call."""
        texts, self._texts = self._texts, []
        return texts

    def _lead(self) -> None:
        """Lead on from where the load is: to the next waypoint, or, paused, to where it can stop."""
        x = self._x
        if x is None:
            return
        here, vel = x[:3].copy(), x[SltsState.LOAD_VEL : SltsState.LOAD_VEL + 3]
        if self._points is None:
            begin = here if self._is_from_start else np.zeros(3)
            self._points = [begin + np.array(place) for place in self._places]
            self._base = self._reached = 0
        began, self.leading = not self.leading, True
        if self._paused:
            self._base = self._reached
            self._follow([here + STOP_S * vel], x)
        else:
            self._base = min(self._reached, len(self._points) - 1)
            ahead = self._points[self._base :]
            near = float(np.linalg.norm(ahead[0] - here)) < LEG_MIN_M
            if near and len(ahead) > 1:
                self._base += 1
                ahead = ahead[1:]
                near = False
            self._follow(ahead if near else [here, *ahead], x)
        if began:
            self._texts.append(f"path {self.state.value}: waypoint {self.progress.waypoint} of {len(self._points)}")

    def _follow(self, points: list[FloatArray], x: FloatArray) -> None:
        follower = PathFollower(self._settings, [(float(p[0]), float(p[1]), float(p[2])) for p in points])
        begun = follower.begin(x, self._follower) is Status.OK and self._update(follower, x, 0.0)
        self._follower = follower if begun else None

    def _update(self, follower: PathFollower, x: FloatArray, dt_s: float) -> bool:
        inputs = self._inputs
        assert inputs is not None
        thrust, specific_force = np.array(inputs.thrust_ned_n), np.array(inputs.specific_force_ned_mps2)
        return follower.update(x, thrust, specific_force, dt_s) is Status.OK

    def _tell_progress(self) -> None:
        assert self._points is not None
        assert self._follower is not None
        if self._paused:
            return
        reached = len(self._points) if self._follower.holding else self._base + self._follower.leg
        if reached > self._reached:
            self._reached = reached
            left = f", {self._follower.remaining_m:.0f} m left" if reached < len(self._points) else "; the load is held"
            self._texts.append(f"path: waypoint {reached} of {len(self._points)}{left}")

    # ---- what is told

    @property
    def state(self) -> PathState:
        """How far it has come."""
        if self._aborted:
            return PathState.ABORTED
        if self._paused:
            return PathState.PAUSED
        if self.leading:
            arrived = self._follower is not None and self._follower.holding
            return PathState.ARRIVED if arrived else PathState.LEADING
        return PathState.WAITING if self._points is None else PathState.INTERRUPTED

    @property
    def progress(self) -> PathProgress:
        """What is told of it."""
        count = len(self._places)
        remaining_m = None
        if self.leading and not self._paused and self._follower is not None:
            remaining_m = self._follower.remaining_m
        return PathProgress(self.state, min(self._reached + 1, count), count, remaining_m)
