"""A whole flight of the planar rotorcraft, compiled: plant, sensors, three ES-LKF, hierarchical control (Figure 2).

Escareno et al., ICINCO 2016, section 5. At every sample position, pitch and their rates are measured with noise, each
axis' filter corrects, the control acts on what the filters say, and thrust and torque are held until the next sample.

The axes are x, z, theta, in this order wherever there are three. A second set of filters sees the same flight without
noise: it is linear, so that its error is the first set's lag, and the difference of both is the noise.
"""

from enum import IntEnum
from math import cos, sin

import numpy as np

from swingd.core import es_lkf
from swingd.core._jit import I8, MAT, VEC, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.hierarchical import axis_force, thrust_and_pitch
from swingd.core.planar_rotorcraft import PlanarInput, PlanarParam, PlanarState, disturbances, step
from swingd.core.status import Status

NOISE_PER_SAMPLE = 6
"""Of x, z, theta, then of their rates."""


class PlanarFlightParam(IntEnum):
    """Offsets into a flight's description."""

    DT = 0
    """Between samples [s]."""
    STEPS = 1
    """Of the plant in a sample."""
    GAINS = 2
    """kp [1/s^2] and kd [1/s] of x, z, theta, 6."""
    COMPENSATE_TRANSLATION = 8
    """1: rho_hat of x and z is taken out."""
    COMPENSATE_ROTATION = 9
    TILT_MAX = 10
    """[rad]"""
    UP_MIN = 11
    """Least wanted force upwards [N]."""
    PROCESS_DENSITY = 12
    """Q_33 of the filters, 3 [N^2/s]."""
    INITIAL_VAR = 15
    """P_0 of every axis, 3."""
    POS_VAR = 18
    """Of the sensors, and as the filters assume it: x, z, theta, 3 [m^2, rad^2]."""
    VEL_VAR = 21
    """3"""
    TOLD_WANTED = 24
    """1: the filters are told the wanted force, else the thrust in the direction of the estimated pitch."""
    SIZE = 25


class Reference(IntEnum):
    """Columns of the reference; position, velocity and acceleration of x, then of z."""

    X = 0
    Z = 3
    PITCH_RATE = 6
    """Of the thrust that flies the reference undisturbed; its derivative follows."""
    SIZE = 8


class PlanarFlightLog(IntEnum):
    """Columns of the log, one row for every sample."""

    T = 0
    STATE = 1
    """Truth, `PlanarState`, 8."""
    POS_SP = 9
    """x, z wanted and the pitch asked for, 3."""
    ESTIMATE = 12
    """Positions, 3, and velocities, 3, of the filters."""
    RHO = 18
    """True disturbances, 3."""
    RHO_ESTIMATE = 21
    """3"""
    RHO_VAR = 24
    """As the filters believe it, 3."""
    RHO_NOISELESS = 27
    """Estimated without measurement noise, 3."""
    NIS = 30
    """3"""
    THRUST = 33
    TORQUE = 34
    BOUNDED = 35
    """1 where the wanted force was bounded."""
    SIZE = 36


_DT = int(PlanarFlightParam.DT)
_STEPS = int(PlanarFlightParam.STEPS)
_GAINS = int(PlanarFlightParam.GAINS)
_COMPENSATE_TRANSLATION = int(PlanarFlightParam.COMPENSATE_TRANSLATION)
_COMPENSATE_ROTATION = int(PlanarFlightParam.COMPENSATE_ROTATION)
_TILT_MAX = int(PlanarFlightParam.TILT_MAX)
_UP_MIN = int(PlanarFlightParam.UP_MIN)
_PROCESS_DENSITY = int(PlanarFlightParam.PROCESS_DENSITY)
_INITIAL_VAR = int(PlanarFlightParam.INITIAL_VAR)
_POS_VAR = int(PlanarFlightParam.POS_VAR)
_VEL_VAR = int(PlanarFlightParam.VEL_VAR)
_TOLD_WANTED = int(PlanarFlightParam.TOLD_WANTED)
_LOG_STATE = int(PlanarFlightLog.STATE)
_LOG_POS_SP = int(PlanarFlightLog.POS_SP)
_LOG_ESTIMATE = int(PlanarFlightLog.ESTIMATE)
_LOG_RHO = int(PlanarFlightLog.RHO)
_LOG_RHO_ESTIMATE = int(PlanarFlightLog.RHO_ESTIMATE)
_LOG_RHO_VAR = int(PlanarFlightLog.RHO_VAR)
_LOG_RHO_NOISELESS = int(PlanarFlightLog.RHO_NOISELESS)
_LOG_NIS = int(PlanarFlightLog.NIS)
_LOG_THRUST = int(PlanarFlightLog.THRUST)
_LOG_TORQUE = int(PlanarFlightLog.TORQUE)
_LOG_BOUNDED = int(PlanarFlightLog.BOUNDED)
_STATES = int(PlanarState.SIZE)
_MASS = int(PlanarParam.MASS)
_INERTIA = int(PlanarParam.INERTIA)
_THRUST = int(PlanarInput.THRUST)
_TORQUE = int(PlanarInput.TORQUE)
_INPUTS = int(PlanarInput.SIZE)
_REF_Z = int(Reference.Z)
_REF_PITCH_RATE = int(Reference.PITCH_RATE)
_OK = int(Status.OK)


@kernel(I8(MAT, VEC, VEC, VEC, MAT, MAT, MAT))
def fly(log_out, x, p, f, reference, outside, noise):
    """Fly from rest until the reference ends.

    Parameters
    ----------
    log_out : (n, PlanarFlightLog.SIZE), written
    x : (PlanarState.SIZE,), changed
        True state, from the first sample to the last; the filters begin at its position.
    p : (PlanarParam.SIZE,)
    f : (PlanarFlightParam.SIZE,)
    reference : (n, Reference.SIZE)
    outside : (n, PlanarInput.SIZE)
        Torques and wind from each sample to the next; thrust and the rotors' torque in it are not read.
    noise : (n, NOISE_PER_SAMPLE)
        Standard normal.

    Returns
    -------
    int
        n; negative where the flight or a filter diverged.

    Notes
    -----
    The estimated pitch by which the filters are told the thrust's direction is that in the middle of the interval. Told
    the wanted force instead, they take the lag of the pitch for a disturbance.
    """
    dt_s = f[_DT]
    inertia = np.array([p[_MASS], p[_MASS], p[_INERTIA]])
    A = np.empty((3, 3, 3))
    B = np.empty((3, 3))
    Q = np.empty((3, 3, 3))
    # First index: 0 with measurement noise, 1 without.
    estimate = np.zeros((2, 3, 3))
    P = np.zeros((2, 3, 3, 3))
    for axis in range(3):
        es_lkf.discretise(A[axis], B[axis], Q[axis], inertia[axis], f[_PROCESS_DENSITY + axis], dt_s)
        for which in range(2):
            estimate[which, axis, 0] = x[axis]
            for i in range(3):
                P[which, axis, i, i] = f[_INITIAL_VAR + i]
    u = np.zeros(_INPUTS)
    z = np.empty(2)
    var = np.empty(2)
    nis = np.zeros(1)
    rho = np.empty(3)
    force = np.empty(3)
    wanted = np.empty(3)
    thrust_pitch = np.empty(2)
    for k in range(log_out.shape[0]):
        for axis in range(3):
            var[0] = f[_POS_VAR + axis]
            var[1] = f[_VEL_VAR + axis]
            # The noisy filters last: it is their innovation that is logged.
            for which in range(1, -1, -1):
                for i in range(2):
                    z[i] = x[4 * i + axis]
                    if which == 0:
                        z[i] += np.sqrt(var[i]) * noise[k, 3 * i + axis]
                if es_lkf.correct(estimate[which, axis], P[which, axis], nis, z, var, np.inf) != _OK:
                    return -1
            log_out[k, _LOG_NIS + axis] = nis[0]

        for axis in range(2):
            wanted[axis] = axis_force(
                estimate[0, axis, 0], estimate[0, axis, 1],
                reference[k, _REF_Z * axis], reference[k, _REF_Z * axis + 1], reference[k, _REF_Z * axis + 2],
                f[_GAINS + 2 * axis : _GAINS + 2 * axis + 2], inertia[axis], GRAVITY_MPS2 * axis,
            )  # fmt: skip
            wanted[axis] -= f[_COMPENSATE_TRANSLATION] * estimate[0, axis, 2]
        bounded = thrust_and_pitch(thrust_pitch, wanted[0], wanted[1], f[_UP_MIN], f[_TILT_MAX]) != _OK
        # The pitch asked for follows from noisy forces: its rate and acceleration are those of the reference alone.
        wanted[2] = axis_force(
            estimate[0, 2, 0], estimate[0, 2, 1],
            thrust_pitch[1], reference[k, _REF_PITCH_RATE], reference[k, _REF_PITCH_RATE + 1],
            f[_GAINS + 4 : _GAINS + 6], inertia[2], 0.0,
        )  # fmt: skip
        wanted[2] -= f[_COMPENSATE_ROTATION] * estimate[0, 2, 2]
        for i in range(_INPUTS):
            u[i] = outside[k, i]
        u[_THRUST] = thrust_pitch[0]
        u[_TORQUE] = wanted[2]

        if disturbances(rho, x, u, p) != _OK:
            return -1
        log_out[k, 0] = k * dt_s
        for i in range(_STATES):
            log_out[k, _LOG_STATE + i] = x[i]
        log_out[k, _LOG_POS_SP] = reference[k, 0]
        log_out[k, _LOG_POS_SP + 1] = reference[k, _REF_Z]
        log_out[k, _LOG_POS_SP + 2] = thrust_pitch[1]
        for axis in range(3):
            log_out[k, _LOG_ESTIMATE + axis] = estimate[0, axis, 0]
            log_out[k, _LOG_ESTIMATE + 3 + axis] = estimate[0, axis, 1]
            log_out[k, _LOG_RHO + axis] = rho[axis]
            log_out[k, _LOG_RHO_ESTIMATE + axis] = estimate[0, axis, 2]
            log_out[k, _LOG_RHO_VAR + axis] = P[0, axis, 2, 2]
            log_out[k, _LOG_RHO_NOISELESS + axis] = estimate[1, axis, 2]
        log_out[k, _LOG_THRUST] = u[_THRUST]
        log_out[k, _LOG_TORQUE] = u[_TORQUE]
        log_out[k, _LOG_BOUNDED] = 1.0 if bounded else 0.0

        for which in range(2):
            pitch = thrust_pitch[1]
            if f[_TOLD_WANTED] == 0.0:
                pitch = estimate[which, 2, 0] + 0.5 * dt_s * estimate[which, 2, 1]
            force[0] = u[_THRUST] * sin(pitch)
            force[1] = u[_THRUST] * cos(pitch) - inertia[1] * GRAVITY_MPS2
            force[2] = u[_TORQUE]
            for axis in range(3):
                status = es_lkf.predict(estimate[which, axis], P[which, axis], force[axis], A[axis], B[axis], Q[axis])
                if status != _OK:
                    return -1
        steps = int(f[_STEPS])
        for _ in range(steps):
            if step(x, u, p, dt_s / steps) != _OK:
                return -1
    return log_out.shape[0]
