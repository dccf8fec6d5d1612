"""What a flight tells of load, cable and drag, and what it does not."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from swingd.identify.fit import PERIODS_MIN, SEGMENTS_MIN, Fit, Progress, Shared, fit, student_quantile
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
    drag: Quantity
    """Of the vehicle across its thrust."""
    fit: Fit | None
    swing_rms_rad: float
    """Angle of the cable from the vertical, as fitted; 0 without a fit."""
    hanging_s: float
    """For how long a load hung."""

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them."""
        return self.mass, self.weighed_mass, self.length, self.damping, self.drag

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
        for quantity in (self.best_mass, self.length, self.damping, self.drag):
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
    """Tell load mass, cable length, damping ratio and drag from a flight.

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
    if best is None:
        period_s = 2.0 * math.pi * math.sqrt(parameters.cable.length_m / 9.81)
        silent = (
            f"a load hung for {hanging_s:.0f} s without a gap in the streams; "
            f"expected {SEGMENTS_MIN * PERIODS_MIN:.0f} periods, here {SEGMENTS_MIN * PERIODS_MIN * period_s:.0f} s"
        )
        reasons = dict.fromkeys(Shared, silent)
        values: dict[Shared, Known | None] = dict.fromkeys(Shared)
        swing_rms_rad = 0.0
    else:
        swing_rms_rad = math.sqrt(_mean_square([best.swing_rad(index) for index in range(len(best.segments))]))
        values, reasons = _judge(best, swing_rms_rad, record.has_velocity)
    vehicle = parameters.vehicle
    return Identification(
        Quantity(
            "load mass by swing",
            "payload.mass_kg",
            "kg",
            parameters.payload.mass_kg,
            values[Shared.MASS],
            reasons[Shared.MASS],
        ),
        _weighed(weighing, parameters.payload.mass_kg),
        Quantity(
            "cable length",
            "cable.length_m",
            "m",
            parameters.cable.length_m,
            values[Shared.LOG_LENGTH],
            reasons[Shared.LOG_LENGTH],
        ),
        Quantity(
            "damping ratio",
            "estimator.damping_ratio",
            "1",
            parameters.estimator.damping_ratio,
            values[Shared.DAMPING_RATIO],
            reasons[Shared.DAMPING_RATIO],
        ),
        Quantity(
            "vehicle's drag",
            "vehicle.drag_n_per_mps",
            "N/(m/s)",
            vehicle.drag_n_per_mps,
            values[Shared.DRAG],
            reasons[Shared.DRAG],
        ),
        best,
        swing_rms_rad,
        hanging_s,
    )


def _judge(best: Fit, swing_rms_rad: float, has_velocity: bool) -> tuple[dict[Shared, Known | None], dict[Shared, str]]:
    """Take what the fit tells well enough; give a reason for the rest."""
    reach = best.quantile * best.std
    low, value, high = (best.shared + sign * reach for sign in (-1.0, 0.0, 1.0))
    told: dict[Shared, Known | None] = {
        index: Known(max(float(value[index]), 0.0), max(float(low[index]), 0.0), max(float(high[index]), 0.0))
        for index in (Shared.DAMPING_RATIO, Shared.MASS, Shared.DRAG)
    }
    length = Known(*(math.exp(min(bounds[Shared.LOG_LENGTH], 20.0)) for bounds in (value, low, high)))
    told[Shared.LOG_LENGTH] = length
    reasons = dict.fromkeys(Shared, f"{len(best.segments)} segments, residual {best.residual_rms_n:.2g} N RMS")
    swing = f"too little swing ({math.degrees(swing_rms_rad):.1f} deg RMS)"
    limits = {
        Shared.MASS: HALF_WIDTH_MAX * value[Shared.MASS],
        Shared.LOG_LENGTH: HALF_WIDTH_MAX * length.value,
        Shared.DAMPING_RATIO: DAMPING_HALF_WIDTH_MAX,
        Shared.DRAG: HALF_WIDTH_MAX * value[Shared.DRAG],
    }
    for index, limit in limits.items():
        known = told[index]
        assert known is not None
        if not known.half_width <= limit:
            cause = "too little motion through the air" if index is Shared.DRAG else swing
            told[index] = None
            reasons[index] = f"{cause}: 95 % from {known.low:.2g} to {known.high:.2g}"
    if told[Shared.MASS] is None:
        # Length and damping of a pull that is not there would be those of noise.
        for index in (Shared.LOG_LENGTH, Shared.DAMPING_RATIO):
            told[index] = None
            reasons[index] = f"{swing}: the load's pull does not stand out"
    if not has_velocity:
        told[Shared.DRAG] = None
        reasons[Shared.DRAG] = "no velocity in the log (LOCAL_POSITION_NED)"
    return told, reasons


def _weighed(weighing: MassEstimate | None, configured_kg: float) -> Quantity:
    known, reason = None, "no load was seen to hang"
    if weighing is not None:
        reason = weighing.reason
        if weighing.mass_kg is not None and weighing.std_kg is not None:
            reach_kg = student_quantile(WEIGHING_FREEDOM) * weighing.std_kg
            known = Known(weighing.mass_kg, weighing.mass_kg - reach_kg, weighing.mass_kg + reach_kg)
    return Quantity("load mass by hover thrust", "payload.mass_kg", "kg", configured_kg, known, reason)


def _mean_square(parts: Sequence[np.ndarray]) -> float:
    return float(np.mean(np.concatenate(parts) ** 2))
