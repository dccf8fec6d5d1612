"""Ports that nobody uses at this moment, for links whose far end must be known before it is opened.

They lie below those that the systems give out by themselves, and each worker has its own: until the link is opened,
nobody else gets them.
"""

import itertools
import os
import socket

FIRST, PER_WORKER, WORKERS = 20000, 1000, 12

_numbers = itertools.count(os.getpid())  # not the same ones as the run before, whose TCP ports may still be closing


def udp_port() -> int:
    """Of this computer, free an instant ago."""
    return _free(socket.SOCK_DGRAM)


def tcp_port() -> int:
    """The same for TCP."""
    return _free(socket.SOCK_STREAM)


def _free(kind: socket.SocketKind) -> int:
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % WORKERS
    for number in itertools.islice(_numbers, PER_WORKER):
        port = FIRST + PER_WORKER * worker + number % PER_WORKER
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
    raise AssertionError(f"no free port in {PER_WORKER} from {FIRST + PER_WORKER * worker} on")
