"""The slung load transport system against a Lagrangian, (4) as printed, differences, energy and the two-body plant."""

from functools import cache

import numpy as np
import pytest
import sympy as sp

from swingd.core import slts
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slts import REACH_MAX, SltsState
from swingd.core.slung_plant import PlantInput, PlantOutput, PlantParam, PlantState, slung_plant_derivative
from swingd.core.status import Status

VEHICLE = (1.52, 0.5, 1.6)
"""m_b, m_p, l of the paper's section VI.A."""
OUTDOOR = (1.09, 0.54, 1.6)
STILL = np.zeros(3)


def random_state(rng, length, reach=0.8):
    x = rng.standard_normal(10)
    r = rng.uniform(-1.0, 1.0, 2)
    x[3:5] = reach * length * r / max(1.0, np.linalg.norm(r))
    return x


def acceleration(x, force, load_force, vehicle):
    acc = np.full(6, np.nan)
    assert slts.acceleration(acc, x, force, load_force, *vehicle) == Status.OK
    return acc


@cache
def lagrangian():
    """Accelerations of (x_p, r) from the Lagrangian of two point masses, in the paper's coordinates."""
    mb, mp, length, g = sp.symbols("m_b m_p l g", positive=True)
    q = sp.Matrix(sp.symbols("x y z r_x r_y"))
    qd = sp.Matrix(sp.symbols("x_d y_d z_d v_x v_y"))
    force, load_force = sp.Matrix(sp.symbols("f_x f_y f_z")), sp.Matrix(sp.symbols("d_x d_y d_z"))
    ell = sp.Matrix([q[3], q[4], -sp.sqrt(length**2 - q[3] ** 2 - q[4] ** 2)])
    vehicle = q[:3, 0] + ell
    v_load, v_vehicle = qd[:3, 0], vehicle.jacobian(q) * qd
    lagrangian = mp / 2 * v_load.dot(v_load) + mb / 2 * v_vehicle.dot(v_vehicle) + g * (mp * q[2] + mb * vehicle[2])
    momentum = sp.Matrix([lagrangian.diff(rate) for rate in qd])
    given = vehicle.jacobian(q).T * force + sp.Matrix([*load_force, 0, 0])
    right = given + sp.Matrix([lagrangian.diff(c) for c in q]) - momentum.jacobian(q) * qd
    arguments = (tuple(q), tuple(qd), tuple(force), tuple(load_force), mb, mp, length, g)
    return sp.lambdify(arguments, momentum.jacobian(qd), cse=True), sp.lambdify(arguments, right, cse=True)


@pytest.mark.parametrize("vehicle", [VEHICLE, OUTDOOR])
def test_accelerations_are_those_of_the_lagrangian(vehicle):
    M, right = lagrangian()
    rng = np.random.default_rng(1)
    for _ in range(50):
        x = random_state(rng, vehicle[2])
        force, load_force = 20.0 * rng.standard_normal(3), 3.0 * rng.standard_normal(3)
        arguments = (x[:5], x[5:], force, load_force, *vehicle, GRAVITY_MPS2)
        expected = np.linalg.solve(M(*arguments), right(*arguments)[:, 0])
        np.testing.assert_allclose(acceleration(x, force, load_force, vehicle)[:5], expected, rtol=1e-10, atol=1e-9)


def test_accelerations_are_those_of_the_printed_mass_matrix():
    _, mp, length = VEHICLE
    rng = np.random.default_rng(2)
    for _ in range(50):
        x, force, load_force = random_state(rng, length), 20.0 * rng.standard_normal(3), rng.standard_normal(3)
        M, C, ell, B = np.empty((5, 5)), np.empty((5, 5)), np.empty(3), np.empty((3, 2))
        slts.mass_and_coriolis(M, C, x, *VEHICLE)
        slts.cable(ell, B, x[3:5], length)
        f = np.concatenate([force + load_force, B.T @ force])
        g = M @ np.array([0.0, 0.0, GRAVITY_MPS2, 0.0, 0.0])
        acc = acceleration(x, force, load_force, VEHICLE)
        np.testing.assert_allclose(acc[:5], np.linalg.solve(M, -C @ x[5:] + f + g), rtol=1e-10, atol=1e-9)
        # The tension is what the load feels beside its weight.
        pull = mp * (acc[:3] - [0.0, 0.0, GRAVITY_MPS2]) - load_force
        np.testing.assert_allclose(pull, acc[5] * ell / length, atol=1e-9)


def test_mass_matrix_less_twice_coriolis_is_skew_along_the_motion():
    x = random_state(np.random.default_rng(3), VEHICLE[2])
    M, C, ahead, behind = (np.empty((5, 5)) for _ in range(4))
    unused = np.empty((5, 5))
    e = 1e-6
    for out, sign in ((ahead, e), (behind, -e)):
        moved = x.copy()
        moved[:5] += sign * x[5:]
        slts.mass_and_coriolis(out, unused, moved, *VEHICLE)
    slts.mass_and_coriolis(M, C, x, *VEHICLE)
    skew = (ahead - behind) / (2.0 * e) - 2.0 * C
    np.testing.assert_allclose(skew, -skew.T, atol=1e-8)


def test_jacobians_are_the_differences():
    rng = np.random.default_rng(4)
    for _ in range(20):
        x, force, load_force = random_state(rng, VEHICLE[2], 0.6), 20.0 * rng.standard_normal(3), rng.standard_normal(3)

        def rate(y, x=x):
            acc = acceleration(np.ascontiguousarray(y[:10]), y[10:13].copy(), y[13:].copy(), VEHICLE)
            return np.concatenate([y[5:10], acc[:5]])

        y = np.concatenate([x, force, load_force])
        e = 1e-6
        expected = np.array([(rate(y + e * d) - rate(y - e * d)) / (2.0 * e) for d in np.eye(16)]).T
        A, G = np.full((10, 10), np.nan), np.full((10, 6), np.nan)
        slts.jacobians(A, G, x, force, load_force, *VEHICLE)
        np.testing.assert_allclose(np.hstack([A, G]), expected, rtol=1e-6, atol=1e-6)


def rollout(x, force_of, vehicle, duration_s, dt_s=1e-3):
    """Runge-Kutta; returns states at every step."""

    def rate(x):
        return np.concatenate([x[5:], acceleration(x, force_of(x), STILL, vehicle)[:5]])

    states = [x]
    for _ in range(round(duration_s / dt_s)):
        k1 = rate(x)
        k2 = rate(x + 0.5 * dt_s * k1)
        k3 = rate(x + 0.5 * dt_s * k2)
        k4 = rate(x + dt_s * k3)
        x = x + dt_s / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        states.append(x)
    return np.array(states)


def test_energy_is_what_the_thrust_puts_in():
    mb, mp, length = VEHICLE
    rng = np.random.default_rng(5)
    force = np.array([2.0, -1.0, -19.0])

    def energy(x):
        ell, B = np.empty(3), np.empty((3, 2))
        slts.cable(ell, B, x[3:5].copy(), length)
        vel = x[5:8] + B @ x[8:]
        kinetic = 0.5 * (mp * x[5:8] @ x[5:8] + mb * vel @ vel)
        return kinetic - GRAVITY_MPS2 * (mp * x[2] + mb * (x[2] + ell[2])) - force @ (x[:3] + ell)

    states = rollout(random_state(rng, length, 0.3), lambda _: force, VEHICLE, 3.0)
    energies = np.array([energy(x) for x in states])
    assert np.ptp(states[:, 3]) > 0.3
    np.testing.assert_allclose(energies, energies[0], atol=1e-7 * np.abs(energies).max())


def test_in_words_a_vehicle_that_accelerates_north_leads_its_load():
    hover = np.array([1.0, 0.0, -(1.52 + 0.5) * GRAVITY_MPS2])
    x = np.zeros(10)
    acc = acceleration(x, hover, STILL, VEHICLE)
    assert acc[3] > 0.0
    assert acc[0] == 0.0  # the load learns of it when the cable leans
    x[3] = 0.2
    acc = acceleration(x, np.array([0.0, 0.0, hover[2]]), STILL, VEHICLE)
    assert acc[0] > 0.0  # pulled north
    assert acc[3] < 0.0  # and the vehicle back
    # Wind on the load towards the south leaves the vehicle north of it.
    assert acceleration(np.zeros(10), np.array([0.0, 0.0, hover[2]]), np.array([-1.0, 0.0, 0.0]), VEHICLE)[3] > 0.0


def test_steady_wind_on_the_load_leans_the_cable_as_7_corrected_says():
    mb, mp, length = VEHICLE
    d = np.array([0.7, -0.4, 0.0])
    pull = mp * np.array([0.0, 0.0, GRAVITY_MPS2]) + d
    x = np.zeros(10)
    x[3:5] = -length * pull[:2] / np.linalg.norm(pull)
    force = -pull - mb * np.array([0.0, 0.0, GRAVITY_MPS2])
    np.testing.assert_allclose(acceleration(x, force, d, VEHICLE)[:5], 0.0, atol=1e-12)
    assert x[3] < 0.0  # the load lies downwind, north of the vehicle


@pytest.mark.parametrize(("stretched_mm", "within_m"), [(5.0, 0.02), (0.5, 0.002)])
def test_the_simulators_two_bodies_tend_to_it_as_the_cable_stiffens(stretched_mm, within_m):
    """The plant's thrust is replaced by an outer force, so that its body does not turn."""
    mb, mp, length = VEHICLE
    stiffness = mp * GRAVITY_MPS2 / (1e-3 * stretched_mm)
    p = np.zeros(PlantParam.SIZE)
    p[PlantParam.MASS], p[PlantParam.LOAD_MASS] = mb, mp
    p[PlantParam.INERTIA : PlantParam.INERTIA + 3] = 0.02
    p[PlantParam.LAG_UP] = p[PlantParam.LAG_DOWN] = 1.0
    p[PlantParam.CABLE_STIFFNESS], p[PlantParam.CABLE_DAMPING] = stiffness, 0.2 * np.sqrt(stiffness)
    p[PlantParam.GROUND_DOWN] = 1000.0
    u, y, x_dot = np.zeros(PlantInput.SIZE), np.empty(PlantOutput.SIZE), np.empty(PlantState.SIZE)
    u[PlantInput.ATTACHED] = 1.0
    hover = np.array([0.5, 0.3, -(mb + mp) * GRAVITY_MPS2])

    def rate(x):
        slung_plant_derivative(x_dot, y, x, u, p)
        out = x_dot.copy()
        out[PlantState.VEL : PlantState.VEL + 3] += hover / mb
        return out

    start = np.zeros(10)
    start[3:5] = 0.4, -0.3
    ell, B = np.empty(3), np.empty((3, 2))
    slts.cable(ell, B, start[3:5].copy(), length)
    x = np.zeros(PlantState.SIZE)
    x[PlantState.POS : PlantState.POS + 3] = ell
    x[PlantState.QUAT], x[PlantState.CABLE_LENGTH] = 1.0, length
    dt_s = 5e-4
    rigid = rollout(start, lambda _: hover, VEHICLE, 1.4)[-1]
    for _ in range(round(1.4 / dt_s)):
        k1 = rate(x)
        k2 = rate(x + 0.5 * dt_s * k1)
        k3 = rate(x + 0.5 * dt_s * k2)
        k4 = rate(x + dt_s * k3)
        x = x + dt_s / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    load = x[PlantState.LOAD_POS : PlantState.LOAD_POS + 3]
    assert np.linalg.norm(rigid[3:5] - start[3:5]) > 0.3
    np.testing.assert_allclose((x[:3] - load)[:2], rigid[3:5], atol=within_m)
    np.testing.assert_allclose(load[:2], rigid[:2], atol=within_m)


def test_a_load_out_of_reach_or_not_a_number_is_refused():
    x, acc = np.zeros(10), np.full(6, np.nan)
    x[SltsState.REL_POS] = 1.001 * REACH_MAX * VEHICLE[2]
    assert slts.acceleration(acc, x, STILL, STILL, *VEHICLE) == Status.NOT_CONVERGED
    x[SltsState.REL_POS] = np.nan
    assert slts.acceleration(acc, x, STILL, STILL, *VEHICLE) == Status.NOT_FINITE
    assert np.isnan(acc).all()
