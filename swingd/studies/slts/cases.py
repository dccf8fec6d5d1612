"""What is flown: paths, sensors, gains and filters. Only speeds, sizes and masses are printed in the paper."""

from dataclasses import dataclass, field, replace
from math import cos, pi, radians, sin

from swingd.control.path_following import PathSettings
from swingd.estimation.gp_ekf import GpEkfSettings
from swingd.model.events import Vec3
from swingd.studies.drones2023.vehicles import Vehicle
from swingd.studies.slts.vehicles import CABLE_M, FLOWN, SIMULATED

ALTITUDE_M = 10.0
"""Of the load over the ned origin."""
CRUISE_MPS = 2.0


@dataclass(frozen=True, slots=True)
class Attitude:
    """Gains of the attitude tracking (12), which the paper does not print."""

    frequency_radps: float = 14.0
    """Natural frequency of the tilt."""
    damping: float = 0.8


@dataclass(frozen=True, slots=True)
class Sensors:
    """What the autopilot and the camera measure."""

    tilt_std_rad: float = 0.003
    tilt_time_s: float = 10.0
    gyro_radps: float = 0.01
    acc_mps2: float = 0.14
    acc_bias_frd_mps2: Vec3 = (0.03, -0.02, 0.04)
    pos_std_m: tuple[float, float] = (0.06, 0.03)
    """Level, vertical; about the mean, for where the autopilot's origin lies is no error of following."""
    vel_std_mps: tuple[float, float] = (0.022, 0.006)
    gnss_time_s: float = 3.0
    gnss_smoothing_s: float = 0.3
    gnss_hz: float = 25.0
    gnss_delay_s: float = 0.02
    camera_hz: float = 15.0
    camera_delay_s: float = 0.08
    camera_std_m: float = 0.03
    camera_std_share: float = 0.02
    camera_half_angle_rad: float = radians(30.0)
    dropout_share: float = 0.1
    dropout_s: float = 0.5


SENSORS_IN_WIND = Sensors(pos_std_m=(0.07, 0.09), vel_std_mps=(0.055, 0.055), gnss_time_s=5.0)
"""The autopilot's position and velocity in wind and with a noisy IMU; those of `Sensors` are of a calm flight."""


def path_settings(vehicle: Vehicle, cruise_mps: float = CRUISE_MPS) -> PathSettings:
    """Return the path following of a vehicle, its default gains: one set for every flight."""
    return PathSettings(vehicle.mass_kg, vehicle.load_mass_kg, CABLE_M, cruise_mps)


LOAD_FORCE_NOISE_N = 0.04
"""What the filters take to blow at the load in the calm, a small model error [N/sqrt(Hz)]."""
LOAD_FORCE_NOISE_IN_WIND_N = 0.1


def filter_settings(vehicle: Vehicle, load_force_noise_n: float = LOAD_FORCE_NOISE_N) -> GpEkfSettings:
    """Return the filters' settings of a vehicle."""
    return GpEkfSettings(vehicle.mass_kg, vehicle.load_mass_kg, CABLE_M, load_force_noise_n=load_force_noise_n)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A path of one vehicle."""

    name: str
    waypoints_ned_m: tuple[Vec3, ...]
    """Of the load."""
    vehicle: Vehicle = SIMULATED
    start_ned_m: Vec3 | None = None
    """Of the load; None: the first waypoint."""
    thrust_factor: float = 1.0
    """True thrust over the one that is believed."""
    wind_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    turbulence_6m_mps: float = 0.0
    path: PathSettings = field(default_factory=lambda: path_settings(SIMULATED))
    filters: GpEkfSettings = field(default_factory=lambda: filter_settings(SIMULATED))
    """Of both; one of them lacks the Gaussian process."""
    pos_std_m: float = 0.1
    """Of the vehicle's position, as the filters take it: errors that last for seconds count as more than they are."""
    vel_std_mps: float = 0.1
    yaw_rad: float = 0.0
    hold_s: float = 5.0
    """At the last waypoint."""
    duration_max_s: float = 300.0
    attitude: Attitude = field(default_factory=Attitude)
    sensors: Sensors = field(default_factory=Sensors)


def square(side_m: float) -> tuple[Vec3, ...]:
    """Return a square and back to its first corner."""
    a, d = side_m, -ALTITUDE_M
    return ((0.0, 0.0, d), (a, 0.0, d), (a, a, d), (0.0, a, d), (0.0, 0.0, d))


def circle(radius_m: float, segments: int) -> tuple[Vec3, ...]:
    """Return a circle in straight segments, from its southernmost point and back to it."""
    turns = [2.0 * pi * i / segments for i in range(segments + 1)]
    return tuple((-radius_m * cos(turn), radius_m * sin(turn), -ALTITUDE_M) for turn in turns)


SQUARE = Scenario("square", square(80.0))
CIRCLE = Scenario("circle", circle(15.0, 10))
OUTDOOR = Scenario(
    "outdoor",
    square(10.0),
    FLOWN,
    start_ned_m=(0.0, 0.0, -ALTITUDE_M + 2.952),
    thrust_factor=0.85,
    wind_ned_mps=(-1.5, 1.0, 0.0),
    turbulence_6m_mps=3.0,
    path=path_settings(FLOWN),
    filters=filter_settings(FLOWN, LOAD_FORCE_NOISE_IN_WIND_N),
    sensors=SENSORS_IN_WIND,
)
SCENARIOS = (SQUARE, CIRCLE, OUTDOOR)

_TRAINING_PATHS = {
    "star": ((0, 0), (12, 5), (-6, 9), (8, -10), (10, 10), (-10, -4), (4, 13), (0, -12), (-9, 6), (11, -3), (0, 0)),
    "zigzag": ((0, 0), (6, 6), (12, 0), (18, 6), (12, 14), (4, 10), (-4, 16), (-8, 6), (-2, -3), (6, -8), (0, 0)),
    "steps": ((0, 0), (4, 0), (4, 5), (-3, 5), (-3, -4), (2, -4), (5, 2), (-1, 7), (-6, 0), (0, -6), (0, 0)),
}
TRAINING = tuple(
    Scenario(
        name,
        tuple((float(n), float(e), -ALTITUDE_M) for n, e in path),
        path=path_settings(SIMULATED, speed),
        yaw_rad=0.4,
    )
    for (name, path), speed in zip(_TRAINING_PATHS.items(), (2.5, 2.0, 1.5), strict=True)
)
"""None of their legs is one of the paths that are judged."""


def like(path: Scenario, other: Scenario) -> Scenario:
    """Return a path flown by another scenario's vehicle in its weather, with its sensors and filters."""
    return replace(
        other, name=f"{path.name} for {other.name}", waypoints_ned_m=path.waypoints_ned_m, start_ned_m=None,
        path=replace(other.path, cruise_mps=path.path.cruise_mps), yaw_rad=path.yaw_rad,
    )  # fmt: skip
