"""Link URLs as MAVSDK writes them."""

import re
from dataclasses import dataclass

from swingd.model.errors import LinkUrlError

FORMS = (
    "udpin://HOST:PORT, udpout://HOST:PORT, tcpin://HOST:PORT, tcpout://HOST:PORT, "
    "serial://DEVICE:BAUD, serial_flowcontrol://DEVICE:BAUD"
)
"""What `parse_url` accepts, for help texts."""
ANY_HOST = "0.0.0.0"
"""Every IPv4 address of this machine."""
LOOPBACK = "127.0.0.1"
"""This machine alone."""


def _authority(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


@dataclass(frozen=True, slots=True)
class UdpIn:
    """Wait for datagrams on a local address; answer the last peer that spoke."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"udpin://{_authority(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class UdpOut:
    """Send datagrams to a remote address."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"udpout://{_authority(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class TcpIn:
    """Wait for a TCP connection on a local address."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tcpin://{_authority(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class TcpOut:
    """Connect to a remote address."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tcpout://{_authority(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial device; ``flow_control`` uses RTS and CTS."""

    device: str
    baud: int
    flow_control: bool = False

    def __str__(self) -> str:
        return f"{'serial_flowcontrol' if self.flow_control else 'serial'}://{self.device}:{self.baud}"


LinkUrl = UdpIn | UdpOut | TcpIn | TcpOut | SerialPort

_NETWORK: dict[str, type[UdpIn] | type[UdpOut] | type[TcpIn] | type[TcpOut]] = {
    "udpin": UdpIn,
    "udp": UdpIn,
    "udpout": UdpOut,
    "tcpin": TcpIn,
    "tcpout": TcpOut,
    "tcp": TcpOut,
}
_HOST_PORT = re.compile(r"(?:\[(?P<v6>[0-9A-Fa-f:.]+(?:%[\w.-]+)?)\]|(?P<host>[\w.-]*)):(?P<port>\d{1,5})/?", re.ASCII)


def taken_by(url: LinkUrl) -> str | None:
    """Name what only one link can have; None if there is no such thing."""
    match url:
        case UdpIn(port=port) if port:
            return f"UDP port {port}"
        case TcpIn(port=port) if port:
            return f"TCP port {port}"
        case SerialPort(device=device):
            return device
    return None


def parse_url(url: str, default_host: str = ANY_HOST) -> LinkUrl:
    """Parse a link URL.

    Parameters
    ----------
    url : str
        One of `FORMS`; an IPv6 address stands in brackets. MAVSDK's older ``udp://:PORT`` (listening) and
        ``tcp://HOST:PORT`` (connecting) are understood.
    default_host : str
        What an empty host of a listening link means: `ANY_HOST` on the autopilot's side, `LOOPBACK` for an endpoint.

    Raises
    ------
    LinkUrlError
        If the URL is not understood; the text names the URL, what is wrong and the accepted forms.
    """

    def wrong(what: str) -> LinkUrlError:
        return LinkUrlError(f"link URL {url!r}: {what}; expected one of {FORMS}")

    scheme, separator, rest = url.strip().partition("://")
    scheme = scheme.lower()
    if not separator:
        raise wrong("no '://'")
    if scheme in ("serial", "serial_flowcontrol"):
        device, colon, baud = rest.rpartition(":")
        if not colon or not device:
            raise wrong("a device and a baud rate are needed")
        if not (baud.isascii() and baud.isdigit()) or not 0 < int(baud) <= 20_000_000:
            raise wrong(f"{baud!r} is no baud rate")
        return SerialPort(device, int(baud), scheme == "serial_flowcontrol")
    kind = _NETWORK.get(scheme)
    if kind is None:
        raise wrong(f"unknown scheme {scheme!r}")
    match = _HOST_PORT.fullmatch(rest)
    if match is None:
        raise wrong(f"{rest!r} is no HOST:PORT")
    port = int(match["port"])
    host = match["v6"] or match["host"]
    listening = kind in (UdpIn, TcpIn)
    if not (0 if listening else 1) <= port <= 65535:
        raise wrong(f"port {port} is not within {0 if listening else 1}..65535")
    if not host:
        if not listening:
            raise wrong("a host is needed")
        host = default_host
    return kind(host, port)
