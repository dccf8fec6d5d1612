"""Attitude by quaternion, scalar first."""

from math import sqrt

from numba.core.types import UniTuple

from swingd.core._jit import F8, VEC, VOID, kernel


@kernel(UniTuple(F8, 9)(F8, F8, F8, F8))
def matrix(qw, qx, qy, qz):
    """Rotation matrix of a quaternion of any length, row by row: ned_from_frd for the attitude of a body."""
    scale = 1.0 / sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    qw, qx, qy, qz = qw * scale, qx * scale, qy * scale, qz * scale
    return (
        1.0 - 2.0 * (qy * qy + qz * qz),
        2.0 * (qx * qy - qw * qz),
        2.0 * (qx * qz + qw * qy),
        2.0 * (qx * qy + qw * qz),
        1.0 - 2.0 * (qx * qx + qz * qz),
        2.0 * (qy * qz - qw * qx),
        2.0 * (qx * qz - qw * qy),
        2.0 * (qy * qz + qw * qx),
        1.0 - 2.0 * (qx * qx + qy * qy),
    )


@kernel(VOID(VEC, VEC, F8, F8, F8))
def quaternion_rate(q_dot_out, q, wx, wy, wz):
    """Derivative of an attitude's quaternion (4,) under body rates [rad/s]; written as for unit length."""
    scale = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    qw, qx, qy, qz = q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale
    q_dot_out[0] = 0.5 * (-qx * wx - qy * wy - qz * wz)
    q_dot_out[1] = 0.5 * (qw * wx + qy * wz - qz * wy)
    q_dot_out[2] = 0.5 * (qw * wy - qx * wz + qz * wx)
    q_dot_out[3] = 0.5 * (qw * wz + qx * wy - qy * wx)


@kernel(VOID(VEC))
def normalise(q):
    """Scale a quaternion (4,) to unit length, in place."""
    scale = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] *= scale
