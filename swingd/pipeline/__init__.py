"""The brain: events in, actions out; pure, synchronous and deterministic."""

from swingd.pipeline.pipeline import Pipeline

__all__ = ["Pipeline"]
