"""Flights of real autopilots, kept small enough for the repository: what swingd was given, and the true swing.

    python -m tools.recorded_flight FLIGHT.swingd TRUTH.csv NAME --until 45

thins a recording (``swingd run --record``) and the truth of its simulation (``swingd sim --truth``) into tests/golden.
What swingd sent is left out, and so are messages that it only forwards: a replay gives the same estimate and the same
correction without them.
"""

import argparse
import csv
import lzma
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swingd.config.loader import parameters_from_json
from swingd.link.codec import Framer
from swingd.model.actions import SwingReport
from swingd.record.event_log import EventLogReader, EventLogWriter, Record, RecordKind
from swingd.replay.runner import replay

FOLDER = Path(__file__).resolve().parent.parent / "tests" / "golden"
TRUTH_EVERY_S = 0.2
TRUTH_COLUMNS = ("t_boot_s", "swing_lateral_rad", "swing_longitudinal_rad")
NEEDED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS,
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    }
)
"""Messages of an autopilot from which swingd learns something; it only forwards the others.

Not TIMESYNC: an answer means something to the question alone, and what swingd asks changes.
"""


def recording_of(name: str) -> Path:
    """Thinned recording of a flight, compressed."""
    return FOLDER / f"{name}.swingd.xz"


def truth_of(name: str) -> Path:
    """True swing of a flight."""
    return FOLDER / f"{name}_truth.csv"


def names() -> list[str]:
    """The flights that are kept."""
    return sorted(path.name.removesuffix(".swingd.xz") for path in FOLDER.glob("*.swingd.xz"))


@cache
def reports(name: str) -> list[SwingReport]:
    """Replay a kept flight; return the report of every filter step."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.swingd"
        path.write_bytes(lzma.decompress(recording_of(name).read_bytes()))
        return replay(path, None, parameters_from_json).reports


def rmse_deg(name: str, flown: Sequence[SwingReport]) -> tuple[float, float]:
    """Estimate against truth over the reports with a correction, lateral and longitudinal [deg]."""
    with truth_of(name).open(encoding="utf-8", newline="") as file:
        truth = np.array([[float(row[column]) for column in TRUTH_COLUMNS] for row in csv.DictReader(file)]).T
    estimated = {round(report.t_boot_s, 2): report for report in flown if report.health.value == "active"}
    errors = [
        (report.xi_rad - np.interp(t, truth[0], truth[1]), report.zeta_rad - np.interp(t, truth[0], truth[2]))
        for t, report in estimated.items()
    ]
    lateral, longitudinal = np.degrees(np.sqrt(np.mean(np.square(errors), axis=0)))
    return float(lateral), float(longitudinal)


def keep(recording: Path, truth: Path, name: str, until_s: float) -> None:
    """Thin a flight and its truth into the folder of the golden files.

    Parameters
    ----------
    recording, truth : Path
        A recording, and the truth that the simulation wrote.
    name : str
        Of the flight.
    until_s : float
        Time after the recording's first record at which the kept part ends [s].
    """
    reader = EventLogReader(recording)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.swingd"
        writer = EventLogWriter(path, reader.swingd_version, reader.configuration)
        for record in _thinned(reader, until_s):
            writer.write(record.kind, record.t_mono_s, record.payload)
        writer.close()
        recording_of(name).write_bytes(lzma.compress(path.read_bytes(), preset=9 | lzma.PRESET_EXTREME))
    end_s = reports(name)[-1].t_boot_s
    with truth.open(encoding="utf-8", newline="") as file, truth_of(name).open("w", encoding="utf-8") as kept:
        print(",".join(TRUTH_COLUMNS), file=kept)
        next_s = -math.inf
        for row in csv.DictReader(file):
            t_s = float(row["t_boot_s"])
            if next_s <= t_s <= end_s + TRUTH_EVERY_S:
                next_s = t_s + TRUTH_EVERY_S - 1e-6
                print(",".join(row[column] for column in TRUTH_COLUMNS), file=kept)


def _thinned(reader: EventLogReader, until_s: float) -> Iterator[Record]:
    """Give what the engine needs of a recording."""
    framer = Framer()
    begin_s = None
    for record in reader:
        begin_s = record.t_mono_s if begin_s is None else begin_s
        if record.t_mono_s - begin_s > until_s:
            return
        if record.kind is RecordKind.RECEIVED_AUTOPILOT:
            payload = b"".join(frame.raw for frame in framer.receive(record.payload) if frame.msg_id in NEEDED)
            if payload:
                yield Record(record.kind, record.t_mono_s, payload)
        elif not record.kind.is_output:
            yield record


def main(arguments: Sequence[str] | None = None) -> int:
    """Thin one flight; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("name")
    parser.add_argument("--until", type=float, default=math.inf, metavar="S", help="keep this much of the recording")
    options = parser.parse_args(arguments)
    keep(options.recording, options.truth, options.name, options.until)
    lateral, longitudinal = rmse_deg(options.name, reports(options.name))
    size = recording_of(options.name).stat().st_size
    print(f"{options.name}: {size / 1e3:.0f} kB, estimate against truth {lateral:.2f}, {longitudinal:.2f} deg RMSE")
    return 0


if __name__ == "__main__":
    sys.exit(main())
