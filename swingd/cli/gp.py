"""``swingd gp``: the Gaussian process of the GP-EKF."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swingd.cli import options, process
from swingd.model.errors import ConfigurationError

if TYPE_CHECKING:
    from swingd.identify.gp_training import Training

EXAMPLES = """\b
Examples:
  swingd gp log flight1.swingd --truth truth1.csv -o flight1.csv
  swingd gp train flight1.csv flight2.csv -c configs/iris.yaml -o model.json --picture model.png
"""
TRAIN_EXAMPLES = """\b
Examples:
  swingd gp log flight1.swingd --truth truth1.csv -o flight1.csv
  swingd gp train flight1.csv flight2.csv -c configs/iris.yaml -o model.json --picture model.png
  swingd gp train *.csv --set vehicle.mass_kg=1.52 --set payload.mass_kg=0.5 --set cable.length_m=1.6 -o model.json
  swingd gp train *.csv -c configs/iris.yaml -o model.json --json | jq .rmse_after
"""

LOG_EXAMPLES = """\b
Examples:
  swingd gp log flight1.swingd --truth truth1.csv -o flight1.csv
  swingd gp log flight1.tlog -c configs/iris.yaml --truth truth1.csv.gz -o flight1.csv --json
"""

gp = typer.Typer(no_args_is_help=True)


@gp.callback(epilog=EXAMPLES)
def _gp() -> None:
    """Train what the GP-EKF knows of the cable beyond the rigid pendulum."""


@gp.command("log", epilog=LOG_EXAMPLES)
def log_(
    flight: Annotated[
        Path, typer.Argument(metavar="LOG", help="A recording, .tlog, .ulg or CSV, as swingd replay takes.")
    ],
    truth: Annotated[
        Path, typer.Option("--truth", metavar="FILE", help="Where vehicle and load were (CSV, also .gz; docs/gp.md).")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="LOG.csv", help="What swingd gp train takes.")],
    config: options.Config = None,
    overrides: options.Overrides = None,
    as_json: options.Json = False,
) -> None:
    """Join a flight with what watched the load from outside, for swingd gp train.

    The flight is replayed: the force in the log is what the filter is told in flight. Without a configuration a
    recording's own parameters hold.
    """
    process.check_output(output, "--output", (flight, truth, config))
    process.announce_compilation()
    from swingd.cli.progress import bar
    from swingd.config.loader import parameters_from_json
    from swingd.identify.watched_flight import read_watched, swing_rows
    from swingd.replay import replay

    parameters = options.given(config, overrides)
    watched = read_watched(truth)
    with bar(f"replaying {flight.name}", quiet=as_json) as advance:
        run = replay(flight, parameters, parameters_from_json, advance)
    rows = swing_rows(watched, run.reports, run.attitudes, run.parameters.vehicle.hook_frd_m)
    try:
        rows.write(output)
    except OSError as error:
        raise ConfigurationError(f"--output: {output} cannot be written: {error.strerror}") from error
    count, from_s, to_s = len(rows.t_s), float(rows.t_s[0]), float(rows.t_s[-1])
    if as_json:
        typer.echo(json.dumps({"log": str(output), "rows": count, "from_s": from_s, "to_s": to_s}))
    else:
        typer.echo(f"{count} rows from {from_s:.2f} to {to_s:.2f} s of the autopilot's clock: {output}")


@gp.command(epilog=TRAIN_EXAMPLES)
def train(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="CSV files with the load's measured position (docs/gp.md).")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="MODEL.json", help="The model.")],
    config: options.Config = None,
    overrides: options.Overrides = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="PICTURE.png", help="Draw what was learned.")
    ] = None,
    samples: Annotated[int, typer.Option(min=4, max=256, help="How many samples the model keeps.")] = 48,
    with_velocity: Annotated[
        bool, typer.Option("--with-velocity", help="Let the model know the load's velocity, which its drag follows.")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Learn the error of the cable's acceleration from flights with a load that was watched from outside.

    Vehicle, load and cable of the configuration are those whose equation is corrected. The last quarter of every
    stretch is held out and tells what the model is worth.
    """
    for path, option in ((output, "--output"), (picture, "--picture")):
        process.check_output(path, option, (*logs, config))
    process.announce_compilation("gaussian_process", "the filter")
    from swingd.cli.progress import bar
    from swingd.config.loader import load_parameters
    from swingd.estimation.acceleration_model import TrainedFor
    from swingd.identify import swing_log
    from swingd.identify.gp_training import train as train_model

    parameters = load_parameters(config, overrides or ())
    trained_for = TrainedFor(
        parameters.vehicle.mass_kg,
        parameters.payload.mass_kg,
        parameters.cable.length_m,
    )
    segments = [segment for log in logs for segment in swing_log.read(log)]
    with bar("training", quiet=as_json) as watch:
        training = train_model(segments, trained_for, samples, with_velocity, watch)
    output.write_text(training.model.to_json(), encoding="utf-8")
    if picture is not None:
        from swingd.identify.gp_picture import draw

        draw(training, ", ".join(log.name for log in logs[:4]) + (" ..." if len(logs) > 4 else ""), picture)
    if as_json:
        typer.echo(json.dumps(_as_object(output, training), allow_nan=False))
        return
    score = training.score
    typer.echo(f"trained on {len(training.trained.z)} samples, {len(training.held_out.z)} held out")
    typer.echo(f"RMSE of the acceleration   {score.rmse_before:.4g} -> {score.rmse_after:.4g} m/s^2")
    typer.echo(f"log likelihood per sample  {score.log_likelihood_before:.3g} -> {score.log_likelihood_after:.3g}")
    typer.echo(f"of it on the load            {100.0 * training.model.load_share:.0f} %")
    if score.log_likelihood_after <= score.log_likelihood_before:
        typer.echo("the model tells no more than none: do not use it")
    typer.echo(f"model: {output}")


def _as_object(output: Path, training: "Training") -> dict[str, object]:
    score, model = training.score, training.model
    return {
        "model": str(output),
        "trained_on": len(training.trained.z),
        "held_out": len(training.held_out.z),
        "kept": len(model.features),
        "rmse_before": score.rmse_before,
        "rmse_after": score.rmse_after,
        "log_likelihood_before": score.log_likelihood_before,
        "log_likelihood_after": score.log_likelihood_after,
        "length_scales": model.scales.tolist(),
        "signal_std": model.signal_std.tolist(),
        "load_share": model.load_share,
        "noise_std": training.noise_std.tolist(),
    }
