"""``swingd status``."""

import contextlib
import json
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swingd.cli import options
from swingd.service.status import StatusError, StatusSocket, ask, sockets

if TYPE_CHECKING:
    from rich.console import RenderableType

EXAMPLES = """\b
Examples:
  swingd status                       # of the only one that runs
  swingd status x500                  # of the one that flies by x500.yaml; a service's name, too
  swingd status -c configs/x500.yaml --json
  swingd status --watch

Exit codes: 0 healthy (init, ready, active), 1 degraded or fault, 2 wrong usage or several to choose from,
3 no swingd answers.
"""

EXIT_UNHEALTHY = 1
EXIT_SEVERAL = 2
EXIT_NOBODY = 3
WATCH_S = 1.0
LATE_SHARE = 0.75
"""Of the rate that is asked for: below it an input is shown as slow, as swingd itself judges it."""
_HEALTHY = ("init", "ready", "active")
_CAMERA_LATE_S = 1.0
_PLAIN_WIDTH = 120
_LABEL_WIDTH = 12
_STYLES = {"init": "cyan", "ready": "green", "active": "bold green", "degraded": "yellow", "fault": "bold red"}
_KINDS = {"px4": "PX4", "ardupilot": "ArduPilot", "other": "neither PX4 nor ArduPilot"}


class _SeveralError(StatusError):
    """There is more than one daemon, and nothing says which is meant."""


def status(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="The configuration's file without .yaml, where several run."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("-c", "--config", metavar="FILE", help="The configuration that it was started with.")
    ] = None,
    pid: Annotated[int | None, typer.Option("--pid", metavar="N", help="The process, where several are alike.")] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Show it anew every second, until Ctrl-C.")] = False,
    as_json: options.Json = False,
) -> None:
    """Show how a running swingd is: health and reason, correction and what withholds it, inputs, refusals, latency."""
    if name is not None and config is not None:
        raise typer.BadParameter("give NAME or --config, not both")

    def look() -> tuple[int, "dict[str, Any] | str"]:
        try:
            told = ask(_find(name, config, pid).path)
        except StatusError as error:
            return EXIT_SEVERAL if isinstance(error, _SeveralError) else EXIT_NOBODY, str(error)
        return 0 if told["health"]["state"] in _HEALTHY else EXIT_UNHEALTHY, told

    if watch:
        raise typer.Exit(_watch(look, as_json))
    code, told = look()
    _print(told, as_json)
    raise typer.Exit(code)


def _find(name: str | None, config: Path | None, pid: int | None) -> StatusSocket:
    """Return the one socket that is meant.

    Raises
    ------
    StatusError
        If there is none, or more than one.
    """
    found = [
        socket
        for socket in sockets()
        if (name is None or socket.name == name)
        and (config is None or socket.belongs_to(config))
        and (pid is None or socket.pid == pid)
    ]
    meant = f" by {config}" if config is not None else f" by the name {name}" if name is not None else ""
    meant += "" if pid is None else f" as process {pid}"
    if not found:
        raise StatusError(f"no swingd runs{meant} that this user may ask; a service: sudo, or the group swingd")
    if len(found) > 1:
        lines = "".join(f"\n  swingd status {socket.name} --pid {socket.pid}" for socket in found)
        raise _SeveralError(f"{len(found)} swingd run{meant}; expected one of:{lines}")
    return found[0]


# ------------------------------------------------------------------------------------------------------ output


def _print(told: "dict[str, Any] | str", as_json: bool) -> None:
    if isinstance(told, str):
        typer.echo(f"swingd: {told}", err=True)
    elif as_json:
        typer.echo(json.dumps(told))
    else:
        from rich.console import Console

        if sys.stdout.isatty():
            Console(highlight=False).print(_page(told))
            return
        console = Console(highlight=False, width=_PLAIN_WIDTH, color_system=None)
        with console.capture() as page:
            console.print(_page(told))
        typer.echo("\n".join(line.rstrip() for line in page.get().splitlines()))


def _watch(look: Any, as_json: bool) -> int:
    """Show it until Ctrl-C; return the last exit code. One that ends is waited for: it may be started again."""
    code = 0
    with contextlib.suppress(KeyboardInterrupt):
        if as_json or not sys.stdout.isatty():
            while True:
                code, told = look()
                _print(told, as_json)
                sys.stdout.flush()
                time.sleep(WATCH_S)
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text

        with Live(console=Console(highlight=False), screen=True, auto_refresh=False) as live:
            while True:
                code, told = look()
                live.update(Text(told) if isinstance(told, str) else _page(told), refresh=True)
                time.sleep(WATCH_S)
    return code


def _page(told: dict[str, Any]) -> "RenderableType":
    """Lay out what a daemon has told."""
    from rich.console import Group
    from rich.text import Text

    configuration = told["configuration"] or "no configuration file"
    title = Text.assemble(
        (f"swingd {told['version']}", "bold"),
        f"  {configuration}  pid {told['pid']}  up {_duration(told['uptime_s'])}",
    )
    parts: list[RenderableType] = [title, _pairs(_summary(told))]
    if told["inputs"]:
        parts += [Text(), _table(("input", "asked", "got", "age", ""), _input_rows(told["inputs"]))]
    parts += [Text(), _table(("link", "url", "state", "received", "sent"), _link_rows(told["links"]))]
    counted = list(_counter_rows(told["counters"]))
    if counted:
        parts += [Text(), _table(("refused or lost", "why", "how often"), counted)]
    return Group(*parts)


def _summary(told: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    health, correction, rate = told["health"], told["correction"], told["filter"]
    state = f"{health['state']} for {_duration(health['for_s'])}"
    reason = f": {health['reason']}" if health["reason"] else ""
    yield "health", state + reason, _STYLES.get(health["state"], "")
    yield "mode", told["mode"], ""
    yield "autopilot", _autopilot(told["autopilot"]), ""
    if told["payload"] is not None:
        yield "payload", _payload(told["payload"]), ""
    withheld = "; ".join(correction["withheld_by"])
    if correction["on"]:
        yield "correction", "on" + (f", fading: {withheld}" if withheld else ""), "green"
    else:
        yield "correction", "off" + (f": {withheld}" if withheld else ""), "yellow" if told["mode"] != "shadow" else ""
    if told.get("path") is not None:
        yield "path", *_path(told["path"])
    if told["disturbance"] is not None:
        yield "disturbance", *_disturbance(told["disturbance"], streams=told["mode"] != "shadow")
    if told.get("camera") is not None:
        yield "camera", *_camera(told["camera"])
    if rate["joined"]:
        slow = rate["rate_hz"] < LATE_SHARE * rate["asked_hz"]
        text = f"{rate['name']}, {rate['rate_hz']:.1f} of {rate['asked_hz']:g} Hz, {rate['steps']} steps"
        yield "filter", text, "yellow" * slow
    latency = told["latency_ms"]
    if latency["p50"] is not None:
        yield "latency", f"p50 {latency['p50']:.2f} ms, p99 {latency['p99']:.2f} ms, IMU to setpoint", ""
    recording = told["recording"]
    if recording is not None:
        lost = f", {recording['lost']} lost: it has ended" if recording["lost"] else ""
        yield "recording", f"{recording['file']}, {recording['records']} records{lost}", "red" if lost else ""


def _path(path: dict[str, Any]) -> tuple[str, str]:
    """State and progress, with the style."""
    text = f"{path['state']}, waypoint {path['waypoint']} of {path['waypoints']}"
    if path["remaining_m"] is not None:
        text += f", {path['remaining_m']:.1f} m left"
    withheld = "; ".join(path["withheld_by"])
    return text + (f"; not led: {withheld}" if withheld else ""), "yellow" if withheld else "green"


def _disturbance(disturbance: dict[str, Any], *, streams: bool) -> tuple[str, str]:
    """Force and what becomes of it, with the style."""
    north, east, down = disturbance["force_ned_n"]
    force = f"north {north:+.2f}, east {east:+.2f}, down {down:+.2f} N"
    if disturbance["fed_forward"]:
        return f"{force}; fed forward", "green"
    withheld = "; ".join(disturbance["withheld_by"] if streams else filter(None, [disturbance["doubt"]]))
    return force + (f"; not fed forward: {withheld}" if withheld else ""), ""


def _camera(camera: dict[str, Any]) -> tuple[str, str]:
    """Rate and age of the load's sightings, with the style."""
    if camera["age_s"] is None:
        return "no LANDING_TARGET of the load yet", "yellow"
    unused = f"; {camera['unused']} not used" if camera["unused"] else ""
    text = f"{camera['got_hz']:.1f} Hz, the last {1e3 * camera['age_s']:.0f} ms ago{unused}"
    return text, "" if camera["age_s"] < _CAMERA_LATE_S else "yellow"


def _autopilot(autopilot: dict[str, Any] | None) -> str:
    if autopilot is None:
        return "none heard"
    armed = {True: "armed", False: "disarmed", None: "arming not known"}[autopilot["armed"]]
    mode = {"offboard": "follows setpoints", "other": "in a mode of its own", "unknown": "mode not known"}
    parts = [_KINDS[autopilot["kind"]], f"system {autopilot['system_id']}", armed]
    if autopilot["flight_mode"] is not None:
        parts.append(mode[autopilot["flight_mode"]])
    return ", ".join(parts)


def _payload(payload: dict[str, Any]) -> str:
    reason, mass = payload["reason"], payload["mass"]
    text = f"{payload['state']}: {reason}" if reason else str(payload["state"])
    if mass["mass_kg"] is None:
        return text
    deviation = "" if mass["std_kg"] is None else f" +- {mass['std_kg']:.2g}"
    return f"{text}; {mass['mass_kg']:.3g}{deviation} kg, {mass['reason']}"


def _input_rows(inputs: Iterable[dict[str, Any]]) -> Iterator[tuple[tuple[str, ...], str]]:
    for one in inputs:
        slow = one["got_hz"] < LATE_SHARE * one["asked_hz"]
        age = "never" if one["age_s"] is None else f"{1e3 * one['age_s']:.0f} ms"
        why = f"refused: {one['refused']}" if one["refused"] else ""
        cells = (one["stream"].replace("_", " "), f"{one['asked_hz']:.4g} Hz", f"{one['got_hz']:.4g} Hz", age, why)
        yield cells, "red" if one["age_s"] is None else "yellow" if slow else ""


def _link_rows(links: Iterable[dict[str, Any]]) -> Iterator[tuple[tuple[str, ...], str]]:
    for link in links:
        cells = (link["name"], link["url"], link["state"], _amount(link["bytes_in"]), _amount(link["bytes_out"]))
        yield cells, "" if link["state"] == "open" else "yellow"


def _counter_rows(counters: dict[str, dict[str, int]]) -> Iterator[tuple[tuple[str, ...], str]]:
    for kind, reasons in counters.items():
        for reason, count in sorted(reasons.items()):
            yield (kind, reason.replace("_", " "), str(count)), ""


def _pairs(rows: Iterable[tuple[str, str, str]]) -> "RenderableType":
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(width=_LABEL_WIDTH)
    table.add_column(overflow="fold")
    for name, value, style in rows:
        table.add_row(name, Text(value, style=style))
    return table


def _table(header: tuple[str, ...], rows: Iterable[tuple[tuple[str, ...], str]]) -> "RenderableType":
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for name in header:
        table.add_column(name, justify="right" if name in ("asked", "got", "age", "received", "sent") else "left")
    for cells, style in rows:
        table.add_row(*(Text(cell, style=style) for cell in cells))
    return table


def _duration(seconds: float) -> str:
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def _amount(count: int) -> str:
    return (
        f"{count} B" if count < 10_000 else f"{count / 1e3:.0f} kB" if count < 10_000_000 else f"{count / 1e6:.0f} MB"
    )
