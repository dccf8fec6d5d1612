"""Pose of a shared load: two vehicles and four tethers, more of them, winch, degenerate cases, bad inputs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swingd.core.status import Status
from swingd.estimation.cooperative_pose import (
    CooperativePose,
    KnownAngles,
    TetherSight,
    WinchTable,
    printed_roll_rad,
    printed_yaw_rad,
)
from swingd.model.errors import ConfigurationError

L = 1.2
ENDS = ((0.0, -0.2, -0.1), (0.0, 0.2, -0.1))
"""Middle between the anchors of the left and of the right vehicle."""
CORNERS = ((0.1, -0.2, -0.1), (-0.1, -0.2, -0.1), (0.1, 0.2, -0.1), (-0.1, 0.2, -0.1))


def across(direction, std):
    return std**2 * (np.eye(3) - np.outer(direction, direction))


def sight(pos, R, anchor, lean, std=0.01, length_m=L):
    """A tether from the load's anchor up to a vehicle, leaning by a vector (level frame, x and y)."""
    direction = np.array([*lean, 1.0])
    direction /= np.linalg.norm(direction)
    hook = pos + R @ np.array(anchor) - length_m * direction
    return TetherSight(hook, direction, across(direction, std), length_m, 0.005, anchor)


def load(roll=0.0, pitch=0.0, yaw=0.0):
    return np.array([3.0, -2.0, -5.0]), Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()


def leans(yaw, outwards):
    """Towards the load from left and right when both lean outwards."""
    right = np.array([-math.sin(yaw), math.cos(yaw)])
    return outwards * right, -outwards * right


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, -2.5, math.pi])
@pytest.mark.parametrize("outwards", [0.0, 0.2, -0.2])
def test_two_vehicles_and_the_winch_s_pitch_tell_the_pose(yaw, outwards):
    """Vertical tethers, leaning apart, leaning together; at any heading."""
    pos, R = load(0.2, 0.15, yaw)
    sights = [sight(pos, R, anchor, lean) for anchor, lean in zip(ENDS, leans(yaw, outwards), strict=True)]
    solver = CooperativePose()
    solver.reset(yaw + 0.3)
    status, pose = solver.solve(sights, KnownAngles(pitch_rad=0.15, pitch_std_rad=0.01))
    assert status is Status.OK
    np.testing.assert_allclose(pose.pos_ned_m, pos, atol=1e-7)
    assert [pose.roll_rad, pose.pitch_rad] == pytest.approx([0.2, 0.15], abs=1e-7)
    assert math.remainder(pose.yaw_rad - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-7)
    assert pose.dof == 1
    assert np.linalg.eigvalsh(pose.cov).min() > 0.0


def test_two_points_alone_do_not_tell_the_turn_about_their_line():
    pos, R = load()
    sights = [sight(pos, R, anchor, lean) for anchor, lean in zip(ENDS, leans(0.0, 0.2), strict=True)]
    assert CooperativePose().solve(sights) == (Status.NOT_POSITIVE, None)
    # Nor do any number of them on one line.
    many = [sight(pos, R, (0.0, y, -0.1), (0.1, -y)) for y in (-0.2, -0.1, 0.1, 0.2)]
    assert CooperativePose().solve(many) == (Status.NOT_POSITIVE, None)


def test_four_tethers_from_two_vehicles_tell_everything():
    pos, R = load(0.1, -0.2, 0.4)
    hooks = [
        pos + R @ np.array(end) - 1.19 * np.array([*lean, 1.0]) for end, lean in zip(ENDS, leans(0.4, 0.2), strict=True)
    ]
    sights = []
    for k, anchor in enumerate(CORNERS):
        line = pos + R @ np.array(anchor) - hooks[k // 2]
        length_m = float(np.linalg.norm(line))
        sights.append(
            TetherSight(hooks[k // 2], line / length_m, across(line / length_m, 0.02), length_m, 0.005, anchor)
        )
    status, pose = CooperativePose().solve(sights)
    assert status is Status.OK
    np.testing.assert_allclose(pose.pos_ned_m, pos, atol=1e-7)
    np.testing.assert_allclose(pose.ned_from_frd, R, atol=1e-7)
    assert pose.dof == 6


def test_lengths_alone_and_directions_alone_count_for_what_they_tell():
    """Four lengths leave the swing and the sway free; two directions without lengths tell those."""
    pos, R = load(0.1, -0.1, 0.4)
    ends = [sight(pos, R, end, lean) for end, lean in zip(ENDS, leans(0.4, 0.2), strict=True)]
    directions = [replace(one, length_std_m=math.inf) for one in ends]
    lengths = []
    for k, anchor in enumerate(CORNERS):
        hook = ends[k // 2].hook_ned_m
        length_m = float(np.linalg.norm(pos + R @ np.array(anchor) - hook))
        lengths.append(TetherSight(hook, np.full(3, math.nan), None, length_m, 0.005, anchor))
    assert CooperativePose().solve(lengths) == (Status.NOT_POSITIVE, None)
    status, pose = CooperativePose().solve([*lengths, *directions])
    assert status is Status.OK
    np.testing.assert_allclose(pose.pos_ned_m, pos, atol=1e-6)
    np.testing.assert_allclose(pose.ned_from_frd, R, atol=1e-6)
    assert pose.dof == 2


@pytest.mark.parametrize("vehicles", [3, 5])
def test_any_number_of_vehicles_and_any_anchors(vehicles):
    rng = np.random.default_rng(vehicles)
    pos, R = load(-0.3, 0.2, 2.0)
    sights = [
        sight(pos, R, tuple(rng.normal(size=3) * 0.5), rng.normal(size=2) * 0.3, length_m=float(rng.uniform(1.0, 3.0)))
        for _ in range(vehicles)
    ]
    status, pose = CooperativePose().solve(sights)
    assert status is Status.OK
    np.testing.assert_allclose(pose.pos_ned_m, pos, atol=1e-7)
    np.testing.assert_allclose(pose.ned_from_frd, R, atol=1e-7)


def test_one_vehicle_does_not_tell_the_attitude():
    pos, R = load()
    assert CooperativePose().solve([sight(pos, R, ENDS[0], (0.1, 0.0))]) == (Status.NOT_POSITIVE, None)
    known = KnownAngles(roll_std_rad=0.1, pitch_std_rad=0.1, yaw_std_rad=0.1)
    status, pose = CooperativePose().solve([sight(pos, R, ENDS[0], (0.1, 0.0))], known)
    assert status is Status.OK
    np.testing.assert_allclose(pose.pos_ned_m, pos, atol=1e-6)


def test_a_worse_tether_weighs_less():
    pos, R = load()
    good = [sight(pos, R, anchor, (0.0, 0.0), std=0.005) for anchor in CORNERS[:3]]
    bad = sight(pos, R, CORNERS[3], (0.1, 0.0), std=0.5)
    wrong = TetherSight(good[0].hook_ned_m + bad.hook_ned_m - good[0].hook_ned_m, np.array([0.0, 0.0, 1.0]),
                        across(np.array([0.0, 0.0, 1.0]), 0.5), L, 0.5, CORNERS[3])  # fmt: skip
    _, pose = CooperativePose().solve([*good, wrong])
    assert np.linalg.norm(pose.pos_ned_m - pos) < 0.005


def test_the_covariance_is_that_of_many_draws():
    pos, R = load(0.1, 0.05, 0.3)
    rng, solver = np.random.default_rng(1), CooperativePose()
    exact = [sight(pos, R, anchor, lean, std=0.02) for anchor, lean in zip(ENDS, leans(0.3, 0.25), strict=True)]
    nees = []
    for _ in range(400):
        noisy = []
        for one in exact:
            seen = one.direction_ned + np.linalg.cholesky(one.direction_cov + 1e-15 * np.eye(3)) @ rng.normal(size=3)
            seen /= np.linalg.norm(seen)
            length_m = one.length_m + one.length_std_m * rng.normal()
            noisy.append(
                TetherSight(one.hook_ned_m, seen, across(seen, 0.02), length_m, one.length_std_m, one.anchor_frd_m)
            )
        known = KnownAngles(pitch_rad=0.05 + 0.01 * rng.normal(), pitch_std_rad=0.01)
        status, pose = solver.solve(noisy, known)
        assert status is Status.OK
        error = np.array([pose.roll_rad - 0.1, pose.pitch_rad - 0.05, pose.yaw_rad - 0.3, *(pose.pos_ned_m - pos)])
        nees.append(error @ np.linalg.solve(pose.cov, error))
    assert np.mean(nees) == pytest.approx(6.0, abs=4.0 * math.sqrt(12.0 / 400.0))


@pytest.mark.parametrize(
    "change",
    [
        {"hook_ned_m": np.array([math.nan, 0.0, 0.0])},
        {"hook_ned_m": np.array([1e8, 0.0, 0.0])},
        {"direction_ned": np.array([0.0, 0.0, 2.0])},
        {"direction_cov": np.full((3, 3), math.inf)},
        {"length_m": 0.0},
        {"length_std_m": -1.0},
        {"length_std_m": math.nan},
        {"anchor_frd_m": (math.inf, 0.0, 0.0)},
    ],
)
def test_bad_inputs_are_answered(change):
    pos, R = load()
    sights = [sight(pos, R, anchor, (0.0, 0.1)) for anchor in CORNERS]
    assert CooperativePose().solve([*sights[:3], replace(sights[3], **change)]) == (Status.INPUT_INVALID, None)
    assert CooperativePose().solve(sights, KnownAngles(pitch_rad=math.nan)) == (Status.INPUT_INVALID, None)
    assert CooperativePose().solve(sights, KnownAngles(pitch_std_rad=0.0)) == (Status.INPUT_INVALID, None)
    assert CooperativePose().solve([]) == (Status.INPUT_INVALID, None)


def test_the_printed_roll_holds_at_yaw_0_only():
    for yaw, holds in ((0.0, True), (0.5 * math.pi, False)):
        pos, R = load(0.2, 0.0, yaw)
        anchors = np.array([pos + R @ np.array(end) for end in ENDS])
        assert (abs(printed_roll_rad(anchors) - 0.2) < 1e-9) is holds


def test_the_printed_yaw_is_lost_where_tethers_pull_outwards():
    """phi_b + psi of tethers that lean to the same side is their heading; of opposite ones a hair decides."""
    assert printed_yaw_rad([0.3 + 0.01, 0.3 - 0.01]) == pytest.approx(0.3)
    a, b = printed_yaw_rad([0.0 + 1e-3, math.pi]), printed_yaw_rad([0.0 - 1e-3, math.pi])
    assert abs(math.remainder(a - b, 2.0 * math.pi)) > 3.0


def test_the_winch_table_interpolates_and_refuses_what_was_not_calibrated():
    table = WinchTable([-0.1, 0.0, 0.05, 0.1], [-0.2, 0.0, 0.09, 0.2])
    assert table.pitch_rad(1.2, 1.2) == (Status.OK, 0.0)
    status, pitch = table.pitch_rad(1.175, 1.2)
    assert status is Status.OK
    assert pitch == pytest.approx(0.045)
    assert table.pitch_rad(1.1, 1.3) == (Status.INPUT_INVALID, 0.0)
    assert table.pitch_rad(math.nan, 1.2) == (Status.INPUT_INVALID, 0.0)
    falling = WinchTable([-0.1, 0.1], [0.2, -0.2])
    assert falling.pitch_rad(1.2, 1.25)[1] == pytest.approx(-0.1)


@pytest.mark.parametrize(
    ("differences", "pitches", "said"),
    [
        ([0.0], [0.0], "1 lengths and 1 pitches; expected as many, 2 or more"),
        ([0.0, 0.1], [0.0], "2 lengths and 1 pitches"),
        ([0.0, 0.1, 0.1], [0.0, 0.1, 0.2], "row 3: 0.1 m, 0.2 rad; expected more than the 0.1 m before"),
        ([0.0, 0.1, 0.2], [0.0, 0.1, 0.05], "row 3: 0.2 m, 0.05 rad; expected pitches that only rise or only fall"),
        ([0.0, math.nan], [0.0, 0.1], "row 2: nan m, 0.1 rad; expected finite numbers"),
    ],
)
def test_a_winch_table_that_is_none_is_refused(differences, pitches, said):
    with pytest.raises(ConfigurationError, match=said):
        WinchTable(differences, pitches)
