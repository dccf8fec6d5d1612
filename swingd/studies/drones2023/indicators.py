"""Indicators of a flight: (17) to (21), and the errors of both filters."""

from math import degrees, sqrt

import numpy as np

from swingd.core import pendulum
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slung_flight import FlightLog
from swingd.model.estimate import FloatArray
from swingd.studies.drones2023.flight import DT_S, Flight
from swingd.studies.drones2023.potentiometer import readings

SWING_NAMES = ("xi_deg", "zeta_deg", "xi_rate_deg_s", "zeta_rate_deg_s")
PENDULUM_DAMPING = 0.02
"""Natural damping ratio of the open-loop pendulum."""
SETTLED_DEG = 1.4
"""5 % of the 28 deg with which case 1 begins."""
STEADY_S = (20.0, 30.0)
"""In which the paper averages the disturbance of case 2."""


def indicators(flight: Flight) -> dict[str, float]:
    """Compute the performance indicators.

    Returns
    -------
    dict
        ``t_m`` [s], ``chi_bar`` [deg] (18), ``nu_bar`` [deg/s] (19), ``d_bar`` [m] (20), ``energy`` [kJ] (21),
        ``chi_integral`` [deg s], ``nu_integral`` [deg/sqrt(s)], and ``distance_to_go`` [m], the mean distance in space
        from the position that is wanted. Distances are left out where velocities are commanded.
    """
    t_m = flight.duration_s
    chi, nu = np.degrees(flight.column(FlightLog.CHI)), np.degrees(flight.column(FlightLog.CHI_RATE))
    chi_integral, nu2_integral = _integral(flight, chi), _integral(flight, nu * nu)
    figures = {
        "t_m": t_m,
        "chi_bar": chi_integral / t_m,
        "nu_bar": sqrt(nu2_integral / t_m),
        "energy": float(flight.log[-1, FlightLog.ENERGY]) / 1e3,
        "chi_integral": chi_integral,
        "nu_integral": sqrt(nu2_integral),
    }
    if not flight.scenario.by_velocity:
        to_go = np.linalg.norm(flight.column(FlightLog.POS, 3) - flight.column(FlightLog.REFERENCE, 3), axis=1)
        figures["d_bar"] = _integral(flight, track_distance_m(flight)) / t_m
        figures["distance_to_go"] = _integral(flight, to_go) / t_m
    return figures


def track_distance_m(flight: Flight) -> FloatArray:
    """Give the horizontal distance d(t) from the line between the waypoints, or from the one position held, (n,)."""
    waypoints = np.array(flight.scenario.references)[:, 1:3]
    leg = flight.column(FlightLog.LEG).astype(int)
    end, begin = waypoints[leg], waypoints[np.maximum(leg - 1, 0)]
    off = flight.column(FlightLog.POS, 2) - end
    along = end - begin
    length = np.hypot(*along.T)
    across = np.abs(along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0]) / np.where(length > 0.0, length, 1.0)
    distance: FloatArray = np.where(length > 0.0, across, np.hypot(*off.T))
    return distance


def filter_errors(flight: Flight, seed: int) -> dict[str, dict[str, float]]:
    """Compute the RMSE of the angles [deg] and rates [deg/s] of both filters and of the open-loop pendulum.

    Returns
    -------
    dict
        ``ekf``, ``fgdf`` and ``pendulum`` against the truth; for the manoeuvres of section 4.2 also
        ``ekf_potentiometer`` and so on, against the readings at 20 Hz. Values by `SWING_NAMES`.
    """
    truth = flight.column(FlightLog.SWING, 4)
    filters = {
        "ekf": flight.column(FlightLog.EKF, 4),
        "fgdf": flight.column(FlightLog.FGDF, 4),
        "pendulum": open_loop_pendulum(flight),
    }
    errors = {name: _rmse(estimate - truth) for name, estimate in filters.items()}
    if flight.scenario.name.startswith("manoeuvre"):
        read = readings(flight, seed)
        rows = np.searchsorted(flight.t_s, read.t_s)
        measured = np.concatenate([read.angle_rad, read.rate_radps]).T
        errors |= {f"{name}_potentiometer": _rmse(estimate[rows] - measured) for name, estimate in filters.items()}
    return errors


def open_loop_pendulum(flight: Flight) -> FloatArray:
    """Let a pendulum swing below the measured acceleration, from rest: the honest baseline of both filters, (n, 4)."""
    length_m = flight.scenario.vehicle.cable_length_m
    dt_s = DT_S * flight.scenario.control_every
    swing = np.empty((flight.log.shape[0], 4))
    acc = np.ascontiguousarray(flight.column(FlightLog.ACC, 3))
    pendulum.trajectory(swing, acc, dt_s, GRAVITY_MPS2 / length_m, PENDULUM_DAMPING, 1.0 / length_m)
    return swing


def disturbance(flight: Flight) -> dict[str, float]:
    """Compare the EKF's disturbance force with the true one: RMSE, and means where case 2 is steady [N]."""
    true, estimated = flight.column(FlightLog.FORCE, 3), flight.column(FlightLog.EKF, 7)[:, 4:]
    steady = (flight.t_s >= STEADY_S[0]) & (flight.t_s < STEADY_S[1])
    figures = {}
    for axis, name in enumerate("xyz"):
        figures[f"true_rms_{name}"] = float(np.sqrt(np.mean(true[:, axis] ** 2)))
        figures[f"rmse_{name}"] = float(np.sqrt(np.mean((estimated[:, axis] - true[:, axis]) ** 2)))
        figures[f"steady_true_{name}"] = float(true[steady, axis].mean())
        figures[f"steady_estimated_{name}"] = float(estimated[steady, axis].mean())
    return figures


def settled_after_s(flight: Flight) -> float:
    """Give the time after which chi stays under 5 % of what case 1 begins with [s]."""
    above = np.flatnonzero(np.degrees(flight.column(FlightLog.CHI)) > SETTLED_DEG)
    return float(flight.t_s[above[-1]]) if above.size else 0.0


def _integral(flight: Flight, values: FloatArray) -> float:
    return float(np.trapezoid(values, flight.t_s))


def _rmse(errors: FloatArray) -> dict[str, float]:
    return {
        name: degrees(float(np.sqrt(np.mean(column * column))))
        for name, column in zip(SWING_NAMES, errors.T, strict=True)
    }
