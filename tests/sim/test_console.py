"""What the console understands, and what it answers."""

from collections.abc import Callable
from math import radians

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.core.slung_plant import GRAVITY
from swingd.sim.console import USAGE, Console
from swingd.sim.faults import Faults
from swingd.sim.plant import Plant

from .rigs import iris


@pytest.fixture
def plant() -> Plant:
    made = Plant(iris(wind_ned_mps=(1.0, 2.0, 3.0)))
    made.place((1.0, -2.0, -20.0), rotors=0.5)
    return made


@pytest.fixture
def console(plant: Plant) -> Console:
    return Console(plant)


def test_wind_is_set_with_and_without_its_vertical_part(plant: Plant, console: Console) -> None:
    assert console.execute("wind 4 -0.5") == "ok wind 4 -0.5 0 m/s"
    assert plant.truth().wind_ned_mps == (4.0, -0.5, 0.0)
    assert console.execute("wind 0 1e0 -1") == "ok wind 0 1 -1 m/s"
    assert plant.truth().wind_ned_mps == (0.0, 1.0, -1.0)


def test_gusts_keep_their_time_constant_unless_told(plant: Plant, console: Console) -> None:
    assert console.execute("gust 1.5") == "ok gusts of 1.5 m/s, 2 s"
    assert console.execute("gust 2 0.5") == "ok gusts of 2 m/s, 0.5 s"
    assert console.execute("gust 1") == "ok gusts of 1 m/s, 0.5 s"
    assert (plant.gust_std_mps, plant.gust_time_constant_s) == (1.0, 0.5)


def test_a_seed_makes_gusts_repeat(plant: Plant, console: Console) -> None:
    winds = []
    for _ in range(2):
        assert console.execute("gust 2 1 7") == "ok gusts of 2 m/s, 1 s"
        assert plant.truth().wind_ned_mps == (1.0, 2.0, 3.0)
        plant.step((0.5,) * 4, 16.2, spinning=True)
        winds.append(plant.truth().wind_ned_mps)
    assert winds[0] == winds[1] != (1.0, 2.0, 3.0)


def test_a_load_is_released_and_hooked(plant: Plant, console: Console) -> None:
    assert console.execute("release") == "ok load released"
    assert not plant.attached
    plant.kick((5.0, 0.0, 0.0))
    plant.step((0.5,) * 4, 16.2, spinning=True)
    assert console.execute("hook") == "ok load of 0.3 kg hooked, cable 1.5 m"
    truth = plant.truth()
    assert truth.attached
    assert truth.chi_rad < radians(0.01)
    # Again is no mistake.
    assert console.execute("hook").startswith("ok")


def test_a_kick_adds_to_the_velocity(plant: Plant, console: Console) -> None:
    assert console.execute("kick 1.5 -2") == "ok load kicked by 1.5 -2 0 m/s"
    assert console.execute("kick 0 0 0.5") == "ok load kicked by 0 0 0.5 m/s"
    assert plant.truth().load_vel_ned_mps == (1.5, -2.0, 0.5)


def test_mass_and_length_change(plant: Plant, console: Console) -> None:
    assert console.execute("mass 0.6") == "ok load 0.6 kg"
    assert plant.load_mass_kg == 0.6
    assert console.execute("length 0.8") == "ok cable from 1.5 to 0.8 m, at most 1 m/s"
    assert plant.cable_target_m == 0.8


def test_status_tells_what_is_so(plant: Plant, console: Console) -> None:
    plant.place((1.0, -2.0, -20.0), xi_rad=radians(10.0), zeta_rad=radians(-5.0), rotors=0.5)
    assert console.execute("status").startswith("ok t_s=0.00 veh_ned_m=1.00,-2.00,-20.00 load_kg=0.3 cable_m=1.5 load=")
    console.execute("gust 1 3")
    plant.step((0.5,) * 4, 16.2, spinning=True)
    told = console.execute("status")
    assert told.startswith("ok t_s=0.00 ")
    fields = dict(word.split("=") for word in told.split() if "=" in word)
    assert float(fields["swing_lateral_deg"]) == pytest.approx(10.0, abs=0.2)
    assert float(fields["swing_longitudinal_deg"]) == pytest.approx(-5.0, abs=0.2)
    assert 0.5 * 0.3 * GRAVITY < float(fields["tension_n"]) < 1.2 * 0.3 * GRAVITY
    assert (fields["load"], fields["wind_ned_mps"]) == ("taut", "1,2,3")
    assert (fields["gust_mps"], fields["gust_time_s"]) == ("1", "3")
    console.execute("release")
    assert " load=released " in console.execute("status")


def test_help_tells_every_command_and_each_tells_its_own(console: Console) -> None:
    assert console.execute("help") == f"ok {USAGE}"
    for name in ("wind", "gust", "release", "hook", "kick", "mass", "length", "status"):
        assert name in USAGE
        assert console.execute(f"help {name}").startswith(f"ok {name}")
    assert console.execute("help wind") == "ok wind N E [D]: mean velocity of the air to north, east, down [m/s]"
    assert console.execute("help me").startswith("error: help me: no such command; expected one of wind, ")


def test_case_and_blanks_do_not_matter(plant: Plant, console: Console) -> None:
    assert console.execute("  WIND\t1   2 \r") == "ok wind 1 2 0 m/s"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (
            "",
            "error: no command given; expected one of "
            "wind, gust, release, hook, kick, mass, length, status, fault, help",
        ),
        ("wnd 1 2", "error: wnd 1 2: no such command; expected one of wind, gust, release"),
        ("wind", "error: wind: 0 numbers given; expected wind N E [D]: mean velocity of the air to north, east, down"),
        ("wind 1 2 3 4", "error: wind 1 2 3 4: 4 numbers given; expected wind N E [D]"),
        ("wind 1,5 2", "error: wind 1,5 2: 1,5 is no number; expected wind N E [D]: mean velocity"),
        ("wind 31 0", "error: wind 31 0: simulation.wind_ned_mps: 31 given; expected -30 to 30 m/s"),
        ("wind nan 0", "error: wind nan 0: simulation.wind_ned_mps: nan given; expected -30 to 30 m/s"),
        ("gust -1", "error: gust -1: simulation.gust_std_mps: -1 given; expected 0 to 15 m/s"),
        ("gust 1 0", "error: gust 1 0: simulation.gust_time_constant_s: 0 given; expected 0.05 to 60 s"),
        ("gust 1 1 1.5", "error: gust 1 1 1.5: simulation.seed: 1.5 given; expected a whole number"),
        ("gust 1 1 inf", "error: gust 1 1 inf: simulation.seed: inf given; expected a whole number"),
        ("release now", "error: release now: now is no number; expected release: let the load fall"),
        ("hook 1", "error: hook 1: 1 number given; expected hook: "),
        ("kick 1 99", "error: kick 1 99: kick: 1, 99, 0 given; expected each of -30 to 30 m/s"),
        ("mass", "error: mass: 0 numbers given; expected mass KG: mass of the load [kg]"),
        ("mass 0", "error: mass 0: payload.mass_kg: 0 given; expected 0.005 to 2000 kg"),
        ("length 1e9", "error: length 1e9: cable.length_m: 1e+09 given; expected 0.1 to 200 m"),
        ("\x1b[2J wind", "error: '\\x1b[2J wind': no such command"),
        ("x" * 500, "error: " + "x" * 60 + "...: no such command"),
    ],
)
def test_a_mistake_is_named_and_changes_nothing(plant: Plant, console: Console, line: str, answer: str) -> None:
    before = plant.truth()
    assert console.execute(line).startswith(answer)
    assert plant.truth() == before


def test_faults_are_injected_shown_and_ended(plant: Plant) -> None:
    faults = Faults(1)
    console = Console(plant, faults)
    assert console.execute("fault") == "ok no faults"
    plant.step((0.5,) * 4, 16.2, spinning=True)
    assert console.execute("fault loss 0.5 1..3") == "ok fault loss 0.5 (share of the frames) 1.00..3.00 s"
    assert faults.planned[0].start_s == pytest.approx(plant.t_s + 1.0)
    assert console.execute("fault gap").startswith("ok fault gap 0.00..")
    assert console.execute("fault").count(";") == 1
    assert console.execute("fault loss 2") == (
        "error: fault loss: strength 2 given; expected 0 to 1 (share of the frames)"
    )
    assert console.execute("fault off") == "ok no faults"
    assert faults.planned == ()


def test_a_real_autopilot_takes_no_faults(console: Console) -> None:
    assert console.execute("fault gap") == "error: fault: the autopilot is a real one; expected a simulated one"


def words() -> st.SearchStrategy[str]:
    names = st.sampled_from(USAGE.replace("|", " ").split())
    numbers = st.one_of(st.floats().map(str), st.integers().map(str))
    return st.lists(st.one_of(names, numbers, st.text(max_size=8)), max_size=6).map(" ".join)


@pytest.fixture(scope="module")
def any_console() -> Callable[[str], str]:
    return Console(Plant(iris()), Faults(1)).execute


@given(line=st.one_of(st.text(), words()))
def test_no_text_raises_and_every_answer_is_one_line(any_console: Callable[[str], str], line: str) -> None:
    answer = any_console(line)
    assert answer.startswith(("ok ", "error: "))
    assert answer.isprintable()
    assert answer.isascii()
