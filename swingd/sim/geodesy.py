"""Where the simulated autopilot flies: a place on a sphere, the origin of its local frame."""

from math import cos, degrees, radians

LATITUDE_DEG = 47.397742
LONGITUDE_DEG = 8.545594
ALTITUDE_M = 488.0
"""Above mean sea level."""

_RADIUS_M = 6371000.0
_ACROSS = cos(radians(LATITUDE_DEG))


def global_of(pos_ned_m: tuple[float, float, float]) -> tuple[float, float, float]:
    """Latitude and longitude [deg] and altitude above mean sea level [m] of a local position."""
    return (
        LATITUDE_DEG + degrees(pos_ned_m[0] / _RADIUS_M),
        LONGITUDE_DEG + degrees(pos_ned_m[1] / _RADIUS_M / _ACROSS),
        ALTITUDE_M - pos_ned_m[2],
    )


def local_of(latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """North and east of the origin [m]."""
    return (
        radians(latitude_deg - LATITUDE_DEG) * _RADIUS_M,
        radians(longitude_deg - LONGITUDE_DEG) * _RADIUS_M * _ACROSS,
    )
