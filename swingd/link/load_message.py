"""The pose of a load that several vehicles carry on the wire: ODOMETRY and DEBUG_FLOAT_ARRAY ``LOADPOSE``."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.swing_message import HEALTH_CODES, float32
from swingd.model.actions import Health
from swingd.model.estimate import FloatArray
from swingd.model.formation import VEHICLES_MAX, FormationReport, LoadMotion, LocalOrigin

NAME = "LOADPOSE"
"""DEBUG_FLOAT_ARRAY.name."""
ARRAY_ID = 2
"""DEBUG_FLOAT_ARRAY.array_id: changes where a field changes its meaning; others are added behind."""
FIELDS = (
    "health",
    "vehicles_used",
    "resets",
    *("pos_n_m", "pos_e_m", "pos_d_m"),
    *("roll_rad", "pitch_rad", "yaw_rad"),
    *("vel_n_mps", "vel_e_mps", "vel_d_mps"),
    *("rate_f_radps", "rate_r_radps", "rate_d_radps"),
    *("pos_n_std_m", "pos_e_std_m", "pos_d_std_m"),
    *("roll_std_rad", "pitch_std_rad", "yaw_std_rad"),
    *("vel_n_std_mps", "vel_e_std_mps", "vel_d_std_mps"),
    "chi2_per_dof",
    "age_s",
    *(f"vehicle_{k}_age_s" for k in range(1, VEHICLES_MAX + 1)),
    *(f"vehicle_{k}_clock_std_s" for k in range(1, VEHICLES_MAX + 1)),
)
"""Meaning of DEBUG_FLOAT_ARRAY.data[0], data[1], ...; the rest of the 58 floats is zero. Without a pose its fields are
NaN, as is the age of a vehicle of which something is missing; vehicles that are not configured are 0."""
_SIZE = 58
_AGES = FIELDS.index("vehicle_1_age_s")
_CLOCKS = FIELDS.index("vehicle_1_clock_std_s")

QUALITY = {Health.READY: 100, Health.DEGRADED: 10}
"""ODOMETRY.quality [%]; in any other health no ODOMETRY is sent."""
_UPPER = np.triu_indices(6)


def odometry(report: FormationReport) -> Any | None:
    """Return the ODOMETRY of a report, or None where there is no pose that may be told.

    Pose in LOCAL_NED, the common frame; velocities in BODY_FRD, the load's axes. ``time_usec`` is the instant of the
    pose on the host's monotonic clock.
    """
    motion, quality = report.motion, QUALITY.get(report.health)
    if motion is None or quality is None:
        return None
    R = motion.ned_from_frd
    turn = np.eye(6)
    turn[:3, :3] = R.T
    vel_frd = R.T @ motion.vel_ned_mps
    return mavlink.MAVLink_odometry_message(
        _usec(motion),
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD,
        *_floats(motion.pos_ned_m),
        list(quaternion_of(R)),
        *_floats(vel_frd),
        *_floats(motion.rate_frd_radps),
        _floats(motion.pose_cov[_UPPER]),
        _floats((turn @ motion.motion_cov @ turn.T)[_UPPER]),
        report.resets % 256,
        mavlink.MAV_ESTIMATOR_TYPE_UNKNOWN,
        quality,
    )


def load_pose(report: FormationReport) -> Any:
    """Return the DEBUG_FLOAT_ARRAY of a report; ``time_usec`` is that of its pose, else of the tick."""
    motion = report.motion
    used = sum(vehicle.used for vehicle in report.vehicles)
    data = [float(HEALTH_CODES[report.health]), float(used), float(report.resets % 256)]
    if motion is None:
        data += [math.nan] * (_AGES - len(data))
        time_usec = round(report.t_mono_s * 1e6)
    else:
        pose_std, motion_std = np.sqrt(np.diag(motion.pose_cov)), np.sqrt(np.diag(motion.motion_cov))
        data += _floats(motion.pos_ned_m)
        data += [motion.roll_rad, motion.pitch_rad, motion.yaw_rad]
        data += _floats(motion.vel_ned_mps) + _floats(motion.rate_frd_radps)
        data += _floats(pose_std) + _floats(motion_std[:3])
        data += [motion.chi2 / motion.dof if motion.dof > 0 else 0.0, report.t_mono_s - motion.t_mono_s]
        time_usec = _usec(motion)
    for values in (
        [vehicle.age_s for vehicle in report.vehicles],
        [vehicle.clock_std_s for vehicle in report.vehicles],
    ):
        row = [math.nan if value is None else value for value in values]
        data += row + [0.0] * (VEHICLES_MAX - len(row))
    data += [0.0] * (_SIZE - len(data))
    return mavlink.MAVLink_debug_float_array_message(time_usec, NAME.encode(), ARRAY_ID, [float32(x) for x in data])


@dataclass(frozen=True, slots=True)
class LoadPoseReport:
    """What `load_pose` has written."""

    t_s: float
    health: Health
    values: dict[str, float]
    """By the names of `FIELDS`."""


def decode(message: Any) -> LoadPoseReport | None:
    """Return what a DEBUG_FLOAT_ARRAY holds, or None if it is another one or of another layout."""
    if message.name != NAME or message.array_id != ARRAY_ID:
        return None
    health = {code: health for health, code in HEALTH_CODES.items()}.get(message.data[0])
    if health is None:
        return None
    return LoadPoseReport(message.time_usec * 1e-6, health, dict(zip(FIELDS, message.data, strict=False)))


def heartbeat(health: Health) -> Any:
    """Return the HEARTBEAT; ``custom_mode`` is the health's code, as swingd's own."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
        mavlink.MAV_AUTOPILOT_INVALID,
        0,
        HEALTH_CODES[health],
        _STATES[health],
        3,
    )


def global_origin(origin: LocalOrigin, t_mono_s: float) -> Any:
    """Return the GPS_GLOBAL_ORIGIN of the common frame."""
    return mavlink.MAVLink_gps_global_origin_message(
        round(math.degrees(origin.lat_rad) * 1e7),
        round(math.degrees(origin.lon_rad) * 1e7),
        round(origin.alt_amsl_m * 1e3),
        round(t_mono_s * 1e6),
    )


def quaternion_of(R: FloatArray) -> tuple[float, float, float, float]:
    """Return w, x, y, z of a rotation matrix, w not negative."""
    # The largest of the four is divided by, so that nothing is lost near half a turn.
    squares = [
        1.0 + R[0, 0] + R[1, 1] + R[2, 2],
        1.0 + R[0, 0] - R[1, 1] - R[2, 2],
        1.0 - R[0, 0] + R[1, 1] - R[2, 2],
        1.0 - R[0, 0] - R[1, 1] + R[2, 2],
    ]
    largest = squares.index(max(squares))
    root = math.sqrt(squares[largest])
    others = {
        (0, 1): R[2, 1] - R[1, 2],
        (0, 2): R[0, 2] - R[2, 0],
        (0, 3): R[1, 0] - R[0, 1],
        (1, 2): R[0, 1] + R[1, 0],
        (1, 3): R[0, 2] + R[2, 0],
        (2, 3): R[1, 2] + R[2, 1],
    }
    q = [0.5 * root if k == largest else 0.5 * others[min(k, largest), max(k, largest)] / root for k in range(4)]
    sign = -1.0 if q[0] < 0.0 else 1.0
    w, x, y, z = (float(sign * value) for value in q)
    return w, x, y, z


def _floats(values: FloatArray) -> list[float]:
    return [float32(value) for value in values.tolist()]


def _usec(motion: LoadMotion) -> int:
    return max(round(motion.t_mono_s * 1e6), 0)


_STATES = {
    Health.INIT: mavlink.MAV_STATE_BOOT,
    Health.READY: mavlink.MAV_STATE_STANDBY,
    Health.ACTIVE: mavlink.MAV_STATE_ACTIVE,
    Health.DEGRADED: mavlink.MAV_STATE_CRITICAL,
    Health.FAULT: mavlink.MAV_STATE_EMERGENCY,
}
