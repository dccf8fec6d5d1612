"""The study's tables as CSV, Markdown and rows for a terminal. The paper prints no figures to stand beside them."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from swingd.studies.icinco2016 import filters, paper, variations
from swingd.studies.icinco2016.cases import SCENARIOS, VARIANTS
from swingd.studies.icinco2016.indicators import AXES, UNITS
from swingd.studies.seeds import Figures
from swingd.studies.tables import Table, markdown, number, with_spread

VARIATIONS_TITLE = "Tracking error with compensation over that without, what was chosen varied one by one"
FILTERS_TITLE = (
    "RMSE of rho over its RMS, circle with torque: other densities Q of its walk, other variances R of sensors"
)


@dataclass(frozen=True, slots=True)
class Row:
    """One index of one case with one compensation."""

    case: str
    compensation: str
    index: str
    unit: str
    ours: float
    ours_std: float
    """Over the seeds."""


def rows(mean: Figures, spread: Figures) -> Iterator[Row]:
    """Yield every case's indices."""
    for scenario in SCENARIOS:
        for index, unit in UNITS.items():
            for variant in VARIANTS:
                group = f"{scenario.name}/{variant}"
                if index in mean[group]:
                    yield Row(scenario.name, variant, index, unit, mean[group][index], spread[group][index])


def write_csv(path: Path, table: Sequence[Row]) -> None:
    """Write the rows."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([field.name for field in fields(Row)])
        for row in table:
            writer.writerow([value if isinstance(value, str) else number(value, 6) for value in astuple(row)])


def write_markdown(path: Path, table: Sequence[Row], mean: Figures, spread: Figures, seeds: int) -> None:
    """Write all tables as one page."""
    lines = [f"# ICINCO 2016, ES-LKF and hierarchical control, recomputed ({seeds} seed{'s' if seeds > 1 else ''})", ""]
    for scenario in SCENARIOS:
        lines += [f"## {scenario.name}", "", *markdown(*case_table(scenario.name, table, seeds)), ""]
    lines += [f"## {VARIATIONS_TITLE}", "", *markdown(*variations_table(mean, spread, seeds)), ""]
    lines += [f"## {FILTERS_TITLE}", "", *markdown(*filters_table(mean))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def case_table(case: str, table: Sequence[Row], seeds: int) -> Table:
    """Build one case's table, a column for each compensation."""
    body = []
    for index, unit in UNITS.items():
        found = {row.compensation: row for row in table if row.case == case and row.index == index}
        if found:
            body.append((f"{index} [{unit}]", *(_cell(found[variant], seeds) for variant in VARIANTS)))
    return ("compensation", *VARIANTS), body


def variations_table(mean: Figures, spread: Figures, seeds: int) -> Table:
    """Build the table of the variations, for both tasks and both layers."""
    headings = {"regulation_torque": "regulation", "circle_torque": "circle"}
    groups: dict[str, dict[str, str]] = {}
    for group, values in mean.items():
        if group.startswith(variations.GROUP):
            task, _, name = group.removeprefix(variations.GROUP).partition("/")
            for layer, value in values.items():
                cell = with_spread(number(value, 2), spread[group][layer], seeds)
                groups.setdefault(name, {})[f"{layer}, {headings[task]}"] = cell
    columns = [f"{layer}, {task}" for layer in variations.RATIOS for task in headings.values()]
    # The regulation has no circle whose frequency could be changed.
    return ("factor", *columns), [(name, *(cells.get(c, "") for c in columns)) for name, cells in groups.items()]


def filters_table(mean: Figures) -> Table:
    """Build the table of other filters and sensors, the cells by axis."""
    body = []
    for var in filters.SENSOR_VARS:
        for axis in AXES:
            cells = (mean[f"{filters.GROUP}R {var:g}/Q {density:g}"][axis] for density in filters.DENSITIES)
            body.append((f"R = {var:g}, rho_{axis}", *(f"{cell:.0f}%" for cell in cells)))
    return ("", *(f"Q = {density:g}" for density in filters.DENSITIES)), body


def _cell(row: Row, seeds: int) -> str:
    if row.index == "settled" and row.ours >= paper.TORQUE_AT_S:
        return "no"
    # What no noise reaches differs by rounding.
    spread = row.ours_std if row.ours_std > 1e-9 * row.ours else 0.0
    return with_spread(number(row.ours, 3), spread, seeds)
