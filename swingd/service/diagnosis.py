"""What an examination of autopilot and link reports, and how that is judged."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from swingd.link.preflight import Advice, AdviceSeverity, link_budget
from swingd.link.url import SerialPort, TcpIn, TcpOut, UdpIn, UdpOut, parse_url
from swingd.model.events import AutopilotKind, Stream
from swingd.model.parameters import Mode, Parameters, ThrustSource
from swingd.pipeline.health import LATE_S, RATE_SHARE, ROUND_TRIP_MAX_S

_LOST_SHARE = 0.02
_GARBAGE_SHARE = 0.05
_HOVER_THROTTLE_MAX = 0.8
_VOLTAGE_SPAN = 1.35
"""A battery is between its nominal voltage divided and multiplied by this, whatever its charge."""
_THRUST = (Stream.MOTORS, Stream.THROTTLE)
_USES = {
    Stream.IMU: "the filter lives on it",
    Stream.ATTITUDE: "the filter lives on it",
    Stream.THROTTLE: "thrust is then reconstructed from the acceleration, good near hover only",
    Stream.MOTORS: "thrust is then reconstructed from the acceleration, good near hover only",
    Stream.BATTERY: "the thrust curve needs the voltage",
    Stream.LOCAL_POSITION: "drag, altitude and setpoints in other frames need it",
    Stream.LANDED_STATE: "it tells when the load is lifted",
}


@dataclass(frozen=True, slots=True)
class LinkReport:
    """What came over the link."""

    url: str
    seconds: float
    """Time of listening since the first byte [s]."""
    bytes_in: int
    bytes_per_s: float
    frames: int
    frames_per_s: float
    autopilot_frames: int
    """Those of the autopilot itself."""
    lost_frames: int
    """Gaps in the autopilot's sequence numbers."""
    garbage_bytes: int
    """Bytes that belong to no frame."""
    refused_frames: int
    """Frames without the signature that the configured key demands."""
    signed: bool
    """Whether the autopilot signs what it sends."""
    swingd_running: bool
    """Whether a running swingd was heard on this link."""
    senders: tuple[str, ...]
    """Who speaks, as system/component."""
    autopilots: tuple[int, ...]
    """Systems whose HEARTBEAT is that of an autopilot."""


@dataclass(frozen=True, slots=True)
class AutopilotReport:
    """Who was heard."""

    system_id: int
    kind: AutopilotKind
    version: str | None
    """Of its firmware; None if it was not told."""
    armed: bool
    in_air: bool
    remote_control: bool | None
    """Whether it hears a remote control; None if it does not say."""
    restarts: int
    """How often its clock jumped while it was examined."""


@dataclass(frozen=True, slots=True)
class StreamReport:
    """One stream that swingd uses."""

    stream: Stream
    message: str
    """What carries it; empty if nothing came."""
    asked_hz: float
    got_hz: float
    verdict: str
    """good, slow, missing, refused, or idle: comes with arming."""
    refused: str | None
    """Why the autopilot denied it."""


@dataclass(frozen=True, slots=True)
class ClockReport:
    """How long the link takes, and how the clocks stand to each other."""

    asked: int
    answered: int
    round_trip_p50_s: float | None
    round_trip_p99_s: float | None
    offset_s: float | None
    """Autopilot's clock minus this computer's monotonic one [s]."""
    offset_spread_s: float | None
    """Of the offset over the quicker half of the round trips [s]."""
    delivery_p50_s: float | None
    delivery_p99_s: float | None
    """How much later than the quickest ones IMU samples arrive [s]."""


@dataclass(frozen=True, slots=True)
class ThrustReport:
    """Where the configured curve expects hover, and where it is."""

    weight_n: float
    voltage_nominal_v: float
    voltage_v: float | None
    """Measured; None without a reading."""
    expected_nominal: float | None
    """Output or throttle of hover at nominal voltage, 0..1; None if full throttle is not enough."""
    expected_now: float | None
    """The same at the measured voltage."""
    measured: float | None
    """Mean in a steady hover; None on the ground."""
    measured_source: ThrustSource | None
    """Whether ``measured`` are motor outputs or the throttle."""
    scale: float | None
    """Weight over the curve's thrust at ``measured``."""
    autopilot_hover: float | None
    """The autopilot's own parameter."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Everything that an examination found."""

    mode: Mode
    link: LinkReport
    autopilot: AutopilotReport | None
    streams: tuple[StreamReport, ...]
    clock: ClockReport
    thrust: ThrustReport
    values: dict[str, float]
    """The autopilot's parameters that were read."""
    missing: tuple[str, ...]
    """Those that it did not tell."""
    findings: tuple[Advice, ...]
    """The most severe first."""
    streams_restored: bool
    """Whether the streams that were asked for were set back to their defaults."""

    @property
    def ready(self) -> bool:
        """Whether nothing speaks against a flight."""
        return not any(finding.severity is AdviceSeverity.DANGER for finding in self.findings)


def judge_silence(parameters: Parameters, link: LinkReport) -> Advice:
    """Say why no autopilot was found."""
    wanted = parameters.link.system_id
    if link.autopilots and wanted not in (0, *link.autopilots):
        return Advice(
            AdviceSeverity.DANGER,
            "autopilot",
            f"heard: system {', '.join(map(str, link.autopilots))}",
            f"the configuration serves system {wanted} only",
            f"link.system_id = {link.autopilots[0]}, or 0 for the first one heard",
        )
    if link.frames:
        return Advice(
            AdviceSeverity.DANGER,
            "autopilot",
            f"heard: {', '.join(link.senders)}",
            "there is MAVLink on the link, but no HEARTBEAT of an autopilot (component 1)",
            "does the router or radio in between forward the autopilot's frames to this computer?",
        )
    if link.refused_frames:
        return _wrong_key(link)
    if link.bytes_in:
        return Advice(
            AdviceSeverity.DANGER,
            "link",
            f"{link.bytes_in} bytes",
            "something speaks, but it is not MAVLink",
            "on a serial line the baud rates of both ends differ, or the port is set up for something else",
        )
    return Advice(AdviceSeverity.DANGER, "link", "silent", f"nothing came over {link.url}", _what_to_check(link.url))


def judge_link(
    parameters: Parameters,
    link: LinkReport,
    autopilot: AutopilotReport,
    clock: ClockReport,
    values: Mapping[str, float],
) -> Iterable[Advice]:
    """Judge everything about the link but the streams."""
    if autopilot.kind is AutopilotKind.OTHER:
        yield Advice(
            AdviceSeverity.WARNING,
            "autopilot",
            "neither PX4 nor ArduPilot",
            "swingd knows neither its modes nor its parameters: it can estimate, not correct",
            "use PX4 or ArduPilot Copter",
        )
    if autopilot.restarts:
        yield Advice(
            AdviceSeverity.WARNING,
            "clock",
            f"{autopilot.restarts} jumps",
            "the autopilot's clock jumped: it restarted, or two autopilots share a system id",
            "run swingd doctor again; if it stays, look for a second sender",
        )
    yield from _judge_signing(parameters, link)
    yield from _judge_losses(link)
    yield from _judge_latency(parameters, clock)
    if not values and autopilot.kind is not AutopilotKind.OTHER:
        yield Advice(
            AdviceSeverity.WARNING,
            "parameters",
            "none read",
            "the autopilot's failsafes and gains could not be checked",
            "check the way to the autopilot, and run swingd doctor again",
        )
    if link.swingd_running:
        yield Advice(
            AdviceSeverity.HINT,
            "streams",
            "as swingd asked",
            "a running swingd was heard on this link: its streams were measured, none were asked for",
            "nothing",
        )
    elif autopilot.armed:
        yield Advice(
            AdviceSeverity.HINT,
            "streams",
            "left raised",
            "the vehicle is armed: somebody may fly by these streams, so they are not set back",
            "nothing; a restart of the autopilot sets them back",
        )


def _judge_signing(parameters: Parameters, link: LinkReport) -> Iterable[Advice]:
    has_key = parameters.link.key_file != "none"
    if link.signed and not has_key:
        yield Advice(
            AdviceSeverity.DANGER,
            "signing",
            "demanded",
            "the autopilot signs, so it refuses what is not signed: no request and no setpoint of swingd's will pass",
            "link.key_file = the file with the autopilot's key",
        )
    if has_key and link.refused_frames > link.frames:
        yield _wrong_key(link)


def _wrong_key(link: LinkReport) -> Advice:
    return Advice(
        AdviceSeverity.DANGER,
        "signing",
        f"{link.refused_frames} frames refused",
        "the autopilot does not sign, or signs with another key than that of link.key_file",
        "set the same key on both ends, or link.key_file = none",
    )


def _judge_losses(link: LinkReport) -> Iterable[Advice]:
    sent = link.autopilot_frames + link.lost_frames
    if link.lost_frames > _LOST_SHARE * sent:
        yield Advice(
            AdviceSeverity.WARNING,
            "link",
            f"{link.lost_frames / sent:.0%} of the frames lost",
            "gaps in the IMU's samples make the estimate worse",
            "a faster baud rate with hardware flow control, fewer streams, a better cable or radio; behind a router "
            "frames addressed to others count as lost here",
        )
    if link.garbage_bytes > _GARBAGE_SHARE * link.bytes_in:
        yield Advice(
            AdviceSeverity.WARNING,
            "link",
            f"{link.garbage_bytes} bytes of garbage",
            "part of what arrives is no MAVLink: bytes are changed or lost on the way",
            "check ground wire, cable length and baud rate of a serial line",
        )


def _judge_latency(parameters: Parameters, clock: ClockReport) -> Iterable[Advice]:
    if clock.round_trip_p50_s is None:
        yield Advice(
            AdviceSeverity.WARNING,
            "latency",
            "not known",
            "the autopilot answers no TIMESYNC: a slow link would not be noticed, or nothing that this computer sends "
            "arrives",
            "check the way to the autopilot (TX of this computer to RX of the autopilot)",
        )
    elif clock.round_trip_p50_s > ROUND_TRIP_MAX_S:
        yield Advice(
            AdviceSeverity.WARNING if parameters.mode is Mode.SHADOW else AdviceSeverity.DANGER,
            "latency",
            f"{1e3 * clock.round_trip_p50_s:.0f} ms there and back",
            f"beyond {1e3 * ROUND_TRIP_MAX_S:.0f} ms a correction would come too late: swingd gives none",
            "a direct serial line or network instead of a radio",
        )


def judge_streams(
    parameters: Parameters, link: LinkReport, autopilot: AutopilotReport, streams: Iterable[StreamReport]
) -> Iterable[Advice]:
    """Judge what arrives of the streams that swingd uses."""
    streams = tuple(streams)
    needed_hz = {Stream.IMU: RATE_SHARE * parameters.estimator.rate_hz, Stream.ATTITUDE: 2.0 / LATE_S}
    budget = link_budget(autopilot.kind, {stream.stream: stream.asked_hz for stream in streams})
    line = f" ({budget.baud} baud on a serial line)" if budget.baud else ""
    more = "; PX4: MAV_n_MODE = 2 (Onboard), MAV_n_RATE" if autopilot.kind is AutopilotKind.PX4 else ""
    has_thrust = any(stream.stream in _THRUST and stream.verdict == "good" for stream in streams)
    for stream in streams:
        if stream.verdict in ("good", "idle") or (stream.stream in _THRUST and has_thrust):
            continue
        if stream.refused:
            why = f"the autopilot refused it ({stream.refused})"
        elif link.swingd_running:
            why = "the running swingd does not get more either"
        else:
            why = "the link or the autopilot gives no more"
        yield Advice(
            AdviceSeverity.DANGER if stream.got_hz < needed_hz.get(stream.stream, 0.0) else AdviceSeverity.WARNING,
            stream.stream.value,
            f"asked {stream.asked_hz:.4g} Hz, got {stream.got_hz:.4g} Hz",
            f"{_USES[stream.stream]}; {why}",
            f"all streams together need {budget.needed_bytes_per_s:.0f} bytes/s{line}{more}",
        )


def judge_thrust(parameters: Parameters, report: ThrustReport) -> Iterable[Advice]:
    """Judge hover and battery."""
    thrust = parameters.thrust
    nominal_v, voltage_v = report.voltage_nominal_v, report.voltage_v
    if report.expected_nominal is None:
        yield Advice(
            AdviceSeverity.DANGER,
            "hover",
            "not possible",
            f"by the configured thrust curve full throttle does not carry {report.weight_n:.1f} N",
            "check masses and thrust curve, or take a lighter load",
        )
    elif report.expected_now is None or report.expected_now > _HOVER_THROTTLE_MAX:
        now = "more than 100 %" if report.expected_now is None else f"{report.expected_now:.0%}"
        yield Advice(
            AdviceSeverity.WARNING,
            "hover",
            f"{now} at {voltage_v or nominal_v:.1f} V",
            "little is left for climbing and for the correction",
            "a lighter load or a fresh battery",
        )
    if voltage_v is not None and not thrust.voltage_min_v <= voltage_v <= thrust.voltage_max_v:
        yield Advice(
            AdviceSeverity.DANGER,
            "battery",
            f"{voltage_v:.2f} V",
            f"outside of {thrust.voltage_min_v:g} .. {thrust.voltage_max_v:g} V: swingd refuses the readings and takes "
            "the nominal voltage",
            "set thrust.voltage_min_v and thrust.voltage_max_v, or the autopilot's battery monitor",
        )
    elif voltage_v is not None and not nominal_v / _VOLTAGE_SPAN <= voltage_v <= nominal_v * _VOLTAGE_SPAN:
        yield Advice(
            AdviceSeverity.WARNING,
            "battery",
            f"{voltage_v:.2f} V",
            f"far from the {nominal_v:g} V at which the thrust curve was measured: another number of cells?",
            "measure the thrust curve with this battery; set thrust.voltage_nominal_v",
        )
    if report.scale is not None and abs(report.scale - 1.0) > thrust.scale_range:
        yield Advice(
            AdviceSeverity.WARNING,
            "thrust",
            f"scale {report.scale:.2f} in hover",
            f"the calibration reaches 1 +- {thrust.scale_range:g}: either the load does not hang, or masses or thrust "
            "curve are wrong",
            "check vehicle.mass_kg and payload.mass_kg; measure the thrust curve",
        )


def _what_to_check(text: str) -> str:
    match parse_url(text):
        case UdpIn(port=port):
            return (
                f"does the autopilot, or the router in between, send to UDP port {port} of this computer? PX4's "
                "simulator sends to 14540; a firewall may be in the way"
            )
        case UdpOut(host=host, port=port):
            return f"does anybody listen on UDP port {port} of {host}, and may it answer?"
        case TcpIn(port=port):
            return f"nobody connected to TCP port {port}, or who did sent nothing"
        case TcpOut(host=host, port=port):
            return f"does anybody accept connections on TCP port {port} of {host}, and send?"
        case SerialPort(device=device, baud=baud):
            return (
                f"is the autopilot on and wired to {device} (TX to RX, RX to TX, ground)? PX4: MAV_n_CONFIG on that "
                f"port and SER_..._BAUD {baud}; ArduPilot: SERIALn_PROTOCOL 2 and SERIALn_BAUD"
            )
