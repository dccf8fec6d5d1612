"""A whole flight of several quadrotors that carry one load, compiled: plant, gusts, autopilots.

Every vehicle follows its own reference with a cascade of its own and knows nothing of the others, so that the load's
motion is fed forward only; the sensors that the estimators see are made of the log afterwards.
"""

from enum import IntEnum
from math import asin, atan2

import numpy as np

from swingd.core._jit import F8, I8, MAT, VEC, VOID, kernel
from swingd.core.cooperative_plant import (
    FIRST_CARRIER,
    BodyState,
    CarrierInput,
    CarrierOutput,
    CarrierState,
    LoadInput,
    cooperative_step,
)
from swingd.core.px4_cascade import CascadeInput, CascadeState, cascade_update


class LoadLog(IntEnum):
    """Columns of the log that tell of the load; truth."""

    T = 0
    POS = 1
    """ned, 3."""
    VEL = 4
    """ned, 3."""
    EULER = 7
    """Roll, pitch, yaw of its frd axes."""
    SIZE = 10


class CarrierLog(IntEnum):
    """Columns of the log that tell of a vehicle, after the load's and one vehicle after the other; truth."""

    POS = 0
    """ned, 3."""
    VEL = 3
    """ned, 3."""
    EULER = 6
    """3"""
    SPECIFIC_FORCE = 9
    """At the CG, frd, 3: mean over the sample that begins here."""
    ACC = 12
    """Inertial, ned, 3: mean over the sample."""
    CABLE_FORCE = 15
    """Pull of its tethers, ned, 3: mean over the sample."""
    THRUST = 18
    """Mean over the sample [N]."""
    WINCH = 19
    """[m]"""
    SIZE = 20


class Reference(IntEnum):
    """Columns of the references that tell of a vehicle, one vehicle after the other."""

    POS = 0
    """ned, 3."""
    VEL = 3
    """ned, 3."""
    ACC = 6
    """Fed forward, ned, 3."""
    YAW = 9
    WINCH = 10
    """[m]"""
    SIZE = 11


_B = BodyState
_C = CarrierState
_I = CascadeInput
_K = CarrierLog
_Y = CarrierOutput
_R = Reference
ROTORS = 4
CASCADE_INPUTS = int(_I.SIZE)
CASCADE_STATES = int(CascadeState.SIZE)
NOISE_PER_CARRIER = 6
"""Standard normals of one sample: position and velocity that the autopilot gets."""
GUST_PER_LOAD = 6
"""Force and moment of the air on the load."""


@kernel(VOID(VEC, VEC))
def euler(out, q):
    """Roll, pitch, yaw (3,) of a quaternion of unit length, 3-2-1."""
    out[0] = atan2(2.0 * (q[0] * q[1] + q[2] * q[3]), 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]))
    out[1] = asin(min(max(2.0 * (q[0] * q[2] - q[3] * q[1]), -1.0), 1.0))
    out[2] = atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]))


@kernel(I8(MAT, MAT, VEC, VEC, MAT, MAT, MAT, VEC, MAT, MAT, MAT, VEC, F8, I8))
def fly(
    log, tension_log, x, p, rotors, tethers, allocation, cascade, references, gusts, noise, noise_std, dt_s,
    control_every,
):  # fmt: skip
    """Fly along the references.

    Parameters
    ----------
    log : (n, LoadLog.SIZE + c CarrierLog.SIZE), written
        One row for every sample of the autopilots.
    tension_log : (n, k), written
        Of every tether at the row's instant [N].
    x : (BodyState.SIZE + c CarrierState.SIZE,), changed
    p, rotors, tethers
        See `swingd.core.cooperative_plant`.
    allocation, cascade
        See `swingd.core.px4_cascade`; the vehicles are alike.
    references : (n, c Reference.SIZE)
    gusts : (n, GUST_PER_LOAD)
        Force (ned) and moment (frd) of the air on the load, held over a sample.
    noise : (n, c NOISE_PER_CARRIER)
        Standard normals.
    noise_std : (2,)
        Of the position [m] and of the velocity [m/s] that the autopilots get.
    dt_s : float
        Step of the plant [s].
    control_every : int
        Steps of the plant in a sample.

    Returns
    -------
    int
        Rows written; less than n where the flight diverged.
    """
    carriers = (x.shape[0] - FIRST_CARRIER) // _C.SIZE
    control_s = control_every * dt_s
    u = np.zeros(LoadInput.SIZE + carriers * CarrierInput.SIZE)
    y, tensions = np.zeros(carriers * _Y.SIZE), np.zeros(tethers.shape[0])
    memory = np.zeros((carriers, CASCADE_STATES))
    for c in range(carriers):
        for i in range(3):
            memory[c, CascadeState.VEL_SLOW + i] = x[FIRST_CARRIER + c * _C.SIZE + _B.VEL + i]
    sample, angles, acc_vc, omega = np.zeros(CASCADE_INPUTS), np.empty(3), np.zeros(3), np.zeros(ROTORS)
    for row in range(log.shape[0]):
        log[row, :] = 0.0
        log[row, LoadLog.T] = row * control_s
        euler(angles, x[_B.QUAT : _B.QUAT + 4])
        for i in range(3):
            log[row, LoadLog.POS + i] = x[_B.POS + i]
            log[row, LoadLog.VEL + i] = x[_B.VEL + i]
            log[row, LoadLog.EULER + i] = angles[i]
        for i in range(GUST_PER_LOAD):
            u[i] = gusts[row, i]
        for c in range(carriers):
            own = x[FIRST_CARRIER + c * _C.SIZE : FIRST_CARRIER + (c + 1) * _C.SIZE]
            wanted = references[row, c * _R.SIZE : (c + 1) * _R.SIZE]
            out = log[row, LoadLog.SIZE + c * _K.SIZE : LoadLog.SIZE + (c + 1) * _K.SIZE]
            euler(angles, own[_B.QUAT : _B.QUAT + 4])
            for i in range(3):
                out[_K.POS + i] = own[_B.POS + i]
                out[_K.VEL + i] = own[_B.VEL + i]
                out[_K.EULER + i] = angles[i]
                sample[_I.POS + i] = own[_B.POS + i] + noise_std[0] * noise[row, c * NOISE_PER_CARRIER + i]
                sample[_I.VEL + i] = own[_B.VEL + i] + noise_std[1] * noise[row, c * NOISE_PER_CARRIER + 3 + i]
                sample[_I.EULER + i] = angles[i]
                sample[_I.RATE + i] = own[_B.RATE + i]
                sample[_I.POS_SP + i] = wanted[_R.POS + i]
                sample[_I.VEL_SP + i] = wanted[_R.VEL + i]
                sample[_I.ACC_SP + i] = wanted[_R.ACC + i]
            out[_K.WINCH] = own[_C.WINCH]
            sample[_I.YAW_SP] = wanted[_R.YAW]
            cascade_update(omega, acc_vc, memory[c], sample, cascade, allocation, rotors, control_s)
            given = u[LoadInput.SIZE + c * CarrierInput.SIZE : LoadInput.SIZE + (c + 1) * CarrierInput.SIZE]
            for j in range(ROTORS):
                given[CarrierInput.OMEGA + j] = omega[j]
            given[CarrierInput.WINCH_RATE] = (wanted[_R.WINCH] - own[_C.WINCH]) / control_s
        for step in range(control_every):
            cooperative_step(x, y, tensions, u, p, rotors, tethers, dt_s)
            if step == 0:
                for k in range(tethers.shape[0]):
                    tension_log[row, k] = tensions[k]
            for c in range(carriers):
                out = log[row, LoadLog.SIZE + c * _K.SIZE : LoadLog.SIZE + (c + 1) * _K.SIZE]
                for i in range(3):
                    out[_K.SPECIFIC_FORCE + i] += y[c * _Y.SIZE + _Y.SPECIFIC_FORCE + i] / control_every
                    out[_K.ACC + i] += y[c * _Y.SIZE + _Y.ACC + i] / control_every
                    out[_K.CABLE_FORCE + i] += y[c * _Y.SIZE + _Y.CABLE_FORCE + i] / control_every
                out[_K.THRUST] += y[c * _Y.SIZE + _Y.THRUST] / control_every
        total = 0.0
        for i in range(x.shape[0]):
            total += abs(x[i])
        if not np.isfinite(total):
            return row
    return log.shape[0]
