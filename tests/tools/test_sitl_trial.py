"""The trial on real autopilots: its figures on signals with a known answer; a short flight where there is a binary."""

import asyncio
import csv
import json
import math
import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.config.loader import load_parameters
from tools.sitl_trial import report
from tools.sitl_trial.__main__ import CONFIGS, main
from tools.sitl_trial.autopilots import Copter, Px4
from tools.sitl_trial.figures import fit_decay, judge_flight, judge_step, real_time_factors
from tools.sitl_trial.flight import Flight, fly_once
from tools.sitl_trial.picture import draw
from tools.sitl_trial.plan import BASE, COPTER, PX4, REST, Correction, Leg, Manoeuvre, Scenario, Velocity, one_step
from tools.sitl_trial.record import COLUMNS, Files, Flown, Step, TrialError, Truth
from tools.sitl_trial.slung_payload import write_truth
from tools.sitl_trial.terrain import FlatTerrain
from tools.sitl_trial.verdict import verdicts

BASE_FLIGHT = Scenario("base", 0.3, 1.5, one_step(3.0), BASE)
BEGIN_S, END_S = 10.0, 30.0
DAEMON = {"filter_hz": 100.0, "latency_ms_p99": 5.0}

Signal = Callable[[np.ndarray], np.ndarray]


def nothing(t: np.ndarray) -> np.ndarray:
    return np.zeros_like(t)


def truth(towards_n: Signal = nothing, *, vn: Signal = nothing, down: Signal = nothing, yaw_deg: float = 0.0) -> Truth:
    """A flight of 40 s whose load hangs towards the north by an angle of the time since the command."""
    t = np.arange(0.0, 40.0, 0.008)
    angle, yaw = towards_n(t - BEGIN_S), math.radians(yaw_deg)
    north = np.sin(angle)
    ahead, right = math.cos(yaw) * north, -math.sin(yaw) * north
    angles = np.array([np.arctan2(-right, np.cos(angle)), np.arcsin(ahead)])
    zero = np.zeros_like(t)
    velocity = np.array([vn(t - BEGIN_S), zero, zero])
    return Truth(t, angles, np.full_like(t, yaw), np.array([zero, zero, down(t - BEGIN_S)]), velocity)


def step(*velocity: tuple[float, float, float, float], last_s: float = BEGIN_S) -> Step:
    return Step("north", "0 -> 3 m/s", 0.0, BEGIN_S, last_s, END_S, list(velocity))


def decaying(t: np.ndarray, peak_rad: float = 0.5, period_s: float = 2.3, damping_ratio: float = 0.06) -> np.ndarray:
    pulsation = 2.0 * math.pi / period_s
    damping = pulsation * damping_ratio / math.sqrt(1.0 - damping_ratio**2)
    return np.where(t < 0.0, 0.0, peak_rad * np.exp(-damping * t) * np.cos(pulsation * t))


# ----------------------------------------------------------------------------------------------------------- figures


def test_a_swing_that_ends_at_once_has_the_figures_of_a_rectangle() -> None:
    found = judge_step(truth(lambda t: np.where((t >= 0.0) & (t < 3.0), math.radians(10.0), 0.0)), step(), BASE_FLIGHT)
    assert found.peak_deg == pytest.approx(10.0)
    assert found.settled
    assert found.settle_s == pytest.approx(3.0, abs=0.009)
    assert found.settle_periods == pytest.approx(3.0 / (2.0 * math.pi * math.sqrt(1.5 / 9.80665)), rel=0.01)
    assert found.rms_deg == pytest.approx(10.0 * math.sqrt(3.0 / 12.0), rel=0.01), "over 12 s, not to the end"
    assert found.velocity_rmse_mps is None, "no velocity was commanded"
    assert found.period_s is None, "nothing swings any more"


def test_what_still_swings_at_the_end_is_not_settled() -> None:
    found = judge_step(truth(lambda t: np.radians(5.0) * np.cos(2.0 * t)), step(), BASE_FLIGHT)
    assert not found.settled
    assert found.settle_s == pytest.approx(END_S - BEGIN_S, abs=0.5)


@pytest.mark.parametrize("yaw_deg", [0.0, 60.0, -135.0])
def test_a_decay_is_found_whatever_the_heading(yaw_deg: float) -> None:
    flown = truth(decaying, yaw_deg=yaw_deg)
    assert flown.towards_ne[0] == pytest.approx(np.sin(decaying(flown.t_boot_s - BEGIN_S)), abs=1e-9)
    assert flown.towards_ne[1] == pytest.approx(np.zeros_like(flown.t_boot_s), abs=1e-9)
    found = judge_step(flown, step(), BASE_FLIGHT)
    assert found.period_s == pytest.approx(2.3, rel=0.005)
    assert found.damping_ratio == pytest.approx(0.06, abs=0.003)
    assert found.peak_deg == pytest.approx(math.degrees(0.5), rel=1e-3)


@pytest.mark.parametrize("damping_ratio", [0.005, 0.06, 0.2])
@pytest.mark.parametrize("period_s", [2.2, 2.7])
def test_a_decay_is_told_apart_from_noise_and_a_lean(period_s: float, damping_ratio: float) -> None:
    t = np.arange(0.0, 15.0, 0.02)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    found = fit_decay(t, 0.1 + noise + decaying(t, 0.2, period_s, damping_ratio), 2.457)
    assert found is not None
    assert found.period_s == pytest.approx(period_s, rel=0.01)
    assert found.damping_ratio == pytest.approx(damping_ratio, abs=0.004)


def test_settling_counts_from_the_last_command_and_the_rms_from_the_first() -> None:
    flown = truth(lambda t: np.where((t >= 0.0) & (t < 6.0), math.radians(8.0), 0.0))
    found = judge_step(flown, step(last_s=BEGIN_S + 4.0), BASE_FLIGHT)
    assert found.settle_s == pytest.approx(2.0, abs=0.009)
    assert found.rms_deg == pytest.approx(8.0 * math.sqrt(6.0 / 16.0), rel=0.01)


def test_the_velocity_is_held_against_what_was_commanded_at_that_time() -> None:
    commanded = step((BEGIN_S, 3.0, 0.0, 0.0), (BEGIN_S + 6.0, 0.0, 0.0, 0.0))
    found = judge_step(truth(vn=lambda t: np.where(t < 6.0, 2.5, 0.5)), commanded, BASE_FLIGHT)
    assert found.velocity_rmse_mps == pytest.approx(0.5, rel=1e-3)


def test_the_altitude_is_held_against_the_second_before_the_command() -> None:
    found = judge_step(truth(down=lambda t: np.where(t < 0.0, -5.0, -5.0 - 0.02 * t)), step(), BASE_FLIGHT)
    assert found.altitude_m == pytest.approx(0.02 * 12.0, rel=0.01)


def test_a_load_that_hangs_askew_while_travelling_counts_from_there_with_its_own_drag() -> None:
    lean = math.radians(6.0)
    flown = truth(lambda t: np.where(t < 2.0, 0.0, -lean))
    assert not judge_step(flown, step(), BASE_FLIGHT).settled
    found = judge_step(flown, step(), replace(BASE_FLIGHT, built_in=True))
    assert found.settled
    assert found.settle_s == pytest.approx(2.0, abs=0.009)
    assert found.peak_deg == pytest.approx(6.0)


def test_a_truth_that_ends_before_the_step_is_refused() -> None:
    short = Truth(*(values[..., :2000] for values in (truth().t_boot_s, truth().angles_rad, truth().yaw_rad)),
                  truth().pos_ned_m[:, :2000], truth().vel_ned_mps[:, :2000])  # fmt: skip
    with pytest.raises(TrialError, match=r"the truth covers 0\.0 to 16\.0 s .* the step 10\.0 to 30\.0 s"):
        judge_step(short, step(), BASE_FLIGHT)


def test_the_estimate_is_judged_by_axis_and_only_around_the_manoeuvres() -> None:
    times = np.arange(0.0, 40.0, 0.02)
    bias = np.radians(np.where(times < BEGIN_S - 5.0, 50.0, 0.4))
    zeta = decaying(times - BEGIN_S) + 0.5 * bias
    flown = Flown(
        "1",
        [step()],
        [(t, b, z, 0.1 if t < BEGIN_S else 0.7) for t, b, z in zip(times, bias, zeta, strict=True)],
        [(0.0, 0.0), (40.0, 50.0)],
    )
    found = judge_flight(truth(decaying), flown, DAEMON)
    assert found.xi_rmse_deg == pytest.approx(0.4, rel=0.01)
    assert found.zeta_rmse_deg == pytest.approx(0.2, rel=0.02)
    assert found.correction_mps2 == 0.7
    assert found.filter_hz == 100.0


def test_a_stall_shows_in_the_worst_two_seconds() -> None:
    clock = [
        (t, t + max(0.0, min(1.0, t - 20.0))) for t in np.arange(0.0, 40.0, 0.1)
    ]  # between 20 and 21 s half as fast
    mean, worst = real_time_factors(clock, 10.0, 30.0)
    assert mean == pytest.approx(20.0 / 21.0, rel=0.01)
    assert worst == pytest.approx(0.5, abs=0.03)


# ---------------------------------------------------------------------------------------------------------- verdicts


def flight(correction: Correction, swing_deg: float, *, settle_s: float = 2.0, vn: float = 2.5) -> Flight:
    """One whose load hangs at an angle for some time after the command."""
    swing = truth(
        lambda t: np.where((t >= 0.0) & (t < settle_s), math.radians(swing_deg), 0.0), vn=lambda t: np.full_like(t, vn)
    )
    times = swing.t_boot_s[::5]
    flown = Flown(
        "1.16.0", [step((BEGIN_S, 3.0, 0.0, 0.0))], [(t, *swing.angles_rad[:, 5 * i], 0.0) for i, t in enumerate(times)]
    )
    flown.clock = [(t, t) for t in times]
    figures = judge_flight(swing, flown, DAEMON)
    steps = tuple((each, judge_step(swing, each, BASE_FLIGHT)) for each in flown.steps)
    return Flight("base", BASE_FLIGHT, correction, flown, swing, figures, steps)


def missed(*flights: Flight) -> set[tuple[str, str]]:
    return {(v.where.split(":")[0], v.what) for v in verdicts(list(flights)) if not v.reached}


def test_flights_that_reach_everything_miss_nothing() -> None:
    flights = [flight(Correction.OFF, 20.0), flight(Correction.ON, 8.0), flight(Correction.SHAPED, 6.9)]
    assert missed(*flights) == set()
    # The estimate of each axis in three flights; four figures of the step with each correction.
    assert len(verdicts(flights)) == 3 * 2 + 2 * 4


@pytest.mark.parametrize(
    ("correction", "swing_deg", "more", "what"),
    [
        (Correction.ON, 9.1, {}, "swing RMS, of uncorrected"),
        (Correction.SHAPED, 7.1, {}, "swing RMS, of uncorrected"),
        (Correction.ON, 4.0, {"settle_s": 2.6}, "under 2 deg after [s]"),
        (Correction.ON, 2.1, {"settle_s": 25.0}, "under 2 deg after [s]"),
        (Correction.ON, 8.0, {"vn": 2.2}, "velocity error, of uncorrected"),
    ],
)
def test_each_asked_figure_is_held(correction: Correction, swing_deg: float, more: dict[str, float], what: str) -> None:
    flights = flight(Correction.OFF, 20.0), flight(correction, swing_deg, **more)
    assert (f"base, {correction}", what) in missed(*flights)


def test_without_the_uncorrected_flight_ratios_are_not_judged() -> None:
    judged = {verdict.what for verdict in verdicts([flight(Correction.ON, 19.0)])}
    assert "under 2 deg after [s]" in judged
    assert not any("uncorrected" in what for what in judged)


# ------------------------------------------------------------------------------------------------------------- files


def test_the_report_holds_the_same_figures_in_each_form(tmp_path: Path) -> None:
    flights = [flight(Correction.OFF, 20.0), flight(Correction.ON, 8.0)]
    report.write(tmp_path, flights, verdicts(flights), ["wind, on: no autopilot"])
    rows = list(csv.DictReader((tmp_path / "trial.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["correction"] for row in rows] == ["off", "on"]
    assert float(rows[1]["rms_ratio"]) == pytest.approx(0.4)
    found = json.loads((tmp_path / "trial.json").read_text(encoding="utf-8"))
    assert found["steps"][1]["rms_ratio"] == float(rows[1]["rms_ratio"])
    assert found["not_flown"] == ["wind, on: no autopilot"]
    text = (tmp_path / "trial.md").read_text(encoding="utf-8")
    assert "swingd" in text.splitlines()[0]
    assert "1.16.0" in text.splitlines()[0]
    row = next(line for line in text.splitlines() if line.startswith("| base: north"))
    assert "20.0 / 8.0" in row
    assert "wind, on: no autopilot" in text


def test_each_manoeuvre_gets_a_picture(tmp_path: Path) -> None:
    (path,) = draw(tmp_path, [flight(Correction.OFF, 20.0), flight(Correction.ON, 8.0)])
    assert path.name == "base-north.png"
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_flight_is_read_back_as_it_was_saved(tmp_path: Path) -> None:
    flown = flight(Correction.ON, 8.0).flown
    flown.save(tmp_path / "flown.json")
    again = Flown.load(tmp_path / "flown.json")
    assert again.steps[0].t_last_s == flown.steps[0].t_last_s
    assert np.array_equal(again.estimate, flown.estimate)
    (tmp_path / "flown.json").write_text('{"version": "1"}', encoding="utf-8")
    with pytest.raises(TrialError, match=r"flown\.json.*expected a flight of this tool"):
        Flown.load(tmp_path / "flown.json")


def test_a_truth_file_may_end_in_the_middle_of_a_row(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    rows = "".join(f"{0.1 * i},{','.join(['0.5'] * 9)}\n" for i in range(5))
    path.write_text(f"{','.join(COLUMNS)}\n{rows}0.5,0.5,0.", encoding="utf-8")
    assert Truth.load(path).t_boot_s == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    path.write_text("t_boot_s,other\n0,1\n1,2\n", encoding="utf-8")
    with pytest.raises(TrialError, match="swing_lateral_rad"):
        Truth.load(path)


# ----------------------------------------------------------------------------------------- ArduPilot's slung payload

_HEAD = b"\xa3\x95"
_CTYPES = {"Q": "Q", "f": "f", "d": "d", "b": "b", "C": "H", "c": "h"}


class OnboardLog:
    """Writes ArduPilot's binary onboard log, as far as its reader needs."""

    def __init__(self) -> None:
        self._formats: dict[str, tuple[int, struct.Struct]] = {}
        self._data = b""
        self._describe(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)

    def _describe(self, number: int, name: str, form: str, columns: str, length: int) -> None:
        texts = struct.pack("<4s16s64s", name.encode(), form.encode(), columns.encode())
        self._data += _HEAD + bytes([128, number, length]) + texts

    def write(self, name: str, form: str, columns: str, *values: float) -> None:
        if name not in self._formats:
            packer = struct.Struct("<" + "".join(_CTYPES[letter] for letter in form))
            self._formats[name] = (130 + len(self._formats), packer)
            self._describe(self._formats[name][0], name, form, columns, 3 + packer.size)
        number, packer = self._formats[name]
        self._data += _HEAD + bytes([number]) + packer.pack(*values)

    def save(self, path: Path) -> None:
        path.write_bytes(self._data)


def test_the_onboard_log_of_a_copter_becomes_truth_in_the_heading_frame(tmp_path: Path) -> None:
    """GIVEN a load on 5 m that swings north and south, a vehicle that moves east and heads 300 deg."""
    length_m, yaw_deg = 5.0, 300.0
    log = OnboardLog()

    def angle(t_s: float) -> float:
        return 0.3 * math.cos(1.4 * t_s)

    for i in range(2000):
        t_us, t_s = 10_000 * i, 0.01 * i
        log.write("SIM2", "Qddd" + "fff", "TimeUS,PN,PE,PD,VN,VE,VD", t_us, 0.0, 2.0 * t_s, -9.0, 0.0, 2.0, 0.0)
        if i % 4 == 0:
            log.write("SIM", "QC", "TimeUS,Yaw", t_us, round(100 * yaw_deg))
        if i % 10 == 0:
            offset = length_m * math.sin(angle(t_s)), 0.0, length_m * math.cos(angle(t_s))
            log.write("SLUP", "Qfff", "TimeUS,PN,PE,PD", t_us, *offset)
    (tmp_path / "logs").mkdir()
    log.save(tmp_path / "logs" / "00000001.BIN")
    write_truth(tmp_path / "logs", tmp_path / "truth.csv")
    found = Truth.load(tmp_path / "truth.csv")
    expected = np.array([math.sin(angle(t)) for t in found.t_boot_s])
    assert found.t_boot_s[-1] > 19.0
    assert found.towards_ne[0] == pytest.approx(expected, abs=1e-3)
    assert found.towards_ne[1] == pytest.approx(np.zeros_like(expected), abs=1e-3)
    # Heading west-north-west, a load in the north is ahead and to the right.
    first = found.angles_rad[:, 0]
    assert first[1] == pytest.approx(math.asin(math.sin(0.3) * math.cos(math.radians(60.0))), abs=1e-3)
    assert first[0] < 0.0
    assert found.pos_ned_m[1] == pytest.approx(2.0 * found.t_boot_s, abs=1e-3)


def test_a_log_without_slung_payload_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrialError, match="no onboard log"):
        write_truth(tmp_path, tmp_path / "truth.csv")
    log = OnboardLog()
    for i in range(10):
        log.write("SIM", "QC", "TimeUS,Yaw", 1000 * i, 0)
    log.save(tmp_path / "00000001.BIN")
    with pytest.raises(TrialError, match="too little of SLUP, SIM2"):
        write_truth(tmp_path, tmp_path / "truth.csv")


def test_the_ground_is_flat_wherever_the_autopilot_asks() -> None:
    terrain, copter = FlatTerrain(584), mavlink.MAVLink(None, 7, 1)
    heard = mavlink.MAVLink(None)

    def said(data: bytes) -> list[Any]:
        return list(heard.parse_buffer(data) or [])

    assert [message.get_type() for message in said(terrain.hello())] == ["HEARTBEAT"]
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 0, 3).pack(copter)
    (asked,) = said(terrain.receive(b"noise" + beat[:5])) + said(terrain.receive(beat[5:]))
    assert (asked.target_system, asked.command, asked.param1) == (7, 511, mavlink.MAVLINK_MSG_ID_TERRAIN_REQUEST)
    assert terrain.receive(beat) != b"", "asked until it is heard"
    mask = 1 << 55 | 0b101
    request = mavlink.MAVLink_terrain_request_message(-353_632_620, 1_491_652_370, 100, mask).pack(copter)
    answers = said(terrain.receive(request))
    assert [answer.gridbit for answer in answers] == [0, 2, 55]
    assert terrain.receive(beat) == b""
    for answer in answers:
        assert (answer.lat, answer.lon, answer.grid_spacing) == (-353_632_620, 1_491_652_370, 100)
        assert list(answer.data) == [584] * 16


# --------------------------------------------------------------------------------------------------- the command line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--autopilot", "px4"], "neither --binary nor $SWINGD_PX4"),
        (["--autopilot", "ardupilot", "--binary", "/nowhere"], "no file /nowhere"),
        (["--autopilot", "px4", "--binary", __file__, "--only", "loops"], "no loops; expected steps"),
        (["--autopilot", "px4", "--binary", __file__, "--set", "payload.mass_kg=-1"], "payload.mass_kg"),
    ],
)
def test_wrong_usage_is_told(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWINGD_PX4", raising=False)
    assert main(arguments) == 2
    assert said in capsys.readouterr().err.replace("\n", " ")


@pytest.mark.parametrize("scenario", [*PX4, *COPTER], ids=lambda scenario: scenario.name)
def test_every_scenario_can_be_simulated_and_gives_an_uncorrected_load_time_to_rest(scenario: Scenario) -> None:
    config = CONFIGS["px4" if scenario in PX4 else "ardupilot"]
    parameters = scenario.parameters(load_parameters(config))
    assert (parameters.payload.mass_kg, parameters.cable.length_m) == (scenario.load_kg, scenario.cable_m)
    for manoeuvre in scenario.manoeuvres(scenario.period_s):
        assert manoeuvre.legs[-1].duration_s >= max(12.0, 8.0 * scenario.period_s)
        if not manoeuvre.each:
            assert manoeuvre.legs[-1].setpoint == Velocity(REST)


# ------------------------------------------------------------------------------------------------- a real autopilot


def binary(variable: str) -> Path:
    named = os.environ.get(variable)
    if not named:
        pytest.skip(f"${variable} names no autopilot binary")
    return Path(named).absolute()


@pytest.mark.live
@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_a_real_autopilot_flies_a_step_with_a_calm_load(kind: str, tmp_path: Path) -> None:
    if kind == "px4":
        autopilot, scenario = Px4(binary("SWINGD_PX4")), PX4[0]
    else:
        autopilot, scenario = Copter(binary("SWINGD_COPTER"), binary("SWINGD_COPTER_DEFAULTS")), COPTER[-1]
    files = Files(tmp_path / "on")
    rest_s = max(8.0, 3.0 * scenario.period_s)
    legs = (Leg("0 -> 2 m/s", Velocity((2.0, 0.0, 0.0)), rest_s), Leg("2 -> 0 m/s", Velocity(REST), rest_s))
    short = [Manoeuvre("north", legs, each=True)]
    parameters = load_parameters(CONFIGS[kind])
    asyncio.run(fly_once(autopilot, parameters, scenario, short, Correction.ON, files, lambda _doing, _share: None))
    flown = Flight.load(scenario.name, scenario, Correction.ON, files)
    assert files.recording.stat().st_size > 100_000
    assert flown.figures.xi_rmse_deg < 1.0
    assert flown.figures.zeta_rmse_deg < 1.0
    for _, figures in flown.steps:
        assert figures.peak_deg > 4.0, "the load was made to swing"
        assert figures.settled
        assert figures.settle_periods < 2.0
    assert abs(flown.truth.vel_ned_mps[0, -1]) < 0.3
