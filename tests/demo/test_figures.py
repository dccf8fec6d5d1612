"""The demonstration's figures, on flights whose answers are known."""

import math

import numpy as np
import pytest

from swingd.demo.figures import figures
from swingd.demo.flight import Flight
from swingd.demo.pilot import Step
from swingd.model.parameters import Parameters

STEPS = (Step(100.0, (3.0, 0.0, 0.0)), Step(122.0, (0.0, 0.0, 0.0)))
END_S = 144.0
DAEMON: dict[str, float | None] = {
    "filter_hz": 100.0,
    "latency_ms_p50": 1.0,
    "latency_ms_p99": 2.0,
    "cpu_percent": 10.0,
}


def flight(
    peak_deg: float, decay_s: float, late_mps: float, bias_deg: float = 0.0, setpoint_gap_s: float = 0.02
) -> Flight:
    """After each step the swing falls exponentially from its peak and the velocity is ``late_mps`` too low."""
    t = 80.01 + 0.02 * np.arange(3200)  # no sample falls on a step
    since = np.where(t < 122.0, t - 100.0, t - 122.0)
    chi = np.where(t < 100.0, 0.0, np.radians(peak_deg) * np.exp(-since / decay_s))
    wanted = np.where((t >= 100.0) & (t < 122.0), 3.0, 0.0)
    angles = np.array([np.zeros_like(chi), chi])
    return Flight(
        t_boot_s=t,
        chi_rad=chi,
        angles_rad=angles,
        rates_radps=np.zeros_like(angles),
        vel_ned_mps=np.array([wanted - late_mps, np.zeros_like(t), np.zeros_like(t)]),
        steps=STEPS,
        end_s=END_S,
        estimate_t_s=t,
        estimate_rad=angles + math.radians(bias_deg),
        estimate_rates_radps=np.zeros_like(angles),
        setpoint_gap_s=setpoint_gap_s,
        daemon=DAEMON,
    )


def test_figures_of_exponential_swings() -> None:
    f = figures(Parameters(), flight(30.0, 4.0, 0.5), flight(20.0, 1.0, 0.6))
    assert f.period_s == pytest.approx(2.0 * math.pi * math.sqrt(1.5 / 9.80665))
    assert (f.peak_deg_off, f.peak_deg_on) == pytest.approx((30.0, 20.0), rel=0.011)  # the first sample comes late
    assert f.settle_2deg_s_off == pytest.approx(4.0 * math.log(15.0), abs=0.03)
    assert f.settle_2deg_s_on == pytest.approx(math.log(10.0), abs=0.03)
    assert f.settle_periods_on == pytest.approx(f.settle_2deg_s_on / f.period_s)
    # RMS of A exp(-t / tau) over 12 s: A sqrt(tau / 24 (1 - exp(-24 / tau)))
    assert f.rms_deg_off == pytest.approx(30.0 * math.sqrt(4.0 / 24.0 * (1.0 - math.exp(-6.0))), rel=5e-3)
    assert f.rms_ratio == pytest.approx(f.rms_deg_on / f.rms_deg_off)
    assert (f.velocity_rmse_mps_off, f.velocity_rmse_mps_on) == pytest.approx((0.5, 0.6))
    assert f.velocity_ratio == pytest.approx(1.2)


def test_a_swing_that_never_settles_takes_the_whole_window() -> None:
    f = figures(Parameters(), flight(30.0, 1e6, 0.1), flight(1.0, 1.0, 0.1))
    assert f.settle_2deg_s_off == pytest.approx(22.0, abs=0.05)
    assert f.settle_2deg_s_on == 0.0


def test_the_estimate_is_judged_over_both_axes_and_both_flights() -> None:
    f = figures(Parameters(), flight(30.0, 4.0, 0.5, bias_deg=1.0), flight(20.0, 1.0, 0.6, bias_deg=0.0))
    assert f.angle_rmse_deg == pytest.approx(math.sqrt(0.5), rel=1e-6)


@pytest.mark.parametrize(("gaps_s", "stalled"), [((0.02, 0.09), False), ((0.02, 0.2), True), ((0.2, 0.02), True)])
def test_a_flight_on_a_machine_that_stood_still_says_so(gaps_s: tuple[float, float], stalled: bool) -> None:
    f = figures(Parameters(), *(flight(30.0, 4.0, 0.5, setpoint_gap_s=gap_s) for gap_s in gaps_s))
    assert f.setpoint_gap_ms == pytest.approx(1e3 * max(gaps_s))
    assert f.stalled is stalled
