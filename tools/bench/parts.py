"""The codec and the filter."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from pymavlink.dialects.v20 import common as mavlink
from scipy.linalg import solve_continuous_are

from swingd.core import swing_ekf as kernels
from swingd.core.status import Status
from swingd.link.codec import Codec

from .result import Result, cost, quickest

FloatArray = npt.NDArray[np.float64]

# The model's formulas as the interpreter runs them: numba keeps them behind a kernel, unless it is switched off.
_dynamics: Callable[..., None] = getattr(kernels.dynamics, "py_func", kernels.dynamics)
_observation: Callable[..., float] = getattr(kernels.observation, "py_func", kernels.observation)


def bench_codec(count: int) -> Result:
    """Parse a stream of HIGHRES_IMU as it arrives, a frame at a time."""
    sender = Codec(1, 1)
    fields = (0.1, -0.2, -9.8, 0.01, 0.02, -0.03, 0.2, 0.0, 0.4, 950.0, 0.0, 488.0, 15.0, 63)
    frames = [sender.encode(mavlink.MAVLink_highres_imu_message(4000 * k, *fields)) for k in range(count)]

    def own() -> float:
        codec = Codec(255, 190)
        return sum((float(frame.message.zacc) for raw in frames for frame in codec.receive(raw)), 0.0)

    def theirs() -> float:
        parser = mavlink.MAVLink(None)
        return sum((float(message.zacc) for raw in frames for message in parser.parse_buffer(raw) or ()), 0.0)

    assert own() == theirs()
    own_s, their_s = quickest(own, theirs)
    return cost("codec: parse HIGHRES_IMU", own_s / count, "pymavlink's parser", their_s / count)


class NumpyStep:
    """The filter's step written with NumPy and SciPy: the same model, Newton by `solve`, Riccati by SciPy."""

    def __init__(self, Q: FloatArray, R: FloatArray, mass_kg: float, payload_mass_kg: float, length_m: float) -> None:
        self._Q, self._R_inv = np.diag(Q), np.diag(1.0 / R)
        self._mass_kg, self._payload_mass_kg, self._length_m = mass_kg, payload_mass_kg, length_m

    def _model(self, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        f, F, h, H = np.empty(7), np.empty((7, 7)), np.empty(3), np.empty((3, 7))
        _dynamics(f, F, x, u, self._mass_kg, self._length_m)
        _observation(h, H, x, u, self._mass_kg, self._payload_mass_kg, self._length_m)
        return f, F, h, H

    def __call__(
        self, x: FloatArray, P: FloatArray, u: FloatArray, z: FloatArray, dt_s: float
    ) -> tuple[FloatArray, FloatArray]:
        _, F, _, H = self._model(x, u)
        A = F - np.eye(7) / (2.0 * dt_s)
        P_new = solve_continuous_are(A.T, H.T, self._Q + P / dt_s, np.linalg.inv(self._R_inv))
        K = P_new @ H.T @ self._R_inv
        new = x.copy()
        for _ in range(kernels.NEWTON_MAX):
            f, F, h, H = self._model(new, u)
            residual = new - x - dt_s * (f + K @ (z - h))
            step = np.linalg.solve(np.eye(7) - dt_s * (F - K @ H), residual)
            new -= step
            if np.abs(step).max() < kernels.NEWTON_TOLERANCE:
                break
        return new, P_new


def bench_filter(count: int) -> Result:
    """One step of the swing EKF."""
    mass_kg, payload_mass_kg, length_m, dt_s = 2.0, 0.3, 1.5, 0.0025
    Q = np.array([1e-8, 1e-8, 4e-4, 4e-4, 0.25, 0.25, 0.25])
    R = np.array([3.6e-3, 3.6e-3, 0.04])
    x = np.array([0.2, -0.1, 0.5, 0.3, 0.4, -0.2, 0.1])
    P = np.diag([0.01, 0.01, 0.05, 0.05, 0.5, 0.5, 0.5])
    u = np.array([0.5, -0.3, -22.4])
    z = np.array([0.3, -0.2, 0.1])
    x_out, P_out, nis = np.empty(7), np.empty((7, 7)), np.empty(1)
    peer = NumpyStep(Q, R, mass_kg, payload_mass_kg, length_m)

    def own() -> None:
        for _ in range(count):
            status = kernels.step(
                x_out, P_out, nis, x, P, u, z, Q, R, dt_s, dt_s, mass_kg, payload_mass_kg, length_m, 1e9, 0
            )
            assert status == Status.OK

    peers = max(count // 50, 1)

    def theirs() -> None:
        for _ in range(peers):
            peer(x, P, u, z, dt_s)

    own()
    x_peer, P_peer = peer(x, P, u, z, dt_s)
    # The ratio only means something where both compute the same.
    assert np.allclose(x_out, x_peer, rtol=1e-8, atol=1e-10)
    assert np.allclose(P_out, P_peer, rtol=1e-6, atol=1e-10)
    own_s, their_s = quickest(own, theirs)
    return cost("filter: one step", own_s / count, "NumPy and SciPy", their_s / peers)
