"""What the rules of every autopilot share."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum

from swingd.link.preflight.budget import BITS_PER_BYTE, LinkBudget, link_budget
from swingd.link.url import SerialPort, parse_url
from swingd.model.errors import LinkUrlError
from swingd.model.events import AutopilotKind, Stream
from swingd.model.parameters import Mode, Parameters, ThrustSource

GRAVITY_MPS2 = 9.80665
GAIN_TOLERANCE = 0.05
"""Relative difference of a gain that the design of the correction does not notice."""


class AdviceSeverity(IntEnum):
    """How much a finding matters; the most severe is the smallest."""

    DANGER = 0
    """Do not fly like this."""
    WARNING = 1
    """The correction, or a failsafe, will work worse than it could."""
    HINT = 2
    """Worth knowing."""


@dataclass(frozen=True, slots=True)
class Advice:
    """One finding, in words for who flies."""

    severity: AdviceSeverity
    name: str
    """The parameter, or the thing, that it is about."""
    value: str
    """What was found, with its unit."""
    meaning: str
    """What that does to a vehicle with a load."""
    remedy: str
    """What to do."""


@dataclass(frozen=True, slots=True)
class Facts:
    """What a rule may look at."""

    kind: AutopilotKind
    values: Mapping[str, float]
    parameters: Parameters
    hover_throttle: float | None
    """Of the configured curve at nominal voltage; None if not known, or if full throttle is not enough."""
    remote_control: bool | None
    rates_hz: Mapping[Stream, float]

    def known(self, name: str) -> float | None:
        """The value of a parameter; None if it is missing."""
        return self.values.get(name)

    def first(self, *names: str) -> tuple[str, float] | None:
        """The first of several names, of which each release knows another, with its value."""
        return next(((name, self.values[name]) for name in names if name in self.values), None)

    @property
    def budget(self) -> LinkBudget | None:
        """What the streams need; None if they are not known."""
        return link_budget(self.kind, self.rates_hz) if self.rates_hz else None

    @property
    def serial_baud(self) -> int | None:
        """Baud rate of swingd's own link; None if it is no serial line."""
        try:
            url = parse_url(self.parameters.link.autopilot)
        except LinkUrlError:
            return None
        return url.baud if isinstance(url, SerialPort) else None

    def danger(self) -> AdviceSeverity:
        """DANGER where swingd sends setpoints; where it only watches, no more than a WARNING."""
        return AdviceSeverity.WARNING if self.parameters.mode is Mode.SHADOW else AdviceSeverity.DANGER


Rule = Callable[[Facts], Iterable[Advice]]


def text(value: float, unit: str = "") -> str:
    """Write a parameter's value, as short as it is clear."""
    return f"{value:.6g} {unit}".rstrip()


def velocity_gains(facts: Facts, names: Mapping[str, tuple[str, ...]]) -> Iterable[Advice]:
    """Compare the autopilot's velocity loop with what the correction was designed for.

    Parameters
    ----------
    facts : Facts
        What is known.
    names : mapping
        For each key of ``autopilot`` in the configuration the names of the parameter, of which each release knows one.
    """
    for key, candidates in names.items():
        found = facts.first(*candidates)
        expected: float = getattr(facts.parameters.autopilot, key)
        if found is None or math.isclose(found[1], expected, rel_tol=GAIN_TOLERANCE, abs_tol=1e-3):
            continue
        name, value = found
        yield Advice(
            AdviceSeverity.WARNING,
            name,
            text(value),
            f"the correction is designed for a velocity loop with {text(expected)}: "
            "its damping will be another than promised",
            f"autopilot.{key}: {text(value)} in the configuration",
        )


def tilt_limit(facts: Facts, name: str, value: str, tilt_max_rad: float, remedy: str) -> Iterable[Advice]:
    """Compare the largest tilt with what the largest correction needs.

    Parameters
    ----------
    facts : Facts
        What is known.
    name, value : str
        The parameter, as the autopilot writes it.
    tilt_max_rad : float
        What it allows [rad].
    remedy : str
        How to set it, with ``{tilt_deg}`` for the smallest sufficient angle [deg].
    """
    acc_mps2 = facts.parameters.control.acc_max_mps2
    needed_rad = math.atan2(acc_mps2, GRAVITY_MPS2)
    # A correction comes on top of the tilt of the manoeuvre that it corrects; a third is left for that.
    if needed_rad <= tilt_max_rad / 1.5:
        return
    fits_mps2 = GRAVITY_MPS2 * math.tan(max(tilt_max_rad, 0.0) / 1.5)
    cut = needed_rad > tilt_max_rad
    yield Advice(
        AdviceSeverity.WARNING if cut else AdviceSeverity.HINT,
        name,
        value,
        f"a correction of {text(acc_mps2)} m/s^2 tilts the vehicle by {math.degrees(needed_rad):.0f} deg: "
        + ("the autopilot cuts it off" if cut else "little is left for the manoeuvre itself"),
        remedy.format(tilt_deg=math.ceil(math.degrees(1.5 * needed_rad)))
        + f", or control.acc_max_mps2 to {fits_mps2:.1f} at most",
    )


def voltage_exponent(facts: Facts, name: str, compensated: bool | None) -> Iterable[Advice]:
    """Compare the thrust curve's voltage exponent with what the autopilot compensates itself.

    Parameters
    ----------
    facts : Facts
        What is known.
    name : str
        The parameter that switches the compensation.
    compensated : bool or None
        Whether it is on; None if not known.
    """
    thrust = facts.parameters.thrust
    if compensated is None or thrust.source is ThrustSource.REMARK_1:
        return
    exponent = thrust.voltage_exponent
    value = text(facts.values[name])
    if compensated and exponent == 0.0 and thrust.source is not ThrustSource.THROTTLE:
        yield Advice(
            AdviceSeverity.WARNING,
            name,
            value,
            "the autopilot raises its motor outputs as the voltage falls, and with thrust.voltage_exponent 0 swingd "
            "takes that for more thrust",
            "thrust.voltage_exponent: 2 in the configuration; swingd drops it for the throttle by itself (keep 0 only "
            "with ESCs that hold the speed)",
        )
    elif compensated and exponent > 0.0:
        yield Advice(
            AdviceSeverity.HINT,
            name,
            value,
            "the autopilot compensates the voltage after the throttle that it reports: swingd applies "
            f"thrust.voltage_exponent {text(exponent)} to motor outputs only",
            "nothing; measure the thrust curve of the throttle with the compensation on",
        )
    elif not compensated and exponent == 0.0:
        yield Advice(
            AdviceSeverity.HINT,
            name,
            value,
            "nothing compensates the voltage here, and with thrust.voltage_exponent 0 swingd does not either: the "
            "thrust is overestimated as the battery empties",
            "thrust.voltage_exponent: 2 in the configuration, unless the ESCs hold the speed",
        )


def thrust_model(facts: Facts, name: str, factor: float) -> Iterable[Advice]:
    """Tell that throttle and motor outputs are no longer the same number.

    Parameters
    ----------
    facts : Facts
        What is known.
    name : str
        The parameter that bends the autopilot's thrust curve.
    factor : float
        Its value: 0 is a straight line.
    """
    if factor != 0.0 and facts.parameters.thrust.source is ThrustSource.AUTO:
        yield Advice(
            AdviceSeverity.WARNING,
            name,
            text(factor),
            "throttle and motor outputs are different numbers here, and one thrust curve fits only one of them: the "
            "thrust jumps when motor outputs come or stay away",
            "thrust.source: motors or throttle in the configuration, whichever the curve was measured with",
        )


def hover(facts: Facts, name: str, value: float, expected: float | None, learns: bool, remedy: str) -> Iterable[Advice]:
    """Compare the autopilot's hover throttle with the one that the thrust curve gives with the load.

    Parameters
    ----------
    facts : Facts
        What is known.
    name : str
        The parameter.
    value : float
        Its value, 0..1.
    expected : float or None
        What it should be by the configured curve, in the autopilot's own measure; None if not known.
    learns : bool
        Whether the autopilot corrects it in flight.
    remedy : str
        How to set it, with ``{expected}``.
    """
    if expected is None or abs(value - expected) <= 0.1:
        return
    masses = facts.parameters.vehicle.mass_kg, facts.parameters.payload.mass_kg
    yield Advice(
        AdviceSeverity.HINT if learns else AdviceSeverity.WARNING,
        name,
        f"{value:.2f}",
        f"by the configured thrust curve {text(masses[0])} kg with {text(masses[1])} kg below hover at {expected:.2f}: "
        + ("the autopilot learns it in flight, but begins wrong" if learns else "altitude will be held badly")
        + ", or the curve is wrong",
        remedy.format(expected=f"{expected:.2f}") + " once the load hangs in a hover, or calibrate the thrust curve",
    )


def slow_line(facts: Facts, name: str, where: str) -> Iterable[Advice]:
    """Compare swingd's own serial line with what the streams need.

    Parameters
    ----------
    facts : Facts
        What is known.
    name : str
        What the finding is to be called.
    where : str
        What is to be set on the autopilot's end.
    """
    budget, baud = facts.budget, facts.serial_baud
    if budget is None or baud is None or baud / BITS_PER_BYTE >= budget.needed_bytes_per_s:
        return
    yield Advice(
        AdviceSeverity.WARNING,
        name,
        f"{baud} baud",
        f"the line carries {baud / BITS_PER_BYTE:.0f} bytes/s, the streams that swingd asks for need "
        f"{budget.needed_bytes_per_s:.0f}: all of them come slower, or are lost",
        f"{budget.baud or 'a faster line'} baud on both ends: link.autopilot, and {where}; or lower link.imu_rate_hz",
    )
