"""From the law's acceleration to a push that none of the autopilot's loops fights, within its limits."""

import math
from dataclasses import dataclass

from swingd.control.base import Vec2
from swingd.model.parameters import Control


def turn(vector: Vec2, angle_rad: float) -> Vec2:
    """Turn a horizontal vector about the down axis."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]


@dataclass(frozen=True, slots=True)
class Push:
    """A horizontal correction: an acceleration, its leaky integral, and the leaky integral of that."""

    acc_mps2: Vec2 = (0.0, 0.0)
    vel_mps: Vec2 = (0.0, 0.0)
    pos_m: Vec2 = (0.0, 0.0)

    def turned(self, angle_rad: float) -> "Push":
        """Turn the push about the down axis."""
        return Push(*(turn(vector, angle_rad) for vector in (self.acc_mps2, self.vel_mps, self.pos_m)))

    def leaning(self, acc_mps2: Vec2) -> "Push":
        """Add an acceleration that a force holds against: nothing moves, and no loop above needs a share of it."""
        if acc_mps2 == (0.0, 0.0):
            return self
        return Push((self.acc_mps2[0] + acc_mps2[0], self.acc_mps2[1] + acc_mps2[1]), self.vel_mps, self.pos_m)

    def scaled(self, share: float) -> "Push":
        """Take a share of the push."""
        if share == 1.0:
            return self
        (ax, ay), (vx, vy), (px, py) = self.acc_mps2, self.vel_mps, self.pos_m
        return Push((share * ax, share * ay), (share * vx, share * vy), (share * px, share * py))


NO_PUSH = Push()


class Correction:
    """Acceleration and its leaky integrals, washed out, limited in size, slew and jerk, and faded.

    All vectors lie in the level frame that does not turn, so that no yaw, nor a reset of it, changes what was given.
    """

    def __init__(self, control: Control) -> None:
        self.configure(control)
        self.reset()

    def configure(self, control: Control) -> None:
        """Take other limits; what is being given goes on from where it is."""
        self._control = control

    def reset(self) -> None:
        """Start from zero."""
        self._wanted: Vec2 = (0.0, 0.0)
        self._slow: Vec2 = (0.0, 0.0)
        self._acc: Vec2 = (0.0, 0.0)
        self._vel: Vec2 = (0.0, 0.0)
        self._pos: Vec2 = (0.0, 0.0)
        self.limited = False
        """Whether a limit of acceleration or velocity held the last push."""
        self.displaced = False
        """Whether that of the displacement did."""

    def update(self, wanted_mps2: Vec2 | None, fade: float, dt_s: float) -> Push:
        """Take the law's acceleration; return what to add to the setpoint.

        Parameters
        ----------
        wanted_mps2 : (2,)
            What the law asks for; None where it may not be asked: what it asked last is then faded.
        fade : float
            0 (nothing leaves) to 1.
        dt_s : float
            Since the last call [s].
        """
        control = self._control
        if fade <= 0.0:
            self.reset()
            return NO_PUSH
        # The slow part starts at zero: a wind that holds the load aside is washed out, a swing at entry is answered.
        slow_x, slow_y = self._slow
        if wanted_mps2 is not None:
            self._wanted = wanted_mps2
            blend = dt_s / (dt_s + control.washout_s)
            slow_x += blend * (wanted_mps2[0] - slow_x)
            slow_y += blend * (wanted_mps2[1] - slow_y)
            self._slow = (slow_x, slow_y)
        wanted = (fade * (self._wanted[0] - slow_x), fade * (self._wanted[1] - slow_y))
        target = limited(wanted, control.acc_max_mps2)
        step = limited((target[0] - self._acc[0], target[1] - self._acc[1]), control.jerk_max_mps3 * dt_s)
        self._acc = (self._acc[0] + step[0], self._acc[1] + step[1])
        kept = math.exp(-dt_s / control.velocity_leak_s)
        faster = kept * self._vel[0] + self._acc[0] * dt_s, kept * self._vel[1] + self._acc[1] * dt_s
        self._vel = limited(faster, control.vel_max_mps)
        vel = (fade * self._vel[0], fade * self._vel[1])
        farther = kept * self._pos[0] + vel[0] * dt_s, kept * self._pos[1] + vel[1] * dt_s
        self._pos = limited(farther, control.displacement_max_m)
        self.limited = target != wanted or (self._vel != faster and control.vel_max_mps > 0.0)
        self.displaced = self._pos != farther
        return Push(self._acc, vel, (fade * self._pos[0], fade * self._pos[1]))


def limited(vector: Vec2, size: float) -> Vec2:
    """Shorten a vector to a length."""
    length = math.hypot(*vector)
    if length <= size:
        return vector
    return vector[0] * size / length, vector[1] * size / length
