"""The flights of the paper: attitude manoeuvre (4.1), position manoeuvre (4.2), experiment (5)."""

from math import radians

import numpy as np

from swingd.model.estimate import FloatArray
from swingd.studies.cooperative.flight import Scenario, smooth


def _attitude(t_s: FloatArray) -> FloatArray:
    """Roll, pitch and yaw, one after the other, there and back."""
    course = np.zeros((t_s.size, 6))
    course[:, 2] = -1.0
    for column, begin_s, angle_rad in ((3, 3.0, radians(10.0)), (4, 15.0, radians(10.0)), (5, 27.0, radians(15.0))):
        course[:, column] = angle_rad * (
            smooth(t_s, begin_s, 2.0) - 2.0 * smooth(t_s, begin_s + 4.0, 2.0) + smooth(t_s, begin_s + 8.0, 2.0)
        )
    return course


def _position(t_s: FloatArray) -> FloatArray:
    """Forward, right and up, one after the other, there and back."""
    course = np.zeros((t_s.size, 6))
    course[:, 2] = -1.0
    for column, begin_s, way_m in ((0, 3.0, 1.0), (1, 15.0, 1.0), (2, 27.0, -0.6)):
        course[:, column] += way_m * (smooth(t_s, begin_s, 3.0) - smooth(t_s, begin_s + 6.0, 3.0))
    return course


ATTITUDE = Scenario("attitude", "attitude manoeuvre", _attitude, 40.0)
POSITION = Scenario("position", "position manoeuvre", _position, 40.0)
