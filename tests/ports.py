"""Ports that nobody uses at this moment, for links whose far end must be known before it is opened."""

import socket


def udp_port() -> int:
    """Of this computer, free an instant ago."""
    return _free(socket.SOCK_DGRAM)


def tcp_port() -> int:
    """The same for TCP."""
    return _free(socket.SOCK_STREAM)


def _free(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
