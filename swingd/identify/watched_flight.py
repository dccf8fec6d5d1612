"""Flights in which something watched the load from outside, as the logs that an acceleration model is trained on."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swingd.core.level import level_from_frd
from swingd.identify.swing_log import GAP_S, write_rows
from swingd.model.actions import SwingReport
from swingd.model.errors import LogFormatError
from swingd.model.estimate import FloatArray
from swingd.model.events import Attitude
from swingd.record.truth import hanging, read_columns

WATCHED = ("t_boot_s", "veh_n_m", "veh_e_m", "load_n_m", "load_e_m")
WATCHED_VELOCITY = ("veh_vn_m_s", "veh_ve_m_s")


@dataclass(frozen=True, slots=True)
class Watched:
    """Where vehicle and load were, on the autopilot's clock; rows with a load on a taut cable only."""

    t_boot_s: FloatArray
    """(n,) rising."""
    rel_m: FloatArray
    """(n, 2) vehicle's centre of gravity relative to the load, north and east."""
    vel_mps: FloatArray | None
    """(n, 2) of the vehicle, north and east."""


@dataclass(frozen=True, slots=True)
class SwingRows:
    """Rows of a training log, see `swingd.identify.swing_log`."""

    t_s: FloatArray
    """(n,)"""
    force_ned_n: FloatArray
    """(n, 3)"""
    rel_m: FloatArray
    """(n, 2) hook relative to the load."""
    vel_mps: FloatArray | None
    """(n, 2)"""

    def write(self, path: Path) -> None:
        """Write the log; see `swingd.identify.swing_log.write`."""
        write_rows(path, self.t_s, self.force_ned_n, self.rel_m, vel_mps=self.vel_mps)


def read_watched(path: Path) -> Watched:
    """Read what watched the load, a CSV file, plain or gzip, such as ``swingd sim --truth`` writes.

    Raises
    ------
    LogFormatError
        If the file is not such a table; names file, line and what was expected.
    """
    columns = read_columns(path, lambda _names: WATCHED)
    kept = np.isfinite(np.column_stack([columns[name] for name in WATCHED])).all(axis=1)
    kept &= hanging(columns)
    t_boot_s = columns["t_boot_s"][kept]
    if not (np.diff(t_boot_s) > 0.0).all():
        at = int(np.flatnonzero(~(np.diff(t_boot_s) > 0.0))[0])
        raise LogFormatError(f"{path}: t_boot_s = {t_boot_s[at + 1]} after {t_boot_s[at]}; expected it to rise")
    rel_m = np.column_stack([columns[f"veh_{axis}_m"] - columns[f"load_{axis}_m"] for axis in ("n", "e")])[kept]
    moving = all(name in columns for name in WATCHED_VELOCITY)
    vel_mps = np.column_stack([columns[name] for name in WATCHED_VELOCITY])[kept] if moving else None
    return Watched(t_boot_s, rel_m, vel_mps)


def swing_rows(
    watched: Watched, reports: Sequence[SwingReport], attitudes: Sequence[Attitude], hook_frd_m: tuple[float, ...]
) -> SwingRows:
    """Join what was seen from outside with what the filter was driven by.

    Parameters
    ----------
    watched : Watched
    reports : sequence of SwingReport
        Of a replay of the flight; steps without a watched row within `GAP_S` on both sides are left out, and those
        whose thrust was inferred from the acceleration, which says nothing of what the acceleration's model lacks.
    attitudes : sequence of Attitude
        Of the same flight, at least two.
    hook_frd_m : (3,)
        From the centre of gravity: the logs have the hook relative to the load.

    Raises
    ------
    LogFormatError
        If not one step of the flight was watched with a known thrust.
    """
    driven = [report for report in reports if report.thrust_known]
    t_s = np.array([report.t_boot_s for report in driven])
    force = np.array([report.applied_ned_n for report in driven]).reshape(-1, 3)
    after = np.searchsorted(watched.t_boot_s, t_s)
    inside = (after > 0) & (after < watched.t_boot_s.size)
    if inside.any():
        at = np.clip(after, 1, watched.t_boot_s.size - 1)
        inside &= watched.t_boot_s[at] - watched.t_boot_s[at - 1] <= GAP_S
    if not inside.any() or len(attitudes) < 2:
        raise LogFormatError(
            "no step of the flight was watched with a known thrust; expected t_boot_s on the autopilot's clock, and "
            "motor outputs or a throttle"
        )
    t_s, force = t_s[inside], force[inside]

    def at_steps(values: FloatArray, times: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(t_s, times, column) for column in values.T])

    rel_m = at_steps(watched.rel_m, watched.t_boot_s) + _hook_ned_m(t_s, attitudes, hook_frd_m)
    vel_mps = None if watched.vel_mps is None else at_steps(watched.vel_mps, watched.t_boot_s)
    return SwingRows(t_s, force, rel_m, vel_mps)


def _hook_ned_m(t_s: FloatArray, attitudes: Sequence[Attitude], hook_frd_m: tuple[float, ...]) -> FloatArray:
    """(n, 2) horizontal part of the hook's place from the centre of gravity."""
    times = np.array([attitude.t_boot_s for attitude in attitudes])
    angles = np.array([(a.roll_rad, a.pitch_rad, a.yaw_rad) for a in attitudes])
    roll, pitch, yaw = (np.interp(t_s, times, angle) for angle in np.unwrap(angles, axis=0).T)
    hook, ned_from_frd, places = np.array(hook_frd_m), np.empty((3, 3)), np.empty((t_s.size, 2))
    for row in range(t_s.size):
        level_from_frd(ned_from_frd, roll[row], pitch[row], yaw[row])
        places[row] = ned_from_frd[:2] @ hook
    return places
