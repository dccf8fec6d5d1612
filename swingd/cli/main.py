"""The ``swingd`` command; each subcommand is a file beside this one and a line below."""

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import swingd
from swingd.cli import calibrate, check, cooperate, demo, doctor, gp, identify, replay, run, schema, sim, status, study
from swingd.cli.process import EXIT_CODES, report
from swingd.model.errors import SwingdError


class _Commands(TyperGroup):
    """Subcommands whose expected errors end in one message and an exit code; any other exception is a bug."""

    def invoke(self, ctx: Any) -> Any:  # typer's Context is click's in some releases, its own in others
        try:
            return super().invoke(ctx)
        except SwingdError as error:
            raise typer.Exit(report(error)) from None


app = typer.Typer(
    cls=_Commands,
    name="swingd",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=EXIT_CODES,
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


@app.command(
    name="run",
    help=run.SUMMARY,
    add_help_option=False,
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True},
)
def _run(ctx: typer.Context) -> None:
    sys.exit(run.main(ctx.args))


app.command(epilog=cooperate.EXAMPLES)(cooperate.cooperate)
app.command(epilog=status.EXAMPLES)(status.status)
app.command(epilog=sim.EXAMPLES)(sim.sim)
app.command(epilog=replay.EXAMPLES)(replay.replay)
app.command(epilog=identify.EXAMPLES)(identify.identify)
app.add_typer(calibrate.calibrate, name="calibrate")
app.command(epilog=check.EXAMPLES)(check.check)
app.command(epilog=doctor.EXAMPLES)(doctor.doctor)
app.command(epilog=schema.EXAMPLES)(schema.schema)
app.add_typer(gp.gp, name="gp")
app.add_typer(study.study, name="study")
