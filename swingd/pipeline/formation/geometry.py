"""Rotations, the cable's direction, and where the local frames of several vehicles begin."""

import math

import numpy as np

from swingd.model.estimate import FloatArray
from swingd.model.events import Vec3
from swingd.model.formation import LocalOrigin


def rotation_of(angles_rad: FloatArray) -> FloatArray:
    """Return ned_from_frd (3, 3) of roll, pitch, yaw."""
    (s_r, s_p, s_y), (c_r, c_p, c_y) = np.sin(angles_rad), np.cos(angles_rad)
    return np.array(
        [
            [c_p * c_y, s_r * s_p * c_y - c_r * s_y, c_r * s_p * c_y + s_r * s_y],
            [c_p * s_y, s_r * s_p * s_y + c_r * c_y, c_r * s_p * s_y - s_r * c_y],
            [-s_p, s_r * c_p, c_r * c_p],
        ]
    )


def cable_of(xi_zeta_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the cable's direction (3,) in the heading frame, and its derivative by xi and zeta, (3, 2)."""
    (s_xi, s_zeta), (c_xi, c_zeta) = np.sin(xi_zeta_rad), np.cos(xi_zeta_rad)
    along = np.array([s_zeta, -s_xi * c_zeta, c_xi * c_zeta])
    across = np.array([[0.0, c_zeta], [-c_xi * c_zeta, s_xi * s_zeta], [-s_xi * c_zeta, -c_xi * s_zeta]])
    return along, across


def offset_ned_m(origin: LocalOrigin, reference: LocalOrigin) -> Vec3:
    """Return where an origin lies in the frame of another: azimuthal equidistant, as autopilots map degrees.

    On the autopilot's own sphere, because its local positions are of it: so two vehicles in one place agree.
    """
    d_lon = origin.lon_rad - reference.lon_rad
    sin_0, cos_0 = math.sin(reference.lat_rad), math.cos(reference.lat_rad)
    sin_1, cos_1 = math.sin(origin.lat_rad), math.cos(origin.lat_rad)
    north, east = cos_0 * sin_1 - sin_0 * cos_1 * math.cos(d_lon), cos_1 * math.sin(d_lon)
    sine = math.hypot(north, east)
    arc = math.atan2(sine, sin_0 * sin_1 + cos_0 * cos_1 * math.cos(d_lon))
    scale_m = origin.earth_radius_m * (arc / sine if sine > 0.0 else 1.0)
    return scale_m * north, scale_m * east, reference.alt_amsl_m - origin.alt_amsl_m
