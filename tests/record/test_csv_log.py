import gzip
import math

import numpy as np
import pytest

from swingd.model.errors import LogFormatError
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
from swingd.record.csv_log import REQUIRED, CsvFormat, read_csv_log

approx = pytest.approx
HEADER = ",".join(REQUIRED)


def log_of(tmp_path, text: str):
    path = tmp_path / "log.csv"
    path.write_text(text)
    return read_csv_log(path)


def only(events, kind) -> list:
    return [event for event in events if isinstance(event, kind)]


# ------------------------------------------------------------------------------------------------------ swingd's


def test_required_columns_alone(tmp_path):
    log = log_of(tmp_path, HEADER + "\n5.0,1,2,-9,0.1,0.2,0.3,0.01,0.02,0.03\n5.01,1,2,-9,0.1,0.2,0.3,0.01,0.02,0.03\n")
    assert log.format is CsvFormat.SWINGD
    assert log.truth is None
    assert log.events == [
        AutopilotState(5.0, True, FlightMode.OTHER),
        Landed(5.0, LandedState.IN_AIR),
        Attitude(5.0, 5.0, 0.01, 0.02, 0.03),
        Imu(5.0, 5.0, (1.0, 2.0, -9.0), (0.1, 0.2, 0.3)),
        Attitude(5.01, 5.01, 0.01, 0.02, 0.03),
        Imu(5.01, 5.01, (1.0, 2.0, -9.0), (0.1, 0.2, 0.3)),
    ]


def test_optional_columns_in_any_order_and_empty_cells(tmp_path):
    optional = "vd_mps,motor_2,throttle,motor_1,voltage_v,vn_mps,ve_mps,armed,landed,remark_1"
    imu = "1,2,-9,0.1,0.2,0.3"
    rows = [
        f"5.00,{imu},0,0,0,0.3,0.6,0.55,0.5,15.9,0.1,0.2,0,1,7",
        f"5.01,{imu},,,,,,,,,,,0,1,7",
        "5.02,,,,,,,0,0,0.1,,,1.2,,,,,0,1,7",
    ]
    log = log_of(tmp_path, "\n".join([f"{HEADER},{optional}", *rows]))
    assert only(log.events, Throttle) == [Throttle(5.0, 5.0, 0.55), Throttle(5.02, 5.02, 1.0)]
    assert only(log.events, Motors) == [Motors(5.0, 5.0, (0.5, 0.6))]
    assert only(log.events, Battery) == [Battery(5.0, 15.9)]
    assert only(log.events, LocalPosition) == [LocalPosition(5.0, 5.0, (0.0, 0.0, 0.0), (0.1, 0.2, 0.3))]
    assert [e.t_boot_s for e in only(log.events, Imu)] == [5.0, 5.01]
    assert [e.t_boot_s for e in only(log.events, Attitude)] == [5.0, 5.02]
    assert only(log.events, AutopilotState)[0].armed is False
    assert only(log.events, Landed)[0].state is LandedState.ON_GROUND
    assert log.skipped_rows == 0


def test_rows_that_go_back_in_time_are_skipped_and_counted(tmp_path):
    rows = [f"{t},1,2,-9,0.1,0.2,0.3,0,0,0" for t in (5.0, 5.02, 5.01, 5.02, "nan", 5.03)]
    log = log_of(tmp_path, "\n".join([HEADER, *rows]))
    assert [e.t_boot_s for e in only(log.events, Imu)] == [5.0, 5.02, 5.03]
    assert log.skipped_rows == 3


def test_a_packed_log_is_read(tmp_path):
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(f"{HEADER}\n5,1,2,-9,0,0,0,0,0,0\n".encode()))
    assert len(only(read_csv_log(path).events, Imu)) == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "expected a header with t_boot_s"),
        ("time,roll\n1,2\n", "line 1: 'time,roll'; expected a header"),
        ("t_boot_s,roll_rad\n1,2\n", "line 1: no column acc_x_frd_mps2"),
        (HEADER + "\n", "no rows"),
        (HEADER + "\n1,2,3\n", "line 2: 3 cells; expected 10"),
        (HEADER + "\n1,2,3,4,5,6,7,8,9,high\n", "line 2, column 10: 'high'; expected a number"),
        (",".join(["0.5"] * 24) + "\n" + ",".join(["0.5"] * 23), "line 2: 23 cells; expected 24"),
        (",".join(["0.5"] * 24) + "\n", "1 usable rows; expected at least 21"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, text, expected):
    with pytest.raises(LogFormatError) as error:
        log_of(tmp_path, text)
    assert str(tmp_path / "log.csv") in str(error.value)
    assert expected in str(error.value)


# ----------------------------------------------------------------------------------------------- the Gazebo set

GAZEBO = (
    "timestamp,imu_ax,imu_ay,imu_az,imu_wx,imu_wy,imu_wz,drone_px,drone_py,drone_pz,drone_vx,drone_vy,drone_vz,"
    "drone_qw,drone_qx,drone_qy,drone_qz,cmd_thrust,gt_xi,gt_zeta,gt_xi_dot,gt_zeta_dot,gt_load_px,gt_load_py,gt_load_pz"
)


def gazebo_row(t_s: float, quaternion: str, xi: float, zeta: float) -> str:
    return f"{t_s},1,2,9.8,0.1,0.2,0.3,10,20,30,1,2,3,{quaternion},0.5,{xi},{zeta},0,0,0,0,0"


def test_gazebo_axes_heading_north(tmp_path):
    half = math.sqrt(0.5)
    north = f"{half},0,0,{half}"  # turned left by 90 degrees from ENU's x axis, which is east
    rows = [gazebo_row(1.00 + i * 0.02, north, 0.1 * i, 0.2) for i in range(3)]
    log = log_of(tmp_path, "\n".join([GAZEBO, *rows]))
    assert log.format is CsvFormat.GAZEBO_SITL
    (imu, *_), (attitude,), (position,) = (only(log.events, kind) for kind in (Imu, Attitude, LocalPosition))
    assert (imu.acc_frd_mps2, imu.gyro_frd_radps) == (approx((1, -2, -9.8)), approx((0.1, -0.2, -0.3)))
    assert (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) == approx((0, 0, 0), abs=1e-9)
    assert (position.pos_ned_m, position.vel_ned_mps) == ((20.0, 10.0, -30.0), (2.0, 1.0, -3.0))
    assert len(only(log.events, Throttle)) == 3
    assert log.truth is not None
    assert log.truth.xi_rad == approx([0.0, -0.1, -0.2])  # a load to the east is to the right
    assert log.truth.zeta_rad[0] == approx(0.2)  # a load to the north is ahead


def test_gazebo_axes_heading_east_and_nose_up(tmp_path):
    half = math.radians(-10.0) / 2  # about the left axis: nose up
    up = f"{math.cos(half)},0,{math.sin(half)},0"
    rows = [gazebo_row(1.0 + i * 0.02, up, 0.2, 0.0) for i in range(2)]
    log = log_of(tmp_path, "\n".join([GAZEBO, *rows]))
    (attitude,) = only(log.events, Attitude)
    assert (attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) == approx(
        (0.0, math.radians(10.0), math.radians(90.0)), abs=1e-9
    )
    assert log.truth is not None
    assert (log.truth.xi_rad[0], log.truth.zeta_rad[0]) == approx((0.0, 0.2), abs=1e-9)


def test_gazebo_rows_with_missing_values_are_skipped(tmp_path):
    rows = [gazebo_row(1.0 + i * 0.02, "1,0,0,0" if i != 1 else "1,0,0,nan", 0.2, 0.0) for i in range(4)]
    log = log_of(tmp_path, "\n".join([GAZEBO, *rows]))
    assert log.skipped_rows == 1
    assert len(only(log.events, Imu)) == 3


@pytest.mark.data
def test_gazebo_flight(flight_data):
    log = read_csv_log(flight_data("gazebo_sitl/slung_load_dataset_small.csv"))
    imu = only(log.events, Imu)
    assert (log.format, log.skipped_rows, len(imu)) == (CsvFormat.GAZEBO_SITL, 0, 3987)
    assert imu[-1].t_boot_s - imu[0].t_boot_s == approx(79.72)
    assert [e.t_mono_s for e in log.events] == sorted(e.t_mono_s for e in log.events)
    assert log.truth is not None
    assert np.isfinite(log.truth.xi_rate_radps).all()
    assert_the_truth_is_the_swing_of_this_imu(log, 2.0)


# ------------------------------------------------------------------------------------------ the OptiTrack flights


def optitrack(n: int, yaw: float = 0.0, jump_at: int | None = None, seed: int = 0) -> str:
    """A vehicle that swings forth and back to the east with its load 0.3 m south of the hook and 3 m below."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / 28.7
    east = 2.0 * np.sin(1.0 * t)
    if jump_at is not None:
        east[jump_at:] += 1.5
    pos = np.column_stack([east, np.zeros(n), np.full(n, 2.0)]) + rng.normal(0.0, 1e-4, (n, 3))
    load = pos + np.array([0.0, -0.3, -3.0])
    half = yaw / 2
    rows = np.zeros((n, 24))
    rows[:, 0:3], rows[:, 14:17] = pos, load
    rows[:, 3:7] = [0.0, 0.0, math.sin(half), math.cos(half)]
    return "\n".join(",".join(f"{x:.6f}" for x in row) for row in rows)


def test_optitrack_accelerations_are_those_of_the_path(tmp_path):
    log = log_of(tmp_path, optitrack(300))
    imu = only(log.events, Imu)
    assert (log.format, len(imu)) == (CsvFormat.OPTITRACK_FLIGHTS, 280)
    assert not only(log.events, Throttle)
    t = np.array([e.t_boot_s for e in imu])
    assert t[0] == approx(10 / 28.7)
    acc = np.array([e.acc_frd_mps2 for e in imu])
    assert acc[:, 0] == approx(-2.0 * np.sin(t), abs=0.05)  # the nose points east
    assert acc[:, 1:] == approx(np.tile([0.0, -9.82], (len(t), 1)), abs=0.05)
    velocity = np.array([e.vel_ned_mps for e in only(log.events, LocalPosition)])
    assert velocity[:, 1] == approx(2.0 * np.cos(t), abs=0.02)
    assert log.truth is not None
    assert log.truth.xi_rad == approx(-math.atan2(0.3, 3.0), abs=1e-4)  # south is to the right of east
    assert log.truth.valid.sum() == 280


def test_optitrack_turning_vehicle_has_rates(tmp_path):
    rows = optitrack(60).splitlines()
    for i, row in enumerate(rows):
        cells = row.split(",")
        half = 0.5 * i / 28.7 / 2  # turns left at 0.5 rad/s: negative about the down axis
        cells[3:7] = ["0", "0", f"{math.sin(half):.9f}", f"{math.cos(half):.9f}"]
        rows[i] = ",".join(cells)
    log = log_of(tmp_path, "\n".join(rows))
    assert np.array([e.gyro_frd_radps for e in only(log.events, Imu)]) == approx(
        np.tile([0.0, 0.0, -0.5], (40, 1)), abs=1e-4
    )


def test_optitrack_gap_makes_no_acceleration_and_a_hole_in_time(tmp_path):
    log = log_of(tmp_path, optitrack(300, jump_at=150))
    imu = only(log.events, Imu)
    assert len(imu) == 300 - 4 * 10
    assert max(abs(e.acc_frd_mps2[0]) for e in imu) < 2.1
    steps = np.diff([e.t_boot_s for e in imu])
    assert np.sum(steps > 1.0) == 1
    assert log.truth is not None
    assert log.truth.valid.sum() == len(imu)


def test_optitrack_rows_with_missing_values_are_skipped(tmp_path):
    rows = optitrack(60).splitlines()
    rows[30] = ",".join(["nan"] * 24)
    rows[31] = ",".join(["0"] * 24)  # no quaternion
    log = log_of(tmp_path, "\n".join(rows))
    assert log.skipped_rows == 2
    assert all(math.isfinite(x) for e in only(log.events, Imu) for x in e.acc_frd_mps2 + e.gyro_frd_radps)


@pytest.mark.data
@pytest.mark.parametrize(("name", "rows", "std_deg"), [("dataset_17", 7940, 9.5), ("dataset_19", 6934, 9.9)])
def test_optitrack_flights(flight_data, name, rows, std_deg):
    log = read_csv_log(flight_data(f"optitrack_flights/{name}.csv"))
    assert log.truth is not None
    assert len(log.truth.t_boot_s) == rows
    assert log.skipped_rows == 0
    angles = np.degrees(np.hypot(log.truth.xi_rad, log.truth.zeta_rad))
    assert angles.max() < 33.0
    assert np.degrees(max(log.truth.xi_rad.std(), log.truth.zeta_rad.std())) == approx(std_deg, abs=0.4)
    acc = np.array([e.acc_frd_mps2 for e in only(log.events, Imu)])
    assert np.isfinite(acc).all()
    assert acc[:, 2].mean() == approx(-9.82, abs=0.1)
    assert_the_truth_is_the_swing_of_this_imu(log, 3.158)


def assert_the_truth_is_the_swing_of_this_imu(log, length_m: float) -> None:
    """The pendulum of the heading frame, small angles: zeta'' + g/L zeta = -a_forward/L, xi'' + g/L xi = a_right/L."""
    truth = log.truth
    attitudes = {e.t_boot_s: e for e in only(log.events, Attitude)}
    at, level = [], []
    attitude = None
    for e in only(log.events, Imu):
        attitude = attitudes.get(e.t_boot_s, attitude)
        (sr, cr), (sp, cp) = [(math.sin(a), math.cos(a)) for a in (attitude.roll_rad, attitude.pitch_rad)]
        ax, ay, az = e.acc_frd_mps2
        at.append(int(np.searchsorted(truth.t_boot_s, e.t_boot_s - 1e-9)))
        level.append((cp * ax + sp * (sr * ay + cr * az), cr * ay - sr * az))
    t_s = truth.t_boot_s[at]

    def smooth(x):
        for _ in range(3):
            x = np.convolve(x, np.ones(11) / 11, "same")
        return x

    for angle, acc in ((truth.zeta_rad[at], -np.array(level)[:, 0]), (truth.xi_rad[at], np.array(level)[:, 1])):
        if np.degrees(angle.std()) < 4.0:
            continue
        angle = smooth(np.sin(angle))
        left = np.gradient(np.gradient(angle, t_s), t_s) + 9.81 / length_m * angle
        right = smooth(acc) / length_m
        inner = slice(40, -40)
        assert np.corrcoef(left[inner], right[inner])[0, 1] > 0.8
        assert np.polyfit(right[inner], left[inner], 1)[0] == approx(1.0, abs=0.25)
