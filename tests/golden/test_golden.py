"""Golden flights: what the engine computes changes only by intent."""

import math
from functools import partial
from pathlib import Path

import pytest

from tools import golden, recorded_flight


@pytest.mark.parametrize("name", golden.flights())
def test_flight_is_as_it_was(name: str) -> None:
    before = golden.from_text(golden.path_of(name).read_text(encoding="utf-8"))
    worst = golden.compare(before, golden.rows(golden.flights()[name]()))
    assert worst.ratio <= 1.0, f"{worst.text}; if that is meant: {golden.REWRITE}, and read the diff"


@pytest.mark.parametrize("name", golden.flights())
def test_the_files_hold_a_flight_with_a_correction(name: str) -> None:
    table = golden.from_text(golden.path_of(name).read_text(encoding="utf-8"))
    assert len(table) > 100
    assert table[-1]["health"] == "active"
    assert max(math.hypot(float(row["acc_n_mps2"]), float(row["acc_e_mps2"])) for row in table) > 0.5
    assert max(math.hypot(float(row["xi_rad"]), float(row["zeta_rad"])) for row in table) > 0.15
    assert golden.to_text(table) == golden.path_of(name).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", recorded_flight.names())
def test_on_a_real_autopilot_the_estimate_shows_the_true_swing(name: str) -> None:
    lateral_deg, longitudinal_deg = recorded_flight.rmse_deg(name, recorded_flight.reports(name))
    assert max(lateral_deg, longitudinal_deg) < 0.6


def table(value: float = 0.5, health: str = "ready") -> list[dict[str, str]]:
    return [{"t_boot_s": f"{0.2 * k:.10g}", "xi_rad": f"{value * k:.12g}", "health": health} for k in range(5)]


def test_differences_within_the_last_bits_are_none() -> None:
    assert golden.compare(table(), table()).ratio == 0.0
    assert golden.compare(table(), table(0.5 * (1.0 + 5e-7))).ratio <= 1.0


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (table(0.5 * (1.0 + 3e-6)), "xi_rad at "),
        (table(math.nan), "xi_rad at 0 s"),
        (table()[:4], "5 rows became 4"),
        (table(health="fault"), "ready became fault"),
        ([], "5 rows became 0"),
    ],
)
def test_any_other_difference_is_told(now: list[dict[str, str]], words: str) -> None:
    worst = golden.compare(table(), now)
    assert worst.ratio > 1.0
    assert words in worst.text


def test_writing_makes_the_comparison_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = {"short": partial(golden.fly, golden.Scenario(golden.Parameters(), (0.0, 0.0, 0.0), 0.0, 3.0))}
    monkeypatch.setattr(golden, "FOLDER", tmp_path)
    monkeypatch.setattr(golden, "flights", lambda: short)
    said: list[str] = []
    assert golden.main([], said.append) == 1
    assert "make golden" in said[-1]
    assert golden.main(["--write"], said.append) == 0
    assert golden.main([], said.append) == 0
    assert said[-1] == "short: identical"
    path = tmp_path / "short.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("init", "ready", 1), encoding="utf-8")
    assert golden.main([], said.append) == 1
