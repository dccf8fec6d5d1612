"""Tables of a study as text: numbers, their spread over seeds, and Markdown."""

from collections.abc import Sequence
from math import isnan

Table = tuple[tuple[str, ...], list[tuple[str, ...]]]
"""Headings and rows, as text."""


def markdown(headings: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """Give the lines of a table in Markdown."""
    return [
        "| " + " | ".join(headings) + " |",
        "|" + "---|" * len(headings),
        *("| " + " | ".join(row) + " |" for row in body),
    ]


def number(value: float, digits: int) -> str:
    """Give a number with so many significant digits; nan is nothing."""
    return "" if isnan(value) else f"{value:.{digits}g}"


def with_spread(text: str, deviation: float, seeds: int) -> str:
    """Append the deviation over the seeds, where there is more than one."""
    return f"{text} ± {deviation:.2g}" if seeds > 1 and text else text


def percent(value: float) -> str:
    """Give a change with its sign; nan is nothing."""
    return "" if isnan(value) else f"{value:+.1f}%"
