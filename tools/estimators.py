"""Every estimator by its name over the recorded flights, as one table: python -m tools.estimators DATA.

DATA is the folder of independent flights (docs/validation.md). Every estimator gets the flight's own configuration;
only the load and the cable of dev_3 are set.
"""

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path

from swingd.config.loader import load_parameters, parameters_from_json
from swingd.model.errors import ConfigurationError
from swingd.record.truth import read_truth, within
from swingd.replay import Comparison, compare, replay
from swingd.studies.tables import markdown

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
ESTIMATORS = ("swing_ekf", "gp-ekf", "tether-ukf", "fgdf")


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recorded flight with the truth."""

    name: str
    log: str
    config: str
    truth: str | None = None
    """None: it is in the log."""
    window_s: tuple[float, float] | None = None
    facts: tuple[str, ...] = field(default=())
    """What is set besides the configuration."""


FLIGHTS = (
    Recorded("dev_1: steps, calm", "px4_sitl/dev_1.tlog", "iris.yaml", "px4_sitl/dev_1_truth.csv.gz", (17.76, 104.27)),
    Recorded(
        "dev_2: circles, wind with gusts", "px4_sitl/dev_2.tlog", "iris.yaml", "px4_sitl/dev_2_truth.csv.gz",
        (17.85, 115.5),
    ),
    Recorded(
        "dev_3: steps, vibration, sag", "px4_sitl/dev_3.tlog", "iris.yaml", "px4_sitl/dev_3_truth.csv.gz",
        (18.96, 108.57), ("payload.mass_kg=0.5", "cable.length_m=3"),
    ),
    Recorded("Gazebo", "gazebo_sitl/slung_load_dataset_small.csv", "gazebo.yaml"),
    Recorded("motion capture 17", "optitrack_flights/dataset_17.csv", "optitrack.yaml"),
    Recorded("motion capture 19", "optitrack_flights/dataset_19.csv", "optitrack.yaml"),
)  # fmt: skip


def judge(data: Path, flight: Recorded, estimator: str) -> Comparison | None:
    """Replay a flight with an estimator and compare it with the truth; None where it cannot use what was recorded."""
    facts = (*flight.facts, f"estimator.name={estimator}")
    try:
        parameters = load_parameters(CONFIGS / flight.config, facts)
    except ConfigurationError:
        return None
    run = replay(data / flight.log, parameters, parameters_from_json)
    true = run.truth if flight.truth is None else read_truth(data / flight.truth)
    if true is None:
        raise SystemExit(f"{flight.log}: no truth in it; expected a published set")
    return compare(run, parameters, within(true, *flight.window_s) if flight.window_s else true)


def table(data: Path, flights: tuple[Recorded, ...], estimators: tuple[str, ...]) -> list[str]:
    """Give the lines of the table: RMSE lateral / longitudinal [deg], then of the rates [deg/s]."""
    headings = ["flight", *estimators, "pendulum", *(f"rates, {name}" for name in estimators)]
    body = []
    for flight in flights:
        found = [judge(data, flight, name) for name in estimators]
        body.append(
            [
                flight.name,
                *("-" if c is None else f"{c.xi.rmse_deg:.2f} / {c.zeta.rmse_deg:.2f}" for c in found),
                next((f"{c.xi.pendulum_rmse_deg:.2f} / {c.zeta.pendulum_rmse_deg:.2f}" for c in found if c), "-"),
                *("-" if c is None else f"{c.xi.rate_rmse_deg_s:.1f} / {c.zeta.rate_rmse_deg_s:.1f}" for c in found),
            ]
        )
    return markdown(headings, body)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the recorded flights")
    parser.add_argument("--estimators", default=",".join(ESTIMATORS), help="names, with commas (%(default)s)")
    options = parser.parse_args()
    missing = [flight.log for flight in FLIGHTS if not (options.data / flight.log).exists()]
    if missing:
        print(f"{options.data}: no {', '.join(missing)}; expected the folder of the recorded flights", file=sys.stderr)
        return 1
    print("\n".join(table(options.data, FLIGHTS, tuple(options.estimators.split(",")))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
