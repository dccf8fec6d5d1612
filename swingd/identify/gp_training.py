"""Training of the Gaussian process (13)-(18) of the GP-EKF paper: samples from logs, hyperparameters by likelihood."""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from swingd.core import slts
from swingd.core.gaussian_process import NUM_FEATURES, NUM_SWING_FEATURES
from swingd.core.status import Status
from swingd.estimation.acceleration_model import AccelerationModel, TrainedFor, correction
from swingd.identify.swing_log import VELOCITY, Segment
from swingd.model.errors import ConfigurationError, LogFormatError
from swingd.model.estimate import FloatArray

INTERVAL_S = 0.1
"""delta T of (18): the noise of a measured v enters divided by it."""
HELD_OUT_SHARE = 0.25
"""Of every segment, its end."""
FITTED_MAX = 300
"""Samples that the likelihood is computed with; its cost grows with their cube."""
SAMPLES = 48
"""What the model keeps."""
SAMPLES_MIN = 100
_BOUNDS = [(0.15, 30.0)] * 2 + [(0.4, 30.0)] * 2 + [(1.0, 30.0)] * 2
"""Of the length scales of r [m], v and v_p [m/s]: shorter ones would fit what is noise of neighbours in time."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Training data: features, and the acceleration errors of (18)."""

    z: FloatArray
    """(n, k) r [m], v [m/s] and, where it is a feature, v_p [m/s]."""
    error: FloatArray
    """(n, 2) [m/s^2]"""
    vehicle_error: FloatArray
    """(n, 2) the same of the vehicle's own acceleration [m/s^2]; nan where its velocity was not logged."""

    def rows(self, chosen: slice) -> "Samples":
        """Return some of them."""
        return Samples(self.z[chosen], self.error[chosen], self.vehicle_error[chosen])


@dataclass(frozen=True, slots=True)
class Score:
    """How well errors are told that nobody trained on; both outputs together."""

    rmse_before: float
    """Without correction [m/s^2]."""
    rmse_after: float
    log_likelihood_before: float
    """Mean over samples and outputs, of zero with the deviation of the training data."""
    log_likelihood_after: float


@dataclass(frozen=True, slots=True)
class Training:
    """A trained model and what it is worth."""

    model: AccelerationModel
    noise_std: FloatArray
    """(2,) sigma_n of one sample [m/s^2]."""
    trained: Samples
    held_out: Samples
    score: Score
    held_out_mean: FloatArray
    """(n, 2) what the model says at the held out features [m/s^2]."""
    held_out_std: FloatArray
    """(n, 2) with the samples' noise."""


def samples_of(segment: Segment, trained_for: TrainedFor, with_velocity: bool = False) -> Samples:
    """Compute the acceleration errors of a segment, (18), one for each interval.

    Parameters
    ----------
    segment : Segment
    trained_for : TrainedFor
        Whose equation (3) predicts.
    with_velocity : bool
        Whether the load's velocity is a feature.

    Notes
    -----
    The prediction integrates (3) by the midpoint rule from the measured r, v with the force of every row in between.
    Intervals that leave the reach of r are left out.
    """
    t_s, force = segment.t_s, np.ascontiguousarray(segment.force_ned_n)
    rows = max(1, round(INTERVAL_S / float(np.median(np.diff(t_s)))))
    vehicle = (trained_for.mass_kg, trained_for.payload_mass_kg, trained_for.cable_length_m)
    still, acc = np.zeros(3), np.empty(6)
    features, errors, vehicle_errors = [], [], []
    vel_load = segment.vel_load_mps if segment.vel_load_mps is not None else np.full(segment.v_mps.shape, np.nan)
    for first in range(0, t_s.size - rows, rows):
        x = np.zeros(slts.NUM_STATES)
        x[3:5], x[8:10] = segment.r_m[first], segment.v_mps[first]
        for row in range(first + 1, first + rows + 1):
            dt_s = t_s[row] - t_s[row - 1]
            if slts.acceleration(acc, x, force[row], still, *vehicle) != Status.OK:
                break
            middle = x + 0.5 * dt_s * np.concatenate([x[5:], acc[:5]])
            if slts.acceleration(acc, middle, force[row], still, *vehicle) != Status.OK:
                break
            x = x + dt_s * np.concatenate([middle[5:], acc[:5]])
        else:
            last = first + rows
            features.append(_features(segment, first, with_velocity))
            since_s = t_s[last] - t_s[first]
            error = (segment.v_mps[last] - x[8:10]) / since_s
            errors.append(error)
            vehicle_errors.append((vel_load[last] - vel_load[first] - x[5:7]) / since_s + error)
    width = NUM_FEATURES if with_velocity else NUM_SWING_FEATURES
    return Samples(
        np.array(features).reshape(-1, width), np.array(errors).reshape(-1, 2), np.array(vehicle_errors).reshape(-1, 2)
    )


def train(
    segments: Sequence[Segment],
    trained_for: TrainedFor,
    samples: int = SAMPLES,
    with_velocity: bool = False,
    watch: Callable[[float], None] = lambda _share: None,
) -> Training:
    """Train on the beginnings of all segments and judge on their ends.

    Parameters
    ----------
    segments : sequence of Segment
    trained_for : TrainedFor
    samples : int
        How many the model keeps, see `swingd.core.gaussian_process.SAMPLES_MAX`.
    with_velocity : bool
        Whether the load's velocity is a feature, as its drag wants it; (17) has r and v alone.
    watch : callable
        Takes the share done, 0..1.

    Returns
    -------
    Training
        The same segments give the same model.

    Raises
    ------
    ConfigurationError
        If scikit-learn is missing.
    LogFormatError
        If there are too few samples, or the vehicle's velocity is wanted and missing.

    Notes
    -----
    Hyperparameters maximise the likelihood of at most `FITTED_MAX` samples, drawn evenly. The model keeps the centres
    of the clusters that all training samples fall into, each with the mean of its samples' errors and sigma_n over the
    root of their number, corrected for the correlation of neighbours in time: a Gaussian process of few samples that
    has seen all of them. Which body the error pushes shows in the vehicle's own acceleration, where its velocity was
    logged; without it the error is taken to push the vehicle, which does less harm where it is wrong.
    """
    if find_spec("sklearn") is None:
        raise ConfigurationError("scikit-learn is not installed; expected: pip install 'swingd[train]'")
    if with_velocity and any(segment.vel_load_mps is None for segment in segments):
        raise LogFormatError(f"a log has no vehicle's velocity; expected columns {', '.join(VELOCITY)}")
    parts = [samples_of(segment, trained_for, with_velocity) for segment in segments]
    cuts = [round((1.0 - HELD_OUT_SHARE) * len(part.z)) for part in parts]
    trained = _joined([part.rows(slice(None, cut)) for part, cut in zip(parts, cuts, strict=True)])
    held_out = _joined([part.rows(slice(cut, None)) for part, cut in zip(parts, cuts, strict=True)])
    if len(trained.z) < max(SAMPLES_MIN, 2 * samples):
        raise LogFormatError(
            f"the logs hold {len(trained.z)} samples of {INTERVAL_S:g} s for training; "
            f"expected at least {max(SAMPLES_MIN, 2 * samples)}"
        )
    watch(0.3)
    from threadpoolctl import threadpool_limits

    scales, signal_std, noise_std = np.empty((2, trained.z.shape[1])), np.empty(2), np.empty(2)
    # The matrices are so small that threads only wait for each other; and their sums depend on how many there are.
    with threadpool_limits(1):
        for output in range(2):
            scales[output], signal_std[output], noise_std[output] = _hyperparameters(trained, output)
            watch(0.5 + 0.2 * output)
        model = _compressed(trained, trained_for, scales, signal_std, noise_std, samples)
    model = replace(model, load_share=_load_share(trained, model))
    mean, var = correction(model.prepare(), held_out.z)
    std = np.sqrt(var + noise_std**2)
    watch(1.0)
    before_std = np.sqrt(np.mean(trained.error**2, axis=0))
    score = Score(
        float(np.sqrt(np.mean(held_out.error**2))),
        float(np.sqrt(np.mean((held_out.error - mean) ** 2))),
        _log_likelihood(held_out.error, before_std),
        _log_likelihood(held_out.error - mean, std),
    )
    return Training(model, noise_std, trained, held_out, score, mean, std)


def _features(segment: Segment, row: int, with_velocity: bool) -> FloatArray:
    parts = [segment.r_m[row], segment.v_mps[row]]
    if with_velocity:
        assert segment.vel_load_mps is not None
        parts.append(segment.vel_load_mps[row])
    return np.concatenate(parts)


def _joined(parts: Sequence[Samples]) -> Samples:
    return Samples(
        np.concatenate([part.z for part in parts]),
        np.concatenate([part.error for part in parts]),
        np.concatenate([part.vehicle_error for part in parts]),
    )


def _load_share(trained: Samples, model: AccelerationModel) -> float:
    """Share of what the model says that the vehicle's own acceleration does not show.

    The vehicle's error is regressed on the model's mean and not on the measured error, whose noise would feign a load.
    """
    known = np.isfinite(trained.vehicle_error).all(axis=1)
    if not known.any():
        return 0.0
    mean, _ = correction(model.prepare(), trained.z[known])
    of_vehicle = float(np.sum(mean * trained.vehicle_error[known]) / np.sum(mean * mean))
    return float(np.clip(1.0 - of_vehicle, 0.0, 1.0))


def _log_likelihood(error: FloatArray, std: FloatArray) -> float:
    return float(np.mean(-0.5 * (error / std) ** 2 - np.log(std) - 0.5 * math.log(2.0 * math.pi)))


def _hyperparameters(trained: Samples, output: int) -> tuple[FloatArray, float, float]:
    """Length scales, sigma_f, sigma_n of the greatest likelihood."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    chosen = np.linspace(0, len(trained.z) - 1, min(FITTED_MAX, len(trained.z))).astype(int)
    z, error = trained.z[chosen], trained.error[chosen, output]
    variance = float(np.mean(error**2))
    kernel = ConstantKernel(0.3 * variance, (1e-3 * variance, 1e3 * variance)) * RBF(
        np.maximum(2.0 * z.std(axis=0), 0.1), _BOUNDS[: z.shape[1]]
    ) + WhiteKernel(0.7 * variance, (1e-3 * variance, 2.0 * variance))
    regressor = GaussianProcessRegressor(kernel, alpha=1e-9 * variance, random_state=0)
    with warnings.catch_warnings():
        # A feature that tells nothing ends at the longest scale, which is right and no reason to warn.
        warnings.simplefilter("ignore", ConvergenceWarning)
        regressor.fit(z, error)
    product, white = regressor.kernel_.k1, regressor.kernel_.k2
    return (
        np.asarray(product.k2.length_scale, dtype=float),
        math.sqrt(product.k1.constant_value),
        math.sqrt(white.noise_level),
    )


def _compressed(
    trained: Samples, trained_for: TrainedFor, scales: FloatArray, signal_std: FloatArray, noise_std: FloatArray,
    count: int,
) -> AccelerationModel:  # fmt: skip
    """Means of clusters of the samples, in features measured by their shorter length scale."""
    from sklearn.cluster import KMeans

    # A scale far beyond what was flown tells nothing of how finely to divide.
    unit = np.minimum(scales.min(axis=0), 4.0 * trained.z.std(axis=0) + 1e-6)
    labels = KMeans(count, n_init=1, random_state=0).fit_predict(trained.z / unit)
    sizes = np.bincount(labels, minlength=count)
    kept = np.flatnonzero(sizes)
    centres = np.array([trained.z[labels == at].mean(axis=0) for at in kept])
    targets = np.array([trained.error[labels == at].mean(axis=0) for at in kept])
    target_std = noise_std[None, :] * np.sqrt(_correlation(trained.error) / sizes[kept, None])
    return AccelerationModel(trained_for, scales, signal_std, centres, targets, np.minimum(target_std, noise_std))


def _correlation(error: FloatArray) -> float:
    """How many neighbouring samples in time tell as much as one: the integral of their autocorrelation."""
    centred = error - error.mean(axis=0)
    total, variance = 1.0, float(np.mean(centred**2))
    for lag in range(1, len(centred) // 4):
        correlation = float(np.mean(centred[lag:] * centred[:-lag])) / variance
        if correlation < 0.05:
            break
        total += 2.0 * correlation
    return total
