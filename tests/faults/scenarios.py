"""Flights under a fault, and what they show: the same manoeuvre for every one of them."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from engine.flight import Flight, hold

from swingd.model.actions import Health, SwingReport
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Parameters
from swingd.sim.autopilot import NavState
from swingd.sim.faults import parse_fault

NORMAL_DEG = 0.35
"""Root mean square error of the unspoiled flight; `test_the_unspoiled_flight` holds it."""
LEGS = ((0.0, (2.0, -1.0, 0.0)), (3.0, (0.0, 0.0, 0.0)), (5.5, (-1.5, 1.0, 0.0)), (8.0, (0.0, 0.0, 0.0)))
"""Velocity that is asked for from each time on, NED [m/s]."""
FAULT_S = 1.5
"""When the fault begins: within the first swing."""
END_S = 10.0
LAP_S = 11.0
WINDOW_S = 1.0
FADED_MPS2 = 0.05
KEPT_MPS2 = 0.3
SWING_FLOOR_DEG = 5.0
"""A smaller swing is not compared."""


@dataclass(frozen=True)
class Outcome:
    """What a flight under a fault has shown."""

    finite: bool
    during_deg: float
    """Root mean square error while the fault lasted; nan where nothing was reported on the truth's clock."""
    after_deg: float
    """Of the last two seconds."""
    settled_s: float
    """After the end of the fault, the error stays within twice the normal one from here on."""
    healths: frozenset[Health]
    """Reported or published since the fault began, until `settled_s` cannot matter any more."""
    healthy_s: float
    """After the end of the fault, health stays READY or ACTIVE from here on."""
    last_mps2: float
    """Largest correction in the last third of the fault."""
    swing_deg: float
    uncorrected_deg: float
    """Largest swing since the fault began, with and without the correction."""
    resets: dict[ResetReason, int]
    offboard: bool
    """Whether OFFBOARD was never left."""
    texts: int
    withheld: tuple[str, ...]
    """Texts that say that the correction stays off."""

    @property
    def swing_ratio(self) -> float:
        return self.swing_deg / max(self.uncorrected_deg, SWING_FLOOR_DEG)


def finite(reports: Iterable[SwingReport]) -> bool:
    return all(
        math.isfinite(value)
        for report in reports
        for value in (
            *(report.xi_rad, report.zeta_rad, report.xi_rate_radps, report.zeta_rate_radps),
            *(report.xi_std_rad, report.zeta_std_rad, report.thrust_n, report.thrust_scale, report.nis),
            *(*report.force_ned_n, *report.correction_acc_ned_mps2, *report.correction_vel_ned_mps),
        )
    )


def hovering(truth: Parameters | None = None, belief: Parameters | None = None) -> Flight:
    """In OFFBOARD with the correction active."""
    truth = truth or hold()
    return Flight(truth, belief or truth).take_off().enter_offboard().run(2.0)


def blown(**simulation: float) -> Parameters:
    """A vehicle and a load that the wind pushes."""
    parameters = hold(payload_drag_area_m2=0.006, **simulation)
    return replace(parameters, vehicle=replace(parameters.vehicle, drag_n_per_mps=0.35))


def fly(flight: Flight, faults: Iterable[str] = (), *, corrected: bool = True, laps: int = 1) -> "Record":
    """Fly the manoeuvre on a copy, again and again for several laps; the times of the faults count from `FAULT_S`."""
    flight = flight.fork()
    begin_s = flight.t_s
    if not corrected:
        flight.engine.switch_correction(begin_s, False)
    flight.peer.faults.inject(*(parse_fault(fault).after(begin_s + FAULT_S) for fault in faults))
    legs = [(lap * LAP_S + start_s, vel_ned_mps) for lap in range(laps) for start_s, vel_ned_mps in LEGS]
    end_s = (laps - 1) * LAP_S + END_S
    record = Record(flight, begin_s, end_s, dict(flight.engine.pipeline.resets))
    for (_, vel_ned_mps), until_s in zip(legs, [*(start_s for start_s, _ in legs[1:]), end_s], strict=True):
        flight.reference = vel_ned_mps
        record.run_until(begin_s + until_s)
    return record


class Record:
    """A flight and what was noted of it."""

    def __init__(self, flight: Flight, begin_s: float, end_s: float, resets: dict[ResetReason, int]) -> None:
        self.flight = flight
        self.begin_s = begin_s
        self.end_s = end_s
        """Since the beginning."""
        self.healths: list[tuple[float, Health]] = []
        self.offboard = True
        self._resets = resets

    def run_until(self, t_s: float) -> None:
        flight = self.flight
        while flight.t_s < t_s - 1e-6:
            flight.run(min(0.1, t_s - flight.t_s))
            self.healths.append((flight.t_s - self.begin_s, flight.health))
            self.offboard &= flight.nav_state is NavState.OFFBOARD

    @property
    def resets(self) -> dict[ResetReason, int]:
        now = Counter(self.flight.engine.pipeline.resets)
        now.subtract(self._resets)
        return {reason: count for reason, count in now.items() if count}

    def swing_deg(self) -> float:
        """Largest since the fault began."""
        chi = [truth.chi_rad for truth in self.flight.truths[round(FAULT_S / 0.004) :]]
        return math.degrees(float(np.nanmax(chi)))

    def rmse_deg(self, begin_s: float, end_s: float) -> float:
        """Of a window since the beginning; nan where nothing was reported in it."""
        first_s = self.flight.truths[0].t_boot_s
        errors = self.flight.errors_deg(first_s + begin_s, first_s + end_s)
        return float(np.sqrt(np.mean(errors**2))) if errors.size else math.nan

    def settled_s(self, end_s: float) -> float:
        settled_s = 0.0
        begin_s = end_s
        while begin_s + WINDOW_S <= self.end_s + 1e-9:
            rmse_deg = self.rmse_deg(begin_s, begin_s + WINDOW_S)
            if not rmse_deg <= 2.0 * NORMAL_DEG:
                settled_s = begin_s + 0.25 - end_s
            begin_s += 0.25
        return settled_s


def outcome(record: Record, uncorrected: Record, duration_s: float) -> Outcome:
    """Read off what the flight shows of a fault that lasted ``duration_s``."""
    flight = record.flight
    end_s = FAULT_S + duration_s
    ill_s = [t_s for t_s, health in record.healths if health not in (Health.READY, Health.ACTIVE)]
    late_s = record.begin_s + FAULT_S + 2.0 * duration_s / 3.0
    pushes = [
        math.hypot(*setpoint)
        for t_s, setpoint in ((t_s, report) for t_s, report in _pushes(flight))
        if late_s <= t_s <= record.begin_s + end_s
    ]
    return Outcome(
        finite=finite(flight.reports),
        during_deg=record.rmse_deg(FAULT_S, end_s),
        after_deg=record.rmse_deg(record.end_s - 2.0, record.end_s),
        settled_s=record.settled_s(end_s),
        healths=frozenset(health for t_s, health in record.healths if t_s > FAULT_S),
        healthy_s=max(0.0, max(ill_s, default=0.0) - end_s),
        last_mps2=max(pushes, default=0.0),
        swing_deg=record.swing_deg(),
        uncorrected_deg=uncorrected.swing_deg(),
        resets=record.resets,
        offboard=record.offboard,
        texts=len(flight.texts),
        withheld=tuple(text for _, text in flight.texts if "off until" in text),
    )


def _pushes(flight: Flight) -> Iterable[tuple[float, tuple[float, float]]]:
    """Time on the host's clock and horizontal acceleration of each setpoint that was sent."""
    return ((t_s, (s.acc_ned_mps2[0], s.acc_ned_mps2[1])) for t_s, s in flight.setpoints)
