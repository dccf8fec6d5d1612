"""Training of the Gaussian process: a known error is found, logs are read or refused, the command does it all."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.core import slts
from swingd.core.constants import GRAVITY_MPS2
from swingd.estimation.acceleration_model import AccelerationModel, TrainedFor, correction
from swingd.identify import swing_log
from swingd.identify.gp_training import INTERVAL_S, samples_of, train
from swingd.identify.swing_log import Segment
from swingd.model.errors import ConfigurationError, LogFormatError

MASS, PAYLOAD, LENGTH = 1.52, 0.5, 1.6
TRAINED_FOR = TrainedFor(MASS, PAYLOAD, LENGTH)
DT_S = 0.01


def missing(r, v):
    """What the rigid equation does not know here [m/s^2]."""
    return -0.6 * v + 1.2 * np.sin(4.0 * r)


def flown(seed, duration_s=40.0, noise=0.0, drag=0.0, load_share=0.0):
    """A swing with an error of its own, as a log; v to within its noise.

    With drag the load is said to cruise to and fro, else its velocity is the one that it has.
    """
    rng = np.random.default_rng(seed)
    x, acc = np.zeros(10), np.empty(6)
    x[3:5] = 0.2 * rng.standard_normal(2)
    phase = rng.uniform(0.0, 6.0, 4)
    rows = []
    for step in range(round(duration_s / DT_S)):
        t_s = step * DT_S
        force = np.array(
            [
                2.0 * math.sin(1.9 * t_s + phase[0]) + math.sin(0.7 * t_s + phase[1]) - 2.0 * x[8],
                2.0 * math.sin(1.6 * t_s + phase[2]) + math.sin(0.9 * t_s + phase[3]) - 2.0 * x[9],
                -(MASS + PAYLOAD) * GRAVITY_MPS2,
            ]
        )
        vel = 2.0 * np.array([math.sin(0.41 * t_s + phase[0]), math.cos(0.33 * t_s + phase[2])])
        dragged = drag * vel * np.abs(vel)
        if step:
            for _ in range(2):
                slts.acceleration(acc, x, force, np.zeros(3), MASS, PAYLOAD, LENGTH)
                rate = np.concatenate([x[5:], acc[:5]])
                rate[8:] += missing(x[3:5], x[8:]) + dragged
                rate[5:7] -= load_share * missing(x[3:5], x[8:])
                middle = x + 0.25 * DT_S * rate
                slts.acceleration(acc, middle, force, np.zeros(3), MASS, PAYLOAD, LENGTH)
                rate = np.concatenate([middle[5:], acc[:5]])
                rate[8:] += missing(middle[3:5], middle[8:]) + dragged
                rate[5:7] -= load_share * missing(middle[3:5], middle[8:])
                x = x + 0.5 * DT_S * rate
        rows.append([t_s, *force, *x[3:5], *(x[8:] + noise * rng.standard_normal(2)), *(vel if drag else x[5:7])])
    table = np.array(rows)
    return Segment(table[:, 0], table[:, 1:4], table[:, 4:6], table[:, 6:8], table[:, 8:])


@pytest.fixture(scope="module")
def segments():
    return [flown(1, noise=0.004), flown(2, noise=0.004)]


@pytest.fixture(scope="module")
def training(segments):
    return train(segments, TRAINED_FOR, samples=40)


def test_samples_are_the_error_at_their_place(segments):
    found = samples_of(flown(3), TRAINED_FOR)
    assert len(found.z) == pytest.approx(40.0 / INTERVAL_S, abs=2)
    # The mean over the interval, against the value at its beginning: within what changes in between.
    expected = missing(found.z[:, :2], found.z[:, 2:])
    changed = np.abs(np.diff(expected, axis=0)).max()
    np.testing.assert_allclose(found.error, expected, atol=changed)
    assert np.sqrt(np.mean((found.error - expected) ** 2)) < 0.25 * np.sqrt(np.mean(expected**2))


def test_with_the_right_equation_there_is_nothing_to_learn():
    segment = flown(3)
    silent = TrainedFor(MASS, PAYLOAD, LENGTH)
    x, acc = np.zeros(10), np.empty(6)
    x[3] = 0.3
    rows = []
    for step in range(400):
        force = np.ascontiguousarray(segment.force_ned_n[step])
        for _ in range(4 if step else 0):
            slts.acceleration(acc, x, force, np.zeros(3), MASS, PAYLOAD, LENGTH)
            middle = x + 0.125 * DT_S * np.concatenate([x[5:], acc[:5]])
            slts.acceleration(acc, middle, force, np.zeros(3), MASS, PAYLOAD, LENGTH)
            x = x + 0.25 * DT_S * np.concatenate([middle[5:], acc[:5]])
        rows.append([*x[3:5], *x[8:]])
    rows = np.array(rows)
    found = samples_of(Segment(segment.t_s[:400], segment.force_ned_n[:400], rows[:, :2], rows[:, 2:]), silent)
    assert np.abs(found.error).max() < 2e-3


def test_a_known_error_is_found_where_it_was_flown(training):
    score = training.score
    assert score.rmse_after < 0.3 * score.rmse_before
    assert score.log_likelihood_after > score.log_likelihood_before + 0.8
    z = training.held_out.z
    mean, var = correction(training.model.prepare(), z)
    off = mean - missing(z[:, :2], z[:, 2:])
    # The error over an interval, and the clusters' means, are not quite the value at a point.
    assert np.sqrt(np.mean(off**2)) < 0.25
    assert np.mean(np.abs(training.held_out.error - mean) < 2.0 * training.held_out_std) > 0.85
    assert (var < training.model.signal_std**2).all()


def test_drag_of_the_load_needs_its_velocity():
    segments = [flown(seed, drag=0.15) for seed in (6, 7)]
    narrow, wide = (train(segments, TRAINED_FOR, 60, with_velocity=wanted) for wanted in (False, True))
    assert wide.trained.z.shape[1] == 6
    assert wide.score.rmse_after < 0.5 * narrow.score.rmse_after
    assert wide.score.log_likelihood_after > narrow.score.log_likelihood_after + 0.3
    with pytest.raises(LogFormatError, match=r"no vehicle's velocity; expected columns vn_mps, ve_mps"):
        train([replace(segments[0], vel_load_mps=None)], TRAINED_FOR, with_velocity=True)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_which_body_the_error_pushes_shows_in_the_vehicles_acceleration(share):
    segments = [flown(seed, noise=0.004, load_share=share) for seed in (8, 9)]
    assert train(segments, TRAINED_FOR, 40).model.load_share == pytest.approx(share, abs=0.1)
    silent = [replace(segment, vel_load_mps=None) for segment in segments]
    assert train(silent, TRAINED_FOR, 40).model.load_share == 0.0


def test_the_model_is_bounded_and_the_same_logs_give_the_same(training, segments):
    assert len(training.model.features) <= 40
    assert train(segments, TRAINED_FOR, samples=40).model.to_json() == training.model.to_json()


def test_too_short_logs_are_refused():
    with pytest.raises(LogFormatError, match=r"samples of 0.1 s for training; expected at least"):
        train([flown(1, 6.0)], TRAINED_FOR)


def test_without_scikit_learn_it_says_what_to_install(segments, monkeypatch):
    monkeypatch.setattr("swingd.identify.gp_training.find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"expected: pip install 'swingd\[train\]'"):
        train(segments, TRAINED_FOR)


# ---- logs


def test_a_log_is_read_as_it_was_written(tmp_path):
    segment = flown(4, 5.0)
    path = tmp_path / "flight.csv"
    swing_log.write(path, segment)
    (again,) = swing_log.read(path)
    for name in ("t_s", "force_ned_n", "r_m", "v_mps", "vel_load_mps"):
        np.testing.assert_allclose(getattr(again, name), getattr(segment, name), rtol=2e-5, atol=2e-5)


def test_without_v_it_is_the_derivative_of_r(tmp_path):
    segment = flown(4, 10.0)
    path = tmp_path / "flight.csv"
    lines = [",".join(swing_log.REQUIRED)]
    table = np.column_stack([segment.t_s, segment.force_ned_n, segment.r_m])
    lines += [",".join(f"{value:.7g}" for value in row) for row in table]
    path.write_text("\n".join(lines))
    (again,) = swing_log.read(path)
    inside = slice(20, -20)
    np.testing.assert_allclose(again.r_m[inside], segment.r_m[: len(again.t_s)][inside], atol=2e-3)
    np.testing.assert_allclose(again.v_mps[inside], segment.v_mps[: len(again.t_s)][inside], atol=0.03)


def test_gaps_and_empty_cells_divide_a_log(tmp_path):
    segment = flown(4, 6.0)
    path = tmp_path / "flight.csv"
    swing_log.write(path, segment)
    lines = path.read_text().splitlines()
    cells = lines[200].split(",")
    cells[4] = ""
    lines[200] = ",".join(cells)
    del lines[400:450]
    path.write_text("\n".join(lines))
    assert [len(part.t_s) for part in swing_log.read(path)] == [199, 199, 151]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: no column t_s"),
        ("t_s,force_n_n,force_e_n,force_d_n,r_n_m\n", "line 1: no column r_e_m"),
        ("t_s,force_n_n,force_e_n,force_d_n,r_n_m,r_e_m\n0,0,0,-20,0\n", "line 2: 5 cells"),
        ("t_s,force_n_n,force_e_n,force_d_n,r_n_m,r_e_m\n0,0,0,x,0,0\n", "line 2: 'x' given; expected a finite number"),
        ("t_s,force_n_n,force_e_n,force_d_n,r_n_m,r_e_m\n0,0,0,inf,0,0\n", "line 2: 'inf' given"),
        ("t_s,force_n_n,force_e_n,force_d_n,r_n_m,r_e_m\n0,0,0,-20,0,0\n", "no stretch of 0.5 s"),
    ],
)
def test_a_log_that_is_none_is_refused(tmp_path, text, message):
    path = tmp_path / "flight.csv"
    path.write_text(text)
    with pytest.raises(LogFormatError, match=message):
        swing_log.read(path)


def test_a_log_that_cannot_be_read(tmp_path):
    with pytest.raises(LogFormatError, match="cannot be read"):
        swing_log.read(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LogFormatError, match="cannot be read"):
        swing_log.read(tmp_path / "bytes.csv")


# ---- command


def test_the_command_trains_draws_and_tells(tmp_path, segments):
    for name, segment in zip("ab", segments, strict=True):
        swing_log.write(tmp_path / f"{name}.csv", segment)
    logs = [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")]
    sets = ["vehicle.mass_kg=1.52", "payload.mass_kg=0.5", "cable.length_m=1.6"]
    settings = [word for value in sets for word in ("--set", value)]
    model, picture = tmp_path / "model.json", tmp_path / "model.png"
    arguments = ["gp", "train", *logs, *settings, "-o", str(model), "--samples", "30"]
    result = CliRunner().invoke(app, [*arguments, "--picture", str(picture), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["rmse_after"] < 0.4 * told["rmse_before"]
    assert told["kept"] <= 30
    assert picture.read_bytes().startswith(b"\x89PNG")
    read = AccelerationModel.from_json(model.read_text(), "model.json")
    assert read.trained_for == TRAINED_FOR
    # Refused before any work: a log would be written over.
    refused = CliRunner().invoke(app, ["gp", "train", *logs, "-o", logs[0]])
    assert refused.exit_code == 78
    assert "is read by this command" in refused.output
