"""The path follower as an object: the kernel's answers, bad paths, bad inputs, progress."""

import math

import numpy as np
import pytest

from swingd.control.path_following import PathFollower, PathSettings, PathTerm
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.status import Status
from swingd.model.errors import ConfigurationError

SETTINGS = PathSettings(1.52, 0.5, 1.6)
PATH = ((0.0, 0.0, -10.0), (10.0, 0.0, -10.0), (10.0, 5.0, -10.0))
HOVER = np.array([0.0, 0.0, -2.02 * GRAVITY_MPS2])
WEIGHTLESS = np.array([0.0, 0.0, -GRAVITY_MPS2])


def at(north, east=0.0, speed=0.0):
    x = np.zeros(10)
    x[:3] = north, east, -10.0
    x[5] = speed
    return x


def begun():
    follower = PathFollower(SETTINGS, PATH)
    assert follower.begin(at(0.0)) is Status.OK
    return follower


def test_at_cruise_on_the_path_it_asks_for_hovering():
    follower = PathFollower(SETTINGS, PATH)
    assert follower.begin(at(2.0, speed=2.0)) is Status.OK
    assert follower.update(at(2.0, speed=2.0), HOVER, WEIGHTLESS * 2.02 / 1.52, 0.0) is Status.OK
    np.testing.assert_allclose(follower.thrust_ned_n, HOVER, atol=1e-9)
    np.testing.assert_allclose(follower.acceleration_ned_mps2, 0.0, atol=1e-9)
    np.testing.assert_allclose(follower.attitude(0.0), np.eye(3), atol=1e-12)


def test_in_words_a_load_at_rest_is_pulled_forward_and_one_beside_the_path_back():
    follower = begun()
    assert follower.update(at(0.0), HOVER, WEIGHTLESS, 0.0) is Status.OK
    assert follower.acceleration_ned_mps2[0] > 0.5
    assert follower.attitude(0.0)[0, 2] < -0.05  # nose down: the thrust axis leans north
    assert follower.update(at(0.0, east=1.0), HOVER, WEIGHTLESS, 0.01) is Status.OK
    assert follower.acceleration_ned_mps2[1] < -0.2
    assert follower.term(PathTerm.E_P).tolist() == pytest.approx([0.0, 1.0, 0.0])
    assert follower.term(PathTerm.MU).shape == (2,)
    assert follower.term(PathTerm.ENERGY).shape == (1,)


def test_progress_along_the_legs():
    follower = begun()
    for x, leg, remaining in ((at(0.0), 0, 15.0), (at(4.0), 0, 11.0), (at(9.0), 1, 5.0), (at(10.0, 3.0), 1, 2.0)):
        assert follower.update(x, HOVER, WEIGHTLESS, 0.01) is Status.OK
        assert (follower.leg, follower.holding) == (leg, False)
        assert follower.remaining_m == pytest.approx(remaining)
    assert follower.update(at(10.0, 4.5), HOVER, WEIGHTLESS, 0.01) is Status.OK
    assert (follower.leg, follower.holding, follower.remaining_m) == (2, True, 0.0)


def test_another_path_begins_with_the_disturbances_that_are_known():
    """GIVEN a thrust that is believed a tenth too small WHEN another path begins THEN the load is not let fall."""
    follower = begun()
    for _ in range(1000):
        assert follower.update(at(0.0), 0.9 * HOVER, WEIGHTLESS * 2.02 / 1.52, 0.01) is Status.OK
    known = follower.term(PathTerm.D_T)
    assert known[2] == pytest.approx(0.1 * HOVER[2], rel=0.01)
    other, unaware = PathFollower(SETTINGS, PATH[:2]), PathFollower(SETTINGS, PATH[:2])
    assert other.begin(at(0.0), follower) is unaware.begin(at(0.0)) is Status.OK
    for follows, expected in ((other, known[2]), (unaware, 0.0)):
        assert follows.update(at(0.0), 0.9 * HOVER, WEIGHTLESS * 2.02 / 1.52, 0.0) is Status.OK
        assert follows.term(PathTerm.D_T)[2] == pytest.approx(expected, rel=0.01, abs=1e-9)


def test_one_waypoint_is_a_place_to_hold():
    follower = PathFollower(SETTINGS, PATH[:1])
    assert follower.begin(at(3.0)) is Status.OK
    assert follower.update(at(3.0), HOVER, WEIGHTLESS, 0.0) is Status.OK
    assert follower.holding
    assert follower.acceleration_ned_mps2[0] < 0.0


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ((), "no waypoint"),
        (((0.0, 0.0, math.nan),), "waypoint 1: .* expected north, east, down"),
        (((0.0, 0.0, 0.0), (0.0, 1e6, 0.0)), "waypoint 2"),
        (((0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (5.0, 0.0, 0.001)), "waypoint 3 is 0.001 m from the one before"),
    ],
)
def test_bad_paths_are_refused(path, message):
    with pytest.raises(ConfigurationError, match=message):
        PathFollower(SETTINGS, path)


@pytest.mark.parametrize(
    ("x", "thrust", "dt_s", "status"),
    [
        (np.full(10, np.nan), HOVER, 0.01, Status.INPUT_INVALID),
        (np.zeros(9), HOVER, 0.01, Status.INPUT_INVALID),
        (np.zeros(10), np.array([0.0, np.inf, 0.0]), 0.01, Status.INPUT_INVALID),
        (np.zeros(10), HOVER, -0.01, Status.INPUT_INVALID),
        (np.zeros(10), HOVER, math.nan, Status.INPUT_INVALID),
        (np.array([0.0, 0.0, 0.0, 1.59, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), HOVER, 0.01, Status.NOT_CONVERGED),
    ],
)
def test_bad_inputs_are_refused_and_the_last_answer_stands(x, thrust, dt_s, status):
    follower = begun()
    assert follower.update(at(1.0), HOVER, WEIGHTLESS, 0.0) is Status.OK
    before = follower.thrust_ned_n
    assert follower.update(x, thrust, WEIGHTLESS, dt_s) is status
    np.testing.assert_array_equal(follower.thrust_ned_n, before)


def test_nothing_is_asked_for_before_the_start():
    follower = PathFollower(SETTINGS, PATH)
    assert follower.update(at(0.0), HOVER, WEIGHTLESS, 0.0) is Status.INPUT_INVALID
    assert follower.begin(np.full(10, np.nan)) is Status.INPUT_INVALID
