"""The unit files as ``make install`` stages them."""

import dataclasses
import inspect
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from swingd.cli.process import EXIT_CONFIG
from swingd.model.parameters import Control
from swingd.record.event_log import EventLogWriter
from swingd.service.daemon import HAND_BACK_SPARE_S
from swingd.service.state import StateFile

PROJECT = Path(__file__).resolve().parents[2]
SYSTEMD = PROJECT / "systemd"
EXAMPLES = SYSTEMD / "swingd.service.d.examples"
UNITS = Path("usr/local/lib/systemd/system")
EXPOSURE_MAX = 1.5

Make = Callable[..., "subprocess.CompletedProcess[str]"]

needs_systemd_analyze = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze, which judges units, is not on this machine"
)


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Runs a target of the Makefile, staged into ``tmp_path`` and with the environment of these tests."""

    def run(target: str, **variables: str) -> "subprocess.CompletedProcess[str]":
        given = {"DESTDIR": str(tmp_path), "VENV_READY": sys.prefix} | variables
        # A make that runs the tests must not hand its own variables on.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        return subprocess.run(
            ["make", "-C", str(PROJECT), target, *(f"{name}={value}" for name, value in given.items())],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )

    return run


def files_below(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def test_a_staged_installation_is_whole_and_its_removal_leaves_the_configuration(make: Make, tmp_path: Path) -> None:
    installed = make("install", PREFIX="/opt/own")
    assert installed.returncode == 0, installed.stderr
    assert files_below(tmp_path) == {
        "etc/swingd/swingd.yaml",
        "opt/own/share/swingd.service.d.examples/realtime.conf",
        "opt/own/share/swingd.service.d.examples/remote.conf",
        "usr/local/lib/systemd/system/swingd.service",
        "usr/local/lib/systemd/system/swingd@.service",
        "usr/local/lib/sysusers.d/swingd.conf",
    }
    for word in ("systemctl", "systemd-sysusers", "runuser"):
        assert word not in installed.stdout, "of this machine nothing is changed"

    mine = tmp_path / "etc/swingd/swingd.yaml"
    mine.write_text("mode: inline\n", encoding="utf-8")
    kept = tmp_path / "var/lib/swingd/default.json"
    kept.parent.mkdir(parents=True)
    kept.write_text("{}", encoding="utf-8")
    assert make("install", PREFIX="/opt/own").returncode == 0
    assert make("uninstall", PREFIX="/opt/own").returncode == 0
    assert files_below(tmp_path) == {"etc/swingd/swingd.yaml", "var/lib/swingd/default.json"}
    assert mine.read_text(encoding="utf-8") == "mode: inline\n"
    assert not (tmp_path / "opt/own").exists()


@pytest.mark.parametrize("target", ["install", "uninstall"])
@pytest.mark.parametrize(("name", "value"), [("PREFIX", ""), ("PREFIX", "/"), ("PREFIX", "opt"), ("DESTDIR", "stage")])
def test_a_place_that_would_be_another_than_meant_is_refused(
    target: str, name: str, value: str, make: Make, tmp_path: Path
) -> None:
    refused = make(target, **{name: value})
    assert refused.returncode != 0
    assert f"{name}: '{value}'; expected an absolute path below /" in refused.stderr
    assert files_below(tmp_path) == set()


@pytest.mark.parametrize("environment", ["venv", "/nowhere/venv"])
def test_an_environment_that_cannot_be_started_is_refused_before_anything_is_installed(
    environment: str, make: Make, tmp_path: Path
) -> None:
    refused = make("install", VENV_READY=environment)
    assert refused.returncode != 0
    assert f"VENV_READY: '{environment}'" in refused.stderr
    assert "expected an" in refused.stderr
    assert files_below(tmp_path) == set()


def test_units_start_what_was_installed(make: Make, tmp_path: Path) -> None:
    assert make("install").returncode == 0
    for name, configuration in (("swingd.service", "swingd"), ("swingd@.service", "%i")):
        settings = _settings((tmp_path / UNITS / name).read_text(encoding="utf-8"))
        assert f"ExecStart={sys.prefix}/bin/swingd run -c /etc/swingd/{configuration}.yaml" in settings


def test_a_vehicle_of_several_differs_by_its_folders_alone() -> None:
    one = _settings((SYSTEMD / "swingd.service").read_text(encoding="utf-8"))
    several = _settings((SYSTEMD / "swingd@.service").read_text(encoding="utf-8"))
    differing = {setting.split("=")[0] for setting in one ^ several}
    folders = {"RuntimeDirectory", "StateDirectory", "CacheDirectory", "Environment"}
    assert differing == folders | {"Description", "ExecStart"}
    for setting in several - one:
        assert "%i" in setting


def test_what_cannot_heal_is_not_started_again() -> None:
    for name in ("swingd.service", "swingd@.service"):
        settings = _settings((SYSTEMD / name).read_text(encoding="utf-8"))
        (line,) = (setting for setting in settings if setting.startswith("RestartPreventExitStatus="))
        assert str(EXIT_CONFIG) in line.split("=")[1].split()


def test_the_end_is_given_the_time_that_it_may_take() -> None:
    fade_out = next(field for field in dataclasses.fields(Control) if field.name == "fade_out_s")
    recording_s = inspect.signature(EventLogWriter.close).parameters["timeout_s"].default
    state_s = inspect.signature(StateFile.close).parameters["timeout_s"].default
    at_most_s = fade_out.metadata["high"] + HAND_BACK_SPARE_S + recording_s + 2 * state_s
    for name in ("swingd.service", "swingd@.service"):
        settings = _settings((SYSTEMD / name).read_text(encoding="utf-8"))
        (line,) = (setting for setting in settings if setting.startswith("TimeoutStopSec="))
        assert at_most_s + 2.0 < float(line.split("=")[1])


def _settings(unit: str) -> set[str]:
    return {line for line in unit.splitlines() if "=" in line and not line.startswith("#")}


@needs_systemd_analyze
@pytest.mark.parametrize("unit", ["swingd.service", "swingd@a.service"])
@pytest.mark.parametrize("drop_in", [None, "remote.conf", "realtime.conf"])
def test_systemd_finds_nothing_wrong_and_little_exposed(
    unit: str, drop_in: str | None, make: Make, tmp_path: Path
) -> None:
    assert make("install").returncode == 0
    folder = tmp_path / UNITS
    file = folder / unit.replace("@a.", "@.")
    if drop_in is not None:
        extended = folder / f"{file.name}.d"
        extended.mkdir()
        shutil.copy(EXAMPLES / drop_in, extended)

    verified = _analyze("verify", "--man=no", str(folder / unit))
    assert verified.returncode == 0, verified.stderr
    # An unknown setting is only told.
    assert [line for line in verified.stderr.splitlines() if "swingd" in line or "drop" in line] == []

    judged = _analyze("security", "--offline=true", f"--threshold={10 * EXPOSURE_MAX:.0f}", str(file))
    print(judged.stdout.splitlines()[-1])
    assert judged.returncode == 0, judged.stdout


def _analyze(*arguments: str) -> "subprocess.CompletedProcess[str]":
    environment = os.environ | {"SYSTEMD_COLORS": "0", "SYSTEMD_PAGER": ""}
    return subprocess.run(["systemd-analyze", *arguments], capture_output=True, text=True, env=environment, check=False)
