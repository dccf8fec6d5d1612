"""``swingd study``."""

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swingd.cli import options, process, progress

if TYPE_CHECKING:
    from swingd.studies.drones2023.report import Row
    from swingd.studies.drones2023.study import Figures

EXAMPLES = """\b
Examples:
  swingd study drones2023
"""

study = typer.Typer(no_args_is_help=True)

WIDTH = 120
"""Of the tables where nobody watches a terminal."""

DRONES2023_EXAMPLES = """\b
Examples:
  swingd study drones2023
  swingd study drones2023 -o out/study --format svg
  swingd study drones2023 --seeds 20 --no-figures
  swingd study drones2023 --no-figures --json | jq .case1.t_m
"""


@study.callback(epilog=EXAMPLES)
def _study() -> None:
    """Recompute the cases of a paper: tables beside the printed ones, figures."""


@study.command(epilog=DRONES2023_EXAMPLES)
def drones2023(
    folder: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where tables and figures go.")] = Path(
        "swingd-drones2023"
    ),
    seeds: Annotated[
        int, typer.Option(min=1, max=10000, help="Repeat with this many seeds of noise and gusts; mean and spread.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="First seed; the figures show it.")] = 1,
    file_format: Annotated[str, typer.Option("--format", metavar="png|svg", help="Of the figures.")] = "png",
    figures: Annotated[bool, typer.Option(help="Draw figures 4 to 16 and 18 to 21.")] = True,
    as_json: options.Json = False,
) -> None:
    """Swing EKF, FGDF baseline and payload controller of Drones 2023, 7, 654 (section 4).

    An octarotor with 100 kg on 15 m flies cases 1 to 3 without and with the payload controller, and with swingd's own
    law; an X500 flies manoeuvres 1 and 2. Writes tables.csv, tables.md and one picture for each figure of the paper.
    """
    from swingd.model.errors import ConfigurationError

    if file_format not in ("png", "svg"):
        raise ConfigurationError(f"--format: {file_format!r} given; expected png or svg")
    if figures and find_spec("matplotlib") is None:
        raise ConfigurationError("matplotlib is not installed; expected: pip install 'swingd[study]', or --no-figures")
    process.announce_compilation("slung_flight", "the simulation", "forty")
    from swingd.studies.drones2023.report import rows, write_csv, write_markdown
    from swingd.studies.drones2023.study import as_object, fly_all, judge, mean_and_spread, repeat

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"--output: {folder} cannot be made: {error.strerror}") from None
    with progress.bar("flying", as_json) as watch:
        flights = fly_all(seed, watch)
    repeated = [judge(flights, seed)]
    if seeds > 1:
        with progress.bar(f"flying {seeds - 1} more seeds", as_json) as watch:
            repeated += repeat(range(seed + 1, seed + seeds), watch)
    mean, spread = mean_and_spread(repeated)
    table = list(rows(mean, spread))
    write_csv(folder / "tables.csv", table)
    write_markdown(folder / "tables.md", table, mean, seeds)
    if figures:
        from swingd.studies.drones2023.figures import draw

        with progress.bar("drawing", as_json) as watch:
            draw(flights, folder, file_format, watch)
    if as_json:
        typer.echo(json.dumps(as_object(mean, spread, seeds), allow_nan=False))
    else:
        _print(table, mean, seeds)
        typer.echo(f"tables{' and figures' if figures else ''}: {folder}")


def _print(rows: "list[Row]", mean: "Figures", seeds: int) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from swingd.studies.drones2023 import paper, report

    console = Console(markup=False, width=None if sys.stdout.isatty() else WIDTH)
    tables = {case: report.case_table(case, rows, seeds) for case in paper.VALUES}
    tables |= {report.RMSE_TITLE: report.rmse_table(mean), report.FORCE_TITLE: report.force_table(mean)}
    for title, (headings, body) in tables.items():
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        for number, heading in enumerate(headings):
            table.add_column(heading, justify="right" if number else "left", no_wrap=True)
        for row in body:
            table.add_row(*row)
        console.print(table)
