"""The law that needs no tuning: its two gains place the swing's poles in the autopilot's closed velocity loop.

Linear model of one horizontal axis, r the load's displacement ahead of the hook, a the vehicle's acceleration:

    r'' = -(g / L) r - a                                        the pendulum
    a   = M/m G(s) a_sp + (m_l / m)(g / L) r                     tilted thrust of M g, and the cable's pull
    a_sp = -(Kp + Ki/s + Kd s)/s a + B(s) a_pc                   the autopilot's velocity loop, and feed-forward
    B(s) = 1 + (Kp + Ki/s) T/(1 + s T)                           acceleration and its leaky integral as velocity
    a_pc = s Tw/(1 + s Tw) exp(-s d) (kp + kd s) r               washout, age of the estimate, the law

G is the attitude loop, second order with damping 0.6. The characteristic equation is linear in kp + kd s, so a wanted
complex pole gives both gains at once.
"""

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from swingd.control.base import Vec2
from swingd.core.constants import GRAVITY_MPS2
from swingd.model.parameters import Autopilot, Parameters

ATTITUDE_DAMPING = 0.6
"""Of the attitude loop, taken as second order."""
_DELAY_MIN_S = 1e-4
"""A shorter delay is none."""
_PHASE_MAX = 4.0
"""Modulus of a wanted pole times the delay: beyond it the answer comes a good half cycle late."""
_SETTLED_SHARE = 0.02
"""Of the swing's frequency: poles slower than this belong to the integrator, the leak and the washout."""
_STANDING_SHARE = 1e-6
"""Of the natural frequency: a pole slower than this stands still, and its damping means nothing."""
_MARGIN = 0.4
"""Least distance of the loop's frequency response from -1."""
_BANDWIDTH_SHARE = 0.45
"""Of the attitude loop's frequency: a swing that is made faster than this outruns what damps it, and rings on."""
_RATIO_STEPS = 20
_FREQUENCY_SHARES = (1.0, 0.9, 0.8, 0.7)


@dataclass(frozen=True, slots=True)
class PlacedDesign:
    """Gains of the placed law and what they promise."""

    kp_per_s2: float
    """Acceleration per displacement of the load."""
    kd_per_s: float
    """Acceleration per velocity of the load relative to the vehicle; 0 where no correction would help."""
    damping_ratio: float
    """Of the swing's poles with the correction."""
    frequency_radps: float
    """Modulus of the swing's poles with the correction."""
    damping_ratio_off: float
    """Of the swing's poles in the autopilot's own loop."""
    frequency_off_radps: float
    poles: tuple[complex, ...]
    """All poles of the model with the correction, the delay as a Padé approximation [1/s]."""


@dataclass(frozen=True, slots=True)
class _Loop:
    """Characteristic equation own(s) + path(s) exp(-s delay) (kp + kd s) = 0, without common roots at zero."""

    own: Polynomial
    """Without correction, times the denominators of the correction."""
    path: Polynomial
    delay_s: float
    natural_radps: float
    """Of the load below a vehicle that thrust only carries."""
    bandwidth_radps: float
    """Of the attitude loop."""

    def closed(self, kp: float, kd: float) -> Polynomial:
        """Characteristic polynomial with correction, the delay as a Padé approximation."""
        half = 0.5 * self.delay_s
        ahead = behind = Polynomial([1.0])
        if self.delay_s >= _DELAY_MIN_S:
            ahead, behind = Polynomial([1.0, -half, half**2 / 3.0]), Polynomial([1.0, half, half**2 / 3.0])
        return self.own * behind + self.path * Polynomial([kp, kd]) * ahead

    def gains(self, pole: complex) -> tuple[float, float]:
        """The gains that make ``pole`` a root, the delay exact."""
        value = complex(-self.own(pole) / (self.path(pole) * cmath.exp(-pole * self.delay_s)))
        kd = value.imag / pole.imag
        return value.real - kd * pole.real, kd

    def robust(self, kp: float, kd: float) -> bool:
        """Tell whether the loop with its exact delay is stable and keeps its distance from -1 (Nyquist)."""
        fastest = max(self.natural_radps, self.bandwidth_radps)
        s = 1j * np.geomspace(1e-4 * self.natural_radps, 1e2 * fastest, 4000)
        own = self.own(s)
        closed = own + self.path(s) * (kp + kd * s) * np.exp(-s * self.delay_s)
        # Of all roots left of the axis the argument turns by a quarter per degree; each on the right takes half a turn.
        turned = np.unwrap(np.angle(closed / (s + self.natural_radps) ** self.own.degree()))
        unstable = round(float(turned[0] - turned[-1]) / math.pi)
        return unstable == 0 and float(np.min(np.abs(closed / own))) >= _MARGIN

    def poles(self, polynomial: Polynomial) -> list[complex]:
        """Roots that move, found in a unit of time that keeps the coefficients within reach of each other."""
        coefficients = np.asarray(polynomial.coef, dtype=float)
        scaled = Polynomial(coefficients * self.natural_radps ** np.arange(coefficients.size))
        roots = [complex(root) for root in np.asarray(scaled.roots(), dtype=complex)]
        return [root * self.natural_radps for root in roots if abs(root) > _STANDING_SHARE]


def attitude_bandwidth_radps(autopilot: Autopilot) -> float:
    """Give the natural frequency of the attitude loop whose delay at low frequencies is the autopilot's [rad/s]."""
    return 2.0 * ATTITUDE_DAMPING / max(autopilot.acceleration_delay_s, 1e-3)


def _loop(parameters: Parameters) -> _Loop:
    """Build the polynomials of (s^2 + g/L)(1 + M/m G W) + (m_l/m)(g/L) = -M/m G B C (kp + kd s)."""
    autopilot, control = parameters.autopilot, parameters.control
    ratio = parameters.payload.mass_kg / parameters.vehicle.mass_kg
    stiffness = GRAVITY_MPS2 / parameters.cable.length_m
    bandwidth = attitude_bandwidth_radps(autopilot)
    leak, washout = control.velocity_leak_s, control.washout_s
    s = Polynomial([0.0, 1.0])
    G_den = s**2 / bandwidth**2 + 2.0 * ATTITUDE_DAMPING / bandwidth * s + 1.0
    pi = autopilot.velocity_p * s + autopilot.velocity_i
    W_num = autopilot.velocity_d * s**2 + pi
    B_num, B_den = s * (1.0 + leak * s) + pi * leak, s * (1.0 + leak * s)
    C_num, C_den = washout * s, 1.0 + washout * s
    plant = (s**2 + stiffness) * (s**2 * G_den + (1.0 + ratio) * W_num) + ratio * stiffness * s**2 * G_den
    own = plant * B_den * C_den
    path = s**2 * (1.0 + ratio) * B_num * C_num
    # The washout cancels the integrator of the velocity; without gains there are more of them.
    zeros = int(np.flatnonzero(own.coef)[0])
    return _Loop(
        own=Polynomial(own.coef[zeros:]),
        path=Polynomial(path.coef[zeros:]),
        delay_s=control.delay_s,
        natural_radps=math.sqrt(stiffness * (1.0 + ratio)),
        bandwidth_radps=bandwidth,
    )


def _damping(pole: complex) -> float:
    return -pole.real / abs(pole)


def design(parameters: Parameters) -> PlacedDesign:
    """Compute the gains for the wanted damping ratio and frequency of the swing.

    Where that would cost the stability, the robustness or the damping of another mode (slow autopilot, short cable,
    heavy load), a lower frequency and then a lower ratio is taken: the largest that leaves every other mode at least
    half as well damped, and all of them better than the worst one without correction. Where none does, the gains are
    zero and ``damping_ratio`` is ``damping_ratio_off``.
    """
    loop = _loop(parameters)
    poles_off = loop.poles(loop.own)
    upper = [pole for pole in poles_off if pole.imag > _SETTLED_SHARE * loop.natural_radps] or poles_off
    # The velocity loop may have a damped pair of the same frequency: the swing's is the one next to a free pendulum's.
    off = min(upper, key=lambda pole: abs(pole - 1j * loop.natural_radps))
    worst_off = min(_damping(pole) for pole in poles_off)
    wanted = parameters.control.damping_ratio
    fastest_radps = max(abs(off), _BANDWIDTH_SHARE * loop.bandwidth_radps)
    wanted_radps = min(parameters.control.frequency_ratio * abs(off), fastest_radps)
    for step in range(_RATIO_STEPS):
        ratio = wanted * (1.0 - step / _RATIO_STEPS)
        if ratio <= _damping(off):
            break
        for frequency_radps in (share * wanted_radps for share in _FREQUENCY_SHARES):
            if frequency_radps * loop.delay_s > _PHASE_MAX:
                continue
            target = frequency_radps * complex(-ratio, math.sqrt(1.0 - ratio * ratio))
            kp, kd = loop.gains(target)
            if kd <= 0.0:
                continue
            poles = loop.poles(loop.closed(kp, kd))
            others = sorted(poles, key=lambda pole: abs(complex(pole.real, abs(pole.imag)) - target))[2:]
            worst = min(_damping(pole) for pole in others)
            if worst > max(0.5 * ratio, worst_off) and loop.robust(kp, kd):
                return _designed(kp, kd, target, off, poles)
    return _designed(0.0, 0.0, off, off, poles_off)


def _designed(kp: float, kd: float, swing: complex, off: complex, poles: list[complex]) -> PlacedDesign:
    return PlacedDesign(
        kp_per_s2=kp,
        kd_per_s=kd,
        damping_ratio=_damping(swing),
        frequency_radps=abs(swing),
        damping_ratio_off=_damping(off),
        frequency_off_radps=abs(off),
        poles=tuple(sorted(poles, key=abs)),
    )


class PlacedLaw:
    """State feedback of the load's horizontal displacement with the gains of `design`."""

    def __init__(self, parameters: Parameters) -> None:
        self.design = design(parameters)
        length_m = parameters.cable.length_m
        self._kp = self.design.kp_per_s2 * length_m
        self._kd = self.design.kd_per_s * length_m

    @property
    def acts(self) -> bool:
        """Whether the design found gains."""
        return self.design.kd_per_s > 0.0

    def acceleration(self, direction: Vec2, rate_per_s: Vec2) -> Vec2:
        """Answer one state of the swing; see `SwingLaw.acceleration`."""
        return (
            self._kp * direction[0] + self._kd * rate_per_s[0],
            self._kp * direction[1] + self._kd * rate_per_s[1],
        )
