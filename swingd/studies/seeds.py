"""A study over many seeds: one process a processor, mean and spread of every figure."""

import os
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from statistics import fmean, stdev
from typing import TypeVar

_Case = TypeVar("_Case", bound=Hashable)
_Flight = TypeVar("_Flight")

Figures = dict[str, dict[str, float]]
"""By what is judged, then by index; the figures of one seed."""


def repeat(
    judged: Callable[[int], Figures], seeds: Iterable[int], watch: Callable[[float], None] = lambda _share: None
) -> list[Figures]:
    """Fly and judge every seed, over as many processes as there are processors.

    Parameters
    ----------
    judged : callable
        Takes a seed and gives its figures; a function of a module, so that another process finds it.
    seeds : ints
    watch : callable
        Takes the share done, 0..1.

    Returns
    -------
    list of dict
        In the order of the seeds.
    """
    wanted = list(seeds)
    workers = min(len(wanted), len(os.sched_getaffinity(0)))
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(judged, seed) for seed in wanted]
        for done, future in enumerate(as_completed(futures), start=1):
            future.result()
            watch(done / len(wanted))
        return [future.result() for future in futures]


def each(
    wanted: Sequence[_Case], fly: Callable[[_Case], _Flight], watch: Callable[[float], None]
) -> dict[_Case, _Flight]:
    """Fly every case once; ``watch`` takes the share done, 0..1."""
    flights = {}
    for done, case in enumerate(wanted, start=1):
        flights[case] = fly(case)
        watch(done / len(wanted))
    return flights


def mean_and_spread(repeated: list[Figures]) -> tuple[Figures, Figures]:
    """Give mean and standard deviation of every figure over the seeds; the spread of a single seed is 0."""
    mean, spread = {}, {}
    for group, values in repeated[0].items():
        columns = {index: [figures[group][index] for figures in repeated] for index in values}
        mean[group] = {index: fmean(column) for index, column in columns.items()}
        spread[group] = {index: stdev(column) if len(column) > 1 else 0.0 for index, column in columns.items()}
    return mean, spread
