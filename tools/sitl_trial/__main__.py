"""Flies swingd on a real PX4 or Copter in the loop, with a slung load, through stated manoeuvres: off, on, and shaped.

    python -m tools.sitl_trial --autopilot px4 --binary PX4-Autopilot/build/px4_sitl_default/bin/px4
    python -m tools.sitl_trial --autopilot ardupilot --binary ardupilot/build/sitl/bin/arducopter \
        --defaults ardupilot/Tools/autotest/default_params/copter.parm
    python -m tools.sitl_trial --autopilot simulated

For each flight the autopilot, ``swingd sim --hil``, ``swingd run`` in line and a MAVSDK application are started anew,
in real time. The folder gets tables (trial.md, trial.csv, trial.json), a picture of each manoeuvre, and of each flight
the truth, swingd's recording and what every process said. Exit code 1: an asked figure was not reached, or a flight was
not flown; 2: wrong usage.
"""

import argparse
import asyncio
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from swingd.cli import process
from swingd.config.loader import load_parameters
from swingd.model.errors import SwingdError
from swingd.model.parameters import Parameters

from . import report
from .autopilots import Autopilot, Copter, Px4, Simulated
from .flight import Flight, fly_once
from .picture import draw
from .plan import COPTER, PX4, Correction, Manoeuvre, Scenario
from .record import Files, TrialError
from .verdict import verdicts

ROOT = Path(__file__).parents[2]
SCENARIOS = {"px4": PX4, "ardupilot": COPTER, "simulated": PX4}
CONFIGS = {
    "px4": ROOT / "configs/iris.yaml",
    "ardupilot": Path(__file__).parent / "copter.yaml",
    "simulated": ROOT / "configs/iris.yaml",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, judge, write; return the exit code."""
    given = _parser().parse_args(arguments)
    process.end_on_signals()
    console = Console(stderr=True, markup=False)
    try:
        autopilot = _autopilot(given)
        scenarios = _chosen(SCENARIOS[given.autopilot], given.only, given.quick)
        parameters = load_parameters(given.config or CONFIGS[given.autopilot], given.set)
        folder = _folder(given.out or ROOT / f"out/sitl-{given.autopilot}", given.resume)
        trial = Trial(autopilot, parameters, folder, given.quick, console)
        keys = [Key(s, c, n) for n in range(1, given.repeats + 1) for s in scenarios for c in given.correction]
        not_flown = asyncio.run(trial.fly(keys, given.jobs))
        flights, not_judged = trial.judge(keys)
        failures = not_flown + not_judged
    except SwingdError as error:
        console.print(f"sitl_trial: {error}")
        return 2
    found = verdicts(flights)
    written = report.write(folder, flights, found, failures)
    for name in dict.fromkeys(flight.name for flight in flights):
        draw(folder, [flight for flight in flights if flight.name == name])
    if given.json:
        print(json.dumps(written))
    else:
        report.show(flights, found, Console(markup=False, width=None if sys.stdout.isatty() else 160))
    for failure in failures:
        console.print(f"not flown: {failure}")
    missed = [verdict for verdict in found if not verdict.reached]
    for verdict in missed:
        console.print(f"not reached: {verdict.where}: {verdict.what} {verdict.value:.2f}, at most {verdict.limit:g}")
    console.print(f"{len(found) - len(missed)} of {len(found)} asked figures reached; everything is in {folder}")
    return 1 if missed or failures else 0


@dataclass(frozen=True, slots=True)
class Key:
    """Which flight."""

    scenario: Scenario
    correction: Correction
    number: int
    """Of the repeat, from 1."""

    @property
    def name(self) -> str:
        return self.scenario.name if self.number == 1 else f"{self.scenario.name}#{self.number}"

    @property
    def label(self) -> str:
        return f"{self.name}, {self.correction}"

    def files(self, folder: Path) -> Files:
        return Files(folder / self.name / self.correction.value)


class Trial:
    """Flies each flight once; reads what they left when all have landed, for reading holds up those that fly."""

    def __init__(
        self, autopilot: Autopilot, parameters: Parameters, folder: Path, quick: bool, console: Console
    ) -> None:
        self._autopilot, self._parameters, self._folder, self._console = autopilot, parameters, folder, console
        self._quick = quick

    async def fly(self, keys: list[Key], jobs: int) -> list[str]:
        """Fly what is asked for, so many at once; return why which flight was not flown."""
        turn = asyncio.Semaphore(jobs)
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[doing]}"))
        with Progress(*columns, TimeElapsedColumn(), console=self._console) as progress:

            async def one(key: Key) -> str | None:
                async with turn:
                    return await self._one(key, progress)

            return [failure for failure in await asyncio.gather(*map(one, keys)) if failure is not None]

    async def _one(self, key: Key, progress: Progress) -> str | None:
        if key.files(self._folder).flown.exists():
            return None
        task = progress.add_task(f"{key.label:20}", total=1.0, doing="")
        last = ""

        def say(doing: str, share: float) -> None:
            nonlocal last
            progress.update(task, completed=share, doing=doing)
            if doing != last and not self._console.is_terminal:
                self._console.print(f"{key.label}: {doing}")
            last = doing

        simulation = self._parameters.simulation
        other_noise = replace(simulation, seed=simulation.seed + key.number - 1)
        parameters = replace(self._parameters, simulation=other_noise)
        manoeuvres = self._manoeuvres(key.scenario)
        try:
            files = key.files(self._folder)
            await fly_once(self._autopilot, parameters, key.scenario, manoeuvres, key.correction, files, say)
        except TrialError as error:
            say("failed", 1.0)
            return f"{key.label}: {error}"
        say("flown", 1.0)
        return None

    def judge(self, keys: list[Key]) -> tuple[list[Flight], list[str]]:
        """Read the flights that were flown, in the order asked for, and why others say nothing."""
        flights, failures = [], []
        for key in keys:
            files = key.files(self._folder)
            if not files.flown.exists():
                continue
            try:
                flights.append(Flight.load(key.name, key.scenario, key.correction, files))
            except TrialError as error:
                failures.append(f"{key.label}: {error}")
        return flights, failures

    def _manoeuvres(self, scenario: Scenario) -> list[Manoeuvre]:
        manoeuvres = list(scenario.manoeuvres(scenario.period_s))
        return manoeuvres[:1] if self._quick else manoeuvres


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tools.sitl_trial", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = "; ".join(f"{key}: {', '.join(s.name for s in scenarios)}" for key, scenarios in SCENARIOS.items())
    cores = os.cpu_count() or 1
    corrections = list(Correction)
    add = parser.add_argument
    add("--autopilot", choices=tuple(SCENARIOS), required=True)
    add("--binary", type=Path, metavar="FILE", help="bin/px4 of a SITL build, or arducopter; else $SWINGD_PX4, _COPTER")
    add("--defaults", type=Path, metavar="FILE", help="copter.parm of ArduPilot; else $SWINGD_COPTER_DEFAULTS")
    add("-c", "--config", type=Path, metavar="FILE", help="vehicle, sensors and gains, instead of the trial's own")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="one key of the configuration; repeatable")
    add("-o", "--out", type=Path, metavar="FOLDER", help="default: out/sitl-AUTOPILOT")
    add("--resume", action="store_true", help="do not fly again what the folder holds already")
    add("--only", action="append", metavar="NAME", help=f"repeatable; {names}")
    add("--quick", action="store_true", help="the first step alone")
    add("--repeats", type=int, default=1, metavar="N", help="fly everything N times, with other noise")
    add("--correction", type=Correction, choices=corrections, nargs="+", default=corrections, help="ratios need off")
    add("--jobs", type=int, default=max(1, cores // 2), metavar="N", help="flights at once; each wants a core")
    add("--json", action="store_true", help="print one JSON object instead of the tables")
    return parser


def _autopilot(given: argparse.Namespace) -> Autopilot:
    if given.autopilot == "simulated":
        return Simulated()
    if given.autopilot == "px4":
        return Px4(_file(given.binary, "--binary", "SWINGD_PX4", "bin/px4 of a SITL build"))
    return Copter(
        _file(given.binary, "--binary", "SWINGD_COPTER", "the arducopter of a SITL build"),
        _file(given.defaults, "--defaults", "SWINGD_COPTER_DEFAULTS", "ArduPilot's default_params/copter.parm"),
    )


def _file(given: Path | None, option: str, variable: str, expected: str) -> Path:
    named = given or os.environ.get(variable)
    if not named:
        raise TrialError(f"neither {option} nor ${variable}; expected {expected}")
    path = Path(named).absolute()
    if not path.is_file():
        raise TrialError(f"{option}: no file {path}; expected {expected}")
    return path


def _chosen(scenarios: Sequence[Scenario], only: list[str] | None, quick: bool) -> list[Scenario]:
    known = {scenario.name: scenario for scenario in scenarios}
    unknown = [name for name in only or () if name not in known]
    if unknown:
        raise TrialError(f"--only: no {', '.join(unknown)}; expected {', '.join(known)}")
    if only:
        return [known[name] for name in only]
    return list(scenarios[:1] if quick else scenarios)


def _folder(folder: Path, resume: bool) -> Path:
    folder = folder.absolute()
    if not resume and folder.is_dir() and any(folder.iterdir()):
        raise TrialError(f"--out: {folder} is not empty; expected a new folder, or --resume")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


if __name__ == "__main__":
    sys.exit(main())
