"""Figures 4 to 16 and 18 to 21 of the paper, drawn from flights of our own."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swingd.core.slung_flight import FlightLog
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.studies.drones2023.flight import Flight
from swingd.studies.drones2023.indicators import SETTLED_DEG, track_distance_m
from swingd.studies.drones2023.potentiometer import readings
from swingd.studies.drones2023.study import Flights
from swingd.studies.pictures import WIDTH_IN, numbered, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POTENTIOMETER_SEED = 1
"""Of the readings' noise; another draw than the tables' where these begin with another seed."""
DETAIL_S = 20.0
"""What the enlarged panels show."""
TO_WAYPOINT_4 = 3
"""Leg whose flight swings the load most to the side."""
SIGN_MEAN_S = 1.0
"""Over which the sign of the accelerations' product is averaged."""

# Hues that colour-blind readers tell apart, each for one thing in all figures.
TRUE: dict[str, Any] = {"color": "black", "label": "true", "zorder": 2.2}
POTENTIOMETER: dict[str, Any] = {"color": "black", "lw": 1.0, "label": "potentiometer", "zorder": 2.2}
FLOWN: dict[str, Any] = {"color": "black", "label": "flown"}
EKF: dict[str, Any] = {"color": "#D55E00", "label": "EKF", "lw": 1.1, "zorder": 2.3}
FGDF: dict[str, Any] = {"color": "#0072B2", "label": "FGDF", "lw": 1.0, "zorder": 2.1}
SET_POINT: dict[str, Any] = {"color": "#CC3377", "label": "set-point", "ls": "--"}
OFF: dict[str, Any] = {"color": "0.6", "label": "no payload controller"}
ON: dict[str, Any] = {"color": "#009E73", "label": "payload controller (16)"}
DEFAULT: dict[str, Any] = {"color": "#7B4FA3", "label": "default law", "lw": 0.8}
NED: tuple[dict[str, Any], ...] = (
    {"color": "#E69F00", "label": "north"},
    {"color": "#56B4E9", "label": "east"},
    {"color": "#555555", "label": "down"},
)
GUIDE: dict[str, Any] = {"color": "0.4", "lw": 0.8, "ls": ":"}

_SYMBOLS = (r"\xi", r"\zeta")


def draw(
    flights: Flights, folder: Path, suffix: str = "png", watch: Callable[[float], None] = lambda _share: None
) -> list[Path]:
    """Write the pictures, one file each: ``figure04.png`` and so on.

    Parameters
    ----------
    flights : Mapping
        By case and variant: ``off``, without payload controller, of all; ``on``, (16) on the EKF, of the cases 1 and
        2. ``default``, the daemon's own law, is drawn beside them in case 1 where it is given.
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


def _position_error(flights: Flights) -> "Figure":
    flight = _flight(flights, "case1", "off")
    figure, (axis,) = _panels(1)
    _components(axis, flight, flight.column(FlightLog.REFERENCE, 3) - flight.column(FlightLog.POS, 3))
    axis.set_ylabel("set-point minus position [m]")
    return figure


def _swing_state(flights: Flights) -> "Figure":
    flight = _flight(flights, "case1", "off")
    figure, axes = _panels(2, 2)
    for j, axis in enumerate(axes):
        # Row by row: an angle and its rate.
        side, rate = divmod(j, 2)
        _swing(axis, flight, 2 * rate + side, (TRUE, EKF))
        axis.set_title(f"{'abcd'[j]})")
    _legend(axes[1])
    return figure


def _damping(flights: Flights) -> "Figure":
    figure, (angle, rate) = _panels(2)
    for flight, style in _laws(flights):
        angle.plot(flight.t_s, np.degrees(flight.column(FlightLog.CHI)), **style)
        rate.plot(flight.t_s, np.degrees(flight.column(FlightLog.CHI_RATE)), **style)
    angle.axhline(SETTLED_DEG, **GUIDE, label="5% of the start")
    angle.set_ylim(bottom=0.0)
    angle.set_ylabel(r"swing angle $\chi$ [deg]")
    rate.set_ylabel(r"swing rate $\nu$ [deg/s]")
    _legend(angle)
    return figure


def _opposition(flights: Flights) -> "Figure":
    flight = _flight(flights, "case1", "on")
    figure, (sign, distance) = _panels(2)
    product = np.sum(flight.column(FlightLog.ACC_VC, 3) * flight.column(FlightLog.ACC_PC, 3), axis=1)
    # Where both are small the noise decides the sign, many times a second; its mean shows what remains.
    samples = min(round(SIGN_MEAN_S / (flight.t_s[1] - flight.t_s[0])), product.size)
    mean = np.convolve(np.sign(product), np.ones(samples) / samples, mode="valid")
    first = (product.size - mean.size) // 2
    sign.plot(flight.t_s, np.sign(product), color="#A8DCCB", lw=0.5, label="every sample")
    sign.plot(flight.t_s[first : first + mean.size], mean, color=ON["color"], label=f"mean over {SIGN_MEAN_S:g} s")
    sign.set_ylabel(r"sign of $a^{VC}_{sp} \cdot a^{PC}_{sp}$")
    sign.set_yticks([-1, 0, 1])
    sign.set_title("a)")
    for flown, style in _laws(flights):
        distance.plot(flown.t_s, track_distance_m(flown), **style)
    distance.set_ylim(bottom=0.0)
    distance.set_ylabel("error distance $d$ [m]")
    distance.set_title("b)")
    _legend(sign)
    _legend(distance)
    return figure


def _velocity_error(flights: Flights) -> "Figure":
    flight = _flight(flights, "case2", "on")
    figure, (axis,) = _panels(1)
    _components(axis, flight, flight.column(FlightLog.REFERENCE, 3) - flight.column(FlightLog.VEL, 3))
    axis.set_ylabel("set-point minus velocity [m/s]")
    return figure


def _forward_swing(flights: Flights) -> "Figure":
    flight = _flight(flights, "case2", "on")
    figure, axes = _panels(2)
    for index, axis in zip((1, 3), axes, strict=True):
        _swing(axis, flight, index, (TRUE, EKF))
    _legend(axes[0])
    return figure


def _disturbance(flights: Flights) -> "Figure":
    flight = _flight(flights, "case2", "on")
    figure, axes = _panels(3)
    force, estimated = flight.column(FlightLog.FORCE, 3), flight.column(FlightLog.EKF, 7)[:, 4:]
    for j, (axis, name) in enumerate(zip(axes, ("forward", "right", "down"), strict=True)):
        axis.plot(flight.t_s, force[:, j], **TRUE)
        axis.plot(flight.t_s, estimated[:, j], **EKF)
        axis.set_ylabel(f"{name} $f_{{a{j + 1}}}$ [N]")
    _legend(axes[0])
    return figure


def _trajectory(flights: Flights) -> "Figure":
    from matplotlib.patches import Circle

    flight = _flight(flights, "case3", "off")
    figure, (plan, side) = _panels(1, 2, height_in=4.4)
    scenario, color = flight.scenario, SET_POINT["color"]
    way = np.array([place for _, *place in scenario.references])
    pos = flight.column(FlightLog.POS, 3)
    names: dict[tuple[float, ...], list[str]] = {}
    for number, place in enumerate(way, start=1):
        names.setdefault(tuple(place), []).append(str(number))
    # Plan: east over north. Elevation as an observer in the east sees it: north to the right.
    for axis, across, up, up_sign, label_at in (
        (plan, 1, 0, 1.0, (9, 8)),
        (side, 0, 2, -1.0, (9, -16)),
    ):
        axis.plot(way[:, across], up_sign * way[:, up], **GUIDE, label="between waypoints")
        axis.plot(pos[:, across], up_sign * pos[:, up], **FLOWN)
        seen: dict[tuple[float, float], list[str]] = {}
        for place, numbers in names.items():
            seen.setdefault((place[across], up_sign * place[up]), []).extend(numbers)
        for centre, numbers in seen.items():
            axis.add_patch(Circle(centre, scenario.accept_radius_m, fill=False, color=color))
            axis.annotate(
                f"WP {', '.join(numbers)}", centre, xytext=label_at, textcoords="offset points", fontsize=8.5,
                color=color,
            )  # fmt: skip
        axis.plot(
            [], [], "o", color=color, markerfacecolor="none", markersize=9,
            label=f"waypoint, within {scenario.accept_radius_m:g} m",
        )  # fmt: skip
        axis.margins(0.12)
        axis.set_aspect("equal", adjustable="datalim")
    plan.set(title="a) plan", xlabel="east [m]", ylabel="north [m]")
    side.set(title="b) elevation", xlabel="north [m]", ylabel="altitude [m]")
    handles, labels = plan.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _wind(flights: Flights) -> "Figure":
    flight = _flight(flights, "case3", "off")
    figure, (velocity, rate) = _panels(2)
    _components(velocity, flight, flight.column(FlightLog.WIND, 3))
    _components(rate, flight, np.degrees(flight.column(FlightLog.GUST_RATE, 3)), legend=False, lw=0.3)
    velocity.set_ylabel("velocity [m/s]")
    rate.set_ylabel("rotation [deg/s]")
    return figure


def _filters(index: int, flights: Flights) -> "Figure":
    flight = _flight(flights, "case3", "off")
    figure, axes = _panels(2, share_time=False)
    first_s, last_s = _detail(flight, side=index % 2)
    for axis in axes:
        _swing(axis, flight, index, (TRUE, EKF, FGDF))
    whole, detail = axes
    whole.axvspan(first_s, last_s, color="0.92", zorder=0)
    shown = (flight.t_s >= first_s) & (flight.t_s <= last_s)
    lines = [np.asarray(line.get_ydata())[shown] for line in detail.get_lines()]
    low, high = min(map(np.min, lines)), max(map(np.max, lines))
    edge = 0.05 * (high - low) + 1e-6
    detail.set(xlim=(first_s, last_s), ylim=(low - edge, high + edge), facecolor="0.97", title="detail")
    _legend(whole)
    return figure


def _detail(flight: Flight, side: int) -> tuple[float, float]:
    """Where the paper looks closer: aside from waypoint 3 to 4, ahead the hover against the wind at the end."""
    end_s = flight.duration_s
    on_the_way = flight.t_s[flight.column(FlightLog.LEG) == TO_WAYPOINT_4]
    if side == 0 and on_the_way.size:
        return on_the_way[0], min(on_the_way[0] + DETAIL_S, end_s)
    return max(0.0, end_s - DETAIL_S), end_s


def _speed(case: str, side: int, flights: Flights) -> "Figure":
    flight = _flight(flights, case, "off")
    figure, (axis,) = _panels(1)
    yaw = flight.column(FlightLog.EULER, 3)[:, 2]
    axis.plot(flight.t_s, _heading(flight.column(FlightLog.VEL, 2), yaw)[1 - side], **FLOWN)
    set_point = _heading(flight.column(FlightLog.REFERENCE, 2), np.full(yaw.shape, flight.scenario.yaw_rad))
    axis.plot(flight.t_s, set_point[1 - side], **SET_POINT)
    axis.set_ylabel(f"velocity along ${'yx'[side]}_H$ [m/s]")
    _legend(axis)
    return figure


def _measured(case: str, side: int, flights: Flights) -> "Figure":
    flight = _flight(flights, case, "off")
    figure, axes = _panels(2)
    measured = readings(flight, POTENTIOMETER_SEED)
    for axis, index, values in zip(axes, (side, 2 + side), (measured.angle_rad, measured.rate_radps), strict=True):
        axis.plot(measured.t_s, np.degrees(values[side]), **POTENTIOMETER)
        _swing(axis, flight, index, (EKF, FGDF))
    axes[0].set_title("a)")
    axes[1].set_title("b)")
    _legend(axes[0])
    return figure


_FIGURES: dict[int, tuple[str, Callable[[Flights], "Figure"]]] = {
    4: ("Position error, case 1, no payload controller", _position_error),
    5: ("True and estimated swing, case 1, no payload controller", _swing_state),
    6: ("Swing angle and rate with and without payload controller, case 1", _damping),
    7: ("Opposition of the desired accelerations, and error distance, case 1", _opposition),
    8: ("Velocity error, case 2, payload controller", _velocity_error),
    9: ("True and estimated longitudinal swing, case 2, payload controller", _forward_swing),
    10: ("True and estimated disturbance force, case 2, payload controller", _disturbance),
    11: ("Trajectory, case 3, no payload controller", _trajectory),
    12: ("Wind at the vehicle, case 3, no payload controller", _wind),
    13: ("Lateral swing angle, case 3, no payload controller", partial(_filters, 0)),
    14: ("Lateral swing rate, case 3, no payload controller", partial(_filters, 2)),
    15: ("Longitudinal swing angle, case 3, no payload controller", partial(_filters, 1)),
    16: ("Longitudinal swing rate, case 3, no payload controller", partial(_filters, 3)),
    18: ("Lateral velocity, manoeuvre 1", partial(_speed, "manoeuvre1", 0)),
    19: ("Lateral swing by potentiometer and filters, manoeuvre 1", partial(_measured, "manoeuvre1", 0)),
    20: ("Longitudinal velocity, manoeuvre 2", partial(_speed, "manoeuvre2", 1)),
    21: ("Longitudinal swing by potentiometer and filters, manoeuvre 2", partial(_measured, "manoeuvre2", 1)),
}
"""Number in the paper, title, and what draws it."""


def _flight(flights: Flights, case: str, variant: str) -> Flight:
    try:
        return flights[case, variant]
    except KeyError:
        given = ", ".join(f"{a}/{b}" for a, b in flights) or "none"
        raise StudyError(f"no flight {case}/{variant}: a figure of the study shows it; given are {given}") from None


def _laws(flights: Flights) -> Iterator[tuple[Flight, dict[str, Any]]]:
    """Yield what case 1 compares, each with its line."""
    yield _flight(flights, "case1", "off"), OFF
    yield _flight(flights, "case1", "on"), ON
    if ("case1", "default") in flights:
        yield flights["case1", "default"], DEFAULT


def _heading(ned: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotate horizontal vectors (n, 2) into the heading frame: forward, right."""
    c, s = np.cos(yaw), np.sin(yaw)
    return c * ned[:, 0] + s * ned[:, 1], c * ned[:, 1] - s * ned[:, 0]


def _swing(axis: "Axes", flight: Flight, index: int, styles: tuple[dict[str, Any], ...]) -> None:
    """Plot one of xi, zeta and their rates, truth and filters as their styles say."""
    first = {"true": FlightLog.SWING, "EKF": FlightLog.EKF, "FGDF": FlightLog.FGDF}
    for style in styles:
        axis.plot(flight.t_s, np.degrees(flight.column(first[style["label"]], 4)[:, index]), **style)
    rate, side = divmod(index, 2)
    symbol = _SYMBOLS[side]
    axis.set_ylabel(rf"$\dot{{{symbol}}}$ [deg/s]" if rate else f"${symbol}$ [deg]")


def _components(axis: "Axes", flight: Flight, ned: FloatArray, legend: bool = True, lw: float = 1.1) -> None:
    for values, style in zip(ned.T, NED, strict=True):
        axis.plot(flight.t_s, values, lw=lw, **style)
    if legend:
        _legend(axis)


def _legend(axis: "Axes") -> None:
    """Put it above the panel, where it hides no line."""
    _, labels = axis.get_legend_handles_labels()
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=len(labels))


def _panels(
    rows: int, columns: int = 1, height_in: float | None = None, share_time: bool = True
) -> tuple["Figure", list["Axes"]]:
    """Return a figure and its panels, row by row, with time below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in or 1.4 + 1.8 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=share_time and rows > 1)
    for axis in axes[-1] if share_time else axes.flat:
        axis.set_xlabel("time [s]")
    figure.align_ylabels()
    return figure, list(axes.flat)
