"""Signed links, with pymavlink's own signing at the other end."""

import hashlib
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.wire import Wire

from .rigs import as_copter, iris

KEY = hashlib.sha256(b"of this test").digest()
OTHER_KEY = hashlib.sha256(b"of another").digest()
YEAR_S = 365.25 * 86400.0
START_UNIX_S = 1_420_070_400.0 + 11.0 * YEAR_S
ARM = (1, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)


class Client:
    """pymavlink's parser and packer."""

    def __init__(self, key: bytes | None, age_s: float = 11.0 * YEAR_S) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True
            self.mav.signing.timestamp = round(age_s * 1e5)
            self.mav.signing.link_id = 3

    def pack(self, message: Any, *, force_mavlink1: bool = False) -> bytes:
        raw: bytes = message.pack(self.mav, force_mavlink1=force_mavlink1)
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        return raw

    def heard(self, frames: list[bytes]) -> list[Any]:
        """Messages with a good signature."""
        out = []
        for raw in frames:
            try:
                out.append(self.mav.decode(bytearray(raw)))
            except mavlink.MAVError:
                continue
        return out


def arm() -> Any:
    return mavlink.MAVLink_command_long_message(*ARM)


def results(messages: list[Any]) -> list[int]:
    return [message.result for message in messages if message.get_type() == "COMMAND_ACK"]


@pytest.fixture(params=["px4", "ardupilot"])
def peer(request: pytest.FixtureRequest) -> SimulatedAutopilot:
    parameters = iris() if request.param == "px4" else as_copter(iris())
    made = SimulatedAutopilot(parameters, signing_key=KEY, signing_start_unix_s=START_UNIX_S)
    made.advance(0.2)
    return made


def test_everything_that_is_sent_is_signed(peer: SimulatedAutopilot) -> None:
    frames = peer.advance(3.0)
    assert len(frames) >= 5
    assert all(raw[2] & 1 for raw in frames)
    assert len(Client(KEY).heard(frames)) == len(frames)
    assert Client(OTHER_KEY).heard(frames) == []


def test_a_signed_command_is_obeyed(peer: SimulatedAutopilot) -> None:
    client = Client(KEY)
    peer.receive(client.pack(arm()))
    messages = client.heard(peer.advance(peer.t_s + 0.1))
    assert results(messages) == [mavlink.MAV_RESULT_ACCEPTED]
    assert peer.autopilot.armed
    assert peer.refused_signatures == 0


def test_what_is_not_signed_or_wrongly_is_refused(peer: SimulatedAutopilot) -> None:
    signed = Client(KEY)
    broken = bytearray(signed.pack(arm()))
    broken[-1] ^= 1
    heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    refused = [
        Client(None).pack(arm()),
        Client(None).pack(arm(), force_mavlink1=True),
        Client(OTHER_KEY).pack(arm()),
        Client(KEY, age_s=11.0 * YEAR_S - 120.0).pack(arm()),
        bytes(broken),
        Client(None).pack(heartbeat),
    ]
    for raw in refused:
        peer.receive(raw)
    assert results(signed.heard(peer.advance(peer.t_s + 0.1))) == []
    assert not peer.autopilot.armed
    assert peer.refused_signatures == len(refused)
    assert peer.companion.heartbeat_t_s != peer.companion.heartbeat_t_s  # none was taken


def test_a_frame_is_taken_once(peer: SimulatedAutopilot) -> None:
    raw = Client(KEY).pack(arm())
    for _ in range(3):
        peer.receive(raw)
    assert results(Client(KEY).heard(peer.advance(peer.t_s + 0.1))) == [mavlink.MAV_RESULT_ACCEPTED]
    assert peer.refused_signatures == 2


def test_without_a_clock_the_time_of_the_first_signed_frame_is_taken_over() -> None:
    peer = SimulatedAutopilot(iris(), signing_key=KEY)
    client = Client(KEY)
    assert client.heard(peer.advance(0.5)) == []  # decades old
    peer.receive(client.pack(arm()))
    assert results(client.heard(peer.advance(1.0))) == [mavlink.MAV_RESULT_ACCEPTED]


def test_a_ground_station_behind_the_autopilot_is_signed_as_well(peer: SimulatedAutopilot) -> None:
    peer.send_to_companion(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    client = Client(KEY)
    heard = client.heard(peer.advance(peer.t_s + 0.1))
    assert (255, 190) in {(message.get_srcSystem(), message.get_srcComponent()) for message in heard}


def test_signing_goes_on_after_a_reboot(peer: SimulatedAutopilot) -> None:
    client = Client(KEY)
    before = peer.advance(peer.t_s + 1.0)
    peer.reboot()
    after = peer.advance(peer.t_s + 5.0)
    assert len(after) > 2
    assert len(client.heard(before + after)) == len(before) + len(after)


def test_signed_frames_are_the_same_each_time() -> None:
    def frames() -> list[bytes]:
        return SimulatedAutopilot(iris(), signing_key=KEY, signing_start_unix_s=START_UNIX_S).advance(1.0)

    assert frames() == frames()


def test_a_key_of_another_length_is_named() -> None:
    with pytest.raises(ValueError, match="31 bytes: expected 32"):
        SimulatedAutopilot(iris(), signing_key=KEY[:31])


def test_radio_status_passes_unsigned() -> None:
    radio = mavlink.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
    wire = Wire(1, 1, KEY, pass_unsigned=(mavlink.MAVLINK_MSG_ID_RADIO_STATUS,))
    (frame,) = wire.receive(Codec(51, 68).encode(radio))
    assert frame.msg_id == mavlink.MAVLINK_MSG_ID_RADIO_STATUS
    assert wire.receive(Client(OTHER_KEY).pack(arm())) == []
    assert wire.refused == 1
