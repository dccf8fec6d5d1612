"""One step of the filter: order, numerical damping, gate, statuses, whatever bits come in."""

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.integrate import solve_ivp

from swingd.core import linalg
from swingd.core import swing_ekf as kernels
from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2, Scheme

M, ML, L = 2.0, 0.192, 1.9
"""The vehicle of Drones 2023, section 4.2."""
OMEGA2 = GRAVITY_MPS2 / L * (M + ML) / M
HOVER = np.array([0.0, 0.0, -(M + ML) * GRAVITY_MPS2])
Q_DIAG = np.array([1e-8, 1e-8, 4e-4, 4e-4, 0.25, 0.25, 0.25])
R_DIAG = np.array([3.6e-3, 3.6e-3, 0.04])
P_START = np.diag([0.16, 0.16, 1.0, 1.0, 9.0, 9.0, 9.0])
OPEN, CLOSED = 1e9, -1.0
JIT = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs compiled kernels")


def step(x, P, u, z, dt_s, gate=OPEN, scheme=Scheme.BACKWARD_EULER, interval_s=None):
    """Status, x, P and NIS after one step."""
    x_out, P_out, nis = np.empty(7), np.empty((7, 7)), np.full(1, np.nan)
    interval_s = dt_s if interval_s is None else interval_s
    status = kernels.step(x_out, P_out, nis, x, P, u, z, Q_DIAG, R_DIAG, dt_s, interval_s, M, ML, L, gate, int(scheme))
    return Status(status), x_out, P_out, nis[0]


def dynamics(x, u):
    f, F = np.empty(7), np.empty((7, 7))
    kernels.dynamics(f, F, x, u, M, L)
    return f, F


def observation(x, u):
    h, H = np.empty(3), np.empty((3, 7))
    kernels.observation(h, H, x, u, M, ML, L)
    return h, H


SWINGING = np.array([0.5, -0.4, 0.8, 0.6, 0.3, -0.2, 0.1])
PUSHED = HOVER + np.array([1.0, -2.0, 0.5])


@pytest.mark.parametrize(
    ("scheme", "order"), [(Scheme.BACKWARD_EULER, 1), (Scheme.IMPLICIT_MIDPOINT, 2), (Scheme.RK4, 4)]
)
def test_order_of_the_mean(scheme, order):
    duration = 1.0
    exact = solve_ivp(
        lambda _t, x: dynamics(x, PUSHED)[0], (0.0, duration), SWINGING, method="DOP853", rtol=1e-12, atol=1e-13
    ).y[:, -1]
    errors = []
    for steps in (50, 100, 200):
        x, P = SWINGING, P_START
        for _ in range(steps):
            status, x, P, _ = step(x, P, PUSHED, np.zeros(3), duration / steps, CLOSED, scheme)
            assert status is Status.GATED
        errors.append(np.abs(x - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, order, atol=0.15)


@pytest.mark.parametrize("dt_s", [0.0025, 0.01, 0.02])
def test_backward_euler_damps_by_omega2_dt_over_2(dt_s):
    damping_per_s = small_swing_damping(dt_s, Scheme.BACKWARD_EULER)
    assert damping_per_s == pytest.approx(0.5 * OMEGA2 * dt_s, rel=0.01)


def test_numerical_damping_of_the_papers_flight():
    """0.028 1/s for 2 kg, 0.192 kg, 1.9 m at 100 Hz."""
    assert small_swing_damping(0.01, Scheme.BACKWARD_EULER) == pytest.approx(0.028, abs=5e-4)


def test_implicit_midpoint_and_rk4_do_not_damp():
    assert small_swing_damping(0.01, Scheme.IMPLICIT_MIDPOINT) == pytest.approx(0.0, abs=1e-5)
    assert small_swing_damping(0.01, Scheme.RK4) == pytest.approx(0.0, abs=1e-5)


def small_swing_damping(dt_s, scheme):
    """Decay of the amplitude of a predicted swing of 0.6 deg [1/s]."""
    x, P = np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), P_START
    steps = round(4.0 / dt_s)
    for _ in range(steps):
        _, x, P, _ = step(x, P, HOVER, np.zeros(3), dt_s, CLOSED, scheme)
    return -math.log(math.hypot(x[0], x[2] / math.sqrt(OMEGA2)) / 0.01) / (steps * dt_s)


@pytest.mark.parametrize("scheme", list(Scheme))
def test_corrected_step_solves_its_equation(scheme):
    """(10) with K = P H^T R^-1 of the step's end: exactly for the implicit schemes, to the fourth order for RK4."""
    z = np.array([0.4, -0.3, 0.2])
    dt_s = 0.001
    status, x, P, _ = step(SWINGING, P_START, PUSHED, z, dt_s, scheme=scheme)
    assert status is Status.OK
    _, H = observation(SWINGING, PUSHED)
    K = P @ H.T / R_DIAG

    def rate(at):
        return dynamics(at, PUSHED)[0] + K @ (z - observation(at, PUSHED)[0])

    if scheme is Scheme.BACKWARD_EULER:
        np.testing.assert_allclose(x, SWINGING + dt_s * rate(x), rtol=1e-9, atol=1e-10)
    elif scheme is Scheme.IMPLICIT_MIDPOINT:
        np.testing.assert_allclose(x, SWINGING + dt_s * rate(0.5 * (x + SWINGING)), rtol=1e-9, atol=1e-10)
    else:
        exact = solve_ivp(lambda _t, at: rate(at), (0.0, dt_s), SWINGING, rtol=1e-11, atol=1e-12).y[:, -1]
        euler_error = np.abs(SWINGING + dt_s * rate(SWINGING) - exact).max()
        assert np.abs(x - exact).max() < 0.01 * euler_error


def test_covariance_is_the_riccati_step_at_the_start_whatever_the_scheme():
    """The implicit midpoint of the covariance would be indefinite after a reset: it is not offered."""
    dt_s = 0.01
    _, F = dynamics(SWINGING, PUSHED)
    _, H = observation(SWINGING, PUSHED)
    S = np.ascontiguousarray(H.T / R_DIAG @ H)
    expected = np.empty((7, 7))
    assert linalg.riccati_backward_euler(expected, P_START, F, S, np.diag(Q_DIAG), dt_s) == Status.OK
    half = np.empty((7, 7))
    assert linalg.riccati_backward_euler(half, P_START, F, S, np.diag(Q_DIAG), 0.5 * dt_s) == Status.OK
    assert np.linalg.eigvalsh(2.0 * half - P_START).min() < 0.0
    for scheme in Scheme:
        _, _, P, _ = step(SWINGING, P_START, PUSHED, np.zeros(3), dt_s, scheme=scheme)
        np.testing.assert_allclose(P, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("interval_s", [0.01, 0.04])
def test_nis_is_that_of_the_interval_at_its_start(interval_s):
    z = np.array([0.7, -0.4, 0.5])
    h, H = observation(SWINGING, PUSHED)
    covariance = H @ P_START @ H.T + np.diag(R_DIAG) / interval_s
    expected = (z - h) @ np.linalg.solve(covariance, z - h)
    _, _, _, nis = step(SWINGING, P_START, PUSHED, z, 0.01, interval_s=interval_s)
    assert nis == pytest.approx(expected, rel=1e-10)


def test_gate_is_the_nis():
    z = np.array([3.0, -2.0, 1.0])
    nis = step(SWINGING, P_START, PUSHED, z, 0.01)[3]
    assert step(SWINGING, P_START, PUSHED, z, 0.01, gate=1.001 * nis)[0] is Status.OK
    assert step(SWINGING, P_START, PUSHED, z, 0.01, gate=0.999 * nis)[0] is Status.GATED


@pytest.mark.parametrize("scheme", list(Scheme))
def test_gated_step_is_the_prediction_alone(scheme):
    outlier, silence = np.array([1e3, -1e3, 1e3]), np.zeros(3)
    status, x, P, _ = step(SWINGING, P_START, PUSHED, outlier, 0.01, gate=10.0, scheme=scheme)
    assert status is Status.GATED
    _, x_other, P_other, _ = step(SWINGING, P_START, PUSHED, silence, 0.01, gate=CLOSED, scheme=scheme)
    np.testing.assert_array_equal(x, x_other)
    np.testing.assert_array_equal(P, P_other)
    _, F = dynamics(SWINGING, PUSHED)
    rebuilt = P_START + 0.01 * (F @ P + P @ F.T + np.diag(Q_DIAG))
    np.testing.assert_allclose(P, rebuilt, rtol=1e-9, atol=1e-12)


def test_covariance_shrinks_where_it_is_measured_and_stays_positive():
    _, _, P, _ = step(SWINGING, P_START, PUSHED, np.zeros(3), 0.01)
    assert np.linalg.eigvalsh(P).min() > 0.0
    # What is measured at once is the force; the angles follow through it.
    assert (np.diag(P)[4:] < 0.8 * np.diag(P_START)[4:]).all()


BAD_ARGUMENTS = [
    ("x", math.nan, Status.NOT_POSITIVE),
    ("P", math.nan, Status.NOT_POSITIVE),
    ("u", math.inf, Status.NOT_POSITIVE),
    ("z", math.nan, Status.NOT_FINITE),
    ("z", -math.inf, Status.NOT_FINITE),
]


@pytest.mark.parametrize(("which", "bad", "answer"), BAD_ARGUMENTS)
def test_what_is_not_finite_is_answered_and_the_inputs_stand(which, bad, answer):
    arguments = {"x": SWINGING.copy(), "P": P_START.copy(), "u": PUSHED.copy(), "z": np.zeros(3)}
    arguments[which].flat[-1] = bad
    before = {name: array.copy() for name, array in arguments.items()}
    status, _, _, _ = step(**arguments, dt_s=0.01)
    assert status is answer
    for name, array in arguments.items():
        np.testing.assert_array_equal(array, before[name])


@pytest.mark.parametrize("dt_s", [0.0, -0.01, math.nan])
def test_an_impossible_interval_is_answered(dt_s):
    status, _, _, _ = step(SWINGING, P_START, PUSHED, np.zeros(3), dt_s)
    assert status not in (Status.OK, Status.GATED)


ANY = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, -0.0, 1e-308, 1e308, 5e-324, math.pi / 2])


@JIT
@settings(max_examples=400, deadline=None, derandomize=True)
@given(
    x=hnp.arrays(float, 7, elements=ANY),
    P=hnp.arrays(float, (7, 7), elements=ANY) | st.just(P_START),
    u=hnp.arrays(float, 3, elements=ANY),
    z=hnp.arrays(float, 3, elements=ANY),
    noise=hnp.arrays(float, 10, elements=ANY) | st.just(np.concatenate([Q_DIAG, R_DIAG])),
    scalars=hnp.arrays(float, 6, elements=ANY) | st.just(np.array([0.01, 0.01, M, ML, L, 50.0])),
    scheme=st.sampled_from(list(Scheme)),
)
def test_no_bits_raise_and_what_is_ok_is_finite(x, P, u, z, noise, scalars, scheme):
    x_out, P_out, nis = np.empty(7), np.empty((7, 7)), np.empty(1)
    status = kernels.step(
        x_out, P_out, nis, x, P, u, z, noise[:7].copy(), noise[7:].copy(), *scalars.tolist(), int(scheme)
    )
    if Status(status) in (Status.OK, Status.GATED):
        assert np.isfinite(x_out).all()
        assert np.isfinite(P_out).all()
        assert (np.diag(P_out) > 0.0).all()


@JIT
@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    x=hnp.arrays(float, 7, elements=st.floats(-1.4, 1.4)),
    u=hnp.arrays(float, 3, elements=st.floats(-1e4, 1e4)),
    z=hnp.arrays(float, 3, elements=st.floats(-1e4, 1e4)),
    scheme=st.sampled_from(list(Scheme)),
)
def test_wild_but_finite_inputs_leave_a_positive_covariance_or_a_status(x, u, z, scheme):
    status, x_out, P_out, _ = step(x, P_START, u, z, 0.0025, scheme=scheme)
    if status is Status.OK:
        assert np.isfinite(x_out).all()
        unit = np.sqrt(np.outer(np.diag(P_out), np.diag(P_out)))
        assert np.linalg.eigvalsh(P_out / unit).min() > -1e-9


@JIT
@pytest.mark.parametrize("position", range(9))
def test_single_precision_is_refused(position):
    arguments = [np.zeros(7), np.zeros((7, 7)), np.zeros(1), np.zeros(7), P_START, HOVER, np.zeros(3), Q_DIAG, R_DIAG]
    arguments[position] = arguments[position].astype(np.float32)
    with pytest.raises(TypeError, match="No matching definition"):
        kernels.step(*arguments, 0.01, 0.01, M, ML, L, 50.0, 0)


@JIT
@pytest.mark.parametrize("position", range(9))
def test_strided_arrays_are_refused(position):
    arguments = [np.zeros(7), np.zeros((7, 7)), np.zeros(1), np.zeros(7), P_START, HOVER, np.zeros(3), Q_DIAG, R_DIAG]
    array = arguments[position]
    spaced = np.zeros((*array.shape[:-1], 2 * array.shape[-1] + 2))
    arguments[position] = spaced[..., : 2 * array.shape[-1] : 2]
    if array.size == 1:
        arguments[position] = np.zeros((2, 2))[:, ::2][:, 0]
    with pytest.raises(TypeError, match="No matching definition"):
        kernels.step(*arguments, 0.01, 0.01, M, ML, L, 50.0, 0)
