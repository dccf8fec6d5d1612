"""The benchmark runs, and what it measures is what the design counts on."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.live, pytest.mark.alone]

ROOT = Path(__file__).resolve().parents[2]


def test_a_quick_run_says_how_the_parts_compare() -> None:
    command = [sys.executable, "-m", "tools.bench", "--json", "--quick"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=240)
    results = {result["name"].split(" (")[0]: result for result in json.loads(run.stdout)["results"]}
    for result in results.values():
        assert math.isfinite(result["ratio"])
        assert result["value"] > 0.0
    assert results["codec: parse HIGHRES_IMU"]["ratio"] > 1.2
    assert results["filter: one step"]["ratio"] > 20.0
    assert results["engine: share of a core in flight"]["value"] < 15.0
    assert results["lockstep: simulated PX4 and engine"]["ratio"] > 1.0
    assert results["replay: a recording"]["ratio"] > 1.0
    # Some 300 on a core of its own; an interpreted part in the loop would cost far more than a shared machine does.
    assert results["study: case 1, calm air"]["ratio"] > 50.0
    assert results["study: case 3, turbulence"]["ratio"] > 50.0
    assert results["frame: Port.receive"]["ratio"] > 1.5
    assert results["frame: Router.route"]["ratio"] > 4.0
    # Half a second on a machine whose bare interpreter starts in 25 ms, whatever else this one is doing.
    assert results["start: to the first forwarded frame"]["ratio"] > 0.05
    # At saturation the daemon reads many frames at a time, which makes up for looking at each.
    assert results["forward to 1, filter not joined: saturated"]["ratio"] > 0.25
    assert results["forward to 1, filter joined: share of a core"]["value"] < 40.0
