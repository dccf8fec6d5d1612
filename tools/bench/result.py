"""What a case found, and how it is timed."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

ROUNDS = 5


@dataclass(frozen=True)
class Result:
    """One part against its peer."""

    name: str
    value: float
    unit: str
    peer: str
    peer_value: float
    ratio: float
    """How many times better than the peer; below 1 it is worse."""


def smaller_is_better(name: str, own: float, unit: str, peer: str, theirs: float) -> Result:
    return Result(name, own, unit, peer, theirs, theirs / own)


def cost(name: str, own_s: float, peer: str, peer_s: float) -> Result:
    return smaller_is_better(name, 1e6 * own_s, "us", peer, 1e6 * peer_s)


def quickest(*functions: Callable[[], object], rounds: int = ROUNDS) -> list[float]:
    """Shortest time of each function [s], run in alternation so that a busy machine troubles all alike."""
    best = [math.inf] * len(functions)
    for _ in range(rounds):
        for i, function in enumerate(functions):
            begin_s = time.perf_counter()
            function()
            best[i] = min(best[i], time.perf_counter() - begin_s)
    return best
