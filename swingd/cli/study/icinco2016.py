"""``swingd study icinco2016``."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from swingd.cli import options, process, progress
from swingd.cli.study import shared

EXAMPLES = """\b
Examples:
  swingd study icinco2016
  swingd study icinco2016 -o out/study --format svg
  swingd study icinco2016 --seeds 20 --no-figures
  swingd study icinco2016 --no-figures --json | jq .circle_torque.error
"""


def icinco2016(
    folder: shared.Folder = Path("swingd-icinco2016"),
    seeds: shared.Seeds = 1,
    seed: shared.FirstSeed = 1,
    file_format: shared.Format = "png",
    figures: Annotated[bool, typer.Option(help="Draw figures 3 to 10.")] = True,
    as_json: options.Json = False,
) -> None:
    """Extended-state Kalman filter and hierarchical control of Escareno et al., ICINCO 2016 (section 5).

    A planar rotorcraft with a load on a rod flies to a point and along a circle, a torque acts between both after
    15 s, and the estimated disturbances are compensated in neither layer, in one or in both. Writes tables.csv,
    tables.md and one picture for each figure of the paper.
    """
    shared.prepare(folder, file_format, figures)
    process.announce_compilation("planar_flight", "the simulation", "twenty")
    from swingd.studies.icinco2016 import report
    from swingd.studies.icinco2016.cases import SCENARIOS
    from swingd.studies.icinco2016.study import as_object, fly_all, fly_and_judge, judge

    with progress.bar("flying", as_json) as watch:
        flights = fly_all(seed, watch)
    mean, spread = shared.over_seeds(judge(flights, seed), fly_and_judge, seed, seeds, as_json)
    table = list(report.rows(mean, spread))
    report.write_csv(folder / "tables.csv", table)
    report.write_markdown(folder / "tables.md", table, mean, spread, seeds)
    draw = None
    if figures:
        from swingd.studies.icinco2016.figures import draw as draw_all

        draw = partial(draw_all, flights, folder, file_format)

    shared.tell(
        folder,
        draw,
        as_object(mean, spread, seeds),
        {scenario.name: report.case_table(scenario.name, table, seeds) for scenario in SCENARIOS}
        | {
            report.VARIATIONS_TITLE: report.variations_table(mean, spread, seeds),
            report.FILTERS_TITLE: report.filters_table(mean),
        },
        as_json,
    )
