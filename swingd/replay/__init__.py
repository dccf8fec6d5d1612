"""The host that feeds a log: the same engine and pipeline as in flight, as fast as the machine can."""

from swingd.replay.compare import AxisFigures, Comparison, compare
from swingd.replay.runner import Replay, replay
from swingd.replay.table import write_reports

__all__ = ["AxisFigures", "Comparison", "Replay", "compare", "replay", "write_reports"]
