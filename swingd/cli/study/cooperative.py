"""``swingd study cooperative``."""

from functools import partial
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

    with progress.bar("flying", as_json) as watch:
        study = fly_all(seed, watch)
    mean, spread = shared.over_seeds(judge(study), fly_and_judge, seed, seeds, as_json)
    report.write_csv(folder / "tables.csv", list(report.rows(mean, spread)))
    report.write_markdown(folder / "tables.md", mean, spread, seeds)
    draw = None
    if figures:
        from swingd.studies.cooperative.figures import draw as draw_all

        draw = partial(draw_all, study, folder, file_format)

    shared.tell(folder, draw, as_object(mean, spread, seeds), report.tables(mean, spread, seeds), as_json)
