"""What every study's command does alike: options, checks before the work, tables on the terminal."""

import json
import sys
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swingd.cli import progress

if TYPE_CHECKING:
    from swingd.studies.seeds import Figures
    from swingd.studies.tables import Table

WIDTH = 120
"""Of the tables where nobody watches a terminal."""

Seeds = Annotated[int, typer.Option(min=1, max=10000, help="Repeat with this many seeds; mean and spread.")]
FirstSeed = Annotated[int, typer.Option(min=0, max=2**31 - 1, help="First seed; the figures show it.")]
Format = Annotated[str, typer.Option("--format", metavar="png|svg", help="Of the figures.")]
Folder = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where tables and figures go.")]


def prepare(folder: Path, file_format: str, figures: bool) -> None:
    """Make the folder, and refuse before any work what could not be drawn or written after it.

    Raises
    ------
    ConfigurationError
        If the format is unknown, matplotlib is missing or the folder cannot be made.
    """
    from swingd.model.errors import ConfigurationError

    if file_format not in ("png", "svg"):
        raise ConfigurationError(f"--format: {file_format!r} given; expected png or svg")
    if figures and find_spec("matplotlib") is None:
        raise ConfigurationError("matplotlib is not installed; expected: pip install 'swingd[study]', or --no-figures")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"--output: {folder} cannot be made: {error.strerror}") from None


def over_seeds(
    first: "Figures", judged: "Callable[[int], Figures]", seed: int, seeds: int, quiet: bool
) -> "tuple[Figures, Figures]":
    """Fly and judge the seeds behind the first; mean and spread of every figure over all of them.

    Parameters
    ----------
    first : Figures
        Of ``seed``.
    judged : callable
        Takes a seed and gives its figures; see `swingd.studies.seeds.repeat`.
    seed, seeds : int
        The first one, and how many there are.
    quiet : bool
        Shows no progress.
    """
    from swingd.studies.seeds import mean_and_spread, repeat

    repeated = [first]
    if seeds > 1:
        with progress.bar(f"flying {seeds - 1} more seeds", quiet) as watch:
            repeated += repeat(judged, range(seed + 1, seed + seeds), watch)
    return mean_and_spread(repeated)


def tell(
    folder: Path, draw: "Callable[[Callable[[float], None]], object] | None", found: Any, tables: "Mapping[str, Table]",
    as_json: bool,
) -> None:  # fmt: skip
    """Draw the figures, if there are to be any, and print what was found: one object, or tables."""
    if draw is not None:
        with progress.bar("drawing", as_json) as watch:
            draw(watch)
    if as_json:
        typer.echo(json.dumps(found, allow_nan=False))
        return
    print_tables(tables)
    typer.echo(f"tables{' and figures' if draw is not None else ''}: {folder}")


def print_tables(tables: "Mapping[str, Table]") -> None:
    """Print tables under their titles; the first column is text, the others are numbers."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, width=None if sys.stdout.isatty() else WIDTH)
    for title, (headings, body) in tables.items():
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        for number, heading in enumerate(headings):
            table.add_column(heading, justify="right" if number else "left", no_wrap=True)
        for row in body:
            table.add_row(*row)
        console.print(table)
