"""The truth as a table: the columns are those of the truth files of recorded PX4 flights, so one reader serves both."""

from collections.abc import Sequence
from typing import TextIO

from swingd.sim.plant import Truth

COLUMNS = (
    "t_boot_s",
    "swing_lateral_rad",
    "swing_longitudinal_rad",
    "swing_lateral_rate_rad_s",
    "swing_longitudinal_rate_rad_s",
    "tension_n",
    "thrust_n",
    *("veh_n_m", "veh_e_m", "veh_d_m", "veh_vn_m_s", "veh_ve_m_s", "veh_vd_m_s"),
    *("veh_an_m_s2", "veh_ae_m_s2", "veh_ad_m_s2"),
    *("load_n_m", "load_e_m", "load_d_m", "load_vn_m_s", "load_ve_m_s", "load_vd_m_s"),
    *("qw", "qx", "qy", "qz"),
    *("wind_n_m_s", "wind_e_m_s", "wind_d_m_s"),
    *("heading_rad", "attached", "taut", "grounded", "tscale"),
    *("u0", "u1", "u2", "u3"),
    *("sf_x_m_s2", "sf_y_m_s2", "sf_z_m_s2"),
    *("p_rad_s", "q_rad_s", "r_rad_s"),
    *("load_kg", "cable_m"),
)
"""Lateral is xi, longitudinal is zeta; swing columns are nan while nothing is attached."""


def truth_row(truth: Truth) -> tuple[float, ...]:
    """Values of one instant in the order of `COLUMNS`."""
    return (
        truth.t_boot_s,
        truth.xi_rad,
        truth.zeta_rad,
        truth.xi_rate_radps,
        truth.zeta_rate_radps,
        truth.tension_n,
        truth.thrust_n,
        *truth.pos_ned_m,
        *truth.vel_ned_mps,
        *truth.acc_ned_mps2,
        *truth.load_pos_ned_m,
        *truth.load_vel_ned_mps,
        *truth.ned_from_frd,
        *truth.wind_ned_mps,
        truth.yaw_rad,
        float(truth.attached),
        float(truth.taut),
        float(truth.grounded),
        truth.thrust_factor,
        *truth.rotor_commands,
        *truth.specific_force_frd_mps2,
        *truth.rates_frd_radps,
        truth.load_mass_kg,
        truth.cable_length_m,
    )


class TruthWriter:
    """Writes truth as CSV.

    Parameters
    ----------
    file : text file
        Open for writing; the caller closes it.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        file.write(",".join(COLUMNS) + "\n")

    def write(self, truth: Truth) -> None:
        """Append one row."""
        self._file.write(_line(truth_row(truth)))


def _line(values: Sequence[float]) -> str:
    return ",".join(f"{value:.6g}" if i else f"{value:.3f}" for i, value in enumerate(values)) + "\n"
