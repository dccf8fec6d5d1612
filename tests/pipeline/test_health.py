"""Streams measured, asked for and complained about; health of the whole."""

import itertools
import math
from dataclasses import fields, replace

import pytest

from swingd.model.actions import Health, StatusText, StreamRequest
from swingd.model.events import Stream
from swingd.model.parameters import Link, Parameters
from swingd.pipeline.health import (
    HEARTBEAT_LOST_S,
    LATE_S,
    ROUND_TRIP_MAX_S,
    ROUND_TRIP_SILENCE_S,
    SETTLE_S,
    Assessment,
    Evidence,
    HealthWatch,
    RoundTripWatch,
    StreamWatch,
    judge,
)
from swingd.pipeline.payload_state import PayloadState

GOOD_HZ = {
    Stream.IMU: 224.0,
    Stream.ATTITUDE: 100.0,
    Stream.THROTTLE: 100.0,
    Stream.MOTORS: 100.0,
    Stream.BATTERY: 10.0,
    Stream.LOCAL_POSITION: 50.0,
    Stream.LANDED_STATE: 5.0,
}


class Link20Hz:
    """An autopilot that streams at given rates, and a host that ticks at 20 Hz."""

    def __init__(self, rates_hz: dict[Stream, float], watch: StreamWatch | None = None) -> None:
        self.watch = watch or StreamWatch(Parameters())
        self.rates_hz = rates_hz
        self.t_s = 0.0
        self.requests: list[tuple[float, StreamRequest]] = []
        self.texts: list[tuple[float, str]] = []

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s * 20.0)):
            begin_s, self.t_s = self.t_s, self.t_s + 0.05
            for stream, rate_hz in self.rates_hz.items():
                for k in range(math.floor(begin_s * rate_hz), math.floor(self.t_s * rate_hz)):
                    self.watch.arrived(stream, (k + 1) / rate_hz)
            for action in self.watch.tick(self.t_s, armed=True):
                if isinstance(action, StreamRequest):
                    self.requests.append((self.t_s, action))
                else:
                    assert isinstance(action, StatusText)
                    self.texts.append((self.t_s, action.text))

    def asked(self, stream: Stream) -> list[float]:
        return [t_s for t_s, request in self.requests if request.stream is stream]


def test_everything_is_asked_for_at_once_and_then_left_alone() -> None:
    link = Link20Hz(GOOD_HZ)
    link.run(60.0)
    assert {request.stream: request.rate_hz for _, request in link.requests} == {
        Stream.IMU: 250.0,
        Stream.ATTITUDE: 100.0,
        Stream.THROTTLE: 100.0,
        Stream.MOTORS: 100.0,
        Stream.BATTERY: 10.0,
        Stream.LOCAL_POSITION: 50.0,
        Stream.LANDED_STATE: 2.0,
    }
    assert len(link.requests) == len(GOOD_HZ)
    assert link.texts == []


@pytest.mark.parametrize("rate_hz", [20.0, 250.0, 600.0, 1000.0])
def test_the_rate_is_measured(rate_hz: float) -> None:
    link = Link20Hz({Stream.IMU: rate_hz}, StreamWatch(Parameters(link=Link(imu_rate_hz=rate_hz))))
    link.run(5.0)
    state = link.watch.state(Stream.IMU, link.t_s)
    assert state.got_hz == pytest.approx(rate_hz, rel=0.03)
    assert state.asked_hz == rate_hz
    assert state.age_s == pytest.approx(0.0, abs=1.0 / rate_hz + 1e-9)
    assert len(link.asked(Stream.IMU)) == 1
    assert link.watch.state(Stream.IMU, link.t_s + 10.0).got_hz == 0.0
    assert link.watch.age_s(Stream.IMU, link.t_s + 10.0) == pytest.approx(10.0, abs=0.1)


def test_what_does_not_come_is_asked_for_ever_less_often_and_told_once() -> None:
    link = Link20Hz({**GOOD_HZ, Stream.MOTORS: 10.0})
    link.run(300.0)
    asked = link.asked(Stream.MOTORS)
    waits = [round(b - a, 3) for a, b in itertools.pairwise(asked)]
    assert waits[0] == pytest.approx(2.0, abs=0.06)
    assert waits == sorted(waits)
    assert waits[-1] == pytest.approx(16.0, abs=0.06)
    assert [text for _, text in link.texts] == [
        "motors: asked 100 Hz, got 10 Hz (link or autopilot gives no more)",
    ]
    assert link.texts[0][0] < 15.0


def test_a_refusal_is_the_reason() -> None:
    link = Link20Hz({**GOOD_HZ, Stream.BATTERY: 0.5})
    link.run(1.0)
    link.watch.refused(Stream.BATTERY, "BATTERY_STATUS: MAV_RESULT_DENIED")
    link.run(30.0)
    assert [text for _, text in link.texts] == [
        "battery: asked 10 Hz, got 0.5 Hz (refused: BATTERY_STATUS: MAV_RESULT_DENIED)"
    ]


def test_a_stream_that_comes_back_and_goes_again_is_asked_for_and_told_again() -> None:
    link = Link20Hz(GOOD_HZ)
    link.run(10.0)
    for _ in range(2):
        link.rates_hz = {**GOOD_HZ, Stream.THROTTLE: 5.0}
        link.run(30.0)
        link.rates_hz = GOOD_HZ
        link.run(30.0)
    assert [text.split(":")[0] for _, text in link.texts] == ["throttle", "throttle"]


def test_after_a_restart_everything_is_asked_for_again() -> None:
    link = Link20Hz({stream: 0.9 * rate for stream, rate in GOOD_HZ.items()})
    link.run(20.0)
    before = len(link.requests)
    link.watch.restarted()
    link.rates_hz = dict.fromkeys(GOOD_HZ, 0.4)
    link.run(3.0)
    assert {request.stream for _, request in link.requests[before:]} == set(GOOD_HZ)


def test_a_host_clock_that_goes_back_changes_nothing() -> None:
    watch = StreamWatch(Parameters())
    watch.arrived(Stream.IMU, 5.0)
    watch.arrived(Stream.IMU, 4.0)
    assert watch.age_s(Stream.IMU, 5.5) == 0.5
    assert watch.age_s(Stream.BATTERY, 5.5) is None


# ---- health

ATTACHED = PayloadState.ATTACHED
RECOVERY_S = 0.5
"""After DEGRADED and FAULT."""


class Judged:
    """A filter at 100 Hz with both inputs, to be spoiled."""

    def __init__(self) -> None:
        self.streams = StreamWatch(Parameters())
        self.watch = HealthWatch(Parameters())
        self.t_s = 0.0

    def run(
        self,
        duration_s: float,
        *,
        nis: float = 3.0,
        std_rad: float = 0.02,
        imu: bool = True,
        attitude: bool = True,
        payload: PayloadState = ATTACHED,
        heartbeat_age_s: float | None = 0.5,
    ) -> Health:
        for _ in range(round(duration_s * 100.0)):
            self.t_s += 0.01
            if imu:
                self.streams.arrived(Stream.IMU, self.t_s)
            if attitude:
                self.streams.arrived(Stream.ATTITUDE, self.t_s)
            if imu and payload is ATTACHED:
                self.watch.step(0.01, nis, std_rad)
            assessment = self.watch.assess(
                self.t_s, self.watch.evidence(self.t_s, self.streams, payload, heartbeat_age_s)
            )
            assert (assessment.reason == "") == (assessment.health is Health.READY)
        return assessment.health

    def reason(self) -> str:
        return judge(self.watch.evidence(self.t_s, self.streams, ATTACHED, None)).reason


def test_it_waits_for_both_inputs_then_for_the_filter() -> None:
    judged = Judged()
    assert judged.reason() == "waiting for the autopilot's IMU"
    assert judged.run(0.1, attitude=False) is Health.INIT
    assert judged.reason() == "waiting for the autopilot's attitude"
    assert judged.run(SETTLE_S - 0.2) is Health.INIT
    assert judged.run(0.3) is Health.READY


@pytest.mark.parametrize(
    ("payload", "health"),
    [
        (PayloadState.ON_GROUND, Health.INIT),
        (PayloadState.SLACK, Health.INIT),
        (PayloadState.UNKNOWN, Health.DEGRADED),
        (PayloadState.ATTACHED, Health.READY),
    ],
)
def test_without_a_load_that_is_known_to_hang_it_is_not_ready(payload: PayloadState, health: Health) -> None:
    judged = Judged()
    judged.run(5.0)
    assert judged.run(0.01, payload=payload) is health


@pytest.mark.parametrize(
    ("age_s", "health"), [(None, Health.READY), (2.0, Health.READY), (HEARTBEAT_LOST_S + 0.1, Health.FAULT)]
)
def test_a_lost_heartbeat_is_a_fault(age_s: float | None, health: Health) -> None:
    judged = Judged()
    judged.run(5.0)
    assert judged.run(0.01, heartbeat_age_s=age_s) is health


def test_a_slow_link_degrades_and_heals() -> None:
    judged = Judged()
    judged.run(5.0)
    round_trip = judged.watch.round_trip
    round_trip.answered(judged.t_s, 2.0 * ROUND_TRIP_MAX_S)
    assert judged.run(0.01) is Health.DEGRADED
    for _ in range(3):
        round_trip.answered(judged.t_s, 0.02)
    assert judged.run(RECOVERY_S - 0.05) is Health.DEGRADED
    round_trip.answered(judged.t_s, 0.02)
    assert judged.run(0.1) is Health.READY
    assert judged.run(ROUND_TRIP_SILENCE_S + 0.05) is Health.DEGRADED, "answers that stop are slow ones"


def test_one_slow_answer_is_no_slow_link() -> None:
    watch = RoundTripWatch()
    assert not watch.is_slow(0.0), "an autopilot that never answers is not judged"
    for k, round_trip_s in enumerate((0.01, 0.01, 1.0, 0.01, 1.0)):
        watch.answered(0.1 * k, round_trip_s)
        assert watch.is_slow(0.1 * k) == (k == 4)
    watch.restarted()
    assert not watch.is_slow(9.0)


def test_the_clock_is_asked_for_seldom_until_it_answers() -> None:
    watch = RoundTripWatch()
    ticks_s = [0.05 * k for k in range(200)]
    assert sum(watch.request_due(t_s) for t_s in ticks_s) == 10
    watch.answered(10.0, 0.01)
    assert sum(watch.request_due(10.0 + t_s) for t_s in ticks_s) == 100


def test_an_uncertain_angle_is_not_ready() -> None:
    judged = Judged()
    assert judged.run(5.0, std_rad=0.2) is Health.INIT
    assert judged.run(0.1, std_rad=0.1) is Health.READY
    assert judged.run(0.1, std_rad=0.2) is Health.DEGRADED, "it was certain before"
    assert judged.run(RECOVERY_S + 0.05, std_rad=0.1) is Health.READY


def test_what_flickers_stays_degraded() -> None:
    judged = Judged()
    judged.run(5.0)
    for _ in range(10):
        assert judged.run(0.05, std_rad=0.2) is Health.DEGRADED
        assert judged.run(RECOVERY_S - 0.05, std_rad=0.1) is Health.DEGRADED


BEST = Evidence(True, True, True, True, True, True, ATTACHED, True, True, True, True, True)


def test_the_gravest_of_all_that_speaks_against_it_counts() -> None:
    """Over every combination: no state is better than what each single doubt asks for, where there are inputs."""
    doubts = [field.name for field in fields(Evidence) if field.name != "payload"]
    single = {doubt: judge(replace(BEST, **{doubt: False})).health for doubt in doubts}
    assert judge(BEST) == Assessment(Health.READY, "")
    assert set(single.values()) == {Health.INIT, Health.DEGRADED, Health.FAULT}
    for values in itertools.product((True, False), repeat=len(doubts)):
        for payload in PayloadState:
            evidence = replace(BEST, payload=payload, **dict(zip(doubts, values, strict=True)))
            told = judge(evidence)
            asked = {single[doubt] for doubt, value in zip(doubts, values, strict=True) if not value}
            if asked or payload is not ATTACHED:
                assert told.health in (Health.INIT, Health.DEGRADED, Health.FAULT)
                assert told.reason
            if evidence.imu_heard and evidence.attitude_heard and Health.FAULT in asked:
                assert told.health is Health.FAULT


@pytest.mark.parametrize("gone", ["imu", "attitude"])
def test_a_late_input_degrades_and_a_missing_one_is_a_fault(gone: str) -> None:
    judged = Judged()
    judged.run(5.0)
    silent = {gone: False}
    assert judged.run(LATE_S - 0.02, **silent) is Health.READY
    assert judged.run(0.05, **silent) is Health.DEGRADED
    assert judged.run(0.4, **silent) is Health.FAULT
    assert judged.run(RECOVERY_S - 0.02) is Health.FAULT, "what comes back has to stay"
    assert judged.run(0.05) is Health.READY


def test_disagreement_degrades_and_heals() -> None:
    judged = Judged()
    judged.run(5.0)
    assert judged.run(0.05, nis=40.0) is Health.READY, "one bad moment is none"
    assert judged.run(1.0, nis=40.0) is Health.DEGRADED
    assert judged.run(2.0) is Health.READY


def test_after_a_reset_it_must_have_been_consistent_for_a_while() -> None:
    judged = Judged()
    assert judged.run(4.0, nis=40.0) is not Health.READY
    assert judged.run(SETTLE_S - 0.1) is not Health.READY, "however long ago the reset was"
    assert judged.run(1.5) is Health.READY


def test_three_divergences_are_a_fault_for_a_while() -> None:
    judged = Judged()
    judged.run(5.0)
    for _ in range(3):
        assert judged.run(1.0) is not Health.FAULT
        judged.watch.reset(judged.t_s, fault=True)
    assert judged.run(1.0) is Health.FAULT
    assert judged.run(10.0) is Health.READY


def test_resets_that_nobody_is_to_blame_for_are_no_fault() -> None:
    judged = Judged()
    judged.run(5.0)
    for _ in range(5):
        judged.watch.reset(judged.t_s, fault=False)
        assert judged.run(0.5) is Health.INIT
    assert judged.run(SETTLE_S) is Health.READY


def test_motors_that_stand_are_nothing_to_complain_about() -> None:
    told = {}
    for armed in (False, True):
        watch = StreamWatch(Parameters())
        actions = [action for k in range(600) for action in watch.tick(0.05 * k, armed=armed)]
        told[armed] = {action.text.split(":")[0] for action in actions if isinstance(action, StatusText)}
    assert told[True] - told[False] == {"motors", "throttle"}
