"""The protocol of the swing estimators."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from swingd.core.gp_ekf import Source
from swingd.core.status import Status
from swingd.core.swing_ekf import ANGLE_MAX_RAD, State
from swingd.model.estimate import FloatArray, ResetReason, SwingEstimate
from swingd.model.events import Vec3

INTERVAL_MAX_S = 10.0
ANGLE_STD_MAX_RAD = 1.0
"""Beyond it the estimate says nothing."""
GATED_MAX_S = 1.0
"""Measurements rejected for longer mean that the state is wrong, not the measurements."""
INPUT_MAX = 1e9
"""Forces [N] and accelerations [m/s^2] from here on are refused, so that nothing derived from them overflows."""


def inputs_valid(force_n: FloatArray, acc_mps2: FloatArray, dt_s: float) -> bool:
    """Tell whether an estimator may take these; a value that is not a number fails every comparison."""
    return bool(0.0 < dt_s <= INTERVAL_MAX_S and (abs(force_n) < INPUT_MAX).all() and (abs(acc_mps2) < INPUT_MAX).all())


def fault_of(x: FloatArray, P: FloatArray, gated_s: float) -> ResetReason | None:
    """Tell why a filter must begin anew; None where it need not.

    Parameters
    ----------
    x, P : (>= 2,), (>= 2, >= 2)
        State and covariance that begin with xi and zeta.
    gated_s : float
        For how long its measurements have been left out [s].
    """
    if max(abs(x[State.XI]), abs(x[State.ZETA])) > ANGLE_MAX_RAD:
        return ResetReason.ANGLE
    if max(P[State.XI, State.XI], P[State.ZETA, State.ZETA]) > ANGLE_STD_MAX_RAD**2:
        return ResetReason.COVARIANCE
    if gated_s > GATED_MAX_S:
        return ResetReason.INNOVATION
    return None


@dataclass(frozen=True, slots=True)
class LoadMeasurement:
    """One measurement of one source."""

    source: Source
    value: Vec3
    """ned: vehicle's position [m] or velocity [m/s], or the vehicle relative to the load [m]."""
    std: Vec3
    """Deviation of each component, > 0."""
    t_s: float
    """When it was taken, by the clock of the steps."""


class SwingEstimator(Protocol):
    """Estimates the swing from forces and accelerations in a level frame that does not turn."""

    resets: dict[ResetReason, int]
    """How often it began anew, by reason."""

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float, *, thrust_known: bool = True) -> Status:
        """Advance over one interval.

        Parameters
        ----------
        force_n : (3,)
            Mean thrust and known forces on the vehicle, level frame [N].
        acc_mps2 : (3,)
            Mean inertial acceleration of the hook, level frame [m/s^2].
        dt_s : float
            Length of the interval [s], 0 < dt_s <= `INTERVAL_MAX_S`.
        thrust_known : bool
            False where the thrust was inferred from the model itself: nothing is to be learned of it then.

        Returns
        -------
        Status
            ``OK`` or ``GATED`` where the estimate was advanced, ``INPUT_INVALID`` where an input is not finite or out
            of its range and nothing was done; anything else where the estimate was reset instead.
        """

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Advance over an interval without a measurement, the force held; invalid inputs are ignored."""

    def estimate(self) -> SwingEstimate:
        """Return the state after the last step."""

    def reset(self, reason: ResetReason, force_n: tuple[float, float, float] | None = None) -> None:
        """Begin anew with the load at rest below; ``force_n`` is the disturbance where it was measured just before."""


@runtime_checkable
class LoadEstimator(SwingEstimator, Protocol):
    """Takes besides what comes when it comes: positions, velocities and sightings, each with its own time."""

    note: str
    """What is to be told of how it was built; empty where there is nothing."""

    def stand(self, t_boot_s: float, to_ned_rad: float) -> None:
        """Tell how the interval that the next `step` advances over ends.

        Parameters
        ----------
        t_boot_s : float
            When, by the clock of the measurements' stamps [s].
        to_ned_rad : float
            By how much vectors of the level frame are turned to be vectors of ned.
        """

    def correct(self, measurement: LoadMeasurement) -> Status:
        """Take a measurement of the vehicle's hook or of the load.

        Returns
        -------
        Status
            ``OK``, ``GATED``; ``TOO_LATE`` where it is older than what is remembered, ``INPUT_INVALID`` where it cannot
            be used; anything else where the estimate began anew instead, which the next `step` answers too.
        """

    def turn(self, yaw_jump_rad: float) -> None:
        """The autopilot's yaw was reset by this much: thrust was turned to ned by a wrong one."""
