"""`swingd cooperate`: hears several vehicles and publishes the pose of the load that they carry, until told to stop.

What is heard on the vehicles' links goes to listeners and formation; what comes of it leaves for the outputs alone. The
vehicles get a heartbeat and questions (clock, origin, streams): an autopilot would take ODOMETRY for its own position.
"""

import asyncio
import contextlib
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

import swingd
from swingd.link import load_message
from swingd.link.codec import Encoder, Frame
from swingd.link.formation_listener import AUTOPILOT_COMPONENT, FormationListener
from swingd.link.router import endpoint_of, peer_of
from swingd.link.transport import TransportState
from swingd.link.url import LOOPBACK, parse_url
from swingd.model.actions import Health, Severity
from swingd.model.errors import ConfigurationError
from swingd.model.formation import FormationParameters, FormationReport
from swingd.pipeline.formation import Formation
from swingd.record.tlog import TlogWriter
from swingd.service.links import Link, LinkSettings
from swingd.service.logs import Log
from swingd.service.notify import Supervisor

COMPONENT = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
ASK_S = 0.1
HEARTBEAT_S = 1.0
ORIGIN_S = 5.0
TEXT_MAX = 50
"""Bytes of one STATUSTEXT."""

_LEVELS = {Health.DEGRADED: "warning", Health.FAULT: "error"}
_SEVERITIES = {Health.DEGRADED: Severity.WARNING, Health.FAULT: Severity.ERROR}


@dataclass(frozen=True, slots=True)
class CooperateSummary:
    """One run in figures."""

    duration_s: float
    ticks: int
    poses: int
    """ODOMETRY sent, once however many hear it."""
    health: str
    """At the end."""


class Cooperation:
    """Links, listeners and formation of one configuration.

    Parameters
    ----------
    parameters : FormationParameters
    record : Path, optional
        .tlog to write: all frames of the vehicles, and all that is sent to the outputs.
    log : Log, optional
    supervisor : Supervisor, optional
        The service manager that is told of readiness, health and progress.

    Raises
    ------
    LinkUrlError, ConfigurationError
        If a link is not understood, or the recording cannot be begun.
    """

    def __init__(
        self,
        parameters: FormationParameters,
        record: Path | None = None,
        log: Log | None = None,
        supervisor: Supervisor | None = None,
    ) -> None:
        self._parameters = parameters
        self._log = log or Log()
        self._supervisor = supervisor
        self._formation = Formation(parameters)
        self._listeners = [FormationListener(rig, parameters.stream_rate_hz) for rig in parameters.vehicles]
        urls = list(dict.fromkeys(str(parse_url(rig.link, LOOPBACK)) for rig in parameters.vehicles))
        self._vehicle_links = len(urls)
        self._vehicle_of = {
            (urls.index(str(parse_url(rig.link, LOOPBACK))), rig.system_id): place
            for place, rig in enumerate(parameters.vehicles)
        }
        names = [f"vehicles {url}" for url in urls] + [f"output {url}" for url in parameters.outputs]
        self._links = [
            Link(
                LinkSettings(name, parse_url(url, LOOPBACK), None, None, frozenset(), number),
                self._received,
                self._peer,
                self._link_changed,
            )
            for number, (name, url) in enumerate(zip(names, [*urls, *parameters.outputs], strict=True))
        ]
        self._encoders: dict[int, Encoder] = {}
        self._recorder = Encoder(parameters.system_id, COMPONENT)
        self._ways: dict[int, int] = {}
        self._others: Counter[int] = Counter()
        self._told: tuple[Health, str] | None = None
        self._ticks = self._poses = self._heard = 0
        self._stop = asyncio.Event()
        self._record: TlogWriter | None = None
        if record is not None:
            try:
                self._record = TlogWriter(record)
            except OSError as error:
                raise ConfigurationError(f"record: {record}: {error.strerror or error}; expected a file") from None

    async def run(self, on_ready: Callable[[], None] | None = None) -> CooperateSummary:
        """Serve until `stop`, SIGINT, SIGTERM or SIGHUP; return the figures of the run.

        Raises
        ------
        LinkOpenError
            If a link cannot be opened.
        """
        loop = asyncio.get_running_loop()
        begun_s = time.monotonic()
        handled: list[signal.Signals] = []
        try:
            for link in self._links:
                await link.open()
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
            await self._tick_until_stopped()
        finally:
            if self._supervisor is not None:
                self._supervisor.stopping()
            for number in handled:
                loop.remove_signal_handler(number)
            for link in self._links:
                await link.close()
            self._end_recording("")
            if self._supervisor is not None:
                self._supervisor.close()
        health = Health.INIT if self._told is None else self._told[0]
        summary = CooperateSummary(time.monotonic() - begun_s, self._ticks, self._poses, health.value)
        self._log.info(
            "stopped", duration_s=round(summary.duration_s, 1), poses=summary.poses, not_used=self._refusals()
        )
        self._log.close()
        return summary

    def stop(self) -> None:
        """End `run`."""
        self._stop.set()

    # ---- what comes

    def _received(self, port: int, frames: list[Frame]) -> None:
        now_s = time.monotonic()
        link = endpoint_of(port)
        for frame in frames:
            vehicle = self._vehicle_of.get((link, frame.system_id))
            if vehicle is None:
                # Ground stations on the same line, and whoever answers at an output.
                self._others[frame.system_id] += link < self._vehicle_links
                continue
            self._heard += 1
            if frame.component_id == AUTOPILOT_COMPONENT:
                self._ways[vehicle] = port
            self._write(frame.raw)
            for event in self._listeners[vehicle].receive(now_s, frame):
                self._formation.take(vehicle, event)

    def _peer(self, port: int, present: bool) -> None:
        if present:
            self._encoders[port] = Encoder(self._parameters.system_id, COMPONENT)
        else:
            self._encoders.pop(port, None)
            for vehicle in [vehicle for vehicle, way in self._ways.items() if way == port]:
                del self._ways[vehicle]

    def _link_changed(self, name: str, state: TransportState, reason: str) -> None:
        self._log.info("link", link=name, state=state.value, reason=reason)

    # ---- what leaves

    def _send(self, ports: Iterable[int], messages: Sequence[Any]) -> None:
        if not messages:
            return
        for port in list(ports):
            encoder = self._encoders.get(port)
            if encoder is not None:
                frames = [encoder.encode(message) for message in messages]
                self._links[endpoint_of(port)].send(peer_of(port), frames)

    def _publish(self, messages: Sequence[Any]) -> None:
        """Send to every output, and record once."""
        if self._record is not None:
            for message in messages:
                self._write(self._recorder.encode(message))
        self._send((port for port in self._encoders if endpoint_of(port) >= self._vehicle_links), messages)

    async def _tick_until_stopped(self) -> None:
        period_s = 1.0 / self._parameters.rate_hz
        due_s = asked_s = beaten_s = origin_s = time.monotonic()
        while not self._stop.is_set():
            now_s = time.monotonic()
            # After a stall the ticks that were missed are not made up.
            due_s = max(due_s + period_s, now_s)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), due_s - now_s)
            now_s = time.monotonic()
            report = self._formation.step(now_s)
            self._ticks += 1
            messages = [load_message.load_pose(report)]
            odometry = load_message.odometry(report)
            if odometry is not None:
                self._poses += 1
                messages.append(odometry)
            messages += self._note_health(report)
            if now_s >= beaten_s:
                beaten_s = now_s + HEARTBEAT_S
                beat = load_message.heartbeat(report.health)
                messages.append(beat)
                # A link that speaks first is only answered once it has spoken.
                self._send((port for port in self._encoders if endpoint_of(port) < self._vehicle_links), [beat])
            if report.origin is not None and now_s >= origin_s:
                origin_s = now_s + ORIGIN_S
                messages.append(load_message.global_origin(report.origin, now_s))
            self._publish(messages)
            if now_s >= asked_s:
                asked_s = now_s + ASK_S
                for vehicle, listener in enumerate(self._listeners):
                    if (way := self._ways.get(vehicle)) is not None:
                        self._send((way,), listener.messages(now_s))
            self._log.tick()
            if self._supervisor is not None:
                self._supervisor.status(f"{report.health.value} {report.reason}")
                self._supervisor.feed(now_s, self._heard, self._ticks)

    def _note_health(self, report: FormationReport) -> list[Any]:
        """Log a change of health or reason; return the text for who watches the outputs."""
        before, self._told = self._told, (report.health, report.reason)
        if before == self._told:
            return []
        ages = {
            rig.system_id: None if vehicle.age_s is None else round(vehicle.age_s, 3)
            for rig, vehicle in zip(self._parameters.vehicles, report.vehicles, strict=True)
        }
        self._log.write(
            _LEVELS.get(report.health, "info"), f"load pose {report.health.value}", reason=report.reason, ages_s=ages
        )
        if before is not None and before[0] is report.health:
            return []
        text = f"load pose {report.health.value} {report.reason}".strip().encode("ascii", "replace")[:TEXT_MAX]
        return [mavlink.MAVLink_statustext_message(_SEVERITIES.get(report.health, Severity.NOTICE), text)]

    # ---- log and record

    def _announce(self) -> None:
        self._log.open()
        parameters = self._parameters
        self._log.info(
            "serving",
            vehicles={rig.system_id: rig.link for rig in parameters.vehicles},
            outputs=list(parameters.outputs),
            system_id=parameters.system_id,
            frame="configured origins" if parameters.origins_are_configured else "first GPS_GLOBAL_ORIGIN heard",
            version=swingd.__version__,
        )
        if not parameters.outputs and self._record is None:
            self._log.warning("neither outputs nor a record: nobody learns of the pose")

    def _write(self, raw: bytes) -> None:
        if self._record is None:
            return
        try:
            self._record.write(time.time(), raw)
        except OSError as error:
            self._end_recording(error.strerror or str(error))

    def _end_recording(self, reason: str) -> None:
        record, self._record = self._record, None
        if record is None:
            return
        try:
            record.close()
        except OSError as error:
            reason = reason or error.strerror or str(error)
        if reason:
            self._log.error("the recording has ended", reason=reason)

    def _refusals(self) -> dict[str, dict[str, int]]:
        """Count what was not used: by system of a vehicle, of others by their ids, and what was no frame by link."""
        counts: dict[str, dict[str, int]] = {}
        for listener, told in zip(self._listeners, self._formation.refusals().values(), strict=True):
            of = Counter({drop.value: count for drop, count in listener.drops.items()}) + Counter(told)
            counts[f"system {listener.rig.system_id}"] = dict(of)
        counts["others"] = {f"system {system}": count for system, count in self._others.items() if count}
        for link in self._links:
            counts[link.settings.name] = {"garbage_bytes": link.counters.framing.garbage_bytes}
        return {name: {reason: n for reason, n in of.items() if n} for name, of in counts.items() if any(of.values())}
