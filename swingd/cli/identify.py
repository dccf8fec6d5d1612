"""``swingd identify``."""

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swingd.cli import options, process

if TYPE_CHECKING:
    from swingd.identify import Identification, Quantity

EXAMPLES = """\b
Examples:
  swingd identify flight.tlog -c configs/iris.yaml
  swingd identify flight.swingd -o fit.png
  swingd identify flight.ulg -c configs/x500.yaml --set vehicle.mass_kg=2.1 --json | jq .length
"""

WIDTH = 140
"""Of the table where nobody watches a terminal."""


def identify(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="A .tlog, .ulg or CSV file, or a recording of swingd run --record.")
    ],
    config: options.Config = None,
    overrides: options.Overrides = None,
    picture: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="PICTURE.png", help="Draw measured against fitted.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Fit load mass, cable length and damping to a flight, with 95 % confidence intervals.

    The load's pull is what the accelerometer feels across the thrust: no thrust curve is needed, but the vehicle's
    mass must be right. A velocity step or two in each direction are enough; what a flight cannot tell is said.
    """
    from swingd.cli.progress import bar
    from swingd.config.loader import parameters_from_json
    from swingd.identify import FlightRecord
    from swingd.identify import identify as identify_flight
    from swingd.replay import replay

    process.check_output(picture, "--output", (log, config))
    process.announce_compilation()
    parameters = options.given(config, overrides)
    with bar(f"replaying {log.name}", quiet=as_json) as advance:
        run = replay(log, parameters, parameters_from_json, advance)
    record = FlightRecord(run.imu, run.attitudes, run.positions, run.parameters.vehicle)
    with bar("fitting", quiet=as_json) as advance:
        found = identify_flight(record, run.hanging, run.parameters, run.weighing, advance)
    if picture is not None:
        from swingd.identify.picture import draw

        draw(found, log.name, picture)
    if as_json:
        typer.echo(json.dumps(_as_json(log, found), allow_nan=False))
    else:
        _print(found)


def _as_json(log: Path, found: "Identification") -> dict[str, Any]:
    def plain(quantity: "Quantity") -> dict[str, Any]:
        return {**asdict(quantity), "agrees": quantity.agrees}

    return {
        "log": str(log),
        "hanging_s": found.hanging_s,
        "swing_rms_deg": None if found.fit is None else math.degrees(found.fit.swing_rms_rad),
        "segments": 0 if found.fit is None else len(found.fit.segments),
        "residual_rms_n": None if found.fit is None else found.fit.residual_rms_n,
        "mass": plain(found.mass),
        "weighed_mass": plain(found.weighed_mass),
        "length": plain(found.length),
        "damping": plain(found.damping),
        "contradiction": found.contradiction or None,
        "yaml": found.yaml(),
    }


def _print(found: "Identification") -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False, width=None if sys.stdout.isatty() else WIDTH)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for heading, justify in (("", "left"), ("value", "right"), ("95 % interval", "right"), ("configured", "right")):
        table.add_column(heading, justify=justify, no_wrap=True)  # type: ignore[arg-type]
    table.add_column("")
    for quantity in found.quantities:
        known = quantity.known
        unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
        table.add_row(
            quantity.name + unit,
            "unknown" if known is None else f"{known.value:.4g}",
            "" if known is None else f"{known.low:.4g} .. {known.high:.4g}",
            f"{quantity.configured:.4g}",
            quantity.note + ("; the configured value is outside" if quantity.agrees is False else ""),
        )
    console.print(table)
    swing = "" if found.fit is None else f", swing {math.degrees(found.fit.swing_rms_rad):.1f} deg RMS"
    typer.echo(f"{found.hanging_s:.0f} s with a load{swing}")
    if found.contradiction:
        typer.echo(found.contradiction)
    if found.yaml():
        typer.echo(f"\nto paste:\n\n{found.yaml()}")
