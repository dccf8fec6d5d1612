"""Measures the computer that swingd runs on."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from swingd.model.host import HostStatus, LinkKind, LinkRate

_CORE_SENSORS = ("coretemp", "k10temp", "zenpower", "soc_thermal", "bigcore0_thermal")
"""Drivers of the processor's sensors on Linux, besides those whose names begin with cpu."""
_BOARD_SENSORS = ("acpitz", "board_thermal")


@dataclass(frozen=True, slots=True)
class LinkBytes:
    """What one of swingd's links has carried since it was opened."""

    kind: LinkKind
    sent: int
    received: int


class HostMeter:
    """Reads the state of the computer.

    Parameters
    ----------
    storage : Path
        Any path on the file system that is to be watched.

    Notes
    -----
    psutil is imported here, not with this module. A reading asks the operating system a dozen questions and some boards
    answer slowly: it belongs in a thread, one at a time.
    """

    def __init__(self, storage: Path = Path("/")) -> None:
        import psutil

        self._psutil: ModuleType = psutil
        self._storage = storage
        self._read_s: float | None = None
        self._links: tuple[LinkBytes, ...] = ()
        self._cores = self._core_times()

    def read(self, t_mono_s: float, links: Sequence[LinkBytes] = ()) -> HostStatus:
        """Measure; what cannot be measured is left out.

        Parameters
        ----------
        t_mono_s : float
            The host's monotonic clock [s].
        links : sequence of LinkBytes
            swingd's links, in the same order each time; their rates are those since the last reading.
        """
        psutil = self._psutil
        storage_used: int | None = None
        storage_total: int | None = None
        try:
            usage = psutil.disk_usage(str(self._storage))
            storage_used, storage_total = usage.used, usage.total
        except OSError:
            pass
        memory = psutil.virtual_memory()
        cores, board = self._temperatures()
        status = HostStatus(
            uptime_s=_uptime_s(psutil),
            core_loads=self._core_loads(),
            core_temperatures_c=cores,
            board_temperature_c=board,
            memory_used_bytes=memory.total - memory.available,
            memory_total_bytes=memory.total,
            storage_used_bytes=storage_used,
            storage_total_bytes=storage_total,
            links=self._rates(t_mono_s, links),
        )
        self._read_s = t_mono_s
        self._links = tuple(links)
        return status

    def _core_times(self) -> tuple[tuple[float, float], ...]:
        """Seconds that each core was busy, and in all, since the start."""
        times = []
        for core in self._psutil.cpu_times(percpu=True):
            idle_s = core.idle + getattr(core, "iowait", 0.0)
            # Time of guests is contained in that of the user.
            total_s = sum(core) - getattr(core, "guest", 0.0) - getattr(core, "guest_nice", 0.0)
            times.append((total_s - idle_s, total_s))
        return tuple(times)

    def _core_loads(self) -> tuple[float, ...]:
        # psutil's own cpu_percent remembers by thread, and a pool's threads change.
        before, self._cores = self._cores, self._core_times()
        if len(before) != len(self._cores):
            return ()
        return tuple(
            min(max((busy_s - was_busy_s) / (total_s - was_total_s), 0.0), 1.0) if total_s > was_total_s else 0.0
            for (busy_s, total_s), (was_busy_s, was_total_s) in zip(self._cores, before, strict=True)
        )

    def _rates(self, t_mono_s: float, links: Sequence[LinkBytes]) -> tuple[LinkRate, ...]:
        elapsed_s = t_mono_s - self._read_s if self._read_s is not None else 0.0
        if elapsed_s <= 0.0 or len(links) != len(self._links):
            return ()
        return tuple(
            LinkRate(
                link.kind,
                max(link.sent - before.sent, 0) / elapsed_s,
                max(link.received - before.received, 0) / elapsed_s,
            )
            for link, before in zip(links, self._links, strict=True)
        )

    def _temperatures(self) -> tuple[tuple[float, ...], float | None]:
        read = getattr(self._psutil, "sensors_temperatures", None)  # absent on some systems
        if read is None:
            return (), None
        try:
            sensors = read()
        except (OSError, ValueError):
            return (), None
        return cores_and_board(sensors)


def cores_and_board(sensors: Mapping[str, Sequence[Any]]) -> tuple[tuple[float, ...], float | None]:
    """Find the temperatures of the processor's cores and of the board [degC].

    Parameters
    ----------
    sensors : mapping
        As psutil lists them: by driver, each with ``label`` and ``current``.
    """
    of_cores = next((v for name, v in sensors.items() if name in _CORE_SENSORS or name.lower().startswith("cpu")), [])
    # A sensor by core where there is one, else that of the whole processor.
    by_core = [sensor for sensor in of_cores if sensor.label.startswith("Core")] or of_cores
    board = next((sensors[name][0].current for name in _BOARD_SENSORS if sensors.get(name)), None)
    return tuple(sensor.current for sensor in by_core), board


def _uptime_s(psutil: ModuleType) -> float:
    """Seconds since the computer was started, whatever its calendar clock does meanwhile."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.clock_gettime(clock) if clock is not None else time.time() - psutil.boot_time()
