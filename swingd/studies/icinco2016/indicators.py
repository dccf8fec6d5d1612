"""Indicators of a flight: tracking, overshoot, settling, swing, and the error of the estimated disturbances."""

from math import sqrt

import numpy as np

from swingd.core.planar_flight import PlanarFlightLog
from swingd.core.planar_rotorcraft import PlanarState
from swingd.model.estimate import FloatArray
from swingd.studies.icinco2016 import paper
from swingd.studies.icinco2016.flight import Flight

AXES = ("x", "z", "theta")
ESTIMATED_FROM_S = 1.0
"""The filters have found the load's weight."""
TRACKED_FROM_S = 10.0
"""The step to the point, or onto the moving circle, is over in every flight."""
SETTLED_SHARE = 0.05
"""Of the way to the point, or of the circle's radius."""
NOTHING = 1e-9
"""Smaller disturbances and errors [N, N m] are rounding."""
SWING_S = 5.0
"""At the end, in which the swing that is left is measured."""

UNITS = {
    "error_x": "m",
    "error_z": "m",
    "error": "m",
    "error_x_torque": "m",
    "peak_torque": "m",
    "error_theta": "deg",
    "overshoot_x": "%",
    "overshoot_z": "%",
    "settled": "s",
    "swing": "deg",
    **{f"rho_{axis}": "N m" if axis == "theta" else "N" for axis in AXES},
    **{f"rmse_{axis}": "N m" if axis == "theta" else "N" for axis in AXES},
    **{f"relative_{axis}": "%" for axis in AXES},
    **{f"lag_{axis}": "N m" if axis == "theta" else "N" for axis in AXES},
    **{f"noise_{axis}": "N m" if axis == "theta" else "N" for axis in AXES},
}
"""Of the indices, in the order of the tables."""


def indicators(flight: Flight) -> dict[str, float]:
    """Compute the indicators.

    Returns
    -------
    dict
        By the names of `UNITS`: RMS of the tracking error ``error_x``, ``error_z``, ``error`` (their norm) and of the
        pitch against the pitch asked for, ``error_theta``, from `TRACKED_FROM_S` on; ``error_x_torque`` and the
        largest distance ``peak_torque`` from the torque's instant on; ``overshoot_*`` of the regulation, before the
        torque; ``settled``, after which the error stays below `SETTLED_SHARE` until the torque, that instant where it
        does not; ``swing``, RMS of the rod angle at the end. Of each disturbance its RMS ``rho_*``, the estimate's
        RMSE ``rmse_*``, that over the RMS, ``relative_*``, absent where there is no disturbance, and the parts of
        the RMSE that are the filter's ``lag_*`` and ``noise_*``, from `ESTIMATED_FROM_S` on.
    """
    t_s, error = flight.t_s, flight.error_m
    distance = np.hypot(*error.T)
    tracked, torque = t_s >= TRACKED_FROM_S, t_s >= paper.TORQUE_AT_S
    state = flight.column(PlanarFlightLog.STATE, PlanarState.SIZE)
    pitch_error = state[:, PlanarState.PITCH] - flight.column(PlanarFlightLog.POS_SP, 3)[:, 2]
    rod = state[t_s >= t_s[-1] - SWING_S, PlanarState.ROD]
    figures = {
        "error_x": rms(error[tracked, 0]),
        "error_z": rms(error[tracked, 1]),
        "error": rms(distance[tracked]),
        "error_x_torque": rms(error[torque, 0]),
        "peak_torque": float(distance[torque].max()),
        "error_theta": float(np.degrees(rms(pitch_error[tracked]))),
        "settled": _settled_s(flight, distance),
        # A rod that has turned over hangs as it did before.
        "swing": float(np.degrees(rms(np.arctan2(np.sin(rod), np.cos(rod))))),
    }
    if flight.scenario.circle_hz == 0.0:
        for axis, target_m in enumerate(paper.TARGET_M):
            beyond = float(error[~torque, axis].max())
            figures[f"overshoot_{AXES[axis]}"] = 100.0 * max(beyond, 0.0) / target_m
    return figures | disturbance_errors(flight)


def disturbance_errors(flight: Flight) -> dict[str, float]:
    """Compare the estimated disturbances with the true ones; see `indicators`."""
    judged = flight.t_s >= ESTIMATED_FROM_S
    true, estimated, noiseless = (
        flight.column(first, 3)[judged]
        for first in (PlanarFlightLog.RHO, PlanarFlightLog.RHO_ESTIMATE, PlanarFlightLog.RHO_NOISELESS)
    )
    figures = {}
    for axis, name in enumerate(AXES):
        size, rmse = rms(true[:, axis]), rms(estimated[:, axis] - true[:, axis])
        figures[f"rho_{name}"] = size
        figures[f"rmse_{name}"] = rmse
        figures[f"lag_{name}"] = rms(noiseless[:, axis] - true[:, axis])
        figures[f"noise_{name}"] = rms(estimated[:, axis] - noiseless[:, axis])
        if size > NOTHING:
            figures[f"relative_{name}"] = 100.0 * rmse / size
    return {index: value if value > NOTHING else 0.0 for index, value in figures.items()}


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return sqrt(float(np.mean(values * values)))


def _settled_s(flight: Flight, distance: FloatArray) -> float:
    before = flight.t_s < paper.TORQUE_AT_S
    way_m = paper.RADIUS_M if flight.scenario.circle_hz > 0.0 else float(np.hypot(*paper.TARGET_M))
    beyond = np.flatnonzero(distance[before] > SETTLED_SHARE * way_m)
    if not beyond.size:
        return 0.0
    return float(flight.t_s[beyond[-1] + 1])
