"""Files and overrides: what is read, and what is said about mistakes."""

import dataclasses
import json
import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from parameter_strategies import parameter_sets, values

from swingd.config.checks import CHECKS
from swingd.config.loader import load_parameters, parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.config.reader import DEPTH_MAX, SIZE_MAX
from swingd.config.render import dump_parameters, yaml_text
from swingd.config.schema import GROUPS, KEYS, nested, plain, value_of
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Control, Estimator, Hold, Link, Mode, Parameters, Payload, ThrustSource

shares_a_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def load(tmp_path: Path) -> Any:
    def load_text(text: str | bytes, *overrides: str) -> Parameters:
        path = tmp_path / "test.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_parameters(path, overrides)

    return load_text


@pytest.fixture
def problems(load: Any, tmp_path: Path) -> Any:
    def problems_of(text: str | bytes, *overrides: str) -> list[str]:
        with pytest.raises(ConfigurationError) as caught:
            load(text, *overrides)
        head, *lines = str(caught.value).split("\n  ")
        assert head == f"{tmp_path / 'test.yaml'}: {len(lines)} problem{'s' if len(lines) != 1 else ''}"
        return lines

    return problems_of


@pytest.fixture
def refusal(load: Any, tmp_path: Path) -> Any:
    """The message about a file that cannot be read as a configuration at all."""

    def refusal_of(text: str | bytes) -> str:
        with pytest.raises(ConfigurationError) as caught:
            load(text)
        return str(caught.value).removeprefix(f"{tmp_path / 'test.yaml'}: ")

    return refusal_of


# What is read


@pytest.mark.parametrize("text", ["", "# only a comment\n", "---\n", "null\n", "{}", "payload:\n", "payload: {}\n"])
def test_what_is_left_out_keeps_its_default(load: Any, text: str) -> None:
    assert load(text) == Parameters()


def test_no_file_gives_the_defaults() -> None:
    assert load_parameters() == Parameters()


def test_every_kind_of_value_is_read(load: Any) -> None:
    parameters = load(
        "mode: hold\n"
        "payload: {mass_kg: 1}\n"
        "thrust:\n"
        "  source: remark_1\n"
        "estimator:\n"
        "  name: pendulum\n"
        "  acc_noise: 5e-2\n"
        "control:\n"
        "  enabled: false\n"
        "hold:\n"
        "  vel_ned_mps: [1, -2.5, 0]\n"
        "link:\n"
        "  autopilot: serial:///dev/ttyAMA0:921600\n"
        "  system_id: 7\n"
    )
    assert parameters.mode is Mode.HOLD
    assert parameters.payload == Payload(mass_kg=1.0)
    assert parameters.thrust.source is ThrustSource.REMARK_1
    assert parameters.estimator == Estimator(name="pendulum", acc_noise=0.05)
    assert parameters.control == Control(enabled=False)
    assert parameters.hold == Hold(vel_ned_mps=(1.0, -2.5, 0.0))
    assert parameters.link == Link(autopilot="serial:///dev/ttyAMA0:921600", system_id=7)


@pytest.mark.parametrize(
    ("text", "value"),
    [("1", 1.0), ("1.", 1.0), (".5", 0.5), ("1e0", 1.0), ("5E-1", 0.5), ("+1.2e+0", 1.2), ("010e-1", 1.0), ("02", 2.0)],
)
def test_numbers_are_read_as_people_write_them(load: Any, text: str, value: float) -> None:
    """YAML 1.1, PyYAML's own rule, takes 1e0 for a text and 02 for an octal number."""
    assert load(f"cable: {{length_m: {text}}}").cable.length_m == value


def test_a_byte_order_mark_and_windows_line_ends_are_read(load: Any) -> None:
    assert load(b"\xef\xbb\xbfpayload:\r\n  mass_kg: 0.4\r\n").payload.mass_kg == 0.4


def test_anchors_are_read(load: Any) -> None:
    parameters = load("payload: {mass_kg: &m 0.7}\nvehicle: {mass_kg: *m}\n")
    assert parameters.payload.mass_kg == parameters.vehicle.mass_kg == 0.7


# Overrides


def test_overrides_win_over_the_file_and_later_ones_over_earlier(load: Any) -> None:
    text = "payload: {mass_kg: 0.2}\n"
    assert load(text, "payload.mass_kg=0.4").payload.mass_kg == 0.4
    assert load(text, "payload.mass_kg=0.4", "payload.mass_kg=5e-1").payload.mass_kg == 0.5


def test_overrides_take_any_kind_of_value() -> None:
    parameters = load_parameters(
        None,
        [
            "mode=hold",
            "hold.vel_ned_mps=[1, 0, 0]",
            "control.enabled=false",
            " link.autopilot = serial:///dev/by-id/a=b:57600 ",
        ],
    )
    assert parameters.mode is Mode.HOLD
    assert parameters.hold.vel_ned_mps == (1.0, 0.0, 0.0)
    assert parameters.control.enabled is False
    assert parameters.link.autopilot == "serial:///dev/by-id/a=b:57600"


def test_an_override_mends_what_is_wrong_in_the_file(load: Any) -> None:
    assert load("payload: {mass_kg: heavy}\n", "payload.mass_kg=0.4").payload.mass_kg == 0.4


@pytest.mark.parametrize(
    ("override", "problem"),
    [
        ("payload.mass_kg", "payload.mass_kg (--set): no value given; expected KEY=VALUE, such as payload.mass_kg=0.4"),
        ("payload.mass_kg=", "payload.mass_kg (--set): nothing given; expected a number from 0.005 to 2000 kg"),
        ("payload.mass_kg=-1", "payload.mass_kg (--set): -1 given; expected a number from 0.005 to 2000 kg"),
        ("payload.mas_kg=1", "payload.mas_kg (--set): no such key; did you mean payload.mass_kg?"),
        ("paylod.mass=1", "paylod.mass (--set): no such key; did you mean payload.mass_kg?"),
        (
            "payload={mass_kg: 1}",
            "payload (--set): is a group of keys; expected one of them, such as payload.mass_kg",
        ),
        (
            "payload.mass_kg=[1",
            "payload.mass_kg (--set): '[1' given, line 1, column 3: not YAML: while parsing a flow sequence, "
            "expected ',' or ']', but got '<stream end>'; expected a number from 0.005 to 2000 kg",
        ),
        ("=1", " (--set): no such key; expected mode or a key of " + ", ".join(GROUPS)),
    ],
)
def test_what_is_said_about_a_wrong_override(problems: Any, override: str, problem: str) -> None:
    assert problems("", override) == [problem]


def test_a_number_of_any_length_is_refused_briefly(problems: Any) -> None:
    for override in (f"payload.mass_kg={'9' * 4000}", f"payload.mass_kg={'9' * 5000}"):
        (line,) = problems("", override)
        assert line.startswith("payload.mass_kg (--set): ")
        assert "99...99" in line
        assert line.endswith("expected a number from 0.005 to 2000 kg")
        assert len(line) < 350


def test_an_override_into_something_else_leaves_the_files_problem(problems: Any) -> None:
    assert problems("payload: 3\n", "payload.mass_kg=1") == [
        "payload (line 1): 3 given, but it is a group of keys; expected one of them, such as payload.mass_kg"
    ]


# Mistakes in files


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("mode: hovr", "mode (line 1): 'hovr' given; expected one of shadow, hold, inline"),
        ("mode:", "mode (line 1): nothing given; expected one of shadow, hold, inline"),
        ("\n\nmode: [hold]", "mode (line 3): ['hold'] given; expected one of shadow, hold, inline"),
        ("payload:\n  mass_kg: '1'", "payload.mass_kg (line 2): '1' given; expected a number from 0.005 to 2000 kg"),
        ("payload:\n  mass_kg: true", "payload.mass_kg (line 2): true given; expected a number from 0.005 to 2000 kg"),
        ("payload:\n  mass_kg: .nan", "payload.mass_kg (line 2): nan given; expected a number from 0.005 to 2000 kg"),
        ("payload:\n  mass_kg: .inf", "payload.mass_kg (line 2): inf given; expected a number from 0.005 to 2000 kg"),
        ("payload:\n  mass_kg: 1_0", "payload.mass_kg (line 2): '1_0' given; expected a number from 0.005 to 2000 kg"),
        ("cable:\n  length_m: 1:30", "cable.length_m (line 2): '1:30' given; expected a number from 0.1 to 200 m"),
        ("link:\n  system_id: 1.5", "link.system_id (line 2): 1.5 given; expected a whole number from 0 to 255"),
        ("link:\n  system_id: 256", "link.system_id (line 2): 256 given; expected a whole number from 0 to 255"),
        ("control:\n  enabled: 1", "control.enabled (line 2): 1 given; expected true or false"),
        (
            "control:\n  law: place",
            "control.law (line 2): 'place' given; expected one of placed, payload",
        ),
        (
            "link:\n  autopilot: 14540",
            "link.autopilot (line 2): 14540 given; expected a text of 1 to 200 printable characters",
        ),
        (
            "hold:\n  vel_ned_mps: [1, 2]",
            "hold.vel_ned_mps (line 2): [1, 2] given; expected a list of 3 numbers, each from -30 to 30 m/s",
        ),
        (
            "hold:\n  vel_ned_mps: []",
            "hold.vel_ned_mps (line 2): [] given; expected a list of 3 numbers, each from -30 to 30 m/s",
        ),
        (
            "hold:\n  vel_ned_mps: [1, 2, 3, 4]",
            "hold.vel_ned_mps (line 2): [1, 2, 3, 4] given; expected a list of 3 numbers, each from -30 to 30 m/s",
        ),
        (
            "hold:\n  vel_ned_mps:\n  - 1\n  - 31\n  - 0\n",
            "hold.vel_ned_mps (line 2): 31 as component 2 given; expected a list of 3 numbers, each from -30 to 30 m/s",
        ),
        (
            "payload:\n- mass_kg: 1\n",
            "payload (line 1): [{'mass_kg': 1}] given, but it is a group of keys; expected one of them, such as "
            "payload.mass_kg",
        ),
        (
            "hold:\n  x: 1",
            "hold.x (line 2): no such key; expected one of "
            + ", ".join(field.name for field in dataclasses.fields(Hold)),
        ),
        ("payload:\n  mass: 1", "payload.mass (line 2): no such key; did you mean payload.mass_kg?"),
        ("payload:\n  lenght_m: 1", "payload.lenght_m (line 2): no such key; did you mean cable.length_m?"),
        ("length_m: 1", "length_m (line 1): no such key; did you mean cable.length_m?"),
        ("mass_kg: 1", "mass_kg (line 1): no such key; did you mean vehicle.mass_kg or payload.mass_kg?"),
        ("vehicel:\n  mass_kg: 1", "vehicel (line 1): no such key; did you mean vehicle?"),
        ("payload.mass_kg: 1", "payload.mass_kg (line 1): no such key at this level; expected mass_kg inside payload"),
        ("cable:\n  length_m: {a: 1}", "cable.length_m (line 2): {'a': 1} given; expected a number from 0.1 to 200 m"),
        ("qqq: 1", "qqq (line 1): no such key; expected mode or a key of " + ", ".join(GROUPS)),
        ("- 1", "the file (line 1): [1] given; expected groups of keys, such as payload: {mass_kg: 0.3}"),
        ("# c\n42", "the file (line 2): 42 given; expected groups of keys, such as payload: {mass_kg: 0.3}"),
        ("1: 2", "1 (line 1): no such key; expected mode or a key of " + ", ".join(GROUPS)),
        ("? [a]\n: 2", "? (line 1): a list or mapping given; expected the name of a key"),
        ("payload:\n  ? {a: 1}\n  : 2", "payload.? (line 2): a list or mapping given; expected the name of a key"),
        (
            "payload:\n  mass_kg: 1\n  mass_kg: 1\n",
            "payload.mass_kg (line 3): given again, first on line 2; expected each key once",
        ),
        ("mode: hold\npayload:\nmode: hold", "mode (line 3): given again, first on line 1; expected each key once"),
    ],
)  # fmt: skip
def test_what_is_said_about_a_wrong_value(problems: Any, text: str, problem: str) -> None:
    assert problems(text) == [problem]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "mode: [",
            "line 1, column 8: not YAML: while parsing a flow node, expected the node content, but found "
            "'<stream end>'",
        ),
        ("a: b: c", "line 1, column 5: not YAML: mapping values are not allowed here"),
        (
            "mode: hold\n\tpayload:",
            "line 2, column 1: not YAML: while scanning for the next token, found character '\\t' that cannot start "
            "any token",
        ),
        (
            "a: 1\n---\nb: 2",
            "line 2, column 1: not YAML: expected a single document in the stream, but found another document",
        ),
        ("mode: *x", "line 1, column 7: not YAML: found undefined alias 'x'"),
        (
            "mode: !!python/name:os.system",
            "line 1, column 7: not YAML: could not determine a constructor for the tag "
            "'tag:yaml.org,2002:python/name:os.system'",
        ),
        ("payload: &p {mass_kg: *p}", "line 1, column 10: not YAML: found unconstructable recursive node"),
        ("payload:\n  mass_kg: !!int x", "not YAML: invalid literal for int() with base 10: 'x'"),
        (
            "mode: \x01",
            "not YAML: unacceptable character #x0001: special characters are not allowed in \"<unicode string>\", "
            "position 6",
        ),
        (b"mode: hold\npayload: \xff\n", "line 2: byte 0xff is not UTF-8; expected YAML in UTF-8"),
        ("mode: hold".encode("utf-16"), "line 1: byte 0xff is not UTF-8; expected YAML in UTF-8"),
        (
            "mode: " + "[" * DEPTH_MAX,
            f"line 1, column {6 + DEPTH_MAX}: not YAML: nested deeper than {DEPTH_MAX} levels",
        ),
        (b"#" * (SIZE_MAX + 1), "larger than 256 KiB; expected a configuration file in YAML"),
    ],
)  # fmt: skip
def test_what_is_said_about_a_file_that_is_no_configuration(refusal: Any, text: str | bytes, message: str) -> None:
    assert refusal(text) == message


def test_a_file_of_the_largest_size_is_read(load: Any) -> None:
    assert load(b"mode: hold\n" + b"#" * (SIZE_MAX - 11)).mode is Mode.HOLD


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_parameters(tmp_path / "no.yaml")
    assert str(caught.value) == f"{tmp_path}/no.yaml: No such file or directory; expected a configuration file in YAML"
    with pytest.raises(ConfigurationError, match="Is a directory; expected a configuration file"):
        load_parameters(tmp_path)
    with pytest.raises(ConfigurationError, match=re.escape(r"'a\x00b': embedded null byte; expected the path")):
        load_parameters("a\0b")


def test_ten_mistakes_of_one_file_are_reported_at_once(problems: Any) -> None:
    lines = problems(
        "mode: hovr\n"
        "vehicle:\n"
        "  mass_kg: -1\n"
        "  hook_frd_m: [0, 0, .nan]\n"
        "payload:\n"
        "  mas_kg: 0.4\n"
        "  mass_kg: 0.4\n"
        "  mass_kg: 0.5\n"
        "thrust:\n"
        "  voltage_nominal_v: 5.0\n"
        "  motor_output_max: 1000\n"
        "estimator:\n"
        "  name: ekf\n"
        "  rate_hz: fast\n"
        "control: on\n"
        "length_m: 2\n",
    )
    assert [line.split(": ")[0] for line in lines] == [
        "mode (line 1)",
        "vehicle.mass_kg (line 3)",
        "vehicle.hook_frd_m (line 4)",
        "payload.mas_kg (line 6)",
        "payload.mass_kg (line 8)",
        "thrust.voltage_nominal_v (line 10)",
        "thrust.motor_output_max (line 11)",
        "estimator.name (line 13)",
        "estimator.rate_hz (line 14)",
        "control (line 15)",
        "length_m (line 16)",
    ]


def test_a_refused_key_raises_no_second_problem(problems: Any) -> None:
    """Its default does not go together with the rest of the file, but the user never wrote it."""
    assert len(problems("vehicle: {mass_kg: -1}\npayload: {mass_kg: 300}\nthrust: {quadratic_n: 10000}\n")) == 1
    assert len(problems("vehicle: 1\npayload: {mass_kg: 300}\nthrust: {quadratic_n: 10000}\n")) == 1


def test_a_value_of_any_size_is_shown_briefly_and_on_one_line(problems: Any) -> None:
    for value in ('"' + "x\\n" * 5000 + '"', "[" + "[1, 2]," * 500 + "]", "{" + "a: 1," * 500 + "}", "9" * 4000):
        (line,) = problems(f"payload:\n  mass_kg: {value}\n")
        assert len(line) < 250
        assert "\n" not in line


def test_a_key_of_any_size_is_shown_briefly_and_printable(problems: Any) -> None:
    (line,) = problems('"\\e[2J' + "k" * 500 + '": 1\n')
    assert "\x1b" not in line
    assert line.startswith("\\x1b[2Jkkk")
    assert len(line) < 400


def test_a_file_that_doubles_itself_is_refused_in_bounded_time(problems: Any) -> None:
    """Each level holds the one below ten times: 1e9 values, if anything copied or formatted them all."""
    levels = "".join(f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 10)}]\n" for i in range(1, 10))
    for name in KEYS:
        *groups, last = name.split(".")
        value = f"{last}: *l9" if not groups else f"{groups[0]}: {{{last}: *l9}}"
        lines = problems(f"l0: &l0 [1]\n{levels}{value}\n")
        assert len(lines) == 11
        assert all(len(line) < 400 for line in lines)


# Nothing but ConfigurationError, whatever is read


@shares_a_folder
@given(st.binary(max_size=200))
@example(b"%YAML 9.9\n---\n")
@example(b"a: !!timestamp 2020-99-99")
@example(b"mode: 2020-99-99")
@example(b"mode: !!binary x")
@example(b"payload: {<<: [1]}")
@example(b"mode: !!set {a, [b]}")
@example(b"mode: {[1]: 2}")
@example(b'"\\ud800": 1')
@example(b'link: {autopilot: "\\ud800"}')
def test_any_bytes_are_read_or_refused(load: Any, content: bytes) -> None:
    with suppress(ConfigurationError):
        assert isinstance(load(content), Parameters)


names = st.sampled_from([*KEYS, *GROUPS, *(key.path[-1] for key in KEYS.values()), "x", "?", "<<"])
junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names | st.text(max_size=3), inner, max_size=4),
)


@shares_a_folder
@given(st.dictionaries(names, junk, max_size=5), st.lists(st.tuples(names, junk), max_size=3))
def test_any_tree_is_read_or_refused(load: Any, tree: dict[str, Any], overrides: list[tuple[str, Any]]) -> None:
    text = yaml.safe_dump(tree)
    sets = [f"{name}={yaml.safe_dump(value, default_flow_style=True)}" for name, value in overrides]
    with suppress(ConfigurationError):
        assert isinstance(load(text, *sets), Parameters)


@given(st.text(max_size=40))
def test_any_override_is_read_or_refused(override: str) -> None:
    with pytest.raises(ConfigurationError, match=r"^configuration: 1 problem\n"):
        load_parameters(None, [override])


@given(st.text(max_size=60) | junk.map(json.dumps))
@example("[" * 100_000)
@example("9" * 5000)
@example('{"payload": {"mass_kg": NaN}}')
def test_any_json_is_read_or_refused(text: str) -> None:
    with suppress(ConfigurationError):
        assert isinstance(parameters_from_json(text), Parameters)


# Round trips


def as_written(parameters: Parameters) -> dict[str, str]:
    """Every value as text, so that -0.0 is not 0.0 and 1 is not 1.0."""
    return {name: repr(value_of(parameters, name)) for name in KEYS}


@given(parameter_sets())
def test_json_keeps_every_bit(parameters: Parameters) -> None:
    text = parameters_to_json(parameters)
    assert "\n" not in text
    assert as_written(parameters_from_json(text)) == as_written(parameters)


@given(
    parameter_sets(), st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Zs", "Zl")), max_size=30)
)
def test_a_dump_says_what_was_given(parameters: Parameters, head: str) -> None:
    """PyYAML, which reads YAML by other rules for numbers, finds the same values in it."""
    text = dump_parameters(parameters, head, {"payload.mass_kg": "weighed: [twice]"})
    assert "weighed: [twice]" in text
    assert yaml.safe_load(text) == nested(parameters)


@shares_a_folder
@given(st.sampled_from(list(KEYS.values())).flatmap(lambda key: st.tuples(st.just(key), values(key))))
def test_a_dump_and_an_override_load_as_the_same_values(load: Any, chosen: tuple[Any, Any]) -> None:
    key, value = chosen
    parts: dict[str, Any] = nested(Parameters())
    group = parts if len(key.path) == 1 else parts[key.path[0]]
    group[key.path[-1]] = plain(value)
    parameters = parameters_from_json(json.dumps(parts))
    if any(check.find(parameters) for check in CHECKS):
        with pytest.raises(ConfigurationError):
            load(dump_parameters(parameters))
        return
    assert as_written(load(dump_parameters(parameters))) == as_written(parameters)
    assert as_written(load("", f"{key.name}={yaml_text(value)}")) == as_written(parameters)


def test_a_dump_names_every_key_with_unit_range_and_meaning() -> None:
    text = dump_parameters(dataclasses.replace(Parameters(), payload=Payload(mass_kg=math.pi)), "Title\n\nmore")
    assert text.startswith("# Title\n#\n# more\n\n# shadow: ")
    assert (
        "# The load.\npayload:\n"
        "  # mass of the load with its hook and half of the cable [kg, 0.005 .. 2000]\n"
        "  mass_kg: 3.141592653589793\n"
    ) in text


def test_json_accepts_values_that_do_not_go_together() -> None:
    heavy = dataclasses.replace(Parameters(), payload=Payload(mass_kg=500.0))
    assert parameters_from_json(parameters_to_json(heavy)) == heavy


def test_json_problems_name_the_keys() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parameters_from_json('{"payload": {"mass_kg": NaN, "x": 1}, "mode": "no"}')
    assert str(caught.value) == (
        "parameters: 3 problems\n"
        "  payload.x: no such key; expected one of mass_kg\n"
        "  mode: 'no' given; expected one of shadow, hold, inline\n"
        "  payload.mass_kg: nan given; expected a number from 0.005 to 2000 kg"
    )
