"""Pictures of the study: every figure is there, shows the flights' own values, and says what is missing."""

from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.image import imread

from swingd.core.planar_flight import PlanarFlightLog
from swingd.core.planar_rotorcraft import PlanarState
from swingd.model.errors import StudyError
from swingd.studies.icinco2016 import figures as pictures
from swingd.studies.icinco2016.study import fly_all
from swingd.studies.pictures import DPI, WIDTH_IN

STATES = {
    3: ("regulation", "none"),
    4: ("regulation", "both"),
    5: ("regulation_torque", "translational"),
    6: ("regulation_torque", "both"),
    7: ("circle_torque", "translational"),
    9: ("circle_torque", "both"),
}
NUMBERS = list(range(3, 11))


@pytest.fixture(scope="module")
def flights():
    return fly_all(3)


@pytest.fixture(scope="module")
def drawn(flights):
    return dict(pictures.figures(flights))


def lines(axis):
    return {line.get_label(): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in axis.get_lines()}


def test_writes_one_picture_for_each_figure_of_the_paper(flights, tmp_path):
    shares = []
    paths = pictures.draw(flights, tmp_path / "new", watch=shares.append)
    assert paths == [tmp_path / "new" / f"figure{number:02d}.png" for number in NUMBERS]
    assert shares == pytest.approx(np.arange(1, 9) / 8)
    for path in paths:
        ink = imread(path)[:, :, :3].min(axis=2) < 0.9
        assert ink.shape[1] == WIDTH_IN * DPI
        assert 0.005 < ink.mean() < 0.5
        # What is too long would be cut off at the edge.
        assert not np.concatenate([ink[:, 0], ink[:, -1], ink[0], ink[-1]]).any(), path.name


def test_writes_vectors(flights, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "_FIGURES", {10: pictures._FIGURES[10]})
    first, second = (pictures.draw(flights, tmp_path / name, "svg")[0] for name in ("a", "b"))
    assert first.name == "figure10.svg"
    assert first.read_bytes() == second.read_bytes()
    assert ElementTree.parse(first).getroot().tag == "{http://www.w3.org/2000/svg}svg"


def test_every_figure_has_number_units_and_legend(drawn):
    assert list(drawn) == NUMBERS
    for number, figure in drawn.items():
        assert figure.get_suptitle().startswith(f"Figure {number}. ")
        assert figure.legends or any(axis.get_legend() for axis in figure.axes)
        for axis in figure.axes:
            assert axis.get_ylabel().endswith(("[deg]", "[m]", "[N]", "[N m]"))
            assert axis.get_xlabel() in ("time [s]", "x [m]")


@pytest.mark.parametrize("number", STATES)
def test_states_and_disturbances_are_shown_true_and_as_estimated(flights, drawn, number):
    log = flights[STATES[number]].log
    x, z, pitch, rod, rho_x, rho_z, rho_theta, plane = drawn[number].axes
    for axis, panel in enumerate((x, z, pitch)):
        scale = np.degrees(1.0) if axis == 2 else 1.0
        shown = lines(panel)
        np.testing.assert_allclose(shown["true"], (log[:, 0], scale * log[:, PlanarFlightLog.STATE + axis]))
        np.testing.assert_allclose(shown["ES-LKF"][1], scale * log[:, PlanarFlightLog.ESTIMATE + axis])
        np.testing.assert_allclose(shown["wanted"][1], scale * log[:, PlanarFlightLog.POS_SP + axis])
    np.testing.assert_allclose(lines(rod)["true"][1], np.rad2deg(log[:, PlanarFlightLog.STATE + PlanarState.ROD]))
    for axis, panel in enumerate((rho_x, rho_z, rho_theta)):
        shown = lines(panel)
        np.testing.assert_allclose(shown["true"][1], log[:, PlanarFlightLog.RHO + axis])
        np.testing.assert_allclose(shown["ES-LKF"][1], log[:, PlanarFlightLog.RHO_ESTIMATE + axis])
    shown = lines(plane)
    if STATES[number][0] == "regulation":
        np.testing.assert_allclose(shown["true"], log[:, PlanarFlightLog.STATE :][:, :2].T)
    else:
        assert shown["before the torque"][0].size == 1501
        np.testing.assert_allclose(shown["from the torque on"], log[1500:, PlanarFlightLog.STATE :][:, :2].T)


def test_motion_with_compensation_has_that_without_beside_it(flights, drawn):
    without = flights["circle_torque", "translational"].column(PlanarFlightLog.STATE, 2).T
    panel = drawn[10].axes[0]
    np.testing.assert_allclose(lines(panel)["without, from Figure 8"], without)
    np.testing.assert_allclose(lines(drawn[8].axes[0])["from the torque on"], without[:, 1500:])
    assert panel.get_aspect() == 1.0


def test_a_missing_flight_is_named_before_anything_is_written(flights, tmp_path):
    few = {key: flight for key, flight in flights.items() if key != ("circle_torque", "both")}
    with pytest.raises(StudyError, match="no flight circle_torque/both"):
        pictures.draw(few, tmp_path / "none")
    assert not (tmp_path / "none").exists()
