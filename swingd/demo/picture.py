"""The two flights of the demonstration as a picture."""

from pathlib import Path

import numpy as np

from swingd.demo.figures import Figures
from swingd.demo.flight import Flight
from swingd.model.estimate import FloatArray

LEAD_S = 3.0


def draw(off: Flight, on: Flight, figures: Figures, path: Path) -> None:
    """Write a picture: total swing, longitudinal swing with its estimate, and velocity, off and on."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    total, angle, velocity = figure.subplots(3, 1, sharex=True)
    for flight, color, name in ((off, "tab:gray", "correction off"), (on, "tab:blue", "correction on")):
        zero_s = flight.steps[0].t_boot_s
        shown = flight.t_boot_s >= zero_s - LEAD_S
        t = flight.t_boot_s[shown] - zero_s
        estimated = flight.estimate_t_s >= zero_s - LEAD_S
        t_est = flight.estimate_t_s[estimated] - zero_s
        xi, zeta = flight.estimate_rad[:, estimated]
        total.plot(t, np.degrees(flight.chi_rad[shown]), color=color, label=f"{name}, true")
        total.plot(
            t_est, np.degrees(np.arccos(np.cos(xi) * np.cos(zeta))), color="tab:red", lw=0.9, ls="--",
            label="estimated" if flight is on else None,
        )  # fmt: skip
        angle.plot(t, np.degrees(flight.angles_rad[1, shown]), color=color, label=f"{name}, true")
        angle.plot(
            t_est, np.degrees(zeta), color="tab:red", lw=0.9, ls="--", label="estimated" if flight is on else None
        )
        velocity.plot(t, flight.vel_ned_mps[0, shown], color=color, label=name)
    reference_t, reference = _reference(on)
    velocity.plot(reference_t, reference, color="black", lw=0.9, ls=":", label="commanded")
    for step in on.steps:
        total.axvline(step.t_boot_s - on.steps[0].t_boot_s + figures.settle_2deg_s_on, color="tab:blue", lw=0.8, ls=":")
    total.axhline(2.0, color="black", lw=0.7, ls=":")
    total.set_ylabel("total swing [deg]")
    angle.set_ylabel("longitudinal swing zeta [deg]")
    velocity.set_ylabel("velocity north [m/s]")
    velocity.set_xlabel("time since the first step [s]")
    total.set_title(
        f"swing RMS {figures.rms_deg_off:.1f} -> {figures.rms_deg_on:.1f} deg, "
        f"under 2 deg after {figures.settle_2deg_s_off:.1f} -> {figures.settle_2deg_s_on:.1f} s, "
        f"estimate within {figures.angle_rmse_deg:.2f} deg RMS",
        fontsize="medium",
    )
    for axis in (total, angle, velocity):
        axis.grid(alpha=0.3)
        axis.legend(loc="upper right", fontsize="small", ncols=3)
    figure.savefig(path, dpi=100)


def _reference(flight: Flight) -> tuple[FloatArray, FloatArray]:
    zero_s = flight.steps[0].t_boot_s
    times, values = [-LEAD_S, 0.0], [0.0, 0.0]
    for step, end_s in zip(flight.steps, flight.step_ends_s, strict=True):
        times += [step.t_boot_s - zero_s, end_s - zero_s]
        values += [step.vel_ned_mps[0], step.vel_ned_mps[0]]
    return np.array(times), np.array(values)
