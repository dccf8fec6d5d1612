"""What runs beside the application: the autopilot, the physics and swingd, each a process of its own."""

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from swingd.config.render import dump_parameters
from swingd.model.parameters import Endpoint, Mode, Parameters

from .autopilots import Autopilot, console_port
from .plan import Correction, Scenario
from .record import Files, TrialError

TAIL_LINES = 12
INSTANCES = range(9, -1, -1)
"""PX4 gives more than ten instances one port; the first ones are those that a user runs by hand."""
_STOP_S = 8.0
_LISTENS_S = 60.0


class Process:
    """One that was started, with what it says in a file."""

    def __init__(self, name: str, process: asyncio.subprocess.Process, log: Path) -> None:
        self.name = name
        self._process = process
        self._log = log

    async def ended(self) -> TrialError:
        """Wait for its end, which no flight expects."""
        code = await self._process.wait()
        return TrialError(f"{self.name} ended with exit code {code}; it said:\n{self.tail()}")

    def tail(self) -> str:
        lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        return "\n".join(lines[-TAIL_LINES:])

    async def stop(self) -> None:
        """End it and whatever it has started."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            if self._process.returncode is not None:
                return
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._process.wait(), _STOP_S)


@contextlib.asynccontextmanager
async def started(
    name: str, command: Sequence[str | Path], log: Path, folder: Path, environment: Mapping[str, str]
) -> AsyncIterator[Process]:
    """Run a command in `folder` for as long as the context lasts."""
    with log.open("wb") as file:
        process = Process(
            name,
            await asyncio.create_subprocess_exec(
                *map(str, command),
                cwd=folder,
                env={**os.environ, **environment},
                stdin=asyncio.subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                start_new_session=True,
            ),
            log,
        )
    try:
        yield process
    finally:
        await process.stop()


@dataclass(frozen=True, slots=True)
class Bench:
    """A flight's processes while they run."""

    url: str
    """Where the application finds the vehicle."""
    processes: tuple[Process, ...]


@contextlib.asynccontextmanager
async def bench(
    autopilot: Autopilot, parameters: Parameters, scenario: Scenario, correction: Correction, files: Files
) -> AsyncIterator[Bench]:
    """Start everything but the application, and end it.

    Parameters
    ----------
    autopilot : Autopilot
        Gets an instance number whose ports are free, and an empty folder to run in.
    parameters : Parameters
        Vehicle, sensors and gains; for swingd and for the simulation.
    scenario : Scenario
        Load, cable and wind.
    correction : Correction
        Off, on, or on with shaping.
    files : Files
        Where configuration, truth, recording, summary and logs go.

    Raises
    ------
    TrialError
        If no instance has its ports free.
    """
    with _instance(autopilot) as instance, tempfile.TemporaryDirectory(prefix="sitl-trial-") as name:
        folder = Path(name)
        application_port = _free_port()
        endpoint = Endpoint(url=f"udpout://127.0.0.1:{application_port}", shaper=correction.shaper)
        parameters = correction.apply(
            replace(
                scenario.parameters(parameters),
                mode=Mode.INLINE,
                link=replace(parameters.link, autopilot=autopilot.link(instance)),
                endpoints=(endpoint,),
            )
        )
        files.config.write_text(dump_parameters(parameters), encoding="utf-8")
        # What an earlier flight learned must not help this one.
        environment = {"XDG_STATE_HOME": str(folder / "state")}
        async with contextlib.AsyncExitStack() as stack:

            async def start(name: str, command: Sequence[str | Path], **more: str) -> Process:
                context = started(name, command, files.log(name), folder, {**environment, **more})
                return await stack.enter_async_context(context)

            physics = autopilot.physics(instance, scenario, files)
            processes = [] if physics is None else [await start("physics", physics)]
            flown = autopilot.command(instance, folder, scenario)
            if flown is not None:
                processes.append(await start("autopilot", flown, **autopilot.environment()))
            companion = autopilot.companion(instance, scenario)
            if companion is not None:
                stack.callback(asyncio.ensure_future(companion).cancel)
            daemon = ("run", "-c", files.config, "--record", files.recording, "--summary", files.summary)
            processes.append(await start("swingd", (sys.executable, "-m", "swingd", *daemon)))
            if not scenario.hooked:
                await _unhook(console_port(instance))
            yield Bench(f"udpin://127.0.0.1:{application_port}", tuple(processes))
        autopilot.leave(folder, scenario, files)


async def _unhook(port: int) -> None:
    """Let the load go before anything flies, as soon as the simulation listens."""
    for _ in range(round(_LISTENS_S / 0.1)):
        with contextlib.suppress(OSError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"release\n")
            answer = await reader.readline()
            writer.close()
            if answer.startswith(b"ok"):
                return
        await asyncio.sleep(0.1)
    raise TrialError(f"the simulation's console on port {port} has not released the load within {_LISTENS_S:g} s")


_taken: set[int] = set()


@contextlib.contextmanager
def _instance(autopilot: Autopilot) -> Iterator[int]:
    """Reserve an instance number whose ports nobody has."""
    for number in INSTANCES:
        if number not in _taken and all(_is_free(kind, port) for kind, port in autopilot.ports(number)):
            _taken.add(number)
            try:
                yield number
            finally:
                _taken.discard(number)
            return
    raise TrialError("the ports of all ten instances are taken; expected one free for this autopilot")


def _is_free(kind: socket.SocketKind, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("0.0.0.0", port))
        except OSError:
            return False
    return True


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def summary(files: Files) -> dict[str, float | None]:
    """What swingd measured of itself.

    Raises
    ------
    TrialError
        If it has left nothing.
    """
    try:
        figures: dict[str, float | None] = json.loads(files.summary.read_text(encoding="utf-8"))
        return figures
    except (OSError, ValueError) as error:
        raise TrialError(f"{files.summary}: swingd left no figures: {error}") from None
