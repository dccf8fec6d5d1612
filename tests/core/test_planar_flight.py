"""The compiled flight against the same loop written down once more around the estimator's class."""

import math

import numpy as np
import pytest

from swingd.core import planar_rotorcraft as plant
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.planar_flight import (
    NOISE_PER_SAMPLE,
    PlanarFlightLog,
    PlanarFlightParam,
    Reference,
    fly,
)
from swingd.core.planar_rotorcraft import PlanarInput, PlanarParam, PlanarState
from swingd.core.status import Status
from swingd.estimation.es_lkf import EsLkf

DT_S, SAMPLES = 0.01, 300
VEHICLE = np.array([0.5, 0.177, 0.125, 0.35, 0.03, -0.1, 0.05, 0.02])
GAINS = np.array([[1.0, 2.0], [1.2, 1.9], [25.0, 10.0]])
DENSITY, VAR, INITIAL_VAR = (1.0, 1.5, 0.7), (1e-3, 2e-3, 5e-4), (1e-3, 1e-3, 1.0)
TILT_MAX_RAD, UP_MIN_N = math.radians(60.0), 1.0


def description(translation=1.0, rotation=1.0, told_wanted=0.0):
    f = np.empty(PlanarFlightParam.SIZE)
    f[:] = [
        DT_S,
        2,
        *GAINS.ravel(),
        translation,
        rotation,
        TILT_MAX_RAD,
        UP_MIN_N,
        *DENSITY,
        *INITIAL_VAR,
        *VAR,
        *VAR,
        told_wanted,
    ]
    return f


def inputs(seed=0):
    rng = np.random.default_rng(seed)
    reference = np.zeros((SAMPLES, Reference.SIZE))
    reference[:, Reference.X], reference[:, Reference.X + 1] = 1.0, 0.3
    reference[:, Reference.Z], reference[:, Reference.Z + 2] = 2.0, -0.2
    reference[:, Reference.PITCH_RATE], reference[:, Reference.PITCH_RATE + 1] = 0.05, 0.02
    outside = np.zeros((SAMPLES, PlanarInput.SIZE))
    outside[100:200, PlanarInput.ROD_TORQUE] = -0.2
    outside[50:, PlanarInput.WIND] = -3.0
    outside[150:, PlanarInput.AIRFRAME_TORQUE] = 0.05
    return reference, outside, rng.standard_normal((SAMPLES, NOISE_PER_SAMPLE))


def flown(**changes):
    reference, outside, noise = inputs()
    x, log = np.zeros(PlanarState.SIZE), np.full((SAMPLES, PlanarFlightLog.SIZE), np.nan)
    assert fly(log, x, VEHICLE, description(**changes), reference, outside, noise) == SAMPLES
    assert np.isfinite(log).all()
    return log, x


def again(compensate, told_wanted=False):
    """Fly in Python: estimates, disturbances, inputs and true states, row by row."""
    reference, outside, noise = inputs()
    inertia = (VEHICLE[PlanarParam.MASS],) * 2 + (VEHICLE[PlanarParam.INERTIA],)
    filters = [
        EsLkf(a, q, pos_var=v, vel_var=v, initial_var=INITIAL_VAR)
        for a, q, v in zip(inertia, DENSITY, VAR, strict=True)
    ]
    x = np.zeros(PlanarState.SIZE)
    for k in range(SAMPLES):
        for axis, one in enumerate(filters):
            std = math.sqrt(VAR[axis])
            assert one.correct(x[axis] + std * noise[k, axis], x[4 + axis] + std * noise[k, 3 + axis]) is Status.OK
        estimate = np.array([one.state for one in filters])
        nu = [
            reference[k, 3 * i + 2] - GAINS[i] @ (estimate[i, :2] - reference[k, 3 * i : 3 * i + 2]) for i in range(2)
        ]
        force = 0.5 * np.array([nu[0], nu[1] + GRAVITY_MPS2]) - compensate * estimate[:2, 2]
        pitch = math.atan2(*force)
        nu_pitch = reference[k, 7] - GAINS[2] @ (estimate[2, :2] - [pitch, reference[k, 6]])
        torque = inertia[2] * nu_pitch - compensate * estimate[2, 2]
        thrust = np.linalg.norm(force)
        u = outside[k].copy()
        u[:2] = thrust, torque
        rho = np.empty(3)
        plant.disturbances(rho, x, u, VEHICLE)
        yield np.concatenate([x, estimate.T.ravel(), rho, [thrust, torque, pitch]])
        ahead = pitch if told_wanted else estimate[2, 0] + 0.5 * DT_S * estimate[2, 1]
        filters[0].predict(thrust * math.sin(ahead), 0.0, DT_S)
        filters[1].predict(thrust * math.cos(ahead), GRAVITY_MPS2, DT_S)
        filters[2].predict(torque, 0.0, DT_S)
        for _ in range(2):
            plant.step(x, u, VEHICLE, 0.5 * DT_S)


@pytest.mark.parametrize(("compensate", "told_wanted"), [(0.0, False), (1.0, False), (0.0, True)])
def test_the_same_flight_in_python(compensate, told_wanted):
    log, _ = flown(translation=compensate, rotation=compensate, told_wanted=float(told_wanted))
    index = PlanarFlightLog
    columns = [
        *range(index.STATE, index.STATE + 8), *range(index.ESTIMATE, index.ESTIMATE + 6),
        *range(index.RHO_ESTIMATE, index.RHO_ESTIMATE + 3), *range(index.RHO, index.RHO + 3),
        index.THRUST, index.TORQUE, index.POS_SP + 2,
    ]  # fmt: skip
    np.testing.assert_allclose(log[:, columns], np.array(list(again(compensate, told_wanted))), rtol=1e-7, atol=1e-8)
    assert not log[:, index.BOUNDED].any()
    np.testing.assert_allclose(log[:, index.T], DT_S * np.arange(SAMPLES))


def test_filters_without_noise_differ_by_the_noise_alone():
    """Superposition: the noiseless filters' error is lag, and vanishes where nothing changes."""
    reference, outside, _ = inputs()
    log = np.empty((SAMPLES, PlanarFlightLog.SIZE))
    noise = np.zeros((SAMPLES, NOISE_PER_SAMPLE))
    fly(log, np.zeros(PlanarState.SIZE), VEHICLE, description(), reference, outside, noise)
    index = PlanarFlightLog
    np.testing.assert_array_equal(log[:, index.RHO_ESTIMATE :][:, :3], log[:, index.RHO_NOISELESS :][:, :3])
    noisy, _ = flown()
    difference = noisy[100:, index.RHO_ESTIMATE :][:, :3] - noisy[100:, index.RHO_NOISELESS :][:, :3]
    # As much as the filters' variance holds of noise, and no more than all of it.
    assert (difference.std(axis=0) < np.sqrt(noisy[-1, index.RHO_VAR :][:3])).all()
    assert (difference.std(axis=0) > 0.3 * np.sqrt(noisy[-1, index.RHO_VAR :][:3])).all()


def test_a_wanted_force_out_of_reach_is_bounded_and_said():
    reference, outside, noise = inputs()
    reference[:, Reference.X] = 40.0
    log = np.empty((SAMPLES, PlanarFlightLog.SIZE))
    assert fly(log, np.zeros(8), VEHICLE, description(), reference, outside, noise) == SAMPLES
    assert log[0, PlanarFlightLog.BOUNDED] == 1.0
    assert np.abs(log[:, PlanarFlightLog.POS_SP + 2]).max() == pytest.approx(TILT_MAX_RAD)


def test_a_flight_that_diverges_says_so():
    reference, outside, noise = inputs()
    log = np.empty((SAMPLES, PlanarFlightLog.SIZE))
    outside[20, PlanarInput.ROD_TORQUE] = math.nan
    assert fly(log, np.zeros(8), VEHICLE, description(), reference, outside, noise) < 0
    noise[30, 2] = math.inf
    assert fly(log, np.zeros(8), VEHICLE, description(), reference, np.zeros_like(outside), noise) < 0
    weightless = VEHICLE.copy()
    weightless[PlanarParam.ROD_LENGTH] = 0.0
    assert fly(log, np.zeros(8), weightless, description(), reference, np.zeros_like(outside), noise) < 0
