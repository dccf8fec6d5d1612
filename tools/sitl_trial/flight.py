"""One flight from the first process to the files in its folder."""

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass

from swingd.model.parameters import Parameters

from .application import Say, fly
from .autopilots import Autopilot
from .figures import FlightFigures, StepFigures, judge_flight, judge_step
from .plan import Correction, Manoeuvre, Scenario
from .processes import Bench, bench, summary
from .record import Files, Flown, Step, TrialError, Truth


@dataclass(frozen=True, slots=True)
class Flight:
    """One that was flown, read from its folder."""

    name: str
    """Of the scenario, with the number of the repeat."""
    scenario: Scenario
    correction: Correction
    flown: Flown
    truth: Truth
    figures: FlightFigures
    steps: tuple[tuple[Step, StepFigures], ...]

    @staticmethod
    def load(name: str, scenario: Scenario, correction: Correction, files: Files) -> "Flight":
        """Read and judge a flight.

        Raises
        ------
        TrialError
            If its files are not there or hold no flight.
        """
        flown, truth = Flown.load(files.flown), Truth.load(files.truth)
        return Flight(
            name,
            scenario,
            correction,
            flown,
            truth,
            judge_flight(truth, flown, summary(files)),
            tuple((step, judge_step(truth, step, scenario)) for step in flown.steps),
        )


async def fly_once(
    autopilot: Autopilot,
    parameters: Parameters,
    scenario: Scenario,
    manoeuvres: list[Manoeuvre],
    correction: Correction,
    files: Files,
    say: Say,
) -> None:
    """Fly a scenario once and leave its files.

    Raises
    ------
    TrialError
        If it could not be flown; with the last words of all processes.
    """
    files.folder.mkdir(parents=True, exist_ok=True)
    # What an attempt left that came to nothing; swingd overwrites no recording.
    for path in (files.recording, files.summary, files.flown, files.truth):
        path.unlink(missing_ok=True)
    async with bench(autopilot, parameters, scenario, correction, files) as running:
        try:
            flown = await _unless_ended(running, fly(running.url, autopilot.parameters, scenario, manoeuvres, say))
        except TrialError as error:
            words = "".join(f"\n{process.name}:\n{process.tail()}" for process in running.processes)
            raise TrialError(f"{error}{words}") from error
    flown.save(files.flown)


async def _unless_ended(running: Bench, flying: Coroutine[object, object, Flown]) -> Flown:
    """Await the flight, or the first process that ends before it."""
    flight = asyncio.ensure_future(flying)
    ends = [asyncio.ensure_future(process.ended()) for process in running.processes]
    try:
        await asyncio.wait((flight, *ends), return_when=asyncio.FIRST_COMPLETED)
        if flight.done():
            return flight.result()
        raise next(end for end in ends if end.done()).result()
    finally:
        for task in (flight, *ends):
            task.cancel()
        await asyncio.gather(flight, *ends, return_exceptions=True)
