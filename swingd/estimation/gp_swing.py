"""The GP-EKF as a swing estimator: from ned to the level frame, and from stamps to intervals."""

import math

import numpy as np

from swingd.core import slts
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slts import SltsState
from swingd.core.slts_swing import swing
from swingd.core.status import Status
from swingd.estimation.acceleration_model import NOTHING_LEARNED, AccelerationModel, Prepared
from swingd.estimation.base import ANGLE_STD_MAX_RAD, inputs_valid
from swingd.estimation.gp_ekf import GpEkf, GpEkfSettings, LoadEstimate, LoadMeasurement, Source
from swingd.model.estimate import FloatArray, ResetReason, SwingEstimate
from swingd.model.events import Vec3
from swingd.model.parameters import Parameters

SOURCE_LATE_S = 0.3
"""It begins at a position and velocity that are younger."""
NIS_LATE_S = 0.1
"""For how long a measurement tells how well model and measurements agree: one outlier is no disagreement."""
_RELATIVE = [SltsState.REL_POS, SltsState.REL_POS + 1, SltsState.REL_VEL, SltsState.REL_VEL + 1]


def settings_of(parameters: Parameters) -> GpEkfSettings:
    """Give the filter's settings; its vehicle is the point at the hook, its cable that of the configuration."""
    vehicle, estimator, gp_ekf = parameters.vehicle, parameters.estimator, parameters.gp_ekf
    payload_kg, length_m = parameters.payload.mass_kg, parameters.cable.length_m
    level_n = gp_ekf.thrust_noise * vehicle.mass_kg
    angle_m, rate_mps = estimator.swing_std_init_rad * length_m, estimator.swing_rate_std_init_radps * length_m
    return GpEkfSettings(
        mass_kg=vehicle.mass_kg,
        payload_mass_kg=payload_kg,
        cable_length_m=length_m,
        force_noise_n=(level_n, level_n, gp_ekf.thrust_noise_vertical * vehicle.mass_kg),
        load_force_noise_n=gp_ekf.load_force_noise * payload_kg,
        model_memory_s=gp_ekf.model_memory_s,
        nis_gate=estimator.nis_gate,
        # The load is not where the vehicle is, by as much as the cable's angle is not known.
        initial_std=(*[0.3 + angle_m] * 3, *[angle_m] * 2, *[0.3 + rate_mps] * 3, *[rate_mps] * 2),
    )


def model_of(parameters: Parameters) -> Prepared:
    """Give what was learned, or nothing.

    Raises
    ------
    ConfigurationError
        If ``gp_ekf.model_text`` is no model.
    """
    text = parameters.gp_ekf.model_text
    return AccelerationModel.from_json(text, parameters.gp_ekf.model).prepare() if text else NOTHING_LEARNED


class GpSwing:
    """Load and cable by the GP-EKF (19)-(27), told as swing angles of the level frame.

    It needs the autopilot's position and velocity; a camera makes it independent of wind on the vehicle, which it
    otherwise takes for the load's pull. The measured acceleration is not used: the thrust is.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, payload, cable, estimator and gp_ekf.

    Raises
    ------
    ConfigurationError
        If ``gp_ekf.model_text`` is no model.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._settings = settings_of(parameters)
        self._filter = GpEkf(self._settings, model_of(parameters))
        self.resets = self._filter.resets
        self._running = False
        self._t_s = -math.inf
        self._to_ned_rad = 0.0
        self._force_ned = np.zeros(3)
        self._newest: dict[Source, LoadMeasurement] = {}
        self._failure: Status | None = None

    @property
    def load(self) -> LoadEstimate | None:
        """What the filter knows of load and cable, ned; None before it has begun."""
        return self._filter.estimate() if self._running else None

    def stand(self, t_boot_s: float, to_ned_rad: float) -> None:
        """Tell when the next interval ends, and by how much vectors of the level frame are turned to be of ned."""
        self._t_s, self._to_ned_rad = t_boot_s, to_ned_rad

    def step(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float, *, thrust_known: bool = True) -> Status:
        """Advance to the time of the last `stand`; see `SwingEstimator.step`."""
        if not inputs_valid(force_n, acc_mps2, dt_s):
            return Status.INPUT_INVALID
        c, s = math.cos(self._to_ned_rad), math.sin(self._to_ned_rad)
        x, y, down = force_n.tolist()
        self._force_ned[:] = c * x - s * y, s * x + c * y, down
        if not self._running:
            self._begin()
            return Status.OK
        failure, self._failure = self._failure, None
        status = self._filter.step(self._force_ned, self._t_s)
        return status if failure is None else failure

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Do nothing: the next step covers the time since the last, whatever is missing in it."""

    def correct(self, measurement: LoadMeasurement) -> Status:
        """Take a measurement of the hook or the load, see `GpEkf.correct`; before the start it is only remembered."""
        self._newest[measurement.source] = measurement
        if not self._running:
            return Status.OK
        status = self._filter.correct(measurement)
        if status not in (Status.OK, Status.GATED, Status.TOO_LATE, Status.INPUT_INVALID):
            # The filter has begun anew; whoever steps it is to know.
            self._failure = status
        return status

    def turn(self, yaw_jump_rad: float) -> None:
        """The autopilot's yaw was reset."""
        if self._running and yaw_jump_rad != 0.0:
            self._filter.turn(yaw_jump_rad)

    def estimate(self) -> SwingEstimate:
        """Return the state after the last step; before the start nothing is known, and its covariance says so."""
        x, x_rate, P = np.zeros(7), np.zeros(4), np.zeros((7, 7))
        if not self._running:
            P[:4, :4] = np.eye(4) * ANGLE_STD_MAX_RAD**2
            return SwingEstimate(x, x_rate, P, 0.0, self._settings.payload_mass_kg * GRAVITY_MPS2)
        load = self._filter.estimate()
        acc, s = np.zeros(6), self._settings
        still, size = np.zeros(3), s.cable_length_m
        slts.acceleration(acc, load.x, self._force_ned, still, s.mass_kg, s.payload_mass_kg, size)
        swing_out, P_out = np.empty(4), np.empty((4, 4))
        relative = np.concatenate([load.x[_RELATIVE], acc[3:5]])
        swing(swing_out, x_rate, P_out, relative, load.P[np.ix_(_RELATIVE, _RELATIVE)], size, -self._to_ned_rad)
        x[:4], P[:4, :4] = swing_out, P_out
        heard = [source for source, last in self._newest.items() if self._t_s - last.t_s < NIS_LATE_S]
        nis = max((load.nis[source] for source in heard), default=0.0)
        return SwingEstimate(x, x_rate, P, nis, float(acc[5]))

    def reset(self, reason: ResetReason, force_n: Vec3 | None = None) -> None:
        """Begin anew with the next step; there is no state for a disturbance measured before."""
        self.resets[reason] += 1
        self._running = False
        self._failure = None

    def _begin(self) -> None:
        pos, vel = self._newest.get(Source.VEHICLE_POS), self._newest.get(Source.VEHICLE_VEL)
        if pos is None or vel is None or not all(abs(self._t_s - m.t_s) < SOURCE_LATE_S for m in (pos, vel)):
            return
        self._filter.begin(self._t_s, pos.value, vel.value)
        self._running = True
