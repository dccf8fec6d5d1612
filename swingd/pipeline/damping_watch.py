"""Whether the correction does what it is for: it must not drive the swing that it is to damp.

Three signs of a correction that does harm, each judged while it is in the setpoints:

- **The swing grows.** The speed amplitude s of the swing, s^2 = r'^2 + (g / L) r^2 with r the load's displacement from
  the hook, has grown from each half period to the next over two periods, and what the application asked for does not
  explain it. That is known from a twin: the pendulum below a vehicle that follows the application's reference alone.
- **It sits at a limit** for a whole period: what is asked for is not what is given.
- **The vehicle does not follow it.** By a regression of the tilt of the thrust on the correction, both after the
  autopilot's velocity loop and up to a constant, the vehicle answers a push with g times it. g is near 1; where
  it is surely below `GAIN_MIN`, as with a reversed axis, the correction is not what moves the vehicle.
"""

import itertools
import math
from collections import deque
from dataclasses import dataclass

from swingd.control.base import Vec2
from swingd.control.nominal import swing_frequency_radps
from swingd.control.placed import ATTITUDE_DAMPING, attitude_bandwidth_radps
from swingd.model.parameters import Parameters
from swingd.pipeline.correction import Push, turn

GROWTH_MIN = 1.1
"""From one half period's peak to the next one's."""
HALF_PERIODS = 4
UNEXPLAINED_SHARE = 1.2
"""Of the twin's swing: what is beyond is not explained by what the application asked for."""
UNEXPLAINED_MPS = 0.3
"""What wind may add to it."""
GROWN_MPS = 0.5
"""A smaller swing is not judged: noise grows too."""
GAIN_MIN = 0.2
GAIN_PLAUSIBLE = -3.0
"""What a much smaller push seems to make is made by something else."""
GAIN_DEVIATIONS = 2.0
"""Flights with wind, gusts, a wrong load and 0.15 s of extra delay stay 1.4 deviations and more above `GAIN_MIN`."""
ANSWER_NOISE_MPS2 = 0.15
"""Of the tilt's acceleration: turbulence and the attitude's noise."""
ANSWER_MODEL_SHARE = 0.2
"""Of what the application's reference should make of the tilt: the model is no better."""
ANSWERS_MIN = 3.0
"""Independent ones, before there is anything to judge."""
ANSWER_CORRELATION_S = 0.1
"""Residuals closer than this say the same."""
_ZERO: Vec2 = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Motion:
    """One step of what is asked for, given and seen; all vectors horizontal, in one frame that does not turn."""

    dt_s: float
    load_m: Vec2
    """Displacement of the load from the hook."""
    load_rate_mps: Vec2
    vel_mps: Vec2
    """Of the vehicle."""
    vel_ref_mps: Vec2 | None
    """Velocity that the application's reference asks for, by its position too; None where it closes no such loop."""
    acc_ref_mps2: Vec2
    """Acceleration that it asks for besides."""
    lean_mps2: Vec2
    """Acceleration that is set against a disturbance: the tilt follows it, and the vehicle does not move by it."""
    tilt_acc_mps2: Vec2
    """Acceleration that the tilted thrust makes."""
    heading_rad: float
    """Of the nose in this frame."""
    push: Push
    """What was added to the reference."""
    limited: bool
    """Whether a limit holds the push."""


class DampingWatch:
    """Watches a correction that is being given, and distrusts it for good where it does harm.

    Parameters
    ----------
    parameters : Parameters
        Cable, natural damping, the autopilot's velocity loop.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.distrust = ""
        """Why the correction must stay off until it is enabled again; empty where it need not."""
        self.configure(parameters)

    def configure(self, parameters: Parameters) -> None:
        """Take other parameters; what has been judged stays."""
        self._omega = swing_frequency_radps(parameters.cable.length_m)
        self._period_s = 2.0 * math.pi / self._omega
        self._damping = parameters.estimator.damping_ratio
        self._velocity_p = parameters.autopilot.velocity_p
        self._bandwidth = attitude_bandwidth_radps(parameters.autopilot)
        self.rest()

    def enabled(self) -> None:
        """The user wants the correction, whatever was judged before."""
        self.distrust = ""
        self.rest()

    def rest(self) -> None:
        """No correction is given: nothing is judged, and the next one begins anew."""
        self._twin: _Twin | None = None
        self._peaks: deque[tuple[float, float]] = deque(maxlen=HALF_PERIODS + 1)
        self._peak, self._twin_peak, self._peak_s = 0.0, 0.0, 0.0
        self._limited_s = 0.0
        self._asked: _Lag | None = None
        self._pushed = _Lag(_ZERO)
        self._answers = (_Answer(), _Answer())

    def update(self, motion: Motion) -> None:
        """Take one step with a correction in the setpoints."""
        if self._twin is None:
            self._twin = _Twin(motion)
        self._limited_s = self._limited_s + motion.dt_s if motion.limited else 0.0
        if self._limited_s > self._period_s:
            self._distrust("it has sat at a limit for a whole period")
        if self._grows(motion):
            self._distrust("the swing has grown over two periods")
        gain = self._unanswered_gain(motion)
        if gain is not None:
            self._distrust(f"the vehicle answers it by {gain:+.1f} of what was asked")

    def _distrust(self, why: str) -> None:
        self.distrust = self.distrust or why

    def _grows(self, motion: Motion) -> bool:
        """Whether each half period's peak has been higher than the one before, beyond what the reference explains."""
        assert self._twin is not None
        twin = self._twin.step(motion, self._omega, self._damping, self._velocity_p, self._bandwidth)
        speed = _speed_amplitude(motion.load_m, motion.load_rate_mps, self._omega)
        self._peak, self._twin_peak = max(self._peak, speed), max(self._twin_peak, twin)
        self._peak_s += motion.dt_s
        if self._peak_s < 0.5 * self._period_s:
            return False
        self._peaks.append((self._peak, self._twin_peak))
        self._peak, self._twin_peak, self._peak_s = 0.0, 0.0, 0.0
        if len(self._peaks) <= HALF_PERIODS:
            return False
        speeds = [peak for peak, _ in self._peaks]
        explained = UNEXPLAINED_SHARE * max(twin for _, twin in self._peaks) + UNEXPLAINED_MPS
        grown = all(after > GROWTH_MIN * before for before, after in itertools.pairwise(speeds))
        return grown and speeds[-1] > max(GROWN_MPS, explained)

    def _unanswered_gain(self, motion: Motion) -> float | None:
        """Gain of the vehicle's answer to the correction on the axis where it is surely too small, if there is one."""
        asked, pushed = _sum(motion.acc_ref_mps2, motion.lean_mps2), motion.push.acc_mps2
        if motion.vel_ref_mps is not None:
            p = self._velocity_p
            asked = _sum(asked, _scaled(p, _sum(motion.vel_ref_mps, _scaled(-1.0, motion.vel_mps))))
            pushed = _sum(pushed, _scaled(p, motion.push.vel_mps))
        if self._asked is None:
            # The vehicle has been following the reference before there was a correction.
            self._asked = _Lag(asked)
        expected = self._pushed.step(pushed, self._bandwidth, motion.dt_s)
        reference = self._asked.step(asked, self._bandwidth, motion.dt_s)
        rest = _sum(motion.tilt_acc_mps2, _scaled(-1.0, reference))
        expected, rest, reference = (turn(v, -motion.heading_rad) for v in (expected, rest, reference))
        gains = [
            answer.update(e, r, known, motion.dt_s, self._period_s)
            for answer, e, r, known in zip(self._answers, expected, rest, reference, strict=True)
        ]
        return min((gain for gain in gains if gain is not None), default=None)


class _Twin:
    """The pendulum below a vehicle that follows the application's reference alone; both axes."""

    def __init__(self, motion: Motion) -> None:
        # It begins with the swing that there is, and with the vehicle as it flies.
        self._load, self._rate = motion.load_m, motion.load_rate_mps
        self._vel = motion.vel_mps
        self._tilt = _Lag(motion.tilt_acc_mps2)

    def step(self, motion: Motion, omega: float, damping: float, velocity_p: float, bandwidth: float) -> float:
        """Advance by one step; return the speed amplitude of its swing [m/s]."""
        dt_s = motion.dt_s
        asked = motion.acc_ref_mps2
        if motion.vel_ref_mps is not None:
            asked = _sum(asked, _scaled(velocity_p, _sum(motion.vel_ref_mps, _scaled(-1.0, self._vel))))
        acc = self._tilt.step(asked, bandwidth, dt_s)
        self._vel = _sum(self._vel, _scaled(dt_s, acc))
        pull = _scaled(-omega * omega, self._load)
        self._rate = _sum(
            self._rate, _scaled(dt_s, _sum(pull, _sum(_scaled(-2.0 * damping * omega, self._rate), _scaled(-1.0, acc))))
        )
        self._load = _sum(self._load, _scaled(dt_s, self._rate))
        return _speed_amplitude(self._load, self._rate, omega)


class _Lag:
    """The attitude loop: second order, both axes; semi-implicit Euler, stable for steps far below its period."""

    def __init__(self, value: Vec2) -> None:
        self._value = value
        self._rate: Vec2 = _ZERO

    def step(self, target: Vec2, omega: float, dt_s: float) -> Vec2:
        step = omega * dt_s
        kept = 1.0 / (1.0 + 2.0 * ATTITUDE_DAMPING * step + step * step)
        ahead = _sum(target, _scaled(-1.0, self._value))
        self._rate = _scaled(kept, _sum(self._rate, _scaled(omega * step, ahead)))
        self._value = _sum(self._value, _scaled(dt_s, self._rate))
        return self._value


class _Answer:
    """Weighted regression of what the tilt does beyond the reference on what the correction should make it do.

    Its constant takes what is slow: wind, trim, and what the autopilot's integrator makes of them.
    """

    def __init__(self) -> None:
        self._count = 0.0
        self._w = self._wx = self._wy = 0.0
        self._wxx = self._wxy = self._wyy = 0.0

    def update(self, x: float, y: float, reference: float, dt_s: float, memory_s: float) -> float | None:
        """Take one step; return the gain if it is surely below `GAIN_MIN`.

        Parameters
        ----------
        x, y : float
            What the correction should make the tilt do, and what it does beyond the reference [m/s^2].
        reference : float
            What the reference should make it do [m/s^2].
        dt_s, memory_s : float
            Step, and the time constant by which older steps are forgotten [s].
        """
        kept = math.exp(-dt_s / memory_s)
        weight = dt_s / (ANSWER_CORRELATION_S * (ANSWER_NOISE_MPS2**2 + (ANSWER_MODEL_SHARE * reference) ** 2))
        self._count = kept * self._count + dt_s / ANSWER_CORRELATION_S
        self._w = kept * self._w + weight
        self._wx = kept * self._wx + weight * x
        self._wy = kept * self._wy + weight * y
        self._wxx = kept * self._wxx + weight * x * x
        self._wxy = kept * self._wxy + weight * x * y
        self._wyy = kept * self._wyy + weight * y * y
        xx = self._wxx - self._wx * self._wx / self._w
        xy = self._wxy - self._wx * self._wy / self._w
        yy = self._wyy - self._wy * self._wy / self._w
        if not GAIN_MIN * xx > xy > GAIN_PLAUSIBLE * xx or self._count < ANSWERS_MIN:
            return None
        # Where the rest is larger than the noise and no gain makes it fit, the model is to blame and not the vehicle.
        misfit = max(1.0, (yy - xy * xy / xx) / self._count)
        if xy + GAIN_DEVIATIONS * math.sqrt(misfit * xx) >= GAIN_MIN * xx:
            return None
        return xy / xx


def _speed_amplitude(load_m: Vec2, load_rate_mps: Vec2, omega: float) -> float:
    return math.hypot(*load_rate_mps, omega * load_m[0], omega * load_m[1])


def _sum(a: Vec2, b: Vec2) -> Vec2:
    return a[0] + b[0], a[1] + b[1]


def _scaled(share: float, vector: Vec2) -> Vec2:
    return share * vector[0], share * vector[1]
