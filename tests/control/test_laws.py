"""The laws take energy out of the swing on both axes, wherever it starts and wherever the nose points."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from swingd.control import PayloadLaw, PlacedLaw, make_law
from swingd.control.base import Vec2
from swingd.core.level import swing_in_heading
from swingd.model.parameters import Cable, Control, Parameters

G = 9.80665
LENGTH_M = 1.5
PERIOD_S = 2.0 * math.pi * math.sqrt(LENGTH_M / G)
DT_S = 0.01
SIGNS = list(itertools.product((-1.0, 1.0), repeat=4))
YAWS_DEG = range(0, 360, 45)
LAWS = ["placed", "payload"]


def parameters(law):
    return dataclasses.replace(Parameters(), cable=Cable(LENGTH_M), control=Control(law=law))


class PaperLaw(PayloadLaw):
    """Drones 2023 (16) as printed: a plus in both rows."""

    def acceleration(self, direction: Vec2, rate_per_s: Vec2) -> Vec2:
        forward, right = super().acceleration(direction, rate_per_s)
        return forward, -right


def turn(vector, angle_rad):
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]


def energies(n, v):
    """Of the forward and right motion of the load, level frame [1/s^2]."""
    return 0.5 * v[:2] ** 2 + 0.5 * G / LENGTH_M * n[:2] ** 2


def swing(law, state, duration_s, yaw_rad=0.0, yaw_rate_radps=0.0):
    """A spherical pendulum below a vehicle that accelerates as the law wants; energies at each step.

    ``state`` is xi, zeta and their rates in the level frame; the law sees what the estimator's kernel would give it.
    """
    angles, vector = np.empty(6), np.empty(4)
    xi, zeta, xi_rate, zeta_rate = state
    n = np.array([math.sin(zeta), -math.sin(xi) * math.cos(zeta), math.cos(xi) * math.cos(zeta)])
    v = np.array(
        [
            math.cos(zeta) * zeta_rate,
            -math.cos(xi) * math.cos(zeta) * xi_rate + math.sin(xi) * math.sin(zeta) * zeta_rate,
            -math.sin(xi) * math.cos(zeta) * xi_rate - math.cos(xi) * math.sin(zeta) * zeta_rate,
        ]
    )
    history = [energies(n, v)]
    for k in range(round(duration_s / DT_S)):
        yaw = yaw_rad + yaw_rate_radps * k * DT_S
        xi, zeta = math.atan2(-n[1], n[2]), math.asin(n[0])
        across2 = n[1] ** 2 + n[2] ** 2
        rates = ((n[1] * v[2] - n[2] * v[1]) / across2, v[0] / math.sqrt(across2))
        x = np.array([xi, zeta, *rates])
        swing_in_heading(angles, vector, x, np.zeros(4), np.zeros((2, 2)), 0.0, yaw, yaw_rate_radps)
        a_x, a_y = turn(law.acceleration(turn(vector[:2], -yaw), turn(vector[2:], -yaw)), yaw)
        pull = np.array([-a_x, -a_y, G]) / LENGTH_M

        def rate(n, v, pull=pull):
            return pull - (pull @ n) * n - (v @ v) * n

        middle_n, middle_v = n + 0.5 * DT_S * v, v + 0.5 * DT_S * rate(n, v)
        n, v = n + DT_S * middle_v, v + DT_S * rate(middle_n, middle_v)
        n /= np.linalg.norm(n)
        v -= (v @ n) * n
        history.append(energies(n, v))
    return np.array(history)


def state_of(signs, size_rad=0.1):
    """Each angle and each rate with its sign, the rates of a like size."""
    omega = math.sqrt(G / LENGTH_M)
    return np.array(signs) * size_rad * np.array([1.0, 0.8, 0.7 * omega, 1.1 * omega])


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("yaw_deg", YAWS_DEG)
def test_both_axes_lose_energy_from_every_sign_in_every_heading(name, yaw_deg):
    law = make_law(parameters(name))
    for signs in SIGNS:
        history = swing(law, state_of(signs), PERIOD_S, math.radians(yaw_deg))
        assert (history[-1] < 0.1 * history[0]).all(), signs


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("angle", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_one_axis_alone(name, angle, sign):
    """A swing about one axis is damped and does not wake the other."""
    law = make_law(parameters(name))
    state = np.zeros(4)
    state[angle] = 0.15 * sign
    history = swing(law, state, PERIOD_S)
    axis = 1 - angle  # xi moves the load right and left, zeta forward and back
    assert history[-1, axis] < 0.1 * history[0, axis]
    assert history[:, 1 - axis].max() < 1e-20


@pytest.mark.parametrize("name", LAWS)
def test_a_large_swing_loses_energy_too(name):
    law = make_law(parameters(name))
    for signs in SIGNS:
        history = swing(law, state_of(signs, 0.5), 2.0 * PERIOD_S, math.radians(30.0))
        assert (history[-1] < 0.05 * history[0].sum()).all(), signs


def test_without_a_law_nothing_is_lost():
    """The test's pendulum keeps its energy: what the other tests see is the law's work."""
    none = PayloadLaw(
        dataclasses.replace(Parameters(), control=Control(payload_kp_mps2_per_rad=0.0, payload_kd_mps2_per_radps=0.0))
    )
    history = swing(none, state_of((1.0, 1.0, -1.0, 1.0)), PERIOD_S).sum(axis=1)
    np.testing.assert_allclose(history, history[0], rtol=0.02)


@pytest.mark.parametrize("signs", SIGNS)
def test_the_sign_that_the_paper_prints_drives_the_lateral_swing(signs):
    """Erratum 2."""
    history = swing(PaperLaw(parameters("payload")), 0.1 * state_of(signs), PERIOD_S)
    assert history[-1, 0] < 0.1 * history[0, 0]
    assert history[-1, 1] > 3.0 * history[0, 1]


@pytest.mark.parametrize("name", LAWS)
def test_a_turning_vehicle_damps_as_well(name):
    law = make_law(parameters(name))
    for yaw_rate_radps in (-2.0, 1.0):
        history = swing(law, state_of((1.0, -1.0, 1.0, 1.0)), PERIOD_S, 0.3, yaw_rate_radps)
        assert (history[-1] < 0.1 * history[0]).all()


@pytest.mark.parametrize("name", LAWS)
def test_a_load_that_stands_still_in_the_level_frame_has_no_rate_to_answer(name):
    """Yawing at 1 rad/s beside it asks for what its place alone asks for."""
    law = make_law(parameters(name))
    answers = []
    for yaw_rate_radps in (0.0, 1.0):
        angles, vector = np.empty(6), np.empty(4)
        x = np.array([0.1, 0.2, 0.0, 0.0])
        swing_in_heading(angles, vector, x, np.zeros(4), np.zeros((2, 2)), 0.0, 0.5, yaw_rate_radps)
        answers.append(law.acceleration(turn(vector[:2], -0.5), turn(vector[2:], -0.5)))
    assert answers[0] == answers[1]
    # Hanging straight down it asks for nothing at all.
    np.testing.assert_array_equal(law.acceleration((0.0, 0.0), (0.0, 0.0)), 0.0)


@pytest.mark.parametrize("name", LAWS)
def test_signs_in_words(name):
    """Load ahead, or moving forward: accelerate forward, after it. Load to the right: accelerate to the right."""
    law = make_law(parameters(name))
    for axis in (0, 1):
        unit = tuple(1.0 if i == axis else 0.0 for i in range(2))
        small = tuple(0.05 * component for component in unit)
        for direction, rate in ((small, (0.0, 0.0)), ((0.0, 0.0), small)):
            answer = law.acceleration(direction, rate)
            assert answer[axis] > 0.0
            assert answer[1 - axis] == pytest.approx(0.0, abs=1e-15)


def test_payload_law_is_equation_16_with_the_lateral_sign_that_damps():
    law = PayloadLaw(parameters("payload"))
    xi, zeta, xi_rate, zeta_rate = 0.3, -0.2, 0.9, -1.1
    angles, vector = np.empty(6), np.empty(4)
    x = np.array([xi, zeta, xi_rate, zeta_rate])
    swing_in_heading(angles, vector, x, np.zeros(4), np.zeros((2, 2)), 0.0, 0.0, 0.0)
    a_x, a_y = law.acceleration(tuple(vector[:2]), tuple(vector[2:]))
    kp, kd = Control().payload_kp_mps2_per_rad, Control().payload_kd_mps2_per_radps
    assert a_x == pytest.approx(kd * zeta_rate + kp * zeta)
    assert a_y == pytest.approx(-(kd * xi_rate + kp * xi))


def test_placed_law_is_linear_in_the_loads_displacement():
    law = PlacedLaw(parameters("placed"))
    kp, kd = law.design.kp_per_s2 * LENGTH_M, law.design.kd_per_s * LENGTH_M
    expected = (kp * 0.1 + kd * 0.3, kp * -0.2 + kd * 0.4)
    np.testing.assert_allclose(law.acceleration((0.1, -0.2), (0.3, 0.4)), expected, rtol=1e-12)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("size", [1.0, 1.5, 1e9, math.inf])
def test_no_direction_raises(name, size):
    """A unit vector's horizontal part is at most 1; a rounding error, or nonsense, is answered all the same."""
    law = make_law(parameters(name))
    for direction in ((size, 0.0), (0.0, -size), (size, size)):
        assert len(law.acceleration(direction, (1.0, -1.0))) == 2


def test_make_law_takes_the_name():
    assert isinstance(make_law(parameters("placed")), PlacedLaw)
    assert isinstance(make_law(parameters("payload")), PayloadLaw)
