import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.link.url import LOOPBACK, SerialPort, TcpIn, TcpOut, UdpIn, UdpOut, parse_url
from swingd.model.errors import LinkUrlError

PARSED = {
    "udpin://0.0.0.0:14540": UdpIn("0.0.0.0", 14540),
    "udpin://:14540": UdpIn("0.0.0.0", 14540),
    "udp://:14540": UdpIn("0.0.0.0", 14540),
    "udpin://[::]:14540": UdpIn("::", 14540),
    "udpout://192.168.1.12:14550": UdpOut("192.168.1.12", 14550),
    "udpout://[fe80::1%eth0]:14550": UdpOut("fe80::1%eth0", 14550),
    "tcpout://ground-station.local:5760": TcpOut("ground-station.local", 5760),
    "tcp://localhost:5760": TcpOut("localhost", 5760),
    "tcpin://127.0.0.1:0": TcpIn("127.0.0.1", 0),
    " TCPIN://:5790/ ": TcpIn("0.0.0.0", 5790),
    "serial:///dev/ttyAMA0:921600": SerialPort("/dev/ttyAMA0", 921600),
    "serial://COM3:57600": SerialPort("COM3", 57600),
    "serial:///dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0:115200": SerialPort(
        "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0", 115200
    ),
    "serial_flowcontrol:///dev/ttyS1:3000000": SerialPort("/dev/ttyS1", 3000000, True),
}


@pytest.mark.parametrize(("text", "url"), PARSED.items())
def test_accepted(text, url):
    assert parse_url(text) == url
    assert parse_url(str(url)) == url


@pytest.mark.parametrize(
    ("text", "url"),
    [
        ("udpin://:14541", UdpIn("127.0.0.1", 14541)),
        ("udp://:14541", UdpIn("127.0.0.1", 14541)),
        ("tcpin://:5760", TcpIn("127.0.0.1", 5760)),
        ("udpin://0.0.0.0:14541", UdpIn("0.0.0.0", 14541)),
        ("udpin://[::]:14541", UdpIn("::", 14541)),
        ("udpout://192.168.1.12:14550", UdpOut("192.168.1.12", 14550)),
    ],
)
def test_an_empty_host_is_this_machine_alone_where_that_is_asked_for(text, url):
    assert parse_url(text, default_host=LOOPBACK) == url


def test_a_host_to_connect_to_has_no_default():
    with pytest.raises(LinkUrlError, match="a host is needed"):
        parse_url("udpout://:14550", default_host=LOOPBACK)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "no '://'"),
        ("/dev/ttyAMA0", "no '://'"),
        ("http://127.0.0.1:80", "unknown scheme 'http'"),
        ("udpin://14540", "'14540' is no HOST:PORT"),
        ("udpin://::1:14540", "no HOST:PORT"),
        ("udpout://:14540", "a host is needed"),
        ("tcpout://host:0", "port 0 is not within 1..65535"),
        ("udpin://0.0.0.0:65536", "port 65536 is not within 0..65535"),
        ("udpin://0.0.0.0:14540/x", "no HOST:PORT"),
        ("udpin://0.0.0.0:\u0661", "no HOST:PORT"),
        ("serial:///dev/ttyAMA0", "a device and a baud rate are needed"),
        ("serial:///dev/ttyAMA0:fast", "'fast' is no baud rate"),
        ("serial:///dev/ttyAMA0:0", "'0' is no baud rate"),
        ("serial://:57600", "a device and a baud rate are needed"),
    ],
)
def test_refused_with_the_reason_and_the_forms(text, reason):
    with pytest.raises(LinkUrlError) as error:
        parse_url(text)
    assert reason in str(error.value)
    assert repr(text) in str(error.value)
    assert "udpout://HOST:PORT" in str(error.value)


@given(st.text(max_size=60), st.sampled_from(["", "udpin://", "tcpout://", "serial://"]))
def test_any_text_is_parsed_or_refused(text, scheme):
    try:
        url = parse_url(scheme + text)
    except LinkUrlError:
        return
    assert parse_url(str(url)) == url
