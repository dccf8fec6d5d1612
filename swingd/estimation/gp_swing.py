"""The GP-EKF as a swing estimator: from ned to the level frame, and from stamps to intervals."""

import math
from dataclasses import dataclass

import numpy as np

from swingd.core import slts
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slts import SltsState
from swingd.core.slts_swing import swing
from swingd.core.status import Status
from swingd.estimation.acceleration_model import NOTHING_LEARNED, AccelerationModel, Prepared
from swingd.estimation.base import ANGLE_STD_MAX_RAD, inputs_valid
from swingd.estimation.gp_ekf import GAP_MAX_S, GpEkf, GpEkfSettings, LoadEstimate, LoadMeasurement, Source
from swingd.model.estimate import FloatArray, ResetReason, SwingEstimate
from swingd.model.events import Vec3
from swingd.model.parameters import Parameters

SOURCE_LATE_S = 0.3
"""It begins at a position and velocity that are younger."""
POSITION_LOST_S = 0.5
"""Without a position for longer the angles are told as unknown: nothing shows any more whether they are right."""
SWING_STD_INIT_MAX_RAD = 0.5
"""Beyond, the filter would take itself for lost at its beginning."""
NIS_GATE_MAX = 30.0
"""Of 3 degrees of freedom, one in a million is above."""
NIS_UNKNOWN = 1e3
"""Told while there is nothing that could agree with measurements."""
NIS_HELD_MAX_S = 0.25
"""A measurement speaks until the next of its source is due, at most for so long: one outlier is no disagreement."""
MEMORY_S = 0.35
"""Beyond the camera's usual delay."""
CORRECTIONS_PER_S = 160.0
"""Positions, velocities and pictures, as many as may come."""
FELT_FAST_S = 0.2
FELT_SLOW_S = 3.0
"""What the cable's pull is felt to differ from the estimate's for longer is wind on the vehicle."""
FELT_SHARE = 0.1
"""Of the load's weight, across: as much as this, and `FELT_VEHICLE_SHARE` of the vehicle's, the pull may differ by."""
FELT_VEHICLE_SHARE = 0.02
FELT_NIS = 5.0
"""Told as normalised innovation squared where the pull differs by as much as it may."""
CAMERA_TRUSTED_S = 0.7
"""For so long after a picture that agrees the load is where it was seen, whatever the vehicle feels: that is wind."""
_RELATIVE = [SltsState.REL_POS, SltsState.REL_POS + 1, SltsState.REL_VEL, SltsState.REL_VEL + 1]
_OF_VEHICLE = (Source.VEHICLE_POS, Source.VEHICLE_VEL)


def settings_of(parameters: Parameters) -> GpEkfSettings:
    """Give the filter's settings; its vehicle is the point at the hook, its cable that of the configuration."""
    vehicle, estimator, gp_ekf = parameters.vehicle, parameters.estimator, parameters.gp_ekf
    payload_kg, length_m = parameters.payload.mass_kg, parameters.cable.length_m
    level_n = gp_ekf.thrust_noise * vehicle.mass_kg
    angle_m = min(estimator.swing_std_init_rad, SWING_STD_INIT_MAX_RAD) * length_m
    rate_mps = estimator.swing_rate_std_init_radps * length_m
    return GpEkfSettings(
        mass_kg=vehicle.mass_kg,
        payload_mass_kg=payload_kg,
        cable_length_m=length_m,
        force_noise_n=(level_n, level_n, gp_ekf.thrust_noise_vertical * vehicle.mass_kg),
        load_force_noise_n=gp_ekf.load_force_noise * payload_kg,
        model_memory_s=gp_ekf.model_memory_s,
        nis_gate=min(estimator.nis_gate, NIS_GATE_MAX),
        # The load is not where the vehicle is, by as much as the cable's angle is not known.
        initial_std=(*[0.3 + angle_m] * 3, *[angle_m] * 2, *[0.3 + rate_mps] * 3, *[rate_mps] * 2),
        memory=math.ceil((parameters.camera.delay_s + MEMORY_S) * (estimator.rate_hz + CORRECTIONS_PER_S)),
    )


@dataclass(slots=True)
class _Heard:
    """What the last measurement of a source said, and when it came by the clock of the steps."""

    came_s: float
    lasts_s: float
    nis: float


class GpSwing:
    """Load and cable by the GP-EKF (19)-(27), told as swing angles of the level frame.

    It needs the autopilot's position and velocity; a camera helps where thrust and wind are not known well. It does not
    use the measured acceleration: that judges it. A cable that is felt to pull otherwise than the estimate says, by
    more than a steady wind explains, and that no camera sees, is told as a disagreement (`SwingEstimate.nis`).

    Parameters
    ----------
    parameters : Parameters
        Vehicle, payload, cable, estimator, gp_ekf and camera.

    Raises
    ------
    ConfigurationError
        If ``gp_ekf.model_text`` is no model.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._settings = settings_of(parameters)
        s = self._settings
        self._allowed_n = GRAVITY_MPS2 * math.hypot(FELT_SHARE * s.payload_mass_kg, FELT_VEHICLE_SHARE * s.mass_kg)
        self.note = ""
        """Why what was learned is not used; empty where it is, or where there is nothing."""
        self._filter = GpEkf(self._settings, self._model_of(parameters))
        self.resets = self._filter.resets
        self._t_s = -math.inf
        self._to_ned_rad = 0.0
        self._force_ned = np.zeros(3)
        self._newest: dict[Source, LoadMeasurement] = {}
        self._forget()

    def _model_of(self, parameters: Parameters) -> Prepared:
        text, s = parameters.gp_ekf.model_text, self._settings
        if not text:
            return NOTHING_LEARNED
        model = AccelerationModel.from_json(text, parameters.gp_ekf.model)
        # Masses and cable may have been changed, or weighed, since the configuration was judged.
        misfit = model.misfit(s.mass_kg, s.payload_mass_kg, s.cable_length_m)
        if misfit:
            self.note = f"{parameters.gp_ekf.model} is not used: {misfit}"
            return NOTHING_LEARNED
        return model.prepare()

    def _forget(self) -> None:
        self._running = False
        self._failure: Status | None = None
        self._heard: dict[Source, _Heard] = {}
        self._felt_fast, self._felt_slow = np.zeros(2), np.zeros(2)
        P = np.zeros((7, 7))
        P[:4, :4] = np.eye(4) * ANGLE_STD_MAX_RAD**2
        weight_n = self._settings.payload_mass_kg * GRAVITY_MPS2
        self._estimate = SwingEstimate(np.zeros(7), np.zeros(4), P, NIS_UNKNOWN, weight_n)

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
        if self._running and self._t_s - self._filter.t_s > GAP_MAX_S:
            self.reset(ResetReason.GAP)
        if not self._running:
            self._begin()
            return Status.OK
        failure, self._failure = self._failure, None
        status = self._filter.step(self._force_ned, self._t_s)
        if status is Status.OK:
            self._look(force_n, acc_mps2, dt_s)
        return status if failure is None else failure

    def coast(self, force_n: FloatArray, dt_s: float) -> None:
        """Do nothing: the next step covers the time since the last, whatever is missing in it."""

    def correct(self, measurement: LoadMeasurement) -> Status:
        """Take a measurement of the hook or the load, see `GpEkf.correct`; before the start it is only remembered."""
        source = measurement.source
        self._newest[source] = measurement
        if not self._running:
            return Status.OK
        status = self._filter.correct(measurement)
        if status in (Status.OK, Status.GATED):
            last = self._heard.get(source)
            since_s = self._t_s - last.came_s if last is not None else 0.0
            lasts_s = min(since_s, NIS_HELD_MAX_S)
            self._heard[source] = _Heard(self._t_s, lasts_s, self._filter.nis(source))
        elif status not in (Status.TOO_LATE, Status.INPUT_INVALID):
            # The filter has begun anew; whoever steps it is to know.
            self._failure = status
        return status

    def turn(self, yaw_jump_rad: float) -> None:
        """The autopilot's yaw was reset."""
        if self._running and yaw_jump_rad != 0.0:
            self._filter.turn(yaw_jump_rad)

    def estimate(self) -> SwingEstimate:
        """Return the state after the last step; before the start nothing is known, and its covariance says so."""
        return self._estimate

    def reset(self, reason: ResetReason, force_n: Vec3 | None = None) -> None:
        """Begin anew with the next step; there is no state for a disturbance measured before."""
        self.resets[reason] += 1
        if reason is ResetReason.CLOCK:
            self._newest.clear()
        self._forget()

    def _begin(self) -> None:
        known = [self._newest[source] for source in _OF_VEHICLE if source in self._newest]
        if len(known) == len(_OF_VEHICLE) and all(abs(self._t_s - m.t_s) < SOURCE_LATE_S for m in known):
            self._filter.begin(self._t_s, known[0].value, known[1].value)
            self._running = True

    def _look(self, force_n: FloatArray, acc_mps2: FloatArray, dt_s: float) -> None:
        """Tell the filter's state as swing, and how well it agrees with what was measured and with what is felt."""
        load, s = self._filter.estimate(), self._settings
        acc = np.zeros(6)
        slts.acceleration(acc, load.x, self._force_ned, np.zeros(3), s.mass_kg, s.payload_mass_kg, s.cable_length_m)
        x, x_rate, P, angles, cov = np.zeros(7), np.zeros(4), np.zeros((7, 7)), np.empty(4), np.empty((4, 4))
        relative = np.concatenate([load.x[_RELATIVE], acc[3:5]])
        swing(
            angles, x_rate, cov, relative, load.P[np.ix_(_RELATIVE, _RELATIVE)], s.cable_length_m, -self._to_ned_rad
        )  # fmt: skip
        x[:4], P[:4, :4] = angles, cov
        tension_n = float(acc[5])
        direction = np.array([math.sin(angles[1]), -math.sin(angles[0]) * math.cos(angles[1])])
        felt = s.mass_kg * acc_mps2[:2] - force_n[:2] - tension_n * direction
        self._felt_fast += dt_s / (dt_s + FELT_FAST_S) * (felt - self._felt_fast)
        self._felt_slow += dt_s / (dt_s + FELT_SLOW_S) * (felt - self._felt_slow)
        felt_nis = FELT_NIS * float(np.sum((self._felt_fast - self._felt_slow) ** 2)) / self._allowed_n**2
        camera = self._heard.get(Source.REL_POS)
        if camera is not None and self._t_s - camera.came_s < CAMERA_TRUSTED_S and camera.nis <= s.nis_gate:
            felt_nis = 0.0
        heard = [one.nis for one in self._heard.values() if self._t_s - one.came_s <= one.lasts_s]
        position = self._heard.get(Source.VEHICLE_POS)
        if position is None or self._t_s - position.came_s > POSITION_LOST_S:
            P[:4, :4] += np.eye(4) * ANGLE_STD_MAX_RAD**2
        self._estimate = SwingEstimate(x, x_rate, P, max(heard, default=0.0) + felt_nis, tension_n)
