"""The estimate as a table, one row for each filter step."""

from collections.abc import Sequence
from typing import TextIO

from swingd.model.actions import SwingReport

COLUMNS = (
    "t_boot_s",
    "xi_rad",
    "zeta_rad",
    "xi_rate_radps",
    "zeta_rate_radps",
    "fax_n",
    "fay_n",
    "faz_n",
    "xi_std_rad",
    "zeta_std_rad",
    "thrust_n",
    "thrust_scale",
    "health",
)
"""Angles and rates of the heading frame; the force is that on the vehicle besides known drag and load, in NED."""
DISTURBANCE_COLUMNS = ("disturbance_n_n", "disturbance_e_n", "disturbance_d_n", "disturbance_doubt")
"""The whole force besides thrust and weight, and why it is not to be acted on; where a source of it is configured."""


def write_reports(file: TextIO, reports: Sequence[SwingReport]) -> None:
    """Write the reports as CSV."""
    whole = any(report.disturbance is not None for report in reports)
    file.write(",".join(COLUMNS + (DISTURBANCE_COLUMNS if whole else ())) + "\n")
    for report in reports:
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
        )
        row = f"{report.t_boot_s:.6f},{_joined(values)},{report.health.value}"
        if report.disturbance is not None:
            row += f",{_joined(report.disturbance.force_ned_n)},{report.disturbance.doubt}"
        elif whole:
            row += ",,,,"
        file.write(row + "\n")


def _joined(values: Sequence[float]) -> str:
    return ",".join(f"{value:.9g}" for value in values)
