"""Pictures of a manoeuvre: swing, velocity and the estimate over the truth, for each correction."""

import re
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .flight import Flight
from .plan import Correction
from .record import Step

LEAD_S = 3.0
COLORS = {Correction.OFF: "tab:gray", Correction.ON: "tab:blue", Correction.SHAPED: "tab:green"}


def draw(folder: Path, flights: list[Flight]) -> list[Path]:
    """Draw each manoeuvre of the flights of one scenario; return the files."""
    names = list(dict.fromkeys(step.manoeuvre for flight in flights for step, _ in flight.steps))
    return [_draw(folder, flights, name) for name in names]


def _draw(folder: Path, flights: list[Flight], manoeuvre: str) -> Path:
    figure = Figure(figsize=(11, 4.0 + 2.6 * len(flights) + 2.6), layout="constrained")
    FigureCanvasAgg(figure)
    swing, velocity, *estimates = figure.subplots(2 + len(flights), 1, sharex=True)
    for flight in flights:
        steps = [step for step, _ in flight.steps if step.manoeuvre == manoeuvre]
        if steps:
            _swing(swing, flight, steps)
            _velocity(velocity, flight, steps)
    _commanded(velocity, flights, manoeuvre)
    for axis, flight in zip(estimates, flights, strict=True):
        steps = [step for step, _ in flight.steps if step.manoeuvre == manoeuvre]
        if steps:
            _estimate(axis, flight, steps)
    swing.axhline(2.0, color="black", lw=0.7, ls=":")
    swing.set_ylabel("total swing [deg]")
    velocity.set_ylabel("velocity [m/s]")
    swing.set_title(f"{flights[0].name}: {manoeuvre}", fontsize="medium")
    figure.axes[-1].set_xlabel("time since the first command [s]")
    for axis in figure.axes:
        axis.grid(alpha=0.3)
        axis.legend(loc="upper right", fontsize="small", ncols=3)
    path = folder / f"{flights[0].name}-{re.sub(r'[^a-z0-9.]+', '-', manoeuvre.lower()).strip('-')}.png"
    figure.savefig(path, dpi=90)
    return path


def _shown(flight: Flight, steps: list[Step]) -> tuple[np.ndarray, np.ndarray]:
    """Return which samples of the truth are shown, and when they are."""
    t = flight.truth.t_boot_s
    shown = (t >= steps[0].t_boot_s - LEAD_S) & (t < steps[-1].t_end_s)
    return shown, t[shown] - steps[0].t_boot_s


def _swing(axis: Axes, flight: Flight, steps: list[Step]) -> None:
    shown, t = _shown(flight, steps)
    color = COLORS[flight.correction]
    axis.plot(t, np.degrees(flight.truth.chi_rad[shown]), color=color, label=f"{flight.correction}, true")
    for step, figures in flight.steps:
        if step in steps and figures.settled:
            axis.axvline(step.t_last_s + figures.settle_s - steps[0].t_boot_s, color=color, lw=0.8, ls=":")


def _velocity(axis: Axes, flight: Flight, steps: list[Step]) -> None:
    shown, t = _shown(flight, steps)
    for row, style in ((0, "-"), (1, "--")):
        axis.plot(
            t, flight.truth.vel_ned_mps[row, shown], style, color=COLORS[flight.correction],
            label=f"{flight.correction}, {('north', 'east')[row]}",
        )  # fmt: skip


def _commanded(axis: Axes, flights: list[Flight], manoeuvre: str) -> None:
    steps = [step for step, _ in flights[-1].steps if step.manoeuvre == manoeuvre]
    commanded = np.array([row for step in steps for row in step.velocity])
    if not len(commanded):
        return
    t = np.append(commanded[:, 0], steps[-1].t_end_s) - steps[0].t_boot_s
    for row in (1, 2):
        values = np.append(commanded[:, row], commanded[-1, row])
        axis.step(t, values, where="post", color="black", lw=0.8, ls=":", label="commanded" if row == 1 else None)


def _estimate(axis: Axes, flight: Flight, steps: list[Step]) -> None:
    shown, t = _shown(flight, steps)
    estimate = np.array(flight.flown.estimate).T
    used = (estimate[0] >= steps[0].t_boot_s - LEAD_S) & (estimate[0] < steps[-1].t_end_s)
    for row, (name, color) in enumerate((("xi", "tab:orange"), ("zeta", "tab:purple"))):
        axis.plot(t, np.degrees(flight.truth.angles_rad[row, shown]), color=color, alpha=0.6, label=f"{name}, true")
        axis.plot(
            estimate[0, used] - steps[0].t_boot_s, np.degrees(estimate[1 + row, used]), color="black", lw=0.7, ls="--",
            label="estimated" if row else None,
        )  # fmt: skip
    axis.set_ylabel(f"{flight.correction}: angles [deg]")
