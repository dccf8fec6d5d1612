"""Forces of a propeller in the plane of its disc, by blade elements in a uniform inflow.

Blade elements at radius r and azimuth psi (0 downstream) of a rigid blade with linear twist theta(r) = theta_0 +
theta_t r / R and pre-cone a_0 see the speeds U_T = Omega r + V sin psi in the disc's plane and U_P = w + V a_0 cos psi
through it, w = v_i + V_c: induced and axial flow. Integrated over r = 0..R and averaged over psi, with lift
0.5 rho c a (theta U_T^2 - U_P U_T) and profile drag 0.5 rho c c_d U_T^2.
"""

from math import pi, sqrt

from swingd.core._jit import F8, VEC, VOID, kernel

INFLOW_ITERATIONS_MAX = 30
INFLOW_TOLERANCE_MPS = 1e-5
"""Of Newton's last step; what it leaves goes with the step's square, 1e-11 m/s."""

# Offsets into the blade's description.
BLADES = 0
RADIUS = 1
"""[m]"""
CHORD_MEAN = 2
"""[m]"""
CHORD_75 = 3
"""At 75 % of the radius, where the lift weighs [m]."""
LIFT_SLOPE = 4
"""[1/rad]"""
PRECONE = 5
"""[rad]"""
PITCH_ROOT = 6
"""[rad]"""
TWIST = 7
"""Pitch at the tip minus pitch at the root [rad]."""
PROFILE_DRAG = 8
BLADE_SIZE = 9


@kernel(F8(F8, F8, F8, F8, F8, VEC))
def induced_velocity(guess_mps, axial_mps, inplane_mps, omega_radps, density_kg_m3, blade):
    """Find the uniform induced velocity at which blade elements and momentum theory give the same thrust.

    Parameters
    ----------
    guess_mps : float
        Where Newton's method starts, the value of the instant before for one; positive down through the disc.
    axial_mps : float
        Air that flows down through the disc beside the induced velocity: the climb's speed along the axis.
    inplane_mps : float
        Speed of the air along the disc.
    omega_radps : float
        Speed of rotation, >= 0.
    density_kg_m3 : float
        Of the air.
    blade : (BLADE_SIZE,)
        Geometry.

    Returns
    -------
    float
        Induced velocity, >= 0 [m/s].
    """
    radius = blade[RADIUS]
    lift = 0.5 * density_kg_m3 * blade[LIFT_SLOPE] * blade[BLADES] * blade[CHORD_75] * radius
    pitch = omega_radps * omega_radps * radius * radius * (blade[PITCH_ROOT] / 3.0 + blade[TWIST] / 4.0)
    pitch += inplane_mps * inplane_mps * (0.5 * blade[PITCH_ROOT] + 0.25 * blade[TWIST])
    slope = 0.5 * omega_radps * radius
    disc = 2.0 * density_kg_m3 * pi * radius * radius
    v = max(guess_mps, 0.0)
    for _ in range(INFLOW_ITERATIONS_MAX):
        w = v + axial_mps
        through = sqrt(inplane_mps * inplane_mps + w * w) + 1e-9
        excess = disc * v * through - lift * (pitch - w * slope)
        rising = disc * (through + v * w / through) + lift * slope
        # In a fast descent momentum theory has several branches; the one that is followed is the rising one.
        step = excess / max(rising, 0.1 * lift * slope + 1e-9)
        v_next = max(v - step, 0.0)
        if abs(v_next - v) < INFLOW_TOLERANCE_MPS:
            return v_next
        v = v_next
    return v


@kernel(VOID(VEC, F8, F8, F8, F8, VEC))
def inplane_loads(loads_out, inflow_mps, inplane_mps, omega_radps, density_kg_m3, blade):
    """Give drag, side force and moment of the hub of a propeller that moves through the air.

    Parameters
    ----------
    loads_out : (3,), written
        Force against the motion [N]; force across it, towards the side where the blade advances [N]; moment about the
        direction of motion, positive where the advancing side is lifted [N m].
    inflow_mps : float
        All the air through the disc, induced and axial.
    inplane_mps : float
        Speed of the hub through the air along the disc.
    omega_radps, density_kg_m3, blade
        As for `induced_velocity`.
    """
    radius, a0 = blade[RADIUS], blade[PRECONE]
    root, twist = blade[PITCH_ROOT], blade[TWIST]
    w, V = inflow_mps, inplane_mps
    tip = omega_radps * radius
    half = 0.5 * density_kg_m3 * blade[BLADES] * radius
    lift = half * blade[CHORD_MEAN] * blade[LIFT_SLOPE]
    profile = half * blade[CHORD_75] * blade[PROFILE_DRAG]
    mean_pitch = root + 0.5 * twist
    loads_out[0] = 0.5 * V * (profile * tip + lift * (w * mean_pitch + 0.5 * a0 * a0 * tip))
    loads_out[1] = -1.5 * lift * a0 * V * (tip * (root / 2.0 + twist / 3.0) - w)
    loads_out[2] = lift * radius * V * (tip * (root / 3.0 + twist / 4.0) - 0.25 * w)
