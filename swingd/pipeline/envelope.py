"""One table of what must hold before any part of a correction may leave, and its ramp."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from swingd.model.events import FlightMode
from swingd.model.parameters import Control, Mode
from swingd.pipeline.payload_state import PayloadState

HARMFUL_OUT_S = 0.2
"""At most, to end a correction that does harm."""


class Part(Enum):
    """What may be added to a setpoint; each part is decided on by itself."""

    SWING = "correction of the swing"
    DISTURBANCE = "feed-forward of the disturbance"


@dataclass(frozen=True, slots=True)
class Conditions:
    """Everything that the decisions depend on."""

    mode: Mode
    enabled: bool
    """By the user."""
    trusted: bool
    """The watch over the damping has nothing against it."""
    armed: bool
    flight_mode: FlightMode
    high: bool
    """High enough above the ground."""
    asked: bool
    """Whether somebody asks for something that a correction can enter: mode hold does; an application must still be
    alive, alone, and fast enough."""
    payload: PayloadState
    fresh: bool
    """IMU and attitude, and no sample of this step is missing."""
    finite: bool
    settled: bool
    certain: bool
    """The angles' covariance is within its bound."""
    consistent: bool
    """The innovations agree with their covariance."""
    link: bool
    """The link is alive and fast enough."""
    recovered: bool
    """Health is READY: nothing has spoken against the estimate for a while."""
    sound: bool
    """Health is not FAULT: no setpoint of swingd's leaves then."""
    disturbance: str
    """Why the disturbance may not be fed forward, as far as it depends on its estimate; empty where it may."""


_ALWAYS = frozenset(Part)
_SWING = frozenset({Part.SWING})
_DISTURBANCE = frozenset({Part.DISTURBANCE})

_REQUIRED: tuple[tuple[frozenset[Part], Callable[[Conditions], bool], Callable[[Conditions], str]], ...] = (
    (_ALWAYS, lambda c: c.mode is not Mode.SHADOW, lambda _: "mode shadow"),
    (_ALWAYS, lambda c: c.enabled, lambda _: "switched off"),
    (_ALWAYS, lambda c: c.trusted, lambda _: "does harm; off until enabled again"),
    (_ALWAYS, lambda c: c.armed, lambda _: "not armed"),
    (_ALWAYS, lambda c: c.flight_mode is FlightMode.OFFBOARD, lambda c: f"flight mode is {c.flight_mode.value}"),
    (_ALWAYS, lambda c: c.high, lambda _: "too low"),
    (_ALWAYS, lambda c: c.asked, lambda _: "nobody asks for a setpoint that can be corrected"),
    (_SWING, lambda c: c.payload is PayloadState.ATTACHED, lambda c: f"payload: {c.payload.value}"),
    (_ALWAYS, lambda c: c.fresh, lambda _: "IMU or attitude late"),
    (_SWING, lambda c: c.finite, lambda _: "estimate not finite"),
    (_SWING, lambda c: c.settled, lambda _: "estimate settling"),
    (_SWING, lambda c: c.certain, lambda _: "estimate uncertain"),
    (_SWING, lambda c: c.consistent, lambda _: "measurements and model disagree"),
    (_ALWAYS, lambda c: c.link, lambda _: "link late or silent"),
    (_SWING, lambda c: c.recovered, lambda _: "health is not ready"),
    (_DISTURBANCE, lambda c: c.sound, lambda _: "health is fault"),
    (_DISTURBANCE, lambda c: not c.disturbance, lambda c: c.disturbance),
)
"""For which parts it must hold, what must hold, and what to say where it does not."""


def may_leave(part: Part, conditions: Conditions) -> bool:
    """Whether a part of the correction may leave: every condition of its own must hold, a doubt is a no."""
    return all(holds(conditions) for parts, holds, _ in _REQUIRED if part in parts)


def withheld_by(part: Part, conditions: Conditions) -> tuple[str, ...]:
    """Name every condition that does not hold, for people; empty where `may_leave` says yes."""
    return tuple(reason(conditions) for parts, holds, reason in _REQUIRED if part in parts and not holds(conditions))


class Fade:
    """The ramp between nothing and the whole of one part."""

    def __init__(self, control: Control) -> None:
        self.configure(control)
        self.value = 0.0
        """0 (nothing leaves) to 1."""

    def configure(self, control: Control) -> None:
        """Take other ramps."""
        self._in_s = control.fade_in_s
        self._out_s = control.fade_out_s

    def update(self, allowed: bool, dt_s: float, *, harmful: bool = False) -> float:
        """Advance by ``dt_s`` towards what is allowed; return the new value. What does harm goes faster."""
        if allowed:
            self.value = min(1.0, self.value + (dt_s / self._in_s if self._in_s > 0.0 else 1.0))
        else:
            out_s = min(self._out_s, HARMFUL_OUT_S) if harmful else self._out_s
            self.value = max(0.0, self.value - (dt_s / out_s if out_s > 0.0 else 1.0))
        return self.value

    def cut(self) -> None:
        """Drop to zero at once: the autopilot no longer follows setpoints, there is nothing to fade."""
        self.value = 0.0
