"""The two vehicles of the study: the octarotor of Table 1 and the X500 of section 4.2."""

from dataclasses import dataclass

import numpy as np

from swingd.core.atmosphere import air_density
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.multirotor import MultirotorParam, MultirotorState, Rotor
from swingd.core.px4_cascade import CascadeParam
from swingd.model.estimate import FloatArray
from swingd.model.events import Vec3


@dataclass(frozen=True, slots=True)
class Blade:
    """Geometry of a propeller's blades."""

    count: int
    radius_m: float
    chord_mean_m: float
    chord_75_m: float
    """At 75 % of the radius."""
    lift_slope_per_rad: float
    precone_rad: float
    pitch_root_rad: float
    twist_rad: float
    profile_drag: float
    """Drag coefficient of the section."""

    def packed(self) -> list[float]:
        """Return it in the order of `swingd.core.rotor`."""
        return [
            self.count, self.radius_m, self.chord_mean_m, self.chord_75_m, self.lift_slope_per_rad, self.precone_rad,
            self.pitch_root_rad, self.twist_rad, self.profile_drag,
        ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class RotorUnit:
    """One motor with its propeller."""

    place_frd_m: Vec3
    """Hub from the CG."""
    spin: int
    """+1: counter-clockwise seen from above."""
    thrust_n_s2: float
    """T / Omega^2 at the reference density."""
    torque_nm_s2: float
    """Q / Omega^2 at the reference density."""


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A multirotor with a load on an elastic cable; places are from the CG, frd."""

    mass_kg: float
    inertia_kg_m2: tuple[Vec3, Vec3, Vec3]
    rotors: tuple[RotorUnit, ...]
    blade: Blade
    reference_density_kg_m3: float
    rotor_lag_s: float
    rotor_thrust_max_n: float
    hook_frd_m: Vec3
    centre_of_pressure_frd_m: Vec3
    imu_frd_m: Vec3
    drag_area_m2: Vec3
    load_mass_kg: float
    load_drag_area_m2: float
    cable_length_m: float
    cable_stiffness_n_per_m: float
    cable_damping_ns_per_m: float
    origin_altitude_m: float
    """Of the ned origin in the standard atmosphere."""

    @property
    def weight_n(self) -> float:
        """Of vehicle and load."""
        return (self.mass_kg + self.load_mass_kg) * GRAVITY_MPS2

    def density_ratio(self, down_m: float) -> float:
        """Density of the air over the reference density."""
        return float(air_density(self.origin_altitude_m - down_m)) / self.reference_density_kg_m3

    def packed(self) -> FloatArray:
        """Return the parameters as (MultirotorParam.SIZE,)."""
        index = MultirotorParam
        inertia = np.array(self.inertia_kg_m2)
        p = np.zeros(index.SIZE)
        p[index.MASS] = self.mass_kg
        p[index.INERTIA : index.INERTIA + 9] = inertia.ravel()
        p[index.INERTIA_INV : index.INERTIA_INV + 9] = np.linalg.inv(inertia).ravel()
        p[index.HOOK : index.HOOK + 3] = self.hook_frd_m
        p[index.CENTRE_OF_PRESSURE : index.CENTRE_OF_PRESSURE + 3] = self.centre_of_pressure_frd_m
        p[index.IMU : index.IMU + 3] = self.imu_frd_m
        p[index.DRAG_AREA : index.DRAG_AREA + 3] = self.drag_area_m2
        p[index.ROTOR_LAG] = self.rotor_lag_s
        p[index.REFERENCE_DENSITY] = self.reference_density_kg_m3
        p[index.ORIGIN_ALTITUDE] = self.origin_altitude_m
        p[index.LOAD_MASS] = self.load_mass_kg
        p[index.LOAD_DRAG_AREA] = self.load_drag_area_m2
        p[index.CABLE_LENGTH] = self.cable_length_m
        p[index.CABLE_STIFFNESS] = self.cable_stiffness_n_per_m
        p[index.CABLE_DAMPING] = self.cable_damping_ns_per_m
        p[index.BLADE : index.SIZE] = self.blade.packed()
        return p

    def rotor_table(self) -> FloatArray:
        """Return the rotors as (n, Rotor.SIZE)."""
        table = np.zeros((len(self.rotors), Rotor.SIZE))
        for row, rotor in zip(table, self.rotors, strict=True):
            row[:] = [*rotor.place_frd_m, rotor.spin, rotor.thrust_n_s2, rotor.torque_nm_s2]
        return table

    def allocation(self) -> FloatArray:
        """Return each rotor's thrust per total thrust and per moment: the pseudo-inverse of what they do, (n, 4)."""
        effect = np.array(
            [[1.0, -r.place_frd_m[1], r.place_frd_m[0], r.spin * r.torque_nm_s2 / r.thrust_n_s2] for r in self.rotors]
        ).T
        return np.ascontiguousarray(np.linalg.pinv(effect))

    def hovering(self, pos_ned_m: Vec3, yaw_rad: float, xi_rad: float, zeta_rad: float) -> FloatArray:
        """Return the state of the level vehicle at rest, rotors carrying it, the load at rest on its taut cable."""
        s = MultirotorState
        x = np.zeros(s.OMEGA + len(self.rotors))
        stretch = np.cos(xi_rad) * np.cos(zeta_rad) * self.load_mass_kg * GRAVITY_MPS2 / self.cable_stiffness_n_per_m
        length = self.cable_length_m + stretch
        c, s_yaw = np.cos(yaw_rad), np.sin(yaw_rad)
        ahead = self.hook_frd_m[0] + length * np.sin(zeta_rad)
        right = self.hook_frd_m[1] - length * np.sin(xi_rad) * np.cos(zeta_rad)
        down = self.hook_frd_m[2] + length * np.cos(xi_rad) * np.cos(zeta_rad)
        x[s.POS : s.POS + 3] = pos_ned_m
        x[s.QUAT], x[s.QUAT + 3] = np.cos(0.5 * yaw_rad), np.sin(0.5 * yaw_rad)
        x[s.LOAD_POS : s.LOAD_POS + 3] = pos_ned_m
        x[s.LOAD_POS : s.LOAD_POS + 3] += (c * ahead - s_yaw * right, s_yaw * ahead + c * right, down)
        thrust = self.allocation()[:, 0] * self.weight_n
        gamma = self.density_ratio(pos_ned_m[2])
        x[s.OMEGA :] = np.sqrt(thrust / (gamma * np.array([r.thrust_n_s2 for r in self.rotors])))
        return x


@dataclass(frozen=True, slots=True)
class Autopilot:
    """Gains and limits of the cascade (`swingd.core.px4_cascade`)."""

    pos_p_xy: float
    pos_p_z: float
    vel_p_xy: float
    vel_i_xy: float
    vel_d_xy: float
    vel_p_z: float
    vel_i_z: float
    vel_d_z: float
    vel_d_lag_s: float
    speed_xy_max_mps: float
    speed_up_max_mps: float
    speed_down_max_mps: float
    tilt_max_rad: float
    att_p_tilt: float
    att_p_yaw: float
    rate_max_radps: float
    rate_p_tilt: float
    rate_p_yaw: float
    rate_i: float
    rate_d_tilt: float
    rate_d_lag_s: float

    def packed(self, vehicle: Vehicle, down_m: float) -> FloatArray:
        """Return the parameters as (CascadeParam.SIZE,), for a vehicle whose hover it has learnt at this place."""
        inertia = np.diag(vehicle.inertia_kg_m2)
        gains = [
            self.pos_p_xy, self.pos_p_z, self.vel_p_xy, self.vel_i_xy, self.vel_d_xy, self.vel_p_z, self.vel_i_z,
            self.vel_d_z, self.vel_d_lag_s, self.speed_xy_max_mps, self.speed_up_max_mps, self.speed_down_max_mps,
            self.tilt_max_rad, self.att_p_tilt, self.att_p_yaw, self.rate_max_radps, self.rate_p_tilt,
            self.rate_p_yaw, self.rate_i, self.rate_d_tilt, self.rate_d_lag_s,
        ]  # fmt: skip
        known = [vehicle.weight_n, *inertia, vehicle.density_ratio(down_m), vehicle.rotor_thrust_max_n]
        packed = np.array(gains + known)
        assert packed.size == CascadeParam.SIZE
        return packed


def _octarotor() -> Vehicle:
    """Table 1; stations are measured aft, waterlines up, from a point 0.15 m above the CG."""
    arm, upper_m, lower_m = 0.690, -(-0.024 + 0.150), -(-0.238 + 0.150)
    # Front right, front left, rear left, rear right; neighbours turn against each other, lower rotors against upper.
    places = ((arm, arm, 1), (arm, -arm, -1), (-arm, -arm, 1), (-arm, arm, -1))
    rotors = [RotorUnit((x, y, upper_m), spin, 2.90e-3, 1.25e-4) for x, y, spin in places]
    rotors += [RotorUnit((x, y, lower_m), -spin, 2.20e-3, 1.25e-4) for x, y, spin in places]
    return Vehicle(
        mass_kg=70.0,
        inertia_kg_m2=((10.61, 0.037, -0.043), (0.037, 10.31, -0.003), (-0.043, -0.003, 19.74)),
        rotors=tuple(rotors),
        blade=Blade(
            count=2,
            radius_m=0.5,
            chord_mean_m=0.086,
            chord_75_m=0.103,
            lift_slope_per_rad=5.9,
            precone_rad=0.0,
            pitch_root_rad=0.7854,
            twist_rad=-0.6981,
            profile_drag=0.01,  # not printed
        ),
        reference_density_kg_m3=1.1229,
        rotor_lag_s=0.06,
        rotor_thrust_max_n=420.0,  # not printed: twice the hover's
        hook_frd_m=(0.0, 0.0, 0.150),
        centre_of_pressure_frd_m=(0.0, 0.0, -0.025),
        imu_frd_m=(0.0, 0.0, -0.050),
        drag_area_m2=(0.22, 0.22, 1.03),
        load_mass_kg=100.0,
        load_drag_area_m2=0.5 * 0.785,
        cable_length_m=15.0,
        cable_stiffness_n_per_m=90950.0,
        cable_damping_ns_per_m=0.0,
        origin_altitude_m=0.0,
    )


OCTAROTOR = _octarotor()


def _x500() -> Vehicle:
    """Section 4.2; propellers 1045, frame and rope as such parts are, for the paper does not print them."""
    arm, hub_m = 0.5 / 2.0 * 2.0**-0.5, -0.03
    places = ((arm, arm, 1), (-arm, -arm, 1), (arm, -arm, -1), (-arm, arm, -1))
    return Vehicle(
        mass_kg=2.0,
        inertia_kg_m2=((0.0216, 0.0, 0.0), (0.0, 0.0216, 0.0), (0.0, 0.0, 0.0400)),
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
        rotor_thrust_max_n=11.0,
        hook_frd_m=(0.0, 0.0, 0.15),
        centre_of_pressure_frd_m=(0.0, 0.0, 0.0),
        imu_frd_m=(0.0, 0.0, 0.0),
        drag_area_m2=(0.03, 0.03, 0.06),
        load_mass_kg=0.192,
        load_drag_area_m2=0.5 * 0.00283,
        cable_length_m=1.9,
        cable_stiffness_n_per_m=2000.0,
        cable_damping_ns_per_m=1.9,
        origin_altitude_m=-327.0,  # where the standard atmosphere is as dense as air of 8 deg C and 1020 hPa
    )


X500 = _x500()
