"""What an autopilot and the link to it give, measured before a flight and judged by the configuration."""

import asyncio
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from swingd.control.summary import curve_thrust_n, hover_throttle, hover_thrust_n
from swingd.link.adapter import AutopilotAdapter, AutopilotId
from swingd.link.clock import RemoteClock
from swingd.link.codec import Encoder, Frame
from swingd.link.preflight import ParameterReader, advise, carrier, parameters_of, voltage_compensated
from swingd.link.router import AUTOPILOT
from swingd.link.url import LOOPBACK, TcpIn, UdpIn, parse_url
from swingd.model.actions import ClockRequest, Health, Heartbeat, StreamRequest
from swingd.model.errors import LinkOpenError, LinkUrlError
from swingd.model.events import (
    Attitude,
    AutopilotKind,
    AutopilotRestart,
    AutopilotState,
    Battery,
    Event,
    Imu,
    Landed,
    LandedState,
    LocalPosition,
    Motors,
    Stream,
    StreamRefused,
    Throttle,
)
from swingd.model.parameters import Parameters, ThrustSource
from swingd.pipeline.health import RATE_SHARE, StreamWatch
from swingd.service.diagnosis import (
    AutopilotReport,
    ClockReport,
    Diagnosis,
    LinkReport,
    StreamReport,
    ThrustReport,
    judge_link,
    judge_silence,
    judge_streams,
    judge_thrust,
)
from swingd.service.links import Link, settings_of

TICK_S = 0.05
PARAMETERS_EXTRA_S = 6.0
"""How much longer the examination may last for parameters that are still being read."""
FAREWELL_S = 0.2
"""Left to the last frames to leave the computer."""

_HEARTBEAT_S = 1.0
_CLOCK_EVERY_S = 0.1
_VERSION_EVERY_S = 1.0
_VERSION_REQUESTS = 5
_NEIGHBOUR_S = 1.2
"""A running swingd shows itself by its HEARTBEAT within this time."""
_HOVER_SAMPLES = 20
_HOVER_CLIMB_MPS = 0.3
_SEQUENCE = 256


class Examination:
    """Listens and asks; frames and ticks in, messages out, no I/O.

    It says no more than HEARTBEAT, TIMESYNC, PARAM_REQUEST_READ, and the commands REQUEST_MESSAGE and
    SET_MESSAGE_INTERVAL, and never a setpoint; as a component other than swingd's, so that it may go through a running
    swingd.

    Parameters
    ----------
    parameters : Parameters
        What the daemon would run with.
    t_mono_s : float
        The host's monotonic clock at the beginning [s].
    """

    def __init__(self, parameters: Parameters, t_mono_s: float) -> None:
        link = parameters.link
        usual = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2
        self.component_id = usual if link.component_id != usual else mavlink.MAV_COMP_ID_ONBOARD_COMPUTER3
        self.parameters = parameters
        self.adapter = AutopilotAdapter(replace(link, component_id=self.component_id, rc_channel=0), parameters.thrust)
        self.found_s: float | None = None
        """When the autopilot was found; None before."""
        self._begun_s = t_mono_s
        self._t_mono_s = t_mono_s
        self._watch = StreamWatch(parameters)
        self._reader: ParameterReader | None = None
        self._clock = _Clocks()
        self._hover = _Hover()
        self._voltages_v: list[float] = []
        self._frames = 0
        self._by_message: Counter[int] = Counter()
        self._senders: set[tuple[int, int]] = set()
        self._autopilots: set[int] = set()
        self._sequence: int | None = None
        self._lost = 0
        self._signed = False
        self._running = False
        self._restarts = 0
        self._armed = False
        self._landed = LandedState.UNKNOWN
        self._remote_control: bool | None = None
        self._version: str | None = None
        self._version_requests = 0
        self._due_s = dict.fromkeys(("heartbeat", "clock", "version"), t_mono_s)
        self._asked: dict[Stream, list[int]] = {}

    @property
    def parameters_done(self) -> bool:
        """Whether nothing is left to be read."""
        return self._reader is None or self._reader.done

    # ---- in

    def receive(self, t_mono_s: float, frames: Sequence[Frame]) -> None:
        """Take frames that came from the autopilot's side; never raises."""
        self._t_mono_s = t_mono_s
        known = self.adapter.autopilot is not None
        events = self.adapter.take(t_mono_s, frames)
        autopilot = self.adapter.autopilot
        if autopilot is not None and not known:
            self.found_s = t_mono_s
            self._reader = ParameterReader(autopilot, parameters_of(autopilot.kind))
        for frame in frames:
            self._frames += 1
            self._senders.add((frame.system_id, frame.component_id))
            self._hear(t_mono_s, frame, autopilot)
        for event in events:
            self._take(event)

    def _hear(self, t_mono_s: float, frame: Frame, autopilot: AutopilotId | None) -> None:
        if frame.msg_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            message = frame.message
            own = frame.component_id == self.parameters.link.component_id
            if own and message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER:
                self._running = True
            elif message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
                self._autopilots.add(frame.system_id)
        if autopilot is None or not autopilot.is_sender_of(frame):
            return
        self._by_message[frame.msg_id] += 1
        self._signed |= frame.signed
        self._count_lost(frame)
        if frame.msg_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
            self._clock.answered(t_mono_s, frame.message)
        elif frame.msg_id == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self._version = _version(frame.message)
        elif frame.msg_id == mavlink.MAVLINK_MSG_ID_SYS_STATUS:
            message = frame.message
            healthy = message.onboard_control_sensors_present & message.onboard_control_sensors_health
            self._remote_control = bool(healthy & mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER)
        elif frame.msg_id in _PARAMETER_IDS and self._reader is not None:
            self._reader.take(frame.message)

    def _count_lost(self, frame: Frame) -> None:
        sequence = frame.raw[4] if frame.is_v2 else frame.raw[2]
        if self._sequence is not None:
            gap = (sequence - self._sequence - 1) % _SEQUENCE
            if gap >= _SEQUENCE // 2:
                return  # an old frame, late
            self._lost += gap
        self._sequence = sequence

    def _take(self, event: Event) -> None:
        stream = _STREAMS.get(type(event))
        if stream is not None:
            self._watch.arrived(stream, event.t_mono_s)
        match event:
            case Imu():
                self._clock.delivered(event.t_mono_s, event.t_boot_s)
            case AutopilotState():
                self._armed = event.armed
            case Landed():
                self._landed = event.state
            case Battery():
                self._voltages_v.append(event.voltage_v)
            case StreamRefused():
                self._watch.refused(event.stream, event.reason)
            case AutopilotRestart():
                self._restarts += 1
                self._watch.restarted()
                self._clock = _Clocks()
            case LocalPosition():
                self._hover.steady = abs(event.vel_ned_mps[2]) < _HOVER_CLIMB_MPS
            case Throttle() if self._flies:
                self._hover.throttle(event.throttle)
            case Motors() if self._flies and event.outputs:
                self._hover.motors(sum(event.outputs) / len(event.outputs))
            case _:
                pass

    @property
    def _flies(self) -> bool:
        return self._armed and self._landed is LandedState.IN_AIR

    # ---- out

    def tick(self, t_mono_s: float) -> list[Any]:
        """Let time pass; return the messages that are due, as pymavlink's."""
        self._t_mono_s = t_mono_s
        messages: list[Any] = []
        if self._is_due("heartbeat", _HEARTBEAT_S):
            messages += self.adapter.messages(Heartbeat(Health.INIT))
        autopilot = self.adapter.autopilot
        if autopilot is None or self.found_s is None or self._reader is None:
            return messages
        if self._is_due("clock", _CLOCK_EVERY_S):
            self._clock.asked(t_mono_s)
            messages += self.adapter.messages(ClockRequest(t_mono_s))
        asks_version = self._version is None and self._version_requests < _VERSION_REQUESTS
        if asks_version and self._is_due("version", _VERSION_EVERY_S):
            self._version_requests += 1
            messages.append(_command(autopilot, mavlink.MAV_CMD_REQUEST_MESSAGE, _VERSION_ID))
        messages += self._reader.tick(t_mono_s)
        if not self._running and t_mono_s - self.found_s >= _NEIGHBOUR_S:
            for action in self._watch.tick(t_mono_s, self._armed):
                if isinstance(action, StreamRequest):
                    requests = self.adapter.messages(action)
                    self._asked.setdefault(action.stream, []).extend(int(request.param1) for request in requests)
                    messages += requests
        return messages

    def farewell(self) -> list[Any]:
        """Return the messages that set the streams back to the autopilot's defaults.

        None where a running swingd was heard, which needs them, and none while armed: somebody may fly by them.
        """
        autopilot = self.adapter.autopilot
        if autopilot is None or self._running or self._armed:
            return []
        ids = sorted({msg_id for asked in self._asked.values() for msg_id in asked})
        return [_command(autopilot, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msg_id) for msg_id in ids]

    def _is_due(self, what: str, every_s: float) -> bool:
        if self._t_mono_s < self._due_s[what] - 1e-6:
            return False
        self._due_s[what] = self._t_mono_s + every_s
        return True

    # ---- judgement

    def diagnosis(self, bytes_in: int, garbage_bytes: int, refused_frames: int) -> Diagnosis:
        """Judge what was found so far.

        Parameters
        ----------
        bytes_in : int
            Received on the link.
        garbage_bytes : int
            Those among them that belong to no frame.
        refused_frames : int
            Frames that did not pass for want of a good signature.
        """
        parameters, autopilot = self.parameters, self.adapter.autopilot
        seconds = max(self._t_mono_s - self._begun_s, TICK_S)
        link = LinkReport(
            url=parameters.link.autopilot,
            seconds=seconds,
            bytes_in=bytes_in,
            bytes_per_s=bytes_in / seconds,
            frames=self._frames,
            frames_per_s=self._frames / seconds,
            autopilot_frames=sum(self._by_message.values()),
            lost_frames=self._lost,
            garbage_bytes=garbage_bytes,
            refused_frames=refused_frames,
            signed=self._signed,
            swingd_running=self._running,
            senders=tuple(f"{system}/{component}" for system, component in sorted(self._senders)),
            autopilots=tuple(sorted(self._autopilots)),
        )
        values = dict(sorted(self._reader.values.items())) if self._reader is not None else {}
        missing = tuple(sorted(self._reader.missing)) if self._reader is not None else ()
        clock, thrust = self._clock.report(), self._thrust(values)
        report: AutopilotReport | None = None
        streams: tuple[StreamReport, ...] = ()
        if autopilot is None:
            findings = [judge_silence(parameters, link)]
        else:
            report = AutopilotReport(
                autopilot.system_id,
                autopilot.kind,
                self._version,
                self._armed,
                self._flies,
                self._remote_control,
                self._restarts,
            )
            streams = tuple(self._stream(stream) for stream in _STREAMS.values())
            findings = [
                *judge_link(parameters, link, report, clock, values),
                *judge_streams(parameters, link, report, streams),
                *judge_thrust(parameters, thrust),
                *advise(
                    report.kind,
                    values,
                    parameters,
                    hover_throttle=thrust.expected_nominal,
                    remote_control=report.remote_control,
                    rates_hz={stream.stream: stream.asked_hz for stream in streams},
                ),
            ]
        return Diagnosis(
            mode=parameters.mode,
            link=link,
            autopilot=report,
            streams=streams,
            clock=clock,
            thrust=thrust,
            values=values,
            missing=missing,
            findings=tuple(sorted(findings, key=lambda finding: finding.severity)),
            streams_restored=bool(self.farewell()),
        )

    @property
    def _kind(self) -> AutopilotKind:
        return self.adapter.autopilot.kind if self.adapter.autopilot is not None else AutopilotKind.OTHER

    def _stream(self, stream: Stream) -> StreamReport:
        state = self._watch.state(stream, self._t_mono_s)
        candidates = [carrier(self._kind, stream), *self._asked.get(stream, [])]
        best = max(candidates, key=lambda msg_id: self._by_message[msg_id])
        message = str(mavlink.mavlink_map[best].msgname) if self._by_message[best] else ""
        if state.got_hz >= RATE_SHARE * state.asked_hz:
            verdict = "good"
        elif not self._armed and stream in (Stream.MOTORS, Stream.THROTTLE):
            verdict = "idle"
        elif state.got_hz > 0.0:
            verdict = "slow"
        else:
            verdict = "refused" if state.refused else "missing"
        return StreamReport(stream, message, state.asked_hz, state.got_hz, verdict, state.refused)

    def _thrust(self, values: dict[str, float]) -> ThrustReport:
        parameters, thrust = self.parameters, self.parameters.thrust
        good = [v for v in self._voltages_v if thrust.voltage_min_v <= v <= thrust.voltage_max_v]
        voltage_v = sum(good) / len(good) if good else (self._voltages_v[-1] if self._voltages_v else None)
        wants_motors = thrust.source in (ThrustSource.AUTO, ThrustSource.MOTORS)
        measured, source = self._hover.mean(wants_motors)
        # The throttle of an autopilot that compensates the voltage means the same at any voltage.
        sags = bool(good) and not (source is ThrustSource.THROTTLE and voltage_compensated(self._kind, values))
        curve_v = voltage_v if sags and voltage_v is not None else thrust.voltage_nominal_v
        weight_n = hover_thrust_n(parameters)
        scale = None
        if measured is not None:
            curve_n = curve_thrust_n(thrust, measured, curve_v)
            scale = weight_n / curve_n if curve_n > 0.0 else None
        return ThrustReport(
            weight_n=weight_n,
            voltage_nominal_v=thrust.voltage_nominal_v,
            voltage_v=voltage_v,
            expected_nominal=hover_throttle(parameters, thrust.voltage_nominal_v),
            expected_now=hover_throttle(parameters, curve_v),
            measured=measured,
            measured_source=source,
            scale=scale,
            autopilot_hover=values.get("MPC_THR_HOVER", values.get("MOT_THST_HOVER")),
        )


class _Clocks:
    """Round trips, the offset of the autopilot's clock, and how evenly samples arrive."""

    def __init__(self) -> None:
        self._asked = 0
        self._asked_ns: dict[int, float] = {}
        self._trips: list[tuple[float, float]] = []  # round trip and offset [s]
        self._remote = RemoteClock()
        self._delays_s: list[float] = []

    def asked(self, t_mono_s: float) -> None:
        self._asked += 1
        self._asked_ns[round(t_mono_s * 1e9)] = t_mono_s

    def answered(self, t_mono_s: float, message: Any) -> None:
        asked_s = self._asked_ns.pop(message.ts1, None) if message.tc1 != 0 else None
        if asked_s is not None:
            trip_s = t_mono_s - asked_s
            self._trips.append((trip_s, message.tc1 * 1e-9 - (asked_s + 0.5 * trip_s)))

    def delivered(self, t_mono_s: float, t_boot_s: float) -> None:
        self._remote.judge(t_mono_s, t_boot_s)
        if self._remote.offset_s is not None:
            self._delays_s.append(max(self._remote.offset_s - (t_boot_s - t_mono_s), 0.0))

    def report(self) -> ClockReport:
        trips = sorted(self._trips)
        quick = [offset_s for _, offset_s in trips[: max(len(trips) // 2, 1)]]
        return ClockReport(
            asked=self._asked,
            answered=len(trips),
            round_trip_p50_s=_quantile([trip_s for trip_s, _ in trips], 0.5),
            round_trip_p99_s=_quantile([trip_s for trip_s, _ in trips], 0.99),
            offset_s=trips[0][1] if trips else None,
            offset_spread_s=max(quick) - min(quick) if quick else None,
            delivery_p50_s=_quantile(self._delays_s, 0.5),
            delivery_p99_s=_quantile(self._delays_s, 0.99),
        )


class _Hover:
    """Throttle and motor outputs of a steady hover."""

    def __init__(self) -> None:
        self.steady = False
        """Whether the vehicle neither climbs nor sinks."""
        self._throttles: list[float] = []
        self._motors: list[float] = []

    def throttle(self, value: float) -> None:
        if self.steady:
            self._throttles.append(value)

    def motors(self, value: float) -> None:
        if self.steady:
            self._motors.append(value)

    def mean(self, wants_motors: bool) -> tuple[float | None, ThrustSource | None]:
        if wants_motors and len(self._motors) >= _HOVER_SAMPLES:
            return sum(self._motors) / len(self._motors), ThrustSource.MOTORS
        if len(self._throttles) >= _HOVER_SAMPLES:
            return sum(self._throttles) / len(self._throttles), ThrustSource.THROTTLE
        return None, None


async def examine(
    parameters: Parameters, seconds: float, on_progress: Callable[[float], None] = lambda _share: None
) -> Diagnosis:
    """Listen to the autopilot on the link that the daemon would use, ask it what is to be known, and judge.

    Parameters
    ----------
    parameters : Parameters
        ``link.autopilot`` is the link.
    seconds : float
        How long to listen for the autopilot, and again to it once it is found; reading its parameters over a slow link
        may take `PARAMETERS_EXTRA_S` more [s].
    on_progress : callable
        Gets the share of the time that has passed, 0..1.

    Raises
    ------
    LinkUrlError, ConfigurationError
        If the link or its key is not understood.
    LinkOpenError
        If the link cannot be opened, for example because a running swingd has its port.
    """
    begun_s = time.monotonic()
    examination = Examination(parameters, begun_s)
    encoder = Encoder(parameters.link.system_id or 1, examination.component_id)
    link = Link(
        settings_of(replace(parameters, endpoints=()))[0],
        lambda _port, frames: examination.receive(time.monotonic(), frames),
        lambda _port, _present: None,
        lambda _name, _state, _reason: None,
    )
    try:
        await link.open()
    except LinkOpenError as error:
        raise LinkOpenError(f"{error}; {_through_swingd(parameters)}") from error

    def say(messages: Sequence[Any]) -> None:
        if messages:
            autopilot = examination.adapter.autopilot
            encoder.system_id = autopilot.system_id if autopilot is not None else encoder.system_id
            link.send(AUTOPILOT, [encoder.encode(message) for message in messages])

    share = 0.0
    try:
        while True:
            now_s = time.monotonic()
            end_s = (begun_s if examination.found_s is None else examination.found_s) + seconds
            if now_s >= end_s and (examination.parameters_done or now_s >= end_s + PARAMETERS_EXTRA_S):
                break
            say(examination.tick(now_s))
            share = max(share, min((now_s - begun_s) / max(end_s - begun_s, TICK_S), 1.0))
            on_progress(share)
            await asyncio.sleep(TICK_S)
        framing, bytes_in = link.counters.framing, link.traffic[1]
        # What is half received at the end is no garbage; where no frame ever came, all of it is.
        garbage = framing.garbage_bytes if framing.frames else bytes_in
        return examination.diagnosis(bytes_in, garbage, link.counters.refused)
    finally:
        goodbye = examination.farewell()
        if goodbye:
            say(goodbye)
            await asyncio.sleep(FAREWELL_S)
        await link.close()


def _through_swingd(parameters: Parameters) -> str:
    """Say how to examine the autopilot while swingd runs."""
    ways = []
    for endpoint in parameters.endpoints:
        try:
            url = parse_url(endpoint.url, default_host=LOOPBACK)
        except LinkUrlError:
            continue
        if isinstance(url, UdpIn):
            ways.append(f"udpout://{LOOPBACK}:{url.port}")
        elif isinstance(url, TcpIn):
            ways.append(f"tcpout://{LOOPBACK}:{url.port}")
    if ways:
        return f"if swingd is running, go through its endpoint: --autopilot {ways[0]}"
    return (
        "if swingd is running, stop it, or give it an endpoint (--endpoint udpin://127.0.0.1:14541) and go through "
        "that: --autopilot udpout://127.0.0.1:14541"
    )


def _command(autopilot: AutopilotId, command: int, first: float) -> Any:
    return mavlink.MAVLink_command_long_message(
        autopilot.system_id, autopilot.component_id, command, 0, float(first), *(0.0 for _ in range(6))
    )


def _version(message: Any) -> str | None:
    version = message.flight_sw_version
    if not version:
        return None
    kind = version & 0xFF
    stage = next(
        (name for limit, name in ((64, "dev"), (128, "alpha"), (192, "beta"), (255, "rc")) if kind < limit), ""
    )
    return f"{version >> 24 & 0xFF}.{version >> 16 & 0xFF}.{version >> 8 & 0xFF}" + (f"-{stage}" if stage else "")


def _quantile(values: Sequence[float], share: float) -> float | None:
    if not values:
        return None
    ordered = sorted(values)
    return ordered[min(math.ceil(share * len(ordered)), len(ordered)) - 1] if share > 0.0 else ordered[0]


_VERSION_ID = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_PARAMETER_IDS = frozenset({mavlink.MAVLINK_MSG_ID_PARAM_VALUE, getattr(mavlink, "MAVLINK_MSG_ID_PARAM_ERROR", 345)})
_STREAMS: dict[type, Stream] = {
    Imu: Stream.IMU,
    Attitude: Stream.ATTITUDE,
    Throttle: Stream.THROTTLE,
    Motors: Stream.MOTORS,
    Battery: Stream.BATTERY,
    LocalPosition: Stream.LOCAL_POSITION,
    Landed: Stream.LANDED_STATE,
}
