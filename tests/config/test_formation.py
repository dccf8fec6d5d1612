"""The configuration of several vehicles with one load."""

import contextlib
import tempfile
from math import radians
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.config.formation import load_formation
from swingd.model.errors import ConfigurationError
from swingd.model.formation import FormationParameters, RiggedVehicle

EXAMPLE = Path(__file__).resolve().parents[2] / "configs" / "cooperate" / "two.yaml"
LEAST = """\
load: {pitch_std_deg: 5}
vehicles:
  - {system_id: 1, link: "udpin://:14601", tethers: [{length_m: 1.2, anchor_frd_m: [0, -0.2, -0.1]}]}
  - {system_id: 2, link: "udpin://:14602", tethers: [{length_m: 1.2, anchor_frd_m: [0, 0.2, -0.1]}]}
"""
WRONG = """\
system_id: 2
rate_hz: 500
late_s: 2
recrod: x
outputs: [udp:/x, "udpin://:14601"]
load: {pich_deg: 3, winch_pitch: [[0, 1], [0, 2]]}
vehicles:
  - system_id: 1
    link: udpin://:14601
    tethers: [{length_m: 0, anchor_frd_m: [1, 2]}]
    winsh: A
  - system_id: 1
    origin_ned_m: [0, 0, 0]
    link: udpin://0.0.0.0:14601
    tethers: [{length_m: 1.0, anchor_frd_m: [0, 1, .nan], winch_gain: 1}]
  - system_id: 2
    link: nonsense
"""


def load(tmp_path: Path, text: str) -> FormationParameters:
    file = tmp_path / "two.yaml"
    file.write_text(text, encoding="utf-8")
    return load_formation(file)


def problems(tmp_path: Path, text: str) -> list[str]:
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, text)
    return [line.strip() for line in str(caught.value).splitlines()[1:]]


def test_the_example_is_valid_and_its_units_are_turned() -> None:
    parameters = load_formation(EXAMPLE)
    assert [vehicle.system_id for vehicle in parameters.vehicles] == [1, 2]
    assert parameters.load.winch_pitch[0] == (-0.0361, radians(-20.0))
    assert parameters.vehicles[0].direction_std_rad == radians(1.0)
    assert parameters.vehicles[1].tethers[1].winch_gain == 1.0
    assert not parameters.origins_are_configured


def test_the_example_names_every_key() -> None:
    from swingd.config import formation

    text = EXAMPLE.read_text(encoding="utf-8")
    groups = (formation._Formation, formation._Load, formation._Vehicle, formation._Tether)
    for name in (name for group in groups for name in group.model_fields):
        assert f"{name}:" in text, name


def test_what_is_left_out_has_the_defaults_that_are_declared(tmp_path: Path) -> None:
    parameters = load(tmp_path, LEAST)
    vehicle = parameters.vehicles[0]
    declared = RiggedVehicle(1, "udpin://:14601", vehicle.tethers)
    assert vehicle.pos_std_m == declared.pos_std_m
    assert vehicle.hook_frd_m == declared.hook_frd_m
    assert vehicle.winch == ""
    assert parameters.rate_hz == FormationParameters(parameters.vehicles).rate_hz


def test_everything_that_is_wrong_is_told_at_once_with_its_line(tmp_path: Path) -> None:
    told = problems(tmp_path, WRONG)
    for beginning in (
        "system_id (line 1): 2 given, as in vehicles.3",
        "rate_hz (line 2): 500 given; expected less than or equal to 100",
        "late_s (line 3): 2 s given; expected less than lost_s",
        "recrod (line 4): no such key; did you mean record?",
        "outputs.1 (line 5): link URL 'udp:/x'",
        "outputs.2 (line 5): udpin://127.0.0.1:14601 takes UDP port 14601",
        "load.pich_deg (line 6): no such key; did you mean pitch_deg or pitch_std_deg?",
        "load.winch_pitch (line 6): given, but no vehicle has a winch",
        "load.winch_pitch (line 6): winch table, row 2",
        "load.pitch_std_deg (line 6): not given",
        "vehicles.1.tethers.1.length_m (line 10): 0 given",
        "vehicles.1.tethers.1.anchor_frd_m (line 10): [1, 2] given",
        "vehicles.1.winsh (line 11): no such key; did you mean winch?",
        "vehicles.1.origin_ned_m (line 8): not given, but others have one",
        "vehicles.2.system_id (line 12): 1 given, as in vehicles.1",
        "vehicles.2.link (line 14): udpin://0.0.0.0:14601 takes UDP port 14601",
        "vehicles.2.tethers.1.anchor_frd_m.3 (line 15): nan given; expected a finite number",
        "vehicles.2.tethers (line 15): a winch_gain without a winch",
        "vehicles.3.tethers (line 16): missing",
        "vehicles.3.link (line 17): link URL 'nonsense'",
    ):
        assert any(line.startswith(beginning) for line in told), (beginning, told)
    assert len(told) == 20


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "vehicles: missing"),
        ("[1, 2]", "the file: [1, 2] given"),
        ("vehicles: 3\n", "vehicles (line 1): 3 given"),
        ("vehicles: [1, 2]\n", "vehicles.1 (line 1): 1 given"),
        (LEAST.replace("load: {pitch_std_deg: 5}", "load: 7"), "load (line 1): 7 given"),
        (LEAST.replace("load: {pitch_std_deg: 5}", ""), "load: all anchors lie on one line"),
        (LEAST + "rate_hz: 50\nrate_hz: 20\n", "rate_hz (line 6): given again, first on line 5"),
        (LEAST.replace("14602", "14601").replace("udpin://:14601", "udpin://:146011", 1), "vehicles.1.link (line 3)"),
        (LEAST.replace("load: {pitch_std_deg: 5}", "").replace("-0.2", "1" + 400 * "0"), "vehicles.1.tethers.1.anchor"),
        (LEAST + f"late_s: {10**400}\n", "late_s (line 5)"),
        (LEAST.replace("system_id: 2", "system_id: yes"), "vehicles.2.system_id (line 4): true given"),
        (LEAST + 'outputs: ["udpout://h:1", 3]\n', "outputs.2 (line 5): 3 given"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, part: str) -> None:
    assert any(part in line for line in problems(tmp_path, text)), problems(tmp_path, text)


def test_vehicles_may_share_a_link(tmp_path: Path) -> None:
    parameters = load(tmp_path, LEAST.replace("14602", "14601"))
    assert parameters.vehicles[0].link == parameters.vehicles[1].link


@pytest.mark.parametrize("content", [b"\xff\xfe", b"a: [1", b"vehicles: &x [*x]"])
def test_what_is_no_yaml_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "two.yaml"
    file.write_bytes(content)
    with pytest.raises(ConfigurationError):
        load_formation(file)


leaf = st.one_of(
    st.none(), st.booleans(), st.integers(), st.just(10**400), st.floats(), st.text(max_size=5), st.just("udpin://:1")
)
KEYS = """vehicles load tethers outputs system_id link anchor_frd_m length_m winch winch_gain winch_pitch pitch_std_deg
    origin_ned_m late_s lost_s rate_hz nonsense"""
keys = st.sampled_from(KEYS.split())
anything = st.recursive(
    leaf, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=5), max_leaves=25
)


@given(st.dictionaries(keys, anything, max_size=6))
def test_whatever_a_file_holds_it_is_taken_or_refused(values: dict) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "two.yaml"
        file.write_text(yaml.safe_dump(values), encoding="utf-8")
        with contextlib.suppress(ConfigurationError):
            load_formation(file)


def test_the_command_checks_and_has_examples(tmp_path: Path) -> None:
    run = CliRunner().invoke
    checked = run(app, ["cooperate", "-c", str(EXAMPLE), "--check"])
    assert checked.exit_code == 0
    assert "valid; 2 vehicles, 4 tethers" in checked.output
    assert "configs/cooperate/two.yaml" in run(app, ["cooperate", "--help"]).output
    (tmp_path / "wrong.yaml").write_text(WRONG, encoding="utf-8")
    wrong = run(app, ["cooperate", "-c", str(tmp_path / "wrong.yaml")])
    assert wrong.exit_code == 78
    there = run(app, ["cooperate", "-c", str(EXAMPLE), "--record", str(EXAMPLE)])
    assert there.exit_code == 78
    url = run(app, ["cooperate", "-c", str(EXAMPLE), "--output", "here"])
    assert url.exit_code == 78
