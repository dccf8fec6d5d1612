"""One decision on whether a correction may leave, and one fade."""

from dataclasses import dataclass

from swingd.model.actions import Health
from swingd.model.events import FlightMode
from swingd.model.parameters import Control, Mode
from swingd.pipeline.payload_state import PayloadState


@dataclass(frozen=True, slots=True)
class Conditions:
    """Everything that the decision depends on."""

    mode: Mode
    enabled: bool
    """By the user."""
    armed: bool
    flight_mode: FlightMode
    payload: PayloadState
    health: Health
    """READY or ACTIVE where inputs are fresh and the estimate is finite, settled and consistent."""
    asked: bool
    """Whether somebody asks for something that a correction can enter: mode hold does; an application must still be
    alive, alone, and fast enough."""


def may_correct(conditions: Conditions) -> bool:
    """Whether a correction may leave: every condition must hold, a doubt is a no."""
    return (
        conditions.mode is not Mode.SHADOW
        and conditions.enabled
        and conditions.armed
        and conditions.flight_mode is FlightMode.OFFBOARD
        and conditions.payload is PayloadState.ATTACHED
        and conditions.health in (Health.READY, Health.ACTIVE)
        and conditions.asked
    )


def withheld_by(conditions: Conditions) -> tuple[str, ...]:
    """Name every condition that does not hold, for people; empty where `may_correct` says yes."""
    flying = conditions.flight_mode is FlightMode.OFFBOARD
    reasons = (
        (conditions.mode is Mode.SHADOW, "mode shadow"),
        (not conditions.enabled, "switched off"),
        (not conditions.armed, "not armed"),
        (not flying, f"flight mode is {conditions.flight_mode.value}"),
        (conditions.payload is not PayloadState.ATTACHED, f"payload: {conditions.payload.value}"),
        (conditions.health not in (Health.READY, Health.ACTIVE), f"health is {conditions.health.value}"),
        (not conditions.asked, "nobody asks for a setpoint that can be corrected"),
    )
    return tuple(text for withholds, text in reasons if withholds)


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

    def update(self, allowed: bool, dt_s: float) -> float:
        """Advance by ``dt_s`` towards what is allowed; return the new value."""
        if allowed:
            self.value = min(1.0, self.value + (dt_s / self._in_s if self._in_s > 0.0 else 1.0))
        else:
            self.value = max(0.0, self.value - (dt_s / self._out_s if self._out_s > 0.0 else 1.0))
        return self.value

    def cut(self) -> None:
        """Drop to zero at once: the autopilot no longer follows setpoints, there is nothing to fade."""
        self.value = 0.0
