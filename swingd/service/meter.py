"""What the daemon measures of itself; without numpy, because it counts from the first frame on."""

import os
import time
from array import array
from collections import deque
from dataclasses import dataclass

from swingd.model.actions import SwingReport

LATENCIES_KEPT = 1 << 17
"""About twenty minutes of setpoints."""
RECENT = 2048
"""Setpoints whose latency tells how it is now: some twenty seconds."""
RECENT_STEPS = 200
STAMPS_KEPT = 4096
"""About forty seconds of filter steps: the rate is that of the end, not of the start, when streams are still slow."""


@dataclass(frozen=True, slots=True)
class Recent:
    """How it goes now; costs less than a millisecond to ask for."""

    filter_steps: int
    """Since the start."""
    filter_hz: float
    """Over the autopilot's time, the last 200 steps."""
    latency_ms_p50: float | None
    """Of the last 2048 setpoints; see `Summary`."""
    latency_ms_p99: float | None


@dataclass(frozen=True, slots=True)
class Summary:
    """One run of the daemon in figures."""

    duration_s: float
    """From the first filter step to the end, host's clock."""
    filter_steps: int
    filter_hz: float
    """Filter steps over the autopilot's time, the last 4096 of them."""
    forwarded: int
    """Frames passed on, once for each port that they left through."""
    left_out: int
    """Own setpoints and reports that a slow line to the autopilot had no room for."""
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
        self._latencies_s = array("d")
        self._recent_s: deque[float] = deque(maxlen=RECENT)
        self._setpoints = 0
        self._steps = 0
        self.forwarded = 0
        self.left_out = 0
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
        self._recent_s.append(latency_s)
        if len(self._latencies_s) < LATENCIES_KEPT:
            self._latencies_s.append(latency_s)
        else:
            self._latencies_s[self._setpoints % LATENCIES_KEPT] = latency_s
        self._setpoints += 1

    def _filter_hz(self, last: int) -> float:
        stamps_s = self._stamps_s
        count = min(len(stamps_s), last)
        span_s = stamps_s[-1] - stamps_s[-count] if count else 0.0
        return (count - 1) / span_s if span_s > 0.0 else 0.0

    def recent(self) -> Recent:
        """Return how it goes now."""
        latencies_ms = sorted(1e3 * latency_s for latency_s in self._recent_s)
        return Recent(
            self._steps, self._filter_hz(RECENT_STEPS), _quantile(latencies_ms, 0.5), _quantile(latencies_ms, 0.99)
        )

    def summary(self) -> Summary:
        """Return the figures so far."""
        duration_s = time.monotonic() - self._begun_s if self._begun_s is not None else 0.0
        latencies_ms = sorted(1e3 * latency_s for latency_s in self._latencies_s)
        return Summary(
            duration_s=duration_s,
            filter_steps=self._steps,
            filter_hz=self._filter_hz(STAMPS_KEPT),
            forwarded=self.forwarded,
            left_out=self.left_out,
            setpoints=self._setpoints,
            latency_ms_p50=_quantile(latencies_ms, 0.5),
            latency_ms_p99=_quantile(latencies_ms, 0.99),
            latency_ms_max=_quantile(latencies_ms, 1.0),
            cpu_percent=100.0 * (_cpu_s() - self._cpu_begun_s) / duration_s if duration_s > 0.0 else 0.0,
        )


def _quantile(ordered: list[float], share: float) -> float | None:
    """Interpolate linearly between the two nearest of ordered values."""
    if not ordered:
        return None
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system
