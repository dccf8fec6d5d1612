import json
import os
import struct
import time
from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.model.errors import LogFormatError
from swingd.record import event_log
from swingd.record.event_log import EventLogError, EventLogReader, EventLogWriter, Record, RecordKind

CONFIGURATION = "mode: hold\nvehicle: {mass_kg: 1.5}  # µ\n"

records = st.lists(
    st.builds(
        Record,
        st.sampled_from(RecordKind),
        st.floats(allow_nan=False, allow_infinity=False),
        st.binary(max_size=300),
    ),
    max_size=50,
)


def written(path: Path, items: list[Record]) -> Path:
    writer = EventLogWriter(path, "1.2.3", CONFIGURATION)
    for item in items:
        writer.write(item.kind, item.t_mono_s, item.payload)
    writer.close()
    assert (writer.records, writer.lost) == (len(items), 0)
    return path


@given(records)
def test_what_is_recorded_is_read_exactly(tmp_path_factory, items):
    log = EventLogReader(written(tmp_path_factory.mktemp("log") / "x.events", items))
    assert (log.swingd_version, log.configuration) == ("1.2.3", CONFIGURATION)
    assert list(log) == items
    assert log.tail_bytes == 0
    assert list(log) == items


def test_each_kind_says_what_it_holds(tmp_path):
    writer = EventLogWriter(tmp_path / "x", "1", "")
    writer.write(RecordKind.RECEIVED_AUTOPILOT, 1.0, b"\xfd\x00")
    writer.tick(1.1)
    writer.parameters(1.2, "mass: 2 µ")
    writer.correction(1.3, True)
    writer.correction(1.4, False)
    writer.write(RecordKind.SENT_AUTOPILOT, 1.5, b"\xfd\x01")
    writer.close()
    received, tick, parameters, on, off, sent = EventLogReader(tmp_path / "x")
    assert received == Record(RecordKind.RECEIVED_AUTOPILOT, 1.0, b"\xfd\x00")
    assert (tick.kind, tick.payload) == (RecordKind.TICK, b"")
    assert parameters.text == "mass: 2 µ"
    assert (on.enabled, off.enabled) == (True, False)
    assert [r.kind.is_output for r in (received, tick, parameters, on, sent)] == [False] * 4 + [True]


@given(st.integers(0, 2000), st.data())
def test_a_truncated_log_is_read_up_to_its_last_whole_record(tmp_path_factory, end, data):
    items = [Record(RecordKind.RECEIVED_AUTOPILOT, i * 0.01, bytes([i]) * (i % 30)) for i in range(40)]
    path = written(tmp_path_factory.mktemp("log") / "x", items)
    whole = path.read_bytes()
    end = min(end, len(whole))
    path.write_bytes(whole[:end])
    try:
        log = EventLogReader(path)
    except LogFormatError:
        assert end < len(whole) - sum(17 + len(r.payload) for r in items)
        return
    got = list(log)
    assert got == items[: len(got)]
    used = len(whole) - sum(17 + len(r.payload) for r in items[len(got) :])
    assert log.tail_bytes == end - used
    assert len(got) == len(items) or log.tail_bytes < 17 + len(items[len(got)].payload)


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_a_damaged_byte_never_gives_a_wrong_record(tmp_path_factory, at, flip):
    items = [Record(RecordKind.RECEIVED_AUTOPILOT, i * 0.01, bytes([i]) * 20) for i in range(20)]
    path = written(tmp_path_factory.mktemp("log") / "x", items)
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= flip
    path.write_bytes(data)
    try:
        got = list(EventLogReader(path))
    except LogFormatError:
        return
    assert got == items[: len(got)]
    assert len(got) < len(items)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "expected an event log of swingd"),
        (b"t_boot_s,xi_rad", "begins with b't_boot_s'; expected an event log of swingd"),
        (struct.pack("<8sHI", b"SWINGDEV", 9, 0), "event log of version 9; expected 2"),
        (struct.pack("<8sHI", b"SWINGDEV", 2, 50) + b"{}", "the header is damaged"),
        (struct.pack("<8sHI", b"SWINGDEV", 2, 2) + b"{}" + struct.pack("<I", 0), "the header is damaged"),
    ],
)
def test_other_files_are_refused(tmp_path, data, expected):
    path = tmp_path / "x.events"
    path.write_bytes(data)
    with pytest.raises(LogFormatError, match=r"x\.events") as error:
        EventLogReader(path)
    assert expected in str(error.value)


def test_a_file_that_cannot_be_made_is_told_at_the_start(tmp_path):
    with pytest.raises(EventLogError, match="No such file or directory"):
        EventLogWriter(tmp_path / "no" / "x", "1", "")


def full_disk() -> Path:
    path = Path("/dev/full")
    if not path.exists():
        pytest.skip("no /dev/full here")
    return path


def test_a_full_disk_ends_the_recording_once_and_never_raises():
    ends: list[str] = []
    writer = EventLogWriter(full_disk(), "1", "", ends.append)
    for i in range(200_000):
        writer.write(RecordKind.RECEIVED_AUTOPILOT, i * 0.001, bytes(60))
        if ends:
            break
    assert ends == ["/dev/full: recording ended: No space left on device"]
    for i in range(10):
        writer.tick(i)
    assert writer.lost == 11
    writer.close()
    writer.close()
    assert len(ends) == 1


def test_a_full_disk_seen_only_at_the_end_is_told_by_close():
    ends: list[str] = []
    writer = EventLogWriter(full_disk(), "1", "", ends.append)
    writer.tick(1.0)
    writer.close()
    assert ends == ["/dev/full: recording ended: No space left on device"]


def test_a_disk_that_does_not_keep_up_costs_bounded_memory_and_no_time(tmp_path):
    """A FIFO that nobody reads takes 64 KiB and then blocks the writing thread, as a dying card does."""
    path = tmp_path / "fifo"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    ends: list[str] = []
    writer = EventLogWriter(path, "1", "", ends.append)
    longest_s = 0.0
    for i in range(400):
        began_s = time.perf_counter()
        writer.write(RecordKind.RECEIVED_AUTOPILOT, i * 0.001, bytes(40_000))
        longest_s = max(longest_s, time.perf_counter() - began_s)
    assert ends == [f"{path}: recording ended: the disk does not keep up"]
    assert writer.records * 40_000 < 9 << 20
    assert longest_s < 0.5
    os.close(reader)  # frees the writing thread with an error
    writer.close()
    assert len(ends) == 1


def test_the_log_on_disk_is_current_after_a_flush(tmp_path):
    writer = EventLogWriter(tmp_path / "x", "1", "")
    writer.tick(1.0)
    writer.flush()
    deadline_s = time.monotonic() + 5.0
    while not (tmp_path / "x").stat().st_size and time.monotonic() < deadline_s:
        time.sleep(0.002)
    assert [r.t_mono_s for r in EventLogReader(tmp_path / "x")] == [1.0]
    writer.close()


def test_the_layout_is_what_its_description_says(tmp_path):
    data = written(tmp_path / "x", [Record(RecordKind.CORRECTION, 2.5, b"\x01")]).read_bytes()
    magic, version, length = struct.unpack_from("<8sHI", data)
    assert (magic, version) == (b"SWINGDEV", 2)
    header = data[14 : 14 + length]
    assert json.loads(header) == {"swingd": "1.2.3", "configuration": CONFIGURATION}
    at = 14 + length
    assert struct.unpack_from("<I", data, at)[0] == crc32(data[:at])
    record = struct.pack("<BdI", 5, 2.5, 1) + b"\x01"
    assert data[at + 4 :] == record + struct.pack("<I", crc32(record))
    assert event_log.VERSION == 2
