"""A rotorcraft in a vertical plane with a load on a rigid rod, Escareno et al., ICINCO 2016, (13)-(16).

x points forward, z up; pitch theta > 0 leans the thrust forward, T (sin theta, cos theta). The rod hangs freely from
the hook, rod angle gamma > 0 with the load behind: load = hook - l (sin gamma, cos gamma). A rod pulls and pushes.

Beyond the paper, whose hook is the centre of gravity, the hook may lie anywhere in the airframe, so that the load turns
it; air may drag; and torques may act from outside or between airframe and rod. With q = (x, z, theta, gamma) and J the
load's velocity by q', the equations of motion are

    (diag(m_r, m_r, I_r, 0) + m_p J^T J) q'' = forces - m_p J^T (J' q' + g e_z) - m_r g e_z
"""

from enum import IntEnum
from math import cos, sin

import numpy as np

from swingd.core._jit import F8, I8, VEC, kernel
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.linalg import cholesky, cholesky_solve
from swingd.core.status import Status


class PlanarState(IntEnum):
    """Indices of the state; the coordinates' rates follow in the same order."""

    X = 0
    """Forward [m]."""
    Z = 1
    """Up [m]."""
    PITCH = 2
    """theta [rad]; > 0: thrust leans forward."""
    ROD = 3
    """gamma [rad], from the vertical; > 0: load behind."""
    RATES = 4
    """4"""
    SIZE = 8


class PlanarParam(IntEnum):
    """Indices of the vehicle's parameters."""

    MASS = 0
    """Vehicle without load, m_r [kg]."""
    INERTIA = 1
    """I_r [kg m^2]."""
    LOAD_MASS = 2
    """m_p [kg]."""
    ROD_LENGTH = 3
    """l_p [m]."""
    HOOK = 4
    """From the centre of gravity along the body's axes e_1 (forward) and e_3 (up), 2 [m]."""
    DRAG = 6
    """Of the vehicle, force over velocity through the air [N s/m]."""
    LOAD_DRAG = 7
    SIZE = 8


class PlanarInput(IntEnum):
    """Indices of what acts, held over a step."""

    THRUST = 0
    """T [N]."""
    TORQUE = 1
    """u_theta, of the rotors [N m]."""
    ROD_TORQUE = 2
    """u_gamma, on the rod from the airframe [N m]; the airframe feels the opposite, (23)."""
    LOAD_TORQUE = 3
    """On the rod from outside [N m]."""
    AIRFRAME_TORQUE = 4
    """On the airframe from outside [N m]."""
    WIND = 5
    """Velocity of the air forward and up, 2 [m/s]."""
    SIZE = 7


_X, _Z, _PITCH, _ROD = int(PlanarState.X), int(PlanarState.Z), int(PlanarState.PITCH), int(PlanarState.ROD)
_RATES = int(PlanarState.RATES)
_STATES = int(PlanarState.SIZE)
_MASS = int(PlanarParam.MASS)
_INERTIA = int(PlanarParam.INERTIA)
_LOAD_MASS = int(PlanarParam.LOAD_MASS)
_ROD_LENGTH = int(PlanarParam.ROD_LENGTH)
_HOOK = int(PlanarParam.HOOK)
_DRAG = int(PlanarParam.DRAG)
_LOAD_DRAG = int(PlanarParam.LOAD_DRAG)
_THRUST = int(PlanarInput.THRUST)
_TORQUE = int(PlanarInput.TORQUE)
_ROD_TORQUE = int(PlanarInput.ROD_TORQUE)
_LOAD_TORQUE = int(PlanarInput.LOAD_TORQUE)
_AIRFRAME_TORQUE = int(PlanarInput.AIRFRAME_TORQUE)
_WIND = int(PlanarInput.WIND)
_OK = int(Status.OK)
_NOT_FINITE = int(Status.NOT_FINITE)


@kernel(I8(VEC, VEC, VEC, VEC))
def accelerations(acc_out, x, u, p):
    """Solve the equations of motion.

    Parameters
    ----------
    acc_out : (4,), written
        Second derivatives of x, z, theta, gamma; undefined unless ``OK``.
    x : (PlanarState.SIZE,)
    u : (PlanarInput.SIZE,)
    p : (PlanarParam.SIZE,)
        Masses, inertia and length > 0.

    Returns
    -------
    Status
        ``NOT_POSITIVE`` if a mass, the inertia or the length is not positive.
    """
    s, c = sin(x[_PITCH]), cos(x[_PITCH])
    s_rod, c_rod = sin(x[_ROD]), cos(x[_ROD])
    pitch_rate, rod_rate = x[_RATES + _PITCH], x[_RATES + _ROD]
    load_mass, length = p[_LOAD_MASS], p[_ROD_LENGTH]
    hook_x = p[_HOOK] * c + p[_HOOK + 1] * s
    hook_z = -p[_HOOK] * s + p[_HOOK + 1] * c
    J = np.zeros((2, 4))
    J[0, 0] = 1.0
    J[1, 1] = 1.0
    J[0, 2] = hook_z
    J[1, 2] = -hook_x
    J[0, 3] = -length * c_rod
    J[1, 3] = length * s_rod
    # Forces on the load in free fall with its own rotation: drag - m_p (J' q' + g e_z).
    force_x = load_mass * (hook_x * pitch_rate**2 - length * s_rod * rod_rate**2)
    force_z = load_mass * (hook_z * pitch_rate**2 - length * c_rod * rod_rate**2 - GRAVITY_MPS2)
    vel_x = x[_RATES + _X] + J[0, 2] * pitch_rate + J[0, 3] * rod_rate
    vel_z = x[_RATES + _Z] + J[1, 2] * pitch_rate + J[1, 3] * rod_rate
    force_x -= p[_LOAD_DRAG] * (vel_x - u[_WIND])
    force_z -= p[_LOAD_DRAG] * (vel_z - u[_WIND + 1])
    M = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            M[i, j] = load_mass * (J[0, i] * J[0, j] + J[1, i] * J[1, j])
        acc_out[i] = J[0, i] * force_x + J[1, i] * force_z
    M[0, 0] += p[_MASS]
    M[1, 1] += p[_MASS]
    M[2, 2] += p[_INERTIA]
    acc_out[0] += u[_THRUST] * s - p[_DRAG] * (x[_RATES + _X] - u[_WIND])
    acc_out[1] += u[_THRUST] * c - p[_DRAG] * (x[_RATES + _Z] - u[_WIND + 1]) - p[_MASS] * GRAVITY_MPS2
    acc_out[2] += u[_TORQUE] + u[_AIRFRAME_TORQUE] - u[_ROD_TORQUE]
    acc_out[3] += u[_ROD_TORQUE] + u[_LOAD_TORQUE]
    L = np.empty((4, 4))
    status = cholesky(L, M)
    if status == _OK:
        cholesky_solve(acc_out, L)
    return status


@kernel(I8(VEC, VEC, VEC, VEC))
def disturbances(rho_out, x, u, p):
    """What acts beside thrust, the rotors' torque and the vehicle's own weight: rho of (18), (20), (22).

    Parameters
    ----------
    rho_out : (3,), written
        rho_x, rho_z [N] and rho_theta [N m]; undefined unless ``OK``.
    x, u, p
        As in `accelerations`.

    Returns
    -------
    Status
        As `accelerations`.

    Notes
    -----
    With the hook at the centre of gravity these are -m_p times the load's acceleration against free fall, (19) and
    (21), and -u_gamma: what is printed in (23) is (16), with l_p where it must be l_p^2.
    """
    acc = np.empty(4)
    status = accelerations(acc, x, u, p)
    rho_out[0] = p[_MASS] * acc[0] - u[_THRUST] * sin(x[_PITCH])
    rho_out[1] = p[_MASS] * (acc[1] + GRAVITY_MPS2) - u[_THRUST] * cos(x[_PITCH])
    rho_out[2] = p[_INERTIA] * acc[2] - u[_TORQUE]
    return status


@kernel(I8(VEC, VEC, VEC, F8))
def step(x, u, p, dt_s):
    """Advance by the classical Runge-Kutta method.

    Parameters
    ----------
    x : (PlanarState.SIZE,), changed
        Untouched unless ``OK``.
    u : (PlanarInput.SIZE,)
        Held over the step.
    p : (PlanarParam.SIZE,)
    dt_s : float
        [s]

    Returns
    -------
    Status
        ``OK``, ``NOT_POSITIVE`` as in `accelerations`, or ``NOT_FINITE``.
    """
    stage = x.copy()
    total = np.zeros(_STATES)
    acc = np.empty(4)
    size = 0.0
    for weight, ahead in ((1.0, 0.5), (2.0, 0.5), (2.0, 1.0), (1.0, 0.0)):
        status = accelerations(acc, stage, u, p)
        if status != _OK:
            return status
        for i in range(4):
            total[i] += weight * stage[_RATES + i]
            total[_RATES + i] += weight * acc[i]
            # The position first: it takes the rate of this stage.
            stage[i] = x[i] + ahead * dt_s * stage[_RATES + i]
            stage[_RATES + i] = x[_RATES + i] + ahead * dt_s * acc[i]
    for i in range(_STATES):
        total[i] = x[i] + dt_s / 6.0 * total[i]
        size += abs(total[i])
    if not np.isfinite(size):
        return _NOT_FINITE
    for i in range(_STATES):
        x[i] = total[i]
    return _OK
