"""PX4's parameters: meanings by its parameter reference (1.14 to 1.18), the rest measured on 1.16."""

import math
from collections.abc import Iterable, Mapping

from swingd.link.preflight.budget import BITS_PER_BYTE
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
from swingd.model.parameters import Mode, ShaperName, ThrustSource

INSTANCES = (0, 1, 2)
_PORTS = {101: "SER_TEL1_BAUD", 102: "SER_TEL2_BAUD", 103: "SER_TEL3_BAUD", 104: "SER_TEL4_BAUD"}
"""MAV_n_CONFIG, and the baud rate of that port."""
_ETHERNET = 1000
_ETHERNET_BYTES_PER_S = 100_000
_ONBOARD = 2
_OFFBOARD_BIT = 4
_NO_STICKS = 4
_IMU_RATES_HZ = (100, 200, 250, 400)
"""What IMU_INTEG_RATE offers."""
_LEFT_OUT = 1.2
"""More samples than are asked for by this factor are left out."""
_RESTART_S = 1.0
"""A restart of swingd in flight may leave the autopilot without setpoints for nearly this long [s]."""
_LED_LOSS_S = 0.5
"""Mode path: an acceleration must not outlive whoever gave it for longer."""
_LONG_LOSS_S = 2.0

NAMES = (
    "COM_OBL_RC_ACT",
    "COM_OF_LOSS_T",
    "COM_RCL_EXCEPT",
    "COM_RC_IN_MODE",
    "MC_BAT_SCALE_EN",
    "MPC_XY_VEL_P_ACC",
    "MPC_XY_VEL_I_ACC",
    "MPC_XY_VEL_D_ACC",
    "MPC_XY_VEL_MAX",
    "MPC_ACC_HOR",
    "MPC_TILTMAX_AIR",
    "MPC_THR_HOVER",
    "MPC_USE_HTE",
    "THR_MDL_FAC",
    "IMU_INTEG_RATE",
    *(f"MAV_{n}_{what}" for n in INSTANCES for what in ("CONFIG", "MODE", "RATE")),
    *_PORTS.values(),
)

_LOSS_ACTIONS = {
    0: "Position mode",
    1: "Altitude mode",
    2: "Stabilized",
    3: "Return",
    4: "Land",
    5: "Hold",
    6: "Terminate",
    7: "Disarm",
}


def voltage_compensated(values: Mapping[str, float]) -> bool | None:
    """Whether MC_BAT_SCALE_EN is on."""
    value = values.get("MC_BAT_SCALE_EN")
    return None if value is None else value != 0.0


def _loss_action(facts: Facts) -> Iterable[Advice]:
    value = facts.known("COM_OBL_RC_ACT")
    if value is None:
        return
    action = _LOSS_ACTIONS.get(int(value), "unknown")
    shown = f"{text(value)} ({action})"
    remedy = "COM_OBL_RC_ACT = 5 (Hold) or 4 (Land)"
    if value in (0, 1, 2):
        if facts.remote_control:
            yield Advice(
                AdviceSeverity.WARNING,
                "COM_OBL_RC_ACT",
                shown,
                "when setpoints stop, PX4 hands over to the remote control at once: without hands at the sticks, or "
                "with the remote control lost as well, it sinks and drifts with the load",
                remedy + ", unless a pilot is always ready",
            )
        else:
            yield Advice(
                facts.danger(),
                "COM_OBL_RC_ACT",
                shown,
                "when setpoints stop and there is no remote control, PX4 sinks at 0.7 m/s with no horizontal control: "
                "the load touches down first and the vehicle drifts with the wind",
                remedy,
            )
    elif value in (6, 7):
        yield Advice(
            facts.danger(),
            "COM_OBL_RC_ACT",
            shown,
            "when setpoints stop for a moment, PX4 stops the motors in flight",
            remedy,
        )
    elif value == 3:
        yield Advice(
            AdviceSeverity.HINT,
            "COM_OBL_RC_ACT",
            shown,
            "when setpoints stop, PX4 climbs to RTL_RETURN_ALT and flies home, with the load swinging undamped",
            "COM_OBL_RC_ACT = 5 (Hold) lets the swing die out first",
        )


def _loss_time(facts: Facts) -> Iterable[Advice]:
    value = facts.known("COM_OF_LOSS_T")
    if value is None:
        return
    leads = facts.parameters.mode is Mode.PATH
    wanted_s = _LED_LOSS_S if leads else _RESTART_S
    if value < wanted_s:
        yield Advice(
            AdviceSeverity.WARNING,
            "COM_OF_LOSS_T",
            text(value, "s"),
            "a restart of swingd or of the application, or a short outage of the link, ends OFFBOARD: the correction "
            "stops in the middle of a swing",
            f"COM_OF_LOSS_T = {wanted_s:g}",
        )
    elif leads and value > wanted_s:
        yield Advice(
            AdviceSeverity.WARNING,
            "COM_OF_LOSS_T",
            text(value, "s"),
            f"where swingd is killed, PX4 flies on with the last acceleration for {text(value)} s",
            f"COM_OF_LOSS_T = {wanted_s:g}",
        )
    elif value > _LONG_LOSS_S:
        yield Advice(
            AdviceSeverity.WARNING,
            "COM_OF_LOSS_T",
            text(value, "s"),
            f"when setpoints stop, PX4 flies on with the last one for {text(value)} s before it does anything",
            "COM_OF_LOSS_T = 1",
        )


def _remote_control_loss(facts: Facts) -> Iterable[Advice]:
    value = facts.known("COM_RCL_EXCEPT")
    if value is None or int(value) & _OFFBOARD_BIT or facts.known("COM_RC_IN_MODE") == _NO_STICKS:
        return
    yield Advice(
        AdviceSeverity.HINT,
        "COM_RCL_EXCEPT",
        text(value),
        "losing the remote control (or joystick) ends OFFBOARD, and with it the correction",
        f"leave it if that is wanted (NAV_RCL_ACT says what follows); else COM_RCL_EXCEPT = "
        f"{int(value) | _OFFBOARD_BIT}; without any remote control COM_RC_IN_MODE = 4",
    )


def _gains(facts: Facts) -> Iterable[Advice]:
    return velocity_gains(
        facts,
        {
            "velocity_p": ("MPC_XY_VEL_P_ACC",),
            "velocity_i": ("MPC_XY_VEL_I_ACC",),
            "velocity_d": ("MPC_XY_VEL_D_ACC",),
        },
    )


def _velocity_limit(facts: Facts) -> Iterable[Advice]:
    value = facts.known("MPC_XY_VEL_MAX")
    if value is None:
        return
    parameters = facts.parameters
    correction = parameters.control.vel_max_mps
    asked = 0.0
    who = "an application"
    if parameters.mode is Mode.HOLD:
        asked, who = math.hypot(*parameters.hold.vel_ned_mps[:2]), "hold.vel_ned_mps"
    elif parameters.mode is Mode.PATH:
        return  # accelerations, which this does not limit
    elif any(endpoint.shaper is not ShaperName.NONE for endpoint in parameters.endpoints):
        asked, who = parameters.shaping.vel_max_mps, "shaping.vel_max_mps"
    if value >= asked + correction and value >= 2.0 * correction:
        return
    yield Advice(
        AdviceSeverity.WARNING,
        "MPC_XY_VEL_MAX",
        text(value, "m/s"),
        f"PX4 limits setpoint and correction together: {who} of more than {max(value - correction, 0.0):.1f} m/s "
        "leaves no room for the correction's velocity",
        f"MPC_XY_VEL_MAX = {max(asked + correction, 2.0 * correction):.1f} or more, or fly slower",
    )


def _acceleration_limit(facts: Facts) -> Iterable[Advice]:
    value = facts.known("MPC_ACC_HOR")
    if value is None or value <= 3.0:
        return
    yield Advice(
        AdviceSeverity.HINT,
        "MPC_ACC_HOR",
        text(value, "m/s^2"),
        "in its own modes (Hold, Return, missions) PX4 accelerates and brakes by up to that, and nothing damps the "
        "load there",
        "MPC_ACC_HOR = 2 .. 3 with a load",
    )


def _tilt(facts: Facts) -> Iterable[Advice]:
    value = facts.known("MPC_TILTMAX_AIR")
    if value is None:
        return ()
    return tilt_limit(
        facts, "MPC_TILTMAX_AIR", text(value, "deg"), math.radians(value), "MPC_TILTMAX_AIR = {tilt_deg} or more"
    )


def _hover(facts: Facts) -> Iterable[Advice]:
    value, uses_estimate = facts.known("MPC_THR_HOVER"), facts.known("MPC_USE_HTE")
    if uses_estimate == 0.0:
        yield Advice(
            AdviceSeverity.WARNING,
            "MPC_USE_HTE",
            "0",
            "PX4 does not learn the throttle of hover: with another load, or as the battery empties, altitude is held "
            "worse",
            "MPC_USE_HTE = 1",
        )
    if value is None:
        return
    expected = facts.hover_throttle
    factor = facts.known("THR_MDL_FAC") or 0.0
    if expected is not None and facts.parameters.thrust.source in (ThrustSource.AUTO, ThrustSource.MOTORS):
        # PX4's throttle is relative thrust; the curve's is then the motors' signal.
        expected = factor * expected * expected + (1.0 - factor) * expected
    learns = uses_estimate is None or uses_estimate != 0.0
    yield from hover(facts, "MPC_THR_HOVER", value, expected, learns, "MPC_THR_HOVER = {expected}")


def _thrust_model(facts: Facts) -> Iterable[Advice]:
    factor = facts.known("THR_MDL_FAC")
    return () if factor is None else thrust_model(facts, "THR_MDL_FAC", factor)


def _voltage(facts: Facts) -> Iterable[Advice]:
    return voltage_exponent(facts, "MC_BAT_SCALE_EN", voltage_compensated(facts.values))


def _imu_rate(facts: Facts) -> Iterable[Advice]:
    value = facts.known("IMU_INTEG_RATE")
    if value is None or value <= 0.0:
        return
    asked_hz, filter_hz = facts.parameters.link.imu_rate_hz, facts.parameters.estimator.rate_hz
    if value < filter_hz:
        yield Advice(
            AdviceSeverity.WARNING,
            "IMU_INTEG_RATE",
            text(value, "Hz"),
            f"PX4 has fewer IMU samples than the filter has steps ({text(filter_hz)} Hz)",
            "IMU_INTEG_RATE = 200, then restart PX4",
        )
    elif value > _LEFT_OUT * asked_hz:
        fits = [rate_hz for rate_hz in _IMU_RATES_HZ if filter_hz <= rate_hz <= _LEFT_OUT * asked_hz]
        yield Advice(
            AdviceSeverity.HINT,
            "IMU_INTEG_RATE",
            text(value, "Hz"),
            f"HIGHRES_IMU carries one sample of {1e3 / value:.2g} ms and is not averaged: of {text(value)} Hz swingd "
            f"asks for {text(asked_hz)}, so vibration in between shows up as swing",
            (f"IMU_INTEG_RATE = {fits[-1]}, or " if fits else "")
            + f"link.imu_rate_hz = {text(value)} where the link carries it",
        )


def _link(facts: Facts) -> Iterable[Advice]:
    """Judge the MAVLink instances that serve a companion computer by what the streams need."""
    budget = facts.budget
    if budget is None:
        return
    need = budget.needed_bytes_per_s
    configs = [facts.known(f"MAV_{n}_CONFIG") for n in INSTANCES]
    if None in configs:
        yield from slow_line(facts, "link.autopilot", "SER_TELn_BAUD of the port that leads here")
        return
    onboard = [n for n in INSTANCES if configs[n] and facts.known(f"MAV_{n}_MODE") == _ONBOARD]
    if not onboard and facts.serial_baud is not None:
        yield from slow_line(facts, "link.autopilot", "SER_TELn_BAUD of the port that leads here")
        yield Advice(
            AdviceSeverity.HINT,
            "MAV_n_MODE",
            "none is 2",
            "no MAVLink instance is set up for a companion computer: the link has the streams of a ground station",
            f"for TELEM2: MAV_1_CONFIG = 102, MAV_1_MODE = 2 (Onboard), SER_TEL2_BAUD = {budget.baud or 921600}",
        )
    for n in onboard:
        config, rate = int(configs[n] or 0), facts.known(f"MAV_{n}_RATE")
        baud_name = _PORTS.get(config)
        baud = facts.known(baud_name) if baud_name is not None else None
        line = baud / BITS_PER_BYTE if baud else None
        if baud is not None and line is not None and line < need:
            yield Advice(
                AdviceSeverity.WARNING,
                str(baud_name),
                text(baud),
                f"the line carries {line:.0f} bytes/s, the streams that swingd asks for need {need:.0f}: "
                "PX4 slows all of them down",
                f"{baud_name} = {budget.baud or 'the fastest'}, or lower link.imu_rate_hz",
            )
            continue
        if rate is None or (config != _ETHERNET and line is None):
            continue
        capacity = rate or (float(_ETHERNET_BYTES_PER_S) if line is None else line / 2.0)
        if capacity < need:
            half = ", which means half of what the line carries" if not rate and line is not None else ""
            yield Advice(
                AdviceSeverity.WARNING,
                f"MAV_{n}_RATE",
                text(rate, "B/s") + half,
                f"PX4 sends at most {capacity:.0f} bytes/s, the streams that swingd asks for need {need:.0f}: "
                "without hardware flow control it slows all of them down",
                f"MAV_{n}_RATE = {_round_up(need)}, or lower link.imu_rate_hz",
            )


def _round_up(value: float) -> int:
    return math.ceil(value / 5000.0) * 5000


RULES: tuple[Rule, ...] = (
    _loss_action,
    _loss_time,
    _remote_control_loss,
    _gains,
    _velocity_limit,
    _tilt,
    _hover,
    _thrust_model,
    _voltage,
    _imu_rate,
    _link,
    _acceleration_limit,
)
