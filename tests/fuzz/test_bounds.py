"""Whoever invents names, systems, peers or messages without end fills no memory."""

import gc
import itertools
import tracemalloc
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.engine import Engine
from swingd.link.codec import Codec, Framer
from swingd.link.router import AUTOPILOT, port_of
from swingd.model.parameters import Parameters

COUNT = 12_000
ENDPOINT = port_of(0, 0)
GROWTH_MAX_BYTES = 800_000
"""Of a whole flood; what kept a hundred bytes of each message would need half as much again."""


def components() -> Iterator[bytes]:
    for system, component in itertools.islice(itertools.product(range(2, 255), range(1, 255)), COUNT):
        yield Codec(system, component).encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))


def parameters_set() -> Iterator[bytes]:
    codec = Codec(255, 190)
    for k in range(COUNT):
        yield codec.encode(mavlink.MAVLink_param_set_message(1, 191, f"P_{k}".encode(), float(k), 9))


def parameters_told() -> Iterator[bytes]:
    codec = Codec(1, 1)
    for k in range(COUNT):
        yield codec.encode(mavlink.MAVLink_param_value_message(f"P_{k}".encode(), float(k), 9, 65535, k))


def commands() -> Iterator[bytes]:
    codec = Codec(255, 190)
    for k in range(COUNT):
        yield codec.encode(mavlink.MAVLink_command_long_message(1, 191, k, 0, *(0.0 for _ in range(7))))


def addressed() -> Iterator[bytes]:
    codec = Codec(255, 190)
    for k in range(COUNT):
        yield codec.encode(mavlink.MAVLink_param_request_list_message(2 + k % 250, 1 + k // 250 % 250))


def imu_of_any_time() -> Iterator[bytes]:
    codec = Codec(1, 1)
    for k in range(COUNT):
        t_us = k * 7_919_000_003 % 2**63
        yield codec.encode(mavlink.MAVLink_highres_imu_message(t_us, 0, 0, -9.8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 63, 0))


def garbage() -> Iterator[bytes]:
    for k in range(COUNT):
        yield bytes((0xFD, 255, 0, 0, 0, 1, 1, k & 255, k >> 8 & 255)) * 3


@pytest.mark.parametrize(
    ("flood", "port"),
    [
        (components, ENDPOINT),
        (components, AUTOPILOT),
        (parameters_set, ENDPOINT),
        (parameters_told, AUTOPILOT),
        (commands, ENDPOINT),
        (addressed, ENDPOINT),
        (imu_of_any_time, AUTOPILOT),
        (garbage, ENDPOINT),
    ],
)
def test_a_flood_fills_no_memory(flood, port) -> None:
    engine, framer = Engine(Parameters()), Framer()
    engine.join(0.0)
    engine.open_port(0.0, ENDPOINT)
    engine.receive(
        0.0, AUTOPILOT, Framer().receive(Codec(1, 1).encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)))
    )
    pieces = list(flood())
    tracemalloc.start()
    try:
        for k, piece in enumerate(pieces, start=1):
            t_s = 0.001 * k
            engine.receive(t_s, port, framer.receive(piece))
            if k % 50 == 0:
                engine.tick(t_s)
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert grown < GROWTH_MAX_BYTES
    assert engine.failure is None


def test_peers_that_come_and_go_leave_nothing() -> None:
    engine = Engine(Parameters())
    for k in range(5_000):
        port = port_of(0, k)
        engine.open_port(0.001 * k, port)
        beat = Codec(255, 190).encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
        engine.receive(0.001 * k, port, Framer().receive(beat))
        engine.close_port(0.001 * k, port)
    assert engine.router.ports == (AUTOPILOT,)
