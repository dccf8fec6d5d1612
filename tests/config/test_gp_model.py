"""A learned model that a configuration names: read once, judged, and carried along as text."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swingd.config.cache import load_cached
from swingd.config.loader import load_parameters, parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.config.render import dump_parameters
from swingd.estimation.acceleration_model import AccelerationModel, TrainedFor
from swingd.model.errors import ConfigurationError
from swingd.service.reload import Change

CONFIGURATION = "estimator: {name: gp-ekf}\ngp_ekf: {model: models/flown.json}\n"


def model(target: float = 0.4, trained_for: TrainedFor | None = None) -> str:
    """A model of two samples for the default vehicle."""
    return AccelerationModel(
        trained_for or TrainedFor(2.0, 0.3, 1.5),
        np.ones((2, 4)),
        np.full(2, 0.5),
        np.array([[0.1, 0.0, 0.5, 0.0], [0.0, -0.1, 0.0, 1.0]]),
        np.array([[target, 0.0], [0.1, -0.2]]),
        np.full((2, 2), 0.1),
    ).to_json()


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A configuration beside its model, seen from another folder."""
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "flown.json").write_text(model(), encoding="utf-8")
    path = tmp_path / "test.yaml"
    path.write_text(CONFIGURATION, encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path.parent)
    return path


def refusal(path: Path, *overrides: str) -> str:
    with pytest.raises(ConfigurationError) as caught:
        load_parameters(path, overrides)
    return str(caught.value)


def test_the_file_is_found_beside_the_configuration_and_is_what_was_trained(file: Path) -> None:
    text = load_parameters(file).gp_ekf.model_text
    assert AccelerationModel.from_json(text, "test").to_json() == model()
    assert "\n" not in text


def test_a_record_holds_it_and_needs_no_file(file: Path) -> None:
    parameters = load_parameters(file)
    record = parameters_to_json(parameters)
    (file.parent / "models" / "flown.json").unlink()
    assert parameters_from_json(record) == parameters


def test_a_configuration_that_is_written_names_the_file(file: Path) -> None:
    text = dump_parameters(load_parameters(file))
    assert '  model: "models/flown.json"\n' in text
    assert "model_text" not in text
    assert "model_text" not in parameters_to_json(load_parameters(None))


def test_it_cannot_be_written_into_a_configuration(file: Path) -> None:
    file.write_text("gp_ekf: {model_text: '{}'}\n", encoding="utf-8")
    assert "gp_ekf.model_text (line 1): no such key" in refusal(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "flown.json: No such file or directory; expected a file"),
        ("{", "models/flown.json: file: 'no JSON' given; expected a model by swingd gp train"),
        ('{"format": "other"}', "models/flown.json: format: 'other' given; expected 'swingd-acceleration-model'"),
        (
            model(trained_for=TrainedFor(2.0, 0.5, 1.5)),
            "models/flown.json: trained for payload.mass_kg 0.5, configured is 0.3; expected a model of this vehicle",
        ),
        (
            model(trained_for=TrainedFor(2.0, 0.3, 2.0)),
            "trained for cable.length_m 2, configured is 1.5;",
        ),
    ],
)
def test_what_is_no_model_of_this_vehicle_is_refused(file: Path, text: str | None, said: str) -> None:
    path = file.parent / "models" / "flown.json"
    path.unlink()
    if text is not None:
        path.write_text(text, encoding="utf-8")
    told = refusal(file)
    assert "gp_ekf.model (line 2): " in told
    assert said in told


def test_on_the_command_line_it_is_named_from_where_one_is(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(file.parent / "models")
    (file.parent / "models" / "new.json").write_text(model(target=0.7), encoding="utf-8")
    assert load_parameters(file).gp_ekf.model_text != load_parameters(file, ["gp_ekf.model=new.json"]).gp_ekf.model_text
    assert load_cached(file, ["gp_ekf.model=new.json"]) == load_cached(file, ["gp_ekf.model=new.json"])
    assert "models/flown.json: No such file" in refusal(file, "gp_ekf.model=models/flown.json")


def test_bytes_that_are_no_text_and_a_file_too_large_are_refused(file: Path) -> None:
    path = file.parent / "models" / "flown.json"
    path.write_bytes(b"\xff\xfe")
    assert "flown.json: not UTF-8" in refusal(file)
    with path.open("wb") as stream:
        os.truncate(stream.fileno(), 5 * 1024 * 1024)
    assert "flown.json: larger than 4096 KiB" in refusal(file)


def test_a_model_that_was_trained_anew_is_read_anew(file: Path) -> None:
    before = load_cached(file)
    assert load_cached(file) == before
    (file.parent / "models" / "flown.json").write_text(model(target=0.7), encoding="utf-8")
    after = load_cached(file)
    assert json.loads(after.gp_ekf.model_text)["samples"]["targets"][0][0] == 0.7
    assert Change.between(before, after).taken == ("gp_ekf.model",)
    assert Change.between(before, after).waiting == ()


def test_the_one_of_another_folder_is_not_taken_for_it(file: Path, tmp_path: Path) -> None:
    """The cache knows configurations by their text, and two of the same text may name two files."""
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "models").mkdir(parents=True)
    (elsewhere / "models" / "flown.json").write_text(model(target=0.7), encoding="utf-8")
    (elsewhere / "test.yaml").write_text(CONFIGURATION, encoding="utf-8")
    assert load_cached(file) != load_cached(elsewhere / "test.yaml")


def test_a_damaged_record_says_so(file: Path) -> None:
    parameters = load_parameters(file)
    values = json.loads(parameters_to_json(parameters))
    values["gp_ekf"]["model_text"] = 3
    with pytest.raises(ConfigurationError, match=r"gp_ekf\.model_text: 3 given; expected a text"):
        parameters_from_json(json.dumps(values))
    unread = replace(parameters, gp_ekf=replace(parameters.gp_ekf, model_text=""))
    assert load_parameters(file) != unread
