"""``swingd cooperate``."""

from pathlib import Path
from typing import Annotated

import typer

EXAMPLES = """\b
Examples:
  swingd cooperate -c configs/cooperate/two.yaml
  swingd cooperate -c two.yaml --output udpout://192.168.1.5:14550 --record flight.tlog
  swingd cooperate -c two.yaml --check          # only say whether the configuration is right

\b
Beside each vehicle:
  swingd run -c my.yaml --autopilot serial:///dev/ttyAMA0:921600 --endpoint udpout://192.168.1.10:14601
"""


def cooperate(
    config: Annotated[
        Path,
        typer.Option("-c", "--config", metavar="FILE", help="Vehicles, tethers and load in YAML; a file of its own."),
    ],
    outputs: Annotated[
        list[str] | None,
        typer.Option(
            "--output", metavar="URL", help="Where the pose is sent, instead of the file's outputs; repeatable."
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", metavar="FILE", help="Write everything heard and said as .tlog; a new file."),
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Validate the configuration and end.")] = False,
) -> None:
    """Publish the pose of a load that several vehicles carry: ODOMETRY and DEBUG_FLOAT_ARRAY "LOADPOSE"."""
    import asyncio
    import os
    from dataclasses import replace

    from swingd.cli.process import announce_compilation, check_output, event_loop_factory

    announce_compilation("load_pose")
    from swingd.config.formation import load_formation
    from swingd.link.url import LOOPBACK, parse_url

    parameters = load_formation(config)
    if outputs:
        for url in outputs:
            parse_url(url, LOOPBACK)
        parameters = replace(parameters, outputs=tuple(outputs))
    if record is None and parameters.record:
        record = Path(parameters.record)
    check_output(record, "--record", (config,), keep=True)
    if check:
        tethers = sum(len(vehicle.tethers) for vehicle in parameters.vehicles)
        typer.echo(f"{config}: valid; {len(parameters.vehicles)} vehicles, {tethers} tethers")
        return

    from swingd.service.cooperate import Cooperation
    from swingd.service.logs import Log, journald_reads
    from swingd.service.notify import Supervisor

    log = Log(under_journald=journald_reads(os.environ))

    async def serve() -> None:
        await Cooperation(parameters, record, log, Supervisor.from_environment(os.environ)).run()

    with asyncio.Runner(loop_factory=event_loop_factory()) as runner:
        runner.run(serve())
