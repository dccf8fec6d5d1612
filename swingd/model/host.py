"""What is known of the computer that swingd runs on."""

from dataclasses import dataclass
from enum import Enum


class LinkKind(Enum):
    """What a link is made of."""

    SERIAL = "serial"
    NETWORK = "network"


@dataclass(frozen=True, slots=True)
class LinkRate:
    """Traffic of one of swingd's links."""

    kind: LinkKind
    sent_bytes_per_s: float
    received_bytes_per_s: float


@dataclass(frozen=True, slots=True)
class HostStatus:
    """State of the computer; None and empty where it cannot be known."""

    uptime_s: float
    """Since the computer was started [s]."""
    core_loads: tuple[float, ...] = ()
    """Share of the time since the last status that each core was busy, 0..1."""
    core_temperatures_c: tuple[float, ...] = ()
    """Of the processor, by core where it has a sensor for each [degC]."""
    board_temperature_c: float | None = None
    memory_used_bytes: int | None = None
    memory_total_bytes: int | None = None
    storage_used_bytes: int | None = None
    storage_total_bytes: int | None = None
    """Of the file system that swingd keeps its state on."""
    links: tuple[LinkRate, ...] = ()
