"""Log lines."""

import contextlib
import json
import os
import sys
import threading
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from swingd.model.actions import Severity
from swingd.service.logs import (
    EVENTS_MAX,
    LINES_MAX,
    REPEATS_MAX,
    WINDOW_S,
    Log,
    journald_reads,
    level_of,
    with_priority,
)


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
    for number in range(20):
        log.info(f"early {number}")
    assert capsys.readouterr().err == ""
    log.open()
    log.open()
    log.info("late")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [line["event"] for line in lines] == [*(f"early {number}" for number in range(20)), "late"], "written once"
    times = [line["timestamp"] for line in lines]
    assert times == sorted(times)


def test_what_is_kept_until_it_opens_is_bounded(capsys: pytest.CaptureFixture[str]) -> None:
    log = Log()
    for number in range(2000):
        log.error(f"early {number}")
    log.open()
    assert len(capsys.readouterr().err.splitlines()) == 1000


class Clock:
    """Of a test's own [s]."""

    t_s = 0.0

    def __call__(self) -> float:
        return self.t_s


def opened(clock: Clock) -> Log:
    log = Log(clock=clock)
    log.open()
    return log


def _lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().err.splitlines()]


def test_the_same_event_is_written_a_few_times_then_counted(capsys: pytest.CaptureFixture[str]) -> None:
    """GIVEN an event a hundred times a second WHEN its window ends THEN a line says how many were left out."""
    clock = Clock()
    log = opened(clock)
    for _ in range(100):
        log.warning("link waiting", link="endpoint 1", reason="Connection refused")
        clock.t_s += 0.01
    log.warning("link waiting", link="endpoint 2")
    assert [line["link"] for line in _lines(capsys)] == ["endpoint 1"] * REPEATS_MAX + ["endpoint 2"]

    log.tick()
    assert _lines(capsys) == []
    clock.t_s = WINDOW_S
    log.tick()
    (left_out,) = _lines(capsys)
    assert (left_out["event"], left_out["level"], left_out["link"]) == ("link waiting", "warning", "endpoint 1")
    assert left_out["left_out"] == 100 - REPEATS_MAX

    log.warning("link waiting", link="endpoint 1")
    assert ["left_out" in line for line in _lines(capsys)] == [False], "a new window"
    clock.t_s += 3 * WINDOW_S
    log.tick()
    assert _lines(capsys) == [], "nothing was left out"


def test_many_events_together_are_limited_but_for_errors(capsys: pytest.CaptureFixture[str]) -> None:
    """GIVEN texts that each differ, by a ground station's values WHEN they flood THEN most are counted."""
    clock = Clock()
    log = opened(clock)
    for number in range(3 * LINES_MAX):
        log.info(f"SWG_DAMPING set to {number}")
    log.error("the filter has failed")
    lines = _lines(capsys)
    assert len(lines) == LINES_MAX + 1
    assert lines[-1]["event"] == "the filter has failed"
    clock.t_s = WINDOW_S
    log.tick()
    assert [line["left_out"] for line in _lines(capsys)] == [2 * LINES_MAX]
    log.info("again")
    assert [line["event"] for line in _lines(capsys)] == ["again"]


def test_what_was_left_out_is_told_at_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    log = opened(Clock())
    for _ in range(REPEATS_MAX + 3):
        log.info("again")
    log.close()
    assert _lines(capsys)[-1]["left_out"] == 3


def test_texts_that_others_make_up_fill_no_memory(capsys: pytest.CaptureFixture[str]) -> None:
    log = opened(Clock())
    tracemalloc.start()
    try:
        for number in range(EVENTS_MAX):
            log.warning(f"{number:0100}")
        _lines(capsys)
        before = tracemalloc.get_traced_memory()[0]
        for number in range(EVENTS_MAX, 21 * EVENTS_MAX):
            log.warning(f"{number:0100}")
        _lines(capsys)
        assert tracemalloc.get_traced_memory()[0] - before < 100_000
    finally:
        tracemalloc.stop()


def test_lines_of_several_threads_are_whole_and_counted(capsys: pytest.CaptureFixture[str]) -> None:
    log = opened(Clock())

    def work(number: int) -> None:
        for _ in range(200):
            log.info(f"of {number}")

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    log.close()
    lines = _lines(capsys)
    assert len(lines) == 4 * (REPEATS_MAX + 1)
    assert sum(line.get("left_out", 0) for line in lines) == 4 * (200 - REPEATS_MAX)


def test_only_what_the_journal_reads_gets_its_priorities(tmp_path: Path) -> None:
    """JOURNAL_STREAM is handed on to processes whose output goes to a file or a pipe."""
    journal, other = (tmp_path / "journal").open("wb"), (tmp_path / "other").open("wb")
    with journal, other:
        status = os.fstat(journal.fileno())
        environment = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        assert journald_reads(environment, journal.fileno())
        assert not journald_reads(environment, other.fileno())
        assert not journald_reads({}, journal.fileno())
        assert not journald_reads({"JOURNAL_STREAM": "nonsense"}, journal.fileno())
    assert not journald_reads(environment, 10_000), "no such descriptor"


def test_every_line_of_a_text_gets_the_priority() -> None:
    assert (
        with_priority("error", "swingd: x500.yaml:\n  mass_kg: heavy") == "<3>swingd: x500.yaml:\n<3>  mass_kg: heavy"
    )


def test_a_reader_that_is_gone_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with open("/dev/full", "w", buffering=1) as full:
        monkeypatch.setattr(sys, "stderr", full)
        log = Log()
        log.open()
        log.error("nobody reads this")
        monkeypatch.undo()
        with contextlib.suppress(OSError):
            full.close()
