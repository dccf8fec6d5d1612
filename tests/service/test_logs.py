"""Log lines."""

import contextlib
import json
import sys

import pytest

from swingd.model.actions import Severity
from swingd.service.logs import Log, level_of


def test_a_line_is_json_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    log = Log()
    log.open()
    log.warning("battery: asked 10 Hz, got 0.5 Hz", link="udpin://0.0.0.0:14540")
    captured = capsys.readouterr()
    line = json.loads(captured.err)
    assert captured.out == ""
    assert line["event"] == "battery: asked 10 Hz, got 0.5 Hz"
    assert (line["level"], line["link"]) == ("warning", "udpin://0.0.0.0:14540")
    assert line["timestamp"].endswith("Z")


def test_under_journald_a_line_carries_its_priority(capsys: pytest.CaptureFixture[str]) -> None:
    log = Log(under_journald=True)
    log.open()
    for severity in Severity:
        log.write(level_of(severity), severity.name)
    lines = capsys.readouterr().err.splitlines()
    assert [line[:3] for line in lines] == ["<2>", "<3>", "<4>", "<6>", "<6>"]
    assert [json.loads(line[3:])["event"] for line in lines] == [severity.name for severity in Severity]


def test_what_was_said_before_is_kept_with_its_time_and_order(capsys: pytest.CaptureFixture[str]) -> None:
    log = Log()
    for number in range(2000):
        log.info("early", number=number)
    assert capsys.readouterr().err == ""
    log.open()
    log.open()
    log.info("late")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [line.get("number") for line in lines] == [*range(1000), None], "bounded, and written once"
    times = [line["timestamp"] for line in lines]
    assert times == sorted(times)


def test_a_reader_that_is_gone_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with open("/dev/full", "w", buffering=1) as full:
        monkeypatch.setattr(sys, "stderr", full)
        log = Log()
        log.open()
        log.error("nobody reads this")
        monkeypatch.undo()
        with contextlib.suppress(OSError):
            full.close()
