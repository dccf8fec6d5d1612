"""The multirotor with a load against vectors and matrices of NumPy, conservation laws, and the study's octarotor."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from swingd.core.atmosphere import air_density
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.multirotor import (
    MultirotorInput,
    MultirotorOutput,
    MultirotorParam,
    MultirotorState,
    Rotor,
    multirotor_derivative,
    multirotor_step,
)
from swingd.core.rotor import induced_velocity, inplane_loads
from swingd.studies.drones2023.vehicles import OCTAROTOR

S, U, Y, P = MultirotorState, MultirotorInput, MultirotorOutput, MultirotorParam
DOWN = np.array([0.0, 0.0, 1.0])
HOVER = (0.0, 0.0, -30.0)


def vector(packed, first):
    return packed[first : first + 3]


def lopsided():
    """Parameters and rotors of a vehicle without any symmetry."""
    inertia = np.array([[2.1, 0.3, -0.2], [0.3, 1.7, 0.15], [-0.2, 0.15, 3.2]])
    p = np.zeros(P.SIZE)
    p[P.MASS] = 9.0
    p[P.INERTIA : P.INERTIA + 9] = inertia.ravel()
    p[P.INERTIA_INV : P.INERTIA_INV + 9] = np.linalg.inv(inertia).ravel()
    p[P.HOOK : P.HOOK + 3] = (0.1, -0.07, 0.2)
    p[P.CENTRE_OF_PRESSURE : P.CENTRE_OF_PRESSURE + 3] = (-0.05, 0.04, -0.1)
    p[P.IMU : P.IMU + 3] = (0.06, 0.03, -0.08)
    p[P.DRAG_AREA : P.DRAG_AREA + 3] = (0.1, 0.2, 0.5)
    p[P.ROTOR_LAG] = 0.05
    p[P.REFERENCE_DENSITY] = 1.1
    p[P.ORIGIN_ALTITUDE] = 700.0
    p[P.LOAD_MASS] = 4.0
    p[P.LOAD_DRAG_AREA] = 0.08
    p[P.CABLE_LENGTH] = 3.0
    p[P.CABLE_STIFFNESS] = 900.0
    p[P.CABLE_DAMPING] = 7.0
    p[P.BLADE :] = [3, 0.3, 0.03, 0.033, 5.7, 0.06, 0.4, -0.25, 0.012]
    rotors = np.array(
        [
            [0.5, 0.4, -0.1, 1.0, 3.0e-4, 7e-6],
            [-0.5, 0.5, -0.2, -1.0, 2.5e-4, 6e-6],
            [0.1, -0.6, 0.1, 1.0, 3.5e-4, 8e-6],
        ]
    )
    return p, rotors


def random_state(rng, rotors, taut=True):
    """A state of the lopsided vehicle that tumbles through gusty air, and inputs."""
    x = np.zeros(S.OMEGA + len(rotors))
    x[: S.ENERGY] = rng.normal(size=S.ENERGY)
    x[S.VEL : S.VEL + 3] *= 5.0
    x[S.POS + 2] *= 200.0
    x[S.OMEGA :] = rng.uniform(100.0, 400.0, len(rotors))
    direction = rng.normal(size=3)
    distance = rng.uniform(3.5, 3.6) if taut else 2.0
    x[S.LOAD_POS : S.LOAD_POS + 3] = x[:3] + distance * direction / np.linalg.norm(direction)
    u = 3.0 * rng.normal(size=U.OMEGA + len(rotors))
    u[U.OMEGA :] = rng.uniform(100.0, 400.0, len(rotors))
    return x, u


def derivative(x, u, p, rotors):
    x_dot, y = np.full(len(x), np.nan), np.full(Y.SIZE, np.nan)
    multirotor_derivative(x_dot, y, np.full(len(rotors), 5.0), x, u, p, rotors)
    return x_dot, y


def step(x, u, p, rotors, dt_s, count=1):
    """State after some steps, and outputs at the beginning of the last one."""
    x, x_dot, y, inflow = x.copy(), np.empty(len(x)), np.empty(Y.SIZE), np.full(len(rotors), 5.0)
    for _ in range(count):
        multirotor_step(x, x_dot, y, inflow, u, p, rotors, dt_s)
    return x, y


def by_vectors(x, u, p, rotors):
    """Derivative and outputs from wrenches and Newton-Euler, frames by `Rotation`."""
    ned_from_frd = Rotation.from_quat(x[S.QUAT : S.QUAT + 4], scalar_first=True).as_matrix()
    rate = vector(x, S.RATE)
    density = air_density(p[P.ORIGIN_ALTITUDE] - x[S.POS + 2])
    gamma = density / p[P.REFERENCE_DENSITY]

    def through_air(place):
        return ned_from_frd.T @ (vector(x, S.VEL) - vector(u, U.WIND)) + np.cross(rate - vector(u, U.GUST_RATE), place)

    at_pressure = through_air(vector(p, P.CENTRE_OF_PRESSURE))
    drag = -0.5 * density * np.linalg.norm(at_pressure) * vector(p, P.DRAG_AREA) * at_pressure
    wrenches = [(vector(p, P.CENTRE_OF_PRESSURE), drag, np.zeros(3))]
    aero = drag
    thrust = power = 0.0
    for row, omega in zip(rotors, x[S.OMEGA :], strict=True):
        place, spin = row[:3], row[Rotor.SPIN]
        air = through_air(place)
        inplane = air - air[2] * DOWN
        speed = np.linalg.norm(inplane)
        climb = -air[2]
        inflow = climb + induced_velocity(5.0, climb, speed, omega, density, p[P.BLADE :])
        loads = np.empty(3)
        inplane_loads(loads, inflow, speed, omega, density, p[P.BLADE :])
        motion = inplane / speed
        # Counter-clockwise from above the blade on the right of the motion advances.
        advancing = spin * np.cross(DOWN, motion)
        along = -loads[0] * motion + loads[1] * advancing
        lifted = loads[2] * np.cross(advancing, -DOWN)
        pull = -gamma * row[Rotor.THRUST] * omega**2 * DOWN
        reaction = spin * gamma * row[Rotor.TORQUE] * omega**2 * DOWN
        wrenches.append((place, along + pull, reaction + lifted))
        aero = aero + along
        thrust -= pull[2]
        power += abs(reaction[2]) * omega
    hook = vector(p, P.HOOK)
    cable = vector(x, S.LOAD_POS) - vector(x, S.POS) - ned_from_frd @ hook
    cable_rate = vector(x, S.LOAD_VEL) - vector(x, S.VEL) - ned_from_frd @ np.cross(rate, hook)
    length = np.linalg.norm(cable)
    tension = 0.0
    if length > p[P.CABLE_LENGTH]:
        tension = p[P.CABLE_STIFFNESS] * (length - p[P.CABLE_LENGTH])
        tension = max(0.0, tension + p[P.CABLE_DAMPING] * cable_rate @ cable / length)
    pull = tension * cable / length
    wrenches.append((hook, ned_from_frd.T @ pull, np.zeros(3)))
    force = sum(wrench[1] for wrench in wrenches)
    moment = sum(np.cross(place, push) + couple for place, push, couple in wrenches)
    inertia = p[P.INERTIA : P.INERTIA + 9].reshape(3, 3)
    rate_dot = np.linalg.solve(inertia, moment - np.cross(rate, inertia @ rate))
    load_air = vector(x, S.LOAD_VEL) - vector(u, U.LOAD_WIND)
    load_force = -0.5 * density * p[P.LOAD_DRAG_AREA] * np.linalg.norm(load_air) * load_air - pull
    quat = x[S.QUAT : S.QUAT + 4] / np.linalg.norm(x[S.QUAT : S.QUAT + 4])
    quat_dot = np.array([-quat[1:] @ rate, *(quat[0] * rate + np.cross(quat[1:], rate))]) / 2.0
    imu = vector(p, P.IMU)
    x_dot = np.concatenate(
        [
            vector(x, S.VEL),
            ned_from_frd @ force / p[P.MASS] + GRAVITY_MPS2 * DOWN,
            quat_dot,
            rate_dot,
            vector(x, S.LOAD_VEL),
            load_force / p[P.LOAD_MASS] + GRAVITY_MPS2 * DOWN,
            [power],
            (u[U.OMEGA :] - x[S.OMEGA :]) / p[P.ROTOR_LAG],
        ]
    )
    at_imu = force / p[P.MASS] + np.cross(rate_dot, imu) + np.cross(rate, np.cross(rate, imu))
    y = np.concatenate([at_imu, ned_from_frd @ aero, cable, cable_rate, [tension, thrust, power]])
    return x_dot, y


@pytest.mark.parametrize("taut", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_derivative_and_outputs_are_those_of_newton_and_euler(seed, taut):
    p, rotors = lopsided()
    x, u = random_state(np.random.default_rng(seed), rotors, taut)
    x_dot, y = derivative(x, u, p, rotors)
    x_dot_expected, y_expected = by_vectors(x, u, p, rotors)
    np.testing.assert_allclose(x_dot, x_dot_expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(y, y_expected, rtol=1e-10, atol=1e-10)
    assert (y[Y.TENSION] > 0.0) == taut


def in_vacuum(damping=0.0):
    """No rotors, no air, a spring that stays taut while vehicle and load whirl about each other; x, u, p, rotors."""
    p, _ = lopsided()
    p[P.DRAG_AREA : P.DRAG_AREA + 3] = 0.0
    p[P.LOAD_DRAG_AREA] = 0.0
    p[P.CABLE_DAMPING] = damping
    x = np.zeros(S.OMEGA)
    x[S.VEL : S.VEL + 3] = (1.0, -2.0, 0.5)
    x[S.QUAT : S.QUAT + 4] = Rotation.from_euler("ZYX", [0.3, 0.2, -0.4]).as_quat(scalar_first=True)
    x[S.RATE : S.RATE + 3] = (0.6, -0.4, 0.8)
    x[S.LOAD_POS : S.LOAD_POS + 3] = (0.1, 0.0, 3.27)
    x[S.LOAD_VEL : S.LOAD_VEL + 3] = (8.0, 1.0, 0.5)
    return x, np.zeros(U.OMEGA), p, np.zeros((0, Rotor.SIZE))


def invariants(x, p):
    """Momentum [N s], angular momentum about the common CG [N m s], mechanical energy [J]."""
    masses = p[P.MASS], p[P.LOAD_MASS]
    places = vector(x, S.POS), vector(x, S.LOAD_POS)
    velocities = vector(x, S.VEL), vector(x, S.LOAD_VEL)
    momentum = sum(m * v for m, v in zip(masses, velocities, strict=True))
    centre = sum(m * r for m, r in zip(masses, places, strict=True)) / sum(masses)
    ned_from_frd = Rotation.from_quat(x[S.QUAT : S.QUAT + 4], scalar_first=True).as_matrix()
    rate = vector(x, S.RATE)
    inertia = p[P.INERTIA : P.INERTIA + 9].reshape(3, 3)
    angular = ned_from_frd @ inertia @ rate
    energy = 0.5 * rate @ inertia @ rate
    for m, r, v in zip(masses, places, velocities, strict=True):
        angular = angular + m * np.cross(r - centre, v)
        energy += 0.5 * m * v @ v - m * GRAVITY_MPS2 * r[2]
    length = np.linalg.norm(places[1] - places[0] - ned_from_frd @ vector(p, P.HOOK))
    energy += 0.5 * p[P.CABLE_STIFFNESS] * max(length - p[P.CABLE_LENGTH], 0.0) ** 2
    return momentum, angular, energy


def test_falling_freely_conserves_momentum_and_energy():
    x, u, p, rotors = in_vacuum()
    momentum, angular, energy = invariants(x, p)
    for k in range(1, 5):
        x, y = step(x, u, p, rotors, 1e-3, 250)
        assert y[Y.TENSION] > 0.0
        momentum_k, angular_k, energy_k = invariants(x, p)
        weight = (p[P.MASS] + p[P.LOAD_MASS]) * GRAVITY_MPS2 * DOWN
        np.testing.assert_allclose(momentum_k, momentum + 0.25 * k * weight, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(angular_k, angular, rtol=1e-7, atol=1e-7)
        assert energy_k == pytest.approx(energy, rel=1e-7)


def test_a_damped_cable_takes_the_energy_of_its_damper_and_no_momentum():
    damping = 20.0
    x, u, p, rotors = in_vacuum(damping)
    momentum, angular, energy = invariants(x, p)
    powers = []
    for _ in range(300):
        x, y = step(x, u, p, rotors, 1e-3)
        cable = vector(y, Y.CABLE)
        powers.append(damping * (cable @ vector(y, Y.CABLE_RATE)) ** 2 / (cable @ cable))
    momentum_later, angular_later, energy_later = invariants(x, p)
    assert energy - energy_later > 0.1
    assert energy - energy_later == pytest.approx(1e-3 * sum(powers), rel=0.02)
    np.testing.assert_allclose(momentum_later[:2], momentum[:2], atol=1e-9)
    np.testing.assert_allclose(angular_later, angular, rtol=1e-7, atol=1e-7)


def test_a_step_is_of_fourth_order():
    p, rotors = lopsided()
    x = np.zeros(S.OMEGA + 3)
    x[S.QUAT] = 1.0
    x[S.RATE : S.RATE + 3] = (0.3, -0.2, 0.4)
    x[S.LOAD_POS : S.LOAD_POS + 3] = (0.2, 0.0, 3.25)
    x[S.OMEGA :] = 350.0
    u = np.concatenate([[4.0, -3.0, 0.5, 0.1, -0.2, 0.1, 5.0, -2.0, 0.3], [380.0, 340.0, 360.0]])
    duration_s = 0.16
    exact = solve_ivp(
        lambda _t, at: derivative(at, u, p, rotors)[0], (0.0, duration_s), x, method="DOP853", rtol=1e-12, atol=1e-12
    ).y[:, -1]
    errors = []
    for count in (8, 16, 32):
        end, y = step(x, u, p, rotors, duration_s / count, count)
        assert y[Y.TENSION] > 0.0
        assert np.linalg.norm(end[S.QUAT : S.QUAT + 4]) == pytest.approx(1.0, abs=1e-15)
        errors.append(np.abs(end - exact)[: S.ENERGY].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.3)


def test_a_slack_cable_pulls_nothing():
    x, u, p, rotors = in_vacuum()
    x[S.LOAD_POS : S.LOAD_POS + 3] = (0.5, 0.2, 2.0)
    x[S.RATE : S.RATE + 3] = 0.0
    x_dot, y = derivative(x, u, p, rotors)
    assert y[Y.TENSION] == 0.0
    np.testing.assert_array_equal(vector(x_dot, S.VEL), GRAVITY_MPS2 * DOWN)
    np.testing.assert_array_equal(vector(x_dot, S.LOAD_VEL), GRAVITY_MPS2 * DOWN)
    np.testing.assert_array_equal(vector(x_dot, S.RATE), 0.0)
    np.testing.assert_array_equal(vector(y, Y.SPECIFIC_FORCE), 0.0)


def test_a_cable_does_not_push_when_its_damper_would():
    x, u, p, rotors = in_vacuum(damping=1e4)
    x[S.LOAD_VEL : S.LOAD_VEL + 3] = (0.0, 0.0, -5.0)
    _, y = derivative(x, u, p, rotors)
    assert np.linalg.norm(vector(y, Y.CABLE)) > p[P.CABLE_LENGTH]
    assert y[Y.TENSION] == 0.0


def test_the_cable_turns_the_vehicle_by_its_lever_at_the_hook():
    """A hook ahead of the CG pulls the nose down; one on the right, the right side."""
    x, u, p, rotors = in_vacuum()
    x[S.QUAT : S.QUAT + 4] = (1.0, 0.0, 0.0, 0.0)
    x[S.RATE : S.RATE + 3] = 0.0
    for hook, moment_sign in (([0.3, 0, 0], [0, -1, 0]), ([0, 0.3, 0], [1, 0, 0]), ([0, 0, 0.3], [0, 0, 0])):
        p[P.HOOK : P.HOOK + 3] = hook
        x[S.LOAD_POS : S.LOAD_POS + 3] = np.add(hook, 3.2 * DOWN)
        x_dot, y = derivative(x, u, p, rotors)
        assert y[Y.TENSION] == pytest.approx(900.0 * 0.2)
        moment = p[P.INERTIA : P.INERTIA + 9].reshape(3, 3) @ vector(x_dot, S.RATE)
        np.testing.assert_allclose(moment, 0.3 * 180.0 * np.array(moment_sign), atol=1e-9)


def octarotor(pos=HOVER, yaw=0.0, xi=0.0, zeta=0.0):
    """x, u, p and rotors of the study's vehicle at rest."""
    x = OCTAROTOR.hovering(pos, yaw, xi, zeta)
    u = np.zeros(U.OMEGA + 8)
    u[U.OMEGA :] = x[S.OMEGA :]
    return x, u, OCTAROTOR.packed(), OCTAROTOR.rotor_table()


@pytest.mark.parametrize("pos", [HOVER, (20.0, -5.0, -900.0)])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_octarotor_hovers_in_balance(pos, yaw):
    x, u, p, rotors = octarotor(pos, yaw)
    x_dot, y = derivative(x, u, p, rotors)
    np.testing.assert_allclose(x_dot[: S.ENERGY], 0.0, atol=1e-6)
    np.testing.assert_array_equal(x_dot[S.OMEGA :], 0.0)
    assert y[Y.TENSION] == pytest.approx(100.0 * GRAVITY_MPS2, rel=1e-9)
    assert y[Y.THRUST] == pytest.approx(170.0 * GRAVITY_MPS2, rel=1e-12)
    np.testing.assert_allclose(vector(y, Y.SPECIFIC_FORCE), -GRAVITY_MPS2 * DOWN, atol=1e-9)
    gamma = air_density(-pos[2]) / p[P.REFERENCE_DENSITY]
    np.testing.assert_allclose(gamma * rotors[:, Rotor.THRUST] * x[S.OMEGA :] ** 2, 170.0 * GRAVITY_MPS2 / 8)


def test_hover_takes_the_papers_power():
    """Table 2 of Drones 2023, 7, 654, energy over manoeuvre time: 23.1 to 23.2 kW."""
    x, u, p, rotors = octarotor()
    _, y = derivative(x, u, p, rotors)
    assert y[Y.SHAFT_POWER] == pytest.approx(23.16e3, rel=0.005)


def test_a_released_load_swings_back():
    """Load to the left and ahead, as its angles say, is drawn to the right and backwards; the vehicle after it."""
    x, u, p, rotors = octarotor(xi=0.2, zeta=0.3)
    x_dot, y = derivative(x, u, p, rotors)
    assert y[Y.CABLE] > 0.0 > y[Y.CABLE + 1]
    assert x_dot[S.LOAD_VEL] < 0.0 < x_dot[S.LOAD_VEL + 1]
    assert x_dot[S.VEL] > 0.0 > x_dot[S.VEL + 1]
    # The cable carries what lies along it of the weight.
    assert y[Y.TENSION] == pytest.approx(math.cos(0.2) * math.cos(0.3) * 100.0 * GRAVITY_MPS2, rel=1e-9)


def test_energy_is_the_integral_of_the_shaft_power():
    x, u, p, rotors = octarotor()
    u[U.OMEGA :] += np.linspace(-20.0, 30.0, 8)
    dt_s, powers = 0.002, []
    for _ in range(100):
        x, y = step(x, u, p, rotors, dt_s)
        powers.append(y[Y.SHAFT_POWER])
    powers.append(derivative(x, u, p, rotors)[1][Y.SHAFT_POWER])
    by_hand = sum(rotors[:, Rotor.TORQUE] * x[S.OMEGA :] ** 3) * air_density(-x[S.POS + 2]) / p[P.REFERENCE_DENSITY]
    assert powers[-1] == pytest.approx(by_hand, rel=1e-12)
    assert x[S.ENERGY] == pytest.approx(np.trapezoid(powers, dx=dt_s), rel=1e-4)
    assert np.ptp(powers) > 100.0


def test_a_motor_follows_with_its_lag():
    x, u, p, rotors = octarotor()
    before = x[S.OMEGA :].copy()
    u[U.OMEGA :] += 10.0
    x, _ = step(x, u, p, rotors, 0.002, 30)
    np.testing.assert_allclose(x[S.OMEGA :] - before, 10.0 * (1.0 - math.exp(-1.0)), rtol=1e-6)


@pytest.mark.parametrize(
    ("faster", "axis", "sign"),
    [
        (lambda r: r[:, 1] > 0, 0, -1),  # right side lifts: roll to the left
        (lambda r: r[:, 0] > 0, 1, 1),  # front lifts: nose up
        (lambda r: r[:, Rotor.SPIN] > 0, 2, 1),  # counter-clockwise propellers turn the body clockwise
    ],
    ids=["right", "front", "counter-clockwise"],
)
def test_faster_rotors_turn_the_vehicle(faster, axis, sign):
    x, u, p, rotors = octarotor()
    x[S.OMEGA :][faster(rotors)] *= 1.01
    x_dot, _ = derivative(x, u, p, rotors)
    assert sign * x_dot[S.RATE + axis] > 0.01


def test_flying_forward_is_braked_as_a_head_wind_is():
    x, u, p, rotors = octarotor()
    x[S.VEL] = x[S.LOAD_VEL] = 8.0
    x_dot, y = derivative(x, u, p, rotors)
    assert y[Y.AERO_FORCE] < -5.0
    assert y[Y.AERO_FORCE + 1] == pytest.approx(0.0, abs=1e-9)
    x[S.VEL] = x[S.LOAD_VEL] = 0.0
    u[U.WIND] = u[U.LOAD_WIND] = -8.0
    x_dot_wind, y_wind = derivative(x, u, p, rotors)
    x_dot[S.LOAD_POS] = 0.0
    np.testing.assert_allclose(x_dot_wind[S.VEL :], x_dot[S.VEL :], atol=1e-12)
    np.testing.assert_allclose(y_wind, y, atol=1e-12)


def test_a_single_rotor_rolls_away_from_its_advancing_side():
    """Flying forward, counter-clockwise: the right blade advances, lifts, and the vehicle rolls to the left."""
    x, u, p, rotors = octarotor()
    x[S.VEL] = 8.0
    rotors = np.ascontiguousarray(rotors[:1])
    rotors[0, :3] = 0.0
    p[P.DRAG_AREA : P.DRAG_AREA + 3] = 0.0
    for spin in (1.0, -1.0):
        rotors[0, Rotor.SPIN] = spin
        x_dot, _ = derivative(x[: S.OMEGA + 1].copy(), u[: U.OMEGA + 1].copy(), p, rotors)
        assert spin * x_dot[S.RATE] < -0.01
