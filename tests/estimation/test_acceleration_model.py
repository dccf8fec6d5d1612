"""The model's file: what is written is read again, and whatever else is refused with a reason."""

import copy
import json

import numpy as np
import pytest

from swingd.core.gaussian_process import SAMPLES_MAX
from swingd.estimation.acceleration_model import NOTHING_LEARNED, AccelerationModel, TrainedFor, correction
from swingd.model.errors import ConfigurationError


def some_model(count=12, features=4):
    rng = np.random.default_rng(1)
    return AccelerationModel(
        TrainedFor(1.52, 0.5, 1.6),
        rng.uniform(0.2, 2.0, (2, features)),
        np.array([0.3, 0.4]),
        rng.uniform(-0.5, 0.5, (count, features)),
        0.3 * rng.standard_normal((count, 2)),
        rng.uniform(0.01, 0.1, (count, 2)),
        0.7,
    )


@pytest.fixture
def content():
    return json.loads(some_model().to_json())


def read(content):
    return AccelerationModel.from_json(json.dumps(content), "model.json")


@pytest.mark.parametrize("features", [4, 6])
def test_what_is_written_is_read_again_exactly(features):
    model = some_model(features=features)
    again = AccelerationModel.from_json(model.to_json(), "model.json")
    assert (again.trained_for, again.load_share) == (model.trained_for, model.load_share)
    for name in ("scales", "signal_std", "features", "targets", "target_std"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (5, features))
    for ours, theirs in zip(correction(model.prepare(), points), correction(again.prepare(), points), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_nothing_learned_corrects_nothing():
    mean, _ = correction(NOTHING_LEARNED, np.ones((3, 4)))
    np.testing.assert_array_equal(mean, 0.0)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "3", "[" * 100000, "\x80"])
def test_what_is_no_model_at_all(text):
    with pytest.raises(ConfigurationError, match=r"^model\.json: file: "):
        AccelerationModel.from_json(text, "model.json")


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("format",), "other", "format: 'other' given; expected 'swingd-acceleration-model'"),
        (("version",), 2, "version: 2 given; expected 1"),
        (("version",), True, "version: True given; expected 1"),
        (("features",), ["r_n_m"], "features: "),
        (("outputs",), None, "outputs: None given"),
        (("trained_for",), 3, "trained_for: 3 given; expected an object"),
        (("trained_for", "mass_kg"), 0.0, "trained_for.mass_kg: 0.0 given; expected a number over 0"),
        (("trained_for", "mass_kg"), "1", "trained_for.mass_kg: '1' given"),
        (("length_scales",), [[1.0] * 4], "length_scales: .* expected 2 rows of 4 numbers"),
        (("length_scales", 1, 2), -0.1, "length_scales: -0.1 given; expected numbers between 1e-06 and"),
        (("signal_std",), [0.1], "signal_std: .* expected 2 numbers"),
        (("signal_std", 0), None, "signal_std: None given"),
        (("load_share",), 1.2, "load_share: 1.2 given; expected a number between 0 and 1"),
        (("load_share",), True, "load_share: True given"),
        (("samples",), None, "samples: None given; expected an object"),
        (("samples", "features"), [], f"samples.features: .* expected 1 to {SAMPLES_MAX} rows of 4 numbers"),
        (("samples", "features"), [[0.0] * 4] * (SAMPLES_MAX + 1), "samples.features: "),
        (("samples", "features", 3), [1.0, 2.0], "samples.features: "),
        (("samples", "features", 3, 1), float("nan"), "samples.features: nan given"),
        (("samples", "targets", 0, 0), float("inf"), "samples.targets: inf given"),
        (("samples", "targets", 0, 0), 1e300, "samples.targets: 1e\\+300 given; expected numbers between -1e\\+06 and"),
        (("samples", "targets"), [[0.0, 0.0]], "samples.targets: .* expected 12 rows of 2 numbers"),
        (("samples", "target_std", 0, 1), 0.0, "samples.target_std: 0.0 given"),
        (("samples", "target_std", 0, 1), False, "samples.target_std: False given"),
    ],
)
def test_a_wrong_value_is_named_with_what_was_expected(content, keys, value, message):
    broken = copy.deepcopy(content)
    place = broken
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    with pytest.raises(ConfigurationError, match=rf"^model\.json: {message}"):
        read(broken)


def test_every_key_is_needed(content):
    for key in content:
        with pytest.raises(ConfigurationError, match=key):
            read({other: value for other, value in content.items() if other != key})


def test_samples_that_contradict_a_noiseless_process_are_refused():
    model = some_model()
    twice = np.vstack([model.features] * 2), np.vstack([model.targets] * 2), np.full((24, 2), 1.1e-6)
    broken = AccelerationModel(model.trained_for, np.full((2, 4), 1e5), np.array([1e5, 1e5]), *twice)
    with pytest.raises(ConfigurationError, match="not positive definite"):
        broken.prepare()
