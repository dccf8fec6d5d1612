"""Several vehicles that carry one load: how they are rigged, what they tell, and what follows from it."""

from dataclasses import dataclass
from enum import Enum

from swingd.model.actions import Health
from swingd.model.estimate import FloatArray
from swingd.model.events import Attitude, AutopilotRestart, LocalPosition, Vec3

VEHICLES_MAX = 8
VEHICLES_MIN = 2
TETHERS_MAX = 2
"""Of one vehicle: where the force of more than two tethers points is not told by their lengths."""


class DirectionSource(Enum):
    """What tells the direction of a vehicle's cable."""

    SWING = "swing"
    """The swing angles: of a load that hangs from this vehicle alone, or below vertical tethers."""
    FORCE = "force"
    """The whole force besides thrust and weight (`disturbance.source`), which knows nothing of pendulums: of a load
    that others pull aside. Wind on the vehicle is taken for the cable's pull."""


@dataclass(frozen=True, slots=True)
class RiggedTether:
    """One tether from a vehicle's hook to the load."""

    length_m: float
    anchor_frd_m: Vec3
    """Lower end on the load, from its centre of gravity."""
    length_std_m: float = 0.01
    winch_gain: float = 0.0
    """Metres that it gets longer for each unit that the winch tells."""


@dataclass(frozen=True, slots=True)
class RiggedVehicle:
    """One vehicle and what it holds."""

    system_id: int
    link: str
    """URL on which its autopilot and its swingd are heard."""
    tethers: tuple[RiggedTether, ...]
    hook_frd_m: Vec3 = (0.0, 0.0, 0.0)
    """From its centre of gravity."""
    origin_ned_m: Vec3 | None = None
    """Origin of its local frame in the common frame; None: by GPS_GLOBAL_ORIGIN."""
    pos_std_m: float = 0.02
    """Of its position against the other vehicles', each axis."""
    vel_std_mps: float = 0.05
    direction_std_rad: float = 0.02
    """Of the cable's direction, besides what the estimator claims."""
    direction: DirectionSource = DirectionSource.SWING
    winch: str = ""
    """NAMED_VALUE_FLOAT that tells what its winch has turned; empty: it has none."""


@dataclass(frozen=True, slots=True)
class SharedLoad:
    """What is known of the load without the vehicles."""

    roll_rad: float = 0.0
    roll_std_rad: float | None = None
    """None: not known."""
    pitch_rad: float = 0.0
    pitch_std_rad: float | None = None
    winch_pitch: tuple[tuple[float, float], ...] = ()
    """Rows of winch value (mean of the winches) and pitch [rad] there; with it ``pitch_rad`` is not used."""


@dataclass(frozen=True, slots=True)
class FormationParameters:
    """Everything that `swingd cooperate` is configured by."""

    vehicles: tuple[RiggedVehicle, ...]
    load: SharedLoad = SharedLoad()
    outputs: tuple[str, ...] = ()
    """URLs to which the pose is sent."""
    system_id: int = 200
    """That the pose is sent as."""
    rate_hz: float = 50.0
    stream_rate_hz: float = 50.0
    """Attitude and position that each autopilot is asked for; 0: nothing is asked."""
    late_s: float = 0.25
    """Beyond this age of a vehicle the pose is doubtful."""
    lost_s: float = 1.0
    """Beyond this age a vehicle is not used."""
    record: str = ""
    """.tlog to write; empty: none."""

    @property
    def origins_are_configured(self) -> bool:
        """Whether the local frames are related by the configuration."""
        return all(vehicle.origin_ned_m is not None for vehicle in self.vehicles)


# ---- what vehicles tell, beside `Attitude`, `LocalPosition` and `AutopilotRestart`


@dataclass(frozen=True, slots=True)
class CableSwing:
    """Direction of the cable by the swingd beside a vehicle, heading frame."""

    t_mono_s: float
    t_boot_s: float
    xi_rad: float
    zeta_rad: float
    xi_rate_radps: float
    zeta_rate_radps: float
    xi_std_rad: float
    zeta_std_rad: float
    health: Health


@dataclass(frozen=True, slots=True)
class CableForce:
    """Whole force on a vehicle besides thrust and weight, by the swingd beside it: its cables' pull."""

    t_mono_s: float
    t_boot_s: float
    force_ned_n: Vec3
    force_std_n: Vec3


@dataclass(frozen=True, slots=True)
class WinchTurned:
    """What a vehicle's winch has turned."""

    t_mono_s: float
    t_boot_s: float
    winch: float


@dataclass(frozen=True, slots=True)
class LocalOrigin:
    """Where the origin of a vehicle's local frame lies."""

    t_mono_s: float
    lat_rad: float
    lon_rad: float
    alt_amsl_m: float
    earth_radius_m: float
    """Of the sphere on which its autopilot turns degrees into metres."""


@dataclass(frozen=True, slots=True)
class ClockAnswer:
    """A vehicle has answered with its boot clock."""

    t_mono_s: float
    sent_s: float
    """When it was asked, on the host's clock."""
    t_boot_s: float


VehicleEvent = (
    Attitude | LocalPosition | AutopilotRestart | CableSwing | CableForce | WinchTurned | LocalOrigin | ClockAnswer
)


# ---- what follows


@dataclass(frozen=True, slots=True)
class VehicleCondition:
    """How one vehicle is heard."""

    age_s: float | None
    """Since the instant of the oldest of its newest samples; None while one is missing."""
    used: bool
    clock_std_s: float | None
    """How well its clock is known; None before the first sample."""
    missing: tuple[str, ...]
    """What has not been heard since it began or restarted."""


@dataclass(frozen=True, slots=True)
class LoadMotion:
    """Pose and motion of the load at one instant, common frame."""

    t_mono_s: float
    """The instant, on the host's clock."""
    pos_ned_m: FloatArray
    ned_from_frd: FloatArray
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    pose_cov: FloatArray
    """(6, 6) of position and roll, pitch, yaw."""
    vel_ned_mps: FloatArray
    rate_frd_radps: FloatArray
    motion_cov: FloatArray
    """(6, 6) of velocity (ned) and rates (frd)."""
    chi2: float
    dof: int


@dataclass(frozen=True, slots=True)
class FormationReport:
    """What is known at one tick."""

    t_mono_s: float
    health: Health
    reason: str
    """Empty where it is good."""
    motion: LoadMotion | None
    """None while there is no pose to be told."""
    vehicles: tuple[VehicleCondition, ...]
    resets: int
    """How often the pose has begun anew."""
    origin: LocalOrigin | None
    """Of the common frame; None where it is not known, or configured."""
