"""The files of configs/ and what is derived from the declarations."""

import dataclasses
import itertools
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from swingd.config.loader import load_parameters
from swingd.config.render import dump_parameters
from swingd.config.schema import KEYS
from swingd.model.parameters import Mode, ShaperName, ThrustSource

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "configs.py"
LISTS = {key.name: list(key.item.every_key()) for key in KEYS.values() if key.item is not None}
"""The keys of the groups of each list."""
FILES = sorted((ROOT / "configs").glob("*.yaml"))


def run_tool(root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, TOOL, "--root", root, *options], capture_output=True, text=True, check=False, timeout=60
    )


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    (tmp_path / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "configuration.md", tmp_path / "docs")
    return tmp_path


def test_the_configurations_are_there() -> None:
    assert {path.stem for path in FILES} >= {"x500", "demo", "inline", "iris", "gazebo", "optitrack"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_configuration_loads_and_names_every_key(path: Path) -> None:
    load_parameters(path)
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    given = [f"{group}.{key}" for group, keys in tree.items() if isinstance(keys, dict) for key in keys]
    given += [key for key, value in tree.items() if not isinstance(value, dict)]
    assert sorted(given) == sorted(KEYS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_key_of_a_configuration_has_its_comment(path: Path) -> None:
    lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    commented = [
        (above.removeprefix("# "), line.partition(":")[0])
        for above, line in itertools.pairwise(lines)
        if above.startswith("# ") and ": " in line and not line.startswith("#")
    ]
    single = [key for key in KEYS.values() if key.item is None]
    assert [name for _, name in commented if name not in LISTS] == [key.path[-1] for key in single]
    for (comment, _), key in zip(((c, n) for c, n in commented if n not in LISTS), single, strict=True):
        assert comment.startswith(key.text)
        assert key.unit in comment
        if key.low is not None:
            assert comment.endswith(f"{key.range}]")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_list_of_a_configuration_says_what_stands_in_it(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    for name, keys in LISTS.items():
        place = next(index for index, line in enumerate(lines) if line.startswith(f"{name}:"))
        above = lines[place - 1 - len(keys) : place]
        assert above[0] == f"# {KEYS[name].text}"
        for line, key in zip(above[1:], keys, strict=True):
            assert line.startswith(f"#   {key.path[-1]}: {key.text}")
            assert line.endswith(f"{key.range}]") or key.low is None


def test_everything_derived_is_current() -> None:
    """If this fails, run: python tools/configs.py."""
    result = run_tool(ROOT, "--check")
    assert result.returncode == 0, result.stdout


def test_a_stale_comment_is_found_and_mended_and_nothing_else_is_touched(copy: Path) -> None:
    path = copy / "configs" / "x500.yaml"
    original = path.read_text(encoding="utf-8")
    path.write_text(original.replace("# mass of the load", "# weight of the load"), encoding="utf-8")
    check = run_tool(copy, "--check")
    assert check.returncode == 1
    assert "-  # weight of the load with its hook" in check.stdout
    assert "+  # mass of the load with its hook" in check.stdout
    assert "run: python tools/configs.py" in check.stderr

    assert run_tool(copy).stdout == f"wrote {Path('configs') / 'x500.yaml'}\n"
    assert path.read_text(encoding="utf-8") == original
    assert run_tool(copy, "--check").returncode == 0


def test_a_value_a_head_and_a_note_belong_to_the_file(copy: Path) -> None:
    path = copy / "configs" / "mine.yaml"
    path.write_text(
        "# Mine\n#\n#   indented\npayload: {mass_kg: 0.4}\n"
        "hold:\n  vel_ned_mps: [1,   2,3]   #    along the field\n"
        "link:\n  autopilot: serial:///dev/tty#2:57600\n"
        "endpoints:\n"
        "- {url: udpin://:1}  # not behind a value\n"
        "-   url: udpin://:2   #  the second\n"
        "    shaper: zv\n",
        encoding="utf-8",
    )
    assert run_tool(copy).returncode == 0
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# Mine\n#\n#   indented\n\n# shadow: ")
    assert "\n  vel_ned_mps: [1.0, 2.0, 3.0]  # along the field\n" in text
    assert '\n  autopilot: "serial:///dev/tty#2:57600"\n' in text
    assert '\n  - url: "udpin://:1"\n    shaper: none\n' in text
    assert '\n  - url: "udpin://:2"  # the second\n    shaper: zv\n' in text
    assert load_parameters(path).payload.mass_kg == 0.4
    assert run_tool(copy, "--check").returncode == 0


def test_keys_and_groups_can_be_reset_in_all_files(copy: Path) -> None:
    assert run_tool(copy, "--reset", "thrust", "--reset", "vehicle.mass_kg", "--reset", "endpoints").returncode == 0
    default = load_parameters()
    for path in (copy / "configs").glob("*.yaml"):
        parameters = load_parameters(path)
        assert parameters.thrust == default.thrust
        assert parameters.vehicle.mass_kg == default.vehicle.mass_kg
        assert parameters.endpoints == ()
    assert load_parameters(copy / "configs" / "iris.yaml").vehicle.drag_n_per_mps == 0.35
    assert run_tool(copy, "--reset", "nothing").returncode == 2


def test_the_reference_names_every_key_with_default_unit_range_and_meaning() -> None:
    rows = {
        cells[0]: cells[1:]
        for line in (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("| `")
        for cells in [[cell.strip() for cell in line.strip("|").split("|")]]
    }
    keys = [key for name in KEYS for key in LISTS.get(name, [KEYS[name]])]
    assert list(rows) == [f"`{key.name}`" for key in keys]
    assert rows["`cable.length_m`"] == [
        "`1.5`", "m", "0.1 .. 200", "from the hook to the load's centre of mass", "`SWG_CABLE_LEN`"
    ]  # fmt: skip
    assert rows["`endpoints.N.shaper`"][:3] == ["`none`", "", "none, zv, zvd, ei"]
    for key in keys:
        row = rows[f"`{key.name}`"]
        assert row[1:4] == [key.unit, key.range, key.text]
        assert row[4:] in ([[f"`{key.mavlink}`"]] if key.mavlink else [[], [""]])


def test_the_editors_schema_is_json() -> None:
    schema = json.loads((ROOT / "configs" / "schema.json").read_text(encoding="utf-8"))
    assert schema["properties"].keys() == {key.path[0] for key in KEYS.values()}
    for path in FILES:
        assert path.read_text(encoding="utf-8").startswith("# yaml-language-server: $schema=schema.json\n")


def test_facts_of_the_x500() -> None:
    """Drones 2023, 7, 654, section 4.2."""
    parameters = load_parameters(ROOT / "configs" / "x500.yaml")
    assert parameters.vehicle.mass_kg == 2.0
    assert parameters.payload.mass_kg == 0.192
    assert parameters.cable.length_m == 1.9
    assert parameters.vehicle.hook_frd_m == (0.0, 0.0, 0.22)


def test_facts_of_the_example_in_line() -> None:
    parameters = load_parameters(ROOT / "configs" / "inline.yaml")
    application, ground_station = parameters.endpoints
    assert parameters.mode is Mode.INLINE
    assert parameters.link.autopilot.startswith("serial://")
    assert (application.url, application.shaper) == ("udpin://127.0.0.1:14541", ShaperName.ZV)
    assert (ground_station.url, ground_station.shaper) == ("udpout://127.0.0.1:14550", ShaperName.NONE)
    x500 = load_parameters(ROOT / "configs" / "x500.yaml")
    link = dataclasses.replace(parameters.link, autopilot=x500.link.autopilot)
    assert dataclasses.replace(parameters, mode=x500.mode, link=link, endpoints=()) == x500


def test_facts_of_the_demo() -> None:
    parameters = load_parameters(ROOT / "configs" / "demo.yaml")
    assert parameters.mode is Mode.HOLD
    assert parameters.endpoints == ()
    assert (parameters.vehicle.mass_kg, parameters.payload.mass_kg, parameters.cable.length_m) == (2.0, 0.3, 1.5)
    assert parameters.simulation.battery_empty_v < parameters.simulation.battery_full_v
    assert parameters.simulation.acc_noise_mps2 > 0.0


@pytest.mark.parametrize(
    ("throttle", "thrust_n"), [(0.0, 0.374), (0.3, 5.980), (0.5, 13.455), (0.8, 30.275), (1.0, 45.225)]
)
def test_the_thrust_curve_of_the_iris(throttle: float, thrust_n: float) -> None:
    """Recorded PX4 SITL flights: curve_thrust_setpoint_to_n_at_full_voltage of dev_1.yaml."""
    thrust = load_parameters(ROOT / "configs" / "iris.yaml").thrust
    curve = thrust.quadratic_n * throttle**2 + thrust.linear_n * throttle + thrust.offset_n
    assert curve == pytest.approx(thrust_n, abs=1e-3)


def test_facts_of_the_recorded_flights() -> None:
    iris = load_parameters(ROOT / "configs" / "iris.yaml")
    assert (iris.vehicle.mass_kg, iris.vehicle.drag_n_per_mps, iris.vehicle.drag_vertical_n_per_mps) == (1.5, 0.35, 0.1)
    assert (iris.thrust.voltage_nominal_v, iris.thrust.voltage_exponent) == (16.2, 2.0)
    gazebo = load_parameters(ROOT / "configs" / "gazebo.yaml")
    assert (gazebo.vehicle.mass_kg, gazebo.payload.mass_kg, gazebo.cable.length_m) == (1.5, 0.5, 2.0)
    assert gazebo.thrust.quadratic_n + gazebo.thrust.linear_n + gazebo.thrust.offset_n == 23.5
    assert gazebo.thrust.voltage_exponent == 0.0
    optitrack = load_parameters(ROOT / "configs" / "optitrack.yaml")
    assert (optitrack.vehicle.mass_kg, optitrack.payload.mass_kg) == (1.8306, 0.4623)
    assert optitrack.cable.length_m == 3.158
    assert optitrack.thrust.source is ThrustSource.REMARK_1


def test_a_dump_of_a_file_is_the_file_without_head_and_notes() -> None:
    path = ROOT / "configs" / "iris.yaml"
    assert load_parameters(path) == load_parameters(path, [])
    text = dump_parameters(load_parameters(path))
    kept = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("  #")]
    assert [line for line in text.splitlines() if line.startswith("  #")] == kept
