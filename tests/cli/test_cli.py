"""The command line: output, exit codes, messages."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import swingd
from swingd.cli.main import app
from swingd.config.loader import load_parameters
from swingd.config.plain import plain
from swingd.config.schema import KEYS
from swingd.control.summary import summarise
from swingd.model.errors import ConfigurationError, LinkOpenError, LinkUrlError, LogFormatError, SwingdError

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
X500 = str(CONFIGS / "x500.yaml")
runner = CliRunner()


def test_version() -> None:
    result = runner.invoke(app, ["--version"])
    assert (result.exit_code, result.stdout) == (0, f"swingd {swingd.__version__}\n")


def commands() -> list[str]:
    return sorted(typer.main.get_command(app).commands)


def test_help_names_every_command_and_the_exit_codes() -> None:
    for flag in ("--help", "-h"):
        result = runner.invoke(app, [flag])
        assert result.exit_code == 0
        assert all(f"\n  {name} " in result.stdout for name in commands())
        assert "78 wrong configuration" in result.stdout


@pytest.mark.parametrize("command", commands())
def test_help_of_every_command_has_an_example(command: str) -> None:
    result = runner.invoke(app, [command, "--help"])
    assert result.exit_code == 0
    examples = result.stdout.partition("Examples:\n")[2]
    assert f"swingd {command}" in examples


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["chek"], "No such command 'chek'"),
        (["check"], "Missing argument 'FILE'"),
        (["check", X500, "--no-such"], "No such option: --no-such"),
        (["check", X500, "--set"], "Option '--set' requires an argument"),
    ],
)
def test_wrong_usage_exits_with_2(arguments: list[str], message: str) -> None:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stdout == ""


def test_without_a_command_the_help_is_shown() -> None:
    result = runner.invoke(app, [])
    assert result.exit_code == 2
    assert "Usage:" in result.output


# check


def test_check_prints_every_parameter_with_its_unit_and_marks_what_was_changed() -> None:
    result = runner.invoke(app, ["check", X500, "--set", "payload.mass_kg=0.4"])
    assert result.exit_code == 0
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert lines[0] == f"{X500}: valid; * marks what differs from the default"
    assert "* mass_kg                    0.4 kg  (default 0.3)" in lines
    assert "  mass_kg                    2.0 kg" in lines
    assert "* hook_frd_m                 [0.0, 0.0, 0.22] m  (default [0.0, 0.0, 0.0])" in lines
    groups = [line for line in lines if line in plain(load_parameters())]
    assert groups == [key for key in plain(load_parameters()) if key != "mode"]
    shown = [line[2:].split(" ")[0] for line in lines[1 : lines.index("linear swing")] if line[:2] in ("* ", "  ")]
    assert shown == ["none" if key.item else key.path[-1] for key in KEYS.values()]


def test_check_prints_what_follows_from_the_parameters() -> None:
    result = runner.invoke(app, ["check", X500])
    tail = result.stdout.partition("\nlinear swing\n")[2].splitlines()
    found = summarise(load_parameters(X500))
    # sqrt(9.80665 / 1.9) and sqrt(9.80665 / 1.9 * 2.192 / 2)
    assert tail[0] == "  fixed pivot   2.272 rad/s  0.362 Hz  period 2.77 s"
    assert tail[1] == "  free vehicle  2.378 rad/s  0.379 Hz  period 2.64 s"
    assert tail[3] == "hover with the load, 21.50 N"
    assert tail[4] == "  at 16.00 V    66.2% throttle"
    assert tail[5] == "  at 13.60 V    79.9% throttle"
    assert tail[7] == "correction, law placed"
    assert f"{found.correction.kp_mps2_per_rad:.3f} m/s^2/rad" in tail[8]
    assert f"{found.correction.kd_mps2_per_radps:.3f} m/s^2/(rad/s)" in tail[8]
    assert tail[9].endswith(f"damping ratio {found.correction.damping_ratio_off:.3f}")
    assert tail[10].endswith(f"damping ratio {found.correction.damping_ratio_on:.3f}")


def test_check_prints_endpoints_like_groups_and_where_every_link_leads() -> None:
    endpoints = (
        'endpoints=[{url: "udpin://:14541", shaper: zv}, {url: "udpout://10.1.1.9:14550", system_ids: [255, 1]}]'
    )
    result = runner.invoke(app, ["check", X500, "--set", endpoints])
    assert result.exit_code == 0
    assert (
        "\n\nendpoints.1\n"
        '* url                        "udpin://:14541"  (default "udpin://127.0.0.1:14541")\n'
        "* shaper                     zv  (default none)\n"
        "  key_file                   none\n"
        "  system_ids                 []\n"
        "\nendpoints.2\n"
    ) in result.stdout
    assert "\n* system_ids                 [255, 1]  (default [])\n\nwaypoints\n  none\n\nsimulation\n" in result.stdout
    assert result.stdout.endswith(
        "\nlinks\n"
        "  link.autopilot    udpin://0.0.0.0:14540\n"
        "  endpoints.1.url   udpin://127.0.0.1:14541\n"
        "  endpoints.2.url   udpout://10.1.1.9:14550\n"
    )
    found = json.loads(runner.invoke(app, ["check", X500, "--json", "--set", endpoints]).stdout)
    assert "endpoints" in found["changed"]
    assert found["parameters"]["endpoints"][1]["system_ids"] == [255, 1]
    assert found["links"] == {
        "link.autopilot": "udpin://0.0.0.0:14540",
        "endpoints.1.url": "udpin://127.0.0.1:14541",
        "endpoints.2.url": "udpout://10.1.1.9:14550",
    }


def test_check_says_what_it_cannot_give() -> None:
    """A load that an empty battery no longer carries, and a law whose gains are given."""
    result = runner.invoke(app, ["check", X500, "--set", "payload.mass_kg=1.4", "--set", "control.law=payload"])
    assert result.exit_code == 0
    assert "\n  at 13.60 V    not possible\n" in result.stdout
    assert "\ncorrection, law payload\n  gains         9.000 m/s^2/rad  2.000 m/s^2/(rad/s)\n" in result.stdout
    assert "\n  with          not computed: this law's gains are given, not designed\n" in result.stdout


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_check_as_json_is_one_object_on_one_line(path: Path) -> None:
    result = runner.invoke(app, ["check", str(path), "--json"])
    assert result.exit_code == 0
    assert result.stdout.count("\n") == 1
    found = json.loads(result.stdout)
    parameters = load_parameters(path)
    summary = summarise(parameters)
    assert found.keys() == {"file", "parameters", "changed", "swing", "hover", "correction", "links"}
    assert found["file"] == str(path)
    assert found["parameters"] == plain(parameters)
    assert found["swing"]["fixed_pivot"] == {
        "frequency_radps": summary.swing_fixed.frequency_radps,
        "frequency_hz": summary.swing_fixed.frequency_hz,
        "period_s": summary.swing_fixed.period_s,
    }
    assert found["swing"]["free_vehicle"]["frequency_radps"] == summary.swing_free.frequency_radps
    assert found["hover"]["thrust_n"] == summary.hover_thrust_n
    assert found["hover"]["sagged"]["throttle"] == summary.hover_sagged.throttle
    assert found["correction"]["on"]["damping_ratio"] == summary.correction.damping_ratio_on
    assert found["correction"]["poles_per_s"] == [[p.real, p.imag] for p in summary.correction.poles_per_s]


def test_check_as_json_lists_what_was_changed(tmp_path: Path) -> None:
    path = tmp_path / "test.yaml"
    path.write_text("payload: {mass_kg: 0.4}\ncable: {length_m: 1.5}\n", encoding="utf-8")
    result = runner.invoke(
        app, ["check", str(path), "--json", "--set", "payload.mass_kg=1.4", "--set", "control.law=payload"]
    )
    found = json.loads(result.stdout)
    assert found["changed"] == ["payload.mass_kg", "control.law"]
    assert found["hover"]["sagged"]["throttle"] is None
    assert found["correction"]["on"] is None


def test_check_lists_every_problem_on_stderr_and_exits_with_78(tmp_path: Path) -> None:
    path = tmp_path / "test.yaml"
    path.write_text("payload:\n  mass_kg: [bold]\n  lenght: 1\n", encoding="utf-8")
    result = runner.invoke(app, ["check", str(path), "--set", "cable.lenght_m=2"])
    assert result.exit_code == 78
    assert result.stdout == ""
    assert result.stderr == (
        f"swingd: {path}: 3 problems\n"
        "  payload.mass_kg (line 2): ['bold'] given; expected a number from 0.005 to 2000 kg\n"
        "  payload.lenght (line 3): no such key; did you mean cable.length_m?\n"
        "  cable.lenght_m (--set): no such key; did you mean cable.length_m?\n"
    )


def test_check_of_a_missing_file_exits_with_78(tmp_path: Path) -> None:
    result = runner.invoke(app, ["check", str(tmp_path / "no.yaml")])
    assert result.exit_code == 78
    assert result.stderr == (
        f"swingd: {tmp_path}/no.yaml: No such file or directory; expected a configuration file in YAML\n"
    )


def test_schema_prints_the_editors_schema() -> None:
    result = runner.invoke(app, ["schema"])
    assert result.exit_code == 0
    assert result.stdout == (CONFIGS / "schema.json").read_text(encoding="utf-8")


# Errors


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigurationError, 78),
        (LinkUrlError, 78),
        (LinkOpenError, 1),
        (LogFormatError, 1),
        (SwingdError, 1),
    ],
)
def test_an_expected_error_of_any_command_is_one_message_and_a_code(error: type[SwingdError], code: int) -> None:
    group = type(typer.main.get_command(app))
    other = typer.Typer(cls=group, rich_markup_mode=None)

    @other.callback()
    def root() -> None:
        """Stand beside one command."""

    @other.command()
    def fail() -> None:
        raise error("what [red]went[/red] wrong")

    result = runner.invoke(other, ["fail"])
    assert (result.exit_code, result.stdout) == (code, "")
    assert result.stderr == "swingd: what [red]went[/red] wrong\n"


def test_a_bug_is_not_disguised_as_an_expected_error() -> None:
    group = type(typer.main.get_command(app))
    other = typer.Typer(cls=group, rich_markup_mode=None)

    @other.callback()
    def root() -> None:
        """Stand beside one command."""

    @other.command()
    def fail() -> None:
        raise ZeroDivisionError

    assert isinstance(runner.invoke(other, ["fail"]).exception, ZeroDivisionError)


# The installed command


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    script = Path(sys.executable).with_name("swingd")
    return subprocess.run([script, *arguments], capture_output=True, text=True, check=False, timeout=120)


def test_the_installed_command_prints_and_exits() -> None:
    good = run("check", X500, "--json")
    assert (good.returncode, good.stderr) == (0, "")
    assert json.loads(good.stdout)["parameters"]["payload"]["mass_kg"] == 0.192
    bad = run("check", X500, "--set", "payload.mass_kg=x")
    assert (bad.returncode, bad.stdout) == (78, "")
    assert bad.stderr == (
        f"swingd: {X500}: 1 problem\n  payload.mass_kg (--set): 'x' given; expected a number from 0.005 to 2000 kg\n"
    )
    assert run("no-such-command").returncode == 2
