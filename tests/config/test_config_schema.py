"""The schema is the declarations: every key, bound and choice of the dataclasses, nothing else."""

import dataclasses
import math
import re
from typing import Any, get_type_hints

import pytest
from hypothesis import given
from parameter_strategies import parameter_sets
from pydantic import ValidationError

from swingd.config.plain import plain, restore
from swingd.config.schema import (
    GROUPS,
    ITEM_KEYS,
    KEYS,
    LIST_MAX,
    ROOT,
    TEXT_MAX,
    Group,
    Key,
    find,
    json_schema,
    model_of,
)
from swingd.model.parameters import CONTENT_OF, Endpoint, Mode, Parameters, ShaperName, Thrust, ThrustSource, Waypoint

MODEL = model_of(ROOT)
ALL = [*KEYS.values(), *ITEM_KEYS]
NUMBERS = [key for key in ALL if key.low is not None]
SCALARS = [key for key in NUMBERS if key.sizes is None]
VECTORS = [key for key in NUMBERS if key.sizes is not None and key.sizes[0] == key.sizes[1]]
LISTS = [key for key in NUMBERS if key.sizes is not None and key.sizes[0] < key.sizes[1]]
IDS = {"ids": lambda key: key.name}


def tree(key: Key, value: Any) -> Any:
    """Nest one value under its key; in a list of groups it stands in the only one."""
    for part in reversed(key.path):
        value = [value] if part == "N" else {part: value}
    return value


def build(values: Any) -> Parameters:
    """Give the parameters that nested plain values mean, all others at their defaults."""
    parameters: Parameters = restore(Parameters, MODEL.model_validate(values).model_dump())
    return parameters


def held(key: Key, value: Any) -> Any:
    """Give what the parameters hold under a key that is given as ``value``."""
    found: Any = build(tree(key, value))
    for part in key.path:
        found = found[0] if part == "N" else getattr(found, part)
    return found


def accepts(key: Key, value: Any) -> bool:
    try:
        MODEL.model_validate(tree(key, value))
    except ValidationError:
        return False
    return True


def test_the_schema_has_every_field_of_the_dataclasses_in_order() -> None:
    assert [key.name for key in ITEM_KEYS] == [
        *(f"endpoints.N.{field.name}" for field in dataclasses.fields(Endpoint)),
        *(f"waypoints.N.{field.name}" for field in dataclasses.fields(Waypoint)),
    ]
    expected = []
    for field in dataclasses.fields(Parameters):
        kind = get_type_hints(Parameters)[field.name]
        if dataclasses.is_dataclass(kind):
            inner = [inner for inner in dataclasses.fields(kind) if CONTENT_OF not in inner.metadata]
            expected += [f"{field.name}.{declared.name}" for declared in inner]
        else:
            expected.append(field.name)
    assert list(KEYS) == expected
    assert set(GROUPS) == {name.split(".")[0] for name in expected if "." in name}


def test_without_values_the_schema_gives_the_defaults() -> None:
    assert build({}) == Parameters()


@pytest.mark.parametrize("key", NUMBERS, **IDS)
def test_every_number_declares_finite_bounds_that_hold_its_default(key: Key) -> None:
    assert key.low is not None
    assert key.high is not None
    assert math.isfinite(key.low)
    assert math.isfinite(key.high)
    components = (key.default,) if key.sizes is None else key.default
    assert all(key.low <= component <= key.high for component in components)


@pytest.mark.parametrize("key", ALL, **IDS)
def test_every_key_and_group_has_a_meaning_on_one_line(key: Key) -> None:
    assert key.text.strip()
    assert "\n" not in key.text
    if key.path[0] in GROUPS:
        assert GROUPS[key.path[0]].text.endswith(".")
        assert "\n" not in GROUPS[key.path[0]].text


@pytest.mark.parametrize("key", SCALARS, **IDS)
def test_bounds_are_inclusive_and_enforced(key: Key) -> None:
    low, high = key.type(key.low), key.type(key.high)
    beyond = (
        (low - 1, high + 1) if key.type is int else (math.nextafter(low, -math.inf), math.nextafter(high, math.inf))
    )
    assert accepts(key, low)
    assert accepts(key, high)
    assert not accepts(key, beyond[0])
    assert not accepts(key, beyond[1])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, True, False, None, "1", "", [], {}, 10**400])
@pytest.mark.parametrize("key", SCALARS, **IDS)
def test_a_number_takes_no_other_type_and_nothing_infinite(key: Key, bad: Any) -> None:
    assert not accepts(key, bad)


@pytest.mark.parametrize(
    "key", [key for key in SCALARS if key.type is float and key.low <= math.floor(key.high)], **IDS
)
def test_a_whole_number_is_a_number(key: Key) -> None:
    assert key.high is not None
    whole = math.floor(key.high)
    value = held(key, whole)
    assert type(value) is float
    assert value == whole


@pytest.mark.parametrize("key", [key for key in SCALARS if key.type is int], **IDS)
def test_a_fraction_is_not_a_whole_number(key: Key) -> None:
    assert not accepts(key, float(key.default))


@pytest.mark.parametrize("key", VECTORS, **IDS)
def test_a_vector_has_its_length_and_bounds_in_each_component(key: Key) -> None:
    assert key.low is not None
    assert key.sizes is not None
    good = [key.low] * key.sizes[0]
    assert held(key, good) == tuple(map(float, good))
    for bad in ([], good[:-1], [*good, key.low], "abc", key.low, None, {0: 1, 1: 1, 2: 1}):
        assert not accepts(key, bad)
    for index in range(len(good)):
        for component in (key.low - 1.0, math.nan, True, "0", None, [0.0]):
            assert not accepts(key, [*good[:index], component, *good[index + 1 :]])


@pytest.mark.parametrize("key", LISTS, **IDS)
def test_a_list_has_any_length_up_to_the_largest_and_bounds_in_each_component(key: Key) -> None:
    assert key.low is not None
    assert key.high is not None
    for good in ([], [key.low], [key.high] * LIST_MAX):
        assert held(key, good) == tuple(good)
    for bad in (
        [key.low] * (LIST_MAX + 1),
        [key.low, key.high + 1],
        [1.5],
        [True],
        ["1"],
        [None],
        [[1]],
        key.low,
        "",
        {},
    ):
        assert not accepts(key, bad)


def test_a_list_of_groups_has_any_length_up_to_the_largest() -> None:
    assert build({"endpoints": []}).endpoints == ()
    assert build({"endpoints": [{}, {"shaper": "ei"}]}).endpoints == (Endpoint(), Endpoint(shaper=ShaperName.EI))
    assert len(build({"endpoints": [{}] * LIST_MAX}).endpoints) == LIST_MAX
    for bad in ([{}] * (LIST_MAX + 1), {}, None, "udpin://:1", [None], ["udpin://:1"], [[]], ({},)):
        assert not accepts(KEYS["endpoints"], bad)


@pytest.mark.parametrize("key", [key for key in ALL if key.choices], **IDS)
def test_a_choice_takes_its_names_only(key: Key) -> None:
    for choice in key.choices:
        assert plain(held(key, choice)) == choice
    for bad in (key.choices[0].upper(), "", None, 0, True, [key.choices[0]]):
        assert not accepts(key, bad)


@pytest.mark.parametrize("key", [key for key in ALL if key.type is bool], **IDS)
def test_a_switch_takes_true_and_false_only(key: Key) -> None:
    assert accepts(key, True)
    assert accepts(key, False)
    for bad in (0, 1, 1.0, "true", "", None):
        assert not accepts(key, bad)


@pytest.mark.parametrize("key", [key for key in ALL if key.type is str and not key.choices], **IDS)
def test_a_text_is_printable_and_of_bounded_length(key: Key) -> None:
    assert accepts(key, "x" * TEXT_MAX)
    for bad in ("", "x" * (TEXT_MAX + 1), "a\nb", "a\0", "\x7f", 1, True, None, "\ud800"):
        assert not accepts(key, bad)


def test_unknown_keys_are_refused_at_every_level() -> None:
    for bad in ({"unknown": 1}, {"payload": {"unknown": 1}}, {"endpoints": [{"unknown": 1}]}):
        with pytest.raises(ValidationError, match="Extra inputs"):
            MODEL.model_validate(bad)


@given(parameter_sets())
def test_plain_values_validate_to_the_same_parameters(parameters: Parameters) -> None:
    assert build(plain(parameters)) == parameters


def test_plain_values_are_what_yaml_has() -> None:
    changed = dataclasses.replace(Parameters(), mode=Mode.HOLD, thrust=Thrust(source=ThrustSource.REMARK_1))
    changed = dataclasses.replace(changed, endpoints=(Endpoint(shaper=ShaperName.ZV, system_ids=(255, 1)),))
    assert plain(changed)["mode"] == "hold"
    assert plain(changed)["endpoints"] == [
        {"url": "udpin://127.0.0.1:14541", "shaper": "zv", "key_file": "none", "system_ids": [255, 1]}
    ]
    assert plain(changed)["thrust"]["source"] == "remark_1"
    assert plain(changed)["hold"]["vel_ned_mps"] == [0.0, 0.0, 0.0]


def test_what_is_expected_is_said_with_the_unit() -> None:
    assert KEYS["payload.mass_kg"].expected == "a number from 0.005 to 2000 kg"
    assert KEYS["estimator.nis_gate"].expected == "a number from 5 to 10000"
    assert KEYS["link.system_id"].expected == "a whole number from 0 to 255"
    assert KEYS["hold.vel_ned_mps"].expected == "a list of 3 numbers, each from -30 to 30 m/s"
    assert KEYS["control.enabled"].expected == "true or false"
    assert KEYS["mode"].expected == "one of shadow, hold, inline, path"
    assert KEYS["estimator.name"].expected == "one of swing_ekf, gp-ekf, tether-ukf, fgdf, pendulum"
    assert KEYS["link.autopilot"].expected == "a text of 1 to 200 printable characters"
    assert KEYS["endpoints"].expected == "a list of at most 16 groups of url, shaper, key_file, system_ids"
    system_ids = find(["endpoints", "1", "system_ids"])
    assert isinstance(system_ids, Key)
    assert system_ids.expected == "a list of at most 16 whole numbers, each from 1 to 255"


def test_a_place_in_a_configuration_is_found_by_its_path() -> None:
    assert find([]) is ROOT
    assert find(["payload"]) is GROUPS["payload"]
    assert find(["payload", "mass_kg"]) is KEYS["payload.mass_kg"]
    assert find(["endpoints"]) is KEYS["endpoints"]
    for place in ("1", str(LIST_MAX)):
        item = find(["endpoints", place])
        assert isinstance(item, Group)
        assert find(["endpoints", place, "url"]) is item.members["url"] is ITEM_KEYS[0]
    for path in (
        ["x"],
        [""],
        ["payload", "x"],
        ["payload", "mass_kg", "1"],
        ["endpoints", "0"],
        ["endpoints", "01"],
        ["endpoints", str(LIST_MAX + 1)],
        ["endpoints", "N"],
        ["endpoints", "url"],
        ["endpoints", "1", "url", "1"],
        ["endpoints", "1", "system_ids", "1"],
    ):
        assert find(path) is None


def test_names_of_the_param_protocol_are_fit_for_it() -> None:
    """Sixteen bytes without an end are the longest that PARAM_VALUE carries; its value is a float here."""
    names = [key.mavlink for key in ALL if key.mavlink]
    assert len(names) == len(set(names)) > 20
    for key in ALL:
        if key.mavlink:
            assert re.fullmatch(r"SWG_[A-Z0-9_]+", key.mavlink)
            assert len(key.mavlink) <= 16
            assert key.type in (float, bool)
            assert key.path[0] not in ("endpoints", "waypoints")


@pytest.mark.parametrize("key", ALL, **IDS)
def test_the_json_schema_carries_bounds_defaults_and_meaning(key: Key) -> None:
    schema = json_schema()
    node = schema
    for part in key.path:
        node = node["items"] if part == "N" else node["properties"][part]
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rsplit("/", 1)[-1]]
            assert node["additionalProperties"] is False
    assert node["default"] == plain(key.default)
    assert key.text in node["description"]
    assert key.unit in node["description"]
    if key.sizes is not None:
        assert (node["minItems"], node["maxItems"]) == key.sizes
        node = node["items"]
    if key.low is not None:
        assert (node["minimum"], node["maximum"]) == (key.low, key.high)
    if key.choices:
        assert tuple(node["enum"]) == key.choices
