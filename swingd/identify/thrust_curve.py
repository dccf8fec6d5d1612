"""Thrust curve F = (V / V0)^n (a x^2 + b x + c) from a thrust stand, or its scale and n from hover at falling voltage.

The shape generalises (28), (29) of the tether UKF's paper: F = 0.8 (V / 16.0)^2 (0.0011 x^2 + 0.76 x), x in percent.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swingd.core.constants import GRAVITY_MPS2
from swingd.identify.fit import student_quantile
from swingd.model.errors import LogFormatError
from swingd.model.estimate import FloatArray
from swingd.model.events import Attitude, Battery, Imu, Motors, Throttle
from swingd.model.parameters import Thrust
from swingd.record.truth import header_of, read_table, read_text

REQUIRED = ("throttle", "thrust_n")
"""Columns of a stand's CSV; ``voltage_v`` may be there as well."""
ROWS_MIN = 5
VOLTAGE_SPREAD_MIN = 0.03
"""Share by which the voltage must differ before its exponent is fitted."""
EXPONENT_RANGE = (0.0, 3.0)
WINDOW_S = 1.0
"""Hover is taken as means over so long."""
WINDOWS_MIN = 20
BLOCKS = 10
"""Stretches of windows that are left out in turn: what drifts is the same within one."""
QUIET_RATE_RADPS = 0.15
QUIET_ACC_MPS2 = 0.4
QUIET_TILT_RAD = math.radians(12.0)
FLOWN_SHARE = 0.4
"""Of the thrust needed: where the configured curve gives less, the vehicle stood on the ground."""


@dataclass(frozen=True, slots=True)
class StandRow:
    """One steady point of a thrust stand."""

    throttle: float
    """0..1"""
    thrust_n: float
    voltage_v: float
    """nan where it was not measured."""


@dataclass(frozen=True, slots=True)
class Value:
    """A fitted number with its interval of 95 %."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ThrustCurve:
    """The fitted curve, and what it was fitted to."""

    quadratic_n: Value
    linear_n: Value
    offset_n: Value
    voltage_nominal_v: float
    exponent: Value | None
    """None where the data do not tell it; then ``exponent_used`` is the configured one."""
    exponent_used: float
    exponent_note: str
    """Why it is not known; empty where it is."""
    rms_n: float
    """Of what is left."""
    throttle: FloatArray
    """(n,)"""
    voltage_v: FloatArray
    """(n,) nan where it was not measured."""
    thrust_n: FloatArray
    """(n,) measured on the stand, or what carried the vehicle in hover."""
    from_hover: bool

    def thrust_at(self, throttle: FloatArray, voltage_v: FloatArray, compensated: bool = True) -> FloatArray:
        """Give the curve's thrust (n,) [N]; without compensation as if the voltage were always nominal."""
        x = np.asarray(throttle)
        curve = (self.quadratic_n.value * x + self.linear_n.value) * x + self.offset_n.value
        if not compensated:
            return np.asarray(curve)
        known = np.where(np.isnan(voltage_v), self.voltage_nominal_v, voltage_v)
        return np.asarray((known / self.voltage_nominal_v) ** self.exponent_used * curve)

    def yaml(self) -> str:
        """Return the block of the configuration."""

        def line(key: str, known: Value) -> str:
            return f"  {key}: {known.value:.5g}  # {known.low:.4g} .. {known.high:.4g}"

        told = self.exponent or Value(self.exponent_used, self.exponent_used, self.exponent_used)
        exponent = line("voltage_exponent", told) if self.exponent else f"  voltage_exponent: {self.exponent_used:.5g}"
        return "\n".join(
            [
                "thrust:",
                line("quadratic_n", self.quadratic_n),
                line("linear_n", self.linear_n),
                line("offset_n", self.offset_n),
                f"  voltage_nominal_v: {self.voltage_nominal_v:.5g}",
                exponent + (f"  # {self.exponent_note}" if self.exponent_note else ""),
            ]
        )


def is_stand_csv(path: Path) -> bool:
    """Tell a stand's CSV, by its header, from a log."""
    if path.suffix.lower() in (".tlog", ".ulg", ".swingd"):
        return False
    try:
        with path.open("rb") as file:
            head = file.readline(4096)
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from error
    return b"thrust" in head and b"t_boot_s" not in head


def read_stand(path: Path) -> list[StandRow]:
    """Read a stand's CSV.

    Raises
    ------
    LogFormatError
        Names file, line, value and what was expected.
    """
    text = read_text(path)
    names = header_of(path, text)
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise LogFormatError(
            f"{path}, line 1: no column {', '.join(missing)}; expected {', '.join(REQUIRED)}, and voltage_v if measured"
        )
    table = read_table(path, text, len(names), header=True)
    lines = [number for number, line in enumerate(text.splitlines(), start=1) if line.strip()][1:]
    rows = []
    for line, values in zip(lines, table, strict=True):
        cells = dict(zip(names, values.tolist(), strict=True))
        row = StandRow(cells["throttle"], cells["thrust_n"], cells.get("voltage_v", math.nan))
        for name, value, low, high in (
            ("throttle", row.throttle, 0.0, 1.0),
            ("thrust_n", row.thrust_n, 0.0, 1e5),
            ("voltage_v", row.voltage_v, 1.0, 1000.0),
        ):
            if name == "voltage_v" and "voltage_v" not in names:
                continue
            if not low <= value <= high:
                raise LogFormatError(f"{path}, line {line}: {name} {value:g}; expected {low:g} .. {high:g}")
        rows.append(row)
    if len(rows) < ROWS_MIN:
        raise LogFormatError(f"{path}: {len(rows)} rows; expected at least {ROWS_MIN}")
    if len({row.throttle for row in rows}) < 4:
        raise LogFormatError(f"{path}: {len({row.throttle for row in rows})} different throttles; expected at least 4")
    return rows


def fit_stand(rows: Sequence[StandRow], thrust: Thrust, rotors: int = 1, nominal_v: float | None = None) -> ThrustCurve:
    """Fit a curve to a stand's points by least squares.

    Parameters
    ----------
    rows : sequence of StandRow
        At least `ROWS_MIN`.
    thrust : Thrust
        Its exponent is used where the voltage did not differ enough, its nominal voltage where none was measured.
    rotors : int
        How many rotors like the one on the stand the vehicle has; 1: the stand measured all.
    nominal_v : float, optional
        V0 of the curve; by default the median of the measured ones.

    Notes
    -----
    For each exponent the curve is linear; the exponent is found by Gauss-Newton on all four, from the best of a scan.
    Intervals are Student's, of white residuals.
    """
    x, force, voltage = (
        np.array(column, dtype=float)
        for column in zip(*((r.throttle, rotors * r.thrust_n, r.voltage_v) for r in rows), strict=True)
    )
    measured = bool(np.isfinite(voltage).all())
    if nominal_v is None:
        nominal_v = float(np.median(voltage)) if measured else thrust.voltage_nominal_v
    spread = float(np.ptp(voltage)) / nominal_v if measured else 0.0
    ratio = voltage / nominal_v if measured else np.ones_like(x)
    powers = np.column_stack([x * x, x, np.ones_like(x)])
    fitted = spread >= VOLTAGE_SPREAD_MIN and len(rows) > ROWS_MIN
    exponent = thrust.voltage_exponent
    if fitted:
        tried = np.linspace(*EXPONENT_RANGE, 61)
        costs = [_linear(powers * (ratio**n)[:, None], force)[1] for n in tried]
        exponent = float(tried[int(np.argmin(costs))])
        for _ in range(20):
            curve, _ = _linear(powers * (ratio**exponent)[:, None], force)
            jacobian = _jacobian(powers, ratio, exponent, curve)
            step = np.linalg.lstsq(jacobian, force - ratio**exponent * (powers @ curve))[0]
            exponent = float(np.clip(exponent + step[3], *EXPONENT_RANGE))
            if abs(step[3]) < 1e-10:
                break
    curve, cost = _linear(powers * (ratio**exponent)[:, None], force)
    jacobian = _jacobian(powers, ratio, exponent, curve)[:, : 4 if fitted else 3]
    freedom = max(len(rows) - jacobian.shape[1], 1)
    cov = np.linalg.pinv(jacobian.T @ jacobian) * cost / freedom
    reach = student_quantile(max(freedom, 3)) * np.sqrt(np.diag(cov))
    values = [
        Value(float(v), float(v - r), float(v + r)) for v, r in zip([*curve, exponent], [*reach, 0.0], strict=False)
    ]
    note = ""
    if not fitted:
        note = (
            "configured; no voltage was measured"
            if not measured
            else f"configured; the voltage differed by {100.0 * spread:.1f} % only"
        )
    return ThrustCurve(
        values[0], values[1], values[2], nominal_v, values[3] if fitted else None, exponent, note,
        math.sqrt(cost / len(rows)), x, voltage, force, from_hover=False,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class HoverRow:
    """One quiet second of hover."""

    throttle: float
    voltage_v: float
    thrust_n: float
    """What carried vehicle and load."""


def hover_rows(
    imu: Sequence[Imu],
    attitudes: Sequence[Attitude],
    outputs: Sequence[Motors] | Sequence[Throttle],
    batteries: Sequence[Battery],
    stretches: Sequence[tuple[float, float]],
    vehicle_kg: float,
    load_kg: float,
) -> list[HoverRow]:
    """Take the quiet seconds of a flight.

    Parameters
    ----------
    imu, attitudes, outputs, batteries
        Streams of the flight.
    stretches : pairs of float
        When the vehicle flew with this load [s, boot time].
    vehicle_kg, load_kg : float
    """
    if not (imu and attitudes and outputs and batteries):
        return []
    t_imu = np.array([s.t_boot_s for s in imu])
    acc = np.array([s.acc_frd_mps2 for s in imu])
    rate = np.array([s.gyro_frd_radps for s in imu])
    t_att = np.array([a.t_boot_s for a in attitudes])
    tilt = np.array([math.acos(max(-1.0, min(1.0, math.cos(a.roll_rad) * math.cos(a.pitch_rad)))) for a in attitudes])
    t_out = np.array([o.t_boot_s for o in outputs])
    level = np.array(
        [o.throttle if isinstance(o, Throttle) else float(np.mean(o.outputs or (math.nan,))) for o in outputs]
    )
    # A battery carries the host's stamp only; in a log it differs from boot time by a constant.
    shift_s = imu[0].t_mono_s - imu[0].t_boot_s
    t_bat = np.array([b.t_mono_s - shift_s for b in batteries])
    volts = np.array([b.voltage_v for b in batteries])
    rows = []
    for begin_s, end_s in stretches:
        for start_s in np.arange(begin_s, end_s - WINDOW_S, WINDOW_S):
            here, tilted, given = (
                slice(*np.searchsorted(t, (start_s, start_s + WINDOW_S))) for t in (t_imu, t_att, t_out)
            )
            if min(s.stop - s.start for s in (here, tilted, given)) < 3:
                continue
            if (
                np.sqrt(np.mean(rate[here] ** 2)) > QUIET_RATE_RADPS
                or np.abs(np.linalg.norm(acc[here].mean(axis=0)) - GRAVITY_MPS2) > QUIET_ACC_MPS2
                or tilt[tilted].max() > QUIET_TILT_RAD
            ):
                continue
            voltage_v = float(np.interp(start_s + 0.5 * WINDOW_S, t_bat, volts))
            thrust_n = -vehicle_kg * float(acc[here, 2].mean()) + load_kg * GRAVITY_MPS2 * math.cos(
                float(tilt[tilted].mean())
            )
            throttle = float(level[given].mean())
            if math.isfinite(throttle + voltage_v) and voltage_v > 1.0:
                rows.append(HoverRow(throttle, voltage_v, thrust_n))
    return rows


def fit_hover(rows: Sequence[HoverRow], thrust: Thrust) -> ThrustCurve:
    """Fit scale and exponent of the configured curve to hover; its shape stays, for one weight shows one thrust.

    Parameters
    ----------
    rows : sequence of HoverRow
    thrust : Thrust
        The curve that is scaled.

    Raises
    ------
    LogFormatError
        If there are fewer than `WINDOWS_MIN` quiet seconds in the air, or the configured curve is another vehicle's.

    Notes
    -----
    log F = log scale + n log(V / V0) + log f(x) is linear in both. The interval is that of a delete-one jackknife over
    `BLOCKS` consecutive stretches. Scale and exponent tell the curve only near the hover's throttle, and the exponent
    leans on the configured curve's slope there.
    """
    flown = [row for row in rows if _curve_n(thrust, row.throttle) > FLOWN_SHARE * row.thrust_n > 0.0]
    if rows and not flown:
        first = rows[0]
        raise LogFormatError(
            f"the configured curve gives {_curve_n(thrust, first.throttle):.3g} N at throttle {first.throttle:.2f}, "
            f"where {first.thrust_n:.3g} N were flown; expected the curve of this vehicle"
        )
    if len(flown) < WINDOWS_MIN:
        raise LogFormatError(f"{len(flown)} quiet seconds of hover; expected at least {WINDOWS_MIN}")
    x, voltage, force = (
        np.array(column) for column in zip(*((r.throttle, r.voltage_v, r.thrust_n) for r in flown), strict=True)
    )
    curve = np.asarray(_curve_n(thrust, x))
    ratio = voltage / thrust.voltage_nominal_v
    spread = float(np.ptp(voltage)) / thrust.voltage_nominal_v
    fitted = spread >= VOLTAGE_SPREAD_MIN

    def solve(keep: FloatArray) -> FloatArray:
        left = np.log(force[keep] / curve[keep])
        if not fitted:
            return np.array(
                [float(np.mean(left - thrust.voltage_exponent * np.log(ratio[keep]))), thrust.voltage_exponent]
            )
        columns = np.column_stack([np.ones(keep.sum()), np.log(ratio[keep])])
        found: FloatArray = np.linalg.lstsq(columns, left)[0]
        return found

    everything = np.ones(len(flown), dtype=bool)
    log_scale, exponent = solve(everything).tolist()
    blocks = np.array_split(np.arange(len(flown)), BLOCKS)
    parts = []
    for block in blocks:
        keep = everything.copy()
        keep[block] = False
        parts.append(solve(keep))
    std = np.sqrt((BLOCKS - 1.0) / BLOCKS * np.sum((np.array(parts) - np.mean(parts, axis=0)) ** 2, axis=0))
    reach = student_quantile(BLOCKS - 1) * std
    scale = math.exp(log_scale)

    def scaled(value: float) -> Value:
        ends = sorted((value * scale * math.exp(-reach[0]), value * scale * math.exp(reach[0])))
        return Value(value * scale, *ends)

    told = ratio**exponent * scale * curve
    return ThrustCurve(
        scaled(thrust.quadratic_n), scaled(thrust.linear_n), scaled(thrust.offset_n), thrust.voltage_nominal_v,
        Value(exponent, exponent - float(reach[1]), exponent + float(reach[1])) if fitted else None, float(exponent),
        "" if fitted else f"configured; the voltage differed by {100.0 * spread:.1f} % only",
        float(np.sqrt(np.mean((told - force) ** 2))), x, voltage, force, from_hover=True,
    )  # fmt: skip


def _curve_n(thrust: Thrust, throttle: Any) -> Any:
    """Configured curve at nominal voltage [N]."""
    return (thrust.quadratic_n * throttle + thrust.linear_n) * throttle + thrust.offset_n


def _linear(columns: FloatArray, force: FloatArray) -> tuple[FloatArray, float]:
    """Least squares and its cost."""
    found = np.asarray(np.linalg.lstsq(columns, force)[0], dtype=np.float64)
    left = force - columns @ found
    return found, float(left @ left)


def _jacobian(powers: FloatArray, ratio: FloatArray, exponent: float, curve: FloatArray) -> FloatArray:
    """Derivatives of the thrust by a, b, c and n, (n, 4)."""
    factor = ratio**exponent
    jacobian: FloatArray = np.column_stack([powers * factor[:, None], factor * np.log(ratio) * (powers @ curve)])
    return jacobian
