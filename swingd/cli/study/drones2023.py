"""``swingd study drones2023``."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from swingd.cli import options, process, progress
from swingd.cli.study import shared

EXAMPLES = """\b
Examples:
  swingd study drones2023
  swingd study drones2023 -o out/study --format svg
  swingd study drones2023 --seeds 20 --no-figures
  swingd study drones2023 --no-figures --json | jq .case1.t_m
"""


def drones2023(
    folder: shared.Folder = Path("swingd-drones2023"),
    seeds: shared.Seeds = 1,
    seed: shared.FirstSeed = 1,
    file_format: shared.Format = "png",
    figures: Annotated[bool, typer.Option(help="Draw figures 4 to 16 and 18 to 21.")] = True,
    as_json: options.Json = False,
) -> None:
    """Swing EKF, FGDF baseline and payload controller of Drones 2023, 7, 654 (section 4).

    An octarotor with 100 kg on 15 m flies cases 1 to 3 without and with the payload controller, and with swingd's own
    law; an X500 flies manoeuvres 1 and 2. Writes tables.csv, tables.md and one picture for each figure of the paper.
    """
    shared.prepare(folder, file_format, figures)
    process.announce_compilation("slung_flight", "the simulation", "forty")
    from swingd.studies.drones2023 import paper, report
    from swingd.studies.drones2023.study import as_object, fly_all, fly_and_judge, judge

    with progress.bar("flying", as_json) as watch:
        flights = fly_all(seed, watch)
    mean, spread = shared.over_seeds(judge(flights, seed), fly_and_judge, seed, seeds, as_json)
    table = list(report.rows(mean, spread))
    report.write_csv(folder / "tables.csv", table)
    report.write_markdown(folder / "tables.md", table, mean, seeds)
    draw = None
    if figures:
        from swingd.studies.drones2023.figures import draw as draw_all

        draw = partial(draw_all, flights, folder, file_format)

    shared.tell(
        folder,
        draw,
        as_object(mean, spread, seeds),
        {case: report.case_table(case, table, seeds) for case in paper.VALUES}
        | {report.RMSE_TITLE: report.rmse_table(mean), report.FORCE_TITLE: report.force_table(mean)},
        as_json,
    )
