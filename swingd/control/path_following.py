"""Path following of a slung load as an object with state, (5)-(11) of the GP-EKF paper."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swingd.core import path_following as kernels
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.path_following import PathParam, PathState, PathTerm
from swingd.core.slts import SltsState
from swingd.core.status import Status
from swingd.model.errors import ConfigurationError
from swingd.model.estimate import FloatArray
from swingd.model.events import Vec3
from swingd.model.parameters import LEG_MIN_M

__all__ = ["PathFollower", "PathSettings", "PathTerm"]

POSITION_MAX_M = 1e5
"""Of a waypoint from the origin, along every axis."""
INTERVAL_MAX_S = 1.0


@dataclass(frozen=True, slots=True)
class PathSettings:
    """Vehicle, speed, gains (the paper prints none) and limits."""

    mass_kg: float
    payload_mass_kg: float
    cable_length_m: float
    """From the vehicle's centre of mass to the load's."""
    cruise_mps: float = 2.0
    lead_m: float = 1.25
    """A leg ends where less than this is left of it."""
    k_p: float = 0.7
    """[1/s]"""
    k_l: float = 1.5
    """[1/s]"""
    k_0_per_mass: float = 1.0
    """K0 over the mass of vehicle and load [1/s]."""
    k_r: float = 1.0
    """[1/s]"""
    leak: float = 1.0
    """lambda of F [1/s]."""
    lambda_t: float = 1.0
    """[1/s]"""
    kappa: float = 2.0
    """[1/s]"""
    tilt_max_rad: float = math.radians(35.0)
    lift_min: float = 0.3
    """Vertical part of the thrust over the weight of vehicle and load."""
    lift_max: float = 1.8

    @property
    def total_mass_kg(self) -> float:
        """Vehicle and load."""
        return self.mass_kg + self.payload_mass_kg

    def packed(self) -> FloatArray:
        """Return it as (PathParam.SIZE,)."""
        weight_n = self.total_mass_kg * GRAVITY_MPS2
        packed = np.array(
            [
                self.mass_kg, self.payload_mass_kg, self.cable_length_m, self.cruise_mps, self.lead_m, self.k_p,
                self.k_l, self.k_0_per_mass * self.total_mass_kg, self.k_r, self.leak, self.lambda_t, self.kappa,
                self.tilt_max_rad, self.lift_min * weight_n, self.lift_max * weight_n,
            ]
        )  # fmt: skip
        assert packed.size == PathParam.SIZE
        return packed


class PathFollower:
    """Leads the load along straight legs between waypoints and holds it at the last one.

    Parameters
    ----------
    settings : PathSettings
    waypoints_ned_m : sequence of Vec3
        Of the load; a single one is a place to hold.

    Raises
    ------
    ConfigurationError
        If a waypoint is not finite or too far away, or two neighbours are the same place.
    """

    def __init__(self, settings: PathSettings, waypoints_ned_m: Sequence[Vec3]) -> None:
        self._settings = settings
        self._p = settings.packed()
        self._waypoints = _checked(waypoints_ned_m)
        self._lengths_m = np.linalg.norm(np.diff(self._waypoints, axis=0), axis=1)
        self._state = np.zeros(PathState.SIZE)
        self._terms = np.zeros(PathTerm.SIZE)
        self._begun = False

    def begin(self, x: FloatArray, known: "PathFollower | None" = None) -> Status:
        """Start on the first leg with an estimate (10,); see `update` for the answers.

        The disturbances are those that ``known`` has estimated by now, on another path; without it none is known.
        """
        if not _finite(x, SltsState.REL_VEL + 2):
            return Status.INPUT_INVALID
        status = Status(kernels.begin(self._state, np.ascontiguousarray(x, dtype=float), self._waypoints, self._p))
        self._begun = status is Status.OK
        if self._begun and known is not None:
            self._state[PathState.F : PathState.IMPULSE] = known._state[PathState.F : PathState.IMPULSE]
            # (8): d_T is lambda_T times what is missing from the integral.
            self._state[PathState.IMPULSE : PathState.IMPULSE + 3] -= known.term(PathTerm.D_T) / self._settings.lambda_t
        self._terms[:] = 0.0
        return status

    def update(
        self, x: FloatArray, thrust_ned_n: FloatArray, specific_force_ned_mps2: FloatArray, dt_s: float
    ) -> Status:
        """Compute the thrust wanted now.

        Parameters
        ----------
        x : (10,)
            Estimate, see `swingd.core.slts.SltsState`.
        thrust_ned_n : (3,)
            f_L as the vehicle is believed to give it now, ned [N].
        specific_force_ned_mps2 : (3,)
            Of the vehicle, the accelerometer's reading turned into ned [m/s^2].
        dt_s : float
            Since the last update [s], 0 <= dt_s <= `INTERVAL_MAX_S`.

        Returns
        -------
        Status
            ``OK``; ``INPUT_INVALID`` where an input is not finite or out of its range, or before `begin`;
            ``NOT_CONVERGED`` where the load is out of r's reach. Nothing was done then, and the last answer stands.
        """
        inputs = _finite(x, SltsState.REL_VEL + 2) and _finite(thrust_ned_n, 3) and _finite(specific_force_ned_mps2, 3)
        if not (self._begun and inputs and 0.0 <= dt_s <= INTERVAL_MAX_S):
            return Status.INPUT_INVALID
        terms = self._terms.copy()
        status = Status(
            kernels.update(
                terms, self._state, np.ascontiguousarray(x, dtype=float),
                np.ascontiguousarray(thrust_ned_n, dtype=float),
                np.ascontiguousarray(specific_force_ned_mps2, dtype=float), self._waypoints, self._p, dt_s,
            )
        )  # fmt: skip
        if status is Status.OK:
            self._terms = terms
        return status

    def term(self, first: PathTerm) -> FloatArray:
        """Return a term of the last update by the paper's symbol: 3 components, 2 of R_D and MU, 1 of the scalars."""
        count = {PathTerm.R_D: 2, PathTerm.MU: 2, PathTerm.ENERGY: 1, PathTerm.REMAINING: 1}.get(first, 3)
        return self._terms[first : first + count].copy()

    @property
    def thrust_ned_n(self) -> FloatArray:
        """(3,) f_v, the thrust wanted."""
        return self.term(PathTerm.F_V)

    @property
    def acceleration_ned_mps2(self) -> FloatArray:
        """(3,) the same as acceleration, for an autopilot that knows the thrust of hovering with the load."""
        gravity = np.array([0.0, 0.0, GRAVITY_MPS2])
        return np.asarray(self.thrust_ned_n / self._settings.total_mass_kg + gravity)

    def attitude(self, yaw_rad: float) -> FloatArray:
        """Return ned_from_frd (3, 3) that gives the wanted thrust with the nose towards a heading, (11)."""
        R = np.empty((3, 3))
        kernels.desired_attitude(R, self.thrust_ned_n, yaw_rad)
        return R

    @property
    def leg(self) -> int:
        """Index of the waypoint where the leg begins; of the last one while the load is held there."""
        return int(self._state[PathState.LEG])

    @property
    def holding(self) -> bool:
        """Whether the path is flown and the load is held at its end."""
        return self.leg + 1 >= len(self._waypoints)

    @property
    def remaining_m(self) -> float:
        """Path left, along the legs."""
        if self.holding:
            return 0.0
        return float(self._terms[PathTerm.REMAINING] + self._lengths_m[self.leg + 1 :].sum())


def _finite(values: FloatArray, count: int) -> bool:
    return len(values) == count and bool(np.isfinite(values).all())


def _checked(waypoints_ned_m: Sequence[Vec3]) -> FloatArray:
    if not waypoints_ned_m:
        raise ConfigurationError("path: no waypoint given; expected at least one")
    for number, waypoint in enumerate(waypoints_ned_m, start=1):
        if len(waypoint) != 3 or not all(abs(value) <= POSITION_MAX_M for value in waypoint):
            raise ConfigurationError(
                f"path: waypoint {number}: {tuple(waypoint)} given; "
                f"expected north, east, down within {POSITION_MAX_M:g} m"
            )
    waypoints = np.array(waypoints_ned_m, dtype=float)
    for number, length_m in enumerate(np.linalg.norm(np.diff(waypoints, axis=0), axis=1), start=2):
        if length_m < LEG_MIN_M:
            raise ConfigurationError(
                f"path: waypoint {number} is {length_m:.3g} m from the one before; expected at least {LEG_MIN_M:g} m"
            )
    return waypoints
