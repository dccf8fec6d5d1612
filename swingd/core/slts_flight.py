"""A flight along a path, whole, in one call: plant, sensors, camera, both filters, path following, attitude, log.

Truth is `swingd.core.multirotor`: rigid body, rotors that lag, an elastic cable at a hook off the centre of mass, drag
of load, frame and rotors. The filters know a rigid cable, two point masses, and the thrust that was commanded.
"""

from math import atan2, cos, exp, inf, nan, sin, sqrt

import numpy as np

from swingd.core import gp_ekf_history, path_following
from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.attitude_tracking import rate_between, tracking_torque
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.gp_ekf import GpEkfParam, Source
from swingd.core.gp_ekf_history import Node, Ring
from swingd.core.linalg import cholesky, cholesky_solve
from swingd.core.multirotor import (
    MultirotorInput,
    MultirotorOutput,
    MultirotorParam,
    MultirotorState,
    Rotor,
    multirotor_derivative,
    multirotor_step,
)
from swingd.core.path_following import PathParam, PathState, PathTerm
from swingd.core.rotation import matrix
from swingd.core.slts import NUM_STATES, SltsState
from swingd.core.slts_flight_layout import Feedback, SltsFlightLog, SltsFlightParam
from swingd.core.status import Status
from swingd.core.turbulence import TurbulenceState, turbulence_step

_F = SltsFlightParam
_L = SltsFlightLog
_S = MultirotorState
_U = MultirotorInput
_Y = MultirotorOutput
_X = SltsState
_G = GpEkfParam
_P = PathParam
_T = PathTerm
_M = PathState
_OK = int(Status.OK)
_GATED = int(Status.GATED)
_TOO_LATE = int(Status.TOO_LATE)
_PATH_STATES = int(PathState.SIZE)
_TERMS = int(PathTerm.SIZE)
_OUTPUTS = int(MultirotorOutput.SIZE)
_TURBULENCE_STATES = int(TurbulenceState.SIZE)
_NODE_SIZE = int(Node.SIZE)
_RING_SIZE = int(Ring.SIZE)
_VEHICLE_POS = int(Source.VEHICLE_POS)
_VEHICLE_VEL = int(Source.VEHICLE_VEL)
_REL_POS = int(Source.REL_POS)
_TRUTH = int(Feedback.TRUTH)
_EKF = int(Feedback.EKF)

NODES = 128
"""What each filter remembers; 0.7 s with the rates of the study."""
NOISE_PER_STEP = 18
"""Standard normals of one step: attitude, gyro, accelerometer, position, velocity, 3 spare for the camera."""
WHITE_PER_STEP = 8
"""Standard normals for the air at the vehicle and at the load."""
_TILT_SMOOTHING_S = 0.02
_WAITING = 8
"""Pictures on their way."""


@kernel(VOID(VEC, VEC, F8, F8, F8, F8, F8, VEC))
def _drift(error, raw, level_std, vertical_std, time_s, smoothing_s, dt_s, normal):
    """Advance a slow error of three components: Gauss-Markov, smoothed once more, of the given deviations."""
    drive = sqrt(2.0 * dt_s / time_s * (time_s + smoothing_s) / time_s)
    for i in range(3):
        std = level_std if i < 2 else vertical_std
        raw[i] += -dt_s / time_s * raw[i] + std * drive * normal[i]
        error[i] += dt_s / smoothing_s * (raw[i] - error[i])


@kernel(VOID(MAT, VEC, VEC))
def _believed_attitude(R_out, quaternion, tilt):
    """Rotation matrix of an attitude that is turned by a small rotation vector about the axes of ned."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix(quaternion[0], quaternion[1], quaternion[2], quaternion[3])
    t00, t01, t02, t10, t11, t12, t20, t21, t22 = matrix(1.0, 0.5 * tilt[0], 0.5 * tilt[1], 0.5 * tilt[2])
    R_out[0, 0], R_out[0, 1] = t00 * r00 + t01 * r10 + t02 * r20, t00 * r01 + t01 * r11 + t02 * r21
    R_out[0, 2], R_out[1, 0] = t00 * r02 + t01 * r12 + t02 * r22, t10 * r00 + t11 * r10 + t12 * r20
    R_out[1, 1], R_out[1, 2] = t10 * r01 + t11 * r11 + t12 * r21, t10 * r02 + t11 * r12 + t12 * r22
    R_out[2, 0], R_out[2, 1] = t20 * r00 + t21 * r10 + t22 * r20, t20 * r01 + t21 * r11 + t22 * r21
    R_out[2, 2] = t20 * r02 + t21 * r12 + t22 * r22


@kernel(F8(VEC, MAT, VEC))
def _nees(x, P, true):
    """Normalised error squared of r and v."""
    at = (3, 4, 8, 9)  # r, v
    part, L, error = np.empty((4, 4)), np.empty((4, 4)), np.empty(4)
    for i in range(4):
        error[i] = x[at[i]] - true[at[i]]
        for j in range(4):
            part[i, j] = P[at[i], at[j]]
    if cholesky(L, part) != _OK:
        return nan
    solved = error.copy()
    cholesky_solve(solved, L)
    return error[0] * solved[0] + error[1] * solved[1] + error[2] * solved[2] + error[3] * solved[3]


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, VEC, F8, F8, VEC))
def _blow(u, gust, state, load_state, x, white, dt_s, wind_6m_mps, f):
    """Wind at vehicle and load for the next step, turbulence along and across the steady wind."""
    speed = sqrt(x[_S.VEL] ** 2 + x[_S.VEL + 1] ** 2 + x[_S.VEL + 2] ** 2) + sqrt(f[_F.WIND] ** 2 + f[_F.WIND + 1] ** 2)
    to = atan2(f[_F.WIND + 1], f[_F.WIND])
    c, s = cos(to), sin(to)
    for at in range(2):
        first = _U.WIND if at == 0 else _U.LOAD_WIND
        if at == 0:
            turbulence_step(gust, state, white[0:4], -x[_S.POS + 2], speed, wind_6m_mps, f[_F.SPAN], dt_s)
        else:
            height = -x[_S.LOAD_POS + 2]
            turbulence_step(gust, load_state, white[4:8], height, speed, wind_6m_mps, f[_F.LOAD_SPAN], dt_s)
        u[first] = f[_F.WIND] + c * gust[0] - s * gust[1]
        u[first + 1] = f[_F.WIND + 1] + s * gust[0] + c * gust[1]
        u[first + 2] = f[_F.WIND + 2] + gust[2]


@kernel(I8(MAT, VEC, VEC, MAT, MAT, MAT, VEC, VEC, VEC, MAT, MAT, MAT, MAT, MAT, VEC, MAT, MAT, MAT))
def fly(
    log, x, plant, rotors, believed_rotors, allocation, f, path, ekf, waypoints,
    Z, weights, K_inv, inv_sq_scales, signal_var, noise, camera, white,
):  # fmt: skip
    """Fly until the load was held at the last waypoint for a while, or until the log is full.

    Parameters
    ----------
    log : (n, SltsFlightLog.SIZE), written
    x : (MultirotorState.OMEGA + n_rotors,), changed
        State of the plant.
    plant, rotors
        See `swingd.core.multirotor`.
    believed_rotors : (n_rotors, Rotor.SIZE)
        As autopilot and filters take them; weaker rotors in truth are thrust below the model.
    allocation : (n_rotors, 4)
        Thrust of each rotor per total thrust [1] and per roll, pitch and yaw moment [1/m].
    f, path, ekf
        See `SltsFlightParam`, `swingd.core.path_following.PathParam`, `swingd.core.gp_ekf.GpEkfParam`.
    waypoints : (k, 3)
        Of the load, ned [m].
    Z, weights, K_inv, inv_sq_scales, signal_var
        Gaussian process, see `swingd.core.gaussian_process`; the other filter flies without.
    noise : (n OUTER_EVERY, NOISE_PER_STEP)
        Standard normals.
    camera : (pictures, 4)
        Of each picture: whether one is taken at all, and standard normals of its three axes.
    white : (n OUTER_EVERY, WHITE_PER_STEP)
        Standard normals; not used without turbulence.

    Returns
    -------
    int
        Rows written, n where the log is full; -1 where the plant, -2 where a filter, -3 where the law failed.
    """
    dt_s, every = f[_F.DT], int(f[_F.OUTER_EVERY])
    outer_s = every * dt_s
    n_rotors = rotors.shape[0]
    length = ekf[_G.CABLE_LENGTH]
    u, x_dot, y = np.zeros(_U.OMEGA + n_rotors), np.empty(x.shape[0]), np.empty(_OUTPUTS)
    inflow = np.full(n_rotors, 6.0)
    gust, air, load_air = np.zeros(6), np.zeros(_TURBULENCE_STATES), np.zeros(_TURBULENCE_STATES)
    for i in range(3):
        u[_U.WIND + i] = u[_U.LOAD_WIND + i] = f[_F.WIND + i]
    multirotor_derivative(x_dot, y, inflow, x, u, plant, rotors)

    # Errors of what the autopilot tells, settled before the start.
    tilt, tilt_raw = np.zeros(3), np.zeros(3)
    pos_error, pos_raw, vel_error, vel_raw = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        tilt[i] = tilt_raw[i] = f[_F.TILT_STD] * noise[0, i]
        axis = 0 if i < 2 else 1
        pos_error[i] = pos_raw[i] = f[_F.POS_STD + axis] * noise[0, 9 + i]
        vel_error[i] = vel_raw[i] = f[_F.VEL_STD + axis] * noise[0, 12 + i]
    R, R_d, R_before, J = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            J[i, j] = plant[MultirotorParam.INERTIA + 3 * i + j]
    _believed_attitude(R, x[_S.QUAT : _S.QUAT + 4], tilt)
    rate, rate_d, rate_d_rate, rate_raw, torque = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(3):
        for j in range(3):
            R_d[i, j] = R_before[i, j] = R[i, j]

    # Filters.
    n = NUM_STATES
    true, estimate, P = np.zeros(n), np.zeros(n), np.zeros((n, n))
    x_gp, P_gp, x_plain, P_plain = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
    no_Z, no_weights = np.empty((0, 4)), np.empty((0, 2))
    no_K_inv = np.empty((0, 0))
    nodes_gp, nodes_plain = np.zeros((NODES, _NODE_SIZE)), np.zeros((NODES, _NODE_SIZE))
    P_all_gp, P_all_plain = np.zeros((n * NODES, n)), np.zeros((n * NODES, n))
    ring_gp, ring_plain = np.zeros(_RING_SIZE), np.zeros(_RING_SIZE)
    nis = np.zeros(1)
    force, specific_force = np.zeros(3), np.zeros(3)
    believed_thrust = (plant[MultirotorParam.MASS] + plant[MultirotorParam.LOAD_MASS]) * GRAVITY_MPS2
    for i in range(n):
        P[i, i] = f[_F.P0 + i]
    for i in range(3):
        estimate[_X.LOAD_POS + i] = x[_S.POS + i] + pos_error[i]
        estimate[_X.LOAD_VEL + i] = x[_S.VEL + i] + vel_error[i]
        force[i] = -believed_thrust * R[i, 2]
    estimate[_X.LOAD_POS + 2] += length
    gp_ekf_history.begin(nodes_gp, P_all_gp, ring_gp, 0.0, estimate, P, force)
    gp_ekf_history.begin(nodes_plain, P_all_plain, ring_plain, 0.0, estimate, P, force)
    pos_var, vel_var, z, camera_var = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    pos_var[:] = f[_F.FILTER_POS_STD] ** 2
    vel_var[:] = f[_F.FILTER_VEL_STD] ** 2

    # What is on its way: pictures, and the autopilot's positions and velocities.
    gnss_every, gnss_delay, camera_delay = int(f[_F.GNSS_EVERY]), int(f[_F.GNSS_DELAY]), int(f[_F.CAMERA_DELAY])
    gnss_sent, gnss_value = np.full((2, _WAITING), -1.0), np.zeros((2, _WAITING, 3))
    picture_sent, picture_value, picture_std = np.full(_WAITING, -1.0), np.zeros((_WAITING, 3)), np.zeros(_WAITING)
    pictures, positions = 0, 0
    held = np.full(2, nan)
    fresh = 0.0

    state, terms = np.zeros(_PATH_STATES), np.zeros(_TERMS)
    begun = False
    held_s = 0.0
    wanted_thrust = believed_thrust
    step_count = 0
    cos_half = cos(f[_F.CAMERA_HALF_ANGLE])
    for row in range(log.shape[0]):
        t_s = row * outer_s

        # Truth.
        for i in range(3):
            true[_X.LOAD_POS + i] = x[_S.LOAD_POS + i]
            true[_X.LOAD_VEL + i] = x[_S.LOAD_VEL + i]
        for i in range(2):
            true[_X.REL_POS + i] = x[_S.POS + i] - x[_S.LOAD_POS + i]
            true[_X.REL_VEL + i] = x[_S.VEL + i] - x[_S.LOAD_VEL + i]
        total = 0.0
        for i in range(n):
            total += abs(true[i])
        if not np.isfinite(total):
            return -1

        # Filters advance with the thrust believed since the last step, then take what has arrived.
        if row > 0:
            status = gp_ekf_history.step(
                nodes_gp, P_all_gp, ring_gp, t_s, force, ekf, Z, weights, K_inv, inv_sq_scales, signal_var
            )
            status_plain = gp_ekf_history.step(
                nodes_plain, P_all_plain, ring_plain, t_s, force, ekf, no_Z, no_weights, no_K_inv, inv_sq_scales,
                signal_var,
            )  # fmt: skip
            if status != _OK or status_plain != _OK:
                return -2
        for kind in range(3):
            for slot in range(_WAITING):
                sent = picture_sent[slot] if kind == 2 else gnss_sent[kind, slot]
                delay = camera_delay if kind == 2 else gnss_delay
                if sent < 0.0 or step_count < sent + delay:
                    continue
                if kind == 2:
                    picture_sent[slot] = -1.0
                    camera_var[:] = picture_std[slot] ** 2
                    z[:] = picture_value[slot]
                    held[0], held[1] = z[0], z[1]
                    fresh = 1.0
                    source = _REL_POS
                else:
                    gnss_sent[kind, slot] = -1.0
                    z[:] = gnss_value[kind, slot]
                    source = _VEHICLE_POS if kind == 0 else _VEHICLE_VEL
                var = camera_var if kind == 2 else (pos_var if kind == 0 else vel_var)
                status = gp_ekf_history.measure(
                    nodes_gp, P_all_gp, ring_gp, nis, sent * dt_s, source, z, var, ekf,
                    Z, weights, K_inv, inv_sq_scales, signal_var,
                )  # fmt: skip
                status_plain = gp_ekf_history.measure(
                    nodes_plain, P_all_plain, ring_plain, nis, sent * dt_s, source, z, var, ekf,
                    no_Z, no_weights, no_K_inv, inv_sq_scales, signal_var,
                )  # fmt: skip
                if (status != _OK and status != _GATED) or (status_plain != _OK and status_plain != _GATED):
                    return -2
        gp_ekf_history.newest(x_gp, P_gp, nodes_gp, P_all_gp, ring_gp)
        gp_ekf_history.newest(x_plain, P_plain, nodes_plain, P_all_plain, ring_plain)

        # Path following.
        feedback = int(f[_F.FEEDBACK])
        for i in range(n):
            estimate[i] = true[i] if feedback == _TRUTH else (x_plain[i] if feedback == _EKF else x_gp[i])
        if not begun:
            if path_following.begin(state, estimate, waypoints, path) != _OK:
                return -3
            begun = True
        if path_following.update(
            terms, state, estimate, force, specific_force, waypoints, path, outer_s if row > 0 else 0.0
        ) != _OK:  # fmt: skip
            return -3
        f_v = terms[_T.F_V : _T.F_V + 3]
        wanted_thrust = sqrt(f_v[0] ** 2 + f_v[1] ** 2 + f_v[2] ** 2)
        path_following.desired_attitude(R_d, f_v, f[_F.YAW])
        if row > 0:
            rate_between(rate_raw, R_before, R_d, outer_s)
            blend = outer_s / (outer_s + f[_F.RATE_D_LAG])
            for i in range(3):
                rate_d_rate[i] = blend / outer_s * (rate_raw[i] - rate_d[i])
                rate_d[i] += blend * (rate_raw[i] - rate_d[i])
        for i in range(3):
            for j in range(3):
                R_before[i, j] = R_d[i, j]

        # Log.
        log[row, _L.T] = t_s
        for i in range(n):
            log[row, _L.TRUE + i] = true[i]
            log[row, _L.GP_EKF + i], log[row, _L.GP_EKF_VAR + i] = x_gp[i], P_gp[i, i]
            log[row, _L.EKF + i], log[row, _L.EKF_VAR + i] = x_plain[i], P_plain[i, i]
        log[row, _L.NEES] = _nees(x_gp, P_gp, true)
        log[row, _L.NEES + 1] = _nees(x_plain, P_plain, true)
        log[row, _L.CAMERA], log[row, _L.CAMERA + 1], log[row, _L.CAMERA_FRESH] = held[0], held[1], fresh
        fresh = 0.0
        for i in range(_TERMS):
            log[row, _L.TERMS + i] = terms[i]
        log[row, _L.LEG] = state[_M.LEG]
        log[row, _L.THRUST], log[row, _L.TENSION] = y[_Y.THRUST], y[_Y.TENSION]
        log[row, _L.TILT] = sqrt(R[0, 2] ** 2 + R[1, 2] ** 2)
        leg, last = int(state[_M.LEG]), waypoints.shape[0] - 1
        leg_length, along = 0.0, 0.0
        for i in range(3):
            if leg < last:
                way = waypoints[leg + 1, i] - waypoints[leg, i]
                leg_length += way * way
                along += way * (true[_X.LOAD_POS + i] - waypoints[leg, i])
        leg_length = max(sqrt(leg_length), 1e-9)
        for i in range(3):
            n_i = (waypoints[leg + 1, i] - waypoints[leg, i]) / leg_length if leg < last else 0.0
            log[row, _L.TRUE_E_P + i] = true[_X.LOAD_POS + i] - waypoints[leg, i] - along / leg_length * n_i
            log[row, _L.TRUE_E_V + i] = true[_X.LOAD_VEL + i] - path[_P.CRUISE] * n_i
            log[row, _L.FORCE + i] = force[i]
            log[row, _L.POS + i] = x[_S.POS + i]
        for i in range(4):
            log[row, _L.QUAT + i] = x[_S.QUAT + i]
        held_s = held_s + outer_s if leg == last else 0.0
        if held_s > f[_F.STOP_AFTER]:
            return row + 1

        # Plant, sensors and attitude loop.
        felt_mean, pushed = np.zeros(3), np.zeros(3)
        for _ in range(every):
            normal = noise[step_count]
            _drift(
                tilt, tilt_raw, f[_F.TILT_STD], f[_F.TILT_STD], f[_F.TILT_TIME], _TILT_SMOOTHING_S, dt_s, normal[0:3]
            )
            _drift(
                pos_error, pos_raw, f[_F.POS_STD], f[_F.POS_STD + 1], f[_F.GNSS_TIME], f[_F.GNSS_SMOOTHING], dt_s,
                normal[9:12],
            )  # fmt: skip
            _drift(
                vel_error, vel_raw, f[_F.VEL_STD], f[_F.VEL_STD + 1], f[_F.GNSS_TIME], f[_F.GNSS_SMOOTHING], dt_s,
                normal[12:15],
            )  # fmt: skip
            _believed_attitude(R, x[_S.QUAT : _S.QUAT + 4], tilt)
            for i in range(3):
                rate[i] = x[_S.RATE + i] + f[_F.GYRO_STD] * normal[3 + i]
            tracking_torque(torque, R, rate, R_d, rate_d, rate_d_rate, J, f[_F.B_R], f[_F.B_OMEGA])
            given = 0.0
            for i in range(n_rotors):
                t = allocation[i, 0] * wanted_thrust
                for j in range(3):
                    t += allocation[i, 1 + j] * torque[j]
                t = min(max(t, 0.0), f[_F.ROTOR_THRUST_MAX])
                given += t
                u[_U.OMEGA + i] = sqrt(t / (f[_F.BELIEVED_DENSITY_RATIO] * believed_rotors[i, Rotor.THRUST]))
            before = believed_thrust
            believed_thrust += (1.0 - exp(-dt_s / f[_F.BELIEVED_LAG])) * (given - believed_thrust)
            for i in range(3):
                pushed[i] -= 0.5 * (before + believed_thrust) * R[i, 2] / every

            # What is measured now arrives later.
            if step_count % gnss_every == 0:
                slot = positions % _WAITING
                gnss_sent[0, slot] = step_count
                for i in range(3):
                    gnss_value[0, slot, i] = x[_S.POS + i] + pos_error[i]
            if step_count % gnss_every == gnss_every // 2:
                slot = positions % _WAITING
                gnss_sent[1, slot] = step_count
                for i in range(3):
                    gnss_value[1, slot, i] = x[_S.VEL + i] + vel_error[i]
                positions += 1
            if step_count * dt_s >= pictures * f[_F.CAMERA_PERIOD] and pictures < camera.shape[0]:
                distance, down = 0.0, 0.0
                r = matrix(x[_S.QUAT], x[_S.QUAT + 1], x[_S.QUAT + 2], x[_S.QUAT + 3])
                for i in range(3):
                    way = x[_S.LOAD_POS + i] - x[_S.POS + i]
                    distance += way * way
                    down += way * r[3 * i + 2]
                distance = sqrt(distance)
                if camera[pictures, 0] > 0.5 and down > cos_half * distance:
                    slot = pictures % _WAITING
                    picture_sent[slot] = step_count
                    std = f[_F.CAMERA_STD] + f[_F.CAMERA_STD_SHARE] * distance
                    picture_std[slot] = std
                    # In the body the camera sees R^T (load - vehicle); turned back by the believed attitude.
                    seen = np.zeros(3)
                    picture_value[slot, :] = 0.0
                    for j in range(3):
                        for i in range(3):
                            seen[j] += r[3 * i + j] * (x[_S.LOAD_POS + i] - x[_S.POS + i])
                        seen[j] += std * camera[pictures, 1 + j]
                    for i in range(3):
                        for j in range(3):
                            picture_value[slot, i] -= R[i, j] * seen[j]
                pictures += 1

            if f[_F.TURBULENCE_WIND] > 0.0:
                _blow(u, gust, air, load_air, x, white[step_count], dt_s, f[_F.TURBULENCE_WIND], f)
            multirotor_step(x, x_dot, y, inflow, u, plant, rotors, dt_s)
            for i in range(3):
                felt = y[_Y.SPECIFIC_FORCE + i] + f[_F.ACC_BIAS + i] + f[_F.ACC_STD] * normal[6 + i]
                felt_mean[i] += felt / every
            step_count += 1
        for i in range(3):
            force[i] = pushed[i]
            specific_force[i] = R[i, 0] * felt_mean[0] + R[i, 1] * felt_mean[1] + R[i, 2] * felt_mean[2]
        if not believed_thrust < inf:
            return -1
    return log.shape[0]
