"""The load's mass: what the thrust seems to carry, what the swing shows, and what both tell together."""

import math
from collections import deque
from dataclasses import dataclass
from statistics import fmean, stdev

import numpy as np

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import Vec3

BLOCK_S = 0.25
"""The apparent mass is averaged over blocks of this length."""
EMPTY_BLOCKS_MIN = 4
EMPTY_BLOCKS_MAX = 40
TUG_BLOCKS = 2
"""The last blocks before a pick-up was noticed may have it in them."""
BOUNCE_BLOCKS = 4
"""The first blocks after it have the jerk of the cable."""
LOADED_BLOCKS = 20
QUIET_MPS = 2.0
"""Slower than this, in any direction, the air's unknown part in the lift is small."""
SCALE_STD = 0.005
"""Of the thrust scale between two moments of one flight: the curve's shape, drag that nobody told, ground effect."""
SCALE_DRIFT_PER_S = 3e-4
"""What the battery does to it meanwhile, beyond its voltage."""
AGREE_SHARE = 0.5
"""Thrust and swing may differ by this share and three deviations: the swing's regression sees wide swings too light."""

SWING_MEMORY_S = 15.0
SWING_POLES = 1.5
"""Filter's poles over the pendulum's frequency."""
SWING_HIGH_PASS = 0.25
"""Corner of the high-pass over the pendulum's frequency: steady wind and tilt errors tell nothing."""


SMOOTHING_S = 0.02
"""Vibration squared would count as weight: 4 m/s^2 in the mean accelerations feigned the loss of 0.3 kg under 2 kg."""


class ApparentMass:
    """Mass beyond the vehicle's that the lift seems to carry, by least squares that forget.

    Lift and acceleration obey L + m (z - g) = m_app (g - z). In free fall the right-hand side says nothing and weighs
    nothing, so that the answer stays; in a climb it weighs more. A thrust curve that is wrong by a share e adds
    e (m + m_l), whatever the manoeuvre. The same holds of both behind one low-pass, which leaves vibration out.
    """

    def __init__(self, mass_kg: float) -> None:
        self._mass_kg = mass_kg
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._product, self._square = 0.0, 0.0
        self._smooth: tuple[float, float] | None = None

    def update(self, dt_s: float, lift_n: float, acc_down_mps2: float, time_constant_s: float = math.inf) -> float:
        """Take a step with the lift [N] and the vehicle's acceleration down; return the apparent mass [kg]."""
        felt_mps2 = GRAVITY_MPS2 - acc_down_mps2
        if self._smooth is not None:
            followed = -math.expm1(-dt_s / SMOOTHING_S)
            lift_before_n, felt_before_mps2 = self._smooth
            lift_n = lift_before_n + followed * (lift_n - lift_before_n)
            felt_mps2 = felt_before_mps2 + followed * (felt_mps2 - felt_before_mps2)
        self._smooth = lift_n, felt_mps2
        kept = math.exp(-dt_s / time_constant_s)
        self._product = kept * self._product + dt_s * felt_mps2 * (lift_n - self._mass_kg * felt_mps2)
        self._square = kept * self._square + dt_s * felt_mps2 * felt_mps2
        return self.value_kg

    @property
    def value_kg(self) -> float:
        """Apparent mass; 0 where nothing is known."""
        return self._product / self._square if self._square > 0.0 else 0.0


class SwingMass:
    """Mass that hangs on the cable, from how its pull answers the vehicle's motion, whatever the thrust's size.

    The small swing of a load under a hook with the acceleration z pulls with F'' + omega^2 F = -m_l omega^2 z, where
    omega^2 = g / L. Across the thrust's axis the accelerometer shows o = F - m_l g b with b the horizontal part of that
    axis, so that

        (s^2 + omega^2) o = -m_l (omega^2 z + g (s^2 + omega^2) b)

    is linear in m_l. Both sides pass a filter with three poles, after which the swing's beginning is forgotten, and
    a least-squares fit with a memory. Drag and wind on the vehicle are noise in it.

    Parameters
    ----------
    mass_kg : float
        Vehicle without load.
    length_m : float
        Cable.
    """

    def __init__(self, mass_kg: float, length_m: float) -> None:
        self._mass_kg = mass_kg
        self._omega2 = GRAVITY_MPS2 / length_m
        omega = math.sqrt(self._omega2)
        self._pole = SWING_POLES * omega
        self._high_pass = SWING_HIGH_PASS * omega
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._filters = np.zeros((4, 6))
        self._yf = self._ff = self._yy = 0.0
        self._t_s = 0.0

    def update(self, dt_s: float, force_n: Vec3, acc_mps2: Vec3, body_down: Vec3) -> None:
        """Take a step, level frame: thrust and known drag, acceleration of the hook, body's down axis."""
        m = self._mass_kg
        rest = (
            m * acc_mps2[0] - force_n[0],
            m * acc_mps2[1] - force_n[1],
            m * (acc_mps2[2] - GRAVITY_MPS2) - force_n[2],
        )
        along = rest[0] * body_down[0] + rest[1] * body_down[1] + rest[2] * body_down[2]
        across = (rest[0] - along * body_down[0], rest[1] - along * body_down[1])
        signal = (
            *across,
            *acc_mps2[:2],
            GRAVITY_MPS2 * body_down[0],
            GRAVITY_MPS2 * body_down[1],
        )
        filters = self._filters
        slow, first, second, third = filters
        slow += (1.0 - math.exp(-self._high_pass * dt_s)) * (signal - slow)
        blend = 1.0 - math.exp(-self._pole * dt_s)
        first += blend * (signal - slow - first)
        second += blend * (first - second)
        third += blend * (second - third)
        swung = self._pole**2 * (first - 2.0 * second + third) + self._omega2 * third
        y = swung[:2]
        f = -(self._omega2 * third[2:4] + swung[4:])
        self._t_s += dt_s
        if self._t_s < 2.0 / self._high_pass:
            # The filters still swing in.
            return
        kept = math.exp(-dt_s / SWING_MEMORY_S)
        self._yf = kept * self._yf + dt_s * float(y @ f)
        self._ff = kept * self._ff + dt_s * float(f @ f)
        self._yy = kept * self._yy + dt_s * float(y @ y)

    def value(self) -> tuple[float, float]:
        """Return mass and deviation [kg]; the deviation is infinite where nothing swung."""
        if self._ff <= 0.0:
            return 0.0, math.inf
        mass_kg = self._yf / self._ff
        residual = max(self._yy - mass_kg * self._yf, 0.0)
        # The residual stays alike for about two of the filter's time constants.
        span_s = min(max(self._t_s - 2.0 / self._high_pass, 1e-3), SWING_MEMORY_S)
        return mass_kg, math.sqrt(residual / self._ff * 2.0 / (self._pole * span_s))


@dataclass(frozen=True, slots=True)
class MassEstimate:
    """The load's mass as far as the flight tells."""

    mass_kg: float | None
    """None where it is not known."""
    std_kg: float | None
    reason: str
    """How it was found, or why it is not known."""


class Weighing:
    """Weighs the load: hover thrust with it against hover thrust without it, shortly before.

    With a thrust curve that is wrong by a share e the apparent mass without load is e m, with it m_l + e (m + m_l); the
    scale is frozen in the first. Without that moment scale and mass look alike.
    """

    def __init__(self, mass_kg: float) -> None:
        self._mass_kg = mass_kg
        self._block = ApparentMass(mass_kg)
        self.reset()

    def reset(self) -> None:
        """The vehicle stands."""
        self._empty: deque[float] = deque(maxlen=EMPTY_BLOCKS_MAX)
        self._loaded: list[float] = []
        self._begin_block()
        self._hangs = False
        self._age_s = 0.0
        self.estimate = MassEstimate(None, None, "no load hangs")

    def _begin_block(self) -> None:
        self._block.reset()
        self._block_s = 0.0

    def lifted(self) -> None:
        """The load was seen to be lifted, or to hang."""
        self._begin_block()
        self._hangs = True
        for _ in range(min(TUG_BLOCKS, len(self._empty))):
            self._empty.pop()
        self._loaded = []
        self._age_s = 0.0
        known = len(self._empty) >= EMPTY_BLOCKS_MIN
        why = (
            "no quiet flight yet since the pick-up"
            if known
            else "no flight without it before: mass and scale look alike"
        )
        self.estimate = MassEstimate(None, None, why)

    def lost(self) -> None:
        """The load was released or set down: the scale is taken anew, and frozen before the next pick-up."""
        self._begin_block()
        self._hangs = False
        self._empty.clear()
        self.estimate = MassEstimate(None, None, "no load hangs")

    def update(
        self, dt_s: float, lift_n: float, acc_down_mps2: float, vel_mps: Vec3 | None, swing: tuple[float, float]
    ) -> None:
        """Take one filter step in flight; ``swing`` is what `SwingMass` says."""
        self._age_s += dt_s
        if vel_mps is None or math.hypot(*vel_mps) > QUIET_MPS:
            self._begin_block()
        else:
            apparent_kg = self._block.update(dt_s, lift_n, acc_down_mps2)
            self._block_s += dt_s
            if self._block_s >= BLOCK_S - 1e-9:
                self._begin_block()
                self._take(apparent_kg)
        weighed = self.estimate.mass_kg
        if weighed is not None and abs(weighed - swing[0]) > AGREE_SHARE * weighed + 3.0 * swing[1]:
            why = f"thrust says {weighed:.2g} kg, the swing {swing[0]:.2g} kg"
            self.estimate = MassEstimate(None, None, why)

    def _take(self, apparent_kg: float) -> None:
        if not self._hangs:
            self._empty.append(apparent_kg)
            return
        if len(self._empty) < EMPTY_BLOCKS_MIN or len(self._loaded) >= BOUNCE_BLOCKS + LOADED_BLOCKS:
            return
        self._loaded.append(apparent_kg)
        if len(self._loaded) < BOUNCE_BLOCKS + LOADED_BLOCKS:
            return
        loaded = self._loaded[BOUNCE_BLOCKS:]
        empty_kg, loaded_kg = fmean(self._empty), fmean(loaded)
        total_kg = (loaded_kg + self._mass_kg) / (1.0 + empty_kg / self._mass_kg)
        # Neighbouring blocks are alike: half of them count.
        empty_std = stdev(self._empty) * math.sqrt(2.0 / len(self._empty)) / self._mass_kg
        loaded_std = stdev(loaded) * math.sqrt(2.0 / len(loaded))
        scale_std = math.hypot(empty_std, SCALE_STD, SCALE_DRIFT_PER_S * self._age_s)
        mass_kg = total_kg - self._mass_kg
        if mass_kg > 0.0:
            self.estimate = MassEstimate(mass_kg, math.hypot(loaded_std, scale_std * total_kg), "weighed by thrust")
