"""The demonstration's pilot in virtual time."""

from pymavlink.dialects.v20 import common as mavlink

from swingd.demo.pilot import Phase, Pilot
from swingd.link.codec import Codec
from swingd.model.parameters import Parameters
from swingd.sim.peer import SimulatedAutopilot


def test_it_takes_off_only_once_the_filter_is_there() -> None:
    """GIVEN a daemon that loads its filter for long WHEN it only forwards THEN the pilot waits for its first health."""
    peer = SimulatedAutopilot(Parameters())
    pilot = Pilot(peer, ((3.0, 0.0, 0.0),))
    swingd = Codec(1, 191)

    def after(seconds: float, message: object) -> Phase:
        peer.receive(swingd.encode(message))
        end_s = peer.t_s + seconds
        while peer.t_s < end_s:
            pilot(peer.t_s)
            peer.advance(peer.t_s + 0.004)
        return pilot.phase

    assert after(5.0, mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)) is Phase.WAIT
    assert after(1.0, mavlink.MAVLink_statustext_message(5, b"state file left out")) is Phase.WAIT
    assert after(1.0, mavlink.MAVLink_statustext_message(6, b"swingd init: vehicle on ground")) is Phase.CLIMB
    assert peer.autopilot.armed
