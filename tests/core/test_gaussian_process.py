"""The Gaussian process against scikit-learn, finite differences and its own limits."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from swingd.core.gaussian_process import predict, prepare
from swingd.core.status import Status

SCALES = np.array([[0.3, 0.5, 0.8, 1.5], [0.4, 0.2, 2.0, 0.6]])
SIGNAL_STD = np.array([0.4, 0.7])


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(1)
    Z = rng.uniform(-0.5, 0.5, (40, 4))
    targets = np.column_stack([np.sin(3.0 * Z[:, 0]) - 0.3 * Z[:, 2], Z[:, 1] * Z[:, 3]])
    noise_var = rng.uniform(0.01, 0.05, (40, 2)) ** 2
    return Z, targets, noise_var


@pytest.fixture(scope="module")
def prepared(samples):
    Z, targets, noise_var = samples
    weights, K_inv = np.empty((40, 2)), np.empty((80, 40))
    status = prepare(weights, K_inv, Z, targets, np.ascontiguousarray(SCALES**-2.0), SIGNAL_STD**2, noise_var)
    assert status == Status.OK
    return Z, weights, K_inv, np.ascontiguousarray(SCALES**-2.0), SIGNAL_STD**2


def at(z, prepared):
    mean, var, J = np.empty(2), np.empty(2), np.empty((2, 4))
    predict(mean, var, J, np.ascontiguousarray(z), *prepared)
    return mean, var, J


def test_mean_and_variance_are_those_of_scikit_learn(samples, prepared):
    Z, targets, noise_var = samples
    points = np.random.default_rng(2).uniform(-0.7, 0.7, (25, 4))
    for output in range(2):
        kernel = ConstantKernel(SIGNAL_STD[output] ** 2, "fixed") * RBF(SCALES[output], "fixed")
        oracle = GaussianProcessRegressor(kernel, alpha=noise_var[:, output], optimizer=None)
        mean, std = oracle.fit(Z, targets[:, output]).predict(points, return_std=True)
        ours = [at(point, prepared) for point in points]
        np.testing.assert_allclose([m[output] for m, _, _ in ours], mean, atol=1e-8)
        np.testing.assert_allclose([v[output] for _, v, _ in ours], std**2, atol=1e-8)


def test_jacobian_is_the_difference(prepared):
    rng = np.random.default_rng(3)
    e = 1e-6
    for z in rng.uniform(-0.6, 0.6, (10, 4)):
        _, _, J = at(z, prepared)
        expected = [(at(z + e * d, prepared)[0] - at(z - e * d, prepared)[0]) / (2.0 * e) for d in np.eye(4)]
        np.testing.assert_allclose(J, np.array(expected).T, atol=1e-7)


def test_far_from_every_sample_nothing_is_known(prepared):
    mean, var, J = at(np.full(4, 30.0), prepared)
    np.testing.assert_array_equal(mean, 0.0)
    np.testing.assert_allclose(var, SIGNAL_STD**2)
    np.testing.assert_array_equal(J, 0.0)


def test_noise_enters_once(samples, prepared):
    """(15) writes it beside K and into K, (16) on every entry: either would pull the mean at a sample to zero."""
    Z, targets, _ = samples
    for row in range(0, 40, 7):
        mean, _, _ = at(Z[row], prepared)
        np.testing.assert_allclose(mean, targets[row], atol=0.12)


def test_samples_twice_without_noise_are_refused(samples):
    Z, targets, _ = samples
    twice = np.ascontiguousarray(np.vstack([Z, Z]))
    out = np.empty((80, 2)), np.empty((160, 80))
    status = prepare(*out, twice, np.vstack([targets, targets]), SCALES**-2.0, SIGNAL_STD**2, np.zeros((80, 2)))
    assert status == Status.NOT_POSITIVE


def test_no_samples_are_no_correction():
    none = np.empty((0, 4)), np.empty((0, 2)), np.empty((0, 0)), np.ones((2, 4)), np.ones(2)
    mean, var, J = at(np.zeros(4), none)
    np.testing.assert_array_equal(mean, 0.0)
    np.testing.assert_array_equal(var, 1.0)
    np.testing.assert_array_equal(J, 0.0)
