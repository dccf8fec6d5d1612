"""``swingd run``: parsed by the standard library, because the first forwarded frame waits for whatever is loaded."""

import argparse
import asyncio
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from swingd.cli.process import EXIT_CODES, check_output, event_loop_factory, exit_code, report
from swingd.model.errors import SwingdError
from swingd.model.parameters import Parameters

SUMMARY = "Run the daemon until SIGINT or SIGTERM: forward, estimate the swing, publish it and, by its mode, damp it."
EXAMPLES = """\
Examples:
  swingd run -c configs/x500.yaml
  swingd run -c configs/x500.yaml --autopilot serial:///dev/ttyAMA0:921600
  swingd run -c configs/x500.yaml --set mode=inline --endpoint udpin://:14541 --endpoint udpout://192.168.1.5:14550
  swingd run -c configs/x500.yaml --set mode=hold --record flight.swingd
"""


def main(arguments: Sequence[str]) -> int:
    """Run the command with its arguments; return the exit code."""
    given = _parser().parse_args(arguments)
    try:
        return _run(given)
    except SwingdError as error:
        return _report(error)


def _report(error: SwingdError) -> int:
    """Write an expected error as the log is written; return the exit code."""
    from swingd.service.logs import journald_reads, with_priority

    if journald_reads(os.environ):
        print(with_priority("error", f"swingd: {error}"), file=sys.stderr)
        return exit_code(error)
    return report(error)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="swingd run",
        description=SUMMARY,
        epilog=f"{EXAMPLES}\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add(
        *("-c", "--config"),
        metavar="FILE",
        type=Path,
        help="configuration in YAML; without it every key has its default",
    )
    add(
        "--set",
        metavar="KEY=VALUE",
        dest="overrides",
        action="append",
        default=[],
        help="set one key, for example payload.mass_kg=0.4; repeatable",
    )
    add("--autopilot", metavar="URL", help="link to the autopilot instead of link.autopilot")
    add(
        "--endpoint",
        metavar="URL",
        dest="endpoints",
        action="append",
        default=[],
        help="link for an application or a ground station, instead of all endpoints of the file; repeatable",
    )
    add("--record", metavar="FILE", type=Path, help="write every input event; swingd replay runs it")
    add("--summary", metavar="FILE", type=Path, help="write the run's figures as JSON at the end")
    return parser


def _run(given: argparse.Namespace) -> int:
    from swingd.config.cache import load_cached
    from swingd.service.daemon import Daemon
    from swingd.service.logs import Log, journald_reads, level_of
    from swingd.service.state import StateFile
    from swingd.service.status import StatusServer

    overrides = list(given.overrides)
    if given.autopilot is not None:
        overrides.append(f"link.autopilot={json.dumps(given.autopilot)}")
    if given.endpoints:
        overrides.append(f"endpoints={json.dumps([{'url': url} for url in given.endpoints])}")
    parameters = load_cached(given.config, overrides)
    check_output(given.record, "--record", (given.config,), keep=True)
    check_output(given.summary, "--summary", (given.config,))
    log = Log(under_journald=journald_reads(os.environ))
    state = StateFile(given.config, lambda note: log.write(level_of(note.severity), note.text))

    supervisor = None
    if "NOTIFY_SOCKET" in os.environ:
        from swingd.service.notify import Supervisor

        supervisor = Supervisor.from_environment(os.environ)

    def reread() -> Parameters:
        from swingd.service.reload import read_configuration

        return read_configuration(given.config, overrides)

    async def serve() -> None:
        # Whoever closes the terminal of a process ends it by SIGHUP; one without a terminal is asked to read again.
        daemon = Daemon(
            parameters,
            given.record,
            state,
            log,
            supervisor,
            StatusServer(given.config),
            None if _has_terminal() else reread,
        )
        summary = await daemon.run()
        if given.summary is not None:
            given.summary.write_text(json.dumps(asdict(summary)) + "\n", encoding="utf-8")

    with asyncio.Runner(loop_factory=event_loop_factory()) as runner:
        runner.run(serve())
    return 0


def _has_terminal() -> bool:
    """Whether the process has a controlling terminal, wherever its output goes."""
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY))
    except OSError:
        return False
    return True
