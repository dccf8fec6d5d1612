"""What the daemon measures of itself."""

import time

import pytest

from swingd.model.actions import Health, SwingReport
from swingd.service.meter import RECENT, Meter

ZERO = (0.0, 0.0, 0.0)


def report(t_boot_s: float) -> SwingReport:
    return SwingReport(
        t_boot_s, 0.0, 0.0, 0.0, 0.0, ZERO, 0.1, 0.1, 20.0, 1.0, 1.0, ZERO, ZERO, Health.READY
    )  # fmt: skip


def test_nothing_measured_is_nothing_claimed() -> None:
    summary = Meter().summary()
    assert (summary.filter_steps, summary.filter_hz, summary.setpoints) == (0, 0.0, 0)
    assert (summary.latency_ms_p50, summary.latency_ms_p99, summary.latency_ms_max) == (None, None, None)


def test_the_filters_rate_is_that_of_the_autopilots_clock() -> None:
    meter = Meter()
    for k in range(5000):
        meter.report(report(50.0 + 0.01 * k))
    assert meter.summary().filter_hz == pytest.approx(100.0, rel=1e-3)
    assert meter.summary().filter_steps == 5000
    for k in range(5000):  # a restart of the autopilot
        meter.report(report(0.01 * k))
    assert meter.summary().filter_hz == pytest.approx(100.0, rel=1e-2)


def test_latencies_are_percentiles_of_what_was_kept() -> None:
    meter = Meter()
    for k in range(1, 1001):
        meter.setpoint(1e-6 * k)
    summary = meter.summary()
    assert summary.setpoints == 1000
    assert summary.latency_ms_p50 == pytest.approx(0.5, abs=0.01)
    assert summary.latency_ms_p99 == pytest.approx(0.99, abs=0.01)
    assert summary.latency_ms_max == pytest.approx(1.0)


def test_the_recent_latencies_are_those_of_the_last_setpoints() -> None:
    meter = Meter()
    assert (meter.recent().latency_ms_p50, meter.recent().latency_ms_p99) == (None, None)
    for _ in range(3 * RECENT):
        meter.setpoint(0.5)
    for k in range(RECENT):
        meter.setpoint(1e-3 * k / RECENT)
    recent = meter.recent()
    assert recent.latency_ms_p50 == pytest.approx(0.5, abs=0.01)
    assert recent.latency_ms_p99 == pytest.approx(0.99, abs=0.01)


def test_the_processor_time_is_that_of_this_process() -> None:
    meter = Meter()
    meter.report(report(0.0))
    begin_s, busy_s = time.monotonic(), time.process_time()
    while time.process_time() - busy_s < 0.3:
        pass
    share = (time.process_time() - busy_s) / (time.monotonic() - begin_s)
    assert meter.summary().cpu_percent == pytest.approx(100.0 * share, rel=0.3)
