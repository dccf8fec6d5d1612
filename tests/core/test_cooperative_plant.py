"""The plant of several vehicles under one load: energy, momentum, free fall, slack, statics, the winch."""

import math

import numpy as np
import pytest

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.cooperative_plant import (
    FIRST_CARRIER,
    BodyState,
    CarrierInput,
    CarrierOutput,
    CarrierState,
    CooperativeParam,
    LoadInput,
    Tether,
    cooperative_derivative,
    cooperative_step,
)
from swingd.core.rotation import matrix
from swingd.studies.cooperative import vehicles as v

B, C, P, T = BodyState, CarrierState, CooperativeParam, Tether
U_SIZE = LoadInput.SIZE + v.CARRIERS * CarrierInput.SIZE


def lossless():
    """Parameters and tethers without drag and damping."""
    p, tethers = v.parameters(), v.tethers()
    p[[P.DRAG, P.LOAD_DRAG, P.LOAD_RATE_DRAG]] = 0.0
    tethers[:, T.DAMPING] = 0.0
    return p, tethers


def hanging(lean=0.2):
    """All level at rest, tethers stretched by the load's weight."""
    shape = v.triangle(v.TETHER_M, v.TETHER_M)
    tension_n = 0.25 * v.LOAD_MASS_KG * GRAVITY_MPS2 / math.cos(lean) * v.TETHER_M / shape.height_m
    taut_m = v.TETHER_M + tension_n / v.TETHER_STIFFNESS_N_PER_M
    stretched = v.triangle(taut_m, taut_m).height_m
    carriers = [
        (0.0, side * (v.HALF_SPAN_M + stretched * math.sin(lean)), -v.ANCHOR_UP_M - stretched * math.cos(lean) - 0.05)
        for side in v.SIDES
    ]
    return v.at_rest(np.array(carriers), np.zeros(3), 0.0)


def carrier(x, c):
    return x[FIRST_CARRIER + c * C.SIZE : FIRST_CARRIER + (c + 1) * C.SIZE]


def still_rotors(x):
    for c in range(v.CARRIERS):
        carrier(x, c)[C.OMEGA : C.OMEGA + 4] = 0.0


def inputs(x):
    """Rotors held at the speeds they have."""
    u = np.zeros(U_SIZE)
    for c in range(v.CARRIERS):
        at = LoadInput.SIZE + c * CarrierInput.SIZE
        u[at : at + 4] = carrier(x, c)[C.OMEGA : C.OMEGA + 4]
    return u


def step(x, u, p, tethers, dt_s=1e-3):
    y, tensions = np.empty(v.CARRIERS * CarrierOutput.SIZE), np.empty(len(tethers))
    cooperative_step(x, y, tensions, u, p, v.rotors(), tethers, dt_s)
    return y, tensions


def bodies(x, p):
    """Mass, inertia and state of every body."""
    yield p[P.LOAD_MASS], p[P.LOAD_INERTIA : P.LOAD_INERTIA + 3], x[: B.SIZE]
    for c in range(v.CARRIERS):
        yield p[P.MASS], p[P.INERTIA : P.INERTIA + 3], carrier(x, c)[: B.SIZE]


def rotation(body):
    return np.array(matrix(*body[B.QUAT : B.QUAT + 4])).reshape(3, 3)


def energy(x, p, tethers):
    total = 0.0
    for mass, inertia, body in bodies(x, p):
        vel, rate = body[B.VEL : B.VEL + 3], body[B.RATE : B.RATE + 3]
        total += 0.5 * mass * (vel @ vel) + 0.5 * (inertia * rate) @ rate - mass * GRAVITY_MPS2 * body[B.POS + 2]
    for row in tethers:
        own = carrier(x, int(row[T.CARRIER]))
        hook = own[B.POS : B.POS + 3] + rotation(own) @ row[T.HOOK : T.HOOK + 3]
        anchor = x[B.POS : B.POS + 3] + rotation(x[: B.SIZE]) @ row[T.ANCHOR : T.ANCHOR + 3]
        stretch = np.linalg.norm(anchor - hook) - row[T.LENGTH] - row[T.GAIN] * own[C.WINCH]
        total += 0.5 * row[T.STIFFNESS] * max(stretch, 0.0) ** 2
    return total


def momenta(x, p):
    linear, angular = np.zeros(3), np.zeros(3)
    for mass, inertia, body in bodies(x, p):
        linear += mass * body[B.VEL : B.VEL + 3]
        angular += mass * np.cross(body[B.POS : B.POS + 3], body[B.VEL : B.VEL + 3])
        angular += rotation(body) @ (inertia * body[B.RATE : B.RATE + 3])
    return linear, angular


def thrown(seed=1):
    """Bodies that spin and fly apart and are caught by their tethers, again and again."""
    x, rng = hanging(), np.random.default_rng(seed)
    still_rotors(x)
    for _, _, body in bodies(x, v.parameters()):
        body[B.VEL : B.VEL + 3] = rng.normal(size=3) * 0.5
        body[B.RATE : B.RATE + 3] = rng.normal(size=3)
    return x


def test_energy_stays_without_thrust_drag_and_damping():
    p, tethers = lossless()
    x = thrown()
    before, taut, slack = energy(x, p, tethers), 0, 0
    for _ in range(20000):
        _, tensions = step(x, np.zeros(U_SIZE), p, tethers, 1e-4)
        taut += int((tensions > 0.0).any())
        slack += int((tensions == 0.0).any())
    assert taut > 1000
    assert slack > 1000
    assert energy(x, p, tethers) == pytest.approx(before, rel=1e-5, abs=1e-3)


def test_inner_forces_change_no_momentum():
    p, tethers = lossless()
    x = thrown()
    mass = v.LOAD_MASS_KG + v.CARRIERS * v.MASS_KG
    linear, _ = momenta(x, p)
    for _ in range(2000):
        step(x, np.zeros(U_SIZE), p, tethers)
    after, _ = momenta(x, p)
    np.testing.assert_allclose(after, linear + np.array([0.0, 0.0, mass * GRAVITY_MPS2 * 2.0]), rtol=1e-9)


def test_inner_forces_give_no_turn():
    """Where gravity is the same for all, the angular momentum changes by the weight's moment alone."""
    p, tethers = lossless()
    x = thrown(2)
    u = np.zeros(U_SIZE)
    dt_s = 1e-4
    moment = np.zeros(3)
    _, before = momenta(x, p)
    for _ in range(5000):
        first = sum(mass * body[B.POS : B.POS + 3] for mass, _, body in bodies(x, p))
        step(x, u, p, tethers, dt_s)
        second = sum(mass * body[B.POS : B.POS + 3] for mass, _, body in bodies(x, p))
        moment += dt_s * np.cross(0.5 * (first + second), [0.0, 0.0, GRAVITY_MPS2])
    _, after = momenta(x, p)
    np.testing.assert_allclose(after - before, moment, atol=1e-6)


def test_damping_only_takes_energy():
    p, tethers = lossless()
    tethers[:, T.DAMPING] = 3.0
    x = thrown(3)
    last = energy(x, p, tethers)
    for _ in range(200):
        for _ in range(10):
            step(x, np.zeros(U_SIZE), p, tethers)
        now = energy(x, p, tethers)
        assert now <= last + 1e-9
        last = now


def test_in_free_fall_the_tethers_are_slack_and_nobody_feels_anything():
    p, tethers = lossless()
    x = hanging()
    still_rotors(x)
    x[B.POS + 2] -= 0.05
    start = x.copy()
    for _ in range(300):
        y, tensions = step(x, np.zeros(U_SIZE), p, tethers)
        assert not tensions.any()
        for c in range(v.CARRIERS):
            assert not y[c * CarrierOutput.SIZE : c * CarrierOutput.SIZE + 3].any()
    fall = 0.5 * GRAVITY_MPS2 * 0.3**2
    assert x[B.POS + 2] - start[B.POS + 2] == pytest.approx(fall)
    assert carrier(x, 0)[B.POS + 2] - carrier(start, 0)[B.POS + 2] == pytest.approx(fall)


def test_statics_of_a_load_that_leans_between_two():
    p, tethers = lossless()
    lean = 0.2
    x, u = hanging(lean), np.zeros(U_SIZE)
    y, tensions, x_dot = np.empty(v.CARRIERS * CarrierOutput.SIZE), np.empty(4), np.empty(x.size)
    cooperative_derivative(x_dot, y, tensions, x, u, p, v.rotors(), tethers)
    np.testing.assert_allclose(x_dot[B.VEL : B.VEL + 3], 0.0, atol=1e-3)
    np.testing.assert_allclose(x_dot[B.RATE : B.RATE + 3], 0.0, atol=1e-6)
    half_n = 0.5 * v.LOAD_MASS_KG * GRAVITY_MPS2
    for c, side in enumerate(v.SIDES):
        at = c * CarrierOutput.SIZE + CarrierOutput.CABLE_FORCE
        # The cable pulls the vehicle towards the load: down, and inwards.
        assert y[at + 2] == pytest.approx(half_n, rel=1e-3)
        assert y[at + 1] == pytest.approx(-side * half_n * math.tan(lean), rel=1e-3)
    assert np.ptp(tensions) < 1e-9


def test_rotors_lift_along_minus_down_and_spins_cancel():
    p, tethers = lossless()
    x = hanging()
    x[B.POS + 2] -= 0.5  # slack
    y, tensions, x_dot = np.empty(v.CARRIERS * CarrierOutput.SIZE), np.empty(4), np.empty(x.size)
    cooperative_derivative(x_dot, y, tensions, x, inputs(x), p, v.rotors(), tethers)
    share_n = (v.MASS_KG + 0.5 * v.LOAD_MASS_KG) * GRAVITY_MPS2
    assert y[CarrierOutput.THRUST] == pytest.approx(share_n)
    np.testing.assert_allclose(y[:3], [0.0, 0.0, -share_n / v.MASS_KG], atol=1e-12)
    np.testing.assert_allclose(y[3:6], [0.0, 0.0, GRAVITY_MPS2 - share_n / v.MASS_KG], atol=1e-12)
    np.testing.assert_allclose(x_dot[FIRST_CARRIER + B.RATE : FIRST_CARRIER + B.RATE + 3], 0.0, atol=1e-12)
    # More thrust on the right side rolls to the left.
    carrier(x, 0)[[C.OMEGA, C.OMEGA + 3]] *= 1.05
    cooperative_derivative(x_dot, y, tensions, x, inputs(x), p, v.rotors(), tethers)
    assert x_dot[FIRST_CARRIER + B.RATE] < 0.0


def test_a_winch_that_shortens_the_front_tethers_lifts_the_nose_to_where_the_triangle_says():
    """Vehicles held in place; the load swings to rest."""
    p, tethers = v.parameters(), v.tethers()
    p[P.MASS] = 1e9
    p[P.LOAD_RATE_DRAG], p[P.LOAD_DRAG] = 0.05, 0.5
    x = hanging(0.0)
    still_rotors(x)
    u = np.zeros(U_SIZE)
    for c in range(v.CARRIERS):
        u[LoadInput.SIZE + c * CarrierInput.SIZE + CarrierInput.WINCH_RATE] = 0.02
        u[LoadInput.SIZE + c * CarrierInput.SIZE + CarrierInput.FORCE + 2] = -1e9 * GRAVITY_MPS2
    for k in range(20000):
        if k == 2000:
            for c in range(v.CARRIERS):
                u[LoadInput.SIZE + c * CarrierInput.SIZE + CarrierInput.WINCH_RATE] = 0.0
        _, tensions = step(x, u, p, tethers)
    assert carrier(x, 0)[C.WINCH] == pytest.approx(0.04)
    pitch = -math.asin(rotation(x[: B.SIZE])[2, 0])
    assert pitch == pytest.approx(v.triangle(v.TETHER_M - 0.04, v.TETHER_M + 0.04).pitch_rad(), abs=math.radians(0.4))
    assert pitch > math.radians(8.0)
    assert (tensions > 0.0).all()
