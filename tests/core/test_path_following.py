"""The path-following law: its energy, its terms against the equations, its disturbances, its path; and the attitude."""

import math

import numpy as np
import pytest

from swingd.core import path_following as kernels
from swingd.core import slts
from swingd.core.attitude_tracking import rate_between, tracking_torque
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.path_following import PathParam, PathState, PathTerm
from swingd.core.status import Status

MASS, PAYLOAD, LENGTH = 1.52, 0.5, 1.6
TOTAL = MASS + PAYLOAD
WEIGHT = np.array([0.0, 0.0, GRAVITY_MPS2])
NORTH = np.array([[0.0, 0.0, -10.0], [1000.0, 0.0, -10.0]])
DT_S = 0.002


def parameters(**changed):
    given = {
        "MASS": MASS, "PAYLOAD_MASS": PAYLOAD, "CABLE_LENGTH": LENGTH, "CRUISE": 2.0, "LEAD": 1.0, "K_P": 0.7,
        "K_L": 1.5, "K_0": TOTAL, "K_R": 1.0, "LEAK": 1.0, "LAMBDA_T": 1.0, "KAPPA": 2.0, "TILT_MAX": 1.4,
        "LIFT_MIN": 1.0, "LIFT_MAX": 100.0,
    } | changed  # fmt: skip
    return np.array([given[index.name] for index in PathParam if index is not PathParam.SIZE], dtype=float)


def begun(x, p, waypoints=NORTH):
    state = np.empty(PathState.SIZE)
    assert kernels.begin(state, x, waypoints, p) == Status.OK
    return state


class Loop:
    """Point masses under the law with exact inputs, and a disturbance on each body."""

    def __init__(self, x, p, waypoints=NORTH, d_b=(0.0, 0.0, 0.0), d_p=(0.0, 0.0, 0.0)):
        self.x, self.p, self.waypoints = x, p, waypoints
        self.d_b, self.d_p = np.array(d_b, dtype=float), np.array(d_p, dtype=float)
        self.state, self.terms = begun(x, p, waypoints), np.empty(PathTerm.SIZE)
        self.force = -TOTAL * WEIGHT
        self.dt_s = 0.0

    def term(self, first, count=3):
        return self.terms[first : first + count].copy()

    def step(self):
        acc = self.acceleration(self.x, self.force)
        ell, B = np.empty(3), np.empty((3, 2))
        slts.cable(ell, B, self.x[3:5].copy(), LENGTH)
        specific_force = (self.force + self.d_b - acc[5] * ell / LENGTH) / MASS
        status = kernels.update(
            self.terms, self.state, self.x, self.force, specific_force, self.waypoints, self.p, self.dt_s
        )
        assert status == Status.OK
        self.dt_s = DT_S
        self.force = self.term(PathTerm.F_V)
        rate = self.rate(self.x)
        self.x = self.x + DT_S * self.rate(self.x + 0.5 * DT_S * rate)

    def acceleration(self, x, force):
        acc = np.empty(6)
        assert slts.acceleration(acc, x, force + self.d_b, self.d_p, MASS, PAYLOAD, LENGTH) == Status.OK
        return acc

    def rate(self, x):
        return np.concatenate([x[5:], self.acceleration(x, self.force)[:5]])


def some_state(seed, size=1.0):
    rng = np.random.default_rng(seed)
    x = size * np.concatenate(
        [rng.normal(0, 1, 3), rng.uniform(-0.5, 0.5, 2), rng.normal(0, 1, 3), rng.normal(0, 0.6, 2)]
    )
    x[2] -= 10.0
    return x


def rate_of_energy(loop):
    """E' as the module's text says it."""
    p, x = loop.p, loop.x
    ell, B = np.empty(3), np.empty((3, 2))
    slts.cable(ell, B, x[3:5].copy(), LENGTH)
    s_p, R = loop.term(PathTerm.S_P), loop.term(PathTerm.R)
    sigma = s_p + R
    W = PAYLOAD * WEIGHT
    r_off = x[3:5] - loop.term(PathTerm.R_D, 2)
    swing = p[PathParam.K_L] * r_off @ B.T @ W
    f_b, zeta_rate = loop.term(PathTerm.F_B), loop.term(PathTerm.ZETA_RATE)
    return -p[PathParam.K_0] * sigma @ sigma - swing + PAYLOAD * s_p @ zeta_rate + sigma @ f_b, sigma, swing, s_p


def test_energy_changes_as_derived():
    p = parameters(LAMBDA_T=0.0, KAPPA=0.0)
    for seed in range(12):
        loop = Loop(some_state(seed), p)
        loop.step()
        energies = []
        expected = []
        for _ in range(300):
            expected.append(rate_of_energy_before(loop))
            loop.step()
            energies.append(loop.terms[PathTerm.ENERGY])
        change = np.diff(energies) / DT_S
        middle = 0.5 * (np.array(expected[1:]) + np.array(expected[:-1]))[1:]
        np.testing.assert_allclose(change[1:], middle, atol=0.02 * np.abs(middle).max())


def rate_of_energy_before(loop):
    """The derived rate at the state that the next step begins from."""
    terms, state = loop.terms.copy(), loop.state.copy()
    x, force = loop.x.copy(), loop.force.copy()
    status = kernels.update(terms, state, x, force, np.zeros(3), loop.waypoints, loop.p, 1e-9)
    assert status == Status.OK
    probe = Loop.__new__(Loop)
    probe.p, probe.x, probe.terms = loop.p, x, terms
    return rate_of_energy(probe)[0]


def test_velocities_and_swing_lose_energy_at_every_instant():
    """k_p = lambda = 0: no position, no leak; then every term of E' has a sign."""
    p = parameters(K_P=0.0, LEAK=0.0, LAMBDA_T=0.0, KAPPA=0.0)
    for seed in range(20):
        loop = Loop(some_state(seed), p)
        loop.step()
        rate, sigma, swing, s_p = rate_of_energy(loop)
        assert swing >= 0.0
        assert rate == pytest.approx(-TOTAL * sigma @ sigma - swing - PAYLOAD * s_p @ s_p, rel=1e-6, abs=1e-9)
        energies = [loop.terms[PathTerm.ENERGY]]
        for _ in range(2000):
            loop.step()
            energies.append(loop.terms[PathTerm.ENERGY])
        # Euler holds the thrust over each step, which is all that may show.
        assert np.diff(energies).max() < 1e-5 * energies[0]
        assert energies[-1] < 0.05 * energies[0]


def test_with_position_and_leak_the_energy_goes_from_any_start():
    p = parameters(LAMBDA_T=0.0, KAPPA=0.0)
    for seed in range(20):
        loop = Loop(some_state(seed), p)
        loop.step()
        first = loop.terms[PathTerm.ENERGY]
        second_s = []
        for _ in range(8):
            for _ in range(500):
                loop.step()
            e_p = loop.term(PathTerm.E_P)
            second_s.append(loop.terms[PathTerm.ENERGY] + 0.5 * PAYLOAD * 0.49 * e_p @ e_p)
        assert second_s[-1] < 2e-3 * first
        assert np.linalg.norm(loop.term(PathTerm.E_P)) < 0.1
        assert np.linalg.norm(loop.term(PathTerm.E_V)) < 0.1


def test_as_printed_f_b_could_put_energy_in():
    """f_b = m_b (zeta' + k_p s_p) of (10) against the one that is derived, in the same states."""
    p = parameters(K_P=0.7, LEAK=0.0, LAMBDA_T=0.0, KAPPA=0.0)
    printed, derived = [], []
    for seed in range(200):
        loop = Loop(some_state(seed), p)
        loop.step()
        rate, sigma, _, s_p = rate_of_energy(loop)
        f_b = MASS * (loop.term(PathTerm.ZETA_RATE) + 0.7 * s_p)
        derived.append(rate / loop.terms[PathTerm.ENERGY])
        printed.append((rate + sigma @ (f_b - loop.term(PathTerm.F_B))) / loop.terms[PathTerm.ENERGY])
    assert np.mean(printed) > 0.6 * np.mean(derived)
    assert max(printed) > 0.3
    assert max(derived) < 0.0


def test_terms_are_those_of_the_equations():
    p = parameters()
    x = some_state(5)
    loop = Loop(x.copy(), p)
    loop.step()
    ell, B = np.empty(3), np.empty((3, 2))
    slts.cable(ell, B, x[3:5].copy(), LENGTH)
    n = np.array([1.0, 0.0, 0.0])
    e_p = (x[:3] - NORTH[0]) - (x[:3] - NORTH[0]) @ n * n
    mu = 1.5 * (x[3:5] - loop.term(PathTerm.R_D, 2))
    R = B @ (x[8:] + mu)
    zeta = 0.7 * e_p - 2.0 * n
    np.testing.assert_allclose(loop.term(PathTerm.E_P), e_p, atol=1e-12)
    np.testing.assert_allclose(loop.term(PathTerm.E_V), x[5:8] - 2.0 * n, atol=1e-12)
    np.testing.assert_allclose(loop.term(PathTerm.MU, 2), mu)
    np.testing.assert_allclose(loop.term(PathTerm.R), R, atol=1e-12)
    np.testing.assert_allclose(loop.term(PathTerm.ZETA), zeta, atol=1e-12)
    np.testing.assert_allclose(loop.term(PathTerm.F_A), -TOTAL * (x[5:8] + zeta + R), atol=1e-12)
    # B mu along the motion, by differences.
    e, ends = 1e-6, []
    for sign in (1.0, -1.0):
        moved = x[3:5] + sign * e * x[8:]
        slts.cable(ell, B, moved, LENGTH)
        ends.append(B @ (1.5 * moved))
    B_mu_rate = (ends[0] - ends[1]) / (2.0 * e)
    zeta_rate = 0.7 * (x[5:8] - x[5] * n) + R
    np.testing.assert_allclose(loop.term(PathTerm.ZETA_RATE), zeta_rate, atol=1e-9)
    np.testing.assert_allclose(loop.term(PathTerm.F_0), -MASS * (zeta_rate + B_mu_rate), atol=1e-6)


@pytest.mark.parametrize(
    ("d_b", "d_p"),
    [((0.8, -0.5, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (0.6, 0.3, 0.0)), ((0.5, 0.2, 3.0), (-0.4, 0.5, 0.1))],
)
def test_steady_disturbances_are_found_and_leave_no_error(d_b, d_p):
    loop = Loop(some_state(1, 0.3), parameters(), d_b=d_b, d_p=d_p)
    for _ in range(round(20.0 / DT_S)):
        loop.step()
    assert np.linalg.norm(loop.term(PathTerm.E_P)) < 0.02
    pull = PAYLOAD * WEIGHT + np.array(d_p)
    r_d = -LENGTH * pull[:2] / np.linalg.norm(pull)
    np.testing.assert_allclose(loop.x[3:5], r_d, atol=5e-3)
    np.testing.assert_allclose(loop.term(PathTerm.R_D, 2), r_d, atol=5e-3)
    q = np.array([*r_d, -math.sqrt(LENGTH**2 - r_d @ r_d)]) / LENGTH
    across = np.eye(3) - np.outer(q, q)
    np.testing.assert_allclose(loop.term(PathTerm.D_PERP), across @ d_b, atol=0.02)
    np.testing.assert_allclose(loop.term(PathTerm.D_T), np.array(d_p) + d_b - across @ d_b, atol=0.02)


def test_in_words_wind_on_the_load_leaves_it_downwind_of_the_vehicle():
    loop = Loop(some_state(1, 0.0) - [0, 0, 0, 0, 0, 0, 0, 0, 0, 0], parameters(), d_p=(1.0, 0.0, 0.0))
    for _ in range(round(10.0 / DT_S)):
        loop.step()
    assert loop.x[3] < -0.2  # the vehicle south of a load that is blown north


def test_a_leg_ends_where_less_than_the_lead_is_left_and_the_last_place_is_held():
    path = np.array([[0.0, 0.0, -10.0], [10.0, 0.0, -10.0], [10.0, 10.0, -10.0]])
    x = np.zeros(10)
    x[2] = -10.0
    loop = Loop(x, parameters(LEAD=1.25), path)
    turned_at = held_at = None
    for _ in range(round(30.0 / DT_S)):
        before = loop.x[:3].copy()
        loop.step()
        leg = int(loop.state[PathState.LEG])
        if leg == 1 and turned_at is None:
            turned_at = before
        if leg == 2 and held_at is None:
            held_at = before
    assert turned_at[0] == pytest.approx(8.75, abs=0.01)
    assert held_at[1] == pytest.approx(8.75, abs=0.01)
    np.testing.assert_allclose(loop.x[:3], path[-1], atol=0.02)
    np.testing.assert_allclose(loop.term(PathTerm.E_P), loop.x[:3] - path[-1], atol=0.02)
    assert loop.terms[PathTerm.REMAINING] == 0.0


def test_the_thrust_stays_within_lift_and_tilt():
    p = parameters(TILT_MAX=0.4, LIFT_MIN=10.0, LIFT_MAX=25.0)
    for seed in range(30):
        x = some_state(seed, 3.0)
        x[3:5] = np.clip(x[3:5], -0.9, 0.9)
        terms = np.empty(PathTerm.SIZE)
        status = kernels.update(terms, begun(x, p), x, -TOTAL * WEIGHT, -WEIGHT, NORTH, p, 0.0)
        assert status == Status.OK
        f = terms[PathTerm.F_V : PathTerm.F_V + 3]
        assert 10.0 <= -f[2] <= 25.0
        assert math.atan2(math.hypot(f[0], f[1]), -f[2]) <= 0.4 + 1e-9


def test_out_of_reach_and_not_a_number_are_refused_and_change_nothing():
    p, x = parameters(), np.zeros(10)
    state = begun(x, p)
    before, terms = state.copy(), np.empty(PathTerm.SIZE)
    far = x.copy()
    far[3] = 1.59
    assert kernels.update(terms, state, far, -TOTAL * WEIGHT, -WEIGHT, NORTH, p, DT_S) == Status.NOT_CONVERGED
    assert kernels.begin(state.copy(), far, NORTH, p) == Status.NOT_CONVERGED
    bad = np.array([math.nan, 0.0, -20.0])
    assert kernels.update(terms, state, x, bad, -WEIGHT, NORTH, p, DT_S) == Status.NOT_FINITE
    np.testing.assert_array_equal(state, before)


# ---- attitude


def rotation(vector):
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -2.5, math.pi])
def test_wanted_attitude_gives_the_thrust_and_heads_where_told(yaw_rad):
    rng = np.random.default_rng(1)
    for _ in range(20):
        f_v = np.array([*rng.uniform(-8.0, 8.0, 2), -rng.uniform(5.0, 30.0)])
        R = np.empty((3, 3))
        kernels.desired_attitude(R, f_v, yaw_rad)
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        np.testing.assert_allclose(-np.linalg.norm(f_v) * R[:, 2], f_v, atol=1e-9)
        assert math.remainder(math.atan2(R[1, 0], R[0, 0]) - yaw_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
        assert R[2, 2] > 0.0  # as printed it would fly upside down


def test_attitude_follows_a_turning_reference_exactly_and_loses_energy_from_any_start():
    J = np.array([[0.0165, 0.001, 0.0], [0.001, 0.02, 0.0], [0.0, 0.0, 0.03]])
    b_r, b_omega, dt_s = 1.6, 0.37, 0.001
    rate_d, rate_d_rate = np.array([0.4, -0.3, 0.8]), np.zeros(3)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        R, R_d = rotation(rng.uniform(-1.5, 1.5, 3)), np.eye(3)
        rate, torque = 3.0 * rng.standard_normal(3), np.empty(3)
        energies = []
        for _ in range(4000):
            tracking_torque(
                torque, np.ascontiguousarray(R), rate, np.ascontiguousarray(R_d), rate_d, rate_d_rate, J, b_r, b_omega
            )
            off = R_d.T @ R
            error = rate - off.T @ rate_d
            energies.append(0.5 * error @ J @ error + b_r * (3.0 - np.trace(off)))
            rate = rate + dt_s * np.linalg.solve(J, torque - np.cross(rate, J @ rate))
            R, R_d = R @ rotation(dt_s * rate), R_d @ rotation(dt_s * rate_d)
        assert np.diff(energies).max() < 2e-3 * energies[0]
        assert energies[-1] < 1e-4 * energies[0]


def test_rate_between_two_attitudes():
    rng = np.random.default_rng(2)
    for size in (1e-6, 0.1, 2.0, 3.0):
        vector = rng.standard_normal(3)
        vector *= size / np.linalg.norm(vector)
        before = rotation(rng.standard_normal(3))
        rate = np.empty(3)
        rate_between(rate, np.ascontiguousarray(before), np.ascontiguousarray(before @ rotation(vector)), 0.01)
        np.testing.assert_allclose(rate, vector / 0.01, rtol=1e-6, atol=1e-6 * size)
