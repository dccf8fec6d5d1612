import struct

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec, Encoder, Frame, checksum, checksum_seed

from .messages import attitude, battery, imu, px4_heartbeat


def frames_of(chunks: list[bytes]) -> list[Frame]:
    codec = Codec(1, 191)
    return [frame for chunk in chunks for frame in codec.receive(chunk)]


def cut(data: bytes, cuts: list[int]) -> list[bytes]:
    ends = [*sorted(c % (len(data) + 1) for c in cuts), len(data)]
    return [data[a:b] for a, b in zip([0, *ends], ends, strict=False)]


def v1(message) -> bytes:
    return message.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=1), force_mavlink1=True)


def signed(message) -> bytes:
    mav = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    mav.signing.secret_key = bytes(32)
    mav.signing.sign_outgoing = True
    return message.pack(mav)


def unknown(msg_id: int, payload: bytes, seed: int = 77) -> bytes:
    body = struct.pack("<BBBBBB", len(payload), 0, 0, 3, 1, 1) + msg_id.to_bytes(3, "little") + payload
    crc = mavlink.x25crc(body + bytes([seed])).crc
    return b"\xfd" + body + struct.pack("<H", crc)


GOOD = [
    Codec(1, 1).encode(imu(1.25)),
    v1(attitude(2.5)),
    signed(attitude(3.5)),
    unknown(54321, b"\x01\x02\x03"),
    Codec(1, 1).encode(px4_heartbeat()),
]


def test_frames_carry_their_sender_and_their_bytes_untouched():
    frames = frames_of(GOOD)
    assert [frame.raw for frame in frames] == GOOD
    assert [(f.system_id, f.component_id, f.msg_id) for f in frames] == [
        (1, 1, 105),
        (7, 1, 30),
        (7, 1, 30),
        (1, 1, 54321),
        (1, 1, 0),
    ]


@given(st.lists(st.integers(0, 10_000), max_size=40))
@example(list(range(10_000)))
def test_any_cut_of_the_stream_gives_the_same_frames(cuts):
    data = b"\xfd\x05" + GOOD[0] + b"noise\xfe" + GOOD[1] + GOOD[2][:-3] + GOOD[2] + GOOD[3] + b"\xfd" * 5 + GOOD[4]
    assert frames_of(cut(data, cuts)) == frames_of([data])


@given(st.binary(max_size=400), st.lists(st.integers(0, 400), max_size=10))
def test_no_bytes_raise_and_none_is_forgotten(data, cuts):
    codec = Codec(1, 191)
    frames = [frame for chunk in cut(data, cuts) for frame in codec.receive(chunk)]
    frames += codec.receive(bytes(300))  # whatever waits for its end gets it
    assert codec.counters.frames == len(frames)
    in_frames = sum(len(frame.raw) for frame in frames)
    assert in_frames + codec.counters.garbage_bytes in range(len(data) + 300 - 2, len(data) + 301)


@given(st.binary(max_size=300).filter(lambda noise: not {0xFD, 0xFE} & set(noise)))
def test_noise_hides_no_frame_and_is_counted(noise):
    codec = Codec(1, 191)
    assert [f.raw for f in codec.receive(noise + GOOD[0] + noise + GOOD[4])] == [GOOD[0], GOOD[4]]
    assert codec.counters.garbage_bytes == 2 * len(noise)


@given(st.integers(0, len(GOOD[0]) - 1), st.integers(1, 255))
def test_a_damaged_frame_is_no_frame_and_costs_only_itself(place, flip):
    damaged = bytearray(GOOD[0])
    damaged[place] ^= flip
    frames = frames_of([bytes(damaged) + GOOD[4] * 30])  # enough for a length that was made too long
    assert bytes(damaged) not in [f.raw for f in frames]
    assert [f.raw for f in frames][-20:] == [GOOD[4]] * 20


def test_an_unknown_id_needs_a_checksum_that_some_seed_makes_right():
    good = unknown(54321, bytes(range(1, 40)))
    assert frames_of([good])[0].message is None
    accepted = sum(len(frames_of([good[:-2] + crc.to_bytes(2, "little")])) for crc in range(0, 65536, 7))
    assert accepted < 65536 / 7 / 256 * 3


def test_incompatibility_flags_that_are_not_understood_are_refused():
    codec = Codec(1, 191)
    strange = bytearray(GOOD[0])
    strange[2] = 0x02
    assert codec.receive(bytes(strange) + GOOD[4])[-1].raw == GOOD[4]
    assert codec.counters.unknown_flags >= 1


@settings(max_examples=300)
@given(st.sampled_from(sorted(mavlink.mavlink_map)), st.binary(max_size=255))
def test_every_payload_of_every_message_decodes_as_pymavlink_does(msg_id, payload):
    message_class = mavlink.mavlink_map[msg_id]
    raw = unknown(msg_id, payload, message_class.crc_extra)
    (frame,) = frames_of([raw])
    reference = mavlink.MAVLink(None).decode(bytearray(raw))
    assert repr(frame.message.to_dict()) == repr(reference.to_dict())
    assert frame.message.get_srcSystem() == reference.get_srcSystem()
    assert frame.message.get_seq() == reference.get_seq()


def test_a_message_is_decoded_once():
    (frame,) = frames_of([GOOD[0]])
    assert frame.message is frame.message
    assert frame.message.xacc == pytest.approx(0.1)
    assert frame == frames_of([GOOD[0]])[0]  # whether somebody has looked is no difference


def test_frames_tell_their_version_and_whether_they_are_signed():
    assert [(f.is_v2, f.signed) for f in frames_of(GOOD)] == [
        (True, False),
        (False, False),
        (True, True),
        (True, False),
        (True, False),
    ]
    odd = v1(attitude(2.5))
    odd = odd[:2] + b"\x01" + odd[3:-2]  # MAVLink 1 has its sequence number where MAVLink 2 has the flags
    odd += checksum(odd, mavlink.MAVLink_attitude_message.crc_extra)
    assert not frames_of([odd])[0].signed


@settings(max_examples=300)
@given(st.sampled_from(sorted(mavlink.mavlink_map)), st.binary(max_size=255), st.booleans())
def test_targets_are_those_that_pymavlink_decodes(msg_id, payload, first):
    message_class = mavlink.mavlink_map[msg_id]
    if first and msg_id < 256:
        body = struct.pack("<BBBBB", len(payload), 0, 1, 1, msg_id) + payload
        crc = mavlink.x25crc(body + bytes([message_class.crc_extra])).crc
        raw = b"\xfe" + body + struct.pack("<H", crc)
    else:
        raw = unknown(msg_id, payload, message_class.crc_extra)
    (frame,) = frames_of([raw])
    reference = mavlink.MAVLink(None).decode(bytearray(raw))
    assert frame.target_system == getattr(reference, "target_system", 0)
    assert frame.target_component == getattr(reference, "target_component", 0)
    assert frame.has_target == hasattr(reference, "target_system")


def test_targets_of_what_is_cut_or_unknown_read_zero():
    codec = Codec(1, 1)
    command = mavlink.MAVLink_command_long_message(7, 190, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    to_all = mavlink.MAVLink_command_long_message(0, 0, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    ack = mavlink.MAVLink_command_ack_message(400, 0)
    frames = frames_of([*map(codec.encode, [command, to_all, ack]), v1(ack), unknown(54321, bytes(range(1, 60)))])
    assert [(f.target_system, f.target_component, f.has_target) for f in frames] == [
        (7, 190, True),
        (0, 0, True),
        (0, 0, True),
        (0, 0, True),
        (0, 0, False),
    ]


@given(st.integers(0, 255), st.integers(0, 2**24 - 1), st.binary(max_size=255))
def test_the_seed_of_any_frame_is_found(seed, msg_id, payload):
    frame = unknown(msg_id, payload, seed)
    assert checksum_seed(frame) == seed
    assert checksum(frame[:-2], seed) == frame[-2:]
    assert checksum_seed(frame[:-2] + bytes([frame[-2], frame[-1] ^ 0xFF])) != seed


def test_encode_numbers_its_frames_and_signs_with_its_ids():
    codec = Codec(9, 191)
    raw = [codec.encode(battery([16000])) for _ in range(258)]
    frames = frames_of(raw)
    assert [f.raw[4] for f in frames] == [*range(256), 0, 1]
    assert {(f.system_id, f.component_id) for f in frames} == {(9, 191)}
    codec.system_id = 3
    assert frames_of([codec.encode(px4_heartbeat())])[0].system_id == 3
    assert codec.sent == 259


@settings(max_examples=20)
@given(st.sampled_from([battery([16000]), px4_heartbeat(), mavlink.MAVLink_statustext_message(6, b"swingd")]))
def test_a_packed_message_is_numbered_for_another_receiver_as_if_packed_for_it(message):
    first, second, other = (Encoder(9, 191) for _ in range(3))
    for _ in range(258):
        assert other.number(first.encode(message)) == second.encode(message)
        first.encode(message)
    assert other.sent == second.sent


def test_each_encoder_has_its_own_sequence():
    message = battery([16000])
    first, second = Encoder(1, 191), Encoder(1, 191)
    raw = [first.encode(message), first.encode(message), second.encode(message), first.encode(message)]
    assert [f.raw[4] for f in frames_of(raw)] == [0, 1, 0, 2]
    assert {f.message.voltages[0] for f in frames_of(raw)} == {16000}
    second.system_id, second.component_id = 4, 5
    (frame,) = frames_of([second.encode(message)])
    assert (frame.system_id, frame.component_id) == (4, 5)
