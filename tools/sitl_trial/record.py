"""What a flight leaves behind, on disk and read again."""

import io
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from swingd.model.errors import SwingdError
from swingd.model.estimate import FloatArray

COLUMNS = (
    *("t_boot_s", "swing_lateral_rad", "swing_longitudinal_rad", "heading_rad"),
    *("veh_n_m", "veh_e_m", "veh_d_m", "veh_vn_m_s", "veh_ve_m_s", "veh_vd_m_s"),
)
"""What is read of a truth file, named as in `swingd.sim.truth.COLUMNS`."""


class TrialError(SwingdError):
    """A flight could not be flown or read; the text says how far it came."""


@dataclass(frozen=True, slots=True)
class Files:
    """What a flight leaves in its folder."""

    folder: Path

    @property
    def config(self) -> Path:
        return self.folder / "config.yaml"

    @property
    def truth(self) -> Path:
        return self.folder / "truth.csv"

    @property
    def recording(self) -> Path:
        return self.folder / "flight.swingd"

    @property
    def summary(self) -> Path:
        return self.folder / "summary.json"

    @property
    def flown(self) -> Path:
        return self.folder / "flown.json"

    def log(self, name: str) -> Path:
        return self.folder / f"{name}.log"


@dataclass(frozen=True, slots=True)
class Step:
    """What is judged as a whole: a command, or a course of several; times on the autopilot's clock [s]."""

    manoeuvre: str
    name: str
    yaw_deg: float
    t_boot_s: float
    """Of the first command."""
    t_last_s: float
    """Of the last command: settling counts from here."""
    t_end_s: float
    """Of the next one."""
    velocity: list[tuple[float, float, float, float]]
    """Commanded: time, north, east, down [m/s], each until the next; empty for a commanded position."""


@dataclass(slots=True)
class Flown:
    """What the application saw of its flight."""

    version: str
    steps: list[Step] = field(default_factory=list)
    estimate: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Published: time on the autopilot's clock [s], xi, zeta [rad], horizontal size of the correction [m/s^2]."""
    clock: list[tuple[float, float]] = field(default_factory=list)
    """The autopilot's against the wall clock [s], some ten a second."""

    def save(self, path: Path) -> None:
        path.write_text(json.dumps(asdict(self)), encoding="utf-8")

    @staticmethod
    def load(path: Path) -> "Flown":
        """Read what `save` wrote.

        Raises
        ------
        TrialError
            If it is not there or something else.
        """
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            return Flown(**{**data, "steps": [Step(**step) for step in data["steps"]]})
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise TrialError(f"{path}: {error}; expected a flight of this tool") from None


@dataclass(frozen=True, slots=True)
class Truth:
    """What really happened, on the autopilot's clock; angles of the heading frame."""

    t_boot_s: FloatArray
    """(n,)"""
    angles_rad: FloatArray
    """(2, n) xi, zeta; 0 where nothing hangs that could swing."""
    yaw_rad: FloatArray
    """(n,)"""
    pos_ned_m: FloatArray
    """(3, n)"""
    vel_ned_mps: FloatArray
    """(3, n)"""

    @property
    def chi_rad(self) -> FloatArray:
        """(n,) total swing."""
        xi, zeta = self.angles_rad
        chi: FloatArray = np.arccos(np.clip(np.cos(xi) * np.cos(zeta), -1.0, 1.0))
        return chi

    @property
    def towards_ne(self) -> FloatArray:
        """(2, n) horizontal direction from hook to load, north and east, of a cable of length 1."""
        xi, zeta = self.angles_rad
        ahead, right = np.sin(zeta), -np.sin(xi) * np.cos(zeta)
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([c * ahead - s * right, s * ahead + c * right])

    @staticmethod
    def load(path: Path) -> "Truth":
        """Read a truth file of ``swingd sim``.

        Raises
        ------
        TrialError
            If it is not there or holds too little.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise TrialError(f"{path}: {error.strerror}") from None
        # A simulation that was ended may have written half of its last row.
        head, _, body = text[: text.rfind("\n") + 1].partition("\n")
        names = head.split(",")
        if body.count("\n") < 2:
            raise TrialError(f"{path}: no rows; expected the truth of a flight")
        try:
            rows = np.loadtxt(io.StringIO(body), delimiter=",", usecols=[names.index(name) for name in COLUMNS]).T
        except ValueError as error:
            raise TrialError(f"{path}: {error}; expected the columns {', '.join(COLUMNS)}") from None
        return Truth(rows[0], np.nan_to_num(rows[1:3]), rows[3], rows[4:7], rows[7:10])
