"""Text commands that change a simulation while it runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees

from swingd.model.errors import ConfigurationError
from swingd.model.events import Vec3
from swingd.sim.faults import KINDS, Faults, parse_fault
from swingd.sim.faults import USAGE as FAULT_USAGE
from swingd.sim.plant import WINCH_MPS, Plant

_SHOWN_MAX = 60


@dataclass(frozen=True, slots=True)
class _Command:
    """One command: how it is written, what it does, how many numbers it takes."""

    usage: str
    text: str
    numbers: tuple[int, ...]
    run: Callable[[Plant, list[float]], str]
    """Gets as many numbers as one of ``numbers`` says; returns the answer, raises `ConfigurationError`."""


class Console:
    """Understands lines of text about a plant.

    Parameters
    ----------
    plant : Plant
        What the commands change.
    faults : Faults, optional
        Of a simulated autopilot; a real one has its own, and takes none from here.
    """

    def __init__(self, plant: Plant, faults: Faults | None = None) -> None:
        self._plant = plant
        self._faults = faults

    def execute(self, line: str) -> str:
        """Obey one line; never raises, whatever it says.

        Parameters
        ----------
        line : str
            A command of `USAGE` and its numbers, separated by blanks.

        Returns
        -------
        str
            One line without its end: ``ok`` and what is so now, or ``error:`` and what was given and expected; after
            an error nothing has changed.
        """
        words = line.split()
        if not words:
            return f"error: no command given; expected one of {_NAMES}"
        name, given = words[0].lower(), _shown(words)
        if name == "help":
            return _help(words[1:])
        if name == "fault":
            try:
                return f"ok {self._fault(words[1:])}"
            except ConfigurationError as error:
                return f"error: {error}"
        command = _COMMANDS.get(name)
        if command is None:
            return f"error: {given}: no such command; expected one of {_NAMES}"
        numbers: list[float] = []
        for word in words[1:]:
            try:
                numbers.append(float(word))
            except ValueError:
                return f"error: {given}: {_shown([word])} is no number; expected {command.usage}: {command.text}"
        if len(numbers) not in command.numbers:
            count = f"{len(numbers)} number{'' if len(numbers) == 1 else 's'}"
            return f"error: {given}: {count} given; expected {command.usage}: {command.text}"
        try:
            return f"ok {command.run(self._plant, numbers)}"
        except ConfigurationError as error:
            return f"error: {given}: {error}"

    def _fault(self, words: list[str]) -> str:
        faults = self._faults
        if faults is None:
            raise ConfigurationError("fault: the autopilot is a real one; expected a simulated one")
        if words == ["off"]:
            faults.clear()
            return "no faults"
        if words:
            fault = parse_fault(" ".join(words)).after(self._plant.t_s)
            faults.inject(fault)
            return f"fault {fault}"
        return "; ".join(map(str, faults.at_work + faults.planned)) or "no faults"


def _wind(plant: Plant, numbers: list[float]) -> str:
    plant.set_wind(_vector(numbers))
    return f"wind {_triple(plant.mean_wind_ned_mps)} m/s"


def _gust(plant: Plant, numbers: list[float]) -> str:
    std_mps, time_s, seed = (*numbers, None, None)[:3]
    if seed is not None and not seed.is_integer():
        raise ConfigurationError(f"simulation.seed: {seed:g} given; expected a whole number")
    plant.set_gusts(std_mps or 0.0, time_s, None if seed is None else int(seed))
    return f"gusts of {plant.gust_std_mps:g} m/s, {plant.gust_time_constant_s:g} s"


def _release(plant: Plant, _numbers: list[float]) -> str:
    plant.release()
    return "load released"


def _hook(plant: Plant, _numbers: list[float]) -> str:
    plant.hook()
    return f"load of {plant.load_mass_kg:g} kg hooked, cable {plant.cable_length_m:.3g} m"


def _kick(plant: Plant, numbers: list[float]) -> str:
    plant.kick(_vector(numbers))
    return f"load kicked by {_triple(_vector(numbers))} m/s"


def _mass(plant: Plant, numbers: list[float]) -> str:
    plant.set_load_mass(numbers[0])
    return f"load {plant.load_mass_kg:g} kg"


def _length(plant: Plant, numbers: list[float]) -> str:
    plant.set_cable_length(numbers[0])
    return f"cable from {plant.cable_length_m:.3g} to {plant.cable_target_m:g} m, at most {WINCH_MPS:g} m/s"


def _status(plant: Plant, _numbers: list[float]) -> str:
    truth = plant.truth()
    if truth.attached:
        swing = f"swing_lateral_deg={_tenths(truth.xi_rad)} swing_longitudinal_deg={_tenths(truth.zeta_rad)}"
        load = f"{'taut' if truth.taut else 'slack'} {swing} tension_n={truth.tension_n:.2f}"
    else:
        load = "released"
    north, east, down = truth.pos_ned_m
    return (
        f"t_s={plant.t_s:.2f} veh_ned_m={north:.2f},{east:.2f},{down:.2f} load_kg={plant.load_mass_kg:g} "
        f"cable_m={plant.cable_length_m:.3g} load={load} wind_ned_mps={_comma(plant.mean_wind_ned_mps)} "
        f"gust_mps={plant.gust_std_mps:g} gust_time_s={plant.gust_time_constant_s:g}"
    )


_COMMANDS: Mapping[str, _Command] = {
    "wind": _Command("wind N E [D]", "mean velocity of the air to north, east, down [m/s]", (2, 3), _wind),
    "gust": _Command(
        "gust STD [TIME [SEED]]",
        "deviation of the gusts on each horizontal axis [m/s], their time constant [s]; with a seed they begin anew",
        (1, 2, 3),
        _gust,
    ),
    "release": _Command("release", "let the load fall", (0,), _release),
    "hook": _Command("hook", "hang the load under the vehicle, at rest", (0,), _hook),
    "kick": _Command("kick N E [D]", "change the load's velocity at once [m/s]", (2, 3), _kick),
    "mass": _Command("mass KG", "mass of the load [kg]", (1,), _mass),
    "length": _Command("length M", "let a winch change the cable's length [m]", (1,), _length),
    "status": _Command("status", "what is so now", (0,), _status),
}
_FAULT = "fault [TEXT]"
_NAMES = ", ".join((*_COMMANDS, "fault", "help"))
USAGE = " | ".join((*(command.usage for command in _COMMANDS.values()), _FAULT, "help [COMMAND]"))
"""Every command."""


def _help(words: list[str]) -> str:
    if not words:
        return f"ok {USAGE}"
    if words[0].lower() == "fault":
        return (
            f"ok {_FAULT}: show all faults, end them (off), or inject one: {FAULT_USAGE}, times counted from now [s]; "
            f"KIND: {', '.join(KINDS)}"
        )
    command = _COMMANDS.get(words[0].lower())
    if command is None:
        return f"error: {_shown(['help', *words])}: no such command; expected one of {_NAMES}"
    return f"ok {command.usage}: {command.text}"


def _vector(numbers: list[float]) -> Vec3:
    north, east, down = (*numbers, 0.0)[:3]
    return (north, east, down)


def _triple(vector: Vec3) -> str:
    return " ".join(f"{value:g}" for value in vector)


def _comma(vector: Vec3) -> str:
    return ",".join(f"{value:g}" for value in vector)


def _tenths(angle_rad: float) -> str:
    return f"{round(degrees(angle_rad), 1) + 0.0:.1f}"  # no -0.0


def _shown(words: list[str]) -> str:
    """Give back what was said, on one line, harmless to a terminal and not too long."""
    text = " ".join(words)
    if not (text.isascii() and text.isprintable()):
        text = ascii(text)
    return text if len(text) <= _SHOWN_MAX else text[:_SHOWN_MAX] + "..."
