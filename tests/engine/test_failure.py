"""A fault in the pipeline ends the correction, never the forwarding."""

import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Encoder, Framer
from swingd.link.stamps import Drop
from swingd.model.actions import Action
from swingd.model.events import AppSetpoint, Event, Imu, Tick, VoltageCompensation
from swingd.pipeline import Pipeline

from .flight import Flight, inline, local_setpoint


@pytest.mark.parametrize("at", [Imu, Tick, AppSetpoint, VoltageCompensation])
def test_a_fault_of_the_pipeline_lets_everything_pass(at: type[Event], monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Flight(inline())
    application = flight.connect()
    sent: list[bytes] = []

    def counted(data: bytes) -> bytes:
        sent.append(data)
        return data

    application.seal = counted
    step = Pipeline.step

    def broken(pipeline: Pipeline, event: Event) -> list[Action]:
        if isinstance(event, at):
            raise ZeroDivisionError("a bug")
        return step(pipeline, event)

    monkeypatch.setattr(Pipeline, "step", broken)
    monkeypatch.setattr(Flight, "_check", lambda _self, _answer: None)
    flight.run(0.02)  # the autopilot has been heard
    application.setpoint = local_setpoint(vel=(0.0, 0.0, 0.0))
    flight.run_while(lambda: flight.engine.failure is None, 5.0)
    assert flight.engine.failure == "ZeroDivisionError: a bug"
    assert flight.engine.adapter.drops[Drop.OUTGOING] == 0
    texts = [frame.message.text for frame in application.heard() if frame.msg_id == mavlink.MAVLINK_MSG_ID_STATUSTEXT]
    assert any("swingd fault: ZeroDivisionError" in text for text in texts)
    flight.run(1.5)
    application.setpoint = None
    flight.run(0.1)
    assert flight.peer.companion.setpoints == len(sent), "none was lost on the way"
    heard = application.heard()
    assert len([frame for frame in heard if frame.msg_id == mavlink.MAVLINK_MSG_ID_ATTITUDE]) > 75
    states = [
        frame.message.system_status
        for frame in heard
        if frame.msg_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and frame.component_id == 191
    ]
    assert states[-1] == mavlink.MAV_STATE_EMERGENCY


def test_another_component_of_its_number_passes_and_is_told() -> None:
    flight = Flight(inline())
    application = flight.connect()
    flight.run(1.5)
    engine, port = flight.engine, application.port
    assert port is not None
    message = mavlink.MAVLink_named_value_float_message(0, b"mine", 1.0)
    (frame,) = Framer().receive(Encoder(1, 191).encode(message))
    out = engine.receive(flight.t_s, port, [frame])
    assert (0, frame.raw) in out
    flight.run(0.1)
    assert any("another component 191" in text for _, text in flight.texts)
