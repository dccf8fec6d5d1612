"""Figures 3 to 6 of the paper, drawn from flights of our own."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swingd.core.slts_flight_layout import SltsFlightLog
from swingd.model.errors import StudyError
from swingd.studies.pictures import WIDTH_IN, numbered, save
from swingd.studies.slts import paper
from swingd.studies.slts.flight import Flight
from swingd.studies.slts.indicators import SETTLED_S, size
from swingd.studies.slts.study import Flights

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Hues that colour-blind readers tell apart, each for one thing in all figures.
LATERAL: dict[str, Any] = {"color": "#0072B2", "label": "lateral"}
VERTICAL: dict[str, Any] = {"color": "#E69F00", "label": "vertical"}
FLOWN: dict[str, Any] = {"color": "black", "lw": 1.1, "label": "load"}
PATH: dict[str, Any] = {"color": "#CC3377", "lw": 0.9, "ls": "--", "label": "path"}
GP_EKF: dict[str, Any] = {"color": "#D55E00", "label": "GP-EKF", "zorder": 2.3}
EKF: dict[str, Any] = {"color": "#009E73", "label": "EKF", "lw": 0.9, "zorder": 2.2}
CAMERA: dict[str, Any] = {"color": "0.75", "label": "camera, last picture held", "lw": 0.8}
SIGMA: dict[str, Any] = {"color": "0.4", "lw": 0.8, "ls": ":", "label": "3 sigma"}
GUIDE: dict[str, Any] = {"color": "0.4", "lw": 0.8, "ls": ":"}
SHOWN_S = 60.0
"""What the figure of the filters shows of the square."""


def draw(
    flights: Flights, folder: Path, suffix: str = "png", watch: Callable[[float], None] = lambda _share: None
) -> list[Path]:
    """Write the pictures, one file each: ``figure03.png`` and so on.

    Raises
    ------
    StudyError
        If a flight that a figure needs is missing, or if the suffix is neither ``png`` nor ``svg``.
    """
    return save(figures(flights), folder, suffix, watch)


def figures(flights: Flights) -> Iterator[tuple[int, "Figure"]]:
    """Draw one figure after the other, each with its number in the paper; raises as `draw` does."""
    missing = [name for _, name in _FIGURES.values() if name not in flights]
    if missing:
        given = ", ".join(flights) or "none"
        raise StudyError(f"no flight {missing[0]}: a figure of the study shows it; given are {given}")
    return numbered(
        (number, title, partial(_filters if number == _FILTERS else _following, flights[name]))
        for number, (title, name) in _FIGURES.items()
    )


def _following(flight: Flight) -> "Figure":
    """Plan and swing seen from above, beside the errors of the path, the swing and their rates."""
    figure = _figure(6.4)
    grid = figure.add_gridspec(4, 2, width_ratios=(0.42, 0.58))
    plan, swing = figure.add_subplot(grid[:2, 0]), figure.add_subplot(grid[2:, 0])
    axes = [figure.add_subplot(grid[row, 1]) for row in range(4)]
    for axis in axes[:-1]:
        axis.sharex(axes[-1])
        axis.tick_params(labelbottom=False)
    way = np.array(flight.scenario.waypoints_ned_m)
    load = flight.column(SltsFlightLog.TRUE, 3)
    plan.plot(way[:, 1], way[:, 0], **PATH)
    plan.plot(load[:, 1], load[:, 0], **FLOWN)
    plan.plot(load[0, 1], load[0, 0], "o", color="black", ms=4)
    plan.set(xlabel="east [m]", ylabel="north [m]", title="a) plan")
    plan.set_aspect("equal", adjustable="datalim")
    _legend(plan)
    r_n, r_e = flight.column(SltsFlightLog.TRUE + 3, 2).T
    swing.plot(r_e, r_n, **(FLOWN | {"lw": 0.7}))
    swing.set(xlabel="east [m]", ylabel="north [m]", title="c) vehicle over the load, r")
    swing.set_aspect("equal", adjustable="datalim")
    error = flight.column(SltsFlightLog.TRUE_E_P, 3)
    printed = paper.VALUES[flight.scenario.name]
    _lines(axes[0], flight, (size(error[:, :2]), LATERAL), (np.abs(error[:, 2]), VERTICAL), legend=True)
    axes[0].axhline(printed["lateral_max"], **GUIDE)
    axes[0].set(ylabel=r"$|e_p|$ [m]", title="b)")
    _lines(axes[1], flight, (size(flight.column(SltsFlightLog.TRUE_E_V, 3)), LATERAL))
    axes[1].axhline(printed["velocity_error_max"], **GUIDE)
    axes[1].set_ylabel(r"$|e_v|$ [m/s]")
    true = flight.column(SltsFlightLog.TRUE, 10)
    _lines(axes[2], flight, (size(true[:, 3:5]), LATERAL))
    _lines(axes[3], flight, (size(true[:, 8:10]), LATERAL))
    for axis, index, label in ((axes[2], "swing_max", r"$|r|$ [m]"), (axes[3], "swing_rate_max", r"$|v|$ [m/s]")):
        if index in printed:
            axis.axhline(printed[index], **GUIDE)
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0.0)
    axes[3].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    return figure


def _filters(flight: Flight) -> "Figure":
    """Errors of r with their envelopes, and their size beside the camera's."""
    figure = _figure(6.4)
    axes = list(figure.subplots(3, 1, sharex=True))
    shown = (flight.t_s > SETTLED_S) & (flight.t_s < SETTLED_S + SHOWN_S)
    t_s = flight.t_s[shown]
    true = flight.column(SltsFlightLog.TRUE, 10)[shown]
    error = flight.column(SltsFlightLog.GP_EKF, 10)[shown] - true
    std = np.sqrt(flight.column(SltsFlightLog.GP_EKF_VAR, 10)[shown])
    for j, name in enumerate(("north", "east")):
        axes[j].plot(t_s, error[:, 3 + j], **GP_EKF)
        axes[j].plot(t_s, 3.0 * std[:, 3 + j], **SIGMA)
        axes[j].plot(t_s, -3.0 * std[:, 3 + j], **(SIGMA | {"label": None}))
        axes[j].set_ylabel(f"error of r, {name} [m]")
    _legend(axes[0])
    axes[0].set_title("a)")
    axes[2].plot(t_s, size(flight.column(SltsFlightLog.CAMERA, 2)[shown] - true[:, 3:5]), **CAMERA)
    axes[2].plot(t_s, size(flight.column(SltsFlightLog.EKF, 10)[shown, 3:5] - true[:, 3:5]), **EKF)
    axes[2].plot(t_s, size(error[:, 3:5]), **GP_EKF)
    axes[2].set(ylabel="size of the error [m]", xlabel="time [s]", title="b)")
    axes[2].set_ylim(bottom=0.0)
    _legend(axes[2])
    return figure


_FILTERS = 5
_FIGURES = {
    3: ("Square of 80 m: path, errors and swing; dotted: the paper's maxima", "square"),
    4: ("Circle of 15 m: path, errors and swing; dotted: the paper's maxima", "circle"),
    5: ("Relative position of the load by GP-EKF and camera, square", "square"),
    6: ("Square of 10 m, thrust 15 % below the model; dotted: the paper's maxima", "outdoor"),
}
"""Number in the paper, title, and the flight that it shows."""


def _lines(axis: "Axes", flight: Flight, *lines: tuple[Any, dict[str, Any]], legend: bool = False) -> None:
    for values, style in lines:
        axis.plot(flight.t_s, values, **style)
    if legend:
        _legend(axis)


def _legend(axis: "Axes") -> None:
    """Put it above the panel, where it hides no line."""
    _, labels = axis.get_legend_handles_labels()
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=len(labels))


def _figure(height_in: float) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
