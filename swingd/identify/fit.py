"""Prediction-error fit of a hooked load over segments of flight, with intervals that bear gusts and vibration."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from statistics import NormalDist

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.hooked_load import pull_per_mass
from swingd.identify.segments import RATE_HZ, FlightRecord, Segment
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
BLOCKS_PER_PERIOD = 16.0
"""The residual is averaged over blocks: vibration and the noise of the sensors are no matter of the swing."""
COLOUR_ORDER = 2
"""Of the autoregression of the averaged residual: wind, and what is left of the noise."""
COLOUR_PASSES = 3
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


RATE_MAX = 20.0
"""Of a load's start, in rad/s: faster ones are no swing."""
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
    """Of the side force averaged over blocks, beyond what was to be expected from the blocks before."""

    @property
    def length_m(self) -> float:
        """Cable."""
        return math.exp(self.shared[Shared.LOG_LENGTH])

    @property
    def swing_rms_rad(self) -> float:
        """Angle of the cable from the vertical."""
        swing = np.concatenate([self.swing_rad(index) for index in range(len(self.segments))])
        return float(np.sqrt(np.mean(swing * swing)))

    def side_force_frd_n(self, index: int) -> FloatArray:
        """Return (n, 2) force across the thrust's axis of one segment, as fitted, steady forces included."""
        segment = self.segments[index]
        force = _side_force(segment, self.shared, self.starts[index])
        steady = _steady(segment)
        force += steady @ np.linalg.lstsq(steady, segment.side_force_frd_n.ravel() - force)[0]
        fitted: FloatArray = force.reshape(-1, 2)
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
    load's pull, drag, wind: no thrust curve is in it. The load swings below the measured motion of the hook; where and
    how it starts is free in each segment. What is minimised is the part of the rest that the rest before did not
    announce: so gusts, which cause swing, are not taken for its pull.

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
    to segment, whatever their colour. They are never below those of white residuals, and `MODEL_STD` is added.
    B. Efron, The jackknife, the bootstrap and other resampling plans (1982).
    """
    coarse = record.cut(hanging, length_m, PERIODS_MIN)
    if len(coarse) < SEGMENTS_MIN // 2:
        return None
    drag = [Shared.DRAG] if record.has_velocity else []
    scales = [Scale(segment, _block(length_m), RANDOM_WALK) for segment in coarse]
    best_cost, shared = math.inf, np.zeros(len(Shared))
    for count, factor in enumerate(SCAN_FACTORS):
        tried = np.array([math.log(factor * length_m), 0.02, mass_kg, 0.0])
        tried, _, cost = _minimise(scales, tried, [Shared.MASS, *drag], iterations=4)
        if cost < best_cost:
            best_cost, shared = cost, tried
        progress(0.8 * (count + 1) / len(SCAN_FACTORS))
    free = [Shared.LOG_LENGTH, Shared.DAMPING_RATIO, Shared.MASS, *drag]
    shared, _, _ = _minimise(scales, shared, free, _ITERATIONS_MAX)
    found_m = math.exp(shared[Shared.LOG_LENGTH])
    segments = _cut(record, hanging, found_m)
    if len(segments) < SEGMENTS_MIN:
        return None
    block = _block(found_m)
    # Plain squares find the minimum from afar, in wide swings too; whitened ones find where it really is.
    scales = [Scale(segment, block, np.empty(0)) for segment in segments]
    shared, starts, cost = _minimise(scales, shared, free, _ITERATIONS_MAX)
    for _ in range(COLOUR_PASSES):
        colour = _colour(scales, shared, starts)
        scales = [Scale(segment, block, colour) for segment in segments]
        shared, starts, cost = _minimise(scales, shared, free, _ITERATIONS_MAX, starts)
    std, residual_rms_n = _deviations(scales, shared, starts, free, cost)
    progress(1.0)
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


def _steady(segment: Segment) -> FloatArray:
    """Return (2 n, 2) forces along the level axes as the body feels them: steady wind, bias of the sensors."""
    steady: FloatArray = segment.side_from_level[:, :, :2].reshape(-1, 2)
    return steady


def _block(length_m: float) -> int:
    """Samples of a block."""
    period_s = 2.0 * math.pi * math.sqrt(length_m / GRAVITY_MPS2)
    return max(round(period_s / BLOCKS_PER_PERIOD * RATE_HZ), 1)


RANDOM_WALK = np.array([0.95])
"""Colour that is presumed at first: wind."""


class Scale:
    """Weighs residuals of one segment: averaged over blocks, made white, steady forces left out.

    A gust that pushes the vehicle makes the load swing a little later, and plain least squares take the one for the
    other; what nobody could foresee of a gust has nothing in common with the swing that it finds.

    Parameters
    ----------
    segment : Segment
    block : int
        Samples of a block.
    colour : (p,)
        Autoregression of the averaged force that is not fitted.
    """

    def __init__(self, segment: Segment, block: int, colour: FloatArray) -> None:
        self.segment = segment
        self._block = block
        self._colour = colour
        steady = self._white(_steady(segment))
        self._steady: FloatArray = np.linalg.qr(steady)[0]

    def blocks(self, values: FloatArray) -> FloatArray:
        """Return (b, 2, k) block means of (2 n, k) values."""
        count = len(self.segment.t_boot_s) // self._block
        shape = (count, self._block, 2, values.shape[1])
        means: FloatArray = values[: 2 * count * self._block].reshape(shape).mean(axis=1)
        return means

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return weighed (m, k) of (2 n, k) values [N]."""
        white = self._white(values)
        return white - self._steady @ (self._steady.T @ white)

    def _white(self, values: FloatArray) -> FloatArray:
        blocks = self.blocks(values)
        order = len(self._colour)
        white = blocks[order:].copy()
        for lag, share in enumerate(self._colour, start=1):
            white -= share * blocks[order - lag : len(blocks) - lag]
        return white.reshape(-1, values.shape[1])

    def residual(self, shared: FloatArray, start: FloatArray) -> FloatArray:
        """Return (m,) what is measured and not fitted, weighed."""
        return self(_unfitted(self.segment, shared, start))[:, 0]


def _unfitted(segment: Segment, shared: FloatArray, start: FloatArray) -> FloatArray:
    """Return (2 n, 1) what is measured and not fitted [N]."""
    return (segment.side_force_frd_n.ravel() - _side_force(segment, shared, start))[:, None]


def _colour(scales: Sequence[Scale], shared: FloatArray, starts: Sequence[FloatArray]) -> FloatArray:
    """Autoregression of the averaged force that is not fitted, by least squares over all segments."""
    past, present = [], []
    for scale, start in zip(scales, starts, strict=True):
        values = np.column_stack([_unfitted(scale.segment, shared, start), _steady(scale.segment)])
        blocks = scale.blocks(values)
        flat = blocks.reshape(-1, 3)
        left = flat[:, 0] - flat[:, 1:] @ np.linalg.lstsq(flat[:, 1:], flat[:, 0])[0]
        course = left.reshape(-1, 2)
        past.append(
            np.stack([course[COLOUR_ORDER - lag : len(course) - lag] for lag in range(1, COLOUR_ORDER + 1)], -1)
        )
        present.append(course[COLOUR_ORDER:])
    pasts = np.concatenate(past).reshape(-1, COLOUR_ORDER)
    return np.asarray(np.linalg.lstsq(pasts, np.concatenate(present).ravel())[0], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _Tangent:
    """A segment's residual and what changes it, weighed."""

    residual: FloatArray
    by_shared: FloatArray
    """(m, f) derivatives of the fitted force."""
    by_start: FloatArray
    """(m, 4)."""

    @classmethod
    def at(cls, scale: Scale, shared: FloatArray, start: FloatArray, free: Sequence[int]) -> "_Tangent":
        segment = scale.segment

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
            scale.residual(shared, start),
            scale(np.column_stack(by_shared)),
            scale(np.column_stack(by_start)),
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
    scales: Sequence[Scale],
    shared: FloatArray,
    free: Sequence[int],
    iterations: int,
    starts: Sequence[FloatArray] | None = None,
) -> tuple[FloatArray, list[FloatArray], float]:
    """Levenberg-Marquardt from ``starts`` or loads at rest; the work grows as the flight.

    Each segment's start is eliminated from the normal equations.

    Returns
    -------
    tuple
        Shared parameters, starts, and the sum of squared residuals [N^2].
    """
    starts = [np.zeros(4) for _ in scales] if starts is None else list(starts)
    free = list(free)
    cost = _cost(scales, shared, starts)
    damping = 1e-3
    for _ in range(iterations):
        tangents = [_Tangent.at(scale, shared, start, free) for scale, start in zip(scales, starts, strict=True)]
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
            tried_cost = _cost(scales, tried, tried_starts)
            if tried_cost <= cost:
                shared, starts, cost = tried, tried_starts, tried_cost
                damping = max(0.1 * damping, 1e-9)
                break
            damping *= 10.0
        if damping >= _LAMBDA_MAX or before - cost < _CONVERGED * before:
            break
    return shared, starts, cost


def _cost(scales: Sequence[Scale], shared: FloatArray, starts: Sequence[FloatArray]) -> float:
    """Sum of squared residuals; infinite where no load could hang."""
    possible = (
        -3.0 < shared[Shared.LOG_LENGTH] < 6.0
        and -0.1 < shared[Shared.DAMPING_RATIO] < 0.6
        and shared[Shared.MASS] > 0.0
        and all(math.hypot(start[0], start[1]) < 0.99 and math.hypot(start[2], start[3]) < RATE_MAX for start in starts)
    )
    if not possible:
        return math.inf
    residuals = (scale.residual(shared, start) for scale, start in zip(scales, starts, strict=True))
    cost = sum(float(residual @ residual) for residual in residuals)
    return cost if math.isfinite(cost) else math.inf


def _deviations(
    scales: Sequence[Scale], shared: FloatArray, starts: Sequence[FloatArray], free: Sequence[int], cost: float
) -> tuple[FloatArray, float]:
    """Return (4,) deviations, infinite where not free, and the RMS of the residual [N]."""
    tangents = [_Tangent.at(scale, shared, start, free) for scale, start in zip(scales, starts, strict=True)]
    reduced = [tangent.without_start() for tangent in tangents]
    information = np.sum([part[0] for part in reduced], axis=0)
    # Each segment pays for its start and for the steady forces.
    count = sum(len(tangent.residual) - 6 for tangent in tangents)
    variance = cost / max(count - len(free), 1)
    white = variance * np.diag(np.linalg.pinv(information))
    without = np.array([-np.linalg.lstsq(information - part, gradient)[0] for part, gradient, _ in reduced])
    kept = len(scales)
    jackknife = (kept - 1) / kept * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    std = np.full(len(Shared), math.inf)
    std[free] = np.sqrt(np.maximum(white, jackknife))
    std = np.hypot(std, MODEL_STD * np.array([1.0, 1.0, shared[Shared.MASS], 1.0]))
    return std, math.sqrt(variance)
