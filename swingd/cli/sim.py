"""``swingd sim``."""

import asyncio
import json
from pathlib import Path
from typing import Annotated

import typer

from swingd.cli import options, process

EXAMPLES = """\b
Examples:
  swingd sim -c configs/demo.yaml
  swingd sim --set 'simulation.wind_ned_mps=[4, 0, 0]' --set simulation.gust_std_mps=1 --truth truth.csv
  swingd sim --ground-station udpout://127.0.0.1:14550
  swingd sim --mavlink udpout://127.0.0.1:14550 --speed 3
"""


def sim(
    config: options.Config = None,
    overrides: options.Overrides = None,
    mavlink: Annotated[
        str | None, typer.Option("--mavlink", metavar="URL", help="Where to talk to instead of simulation.mavlink.")
    ] = None,
    ground_station: Annotated[
        str | None, typer.Option("--ground-station", metavar="URL", help="A second link; both hear each other.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="FILE", help="Write the truth at 125 Hz as CSV.")
    ] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", metavar="X", help="Simulated over real time instead of simulation.speed.")
    ] = None,
    duration_s: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=0.0, help="Stop after this simulated time; default: never."),
    ] = None,
) -> None:
    """Run a simulated PX4 with a slung load on its MAVLink link, for swingd or any other MAVLink tool."""
    from swingd.config.loader import load_parameters

    settings = list(overrides or ())
    if mavlink is not None:
        settings.append(f"simulation.mavlink={json.dumps(mavlink)}")
    if speed is not None:
        settings.append(f"simulation.speed={speed!r}")
    if ground_station is not None:
        settings.append(f"simulation.ground_station={json.dumps(ground_station)}")
    parameters = load_parameters(config, settings)
    process.check_output(truth, "--truth", (config,))
    process.announce_compilation()
    process.end_on_signals()
    from swingd.sim.outlets import Outside
    from swingd.sim.run import run_simulation

    simulation = parameters.simulation
    typer.echo(
        f"simulated PX4 on {simulation.mavlink}, local port {simulation.mavlink_bind_port}, "
        f"{simulation.speed:g} times real time; Ctrl-C stops",
        err=True,
    )
    with asyncio.Runner(loop_factory=process.event_loop_factory()) as runner:
        try:
            runner.run(run_simulation(parameters, outside=Outside(truth_file=truth), duration_s=duration_s))
        except KeyboardInterrupt:
            typer.echo("stopped", err=True)
