"""Several vehicles with one load: their samples in, the load's pose at a steady rate out; no I/O and no clock."""

from swingd.pipeline.formation.formation import Formation

__all__ = ["Formation"]
