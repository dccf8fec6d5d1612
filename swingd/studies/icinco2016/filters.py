"""How well the disturbances can be known: other process densities, other sensors, on one and the same flight."""

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.planar_flight import PlanarFlightLog
from swingd.core.planar_rotorcraft import PlanarState
from swingd.core.status import Status
from swingd.estimation.es_lkf import EsLkf
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.studies.icinco2016 import paper
from swingd.studies.icinco2016.flight import Flight
from swingd.studies.icinco2016.indicators import AXES, ESTIMATED_FROM_S, rms
from swingd.studies.seeds import Figures

DENSITIES = (0.01, 0.1, 1.0, 10.0)
SENSOR_VARS = (1e-3, 1e-5, 1e-7)
GROUP = "filters/"


def compare(flight: Flight, seed: int) -> Figures:
    """Estimate the disturbances of a flight anew with every density and every noise, by constant gains.

    Parameters
    ----------
    flight : Flight
    seed : int
        Of the sensors' noise.

    Returns
    -------
    dict
        Keys ``filters/R 0.001/Q 1`` and so on; by axis the RMSE over the RMS [%].
    """
    figures: Figures = {}
    judged = flight.t_s >= ESTIMATED_FROM_S
    state = flight.column(PlanarFlightLog.STATE, PlanarState.SIZE)
    true = flight.column(PlanarFlightLog.RHO, 3)[judged]
    noise = np.random.default_rng(seed).standard_normal((flight.t_s.size, 2, 3))
    forces = _forces(flight)
    for var in SENSOR_VARS:
        measured = np.stack([state[:, :3], state[:, PlanarState.RATES :][:, :3]], axis=1) + np.sqrt(var) * noise
        for density in DENSITIES:
            figures[f"{GROUP}R {var:g}/Q {density:g}"] = {
                name: 100.0
                * rms(estimated(measured[:, :, axis], forces[:, axis], axis, density, var)[judged] - true[:, axis])
                / rms(true[:, axis])
                for axis, name in enumerate(AXES)
            }
    return figures


def estimated(measured: FloatArray, force: FloatArray, axis: int, density: float, var: float) -> FloatArray:
    """Run one axis' filter with its constant gain.

    Parameters
    ----------
    measured : (n, 2)
        Position and velocity.
    force : (n,)
        Held from each sample to the next.
    axis : int
        0, 1, 2: x, z, theta.
    density, var : float
        Process density and variance of a measurement.

    Returns
    -------
    (n,)
        rho_hat at each sample.
    """
    one = EsLkf(
        paper.INERTIA_KG_M2 if axis == 2 else paper.MASS_KG, density, pos_var=var, vel_var=var, steady_state=True
    )
    offset = GRAVITY_MPS2 if axis == 1 else 0.0
    rho = np.zeros(force.size)
    # The first measurement is where the filter begins.
    one.reset(*measured[0].tolist())
    pairs, held = measured.tolist(), force.tolist()
    for k in range(1, len(held)):
        done = one.predict(held[k - 1], offset, paper.DT_S), one.correct(*pairs[k])
        if done != (Status.OK, Status.OK):
            raise StudyError(f"filter of {AXES[axis]}: {done[0].name}, {done[1].name} at sample {k}; expected OK")
        rho[k] = one.disturbance
    return rho


def _forces(flight: Flight) -> FloatArray:
    """Give the mean thrust along x and z and the torque of each interval, the thrust as it turned, (n, 3)."""
    pitch, thrust = flight.column(PlanarFlightLog.STATE + PlanarState.PITCH), flight.column(PlanarFlightLog.THRUST)
    ahead = pitch.copy()
    ahead[:-1] = 0.5 * (pitch[:-1] + pitch[1:])
    return np.stack([thrust * np.sin(ahead), thrust * np.cos(ahead), flight.column(PlanarFlightLog.TORQUE)], axis=1)
