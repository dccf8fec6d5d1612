"""The adapter on real PX4 flights."""

import math
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from swingd.link.adapter import AutopilotAdapter, Drop
from swingd.model.events import (
    Attitude,
    AutopilotKind,
    AutopilotRestart,
    AutopilotState,
    Battery,
    FlightMode,
    Imu,
    Landed,
    LandedState,
    LocalPosition,
    Motors,
    Stream,
    Throttle,
)
from swingd.model.parameters import Link, Thrust
from swingd.record.tlog import TlogReader
from swingd.record.truth import read_truth

pytestmark = pytest.mark.data
approx = pytest.approx


def flown(path) -> tuple[AutopilotAdapter, list]:
    adapter = AutopilotAdapter(Link(), Thrust())
    return adapter, [event for t_s, raw in TlogReader(path) for event in adapter.receive(t_s, raw)]


def test_px4_flight_as_events(flight_data):
    adapter, events = flown(flight_data("px4_sitl/dev_1.tlog"))
    assert adapter.autopilot is not None
    assert adapter.autopilot.kind is AutopilotKind.PX4
    counts = Counter(type(event) for event in events)
    assert (counts[Imu], counts[Attitude], counts[Throttle]) == (10600, 10600, 10600)
    assert (counts[LocalPosition], counts[Battery], counts[Landed]) == (5300, 1061, 531)
    assert counts[Motors] == 10178  # from arming on
    assert counts[AutopilotRestart] == 0
    assert set(adapter.drops) == {Drop.OTHER_SENDER}  # the companion's heartbeats, and what came before the autopilot's
    assert adapter.received[Stream.IMU] == counts[Imu]

    for kind in (Imu, Attitude, Throttle, Motors, LocalPosition):
        stamps = [e.t_boot_s for e in events if isinstance(e, kind)]
        assert all(0.0 < b - a < 0.05 for a, b in pairwise(stamps))
    first = next(e for e in events if isinstance(e, Imu))
    assert first.t_mono_s - first.t_boot_s == approx(1795400822.7766, abs=0.02)

    # Heartbeats come once a second: the mode is seen up to a second after its beginning at 28.2 s and end at 96.2 s.
    changes, last = [], (None, None)
    for e in events:
        if isinstance(e, AutopilotState) and (e.armed, e.mode) != last:
            last = (e.armed, e.mode)
            changes.append((round(e.t_mono_s - 1795400822.7766, 1), *last))
    assert changes == [
        (8.2, False, FlightMode.OTHER),
        (12.2, True, FlightMode.OTHER),
        (28.2, True, FlightMode.OFFBOARD),
        (97.2, True, FlightMode.OTHER),
        (113.2, False, FlightMode.OFFBOARD),
    ]
    states = [e.state for e in events if isinstance(e, Landed)]
    assert states[0] is states[-1] is LandedState.ON_GROUND
    assert {LandedState.TAKING_OFF, LandedState.IN_AIR, LandedState.LANDING} & set(states)

    volts = [e.voltage_v for e in events if isinstance(e, Battery)]
    assert volts[0] == 16.2
    assert min(volts) == approx(14.44, abs=0.01)
    assert {len(e.outputs) for e in events if isinstance(e, Motors)} == {4}


def test_motor_outputs_and_throttle_give_the_true_thrust(flight_data):
    _, events = flown(flight_data("px4_sitl/dev_1.tlog"))
    path = flight_data("px4_sitl/dev_1_truth.csv.gz")
    truth = read_truth(path, 30.0, 90.0)
    table = np.genfromtxt(path, delimiter=",", names=True)

    def scale(t_s: float) -> float:
        return float(np.interp(t_s, table["t_boot_s"], table["tscale"]))

    for kind, delay_s, tolerance_n in ((Motors, 0.014, 0.25), (Throttle, 0.03, 0.5)):
        times, thrust = [], []
        for e in events:
            if isinstance(e, kind) and truth.t_boot_s[truth.valid][0] < e.t_boot_s < truth.t_boot_s[truth.valid][-1]:
                u = e.outputs if isinstance(e, Motors) else (e.throttle,) * 4
                times.append(e.t_boot_s + delay_s)
                thrust.append(scale(e.t_boot_s) * sum(9.344e-6 * (1000.0 * x + 100.0) ** 2 for x in u))
        true_n = np.interp(times, table["t_boot_s"], table["thrust_n"])
        assert np.sqrt(np.mean((np.array(thrust) - true_n) ** 2)) < tolerance_n


def test_attitude_is_the_true_one(flight_data):
    _, events = flown(flight_data("px4_sitl/dev_2.tlog"))
    table = np.genfromtxt(flight_data("px4_sitl/dev_2_truth.csv.gz"), delimiter=",", names=True)
    airborne = [e for e in events if isinstance(e, Attitude) and 30.0 < e.t_boot_s < 110.0]
    heading = np.interp([e.t_boot_s - 0.007 for e in airborne], table["t_boot_s"], np.unwrap(table["heading_rad"]))
    error = np.array([e.yaw_rad for e in airborne]) - heading
    assert np.degrees(np.abs((error + math.pi) % (2 * math.pi) - math.pi)).max() < 5.0
