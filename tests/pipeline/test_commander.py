"""Who talks to the autopilot: the rules by which setpoints change hands between an application and swingd."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import pytest

from swingd.control.base import Vec2
from swingd.core.constants import GRAVITY_MPS2
from swingd.model.actions import Action, Health, PassSetpoint, Setpoint, StatusText
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.events import (
    AppSetpoint,
    AutopilotKind,
    AutopilotState,
    FlightMode,
    LocalPosition,
    SetpointUse,
    UnmetSetpoint,
    Vec3,
)
from swingd.model.parameters import Disturbance, Mode, Parameters
from swingd.pipeline.commander import APPLICATION_FOR_S, STEADY_S, STREAM_LOST_S, TEXT_EVERY_S, Commander, Situation
from swingd.pipeline.correction import turn
from swingd.pipeline.envelope import Part, withheld_by
from swingd.pipeline.health import HEARTBEAT_LATE_S, LATE_S, Evidence
from swingd.pipeline.payload_state import PayloadState

DT_S = 0.01
YAW_RAD, LEVEL_YAW_RAD = 0.3, 0.1
PX4, COPTER = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
APP, OTHER = 0x01FF42, 0x02FF42
VELOCITY = SetpointUse.VEL | SetpointUse.YAW
ACC = SetpointUse.ACC_N | SetpointUse.ACC_E
ZERO: Vec3 = (0.0, 0.0, 0.0)
PASSED = [PassSetpoint()]
GOOD = Evidence(True, True, True, True, True, True, PayloadState.ATTACHED, True, True, True, True, True)


@dataclass
class Bench:
    """A commander in a flight that is described step by step; the load hangs aside, which is to be corrected."""

    parameters: Parameters = field(default_factory=lambda: Parameters(mode=Mode.INLINE))
    kind: AutopilotKind = PX4
    t_s: float = 100.0
    interval_s: float = 0.05
    mode: FlightMode = FlightMode.OFFBOARD
    armed: bool = True
    heartbeats: bool = True
    height: bool = False
    """Whether the least height of a correction stays as it is configured."""
    ask: bool = True
    situation: dict[str, Any] = field(default_factory=dict)
    source: int = APP
    vel: Vec3 = (2.0, -1.0, 0.5)

    def __post_init__(self) -> None:
        # No position is given here: the height is looked at in tests of its own.
        if not self.height:
            self.parameters = replace(self.parameters, control=replace(self.parameters.control, height_min_m=0.0))
        self.commander = Commander(self.parameters)
        self._asked_s = self._beat_s = -math.inf
        self.passed: list[float] = []
        self.sent: list[tuple[float, Setpoint]] = []
        self.texts: list[tuple[float, str]] = []
        self._warm_up()

    def _warm_up(self) -> None:
        """Let the filter have been stepping for long, before ``t_s``."""
        begin_s, ask, situation = self.t_s, self.ask, self.situation
        self.ask, self.situation = False, {"health": Health.INIT}
        self.t_s -= 2.0 * STEADY_S
        while self.t_s < begin_s - 0.5 * DT_S:
            self.step()
        self.t_s, self.ask, self.situation, self._beat_s = begin_s, ask, situation, -math.inf

    def take(self, **changes: Any) -> list[Action]:
        """Take one setpoint of the application."""
        asked = AppSetpoint(self.t_s, VELOCITY, ZERO, self.vel, ZERO, 0.7, 0.0, self.source)
        self.commander.advance_clock(self.t_s)
        answer = self.commander.take(replace(asked, **changes))
        self.passed += [self.t_s] * (PassSetpoint() in answer)
        self.texts += [(self.t_s, action.text) for action in answer if isinstance(action, StatusText)]
        return answer

    def step(self) -> Setpoint | None:
        """Let one filter step go by."""
        self.t_s += DT_S
        self.commander.advance_clock(self.t_s)
        if self.heartbeats and self.t_s - self._beat_s >= 1.0:
            self._beat_s = self.t_s
            self.commander.set_state(AutopilotState(self.t_s, self.armed, self.mode, self.kind))
        usual: dict[str, Any] = {
            "gap": False,
            "evidence": GOOD,
            "health": Health.READY,
            "taking_off": False,
            "tilt_acc_mps2": self._followed(),
            "direction": (0.1, -0.05),
            "direction_rate_per_s": (0.2, 0.1),
            "lift_n": 22.5,
            "disturbance": None,
        }
        setpoint = self.commander.step(
            Situation(
                t_boot_s=self.t_s,
                dt_s=DT_S,
                yaw_rad=YAW_RAD,
                level_yaw_rad=LEVEL_YAW_RAD,
                **{**usual, **self.situation},
            )
        )
        if setpoint is not None:
            self.sent.append((self.t_s, setpoint))
        return setpoint

    def _followed(self) -> Vec2:
        """The tilt of a vehicle that follows the pushes by the autopilot's velocity loop, in the level frame."""
        push, p = self.commander.push, self.parameters.autopilot.velocity_p
        north, east = (acc + p * vel for acc, vel in zip(push.acc_mps2, push.vel_mps, strict=True))
        return turn((north, east), LEVEL_YAW_RAD - YAW_RAD)

    def run(self, duration_s: float) -> "Bench":
        """Let time pass, with the application's setpoints at its rate, and forget what was sent before."""
        self.passed, self.sent, self.texts = [], [], []
        for _ in range(round(duration_s / DT_S)):
            if self.ask and self.t_s - self._asked_s >= self.interval_s - 1e-9:
                self._asked_s = self.t_s
                self.take()
            self.step()
        return self

    def said(self, mode: FlightMode) -> None:
        """The autopilot tells its mode now."""
        self.mode = mode
        self.commander.set_state(AutopilotState(self.t_s, self.armed, mode, self.kind))

    @property
    def pushes(self) -> list[float]:
        """Size of the acceleration in each setpoint that was sent."""
        return [math.hypot(*setpoint.acc_ned_mps2[:2]) for _, setpoint in self.sent]


def meeting(**changes: Any) -> Bench:
    """A bench on which a correction is in the application's setpoints."""
    bench = Bench(**changes).run(2.0)
    assert len(bench.sent) > 150
    return bench.run(0.5)


# ------------------------------------------------------------------------------------------------------------ handover


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_a_met_setpoint_is_sent_on_at_the_filters_rate_and_never_passes(kind: AutopilotKind) -> None:
    bench = meeting(kind=kind).run(1.0)
    assert bench.passed == []
    assert len(bench.sent) == 100
    assert min(bench.pushes) > 0.1
    for _, setpoint in bench.sent:
        assert setpoint.use == VELOCITY | (SetpointUse.ACC if kind is COPTER else ACC)
        assert setpoint.vel_ned_mps[2] == 0.5
        assert setpoint.yaw_rad == 0.7


def test_the_first_ones_pass_until_a_stream_is_known_and_a_step_has_agreed() -> None:
    bench = Bench().run(0.3)
    assert bench.passed == pytest.approx([100.0, 100.05, 100.1])
    assert bench.sent[0][0] == pytest.approx(100.16)
    assert len(bench.passed) + 3 == 6, "the other three were met"


@pytest.mark.parametrize(
    "reason",
    [
        {"situation": {"health": Health.INIT}},
        {"situation": {"health": Health.DEGRADED}},
        {"situation": {"health": Health.FAULT}},
        {"situation": {"evidence": replace(GOOD, payload=PayloadState.SLACK)}},
        {"situation": {"evidence": replace(GOOD, payload=PayloadState.UNKNOWN)}},
        {"situation": {"gap": True}},
        {"mode": FlightMode.OTHER},
        {"mode": FlightMode.UNKNOWN},
        {"armed": False},
        {"heartbeats": False},
        {"kind": AutopilotKind.OTHER},
        {"interval_s": 0.25},
        {"parameters": Parameters(mode=Mode.SHADOW)},
        {"parameters": Parameters(mode=Mode.HOLD), "armed": False},
    ],
    ids=str,
)
def test_whatever_is_missing_everything_passes(reason: dict[str, Any]) -> None:
    bench = Bench(**reason).run(2.0)
    assert bench.sent == []
    assert len(bench.passed) == pytest.approx(2.0 / bench.interval_s, abs=1)
    assert bench.commander.push.acc_mps2 == (0.0, 0.0)


def test_disabled_it_fades_and_then_passes() -> None:
    bench = meeting()
    assert bench.commander.switch(False)
    assert not bench.commander.switch(False)
    bench.run(1.0)
    fade_s = bench.parameters.control.fade_out_s
    assert bench.sent[-1][0] == pytest.approx(102.5 + fade_s, abs=0.02)
    assert bench.pushes[0] > 0.3
    assert bench.pushes[-1] < 0.05 * bench.pushes[0]
    assert max(abs(a - b) for a, b in pairwise(bench.pushes)) < 0.35, "no step beyond the jerk"
    assert bench.passed[0] - bench.sent[-1][0] <= bench.interval_s
    assert min(b - a for a, b in pairwise(bench.passed)) == pytest.approx(bench.interval_s)
    bench.commander.switch(True)
    bench.run(0.3)
    assert bench.sent
    assert max(bench.passed) < min(t_s for t_s, _ in bench.sent), "one change of hands"


def test_a_correction_that_comes_back_while_it_fades_never_lets_go() -> None:
    bench = meeting()
    bench.commander.switch(False)
    bench.run(0.2)
    bench.commander.switch(True)
    bench.run(0.5)
    assert bench.passed == []
    assert len(bench.sent) == 50


def test_silence_of_the_application_is_swingds_silence() -> None:
    bench = meeting()
    silent_s = bench.t_s
    bench.ask = False
    bench.run(3.0)
    assert bench.sent[-1][0] - silent_s <= 3 * bench.interval_s
    assert bench.pushes[-1] < 0.1 * bench.pushes[0], "faded before"
    bench.ask = True
    bench.run(0.3)
    assert len(bench.passed) == 3, "it begins anew"


def test_a_stalled_filter_lets_the_applications_setpoints_pass() -> None:
    bench = meeting()
    for _ in range(10):
        bench.t_s += 0.05
        bench.take()
        bench.commander.advance_clock(bench.t_s)
        bench.commander.tick(Health.READY)
    assert len(bench.passed) >= 10 - math.ceil(LATE_S / 0.05)
    assert bench.commander.push.acc_mps2 == (0.0, 0.0)


def test_a_fault_ends_it_at_once() -> None:
    bench = meeting()
    bench.situation = {"health": Health.FAULT}
    bench.commander.tick(Health.FAULT)
    assert not bench.commander.active
    assert bench.step() is None
    assert bench.take() == PASSED


@pytest.mark.parametrize("end", ["mode", "disarmed", "landed", "attitude", "restart"])
def test_what_ends_the_flight_by_setpoints_ends_the_repetition_at_once(end: str) -> None:
    bench = meeting()
    match end:
        case "mode":
            bench.said(FlightMode.OTHER)
        case "disarmed":
            bench.armed = False
            bench.said(FlightMode.OTHER)
        case "landed":
            bench.commander.land()
        case "attitude":
            bench.commander.leave(UnmetSetpoint(bench.t_s, APP))
        case "restart":
            bench.commander.autopilot_restarted()
    assert bench.step() is None
    assert not bench.commander.active


def test_a_setpoint_that_takes_no_correction_passes_and_is_followed_alone() -> None:
    bench = meeting()
    assert bench.take(use=SetpointUse.VEL_N | SetpointUse.VEL_D) == PASSED
    assert bench.step() is None
    assert bench.take() == PASSED, "a step has to agree first"
    assert bench.step() is None
    assert bench.take() == []
    assert bench.step() is not None


def test_two_applications_pass_and_the_pilot_is_told_now_and_then() -> None:
    bench = meeting()
    for k in range(round(1.5 * TEXT_EVERY_S / 0.05)):
        bench.source = OTHER if k % 2 else APP
        assert PassSetpoint() in bench.take() or k == 0
        bench.t_s += 0.04
        assert bench.step() is None or k == 0
    assert [text for _, text in bench.texts] == ["two applications send setpoints: both pass uncorrected"] * 2
    assert bench.texts[1][0] - bench.texts[0][0] >= TEXT_EVERY_S
    assert len(bench.texts) == 2


def test_a_mode_that_was_not_reported_for_long_is_not_believed() -> None:
    bench = meeting()
    bench.heartbeats = False
    bench.run(HEARTBEAT_LATE_S + 1.0)
    last_s = bench.sent[-1][0]
    fade_s = bench.parameters.control.fade_out_s
    assert last_s - 102.5 <= HEARTBEAT_LATE_S + fade_s + 0.02
    assert bench.passed
    assert min(bench.passed) > last_s


# -------------------------------------------------------------------------------------------------------- what is sent


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_where_nothing_swings_the_application_is_repeated_as_it_asks(kind: AutopilotKind) -> None:
    still = {"direction": (0.0, 0.0), "direction_rate_per_s": (0.0, 0.0)}
    bench = meeting(kind=kind, situation=still)
    for _, setpoint in bench.sent:
        assert (setpoint.use, setpoint.vel_ned_mps, setpoint.yaw_rad) == (VELOCITY, (2.0, -1.0, 0.5), 0.7)


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_between_two_setpoints_a_target_moves_on_where_the_autopilot_moves_it(kind: AutopilotKind) -> None:
    still = {"direction": (0.0, 0.0), "direction_rate_per_s": (0.0, 0.0)}
    bench = meeting(kind=kind, situation=still, interval_s=0.1)
    assert bench.take(use=SetpointUse.POS | SetpointUse.VEL, pos_ned_m=(10.0, 0.0, -5.0)) == []
    taken_s = bench.t_s
    for _ in range(8):
        setpoint = bench.step()
        assert setpoint is not None
        age_s = bench.t_s - taken_s if kind is COPTER else 0.0
        moved = (10.0 + 2.0 * age_s, -1.0 * age_s, -5.0 + 0.5 * age_s)
        assert setpoint.pos_ned_m == pytest.approx(moved)
        assert setpoint.vel_ned_mps == (2.0, -1.0, 0.5)


def test_new_limits_hold_at_once_and_nothing_jumps() -> None:
    bench = meeting()
    control = replace(bench.parameters.control, acc_max_mps2=0.2)
    before = bench.pushes[-1]
    bench.commander.configure(replace(bench.parameters, control=control))
    bench.run(1.0)
    assert bench.passed == []
    assert bench.pushes[-1] <= 0.2 + 1e-9 < before
    assert max(abs(a - b) for a, b in pairwise([before, *bench.pushes])) <= control.jerk_max_mps3 * DT_S + 1e-6


def test_whether_it_is_enabled_has_one_truth() -> None:
    bench = meeting()
    bench.commander.switch(False)
    # As a ground station would set it afterwards.
    bench.commander.configure(replace(bench.parameters, control=replace(bench.parameters.control, enabled=True)))
    bench.run(1.0)
    assert bench.passed == []
    assert min(bench.pushes) > 0.1


def test_another_mode_begins_from_nothing() -> None:
    bench = meeting()
    bench.commander.configure(replace(bench.parameters, mode=Mode.SHADOW))
    assert bench.step() is None
    assert bench.take() == PASSED
    assert not bench.commander.active


# ---------------------------------------------------------------------------------------------------------------- hold


def holding() -> Bench:
    """A bench in mode hold, in OFFBOARD at a known place."""
    bench = Bench(parameters=Parameters(mode=Mode.HOLD), ask=False)
    bench.commander.add_position(LocalPosition(bench.t_s, bench.t_s, (1.0, 2.0, -8.0), ZERO))
    return bench


def test_in_hold_the_stream_is_swingds_own_until_an_application_talks() -> None:
    bench = holding().run(1.0)
    assert len(bench.sent) == 100
    passes, told = bench.take()
    assert passes == PassSetpoint()
    assert "mode hold is silent" in told.text
    assert bench.run(APPLICATION_FOR_S - 0.02).sent == [], "two never talk at a time"
    assert len(bench.run(0.2).sent) == pytest.approx(20, abs=3), "and it goes on when the application has ended"


def test_what_was_consumed_and_never_sent_goes_out_when_steps_stop() -> None:
    """GIVEN a setpoint that was met WHEN no filter step comes any more THEN it leaves as it was asked for."""
    bench = meeting()
    bench.t_s += 0.02
    bench.commander.advance_clock(bench.t_s)
    assert bench.take(vel_ned_mps=(1.5, 0.5, 0.0)) == []
    bench.t_s += LATE_S + 0.01
    bench.commander.advance_clock(bench.t_s)
    owed = bench.commander.tick(Health.READY)
    assert owed is not None
    assert (owed.use, owed.vel_ned_mps) == (VELOCITY, (1.5, 0.5, 0.0))
    assert bench.commander.tick(Health.READY) is None, "once"


def test_telemetry_in_bursts_changes_no_hands() -> None:
    bench = Bench()
    for _ in range(30):
        bench.t_s += LATE_S + 0.05
        bench.take()
        for _ in range(15):
            bench.step()
            bench.t_s -= DT_S  # the whole burst arrives at once
    assert bench.sent == []


@pytest.mark.parametrize(
    "ends", [lambda bench: setattr(bench, "situation", {"health": Health.FAULT}), lambda bench: bench.commander.land()]
)
def test_in_hold_nothing_is_sent_after_a_fault_or_a_landing(ends: Callable[[Bench], Any]) -> None:
    bench = holding().run(1.0)
    bench.situation = {"health": Health.INIT}
    assert len(bench.run(0.3).sent) == 30, "a doubt ends the correction, not the stream that the autopilot lives on"
    assert bench.pushes[-1] < bench.pushes[0]
    ends(bench)
    assert bench.run(STREAM_LOST_S + 0.5).sent == []


def test_in_hold_a_copter_takes_off_undisturbed_and_a_px4_gets_its_stream() -> None:
    for kind, count in ((COPTER, 0), (PX4, 50)):
        bench = Bench(parameters=Parameters(mode=Mode.HOLD), kind=kind, ask=False, situation={"taking_off": True}).run(
            0.5
        )
        assert len(bench.sent) == count
        bench.situation = {}
        bench.run(0.5)
        assert len(bench.sent) == 50
        if kind is COPTER:
            assert bench.pushes[0] < 0.4, "the correction begins from nothing"


def test_a_reference_that_hold_cannot_take_is_refused_in_words_once() -> None:
    bench = holding().run(0.2)
    texts = []
    for _ in range(10):
        answer = bench.take(source=0, use=SetpointUse.POS)
        texts += [action.text for action in answer if isinstance(action, StatusText)]
        assert PassSetpoint() not in answer
    assert texts == ["reference refused: expected a velocity, with or without yaw, and nothing else"]
    assert bench.commander.refused_references == 10
    assert bench.take(source=0) == []
    setpoint = bench.step()
    assert setpoint is not None
    assert bench.commander.refused_references == 10
    assert setpoint.yaw_rad == 0.7


def at_height(bench: Bench, height_m: float) -> Bench:
    """Let the vehicle be that high above its origin for a second."""
    for _ in range(10):
        bench.commander.add_position(LocalPosition(bench.t_s, bench.t_s, (0.0, 0.0, -height_m), bench.vel))
        bench.run(0.1)
    return bench


def test_near_the_ground_nothing_is_corrected() -> None:
    bench = Bench(height=True)
    for height_m, corrected in ((0.9, False), (1.1, True), (0.9, False), (30.0, True)):
        at_height(at_height(bench, height_m), height_m)
        assert bool(bench.sent) is corrected, height_m
    assert bench.run(2.0).sent, "and fades"
    assert not bench.run(0.5).sent, "a height that is not known any more is none"


def test_the_height_counts_from_where_the_vehicle_was_armed() -> None:
    """On a hill 50 m above the origin of its position."""
    bench = Bench(height=True, armed=False)
    at_height(bench, 50.0)
    bench.armed = True
    at_height(bench, 50.5)
    assert not at_height(bench, 50.5).sent
    at_height(bench, 51.5)
    assert at_height(bench, 51.5).sent


# ------------------------------------------------------------------------------------- feed-forward of a disturbance

LEANING = replace(Parameters(mode=Mode.INLINE), disturbance=Disturbance(source="es_lkf", feed_forward=True))
NO_LOAD = replace(GOOD, payload=PayloadState.RELEASED)


def wind(north_n: float) -> DisturbanceEstimate:
    return DisturbanceEstimate((north_n, 0.0, 0.0), (0.1, 0.1, 0.1), "")


def leaning(**changes: Any) -> Bench:
    """A wind of 2 N has come while the feed-forward alone was in the setpoints: no load is there to be damped."""
    bench = Bench(**{"parameters": LEANING, **changes})
    calm = {"evidence": NO_LOAD, "health": Health.INIT}
    bench.situation = calm | {"disturbance": wind(0.0)}
    bench.run(3.0)
    bench.situation = calm | {"disturbance": wind(2.0)}
    return bench.run(2.0)


def test_a_disturbance_is_leaned_against_without_a_load() -> None:
    bench = leaning()
    assert len(bench.sent) == 200
    assert bench.passed == []
    acc_n, acc_e, _ = bench.sent[-1][1].acc_ned_mps2
    assert acc_n == pytest.approx(-2.0 * GRAVITY_MPS2 / 22.5, rel=1e-3)
    assert acc_e == 0.0
    assert bench.sent[-1][1].vel_ned_mps == bench.vel, "nothing is to move by it"
    assert not bench.commander.damps
    assert bench.commander.active


def test_swing_and_disturbance_change_hands_without_a_gap_or_a_passed_setpoint() -> None:
    bench = leaning()
    bench.situation = {"disturbance": wind(2.0)}
    bench.run(2.0)
    assert bench.commander.damps
    bench.situation = {"disturbance": DisturbanceEstimate((9.0, 0.0, 0.0), (0.1,) * 3, "late")}
    bench.run(2.0)
    assert (len(bench.sent), bench.passed) == (200, [])
    assert bench.commander.feed_forward_mps2 == (0.0, 0.0)
    assert bench.commander.damps


@pytest.mark.parametrize(
    "change",
    [
        {"situation": {"health": Health.FAULT, "evidence": replace(NO_LOAD, finite=False)}},
        {"situation": {"evidence": replace(NO_LOAD, payload=PayloadState.ON_GROUND)}},
        {"situation": {"evidence": replace(NO_LOAD, fresh=False)}},
        {"situation": {"evidence": replace(NO_LOAD, link=False)}},
        {"mode": FlightMode.OTHER},
        {"armed": False},
    ],
    ids=str,
)
def test_whatever_speaks_against_leaning_lets_setpoints_pass_and_nothing_chatters(change: dict[str, Any]) -> None:
    bench = leaning()
    situation = bench.situation | change.get("situation", {})
    for name in ("mode", "armed"):
        setattr(bench, name, change.get(name, getattr(bench, name)))
    bench.situation = situation
    bench.run(2.0)
    for _ in range(20):
        bench.commander.tick(situation["health"])
        bench.run(0.05)
        assert bench.sent == []
    assert bench.commander.feed_forward_mps2 == (0.0, 0.0)


def test_a_copter_is_not_leaned_it_would_take_the_acceleration_for_a_change_of_its_target() -> None:
    bench = leaning(kind=COPTER)
    assert bench.sent == []
    assert "only PX4 leans" in bench.commander.conditions(NO_LOAD, Health.INIT, wind(2.0)).disturbance


def test_a_correction_that_is_distrusted_takes_the_lean_along() -> None:
    conditions = replace(
        Bench(parameters=LEANING).run(1.0).commander.conditions(GOOD, Health.READY, wind(0.0)), trusted=False
    )
    assert withheld_by(Part.DISTURBANCE, conditions) == ("does harm; off until enabled again",)


def test_in_mode_hold_nothing_rises_before_the_stream_begins() -> None:
    bench = Bench(parameters=replace(LEANING, mode=Mode.HOLD), ask=False)
    for force_n in (0.0, 3.0):
        bench.situation = {"evidence": NO_LOAD, "health": Health.INIT, "disturbance": wind(force_n)}
        bench.run(20.0)
        assert bench.sent == []
        assert not bench.commander.active
    bench.situation = {"direction": (0.0, 0.0), "direction_rate_per_s": (0.0, 0.0), "disturbance": wind(3.0)}
    bench.run(3.0)
    assert len(bench.sent) > 250
    assert max(bench.pushes) < 0.05, "the autopilot's integrator holds that wind already"
