"""Von Karman gusts against the specification's formulas: exactly by their impulse response, and measured by Welch."""

import functools
import math
from itertools import pairwise

import numba
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import csd, welch

from swingd.core import turbulence
from swingd.core.turbulence import TurbulenceState, low_altitude_intensity, low_altitude_scale, turbulence_step

JIT = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs compiled kernels")

DT_S = 0.002
U, V, W, P, Q, R = range(6)
NOISE_OF = {U: 0, V: 1, W: 2, P: 3, Q: 2, R: 1}

# height [m], speed [m/s], wind at 6 m [m/s], span [m]: a multirotor, its load, and an aeroplane
BODIES = [(30.0, 10.0, 10.0, 2.38), (45.0, 17.0, 10.0, 1.0), (200.0, 30.0, 4.0, 11.0)]


@numba.njit
def fly(gusts, state, white, height_m, speed_mps, wind_6m_mps, span_m, dt_s):
    for k in range(white.shape[0]):
        turbulence_step(gusts[k], state, white[k], height_m[k], speed_mps[k], wind_6m_mps, span_m, dt_s)


def gusts_of(white, height_m, speed_mps, wind_6m_mps, span_m, dt_s=DT_S, state=None):
    n = len(white)
    gusts = np.full((n, 6), np.nan)
    state = np.zeros(TurbulenceState.SIZE) if state is None else state
    heights, speeds = np.broadcast_to(height_m, n) * 1.0, np.broadcast_to(speed_mps, n) * 1.0
    fly(gusts, state, white, heights, speeds, wind_6m_mps, span_m, dt_s)
    return gusts


@functools.cache
def impulse_response(channel, body):
    """Gusts after a single normal of 1: 300 s, eleven time constants of the slowest lag."""
    white = np.zeros((150_000, 4))
    white[0, channel] = 1.0
    return gusts_of(white, *body)


def frequency_response(h):
    """Angular frequencies from 0.02 rad/s to 15 Hz, where the fit holds for u at 30 m, and the response there."""
    omega = 2 * math.pi * np.fft.rfftfreq(len(h), DT_S)
    band = (omega > 0.02) & (omega < 2 * math.pi * 15.0)
    return omega[band], np.fft.rfft(h)[band]


def specified(body):
    """One-sided spectra [unit^2/(rad/s)] of MIL-F-8785C, written in feet as it is printed."""
    height_m, speed_mps, wind_mps, span_m = body
    foot = 0.3048
    h, v, b, wind = height_m / foot, speed_mps / foot, span_m / foot, wind_mps / foot
    lw, lu = h, h / (0.177 + 0.000823 * h) ** 1.2
    sw = 0.1 * wind
    su = sw / (0.177 + 0.000823 * h) ** 0.4

    def transverse(w, s, length):
        x2 = (1.339 * length * w / v) ** 2
        return s**2 * length / (math.pi * v) * (1 + 8 / 3 * x2) / (1 + x2) ** (11 / 6)

    return {
        U: lambda w: foot**2 * su**2 * 2 * lu / (math.pi * v) / (1 + (1.339 * lu * w / v) ** 2) ** (5 / 6),
        V: lambda w: foot**2 * transverse(w, su, lu),
        W: lambda w: foot**2 * transverse(w, sw, lw),
        P: lambda w: (
            sw**2 / (v * lw) * 0.8 * (math.pi * lw / (4 * b)) ** (1 / 3) / (1 + (4 * b * w / (math.pi * v)) ** 2)
        ),
        Q: lambda w: (w / v) ** 2 / (1 + (4 * b * w / (math.pi * v)) ** 2) * transverse(w, sw, lw),
        R: lambda w: (w / v) ** 2 / (1 + (3 * b * w / (math.pi * v)) ** 2) * transverse(w, su, lu),
    }


@pytest.mark.parametrize(
    ("weights", "density"),
    [
        (turbulence._WEIGHT_LONGITUDINAL, lambda x: (1 + x**2) ** (-5 / 6)),
        (turbulence._WEIGHT_TRANSVERSE, lambda x: (1 + 8 / 3 * x**2) * (1 + x**2) ** (-11 / 6)),
    ],
)
def test_fit_stays_within_its_ripple(weights, density):
    x = np.concatenate([[0.0], np.geomspace(0.01, 3000.0, 2000)])
    response = (turbulence._POLE / (turbulence._POLE + 1j * x[:, None])) @ weights
    assert np.max(np.abs(10 * np.log10(np.abs(response) ** 2 / density(x)))) < 0.11


@JIT
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("component", [U, V, W, P, Q, R])
def test_density_is_the_specified_one(component, body):
    """A standard normal held over dt has the one-sided density dt / pi."""
    omega, response = frequency_response(impulse_response(NOISE_OF[component], body)[:, component])
    density = np.abs(response) ** 2 * DT_S / math.pi
    error_db = 10 * np.log10(density / specified(body)[component](omega))
    assert np.max(np.abs(error_db)) < 0.15


@JIT
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("component", [U, V, W, P, Q, R])
def test_deviation_is_the_specified_one(component, body):
    """The sum over the impulse response against the integral of the spectrum up to the sampling's band."""
    h = impulse_response(NOISE_OF[component], body)[:, component]
    density = specified(body)[component]
    edges = [0.0, *np.geomspace(1e-3, math.pi / DT_S, 12)]
    variance = sum(quad(density, a, b, epsrel=1e-8)[0] for a, b in pairwise(edges))
    assert math.sqrt(np.sum(h**2)) == pytest.approx(math.sqrt(variance), rel=0.01)


@JIT
def test_intensities_are_the_deviations():
    body = BODIES[0]
    deviations = [np.sqrt(np.sum(impulse_response(i, body)[:, i] ** 2)) for i in (U, V, W)]
    np.testing.assert_allclose(deviations, low_altitude_intensity(30.0, 10.0), rtol=0.008)


@JIT
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize(("rate", "velocity", "factor"), [(Q, W, 4.0), (R, V, 3.0)])
def test_rates_follow_their_velocities_with_plus_signs(rate, velocity, factor, body):
    """+q +r: q = +s/V / (1 + 4b/(pi V) s) w, r = +s/V / (1 + 3b/(pi V) s) v, in magnitude and phase."""
    _, speed_mps, _, span_m = body
    h = impulse_response(NOISE_OF[rate], body)
    omega, response_rate = frequency_response(h[:, rate])
    _, response_velocity = frequency_response(h[:, velocity])
    s = 1j * omega
    expected = s / speed_mps / (1.0 + factor * span_m / (math.pi * speed_mps) * s)
    assert np.max(np.abs(response_rate / response_velocity / expected - 1.0)) < 0.005


@JIT
def test_each_noise_moves_its_own_components():
    for channel, moved in enumerate([{U}, {V, R}, {W, Q}, {P}]):
        last = impulse_response(channel, BODIES[0])[50]
        assert set(np.flatnonzero(last)) == moved


@pytest.fixture(scope="module")
def flight():
    """An hour of the vehicle at 500 Hz, after the filters have risen."""
    white = np.random.default_rng(20231).standard_normal((1_900_000, 4))
    return gusts_of(white, *BODIES[0])[100_000:]


@JIT
@pytest.mark.parametrize("component", [U, V, W, P, Q, R])
def test_measured_spectrum(flight, component):
    """Welch's estimate in bands of a sixth of a decade: four deviations of its scatter, and the ripple of the fit."""
    frequency, density = welch(flight[:, component], 1 / DT_S, nperseg=2**15)
    edges = np.geomspace(0.05, 20.0, 16)
    for low, high in pairwise(edges):
        band = (frequency >= low) & (frequency < high)
        omega = 2 * math.pi * frequency[band]
        ratio = np.mean(density[band] / (2 * math.pi * specified(BODIES[0])[component](omega)))
        assert ratio == pytest.approx(1.0, abs=0.03 + 4.0 / math.sqrt(len(flight) * DT_S * (high - low)))


@JIT
def test_measured_deviations(flight):
    """Of an hour the deviation scatters by 4 % for u and v, by 1.3 % for w and by 0.6 % for p (twenty seeds)."""
    measured = np.std(flight, axis=0)
    std_u_mps, std_v_mps, std_w_mps = low_altitude_intensity(30.0, 10.0)
    np.testing.assert_allclose(measured[:2], [std_u_mps, std_v_mps], rtol=0.12)
    assert measured[W] == pytest.approx(std_w_mps, rel=0.04)
    k = math.pi / 4 / 2.38
    assert measured[P] == pytest.approx(math.sqrt(0.4 * math.pi) * k / (k * 30.0) ** (1 / 3), rel=0.02)


@JIT
def test_measured_signs(flight):
    """Rising w comes with positive q, rising v with positive r; u and p go with nothing."""
    assert np.corrcoef(np.diff(flight[:, W]), flight[1:, Q])[0, 1] > 0.05
    assert np.corrcoef(np.diff(flight[:, V]), flight[1:, R])[0, 1] > 0.05
    frequency, cross = csd(flight[:, W], flight[:, Q], 1 / DT_S, nperseg=2**13)
    lead = np.angle(cross[(frequency > 0.1) & (frequency < 1.0)])
    lag = np.arctan(2 * math.pi * frequency[(frequency > 0.1) & (frequency < 1.0)] * 4 * 2.38 / (math.pi * 10.0))
    np.testing.assert_allclose(lead, math.pi / 2 - lag, atol=0.1)
    slow = np.corrcoef(flight[::2500].T)
    assert np.max(np.abs([slow[U, V], slow[U, W], slow[V, W], slow[P, W]])) < 0.25


@JIT
def test_deviation_stays_while_speed_and_height_change():
    """The filters' time is warped, their noise with it: w keeps a tenth of the wind (scatter: 1.3 % and 2 %)."""
    t = np.arange(1_000_000) * DT_S
    height, speed = 20.0 + 15.0 * np.sin(0.4 * t), 16.0 + 14.0 * np.sin(1.7 * t)
    white = np.random.default_rng(7).standard_normal((len(t), 4))
    w = gusts_of(white, height, speed, 10.0, 1.0)[50_000:, W]
    fast = speed[50_000:] > 16.0
    assert np.std(w) == pytest.approx(1.0, rel=0.04)
    assert np.std(w[fast]) == pytest.approx(np.std(w[~fast]), rel=0.06)


def test_travelled_length_is_the_time_of_the_filters():
    """Without noise, ten steps at 1 m/s are one step at 10 m/s."""
    slow = np.random.default_rng(3).standard_normal(TurbulenceState.SIZE)
    slow[TurbulenceState.Q :] = 0.0
    fast = slow.copy()
    ten = gusts_of(np.zeros((10, 4)), 30.0, 1.0, 10.0, 1.0, state=slow)[-1]
    one = gusts_of(np.zeros((1, 4)), 30.0, 10.0, 10.0, 1.0, state=fast)[-1]
    np.testing.assert_allclose(ten[:4], one[:4], rtol=1e-3)
    np.testing.assert_allclose(ten[4:], one[4:], rtol=0.02)


def test_field_stands_still_without_speed():
    state = np.random.default_rng(4).standard_normal(TurbulenceState.SIZE)
    before = state.copy()
    white = np.random.default_rng(5).standard_normal((3, 4))
    gusts = gusts_of(white, 30.0, np.array([0.0, -0.0, -2.0]), 10.0, 1.0, state=state)
    np.testing.assert_array_equal(state, before)
    assert np.isfinite(gusts).all()
    assert (gusts == gusts[0]).all()


def test_no_step_is_too_long():
    white = np.random.default_rng(6).standard_normal((2000, 4))
    gusts = gusts_of(white, 3.0, 40.0, 10.0, 0.3, dt_s=5.0)
    assert np.isfinite(gusts).all()
    assert (np.std(gusts[:, :3], axis=0) <= low_altitude_intensity(3.0, 10.0)).all()


def test_same_noise_gives_the_same_gusts_in_one_flight_or_two():
    white = np.random.default_rng(8).standard_normal((1000, 4))
    whole = gusts_of(white, *BODIES[1])
    state = np.zeros(TurbulenceState.SIZE)
    parts = [gusts_of(part, *BODIES[1], state=state) for part in (white[:300], white[300:])]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


@pytest.mark.parametrize(
    ("height_ft", "scale_u_ft", "intensity_ratio"),
    [
        (10.0, 75.64, 1.9630),  # 10 / 0.18523^1.2, 0.18523^-0.4
        (100.0, 505.2, 1.7158),  # 100 / 0.2593^1.2, 0.2593^-0.4
        (500.0, 944.6, 1.2362),  # 500 / 0.5885^1.2, 0.5885^-0.4
        (1000.0, 1000.0, 1.0),
    ],
)
def test_scales_and_intensities_in_feet(height_ft, scale_u_ft, intensity_ratio):
    scales = np.array(low_altitude_scale(height_ft * 0.3048)) / 0.3048
    np.testing.assert_allclose(scales, [scale_u_ft, scale_u_ft, height_ft], rtol=2e-4)
    knots_30 = 15.433
    ratio = np.array(low_altitude_intensity(height_ft * 0.3048, knots_30)) / (0.1 * knots_30)
    np.testing.assert_allclose(ratio, [intensity_ratio, intensity_ratio, 1.0], rtol=2e-4)


@pytest.mark.parametrize(("height_m", "held_m"), [(-1.0, 3.048), (0.0, 3.048), (304.9, 304.8), (2000.0, 304.8)])
def test_heights_are_held_where_the_model_ends(height_m, held_m):
    assert low_altitude_scale(height_m) == pytest.approx(low_altitude_scale(held_m))
    assert low_altitude_intensity(height_m, 5.0) == pytest.approx(low_altitude_intensity(held_m, 5.0))
    white = np.random.default_rng(9).standard_normal((50, 4))
    np.testing.assert_allclose(
        gusts_of(white, height_m, 10.0, 5.0, 1.0), gusts_of(white, held_m, 10.0, 5.0, 1.0), rtol=1e-12
    )
