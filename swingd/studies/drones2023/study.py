"""The whole study: every flight of a seed, its figures, and the object that a program reads."""

from collections.abc import Callable, Mapping
from typing import Any

from swingd.studies.drones2023 import paper
from swingd.studies.drones2023.cases import LAWS, SCENARIOS, VARIANTS
from swingd.studies.drones2023.flight import Flight, run
from swingd.studies.drones2023.indicators import disturbance, filter_errors, indicators, settled_after_s
from swingd.studies.seeds import Figures, each

Flights = Mapping[tuple[str, str], Flight]
"""By case and variant, see `swingd.studies.drones2023.cases.VARIANTS`."""


def fly_all(seed: int, watch: Callable[[float], None] = lambda _share: None) -> dict[tuple[str, str], Flight]:
    """Fly every variant of every case.

    Parameters
    ----------
    seed : int
        Of sensors and gusts; all variants of a case get the same weather.
    watch : callable
        Takes the share done, 0..1.

    Raises
    ------
    StudyError
        If a flight diverges.
    """
    scenarios = {scenario.name: scenario for scenario in SCENARIOS}
    wanted = [(case, variant) for case in scenarios for variant in VARIANTS[case]]
    return each(wanted, lambda one: run(scenarios[one[0]], LAWS[one[1]], seed), watch)


def judge(flights: Flights, seed: int) -> Figures:
    """Compute every figure of a seed's flights.

    Returns
    -------
    dict
        Keys ``case1/off`` and so on for the indicators, ``case1/on/change_percent`` for the changes against "off",
        ``case3/rmse/ekf`` and so on for the filters' errors in the flights without law, ``case2/force`` for the
        disturbance with the payload controller, ``case1/settled`` for its times under 5 %.
    """
    figures: Figures = {}
    for (case, variant), flight in flights.items():
        if case in paper.VALUES:
            figures[f"{case}/{variant}"] = indicators(flight)
        if variant == "off":
            for name, errors in filter_errors(flight, seed).items():
                figures[f"{case}/rmse/{name}"] = errors
    for case, variants in VARIANTS.items():
        for variant in variants:
            if case in paper.VALUES and variant != "off":
                off, on = figures[f"{case}/off"], figures[f"{case}/{variant}"]
                figures[f"{case}/{variant}/change_percent"] = {
                    index: 100.0 * (on[index] / off[index] - 1.0) for index in off
                }
    figures["case2/force"] = disturbance(flights["case2", "on"])
    figures["case1/settled"] = {variant: settled_after_s(flights["case1", variant]) for variant in VARIANTS["case1"]}
    return figures


def fly_and_judge(seed: int) -> Figures:
    """Fly every variant of every case with a seed and compute its figures."""
    return judge(fly_all(seed), seed)


def as_object(mean: Figures, spread: Figures, seeds: int) -> dict[str, Any]:
    """Build the object that ``--json`` prints.

    Returns
    -------
    dict
        By case and index: ``off``, ``on``, ``change_percent``, the paper's ``paper_off``, ``paper_on``,
        ``paper_change_percent``, the same for ``fgdf`` and ``default`` where they were flown, and ``*_std`` where more
        than one seed was. Beside them ``rmse``, ``force`` and ``settled``. What the paper does not print is left out.
    """
    result: dict[str, Any] = {"seeds": seeds}
    for case, printed in paper.VALUES.items():
        rows: dict[str, Any] = {}
        for index in paper.UNITS:
            row: dict[str, float] = {}
            for variant in VARIANTS[case]:
                change = "change_percent" if variant == "on" else f"{variant}_change_percent"
                changes = paper.CHANGES_PERCENT[case].get(variant, {})
                _put(row, variant, f"{case}/{variant}", index, mean, spread, seeds, printed.get(variant, {}))
                if variant != "off":
                    _put(row, change, f"{case}/{variant}/change_percent", index, mean, spread, seeds, changes)
            if row:
                rows[index] = row
        result[case] = rows
    result["rmse"] = _nested(mean, "/rmse/")
    result["force"] = mean["case2/force"] | {"paper_steady_estimated_y": paper.STEADY_FORCE_Y_N}
    result["settled"] = mean["case1/settled"] | {f"paper_{name}": value for name, value in paper.SETTLED_S.items()}
    return result


def _put(
    row: dict[str, float],
    name: str,
    group: str,
    index: str,
    mean: Figures,
    spread: Figures,
    seeds: int,
    printed: Mapping[str, float],
) -> None:
    if index not in mean[group]:
        return
    row[name] = mean[group][index]
    if seeds > 1:
        row[f"{name}_std"] = spread[group][index]
    if index in printed:
        row[f"paper_{name}"] = printed[index]


def _nested(mean: Figures, between: str) -> dict[str, dict[str, dict[str, float]]]:
    nested: dict[str, dict[str, dict[str, float]]] = {}
    for group, values in mean.items():
        case, found, name = group.partition(between)
        if found:
            nested.setdefault(case, {})[name] = values
    return nested
