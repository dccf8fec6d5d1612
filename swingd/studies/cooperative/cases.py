"""The flights of the paper: attitude manoeuvre (4.1), position manoeuvre (4.2), experiment (5).

What the paper does not print, the size and pace of the manoeuvres, the lean of the tethers, the air's push on the
load, was chosen together with the noise so that the paper's filter, its errors put right, reproduces Table 3 in the
mean of the seeds 1 to 3; then frozen. Ours was tuned on the same seeds. Figures to judge by come from others.
"""

from dataclasses import replace
from math import cos, inf, radians, sin

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.model.estimate import FloatArray
from swingd.studies.cooperative import vehicles as v
from swingd.studies.cooperative.estimate import FORCE_STD_MIN_N, Tuning
from swingd.studies.cooperative.flight import SAMPLE_S, Course, Scenario, smooth
from swingd.studies.cooperative.measure import Noise
from swingd.studies.cooperative.paper_filter import AngleNoise

HEIGHT_M = 1.0
ATTITUDE_FROM_S = (3.0, 15.0, 27.0)
"""When roll, pitch and yaw begin."""
HOLD_S = 4.0
"""From one change to the next."""


def attitudes(roll_deg: float, pitch_deg: float, yaw_deg: float, roll_s: float, rest_s: float) -> Course:
    """Turn the load about one axis after the other: there, to the other side, and back; at rest in position."""

    def course(t_s: FloatArray) -> FloatArray:
        wanted = np.zeros((t_s.size, 6))
        wanted[:, 2] = -HEIGHT_M
        turns = ((roll_deg, roll_s), (pitch_deg, rest_s), (yaw_deg, rest_s))
        for column, (begin_s, (angle_deg, rise_s)) in enumerate(zip(ATTITUDE_FROM_S, turns, strict=True), start=3):
            there = smooth(t_s, begin_s, rise_s)
            across = smooth(t_s, begin_s + HOLD_S, rise_s)
            back = smooth(t_s, begin_s + 2.0 * HOLD_S, rise_s)
            wanted[:, column] = radians(angle_deg) * (there - 2.0 * across + back)
        return wanted

    return course


def _positions(t_s: FloatArray) -> FloatArray:
    """Forward, right and up, one after the other, there and back."""
    wanted = np.zeros((t_s.size, 6))
    wanted[:, 2] = -HEIGHT_M
    for column, begin_s, way_m in ((0, 3.0, 1.0), (1, 18.0, 1.0), (2, 33.0, -0.6)):
        wanted[:, column] += way_m * (smooth(t_s, begin_s, 4.0) - smooth(t_s, begin_s + 7.0, 4.0))
    return wanted


ATTITUDE = Scenario("attitude", "attitude manoeuvre", attitudes(10.0, 10.0, 15.0, 2.0, 2.0), 40.0)
POSITION = Scenario("position", "position manoeuvre", _positions, 48.0)
EXPERIMENT = Scenario(
    "experiment",
    "experiment",
    attitudes(23.4, 20.2, 14.8, 1.4, 2.0),
    40.0,
    lean_rad=radians(20.35),
    gust_force_n=0.029,
    pos_std_m=0.001,
    vel_std_mps=0.01,
)

QUIET = Noise()
NOISE = Noise(
    acc_mps2=0.125,
    thrust_n=0.1,
    thrust_scale=1.048,
    pos_m=0.001,
    attitude_rad=0.0005,
    winch_m=0.0002,
)
"""Of the experiment."""

VIBRATION = replace(NOISE, vibration_mps2=2.0)
"""The same with rotors out of balance: high-frequency noise of the inputs, which the paper names as its limit."""

TUNING = Tuning()
UNFILTERED = Tuning(low_pass_hz=inf)
_TENSION_N = 0.5 * v.LOAD_MASS_KG * GRAVITY_MPS2 / cos(EXPERIMENT.lean_rad)
_DIRECTION_VAR = ((v.MASS_KG * NOISE.acc_mps2) ** 2 + FORCE_STD_MIN_N**2) / _TENSION_N**2
_SIGMA = TUNING.acc_density / SAMPLE_S**0.5
RETUNED = AngleNoise(
    _SIGMA, _SIGMA / sin(EXPERIMENT.lean_rad), _DIRECTION_VAR, _DIRECTION_VAR / sin(EXPERIMENT.lean_rad) ** 2
)
"""The paper's filter with the noises that ours has: how much of the difference is nothing but sigma and R."""
STEPS = {
    "on the sphere": Tuning(low_pass_hz=inf, anchor_geometry=False),
    "filtered": Tuning(anchor_geometry=False),
    "all, as a pendulum": Tuning(length_m=1.3),
}
"""Between the paper's filter and ours: the neglected terms, filtered inputs; ours adds the anchors' geometry. The last
one takes the load for a pendulum that the other vehicle holds aside instead of (13)."""
