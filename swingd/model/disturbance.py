"""What the estimator of the disturbance tells, along north, east and down."""

from dataclasses import dataclass

from swingd.model.events import Vec3


@dataclass(frozen=True, slots=True)
class DisturbanceEstimate:
    """Force on the vehicle besides thrust and weight: cable, load, wind and drag."""

    force_ned_n: Vec3
    force_std_n: Vec3
    """Deviation of each component [N]."""
    doubt: str
    """Why it is not to be acted on; empty where it may be."""
