"""The linear baseline flown by name: seen live, recorded, replayed, and beside the EKF and the pendulum."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import swingd
from swingd.cli.main import app
from swingd.config.loader import parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.model.actions import Health
from swingd.model.parameters import Parameters
from swingd.record.event_log import EventLogWriter
from swingd.record.truth import SwingTruth, read_truth, within
from swingd.replay import Replay, compare, replay
from swingd.sim.truth import TruthWriter

from .flight import Flight, hold

CONFIG = str(Path(__file__).resolve().parents[2] / "configs" / "x500.yaml")
SPEED_MPS = 3.0


def estimated_by(name: str) -> Parameters:
    parameters = hold()
    return replace(parameters, estimator=replace(parameters.estimator, name=name))


@dataclass(frozen=True)
class Recorded:
    """A step to 3 m/s corrected on the linear filter's estimate, and a stop without correction."""

    events: Path
    flight: Flight
    truth: SwingTruth
    stepped_s: float
    stopped_s: float
    health: tuple[Health, Health]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("fgdf")
    parameters = estimated_by("fgdf")
    log = EventLogWriter(folder / "flight.swingd", swingd.__version__, parameters_to_json(parameters))
    flight = Flight(parameters, log=log).take_off().enter_offboard().run(2.0)
    stepped_s = flight.t_s
    flight.reference = (SPEED_MPS, 0.0, 0.0)
    flight.run(5.0)
    corrected = flight.health
    flight.engine.switch_correction(flight.t_s, False)
    flight.run(0.5)
    stopped_s = flight.t_s
    flight.reference = (0.0, 0.0, 0.0)
    flight.run(5.0)
    log.close()
    with (folder / "truth.csv").open("w", encoding="utf-8", newline="\n") as text:
        writer = TruthWriter(text)
        for truth in flight.truths[::2]:
            writer.write(truth)
    truth = within(read_truth(folder / "truth.csv"), stepped_s)
    return Recorded(folder / "flight.swingd", flight, truth, stepped_s, stopped_s, (corrected, flight.health))


@pytest.fixture(scope="module")
def replayed(recorded: Recorded) -> Replay:
    """The recording as it was flown."""
    return replay(recorded.events, None, parameters_from_json)


def test_the_correction_on_its_estimate_damps_the_swing(recorded: Recorded) -> None:
    flight = recorded.flight
    swings = []
    for begin_s in (recorded.stepped_s, recorded.stopped_s):
        late = flight.chi_rad(begin_s + 3.0, begin_s + 5.0)
        swings.append(math.degrees(float(np.sqrt(np.mean(late * late)))))
        assert math.degrees(flight.chi_rad(begin_s, begin_s + 3.0).max()) > 15.0
    assert swings[1] > 5.0, "without correction"
    assert swings[0] < 0.2 * swings[1]
    assert recorded.health == (Health.ACTIVE, Health.READY)


def test_its_estimate_is_near_the_truth_and_nothing_of_it_is_refused(recorded: Recorded) -> None:
    flight = recorded.flight
    reports = [report for report in flight.reports if report.t_boot_s > recorded.stepped_s]
    assert len(reports) > 1000
    assert flight.rmse_deg(recorded.stepped_s) < 1.0
    assert {report.force_ned_n for report in reports} == {(0.0, 0.0, 0.0)}
    assert 0.0 < max(report.nis for report in reports) < 50.0
    assert {reason.name for reason, count in flight.engine.pipeline.resets.items() if count} == {"LIFT"}


def test_its_recording_replays_byte_for_byte(recorded: Recorded, replayed: Replay) -> None:
    assert replayed.frames_sent > 500
    assert replayed.frames_differing == 0, replayed.first_difference
    assert replayed.reports == recorded.flight.reports


def test_it_lies_between_the_ekf_and_the_pendulum(recorded: Recorded, replayed: Replay) -> None:
    other = replay(recorded.events, estimated_by("swing_ekf"), parameters_from_json)
    ekf, fgdf = (compare(run, estimated_by("fgdf"), recorded.truth).zeta for run in (other, replayed))
    assert fgdf.true_std_deg > 5.0
    assert ekf.rmse_deg < 0.8 * fgdf.rmse_deg
    assert ekf.rate_rmse_deg_s < 0.8 * fgdf.rate_rmse_deg_s
    assert fgdf.rmse_deg < 0.8 * fgdf.pendulum_rmse_deg


def test_the_commands_take_its_name(recorded: Recorded, tmp_path: Path) -> None:
    runner = CliRunner()
    chosen = ["--set", "estimator.name=fgdf", "--set", "estimator.fgdf_memory_s=2"]
    result = runner.invoke(app, ["check", CONFIG, *chosen])
    assert result.exit_code == 0, result.output
    assert "fgdf_memory_s" in result.output
    result = runner.invoke(app, ["replay", str(recorded.events), *chosen, "-o", str(tmp_path / "out.csv")])
    assert result.exit_code == 0, result.output
    refused = runner.invoke(app, ["check", CONFIG, "--set", "estimator.fgdf_memory_s=0"])
    assert refused.exit_code == 78
    assert "estimator.fgdf_memory_s" in refused.output
    assert "0.1 to 1000 s" in refused.output
