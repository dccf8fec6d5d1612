"""Forwarding before everything else: what is loaded by then."""

import contextlib
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from ports import udp_port
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Encoder, Framer

pytestmark = pytest.mark.live

HEAVY = ("numpy", "numba", "pydantic", "rich", "typer", "structlog", "yaml", "scipy")
LOADING = """
import sys, time
heavy = {heavy!r}
seen = open({seen!r}, "w", buffering=1)
def watch(event, arguments):
    if event == "import" and arguments[0].split(".")[0] in heavy:
        seen.write(f"{{time.monotonic()}} {{arguments[0]}}\\n")
sys.addaudithook(watch)
sys.argv[0] = "swingd"
from swingd.cli.start import main
main()
"""


class Ends:
    """An autopilot's and an application's end of the daemon's links, on plain sockets."""

    def __init__(self) -> None:
        self.application = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.application.bind(("127.0.0.1", 0))
        self.application.settimeout(0.005)
        self.autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.autopilot_port = udp_port()
        self.arguments = (
            *("run", "--autopilot", f"udpin://127.0.0.1:{self.autopilot_port}"),
            *("--endpoint", f"udpout://127.0.0.1:{self.application.getsockname()[1]}"),
        )
        self._encoder = Encoder(1, 1)

    def until_forwarded(self, at_most_s: float) -> float:
        """Speak as an autopilot until the application hears it; return when that was on the monotonic clock [s]."""
        end_s = time.monotonic() + at_most_s
        while time.monotonic() < end_s:
            heartbeat = self._encoder.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))
            self.autopilot.sendto(heartbeat, ("127.0.0.1", self.autopilot_port))
            with contextlib.suppress(TimeoutError):
                frames = Framer().receive(self.application.recv(4096))
                if any(frame.component_id == 1 for frame in frames):
                    return time.monotonic()
        raise AssertionError("nothing was forwarded")


@pytest.fixture
def ends() -> Iterator[Ends]:
    ends = Ends()
    with ends.application, ends.autopilot:
        yield ends


def test_nothing_heavy_is_loaded_before_the_first_frame_is_forwarded(ends: Ends, tmp_path: Path) -> None:
    """GIVEN a configuration that was valid before WHEN the daemon starts THEN it forwards first, then loads."""
    seen = tmp_path / "imports"
    script = LOADING.format(heavy=HEAVY, seen=str(seen))
    for attempt in range(2):
        process = subprocess.Popen([sys.executable, "-c", script, *ends.arguments], stderr=subprocess.PIPE, text=True)
        try:
            forwarded_s = ends.until_forwarded(20.0)
            assert process.stderr is not None
            while "estimating" not in process.stderr.readline():
                assert process.poll() is None
        finally:
            process.terminate()
            process.communicate()
        loads = [(float(t_s), name) for t_s, name in map(str.split, seen.read_text().splitlines())]
        assert {"numpy", "numba"} <= {name for _, name in loads}, "the filter was loaded at last"
        if attempt:
            assert [name for t_s, name in loads if t_s < forwarded_s] == []
