import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swingd.model.errors import ConfigurationError, LogFormatError
from swingd.model.events import (
    Attitude,
    AutopilotState,
    Battery,
    FlightMode,
    Imu,
    Landed,
    LandedState,
    LocalPosition,
    Motors,
    Throttle,
)
from swingd.model.parameters import Thrust
from swingd.record.ulog import read_ulog

from .ulog_file import UlogFile

approx = pytest.approx
VEHICLE_IMU = (
    "uint64_t timestamp_sample;float[3] delta_angle;float[3] delta_velocity;uint32_t delta_angle_dt;uint32_t "
    "delta_velocity_dt"
)


def flight(*, imu: bool = True, attitude: bool = True) -> UlogFile:
    log = UlogFile()
    if imu:
        log.topic("vehicle_imu", VEHICLE_IMU)
        for i in range(100):
            t_s = 10.0 + i * 0.005
            log.add("vehicle_imu", t_s + 0.001, round(t_s * 1e6), *[5e-5, 1e-4, 0], *[0.005, 0, -0.049], 5000, 5000)
    if attitude:
        half = math.radians(20.0) / 2
        log.topic("vehicle_attitude", "float[4] q")
        for i in range(50):
            log.add("vehicle_attitude", 10.0 + i * 0.01, math.cos(half), math.sin(half), 0.0, 0.0)
    return log


def read(log: UlogFile, tmp_path, thrust: Thrust | None = None) -> list:
    return list(read_ulog(log.write(tmp_path / "log.ulg"), thrust or Thrust()))


def only(events, kind) -> list:
    return [event for event in events if isinstance(event, kind)]


def test_imu_and_attitude_in_si_units_and_time_order(tmp_path):
    events = read(flight(), tmp_path)
    assert [e.t_mono_s for e in events] == sorted(e.t_mono_s for e in events)
    imu, attitude = only(events, Imu), only(events, Attitude)
    assert (len(imu), len(attitude)) == (100, 50)
    assert imu[0] == Imu(10.0, 10.0, approx((1.0, 0.0, -9.8)), approx((0.01, 0.02, 0.0)))
    assert imu[-1].t_boot_s == approx(10.495)
    assert attitude[1] == Attitude(10.01, 10.01, approx(math.radians(20.0), abs=1e-6), approx(0), approx(0))


def test_the_more_frequent_imu_is_taken_and_the_bias_removed(tmp_path):
    log = flight()
    log.topic("sensor_combined", "float[3] gyro_rad;float[3] accelerometer_m_s2")
    for i in range(200):
        log.add("sensor_combined", 10.0 + i * 0.0025, 0.1, 0.2, 0.3, 1.0, 2.0, -9.0)
    fields = "float[3] gyro_bias;float[3] accel_bias;bool gyro_bias_valid;bool accel_bias_valid"
    log.topic("estimator_sensor_bias", fields)
    log.add("estimator_sensor_bias", 10.2, 0.01, 0.02, 0.03, 0.5, 0.5, 0.5, True, False)
    log.add("estimator_sensor_bias", 10.3, 0.01, 0.02, 0.03, 0.5, 0.5, 0.5, True, True)
    imu = only(read(log, tmp_path), Imu)
    assert len(imu) == 200
    assert (imu[0].acc_frd_mps2, imu[0].gyro_frd_radps) == (approx((1, 2, -9)), approx((0.1, 0.2, 0.3)))
    assert (imu[100].acc_frd_mps2, imu[100].gyro_frd_radps) == (approx((1, 2, -9)), approx((0.09, 0.18, 0.27)))
    assert (imu[-1].acc_frd_mps2, imu[-1].gyro_frd_radps) == (approx((0.5, 1.5, -9.5)), approx((0.09, 0.18, 0.27)))


@pytest.mark.parametrize(
    ("topic", "fields"),
    [("vehicle_attitude_setpoint", "float[3] thrust_body"), ("vehicle_thrust_setpoint", "float[3] xyz")],
)
def test_throttle_is_the_thrust_upwards(tmp_path, topic, fields):
    log = flight()
    log.topic(topic, fields)
    log.add(topic, 10.1, 0.0, 0.0, -0.6)
    log.add(topic, 10.2, 0.0, 0.0, 0.001)
    log.add(topic, 10.3, 0.0, 0.0, math.nan)
    assert only(read(log, tmp_path), Throttle) == [Throttle(10.1, 10.1, approx(0.6)), Throttle(10.2, 10.2, 0.0)]


def test_motor_outputs_are_those_that_were_driven(tmp_path):
    log = flight()
    log.topic("actuator_outputs", "float[16] output")
    log.topic("actuator_outputs", "float[16] output", instance=1)
    log.add("actuator_outputs", 10.1, *([900.0] * 16))
    log.add("actuator_outputs", 10.2, 1100.0, 1200.0, 1300.0, 1400.0, *([900.0] * 12))
    log.add("actuator_outputs", 10.2, *([1500.0] * 16), instance=1)
    motors = only(read(log, tmp_path), Motors)
    assert motors[0] == Motors(10.1, 10.1, (0.0,) * 4)
    assert motors[1] == Motors(10.2, 10.2, approx((0.1, 0.2, 0.3, 0.4)))
    assert only(read(log, tmp_path, Thrust(motor_count=2)), Motors)[1].outputs == approx((0.1, 0.2))


def test_actuator_motors_stand_in(tmp_path):
    log = flight()
    log.topic("actuator_motors", "float[12] control")
    log.add("actuator_motors", 10.1, 0.5, 0.6, *([math.nan] * 10))
    log.add("actuator_motors", 10.2, 0.5, *([math.nan] * 11))
    motors = only(read(log, tmp_path), Motors)
    assert [m.outputs for m in motors] == [approx((0.5, 0.6)), approx((0.5, 0.0))]


def test_battery_position_and_states(tmp_path):
    log = flight()
    log.topic("battery_status", "float voltage_v")
    log.topic("battery_status", "float voltage_v", instance=1)
    log.add("battery_status", 10.1, 15.5)
    log.add("battery_status", 10.1, 7.0, instance=1)
    log.add("battery_status", 10.2, 0.0)
    log.topic("vehicle_local_position", "float x;float y;float z;float vx;float vy;float vz;bool v_xy_valid")
    log.add("vehicle_local_position", 10.1, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3, True)
    log.add("vehicle_local_position", 10.2, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3, False)
    log.topic("vehicle_status", "uint8_t arming_state;uint8_t nav_state")
    log.add("vehicle_status", 8.0, 2, 14)
    log.add("vehicle_status", 10.25, 1, 4)
    log.topic("vehicle_land_detected", "bool landed")
    log.add("vehicle_land_detected", 10.0, False)
    events = read(log, tmp_path)
    assert only(events, Battery) == [Battery(10.1, approx(15.5))]
    assert only(events, LocalPosition) == [
        LocalPosition(10.1, 10.1, approx((1.0, 2.0, -3.0)), approx((0.1, 0.2, 0.3))),
    ]
    # states are repeated every second, as a link does
    assert only(events, AutopilotState) == [
        AutopilotState(8.0, True, FlightMode.OFFBOARD),
        AutopilotState(9.0, True, FlightMode.OFFBOARD),
        AutopilotState(10.0, True, FlightMode.OFFBOARD),
        AutopilotState(10.25, False, FlightMode.OTHER),
    ]
    assert only(events, Landed) == [Landed(10.0, LandedState.IN_AIR)]


def test_what_is_not_finite_repeated_or_wild_is_left_out(tmp_path):
    log = flight()
    log.add("vehicle_attitude", 10.6, math.nan, 0.0, 0.0, 0.0)
    log.add("vehicle_attitude", 10.6, math.inf, math.inf, 0.0, 0.0)
    log.add("vehicle_attitude", 10.49, 1.0, 0.0, 0.0, 0.0)
    log.add("vehicle_attitude", 1e12, 1.0, 0.0, 0.0, 0.0)
    log.add("vehicle_imu", 10.7, 10_700_000, *([0.0] * 6), 0, 0)
    events = read(log, tmp_path)
    assert len(only(events, Attitude)) == 50
    assert len(only(events, Imu)) == 100


@pytest.mark.parametrize("options", [{"imu": False}, {"attitude": False}])
def test_a_log_without_imu_or_attitude_is_refused(tmp_path, options):
    with pytest.raises(LogFormatError, match="expected vehicle_attitude and one of vehicle_imu"):
        read(flight(**options), tmp_path)


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "x.ulg"
    with pytest.raises(LogFormatError, match="No such file"):
        read_ulog(path, Thrust())
    for content in (b"", b"t_boot_s,roll\n", bytes(1000)):
        path.write_bytes(content)
        with pytest.raises(LogFormatError, match=r"x\.ulg"):
            read_ulog(path, Thrust())
    with pytest.raises(ConfigurationError, match="motor_output_max"):
        read(flight(), tmp_path, Thrust(motor_output_min=2000.0))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 20_000), st.integers(0, 20_000), st.binary(max_size=20))
def test_a_damaged_or_truncated_log_is_read_or_refused(tmp_path_factory, end, at, noise):
    data = bytearray(flight().bytes()[:end])
    data[at : at + len(noise)] = noise
    path = tmp_path_factory.mktemp("ulog") / "x.ulg"
    path.write_bytes(data)
    try:
        events = list(read_ulog(path, Thrust()))
    except LogFormatError:
        return
    assert [e.t_mono_s for e in events] == sorted(e.t_mono_s for e in events)


def test_a_damaged_log_in_which_the_parser_runs_in_circles_is_refused(tmp_path):
    path = tmp_path / "x.ulg"
    path.write_bytes(flight().bytes()[:16] + b"\xff\x00\x00" * 10)
    with pytest.raises(LogFormatError, match="damaged at byte"):
        read_ulog(path, Thrust())
