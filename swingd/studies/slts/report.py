"""The study's tables: paper and ours, filters and camera, as CSV, Markdown and rows for a terminal."""

import csv
from collections.abc import Mapping
from math import nan
from pathlib import Path

from swingd.identify.gp_training import Training
from swingd.studies.seeds import Figures
from swingd.studies.slts import paper
from swingd.studies.slts.cases import SCENARIOS
from swingd.studies.slts.study import ESTIMATE
from swingd.studies.tables import Table, markdown, number, with_spread

ESTIMATE_TITLE = "Error of the load's relative position"
TRAINING_TITLE = "Acceleration error of the cable, held-out flights"


def tables(mean: Figures, spread: Figures, seeds: int, trained: Mapping[str, Training]) -> dict[str, Table]:
    """Build every table under its title."""
    result = {scenario.name: following_table(scenario.name, mean, spread, seeds) for scenario in SCENARIOS}
    result[ESTIMATE_TITLE] = estimate_table(mean, spread, seeds)
    result[TRAINING_TITLE] = training_table(trained)
    return result


def following_table(name: str, mean: Figures, spread: Figures, seeds: int) -> Table:
    """Build one path's table."""
    body: list[tuple[str, ...]] = [
        (
            f"{index} [{unit}]",
            with_spread(number(mean[name][index], 3), spread[name][index], seeds),
            number(paper.VALUES[name].get(index, nan), 4),
        )
        for index, unit in paper.UNITS.items()
        if index in mean[name]
    ]
    return ("index", "ours", "paper"), body


def estimate_table(mean: Figures, spread: Figures, seeds: int) -> Table:
    """Build the table of filters and camera."""
    body = []
    for group, found in mean.items():
        if not group.startswith(ESTIMATE):
            continue
        deviation = spread[group]

        def cell(index: str, digits: int, found: dict[str, float] = found, by: dict[str, float] = deviation) -> str:
            return with_spread(number(found[index], digits), by[index], seeds)

        body.append(
            (
                group.removeprefix(ESTIMATE),
                *(cell(f"{source}_rmse", 3) for source in ("gp_ekf", "ekf", "camera")),
                cell("gain", 2),
                *(cell(f"{source}_max", 3) for source in ("gp_ekf", "ekf", "camera")),
                number(found["gp_ekf_nees"], 3),
                number(100.0 * found["gp_ekf_within_3_sigma"], 4),
            )
        )
    headings = (
        "path", "GP-EKF RMSE [m]", "EKF", "camera", "GP gains [%]", "GP-EKF max [m]", "EKF", "camera", "NEES (4)",
        "in 3 sigma [%]",
    )  # fmt: skip
    return headings, body


def training_table(trained: Mapping[str, Training]) -> Table:
    """Build the table of what the Gaussian processes learned."""
    body: list[tuple[str, ...]] = [
        (
            name,
            str(len(training.trained.z)),
            str(len(training.held_out.z)),
            number(training.score.rmse_before, 3),
            number(training.score.rmse_after, 3),
            number(training.score.log_likelihood_before, 3),
            number(training.score.log_likelihood_after, 3),
        )
        for name, training in trained.items()
    ]
    headings = ("vehicle", "trained on", "held out", "RMSE before [m/s^2]", "after", "log likelihood before", "after")
    return headings, body


def write_csv(path: Path, mean: Figures, spread: Figures) -> None:
    """Write every figure: path, index, unit, ours, its deviation, the paper's; empty where there is none."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["path", "index", "unit", "ours", "ours_std", "paper"])
        for group, values in mean.items():
            for index, value in values.items():
                printed = paper.VALUES.get(group, {}).get(index, nan)
                unit = paper.UNITS.get(index, "")
                table.writerow(
                    [group, index, unit, number(value, 6), number(spread[group][index], 6), number(printed, 6)]
                )


def write_markdown(path: Path, made: Mapping[str, Table], seeds: int) -> None:
    """Write all tables as one page."""
    lines = [f"# Path following of a slung load, recomputed ({seeds} seed{'s' if seeds > 1 else ''})", ""]
    for title, table in made.items():
        lines += [f"## {title}", "", *markdown(*table), ""]
    path.write_text("\n".join(lines), encoding="utf-8")
