"""What flew is what is replayed: recordings byte for byte, .tlog to the last digits that the link leaves."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.config.loader import load_parameters, parameters_from_json
from swingd.link.codec import Codec
from swingd.model.actions import SwingReport
from swingd.model.errors import LogFormatError
from swingd.record.event_log import EventLogReader, EventLogWriter, RecordKind
from swingd.replay import replay

from .conftest import Recorded

ISSUE_COLUMNS = [
    *("t_boot_s", "xi_rad", "zeta_rad", "xi_rate_radps", "zeta_rate_radps", "fax_n", "fay_n", "faz_n"),
    *("xi_std_rad", "zeta_std_rad", "thrust_n", "thrust_scale", "health"),
]
HEARTBEAT = Codec(1, 1).encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
runner = CliRunner()


def numbers(report: SwingReport) -> list[float]:
    return [
        *(report.t_boot_s, report.xi_rad, report.zeta_rad, report.xi_rate_radps, report.zeta_rate_radps),
        *(*report.force_ned_n, report.xi_std_rad, report.zeta_std_rad, report.thrust_n, report.thrust_scale),
    ]


def rewritten(source: Path, target: Path, change: str) -> Path:
    """Copy a recording with one thing changed."""
    reader = EventLogReader(source)
    writer = EventLogWriter(target, reader.swingd_version, reader.configuration)
    sent = 0
    for record in reader:
        payload = record.payload
        if record.kind is RecordKind.SENT_AUTOPILOT:
            sent += 1
            if sent == 700 and change == "one byte sent":
                payload = payload[:-1] + bytes([payload[-1] ^ 1])
            if sent == 700 and change == "one frame less sent":
                continue
        if change == "no ticks" and record.kind is RecordKind.TICK:
            continue
        writer.write(record.kind, record.t_mono_s, payload)
    writer.close()
    return target


def test_a_recording_replays_byte_for_byte(recorded: Recorded) -> None:
    run = replay(recorded.events, None, parameters_from_json)
    assert run.frames_sent > 1000
    assert run.frames_differing == 0, run.first_difference
    assert run.first_difference is None
    assert run.reports == recorded.reports
    assert len(run.imu) > 4000
    assert len(run.attitudes) > 2000


@pytest.mark.parametrize(("change", "at_least"), [("one byte sent", 1), ("one frame less sent", 100), ("no ticks", 20)])
def test_any_difference_is_found(recorded: Recorded, tmp_path: Path, change: str, at_least: int) -> None:
    run = replay(rewritten(recorded.events, tmp_path / "other.swingd", change), None, parameters_from_json)
    assert run.frames_differing >= at_least
    assert run.first_difference is not None
    if change == "one byte sent":
        assert run.frames_differing == 1
        assert run.first_difference.startswith("frame 700 at ")


def test_other_parameters_are_not_compared(recorded: Recorded) -> None:
    other = replace(recorded.parameters, cable=replace(recorded.parameters.cable, length_m=1.6))
    run = replay(recorded.events, other, parameters_from_json)
    assert (run.frames_sent, run.frames_differing) == (0, 0)
    assert run.reports != recorded.reports
    assert len(run.reports) > 0.9 * len(recorded.reports)


def test_a_tlog_of_the_flight_gives_the_live_estimate(recorded: Recorded) -> None:
    run = replay(recorded.tlog, recorded.parameters, parameters_from_json)
    live = [report for report in recorded.reports if report.t_boot_s < recorded.changed_s - 0.05]
    replayed = {report.t_boot_s: report for report in run.reports}
    assert len(live) > 2000
    worst = 0.0
    for report in live:
        other = replayed[report.t_boot_s]
        for a, b in zip(numbers(report), numbers(other), strict=True):
            worst = max(worst, abs(a - b) / max(1.0, abs(a)))
    assert worst < 1e-6


def test_replaying_twice_gives_the_same_table(recorded: Recorded, tmp_path: Path) -> None:
    for name in ("one.csv", "two.csv"):
        result = runner.invoke(app, ["replay", str(recorded.tlog), "-o", str(tmp_path / name)])
        assert result.exit_code == 0, result.output
    one = (tmp_path / "one.csv").read_bytes()
    assert one == (tmp_path / "two.csv").read_bytes()
    rows = list(csv.reader(one.decode().splitlines()))
    assert rows[0] == ISSUE_COLUMNS
    assert {row[-1] for row in rows[1:]} <= {"init", "ready", "active", "degraded", "fault"}
    assert all(math.isfinite(float(cell)) for row in rows[1:] for cell in row[:-1])
    times = [float(row[0]) for row in rows[1:]]
    assert len(times) / (times[-1] - times[0]) == pytest.approx(100.0, rel=0.01)


def test_the_command_compares_with_the_truth(recorded: Recorded, tmp_path: Path) -> None:
    changed = f"{recorded.changed_s:.2f}"
    arguments = ["replay", str(recorded.tlog), "--truth", str(recorded.truth), "--from", "12", "--to", changed]
    plot = tmp_path / "flight.png"
    result = runner.invoke(app, [*arguments, "--json", "--plot", str(plot)])
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    for axis in ("xi", "zeta"):
        assert said[axis]["rmse_deg"] < 1.0
        assert said[axis]["ratio"] < 0.5
        assert said[axis]["correlation"] > 0.98
    assert said["rows"] > 900
    assert plot.read_bytes().startswith(b"\x89PNG")
    text = runner.invoke(app, arguments).stdout
    assert "RMSE [deg]" in text
    assert f"{said['xi']['rmse_deg']:.2f}" in text


def test_the_command_answers_a_difference_with_its_exit_code(recorded: Recorded, tmp_path: Path) -> None:
    good = runner.invoke(app, ["replay", str(recorded.events), "--json"])
    assert good.exit_code == 0
    assert json.loads(good.stdout)["frames_differing"] == 0
    bad = runner.invoke(app, ["replay", str(rewritten(recorded.events, tmp_path / "x.swingd", "one byte sent"))])
    assert bad.exit_code == 1
    assert "1 differ in the replay" in bad.stdout
    assert "first difference: frame 700" in bad.stdout


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.tlog", None, "cannot be read"),
        ("empty.tlog", b"", "no MAVLink record"),
        ("noise.tlog", bytes(range(256)) * 8, "no MAVLink record"),
        ("silent.tlog", (10**15).to_bytes(8, "big") + HEARTBEAT, "no inertial samples"),
        ("cut.swingd", b"SWINGDEV\x01\x00", "SWINGDEV"),
    ],
)
def test_what_is_no_flight_is_one_clear_message(tmp_path: Path, name: str, content: bytes | None, words: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogFormatError, match=words) as caught:
        replay(path, None, parameters_from_json)
    assert str(path) in str(caught.value)
    result = runner.invoke(app, ["replay", str(path)])
    assert result.exit_code == 1
    assert result.stderr.startswith("swingd: ")
    assert "Traceback" not in result.output


def test_a_truth_of_another_time_is_one_clear_message(recorded: Recorded) -> None:
    result = runner.invoke(app, ["replay", str(recorded.tlog), "--truth", str(recorded.truth), "--from", "900"])
    assert result.exit_code == 1
    assert "no valid time in common" in result.stderr


def test_progress_runs_from_nothing_to_all(recorded: Recorded) -> None:
    for path in (recorded.events, recorded.tlog):
        shares: list[float] = []
        replay(path, load_parameters(None, ()), parameters_from_json, shares.append)
        assert shares == sorted(shares)
        assert (shares[0] < 0.05, shares[-1]) == (True, 1.0)
