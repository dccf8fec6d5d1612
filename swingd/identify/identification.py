"""What a flight tells of load and cable, and what it does not."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from swingd.core.constants import GRAVITY_MPS2
from swingd.identify.fit import (
    PERIODS_MIN,
    SCAN_FACTORS,
    SEGMENTS_MIN,
    Fit,
    Progress,
    Shared,
    fit,
    student_quantile,
)
from swingd.identify.segments import FlightRecord
from swingd.model.parameters import Parameters
from swingd.pipeline.payload_mass import MassEstimate

LIFTED_S = 1.0
"""After a lift the cable may still be slack now and then."""
NOTICED_S = 1.0
"""A load that was lost is noticed within this time."""
HALF_WIDTH_MAX = 0.3
"""A value whose interval reaches further to one side, as a share of it, is not known."""
DAMPING_HALF_WIDTH_MAX = 0.03
"""The same for the damping ratio, which may be zero."""
SWING_RMS_MIN_RAD = math.radians(1.0)
"""Below it errors of attitude and gyro pass for swing."""
PULL_OVER_RESIDUAL_MIN = 1.0
"""A pull that is less than this times what is left is no load's."""
WEIGHING_FREEDOM = 24
"""Of a weighing: the blocks of quiet flight that it averages."""


@dataclass(frozen=True, slots=True)
class Known:
    """A value with its interval of 95 % confidence."""

    value: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """How far the interval reaches, on its longer side."""
        return max(self.high - self.value, self.value - self.low)


@dataclass(frozen=True, slots=True)
class Quantity:
    """One thing that a flight may tell."""

    name: str
    key: str
    """Of the configuration; its unit is the quantity's."""
    unit: str
    configured: float
    known: Known | None
    """None where the flight does not tell."""
    note: str
    """How it was found, or why it is not known."""

    @property
    def agrees(self) -> bool | None:
        """Whether the configured value is within the interval; None where nothing is known."""
        return None if self.known is None else self.known.low <= self.configured <= self.known.high


@dataclass(frozen=True, slots=True)
class Identification:
    """What a flight tells."""

    mass: Quantity
    """Load, by its swing: what the cable pulls the vehicle aside with."""
    weighed_mass: Quantity
    """Load, by hover thrust with it against hover thrust without it."""
    length: Quantity
    """From the hook to the load's centre of mass, as the swing's frequency shows it."""
    damping: Quantity
    fit: Fit | None
    hanging_s: float
    """For how long a load hung."""

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them."""
        return self.mass, self.weighed_mass, self.length, self.damping

    @property
    def best_mass(self) -> Quantity:
        """The load's mass by the narrower interval."""
        pair = [quantity for quantity in (self.mass, self.weighed_mass) if quantity.known is not None]
        return min(
            pair, key=lambda quantity: quantity.known.half_width if quantity.known else math.inf, default=self.mass
        )

    @property
    def contradiction(self) -> str:
        """What thrust and swing say of the mass where they cannot both be right, else nothing."""
        swung, weighed = self.mass.known, self.weighed_mass.known
        if swung is None or weighed is None or (swung.low <= weighed.high and weighed.low <= swung.high):
            return ""
        return (
            f"the swing says {swung.low:.3g} .. {swung.high:.3g} kg, "
            f"the thrust {weighed.low:.3g} .. {weighed.high:.3g} kg: "
            "check vehicle.mass_kg, which scales both, and the thrust curve"
        )

    def yaml(self) -> str:
        """Return what is known as lines for a configuration."""
        lines = []
        for quantity in (self.best_mass, self.length, self.damping):
            if quantity.known is not None:
                room, key = quantity.key.split(".")
                value, low, high = (
                    f"{number:.4g}" for number in (quantity.known.value, quantity.known.low, quantity.known.high)
                )
                lines += [f"{room}:", f"  {key}: {value}  # {low} .. {high}"]
        return "\n".join(lines)


def identify(
    record: FlightRecord,
    hanging: Iterable[tuple[float, float]],
    parameters: Parameters,
    weighing: MassEstimate | None = None,
    progress: Progress = lambda _share: None,
) -> Identification:
    """Tell load mass, cable length and damping ratio from a flight.

    Parameters
    ----------
    record : FlightRecord
        Its streams.
    hanging : pairs of float
        When a load hung [s, boot time], as a replay finds it.
    parameters : Parameters
        As configured: the vehicle's mass scales the load's; the cable's length may be wrong by a factor of four.
    weighing : MassEstimate, optional
        What hover thrust said during the replay.
    progress : callable, optional
        Gets the share done, 0..1.
    """
    # What is lost at the end was noticed late; the end of the log is no loss, but a second of it is no loss either.
    swinging = [(begin_s + LIFTED_S, end_s - NOTICED_S) for begin_s, end_s in hanging]
    swinging = [(begin_s, end_s) for begin_s, end_s in swinging if end_s > begin_s]
    hanging_s = sum(end_s - begin_s for begin_s, end_s in swinging)
    best = fit(record, swinging, parameters.cable.length_m, parameters.payload.mass_kg, progress)
    told = _silence(hanging_s, parameters.cable.length_m) if best is None else _judge(best, parameters.cable.length_m)

    def quantity(name: str, key: str, unit: str, configured: float, index: Shared) -> Quantity:
        return Quantity(name, key, unit, configured, *told[index])

    load, cable, estimator = parameters.payload, parameters.cable, parameters.estimator
    return Identification(
        mass=quantity("load mass by swing", "payload.mass_kg", "kg", load.mass_kg, Shared.MASS),
        weighed_mass=_weighed(weighing, load.mass_kg),
        length=quantity("cable length", "cable.length_m", "m", cable.length_m, Shared.LOG_LENGTH),
        damping=quantity(
            "damping ratio", "estimator.damping_ratio", "1", estimator.damping_ratio, Shared.DAMPING_RATIO
        ),
        fit=best,
        hanging_s=hanging_s,
    )


_Told = dict[Shared, tuple[Known | None, str]]
"""What is known, and how it was found or why it is not."""
_TOLD = (Shared.MASS, Shared.LOG_LENGTH, Shared.DAMPING_RATIO)


def _silence(hanging_s: float, length_m: float) -> _Told:
    """Say that the flight is too short."""
    needed_s = SEGMENTS_MIN * PERIODS_MIN * 2.0 * math.pi * math.sqrt(length_m / GRAVITY_MPS2)
    reason = (
        f"a load hung for {hanging_s:.0f} s; expected {needed_s:.0f} s without gaps in IMU, attitude and position "
        f"({SEGMENTS_MIN * PERIODS_MIN:.0f} periods)"
    )
    return dict.fromkeys(_TOLD, (None, reason))


def _judge(best: Fit, configured_m: float) -> _Told:
    """Take what the fit tells well enough; give a reason for the rest."""
    reach = best.quantile * best.std
    value, low, high = (best.shared + sign * reach for sign in (0.0, -1.0, 1.0))
    swung = f"with {math.degrees(best.swing_rms_rad):.1f} deg RMS of swing"
    pull_n = best.shared[Shared.MASS] * GRAVITY_MPS2 * best.swing_rms_rad
    if best.swing_rms_rad < SWING_RMS_MIN_RAD:
        return dict.fromkeys(_TOLD, (None, f"too little swing: {math.degrees(best.swing_rms_rad):.1f} deg RMS"))
    if pull_n < PULL_OVER_RESIDUAL_MIN * best.residual_rms_n:
        reason = (
            f"too little swing, or no load: a pull of {pull_n:.2g} N RMS is below what is left, "
            f"{best.residual_rms_n:.2g} N"
        )
        return dict.fromkeys(_TOLD, (None, reason))
    if not SCAN_FACTORS[0] < best.length_m / configured_m < SCAN_FACTORS[-1]:
        reason = f"the best fit, {best.length_m:.2g} m, is beyond a quarter to four times the configured length"
        return dict.fromkeys(_TOLD, (None, reason))
    known = {
        Shared.MASS: Known(*(max(float(bound[Shared.MASS]), 0.0) for bound in (value, low, high))),
        Shared.LOG_LENGTH: Known(*(math.exp(min(bound[Shared.LOG_LENGTH], 20.0)) for bound in (value, low, high))),
        Shared.DAMPING_RATIO: Known(*(max(float(bound[Shared.DAMPING_RATIO]), 0.0) for bound in (value, low, high))),
    }
    limits = {
        Shared.MASS: HALF_WIDTH_MAX * known[Shared.MASS].value,
        Shared.LOG_LENGTH: HALF_WIDTH_MAX * known[Shared.LOG_LENGTH].value,
        Shared.DAMPING_RATIO: DAMPING_HALF_WIDTH_MAX,
    }
    how = f"{len(best.segments)} segments, {best.residual_rms_n:.2g} N left"
    told: _Told = {
        index: (known[index], how)
        if known[index].half_width <= limit
        else (None, f"too uncertain {swung}: 95 % from {known[index].low:.2g} to {known[index].high:.2g}")
        for index, limit in limits.items()
    }
    if told[Shared.MASS][0] is None:
        # Length and damping of a pull that may not be there would be those of the gusts.
        told[Shared.LOG_LENGTH] = told[Shared.DAMPING_RATIO] = (None, f"the load's pull does not stand out {swung}")
    return told


def _weighed(weighing: MassEstimate | None, configured_kg: float) -> Quantity:
    known, reason = None, "no load was seen to hang"
    if weighing is not None:
        reason = weighing.reason
        if weighing.mass_kg is not None and weighing.std_kg is not None:
            reach_kg = student_quantile(WEIGHING_FREEDOM) * weighing.std_kg
            known = Known(weighing.mass_kg, weighing.mass_kg - reach_kg, weighing.mass_kg + reach_kg)
    return Quantity("load mass by hover thrust", "payload.mass_kg", "kg", configured_kg, known, reason)
