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

from .plan import Correction
from .record import TrialError

TAIL_LINES = 12
INSTANCES = range(9, -1, -1)
"""PX4 gives more than ten instances one port; the first ones are those that a user runs by hand."""
_STOP_S = 8.0


@dataclass(frozen=True, slots=True)
class Files:
    """What a flight leaves in its folder."""

    folder: Path

    @property
    def config(self) -> Path:
        return self.folder / "config.yaml"

    @property
    def truth(self) -> Path:
        return self.folder / "truth.csv"

    @property
    def recording(self) -> Path:
        return self.folder / "flight.swingd"

    @property
    def summary(self) -> Path:
        return self.folder / "summary.json"

    @property
    def flown(self) -> Path:
        return self.folder / "flown.json"

    def log(self, name: str) -> Path:
        return self.folder / f"{name}.log"


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
class Px4:
    """PX4 in the loop; the build folder lies around its binary."""

    binary: Path
    name: str = "px4"

    def link(self, instance: int) -> str:
        return f"udpin://127.0.0.1:{14540 + instance}"

    def ports(self, instance: int) -> list[tuple[socket.SocketKind, int]]:
        """Those that one instance and its swingd open."""
        datagrams = (14540, 14580, 14280, 13030, 18570)
        return [(socket.SOCK_STREAM, 4560 + instance), *((socket.SOCK_DGRAM, port + instance) for port in datagrams)]

    def command(self, instance: int, folder: Path) -> list[str | Path]:
        return [self.binary, "-i", str(instance), "-d", "-w", folder, self.binary.parent.parent / "etc"]

    def environment(self) -> dict[str, str]:
        return {"PX4_SIM_MODEL": "none_iris"}


Autopilot = Px4


@dataclass(frozen=True, slots=True)
class Bench:
    """A flight's processes while they run."""

    url: str
    """Where the application finds the vehicle."""
    processes: tuple[Process, ...]


@contextlib.asynccontextmanager
async def bench(
    autopilot: Autopilot, parameters: Parameters, correction: Correction, files: Files
) -> AsyncIterator[Bench]:
    """Start everything but the application, and end it.

    Parameters
    ----------
    autopilot : Autopilot
        Gets an instance number whose ports are free, and an empty folder to run in.
    parameters : Parameters
        Vehicle, load, wind; for swingd and for the simulation.
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
                parameters,
                mode=Mode.INLINE,
                link=replace(parameters.link, autopilot=autopilot.link(instance)),
                endpoints=(endpoint,),
            )
        )
        files.config.write_text(dump_parameters(parameters), encoding="utf-8")
        swingd = (sys.executable, "-m", "swingd")
        # What an earlier flight learned must not help this one.
        environment = {"XDG_STATE_HOME": str(folder / "state")}
        async with contextlib.AsyncExitStack() as stack:

            async def start(name: str, command: Sequence[str | Path], **more: str) -> Process:
                context = started(name, command, files.log(name), folder, {**environment, **more})
                return await stack.enter_async_context(context)

            physics = await start("physics", physics_command(autopilot, instance, files))
            brain = await start("autopilot", autopilot.command(instance, folder), **autopilot.environment())
            daemon = await start(
                "swingd",
                (*swingd, "run", "-c", files.config, "--record", files.recording, "--summary", files.summary),
            )
            yield Bench(f"udpin://127.0.0.1:{application_port}", (physics, brain, daemon))


def physics_command(autopilot: Autopilot, instance: int, files: Files) -> list[str | Path]:
    """The vehicle, the cable and the load behind the autopilot's simulator interface."""
    hil = ("--hil", autopilot.name, "--instance", str(instance))
    return [sys.executable, "-m", "swingd", "sim", *hil, "-c", files.config, "--truth", files.truth]


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
