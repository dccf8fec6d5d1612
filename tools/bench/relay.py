"""A plain UDP relay: what forwarding costs in this interpreter when nobody looks at what passes.

    python relay.py AUTOPILOT_PORT ENDPOINT_PORT...

Waits for the autopilot on a port of this machine; sends each of its datagrams to every endpoint, and what an endpoint
answers to the autopilot.
"""

import selectors
import socket
import sys

HOST = "127.0.0.1"


def main(autopilot_port: int, *endpoint_ports: int) -> None:
    """Relay until killed."""
    autopilot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    autopilot.bind((HOST, autopilot_port))
    endpoints = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in endpoint_ports]
    selector = selectors.DefaultSelector()
    selector.register(autopilot, selectors.EVENT_READ)
    for endpoint, port in zip(endpoints, endpoint_ports, strict=True):
        endpoint.connect((HOST, port))
        selector.register(endpoint, selectors.EVENT_READ)
    speaker = None
    while True:
        for key, _ in selector.select():
            if key.fileobj is autopilot:
                data, speaker = autopilot.recvfrom(65536)
                for endpoint in endpoints:
                    endpoint.send(data)
            else:
                data = key.fileobj.recv(65536)  # type: ignore[union-attr]
                if speaker is not None:
                    autopilot.sendto(data, speaker)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
