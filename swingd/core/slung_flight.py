"""A whole flight of a multirotor with a slung load, compiled: plant, wind, sensors, filters, payload law, autopilot.

The closed loop of section 4 of Drones 2023, 7, 654. Plant and wind advance with the plant's step; sensors are sampled,
and the autopilot runs, every ``CONTROL_EVERY`` steps, the filters every ``FILTER_EVERY``. Both filters always run;
``FEEDBACK`` says which one the law listens to. Filters work in the heading frame (F_H of the paper), which the flights
keep from turning by a constant yaw.
"""

from enum import IntEnum
from math import asin, atan2, cos, exp, hypot, inf, sin, sqrt

import numpy as np

from swingd.core import fgdf
from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.level import level_from_frd
from swingd.core.multirotor import (
    MultirotorInput,
    MultirotorOutput,
    MultirotorParam,
    MultirotorState,
    multirotor_derivative,
    multirotor_step,
)
from swingd.core.px4_cascade import CascadeInput, CascadeState, cascade_update
from swingd.core.status import Status
from swingd.core.swing_ekf import step as ekf_step
from swingd.core.swing_ekf_rk4 import rk4_step
from swingd.core.turbulence import TurbulenceState, turbulence_step


class Law(IntEnum):
    """What answers the swing."""

    NONE = 0
    PAYLOAD = 1
    """(16): kP and kD on the angles, lateral row with the sign that damps."""
    PLACED = 2
    """Placed gains on the load's displacement, washed out, with the leaky integrals as velocity and position."""


class Feedback(IntEnum):
    """Which filter the law listens to."""

    EKF = 0
    FGDF = 1


class FlightParam(IntEnum):
    """Offsets into a flight's description."""

    DT = 0
    """Step of the plant [s]."""
    CONTROL_EVERY = 1
    FILTER_EVERY = 2
    YAW = 3
    """Wanted and initial heading [rad]."""
    BY_VELOCITY = 4
    """1: the references are velocities by time, else positions to be reached one after the other."""
    ACCEPT_RADIUS = 5
    """At which the next position is taken [m]."""
    STOP_DISTANCE = 6
    """From the last position; inf: position does not matter [m]."""
    STOP_CHI = 7
    """Swing below which the load hangs still [rad]."""
    STOP_FOR = 8
    """How long it must [s]; inf: the flight ends with its time."""
    STOP_AFTER = 9
    """Still time counts from here on [s]."""
    WIND = 10
    """Steady, ned, 3 [m/s]."""
    TURBULENCE_WIND = 13
    """Wind at 6 m that sets the turbulence; 0: none [m/s]."""
    TURBULENCE_TO = 14
    """Direction that wind blows to, from north [rad]."""
    TURBULENCE_SPEED = 15
    """Added to the vehicle's speed through the frozen field [m/s]."""
    SPAN = 16
    LOAD_SPAN = 17
    ATTITUDE_STD = 18
    """White, per sample, as all that follow."""
    RATE_STD = 19
    ACC_STD = 20
    ACC_BIAS = 21
    """frd, 3 [m/s^2]."""
    POS_STD_XY = 24
    POS_STD_Z = 25
    VEL_STD_XY = 26
    VEL_STD_Z = 27
    LAW = 28
    FEEDBACK = 29
    KP = 30
    """Of (16) [m/s^2/rad]; of the placed law, times the cable's length [m/s^2]."""
    KD = 31
    WASHOUT = 32
    """Of the placed law [s]."""
    LEAK = 33
    """[s]"""
    ACC_MAX = 34
    JERK_MAX = 35
    VEL_MAX = 36
    POS_MAX = 37
    FILTER_MASS = 38
    """Vehicle, as the filters assume it [kg]."""
    FILTER_LOAD_MASS = 39
    FILTER_LENGTH = 40
    EKF_P0 = 41
    """7 initial variances."""
    EKF_Q = 48
    """7"""
    EKF_R = 55
    """One for all axes."""
    EKF_SCHEME = 56
    """-1: Runge-Kutta for mean and covariance, else a `Scheme` of `swing_ekf.step`."""
    FGDF_E0 = 57
    """4 initial variances."""
    FGDF_R = 61
    """[rad^2]"""
    FGDF_FADING = 62
    SIZE = 63


class FlightLog(IntEnum):
    """Columns of the log, one row for every sample of the autopilot."""

    T = 0
    POS = 1
    """Truth, ned, 3, as the following."""
    VEL = 4
    EULER = 7
    CHI = 10
    """Angle between cable and vertical [rad], its rate."""
    CHI_RATE = 11
    SWING = 12
    """xi, zeta and their rates, heading frame, 4."""
    FORCE = 16
    """Aerodynamic force on the vehicle, heading frame, 3 [N]."""
    EKF = 19
    """State, 7."""
    FGDF = 26
    """State, 4."""
    ACC_VC = 30
    """What the velocity controller asks for, ned, 3 [m/s^2]."""
    ACC_PC = 33
    """What the law asks for, ned, 3 [m/s^2]."""
    REFERENCE = 36
    """Position or velocity, ned, 3."""
    LEG = 39
    """Index of the reference."""
    ENERGY = 40
    SHAFT_POWER = 41
    THRUST = 42
    THRUST_ESTIMATED = 43
    TENSION = 44
    WIND = 45
    """At the vehicle, ned, 3."""
    GUST_RATE = 48
    """ned, 3."""
    EULER_MEASURED = 51
    """3"""
    ACC = 54
    """What the filters took last: measured inertial acceleration, heading frame, 3 [m/s^2]."""
    SIZE = 57


_S = MultirotorState
_U = MultirotorInput
_Y = MultirotorOutput
_P = MultirotorParam
_I = CascadeInput
_F = FlightParam
_L = FlightLog
OUTPUTS = int(_Y.SIZE)
CASCADE_INPUTS = int(_I.SIZE)
CASCADE_STATES = int(CascadeState.SIZE)
TURBULENCE_STATES = int(TurbulenceState.SIZE)
_OK = int(Status.OK)
_GATED = int(Status.GATED)

NOISE_PER_SAMPLE = 15
"""Standard normals of one sample: attitude, rates, acceleration, position, velocity."""
WHITE_PER_STEP = 8
"""Standard normals of one step of the plant: four each for the air at the vehicle and at the load."""
_PAYLOAD = int(Law.PAYLOAD)
_PLACED = int(Law.PLACED)
_FGDF = int(Feedback.FGDF)


@kernel(VOID(VEC, VEC))
def swing_angles(swing_out, cable):
    """Angles and rates of a cable in a frame that does not turn.

    Parameters
    ----------
    swing_out : (4,), written
        xi, zeta [rad], their rates [rad/s].
    cable : (6,)
        Vector from hook to load, x forward, y right, z down [m], and its derivative [m/s].
    """
    x, y, z = cable[0], cable[1], cable[2]
    across2 = y * y + z * z
    across = sqrt(across2)
    length2 = across2 + x * x
    swing_out[0] = atan2(-y, z)
    swing_out[1] = atan2(x, across)
    swing_out[2] = (y * cable[5] - z * cable[4]) / across2
    swing_out[3] = (cable[3] * across2 - x * (y * cable[4] + z * cable[5])) / (length2 * across)


@kernel(VOID(VEC, F8))
def _limit(vector, size):
    length = hypot(vector[0], vector[1])
    if length > size:
        vector[0] *= size / length
        vector[1] *= size / length


@kernel(VOID(VEC, VEC, VEC, VEC, F8))
def _payload_law(acc_out, push, swing, f, dt_s):
    """Acceleration asked for, heading frame; ``push`` remembers slow part, acceleration, velocity, position, 2 each."""
    if f[_F.LAW] == _PAYLOAD:
        acc_out[0] = f[_F.KP] * swing[1] + f[_F.KD] * swing[3]
        # xi > 0 is a load to the left: the lateral row needs a minus that the paper does not print.
        acc_out[1] = -(f[_F.KP] * swing[0] + f[_F.KD] * swing[2])
        return
    sx, cx = sin(swing[0]), cos(swing[0])
    sz, cz = sin(swing[1]), cos(swing[1])
    wanted = (
        f[_F.KP] * sz + f[_F.KD] * cz * swing[3],
        -f[_F.KP] * sx * cz - f[_F.KD] * (cx * cz * swing[2] - sx * sz * swing[3]),
    )
    blend = dt_s / (dt_s + f[_F.WASHOUT])
    kept = exp(-dt_s / f[_F.LEAK])
    for j in range(2):
        push[j] += blend * (wanted[j] - push[j])
        acc_out[j] = wanted[j] - push[j]
    _limit(acc_out, f[_F.ACC_MAX])
    for j in range(2):
        acc_out[j] -= push[2 + j]
    _limit(acc_out, f[_F.JERK_MAX] * dt_s)
    for j in range(2):
        push[2 + j] += acc_out[j]
        acc_out[j] = push[2 + j]
        push[4 + j] = kept * push[4 + j] + push[2 + j] * dt_s
    _limit(push[4:6], f[_F.VEL_MAX])
    for j in range(2):
        push[6 + j] = kept * push[6 + j] + push[4 + j] * dt_s
    _limit(push[6:8], f[_F.POS_MAX])


@kernel(VOID(VEC, VEC, VEC, VEC, F8, F8, F8, VEC))
def _gust_ned(wind_out, gust, state, white, height_m, speed_mps, span_m, f):
    """Advance one body's turbulence; its wind, steady part included, and the gust with its rotation turned into ned."""
    turbulence_step(gust, state, white, height_m, speed_mps, f[_F.TURBULENCE_WIND], span_m, f[_F.DT])
    c, s = cos(f[_F.TURBULENCE_TO]), sin(f[_F.TURBULENCE_TO])
    for j in (0, 3):
        gust[j], gust[j + 1] = c * gust[j] - s * gust[j + 1], s * gust[j] + c * gust[j + 1]
    for j in range(3):
        wind_out[j] = f[_F.WIND + j] + gust[j]


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, VEC, VEC))
def _blow(u, gust, gust_state, load_gust_state, x, white, f):
    """Set wind, gusts and their rotation for the next step; the ned origin lies on the ground."""
    speed = sqrt(x[_S.VEL] ** 2 + x[_S.VEL + 1] ** 2 + x[_S.VEL + 2] ** 2) + f[_F.TURBULENCE_SPEED]
    load_wind, wind = u[_U.LOAD_WIND : _U.LOAD_WIND + 3], u[_U.WIND : _U.WIND + 3]
    _gust_ned(load_wind, gust, load_gust_state, white[4:8], -x[_S.LOAD_POS + 2], speed, f[_F.LOAD_SPAN], f)
    _gust_ned(wind, gust, gust_state, white[0:4], -x[_S.POS + 2], speed, f[_F.SPAN], f)
    # The body stays nearly level, so that its yaw alone turns the air's rotation into its axes.
    c, s = cos(f[_F.YAW]), sin(f[_F.YAW])
    u[_U.GUST_RATE] = c * gust[3] + s * gust[4]
    u[_U.GUST_RATE + 1] = c * gust[4] - s * gust[3]
    u[_U.GUST_RATE + 2] = gust[5]


@kernel(I8(MAT, VEC, VEC, MAT, MAT, VEC, VEC, MAT, MAT, MAT))
def fly(log, x, p, rotors, allocation, cascade, f, references, noise, white):
    """Fly until the stop criterion holds, or until the log is full.

    Parameters
    ----------
    log : (n, FlightLog.SIZE), written
        One row for every sample.
    x : (MultirotorState.OMEGA + n_rotors,), changed
        State of the plant.
    p, rotors, allocation, cascade
        See `swingd.core.multirotor` and `swingd.core.px4_cascade`.
    f : (FlightParam.SIZE,)
    references : (k, 4)
        Time [s], then position [m] or velocity [m/s], ned. Positions are taken one after the other and their time is
        not used; velocities hold from their time on.
    noise : (n, NOISE_PER_SAMPLE)
        Standard normals.
    white : (n CONTROL_EVERY, WHITE_PER_STEP)
        Standard normals; not used without turbulence.

    Returns
    -------
    int
        Rows written; less than n where the flight ended by its criterion, -1 where a filter or the plant failed.
    """
    dt_s = f[_F.DT]
    control_every, filter_every = int(f[_F.CONTROL_EVERY]), int(f[_F.FILTER_EVERY])
    control_s, filter_s = control_every * dt_s, filter_every * dt_s
    n_rotors = rotors.shape[0]
    u = np.zeros(_U.OMEGA + n_rotors)
    x_dot = np.empty(x.shape[0])
    y = np.empty(OUTPUTS)
    inflow = np.full(n_rotors, 10.0)
    gust, gust_state, load_gust_state = np.zeros(6), np.zeros(TURBULENCE_STATES), np.zeros(TURBULENCE_STATES)
    memory = np.zeros(CASCADE_STATES)
    for j in range(3):
        memory[CascadeState.VEL_SLOW + j] = x[_S.VEL + j]
        u[_U.WIND + j] = f[_F.WIND + j]
        u[_U.LOAD_WIND + j] = f[_F.WIND + j]
    omega = x[_S.OMEGA :].copy()
    u[_U.OMEGA :] = omega
    sample = np.zeros(CASCADE_INPUTS)
    acc_vc, acc_pc, push = np.zeros(3), np.zeros(2), np.zeros(8)
    swing, cable = np.zeros(4), np.zeros(6)

    mass, load_mass, length = f[_F.FILTER_MASS], f[_F.FILTER_LOAD_MASS], f[_F.FILTER_LENGTH]
    ekf, P = np.zeros(7), np.zeros((7, 7))
    ekf_next, P_next = np.zeros(7), np.zeros((7, 7))
    for j in range(7):
        P[j, j] = f[_F.EKF_P0 + j]
    R = np.full(3, f[_F.EKF_R])
    scheme = int(f[_F.EKF_SCHEME])
    linear, E = np.zeros(4), np.zeros((4, 4))
    Phi, Gamma, nis = np.zeros((4, 4)), np.zeros((4, 2)), np.zeros(1)
    for j in range(4):
        E[j, j] = f[_F.FGDF_E0 + j]
    fgdf.transition(Phi, Gamma, mass, load_mass, length, filter_s)
    R_heading, z, force, force_linear = np.empty((3, 3)), np.zeros(3), np.zeros(3), np.zeros(3)
    thrust = 0.0

    leg = 0
    still_s = 0.0
    steps = 0
    for row in range(log.shape[0]):
        t_s = row * control_s
        multirotor_derivative(x_dot, y, inflow, x, u, p, rotors)
        # Attitude, 3-2-1 Euler.
        qw, qx, qy, qz = x[_S.QUAT], x[_S.QUAT + 1], x[_S.QUAT + 2], x[_S.QUAT + 3]
        roll = atan2(2.0 * (qw * qx + qy * qz), 1.0 - 2.0 * (qx * qx + qy * qy))
        pitch = asin(min(max(2.0 * (qw * qy - qz * qx), -1.0), 1.0))
        yaw = atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        cy, sy = cos(yaw), sin(yaw)
        # True swing in the heading frame, whose rotation the rates include.
        yaw_rate = (sin(roll) * x[_S.RATE + 1] + cos(roll) * x[_S.RATE + 2]) / cos(pitch)
        for j in (0, 3):
            cable[j] = cy * y[_Y.CABLE + j] + sy * y[_Y.CABLE + 1 + j]
            cable[j + 1] = cy * y[_Y.CABLE + 1 + j] - sy * y[_Y.CABLE + j]
            cable[j + 2] = y[_Y.CABLE + 2 + j]
        cable[3] += yaw_rate * cable[1]
        cable[4] -= yaw_rate * cable[0]
        swing_angles(swing, cable)
        chi = atan2(hypot(cable[0], cable[1]), cable[2])
        sin_chi = sin(chi)
        chi_rate = hypot(swing[2], swing[3])
        if sin_chi > 1e-6:
            chi_rate = (sin(swing[0]) * cos(swing[1]) * swing[2] + cos(swing[0]) * sin(swing[1]) * swing[3]) / sin_chi
        if not np.isfinite(chi):
            return -1

        # Sensors.
        for j in range(3):
            position_std = f[_F.POS_STD_XY] if j < 2 else f[_F.POS_STD_Z]
            velocity_std = f[_F.VEL_STD_XY] if j < 2 else f[_F.VEL_STD_Z]
            sample[_I.EULER + j] = f[_F.ATTITUDE_STD] * noise[row, j]
            sample[_I.RATE + j] = x[_S.RATE + j] + f[_F.RATE_STD] * noise[row, 3 + j]
            sample[_I.POS + j] = x[_S.POS + j] + position_std * noise[row, 9 + j]
            sample[_I.VEL + j] = x[_S.VEL + j] + velocity_std * noise[row, 12 + j]
        sample[_I.EULER] += roll
        sample[_I.EULER + 1] += pitch
        sample[_I.EULER + 2] += yaw
        cy_m, sy_m = cos(sample[_I.EULER + 2]), sin(sample[_I.EULER + 2])

        # Filters.
        if steps % filter_every == 0:
            level_from_frd(R_heading, sample[_I.EULER], sample[_I.EULER + 1], 0.0)
            z[0], z[1], z[2] = 0.0, 0.0, GRAVITY_MPS2
            for j in range(3):
                read = y[_Y.SPECIFIC_FORCE + j] + f[_F.ACC_BIAS + j] + f[_F.ACC_STD] * noise[row, 6 + j]
                for k in range(3):
                    z[k] += R_heading[k, j] * read
            # Remark 1, (14), along the measured body axis: with the disturbance that the EKF knows, and without any.
            hanging = (mass + load_mass) * GRAVITY_MPS2
            lift = mass * z[2] - hanging
            thrust = sqrt((mass * z[0] - ekf[4]) ** 2 + (mass * z[1] - ekf[5]) ** 2 + (lift - ekf[6]) ** 2)
            thrust_linear = mass * sqrt(z[0] ** 2 + z[1] ** 2 + (lift / mass) ** 2)
            for j in range(3):
                force[j] = -thrust * R_heading[j, 2]
                force_linear[j] = -thrust_linear * R_heading[j, 2]
            if scheme < 0:
                status = rk4_step(ekf, P, force, z, f[_F.EKF_Q : _F.EKF_Q + 7], R, filter_s, mass, load_mass, length)
            else:
                status = ekf_step(
                    ekf_next, P_next, nis, ekf, P, force, z, f[_F.EKF_Q : _F.EKF_Q + 7], R, filter_s, filter_s,
                    mass, load_mass, length, inf, scheme,
                )  # fmt: skip
                ekf[:] = ekf_next
                P[:, :] = P_next
            if status != _OK:
                return -1
            status = fgdf.step(linear, E, nis, force_linear, z, Phi, Gamma, f[_F.FGDF_R], f[_F.FGDF_FADING], mass, inf)
            if status != _OK and status != _GATED:
                return -1

        # Payload law.
        acc_pc[:] = 0.0
        if f[_F.LAW] > 0.5:
            if f[_F.FEEDBACK] == _FGDF:
                _payload_law(acc_pc, push, linear, f, control_s)
            else:
                _payload_law(acc_pc, push, ekf[:4], f, control_s)

        # References.
        by_velocity = f[_F.BY_VELOCITY] > 0.5
        distance = 0.0
        if by_velocity:
            while leg + 1 < references.shape[0] and t_s >= references[leg + 1, 0] - 1e-9:
                leg += 1
        else:
            while True:
                distance = 0.0
                for j in range(3):
                    distance += (references[leg, 1 + j] - x[_S.POS + j]) ** 2
                distance = sqrt(distance)
                if leg + 1 == references.shape[0] or distance > f[_F.ACCEPT_RADIUS]:
                    break
                leg += 1
        sample[_I.BY_VELOCITY] = f[_F.BY_VELOCITY]
        sample[_I.YAW_SP] = f[_F.YAW]
        for j in range(3):
            sample[_I.POS_SP + j] = references[leg, 1 + j]
            sample[_I.VEL_SP + j] = references[leg, 1 + j] if by_velocity else 0.0
        if f[_F.LAW] == _PLACED:
            sample[_I.VEL_SP] += cy_m * push[4] - sy_m * push[5]
            sample[_I.VEL_SP + 1] += sy_m * push[4] + cy_m * push[5]
            sample[_I.POS_SP] += cy_m * push[6] - sy_m * push[7]
            sample[_I.POS_SP + 1] += sy_m * push[6] + cy_m * push[7]
        sample[_I.ACC_SP] = cy_m * acc_pc[0] - sy_m * acc_pc[1]
        sample[_I.ACC_SP + 1] = sy_m * acc_pc[0] + cy_m * acc_pc[1]
        cascade_update(omega, acc_vc, memory, sample, cascade, allocation, rotors, control_s)
        u[_U.OMEGA :] = omega

        # Log.
        log[row, _L.T] = t_s
        for j in range(3):
            log[row, _L.POS + j] = x[_S.POS + j]
            log[row, _L.VEL + j] = x[_S.VEL + j]
            log[row, _L.ACC_VC + j] = acc_vc[j]
            log[row, _L.ACC_PC + j] = sample[_I.ACC_SP + j]
            log[row, _L.REFERENCE + j] = references[leg, 1 + j]
            log[row, _L.WIND + j] = u[_U.WIND + j]
            log[row, _L.EULER_MEASURED + j] = sample[_I.EULER + j]
            log[row, _L.ACC + j] = z[j]
        log[row, _L.EULER], log[row, _L.EULER + 1], log[row, _L.EULER + 2] = roll, pitch, yaw
        log[row, _L.CHI], log[row, _L.CHI_RATE] = chi, chi_rate
        for j in range(4):
            log[row, _L.SWING + j] = swing[j]
            log[row, _L.FGDF + j] = linear[j]
        log[row, _L.FORCE] = cy * y[_Y.AERO_FORCE] + sy * y[_Y.AERO_FORCE + 1]
        log[row, _L.FORCE + 1] = cy * y[_Y.AERO_FORCE + 1] - sy * y[_Y.AERO_FORCE]
        log[row, _L.FORCE + 2] = y[_Y.AERO_FORCE + 2]
        for j in range(7):
            log[row, _L.EKF + j] = ekf[j]
        log[row, _L.LEG] = leg
        log[row, _L.ENERGY] = x[_S.ENERGY]
        log[row, _L.SHAFT_POWER] = y[_Y.SHAFT_POWER]
        log[row, _L.THRUST] = y[_Y.THRUST]
        log[row, _L.THRUST_ESTIMATED] = thrust
        log[row, _L.TENSION] = y[_Y.TENSION]
        log[row, _L.GUST_RATE] = cy * u[_U.GUST_RATE] - sy * u[_U.GUST_RATE + 1]
        log[row, _L.GUST_RATE + 1] = sy * u[_U.GUST_RATE] + cy * u[_U.GUST_RATE + 1]
        log[row, _L.GUST_RATE + 2] = u[_U.GUST_RATE + 2]

        # Stop.
        still_s = still_s + control_s if chi < f[_F.STOP_CHI] and t_s >= f[_F.STOP_AFTER] else 0.0
        if still_s >= f[_F.STOP_FOR] - 1e-9 and leg + 1 == references.shape[0] and distance < f[_F.STOP_DISTANCE]:
            return row + 1

        for step in range(control_every):
            if f[_F.TURBULENCE_WIND] > 0.0:
                _blow(u, gust, gust_state, load_gust_state, x, white[row * control_every + step], f)
            multirotor_step(x, x_dot, y, inflow, u, p, rotors, dt_s)
            steps += 1
    return log.shape[0]
