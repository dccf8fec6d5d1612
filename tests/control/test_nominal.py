"""The planned motion against the equations of vehicle, load and autopilot, integrated a second time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swingd.control.nominal import NominalMotion, swing_frequency_radps
from swingd.model.parameters import Autopilot, Cable, Estimator, Parameters, Payload, Shaping, Vehicle

GRAVITY = 9.80665
DT_S = 0.01
DURATION_S = 6.0
Vec2 = tuple[float, float]


def slung(vehicle_kg: float, payload_kg: float, length_m: float, **parts: object) -> Parameters:
    return replace(
        Parameters(),
        vehicle=Vehicle(vehicle_kg),
        payload=Payload(payload_kg),
        cable=Cable(length_m),
        estimator=Estimator(damping_ratio=0.0),
        **parts,
    )


def reference(t_s: float) -> tuple[float, float, float, float]:
    """A smooth velocity step of 2 m/s within 2 s with its derivatives, position first."""
    T = 2.0
    if t_s <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if t_s >= T:
        return T + 2.0 * (t_s - T), 2.0, 0.0, 0.0
    w = 2.0 * math.pi / T
    return (
        2.0 / T * (0.5 * t_s**2 + (math.cos(w * t_s) - 1.0) / w**2),
        2.0 / T * (t_s - math.sin(w * t_s) / w),
        2.0 / T * (1.0 - math.cos(w * t_s)),
        2.0 / T * w * math.sin(w * t_s),
    )


def plan(parameters: Parameters) -> tuple[NominalMotion, list[tuple[float, ...]]]:
    """Rows of t, position, velocity, acceleration setpoint, load ahead, its rate; along north."""
    motion = NominalMotion(parameters)
    rows = [(0.0,) * 6]
    for k in range(1, round(DURATION_S / DT_S) + 1):
        t_s = k * DT_S
        pos, vel, acc, jerk = reference(t_s)
        motion.step((vel, 0.0), (acc, 0.0), (jerk, 0.0), DT_S, ended=False)
        length_m = parameters.cable.length_m
        rows.append(
            (
                t_s,
                pos - motion.lag_m[0],
                motion.vel_mps[0],
                motion.acc_mps2[0],
                motion.direction[0] * length_m,
                motion.direction_rate_per_s[0] * length_m,
            )
        )
    return motion, rows


def fly(parameters: Parameters, rows: np.ndarray) -> np.ndarray:
    """Position, velocity and load of a vehicle that is given the plan's velocity and acceleration, (3, n)."""
    m, ml, L = parameters.vehicle.mass_kg, parameters.payload.mass_kg, parameters.cable.length_m
    px4 = parameters.autopilot
    bandwidth = 2.0 * 0.6 / px4.acceleration_delay_s

    def rates(t_s: float, x: np.ndarray) -> list[float]:
        _pos, vel, integral, tilt, tilt_rate, load, load_rate = x
        vel_sp, acc_ff = np.interp(t_s, rows[:, 0], rows[:, 2]), np.interp(t_s, rows[:, 0], rows[:, 3])
        pull = ml / m * GRAVITY / L * load
        acc = (m + ml) / m * tilt + pull
        error = vel_sp - vel
        acc_sp = px4.velocity_p * error + integral - px4.velocity_d * acc + acc_ff
        return [
            vel,
            acc,
            px4.velocity_i * error,
            tilt_rate,
            bandwidth**2 * (acc_sp - tilt) - 1.2 * bandwidth * tilt_rate,
            load_rate,
            -GRAVITY / L * load - acc,
        ]

    solution = solve_ivp(rates, (0.0, DURATION_S), np.zeros(7), t_eval=rows[:, 0], max_step=0.01, rtol=1e-8, atol=1e-10)
    return solution.y[[0, 1, 5]]


@pytest.mark.parametrize("delay_s", [0.05, 0.12, 0.3])
@pytest.mark.parametrize(
    ("vehicle_kg", "payload_kg", "length_m"), [(1.5, 0.3, 1.5), (2.0, 0.5, 3.0), (2.0, 1.0, 1.5), (2.0, 0.2, 0.8)]
)
def test_a_vehicle_that_is_given_the_plan_flies_it(
    vehicle_kg: float, payload_kg: float, length_m: float, delay_s: float
) -> None:
    parameters = slung(vehicle_kg, payload_kg, length_m, autopilot=Autopilot(acceleration_delay_s=delay_s))
    rows = np.array(plan(parameters)[1])
    pos, vel, load = fly(parameters, rows)
    assert np.abs(vel - rows[:, 2]).max() < 0.01 * 2.0
    assert np.abs(pos - rows[:, 1]).max() < 0.02
    assert np.abs(load - rows[:, 4]).max() < 0.02 * np.abs(rows[:, 4]).max()


def test_position_velocity_and_load_are_integrals_of_each_other() -> None:
    rows = np.array(plan(slung(2.0, 0.3, 1.5))[1])
    for value, rate in ((1, 2), (4, 5)):
        integral = rows[0, value] + np.cumsum(np.r_[0.0, 0.5 * DT_S * (rows[1:, rate] + rows[:-1, rate])])
        assert np.abs(integral - rows[:, value]).max() < 2e-3


def test_the_lead_makes_up_for_the_attitude_loop() -> None:
    """Once the reference is steady, the vehicle is where the reference is, not a delay behind."""
    motion, rows = plan(slung(2.0, 0.3, 1.5))
    assert motion.lag_m[0] == pytest.approx(0.0, abs=1e-6)
    assert rows[-1][2] == pytest.approx(2.0, abs=1e-6)
    late = NominalMotion(slung(2.0, 0.3, 1.5, shaping=Shaping(acc_max_mps2=0.5, jerk_max_mps3=1000.0)))
    late.reset((2.0, 0.0))
    for _ in range(200):
        late.step((2.0, 0.0), (0.0, 0.0), (0.0, 0.0), DT_S, ended=False)
    assert late.lag_m[0] == pytest.approx(2.0 * (0.12 - 0.001), rel=1e-3), "no lead longer than the jerk lasts"


def test_the_load_hangs_from_a_prescribed_motion() -> None:
    """Left alone in the plan, it swings at sqrt(g / L) whatever the masses are."""
    for payload_kg in (0.1, 2.0):
        motion = NominalMotion(slung(2.0, payload_kg, 1.5))
        # An acceleration that lasts a quarter of a second.
        for k in range(25):
            motion.step((0.01 * k, 0.0), (1.0, 0.0), (0.0, 0.0), DT_S, ended=False)
        ahead = []
        for _ in range(1500):
            motion.step((0.25, 0.0), (0.0, 0.0), (0.0, 0.0), DT_S, ended=False)
            ahead.append(motion.direction[0])
        crossings = np.flatnonzero(np.diff(np.sign(ahead[100:])))
        period_s = 2.0 * DT_S * np.mean(np.diff(crossings))
        assert period_s == pytest.approx(2.0 * math.pi / swing_frequency_radps(1.5), rel=2e-3)
        assert swing_frequency_radps(1.5) == pytest.approx(math.sqrt(GRAVITY / 1.5))


def test_what_swings_when_the_motion_has_ended_is_left_to_the_law() -> None:
    motion = NominalMotion(slung(2.0, 0.3, 1.5))
    for k in range(30):
        motion.step((0.05 * k, 0.0), (5.0, 0.0), (0.0, 0.0), DT_S, ended=False)
    assert abs(motion.direction[0]) > 0.1
    sizes = []
    for _ in range(300):
        motion.step((1.45, 0.0), (0.0, 0.0), (0.0, 0.0), DT_S, ended=True)
        sizes.append(math.hypot(motion.direction[0], motion.direction_rate_per_s[0] / swing_frequency_radps(1.5)))
    assert sizes[100] < 0.15 * sizes[0]
    assert sizes[-1] < 1e-3


def test_a_longer_cable_is_taken_where_the_load_is() -> None:
    motion = NominalMotion(slung(2.0, 0.3, 1.5))
    for k in range(30):
        motion.step((0.02 * k, 0.0), (2.0, 0.0), (0.0, 0.0), DT_S, ended=False)
    load_m, vel = motion.direction[0] * 1.5, motion.vel_mps
    motion.configure(slung(2.0, 0.3, 2.0))
    assert motion.direction[0] * 2.0 == pytest.approx(load_m)
    assert motion.vel_mps == vel


@pytest.mark.parametrize("dt_s", [0.0025, 0.02, 0.5])
@pytest.mark.parametrize("delay_s", [0.0, 0.12, 1.0])
@pytest.mark.parametrize("length_m", [0.1, 200.0])
def test_it_stays_finite_and_ends_where_the_reference_ends(dt_s: float, delay_s: float, length_m: float) -> None:
    motion = NominalMotion(slung(2.0, 0.3, length_m, autopilot=Autopilot(acceleration_delay_s=delay_s)))
    for k in range(round(40.0 / dt_s)):
        _pos, vel, acc, jerk = reference(k * dt_s)
        motion.step((vel, -vel), (acc, -acc), (jerk, -jerk), dt_s, ended=False)
    for _ in range(round(60.0 / dt_s)):
        motion.step((2.0, -2.0), (0.0, 0.0), (0.0, 0.0), dt_s, ended=True)
    assert motion.vel_mps == pytest.approx((2.0, -2.0), abs=1e-6)
    assert np.hypot(*motion.direction) < 0.01
    assert np.hypot(*motion.acc_mps2) < 0.05
