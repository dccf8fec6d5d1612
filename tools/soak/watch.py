"""What must hold at every instant of a soak, judged from what leaves the engine and from the simulated truth."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, fields
from enum import Enum

from swingd.engine import Engine
from swingd.model.actions import Action, Health, Setpoint, SwingReport
from swingd.model.parameters import Mode, Parameters
from swingd.pipeline.application import REPEAT_MAX_S
from swingd.pipeline.health import HEARTBEAT_LATE_S
from swingd.sim.plant import Truth

from .record import Breach

QUIET_S = 5.0
"""After the last fault, until its consequences are no excuse any more."""
STALL_S = 0.7
"""Of a link that jitters: the fade runs by the samples that arrive."""
RELEASE_SEEN_S = 1.0
SILENT_S = REPEAT_MAX_S + 0.1
"""After the application's last setpoint, which may be repeated for `REPEAT_MAX_S`, and once more a step later."""
KEPT_PER_RULE = 5
TRUSTED = (Health.READY, Health.ACTIVE)


class Rule(Enum):
    """What is an error, whatever was wrong with link, autopilot, load and wind."""

    EXCEPTION = "exception"
    NOT_FINITE = "not finite"
    SILENCE = "setpoint after silence"
    WITHHELD = "correction though the envelope forbids it"
    OFF = "correction though switched off"
    NOT_FLYING = "correction though disarmed or not in OFFBOARD"
    RELEASED = "correction though the load was released"


@dataclass(slots=True)
class Since:
    """Since when a correction has no right to be there, by the simulated truth and by the switch [s]."""

    off_s: float = math.inf
    not_flying_s: float = math.inf
    released_s: float = math.inf
    fault_s: float = -math.inf
    """When the last fault was at work."""
    application_s: float = -math.inf
    """When an application sent its last setpoint."""


class Watch:
    """Sees every action and, ten times a second, the truth."""

    def __init__(self) -> None:
        self.since = Since()
        self.breaches: list[Breach] = []
        self.breached: Counter[str] = Counter()
        self.health_s: Counter[str] = Counter()
        self._engine: Engine | None = None
        self._withheld_s = math.inf
        self._report: SwingReport | None = None
        self._reported_s = -math.inf
        self._errors = {True: (0, 0.0), False: (0, 0.0)}

    def attach(self, engine: Engine) -> None:
        """Name the engine whose actions it sees."""
        self._engine = engine

    # ---- actions

    def see(self, t_s: float, action: Action) -> None:
        """Judge one action, at the host's time [s]."""
        if isinstance(action, Setpoint):
            if not _is_finite(action):
                self.break_(t_s, Rule.NOT_FINITE, str(action))
            silent_s = t_s - self.since.application_s
            if self._parameters.mode is Mode.INLINE and silent_s > SILENT_S:
                self.break_(t_s, Rule.SILENCE, f"{silent_s:.2f} s after the application's last")
        elif isinstance(action, SwingReport):
            self._report, self._reported_s = action, t_s
            if not _is_finite(action):
                self.break_(t_s, Rule.NOT_FINITE, str(action))
            if any(action.correction_acc_ned_mps2) or any(action.correction_vel_ned_mps):
                self._judge_correction(t_s, action)
            else:
                self._withheld_s = math.inf

    def _judge_correction(self, t_s: float, report: SwingReport) -> None:
        since, fade_s = self.since, self._parameters.control.fade_out_s
        pipeline = self._engine_attached.pipeline
        reasons = pipeline.withheld_by
        self._withheld_s = min(self._withheld_s, t_s) if reasons else math.inf
        acc_mps2 = math.hypot(*report.correction_acc_ned_mps2)
        for rule, begin_s, allowed_s in (
            (Rule.WITHHELD, self._withheld_s, fade_s + STALL_S),
            (Rule.OFF, since.off_s, fade_s + STALL_S),
            (Rule.NOT_FLYING, since.not_flying_s, HEARTBEAT_LATE_S + fade_s + STALL_S),
            (Rule.RELEASED, since.released_s, RELEASE_SEEN_S + fade_s + STALL_S),
        ):
            if t_s - begin_s > allowed_s:
                why = "; ".join(reasons) or "nothing forbids it by its own judgement"
                self.break_(t_s, rule, f"{acc_mps2:.3g} m/s^2, {t_s - begin_s:.2f} s since ({why})")

    def break_(self, t_s: float, rule: Rule, text: str) -> None:
        """Note that a rule was broken."""
        self.breached[rule.value] += 1
        if self.breached[rule.value] <= KEPT_PER_RULE:
            self.breaches.append(Breach(round(t_s, 3), rule.value, text))

    # ---- the truth

    def look(self, t_s: float, dt_s: float, truth: Truth, *, flying: bool, faults: bool) -> None:
        """Note the true state; ``dt_s`` after the last look, ``flying`` where the autopilot follows setpoints."""
        since, engine = self.since, self._engine_attached
        if faults:
            since.fault_s = t_s
        quiet = t_s - since.fault_s > QUIET_S
        since.not_flying_s = math.inf if flying else min(since.not_flying_s, t_s)
        # A fault may hide that the load is gone; the time counts from when nothing does.
        since.released_s = min(since.released_s, t_s) if quiet and not truth.attached else math.inf
        if engine.failure is not None:
            self.break_(t_s, Rule.EXCEPTION, engine.failure)
        if not engine.has_joined:
            return
        self.health_s[engine.pipeline.health.value] += dt_s
        report = self._report
        if report is None or t_s - self._reported_s > dt_s or report.health not in TRUSTED:
            return
        if truth.attached and truth.taut and not truth.grounded:
            count, total = self._errors[quiet]
            error = (report.xi_rad - truth.xi_rad) ** 2 + (report.zeta_rad - truth.zeta_rad) ** 2
            self._errors[quiet] = (count + 2, total + error)

    def take_error_deg(self, *, quiet: bool) -> float | None:
        """Return the root mean square of the angles' error since the last call; None where there was nothing."""
        count, total = self._errors[quiet]
        self._errors[quiet] = (0, 0.0)
        return math.degrees(math.sqrt(total / count)) if count else None

    def take_health_s(self) -> dict[str, float]:
        """Return the seconds in each state since the last call."""
        taken = dict(self.health_s)
        self.health_s.clear()
        return taken

    @property
    def _engine_attached(self) -> Engine:
        assert self._engine is not None
        return self._engine

    @property
    def _parameters(self) -> Parameters:
        return self._engine_attached.parameters


_NAMES = {kind: tuple(field.name for field in fields(kind)) for kind in (Setpoint, SwingReport)}


def _is_finite(action: Setpoint | SwingReport) -> bool:
    return math.isfinite(sum(_numbers(action)))


def _numbers(action: Setpoint | SwingReport) -> Iterable[float]:
    for name in _NAMES[type(action)]:
        value = getattr(action, name)
        if isinstance(value, tuple):
            yield from value
        elif isinstance(value, float):
            yield value
