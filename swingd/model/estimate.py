"""What an estimator tells, in the level frame that does not turn."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class ResetReason(Enum):
    """Why an estimator began anew."""

    START = "start"
    GAP = "gap in the IMU stream"
    CLOCK = "autopilot restarted or its clock jumped"
    LIFT = "load lifted"
    SLACK = "cable slack"
    PARAMETERS = "parameters changed"
    ATTITUDE = "autopilot reset its roll or pitch"
    ANGLE = "swing beyond what a hanging load can do"
    COVARIANCE = "covariance out of bounds"
    INNOVATION = "measurements rejected for too long"
    NUMERICS = "step failed"


@dataclass(frozen=True, slots=True)
class LearnedModel:
    """What an estimator has learned in flight of cable and load."""

    length_m: float
    """From the hook to the load's centre of mass, as the swing shows it [m]."""
    length_std_m: float
    payload_mass_kg: float
    """As the pull of the swinging load shows it [kg]."""
    payload_mass_std_kg: float


@dataclass(frozen=True, slots=True)
class SwingEstimate:
    """State of the swing after a step."""

    x: FloatArray
    """(7,) xi, zeta [rad], their rates [rad/s], disturbance force on the vehicle [N]; level frame. Read only."""
    x_rate: FloatArray
    """(4,) time derivative of xi, zeta and of their rates by the model."""
    P: FloatArray
    """(7, 7) covariance of ``x``. Read only."""
    nis: float
    """Normalised innovation squared of the last measurement, 3 degrees of freedom (fgdf, tether-ukf: 2); 0: there is
    none."""
    tension_n: float
    """Cable force by the model [N]; negative where a real cable would be slack."""
    learned: LearnedModel | None = None
    """None where the estimator learns nothing of its model."""
    noise_inflation: float = 1.0
    """Largest measurement noise density over the configured one, as the innovation shows it: vibration."""
