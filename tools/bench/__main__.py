"""Speed of the parts and of the whole, each as a ratio to a peer of the same run: figures that mean something anywhere.

Every case is timed in alternation with its peer and the best of the rounds counts. ``--json`` prints one object. The
daemon's forwarding is held against mavlink-router where ``mavlink-routerd`` is on the path or named by
``$MAVLINK_ROUTERD``, else against a plain UDP relay.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

import swingd

from .flight import bench_engine, bench_frame, bench_lockstep, bench_replay, fly
from .forwarding import bench_forwarding, bench_start, plan
from .parts import bench_codec, bench_filter
from .study import bench_study


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every case and print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--quick", action="store_true", help="shorter runs, rougher figures")
    options = parser.parse_args(arguments)
    quick: bool = options.quick
    count = 500 if quick else 4000
    results = [bench_codec(count), bench_filter(count)]
    flight = fly(6.0 if quick else 30.0)
    results += [*bench_engine(flight), bench_lockstep(flight), *bench_frame(flight)]
    with tempfile.TemporaryDirectory() as folder:
        results.append(bench_replay(flight, Path(folder)))
    results += bench_study(10.0 if quick else 40.0)
    results.append(bench_start())
    hover = plan(flight.received, *((0.5, 1.0, 0.5) if quick else (1.0, 4.0, 2.0)))
    results += bench_forwarding(hover, *(((0, 1), 1) if quick else ((0, 1, 4), 3)))
    if options.json:
        print(json.dumps({"swingd": swingd.__version__, "results": [asdict(result) for result in results]}))
        return 0
    table = Table("part", "here", "peer of the same run", "there", "times better")
    for result in results:
        table.add_row(
            result.name,
            f"{result.value:.3g} {result.unit}",
            result.peer,
            f"{result.peer_value:.3g} {result.unit}",
            f"{result.ratio:.2f}",
        )
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
