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
"""Angles and rates of the heading frame; the force is that on the vehicle besides its known drag, in NED."""


def write_reports(file: TextIO, reports: Sequence[SwingReport]) -> None:
    """Write the reports as CSV."""
    file.write(",".join(COLUMNS) + "\n")
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
        row = ",".join(f"{value:.9g}" for value in values)
        file.write(f"{report.t_boot_s:.6f},{row},{report.health.value}\n")
