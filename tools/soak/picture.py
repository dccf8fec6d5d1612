"""A soak as a picture: memory, handles, latency, health, resets, refusals and error over the simulated hours."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from swingd.model.actions import Health

from .record import Hour, Lane
from .verdict import MB

COLORS = {
    Health.INIT: "tab:gray",
    Health.READY: "tab:green",
    Health.ACTIVE: "tab:blue",
    Health.DEGRADED: "tab:orange",
    Health.FAULT: "tab:red",
}
SHARES_MAX = 200
"""Columns of the health's shares: minutes are gathered where there are more."""
REASONS_MAX = 8


def draw(lanes: list[Lane], path: Path) -> None:
    """Write the picture, one column for each lane."""
    figure = Figure(figsize=(6.5 * len(lanes), 17.0), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(7, len(lanes), sharex="col", squeeze=False)
    for column, lane in zip(rows.T, lanes, strict=True):
        memory, handles, latency, health, resets, refusals, error = column
        memory.set_title(f"seed {lane.seed}, {lane.autopilot}: {lane.flown_s / lane.wall_s:.1f} x real time")
        t_h = np.array([sample.t_s for sample in lane.samples]) / 3600.0
        memory.plot(t_h, [sample.rss_bytes / MB for sample in lane.samples])
        handles.step(t_h, [sample.handles for sample in lane.samples], where="post")
        _latency(latency, lane.hours)
        _health(health, lane)
        _counts(resets, t_h, [sample.resets for sample in lane.samples])
        _counts(refusals, t_h, [sample.refusals for sample in lane.samples])
        refusals.set_yscale("symlog")
        _error(error, lane.hours)
        error.set_xlabel("simulated time [h]")
        for axis in column:
            axis.grid(alpha=0.3)
    for axis, label in zip(
        rows[:, 0],
        ("RSS [MB]", "file handles", "latency [ms]", "share of health", "resets", "refusals", "error of angles [deg]"),
        strict=True,
    ):
        axis.set_ylabel(label)
    figure.savefig(path, dpi=90)


def _latency(axis: Axes, hours: list[Hour]) -> None:
    t_h = [hour.t_s / 3600.0 for hour in hours]
    for color, name, taken in (
        ("tab:blue", "engine", [hour.engine for hour in hours]),
        ("tab:orange", "Pipeline.step", [hour.pipeline for hour in hours]),
    ):
        for style, figure, value in (
            (":", "p50", [p.p50_s for p in taken]),
            ("-", "p99", [p.p99_s for p in taken]),
            ("--", "max", [p.max_s for p in taken]),
        ):
            axis.plot(t_h, 1e3 * np.array(value), style, color=color, marker=".", label=f"{name}, {figure}")
    axis.set_yscale("log")
    axis.legend(fontsize="x-small", ncols=2)


def _health(axis: Axes, lane: Lane) -> None:
    gathered = max(1, -(-len(lane.samples) // SHARES_MAX))
    groups = [lane.samples[i : i + gathered] for i in range(0, len(lane.samples), gathered)]
    ends_h = [group[-1].t_s / 3600.0 for group in groups]
    seconds = np.array([[sum(s.health_s.get(h.value, 0.0) for s in group) for h in COLORS] for group in groups]).T
    shares = seconds / np.maximum(seconds.sum(axis=0), 1e-9)
    axis.stackplot(ends_h, shares, colors=COLORS.values(), labels=[h.value for h in COLORS], step="pre")
    axis.set_ylim(0.0, 1.0)
    axis.legend(fontsize="x-small", ncols=5, loc="lower left")


def _counts(axis: Axes, t_h: Iterable[float], counts: list[dict[str, int]]) -> None:
    last = counts[-1] if counts else {}
    for reason in sorted(last, key=lambda reason: last[reason], reverse=True)[:REASONS_MAX]:
        axis.plot(t_h, [count.get(reason, 0) for count in counts], label=reason)
    if last:
        axis.legend(fontsize="x-small")


def _error(axis: Axes, hours: list[Hour]) -> None:
    t_h = [hour.t_s / 3600.0 for hour in hours]
    for name, values in (
        ("nothing wrong, READY or ACTIVE", [hour.error_quiet_deg for hour in hours]),
        ("under faults, READY or ACTIVE", [hour.error_faults_deg for hour in hours]),
    ):
        axis.plot(t_h, [np.nan if value is None else value for value in values], marker=".", label=name)
    axis.set_ylim(bottom=0.0)
    axis.legend(fontsize="x-small")
