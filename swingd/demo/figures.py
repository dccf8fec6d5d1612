"""What the two flights of the demonstration show, in figures."""

import math
from dataclasses import dataclass

import numpy as np

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.demo.flight import Flight
from swingd.model.estimate import FloatArray
from swingd.model.parameters import Parameters

RMS_WINDOW_S = 12.0
SETTLED_RAD = math.radians(2.0)
SETTLED_FOR_S = 1.0
ESTIMATE_LEAD_S = 10.0
"""The estimate is judged from this long before the first step."""
STALL_MS = 100.0
"""Setpoints come every 20 ms; who waits this long for one waits for the machine."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Swing and velocity after the steps; without (off) and with (on) the correction."""

    period_s: float
    """Of the load under a fixed hook, 2 pi sqrt(L / g)."""
    peak_deg_off: float
    """Largest true total swing after a step."""
    peak_deg_on: float
    rms_deg_off: float
    """True total swing over the 12 s after each step."""
    rms_deg_on: float
    rms_ratio: float
    settle_2deg_s_off: float
    """From a step's command until the true total swing stays under 2 deg up to the next step; the longest."""
    settle_2deg_s_on: float
    settled_off: bool
    """Whether it stayed under 2 deg for a second at least; else the time is only what was watched."""
    settled_on: bool
    settle_periods_off: float
    settle_periods_on: float
    angle_rmse_deg: float
    """Published against true angles, both axes and both flights together."""
    rate_rmse_deg_s: float
    velocity_rmse_mps_off: float
    """True against commanded horizontal velocity over the 12 s after each step."""
    velocity_rmse_mps_on: float
    velocity_ratio: float
    filter_hz: float
    """Of the flight with correction, as the following."""
    latency_ms_p50: float | None
    """IMU frame received to setpoint sent."""
    latency_ms_p99: float | None
    cpu_percent: float
    """Of one core, the daemon's whole process."""
    setpoint_gap_ms: float
    """Longest wait of the simulated autopilot for a setpoint during the steps of either flight."""

    @property
    def stalled(self) -> bool:
        """Whether this machine stood still during a flight, so that the figures are not swingd's."""
        return self.setpoint_gap_ms > STALL_MS


def figures(parameters: Parameters, off: Flight, on: Flight) -> Figures:
    """Judge both flights."""
    period_s = 2.0 * math.pi * math.sqrt(parameters.cable.length_m / GRAVITY_MPS2)
    angle_errors, rate_errors = (np.concatenate(parts, axis=1) for parts in zip(_errors(off), _errors(on), strict=True))
    rms_off, rms_on = math.degrees(_rms(_after_steps(off)[0])), math.degrees(_rms(_after_steps(on)[0]))
    velocity_off, velocity_on = _velocity_rmse(off), _velocity_rmse(on)
    settle_off, settle_on = _settle_s(off), _settle_s(on)
    return Figures(
        period_s=period_s,
        peak_deg_off=math.degrees(_after_steps(off)[0].max()),
        peak_deg_on=math.degrees(_after_steps(on)[0].max()),
        rms_deg_off=rms_off,
        rms_deg_on=rms_on,
        rms_ratio=rms_on / rms_off,
        settle_2deg_s_off=settle_off,
        settle_2deg_s_on=settle_on,
        settled_off=_settled(off),
        settled_on=_settled(on),
        settle_periods_off=settle_off / period_s,
        settle_periods_on=settle_on / period_s,
        angle_rmse_deg=math.degrees(_rms(angle_errors)),
        rate_rmse_deg_s=math.degrees(_rms(rate_errors)),
        velocity_rmse_mps_off=velocity_off,
        velocity_rmse_mps_on=velocity_on,
        velocity_ratio=velocity_on / velocity_off,
        filter_hz=on.daemon["filter_hz"] or 0.0,
        latency_ms_p50=on.daemon["latency_ms_p50"],
        latency_ms_p99=on.daemon["latency_ms_p99"],
        cpu_percent=on.daemon["cpu_percent"] or 0.0,
        setpoint_gap_ms=1e3 * max(off.setpoint_gap_s, on.setpoint_gap_s),
    )


def _after_steps(flight: Flight) -> tuple[FloatArray, FloatArray]:
    """Total swing (n,) and velocity error (2, n) over the windows after the steps."""
    swing, error = [], []
    for step in flight.steps:
        window = (flight.t_boot_s >= step.t_boot_s) & (flight.t_boot_s < step.t_boot_s + RMS_WINDOW_S)
        swing.append(flight.chi_rad[window])
        error.append(flight.vel_ned_mps[:2, window] - np.array(step.vel_ned_mps[:2])[:, np.newaxis])
    return np.concatenate(swing), np.concatenate(error, axis=1)


def _velocity_rmse(flight: Flight) -> float:
    error = _after_steps(flight)[1]
    return float(np.sqrt((error * error).sum(axis=0).mean()))


def _settle_s(flight: Flight) -> float:
    longest = 0.0
    for step, end_s in zip(flight.steps, flight.step_ends_s, strict=True):
        window = (flight.t_boot_s >= step.t_boot_s) & (flight.t_boot_s < end_s)
        above = np.flatnonzero(flight.chi_rad[window] > SETTLED_RAD)
        if above.size:
            longest = max(longest, float(flight.t_boot_s[window][above[-1]]) - step.t_boot_s)
    return longest


def _settled(flight: Flight) -> bool:
    return all(
        flight.chi_rad[(flight.t_boot_s > end_s - SETTLED_FOR_S) & (flight.t_boot_s < end_s)].max() <= SETTLED_RAD
        for end_s in flight.step_ends_s
    )


def _errors(flight: Flight) -> tuple[FloatArray, FloatArray]:
    """Published minus true angles and rates (2, m), from shortly before the first step on."""
    used = flight.estimate_t_s >= flight.steps[0].t_boot_s - ESTIMATE_LEAD_S
    t = flight.estimate_t_s[used]
    angles, rates = (
        np.array([np.interp(t, flight.t_boot_s, row) for row in rows])
        for rows in (flight.angles_rad, flight.rates_radps)
    )
    return flight.estimate_rad[:, used] - angles, flight.estimate_rates_radps[:, used] - rates


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values)))
