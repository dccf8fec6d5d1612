"""A propeller's inflow and in-plane loads against blade elements summed by brute force, and the standard atmosphere."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from swingd.core import rotor
from swingd.core.atmosphere import air_density

DENSITY = 1.19
OMEGA = 270.0

OCTAROTOR = np.array([2, 0.5, 0.086, 0.103, 5.9, 0.0, 0.7854, -0.6981, 0.01])
CONED = np.array([3, 0.4, 0.03, 0.033, 5.7, 0.06, 0.4, -0.25, 0.012])
BLADES = pytest.mark.parametrize("blade", [OCTAROTOR, CONED], ids=["octarotor", "coned"])


def induced(axial, inplane, omega=OMEGA, blade=OCTAROTOR, guess=10.0, density=DENSITY):
    return rotor.induced_velocity(guess, axial, inplane, omega, density, blade)


def loads(inflow, inplane, omega=OMEGA, blade=OCTAROTOR, density=DENSITY):
    out = np.full(3, np.nan)
    rotor.inplane_loads(out, inflow, inplane, omega, density, blade)
    return out


class BladeElements:
    """Lift and drag of every element, summed over radius (Gauss) and mean over azimuth (rectangles, exact for these).

    Level axes: downstream, towards the advancing side, up. Angles are small: what is tilted by them keeps its length.
    """

    def __init__(self, inflow, inplane, omega, blade, lift_chord, drag_chord):
        nodes, weights = np.polynomial.legendre.leggauss(8)
        radius, a0 = blade[rotor.RADIUS], blade[rotor.PRECONE]
        r = 0.5 * radius * (nodes + 1.0)
        psi = np.arange(12)[:, None] * math.tau / 12
        theta = blade[rotor.PITCH_ROOT] + blade[rotor.TWIST] * r / radius
        u_t = omega * r + inplane * np.sin(psi)
        u_p = inflow + inplane * a0 * np.cos(psi) + 0.0 * r
        half = 0.5 * DENSITY * blade[rotor.BLADES] * 0.5 * radius * weights / 12
        lift = half * lift_chord * blade[rotor.LIFT_SLOPE] * (theta * u_t**2 - u_p * u_t)
        induced_drag = half * lift_chord * blade[rotor.LIFT_SLOPE] * (theta * u_t * u_p - u_p**2)
        drag = induced_drag + half * drag_chord * blade[rotor.PROFILE_DRAG] * u_t**2
        zero = np.zeros_like(lift)
        outward = np.stack([np.cos(psi) + zero, np.sin(psi) + zero, zero])
        ahead = np.stack([-np.sin(psi) + zero, np.cos(psi) + zero, zero])
        # The lift stands on the coned blade: it leans inwards.
        element = np.stack([zero, zero, lift]) - a0 * lift * outward - drag * ahead
        self.force = element.sum(axis=(1, 2))
        self.moment = np.cross(r * outward, element, axis=0).sum(axis=(1, 2))


@BLADES
@pytest.mark.parametrize(("axial", "inplane"), [(0.0, 6.0), (3.0, 12.0), (-4.0, 9.0), (6.0, 0.5)])
def test_inplane_loads_are_the_sum_of_the_elements(blade, axial, inplane):
    w = induced(axial, inplane, blade=blade) + axial
    along, across, hub = loads(w, inplane, blade=blade)
    elements = BladeElements(w, inplane, OMEGA, blade, blade[rotor.CHORD_MEAN], blade[rotor.CHORD_75])
    downstream, advancing, _ = elements.force
    assert along == pytest.approx(downstream, rel=1e-12)
    assert across == pytest.approx(advancing, rel=1e-12, abs=1e-13)
    # About the axis that points downstream, a lift on the advancing side turns by the right hand.
    lift_alone = BladeElements(w, inplane, OMEGA, blade, blade[rotor.CHORD_MEAN], 0.0)
    assert hub == pytest.approx(lift_alone.moment[0], rel=1e-12)


@BLADES
@pytest.mark.parametrize(("axial", "inplane"), [(0.0, 0.0), (0.0, 8.0), (5.0, 3.0), (15.0, 0.0), (-3.0, 6.0)])
def test_induced_velocity_balances_the_elements_with_the_momentum(blade, axial, inplane):
    """Glauert's disc: T = 2 rho A v sqrt(V^2 + w^2), T summed over the elements."""
    area = math.pi * blade[rotor.RADIUS] ** 2

    def excess(v):
        w = v + axial
        chord = blade[rotor.CHORD_75]
        thrust = BladeElements(w, inplane, OMEGA, blade, chord, chord).force[2]
        return 2.0 * DENSITY * area * v * math.hypot(inplane, w) - thrust

    expected = brentq(excess, max(0.0, -axial), 60.0, xtol=1e-12)
    assert induced(axial, inplane, blade=blade) == pytest.approx(expected, abs=2e-9)  # the kernel softens the root


def test_hover_by_hand():
    """2 rho A v^2 + rho/4 a b c75 Omega R^2 v = rho/2 a b c75 R (Omega R)^2 (theta_0/3 + theta_t/4)."""
    # In units of rho, with A = 0.7854 m^2, a b c75 = 1.2154 m and tip speed 135 m/s:
    quadratic, linear, constant = 1.5708, 0.25 * 1.2154 * 67.5, -0.5 * 1.2154 * 0.5 * 135.0**2 * 0.087275
    by_hand = (-linear + math.sqrt(linear**2 - 4.0 * quadratic * constant)) / (2.0 * quadratic)
    assert 11.0 < by_hand < 13.0
    assert induced(0.0, 0.0) == pytest.approx(by_hand, rel=1e-4)
    assert induced(0.0, 0.0, density=0.7) == pytest.approx(by_hand, rel=1e-4)


def test_climbing_takes_inflow_away_and_advancing_too():
    hover = induced(0.0, 0.0)
    assert induced(3.0, 0.0) < hover < induced(-3.0, 0.0)
    assert induced(0.0, 10.0) < hover


@pytest.mark.parametrize("guess", [-5.0, 0.0, 1.0, 10.0, 80.0])
def test_the_guess_does_not_matter(guess):
    assert induced(1.0, 7.0, guess=guess) == pytest.approx(induced(1.0, 7.0), abs=1e-10)


@pytest.mark.parametrize("omega", [0.0, 40.0, OMEGA])
def test_inflow_stays_finite_and_not_negative(omega):
    """In a fast descent too, where momentum theory has no answer."""
    found = [induced(axial, inplane, omega) for axial in np.linspace(-30.0, 60.0, 19) for inplane in (0.0, 1.0, 25.0)]
    speeds = np.array(found)
    assert np.all((speeds >= 0.0) & (speeds < 100.0))


def test_at_rest_there_is_nothing_along_the_disc():
    np.testing.assert_array_equal(loads(induced(0.0, 0.0), 0.0), 0.0)


def test_moving_is_braked_and_lifts_the_advancing_side():
    along, across, hub = loads(induced(0.0, 5.0), 5.0)
    assert along > 0.0
    assert across == 0.0  # without coning
    assert hub > 0.0


def test_coning_pushes_towards_the_retreating_side():
    """The advancing side's greater lift leans inwards, away from its side."""
    _, across, _ = loads(induced(0.0, 5.0, blade=CONED), 5.0, blade=CONED)
    assert across < 0.0


@pytest.mark.parametrize(("altitude_m", "published"), [(0.0, 1.2250), (1000.0, 1.1117), (5000.0, 0.73643)])
def test_density_of_the_standard_atmosphere(altitude_m, published):
    """U.S. Standard Atmosphere, 1976, table I by geometric altitude; the function's is geopotential."""
    earth_m = 6356766.0
    geopotential_m = earth_m * altitude_m / (earth_m + altitude_m)
    assert air_density(geopotential_m) == pytest.approx(published, rel=5e-5)


@pytest.mark.parametrize(("altitude_m", "published"), [(1000.0, 1.11164), (5000.0, 0.736116)])
def test_density_by_geopotential_altitude(altitude_m, published):
    """ISO 2533, table 5."""
    assert air_density(altitude_m) == pytest.approx(published, rel=1e-5)
