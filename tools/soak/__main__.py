"""Flies simulated hours faster than real time, with random manoeuvres, loads, wind and faults, and shows what becomes
of memory, file handles, latency and health.

    make soak                                     # 24 hours in as many lanes as there are cores
    python -m tools.soak --hours 1 --seed 7 --lanes 1
    python -m tools.soak --hours 1 --estimator gp-ekf   # with a camera that sees the load

The whole engine flies against the simulated autopilot in virtual time; every second lane is an ArduPilot. A lane is
flown again by its seed, printed with whatever it broke. The picture and the figures lie in out/soak, also of what was
flown before an interrupt. Exit code 1: not flown to the end, an exception, a number that is not finite, a setpoint
after the application went silent, a correction that nothing allows, memory or file handles that grow. 2: wrong usage.
"""

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from time import perf_counter

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

import swingd

from .lane import AUTOPILOTS, fly_in_process
from .picture import draw
from .record import Breach, Hour, Lane, Sample
from .verdict import complaints, growth_of
from .watch import Rule

ROOT = Path(__file__).parents[2]


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, show and judge; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="tools.soak", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=_positive, default=24.0, metavar="H", help="simulated, in all; default: 24")
    parser.add_argument("--lanes", type=_count, default=os.cpu_count() or 1, metavar="N", help="default: one per core")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the first lane; default: 1")
    parser.add_argument(
        "--estimator", choices=("swing_ekf", "gp-ekf"), default="swing_ekf", help="default: %(default)s"
    )
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out/soak", metavar="DIR")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object instead of a table")
    given = parser.parse_args(arguments)
    if given.seed < 0:
        parser.error(f"argument --seed: {given.seed} given; expected 0 or more")
    lanes = fly_all(given.seed, given.lanes, 3600.0 * given.hours / given.lanes, given.estimator)
    said = complaints(lanes)
    given.out.mkdir(parents=True, exist_ok=True)
    figures = {"swingd": swingd.__version__, "complaints": said, "lanes": [_figures(lane) for lane in lanes]}
    (given.out / "soak.json").write_text(json.dumps(figures, indent=1) + "\n")
    if any(lane.samples for lane in lanes):
        draw(lanes, given.out / "soak.png")
    if given.json:
        print(json.dumps(figures))
    else:
        _print(lanes, said, given.out)
    return 1 if said else 0


def fly_all(seed: int, count: int, duration_s: float, estimator: str = "swing_ekf") -> list[Lane]:
    """Fly lanes side by side, each in a process of its own, and gather what they tell."""
    context = multiprocessing.get_context("spawn")
    jobs: dict[Connection, tuple[BaseProcess, Lane]] = {}
    for number in range(count):
        here, there = context.Pipe(duplex=False)
        autopilot = AUTOPILOTS[number % len(AUTOPILOTS)]
        process = context.Process(target=fly_in_process, args=(there, seed + number, autopilot, duration_s, estimator))
        process.start()
        there.close()
        jobs[here] = process, Lane(seed + number, autopilot.value, duration_s)
    lanes = [lane for _, lane in jobs.values()]
    try:
        _gather(jobs, count * duration_s)
    except KeyboardInterrupt:
        print("tools.soak: interrupted; what was flown so far:", file=sys.stderr)
    finally:
        for process, _ in jobs.values():
            process.terminate()
    return lanes


def _gather(jobs: dict[Connection, tuple[BaseProcess, Lane]], total_s: float) -> None:
    begin_s = perf_counter()
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task(f"{total_s / 3600.0:.3g} h of flight", total=total_s)
        while jobs:
            for connection in wait(list(jobs)):
                assert isinstance(connection, Connection)
                process, lane = jobs[connection]
                try:
                    _take(lane, connection.recv(), begin_s, lambda flown_s: progress.update(task, advance=flown_s))
                except EOFError:
                    process.join()
                    if process.exitcode:
                        text = f"process ended with exit code {process.exitcode}"
                        lane.breaches.append(Breach(lane.flown_s, Rule.EXCEPTION.value, text))
                        lane.breached[Rule.EXCEPTION.value] = 1
                    del jobs[connection]


def _take(lane: Lane, told: object, begin_s: float, advance: Callable[[float], None]) -> None:
    if isinstance(told, Sample):
        lane.samples.append(told)
    elif isinstance(told, Hour):
        lane.hours.append(told)
    elif isinstance(told, Breach):
        lane.breaches.append(told)
        lane.breached[told.rule] = lane.breached.get(told.rule, 0) + 1
    elif isinstance(told, float):
        advance(told - lane.flown_s)
        lane.flown_s, lane.wall_s = told, perf_counter() - begin_s
    elif isinstance(told, Lane):
        lane.breaches, lane.breached = told.breaches, told.breached
        lane.manoeuvres, lane.faults = told.manoeuvres, told.faults
        lane.flown_s, lane.wall_s = told.flown_s, told.wall_s


def _figures(lane: Lane) -> dict[str, object]:
    growth = growth_of(lane)
    return {**asdict(lane), "growth": None if growth is None else asdict(growth)}


def _print(lanes: list[Lane], said: list[str], out: Path) -> None:
    table = Table("", *(f"seed {lane.seed}, {lane.autopilot}" for lane in lanes))
    for name, figure in _ROWS.items():
        table.add_row(Text(name), *(figure(lane) for lane in lanes))
    console = Console(width=None if sys.stdout.isatty() else 120)
    console.print(table)
    for lane in lanes:
        for breach in lane.breaches:
            console.print(f"seed {lane.seed}, {breach.t_s:.1f} s: {breach.rule}: {breach.text}", markup=False)
    for complaint in said:
        console.print(f"tools.soak: {complaint}", style="bold red", markup=False)
    console.print(f"tools.soak: {'FAILED' if said else 'nothing to complain about'}; picture and figures in {out}")


def _health(lane: Lane) -> str:
    seconds: dict[str, float] = {}
    for sample in lane.samples:
        for health, health_s in sample.health_s.items():
            seconds[health] = seconds.get(health, 0.0) + health_s
    total_s = sum(seconds.values())
    return ", ".join(f"{health} {100.0 * health_s / total_s:.1f} %" for health, health_s in seconds.items())


def _latency(lane: Lane, part: str) -> str:
    hours = [getattr(hour, part) for hour in lane.hours]
    if not hours:
        return "-"
    p50, p99, longest = (1e3 * max(getattr(h, name) for h in hours) for name in ("p50_s", "p99_s", "max_s"))
    return f"{p50:.3f}, {p99:.2f}, {longest:.1f}"


def _growth(lane: Lane) -> str:
    growth = growth_of(lane)
    if growth is None:
        return "too short to tell"
    return f"{growth.memory_mb:+.1f} MB (at least {growth.memory_low_mb:+.1f}), {growth.handles:+d} handles"


def _error(lane: Lane) -> str:
    quiet = [hour.error_quiet_deg for hour in lane.hours if hour.error_quiet_deg is not None]
    return f"{max(quiet):.2f}" if quiet else "-"


_ROWS: dict[str, Callable[[Lane], str]] = {
    "flown [h]": lambda lane: f"{lane.flown_s / 3600.0:.2f}",
    "times real time": lambda lane: f"{lane.flown_s / lane.wall_s:.1f}" if lane.wall_s else "-",
    "sorties, manoeuvres, faults": lambda lane: (
        f"{lane.samples[-1].sorties if lane.samples else 0}, {sum(lane.manoeuvres.values())}, "
        f"{sum(lane.faults.values())}"
    ),
    "health": _health,
    "resets": lambda lane: str(sum(lane.samples[-1].resets.values()) if lane.samples else 0),
    "growth": _growth,
    "engine, 4 ms: p50, p99, max [ms]": lambda lane: _latency(lane, "engine"),
    "Pipeline.step: p50, p99, max [ms]": lambda lane: _latency(lane, "pipeline"),
    "error of angles, worst hour, nothing wrong [deg]": _error,
}


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value <= 10_000.0:
        raise argparse.ArgumentTypeError(f"{text} given; expected above 0 and at most 10000")
    return value


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 256:
        raise argparse.ArgumentTypeError(f"{text} given; expected 1 to 256")
    return value


if __name__ == "__main__":
    sys.exit(main())
