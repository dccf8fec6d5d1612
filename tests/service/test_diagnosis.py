"""How reports are judged, at their thresholds."""

from dataclasses import replace
from typing import Any

import pytest

from swingd.link.preflight import Advice, AdviceSeverity
from swingd.model.events import AutopilotKind, Stream
from swingd.model.parameters import Mode, Parameters
from swingd.service.diagnosis import (
    AutopilotReport,
    ClockReport,
    LinkReport,
    StreamReport,
    ThrustReport,
    judge_link,
    judge_silence,
    judge_streams,
    judge_thrust,
)

DANGER, WARNING, HINT = AdviceSeverity.DANGER, AdviceSeverity.WARNING, AdviceSeverity.HINT
HOLD = replace(Parameters(), mode=Mode.HOLD)
SHADOW = Parameters()
LINK = LinkReport(
    url="udpin://127.0.0.1:14540",
    seconds=8.0,
    bytes_in=400_000,
    bytes_per_s=50_000.0,
    frames=8000,
    frames_per_s=1000.0,
    autopilot_frames=8000,
    lost_frames=0,
    garbage_bytes=0,
    refused_frames=0,
    signed=False,
    swingd_running=False,
    senders=("1/1",),
    autopilots=(1,),
)
AUTOPILOT = AutopilotReport(
    system_id=1,
    kind=AutopilotKind.PX4,
    version="1.16.0",
    armed=False,
    in_air=False,
    remote_control=False,
    restarts=0,
)
CLOCK = ClockReport(
    asked=80,
    answered=80,
    round_trip_p50_s=0.008,
    round_trip_p99_s=0.02,
    offset_s=-5.0,
    offset_spread_s=0.001,
    delivery_p50_s=0.0,
    delivery_p99_s=0.01,
)
THRUST = ThrustReport(
    weight_n=22.6,
    voltage_nominal_v=16.2,
    voltage_v=16.0,
    expected_nominal=0.68,
    expected_now=0.69,
    measured=None,
    measured_source=None,
    scale=None,
    autopilot_hover=0.68,
)
VALUES = {"COM_OBL_RC_ACT": 5.0}


def of_link(parameters: Parameters = HOLD, values: dict[str, float] = VALUES, **changes: Any) -> list[Advice]:
    link, autopilot, clock = LINK, AUTOPILOT, CLOCK
    for name, value in changes.items():
        if hasattr(link, name):
            link = replace(link, **{name: value})
        elif hasattr(autopilot, name):
            autopilot = replace(autopilot, **{name: value})
        else:
            clock = replace(clock, **{name: value})
    return list(judge_link(parameters, link, autopilot, clock, values))


def test_a_good_link_needs_no_words() -> None:
    assert of_link() == []


@pytest.mark.parametrize(
    ("changes", "severity", "name"),
    [
        ({"lost_frames": 160}, None, ""),
        ({"lost_frames": 170}, WARNING, "link"),
        ({"garbage_bytes": 19_000}, None, ""),
        ({"garbage_bytes": 21_000}, WARNING, "link"),
        ({"round_trip_p50_s": 0.19}, None, ""),
        ({"round_trip_p50_s": 0.21}, DANGER, "latency"),
        ({"round_trip_p50_s": None}, WARNING, "latency"),
        ({"kind": AutopilotKind.OTHER}, WARNING, "autopilot"),
        ({"restarts": 1}, WARNING, "clock"),
        ({"signed": True}, DANGER, "signing"),
        ({"armed": True}, HINT, "streams"),
        ({"swingd_running": True}, HINT, "streams"),
        ({"values": {}}, WARNING, "parameters"),
    ],
)
def test_one_fault_of_the_link_is_one_finding(
    changes: dict[str, Any], severity: AdviceSeverity | None, name: str
) -> None:
    findings = of_link(**changes)
    assert [(finding.severity, finding.name) for finding in findings] == (
        [] if severity is None else [(severity, name)]
    )


def test_a_slow_link_hurts_only_who_corrects() -> None:
    (finding,) = of_link(SHADOW, round_trip_p50_s=0.5)
    assert finding.severity is WARNING
    assert finding.value == "500 ms there and back"


def test_a_key_that_lets_nothing_through_is_the_wrong_one() -> None:
    keyed = replace(HOLD, link=replace(HOLD.link, key_file="key"))
    assert of_link(keyed, signed=True) == []
    assert of_link(keyed, signed=True, refused_frames=20) == [], "a stranger's"
    (finding,) = of_link(keyed, frames=8, refused_frames=7000)
    assert (finding.severity, finding.name) == (DANGER, "signing")
    assert judge_silence(keyed, replace(LINK, frames=0, autopilots=(), refused_frames=7000)).name == "signing"


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("udpin://0.0.0.0:14540", "UDP port 14540 of this computer"),
        ("udpout://10.0.0.2:14580", "UDP port 14580 of 10.0.0.2"),
        ("tcpin://0.0.0.0:5760", "nobody connected to TCP port 5760"),
        ("tcpout://10.0.0.2:5760", "TCP port 5760 of 10.0.0.2"),
        ("serial:///dev/ttyAMA0:921600", "/dev/ttyAMA0 (TX to RX"),
    ],
)
def test_silence_is_asked_about_by_the_kind_of_link(url: str, words: str) -> None:
    silent = replace(LINK, url=url, bytes_in=0, frames=0, senders=(), autopilots=())
    finding = judge_silence(HOLD, silent)
    assert (finding.severity, finding.value, finding.meaning) == (DANGER, "silent", f"nothing came over {url}")
    assert words in finding.remedy


GOOD_HZ = {
    Stream.IMU: 250.0,
    Stream.ATTITUDE: 100.0,
    Stream.THROTTLE: 100.0,
    Stream.MOTORS: 100.0,
    Stream.BATTERY: 10.0,
    Stream.LOCAL_POSITION: 50.0,
    Stream.LANDED_STATE: 2.0,
}


def of_streams(
    changes: dict[Stream, tuple[float, str]], refused: str | None = None, parameters: Parameters = HOLD, **link: Any
) -> list[Advice]:
    streams = []
    for stream, asked_hz in GOOD_HZ.items():
        got_hz, verdict = changes.get(stream, (asked_hz, "good"))
        streams.append(StreamReport(stream, "", asked_hz, got_hz, verdict, refused if verdict == "refused" else None))
    return list(judge_streams(parameters, replace(LINK, **link), AUTOPILOT, streams))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({Stream.MOTORS: (0.0, "idle"), Stream.THROTTLE: (0.0, "idle")}, []),
        ({Stream.IMU: (74.0, "slow")}, [(DANGER, "imu")]),
        ({Stream.IMU: (76.0, "slow")}, [(WARNING, "imu")]),
        ({Stream.IMU: (0.0, "missing")}, [(DANGER, "imu")]),
        ({Stream.ATTITUDE: (19.0, "slow")}, [(DANGER, "attitude")]),
        ({Stream.ATTITUDE: (21.0, "slow")}, [(WARNING, "attitude")]),
        ({Stream.MOTORS: (0.0, "missing")}, []),
        ({Stream.THROTTLE: (0.0, "missing")}, []),
        (
            {Stream.MOTORS: (0.0, "missing"), Stream.THROTTLE: (10.0, "slow")},
            [(WARNING, "throttle"), (WARNING, "motors")],
        ),
        ({Stream.BATTERY: (0.5, "slow")}, [(WARNING, "battery")]),
        ({Stream.LOCAL_POSITION: (0.0, "missing")}, [(WARNING, "local_position")]),
        ({Stream.LANDED_STATE: (0.0, "missing")}, [(WARNING, "landed_state")]),
    ],
)
def test_streams_are_judged_by_what_needs_them(
    changes: dict[Stream, tuple[float, str]], expected: list[tuple[AdviceSeverity, str]]
) -> None:
    assert [(finding.severity, finding.name) for finding in of_streams(changes)] == expected


def test_the_reason_of_a_slow_stream_is_told() -> None:
    slow = {Stream.IMU: (50.0, "slow")}
    assert "the link or the autopilot gives no more" in of_streams(slow)[0].meaning
    assert "54646 bytes/s (921600 baud" in of_streams(slow)[0].remedy
    assert "running swingd" in of_streams(slow, swingd_running=True)[0].meaning
    (finding,) = of_streams({Stream.IMU: (0.0, "refused")}, "HIGHRES_IMU: MAV_RESULT_FAILED")
    assert "refused it (HIGHRES_IMU: MAV_RESULT_FAILED)" in finding.meaning


def test_a_slower_filter_needs_less() -> None:
    slower = replace(HOLD, estimator=replace(HOLD.estimator, rate_hz=50.0))
    (finding,) = of_streams({Stream.IMU: (40.0, "slow")}, parameters=slower)
    assert finding.severity is WARNING


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({"expected_nominal": None, "expected_now": None}, [(DANGER, "hover", "not possible")]),
        ({"expected_now": 0.81}, [(WARNING, "hover", "81% at 16.0 V")]),
        ({"expected_now": None}, [(WARNING, "hover", "more than 100 % at 16.0 V")]),
        ({"voltage_v": None}, []),
        ({"voltage_v": 5.0}, [(DANGER, "battery", "5.00 V")]),
        ({"voltage_v": 61.0}, [(DANGER, "battery", "61.00 V")]),
        ({"voltage_v": 24.0}, [(WARNING, "battery", "24.00 V")]),
        ({"voltage_v": 11.5}, [(WARNING, "battery", "11.50 V")]),
        ({"voltage_v": 13.0}, []),
        ({"measured": 0.68, "scale": 1.2}, []),
        ({"measured": 0.60, "scale": 1.3}, [(WARNING, "thrust", "scale 1.30 in hover")]),
        ({"measured": 0.80, "scale": 0.7}, [(WARNING, "thrust", "scale 0.70 in hover")]),
    ],
)
def test_hover_and_battery(changes: dict[str, Any], expected: list[tuple[AdviceSeverity, str, str]]) -> None:
    findings = judge_thrust(HOLD, replace(THRUST, **changes))
    assert [(finding.severity, finding.name, finding.value) for finding in findings] == expected
