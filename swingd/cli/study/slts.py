"""``swingd study slts``."""

from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from swingd.cli import options, process, progress
from swingd.cli.study import shared

EXAMPLES = """\b
Examples:
  swingd study slts
  swingd study slts -o out/study --format svg
  swingd study slts --seeds 20 --no-figures
  swingd study slts --no-figures --json | jq .square.lateral_rms
"""


def slts(
    folder: shared.Folder = Path("swingd-slts"),
    seeds: shared.Seeds = 1,
    seed: shared.FirstSeed = 1,
    file_format: shared.Format = "png",
    figures: Annotated[bool, typer.Option(help="Draw figures 3 to 6.")] = True,
    as_json: options.Json = False,
) -> None:
    """GP-EKF and robust path following of a slung load transport system (section VI of the paper).

    A quadrotor flies its load along a square of 80 m and a circle of 15 m, and another one, whose rotors are weaker
    than it believes, along a square of 10 m in wind; the loop is closed on the GP-EKF, which a simulated camera
    corrects. Trains the Gaussian processes on other flights first. Writes tables.csv, tables.md, the training logs and
    models, and one picture for each figure of the paper.
    """
    from swingd.model.errors import ConfigurationError

    shared.prepare(folder, file_format, figures)
    if find_spec("sklearn") is None:
        raise ConfigurationError("scikit-learn is not installed; expected: pip install 'swingd[study,train]'")
    process.announce_compilation("slts_flight", "the simulation", "forty")
    from swingd.studies.slts import report
    from swingd.studies.slts.study import as_object, fly_all, fly_and_judge, judge
    from swingd.studies.slts.training import train_all

    logs = folder / "training"
    logs.mkdir(exist_ok=True)
    with progress.bar("training", as_json) as watch:
        trained = train_all(watch, logs)
    models = {name: training.model.prepare() for name, training in trained.items()}
    with progress.bar("flying", as_json) as watch:
        flights = fly_all(seed, models, watch)
    mean, spread = shared.over_seeds(judge(flights), partial(fly_and_judge, models), seed, seeds, as_json)
    tables = report.tables(mean, spread, seeds, trained)
    report.write_csv(folder / "tables.csv", mean, spread)
    report.write_markdown(folder / "tables.md", tables, seeds)
    draw = None
    if figures:
        from swingd.studies.slts.figures import draw as draw_all

        draw = partial(draw_all, flights, folder, file_format)

    shared.tell(folder, draw, as_object(mean, spread, seeds, trained), tables, as_json)
