"""The study's tables: paper, ours and difference, as CSV, Markdown and rows for a terminal."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from math import isnan, nan
from pathlib import Path

from swingd.studies.drones2023 import paper
from swingd.studies.drones2023.cases import VARIANTS
from swingd.studies.drones2023.indicators import SWING_NAMES
from swingd.studies.drones2023.study import Figures

LAW_NAMES = {"off": "none", "on": "(16) on EKF", "fgdf": "(16) on FGDF", "default": "default law"}
_RMSE_COLUMNS = ("ekf", "fgdf", "ekf_potentiometer", "fgdf_potentiometer")


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
                ours = mean[f"{case}/{law}"][index]
                if isnan(ours):
                    continue
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
            writer.writerow([value if isinstance(value, str) else _number(value, 6) for value in astuple(row)])


def write_markdown(path: Path, table: Sequence[Row], mean: Figures, seeds: int) -> None:
    """Write all tables as one page."""
    lines = [f"# Drones 2023, 7, 654, recomputed ({seeds} seed{'s' if seeds > 1 else ''})", ""]
    for case in paper.VALUES:
        lines += [f"## {case}", ""]
        lines += _markdown(HEADINGS, [cells(row, seeds) for row in table if row.case == case])
        lines.append("")
    lines += ["## RMSE of the filters without payload controller", ""]
    lines += _markdown(RMSE_HEADINGS, list(rmse_cells(mean)))
    lines += ["", "## Disturbance force in case 2 with payload controller", ""]
    lines += _markdown(FORCE_HEADINGS, list(force_cells(mean)))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


HEADINGS = ("index", "law", "paper", "ours", "paper's change", "our change", "difference")


def cells(row: Row, seeds: int) -> tuple[str, ...]:
    """Return one row as text, in the order of `HEADINGS`."""
    spread = f" ± {_number(row.ours_std, 3)}" if seeds > 1 else ""
    change_spread = f" ± {row.change_percent_std:.1f}" if seeds > 1 and not isnan(row.change_percent) else ""
    difference = "" if isnan(row.difference) else f"{row.difference:+.1f} {'%' if row.law == 'none' else 'points'}"
    return (
        f"{row.index} [{row.unit}]",
        row.law,
        _number(row.paper, 5),
        _number(row.ours, 4) + spread,
        _percent(row.paper_change_percent),
        _percent(row.change_percent) + change_spread,
        difference,
    )


RMSE_HEADINGS = ("case", "quantity", "EKF", "FGDF", "EKF to potentiometer", "FGDF to potentiometer")


def rmse_cells(mean: Figures) -> Iterator[tuple[str, ...]]:
    """Yield the filters' errors as text."""
    for case in VARIANTS:
        for name in SWING_NAMES:
            errors = (mean.get(f"{case}/rmse/{column}", {}).get(name, nan) for column in _RMSE_COLUMNS)
            quantity, unit = name.split("_deg")
            yield (case, f"{quantity} [deg{'/s' if unit else ''}]", *(_number(error, 3) for error in errors))


FORCE_HEADINGS = ("axis", "true, RMS [N]", "error, RMSE [N]", "true, 20 to 30 s [N]", "estimated, 20 to 30 s [N]")


def force_cells(mean: Figures) -> Iterator[tuple[str, ...]]:
    """Yield the disturbance's figures as text."""
    force = mean["case2/force"]
    for axis in "xyz":
        names = ("true_rms", "rmse", "steady_true", "steady_estimated")
        yield (axis, *(f"{force[f'{name}_{axis}']:.2f}" for name in names))


def _markdown(headings: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    return [
        "| " + " | ".join(headings) + " |",
        "|" + "---|" * len(headings),
        *("| " + " | ".join(row) + " |" for row in body),
    ]


def _number(value: float, digits: int) -> str:
    return "" if isnan(value) else f"{value:.{digits}g}"


def _percent(value: float) -> str:
    return "" if isnan(value) else f"{value:+.1f} %"
