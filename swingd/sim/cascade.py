"""PX4's multicopter loops: position, velocity, attitude, body rates, mixer, hover thrust; no clocks, no modes.

Structure and default gains are those of PX4 v1.16, because the swing that an undamped load shows is a property of
these loops. Scalars instead of arrays: the loops run 250 times a simulated second, and arrays of three cost more.
"""

from dataclasses import dataclass
from math import acos, asin, atan2, cos, exp, pi, radians, sin, sqrt

from swingd.core.slung_plant import GRAVITY
from swingd.model.events import Vec3
from swingd.sim.plant import ROTOR_FORWARD, ROTOR_RIGHT, ROTOR_SPIN, Quaternion, Rotors
from swingd.sim.px4_parameters import Px4Parameters

Axes = tuple[float | None, float | None, float | None]
"""Three components along ned; None where an axis is not commanded."""

_NO_AXES: Axes = (None, None, None)


@dataclass(frozen=True, slots=True)
class TrajectorySetpoint:
    """What the position controller follows, local ned; None is 'not commanded'."""

    pos_ned_m: Axes = _NO_AXES
    vel_ned_mps: Axes = _NO_AXES
    acc_ned_mps2: Axes = _NO_AXES
    yaw_rad: float | None = None
    yaw_rate_radps: float | None = None


@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """What is flown instead of a trajectory: an attitude or body rates, with a thrust or a climb rate."""

    ned_from_frd: Quaternion | None = None
    """None: body rates alone."""
    rates_frd_radps: Vec3 = (0.0, 0.0, 0.0)
    """Without an attitude all three are flown, with one the rate of its yaw."""
    thrust: float | None = None
    """Collective, 0..1; None: ``climb_mps`` is held."""
    climb_mps: float = 0.0


class PositionControl:
    """P on position, PID on velocity, acceleration setpoint added after it, thrust vector out."""

    def __init__(self, px4: Px4Parameters) -> None:
        self._integral = [0.0, 0.0, 0.0]
        self.acc_sp = [0.0, 0.0, 0.0]
        """Acceleration asked for, ned [m/s^2]."""
        self.vel_sp: Axes = _NO_AXES
        """Velocity asked for, ned [m/s]."""
        self.thrust_sp: Vec3 = (0.0, 0.0, 0.0)
        """Thrust asked for, ned, in units of full thrust."""
        self.hover_thrust = px4["MPC_THR_HOVER"]
        self.tilt_max_rad = radians(px4["MPC_TILTMAX_LND"])
        self.speed_up_max_mps = px4["MPC_Z_VEL_MAX_UP"]
        """Limit of the climb; negative while the take-off ramp holds the vehicle down."""
        self.thrust_min = px4["MPC_THR_MIN"]
        self.load(px4)

    def load(self, px4: Px4Parameters) -> None:
        """Take the gains and limits."""
        self._pos_p = (px4["MPC_XY_P"], px4["MPC_XY_P"], px4["MPC_Z_P"])
        self._vel_p = (px4["MPC_XY_VEL_P_ACC"], px4["MPC_XY_VEL_P_ACC"], px4["MPC_Z_VEL_P_ACC"])
        self._vel_i = (px4["MPC_XY_VEL_I_ACC"], px4["MPC_XY_VEL_I_ACC"], px4["MPC_Z_VEL_I_ACC"])
        self._vel_d = (px4["MPC_XY_VEL_D_ACC"], px4["MPC_XY_VEL_D_ACC"], px4["MPC_Z_VEL_D_ACC"])
        self._speed_xy_max = px4["MPC_XY_VEL_MAX"]
        self._speed_down_max = px4["MPC_Z_VEL_MAX_DN"]
        self._thrust_max = px4["MPC_THR_MAX"]
        self._thrust_xy_margin = px4["MPC_THR_XY_MARG"]

    def reset_integral(self) -> None:
        """Forget what the integrators learnt."""
        self._integral = [0.0, 0.0, 0.0]

    def update_hover_thrust(self, hover_thrust: float) -> None:
        """Take a new hover thrust without a step of the thrust: the vertical integrator absorbs it."""
        if hover_thrust > 1e-6:
            a = self.acc_sp[2]
            self._integral[2] += (a - GRAVITY) * self.hover_thrust / hover_thrust + GRAVITY - a
            self.hover_thrust = hover_thrust

    def update(self, dt_s: float, pos: Vec3, vel: Vec3, acc: Vec3, setpoint: TrajectorySetpoint) -> bool:
        """Compute ``thrust_sp`` from the state.

        Parameters
        ----------
        dt_s : float
            Since the last update [s].
        pos, vel, acc : (3,)
            Estimated position, velocity and filtered derivative of the velocity, ned.
        setpoint : TrajectorySetpoint
            Each axis needs a position, a velocity or an acceleration; north and east go in pairs.

        Returns
        -------
        bool
            False if the setpoint cannot be flown; nothing is changed.
        """
        p_sp, v_ff, a_ff = setpoint.pos_ned_m, setpoint.vel_ned_mps, setpoint.acc_ned_mps2
        for group in (p_sp, v_ff, a_ff):
            if (group[0] is None) != (group[1] is None):
                return False
        v_sp: list[float | None] = [None, None, None]
        v_pos = [0.0, 0.0, 0.0]
        for i in range(3):
            p, v = p_sp[i], v_ff[i]
            if p is None and v is None and a_ff[i] is None:
                return False
            if p is not None:
                v_pos[i] = (p - pos[i]) * self._pos_p[i]
                v_sp[i] = v_pos[i] + (v or 0.0)
            else:
                v_sp[i] = v
        vn, ve, vd = v_sp
        if vn is not None and ve is not None:
            vn, ve = _constrain_xy(v_pos[0], v_pos[1], vn - v_pos[0], ve - v_pos[1], self._speed_xy_max)
        if vd is not None:
            # In this order, so that the take-off ramp's negative limit wins.
            vd = max(min(vd, self._speed_down_max), -self.speed_up_max_mps)
        self.vel_sp = (vn, ve, vd)

        integral, gain_p, gain_d = self._integral, self._vel_p, self._vel_d
        integral[2] = max(-GRAVITY, min(GRAVITY, integral[2]))
        error = [0.0, 0.0, 0.0]
        acc_sp = self.acc_sp
        for i in range(3):
            v, a = self.vel_sp[i], a_ff[i]
            acc_sp[i] = a if a is not None else 0.0
            if v is not None:
                error[i] = v - vel[i]
                acc_sp[i] += error[i] * gain_p[i] + integral[i] - acc[i] * gain_d[i]

        thrust_n, thrust_e, thrust_d = self._thrust_vector()

        # Vertical integrator stops where the thrust does.
        if (thrust_d >= -self.thrust_min and error[2] >= 0.0) or (thrust_d <= -self._thrust_max and error[2] <= 0.0):
            error[2] = 0.0
        # The vertical has priority, except for a horizontal margin.
        thrust_xy = sqrt(thrust_n * thrust_n + thrust_e * thrust_e)
        max_squared = self._thrust_max * self._thrust_max
        margin = min(thrust_xy, self._thrust_xy_margin)
        thrust_d = max(thrust_d, -sqrt(max(max_squared - margin * margin, 0.0)))
        left = sqrt(max(max_squared - thrust_d * thrust_d, 0.0))
        if thrust_xy > left:
            thrust_n *= left / thrust_xy
            thrust_e *= left / thrust_xy
        # Tracking anti-windup: while saturated, the integrator unsaturates the output.
        per_thrust = GRAVITY / self.hover_thrust
        produced_n, produced_e = thrust_n * per_thrust, thrust_e * per_thrust
        if acc_sp[0] ** 2 + acc_sp[1] ** 2 > produced_n**2 + produced_e**2:
            arw = 2.0 / gain_p[0] if gain_p[0] > 0.0 else 0.0
            error[0] -= arw * (acc_sp[0] - produced_n)
            error[1] -= arw * (acc_sp[1] - produced_e)
        for i in range(3):
            if i == 2 or self.vel_sp[0] is not None:
                integral[i] += error[i] * self._vel_i[i] * dt_s
        self.thrust_sp = (thrust_n, thrust_e, thrust_d)
        return True

    def _thrust_vector(self) -> Vec3:
        """Turn the acceleration setpoint into a thrust vector within the tilt limit.

        The horizontal acceleration sets the tilt as if the vertical were gravity alone (MPC_ACC_DECOUPLE = 1).
        """
        n, e = -self.acc_sp[0], -self.acc_sp[1]
        norm = sqrt(n * n + e * e + GRAVITY * GRAVITY)
        zn, ze, zd = n / norm, e / norm, GRAVITY / norm
        limit = cos(self.tilt_max_rad)
        if zd < limit:
            across = sin(self.tilt_max_rad) / sqrt(zn * zn + ze * ze)
            zn, ze, zd = zn * across, ze * across, limit
        vertical = self.acc_sp[2] * (self.hover_thrust / GRAVITY) - self.hover_thrust
        collective = min(vertical / zd, -max(self.thrust_min, 1e-3))
        return (zn * collective, ze * collective, zd * collective)


def _constrain_xy(an: float, ae: float, bn: float, be: float, limit: float) -> tuple[float, float]:
    """Add two horizontal vectors within ``limit``, the first having priority."""
    n, e = an + bn, ae + be
    if n * n + e * e <= limit * limit:
        return n, e
    a = sqrt(an * an + ae * ae)
    b = sqrt(bn * bn + be * be)
    if a >= limit:
        return an / a * limit, ae / a * limit
    un, ue = bn / b, be / b
    m = un * an + ue * ae
    s = -m + sqrt(m * m - a * a + limit * limit)
    return an + un * s, ae + ue * s


def attitude_from_thrust(thrust_ned: Vec3, yaw_rad: float) -> Quaternion:
    """Attitude whose up axis points along the thrust and whose nose points to ``yaw_rad``, scalar first."""
    zn, ze, zd = -thrust_ned[0], -thrust_ned[1], -thrust_ned[2]
    norm = sqrt(zn * zn + ze * ze + zd * zd)
    if norm < 1e-9:
        zn, ze, zd, norm = 0.0, 0.0, 1.0, 1.0
    zn, ze, zd = zn / norm, ze / norm, zd / norm
    cn, ce = -sin(yaw_rad), cos(yaw_rad)
    # body x = y_heading x body z; the tilt limit keeps body z away from the horizontal.
    xn, xe, xd = ce * zd, -cn * zd, cn * ze - ce * zn
    norm = sqrt(xn * xn + xe * xe + xd * xd)
    xn, xe, xd = xn / norm, xe / norm, xd / norm
    yn, ye, yd = ze * xd - zd * xe, zd * xn - zn * xd, zn * xe - ze * xn
    trace = xn + ye + zd
    if trace > 0.0:
        s = 0.5 / sqrt(trace + 1.0)
        return (0.25 / s, (yd - ze) * s, (zn - xd) * s, (xe - yn) * s)
    if xn >= ye and xn >= zd:
        s = 0.5 / sqrt(1.0 + xn - ye - zd)
        return ((yd - ze) * s, 0.25 / s, (xe + yn) * s, (zn + xd) * s)
    if ye >= zd:
        s = 0.5 / sqrt(1.0 + ye - xn - zd)
        return ((zn - xd) * s, (xe + yn) * s, 0.25 / s, (yd + ze) * s)
    s = 0.5 / sqrt(1.0 + zd - xn - ye)
    return ((xe - yn) * s, (zn + xd) * s, (yd + ze) * s, 0.25 / s)


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def yaw_of(q: Quaternion) -> float:
    """Heading of an attitude (3-2-1 Euler yaw)."""
    w, x, y, z = q
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class AttitudeControl:
    """P on the attitude's quaternion, tilt before yaw."""

    def __init__(self, px4: Px4Parameters) -> None:
        self.load(px4)

    def load(self, px4: Px4Parameters) -> None:
        """Take the gains and limits."""
        self._yaw_weight = max(0.0, min(1.0, px4["MC_YAW_WEIGHT"]))
        yaw_p = px4["MC_YAW_P"] / self._yaw_weight if self._yaw_weight > 1e-4 else px4["MC_YAW_P"]
        self._gain = (px4["MC_ROLL_P"], px4["MC_PITCH_P"], yaw_p)
        self._limit = (
            radians(px4["MC_ROLLRATE_MAX"]),
            radians(px4["MC_PITCHRATE_MAX"]),
            radians(px4["MC_YAWRATE_MAX"]),
        )

    def update(self, q: Quaternion, q_sp: Quaternion, yaw_rate_radps: float) -> Vec3:
        """Give the body rates that turn attitude ``q`` to ``q_sp``, the yaw rate fed forward [rad/s]."""
        w, x, y, z = q
        ez = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
        sw, sx, sy, sz = q_sp
        dz = (2.0 * (sx * sz + sw * sy), 2.0 * (sy * sz - sw * sx), 1.0 - 2.0 * (sx * sx + sy * sy))
        # Shortest rotation, in ned, that brings the thrust axis home; what is left of q_sp after it is yaw.
        real = 1.0 + ez[0] * dz[0] + ez[1] * dz[1] + ez[2] * dz[2]
        inverse = (w, -x, -y, -z)
        if real > 1e-5:
            tx = ez[1] * dz[2] - ez[2] * dz[1]
            ty = ez[2] * dz[0] - ez[0] * dz[2]
            tz = ez[0] * dz[1] - ez[1] * dz[0]
            n = 1.0 / sqrt(real * real + tx * tx + ty * ty + tz * tz)
            reduced = multiply((real * n, tx * n, ty * n, tz * n), q)
            yaw = multiply((reduced[0], -reduced[1], -reduced[2], -reduced[3]), q_sp)
            yw, yz = (yaw[0], yaw[3]) if yaw[0] >= 0.0 else (-yaw[0], -yaw[3])
            yw, yz = min(yw, 1.0), max(-1.0, min(1.0, yz))
            wanted = multiply(reduced, (cos(self._yaw_weight * acos(yw)), 0.0, 0.0, sin(self._yaw_weight * asin(yz))))
        else:
            wanted = q_sp
        error = multiply(inverse, wanted)
        scale = 2.0 if error[0] >= 0.0 else -2.0
        gain, limit = self._gain, self._limit
        # Third row of ned_from_frd: the down axis in the body.
        down = (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), ez[2])
        a = scale * error[1] * gain[0] + down[0] * yaw_rate_radps
        b = scale * error[2] * gain[1] + down[1] * yaw_rate_radps
        c = scale * error[3] * gain[2] + down[2] * yaw_rate_radps
        return (
            max(-limit[0], min(limit[0], a)),
            max(-limit[1], min(limit[1], b)),
            max(-limit[2], min(limit[2], c)),
        )


class _Butterworth:
    """Second-order low-pass, one channel."""

    __slots__ = ("_a1", "_a2", "_b0", "_b1", "_d1", "_d2")

    def __init__(self, rate_hz: float, cutoff_hz: float) -> None:
        ohm = sin(pi * cutoff_hz / rate_hz) / cos(pi * cutoff_hz / rate_hz)
        c = 1.0 + sqrt(2.0) * ohm + ohm * ohm
        self._b0 = ohm * ohm / c
        self._b1 = 2.0 * self._b0
        self._a1 = 2.0 * (ohm * ohm - 1.0) / c
        self._a2 = (1.0 - sqrt(2.0) * ohm + ohm * ohm) / c
        self._d1 = self._d2 = 0.0

    def __call__(self, value: float) -> float:
        d0 = value - self._d1 * self._a1 - self._d2 * self._a2
        out = self._b0 * d0 + self._b1 * self._d1 + self._b0 * self._d2
        self._d2, self._d1 = self._d1, d0
        return out


class RateControl:
    """PID on body rates; torque out, in units of full torque.

    Parameters
    ----------
    px4 : Px4Parameters
        Gains.
    torque_gain_radps2 : (3,)
        Angular acceleration that full torque gives this vehicle at hover [rad/s^2]. The gains are scaled so that the
        loops are those that PX4's defaults give the vehicle they fit, as anybody who sets up a vehicle would do.
    rate_hz : float
        Calls per second.
    """

    # Full torque on PX4's default quadrotor (none_iris: 1.5 kg, arms of 0.13 m by 0.21 m, 45 N).
    _REFERENCE_RADPS2 = (148.0, 148.0, 51.0)

    def __init__(self, px4: Px4Parameters, torque_gain_radps2: Vec3, rate_hz: float) -> None:
        self._scale = tuple(r / t for r, t in zip(self._REFERENCE_RADPS2, torque_gain_radps2, strict=True))
        self._rate_hz = rate_hz
        self._integral = [0.0, 0.0, 0.0]
        self._last = [0.0, 0.0, 0.0]
        self._yaw_torque = 0.0
        self.saturated: tuple[int, int, int] = (0, 0, 0)
        """Sign of the torque that the mixer could not give, per axis."""
        self.load(px4)

    def load(self, px4: Px4Parameters) -> None:
        """Take the gains and limits."""
        names = ("ROLLRATE", "PITCHRATE", "YAWRATE")
        k = [px4[f"MC_{name}_K"] * self._scale[i] for i, name in enumerate(names)]
        self._p = [k[i] * px4[f"MC_{name}_P"] for i, name in enumerate(names)]
        self._i = [k[i] * px4[f"MC_{name}_I"] for i, name in enumerate(names)]
        self._d = [k[i] * px4[f"MC_{name}_D"] for i, name in enumerate(names)]
        self._limit = (px4["MC_RR_INT_LIM"], px4["MC_PR_INT_LIM"], px4["MC_YR_INT_LIM"])
        self._gyro = [_Butterworth(self._rate_hz, px4["IMU_GYRO_CUTOFF"]) for _ in range(3)]
        self._d_alpha = 1.0 - exp(-2.0 * pi * px4["IMU_DGYRO_CUTOFF"] / self._rate_hz)
        self._d_state = [0.0, 0.0, 0.0]
        cutoff = px4["MC_YAW_TQ_CUTOFF"]
        self._yaw_alpha = 1.0 - exp(-2.0 * pi * cutoff / self._rate_hz) if cutoff > 0.0 else 1.0

    def reset_integral(self) -> None:
        """Forget what the integrators learnt."""
        self._integral = [0.0, 0.0, 0.0]

    def update(self, dt_s: float, gyro: Vec3, rate_sp: Vec3, *, landed: bool) -> Vec3:
        """Give roll, pitch and yaw torque for one gyro sample."""
        torque = [0.0, 0.0, 0.0]
        for i in range(3):
            rate = self._gyro[i](gyro[i])
            derivative = (rate - self._last[i]) / dt_s
            self._last[i] = rate
            self._d_state[i] += self._d_alpha * (derivative - self._d_state[i])
            error = rate_sp[i] - rate
            torque[i] = self._p[i] * error + self._integral[i] - self._d[i] * self._d_state[i]
            if not landed and self.saturated[i] * error <= 0.0:
                # PX4 integrates less at large errors, against the bounce-back after flips.
                factor = max(0.0, 1.0 - (error / radians(400.0)) ** 2)
                limit = self._limit[i]
                self._integral[i] = max(-limit, min(limit, self._integral[i] + factor * self._i[i] * error * dt_s))
        self._yaw_torque += self._yaw_alpha * (torque[2] - self._yaw_torque)
        return (torque[0], torque[1], self._yaw_torque)


_HALF_SQRT2 = sqrt(0.5)
_ROLL = tuple(-_HALF_SQRT2 * r for r in ROTOR_RIGHT)
_PITCH = tuple(_HALF_SQRT2 * f for f in ROTOR_FORWARD)
_YAW = ROTOR_SPIN


def mix(thrust: float, torque: Vec3) -> tuple[Rotors, tuple[int, int, int]]:
    """Distribute thrust and torque over the rotors of a quad x, without airmode.

    Returns
    -------
    rotors : (4,)
        Throttle of each rotor, 0..1.
    saturated : (3,)
        Sign of the torque that could not be given about each axis, else 0.

    Notes
    -----
    As in PX4, roll and pitch take from the thrust but never add to it, then shrink; yaw gets what is left.
    """
    roll, pitch, yaw = torque
    lean = [_ROLL[i] * roll + _PITCH[i] * pitch for i in range(4)]
    high, low = max(lean), min(lean)
    spread = high - low
    scale = 1.0
    if spread > 1.0:
        scale = 1.0 / spread
    if thrust + scale * high > 1.0:
        thrust = 1.0 - scale * high
    if thrust + scale * low < 0.0 and low < 0.0:
        scale = max(0.0, min(scale, -thrust / low))
    lean = [thrust + scale * value for value in lean]
    # Yaw may take a little thrust (PX4's minimum yaw margin), then shrinks.
    yaw_scale = 1.0
    if yaw:
        top = max(lean[i] + _YAW[i] * yaw for i in range(4))
        if top > 1.0:
            thrust_given = min(top - 1.0, 0.15)
            lean = [value - thrust_given for value in lean]
        for i in range(4):
            step = _YAW[i] * yaw
            if step > 0.0 and lean[i] + step > 1.0:
                yaw_scale = min(yaw_scale, max(0.0, (1.0 - lean[i]) / step))
            elif step < 0.0 and lean[i] + step < 0.0:
                yaw_scale = min(yaw_scale, max(0.0, -lean[i] / step))
    out = [min(1.0, max(0.0, lean[i] + yaw_scale * _YAW[i] * yaw)) for i in range(4)]
    sign = (
        0 if scale > 0.999 else (roll > 0.0) - (roll < 0.0),
        0 if scale > 0.999 else (pitch > 0.0) - (pitch < 0.0),
        0 if yaw_scale > 0.999 else (yaw > 0.0) - (yaw < 0.0),
    )
    return (out[0], out[1], out[2], out[3]), sign


class HoverThrust:
    """PX4's one-state Kalman filter for the thrust that carries the vehicle, from the vertical acceleration."""

    def __init__(self, px4: Px4Parameters) -> None:
        self.reset(px4["MPC_THR_HOVER"])
        self.load(px4)

    def load(self, px4: Px4Parameters) -> None:
        """Take the process noise."""
        self._process_var = px4["HTE_HT_NOISE"] ** 2

    def reset(self, hover_thrust: float) -> None:
        """Start again from a guess."""
        self.value = hover_thrust
        self._var = 0.01
        self._acc_var = 5.0
        self._residual_mean = 0.0
        self._since_passed_s = 0.0

    @property
    def valid(self) -> bool:
        """Whether the estimate has settled."""
        return self._var < 0.001

    def update(self, dt_s: float, acc_up_mps2: float, thrust: float) -> None:
        """Fuse one vertical acceleration with the vertical part of the thrust that was commanded."""
        self._var += self._process_var * dt_s * dt_s
        h = -GRAVITY * thrust / (self.value * self.value)
        innovation = acc_up_mps2 - GRAVITY * (thrust / self.value - 1.0)
        innovation_var = h * self._var * h + self._acc_var
        if innovation * innovation <= 9.0 * innovation_var:
            gain = self._var * h / innovation_var
            self.value = max(0.1, min(0.9, self.value + gain * innovation))
            self._var = max((1.0 - gain * h) * self._var, 1e-10)
            self._since_passed_s = 0.0
        else:
            self._since_passed_s += dt_s
            if self._since_passed_s > 0.5:
                # The hover thrust has changed at once (a load let go): let the filter learn again.
                self._var += 1e4 * self._process_var * dt_s * dt_s
        residual = acc_up_mps2 - GRAVITY * (thrust / self.value - 1.0)
        self._residual_mean += dt_s / (1.5 + dt_s) * (residual - self._residual_mean)
        noise = (residual - self._residual_mean) ** 2 + h * self._var * h
        alpha = dt_s / (2.0 + dt_s)
        self._acc_var = max(1.0, min(400.0, (1.0 - alpha) * self._acc_var + alpha * noise))
