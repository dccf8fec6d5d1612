"""Reference flights of the whole engine, so that every numerical change is a diff that a person reads.

Some are flown in lockstep against the simulated autopilot with a fixed seed, others are recordings of real autopilots
(see `tools.recorded_flight`) that are replayed; all are thinned to 5 Hz. Without options the flights are compared with
tests/golden; with ``--write`` they replace them: read the diff before committing it.
"""

import argparse
import csv
import io
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from swingd.engine import Engine
from swingd.link.codec import Codec
from swingd.model.actions import Action, SwingReport
from swingd.model.parameters import Mode, Parameters, ThrustSource
from swingd.sim.lockstep import EngineCompanion, Lockstep
from swingd.sim.peer import SimulatedAutopilot
from tools import recorded_flight

FOLDER = Path(__file__).resolve().parent.parent / "tests" / "golden"
REWRITE = "make golden"
EVERY = 20
"""Filter steps from one row to the next."""
RELATIVE = 1e-6
"""Tolerance, of the larger of the value and a tenth of its column's largest: machines differ in the last bits."""
HEALTH = "health"
TAKE_OFF_S, OFFBOARD_S, REFERENCE_S = 2.0, 13.0, 15.0
REFERENCE_EVERY_S = 0.1

Row = dict[str, str]


@dataclass(frozen=True)
class Scenario:
    """A flight: take-off at 2 s, OFFBOARD at 13 s, a velocity and a heading from 15 s on."""

    parameters: Parameters
    vel_ned_mps: tuple[float, float, float]
    yaw_rad: float
    duration_s: float


def scenarios() -> dict[str, Scenario]:
    """The flights by name: the default configuration, and one that goes the ways which that leaves out."""
    base = Parameters(mode=Mode.HOLD)
    base = replace(base, simulation=replace(base.simulation, takeoff_altitude_m=5.0))
    other = replace(
        base,
        vehicle=replace(
            base.vehicle, hook_frd_m=(0.02, 0.0, 0.15), imu_frd_m=(0.05, -0.03, -0.02), drag_n_per_mps=0.35
        ),
        payload=replace(base.payload, mass_kg=0.5),
        cable=replace(base.cable, length_m=2.5),
        thrust=replace(base.thrust, source=ThrustSource.THROTTLE),
        control=replace(base.control, law="payload", payload_kp_mps2_per_rad=4.0, payload_kd_mps2_per_radps=3.0),
        simulation=replace(base.simulation, seed=2, wind_ned_mps=(2.0, -1.5, 0.0), gust_std_mps=0.5),
    )
    return {
        "velocity_step": Scenario(base, (3.0, 0.0, 0.0), 0.0, 30.0),
        "turn_in_wind": Scenario(other, (-1.0, 2.0, 0.0), 1.0, 27.0),
    }


def fly(scenario: Scenario) -> list[SwingReport]:
    """Fly in lockstep; return the report of every filter step."""
    reports: list[SwingReport] = []

    def see(_t_mono_s: float, action: Action) -> None:
        if isinstance(action, SwingReport):
            reports.append(action)

    peer = SimulatedAutopilot(scenario.parameters)
    engine = Engine(scenario.parameters, see)
    engine.join(0.0)
    pilot = Codec(255, 190)
    due_s = {"reference": REFERENCE_S, "take-off": TAKE_OFF_S, "offboard": OFFBOARD_S}

    def command(number: int, *params: float) -> None:
        padded = (*params, *(0.0 for _ in range(7 - len(params))))
        peer.receive(pilot.encode(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)))

    def due(what: str, t_s: float, every_s: float = math.inf) -> bool:
        if t_s < due_s[what]:
            return False
        due_s[what] += every_s
        return True

    def on_step(t_s: float) -> None:
        if due("take-off", t_s):
            command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, *(math.nan for _ in range(4)))
            command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        if due("offboard", t_s):
            command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
        if due("reference", t_s, REFERENCE_EVERY_S):
            peer.send_to_companion(
                mavlink.MAVLink_set_position_target_local_ned_message(
                    0, 1, 191, 1, 0b1001_1100_0111, 0.0, 0.0, 0.0, *scenario.vel_ned_mps, 0.0, 0.0, 0.0,
                    scenario.yaw_rad, 0.0,
                )
            )  # fmt: skip

    Lockstep(peer, EngineCompanion(engine), on_step).run_until(scenario.duration_s)
    return reports


def flights() -> dict[str, Callable[[], list[SwingReport]]]:
    """All flights by name; a call gives the reports of one."""
    return {
        **{name: partial(fly, scenario) for name, scenario in scenarios().items()},
        **{name: partial(recorded_flight.reports, name) for name in recorded_flight.names()},
    }


def rows(reports: Sequence[SwingReport]) -> list[Row]:
    """Thin the reports out and write them as text."""
    return [_row(report) for report in reports[::EVERY]]


def _row(report: SwingReport) -> Row:
    force, acc, vel = report.force_ned_n, report.correction_acc_ned_mps2, report.correction_vel_ned_mps
    values = {
        "t_boot_s": report.t_boot_s,
        "xi_rad": report.xi_rad,
        "zeta_rad": report.zeta_rad,
        "xi_rate_radps": report.xi_rate_radps,
        "zeta_rate_radps": report.zeta_rate_radps,
        "force_n_n": force[0],
        "force_e_n": force[1],
        "force_d_n": force[2],
        "xi_std_rad": report.xi_std_rad,
        "zeta_std_rad": report.zeta_std_rad,
        "thrust_n": report.thrust_n,
        "thrust_scale": report.thrust_scale,
        "nis": report.nis,
        "acc_n_mps2": acc[0],
        "acc_e_mps2": acc[1],
        "vel_n_mps": vel[0],
        "vel_e_mps": vel[1],
    }
    return {**{name: f"{value:.10g}" for name, value in values.items()}, HEALTH: report.health.value}


def to_text(table: Sequence[Row]) -> str:
    """The rows as CSV."""
    file = io.StringIO()
    writer = csv.DictWriter(file, list(table[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return file.getvalue()


def from_text(text: str) -> list[Row]:
    """The rows of a golden file."""
    return list(csv.DictReader(io.StringIO(text)))


@dataclass(frozen=True)
class Difference:
    """Where two tables differ most."""

    ratio: float
    """Over the tolerance; infinite where the tables are not comparable."""
    text: str


def compare(golden: Sequence[Row], now: Sequence[Row]) -> Difference:
    """Find the worst difference of a flight from its golden file."""
    if not golden or len(golden) != len(now) or list(golden[0]) != list(now[0]):
        return Difference(math.inf, f"{len(golden)} rows became {len(now)}, or the columns changed")
    worst = Difference(0.0, "identical")
    for name in golden[0]:
        if name == HEALTH:
            for old, new in zip(golden, now, strict=True):
                if old[name] != new[name]:
                    return Difference(math.inf, f"health at {old['t_boot_s']} s: {old[name]} became {new[name]}")
            continue
        largest = max(abs(float(row[name])) for row in golden)
        for old, new in zip(golden, now, strict=True):
            before, after = float(old[name]), float(new[name])
            allowed = RELATIVE * max(abs(before), 0.1 * largest, 1e-9)
            ratio = abs(after - before) / allowed
            text = f"{name} at {old['t_boot_s']} s: {old[name]} became {new[name]}"
            if not math.isfinite(ratio):
                return Difference(math.inf, text)
            if ratio > worst.ratio:
                worst = Difference(ratio, f"{text}, {ratio:.3g} of what is allowed")
    return worst


def path_of(name: str) -> Path:
    """Golden file of a flight."""
    return FOLDER / f"{name}.csv"


def main(arguments: Sequence[str] | None = None, say: Callable[[str], None] = print) -> int:
    """Compare, or rewrite; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="replace the golden files")
    options = parser.parse_args(arguments)
    code = 0
    for name, flight in flights().items():
        now = rows(flight())
        path = path_of(name)
        before = from_text(path.read_text(encoding="utf-8")) if path.exists() else []
        worst = compare(before, now)
        say(f"{name}: {worst.text}")
        if options.write:
            # What the tolerance hides would only be noise in the diff.
            if worst.ratio > 1.0:
                path.write_text(to_text(now), encoding="utf-8")
                say(f"{name}: {path} rewritten")
        elif worst.ratio > 1.0:
            say(f"{name}: more than the tolerance; if it is meant, {REWRITE}, and read the diff")
            code = 1
    return code


if __name__ == "__main__":
    sys.exit(main())
