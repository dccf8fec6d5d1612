"""The vehicles of sections VI.A and VI.C; masses and cable are printed, the rest is as such parts are."""

from dataclasses import replace

from swingd.studies.drones2023.vehicles import Blade, RotorUnit, Vehicle

CABLE_M = 1.6
"""From the vehicle's centre of mass to the load's along the unstretched cable: what the filter is told."""
_HOOK_M = 0.05


def _quadrotor() -> Vehicle:
    arm, hub_m = 0.5 / 2.0 * 2.0**-0.5, -0.03
    places = ((arm, arm, 1), (-arm, -arm, 1), (arm, -arm, -1), (-arm, arm, -1))
    return Vehicle(
        mass_kg=1.52,
        inertia_kg_m2=((0.0165, 0.0, 0.0), (0.0, 0.0165, 0.0), (0.0, 0.0, 0.0300)),
        rotors=tuple(RotorUnit((x, y, hub_m), spin, 1.42e-5, 2.35e-7) for x, y, spin in places),
        blade=Blade(
            count=2,
            radius_m=0.127,
            chord_mean_m=0.021,
            chord_75_m=0.018,
            lift_slope_per_rad=5.7,
            precone_rad=0.0,
            pitch_root_rad=0.42,
            twist_rad=-0.30,
            profile_drag=0.02,
        ),
        reference_density_kg_m3=1.225,
        rotor_lag_s=0.03,
        rotor_thrust_max_n=12.0,
        hook_frd_m=(0.0, 0.0, _HOOK_M),
        centre_of_pressure_frd_m=(0.0, 0.0, 0.0),
        imu_frd_m=(0.0, 0.0, 0.0),
        drag_area_m2=(0.03, 0.03, 0.06),
        load_mass_kg=0.5,
        load_drag_area_m2=0.055,  # a parcel of 0.25 by 0.2 m
        cable_length_m=CABLE_M - _HOOK_M,
        cable_stiffness_n_per_m=300.0,  # a cord of nylon: 16 mm under the load's weight
        cable_damping_ns_per_m=2.0,
        origin_altitude_m=0.0,
    )


SIMULATED = _quadrotor()
"""Section VI.A: 1.52 kg, 0.5 kg, 1.6 m."""

FLOWN = replace(SIMULATED, mass_kg=1.09, inertia_kg_m2=((0.0110, 0.0, 0.0), (0.0, 0.0110, 0.0), (0.0, 0.0, 0.0200)),
                load_mass_kg=0.54)  # fmt: skip
"""Section VI.C: 1.09 kg, 0.54 kg; the cable's length is not printed, that of section VI.A is taken."""
