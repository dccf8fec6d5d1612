import math
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from swingd.link import host_message
from swingd.model.host import HostStatus, LinkKind, LinkRate

from .ground_station import on_the_wire

MIB = 2**20
STATUS = HostStatus(
    uptime_s=12.3456,
    core_loads=(0.0, 0.504, 1.0),
    core_temperatures_c=(51.6, -3.0),
    board_temperature_c=40.2,
    memory_used_bytes=512 * MIB,
    memory_total_bytes=2048 * MIB,
    storage_used_bytes=9 * 1024 * MIB,
    storage_total_bytes=32 * 1024 * MIB,
    links=(LinkRate(LinkKind.SERIAL, 20_480.0, 51_200.0), LinkRate(LinkKind.NETWORK, 0.0, 1024.0)),
)
UNUSED = 2**32 - 1


def test_a_status_arrives_in_mavlink_s_units():
    message = on_the_wire(host_message.encode(STATUS))
    assert message.get_type() == "ONBOARD_COMPUTER_STATUS"
    assert (message.time_usec, message.uptime, message.type) == (12_345_600, 12_346, 0)
    assert message.cpu_cores == [0, 50, 100, 255, 255, 255, 255, 255]
    assert message.temperature_core == [52, -3, 127, 127, 127, 127, 127, 127]
    assert message.temperature_board == 40
    assert (message.ram_usage, message.ram_total) == (512, 2048)
    assert message.storage_usage == [9 * 1024, UNUSED, UNUSED, UNUSED]
    assert message.storage_total == [32 * 1024, UNUSED, UNUSED, UNUSED]
    assert message.link_type == [0, 10, UNUSED, UNUSED, UNUSED, UNUSED]
    assert message.link_tx_rate == [20, 0, UNUSED, UNUSED, UNUSED, UNUSED]
    assert message.link_rx_rate == [50, 1, UNUSED, UNUSED, UNUSED, UNUSED]


def test_what_is_not_known_holds_mavlink_s_value_for_unused_fields():
    message = on_the_wire(host_message.encode(HostStatus(uptime_s=1.0)))
    assert message.cpu_cores == [255] * 8
    assert message.cpu_combined == message.gpu_combined == [255] * 10
    assert message.gpu_cores == [255] * 4
    assert message.temperature_core == [127] * 8
    assert message.temperature_board == 127
    assert message.fan_speed == [32767] * 4
    assert message.ram_usage == message.ram_total == UNUSED
    for field in ("storage_type", "storage_usage", "storage_total"):
        assert getattr(message, field) == [UNUSED] * 4
    for field in ("link_type", "link_tx_rate", "link_rx_rate", "link_tx_max", "link_rx_max"):
        assert getattr(message, field) == [UNUSED] * 6


def test_more_than_the_fields_hold_is_left_out():
    status = replace(STATUS, core_loads=(0.25,) * 64, core_temperatures_c=(30.0,) * 64, links=STATUS.links * 8)
    message = on_the_wire(host_message.encode(status))
    assert message.cpu_cores == [25] * 8
    assert message.temperature_core == [30] * 8
    assert message.link_type == [0, 10] * 3


NUMBERS = st.floats()
AMOUNTS = st.none() | st.integers(-(2**70), 2**70)


@given(
    st.builds(
        HostStatus,
        uptime_s=NUMBERS,
        core_loads=st.lists(NUMBERS, max_size=12).map(tuple),
        core_temperatures_c=st.lists(NUMBERS, max_size=12).map(tuple),
        board_temperature_c=st.none() | NUMBERS,
        memory_used_bytes=AMOUNTS,
        memory_total_bytes=AMOUNTS,
        storage_used_bytes=AMOUNTS,
        storage_total_bytes=AMOUNTS,
        links=st.lists(st.builds(LinkRate, st.sampled_from(LinkKind), NUMBERS, NUMBERS), max_size=8).map(tuple),
    )
)
def test_whatever_the_sensors_say_can_be_sent(status):
    message = on_the_wire(host_message.encode(status))
    for load, sent in zip(status.core_loads, message.cpu_cores, strict=False):
        assert sent == (min(max(round(100.0 * load), 0), 100) if math.isfinite(100.0 * load) else 255)
