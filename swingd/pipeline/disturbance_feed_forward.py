"""From the estimated disturbance to an acceleration that leans the vehicle against it."""

import math

from swingd.control.base import Vec2
from swingd.core.constants import GRAVITY_MPS2
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.parameters import Parameters
from swingd.pipeline.correction import limited

LIFT_MIN_SHARE = 0.3
"""Of the vehicle's weight: below it the thrust is no measure of what a tilt does."""


class DisturbanceFeedForward:
    """Leans against what has changed of the horizontal force since it began to.

    An autopilot turns a horizontal acceleration setpoint a into a tilt a / g, whose horizontal force is a / g times the
    vertical thrust. So the force is divided by the thrust that flies, and no mass is needed. Only the slow part is fed
    forward: behind the low-pass the pull of a swinging load comes late, and leaning late against it damps the swing.

    What was there before is held by the integrator of the autopilot's velocity loop already: it would be leaned against
    twice until that gives way.

    Parameters
    ----------
    parameters : Parameters
        Disturbance, vehicle, the autopilot's velocity loop.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.configure(parameters)
        self.forget()

    def configure(self, parameters: Parameters) -> None:
        """Take other parameters; what is being given goes on from where it is."""
        disturbance, autopilot = parameters.disturbance, parameters.autopilot
        self._time_constant_s = disturbance.time_constant_s
        self._acc_max_mps2 = disturbance.acc_max_mps2
        self._jerk_max_mps3 = parameters.control.jerk_max_mps3
        self._lift_min_n = LIFT_MIN_SHARE * parameters.vehicle.mass_kg * GRAVITY_MPS2
        self._held_s = autopilot.velocity_p / autopilot.velocity_i if autopilot.velocity_i > 0.0 else math.inf
        """In which the velocity loop's integrator takes over what pushes the vehicle."""

    def forget(self) -> None:
        """Nothing is known of the force any more."""
        self._slow: Vec2 | None = None
        self._held: Vec2 = (0.0, 0.0)
        self._acc: Vec2 = (0.0, 0.0)

    def cut(self) -> None:
        """Nothing follows it any more: the next one rises from zero. What is known of the force stays."""
        self._acc = (0.0, 0.0)

    def update(self, estimate: DisturbanceEstimate | None, lift_n: float, fade: float, dt_s: float) -> Vec2:
        """Take the estimate of one step; return the acceleration to set against it.

        Parameters
        ----------
        estimate : DisturbanceEstimate or None
            None, or one that is in doubt: the last one is kept while it fades.
        lift_n : float
            Vertical part of the thrust [N].
        fade : float
            0 (nothing leaves) to 1.
        dt_s : float
            Since the last call [s].

        Returns
        -------
        (2,)
            North and east [m/s^2].
        """
        if estimate is not None and not estimate.doubt and lift_n > self._lift_min_n:
            self._follow(estimate, lift_n, held=fade > 0.0, dt_s=dt_s)
        elif fade <= 0.0:
            self.forget()
        if fade <= 0.0 or self._slow is None:
            self._acc = (0.0, 0.0)
            return self._acc
        wanted = (fade * (self._held[0] - self._slow[0]), fade * (self._held[1] - self._slow[1]))
        target = limited(wanted, self._acc_max_mps2)
        step = limited((target[0] - self._acc[0], target[1] - self._acc[1]), self._jerk_max_mps3 * dt_s)
        self._acc = (self._acc[0] + step[0], self._acc[1] + step[1])
        return self._acc

    def _follow(self, estimate: DisturbanceEstimate, lift_n: float, *, held: bool, dt_s: float) -> None:
        north_n, east_n, _ = estimate.force_ned_n
        now = (north_n * GRAVITY_MPS2 / lift_n, east_n * GRAVITY_MPS2 / lift_n)
        if self._slow is None:
            self._slow = now
            self._held = (0.0, 0.0) if math.isinf(self._held_s) else now
            return
        self._slow = _blended(self._slow, now, dt_s / (dt_s + self._time_constant_s))
        if not held and not math.isinf(self._held_s):
            self._held = _blended(self._held, now, dt_s / (dt_s + self._held_s))


def _blended(old: Vec2, new: Vec2, share: float) -> Vec2:
    return old[0] + share * (new[0] - old[0]), old[1] + share * (new[1] - old[1])
