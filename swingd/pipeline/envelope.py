"""One decision on whether a correction may leave, and one fade."""

from collections.abc import Callable
from dataclasses import dataclass

from swingd.model.events import FlightMode
from swingd.model.parameters import Control, Mode
from swingd.pipeline.payload_state import PayloadState

HARMFUL_OUT_S = 0.2
"""At most, to end a correction that does harm."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Everything that the decision depends on."""

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


_REQUIRED: tuple[tuple[Callable[[Conditions], bool], Callable[[Conditions], str]], ...] = (
    (lambda c: c.mode is not Mode.SHADOW, lambda _: "mode shadow"),
    (lambda c: c.enabled, lambda _: "switched off"),
    (lambda c: c.trusted, lambda _: "does harm; off until enabled again"),
    (lambda c: c.armed, lambda _: "not armed"),
    (lambda c: c.flight_mode is FlightMode.OFFBOARD, lambda c: f"flight mode is {c.flight_mode.value}"),
    (lambda c: c.high, lambda _: "too low"),
    (lambda c: c.asked, lambda _: "nobody asks for a setpoint that can be corrected"),
    (lambda c: c.payload is PayloadState.ATTACHED, lambda c: f"payload: {c.payload.value}"),
    (lambda c: c.fresh, lambda _: "IMU or attitude late"),
    (lambda c: c.finite, lambda _: "estimate not finite"),
    (lambda c: c.settled, lambda _: "estimate settling"),
    (lambda c: c.certain, lambda _: "estimate uncertain"),
    (lambda c: c.consistent, lambda _: "measurements and model disagree"),
    (lambda c: c.link, lambda _: "link late or silent"),
    (lambda c: c.recovered, lambda _: "health is not ready"),
)
"""What must hold, and what to say where it does not."""


def may_correct(conditions: Conditions) -> bool:
    """Whether a correction may leave: every condition must hold, a doubt is a no."""
    return all(holds(conditions) for holds, _ in _REQUIRED)


def withheld_by(conditions: Conditions) -> tuple[str, ...]:
    """Name every condition that does not hold, for people; empty where `may_correct` says yes."""
    return tuple(reason(conditions) for holds, reason in _REQUIRED if not holds(conditions))


class Fade:
    """The one ramp between nothing and the whole correction."""

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
