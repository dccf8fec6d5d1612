"""The placed design against an independent state-space model of the same loop, its delay exact."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swingd.control.placed import PlacedDesign, design
from swingd.model.parameters import Autopilot, Cable, Control, Parameters, Payload, Vehicle

G = 9.80665
R, R_RATE, ACC, ACC_RATE, VEL, INTEGRAL, VEL_PC, SLOW = range(8)


def iris(mass_ratio=0.2, cable_m=1.5, autopilot=None, control=None):
    return dataclasses.replace(
        Parameters(),
        vehicle=Vehicle(1.5),
        payload=Payload(1.5 * mass_ratio),
        cable=Cable(cable_m),
        autopilot=autopilot or Autopilot(),
        control=control or Control(),
    )


def loop(parameters: Parameters, found: PlacedDesign):
    """x' = A0 x + A1 x(t - delay), written down from the block diagram.

    r the load ahead of the hook; ACC the horizontal thrust acceleration of the whole mass, second order behind its
    setpoint; VEL the vehicle's velocity; INTEGRAL that of the velocity controller; VEL_PC the velocity correction, a
    leaky integral; SLOW the part of the law that is washed out.
    """
    autopilot, control = parameters.autopilot, parameters.control
    ratio = parameters.payload.mass_kg / parameters.vehicle.mass_kg
    stiffness = G / parameters.cable.length_m
    bandwidth = 1.2 / autopilot.acceleration_delay_s

    def row(**entries):
        return np.array(
            [entries.get(name, 0.0) for name in ("r", "r_rate", "acc", "acc_rate", "vel", "i", "pc", "slow")]
        )

    vehicle_acc = row(acc=1.0 + ratio, r=ratio * stiffness)
    law = row(r=found.kp_per_s2, r_rate=found.kd_per_s)
    error = row(pc=1.0, vel=-1.0)
    acc_pc = row(slow=-1.0)  # and the law, late
    acc_sp = autopilot.velocity_p * error + row(i=autopilot.velocity_i) - autopilot.velocity_d * vehicle_acc + acc_pc
    A0, A1 = np.zeros((8, 8)), np.zeros((8, 8))
    A0[R] = row(r_rate=1.0)
    A0[R_RATE] = row(r=-stiffness) - vehicle_acc
    A0[ACC] = row(acc_rate=1.0)
    A0[ACC_RATE] = bandwidth**2 * (acc_sp - row(acc=1.0)) - 1.2 * bandwidth * row(acc_rate=1.0)
    A1[ACC_RATE] = bandwidth**2 * law
    A0[VEL] = vehicle_acc
    A0[INTEGRAL] = error
    A0[VEL_PC] = row(pc=-1.0 / control.velocity_leak_s) + acc_pc
    A1[VEL_PC] = law
    A0[SLOW] = row(slow=-1.0 / control.washout_s)
    A1[SLOW] = law / control.washout_s
    return A0, A1, control.delay_s


def characteristic(A0, A1, delay_s, s):
    return s * np.eye(8) - A0 - A1 * np.exp(-s * delay_s)


def spectrum(A0, A1, delay_s, nodes=8):
    """Rightmost eigenvalues of the delay system by Chebyshev collocation of its generator."""
    if delay_s < 1e-4:
        return np.linalg.eigvals(A0 + A1)
    x = np.cos(np.pi * np.arange(nodes + 1) / nodes)
    weights = np.array([2.0, *[1.0] * (nodes - 1), 2.0]) * (-1.0) ** np.arange(nodes + 1)
    differences = x[:, None] - x[None, :] + np.eye(nodes + 1)
    D = np.outer(weights, 1.0 / weights) / differences
    D -= np.diag(D.sum(axis=1))
    # The interval [-delay, 0] has length delay, [-1, 1] has 2; node 0 is now, the last one the delay ago.
    generator = np.kron(2.0 / delay_s * D, np.eye(8))
    generator[:8] = 0.0
    generator[:8, :8] = A0
    generator[:8, -8:] = A1
    return np.linalg.eigvals(generator)


def simulate(A0, A1, delay_s, history, duration_s, steps_per_delay=10):
    """Method of steps: classical Runge-Kutta, the delayed state by cubic Hermite interpolation of the past."""
    n, h = steps_per_delay, delay_s / steps_per_delay
    # One step more of the past than the delay: the slope at its oldest point is a central difference.
    states = [history(k * h) for k in range(-n - 1, 1)]
    for _ in range(round(duration_s / h)):
        before, late0, late1, after = states[-n - 2], states[-n - 1], states[-n], states[-n + 1]
        middle = 0.5 * (late0 + late1) + 0.0625 * ((late1 - before) - (after - late0))
        x = states[-1]
        k1 = A0 @ x + A1 @ late0
        k2 = A0 @ (x + 0.5 * h * k1) + A1 @ middle
        k3 = A0 @ (x + 0.5 * h * k2) + A1 @ middle
        k4 = A0 @ (x + h * k3) + A1 @ late1
        states.append(x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))
    return h, np.array(states[n + 1 :])


def no_gains(found: PlacedDesign) -> PlacedDesign:
    return dataclasses.replace(found, kp_per_s2=0.0, kd_per_s=0.0)


def pole_of(damping_ratio, frequency_radps):
    return frequency_radps * complex(-damping_ratio, math.sqrt(1.0 - damping_ratio**2))


CASES = {
    "iris": iris(),
    "light on a long cable": iris(0.05, 10.0),
    "heavy": iris(1.0, 3.0),
    "short cable": iris(0.2, 0.5),
    "slow estimate": iris(control=Control(delay_s=0.1)),
    "slow autopilot": iris(autopilot=Autopilot(acceleration_delay_s=0.25)),
    "more damping": iris(control=Control(damping_ratio=0.7, frequency_ratio=1.1)),
}


@pytest.mark.parametrize("name", CASES)
def test_promised_poles_are_poles_of_the_loop(name):
    parameters = CASES[name]
    found = design(parameters)
    A0, A1, delay_s = loop(parameters, found)
    swing = pole_of(found.damping_ratio, found.frequency_radps)
    matrix = characteristic(A0, A1, delay_s, swing)
    assert np.linalg.svd(matrix, compute_uv=False)[-1] < 1e-9 * np.linalg.norm(matrix)
    eigenvalues = spectrum(A0, A1, delay_s)
    assert np.abs(eigenvalues - swing).min() < 1e-6
    assert eigenvalues.real.max() < 0.0
    off = np.linalg.eigvals(loop(parameters, no_gains(found))[0])
    assert np.abs(off - pole_of(found.damping_ratio_off, found.frequency_off_radps)).min() < 1e-6


@pytest.mark.parametrize("name", ["iris", "light on a long cable", "more damping"])
def test_where_it_can_be_had_the_wanted_pole_is_placed(name):
    parameters = CASES[name]
    found = design(parameters)
    assert found.damping_ratio == pytest.approx(parameters.control.damping_ratio)
    assert found.frequency_radps == pytest.approx(parameters.control.frequency_ratio * found.frequency_off_radps)
    swing = pole_of(found.damping_ratio, found.frequency_radps)
    assert min(abs(pole - swing) for pole in found.poles) < 1e-3


@pytest.mark.parametrize("name", CASES)
def test_reported_poles_are_those_of_the_exact_loop(name):
    """All that matter: no faster than three times the swing."""
    parameters = CASES[name]
    found = design(parameters)
    eigenvalues = spectrum(*loop(parameters, found))
    for pole in found.poles:
        if abs(pole) < 3.0 * found.frequency_radps:
            assert np.abs(eigenvalues - pole).min() < 0.01 * abs(pole)


def test_the_iris_without_correction():
    """Real PX4, 1.5 kg, 0.3 kg on 1.5 m: period 2.33 s, damping ratio 0.06; the model says 2.31 s and 0.051."""
    found = design(iris())
    assert 2.0 * math.pi / found.frequency_off_radps == pytest.approx(2.31, abs=0.01)
    assert found.damping_ratio_off == pytest.approx(0.051, abs=0.001)
    h, states = simulate(*loop(iris(), no_gains(found)), lambda t: np.eye(8)[R], 14.0)
    r = states[:, R]
    peaks = np.flatnonzero((r[1:-1] > r[:-2]) & (r[1:-1] > r[2:])) + 1
    period_s = np.diff(peaks).mean() * h
    decrement = math.log(r[peaks[0]] / r[peaks[-1]]) / (len(peaks) - 1)
    damped = 2.0 * math.pi / math.sqrt((2.0 * math.pi) ** 2 + decrement**2)
    assert period_s * damped == pytest.approx(2.31, abs=0.02)
    assert decrement / (2.0 * math.pi) * damped == pytest.approx(0.051, abs=0.004)


@pytest.mark.parametrize("name", CASES)
def test_the_swings_mode_decays_with_the_promised_damping(name):
    """Started on the mode, the simulated loop with its exact delay stays on it: frequency and damping as promised."""
    parameters = CASES[name]
    found = design(parameters)
    A0, A1, delay_s = loop(parameters, found)
    swing = pole_of(found.damping_ratio, found.frequency_radps)
    mode = np.linalg.svd(characteristic(A0, A1, delay_s, swing))[2][-1].conj()
    mode /= mode[R]
    duration_s = 2.0 * 2.0 * math.pi / found.frequency_radps
    h, states = simulate(A0, A1, delay_s, lambda t: (mode * np.exp(swing * t)).real, duration_s)
    promised = np.exp(swing * np.arange(len(states)) * h).real
    np.testing.assert_allclose(states[:, R], promised, atol=2e-3)


def test_a_swing_from_rest_dies_within_a_period():
    found = design(iris())

    def history(t):
        """The correction begins at t = 0: nothing is known of the past."""
        return np.eye(8)[R] * (t >= 0.0)

    h, states = simulate(*loop(iris(), found), history, 8.0)
    one_period = round(2.0 * math.pi * math.sqrt(1.5 / G) / h)
    assert np.abs(states[one_period:, R]).max() < 0.1
    _, off = simulate(*loop(iris(), no_gains(found)), history, 8.0)
    assert np.abs(off[one_period:, R]).max() > 0.6


def promise_holds(parameters: Parameters) -> PlacedDesign:
    """What a design says of itself, and what the exact loop says of it."""
    found = design(parameters)
    assert all(math.isfinite(value) for value in dataclasses.astuple(found)[:6])
    assert all(math.isfinite(abs(pole)) for pole in found.poles)
    if found.kd_per_s == 0.0:
        assert found.kp_per_s2 == 0.0
        assert found.damping_ratio == found.damping_ratio_off
        assert found.frequency_radps == found.frequency_off_radps
    else:
        assert found.kd_per_s > 0.0
        assert found.damping_ratio > found.damping_ratio_off
        assert max(pole.real for pole in found.poles) < 0.0
    return found


@pytest.mark.parametrize("mass_ratio", [0.01, 0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("cable_m", [0.5, 1.0, 2.0, 5.0, 15.0, 50.0])
def test_every_plausible_vehicle_is_damped_or_left_alone(mass_ratio, cable_m):
    helped = []
    for acceleration_delay_s in (0.05, 0.1, 0.15, 0.2, 0.3, 0.4):
        parameters = iris(mass_ratio, cable_m, Autopilot(acceleration_delay_s=acceleration_delay_s))
        found = promise_holds(parameters)
        helped.append(found.kd_per_s > 0.0)
        if helped[-1]:
            A0, A1, delay_s = loop(parameters, found)
            on, off = spectrum(A0, A1, delay_s), np.linalg.eigvals(A0)
            assert on.real.max() < 0.0
            # Far out the collocation has eigenvalues that the loop has not.
            on = on[np.abs(on) < 60.0]
            assert (-on.real / np.abs(on)).min() > (-off.real / np.abs(off)).min()
    # Up to 0.1 s, PX4's own, every one of them is helped.
    assert all(helped[:2])


@pytest.mark.parametrize("cable_m", [2.0, 5.0, 10.0, 12.0, 20.0, 50.0])
def test_a_damped_velocity_loop_of_the_same_frequency_is_not_taken_for_the_swing(cable_m):
    copter = Autopilot(velocity_p=2.0, velocity_i=1.0, velocity_d=0.25)
    found = design(iris(1.0 / 3.0, cable_m, copter))
    assert found.damping_ratio_off < 0.3
    assert found.damping_ratio > found.damping_ratio_off + 0.2
    assert found.kd_per_s > 0.0


def test_a_loop_that_cannot_be_helped_is_left_alone():
    """Half a metre of cable below an autopilot that answers after 0.4 s."""
    found = design(iris(0.2, 0.5, Autopilot(acceleration_delay_s=0.4)))
    assert (found.kp_per_s2, found.kd_per_s) == (0.0, 0.0)
    assert found.damping_ratio == found.damping_ratio_off


@pytest.mark.parametrize("delay_s", [0.0, 1e-12, 1e-6, 9e-5, 1.1e-4])
def test_tiny_delays_are_none(delay_s):
    found = design(iris(control=Control(delay_s=delay_s)))
    none = design(iris(control=Control(delay_s=0.0)))
    assert found.kp_per_s2 == pytest.approx(none.kp_per_s2, rel=2e-3)
    assert found.kd_per_s == pytest.approx(none.kd_per_s, rel=2e-3)
    assert found.damping_ratio == pytest.approx(0.5)


def within_bounds(kind, *names):
    """Anything that the declared parameters may hold, the bounds among them."""
    declared = {field.name: field for field in dataclasses.fields(kind)}
    strategies = {}
    for name in names or [n for n, f in declared.items() if isinstance(f.default, float)]:
        low, high = declared[name].metadata["low"], declared[name].metadata["high"]
        strategies[name] = st.floats(low, high) | st.sampled_from([low, high])
    return st.builds(kind, **strategies)


@settings(max_examples=250, deadline=None, derandomize=True)
@given(
    vehicle=within_bounds(Vehicle, "mass_kg"),
    payload=within_bounds(Payload),
    cable=within_bounds(Cable),
    autopilot=within_bounds(Autopilot),
    control=within_bounds(Control),
)
def test_no_parameter_within_its_bounds_raises(vehicle, payload, cable, autopilot, control):
    promise_holds(
        dataclasses.replace(
            Parameters(), vehicle=vehicle, payload=payload, cable=cable, autopilot=autopilot, control=control
        )
    )
