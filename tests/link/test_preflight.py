"""Reading an autopilot's parameters, and what is said about them."""

import math
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotId
from swingd.link.codec import Codec
from swingd.link.preflight import (
    AdviceSeverity,
    ParameterReader,
    advise,
    carrier,
    link_budget,
    parameters_of,
    voltage_compensated,
)
from swingd.link.preflight.reader import ATTEMPTS, FIRST_WAIT_S, OUTSTANDING_MAX
from swingd.model import parameters as model_parameters
from swingd.model.events import AutopilotKind, Stream
from swingd.model.parameters import Endpoint, Mode, Parameters, ShaperName, ThrustSource
from swingd.sim.peer import SimulatedAutopilot

PX4, COPTER, OTHER = AutopilotKind.PX4, AutopilotKind.ARDUPILOT, AutopilotKind.OTHER
DANGER, WARNING, HINT = AdviceSeverity.DANGER, AdviceSeverity.WARNING, AdviceSeverity.HINT
RATES_HZ = {
    Stream.IMU: 250.0,
    Stream.ATTITUDE: 100.0,
    Stream.THROTTLE: 100.0,
    Stream.MOTORS: 100.0,
    Stream.BATTERY: 10.0,
    Stream.LOCAL_POSITION: 50.0,
    Stream.LANDED_STATE: 2.0,
}
HOLD = replace(Parameters(), mode=Mode.HOLD)

# ---- reading


def autopilot(kind: AutopilotKind = PX4) -> AutopilotId:
    return AutopilotId(1, 1, kind)


def sent_by(message: Any, system: int = 1, component: int = 1) -> Any:
    """The message as it arrives."""
    (frame,) = Codec(9, 9).receive(Codec(system, component).encode(message))
    return frame.message


def value(name: str, number: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32) -> Any:
    return mavlink.MAVLink_param_value_message(name.encode(), number, kind, 1, 0)


def bits(number: int, form: str = "<i") -> float:
    packed = struct.pack(form, number)
    (as_float,) = struct.unpack("<f", packed.ljust(4, b"\0"))
    return float(as_float)


def times(seconds: float, step_s: float = 0.05) -> Iterator[float]:
    return (i * step_s for i in range(round(seconds / step_s)))


def names_in(messages: list[Any]) -> list[str]:
    return [message.param_id for message in messages]


def ask(reader: ParameterReader, peer: SimulatedAutopilot, seconds: float, lost_every: int = 0) -> float:
    """Let a reader ask a simulated autopilot; return when it was done [s]."""
    codec = Codec(1, 191)
    requests = 0
    for t_s in times(seconds):
        for message in reader.tick(t_s):
            requests += 1
            if not lost_every or requests % lost_every:
                peer.receive(codec.encode(message))
        for data in peer.advance(peer.t_s + 0.05):
            for frame in codec.receive(data):
                reader.take(frame.message)
        if reader.done:
            return t_s
    raise AssertionError(f"not done after {seconds} s: {reader.values.keys()} {reader.missing}")


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_every_parameter_of_a_simulated_autopilot_is_read_as_it_is(kind: AutopilotKind) -> None:
    base = Parameters()
    face = model_parameters.SimulatedKind(kind.value)
    peer = SimulatedAutopilot(replace(base, simulation=replace(base.simulation, autopilot=face)))
    names = [*peer.parameters, "NO_SUCH_NAME"]
    reader = ParameterReader(autopilot(kind), names)
    done_s = ask(reader, peer, 30.0)
    assert reader.values == {name: pytest.approx(peer.parameters[name]) for name in peer.parameters}
    assert reader.missing == {"NO_SUCH_NAME"}
    assert done_s < 0.3 * len(names) + FIRST_WAIT_S * 2**ATTEMPTS


def test_lost_requests_are_made_again() -> None:
    reader = ParameterReader(autopilot(), parameters_of(PX4))
    ask(reader, SimulatedAutopilot(Parameters()), 30.0, lost_every=3)
    assert reader.values["COM_OBL_RC_ACT"] == 0.0
    assert reader.values["MPC_XY_VEL_P_ACC"] == pytest.approx(1.8)


def test_requests_are_paced_and_unknown_names_keep_nobody_waiting() -> None:
    unknown = [f"UNKNOWN_{i}" for i in range(12)]
    reader = ParameterReader(autopilot(), [*unknown, "KNOWN"])
    known_s = None
    asked: list[tuple[float, str]] = []
    for t_s in times(20.0):
        messages = reader.tick(t_s)
        asked += [(t_s, name) for name in names_in(messages)]
        recent = [at for at, name in asked if t_s - at < 0.2 and name != "KNOWN"]
        assert len(recent) <= OUTSTANDING_MAX
        if "KNOWN" in names_in(messages):
            reader.take(sent_by(value("KNOWN", 2.5)))
            known_s = known_s or t_s
        if reader.done:
            break
    assert known_s is not None
    assert known_s < 1.5
    assert reader.values == {"KNOWN": 2.5}
    assert reader.missing == set(unknown)
    assert all(sum(name == unknown_name for _, name in asked) == ATTEMPTS for unknown_name in unknown)
    assert reader.tick(100.0) == []


def test_patience_grows_from_request_to_request() -> None:
    reader = ParameterReader(autopilot(), ["NAME"])
    asked = [t_s for t_s in times(10.0, 0.01) if reader.tick(t_s)]
    gaps = [b - a for a, b in pairwise(asked)]
    assert gaps == pytest.approx([FIRST_WAIT_S * 2**i for i in range(ATTEMPTS - 1)], abs=0.011)
    assert reader.missing == {"NAME"}


@pytest.mark.parametrize(
    ("kind", "sent", "mav_type", "expected"),
    [
        (PX4, bits(5), mavlink.MAV_PARAM_TYPE_INT32, 5.0),
        (PX4, bits(-1), mavlink.MAV_PARAM_TYPE_INT32, -1.0),
        (PX4, bits(921600), mavlink.MAV_PARAM_TYPE_INT32, 921600.0),
        (PX4, bits(3_000_000_000, "<I"), mavlink.MAV_PARAM_TYPE_UINT32, 3e9),
        (PX4, bits(-3, "<b"), mavlink.MAV_PARAM_TYPE_INT8, -3.0),
        (PX4, 0.25, mavlink.MAV_PARAM_TYPE_REAL32, 0.25),
        (COPTER, 5.0, mavlink.MAV_PARAM_TYPE_INT8, 5.0),
        (COPTER, 57.0, mavlink.MAV_PARAM_TYPE_INT32, 57.0),
        (COPTER, 0.25, mavlink.MAV_PARAM_TYPE_REAL32, 0.25),
        (OTHER, 7.0, mavlink.MAV_PARAM_TYPE_INT32, 7.0),
    ],
)
def test_integers_are_bits_on_px4_and_numbers_elsewhere(
    kind: AutopilotKind, sent: float, mav_type: int, expected: float
) -> None:
    reader = ParameterReader(autopilot(kind), ["NAME"])
    reader.take(sent_by(value("NAME", sent, mav_type)))
    assert reader.values == {"NAME": expected}
    assert reader.done


def test_others_and_what_was_not_asked_for_are_left_alone() -> None:
    reader = ParameterReader(autopilot(), ["NAME"])
    reader.take(sent_by(value("NAME", 1.0), system=2))
    reader.take(sent_by(value("NAME", 1.0), component=191))
    reader.take(sent_by(value("ANOTHER", 1.0)))
    reader.take(sent_by(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)))
    reader.take(None)
    assert (reader.values, reader.missing, reader.done) == ({}, set(), False)


def test_a_value_that_is_no_number_is_missing_and_a_later_one_holds() -> None:
    reader = ParameterReader(autopilot(), ["NAME"])
    reader.take(sent_by(value("NAME", math.nan)))
    assert (reader.values, reader.missing, reader.done) == ({}, {"NAME"}, True)
    reader.take(sent_by(value("NAME", 3.0)))
    reader.take(sent_by(value("NAME", 4.0)))
    reader.take(sent_by(value("NAME", math.inf)))
    assert (reader.values, reader.missing) == ({"NAME": 4.0}, set())


@pytest.mark.skipif(not hasattr(mavlink, "MAVLink_param_error_message"), reason="younger than this pymavlink")
def test_an_error_ends_the_asking() -> None:
    reader = ParameterReader(autopilot(), ["NAME"])
    assert names_in(reader.tick(0.0)) == ["NAME"]
    reader.take(sent_by(mavlink.MAVLink_param_error_message(1, 191, b"NAME", -1, 1)))
    assert (reader.missing, reader.done) == ({"NAME"}, True)


@pytest.mark.parametrize("name", ["", "SEVENTEEN_LETTERS", "GRÖSSE"])
def test_a_name_that_cannot_be_asked_for_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="expected a parameter's name"):
        ParameterReader(autopilot(), [name])


@given(st.binary(min_size=25, max_size=25), st.sampled_from([PX4, COPTER, OTHER]))
def test_no_answer_raises(payload: bytes, kind: AutopilotKind) -> None:
    """Any payload of PARAM_VALUE, as the bytes of a link may spell it."""
    number, count, index, name, mav_type = struct.unpack("<fHH16sB", payload)
    message = sent_by(mavlink.MAVLink_param_value_message(name, number, mav_type, count, index))
    reader = ParameterReader(
        autopilot(kind), ["NAME", message.param_id.encode("ascii", "replace").decode()[:16] or "X"]
    )
    reader.take(message)
    assert all(math.isfinite(number) for number in reader.values.values())


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_every_name_can_be_asked_for_once(kind: AutopilotKind) -> None:
    names = parameters_of(kind)
    assert len(set(names)) == len(names)
    assert not ParameterReader(autopilot(kind), names).done
    assert parameters_of(OTHER) == ()


def test_it_is_there_before_anything_large_is_loaded() -> None:
    code = (
        "import sys, swingd.link.preflight; "
        "print(sorted(sys.modules.keys() & {'numpy', 'numba', 'pydantic', 'rich', 'structlog', 'yaml', 'typer'}))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout == "[]\n"


# ---- the link's budget


def test_the_budget_is_that_of_full_frames() -> None:
    """Against frames that pymavlink packs with no zero at their end."""
    packed = {
        Stream.IMU: mavlink.MAVLink_highres_imu_message(1, *([1.0] * 13), 63, 1),
        Stream.ATTITUDE: mavlink.MAVLink_attitude_message(1, *([1.0] * 6)),
        Stream.MOTORS: mavlink.MAVLink_actuator_output_status_message(1, 16, [1.0] * 32),
        Stream.LANDED_STATE: mavlink.MAVLink_extended_sys_state_message(1, 1),
    }
    for stream, message in packed.items():
        frame = Codec(1, 1).encode(message)
        assert carrier(PX4, stream) == message.get_msgId()
        assert link_budget(PX4, {stream: 10.0}).streams_bytes_per_s == 10.0 * len(frame)
    both = link_budget(PX4, {Stream.IMU: 250.0, Stream.LANDED_STATE: 2.0})
    assert both.streams_bytes_per_s == 250.0 * 75 + 2.0 * 14
    assert both.needed_bytes_per_s == pytest.approx(1.2 * both.streams_bytes_per_s)


def test_the_budget_names_the_slowest_line_that_does() -> None:
    assert link_budget(PX4, RATES_HZ).baud == 921600
    assert link_budget(PX4, {Stream.LANDED_STATE: 2.0}).baud == 57600
    assert link_budget(PX4, {Stream.MOTORS: 5000.0}).baud is None


def test_ardupilot_is_asked_for_no_more_than_it_gives() -> None:
    asked = link_budget(COPTER, {Stream.IMU: 1000.0})
    assert asked.streams_bytes_per_s == 200.0 * 75


# ---- advice

PX4_GOOD: Mapping[str, float] = {
    "COM_OBL_RC_ACT": 5,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 4,
    "COM_RC_IN_MODE": 3,
    "MC_BAT_SCALE_EN": 0,
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_XY_VEL_I_ACC": 0.4,
    "MPC_XY_VEL_D_ACC": 0.2,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_ACC_HOR": 3.0,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_THR_HOVER": 0.64,
    "MPC_USE_HTE": 1,
    "THR_MDL_FAC": 0.0,
    "IMU_INTEG_RATE": 200,
    "MAV_0_CONFIG": 101,
    "MAV_0_MODE": 0,
    "MAV_0_RATE": 1200,
    "MAV_1_CONFIG": 102,
    "MAV_1_MODE": 2,
    "MAV_1_RATE": 80000,
    "MAV_2_CONFIG": 0,
    "MAV_2_MODE": 0,
    "MAV_2_RATE": 0,
    "SER_TEL1_BAUD": 57600,
    "SER_TEL2_BAUD": 921600,
}
COPTER_GOOD: Mapping[str, float] = {
    "GUID_TIMEOUT": 3.0,
    "GUID_OPTIONS": 0,
    "MOT_BAT_VOLT_MAX": 0.0,
    "MOT_BAT_VOLT_MIN": 0.0,
    "PSC_VELXY_P": 1.8,
    "PSC_VELXY_I": 0.4,
    "PSC_VELXY_D": 0.2,
    "ANGLE_MAX": 3000,
    "MOT_THST_HOVER": 0.6,
    "MOT_HOVER_LEARN": 2,
    "MOT_THST_EXPO": 0.0,
    "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95,
    "FS_GCS_ENABLE": 0,
    "FS_THR_ENABLE": 1,
    "FS_OPTIONS": 20,
    "SERIAL1_PROTOCOL": 2,
    "SERIAL1_BAUD": 57,
    "SERIAL2_PROTOCOL": 2,
    "SERIAL2_BAUD": 921,
    "SR1_RAW_SENS": 2,
}
GOOD = {PX4: PX4_GOOD, COPTER: COPTER_GOOD}


def found(
    kind: AutopilotKind, changes: Mapping[str, float] | None = None, parameters: Parameters = HOLD, **more: Any
) -> list[Any]:
    options: dict[str, Any] = {"hover_throttle": 0.64, "rates_hz": RATES_HZ, **more}
    return advise(kind, {**GOOD[kind], **(changes or {})}, parameters, **options)


def serial(baud: int, parameters: Parameters = HOLD) -> Parameters:
    return replace(parameters, link=replace(parameters.link, autopilot=f"serial:///dev/ttyAMA0:{baud}"))


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_a_good_set_needs_no_advice(kind: AutopilotKind) -> None:
    assert found(kind) == []
    assert found(kind, parameters=serial(921600)) == []


@pytest.mark.parametrize(
    ("changes", "severity", "remedy"),
    [
        ({"COM_OBL_RC_ACT": 0}, DANGER, "COM_OBL_RC_ACT = 5"),
        ({"COM_OBL_RC_ACT": 1}, DANGER, "COM_OBL_RC_ACT = 5"),
        ({"COM_OBL_RC_ACT": 2}, DANGER, "COM_OBL_RC_ACT = 5"),
        ({"COM_OBL_RC_ACT": 6}, DANGER, "COM_OBL_RC_ACT = 5"),
        ({"COM_OBL_RC_ACT": 7}, DANGER, "COM_OBL_RC_ACT = 5"),
        ({"COM_OBL_RC_ACT": 3}, HINT, "COM_OBL_RC_ACT = 5"),
        ({"COM_OF_LOSS_T": 0.5}, WARNING, "COM_OF_LOSS_T = 1"),
        ({"COM_OF_LOSS_T": 5.0}, WARNING, "COM_OF_LOSS_T = 1"),
        ({"COM_RCL_EXCEPT": 3}, HINT, "COM_RCL_EXCEPT = 7"),
        ({"MPC_XY_VEL_P_ACC": 2.4}, WARNING, "autopilot.velocity_p: 2.4"),
        ({"MPC_XY_VEL_I_ACC": 1.0}, WARNING, "autopilot.velocity_i: 1"),
        ({"MPC_XY_VEL_D_ACC": 0.0}, WARNING, "autopilot.velocity_d: 0"),
        ({"MPC_XY_VEL_MAX": 2.0}, WARNING, "MPC_XY_VEL_MAX = 3.0"),
        ({"MPC_ACC_HOR": 5.0}, HINT, "MPC_ACC_HOR = 2 .. 3"),
        ({"MPC_TILTMAX_AIR": 15.0}, WARNING, "control.acc_max_mps2 to 1.7"),
        ({"MPC_TILTMAX_AIR": 20.0}, HINT, "MPC_TILTMAX_AIR = 26"),
        ({"MPC_THR_HOVER": 0.3}, HINT, "MPC_THR_HOVER = 0.64"),
        ({"MPC_USE_HTE": 0}, WARNING, "MPC_USE_HTE = 1"),
        ({"THR_MDL_FAC": 0.3, "MPC_THR_HOVER": 0.57}, WARNING, "thrust.source: motors"),
        ({"MC_BAT_SCALE_EN": 1}, HINT, "nothing"),
        ({"IMU_INTEG_RATE": 50}, WARNING, "IMU_INTEG_RATE = 200"),
        ({"IMU_INTEG_RATE": 400}, HINT, "IMU_INTEG_RATE = 250"),
        ({"MAV_1_RATE": 0}, WARNING, "MAV_1_RATE = 55000"),
        ({"MAV_1_RATE": 1200}, WARNING, "MAV_1_RATE = 55000"),
        ({"SER_TEL2_BAUD": 57600}, WARNING, "SER_TEL2_BAUD = 921600"),
        ({"MAV_1_CONFIG": 1000, "MAV_1_RATE": 1200}, WARNING, "MAV_1_RATE = 55000"),
    ],
)
def test_px4_one_thing_wrong_is_one_advice(changes: dict[str, float], severity: AdviceSeverity, remedy: str) -> None:
    (advice,) = found(PX4, changes)
    assert advice.severity is severity
    assert advice.name in changes
    assert remedy in advice.remedy
    assert advice.value.startswith(f"{changes[advice.name]:.6g}"[:3])


@pytest.mark.parametrize(
    ("changes", "severity", "remedy"),
    [
        ({"GUID_TIMEOUT": 5.0}, WARNING, "GUID_TIMEOUT = 1 .. 3"),
        ({"GUID_TIMEOUT": 10.0}, DANGER, "GUID_TIMEOUT = 1 .. 3"),
        ({"GUID_TIMEOUT": 0.5}, WARNING, "GUID_TIMEOUT = 1 .. 3"),
        ({"GUID_OPTIONS": 1 + 32}, DANGER, "GUID_OPTIONS = 1"),
        ({"GUID_OPTIONS": 16}, WARNING, "GUID_OPTIONS = 0"),
        ({"GUID_OPTIONS": 64}, WARNING, "GUID_OPTIONS = 0"),
        ({"PSC_VELXY_P": 2.0}, WARNING, "autopilot.velocity_p: 2"),
        ({"PSC_NE_VEL_I": 1.0}, WARNING, "autopilot.velocity_i: 1"),
        ({"PSC_VELXY_D": 0.5}, WARNING, "autopilot.velocity_d: 0.5"),
        ({"ANGLE_MAX": 1500}, WARNING, "ANGLE_MAX = 2600"),
        ({"ATC_ANGLE_MAX": 15.0}, WARNING, "ATC_ANGLE_MAX = 26"),
        ({"PSC_ANGLE_MAX": 15.0}, WARNING, "PSC_ANGLE_MAX = 26"),
        ({"MOT_THST_HOVER": 0.2}, HINT, "MOT_THST_HOVER = 0.61"),
        ({"MOT_THST_EXPO": 0.65, "MOT_THST_HOVER": 0.46}, WARNING, "thrust.source: motors"),
        ({"MOT_BAT_VOLT_MAX": 16.8, "MOT_BAT_VOLT_MIN": 13.2}, HINT, "nothing"),
        ({"MOT_BAT_VOLT_MAX": 12.0, "MOT_BAT_VOLT_MIN": 13.2}, WARNING, "MOT_BAT_VOLT_MAX = 4.2 V"),
        ({"FS_GCS_ENABLE": 1}, HINT, "HEARTBEAT"),
        ({"FS_THR_ENABLE": 0}, WARNING, "FS_GCS_ENABLE = 1"),
        ({"FS_OPTIONS": 16, "FS_THR_ENABLE": 1}, HINT, "FS_OPTIONS = 20"),
        ({"FS_OPTIONS": 52}, WARNING, "FS_OPTIONS = 20"),
        ({"SR1_RAW_SENS": 50}, HINT, "SR1_RAW_SENS = 2"),
        ({"MAV2_RAW_SENS": 20}, HINT, "MAV2_RAW_SENS = 2"),
    ],
)
def test_copter_one_thing_wrong_is_one_advice(changes: dict[str, float], severity: AdviceSeverity, remedy: str) -> None:
    (advice,) = found(COPTER, changes)
    assert advice.severity is severity
    assert advice.name in changes
    assert remedy in advice.remedy


@pytest.mark.parametrize(("loss_s", "advised"), [(0.5, False), (0.2, True), (1.0, True), (5.0, True)])
def test_a_load_that_is_led_wants_a_shorter_loss_time(loss_s: float, advised: bool) -> None:
    advice = found(PX4, {"COM_OF_LOSS_T": loss_s}, replace(HOLD, mode=Mode.PATH))
    assert [one.remedy for one in advice] == (["COM_OF_LOSS_T = 0.5"] if advised else [])


def test_a_gain_of_the_new_name_stands_over_one_of_the_old() -> None:
    assert found(COPTER, {"PSC_NE_VEL_P": 1.8, "PSC_VELXY_P": 5.0}) == []


def test_with_a_remote_control_the_hand_over_is_no_danger() -> None:
    (advice,) = found(PX4, {"COM_OBL_RC_ACT": 0}, remote_control=True)
    assert (advice.severity, advice.name) == (WARNING, "COM_OBL_RC_ACT")
    assert "hands at the sticks" in advice.meaning
    assert "sinks" in found(PX4, {"COM_OBL_RC_ACT": 0}, remote_control=False)[0].meaning


@pytest.mark.parametrize(
    ("kind", "changes"),
    [(PX4, {"COM_OBL_RC_ACT": 0}), (PX4, {"COM_OBL_RC_ACT": 7}), (COPTER, {"GUID_TIMEOUT": 10.0})],
)
def test_who_only_watches_is_in_no_danger_from_setpoints(kind: AutopilotKind, changes: dict[str, float]) -> None:
    assert [advice.severity for advice in found(kind, changes)] == [DANGER]
    assert [advice.severity for advice in found(kind, changes, replace(HOLD, mode=Mode.SHADOW))] == [WARNING]


def test_without_sticks_their_loss_is_no_matter() -> None:
    assert found(PX4, {"COM_RCL_EXCEPT": 0, "COM_RC_IN_MODE": 4}) == []


def test_the_velocity_limit_is_judged_by_what_is_asked_for() -> None:
    limit = {"MPC_XY_VEL_MAX": 8.0}
    assert found(PX4, limit) == []
    fast = replace(HOLD, hold=replace(HOLD.hold, vel_ned_mps=(6.0, 3.5, 0.0)))
    (advice,) = found(PX4, limit, fast)
    assert "MPC_XY_VEL_MAX = 8.4" in advice.remedy
    shaped = replace(HOLD, mode=Mode.INLINE, endpoints=(Endpoint(shaper=ShaperName.ZV),))
    (advice,) = found(PX4, limit, shaped)
    assert "shaping.vel_max_mps of more than 6.5 m/s" in advice.meaning
    assert "MPC_XY_VEL_MAX = 9.5" in advice.remedy


def test_hover_is_compared_in_the_autopilots_own_measure() -> None:
    """The curve's 64 % of the motors' signal are 55 % of the thrust where the autopilot bends its curve by half."""
    thrust = 0.5 * 0.64**2 + 0.5 * 0.64
    motors = replace(HOLD, thrust=replace(HOLD.thrust, source=ThrustSource.MOTORS))
    assert found(PX4, {"THR_MDL_FAC": 0.5, "MPC_THR_HOVER": thrust}, motors) == []
    (advice,) = found(PX4, {"THR_MDL_FAC": 0.5, "MPC_THR_HOVER": thrust - 0.11}, motors)
    assert f"hover at {thrust:.2f}" in advice.meaning
    throttle = replace(HOLD, thrust=replace(HOLD.thrust, source=ThrustSource.THROTTLE))
    assert found(PX4, {"THR_MDL_FAC": 0.5, "MPC_THR_HOVER": 0.64}, throttle) == []
    (advice,) = found(PX4, {"MPC_THR_HOVER": 0.3, "MPC_USE_HTE": 0})[1:]
    assert advice.severity is WARNING, "nothing learns it"
    assert found(PX4, {"MPC_THR_HOVER": 0.3}, hover_throttle=None) == []


def test_copters_thrust_is_that_of_its_own_formula() -> None:
    """Signal between spin_min and spin_max, then the quadratic; 0.15 + 0.8 x 0.5 gives 0.4125 with expo 0.35."""
    motors = replace(HOLD, thrust=replace(HOLD.thrust, source=ThrustSource.MOTORS))
    changes = {"MOT_THST_EXPO": 0.35, "MOT_THST_HOVER": 0.1}
    (advice,) = found(COPTER, changes, motors, hover_throttle=0.15 + 0.8 * 0.5)
    assert "MOT_THST_HOVER = 0.41" in advice.remedy


@pytest.mark.parametrize(
    ("source", "exponent", "compensated", "expected"),
    [
        (ThrustSource.AUTO, 2.0, 0, None),
        (ThrustSource.AUTO, 0.0, 0, HINT),
        (ThrustSource.AUTO, 2.0, 1, HINT),
        (ThrustSource.AUTO, 0.0, 1, WARNING),
        (ThrustSource.MOTORS, 0.0, 1, WARNING),
        (ThrustSource.THROTTLE, 0.0, 1, None),
        (ThrustSource.REMARK_1, 0.0, 0, None),
    ],
)
def test_the_voltage_exponent_follows_the_compensation(
    source: ThrustSource, exponent: float, compensated: int, expected: AdviceSeverity | None
) -> None:
    parameters = replace(HOLD, thrust=replace(HOLD.thrust, source=source, voltage_exponent=exponent))
    severities = [advice.severity for advice in found(PX4, {"MC_BAT_SCALE_EN": compensated}, parameters)]
    assert severities == ([] if expected is None else [expected])
    volts = {"MOT_BAT_VOLT_MAX": 16.8 * compensated, "MOT_BAT_VOLT_MIN": 13.2 * compensated}
    assert [advice.severity for advice in found(COPTER, volts, parameters)] == severities


@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        (PX4, {"MC_BAT_SCALE_EN": 0}, False),
        (PX4, {"MC_BAT_SCALE_EN": 1}, True),
        (PX4, {"MOT_BAT_VOLT_MAX": 16.8}, None),
        (COPTER, {"MOT_BAT_VOLT_MAX": 0.0}, False),
        (COPTER, {"MOT_BAT_VOLT_MAX": 16.8}, True),
        (COPTER, {"MOT_BAT_VOLT_MAX": 16.8, "MOT_BAT_VOLT_MIN": 13.2}, True),
        (COPTER, {"MOT_BAT_VOLT_MAX": 13.2, "MOT_BAT_VOLT_MIN": 13.2}, False),
        (COPTER, {"MOT_BAT_VOLT_MAX": -1.0}, False),
        (COPTER, {}, None),
        (OTHER, {"MC_BAT_SCALE_EN": 1}, None),
    ],
)
def test_voltage_compensation(kind: AutopilotKind, values: dict[str, float], expected: bool | None) -> None:
    assert voltage_compensated(kind, values) is expected


def test_a_serial_line_that_is_too_slow_is_named_with_what_to_set() -> None:
    slow = serial(57600)
    (advice,) = found(COPTER, parameters=slow)
    assert (advice.severity, advice.name) == (WARNING, "SERIAL1_BAUD")
    assert "5760 bytes/s" in advice.meaning
    assert "SERIAL1_BAUD = 460" in advice.remedy
    (advice,) = found(COPTER, {"SERIAL2_BAUD": 57}, slow)
    assert advice.name == "link.autopilot", "which of the two ports it is cannot be known"
    nothing_onboard = {"MAV_1_MODE": 0}
    assert [advice.name for advice in found(PX4, nothing_onboard, slow)] == ["link.autopilot", "MAV_n_MODE"]
    assert [advice.name for advice in found(PX4, nothing_onboard, serial(921600))] == ["MAV_n_MODE"]
    assert found(PX4, nothing_onboard) == [], "another link than a serial one"


def test_a_rate_of_zero_is_half_the_line_or_the_network() -> None:
    assert found(PX4, {"MAV_1_RATE": 0, "SER_TEL2_BAUD": 1500000}) == []
    assert found(PX4, {"MAV_1_CONFIG": 1000, "MAV_1_RATE": 0}) == []
    slower = replace(HOLD, link=replace(HOLD.link, imu_rate_hz=100.0))
    advices = found(PX4, {"MAV_1_RATE": 0}, slower, rates_hz={**RATES_HZ, Stream.IMU: 100.0})
    assert [advice.name for advice in advices] == ["IMU_INTEG_RATE"], "the line does it, at the price of the IMU"
    assert found(PX4, {"MAV_1_RATE": 0}, rates_hz={}) == [], "not known what is asked for"


@pytest.mark.parametrize(
    ("asked_hz", "integrated_hz", "remedy"),
    [
        (250.0, 400, "IMU_INTEG_RATE = 250, or link.imu_rate_hz = 400 where the link carries it"),
        (200.0, 400, "IMU_INTEG_RATE = 200, or link.imu_rate_hz = 400 where the link carries it"),
        (100.0, 200, "IMU_INTEG_RATE = 100, or link.imu_rate_hz = 200 where the link carries it"),
        (50.0, 200, "link.imu_rate_hz = 200 where the link carries it"),
    ],
)
def test_imu_samples_that_are_left_out_are_told(asked_hz: float, integrated_hz: int, remedy: str) -> None:
    asked = replace(HOLD, link=replace(HOLD.link, imu_rate_hz=asked_hz))
    (advice,) = found(PX4, {"IMU_INTEG_RATE": integrated_hz}, asked)
    assert (advice.severity, advice.name, advice.remedy) == (HINT, "IMU_INTEG_RATE", remedy)


def test_of_an_unknown_autopilot_nothing_is_said() -> None:
    assert advise(OTHER, PX4_GOOD, HOLD, hover_throttle=0.64, rates_hz=RATES_HZ) == []


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_what_is_not_known_is_not_judged(kind: AutopilotKind) -> None:
    assert advise(kind, {}, HOLD, hover_throttle=0.64, rates_hz=RATES_HZ) == []


@pytest.mark.parametrize("kind", [PX4, COPTER])
@given(data=st.data())
def test_whatever_the_values_the_most_severe_comes_first_in_whole_words(kind: AutopilotKind, data: Any) -> None:
    names = data.draw(st.lists(st.sampled_from(parameters_of(kind)), unique=True))
    number = st.floats(-3.4e38, 3.4e38, allow_nan=False) | st.integers(-(2**31), 2**31).map(float) | st.just(0.0)
    values = {name: data.draw(number) for name in names}
    throttle = data.draw(st.none() | st.floats(0.0, 1.0))
    advices = advise(
        kind, values, serial(57600), hover_throttle=throttle, remote_control=data.draw(st.none() | st.booleans())
    )
    assert [advice.severity for advice in advices] == sorted(advice.severity for advice in advices)
    for advice in advices:
        assert all((advice.name, advice.value, advice.meaning, advice.remedy))
        assert "{" not in advice.remedy
