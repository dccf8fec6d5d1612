"""Faults: their grammar, and what each one does to the link, to the messages and to the world."""

import copy
import math
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.core.slung_plant import GRAVITY
from swingd.link.codec import Codec, Framer
from swingd.model.errors import ConfigurationError
from swingd.sim.faults import KINDS, Fault, parse_fault
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import DT_S

from .rigs import in_the_air, iris


@pytest.fixture
def peer() -> SimulatedAutopilot:
    """On the ground, a second after its start."""
    made = SimulatedAutopilot(iris())
    made.advance(1.0)
    return made


def flying() -> SimulatedAutopilot:
    """In the air, holding its place."""
    return in_the_air(iris()).peer


def frames(peer: SimulatedAutopilot, duration_s: float) -> Iterator[tuple[float, Any]]:
    """Time of arrival and message of everything that the autopilot sends."""
    framer = Framer()
    for _ in range(round(duration_s / DT_S)):
        for raw in peer.advance(peer.t_s + DT_S):
            for frame in framer.receive(raw):
                yield peer.t_s, frame.message


def count(peer: SimulatedAutopilot, duration_s: float) -> int:
    return sum(1 for _ in frames(peer, duration_s))


# ---- the grammar


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("loss 0.2 10..20", Fault("loss", 0.2, 10.0, 20.0)),
        ("gap 10..10.3", Fault("gap", None, 10.0, 10.3)),
        ("reboot 30..", Fault("reboot", None, 30.0)),
        ("clock -15 ..4", Fault("clock", -15.0, 0.0, 4.0)),
        ("gust", Fault("gust", 12.0)),
        ("  voltage   0  1e1..2e1 ", Fault("voltage", 0.0, 10.0, 20.0)),
    ],
)
def test_a_fault_is_written_in_one_line(text: str, fault: Fault) -> None:
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "fault: nothing given; expected KIND [STRENGTH] [START..END]"),
        ("gab 1..2", "fault 'gab': no such kind; expected one of loss, gap,"),
        ("loss 1.2", "fault loss: strength 1.2 given; expected 0 to 1 (share of the frames)"),
        ("loss nan", "fault loss: strength nan given; expected 0 to 1"),
        ("gap 0.3", "fault gap: strength 0.3 given; expected none"),
        ("loss much 1..2", "fault 'loss much 1..2': 'much' is no number; expected KIND [STRENGTH] [START..END]"),
        ("loss 0.1 a..2", "fault 'loss 0.1 a..2': 'a' is no number"),
        ("loss 0.1 0.2 1..2", "fault 'loss 0.1 0.2 1..2': too much given"),
        ("gap 5..4", "fault gap: from 5 to 4 s given; expected a start of at least 0 and a later end"),
        ("gap -1..4", "fault gap: from -1 to 4 s given"),
        ("gap nan..4", "fault gap: from nan to 4 s given"),
        ("gap 4..nan", "fault gap: from 4 to nan s given"),
    ],
)
def test_what_is_not_understood_is_named(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_fault(text)
    assert str(caught.value).startswith(message)


@given(st.text())
def test_any_text_is_a_fault_or_an_error(text: str) -> None:
    try:
        fault = parse_fault(text)
    except ConfigurationError:
        return
    assert fault.kind in KINDS


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_begins_and_ends_in_the_air_and_leaves_finite_numbers(name: str) -> None:
    peer = flying()
    peer.faults.inject(Fault(name, start_s=peer.t_s + 0.1, end_s=peer.t_s + 0.5))
    peer.advance(peer.t_s + 0.3)
    assert [fault.kind for fault in peer.faults.at_work] == [name]
    peer.advance(peer.t_s + 0.4)
    assert peer.faults.at_work == peer.faults.planned == ()
    assert not peer.faults.on_link
    assert all(math.isfinite(value) for value in peer.plant.state)


@pytest.mark.parametrize("name", ["loss", "jitter", "corrupt", "nan", "gust", "vibration"])
def test_the_same_seed_gives_the_same_flight(name: str) -> None:
    first = flying()
    first.faults.inject(Fault(name))
    second = copy.deepcopy(first)
    spoiled = first.advance(first.t_s + 1.0)
    assert spoiled == second.advance(second.t_s + 1.0)
    untouched = flying()
    assert untouched.advance(untouched.t_s + 1.0) != spoiled


# ---- the link


def test_a_share_of_the_frames_is_lost_both_ways(peer: SimulatedAutopilot) -> None:
    usual = count(copy.deepcopy(peer), 10.0)
    peer.faults.inject(Fault("loss", 0.3))
    assert count(peer, 10.0) == pytest.approx(0.7 * usual, rel=0.05)
    codec = Codec(255, 190)
    for _ in range(400):
        peer.receive(codec.encode(mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_XY_P", -1)))
    answers = [m for _, m in frames(peer, 0.2) if m.get_type() == "PARAM_VALUE"]
    assert len(answers) == pytest.approx(0.7**2 * 400, rel=0.15)


def test_a_gap_is_silence_and_nothing_of_it_comes_later(peer: SimulatedAutopilot) -> None:
    start_s = peer.t_s + 0.2
    peer.faults.inject(Fault("gap", None, start_s, start_s + 0.3))
    times = [t_s for t_s, _ in frames(peer, 1.0)]
    assert max(np.diff(times)) == pytest.approx(0.3, abs=0.03)


def test_every_frame_comes_twice(peer: SimulatedAutopilot) -> None:
    usual = count(copy.deepcopy(peer), 2.0)
    peer.faults.inject(Fault("duplicate"))
    assert count(peer, 2.0) == 2 * usual


def stamps_of_imu(peer: SimulatedAutopilot, duration_s: float) -> list[tuple[float, float]]:
    return [(t_s, 1e-6 * m.time_usec) for t_s, m in frames(peer, duration_s) if m.get_type() == "HIGHRES_IMU"]


def test_a_delay_makes_every_frame_equally_late_and_loses_none(peer: SimulatedAutopilot) -> None:
    usual = count(copy.deepcopy(peer), 3.0)
    start_s = peer.t_s
    peer.faults.inject(Fault("delay", 0.15, start_s, start_s + 2.0))
    arrivals = list(frames(peer, 3.0))
    assert len(arrivals) == usual
    late = [t_s - 1e-6 * m.time_usec for t_s, m in arrivals if m.get_type() == "HIGHRES_IMU"]
    assert late[:40] == pytest.approx([0.15] * 40, abs=0.01)
    assert max(late[-20:]) < 0.01


def test_jitter_delays_up_to_its_strength_in_order(peer: SimulatedAutopilot) -> None:
    peer.faults.inject(Fault("jitter", 0.2))
    arrivals = stamps_of_imu(peer, 20.0)
    late = np.array([t_s - stamp_s for t_s, stamp_s in arrivals])
    assert late.max() == pytest.approx(0.2, abs=0.02)
    assert np.quantile(late, 0.2) < 0.01
    assert all(b > a for (_, a), (_, b) in pairwise(arrivals))


def test_some_frames_are_overtaken_and_none_is_lost(peer: SimulatedAutopilot) -> None:
    usual = Counter(m.get_type() for _, m in frames(copy.deepcopy(peer), 2.0))
    end_s = peer.t_s + 1.9
    peer.faults.inject(Fault("reorder", 0.33, 0.0, end_s))
    arrivals = list(frames(peer, 2.0))
    assert Counter(m.get_type() for _, m in arrivals) == usual
    stamps = [m.time_usec for _, m in arrivals if m.get_type() == "HIGHRES_IMU"]
    assert sum(b < a for a, b in pairwise(stamps)) > 10


def test_corrupted_bytes_cost_their_frames(peer: SimulatedAutopilot) -> None:
    usual = count(copy.deepcopy(peer), 10.0)
    peer.faults.inject(Fault("corrupt", 0.3))
    assert count(peer, 10.0) == pytest.approx(0.7 * usual, rel=0.05)


# ---- what the autopilot says


def reals(message: Any) -> list[float]:
    return [value for value in message.to_dict().values() if isinstance(value, float)]


def test_numbers_that_are_none_stand_in_a_share_of_the_messages() -> None:
    peer = flying()
    peer.faults.inject(Fault("nan", 0.5))
    imu = [m for _, m in frames(peer, 4.0) if m.get_type() == "HIGHRES_IMU"]
    spoiled = [m for m in imu if not all(math.isfinite(value) for value in reals(m))]
    assert len(spoiled) == pytest.approx(0.5 * len(imu), rel=0.2)
    assert {value for m in spoiled for value in reals(m) if math.isinf(value)} == {math.inf, -math.inf}


def test_the_clock_steps_and_steps_back() -> None:
    peer = flying()
    start_s = peer.t_s
    peer.faults.inject(Fault("clock", 50.0, start_s + 1.0, start_s + 2.0))
    ahead = [(t_s - start_s, stamp_s - t_s) for t_s, stamp_s in stamps_of_imu(peer, 3.0)]
    assert [d for t, d in ahead if 1.05 < t < 1.95] == pytest.approx([50.0] * 45, abs=0.01)
    assert [d for t, d in ahead if t < 0.95 or t > 2.05][-1] == pytest.approx(0.0, abs=0.01)


def test_the_reported_voltage_is_not_the_true_one() -> None:
    peer = flying()
    true_v = peer.battery.voltage_v
    peer.faults.inject(Fault("voltage", 0.0), Fault("sag", 0.1))
    shown = {m.voltage_battery for _, m in frames(peer, 1.0) if m.get_type() == "SYS_STATUS"}
    assert 0 in shown
    assert peer.battery.voltage_v == pytest.approx(0.9 * true_v, rel=0.01)
    peer.faults.clear()
    shown = [m.voltage_battery for _, m in frames(peer, 1.0) if m.get_type() == "SYS_STATUS"]
    assert 1e-3 * shown[-1] == pytest.approx(peer.battery.voltage_v, abs=0.01)


def test_a_frozen_voltage_hides_the_drain() -> None:
    peer = flying()
    before_v = peer.battery.voltage_v
    peer.faults.inject(Fault("voltage_frozen"))
    peer.advance(peer.t_s + 3.0)
    assert peer.battery.reported_v == pytest.approx(before_v, abs=1e-3)
    assert peer.battery.voltage_v < before_v - 0.03


# ---- what it measures


def test_a_frozen_imu_has_new_stamps() -> None:
    peer = flying()
    peer.faults.inject(Fault("imu_frozen"))
    imu = [m for _, m in frames(peer, 1.0) if m.get_type() == "HIGHRES_IMU"][1:]
    assert len({(m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro) for m in imu}) == 1
    assert len({m.time_usec for m in imu}) == len(imu)


def test_the_accelerometer_is_biased_and_shaken() -> None:
    peer = flying()
    usual = [m for _, m in frames(copy.deepcopy(peer), 2.0) if m.get_type() == "HIGHRES_IMU"]
    biased, shaken = copy.deepcopy(peer), peer
    biased.faults.inject(Fault("acc_bias", 0.5))
    imu = [m for _, m in frames(biased, 2.0) if m.get_type() == "HIGHRES_IMU"]
    assert np.mean([m.yacc for m in imu]) - np.mean([m.yacc for m in usual]) == pytest.approx(0.5, abs=0.02)
    shaken.faults.inject(Fault("vibration", 10.0))
    imu = [m for _, m in frames(shaken, 2.0) if m.get_type() == "HIGHRES_IMU"]
    # Four lines that have the power of one of this amplitude at half throttle, where it grows with the square.
    expected = 10.0 / math.sqrt(2.0) * (np.mean(shaken.autopilot.rotors) / 0.5) ** 2
    assert np.std([m.yacc for m in imu]) == pytest.approx(expected, rel=0.3)


@pytest.mark.parametrize(("name", "field"), [("attitude", "roll"), ("yaw", "yaw")])
def test_the_estimated_attitude_steps_and_the_gyro_shows_nothing(name: str, field: str) -> None:
    peer = flying()
    start_s = peer.t_s + 0.5
    peer.faults.inject(Fault(name, 0.2, start_s))
    seen = [(t_s, m) for t_s, m in frames(peer, 1.0) if m.get_type() == "ATTITUDE"]
    before = next(m for t_s, m in reversed(seen) if t_s <= start_s)
    after = next(m for t_s, m in seen if t_s > start_s + DT_S)
    step = getattr(after, field) - getattr(before, field)
    assert step == pytest.approx(0.2 * (math.sqrt(0.5) if name == "attitude" else 1.0), abs=0.02)
    assert abs(after.rollspeed - before.rollspeed) < 0.1


# ---- the world, and who else talks


def test_gusts_reach_their_peak_and_end() -> None:
    peer = flying()
    peer.faults.inject(Fault("gust", 6.0, 0.0, peer.t_s + 8.0))
    speeds = []
    for _ in range(80):
        peer.advance(peer.t_s + 0.1)
        speeds.append(math.hypot(*peer.truth().wind_ned_mps))
    assert max(speeds) == pytest.approx(6.0, abs=0.2)
    peer.advance(peer.t_s + 0.1)
    assert peer.truth().wind_ned_mps == (0.0, 0.0, 0.0)


def test_a_load_that_is_thrown_up_slackens_its_cable() -> None:
    peer = flying()
    peer.faults.inject(Fault("slack", 3.0))
    start_s = peer.t_s
    peer.advance(start_s + 2.0 * DT_S)
    while not peer.truth().taut:
        peer.advance(peer.t_s + DT_S)
    # Up and down again; without its load the vehicle rises meanwhile, at most by the thrust that carried it.
    assert 6.0 / (GRAVITY * (1.0 + 0.3 / 1.5)) < peer.t_s - start_s < 6.0 / GRAVITY + 2.0 * DT_S


def test_motors_lose_power_behind_the_autopilots_back() -> None:
    peer = flying()
    peer.faults.inject(Fault("power", 0.3))
    peer.advance(peer.t_s + 0.1)
    commanded = np.mean(peer.autopilot.rotors)
    assert np.mean(peer.truth().rotor_commands) == pytest.approx(0.7 * commanded, rel=0.02)


def test_a_reboot_in_flight_stops_the_motors_and_starts_the_clock_anew() -> None:
    peer = flying()
    peer.faults.inject(Fault("reboot"))
    peer.advance(peer.t_s + 0.2)
    assert not peer.autopilot.armed
    assert peer.t_boot_s == pytest.approx(0.2, abs=0.01)


def test_a_rival_is_obeyed_and_heard() -> None:
    app = in_the_air(iris())
    app.offboard()
    app.keep = True
    app.peer.faults.inject(Fault("rival", 2.0))
    app.setpoint = None
    app.run(3.0)
    assert app.peer.truth().vel_ned_mps[0] > 1.0
    assert len(app.of_type("SET_POSITION_TARGET_LOCAL_NED")) == pytest.approx(60, abs=3)


def test_a_flood_has_its_rate(peer: SimulatedAutopilot) -> None:
    peer.faults.inject(Fault("flood", 300.0))
    questions = Counter(m.get_type() for _, m in frames(peer, 2.0))
    assert sum(n for name, n in questions.items() if name.startswith("PARAM_")) == pytest.approx(600, abs=3)
    assert questions["PARAM_SET"] > 200
