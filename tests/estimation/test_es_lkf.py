"""The extended-state filter as an object: consistency, signs in words, gate, constant gain, bad inputs."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from swingd.core.status import Status
from swingd.estimation.es_lkf import EsLkf

MASS_KG, DENSITY, DT_S, VAR = 0.5, 1.0, 0.01, 1e-3
GRAVITY_MPS2 = 9.81


def filter_of(**changes):
    settings = {"pos_var": VAR, "vel_var": VAR} | changes
    return EsLkf(MASS_KG, DENSITY, **settings)


class Axis:
    """The filter's own model with its own noise: rho is a random walk of fine steps."""

    FINE = 50

    def __init__(self, seed, x=(0.0, 0.0, 0.0)):
        self.rng = np.random.default_rng(seed)
        self.x = np.array(x)

    def advance(self, force, offset):
        dt_s = DT_S / self.FINE
        for _ in range(self.FINE):
            pos, vel, rho = self.x
            # The mean of rho over a fine step, so that nothing of first order is left out.
            stepped = rho + self.rng.normal() * math.sqrt(DENSITY * dt_s)
            acc = (force + 0.5 * (rho + stepped)) / MASS_KG - offset
            self.x = np.array([pos + vel * dt_s + 0.5 * acc * dt_s**2, vel + acc * dt_s, stepped])

    def measure(self):
        return self.x[:2] + self.rng.normal(size=2) * math.sqrt(VAR)


def fly(estimator, seed, steps, initial_std=1.0):
    """Yield after each correction; U carries the weight and something more."""
    axis = Axis(seed, np.random.default_rng(seed + 1000).normal(size=3) * initial_std)
    for k in range(steps):
        force = MASS_KG * GRAVITY_MPS2 + math.sin(0.05 * k)
        axis.advance(force, GRAVITY_MPS2)
        assert estimator.predict(force, GRAVITY_MPS2, DT_S) is Status.OK
        status = estimator.correct(*axis.measure().tolist())
        yield axis.x, status


@pytest.mark.parametrize("steady_state", [False, True])
def test_nees_and_nis_on_its_own_model(steady_state):
    runs, steps, settle = 25, 120, 60
    nees, nis = 0.0, 0.0
    for seed in range(runs):
        estimator = filter_of(steady_state=steady_state)
        truth = np.zeros(3)
        for k, (x, status) in enumerate(fly(estimator, seed, steps, 0.0 if steady_state else 1.0)):
            assert status is Status.OK
            truth = x
            # The constant gain is right once what was not known at the start is forgotten.
            if k >= (settle if steady_state else 0):
                nis += estimator.nis
        error = estimator.state - truth
        nees += error @ np.linalg.solve(estimator.covariance, error)
    low, high = chi2.interval(0.999, 3 * runs)
    assert low < nees < high
    low, high = chi2.interval(0.999, 2 * runs * (steps - (settle if steady_state else 0)))
    assert low < nis < high


def test_a_steady_push_forward_is_a_positive_disturbance():
    """GIVEN a mass that hovers and is pushed by 0.7 N THEN that is rho, without the weight."""
    estimator = filter_of()
    vel = pos = 0.0
    rng = np.random.default_rng(0)
    for _ in range(500):
        weight = MASS_KG * GRAVITY_MPS2
        pos += vel * DT_S + 0.5 * 0.7 / MASS_KG * DT_S**2
        vel += 0.7 / MASS_KG * DT_S
        estimator.predict(weight, GRAVITY_MPS2, DT_S)
        estimator.correct(*(np.array([pos, vel]) + rng.normal(size=2) * math.sqrt(VAR)).tolist())
    assert estimator.disturbance == pytest.approx(0.7, abs=3.0 * estimator.disturbance_std)
    assert 0.0 < estimator.disturbance_std < 0.35
    assert estimator.state[2] == estimator.disturbance
    assert estimator.covariance[2, 2] == estimator.disturbance_std**2


def test_the_velocity_alone_shows_the_disturbance():
    estimator = filter_of()
    vel = 0.0
    for _ in range(500):
        vel += -1.2 / MASS_KG * DT_S
        assert estimator.predict(0.0, 0.0, DT_S) is Status.OK
        assert estimator.correct(None, vel) is Status.OK
    assert estimator.disturbance == pytest.approx(-1.2, abs=0.01)


def test_constant_gain_and_recursion_agree_once_settled():
    recursive, constant = filter_of(), filter_of(steady_state=True)
    difference = []
    for (_, _), (_, _) in zip(fly(recursive, 3, 2500, 0.0), fly(constant, 3, 2500, 0.0), strict=True):
        difference.append(np.abs(recursive.state - constant.state).max())
    assert difference[20] > 1e-3
    assert difference[-1] < 1e-9
    np.testing.assert_allclose(constant.covariance, recursive.covariance, rtol=1e-8)
    assert constant.nis == pytest.approx(recursive.nis, rel=1e-6)
    # A constant gain follows a change of the interval.
    assert constant.predict(0.0, 0.0, 2.0 * DT_S) is Status.OK
    assert constant.covariance[2, 2] > recursive.covariance[2, 2]


def test_a_gated_measurement_leaves_the_prediction():
    for steady_state in (False, True):
        estimator = filter_of(nis_gate=20.0, steady_state=steady_state)
        list(fly(estimator, 7, 300, 0.0))
        estimator.predict(0.0, 0.0, DT_S)
        before = estimator.state, estimator.covariance
        assert estimator.correct(estimator.state[0] + 5.0, estimator.state[1]) is Status.GATED
        assert estimator.nis > 20.0
        np.testing.assert_array_equal(estimator.state, before[0])
        np.testing.assert_array_equal(estimator.covariance, before[1])


def test_a_reset_begins_anew_where_it_is_told():
    estimator = filter_of(initial_var=(4.0, 9.0, 16.0))
    list(fly(estimator, 8, 100))
    estimator.reset(1.0, 2.0, 3.0)
    assert estimator.state.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(estimator.covariance, np.diag([4.0, 9.0, 16.0]))
    assert estimator.nis == 0.0
    estimator.reset()
    assert estimator.state.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("steady_state", [False, True])
def test_bad_inputs_are_refused_and_change_nothing(steady_state):
    estimator = filter_of(steady_state=steady_state)
    list(fly(estimator, 9, 50, 0.0))
    before = estimator.state, estimator.covariance, estimator.nis
    bad = (math.nan, math.inf, -math.inf, 1e10)
    for value in bad:
        assert estimator.predict(value, 0.0, DT_S) is Status.INPUT_INVALID
        assert estimator.predict(0.0, value, DT_S) is Status.INPUT_INVALID
        assert estimator.predict(0.0, 0.0, value) is Status.INPUT_INVALID
        assert estimator.correct(value, 0.0) is Status.INPUT_INVALID
        assert estimator.correct(0.0, value) is Status.INPUT_INVALID
    for dt_s in (0.0, -0.01, 10.1):
        assert estimator.predict(0.0, 0.0, dt_s) is Status.INPUT_INVALID
    assert estimator.correct(None, None) is Status.INPUT_INVALID
    if steady_state:
        assert estimator.correct(None, 0.0) is Status.INPUT_INVALID
        assert filter_of(steady_state=True).correct(0.0, 0.0) is Status.INPUT_INVALID
    np.testing.assert_array_equal(estimator.state, before[0])
    np.testing.assert_array_equal(estimator.covariance, before[1])
    assert estimator.nis == before[2]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"pos_var": 0.0}, "pos_var"),
        ({"vel_var": math.nan}, "vel_var"),
        ({"initial_var": (1.0, -1.0, 1.0)}, r"initial_var\[1\]"),
        ({"nis_gate": 0.0}, "nis_gate"),
    ],
)
def test_parameters_out_of_range_are_named(changes, named):
    with pytest.raises(ValueError, match=named):
        filter_of(**changes)


def test_inertia_and_density_out_of_range_are_named():
    with pytest.raises(ValueError, match="inertia"):
        EsLkf(0.0, 1.0, pos_var=VAR, vel_var=VAR)
    for density, steady_state in ((-1.0, False), (math.inf, False), (0.0, True)):
        with pytest.raises(ValueError, match="process_density"):
            EsLkf(1.0, density, pos_var=VAR, vel_var=VAR, steady_state=steady_state)
    constant = EsLkf(1.0, 0.0, pos_var=VAR, vel_var=VAR)
    assert constant.predict(0.0, 0.0, DT_S) is Status.OK
