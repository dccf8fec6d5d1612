"""The simulated vehicle, cable and load: the truth."""

from dataclasses import dataclass, fields, replace
from math import asin, atan2, ceil, copysign, cos, hypot, nan, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from swingd.core.slung_plant import (
    GRAVITY,
    PlantInput,
    PlantOutput,
    PlantParam,
    PlantState,
    slung_plant_derivative,
    slung_plant_step,
)
from swingd.model.errors import ConfigurationError
from swingd.model.events import Vec3
from swingd.model.parameters import Cable, Parameters, Payload, Simulation

Quaternion = tuple[float, float, float, float]
Rotors = tuple[float, float, float, float]

DT_S = 0.004
"""Step of the simulation: the autopilot's IMU and its fast loops run at 250 Hz."""
LEG_M = 0.10
"""Height of the vehicle's CG over the ground at rest; the ground is this much under the local origin."""
YAW_MOMENT_M = 0.06
"""Drag moment of a rotor over its thrust."""
WINCH_MPS = 1.0
"""Speed at which the cable's length is changed."""
WINCH_MPS2 = 1.0
"""Acceleration to and from that speed: a tenth of g, so that the cable stays taut."""
KICK_MAX_MPS = 30.0
"""Largest component of a kick."""

_SUBSTEPS_MIN = 4
_SUBSTEPS_MAX = 200
_GROUND_FREQUENCY_RADPS = 60.0
_GROUND_FRICTION = 0.8
_AIR_DENSITY_KG_M3 = 1.225
_RATE_DAMPING_PER_S = 0.1  # of body rates, by the rotors' inflow

# PX4's numbering of a quad x: front right, rear left (both turn counter-clockwise), front left, rear right.
ROTOR_FORWARD = (1.0, -1.0, 1.0, -1.0)
ROTOR_RIGHT = (1.0, -1.0, -1.0, 1.0)
ROTOR_SPIN = (1.0, 1.0, -1.0, -1.0)
"""Sign of the yaw moment on the body, about down."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Everything about one instant; nothing of it is known to the autopilot or to the filter."""

    t_boot_s: float
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    acc_ned_mps2: Vec3
    ned_from_frd: Quaternion
    rates_frd_radps: Vec3
    yaw_rad: float
    load_pos_ned_m: Vec3
    load_vel_ned_mps: Vec3
    xi_rad: float
    """Lateral swing, heading frame; positive with the load to the left; nan while nothing is attached."""
    zeta_rad: float
    """Longitudinal swing, heading frame; positive with the load ahead."""
    xi_rate_radps: float
    """Derivative of the heading-frame angle, the frame's rotation included."""
    zeta_rate_radps: float
    chi_rad: float
    """Total swing: angle between the cable and the vertical."""
    tension_n: float
    thrust_n: float
    thrust_factor: float
    """True thrust over the configured curve at nominal voltage."""
    rotor_commands: Rotors
    specific_force_frd_mps2: Vec3
    """At the IMU, mean over the last step."""
    wind_ned_mps: Vec3
    attached: bool
    taut: bool
    grounded: bool
    load_mass_kg: float
    cable_length_m: float
    """Unstretched."""


class Plant:
    """Vehicle, cable and load, stepped at 250 Hz.

    Parameters
    ----------
    parameters : Parameters
        Sections ``vehicle``, ``payload``, ``cable``, ``thrust`` (the curve) and ``simulation``.

    Raises
    ------
    ConfigurationError
        If the cable is too stiff or too damped for its load to be integrated in reasonable time.

    Notes
    -----
    At the start the vehicle stands on the ground at the local origin, nose to the north; the load lies on the ground
    north of it, with a slack cable.
    """

    def __init__(self, parameters: Parameters) -> None:
        simulation, length_m = parameters.simulation, parameters.cable.length_m
        self._parameters = parameters
        self._hook = parameters.vehicle.hook_frd_m
        self._p = _pack(parameters)
        self._substeps = _substeps(parameters)
        self._wind = simulation.wind_ned_mps
        self._gust_std_mps = simulation.gust_std_mps
        self._gust_time_s = simulation.gust_time_constant_s
        self._random = _gust_generator(simulation.seed)
        self._gust = [0.0, 0.0]
        self._squall: Vec3 = (0.0, 0.0, 0.0)
        self._winch_target_m: float | None = None
        self._x = np.zeros(PlantState.SIZE)
        self._y = np.zeros(PlantOutput.SIZE)
        self._u = np.zeros(PlantInput.SIZE)
        self._x[PlantState.QUAT] = 1.0
        # On its springs the vehicle sinks by g / w0^2.
        self._x[PlantState.POS + 2] = GRAVITY / _GROUND_FREQUENCY_RADPS**2
        self._x[PlantState.LOAD_POS] = min(0.3, 0.5 * length_m)
        self._x[PlantState.LOAD_POS + 2] = LEG_M + GRAVITY / _GROUND_FREQUENCY_RADPS**2
        self._x[PlantState.CABLE_LENGTH] = length_m
        self._u[PlantInput.ATTACHED] = 1.0
        self._u[PlantInput.WIND : PlantInput.WIND + 3] = simulation.wind_ned_mps
        self._t_s = 0.0
        self._steps = 0.0
        slung_plant_derivative(np.empty(PlantState.SIZE), self._y, self._x, self._u, self._p)
        self.state: list[float] = self._x.tolist()
        """State vector after the last step, by `PlantState`."""
        self.output: list[float] = self._y.tolist()
        """Outputs of the last step, by `PlantOutput`."""

    @property
    def t_s(self) -> float:
        """Simulated time since boot [s]."""
        return self._t_s

    @property
    def attached(self) -> bool:
        """Whether the load hangs on the cable."""
        return bool(self._u[PlantInput.ATTACHED] > 0.5)

    @property
    def load_mass_kg(self) -> float:
        """Mass of the load [kg]."""
        return float(self._p[PlantParam.LOAD_MASS])

    @property
    def cable_length_m(self) -> float:
        """Unstretched length of the cable at present [m]."""
        return self.state[PlantState.CABLE_LENGTH]

    @property
    def cable_target_m(self) -> float:
        """Length that the winch works towards, or has reached [m]."""
        return self.cable_length_m if self._winch_target_m is None else self._winch_target_m

    @property
    def mean_wind_ned_mps(self) -> Vec3:
        """Wind without its gusts [m/s]."""
        return self._wind

    @property
    def gust_std_mps(self) -> float:
        """Deviation of the gusts on each horizontal axis [m/s]."""
        return self._gust_std_mps

    @property
    def gust_time_constant_s(self) -> float:
        """Correlation time of the gusts [s]."""
        return self._gust_time_s

    def step(self, rotor_commands: Rotors, voltage_v: float, *, spinning: bool, dt_s: float = DT_S) -> None:
        """Advance by `DT_S`, or by less.

        Parameters
        ----------
        rotor_commands : (4,)
            Throttle of each rotor, 0..1, in PX4's numbering.
        voltage_v : float
            Of the pack; the thrust follows it with the curve's exponent.
        spinning : bool
            False stops the rotors whatever is commanded.
        dt_s : float
            Length of the step, above 0 and at most `DT_S` [s].
        """
        u = self._u
        thrust, simulation = self._parameters.thrust, self._parameters.simulation
        u[0], u[1], u[2], u[3] = rotor_commands
        factor = simulation.thrust_factor * (voltage_v / thrust.voltage_nominal_v) ** thrust.voltage_exponent
        u[PlantInput.THRUST_FACTOR] = factor if spinning else 0.0
        if self._gust_std_mps > 0.0:
            self._blow(dt_s)
        if self._winch_target_m is not None:
            self._wind_cable(self._winch_target_m, dt_s)
        slung_plant_step(self._x, self._y, u, self._p, dt_s, ceil(self._substeps * dt_s / DT_S))
        self._steps += dt_s / DT_S
        self._t_s = self._steps * DT_S
        self.state = self._x.tolist()
        self.output = self._y.tolist()

    def release(self) -> None:
        """Let the load go; it falls and stays behind until `hook`."""
        self._u[PlantInput.ATTACHED] = 0.0

    def hook(self) -> None:
        """Hang the load on the cable at once: straight under the hook, moving with it, the cable taut by its weight.

        Where the ground is nearer than that, it lies on the ground under the hook, at rest, with a slack cable. A load
        that hangs already is brought to rest in the same way.
        """
        s, p, x = PlantState, self._p, self._x
        hook = self._hook
        rotation = rotation_matrix(*x[s.QUAT : s.QUAT + 4].tolist())
        arm_rate = cross((x[s.RATE], x[s.RATE + 1], x[s.RATE + 2]), hook)
        for i in range(3):
            x[s.LOAD_POS + i] = x[s.POS + i] + sum(rotation[i][j] * hook[j] for j in range(3))
            x[s.LOAD_VEL + i] = x[s.VEL + i] + sum(rotation[i][j] * arm_rate[j] for j in range(3))
        x[s.LOAD_POS + 2] += x[s.CABLE_LENGTH] + p[PlantParam.LOAD_MASS] * GRAVITY / p[PlantParam.CABLE_STIFFNESS]
        if x[s.LOAD_POS + 2] > p[PlantParam.GROUND_DOWN]:
            x[s.LOAD_POS + 2] = p[PlantParam.GROUND_DOWN] + GRAVITY / p[PlantParam.GROUND_FREQUENCY] ** 2
            x[s.LOAD_VEL : s.LOAD_VEL + 3] = 0.0
        self._u[PlantInput.ATTACHED] = 1.0
        self.state = x.tolist()

    def kick(self, load_dv_ned_mps: Vec3) -> None:
        """Change the load's velocity at once, as a blow would.

        Parameters
        ----------
        load_dv_ned_mps : (3,)
            What is added to it, each within `KICK_MAX_MPS` [m/s].

        Raises
        ------
        ConfigurationError
            If it is out of bounds.
        """
        if not all(-KICK_MAX_MPS <= v <= KICK_MAX_MPS for v in load_dv_ned_mps):
            shown = ", ".join(f"{v:g}" for v in load_dv_ned_mps)
            raise ConfigurationError(f"kick: {shown} given; expected each of {-KICK_MAX_MPS:g} to {KICK_MAX_MPS:g} m/s")
        self._x[PlantState.LOAD_VEL : PlantState.LOAD_VEL + 3] += load_dv_ned_mps
        self.state = self._x.tolist()

    def set_wind(self, wind_ned_mps: Vec3) -> None:
        """Change the mean wind at once; gusts blow on top of it.

        Parameters
        ----------
        wind_ned_mps : (3,)
            Velocity of the air, within the bounds of ``simulation.wind_ned_mps`` [m/s].

        Raises
        ------
        ConfigurationError
            If it is out of bounds.
        """
        for component in wind_ned_mps:
            _check(Simulation, "wind_ned_mps", component)
        self._wind = wind_ned_mps
        self._mix_wind()

    def set_gusts(self, std_mps: float, time_constant_s: float | None = None, seed: int | None = None) -> None:
        """Change the gusts; their present value stays and grows or dies away within their time constant.

        Parameters
        ----------
        std_mps : float
            Deviation on each horizontal axis, as ``simulation.gust_std_mps`` [m/s]; 0 ends the gusts at once.
        time_constant_s : float, optional
            As ``simulation.gust_time_constant_s`` [s]; by default it stays.
        seed : int, optional
            As ``simulation.seed``: the gusts begin anew from nothing and are the same after every call with this seed.

        Raises
        ------
        ConfigurationError
            If anything is out of bounds; then nothing has changed.
        """
        _check(Simulation, "gust_std_mps", std_mps)
        if time_constant_s is not None:
            _check(Simulation, "gust_time_constant_s", time_constant_s)
        if seed is not None:
            _check(Simulation, "seed", seed)
            self._random = _gust_generator(seed)
        if seed is not None or std_mps == 0.0:
            self._gust = [0.0, 0.0]
        if time_constant_s is not None:
            self._gust_time_s = time_constant_s
        self._gust_std_mps = std_mps
        self._mix_wind()

    def set_squall(self, squall_ned_mps: Vec3) -> None:
        """Let the air move by this besides mean wind and gusts [m/s], until it is told otherwise."""
        self._squall = squall_ned_mps
        self._mix_wind()

    def set_load_mass(self, mass_kg: float) -> None:
        """Change the load's mass at once; it keeps its place and its velocity.

        Parameters
        ----------
        mass_kg : float
            Within the bounds of ``payload.mass_kg`` [kg].

        Raises
        ------
        ConfigurationError
            If it is out of bounds or too light for its cable to be integrated; then nothing has changed.
        """
        _check(Payload, "mass_kg", mass_kg)
        parameters = replace(self._parameters, payload=Payload(mass_kg=mass_kg))
        self._substeps = _substeps(parameters)
        self._parameters = parameters
        self._p[PlantParam.LOAD_MASS] = mass_kg

    def set_cable_length(self, length_m: float) -> None:
        """Let a winch at the hook change the cable's length, at most at `WINCH_MPS` and `WINCH_MPS2`.

        The winch does the work that this takes: reeling in under a swing makes the swing wider, as on a real winch.

        Parameters
        ----------
        length_m : float
            Unstretched, within the bounds of ``cable.length_m`` [m].

        Raises
        ------
        ConfigurationError
            If it is out of bounds.
        """
        _check(Cable, "length_m", length_m)
        self._winch_target_m = length_m

    def place(
        self,
        pos_ned_m: Vec3,
        vel_ned_mps: Vec3 = (0.0, 0.0, 0.0),
        *,
        yaw_rad: float = 0.0,
        xi_rad: float = 0.0,
        zeta_rad: float = 0.0,
        rotors: float = 0.0,
    ) -> None:
        """Put the level vehicle into the air with the load at rest relative to it, the cable stretched by its weight.

        Parameters
        ----------
        pos_ned_m, vel_ned_mps : (3,)
            Of the vehicle's CG.
        yaw_rad : float
            Heading.
        xi_rad, zeta_rad : float
            Swing angles in the heading frame.
        rotors : float
            Throttle to which the rotors' speed already belongs, 0..1.
        """
        p, s = self._p, PlantState
        stretch = cos(xi_rad) * cos(zeta_rad) * p[PlantParam.LOAD_MASS] * GRAVITY / p[PlantParam.CABLE_STIFFNESS]
        cable = float(self._x[s.CABLE_LENGTH])
        length = cable + stretch
        cy, sy = cos(yaw_rad), sin(yaw_rad)
        ahead = self._hook[0] + length * sin(zeta_rad)
        right = self._hook[1] - length * sin(xi_rad) * cos(zeta_rad)
        down = self._hook[2] + length * cos(xi_rad) * cos(zeta_rad)
        x = self._x
        x[:] = 0.0
        x[s.POS : s.POS + 3] = pos_ned_m
        x[s.VEL : s.VEL + 3] = vel_ned_mps
        x[s.QUAT] = cos(0.5 * yaw_rad)
        x[s.QUAT + 3] = sin(0.5 * yaw_rad)
        x[s.ROTOR : s.ROTOR + 4] = rotors
        x[s.LOAD_POS] = pos_ned_m[0] + cy * ahead - sy * right
        x[s.LOAD_POS + 1] = pos_ned_m[1] + sy * ahead + cy * right
        x[s.LOAD_POS + 2] = pos_ned_m[2] + down
        x[s.LOAD_VEL : s.LOAD_VEL + 3] = vel_ned_mps
        x[s.CABLE_LENGTH] = cable
        self.state = x.tolist()

    def truth(self, t_boot_s: float | None = None) -> Truth:
        """Describe the present instant, stamped with ``t_boot_s`` or else with the plant's own time."""
        s, y, u = PlantState, self.output, self._u.tolist()
        x = self.state
        q = x[s.QUAT : s.QUAT + 4]
        rates = (x[s.RATE], x[s.RATE + 1], x[s.RATE + 2])
        rotation = rotation_matrix(q[0], q[1], q[2], q[3])
        yaw = atan2(rotation[1][0], rotation[0][0])
        cy, sy = cos(yaw), sin(yaw)
        hook = self._hook
        arm_rate = cross(rates, hook)
        rel = [0.0, 0.0, 0.0]
        rel_rate = [0.0, 0.0, 0.0]
        for i in range(3):
            row = rotation[i]
            rel[i] = x[s.LOAD_POS + i] - x[s.POS + i] - row[0] * hook[0] - row[1] * hook[1] - row[2] * hook[2]
            rel_rate[i] = (
                x[s.LOAD_VEL + i] - x[s.VEL + i] - row[0] * arm_rate[0] - row[1] * arm_rate[1] - row[2] * arm_rate[2]
            )
        # Rate of the heading: the 3-2-1 yaw rate from the body rates, (q sin(roll) + r cos(roll)) / cos(pitch).
        level = rotation[2][1] ** 2 + rotation[2][2] ** 2
        yaw_rate = (rates[1] * rotation[2][1] + rates[2] * rotation[2][2]) / max(level, 1e-9)
        ahead = cy * rel[0] + sy * rel[1]
        right = -sy * rel[0] + cy * rel[1]
        down = rel[2]
        ahead_rate = cy * rel_rate[0] + sy * rel_rate[1] + yaw_rate * right
        right_rate = -sy * rel_rate[0] + cy * rel_rate[1] - yaw_rate * ahead
        down_rate = rel_rate[2]
        length = sqrt(ahead * ahead + right * right + down * down)
        across = max(hypot(right, down), 1e-9)
        attached = u[PlantInput.ATTACHED] > 0.5
        xi = zeta = xi_rate = zeta_rate = chi = nan
        if attached:
            xi = atan2(-right, down)
            zeta = asin(max(-1.0, min(1.0, ahead / length)))
            chi = atan2(hypot(ahead, right), down)
            xi_rate = (right * down_rate - down * right_rate) / across**2
            length_rate = (ahead * ahead_rate + right * right_rate + down * down_rate) / length
            zeta_rate = (ahead_rate - ahead / length * length_rate) / across
        return Truth(
            t_boot_s=self._t_s if t_boot_s is None else t_boot_s,
            pos_ned_m=(x[0], x[1], x[2]),
            vel_ned_mps=(x[3], x[4], x[5]),
            acc_ned_mps2=(y[PlantOutput.ACC], y[PlantOutput.ACC + 1], y[PlantOutput.ACC + 2]),
            ned_from_frd=(q[0], q[1], q[2], q[3]),
            rates_frd_radps=rates,
            yaw_rad=yaw,
            load_pos_ned_m=(x[s.LOAD_POS], x[s.LOAD_POS + 1], x[s.LOAD_POS + 2]),
            load_vel_ned_mps=(x[s.LOAD_VEL], x[s.LOAD_VEL + 1], x[s.LOAD_VEL + 2]),
            xi_rad=xi,
            zeta_rad=zeta,
            xi_rate_radps=xi_rate,
            zeta_rate_radps=zeta_rate,
            chi_rad=chi,
            tension_n=y[PlantOutput.TENSION],
            thrust_n=y[PlantOutput.THRUST],
            thrust_factor=u[PlantInput.THRUST_FACTOR],
            rotor_commands=(u[0], u[1], u[2], u[3]),
            specific_force_frd_mps2=(
                y[PlantOutput.SPECIFIC_FORCE],
                y[PlantOutput.SPECIFIC_FORCE + 1],
                y[PlantOutput.SPECIFIC_FORCE + 2],
            ),
            wind_ned_mps=(u[PlantInput.WIND], u[PlantInput.WIND + 1], u[PlantInput.WIND + 2]),
            attached=attached,
            taut=y[PlantOutput.TENSION] > 0.0,
            grounded=y[PlantOutput.GROUND_FORCE] > 0.0,
            load_mass_kg=self.load_mass_kg,
            cable_length_m=x[s.CABLE_LENGTH],
        )

    def _blow(self, dt_s: float = DT_S) -> None:
        """Advance the gusts, one Gauss-Markov process on each horizontal axis."""
        tau, std = self._gust_time_s, self._gust_std_mps
        noise = self._random.standard_normal(2)
        for i in range(2):
            self._gust[i] += -self._gust[i] * dt_s / tau + std * sqrt(2.0 * dt_s / tau) * float(noise[i])
        self._mix_wind()

    def _mix_wind(self) -> None:
        for i in range(2):
            self._u[PlantInput.WIND + i] = self._wind[i] + self._gust[i] + self._squall[i]
        self._u[PlantInput.WIND + 2] = self._wind[2] + self._squall[2]

    def _wind_cable(self, target_m: float, dt_s: float) -> None:
        """Choose the winch's speed for the coming step."""
        left_m = target_m - float(self._x[PlantState.CABLE_LENGTH])
        change = WINCH_MPS2 * dt_s
        if abs(left_m) <= change * dt_s:
            self._x[PlantState.CABLE_LENGTH] = target_m
            self._u[PlantInput.CABLE_RATE] = 0.0
            self._winch_target_m = None
            return
        # The speed from which it can still stop in what is left after this step.
        stopping = sqrt(change**2 + 2.0 * WINCH_MPS2 * abs(left_m)) - change
        rate = copysign(min(WINCH_MPS, stopping), left_m)
        before = float(self._u[PlantInput.CABLE_RATE])
        self._u[PlantInput.CABLE_RATE] = min(max(rate, before - change), before + change)


def _gust_generator(seed: int) -> np.random.Generator:
    return np.random.default_rng((seed, 1))


def _check(group: type[Cable | Payload | Simulation], name: str, value: float) -> None:
    """Hold a value against the bounds of its declaration."""
    declared = next(field.metadata for field in fields(group) if field.name == name)
    if not declared["low"] <= value <= declared["high"]:
        raise ConfigurationError(
            f"{group.__name__.lower()}.{name}: {value:g} given; "
            f"expected {declared['low']:g} to {declared['high']:g} {declared['unit']}"
        )


def rotation_matrix(w: float, x: float, y: float, z: float) -> tuple[Vec3, Vec3, Vec3]:
    """Rows of the rotation that a unit quaternion, scalar first, stands for."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def cross(a: Vec3, b: Vec3) -> Vec3:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _pack(parameters: Parameters) -> NDArray[np.float64]:
    """Build the kernel's parameter vector."""
    vehicle, simulation, thrust = parameters.vehicle, parameters.simulation, parameters.thrust
    inertia = simulation.vehicle_inertia_kg_m2
    offset = simulation.arm_m / sqrt(2.0)
    p = np.zeros(PlantParam.SIZE)
    p[PlantParam.MASS] = vehicle.mass_kg
    p[PlantParam.INERTIA : PlantParam.INERTIA + 3] = inertia
    p[PlantParam.HOOK : PlantParam.HOOK + 3] = vehicle.hook_frd_m
    p[PlantParam.IMU : PlantParam.IMU + 3] = vehicle.imu_frd_m
    for i in range(4):
        p[PlantParam.ROTOR_XY + 2 * i] = ROTOR_FORWARD[i] * offset
        p[PlantParam.ROTOR_XY + 2 * i + 1] = ROTOR_RIGHT[i] * offset
        p[PlantParam.ROTOR_SPIN + i] = ROTOR_SPIN[i] * YAW_MOMENT_M
    p[PlantParam.CURVE : PlantParam.CURVE + 3] = thrust.quadratic_n, thrust.linear_n, thrust.offset_n
    p[PlantParam.LAG_UP] = simulation.motor_up_s
    p[PlantParam.LAG_DOWN] = simulation.motor_down_s
    p[PlantParam.DRAG : PlantParam.DRAG + 3] = (
        vehicle.drag_n_per_mps,
        vehicle.drag_n_per_mps,
        vehicle.drag_vertical_n_per_mps,
    )
    p[PlantParam.RATE_DRAG] = _RATE_DAMPING_PER_S * inertia[0]
    p[PlantParam.LOAD_MASS] = parameters.payload.mass_kg
    p[PlantParam.LOAD_DRAG] = 0.5 * _AIR_DENSITY_KG_M3 * simulation.payload_drag_area_m2
    p[PlantParam.CABLE_STIFFNESS] = simulation.cable_stiffness_n_per_m
    p[PlantParam.CABLE_DAMPING] = simulation.cable_damping_n_s_per_m
    p[PlantParam.GROUND_DOWN] = LEG_M
    p[PlantParam.LEG] = LEG_M
    p[PlantParam.GROUND_FREQUENCY] = _GROUND_FREQUENCY_RADPS
    p[PlantParam.GROUND_FRICTION] = _GROUND_FRICTION
    return p


def _substeps(parameters: Parameters) -> int:
    """Choose how finely a step must be cut for the cable's spring and damper."""
    simulation, vehicle = parameters.simulation, parameters.vehicle
    # The hook's end of the cable moves with the body's mass and, off the CG, with its inertia.
    arm = sqrt(sum(h * h for h in vehicle.hook_frd_m))
    inverse_mass = (
        1.0 / parameters.payload.mass_kg + 1.0 / vehicle.mass_kg + arm**2 / min(simulation.vehicle_inertia_kg_m2)
    )
    rate = (
        sqrt(simulation.cable_stiffness_n_per_m * inverse_mass)
        + simulation.cable_damping_n_s_per_m * inverse_mass
        + 1.0 / min(simulation.motor_up_s, simulation.motor_down_s)
    )
    # The feet push and rub at the end of their lever arms.
    lever = 1.0 + vehicle.mass_kg * (simulation.arm_m**2 + LEG_M**2) / min(simulation.vehicle_inertia_kg_m2)
    rubbing = _GROUND_FRICTION * GRAVITY / 0.05
    rate = max(rate, _GROUND_FREQUENCY_RADPS * sqrt(lever) + (1.4 * _GROUND_FREQUENCY_RADPS + rubbing) * lever)
    substeps = max(_SUBSTEPS_MIN, ceil(DT_S * rate))
    if substeps > _SUBSTEPS_MAX:
        raise ConfigurationError(
            f"simulation: cable_stiffness_n_per_m = {simulation.cable_stiffness_n_per_m:g}, "
            f"cable_damping_n_s_per_m = {simulation.cable_damping_n_s_per_m:g}, payload.mass_kg = "
            f"{parameters.payload.mass_kg:g}, vehicle.mass_kg = {vehicle.mass_kg:g} "
            f"and vehicle_inertia_kg_m2 = {simulation.vehicle_inertia_kg_m2} make motions of "
            f"{rate:.0f} 1/s; expected at most {_SUBSTEPS_MAX / DT_S:.0f} 1/s"
        )
    return substeps
