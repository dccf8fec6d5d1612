"""What a flight is judged by: following of the path, swing, and errors of the estimated load."""

import numpy as np

from swingd.core.slts_flight_layout import SltsFlightLog
from swingd.model.estimate import FloatArray
from swingd.record.truth import BoolArray
from swingd.studies.slts.cases import OUTDOOR
from swingd.studies.slts.flight import Flight

LEVEL_AFTER_S = 5.0
"""After a change of leg the flight counts as level again."""
RECOVERED_M = 0.9413
"""Vertical error that the outdoor flight does not exceed any more once it has recovered, as in the paper."""
RECOVERED_BY_S = 5.26
"""From here on the outdoor flight is judged vertically, as the paper does."""
SETTLED_S = 2.0
"""The filters' errors are counted after their start."""


def size(vectors: FloatArray) -> FloatArray:
    """Length of each vector, (n, k) -> (n,)."""
    return np.asarray(np.linalg.norm(vectors, axis=1))


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def level(flight: Flight) -> BoolArray:
    """Tell which rows are level flight: `LEVEL_AFTER_S` after the start and after every change of leg; (n,) bool."""
    leg = flight.column(SltsFlightLog.LEG)
    changed = np.flatnonzero(np.diff(leg, prepend=leg[0] - 1.0))
    since_s = flight.t_s - flight.t_s[changed][np.cumsum(np.diff(leg, prepend=leg[0] - 1.0) != 0.0) - 1]
    return np.asarray(since_s > LEVEL_AFTER_S)


def following(flight: Flight) -> dict[str, float]:
    """Compute every index of `swingd.studies.slts.paper.UNITS` that the flight has, from the truth.

    Returns
    -------
    dict
        Errors (5), (6) of the true load on the leg that is flown, the hold at the end left out; swing as displacement
        of the vehicle relative to the load. Of the outdoor flight the vertical error from `RECOVERED_BY_S` on, beside
        it ``vertical_rms_all``.
    """
    on_path = flight.column(SltsFlightLog.LEG) < len(flight.scenario.waypoints_ned_m) - 1
    outdoor = flight.scenario.name == OUTDOOR.name
    e_p = flight.column(SltsFlightLog.TRUE_E_P, 3)
    e_v = size(flight.column(SltsFlightLog.TRUE_E_V, 3))[on_path]
    lateral, vertical = size(e_p[:, :2])[on_path], np.abs(e_p[on_path, 2])
    r, v = size(flight.column(SltsFlightLog.TRUE + 3, 2)), size(flight.column(SltsFlightLog.TRUE + 8, 2))
    t_s = flight.t_s[on_path]
    judged = t_s > RECOVERED_BY_S if outdoor else np.full(t_s.shape, True)
    found = {
        "lateral_rms": rms(lateral),
        "lateral_max": float(lateral.max()),
        "vertical_rms": rms(vertical[judged]),
        "vertical_max": float(vertical[judged].max()),
        "swing_max": float(r[on_path].max()),
        "swing_rate_max": float(v[on_path].max()),
        "velocity_error_rms": rms(e_v),
        "velocity_error_max": float(e_v.max()),
    }
    if outdoor:
        late = np.flatnonzero(vertical > RECOVERED_M)
        found["recovered"] = float(t_s[late[-1]]) if late.size else 0.0
        found["vertical_rms_all"] = rms(vertical)
    steady = level(flight) & on_path
    if steady.any():
        found["swing_level_max"] = float(r[steady].max())
        found["swing_rate_level_max"] = float(v[steady].max())
    return found


def estimation(flight: Flight) -> dict[str, float]:
    """Compute the errors of the load's relative position by both filters and by the camera, its last picture held.

    Returns
    -------
    dict
        RMSE and maximum of |r error| [m], ``*_v_rmse`` of its rate [m/s], mean NEES of r and v (4 degrees of freedom:
        4 is right), share of the errors of r within 3 sigma, ``gain`` of the Gaussian process in percent.
    """
    settled = flight.t_s > SETTLED_S
    true = flight.column(SltsFlightLog.TRUE, 10)[settled]
    nees = flight.column(SltsFlightLog.NEES, 2)[settled]
    camera = size(flight.column(SltsFlightLog.CAMERA, 2)[settled] - true[:, 3:5])
    found = {"camera_rmse": rms(camera), "camera_max": float(camera.max())}
    columns = ((SltsFlightLog.GP_EKF, SltsFlightLog.GP_EKF_VAR), (SltsFlightLog.EKF, SltsFlightLog.EKF_VAR))
    for at, (name, (state, var)) in enumerate(zip(("gp_ekf", "ekf"), columns, strict=True)):
        error = flight.column(state, 10)[settled] - true
        r_error = size(error[:, 3:5])
        found[f"{name}_rmse"] = rms(r_error)
        found[f"{name}_max"] = float(r_error.max())
        found[f"{name}_v_rmse"] = rms(size(error[:, 8:10]))
        found[f"{name}_nees"] = float(np.mean(nees[:, at]))
        inside = np.abs(error[:, 3:5]) < 3.0 * np.sqrt(flight.column(var, 10)[settled, 3:5])
        found[f"{name}_within_3_sigma"] = float(inside.mean())
    found["gain"] = 100.0 * (1.0 - found["gp_ekf_rmse"] / found["ekf_rmse"])
    return found
