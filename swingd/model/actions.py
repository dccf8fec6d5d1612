"""Everything that leaves the pipeline, in SI units, radians and named frames."""

from dataclasses import dataclass
from enum import Enum, IntEnum

from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.events import SetpointUse, Stream, Vec3


class Health(Enum):
    """How far swingd can be trusted at this instant."""

    INIT = "init"
    """Inputs are missing or the filter is still settling."""
    READY = "ready"
    """The estimate is good; no correction is being given."""
    ACTIVE = "active"
    """The estimate is good and the correction is in the setpoints."""
    DEGRADED = "degraded"
    """An input is late or the estimate doubtful; the correction fades."""
    FAULT = "fault"
    """An input is gone or the filter diverged; no correction."""


class Severity(IntEnum):
    """MAV_SEVERITY."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the autopilot is asked to do, local NED; components outside ``use`` are to be ignored."""

    t_boot_s: float
    """Stamp of the state it answers, on the autopilot's clock [s]."""
    use: SetpointUse
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    acc_ned_mps2: Vec3
    yaw_rad: float
    yaw_rate_radps: float


@dataclass(frozen=True, slots=True)
class PassSetpoint:
    """Forward the application's setpoint that is being handled as it came: no correction meets it now."""


@dataclass(frozen=True, slots=True)
class SwingReport:
    """The estimate at one filter step; angles and rates of the heading frame."""

    t_boot_s: float
    xi_rad: float
    zeta_rad: float
    xi_rate_radps: float
    zeta_rate_radps: float
    force_ned_n: Vec3
    """Estimated disturbance force on the vehicle besides the configured drag [N]."""
    xi_std_rad: float
    zeta_std_rad: float
    thrust_n: float
    thrust_scale: float
    nis: float
    """Normalised innovation squared, 3 degrees of freedom."""
    correction_acc_ned_mps2: Vec3
    correction_vel_ned_mps: Vec3
    health: Health
    payload_mass_kg: float | None = None
    """As weighed in flight; None where it is not known."""
    payload_mass_std_kg: float | None = None
    disturbance: DisturbanceEstimate | None = None
    """None where no source is configured."""
    feed_forward_acc_ned_mps2: Vec3 = (0.0, 0.0, 0.0)
    """Acceleration set against the disturbance, beside the correction of the swing."""
    applied_ned_n: Vec3 = (0.0, 0.0, 0.0)
    """Force on the vehicle that the filter was told of: thrust, known drag, what the hook's motion takes [N]."""
    thrust_known: bool = True
    """False where the thrust was inferred from the acceleration."""


@dataclass(frozen=True, slots=True)
class StatusText:
    """A line for the pilot and the log; the host limits nothing, the pipeline does."""

    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """Ask the autopilot for a stream."""

    stream: Stream
    rate_hz: float


@dataclass(frozen=True, slots=True)
class ClockRequest:
    """Ask for the autopilot's clock: the answer tells how long the link takes there and back."""

    t_mono_s: float


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """swingd is alive, in this state."""

    health: Health


Action = Setpoint | PassSetpoint | SwingReport | StatusText | StreamRequest | ClockRequest | Heartbeat
