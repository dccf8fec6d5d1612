import asyncio
import os
import resource
import socket
import struct
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from ports import tcp_port

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
        self.of: dict[int, bytes] = {}
        self.peers: list[tuple[int, bool]] = []
        self.states: list[tuple[TransportState, str]] = []

    def __call__(self, peer: int, data: bytes) -> None:
        assert self.present(peer)
        self.calls += 1
        self.extend(data)
        self.of[peer] = self.of.get(peer, b"") + data

    def on_peer(self, peer: int, present: bool) -> None:
        assert self.present(peer) is not present
        self.peers.append((peer, present))

    def on_state(self, state: TransportState, reason: str) -> None:
        self.states.append((state, reason))

    def present(self, peer: int) -> bool:
        """Whether the peer has come and not gone."""
        told = [present for number, present in self.peers if number == peer]
        return bool(told) and told[-1]


async def until(condition: Callable[[], object], timeout_s: float = 5.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.005)


@asynccontextmanager
async def transport(url: str, **options) -> AsyncIterator[tuple[Transport, Received]]:
    received = Received()
    opened = await open_transport(url, received, on_peer=received.on_peer, on_state=received.on_state, **options)
    try:
        yield opened, received
    finally:
        told = len(received.peers), len(received.states)
        await opened.close()
        await asyncio.sleep(0.01)
        assert opened.state is CLOSED
        assert (len(received.peers), len(received.states)) == told


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
        assert received.peers == [(0, True)]
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


async def test_udp_client_is_told_its_peer_once_and_after_it_is_open():
    with udp_socket() as peer:
        async with transport(udp_url(peer)) as (client, received):
            assert (client.state, received.peers) == (OPEN, [])
            await asyncio.sleep(0)
            name = udp_url(peer).removeprefix("udpout://")
            assert (received.peers, received.states) == ([(0, True)], [(OPEN, name)])
            assert (client.peer_name(0), client.peer_name(1)) == (name, "")
            client.send(b"", 0)
            client.send(b"nobody", 1)
            assert client.counters.dropped == 1


async def test_a_link_within_this_machine_is_not_reached_from_others():
    with udp_socket() as peer, udp_socket() as other:
        async with transport(udp_url(peer)) as (client, received):
            other.sendto(b"other address", ("127.0.0.2", client.local_port))
            await asyncio.sleep(0.02)
            other.sendto(b"own address", ("127.0.0.1", client.local_port))
            await until(lambda: received)
            assert received == b"own address"


async def test_udp_server_with_several_peers_keeps_each_address_apart():
    async with transport("udpin://127.0.0.1:0", peers_max=3) as (server, received):
        address = ("127.0.0.1", server.local_port)
        with udp_socket() as first, udp_socket() as second:
            for i in range(5):
                first.sendto(b"a%d" % i, address)
                second.sendto(b"b%d" % i, address)
            await until(lambda: len(received) == 20)
            assert received.of == {0: b"a0a1a2a3a4", 1: b"b0b1b2b3b4"}
            assert received == b"a0b0a1b1a2b2a3b3a4b4"  # in the order of arrival
            assert received.peers == [(0, True), (1, True)]
            assert [state for state, _ in received.states] == [OPEN]
            server.send(b"to b", 1)
            server.send(b"to a", 0)
            assert (await receive(first), await receive(second)) == (b"to a", b"to b")
            assert server.peer_name(1) == f"127.0.0.1:{second.getsockname()[1]}"
            server.send(b"nobody", 2)
            assert server.counters.dropped == 1


async def test_a_udp_peer_among_several_goes_by_silence_and_comes_back_as_another():
    async with transport("udpin://127.0.0.1:0", peers_max=3, silence_s=0.3) as (server, received):
        address = ("127.0.0.1", server.local_port)
        with udp_socket() as talker, udp_socket() as listener:
            listener.sendto(b"once", address)
            talker.sendto(b"x", address)
            await until(lambda: len(received.peers) == 2)
            for _ in range(20):
                talker.sendto(b"x", address)
                server.send(b"being spoken to is no sign of life", 0)
                await asyncio.sleep(0.03)
            assert received.peers == [(0, True), (1, True), (0, False)]
            server.send(b"gone", 0)
            assert server.counters.dropped >= 1
            listener.sendto(b"again", address)
            await until(lambda: received.of.get(2) == b"again")
            await until(lambda: server.state is WAITING)
            assert received.states[-1] == (WAITING, "silent for 0.3 s")
            assert sorted(received.peers[3:]) == [(1, False), (2, False), (2, True)]


async def test_the_longest_silent_udp_peer_of_a_full_table_goes():
    async with transport("udpin://127.0.0.1:0", peers_max=2) as (server, received):
        address = ("127.0.0.1", server.local_port)
        with udp_socket() as a, udp_socket() as b, udp_socket() as c:
            for sock in (a, b, a, c):
                count = len(received)
                sock.sendto(b"x", address)
                await until(lambda count=count: len(received) > count)
                await asyncio.sleep(0.02)
            assert received.peers == [(0, True), (1, True), (1, False), (2, True)]
            server.send(b"to a", 0)
            server.send(b"to c", 2)
            assert (await receive(a), await receive(c)) == (b"to a", b"to c")


async def test_a_dead_udp_peer_disturbs_nobody():
    async with transport("udpin://127.0.0.1:0", peers_max=2) as (server, received):
        address = ("127.0.0.1", server.local_port)
        with udp_socket() as alive:
            with udp_socket() as dead:
                dead.sendto(b"soon dead", address)
                await until(lambda: received)
            alive.sendto(b"hello", address)
            await until(lambda: received.of.get(1) == b"hello")
            for frame in FRAMES:
                server.send(frame, 0)
                server.send(frame, 1)
                await asyncio.sleep(0)
                assert await receive(alive) == frame
                alive.sendto(b"!", address)
            await until(lambda: received.of[1] == b"hello" + b"!" * len(FRAMES))
            assert server.counters.dropped == 0


async def test_ipv6():
    try:
        server = await open_transport("udpin://[::1]:0", received := Received(), on_peer=received.on_peer)
    except LinkOpenError as error:
        pytest.skip(f"no IPv6 here: {error}")
    async with transport(f"udpout://[::1]:{server.local_port}") as (client, _):
        client.send(b"six")
        await until(lambda: received == b"six")
        assert server.peer_name(0) == f"[::1]:{client.local_port}"
    await server.close()


async def test_a_datagram_that_is_too_long_is_dropped():
    with udp_socket() as peer:
        async with transport(udp_url(peer)) as (client, _):
            client.send(bytes(70_000))
            assert (client.counters.dropped, client.counters.errors) == (1, 1)


# ---------------------------------------------------------------------------------------------------------- TCP


async def test_tcp_client_waits_for_its_server_and_comes_back():
    port = tcp_port()
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
        await until(lambda: received.states[-1][1] == "Connection refused")
        name = f"127.0.0.1:{port}"
        life = [(OPEN, name), (WAITING, "closed by the other side"), (WAITING, "Connection refused")]
        # However often it was tried. After a life the listener may be there again before anybody is refused.
        assert received.states in ([life[-1], *life, *life], [life[-1], *life[:2], *life])
        assert received.peers == [(0, True), (0, False)] * 2


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
        assert received.peers == [(0, True), (0, False), (0, True), (0, False)]


async def test_tcp_server_with_several_clients_keeps_them_apart_and_takes_no_more():
    async with transport("tcpin://127.0.0.1:0", peers_max=2) as (server, received):
        address = ("127.0.0.1", server.local_port)
        with socket.create_connection(address) as first, socket.create_connection(address) as second:
            first.sendall(b"a")
            second.sendall(b"b")
            await until(lambda: received.of == {0: b"a", 1: b"b"})
            with socket.create_connection(address) as third:
                third.settimeout(5.0)
                assert await receive(third) == b""
            assert (server.counters.refused, server.counters.connections) == (1, 2)
            server.send(b"to b", 1)
            server.send(b"to a", 0)
            assert (await receive(first), await receive(second)) == (b"to a", b"to b")
            first.close()
            await until(lambda: (0, False) in received.peers)
            assert server.state is OPEN
            with socket.create_connection(address) as fourth:
                fourth.sendall(b"d")
                await until(lambda: received.of.get(2) == b"d")
                second.sendall(b"b")
                await until(lambda: received.of[1] == b"bb")
        await until(lambda: server.state is WAITING)
        assert received.peers[:4] == [(0, True), (1, True), (0, False), (2, True)]
        assert [state for state, _ in received.states] == [OPEN, WAITING]


async def test_a_tcp_client_that_never_reads_costs_the_others_nothing():
    async with transport("tcpin://127.0.0.1:0", peers_max=2, queue_bytes=5000) as (server, received):
        address = ("127.0.0.1", server.local_port)
        with socket.socket() as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.connect(address)
            await until(lambda: received.peers == [(0, True)])
            with socket.create_connection(address) as listener:
                await until(lambda: received.peers == [(0, True), (1, True)])
                listener.setblocking(False)
                heard = bytearray()
                sent = bytearray()
                while server.counters.dropped < 1000:
                    for frame in FRAMES:
                        server.send(frame * 10, 0)
                    server.send(FRAMES[0], 1)
                    sent += FRAMES[0]
                    await asyncio.sleep(0)
                    with suppress(BlockingIOError):
                        heard += listener.recv(65536)
                dropped = server.counters.dropped
                listener.settimeout(5.0)
                while len(heard) < len(sent):
                    heard += await receive(listener)
                assert heard == sent
                assert server.counters.dropped == dropped
                assert (0, False) not in received.peers


async def test_a_tcp_client_that_reads_nothing_for_long_is_gone(monkeypatch):
    monkeypatch.setattr("swingd.link.transport.TCP_GIVE_UP_S", 1.0)
    async with transport("tcpin://127.0.0.1:0", peers_max=2, queue_bytes=5000) as (server, received):
        with socket.socket() as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.connect(("127.0.0.1", server.local_port))
            await until(lambda: server.state is OPEN)
            while not server.counters.dropped:
                server.send(FRAMES[0] * 10)
            await until(lambda: server.state is WAITING, 10.0)
            assert received.states[-1] == (WAITING, "Connection timed out")


async def test_sending_to_a_broken_connection_calls_nobody_back():
    async with transport("tcpin://127.0.0.1:0", peers_max=2) as (server, received):
        peer = socket.create_connection(("127.0.0.1", server.local_port))
        await until(lambda: received.peers == [(0, True)])
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        peer.close()  # a reset
        for _ in range(10):
            server.send(b"into the void", 0)
        assert server.counters.errors == 1
        assert received.peers == [(0, True)]
        await until(lambda: received.peers == [(0, True), (0, False)])
        assert server.state is WAITING


async def test_without_free_descriptors_a_client_waits_and_the_loop_is_not_kept_busy(monkeypatch):
    monkeypatch.setattr("swingd.link.transport._ACCEPT_PAUSE_S", 0.1)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    async with transport("tcpin://127.0.0.1:0", peers_max=2) as (server, received):
        with socket.socket() as peer:
            free = os.dup(peer.fileno())
            os.close(free)
            resource.setrlimit(resource.RLIMIT_NOFILE, (free, hard))
            try:
                peer.connect(("127.0.0.1", server.local_port))
                await asyncio.sleep(0.35)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            assert 1 <= server.counters.errors <= 5
            peer.sendall(b"at last")
            await until(lambda: received == b"at last")


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
        assert received.peers == [(0, True), (0, False), (0, True)]
        assert [state for state, _ in received.states] == [OPEN, WAITING, WAITING, OPEN]
        assert "No such file" in received.states[2][1]
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


@pytest.mark.parametrize("peers_max", [0, -1])
async def test_a_link_serves_at_least_one_peer(peers_max):
    with pytest.raises(ValueError, match=f"peers_max: {peers_max} given"):
        await open_transport("udpin://127.0.0.1:0", print, peers_max=peers_max)


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


@pytest.mark.parametrize(
    "scenario",
    [
        test_udp_server_answers_the_last_peer_that_spoke,
        test_udp_client_is_told_its_peer_once_and_after_it_is_open,
        test_a_udp_peer_among_several_goes_by_silence_and_comes_back_as_another,
        test_tcp_client_waits_for_its_server_and_comes_back,
        test_a_new_tcp_client_takes_the_place_of_the_old,
        test_tcp_server_with_several_clients_keeps_them_apart_and_takes_no_more,
        test_sending_to_a_broken_connection_calls_nobody_back,
    ],
)
def test_on_the_loop_that_the_daemon_uses(scenario):
    uvloop = pytest.importorskip("uvloop")
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(scenario())
