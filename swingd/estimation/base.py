"""The protocol of the swing estimators."""

from typing import Protocol

from swingd.core.status import Status
from swingd.model.estimate import FloatArray, ResetReason, SwingEstimate


class SwingEstimator(Protocol):
    """Estimates the swing from forces and accelerations in a level frame that does not turn."""

    resets: dict[ResetReason, int]
    """How often it began anew, by reason."""

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float) -> Status:
        """Advance over one interval.

        Parameters
        ----------
        force_n : (3,)
            Mean thrust and known forces on the vehicle, level frame [N].
        acc_mps2 : (3,)
            Mean inertial acceleration of the hook, level frame [m/s^2].
        dt_s : float
            Length of the interval [s].

        Returns
        -------
        Status
            ``OK`` or ``GATED`` where the estimate was advanced; anything else where it was reset instead.
        """

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Advance over an interval without a measurement, the force held."""

    def estimate(self) -> SwingEstimate:
        """Return the state after the last step."""

    def reset(self, reason: ResetReason, force_n: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Begin anew with the load at rest below and a first guess of the disturbance force."""
