"""CSV logs as events: swingd's own header, and two published data sets with the true swing in them."""

import math
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from pathlib import Path

import numpy as np

from swingd.model.errors import LogFormatError
from swingd.model.events import (
    Attitude,
    AutopilotState,
    Battery,
    Event,
    FlightMode,
    Imu,
    Landed,
    LandedState,
    LocalPosition,
    Motors,
    Throttle,
    Vec3,
)
from swingd.record.truth import BoolArray, FloatArray, SwingTruth, header_of, read_table, read_text

REQUIRED = (
    "t_boot_s",
    "acc_x_frd_mps2",
    "acc_y_frd_mps2",
    "acc_z_frd_mps2",
    "gyro_x_frd_radps",
    "gyro_y_frd_radps",
    "gyro_z_frd_radps",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
)
"""Columns that swingd's own CSV must have."""
OPTIONAL = ("throttle", "voltage_v", "vn_mps", "ve_mps", "vd_mps", "pos_n_m", "pos_e_m", "pos_d_m", "armed", "landed")
"""Columns that it may have, besides ``motor_1``, ``motor_2``, ... (0..1); an empty cell is no sample."""

_GAZEBO_HEADER = (
    "timestamp,imu_ax,imu_ay,imu_az,imu_wx,imu_wy,imu_wz,drone_px,drone_py,drone_pz,drone_vx,drone_vy,drone_vz,"
    "drone_qw,drone_qx,drone_qy,drone_qz,cmd_thrust,gt_xi,gt_zeta,gt_xi_dot,gt_zeta_dot,gt_load_px,gt_load_py,gt_load_pz"
)
_OPTITRACK_COLUMNS = 24
_OPTITRACK_RATE_HZ = 28.7
_OPTITRACK_GRAVITY_MPS2 = 9.82
_OPTITRACK_GAP_S = 1.0
_OPTITRACK_HALF_WINDOW = 10
_STATE_EVERY_S = 1.0

_NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])


class CsvFormat(Enum):
    """What a CSV file turned out to be."""

    SWINGD = "swingd"
    """swingd's own header."""
    GAZEBO_SITL = "gazebo_sitl"
    """EKF-LSTM swing angle data set: FLU, ENU, 50 Hz."""
    OPTITRACK_FLIGHTS = "optitrack_flights"
    """Motion capture of real flights: no header, no time stamps, no IMU, no thrust."""


@dataclass(frozen=True, slots=True)
class CsvLog:
    """A CSV file as events in time order (``t_mono_s`` equals ``t_boot_s``), with the true swing if it is in it."""

    format: CsvFormat
    events: list[Event]
    truth: SwingTruth | None
    skipped_rows: int
    """Rows whose time does not follow the row before; in the published sets also rows with a value that is missing."""


def read_csv_log(path: Path | str) -> CsvLog:
    """Read a CSV log, plain or gzip; the format is recognised by the header or the number of columns.

    Raises
    ------
    LogFormatError
        If it is none of the known formats or a row is damaged; names file, line and what was expected.
    """
    text = read_text(path)
    names = header_of(path, text)
    if ",".join(names) == _GAZEBO_HEADER:
        return _gazebo(path, read_table(path, text, len(names), header=True))
    if "t_boot_s" in names:
        return _own(path, text, names)
    if len(names) == _OPTITRACK_COLUMNS:
        return _optitrack(path, read_table(path, text, _OPTITRACK_COLUMNS, header=False))
    raise LogFormatError(
        f"{path}, line 1: {','.join(names)[:80]!r}; expected a header with {', '.join(REQUIRED)}, "
        f"the header of the Gazebo set, or {_OPTITRACK_COLUMNS} numbers of a motion capture flight"
    )


def _vec3(row: FloatArray) -> Vec3:
    return float(row[0]), float(row[1]), float(row[2])


def _state(t_s: float, armed: bool, landed: bool) -> list[Event]:
    landed_state = LandedState.ON_GROUND if landed else LandedState.IN_AIR
    return [AutopilotState(t_s, armed, FlightMode.OTHER), Landed(t_s, landed_state)]


# ------------------------------------------------------------------------------------------------------ swingd's


def _own(path: Path | str, text: str, names: list[str]) -> CsvLog:
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise LogFormatError(f"{path}, line 1: no column {', '.join(missing)}; expected {', '.join(REQUIRED)}")
    table = read_table(path, text, len(names), header=True)
    column = {name: table[:, i] for i, name in enumerate(names)}
    empty = np.full(len(table), np.nan)
    throttle, voltage_v = column.get("throttle", empty), column.get("voltage_v", empty)
    acc, gyro = (
        np.column_stack([column[f"{kind}_{axis}_frd_{unit}"] for axis in "xyz"])
        for kind, unit in (("acc", "mps2"), ("gyro", "radps"))
    )
    euler = np.column_stack([column[name] for name in ("roll_rad", "pitch_rad", "yaw_rad")])
    vel = np.column_stack([column.get(name, empty) for name in ("vn_mps", "ve_mps", "vd_mps")])
    zero = np.zeros(len(table))
    pos = np.column_stack([column.get(name, zero) for name in ("pos_n_m", "pos_e_m", "pos_d_m")])
    motor_names = sorted((n for n in names if n.startswith("motor_") and n[6:].isdigit()), key=lambda n: int(n[6:]))
    motors = np.column_stack([column[name] for name in motor_names]) if motor_names else empty[:, None]
    armed, landed = column.get("armed", zero + 1.0), column.get("landed", zero)

    events: list[Event] = []
    skipped = 0
    last_s = state_s = -math.inf
    for i, t_s in enumerate(column["t_boot_s"].tolist()):
        if not last_s < t_s < math.inf:
            skipped += 1
            continue
        last_s = t_s
        if t_s - state_s >= _STATE_EVERY_S:
            state_s = t_s
            events += _state(t_s, bool(armed[i] == 1.0), bool(landed[i] == 1.0))
        if math.isfinite(voltage_v[i]):
            events.append(Battery(t_s, float(voltage_v[i])))
        if math.isfinite(throttle[i]):
            events.append(Throttle(t_s, t_s, min(1.0, max(0.0, float(throttle[i])))))
        if np.isfinite(motors[i]).all():
            events.append(Motors(t_s, t_s, tuple(np.clip(motors[i], 0.0, 1.0).tolist())))
        if np.isfinite(vel[i]).all() and np.isfinite(pos[i]).all():
            events.append(LocalPosition(t_s, t_s, _vec3(pos[i]), _vec3(vel[i])))
        if np.isfinite(euler[i]).all():
            events.append(Attitude(t_s, t_s, *_vec3(euler[i])))
        if np.isfinite(acc[i]).all() and np.isfinite(gyro[i]).all():
            events.append(Imu(t_s, t_s, _vec3(acc[i]), _vec3(gyro[i])))
    return CsvLog(CsvFormat.SWINGD, events, None, skipped)


# ----------------------------------------------------------------------------------------------------- rotations


def _rotations(w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Rotation matrices (n, 3, 3) of unit quaternions."""
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _euler(ned_from_frd: FloatArray) -> FloatArray:
    """Roll, pitch and yaw (n, 3) of rotation matrices (n, 3, 3)."""
    return np.column_stack(
        [
            np.arctan2(ned_from_frd[:, 2, 1], ned_from_frd[:, 2, 2]),
            -np.arcsin(np.clip(ned_from_frd[:, 2, 0], -1.0, 1.0)),
            np.arctan2(ned_from_frd[:, 1, 0], ned_from_frd[:, 0, 0]),
        ]
    )


def _swing(rho_ned: FloatArray, yaw_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Swing angles xi, zeta (n,) of the load's position relative to the vehicle (n, 3), in the heading frame."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    forward = cos * rho_ned[:, 0] + sin * rho_ned[:, 1]
    right = -sin * rho_ned[:, 0] + cos * rho_ned[:, 1]
    length = np.linalg.norm(rho_ned, axis=1)
    return np.arctan2(-right, rho_ned[:, 2]), np.arcsin(np.clip(forward / length, -1.0, 1.0))


# -------------------------------------------------------------------------------------------------------- Gazebo


def _gazebo(path: Path | str, table: FloatArray) -> CsvLog:
    t_s = table[:, 0]
    good = np.isfinite(table).all(axis=1) & np.concatenate([[True], np.diff(np.fmax.accumulate(t_s)) > 0.0])
    table = table[good]
    if len(table) < 2:
        raise LogFormatError(f"{path}: {len(table)} usable rows; expected at least 2")
    t_s = table[:, 0]
    acc = table[:, 1:4] @ _FLU_FROM_FRD
    gyro = table[:, 4:7] @ _FLU_FROM_FRD
    pose = table[:, 7:17]
    ned_from_frd = _NED_FROM_ENU @ _rotations(*_unit(pose[:, 6:10]).T) @ _FLU_FROM_FRD
    euler = _euler(ned_from_frd)
    pos, vel = pose[:, 0:3] @ _NED_FROM_ENU.T, pose[:, 3:6] @ _NED_FROM_ENU.T
    # The pose is written again until the next one arrives; only its first row is a sample.
    is_new = np.concatenate([[True], np.any(np.diff(pose, axis=0) != 0.0, axis=1)])

    events: list[Event] = []
    state_s = -math.inf
    for i, t in enumerate(t_s.tolist()):
        if t - state_s >= _STATE_EVERY_S:
            state_s = t
            events += _state(t, armed=True, landed=False)
        events.append(Throttle(t, t, min(1.0, max(0.0, float(table[i, 17])))))
        if is_new[i]:
            events.append(LocalPosition(t, t, _vec3(pos[i]), _vec3(vel[i])))
            events.append(Attitude(t, t, *_vec3(euler[i])))
        events.append(Imu(t, t, _vec3(acc[i]), _vec3(gyro[i])))
    tan_east, tan_north = np.tan(table[:, 18]), np.tan(table[:, 19])
    rho_ned = np.column_stack([tan_north, tan_east, np.ones(len(table))])
    truth = _truth(t_s, rho_ned, euler[:, 2], np.ones(len(table), dtype=np.bool_))
    return CsvLog(CsvFormat.GAZEBO_SITL, events, truth, int(np.sum(~good)))


def _unit(quaternions: FloatArray) -> FloatArray:
    unit: FloatArray = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return unit


def _truth(t_s: FloatArray, rho_ned: FloatArray, yaw_rad: FloatArray, valid: BoolArray) -> SwingTruth:
    xi, zeta = _swing(rho_ned, yaw_rad)
    return SwingTruth(t_s, xi, zeta, np.gradient(xi, t_s), np.gradient(zeta, t_s), valid)


# ----------------------------------------------------------------------------------------------------- OptiTrack


def _optitrack(path: Path | str, table: FloatArray) -> CsvLog:
    """Rebuild IMU samples from the poses: specific force by smoothed differentiation, rates from the attitude.

    There are no time stamps. Rows are taken to come at the mean rate; where vehicle or load jump, detections are
    missing for an unknown time: the smoothing stops there and the clock goes on by a second, which no filter bridges.
    """
    used = table[:, [*range(7), 14, 15, 16]]
    good = np.isfinite(used).all(axis=1) & (np.linalg.norm(used[:, 3:7], axis=1) > 0.5)
    used = used[good]
    window = 2 * _OPTITRACK_HALF_WINDOW + 1
    if len(used) < window:
        raise LogFormatError(f"{path}: {len(used)} usable rows; expected at least {window}")
    ned_from_frd = _NED_FROM_ENU @ _rotations(*_unit(used[:, [6, 3, 4, 5]]).T) @ _FLU_FROM_FRD
    pos = used[:, 0:3] @ _NED_FROM_ENU.T
    load = used[:, 7:10] @ _NED_FROM_ENU.T
    euler = _euler(ned_from_frd)
    dt_s = 1.0 / _OPTITRACK_RATE_HZ

    gap = _jumps(pos) | _jumps(load)
    t_s = np.concatenate([[0.0], np.cumsum(np.where(gap, _OPTITRACK_GAP_S, dt_s))])
    bounds = [0, *(np.flatnonzero(gap) + 1).tolist(), len(used)]
    gravity_ned = np.array([0.0, 0.0, _OPTITRACK_GRAVITY_MPS2])
    valid = np.zeros(len(used), dtype=np.bool_)

    events: list[Event] = []
    for first, end in pairwise(bounds):
        if end - first < window:
            continue
        vel, acc = _derivatives(pos[first:end], dt_s)
        for k in range(len(acc)):
            i = first + _OPTITRACK_HALF_WINDOW + k
            t = float(t_s[i])
            if k % round(_OPTITRACK_RATE_HZ * _STATE_EVERY_S) == 0:
                events += _state(t, armed=True, landed=False)
            gyro = _rotation_vector(ned_from_frd[i - 1].T @ ned_from_frd[i + 1]) / (2.0 * dt_s)
            specific_force_frd = ned_from_frd[i].T @ (acc[k] - gravity_ned)
            events.append(LocalPosition(t, t, _vec3(pos[i]), _vec3(vel[k])))
            events.append(Attitude(t, t, *_vec3(euler[i])))
            events.append(Imu(t, t, _vec3(specific_force_frd), _vec3(gyro)))
            valid[i] = True
    return CsvLog(CsvFormat.OPTITRACK_FLIGHTS, events, _truth(t_s, load - pos, euler[:, 2], valid), int(np.sum(~good)))


def _jumps(pos: FloatArray) -> BoolArray:
    """Where the step (n - 1,) from row to row is far longer than those around it."""
    step = np.linalg.norm(np.diff(pos, axis=0), axis=1)
    half = _OPTITRACK_HALF_WINDOW
    around = np.lib.stride_tricks.sliding_window_view(np.pad(step, half, mode="edge"), 2 * half + 1)
    jumps: BoolArray = step > 4.0 * np.median(around, axis=1) + 0.1
    return jumps


def _derivatives(pos: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Velocity and acceleration (n - 2 half, 3) by a cubic fitted to a sliding window (Savitzky and Golay)."""
    half = _OPTITRACK_HALF_WINDOW
    powers = np.vander(np.arange(-half, half + 1) * dt_s, 4, increasing=True)
    fit = np.linalg.pinv(powers)
    windows = np.lib.stride_tricks.sliding_window_view(pos, 2 * half + 1, axis=0)
    return windows @ fit[1], 2.0 * (windows @ fit[2])


def _rotation_vector(rotation: FloatArray) -> FloatArray:
    """Axis times angle [rad] of a rotation matrix, for angles below half a turn."""
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    twice_sin = float(np.linalg.norm(axis))
    if twice_sin < 1e-9:
        return 0.5 * axis
    angle_rad = math.atan2(twice_sin, float(np.trace(rotation)) - 1.0)
    scaled: FloatArray = axis * (angle_rad / twice_sin)
    return scaled
