"""The messages in which a simulated autopilot describes itself."""

from math import asin, atan2, degrees, hypot, nan
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.core.slung_plant import GRAVITY
from swingd.model.events import LandedState, Vec3
from swingd.sim import geodesy
from swingd.sim.cascade import yaw_of
from swingd.sim.onboard import Onboard
from swingd.sim.plant import Quaternion, rotation_matrix

_MAGNETIC_NED_GAUSS = (0.21, 0.012, 0.43)
_RC_CHANNELS = 18
_UNUSED = 65535
_LANDED = {
    LandedState.UNKNOWN: mavlink.MAV_LANDED_STATE_UNDEFINED,
    LandedState.ON_GROUND: mavlink.MAV_LANDED_STATE_ON_GROUND,
    LandedState.IN_AIR: mavlink.MAV_LANDED_STATE_IN_AIR,
    LandedState.TAKING_OFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    LandedState.LANDING: mavlink.MAV_LANDED_STATE_LANDING,
}
_HEALTHY = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)


class Telemetry:
    """Builds messages from the state of an autopilot; PX4's form of each.

    Parameters
    ----------
    onboard : Onboard
        What is described.
    """

    idle_pwm = 900
    """Of a motor that is not armed [us]."""
    unused_pwm = 900
    """Of an output without a motor [us]."""
    magnetic_per_gauss = 1.0
    """Unit of HIGHRES_IMU's magnetometer."""

    def __init__(self, onboard: Onboard) -> None:
        self._onboard = onboard

    def highres_imu(self) -> Any:
        """Make HIGHRES_IMU."""
        sensed = self._onboard.sensed
        mag = [self.magnetic_per_gauss * value for value in self._magnetic_frd_gauss()]
        altitude = geodesy.ALTITUDE_M - sensed.pos_ned_m[2]
        pressure = 1013.25 * (1.0 - 2.25577e-5 * altitude) ** 5.25588 if altitude < 20000.0 else 50.0
        return mavlink.MAVLink_highres_imu_message(
            self._onboard.data_us,
            *sensed.imu_acc_frd_mps2,
            *sensed.imu_gyro_frd_radps,
            *mag,
            pressure,
            0.0,
            altitude,
            15.0,
            63,
        )

    def raw_imu(self) -> Any:
        """Make RAW_IMU in ArduPilot's manner: not raw, but in mG, mrad/s and mGauss."""
        return mavlink.MAVLink_raw_imu_message(self._onboard.data_us, *self._thousandths(), 0, 1500)

    def scaled_imu(self) -> Any:
        """Make SCALED_IMU, in mG, mrad/s and mGauss."""
        return mavlink.MAVLink_scaled_imu_message(self._onboard.data_ms, *self._thousandths(), 1500)

    def attitude(self) -> Any:
        """Make ATTITUDE."""
        sensed = self._onboard.sensed
        roll, pitch, yaw = euler_rad(sensed.ned_from_frd)
        return mavlink.MAVLink_attitude_message(self._onboard.data_ms, roll, pitch, yaw, *sensed.rates_frd_radps)

    def attitude_quaternion(self) -> Any:
        """Make ATTITUDE_QUATERNION."""
        sensed = self._onboard.sensed
        return mavlink.MAVLink_attitude_quaternion_message(
            self._onboard.data_ms, *sensed.ned_from_frd, *sensed.rates_frd_radps
        )

    def local_position(self) -> Any:
        """Make LOCAL_POSITION_NED."""
        sensed = self._onboard.sensed
        return mavlink.MAVLink_local_position_ned_message(self._onboard.data_ms, *sensed.pos_ned_m, *sensed.vel_ned_mps)

    def attitude_target(self) -> Any:
        """Make ATTITUDE_TARGET."""
        autopilot = self._onboard.autopilot
        return mavlink.MAVLink_attitude_target_message(
            round(1e3 * autopilot.attitude_sp_t_s),
            0,
            autopilot.attitude_sp,
            *autopilot.rates_sp_frd_radps,
            autopilot.thrust_sp,
        )

    def servo_output(self) -> Any:
        """Make SERVO_OUTPUT_RAW."""
        return mavlink.MAVLink_servo_output_raw_message(
            round(1e6 * self._onboard.autopilot.outputs_t_s) & 0xFFFFFFFF,
            0,
            *self._pwm(),
            *([self.unused_pwm] * 12),
        )

    def actuator_output(self) -> Any:
        """Make ACTUATOR_OUTPUT_STATUS."""
        actuators = [float(pwm) for pwm in self._pwm()] + [float(self.unused_pwm)] * 12 + [0.0] * 16
        return mavlink.MAVLink_actuator_output_status_message(
            round(1e6 * self._onboard.autopilot.outputs_t_s), 16, actuators
        )

    def position_target(self) -> Any:
        """Make POSITION_TARGET_LOCAL_NED."""
        setpoint = self._onboard.autopilot.setpoint
        values = [
            value if value is not None else nan
            for group in (setpoint.pos_ned_m, setpoint.vel_ned_mps, setpoint.acc_ned_mps2)
            for value in group
        ]
        yaw = setpoint.yaw_rad if setpoint.yaw_rad is not None else nan
        yaw_rate = setpoint.yaw_rate_radps if setpoint.yaw_rate_radps is not None else nan
        return mavlink.MAVLink_position_target_local_ned_message(
            self._onboard.data_ms, mavlink.MAV_FRAME_LOCAL_NED, 0, *values, yaw, yaw_rate
        )

    def vfr_hud(self) -> Any:
        """Make VFR_HUD."""
        sensed = self._onboard.sensed
        vel = sensed.vel_ned_mps
        return mavlink.MAVLink_vfr_hud_message(
            0.0,
            hypot(vel[0], vel[1]),
            round(degrees(yaw_of(sensed.ned_from_frd))) % 360,
            round(100.0 * self._onboard.autopilot.thrust_sp),
            geodesy.ALTITUDE_M - sensed.pos_ned_m[2],
            -vel[2],
        )

    def global_position(self) -> Any:
        """Make GLOBAL_POSITION_INT."""
        sensed = self._onboard.sensed
        pos, vel = sensed.pos_ned_m, sensed.vel_ned_mps
        return mavlink.MAVLink_global_position_int_message(
            self._onboard.data_ms,
            *global_int(pos),
            _int32(1000.0 * (self._onboard.autopilot.home_ned_m[2] - pos[2])),
            _int16(100.0 * vel[0]),
            _int16(100.0 * vel[1]),
            _int16(100.0 * vel[2]),
            round(100.0 * (degrees(yaw_of(sensed.ned_from_frd)) % 360.0)) % 36000,
        )

    def gps_raw(self) -> Any:
        """Make GPS_RAW_INT."""
        sensed = self._onboard.sensed
        vel = sensed.vel_ned_mps
        course = degrees(atan2(vel[1], vel[0])) % 360.0
        return mavlink.MAVLink_gps_raw_int_message(
            self._onboard.data_us,
            mavlink.GPS_FIX_TYPE_3D_FIX,
            *global_int(sensed.pos_ned_m),
            90,
            90,
            min(65534, round(100.0 * hypot(vel[0], vel[1]))),
            round(100.0 * course) % 36000,
            12,
        )

    def sys_status(self) -> Any:
        """Make SYS_STATUS."""
        battery = self._onboard.battery
        return mavlink.MAVLink_sys_status_message(
            _HEALTHY,
            _HEALTHY,
            _HEALTHY,
            100,
            min(65534, round(1000.0 * battery.reported_v)),
            -1,
            round(100.0 * battery.remaining),
            *(0, 0, 0, 0, 0, 0),
        )

    def battery_status(self) -> Any:
        """Make BATTERY_STATUS."""
        battery = self._onboard.battery
        # The whole pack stands in the first cell's field, as PX4 and Copter do without cell voltages.
        voltages = [min(65534, round(1000.0 * battery.reported_v))] + [_UNUSED] * 9
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            32767,
            voltages,
            -1,
            -1,
            -1,
            round(100.0 * battery.remaining),
            0,
            mavlink.MAV_BATTERY_CHARGE_STATE_OK,
        )

    def extended_sys_state(self) -> Any:
        """Make EXTENDED_SYS_STATE."""
        return mavlink.MAVLink_extended_sys_state_message(
            mavlink.MAV_VTOL_STATE_UNDEFINED, _LANDED[self._onboard.autopilot.landed_state]
        )

    def system_time(self) -> Any:
        """Make SYSTEM_TIME, without a Unix time."""
        return mavlink.MAVLink_system_time_message(0, self._onboard.data_ms)

    def home_position(self) -> Any:
        """Make HOME_POSITION."""
        home = self._onboard.autopilot.home_ned_m
        return mavlink.MAVLink_home_position_message(
            *global_int(home), *home, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, self._onboard.data_us
        )

    def global_origin(self) -> Any:
        """Make GPS_GLOBAL_ORIGIN."""
        return mavlink.MAVLink_gps_global_origin_message(*global_int((0.0, 0.0, 0.0)), self._onboard.data_us)

    def rc_channels(self) -> Any:
        """Make RC_CHANNELS, or None without a remote control."""
        channels = self._onboard.rc_channels
        if channels is None:
            return None
        given = [max(0, min(_UNUSED, int(value))) for value in channels[:_RC_CHANNELS]]
        padded = given + [_UNUSED] * (_RC_CHANNELS - len(given))
        return mavlink.MAVLink_rc_channels_message(self._onboard.data_ms, len(given), *padded, 255)

    def _pwm(self) -> list[int]:
        autopilot = self._onboard.autopilot
        if not autopilot.armed:
            return [self.idle_pwm] * 4
        return [1000 + round(1000.0 * rotor) for rotor in autopilot.rotors]

    def _magnetic_frd_gauss(self) -> list[float]:
        rotation = rotation_matrix(*self._onboard.sensed.ned_from_frd)
        n, e, d = _MAGNETIC_NED_GAUSS
        return [rotation[0][i] * n + rotation[1][i] * e + rotation[2][i] * d for i in range(3)]

    def _thousandths(self) -> list[int]:
        """Acceleration [mG], rates [mrad/s], magnetic field [mGauss]."""
        sensed = self._onboard.sensed
        acc = [_int16(1000.0 / GRAVITY * value) for value in sensed.imu_acc_frd_mps2]
        rates = [_int16(1000.0 * value) for value in sensed.imu_gyro_frd_radps]
        return acc + rates + [_int16(1000.0 * value) for value in self._magnetic_frd_gauss()]


class CopterTelemetry(Telemetry):
    """Copter's form of the messages, where it differs."""

    idle_pwm = 1000
    unused_pwm = 0
    magnetic_per_gauss = 1e6


def euler_rad(q: Quaternion) -> Vec3:
    """Roll, pitch and yaw (3-2-1) of an attitude."""
    w, x, y, z = q
    return (
        atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
        yaw_of(q),
    )


def global_int(pos_ned_m: Vec3) -> tuple[int, int, int]:
    """Latitude and longitude [1e-7 deg] and altitude [mm] of a local position."""
    lat, lon, alt_m = geodesy.global_of(pos_ned_m)
    return _int32(lat * 1e7), _int32(lon * 1e7), _int32(1000.0 * alt_m)


def _int32(value: float) -> int:
    return max(-(2**31), min(2**31 - 1, round(value)))


def _int16(value: float) -> int:
    return max(-(2**15), min(2**15 - 1, round(value)))
