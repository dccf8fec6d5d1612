"""The stated flights: which load, which wind, which manoeuvres, and what is asked of them."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

from swingd.core.swing_ekf import GRAVITY_MPS2
from swingd.model.events import Vec3
from swingd.model.parameters import Parameters, ShaperName

REST: Vec3 = (0.0, 0.0, 0.0)
WINDOW_S = 12.0
"""After a command: over this the swing's RMS and the velocity error are taken."""
REST_PERIODS = 8.5
"""An uncorrected load of damping ratio 0.06 needs seven of its periods from 30 to under 2 deg."""
ACC_BIAS_MPS2 = 0.003
"""Wander of a calibrated accelerometer. Ten times more, as the simulated autopilot has it for what its estimate leaves
over, lets a real one climb by a metre: to a velocity setpoint it has no altitude to hold."""


class Correction(StrEnum):
    """How swingd takes part; `OFF` only estimates."""

    OFF = "off"
    ON = "on"
    SHAPED = "zv"

    def apply(self, parameters: Parameters) -> Parameters:
        return replace(parameters, control=replace(parameters.control, enabled=self is not Correction.OFF))

    @property
    def shaper(self) -> ShaperName:
        return ShaperName.ZV if self is Correction.SHAPED else ShaperName.NONE


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity setpoint that turns at `turn_radps`, 0 for a straight one."""

    ned_mps: Vec3
    turn_radps: float = 0.0

    def at(self, t_s: float) -> Vec3:
        """Velocity `t_s` after its command [m/s]."""
        c, s = math.cos(self.turn_radps * t_s), math.sin(self.turn_radps * t_s)
        north, east, down = self.ned_mps
        return c * north - s * east, s * north + c * east, down


@dataclass(frozen=True, slots=True)
class Position:
    """A position setpoint, from where the manoeuvre began [m]."""

    offset_ned_m: Vec3


@dataclass(frozen=True, slots=True)
class Leg:
    """One command and how long it stands."""

    name: str
    setpoint: Velocity | Position
    duration_s: float


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """Commands one after another at one heading."""

    name: str
    legs: tuple[Leg, ...]
    yaw_deg: float = 0.0
    each: bool = False
    """Whether every leg is judged for itself; else all together, settling counted from the last command."""

    @property
    def duration_s(self) -> float:
        return sum(leg.duration_s for leg in self.legs)


@dataclass(frozen=True, slots=True)
class Asked:
    """What a corrected flight has to reach; None asks nothing."""

    settle_s: float | None = None
    settle_periods: float | None = None
    rms_ratio: float | None = None
    rms_ratio_shaped: float | None = None
    velocity_ratio: float | None = None
    altitude_m: float | None = None
    estimate_rmse_deg: float | None = None
    stop_settle_s: float | None = None
    """Of the last command of a manoeuvre alone."""
    stop_rms_ratio: float | None = None
    correction_mps2: float | None = None
    """Largest acceleration that is added to a setpoint; of a flight in which nothing is to be damped."""


STILL_AIR = Asked(estimate_rmse_deg=0.6)
WINDY = Asked(estimate_rmse_deg=1.4)
BASE = Asked(
    settle_s=2.5, rms_ratio=0.45, rms_ratio_shaped=0.35, velocity_ratio=1.4, altitude_m=0.3, estimate_rmse_deg=0.6
)
NO_LOAD = Asked(estimate_rmse_deg=1.0, correction_mps2=0.0)
OTHER_LOAD = Asked(settle_periods=1.1, altitude_m=0.3, estimate_rmse_deg=0.6)


@dataclass(frozen=True, slots=True)
class Scenario:
    """One flight; flown once for each `Correction`."""

    name: str
    load_kg: float
    cable_m: float
    manoeuvres: Callable[[float], Iterator[Manoeuvre]]
    """Of the pendulum's period [s]."""
    asked: Asked
    wind_ned_mps: Vec3 = REST
    gust_std_mps: float = 0.0
    hooked: bool = True
    """Whether the load that swingd is told of hangs on the hook; else nothing does."""
    built_in: bool = False
    """Whether ArduPilot's own vehicle and slung payload fly. Their load has so much drag that it hangs askew while
    travelling; its swing counts from there."""

    @property
    def period_s(self) -> float:
        """Of the load under a fixed hook [s]."""
        return 2.0 * math.pi * math.sqrt(self.cable_m / GRAVITY_MPS2)

    @property
    def height_m(self) -> float:
        """Of take-off."""
        return self.cable_m + 4.0

    def parameters(self, parameters: Parameters) -> Parameters:
        """Return the parameters of this flight, for swingd and for the simulation alike."""
        return replace(
            parameters,
            payload=replace(parameters.payload, mass_kg=self.load_kg),
            cable=replace(parameters.cable, length_m=self.cable_m),
            simulation=replace(
                parameters.simulation,
                wind_ned_mps=self.wind_ned_mps,
                gust_std_mps=self.gust_std_mps,
                acc_bias_mps2=ACC_BIAS_MPS2,
            ),
        )


def rest_s(period_s: float) -> float:
    """How long an uncorrected load is left to itself, so that the next command finds it quiet."""
    return max(WINDOW_S + 2.0, REST_PERIODS * period_s)


def velocity_step(axis: str, speed_mps: float, yaw_deg: float, period_s: float) -> Manoeuvre:
    """0 -> speed -> 0 along "north" or "east"."""
    velocity = (speed_mps, 0.0, 0.0) if axis == "north" else (0.0, speed_mps, 0.0)
    rest = rest_s(period_s)
    return Manoeuvre(
        f"{axis}, yaw {yaw_deg:g} deg",
        (
            Leg(f"0 -> {speed_mps:g} m/s", Velocity(velocity), rest),
            Leg(f"{speed_mps:g} -> 0 m/s", Velocity(REST), rest),
        ),
        yaw_deg,
        each=True,
    )


def steps(*yaws_deg: float, speed_mps: float = 3.0) -> Callable[[float], Iterator[Manoeuvre]]:
    """Velocity steps north and east at each heading."""

    def manoeuvres(period_s: float) -> Iterator[Manoeuvre]:
        for yaw_deg in yaws_deg:
            for axis in ("north", "east"):
                yield velocity_step(axis, speed_mps, yaw_deg, period_s)

    return manoeuvres


def one_step(speed_mps: float) -> Callable[[float], Iterator[Manoeuvre]]:
    """One velocity step north."""
    return lambda period_s: iter((velocity_step("north", speed_mps, 0.0, period_s),))


def courses(period_s: float) -> Iterator[Manoeuvre]:
    """What applications fly besides steps."""
    rest = rest_s(period_s)
    stop = Leg("stop", Velocity(REST), rest)
    sides = ((4.0, 0.0, 0.0), (0.0, 4.0, 0.0), (-4.0, 0.0, 0.0), (0.0, -4.0, 0.0))
    yield Manoeuvre("square, 4 m/s", (*(Leg("side", Velocity(side), 5.0) for side in sides), stop))
    yield Manoeuvre(
        "position",
        (
            Leg("5 m north", Position((5.0, 0.0, 0.0)), rest),
            Leg("5 m south", Position(REST), rest),
        ),
        each=True,
    )
    radius_m, turn_radps = 6.0, 0.4
    lap = Leg("lap", Velocity((radius_m * turn_radps, 0.0, 0.0), turn_radps), 2.0 * math.pi / turn_radps)
    yield Manoeuvre("circle, 6 m, 0.4 rad/s", (lap, stop))
    yield Manoeuvre("climb", (Leg("3 m up", Position((0.0, 0.0, -3.0)), rest),), each=True)


PX4 = (
    Scenario("steps", 0.3, 1.5, steps(0.0), BASE),
    Scenario("steps-60deg", 0.3, 1.5, steps(60.0), BASE),
    Scenario("steps-135deg", 0.3, 1.5, steps(135.0), BASE),
    Scenario("courses", 0.3, 1.5, courses, STILL_AIR),
    Scenario("wind", 0.3, 1.5, steps(0.0), WINDY, wind_ned_mps=(-4.0, 0.0, 0.0), gust_std_mps=1.0),
    Scenario("0.5kg-3m", 0.5, 3.0, one_step(3.0), OTHER_LOAD),
    Scenario("0.2kg-0.8m", 0.2, 0.8, one_step(3.0), OTHER_LOAD),
    Scenario("0.6kg-1.5m", 0.6, 1.5, one_step(3.0), OTHER_LOAD),
    Scenario("no-load", 0.3, 1.5, steps(0.0), NO_LOAD, wind_ned_mps=(-4.0, 0.0, 0.0), gust_std_mps=1.0, hooked=False),
)
"""On PX4; the first is flown with ``--quick``, its step north alone."""

_NO_WORSE = Asked(rms_ratio=1.0, rms_ratio_shaped=1.0, estimate_rmse_deg=0.6)
_COPTER = (
    # What ArduPilot's applet for slung payloads, which needs an autopilot on the load, reaches on the stop in AUTO.
    (1.0, 5.0, replace(_NO_WORSE, stop_settle_s=1.9, stop_rms_ratio=1.8 / 3.5)),
    (0.5, 5.0, replace(_NO_WORSE, stop_settle_s=5.6, stop_rms_ratio=2.0 / 3.8)),
    (1.0, 10.0, replace(_NO_WORSE, stop_settle_s=6.4, stop_rms_ratio=2.6 / 5.6)),
    (0.5, 3.0, _NO_WORSE),
    (1.0, 2.0, _NO_WORSE),
)
COPTER = tuple(
    Scenario(f"{load_kg:g}kg-{cable_m:g}m", load_kg, cable_m, one_step(4.0), asked)
    for load_kg, cable_m, asked in _COPTER
) + tuple(
    # That load's drag makes it hang askew by up to 8 deg while travelling, which the vehicle cannot tell from its own.
    Scenario(
        f"builtin-{load_kg:g}kg-{cable_m:g}m",
        *(load_kg, cable_m, one_step(4.0), replace(asked, estimate_rmse_deg=None)),
        built_in=True,
    )
    for load_kg, cable_m, asked in _COPTER
)
"""On Copter, with this simulation and with its own."""
