"""The shaper: steps of velocity or position, spread so that they are within limits and excite no swing.

    target -> slew (speed and acceleration) -> mean over a window (jerk) -> impulses (swing) -> shaped motion

Everything behind the slew is a convolution with weights that sum to one, evaluated exactly from the slewed motion's
history of straight velocity segments. So the shaped motion is within the slewed one's limits, ends exactly where it
ends, and its velocity and acceleration are the derivatives of its position whatever the intervals are.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass

from swingd.control.base import Vec2
from swingd.control.impulses import Impulses, impulses
from swingd.control.nominal import swing_frequency_radps
from swingd.model.parameters import Parameters, ShaperName

BRAKING_SHARE = 0.8
"""Of the acceleration limit that the approach to a position counts on; the rest turns the velocity towards it."""
WINDOW_MAX_S = 4.0
"""Longest window of the mean; where acceleration and jerk ask for more, less acceleration is used."""
CHANGE_LENGTHS = 2.0
"""Duration of a change to another shaper, over the longer one's duration."""
CHANGE_MIN_S = 1.0
_SPARE_SEGMENTS = 256
_ARRIVED_M = 1e-6


@dataclass(frozen=True, slots=True)
class Motion:
    """Position and its derivatives along north and east."""

    pos_m: Vec2
    vel_mps: Vec2
    acc_mps2: Vec2
    jerk_mps3: Vec2


@dataclass(frozen=True, slots=True)
class Target:
    """What the motion is to arrive at."""

    vel_mps: Vec2
    """Wanted velocity; of a position, how fast it moves."""
    pos_m: Vec2 | None = None


@dataclass(frozen=True, slots=True)
class _Kernel:
    """What the slewed motion is convolved with."""

    impulses: Impulses
    window_s: float
    acc_max_mps2: float

    @property
    def length_s(self) -> float:
        return self.impulses[-1][1] + self.window_s


def _kernel(parameters: Parameters, name: ShaperName) -> _Kernel:
    shaping = parameters.shaping
    # An acceleration that turns from one limit to the other within the window changes by twice the limit.
    acc_max = min(shaping.acc_max_mps2, 0.5 * WINDOW_MAX_S * shaping.jerk_max_mps3)
    frequency_radps = swing_frequency_radps(parameters.cable.length_m)
    return _Kernel(
        impulses(name, frequency_radps, parameters.estimator.damping_ratio),
        2.0 * acc_max / shaping.jerk_max_mps3,
        acc_max,
    )


class _History:
    """A motion of straight velocity segments, and the integral of its position, at any instant that still matters."""

    def __init__(self, vel: Vec2) -> None:
        self._t = [0.0]
        # Integral of the position, position, velocity, and the segment's acceleration, each along north and east.
        self._rows: list[tuple[Vec2, Vec2, Vec2, Vec2]] = [((0.0, 0.0), (0.0, 0.0), vel, (0.0, 0.0))]
        self.t_s = 0.0
        self.pos: Vec2 = (0.0, 0.0)
        self.vel = vel
        self.steady_since_s = -math.inf

    def advance(self, dt_s: float, pos: Vec2, vel: Vec2) -> None:
        """Go on to a position and velocity in a straight segment."""
        acc = ((vel[0] - self.vel[0]) / dt_s, (vel[1] - self.vel[1]) / dt_s)
        total, _, _, _ = self._at(self.t_s)
        self._t.append(self.t_s)
        self._rows.append((total, self.pos, self.vel, acc))
        self.t_s += dt_s
        self.pos, self.vel = pos, vel
        if acc != (0.0, 0.0):
            self.steady_since_s = self.t_s

    def forget_before(self, t_s: float) -> None:
        """Drop what is not needed any more."""
        needless = bisect_right(self._t, t_s) - 1
        if needless > _SPARE_SEGMENTS:
            del self._t[:needless], self._rows[:needless]

    def mean(self, t_s: float, window_s: float) -> tuple[Vec2, Vec2, Vec2, Vec2]:
        """Return position, velocity, acceleration and jerk averaged over the window that ends at ``t_s``."""
        now, before = self._at(t_s), self._at(t_s - window_s)
        pos, vel, acc, jerk = (
            ((a[0] - b[0]) / window_s, (a[1] - b[1]) / window_s) for a, b in zip(now, before, strict=True)
        )
        return pos, vel, acc, jerk

    def _at(self, t_s: float) -> tuple[Vec2, Vec2, Vec2, Vec2]:
        # What was before the first segment went on as it began: steadily.
        k = max(bisect_right(self._t, t_s) - 1, 0)
        d = t_s - self._t[k]
        (Pn, Pe), (pn, pe), (vn, ve), (an, ae) = self._rows[k]
        return (
            (Pn + d * (pn + d * (vn / 2.0 + d * an / 6.0)), Pe + d * (pe + d * (ve / 2.0 + d * ae / 6.0))),
            (pn + d * (vn + d * an / 2.0), pe + d * (ve + d * ae / 2.0)),
            (vn + d * an, ve + d * ae),
            (an, ae),
        )


class Shaper:
    """Follows targets with a motion that is limited in speed, acceleration and jerk and excites no swing.

    Parameters
    ----------
    parameters : Parameters
        Limits, cable and natural damping.
    name : ShaperName
        Which impulses.
    """

    def __init__(self, parameters: Parameters, name: ShaperName) -> None:
        self._vel_max_mps = parameters.shaping.vel_max_mps
        self._wanted = self._kernel = _kernel(parameters, name)
        self._before: _Kernel | None = None
        self.begin(Target((0.0, 0.0)))

    def configure(self, parameters: Parameters, name: ShaperName) -> None:
        """Take other limits or another oscillation; the motion turns to it smoothly from where it is."""
        self._vel_max_mps = parameters.shaping.vel_max_mps
        self._wanted = _kernel(parameters, name)

    def begin(self, target: Target) -> None:
        """Begin anew, as if ``target`` had been reached long ago."""
        self._kernel, self._before = self._wanted, None
        self._history = _History(target.vel_mps)
        self._has_place = target.pos_m is not None
        # The history's positions count from here.
        self._origin: Vec2 = target.pos_m or (0.0, 0.0)
        self._origin_before = self._origin
        self._change_from_s = self._change_s = 0.0
        if target.pos_m is not None:
            # A mean over the past of a moving motion lies behind it.
            behind = _difference(self._origin, self._motion().pos_m)
            self._origin = _sum(self._origin, behind)

    @property
    def ended(self) -> bool:
        """Whether the motion is steady, and stays so unless the target changes."""
        steady_s = self._history.t_s - self._history.steady_since_s
        return steady_s > self._kernel.length_s and self._before is None

    def update(self, target: Target, dt_s: float, place_m: Vec2 | None) -> Motion:
        """Advance towards the target.

        Parameters
        ----------
        target : Target
            What is asked for now.
        dt_s : float
            Since the last call, > 0 [s].
        place_m : (2,) or None
            Where the vehicle is; a position that is asked for after velocities is approached from here.

        Returns
        -------
        Motion
            The position means something only while positions are asked for.
        """
        history = self._history
        if target.pos_m is not None and not self._has_place:
            self._place(place_m if place_m is not None else target.pos_m)
        self._has_place = target.pos_m is not None
        if self._before is None and self._wanted != self._kernel:
            self._begin_change()
        acc_max = self._kernel.acc_max_mps2
        if self._before is not None:
            acc_max = min(acc_max, self._before.acc_max_mps2)
        if target.pos_m is None:
            vel = _moved(history.vel, target.vel_mps, acc_max * dt_s)
            pos = _travelled(history.pos, history.vel, vel, dt_s)
        else:
            goal = _combined(target.pos_m, (-1.0, self._origin), (-dt_s, target.vel_mps))
            pos, vel = self._approach(goal, target.vel_mps, acc_max, dt_s)
        history.advance(dt_s, pos, vel)
        longest_s = max(kernel.length_s for kernel in (self._kernel, self._before or self._kernel))
        history.forget_before(history.t_s - longest_s)
        return self._motion()

    def _approach(self, goal: Vec2, goal_vel: Vec2, acc_max: float, dt_s: float) -> tuple[Vec2, Vec2]:
        """Next position and velocity of the slewed motion, on its way to a place that moves steadily from ``goal``."""
        history = self._history
        away = _difference(goal, history.pos)
        distance_m = math.hypot(*away)
        closing = _difference(history.vel, goal_vel)
        half_s = 0.5 * dt_s
        missed = (away[0] - half_s * closing[0], away[1] - half_s * closing[1])
        if math.hypot(*missed) <= _ARRIVED_M and math.hypot(*closing) <= acc_max * dt_s:
            return _travelled(goal, goal_vel, goal_vel, dt_s), goal_vel
        n, e = (away[0] / distance_m, away[1] / distance_m) if distance_m > 0.0 else (0.0, 0.0)
        closing_mps = closing[0] * n + closing[1] * e
        # The fastest from which the goal can still be reached without passing it, once this interval is over;
        # and in the end the one from which another interval like this ends exactly there.
        braking = BRAKING_SHARE * acc_max
        left_m = distance_m - half_s * closing_mps
        fastest = braking * (math.sqrt(max(half_s * half_s + 2.0 * left_m / braking, 0.0)) - half_s)
        speed = min(fastest, distance_m / dt_s - 0.5 * closing_mps, self._vel_max_mps)
        wanted = _limited(
            (goal_vel[0] + speed * n, goal_vel[1] + speed * e), max(self._vel_max_mps, math.hypot(*goal_vel))
        )
        vel = _moved(history.vel, wanted, acc_max * dt_s)
        return _travelled(history.pos, history.vel, vel, dt_s), vel

    # ---- the convolution

    def _convolved(self, kernel: _Kernel, origin: Vec2) -> Motion:
        now_s = self._history.t_s
        sums = [[*origin], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]
        for share, delay_s in kernel.impulses:
            for total, (n, e) in zip(sums, self._history.mean(now_s - delay_s, kernel.window_s), strict=True):
                total[0] += share * n
                total[1] += share * e
        return Motion(*((n, e) for n, e in sums))

    def _motion(self) -> Motion:
        motion = self._convolved(self._kernel, self._origin)
        if self._before is None:
            return motion
        s = (self._history.t_s - self._change_from_s) / self._change_s
        if s >= 1.0:
            self._before = None
            return motion
        # Old and new meanwhile: the new one's share and its derivatives are without a step.
        share = s**3 * (10.0 + s * (6.0 * s - 15.0))
        rate = 30.0 * (s * (1.0 - s)) ** 2 / self._change_s
        rate2 = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self._change_s**2
        before = self._convolved(self._before, self._origin_before)
        pos = _difference(motion.pos_m, before.pos_m)
        vel = _difference(motion.vel_mps, before.vel_mps)
        acc = _difference(motion.acc_mps2, before.acc_mps2)
        jerk = _difference(motion.jerk_mps3, before.jerk_mps3)
        return Motion(
            _combined(before.pos_m, (share, pos)),
            _combined(before.vel_mps, (share, vel), (rate, pos)),
            _combined(before.acc_mps2, (share, acc), (2.0 * rate, vel), (rate2, pos)),
            # What the change itself adds to the jerk is small, and nothing needs it.
            _combined(before.jerk_mps3, (share, jerk)),
        )

    def _begin_change(self) -> None:
        self._before, self._kernel = self._kernel, self._wanted
        self._origin_before = self._origin
        self._change_from_s = self._history.t_s
        self._change_s = max(CHANGE_MIN_S, CHANGE_LENGTHS * max(self._before.length_s, self._kernel.length_s))
        if not self._has_place:
            # Nobody asks where the motion is, so the two need not meet in place, only in velocity.
            apart = _difference(
                self._convolved(self._before, self._origin).pos_m, self._convolved(self._kernel, self._origin).pos_m
            )
            self._origin = _sum(self._origin, apart)

    def _place(self, place_m: Vec2) -> None:
        """Let the motion be here now."""
        shift = _difference(place_m, self._motion().pos_m)
        self._origin, self._origin_before = _sum(self._origin, shift), _sum(self._origin_before, shift)


def _sum(a: Vec2, b: Vec2) -> Vec2:
    return a[0] + b[0], a[1] + b[1]


def _difference(a: Vec2, b: Vec2) -> Vec2:
    return a[0] - b[0], a[1] - b[1]


def _combined(vector: Vec2, *terms: tuple[float, Vec2]) -> Vec2:
    n, e = vector
    for factor, (along_n, along_e) in terms:
        n, e = n + factor * along_n, e + factor * along_e
    return n, e


def _limited(vector: Vec2, size: float) -> Vec2:
    length = math.hypot(*vector)
    if length <= size:
        return vector
    return vector[0] * size / length, vector[1] * size / length


def _moved(vector: Vec2, towards: Vec2, by: float) -> Vec2:
    """Move by at most ``by``; arrive exactly."""
    step = _difference(towards, vector)
    length = math.hypot(*step)
    if length <= by:
        return towards
    return vector[0] + step[0] * by / length, vector[1] + step[1] * by / length


def _travelled(pos: Vec2, vel_0: Vec2, vel_1: Vec2, dt_s: float) -> Vec2:
    half = 0.5 * dt_s
    return pos[0] + half * (vel_0[0] + vel_1[0]), pos[1] + half * (vel_0[1] + vel_1[1])
