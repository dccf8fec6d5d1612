"""What a running simulation shows to the world outside: its truth, as a file and as a stream."""

import asyncio
import contextlib
import json
import socket
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from urllib.parse import urlsplit

from swingd.model.errors import LinkOpenError, LinkUrlError
from swingd.sim.plant import Plant, Truth
from swingd.sim.truth import COLUMNS, TruthWriter, truth_row

TRUTH_STEPS = 2
"""Simulation steps from one row of the truth file to the next: 125 Hz."""
STREAM_STEPS = 5
"""Simulation steps from one datagram of the truth stream to the next: 50 Hz."""

_FILE_BUFFER = 1 << 16


@dataclass(frozen=True, slots=True)
class Outside:
    """What of a simulation is open to the world outside."""

    truth_file: Path | None = None
    """CSV with the truth at 125 Hz, columns as in `swingd.sim.truth.COLUMNS`."""
    truth_url: str | None = None
    """``udp://HOST:PORT``: where the truth goes at 50 Hz of simulated time, one JSON object a datagram, keyed by
    `swingd.sim.truth.COLUMNS`."""


class Outlets:
    """The outlets of one simulation; made by `open_outlets`."""

    def __init__(self, writer: TruthWriter | None, stream: "_TruthStream | None") -> None:
        self._writer = writer
        self._stream = stream
        self._steps = 0

    def after_step(self, truth: Callable[[], Truth]) -> None:
        """Show what is due; called once after every step of the plant.

        Parameters
        ----------
        truth : callable
            Describes the present instant, stamped with the clock that readers know; called only if something is due.

        Raises
        ------
        OSError
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
async def open_outlets(plant: Plant, outside: Outside) -> AsyncIterator[Outlets]:
    """Open the outlets of a simulation and close them at the end.

    Parameters
    ----------
    plant : Plant
        What is simulated.
    outside : Outside
        What is wanted.

    Raises
    ------
    LinkUrlError
        If ``truth_url`` is not understood.
    LinkOpenError
        If its host is not known.
    OSError
        If the truth file cannot be written.
    """
    async with contextlib.AsyncExitStack() as stack:
        stream = None
        if outside.truth_url is not None:
            stream = stack.enter_context(contextlib.closing(await _open_stream(outside.truth_url)))
        writer = None
        if outside.truth_file is not None:
            file = outside.truth_file.open("w", encoding="utf-8", newline="\n", buffering=_FILE_BUFFER)
            writer = TruthWriter(stack.enter_context(file))
        yield Outlets(writer, stream)


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
