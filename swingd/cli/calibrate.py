"""``swingd calibrate``."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swingd.cli import options, process

if TYPE_CHECKING:
    from swingd.identify.thrust_curve import ThrustCurve
    from swingd.model.parameters import Parameters

EXAMPLES = """\b
Examples:
  swingd calibrate thrust stand.csv --rotors 4 -o curve.png
  swingd calibrate thrust hover.tlog -c configs/x500.yaml
  swingd calibrate thrust stand.csv --json | jq .quadratic_n
"""

calibrate = typer.Typer(no_args_is_help=True)


@calibrate.callback(epilog=EXAMPLES)
def _calibrate() -> None:
    """Fit what the configuration must know of a vehicle's parts."""


@calibrate.command(epilog=EXAMPLES)
def thrust(
    source: Annotated[
        Path,
        typer.Argument(metavar="CSV|LOG", help="A stand's CSV (throttle 0..1, thrust_n, voltage_v), or a hover's log."),
    ],
    config: options.Config = None,
    overrides: options.Overrides = None,
    rotors: Annotated[
        int, typer.Option(min=1, max=64, help="Rotors of the vehicle, where the stand measured one of them.")
    ] = 1,
    nominal_v: Annotated[
        float | None,
        typer.Option(
            "--nominal-voltage",
            metavar="V",
            min=1.0,
            max=1000.0,
            help="V0 of the curve; by default the stand's median.",
        ),
    ] = None,
    without_load: Annotated[bool, typer.Option("--without-load", help="The log's flight carried no load.")] = False,
    picture: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="PICTURE.png", help="Draw measured against fitted.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Fit the thrust curve (V / V0)^n (a x^2 + b x + c), and print the YAML lines to paste.

    A stand tells a, b, c and, at different voltages, n. Hover at falling voltage tells n and the scale of the
    configured curve; its shape stays.
    """
    from swingd.config.loader import load_parameters
    from swingd.identify.thrust_curve import fit_stand, is_stand_csv, read_stand
    from swingd.model.parameters import Parameters

    process.check_output(picture, "--output", (source, config))
    parameters = load_parameters(config, overrides or ()) if config is not None or overrides else Parameters()
    if is_stand_csv(source):
        curve = fit_stand(read_stand(source), parameters.thrust, rotors, nominal_v)
    else:
        curve = _from_hover(source, parameters if config is not None or overrides else None, without_load, as_json)
    if picture is not None:
        from swingd.identify.thrust_picture import draw

        draw(curve, source.name, picture)
    if as_json:
        typer.echo(json.dumps(_as_json(source, curve), allow_nan=False))
        return
    error = _errors_percent(curve)
    kind = "quiet seconds of hover" if curve.from_hover else "points"
    typer.echo(f"{curve.throttle.size} {kind}, {curve.rms_n:.3g} N RMS left")
    if "compensated" in error:
        typer.echo(
            f"largest error of the thrust: {error['compensated']:.1f} % with the voltage, "
            f"{error['uncompensated']:.1f} % without"
        )
    typer.echo(f"\nto paste:\n\n{curve.yaml()}")


def _from_hover(source: Path, parameters: "Parameters | None", without_load: bool, quiet: bool) -> "ThrustCurve":
    from swingd.cli.progress import bar
    from swingd.config.loader import parameters_from_json
    from swingd.identify.thrust_curve import fit_hover, hover_rows
    from swingd.model.errors import LogFormatError
    from swingd.replay import replay

    process.announce_compilation()
    with bar(f"replaying {source.name}", quiet=quiet) as advance:
        run = replay(source, parameters, parameters_from_json, advance)
    used = run.parameters
    stretches = run.hanging
    if without_load:
        stretches = [(run.imu[0].t_boot_s, run.imu[-1].t_boot_s)] if run.imu else []
    rows = hover_rows(
        run.imu,
        run.attitudes,
        run.motors or run.throttles,
        run.batteries,
        stretches,
        used.vehicle.mass_kg,
        0.0 if without_load else used.payload.mass_kg,
    )
    try:
        return fit_hover(rows, used.thrust)
    except LogFormatError as error:
        raise LogFormatError(f"{source}: {error}") from None


def _errors_percent(curve: "ThrustCurve") -> dict[str, float]:
    """Largest error of the thrust with and without the voltage, where it was measured."""
    import numpy as np

    if not np.isfinite(curve.voltage_v).all():
        return {}
    # Near no thrust at all a share says nothing.
    counted = curve.thrust_n > 0.2 * curve.thrust_n.max()
    return {
        name: float(
            np.abs(
                curve.thrust_at(curve.throttle, curve.voltage_v, compensated) / np.maximum(curve.thrust_n, 1e-9) - 1.0
            )[counted].max()
            * 100.0
        )
        for name, compensated in (("compensated", True), ("uncompensated", False))
    }


def _as_json(source: Path, curve: "ThrustCurve") -> dict[str, object]:
    return {
        "source": str(source),
        "from_hover": curve.from_hover,
        "samples": int(curve.throttle.size),
        "quadratic_n": asdict(curve.quadratic_n),
        "linear_n": asdict(curve.linear_n),
        "offset_n": asdict(curve.offset_n),
        "voltage_nominal_v": curve.voltage_nominal_v,
        "voltage_exponent": None if curve.exponent is None else asdict(curve.exponent),
        "voltage_exponent_used": curve.exponent_used,
        "note": curve.exponent_note or None,
        "rms_n": curve.rms_n,
        "largest_error_percent": {k: v for k, v in _errors_percent(curve).items() if math.isfinite(v)},
        "yaml": curve.yaml(),
    }
