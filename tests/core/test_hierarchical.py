"""The hierarchical law: exact linearisation, thrust and pitch, bounds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swingd.core.hierarchical import axis_force, thrust_and_pitch
from swingd.core.status import Status

TILT_MAX_RAD, UP_MIN_N = math.radians(60.0), 1.0


def test_with_the_disturbance_known_the_error_obeys_its_gains():
    """(55): chi'' = (U + rho) / a - G leaves e'' = -kd e' - kp e, whatever a, G and rho are."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        pos, vel, pos_sp, vel_sp, acc_sp, offset, rho = rng.normal(size=7) * 3.0
        inertia, kp, kd = rng.uniform(0.1, 5.0, size=3)
        force = axis_force(pos, vel, pos_sp, vel_sp, acc_sp, np.array([kp, kd]), inertia, offset) - rho
        acc = (force + rho) / inertia - offset
        assert acc - acc_sp == pytest.approx(-kd * (vel - vel_sp) - kp * (pos - pos_sp), abs=1e-9)


def test_signs_in_words():
    """Behind the wanted place: push forward. Too fast: push back. A weight is carried."""
    gains = np.array([1.0, 2.0])
    assert axis_force(0.0, 0.0, 1.0, 0.0, 0.0, gains, 0.5, 0.0) > 0.0
    assert axis_force(0.0, 1.0, 0.0, 0.0, 0.0, gains, 0.5, 0.0) < 0.0
    assert axis_force(0.0, 0.0, 0.0, 0.0, 0.0, gains, 0.5, 9.8) == pytest.approx(4.9)
    out = np.empty(2)
    thrust_and_pitch(out, 1.0, 5.0, UP_MIN_N, TILT_MAX_RAD)
    assert out[1] > 0.0


@given(u_x=st.floats(-50.0, 50.0), u_z=st.floats(-50.0, 50.0))
@settings(max_examples=200)
def test_thrust_points_where_it_is_asked_to_within_its_bounds(u_x, u_z):
    out = np.empty(2)
    status = Status(thrust_and_pitch(out, u_x, u_z, UP_MIN_N, TILT_MAX_RAD))
    given_x, given_z = out[0] * math.sin(out[1]), out[0] * math.cos(out[1])
    assert abs(out[1]) <= TILT_MAX_RAD + 1e-12
    assert given_z >= UP_MIN_N - 1e-12
    # Height comes first; what is left of the sideways force has its sign.
    assert given_z == pytest.approx(max(u_z, UP_MIN_N), abs=1e-9)
    assert given_x * u_x >= 0.0
    inside = u_z >= UP_MIN_N and abs(u_x) <= u_z * math.tan(TILT_MAX_RAD)
    assert status is (Status.OK if inside else Status.GATED)
    if inside:
        assert given_x == pytest.approx(u_x, abs=1e-9)
