"""Each fault against what is promised under it: the table of docs/reliability.md."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import Enum

import pytest
from engine.flight import Flight, hold

from swingd.model.actions import Health
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Parameters

from .scenarios import FADED_MPS2, KEPT_MPS2, NORMAL_DEG, Record, fly, hovering, outcome

SWING_MAX = 1.2
"""Over that of the uncorrected flight under the same fault."""
SPOILED_DEG = 2.0 * NORMAL_DEG


class Correction(Enum):
    """What becomes of it while the fault lasts."""

    KEPT = "goes on"
    FADED = "is gone by the last third"
    EITHER = "may do either"


@dataclass(frozen=True)
class Promise:
    """What holds during and after one fault; besides: finite, swing below `SWING_MAX`, not switched off."""

    fault: str
    duration_s: float
    settled_s: float
    """After the end, until the error is within twice the normal one for good."""
    during_deg: float | None = None
    """Largest root mean square error while it lasts; None: finite only."""
    correction: Correction = Correction.EITHER
    reaches: Health | None = None
    """Health that must be told."""
    worst: Collection[Health] = (Health.DEGRADED, Health.INIT, Health.FAULT)
    """Health besides READY and ACTIVE that may be told."""
    healthy_s: float = 0.1
    """After the end, until READY or ACTIVE for good."""
    resets: Collection[ResetReason] = ()
    """For which the estimate may begin anew."""
    failsafe: bool = False
    """Whether the autopilot may leave OFFBOARD meanwhile."""
    moves_vehicle: bool = False
    """Whether the uncorrected flight must be flown under the fault as well."""
    laps: int = 1
    """How often the manoeuvre is flown, where it takes long until the error is normal again."""
    fails: str | None = None
    """Where the promise is not kept: what was measured."""


def unharmed(fault: str, duration_s: float = 3.0, *, moves_vehicle: bool = False, fails: str | None = None) -> Promise:
    """As if nothing were."""
    return Promise(
        fault,
        duration_s,
        settled_s=0.5,
        during_deg=SPOILED_DEG,
        correction=Correction.KEPT,
        worst=(),
        healthy_s=0.0,
        moves_vehicle=moves_vehicle,
        fails=fails,
    )


LOST_AND_FOUND = (ResetReason.SLACK, ResetReason.LIFT)
"""The load: what a fault of the thrust or a cable that was slack looks like."""
PROMISES = [
    unharmed("loss 0.2"),
    unharmed("duplicate 1"),
    unharmed("reorder 0.33"),
    unharmed("corrupt 0.1"),
    unharmed("nan 0.2"),
    unharmed("voltage 0"),
    unharmed("voltage 30"),
    unharmed("voltage_frozen"),
    unharmed("yaw 0.5"),
    unharmed("flood 500"),
    unharmed("rival 0.5"),
    Promise(
        "gap",
        0.3,
        settled_s=2.0,
        correction=Correction.FADED,
        reaches=Health.DEGRADED,
        worst=(Health.DEGRADED,),
        healthy_s=1.0,
    ),
    Promise(
        "gap",
        2.0,
        settled_s=3.0,
        correction=Correction.FADED,
        reaches=Health.FAULT,
        healthy_s=3.0,
        resets=(ResetReason.GAP,),
        failsafe=True,
        moves_vehicle=True,
    ),
    Promise(
        "jitter 0.2",
        3.0,
        settled_s=0.5,
        during_deg=SPOILED_DEG,
        worst=(Health.DEGRADED,),
        healthy_s=1.0,
    ),
    Promise(
        "imu_frozen",
        3.0,
        settled_s=3.0,
        correction=Correction.FADED,
        reaches=Health.FAULT,
        healthy_s=3.0,
        resets=(ResetReason.GAP,),
        failsafe=True,
    ),
    # As much as a load on a cable that leans by 20 deg.
    Promise("acc_bias 0.5", 3.0, settled_s=14.0, during_deg=5.0, correction=Correction.KEPT, worst=(), laps=2),
    Promise("vibration 7", 3.0, settled_s=2.0, during_deg=1.5, correction=Correction.KEPT, worst=()),
    # Aliases of the rotors' lines near zero frequency weigh as much as the load.
    Promise("vibration 10", 3.0, settled_s=6.0, healthy_s=3.0, resets=LOST_AND_FOUND),
    Promise("vibration 30", 3.0, settled_s=6.0, healthy_s=3.0, resets=LOST_AND_FOUND),
    Promise("sag 0.05", 3.0, settled_s=3.0, during_deg=2.0, worst=(Health.DEGRADED,)),
    # Its end is 0.24 kg less within a tenth of a second, of a load of 0.3 kg: nothing tells that from a release.
    Promise("sag 0.1", 3.0, settled_s=5.0, during_deg=2.0, healthy_s=6.0, resets=LOST_AND_FOUND),
    Promise("voltage 12", 3.0, settled_s=3.0, healthy_s=3.0, resets=LOST_AND_FOUND),
    Promise(
        "attitude 0.1",
        2.0,
        settled_s=3.0,
        healthy_s=3.0,
        resets=(ResetReason.ATTITUDE,),
        reaches=Health.INIT,
        moves_vehicle=True,
    ),
    Promise("clock -15", 3.0, settled_s=3.0, healthy_s=3.0, resets=(ResetReason.CLOCK,), reaches=Health.INIT),
    Promise("clock 50", 3.0, settled_s=3.0, healthy_s=3.0, resets=(ResetReason.CLOCK,), reaches=Health.INIT),
    Promise("slack 3", 0.1, settled_s=2.0, healthy_s=3.5, resets=LOST_AND_FOUND, moves_vehicle=True),
    Promise("power 0.5", 0.4, settled_s=18.0, healthy_s=3.5, resets=LOST_AND_FOUND, moves_vehicle=True, laps=2),
]


def cases(promises: list[Promise]) -> list[object]:
    return [
        pytest.param(
            promise,
            id=f"{promise.fault} for {promise.duration_s:g} s",
            marks=[pytest.mark.xfail(reason=promise.fails, strict=True)] if promise.fails else [],
        )
        for promise in promises
    ]


def hold_to(promise: Promise, corrected: Record, uncorrected: Record) -> None:
    seen = outcome(corrected, uncorrected, promise.duration_s)
    print(
        f"\n{promise.fault} for {promise.duration_s:g} s: error {seen.during_deg:.2f} deg while it lasts, normal "
        f"{seen.settled_s:.2f} s after, health good {seen.healthy_s:.1f} s after, "
        f"worst {', '.join(sorted(h.value for h in seen.healths - {Health.READY, Health.ACTIVE})) or 'none'}, "
        f"swing {seen.swing_ratio:.2f} of uncorrected, correction in the last third {seen.last_mps2:.2f} m/s^2"
    )
    assert seen.finite
    assert seen.swing_ratio <= SWING_MAX
    assert seen.settled_s <= promise.settled_s
    if promise.during_deg is not None:
        assert seen.during_deg <= promise.during_deg
    assert seen.healths <= {Health.READY, Health.ACTIVE, *promise.worst}
    assert promise.reaches is None or promise.reaches in seen.healths
    assert seen.healthy_s <= promise.healthy_s + 1e-6
    if promise.correction is Correction.KEPT:
        assert seen.last_mps2 >= KEPT_MPS2
    elif promise.correction is Correction.FADED:
        assert seen.last_mps2 <= FADED_MPS2
    assert set(seen.resets) <= set(promise.resets)
    assert seen.offboard or promise.failsafe
    assert seen.withheld == ()


def test_the_unspoiled_flight(unspoiled: Record, uncorrected: Record) -> None:
    seen = outcome(unspoiled, uncorrected, 3.0)
    assert unspoiled.rmse_deg(0.0, 10.0) < NORMAL_DEG
    assert seen.healths == {Health.ACTIVE}
    assert seen.swing_ratio < 0.5


@pytest.mark.parametrize("promise", cases(PROMISES))
def test_under_a_fault_what_is_promised_holds(calm: Flight, uncorrected: Record, promise: Promise) -> None:
    faults = [f"{promise.fault} 0..{promise.duration_s}"]
    twin = fly(calm, faults, corrected=False) if promise.moves_vehicle else uncorrected
    hold_to(promise, fly(calm, faults, laps=promise.laps), twin)


GUSTS = Promise("gust 12", 4.0, settled_s=4.0, healthy_s=3.0)


@pytest.mark.parametrize("promise", cases([GUSTS]))
def test_in_gusts_of_12_mps_the_swing_is_no_larger_than_without(exposed: Flight, promise: Promise) -> None:
    faults = [f"{promise.fault} 0..{promise.duration_s}"]
    hold_to(promise, fly(exposed, faults), fly(exposed, faults, corrected=False))


def test_many_faults_at_once_leave_it_finite_and_are_forgotten(calm: Flight, uncorrected: Record) -> None:
    kinds = ("loss 0.1", "corrupt 0.05", "nan 0.1", "reorder 0.1", "jitter 0.1", "duplicate 0.3", "flood 200")
    seen = outcome(fly(calm, [f"{kind} 0..3" for kind in kinds]), uncorrected, 3.0)
    assert seen.finite
    assert seen.offboard
    assert seen.during_deg <= SPOILED_DEG
    assert seen.settled_s <= 1.0
    assert seen.healthy_s <= 1.0
    assert seen.swing_ratio <= SWING_MAX


def test_after_a_reboot_in_flight_nothing_is_sent_and_nothing_estimated(calm: Flight) -> None:
    record = fly(calm, ["reboot 0.."])
    flight = record.flight
    assert finite_and_silent(record)
    assert flight.health is Health.INIT
    assert record.resets[ResetReason.CLOCK] == 1
    assert any("clock stepped" in text for _, text in flight.texts)


def finite_and_silent(record: Record) -> bool:
    """No setpoint from half a second after the fault's beginning on."""
    seen = outcome(record, record, 1.0)
    return seen.finite and all(t_s < record.begin_s + 2.0 for t_s, _ in record.flight.setpoints)


def test_a_flood_of_questions_is_answered_within_bounds(calm: Flight) -> None:
    record = fly(calm, ["flood 2000 0..3"])
    flight = record.flight
    assert len(flight.texts) <= 10, "one word a second for what was refused"
    assert record.rmse_deg(1.5, 4.5) <= SPOILED_DEG


def wrong(mass: float, length: float) -> Parameters:
    """What swingd believes, relative to what flies."""
    parameters = hold()
    return replace(
        parameters,
        payload=replace(parameters.payload, mass_kg=mass * parameters.payload.mass_kg),
        cable=replace(parameters.cable, length_m=length * parameters.cable.length_m),
    )


@pytest.mark.parametrize(("mass", "length"), [(0.8, 1.0), (1.2, 1.0), (1.0, 0.8), (1.0, 1.2)])
def test_a_load_or_cable_wrong_by_a_fifth_at_most_doubles_the_error(
    unspoiled: Record, mass: float, length: float
) -> None:
    flight = hovering(hold(), wrong(mass, length))
    record = fly(flight)
    print(f"\nload x {mass:g}, cable x {length:g}: error {record.rmse_deg(0.0, 10.0):.2f} deg")
    assert record.rmse_deg(0.0, 10.0) <= 2.0 * unspoiled.rmse_deg(0.0, 10.0)
