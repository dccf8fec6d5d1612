"""Output-error fit of a hooked load: least squares over segments, and intervals that survive coloured residuals."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from statistics import NormalDist

import numpy as np

from swingd.core.hooked_load import pull_per_mass
from swingd.identify.segments import FlightRecord, Segment
from swingd.model.estimate import FloatArray

PERIODS = 4.0
"""Length of a segment in periods: long enough to see damping, short enough for a wrong attitude to stay the same."""
PERIODS_MIN = 2.0
SEGMENTS_WANTED = 6
"""A short flight is cut finer until it gives as many."""
SEGMENTS_MIN = 4
"""With fewer nobody can say how far segments differ."""
SCAN_FACTORS = np.geomspace(0.25, 4.0, 17)
"""Lengths that are tried first, over the configured one: the fit has a minimum at each wrong number of periods."""
SCAN_SLOW_SHARE = 0.25
"""The longest of them swings at half the configured frequency."""
CONFIDENCE = 0.95
MODEL_STD = np.array([0.005, 0.0, 0.005, 0.0])
"""What two point masses on a straight, massless cable leave out, of the length's logarithm and over the mass."""

Progress = Callable[[float], None]
"""Gets the share that is done, 0..1."""


class Shared(IntEnum):
    """Index into what all segments share."""

    LOG_LENGTH = 0
    """Logarithm of the cable's length over 1 m."""
    DAMPING_RATIO = 1
    MASS = 2
    """Load [kg]."""
    DRAG = 3
    """Drag of the vehicle across its thrust over its velocity [N/(m/s)]."""


_SHARED_STEP = np.array([1e-4, 1e-5])
_START_STEP = 1e-5
"""Of the central differences."""
_CONVERGED = 1e-8
_ITERATIONS_MAX = 30
_LAMBDA_MAX = 1e8


@dataclass(frozen=True, slots=True)
class Fit:
    """The best pendulum, and how well the flight tells it."""

    shared: FloatArray
    """(4,) see `Shared`."""
    std: FloatArray
    """(4,) its deviations."""
    quantile: float
    """Of Student's t: the interval of 95 % is ``shared +- quantile * std``."""
    segments: Sequence[Segment]
    starts: Sequence[FloatArray]
    """(4,) for each segment: x and y of the cable's unit vector at its begin, and their derivatives."""
    residual_rms_n: float
    """Of the fast part of the side force."""

    def side_force_frd_n(self, index: int) -> FloatArray:
        """Return (n, 2) force across the thrust's axis of one segment, as fitted, what is slow included."""
        segment = self.segments[index]
        force = _side_force(segment, self.shared, self.starts[index])
        slow = segment.slow @ (segment.slow.T @ (segment.side_force_frd_n.ravel() - force))
        fitted: FloatArray = (force + slow).reshape(-1, 2)
        return fitted

    def swing_rad(self, index: int) -> FloatArray:
        """Return (n,) angle between cable and vertical of one segment, as fitted."""
        pull = _pull_per_mass(self.segments[index], self.shared, self.starts[index])
        angle: FloatArray = np.arctan2(np.hypot(pull[:, 0], pull[:, 1]), pull[:, 2])
        return angle


def fit(
    record: FlightRecord,
    hanging: Sequence[tuple[float, float]],
    length_m: float,
    mass_kg: float,
    progress: Progress,
) -> Fit | None:
    """Fit length, damping ratio, mass and drag to all the time in which the load hangs.

    The side force, which is what the accelerometer feels across the thrust's axis times the vehicle's mass, is the
    load's pull, drag, and what is slow: no thrust curve is in it. The load swings below the measured motion of the
    hook; where and how it starts is free in each segment.

    Parameters
    ----------
    record : FlightRecord
    hanging : sequence of (float, float)
        When the load hangs [s, boot time].
    length_m, mass_kg : float
        First guess; the length may be wrong by a factor of four.
    progress : callable

    Returns
    -------
    Fit or None
        None where the flight gives fewer than `SEGMENTS_MIN` segments.

    Notes
    -----
    The deviations are those of a delete-one jackknife over segments (one Gauss-Newton step from the common minimum),
    with Student's t for as many segments: gusts, vibration and drag that the model does not have differ from segment
    to segment, whatever their colour; but never below those of white residuals, and with `MODEL_STD` added. B. Efron, The jackknife, the bootstrap
    and other resampling plans (1982).
    """
    coarse = record.cut(hanging, length_m, PERIODS_MIN, SCAN_SLOW_SHARE)
    if len(coarse) < SEGMENTS_MIN // 2:
        return None
    drag = [Shared.DRAG] if record.has_velocity else []
    best_cost, shared = math.inf, np.zeros(len(Shared))
    for count, factor in enumerate(SCAN_FACTORS):
        tried = np.array([math.log(factor * length_m), 0.02, mass_kg, 0.0])
        tried, _, cost = _minimise(coarse, tried, [Shared.MASS, *drag], iterations=4)
        if cost < best_cost:
            best_cost, shared = cost, tried
        progress(0.8 * (count + 1) / len(SCAN_FACTORS))
    free = [Shared.LOG_LENGTH, Shared.DAMPING_RATIO, Shared.MASS, *drag]
    shared, _, _ = _minimise(coarse, shared, free, _ITERATIONS_MAX)
    segments = _cut(record, hanging, math.exp(shared[Shared.LOG_LENGTH]))
    if len(segments) < SEGMENTS_MIN:
        return None
    shared, starts, cost = _minimise(segments, shared, free, _ITERATIONS_MAX)
    progress(1.0)
    std = np.full(len(Shared), math.inf)
    std[free], residual_rms_n = _deviations(segments, shared, starts, free, cost)
    std = np.hypot(std, MODEL_STD * np.array([1.0, 1.0, shared[Shared.MASS], 1.0]))
    return Fit(shared, std, student_quantile(len(segments) - 1), segments, starts, residual_rms_n)


def student_quantile(freedom: int, confidence: float = CONFIDENCE) -> float:
    """Return Student's two-sided quantile, within 0.5 % from 3 degrees of freedom on.

    M. Abramowitz, I. A. Stegun, Handbook of Mathematical Functions, 26.7.5.
    """
    x = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    quantile = x
    terms = (
        (x**3 + x) / 4.0,
        (5.0 * x**5 + 16.0 * x**3 + 3.0 * x) / 96.0,
        (3.0 * x**7 + 19.0 * x**5 + 17.0 * x**3 - 15.0 * x) / 384.0,
        (79.0 * x**9 + 776.0 * x**7 + 1482.0 * x**5 - 1920.0 * x**3 - 945.0 * x) / 92160.0,
    )
    for power, term in enumerate(terms, start=1):
        quantile += term / float(freedom) ** power
    return quantile


def _cut(record: FlightRecord, hanging: Sequence[tuple[float, float]], length_m: float) -> list[Segment]:
    """Segments of `PERIODS`, or as long as a short flight allows."""
    for periods in np.arange(PERIODS, PERIODS_MIN - 0.1, -0.5):
        segments = record.cut(hanging, length_m, float(periods))
        if len(segments) >= SEGMENTS_WANTED:
            break
    return segments


def _pull_per_mass(segment: Segment, shared: FloatArray, start: FloatArray) -> FloatArray:
    """Return (n, 3) pull over the load's mass, level frame."""
    pull = np.empty_like(segment.felt_level_mps2)
    length_m = math.exp(shared[Shared.LOG_LENGTH])
    pull_per_mass(pull, segment.felt_level_mps2, start, segment.dt_s, length_m, shared[Shared.DAMPING_RATIO])
    return pull


def _side_pull_per_mass(segment: Segment, shared: FloatArray, start: FloatArray) -> FloatArray:
    """Return (2 n,) the same along body x and y."""
    side: FloatArray = np.einsum("nij,nj->ni", segment.side_from_level, _pull_per_mass(segment, shared, start)).ravel()
    return side


def _side_force(segment: Segment, shared: FloatArray, start: FloatArray) -> FloatArray:
    """Return (2 n,) pull and drag along body x and y [N]."""
    pull = shared[Shared.MASS] * _side_pull_per_mass(segment, shared, start)
    force: FloatArray = pull - shared[Shared.DRAG] * segment.side_vel_frd_mps.ravel()
    return force


def _residual(segment: Segment, shared: FloatArray, start: FloatArray) -> FloatArray:
    """Return (2 n,) fast part of what is measured and not fitted [N]."""
    return segment.swift(segment.side_force_frd_n.ravel() - _side_force(segment, shared, start))


@dataclass(frozen=True, slots=True)
class _Tangent:
    """A segment's residual and what changes it, the slow part left out."""

    residual: FloatArray
    by_shared: FloatArray
    """(2 n, f) derivatives of the fitted force."""
    by_start: FloatArray
    """(2 n, 4)."""

    @classmethod
    def at(cls, segment: Segment, shared: FloatArray, start: FloatArray, free: Sequence[int]) -> "_Tangent":
        def slope(along_shared: FloatArray, along_start: FloatArray, step: float) -> FloatArray:
            ahead = _side_force(segment, shared + step * along_shared, start + step * along_start)
            behind = _side_force(segment, shared - step * along_shared, start - step * along_start)
            difference: FloatArray = (ahead - behind) / (2.0 * step)
            return difference

        axes, still = np.eye(len(Shared)), np.zeros(4)
        by_shared = []
        for index in free:
            if index == Shared.MASS:
                by_shared.append(_side_pull_per_mass(segment, shared, start))
            elif index == Shared.DRAG:
                by_shared.append(-segment.side_vel_frd_mps.ravel())
            else:
                by_shared.append(slope(axes[index], still, _SHARED_STEP[index]))
        by_start = [slope(np.zeros(len(Shared)), axis, _START_STEP) for axis in np.eye(4)]
        return cls(
            _residual(segment, shared, start),
            segment.swift(np.column_stack(by_shared)),
            segment.swift(np.column_stack(by_start)),
        )

    def without_start(self, damping: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Eliminate the start: return information (f, f), gradient (f,) and the start's answer (4, f + 1) to both."""
        normal = self.by_start.T @ self.by_start
        normal[np.diag_indices(4)] *= 1.0 + damping
        normal[np.diag_indices(4)] += 1e-12
        both = np.column_stack([self.by_shared, self.residual])
        answer = np.asarray(np.linalg.solve(normal, self.by_start.T @ both), dtype=np.float64)
        reduced = self.by_shared.T @ both - (self.by_shared.T @ self.by_start) @ answer
        return reduced[:, :-1], reduced[:, -1], answer


def _minimise(
    segments: Sequence[Segment], shared: FloatArray, free: Sequence[int], iterations: int
) -> tuple[FloatArray, list[FloatArray], float]:
    """Levenberg-Marquardt from loads at rest, each segment's start eliminated: the work grows as the flight.

    Returns
    -------
    tuple
        Shared parameters, starts, and the sum of squared residuals [N^2].
    """
    starts = [np.zeros(4) for _ in segments]
    free = list(free)
    cost = _cost(segments, shared, starts)
    damping = 1e-3
    for _ in range(iterations):
        tangents = [_Tangent.at(*pair, free) for pair in zip(segments, [shared] * len(segments), starts, strict=True)]
        before = cost
        while damping < _LAMBDA_MAX:
            reduced = [tangent.without_start(damping) for tangent in tangents]
            information = np.sum([part[0] for part in reduced], axis=0)
            information[np.diag_indices(len(free))] *= 1.0 + damping
            gradient = np.sum([part[1] for part in reduced], axis=0)
            change: FloatArray = np.linalg.lstsq(information, gradient)[0]
            tried = shared.copy()
            tried[free] += change
            tried_starts = [
                start + answer[:, -1] - answer[:, :-1] @ change
                for start, (_, _, answer) in zip(starts, reduced, strict=True)
            ]
            tried_cost = _cost(segments, tried, tried_starts)
            if tried_cost <= cost:
                shared, starts, cost = tried, tried_starts, tried_cost
                damping = max(0.1 * damping, 1e-9)
                break
            damping *= 10.0
        if damping >= _LAMBDA_MAX or before - cost < _CONVERGED * before:
            break
    return shared, starts, cost


def _cost(segments: Sequence[Segment], shared: FloatArray, starts: Sequence[FloatArray]) -> float:
    """Sum of squared residuals; infinite where no load could hang."""
    possible = (
        -4.0 < shared[Shared.LOG_LENGTH] < 6.0
        and -0.3 < shared[Shared.DAMPING_RATIO] < 0.9
        and shared[Shared.MASS] > 0.0
        and all(math.hypot(start[0], start[1]) < 0.99 for start in starts)
    )
    if not possible:
        return math.inf
    residuals = (_residual(segment, shared, start) for segment, start in zip(segments, starts, strict=True))
    cost = sum(float(residual @ residual) for residual in residuals)
    return cost if math.isfinite(cost) else math.inf


def _deviations(
    segments: Sequence[Segment], shared: FloatArray, starts: Sequence[FloatArray], free: Sequence[int], cost: float
) -> tuple[FloatArray, float]:
    """Return (f,) deviations of the free parameters, and the RMS of the residual [N]."""
    tangents = [_Tangent.at(segment, shared, start, free) for segment, start in zip(segments, starts, strict=True)]
    reduced = [tangent.without_start() for tangent in tangents]
    information = np.sum([part[0] for part in reduced], axis=0)
    # Each segment pays for its start and for what is slow.
    count = sum(
        len(tangent.residual) - 4 - segment.slow.shape[1] for tangent, segment in zip(tangents, segments, strict=True)
    )
    variance = cost / max(count - len(free), 1)
    white = variance * np.diag(np.linalg.pinv(information))
    without = np.array([-np.linalg.lstsq(information - part, gradient)[0] for part, gradient, _ in reduced])
    kept = len(segments)
    jackknife = (kept - 1) / kept * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    deviations: FloatArray = np.sqrt(np.maximum(white, jackknife))
    return deviations, math.sqrt(variance)
