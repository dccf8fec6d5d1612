"""``swingd run``."""

import asyncio
import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from swingd.cli import options

EXAMPLES = """\b
Examples:
  swingd run -c configs/x500.yaml
  swingd run -c configs/x500.yaml --autopilot serial:///dev/ttyAMA0:921600
  swingd run -c configs/x500.yaml --set mode=hold --record flight.swingd
"""


def run(
    config: options.Config = None,
    overrides: options.Overrides = None,
    autopilot: Annotated[
        str | None, typer.Option("--autopilot", metavar="URL", help="Link to the autopilot instead of link.autopilot.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE", help="Write every input event; swingd replay runs it.")
    ] = None,
    summary_file: Annotated[
        Path | None, typer.Option("--summary", metavar="FILE", help="Write the run's figures as JSON at the end.")
    ] = None,
) -> None:
    """Run the daemon until SIGINT or SIGTERM: estimate the swing, publish it and, in mode hold, damp it."""
    from swingd.config.loader import load_parameters
    from swingd.service.logs import configure_logs

    settings = list(overrides or ())
    if autopilot is not None:
        settings.append(f"link.autopilot={json.dumps(autopilot)}")
    parameters = load_parameters(config, settings)
    options.check_output(record, "--record", (config,), keep=True)
    options.check_output(summary_file, "--summary", (config,))
    options.announce_compilation()
    configure_logs(under_journald="JOURNAL_STREAM" in os.environ)
    from swingd.service.daemon import Daemon

    async def serve() -> None:
        summary = await Daemon(parameters, record).run()
        if summary_file is not None:
            summary_file.write_text(json.dumps(asdict(summary)) + "\n", encoding="utf-8")

    with asyncio.Runner(loop_factory=options.event_loop_factory()) as runner:
        runner.run(serve())
