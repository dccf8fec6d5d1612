"""The planar rotorcraft against its Lagrangian, the paper's equations, its energy and a second integrator."""

import math
from functools import cache

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from swingd.core import planar_rotorcraft as plant
from swingd.core.constants import GRAVITY_MPS2 as G
from swingd.core.planar_rotorcraft import PlanarInput, PlanarParam, PlanarState
from swingd.core.status import Status

PAPER = np.array([0.5, 0.177, 0.125, 0.35, 0.0, 0.0, 0.0, 0.0])
"""Table 1."""
HOOKED = np.array([1.3, 0.05, 0.4, 0.8, 0.06, -0.12, 0.0, 0.0])
DRAGGED = np.array([1.3, 0.05, 0.4, 0.8, 0.06, -0.12, 0.3, 0.2])


@cache
def lagrangian():
    """Accelerations (4,) and energy, from kinetic and potential energy alone; forces by virtual work."""
    m, inertia, m_load, length, h_1, h_3, drag, load_drag = p = sp.symbols("m I m_p l h_1 h_3 c c_p", real=True)
    thrust, torque, rod_torque, load_torque, airframe_torque, wind_x, wind_z = u = sp.symbols(
        "T u_theta u_gamma tau_p tau w_x w_z", real=True
    )
    q = sp.Matrix(sp.symbols("x z theta gamma", real=True))
    qd = sp.Matrix(sp.symbols("x_rate z_rate theta_rate gamma_rate", real=True))
    theta, gamma = q[2], q[3]
    e_1 = sp.Matrix([sp.cos(theta), -sp.sin(theta)])
    e_3 = sp.Matrix([sp.sin(theta), sp.cos(theta)])
    vehicle = q[:2, 0]
    load = vehicle + h_1 * e_1 + h_3 * e_3 - length * sp.Matrix([sp.sin(gamma), sp.cos(gamma)])
    vel, vel_load = qd[:2, 0], load.jacobian(q) * qd
    kinetic = m / 2 * vel.dot(vel) + m_load / 2 * vel_load.dot(vel_load) + inertia / 2 * qd[2] ** 2
    potential = G * (m * q[1] + m_load * load[1])
    momentum = sp.Matrix([(kinetic - potential).diff(rate) for rate in qd])
    wind = sp.Matrix([wind_x, wind_z])
    forces = vehicle.jacobian(q).T * (thrust * e_3 - drag * (vel - wind))
    forces += load.jacobian(q).T * (-load_drag * (vel_load - wind))
    # Between airframe and rod a torque does work by the angle between them.
    forces += sp.Matrix([0, 0, torque + airframe_torque, load_torque]) + rod_torque * sp.Matrix([0, 0, -1, 1])
    right = forces - momentum.jacobian(q) * qd + sp.Matrix([(kinetic - potential).diff(c) for c in q])
    arguments = ([*q, *qd], u, p)
    mass = sp.lambdify(arguments, momentum.jacobian(qd), cse=True)
    known = sp.lambdify(arguments, right, cse=True)
    energy = sp.lambdify(arguments, kinetic + potential, cse=True)
    return lambda *a: np.linalg.solve(mass(*a), known(*a)[:, 0]), energy


def accelerations(x, u, p):
    acc = np.empty(4)
    assert Status(plant.accelerations(acc, x, u, p)) is Status.OK
    return acc


def random_case(rng):
    return rng.normal(size=8) * [5, 5, 1, 2, 2, 2, 3, 4], rng.normal(size=7) * [8, 1, 0.5, 0.3, 0.2, 4, 2]


@pytest.mark.parametrize("p", [PAPER, HOOKED, DRAGGED])
def test_accelerations_are_the_lagrangian_s(p):
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, u = random_case(rng)
        np.testing.assert_allclose(accelerations(x, u, p), lagrangian()[0](x, u, p), rtol=1e-9, atol=1e-9)


def test_the_papers_equations_with_the_signs_that_the_text_lost():
    """(13) to (16), (19), (21) and (23) with l_p^2, for a hook at the centre of gravity."""
    m, inertia, m_p, l_p = PAPER[:4]
    rng = np.random.default_rng(1)
    for _ in range(50):
        x, u = random_case(rng)
        u[[PlanarInput.LOAD_TORQUE, PlanarInput.AIRFRAME_TORQUE]] = 0.0
        theta, gamma, rate = x[2], x[3], x[7]
        s, c = math.sin(gamma), math.cos(gamma)
        x_2, z_2, theta_2, gamma_2 = accelerations(x, u, PAPER)
        u_x, u_z, u_gamma = u[0] * math.sin(theta), u[0] * math.cos(theta), u[PlanarInput.ROD_TORQUE]
        assert (m + m_p) * x_2 - m_p * l_p * gamma_2 * c + m_p * l_p * rate**2 * s == pytest.approx(u_x, abs=1e-9)
        assert (m + m_p) * (z_2 + G) + m_p * l_p * (gamma_2 * s + rate**2 * c) == pytest.approx(u_z, abs=1e-9)
        coupling = m_p * l_p * (l_p * gamma_2 - x_2 * c + (z_2 + G) * s)
        assert coupling == pytest.approx(u_gamma, abs=1e-9)
        rho = np.empty(3)
        assert plant.disturbances(rho, x, u, PAPER) == Status.OK
        assert rho[0] == pytest.approx(-m_p * x_2 + m_p * l_p * (gamma_2 * c - rate**2 * s), abs=1e-9)
        assert rho[1] == pytest.approx(-m_p * (z_2 + G) - m_p * l_p * (gamma_2 * s + rate**2 * c), abs=1e-9)
        assert rho[2] == pytest.approx(-coupling, abs=1e-9)
        assert inertia * theta_2 == pytest.approx(u[PlanarInput.TORQUE] + rho[2], abs=1e-9)


def test_signs_in_words():
    m, m_p = PAPER[PlanarParam.MASS], PAPER[PlanarParam.LOAD_MASS]
    hover = np.zeros(PlanarInput.SIZE)
    hover[PlanarInput.THRUST] = (m + m_p) * G
    x, rho = np.zeros(PlanarState.SIZE), np.empty(3)
    # Hovering with the load below: it pulls down with its weight and nothing else.
    plant.disturbances(rho, x, hover, PAPER)
    np.testing.assert_allclose(rho, [0.0, -m_p * G, 0.0], atol=1e-12)
    np.testing.assert_allclose(accelerations(x, hover, PAPER), 0.0, atol=1e-12)
    # Leaning forward accelerates forward and leaves the load behind (gamma > 0), which pulls backwards.
    x[PlanarState.PITCH] = 0.2
    acc = accelerations(x, hover, PAPER)
    assert acc[0] > 0.0
    assert acc[3] > 0.0
    x[PlanarState.ROD] = 0.3
    plant.disturbances(rho, x, hover, PAPER)
    assert rho[0] < 0.0
    # A rod that is turned forward (u_gamma < 0) turns the airframe the other way: it leans forward.
    turned = hover.copy()
    turned[PlanarInput.ROD_TORQUE] = -0.1
    acc = accelerations(np.zeros(PlanarState.SIZE), turned, PAPER)
    assert acc[3] < 0.0 < acc[2]
    # Turned from outside, it does not turn the airframe.
    turned[PlanarInput.ROD_TORQUE], turned[PlanarInput.LOAD_TORQUE] = 0.0, -0.1
    assert accelerations(np.zeros(PlanarState.SIZE), turned, PAPER)[2] == 0.0
    # A load that hangs from the nose makes it heavy: the vehicle leans forward.
    nose = PAPER.copy()
    nose[PlanarParam.HOOK] = 0.1
    plant.disturbances(rho, np.zeros(PlanarState.SIZE), hover, nose)
    assert rho[2] == pytest.approx(0.1 * -rho[1])
    assert rho[2] > 0.0
    # Wind from ahead pushes back.
    windy = hover.copy()
    windy[PlanarInput.WIND] = -5.0
    plant.disturbances(rho, np.zeros(PlanarState.SIZE), windy, DRAGGED)
    assert rho[0] < 0.0


@pytest.mark.parametrize("p", [PAPER, HOOKED])
def test_energy_stays_without_inputs_and_grows_by_their_work(p):
    energy = lagrangian()[1]
    free, dt_s = np.zeros(PlanarInput.SIZE), 0.002
    x = np.array([0.0, 0.0, 0.3, 1.2, 1.0, 2.0, -0.5, 3.0])
    before = energy(x, free, p)
    for _ in range(2000):
        assert plant.step(x, free, p, dt_s) == Status.OK
    assert energy(x, free, p) == pytest.approx(before, rel=1e-8)
    # Power of thrust and torques, the vehicle flown by something.
    u = np.array([7.0, 0.2, 0.1, -0.15, 0.05, 0.0, 0.0])
    before, work = energy(x, u, p), 0.0
    for _ in range(500):
        powers = []
        for _ in range(3):
            thrust = u[0] * (math.sin(x[2]) * x[4] + math.cos(x[2]) * x[5])
            powers.append(thrust + (u[1] + u[4]) * x[6] + u[2] * (x[7] - x[6]) + u[3] * x[7])
            if len(powers) < 3:
                plant.step(x, u, p, 0.5 * dt_s)
        work += dt_s / 6.0 * (powers[0] + 4.0 * powers[1] + powers[2])
    assert energy(x, u, p) - before == pytest.approx(work, rel=1e-6)


def test_drag_takes_energy_until_the_load_hangs_in_the_wind():
    """Held against the wind by nothing, the vehicle ends up flying with it."""
    x = np.zeros(PlanarState.SIZE)
    x[PlanarState.ROD] = 1.0
    u = np.zeros(PlanarInput.SIZE)
    u[PlanarInput.THRUST] = (DRAGGED[0] + DRAGGED[2]) * G
    u[PlanarInput.WIND] = 3.0
    level = DRAGGED.copy()
    level[PlanarParam.HOOK : PlanarParam.HOOK + 2] = 0.0
    for _ in range(6000):
        plant.step(x, u, level, 0.01)
    assert x[PlanarState.RATES] == pytest.approx(3.0, abs=1e-3)
    assert x[PlanarState.RATES + PlanarState.Z] == pytest.approx(0.0, abs=1e-3)
    assert math.sin(x[PlanarState.ROD]) == pytest.approx(0.0, abs=1e-3)


def test_fourth_order_against_scipy():
    x_0 = np.array([0.0, 1.0, 0.2, 0.7, 1.0, -0.5, 0.4, -2.0])
    u = np.array([9.0, 0.05, -0.02, 0.03, 0.01, -2.0, 0.5])

    def rate(_t_s, x):
        return np.concatenate([x[4:], accelerations(np.ascontiguousarray(x), u, DRAGGED)])

    exact = solve_ivp(rate, (0.0, 0.8), x_0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    errors = []
    for steps in (20, 40):
        x = x_0.copy()
        for _ in range(steps):
            plant.step(x, u, DRAGGED, 0.8 / steps)
        errors.append(np.abs(x - exact).max())
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.2)
    assert errors[1] < 1e-5


def test_a_rod_without_length_and_a_state_that_is_no_number_are_said():
    u = np.zeros(PlanarInput.SIZE)
    for index in (PlanarParam.MASS, PlanarParam.INERTIA, PlanarParam.ROD_LENGTH):
        p = PAPER.copy()
        p[index] = 0.0 if index == PlanarParam.ROD_LENGTH else -1.0
        x = np.zeros(PlanarState.SIZE)
        assert Status(plant.step(x, u, p, 0.01)) is Status.NOT_POSITIVE
        assert not x.any()
    x = np.zeros(PlanarState.SIZE)
    x[PlanarState.X] = math.inf
    before = x.copy()
    assert Status(plant.step(x, u, PAPER, 0.01)) is Status.NOT_FINITE
    np.testing.assert_array_equal(x, before)
