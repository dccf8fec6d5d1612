"""The whole brain behind frames: router, adapter and pipeline joined; no I/O, no clock of its own."""

from swingd.engine.engine import TICK_S, Delivery, Engine

__all__ = ["TICK_S", "Delivery", "Engine"]
