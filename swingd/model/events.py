"""Everything that enters the pipeline, in SI units, radians and named frames.

Every event carries ``t_mono_s``, the host's monotonic clock at its arrival, injected by the host; samples carry besides
``t_boot_s``, the autopilot's own stamp. Integration uses ``t_boot_s`` only, ages use ``t_mono_s`` only.
"""

from dataclasses import dataclass
from enum import Enum, IntFlag

from swingd.model.parameters import Parameters, ShaperName

Vec3 = tuple[float, float, float]
"""Three components along the axes of the frame that the name gives."""


class FlightMode(Enum):
    """What the autopilot's mode means to swingd."""

    UNKNOWN = "unknown"
    OFFBOARD = "offboard"
    """PX4 OFFBOARD, ArduPilot GUIDED: the autopilot follows external setpoints."""
    OTHER = "other"


class AutopilotKind(Enum):
    """Whose reading of modes, masks and frames applies."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"
    OTHER = "other"


class LandedState(Enum):
    """The autopilot's land detector (MAV_LANDED_STATE)."""

    UNKNOWN = "unknown"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKING_OFF = "taking_off"
    LANDING = "landing"


class Stream(Enum):
    """An input that swingd asks the autopilot for."""

    IMU = "imu"
    ATTITUDE = "attitude"
    THROTTLE = "throttle"
    MOTORS = "motors"
    BATTERY = "battery"
    LOCAL_POSITION = "local_position"
    LANDED_STATE = "landed_state"
    REMOTE_CONTROL = "remote_control"

    # Enum's own hash runs in the interpreter, and every sample is counted and watched by its stream.
    __hash__ = object.__hash__


@dataclass(frozen=True, slots=True)
class Imu:
    """One inertial sample (HIGHRES_IMU; ArduPilot also RAW_IMU, SCALED_IMU)."""

    t_mono_s: float
    t_boot_s: float
    acc_frd_mps2: Vec3
    """Specific force at the IMU, bias removed by the autopilot [m/s^2]."""
    gyro_frd_radps: Vec3


@dataclass(frozen=True, slots=True)
class Attitude:
    """Attitude of the body (ATTITUDE): 3-2-1 Euler angles of ned_from_frd."""

    t_mono_s: float
    t_boot_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Throttle:
    """Commanded collective thrust, 0..1 (ATTITUDE_TARGET.thrust; ArduPilot also VFR_HUD.throttle)."""

    t_mono_s: float
    t_boot_s: float
    throttle: float


@dataclass(frozen=True, slots=True)
class Motors:
    """Outputs to the motors, each normalised to 0..1 (ACTUATOR_OUTPUT_STATUS, SERVO_OUTPUT_RAW)."""

    t_mono_s: float
    t_boot_s: float
    outputs: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Battery:
    """Voltage of the pack that feeds the motors."""

    t_mono_s: float
    voltage_v: float


@dataclass(frozen=True, slots=True)
class LocalPosition:
    """The autopilot's position and velocity estimate (LOCAL_POSITION_NED)."""

    t_mono_s: float
    t_boot_s: float
    pos_ned_m: Vec3
    vel_ned_mps: Vec3


class SightingFrame(Enum):
    """What the coordinates of a `LoadSighting` count from."""

    BODY_FRD = "body_frd"
    """From the camera's reference point on the vehicle: forward, right, down."""
    LOCAL_NED = "local_ned"
    """From the autopilot's local origin: north, east, down."""


@dataclass(frozen=True, slots=True)
class LoadSighting:
    """A camera saw the load (LANDING_TARGET)."""

    t_mono_s: float
    t_boot_s: float
    """When the picture was taken, as if the messages that come the quickest had taken no time."""
    position_m: Vec3
    frame: SightingFrame


@dataclass(frozen=True, slots=True)
class AutopilotState:
    """Arming and mode, from the autopilot's HEARTBEAT."""

    t_mono_s: float
    armed: bool
    mode: FlightMode
    kind: AutopilotKind = AutopilotKind.PX4


@dataclass(frozen=True, slots=True)
class Landed:
    """State of the autopilot's land detector."""

    t_mono_s: float
    state: LandedState


@dataclass(frozen=True, slots=True)
class AutopilotRestart:
    """The autopilot's clock went back or jumped: every stamp kept so far is void."""

    t_mono_s: float
    step_s: float
    """New clock minus the expected one [s]."""


@dataclass(frozen=True, slots=True)
class StreamRefused:
    """The autopilot denied a stream's interval."""

    t_mono_s: float
    stream: Stream
    reason: str


@dataclass(frozen=True, slots=True)
class VoltageCompensation:
    """Whether the autopilot scales its motor outputs with the voltage, after the throttle that it reports."""

    t_mono_s: float
    active: bool


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """The autopilot answered a `ClockRequest`."""

    t_mono_s: float
    round_trip_s: float
    """From the request to the answer, both on the host's clock [s]."""


class SetpointUse(IntFlag):
    """Which groups of a setpoint are meant (bits of POSITION_TARGET_TYPEMASK inverted, per axis)."""

    NONE = 0
    POS_N = 1
    POS_E = 2
    POS_D = 4
    VEL_N = 8
    VEL_E = 16
    VEL_D = 32
    ACC_N = 64
    ACC_E = 128
    ACC_D = 256
    YAW = 1024
    YAW_RATE = 2048
    VEL = VEL_N | VEL_E | VEL_D
    POS = POS_N | POS_E | POS_D
    ACC = ACC_N | ACC_E | ACC_D


@dataclass(frozen=True, slots=True)
class AppSetpoint:
    """A setpoint that an application asks for, resolved into local NED; components outside ``use`` are ignored."""

    t_mono_s: float
    use: SetpointUse
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    acc_ned_mps2: Vec3
    yaw_rad: float
    yaw_rate_radps: float
    source: int = 0
    """Who sent it: the same number for the same component behind the same port; 0 for a reference of mode ``hold``."""
    shaper: ShaperName = ShaperName.NONE


@dataclass(frozen=True, slots=True)
class UnmetSetpoint:
    """An application's setpoint that the autopilot follows and no correction meets, such as an attitude."""

    t_mono_s: float
    source: int


@dataclass(frozen=True, slots=True)
class CorrectionSwitch:
    """The user enables or disables the correction."""

    t_mono_s: float
    enabled: bool


class PathOrder(Enum):
    """What a ground station orders in mode ``path``."""

    PAUSE = "pause"
    """Hold the load where it can stop."""
    CONTINUE = "continue"
    """Go on towards the next waypoint; after an abort, from the first one."""
    ABORT = "abort"
    """Leave the path and forget its progress."""


@dataclass(frozen=True, slots=True)
class PathCommand:
    """An order to mode ``path``."""

    t_mono_s: float
    order: PathOrder


@dataclass(frozen=True, slots=True)
class Mission:
    """The autopilot's mission was read."""

    t_mono_s: float
    waypoints_ned_m: tuple[Vec3, ...]
    """Places of the load; empty where it cannot be led along them."""
    problem: str
    """Why not; empty where it can."""


@dataclass(frozen=True, slots=True)
class ParametersChange:
    """New parameters, whole."""

    t_mono_s: float
    parameters: Parameters


@dataclass(frozen=True, slots=True)
class Tick:
    """The host's clock, at a steady rate whatever the link does."""

    t_mono_s: float


Event = (
    Imu
    | Attitude
    | Throttle
    | Motors
    | Battery
    | LocalPosition
    | LoadSighting
    | AutopilotState
    | Landed
    | AutopilotRestart
    | StreamRefused
    | VoltageCompensation
    | RoundTrip
    | AppSetpoint
    | UnmetSetpoint
    | CorrectionSwitch
    | PathCommand
    | Mission
    | ParametersChange
    | Tick
)
