"""Every parameter of swingd, declared once: value, unit, range and meaning.

The configuration schema, the documentation and the parameter list of the ground station are derived from these classes.
Every number has both bounds, because YAML can write ``.nan`` and ``.inf``.
"""

from dataclasses import dataclass, field
from enum import Enum
from typing import Any


class Mode(Enum):
    """What the daemon does with its estimate."""

    SHADOW = "shadow"
    """Estimate and publish only."""
    HOLD = "hold"
    """Stream its own reference velocity with the correction in it."""
    INLINE = "inline"
    """Meet the setpoints of an application with the correction on their way to the autopilot."""
    PATH = "path"
    """Lead the load along waypoints."""


class Integrator(Enum):
    """Integration of the filter's mean; the covariance is always backward Euler."""

    BACKWARD_EULER = "backward_euler"
    IMPLICIT_MIDPOINT = "implicit_midpoint"
    RK4 = "rk4"


class ThrustSource(Enum):
    """Where the thrust estimate comes from."""

    AUTO = "auto"
    """Motor outputs where they arrive, else the throttle, else Remark 1."""
    MOTORS = "motors"
    THROTTLE = "throttle"
    REMARK_1 = "remark_1"
    """Reconstructed from the acceleration, Drones 2023 (14); valid near hover only."""


class MassUse(Enum):
    """What is done with the load's mass that a flight shows."""

    REPORT = "report"
    """It is told."""
    USE = "use"
    """It is told, and replaces the configured one where it differs clearly."""


class SimulatedKind(Enum):
    """What the simulated autopilot looks like from its link."""

    PX4 = "px4"
    """PX4 v1.16 on its onboard link."""
    ARDUPILOT = "ardupilot"
    """Copter 4.7: GUIDED in the place of OFFBOARD, streams on request."""


class ShaperName(Enum):
    """Input shaper of an endpoint."""

    NONE = "none"
    """Setpoints are taken as they come."""
    ZV = "zv"
    """Zero vibration: two impulses, half a period."""
    ZVD = "zvd"
    """Zero vibration and derivative: three impulses, one period; bears a wrong frequency better."""
    EI = "ei"
    """Extra insensitive: three impulses, one period; bears it best, leaving a little vibration."""


def quantity(default: Any, unit: str, low: float, high: float, text: str, mavlink: str = "") -> Any:
    """Declare a number (or a vector whose components share unit and bounds) with its unit, bounds and meaning.

    ``mavlink`` names it in the PARAM protocol, where it can be changed live.
    """
    return field(default=default, metadata={"unit": unit, "low": low, "high": high, "text": text, "mavlink": mavlink})


def choice(default: Any, text: str, names: tuple[str, ...] = (), mavlink: str = "") -> Any:
    """Declare a switch, a name (one of ``names`` where they are given) or an enumeration with its meaning.

    ``mavlink`` names a switch in the PARAM protocol, where it is 0 or 1.
    """
    return field(default=default, metadata={"text": text, "names": names, "mavlink": mavlink})


CONTENT_OF = "content_of"
"""Marks the field of a `content_of` in its metadata, with the key's name."""


def content_of(key: str) -> Any:
    """Declare the text of the file that another key of the same group names.

    It is no key itself: the loader fills it, and it travels with the parameters, so that what was recorded can be
    replayed where the file is not.
    """
    return field(default="", metadata={CONTENT_OF: key})


@dataclass(frozen=True, slots=True)
class Vehicle:
    """The multirotor without its load."""

    mass_kg: float = quantity(
        2.0, "kg", 0.05, 2000.0, "mass of the vehicle with battery, without load and cable", mavlink="SWG_VEH_MASS"
    )
    hook_frd_m: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", -10.0, 10.0, "hook from the centre of gravity: forward, right, down"
    )
    imu_frd_m: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", -10.0, 10.0, "autopilot's IMU from the centre of gravity: forward, right, down"
    )
    drag_n_per_mps: float = quantity(
        0.0,
        "N/(m/s)",
        0.0,
        1000.0,
        "horizontal drag over speed; known drag spares the filter from guessing it as wind",
        mavlink="SWG_VEH_DRAG",
    )
    drag_vertical_n_per_mps: float = quantity(0.0, "N/(m/s)", 0.0, 1000.0, "vertical drag over speed")


@dataclass(frozen=True, slots=True)
class Payload:
    """The load."""

    mass_kg: float = quantity(
        0.3, "kg", 0.005, 2000.0, "mass of the load with its hook and half of the cable", mavlink="SWG_LOAD_MASS"
    )
    estimate_mass: MassUse = choice(
        MassUse.REPORT,
        "what is done with the mass weighed after a pick-up: report, or use where it differs clearly",
    )


@dataclass(frozen=True, slots=True)
class Cable:
    """The cable."""

    length_m: float = quantity(
        1.5, "m", 0.1, 200.0, "from the hook to the load's centre of mass", mavlink="SWG_CABLE_LEN"
    )


@dataclass(frozen=True, slots=True)
class Thrust:
    """Thrust curve F = scale (V / V0)^n (a x^2 + b x + c) with x in 0..1, and its self-calibration."""

    source: ThrustSource = choice(ThrustSource.AUTO, "auto, motors, throttle or remark_1")
    quadratic_n: float = quantity(36.0, "N", -1e5, 1e5, "a: all rotors together, at nominal voltage")
    linear_n: float = quantity(8.0, "N", -1e5, 1e5, "b: all rotors together, at nominal voltage")
    offset_n: float = quantity(0.4, "N", -1e4, 1e4, "c: all rotors together, at nominal voltage")
    voltage_nominal_v: float = quantity(16.2, "V", 1.0, 1000.0, "V0: the voltage at which the curve was measured")
    voltage_exponent: float = quantity(
        2.0,
        "1",
        0.0,
        3.0,
        "n: 2 for ESCs without compensation; 0 where the autopilot or the ESC compensates",
        mavlink="SWG_THR_VEXP",
    )
    voltage_min_v: float = quantity(6.0, "V", 0.5, 1000.0, "readings below are refused")
    voltage_max_v: float = quantity(60.0, "V", 1.0, 1000.0, "readings above are refused")
    voltage_time_constant_s: float = quantity(0.5, "s", 0.0, 10.0, "low-pass on the voltage")
    motor_time_constant_s: float = quantity(0.02, "s", 0.0, 0.5, "first-order lag of the rotor's speed")
    motor_output_min: float = quantity(1000.0, "autopilot's unit", -1e4, 1e4, "motor output that means x = 0")
    motor_output_max: float = quantity(2000.0, "autopilot's unit", -1e4, 1e4, "motor output that means x = 1")
    motor_count: int = quantity(
        0, "1", 0, 16, "the first outputs drive motors; 0: all that were between min and max since arming"
    )
    motors_delay_s: float = quantity(0.0, "s", -0.1, 0.2, "from a motor output's stamp to the IMU stamp that shows it")
    throttle_delay_s: float = quantity(0.01, "s", -0.1, 0.2, "from a throttle's stamp to the IMU stamp that shows it")
    scale_rate_per_s: float = quantity(0.005, "1/s", 0.0, 0.005, "fastest change of scale; 0 switches calibration off")
    scale_range: float = quantity(0.25, "1", 0.0, 0.25, "scale stays within 1 +- this")


@dataclass(frozen=True, slots=True)
class Estimator:
    """The swing estimator."""

    name: str = choice(
        "swing_ekf",
        "estimator by name: swing_ekf; gp-ekf (thrust, position and, where there is one, a camera that sees the load; "
        "keys in gp_ekf); tether-ukf (the cable's direction from the force it is felt by, without the load's mass or "
        "wind); baselines: fgdf (linear, fading memory), pendulum (open loop)",
        names=("swing_ekf", "gp-ekf", "tether-ukf", "fgdf", "pendulum"),
    )
    rate_hz: float = quantity(100.0, "Hz", 20.0, 400.0, "filter steps per second")
    integrator: Integrator = choice(Integrator.BACKWARD_EULER, "backward_euler, implicit_midpoint or rk4, for the mean")
    max_gap_s: float = quantity(0.5, "s", 0.05, 5.0, "IMU gaps up to this are bridged, longer ones reset the filter")
    max_step_s: float = quantity(
        0.0025, "s", 0.0005, 0.1, "longer intervals are divided: backward Euler damps the swing by omega^2 step / 2"
    )
    stamp_delay_s: float = quantity(
        0.007, "s", 0.0, 0.1, "age of the state that a stamp of the autopilot shows; the report is carried over it"
    )
    swing_rate_noise: float = quantity(
        0.02,
        "rad/s/sqrt(s)",
        1e-6,
        100.0,
        "process noise on the swing rates: what the two point masses do not tell",
        mavlink="SWG_EKF_SWING",
    )
    force_noise: float = quantity(
        0.25,
        "N/sqrt(s) per kg of vehicle",
        1e-6,
        100.0,
        "random walk of the disturbance force: wind and gusts",
        mavlink="SWG_EKF_FORCE",
    )
    acc_noise: float = quantity(
        0.06,
        "m/s^2/sqrt(Hz)",
        1e-6,
        100.0,
        "horizontal density of accelerometer, vibration and thrust direction noise",
        mavlink="SWG_EKF_ACC",
    )
    acc_noise_vertical: float = quantity(
        0.2, "m/s^2/sqrt(Hz)", 1e-6, 100.0, "vertical density: errors of the thrust's size must not look like swing"
    )
    swing_std_init_rad: float = quantity(0.4, "rad", 1e-4, 1.5, "initial deviation of both angles")
    swing_rate_std_init_radps: float = quantity(1.0, "rad/s", 1e-4, 10.0, "initial deviation of both rates")
    force_std_init: float = quantity(1.5, "N per kg of vehicle", 1e-4, 1e3, "initial deviation of the disturbance")
    relearn_rad: float = quantity(
        0.075,
        "rad",
        0.0,
        3.0,
        "a disturbance that keeps the pendulum's time like a load at this angle is given to the swing; 0: never",
    )
    nis_gate: float = quantity(
        50.0, "1", 5.0, 1e4, "measurements whose normalised innovation squared is above are left out"
    )
    acc_noise_max: float = quantity(
        2.0,
        "m/s^2/sqrt(Hz)",
        1e-6,
        100.0,
        "vibration that the innovation shows raises the densities up to this; at or below them: never",
    )
    cable_length_std: float = quantity(
        0.15, "1", 0.0, 0.5, "deviation of the configured length over itself, learned in flight; 0: exact"
    )
    payload_mass_std: float = quantity(
        0.15, "1", 0.0, 0.5, "deviation of the configured load over itself, learned in flight; 0: exact"
    )
    damping_ratio: float = quantity(
        0.02, "1", 0.0, 0.5, "natural damping of the load's swing, used by the pendulum baseline"
    )
    fgdf_memory_s: float = quantity(
        2.5, "s", 0.1, 1000.0, "fgdf: memory of the fading filter, whose fading factor is exp(-step / memory)"
    )
    fgdf_angle_noise_rad: float = quantity(
        0.2, "rad", 1e-4, 3.0, "fgdf: deviation of one sample of the angles that the cable force shows"
    )


@dataclass(frozen=True, slots=True)
class GpEkf:
    """What estimator.name gp-ekf needs besides."""

    model: str = choice(
        "none",
        "what was learned of the cable's acceleration: a file by swingd gp train, beside this configuration; or none",
    )
    model_text: str = content_of("model")
    thrust_noise: float = quantity(
        0.16,
        "N/sqrt(Hz) per kg of vehicle",
        1e-4,
        100.0,
        "horizontal density of what pushes the vehicle besides thrust",
    )
    thrust_noise_vertical: float = quantity(
        1.0, "N/sqrt(Hz) per kg of vehicle", 1e-4, 100.0, "vertical density: the thrust's size is less certain"
    )
    load_force_noise: float = quantity(
        0.1, "N/sqrt(Hz) per kg of load", 1e-4, 100.0, "density of what pushes the load: its drag, wind"
    )
    pos_noise: float = quantity(
        0.02,
        "m/sqrt(Hz)",
        1e-4,
        10.0,
        "density of the autopilot's position: 0.1 m at 25 Hz, for its errors last seconds",
    )
    vel_noise: float = quantity(0.02, "m/s/sqrt(Hz)", 1e-4, 10.0, "density of the autopilot's velocity")
    model_memory_s: float = quantity(
        0.3, "s", 0.01, 10.0, "for how long an error that the learned model allows for keeps its sign"
    )


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera that sees the load, by LANDING_TARGET; gp-ekf takes it."""

    source: str = choice(
        "none",
        "landing_target: LANDING_TARGET with a position, which then no longer reaches the autopilot; or none",
        names=("none", "landing_target"),
    )
    target_num: int = quantity(0, "1", 0, 255, "number of the target that is the load; others pass")
    delay_s: float = quantity(0.08, "s", 0.0, 0.5, "age of a picture when its message usually comes")
    position_frd_m: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", -10.0, 10.0, "what positions in MAV_FRAME_BODY_FRD count from, from the centre of gravity"
    )
    noise_m: float = quantity(0.03, "m", 1e-4, 10.0, "deviation of the load's position on every axis")
    noise_share: float = quantity(0.02, "1", 0.0, 1.0, "of the distance, on top of it")


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The force on the vehicle besides thrust and weight, whatever causes it: cable, load, wind, drag."""

    source: str = choice(
        "none",
        "disturbance estimator by name: none, or es_lkf (extended-state Kalman filter on position, velocity, attitude "
        "and thrust; needs neither the load's mass nor the cable)",
        names=("none", "es_lkf"),
    )
    feed_forward: bool = choice(
        False,
        "lean against the estimated horizontal force; only acts where the mode streams setpoints",
        mavlink="SWG_DIST_FF",
    )
    force_noise: float = quantity(
        1.6, "N/sqrt(s) per kg of vehicle", 1e-3, 1000.0, "random walk of the force", mavlink="SWG_DIST_FORCE"
    )
    pos_noise_m: float = quantity(0.3, "m", 1e-3, 100.0, "deviation of one position of the autopilot")
    vel_noise_mps: float = quantity(0.03, "m/s", 1e-3, 10.0, "deviation of one velocity of the autopilot")
    time_constant_s: float = quantity(
        0.25, "s", 0.0, 30.0, "low-pass on the force that is fed forward", mavlink="SWG_DIST_TC"
    )
    acc_max_mps2: float = quantity(
        2.0, "m/s^2", 0.0, 20.0, "largest acceleration that is fed forward", mavlink="SWG_DIST_MAX"
    )


@dataclass(frozen=True, slots=True)
class Autopilot:
    """What the correction must know of the autopilot's loops."""

    velocity_p: float = quantity(1.8, "1/s", 0.0, 50.0, "MPC_XY_VEL_P_ACC")
    velocity_i: float = quantity(0.4, "1/s^2", 0.0, 50.0, "MPC_XY_VEL_I_ACC")
    velocity_d: float = quantity(0.2, "1", 0.0, 10.0, "MPC_XY_VEL_D_ACC")
    acceleration_delay_s: float = quantity(
        0.12, "s", 0.0, 1.0, "from an acceleration setpoint to the acceleration, attitude loop included"
    )


@dataclass(frozen=True, slots=True)
class Control:
    """The swing correction."""

    law: str = choice(
        "placed",
        "law by name: placed (gains computed), or payload (Drones 2023 (16), gains given)",
        names=("placed", "payload"),
    )
    enabled: bool = choice(
        True, "correction on at start; only acts where the mode streams setpoints", mavlink="SWG_ENABLE"
    )
    damping_ratio: float = quantity(
        0.5, "1", 0.05, 0.95, "wanted damping ratio of the swing for the placed law", mavlink="SWG_DAMPING"
    )
    frequency_ratio: float = quantity(
        1.3,
        "1",
        0.8,
        2.0,
        "wanted swing frequency over the uncorrected one for the placed law",
        mavlink="SWG_FREQ_RATIO",
    )
    payload_kp_mps2_per_rad: float = quantity(9.0, "m/s^2/rad", 0.0, 100.0, "kP of the payload law")
    payload_kd_mps2_per_radps: float = quantity(2.0, "m/s^2/(rad/s)", 0.0, 100.0, "kD of the payload law")
    velocity_leak_s: float = quantity(
        4.0, "s", 0.2, 60.0, "time constant of the leak of the velocity correction", mavlink="SWG_VEL_LEAK"
    )
    washout_s: float = quantity(
        8.0, "s", 0.5, 120.0, "time constant that removes a steady swing from the correction", mavlink="SWG_WASHOUT"
    )
    delay_s: float = quantity(
        0.02, "s", 0.0, 0.5, "age of the estimate when its setpoint acts, besides the autopilot's loops"
    )
    acc_max_mps2: float = quantity(3.0, "m/s^2", 0.0, 20.0, "largest acceleration correction", mavlink="SWG_ACC_MAX")
    vel_max_mps: float = quantity(1.5, "m/s", 0.0, 20.0, "largest velocity correction", mavlink="SWG_VEL_MAX")
    jerk_max_mps3: float = quantity(
        30.0, "m/s^3", 0.1, 1000.0, "fastest change of the acceleration correction", mavlink="SWG_JERK_MAX"
    )
    displacement_max_m: float = quantity(
        2.0, "m", 0.0, 50.0, "largest correction of a position setpoint", mavlink="SWG_POS_MAX"
    )
    height_min_m: float = quantity(
        1.0, "m", 0.0, 1000.0, "above where it was armed, below which the correction stays off; 0: it is not looked at"
    )
    fade_in_s: float = quantity(1.0, "s", 0.0, 10.0, "ramp when the correction begins", mavlink="SWG_FADE_IN")
    fade_out_s: float = quantity(0.5, "s", 0.0, 5.0, "ramp when the correction ends", mavlink="SWG_FADE_OUT")


@dataclass(frozen=True, slots=True)
class Hold:
    """The reference of mode ``hold``."""

    vel_ned_mps: tuple[float, float, float] = quantity((0.0, 0.0, 0.0), "m/s", -30.0, 30.0, "reference velocity")
    setpoint_timeout_s: float = quantity(
        1.0, "s", 0.1, 10.0, "a reference set from outside that is not repeated for this long falls back to the above"
    )
    hold_altitude: bool = choice(True, "keep the altitude of OFFBOARD's beginning while the vertical reference is 0")
    shaper: ShaperName = choice(ShaperName.NONE, "input shaper of the reference velocity: none, zv, zvd or ei")


WAYPOINT_MAX_M = 1e4
"""Of a waypoint along each axis."""
LEG_MIN_M = 0.01
"""Neighbouring waypoints are at least so far apart."""


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One place of the load."""

    north_m: float = quantity(0.0, "m", -WAYPOINT_MAX_M, WAYPOINT_MAX_M, "north of what path.relative_to names")
    east_m: float = quantity(0.0, "m", -WAYPOINT_MAX_M, WAYPOINT_MAX_M, "east of it")
    down_m: float = quantity(0.0, "m", -WAYPOINT_MAX_M, WAYPOINT_MAX_M, "below it; above it where negative")


@dataclass(frozen=True, slots=True)
class Path:
    """How mode ``path`` leads the load along the waypoints; symbols as in the law's paper."""

    source: str = choice(
        "configuration",
        "where the waypoints are: configuration, or mission (the autopilot's; its altitudes are the load's)",
        names=("configuration", "mission"),
    )
    relative_to: str = choice(
        "start",
        "waypoints count from: start (where the load hangs when the path begins) or origin (the autopilot's local one)",
        names=("start", "origin"),
    )
    cruise_mps: float = quantity(2.0, "m/s", 0.1, 20.0, "speed of the load along the path", mavlink="SWG_PATH_SPEED")
    lead_m: float = quantity(1.25, "m", 0.05, 50.0, "a leg gives way to the next where less than this is left of it")
    error_max_m: float = quantity(
        5.0, "m", 0.5, 100.0, "a load that is farther from the path than this is not led any more"
    )
    tilt_max_rad: float = quantity(0.61, "rad", 0.05, 1.0, "largest tilt that is asked for")
    k_p_per_s: float = quantity(0.7, "1/s", 0.0, 10.0, "k_p: speed towards the path over the distance from it")
    k_l_per_s: float = quantity(1.5, "1/s", 0.0, 10.0, "k_L: how fast the cable is to return to its equilibrium")
    k_0_per_s: float = quantity(1.0, "1/s", 0.0, 10.0, "K_0 over the mass: acceleration over the error of the velocity")
    k_r_per_s: float = quantity(1.0, "1/s", 0.0, 10.0, "k_r: how far the load gives way to its own swing")


@dataclass(frozen=True, slots=True)
class Link:
    """The side of the autopilot."""

    autopilot: str = choice("udpin://0.0.0.0:14540", "link to the autopilot, as a URL like MAVSDK's")
    system_id: int = quantity(0, "1", 0, 255, "autopilot to serve; 0 takes the first one heard")
    component_id: int = quantity(191, "1", 1, 255, "MAV_COMP_ID_ONBOARD_COMPUTER")
    key_file: str = choice(
        "none", "file with the MAVLink 2 signing key of the autopilot's side: 64 hexadecimal digits; or none"
    )
    rc_channel: int = quantity(
        0, "1", 0, 18, "remote control channel that switches the correction on (above 1500 us) and off; 0: none"
    )
    imu_rate_hz: float = quantity(250.0, "Hz", 20.0, 1000.0, "asked of the autopilot, averaged to the filter's rate")
    report_rate_hz: float = quantity(
        50.0, "Hz", 0.0, 400.0, "DEBUG_FLOAT_ARRAY SWING; 0 switches it off", mavlink="SWG_REPORT_HZ"
    )


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One link of an application or a ground station."""

    url: str = choice("udpin://127.0.0.1:14541", "link by URL; an empty host that waits means this machine alone")
    shaper: ShaperName = choice(ShaperName.NONE, "how this application's setpoints are shaped: none, zv, zvd or ei")
    key_file: str = choice(
        "none", "file with the MAVLink 2 signing key of this endpoint: 64 hexadecimal digits; or none"
    )
    system_ids: tuple[int, ...] = quantity((), "1", 1, 255, "system ids that may send here; empty: any")


@dataclass(frozen=True, slots=True)
class Shaping:
    """Feed-forward: how an application's steps are spread so that they excite the swing less."""

    acc_max_mps2: float = quantity(
        2.0, "m/s^2", 0.1, 20.0, "largest horizontal acceleration of a shaped setpoint", mavlink="SWG_SHP_ACC"
    )
    jerk_max_mps3: float = quantity(
        25.0, "m/s^3", 0.1, 1000.0, "largest horizontal jerk of a shaped setpoint", mavlink="SWG_SHP_JERK"
    )
    vel_max_mps: float = quantity(
        8.0, "m/s", 0.1, 50.0, "largest speed towards a shaped position", mavlink="SWG_SHP_VEL"
    )


@dataclass(frozen=True, slots=True)
class Simulation:
    """The simulated autopilot, vehicle and load: the truth, not the filter's model."""

    autopilot: SimulatedKind = choice(SimulatedKind.PX4, "px4 or ardupilot: what the same vehicle looks like")
    mavlink: str = choice("udpout://127.0.0.1:14540", "where the simulated autopilot talks to (PX4: from port 14580)")
    mavlink_bind_port: int = quantity(14580, "1", 0, 65535, "local port of the simulated autopilot's UDP link")
    ground_station: str = choice("none", "a second link by URL, for a ground station; both hear each other; or none")
    seed: int = quantity(1, "1", 0, 2**31 - 1, "of every random number")
    speed: float = quantity(1.0, "1", 0.05, 100.0, "simulated over real time")
    vehicle_inertia_kg_m2: tuple[float, float, float] = quantity(
        (0.0216, 0.0216, 0.0400), "kg m^2", 1e-5, 1e4, "about the forward, right and down axes"
    )
    arm_m: float = quantity(0.25, "m", 0.02, 10.0, "rotor axes from the centre")
    motor_up_s: float = quantity(0.0125, "s", 0.001, 1.0, "true lag of a rotor that speeds up")
    motor_down_s: float = quantity(0.025, "s", 0.001, 1.0, "true lag of a rotor that slows down")
    thrust_factor: float = quantity(1.0, "1", 0.2, 5.0, "true thrust over what the curve of ``thrust`` says")
    cable_stiffness_n_per_m: float = quantity(2000.0, "N/m", 10.0, 1e7, "of the cable, tension only")
    cable_damping_n_s_per_m: float = quantity(13.0, "N s/m", 0.0, 1e5, "of the cable while taut")
    payload_drag_area_m2: float = quantity(0.0024, "m^2", 0.0, 50.0, "drag coefficient times area of the load")
    wind_ned_mps: tuple[float, float, float] = quantity((0.0, 0.0, 0.0), "m/s", -30.0, 30.0, "mean wind")
    gust_std_mps: float = quantity(0.0, "m/s", 0.0, 15.0, "deviation of the gusts on each horizontal axis")
    gust_time_constant_s: float = quantity(2.0, "s", 0.05, 60.0, "of the gusts")
    acc_noise_mps2: float = quantity(0.1, "m/s^2", 0.0, 20.0, "white, per 250 Hz sample")
    gyro_noise_radps: float = quantity(0.01, "rad/s", 0.0, 2.0, "white, per 250 Hz sample")
    vibration_mps2: float = quantity(
        0.0, "m/s^2", 0.0, 200.0, "amplitude that the rotors give each axis of the accelerometer at half throttle"
    )
    vibration_hz: float = quantity(
        80.0, "Hz", 1.0, 2000.0, "revolutions of the rotors at half throttle; proportional to throttle"
    )
    acc_bias_mps2: float = quantity(0.03, "m/s^2", 0.0, 5.0, "Gauss-Markov, 60 s")
    attitude_noise_rad: float = quantity(
        0.003, "rad", 0.0, 0.2, "slow error of the autopilot's attitude estimate, 10 s"
    )
    gnss_vel_noise_mps: float = quantity(0.05, "m/s", 0.0, 5.0, "error of the velocity estimate")
    gnss_pos_noise_m: float = quantity(0.05, "m", 0.0, 20.0, "error of the position estimate")
    battery_full_v: float = quantity(16.2, "V", 1.0, 1000.0, "at arming")
    battery_empty_v: float = quantity(
        14.0, "V", 1.0, 1000.0, "reached after the drain time; thrust falls with the curve's exponent"
    )
    battery_drain_s: float = quantity(150.0, "s", 1.0, 1e5, "from full to empty, armed")
    takeoff_altitude_m: float = quantity(8.0, "m", 0.5, 500.0, "MIS_TAKEOFF_ALT")
    camera_hz: float = quantity(0.0, "Hz", 0.0, 120.0, "pictures of a camera that sees the load; 0: there is none")
    camera_delay_s: float = quantity(0.08, "s", 0.0, 1.0, "from a picture to its message")
    camera_noise_m: float = quantity(0.03, "m", 0.0, 10.0, "deviation of each axis, besides the share of the distance")
    camera_noise_share: float = quantity(0.02, "1", 0.0, 1.0, "deviation of each axis over the load's distance")
    camera_half_angle_rad: float = quantity(
        0.5236, "rad", 0.01, 1.57, "half of the field of view, about the body's down axis"
    )
    camera_dropout_share: float = quantity(0.1, "1", 0.0, 0.9, "share of the time in which nothing is seen, at random")
    camera_dropout_s: float = quantity(0.5, "s", 0.01, 60.0, "length of a time in which nothing is seen")


@dataclass(frozen=True, slots=True)
class Parameters:
    """All parameters of one swingd."""

    mode: Mode = choice(
        Mode.SHADOW,
        "shadow: estimate and publish only; hold: stream a reference velocity, corrected; "
        "inline: correct the setpoints of the application behind an endpoint; path: lead the load along waypoints",
    )
    vehicle: Vehicle = field(default_factory=Vehicle)
    payload: Payload = field(default_factory=Payload)
    cable: Cable = field(default_factory=Cable)
    thrust: Thrust = field(default_factory=Thrust)
    estimator: Estimator = field(default_factory=Estimator)
    gp_ekf: GpEkf = field(default_factory=GpEkf)
    camera: Camera = field(default_factory=Camera)
    disturbance: Disturbance = field(default_factory=Disturbance)
    autopilot: Autopilot = field(default_factory=Autopilot)
    control: Control = field(default_factory=Control)
    hold: Hold = field(default_factory=Hold)
    path: Path = field(default_factory=Path)
    shaping: Shaping = field(default_factory=Shaping)
    link: Link = field(default_factory=Link)
    endpoints: tuple[Endpoint, ...] = choice((), "what applications and ground stations connect to")
    waypoints: tuple[Waypoint, ...] = choice((), "places of the load that mode path leads it through, in order")
    simulation: Simulation = field(default_factory=Simulation)
