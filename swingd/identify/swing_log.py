"""Logs that hold the load's measured position: what a Gaussian process of the cable's acceleration is trained on."""

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swingd.model.errors import LogFormatError
from swingd.model.estimate import FloatArray

REQUIRED: tuple[str, ...] = ("t_s", "force_n_n", "force_e_n", "force_d_n", "r_n_m", "r_e_m")
"""Time; thrust as modelled, ned, mean since the row before; vehicle relative to the load."""
RATES = ("v_n_mps", "v_e_mps")
"""Derivative of r, may be absent: r is smoothed and differentiated then."""
VELOCITY = ("vn_mps", "ve_mps")
"""Of the vehicle, may be absent where the model is not to know of the load's velocity."""
GAP_S = 0.1
"""Rows farther apart belong to two segments."""
SMOOTHED_OVER_S = 0.25
"""Window of the cubic that smooths r and gives v where the log has none."""


@dataclass(frozen=True, slots=True)
class Segment:
    """Rows without a gap, evenly spaced to within what a log's clock shows."""

    t_s: FloatArray
    """(n,)"""
    force_ned_n: FloatArray
    """(n, 3)"""
    r_m: FloatArray
    """(n, 2)"""
    v_mps: FloatArray
    """(n, 2)"""
    vel_load_mps: FloatArray | None = None
    """(n, 2) v_p, where the vehicle's velocity was logged."""


def read(path: Path) -> list[Segment]:
    """Read a log.

    Raises
    ------
    LogFormatError
        If it cannot be read, lacks a column, or holds no segment of some length.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            table = csv.reader(file)
            header = [name.strip() for name in next(table, [])]
            missing = [name for name in REQUIRED if name not in header]
            if missing:
                raise LogFormatError(f"{path}: line 1: no column {', '.join(missing)}; expected {', '.join(REQUIRED)}")
            measured, moving = (all(name in header for name in names) for names in (RATES, VELOCITY))
            names = REQUIRED + (VELOCITY if moving else ()) + (RATES if measured else ())
            columns = [header.index(name) for name in names]
            rows = [_row(path, number, row, columns) for number, row in enumerate(table, start=2) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LogFormatError(f"{path}: cannot be read: {error}") from None
    found = [_segment(np.array(part), measured, moving) for part in _split(rows) if len(part) >= 4]
    segments = [segment for segment in found if segment is not None]
    if not segments:
        raise LogFormatError(f"{path}: no stretch of {2.0 * SMOOTHED_OVER_S:g} s without a gap over {GAP_S:g} s")
    return segments


def write(path: Path, segment: Segment) -> None:
    """Write a log that `read` takes.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    vel_mps = None if segment.vel_load_mps is None else segment.vel_load_mps + segment.v_mps
    write_rows(path, segment.t_s, segment.force_ned_n, segment.r_m, segment.v_mps, vel_mps)


def write_rows(
    path: Path, t_s: FloatArray, force_ned_n: FloatArray, r_m: FloatArray, v_mps: FloatArray | None = None,
    vel_mps: FloatArray | None = None,
) -> None:  # fmt: skip
    """Write the rows of a log: what is None has no columns; ``vel_mps`` is the vehicle's. Raises as `write` does."""
    columns, names = [t_s, force_ned_n, r_m], REQUIRED
    for values, more in ((v_mps, RATES), (vel_mps, VELOCITY)):
        if values is not None:
            columns.append(values)
            names += more
    table = np.column_stack(columns)
    np.savetxt(path, table, "%.6f", delimiter=",", header=",".join(names), comments="", encoding="utf-8")


def _row(path: Path, number: int, row: list[str], columns: list[int]) -> list[float] | None:
    """Values of a line; None where one is empty."""
    values = []
    for column in columns:
        if column >= len(row):
            raise LogFormatError(f"{path}: line {number}: {len(row)} cells; expected at least {column + 1}")
        if not row[column].strip():
            return None
        try:
            value = float(row[column])
        except ValueError:
            value = math.nan
        if not abs(value) < 1e9:
            raise LogFormatError(f"{path}: line {number}: {row[column][:40]!r} given; expected a finite number")
        values.append(value)
    return values


def _split(rows: Iterable[list[float] | None]) -> list[list[list[float]]]:
    parts: list[list[list[float]]] = [[]]
    for row in rows:
        last = parts[-1]
        if row is None or (last and not 0.0 < row[0] - last[-1][0] <= GAP_S):
            parts.append([])
        if row is not None:
            parts[-1].append(row)
    return parts


def _segment(table: FloatArray, measured: bool, moving: bool) -> Segment | None:
    """Rows of t, force, r, then the vehicle's velocity and v where there are such."""
    t_s = table[:, 0]
    if t_s[-1] - t_s[0] < 2.0 * SMOOTHED_OVER_S:
        return None
    if measured:
        v_mps = table[:, -2:]
        vel_load_mps = table[:, 6:8] - v_mps if moving else None
        return Segment(t_s, table[:, 1:4], table[:, 4:6], v_mps, vel_load_mps)
    from scipy.signal import savgol_filter

    dt_s = float(np.median(np.diff(t_s)))
    even_s = np.arange(t_s[0], t_s[-1], dt_s)
    even = np.column_stack([np.interp(even_s, t_s, column) for column in table[:, 1:].T])
    window = max(5, 2 * round(0.5 * SMOOTHED_OVER_S / dt_s) + 1)
    r_m = savgol_filter(even[:, 3:5], window, 3, axis=0)
    v_mps = savgol_filter(even[:, 3:5], window, 3, deriv=1, delta=dt_s, axis=0)
    return Segment(even_s, even[:, :3], r_m, v_mps, even[:, 5:7] - v_mps if moving else None)
