"""``swingd replay``."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swingd.cli import options, process

if TYPE_CHECKING:
    from swingd.replay import Comparison, Replay

EXAMPLES = """\b
Examples:
  swingd replay flight.tlog -c configs/iris.yaml -o estimate.csv
  swingd replay flight.ulg -c configs/x500.yaml --set payload.mass_kg=0.4 -o estimate.csv
  swingd replay flight.tlog -c configs/iris.yaml --truth truth.csv --from 18 --to 104 --plot flight.png
  swingd replay flight.swingd
"""


def replay(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="A .tlog, .ulg or CSV file, or a recording of swingd run --record.")
    ],
    config: options.Config = None,
    overrides: options.Overrides = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="OUT.csv", help="Write the estimate of each filter step.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="FILE", help="True swing (CSV, also .gz): print the errors.")
    ] = None,
    from_s: Annotated[
        float | None, typer.Option("--from", metavar="S", help="Compare from this boot time on [s].")
    ] = None,
    to_s: Annotated[float | None, typer.Option("--to", metavar="S", help="Compare up to this boot time [s].")] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE.png", help="Draw the estimate, with the truth and the baseline."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Run a flight's log through the pipeline that flies; deterministic.

    A recording is checked frame by frame against what swingd sent in flight, unless other parameters are given.
    Published sets that carry the true swing in their CSV are compared with it without --truth.
    """
    from swingd.cli.progress import bar
    from swingd.config.loader import parameters_from_json
    from swingd.model.errors import ConfigurationError
    from swingd.model.parameters import Parameters
    from swingd.record.truth import read_truth, within
    from swingd.replay import compare, write_reports
    from swingd.replay import replay as run_log

    process.check_output(output, "--output", (log, config, truth))
    process.check_output(plot, "--plot", (log, config, truth))
    process.announce_compilation()
    parameters = options.given(config, overrides)
    true = read_truth(truth) if truth is not None else None
    with bar(f"replaying {log.name}", quiet=as_json) as advance:
        run = run_log(log, parameters, parameters_from_json, advance)
    true = true or run.truth
    comparison = None
    if true is not None:
        comparison = compare(run, parameters or Parameters(), within(true, from_s, to_s))
    if output is not None:
        try:
            with output.open("w", encoding="utf-8", newline="\n") as file:
                write_reports(file, run.reports)
        except OSError as error:
            raise ConfigurationError(f"--output: {output} cannot be written: {error.strerror}") from error
    if plot is not None:
        from swingd.replay.picture import draw, draw_estimate

        if comparison is not None:
            draw(comparison, log.name, plot)
        else:
            draw_estimate(run, log.name, plot)
    if as_json:
        typer.echo(json.dumps(_as_json(log, run, comparison), allow_nan=False))
    else:
        typer.echo("\n".join(_lines(run, comparison)))
    if run.frames_differing:
        raise typer.Exit(1)


def _as_json(log: Path, run: "Replay", comparison: "Comparison | None") -> dict[str, Any]:
    result: dict[str, Any] = {
        "log": str(log),
        "steps": len(run.reports),
        "resets": {reason.name.lower(): count for reason, count in run.resets.items()},
        "drops": {drop.value: count for drop, count in run.drops.items()},
        "frames_sent": run.frames_sent,
        "frames_differing": run.frames_differing,
        "unread_bytes": run.unread_bytes,
    }
    if comparison is not None:
        result["rows"] = comparison.rows
        result["xi"] = {**asdict(comparison.xi), "ratio": comparison.xi.ratio}
        result["zeta"] = {**asdict(comparison.zeta), "ratio": comparison.zeta.ratio}
    return result


def _lines(run: "Replay", comparison: "Comparison | None") -> list[str]:
    first, last = run.reports[0].t_boot_s if run.reports else 0.0, run.reports[-1].t_boot_s if run.reports else 0.0
    lines = [f"{len(run.reports)} filter steps from {first:.2f} to {last:.2f} s of the autopilot's clock"]
    lines += [f"filter began anew {count} x: {reason.value}" for reason, count in run.resets.items()]
    lines += [f"not used: {count} x {drop.value}" for drop, count in run.drops.items()]
    if run.unread_bytes:
        lines.append(f"{run.unread_bytes} bytes of the log are damaged or cut off and were not read")
    if run.frames_sent:
        lines.append(f"{run.frames_sent} frames were sent in flight; {run.frames_differing} differ in the replay")
        if run.first_difference is not None:
            lines.append(f"first difference: {run.first_difference}")
    if comparison is None:
        return lines
    lines.append(f"compared with the truth in {comparison.rows} rows:")
    lines.append(f"{'':14}{'lateral xi':>14}{'longitudinal zeta':>20}")
    rows = (
        ("RMSE [deg]", "rmse_deg", ".2f"),
        ("mean [deg]", "mean_error_deg", ".2f"),
        ("correlation", "correlation", ".3f"),
        ("rate [deg/s]", "rate_rmse_deg_s", ".2f"),
        ("true std [deg]", "true_std_deg", ".2f"),
        ("pendulum [deg]", "pendulum_rmse_deg", ".2f"),
        ("ratio", "ratio", ".2f"),
    )
    for label, name, form in rows:
        xi, zeta = getattr(comparison.xi, name), getattr(comparison.zeta, name)
        lines.append(f"{label:14}{xi:>14{form}}{zeta:>20{form}}")
    return lines
