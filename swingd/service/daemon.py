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
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import common as mavlink

import swingd
from swingd.config.plain import parameters_to_json
from swingd.engine import TICK_S, Delivery, Engine
from swingd.link import host_message
from swingd.link.codec import Frame
from swingd.link.router import AUTOPILOT, endpoint_of, peer_of
from swingd.link.transport import TransportState
from swingd.link.url import SerialPort
from swingd.model.actions import Action, Health, Setpoint, Severity, StatusText, SwingReport
from swingd.model.errors import LinkOpenError, SwingdError
from swingd.model.events import FlightMode, Stream
from swingd.model.ground_parameters import GroundParameter
from swingd.model.host import LinkKind
from swingd.model.parameters import Mode, Parameters
from swingd.record.event_log import EventLogWriter
from swingd.service.condition import Standing, condition, health_of, refusals
from swingd.service.links import Link, settings_of
from swingd.service.logs import Log, level_of
from swingd.service.meter import Meter, Summary
from swingd.service.state import StateFile
from swingd.service.status import StatusServer

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
HAND_BACK_SPARE_S = 0.5
"""Beyond the fade's own time: after it the end waits for no filter step any more."""
HAND_OVER_S = 0.15
"""After the fade: time for the application's own setpoint to pass once more."""
GARBAGE_THRESHOLD = 50_000
"""Objects between two collections: the engine makes no cycles, and a setpoint should not wait for the collector."""


_LEVELS = {Health.DEGRADED: "warning", Health.FAULT: "error"}
_FAREWELLS = {
    Mode.HOLD: "swingd ends: the autopilot's failsafe acts next",
    Mode.PATH: "swingd ends: the autopilot's failsafe acts next",
    Mode.INLINE: "swingd ends: nothing passes through it any more",
    Mode.SHADOW: "swingd ends: nothing passes through it any more",
}
"""What the pilot is told in flight; each in the 50 characters of one STATUSTEXT."""


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
    status : StatusServer, optional
        Where whoever asks is told how it is.
    reread : callable, optional
        Gives the parameters as they are configured now, or raises a `SwingdError`; called in a thread when SIGHUP asks
        for it. Without it SIGHUP ends the daemon like SIGTERM.

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
        status: StatusServer | None = None,
        reread: Callable[[], Parameters] | None = None,
    ) -> None:
        self._log = log or Log()
        self._status_server = status
        self._reread = reread
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
        self._begun_s = time.monotonic()
        self._standing = Standing(Health.INIT, "", self._begun_s)
        self._leaving = False
        self._told_stopping = False
        self._stop = asyncio.Event()
        self._reload_asked = asyncio.Event()
        self._forwarded = asyncio.Event()
        self._setpoints_made = 0
        self._known = False
        self._load_problem = ""
        self._unopened: set[str] = set()

    async def run(self, on_ready: Callable[[], None] | None = None) -> Summary:
        """Serve until `stop`, SIGINT or SIGTERM; return the figures of the run.

        Raises
        ------
        LinkOpenError
            If the link to the autopilot cannot be opened; an endpoint is tried again until it can.
        """
        loop = asyncio.get_running_loop()
        handled: list[int] = []
        tasks: list[asyncio.Task[None]] = []
        try:
            await self._links[0].open()
            retried = [task for link in self._links[1:] if (task := await self._open_endpoint(link)) is not None]
            handled = self._handle_signals(loop)
            self._announce()
            if on_ready is not None:
                on_ready()
            if self._supervisor is not None:
                self._supervisor.ready()
            self._open_status()
            works = (self._load(), self._report_host(), self._reload_when_asked())
            tasks = [*retried, *(asyncio.create_task(work) for work in works)]
            await self._tick_until_stopped()
        finally:
            self._tell_stopping()
            # From here on they do what they do by themselves: whoever is in a hurry need not wait for a slow disk.
            for number in handled:
                if number != signal.SIGHUP:
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
            if self._status_server is not None:
                self._status_server.close()
            if self._supervisor is not None:
                self._supervisor.close()
            if signal.SIGHUP in handled:
                loop.remove_signal_handler(signal.SIGHUP)
        summary = self._meter.summary()
        self._log.info("stopped", **_rounded(summary), **self._refusals())
        self._log.close()
        return summary

    def stop(self) -> None:
        """End `run`, once a correction has faded and its application commands alone; called again, at once."""
        if self._leaving:
            self._stop.set()
        self._leaving = True

    def _hang_up(self) -> None:
        """The terminal is gone; its shell and the kernel each may say so, which is no hurry."""
        self._leaving = True

    def reload(self) -> None:
        """Read the configuration again and take over what can change while it runs."""
        self._reload_asked.set()

    def _handle_signals(self, loop: asyncio.AbstractEventLoop) -> list[int]:
        """Take over the signals that end and reload; return which."""
        actions = {
            signal.SIGINT: self.stop,
            signal.SIGTERM: self.stop,
            signal.SIGHUP: self._hang_up if self._reread is None else self.reload,
        }
        if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
            # Started by nohup: whoever closes the terminal wants it to go on.
            del actions[signal.SIGHUP]
        handled: list[int] = []
        for number, action in actions.items():
            # Outside of the main thread the host has its own way to stop.
            with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
                loop.add_signal_handler(number, action)
                handled.append(number)
        return handled

    def _tell_stopping(self) -> None:
        if self._supervisor is not None and not self._told_stopping:
            self._told_stopping = True
            self._supervisor.stopping()

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

    def _open_status(self) -> None:
        """Answer who asks how it is; where that cannot be, it flies all the same."""
        if self._status_server is None:
            return
        try:
            others = self._status_server.open(self._condition)
        except OSError as error:
            self._log.warning(
                "nobody can ask for the status",
                socket=str(self._status_server.path),
                reason=error.strerror or str(error),
            )
            return
        if others:
            self._log.warning("another swingd runs with the same configuration", pids=list(others))

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
        leave_s: float | None = None
        fading = False
        while not self._stop.is_set():
            now_s = time.monotonic()
            # After a stall the ticks that were missed are not made up.
            due_s = max(due_s + TICK_S, now_s)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), due_s - now_s if due_s > now_s else 0.0)
            now_s = time.monotonic()
            self._send(self._engine.tick(now_s))
            self._note_health(now_s)
            self._log.tick()
            if self._event_log is not None and now_s - flush_s > LOG_FLUSH_S:
                flush_s = now_s
                self._event_log.flush()
            if self._supervisor is not None:
                if not self._leaving:
                    self._supervisor.status(self._status())
                self._supervisor.feed(now_s, self._engine.adapter.received[Stream.IMU], self._intervals())
            if self._leaving and leave_s is None:
                leave_s = self._hand_back(now_s)
                fading = self._is_correcting
            elif leave_s is not None and fading and not self._is_correcting:
                leave_s, fading = min(leave_s, now_s + HAND_OVER_S), False
            if leave_s is not None and now_s >= leave_s:
                return

    @property
    def _is_correcting(self) -> bool:
        return self._engine.has_joined and self._engine.pipeline.correcting

    def _hand_back(self, now_s: float) -> float:
        """Let the correction fade, so that whoever commanded commands alone; return when to leave at the latest [s]."""
        self._tell_stopping()
        engine = self._engine
        if not engine.has_joined:
            return now_s
        if engine.pipeline.armed and engine.pipeline.flight_mode is FlightMode.OFFBOARD:
            self._tell_pilot(now_s, _FAREWELLS[engine.parameters.mode])
        if not self._is_correcting:
            return now_s
        # Not the user's choice, and so nothing to be kept for the next start.
        state, self._state = self._state, None
        self._send(engine.switch_correction(now_s, False))
        self._state = state
        return now_s + engine.parameters.control.fade_out_s + HAND_BACK_SPARE_S

    def _tell_pilot(self, now_s: float, text: str) -> None:
        """Send a text of the host's own, of at most 50 characters."""
        self._send(self._engine.tell(now_s, mavlink.MAVLink_statustext_message(Severity.WARNING, text.encode())))

    def _note_health(self, now_s: float) -> None:
        """Log a change of the health or of its reason."""
        health, reason = health_of(self._engine, self._load_problem)
        before = self._standing
        if (health, reason) == (before.health, before.reason):
            return
        self._standing = Standing(health, reason, now_s)
        self._log.write(
            _LEVELS.get(health, "info"),
            f"swingd {health.value}",
            reason=reason,
            was=before.health.value,
            for_s=round(now_s - before.since_s, 2),
        )

    def _condition(self) -> dict[str, Any]:
        assert self._status_server is not None
        return condition(
            time.monotonic(),
            self._begun_s,
            self._status_server.configuration,
            self._standing,
            self._engine,
            self._links,
            self._meter,
            self._event_log,
        )

    # ---- configuration

    async def _reload_when_asked(self) -> None:
        while True:
            await self._reload_asked.wait()
            self._reload_asked.clear()
            if self._reread is not None:
                await self._reload(self._reread)

    async def _reload(self, reread: Callable[[], Parameters]) -> None:
        """Take over a configuration that was changed; the old one stays where the new one is wrong."""
        if self._supervisor is not None:
            self._supervisor.reloading()
        try:
            configured = await asyncio.get_running_loop().run_in_executor(None, reread)
        except SwingdError as error:
            self._log.error("the configuration is refused, the old one stays", reason=str(error))
            self._tell_pilot(time.monotonic(), "swingd: configuration refused, the old one stays")
        else:
            self._reconfigure(configured)
        if self._supervisor is not None:
            self._supervisor.ready()

    def _reconfigure(self, configured: Parameters) -> None:
        from swingd.service.reload import Change

        if self._state is not None:
            configured, notes = self._state.reconfigure(configured)
            for note in notes:
                self._log.write(level_of(note.severity), note.text)
        change = Change.between(self._engine.parameters, configured)
        if change.taken:
            text = parameters_to_json(change.parameters)
            self._send(self._engine.change_parameters(time.monotonic(), change.parameters, text))
        self._log.info("configuration read again", changed=list(change.taken))
        if change.waiting:
            self._log.warning("what changes only with a restart", keys=list(change.waiting))

    def _intervals(self) -> int | None:
        """Filter intervals taken so far; None where there is no pipeline yet and starting again would give none."""
        if self._engine.has_joined:
            return self._engine.pipeline.intervals
        # One that a fault has ended takes no more, and comes back by starting again.
        return None if self._engine.failure is None else 0

    def _status(self) -> str:
        """Say in one line how things are."""
        health, reason = health_of(self._engine, self._load_problem)
        state = f"{health.value}: {reason}" if reason else health.value
        unopened = "".join(f"; {name} cannot be opened" for name in sorted(self._unopened))
        return f"mode {self._engine.parameters.mode.value}, {state}{unopened}"

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
        elif isinstance(action, StatusText) and not self._is_health(action):
            self._log.write(level_of(action.severity), action.text)

    def _is_health(self, text: StatusText) -> bool:
        """Whether a text tells the health, which has a line of its own with its fields."""
        health, _ = health_of(self._engine)
        return text.severity > Severity.CRITICAL and text.text.startswith(f"swingd {health.value}")

    def _set(self, parameters: Parameters, parameter: GroundParameter) -> None:
        if self._state is not None:
            self._state.store(parameters, parameter)

    def _refusals(self) -> dict[str, dict[str, int]]:
        """What was not used, by reason, empty ones left out."""
        return {kind: counts for kind, counts in refusals(self._engine, self._links).items() if counts}

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
