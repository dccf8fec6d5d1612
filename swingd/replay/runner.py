"""Logs of any kind through the pipeline."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from swingd.engine import TICK_S, Delivery, Engine
from swingd.link.adapter import AutopilotAdapter, Drop
from swingd.link.camera_reader import shows_load
from swingd.link.codec import Framer
from swingd.link.router import AUTOPILOT
from swingd.model.actions import Action, StatusText, SwingReport
from swingd.model.errors import LogFormatError
from swingd.model.estimate import ResetReason
from swingd.model.events import Attitude, Battery, Event, Imu, LocalPosition, Motors, Throttle, Tick
from swingd.model.parameters import Camera, Parameters
from swingd.pipeline import Pipeline
from swingd.pipeline.payload_mass import MassEstimate
from swingd.pipeline.payload_state import PayloadState
from swingd.record.csv_log import read_csv_log
from swingd.record.event_log import MAGIC, EventLogReader, RecordKind
from swingd.record.tlog import TlogReader
from swingd.record.truth import SwingTruth
from swingd.record.ulog import read_ulog

_ULOG_MAGIC = b"ULog\x01\x12\x35"
_PROGRESS_EVERY = 500

Progress = Callable[[float], None]
"""Gets the share of the log that is done, 0..1."""


@dataclass(slots=True)
class Replay:
    """What came out of a log."""

    parameters: Parameters
    """Those of the pipeline at the start."""
    reports: list[SwingReport] = field(default_factory=list)
    texts: list[tuple[float, StatusText]] = field(default_factory=list)
    imu: list[Imu] = field(default_factory=list)
    """The inertial samples, for the baseline."""
    attitudes: list[Attitude] = field(default_factory=list)
    positions: list[LocalPosition] = field(default_factory=list)
    throttles: list[Throttle] = field(default_factory=list)
    motors: list[Motors] = field(default_factory=list)
    batteries: list[Battery] = field(default_factory=list)
    loads: list[tuple[float, PayloadState]] = field(default_factory=list)
    """What became of the load, and when [s, boot time]; the first as the flight was found."""
    weighing: MassEstimate | None = None
    """The last weighing that gave a mass, else why there was none; None where no load hung."""
    truth: SwingTruth | None = None
    """The true swing, where the log itself holds it."""
    drops: dict[Drop, int] = field(default_factory=dict)
    """What the adapter did not use, by reason."""
    resets: dict[ResetReason, int] = field(default_factory=dict)
    frames_sent: int = 0
    """Recordings only: frames that swingd sent in flight."""
    frames_differing: int = 0
    """Recordings only: those that the replay did not repeat byte for byte."""
    first_difference: str | None = None
    unread_bytes: int = 0
    """Bytes of a recording or a .tlog that are damaged or cut off."""

    def see(self, t_mono_s: float, action: Action) -> None:
        """Keep an action."""
        if isinstance(action, SwingReport):
            self.reports.append(action)
        elif isinstance(action, StatusText):
            self.texts.append((t_mono_s, action))

    def keep(self, event: Event) -> None:
        """Keep an event that the baseline or an identification needs."""
        if isinstance(event, Imu):
            self.imu.append(event)
        elif isinstance(event, Attitude):
            self.attitudes.append(event)
        elif isinstance(event, LocalPosition):
            self.positions.append(event)
        elif isinstance(event, Throttle):
            self.throttles.append(event)
        elif isinstance(event, Motors):
            self.motors.append(event)
        elif isinstance(event, Battery):
            self.batteries.append(event)

    def watch(self, pipeline: Pipeline) -> None:
        """Note what has become of the load."""
        state, mass = pipeline.payload, pipeline.payload_mass
        if self.reports and (not self.loads or self.loads[-1][1] is not state):
            self.loads.append((self.reports[-1].t_boot_s, state))
        known = self.weighing is not None and self.weighing.mass_kg is not None
        if state.hangs and (mass.mass_kg is not None or not known):
            self.weighing = mass

    @property
    def hanging(self) -> list[tuple[float, float]]:
        """Begin and end of each time in which a load hangs, as far as the pipeline knows [s, boot time]."""
        if not self.reports:
            return []
        ends_s = [t_s for t_s, _ in self.loads[1:]] + [self.reports[-1].t_boot_s]
        return [(t_s, end_s) for (t_s, state), end_s in zip(self.loads, ends_s, strict=True) if state.hangs]


def replay(
    path: Path,
    parameters: Parameters | None,
    decode_parameters: Callable[[str], Parameters],
    progress: Progress | None = None,
) -> Replay:
    """Run a log through the pipeline.

    Parameters
    ----------
    path : Path
        A recording of swingd, a .tlog, a .ulg or a CSV file; told apart by their content.
    parameters : Parameters or None
        None takes those of a recording, and the defaults for any other log.
    decode_parameters : callable
        Reads the parameters' text in a recording.
    progress : callable, optional
        Called now and then.

    Raises
    ------
    LogFormatError
        If the log cannot be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        raise LogFormatError(f"{path}: cannot be read: {error.strerror}") from error
    report = progress or (lambda _share: None)
    if head == MAGIC:
        return _replay_recording(path, parameters, decode_parameters, report)
    chosen = parameters or Parameters()
    result = Replay(chosen)
    if head[: len(_ULOG_MAGIC)] == _ULOG_MAGIC:
        events = list(read_ulog(path, chosen.thrust))
        pipeline = _run_events(result, chosen, events, len(events), report)
    elif path.suffix.lower() == ".tlog" or head[:1] == b"\x00":
        adapter = AutopilotAdapter(chosen.link, chosen.thrust)
        reader = TlogReader(path)
        total = max(sum(1 for _ in reader), 1)
        pipeline = _run_events(result, chosen, _tlog_events(reader, adapter, chosen.camera), total, report)
        result.drops = dict(adapter.drops)
        result.unread_bytes = reader.garbage_bytes + reader.truncated_bytes
    else:
        log = read_csv_log(path)
        result.truth = log.truth
        pipeline = _run_events(result, chosen, log.events, len(log.events), report)
    result.resets = {reason: count for reason, count in pipeline.resets.items() if count}
    if not result.imu:
        raise LogFormatError(f"{path}: no inertial samples in it; expected HIGHRES_IMU of an autopilot")
    return result


def _tlog_events(reader: TlogReader, adapter: AutopilotAdapter, camera: Camera) -> Iterator[Event]:
    """Events of a .tlog; the time of reception counts from the first frame, where doubles are fine."""
    begin_s: float | None = None
    latest_s = 0.0
    framer = Framer()
    for t_s, raw in reader:
        if begin_s is None:
            begin_s = t_s
        # The companion's wall clock may have been set during the flight; a monotonic clock does not go back.
        latest_s = max(latest_s, t_s - begin_s)
        frames = framer.receive(raw)
        for frame in frames:
            sighting = adapter.sighting(latest_s, frame) if shows_load(frame, camera, adapter.system_id) else None
            if sighting is not None:
                yield sighting
        yield from adapter.take(latest_s, frames)


def _run_events(
    result: Replay, parameters: Parameters, events: Iterable[Event], total: int, progress: Progress
) -> Pipeline:
    pipeline = Pipeline(parameters)
    tick_s: float | None = None
    for count, event in enumerate(events):
        now_s = event.t_mono_s
        if tick_s is None or now_s - tick_s > 100.0 * TICK_S:
            tick_s = now_s
        while tick_s <= now_s:
            for action in pipeline.step(Tick(tick_s)):
                result.see(tick_s, action)
            tick_s += TICK_S
        result.keep(event)
        for action in pipeline.step(event):
            result.see(now_s, action)
        result.watch(pipeline)
        if count % _PROGRESS_EVERY == 0:
            progress(min(count / total, 1.0))
    progress(1.0)
    return pipeline


def _replay_recording(
    path: Path, parameters: Parameters | None, decode_parameters: Callable[[str], Parameters], progress: Progress
) -> Replay:
    """Run the engine over its own inputs and compare what it sends with what it sent in flight.

    With other parameters than the recording's nothing is compared.
    """
    reader = EventLogReader(path)
    result = Replay(parameters or decode_parameters(reader.configuration))
    engine = Engine(result.parameters, result.see)
    framer = Framer()
    records = list(reader)
    result.unread_bytes = reader.tail_bytes
    answers: deque[Delivery] = deque()

    def note(deliveries: list[Delivery]) -> None:
        answers.extend(delivery for delivery in deliveries if engine.is_recorded(*delivery))

    for count, record in enumerate(records):
        t_s = record.t_mono_s
        match record.kind:
            case RecordKind.RECEIVED_AUTOPILOT | RecordKind.RECEIVED_APPLICATION:
                port = AUTOPILOT if record.kind is RecordKind.RECEIVED_AUTOPILOT else record.port
                note(engine.receive(t_s, port, framer.receive(record.frames)))
            case RecordKind.JOIN:
                engine.join(t_s)
            case RecordKind.PORT_OPENED:
                engine.open_port(t_s, record.port)
            case RecordKind.PORT_CLOSED:
                engine.close_port(t_s, record.port)
            case RecordKind.MESSAGE:
                for frame in framer.receive(record.frames):
                    note(engine.tell(t_s, frame.message))
            case RecordKind.TICK:
                note(engine.tick(t_s))
            case RecordKind.CORRECTION:
                note(engine.switch_correction(t_s, record.enabled))
            case RecordKind.PARAMETERS:
                if parameters is None:
                    note(engine.change_parameters(t_s, decode_parameters(record.text), record.text))
            case RecordKind.SENT_AUTOPILOT | RecordKind.SENT_APPLICATION:
                result.frames_sent += 1
                port = AUTOPILOT if record.kind is RecordKind.SENT_AUTOPILOT else record.port
                answer_port, answer = answers.popleft() if answers else (port, b"")
                if (answer_port, answer) != (port, record.frames):
                    result.frames_differing += 1
                    if result.first_difference is None:
                        result.first_difference = (
                            f"frame {result.frames_sent} at {t_s:.3f} s: sent {record.frames.hex()}, "
                            f"replayed {answer.hex() or 'nothing'}"
                        )
        if engine.has_joined:
            result.watch(engine.pipeline)
        if count % _PROGRESS_EVERY == 0:
            progress(count / len(records))
    result.frames_differing += len(answers)
    if parameters is not None:
        result.frames_sent = result.frames_differing = 0
        result.first_difference = None
    # The samples for the baseline: the same bytes through an adapter of their own.
    adapter = AutopilotAdapter(engine.parameters.link, engine.parameters.thrust)
    for record in records:
        if record.kind is RecordKind.RECEIVED_AUTOPILOT:
            for event in adapter.receive(record.t_mono_s, record.payload):
                result.keep(event)
    result.drops = dict(engine.adapter.drops)
    if engine.has_joined:
        result.resets = {reason: count for reason, count in engine.pipeline.resets.items() if count}
    progress(1.0)
    return result
