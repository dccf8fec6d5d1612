"""What the state owes to length and mass, and what the innovation says of them."""

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from core.test_swing_ekf_model import STATES, observation, random_case, scale_of
from swingd.core import swing_ekf as kernels
from swingd.core import swing_ekf_parameters as parameter_kernels
from swingd.core.status import Status
from swingd.core.swing_ekf import GRAVITY_MPS2, NUM_STATES, Scheme
from swingd.core.swing_ekf_parameters import NUM_PARAMETERS, ModelParameter

from .two_point_masses import model

M, ML, L = 1.5, 0.3, 1.5
HOVER = np.array([0.0, 0.0, -(M + ML) * GRAVITY_MPS2])
Q_DIAG = np.array([1e-8, 1e-8, 4e-4, 4e-4, 0.14, 0.14, 0.14])
R_DIAG = np.array([3.6e-3, 3.6e-3, 0.04])
DT_S = 0.0025
OPEN = 1e9
X = np.array([0.3, -0.25, 0.5, 0.4, 0.3, -0.2, 0.1])
P = np.diag([0.01, 0.01, 0.05, 0.05, 0.5, 0.5, 0.5])
V = np.random.default_rng(3).normal(0.0, 0.1, (NUM_STATES, NUM_PARAMETERS))
PUSHED = HOVER + np.array([1.0, -2.0, 0.5])
Z = np.array([0.6, -1.4, 0.3])


def model_of(p):
    """Load and length at these logarithms."""
    return ML * math.exp(p[ModelParameter.PAYLOAD_MASS]), L * math.exp(p[ModelParameter.LENGTH])


CLOSED = -1.0


def step(x, p):
    """Prediction over one step by the filter that is run with these parameters."""
    x_out, P_out, nis = np.empty(7), np.empty((7, 7)), np.empty(1)
    ml, length = model_of(p)
    status = kernels.step(
        x_out, P_out, nis, x, P, PUSHED, Z, Q_DIAG, R_DIAG, DT_S, DT_S, M, ml, length, CLOSED, Scheme.BACKWARD_EULER
    )
    assert status == Status.GATED
    return x_out, P_out


def jacobians(x, u, m, ml, length):
    f_d_p, h_d_p = np.empty((NUM_STATES, NUM_PARAMETERS)), np.empty((3, NUM_PARAMETERS))
    parameter_kernels.parameter_jacobians(f_d_p, h_d_p, x, u, m, ml, length)
    return f_d_p, h_d_p


def learn(p, P_p, x=X, P=P, V=V, z=Z, R=R_DIAG, gate=OPEN):
    """Status, parameters, their covariance and the innovation."""
    p, P_p, nu = p.copy(), P_p.copy(), np.full(3, np.nan)
    status = parameter_kernels.learn(p, P_p, nu, x, P, V, PUSHED, z, R, DT_S, M, ML, L, gate)
    return Status(status), p, P_p, nu


@pytest.mark.parametrize("seed", STATES)
def test_derivatives_of_the_lagrangian_by_length_and_mass(seed):
    x, u, m, ml, length = random_case(seed)
    _, acceleration = scale_of(x, u, m, length)
    f_d_p, h_d_p = jacobians(x, u, m, ml, length)
    step_size = 1e-5
    for parameter, change in (
        (ModelParameter.LENGTH, lambda e: (ml, length * math.exp(e))),
        (ModelParameter.PAYLOAD_MASS, lambda e: (ml * math.exp(e), length)),
    ):
        ahead, behind = change(step_size), change(-step_size)
        f_d = (model().dynamics(x, u, m, *ahead) - model().dynamics(x, u, m, *behind)) / (2 * step_size)
        h_d = (model().observation(x, u, m, *ahead) - model().observation(x, u, m, *behind)) / (2 * step_size)
        np.testing.assert_allclose(f_d_p[:, parameter], f_d, rtol=1e-6, atol=1e-7 * acceleration / length)
        np.testing.assert_allclose(h_d_p[:, parameter], h_d, rtol=1e-6, atol=1e-7 * acceleration)


def test_sensitivity_is_how_the_prediction_changes_with_the_parameters():
    """The derivative of x1(x + V p, p) by differences."""
    x_out, P_out = step(X, (0.0, 0.0))
    V_out = np.empty_like(V)
    status = parameter_kernels.carry_sensitivity(V_out, V, X, x_out, P_out, PUSHED, R_DIAG, DT_S, 1, M, ML, L)
    assert status == Status.OK
    for parameter in ModelParameter:
        p = np.zeros(NUM_PARAMETERS)
        p[parameter] = 1e-5
        ahead, _ = step(X + V @ p, p)
        behind, _ = step(X - V @ p, -p)
        np.testing.assert_allclose(V_out[:, parameter], (ahead - behind) / 2e-5, rtol=1e-5, atol=1e-7)


def test_a_correction_takes_from_the_sensitivity_what_the_measurement_shows():
    """With the gain: V1 = (I - dt (F - K H))^-1 (V + dt (f_p - K h_p)), put together by NumPy."""
    x_out, P_out = step(X, (0.0, 0.0))
    V_out = np.empty_like(V)
    assert (
        parameter_kernels.carry_sensitivity(V_out, V, X, x_out, P_out, PUSHED, R_DIAG, DT_S, 0, M, ML, L) == Status.OK
    )
    F, f = np.empty((7, 7)), np.empty(7)
    kernels.dynamics(f, F, x_out, PUSHED, M, L)
    _, H, _ = observation(x_out, PUSHED, M, ML, L)
    _, H_before, _ = observation(X, PUSHED, M, ML, L)
    f_d_p, h_d_p = jacobians(x_out, PUSHED, M, ML, L)
    K = P_out @ H_before.T / R_DIAG
    expected = np.linalg.solve(np.eye(7) - DT_S * (F - K @ H), V + DT_S * (f_d_p - K @ h_d_p))
    np.testing.assert_allclose(V_out, expected, rtol=1e-10, atol=1e-12)


def test_learning_is_the_parameters_part_of_one_big_filter():
    """Friedland (1969): state and parameters in one Kalman update, whose prior has the covariance that V implies."""
    P_p = np.array([[0.02, 0.005], [0.005, 0.03]])
    p = np.array([0.05, -0.1])
    status, learned, P_learned, nu = learn(p, P_p)
    assert status is Status.OK
    h, H, _ = observation(X, PUSHED, M, ML, L)
    np.testing.assert_allclose(nu, Z - h, rtol=1e-12)
    _, h_d_p = jacobians(X, PUSHED, M, ML, L)
    big_P = np.block([[P + V @ P_p @ V.T, V @ P_p], [P_p @ V.T, P_p]])
    big_H = np.hstack([H, h_d_p])
    S = big_H @ big_P @ big_H.T + np.diag(R_DIAG) / DT_S
    K = big_P @ big_H.T @ np.linalg.inv(S)
    # The state that belongs to p is the filter's plus V p.
    expected = p + (K @ (nu - big_H @ np.concatenate([V @ p, p])))[7:]
    np.testing.assert_allclose(learned, expected, rtol=1e-9)
    np.testing.assert_allclose(P_learned, (big_P - K @ S @ K.T)[7:, 7:], rtol=1e-9)


def test_what_is_exact_stays():
    P_p = np.diag([0.0, 0.02])
    status, learned, P_learned, _ = learn(np.array([0.1, 0.0]), P_p)
    assert status is Status.OK
    assert learned[ModelParameter.LENGTH] == 0.1
    assert learned[ModelParameter.PAYLOAD_MASS] != 0.0
    np.testing.assert_array_equal(P_learned[0], 0.0)


def test_nothing_is_learned_at_rest():
    """Below a hovering vehicle a load that hangs still says nothing of its cable."""
    P_p = np.diag([0.02, 0.0])
    rest, none = np.zeros(7), np.zeros((7, 2))
    p, P_learned, nu = np.zeros(2), P_p.copy(), np.empty(3)
    z = np.array([0.3, -0.2, 0.1])
    assert parameter_kernels.learn(p, P_learned, nu, rest, P, none, HOVER, z, R_DIAG, DT_S, M, ML, L, OPEN) == Status.OK
    np.testing.assert_array_equal(p, 0.0)
    np.testing.assert_array_equal(P_learned, P_p)


def test_an_innovation_that_nothing_explains_is_left_out():
    p, P_p = np.array([0.05, -0.1]), np.diag([0.02, 0.03])
    status, learned, P_learned, nu = learn(p, P_p, z=Z + 500.0, gate=50.0)
    assert status is Status.GATED
    np.testing.assert_array_equal(learned, p)
    np.testing.assert_array_equal(P_learned, P_p)
    assert np.isfinite(nu).all()


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs compiled kernels")
@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    x=hnp.arrays(float, 7, elements=st.floats(allow_nan=True, allow_infinity=True)),
    V=hnp.arrays(float, (7, 2), elements=st.floats(allow_nan=True, allow_infinity=True)),
    z=hnp.arrays(float, 3, elements=st.floats(allow_nan=True, allow_infinity=True)),
)
def test_any_bits_give_a_status_and_what_is_learned_stays_finite(x, V, z):
    p, P_p = np.zeros(2), np.diag([0.02, 0.03])
    status, learned, P_learned, _ = learn(p, P_p, x=x, V=V, z=z)
    assert np.isfinite(learned).all()
    assert np.isfinite(P_learned).all()
    assert (np.diag(P_learned) >= 0.0).all()
    if status is not Status.OK:
        np.testing.assert_array_equal(learned, p)
    V_out = np.empty((7, 2))
    if parameter_kernels.carry_sensitivity(V_out, V, x, x, P, PUSHED, R_DIAG, DT_S, 0, M, ML, L) == Status.OK:
        assert np.isfinite(V_out).all()
