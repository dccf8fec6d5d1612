"""The filter on flights of a real PX4 with an independent simulation of load and cable (dev_1 to dev_3).

Position and velocity are PX4's as a companion received them; thrust and attitude are the flight's own, whose thrust
curve is known exactly; the pictures are simulated: 15 Hz, 80 ms late, 3 cm + 2 % of the cable, dropouts.
"""

import csv
import gzip
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from swingd.estimation.gp_ekf import GpEkf, GpEkfSettings, LoadMeasurement, Source
from swingd.record.tlog import TlogReader

FlightData = Callable[[str], Path]
MASS = 1.5
LOCAL_POSITION_NED = 32


@dataclass(frozen=True)
class Recorded:
    t_s: np.ndarray
    force: np.ndarray
    rel_pos: np.ndarray
    rel_vel: np.ndarray
    told: list[tuple[float, tuple[float, ...], tuple[float, ...]]]
    """PX4's time, position, velocity."""


def load(flight_data: FlightData, name: str, begin_s: float, end_s: float) -> Recorded:
    with gzip.open(flight_data(f"px4_sitl/{name}_truth.csv.gz"), "rt") as file:
        rows = csv.reader(file)
        header = next(rows)
        table = np.array([[float(cell) for cell in row] for row in rows])

    def columns(*names: str) -> np.ndarray:
        return table[:, [header.index(name) for name in names]]

    t_s = columns("t_boot_s")[:, 0]
    qw, qx, qy, qz = columns("qw", "qx", "qy", "qz").T
    down = np.column_stack([2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), 1 - 2 * (qx * qx + qy * qy)])
    force = -columns("thrust_n") * down
    rel_pos = columns("veh_n_m", "veh_e_m", "veh_d_m") - columns("load_n_m", "load_e_m", "load_d_m")
    rel_vel = columns("veh_vn_m_s", "veh_ve_m_s", "veh_vd_m_s") - columns("load_vn_m_s", "load_ve_m_s", "load_vd_m_s")
    chosen = (t_s > begin_s) & (t_s < end_s)
    mavlink, told = common.MAVLink(None), []
    for _, frame in TlogReader(flight_data(f"px4_sitl/{name}.tlog")):
        if frame[0] == 0xFD and int.from_bytes(frame[7:10], "little") == LOCAL_POSITION_NED:
            m = mavlink.decode(bytearray(frame))
            told.append((1e-3 * m.time_boot_ms, (m.x, m.y, m.z), (m.vx, m.vy, m.vz)))
    told = [one for one in told if t_s[chosen][0] < one[0] < t_s[chosen][-1]][::2]
    return Recorded(t_s[chosen], force[chosen], rel_pos[chosen], rel_vel[chosen], told)


def pictures(recorded: Recorded, length: float, std: float) -> list[tuple[float, np.ndarray]]:
    """Time and value of every picture that is taken; every fifth half second there is none."""
    rng = np.random.default_rng(1)
    taken = []
    for t_s in np.arange(recorded.t_s[0], recorded.t_s[-1], 1.0 / 15.0):
        row = np.searchsorted(recorded.t_s, t_s)
        noise = std * rng.standard_normal(3)
        if int(t_s / 0.5) % 10 != 3:
            taken.append((float(recorded.t_s[row]), recorded.rel_pos[row] + noise))
    return taken


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "begin_s", "end_s", "payload_kg", "length_m"),
    [("dev_1", 17.8, 104.0, 0.3, 1.5), ("dev_2", 17.9, 115.0, 0.3, 1.5), ("dev_3", 18.5, 95.0, 0.5, 3.0)],
)
def test_load_is_known_within_its_bounds_and_far_better_than_by_camera(
    flight_data, name, begin_s, end_s, payload_kg, length_m
):
    recorded = load(flight_data, name, begin_s, end_s)
    std = 0.03 + 0.02 * length_m
    ekf = GpEkf(GpEkfSettings(MASS, payload_kg, length_m, load_force_noise_n=0.04))
    arrivals = [(t_s + 0.02, 0, (t_s, pos, vel)) for t_s, pos, vel in recorded.told]
    arrivals += [(t_s + 0.08, 1, (t_s, tuple(value))) for t_s, value in pictures(recorded, length_m, std)]
    arrivals.sort(key=lambda arrival: arrival[:2], reverse=True)
    held, rows = np.full(2, np.nan), []
    for t_s, force, rel_pos, rel_vel in zip(
        recorded.t_s, recorded.force, recorded.rel_pos, recorded.rel_vel, strict=True
    ):
        if ekf.started:
            ekf.step(force, t_s)
        while arrivals and arrivals[-1][0] <= t_s:
            _, picture, values = arrivals.pop()
            if picture:
                ekf.correct(LoadMeasurement(Source.REL_POS, values[1], (std,) * 3, values[0]))
                held = np.array(values[1][:2])
            else:
                ekf.correct(LoadMeasurement(Source.VEHICLE_POS, values[1], (0.1,) * 3, values[0]))
                ekf.correct(LoadMeasurement(Source.VEHICLE_VEL, values[2], (0.1,) * 3, values[0]))
        estimate = ekf.estimate()
        error = np.concatenate([estimate.x[3:5] - rel_pos[:2], estimate.x[8:10] - rel_vel[:2]])
        P = estimate.P[np.ix_([3, 4, 8, 9], [3, 4, 8, 9])]
        rows.append([*error, error @ np.linalg.solve(P, error), *np.sqrt(np.diag(P)), *(held - rel_pos[:2])])
    settled = np.array(rows)[300:]
    rmse = np.sqrt(np.mean(np.sum(settled[:, :2] ** 2, axis=1)))
    camera_rmse = np.sqrt(np.mean(np.sum(settled[:, 9:] ** 2, axis=1)))
    assert rmse < 0.05
    assert rmse < 0.3 * camera_rmse
    assert np.mean(np.abs(settled[:, :2]) < 3.0 * settled[:, 5:7]) > 0.995
    assert 1.0 < np.mean(settled[:, 4]) < 4.0
    assert sum(ekf.resets.values()) == 1  # the start
    # It swings, so that there was something to know.
    assert np.sqrt(np.mean(recorded.rel_pos[:, :2] ** 2)) > 0.1
