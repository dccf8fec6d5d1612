"""Hover over a full battery: does the thrust curve with the voltage know what carries the vehicle? (28), (29).

The truth is a motor with back-EMF and resistance under a propeller, of which a quadratic curve and a power of the
voltage are only a fit; the curve comes from a stand that is measured at four voltages, fitted as `swingd calibrate
thrust` does.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.identify.thrust_curve import StandRow, ThrustCurve, fit_stand
from swingd.model.estimate import FloatArray
from swingd.model.parameters import Thrust
from swingd.studies.cooperative import paper
from swingd.studies.cooperative import vehicles as v

BACK_EMF_VS = 60.0 / (2.0 * np.pi * 920.0)
"""Of a 920 rpm/V motor [V s/rad]; its torque per current as well [N m/A]."""
RESISTANCE_OHM = 0.12
IDLE_A = 0.6
FULL_V, EMPTY_V = 16.8, 14.0
STAND_V = (16.8, 16.0, 15.0, 14.0)
STAND_NOISE = 0.01
"""Of the stand's scale, of its reading."""
STAND_NOISE_N = 0.02
READING_V = 0.03
"""Of the voltage on board."""
ROTORS = 4


@dataclass(frozen=True, slots=True)
class HoverOverBattery:
    """Thrust that carries the vehicle and its half of the load, and what curves make of the throttle."""

    voltage_v: FloatArray
    """(n,) full to empty."""
    throttle: FloatArray
    """(n,) 0..1"""
    needed_n: float
    compensated_n: FloatArray
    """(n,) curve with the measured voltage."""
    uncompensated_n: FloatArray
    """(n,) the same curve as if the voltage were always nominal."""
    curve: ThrustCurve

    def errors_percent(self) -> dict[str, float]:
        """Give the largest errors."""
        return {
            name: float(100.0 * np.abs(told / self.needed_n - 1.0).max())
            for name, told in (("compensated", self.compensated_n), ("uncompensated", self.uncompensated_n))
        }


def rotor_speed(throttle: float, voltage_v: float) -> float:
    """Give the steady speed [rad/s] at which the torque of the propeller takes the motor's: a quadratic equation."""
    a = RESISTANCE_OHM * v.ROTOR_TORQUE_NM_S2 / BACK_EMF_VS
    c = RESISTANCE_OHM * IDLE_A - throttle * voltage_v
    if c >= 0.0:
        return 0.0
    return (-BACK_EMF_VS + sqrt(BACK_EMF_VS**2 - 4.0 * a * c)) / (2.0 * a)


def throttle_for(thrust_n: float, voltage_v: float) -> float:
    """Give the throttle at which one rotor pulls so much."""
    speed = sqrt(thrust_n / v.ROTOR_THRUST_N_S2)
    current_a = v.ROTOR_TORQUE_NM_S2 * speed**2 / BACK_EMF_VS + IDLE_A
    return (BACK_EMF_VS * speed + RESISTANCE_OHM * current_a) / voltage_v


def stand(rng: np.random.Generator) -> list[StandRow]:
    """Measure one rotor on a stand."""
    rows = []
    for voltage_v in STAND_V:
        for throttle in np.linspace(0.1, 1.0, 10).tolist():
            thrust_n = v.ROTOR_THRUST_N_S2 * rotor_speed(throttle, voltage_v) ** 2
            read_n = thrust_n * (1.0 + STAND_NOISE * rng.standard_normal()) + STAND_NOISE_N * rng.standard_normal()
            rows.append(StandRow(throttle, max(float(read_n), 0.0), voltage_v))
    return rows


def hover(seed: int) -> HoverOverBattery:
    """Calibrate on the stand, then hover from full to empty."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 2]))
    curve = fit_stand(
        stand(rng), replace(Thrust(), voltage_nominal_v=paper.CARRIER_NOMINAL_V), ROTORS, paper.CARRIER_NOMINAL_V
    )
    needed_n = (v.MASS_KG + v.LOAD_MASS_KG / v.CARRIERS) * GRAVITY_MPS2
    voltage = np.linspace(FULL_V, EMPTY_V, 141)
    throttle = np.array([throttle_for(needed_n / ROTORS, volt) for volt in voltage.tolist()])
    read = voltage + READING_V * rng.standard_normal(voltage.size)
    return HoverOverBattery(
        voltage, throttle, needed_n, curve.thrust_at(throttle, read), curve.thrust_at(throttle, read, False), curve
    )
