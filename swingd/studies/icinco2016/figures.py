"""Figures 3 to 10 of the paper, drawn from flights of our own."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swingd.core.planar_flight import PlanarFlightLog
from swingd.core.planar_rotorcraft import PlanarState
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.studies.icinco2016 import paper
from swingd.studies.icinco2016.flight import Flight
from swingd.studies.icinco2016.study import Flights
from swingd.studies.pictures import WIDTH_IN, numbered, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Hues that colour-blind readers tell apart, each for one thing in all figures.
TRUE: dict[str, Any] = {"color": "black", "label": "true", "zorder": 2.2}
ESTIMATED: dict[str, Any] = {"color": "#D55E00", "label": "ES-LKF", "lw": 0.9, "zorder": 2.1}
WANTED: dict[str, Any] = {"color": "#CC3377", "label": "wanted", "ls": "--", "zorder": 2.15}
BEFORE: dict[str, Any] = {"color": "#0072B2", "label": "before the torque", "zorder": 2.2}
AFTER: dict[str, Any] = {"color": "black", "label": "from the torque on", "zorder": 2.3}
UNCOMPENSATED: dict[str, Any] = {"color": "0.65", "label": "without, from Figure 8", "lw": 0.9, "zorder": 1.9}
START: dict[str, Any] = {"color": "#0072B2", "marker": "o", "ms": 4.0, "ls": "", "label": "start", "zorder": 2.4}


def draw(
    flights: Flights, folder: Path, suffix: str = "png", watch: Callable[[float], None] = lambda _share: None
) -> list[Path]:
    """Write the pictures, one file each: ``figure03.png`` and so on.

    Parameters
    ----------
    flights : Mapping
        By case and compensation, as `swingd.studies.icinco2016.study.fly_all` gives them.
    folder : Path
        Made where it is missing.
    suffix : str
        ``png`` or ``svg``.
    watch : Callable
        Told the share done, 0..1.

    Returns
    -------
    list of Path
        What was written, by number.

    Raises
    ------
    StudyError
        If a flight that a figure needs is missing, or if the suffix is none of both.
    """
    return save(figures(flights), folder, suffix, watch)


def figures(flights: Flights) -> Iterator[tuple[int, "Figure"]]:
    """Draw one figure after the other, each with its number in the paper; raises as `draw` does."""
    return numbered((number, title, partial(compose, flights)) for number, (title, compose) in _FIGURES.items())


def _states(case: str, variant: str, flights: Flights) -> "Figure":
    """Draw positions, angles, disturbances and the motion in the plane."""
    flight = _flight(flights, case, variant)
    figure = _figure(9.0)
    panels = figure.subplots(4, 2)
    log = PlanarFlightLog
    state, wanted, estimate = (flight.column(first, 3).copy() for first in (log.STATE, log.POS_SP, log.ESTIMATE))
    for values in (state, wanted, estimate):
        values[:, 2] = np.degrees(values[:, 2])
    labels = ("x [m]", "z [m]", r"pitch $\theta$ [deg]")
    for axis, panel in enumerate((panels[0, 0], panels[0, 1], panels[1, 0])):
        _lines(panel, flight, (state[:, axis], TRUE), (estimate[:, axis], ESTIMATED), (wanted[:, axis], WANTED))
        panel.set_ylabel(labels[axis])
    _lines(panels[1, 1], flight, (np.degrees(flight.column(log.STATE + PlanarState.ROD)), TRUE))
    panels[1, 1].set_ylabel(r"rod $\gamma$ [deg]")
    rho, rho_estimate = flight.column(log.RHO, 3), flight.column(log.RHO_ESTIMATE, 3)
    labels = (r"$\rho_x$ [N]", r"$\rho_z$ [N]", r"$\rho_\theta$ [N m]")
    for axis, panel in enumerate((panels[2, 0], panels[2, 1], panels[3, 0])):
        _lines(panel, flight, (rho[:, axis], TRUE), (rho_estimate[:, axis], ESTIMATED))
        panel.set_ylabel(labels[axis])
    _path(panels[3, 1], flight, with_legend=False)
    for panel in (*panels[:3].flat, panels[3, 0]):
        panel.set_xlabel("time [s]")
    figure.align_ylabels()
    entries: dict[str, Any] = {}
    for panel in (panels[0, 0], panels[3, 1]):
        handles, names = panel.get_legend_handles_labels()
        for name, handle in zip(names, handles, strict=True):
            entries.setdefault(name, handle)
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=3)
    return figure


def _motion(variant: str, flights: Flights) -> "Figure":
    """Draw the circle; with compensation beside the one without."""
    figure = _figure(6.2)
    panel = figure.subplots()
    if variant == "both":
        without = _flight(flights, "circle_torque", "translational")
        panel.plot(*without.column(PlanarFlightLog.STATE, 2).T, **UNCOMPENSATED)
    _path(panel, _flight(flights, "circle_torque", variant), with_legend=True)
    panel.set_aspect("equal", adjustable="datalim")
    return figure


_FIGURES: dict[int, tuple[str, Callable[[Flights], "Figure"]]] = {
    3: ("Regulation without compensation", partial(_states, "regulation", "none")),
    4: ("Regulation with compensation in both layers", partial(_states, "regulation", "both")),
    5: (
        "Regulation with torque, no compensation in the rotational layer",
        partial(_states, "regulation_torque", "translational"),
    ),
    6: ("Regulation with torque, compensation in both layers", partial(_states, "regulation_torque", "both")),
    7: (
        "Circle with torque, no compensation in the rotational layer",
        partial(_states, "circle_torque", "translational"),
    ),
    8: ("Circle with torque, no compensation in the rotational layer", partial(_motion, "translational")),
    9: ("Circle with torque, compensation in both layers", partial(_states, "circle_torque", "both")),
    10: ("Circle with torque, compensation in both layers", partial(_motion, "both")),
}
"""Number in the paper, title, and what draws it."""


def _flight(flights: Flights, case: str, variant: str) -> Flight:
    try:
        return flights[case, variant]
    except KeyError:
        given = ", ".join(f"{a}/{b}" for a, b in flights) or "none"
        raise StudyError(f"no flight {case}/{variant}: a figure of the study shows it; given are {given}") from None


def _lines(panel: "Axes", flight: Flight, *drawn: tuple[FloatArray, dict[str, Any]]) -> None:
    for values, style in drawn:
        panel.plot(flight.t_s, values, **style)


def _path(panel: "Axes", flight: Flight, with_legend: bool) -> None:
    """Draw the motion in the plane, split where the torque sets in, if it does."""
    path, wanted = flight.column(PlanarFlightLog.STATE, 2), flight.column(PlanarFlightLog.POS_SP, 2)
    if flight.scenario.torque_nm:
        split = int(np.searchsorted(flight.t_s, paper.TORQUE_AT_S))
        panel.plot(*path[: split + 1].T, **BEFORE)
        panel.plot(*path[split:].T, **AFTER)
    else:
        panel.plot(*path.T, **TRUE)
    # A point that is wanted is one, not a line without length; a line is broad, so that it shows below the flown one.
    point = flight.scenario.circle_hz == 0.0
    shape = {"ls": "", "marker": "x"} if point else {"ls": "-", "lw": 3.5, "alpha": 0.35, "zorder": 1.8}
    panel.plot(*wanted.T, **(WANTED | shape))
    panel.plot(*path[:1].T, **START)
    panel.set(xlabel="x [m]", ylabel="z [m]")
    panel.margins(0.08)
    if with_legend:
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3)


def _figure(height_in: float) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
