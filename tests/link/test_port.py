import asyncio
import importlib
import os
import struct
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec, Encoder, Framer
from swingd.link.port import Port
from swingd.link.signing import EPOCH_UNIX_S, TICKS_PER_S, Signing, Verdict, key_is_exposed, read_key
from swingd.link.transport import open_transport
from swingd.model.errors import ConfigurationError

from .messages import attitude, battery, imu, px4_heartbeat
from .test_transport import until

KEY = bytes(range(32))
OTHER_KEY = bytes(32)
NOW_S = 1_790_000_000.0
TICKS = round((NOW_S - EPOCH_UNIX_S) * TICKS_PER_S)
MINUTE = 60 * TICKS_PER_S
RADIO = mavlink.MAVLink_radio_status_message(10, 10, 50, 0, 0, 0, 0)
COMMAND = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)


class Clock:
    """Unix time as it is set."""

    def __init__(self, now_s: float = NOW_S) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        return self.now_s


def port(key: bytes | None = KEY, system_ids: frozenset[int] = frozenset(), clock: Clock | None = None) -> Port:
    return Port(key, 5, system_ids, clock or Clock())


def pymavlink(key: bytes = KEY, ticks: int = TICKS, link_id: int = 0, dialect: Any = mavlink, system: int = 255) -> Any:
    """pymavlink's own end of a signed link."""
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=190)
    mav.signing.secret_key = key
    mav.signing.link_id = link_id
    mav.signing.timestamp = ticks
    mav.signing.sign_outgoing = True
    return mav


def v1(message: Any) -> bytes:
    return message.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1), force_mavlink1=True)


def raw(frames: list[Any]) -> list[bytes]:
    return [frame.raw for frame in frames]


def timestamp(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


def resealed(frame: bytes) -> bytes:
    """A forged frame: its checksum is made right again, the signature's bytes stay."""
    crc_extra = mavlink.mavlink_map[frame[7] | frame[8] << 8 | frame[9] << 16].crc_extra
    return frame[:-15] + struct.pack("<H", mavlink.x25crc(frame[1:-15] + bytes([crc_extra])).crc) + frame[-13:]


SIGNED = COMMAND.pack(pymavlink())


# ----------------------------------------------------------------------------------------- with pymavlink as oracle


def test_what_pymavlink_signs_passes():
    mav = pymavlink()
    frames = [message.pack(mav) for message in (imu(1.0), attitude(2.0), COMMAND, px4_heartbeat())]
    guarded = port()
    assert raw(guarded.receive(b"".join(frames))) == frames
    assert (guarded.counters.accepted, guarded.counters.refused) == (4, 0)


@settings(max_examples=200)
@given(st.sampled_from(sorted(mavlink.mavlink_map)), st.binary(max_size=255), st.integers(0, 255))
def test_what_is_sealed_passes_pymavlink_with_content_sender_and_sequence_intact(msg_id, payload, sequence):
    body = struct.pack("<BBBBBB", len(payload), 0, 0, sequence, 9, 8) + msg_id.to_bytes(3, "little") + payload
    crc = mavlink.x25crc(body + bytes([mavlink.mavlink_map[msg_id].crc_extra])).crc
    frame = b"\xfd" + body + struct.pack("<H", crc)
    before = mavlink.MAVLink(None).decode(bytearray(frame))
    sealed = port().seal(frame)
    mav = pymavlink()
    after = mav.decode(bytearray(sealed))  # raises where checksum or signature are wrong
    assert (after.get_signed(), after.get_link_id()) == (True, 5)
    assert repr(after.to_dict()) == repr(before.to_dict())
    assert after.get_seq() == sequence
    assert (after.get_srcSystem(), after.get_srcComponent()) == (9, 8)
    assert len(sealed) == len(frame) + 13
    with pytest.raises(mavlink.MAVError, match="signature"):
        pymavlink(OTHER_KEY).decode(bytearray(sealed))


def test_an_id_that_the_dialect_does_not_know_is_sealed_for_those_who_know_it():
    foreign = [i for i in ardupilotmega.mavlink_map if i not in mavlink.mavlink_map]
    assert len(foreign) > 20
    sender = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    receiver = pymavlink(dialect=ardupilotmega)
    guarded, sealing = port(), port()
    for msg_id in foreign:
        message_class = ardupilotmega.mavlink_map[msg_id]
        body = struct.pack("<BBBBBB", 20, 0, 0, 3, 1, 1) + msg_id.to_bytes(3, "little") + bytes(range(1, 21))
        crc = ardupilotmega.x25crc(body + bytes([message_class.crc_extra])).crc
        frame = b"\xfd" + body + struct.pack("<H", crc)
        sealed = sealing.seal(frame)
        after = receiver.decode(bytearray(sealed))
        assert after.get_signed()
        assert repr(after.to_dict()) == repr(sender.decode(bytearray(frame)).to_dict())
        assert raw(guarded.receive(sealed)) == [sealed]
    assert guarded.counters.framing.unknown_ids == len(foreign)


@pytest.mark.live
async def test_a_ground_station_with_signing_over_udp(monkeypatch):
    """Real mavutil with setup_signing on one side, a port on a real transport on the other."""
    monkeypatch.setenv("MAVLINK20", "1")
    monkeypatch.setenv("MAVLINK_DIALECT", "common")
    mavutil = importlib.import_module("pymavlink.mavutil")
    mavutil.set_dialect("common")
    guarded = Port(KEY, 5, frozenset(), time.time)
    passed = []
    transport = await open_transport("udpin://127.0.0.1:0", lambda _peer, data: passed.extend(guarded.receive(data)))

    async def say_and_hear(link: Any, message: Any) -> Any:
        heard = len(passed) + guarded.counters.refused
        link.mav.send(message)
        await until(lambda: len(passed) + guarded.counters.refused > heard)
        transport.send(guarded.seal(Encoder(1, 191).encode(imu(1.25))))
        return await asyncio.to_thread(link.recv_match, type="HIGHRES_IMU", blocking=True, timeout=1.0)

    url = f"udpout:127.0.0.1:{transport.local_port}"
    station = mavutil.mavlink_connection(url, source_system=255, source_component=190)
    stranger = mavutil.mavlink_connection(url, source_system=254, source_component=190)
    unsigned = mavutil.mavlink_connection(url, source_system=253, source_component=190)
    try:
        station.setup_signing(KEY)
        stranger.setup_signing(OTHER_KEY)
        answer = await say_and_hear(station, COMMAND)
        assert (answer.time_usec, answer.get_signed(), answer.get_link_id()) == (1_250_000, True, 5)
        assert [(f.system_id, f.message.get_type(), f.signed) for f in passed] == [(255, "COMMAND_LONG", True)]
        assert await say_and_hear(stranger, COMMAND) is None
        assert stranger.mav.signing.badsig_count == 1
        await say_and_hear(unsigned, COMMAND)
        assert len(passed) == 1
        assert (guarded.counters.wrong_signature, guarded.counters.unsigned) == (1, 1)
        await say_and_hear(unsigned, px4_heartbeat())
        assert passed[1].system_id == 253
    finally:
        for link in (station, stranger, unsigned):
            link.close()
        await transport.close()


# ------------------------------------------------------------------------------------------------------- refusals


def test_without_a_key_everything_passes_and_leaves_as_it_is():
    frames = [v1(imu(1.0)), Codec(1, 1).encode(COMMAND), COMMAND.pack(pymavlink(OTHER_KEY))]
    open_port = port(key=None)
    assert raw(open_port.receive(b"".join(frames))) == frames
    assert open_port.seal(b"".join(frames)) == b"".join(frames)
    assert (open_port.counters.accepted, open_port.counters.refused) == (3, 0)


@pytest.mark.parametrize("pack", [Codec(7, 1).encode, v1])
def test_without_signature_only_heartbeats_and_radios_pass(pack):
    guarded = port()
    for message in (COMMAND, imu(1.0), battery([16000]), mavlink.MAVLink_param_set_message(1, 1, b"P", 1.0, 9)):
        assert guarded.receive(pack(message)) == []
    harmless = [pack(px4_heartbeat()), pack(RADIO)]
    assert raw(guarded.receive(b"".join(harmless))) == harmless
    assert (guarded.counters.accepted, guarded.counters.unsigned, guarded.counters.refused) == (2, 4, 4)


@pytest.mark.parametrize("message", [COMMAND, px4_heartbeat(), RADIO])
def test_a_wrong_signature_is_refused_whatever_it_says(message):
    guarded = port()
    assert guarded.receive(message.pack(pymavlink(OTHER_KEY))) == []
    assert (guarded.counters.wrong_signature, guarded.counters.accepted) == (1, 0)


@given(st.sampled_from([4, 5, 6, *range(10, len(SIGNED) - 15)]), st.integers(1, 255))
def test_a_changed_frame_with_a_right_checksum_is_refused(place, flip):
    """GIVEN a signed command WHEN sequence, sender or payload change THEN it does not pass, and the command does."""
    forged = bytearray(SIGNED)
    forged[place] ^= flip
    guarded = port()
    assert guarded.receive(resealed(bytes(forged))) == []
    assert (guarded.counters.framing.frames, guarded.counters.wrong_signature) == (1, 1)
    assert raw(guarded.receive(SIGNED)) == [SIGNED]


@pytest.mark.parametrize("place", range(-13, 0))
def test_a_changed_signature_block_is_refused(place):
    frame = bytearray(COMMAND.pack(pymavlink()))
    frame[place] ^= 0x10
    guarded = port()
    assert guarded.receive(bytes(frame)) == []
    assert guarded.counters.wrong_signature == 1


def test_what_was_heard_is_not_heard_again():
    mav = pymavlink()
    first, second, third = (message.pack(mav) for message in (COMMAND, imu(1.0), COMMAND))
    guarded = port()
    assert raw(guarded.receive(first + first + third + second + third)) == [first, third]
    assert guarded.counters.old_timestamp == 3


def test_streams_are_told_apart_by_link_system_and_component():
    clock = Clock()
    guarded = port(clock=clock)
    for link_id, system, component in [(0, 1, 1), (1, 1, 1), (0, 2, 1), (0, 1, 2)]:
        mav = pymavlink(link_id=link_id, system=system)
        mav.srcComponent = component
        frames = [COMMAND.pack(mav), COMMAND.pack(mav)]
        assert raw(guarded.receive(b"".join(frames))) == frames  # all with the same two timestamps
        assert guarded.receive(frames[1]) == []


def test_a_forged_timestamp_does_not_shut_out_the_real_sender():
    mav = pymavlink()
    guarded, victim = port(), pymavlink()
    forged = COMMAND.pack(pymavlink(OTHER_KEY, ticks=2**48 - 2))
    genuine = COMMAND.pack(mav)
    assert raw(guarded.receive(forged + genuine)) == [genuine]
    with pytest.raises(mavlink.MAVError):
        victim.decode(bytearray(forged))
    with pytest.raises(mavlink.MAVError):  # which is why pymavlink's check is not used
        victim.decode(bytearray(genuine))


@pytest.mark.parametrize(("behind", "passes"), [(MINUTE, True), (MINUTE + 1, False), (-100 * MINUTE, True)])
def test_a_new_stream_may_begin_a_minute_late(behind, passes):
    guarded = port()
    frame = COMMAND.pack(pymavlink(ticks=TICKS - behind))
    assert raw(guarded.receive(frame)) == [frame] * passes
    assert guarded.counters.old_timestamp == (not passes)
    mav = pymavlink()  # and pymavlink sees it the same way
    mav.signing.stream_timestamps.clear()
    if passes:
        assert mav.decode(bytearray(frame)).get_signed()
    else:
        with pytest.raises(mavlink.MAVError):
            mav.decode(bytearray(frame))


def test_a_stream_that_was_silent_for_long_goes_on():
    clock = Clock()
    guarded = port(clock=clock)
    mav = pymavlink()
    assert guarded.receive(COMMAND.pack(mav))
    clock.now_s += 3600.0
    assert guarded.receive(COMMAND.pack(mav))  # its sender counts on where it stopped


def test_a_system_that_is_not_allowed_is_refused_signed_or_not():
    for key in (None, KEY):
        guarded = port(key, frozenset({1, 255}))
        allowed, other = COMMAND.pack(pymavlink(system=255)), COMMAND.pack(pymavlink(system=2))
        heartbeat = Codec(2, 1).encode(px4_heartbeat())
        assert raw(guarded.receive(allowed + other + heartbeat)) == [allowed]
        assert (guarded.counters.system_not_allowed, guarded.counters.refused) == (2, 2)


def test_what_one_peer_sent_is_not_heard_from_another_of_the_same_endpoint():
    first = port()
    second = first.for_peer()
    mav = pymavlink()
    recorded, next_one = COMMAND.pack(mav), COMMAND.pack(mav)
    assert raw(first.receive(recorded)) == [recorded]
    assert second.receive(recorded) == []
    assert raw(second.receive(next_one)) == [next_one]
    assert (first.counters.accepted, first.counters.old_timestamp) == (2, 1)
    assert first.counters is second.counters
    frame = Codec(1, 1).encode(COMMAND)
    assert timestamp(first.seal(frame)) < timestamp(second.seal(frame)) < timestamp(first.seal(frame))


def test_peers_do_not_share_their_byte_streams():
    first = port(key=None, system_ids=frozenset({1}))
    second = first.for_peer()
    frame = Codec(1, 1).encode(imu(1.0))
    assert first.receive(frame[:20]) == []
    assert raw(second.receive(frame)) == [frame]
    assert raw(first.receive(frame[20:])) == [frame]
    other = Codec(2, 1).encode(imu(1.0))
    assert second.receive(other) == []
    assert (first.counters.accepted, first.counters.framing.frames, first.counters.system_not_allowed) == (2, 3, 1)


@given(st.lists(st.binary(max_size=60), max_size=8))
def test_no_bytes_raise(noise):
    genuine = COMMAND.pack(pymavlink())
    for guarded in (port(), port(None, frozenset({9}))):
        for data in noise:
            guarded.receive(data + genuine[: len(data)])
            guarded.seal(data)
            guarded.seal(genuine[: len(data)])


# --------------------------------------------------------------------------------------------------------- sealing


def test_what_is_signed_and_mavlink_1_leave_as_they_are():
    sealing = port()
    frames = [COMMAND.pack(pymavlink(OTHER_KEY)), COMMAND.pack(pymavlink()), v1(COMMAND)]
    assert [sealing.seal(frame) for frame in frames] == frames


def test_joined_frames_are_sealed_each():
    codec = Codec(1, 191)
    parts = [codec.encode(imu(1.0)), v1(COMMAND), COMMAND.pack(pymavlink()), codec.encode(COMMAND)]
    sealed = Framer().receive(port().seal(b"".join(parts)))
    assert [frame.signed for frame in sealed] == [True, False, True, True]
    assert [f.raw for f in sealed[1:3]] == parts[1:3]
    assert [timestamp(sealed[3].raw) - timestamp(sealed[0].raw)] == [1]
    assert [len(f.raw) - len(part) for f, part in zip(sealed, parts, strict=True)] == [13, 0, 0, 13]


def test_a_damaged_frame_is_not_signed():
    frame = Codec(1, 191).encode(imu(1.0))
    damaged = frame[:-1] + bytes([frame[-1] ^ 0x80])
    sealed = port().seal(damaged)
    assert sealed == damaged or Framer().receive(sealed) == []


def test_timestamps_follow_the_clock_and_only_increase():
    clock = Clock()
    sealing = port(clock=clock)
    frame = Codec(1, 191).encode(imu(1.0))

    def next_timestamp() -> int:
        return timestamp(sealing.seal(frame))

    assert [next_timestamp(), next_timestamp(), next_timestamp()] == [TICKS, TICKS + 1, TICKS + 2]
    clock.now_s += 1.0
    assert next_timestamp() == TICKS + TICKS_PER_S
    clock.now_s -= 1000.0  # set back by a time server
    assert [next_timestamp(), next_timestamp()] == [TICKS + TICKS_PER_S + 1, TICKS + TICKS_PER_S + 2]
    clock.now_s = 0.0
    assert next_timestamp() == TICKS + TICKS_PER_S + 3


def test_a_board_without_clock_follows_its_peer():
    """GIVEN a board that believes it is 1970 WHEN a signed frame comes THEN the peer takes what it signs next."""
    sealing = port(clock=Clock(0.0))
    frame = Codec(1, 191).encode(imu(1.0))
    mav = pymavlink()
    with pytest.raises(mavlink.MAVError):
        mav.decode(bytearray(sealing.seal(frame)))
    assert sealing.receive(px4_heartbeat().pack(mav))
    assert timestamp(sealing.seal(frame)) == TICKS + 1
    assert mav.decode(bytearray(sealing.seal(frame))).get_signed()


def test_a_forged_frame_does_not_move_the_own_time():
    sealing = port()
    assert sealing.receive(COMMAND.pack(pymavlink(OTHER_KEY, ticks=TICKS + 100 * MINUTE))) == []
    assert timestamp(sealing.seal(Codec(1, 191).encode(imu(1.0)))) == TICKS


def test_the_end_of_time_raises_nothing():
    sealing = port()
    last = COMMAND.pack(pymavlink(ticks=2**48 - 1))
    assert raw(sealing.receive(last)) == [last]
    assert timestamp(sealing.seal(Codec(1, 191).encode(imu(1.0)))) == 2**48 - 1


def test_the_table_of_streams_is_bounded_and_forgets_no_replay():
    signing = Signing(KEY, 0, Clock())
    first = COMMAND.pack(pymavlink(ticks=TICKS - 5))
    assert signing.check(first) is Verdict.GOOD
    for number in range(3000):
        mav = pymavlink(ticks=TICKS + number, link_id=1 + number // 250, system=1 + number % 250)
        assert signing.check(COMMAND.pack(mav)) is Verdict.GOOD
    assert len(signing._streams) <= 1024
    assert signing.check(first) is Verdict.OLD_TIMESTAMP
    assert signing.check(COMMAND.pack(pymavlink(ticks=TICKS + 3000))) is Verdict.GOOD


@pytest.mark.parametrize(("key", "link_id", "text"), [(b"short", 0, "5 bytes given"), (KEY, 256, "256 given")])
def test_a_key_or_link_id_of_another_size_is_told(key, link_id, text):
    with pytest.raises(ValueError, match=text):
        Port(key, link_id, frozenset(), Clock())


# -------------------------------------------------------------------------------------------------------- key file


@pytest.mark.parametrize("form", ["{}", "{}\n", "\n\t {} \r\n"])
@pytest.mark.parametrize("change", [str.lower, str.upper])
def test_a_key_is_64_hexadecimal_digits(tmp_path, form, change):
    path = tmp_path / "key"
    path.write_text(form.format(change(KEY.hex())))
    assert read_key(path) == KEY


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "0 characters, 0 of them"),
        (b"abc", "3 characters, 3 of them"),
        (KEY.hex().encode()[:-1], "63 characters, 63 of them"),
        (KEY.hex().encode() * 2, "128 characters, 128 of them"),
        (KEY.hex().encode()[:-1] + b"g", "64 characters, 63 of them"),
        (KEY.hex().encode()[:32] + b" " + KEY.hex().encode()[32:], "65 characters, 64 of them"),
        (KEY, "32 characters"),
        ("\N{FULLWIDTH DIGIT ONE}".encode() * 64, "192 characters, 0 of them"),
        (b"0" * 10_000_000, "4096 characters"),
    ],
)
def test_what_is_no_key_is_told_without_showing_it(tmp_path, content, found):
    path = tmp_path / "key"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError) as told:
        read_key(path)
    text = str(told.value)
    assert text.startswith(f"signing key {path}: {found}")
    assert "expected 64 hexadecimal digits" in text
    assert KEY.hex()[:16] not in text


def test_a_key_file_that_cannot_be_read_is_told(tmp_path):
    for path, reason in [(tmp_path / "none", "No such file"), (tmp_path, "Is a directory")]:
        with pytest.raises(ConfigurationError, match=f"signing key {path}: cannot be read: {reason}"):
            read_key(path)


@pytest.mark.parametrize(("mode", "exposed"), [(0o600, False), (0o400, False), (0o640, True), (0o604, True)])
def test_a_key_file_that_others_can_read_is_noticed(tmp_path, mode, exposed):
    path = tmp_path / "key"
    path.write_text(KEY.hex())
    os.chmod(path, mode)
    assert key_is_exposed(path) is exposed
    assert not key_is_exposed(Path(f"{path}.none"))
