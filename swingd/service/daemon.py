"""The daemon: one engine on one link, until it is told to stop."""

import asyncio
import contextlib
import gc
import signal
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import structlog

import swingd
from swingd.config.plain import parameters_to_json
from swingd.engine import Engine
from swingd.link.transport import Transport, open_transport
from swingd.model.actions import Action, Setpoint, StatusText, SwingReport
from swingd.model.parameters import Parameters
from swingd.record.event_log import EventLogWriter
from swingd.service.logs import level_of
from swingd.service.meter import Meter, Summary

TICK_S = 0.05
LOG_FLUSH_S = 1.0
GARBAGE_THRESHOLD = 50_000
"""Objects between two collections: the engine makes no cycles, and a setpoint should not wait for the collector."""


class Daemon:
    """Runs an engine on the link of its parameters.

    Parameters
    ----------
    parameters : Parameters
        ``link.autopilot`` is the link.
    record : Path, optional
        Event log to write.
    """

    def __init__(self, parameters: Parameters, record: Path | None = None) -> None:
        self._parameters = parameters
        self._log = structlog.get_logger("swingd")
        self._event_log: EventLogWriter | None = None
        if record is not None:
            self._event_log = EventLogWriter(
                record, swingd.__version__, parameters_to_json(parameters), on_end=self._recording_ended
            )
        self._engine = Engine(parameters, self._see, self._event_log)
        self._meter = Meter()
        self._transport: Transport | None = None
        self._stop = asyncio.Event()
        self._setpoints_made = 0
        self._known = False

    async def run(self, on_ready: Callable[[], None] | None = None) -> Summary:
        """Serve until `stop` or SIGINT, SIGTERM, SIGHUP; return the figures of the run.

        Raises
        ------
        LinkUrlError, LinkOpenError
            If the link is not understood or cannot be opened.
        """
        loop = asyncio.get_running_loop()
        link = self._parameters.link.autopilot
        try:
            self._transport = await open_transport(link, self._received)
        except BaseException:
            self._end_recording()
            raise
        handled = []
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            # Outside of the main thread the host has its own way to stop.
            with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
                loop.add_signal_handler(number, self.stop)
                handled.append(number)
        self._log.info("serving", link=link, mode=self._parameters.mode.value, version=swingd.__version__)
        if on_ready is not None:
            on_ready()
        # What was loaded at the start stays: the collector need not walk through it while a setpoint is due.
        gc.collect()
        gc.freeze()
        gc.set_threshold(GARBAGE_THRESHOLD)
        try:
            await self._tick_until_stopped()
        finally:
            for number in handled:
                loop.remove_signal_handler(number)
            await self._transport.close()
            self._end_recording()
            summary = self._meter.summary()
            drops = {drop.value: count for drop, count in self._engine.adapter.drops.items()}
            resets = {reason.name.lower(): count for reason, count in self._engine.pipeline.resets.items() if count}
            refusals = {name: count for name, count in self._engine.pipeline.refusals.items() if count}
            self._log.info("stopped", **_rounded(summary), drops=drops, refusals=refusals, resets=resets)
        return summary

    def stop(self) -> None:
        """End `run`."""
        self._stop.set()

    async def _tick_until_stopped(self) -> None:
        due_s = flush_s = time.monotonic()
        while not self._stop.is_set():
            now_s = time.monotonic()
            # After a stall the ticks that were missed are not made up.
            due_s = max(due_s + TICK_S, now_s)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), due_s - now_s if due_s > now_s else 0.0)
            now_s = time.monotonic()
            self._send(self._engine.tick(now_s))
            if self._event_log is not None and now_s - flush_s > LOG_FLUSH_S:
                flush_s = now_s
                self._event_log.flush()

    def _received(self, _peer: int, data: bytes) -> None:
        received_s = time.monotonic()
        self._setpoints_made = 0
        self._send(self._engine.receive(received_s, data))
        if self._setpoints_made:
            # A busy host finds several IMU frames waiting; each of them has its setpoint.
            latency_s = time.monotonic() - received_s
            for _ in range(self._setpoints_made):
                self._meter.setpoint(latency_s)
        if not self._known and self._engine.adapter.autopilot is not None:
            self._known = True
            autopilot = self._engine.adapter.autopilot
            self._log.info("autopilot found", system_id=autopilot.system_id, kind=autopilot.kind.value)

    def _send(self, frames: list[bytes]) -> None:
        transport = self._transport
        if transport is not None and frames:
            # One datagram for what belongs together: a system call costs more than a frame.
            transport.send(b"".join(frames))

    def _see(self, _t_mono_s: float, action: Action) -> None:
        if isinstance(action, SwingReport):
            self._meter.report(action)
        elif isinstance(action, Setpoint):
            self._setpoints_made += 1
        elif isinstance(action, StatusText):
            getattr(self._log, level_of(action.severity))(action.text)

    def _end_recording(self) -> None:
        if self._event_log is not None:
            self._event_log.close()

    def _recording_ended(self, reason: str) -> None:
        self._log.error("recording ended", reason=reason)


def _rounded(summary: Summary) -> dict[str, float | int | None]:
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(summary).items()}
