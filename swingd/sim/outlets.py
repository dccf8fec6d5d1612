"""What a running simulation shows and hears: its truth as a file and as a stream, text commands by TCP and keyboard."""

import asyncio
import contextlib
import json
import os
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from urllib.parse import urlsplit

from swingd.model.errors import LinkOpenError, LinkUrlError, SwingdError
from swingd.sim.console import Console
from swingd.sim.faults import Faults
from swingd.sim.plant import DT_S, Plant, Truth
from swingd.sim.truth import COLUMNS, TruthWriter, truth_row

TRUTH_STEPS = 2
"""Simulation steps from one row of the truth file to the next: 125 Hz."""
STREAM_STEPS = 5
"""Simulation steps from one datagram of the truth stream to the next: 50 Hz."""
STREAM_HZ = 1.0 / (STREAM_STEPS * DT_S)

CONSOLE_HOST = "127.0.0.1"
"""The console changes the world without asking who calls; it is for this machine alone."""
CONSOLE_CLIENTS_MAX = 16
LINE_MAX_BYTES = 256
"""Longest line that the console takes."""

_FILE_BUFFER = 1 << 16
_FAREWELL_S = 1.0
_BACKGROUND_PAUSE_S = 0.5


def _ignore(_line: str) -> None: ...


@dataclass(frozen=True, slots=True)
class Outside:
    """What of a simulation is open to the world outside."""

    truth_file: Path | None = None
    """CSV with the truth at 125 Hz, columns as in `swingd.sim.truth.COLUMNS`."""
    truth_url: str | None = None
    """``udp://HOST:PORT``: where the truth goes at 50 Hz of simulated time, one JSON object a datagram, keyed by
    `swingd.sim.truth.COLUMNS`."""
    console: int | None = None
    """Local TCP port for text commands, one line in, one line out; 0: any free one."""
    keyboard: bool = False
    """Take text commands from standard input as well, where that is a terminal."""
    say: Callable[[str], None] = _ignore
    """Gets a line of text about each way in or out that is open."""


class Outlets:
    """The outlets of one simulation; made by `open_outlets`."""

    def __init__(
        self, writer: "_TruthFile | None", stream: "_TruthStream | None", console_port: int | None = None
    ) -> None:
        self._writer = writer
        self._stream = stream
        self._steps = 0
        self.console_port = console_port
        """TCP port of the console; None where there is none."""

    def after_step(self, truth: Callable[[], Truth]) -> None:
        """Show what is due; called once after every step of the plant.

        Parameters
        ----------
        truth : callable
            Describes the present instant, stamped with the clock that readers know; called only if something is due.

        Raises
        ------
        SwingdError
            If the truth file can no longer be written.
        """
        write = self._writer is not None and self._steps % TRUTH_STEPS == 0
        send = self._stream is not None and self._steps % STREAM_STEPS == 0
        self._steps += 1
        if not write and not send:
            return
        now = truth()
        if write and self._writer is not None:
            self._writer.write(now)
        if send and self._stream is not None:
            self._stream.send(now)


@contextlib.asynccontextmanager
async def open_outlets(plant: Plant, outside: Outside, faults: Faults | None = None) -> AsyncIterator[Outlets]:
    """Open the outlets of a simulation and close them at the end.

    Parameters
    ----------
    plant : Plant
        What is simulated.
    outside : Outside
        What is wanted.
    faults : Faults, optional
        Of the simulated autopilot, where it is one.

    Raises
    ------
    LinkUrlError
        If ``truth_url`` is not understood.
    LinkOpenError
        If its host is not known or the console's port is taken.
    SwingdError
        If the truth file cannot be written.
    """
    async with contextlib.AsyncExitStack() as stack:
        stream = writer = port = None
        if outside.truth_url is not None:
            stream = stack.enter_context(contextlib.closing(await _open_stream(outside.truth_url)))
            outside.say(f"truth, {STREAM_HZ:g} times a simulated second, to {outside.truth_url}")
        if outside.truth_file is not None:
            writer = stack.enter_context(contextlib.closing(_TruthFile(outside.truth_file)))
        console = Console(plant, faults)
        if outside.console is not None:
            port = await stack.enter_async_context(_serve(console, outside.console))
            outside.say(f"commands: TCP port {port} of {CONSOLE_HOST}; help lists them")
        if outside.keyboard and sys.stdin is not None and sys.stdin.isatty():
            await stack.enter_async_context(_listen_to_keyboard(console, sys.stdin.fileno()))
            outside.say("commands: here; help lists them")
        yield Outlets(writer, stream, port)


class _TruthFile:
    """The truth file, open; what the system refuses is an error that names it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._named():
            self._file = path.open("w", encoding="utf-8", newline="\n", buffering=_FILE_BUFFER)
        self._writer = TruthWriter(self._file)

    def write(self, truth: Truth) -> None:
        with self._named():
            self._writer.write(truth)

    def close(self) -> None:
        with self._named():
            self._file.close()

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise SwingdError(f"truth file {self._path}: {error.strerror or error}") from None


class _TruthStream:
    """Sends datagrams that nobody needs to hear; never waits."""

    def __init__(self, sock: socket.socket, address: tuple[object, ...]) -> None:
        self._socket = sock
        self._address = address

    def send(self, truth: Truth) -> None:
        # A full buffer, no route, nobody there: the next one is 20 ms away.
        with contextlib.suppress(OSError):
            self._socket.sendto(truth_json(truth).encode("ascii"), self._address)

    def close(self) -> None:
        self._socket.close()


async def _open_stream(url: str) -> _TruthStream:
    host, port = _parse(url)
    loop = asyncio.get_running_loop()
    try:
        found = await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        family, _, _, _, address = found[0]
        sock = socket.socket(family, socket.SOCK_DGRAM)
    except OSError as error:
        raise LinkOpenError(f"truth stream {url}: {error.strerror or error}") from None
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    return _TruthStream(sock, address)


def _parse(url: str) -> tuple[str, int]:
    """Return host and port of ``udp://HOST:PORT``; raise `LinkUrlError` for anything else."""
    try:
        parts = urlsplit(url.strip())
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise LinkUrlError(f"truth stream {url!r}: {error}; expected udp://HOST:PORT") from None
    if parts.scheme != "udp" or not host or not port or parts.path not in ("", "/") or parts.query or parts.username:
        raise LinkUrlError(f"truth stream {url!r}; expected udp://HOST:PORT with a port of 1..65535")
    return host, port


def truth_json(truth: Truth) -> str:
    """Return the truth as one JSON object, keys as in `COLUMNS`; null where there is no value."""
    values = (_number(name, value) for name, value in zip(COLUMNS, truth_row(truth), strict=True))
    return json.dumps(dict(zip(COLUMNS, values, strict=True)), separators=(",", ":"), allow_nan=False)


def _number(name: str, value: float) -> float | None:
    """Round to what a reader can use, so that the object fits into one frame of an Ethernet."""
    if not isfinite(value):
        return None
    return round(value, 3) if name == "t_boot_s" else float(f"{value:.6g}")


async def _converse(console: Console, reader: asyncio.StreamReader, answer: Callable[[str], Awaitable[None]]) -> None:
    """Answer line by line until the end; what is left without a line's end is not obeyed, it may be half of a word."""
    too_long = False
    while True:
        try:
            line = await reader.readuntil(b"\n")
        except asyncio.LimitOverrunError as error:
            await reader.readexactly(error.consumed)
            too_long = True
            continue
        except asyncio.IncompleteReadError:
            return
        if too_long:
            await answer(f"error: line too long; expected at most {LINE_MAX_BYTES} bytes")
            too_long = False
        else:
            await answer(console.execute(line.decode("utf-8", "replace")))
        # However much one client says at once, the simulation and the others have their turns between its lines.
        await asyncio.sleep(0)


@contextlib.asynccontextmanager
async def _serve(console: Console, port: int) -> AsyncIterator[int]:
    """Serve the console on TCP; give the port."""
    clients: set[asyncio.Task[None]] = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async def answer(line: str) -> None:
            writer.write(line.encode("utf-8") + b"\n")
            # Who does not read is not listened to either, so nothing piles up.
            await writer.drain()

        task = asyncio.current_task()
        assert task is not None
        clients.add(task)
        try:
            # The end of the server cancels it; asyncio's streams would call that an error.
            with contextlib.suppress(OSError, asyncio.CancelledError):
                if len(clients) > CONSOLE_CLIENTS_MAX:
                    await answer(f"error: {CONSOLE_CLIENTS_MAX} clients are here already; expected fewer")
                else:
                    await _converse(console, reader, answer)
                writer.close()
                async with asyncio.timeout(_FAREWELL_S):
                    await writer.wait_closed()
        finally:
            clients.discard(task)
            writer.transport.abort()

    try:
        server = await asyncio.start_server(serve, CONSOLE_HOST, port, limit=LINE_MAX_BYTES)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise LinkOpenError(f"console on {CONSOLE_HOST}, TCP port {port}: {reason}") from None
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        waiting = tuple(clients)
        for task in waiting:
            task.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)


@contextlib.asynccontextmanager
async def _listen_to_keyboard(console: Console, fd: int) -> AsyncIterator[None]:
    """Serve the console on a terminal."""
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader(limit=LINE_MAX_BYTES)
    pause: asyncio.TimerHandle | None = None

    def read() -> None:
        nonlocal pause
        # A background job that reads its terminal is stopped by the system; what is typed there is not for it.
        data = None
        if _is_foreground(fd):
            with contextlib.suppress(OSError):
                data = os.read(fd, 4096)
        if data:
            reader.feed_data(data)
            return
        loop.remove_reader(fd)
        if data is None:
            pause = loop.call_later(_BACKGROUND_PAUSE_S, loop.add_reader, fd, read)
        else:
            reader.feed_eof()

    async def answer(line: str) -> None:
        print(line, flush=True)

    loop.add_reader(fd, read)
    task = asyncio.create_task(_converse(console, reader, answer))
    try:
        yield
    finally:
        loop.remove_reader(fd)
        if pause is not None:
            pause.cancel()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def _is_foreground(fd: int) -> bool:
    try:
        return os.tcgetpgrp(fd) == os.getpgrp()
    except OSError:
        return True  # not this process's terminal, so nothing stops it
