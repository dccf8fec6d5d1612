"""Pictures of the study: every figure is there, shows the flights' own values, and says what is missing."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from matplotlib.patches import Circle

from swingd.core.slung_flight import FlightLog
from swingd.model.errors import StudyError
from swingd.studies.drones2023 import figures as pictures
from swingd.studies.drones2023.cases import LAWS, SCENARIOS, VARIANTS
from swingd.studies.drones2023.flight import run
from swingd.studies.drones2023.potentiometer import readings
from swingd.studies.pictures import DPI, WIDTH_IN

NUMBERS = [*range(4, 17), *range(18, 22)]
SPEED_MPS = 2.0


@pytest.fixture(scope="module")
def flights():
    """Begin every flight of the study; the manoeuvres as steps along their axes, to have something to show so early."""
    flown = {}
    for scenario in SCENARIOS:
        short = replace(scenario, duration_max_s=2.0)
        if scenario.name == "manoeuvre1":
            short = replace(short, references=((0.0, 0.0, SPEED_MPS, 0.0),))
        if scenario.name == "manoeuvre2":
            yaw = scenario.yaw_rad
            short = replace(short, references=((0.0, SPEED_MPS * np.cos(yaw), SPEED_MPS * np.sin(yaw), 0.0),))
        for variant in VARIANTS[scenario.name]:
            flown[scenario.name, variant] = run(short, LAWS[variant], 3)
    return flown


@pytest.fixture(scope="module")
def drawn(flights):
    return dict(pictures.figures(flights))


def lines(axis):
    """Return the lines of a panel by what the legend calls them."""
    return {line.get_label(): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in axis.get_lines()}


def show(axis, flight, **expected):
    """Assert that the panel shows these values over the whole flight."""
    shown = lines(axis)
    for name, values in expected.items():
        t_s, y = shown[name]
        np.testing.assert_allclose(t_s, flight.log[:, 0])
        np.testing.assert_allclose(y, values, rtol=1e-9, atol=1e-9)
        assert np.ptp(y) > 0.0


def test_writes_one_picture_for_each_figure_of_the_paper(flights, tmp_path):
    shares = []
    paths = pictures.draw(flights, tmp_path / "new" / "folder", watch=shares.append)

    assert paths == [tmp_path / "new" / "folder" / f"figure{number:02d}.png" for number in NUMBERS]
    assert shares == pytest.approx(np.arange(1, 18) / 17)
    for path in paths:
        ink = imread(path)[:, :, :3].min(axis=2) < 0.9
        assert ink.shape[1] == WIDTH_IN * DPI
        assert 0.005 < ink.mean() < 0.5
        # What is too long would be cut off at the edge.
        edges = np.concatenate([ink[:, 0], ink[:, -1], ink[0], ink[-1]])
        assert not edges.any(), path.name


def test_writes_vectors_that_are_the_same_for_the_same_flights(flights, tmp_path, monkeypatch):
    few = {number: pictures._FIGURES[number] for number in (11, 13)}
    monkeypatch.setattr(pictures, "_FIGURES", few)
    first, second = (pictures.draw(flights, tmp_path / name, "svg") for name in ("first", "second"))

    assert [path.name for path in first] == ["figure11.svg", "figure13.svg"]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
        root = ElementTree.parse(one).getroot()
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert sum("line2d" in (group.get("id") or "") for group in root.iter()) > 20


def test_every_figure_has_number_units_and_legend(drawn):
    assert list(drawn) == NUMBERS
    for number, figure in drawn.items():
        assert figure.get_suptitle().startswith(f"Figure {number}. ")
        assert figure.legends or any(axis.get_legend() for axis in figure.axes)
        for axis in figure.axes:
            assert (
                axis.get_ylabel().endswith(("[deg]", "[deg/s]", "[m]", "[m/s]", "[N]")) or "sign" in axis.get_ylabel()
            )
        assert all(axis.get_xlabel() in ("time [s]", "east [m]", "north [m]") for axis in figure.axes[-1:])


def test_errors_are_set_point_minus_truth(flights, drawn):
    held, tracked = flights["case1", "off"], flights["case2", "on"]
    position = np.array([0.0, 0.0, -30.0]) - held.log[:, FlightLog.POS : FlightLog.POS + 3]
    velocity = np.array([5.0, 0.0, 0.0]) - tracked.log[:, FlightLog.VEL : FlightLog.VEL + 3]
    for number, flight, error in ((4, held, position), (8, tracked, velocity)):
        north, east, down = error.T
        show(drawn[number].axes[0], flight, north=north, east=east, down=down)


def test_swing_is_shown_true_and_as_estimated_in_degrees(flights, drawn):
    off, on = flights["case1", "off"], flights["case2", "on"]
    for flight, number, order in ((off, 5, (0, 2, 1, 3)), (on, 9, (1, 3))):
        for axis, index in zip(drawn[number].axes, order, strict=True):
            truth, estimate = (np.rad2deg(flight.log[:, first + index]) for first in (FlightLog.SWING, FlightLog.EKF))
            show(axis, flight, true=truth, EKF=estimate)


def test_total_swing_is_that_of_17_for_every_law(flights, drawn):
    angle, rate = drawn[6].axes
    assert len(lines(rate)) == 3
    for name, variant in (
        ("no payload controller", "off"),
        ("payload controller (16)", "on"),
        ("default law", "default"),
    ):
        flight = flights["case1", variant]
        xi, zeta = flight.log[:, FlightLog.SWING], flight.log[:, FlightLog.SWING + 1]
        chi = np.rad2deg(np.arccos(np.cos(xi) * np.cos(zeta)))
        t_s, shown = lines(angle)[name]
        np.testing.assert_allclose(shown, chi, atol=1e-6)
        # Where the cable passes the vertical its angle turns around within one sample.
        swinging = chi[1:-1] > 0.5
        nu, slope = lines(rate)[name][1][1:-1], np.gradient(chi, t_s)[1:-1]
        np.testing.assert_allclose(nu[swinging], slope[swinging], atol=0.1)
    assert lines(angle)["5% of the start"][1][0] == pytest.approx(
        0.05 * np.rad2deg(np.arccos(np.cos(np.pi / 9) ** 2)), abs=0.005
    )


def test_opposition_is_the_sign_of_the_accelerations_product(flights, drawn):
    sign, distance = drawn[7].axes
    flight = flights["case1", "on"]
    product = np.einsum("nj,nj->n", flight.log[:, FlightLog.ACC_VC :][:, :3], flight.log[:, FlightLog.ACC_PC :][:, :3])
    shown = lines(sign)
    np.testing.assert_array_equal(shown["every sample"][1], np.sign(product))
    t_s, mean = shown["mean over 1 s"]
    for t, value in zip(t_s[::50], mean[::50], strict=True):
        near = np.abs(flight.t_s - t) < 0.5
        assert value == pytest.approx(np.sign(product[near]).mean(), abs=0.02)
    away = np.hypot(flight.log[:, FlightLog.POS], flight.log[:, FlightLog.POS + 1])
    show(distance, flight, **{"payload controller (16)": away})


def test_disturbance_is_shown_component_by_component(flights, drawn):
    flight = flights["case2", "on"]
    for j, axis in enumerate(drawn[10].axes):
        estimate = flight.log[:, FlightLog.EKF + 4 + j]
        show(axis, flight, true=flight.log[:, FlightLog.FORCE + j], EKF=estimate)


def test_trajectory_passes_the_waypoints_in_plan_and_elevation(flights, drawn):
    plan, elevation = drawn[11].axes
    flight = flights["case3", "off"]
    north, east, down = flight.log[:, FlightLog.POS : FlightLog.POS + 3].T
    for axis, x, y in ((plan, east, north), (elevation, north, -down)):
        np.testing.assert_allclose(lines(axis)["flown"], (x, y))
    table_4 = {(0, 0): "WP 1, 7", (0, 10): "WP 2, 6", (-10, 20): "WP 3", (10, 20): "WP 4", (0, 30): "WP 5"}
    circles = [patch for patch in plan.patches if isinstance(patch, Circle)]
    assert {tuple(circle.center): text.get_text() for circle, text in zip(circles, plan.texts, strict=True)} == table_4
    assert {circle.radius for circle in circles} == {1.5}
    seen_from_the_east = {(0, 30): "WP 1, 7", (10, 50): "WP 2, 6", (20, 50): "WP 3, 4", (30, 50): "WP 5"}
    assert {tuple(text.xy): text.get_text() for text in elevation.texts} == seen_from_the_east


def test_wind_is_shown_in_metres_and_degrees_per_second(flights, drawn):
    flight = flights["case3", "off"]
    velocity, rate = drawn[12].axes
    for axis, first, unit in ((velocity, FlightLog.WIND, 1.0), (rate, FlightLog.GUST_RATE, 180.0 / np.pi)):
        north, east, down = unit * flight.log[:, first : first + 3].T
        show(axis, flight, north=north, east=east, down=down)
    assert lines(velocity)["north"][1].mean() == pytest.approx(-8.0, abs=3.0)


@pytest.mark.parametrize(("number", "index"), [(13, 0), (14, 2), (15, 1), (16, 3)])
def test_both_filters_stand_beside_the_truth_with_a_detail(flights, drawn, number, index):
    flight = flights["case3", "off"]
    firsts = {"true": FlightLog.SWING, "EKF": FlightLog.EKF, "FGDF": FlightLog.FGDF}
    values = {name: np.rad2deg(flight.log[:, first + index]) for name, first in firsts.items()}
    for axis in drawn[number].axes:
        show(axis, flight, **values)


def test_the_detail_is_where_the_paper_looks_closer(flights):
    # GIVEN a flight of 60 s that is on its way from waypoint 3 to 4 from 25 s to 50 s
    flight = flights["case3", "off"]
    log = np.zeros((601, FlightLog.SIZE))
    log[:, FlightLog.T] = np.linspace(0.0, 60.0, 601)
    log[250:500, FlightLog.LEG] = 3
    log[500:, FlightLog.LEG] = 4
    long = replace(flight, log=log)
    # THEN the lateral swing is enlarged there, the longitudinal one at the end
    drawn = dict(pictures.figures(flights | {("case3", "off"): long}))
    for number, first_s, last_s in ((13, 25.0, 45.0), (14, 25.0, 45.0), (15, 40.0, 60.0), (16, 40.0, 60.0)):
        assert drawn[number].axes[1].get_xlim() == pytest.approx((first_s, last_s))


@pytest.mark.parametrize(
    ("number", "case", "direction_rad"), [(18, "manoeuvre1", np.pi / 2), (20, "manoeuvre2", np.pi / 6)]
)
def test_manoeuvres_show_the_speed_along_their_axis(flights, drawn, number, case, direction_rad):
    flight = flights[case, "off"]
    shown = lines(drawn[number].axes[0])
    along = flight.log[:, FlightLog.VEL] * np.cos(direction_rad) + flight.log[:, FlightLog.VEL + 1] * np.sin(
        direction_rad
    )
    # The heading stays within a fraction of a degree of what was wanted.
    np.testing.assert_allclose(shown["flown"][1], along, atol=0.02)
    assert shown["flown"][1][-1] > 0.5 * SPEED_MPS
    np.testing.assert_allclose(shown["set-point"][1], SPEED_MPS)


@pytest.mark.parametrize(("number", "case", "side"), [(19, "manoeuvre1", 0), (21, "manoeuvre2", 1)])
def test_manoeuvres_compare_filters_with_the_potentiometer(flights, drawn, number, case, side):
    flight = flights[case, "off"]
    measured = readings(flight, pictures.POTENTIOMETER_SEED)
    for axis, read, index in zip(
        drawn[number].axes, (measured.angle_rad, measured.rate_radps), (side, 2 + side), strict=True
    ):
        t_s, shown = lines(axis)["potentiometer"]
        np.testing.assert_allclose(t_s, measured.t_s)
        np.testing.assert_allclose(shown, np.rad2deg(read[side]))
        ekf, fgdf = (np.rad2deg(flight.log[:, first + index]) for first in (FlightLog.EKF, FlightLog.FGDF))
        show(axis, flight, EKF=ekf, FGDF=fgdf)


def test_one_thing_has_one_colour_in_all_figures(drawn):
    colors = {}
    for figure in drawn.values():
        for axis in figure.axes:
            for line in axis.get_lines():
                colors.setdefault(line.get_label(), set()).add(to_rgb(line.get_color()))
    for name in ("true", "EKF", "FGDF", "set-point", "no payload controller", "payload controller (16)", "default law"):
        assert len(colors[name]) == 1, name
    assert len(set.union(*(colors[name] for name in ("true", "EKF", "FGDF", "set-point")))) == 4


def test_the_default_law_is_shown_only_where_it_was_flown(flights):
    without = {key: flight for key, flight in flights.items() if key[1] != "default"}
    for number, figure in pictures.figures(without):
        labels = {name for axis in figure.axes for name in lines(axis)}
        assert "default law" not in labels
        if number == 7:
            assert {"no payload controller", "payload controller (16)"} <= labels
            break


@pytest.mark.parametrize("missing", [("case1", "off"), ("case2", "on"), ("case3", "off"), ("manoeuvre2", "off")])
def test_a_missing_flight_is_named(flights, missing, tmp_path):
    few = {key: flight for key, flight in flights.items() if key != missing and key[1] != "default"}
    with pytest.raises(StudyError, match=f"no flight {missing[0]}/{missing[1]}: .* given are .*case1/on"):
        pictures.draw(few, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_suffix_that_is_none_is_named(flights, tmp_path):
    with pytest.raises(StudyError, match="suffix 'pdf': expected one of png, svg"):
        pictures.draw(flights, tmp_path / "none", "pdf")
    assert not (tmp_path / "none").exists()
