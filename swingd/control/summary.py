"""What follows from the parameters before any flight: hover throttle, the load's linear swing, the correction."""

import math
from dataclasses import dataclass

from swingd.control.placed import design
from swingd.core.constants import GRAVITY_MPS2
from swingd.model.parameters import Parameters, Thrust

SAG_RATIO = 0.85
"""Share of the nominal voltage at which the hover throttle is given a second time: an emptying battery under load."""


@dataclass(frozen=True, slots=True)
class Oscillation:
    """A linear oscillation by its undamped angular frequency."""

    frequency_radps: float

    @property
    def frequency_hz(self) -> float:
        """Cycles per second [Hz]."""
        return self.frequency_radps / (2.0 * math.pi)

    @property
    def period_s(self) -> float:
        """Duration of one cycle [s]."""
        return 2.0 * math.pi / self.frequency_radps


@dataclass(frozen=True, slots=True)
class HoverPoint:
    """The throttle that carries vehicle and load at one voltage."""

    voltage_v: float
    throttle: float | None
    """0..1; None if full throttle is not enough."""


@dataclass(frozen=True, slots=True)
class Correction:
    """The correction's gains at small swing, and what they promise in the linear model of `swingd.control.placed`."""

    law: str
    kp_mps2_per_rad: float
    """Acceleration of the vehicle per swing angle."""
    kd_mps2_per_radps: float
    """Acceleration of the vehicle per swing rate."""
    off: Oscillation
    """The swing in the autopilot's own velocity loop."""
    damping_ratio_off: float
    on: Oscillation | None
    """The swing with the correction; None for a law whose gains are given rather than designed."""
    damping_ratio_on: float | None
    poles_per_s: tuple[complex, ...]
    """All poles of the loop with the correction [1/s]; empty where `on` is None."""


@dataclass(frozen=True, slots=True)
class Summary:
    """What follows from the parameters before any flight."""

    swing_fixed: Oscillation
    """The load below a pivot that does not move: sqrt(g / L)."""
    swing_free: Oscillation
    """The load below a vehicle that thrust only carries: sqrt(g / L (m + m_l) / m)."""
    hover_thrust_n: float
    """Weight of vehicle and load [N]."""
    hover_nominal: HoverPoint
    hover_sagged: HoverPoint
    """At `SAG_RATIO` of the nominal voltage."""
    correction: Correction


def hover_thrust_n(parameters: Parameters) -> float:
    """Give the weight of vehicle and load [N]."""
    return (parameters.vehicle.mass_kg + parameters.payload.mass_kg) * GRAVITY_MPS2


def curve_thrust_n(thrust: Thrust, throttle: float, voltage_v: float) -> float:
    """Give the thrust of the uncalibrated curve, all rotors together [N].

    Parameters
    ----------
    throttle : float
        0..1.
    voltage_v : float
        Of the pack, > 0 [V].
    """
    factor: float = (voltage_v / thrust.voltage_nominal_v) ** thrust.voltage_exponent
    return factor * ((thrust.quadratic_n * throttle + thrust.linear_n) * throttle + thrust.offset_n)


def hover_throttle(parameters: Parameters, voltage_v: float) -> float | None:
    """Give the throttle that carries vehicle and load, from the uncalibrated curve.

    Parameters
    ----------
    voltage_v : float
        Of the pack, > 0 [V].

    Returns
    -------
    float or None
        0..1 on the rising branch of the curve; None if no throttle gives this thrust.
    """
    thrust = parameters.thrust
    factor = (voltage_v / thrust.voltage_nominal_v) ** thrust.voltage_exponent
    a, b = thrust.quadratic_n, thrust.linear_n
    missing_n = hover_thrust_n(parameters) / factor - thrust.offset_n
    discriminant = b * b + 4.0 * a * missing_n
    if missing_n < 0.0 or discriminant < 0.0:
        return None
    # This form of the root is the smaller one where the curve bends down, and holds for a = 0 too.
    denominator = b + math.sqrt(discriminant)
    if denominator <= 0.0:
        return None
    throttle = 2.0 * missing_n / denominator
    return throttle if throttle <= 1.0 else None


def swing_fixed(parameters: Parameters) -> Oscillation:
    """Give the small swing of the load below a fixed pivot."""
    return Oscillation(math.sqrt(GRAVITY_MPS2 / parameters.cable.length_m))


def swing_free(parameters: Parameters) -> Oscillation:
    """Give the small swing of the load below a vehicle that only carries the weight, Drones 2023 (8) linearised."""
    vehicle_kg = parameters.vehicle.mass_kg
    ratio = (vehicle_kg + parameters.payload.mass_kg) / vehicle_kg
    return Oscillation(math.sqrt(GRAVITY_MPS2 / parameters.cable.length_m * ratio))


def correction(parameters: Parameters) -> Correction:
    """Give the gains of the chosen law and the damping that is to be expected."""
    control = parameters.control
    placed = design(parameters)
    off = Oscillation(placed.frequency_off_radps)
    if control.law != "placed":
        kp, kd = control.payload_kp_mps2_per_rad, control.payload_kd_mps2_per_radps
        return Correction(control.law, kp, kd, off, placed.damping_ratio_off, None, None, ())
    return Correction(
        law=control.law,
        kp_mps2_per_rad=placed.kp_per_s2 * parameters.cable.length_m,
        kd_mps2_per_radps=placed.kd_per_s * parameters.cable.length_m,
        off=off,
        damping_ratio_off=placed.damping_ratio_off,
        on=Oscillation(placed.frequency_radps),
        damping_ratio_on=placed.damping_ratio,
        poles_per_s=placed.poles,
    )


def summarise(parameters: Parameters) -> Summary:
    """Compute what ``swingd check`` shows beside the parameters themselves."""
    nominal_v = parameters.thrust.voltage_nominal_v
    sagged_v = SAG_RATIO * nominal_v
    return Summary(
        swing_fixed=swing_fixed(parameters),
        swing_free=swing_free(parameters),
        hover_thrust_n=hover_thrust_n(parameters),
        hover_nominal=HoverPoint(nominal_v, hover_throttle(parameters, nominal_v)),
        hover_sagged=HoverPoint(sagged_v, hover_throttle(parameters, sagged_v)),
        correction=correction(parameters),
    )
