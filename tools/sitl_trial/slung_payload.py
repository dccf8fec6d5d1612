"""The truth of ArduPilot's own simulated slung payload, from its onboard log."""

from pathlib import Path

import numpy as np
from pymavlink.DFReader import DFReader_binary
from scipy.interpolate import CubicSpline

from swingd.model.estimate import FloatArray

from .record import COLUMNS, TrialError

RATE_HZ = 50.0
_ROWS = {
    "SLUP": ("PN", "PE", "PD"),  # load from vehicle [m], 10 Hz
    "SIM2": ("PN", "PE", "PD", "VN", "VE", "VD"),  # vehicle from home [m, m/s], at its loop rate
    "SIM": ("Yaw",),  # [deg], 25 Hz
}


def write_truth(folder: Path, path: Path) -> None:
    """Read the last onboard log of a folder and write the truth file that ``swingd sim`` would have written.

    Raises
    ------
    TrialError
        If there is no log, or no slung payload in it.
    """
    logs = sorted(folder.glob("*.BIN"))
    if not logs:
        raise TrialError(f"{folder}: no onboard log; expected one of ArduPilot")
    rows = _read(logs[-1])
    t = {name: values[0] for name, values in rows.items()}
    begin_s, end_s = max(times[0] for times in t.values()), min(times[-1] for times in t.values())
    grid = np.arange(begin_s, end_s, 1.0 / RATE_HZ)
    load = CubicSpline(t["SLUP"], rows["SLUP"][1:], axis=1)(grid)
    vehicle = np.array([np.interp(grid, t["SIM2"], values) for values in rows["SIM2"][1:]])
    yaw = np.interp(grid, t["SIM"], np.unwrap(np.radians(rows["SIM"][1])))
    c, s = np.cos(yaw), np.sin(yaw)
    ahead, right, down = c * load[0] + s * load[1], c * load[1] - s * load[0], load[2]
    xi, zeta = np.arctan2(-right, down), np.arcsin(ahead / np.linalg.norm(load, axis=0))
    table = np.array([grid, xi, zeta, yaw, *vehicle]).T
    np.savetxt(path, table, fmt="%.6g", delimiter=",", header=",".join(COLUMNS), comments="")


def _read(path: Path) -> dict[str, FloatArray]:
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in _ROWS}
    log = DFReader_binary(str(path))
    try:
        while (message := log.recv_match(type=list(_ROWS))) is not None:
            name = message.get_type()
            found[name].append((1e-6 * message.TimeUS, *(getattr(message, field) for field in _ROWS[name])))
    finally:
        log.close()
    missing = [name for name, rows in found.items() if len(rows) < 4]
    if missing:
        raise TrialError(
            f"{path}: too little of {', '.join(missing)}; expected the log of a flight with SIM_SLUP_ENABLE"
        )
    # A message may come twice with one stamp; a spline takes increasing times.
    tables = {name: np.array(rows).T for name, rows in found.items()}
    return {name: table[:, np.diff(table[0], prepend=-1.0) > 0.0] for name, table in tables.items()}
