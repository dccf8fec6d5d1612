"""The study's tables: paper, ours and difference, as CSV, Markdown and rows for a terminal."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from math import nan
from pathlib import Path

from swingd.studies.drones2023 import paper
from swingd.studies.drones2023.cases import VARIANTS
from swingd.studies.drones2023.indicators import SWING_NAMES
from swingd.studies.seeds import Figures
from swingd.studies.tables import Table, markdown, number, percent, with_spread

LAW_NAMES = {"off": "none", "on": "(16) EKF", "fgdf": "(16) FGDF", "default": "default"}
RMSE_TITLE = "Filters without payload controller, against the truth and against the potentiometer's readings"
FORCE_TITLE = "Disturbance force of case 2 with payload controller"
_RMSE_COLUMNS = ("ekf", "fgdf", "pendulum", "ekf_potentiometer", "fgdf_potentiometer")


@dataclass(frozen=True, slots=True)
class Row:
    """One index of one case with one law; nan where the paper prints nothing, or where there is nothing to compare."""

    case: str
    law: str
    index: str
    unit: str
    paper: float
    ours: float
    ours_std: float
    """Over the seeds."""
    paper_change_percent: float
    """Against no law."""
    change_percent: float
    change_percent_std: float
    difference: float
    """Ours against the paper's: of a change in percentage points, of a value without law in percent."""


def rows(mean: Figures, spread: Figures) -> Iterator[Row]:
    """Yield Tables 2, 3 and 5, each with swingd's own law beside the paper's."""
    for case, printed in paper.VALUES.items():
        for index, unit in paper.UNITS.items():
            for law in VARIANTS[case]:
                if index not in mean[f"{case}/{law}"] or (index == "distance_to_go" and case != "case3"):
                    continue
                ours = mean[f"{case}/{law}"][index]
                theirs = printed.get(law, {}).get(index, nan)
                changes, off = f"{case}/{law}/change_percent", law == "off"
                change = nan if off else mean[changes][index]
                paper_change = nan if off else paper.CHANGES_PERCENT[case].get(law, {}).get(index, nan)
                yield Row(
                    case,
                    LAW_NAMES[law],
                    index,
                    unit,
                    theirs,
                    ours,
                    spread[f"{case}/{law}"][index],
                    paper_change,
                    change,
                    nan if off else spread[changes][index],
                    100.0 * (ours / theirs - 1.0) if off else change - paper_change,
                )


def write_csv(path: Path, table: Sequence[Row]) -> None:
    """Write the rows; empty where there is no value."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([field.name for field in fields(Row)])
        for row in table:
            writer.writerow([value if isinstance(value, str) else number(value, 6) for value in astuple(row)])


def write_markdown(path: Path, table: Sequence[Row], mean: Figures, seeds: int) -> None:
    """Write all tables as one page."""
    lines = [f"# Drones 2023, 7, 654, recomputed ({seeds} seed{'s' if seeds > 1 else ''})", ""]
    for case in paper.VALUES:
        lines += [f"## {case}", ""]
        lines += markdown(*case_table(case, table, seeds))
        lines.append("")
    lines += [f"## {RMSE_TITLE}", ""]
    lines += markdown(*rmse_table(mean))
    lines += ["", f"## {FORCE_TITLE}", ""]
    lines += markdown(*force_table(mean))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def case_table(case: str, table: Sequence[Row], seeds: int) -> Table:
    """Build one case's table: without law, and every law's change; each with the paper's figure where it prints one."""
    laws = [LAW_NAMES[law] for law in VARIANTS[case] if law != "off"]
    printed = [name for name in laws if any(row.law == name and row.paper == row.paper for row in table)]
    headings = ["index", "no law", "paper"]
    for name in laws:
        headings += [name, "paper"] if name in printed else [name]
    body = []
    for index, unit in paper.UNITS.items():
        found = {row.law: row for row in table if row.case == case and row.index == index}
        if not found:
            continue
        off = found[LAW_NAMES["off"]]
        cells = [f"{index} [{unit}]", with_spread(number(off.ours, 4), off.ours_std, seeds), number(off.paper, 5)]
        for name in laws:
            row = found[name]
            cells.append(with_spread(percent(row.change_percent), row.change_percent_std, seeds))
            if name in printed:
                cells.append(percent(row.paper_change_percent))
        body.append(tuple(cells))
    return tuple(headings), body


def rmse_table(mean: Figures) -> Table:
    """Build the table of the filters' errors."""
    body = []
    for case in VARIANTS:
        for name in SWING_NAMES:
            errors = (mean.get(f"{case}/rmse/{column}", {}).get(name, nan) for column in _RMSE_COLUMNS)
            quantity, unit = name.split("_deg")
            quantity = f"{quantity} [deg{'/s' if unit else ''}]"
            body.append((case, quantity, *(number(error, 3) for error in errors)))
    return ("case", "RMSE of", "EKF", "FGDF", "pendulum", "EKF, read", "FGDF, read"), body


def force_table(mean: Figures) -> Table:
    """Build the table of the estimated disturbance, case 2 with the payload controller."""
    force = mean["case2/force"]
    names = ("true_rms", "rmse", "steady_true", "steady_estimated")
    body = [(axis, *(f"{force[f'{name}_{axis}']:.2f}" for name in names)) for axis in "xyz"]
    return ("axis", "true RMS [N]", "RMSE [N]", "true mean, 20-30 s", "estimated mean"), body
