"""``swingd sim``: its options and what it says, before and while it runs."""

import asyncio
import json
import signal
import socket
import sys
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.cli.sim import EXAMPLES, _start_command
from swingd.model.parameters import SimulatedKind
from swingd.sim.console import USAGE
from swingd.sim.faults import KINDS

runner = CliRunner()


def test_the_help_lists_every_command_of_the_console() -> None:
    assert USAGE.replace(" [COMMAND]", "") in EXAMPLES


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--hil", "gazebo"], "'gazebo' is not one of 'px4', 'ardupilot'"),
        (["--instance", "1"], "--instance: 1 given without --hil; expected --hil px4 or --hil ardupilot with it"),
        (["--instance", "0"], "--instance: 0 given without --hil"),
        (["--host", "0.0.0.0"], "--host: 0.0.0.0 given without --hil"),
        (["--hil", "px4", "--instance", "255"], "Invalid value for '--instance'"),
        (
            ["--hil", "px4", "--mavlink", "udpout://h:1"],
            "--mavlink: udpout://h:1 given with --hil px4; expected no link",
        ),
        (["--hil", "ardupilot", "--ground-station", "udpout://h:1"], "--ground-station: udpout://h:1 given with --hil"),
        (["--hil", "px4", "--fault", "gap"], "--fault: 'gap' given with --hil px4; expected no faults"),
        (["--console", "65536"], "Invalid value for '--console'"),
    ],
)
def test_options_that_do_not_go_together_are_wrong_usage(arguments: list[str], message: str) -> None:
    result = runner.invoke(app, ["sim", *arguments])
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loss 1.5 10..20", "fault loss: strength 1.5 given; expected 0 to 1 (share of the frames)"),
        ("los 0.5", "fault 'los': no such kind; expected one of loss, gap,"),
    ],
)
def test_a_fault_that_is_not_understood_ends_it_before_it_flies(text: str, message: str) -> None:
    result = runner.invoke(app, ["sim", "--fault", "gap 5..6", "--fault", text])
    assert result.exit_code != 0
    assert message in " ".join((result.stderr + str(result.exception)).split())


def test_the_help_lists_every_kind_of_fault() -> None:
    (option,) = (option for option in get_command(app).commands["sim"].params if option.name == "faults")
    assert f"KIND: {', '.join(KINDS)}." in option.help


async def started(*arguments: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "swingd", "sim", *arguments),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )


async def until(process: asyncio.subprocess.Process, text: str) -> list[str]:
    """Lines on standard error up to one that holds a text."""
    assert process.stderr is not None
    lines: list[str] = []
    async with asyncio.timeout(60.0):
        while not lines or text not in lines[-1]:
            line = await process.stderr.readline()
            assert line, lines
            lines.append(line.decode().rstrip("\n"))
    return lines


async def ask(port: int, line: str) -> str:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"{line}\n".encode())
    async with asyncio.timeout(5.0):
        answer = await reader.readline()
    writer.close()
    await writer.wait_closed()
    return answer.decode().rstrip("\n")


def port_in(lines: list[str]) -> int:
    return int(next(line for line in lines if line.startswith("commands: TCP port ")).split()[3])


async def ended(process: asyncio.subprocess.Process) -> tuple[int, str, str]:
    async with asyncio.timeout(20.0):
        out, err = await process.communicate()
    assert process.returncode is not None
    return process.returncode, out.decode(), err.decode()


@pytest.mark.live
async def test_a_simulated_autopilot_is_commanded_and_watched_while_it_runs(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as viewer:
        viewer.bind(("127.0.0.1", 0))
        viewer.settimeout(10.0)
        stream = f"udp://127.0.0.1:{viewer.getsockname()[1]}"
        process = await started(
            *("--mavlink", "udpout://127.0.0.1:9", "--set", "simulation.mavlink_bind_port=0", "--speed", "20"),
            *("--console", "0", "--truth-stream", stream, "--truth", str(tmp_path / "truth.csv")),
        )
        try:
            lines = await until(process, "commands: ")
            assert lines[-3].startswith("simulated PX4 on udpout://127.0.0.1:9, local port 0, 20 times real time")
            assert lines[-2] == f"truth, 50 times a simulated second, to {stream}"
            port = port_in(lines)
            assert await ask(port, "wind 3 -1 0.5") == "ok wind 3 -1 0.5 m/s"
            assert await ask(port, "mass 0.45") == "ok load 0.45 kg"
            assert (await ask(port, "mass -1")).startswith("error: mass -1: payload.mass_kg: -1 given; expected 0.005")
            async with asyncio.timeout(10.0):
                while True:
                    seen = json.loads(viewer.recv(65536))
                    if seen["wind_n_m_s"] == 3.0 and seen["load_kg"] == 0.45:
                        break
                    await asyncio.sleep(0)
            process.send_signal(signal.SIGINT)
            assert await ended(process) == (0, "", "stopped\n")
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
    header, *rows = (tmp_path / "truth.csv").read_text().splitlines()
    assert header.endswith(",load_kg,cable_m")
    assert rows[-1].endswith(",0.45,1.5")


WAITING = {
    ("--hil", "px4", "--instance", "93"): [
        "simulator for a real PX4, instance 93, 1 times real time; Ctrl-C stops",
        "next, in the folder of PX4's sources: PX4_SIM_MODEL=none_iris build/px4_sitl_default/bin/px4 -i 93",
        "waiting for PX4 on tcpin://127.0.0.1:4653",
    ],
    ("--hil", "ardupilot", "--instance", "93", "--host", "0.0.0.0", "--speed", "2"): [
        "simulator for a real ArduPilot, instance 93, 2 times real time; Ctrl-C stops",
        "next, in the folder of ArduPilot's sources: "
        "Tools/autotest/sim_vehicle.py -v ArduCopter -f X --model JSON:127.0.0.1 -I 93",
        "waiting for ArduPilot on udpin://0.0.0.0:9932",
    ],
}


async def wait_for_an_autopilot(arguments: tuple[str, ...], said: list[str]) -> None:
    process = await started(*arguments, "--console", "0")
    try:
        lines = await until(process, "waiting for")
        assert [line for line in lines if line in said] == said
        assert (await ask(port_in(lines), "status")).startswith("ok t_s=0.00 ")
        process.send_signal(signal.SIGINT)
        assert await ended(process) == (0, "", "stopped\n")
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


@pytest.mark.live
async def test_a_simulator_says_where_it_waits_and_what_comes_next() -> None:
    await asyncio.gather(*(wait_for_an_autopilot(arguments, said) for arguments, said in WAITING.items()))


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        ((SimulatedKind.PX4, 0, "127.0.0.1"), "make px4_sitl none_iris"),
        ((SimulatedKind.PX4, 0, "10.0.0.2"), "PX4_SIM_HOST_ADDR=10.0.0.2 make px4_sitl none_iris"),
        (
            (SimulatedKind.ARDUPILOT, 0, "10.0.0.2"),
            "Tools/autotest/sim_vehicle.py -v ArduCopter -f X --model JSON:10.0.0.2 -I 0",
        ),
    ],
)
def test_what_comes_next_fits_the_place(arguments: tuple[SimulatedKind, int, str], command: str) -> None:
    assert _start_command(*arguments) == command


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--truth-stream", "udp://127.0.0.1"], 78, "truth stream 'udp://127.0.0.1'; expected udp://HOST:PORT"),
        (["--truth", "/dev/full", "--duration", "0.1"], 1, "truth file /dev/full: No space left on device"),
    ],
)
def test_what_fails_ends_in_one_line(arguments: list[str], code: int, message: str) -> None:
    links = ["--mavlink", "udpout://127.0.0.1:9", "--set", "simulation.mavlink_bind_port=0"]
    result = runner.invoke(app, ["sim", *links, *arguments])
    assert result.exit_code == code
    assert f"swingd: {message}" in result.stderr
    assert "Traceback" not in result.stderr
