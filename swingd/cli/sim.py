"""``swingd sim``."""

import asyncio
import json
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swingd.cli import options, process
from swingd.model.parameters import SimulatedKind

if TYPE_CHECKING:
    from swingd.model.parameters import Parameters
    from swingd.sim.faults import Fault
    from swingd.sim.outlets import Outside

EXAMPLES = """\b
Examples:
  swingd sim -c configs/demo.yaml
  swingd sim --set 'simulation.wind_ned_mps=[4, 0, 0]' --set simulation.gust_std_mps=1 --truth truth.csv
  swingd sim --ground-station udpout://127.0.0.1:14550
  swingd sim --mavlink udpout://127.0.0.1:14550 --speed 3
  swingd sim --fault 'loss 0.2 30..40' --fault 'gap 50..50.3' --fault 'gust 12 60..'
  swingd sim --console 4559 --truth-stream udp://127.0.0.1:9870
  swingd sim -c configs/iris.yaml --hil px4 --console 4559
  swingd sim --hil ardupilot --instance 1 --set payload.mass_kg=0.5 --truth truth.csv
\b
Commands while it runs, on this terminal and on the console's port (printf 'wind 4 0\\n' | nc -q 1 localhost 4559):
  wind N E [D] | gust STD [TIME [SEED]] | release | hook | kick N E [D] | mass KG | length M | status | \
fault [TEXT] | help
"""

_LOOPBACK = "127.0.0.1"
_THIS_MACHINE = (_LOOPBACK, "localhost", "0.0.0.0")
_INSTANCE_MAX = 254  # the autopilots' system ids are one more


def sim(
    config: options.Config = None,
    overrides: options.Overrides = None,
    hil: Annotated[
        SimulatedKind | None,
        typer.Option("--hil", help="Be the simulator of a real autopilot's SITL instead of simulating the autopilot."),
    ] = None,
    instance: Annotated[
        int | None,
        typer.Option(
            "--instance",
            metavar="N",
            min=0,
            max=_INSTANCE_MAX,
            help="Instance of the real autopilot, which shifts its ports: PX4 TCP 4560 + N, ArduPilot UDP 9002 + 10 N.",
        ),
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            "--host", metavar="ADDRESS", help="Address to listen on for the real autopilot; default: 127.0.0.1."
        ),
    ] = None,
    mavlink: Annotated[
        str | None, typer.Option("--mavlink", metavar="URL", help="Where to talk to instead of simulation.mavlink.")
    ] = None,
    ground_station: Annotated[
        str | None, typer.Option("--ground-station", metavar="URL", help="A second link; both hear each other.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="FILE", help="Write the truth at 125 Hz as CSV.")
    ] = None,
    truth_stream: Annotated[
        str | None,
        typer.Option(
            "--truth-stream", metavar="udp://HOST:PORT", help="Send the truth at 50 Hz, one JSON object a datagram."
        ),
    ] = None,
    console: Annotated[
        int | None,
        typer.Option(
            "--console",
            metavar="PORT",
            min=0,
            max=65535,
            help="Take commands on this TCP port of 127.0.0.1, one line in, one line out; 0: any free port.",
        ),
    ] = None,
    faults: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            metavar="TEXT",
            help="Inject a fault: KIND [STRENGTH] [START..END] in simulated seconds; repeatable. "
            "KIND: loss, gap, duplicate, reorder, jitter, delay, corrupt, nan, clock, imu_frozen, acc_bias, vibration, "
            "voltage, voltage_frozen, sag, attitude, yaw, reboot, gust, slack, power, rival, flood.",
        ),
    ] = None,
    speed: Annotated[
        float | None, typer.Option("--speed", metavar="X", help="Simulated over real time instead of simulation.speed.")
    ] = None,
    duration_s: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=0.0, help="Stop after this simulated time [s]; default: never."),
    ] = None,
) -> None:
    """Simulate a vehicle with a slung load.

    With a simulated PX4 or Copter (simulation.autopilot) on its MAVLink link, for swingd or any other MAVLink tool; or,
    with --hil, as the external simulator of a real PX4 or ArduPilot in SITL.
    """
    _refuse_what_does_not_go_together(hil, instance, host, mavlink, ground_station, faults)
    from swingd.config.loader import load_parameters

    settings = list(overrides or ())
    if mavlink is not None:
        settings.append(f"simulation.mavlink={json.dumps(mavlink)}")
    if speed is not None:
        settings.append(f"simulation.speed={speed!r}")
    if ground_station is not None:
        settings.append(f"simulation.ground_station={json.dumps(ground_station)}")
    parameters = load_parameters(config, settings)
    process.check_output(truth, "--truth", (config,))
    process.announce_compilation()
    process.end_on_signals()
    from swingd.sim.outlets import Outside

    outside = Outside(truth_file=truth, truth_url=truth_stream, console=console, keyboard=True, say=_say)
    if hil is None:
        from swingd.sim.faults import parse_fault

        injected = [parse_fault(text) for text in faults or ()]
        running = _simulate_autopilot(parameters, outside, injected, duration_s)
    else:
        running = _serve_autopilot(hil, parameters, instance or 0, host or _LOOPBACK, outside, duration_s)
    with asyncio.Runner(loop_factory=process.event_loop_factory()) as runner:
        try:
            runner.run(running)
        except KeyboardInterrupt:
            _say("stopped")


def _say(line: str) -> None:
    typer.echo(line, err=True)


def _refuse_what_does_not_go_together(
    hil: SimulatedKind | None,
    instance: int | None,
    host: str | None,
    mavlink: str | None,
    ground_station: str | None,
    faults: list[str] | None,
) -> None:
    if hil is None:
        for option, value in (("--instance", instance), ("--host", host)):
            if value is not None:
                raise typer.BadParameter(
                    f"{value} given without --hil; expected --hil px4 or --hil ardupilot with it", param_hint=option
                )
        return
    for option, url in (("--mavlink", mavlink), ("--ground-station", ground_station)):
        if url is not None:
            raise typer.BadParameter(
                f"{url} given with --hil {hil.value}; expected no link of the simulator's own, "
                "the real autopilot has its MAVLink links itself",
                param_hint=option,
            )
    if faults:
        raise typer.BadParameter(
            f"{faults[0]!r} given with --hil {hil.value}; expected no faults, they are the simulated autopilot's",
            param_hint="--fault",
        )


def _simulate_autopilot(
    parameters: "Parameters", outside: "Outside", faults: "Sequence[Fault]", duration_s: float | None
) -> Coroutine[Any, Any, object]:
    from swingd.sim.run import run_simulation

    simulation = parameters.simulation
    _say(
        f"simulated {_NAMES[simulation.autopilot]} on {simulation.mavlink}, local port {simulation.mavlink_bind_port}, "
        f"{simulation.speed:g} times real time; Ctrl-C stops"
    )
    for fault in faults:
        _say(f"fault: {fault}")
    return run_simulation(parameters, outside=outside, faults=faults, duration_s=duration_s)


def _serve_autopilot(
    kind: SimulatedKind,
    parameters: "Parameters",
    instance: int,
    host: str,
    outside: "Outside",
    duration_s: float | None,
) -> Coroutine[Any, Any, object]:
    run: Callable[..., Coroutine[Any, Any, object]]
    if kind is SimulatedKind.PX4:
        from swingd.sim.hil.px4 import run_px4 as run
    else:
        from swingd.sim.hil.ardupilot import run_ardupilot as run
    _say(
        f"simulator for a real {_NAMES[kind]}, instance {instance}, "
        f"{parameters.simulation.speed:g} times real time; Ctrl-C stops"
    )
    _say(f"next, in the folder of {_NAMES[kind]}'s sources: {_start_command(kind, instance, host)}")
    return run(parameters, instance=instance, host=host, outside=outside, duration_s=duration_s, say=_say)


def _start_command(kind: SimulatedKind, instance: int, host: str) -> str:
    """Give the command that starts a real autopilot which looks for its simulator here."""
    here = host in _THIS_MACHINE
    if kind is SimulatedKind.ARDUPILOT:
        address = _LOOPBACK if here else host
        return f"Tools/autotest/sim_vehicle.py -v ArduCopter -f X --model JSON:{address} -I {instance}"
    address = "" if here else f"PX4_SIM_HOST_ADDR={host} "
    if instance == 0:
        return f"{address}make px4_sitl none_iris"
    return f"{address}PX4_SIM_MODEL=none_iris build/px4_sitl_default/bin/px4 -i {instance}"


_NAMES = {SimulatedKind.PX4: "PX4", SimulatedKind.ARDUPILOT: "ArduPilot"}
