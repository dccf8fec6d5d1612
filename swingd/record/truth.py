"""The true swing, where a simulator or motion capture knows it."""

import csv
import gzip
import io
import zlib
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swingd.model.errors import LogFormatError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_PX4_SITL = (
    "swing_lateral_rad",
    "swing_longitudinal_rad",
    "swing_lateral_rate_rad_s",
    "swing_longitudinal_rate_rad_s",
)
_OWN = ("xi_rad", "zeta_rad", "xi_rate_radps", "zeta_rate_radps")


@dataclass(frozen=True, slots=True)
class SwingTruth:
    """The true swing angles of the heading frame and their derivatives, on the boot clock; arrays of (n,)."""

    t_boot_s: FloatArray
    """Strictly increasing [s]."""
    xi_rad: FloatArray
    """Lateral swing, positive with the load to the left [rad]."""
    zeta_rad: FloatArray
    """Longitudinal swing, positive with the load ahead [rad]."""
    xi_rate_radps: FloatArray
    zeta_rate_radps: FloatArray
    valid: BoolArray
    """Load attached, cable taut, angles known, inside of the window that was asked for."""


def read_text(path: Path | str) -> str:
    """Return the text of a file, unpacked if it is a gzip file.

    Raises
    ------
    LogFormatError
        If it cannot be read.
    """
    try:
        data = Path(path).read_bytes()
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
        return data.decode("utf-8-sig")
    except (OSError, EOFError, zlib.error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise LogFormatError(f"{path}: cannot be read: {reason}") from error
    except UnicodeDecodeError as error:
        raise LogFormatError(f"{path}: byte {error.start} is no UTF-8; expected a CSV file") from error


def read_table(path: Path | str, text: str, width: int, header: bool) -> FloatArray:
    """Return the numbers of a CSV text as an array of (rows, width); an empty cell is NaN.

    Raises
    ------
    LogFormatError
        If a row has another number of cells or a cell is no number; names file, line and column.
    """
    rows: list[list[float]] = []
    lines = _lines(path, text)
    if header:
        next(lines, None)
    for line, row in lines:
        if not row:
            continue
        if len(row) != width:
            raise LogFormatError(f"{path}, line {line}: {len(row)} cells; expected {width}")
        try:
            rows.append([float(cell) if cell.strip() else np.nan for cell in row])
        except ValueError:
            column = next(i for i, cell in enumerate(row) if cell.strip() and not _is_number(cell))
            raise LogFormatError(
                f"{path}, line {line}, column {column + 1}: {row[column]!r}; expected a number"
            ) from None
    if not rows:
        raise LogFormatError(f"{path}: no rows; expected at least one")
    return np.array(rows)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _lines(path: Path | str, text: str) -> Iterator[tuple[int, list[str]]]:
    """Cut a CSV text into its lines, ended by any system's line end: their numbers and cells."""
    reader = csv.reader(io.StringIO(text, newline=None))
    try:
        for row in reader:
            yield reader.line_num, row
    except csv.Error as error:
        raise LogFormatError(f"{path}, line {reader.line_num}: {error}; expected a CSV file") from None


def header_of(path: Path | str, text: str) -> list[str]:
    """Return the names in the first line of a CSV text.

    Raises
    ------
    LogFormatError
        If it is no CSV text.
    """
    return [name.strip() for name in next(_lines(path, text), (1, []))[1]]


def read_columns(path: Path | str, wanted: Callable[[Sequence[str]], Sequence[str]]) -> dict[str, FloatArray]:
    """Return the columns (rows,) of a CSV file with a header, plain or gzip, by name; an empty cell is NaN.

    Parameters
    ----------
    path : Path or str
    wanted : callable
        Gives the columns that must be there, from the names that are.

    Raises
    ------
    LogFormatError
        If the file is no table of numbers, or a column is missing; names file, line and what was expected.
    """
    text = read_text(path)
    names = header_of(path, text)
    expected = wanted(names)
    missing = [name for name in expected if name not in names]
    if missing:
        raise LogFormatError(f"{path}, line 1: no column {', '.join(missing)}; expected {', '.join(expected)}")
    return dict(zip(names, read_table(path, text, len(names), header=True).T, strict=True))


def hanging(columns: Mapping[str, FloatArray]) -> BoolArray:
    """Tell the rows with a load on a taut cable, as far as ``attached`` and ``taut`` are among the columns."""
    told = [columns[name] == 1.0 for name in ("attached", "taut") if name in columns]
    return np.logical_and.reduce(told) if told else np.ones(columns["t_boot_s"].size, dtype=np.bool_)


def _angle_columns(names: Container[str]) -> tuple[str, ...]:
    return _PX4_SITL if _PX4_SITL[0] in names else _OWN


def within(truth: SwingTruth, start_s: float | None = None, end_s: float | None = None) -> SwingTruth:
    """Return the truth with nothing outside of a window of ``t_boot_s`` [s], both ends included, valid."""
    valid = truth.valid.copy()
    if start_s is not None:
        valid &= truth.t_boot_s >= start_s
    if end_s is not None:
        valid &= truth.t_boot_s <= end_s
    return replace(truth, valid=valid)


def read_truth(path: Path | str, start_s: float | None = None, end_s: float | None = None) -> SwingTruth:
    """Read the true swing from a CSV file, plain or gzip.

    Parameters
    ----------
    path : Path or str
        Columns, by name: ``t_boot_s`` and either ``swing_lateral_rad, swing_longitudinal_rad,
        swing_lateral_rate_rad_s, swing_longitudinal_rate_rad_s`` (px4_sitl data set) or ``xi_rad, zeta_rad,
        xi_rate_radps, zeta_rate_radps``; optionally ``attached`` and ``taut`` (1 or 0). Others are ignored.
    start_s, end_s : float, optional
        Window of ``t_boot_s`` [s], both included; rows outside are not `SwingTruth.valid`.

    Raises
    ------
    LogFormatError
        If the file is not such a table; names file, line and what was expected.
    """
    columns = read_columns(path, lambda names: ("t_boot_s", *_angle_columns(names)))
    t_boot_s = columns["t_boot_s"]
    wrong = np.flatnonzero(~(np.diff(t_boot_s) > 0.0))
    if wrong.size or not np.isfinite(t_boot_s).all():
        at = int(wrong[0]) + 1 if wrong.size else int(np.flatnonzero(~np.isfinite(t_boot_s))[0])
        raise LogFormatError(f"{path}, row {at + 1}: t_boot_s = {t_boot_s[at]}; expected more than in the row before")
    xi, zeta, xi_rate, zeta_rate = (columns[name] for name in _angle_columns(columns))
    valid = np.isfinite(xi) & np.isfinite(zeta) & np.isfinite(xi_rate) & np.isfinite(zeta_rate)
    valid &= hanging(columns)
    return within(SwingTruth(t_boot_s, xi, zeta, xi_rate, zeta_rate, valid), start_s, end_s)
