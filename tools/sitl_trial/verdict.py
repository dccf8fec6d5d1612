"""What was flown against what is asked."""

from collections.abc import Iterator
from dataclasses import dataclass

from .figures import StepFigures
from .flight import Flight
from .plan import Correction

REAL_TIME_MIN = 0.9
"""In the mean; below, the flight is marked: swingd's timeouts run on the wall clock."""
REAL_TIME_WORST_MIN = 0.75
"""Of the worst two seconds: below, there was a gap of half a second in telemetry or setpoints."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One asked figure."""

    where: str
    """Flight and step."""
    what: str
    value: float
    limit: float
    reached: bool


def verdicts(flights: list[Flight]) -> list[Verdict]:
    """Hold every flight against what its scenario asks; ratios need the flight without correction beside it."""
    uncorrected = {flight.name: flight for flight in flights if flight.correction is Correction.OFF}
    return [verdict for flight in flights for verdict in _of_flight(flight, uncorrected.get(flight.name))]


def ratio(value: float | None, reference: float | None) -> float | None:
    return value / reference if value is not None and reference else None


def _of_flight(flight: Flight, off: Flight | None) -> Iterator[Verdict]:
    asked, figures = flight.scenario.asked, flight.figures
    where = f"{flight.name}, {flight.correction}"
    for axis, rmse in (("xi", figures.xi_rmse_deg), ("zeta", figures.zeta_rmse_deg)):
        yield from _held(where, f"estimate of {axis}, RMSE [deg]", rmse, asked.estimate_rmse_deg)
    yield from _held(where, "largest correction [m/s^2]", figures.correction_mps2, asked.correction_mps2)
    if flight.correction is Correction.OFF:
        return
    steps = [step for _, step in off.steps] if off is not None else [None] * len(flight.steps)
    for number, ((step, found), reference) in enumerate(zip(flight.steps, steps, strict=True)):
        place = f"{where}: {step.manoeuvre} {step.name}"
        yield from _of_step(place, flight, found, reference)
        following = [later.manoeuvre for later, _ in flight.steps[number + 1 :]]
        if step.manoeuvre not in following:
            yield from _held(place, "under 2 deg after [s]", found.settle_s, asked.stop_settle_s, found.settled)
            if reference is not None:
                rms = ratio(found.rms_deg, reference.rms_deg)
                yield from _held(place, "swing RMS, of uncorrected", rms, asked.stop_rms_ratio)


def _of_step(where: str, flight: Flight, found: StepFigures, off: StepFigures | None) -> Iterator[Verdict]:
    asked = flight.scenario.asked
    shaped = flight.correction is Correction.SHAPED
    if asked.settle_s is not None:
        yield from _held(where, "under 2 deg after [s]", found.settle_s, asked.settle_s, found.settled)
    if asked.settle_periods is not None:
        yield from _held(
            where, "under 2 deg after [periods]", found.settle_periods, asked.settle_periods, found.settled
        )
    if off is not None:
        rms_limit = asked.rms_ratio_shaped if shaped else asked.rms_ratio
        yield from _held(where, "swing RMS, of uncorrected", ratio(found.rms_deg, off.rms_deg), rms_limit)
        velocity = ratio(found.velocity_rmse_mps, off.velocity_rmse_mps)
        yield from _held(where, "velocity error, of uncorrected", velocity, asked.velocity_ratio)
    yield from _held(where, "altitude deviation [m]", found.altitude_m, asked.altitude_m)


def _held(where: str, what: str, value: float | None, limit: float | None, valid: bool = True) -> Iterator[Verdict]:
    if value is not None and limit is not None:
        yield Verdict(where, what, value, limit, valid and value <= limit)
