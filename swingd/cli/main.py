"""The ``swingd`` command; each subcommand is a file beside this one and a line below."""

import os
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import swingd
from swingd.cli import check, demo, replay, run, schema, sim
from swingd.model.errors import ConfigurationError, LinkUrlError, SwingdError

EXIT_CONFIG = os.EX_CONFIG
"""What cannot heal by starting again; a supervisor should not try."""
EXIT_FAILURE = 1


class _Commands(TyperGroup):
    """Subcommands whose expected errors end in one message and an exit code; any other exception is a bug."""

    def invoke(self, ctx: Any) -> Any:  # typer's Context is click's in some releases, its own in others
        try:
            return super().invoke(ctx)
        except SwingdError as error:
            typer.echo(f"swingd: {error}", err=True)
            code = EXIT_CONFIG if isinstance(error, ConfigurationError | LinkUrlError) else EXIT_FAILURE
            raise typer.Exit(code) from None


app = typer.Typer(
    cls=_Commands,
    name="swingd",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 done, 2 wrong usage, 78 wrong configuration, 1 any other failure.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"swingd {swingd.__version__}")
        raise typer.Exit


@app.callback()
def _swingd(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Estimate and damp the swing of a load slung under a multirotor, beside PX4 and ArduPilot."""


app.command(epilog=demo.EXAMPLES)(demo.demo)
app.command(epilog=run.EXAMPLES)(run.run)
app.command(epilog=sim.EXAMPLES)(sim.sim)
app.command(epilog=replay.EXAMPLES)(replay.replay)
app.command(epilog=check.EXAMPLES)(check.check)
app.command(epilog=schema.EXAMPLES)(schema.schema)


def main() -> None:
    """Run the command line and exit."""
    app(prog_name="swingd")
