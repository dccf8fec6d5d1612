"""The whole study: every flight of a seed, its figures, and the object that a program reads."""

from collections.abc import Callable, Mapping
from typing import Any

from swingd.studies.icinco2016 import filters, variations
from swingd.studies.icinco2016.cases import CIRCLE_TORQUE, SCENARIOS, VARIANTS
from swingd.studies.icinco2016.flight import Flight, run
from swingd.studies.icinco2016.indicators import indicators
from swingd.studies.seeds import Figures, each

Flights = Mapping[tuple[str, str], Flight]
"""By case and compensation."""


def fly_all(seed: int, watch: Callable[[float], None] = lambda _share: None) -> dict[tuple[str, str], Flight]:
    """Fly every case with every compensation.

    Parameters
    ----------
    seed : int
        Of the sensors' noise, the same for all.
    watch : callable
        Takes the share done, 0..1.

    Raises
    ------
    StudyError
        If a flight diverges.
    """
    scenarios = {scenario.name: scenario for scenario in SCENARIOS}
    wanted = [(case, variant) for case in scenarios for variant in VARIANTS]
    return each(wanted, lambda one: run(scenarios[one[0]], VARIANTS[one[1]], seed), watch)


def judge(flights: Flights, seed: int) -> Figures:
    """Compute every figure of a seed's flights, and fly the variations.

    Returns
    -------
    dict
        Keys ``regulation/none`` and so on for the indicators, and those of `variations.vary` and `filters.compare`.
    """
    figures = {f"{case}/{variant}": indicators(flight) for (case, variant), flight in flights.items()}
    figures |= variations.vary(seed)
    return figures | filters.compare(flights[CIRCLE_TORQUE.name, "both"], seed)


def fly_and_judge(seed: int) -> Figures:
    """Fly every case with a seed and compute its figures."""
    return judge(fly_all(seed), seed)


def as_object(mean: Figures, spread: Figures, seeds: int) -> dict[str, Any]:
    """Build the object that ``--json`` prints.

    Returns
    -------
    dict
        By case, index and compensation, ``*_std`` beside each where more than one seed was flown; ``variations`` and
        ``filters`` by their names.
    """
    result: dict[str, Any] = {"seeds": seeds}
    for scenario in SCENARIOS:
        rows: dict[str, dict[str, float]] = {}
        for variant in VARIANTS:
            group = f"{scenario.name}/{variant}"
            for index, value in mean[group].items():
                row = rows.setdefault(index, {})
                row[variant] = value
                if seeds > 1:
                    row[f"{variant}_std"] = spread[group][index]
        result[scenario.name] = rows
    for key in (variations.GROUP, filters.GROUP):
        nested: dict[str, dict[str, dict[str, float]]] = {}
        for group, values in mean.items():
            if group.startswith(key):
                outer, _, inner = group.removeprefix(key).partition("/")
                nested.setdefault(outer, {})[inner] = values
        result[key.rstrip("/")] = nested
    return result
