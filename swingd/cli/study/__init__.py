"""``swingd study``: each study is a file beside this one and a line below."""

import typer

from swingd.cli.study import cooperative, drones2023

EXAMPLES = """\b
Examples:
  swingd study drones2023
  swingd study cooperative
"""

study = typer.Typer(no_args_is_help=True)


@study.callback(epilog=EXAMPLES)
def _study() -> None:
    """Recompute the cases of a paper: tables beside the printed ones, figures."""


study.command(epilog=drones2023.EXAMPLES)(drones2023.drones2023)
study.command(epilog=cooperative.EXAMPLES)(cooperative.cooperative)
