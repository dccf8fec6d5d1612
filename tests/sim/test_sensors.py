"""The sensors' errors have the size that the configuration says."""

from dataclasses import replace

import numpy as np
import pytest

from swingd.core.slung_plant import GRAVITY
from swingd.model.parameters import Simulation
from swingd.sim.plant import DT_S, Plant
from swingd.sim.sensors import Battery, Sensors
from swingd.sim.telemetry import euler_rad

from .rigs import QUIET, iris, steps, with_vehicle

NOISY = Simulation(
    acc_noise_mps2=0.2,
    gyro_noise_radps=0.02,
    acc_bias_mps2=0.0,
    attitude_noise_rad=0.004,
    gnss_vel_noise_mps=0.07,
    gnss_pos_noise_m=0.3,
)


def at_rest(simulation: Simulation, duration_s: float) -> dict[str, np.ndarray]:
    plant, sensors = Plant(iris()), Sensors(simulation)
    rows: dict[str, list[tuple[float, ...]]] = {"acc": [], "gyro": [], "euler": [], "vel": [], "pos": []}
    for _ in range(steps(duration_s)):
        sensed = sensors.step(plant.state, plant.output)
        rows["acc"].append(sensed.imu_acc_frd_mps2)
        rows["gyro"].append(sensed.gyro_frd_radps)
        rows["euler"].append(euler_rad(sensed.ned_from_frd))
        rows["vel"].append(sensed.vel_ned_mps)
        rows["pos"].append(sensed.pos_ned_m)
    return {name: np.array(values) for name, values in rows.items()}


def test_errors_have_the_configured_deviation() -> None:
    rows = at_rest(NOISY, 600.0)
    assert rows["acc"].std(axis=0) == pytest.approx([0.2] * 3, rel=0.02)
    assert rows["acc"].mean(axis=0) == pytest.approx([0.0, 0.0, -GRAVITY], abs=0.01)
    assert rows["gyro"].std(axis=0) == pytest.approx([0.02] * 3, rel=0.02)
    # 60 and 300 correlation times: the deviation of the deviation is 10 % and 5 %.
    assert np.sqrt((rows["euler"] ** 2).mean()) == pytest.approx(0.004, rel=0.2)
    assert np.sqrt((rows["vel"] ** 2).mean()) == pytest.approx(0.07, rel=0.15)
    assert np.sqrt(((rows["pos"] - rows["pos"].mean(axis=0)) ** 2).mean()) == pytest.approx(0.3, rel=0.15)


def test_white_noise_is_white_and_slow_errors_are_slow() -> None:
    rows = at_rest(NOISY, 60.0)
    acc = rows["acc"][:, 0] - rows["acc"][:, 0].mean()
    assert abs(np.corrcoef(acc[1:], acc[:-1])[0, 1]) < 0.05
    # The estimates are carried by the IMU and never jump.
    assert np.abs(np.diff(rows["vel"], axis=0)).max() < 0.005
    assert np.abs(np.diff(rows["euler"], axis=0)).max() < 0.001


def test_a_bias_stays_within_what_the_autopilot_leaves_of_it() -> None:
    quiet = replace(NOISY, acc_noise_mps2=0.0, acc_bias_mps2=0.05)
    acc = at_rest(quiet, 300.0)["acc"][:, 0]
    assert 0.005 < acc.std() < 0.05
    assert abs(acc[0]) < 1e-3  # what was there at boot is known


def test_without_noise_the_sensors_tell_the_truth_late() -> None:
    simulation = Simulation(**QUIET)
    plant, sensors = Plant(with_vehicle(iris(), imu_frd_m=(0.0, 0.1, 0.0))), Sensors(simulation)
    plant.place((0.0, 0.0, -100.0), rotors=0.5)
    truths = []
    for _ in range(50):
        plant.step((0.5, 0.52, 0.52, 0.5), 16.2, spinning=True)
        truths.append(plant.truth())
        sensed = sensors.step(plant.state, plant.output)
    assert sensed.imu_acc_frd_mps2 == pytest.approx(truths[-2].specific_force_frd_mps2, abs=1e-12)
    assert sensed.ned_from_frd == pytest.approx(truths[-3].ned_from_frd, abs=1e-12)
    assert sensed.vel_ned_mps == pytest.approx(truths[-3].vel_ned_mps, abs=1e-12)
    assert sensed.gyro_frd_radps == pytest.approx(truths[-1].rates_frd_radps, abs=0.02)


def test_the_seed_decides_the_noise() -> None:
    a = at_rest(replace(NOISY, seed=1), 0.5)["acc"]
    assert np.array_equal(a, at_rest(replace(NOISY, seed=1), 0.5)["acc"])
    assert not np.array_equal(a, at_rest(replace(NOISY, seed=2), 0.5)["acc"])


def test_the_battery_sags_only_while_armed_and_not_below_empty() -> None:
    battery = Battery(Simulation(battery_full_v=16.2, battery_empty_v=14.0, battery_drain_s=100.0))
    battery.step(50.0, armed=False)
    assert battery.voltage_v == 16.2
    for _ in range(round(50.0 / DT_S)):
        battery.step(DT_S, armed=True)
    assert battery.voltage_v == pytest.approx(15.1, abs=1e-6)
    assert battery.remaining == pytest.approx(0.5)
    battery.step(500.0, armed=True)
    assert (battery.voltage_v, battery.remaining) == (14.0, 0.0)
