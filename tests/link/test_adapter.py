import math
import struct
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotAdapter, Drop
from swingd.link.setpoints import GeodeticPoint
from swingd.model.actions import StreamRequest
from swingd.model.errors import ConfigurationError
from swingd.model.events import (
    AppSetpoint,
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
    SetpointUse,
    Stream,
    Throttle,
)
from swingd.model.parameters import Link, Thrust

from .messages import (
    Autopilot,
    actuators,
    app_setpoint,
    attitude,
    attitude_quaternion,
    attitude_target,
    battery,
    copter_heartbeat,
    imu,
    local_position,
    px4_heartbeat,
    raw_imu,
    scaled_imu,
    servos,
    sys_status,
    vfr_hud,
)

approx = pytest.approx


def connected(thrust: Thrust | None = None, link: Link | None = None) -> tuple[AutopilotAdapter, Autopilot]:
    adapter, autopilot = AutopilotAdapter(link or Link(), thrust or Thrust()), Autopilot()
    assert adapter.receive(0.0, autopilot(px4_heartbeat())) == [AutopilotState(0.0, False, FlightMode.OTHER)]
    return adapter, autopilot


# ------------------------------------------------------------------------------------------------------ discovery


def test_nothing_is_used_before_the_autopilot_is_known():
    adapter, autopilot = AutopilotAdapter(Link(), Thrust()), Autopilot()
    assert adapter.receive(0.0, autopilot(imu(1.0))) == []
    assert adapter.autopilot is None
    assert adapter.drops == {Drop.OTHER_SENDER: 1}


@pytest.mark.parametrize(
    ("sender", "heartbeat"),
    [
        ((255, 190), mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)),
        ((1, 1), mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)),
        ((1, 191), mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)),
        ((1, 154), mavlink.MAVLink_heartbeat_message(26, 12, 0, 0, 4, 3)),
        ((1, 1), mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 4, 3)),
    ],
)
def test_ground_stations_companions_and_gimbals_are_no_autopilot(sender, heartbeat):
    adapter = AutopilotAdapter(Link(), Thrust())
    assert adapter.receive(0.0, Autopilot(*sender)(heartbeat)) == []
    assert adapter.autopilot is None


def test_the_first_autopilot_is_kept_and_others_are_ignored():
    adapter = AutopilotAdapter(Link(), Thrust())
    first, second = Autopilot(7), Autopilot(8)
    adapter.receive(0.0, second(imu(1.0)) + first(px4_heartbeat()))
    assert adapter.autopilot is not None
    assert (adapter.autopilot.system_id, adapter.autopilot.kind) == (7, AutopilotKind.PX4)
    assert adapter.receive(0.1, second(px4_heartbeat(), imu(1.0))) == []
    assert adapter.receive(0.1, Autopilot(7, 2)(imu(1.0))) == []
    assert len(adapter.receive(0.1, first(imu(1.0)))) == 1
    assert adapter.system_id == 7


def test_a_configured_system_is_waited_for():
    adapter = AutopilotAdapter(Link(system_id=8), Thrust())
    adapter.receive(0.0, Autopilot(7)(px4_heartbeat()))
    assert adapter.autopilot is None
    adapter.receive(0.0, Autopilot(8)(px4_heartbeat()))
    assert adapter.autopilot is not None
    assert adapter.autopilot.system_id == 8


@pytest.mark.parametrize(
    ("heartbeat", "armed", "mode"),
    [
        (px4_heartbeat(True, 6), True, FlightMode.OFFBOARD),
        (px4_heartbeat(False, 6), False, FlightMode.OFFBOARD),
        (px4_heartbeat(True, 3), True, FlightMode.OTHER),
        (mavlink.MAVLink_heartbeat_message(2, 12, 128, 6 << 16, 4, 3), True, FlightMode.UNKNOWN),
        (mavlink.MAVLink_heartbeat_message(13, 3, 129, 4, 4, 3), True, FlightMode.OFFBOARD),
        (mavlink.MAVLink_heartbeat_message(13, 3, 1, 5, 4, 3), False, FlightMode.OTHER),
        (mavlink.MAVLink_heartbeat_message(1, 3, 129, 4, 4, 3), True, FlightMode.UNKNOWN),  # a plane's mode 4
        (mavlink.MAVLink_heartbeat_message(2, 0, 129, 4, 4, 3), True, FlightMode.UNKNOWN),
    ],
)
def test_mode_and_arming(heartbeat, armed, mode):
    adapter = AutopilotAdapter(Link(), Thrust())
    assert adapter.receive(2.0, Autopilot()(heartbeat)) == [AutopilotState(2.0, armed, mode, adapter.autopilot.kind)]


# -------------------------------------------------------------------------------------------------------- samples


def test_samples_in_si_units_and_named_frames():
    adapter, autopilot = connected()
    data = autopilot(
        imu(10.0),
        attitude(10.004),
        attitude_target(10.004, 0.61),
        local_position(10.004),
        mavlink.MAVLink_extended_sys_state_message(0, 2),
        battery([15_800]),
    )
    first, second, third, fourth, fifth, sixth = adapter.receive(0.5, data)
    assert first == Imu(0.5, 10.0, approx((0.1, 0.2, -9.8)), approx((0.01, 0.02, 0.03)))
    assert second == Attitude(0.5, 10.004, approx(0.1), approx(-0.2), approx(0.3))
    assert third == Throttle(0.5, 10.004, approx(0.61))
    assert fourth == LocalPosition(0.5, 10.004, approx((1, 2, -3)), approx((0.1, 0.2, 0)))
    assert fifth == Landed(0.5, LandedState.IN_AIR)
    assert sixth == Battery(0.5, 15.8)
    assert not adapter.drops
    assert adapter.received[Stream.IMU] == 1


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (imu(1.0, acc=(math.nan, 0, 0)), Drop.NOT_FINITE),
        (imu(1.0, xgyro=math.inf), Drop.NOT_FINITE),
        (imu(1.0, acc=(0, 0, -5e3)), Drop.IMPOSSIBLE),
        (attitude(1.0, roll=math.nan), Drop.NOT_FINITE),
        (attitude(1.0, yaw=57.0), Drop.IMPOSSIBLE),
        (attitude_quaternion(1.0, (0.1, 0, 0, 0)), Drop.IMPOSSIBLE),
        (attitude_quaternion(1.0, (1, 0, math.nan, 0)), Drop.NOT_FINITE),
        (attitude_target(1.0, math.nan), Drop.NOT_FINITE),
        (attitude_target(1.0, 1.5), Drop.IMPOSSIBLE),
        (actuators(1.0, [900, 900, math.nan, 900]), None),
        (local_position(1.0, vel=(math.nan, 0, 0)), Drop.NOT_FINITE),
        (local_position(1.0, pos=(1e9, 0, 0)), Drop.IMPOSSIBLE),
        (sys_status(0), Drop.IMPOSSIBLE),
        (sys_status(65535), None),
        (battery([]), None),
        (imu(1.0, number=1), None),
        (attitude_target(1.0, 0.5, type_mask=64), None),
        (servos(1.0, [1500] * 4, port=1), None),
    ],
)
def test_what_is_not_finite_or_impossible_or_not_there_is_no_sample(message, reason):
    adapter, autopilot = connected()
    assert adapter.receive(0.1, autopilot(message)) == []
    assert adapter.drops == ({reason: 1} if reason else {})


def test_a_throttle_a_hair_outside_is_clipped():
    adapter, autopilot = connected()
    (low, high) = adapter.receive(0.0, autopilot(attitude_target(1.0, -0.001), attitude_target(1.01, 1.001)))
    assert (low.throttle, high.throttle) == (0.0, 1.0)


def test_the_quaternion_is_used_only_while_no_attitude_arrives():
    adapter, autopilot = connected()
    half = math.radians(30.0) / 2
    quaternion = (math.cos(half), 0.0, math.sin(half), 0.0)
    (event,) = adapter.receive(0.0, autopilot(attitude_quaternion(1.0, quaternion)))
    assert event == Attitude(0.0, 1.0, approx(0.0, abs=1e-6), approx(math.radians(30.0), abs=1e-6), approx(0.0))
    assert len(adapter.receive(0.01, autopilot(attitude(1.01)))) == 1
    assert adapter.receive(0.02, autopilot(attitude_quaternion(1.02, quaternion))) == []
    assert len(adapter.receive(1.5, autopilot(attitude_quaternion(2.5, quaternion)))) == 1
    assert not adapter.drops


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_quaternion_and_euler_angles_agree(roll, pitch, yaw):
    (sr, cr), (sp, cp), (sy, cy) = [(math.sin(a / 2), math.cos(a / 2)) for a in (roll, pitch, yaw)]
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    adapter, autopilot = connected()
    (event,) = adapter.receive(0.0, autopilot(attitude_quaternion(1.0, q)))
    assert (event.roll_rad, event.pitch_rad, event.yaw_rad) == approx((roll, pitch, yaw), abs=2e-5)


# --------------------------------------------------------------------------------------------------------- motors


def test_only_driven_outputs_are_motors():
    adapter, autopilot = connected()
    assert adapter.receive(0.0, autopilot(actuators(1.0, [900] * 4))) == []
    (event,) = adapter.receive(0.01, autopilot(actuators(1.01, [1250, 1500, 1750, 2000])))
    assert event.outputs == (0.25, 0.5, 0.75, 1.0)
    (event,) = adapter.receive(0.02, autopilot(actuators(1.02, [900, 1500, 2100, 2000])))
    assert event.outputs == (0.0, 0.5, 1.0, 1.0)  # once driven, an output stays a motor
    adapter.receive(0.03, autopilot(px4_heartbeat(armed=False)))
    assert adapter.receive(0.04, autopilot(actuators(1.04, [900] * 4))) == []


def test_a_configured_number_of_motors_leaves_the_grippers_servo_out():
    adapter, autopilot = connected(Thrust(motor_count=4))
    (event,) = adapter.receive(0.0, autopilot(actuators(1.0, [1100, 1200, 1300, 1400, 1900, 1500])))
    assert event.outputs == approx((0.1, 0.2, 0.3, 0.4))
    (event,) = adapter.receive(0.01, autopilot(px4_heartbeat(), actuators(1.01, [900] * 4)))[1:]
    assert event.outputs == (0.0,) * 4
    adapter.receive(0.02, autopilot(actuators(1.02, [1500, math.nan, 1500, 1500])))
    assert adapter.drops == {Drop.NOT_FINITE: 1}


def test_servo_outputs_stand_in_while_no_actuator_status_arrives():
    adapter, autopilot = connected()
    (event,) = adapter.receive(0.0, autopilot(attitude(1.0), servos(1.0, [1600] * 4)))[1:]
    assert event == Motors(0.0, approx(1.0), approx((0.6,) * 4))
    assert len(adapter.receive(0.01, autopilot(actuators(1.01, [1600] * 4)))) == 1
    assert adapter.receive(0.02, autopilot(servos(1.02, [1600] * 4))) == []
    assert len(adapter.receive(1.2, autopilot(servos(2.2, [1600] * 4)))) == 1


def test_equal_motor_limits_are_a_configuration_error():
    with pytest.raises(ConfigurationError, match=r"motor_output_max: 1000\.0 equals"):
        AutopilotAdapter(Link(), Thrust(motor_output_max=1000.0))


# -------------------------------------------------------------------------------------------------------- battery


@pytest.mark.parametrize(
    ("message", "volts"),
    [
        (battery([16_200]), 16.2),
        (battery([4100, 4090, 4080, 4070]), 16.34),
        (battery([4000] * 10, ext=(4000, 4000, 0, 0)), 48.0),
        (battery([65534, 2000]), 67.534),
    ],
)
def test_pack_voltage(message, volts):
    adapter, autopilot = connected()
    assert adapter.receive(1.0, autopilot(message)) == [Battery(1.0, approx(volts))]


def test_battery_0_is_preferred_then_any_then_the_system_status():
    adapter, autopilot = connected()
    assert adapter.receive(0.0, autopilot(sys_status(15_000))) == [Battery(0.0, 15.0)]
    assert adapter.receive(0.1, autopilot(battery([14_000], number=1))) == [Battery(0.1, 14.0)]
    assert adapter.receive(0.2, autopilot(sys_status(15_000))) == []
    assert adapter.receive(0.3, autopilot(battery([16_000]), battery([14_000], number=1))) == [Battery(0.3, 16.0)]
    assert adapter.receive(2.3, autopilot(battery([14_000], number=1), sys_status(15_000))) == []
    assert adapter.receive(6.0, autopilot(battery([14_000], number=1))) == [Battery(6.0, 14.0)]
    assert adapter.receive(12.0, autopilot(sys_status(15_000))) == [Battery(12.0, 15.0)]


# ------------------------------------------------------------------------------------------------------ ArduPilot


def copter() -> tuple[AutopilotAdapter, Autopilot]:
    adapter, autopilot = AutopilotAdapter(Link(), Thrust()), Autopilot()
    (state,) = adapter.receive(0.0, autopilot(copter_heartbeat()))
    assert state.kind is AutopilotKind.ARDUPILOT
    return adapter, autopilot


@pytest.mark.parametrize("message", [raw_imu, scaled_imu])
def test_raw_and_scaled_imu_are_in_milli_g_and_milliradians(message):
    adapter, autopilot = copter()
    assert adapter.receive(0.0, autopilot(message(9.0))) == []  # a better message may still come
    (event,) = adapter.receive(1.0, autopilot(message(10.0)))
    g = 9.80665
    assert event == Imu(1.0, approx(10.0), approx((0.01 * g, -0.02 * g, -g)), approx((0.1, -0.2, 0.3)))
    assert not adapter.drops


def test_the_second_sensor_is_not_the_imu_but_highres_imu_gives_the_primary_one():
    adapter, autopilot = copter()
    for t_s in (0.0, 2.0):
        assert adapter.receive(t_s, autopilot(raw_imu(1.0 + t_s, number=1))) == []
    assert len(adapter.receive(3.0, autopilot(imu(4.0, number=1)))) == 1


def test_px4s_raw_imu_is_in_units_of_its_own_and_never_used():
    adapter, autopilot = connected()
    for i in range(300):
        assert adapter.receive(i * 0.01, autopilot(raw_imu(1.0 + i * 0.01), scaled_imu(1.0 + i * 0.01))) == []


SOURCES = (imu, raw_imu, scaled_imu)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 7), st.integers(1, 80)), min_size=1, max_size=5))
def test_samples_of_two_messages_never_mix(phases):
    """GIVEN messages that come and go, WHEN any come together, THEN only the best of them is taken, a second later."""
    adapter, autopilot = copter()
    accelerations = (0.1, 0.01 * 9.80665)
    last_s = dict.fromkeys(SOURCES, -math.inf)
    taken, step = [], 0
    for present, steps in phases:
        for _ in range(steps):
            step += 1
            t_s = step * 0.02
            messages = [source for i, source in enumerate(SOURCES) if present >> i & 1]
            silent_s = t_s - last_s[imu]
            last_s.update(dict.fromkeys(messages, t_s))
            events = adapter.receive(t_s, autopilot(*(source(1.0 + t_s) for source in reversed(messages))))
            assert len(events) <= 1
            if events:
                is_highres = events[0].acc_frd_mps2[0] == approx(accelerations[0])
                assert is_highres or silent_s >= 1.0 - 1e-9
                taken.append((t_s, is_highres))
            else:
                assert imu not in messages  # the best is never left out
    switches = [b - a for (a, best_a), (b, best_b) in pairwise(taken) if best_a and not best_b]
    assert all(gap_s >= 1.0 - 1e-9 for gap_s in switches)


def test_a_denied_message_is_not_waited_for():
    adapter, autopilot = copter()
    adapter.messages(StreamRequest(Stream.IMU, 250.0))
    denied = mavlink.MAVLink_command_ack_message(511, mavlink.MAV_RESULT_DENIED, 0, 0, 1, 191)
    assert adapter.receive(0.1, autopilot(denied)) == []
    assert len(adapter.receive(0.2, autopilot(raw_imu(1.0)))) == 1
    assert adapter.receive(0.21, autopilot(scaled_imu(1.01))) == []


def test_the_whole_percent_of_vfr_hud_is_a_last_resort():
    adapter, autopilot = copter()
    assert adapter.receive(0.0, autopilot(vfr_hud(37))) == []
    assert adapter.drops == {Drop.NO_CLOCK: 1}
    (_, event) = adapter.receive(0.01, autopilot(attitude(20.0), vfr_hud(37)))
    assert event == Throttle(0.01, approx(20.0), approx(0.37))
    (_, event) = adapter.receive(0.5, autopilot(attitude(20.49), attitude_target(20.49, 0.405)))
    assert event.throttle == approx(0.405)
    assert adapter.receive(1.49, autopilot(vfr_hud(38))) == []
    (event,) = adapter.receive(1.51, autopilot(vfr_hud(38)))
    assert event == Throttle(1.51, approx(21.5), approx(0.38))
    assert adapter.receive(1.6, autopilot(vfr_hud(170))) == []
    assert adapter.drops[Drop.IMPOSSIBLE] == 1
    px4, px4_autopilot = connected()
    assert px4.receive(1.0, px4_autopilot(attitude(1.0), vfr_hud(37)))[1:] == []


def test_copters_motors_are_its_servo_outputs():
    adapter, autopilot = copter()
    (_, event) = adapter.receive(0.0, autopilot(attitude(1.0), servos(1.0, [1100, 1300, 1500, 1700])))
    assert event == Motors(0.0, approx(1.0), approx((0.1, 0.3, 0.5, 0.7)))


@pytest.mark.parametrize("latitude", [900_000_001, -(2**31)])
def test_no_origin_is_beyond_the_pole(latitude):
    adapter, autopilot = connected()
    good = mavlink.MAVLink_gps_global_origin_message(473977420, 85455940, 488_000)
    bad = mavlink.MAVLink_gps_global_origin_message(latitude, 0, 0)
    adapter.receive(0.0, autopilot(good, bad))
    assert adapter.view.origin == GeodeticPoint(473977420, 85455940, 488_000)
    assert adapter.drops == {Drop.IMPOSSIBLE: 1}


# --------------------------------------------------------------------------------------------------------- stamps


def imus(events) -> list[float]:
    return [event.t_boot_s for event in events if isinstance(event, Imu)]


def test_duplicated_and_reordered_samples_are_dropped_per_stream():
    adapter, autopilot = connected()
    stamps = [1.0, 1.01, 1.01, 1.03, 1.02, 1.04]
    events = adapter.receive(0.0, autopilot(*(imu(t) for t in stamps), attitude(1.0)))
    assert imus(events) == approx([1.0, 1.01, 1.03, 1.04])
    assert isinstance(events[-1], Attitude)
    assert adapter.drops == {Drop.DUPLICATE: 1, Drop.REORDERED: 1}


@settings(max_examples=50)
@given(st.permutations(range(12)), st.lists(st.integers(0, 11), max_size=5))
def test_stamps_only_rise_whatever_the_link_does(order, again):
    adapter, autopilot = connected()
    frames = [autopilot(imu(1.0 + i * 0.004)) for i in range(12)]
    stamps = imus(adapter.receive(0.0, b"".join(frames[i] for i in [*order, *again])))
    assert all(b > a for a, b in pairwise(stamps))
    assert len(stamps) + sum(adapter.drops.values()) == 12 + len(again)


@pytest.mark.parametrize("wild_s", [30.2, 31.0, 33.0, 1000.0, 4e6])
def test_one_stamp_of_the_future_locks_nothing_out(wild_s):
    adapter, autopilot = connected()
    for i in range(100):
        adapter.receive(i * 0.01, autopilot(imu(29.0 + i * 0.01)))
    adapter.receive(1.0, autopilot(imu(wild_s)))
    events = [e for i in range(1, 100) for e in adapter.receive(1.0 + i * 0.01, autopilot(imu(30.0 + i * 0.01)))]
    assert not any(isinstance(e, AutopilotRestart) for e in events)
    assert len(imus(events)) >= 99 - 20
    assert imus(events)[-1] == approx(30.99)


@pytest.mark.parametrize("silence_s", [0.0, 8.0])
@pytest.mark.parametrize("reboot_to_s", [0.5, 500.0])
def test_a_reboot_is_one_event_and_the_streams_start_anew(reboot_to_s, silence_s):
    adapter, autopilot = connected()
    for i in range(300):
        adapter.receive(i * 0.01, autopilot(imu(100.0 + i * 0.01), attitude(100.0 + i * 0.01)))
    adapter.receive(3.0, autopilot(actuators(103.0, [1500] * 4)))
    events = []
    for i in range(100):
        t_s = i * 0.01
        data = autopilot(imu(reboot_to_s + t_s), attitude(reboot_to_s + t_s), servos(reboot_to_s + t_s, [1500] * 4))
        events += adapter.receive(3.0 + silence_s + t_s, data)
    restarts = [e for e in events if isinstance(e, AutopilotRestart)]
    assert [e.step_s for e in restarts] == [approx(reboot_to_s - 103.0 - silence_s)]
    at = events.index(restarts[0])
    assert not any(isinstance(e, Imu | Attitude | Motors) for e in events[:at])
    assert isinstance(events[at + 1], Imu | Attitude)
    assert len(imus(events)) >= 65
    assert imus(events)[-1] == approx(reboot_to_s + 0.99)
    assert sum(isinstance(e, Motors) for e in events) >= 60  # the preference for the other message is forgotten too


def test_the_wrap_of_time_boot_ms_is_counted_on():
    adapter, autopilot = connected()
    wrap_s = 2**32 * 1e-3
    events = []
    for i in range(-50, 50):
        t_s = wrap_s + i * 0.01
        events += adapter.receive(t_s, autopilot(attitude(t_s), imu(t_s), servos(t_s, [1500] * 4)))
    assert not adapter.drops
    for kind in (Imu, Attitude, Motors):
        stamps = [e.t_boot_s for e in events if isinstance(e, kind)]
        assert stamps == approx([wrap_s + i * 0.01 for i in range(-50, 50)], abs=1e-4)


def test_servo_stamps_that_wrap_after_71_minutes_are_put_on_the_boot_clock():
    adapter, autopilot = connected()
    events = adapter.receive(0.0, autopilot(servos(9000.0, [1500] * 4), attitude(9000.0), servos(9000.0, [1500] * 4)))
    assert [type(e) for e in events] == [Attitude, Motors]
    assert events[1].t_boot_s == approx(9000.0)
    assert adapter.drops == {Drop.NO_CLOCK: 1}


def unix_imu(t_unix_s: float):
    message = imu(t_unix_s)
    message.time_usec = round(t_unix_s * 1e6)
    return message


@pytest.mark.parametrize("system_time", [True, False])
def test_unix_stamps_are_put_on_the_boot_clock(system_time):
    adapter, autopilot = connected()
    unix_s = 1_800_000_000.0
    events = []
    for i in range(500):
        t_s = i * 0.01
        delay_s = 0.003 + 0.004 * (i % 7 == 3)
        messages = [attitude(50.0 + t_s), unix_imu(unix_s + t_s)]
        if system_time and i == 20:
            messages.append(mavlink.MAVLink_system_time_message(round((unix_s + t_s) * 1e6), round((50.0 + t_s) * 1e3)))
        events += adapter.receive(t_s + delay_s, autopilot(*messages))
    stamps = imus(events)
    assert len(stamps) == pytest.approx(479 if system_time else 400, abs=1)
    assert stamps == approx([55.0 - 0.01 * (len(stamps) - i) for i in range(len(stamps))], abs=0.002)


def test_a_unix_clock_that_is_set_is_no_restart_of_the_autopilot():
    adapter, autopilot = connected()
    events = []
    for i in range(800):
        t_s = i * 0.01
        unix_s = 1_700_000_000.0 if i < 300 else 1_800_000_000.0
        events += adapter.receive(t_s, autopilot(attitude(50.0 + t_s), unix_imu(unix_s + t_s)))
    assert not any(isinstance(e, AutopilotRestart) for e in events)
    assert imus(events)[-1] == approx(57.99, abs=0.002)
    assert sum(isinstance(e, Attitude) for e in events) == 800


def test_senseless_stamps_are_impossible():
    adapter, autopilot = connected()
    assert adapter.receive(0.0, autopilot(unix_imu(1e12))) == []
    assert adapter.drops == {Drop.IMPOSSIBLE: 1}


# --------------------------------------------------------------------------------------- setpoints of applications


def test_a_setpoint_addressed_to_swingd_is_the_applications():
    adapter, _ = connected()
    (event,) = adapter.receive(0.4, Autopilot(255, 190)(app_setpoint()))
    assert event == AppSetpoint(
        0.4,
        SetpointUse.VEL | SetpointUse.YAW,
        (0.0, 0.0, 0.0),
        (3.0, -1.0, 0.5),
        (0.0, 0.0, 0.0),
        approx(0.7),
        0.0,
    )


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (app_setpoint(component=1), None),
        (app_setpoint(component=0), None),
        (app_setpoint(system=2), None),
        (app_setpoint(frame=8), Drop.SETPOINT_FRAME),
        (app_setpoint(type_mask=0x9C7 | 0x200), Drop.SETPOINT_FRAME),
        (app_setpoint(vx=math.nan), Drop.NOT_FINITE),
        (app_setpoint(vx=1e30), Drop.IMPOSSIBLE),
        (app_setpoint(type_mask=0x9F8), Drop.NOT_FINITE),  # position wanted, but x is NaN
    ],
)
def test_other_setpoints_are_not(message, reason):
    adapter, _ = connected()
    assert adapter.receive(0.4, Autopilot(255, 190)(message)) == []
    assert adapter.drops == ({reason: 1} if reason else {})


# --------------------------------------------------------------------------------------------------- any bytes


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                [0, 1, 22, 24, 26, 27, 30, 31, 32, 36, 49, 65, 74, 77, 83, 84, 105, 111, 147, 242, 245, 2, 375]
            ),
            st.binary(min_size=1, max_size=200),
            st.floats(0.0, 10.0),
        ),
        max_size=20,
    )
)
@pytest.mark.parametrize("autopilot", [connected, copter])
def test_no_payload_raises_and_no_event_is_not_finite(autopilot, parts):
    adapter, _ = autopilot()
    for msg_id, payload, t_s in parts:
        header = struct.pack("<BBBBBB", len(payload), 0, 0, 0, 1, 1) + msg_id.to_bytes(3, "little")
        crc = mavlink.x25crc(header + payload + bytes([mavlink.mavlink_map[msg_id].crc_extra])).crc
        for event in adapter.receive(t_s, b"\xfd" + header + payload + struct.pack("<H", crc)):
            text = repr(event)
            assert "nan" not in text
            assert "inf" not in text


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_any_cut_of_the_stream_gives_the_same_events(data):
    autopilot = Autopilot()
    stream = b""
    for i in range(10):
        t_s = 5.0 + i * 0.01
        stream += autopilot(px4_heartbeat(True), imu(t_s), attitude(t_s), actuators(t_s, [1500] * 4)) + b"\xfd\x01"
    whole = AutopilotAdapter(Link(), Thrust())
    cut = AutopilotAdapter(Link(), Thrust())
    expected = whole.receive(1.0, stream)
    assert len(expected) == 40
    events = []
    while stream:
        n = data.draw(st.integers(1, 200))
        events += cut.receive(1.0, stream[:n])
        stream = stream[n:]
    assert events == expected
    assert cut.drops == whole.drops


def test_a_sensor_that_hangs_is_no_sample_until_it_moves_again():
    adapter, autopilot = connected()

    def receive(t_s, zacc):
        message = imu(t_s, acc=(0.1, 0.2, zacc))
        message.zgyro = 0.03
        return adapter.receive(t_s, autopilot(message))

    taken = [bool(receive(1.0 + 0.006 * i, -9.8)) for i in range(60)]
    assert sum(taken) == 17, "coarse units may repeat a reading for a tenth of a second"
    assert not any(taken[17:])
    assert adapter.drops[Drop.FROZEN] == 43
    assert len(receive(1.5, -9.81)) == 1
