"""The benchmark runs, and what it measures is what the design counts on."""

import json
import math
import subprocess
import sys
from pathlib import Path

TOOL = Path(__file__).resolve().parents[2] / "tools" / "bench.py"


def test_a_quick_run_says_how_the_parts_compare() -> None:
    run = subprocess.run(
        [sys.executable, TOOL, "--json", "--quick"], capture_output=True, text=True, check=True, timeout=120
    )
    results = {result["name"].split(" (")[0]: result for result in json.loads(run.stdout)["results"]}
    for result in results.values():
        assert math.isfinite(result["ratio"])
        assert result["value"] > 0.0
    assert results["codec: parse HIGHRES_IMU"]["ratio"] > 1.2
    assert results["filter: one step"]["ratio"] > 20.0
    assert results["engine: share of a core in flight"]["value"] < 15.0
    assert results["lockstep: simulated PX4 and engine"]["ratio"] > 1.0
    assert results["replay: a recording"]["ratio"] > 1.0
