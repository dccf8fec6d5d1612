"""What a flight shows, in figures."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from swingd.model.estimate import FloatArray
from swingd.record.truth import BoolArray

from .plan import WINDOW_S, Scenario
from .record import Flown, Step, TrialError, Truth

SETTLED_RAD = math.radians(2.0)
SETTLED_FOR_S = 1.0
ESTIMATE_LEAD_S = 5.0
"""The estimate is judged from this long before the first command to the end."""
LEVEL_S = 1.0
"""The altitude is held against its mean over this long before the command."""
DECAY_LEAD_PERIODS = 1.5
"""The free decay is looked at from here on, when the vehicle has done what was commanded."""
DECAY_MIN_RAD = math.radians(2.0)
DAMPING_MAX = 0.4
"""More of it is no oscillation that could be told from a lean."""
REAL_TIME_WINDOW_S = 2.0


@dataclass(frozen=True, slots=True)
class StepFigures:
    """After one command, or a course of several."""

    peak_deg: float
    """Largest true total swing."""
    settle_s: float
    """From the last command until the true total swing stays under 2 deg."""
    settled: bool
    """Whether it stayed there for a second at least; else the time is only what was watched."""
    settle_periods: float
    rms_deg: float
    """True total swing, from the first command to 12 s after the last."""
    velocity_rmse_mps: float | None
    """True against commanded horizontal velocity over the same time; none where a position is commanded."""
    altitude_m: float
    """Largest deviation over the same time from the second before."""
    period_s: float | None
    """Of the decay after the last command; none where too little swings."""
    damping_ratio: float | None


@dataclass(frozen=True, slots=True)
class FlightFigures:
    """Of a flight as a whole."""

    xi_rmse_deg: float
    """Published against true lateral angle, from 5 s before the first command to the end."""
    zeta_rmse_deg: float
    """Longitudinal."""
    correction_mps2: float
    """Largest acceleration that was added to a setpoint over the same time."""
    filter_hz: float
    latency_ms_p99: float | None
    """IMU frame received to setpoint sent."""
    real_time: float
    """The autopilot's over the wall's time from the first command to the end."""
    real_time_worst: float
    """Of any two seconds of it."""


@dataclass(frozen=True, slots=True)
class Decay:
    """A free, damped oscillation."""

    period_s: float
    damping_ratio: float


def judge_step(truth: Truth, step: Step, scenario: Scenario) -> StepFigures:
    """Return the figures of one step of a scenario.

    Raises
    ------
    TrialError
        If the truth does not cover it.
    """
    t = truth.t_boot_s
    period_s = scenario.period_s
    if t[0] > step.t_boot_s - LEVEL_S or t[-1] < step.t_end_s - SETTLED_FOR_S:
        raise TrialError(
            f"{step.manoeuvre} {step.name}: the truth covers {t[0]:.1f} to {t[-1]:.1f} s of the autopilot's clock, "
            f"the step {step.t_boot_s:.1f} to {step.t_end_s:.1f} s"
        )
    chi = _askew(truth, step, period_s) if scenario.built_in else truth.chi_rad
    whole = (t >= step.t_boot_s) & (t < step.t_end_s)
    window = whole & (t < step.t_last_s + WINDOW_S)
    last = (t >= step.t_last_s) & (t < step.t_end_s)
    above = np.flatnonzero(chi[last] > SETTLED_RAD)
    settle_s = float(t[last][above[-1]]) - step.t_last_s if above.size else 0.0
    down = truth.pos_ned_m[2]
    level_m = down[(t >= step.t_boot_s - LEVEL_S) & (t < step.t_boot_s)].mean()
    decay = _decay_after(truth, step, period_s)
    return StepFigures(
        peak_deg=math.degrees(chi[whole].max()),
        settle_s=settle_s,
        settled=bool(chi[last][t[last] > step.t_end_s - SETTLED_FOR_S].max() <= SETTLED_RAD),
        settle_periods=settle_s / period_s,
        rms_deg=math.degrees(_rms(chi[window])),
        velocity_rmse_mps=_velocity_rmse(truth, step, window) if step.velocity else None,
        altitude_m=float(np.abs(down[window] - level_m).max()),
        period_s=decay.period_s if decay else None,
        damping_ratio=decay.damping_ratio if decay else None,
    )


def judge_flight(truth: Truth, flown: Flown, daemon: dict[str, float | None]) -> FlightFigures:
    """Return the figures of a whole flight; ``daemon`` is what ``swingd run --summary`` wrote.

    Raises
    ------
    TrialError
        If nothing was commanded, or no estimate arrived.
    """
    if not flown.steps:
        raise TrialError("nothing was commanded")
    begin_s, end_s = flown.steps[0].t_boot_s, flown.steps[-1].t_end_s
    estimate = np.array(flown.estimate).reshape(-1, 4).T
    used = (estimate[0] >= begin_s - ESTIMATE_LEAD_S) & (estimate[0] <= end_s)
    if not used.any():
        raise TrialError(f"no estimate arrived between {begin_s:.1f} and {end_s:.1f} s of the autopilot's clock")
    t = estimate[0, used]
    errors = [estimate[1 + axis, used] - np.interp(t, truth.t_boot_s, truth.angles_rad[axis]) for axis in range(2)]
    real_time, worst = real_time_factors(flown.clock, begin_s, end_s)
    return FlightFigures(
        xi_rmse_deg=math.degrees(_rms(errors[0])),
        zeta_rmse_deg=math.degrees(_rms(errors[1])),
        correction_mps2=float(estimate[3, used].max()),
        filter_hz=daemon["filter_hz"] or 0.0,
        latency_ms_p99=daemon["latency_ms_p99"],
        real_time=real_time,
        real_time_worst=worst,
    )


def real_time_factors(clock: list[tuple[float, float]], begin_s: float, end_s: float) -> tuple[float, float]:
    """Return simulated over real time between two times of the autopilot's clock, in the mean and in the worst 2 s."""
    t, wall = np.array([mark for mark in clock if begin_s <= mark[0] <= end_s]).reshape(-1, 2).T
    if len(t) < 2:
        return 0.0, 0.0
    mean = float((t[-1] - t[0]) / (wall[-1] - wall[0]))
    ends = wall[wall <= wall[-1] - REAL_TIME_WINDOW_S]
    passed = np.interp(ends + REAL_TIME_WINDOW_S, wall, t) - t[: len(ends)]
    return mean, float(passed.min() / REAL_TIME_WINDOW_S) if len(ends) else mean


def fit_decay(t_s: FloatArray, angle_rad: FloatArray, period_s: float) -> Decay | None:
    """Fit a damped oscillation about a constant.

    Parameters
    ----------
    t_s, angle_rad : (n,)
        One angle in free decay.
    period_s : float
        Where the fit begins.

    Returns
    -------
    Decay or None
        None if it swings by less than 2 deg, for less than two periods, or dies out within one.
    """
    centred = angle_rad - angle_rad.mean()
    if t_s[-1] - t_s[0] < 2.0 * period_s or np.abs(centred).max() < DECAY_MIN_RAD:
        return None
    t = t_s - t_s[0]
    omega = 2.0 * math.pi / period_s

    def model(x: FloatArray) -> FloatArray:
        damping, pulsation = x[0] * x[1], x[1] * math.sqrt(max(1.0 - x[0] ** 2, 1e-6))
        angle: FloatArray = np.exp(-damping * t) * (x[2] * np.cos(pulsation * t) + x[3] * np.sin(pulsation * t)) + x[4]
        return angle

    start = np.array([0.05, omega, centred[0], 0.0, 0.0])
    bounds = ([-0.2, 0.6 * omega, -2.0, -2.0, -1.0], [0.9, 1.6 * omega, 2.0, 2.0, 1.0])
    found = least_squares(lambda x: model(x) - centred, np.clip(start, *bounds), bounds=bounds, x_scale="jac")
    damping_ratio, natural = float(found.x[0]), float(found.x[1])
    if damping_ratio > DAMPING_MAX:
        return None
    return Decay(2.0 * math.pi / (natural * math.sqrt(1.0 - damping_ratio**2)), damping_ratio)


def _decay_after(truth: Truth, step: Step, period_s: float) -> Decay | None:
    """Fit the decay along the direction in which the load swings most."""
    t = truth.t_boot_s
    free = (t >= step.t_last_s + DECAY_LEAD_PERIODS * period_s) & (t < step.t_end_s)
    towards = truth.towards_ne[:, free]
    if towards.shape[1] < 3:
        return None
    centred = towards - towards.mean(axis=1, keepdims=True)
    axis = np.linalg.svd(centred, full_matrices=False)[0][:, 0]
    return fit_decay(t[free], np.arcsin(np.clip(axis @ towards, -1.0, 1.0)), period_s)


def _askew(truth: Truth, step: Step, period_s: float) -> FloatArray:
    """Return the angle between the cable and where it hangs in the mean of a step's last two periods."""
    t = truth.t_boot_s
    north, east = truth.towards_ne
    cable = np.array([north, east, np.sqrt(np.clip(1.0 - north**2 - east**2, 0.0, 1.0))])
    hangs = cable[:, (t >= step.t_end_s - 2.0 * period_s) & (t < step.t_end_s)].mean(axis=1)
    angle: FloatArray = np.arccos(np.clip(hangs @ cable / np.linalg.norm(hangs), -1.0, 1.0))
    return angle


def _velocity_rmse(truth: Truth, step: Step, window: BoolArray) -> float:
    commanded = np.array(step.velocity)
    index = np.searchsorted(commanded[:, 0], truth.t_boot_s[window], side="right") - 1
    error = truth.vel_ned_mps[:2, window] - commanded[np.clip(index, 0, None), 1:3].T
    return float(np.sqrt((error * error).sum(axis=0).mean()))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values)))
