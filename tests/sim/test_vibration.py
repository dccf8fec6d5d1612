"""What the rotors do to the accelerometer."""

import numpy as np
import pytest

from swingd.model.parameters import Simulation
from swingd.sim.plant import DT_S, Plant
from swingd.sim.sensors import Sensors
from swingd.sim.vibration import Vibration

from .rigs import QUIET, iris, steps

HALF = (0.5, 0.5, 0.5, 0.5)


def shaken(
    throttle: tuple[float, ...], *, dt_s: float = DT_S, duration_s: float = 40.0, **simulation: float
) -> np.ndarray:
    vibration = Vibration(Simulation(**{"vibration_mps2": 3.0, **simulation}))
    return np.array([vibration.sample(i * dt_s, throttle) for i in range(round(duration_s / dt_s))])


def peak_hz(rows: np.ndarray, dt_s: float = DT_S) -> float:
    power = np.abs(np.fft.rfft(rows * np.hanning(len(rows)))) ** 2
    frequencies = np.fft.rfftfreq(len(rows), dt_s)
    return float((power * frequencies).sum() / power.sum())


def test_at_half_throttle_each_axis_has_the_configured_amplitude_and_frequency() -> None:
    rows = shaken(HALF, vibration_hz=80.0)
    assert np.sqrt(2.0) * rows.std(axis=0) == pytest.approx([3.0] * 3, rel=0.15)
    assert rows.mean(axis=0) == pytest.approx([0.0] * 3, abs=0.02)
    for axis in range(3):
        assert peak_hz(rows[:, axis]) == pytest.approx(80.0, rel=0.02)


def test_rotors_that_are_not_quite_alike_beat() -> None:
    """From one fifth of a second to another the amplitude swells and fades."""
    rows = shaken(HALF)[:, 0]
    amplitude = rows.reshape(-1, 50).std(axis=1) * np.sqrt(2.0)
    assert amplitude.max() > 1.5 * 3.0
    assert amplitude.min() < 0.5 * 3.0


def test_force_rises_with_the_square_of_the_throttle_and_frequency_with_it() -> None:
    low, high = shaken((0.4,) * 4, vibration_hz=60.0), shaken((0.8,) * 4, vibration_hz=60.0)
    assert high.std(axis=0) / low.std(axis=0) == pytest.approx([4.0] * 3, rel=0.05)
    assert peak_hz(high[:, 2]) == pytest.approx(2.0 * peak_hz(low[:, 2]), rel=0.01)


def test_one_rotor_turns_the_force_in_its_own_sense() -> None:
    """Rotor 0 turns counter-clockwise seen from above: from right to forward; rotor 2 the other way."""
    for throttle, sense in (((0.5, 0.0, 0.0, 0.0), 1.0), ((0.0, 0.0, 0.5, 0.0), -1.0)):
        rows = shaken(throttle, dt_s=1e-4, duration_s=0.1)
        forward, right = rows[:, 0], rows[:, 1]
        turned = forward[:-1] * right[1:] - right[:-1] * forward[1:]
        assert (sense * turned < 0.0).all()


def test_what_is_faster_than_half_of_the_sampling_rate_shows_itself_folded() -> None:
    assert peak_hz(shaken(HALF, vibration_hz=170.0, dt_s=0.001)[:, 0], 0.001) == pytest.approx(170.0, rel=0.02)
    assert peak_hz(shaken(HALF, vibration_hz=170.0)[:, 0]) == pytest.approx(80.0, abs=3.0)


def test_rotors_at_rest_and_rotors_without_imbalance_are_silent() -> None:
    assert not shaken((0.0,) * 4, duration_s=0.1).any()
    assert not shaken(HALF, duration_s=0.1, vibration_mps2=0.0).any()


def test_the_seed_decides_how_the_rotors_differ() -> None:
    first = shaken(HALF, duration_s=1.0, seed=1)
    assert np.array_equal(first, shaken(HALF, duration_s=1.0, seed=1))
    assert not np.array_equal(first, shaken(HALF, duration_s=1.0, seed=2))


def test_the_autopilot_s_accelerometer_feels_it_and_nothing_else_does() -> None:
    def fly(vibration_mps2: float) -> list[tuple[object, ...]]:
        parameters = iris(vibration_mps2=vibration_mps2, **{**QUIET, "acc_noise_mps2": 0.1, "gyro_noise_radps": 0.01})
        plant, sensors = Plant(parameters), Sensors(parameters.simulation)
        plant.place((0.0, 0.0, -50.0), rotors=0.5)
        rows = []
        for _ in range(steps(4.0)):
            plant.step(HALF, 16.2, spinning=True)
            sensed = sensors.step(plant.state, plant.output)
            rows.append((sensed.imu_acc_frd_mps2, (sensed.gyro_frd_radps, sensed.pos_ned_m, sensed.vel_ned_mps)))
        return rows

    still, shaking = fly(0.0), fly(2.0)
    assert [row[1] for row in still] == [row[1] for row in shaking]
    felt = np.array([row[0] for row in shaking]) - np.array([row[0] for row in still])
    assert np.sqrt(2.0) * felt.std(axis=0) == pytest.approx([2.0] * 3, rel=0.25)
