"""The command over whole logs."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from identify.flights import Flown, Truth, fly
from swingd.cli.main import app

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SETTINGS = ("vehicle.mass_kg=1.5", "payload.mass_kg=0.6", "cable.length_m=1.2", "thrust.source=remark_1")
FlightData = Callable[[str], Path]


def write_log(flown: Flown, path: Path) -> None:
    """Write the first flight in swingd's own CSV."""
    names = [f"acc_{axis}_frd_mps2" for axis in "xyz"] + [f"gyro_{axis}_frd_radps" for axis in "xyz"]
    names += ["roll_rad", "pitch_rad", "yaw_rad", "vn_mps", "ve_mps", "vd_mps", "armed", "landed"]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["t_boot_s", *names])
        streams = (flown.acc_frd[:, 0], flown.attitude[:, 0], flown.velocity[:, 0])
        for t_s, acc, attitude, velocity in zip(flown.t_s, *streams, strict=True):
            table.writerow([t_s, *acc, 0.0, 0.0, 0.0, *attitude, *velocity, 1, 0])


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["identify", *arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("identify") / "flight.csv"
    write_log(fly(Truth(), 1, 40.0, seed=6), path)
    return path


def test_table_lines_to_paste_and_picture(log: Path, tmp_path: Path) -> None:
    picture = tmp_path / "fit.png"
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    said = run(str(log), *settings, "-o", str(picture))
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "the configured value is outside" in " ".join(said.split())
    pasted = said.split("to paste:")[1]
    assert "payload:\n  mass_kg: 0." in pasted
    assert "cable:\n  length_m: 1." in pasted
    assert "estimator:\n  damping_ratio: 0.0" in pasted
    # No thrust curve was flown here: nothing can have been weighed.
    assert "unknown" in next(line for line in said.splitlines() if "hover thrust" in line)


def test_object(log: Path) -> None:
    said = json.loads(run(str(log), "--json", *(word for setting in SETTINGS for word in ("--set", setting))))
    truth = {"mass": 0.4, "length": 1.5, "damping": 0.015}
    for name, value in truth.items():
        assert said[name]["known"]["low"] <= value <= said[name]["known"]["high"]
        assert said[name]["agrees"] is False
    assert said["weighed_mass"]["known"] is None
    assert said["weighed_mass"]["note"]
    assert 30.0 < said["hanging_s"] < 40.0
    assert said["segments"] >= 4


def test_a_log_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "none.csv"
    path.write_text("a,b\n1,2\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["identify", str(path)])
    assert result.exit_code == 1
    assert str(path) in result.stderr


def from_data(log: Path, config: str) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(run(str(log), "-c", str(CONFIGS / config), "--json"))
    return said


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "config", "load_kg", "length_m", "weighed"),
    [
        ("px4_sitl/dev_1.tlog", "iris.yaml", 0.3, 1.5, False),
        ("px4_sitl/dev_2.tlog", "iris.yaml", 0.3, 1.5, False),
        ("px4_sitl/dev_3.tlog", "iris.yaml", 0.5, 3.0, True),
    ],
)
def test_px4_flights_with_one_configuration_for_all(
    flight_data: FlightData, name: str, config: str, load_kg: float, length_m: float, weighed: bool
) -> None:
    said = from_data(flight_data(name), config)
    for quantity, true in (("mass", load_kg), ("length", length_m)):
        known = said[quantity]["known"]
        assert known["low"] <= true <= known["high"]
        assert known["high"] - known["low"] < 0.15 * true
    # The air's drag on the load is quadratic and small: 0.002 to 0.01 of the critical damping.
    assert said["damping"]["known"]["low"] < 0.006
    assert said["damping"]["known"]["high"] < 0.025
    assert (said["weighed_mass"]["known"] is not None) is weighed
    if weighed:
        assert said["weighed_mass"]["known"]["low"] <= load_kg <= said["weighed_mass"]["known"]["high"]
        assert said["contradiction"] is None


@pytest.mark.data
def test_wide_swings_of_another_simulator(flight_data: FlightData) -> None:
    """Up to 75 deg; where in the load the cable of 2 m ends is not told."""
    said = from_data(flight_data("gazebo_sitl/slung_load_dataset_small.csv"), "gazebo.yaml")
    assert said["mass"]["known"]["low"] <= 0.5 <= said["mass"]["known"]["high"]
    assert said["length"]["known"]["value"] == pytest.approx(2.0, rel=0.05)
