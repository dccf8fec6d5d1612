"""``swingd study``: each study is a file beside this one and a line below."""

import typer

from swingd.cli.study import cooperative, drones2023, icinco2016, slts

EXAMPLES = """\b
Examples:
  swingd study drones2023
  swingd study icinco2016
  swingd study slts
  swingd study cooperative
"""

study = typer.Typer(no_args_is_help=True)


@study.callback(epilog=EXAMPLES)
def _study() -> None:
    """Recompute the cases of a paper: tables beside the printed ones, figures."""


study.command(epilog=drones2023.EXAMPLES)(drones2023.drones2023)
study.command(epilog=icinco2016.EXAMPLES)(icinco2016.icinco2016)
study.command(epilog=slts.EXAMPLES)(slts.slts)
study.command(epilog=cooperative.EXAMPLES)(cooperative.cooperative)
