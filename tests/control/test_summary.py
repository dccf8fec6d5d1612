"""What swingd check computes, against tables and second formulations."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.control.placed import design
from swingd.control.summary import curve_thrust_n, hover_throttle, hover_thrust_n, summarise
from swingd.core.constants import GRAVITY_MPS2
from swingd.model.parameters import Cable, Control, Parameters, Payload, Thrust, Vehicle

IRIS = Thrust(quadratic_n=37.376, linear_n=7.4752, offset_n=0.37376, voltage_nominal_v=16.2, voltage_exponent=2.0)


def vehicle_and_load(vehicle_kg: float, payload_kg: float, cable_m: float = 1.5, **parts: Thrust) -> Parameters:
    return dataclasses.replace(
        Parameters(), vehicle=Vehicle(vehicle_kg), payload=Payload(payload_kg), cable=Cable(cable_m), **parts
    )


@pytest.mark.parametrize(
    ("total_kg", "at_16_2_v", "at_14_44_v", "at_13_8_v"),
    [
        (1.7, 0.568, 0.649, 0.684),
        (1.8, 0.587, 0.671, 0.707),
        (1.9, 0.606, 0.692, 0.729),
        (2.0, 0.624, 0.713, 0.750),
        (2.1, 0.642, 0.733, 0.771),
    ],
)
def test_hover_throttle_of_the_recorded_px4_flights(
    total_kg: float, at_16_2_v: float, at_14_44_v: float, at_13_8_v: float
) -> None:
    """Table "Hover (1.5 kg vehicle + load)" of the PX4 SITL slung-load recordings."""
    parameters = vehicle_and_load(1.5, total_kg - 1.5, thrust=IRIS)
    for voltage_v, throttle in ((16.2, at_16_2_v), (14.44, at_14_44_v), (13.8, at_13_8_v)):
        assert hover_throttle(parameters, voltage_v) == pytest.approx(throttle, abs=6e-4)


@given(
    quadratic_n=st.floats(-40.0, 80.0),
    linear_n=st.floats(0.0, 80.0),
    offset_n=st.floats(0.0, 5.0),
    exponent=st.floats(0.0, 3.0),
    voltage_v=st.floats(12.0, 18.0),
)
def test_the_curve_at_hover_throttle_gives_the_weight(
    quadratic_n: float, linear_n: float, offset_n: float, exponent: float, voltage_v: float
) -> None:
    thrust = Thrust(quadratic_n=quadratic_n, linear_n=linear_n, offset_n=offset_n, voltage_exponent=exponent)
    parameters = vehicle_and_load(1.5, 0.3, thrust=thrust)
    needed_n = hover_thrust_n(parameters)
    grid = np.linspace(0.0, 1.0, 2001)
    reached = np.array([curve_thrust_n(thrust, x, voltage_v) for x in grid]) >= needed_n
    throttle = hover_throttle(parameters, voltage_v)
    if throttle is None:
        assert not reached[:-1].any() or reached[0]
        return
    assert curve_thrust_n(thrust, throttle, voltage_v) == pytest.approx(needed_n, rel=1e-6)
    assert not reached[grid < throttle - 1e-3].any(), "a lower throttle would do"


def test_without_enough_thrust_there_is_no_hover_throttle() -> None:
    weak = Thrust(quadratic_n=10.0, linear_n=5.0, offset_n=0.0)
    assert hover_throttle(vehicle_and_load(2.0, 0.3, thrust=weak), 16.2) is None
    bent = Thrust(quadratic_n=-20.0, linear_n=20.0, offset_n=0.0)
    assert hover_throttle(vehicle_and_load(2.0, 0.3, thrust=bent), 16.2) is None


@pytest.mark.parametrize(("vehicle_kg", "payload_kg", "cable_m"), [(2.0, 0.192, 1.9), (1.5, 0.5, 3.0), (1.0, 2.0, 0.7)])
def test_swing_frequencies_are_eigenvalues_of_two_point_masses(
    vehicle_kg: float, payload_kg: float, cable_m: float
) -> None:
    """Vehicle and load on one horizontal axis, joined by the cable's tension m_l g over its length."""
    found = summarise(vehicle_and_load(vehicle_kg, payload_kg, cable_m))
    spring = payload_kg * GRAVITY_MPS2 / cable_m
    free = np.array([[-spring / vehicle_kg, spring / vehicle_kg], [spring / payload_kg, -spring / payload_kg]])
    assert found.swing_free.frequency_radps == pytest.approx(math.sqrt(-np.linalg.eigvals(free).real.min()))
    assert found.swing_fixed.frequency_radps == pytest.approx(math.sqrt(spring / payload_kg))


def test_the_free_swing_of_the_papers_flight() -> None:
    """Drones 2023, section 4.2: (g / L)(m + m_l) / m is 5.66 1/s^2."""
    assert summarise(vehicle_and_load(2.0, 0.192, 1.9)).swing_free.frequency_radps ** 2 == pytest.approx(5.66, abs=5e-3)


def test_frequency_and_period_agree() -> None:
    swing = summarise(Parameters()).swing_fixed
    assert swing.frequency_hz * swing.period_s == pytest.approx(1.0)
    assert swing.period_s == pytest.approx(2.0 * math.pi * math.sqrt(1.5 / 9.80665))


def test_hover_is_given_at_nominal_and_at_sagged_voltage() -> None:
    found = summarise(vehicle_and_load(1.5, 0.3, thrust=IRIS))
    assert found.hover_thrust_n == pytest.approx(1.8 * 9.80665)
    assert found.hover_nominal.voltage_v == 16.2
    assert found.hover_sagged.voltage_v == pytest.approx(0.85 * 16.2)
    assert found.hover_nominal.throttle is not None
    assert found.hover_sagged.throttle is not None
    assert found.hover_nominal.throttle < found.hover_sagged.throttle


def test_the_correction_of_the_placed_law_is_its_design() -> None:
    placed = design(Parameters())
    found = summarise(Parameters()).correction
    assert found.law == "placed"
    # Small swing: r = L zeta, so an acceleration per metre is one per radian over L.
    assert found.kp_mps2_per_rad == pytest.approx(placed.kp_per_s2 * 1.5)
    assert found.kd_mps2_per_radps == pytest.approx(placed.kd_per_s * 1.5)
    assert found.damping_ratio_on == placed.damping_ratio
    assert found.on is not None
    assert found.on.frequency_radps == placed.frequency_radps
    assert found.poles_per_s == placed.poles


def test_the_correction_of_the_payload_law_is_what_was_given() -> None:
    control = Control(law="payload", payload_kp_mps2_per_rad=7.0, payload_kd_mps2_per_radps=3.0)
    found = summarise(dataclasses.replace(Parameters(), control=control)).correction
    assert (found.law, found.kp_mps2_per_rad, found.kd_mps2_per_radps) == ("payload", 7.0, 3.0)
    assert found.on is None
    assert found.damping_ratio_on is None
    assert found.poles_per_s == ()
    assert found.damping_ratio_off == design(Parameters()).damping_ratio_off


def test_the_iris_without_correction_swings_as_measured() -> None:
    """Real PX4, 1.5 kg, 0.3 kg on 1.5 m: period 2.33 s, damping ratio 0.06."""
    found = summarise(vehicle_and_load(1.5, 0.3, thrust=IRIS)).correction
    assert found.off.period_s == pytest.approx(2.33, rel=0.02)
    assert found.damping_ratio_off == pytest.approx(0.06, abs=0.015)
