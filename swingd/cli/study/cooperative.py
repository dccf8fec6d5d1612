"""``swingd study cooperative``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from swingd.cli import options, process, progress
from swingd.cli.study import shared

EXAMPLES = """\b
Examples:
  swingd study cooperative
  swingd study cooperative --seed 6 --seeds 5 --no-figures
  swingd study cooperative --no-figures --json | jq .table3.yaw
"""


def cooperative(
    folder: shared.Folder = Path("swingd-cooperative"),
    seeds: shared.Seeds = 1,
    seed: shared.FirstSeed = 1,
    file_format: shared.Format = "png",
    figures: Annotated[bool, typer.Option(help="Draw figures 4 to 8, 11 and 12.")] = True,
    as_json: options.Json = False,
) -> None:
    """Tether UKF and the pose of a load that two vehicles carry (Ohira, Asignacion, Suzuki).

    Two quadrotors with a box on four tethers fly attitude and position manoeuvres and the noisy experiment; the
    paper's filter, its errors put right, and swingd's own estimate the load from the vehicles' measurements. Writes
    tables.csv, tables.md and one picture for each figure of the paper.
    """
    shared.prepare(folder, file_format, figures)
    process.announce_compilation("cooperative_flight", "the simulation", "thirty")
    from swingd.studies.cooperative import report
    from swingd.studies.cooperative.study import as_object, fly_all, fly_and_judge, judge
    from swingd.studies.seeds import mean_and_spread, repeat

    with progress.bar("flying", as_json) as watch:
        study = fly_all(seed, watch)
    repeated = [judge(study)]
    if seeds > 1:
        with progress.bar(f"flying {seeds - 1} more seeds", as_json) as watch:
            repeated += repeat(fly_and_judge, range(seed + 1, seed + seeds), watch)
    mean, spread = mean_and_spread(repeated)
    report.write_csv(folder / "tables.csv", list(report.rows(mean, spread)))
    report.write_markdown(folder / "tables.md", mean, spread, seeds)
    if figures:
        from swingd.studies.cooperative.figures import draw

        with progress.bar("drawing", as_json) as watch:
            draw(study, folder, file_format, watch)
    if as_json:
        typer.echo(json.dumps(as_object(mean, spread, seeds), allow_nan=False))
        return
    shared.print_tables(report.tables(mean, spread, seeds))
    typer.echo(f"tables{' and figures' if figures else ''}: {folder}")
