"""Path follower and GP-EKF together, as a daemon will use them; sources come late and drop out."""

import numpy as np
import pytest

from swingd.control.path_following import PathFollower, PathSettings, PathTerm
from swingd.core import slts
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status
from swingd.estimation.gp_ekf import GpEkf, GpEkfSettings, LoadMeasurement, Source

MASS, PAYLOAD, LENGTH = 1.52, 0.5, 1.6
DT_S = 0.01
PATH = ((0.0, 0.0, -10.0), (12.0, 0.0, -10.0), (12.0, 8.0, -11.0))
WIND_ON_LOAD = np.array([0.0, 0.15, 0.0])


@pytest.fixture(scope="module")
def flown():
    rng = np.random.default_rng(1)
    ekf = GpEkf(GpEkfSettings(MASS, PAYLOAD, LENGTH, load_force_noise_n=0.1))
    follower = PathFollower(PathSettings(MASS, PAYLOAD, LENGTH), PATH)
    x, acc = np.zeros(10), np.empty(6)
    x[2] = -10.0
    force = np.array([0.0, 0.0, -(MASS + PAYLOAD) * GRAVITY_MPS2])
    ell, B = np.empty(3), np.empty((3, 2))
    waiting, rows = [], []
    for step in range(2200):
        t_s = step * DT_S
        slts.cable(ell, B, x[3:5].copy(), LENGTH)
        taken = []
        if step % 4 == 0:
            taken.append((Source.VEHICLE_POS, x[:3] + ell, 0.05, 0.03))
            taken.append((Source.VEHICLE_VEL, x[5:8] + B @ x[8:], 0.05, 0.03))
        if step % 7 == 0 and not 4.0 < t_s < 4.8:
            taken.append((Source.REL_POS, ell, 0.06, 0.08))
        for source, value, std, late_s in taken:
            noisy = tuple(value + std * rng.standard_normal(3))
            waiting.append((t_s + late_s, LoadMeasurement(source, noisy, (std,) * 3, t_s)))
        if step and ekf.started:
            assert ekf.step(force, t_s) is Status.OK
        for arrived, measurement in [one for one in waiting if one[0] <= t_s + 1e-9]:
            waiting.remove((arrived, measurement))
            status = ekf.correct(measurement)
            assert status is Status.OK or not ekf.started
            if ekf.started and not rows and status is Status.OK and measurement.source is Source.VEHICLE_POS:
                assert follower.begin(ekf.estimate().x) is Status.OK
        if ekf.started:
            specific_force = (force - acc[5] * ell / LENGTH) / MASS
            assert follower.update(ekf.estimate().x, force, specific_force, DT_S if rows else 0.0) is Status.OK
            force = follower.thrust_ned_n
            estimate = ekf.estimate()
            found = follower.term(PathTerm.D_T) + follower.term(PathTerm.D_PERP)
            rows.append([t_s, *x, *estimate.x, *np.diag(estimate.P), *found, follower.leg, follower.remaining_m])
        assert slts.acceleration(acc, x, force, WIND_ON_LOAD, MASS, PAYLOAD, LENGTH) == Status.OK
        middle = x + 0.5 * DT_S * np.concatenate([x[5:], acc[:5]])
        assert slts.acceleration(acc, middle, force, WIND_ON_LOAD, MASS, PAYLOAD, LENGTH) == Status.OK
        x = x + DT_S * np.concatenate([middle[5:], acc[:5]])
    return np.array(rows), ekf, follower


def test_the_load_reaches_the_end_of_its_path_and_stays(flown):
    rows, ekf, follower = flown
    assert follower.holding
    assert np.linalg.norm(rows[-200:, 1:4] - PATH[-1], axis=1).max() < 0.25
    assert sum(ekf.resets.values()) == 1  # the start
    # All of the wind is found; how much of it belongs to the load follows the estimate of r, which it pulls along.
    np.testing.assert_allclose(rows[-500:, 31:33].mean(axis=0), WIND_ON_LOAD[:2], atol=0.03)


def test_it_keeps_to_the_first_leg(flown):
    rows, _, _ = flown
    on_leg = rows[(rows[:, -2] == 0) & (rows[:, 0] > 3.0)]
    assert len(on_leg) > 200
    assert np.abs(on_leg[:, 2]).max() < 0.3
    remaining = rows[:, -1]
    assert (np.diff(remaining[(rows[:, -2] < 2) & (rows[:, 0] > 1.0)]) < 0.1).all()


def test_the_estimate_stays_within_its_bounds_with_late_pictures_and_a_dropout(flown):
    rows, _, _ = flown
    settled = rows[rows[:, 0] > 2.0]
    error = settled[:, 14:16] - settled[:, 4:6]
    assert np.mean(np.abs(error) < 3.0 * np.sqrt(settled[:, 24:26])) > 0.98
    assert np.sqrt(np.mean(error**2)) < 0.05
