"""What the daemon measures of itself."""

import os
import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from swingd.model.actions import SwingReport

LATENCIES_KEPT = 1 << 17
"""About twenty minutes of setpoints."""
STAMPS_KEPT = 4096
"""About forty seconds of filter steps: the rate is that of the end, not of the start, when streams are still slow."""


@dataclass(frozen=True, slots=True)
class Summary:
    """One run of the daemon in figures."""

    duration_s: float
    """From the first filter step to the end, host's clock."""
    filter_steps: int
    filter_hz: float
    """Filter steps over the autopilot's time, the last 4096 of them."""
    setpoints: int
    latency_ms_p50: float | None
    """From the arrival of the bytes that hold an IMU frame to the setpoint's handing to the socket."""
    latency_ms_p99: float | None
    latency_ms_max: float | None
    cpu_percent: float
    """Processor time of the whole process over the duration, in percent of one core."""


class Meter:
    """Counts and times; costs a microsecond a call."""

    def __init__(self) -> None:
        self._latencies_s = np.zeros(LATENCIES_KEPT)
        self._setpoints = 0
        self._steps = 0
        self._stamps_s: deque[float] = deque(maxlen=STAMPS_KEPT)
        self._begun_s: float | None = None
        self._cpu_begun_s = 0.0

    def report(self, report: SwingReport) -> None:
        """Note a filter step."""
        if self._begun_s is None:
            self._begun_s = time.monotonic()
            self._cpu_begun_s = _cpu_s()
        if self._stamps_s and report.t_boot_s <= self._stamps_s[-1]:
            self._stamps_s.clear()  # the autopilot's clock began anew
        self._stamps_s.append(report.t_boot_s)
        self._steps += 1

    def setpoint(self, latency_s: float) -> None:
        """Note a setpoint and the time since the bytes that caused it were received."""
        self._latencies_s[self._setpoints % LATENCIES_KEPT] = latency_s
        self._setpoints += 1

    def summary(self) -> Summary:
        """Return the figures so far."""
        duration_s = time.monotonic() - self._begun_s if self._begun_s is not None else 0.0
        stamps_s = self._stamps_s
        span_s = stamps_s[-1] - stamps_s[0] if stamps_s else 0.0
        latencies_ms = 1e3 * self._latencies_s[: min(self._setpoints, LATENCIES_KEPT)]
        any_latency = latencies_ms.size > 0
        return Summary(
            duration_s=duration_s,
            filter_steps=self._steps,
            filter_hz=(len(stamps_s) - 1) / span_s if span_s > 0.0 else 0.0,
            setpoints=self._setpoints,
            latency_ms_p50=float(np.percentile(latencies_ms, 50)) if any_latency else None,
            latency_ms_p99=float(np.percentile(latencies_ms, 99)) if any_latency else None,
            latency_ms_max=float(latencies_ms.max()) if any_latency else None,
            cpu_percent=100.0 * (_cpu_s() - self._cpu_begun_s) / duration_s if duration_s > 0.0 else 0.0,
        )


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system
