"""The daemon: one engine between the autopilot and the endpoints, until it is told to stop.

Light: from the start of the process to the first forwarded frame neither the filter nor anything large is loaded. The
filter joins later, from a thread.
"""

import asyncio
import contextlib
import gc
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import swingd
from swingd.config.plain import parameters_to_json
from swingd.engine import TICK_S, Delivery, Engine
from swingd.link import host_message
from swingd.link.codec import Frame
from swingd.link.router import AUTOPILOT, endpoint_of, peer_of
from swingd.link.transport import TransportState
from swingd.link.url import SerialPort
from swingd.model.actions import Action, Setpoint, StatusText, SwingReport
from swingd.model.errors import LinkOpenError
from swingd.model.events import Stream
from swingd.model.ground_parameters import GroundParameter
from swingd.model.host import LinkKind
from swingd.model.parameters import Mode, Parameters
from swingd.record.event_log import EventLogWriter
from swingd.service.links import Link, settings_of
from swingd.service.logs import Log, level_of
from swingd.service.meter import Meter, Summary
from swingd.service.state import StateFile

if TYPE_CHECKING:
    # Only under systemd there is one.
    from swingd.service.notify import Supervisor

LOG_FLUSH_S = 1.0
HOST_STATUS_S = 1.0
ENDPOINT_RETRY_S = 3.0
BACKLOG_MAX_BYTES = 256
"""On the way to the autopilot: beyond it what is soon said again is left out, so that nothing waits for long."""
LOAD_AFTER_S = 0.5
"""The filter is loaded once the first frame has been forwarded, or after this time without any."""
GARBAGE_THRESHOLD = 50_000
"""Objects between two collections: the engine makes no cycles, and a setpoint should not wait for the collector."""


class Daemon:
    """Runs an engine on the links of its parameters.

    Parameters
    ----------
    parameters : Parameters
        As configured. ``link.autopilot`` and ``endpoints`` are the links.
    record : Path, optional
        Event log to write.
    state : StateFile, optional
        Keeps what ground stations set; without it that is forgotten at the end.
    log : Log, optional
        Where lines go.
    supervisor : Supervisor, optional
        The service manager that is told of readiness, health and progress.

    Raises
    ------
    LinkUrlError, ConfigurationError
        If a link or its key is not understood.
    EventLogError
        If the recording cannot be begun.
    """

    def __init__(
        self,
        parameters: Parameters,
        record: Path | None = None,
        state: StateFile | None = None,
        log: Log | None = None,
        supervisor: "Supervisor | None" = None,
    ) -> None:
        self._log = log or Log()
        self._supervisor = supervisor
        self._state = state
        if state is not None:
            parameters, notes = state.apply(parameters)
            for note in notes:
                self._log.write(level_of(note.severity), note.text)
        self._parameters = parameters
        links = settings_of(parameters)
        self._links = [Link(settings, self._received, self._port, self._link_changed) for settings in links]
        self._event_log: EventLogWriter | None = None
        if record is not None:
            self._event_log = EventLogWriter(
                record, swingd.__version__, parameters_to_json(parameters), on_end=self._recording_ended
            )
        signing = links[0].key is not None
        self._engine = Engine(parameters, self._see, self._event_log, signing, self._set, self._pass)
        self._meter = Meter()
        self._stop = asyncio.Event()
        self._forwarded = asyncio.Event()
        self._setpoints_made = 0
        self._known = False
        self._load_problem = ""
        self._unopened: set[str] = set()

    async def run(self, on_ready: Callable[[], None] | None = None) -> Summary:
        """Serve until `stop` or SIGINT, SIGTERM, SIGHUP; return the figures of the run.

        Raises
        ------
        LinkOpenError
            If the link to the autopilot cannot be opened; an endpoint is tried again until it can.
        """
        loop = asyncio.get_running_loop()
        handled = []
        tasks: list[asyncio.Task[None]] = []
        try:
            await self._links[0].open()
            retried = [task for link in self._links[1:] if (task := await self._open_endpoint(link)) is not None]
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                # Outside of the main thread the host has its own way to stop.
                with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
                    loop.add_signal_handler(number, self.stop)
                    handled.append(number)
            self._announce()
            if on_ready is not None:
                on_ready()
            if self._supervisor is not None:
                self._supervisor.ready()
            tasks = [*retried, asyncio.create_task(self._load()), asyncio.create_task(self._report_host())]
            await self._tick_until_stopped()
        finally:
            if self._supervisor is not None:
                self._supervisor.stopping()
            for number in handled:
                loop.remove_signal_handler(number)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            for link in self._links:
                await link.close()
            if self._event_log is not None:
                self._event_log.close()
            if self._state is not None:
                self._state.close()
            if self._supervisor is not None:
                self._supervisor.close()
        summary = self._meter.summary()
        self._log.info("stopped", **_rounded(summary), **self._refusals())
        self._log.open()
        return summary

    def stop(self) -> None:
        """End `run`."""
        self._stop.set()

    async def _open_endpoint(self, link: Link) -> "asyncio.Task[None] | None":
        """Open an endpoint; one that cannot be opened is tried again, because the others must not wait for it."""
        try:
            await link.open()
        except LinkOpenError as error:
            self._log.error(f"{error}; trying again", link=link.settings.name)
            self._unopened.add(link.settings.name)
            return asyncio.create_task(self._retry(link))
        return None

    async def _retry(self, link: Link) -> None:
        while True:
            await asyncio.sleep(ENDPOINT_RETRY_S)
            with contextlib.suppress(LinkOpenError):
                await link.open()
                self._unopened.discard(link.settings.name)
                return

    # ---- start

    def _announce(self) -> None:
        parameters = self._parameters
        endpoints = [endpoint.url for endpoint in parameters.endpoints]
        self._log.info(
            "serving",
            link=parameters.link.autopilot,
            endpoints=endpoints,
            mode=parameters.mode.value,
            version=swingd.__version__,
        )
        if parameters.mode is Mode.INLINE and not endpoints:
            self._log.warning("mode inline without an endpoint: no application can be corrected; see --endpoint")
        if parameters.mode is Mode.SHADOW and endpoints:
            self._log.info("mode shadow: setpoints of applications pass uncorrected; --set mode=inline corrects them")
        for link in self._links:
            if link.settings.exposed_key is not None:
                self._log.warning("others may read the signing key", file=str(link.settings.exposed_key))

    async def _load(self) -> None:
        """Load the filter in a thread, then let it join."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._forwarded.wait(), LOAD_AFTER_S)
        loop = asyncio.get_running_loop()
        loaded: asyncio.Future[str] = loop.create_future()

        def done(problem: str) -> None:
            if not loaded.done():
                loaded.set_result(problem)

        def load() -> None:
            problem = ""
            try:
                self._log.open()
                _import_filter(self._log)
            except Exception as error:  # whatever is wrong with the installation, forwarding goes on
                problem = f"{type(error).__name__}: {error}"
            with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(done, problem)

        # A daemon: a compilation must not keep the process from ending.
        threading.Thread(target=load, name="swingd-load", daemon=True).start()
        if problem := await loaded:
            self._load_problem = problem
            self._log.error("the filter cannot be loaded; everything passes uncorrected", reason=problem)
            return
        self._engine.join(time.monotonic())
        self._log.info("estimating")
        # What was loaded at the start stays: the collector need not walk through it while a setpoint is due.
        gc.freeze()
        gc.set_threshold(GARBAGE_THRESHOLD)

    # ---- while it runs

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
            if self._supervisor is not None:
                self._supervisor.status(self._status())
                self._supervisor.feed(now_s, self._engine.adapter.received[Stream.IMU], self._intervals())

    def _intervals(self) -> int | None:
        """Filter intervals taken so far; None where there is no pipeline yet and starting again would give none."""
        if self._engine.has_joined:
            return self._engine.pipeline.intervals
        # One that a fault has ended takes no more, and comes back by starting again.
        return None if self._engine.failure is None else 0

    def _status(self) -> str:
        """Say in one line how things are."""
        engine = self._engine
        if engine.failure is not None:
            state = f"fault: {engine.failure}; everything passes uncorrected"
        elif self._load_problem:
            state = f"the filter cannot be loaded: {self._load_problem}; everything passes uncorrected"
        elif not engine.has_joined:
            state = "loading the filter; everything passes uncorrected"
        else:
            pipeline = engine.pipeline
            state = f"{pipeline.health.value}: {pipeline.reason}" if pipeline.reason else pipeline.health.value
        unopened = "".join(f"; {name} cannot be opened" for name in sorted(self._unopened))
        return f"mode {engine.parameters.mode.value}, {state}{unopened}"

    async def _report_host(self) -> None:
        """Tell the state of this computer once a second."""
        await self._forwarded.wait()
        loop = asyncio.get_running_loop()
        from swingd.service.host_status import HostMeter, LinkBytes

        meter = await loop.run_in_executor(None, HostMeter)
        kinds = [
            LinkKind.SERIAL if isinstance(link.settings.url, SerialPort) else LinkKind.NETWORK for link in self._links
        ]
        while True:
            await asyncio.sleep(HOST_STATUS_S)
            traffic = [LinkBytes(kind, *link.traffic) for kind, link in zip(kinds, self._links, strict=True)]
            status = await loop.run_in_executor(None, meter.read, time.monotonic(), traffic)
            self._send(self._engine.tell(time.monotonic(), host_message.encode(status)))

    def _received(self, port: int, frames: list[Frame]) -> None:
        received_s = time.monotonic()
        self._setpoints_made = 0
        self._pass(self._engine.receive(received_s, port, frames))
        if self._setpoints_made:
            # A busy host finds several IMU frames waiting; each of them has its setpoint.
            latency_s = time.monotonic() - received_s
            for _ in range(self._setpoints_made):
                self._meter.setpoint(latency_s)
        if not self._known and self._engine.adapter.autopilot is not None:
            self._known = True
            autopilot = self._engine.adapter.autopilot
            self._log.info("autopilot found", system_id=autopilot.system_id, kind=autopilot.kind.value)

    def _pass(self, deliveries: list[Delivery]) -> None:
        self._send(deliveries)
        if deliveries and not self._forwarded.is_set():
            self._forwarded.set()

    def _send(self, deliveries: list[Delivery]) -> None:
        if not deliveries:
            return
        by_port: defaultdict[int, list[bytes]] = defaultdict(list)
        for port, frame in deliveries:
            by_port[port].append(frame)
        for port, frames in by_port.items():
            if port == AUTOPILOT:
                if self._links[0].backlog_bytes > BACKLOG_MAX_BYTES:
                    kept = [frame for frame in frames if not self._engine.is_repeated(frame)]
                    self._meter.left_out += len(frames) - len(kept)
                    frames = kept
                self._links[0].send(0, frames)
            else:
                self._links[endpoint_of(port) + 1].send(peer_of(port), frames)
                self._meter.forwarded += len(frames)

    def _port(self, port: int, present: bool) -> None:
        now_s = time.monotonic()
        if present:
            self._engine.open_port(now_s, port)
        else:
            self._engine.close_port(now_s, port)

    def _link_changed(self, name: str, state: TransportState, reason: str) -> None:
        level = "info" if state is TransportState.OPEN else "warning"
        self._log.write(level, f"link {state.value}", link=name, reason=reason)

    def _see(self, _t_mono_s: float, action: Action) -> None:
        if isinstance(action, SwingReport):
            self._meter.report(action)
        elif isinstance(action, Setpoint):
            self._setpoints_made += 1
        elif isinstance(action, StatusText):
            self._log.write(level_of(action.severity), action.text)

    def _set(self, parameters: Parameters, parameter: GroundParameter) -> None:
        if self._state is not None:
            self._state.store(parameters, parameter)

    def _refusals(self) -> dict[str, dict[str, int]]:
        """What was not used, by reason, empty ones left out."""
        engine = self._engine
        ports = {link.settings.name: link.counters.refused for link in self._links if link.counters.refused}
        counts = {
            "drops": {drop.value: count for drop, count in (engine.adapter.drops | engine.drops).items()},
            "routing": {refusal.value: count for refusal, count in engine.router.refusals.items()},
            "access": ports,
        }
        if engine.has_joined:
            counts["refusals"] = {name: count for name, count in engine.pipeline.refusals.items() if count}
            counts["resets"] = {reason.name.lower(): count for reason, count in engine.pipeline.resets.items() if count}
        return counts

    def _recording_ended(self, reason: str) -> None:
        self._log.error("recording ended", reason=reason)


def _import_filter(log: Log) -> None:
    """Load, and where this version has never run compile, what the pipeline needs."""
    from swingd.core._jit import is_compiled

    if not is_compiled():
        log.info("compiling the filter, once for this version: some twenty seconds")
        # In a process of its own: a compiler in this one would hold up what is forwarded.
        subprocess.run([sys.executable, "-c", "import swingd.pipeline"], check=False, stdin=subprocess.DEVNULL)
    import swingd.pipeline  # noqa: F401


def _rounded(summary: Summary) -> dict[str, float | int | None]:
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(summary).items()}
