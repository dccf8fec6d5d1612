"""What the vehicles' cables tell of the load at one instant: sights for its pose, equations for its motion."""

import math
from dataclasses import dataclass

import numpy as np

from swingd.estimation.cooperative_pose import LoadPose, TetherSight
from swingd.model.estimate import FloatArray
from swingd.model.events import Vec3
from swingd.model.formation import RiggedVehicle
from swingd.pipeline.formation.vehicle import VehicleInstant

PITCH_RATE_PER_ANGLE = 3.0
"""Deviation of the rate of an angle that the load keeps but for its swing, over that of the angle, 1/s: sqrt(g / L)
for a metre of cable."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """What one vehicle's cables tell at an instant."""

    sights: tuple[TetherSight, ...]
    length_rates_mps: tuple[float, ...]
    """At which each sight's tether gets longer."""
    instant: VehicleInstant


def look(rig: RiggedVehicle, instant: VehicleInstant, offset_ned_m: Vec3) -> Sighting | None:
    """Turn a vehicle at an instant into what its tethers tell; None where tethers of that length cannot be.

    Parameters
    ----------
    rig : RiggedVehicle
    instant : VehicleInstant
        In the vehicle's local frame.
    offset_ned_m : Vec3
        Origin of that frame in the common one.

    Notes
    -----
    One tether lies along the cable force. Of two from one hook, which only pull along themselves, each tells its length
    alone; the force points where the line from the hook to the load's CG meets the line between the anchors, seen
    across that line, if the load hangs at rest below them.

    An error of the hook's place is one error, however many tethers begin there: the weights of several share it.
    """
    hook = instant.hook_ned_m + np.array(offset_ned_m)
    lengths = [tether.length_m + tether.winch_gain * instant.winch for tether in rig.tethers]
    if not all(length > 0.0 for length in lengths):
        return None
    rates = tuple(tether.winch_gain * instant.winch_rate for tether in rig.tethers)
    mean_m = sum(lengths) / len(lengths)
    across = np.eye(3) - np.outer(instant.direction_ned, instant.direction_ned)
    cov = instant.direction_cov + instant.pos_var_m2 / mean_m**2 * across
    stds = [math.sqrt(tether.length_std_m**2 + len(lengths) * instant.pos_var_m2) for tether in rig.tethers]
    if len(lengths) == 1:
        sight = TetherSight(hook, instant.direction_ned, cov, lengths[0], stds[0], rig.tethers[0].anchor_frd_m)
        return Sighting((sight,), rates, instant)
    anchor = force_anchor(rig, lengths, instant.direction_ned)
    if anchor is None:
        return None
    force = TetherSight(hook, instant.direction_ned, cov, mean_m, math.inf, anchor)
    return Sighting(
        (
            force,
            *(
                TetherSight(hook, instant.direction_ned, None, length, std, tether.anchor_frd_m)
                for tether, length, std in zip(rig.tethers, lengths, stds, strict=True)
            ),
        ),
        (0.0, *rates),
        instant,
    )


def force_anchor(rig: RiggedVehicle, lengths: list[float], direction_ned: FloatArray) -> Vec3 | None:
    """Return the point of the load that the force of two tethers points to; None where they do not reach.

    Parameters
    ----------
    rig : RiggedVehicle
        Of two tethers.
    lengths : 2 floats
    direction_ned : (3,)
    """
    first, second = (np.array(tether.anchor_frd_m) for tether in rig.tethers)
    edge_m = float(np.linalg.norm(first - second))
    if edge_m < 1e-6:
        return rig.tethers[0].anchor_frd_m
    edge, middle = (first - second) / edge_m, 0.5 * (first + second)
    ahead_m = (lengths[1] ** 2 - lengths[0] ** 2) / (2.0 * edge_m)
    height2 = lengths[0] ** 2 - (0.5 * edge_m - ahead_m) ** 2
    if not height2 > 0.0:
        return None
    # The hook's height as it is seen across the edge: the cables lean by the rest, to the side.
    lean = abs(float(direction_ned[2]))
    height_m, below_m = math.sqrt(height2) * lean, max(-float(middle[2]), 0.0)
    cg_m = -float(middle @ edge)
    share = height_m / (height_m + below_m) if height_m > 0.0 else 1.0
    x, y, z = (middle + (ahead_m + share * (cg_m - ahead_m)) * edge).tolist()
    return x, y, z


def motion_of(
    pose: LoadPose,
    sightings: list[Sighting],
    roll_std_rad: float,
    pitch_std_rad: float,
    pitch_rate_radps: float = 0.0,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Find velocity and rates of the load from those of hooks and cables, by least squares.

    The derivative of every sight, at the pose that was found: a length changes by what its winch turns, a direction at
    the rate that is told.

    Parameters
    ----------
    pose : LoadPose
    sightings : list of Sighting
        Those that the pose was found from.
    roll_std_rad, pitch_std_rad : float
        Of the angles that were known without the tethers; infinite where they were not. They keep still but for swing.
    pitch_rate_radps : float
        That the winches give the load.

    Returns
    -------
    velocity (3,) ned, rates (3,) frd, covariance (6, 6) of both; or None where they are not told
    """
    rows: list[FloatArray] = []
    told: list[float] = []
    stds: list[float] = []
    R = pose.ned_from_frd
    for sighting in sightings:
        now = sighting.instant
        for sight, length_rate in zip(sighting.sights, sighting.length_rates_mps, strict=True):
            anchor = np.array(sight.anchor_frd_m)
            line = pose.pos_ned_m + R @ anchor - sight.hook_ned_m
            length_m = float(np.linalg.norm(line))
            unit = line / length_m
            # Velocity of the anchor: v + R (omega x a) = v - R [a]x omega.
            a_x, a_y, a_z = anchor.tolist()
            cross = np.array([[0.0, -a_z, a_y], [a_z, 0.0, -a_x], [-a_y, a_x, 0.0]])
            effect = np.hstack([np.eye(3), -R @ cross])
            if math.isfinite(sight.length_std_m):
                rows.append(unit @ effect)
                told.append(float(unit @ now.hook_vel_ned_mps) + length_rate)
                stds.append(math.sqrt(now.vel_var_m2ps2 * max(len(sighting.sights) - 1, 1)))
            if sight.direction_cov is None:
                continue
            first = np.cross(unit, np.eye(3)[int(np.abs(unit).argmin())])
            first /= np.linalg.norm(first)
            for axis in (first, np.cross(unit, first)):
                rows.append(axis @ effect / length_m)
                told.append(float(axis @ (now.hook_vel_ned_mps / length_m + now.direction_rate_ned)))
                stds.append(math.sqrt(now.rate_var_radps2 + now.vel_var_m2ps2 / length_m**2))
    s_r, c_r = math.sin(pose.roll_rad), math.cos(pose.roll_rad)
    t_p = math.tan(pose.pitch_rad)
    known = (
        ((1.0, s_r * t_p, c_r * t_p), 0.0, roll_std_rad),
        ((0.0, c_r, -s_r), pitch_rate_radps, pitch_std_rad),
    )
    for euler_rate, value, std_rad in known:
        if math.isfinite(std_rad):
            rows.append(np.array([0.0, 0.0, 0.0, *euler_rate]))
            told.append(value)
            stds.append(PITCH_RATE_PER_ANGLE * std_rad)
    weighted = np.array(rows) / np.array(stds)[:, None]
    information = weighted.T @ weighted
    if not np.isfinite(information).all():
        return None
    scale = np.sqrt(np.diag(information))
    if not (scale > 0.0).all():
        return None
    scaled = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(scaled)[0] < 1e-9:
        return None
    cov = np.linalg.inv(scaled) / np.outer(scale, scale)
    found = cov @ (weighted.T @ (np.array(told) / np.array(stds)))
    return found[:3], found[3:], cov
