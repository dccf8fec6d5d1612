"""``swingd doctor``."""

import asyncio
import io
import json
import shutil
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swingd.cli import options, process

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from swingd.model.actions import StatusText
    from swingd.model.parameters import Parameters
    from swingd.service.diagnosis import Diagnosis

EXAMPLES = """\b
Examples:
  swingd doctor -c configs/x500.yaml
  swingd doctor -c configs/x500.yaml --autopilot serial:///dev/ttyAMA0:921600
  swingd doctor -c configs/x500.yaml --autopilot udpout://127.0.0.1:14541   # through a running swingd's endpoint
  swingd doctor -c configs/x500.yaml --json

Exit codes: 0 ready, 1 not ready or no link, 78 wrong configuration.
"""

SECONDS_MIN = 4.0
"""Shorter there is no time to ask for streams and to measure them."""
_PLAIN_WIDTH = 120
_LABEL_WIDTH = 20
_STYLES = {"DANGER": "bold red", "WARNING": "yellow", "HINT": "cyan"}
_VERDICT_STYLES = {"good": "green", "slow": "yellow", "missing": "red", "refused": "red", "idle": "dim"}


def doctor(
    config: options.Config = None,
    overrides: options.Overrides = None,
    autopilot: Annotated[
        str | None, typer.Option("--autopilot", metavar="URL", help="Link to the autopilot instead of link.autopilot.")
    ] = None,
    seconds: Annotated[
        float,
        typer.Option("--seconds", metavar="S", min=SECONDS_MIN, max=600.0, help="How long to listen to the autopilot."),
    ] = 8.0,
    as_json: options.Json = False,
) -> None:
    """Examine link, autopilot and configuration before a flight: ready or not, and why.

    Only listens and asks; sends no setpoint, arms nothing, changes no mode and no parameter. Streams that it asked for
    are set back to the autopilot's defaults at the end, unless the vehicle is armed.
    """
    from swingd.cli.progress import bar
    from swingd.config.loader import load_parameters

    settings = list(overrides or ())
    if autopilot is not None:
        settings.append(f"link.autopilot={json.dumps(autopilot)}")
    parameters = load_parameters(config, settings)
    parameters = _as_set_in_flight(config, parameters)
    process.announce_compilation()
    from swingd.service.doctor import examine

    with (
        bar(f"listening on {parameters.link.autopilot}", quiet=as_json) as advance,
        asyncio.Runner(loop_factory=process.event_loop_factory()) as runner,
    ):
        diagnosis = runner.run(examine(parameters, seconds, advance))
    if as_json:
        typer.echo(json.dumps(_as_json(diagnosis), allow_nan=False))
    else:
        _print(diagnosis)
    raise typer.Exit(0 if diagnosis.ready else 1)


def _as_set_in_flight(config: Path | None, parameters: "Parameters") -> "Parameters":
    """Take what a ground station has set, as the daemon does; on a copy, for reading may make it forget."""
    from swingd.service.state import StateFile

    def tell(note: "StatusText") -> None:
        typer.echo(note.text, err=True)

    kept = StateFile(config, tell).path
    if kept is None or not kept.is_file():
        return parameters
    with tempfile.TemporaryDirectory(prefix="swingd-doctor-") as folder:
        try:
            shutil.copy(kept, Path(folder) / kept.name)
        except OSError as error:
            typer.echo(f"{kept} cannot be read, and what a ground station has set is left out: {error}", err=True)
            return parameters
        state = StateFile(config, tell, Path(folder))
        parameters, notes = state.apply(parameters)
        state.close()
    for note in notes:
        tell(note)
    return parameters


def _as_json(diagnosis: "Diagnosis") -> dict[str, Any]:
    def plain(value: Any) -> Any:
        if isinstance(value, Enum):
            return value.name.lower() if isinstance(value.value, int) else value.value
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        return value

    return {"ready": diagnosis.ready, **plain(asdict(diagnosis))}


# ---- the page


def _print(diagnosis: "Diagnosis") -> None:
    from rich.console import Console

    if sys.stdout.isatty():
        _write(Console(highlight=False, markup=False), diagnosis)
        return
    page = io.StringIO()
    _write(Console(file=page, highlight=False, markup=False, width=_PLAIN_WIDTH, color_system=None), diagnosis)
    typer.echo("\n".join(line.rstrip() for line in page.getvalue().splitlines()))


def _write(console: "Console", diagnosis: "Diagnosis") -> None:
    _section(console, "link", _link_rows(diagnosis))
    if diagnosis.autopilot is not None:
        _section(console, "autopilot", _autopilot_rows(diagnosis))
        console.print(_streams(diagnosis))
        console.print()
        _section(console, "time", _time_rows(diagnosis))
        _section(console, "thrust and battery", _thrust_rows(diagnosis))
        _section(console, "parameters", _parameter_rows(diagnosis))
    _print_findings(console, diagnosis)
    _print_verdict(console, diagnosis)


def _section(console: "Console", title: str, rows: Iterable[tuple[str, str]]) -> None:
    from rich.table import Table

    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(width=_LABEL_WIDTH)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(f"  {name}", value)
    console.print(title, style="bold")
    console.print(table)
    console.print()


def _link_rows(diagnosis: "Diagnosis") -> list[tuple[str, str]]:
    link = diagnosis.link
    rows = [("over", link.url)]
    if not link.bytes_in:
        return [*rows, ("heard", f"nothing in {link.seconds:.0f} s")]
    rows.append(
        ("received", f"{link.bytes_per_s:.0f} bytes/s, {link.frames_per_s:.0f} frames/s in {link.seconds:.0f} s")
    )
    if diagnosis.autopilot is not None:
        sent = link.autopilot_frames + link.lost_frames
        rows.append(("lost", f"{link.lost_frames} of the autopilot's {sent} frames"))
    if link.garbage_bytes:
        rows.append(("garbage", f"{link.garbage_bytes} of {link.bytes_in} bytes"))
    rows.append(("signing", "the autopilot signs" if link.signed else "not demanded by the autopilot"))
    if link.refused_frames:
        rows.append(("refused", f"{link.refused_frames} frames without a good signature"))
    rows.append(
        ("who speaks", ", ".join(link.senders) + " (system/component)" if link.senders else "nobody in MAVLink")
    )
    return rows


def _autopilot_rows(diagnosis: "Diagnosis") -> list[tuple[str, str]]:
    autopilot = diagnosis.autopilot
    assert autopilot is not None
    names = {"px4": "PX4", "ardupilot": "ArduPilot", "other": "neither PX4 nor ArduPilot"}
    state = "armed, in the air" if autopilot.in_air else "armed, on the ground" if autopilot.armed else "disarmed"
    heard = {True: "heard", False: "none", None: "not known"}[autopilot.remote_control]
    return [
        ("kind", f"{names[autopilot.kind.value]} {autopilot.version or '(version not told)'}"),
        ("system", str(autopilot.system_id)),
        ("state", state),
        ("remote control", heard),
    ]


def _streams(diagnosis: "Diagnosis") -> "Table":
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("streams", width=_LABEL_WIDTH)
    for name in ("asked", "got"):
        table.add_column(name, justify="right")
    table.add_column("")
    table.add_column("carried by")
    for stream in diagnosis.streams:
        verdict = "idle until armed" if stream.verdict == "idle" else stream.verdict
        table.add_row(
            f"  {stream.stream.value.replace('_', ' ')}",
            f"{stream.asked_hz:.4g} Hz",
            f"{stream.got_hz:.4g} Hz",
            Text(verdict, style=_VERDICT_STYLES[stream.verdict]),
            stream.message,
        )
    return table


def _time_rows(diagnosis: "Diagnosis") -> list[tuple[str, str]]:
    clock = diagnosis.clock
    rows = []
    if clock.round_trip_p50_s is None or clock.round_trip_p99_s is None:
        rows.append(("round trip", f"no answer to {clock.asked} TIMESYNC requests"))
    else:
        rows.append(
            (
                "round trip",
                f"{_ms(clock.round_trip_p50_s)} half of the time, {_ms(clock.round_trip_p99_s)} at worst (99 %), "
                f"{clock.answered} of {clock.asked} answered",
            )
        )
    if clock.offset_s is not None and clock.offset_spread_s is not None:
        rows.append(
            (
                "clock",
                f"autopilot's minus this computer's {clock.offset_s:.4f} s, known to {_ms(clock.offset_spread_s)}",
            )
        )
    if clock.delivery_p50_s is not None and clock.delivery_p99_s is not None:
        rows.append(
            (
                "IMU delivery",
                f"{_ms(clock.delivery_p50_s)} later than the quickest half of the time, "
                f"{_ms(clock.delivery_p99_s)} at worst (99 %)",
            )
        )
    return rows


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f} ms"


def _thrust_rows(diagnosis: "Diagnosis") -> list[tuple[str, str]]:
    thrust = diagnosis.thrust

    def share(value: float | None) -> str:
        return "not possible" if value is None else f"{value:.1%}"

    battery = "no reading" if thrust.voltage_v is None else f"{thrust.voltage_v:.2f} V"
    rows = [
        ("battery", f"{battery}; the thrust curve is for {thrust.voltage_nominal_v:g} V"),
        ("weight", f"{thrust.weight_n:.2f} N, vehicle and load"),
        ("hover by the curve", f"{share(thrust.expected_nominal)} at {thrust.voltage_nominal_v:g} V"),
    ]
    if thrust.voltage_v is not None:
        rows.append(("", f"{share(thrust.expected_now)} at the battery's voltage"))
    if thrust.measured is None or thrust.measured_source is None:
        rows.append(("hover measured", "only in a steady hover"))
    else:
        what = "motor outputs" if thrust.measured_source.value == "motors" else "throttle"
        scale = "" if thrust.scale is None else f": scale of the curve {thrust.scale:.3f} if the load hangs"
        rows.append(("hover measured", f"{share(thrust.measured)} ({what}){scale}"))
    if thrust.autopilot_hover is not None:
        rows.append(("autopilot's own", f"{share(thrust.autopilot_hover)} (its parameter)"))
    return rows


def _parameter_rows(diagnosis: "Diagnosis") -> list[tuple[str, str]]:
    rows = [("read", f"{len(diagnosis.values)} of {len(diagnosis.values) + len(diagnosis.missing)}")]
    if diagnosis.values:
        rows.append(("", ", ".join(f"{name} {value:.6g}" for name, value in diagnosis.values.items())))
    if diagnosis.missing:
        rows.append(("not known there", ", ".join(diagnosis.missing)))
    return rows


def _print_findings(console: "Console", diagnosis: "Diagnosis") -> None:
    from rich.table import Table
    from rich.text import Text

    if not diagnosis.findings:
        return
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(width=9)
    table.add_column(overflow="fold")
    for number, finding in enumerate(diagnosis.findings):
        head = Text(f"{finding.name}: {finding.value}", style="bold")
        table.add_row(Text(f"  {finding.severity.name.lower()}", style=_STYLES[finding.severity.name]), head)
        table.add_row("", finding.meaning)
        table.add_row("", Text(f"-> {finding.remedy}"))
        if number < len(diagnosis.findings) - 1:
            table.add_row()
    console.print("advice", style="bold")
    console.print(table)
    console.print()


def _print_verdict(console: "Console", diagnosis: "Diagnosis") -> None:
    dangers = [f"{finding.name} {finding.value}" for finding in diagnosis.findings if finding.severity.name == "DANGER"]
    warnings = sum(finding.severity.name == "WARNING" for finding in diagnosis.findings)
    if dangers:
        console.print(f"not ready for mode {diagnosis.mode.value}: {'; '.join(dangers)}", style="bold red")
    else:
        count = {0: "", 1: ", with one warning"}.get(warnings, f", with {warnings} warnings")
        console.print(f"ready for mode {diagnosis.mode.value}{count}", style="bold green")
