from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec
from swingd.model.errors import LogFormatError
from swingd.record.tlog import TlogReader, TlogWriter

T0_S = 1_795_400_829.0


def frames(n: int) -> list[bytes]:
    codec = Codec(1, 1)
    v1 = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    made = [codec.encode(mavlink.MAVLink_attitude_message(i, 0.1, 0.2, 0.3, 0, 0, 0)) for i in range(n)]
    return [
        *made,
        mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3).pack(v1, force_mavlink1=True),
    ]


def records(raw: list[bytes]) -> list[bytes]:
    return [round((T0_S + i * 0.01) * 1e6).to_bytes(8, "big") + frame for i, frame in enumerate(raw)]


def reader(tmp_path, data: bytes) -> TlogReader:
    path = tmp_path / "x.tlog"
    path.write_bytes(data)
    return TlogReader(path)


def test_what_is_written_is_read(tmp_path):
    raw = frames(20)
    with TlogWriter(tmp_path / "x.tlog") as writer:
        for i, frame in enumerate(raw):
            writer.write(T0_S + i * 0.01, frame)
    log = TlogReader(tmp_path / "x.tlog")
    for _ in range(2):  # each iteration begins anew
        assert [frame for _, frame in log] == raw
        assert [t_s for t_s, _ in log] == pytest.approx([T0_S + i * 0.01 for i in range(len(raw))], abs=1e-6)
    assert (log.garbage_bytes, log.truncated_bytes) == (0, 0)


def test_a_signed_frame_is_whole(tmp_path):
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.signing.secret_key = bytes(32)
    mav.signing.sign_outgoing = True
    raw = [mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3).pack(mav), *frames(1)]
    assert [frame for _, frame in reader(tmp_path, b"".join(records(raw)))] == raw


@pytest.mark.parametrize("missing", range(60))
def test_a_truncated_tail_ends_the_log(tmp_path, missing):
    whole = records(frames(5))
    log = reader(tmp_path, b"".join(whole)[: -missing or None])
    left = sum(map(len, whole)) - missing
    expected = [record[8:] for i, record in enumerate(whole) if sum(map(len, whole[: i + 1])) <= left]
    assert [frame for _, frame in log] == expected
    assert log.garbage_bytes == 0
    assert log.truncated_bytes == left - sum(8 + len(frame) for frame in expected)


@given(st.binary(min_size=1, max_size=60).filter(lambda noise: not {0xFD, 0xFE} & set(noise)))
def test_garbage_between_records_is_skipped_and_counted(tmp_path_factory, noise):
    raw = frames(6)
    data = records(raw)
    log = reader(tmp_path_factory.mktemp("tlog"), b"".join([*data[:3], noise, *data[3:]]))
    read = [frame for _, frame in log]
    assert read[:2] == raw[:2]
    assert read[-4:] == raw[-4:]
    assert log.garbage_bytes in (len(noise), len(noise) + len(data[2]))


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(tmp_path_factory, data):
    try:
        log = reader(tmp_path_factory.mktemp("tlog"), data)
    except LogFormatError:
        return
    total = sum(8 + len(frame) for _, frame in log)
    assert total + log.garbage_bytes + log.truncated_bytes == len(data)


@pytest.mark.parametrize("data", [b"", b"t_boot_s,xi_rad\n0,0\n", bytes(4000)])
def test_other_files_are_refused(tmp_path, data):
    with pytest.raises(LogFormatError, match=r"x\.tlog: no MAVLink record found; expected a \.tlog"):
        reader(tmp_path, data)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(LogFormatError, match="No such file"):
        TlogReader(tmp_path / "none.tlog")


@pytest.mark.data
def test_px4_sitl_flight(flight_data):
    log = TlogReader(flight_data("px4_sitl/dev_1.tlog"))
    codec = Codec(1, 191)
    ids: Counter[int] = Counter()
    for _, raw in log:
        (frame,) = codec.receive(raw)
        assert frame.raw == raw
        ids[frame.msg_id] += 1
    assert (log.garbage_bytes, log.truncated_bytes, codec.counters.garbage_bytes) == (0, 0, 0)
    assert codec.counters.frames == 75277
    assert codec.counters.unknown_ids == 107 + 54 + 53 + 36 + 15  # 8, 436, 380, 411, 410 of PX4's own dialect
    assert [ids[i] for i in (105, 30, 31, 83, 375, 32, 36, 147, 84)] == [10680] * 5 + [5340] * 2 + [1069, 3484]
