"""Load, cable and damping of flights with known truth, and what flights cannot tell."""

import math

import numpy as np
import pytest
from scipy.stats import binom, t

from identify.flights import RATE_HZ, Flown, Truth, fly
from swingd.identify import FlightRecord, Identification, identify
from swingd.identify.fit import student_quantile
from swingd.model.events import Attitude, Imu
from swingd.model.parameters import Cable, Parameters, Payload, Vehicle
from swingd.pipeline.payload_mass import MassEstimate

WINDY = Truth(gust_std_n=0.3, attitude_std_rad=0.004)


def configured(truth: Truth, length_factor: float = 0.8, mass_factor: float = 0.7) -> Parameters:
    return Parameters(
        vehicle=Vehicle(mass_kg=truth.vehicle_kg),
        payload=Payload(mass_kg=mass_factor * truth.load_kg),
        cable=Cable(length_m=length_factor * truth.length_m),
    )


def identified(flown: Flown, flight: int = 0) -> Identification:
    return identify(flown.record(flight), flown.hanging, configured(flown.truth))


@pytest.fixture(scope="module")
def windy() -> Flown:
    return fly(WINDY, 8, 60.0, seed=5)


def test_intervals_hold_the_truth_as_often_as_they_promise_and_are_not_wide(windy: Flown) -> None:
    found = [identified(windy, flight) for flight in range(8)]
    widths = {}
    for name, true in (("mass", WINDY.load_kg), ("length", WINDY.length_m), ("damping", WINDY.damping_ratio)):
        known = [getattr(identification, name).known for identification in found]
        assert all(known), [getattr(identification, name).note for identification in found]
        missed = sum(not one.low <= true <= one.high for one in known)
        # As many misses or more come from honest intervals once in a thousand runs.
        assert missed < binom.isf(1e-3, len(known), 0.05) + 1, (name, known)
        widths[name] = float(np.median([one.half_width for one in known]))
    assert widths["mass"] < 0.15 * WINDY.load_kg
    assert widths["length"] < 0.06 * WINDY.length_m
    assert widths["damping"] < 0.02


@pytest.mark.parametrize("factor", [0.35, 2.8])
def test_a_wrong_configuration_leads_to_the_same_answer(windy: Flown, factor: float) -> None:
    record = windy.record(1)
    near, far = (identify(record, windy.hanging, configured(WINDY, *wrong)) for wrong in ((1.0, 1.0), (factor, factor)))
    for one, other in zip(near.quantities, far.quantities, strict=True):
        if one.known is not None:
            assert other.known is not None
            assert other.known.value == pytest.approx(one.known.value, abs=0.2 * one.known.half_width)
    assert far.length.agrees is False
    assert near.length.agrees


def test_a_steady_tilt_of_the_attitude_costs_nothing() -> None:
    flown = fly(Truth(yaw_rate_radps=0.0), 1, 40.0, seed=3)
    tilted = Flown(flown.t_s, flown.acc_frd, flown.attitude + np.array([0.03, -0.02, 1.0]), flown.velocity, flown.truth)
    straight, wrong = identified(flown).length.known, identified(tilted).length.known
    assert straight is not None
    assert wrong is not None
    assert wrong.value == pytest.approx(straight.value, rel=5e-3)


def test_an_imu_off_the_centre_of_gravity_is_brought_to_it_and_to_the_hook() -> None:
    """GIVEN a body that rolls about its centre WHEN the IMU sits beside THEN the centre feels its weight alone."""
    times = np.arange(0.0, 30.0, 0.01)
    roll, roll_rate = 0.3 * np.sin(2.0 * times), 0.6 * np.cos(2.0 * times)
    roll_acc = -1.2 * np.sin(2.0 * times)
    right_m, down_m, hook_m = 0.1, -0.2, 0.25
    felt = np.stack(
        [
            np.zeros_like(times),
            -9.81 * np.sin(roll) - roll_acc * down_m - roll_rate**2 * right_m,
            -9.81 * np.cos(roll) + roll_acc * right_m - roll_rate**2 * down_m,
        ],
        axis=-1,
    )
    record = FlightRecord(
        [Imu(s, s, tuple(acc), (p, 0.0, 0.0)) for s, acc, p in zip(times, felt.tolist(), roll_rate, strict=True)],
        [Attitude(s, s, angle, 0.0, 0.0) for s, angle in zip(times, roll, strict=True)],
        [],
        Vehicle(mass_kg=2.0, imu_frd_m=(0.0, right_m, down_m), hook_frd_m=(0.0, 0.0, hook_m)),
    )
    (segment,) = record.cut([(1.0, 29.0)], 1.0, 12.0)
    angle = 0.3 * np.sin(2.0 * segment.t_boot_s)
    np.testing.assert_allclose(segment.side_force_frd_n[:, 1], -2.0 * 9.81 * np.sin(angle), atol=0.02)
    acc, rate2 = -1.2 * np.sin(2.0 * segment.t_boot_s), (0.6 * np.cos(2.0 * segment.t_boot_s)) ** 2
    swung = -acc * hook_m * np.cos(angle) + rate2 * hook_m * np.sin(angle)
    np.testing.assert_allclose(segment.felt_level_mps2[:, 1], swung, atol=0.02)


def test_gaps_are_left_out() -> None:
    flown = fly(Truth(), 1, 50.0, seed=4)
    lost = slice(int(20.0 * RATE_HZ), int(23.0 * RATE_HZ))
    record = flown.record(0, drop=lost)
    segments = record.cut(flown.hanging, 1.5, 3.0)
    assert sum(segment.t_boot_s[-1] < 20.0 for segment in segments) == 2
    assert all(segment.t_boot_s[-1] < 20.0 or segment.t_boot_s[0] > 22.9 for segment in segments)
    found = identify(record, flown.hanging, configured(flown.truth)).length.known
    assert found is not None
    assert found.low <= 1.5 <= found.high


@pytest.mark.parametrize(
    "truth",
    [
        Truth(speed_mps=0.0, gust_std_n=0.05),
        Truth(load_kg=1e-4, gust_std_n=0.3),
    ],
    ids=["hover", "no load"],
)
def test_what_does_not_swing_is_not_told(truth: Truth) -> None:
    flown = fly(truth, 2, 40.0, seed=2)
    for flight in range(2):
        found = identify(flown.record(flight), flown.hanging, configured(Truth()))
        assert [quantity.known for quantity in found.quantities] == [None] * 4
        assert found.mass.note.startswith(("too little swing", "too uncertain"))
        assert found.length.note
        assert found.yaml() == ""


def test_a_short_flight_says_how_long_it_must_be() -> None:
    flown = fly(Truth(), 1, 15.0, seed=1)
    found = identified(flown)
    assert found.fit is None
    assert found.length.known is None
    assert found.hanging_s == pytest.approx(13.0, abs=0.1)
    needed_s = 8.0 * 2.0 * math.pi * math.sqrt(0.8 * 1.5 / 9.80665)
    assert f"expected {needed_s:.0f} s" in found.length.note


@pytest.mark.parametrize(
    ("weighing", "mass_kg", "note"),
    [
        (None, None, "no load was seen to hang"),
        (MassEstimate(None, None, "no flight without it before"), None, "no flight without it before"),
        (MassEstimate(0.7, 0.01, "weighed by thrust"), 0.7, "weighed by thrust"),
    ],
)
def test_the_weighing_stands_beside_the_swing(
    windy: Flown, weighing: MassEstimate | None, mass_kg: float | None, note: str
) -> None:
    found = identify(windy.record(2), windy.hanging, configured(WINDY), weighing)
    weighed = found.weighed_mass
    assert weighed.note == note
    if mass_kg is None:
        assert weighed.known is None
        assert found.best_mass is found.mass
        assert found.contradiction == ""
    else:
        assert weighed.known is not None
        assert weighed.known.high - mass_kg == pytest.approx(0.01 * t.ppf(0.975, 24), rel=1e-3)
        assert found.best_mass is weighed
        assert "vehicle.mass_kg" in found.contradiction
        assert "mass_kg: 0.7  # 0.6794 .. 0.7206" in found.yaml()


@pytest.mark.parametrize("freedom", [3, 4, 7, 20, 200])
def test_quantile_of_student(freedom: int) -> None:
    assert student_quantile(freedom) == pytest.approx(t.ppf(0.975, freedom), rel=5e-3)
