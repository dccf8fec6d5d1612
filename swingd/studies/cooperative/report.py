"""The study's tables: paper, its filter here and ours, as CSV, Markdown and rows for a terminal."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from swingd.studies.cooperative import paper
from swingd.studies.cooperative.study import CASES, PRINTED, STEP_NAMES
from swingd.studies.seeds import Figures
from swingd.studies.tables import Table, markdown, number, percent, with_spread

TITLE = "Table 3: RMSE in the experiment"
LARGEST_TITLE = "Table 3: largest errors in the experiment"
STEPS_TITLE = "From the paper's filter to ours, one change after the other, RMSE in the experiment"
VIBRATION_TITLE = "RMSE in the experiment with a vibration of 2 m/s^2 RMS at 22 Hz on each axis"
MANOEUVRES_TITLE = "RMSE in the manoeuvres without noise (4.1, 4.2)"
HOVER_TITLE = "Hover over a full battery: largest error of the thrust"


@dataclass(frozen=True, slots=True)
class Row:
    """One state of one case with one estimator; empty where the paper prints nothing."""

    case: str
    estimator: str
    state: str
    unit: str
    printed: float
    printed_largest: float
    rmse: float
    rmse_std: float
    """Over the seeds."""
    largest: float
    change_percent: float
    """Against the paper's filter."""


def rows(mean: Figures, spread: Figures) -> Iterator[Row]:
    """Yield every case and estimator."""
    nan = float("nan")
    for scenario, _ in CASES:
        case = scenario.name
        for estimator in ("paper", *(STEP_NAMES if case == "experiment" else ()), "ours"):
            group, change = f"{case}/{estimator}", f"{case}/{estimator}/change_percent"
            for state, unit in paper.UNITS.items():
                told = case == "experiment" and estimator == "paper"
                yield Row(
                    case,
                    estimator,
                    state,
                    unit,
                    paper.RMSE[state] if told else nan,
                    paper.LARGEST[state] if told else nan,
                    mean[group][state],
                    spread[group][state],
                    mean[f"{group}/largest"][state],
                    mean[change][state] if change in mean else nan,
                )


def write_csv(path: Path, table: Sequence[Row]) -> None:
    """Write the rows; empty where there is no value."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([field.name for field in fields(Row)])
        for row in table:
            writer.writerow([value if isinstance(value, str) else number(value, 6) for value in astuple(row)])


def tables(mean: Figures, spread: Figures, seeds: int) -> dict[str, Table]:
    """Build all tables under their titles."""
    return {
        TITLE: _table3(mean, spread, seeds, "", paper.RMSE),
        LARGEST_TITLE: _table3(mean, spread, seeds, "/largest", paper.LARGEST),
        STEPS_TITLE: _steps(mean),
        VIBRATION_TITLE: _vibration(mean),
        MANOEUVRES_TITLE: _manoeuvres(mean),
        HOVER_TITLE: _hover(mean, spread, seeds),
    }


def write_markdown(path: Path, mean: Figures, spread: Figures, seeds: int) -> None:
    """Write all tables as one page."""
    lines = [f"# Tether UKF and cooperative payload, recomputed ({seeds} seed{'s' if seeds > 1 else ''})"]
    for title, table in tables(mean, spread, seeds).items():
        lines += ["", f"## {title}", "", *markdown(*table)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _table3(mean: Figures, spread: Figures, seeds: int, what: str, printed: dict[str, float]) -> Table:
    body: list[tuple[str, ...]] = []
    for state, unit in paper.UNITS.items():
        theirs, ours = mean[f"experiment/paper{what}"][state], mean[f"experiment/ours{what}"][state]
        body.append(
            (
                f"{state} [{unit}]",
                number(printed[state], 4),
                with_spread(number(theirs, 3), spread[f"experiment/paper{what}"][state], seeds),
                with_spread(number(ours, 3), spread[f"experiment/ours{what}"][state], seeds),
                percent(100.0 * (ours / theirs - 1.0)),
            )
        )
    return ("state", "printed", "paper's filter, corrected", "ours", "change"), body


def _steps(mean: Figures) -> Table:
    body = [
        (name, *(number(mean[f"experiment/{name}"][state], 3) for state in paper.UNITS))
        for name in ("paper", *STEP_NAMES, "ours")
    ]
    return ("estimator", *(f"{state} [{unit}]" for state, unit in paper.UNITS.items())), body


def _vibration(mean: Figures) -> Table:
    body = [
        (name, *(number(mean[f"vibration/{variant}"][state], 3) for state in paper.UNITS))
        for variant, name in (
            ("paper", "paper's filter, corrected"),
            ("unfiltered", "ours, unfiltered"),
            ("ours", "ours"),
        )
    ]
    return ("estimator", *(f"{state} [{unit}]" for state, unit in paper.UNITS.items())), body


def _manoeuvres(mean: Figures) -> Table:
    body = [
        (f"{case}, {name}", *(number(mean[f"{case}/{variant}"][state], 3) for state in paper.UNITS))
        for case in ("attitude", "position")
        for variant, name in (("paper", "paper's filter, corrected"), ("ours", "ours"))
    ]
    held = [
        (
            f"{scenario.name}, (17) as printed",
            f"lost after {mean[f'{scenario.name}/{PRINTED}']['held_s']:.1f} s",
            *[""] * 5,
        )
        for scenario, _ in CASES
    ]
    return ("case", *(f"{state} [{unit}]" for state, unit in paper.UNITS.items())), body + held


def _hover(mean: Figures, spread: Figures, seeds: int) -> Table:
    body: list[tuple[str, ...]] = [
        (f"{name} [%]", with_spread(number(value, 3), spread["hover"][name], seeds))
        for name, value in mean["hover"].items()
    ]
    return ("thrust curve", "largest error"), body
