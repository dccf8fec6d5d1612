"""Bytes over UDP, TCP and serial lines: thin, never blocking, never growing, opened by URL.

Sockets and serial devices are read and written directly when the event loop says that they are ready. That drains all
waiting datagrams in one turn of the loop, and lets the oldest unsent frames be dropped when a peer does not read, which
the loop's own transports cannot (and pyserial's non-blocking write spins while the line is full).
"""

import asyncio
import contextlib
import os
import socket
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import serial

from swingd.link.url import LinkUrl, SerialPort, TcpIn, TcpOut, UdpIn, UdpOut, parse_url
from swingd.model.errors import LinkOpenError

OnData = Callable[[bytes], None]
Address = tuple[Any, ...]

_READ_BYTES = 65536
_DATAGRAMS_PER_TURN = 64
_RETRY_MIN_S = 0.1
_RETRY_MAX_S = 3.0
_CONNECT_TIMEOUT_S = 5.0


class TransportState(Enum):
    """Where a transport stands."""

    WAITING = "waiting"
    """No peer yet, or the peer is gone; it is waited for or tried again."""
    OPEN = "open"
    """There is somebody to send to."""
    CLOSED = "closed"
    """Closed by its owner."""


@dataclass(slots=True)
class TransportCounters:
    """What a transport has seen since it was opened."""

    bytes_in: int = 0
    bytes_out: int = 0
    dropped: int = 0
    """Calls of ``send`` whose bytes did not leave: nobody there, or the peer does not read."""
    connections: int = 0
    """Peers that came: first datagram of a new address, TCP connections, openings of the device."""
    errors: int = 0
    """Failures of the operating system's calls."""


class Transport(Protocol):
    """A way for bytes."""

    counters: TransportCounters

    @property
    def state(self) -> TransportState:
        """Where the transport stands."""

    @property
    def local_port(self) -> int | None:
        """Port that the socket is bound to; None where that has no meaning."""

    def send(self, data: bytes) -> None:
        """Send whole frames; never blocks nor raises. What cannot leave is dropped and counted, the oldest first."""

    async def close(self) -> None:
        """Give everything back to the operating system; may be called twice."""


async def open_transport(
    url: LinkUrl | str,
    on_data: OnData,
    *,
    local_port: int | None = None,
    queue_bytes: int = 8192,
) -> Transport:
    """Open a transport in the running event loop.

    Parameters
    ----------
    url : LinkUrl or str
        Where to.
    on_data : callable
        Gets the received bytes; datagrams that wait together come joined.
    local_port : int, optional
        Local port of a ``udpout`` link; any free one if not given.
    queue_bytes : int
        Bound of what waits for a stream peer that does not read; beyond it the oldest frames are dropped.

    Returns
    -------
    Transport
        A ``tcpout`` link may still be `TransportState.WAITING`: it tries again until closed, as it does when the
        connection breaks; so does a serial link whose device vanishes.

    Raises
    ------
    LinkUrlError
        If the URL is not understood.
    LinkOpenError
        If the link cannot work as asked for: port in use, unknown host, no such device, no permission.
    """
    if isinstance(url, str):
        url = parse_url(url)
    loop = asyncio.get_running_loop()
    try:
        match url:
            case UdpIn() | UdpOut():
                return await _open_udp(loop, url, on_data, local_port)
            case TcpIn():
                family, address = await _resolve(loop, url.host, url.port, socket.SOCK_STREAM)
                return _TcpServer(loop, on_data, queue_bytes, family, address)
            case TcpOut():
                await _resolve(loop, url.host, url.port, socket.SOCK_STREAM)
                return _Redialled(loop, on_data, queue_bytes, _TcpDialler(loop, url))
            case SerialPort():
                dialler = _SerialDialler(url)
                return _Redialled(loop, on_data, queue_bytes, dialler, await dialler.dial())
    except OSError as error:
        reason = error.strerror or str(error)
        raise LinkOpenError(f"link {url} cannot be opened: {reason}") from error


async def _resolve(loop: asyncio.AbstractEventLoop, host: str, port: int, kind: int) -> tuple[int, Address]:
    try:
        found = await loop.getaddrinfo(host, port, type=kind)
    except UnicodeError as error:
        raise OSError(f"{host!r} is no host name") from error
    return found[0][0], found[0][4]


# ---------------------------------------------------------------------------------------------------------- UDP


async def _open_udp(
    loop: asyncio.AbstractEventLoop, url: UdpIn | UdpOut, on_data: OnData, local_port: int | None
) -> "_Udp":
    family, address = await _resolve(loop, url.host, url.port, socket.SOCK_DGRAM)
    sock = socket.socket(family, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        if isinstance(url, UdpIn):
            sock.bind(address)
            return _Udp(loop, sock, on_data, None)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sock.bind(("::" if family == socket.AF_INET6 else "0.0.0.0", local_port or 0))
        return _Udp(loop, sock, on_data, address)
    except BaseException:
        sock.close()
        raise


class _Udp:
    """Datagrams to a fixed peer, or to the last one that spoke."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, sock: socket.socket, on_data: OnData, peer: Address | None
    ) -> None:
        self.counters = TransportCounters()
        self._loop = loop
        self._sock = sock
        self._on_data = on_data
        self._peer = peer
        self._follow = peer is None
        self._closed = False
        self._buffer = bytearray(_READ_BYTES)
        self._view = memoryview(self._buffer)
        loop.add_reader(sock, self._readable)

    @property
    def local_port(self) -> int:
        """Port that the socket is bound to."""
        return int(self._sock.getsockname()[1])

    @property
    def state(self) -> TransportState:
        """Where the transport stands."""
        if self._closed:
            return TransportState.CLOSED
        return TransportState.WAITING if self._peer is None else TransportState.OPEN

    def _readable(self) -> None:
        datagrams: list[bytes] = []
        peer = self._peer
        try:
            for _ in range(_DATAGRAMS_PER_TURN):
                size, peer = self._sock.recvfrom_into(self._buffer)
                datagrams.append(bytes(self._view[:size]))
        except BlockingIOError:
            pass
        except OSError:
            self.counters.errors += 1
        if not datagrams:
            return
        if self._follow and peer != self._peer:
            self._peer = peer
            self.counters.connections += 1
        data = datagrams[0] if len(datagrams) == 1 else b"".join(datagrams)
        self.counters.bytes_in += len(data)
        self._on_data(data)

    def send(self, data: bytes) -> None:
        """Send one datagram; see `Transport.send`."""
        if self._peer is None or self._closed:
            self.counters.dropped += 1
            return
        try:
            self.counters.bytes_out += self._sock.sendto(data, self._peer)
        except BlockingIOError:
            self.counters.dropped += 1
        except OSError:
            self.counters.dropped += 1
            self.counters.errors += 1

    async def close(self) -> None:
        """Close the socket."""
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._sock)
            self._sock.close()


# ------------------------------------------------------------------------------------------------------ streams


class _Channel:
    """One life of a byte stream: a socket or device, open until it breaks or is closed."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        handle: "socket.socket | serial.Serial",
        on_data: OnData,
        counters: TransportCounters,
        queue_bytes: int,
    ) -> None:
        self.lost: asyncio.Future[None] = loop.create_future()
        """Done when the stream has broken or was closed."""
        self.heard = False
        """Whether the peer has sent anything."""
        self._loop = loop
        self._handle = handle
        self._fd = handle.fileno()
        self._on_data = on_data
        self._counters = counters
        self._queue_bytes = queue_bytes
        self._queue: deque[bytes] = deque()
        self._queued = 0
        self._begun = b""  # rest of a frame whose beginning has left; it must not be cut
        os.set_blocking(self._fd, False)
        loop.add_reader(self._fd, self._readable)

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, _READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self._counters.errors += 1
            self.close()
            return
        if not data:
            self.close()
            return
        self.heard = True
        self._counters.bytes_in += len(data)
        self._on_data(data)

    def send(self, data: bytes) -> None:
        if self.lost.done():
            self._counters.dropped += 1
            return
        waiting = bool(self._begun or self._queue)
        self._queue.append(data)
        self._queued += len(data)
        if not waiting:
            self._flush()
        while self._queued > self._queue_bytes:
            self._queued -= len(self._queue.popleft())
            self._counters.dropped += 1

    def _flush(self) -> None:
        try:
            while self._begun or self._queue:
                if not self._begun:
                    self._begun = self._queue.popleft()
                    self._queued -= len(self._begun)
                written = os.write(self._fd, self._begun)
                self._counters.bytes_out += written
                self._begun = self._begun[written:]
        except (BlockingIOError, InterruptedError):
            self._loop.add_writer(self._fd, self._flush)
        except OSError:
            self._counters.errors += 1
            self.close()
        else:
            self._loop.remove_writer(self._fd)

    def close(self) -> None:
        if self.lost.done():
            return
        self._counters.dropped += len(self._queue) + bool(self._begun)
        self._queue.clear()
        self._begun = b""
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)
        with contextlib.suppress(OSError):
            self._handle.close()
        self.lost.set_result(None)


def _tune(sock: socket.socket) -> None:
    """Send at once, and notice a peer that vanished without a word."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 3), ("TCP_KEEPINTVL", 1), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, name):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


class _Dialler(ABC):
    """Makes the connection of one life."""

    @abstractmethod
    async def dial(self) -> "socket.socket | serial.Serial":
        """Open the device or connect; OSError if that does not work now."""


class _TcpDialler(_Dialler):
    def __init__(self, loop: asyncio.AbstractEventLoop, url: TcpOut) -> None:
        self._loop = loop
        self._url = url

    async def dial(self) -> socket.socket:
        family, address = await _resolve(self._loop, self._url.host, self._url.port, socket.SOCK_STREAM)
        sock = socket.socket(family, socket.SOCK_STREAM)
        try:
            sock.setblocking(False)
            async with asyncio.timeout(_CONNECT_TIMEOUT_S):
                await self._loop.sock_connect(sock, address)
            _tune(sock)
        except BaseException:
            sock.close()
            raise
        return sock


class _SerialDialler(_Dialler):
    def __init__(self, url: SerialPort) -> None:
        self._url = url

    async def dial(self) -> serial.Serial:
        try:
            return serial.Serial(
                self._url.device, self._url.baud, timeout=0, rtscts=self._url.flow_control, exclusive=True
            )
        except ValueError as error:  # a baud rate that the device does not know
            raise OSError(str(error)) from error


class _Redialled:
    """A stream that is made again whenever it breaks."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        on_data: OnData,
        queue_bytes: int,
        dialler: _Dialler,
        handle: "socket.socket | serial.Serial | None" = None,
    ) -> None:
        self.counters = TransportCounters()
        self._loop = loop
        self._on_data = on_data
        self._queue_bytes = queue_bytes
        self._dialler = dialler
        self._closed = False
        self._channel = None if handle is None else self._attach(handle)
        self._task = loop.create_task(self._keep())

    @property
    def local_port(self) -> int | None:
        """None: the system chooses."""
        return None

    def _attach(self, handle: "socket.socket | serial.Serial") -> _Channel:
        self.counters.connections += 1
        return _Channel(self._loop, handle, self._on_data, self.counters, self._queue_bytes)

    async def _keep(self) -> None:
        retry_s = _RETRY_MIN_S
        while True:
            if self._channel is not None:
                await asyncio.wait([self._channel.lost])
                if self._channel.heard:
                    retry_s = _RETRY_MIN_S
                self._channel = None
                await asyncio.sleep(retry_s)
            try:
                self._channel = self._attach(await self._dialler.dial())
            except OSError:
                self.counters.errors += 1
                await asyncio.sleep(retry_s)
            retry_s = min(2.0 * retry_s, _RETRY_MAX_S)

    @property
    def state(self) -> TransportState:
        """Where the transport stands."""
        if self._closed:
            return TransportState.CLOSED
        alive = self._channel is not None and not self._channel.lost.done()
        return TransportState.OPEN if alive else TransportState.WAITING

    def send(self, data: bytes) -> None:
        """See `Transport.send`."""
        if self._channel is None:
            self.counters.dropped += 1
        else:
            self._channel.send(data)

    async def close(self) -> None:
        """Stop trying and close the stream."""
        self._closed = True
        self._task.cancel()
        await asyncio.wait([self._task])
        if self._channel is not None:
            self._channel.close()
            self._channel = None


class _TcpServer:
    """Serves one client; a new one takes the place of the old, which may be a connection that died unnoticed."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, on_data: OnData, queue_bytes: int, family: int, address: Address
    ) -> None:
        self.counters = TransportCounters()
        self._loop = loop
        self._on_data = on_data
        self._queue_bytes = queue_bytes
        self._channel: _Channel | None = None
        self._closed = False
        self._sock = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._sock.setblocking(False)
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._sock.bind(address)
            self._sock.listen()
        except BaseException:
            self._sock.close()
            raise
        loop.add_reader(self._sock, self._acceptable)

    @property
    def local_port(self) -> int:
        """Port that the socket is bound to."""
        return int(self._sock.getsockname()[1])

    @property
    def state(self) -> TransportState:
        """Where the transport stands."""
        if self._closed:
            return TransportState.CLOSED
        alive = self._channel is not None and not self._channel.lost.done()
        return TransportState.OPEN if alive else TransportState.WAITING

    def _acceptable(self) -> None:
        try:
            sock, _ = self._sock.accept()
            _tune(sock)
        except BlockingIOError:
            return
        except OSError:
            self.counters.errors += 1
            return
        if self._channel is not None:
            self._channel.close()
        self.counters.connections += 1
        self._channel = _Channel(self._loop, sock, self._on_data, self.counters, self._queue_bytes)

    def send(self, data: bytes) -> None:
        """See `Transport.send`."""
        if self._channel is None:
            self.counters.dropped += 1
        else:
            self._channel.send(data)

    async def close(self) -> None:
        """Close the client and stop listening."""
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._sock)
            self._sock.close()
            if self._channel is not None:
                self._channel.close()
                self._channel = None
