"""What the simulated autopilot knows of itself: IMU, estimates with slow errors, battery."""

from collections import deque
from dataclasses import dataclass
from math import sqrt

import numpy as np

from swingd.core.slung_plant import PlantOutput, PlantState
from swingd.model.events import Vec3
from swingd.model.parameters import Simulation
from swingd.sim.plant import DT_S, Quaternion
from swingd.sim.vibration import Vibration

_BIAS_TIME_S = 60.0
_BIAS_LEARNING_S = 20.0  # PX4's EKF follows an accelerometer bias this slowly, and the rest stays in HIGHRES_IMU
_ATTITUDE_TIME_S = 10.0
_GNSS_TIME_S = 2.0
_GNSS_SMOOTHING_S = 0.3  # the autopilot's estimate is carried by its IMU and never jumps
_IMU_DELAY_STEPS = 1
_ESTIMATE_DELAY_STEPS = 2
_BLOCK = 4096


@dataclass(slots=True)
class Sensed:
    """One sample of everything; vectors in the frames that their names give."""

    gyro_frd_radps: Vec3 = (0.0, 0.0, 0.0)
    """Newest body rates, for the rate loop."""
    imu_acc_frd_mps2: Vec3 = (0.0, 0.0, 0.0)
    """Specific force as published: delayed, with noise, the autopilot's own bias estimate removed."""
    imu_gyro_frd_radps: Vec3 = (0.0, 0.0, 0.0)
    """Body rates of the same instant."""
    ned_from_frd: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Estimated attitude."""
    rates_frd_radps: Vec3 = (0.0, 0.0, 0.0)
    """Body rates of the same instant as the estimated attitude."""
    pos_ned_m: Vec3 = (0.0, 0.0, 0.0)
    """Estimated position."""
    vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    """Estimated velocity."""
    acc_up_mps2: float = 0.0
    """Measured upward acceleration, gravity removed."""


class Battery:
    """A pack whose voltage falls in proportion to the time spent armed."""

    def __init__(self, simulation: Simulation) -> None:
        self._full_v = simulation.battery_full_v
        self._empty_v = simulation.battery_empty_v
        self._drain_s = simulation.battery_drain_s
        self._armed_s = 0.0
        self.sag = 0.0
        """Share of the voltage that the pack lacks and does not report, 0..1."""
        self.claimed_v: float | None = None
        """What is reported instead of the voltage [V]; None: the voltage, sag apart."""

    def step(self, dt_s: float, *, armed: bool) -> None:
        """Drain for ``dt_s`` if armed."""
        if armed:
            self._armed_s += dt_s

    @property
    def remaining(self) -> float:
        """Charge left, 0..1."""
        return max(0.0, 1.0 - self._armed_s / self._drain_s)

    @property
    def voltage_v(self) -> float:
        """Voltage of the pack [V]."""
        return (1.0 - self.sag) * self._loaded_v

    @property
    def reported_v(self) -> float:
        """Voltage that the autopilot reports [V]."""
        return self._loaded_v if self.claimed_v is None else self.claimed_v

    @property
    def _loaded_v(self) -> float:
        return self._empty_v + self.remaining * (self._full_v - self._empty_v)


class Sensors:
    """Turn the plant's truth into what the autopilot measures and estimates.

    Parameters
    ----------
    simulation : Simulation
        Noise figures, vibration and seed.

    Notes
    -----
    PX4's data are older than their stamps: the IMU's show the state 6 ms before, the attitude's and the position's
    8 ms. The rate loop alone sees the newest gyro sample.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._normal = _Normals(np.random.default_rng((simulation.seed, 2)))
        self.vibration = Vibration(simulation)
        """Of the rotors."""
        self._steps = 0
        self._bias = [simulation.acc_bias_mps2 * self._normal() for _ in range(3)]
        self._bias_learnt = list(self._bias)
        self._tilt = [simulation.attitude_noise_rad * self._normal() for _ in range(3)]
        self._vel_raw = [0.0, 0.0, 0.0]
        self._vel_error = [0.0, 0.0, 0.0]
        self._pos_raw = [0.0, 0.0, 0.0]
        self._pos_error = [0.0, 0.0, 0.0]
        self._imu_queue: deque[tuple[Vec3, Vec3]] = deque(maxlen=_IMU_DELAY_STEPS + 1)
        self._estimate_queue: deque[tuple[Quaternion, Vec3, Vec3, Vec3, float]] = deque(
            maxlen=_ESTIMATE_DELAY_STEPS + 1
        )
        self.sensed = Sensed()

    def step(self, state: list[float], output: list[float]) -> Sensed:
        """Measure the plant after one step of `DT_S`; the same object is returned each time."""
        simulation, normal = self._simulation, self._normal
        acc_std, gyro_std = simulation.acc_noise_mps2, simulation.gyro_noise_radps
        y, bias, learnt = PlantOutput.SPECIFIC_FORCE, self._bias, self._bias_learnt
        decay, drive = DT_S / _BIAS_TIME_S, simulation.acc_bias_mps2 * sqrt(2.0 * DT_S / _BIAS_TIME_S)
        if drive > 0.0:
            for i in range(3):
                bias[i] += -decay * bias[i] + drive * normal()
                learnt[i] += DT_S / _BIAS_LEARNING_S * (bias[i] - learnt[i])
        shaken = self.vibration.sample(self._steps * DT_S, state[PlantState.ROTOR : PlantState.ROTOR + 4])
        self._steps += 1
        acc = (
            output[y] + bias[0] - learnt[0] + shaken[0] + acc_std * normal(),
            output[y + 1] + bias[1] - learnt[1] + shaken[1] + acc_std * normal(),
            output[y + 2] + bias[2] - learnt[2] + shaken[2] + acc_std * normal(),
        )
        w = PlantOutput.MEAN_RATE
        gyro = (
            output[w] + gyro_std * normal(),
            output[w + 1] + gyro_std * normal(),
            output[w + 2] + gyro_std * normal(),
        )
        self._imu_queue.append((acc, gyro))
        self._drift()
        self._estimate_queue.append(
            (
                self._attitude(state),
                gyro,
                (
                    state[0] + self._pos_error[0],
                    state[1] + self._pos_error[1],
                    state[2] + self._pos_error[2],
                ),
                (
                    state[3] + self._vel_error[0],
                    state[4] + self._vel_error[1],
                    state[5] + self._vel_error[2],
                ),
                -output[PlantOutput.ACC + 2],
            )
        )
        sensed = self.sensed
        sensed.gyro_frd_radps = gyro
        sensed.imu_acc_frd_mps2, sensed.imu_gyro_frd_radps = self._imu_queue[0]
        (
            sensed.ned_from_frd,
            sensed.rates_frd_radps,
            sensed.pos_ned_m,
            sensed.vel_ned_mps,
            sensed.acc_up_mps2,
        ) = self._estimate_queue[0]
        return sensed

    def _drift(self) -> None:
        """Advance the slow errors of the autopilot's estimates."""
        simulation, normal = self._simulation, self._normal
        tilt = self._tilt
        if simulation.attitude_noise_rad > 0.0:
            drive = simulation.attitude_noise_rad * sqrt(2.0 * DT_S / _ATTITUDE_TIME_S)
            for i in range(3):
                tilt[i] += -DT_S / _ATTITUDE_TIME_S * tilt[i] + drive * normal()
        # A Gauss-Markov process smoothed once more loses variance tau / (tau + smoothing): make up for it.
        gain = sqrt(2.0 * DT_S / _GNSS_TIME_S * (_GNSS_TIME_S + _GNSS_SMOOTHING_S) / _GNSS_TIME_S)
        decay, smooth = DT_S / _GNSS_TIME_S, DT_S / _GNSS_SMOOTHING_S
        if simulation.gnss_vel_noise_mps > 0.0:
            drive = simulation.gnss_vel_noise_mps * gain
            for i in range(3):
                self._vel_raw[i] += -decay * self._vel_raw[i] + drive * normal()
                self._vel_error[i] += smooth * (self._vel_raw[i] - self._vel_error[i])
        if simulation.gnss_pos_noise_m > 0.0:
            drive = simulation.gnss_pos_noise_m * gain
            for i in range(3):
                self._pos_raw[i] += -decay * self._pos_raw[i] + drive * normal()
                self._pos_error[i] += smooth * (self._pos_raw[i] - self._pos_error[i])

    def _attitude(self, state: list[float]) -> Quaternion:
        """Turn the true attitude by the small error, about the axes of ned."""
        q = PlantState.QUAT
        w, x, y, z = state[q], state[q + 1], state[q + 2], state[q + 3]
        a, b, c = 0.5 * self._tilt[0], 0.5 * self._tilt[1], 0.5 * self._tilt[2]
        ow = w - a * x - b * y - c * z
        ox = x + a * w + b * z - c * y
        oy = y + b * w + c * x - a * z
        oz = z + c * w + a * y - b * x
        n = 1.0 / sqrt(ow * ow + ox * ox + oy * oy + oz * oz)
        return (ow * n, ox * n, oy * n, oz * n)


class _Normals:
    """Gives standard normal numbers one by one; drawn in blocks, because a single draw costs fifty times as much.

    An object, so that the copy of a vehicle draws on its own.
    """

    __slots__ = ("_block", "_generator")

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator
        self._block: list[float] = []

    def __call__(self) -> float:
        if not self._block:
            self._block = self._generator.standard_normal(_BLOCK).tolist()
        return self._block.pop()
