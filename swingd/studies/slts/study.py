"""The whole study: every flight of a seed, its figures, and the object that a program reads."""

from collections.abc import Callable, Mapping
from typing import Any

from swingd.identify.gp_training import Training
from swingd.studies.seeds import Figures
from swingd.studies.slts import paper
from swingd.studies.slts.cases import SCENARIOS
from swingd.studies.slts.flight import Flight, run
from swingd.studies.slts.indicators import estimation, following
from swingd.studies.slts.training import MODEL_OF, WITH_VELOCITY, Models

ESTIMATE = "estimate/"
"""Before a flight's name: what its filters are worth."""

Flights = Mapping[str, Flight]
"""By scenario; that name followed by `swingd.studies.slts.training.WITH_VELOCITY` for the wider model's."""


def fly_all(seed: int, models: Models, watch: Callable[[float], None] = lambda _share: None) -> dict[str, Flight]:
    """Fly every path with the loop closed on the GP-EKF, by the paper's model and by the wider one.

    Parameters
    ----------
    seed : int
        Of sensors, camera and gusts.
    models : Models
    watch : callable
        Takes the share done, 0..1.

    Raises
    ------
    StudyError
        If a flight diverges.
    """
    flights = {}
    for done, scenario in enumerate(SCENARIOS, start=1):
        model = MODEL_OF[scenario.name]
        flights[scenario.name] = run(scenario, seed, models[model])
        flights[f"{scenario.name} {WITH_VELOCITY}"] = run(scenario, seed, models[f"{model} {WITH_VELOCITY}"])
        watch(done / len(SCENARIOS))
    return flights


def judge(flights: Flights) -> Figures:
    """Compute every figure of a seed's flights: ``square`` and so on, and ``estimate/square``."""
    figures: Figures = {}
    for name, flight in flights.items():
        figures[name] = following(flight)
        figures[ESTIMATE + name] = estimation(flight)
    return figures


def fly_and_judge(models: Models, seed: int) -> Figures:
    """Fly every path with a seed and compute its figures."""
    return judge(fly_all(seed, models))


def as_object(mean: Figures, spread: Figures, seeds: int, trained: Mapping[str, Training]) -> dict[str, Any]:
    """Build the object that ``--json`` prints.

    Returns
    -------
    dict
        By path and index ``ours``, ``paper`` where it prints one, ``ours_std`` where more than one seed was flown;
        under ``estimate`` the filters' figures by path, under ``training`` the held-out scores by vehicle.
    """
    result: dict[str, Any] = {"seeds": seeds}
    for name, printed in paper.VALUES.items():
        rows: dict[str, dict[str, float]] = {}
        for index, value in mean[name].items():
            rows[index] = {"ours": value}
            if index in printed:
                rows[index]["paper"] = printed[index]
            if seeds > 1:
                rows[index]["ours_std"] = spread[name][index]
        result[name] = rows
    result["estimate"] = {
        group.removeprefix(ESTIMATE): found for group, found in mean.items() if group.startswith(ESTIMATE)
    }
    result["training"] = {
        name: {
            "samples": len(training.trained.z),
            "held_out": len(training.held_out.z),
            "rmse_before": training.score.rmse_before,
            "rmse_after": training.score.rmse_after,
            "log_likelihood_before": training.score.log_likelihood_before,
            "log_likelihood_after": training.score.log_likelihood_after,
        }
        for name, training in trained.items()
    }
    return result
