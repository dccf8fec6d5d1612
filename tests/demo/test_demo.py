"""The demonstration itself: two live flights, as ``make demo`` flies them, at twice real time."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from swingd.demo.figures import STALL_MS

ROOT = Path(__file__).parents[2]


def fly(picture: Path) -> dict[str, Any]:
    """What the demonstration tells; flown again, at most twice, where the machine stood still meanwhile."""
    options = ("-c", str(ROOT / "configs/demo.yaml"), "-o", str(picture), "--json", "--set", "simulation.speed=2")
    for _ in range(3):
        run = subprocess.run(
            [sys.executable, "-m", "swingd", "demo", *options],
            capture_output=True,
            text=True,
            timeout=400,
            cwd=picture.parent,
        )
        assert run.returncode == 0, run.stderr
        told: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
        if told["setpoint_gap_ms"] <= STALL_MS:
            break
    return told


@pytest.mark.live
@pytest.mark.long
def test_demo_damps_the_swing_and_tells_it_as_json(tmp_path: Path) -> None:
    picture = tmp_path / "demo.png"
    told = fly(picture)
    assert told["rms_deg_on"] <= 0.45 * told["rms_deg_off"], told
    assert told["settle_2deg_s_on"] <= 1.1 * told["period_s"], told
    assert told["settle_2deg_s_off"] >= 5.0 * told["period_s"], told
    assert told["angle_rmse_deg"] <= 1.0, told
    assert told["velocity_rmse_mps_on"] <= 1.4 * told["velocity_rmse_mps_off"], told
    assert told["filter_hz"] == pytest.approx(100.0, rel=0.01)
    assert told["peak_deg_on"] < told["peak_deg_off"]
    assert told["rate_rmse_deg_s"] > 0.0
    assert told["latency_ms_p50"] <= told["latency_ms_p99"]
    assert told["cpu_percent"] > 0.0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.live
def test_a_daemon_that_cannot_start_is_told(tmp_path: Path) -> None:
    # The load cannot be lifted with this thrust: the configuration is refused before anything flies.
    run = subprocess.run(
        [sys.executable, "-m", "swingd", "demo", "--set", "payload.mass_kg=3.5", "-o", str(tmp_path / "no.png")],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert run.returncode == 78
    assert "payload.mass_kg" in run.stderr
