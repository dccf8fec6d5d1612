"""Messages as an autopilot sends them."""

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Codec


def px4_heartbeat(armed: bool = False, main_mode: int = 4) -> Any:
    base_mode = 1 | (128 if armed else 0)
    return mavlink.MAVLink_heartbeat_message(2, 12, base_mode, main_mode << 16, 4, 3)


def copter_heartbeat(armed: bool = True, custom_mode: int = 4) -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 3, 1 | (128 if armed else 0), custom_mode, 4, 3)


def _noise(t_boot_s: float) -> int:
    """No two readings of a real sensor in a row are the same."""
    return (round(t_boot_s * 1e3) + 3) % 7


def imu(
    t_boot_s: float, acc: tuple[float, float, float] = (0.1, 0.2, -9.8), xgyro: float = 0.01, number: int = 0
) -> Any:
    return mavlink.MAVLink_highres_imu_message(
        round(t_boot_s * 1e6), *acc, xgyro, 0.02, 0.03 + 1e-7 * _noise(t_boot_s), 0, 0, 0, 1000, 0, 10, 20, 63, number
    )


def raw_imu(t_boot_s: float, acc_mg: tuple[int, int, int] = (10, -20, -1000), number: int = 0) -> Any:
    gyro_mradps = (100, -200, 300 + _noise(t_boot_s))
    return mavlink.MAVLink_raw_imu_message(round(t_boot_s * 1e6), *acc_mg, *gyro_mradps, 0, 0, 0, number)


def scaled_imu(t_boot_s: float, acc_mg: tuple[int, int, int] = (10, -20, -1000)) -> Any:
    gyro_mradps = (100, -200, 300 + _noise(t_boot_s))
    return mavlink.MAVLink_scaled_imu_message(round(t_boot_s * 1e3) % 2**32, *acc_mg, *gyro_mradps, 0, 0, 0)


def vfr_hud(throttle_percent: int) -> Any:
    return mavlink.MAVLink_vfr_hud_message(0.0, 0.0, 0, throttle_percent, 0.0, 0.0)


def attitude(t_boot_s: float, roll: float = 0.1, pitch: float = -0.2, yaw: float = 0.3) -> Any:
    return mavlink.MAVLink_attitude_message(round(t_boot_s * 1e3) % 2**32, roll, pitch, yaw, 0, 0, 0)


def attitude_quaternion(t_boot_s: float, q: tuple[float, float, float, float]) -> Any:
    return mavlink.MAVLink_attitude_quaternion_message(round(t_boot_s * 1e3) % 2**32, *q, 0, 0, 0)


def attitude_target(t_boot_s: float, thrust: float, type_mask: int = 0) -> Any:
    return mavlink.MAVLink_attitude_target_message(
        round(t_boot_s * 1e3) % 2**32, type_mask, [1, 0, 0, 0], 0, 0, 0, thrust
    )


def actuators(t_boot_s: float, values: list[float]) -> Any:
    return mavlink.MAVLink_actuator_output_status_message(
        round(t_boot_s * 1e6), 16, [*values, *([900.0] * 4), *([0.0] * (28 - len(values)))]
    )


def servos(t_boot_s: float, values: list[int], port: int = 0) -> Any:
    return mavlink.MAVLink_servo_output_raw_message(
        round(t_boot_s * 1e6) % 2**32, port, *[*values, *([900] * (16 - len(values)))]
    )


def battery(millivolts: list[int], number: int = 0, ext: tuple[int, ...] = (0, 0, 0, 0)) -> Any:
    voltages = [*millivolts, *([65535] * (10 - len(millivolts)))]
    return mavlink.MAVLink_battery_status_message(number, 1, 1, 32767, voltages, -1, -1, -1, 50, 0, 1, list(ext))


def sys_status(millivolts: int) -> Any:
    return mavlink.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, -1, -1, 0, 0, 0, 0, 0, 0)


def local_position(t_boot_s: float, pos: tuple[float, ...] = (1, 2, -3), vel: tuple[float, ...] = (0.1, 0.2, 0)) -> Any:
    return mavlink.MAVLink_local_position_ned_message(round(t_boot_s * 1e3) % 2**32, *pos, *vel)


def app_setpoint(
    type_mask: int = 0x9C7, frame: int = 1, system: int = 1, component: int = 191, vx: float = 3.0, x: float = math.nan
) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, component, frame, type_mask, x, 0, 0, vx, -1.0, 0.5, math.nan, 0, 0, 0.7, 0
    )


class Autopilot:
    """Packs messages as component 1 of a system."""

    def __init__(self, system_id: int = 1, component_id: int = 1) -> None:
        self.codec = Codec(system_id, component_id)

    def __call__(self, *messages: Any) -> bytes:
        return b"".join(map(self.codec.encode, messages))


def landing_target(
    stamp_us: int,
    position: tuple[float, float, float] = (0.1, -0.2, 1.5),
    frame: int = mavlink.MAV_FRAME_BODY_FRD,
    number: int = 0,
    valid: int = 1,
) -> Any:
    """A load that a camera sees."""
    return mavlink.MAVLink_landing_target_message(
        stamp_us, number, frame, 0.0, 0.0, 1.5, 0.0, 0.0, *position, [1, 0, 0, 0], 2, valid
    )
