"""The GP-EKF as an object with state: load and cable from the vehicle's thrust, position and velocity, and a camera."""

import math
from dataclasses import dataclass

import numpy as np

from swingd.core import gp_ekf_history as kernels
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.gp_ekf import NUM_STATES, GpEkfParam, Source
from swingd.core.gp_ekf_history import Node, Ring
from swingd.core.slts import SltsState
from swingd.core.status import Status
from swingd.estimation.acceleration_model import NOTHING_LEARNED, Prepared
from swingd.estimation.base import GATED_MAX_S, INPUT_MAX, LoadMeasurement
from swingd.model.estimate import FloatArray, ResetReason
from swingd.model.events import Vec3

__all__ = ["GpEkf", "GpEkfSettings", "LoadEstimate", "LoadMeasurement", "Source"]

GAP_MAX_S = 0.5
"""Without a step for longer the thrust of the time between is not known."""
CLOCK_JUMP_S = 1.0
"""A step that is older than the last by more than this has another clock."""
REL_POS_STD_MAX = 0.6
"""Deviation of r over the cable's length beyond which the estimate says nothing."""


@dataclass(frozen=True, slots=True)
class GpEkfSettings:
    """Model, noise and memory; densities are the roots of two-sided spectral densities of variance."""

    mass_kg: float
    payload_mass_kg: float
    cable_length_m: float
    """From the vehicle's centre of mass to the load's."""
    force_noise_n: Vec3 = (0.25, 0.25, 1.5)
    """Of the thrust, ned [N/sqrt(Hz)]; its size is less certain than its direction."""
    load_force_noise_n: float = 0.05
    """Of what blows at the load, every axis [N/sqrt(Hz)]."""
    model_memory_s: float = 0.3
    """For how long an error that the Gaussian process allows for keeps its sign."""
    nis_gate: float = 30.0
    """Of every source, 3 degrees of freedom."""
    initial_std: tuple[float, ...] = (0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.5, 0.5)
    """Of x_p [m], r [m], v_p [m/s], v [m/s]."""
    memory: int = 128
    """Steps and measurements that a late one may be older than."""

    def packed(self, load_share: float) -> FloatArray:
        """Return model and noise as (GpEkfParam.SIZE,), with the Gaussian process's share of the load."""
        packed = np.array(
            [
                self.mass_kg, self.payload_mass_kg, self.cable_length_m, *np.square(self.force_noise_n),
                self.load_force_noise_n**2, self.model_memory_s, self.nis_gate, load_share,
            ]
        )  # fmt: skip
        assert packed.size == GpEkfParam.SIZE
        return packed


@dataclass(frozen=True, slots=True)
class LoadEstimate:
    """State after the newest step or measurement."""

    t_s: float
    x: FloatArray
    """(10,) see `swingd.core.slts.SltsState`: x_p, r, v_p, v."""
    P: FloatArray
    """(10, 10) covariance of ``x``."""
    nis: dict[Source, float]
    """Normalised innovation squared of each source's last measurement, 3 degrees of freedom; 0 before the first."""


class GpEkf:
    """Ten states of the load and the cable, (19)-(27), corrected by sources that come when they come.

    Nothing is estimated until the first position of the vehicle, below which the load is taken to hang at rest.
    Measurements enter where their stamps place them, and what was done since is repeated with them; the result is that
    of a filter which had them in time.

    Parameters
    ----------
    settings : GpEkfSettings
    model : Prepared
        Gaussian process by `swingd.estimation.acceleration_model.AccelerationModel.prepare`; none: a plain EKF.
    """

    def __init__(self, settings: GpEkfSettings, model: Prepared = NOTHING_LEARNED) -> None:
        self._settings = settings
        self._model = model
        self._p = settings.packed(model.load_share)
        self._nodes = np.zeros((settings.memory, Node.SIZE))
        self._covariances = np.zeros((NUM_STATES * settings.memory, NUM_STATES))
        self._ring = np.zeros(Ring.SIZE)
        self._hover = np.array([0.0, 0.0, -(settings.mass_kg + settings.payload_mass_kg) * GRAVITY_MPS2])
        self._P_init = np.diag(np.square(settings.initial_std))
        self._x, self._P = np.zeros(NUM_STATES), self._P_init.copy()
        self._nis = np.zeros(1)
        self._last_nis = dict.fromkeys(Source, 0.0)
        self._gated_since_s: dict[Source, float | None] = dict.fromkeys(Source)
        self._seen: dict[Source, Vec3] = {}
        self.started = False
        """Whether a position of the vehicle has been seen since the start."""
        self.resets = dict.fromkeys(ResetReason, 0)
        """How often it began anew, by reason."""

    @property
    def t_s(self) -> float:
        """Time of the newest step; 0 before the start."""
        return float(self._ring[Ring.STEP_T])

    def step(self, force_ned_n: FloatArray, t_s: float) -> Status:
        """Advance to a time.

        Parameters
        ----------
        force_ned_n : (3,)
            f_L = -T R_ned_from_frd e_z, mean since the last step, ned [N].
        t_s : float
            Later than the last step.

        Returns
        -------
        Status
            ``OK`` where the estimate was advanced; ``INPUT_INVALID`` where an input is not finite, time does not
            advance or nothing has started yet, and nothing was done; anything else where the estimate began anew
            instead.
        """
        if not ((abs(force_ned_n) < INPUT_MAX).all() and abs(t_s) < INPUT_MAX and self.started):
            return Status.INPUT_INVALID
        since_s = t_s - self.t_s
        if since_s < -CLOCK_JUMP_S or since_s > GAP_MAX_S:
            self._begin_anew(t_s, ResetReason.GAP if since_s > 0.0 else ResetReason.CLOCK)
            return Status.NOT_CONVERGED
        force = np.ascontiguousarray(force_ned_n, dtype=float)
        m = self._model
        status = Status(
            kernels.step(
                self._nodes, self._covariances, self._ring, t_s, force, self._p,
                m.Z, m.weights, m.K_inv, m.inv_sq_scales, m.signal_var,
            )
        )  # fmt: skip
        return status if status is Status.INPUT_INVALID else self._judged(status)

    def correct(self, measurement: LoadMeasurement) -> Status:
        """Take a measurement at the time of its stamp.

        Returns
        -------
        Status
            ``OK`` or ``GATED``; ``TOO_LATE`` where it is older than the memory; ``INPUT_INVALID`` where it is not
            finite, its deviation not positive, its stamp in the future, or where nothing has started and it is no
            position; anything else where the estimate began anew instead.
        """
        value, std = np.array(measurement.value, dtype=float), np.array(measurement.std, dtype=float)
        valid = (abs(value) < INPUT_MAX).all() and (std > 0.0).all() and (std < INPUT_MAX).all()
        if not (valid and abs(measurement.t_s) < INPUT_MAX):
            return Status.INPUT_INVALID
        source = measurement.source
        if not self.started:
            if source is not Source.VEHICLE_POS:
                return Status.INPUT_INVALID
            self._seen[source] = measurement.value
            self._begin_anew(measurement.t_s, ResetReason.START)
            return Status.OK
        m = self._model
        status = Status(
            kernels.measure(
                self._nodes, self._covariances, self._ring, self._nis, measurement.t_s, source, value, std**2, self._p,
                m.Z, m.weights, m.K_inv, m.inv_sq_scales, m.signal_var,
            )
        )  # fmt: skip
        if status in (Status.INPUT_INVALID, Status.TOO_LATE):
            return status
        self._seen[source] = measurement.value
        self._last_nis[source] = float(self._nis[0])
        judged = self._judged(status)
        if judged is status:
            since_s = self._gated_since_s[source]
            if status is not Status.GATED:
                self._gated_since_s[source] = None
            elif since_s is None:
                self._gated_since_s[source] = measurement.t_s
            elif measurement.t_s - since_s > GATED_MAX_S and source is not Source.REL_POS:
                # A camera may mistake something else for the load, and for long: no reason to forget what is known.
                self.reset(ResetReason.INNOVATION)
                return Status.NOT_CONVERGED
        return judged

    def nis(self, source: Source) -> float:
        """Return the normalised innovation squared of a source's last measurement; 0 before the first."""
        return self._last_nis[source]

    def estimate(self) -> LoadEstimate:
        """Return the state after the newest step or measurement."""
        return LoadEstimate(self.t_s, self._x.copy(), self._P.copy(), dict(self._last_nis))

    def reset(self, reason: ResetReason) -> None:
        """Begin anew at the last step: the load at rest below where the vehicle was seen last."""
        self._begin_anew(self.t_s, reason)

    def begin(self, t_s: float, pos_ned_m: Vec3, vel_ned_mps: Vec3) -> None:
        """Begin at a time: the load at rest below a vehicle of this position and velocity."""
        self._seen = {Source.VEHICLE_POS: pos_ned_m, Source.VEHICLE_VEL: vel_ned_mps}
        self._begin(t_s)

    def turn(self, yaw_jump_rad: float) -> None:
        """Turn cable and swing about the vehicle: the autopilot has reset the yaw by which thrust was turned to ned.

        What was measured before is forgotten: it belongs to the old yaw.
        """
        if not self.started:
            return
        c, s = math.cos(yaw_jump_rad), math.sin(yaw_jump_rad)
        R = np.array([[c, -s], [s, c]])
        T = np.eye(NUM_STATES)
        for pos, rel in ((SltsState.LOAD_POS, SltsState.REL_POS), (SltsState.LOAD_VEL, SltsState.REL_VEL)):
            # The vehicle stays where it is, and the load goes about it.
            T[pos : pos + 2, rel : rel + 2] = np.eye(2) - R
            T[rel : rel + 2, rel : rel + 2] = R
        self._x[:] = T @ self._x
        self._P[:] = T @ self._P @ T.T
        kernels.begin(self._nodes, self._covariances, self._ring, self.t_s, self._x, self._P, self._hover)

    def _judged(self, status: Status) -> Status:
        """Take over what the kernels left, or begin anew where it cannot be used."""
        if status not in (Status.OK, Status.GATED):
            self.reset(ResetReason.ANGLE if status is Status.NOT_CONVERGED else ResetReason.NUMERICS)
            return status
        kernels.newest(self._x, self._P, self._nodes, self._covariances, self._ring)
        r = SltsState.REL_POS
        std_max_m = REL_POS_STD_MAX * self._settings.cable_length_m
        if max(self._P[r, r], self._P[r + 1, r + 1]) > std_max_m**2:
            self.reset(ResetReason.COVARIANCE)
            return Status.NOT_CONVERGED
        return status

    def _begin_anew(self, t_s: float, reason: ResetReason) -> None:
        self.resets[reason] += 1
        if Source.VEHICLE_POS in self._seen:
            self._begin(t_s)

    def _begin(self, t_s: float) -> None:
        self._gated_since_s = dict.fromkeys(Source)
        self._last_nis = dict.fromkeys(Source, 0.0)
        s = self._settings
        self._x[:] = 0.0
        self._x[SltsState.LOAD_POS : SltsState.LOAD_POS + 3] = self._seen[Source.VEHICLE_POS]
        self._x[SltsState.LOAD_POS + 2] += s.cable_length_m
        self._x[SltsState.LOAD_VEL : SltsState.LOAD_VEL + 3] = self._seen.get(Source.VEHICLE_VEL, (0.0, 0.0, 0.0))
        self._P[:] = self._P_init
        kernels.begin(self._nodes, self._covariances, self._ring, t_s, self._x, self._P, self._hover)
        self.started = True
