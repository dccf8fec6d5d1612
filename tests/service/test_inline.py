"""A real MAVSDK application, the daemon and the simulated autopilot, each a process of its own."""

import csv
import json
import math
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from ports import udp_port

pytestmark = [pytest.mark.live, pytest.mark.long]

APPLICATION = Path(__file__).with_name("offboard_application.py")
STAGES = ["discovered", "parameters", "mission", "in the air", "step", "velocity", "position", "landed"]
WINDOW_S = 12.0
SIMULATION = ("--set", "simulation.mavlink_bind_port=0")


@dataclass(frozen=True)
class Flown:
    """What one flight left behind."""

    stages: dict[str, dict[str, float]]
    t_s: np.ndarray
    chi_rad: np.ndarray
    vel_n_mps: np.ndarray

    @property
    def step_rms_deg(self) -> float:
        """Of the total swing over 12 s from the velocity step on."""
        begin = int(np.argmax(np.abs(self.vel_n_mps) > 0.5))
        window = (self.t_s >= self.t_s[begin]) & (self.t_s < self.t_s[begin] + WINDOW_S)
        return math.degrees(math.sqrt(np.mean(self.chi_rad[window] ** 2)))


def flown(output: str, truth: Path) -> Flown:
    stages = {line["stage"]: line for line in map(json.loads, output.splitlines())}
    with truth.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    t_s, xi, zeta, vel_n = (
        np.array([float(row[name]) for row in rows])
        for name in ("t_boot_s", "swing_lateral_rad", "swing_longitudinal_rad", "veh_vn_m_s")
    )
    # Of the cable's direction: lateral about the forward axis, then longitudinal.
    return Flown(stages, t_s, np.arccos(np.cos(xi) * np.cos(zeta)), vel_n)


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Flown]:
    """The same application directly, through swingd, and through swingd with shaping; at the same time."""
    folder = tmp_path_factory.mktemp("flights")
    swingd = [sys.executable, "-m", "swingd"]
    running: list[subprocess.Popen[str]] = []
    logs = []

    def fly(name: str, shaper: str | None) -> Flown:
        application, autopilot = udp_port(), udp_port()
        log = (folder / f"{name}.log").open("w", encoding="utf-8")
        logs.append(log)

        def begin(*arguments: str) -> None:
            running.append(subprocess.Popen([*swingd, *arguments], stdout=log, stderr=log, text=True))

        if shaper is not None:
            endpoint = json.dumps([{"url": f"udpout://127.0.0.1:{application}", "shaper": shaper}])
            begin(
                *("run", "--autopilot", f"udpin://127.0.0.1:{autopilot}", "--set", "mode=inline"),
                *("--set", f"endpoints={endpoint}"),
            )
        target = application if shaper is None else autopilot
        truth = folder / f"{name}.csv"
        begin("sim", "--mavlink", f"udpout://127.0.0.1:{target}", "--truth", str(truth), *SIMULATION)
        done = subprocess.run(
            [sys.executable, str(APPLICATION), f"udpin://127.0.0.1:{application}"],
            capture_output=True,
            text=True,
            timeout=150.0,
            check=False,
        )
        assert done.returncode == 0, done.stderr + done.stdout + (folder / f"{name}.log").read_text()
        return flown(done.stdout, truth)

    try:
        with ThreadPoolExecutor() as pool:
            waiting = {
                name: pool.submit(fly, name, shaper)
                for name, shaper in (("direct", None), ("through", "none"), ("shaped", "zv"))
            }
            return {name: future.result() for name, future in waiting.items()}
    finally:
        for process in running:
            process.send_signal(signal.SIGTERM)
        for process in running:
            process.wait(20.0)
        for log in logs:
            log.close()


@pytest.mark.parametrize("name", ["direct", "through", "shaped"])
def test_an_application_needs_no_change(flights: dict[str, Flown], name: str) -> None:
    stages = flights[name].stages
    assert list(stages) == STAGES
    assert stages["discovered"]["system_id"] == 1
    assert (stages["parameters"]["loss_action"], stages["parameters"]["loss_s"]) == (5, 1.0)
    assert stages["mission"]["items"] == 4
    assert stages["velocity"]["north_mps"] == pytest.approx(3.0, abs=0.4)
    assert stages["velocity"]["east_mps"] == pytest.approx(0.0, abs=0.4)
    assert stages["position"]["miss_m"] < 0.8


def test_its_load_swings_less(flights: dict[str, Flown]) -> None:
    direct, through, shaped = (flights[name].step_rms_deg for name in ("direct", "through", "shaped"))
    assert direct > 8.0
    assert through <= 0.45 * direct
    assert shaped <= 0.35 * direct
