"""The force on the vehicle besides thrust and weight, estimated without knowing what causes it."""

import math

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status
from swingd.estimation.es_lkf import EsLkf
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.events import LocalPosition, Vec3
from swingd.model.parameters import Parameters
from swingd.pipeline.correction import turn

POSITION_LATE_S = 0.3
SETTLE_S = 2.0
"""Since it began; the initial force is then forgotten."""
NIS_MAX = 40.0
"""Mean normalised innovation squared of the three axes together, 6 degrees of freedom."""
NIS_TIME_CONSTANT_S = 0.5
NIS_GATE = 200.0
"""Of one axis: beyond it the autopilot has moved its own position or velocity, which is no force."""
FORCE_STD_INIT_PER_KG = 5.0
"""Of the force at the beginning [N per kg of vehicle]."""
OFFSETS_MPS2 = (0.0, 0.0, -GRAVITY_MPS2)
"""G of (28) along north, east and down: what is subtracted from the acceleration."""


class DisturbanceObserver:
    """Three extended-state filters, one along each of north, east and down, on the vehicle's own mass.

    What pulls the vehicle besides its thrust and weight is one force: cable, load, wind, drag, and what the thrust
    curve gets wrong. Neither the load's mass nor the cable is needed. Mathematics: (28)-(49) of ICINCO 2016.

    Parameters
    ----------
    parameters : Parameters
        Vehicle and disturbance.
    """

    def __init__(self, parameters: Parameters) -> None:
        disturbance, mass_kg = parameters.disturbance, parameters.vehicle.mass_kg
        self.active = disturbance.source == "es_lkf"
        """Whether it is wanted."""
        initial_var = (
            disturbance.pos_noise_m**2,
            disturbance.vel_noise_mps**2,
            (FORCE_STD_INIT_PER_KG * mass_kg) ** 2,
        )
        self._axes = [
            EsLkf(
                mass_kg,
                (disturbance.force_noise * mass_kg) ** 2,
                pos_var=disturbance.pos_noise_m**2,
                vel_var=disturbance.vel_noise_mps**2,
                initial_var=initial_var,
                nis_gate=NIS_GATE,
            )
            for _ in range(3)
        ]
        self._mass_kg = mass_kg
        self.reset()

    def reset(self) -> None:
        """Begin anew with the next position."""
        for axis in self._axes:
            axis.reset()
        self._position: LocalPosition | None = None
        self._taken_s = -math.inf
        self._settled_s = 0.0
        self._nis = 0.0
        self._thrust_known = True
        self._t_boot_s = -math.inf
        self._began = False

    def add_position(self, position: LocalPosition) -> None:
        """Take a position and velocity of the autopilot; they are used by the next step."""
        self._position = position

    def turn(self, yaw_jump_rad: float) -> None:
        """The autopilot's north was turned: what is known of horizontal motion and force turns with it."""
        if yaw_jump_rad == 0.0 or not self._began:
            return
        (pos_n, *north), (pos_e, *east) = (axis.state.tolist() for axis in self._axes[:2])
        (vel_n, vel_e), (force_n, force_e) = (turn(pair, yaw_jump_rad) for pair in zip(north, east, strict=True))
        self._axes[0].set_state(pos_n, vel_n, force_n)
        self._axes[1].set_state(pos_e, vel_e, force_e)

    def step(self, t_boot_s: float, dt_s: float, thrust_ned_n: Vec3, *, thrust_known: bool) -> None:
        """Advance over one interval.

        Parameters
        ----------
        t_boot_s, dt_s : float
            Its end on the autopilot's clock, and its length, > 0 [s].
        thrust_ned_n : (3,)
            Mean thrust over it, along north, east and down [N].
        thrust_known : bool
            False where the thrust was inferred from a model of the load: then it tells nothing of the force.
        """
        self._t_boot_s = t_boot_s
        self._thrust_known = thrust_known
        position = self._position
        fresh = position is not None and position.t_boot_s > self._taken_s
        if not self._began:
            if position is not None and fresh:
                self._begin(position)
            return
        for axis, force_n, offset_mps2 in zip(self._axes, thrust_ned_n, OFFSETS_MPS2, strict=True):
            if axis.predict(force_n, offset_mps2, dt_s) is not Status.OK:
                self.reset()
                return
        if position is not None and fresh:
            self._correct(position, thrust_ned_n)
        consistent = self._nis <= NIS_MAX and t_boot_s - self._taken_s <= POSITION_LATE_S and thrust_known
        self._settled_s = min(self._settled_s + dt_s, SETTLE_S) if consistent else 0.0

    def _begin(self, position: LocalPosition) -> None:
        self._began = True
        self._taken_s = position.t_boot_s
        for axis, pos_m, vel_mps in zip(self._axes, position.pos_ned_m, position.vel_ned_mps, strict=True):
            axis.reset(pos_m, vel_mps)

    def _correct(self, position: LocalPosition, thrust_ned_n: Vec3) -> None:
        """Compare with a position, carried from its stamp to the end of the interval."""
        age_s = min(max(self._t_boot_s - position.t_boot_s, 0.0), POSITION_LATE_S)
        dt_s = position.t_boot_s - self._taken_s
        self._taken_s = position.t_boot_s
        nis = 0.0
        for i, axis in enumerate(self._axes):
            acc_mps2 = (thrust_ned_n[i] + axis.disturbance) / self._mass_kg - OFFSETS_MPS2[i]
            vel_mps = position.vel_ned_mps[i] + age_s * acc_mps2
            pos_m = position.pos_ned_m[i] + age_s * (position.vel_ned_mps[i] + 0.5 * age_s * acc_mps2)
            status = axis.correct(pos_m, vel_mps)
            if status is Status.GATED:
                axis.set_state(pos_m, vel_mps, axis.disturbance)
                self._settled_s = 0.0
            elif status is not Status.OK:
                self.reset()
                return
            nis += axis.nis
        self._nis += dt_s / (dt_s + NIS_TIME_CONSTANT_S) * (min(nis, 2.0 * NIS_MAX) - self._nis)

    def estimate(self) -> DisturbanceEstimate | None:
        """Return the estimate after the last step; None where none is wanted."""
        if not self.active:
            return None
        north, east, down = self._axes
        return DisturbanceEstimate(
            (north.disturbance, east.disturbance, down.disturbance),
            (north.disturbance_std, east.disturbance_std, down.disturbance_std),
            self._doubt(),
        )

    def _doubt(self) -> str:
        if not self._thrust_known:
            return "thrust unknown"
        if self._began and self._t_boot_s - self._taken_s > POSITION_LATE_S:
            return "position and velocity late"
        if self._nis > NIS_MAX:
            return "disturbance: measurements and model disagree"
        return "" if self._settled_s >= SETTLE_S else "disturbance settling"
