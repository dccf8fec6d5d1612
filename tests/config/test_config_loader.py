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
from swingd.config.plain import parameters_to_json, plain
from swingd.config.reader import DEPTH_MAX
from swingd.config.render import dump_parameters, yaml_text
from swingd.config.schema import GROUPS, ITEM_KEYS, KEYS, LIST_MAX, value_of
from swingd.config.source import SIZE_MAX
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import (
    Control,
    Endpoint,
    Estimator,
    Hold,
    Link,
    Mode,
    Parameters,
    Payload,
    ShaperName,
    ThrustSource,
    Waypoint,
)

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


TWO = """\
endpoints:
  - url: udpin://127.0.0.1:14541
    shaper: zv
  - url: tcpin://0.0.0.0:5760
    key_file: /etc/swingd/gcs.key
    system_ids: [255]
"""
TWO_READ = (
    Endpoint(url="udpin://127.0.0.1:14541", shaper=ShaperName.ZV),
    Endpoint(url="tcpin://0.0.0.0:5760", key_file="/etc/swingd/gcs.key", system_ids=(255,)),
)


def test_endpoints_are_a_list(load: Any) -> None:
    assert load(TWO).endpoints == TWO_READ
    assert load("endpoints: [{}]").endpoints == (Endpoint(),)


@pytest.mark.parametrize("text", ["endpoints:\n", "endpoints: []\n", "endpoints:\n  # - url: udpin://:14541\n"])
def test_a_list_without_groups_is_empty(load: Any, text: str) -> None:
    assert load(text).endpoints == ()


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


def test_a_list_is_overridden_whole_or_by_its_places(load: Any) -> None:
    one = 'endpoints=[{url: "udpin://:14541"}]'
    first, second = TWO_READ
    assert load_parameters(None, [one]).endpoints == (Endpoint(url="udpin://:14541"),)
    assert load(TWO, one).endpoints == (Endpoint(url="udpin://:14541"),)
    assert load(TWO, "endpoints=[]").endpoints == load(TWO, "endpoints=null").endpoints == ()
    assert load(TWO, "endpoints.1.shaper=ei").endpoints == (dataclasses.replace(first, shaper=ShaperName.EI), second)
    assert load(TWO, "endpoints.2.system_ids=[]").endpoints == (first, dataclasses.replace(second, system_ids=()))
    assert load(TWO, "endpoints.3.url=udpin://:1").endpoints == (*TWO_READ, Endpoint(url="udpin://:1"))
    assert load("", "endpoints.1.shaper=zvd").endpoints == (Endpoint(shaper=ShaperName.ZVD),)
    assert load("endpoints:\n", "endpoints.1.shaper=zvd").endpoints == (Endpoint(shaper=ShaperName.ZVD),)
    later = load(TWO, "endpoints.1.shaper=ei", one, "endpoints.1.shaper=zv")
    assert later.endpoints == (Endpoint(url="udpin://:14541", shaper=ShaperName.ZV),)


def test_an_override_mends_what_is_wrong_in_the_file(load: Any) -> None:
    assert load("payload: {mass_kg: heavy}\n", "payload.mass_kg=0.4").payload.mass_kg == 0.4
    assert load("endpoints: [{url: 1, shaper: 2}]", "endpoints=[{}]").endpoints == (Endpoint(),)
    assert load("endpoints: [{shaper: 2}]", "endpoints.1.shaper=zv").endpoints == (Endpoint(shaper=ShaperName.ZV),)


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
        ("endpoints.1={}", "endpoints.1 (--set): is a group of keys; expected one of them, such as endpoints.1.url"),
        ("endpoints.1.ulr=x", "endpoints.1.ulr (--set): no such key; did you mean endpoints.1.url?"),
        ("endpoints.0.url=x", "endpoints.0.url (--set): no such key; did you mean endpoints.1.url?"),
        ("endpoints.17.url=x", "endpoints.17.url (--set): no such key; did you mean endpoints.1.url?"),
        ("endpoints.url=x", "endpoints.url (--set): no such key; did you mean endpoints.1.url?"),
        (
            "endpoints.2.url=udpin://:1",
            "endpoints.2.url (--set): the list has 0 so far; expected a place from 1 to 1",
        ),
        (
            "endpoints.1.shaper=no",
            "endpoints.1.shaper (--set): false given; expected one of none, zv, zvd, ei",
        ),
        (
            "endpoints=[{url: a, url: b}]",
            "endpoints.1.url (--set): given again, first in --set; expected each key once",
        ),
        (
            "endpoints=[{}, {url: 'udpin://:1', shapr: zv}]",
            "endpoints.2.shapr (--set): no such key; did you mean endpoints.2.shaper?",
        ),
        ("endpoints=[{1: 2}]", "endpoints.1.1 (--set): no such key; expected one of url, shaper, key_file, system_ids"),
        (
            "endpoints=udpin://:14541",
            "endpoints (--set): 'udpin://:14541' given; expected a list of at most 16 groups of url, shaper, key_file, "
            "system_ids",
        ),
        ("=1", " (--set): no such key; expected mode, endpoints, waypoints or a key of " + ", ".join(GROUPS)),
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


def test_an_override_of_a_list_forgets_where_the_file_had_its_values(problems: Any) -> None:
    assert problems(TWO, 'endpoints=[{url: "tcpin://:1"}, {url: "tcpin://:1"}]') == [
        "endpoints.2.url (--set): tcpin://:1 takes TCP port 1, as endpoints.1.url does; expected one of its own"
    ]


def test_an_override_into_something_else_leaves_the_files_problem(problems: Any) -> None:
    item = "expected a group of keys, such as {url: udpin://127.0.0.1:14541}"
    assert problems("endpoints: [x]\n", "endpoints.1.shaper=zv") == [f"endpoints.1 (line 1): 'x' given; {item}"]
    listed = "expected a list of at most 16 groups of url, shaper, key_file, system_ids"
    assert problems("endpoints: x\n", "endpoints.1.shaper=zv") == [f"endpoints (line 1): 'x' given; {listed}"]
    assert problems("payload: 3\n", "payload.mass_kg=1") == [
        "payload (line 1): 3 given, but it is a group of keys; expected one of them, such as payload.mass_kg"
    ]


# Mistakes in files


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("mode: hovr", "mode (line 1): 'hovr' given; expected one of shadow, hold, inline, path"),
        ("mode:", "mode (line 1): nothing given; expected one of shadow, hold, inline, path"),
        ("\n\nmode: [hold]", "mode (line 3): ['hold'] given; expected one of shadow, hold, inline, path"),
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
        (
            "endpoints:\n  - udpin://:14541\n",
            "endpoints.1 (line 2): 'udpin://:14541' given; expected a group of keys, such as "
            "{url: udpin://127.0.0.1:14541}",
        ),
        (
            "endpoints:\n  -\n",
            "endpoints.1 (line 2): nothing given; expected a group of keys, such as {url: udpin://127.0.0.1:14541}",
        ),
        (
            "endpoints:\n  url: udpin://:14541\n",
            "endpoints (line 1): {'url': 'udpin://:14541'} given; expected a list of at most 16 groups of url, shaper, "
            "key_file, system_ids",
        ),
        (
            "endpoints: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]",
            "endpoints (line 1): [1, 1, 1, 1, 1, 1, ...] given; expected a list of at most 16 groups of url, shaper, "
            "key_file, system_ids",
        ),
        (
            "endpoints:\n- shaper: none\n- url: udpin://:1\n  ulr: x\n",
            "endpoints.2.ulr (line 4): no such key; did you mean endpoints.2.url?",
        ),
        (
            "endpoints:\n- port: 1\n",
            "endpoints.1.port (line 2): no such key; expected one of url, shaper, key_file, system_ids",
        ),
        (
            "endpoints:\n- system_ids:\n  - 1\n  - 256\n",
            "endpoints.1.system_ids (line 2): 256 as component 2 given; expected a list of at most 16 whole numbers, "
            "each from 1 to 255",
        ),
        (
            "endpoints:\n- system_ids: 255\n",
            "endpoints.1.system_ids (line 2): 255 given; expected a list of at most 16 whole numbers, each from 1 to "
            "255",
        ),
        (
            "endpoints:\n- url: udpin://:1\n  url: udpin://:2\n",
            "endpoints.1.url (line 3): given again, first on line 2; expected each key once",
        ),
        (
            "endpoints:\n- ? [a]\n  : 2\n",
            "endpoints.1.? (line 2): a list or mapping given; expected the name of a key",
        ),
        ("link:\n  url: x", "link.url (line 2): no such key; did you mean endpoints.1.url?"),
        ("key_file: x", "key_file (line 1): no such key; did you mean link.key_file or endpoints.1.key_file?"),
        ("endpoint:\n- url: x", "endpoint (line 1): no such key; did you mean endpoints?"),
        ("qqq: 1", "qqq (line 1): no such key; expected mode, endpoints, waypoints or a key of " + ", ".join(GROUPS)),
        ("- 1", "the file (line 1): [1] given; expected groups of keys, such as payload: {mass_kg: 0.3}"),
        ("# c\n42", "the file (line 2): 42 given; expected groups of keys, such as payload: {mass_kg: 0.3}"),
        ("1: 2", "1 (line 1): no such key; expected mode, endpoints, waypoints or a key of " + ", ".join(GROUPS)),
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


def test_every_mistake_in_a_list_is_reported_at_once(problems: Any) -> None:
    lines = problems(
        "link: {autopilot: 'serial:///dev/ttyS0:57600'}\n"
        "endpoints:\n"
        "- url: udpin:14541\n"
        "  shaper: zb\n"
        "- shapr: zv\n"
        "  url: udpin://:14550\n"
        "- here\n"
        "- url: udpin://0.0.0.0:14550\n"
        "  system_ids: [0]\n"
        "- url: 14550\n"
        "- url: serial:///dev/ttyS0:921600\n"
        "  url: serial:///dev/ttyS0:921600\n"
        "- url: tcp4://:1\n"
    )
    assert [line.split(": ")[0] for line in lines] == [
        "endpoints.1.url (line 3)",
        "endpoints.1.shaper (line 4)",
        "endpoints.2.shapr (line 5)",
        "endpoints.3 (line 7)",
        "endpoints.4.url (line 8)",
        "endpoints.4.system_ids (line 9)",
        "endpoints.5.url (line 10)",
        "endpoints.6.url (line 12)",
        "endpoints.7.url (line 13)",
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
    for key in (*KEYS.values(), *ITEM_KEYS):
        value = "*l9"
        for part in reversed(key.path[1:]):
            value = f"[{value}]" if part == "N" else f"{{{part}: {value}}}"
        value = f"{key.path[0]}: {value}"
        lines = problems(f"l0: &l0 [1]\n{levels}{value}\n")
        assert len(lines) == 10 + (10 if key.sizes == (0, LIST_MAX) else 1)
        assert all(len(line) < 400 for line in lines)


def test_a_list_that_repeats_a_large_group_is_refused_in_bounded_time(problems: Any) -> None:
    large = "&m {" + ", ".join(f"k{index}: 1" for index in range(2000)) + "}"
    assert len(problems(f"x: {large}\nendpoints: [{'*m, ' * 10_000}]\n")) == 2


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
@example(b"endpoints: [{[1]: 2}, {<<: {url: 1}}, !!set {url}]")
@example(b"endpoints: &e [*e]")
@example(b"endpoints: [&e {url: *e}]")
@example(b"endpoints: !!set {}")
@example(b'"\\ud800": 1')
@example(b'link: {autopilot: "\\ud800"}')
def test_any_bytes_are_read_or_refused(load: Any, content: bytes) -> None:
    with suppress(ConfigurationError):
        assert isinstance(load(content), Parameters)


names = st.sampled_from(
    [*KEYS, *GROUPS, *(key.path[-1] for key in (*KEYS.values(), *ITEM_KEYS)), "x", "?", "<<"]
    + [key.name.replace("N", place) for key in ITEM_KEYS for place in ("1", "2", "17", "N")]
)
junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names | st.text(max_size=3), inner, max_size=4),
)


@shares_a_folder
@given(st.dictionaries(names, junk, max_size=5), st.lists(st.tuples(names, junk), max_size=3))
@example({"endpoints": [{"url": None, "x": [1]}, 3]}, [("endpoints.2.url", 1), ("endpoints.3.shaper", "zv")])
@example({"endpoints": {"1": {"url": "x"}}}, [("endpoints.1.url", "x")])
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
@example('{"endpoints": [{"url": [], "system_ids": [1e999]}, null, [], {"x": 1}]}')
@example('{"endpoints": {"1": 1}}')
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
    assert yaml.safe_load(text) == plain(parameters)


@shares_a_folder
@given(st.sampled_from([*KEYS.values(), *ITEM_KEYS]).flatmap(lambda key: st.tuples(st.just(key), values(key))))
def test_a_dump_and_an_override_load_as_the_same_values(load: Any, chosen: tuple[Any, Any]) -> None:
    key, value = chosen
    parts: dict[str, Any] = plain(Parameters())
    parts["endpoints"] = [plain(Endpoint(url="udpin://:14542"))]
    parts["waypoints"] = [plain(Waypoint(north_m=1.0))]
    group: Any = parts
    for part in key.path[:-1]:
        group = group[0] if part == "N" else group[part]
    group[key.path[-1]] = plain(value)
    parameters = parameters_from_json(json.dumps(parts))
    if any(check.find(parameters) for check in CHECKS):
        with pytest.raises(ConfigurationError):
            load(dump_parameters(parameters))
        return
    assert as_written(load(dump_parameters(parameters))) == as_written(parameters)
    items = "endpoints.1.url=udpin://:14542", "waypoints.1.north_m=1.0"
    override = f"{key.name.replace('N', '1')}={yaml_text(value)}"
    assert as_written(load("", *items, override)) == as_written(parameters)


def test_a_dump_names_every_key_with_unit_range_and_meaning() -> None:
    text = dump_parameters(dataclasses.replace(Parameters(), payload=Payload(mass_kg=math.pi)), "Title\n\nmore")
    assert text.startswith("# Title\n#\n# more\n\n# shadow: ")
    assert (
        "# The load.\npayload:\n"
        "  # mass of the load with its hook and half of the cable [kg, 0.005 .. 2000]\n"
        "  mass_kg: 3.141592653589793\n"
    ) in text


def test_a_dump_of_a_list_says_once_what_its_keys_mean() -> None:
    parameters = dataclasses.replace(Parameters(), endpoints=TWO_READ)
    text = dump_parameters(parameters, notes={"endpoints.2.url": "the tablet", "endpoints.1.shaper": "gentle"})
    assert (
        "\n\n# what applications and ground stations connect to\n"
        "#   url: link by URL; an empty host that waits means this machine alone\n"
    ) in text
    assert (
        "#   system_ids: system ids that may send here; empty: any [1 .. 255]\n"
        "endpoints:\n"
        '  - url: "udpin://127.0.0.1:14541"\n'
        "    shaper: zv  # gentle\n"
        "    key_file: none\n"
        "    system_ids: []\n"
        '  - url: "tcpin://0.0.0.0:5760"  # the tablet\n'
        "    shaper: none\n"
        '    key_file: "/etc/swingd/gcs.key"\n'
        "    system_ids: [255]\n\n"
    ) in text
    assert "[1 .. 255]\nendpoints: []\n\n" in dump_parameters(Parameters())


def test_json_accepts_values_that_do_not_go_together() -> None:
    heavy = dataclasses.replace(Parameters(), payload=Payload(mass_kg=500.0))
    assert parameters_from_json(parameters_to_json(heavy)) == heavy


def test_json_problems_name_the_keys() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parameters_from_json('{"payload": {"mass_kg": NaN, "x": 1}, "mode": "no", "endpoints": [{"shaper": 1}, 2]}')
    assert str(caught.value) == (
        "parameters: 5 problems\n"
        "  payload.x: no such key; expected one of mass_kg, estimate_mass\n"
        "  endpoints.2: 2 given; expected a group of keys, such as {url: udpin://127.0.0.1:14541}\n"
        "  mode: 'no' given; expected one of shadow, hold, inline, path\n"
        "  payload.mass_kg: nan given; expected a number from 0.005 to 2000 kg\n"
        "  endpoints.1.shaper: 1 given; expected one of none, zv, zvd, ei"
    )


def test_a_record_from_before_there_were_endpoints_has_none() -> None:
    values = plain(Parameters())
    del values["endpoints"]
    assert parameters_from_json(json.dumps(values)) == Parameters()
