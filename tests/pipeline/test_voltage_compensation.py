"""The autopilot's own voltage compensation is asked for and respected."""

import pytest

from swingd.engine import Engine
from swingd.model.events import Battery, Motors, Throttle, VoltageCompensation
from swingd.model.parameters import Parameters, ThrustSource
from swingd.pipeline import Pipeline
from swingd.pipeline.thrust import ThrustModel
from swingd.sim.lockstep import EngineCompanion, Lockstep
from swingd.sim.peer import SimulatedAutopilot

LEVEL = (0.0, 0.0, 0.0)


def thrust_n(source: ThrustSource, compensated: bool) -> float:
    model = ThrustModel(Parameters())
    model.compensated = compensated
    model.add_battery(Battery(0.0, 14.0))
    if source is ThrustSource.MOTORS:
        model.add_motors(Motors(0.0, 1.0, (0.6, 0.6, 0.6, 0.6)))
    else:
        model.add_throttle(Throttle(0.0, 1.0, 0.6))
    return model.read(1.0, 1.0, LEVEL, LEVEL).thrust_n


def test_a_compensated_throttle_means_thrust_and_motor_outputs_still_sag() -> None:
    sag = (14.0 / 16.2) ** 2
    whole = 36.0 * 0.36 + 8.0 * 0.6 + 0.4
    assert thrust_n(ThrustSource.THROTTLE, compensated=False) == pytest.approx(sag * whole)
    assert thrust_n(ThrustSource.THROTTLE, compensated=True) == pytest.approx(whole)
    assert thrust_n(ThrustSource.MOTORS, compensated=False) == pytest.approx(sag * whole)
    assert thrust_n(ThrustSource.MOTORS, compensated=True) == pytest.approx(sag * whole)


@pytest.mark.parametrize("active", [0.0, 1.0])
def test_the_autopilot_is_asked_once_it_is_heard(active: float, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []
    step = Pipeline.step

    def spy(pipeline: Pipeline, event: object) -> object:
        if isinstance(event, VoltageCompensation):
            seen.append(event.active)
        return step(pipeline, event)  # type: ignore[arg-type]

    monkeypatch.setattr(Pipeline, "step", spy)
    parameters = Parameters()
    engine = Engine(parameters)
    engine.join(0.0)
    companion = EngineCompanion(engine)
    Lockstep(SimulatedAutopilot(parameters, {"MC_BAT_SCALE_EN": active}), companion).run_until(6.0)
    assert seen == [active != 0.0]
