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
from swingd.model.parameters import Parameters

_ATTITUDE_DAMPING = 0.6
_GRAVITY_MPS2 = 9.80665
_DELAY_MIN_S = 1e-4
"""A shorter delay is none; its Padé poles would only spoil the roots of the others."""
_SETTLED_PER_S = 0.05
"""Poles slower than this belong to the integrator, the leak and the washout, not to the swing."""


@dataclass(frozen=True, slots=True)
class PlacedDesign:
    """Gains of the placed law and what they promise."""

    kp_per_s2: float
    """Acceleration per displacement of the load."""
    kd_per_s: float
    """Acceleration per velocity of the load relative to the vehicle."""
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
    """The model's polynomials in s: (s^2 + g/L)(1 + mu G W) + (m_l/m)(g/L) = -mu G B C (kp + kd s)."""

    stiffness: float
    pull: float
    mu: float
    G_den: Polynomial
    W_num: Polynomial
    B_num: Polynomial
    B_den: Polynomial
    C_num: Polynomial
    C_den: Polynomial
    delay_s: float

    def open(self) -> Polynomial:
        """Characteristic polynomial without correction, times s^2 of W and the denominator of G."""
        s = Polynomial([0.0, 1.0])
        return (s**2 + self.stiffness) * (s**2 * self.G_den + self.mu * self.W_num) + self.pull * s**2 * self.G_den

    def closed(self, kp: float, kd: float) -> Polynomial:
        """Characteristic polynomial with correction."""
        s = Polynomial([0.0, 1.0])
        half = 0.5 * max(self.delay_s, _DELAY_MIN_S)
        ahead = 1.0 - half * s + half**2 / 3.0 * s**2
        behind = 1.0 + half * s + half**2 / 3.0 * s**2
        law = Polynomial([kp, kd])
        return self.open() * self.B_den * self.C_den * behind + s**2 * self.mu * self.B_num * self.C_num * law * ahead

    def gains(self, pole: complex) -> tuple[float, float]:
        """The gains that make ``pole`` a root."""
        path = pole**2 * self.mu * self.B_num(pole) * self.C_num(pole) * cmath.exp(-pole * self.delay_s)
        value = -self.open()(pole) * self.B_den(pole) * self.C_den(pole) / path
        kd = value.imag / pole.imag
        return value.real - kd * pole.real, kd


def _loop(parameters: Parameters) -> _Loop:
    autopilot, control = parameters.autopilot, parameters.control
    ratio = parameters.payload.mass_kg / parameters.vehicle.mass_kg
    stiffness = _GRAVITY_MPS2 / parameters.cable.length_m
    bandwidth = 2.0 * _ATTITUDE_DAMPING / max(autopilot.acceleration_delay_s, 1e-3)
    s = Polynomial([0.0, 1.0])
    leak = control.velocity_leak_s
    pi = autopilot.velocity_p * s + autopilot.velocity_i
    return _Loop(
        stiffness=stiffness,
        pull=ratio * stiffness,
        mu=1.0 + ratio,
        G_den=s**2 / bandwidth**2 + 2.0 * _ATTITUDE_DAMPING / bandwidth * s + 1.0,
        W_num=autopilot.velocity_d * s**2 + pi,
        B_num=s * (1.0 + leak * s) + pi * leak,
        B_den=s * (1.0 + leak * s),
        C_num=control.washout_s * s,
        C_den=1.0 + control.washout_s * s,
        delay_s=control.delay_s,
    )


def _swing_pole(poles: list[complex], near_radps: float) -> complex:
    """The upper pole of the pair that is the swing, the one nearest in frequency; a real one where none oscillates."""
    upper = [pole for pole in poles if pole.imag > _SETTLED_PER_S] or [pole for pole in poles if abs(pole) > 0.0]
    return min(upper, key=lambda pole: abs(math.log(abs(pole) / near_radps)))


def _poles(polynomial: Polynomial) -> list[complex]:
    return [complex(root) for root in np.asarray(polynomial.roots(), dtype=complex)]


def design(parameters: Parameters) -> PlacedDesign:
    """Compute the gains for the wanted damping ratio and frequency of the swing.

    Where the wanted damping would cost the stability or the damping of another mode (slow autopilot, short cable), the
    largest ratio that leaves every mode at least half as well damped is taken instead; ``damping_ratio`` tells it.
    """
    loop = _loop(parameters)
    natural = math.sqrt(loop.stiffness + loop.pull)
    swing_off = _swing_pole(_poles(loop.open()), natural)
    wanted = parameters.control.damping_ratio
    frequency_radps = parameters.control.frequency_ratio * abs(swing_off)
    best: PlacedDesign | None = None
    for ratio in (wanted * (1.0 - 0.05 * k) for k in range(20)):
        target = frequency_radps * complex(-ratio, math.sqrt(1.0 - ratio * ratio))
        kp, kd = loop.gains(target)
        poles = _poles(loop.closed(kp, kd))
        swing = _swing_pole(poles, frequency_radps)
        best = PlacedDesign(
            kp_per_s2=kp,
            kd_per_s=kd,
            damping_ratio=-swing.real / abs(swing),
            frequency_radps=abs(swing),
            damping_ratio_off=-swing_off.real / abs(swing_off),
            frequency_off_radps=abs(swing_off),
            poles=tuple(sorted(poles, key=abs)),
        )
        others = [-pole.real / abs(pole) for pole in poles if abs(pole) > _SETTLED_PER_S and abs(pole - swing) > 1e-6]
        if kd > 0.0 and min(others, default=1.0) > 0.5 * ratio:
            return best
    assert best is not None
    return best


class PlacedLaw:
    """State feedback of the load's horizontal displacement with the gains of `design`."""

    def __init__(self, parameters: Parameters) -> None:
        self.design = design(parameters)
        length_m = parameters.cable.length_m
        self._kp = self.design.kp_per_s2 * length_m
        self._kd = self.design.kd_per_s * length_m

    def acceleration(self, direction: Vec2, rate_per_s: Vec2) -> Vec2:
        """Answer one state of the swing; see `SwingLaw.acceleration`."""
        return (
            self._kp * direction[0] + self._kd * rate_per_s[0],
            self._kp * direction[1] + self._kd * rate_per_s[1],
        )
