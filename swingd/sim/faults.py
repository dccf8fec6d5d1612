"""Faults as data, and the one place where they are let loose on a simulation."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from swingd.model.errors import ConfigurationError
from swingd.sim import fault_effects as effects
from swingd.sim.fault_effects import Direction, Effect

if TYPE_CHECKING:
    from swingd.sim.peer import SimulatedAutopilot

_SHOWN_MAX = 60
_STREAM = 5
"""Which of the simulation's random streams is the faults'."""


@dataclass(frozen=True, slots=True)
class Strength:
    """What the number of a fault means."""

    default: float
    unit: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One fault that can be injected."""

    text: str
    strength: Strength | None
    """None for a fault that is there or not."""
    make: type[Effect]


def _share(default: float) -> Strength:
    return Strength(default, "share of the frames", 0.0, 1.0)


KINDS: Mapping[str, FaultKind] = {
    "loss": FaultKind("frames are lost, both ways", _share(0.2), effects.Loss),
    "gap": FaultKind("nothing passes, either way", None, effects.Gap),
    "duplicate": FaultKind("frames come twice", _share(1.0), effects.Duplicate),
    "reorder": FaultKind("frames are overtaken by up to 60 ms", _share(0.33), effects.Reorder),
    "jitter": FaultKind(
        "the link stalls for up to this, again and again", Strength(0.2, "s", 0.0, 5.0), effects.Jitter
    ),
    "delay": FaultKind("every frame is late, each way", Strength(0.15, "s", 0.0, 5.0), effects.Delay),
    "corrupt": FaultKind("frames with a wrong byte, and noise between them", _share(0.1), effects.Corrupt),
    "nan": FaultKind(
        "messages with a number that is NaN or infinite", Strength(0.2, "share", 0.0, 1.0), effects.NotANumber
    ),
    "clock": FaultKind("the autopilot's clock steps", Strength(-15.0, "s", -1e6, 1e6), effects.Clock),
    "imu_frozen": FaultKind("the published inertial sample stays the same", None, effects.ImuFrozen),
    "acc_bias": FaultKind(
        "the published acceleration is wrong, forward and to the right",
        Strength(0.5, "m/s^2", -20.0, 20.0),
        effects.AccBias,
    ),
    "vibration": FaultKind(
        "the rotors shake the accelerometer, on top of simulation.vibration_mps2",
        Strength(30.0, "m/s^2", 0.0, 200.0),
        effects.Vibrate,
    ),
    "voltage": FaultKind("the reported voltage is this", Strength(0.0, "V", 0.0, 65.0), effects.Voltage),
    "voltage_frozen": FaultKind("the reported voltage stays the same", None, effects.VoltageFrozen),
    "sag": FaultKind("the true voltage is lower than the reported one", Strength(0.1, "share", 0.0, 0.9), effects.Sag),
    "attitude": FaultKind(
        "the autopilot's roll and pitch are reset to something wrong",
        Strength(0.1, "rad", -0.5, 0.5),
        effects.AttitudeReset,
    ),
    "yaw": FaultKind("the autopilot's heading is reset", Strength(0.5, "rad", -3.2, 3.2), effects.YawJump),
    "reboot": FaultKind("the autopilot starts anew, disarmed", None, effects.Reboot),
    "gust": FaultKind("gusts with this peak, one after the other", Strength(12.0, "m/s", 0.0, 30.0), effects.Gust),
    "slack": FaultKind("the load is thrown up", Strength(3.0, "m/s", 0.0, 30.0), effects.Jerk),
    "power": FaultKind("the motors lose throttle", Strength(0.2, "share", 0.0, 1.0), effects.Power),
    "rival": FaultKind(
        "a second companion behind the autopilot asks it to fly north", Strength(0.5, "m/s", -30.0, 30.0), effects.Rival
    ),
    "flood": FaultKind("parameters of swingd are asked for", Strength(500.0, "1/s", 0.0, 1e4), effects.Flood),
}
"""Every kind of fault, by name."""
USAGE = "KIND [STRENGTH] [START..END]"
"""How one fault is written; without END until the end, without times at once and until the end."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: what, how strong, from when until when.

    Raises
    ------
    ConfigurationError
        If there is no such kind, or a number is out of bounds.
    """

    kind: str
    """Name in `KINDS`."""
    strength: float | None = None
    """In the unit of its kind; None: the kind's default."""
    start_s: float = 0.0
    """Simulated time [s]; a time that has passed means at once."""
    end_s: float = inf

    def __post_init__(self) -> None:
        kind = KINDS.get(self.kind)
        if kind is None:
            raise ConfigurationError(f"fault {_shown(self.kind)}: no such kind; expected one of {', '.join(KINDS)}")
        if kind.strength is None:
            if self.strength is not None:
                raise ConfigurationError(f"fault {self.kind}: strength {self.strength:g} given; expected none")
        else:
            bounds = kind.strength
            if self.strength is None:
                object.__setattr__(self, "strength", bounds.default)
            elif not bounds.low <= self.strength <= bounds.high:
                raise ConfigurationError(
                    f"fault {self.kind}: strength {self.strength:g} given; "
                    f"expected {bounds.low:g} to {bounds.high:g} ({bounds.unit})"
                )
        if not (isfinite(self.start_s) and 0.0 <= self.start_s < self.end_s):
            raise ConfigurationError(
                f"fault {self.kind}: from {self.start_s:g} to {self.end_s:g} s given; "
                "expected a start of at least 0 and a later end"
            )

    def after(self, t_s: float) -> "Fault":
        """Return the same, its times counted from ``t_s`` [s]."""
        return Fault(self.kind, self.strength, self.start_s + t_s, self.end_s + t_s)

    def __str__(self) -> str:
        unit = KINDS[self.kind].strength
        strong = "" if unit is None or self.strength is None else f" {self.strength:g} ({unit.unit})"
        until = "" if self.end_s == inf else f"{self.end_s:.2f}"
        return f"{self.kind}{strong} {self.start_s:.2f}..{until} s"


def parse_fault(text: str) -> Fault:
    """Read one fault from its text.

    Parameters
    ----------
    text : str
        As `USAGE` says, such as ``loss 0.2 10..20``, ``gap 5..5.3``, ``reboot 30..``.

    Raises
    ------
    ConfigurationError
        If it is not understood; the text names what was given and what was expected.
    """
    words = text.split()
    if not words:
        raise ConfigurationError(f"fault: nothing given; expected {USAGE}")
    kind, *rest = words
    strength: float | None = None
    start_s, end_s = 0.0, inf
    if rest and ".." in rest[-1]:
        begin, _, end = rest.pop().partition("..")
        start_s = _number(text, begin) if begin else 0.0
        end_s = _number(text, end) if end else inf
    if rest:
        strength = _number(text, rest.pop(0))
    if rest:
        raise ConfigurationError(f"fault {_shown(text)}: too much given; expected {USAGE}")
    return Fault(kind, strength, start_s, end_s)


def _number(text: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ConfigurationError(f"fault {_shown(text)}: {_shown(word)} is no number; expected {USAGE}") from None


def _shown(text: str) -> str:
    shown = ascii(text)
    return shown if len(shown) <= _SHOWN_MAX else shown[:_SHOWN_MAX] + "..."


class Faults:
    """The faults of one simulation: those to come and those at work.

    Parameters
    ----------
    seed : int
        The same seed and the same faults in the same order give the same flight.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._count = 0
        self._planned: list[Fault] = []
        self._at_work: list[tuple[Fault, Effect]] = []
        self._next_s = inf
        self._left: dict[Direction, list[bytes]] = {direction: [] for direction in Direction}
        self.effects: list[Effect] = []
        """What is at work, in the order of its beginning."""
        self.on_link = False
        """Whether frames have to pass through `carry`."""

    @property
    def planned(self) -> tuple[Fault, ...]:
        """Those that have not begun."""
        return tuple(self._planned)

    @property
    def at_work(self) -> tuple[Fault, ...]:
        """Those that have begun and not ended."""
        return tuple(fault for fault, _ in self._at_work)

    def inject(self, *faults: Fault) -> None:
        """Plan faults by the simulated time; one whose start has passed begins with the next step."""
        self._planned += faults
        self._next_s = -inf

    def clear(self) -> None:
        """End all of them with the next step, and forget those to come."""
        self._planned.clear()
        self._at_work = [(Fault(f.kind, f.strength, 0.0, 1e-9), effect) for f, effect in self._at_work]
        self._next_s = -inf

    def step(self, peer: "SimulatedAutopilot") -> None:
        """Begin and end what is due, and let the rest go on; called once before each step of the simulation."""
        if peer.t_s >= self._next_s - 1e-9:
            self._change(peer)
        for effect in self.effects:
            effect.step(peer)

    def _change(self, peer: "SimulatedAutopilot") -> None:
        now_s = peer.t_s + 1e-9
        for fault, effect in self._at_work:
            if fault.end_s <= now_s:
                effect.end(peer)
                for direction, left in self._left.items():
                    left += effect.rest(direction)
        self._at_work = [(fault, effect) for fault, effect in self._at_work if fault.end_s > now_s]
        for fault in [fault for fault in self._planned if fault.start_s <= now_s]:
            self._planned.remove(fault)
            random = np.random.default_rng((self._seed, _STREAM, self._count))
            self._count += 1
            effect = KINDS[fault.kind].make(fault.strength or 0.0, random)
            effect.begin(peer)
            self._at_work.append((fault, effect))
        self.effects = [effect for _, effect in self._at_work]
        late = any(self._left.values())
        self.on_link = late or any(effect.on_link for effect in self.effects)
        changes_s = [fault.end_s for fault in self.at_work] + [fault.start_s for fault in self._planned]
        self._next_s = -inf if late else min(changes_s, default=inf)

    def carry(self, direction: Direction, t_s: float, frames: list[bytes]) -> list[bytes]:
        """Let the frames that enter the link in one step pass; return what leaves it in that step."""
        left = self._left[direction]
        for effect in self.effects:
            if effect.on_link:
                frames = effect.carry(direction, t_s, frames)
        if left:
            frames = left + frames
            self._left[direction] = []
        return frames
