"""The study against the paper, and its parts against independent calculations."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.core.path_following import PathTerm
from swingd.core.slts_flight_layout import Feedback, SltsFlightLog
from swingd.estimation.acceleration_model import AccelerationModel, TrainedFor, correction
from swingd.identify.gp_training import train
from swingd.identify.swing_log import read
from swingd.model.errors import StudyError
from swingd.studies.slts import paper
from swingd.studies.slts.cases import CIRCLE, OUTDOOR, SCENARIOS, SQUARE, TRAINING, like
from swingd.studies.slts.figures import figures
from swingd.studies.slts.flight import run
from swingd.studies.slts.indicators import estimation, following, level, rms, size
from swingd.studies.slts.study import ESTIMATE, as_object, fly_all, judge
from swingd.studies.slts.training import FIRST_SEED, MODEL_OF, VEHICLES, WITH_VELOCITY

SEEDS = (2, 3, 4)
L = SltsFlightLog


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the command wrote."""
    folder = tmp_path_factory.mktemp("slts")
    arguments = ["study", "slts", "-o", str(folder), "--seed", str(SEEDS[0]), "--no-figures", "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    (folder / "told.json").write_text(result.stdout)
    return folder


@pytest.fixture(scope="module")
def told(folder):
    return json.loads((folder / "told.json").read_text())


@pytest.fixture(scope="module")
def models(folder):
    names = [f"{vehicle}{wider}" for vehicle in VEHICLES for wider in ("", f" {WITH_VELOCITY}")]
    files = {name: folder / "training" / f"{name.replace(' ', '_')}.json" for name in names}
    return {name: AccelerationModel.from_json(file.read_text(), file.name).prepare() for name, file in files.items()}


@pytest.fixture(scope="module")
def flights(models):
    return {seed: fly_all(seed, models) for seed in SEEDS}


@pytest.fixture(scope="module")
def mean(flights):
    repeated = [judge(flown) for flown in flights.values()]
    return {
        group: {index: float(np.mean([one[group][index] for one in repeated])) for index in repeated[0][group]}
        for group in repeated[0]
    }


@pytest.mark.parametrize(
    ("path", "index"),
    [
        ("square", "lateral_rms"),
        ("square", "lateral_max"),
        ("square", "vertical_rms"),
        ("square", "swing_level_max"),
        ("circle", "lateral_rms"),
        ("outdoor", "lateral_rms"),
        ("outdoor", "vertical_rms"),
        ("outdoor", "recovered"),
    ],
)
def test_the_load_keeps_to_its_path_at_least_as_the_paper_prints(mean, path, index):
    assert mean[path][index] <= paper.VALUES[path][index]


@pytest.mark.parametrize("scenario", [scenario.name for scenario in SCENARIOS])
def test_the_gp_ekf_is_nearer_to_the_load_than_the_plain_one_and_the_camera(flights, mean, scenario):
    found = mean[ESTIMATE + scenario]
    assert found["gp_ekf_rmse"] < 0.97 * found["ekf_rmse"]
    assert found["ekf_rmse"] < found["camera_rmse"]
    wider = mean[f"{ESTIMATE}{scenario} {WITH_VELOCITY}"]
    assert wider["gp_ekf_rmse"] < 0.8 * wider["ekf_rmse"]
    for flown in flights.values():
        one = estimation(flown[scenario])
        assert one["gp_ekf_rmse"] < min(one["ekf_rmse"], one["camera_rmse"])


@pytest.mark.parametrize("scenario", [scenario.name for scenario in SCENARIOS])
def test_the_errors_are_within_what_the_filter_says(mean, scenario):
    """Errors are correlated over seconds, so that chi-square bounds of independent samples would not do."""
    for name in (scenario, f"{scenario} {WITH_VELOCITY}"):
        assert 1.0 < mean[ESTIMATE + name]["gp_ekf_nees"] < 4.5
        assert mean[ESTIMATE + name]["gp_ekf_within_3_sigma"] > (0.97 if scenario == "outdoor" else 0.99)


def test_no_judged_path_or_seed_was_trained_on(told):
    judged = {scenario.waypoints_ned_m for scenario in SCENARIOS}
    assert judged.isdisjoint(scenario.waypoints_ned_m for scenario in TRAINING)
    assert max(SEEDS) < FIRST_SEED
    for score in told["training"].values():
        assert score["held_out"] > 400
        assert score["rmse_after"] < 0.9 * score["rmse_before"]
        assert score["log_likelihood_after"] > score["log_likelihood_before"]
    assert set(MODEL_OF.values()) == set(VEHICLES)


def test_the_truth_has_what_no_filter_knows(flights):
    """Stretched cable, drag of the load, weaker rotors."""
    flight = flights[SEEDS[0]]["square"]
    true = flight.column(L.TRUE, 10)
    distance = size(flight.column(L.POS, 3) - true[:, :3])
    assert distance.min() > 1.6 + 0.01
    assert np.ptp(distance) > 0.004
    cruising = level(flight) & (flight.column(L.LEG) == 0.0)
    assert true[cruising, 3].mean() > 0.03  # the vehicle pulls a load that its drag holds back
    outdoor = flights[SEEDS[0]]["outdoor"]
    shortfall = outdoor.column(L.THRUST)[500:] / size(outdoor.column(L.FORCE, 3)[500:])
    assert np.median(shortfall) == pytest.approx(0.85, abs=0.01)
    # And the law finds it: the missing thrust pulls down.
    missing_n = 0.15 * np.median(size(outdoor.column(L.FORCE, 3)[500:]))
    assert outdoor.term(PathTerm.D_T)[1500:, 2].mean() == pytest.approx(missing_n, rel=0.1)


def test_pictures_come_late_drop_out_and_leave_the_field_of_view(flights):
    flight = flights[SEEDS[0]]["square"]
    fresh_hz = flight.column(L.CAMERA_FRESH).sum() / flight.t_s[-1]
    assert 0.85 * 15.0 < fresh_hz < 0.95 * 15.0
    arrived = np.flatnonzero(flight.column(L.CAMERA_FRESH) > 0.5)
    assert flight.t_s[arrived[0]] == pytest.approx(0.08, abs=0.011)
    longest_s = np.diff(flight.t_s[arrived]).max()
    assert 0.5 < longest_s < 1.7
    # Noise of one picture, against the truth 80 ms before it came.
    true = flight.column(L.TRUE + 3, 2)
    error = flight.column(L.CAMERA, 2)[arrived[10:]] - true[arrived[10:] - 8]
    assert rms(error) == pytest.approx(0.03 + 0.02 * 1.61, rel=0.06)
    narrow = replace(SQUARE, sensors=replace(SQUARE.sensors, camera_half_angle_rad=0.01), hold_s=1.0)
    blind = run(replace(narrow, waypoints_ned_m=(SQUARE.waypoints_ned_m[0], (12.0, 0.0, -10.0))), 1)
    assert blind.column(L.CAMERA_FRESH).sum() < 0.5 * blind.t_s[-1] * 15.0


def test_the_same_seed_gives_the_same_flight_and_another_another(flights, models):
    again = run(CIRCLE, SEEDS[0], models["simulated"])
    np.testing.assert_array_equal(again.log, flights[SEEDS[0]]["circle"].log)
    assert not np.array_equal(again.log[1000], flights[SEEDS[1]]["circle"].log[1000])


def test_without_a_model_both_filters_are_the_same():
    flight = run(CIRCLE, 7)
    np.testing.assert_array_equal(flight.column(L.GP_EKF, 20), flight.column(L.EKF, 20))
    assert estimation(flight)["gain"] == 0.0


def test_by_the_truth_it_follows_no_worse(flights):
    by_truth = following(run(SQUARE, SEEDS[0], feedback=Feedback.TRUTH))
    by_filter = following(flights[SEEDS[0]]["square"])
    assert by_truth["lateral_rms"] < by_filter["lateral_rms"]
    assert by_truth["vertical_rms"] < by_filter["vertical_rms"]


def test_distance_from_the_leg_by_another_way(flights):
    flight = flights[SEEDS[0]]["circle"]
    way = np.array(CIRCLE.waypoints_ned_m)
    for row in range(0, len(flight.log), 211):
        leg = int(flight.log[row, L.LEG])
        if leg + 1 == len(way):
            continue
        unit = (way[leg + 1] - way[leg]) / np.linalg.norm(way[leg + 1] - way[leg])
        off = flight.log[row, L.TRUE : L.TRUE + 3] - way[leg + 1]
        across = np.cross(unit, off)
        assert np.linalg.norm(flight.log[row, L.TRUE_E_P : L.TRUE_E_P + 3]) == pytest.approx(np.linalg.norm(across))


def test_a_flight_that_does_not_arrive_says_so():
    with pytest.raises(StudyError, match="square, seed 1: not at the last waypoint after 10 s"):
        run(replace(SQUARE, duration_max_s=10.0), 1)


def test_another_vehicles_paths_keep_its_facts():
    scenario = like(TRAINING[0], OUTDOOR)
    assert scenario.vehicle is OUTDOOR.vehicle
    assert scenario.thrust_factor == 0.85
    assert scenario.waypoints_ned_m == TRAINING[0].waypoints_ned_m


def test_figures_show_the_flights_and_miss_what_is_missing(flights):
    drawn = dict(figures(flights[SEEDS[0]]))
    assert sorted(drawn) == [3, 4, 5, 6]
    plan, _, errors = drawn[3].axes[:3]
    east = plan.get_lines()[1].get_xdata()
    np.testing.assert_array_equal(east, flights[SEEDS[0]]["square"].column(L.TRUE + 1))
    assert errors.get_lines()[0].get_ydata().max() == pytest.approx(
        size(flights[SEEDS[0]]["square"].column(L.TRUE_E_P, 2)).max()
    )
    with pytest.raises(StudyError, match="no flight outdoor"):
        dict(figures({name: flight for name, flight in flights[SEEDS[0]].items() if name != "outdoor"}))


def test_object_for_programs(flights, told):
    found = judge(flights[SEEDS[0]])
    assert told["square"]["lateral_rms"] == {"ours": found["square"]["lateral_rms"], "paper": 0.4381}
    assert told["estimate"] == {name: found[ESTIMATE + name] for name in flights[SEEDS[0]]}
    spread = {group: dict.fromkeys(values, 0.1) for group, values in found.items()}
    assert as_object(found, spread, 2, {})["circle"]["lateral_max"]["ours_std"] == 0.1


def test_the_command_writes_tables_logs_and_models(folder, flights, models):
    with (folder / "tables.csv").open() as file:
        table = {(row["path"], row["index"]): row for row in csv.DictReader(file)}
    row = table["square", "lateral_rms"]
    assert float(row["ours"]) == pytest.approx(following(flights[SEEDS[0]]["square"])["lateral_rms"], rel=1e-5)
    assert (row["paper"], row["unit"]) == ("0.4381", "m")
    text = (folder / "tables.md").read_text()
    assert "| path | GP-EKF RMSE [m] | EKF | camera |" in text
    assert f"| outdoor {WITH_VELOCITY} |" in text
    # What lies there is what `swingd gp train` takes: the same logs give the same model.
    logs = [folder / "training" / f"simulated_{scenario.name}.csv" for scenario in TRAINING]
    segments = [segment for log in logs for segment in read(log)]
    vehicle = SQUARE.vehicle
    again = train(segments, TrainedFor(vehicle.mass_kg, vehicle.load_mass_kg, 1.6)).model.prepare()
    point = np.array([[0.1, -0.05, 0.2, 0.1]])
    # To the digits that the log keeps.
    np.testing.assert_allclose(correction(again, point), correction(models["simulated"], point), atol=0.02)
