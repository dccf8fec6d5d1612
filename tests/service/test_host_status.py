"""The computer that the tests run on, as it is."""

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from swingd.model.host import LinkKind, LinkRate
from swingd.service.host_status import HostMeter, LinkBytes, cores_and_board

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="compares with /proc")


def test_memory_storage_and_uptime_are_those_of_the_computer(tmp_path):
    status = HostMeter(tmp_path).read(time.monotonic())
    meminfo = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
    assert status.memory_total_bytes == int(meminfo["MemTotal"].split()[0]) * 1024
    assert status.memory_used_bytes is not None
    assert 0 < status.memory_used_bytes < status.memory_total_bytes
    place = os.statvfs(tmp_path)
    assert status.storage_total_bytes == place.f_blocks * place.f_frsize
    assert status.storage_used_bytes is not None
    assert 0 < status.storage_used_bytes <= status.storage_total_bytes
    assert status.uptime_s == pytest.approx(time.clock_gettime(time.CLOCK_BOOTTIME), abs=2.0)


def test_a_busy_core_shows_whatever_thread_asks():
    with ThreadPoolExecutor(1) as first, ThreadPoolExecutor(1) as second:
        meter = first.submit(HostMeter).result()
        stop = threading.Event()
        busy = threading.Thread(target=_burn, args=(stop,))
        busy.start()
        try:
            time.sleep(0.6)
            status = second.submit(meter.read, 1.0).result()
        finally:
            stop.set()
            busy.join()
    assert len(status.core_loads) == os.cpu_count()
    assert all(0.0 <= load <= 1.0 for load in status.core_loads)
    # Two threads share the interpreter: one core's worth of work, wherever it ran, less what others take.
    assert sum(status.core_loads) > 0.5


def _burn(stop: threading.Event) -> None:
    while not stop.is_set():
        sum(range(10_000))


def test_the_rates_of_the_links_are_those_between_two_readings():
    meter = HostMeter()
    serial, network = LinkKind.SERIAL, LinkKind.NETWORK
    assert meter.read(10.0, [LinkBytes(serial, 1000, 5000)]).links == ()
    assert meter.read(12.0, [LinkBytes(serial, 3000, 5500)]).links == (LinkRate(serial, 1000.0, 250.0),)
    # A link more: nothing is known of it yet, and a link opened anew counts from zero.
    both = [LinkBytes(serial, 10, 10), LinkBytes(network, 0, 0)]
    assert meter.read(13.0, both).links == ()
    restarted = [LinkBytes(serial, 4, 20), LinkBytes(network, 512, 0)]
    assert meter.read(14.0, restarted).links == (LinkRate(serial, 0.0, 10.0), LinkRate(network, 512.0, 0.0))
    assert meter.read(14.0, restarted).links == ()


def test_a_file_system_that_is_gone_is_left_out(tmp_path):
    status = HostMeter(tmp_path / "gone").read(0.0)
    assert (status.storage_used_bytes, status.storage_total_bytes) == (None, None)
    assert status.memory_total_bytes


def test_temperatures_are_those_that_the_system_lists():
    import psutil

    listed = [sensor.current for sensors in psutil.sensors_temperatures().values() for sensor in sensors]
    status = HostMeter().read(0.0)
    for temperature_c in status.core_temperatures_c:
        assert min(listed) - 10.0 <= temperature_c <= max(listed) + 10.0
    if not listed:
        assert (status.core_temperatures_c, status.board_temperature_c) == ((), None)


@dataclass(frozen=True)
class Sensor:
    label: str
    current: float


@pytest.mark.parametrize(
    ("sensors", "cores", "board"),
    [
        ({"cpu_thermal": [Sensor("", 48.3)], "rp1_adc": [Sensor("", 51.0)]}, (48.3,), None),
        (
            {
                "acpitz": [Sensor("", 27.8)],
                "nvme": [Sensor("Composite", 33.9)],
                "coretemp": [Sensor("Package id 0", 44.0), Sensor("Core 0", 41.0), Sensor("Core 1", 43.0)],
            },
            (41.0, 43.0),
            27.8,
        ),
        ({"k10temp": [Sensor("Tctl", 50.1)]}, (50.1,), None),
        ({"CPU-therm": [Sensor("", 39.5)], "GPU-therm": [Sensor("", 38.0)]}, (39.5,), None),
        ({"nvme": [Sensor("Composite", 33.9)], "acpitz": []}, (), None),
        ({}, (), None),
    ],
    ids=["board computer", "PC", "AMD", "Jetson", "disk only", "virtual"],
)
def test_the_processor_s_sensors_are_found_among_those_listed(sensors, cores, board):
    assert cores_and_board(sensors) == (cores, board)


def test_psutil_is_not_loaded_before_it_is_needed():
    script = "import sys, swingd.service.host_status; print('psutil' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "False\n"
