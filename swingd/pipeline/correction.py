"""From the law's acceleration to a pair that the autopilot's velocity loop does not fight, within its limits."""

import math

from swingd.control.base import Vec2
from swingd.model.parameters import Control


class Correction:
    """Acceleration and its leaky integral as velocity, washed out, limited in size, slew and jerk, and faded.

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

    def update(self, wanted_mps2: Vec2 | None, fade: float, dt_s: float) -> tuple[Vec2, Vec2]:
        """Take the law's acceleration; return acceleration [m/s^2] and velocity [m/s] to add to the setpoint.

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
            return (0.0, 0.0), (0.0, 0.0)
        # The slow part starts at zero: a wind that holds the load aside is washed out, a swing at entry is answered.
        slow_x, slow_y = self._slow
        if wanted_mps2 is not None:
            self._wanted = wanted_mps2
            blend = dt_s / (dt_s + control.washout_s)
            slow_x += blend * (wanted_mps2[0] - slow_x)
            slow_y += blend * (wanted_mps2[1] - slow_y)
            self._slow = (slow_x, slow_y)
        target = _limit((fade * (self._wanted[0] - slow_x), fade * (self._wanted[1] - slow_y)), control.acc_max_mps2)
        step = _limit((target[0] - self._acc[0], target[1] - self._acc[1]), control.jerk_max_mps3 * dt_s)
        self._acc = (self._acc[0] + step[0], self._acc[1] + step[1])
        kept = math.exp(-dt_s / control.velocity_leak_s)
        self._vel = _limit(
            (kept * self._vel[0] + self._acc[0] * dt_s, kept * self._vel[1] + self._acc[1] * dt_s), control.vel_max_mps
        )
        return self._acc, (fade * self._vel[0], fade * self._vel[1])


def _limit(vector: Vec2, size: float) -> Vec2:
    length = math.hypot(*vector)
    if length <= size:
        return vector
    return vector[0] * size / length, vector[1] * size / length
