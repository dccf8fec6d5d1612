"""Log lines."""

import json
from collections.abc import Iterator

import pytest
import structlog

from swingd.model.actions import Severity
from swingd.service.logs import configure_logs, level_of


@pytest.fixture(autouse=True)
def _default_logs() -> Iterator[None]:
    yield
    structlog.reset_defaults()


def test_a_line_is_json_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs()
    structlog.get_logger("swingd").warning("battery: asked 10 Hz, got 0.5 Hz", link="udpin://0.0.0.0:14540")
    captured = capsys.readouterr()
    line = json.loads(captured.err)
    assert captured.out == ""
    assert line["event"] == "battery: asked 10 Hz, got 0.5 Hz"
    assert (line["level"], line["link"]) == ("warning", "udpin://0.0.0.0:14540")
    assert line["timestamp"].endswith("Z")


def test_under_journald_a_line_carries_its_priority(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logs(under_journald=True)
    log = structlog.get_logger("swingd")
    for severity in Severity:
        getattr(log, level_of(severity))(severity.name)
    lines = capsys.readouterr().err.splitlines()
    assert [line[:3] for line in lines] == ["<2>", "<3>", "<4>", "<6>", "<6>"]
    assert [json.loads(line[3:])["event"] for line in lines] == [severity.name for severity in Severity]
