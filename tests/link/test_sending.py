import math
from operator import attrgetter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link import swing_message
from swingd.link.adapter import AutopilotAdapter, Drop
from swingd.link.codec import Codec
from swingd.model.actions import Action, Health, Heartbeat, Setpoint, Severity, StatusText, StreamRequest, SwingReport
from swingd.model.disturbance import DisturbanceEstimate
from swingd.model.events import SetpointUse, Stream, StreamRefused
from swingd.model.parameters import Link, Thrust

from .messages import Autopilot, actuators, copter_heartbeat, px4_heartbeat, raw_imu, servos

REPORT = SwingReport(
    t_boot_s=123.456789,
    xi_rad=0.1,
    zeta_rad=-0.2,
    xi_rate_radps=0.3,
    zeta_rate_radps=-0.4,
    force_ned_n=(1.0, 2.0, 3.0),
    xi_std_rad=0.01,
    zeta_std_rad=0.02,
    thrust_n=17.5,
    thrust_scale=0.98,
    nis=2.5,
    correction_acc_ned_mps2=(0.5, 0.6, 0.0),
    correction_vel_ned_mps=(-0.5, -0.6, 0.0),
    health=Health.ACTIVE,
    disturbance=DisturbanceEstimate((1.5, -2.5, 3.5), (0.2, 0.3, 0.4), ""),
    feed_forward_acc_ned_mps2=(-0.7, 0.8, 0.0),
)


def connected(heartbeat=None) -> tuple[AutopilotAdapter, Autopilot]:
    adapter, autopilot = AutopilotAdapter(Link(), Thrust()), Autopilot(7)
    adapter.receive(0.0, autopilot(heartbeat or px4_heartbeat()))
    return adapter, autopilot


def sent(adapter: AutopilotAdapter, action: Action) -> list:
    messages = adapter.messages(action)
    assert messages
    encoder = Codec(adapter.system_id, 191)
    return [frame.message for frame in Codec(1, 1).receive(b"".join(map(encoder.encode, messages)))]


def setpoint(use: SetpointUse, t_boot_s: float = 12.3456, vel=(1.0, 2.0, 3.0)) -> Setpoint:
    return Setpoint(t_boot_s, use, (math.nan, 5.0, 6.0), vel, (7.0, 8.0, 9.0), 0.5, 0.25)


def test_before_an_autopilot_is_known_only_the_heartbeat_leaves():
    adapter = AutopilotAdapter(Link(), Thrust())
    actions = [setpoint(SetpointUse.VEL), REPORT, StatusText(Severity.INFO, "x"), StreamRequest(Stream.IMU, 250.0)]
    assert [adapter.messages(action) for action in actions] == [[]] * 4
    assert adapter.drops == {Drop.OUTGOING: 4}
    assert len(adapter.messages(Heartbeat(Health.INIT))) == 1
    assert adapter.system_id == 1
    assert AutopilotAdapter(Link(system_id=42), Thrust()).system_id == 42


@pytest.mark.parametrize(
    ("health", "state"),
    [
        (Health.INIT, mavlink.MAV_STATE_BOOT),
        (Health.READY, mavlink.MAV_STATE_STANDBY),
        (Health.ACTIVE, mavlink.MAV_STATE_ACTIVE),
        (Health.DEGRADED, mavlink.MAV_STATE_CRITICAL),
        (Health.FAULT, mavlink.MAV_STATE_EMERGENCY),
    ],
)
def test_heartbeat(health, state):
    adapter, _ = connected()
    (m,) = sent(adapter, Heartbeat(health))
    assert (m.type, m.autopilot, m.base_mode, m.system_status) == (18, 8, 0, state)


@pytest.mark.parametrize(
    ("use", "type_mask"),
    [
        (SetpointUse.VEL | SetpointUse.YAW, 0x9C7),
        (SetpointUse.POS_E | SetpointUse.YAW, 0xDFF - 0x400 - 2),
        (SetpointUse.VEL | SetpointUse.ACC | SetpointUse.YAW_RATE, 0x407),
        (SetpointUse.VEL_N | SetpointUse.VEL_E | SetpointUse.POS_D | SetpointUse.ACC, 0xDFF - 8 - 16 - 4 - 0x1C0),
    ],
)
def test_setpoint_uses_exactly_the_groups_that_are_meant(use, type_mask):
    adapter, _ = connected()
    (m,) = sent(adapter, setpoint(use))
    assert m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (m.target_system, m.target_component, m.coordinate_frame) == (7, 1, mavlink.MAV_FRAME_LOCAL_NED)
    assert m.type_mask == type_mask
    assert m.time_boot_ms == 12346
    given_values = (0.0, 5.0, 6.0, 1.0, 2.0, 3.0, 7.0, 8.0, 9.0)
    values = (m.x, m.y, m.z, m.vx, m.vy, m.vz, m.afx, m.afy, m.afz)
    assert values == tuple(v if use & 1 << bit else 0.0 for bit, v in enumerate(given_values))
    assert m.yaw == (0.5 if use & SetpointUse.YAW else 0.0)
    assert m.yaw_rate == (0.25 if use & SetpointUse.YAW_RATE else 0.0)


@pytest.mark.parametrize(
    "bad",
    [
        setpoint(SetpointUse.POS),
        setpoint(SetpointUse.VEL, vel=(0.0, math.inf, 0.0)),
        setpoint(SetpointUse.VEL, t_boot_s=math.nan),
        setpoint(SetpointUse.NONE),
    ],
)
def test_a_setpoint_that_is_not_finite_or_asks_nothing_does_not_leave(bad):
    adapter, _ = connected()
    assert adapter.messages(bad) == []
    assert adapter.drops == {Drop.OUTGOING: 1}


def test_the_stamp_of_a_setpoint_wraps_like_the_autopilots():
    adapter, _ = connected()
    (m,) = sent(adapter, setpoint(SetpointUse.VEL, t_boot_s=2**32 * 1e-3 + 1.0))
    assert m.time_boot_ms == 1000


def test_swing_layout_is_what_the_documents_say():
    adapter, _ = connected()
    (m,) = sent(adapter, REPORT)
    assert (m.get_type(), m.name, m.array_id, m.time_usec) == ("DEBUG_FLOAT_ARRAY", "SWING", 1, 123456789)
    expected = [0.1, -0.2, 0.3, -0.4, 1, 2, 3, 0.01, 0.02, 17.5, 0.98, 2.5, 0.5, 0.6, 0, -0.5, -0.6, 0, 2]
    expected += [1.5, -2.5, 3.5, 0.2, 0.3, 0.4, -0.7, 0.8, 0]
    assert m.data == pytest.approx(expected + [0.0] * 30, rel=1e-6)
    assert len(expected) == len(swing_message.FIELDS)


numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
reports = st.builds(
    SwingReport,
    t_boot_s=st.floats(0, 4e6).map(lambda t: round(t, 6)),
    **dict.fromkeys(
        ["xi_rad", "zeta_rad", "xi_rate_radps", "zeta_rate_radps", "xi_std_rad", "zeta_std_rad", "thrust_n"], numbers
    ),
    **dict.fromkeys(["thrust_scale", "nis"], numbers),
    force_ned_n=st.tuples(numbers, numbers, numbers),
    correction_acc_ned_mps2=st.tuples(numbers, numbers, numbers),
    correction_vel_ned_mps=st.tuples(numbers, numbers, numbers),
    health=st.sampled_from(Health),
    disturbance=st.none()
    | st.builds(
        DisturbanceEstimate,
        st.tuples(numbers, numbers, numbers),
        st.tuples(*(st.floats(1e-3, 1e3),) * 3),
        st.just(""),
    ),
    feed_forward_acc_ned_mps2=st.tuples(numbers, numbers, numbers),
)


@given(reports)
def test_swing_comes_back_as_it_was_to_the_precision_of_a_float(report):
    adapter, _ = connected()
    (m,) = sent(adapter, report)
    back = swing_message.decode(m)
    assert back is not None
    assert back.health is report.health
    assert (back.disturbance is None) == (report.disturbance is None)
    assert back.t_boot_s == pytest.approx(report.t_boot_s, abs=1e-6)
    for name in (
        *("xi_rad", "nis", "force_ned_n", "correction_vel_ned_mps", "feed_forward_acc_ned_mps2"),
        *(("disturbance.force_ned_n", "disturbance.force_std_n") if report.disturbance else ()),
    ):
        was, now = attrgetter(name)(report), attrgetter(name)(back)
        was, now = (value if isinstance(value, tuple) else (value,) for value in (was, now))
        for a, b in zip(was, now, strict=True):
            clipped = a if math.isnan(a) else max(-3.4028234e38, min(3.4028234e38, a))
            assert b == pytest.approx(clipped, rel=1e-6, abs=1e-37, nan_ok=True)


def test_other_arrays_are_not_read_as_swing():
    def array(name: bytes = b"SWING", array_id: int = 1, health: float = 0.0):
        data = [0.0] * 58
        data[18] = health
        raw = Codec(1, 1).encode(mavlink.MAVLink_debug_float_array_message(1, name, array_id, data))
        return Codec(1, 1).receive(raw)[0].message

    assert swing_message.decode(array()) is not None
    for other in (array(name=b"swing"), array(array_id=2), array(health=9.0), array(health=math.nan)):
        assert swing_message.decode(other) is None


def test_a_report_without_a_time_does_not_leave():
    adapter, _ = connected()
    assert len(adapter.messages(StatusText(Severity.INFO, "ok"))) == 1
    bad = SwingReport(**{name: getattr(REPORT, name) for name in SwingReport.__slots__} | {"t_boot_s": math.nan})
    assert adapter.messages(bad) == []


def test_a_short_text_is_one_message():
    adapter, _ = connected()
    (m,) = sent(adapter, StatusText(Severity.WARNING, "x" * 50))
    assert (m.severity, m.text, m.id, m.chunk_seq) == (4, "x" * 50, 0, 0)


@pytest.mark.parametrize("text", ["a" * 51, "b" * 100, "swing 12° " * 30, "cut\0here " * 20])
def test_a_long_text_comes_in_numbered_chunks_that_end_with_a_zero(text):
    adapter, _ = connected()
    messages = sent(adapter, StatusText(Severity.INFO, text))
    assert [m.chunk_seq for m in messages] == list(range(len(messages)))
    assert {m.id for m in messages} == {1}
    raw = [m._text_raw for m in messages]
    assert all(len(chunk) == 50 for chunk in raw[:-1])
    assert len(raw[-1]) < 50
    assert b"".join(raw).decode() == text.replace("\0", " ").rstrip("\0")
    assert {m.id for m in sent(adapter, StatusText(Severity.INFO, text))} == {2}


@pytest.mark.parametrize(
    ("stream", "ids"),
    [
        (Stream.IMU, [105]),
        (Stream.ATTITUDE, [30]),
        (Stream.THROTTLE, [83]),
        (Stream.MOTORS, [375]),
        (Stream.BATTERY, [147]),
        (Stream.LOCAL_POSITION, [32]),
        (Stream.LANDED_STATE, [245]),
    ],
)
def test_streams_are_asked_for_by_interval(stream, ids):
    adapter, _ = connected()
    messages = sent(adapter, StreamRequest(stream, 250.0))
    assert [(m.command, m.param1, m.param2) for m in messages] == [(511, i, 4000.0) for i in ids]
    assert {(m.target_system, m.target_component) for m in messages} == {(7, 1)}
    assert sent(adapter, StreamRequest(stream, 0.0))[0].param2 == -1.0
    assert adapter.messages(StreamRequest(stream, math.nan)) == []


def ack(result: int, command: int = 511, component: int = 191):
    return mavlink.MAVLink_command_ack_message(command, result, 0, 0, 7, component)


def test_a_denied_stream_is_told_with_its_name():
    adapter, autopilot = connected()
    for stream in (Stream.IMU, Stream.ATTITUDE):
        adapter.messages(StreamRequest(stream, 100.0))
    data = autopilot(ack(0), ack(5), ack(0, command=400), ack(4, component=190), ack(2))
    assert adapter.receive(0.1, data) == [StreamRefused(0.1, Stream.ATTITUDE, "ATTITUDE: MAV_RESULT_DENIED")]
    assert adapter.receive(0.2, autopilot(ack(2))) == []


def asked(adapter: AutopilotAdapter, stream: Stream) -> list[int]:
    return [int(m.param1) for m in sent(adapter, StreamRequest(stream, 100.0))]


def test_motors_are_refused_only_when_both_messages_are():
    adapter, autopilot = connected()
    assert asked(adapter, Stream.MOTORS) == [375]
    assert adapter.receive(0.1, autopilot(ack(4))) == []
    assert asked(adapter, Stream.MOTORS) == [36]
    assert adapter.receive(0.2, autopilot(ack(4))) == [
        StreamRefused(0.2, Stream.MOTORS, "SERVO_OUTPUT_RAW: MAV_RESULT_FAILED")
    ]
    assert asked(adapter, Stream.MOTORS) == [375]


def test_servo_outputs_are_asked_for_only_where_no_actuator_status_comes():
    adapter, autopilot = connected()
    for t_s in (0.0, 2.0, 20.0):
        adapter.receive(t_s, autopilot(actuators(1.0 + t_s, [1500] * 4)))
        assert asked(adapter, Stream.MOTORS) == [375]
    adapter, autopilot = connected()
    assert asked(adapter, Stream.MOTORS) == [375]
    adapter.receive(0.5, autopilot(ack(0)))
    assert asked(adapter, Stream.MOTORS) == [375]
    adapter.receive(2.0, autopilot(px4_heartbeat()))
    assert asked(adapter, Stream.MOTORS) == [36]
    adapter.receive(2.1, autopilot(ack(0), servos(3.0, [1500] * 4)))
    assert asked(adapter, Stream.MOTORS) == [36]


@pytest.mark.parametrize(
    ("stream", "ids"),
    [
        (Stream.IMU, [105, 27, 26]),
        (Stream.THROTTLE, [83, 74]),
        (Stream.MOTORS, [36]),
        (Stream.ATTITUDE, [30]),
        (Stream.REMOTE_CONTROL, [65]),
    ],
)
@pytest.mark.parametrize("denied", [True, False])
def test_an_ardupilot_is_asked_for_the_next_message_when_one_is_denied_or_silent(stream, ids, denied):
    adapter, autopilot = connected(copter_heartbeat())
    for number, msg_id in enumerate(ids):
        t_s = 2.0 * (number + 1)
        assert asked(adapter, stream) == [msg_id]
        refused = adapter.receive(t_s, autopilot(ack(2 if denied else 0), copter_heartbeat()))[:-1]
        last = number == len(ids) - 1
        assert [event.stream for event in refused] == ([stream] if denied and last else [])
    assert asked(adapter, stream) == [ids[0]]


def test_what_an_ardupilot_sends_is_asked_for_again_whatever_else_was_denied():
    adapter, autopilot = connected(copter_heartbeat())
    asked(adapter, Stream.IMU)
    adapter.receive(0.1, autopilot(ack(2)))
    assert asked(adapter, Stream.IMU) == [27]
    for t_s in (0.5, 5.0, 30.0):
        adapter.receive(t_s, autopilot(ack(0), raw_imu(1.0 + t_s)))
        assert asked(adapter, Stream.IMU) == [27]


def test_an_ardupilot_is_not_asked_for_a_rate_that_it_denies():
    adapter, _ = connected(copter_heartbeat())
    assert [m.param2 for m in sent(adapter, StreamRequest(Stream.IMU, 250.0))] == [5000.0]
    assert [m.param2 for m in sent(adapter, StreamRequest(Stream.IMU, 100.0))] == [10000.0]


def test_a_restarted_autopilot_is_asked_anew():
    adapter, autopilot = connected(copter_heartbeat())
    asked(adapter, Stream.IMU)
    adapter.receive(0.1, autopilot(ack(2)))
    assert asked(adapter, Stream.IMU) == [27]
    for i in range(300):
        adapter.receive(1.0 + i * 0.01, autopilot(raw_imu(100.0 + i * 0.01)))
    for i in range(100):
        adapter.receive(4.0 + i * 0.01, autopilot(raw_imu(1.0 + i * 0.01)))
    assert asked(adapter, Stream.IMU) == [105]


def questions(adapter: AutopilotAdapter, t_mono_s: float) -> list[tuple[int, int]]:
    return [(m.command, int(m.param1)) for m in adapter.tick(t_mono_s)]


def test_origin_and_home_are_asked_for_until_they_are_known():
    adapter = AutopilotAdapter(Link(), Thrust())
    autopilot = Autopilot(7)
    assert adapter.tick(0.0) == []
    adapter.receive(0.0, autopilot(px4_heartbeat()))
    assert questions(adapter, 0.1) == [(512, 49), (512, 242)]
    assert {(m.target_system, m.target_component) for m in adapter.tick(5.2)} == {(7, 1)}
    assert questions(adapter, 7.0) == []
    adapter.receive(8.0, autopilot(mavlink.MAVLink_gps_global_origin_message(470000000, 80000000, 488000)))
    assert questions(adapter, 10.5) == [(512, 242)]
    home = mavlink.MAVLink_home_position_message(470000000, 80000000, 488000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
    adapter.receive(11.0, autopilot(home))
    assert questions(adapter, 20.0) == []


def test_the_remote_control_is_asked_for_only_where_it_switches():
    for channel, expected in ((0, []), (7, [(511, 65)])):
        adapter = AutopilotAdapter(Link(rc_channel=channel), Thrust())
        autopilot = Autopilot(7)
        adapter.receive(0.0, autopilot(px4_heartbeat()))
        assert questions(adapter, 0.1)[2:] == expected
        channels = mavlink.MAVLink_rc_channels_message(1, 18, *([1500] * 18), 100)
        adapter.receive(5.0, autopilot(channels))
        assert questions(adapter, 5.5)[2:] == []
        assert questions(adapter, 16.5)[2:] == expected


def test_an_answer_that_never_came_is_given_up():
    adapter, autopilot = connected()
    adapter.messages(StreamRequest(Stream.IMU, 100.0))
    adapter.receive(5.0, autopilot(px4_heartbeat()))
    adapter.messages(StreamRequest(Stream.BATTERY, 10.0))
    (refused,) = adapter.receive(5.1, autopilot(ack(3)))
    assert refused.stream is Stream.BATTERY
