"""Estimate against truth, with the open-loop pendulum beside it."""

import itertools
from dataclasses import dataclass

import numpy as np

from swingd.core import pendulum as kernels
from swingd.core.level import level_from_frd
from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.errors import LogFormatError
from swingd.model.estimate import FloatArray
from swingd.model.parameters import Parameters
from swingd.record.truth import SwingTruth
from swingd.replay.runner import Replay

PENDULUM_DAMPING_RATIOS = (0.01, 0.03, 0.06, 0.1, 0.2, 0.3)
PENDULUM_HIGH_PASS_HZ = (0.0, 0.02, 0.05, 0.1, 0.2)
"""The baseline is the best of all pairs, for each axis on its own."""
PENDULUM_LEAD_S = 1.0
"""The baseline starts at rest this long before the first row that is compared: before that the load may lie."""


@dataclass(frozen=True, slots=True)
class AxisFigures:
    """One angle over the rows where the truth is valid."""

    rmse_deg: float
    mean_error_deg: float
    correlation: float
    rate_rmse_deg_s: float
    true_std_deg: float
    pendulum_rmse_deg: float
    """Of the best open-loop pendulum."""

    @property
    def ratio(self) -> float:
        """Error over the baseline's."""
        return self.rmse_deg / self.pendulum_rmse_deg


@dataclass(frozen=True, slots=True)
class Comparison:
    """Estimate against truth."""

    xi: AxisFigures
    """Lateral."""
    zeta: AxisFigures
    """Longitudinal."""
    rows: int
    """Rows of the estimate that were compared."""
    t_boot_s: FloatArray
    """(n,) their times."""
    true_rad: FloatArray
    """(2, n) xi, zeta."""
    estimated_rad: FloatArray
    """(2, n)."""
    std_rad: FloatArray
    """(2, n) the filter's own."""
    pendulum_rad: FloatArray
    """(2, n) the best pendulum of each axis."""


def compare(run: Replay, parameters: Parameters, truth: SwingTruth) -> Comparison:
    """Compare the estimate with the truth.

    Raises
    ------
    LogFormatError
        If log and truth have no time in common.
    """
    reports = run.reports
    t = np.array([report.t_boot_s for report in reports])
    angles = np.array([[report.xi_rad, report.zeta_rad] for report in reports]).reshape(-1, 2).T
    rates = np.array([[report.xi_rate_radps, report.zeta_rate_radps] for report in reports]).reshape(-1, 2).T
    stds = np.array([[report.xi_std_rad, report.zeta_std_rad] for report in reports]).reshape(-1, 2).T
    # A row counts where the truth is valid on both sides of it.
    after = np.clip(np.searchsorted(truth.t_boot_s, t), 1, len(truth.t_boot_s) - 1)
    inside = (t >= truth.t_boot_s[0]) & (t <= truth.t_boot_s[-1])
    used = inside & truth.valid[after] & truth.valid[after - 1]
    if not used.any():
        raise LogFormatError(
            f"log and truth have no valid time in common: the log covers {_span(t)}, the truth {_span(truth.t_boot_s)}"
        )
    t, angles, rates, stds = t[used], angles[:, used], rates[:, used], stds[:, used]
    true = np.array([np.interp(t, truth.t_boot_s, angle) for angle in (truth.xi_rad, truth.zeta_rad)])
    true_rates = np.array([np.interp(t, truth.t_boot_s, rate) for rate in (truth.xi_rate_radps, truth.zeta_rate_radps)])
    best: list[FloatArray | None] = [None, None]
    best_rmse = [np.inf, np.inf]
    for angle in _pendulums(run, parameters, t[0] - PENDULUM_LEAD_S):
        candidate = angle(t)
        for axis in range(2):
            rmse = _rms(candidate[axis] - true[axis])
            if rmse < best_rmse[axis]:
                best[axis], best_rmse[axis] = candidate[axis], rmse
    figures = [
        AxisFigures(
            rmse_deg=float(np.degrees(_rms(angles[axis] - true[axis]))),
            mean_error_deg=float(np.degrees((angles[axis] - true[axis]).mean())),
            correlation=_correlation(angles[axis], true[axis]),
            rate_rmse_deg_s=float(np.degrees(_rms(rates[axis] - true_rates[axis]))),
            true_std_deg=float(np.degrees(true[axis].std())),
            pendulum_rmse_deg=float(np.degrees(best_rmse[axis])),
        )
        for axis in range(2)
    ]
    pendulum = np.array([np.full_like(t, np.nan) if curve is None else curve for curve in best])
    return Comparison(figures[0], figures[1], len(t), t, true, angles, stds, pendulum)


class _PendulumAngles:
    """One pendulum's direction in the level frame and the heading in it, to be read at any time."""

    def __init__(self, t_s: FloatArray, direction: FloatArray, yaw_rad: FloatArray) -> None:
        self._t_s, self._direction, self._yaw_rad = t_s, direction, yaw_rad

    def __call__(self, t_s: FloatArray) -> FloatArray:
        """Return (2, n) xi, zeta of the heading frame [rad]."""
        x, y = (np.interp(t_s, self._t_s, part) for part in self._direction)
        yaw = np.interp(t_s, self._t_s, self._yaw_rad)
        ahead = np.cos(yaw) * x + np.sin(yaw) * y
        right = -np.sin(yaw) * x + np.cos(yaw) * y
        down = np.sqrt(np.clip(1.0 - x * x - y * y, 1e-6, None))
        return np.array([np.arctan2(-right, down), np.arcsin(np.clip(ahead, -1.0, 1.0))])


def _pendulums(run: Replay, parameters: Parameters, start_s: float) -> "list[_PendulumAngles]":
    """Every pendulum of the baseline, at rest at ``start_s``, driven by what the IMU and the attitude tell."""
    t, acc, yaw = _level_acceleration(run)
    t, acc, yaw = t[t >= start_s], acc[t >= start_s], yaw[t >= start_s]
    dt = np.diff(t, prepend=t[0])
    dt[(dt <= 0.0) | (dt > parameters.estimator.max_gap_s)] = 0.0
    length_m = parameters.cable.length_m
    curves = []
    for damping_ratio, high_pass_hz in itertools.product(PENDULUM_DAMPING_RATIOS, PENDULUM_HIGH_PASS_HZ):
        x = np.zeros(4)
        slow = np.zeros(2)
        direction = np.empty((2, len(t)))
        for i in range(len(t)):
            if dt[i] > 0.0:
                slow += (1.0 - np.exp(-2.0 * np.pi * high_pass_hz * dt[i])) * (acc[i] - slow)
                kernels.step(x, acc[i] - slow, dt[i], GRAVITY_MPS2 / length_m, damping_ratio, 1.0 / length_m)
            direction[0, i] = np.sin(x[1])
            direction[1, i] = -np.sin(x[0]) * np.cos(x[1])
        curves.append(_PendulumAngles(t, direction, yaw))
    return curves


def _level_acceleration(run: Replay) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (n,), horizontal acceleration in a north-aligned level frame (n, 2) and yaw in it (n,)."""
    t = np.array([imu.t_boot_s for imu in run.imu])
    force = np.array([imu.acc_frd_mps2 for imu in run.imu])
    # An autopilot that restarted counts from zero again; the longest life is the flight.
    starts = np.flatnonzero(np.diff(t) < 0.0) + 1
    pieces = np.split(np.arange(len(t)), starts)
    kept = max(pieces, key=len)
    t, force = t[kept], force[kept]
    attitude_t = np.array([attitude.t_boot_s for attitude in run.attitudes])
    order = np.argsort(attitude_t, kind="stable")
    roll, pitch, yaw = (
        np.interp(t, attitude_t[order], np.unwrap(np.array([getattr(a, name) for a in run.attitudes])[order]))
        for name in ("roll_rad", "pitch_rad", "yaw_rad")
    )
    acc = np.empty((len(t), 2))
    rotation = np.empty((3, 3))
    for i in range(len(t)):
        level_from_frd(rotation, roll[i], pitch[i], yaw[i])
        acc[i] = (rotation @ force[i])[:2]
    return t, acc, yaw


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values)))


def _correlation(a: FloatArray, b: FloatArray) -> float:
    if a.std() == 0.0 or b.std() == 0.0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def _span(t: FloatArray) -> str:
    return f"{t[0]:.2f} to {t[-1]:.2f} s" if len(t) else "nothing"
