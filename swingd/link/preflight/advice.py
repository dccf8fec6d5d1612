"""Advice about an autopilot's parameters: what each means with a load on a cable, and what to set."""

from collections.abc import Mapping
from types import MappingProxyType

from swingd.link.preflight import copter, px4
from swingd.link.preflight.rules import Advice, AdviceSeverity, Facts, Rule
from swingd.model.events import AutopilotKind, Stream
from swingd.model.parameters import Parameters

__all__ = ["Advice", "AdviceSeverity", "advise", "parameters_of", "voltage_compensated"]

_NAMES: Mapping[AutopilotKind, tuple[str, ...]] = {
    AutopilotKind.PX4: px4.NAMES,
    AutopilotKind.ARDUPILOT: copter.NAMES,
    AutopilotKind.OTHER: (),
}
_RULES: Mapping[AutopilotKind, tuple[Rule, ...]] = {
    AutopilotKind.PX4: px4.RULES,
    AutopilotKind.ARDUPILOT: copter.RULES,
    AutopilotKind.OTHER: (),
}


def parameters_of(kind: AutopilotKind) -> tuple[str, ...]:
    """Return the names of the parameters that `advise` looks at, the ones that matter most first."""
    return _NAMES[kind]


def advise(
    kind: AutopilotKind,
    values: Mapping[str, float],
    parameters: Parameters,
    *,
    hover_throttle: float | None = None,
    remote_control: bool | None = None,
    rates_hz: Mapping[Stream, float] = MappingProxyType({}),
) -> list[Advice]:
    """Judge an autopilot's parameters by swingd's own.

    Parameters
    ----------
    kind : AutopilotKind
        Whose parameters they are.
    values : mapping
        The autopilot's parameters by name, as many as are known; a rule whose parameters are missing says nothing.
    parameters : Parameters
        swingd's configuration.
    hover_throttle : float, optional
        Where the configured thrust curve carries vehicle and load at nominal voltage, 0..1; without it the autopilot's
        hover throttle is not judged.
    remote_control : bool, optional
        Whether the autopilot hears a remote control; None where that is not known.
    rates_hz : mapping
        The streams that are asked for [Hz]; without them the link's budget is not judged.

    Returns
    -------
    list of Advice
        The most severe first; empty if there is nothing to say.
    """
    budget = dict(rates_hz)
    facts = Facts(kind, values, parameters, hover_throttle, remote_control, budget)
    found = [advice for rule in _RULES[kind] for advice in rule(facts)]
    return sorted(found, key=lambda advice: advice.severity)


def voltage_compensated(kind: AutopilotKind, values: Mapping[str, float]) -> bool | None:
    """Say whether the autopilot scales its motor outputs with the voltage, after the throttle that it reports.

    Parameters
    ----------
    kind : AutopilotKind
        Whose parameters they are.
    values : mapping
        The autopilot's parameters by name.

    Returns
    -------
    bool or None
        None if the parameters that tell it are not among ``values``.
    """
    match kind:
        case AutopilotKind.PX4:
            return px4.voltage_compensated(values)
        case AutopilotKind.ARDUPILOT:
            return copter.voltage_compensated(values)
        case AutopilotKind.OTHER:
            return None
