"""Bytes over UDP, TCP and serial lines: thin, never blocking, never growing, opened by URL.

Sockets and serial devices are read and written directly when the event loop says that they are ready. That drains all
waiting datagrams in one turn of the loop, and lets the oldest unsent frames be dropped when a peer does not read, which
the loop's own transports cannot (and pyserial's non-blocking write spins while the line is full).
"""

import asyncio
import contextlib
import itertools
import os
import socket
import termios
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

import serial

from swingd.link.url import LinkUrl, SerialPort, TcpIn, TcpOut, UdpIn, UdpOut, parse_url
from swingd.model.errors import LinkOpenError

PEER_SILENCE_S = 30.0
"""How long a UDP peer among several may be silent before it counts as gone."""
TCP_GIVE_UP_S = 10.0
"""How long a TCP peer may acknowledge nothing, or read nothing while its buffers are full, before it counts as gone."""

Address = tuple[Any, ...]

_Handle: TypeAlias = socket.socket | serial.Serial

_READ_BYTES = 65536
_TCP_BUFFER_BYTES = 32768
"""In the operating system, which doubles it and by itself gives a peer that does not read megabytes, minutes of
telemetry: whoever reads again is to hear what is so now."""
_DATAGRAMS_PER_TURN = 64
_RETRY_MIN_S = 0.1
_RETRY_MAX_S = 3.0
_CONNECT_TIMEOUT_S = 5.0
_ACCEPT_PAUSE_S = 1.0


class TransportState(Enum):
    """Where a transport stands."""

    WAITING = "waiting"
    """No peer yet, or the peer is gone; it is waited for or tried again."""
    OPEN = "open"
    """There is somebody to send to."""
    CLOSED = "closed"
    """Closed by its owner."""


OnData = Callable[[int, bytes], None]
OnPeer = Callable[[int, bool], None]
OnState = Callable[[TransportState, str], None]


@dataclass(slots=True)
class TransportCounters:
    """What a transport has seen since it was opened."""

    bytes_in: int = 0
    bytes_out: int = 0
    dropped: int = 0
    """Calls of ``send`` whose bytes did not leave: nobody there, or the peer does not read."""
    connections: int = 0
    """Peers that came: first datagram of a new address, TCP connections, openings of the device."""
    refused: int = 0
    """TCP connections closed at once, there being as many as may be."""
    errors: int = 0
    """Failures of the operating system's calls."""


async def open_transport(
    url: LinkUrl | str,
    on_data: OnData,
    *,
    on_peer: OnPeer | None = None,
    on_state: OnState | None = None,
    peers_max: int = 1,
    local_port: int | None = None,
    queue_bytes: int = 8192,
    silence_s: float = PEER_SILENCE_S,
) -> "Transport":
    """Open a transport in the running event loop.

    Parameters
    ----------
    url : LinkUrl or str
        Where to.
    on_data : callable
        ``on_data(peer, data)`` gets the received bytes; datagrams of a peer that wait together come joined.
    on_peer : callable, optional
        ``on_peer(peer, present)``: a peer came, before its first bytes, or went. The byte stream of a peer that comes
        begins anew.
    on_state : callable, optional
        ``on_state(state, reason)`` at each change of either: what an operator wants to read once, not at every retry.
    peers_max : int
        How many peers a listening link serves, at least 1. A link that serves one, and every other kind of link, has
        the one peer 0: whoever spoke last to a ``udpin`` link, the newest connection of a ``tcpin`` link. Where there
        may be several, each UDP address and each TCP connection is a number, counted from 0 and never used again. A
        UDP peer is gone when it has been silent for ``silence_s``, or longest of all when one too many comes; a TCP
        connection too many is closed at once.
    local_port : int, optional
        Local port of a ``udpout`` link; any free one if not given.
    queue_bytes : int
        Bound of what waits for each stream peer that does not read; beyond it its oldest frames are dropped.
    silence_s : float
        See ``peers_max`` [s].

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

    Notes
    -----
    The event loop calls back, never `Transport.send` nor `Transport.close`; after `Transport.close` nothing does.
    """
    if peers_max < 1:
        raise ValueError(f"peers_max: {peers_max} given, at least 1 expected")
    if isinstance(url, str):
        url = parse_url(url)
    loop = asyncio.get_running_loop()
    owner = _Owner(loop, on_data, on_peer or _ignore, on_state or _ignore, queue_bytes)
    try:
        match url:
            case UdpIn():
                sock = _bound(socket.SOCK_DGRAM, *await _resolve(loop, url.host, url.port, socket.SOCK_DGRAM))
                return _UdpLink(owner, sock) if peers_max == 1 else _UdpServer(owner, sock, peers_max, silence_s)
            case UdpOut():
                family, remote = await _resolve(loop, url.host, url.port, socket.SOCK_DGRAM)
                sock = _bound(socket.SOCK_DGRAM, family, _way_to(remote, family, local_port or 0))
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
                return _UdpLink(owner, sock, remote)
            case TcpIn():
                sock = _bound(socket.SOCK_STREAM, *await _resolve(loop, url.host, url.port, socket.SOCK_STREAM))
                return _TcpServer(owner, sock, peers_max)
            case TcpOut():
                await _resolve(loop, url.host, url.port, socket.SOCK_STREAM)
                return _Redialled(owner, _TcpDialler(loop, url))
            case SerialPort():
                serial_dialler = _SerialDialler(url)
                return _Redialled(owner, serial_dialler, await serial_dialler.dial())
    except OSError as error:
        raise LinkOpenError(f"link {url} cannot be opened: {_reason(error)}") from error


def _ignore(*_: object) -> None:
    """Nobody wants to know."""


def _reason(error: OSError) -> str:
    # What asyncio adds is the address, which the reader knows; pyserial says what it was about to do.
    if error.errno is not None and error.errno > 0 and not isinstance(error, serial.SerialException):
        return os.strerror(error.errno)
    return error.strerror or str(error) or type(error).__name__


async def _resolve(loop: asyncio.AbstractEventLoop, host: str, port: int, kind: int) -> tuple[int, Address]:
    try:
        found = await loop.getaddrinfo(host, port, type=kind)
    except UnicodeError as error:
        raise OSError(f"{host!r} is no host name") from error
    return found[0][0], found[0][4]


def _bound(kind: int, family: int, address: Address) -> socket.socket:
    sock = socket.socket(family, kind)
    try:
        sock.setblocking(False)
        if kind == socket.SOCK_STREAM:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
        if kind == socket.SOCK_STREAM:
            sock.listen()
    except BaseException:
        sock.close()
        raise
    return sock


def _way_to(remote: Address, family: int, port: int) -> Address:
    """Local address to speak from: a link within this machine is not to be reached from others."""
    if family == socket.AF_INET6:
        return ("::1" if remote[0] == "::1" else "::", port)
    return ("127.0.0.1" if remote[0].startswith("127.") else "0.0.0.0", port)


def _name_of(address: Address) -> str:
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


@dataclass(frozen=True, slots=True)
class _Owner:
    """Whom a transport serves."""

    loop: asyncio.AbstractEventLoop
    on_data: OnData
    on_peer: OnPeer
    on_state: OnState
    queue_bytes: int


class _Peer(ABC):
    """Somebody to send to."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Address or device, for people."""

    @property
    def backlog_bytes(self) -> int:
        """What has been sent and has not left yet, as far as it can be known."""
        return 0

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send or drop; never calls the owner back."""

    @abstractmethod
    def close(self) -> None:
        """Give back what is held for this peer; never calls the owner back."""


class Transport(ABC):
    """A way for bytes to and from peers; made by `open_transport`."""

    def __init__(self, owner: _Owner) -> None:
        self.counters = TransportCounters()
        self._owner = owner
        self._peers: dict[int, _Peer] = {}
        self._closed = False
        self._told: tuple[TransportState, str] | None = None

    @property
    def state(self) -> TransportState:
        """Where the transport stands."""
        if self._closed:
            return TransportState.CLOSED
        return TransportState.OPEN if self._peers else TransportState.WAITING

    @property
    def local_port(self) -> int | None:
        """Port that the socket is bound to; None where that has no meaning."""
        return None

    def peer_name(self, peer: int) -> str:
        """Address or device of a peer, for people; empty when it has gone."""
        present = self._peers.get(peer)
        return "" if present is None else present.name

    def backlog_bytes(self, peer: int = 0) -> int:
        """What has been sent to a peer and has not left yet, as far as it can be known; a datagram has left."""
        present = self._peers.get(peer)
        return 0 if present is None else present.backlog_bytes

    def send(self, data: bytes, peer: int = 0) -> None:
        """Send whole frames; never blocks nor raises. What cannot leave is dropped and counted, the oldest first."""
        present = self._peers.get(peer)
        if present is None:
            self.counters.dropped += 1
        else:
            present.send(data)

    async def close(self) -> None:
        """Give everything back to the operating system; may be called twice."""
        if self._closed:
            return
        self._closed = True
        for peer in self._peers.values():
            peer.close()
        self._peers.clear()
        await self._release()

    @abstractmethod
    async def _release(self) -> None:
        """Give back what is no peer's."""

    def _add(self, number: int, peer: _Peer) -> None:
        self.counters.connections += 1
        self._peers[number] = peer

    def _announce(self, number: int) -> None:
        peer = self._peers.get(number)
        if peer is not None:
            self._tell(TransportState.OPEN, peer.name)
            self._owner.on_peer(number, True)

    def _part(self, number: int, peer: _Peer, reason: str) -> None:
        """Part with a peer, unless it is gone already and its number perhaps another's."""
        peer.close()
        if self._peers.get(number) is peer:
            del self._peers[number]
            if not self._peers:
                self._tell(TransportState.WAITING, reason)
            self._owner.on_peer(number, False)

    def _tell(self, state: TransportState, reason: str) -> None:
        if self._closed or self._told == (state, reason):
            return
        if self._told is not None and self._told[0] is state is TransportState.OPEN:
            return  # one more peer changes nothing
        self._told = state, reason
        self._owner.on_state(state, reason)


# ---------------------------------------------------------------------------------------------------------- UDP


class _UdpPeer(_Peer):
    def __init__(self, number: int, sock: socket.socket, address: Address, counters: TransportCounters) -> None:
        self.number = number
        self.address = address
        self.heard_s = 0.0
        """When it spoke last, on the clock of the event loop."""
        self._sock = sock
        self._counters = counters

    @property
    def name(self) -> str:
        return _name_of(self.address)

    def send(self, data: bytes) -> None:
        try:
            self._counters.bytes_out += self._sock.sendto(data, self.address)
        except BlockingIOError:
            self._counters.dropped += 1
        except OSError:
            self._counters.dropped += 1
            self._counters.errors += 1

    def close(self) -> None:
        pass


class _Udp(Transport):
    """Datagrams through one socket."""

    def __init__(self, owner: _Owner, sock: socket.socket) -> None:
        super().__init__(owner)
        self._sock = sock
        self._buffer = bytearray(_READ_BYTES)
        self._view = memoryview(self._buffer)
        owner.loop.add_reader(sock, self._readable)

    @property
    def local_port(self) -> int | None:
        """Port that the socket is bound to."""
        return None if self._closed else int(self._sock.getsockname()[1])

    @abstractmethod
    def _speaker(self, address: Address) -> int:
        """Whose datagram it is that came from an address."""

    def _readable(self) -> None:
        # In the order of arrival, and what follows each other from one address in one piece.
        arrived: list[tuple[Address, list[bytes]]] = []
        try:
            for _ in range(_DATAGRAMS_PER_TURN):
                size, address = self._sock.recvfrom_into(self._buffer)
                if not arrived or arrived[-1][0] != address:
                    arrived.append((address, []))
                arrived[-1][1].append(bytes(self._view[:size]))
        except BlockingIOError:
            pass
        except OSError:
            self.counters.errors += 1
        for address, datagrams in arrived:
            if self._closed:
                return
            number = self._speaker(address)
            data = datagrams[0] if len(datagrams) == 1 else b"".join(datagrams)
            self.counters.bytes_in += len(data)
            self._owner.on_data(number, data)

    async def _release(self) -> None:
        self._owner.loop.remove_reader(self._sock)
        self._sock.close()


class _UdpLink(_Udp):
    """One peer: a fixed address, or the last that spoke."""

    def __init__(self, owner: _Owner, sock: socket.socket, remote: Address | None = None) -> None:
        super().__init__(owner, sock)
        self._follows = remote is None
        self._peer: _UdpPeer | None = None
        if remote is not None:
            self._peer = _UdpPeer(0, sock, remote, self.counters)
            self._add(0, self._peer)
            owner.loop.call_soon(self._announce, 0)

    def _speaker(self, address: Address) -> int:
        if self._peer is None:
            self._peer = _UdpPeer(0, self._sock, address, self.counters)
            self._add(0, self._peer)
            self._announce(0)
        elif self._follows and address != self._peer.address:
            self._peer.address = address
            self.counters.connections += 1
        return 0


class _UdpServer(_Udp):
    """Several peers, each an address, as long as they speak now and then."""

    def __init__(self, owner: _Owner, sock: socket.socket, peers_max: int, silence_s: float) -> None:
        super().__init__(owner, sock)
        self._peers_max = peers_max
        self._silence_s = silence_s
        self._numbers = itertools.count()
        self._table: dict[Address, _UdpPeer] = {}
        self._review: asyncio.TimerHandle | None = None

    def _speaker(self, address: Address) -> int:
        peer = self._table.get(address)
        if peer is None:
            if len(self._table) >= self._peers_max:
                self._forget(self._longest_silent(), "others came")
            peer = _UdpPeer(next(self._numbers), self._sock, address, self.counters)
            self._table[address] = peer
            self._add(peer.number, peer)
            self._announce(peer.number)
        peer.heard_s = self._owner.loop.time()
        if self._review is None:
            self._review = self._owner.loop.call_later(self._silence_s, self._forget_silent)
        return peer.number

    def _longest_silent(self) -> _UdpPeer:
        return min(self._table.values(), key=lambda peer: peer.heard_s)

    def _forget(self, peer: _UdpPeer, reason: str) -> None:
        del self._table[peer.address]
        self._part(peer.number, peer, reason)

    def _forget_silent(self) -> None:
        # Called only when somebody may have been silent for long enough, not at a rate.
        self._review = None
        loop = self._owner.loop
        while self._table:
            peer = self._longest_silent()
            if loop.time() < peer.heard_s + self._silence_s:
                self._review = loop.call_at(peer.heard_s + self._silence_s, self._forget_silent)
                return
            self._forget(peer, f"silent for {self._silence_s:g} s")

    async def _release(self) -> None:
        await super()._release()
        if self._review is not None:
            self._review.cancel()


# ------------------------------------------------------------------------------------------------------ streams


class _Channel(_Peer):
    """One life of a byte stream: a socket or device, open until it breaks or is closed."""

    def __init__(self, owner: _Owner, number: int, handle: _Handle, name: str, counters: TransportCounters) -> None:
        self.lost: asyncio.Future[str] = owner.loop.create_future()
        """Gets the reason when the stream has broken or was closed."""
        self.heard = False
        """Whether the peer has sent anything."""
        self._owner = owner
        self._number = number
        self._handle = handle
        self._name = name
        self._fd = handle.fileno()
        self._counters = counters
        self._queue: deque[bytes] = deque()
        self._queued = 0
        self._begun = b""  # rest of a frame whose beginning has left; it must not be cut
        os.set_blocking(self._fd, False)
        owner.loop.add_reader(self._fd, self._readable)

    @property
    def name(self) -> str:
        return self._name

    @property
    def backlog_bytes(self) -> int:
        """The queue, and of a serial line the operating system's buffer."""
        waiting = self._queued + len(self._begun)
        if isinstance(self._handle, serial.Serial) and not self.lost.done():
            with contextlib.suppress(OSError):
                waiting += int(self._handle.out_waiting)
        return waiting

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, _READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._break(error)
            return
        if not data:
            self._end("closed by the other side")
            return
        self.heard = True
        self._counters.bytes_in += len(data)
        self._owner.on_data(self._number, data)

    def send(self, data: bytes) -> None:
        if not data:
            return
        if self.lost.done():
            self._counters.dropped += 1
            return
        waiting = bool(self._begun or self._queue)
        self._queue.append(data)
        self._queued += len(data)
        if not waiting:
            self._flush()
        while self._queued > self._owner.queue_bytes:
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
            self._owner.loop.add_writer(self._fd, self._flush)
        except OSError as error:
            self._break(error)
        else:
            self._owner.loop.remove_writer(self._fd)

    def _break(self, error: OSError) -> None:
        self._counters.errors += 1
        self._end(_reason(error))

    def close(self) -> None:
        self._end("closed")

    def _end(self, reason: str) -> None:
        if self.lost.done():
            return
        self._counters.dropped += len(self._queue) + bool(self._begun)
        self._queue.clear()
        self._queued = 0
        self._begun = b""
        self._owner.loop.remove_reader(self._fd)
        self._owner.loop.remove_writer(self._fd)
        if isinstance(self._handle, serial.Serial):
            # Closing a device waits until it has sent all, which a line held by flow control never does.
            with contextlib.suppress(OSError, serial.SerialException, termios.error):
                self._handle.reset_output_buffer()
        with contextlib.suppress(OSError):
            self._handle.close()
        self.lost.set_result(reason)


class _Streams(Transport):
    """Byte streams, each in its channel."""

    def _attach(self, number: int, handle: _Handle, name: str) -> _Channel:
        channel = _Channel(self._owner, number, handle, name, self.counters)
        channel.lost.add_done_callback(lambda lost: self._part(number, channel, lost.result()))
        self._add(number, channel)
        # Whoever opens the link has it in hand before it calls back.
        self._owner.loop.call_soon(self._announce, number)
        return channel


class _TcpServer(_Streams):
    """Serves its clients; a single one gives way to a new one, as it may be a connection that died unnoticed."""

    def __init__(self, owner: _Owner, sock: socket.socket, peers_max: int) -> None:
        super().__init__(owner)
        self._sock = sock
        self._peers_max = peers_max
        self._numbers = itertools.repeat(0) if peers_max == 1 else itertools.count()
        self._resumption: asyncio.TimerHandle | None = None
        self._listen()

    @property
    def local_port(self) -> int | None:
        """Port that the socket is bound to."""
        return None if self._closed else int(self._sock.getsockname()[1])

    def _listen(self) -> None:
        self._owner.loop.add_reader(self._sock, self._acceptable)

    def _acceptable(self) -> None:
        try:
            sock, address = self._sock.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError:
            # Without a free descriptor the connection goes on waiting, and the loop would call again at once.
            self.counters.errors += 1
            self._owner.loop.remove_reader(self._sock)
            self._resumption = self._owner.loop.call_later(_ACCEPT_PAUSE_S, self._listen)
            return
        if len(self._peers) >= self._peers_max > 1:
            self.counters.refused += 1
            sock.close()
            return
        try:
            _tune(sock)
        except OSError:  # it has been reset meanwhile
            self.counters.errors += 1
            sock.close()
            return
        number = next(self._numbers)
        old = self._peers.get(number)
        if old is not None:
            self._part(number, old, "another client came")
        self._attach(number, sock, _name_of(address))

    async def _release(self) -> None:
        self._owner.loop.remove_reader(self._sock)
        self._sock.close()
        if self._resumption is not None:
            self._resumption.cancel()


def _tune(sock: socket.socket) -> None:
    """Send at once, and notice a peer that vanished without a word."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _TCP_BUFFER_BYTES)
    for name, value in (
        ("TCP_KEEPIDLE", 3),
        ("TCP_KEEPINTVL", 1),
        ("TCP_KEEPCNT", 3),
        ("TCP_USER_TIMEOUT", round(1000 * TCP_GIVE_UP_S)),
    ):
        if hasattr(socket, name):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


class _Dialler(ABC):
    """Makes the connection of one life."""

    name: str

    @abstractmethod
    async def dial(self) -> _Handle:
        """Open the device or connect; OSError if that does not work now."""


class _TcpDialler(_Dialler):
    def __init__(self, loop: asyncio.AbstractEventLoop, url: TcpOut) -> None:
        self.name = _name_of((url.host, url.port))
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
        except TimeoutError:
            sock.close()
            raise OSError(f"no answer within {_CONNECT_TIMEOUT_S:g} s") from None
        except BaseException:
            sock.close()
            raise
        return sock


class _SerialDialler(_Dialler):
    def __init__(self, url: SerialPort) -> None:
        self.name = url.device
        self._url = url

    async def dial(self) -> serial.Serial:
        try:
            return serial.Serial(
                self._url.device, self._url.baud, timeout=0, rtscts=self._url.flow_control, exclusive=True
            )
        except ValueError as error:  # a baud rate that the device does not know
            raise OSError(str(error)) from error


class _Redialled(_Streams):
    """A stream that is made again whenever it breaks."""

    def __init__(self, owner: _Owner, dialler: _Dialler, handle: _Handle | None = None) -> None:
        super().__init__(owner)
        self._dialler = dialler
        channel = None if handle is None else self._attach(0, handle, dialler.name)
        self._task = owner.loop.create_task(self._keep(channel))

    async def _keep(self, channel: _Channel | None) -> None:
        retry_s = _RETRY_MIN_S
        while True:
            if channel is not None:
                await asyncio.wait([channel.lost])
                if channel.heard:
                    retry_s = _RETRY_MIN_S
                channel = None
                await asyncio.sleep(retry_s)
            try:
                channel = self._attach(0, await self._dialler.dial(), self._dialler.name)
            except OSError as error:
                self.counters.errors += 1
                self._owner.loop.call_soon(self._tell, TransportState.WAITING, _reason(error))
                await asyncio.sleep(retry_s)
            retry_s = min(2.0 * retry_s, _RETRY_MAX_S)

    async def _release(self) -> None:
        self._task.cancel()
        await asyncio.wait([self._task])
