"""The two-axis potentiometer of section 4.2: what the experiment took for the true swing."""

from dataclasses import dataclass

import numpy as np

from swingd.core.level import level_from_frd
from swingd.core.slung_flight import FlightLog
from swingd.model.estimate import FloatArray
from swingd.studies.drones2023.flight import DT_S, Flight

RATE_HZ = 20.0
NOISE_RAD = np.radians(0.3)
"""Deviation of one reading of either axis; not printed in the paper."""
SMOOTHING_S = 0.25
"""Width of the window that the differentiated angle is smoothed with."""


@dataclass(frozen=True, slots=True)
class Readings:
    """Angles by the potentiometer, and their numerical derivatives."""

    t_s: FloatArray
    """(n,)"""
    angle_rad: FloatArray
    """(2, n) xi, zeta, heading frame."""
    rate_radps: FloatArray
    """(2, n) differences of the angles, smoothed without delay."""


def readings(flight: Flight, seed: int) -> Readings:
    """Read the cable's direction in the body at 20 Hz and correct it by the measured attitude.

    Parameters
    ----------
    flight : Flight
        Of any vehicle.
    seed : int
        Of the potentiometer's noise, >= 0.
    """
    every = round(1.0 / (RATE_HZ * DT_S * flight.scenario.control_every))
    t_s = flight.t_s[::every]
    xi, zeta = flight.column(FlightLog.SWING, 2)[::every].T
    level = np.array([np.sin(zeta), -np.sin(xi) * np.cos(zeta), np.cos(xi) * np.cos(zeta)])
    true, measured = (flight.column(first, 2)[::every].T for first in (FlightLog.EULER, FlightLog.EULER_MEASURED))
    body = np.einsum("nji,jn->in", _rotations(*true), level)
    noise = NOISE_RAD * np.random.default_rng(seed).standard_normal((2, t_s.size))
    about_x, about_y = np.arctan2(-body[1], body[2]) + noise[0], np.arcsin(body[0]) + noise[1]
    read = np.array([np.sin(about_y), -np.sin(about_x) * np.cos(about_y), np.cos(about_x) * np.cos(about_y)])
    level = np.einsum("nij,jn->in", _rotations(*measured), read)
    angle_rad = np.array([np.arctan2(-level[1], level[2]), np.arcsin(np.clip(level[0], -1.0, 1.0))])
    window = np.hanning(round(SMOOTHING_S * RATE_HZ) + 2)[1:-1]
    padded = np.pad(np.gradient(angle_rad, t_s, axis=1), ((0, 0), (window.size // 2,) * 2), mode="edge")
    rate = np.array([np.convolve(row, window / window.sum(), mode="valid")[: t_s.size] for row in padded])
    return Readings(t_s, angle_rad, rate)


def _rotations(roll: FloatArray, pitch: FloatArray) -> FloatArray:
    """Return the rotation from the body to the heading frame at each sample, (n, 3, 3)."""
    rotations = np.empty((roll.size, 3, 3))
    for rotation, roll_rad, pitch_rad in zip(rotations, roll, pitch, strict=True):
        level_from_frd(rotation, roll_rad, pitch_rad, 0.0)
    return rotations
