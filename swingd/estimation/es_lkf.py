"""The extended-state linear Kalman filter of Escareno et al., ICINCO 2016, as an object with state."""

from math import inf

import numpy as np

from swingd.core import es_lkf as kernels
from swingd.core.es_lkf import State
from swingd.core.status import Status
from swingd.estimation.base import INPUT_MAX, INTERVAL_MAX_S
from swingd.model.estimate import FloatArray


class EsLkf:
    """Position, velocity and generalised disturbance of one axis, (28)-(50).

    The axis obeys chi'' = (U + rho) / a - G: a known force U, an unknown one rho, and an acceleration -G. Of a load or
    of wind nothing is known; rho is whatever acts beside U. Units are N and m, or N m and rad for a rotation.

    Parameters
    ----------
    inertia : float
        a, mass [kg] or moment of inertia [kg m^2], > 0.
    process_density : float
        Density of rho's random walk [N^2/s], >= 0; the paper's Q_33. The larger, the sooner a change of rho is
        followed, and the more noise is in it.
    pos_var, vel_var : float
        Variances of a measured position [m^2] and velocity [(m/s)^2], > 0.
    initial_var : three floats
        Variances of position [m^2], velocity [(m/s)^2] and rho [N^2] at the start and after `reset`, > 0.
    nis_gate : float
        A measurement whose normalised innovation squared is above it is left out; infinite: none is.
    steady_state : bool
        Use the gain on which the filter settles, from the first measurement on and without a covariance that is
        propagated; it is solved again when the interval between two predictions changes. Needs a positive
        ``process_density`` and both measured in every correction.

    Raises
    ------
    ValueError
        If a parameter is out of its range.
    """

    def __init__(
        self,
        inertia: float,
        process_density: float,
        *,
        pos_var: float,
        vel_var: float,
        initial_var: tuple[float, float, float] = (1.0, 1.0, 1.0),
        nis_gate: float = inf,
        steady_state: bool = False,
    ) -> None:
        for name, value in (
            ("inertia", inertia),
            ("pos_var", pos_var),
            ("vel_var", vel_var),
            *((f"initial_var[{i}]", initial_var[i]) for i in range(3)),
        ):
            if not 0.0 < value < inf:
                raise ValueError(f"{name}: {value!r} given; expected a positive number")
        if not (0.0 < process_density < inf or (process_density == 0.0 and not steady_state)):
            raise ValueError(f"process_density: {process_density!r} given; expected a positive number")
        if not nis_gate > 0.0:
            raise ValueError(f"nis_gate: {nis_gate!r} given; expected a positive number or infinity")
        self._inertia = inertia
        self._process_density = process_density
        self._var = np.array([pos_var, vel_var])
        self._initial_var = initial_var
        self._nis_gate = nis_gate
        self._steady_state = steady_state
        self._dt_s = 0.0
        self._A, self._B, self._Q = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
        self._P_prior, self._P_post, self._K = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2))
        self._x, self._P = np.zeros(3), np.diag(initial_var)
        self._z, self._used_var, self._nis = np.zeros(2), np.empty(2), np.zeros(1)

    @property
    def state(self) -> FloatArray:
        """Position, velocity, rho, (3,); a copy."""
        return self._x.copy()

    @property
    def covariance(self) -> FloatArray:
        """Of `state`, (3, 3); a copy."""
        return self._P.copy()

    @property
    def disturbance(self) -> float:
        """rho, what acts beside the known force [N] or [N m]; positive along the axis."""
        return float(self._x[State.DISTURBANCE])

    @property
    def disturbance_std(self) -> float:
        """Standard deviation of `disturbance` [N] or [N m]."""
        return float(np.sqrt(self._P[State.DISTURBANCE, State.DISTURBANCE]))

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last measurement; as many degrees of freedom as were measured."""
        return float(self._nis[0])

    def reset(self, pos: float = 0.0, vel: float = 0.0, disturbance: float = 0.0) -> None:
        """Begin anew at a state [m, m/s, N], with the initial variances."""
        self._x[:] = pos, vel, disturbance
        self._P[:] = np.diag(self._initial_var)
        self._nis[0] = 0.0

    def set_state(self, pos: float, vel: float, disturbance: float) -> None:
        """Replace the state [m, m/s, N] where the axis itself was turned or moved; what is known of it stays."""
        self._x[:] = pos, vel, disturbance

    def predict(self, force: float, offset: float, dt_s: float) -> Status:
        """Advance over an interval.

        Parameters
        ----------
        force : float
            U, held over the interval [N] or [N m].
        offset : float
            G, subtracted from the acceleration [m/s^2]: 9.81 on an axis that points up, 0 on a level one.
        dt_s : float
            Interval [s], 0 < dt_s <= `swingd.estimation.base.INTERVAL_MAX_S`.

        Returns
        -------
        Status
            ``OK``; ``INPUT_INVALID`` or ``NOT_FINITE`` where nothing was done.
        """
        if not (0.0 < dt_s <= INTERVAL_MAX_S and abs(force) < INPUT_MAX and abs(offset) < INPUT_MAX):
            return Status.INPUT_INVALID
        if dt_s != self._dt_s:
            status = self._discretise(dt_s)
            if status is not Status.OK:
                return status
        net = force - self._inertia * offset
        if not self._steady_state:
            return Status(kernels.predict(self._x, self._P, net, self._A, self._B, self._Q))
        status = Status(kernels.predict_mean(self._x, net, self._A, self._B))
        if status is Status.OK:
            self._P[:] = self._P_prior
        return status

    def correct(self, pos: float | None, vel: float | None) -> Status:
        """Take in what is measured at the end of the last interval.

        Parameters
        ----------
        pos, vel : float or None
            Position [m] or [rad], velocity [m/s] or [rad/s]; None: not measured.

        Returns
        -------
        Status
            ``OK``; ``GATED`` where the prediction stands; ``INPUT_INVALID`` where nothing is measured, not a number or
            out of range, or, with ``steady_state``, not both or before the first prediction; else a fault of the
            covariance. Nothing is done then.
        """
        measured = False
        for i, value in enumerate((pos, vel)):
            if value is None:
                self._z[i], self._used_var[i] = 0.0, inf
                continue
            if not abs(value) < INPUT_MAX:
                return Status.INPUT_INVALID
            self._z[i], self._used_var[i] = value, self._var[i]
            measured = True
        if not measured:
            return Status.INPUT_INVALID
        if not self._steady_state:
            return Status(kernels.correct(self._x, self._P, self._nis, self._z, self._used_var, self._nis_gate))
        if pos is None or vel is None or self._dt_s == 0.0:
            return Status.INPUT_INVALID
        status = Status(
            kernels.correct_by_gain(self._x, self._P_prior, self._nis, self._z, self._var, self._nis_gate, self._K)
        )
        if status is Status.OK:
            self._P[:] = self._P_post
        return status

    def _discretise(self, dt_s: float) -> Status:
        """Prepare for intervals of another length."""
        kernels.discretise(self._A, self._B, self._Q, self._inertia, self._process_density, dt_s)
        self._dt_s = 0.0
        if self._steady_state:
            status = Status(kernels.steady_state(self._P_prior, self._P_post, self._K, self._A, self._Q, self._var))
            if status is not Status.OK:
                return status
        self._dt_s = dt_s
        return Status.OK
