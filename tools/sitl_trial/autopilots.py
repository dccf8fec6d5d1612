"""The autopilots that a trial can start, and their ports."""

import socket
import sys
from collections.abc import Coroutine, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from .plan import Scenario
from .record import Files
from .slung_payload import write_truth
from .terrain import serve_flat_terrain

Ports = list[tuple[socket.SocketKind, int]]
Command = list[str | Path]


HOME_M = 584
"""Altitude at which ArduPilot's SITL begins."""


def console_port(instance: int) -> int:
    """Where the physics of an instance takes text commands."""
    return 15740 + instance


class Autopilot(Protocol):
    """One binary, started anew for each flight."""

    @property
    def parameters(self) -> Mapping[str, int]:
        """What the application sets before take-off."""

    def link(self, instance: int) -> str:
        """Where swingd finds it."""

    def ports(self, instance: int) -> Ports:
        """Those that one instance, its physics and its swingd open."""

    def command(self, instance: int, folder: Path, scenario: Scenario) -> Command | None:
        """How it is started, in a folder of its own; None if the physics brings it."""

    def environment(self) -> Mapping[str, str]:
        """What it needs besides."""

    def physics(self, instance: int, scenario: Scenario, files: Files) -> Command | None:
        """What simulates vehicle, cable and load; None if the autopilot does that itself."""

    def companion(self, instance: int, scenario: Scenario) -> Coroutine[object, object, None] | None:
        """What else must answer it while it flies."""

    def leave(self, folder: Path, scenario: Scenario, files: Files) -> None:
        """Keep what its folder holds of the truth, when it has ended; may raise `TrialError`."""


_PX4: Mapping[str, int] = {
    "COM_OBL_RC_ACT": 5,  # hold, where setpoints stop
    "COM_RC_IN_MODE": 4,  # no remote control
    "COM_RCL_EXCEPT": 4,  # nor is it missed in OFFBOARD
}


@dataclass(frozen=True, slots=True)
class Simulated:
    """swingd's own simulated PX4: what the real one is compared with."""

    parameters: Mapping[str, int] = field(default_factory=lambda: _PX4)

    def link(self, instance: int) -> str:
        return f"udpin://127.0.0.1:{14740 + instance}"

    def ports(self, instance: int) -> Ports:
        return [(socket.SOCK_STREAM, console_port(instance)), (socket.SOCK_DGRAM, 14740 + instance)]

    def command(self, instance: int, folder: Path, scenario: Scenario) -> Command | None:
        return None

    def environment(self) -> Mapping[str, str]:
        return {}

    def physics(self, instance: int, scenario: Scenario, files: Files) -> Command | None:
        link = ("--mavlink", f"udpout://127.0.0.1:{14740 + instance}", "--set", "simulation.mavlink_bind_port=0")
        return _swingd_sim(link, instance, files)

    def companion(self, instance: int, scenario: Scenario) -> Coroutine[object, object, None] | None:
        return None

    def leave(self, folder: Path, scenario: Scenario, files: Files) -> None:
        """Nothing: the truth is the simulation's."""


@dataclass(frozen=True, slots=True)
class Px4:
    """PX4; its build folder lies around the binary."""

    binary: Path
    parameters: Mapping[str, int] = field(default_factory=lambda: _PX4)

    def link(self, instance: int) -> str:
        return f"udpin://127.0.0.1:{14540 + instance}"

    def ports(self, instance: int) -> Ports:
        datagrams = (14540, 14580, 14280, 13030, 18570)
        streams = (4560 + instance, console_port(instance))
        return [
            *((socket.SOCK_STREAM, port) for port in streams),
            *((socket.SOCK_DGRAM, port + instance) for port in datagrams),
        ]

    def command(self, instance: int, folder: Path, scenario: Scenario) -> Command:
        return [self.binary, "-i", str(instance), "-d", "-w", folder, self.binary.parent.parent / "etc"]

    def environment(self) -> Mapping[str, str]:
        return {"PX4_SIM_MODEL": "none_iris"}

    def physics(self, instance: int, scenario: Scenario, files: Files) -> Command | None:
        return _swingd_sim(_hil("px4", instance), instance, files)

    def companion(self, instance: int, scenario: Scenario) -> Coroutine[object, object, None] | None:
        return None

    def leave(self, folder: Path, scenario: Scenario, files: Files) -> None:
        """Nothing: the truth is the simulation's."""


@dataclass(frozen=True, slots=True)
class Copter:
    """ArduCopter with this simulation, or with its own vehicle and slung payload."""

    binary: Path
    defaults: Path
    """Parameters of its developers' SITL Copter."""
    parameters: Mapping[str, int] = field(default_factory=dict)

    def link(self, instance: int) -> str:
        return f"tcpout://127.0.0.1:{5760 + 10 * instance}"

    def ports(self, instance: int) -> Ports:
        streams, datagrams = (5760, 5762, 5763), (9002, 5501)
        return [
            (socket.SOCK_STREAM, console_port(instance)),
            *((socket.SOCK_STREAM, port + 10 * instance) for port in streams),
            *((socket.SOCK_DGRAM, port + 10 * instance) for port in datagrams),
        ]

    def command(self, instance: int, folder: Path, scenario: Scenario) -> Command:
        lines = ["FRAME_TYPE 1"]  # an X, as the simulated vehicle
        if scenario.built_in:
            lines += [
                "SIM_SLUP_ENABLE 1",
                f"SIM_SLUP_WEIGHT {scenario.load_kg}",
                f"SIM_SLUP_LINELEN {scenario.cable_m}",
            ]
        more = folder / "trial.parm"
        more.write_text("\n".join(lines) + "\n", encoding="utf-8")
        model = "x" if scenario.built_in else "JSON:127.0.0.1"
        number = ("-I", str(instance), "--sysid", str(instance + 1))
        return [self.binary, "--model", model, *number, "--defaults", f"{self.defaults},{more}"]

    def environment(self) -> Mapping[str, str]:
        return {}

    def physics(self, instance: int, scenario: Scenario, files: Files) -> Command | None:
        return None if scenario.built_in else _swingd_sim(_hil("ardupilot", instance), instance, files)

    def companion(self, instance: int, scenario: Scenario) -> Coroutine[object, object, None] | None:
        return serve_flat_terrain(5762 + 10 * instance, HOME_M) if scenario.built_in else None

    def leave(self, folder: Path, scenario: Scenario, files: Files) -> None:
        if scenario.built_in:
            write_truth(folder / "logs", files.truth)


def _hil(name: str, instance: int) -> tuple[str, ...]:
    return "--hil", name, "--instance", str(instance)


def _swingd_sim(link: tuple[str, ...], instance: int, files: Files) -> Command:
    console = ("--console", str(console_port(instance)))
    return [sys.executable, "-m", "swingd", "sim", *link, *console, "-c", files.config, "--truth", files.truth]
