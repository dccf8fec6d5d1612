"""Flights of two point masses on a rigid cable, many at once: a second formulation, in Cartesian coordinates."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from swingd.core.constants import GRAVITY_MPS2
from swingd.identify import FlightRecord
from swingd.model.events import Attitude, Imu, LocalPosition
from swingd.model.parameters import Vehicle

FloatArray = npt.NDArray[np.float64]
RATE_HZ = 100.0
GRAVITY = np.array([0.0, 0.0, GRAVITY_MPS2])
THRUST_LAG_S = 0.12
VELOCITY_P_PER_S = 1.6
STEP_S = 8.0
"""The reference velocity changes this often."""


@dataclass(frozen=True)
class Truth:
    """What flies, besides each flight's own noise and directions."""

    vehicle_kg: float = 1.5
    load_kg: float = 0.4
    length_m: float = 1.5
    damping_ratio: float = 0.015
    drag_n_per_mps: float = 0.3
    speed_mps: float = 2.0
    """Of the velocity steps; 0: hover."""
    yaw_rate_radps: float = 0.1
    gust_std_n: float = 0.0
    """Force on the vehicle, Gauss-Markov with 2 s."""
    acc_noise_mps2: float = 0.1
    acc_bias_mps2: float = 0.03
    attitude_std_rad: float = 0.0
    """Error of the autopilot's roll and pitch, Gauss-Markov with 10 s."""


@dataclass(frozen=True)
class Flown:
    """Streams of several flights."""

    t_s: FloatArray
    acc_frd: FloatArray
    """(n, flights, 3)."""
    attitude: FloatArray
    """(n, flights, 3) roll, pitch, yaw."""
    velocity: FloatArray
    truth: Truth = field(default_factory=Truth)

    def record(self, flight: int, *, velocity: bool = True, drop: slice | None = None) -> FlightRecord:
        """Streams of one flight as the fit takes them, without the samples ``drop``."""
        kept = np.ones(len(self.t_s), dtype=bool)
        if drop is not None:
            kept[drop] = False
        times = self.t_s[kept].tolist()
        imu = [
            Imu(t, t, tuple(acc), (0.0, 0.0, 0.0))
            for t, acc in zip(times, self.acc_frd[kept, flight].tolist(), strict=True)
        ]
        attitudes = [Attitude(t, t, *rpy) for t, rpy in zip(times, self.attitude[kept, flight].tolist(), strict=True)]
        positions = [
            LocalPosition(t, t, (0.0, 0.0, -10.0), tuple(vel))
            for t, vel in zip(times[::2], self.velocity[kept, flight][::2].tolist(), strict=True)
        ]
        return FlightRecord(imu, attitudes, positions if velocity else [], Vehicle(mass_kg=self.truth.vehicle_kg))

    @property
    def hanging(self) -> list[tuple[float, float]]:
        return [(float(self.t_s[0]), float(self.t_s[-1]))]


def fly(truth: Truth, flights: int, duration_s: float, seed: int) -> Flown:
    """Fly velocity steps into random directions; classical Runge-Kutta with the noise held over each step."""
    rng = np.random.default_rng(seed)
    m, m_l, length_m = truth.vehicle_kg, truth.load_kg, truth.length_m
    dt_s = 1.0 / RATE_HZ
    count = int(duration_s * RATE_HZ)
    steps = int(duration_s / STEP_S) + 1
    heading = rng.uniform(-np.pi, np.pi, (steps, flights))
    targets = truth.speed_mps * np.stack([np.cos(heading), np.sin(heading), 0.0 * heading], axis=-1)
    targets[1::2] = 0.0
    bias = truth.acc_bias_mps2 * rng.standard_normal((flights, 3))
    gust = truth.gust_std_n * rng.standard_normal((flights, 3)) * [1.0, 1.0, 0.3]
    tilt_error = truth.attitude_std_rad * rng.standard_normal((flights, 2))
    turning = truth.yaw_rate_radps * rng.choice([-1.0, 1.0], flights)
    weight_n = (m + m_l) * GRAVITY_MPS2
    rope = np.zeros((flights, 3))
    rope[:, :2] = 0.05 * rng.standard_normal((flights, 2)) * length_m
    rope[:, 2] = np.sqrt(length_m**2 - (rope**2).sum(axis=-1))
    # velocity, load relative to the hook, its derivative, thrust
    state = np.stack([np.zeros_like(rope), rope, np.zeros_like(rope), np.tile([0.0, 0.0, -weight_n], (flights, 1))])
    decay_per_s = 2.0 * truth.damping_ratio * np.sqrt(GRAVITY_MPS2 / length_m)

    def forces(state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Force on the vehicle without weight, and the cable's direction."""
        velocity, rope, rate, thrust = state
        n = rope / np.linalg.norm(rope, axis=-1, keepdims=True)
        down = -thrust / np.linalg.norm(thrust, axis=-1, keepdims=True)
        across = velocity - (velocity * down).sum(-1, keepdims=True) * down
        applied = thrust + gust - truth.drag_n_per_mps * across
        tension = ((rate * rate).sum(-1) / length_m - (n * applied).sum(-1) / m) / (1.0 / m + 1.0 / m_l)
        return applied + tension[:, None] * n, n * tension[:, None]

    def slope(state: FloatArray, target: FloatArray) -> FloatArray:
        velocity, _, rate, thrust = state
        force, pull = forces(state)
        wanted = (m + m_l) * (VELOCITY_P_PER_S * (target - velocity) - GRAVITY)
        load = GRAVITY - pull / m_l - decay_per_s * rate
        vehicle = GRAVITY + force / m
        return np.stack([vehicle, rate, load - vehicle, (wanted - thrust) / THRUST_LAG_S])

    acc_frd, attitude, velocities = (np.empty((count, flights, 3)) for _ in range(3))
    for k in range(count):
        yaw = turning * k * dt_s
        thrust = state[3]
        down = -thrust / np.linalg.norm(thrust, axis=-1, keepdims=True)
        x = np.cos(yaw) * down[:, 0] + np.sin(yaw) * down[:, 1]
        y = -np.sin(yaw) * down[:, 0] + np.cos(yaw) * down[:, 1]
        roll, pitch = -np.arcsin(y), np.arctan2(x, down[:, 2])
        felt = forces(state)[0] / m
        felt_heading = np.stack(
            [
                np.cos(yaw) * felt[:, 0] + np.sin(yaw) * felt[:, 1],
                -np.sin(yaw) * felt[:, 0] + np.cos(yaw) * felt[:, 1],
                felt[:, 2],
            ],
            axis=-1,
        )
        down_heading = np.stack([x, y, down[:, 2]], axis=-1)
        forward = np.stack([np.cos(pitch), 0.0 * pitch, -np.sin(pitch)], axis=-1)
        right = np.cross(down_heading, forward)
        acc_frd[k] = np.stack([(felt_heading * axis).sum(-1) for axis in (forward, right, down_heading)], axis=-1)
        attitude[k] = np.stack([roll + tilt_error[:, 0], pitch + tilt_error[:, 1], yaw], axis=-1)
        velocities[k] = state[0]
        target = targets[int(k * dt_s / STEP_S)]
        a = slope(state, target)
        b = slope(state + 0.5 * dt_s * a, target)
        c = slope(state + 0.5 * dt_s * b, target)
        d = slope(state + dt_s * c, target)
        state = state + dt_s / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        gust += -gust * dt_s / 2.0 + truth.gust_std_n * np.sqrt(dt_s) * rng.standard_normal((flights, 3)) * [
            1.0,
            1.0,
            0.3,
        ]
        tilt_error += -tilt_error * dt_s / 10.0 + truth.attitude_std_rad * np.sqrt(0.2 * dt_s) * rng.standard_normal(
            (flights, 2)
        )
    acc_frd += bias + truth.acc_noise_mps2 * rng.standard_normal(acc_frd.shape)
    velocities += 0.05 * rng.standard_normal(velocities.shape)
    return Flown(np.arange(count) * dt_s, acc_frd, attitude, velocities, truth)
