"""What a soak must show besides what `watch` holds at every instant: that nothing grows."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import theilslopes

from .record import Lane

GROWTH_MAX_MB = 8.0
"""Of one lane's memory over its whole flight."""
WARM_UP_SHARE = 0.1
SAMPLES_MIN = 6
"""To judge growth by."""
MB = 1e6


@dataclass(frozen=True, slots=True)
class Growth:
    """Of one lane, by the median of the slopes between all pairs of samples (Theil and Sen) after warming up."""

    memory_mb: float
    """Over the whole flight."""
    memory_low_mb: float
    """Its lower bound, at 95 % confidence."""
    handles: int
    """Most in the last third over most in the first."""


def growth_of(lane: Lane) -> Growth | None:
    """Measure growth; None where there are too few samples."""
    samples = [sample for sample in lane.samples if sample.t_s >= WARM_UP_SHARE * lane.flown_s]
    if len(samples) < SAMPLES_MIN:
        return None
    t_s = np.array([sample.t_s for sample in samples])
    rss_mb = np.array([sample.rss_bytes for sample in samples]) / MB
    slope, _, low, _ = theilslopes(rss_mb, t_s, 0.95)
    third = len(samples) // 3
    handles = [sample.handles for sample in samples]
    return Growth(
        memory_mb=float(slope) * lane.flown_s,
        memory_low_mb=float(low) * lane.flown_s,
        handles=max(handles[-third:]) - max(handles[:third]),
    )


def complaints(lanes: list[Lane]) -> list[str]:
    """Say everything that a soak fails for; empty where it passes."""
    said = []
    for lane in lanes:
        name = f"lane {lane.seed} ({lane.autopilot})"
        said += [f"{name}: {rule}, {count} times" for rule, count in lane.breached.items()]
        if lane.flown_s < lane.duration_s - 1e-3 and not lane.breached:
            said.append(f"{name}: ended after {lane.flown_s:.0f} of {lane.duration_s:.0f} s")
        growth = growth_of(lane)
        if growth is None:
            continue
        if growth.memory_low_mb > GROWTH_MAX_MB:
            said.append(f"{name}: memory grew by {growth.memory_mb:.1f} MB; expected at most {GROWTH_MAX_MB:g}")
        if growth.handles > 0:
            said.append(f"{name}: file handles grew by {growth.handles}; expected none")
    return said
