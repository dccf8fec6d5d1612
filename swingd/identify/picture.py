"""Measured against fitted side force as a picture."""

import math
from pathlib import Path

import numpy as np

from swingd.identify.identification import Identification


def draw(identification: Identification, title: str, path: Path) -> None:
    """Write a picture: force across the thrust measured and fitted, what is left, and the swing.

    Without a fit the picture says why.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 9), layout="constrained")
    FigureCanvasAgg(figure)
    fit = identification.fit
    if fit is None:
        figure.text(0.5, 0.5, identification.length.note, ha="center")
    else:
        axes = figure.subplots(4, 1, sharex=True)
        for index, segment in enumerate(fit.segments):
            t, fitted = segment.t_boot_s, fit.side_force_frd_n(index)
            first = index == 0
            for axis in range(2):
                measured = segment.side_force_frd_n[:, axis]
                axes[axis].plot(t, measured, color="0.6", lw=0.9, label="measured" if first else None)
                axes[axis].plot(t, fitted[:, axis], color="tab:red", lw=1.0, label="fitted" if first else None)
                color, name = ("tab:blue", "forward") if axis == 0 else ("tab:orange", "right")
                axes[2].plot(t, measured - fitted[:, axis], color=color, lw=0.7, label=name if first else None)
            axes[3].plot(t, np.degrees(fit.swing_rad(index)), color="black", lw=0.9)
            for axis_ in axes:
                axis_.axvline(t[0], color="0.85", lw=0.6, zorder=0)
        for axis_, label in zip(axes, ("forward [N]", "right [N]", "residual [N]", "swing, fitted [deg]"), strict=True):
            axis_.set_ylabel(label)
            axis_.grid(alpha=0.3)
        for axis_ in axes[:3]:
            axis_.legend(loc="upper right", ncols=2, fontsize="small")
        axes[0].set_title(
            f"force across the thrust's axis; swing {math.degrees(fit.swing_rms_rad):.1f} deg RMS, "
            f"{fit.residual_rms_n:.2g} N RMS left",
            fontsize="medium",
        )
        axes[-1].set_xlabel("autopilot's boot time [s]")
    figure.suptitle(title)
    figure.savefig(path, dpi=100)
