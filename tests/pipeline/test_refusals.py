"""Whatever an input brings that is not used is counted, and the counts outlive new parameters."""

import math
from dataclasses import replace

from swingd.model.estimate import ResetReason
from swingd.model.events import (
    AppSetpoint,
    Attitude,
    AutopilotRestart,
    Battery,
    Imu,
    ParametersChange,
    SetpointUse,
    Vec3,
)
from swingd.model.parameters import Mode, Parameters
from swingd.pipeline.pipeline import Pipeline

LEVEL: Vec3 = (0.0, 0.0, -9.80665)
ZERO: Vec3 = (0.0, 0.0, 0.0)


def imu(t_s: float, acc_frd_mps2: Vec3 = LEVEL) -> Imu:
    return Imu(t_s, t_s, acc_frd_mps2, ZERO)


def test_what_is_not_used_is_counted_by_its_kind() -> None:
    parameters = Parameters(mode=Mode.HOLD)
    pipeline = Pipeline(parameters)
    pipeline.step(imu(1.0))
    pipeline.step(imu(1.0))
    pipeline.step(imu(0.9))
    pipeline.step(imu(1.004, (math.nan, 0.0, 0.0)))
    pipeline.step(imu(1.004, (0.0, 0.0, math.inf)))
    assert pipeline.refusals == {"imu": 4, "reference": 0}
    pipeline.step(imu(1.01))
    assert pipeline.refusals["no_attitude"] == 1
    pipeline.step(Attitude(1.01, 1.01, 0.0, 0.0, 0.0))
    pipeline.step(imu(1.02))
    assert pipeline.refusals["no_attitude"] == 1
    pipeline.step(Battery(1.0, 0.0))
    pipeline.step(AppSetpoint(1.0, SetpointUse.POS, ZERO, ZERO, ZERO, 0.0, 0.0, 0))
    expected = {"imu": 4, "no_attitude": 1, "voltage": 1, "reference": 1}
    assert pipeline.refusals == expected
    pipeline.step(ParametersChange(1.1, replace(parameters, payload=replace(parameters.payload, mass_kg=0.4))))
    assert pipeline.refusals == expected


def test_new_beginnings_are_counted_beyond_new_parameters() -> None:
    parameters = Parameters()
    pipeline = Pipeline(parameters)
    pipeline.step(AutopilotRestart(1.0, -5.0))
    assert pipeline.resets[ResetReason.CLOCK] == 1
    pipeline.step(ParametersChange(1.1, replace(parameters, payload=replace(parameters.payload, mass_kg=0.4))))
    assert pipeline.resets[ResetReason.CLOCK] == 1
