"""PX4's own logs (.ulg) as events."""

import contextlib
import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swingd.model.errors import ConfigurationError, LogFormatError
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
)
from swingd.model.parameters import Thrust

_TOPICS = [
    "vehicle_imu",
    "sensor_combined",
    "estimator_sensor_bias",
    "vehicle_attitude",
    "vehicle_attitude_setpoint",
    "vehicle_thrust_setpoint",
    "actuator_outputs",
    "actuator_motors",
    "battery_status",
    "vehicle_local_position",
    "vehicle_status",
    "vehicle_land_detected",
]
_ARMED = 2
_NAV_STATE_OFFBOARD = 14
_LONGEST_S = 1e5
_READS_WITHOUT_PROGRESS = 4 * 65536  # a false message of 64 KiB is searched byte by byte

Columns = dict[str, npt.NDArray[Any]]
_Stream = tuple[npt.NDArray[np.float64], Callable[[float, int], Event]]


def read_ulog(path: Path | str, thrust: Thrust) -> Iterator[Event]:
    """Read a .ulg as events in time order, ``t_mono_s`` equal to ``t_boot_s``.

    Where two topics carry the same thing the more frequent one is taken: ``vehicle_imu`` or ``sensor_combined`` (less
    ``estimator_sensor_bias``, as in HIGHRES_IMU), ``vehicle_attitude_setpoint`` or ``vehicle_thrust_setpoint``; motor
    outputs come from ``actuator_outputs``, else from ``actuator_motors``. Samples that are not finite or not later than
    the one before are left out.

    Parameters
    ----------
    path : Path or str
        The log; one that ends in the middle of a record is read as far as it goes.
    thrust : Thrust
        ``motor_output_min``, ``motor_output_max`` and ``motor_count`` normalise ``actuator_outputs``.

    Raises
    ------
    LogFormatError
        If it is no ULog or has no IMU or no attitude; names what is there. Raised by the call, not by iterating.
    ConfigurationError
        If ``motor_output_min`` equals ``motor_output_max``.
    """
    if thrust.motor_output_max == thrust.motor_output_min:
        raise ConfigurationError(
            f"thrust.motor_output_max: {thrust.motor_output_max} equals thrust.motor_output_min; "
            "expected the outputs that mean full and no thrust"
        )
    topics = _read(path)
    with np.errstate(all="ignore"):  # what is not finite is left out at the end
        return _merge(_streams(path, topics, thrust))


def _streams(path: Path | str, topics: dict[str, Columns], thrust: Thrust) -> list[_Stream]:
    imu = _imu(topics)
    attitude = topics.get("vehicle_attitude")
    if imu is None or attitude is None or any(f"q[{i}]" not in attitude for i in range(4)):
        raise LogFormatError(
            f"{path}: topics {', '.join(sorted(topics)) or 'none'}; "
            "expected vehicle_attitude and one of vehicle_imu and sensor_combined"
        )
    streams = [
        _status(topics),
        _landed(topics),
        _battery(topics),
        _local_position(topics),
        _throttle(topics),
        _motors(topics, thrust),
        _attitude(attitude),
        imu,
    ]
    return [stream for stream in streams if stream is not None]


class _NoProgressError(Exception):
    """The parser runs in circles."""


class _Advancing(io.BytesIO):
    """A file that ends a parser which reads the same bytes for ever, as pyulog does with some damaged logs."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._furthest = 0
        self._reads = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        at = self.tell()
        if at > self._furthest:
            self._furthest, self._reads = at, 0
        else:
            self._reads += 1
            if self._reads > _READS_WITHOUT_PROGRESS:
                raise _NoProgressError(f"damaged at byte {at}")
        return data


def _read(path: Path | str) -> dict[str, Columns]:
    """Return the columns of the first instance of each topic that is used."""
    try:
        import pyulog
    except ImportError as error:
        raise LogFormatError(f"{path}: reading .ulg needs pyulog: install swingd[replay]") from error
    try:
        file = _Advancing(Path(path).read_bytes())
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what it finds damaged
            log = pyulog.ULog(file, _TOPICS)
    except Exception as error:  # the parser raises whatever the damaged bytes lead to
        raise LogFormatError(f"{path}: {error or type(error).__name__}; expected a PX4 log (.ulg)") from error
    topics: dict[str, Columns] = {}
    for data in sorted(log.data_list, key=lambda d: -int(d.multi_id)):
        if len(data.data["timestamp"]):
            topics[data.name] = data.data
    return topics


def _merge(streams: list[_Stream]) -> Iterator[Event]:
    times = np.concatenate([t_s for t_s, _ in streams])
    which = np.concatenate([np.full(len(t_s), n) for n, (t_s, _) in enumerate(streams)])
    index = np.concatenate([np.arange(len(t_s)) for t_s, _ in streams])
    for k in np.lexsort((which, times)).tolist():
        yield streams[which[k]][1](float(times[k]), int(index[k]))


def _time_s(columns: Columns) -> npt.NDArray[np.float64]:
    """Time of the data, where the topic tells it apart from the time of publication."""
    stamp = columns.get("timestamp_sample")
    if stamp is None or not np.all(stamp):
        stamp = columns["timestamp"]
    time_s: npt.NDArray[np.float64] = stamp.astype(np.float64) * 1e-6
    return time_s


def _table(columns: Columns, *names: str) -> npt.NDArray[np.float64] | None:
    if any(name not in columns for name in names):
        return None
    return np.column_stack([columns[name].astype(np.float64) for name in names])


def _vec(columns: Columns, name: str, size: int) -> npt.NDArray[np.float64] | None:
    return _table(columns, *(f"{name}[{i}]" for i in range(size)))


def _stream(
    t_s: npt.NDArray[np.float64],
    values: npt.NDArray[np.float64],
    make: Callable[[float, list[float]], Event],
    good: npt.NDArray[np.bool_] | None = None,
) -> _Stream:
    keep = np.isfinite(values).all(axis=1)
    if good is not None:
        keep &= good
    if len(t_s):
        keep &= np.abs(t_s - np.median(t_s)) < _LONGEST_S  # a wild stamp would lock out all that follow
    t_s, values = t_s[keep], values[keep]
    later = np.concatenate([[True], np.diff(np.maximum.accumulate(t_s)) > 0.0]) if len(t_s) else np.ones(0, np.bool_)
    t_s, rows = t_s[later], values[later].tolist()
    return t_s, lambda t, i: make(t, rows[i])


def _most(topics: dict[str, Columns], *names: str) -> list[Columns]:
    """Topics that are there, the most frequent one first."""
    return sorted((topics[n] for n in names if n in topics), key=lambda c: -len(c["timestamp"]))


def _imu(topics: dict[str, Columns]) -> _Stream | None:
    for columns in _most(topics, "vehicle_imu", "sensor_combined"):
        acc = _vec(columns, "accelerometer_m_s2", 3)
        gyro = _vec(columns, "gyro_rad", 3)
        delta_velocity = _vec(columns, "delta_velocity", 3)
        delta_angle = _vec(columns, "delta_angle", 3)
        interval_us = _table(columns, "delta_velocity_dt", "delta_angle_dt")
        good = None
        if delta_velocity is not None and delta_angle is not None and interval_us is not None:
            good = np.all(interval_us > 0.0, axis=1)
            interval_s = np.where(good[:, None], interval_us * 1e-6, 1.0)
            acc = delta_velocity / interval_s[:, :1]
            gyro = delta_angle / interval_s[:, 1:]
        if acc is None or gyro is None:
            continue
        t_s = _time_s(columns)
        acc, gyro = acc - _bias(topics, "accel_bias", t_s), gyro - _bias(topics, "gyro_bias", t_s)
        return _stream(
            t_s, np.hstack([acc, gyro]), lambda t, v: Imu(t, t, (v[0], v[1], v[2]), (v[3], v[4], v[5])), good
        )
    return None


def _bias(topics: dict[str, Columns], name: str, t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """In-flight bias estimate (n, 3) as of each time, zero while there is none."""
    columns = topics.get("estimator_sensor_bias", {})
    bias = _vec(columns, name, 3)
    if bias is None:
        return np.zeros((len(t_s), 3))
    known = columns.get(f"{name}_valid", np.ones(len(bias)))
    bias = np.where((known != 0)[:, None] & np.isfinite(bias), bias, 0.0)
    at = np.searchsorted(columns["timestamp"] * 1e-6, t_s, side="right")
    return np.vstack([np.zeros(3), bias])[at]


def _attitude(columns: Columns) -> _Stream:
    w, x, y, z = (columns[f"q[{i}]"].astype(np.float64) for i in range(4))
    norm = w * w + x * x + y * y + z * z
    good = (norm > 0.9) & (norm < 1.1)
    roll = np.arctan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x) / np.where(good, norm, 1.0), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return _stream(
        _time_s(columns),
        np.column_stack([roll, pitch, yaw]),
        lambda t, v: Attitude(t, t, v[0], v[1], v[2]),
        good,
    )


def _throttle(topics: dict[str, Columns]) -> _Stream | None:
    for columns in _most(topics, "vehicle_attitude_setpoint", "vehicle_thrust_setpoint"):
        body = _vec(columns, "thrust_body", 3)
        if body is None:
            body = _vec(columns, "xyz", 3)
        if body is not None:
            up = np.clip(-body[:, 2:3], 0.0, 1.0)
            return _stream(columns["timestamp"] * 1e-6, up, lambda t, v: Throttle(t, t, v[0]))
    return None


def _motors(topics: dict[str, Columns], thrust: Thrust) -> _Stream | None:
    outputs = topics.get("actuator_outputs", {})
    values = _vec(outputs, "output", 16)
    if values is not None:
        low, high = sorted((thrust.motor_output_min, thrust.motor_output_max))
        if thrust.motor_count:
            driven = np.arange(thrust.motor_count)
        else:
            driven = np.flatnonzero(np.any((values >= low) & (values <= high), axis=0))
        x = (values[:, driven] - thrust.motor_output_min) / (thrust.motor_output_max - thrust.motor_output_min)
        columns = outputs
    else:
        columns = topics.get("actuator_motors", {})
        control = _vec(columns, "control", 12)
        if control is None:
            return None
        driven = np.flatnonzero(np.any(np.isfinite(control), axis=0))
        x = np.nan_to_num(control[:, driven], nan=0.0)  # NaN stops a motor
    if not driven.size:
        return None
    return _stream(columns["timestamp"] * 1e-6, np.clip(x, 0.0, 1.0), lambda t, v: Motors(t, t, tuple(v)))


def _battery(topics: dict[str, Columns]) -> _Stream | None:
    columns = topics.get("battery_status", {})
    voltage = _table(columns, "voltage_v")
    if voltage is None:
        return None
    return _stream(columns["timestamp"] * 1e-6, voltage, lambda t, v: Battery(t, v[0]), voltage[:, 0] > 0.0)


def _local_position(topics: dict[str, Columns]) -> _Stream | None:
    columns = topics.get("vehicle_local_position", {})
    values = _table(columns, "x", "y", "z", "vx", "vy", "vz")
    if values is None:
        return None
    good = np.ones(len(values), dtype=np.bool_)
    for flag in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid"):
        if flag in columns:
            good &= columns[flag] != 0
    return _stream(
        _time_s(columns), values, lambda t, v: LocalPosition(t, t, (v[0], v[1], v[2]), (v[3], v[4], v[5])), good
    )


def _status(topics: dict[str, Columns]) -> _Stream | None:
    columns = topics.get("vehicle_status", {})
    values = _table(columns, "arming_state", "nav_state")
    if values is None:
        return None

    def make(t_s: float, row: list[float]) -> Event:
        mode = FlightMode.OFFBOARD if row[1] == _NAV_STATE_OFFBOARD else FlightMode.OTHER
        return AutopilotState(t_s, row[0] == _ARMED, mode)

    return _stream(*_held(columns["timestamp"] * 1e-6, values, topics), make)


def _landed(topics: dict[str, Columns]) -> _Stream | None:
    columns = topics.get("vehicle_land_detected", {})
    values = _table(columns, "landed")
    if values is None:
        return None
    return _stream(
        *_held(columns["timestamp"] * 1e-6, values, topics),
        lambda t, v: Landed(t, LandedState.ON_GROUND if v[0] else LandedState.IN_AIR),
    )


def _held(
    t_s: npt.NDArray[np.float64], values: npt.NDArray[np.float64], topics: dict[str, Columns]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Repeat a state every second until it changes, as a link does; the log holds changes only."""
    end_s = float(topics["vehicle_attitude"]["timestamp"][-1]) * 1e-6
    ends = np.append(t_s[1:], max(end_s, t_s[-1]))
    copies = np.maximum(1, np.ceil(ends - t_s)).astype(np.int64)
    if copies.sum() > 1_000_000:  # a wild stamp
        return t_s, values
    begun = np.repeat(np.cumsum(copies) - copies, copies)
    return np.repeat(t_s, copies) + (np.arange(copies.sum()) - begun), np.repeat(values, copies, axis=0)
