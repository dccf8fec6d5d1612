"""Golden flights: what the engine computes changes only by intent."""

import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "golden.py"


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("golden_tool", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


golden = _load()


@pytest.mark.parametrize("name", golden.scenarios())
def test_flight_is_as_it_was(name: str) -> None:
    before = golden.from_text(golden.path_of(name).read_text(encoding="utf-8"))
    worst = golden.compare(before, golden.rows(golden.fly(golden.scenarios()[name])))
    assert worst.ratio <= 1.0, f"{worst.text}; if that is meant: {golden.REWRITE}, and read the diff"


@pytest.mark.parametrize("name", golden.scenarios())
def test_the_files_hold_a_flight_with_a_correction(name: str) -> None:
    table = golden.from_text(golden.path_of(name).read_text(encoding="utf-8"))
    assert len(table) > 100
    assert table[-1]["health"] == "active"
    assert max(math.hypot(float(row["acc_n_mps2"]), float(row["acc_e_mps2"])) for row in table) > 0.5
    assert max(math.hypot(float(row["xi_rad"]), float(row["zeta_rad"])) for row in table) > 0.15
    assert golden.to_text(table) == golden.path_of(name).read_text(encoding="utf-8")


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
    short = {"short": golden.Scenario(golden.Parameters(), (0.0, 0.0, 0.0), 0.0, 3.0)}
    monkeypatch.setattr(golden, "FOLDER", tmp_path)
    monkeypatch.setattr(golden, "scenarios", lambda: short)
    said: list[str] = []
    assert golden.main([], said.append) == 1
    assert "make golden" in said[-1]
    assert golden.main(["--write"], said.append) == 0
    assert golden.main([], said.append) == 0
    assert said[-1] == "short: identical"
    path = tmp_path / "short.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("init", "ready", 1), encoding="utf-8")
    assert golden.main([], said.append) == 1
