"""``swingd demo``."""

import asyncio
import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swingd.cli import options, process

if TYPE_CHECKING:
    from swingd.demo.figures import Figures
    from swingd.demo.flight import Moment
    from swingd.model.parameters import Parameters

EXAMPLES = """\b
Examples:
  swingd demo
  swingd demo -c configs/demo.yaml --set payload.mass_kg=0.5 --set cable.length_m=3
  swingd demo --json | tail -n 1
"""


def demo(
    config: options.Config = None,
    overrides: options.Overrides = None,
    speed_mps: Annotated[
        float, typer.Option("--step", metavar="M/S", min=0.5, max=10.0, help="Velocity of the step to the north.")
    ] = 3.0,
    picture: Annotated[Path, typer.Option("-o", "--picture", metavar="FILE.png", help="Where to draw the flights.")] = (
        Path("swingd-demo.png")
    ),
    as_json: options.Json = False,
) -> None:
    """Fly a simulated PX4 with a slung load through a velocity step and a stop: correction off, then on.

    The simulated autopilot and the daemon run in processes of their own and talk MAVLink over loopback UDP in real
    time; two flights of about 75 s.
    """
    from swingd.config.loader import load_parameters

    parameters = load_parameters(config, overrides or ())
    process.check_output(picture, "--picture", (config,))
    process.announce_compilation()
    process.end_on_signals()
    with asyncio.Runner(loop_factory=process.event_loop_factory()) as runner:
        figures = runner.run(_fly_both(parameters, speed_mps, picture, as_json))
    if as_json:
        typer.echo(json.dumps(asdict(figures), allow_nan=False))
    else:
        _print_table(figures)
        typer.echo(f"picture: {picture}")


async def _fly_both(parameters: "Parameters", speed_mps: float, picture: Path, quiet: bool) -> "Figures":
    from swingd.demo.figures import figures
    from swingd.demo.flight import fly
    from swingd.demo.picture import draw

    steps = ((speed_mps, 0.0, 0.0), (0.0, 0.0, 0.0))
    with _watching(quiet) as watch:
        off = await fly(parameters, False, steps, watch("correction off"))
        on = await fly(parameters, True, steps, watch("correction on"))
    result = figures(parameters, off, on)
    draw(off, on, result, picture)
    return result


@contextmanager
def _watching(quiet: bool) -> Iterator[Callable[[str], Callable[["Moment"], None]]]:
    """Show both flights' progress on standard error; lines where nobody watches a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, quiet=quiet)
    if not console.is_terminal:
        yield lambda name: _Lines(console, name)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[phase]}"),
        TextColumn("{task.fields[swing]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:

        def watch(name: str) -> Callable[["Moment"], None]:
            task = progress.add_task(f"{name:15}", total=1.0, phase="", swing="")

            def show(moment: "Moment") -> None:
                progress.update(
                    task,
                    completed=moment.share,
                    phase=f"{moment.phase.value:20}",
                    swing=f"swing {math.degrees(moment.chi_rad):4.1f} deg",
                )

            return show

        yield watch


class _Lines:
    """One line for each phase of a flight."""

    def __init__(self, console: object, name: str) -> None:
        self._print = getattr(console, "print")  # noqa: B009  (rich is imported where it is used)
        self._name = name
        self._phase: object = None

    def __call__(self, moment: "Moment") -> None:
        if moment.phase is not self._phase:
            self._phase = moment.phase
            self._print(f"{self._name}: {moment.phase.value}")


def _print_table(figures: "Figures") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="velocity step and stop", title_justify="left")
    for name in ("", "correction off", "correction on", "on / off"):
        table.add_column(name, justify="left" if not name else "right", no_wrap=True)
    f = figures
    table.add_row(
        "swing, peak [deg]", f"{f.peak_deg_off:.1f}", f"{f.peak_deg_on:.1f}", _ratio(f.peak_deg_on, f.peak_deg_off)
    )
    table.add_row("swing, RMS over 12 s [deg]", f"{f.rms_deg_off:.2f}", f"{f.rms_deg_on:.2f}", f"{f.rms_ratio:.2f}")
    table.add_row(
        "under 2 deg after [s]",
        f"{'' if f.settled_off else '> '}{f.settle_2deg_s_off:.1f}",
        f"{'' if f.settled_on else '> '}{f.settle_2deg_s_on:.1f}",
        _ratio(f.settle_2deg_s_on, f.settle_2deg_s_off),
    )
    table.add_row("  in pendulum periods", f"{f.settle_periods_off:.1f}", f"{f.settle_periods_on:.2f}", "")
    table.add_row(
        "velocity error, RMS [m/s]",
        f"{f.velocity_rmse_mps_off:.2f}",
        f"{f.velocity_rmse_mps_on:.2f}",
        f"{f.velocity_ratio:.2f}",
    )
    console = Console(markup=False)
    console.print(table)
    console.print(f"estimate against truth: {f.angle_rmse_deg:.2f} deg, {f.rate_rmse_deg_s:.1f} deg/s RMS")
    latency = "no setpoints" if f.latency_ms_p50 is None else f"{f.latency_ms_p50:.2f} / {f.latency_ms_p99:.2f} ms"
    console.print(f"filter {f.filter_hz:.1f} Hz, {f.cpu_percent:.1f} % of a core")
    console.print(f"IMU received to setpoint sent: {latency} (p50 / p99)")
    console.print(f"longest wait of the autopilot for a setpoint: {f.setpoint_gap_ms:.0f} ms")
    if f.stalled:
        console.print("This machine stood still during a flight, which the figures show: fly again when it is idle.")


def _ratio(on: float, off: float) -> str:
    return f"{on / off:.2f}" if off > 0.0 else ""
