"""Independent flights against the limits that the estimator promises; only facts are set, no noise."""

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from swingd.cli.main import app

pytestmark = pytest.mark.data
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
FlightData = Callable[[str], Path]


def run(log: Path, config: str, table: Path, *options: str) -> dict[str, Any]:
    arguments = ["replay", str(log), "-c", str(CONFIGS / config), "-o", str(table), "--json", *options]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    with table.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            row.pop("health")
            assert all(math.isfinite(float(cell)) for cell in row.values())
    said: dict[str, Any] = json.loads(result.stdout)
    return said


@pytest.mark.parametrize(
    ("name", "facts", "window_s", "limit_deg"),
    [
        ("dev_1", {}, (17.76, 104.27), 0.6),
        ("dev_2", {}, (17.85, 115.5), 1.4),
        ("dev_3", {"payload.mass_kg": 0.5, "cable.length_m": 3.0}, (18.96, 108.57), 0.6),
    ],
)
def test_px4_sitl(
    flight_data: FlightData,
    tmp_path: Path,
    name: str,
    facts: dict[str, float],
    window_s: tuple[float, float],
    limit_deg: float,
) -> None:
    log, truth = flight_data(f"px4_sitl/{name}.tlog"), flight_data(f"px4_sitl/{name}_truth.csv.gz")
    settings = [word for key, value in facts.items() for word in ("--set", f"{key}={value}")]
    begin, end = (str(bound) for bound in window_s)
    said = run(log, "iris.yaml", tmp_path / "out.csv", *settings, "--truth", str(truth), "--from", begin, "--to", end)
    assert said["rows"] > 8000
    for axis in ("xi", "zeta"):
        assert said[axis]["rmse_deg"] <= limit_deg
        assert said[axis]["ratio"] <= 0.5


@pytest.mark.parametrize(
    ("log", "config", "limits_deg", "rows"),
    [
        ("gazebo_sitl/slung_load_dataset_small.csv", "gazebo.yaml", (3.3, 3.9), 3900),
        ("optitrack_flights/dataset_17.csv", "optitrack.yaml", (2.2, 2.2), 7500),
        ("optitrack_flights/dataset_19.csv", "optitrack.yaml", (2.5, 2.5), 6500),
    ],
)
def test_published_sets(
    flight_data: FlightData, tmp_path: Path, log: str, config: str, limits_deg: tuple[float, float], rows: int
) -> None:
    said = run(flight_data(log), config, tmp_path / "out.csv")
    assert said["rows"] > rows
    assert said["xi"]["rmse_deg"] <= limits_deg[0]
    assert said["zeta"]["rmse_deg"] <= limits_deg[1]
    assert said["xi"]["ratio"] < 0.6
    assert said["zeta"]["ratio"] < 0.6
