"""The soak: every rule that it judges by can be broken, growth is told from noise, and a short one passes."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swingd.engine import Engine
from swingd.model.actions import Action, Health, Setpoint, SwingReport
from swingd.model.events import SetpointUse
from swingd.model.parameters import SimulatedKind
from swingd.sim.faults import KINDS
from swingd.sim.plant import Plant
from tools.soak.__main__ import main
from tools.soak.flight import parameters_of
from tools.soak.pilot import STRENGTHS
from tools.soak.record import Lane, Latency, Sample
from tools.soak.verdict import GROWTH_MAX_MB, complaints, growth_of
from tools.soak.watch import SILENT_S, Rule, Watch

NOTHING = (0.0, 0.0, 0.0)
PARAMETERS = parameters_of(1, SimulatedKind.PX4)
SETPOINT = Setpoint(1.0, SetpointUse.VEL, NOTHING, NOTHING, NOTHING, 0.0, 0.0)
REPORT = SwingReport(
    *(0.0, 0.1, 0.1, 0.0, 0.0),
    force_ned_n=NOTHING,
    xi_std_rad=0.01,
    zeta_std_rad=0.01,
    thrust_n=20.0,
    thrust_scale=1.0,
    nis=3.0,
    correction_acc_ned_mps2=NOTHING,
    correction_vel_ned_mps=NOTHING,
    health=Health.READY,
)
PUSHING = replace(REPORT, correction_acc_ned_mps2=(0.3, 0.0, 0.0))


def watching() -> tuple[Watch, Engine]:
    """A watch over an engine that stands on the ground, whose envelope allows nothing."""
    watch = Watch()
    engine = Engine(PARAMETERS, watch.see)
    engine.join(0.0)
    watch.attach(engine)
    return watch, engine


def test_every_kind_of_fault_is_flown_within_its_bounds() -> None:
    assert set(STRENGTHS) == set(KINDS)
    for kind, drawn in STRENGTHS.items():
        bounds = KINDS[kind].strength
        assert (drawn is None) == (bounds is None)
        if drawn is not None and bounds is not None:
            assert bounds.low <= drawn[0] < drawn[1] <= bounds.high


@pytest.mark.parametrize(
    "action",
    [
        replace(SETPOINT, vel_ned_mps=(math.nan, 0.0, 0.0)),
        replace(SETPOINT, yaw_rad=math.inf),
        replace(REPORT, zeta_rad=math.nan),
        replace(REPORT, force_ned_n=(0.0, -math.inf, math.inf)),
        replace(REPORT, payload_mass_kg=math.nan),
    ],
)
def test_a_number_that_is_not_finite_is_seen(action: Action) -> None:
    watch, _ = watching()
    watch.since.application_s = 0.0
    watch.see(0.0, SETPOINT)
    watch.see(0.0, REPORT)
    assert not watch.breached
    watch.see(0.0, action)
    assert watch.breached == {Rule.NOT_FINITE.value: 1}


def test_a_setpoint_after_the_application_went_silent_is_seen() -> None:
    watch, _ = watching()
    watch.since.application_s = 10.0
    watch.see(10.0 + 0.99 * SILENT_S, SETPOINT)
    assert not watch.breached
    watch.see(10.0 + 1.01 * SILENT_S, SETPOINT)
    assert watch.breached == {Rule.SILENCE.value: 1}


def test_a_correction_that_the_envelope_forbids_may_fade_and_then_is_seen() -> None:
    watch, _ = watching()
    for t_s in np.arange(0.0, 1.1, 0.01):
        watch.see(float(t_s), PUSHING)
    assert not watch.breached
    watch.see(1.2, REPORT)
    for t_s in np.arange(1.3, 2.6, 0.01):
        watch.see(float(t_s), PUSHING)
    assert set(watch.breached) == {Rule.WITHHELD.value}
    assert len(watch.breaches) < watch.breached[Rule.WITHHELD.value]


@pytest.mark.parametrize(
    ("begin", "rule"),
    [
        (lambda watch, plant: setattr(watch.since, "off_s", 10.0), Rule.OFF),
        (lambda watch, plant: look(watch, plant, flying=False), Rule.NOT_FLYING),
        (lambda watch, plant: (plant.release(), look(watch, plant)), Rule.RELEASED),
    ],
)
def test_a_correction_is_judged_by_the_truth_too(begin: Callable[[Watch, Plant], object], rule: Rule) -> None:
    watch, _ = watching()
    plant = Plant(PARAMETERS)
    look(watch, plant)
    begin(watch, plant)
    watch.see(10.0, PUSHING)
    watch.see(15.0, PUSHING)
    assert watch.breached[rule.value] == 1
    others = {Rule.OFF.value, Rule.NOT_FLYING.value, Rule.RELEASED.value} - {rule.value}
    assert not others & set(watch.breached)


def test_while_something_is_wrong_nobody_need_see_a_release() -> None:
    watch, _ = watching()
    plant = Plant(PARAMETERS)
    plant.release()
    look(watch, plant, faults=True)
    assert watch.since.released_s == math.inf


def look(watch: Watch, plant: Plant, *, flying: bool = True, faults: bool = False) -> None:
    watch.look(10.0, 0.1, plant.truth(), flying=flying, faults=faults)


def test_an_exception_that_ended_the_pipeline_is_seen() -> None:
    watch, engine = watching()
    engine.failure = "ZeroDivisionError: division by zero"
    look(watch, Plant(PARAMETERS))
    assert [breach.text for breach in watch.breaches] == [engine.failure]


def test_the_error_is_that_of_both_angles_while_health_is_good() -> None:
    watch, _ = watching()
    plant = Plant(PARAMETERS)
    plant.place((0.0, 0.0, -10.0), xi_rad=0.1, zeta_rad=-0.1)
    plant.step((0.6, 0.6, 0.6, 0.6), 16.0, spinning=True)
    truth = plant.truth()
    watch.see(10.0, replace(REPORT, xi_rad=truth.xi_rad + 0.03, zeta_rad=truth.zeta_rad - 0.04))
    look(watch, plant)
    assert watch.take_error_deg(quiet=True) == pytest.approx(math.degrees(math.hypot(0.03, 0.04) / math.sqrt(2.0)))
    assert watch.take_error_deg(quiet=True) is None
    watch.see(10.0, replace(REPORT, health=Health.DEGRADED))
    look(watch, plant)
    assert watch.take_error_deg(quiet=True) is None


def test_latencies_are_those_of_all_durations_within_a_bin() -> None:
    durations_s = np.random.default_rng(3).lognormal(-9.0, 1.0, 20_000)
    latency = Latency()
    for duration_s in durations_s:
        latency.add(float(duration_s))
    taken = latency.take()
    assert taken.count == 20_000
    assert taken.p50_s == pytest.approx(np.percentile(durations_s, 50.0), rel=0.05)
    assert taken.p99_s == pytest.approx(np.percentile(durations_s, 99.0), rel=0.05)
    assert taken.max_s == durations_s.max()
    assert latency.take().count == 0


def lane(rss_mb: Callable[[float], float], handles: Callable[[float], int] = lambda _h: 9) -> Lane:
    """Twelve hours; a start that needs memory, and noise of 0.5 MB."""
    random = np.random.default_rng(5)
    told = Lane(1, "px4", 43_200.0, flown_s=43_200.0)
    for minute in range(1, 721):
        hours = minute / 60.0
        rss = rss_mb(hours) - 40.0 * math.exp(-hours / 0.1) + random.normal(0.0, 0.5)
        told.samples.append(Sample(60.0 * minute, int(1e6 * rss), handles(hours), {}, {}, {}, 1, 0))
    return told


def test_a_leak_is_told_from_noise_and_from_warming_up() -> None:
    steady, leaking = lane(lambda _h: 200.0), lane(lambda h: 200.0 + 1.5 * GROWTH_MAX_MB * h / 12.0)
    assert complaints([steady]) == []
    growth = growth_of(leaking)
    assert growth is not None
    assert growth.memory_mb == pytest.approx(1.5 * GROWTH_MAX_MB, rel=0.1)
    (said,) = complaints([steady, leaking])
    assert "memory grew" in said


def test_handles_that_stay_open_are_told() -> None:
    (said,) = complaints([lane(lambda _h: 200.0, handles=lambda h: 9 + int(h / 5.0))])
    assert "file handles" in said


def test_a_lane_that_breaks_a_rule_or_ends_early_fails() -> None:
    broken, short = lane(lambda _h: 200.0), lane(lambda _h: 200.0)
    broken.breached = {Rule.NOT_FINITE.value: 3}
    short.flown_s = 40_000.0
    first, second = complaints([broken, short])
    assert "not finite, 3 times" in first
    assert "ended after 40000 of 43200 s" in second


def test_minutes_of_flight_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["--hours", "0.04", "--lanes", "2", "--seed", "3", "--out", str(tmp_path), "--json"])
    figures = json.loads(capsys.readouterr().out)
    assert figures["complaints"] == []
    assert code == 0
    assert [told["autopilot"] for told in figures["lanes"]] == ["px4", "ardupilot"]
    for told in figures["lanes"]:
        assert told["flown_s"] == pytest.approx(72.0)
        assert told["faults"]
        assert {health for sample in told["samples"] for health in sample["health_s"]} >= {"init", "ready", "active"}
        assert 0.0 < told["hours"][-1]["pipeline"]["p50_s"] < told["hours"][-1]["engine"]["max_s"]
    assert json.loads((tmp_path / "soak.json").read_text()) == figures
    assert (tmp_path / "soak.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("wrong", [["--hours", "0"], ["--hours", "nan"], ["--lanes", "0"], ["--seed", "-1"]])
def test_wrong_usage_is_refused_by_name(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(wrong)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert wrong[0] in said
    assert wrong[1] in said
