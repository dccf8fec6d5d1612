"""Somebody who sets parameters without end."""

from pymavlink.dialects.v20 import common as mavlink

from swingd.model.actions import Health
from swingd.model.events import Event, ParametersChange
from swingd.model.parameters import Parameters
from swingd.pipeline import Pipeline

from .flight import Flight, inline, local_setpoint


class Counting(Pipeline):
    """Counts what it is asked to take over."""

    changes = 0

    def step(self, event: Event):  # type: ignore[no-untyped-def]
        self.changes += isinstance(event, ParametersChange)
        return super().step(event)


def test_a_flood_of_values_changes_the_pipeline_a_few_times_a_second_and_the_last_one_holds() -> None:
    """GIVEN a flight that is corrected WHEN a station sets 250 values a second THEN five a second are designed for."""
    flight = Flight(inline())
    pipeline = Counting(flight.engine.parameters)
    flight.engine._pipeline = pipeline
    application, station = flight.connect(), flight.connect(ids=(255, 190))
    application.setpoint = local_setpoint(vel=(0.0, 0.0, 0.0))
    flight.take_off().enter_offboard()
    flight.run_while(lambda: flight.health is not Health.ACTIVE, 5.0)
    before = pipeline.changes
    begun_s = flight.t_s
    for k in range(500):
        value = 0.3 + 1e-4 * k
        station.send(mavlink.MAVLink_param_set_message(1, 191, b"SWG_DAMPING", value, mavlink.MAV_PARAM_TYPE_REAL32))
        flight.run(0.004)
    flight.run(0.3)
    assert 2 <= pipeline.changes - before <= 5 * (flight.t_s - begun_s) + 1
    assert pipeline.parameters.control.damping_ratio == flight.engine.parameters.control.damping_ratio
    assert round(pipeline.parameters.control.damping_ratio, 4) == 0.3499
    assert flight.health is Health.ACTIVE


def test_one_value_counts_at_once() -> None:
    flight = Flight(inline(Parameters()))
    station = flight.connect(ids=(255, 190))
    flight.run(1.0)
    station.send(mavlink.MAVLink_param_set_message(1, 191, b"SWG_DAMPING", 0.4, mavlink.MAV_PARAM_TYPE_REAL32))
    assert round(flight.engine.pipeline.parameters.control.damping_ratio, 4) == 0.4
