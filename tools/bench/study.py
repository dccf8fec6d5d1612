"""The study's compiled flights: plant, wind, sensors, both filters, law and autopilot on one core."""

import math
from dataclasses import replace

from swingd.studies.drones2023.cases import CASE_1, CASE_3, PAYLOAD_CONTROLLER
from swingd.studies.drones2023.flight import run

from .result import Result, quickest


def bench_study(duration_s: float) -> list[Result]:
    """A flight in calm air and one in turbulence against real time; the noise's generation included."""
    scenarios = [replace(case, duration_max_s=duration_s, stop_for_s=math.inf) for case in (CASE_1, CASE_3)]

    def calm() -> None:
        run(scenarios[0], PAYLOAD_CONTROLLER, 0)

    def turbulent() -> None:
        run(scenarios[1], PAYLOAD_CONTROLLER, 0)

    speeds = [duration_s / wall_s for wall_s in quickest(calm, turbulent)]
    names = ("study: case 1, calm air", "study: case 3, turbulence")
    return [Result(n, speed, "x real time", "real time", 1.0, speed) for n, speed in zip(names, speeds, strict=True)]
