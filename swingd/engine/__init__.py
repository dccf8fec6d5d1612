"""The whole brain behind bytes: adapter and pipeline joined, still without I/O and without a clock of its own."""

from swingd.engine.engine import Engine

__all__ = ["Engine"]
