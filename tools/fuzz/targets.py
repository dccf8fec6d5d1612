"""Everything that reads what others wrote, each behind one function of bytes: what the fuzzer and the tests feed.

A check takes any bytes and returns; it raises only where swingd does what it must never do. Bytes from a link give
events or counted refusals, a file or a text gives what it says or the error that names what is wrong with it.
"""

import copy
import copyreg
import math
import os
import struct
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from swingd.config.loader import load_source, parameters_from_json
from swingd.config.plain import parameters_to_json
from swingd.config.source import Source
from swingd.engine import Engine
from swingd.link.codec import Codec, Framer, checksum
from swingd.link.router import AUTOPILOT, port_of
from swingd.model.errors import ConfigurationError, LogFormatError, SwingdError
from swingd.model.parameters import Mode, Parameters, Thrust, Waypoint
from swingd.record.csv_log import read_csv_log
from swingd.record.event_log import EventLogReader, RecordKind
from swingd.record.tlog import TlogReader
from swingd.record.truth import read_truth
from swingd.record.ulog import read_ulog
from swingd.sim.console import Console
from swingd.sim.faults import parse_fault
from swingd.sim.lockstep import EngineCompanion, Lockstep
from swingd.sim.peer import SimulatedAutopilot
from swingd.sim.plant import Plant

from . import seeds

# pymavlink's encoders hold compiled structs, which cannot be copied by themselves.
copyreg.pickle(struct.Struct, lambda compiled: (struct.Struct, (compiled.format,)))  # type: ignore[arg-type]

DIALECT = tuple(sorted(mavlink.mavlink_map))
TELEMETRY = tuple(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in (
        *("HEARTBEAT", "HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET"),
        *(
            "VFR_HUD",
            "SERVO_OUTPUT_RAW",
            "ACTUATOR_OUTPUT_STATUS",
            "BATTERY_STATUS",
            "SYS_STATUS",
            "EXTENDED_SYS_STATE",
        ),
        *("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SYSTEM_TIME", "TIMESYNC", "COMMAND_ACK", "HOME_POSITION"),
        *(
            "SET_POSITION_TARGET_LOCAL_NED",
            "SET_POSITION_TARGET_GLOBAL_INT",
            "PARAM_VALUE",
            "RC_CHANNELS",
            "STATUSTEXT",
            "LANDING_TARGET",
        ),
    )
)
"""What the adapter and the engine look into."""
QUESTIONS = tuple(
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET", "COMMAND_LONG", "COMMAND_INT")
)
FLIGHT_S = 16.0
PORTS = 8
SENDERS = ((1, 1), (1, 191), (255, 190), (2, 1))
"""The autopilot, swingd itself, a ground station, another vehicle."""


@dataclass(frozen=True, slots=True)
class Target:
    """One thing to be fuzzed."""

    text: str
    check: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    """Where the fuzzer begins."""


def _must_tell(error: SwingdError) -> None:
    assert str(error)


# ---------------------------------------------------------------------------------------------------------------- link


def check_codec(data: bytes) -> None:
    """Whole or cut at any place, the same frames; each keeps its bytes, has a message or none, and is written again."""
    cut = data[0] if data else 0
    whole, pieces = Framer(), Framer()
    frames = whole.receive(data)
    again = [frame for part in (data[:cut], data[cut:]) for frame in pieces.receive(part)]
    assert [frame.raw for frame in frames] == [frame.raw for frame in again]
    assert sum(len(frame.raw) for frame in frames) + whole.counters.garbage_bytes <= len(data)
    codec = Codec(1, 191)
    for frame in frames:
        message = frame.message
        if message is not None:
            (copied,) = Framer().receive(codec.encode(message))
            assert copied.msg_id == frame.msg_id


@cache
def _engines() -> tuple[Engine, Engine, Engine]:
    """One that has just joined, one in line on a vehicle that hovers, and one that leads a load; only to be copied."""
    inline = replace(Parameters(mode=Mode.INLINE), simulation=replace(Parameters().simulation, seed=3))
    led = replace(
        inline,
        mode=Mode.PATH,
        waypoints=(Waypoint(20.0), Waypoint(20.0, 20.0)),
        estimator=replace(inline.estimator, name="gp-ekf"),
        camera=replace(inline.camera, source="landing_target"),
        simulation=replace(inline.simulation, camera_hz=15.0),
    )
    fresh = Engine(inline)
    fresh.join(0.0)
    return fresh, _flown(inline), _flown(led)


def _flown(parameters: Parameters) -> Engine:
    """Fly until `FLIGHT_S`, the last seconds in OFFBOARD."""
    flying = Engine(parameters)
    flying.join(0.0)
    peer = SimulatedAutopilot(parameters)
    pilot = Codec(255, 190)

    def command(number: int, *params: float) -> None:
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        peer.receive(pilot.encode(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)))

    flight = Lockstep(peer, EngineCompanion(flying))
    flight.run_until(2.0)
    command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, *(math.nan for _ in range(4)))
    command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    flight.run_until(FLIGHT_S - 2.0)
    command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
    flight.run_until(FLIGHT_S)
    return flying


def _frame(system: int, component: int, msg_id: int, payload: bytes) -> bytes:
    """A MAVLink 2 frame with the right checksum, whatever its payload says."""
    body = bytes((0xFD, len(payload), 0, 0, 0, system, component)) + msg_id.to_bytes(3, "little") + payload
    known = mavlink.mavlink_map.get(msg_id)
    return body + checksum(body, known.crc_extra if known else 0)


def _steps(data: bytes, ids: tuple[int, ...]) -> Iterator[tuple[str, int, bytes]]:
    """Read bytes as what happens: what (``tick``, ``open``, ``close``, ``bytes``), a number, and frames or noise."""
    at = 0

    def take(count: int) -> bytes:
        nonlocal at
        taken = data[at : at + count]
        at += count
        return taken.ljust(count, b"\0")

    while at < len(data):
        what, number = take(2)
        port = number % (PORTS + 1)
        match what % 8:
            case 0:
                yield "tick", number, b""
            case 1:
                yield ("open" if number & 1 else "close"), number >> 1, b""
            case 2:
                yield "bytes", port, take(take(1)[0])
            case _:
                who, which, size = take(3)
                system, component = SENDERS[who % 4] if who < 192 else (who, which)
                msg_id = ids[which % len(ids)] if what < 248 else int.from_bytes(take(3), "little")
                yield "bytes", port, _frame(system, component, msg_id, take(size))


def check_engine(data: bytes, ids: tuple[int, ...]) -> None:
    """No fault inside, and whatever leaves under swingd's name is whole and finite."""
    engine = copy.deepcopy(_engines()[data[0] % 3 if data else 0])
    framers = [Framer() for _ in range(PORTS + 1)]
    t_s = FLIGHT_S
    given: set[bytes] = set()
    out: list[tuple[int, bytes]] = []
    for what, number, content in _steps(data[1:], ids):
        t_s += 0.001
        match what:
            case "tick":
                t_s += number / 100.0
                out += engine.tick(t_s)
            case "open":
                engine.open_port(t_s, port_of(1, number % PORTS))
            case "close":
                engine.close_port(t_s, port_of(1, number % PORTS))
            case _:
                port = AUTOPILOT if number == PORTS else port_of(1, number)
                if port != AUTOPILOT:
                    engine.open_port(t_s, port)
                frames = framers[number].receive(content)
                given |= {frame.raw for frame in frames}
                out += engine.receive(t_s, port, frames)
    out += engine.tick(t_s + 1.0)
    assert engine.failure is None, engine.failure
    for _, raw in out:
        frames = Framer().receive(raw)
        assert b"".join(frame.raw for frame in frames) == raw
        for frame in frames:
            # What passes is not swingd's to judge, whoever it claims to be from.
            if frame.raw not in given and frame.msg_id == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
                _check_setpoint(frame.message)


def _check_setpoint(message: mavlink.MAVLink_message) -> None:
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", None, "yaw", "yaw_rate")
    for bit, name in enumerate(names):
        if name is not None and not message.type_mask >> bit & 1:
            assert math.isfinite(getattr(message, name)), (name, message)


def check_adapter(data: bytes) -> None:
    """What the adapter and the pipeline look into, any values."""
    check_engine(data, TELEMETRY)


def check_router(data: bytes) -> None:
    """Every message of the dialect, and ids that it does not know."""
    check_engine(data, DIALECT)


def check_parameter_server(data: bytes) -> None:
    """Parameters and commands: any names, types and values."""
    check_engine(data, QUESTIONS)


# ---------------------------------------------------------------------------------------------------------------- logs


def _read(data: bytes, suffix: str, read: Callable[[Path], object]) -> None:
    """Read bytes as a file; the only error is the one that tells the user."""
    folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.NamedTemporaryFile(suffix=suffix, dir=folder) as file:
        file.write(data)
        file.flush()
        try:
            read(Path(file.name))
        except LogFormatError as error:
            _must_tell(error)


def check_csv_log(data: bytes) -> None:
    """Any of the known tables."""
    _read(data, ".csv", read_csv_log)


def check_truth(data: bytes) -> None:
    """The true swing of a flight."""
    _read(data, ".csv", read_truth)


def check_tlog(data: bytes) -> None:
    """Records and what lies between them add up to the file."""

    def read(path: Path) -> None:
        reader = TlogReader(path)
        records = sum(8 + len(frame) for _, frame in reader)
        assert records + reader.garbage_bytes + reader.truncated_bytes == len(data)

    _read(data, ".tlog", read)


def check_ulog(data: bytes) -> None:
    """PX4's log; its events are in order and finite."""

    def read(path: Path) -> None:
        last_s = -math.inf
        for event in read_ulog(path, Thrust()):
            assert math.isfinite(event.t_mono_s)
            assert event.t_mono_s >= last_s
            last_s = event.t_mono_s

    _read(data, ".ulg", read)


def check_event_log(data: bytes) -> None:
    """swingd's own recording, damaged or not, with the payloads that its replay looks into."""

    def read(path: Path) -> None:
        reader = EventLogReader(path)
        for record in reader:
            if record.kind in (RecordKind.RECEIVED_APPLICATION, RecordKind.PORT_OPENED, RecordKind.PORT_CLOSED):
                assert record.port >= 0
                Framer().receive(record.frames)
            if record.kind is RecordKind.PARAMETERS:
                _parameters(record.text)
        assert 0 <= reader.tail_bytes <= len(data)

    _read(data, ".swingd", read)


# --------------------------------------------------------------------------------------------------------------- texts


def _parameters(text: str) -> None:
    try:
        parameters = parameters_from_json(text)
    except ConfigurationError as error:
        _must_tell(error)
        return
    assert parameters_from_json(parameters_to_json(parameters)) == parameters


def check_configuration(data: bytes) -> None:
    """A file, an override, and parameters as JSON."""
    head, _, override = data.rpartition(b"\xff")
    overrides = (override.decode("utf-8", "replace"),) if head else ()
    try:
        load_source(Source("fuzz.yaml", head or data, overrides))
    except ConfigurationError as error:
        _must_tell(error)
    _parameters(data.decode("utf-8", "replace"))


@cache
def _plant() -> Plant:
    return Plant(Parameters())


def check_console(data: bytes) -> None:
    """The simulation's text commands, faults among them: an answer of one line, whatever is said."""
    text = data.decode("utf-8", "replace")
    console = Console(copy.deepcopy(_plant()))
    for line in text.splitlines()[:20]:
        answer = console.execute(line)
        assert answer
        assert "\n" not in answer
    try:
        parse_fault(text)
    except ConfigurationError as error:
        _must_tell(error)


TARGETS = {
    "codec": Target("frames out of bytes", check_codec, seeds.frames),
    "adapter": Target("telemetry and setpoints into a pipeline", check_adapter, lambda: seeds.scripts(len(TELEMETRY))),
    "router": Target("frames of many systems through many ports", check_router, lambda: seeds.scripts(len(DIALECT))),
    "parameter_server": Target(
        "parameters and commands", check_parameter_server, lambda: seeds.scripts(len(QUESTIONS))
    ),
    "csv_log": Target("tables of a flight", check_csv_log, seeds.csv_logs),
    "truth": Target("tables of the true swing", check_truth, seeds.truths),
    "tlog": Target("a ground station's log", check_tlog, seeds.tlogs),
    "ulog": Target("PX4's log", check_ulog, seeds.ulogs),
    "event_log": Target("swingd's recording", check_event_log, seeds.event_logs),
    "configuration": Target("YAML, overrides, JSON", check_configuration, seeds.configurations),
    "console": Target("text commands of the simulation", check_console, seeds.console_lines),
}
"""By name."""
