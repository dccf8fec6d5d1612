"""Between the body, the level frame that does not turn, and the heading frame.

``level`` is the filter's frame: aligned with the heading once, not turned after that. ``yaw_rad`` is the nose's heading
in it, so ``level_from_frd`` is the 3-2-1 rotation of (roll, pitch, yaw).
"""

import numpy as np

from swingd.core._jit import F8, MAT, VEC, VOID, kernel


@kernel(VOID(MAT, F8, F8, F8))
def level_from_frd(R_out, roll_rad, pitch_rad, yaw_rad):
    """Rotation matrix that takes body components to level components."""
    c_r, s_r = np.cos(roll_rad), np.sin(roll_rad)
    c_p, s_p = np.cos(pitch_rad), np.sin(pitch_rad)
    c_y, s_y = np.cos(yaw_rad), np.sin(yaw_rad)
    R_out[0, 0] = c_p * c_y
    R_out[0, 1] = s_r * s_p * c_y - c_r * s_y
    R_out[0, 2] = c_r * s_p * c_y + s_r * s_y
    R_out[1, 0] = c_p * s_y
    R_out[1, 1] = s_r * s_p * s_y + c_r * c_y
    R_out[1, 2] = c_r * s_p * s_y - s_r * c_y
    R_out[2, 0] = -s_p
    R_out[2, 1] = s_r * c_p
    R_out[2, 2] = c_r * c_p


@kernel(VOID(VEC, VEC, VEC, VEC))
def point_acceleration(acc_out, gyro, gyro_rate, point):
    """Acceleration of a body-fixed point relative to the origin: w' x r + w x (w x r), all in body axes."""
    w_r = gyro[0] * point[0] + gyro[1] * point[1] + gyro[2] * point[2]
    w_w = gyro[0] * gyro[0] + gyro[1] * gyro[1] + gyro[2] * gyro[2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        acc_out[i] = gyro_rate[j] * point[k] - gyro_rate[k] * point[j] + gyro[i] * w_r - w_w * point[i]


@kernel(VOID(VEC, VEC, VEC, VEC, VEC, MAT, VEC, VEC, VEC, F8, F8, F8, F8, F8))
def filter_inputs(
    z_out,
    u_out,
    acc_frd,
    gyro_frd,
    gyro_rate_frd,
    R,
    vel_level,
    hook_frd,
    imu_frd,
    thrust_n,
    mass_kg,
    drag_n_per_mps,
    drag_vertical_n_per_mps,
    gravity_mps2,
):
    """Acceleration of the hook and the forces that go with it.

    The two point masses of the filter are joined at the hook. With r_h the hook from the centre of gravity, the
    vehicle's equation m a_cg = m g + u + fa + cable becomes, for the hook's acceleration a_h = a_cg + a_rel,
    m a_h = m g + (u + m a_rel) + fa + cable: the same model with a_rel added on both sides.

    Parameters
    ----------
    z_out : (3,), written
        Inertial acceleration of the hook, level frame [m/s^2].
    u_out : (3,), written
        Thrust, drag and m a_rel, level frame [N].
    acc_frd : (3,)
        Specific force at the IMU [m/s^2].
    gyro_frd, gyro_rate_frd : (3,)
        Body rates and their derivative [rad/s], [rad/s^2].
    R : (3, 3)
        level_from_frd.
    vel_level : (3,)
        Velocity of the vehicle over ground [m/s].
    hook_frd, imu_frd : (3,)
        From the centre of gravity [m].
    thrust_n : float
        Along body -z [N].
    mass_kg, drag_n_per_mps, drag_vertical_n_per_mps, gravity_mps2 : float
        Vehicle and gravity; the drag acts on body axes.
    """
    imu_rel = np.empty(3)
    hook_rel = np.empty(3)
    point_acceleration(imu_rel, gyro_frd, gyro_rate_frd, imu_frd)
    point_acceleration(hook_rel, gyro_frd, gyro_rate_frd, hook_frd)
    acc = np.empty(3)
    force = np.empty(3)
    for i in range(3):
        acc[i] = acc_frd[i] - imu_rel[i] + hook_rel[i]
        vel_body = R[0, i] * vel_level[0] + R[1, i] * vel_level[1] + R[2, i] * vel_level[2]
        drag = drag_vertical_n_per_mps if i == 2 else drag_n_per_mps
        force[i] = mass_kg * hook_rel[i] - drag * vel_body
    force[2] -= thrust_n
    for i in range(3):
        z_out[i] = R[i, 0] * acc[0] + R[i, 1] * acc[1] + R[i, 2] * acc[2]
        u_out[i] = R[i, 0] * force[0] + R[i, 1] * force[1] + R[i, 2] * force[2]
    z_out[2] += gravity_mps2


@kernel(VOID(VEC, VEC, VEC, VEC, MAT, F8, F8, F8))
def swing_in_heading(angles_out, vector_out, x, x_rate, P, lead_s, yaw_rad, yaw_rate_radps):
    """Carry swing and heading a little ahead and express the swing in the heading frame.

    (xi, zeta) is not a vector: the cable's direction and its derivative are turned, never the pair of angles.

    Parameters
    ----------
    angles_out : (6,), written
        xi, zeta [rad], their derivatives, the frame's rotation included [rad/s], and the deviations of xi, zeta [rad].
    vector_out : (4,), written
        Horizontal part of the cable's unit vector and of its derivative in the level frame [1], [1/s].
    x, x_rate : (>= 4,)
        xi, zeta and their rates in the level frame, and the derivative of that.
    P : (>= 2, >= 2)
        Covariance of xi, zeta in the level frame.
    lead_s : float
        How far ahead [s].
    yaw_rad, yaw_rate_radps : float
        Heading in the level frame and its rate.
    """
    xi = x[0] + lead_s * (x[2] + 0.5 * lead_s * x_rate[2])
    zeta = x[1] + lead_s * (x[3] + 0.5 * lead_s * x_rate[3])
    xi_rate = x[2] + lead_s * x_rate[2]
    zeta_rate = x[3] + lead_s * x_rate[3]
    s_xi, c_xi = np.sin(xi), np.cos(xi)
    s_zeta, c_zeta = np.sin(zeta), np.cos(zeta)
    n_x, n_y, n_z = s_zeta, -s_xi * c_zeta, c_xi * c_zeta
    n_d_xi = (0.0, -c_xi * c_zeta, -s_xi * c_zeta)
    n_d_zeta = (c_zeta, s_xi * s_zeta, -c_xi * s_zeta)
    v_x = n_d_zeta[0] * zeta_rate
    v_y = n_d_xi[1] * xi_rate + n_d_zeta[1] * zeta_rate
    v_z = n_d_xi[2] * xi_rate + n_d_zeta[2] * zeta_rate
    vector_out[0], vector_out[1], vector_out[2], vector_out[3] = n_x, n_y, v_x, v_y

    heading = yaw_rad + lead_s * yaw_rate_radps
    c_y, s_y = np.cos(heading), np.sin(heading)
    h_x = c_y * n_x + s_y * n_y
    h_y = -s_y * n_x + c_y * n_y
    rate_x = c_y * v_x + s_y * v_y + yaw_rate_radps * h_y
    rate_y = -s_y * v_x + c_y * v_y - yaw_rate_radps * h_x
    h_x = min(1.0, max(-1.0, h_x))
    across2 = max(h_y * h_y + n_z * n_z, 1e-12)
    along = np.sqrt(across2)
    angles_out[0] = np.arctan2(-h_y, n_z)
    angles_out[1] = np.arcsin(h_x)
    angles_out[2] = (h_y * v_z - n_z * rate_y) / across2
    angles_out[3] = rate_x / along

    jacobian = np.empty((2, 2))
    for column in range(2):
        d = n_d_xi if column == 0 else n_d_zeta
        d_x = c_y * d[0] + s_y * d[1]
        d_y = -s_y * d[0] + c_y * d[1]
        jacobian[0, column] = (h_y * d[2] - n_z * d_y) / across2
        jacobian[1, column] = d_x / along
    for row in range(2):
        var = 0.0
        for i in range(2):
            for j in range(2):
                var += jacobian[row, i] * P[i, j] * jacobian[row, j]
        angles_out[4 + row] = np.sqrt(max(var, 0.0))
