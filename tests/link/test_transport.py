import asyncio
import os
import socket
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from swingd.link.codec import Codec
from swingd.link.transport import Transport, TransportState, open_transport
from swingd.model.errors import LinkOpenError, LinkUrlError

from .messages import Autopilot, imu

pytestmark = pytest.mark.live

FRAMES = [Autopilot()(imu(i * 0.004)) for i in range(50)]
OPEN, WAITING, CLOSED = TransportState.OPEN, TransportState.WAITING, TransportState.CLOSED


class Received(bytearray):
    """What a transport has delivered."""

    def __init__(self) -> None:
        super().__init__()
        self.calls = 0

    def __call__(self, _peer: int, data: bytes) -> None:
        self.calls += 1
        self.extend(data)


async def until(condition: Callable[[], object], timeout_s: float = 5.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.005)


@asynccontextmanager
async def transport(url: str, **options) -> AsyncIterator[tuple[Transport, Received]]:
    received = Received()
    opened = await open_transport(url, received, **options)
    try:
        yield opened, received
    finally:
        await opened.close()
        assert opened.state is CLOSED


def udp_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.settimeout(5.0)
    return sock


def udp_url(sock: socket.socket) -> str:
    return f"udpout://127.0.0.1:{sock.getsockname()[1]}"


async def receive(sock: socket.socket, size: int = 65536) -> bytes:
    return await asyncio.to_thread(sock.recv, size)


# ---------------------------------------------------------------------------------------------------------- UDP


async def test_udp_server_answers_the_last_peer_that_spoke():
    async with transport("udpin://127.0.0.1:0") as (server, received):
        server.send(b"nobody")
        assert (server.state, server.counters.dropped) == (WAITING, 1)
        with udp_socket() as first, udp_socket() as second:
            first.sendto(b"one", ("127.0.0.1", server.local_port))
            await until(lambda: received == b"one")
            assert server.state is OPEN
            server.send(b"to the first")
            assert await receive(first) == b"to the first"
            second.sendto(b"two", ("127.0.0.1", server.local_port))
            await until(lambda: received == b"onetwo")
            server.send(b"to the second")
            assert await receive(second) == b"to the second"
        assert server.counters.connections == 2
        assert server.counters.bytes_in == 6
        server.send(b"the peer is gone")
        await asyncio.sleep(0.01)
        server.send(b"still no error")


async def test_waiting_datagrams_come_in_one_call():
    async with transport("udpin://127.0.0.1:0") as (server, received):
        with udp_socket() as peer:
            for frame in FRAMES:
                peer.sendto(frame, ("127.0.0.1", server.local_port))
        await until(lambda: len(received) == sum(map(len, FRAMES)))
        assert received.calls == 1
        assert [f.raw for f in Codec(1, 1).receive(bytes(received))] == FRAMES


async def test_udp_client_sends_first_and_from_the_port_asked_for():
    with udp_socket() as free:
        port = free.getsockname()[1]
    with udp_socket() as peer:
        async with transport(udp_url(peer), local_port=port) as (client, received):
            assert (client.state, client.local_port) == (OPEN, port)
            client.send(b"hello")
            data, address = await asyncio.to_thread(peer.recvfrom, 100)
            assert (data, address) == (b"hello", ("127.0.0.1", port))
            peer.sendto(b"welcome", address)
            await until(lambda: received == b"welcome")


async def test_ipv6():
    try:
        server = await open_transport("udpin://[::1]:0", received := Received())
    except LinkOpenError as error:
        pytest.skip(f"no IPv6 here: {error}")
    async with transport(f"udpout://[::1]:{server.local_port}") as (client, _):
        client.send(b"six")
        await until(lambda: received == b"six")
    await server.close()


async def test_a_datagram_that_is_too_long_is_dropped():
    with udp_socket() as peer:
        async with transport(udp_url(peer)) as (client, _):
            client.send(bytes(70_000))
            assert (client.counters.dropped, client.counters.errors) == (1, 1)


# ---------------------------------------------------------------------------------------------------------- TCP


async def test_tcp_client_waits_for_its_server_and_comes_back():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    async with transport(f"tcpout://127.0.0.1:{port}") as (client, received):
        await until(lambda: client.counters.errors > 0)
        client.send(b"nobody hears this")
        assert (client.state, client.counters.dropped) == (WAITING, 1)
        for life in range(2):
            with socket.create_server(("127.0.0.1", port)) as listener:
                listener.settimeout(10.0)
                connection, _ = await asyncio.to_thread(listener.accept)
                with connection:
                    await until(lambda: client.state is OPEN)
                    connection.sendall(b"hello")
                    await until(lambda life=life: received == b"hello" * (life + 1))
                    client.send(b"answer")
                    assert await receive(connection) == b"answer"
            await until(lambda: client.state is WAITING)
        assert client.counters.connections == 2


async def test_tcp_byte_by_byte():
    stream = b"".join(FRAMES[:10])
    async with transport("tcpin://127.0.0.1:0") as (server, received):
        with socket.create_connection(("127.0.0.1", server.local_port)) as peer:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for byte in stream:
                peer.sendall(bytes([byte]))
                await asyncio.sleep(0)
            await until(lambda: len(received) == len(stream))
        assert [f.raw for f in Codec(1, 1).receive(bytes(received))] == FRAMES[:10]


async def test_a_new_tcp_client_takes_the_place_of_the_old():
    async with transport("tcpin://127.0.0.1:0") as (server, received):
        address = ("127.0.0.1", server.local_port)
        with socket.create_connection(address) as old:
            await until(lambda: server.counters.connections == 1)
            with socket.create_connection(address) as new:
                await until(lambda: server.counters.connections == 2)
                assert await receive(old) == b""
                new.sendall(b"here")
                await until(lambda: received == b"here")
                server.send(b"there")
                assert await receive(new) == b"there"
        await until(lambda: server.state is WAITING)


async def test_a_peer_that_never_reads_costs_bounded_memory_and_the_oldest_frames():
    async with transport("tcpin://127.0.0.1:0", queue_bytes=5000) as (server, _):
        with socket.socket() as peer:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            peer.connect(("127.0.0.1", server.local_port))
            await until(lambda: server.state is OPEN)
            chunks = [Autopilot()(imu(i * 0.001)) * 10 for i in range(10_000)]
            for chunk in chunks:
                server.send(chunk)
            assert server.state is OPEN
            left = len(chunks) - server.counters.dropped
            assert server.counters.dropped > 1000
            assert left * len(chunks[-1]) - server.counters.bytes_out < 5000 + len(chunks[-1])
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            peer.setblocking(False)
            data = bytearray()

            def read_to_the_end() -> bool:
                with suppress(BlockingIOError):
                    data.extend(peer.recv(1 << 20))
                return data.endswith(chunks[-1])  # the newest are kept

            await until(read_to_the_end)
    number_of = {chunk[: len(chunk) // 10]: i for i, chunk in enumerate(chunks)}
    codec = Codec(1, 1)
    numbers = [number_of[frame.raw] for frame in codec.receive(bytes(data))]
    assert codec.counters.garbage_bytes == 0  # frames are dropped whole
    assert len(numbers) == left * 10
    assert numbers == sorted(numbers)


async def test_what_waited_for_a_broken_connection_is_not_sent_to_the_next():
    async with transport("tcpin://127.0.0.1:0", queue_bytes=5000) as (server, _):
        with socket.socket() as peer:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            peer.connect(("127.0.0.1", server.local_port))
            await until(lambda: server.state is OPEN)
            while not server.counters.dropped:
                server.send(FRAMES[0] * 10)
        with socket.create_connection(("127.0.0.1", server.local_port)) as peer:
            await until(lambda: server.counters.connections == 2 and server.state is OPEN)
            server.send(b"fresh")
            assert await receive(peer) == b"fresh"


# -------------------------------------------------------------------------------------------------------- serial


class Pty:
    """A serial line whose far end is ``fd``; the device can be pulled out and put in again."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "ttyUSB0"
        self.fd = -1

    def plug(self) -> None:
        self.fd, device = os.openpty()
        tty.setraw(device)
        os.set_blocking(self.fd, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(device))
        self._device = device

    def free_device(self) -> None:
        """Leave the device to the transport alone, so that pulling hangs it up."""
        os.close(self._device)

    def pull(self) -> None:
        os.close(self.fd)
        self.path.unlink()

    def read(self) -> bytes:
        try:
            return os.read(self.fd, 65536)
        except BlockingIOError:
            return b""


async def test_serial_line_in_both_directions_byte_by_byte(tmp_path):
    pty = Pty(tmp_path)
    pty.plug()
    async with transport(f"serial://{pty.path}:921600") as (line, received):
        assert line.state is OPEN
        stream = b"".join(FRAMES[:5])
        for byte in stream:
            os.write(pty.fd, bytes([byte]))
            await asyncio.sleep(0)
        await until(lambda: len(received) == len(stream))
        assert received == stream
        line.send(stream)
        data = bytearray()
        await until(lambda: data.extend(pty.read()) or len(data) == len(stream))
        assert data == stream
    pty.free_device()
    pty.pull()


async def test_serial_device_that_vanishes_and_returns(tmp_path):
    pty = Pty(tmp_path)
    pty.plug()
    async with transport(f"serial://{pty.path}:57600") as (line, received):
        pty.free_device()
        os.write(pty.fd, b"before")
        await until(lambda: received == b"before")
        pty.pull()
        await until(lambda: line.state is WAITING)
        line.send(b"nobody")
        assert line.counters.dropped == 1
        await until(lambda: line.counters.errors >= 3)
        pty.plug()
        await until(lambda: line.state is OPEN)
        pty.free_device()
        os.write(pty.fd, b"after")
        await until(lambda: received == b"beforeafter")
        assert line.counters.connections == 2
        pty.pull()


async def test_serial_line_that_nobody_reads_does_not_block(tmp_path):
    pty = Pty(tmp_path)
    pty.plug()
    async with transport(f"serial://{pty.path}:57600", queue_bytes=2000) as (line, _):
        async with asyncio.timeout(2.0):
            for frame in FRAMES * 20:
                line.send(frame)
            await asyncio.sleep(0)
        assert line.counters.dropped > 100
        data = bytearray()
        await until(lambda: data.extend(pty.read()) or bytes(data).endswith(FRAMES[-1]))
        codec = Codec(1, 1)
        assert len(codec.receive(bytes(data))) == 1000 - line.counters.dropped
        assert codec.counters.garbage_bytes == 0
    pty.free_device()
    pty.pull()


# -------------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize("scheme", ["udpin", "tcpin"])
async def test_a_port_in_use_is_told(scheme):
    async with transport(f"{scheme}://127.0.0.1:0") as (server, _):
        url = f"{scheme}://127.0.0.1:{server.local_port}"
        with pytest.raises(LinkOpenError, match=rf"link {url} cannot be opened: .*in use"):
            await open_transport(url, print)


async def test_a_local_port_in_use_is_told():
    with udp_socket() as other, pytest.raises(LinkOpenError, match="in use"):
        await open_transport(udp_url(other), print, local_port=other.getsockname()[1])


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("serial:///dev/no-such-device:57600", "No such file"),
        ("udpin://192.0.2.1:14540", "assign"),
        ("udpout://no-such-host.invalid:14540", "resolution|known|address"),
        ("tcpout://no-such-host.invalid:14540", "resolution|known|address"),
        (f"udpout://{'x' * 80}:14540", "is no host name|known|resolution|address"),
    ],
)
async def test_what_cannot_work_is_told(url, reason):
    with pytest.raises(LinkOpenError, match=reason):
        await open_transport(url, print)


async def test_a_file_is_no_serial_device(tmp_path):
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(LinkOpenError, match="configure port"):
        await open_transport(f"serial://{path}:57600", print)


async def test_a_bad_url_is_an_url_error():
    with pytest.raises(LinkUrlError):
        await open_transport("tcp:127.0.0.1:5760", print)


async def test_closing_twice_and_sending_afterwards_is_harmless():
    received = Received()
    for url in ("udpin://127.0.0.1:0", "tcpin://127.0.0.1:0", "tcpout://127.0.0.1:9"):
        opened = await open_transport(url, received)
        await opened.close()
        await opened.close()
        opened.send(b"late")
        assert opened.counters.dropped == 1
