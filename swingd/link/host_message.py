"""ONBOARD_COMPUTER_STATUS: the state of swingd's computer on the wire."""

import math
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.model.host import HostStatus, LinkKind

_UNUSED_U8, _UNUSED_I8, _UNUSED_I16, _UNUSED_U32 = 0xFF, 0x7F, 0x7FFF, 0xFFFFFFFF
_KIB, _MIB = 1024.0, 1024.0**2
_UART, _WIRED = 0, 10
"""First numbers of LINK_TYPE's ranges: of a network nobody asked whether it has wires."""


def encode(status: HostStatus) -> Any:
    """Return pymavlink's message of a status; never raises.

    What is not known holds MAVLink's value for unused fields; what a field has no place for is left out or clipped.
    """
    links = status.links[:6]
    uptime_ms = _whole(status.uptime_s * 1e3, 0, _UNUSED_U32, 0)
    return mavlink.MAVLink_onboard_computer_status_message(
        time_usec=_whole(status.uptime_s * 1e6, 0, 2**63, 0),
        uptime=uptime_ms,
        type=0,
        cpu_cores=_row([_whole(load * 100.0, 0, 100, _UNUSED_U8) for load in status.core_loads], 8, _UNUSED_U8),
        cpu_combined=[_UNUSED_U8] * 10,
        gpu_cores=[_UNUSED_U8] * 4,
        gpu_combined=[_UNUSED_U8] * 10,
        temperature_board=_celsius(status.board_temperature_c),
        temperature_core=_row([_celsius(value) for value in status.core_temperatures_c], 8, _UNUSED_I8),
        fan_speed=[_UNUSED_I16] * 4,
        ram_usage=_amount(status.memory_used_bytes, _MIB),
        ram_total=_amount(status.memory_total_bytes, _MIB),
        storage_type=[_UNUSED_U32] * 4,
        storage_usage=_row([_amount(status.storage_used_bytes, _MIB)], 4, _UNUSED_U32),
        storage_total=_row([_amount(status.storage_total_bytes, _MIB)], 4, _UNUSED_U32),
        link_type=_row([_UART if link.kind is LinkKind.SERIAL else _WIRED for link in links], 6, _UNUSED_U32),
        link_tx_rate=_row([_amount(link.sent_bytes_per_s, _KIB) for link in links], 6, _UNUSED_U32),
        link_rx_rate=_row([_amount(link.received_bytes_per_s, _KIB) for link in links], 6, _UNUSED_U32),
        link_tx_max=[_UNUSED_U32] * 6,
        link_rx_max=[_UNUSED_U32] * 6,
    )


def _whole(value: float, low: int, high: int, unused: int) -> int:
    return min(max(round(value), low), high) if math.isfinite(value) else unused


def _celsius(value: float | None) -> int:
    return _UNUSED_I8 if value is None else _whole(value, -128, _UNUSED_I8 - 1, _UNUSED_I8)


def _amount(value: float | None, unit: float) -> int:
    return _UNUSED_U32 if value is None else _whole(value / unit, 0, _UNUSED_U32 - 1, _UNUSED_U32)


def _row(values: Sequence[int], size: int, unused: int) -> list[int]:
    return [*values, *[unused] * size][:size]
