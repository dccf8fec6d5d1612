"""Estimate, truth and baseline as a picture."""

from pathlib import Path

import numpy as np

from swingd.replay.compare import Comparison
from swingd.replay.runner import Replay


def draw(comparison: Comparison, title: str, path: Path) -> None:
    """Write a picture: both angles true, estimated and by the open-loop pendulum, and the errors with 2 sigma."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 9), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 1, sharex=True)
    t = comparison.t_boot_s
    names = (("lateral", "xi", comparison.xi), ("longitudinal", "zeta", comparison.zeta))
    for axis, (side, symbol, figures) in enumerate(names):
        angle, error = axes[2 * axis], axes[2 * axis + 1]
        angle.plot(t, np.degrees(comparison.pendulum_rad[axis]), color="0.75", lw=0.8, label="open-loop pendulum")
        angle.plot(t, np.degrees(comparison.true_rad[axis]), color="black", lw=1.2, label="true")
        angle.plot(t, np.degrees(comparison.estimated_rad[axis]), color="tab:red", lw=1.0, ls="--", label="swingd")
        angle.set_ylabel(f"{symbol} [deg]")
        angle.legend(loc="upper right", ncols=3, fontsize="small")
        angle.set_title(
            f"{side}: RMSE {figures.rmse_deg:.2f} deg, pendulum {figures.pendulum_rmse_deg:.2f} deg", fontsize="medium"
        )
        difference = np.degrees(comparison.estimated_rad[axis] - comparison.true_rad[axis])
        error.fill_between(
            t,
            -2.0 * np.degrees(comparison.std_rad[axis]),
            2.0 * np.degrees(comparison.std_rad[axis]),
            color="tab:red",
            alpha=0.15,
            label="2 sigma of the filter",
        )
        error.plot(t, difference, color="tab:red", lw=0.8)
        error.set_ylabel("error [deg]")
        error.legend(loc="upper right", fontsize="small")
    for axis_ in axes:
        axis_.grid(alpha=0.3)
    axes[-1].set_xlabel("autopilot's boot time [s]")
    figure.suptitle(title)
    figure.savefig(path, dpi=100)


def draw_estimate(run: Replay, title: str, path: Path) -> None:
    """Write a picture of a flight whose true swing nobody knows: both angles with 2 sigma, and the health."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 1, sharex=True)
    t = np.array([report.t_boot_s for report in run.reports])
    for axis, name, angle, std in (
        (axes[0], "lateral xi", "xi_rad", "xi_std_rad"),
        (axes[1], "longitudinal zeta", "zeta_rad", "zeta_std_rad"),
    ):
        degrees = np.degrees([getattr(report, angle) for report in run.reports])
        band = 2.0 * np.degrees([getattr(report, std) for report in run.reports])
        axis.fill_between(t, degrees - band, degrees + band, color="tab:red", alpha=0.15, label="2 sigma of the filter")
        axis.plot(t, degrees, color="tab:red", lw=1.0, label="swingd")
        axis.set_ylabel(f"{name} [deg]")
        axis.legend(loc="upper right", ncols=2, fontsize="small")
        axis.grid(alpha=0.3)
        swing = np.abs(degrees).max(initial=1.0)
        axis.set_ylim(-1.5 * swing, 1.5 * swing)
    axes[-1].set_xlabel("autopilot's boot time [s]")
    figure.suptitle(title)
    figure.savefig(path, dpi=100)
