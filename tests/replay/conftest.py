"""One recorded flight for all tests of this folder."""

from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from engine.flight import Flight, hold

import swingd
from swingd.config.plain import parameters_to_json
from swingd.model.actions import SwingReport
from swingd.model.parameters import Parameters
from swingd.record.event_log import EventLogWriter
from swingd.sim.truth import TruthWriter


@dataclass(frozen=True)
class Recorded:
    """A flight in lockstep and every file that can be made of it."""

    parameters: Parameters
    events: Path
    tlog: Path
    truth: Path
    reports: list[SwingReport]
    """Live, as the engine made them."""
    changed_s: float
    """When the parameters were changed."""
    frames_sent: int


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Take-off, OFFBOARD, a velocity step, the correction switched off and on, and at last other parameters."""
    folder = tmp_path_factory.mktemp("recorded")
    parameters = hold()
    log = EventLogWriter(folder / "flight.swingd", swingd.__version__, parameters_to_json(parameters))
    flight = Flight(parameters, log=log)
    flight.tlog = []
    flight.take_off().enter_offboard()
    flight.reference = (2.0, 1.0, 0.0)
    flight.run(3.0)
    flight.engine.switch_correction(flight.t_s, False)
    flight.run(1.0)
    flight.engine.switch_correction(flight.t_s, True)
    flight.run(2.0)
    changed_s = flight.t_s
    other = replace(parameters, payload=replace(parameters.payload, mass_kg=0.4))
    flight.engine.change_parameters(changed_s, other, parameters_to_json(other))
    flight.run(1.5)
    log.close()
    with (folder / "flight.tlog").open("wb") as file:
        for t_s, raw in flight.tlog:
            file.write(round((t_s + 1.7e9) * 1e6).to_bytes(8, "big") + raw)
    with (folder / "truth.csv").open("w", encoding="utf-8", newline="\n") as text:
        writer = TruthWriter(text)
        for truth in flight.truths[::2]:
            writer.write(truth)
    return Recorded(
        parameters,
        folder / "flight.swingd",
        folder / "flight.tlog",
        folder / "truth.csv",
        flight.reports,
        changed_s,
        flight.frames_sent,
    )
