"""Flights that the Gaussian process is trained on: other paths than the judged ones, seen by a motion capture."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from swingd.core.slts_flight import SltsFlightLog
from swingd.estimation.acceleration_model import Prepared, TrainedFor
from swingd.identify.gp_training import Training, train
from swingd.identify.swing_log import Segment, write
from swingd.studies.slts.cases import OUTDOOR, SQUARE, TRAINING, Scenario, like
from swingd.studies.slts.flight import Flight, run
from swingd.studies.slts.vehicles import CABLE_M

FIRST_SEED = 1000
"""Of the training flights; no flight that is judged has a seed from here on to ten more."""
TRACKED_STD_M = 0.001
"""Noise of the measured load's position."""
_SMOOTHED_S = 0.25

VEHICLES = {"simulated": SQUARE, "flown": OUTDOOR}
"""Whose model serves which vehicle: every vehicle has one of its own."""
MODEL_OF = {"square": "simulated", "circle": "simulated", "outdoor": "flown"}
Models = dict[str, Prepared]
"""By name in `VEHICLES`, as the filters take them."""


def train_all(watch: Callable[[float], None] = lambda _share: None, folder: Path | None = None) -> dict[str, Training]:
    """Fly the training paths with each vehicle, loop closed on the plain EKF, and train a model of each.

    Parameters
    ----------
    watch : callable
        Takes the share done, 0..1.
    folder : Path or None
        Where logs and models are kept, for ``swingd gp train``.
    """
    trained = {}
    for at, (name, scenario) in enumerate(VEHICLES.items()):
        segments = [tracked(flight) for flight in training_flights(scenario)]
        vehicle = scenario.vehicle
        trained_for = TrainedFor(vehicle.mass_kg, vehicle.load_mass_kg, CABLE_M)
        trained[name] = train(
            segments, trained_for, watch=lambda share, at=at: watch((at + share) / len(VEHICLES))  # type: ignore[misc]
        )  # fmt: skip
        if folder is not None:
            for path, segment in zip(TRAINING, segments, strict=True):
                write(folder / f"{name}_{path.name}.csv", segment)
            (folder / f"{name}.json").write_text(trained[name].model.to_json(), encoding="utf-8")
    return trained


def training_flights(scenario: Scenario) -> list[Flight]:
    """Fly every training path with a scenario's vehicle."""
    return [run(like(path, scenario), FIRST_SEED + at) for at, path in enumerate(TRAINING)]


def tracked(flight: Flight) -> Segment:
    """Return a flight as a log with the load's position measured from outside; v by a cubic over a quarter second."""
    from scipy.signal import savgol_filter

    noise = np.random.default_rng(FIRST_SEED).standard_normal((len(flight.t_s), 2))
    r_m = flight.column(SltsFlightLog.TRUE + 3, 2) + TRACKED_STD_M * noise
    dt_s = float(flight.t_s[1] - flight.t_s[0])
    window = 2 * round(0.5 * _SMOOTHED_S / dt_s) + 1
    return Segment(
        flight.t_s,
        flight.column(SltsFlightLog.FORCE, 3),
        savgol_filter(r_m, window, 3, axis=0),
        savgol_filter(r_m, window, 3, deriv=1, delta=dt_s, axis=0),
    )
