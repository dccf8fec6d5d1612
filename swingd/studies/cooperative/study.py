"""The whole study: the flights of a seed, their estimates, their figures, and the object that a program reads."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from swingd.core.cooperative_flight import LoadLog
from swingd.core.tether_angles import TetherModel
from swingd.model.estimate import FloatArray
from swingd.studies.cooperative import battery, paper
from swingd.studies.cooperative.battery import HoverOverBattery
from swingd.studies.cooperative.cases import (
    ATTITUDE,
    EXPERIMENT,
    NOISE,
    POSITION,
    QUIET,
    RETUNED,
    STEPS,
    TUNING,
    UNFILTERED,
    VIBRATION,
)
from swingd.studies.cooperative.estimate import Track, our_track, paper_track, winch_table
from swingd.studies.cooperative.flight import Flight, Scenario, run
from swingd.studies.cooperative.measure import Noise, measure
from swingd.studies.seeds import Figures

SETTLED_S = 2.0
"""From the start, where the filters find the tethers."""
LOST_RAD = np.radians(45.0)
"""A direction so far from the truth is no estimate."""
PRINTED = "printed"
STEP_NAMES = ("retuned", *STEPS)
"""Between ``paper`` and ``ours``."""
CASES: tuple[tuple[Scenario, Noise], ...] = ((ATTITUDE, QUIET), (POSITION, QUIET), (EXPERIMENT, NOISE))


@dataclass(frozen=True, slots=True)
class Case:
    """One flight with what the estimators make of it."""

    flight: Flight
    tracks: Mapping[str, Track]
    """By name: ``paper``, ``ours``, ``printed``, and the steps between paper and ours in the experiment."""


@dataclass(frozen=True, slots=True)
class Study:
    """Everything of one seed."""

    cases: Mapping[str, Case]
    vibration: Mapping[str, Track]
    """Of the experiment's flight with rotors out of balance: ``paper``, ``unfiltered``, ``ours``."""
    hover: HoverOverBattery


def fly_all(seed: int, watch: Callable[[float], None] = lambda _share: None) -> Study:
    """Fly the three cases, estimate each, and hover over a battery.

    Raises
    ------
    StudyError
        If a flight diverges or a filter fails.
    """
    cases = {}
    for done, (scenario, noise) in enumerate(CASES, start=1):
        flight = run(scenario, seed)
        carriers = measure(flight, noise, seed)
        table = winch_table(scenario.lean_rad)
        noisy = scenario.name == EXPERIMENT.name
        design = paper.EXPERIMENT if noisy else paper.SIMULATION
        tracks = {
            "paper": paper_track(carriers, design, table),
            PRINTED: paper_track(carriers, design, table, TetherModel.PRINTED),
            "ours": our_track(carriers, noise, table, TUNING),
        }
        if noisy:
            tracks["retuned"] = paper_track(carriers, RETUNED, table)
            tracks |= {name: our_track(carriers, noise, table, tuning) for name, tuning in STEPS.items()}
        cases[scenario.name] = Case(flight, tracks)
        watch(done / len(CASES))
    flight = cases[EXPERIMENT.name].flight
    carriers, table = measure(flight, VIBRATION, seed), winch_table(flight.scenario.lean_rad)
    vibration = {
        "paper": paper_track(carriers, paper.EXPERIMENT, table),
        "unfiltered": our_track(carriers, NOISE, table, UNFILTERED),
        "ours": our_track(carriers, NOISE, table, TUNING),
    }
    return Study(cases, vibration, battery.hover(seed))


def errors(flight: Flight, track: Track) -> FloatArray:
    """Return (n, 6) errors of roll, pitch, yaw [deg] and position [m] after the filters have settled."""
    turn = track.euler_rad - flight.load(LoadLog.EULER)
    turn = np.degrees((turn + np.pi) % (2.0 * np.pi) - np.pi)
    both = np.column_stack([turn, track.pos_ned_m - flight.load(LoadLog.POS)])
    settled: FloatArray = both[flight.t_s >= SETTLED_S]
    return settled


def rmse(off: FloatArray) -> dict[str, float]:
    """Return the RMSE of errors (n, 6) by state."""
    return dict(zip(paper.UNITS, np.sqrt(np.mean(off * off, axis=0)).tolist(), strict=True))


def judge(study: Study) -> Figures:
    """Compute every figure of a seed.

    Returns
    -------
    dict
        Keys ``experiment/paper`` and so on for the RMSE by state, ``experiment/paper/largest``,
        ``experiment/ours/change_percent`` against the paper's filter, ``experiment/ours/nees`` for how well the claimed
        deviations hold, ``attitude/printed`` for how long the printed model held, ``hover`` for the thrust's errors.
    """
    figures: Figures = {"hover": study.hover.errors_percent()}
    flight = study.cases[EXPERIMENT.name].flight
    for variant, track in study.vibration.items():
        figures[f"vibration/{variant}"] = rmse(errors(flight, track))
    for name, case in study.cases.items():
        for variant, track in case.tracks.items():
            if variant == PRINTED:
                figures[f"{name}/{PRINTED}"] = {"held_s": held_s(case.flight, track)}
                continue
            off = errors(case.flight, track)
            figures[f"{name}/{variant}"] = rmse(off)
            figures[f"{name}/{variant}/largest"] = dict(zip(paper.UNITS, np.abs(off).max(axis=0).tolist(), strict=True))
    theirs = figures["experiment/paper"]
    for variant in (*STEP_NAMES, "ours"):
        figures[f"experiment/{variant}/change_percent"] = {
            state: 100.0 * (value / theirs[state] - 1.0) for state, value in figures[f"experiment/{variant}"].items()
        }
    return figures


def held_s(flight: Flight, track: Track) -> float:
    """For how long both directions stayed within `LOST_RAD` of the truth [s]."""
    lost = np.zeros(flight.t_s.size, dtype=bool)
    for index in range(track.directions.shape[0]):
        cosine = np.sum(heading_direction(flight, index) * track.directions[index], axis=1)
        lost |= ~(cosine > np.cos(LOST_RAD))
    return float(flight.t_s[np.argmax(lost)] if lost.any() else flight.t_s[-1])


def heading_direction(flight: Flight, index: int) -> FloatArray:
    """Return the true direction to the middle between a vehicle's anchors in its heading frame, (n, 3)."""
    yaw = flight.carrier_yaw_rad(index)
    north, east, down = flight.direction(index).T
    c, s = np.cos(yaw), np.sin(yaw)
    turned: FloatArray = np.column_stack([c * north + s * east, c * east - s * north, down])
    return turned


def fly_and_judge(seed: int) -> Figures:
    """Fly everything with a seed and compute its figures."""
    return judge(fly_all(seed))


def as_object(mean: Figures, spread: Figures, seeds: int) -> dict[str, Any]:
    """Build the object that ``--json`` prints.

    Returns
    -------
    dict
        ``table3`` by state: ``printed``, ``paper`` (its filter here), ``ours``, ``change_percent`` and the largest
        errors, with ``*_std`` where more than one seed was; beside it ``manoeuvres``, ``vibration``, ``steps``,
        ``printed_held_s``, ``hover``.
    """
    table: dict[str, dict[str, float]] = {}
    for state in paper.UNITS:
        row = {"printed": paper.RMSE[state], "printed_largest": paper.LARGEST[state]}
        for name, group in (
            ("paper", "experiment/paper"),
            ("ours", "experiment/ours"),
            ("change_percent", "experiment/ours/change_percent"),
            ("paper_largest", "experiment/paper/largest"),
            ("ours_largest", "experiment/ours/largest"),
        ):
            row[name] = mean[group][state]
            if seeds > 1:
                row[f"{name}_std"] = spread[group][state]
        table[state] = row
    return {
        "seeds": seeds,
        "table3": table,
        "manoeuvres": {
            case: {variant: mean[f"{case}/{variant}"] for variant in ("paper", "ours")}
            for case in ("attitude", "position")
        },
        "vibration": {variant: mean[f"vibration/{variant}"] for variant in ("paper", "unfiltered", "ours")},
        "steps": {name: mean[f"experiment/{name}"] for name in STEP_NAMES},
        "printed_held_s": {scenario.name: mean[f"{scenario.name}/{PRINTED}"]["held_s"] for scenario, _ in CASES},
        "hover": mean["hover"],
    }
