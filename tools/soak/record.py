"""What a lane tells of itself, and counters whose size does not depend on how long it flies."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

_PER_OCTAVE = 16
_OCTAVES = 30
_SMALLEST_S = 1e-7


class Latency:
    """A histogram of durations with logarithmic bins, 4 % wide."""

    def __init__(self) -> None:
        self._bins = np.zeros(_PER_OCTAVE * _OCTAVES, dtype=np.int64)
        self._longest_s = 0.0

    def add(self, duration_s: float) -> None:
        """Note one."""
        place = int(_PER_OCTAVE * math.log2(max(duration_s, _SMALLEST_S) / _SMALLEST_S))
        self._bins[min(place, self._bins.size - 1)] += 1
        self._longest_s = max(self._longest_s, duration_s)

    def take(self) -> "Percentiles":
        """Return what was noted since the last call."""
        counted = np.cumsum(self._bins)
        middle, high = (self._upper_s(int(np.searchsorted(counted, share * counted[-1]))) for share in (0.5, 0.99))
        taken = Percentiles(int(counted[-1]), middle, high, self._longest_s)
        self._bins[:] = 0
        self._longest_s = 0.0
        return taken

    @staticmethod
    def _upper_s(place: int) -> float:
        return _SMALLEST_S * 2.0 ** ((place + 1) / _PER_OCTAVE)


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Of durations, in wall time."""

    count: int
    p50_s: float
    p99_s: float
    max_s: float


@dataclass(frozen=True, slots=True)
class Sample:
    """One lane at the end of a simulated minute."""

    t_s: float
    rss_bytes: int
    handles: int
    health_s: Mapping[str, float]
    """Seconds of this minute spent in each state."""
    resets: Mapping[str, int]
    refusals: Mapping[str, int]
    """Both since the start, by reason."""
    sorties: int
    faults: int


@dataclass(frozen=True, slots=True)
class Hour:
    """One lane over a simulated hour, or the rest of one."""

    t_s: float
    """Its end."""
    pipeline: Percentiles
    """One event through `Pipeline.step`."""
    engine: Percentiles
    """All that 4 ms bring: framing, routing, estimating, answering."""
    error_quiet_deg: float | None
    """Root mean square of the angles' error while health was READY or ACTIVE and nothing had been wrong for a while."""
    error_faults_deg: float | None
    """The same while something was wrong."""


@dataclass(frozen=True, slots=True)
class Breach:
    """Something that must never happen."""

    t_s: float
    rule: str
    text: str


@dataclass(slots=True)
class Lane:
    """Everything that one lane has told."""

    seed: int
    autopilot: str
    duration_s: float
    """Simulated time that was asked for."""
    samples: list[Sample] = field(default_factory=list)
    hours: list[Hour] = field(default_factory=list)
    breaches: list[Breach] = field(default_factory=list)
    """The first of each rule."""
    breached: dict[str, int] = field(default_factory=dict)
    """How often each rule was broken."""
    manoeuvres: dict[str, int] = field(default_factory=dict)
    faults: dict[str, int] = field(default_factory=dict)
    flown_s: float = 0.0
    wall_s: float = 0.0
