"""The vehicles of sections VI.A and VI.C; masses and cable are printed, the rest is as such parts are."""

from dataclasses import replace

from swingd.studies.drones2023.vehicles import X500

CABLE_M = 1.6
"""From the vehicle's centre of mass to the load's along the unstretched cable: what the filter is told."""
_HOOK_M = 0.05


SIMULATED = replace(
    X500,
    mass_kg=1.52,
    inertia_kg_m2=((0.0165, 0.0, 0.0), (0.0, 0.0165, 0.0), (0.0, 0.0, 0.0300)),
    rotor_thrust_max_n=12.0,
    hook_frd_m=(0.0, 0.0, _HOOK_M),
    load_mass_kg=0.5,
    load_drag_area_m2=0.055,  # a parcel of 0.25 by 0.2 m
    cable_length_m=CABLE_M - _HOOK_M,
    cable_stiffness_n_per_m=300.0,  # a cord of nylon: 16 mm under the load's weight
    cable_damping_ns_per_m=2.0,
    origin_altitude_m=0.0,
)
"""Section VI.A: 1.52 kg, 0.5 kg, 1.6 m."""

FLOWN = replace(SIMULATED, mass_kg=1.09, inertia_kg_m2=((0.0110, 0.0, 0.0), (0.0, 0.0110, 0.0), (0.0, 0.0, 0.0200)),
                load_mass_kg=0.54)  # fmt: skip
"""Section VI.C: 1.09 kg, 0.54 kg; the cable's length is not printed, that of section VI.A is taken."""
