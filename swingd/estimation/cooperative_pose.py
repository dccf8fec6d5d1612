"""Position and attitude of a load that several vehicles carry, from their tethers, (22)-(27) generalised.

Any number of vehicles and tethers, any places of the anchors. The vehicles' tether directions come from
`swingd.estimation.tether_direction` or from elsewhere; all must belong to one instant.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swingd.core import load_pose as kernels
from swingd.core.load_pose import TetherRow as Column
from swingd.core.status import Status
from swingd.model.errors import ConfigurationError
from swingd.model.estimate import FloatArray
from swingd.model.events import Vec3

PLACE_MAX_M = 1e7
"""Places from here on are refused."""
TETHERS_MAX = 64


@dataclass(frozen=True, slots=True)
class TetherSight:
    """What one tether tells of the load."""

    hook_ned_m: FloatArray
    """(3,) upper end, on the vehicle."""
    direction_ned: FloatArray
    """(3,) unit vector to the load."""
    direction_cov: FloatArray | None
    """(3, 3) its covariance, of rank 2 across it; None: only the length is known, the direction is not looked at."""
    length_m: float
    length_std_m: float
    """What is not known of the length, and of the hook's place along it; infinite: only the direction counts."""
    anchor_frd_m: Vec3
    """Lower end on the load, from its CG."""


@dataclass(frozen=True, slots=True)
class KnownAngles:
    """Angles of the load that are known without the tethers; an infinite deviation: not known."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    roll_std_rad: float = math.inf
    pitch_std_rad: float = math.inf
    yaw_std_rad: float = math.inf


@dataclass(frozen=True, slots=True)
class LoadPose:
    """Pose of the load at one instant."""

    pos_ned_m: FloatArray
    """(3,) CG."""
    ned_from_frd: FloatArray
    """(3, 3)"""
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    cov: FloatArray
    """(6, 6) of roll, pitch, yaw and position."""
    chi2: float
    """Weighted sum of squared residuals; chi-square distributed."""
    dof: int
    """Its degrees of freedom: 1 for each length, 2 for each direction, 1 for each known angle, less 6."""


class CooperativePose:
    """Least squares over the anchors of one load, each weighted by what its tether knows.

    Keeps the last attitude: where the anchors leave a choice (two points tell nothing of the angle about their line)
    the search begins from there, and a known angle decides.
    """

    def __init__(self) -> None:
        self._R_last = np.eye(3)
        self._p = np.empty(3)
        self._R = np.empty((3, 3))
        self._cov = np.empty((6, 6))
        self._cost = np.empty(1)

    def reset(self, yaw_rad: float = 0.0) -> None:
        """Forget the last attitude; the search begins level, with this heading."""
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        self._R_last[:] = ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))

    def solve(
        self, tethers: Sequence[TetherSight], known: KnownAngles = KnownAngles()
    ) -> tuple[Status, LoadPose | None]:
        """Find the pose that fits everything best.

        Parameters
        ----------
        tethers : sequence of TetherSight
            Of one instant.
        known : KnownAngles

        Returns
        -------
        Status, LoadPose or None
            ``OK`` with the pose. Without one: ``INPUT_INVALID`` where a number is not finite or out of its range,
            ``NOT_POSITIVE`` where tethers and known angles do not tell the whole pose, ``NOT_CONVERGED`` or
            ``NOT_FINITE`` where no pose was found.
        """
        if not 0 < len(tethers) <= TETHERS_MAX:
            return Status.INPUT_INVALID, None
        rows = np.array([_row(tether) for tether in tethers])
        covs = np.vstack([np.zeros((3, 3)) if t.direction_cov is None else t.direction_cov for t in tethers])
        angles = np.array([known.roll_rad, known.pitch_rad, known.yaw_rad])
        std = np.array([known.roll_std_rad, known.pitch_std_rad, known.yaw_std_rad])
        if not (_valid(rows) and np.isfinite(covs).all() and np.isfinite(angles).all() and (std > 0.0).all()):
            return Status.INPUT_INVALID, None
        information = 1.0 / std**2
        status = Status(
            kernels.solve(self._p, self._R, self._cov, self._cost, rows, covs, angles, information, self._R_last)
        )
        if status is not Status.OK:
            return status, None
        self._R_last[:] = self._R
        found = np.empty(3)
        kernels.euler(found, self._R)
        roll_rad, pitch_rad, yaw_rad = found.tolist()
        return status, LoadPose(
            self._p.copy(),
            self._R.copy(),
            roll_rad,
            pitch_rad,
            yaw_rad,
            self._cov.copy(),
            float(self._cost[0]),
            int(
                np.isfinite(rows[:, Column.LENGTH_STD]).sum()
                + 2 * rows[:, Column.TOLD].sum()
                + (information > 0.0).sum()
            )
            - 6,
        )


class WinchTable:
    """Pitch of the load by what the winch has turned: f_winch of (25) as a calibrated table, linear between its rows.

    Parameters
    ----------
    differences_m : sequence of float
        Rear less front tether length, rising [m].
    pitches_rad : sequence of float
        Pitch of the load measured at each, strictly rising or strictly falling [rad].

    Raises
    ------
    ConfigurationError
        If there are fewer than two rows, a value is not finite, or the table is not monotonic.
    """

    def __init__(self, differences_m: Sequence[float], pitches_rad: Sequence[float]) -> None:
        if len(differences_m) != len(pitches_rad) or len(differences_m) < 2:
            raise ConfigurationError(
                f"winch table: {len(differences_m)} lengths and {len(pitches_rad)} pitches; expected as many, 2 or more"
            )
        self._differences_m = np.array(differences_m, dtype=float)
        self._pitches_rad = np.array(pitches_rad, dtype=float)
        steps = np.diff(self._pitches_rad)
        for row in range(len(differences_m)):
            here = f"winch table, row {row + 1}: {self._differences_m[row]:g} m, {self._pitches_rad[row]:g} rad"
            if not (math.isfinite(self._differences_m[row]) and math.isfinite(self._pitches_rad[row])):
                raise ConfigurationError(f"{here}; expected finite numbers")
            if row and not self._differences_m[row] > self._differences_m[row - 1]:
                raise ConfigurationError(f"{here}; expected more than the {self._differences_m[row - 1]:g} m before")
            if row and not steps[row - 1] * steps[0] > 0.0:
                raise ConfigurationError(f"{here}; expected pitches that only rise or only fall")

    def pitch_rad(self, front_m: float, rear_m: float) -> tuple[Status, float]:
        """Give the pitch for the lengths of front and rear tether; ``INPUT_INVALID`` and 0 beyond the table's ends."""
        difference_m = rear_m - front_m
        if not self._differences_m[0] <= difference_m <= self._differences_m[-1]:
            return Status.INPUT_INVALID, 0.0
        return Status.OK, float(np.interp(difference_m, self._differences_m, self._pitches_rad))


def printed_roll_rad(anchors_ned_m: FloatArray) -> float:
    """(24) to the letter, for comparison: it holds at yaw 0 only.

    Parameters
    ----------
    anchors_ned_m : (2, 3)
        (22) of the left and of the right vehicle.
    """
    between = anchors_ned_m[1] - anchors_ned_m[0]
    return math.atan2(between[2], between[1])


def printed_yaw_rad(azimuths_rad: Sequence[float]) -> float:
    """(26), (27) to the letter, for comparison: the circular mean of the tethers' headings psi + phi_b [rad].

    Undefined where the tethers are vertical, or pull outwards in opposite directions: then the sum vanishes.
    """
    return math.atan2(sum(map(math.sin, azimuths_rad)), sum(map(math.cos, azimuths_rad)))


def _row(tether: TetherSight) -> list[float]:
    """Give a tether as the kernel takes it."""
    told = tether.direction_cov is not None
    direction = tether.direction_ned if told else (0.0, 0.0, 1.0)
    return [
        *tether.hook_ned_m, *direction, tether.length_m, tether.length_std_m, *tether.anchor_frd_m, float(told),
    ]  # fmt: skip


def _valid(rows: FloatArray) -> bool:
    """Tell whether places are near, directions of unit length, lengths and deviations positive."""
    near = np.abs(np.delete(rows, Column.LENGTH_STD, axis=1)) < PLACE_MAX_M
    units = np.linalg.norm(rows[:, Column.DIRECTION : Column.DIRECTION + 3], axis=1)
    positive = rows[:, [Column.LENGTH, Column.LENGTH_STD]] > 0.0
    return bool(near.all() and (np.abs(units - 1.0) < 1e-6).all() and positive.all())
