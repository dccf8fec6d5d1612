import math
import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.config.schema import KEYS, value_of
from swingd.model.ground_parameters import BY_KEY, BY_NAME, GROUND_PARAMETERS
from swingd.model.parameters import Parameters


def test_the_table_is_what_the_declarations_say():
    """The schema of the configuration, made independently from the same declarations, is the oracle."""
    declared = [key for key in KEYS.values() if key.mavlink]
    assert [(p.name, p.key, p.unit, p.text) for p in GROUND_PARAMETERS] == [
        (key.mavlink, key.name, key.unit, key.text) for key in declared
    ]
    for parameter, key in zip(GROUND_PARAMETERS, declared, strict=True):
        assert parameter.is_switch == (key.type is bool)
        assert (parameter.low, parameter.high) == ((0.0, 1.0) if parameter.is_switch else (key.low, key.high))
    assert [p.index for p in GROUND_PARAMETERS] == list(range(len(GROUND_PARAMETERS)))
    assert {"SWG_ENABLE", "SWG_CABLE_LEN", "SWG_LOAD_MASS", "SWG_VEH_MASS", "SWG_DAMPING"} <= set(BY_NAME)


def test_every_name_fits_the_protocol_once():
    names = [parameter.name for parameter in GROUND_PARAMETERS]
    assert len(set(names)) == len(names) == len(BY_NAME) == len(BY_KEY)
    for name in names:
        assert re.fullmatch(r"SWG_[A-Z0-9_]{1,12}", name)


@given(st.data())
def test_a_value_that_is_put_is_got_and_nothing_else_changes(data):
    parameter = data.draw(st.sampled_from(GROUND_PARAMETERS))
    allowed = st.sampled_from([0.0, 1.0]) if parameter.is_switch else st.floats(parameter.low, parameter.high)
    value = data.draw(allowed)
    before = Parameters()
    after = parameter.put(before, value)
    assert parameter.get(after) == value
    for key in KEYS:
        if key != parameter.key:
            assert value_of(after, key) == value_of(before, key)
    assert type(value_of(after, parameter.key)) is type(value_of(before, parameter.key))


@given(st.sampled_from(GROUND_PARAMETERS), st.floats())
def test_a_value_that_is_not_allowed_is_refused_with_what_was_expected(parameter, value):
    fits = value in (0.0, 1.0) if parameter.is_switch else parameter.low <= value <= parameter.high
    if fits:
        parameter.put(Parameters(), value)
    else:
        with pytest.raises(ValueError, match=re.escape(f"{parameter.name}: {value!r} given; expected ")):
            parameter.put(Parameters(), value)


def test_all_bounds_can_be_set_together():
    for bound in ("low", "high"):
        parameters = Parameters()
        for parameter in GROUND_PARAMETERS:
            parameters = parameter.put(parameters, getattr(parameter, bound))
        assert [p.get(parameters) for p in GROUND_PARAMETERS] == [getattr(p, bound) for p in GROUND_PARAMETERS]
        for group, cls in get_type_hints(Parameters).items():
            if is_dataclass(cls):
                untouched = [f.name for f in fields(cls) if not f.metadata.get("mavlink")]
                default = getattr(Parameters(), group)
                assert replace(getattr(parameters, group)) == getattr(parameters, group)
                assert all(getattr(getattr(parameters, group), n) == getattr(default, n) for n in untouched)


def test_bounds_are_finite():
    for parameter in GROUND_PARAMETERS:
        assert math.isfinite(parameter.low)
        assert math.isfinite(parameter.high)
        assert parameter.low < parameter.high


def test_the_documentation_lists_what_there_is():
    text = (Path(__file__).parents[2] / "docs" / "ground-station.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| `SWG_")]
    assert [[cell.strip() for cell in row] for row in rows] == [
        [
            f"`{p.name}`",
            f"`{p.key}`",
            *([p.unit] if p.unit else [""]),
            "0, 1" if p.is_switch else KEYS[p.key].range,
            p.text,
        ]
        for p in GROUND_PARAMETERS
    ]
