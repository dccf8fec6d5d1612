"""Small, good inputs of every kind, from which the fuzzer begins; all made here, none taken from a file."""

import gzip
import struct
import tempfile
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from swingd.config.plain import parameters_to_json
from swingd.link.codec import Codec
from swingd.link.router import port_of
from swingd.model.parameters import Parameters
from swingd.record.csv_log import OPTIONAL, REQUIRED
from swingd.record.event_log import EventLogWriter
from swingd.sim.faults import USAGE

_QUIET = "0,0,-9.8,0,0,0,0,0,0"


def _messages() -> list[mavlink.MAVLink_message]:
    return [
        mavlink.MAVLink_heartbeat_message(2, 12, 209, 6 << 16, 4, 3),
        mavlink.MAVLink_highres_imu_message(1_000_000, 0.1, 0.0, -9.8, 0, 0, 0, 0, 0, 0, 1013, 0, 0, 20, 63, 0),
        mavlink.MAVLink_attitude_message(1000, 0.1, -0.1, 1.0, 0.0, 0.0, 0.0),
        mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0b1001_1100_0111, *(0.5 for _ in range(11))),
        mavlink.MAVLink_param_set_message(1, 191, b"SWG_DAMPING", 0.3, 9),
    ]


def frames() -> list[bytes]:
    """Frames of both versions, alone and together."""
    codec = Codec(1, 1)
    single = [codec.encode(message) for message in _messages()]
    packer = mavlink.MAVLink(None, 1, 1)
    old = _messages()[0].pack(packer, force_mavlink1=True)
    return [*single, bytes(old), b"noise\xfd" + b"".join(single)]


def scripts(ids: int) -> list[bytes]:
    """What happens to an engine: ticks, peers that come and go, each message once with a payload of its own size."""
    ticks = bytes((0, 10)) * 5
    peers = bytes((1, 1, 1, 2, 1, 3))
    each = b"".join(bytes((3, i % 9, i % 192, i % 256, 40)) + bytes(range(40)) for i in range(ids))
    return [
        bytes((start,)) + part
        for start in (0, 1)
        for part in (ticks, peers + ticks, each[:400] + ticks, each[-400:] + ticks)
    ]


def csv_logs() -> list[bytes]:
    """The project's own table, with and without the optional columns, and one of motion capture."""
    own = ",".join(REQUIRED) + "\n" + "".join(f"{0.01 * k:g},{_QUIET}\n" for k in range(4))
    more = ",".join((*REQUIRED, *OPTIONAL, "motor_1")) + "\n" + f"0.1,{_QUIET},0.5,15,0,0,0,0,0,-5,1,0,0.5\n"
    captured = "\n".join(",".join(f"{0.1 * (i + k):g}" for i in range(24)) for k in range(25)) + "\n"
    return [*(text.encode() for text in (own, more, captured)), gzip.compress(own.encode())]


def truths() -> list[bytes]:
    """A table of the true swing."""
    return [b"t_boot_s,xi_rad,zeta_rad,xi_rate_radps,zeta_rate_radps,attached,taut\n0,0.1,0,0,0,1,1\n0.1,0,0,0,0,1,1\n"]


def tlogs() -> list[bytes]:
    """Stamped frames, with noise between two."""
    stamped = [struct.pack(">Q", 10**15 + k) + frame for k, frame in enumerate(frames()[:4])]
    return [b"".join(stamped), stamped[0] + b"noise" + stamped[1] + stamped[2], stamped[0][:-3]]


def ulogs() -> list[bytes]:
    """Two topics with three samples each."""

    def message(kind: bytes, data: bytes) -> bytes:
        return struct.pack("<H", len(data)) + kind + data

    head = b"ULog\x01\x12\x35\x01" + bytes(8) + message(b"B", bytes(40))
    fields = {
        b"vehicle_imu": b"uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;float[3] delta_velocity;"
        b"uint32_t delta_angle_dt;uint32_t delta_velocity_dt;",
        b"vehicle_attitude": b"uint64_t timestamp;float[4] q;",
    }
    formats = b"".join(message(b"F", name + b":" + text) for name, text in fields.items())
    topics = b"".join(message(b"A", struct.pack("<BH", 0, k) + name) for k, name in enumerate(fields))
    samples = b""
    for t_us in (1_000_000, 1_010_000, 1_020_000):
        imu = struct.pack("<HQQ6fII", 0, t_us, t_us, 0, 0, 0, 0, 0, -0.049, 5000, 5000)
        samples += message(b"D", imu) + message(b"D", struct.pack("<HQ4f", 1, t_us, 1, 0, 0, 0))
    return [head + formats + topics + samples]


def event_logs() -> list[bytes]:
    """A recording of every kind of input."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seed.swingd"
        log = EventLogWriter(path, "0", "")
        log.join(0.0)
        log.port(0.1, port_of(1, 0), present=True)
        log.received(0, 0.2, frames()[0])
        log.received(port_of(1, 0), 0.3, frames()[3])
        log.tick(0.4)
        log.parameters(0.5, parameters_to_json(Parameters()))
        log.correction(0.6, True)
        log.close()
        return [path.read_bytes()]


def configurations() -> list[bytes]:
    """A short file, a wrong one, one with an override, and JSON."""
    return [
        b"vehicle: {mass_kg: 2.0, hook_frd_m: [0, 0, 0.1]}\nendpoints:\n- url: udpin://:14541\n  shaper: zv\n",
        b"mode: nothing\npayload:\n  mass_kg: heavy\n",
        b"mode: inline\n\xffcable.length_m=1.5",
        parameters_to_json(Parameters()).encode(),
    ]


def console_lines() -> list[bytes]:
    """Commands and faults."""
    commands = ("wind 4 0", "kick 1 0", "release", "hook", "mass 0.3", "length 2", "status", "help wind")
    return ["\n".join(commands).encode(), b"loss 0.2 10..20", USAGE.encode()]
