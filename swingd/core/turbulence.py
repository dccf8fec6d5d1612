r"""Continuous Von Karman turbulence at low altitude (MIL-F-8785C [1]_), linear and angular, with the signs +q +r.

The spectra, one-sided in the angular frequency :math:`\omega`, so that the variance is the integral from 0 to infinity:

.. math::
    \Phi_u &= \sigma_u^2 \frac{2 L_u}{\pi V} \left[1 + x_u^2\right]^{-5/6}, \qquad x_i = 1.339 L_i \omega / V \\
    \Phi_v &= \sigma_v^2 \frac{L_v}{\pi V} \left[1 + \tfrac{8}{3} x_v^2\right] \left[1 + x_v^2\right]^{-11/6},
    \qquad \Phi_w \text{ likewise} \\
    \Phi_p &= \frac{\sigma_w^2}{V L_w} \frac{0.8 (\pi L_w / 4 b)^{1/3}}{1 + (4 b \omega / \pi V)^2} \\
    q &= + \frac{s / V}{1 + (4 b / \pi V) s} w, \qquad r = + \frac{s / V}{1 + (3 b / \pi V) s} v

Near the ground L_w is the height and L_u = L_v. (The later MIL-HDBK-1797 halves L_v and L_w and doubles them in its
spectra: the same turbulence.)

Each velocity is a sum of first-order lags, all driven by the same noise. In the travelled length over 1.339 L, instead
of time, their poles are constants: a change of speed or height warps the time, and the deviation stays the
specification's at any speed. The lags were fitted to both shapes at once, with equal ripple: the density of the sum
stays within 0.11 dB (2.5 %) of the spectra for x from 0 to 3000 and falls faster beyond; the deviation is 0.06 % low.
(The second and third order filters that are commonly printed lose about 1 dB at x = 50, and 2 % of the deviation.)
At a height of 30 m and 10 m/s, x is 3000 at 23 Hz for u and v and at 119 Hz for w.

References
----------
.. [1] MIL-F-8785C, Flying Qualities of Piloted Airplanes, 1980, sections 3.7.1 to 3.7.3.
"""

from enum import IntEnum
from math import pi, sqrt

import numpy as np
from numba.core.types import UniTuple

from swingd.core._jit import F8, VEC, VOID, kernel

_METRES_PER_FOOT = 0.3048
_LOWEST_FT = 10.0
_HIGHEST_FT = 1000.0

_SCALE = 1.339  # corner of the Von Karman spectra: V / (1.339 L)

# Lags with the poles of _POLE and unit gain, weighted: |sum|^2 is (1 + x^2)^(-5/6) for u,
# (1 + 8/3 x^2) (1 + x^2)^(-11/6) for v and w.
_LAGS = 5
_POLE = np.array([0.761557273, 1.649213934, 15.298467496, 140.563954248, 1348.055563735])
_WEIGHT_LONGITUDINAL = np.array([0.436022899, 0.529774569, 0.038471130, 0.005790022, 0.000987729])
_WEIGHT_TRANSVERSE = np.array([-0.446161590, 1.381518422, 0.064525865, 0.009481335, 0.001613422])


class TurbulenceState(IntEnum):
    """Offsets into the state of the forming filters; dimensionless, as if the deviations of u, v and w were 1."""

    U = 0
    """Lags of u, 5."""
    V = 5
    """Lags of v, 5."""
    W = 10
    """Lags of w, 5."""
    P = 15
    """p over its deviation."""
    Q = 16
    """w less its lag of 4 b / (pi V), over the deviation of w."""
    R = 17
    """v less its lag of 3 b / (pi V), over the deviation of v."""
    SIZE = 18


_S = TurbulenceState


@kernel(F8(F8))
def _height_ft(height_m):
    return min(max(height_m / _METRES_PER_FOOT, _LOWEST_FT), _HIGHEST_FT)


@kernel(F8(F8))
def _flatness(height_ft):
    """Deviation of w over that of u and v; its cube is L_w over L_u and L_v."""
    return (0.177 + 0.000823 * height_ft) ** 0.4


@kernel(UniTuple(F8, 3)(F8))
def low_altitude_scale(height_m):
    """Scale lengths L_u, L_v, L_w below 1000 ft.

    Parameters
    ----------
    height_m : float
        Above ground [m]; held between 10 ft and 1000 ft (3.048 m and 304.8 m), where the specification ends.

    Returns
    -------
    scale_u_m, scale_v_m, scale_w_m : float
        [m]; with the height h in feet, L_w = h and L_u = L_v = h / (0.177 + 0.000823 h)^1.2 ft.
    """
    height_ft = _height_ft(height_m)
    scale_w_m = height_ft * _METRES_PER_FOOT
    scale_u_m = scale_w_m / _flatness(height_ft) ** 3
    return scale_u_m, scale_u_m, scale_w_m


@kernel(UniTuple(F8, 3)(F8, F8))
def low_altitude_intensity(height_m, wind_6m_mps):
    """Deviations of u, v, w below 1000 ft.

    Parameters
    ----------
    height_m : float
        Above ground [m]; held between 10 ft and 1000 ft.
    wind_6m_mps : float
        Mean wind 20 ft (6 m) above ground [m/s], >= 0; checked by the caller.

    Returns
    -------
    std_u_mps, std_v_mps, std_w_mps : float
        [m/s]; sigma_w is a tenth of the wind, with the height h in feet
        sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4.
    """
    std_w_mps = 0.1 * wind_6m_mps
    std_u_mps = std_w_mps / _flatness(_height_ft(height_m))
    return std_u_mps, std_u_mps, std_w_mps


@kernel(F8(F8))
def _mean_decay(z):
    """(1 - exp(-z)) / z within z^3 / 72 of itself; tends to 1 / z for large z too, so that no step is too long."""
    return (1.0 + z / 6.0) / (1.0 + z * (2.0 / 3.0 + z / 6.0))


@kernel(VOID(VEC, VEC, VEC, F8, F8, F8, F8, F8))
def turbulence_step(gust_out, state, white, height_m, speed_mps, wind_6m_mps, span_m, dt_s):
    """Advance the forming filters by one interval and write the gust at its end.

    The noise is held over the interval (band-limited white noise), for which the lags are discretised exactly but for
    the error of `_mean_decay`. q and r follow w and v as if these changed linearly in between.

    Parameters
    ----------
    gust_out : (6,), written
        u, v, w [m/s] and p, q, r [rad/s]: velocity and rotation of the air in axes along the mean wind, x where it
        blows to, y to the right of it, both horizontal, z down. The signs of q and r are the transfer functions'.
    state : (TurbulenceState.SIZE,), changed
        Zeros are still air, from which the gusts rise within a few L_u / V.
    white : (4,)
        Independent standard normals of this interval, for u, v, w and p.
    height_m : float
        Above ground [m]; held between 10 ft and 1000 ft (3.048 m and 304.8 m), where the model of higher altitudes
        would begin, which is left out.
    speed_mps : float
        Speed V through the frozen field [m/s]; with 0, or less, the gust stays as it is.
    wind_6m_mps : float
        Mean wind 20 ft (6 m) above ground [m/s], >= 0; checked by the caller.
    span_m : float
        Span b of the body [m], > 0; checked by the caller.
    dt_s : float
        Interval [s], > 0; checked by the caller.
    """
    height_ft = _height_ft(height_m)
    flatness = _flatness(height_ft)
    scale_w_m = height_ft * _METRES_PER_FOOT
    std_w_mps = 0.1 * wind_6m_mps
    std_uv_mps = std_w_mps / flatness

    # Travelled length over 1.339 L: the time in which the poles are constants.
    travelled_m = max(speed_mps, 0.0) * dt_s
    step_w = travelled_m / (_SCALE * scale_w_m)
    step_uv = step_w * flatness * flatness * flatness
    noise_u = white[0] * sqrt(2.0 / _SCALE * step_uv)
    noise_v = white[1] * sqrt(step_uv / _SCALE)
    noise_w = white[2] * sqrt(step_w / _SCALE)

    u = v = w = 0.0
    change_v = change_w = 0.0
    for i in range(_LAGS):
        gain_uv = _POLE[i] * _mean_decay(_POLE[i] * step_uv)
        gain_w = _POLE[i] * _mean_decay(_POLE[i] * step_w)
        change = gain_uv * (noise_v - step_uv * state[_S.V + i])
        state[_S.U + i] += gain_uv * (noise_u - step_uv * state[_S.U + i])
        state[_S.V + i] += change
        change_v += _WEIGHT_TRANSVERSE[i] * change
        change = gain_w * (noise_w - step_w * state[_S.W + i])
        state[_S.W + i] += change
        change_w += _WEIGHT_TRANSVERSE[i] * change
        u += _WEIGHT_LONGITUDINAL[i] * state[_S.U + i]
        v += _WEIGHT_TRANSVERSE[i] * state[_S.V + i]
        w += _WEIGHT_TRANSVERSE[i] * state[_S.W + i]

    per_span_pq = 0.25 * pi / span_m
    per_span_r = pi / (3.0 * span_m)
    step_pq = per_span_pq * travelled_m
    step_r = per_span_r * travelled_m
    decay_pq = _mean_decay(step_pq)
    state[_S.P] += decay_pq * (white[3] * sqrt(2.0 * step_pq) - step_pq * state[_S.P])
    state[_S.Q] += decay_pq * (change_w - step_pq * state[_S.Q])
    state[_S.R] += _mean_decay(step_r) * (change_v - step_r * state[_S.R])

    gust_out[0] = std_uv_mps * u
    gust_out[1] = std_uv_mps * v
    gust_out[2] = std_w_mps * w
    # The integral of the spectrum of p is sigma_p^2 = 0.4 pi sigma_w^2 k^2 (k L_w)^(-2/3) with k = pi / (4 b).
    gust_out[3] = sqrt(0.4 * pi) * std_w_mps * per_span_pq / np.cbrt(per_span_pq * scale_w_m) * state[_S.P]
    gust_out[4] = std_w_mps * per_span_pq * state[_S.Q]
    gust_out[5] = std_uv_mps * per_span_r * state[_S.R]
