"""Parameters and log of `swingd.core.slts_flight`, by name."""

from enum import IntEnum

from swingd.core.path_following import PathTerm


class Feedback(IntEnum):
    """What the path following listens to."""

    GP_EKF = 0
    EKF = 1
    TRUTH = 2


class SltsFlightParam(IntEnum):
    """Offsets into the parameters, SI units."""

    DT = 0
    """Step of the plant, the gyro and the attitude loop [s]."""
    OUTER_EVERY = 1
    """Steps between two of the filters and the path following."""
    FEEDBACK = 2
    YAW = 3
    STOP_AFTER = 4
    """How long the load is held at the last waypoint before the flight ends [s]."""
    BELIEVED_LAG = 5
    """Of the rotors, as the filters take it [s]."""
    BELIEVED_DENSITY_RATIO = 6
    ROTOR_THRUST_MAX = 7
    B_R = 8
    B_OMEGA = 9
    RATE_D_LAG = 10
    """Low-pass on the wanted body rates [s]."""
    WIND = 11
    """Steady, ned, 3."""
    TURBULENCE_WIND = 14
    """At 6 m height, sets the turbulence's strength; 0: none [m/s]."""
    SPAN = 15
    LOAD_SPAN = 16
    TILT_STD = 17
    """Slow error of the estimated attitude about each axis [rad]."""
    TILT_TIME = 18
    GYRO_STD = 19
    """White, per step [rad/s]."""
    ACC_STD = 20
    """White, per step [m/s^2]."""
    ACC_BIAS = 21
    """frd, 3 [m/s^2]."""
    POS_STD = 24
    """Slow error of the autopilot's position, level and vertical, 2 [m]."""
    VEL_STD = 26
    """Of its velocity, 2 [m/s]."""
    GNSS_TIME = 28
    GNSS_SMOOTHING = 29
    """The autopilot's inertial sensors carry the error that much further [s]."""
    GNSS_EVERY = 30
    """Steps between two positions; velocities come halfway in between."""
    GNSS_DELAY = 31
    """Steps."""
    CAMERA_PERIOD = 32
    """[s]"""
    CAMERA_DELAY = 33
    """Steps."""
    CAMERA_STD = 34
    """Every axis [m]."""
    CAMERA_STD_SHARE = 35
    """Of the distance, on top."""
    CAMERA_HALF_ANGLE = 36
    """Of the field of view about the body's down axis [rad]."""
    FILTER_POS_STD = 37
    FILTER_VEL_STD = 38
    P0 = 39
    """Initial variances, 10."""
    SIZE = 49


class SltsFlightLog(IntEnum):
    """Columns of the log, a row for every step of the filters; states as `swingd.core.slts.SltsState`."""

    T = 0
    TRUE = 1
    """10; r and v are the vehicle's CG relative to the load."""
    GP_EKF = 11
    """10"""
    GP_EKF_VAR = 21
    """10"""
    EKF = 31
    """10"""
    EKF_VAR = 41
    """10"""
    NEES = 51
    """Of r and v, 4 degrees of freedom, with and without Gaussian process: 2."""
    CAMERA = 53
    """r of the last picture that arrived, held: 2; nan before the first."""
    CAMERA_FRESH = 55
    """1 where a picture was entered since the row before."""
    TERMS = 56
    """Of the path following, see `swingd.core.path_following.PathTerm`."""
    LEG = 56 + int(PathTerm.SIZE)
    FORCE = LEG + 1
    """Thrust as believed, ned, 3 [N]."""
    THRUST = FORCE + 3
    """True [N]."""
    TENSION = THRUST + 1
    TILT = TENSION + 1
    """True [rad]."""
    TRUE_E_P = TILT + 1
    """(5) with the true position, on the leg that is flown: ned, 3 [m]."""
    TRUE_E_V = TRUE_E_P + 3
    """(6) with the true velocity, ned, 3 [m/s]."""
    POS = TRUE_E_V + 3
    """Vehicle, ned, 3."""
    QUAT = POS + 3
    """4"""
    SIZE = QUAT + 4
