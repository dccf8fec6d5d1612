"""DEBUG_FLOAT_ARRAY ``SWING``: the estimate on the wire, for plots, ground tools and the autopilot's own log."""

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.model.actions import Health, SwingReport
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.events import Vec3

NAME = "SWING"
"""DEBUG_FLOAT_ARRAY.name."""
ARRAY_ID = 1
"""DEBUG_FLOAT_ARRAY.array_id: changes where a field changes its meaning; others are added behind."""
FIELDS = (
    "xi_rad",
    "zeta_rad",
    "xi_rate_radps",
    "zeta_rate_radps",
    "force_n_n",
    "force_e_n",
    "force_d_n",
    "xi_std_rad",
    "zeta_std_rad",
    "thrust_n",
    "thrust_scale",
    "nis",
    "correction_acc_n_mps2",
    "correction_acc_e_mps2",
    "correction_acc_d_mps2",
    "correction_vel_n_mps",
    "correction_vel_e_mps",
    "correction_vel_d_mps",
    "health",
    "disturbance_n_n",
    "disturbance_e_n",
    "disturbance_d_n",
    "disturbance_n_std_n",
    "disturbance_e_std_n",
    "disturbance_d_std_n",
    "feed_forward_n_mps2",
    "feed_forward_e_mps2",
    "feed_forward_d_mps2",
)
"""Meaning of DEBUG_FLOAT_ARRAY.data[0], data[1], ...; the rest of the 58 floats is zero."""

HEALTH_CODES = {Health.INIT: 0, Health.READY: 1, Health.ACTIVE: 2, Health.DEGRADED: 3, Health.FAULT: 4}
"""How `Health` is written as a number."""

_HEALTH_OF_CODE = {code: health for health, code in HEALTH_CODES.items()}
_FLOAT32_MAX = 3.4028234e38
_SIZE = 58
_NO_DISTURBANCE: Vec3 = (0.0, 0.0, 0.0)
_PADDING = (0.0,) * (_SIZE - len(FIELDS))


def float32(value: float) -> float:
    """Clip a number to what a float of 32 bits can hold; NaN stays NaN."""
    if value > _FLOAT32_MAX:
        return _FLOAT32_MAX
    if value < -_FLOAT32_MAX:
        return -_FLOAT32_MAX
    return value


def encode(report: SwingReport) -> Any:
    """Return the DEBUG_FLOAT_ARRAY message of a report; ``time_usec`` is the autopilot's boot time.

    Parameters
    ----------
    report : SwingReport
        ``t_boot_s`` must be finite and not negative.
    """
    values = (
        report.xi_rad,
        report.zeta_rad,
        report.xi_rate_radps,
        report.zeta_rate_radps,
        *report.force_ned_n,
        report.xi_std_rad,
        report.zeta_std_rad,
        report.thrust_n,
        report.thrust_scale,
        report.nis,
        *report.correction_acc_ned_mps2,
        *report.correction_vel_ned_mps,
        float(HEALTH_CODES[report.health]),
        *(_NO_DISTURBANCE if report.disturbance is None else report.disturbance.force_ned_n),
        *(_NO_DISTURBANCE if report.disturbance is None else report.disturbance.force_std_n),
        *report.feed_forward_acc_ned_mps2,
    )
    data = [*map(float32, values), *_PADDING]
    return mavlink.MAVLink_debug_float_array_message(round(report.t_boot_s * 1e6), NAME.encode(), ARRAY_ID, data)


def decode(message: Any) -> SwingReport | None:
    """Return the report in a DEBUG_FLOAT_ARRAY message, or None if it holds something else or another layout."""
    if message.name != NAME or message.array_id != ARRAY_ID:
        return None
    data = message.data
    code = data[18]
    health = _HEALTH_OF_CODE.get(int(code)) if math.isfinite(code) else None
    if health is None:
        return None

    def vector(first: int) -> Vec3:
        return data[first], data[first + 1], data[first + 2]

    return SwingReport(
        t_boot_s=message.time_usec * 1e-6,
        xi_rad=data[0],
        zeta_rad=data[1],
        xi_rate_radps=data[2],
        zeta_rate_radps=data[3],
        force_ned_n=vector(4),
        xi_std_rad=data[7],
        zeta_std_rad=data[8],
        thrust_n=data[9],
        thrust_scale=data[10],
        nis=data[11],
        correction_acc_ned_mps2=vector(12),
        correction_vel_ned_mps=vector(15),
        health=health,
        # A deviation of zero is that of an estimate which nobody makes; doubts are not on the wire.
        disturbance=DisturbanceEstimate(vector(19), vector(22), "") if any(data[22:25]) else None,
        feed_forward_acc_ned_mps2=vector(25),
    )
