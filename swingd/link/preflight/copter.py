"""ArduPilot Copter's parameters: meanings by its parameter documentation, names of 4.3 to 4.7."""

import math
from collections.abc import Iterable, Mapping

from pymavlink.dialects.v20 import common as mavlink

from swingd.link.preflight.budget import frame_bytes
from swingd.link.preflight.rules import (
    Advice,
    AdviceSeverity,
    Facts,
    Rule,
    hover,
    slow_line,
    text,
    thrust_model,
    tilt_limit,
    velocity_gains,
    voltage_exponent,
)
from swingd.model.parameters import ThrustSource

SERIAL_PORTS = (1, 2, 3, 4)
_MAVLINK_PROTOCOLS = (1.0, 2.0)
# SERIALn_BAUD of 1000 and above that is not listed is the rate itself.
_BAUDS = {
    1: 1200,
    2: 2400,
    4: 4800,
    9: 9600,
    19: 19200,
    38: 38400,
    57: 57600,
    111: 111100,
    115: 115200,
    230: 230400,
    256: 256000,
    460: 460800,
    500: 500000,
    921: 921600,
    1500: 1500000,
    2000: 2000000,
}
_RAW_SENSORS = tuple(
    frame_bytes(msg_id)
    for msg_id in (
        mavlink.MAVLINK_MSG_ID_RAW_IMU,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU2,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU3,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE3,
    )
)
"""What the stream group RAW_SENS sends."""
_GROUP_MAX_BYTES_PER_S = 2000.0

_POSITION_FREE, _VELOCITY_FREE, _WAYPOINTS = 16, 32, 64
_GUIDED_ON_RADIO_LOSS = 4
_RELEASE_GRIPPER = 32
_TIMEOUT_MIN_S, _TIMEOUT_MAX_S = 1.0, 3.0

NAMES = (
    "GUID_TIMEOUT",
    "GUID_OPTIONS",
    "MOT_BAT_VOLT_MAX",
    "MOT_BAT_VOLT_MIN",
    "PSC_VELXY_P",
    "PSC_VELXY_I",
    "PSC_VELXY_D",
    "PSC_NE_VEL_P",
    "PSC_NE_VEL_I",
    "PSC_NE_VEL_D",
    "ANGLE_MAX",
    "ATC_ANGLE_MAX",
    "PSC_ANGLE_MAX",
    "MOT_THST_HOVER",
    "MOT_HOVER_LEARN",
    "MOT_THST_EXPO",
    "MOT_SPIN_MIN",
    "MOT_SPIN_MAX",
    "FS_GCS_ENABLE",
    "FS_THR_ENABLE",
    "FS_OPTIONS",
    *(f"SERIAL{n}_{what}" for n in SERIAL_PORTS for what in ("PROTOCOL", "BAUD")),
    "SR1_RAW_SENS",
    "SR2_RAW_SENS",
    "MAV2_RAW_SENS",
    "MAV3_RAW_SENS",
)


def voltage_compensated(values: Mapping[str, float]) -> bool | None:
    """Whether MOT_BAT_VOLT_MAX is set, and above MOT_BAT_VOLT_MIN."""
    highest = values.get("MOT_BAT_VOLT_MAX")
    return None if highest is None else highest > max(values.get("MOT_BAT_VOLT_MIN", 0.0), 0.0)


def _timeout(facts: Facts) -> Iterable[Advice]:
    value = facts.known("GUID_TIMEOUT")
    if value is None:
        return
    if value > _TIMEOUT_MAX_S:
        yield Advice(
            facts.danger() if value > 2.0 * _TIMEOUT_MAX_S else AdviceSeverity.WARNING,
            "GUID_TIMEOUT",
            text(value, "s"),
            f"when setpoints stop, Copter flies on with the last velocity for {text(value)} s before it stops",
            "GUID_TIMEOUT = 1 .. 3",
        )
    elif value < _TIMEOUT_MIN_S:
        yield Advice(
            AdviceSeverity.WARNING,
            "GUID_TIMEOUT",
            text(value, "s"),
            "a restart of swingd or of the application, or a short outage of the link, makes Copter brake in the "
            "middle of a swing",
            "GUID_TIMEOUT = 1 .. 3",
        )


def _options(facts: Facts) -> Iterable[Advice]:
    value = facts.known("GUID_OPTIONS")
    if value is None:
        return
    options = int(value)
    for bit, meaning in (
        (
            _VELOCITY_FREE,
            "Copter does not correct errors of the velocity: the loop that the correction counts on is off",
        ),
        (
            _POSITION_FREE,
            "Copter does not correct errors of the position: it drifts while setpoints ask for a position",
        ),
        (
            _WAYPOINTS,
            "position targets are flown along a planned path that cannot be renewed quickly: the correction cannot get "
            "into them",
        ),
    ):
        if options & bit:
            yield Advice(
                facts.danger() if bit == _VELOCITY_FREE else AdviceSeverity.WARNING,
                "GUID_OPTIONS",
                f"{options} (with {bit})",
                meaning,
                f"GUID_OPTIONS = {options & ~(_VELOCITY_FREE | _POSITION_FREE | _WAYPOINTS)}",
            )


def _gains(facts: Facts) -> Iterable[Advice]:
    return velocity_gains(
        facts,
        {
            "velocity_p": ("PSC_NE_VEL_P", "PSC_VELXY_P"),
            "velocity_i": ("PSC_NE_VEL_I", "PSC_VELXY_I"),
            "velocity_d": ("PSC_NE_VEL_D", "PSC_VELXY_D"),
        },
    )


def _tilt(facts: Facts) -> Iterable[Advice]:
    limits = [
        (math.radians(value), name, text(value, "deg"), f"{name} = {{tilt_deg}} or more")
        for name in ("ATC_ANGLE_MAX", "PSC_ANGLE_MAX")
        if (value := facts.known(name))
    ]
    if value := facts.known("ANGLE_MAX"):
        centidegrees = f"{text(value)} ({text(value / 100.0)} deg)"
        limits.append((math.radians(value / 100.0), "ANGLE_MAX", centidegrees, "ANGLE_MAX = {tilt_deg}00 or more"))
    if not limits:
        return ()
    tilt_rad, name, shown, remedy = min(limits)
    return tilt_limit(facts, name, shown, tilt_rad, remedy)


def _hover(facts: Facts) -> Iterable[Advice]:
    value = facts.known("MOT_THST_HOVER")
    if value is None:
        return ()
    expected = facts.hover_throttle
    if expected is not None and facts.parameters.thrust.source in (ThrustSource.AUTO, ThrustSource.MOTORS):
        expected = _throttle_of(facts.values, expected)
    # 1 and 2 learn in flight, 2 saves it as well.
    learns = facts.known("MOT_HOVER_LEARN") != 0.0
    return hover(facts, "MOT_THST_HOVER", value, expected, learns, "MOT_THST_HOVER = {expected}")


def _throttle_of(values: Mapping[str, float], output: float) -> float | None:
    """Give Copter's throttle, which is relative thrust, for a motor output 0..1 at full voltage; None if not known."""
    try:
        low, high, expo = values["MOT_SPIN_MIN"], values["MOT_SPIN_MAX"], values["MOT_THST_EXPO"]
    except KeyError:
        return None
    if high <= low:
        return None
    signal = max((output - low) / (high - low), 0.0)
    return min((expo * signal + 1.0 - expo) * signal, 1.0)


def _thrust_model(facts: Facts) -> Iterable[Advice]:
    expo = facts.known("MOT_THST_EXPO")
    return () if expo is None else thrust_model(facts, "MOT_THST_EXPO", expo)


def _voltage(facts: Facts) -> Iterable[Advice]:
    highest, lowest = facts.known("MOT_BAT_VOLT_MAX"), facts.known("MOT_BAT_VOLT_MIN")
    if highest is not None and lowest is not None and 0.0 < highest <= lowest:
        yield Advice(
            AdviceSeverity.WARNING,
            "MOT_BAT_VOLT_MAX",
            text(highest, "V"),
            f"not above MOT_BAT_VOLT_MIN ({text(lowest)} V): Copter does not compensate the voltage at all",
            "MOT_BAT_VOLT_MAX = 4.2 V and MOT_BAT_VOLT_MIN = 3.3 V for each cell, or 0 for both",
        )
    yield from voltage_exponent(facts, "MOT_BAT_VOLT_MAX", voltage_compensated(facts.values))


def _failsafes(facts: Facts) -> Iterable[Advice]:
    ground, radio, options = facts.known("FS_GCS_ENABLE"), facts.known("FS_THR_ENABLE"), facts.known("FS_OPTIONS")
    if ground:
        yield Advice(
            AdviceSeverity.HINT,
            "FS_GCS_ENABLE",
            text(ground),
            "when the ground station's HEARTBEAT stays away, Copter leaves GUIDED and the correction ends; swingd's "
            "own HEARTBEAT does not count",
            "let the ground station, or the application as its system, send HEARTBEAT; or FS_GCS_ENABLE = 0",
        )
    if not ground and ground is not None and radio == 0.0:
        yield Advice(
            AdviceSeverity.WARNING,
            "FS_THR_ENABLE",
            "0, FS_GCS_ENABLE 0",
            "nothing happens when remote control and ground station are lost: once setpoints have stopped, Copter "
            "hovers with the load until the battery is low",
            "FS_GCS_ENABLE = 1 (return) or 5 (land), or the same for FS_THR_ENABLE where a remote control is used",
        )
    if radio and options is not None and not int(options) & _GUIDED_ON_RADIO_LOSS:
        yield Advice(
            AdviceSeverity.HINT,
            "FS_THR_ENABLE",
            text(radio),
            "losing the remote control ends GUIDED, and with it the correction",
            f"leave it if that is wanted; to fly on in GUIDED FS_OPTIONS = {int(options) | _GUIDED_ON_RADIO_LOSS}",
        )
    if options is not None and int(options) & _RELEASE_GRIPPER:
        yield Advice(
            AdviceSeverity.WARNING,
            "FS_OPTIONS",
            text(options),
            "a failsafe opens the gripper: a load that hangs on it falls",
            f"FS_OPTIONS = {int(options) & ~_RELEASE_GRIPPER}, unless dropping the load is wanted",
        )


def _link(facts: Facts) -> Iterable[Advice]:
    # Which of the ports leads here is not known: the one of the same speed does, where there is only one.
    same = [
        f"SERIAL{n}_BAUD"
        for n in SERIAL_PORTS
        if facts.known(f"SERIAL{n}_PROTOCOL") in _MAVLINK_PROTOCOLS
        and _baud(facts.known(f"SERIAL{n}_BAUD")) == facts.serial_baud
    ]
    name = same[0] if len(same) == 1 else "link.autopilot"
    budget = facts.budget
    code = next((code for code, baud in _BAUDS.items() if budget is not None and baud == budget.baud), 921)
    return slow_line(facts, name, f"{same[0] if len(same) == 1 else 'SERIALn_BAUD'} = {code} on the autopilot")


def _baud(code: float | None) -> int | None:
    return None if code is None else _BAUDS.get(int(code), int(code))


def _groups(facts: Facts) -> Iterable[Advice]:
    for name in ("SR1_RAW_SENS", "SR2_RAW_SENS", "MAV2_RAW_SENS", "MAV3_RAW_SENS"):
        rate_hz = facts.known(name)
        if rate_hz is None or rate_hz * sum(_RAW_SENSORS) <= _GROUP_MAX_BYTES_PER_S:
            continue
        yield Advice(
            AdviceSeverity.HINT,
            name,
            text(rate_hz, "Hz"),
            f"Copter sends {len(_RAW_SENSORS)} messages at that rate that swingd does not need, about "
            f"{rate_hz * sum(_RAW_SENSORS):.0f} bytes/s: swingd asks for what it needs message by message",
            f"{name} = 2 or less, if this is the port that leads here",
        )


RULES: tuple[Rule, ...] = (
    _timeout,
    _options,
    _gains,
    _tilt,
    _hover,
    _thrust_model,
    _voltage,
    _failsafes,
    _link,
    _groups,
)
