"""One link of the daemon on real sockets."""

import asyncio
import socket
import time
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Encoder, cut_frames
from swingd.link.signing import Signing, Verdict
from swingd.model.parameters import Endpoint, Parameters
from swingd.service.links import DATAGRAM_MAX_BYTES, Link, settings_of

pytestmark = pytest.mark.live

KEY = bytes(range(32))


@pytest.mark.parametrize("count", [1, 5, 60])
@pytest.mark.parametrize("signed", [False, True])
async def test_frames_leave_in_order_and_in_few_datagrams_that_fit(count: int, signed: bool, tmp_path: Path) -> None:
    key_file = tmp_path / "key"
    key_file.write_text(KEY.hex(), encoding="ascii")
    key_file.chmod(0o600)
    encoder = Encoder(1, 1)
    frames = [encoder.encode(mavlink.MAVLink_statustext_message(6, b"x" * (k % 50 + 1))) for k in range(count)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(2.0)
        url = f"udpout://127.0.0.1:{ground.getsockname()[1]}"
        endpoint = Endpoint(url, key_file=str(key_file) if signed else "none")
        settings = settings_of(replace(Parameters(), endpoints=(endpoint,)))[1]
        link = Link(settings, lambda *_: None, lambda *_: None, lambda *_: None)
        await link.open()
        await asyncio.sleep(0)
        link.send(0, frames)
        await link.close()
        datagrams: list[bytes] = []
        while len([*cut_frames(b"".join(datagrams))]) < count:
            datagrams.append(ground.recv(65536))
    assert max(map(len, datagrams)) <= DATAGRAM_MAX_BYTES
    assert len(datagrams) == 1 + sum(map(len, datagrams)) // DATAGRAM_MAX_BYTES
    received = [*cut_frames(b"".join(datagrams))]
    if not signed:
        assert received == frames
        return
    checker = Signing(KEY, 0, time.time)
    assert [checker.check(frame) for frame in received] == [Verdict.GOOD] * count
    assert [frame[10 : 10 + frame[1]] for frame in received] == [frame[10 : 10 + frame[1]] for frame in frames]
