"""The load's pose from the vehicles' measurements, offline: the paper's way, its sign errors put right, and ours."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, hypot, inf, radians

import numpy as np

from swingd.core.status import Status
from swingd.core.tether_angles import TetherModel
from swingd.estimation.cooperative_pose import CooperativePose, KnownAngles, TetherSight, WinchTable
from swingd.estimation.input_filter import MatchedFilter
from swingd.estimation.tether_direction import TetherDirection
from swingd.model.errors import StudyError
from swingd.model.estimate import FloatArray
from swingd.studies.cooperative import vehicles as v
from swingd.studies.cooperative.flight import SAMPLE_S, rotations
from swingd.studies.cooperative.measure import Carrier, Noise
from swingd.studies.cooperative.paper_filter import AngleNoise, track

CALIBRATED_DEG = np.linspace(-25.0, 25.0, 11)
"""Pitches at which the winch was calibrated."""
FORCE_STD_MIN_N = 0.05
NOMINAL_M = v.triangle(v.TETHER_M, v.TETHER_M).middle_m


@dataclass(frozen=True, slots=True)
class Track:
    """The load's pose and the tethers' angles over a flight."""

    euler_rad: FloatArray
    """(n, 3) roll, pitch, yaw."""
    pos_ned_m: FloatArray
    """(n, 3) CG."""
    directions: FloatArray
    """(2, n, 3) from each vehicle's winch to the middle between its anchors, its heading frame."""
    std: FloatArray | None = None
    """(n, 6) deviations that the estimator claims, attitude and position; None where it claims none."""
    missing: int = 0
    """Samples without a pose, for which the last one stands."""


@dataclass(frozen=True, slots=True)
class Tuning:
    """Of our estimator."""

    low_pass_hz: float = 8.0
    """Of the inputs; infinite: not filtered."""
    acc_density: float = 0.2
    """Of the noise acceleration across a tether [rad/s/sqrt(s)]."""
    length_m: float = inf
    """Of the pendulum as which the load swings, held aside by the other vehicle; infinite: random acceleration (13)."""
    pull_density: float = 3.0
    """Of the other vehicle's pull on such a pendulum [m/s^2/sqrt(s)]."""
    length_std_m: float = 0.004
    swing_std_rad: float = 0.03
    """Of the swing that the winch's pitch (25) does not know."""
    anchor_geometry: bool = True
    """False: anchors in the middle of the edge, and the pose of (22)-(25)."""


def winch_table(lean_rad: float) -> WinchTable:
    """Calibrate (25) where the vehicles hover as they will fly: pitch at rest over rear less front tether."""
    winches = [v.winch_for(radians(pitch), lean_rad) for pitch in CALIBRATED_DEG]
    return WinchTable([2.0 * winch for winch in winches], [radians(pitch) for pitch in CALIBRATED_DEG])


def paper_track(
    carriers: Sequence[Carrier],
    noise: AngleNoise,
    table: WinchTable,
    model: TetherModel = TetherModel.RANDOM,
    rotating: bool = False,
) -> Track:
    """Estimate as the paper does: (12)-(25), yaw and roll from the vector between the anchors in the load's heading.

    Parameters
    ----------
    carriers : 2 vehicles
        Left of the load, right of it.
    noise : AngleNoise
        Table 1 or 2.
    table : WinchTable
    model, rotating
        See `swingd.core.tether_angles.angle_rates`.
    """
    directions = np.array(
        [
            track(
                c.thrust_n, c.acc_mps2, c.cable_n, c.yaw_rad, noise, model, rotating, NOMINAL_M, v.MASS_KG, SAMPLE_S
            ).direction
            for c in carriers
        ]
    )
    return _pose_of_two(carriers, directions, table)


def our_track(carriers: Sequence[Carrier], noise: Noise, table: WinchTable, tuning: Tuning = Tuning()) -> Track:
    """Estimate with filtered inputs, on the sphere, by least squares over the anchors.

    Parameters
    ----------
    carriers : 2 vehicles
    noise : Noise
        What the filters are told of it.
    table : WinchTable
    tuning : Tuning
    """
    samples = carriers[0].yaw_rad.size
    # White noise of a sample: the low-pass keeps its density for slow signals, and that is what counts.
    force_var = (v.MASS_KG * noise.acc_mps2) ** 2 + FORCE_STD_MIN_N**2
    force_cov = np.diag([force_var, force_var, force_var + noise.thrust_n**2])
    directions, covs = np.empty((v.CARRIERS, samples, 3)), np.empty((v.CARRIERS, samples, 3, 3))
    for index, carrier in enumerate(carriers):
        tether = TetherDirection(tuning.length_m, tuning.acc_density, 0.2, 0.2, tuning.pull_density, 0.5)
        matched = MatchedFilter(1.0 / SAMPLE_S, tuning.low_pass_hz)
        # The azimuth of a load that turns with its vehicles stays in their heading frame.
        weight_free = -v.MASS_KG * 9.80665 * np.array([0.0, 0.0, 1.0])
        for row in range(samples):
            _, thrust_n, acc = matched.step(carrier.thrust_n[row], carrier.acc_mps2[row], SAMPLE_S)
            force_n = v.MASS_KG * acc + weight_free - thrust_n
            if row == 0:
                tether.reset(force_n)
            status = tether.predict(acc, SAMPLE_S)
            if status is Status.OK:
                status = tether.correct(force_n, force_cov)
            if status is not Status.OK:
                raise StudyError(f"the filter on the sphere failed in sample {row}: {status.name}; expected OK")
            now = tether.ahead(matched.delay_s)
            directions[index, row], covs[index, row] = now.direction, now.direction_cov
    if not tuning.anchor_geometry:
        return _pose_of_two(carriers, directions, table)
    return _pose_by_least_squares(carriers, directions, covs, table, tuning)


def _pose_of_two(carriers: Sequence[Carrier], directions: FloatArray, table: WinchTable) -> Track:
    """(22)-(25) from directions (2, n, 3) in the vehicles' heading frames."""
    anchors = np.array(
        [
            c.hook_ned_m
            + np.array([v.triangle(v.TETHER_M - w, v.TETHER_M + w).middle_m for w in c.winch_m.tolist()])[:, None]
            * np.einsum("nij,nj->ni", _heading(c), direction)
            for c, direction in zip(carriers, directions, strict=True)
        ]
    )
    left, right = anchors
    across = right - left
    euler = np.column_stack(
        [
            np.arctan2(across[:, 2], np.hypot(across[:, 0], across[:, 1])),
            [winch_pitch(carriers, row, table) for row in range(left.shape[0])],
            np.arctan2(-across[:, 0], across[:, 1]),
        ]
    )
    # The middle between the anchors is above the load's CG.
    return Track(euler, 0.5 * (left + right) + rotations(euler) @ np.array([0.0, 0.0, v.ANCHOR_UP_M]), directions)


def winch_pitch(carriers: Sequence[Carrier], row: int, table: WinchTable) -> float:
    """(25) of both winches' mean."""
    winch_m = sum(float(c.winch_m[row]) for c in carriers) / len(carriers)
    status, pitch_rad = table.pitch_rad(v.TETHER_M - winch_m, v.TETHER_M + winch_m)
    if status is not Status.OK:
        raise StudyError(f"winch at {winch_m:g} m in sample {row}; expected within the calibrated table")
    return pitch_rad


def _pose_by_least_squares(
    carriers: Sequence[Carrier], directions: FloatArray, covs: FloatArray, table: WinchTable, tuning: Tuning
) -> Track:
    """Pose that fits the lengths of all four tethers and where each vehicle's cable force really points.

    Four lengths leave two of six free: the swing about the line between the vehicles, with which the load pitches, and
    the sway across the heading, with which it rolls. The forces' directions tell those, and the winch the pitch of a
    load that does not swing.
    """
    samples = directions.shape[1]
    euler, pos, std = np.empty((samples, 3)), np.empty((samples, 3)), np.empty((samples, 6))
    middles = np.empty_like(directions)
    headings = [_heading(c) for c in carriers]
    missing, below = 0, np.array([0.0, 0.0, NOMINAL_M + v.ANCHOR_UP_M])
    last = np.zeros(3), np.mean([c.hook_ned_m[0] for c in carriers], axis=0) + below, np.full(6, inf)
    solver = CooperativePose()
    solver.reset(float(np.mean([c.yaw_rad[0] for c in carriers])))
    for row in range(samples):
        sights = []
        for c, carrier in enumerate(carriers):
            winch_m, hook = float(carrier.winch_m[row]), carrier.hook_ned_m[row]
            front_m, rear_m = v.TETHER_M - winch_m, v.TETHER_M + winch_m
            shape = v.triangle(front_m, rear_m)
            direction = headings[c][row] @ directions[c, row]
            cov = headings[c][row] @ covs[c, row] @ headings[c][row].T
            under_m = shape.under(atan2(abs(directions[c, row, 1]), directions[c, row, 2]))
            length_m = hypot(shape.ahead_m - under_m, shape.height_m)
            side_m = v.SIDES[c] * v.HALF_SPAN_M
            sights.append(TetherSight(hook, direction, cov, length_m, inf, (under_m, side_m, -v.ANCHOR_UP_M)))
            for ahead_m, tether_m in ((0.5 * v.EDGE_M, front_m), (-0.5 * v.EDGE_M, rear_m)):
                anchor = (ahead_m, side_m, -v.ANCHOR_UP_M)
                sights.append(TetherSight(hook, direction, None, tether_m, tuning.length_std_m, anchor))
        known = KnownAngles(pitch_rad=winch_pitch(carriers, row, table), pitch_std_rad=tuning.swing_std_rad)
        _, pose = solver.solve(sights, known)
        if pose is None:
            missing += 1
            euler[row], pos[row], std[row] = last
            middles[:, row] = directions[:, row]
            continue
        euler[row] = pose.roll_rad, pose.pitch_rad, pose.yaw_rad
        pos[row], std[row] = pose.pos_ned_m, np.sqrt(np.diag(pose.cov))
        last = euler[row], pos[row], std[row]
        for c, carrier in enumerate(carriers):
            middle = pose.pos_ned_m + pose.ned_from_frd @ np.array([0.0, v.SIDES[c] * v.HALF_SPAN_M, -v.ANCHOR_UP_M])
            line = headings[c][row].T @ (middle - carrier.hook_ned_m[row])
            middles[c, row] = line / np.linalg.norm(line)
    return Track(euler, pos, middles, std, missing)


def _heading(carrier: Carrier) -> FloatArray:
    """(n, 3, 3) ned_from_heading."""
    zero = np.zeros_like(carrier.yaw_rad)
    return rotations(np.column_stack([zero, zero, carrier.yaw_rad]))
