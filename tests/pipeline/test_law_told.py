"""A law that finds no gains flies uncorrected, which must be said and not only shown by a command."""

from dataclasses import replace

import pytest

from swingd.model.actions import Severity, StatusText
from swingd.model.events import AutopilotState, CorrectionSwitch, FlightMode, ParametersChange, Tick
from swingd.model.parameters import Autopilot, Cable, Control, Mode, Parameters
from swingd.pipeline.pipeline import Pipeline

SLOW = replace(
    Parameters(), mode=Mode.INLINE, cable=Cable(0.5), autopilot=replace(Autopilot(), acceleration_delay_s=0.5)
)


def told(pipeline: Pipeline, t_s: float) -> list[StatusText]:
    actions = [action for i in range(3) for action in pipeline.step(Tick(t_s + 0.05 * i))]
    return [action for action in actions if isinstance(action, StatusText) and "gains" in action.text]


def heard(parameters: Parameters) -> Pipeline:
    pipeline = Pipeline(parameters)
    assert not told(pipeline, 1.0)
    pipeline.step(AutopilotState(2.0, False, FlightMode.OTHER))
    return pipeline


def test_it_is_told_once_when_the_autopilot_is_there() -> None:
    pipeline = heard(SLOW)
    (text,) = told(pipeline, 2.1)
    assert text.severity is Severity.WARNING
    assert not told(pipeline, 3.0)
    pipeline.step(CorrectionSwitch(3.5, False))
    assert not told(pipeline, 4.0)


def test_it_is_told_again_of_other_parameters_that_do_not_help_either() -> None:
    pipeline = heard(Parameters(mode=Mode.INLINE))
    assert not told(pipeline, 2.1)
    pipeline.step(ParametersChange(3.0, SLOW))
    assert len(told(pipeline, 3.1)) == 1


@pytest.mark.parametrize(
    "parameters",
    [
        replace(SLOW, mode=Mode.SHADOW),
        replace(SLOW, control=replace(Control(), law="payload")),
        Parameters(mode=Mode.HOLD),
    ],
    ids=["shadow corrects nothing", "given gains", "gains found"],
)
def test_nothing_is_told_where_nothing_is_missing(parameters: Parameters) -> None:
    assert not told(heard(parameters), 2.1)
