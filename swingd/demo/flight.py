"""One live flight: the simulated PX4 here, the daemon in a process of its own, real UDP between them."""

import asyncio
import contextlib
import json
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from swingd.config.render import dump_parameters
from swingd.demo.pilot import Phase, Pilot, Step
from swingd.model.errors import SwingdError
from swingd.model.estimate import FloatArray
from swingd.model.events import Vec3
from swingd.model.parameters import Mode, Parameters
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.run import run_simulation

SAMPLE_S = 0.02
START_TIMEOUT_S = 180.0
"""The first run of all compiles the filter."""
OVERTIME_S = 60.0
STOP_TIMEOUT_S = 10.0
_HOLD = 5.0
"""COM_OBL_RC_ACT: hold where the stream of setpoints is lost."""


class DemoError(SwingdError):
    """The demonstration could not be flown; the text says how far it came."""


@dataclass(frozen=True, slots=True)
class Flight:
    """What one flight left behind; times on the autopilot's clock [s]."""

    t_boot_s: FloatArray
    """(n,)"""
    chi_rad: FloatArray
    """(n,) true total swing."""
    angles_rad: FloatArray
    """(2, n) true xi, zeta of the heading frame."""
    rates_radps: FloatArray
    """(2, n)"""
    vel_ned_mps: FloatArray
    """(3, n) true."""
    steps: tuple[Step, ...]
    """The velocity steps that were commanded."""
    end_s: float
    estimate_t_s: FloatArray
    """(m,) stamps of the published estimate."""
    estimate_rad: FloatArray
    """(2, m) published xi, zeta."""
    estimate_rates_radps: FloatArray
    """(2, m)"""
    setpoint_gap_s: float
    """Longest wait of the autopilot for a setpoint during the steps [s]."""
    daemon: dict[str, float | None]
    """The daemon's own figures (``swingd run --summary``)."""

    @property
    def step_ends_s(self) -> list[float]:
        """When each step's window ends: at the next step, the last with the flight [s]."""
        return [step.t_boot_s for step in self.steps[1:]] + [self.end_s]


@dataclass(frozen=True, slots=True)
class Moment:
    """Where the flight stands, for whoever watches."""

    share: float
    """Of the flight's duration, 0..1."""
    phase: Phase
    chi_rad: float


class _Recorder:
    """Samples the truth and the published estimate while the simulation runs."""

    def __init__(self, peer: SimulatedAutopilot, pilot: Pilot, watch: Callable[[Moment], None]) -> None:
        self._peer, self._pilot, self._watch = peer, pilot, watch
        self._due_s = 0.0
        self._begun_s: float | None = None
        self.rows: list[tuple[float, ...]] = []
        self.estimates: list[tuple[float, ...]] = []
        self.setpoint_gap_s = 0.0

    def __call__(self, t_s: float) -> None:
        if self._pilot.phase is Phase.STEPS:
            self.setpoint_gap_s = max(self.setpoint_gap_s, self._peer.autopilot.setpoint_age_s)
        if t_s < self._due_s:
            return
        self._due_s = t_s + SAMPLE_S
        truth = self._peer.truth()
        self.rows.append(
            (
                truth.t_boot_s,
                truth.chi_rad,
                truth.xi_rad,
                truth.zeta_rad,
                truth.xi_rate_radps,
                truth.zeta_rate_radps,
                *truth.vel_ned_mps,
            )
        )
        reports = self._peer.companion.reports
        while reports:
            report = reports.popleft()
            self.estimates.append(
                (report.t_boot_s, report.xi_rad, report.zeta_rad, report.xi_rate_radps, report.zeta_rate_radps)
            )
        if self._pilot.phase is not Phase.WAIT and self._begun_s is None:
            self._begun_s = t_s
        flown_s = t_s - self._begun_s if self._begun_s is not None else 0.0
        self._watch(Moment(min(flown_s / self._pilot.duration_s, 1.0), self._pilot.phase, truth.chi_rad))


async def fly(
    parameters: Parameters, enabled: bool, steps_ned_mps: tuple[Vec3, ...], watch: Callable[[Moment], None]
) -> Flight:
    """Fly the manoeuvre once.

    Parameters
    ----------
    parameters : Parameters
        Vehicle, load, noise; links and mode are chosen here.
    enabled : bool
        Whether the correction is on.
    steps_ned_mps : vectors
        The reference velocities.
    watch : callable
        Called fifty times a second of simulated time.

    Raises
    ------
    DemoError
        If the daemon does not start, ends early, or the manoeuvre is not over in time.
    """
    port = _free_port()
    parameters = replace(
        parameters,
        mode=Mode.HOLD,
        control=replace(parameters.control, enabled=enabled),
        link=replace(parameters.link, autopilot=f"udpin://127.0.0.1:{port}"),
        simulation=replace(parameters.simulation, mavlink=f"udpout://127.0.0.1:{port}", mavlink_bind_port=0),
    )
    peer = SimulatedAutopilot(parameters, {"COM_OBL_RC_ACT": _HOLD})
    pilot = Pilot(peer, steps_ned_mps)
    recorder = _Recorder(peer, pilot, watch)
    with tempfile.TemporaryDirectory(prefix="swingd-demo-") as folder:
        config, summary, log = (Path(folder) / name for name in ("config.yaml", "summary.json", "log"))
        config.write_text(dump_parameters(parameters), encoding="utf-8")
        with log.open("wb") as log_file:
            daemon = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "swingd", "run", "-c", str(config), "--summary", str(summary)),
                stdout=log_file,
                stderr=log_file,
            )
        try:
            await _until_done(parameters, peer, pilot, recorder, daemon, log)
        finally:
            await _stop(daemon)
        try:
            figures: dict[str, float | None] = json.loads(summary.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise DemoError(f"the daemon left no figures; it said:\n{_tail(log)}") from None
    rows = np.array(recorder.rows).T
    estimates = np.array(recorder.estimates or [(0.0,) * 5]).T
    return Flight(
        t_boot_s=rows[0],
        chi_rad=rows[1],
        angles_rad=rows[2:4],
        rates_radps=rows[4:6],
        vel_ned_mps=rows[6:9],
        steps=tuple(pilot.steps),
        end_s=peer.t_boot_s,
        estimate_t_s=estimates[0],
        estimate_rad=estimates[1:3],
        estimate_rates_radps=estimates[3:5],
        setpoint_gap_s=recorder.setpoint_gap_s,
        daemon=figures,
    )


async def _until_done(
    parameters: Parameters,
    peer: SimulatedAutopilot,
    pilot: Pilot,
    recorder: _Recorder,
    daemon: asyncio.subprocess.Process,
    log: Path,
) -> None:
    """Run the simulation until the pilot is done."""

    def on_step(peer: SimulatedAutopilot) -> None:
        pilot(peer.t_s)
        recorder(peer.t_s)

    simulation = asyncio.create_task(run_simulation(parameters, peer=peer, on_step=on_step))
    begun_s = time.monotonic()
    limit_s = START_TIMEOUT_S
    try:
        while pilot.phase is not Phase.DONE:
            await asyncio.sleep(0.05)
            if simulation.done():
                simulation.result()
            if daemon.returncode is not None:
                raise DemoError(f"the daemon ended with exit code {daemon.returncode}; it said:\n{_tail(log)}")
            if pilot.phase is Phase.WAIT:
                limit_s = START_TIMEOUT_S
            elif limit_s == START_TIMEOUT_S:
                begun_s = time.monotonic()
                limit_s = pilot.duration_s / parameters.simulation.speed + OVERTIME_S
            if time.monotonic() - begun_s > limit_s:
                raise DemoError(f"not done in time, still {pilot.phase.value}; the daemon said:\n{_tail(log)}")
    finally:
        simulation.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await simulation


async def _stop(daemon: asyncio.subprocess.Process) -> None:
    if daemon.returncode is None:
        daemon.send_signal(signal.SIGTERM)
        try:
            await asyncio.wait_for(daemon.wait(), STOP_TIMEOUT_S)
        except TimeoutError:
            daemon.kill()
            await daemon.wait()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _tail(log: Path, lines: int = 12) -> str:
    return "\n".join(log.read_text(encoding="utf-8", errors="replace").splitlines()[-lines:])
