"""Flights that the Gaussian process is trained on: other paths than the judged ones, seen by a motion capture."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from swingd.core.slts_flight_layout import SltsFlightLog
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
WITH_VELOCITY = "with velocity"
Models = dict[str, Prepared]
"""By name in `VEHICLES` with the features of (17); with the load's velocity too by that name and `WITH_VELOCITY`."""


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
        for title, with_velocity in ((name, False), (f"{name} {WITH_VELOCITY}", True)):
            trained[title] = train(segments, trained_for, with_velocity=with_velocity)
            if folder is not None:
                text = trained[title].model.to_json()
                (folder / f"{title.replace(' ', '_')}.json").write_text(text, encoding="utf-8")
        if folder is not None:
            for path, segment in zip(TRAINING, segments, strict=True):
                write(folder / f"{name}_{path.name}.csv", segment)
        watch((at + 1) / len(VEHICLES))
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
    v_mps = savgol_filter(r_m, window, 3, deriv=1, delta=dt_s, axis=0)
    # The vehicle's velocity as its autopilot tells it, which the plain EKF has made of it here.
    estimate = flight.column(SltsFlightLog.EKF, 10)
    vel_load_mps = estimate[:, 5:7] + estimate[:, 8:10] - v_mps
    return Segment(
        flight.t_s, flight.column(SltsFlightLog.FORCE, 3), savgol_filter(r_m, window, 3, axis=0), v_mps, vel_load_mps
    )
