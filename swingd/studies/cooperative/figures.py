"""Figures 4 to 8, 11 and 12 of the paper, drawn from flights of our own."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swingd.core.cooperative_flight import LoadLog
from swingd.model.estimate import FloatArray
from swingd.studies.cooperative.study import Study, heading_direction
from swingd.studies.pictures import WIDTH_IN, numbered, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUE: dict[str, Any] = {"color": "black", "label": "true", "zorder": 2.4}
PAPER: dict[str, Any] = {"color": "#0072B2", "label": "paper's filter, corrected", "lw": 1.0, "zorder": 2.1}
OURS: dict[str, Any] = {"color": "#D55E00", "label": "ours", "lw": 1.0, "zorder": 2.3}
WANTED: dict[str, Any] = {"color": "0.6", "label": "wanted", "ls": ":", "zorder": 2.0}
ESTIMATES = (("paper", PAPER), ("ours", OURS))
SIDES = ("left", "right")


def draw(
    study: Study, folder: Path, suffix: str = "png", watch: Callable[[float], None] = lambda _share: None
) -> list[Path]:
    """Write the pictures, one file each: ``figure04.png`` and so on.

    Parameters
    ----------
    study : Study
    folder : Path
        Made where it is missing.
    suffix : str
        ``png`` or ``svg``.
    watch : Callable
        Told the share done, 0..1.

    Returns
    -------
    list of Path

    Raises
    ------
    StudyError
        If the suffix is none of both.
    """
    return save(figures(study), folder, suffix, watch)


def figures(study: Study) -> Iterator[tuple[int, "Figure"]]:
    """Draw one figure after the other, each with its number in the paper."""
    return numbered((number, title, partial(compose, study)) for number, (title, compose) in _FIGURES.items())


def tether_angles(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give inclination and phi_b of (1) [deg] of directions in a heading frame (n, 3), from the right to the nose."""
    inclination = np.degrees(np.arctan2(np.hypot(direction[:, 0], direction[:, 1]), direction[:, 2]))
    # phi_abs = psi + phi_b + pi/2 from north to east, unwrapped so that it shows no jumps of a whole turn.
    azimuth = np.degrees(np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]) - 0.5 * np.pi))
    return inclination, azimuth


def _tethers(case: str, study: Study) -> "Figure":
    flight, tracks = study.cases[case].flight, study.cases[case].tracks
    figure, axes = _panels(2, 2)
    for index, side in enumerate(SIDES):
        shown = [(heading_direction(flight, index), TRUE)]
        shown += [(tracks[name].directions[index], style) for name, style in ESTIMATES]
        for row, symbol in enumerate((r"\theta_s", r"\phi_b")):
            axis = axes[2 * row + index]
            for direction, style in shown:
                axis.plot(flight.t_s, _near(tether_angles(direction)[row], index, row), **style)
            axis.set_ylabel(f"{side} ${symbol}$ [deg]")
    _legend(figure, axes[0])
    return figure


def _near(angle_deg: FloatArray, index: int, row: int) -> FloatArray:
    """Shift an azimuth by whole turns towards where the tether of this side rests."""
    if row == 0:
        return angle_deg
    rest_deg = 0.0 if index == 0 else -180.0
    shifted: FloatArray = angle_deg - 360.0 * np.round((angle_deg[-1] - rest_deg) / 360.0)
    return shifted


def _attitude(case: str, study: Study) -> "Figure":
    flight, tracks = study.cases[case].flight, study.cases[case].tracks
    figure, axes = _panels(3)
    for column, (axis, name) in enumerate(zip(axes, ("roll", "pitch", "yaw"), strict=True)):
        axis.plot(flight.t_s, np.degrees(flight.course[:, 3 + column]), **WANTED)
        axis.plot(flight.t_s, np.degrees(flight.load(LoadLog.EULER)[:, column]), **TRUE)
        for estimate, style in ESTIMATES:
            axis.plot(flight.t_s, np.degrees(tracks[estimate].euler_rad[:, column]), **style)
        axis.set_ylabel(f"{name} [deg]")
    _legend(figure, axes[0])
    return figure


def _position(case: str, study: Study) -> "Figure":
    figure, axes = _panels(3)
    _positions(axes, case, study)
    _legend(figure, axes[0])
    return figure


def _positions(axes: "list[Axes]", case: str, study: Study) -> None:
    flight, tracks = study.cases[case].flight, study.cases[case].tracks
    for column, (axis, name) in enumerate(zip(axes, "xyz", strict=True)):
        axis.plot(flight.t_s, flight.course[:, column], **WANTED)
        axis.plot(flight.t_s, flight.load(LoadLog.POS)[:, column], **TRUE)
        for estimate, style in ESTIMATES:
            axis.plot(flight.t_s, tracks[estimate].pos_ned_m[:, column], **style)
        axis.set_ylabel(f"{name} [m]")


def _experiment(study: Study) -> "Figure":
    flight, tracks = study.cases["experiment"].flight, study.cases["experiment"].tracks
    figure, axes = _panels(3, 2)
    for column, (axis, name) in enumerate(zip(axes[::2], ("roll", "pitch", "yaw"), strict=True)):
        axis.plot(flight.t_s, np.degrees(flight.load(LoadLog.EULER)[:, column]), **TRUE)
        for estimate, style in ESTIMATES:
            axis.plot(flight.t_s, np.degrees(tracks[estimate].euler_rad[:, column]), **style)
        axis.set_ylabel(f"{name} [deg]")
    _positions(axes[1::2], "experiment", study)
    _legend(figure, axes[1])
    return figure


def _hover(study: Study) -> "Figure":
    hover = study.hover
    figure, (stand, battery) = _panels(1, 2, height_in=3.2)
    for voltage_v in sorted(set(hover.curve.voltage_v.tolist()), reverse=True):
        rows = hover.curve.voltage_v == voltage_v
        stand.plot(100.0 * hover.curve.throttle[rows], hover.curve.thrust_n[rows], ".", ms=4, label=f"{voltage_v:g} V")
    throttle = np.linspace(0.0, 1.0, 51)
    for voltage_v in (hover.voltage_v[0], hover.voltage_v[-1]):
        curve = hover.curve.thrust_at(throttle, np.full_like(throttle, voltage_v))
        stand.plot(100.0 * throttle, curve, color="0.4", lw=0.9, zorder=1.9)
    stand.set(xlabel="throttle [%]", ylabel="thrust on the stand, all rotors [N]", title="a)")
    stand.legend(loc="upper left")
    battery.axhline(hover.needed_n, **{**TRUE, "label": "weight"})
    battery.plot(hover.voltage_v, hover.compensated_n, **{**OURS, "label": "curve with the voltage"})
    battery.plot(hover.voltage_v, hover.uncompensated_n, **{**PAPER, "label": "curve without"})
    battery.set(xlabel="voltage [V]", ylabel="thrust in hover [N]", title="b)")
    battery.invert_xaxis()
    battery.legend(loc="upper left")
    return figure


_FIGURES: dict[int, tuple[str, Callable[[Study], "Figure"]]] = {
    4: ("Tether angles, attitude manoeuvre without noise", partial(_tethers, "attitude")),
    5: ("Attitude of the load, attitude manoeuvre without noise", partial(_attitude, "attitude")),
    6: ("Tether angles, position manoeuvre without noise", partial(_tethers, "position")),
    7: ("Position of the load, position manoeuvre without noise", partial(_position, "position")),
    8: ("Thrust curve from the stand, and hover over a full battery", _hover),
    11: ("Tether angles, experiment", partial(_tethers, "experiment")),
    12: ("Attitude and position of the load, experiment", _experiment),
}
"""Number in the paper, title, and what draws it."""


def _legend(figure: "Figure", axis: "Axes") -> None:
    """Put one for all panels below them."""
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def _panels(rows: int, columns: int = 1, height_in: float | None = None) -> "tuple[Figure, list[Axes]]":
    """Return a figure and its panels, row by row, with time below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in or 1.6 + 1.6 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=rows > 1)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.align_ylabels()
    return figure, list(axes.flat)
