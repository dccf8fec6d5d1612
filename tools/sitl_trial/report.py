"""The figures of all flights as tables: on the terminal, in Markdown, as CSV and as JSON."""

import csv
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import swingd

from .figures import StepFigures
from .flight import Flight
from .plan import Correction
from .record import Step
from .verdict import REAL_TIME_MIN, REAL_TIME_WORST_MIN, Verdict, ratio

ORDER = tuple(Correction)


@dataclass(frozen=True, slots=True)
class Grid:
    """One table."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]

    def markdown(self) -> str:
        lines = [self.header, tuple("---:" if i else "---" for i in range(len(self.header))), *self.rows]
        return f"## {self.title}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"

    def rich(self) -> Table:
        table = Table(title=self.title, title_justify="left")
        for i, name in enumerate(self.header):
            table.add_column(name, justify="right" if i else "left", overflow="fold")
        for row in self.rows:
            table.add_row(*row)
        return table


def grids(flights: list[Flight], verdicts: list[Verdict]) -> list[Grid]:
    """Return the tables: steps, decay, flights, what is asked."""
    return [_steps(flights), _decays(flights), _flights(flights), _asked(verdicts)]


def write(folder: Path, flights: list[Flight], verdicts: list[Verdict], failures: list[str]) -> dict[str, Any]:
    """Write ``trial.md``, ``trial.csv`` and ``trial.json``; return what the last one holds."""
    text = "\n".join(grid.markdown() for grid in grids(flights, verdicts))
    if failures:
        text += "\n## Not flown\n\n" + "\n".join(f"    {line}" for line in "\n".join(failures).splitlines()) + "\n"
    (folder / "trial.md").write_text(f"# {title(flights)}\n\n{text}", encoding="utf-8")
    rows = _records(flights)
    with (folder / "trial.csv").open("w", encoding="utf-8", newline="") as file:
        if rows:
            writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    found = {
        "title": title(flights),
        "steps": rows,
        "flights": [
            {"flight": flight.name, "correction": flight.correction.value, **asdict(flight.figures)}
            for flight in flights
        ],
        "asked": [asdict(verdict) for verdict in verdicts],
        "not_flown": failures,
    }
    (folder / "trial.json").write_text(json.dumps(found, indent=1, allow_nan=False), encoding="utf-8")
    return found


def show(flights: list[Flight], verdicts: list[Verdict], console: Console) -> None:
    """Print the tables."""
    console.print(title(flights), highlight=False)
    for grid in grids(flights, verdicts):
        console.print(grid.rich())


def title(flights: list[Flight]) -> str:
    """Name what flew."""
    versions = ", ".join(sorted({flight.flown.version for flight in flights})) or "nothing flown"
    return f"swingd {swingd.__version__} on {versions}"


def _steps(flights: list[Flight]) -> Grid:
    columns: tuple[tuple[str, Callable[[StepFigures], str]], ...] = (
        ("peak [deg]", lambda f: f"{f.peak_deg:.1f}"),
        ("under 2 deg after [s]", lambda f: f"{'' if f.settled else '>'}{f.settle_s:.1f}"),
        ("[periods]", lambda f: f"{'' if f.settled else '>'}{f.settle_periods:.2f}"),
        ("RMS [deg]", lambda f: f"{f.rms_deg:.2f}"),
        ("velocity error [m/s]", lambda f: "-" if f.velocity_rmse_mps is None else f"{f.velocity_rmse_mps:.2f}"),
        ("altitude [m]", lambda f: f"{f.altitude_m:.2f}"),
    )
    rows = []
    for name, step, found in _by_step(flights):
        cells = [" / ".join(text(found[c]) if c in found else "" for c in ORDER) for _, text in columns]
        off = found.get(Correction.OFF)
        ratios = [
            " / ".join(
                _number(ratio(getattr(found[c], key), getattr(off, key, None)) if c in found else None)
                for c in ORDER[1:]
            )
            for key in ("rms_deg", "velocity_rmse_mps")
        ]
        cells.insert(4, ratios[0])
        cells.insert(6, ratios[1])
        rows.append((f"{name}: {step.manoeuvre} {step.name}".rstrip(), *cells))
    names = [name for name, _ in columns]
    names.insert(4, "of off")
    names.insert(6, "of off")
    return Grid(f"Steps: {' / '.join(ORDER)}", ("flight and step", *names), rows)


def _decays(flights: list[Flight]) -> Grid:
    rows = [
        (f"{flight.name}: {step.manoeuvre} {step.name}".rstrip(), _number(f.period_s), _number(f.damping_ratio, 3))
        for flight in flights
        if flight.correction is Correction.OFF
        for step, f in flight.steps
    ]
    return Grid("Free decay without correction", ("flight and step", "period [s]", "damping ratio"), rows)


def _flights(flights: list[Flight]) -> Grid:
    rows = []
    for flight in flights:
        f = flight.figures
        slow = " slow" if f.real_time < REAL_TIME_MIN or f.real_time_worst < REAL_TIME_WORST_MIN else ""
        rows.append(
            (
                f"{flight.name}, {flight.correction}",
                f"{f.xi_rmse_deg:.2f}",
                f"{f.zeta_rmse_deg:.2f}",
                f"{f.filter_hz:.1f}",
                _number(f.latency_ms_p99, 1),
                f"{f.real_time:.2f}",
                f"{f.real_time_worst:.2f}{slow}",
            )
        )
    header = (
        "flight",
        "xi RMSE [deg]",
        "zeta RMSE [deg]",
        "filter [Hz]",
        "latency p99 [ms]",
        "x real time",
        "worst 2 s",
    )
    return Grid("Flights", header, rows)


def _asked(verdicts: list[Verdict]) -> Grid:
    rows = [
        (v.where, v.what, f"{v.value:.2f}", f"{v.limit:g}", "yes" if v.reached else "NO")
        for v in sorted(verdicts, key=lambda v: v.reached)
    ]
    return Grid("Asked", ("where", "what", "measured", "at most", "reached"), rows)


def _by_step(flights: list[Flight]) -> Iterable[tuple[str, Step, dict[Correction, StepFigures]]]:
    """One entry for each step that was flown, whatever the corrections."""
    found: dict[tuple[str, int], tuple[str, Step, dict[Correction, StepFigures]]] = {}
    for flight in flights:
        for number, (step, figures) in enumerate(flight.steps):
            entry = found.setdefault((flight.name, number), (flight.name, step, {}))
            entry[2][flight.correction] = figures
    return found.values()


def _records(flights: list[Flight]) -> list[dict[str, Any]]:
    rows = []
    for name, step, found in _by_step(flights):
        off = found.get(Correction.OFF)
        for correction, figures in found.items():
            rows.append(
                {
                    "flight": name,
                    "manoeuvre": step.manoeuvre,
                    "step": step.name,
                    "yaw_deg": step.yaw_deg,
                    "correction": correction.value,
                    **asdict(figures),
                    "rms_ratio": ratio(figures.rms_deg, getattr(off, "rms_deg", None)),
                    "velocity_ratio": ratio(figures.velocity_rmse_mps, getattr(off, "velocity_rmse_mps", None)),
                }
            )
    return rows


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
