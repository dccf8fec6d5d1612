"""What the sensors on the airframe measure, before any autopilot has looked at it."""

from collections import deque
from dataclasses import dataclass
from math import sqrt

import numpy as np

from swingd.core.slung_plant import PlantOutput, PlantState
from swingd.model.events import Vec3
from swingd.model.parameters import Simulation
from swingd.sim import geodesy
from swingd.sim.plant import DT_S, Plant, rotation_matrix
from swingd.sim.vibration import Vibration

MAGNETIC_FIELD_NED_GAUSS: Vec3 = (0.21475, 0.00797, 0.42817)
"""Of the earth at the place of `swingd.sim.geodesy`."""
TEMPERATURE_C = 15.0
AIR_STEPS = 5
"""Steps from one reading of magnetometer and barometer to the next: 50 Hz."""
GNSS_STEPS = 25
"""Steps from one fix to the next: 10 Hz."""
GNSS_DELAY_STEPS = 2
"""Age of a fix when it arrives: 8 ms; PX4 takes it for 10 ms with an external simulator (EKF2_GPS_DELAY)."""

_BIAS_TIME_S = 60.0
_MAGNETOMETER_NOISE_GAUSS = 0.001
_BAROMETER_NOISE_M = 0.03
_GNSS_TIME_S = 30.0  # a receiver's position error wanders; its velocity error is nearly white


@dataclass(frozen=True, slots=True)
class Fix:
    """What a GNSS receiver tells."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """Above mean sea level."""
    vel_ned_mps: Vec3


@dataclass(frozen=True, slots=True)
class Air:
    """Magnetometer and barometer."""

    field_frd_gauss: Vec3
    pressure_hpa: float
    altitude_m: float
    """That the pressure stands for in the standard atmosphere, above mean sea level."""


@dataclass(frozen=True, slots=True)
class Readings:
    """What arrived with one step."""

    acc_frd_mps2: Vec3
    """Specific force at the IMU."""
    gyro_frd_radps: Vec3
    air: Air | None
    gnss: Fix | None


class Imu:
    """Accelerometer and gyroscope of a plant.

    Parameters
    ----------
    simulation : Simulation
        ``acc_noise_mps2``, ``gyro_noise_radps``, ``acc_bias_mps2``, vibration and seed.
    plant : Plant
        The truth.
    random : Generator, optional
        Where the noise comes from; by default one of its own, made from the seed.
    """

    def __init__(self, simulation: Simulation, plant: Plant, random: np.random.Generator | None = None) -> None:
        self._simulation = simulation
        self._plant = plant
        self._random = random or np.random.default_rng((simulation.seed, 2))
        self._vibration = Vibration(simulation)
        self._bias = simulation.acc_bias_mps2 * self._random.standard_normal(3)

    def read(self, dt_s: float = DT_S) -> tuple[Vec3, Vec3]:
        """Measure the plant's last step, which took ``dt_s``; to be called once for each step.

        White noise keeps its density: a sample over a shorter time has more of it.

        Returns
        -------
        acc_frd_mps2, gyro_frd_radps : (3,)
            Specific force at the IMU and body rates, means over the step.
        """
        simulation, plant = self._simulation, self._plant
        noise = self._random.standard_normal(9)
        drive = simulation.acc_bias_mps2 * sqrt(2.0 * dt_s / _BIAS_TIME_S)
        self._bias += -dt_s / _BIAS_TIME_S * self._bias + drive * noise[3:6]
        throttle = plant.state[PlantState.ROTOR : PlantState.ROTOR + 4]
        shaken = self._vibration.sample(plant.t_s, throttle)
        a, w, shorter = PlantOutput.SPECIFIC_FORCE, PlantOutput.MEAN_RATE, sqrt(DT_S / dt_s)
        acc_std, gyro_std = simulation.acc_noise_mps2 * shorter, simulation.gyro_noise_radps * shorter
        x, y, z = (float(plant.output[a + i] + self._bias[i] + shaken[i] + acc_std * noise[i]) for i in range(3))
        p, q, r = (float(plant.output[w + i] + gyro_std * noise[6 + i]) for i in range(3))
        return (x, y, z), (p, q, r)


class RawSensors:
    """Measure a plant, 250 times a second.

    Parameters
    ----------
    simulation : Simulation
        Noise figures, vibration and seed. ``gnss_vel_noise_mps`` is white, ``gnss_pos_noise_m`` a wander of 30 s;
        ``attitude_noise_rad`` is not used: the attitude is the autopilot's own affair.
    plant : Plant
        The truth.
    """

    def __init__(self, simulation: Simulation, plant: Plant) -> None:
        self._simulation = simulation
        self._plant = plant
        self._random = np.random.default_rng((simulation.seed, 2))
        self._imu = Imu(simulation, plant, self._random)
        self._wander_m = simulation.gnss_pos_noise_m * self._random.standard_normal(3)
        self._fixes: deque[tuple[int, Fix]] = deque()
        self._steps = 0

    def read(self) -> Readings:
        """Measure the state after the plant's last step; to be called once for each step."""
        self._steps += 1
        if self._steps % GNSS_STEPS == 0:
            self._fixes.append((self._steps + GNSS_DELAY_STEPS, self._fix()))
        arrived = bool(self._fixes) and self._fixes[0][0] <= self._steps
        return Readings(
            *self._imu.read(),
            self._air() if self._steps % AIR_STEPS == 0 else None,
            self._fixes.popleft()[1] if arrived else None,
        )

    def _air(self) -> Air:
        state = self._plant.state
        noise = self._random.standard_normal(4)
        rotation = rotation_matrix(*state[PlantState.QUAT : PlantState.QUAT + 4])
        forward, right, down = (
            sum(rotation[row][column] * MAGNETIC_FIELD_NED_GAUSS[row] for row in range(3))
            + _MAGNETOMETER_NOISE_GAUSS * float(noise[column])
            for column in range(3)
        )
        altitude_m = geodesy.ALTITUDE_M - state[PlantState.POS + 2] + _BAROMETER_NOISE_M * float(noise[3])
        return Air((forward, right, down), _standard_pressure_hpa(altitude_m), altitude_m)

    def _fix(self) -> Fix:
        simulation, state = self._simulation, self._plant.state
        noise = self._random.standard_normal(6)
        share = GNSS_STEPS * DT_S / _GNSS_TIME_S
        self._wander_m += -share * self._wander_m + simulation.gnss_pos_noise_m * sqrt(2.0 * share) * noise[:3]
        n, e, d = (state[PlantState.POS + i] + float(self._wander_m[i]) for i in range(3))
        vn, ve, vd = (state[PlantState.VEL + i] + simulation.gnss_vel_noise_mps * float(noise[3 + i]) for i in range(3))
        return Fix(*geodesy.global_of((n, e, d)), (vn, ve, vd))


def _standard_pressure_hpa(altitude_m: float) -> float:
    """Pressure of the standard atmosphere's lowest layer."""
    return float(1013.25 * (1.0 - 0.0065 * altitude_m / 288.15) ** 5.25588)
