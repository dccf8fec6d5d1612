"""Estimate, truth and baseline as a picture."""

from pathlib import Path

import numpy as np

from swingd.replay.compare import Comparison


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
