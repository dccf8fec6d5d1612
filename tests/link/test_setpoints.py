"""What an application asks for, resolved as each autopilot reads it.

The oracles say what an autopilot follows after a message: PX4 v1.16 from its handlers of both messages, Copter 4.7 from
its handlers, GUIDED's submodes and its Location. They are written from those, in their units and their order, and know
nothing of swingd.
"""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.adapter import AutopilotAdapter, Drop
from swingd.link.codec import Codec, Frame
from swingd.link.setpoints import FRESH_S, SETPOINT_IDS
from swingd.model.actions import Setpoint
from swingd.model.events import AppSetpoint, AutopilotKind, SetpointUse, UnmetSetpoint
from swingd.model.parameters import Link, ShaperName, Thrust
from swingd.sim.copter import local_target_of
from swingd.sim.px4 import setpoint_of

from .messages import Autopilot, attitude, attitude_target, copter_heartbeat, local_position, px4_heartbeat

nan, inf = math.nan, math.inf
PX4, COPTER = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
NOW_S = 5.0
SOURCE = 0x10FF42

ROLL, PITCH, YAW = 0.2, -0.3, 2.1
YAW_SP = 2.15
POSITION, VELOCITY = (12.0, -7.0, -20.0), (1.0, -2.0, 0.5)
ORIGIN = (473977420, 85455940, 488_000)
HOME = (473977000, 85456000, 488_200)

APPLICATION = Codec(255, 190)


def yaw_quaternion(yaw: float) -> list[float]:
    return [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]


def flying(kind: AutopilotKind, *, home: tuple[int, int, int] = HOME, age_s: float = 0.0) -> AutopilotAdapter:
    """An adapter that knows where the vehicle is and how it lies."""
    adapter, autopilot = AutopilotAdapter(Link(), Thrust()), Autopilot()
    target = attitude_target(100.0, 0.5)
    target.q = yaw_quaternion(YAW_SP)
    messages = (
        px4_heartbeat(True, 6) if kind is PX4 else copter_heartbeat(),
        attitude(100.0, ROLL, PITCH, YAW),
        target,
        local_position(100.0, POSITION, VELOCITY),
        mavlink.MAVLink_gps_global_origin_message(*ORIGIN),
        mavlink.MAVLink_home_position_message(*home, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
    )
    adapter.receive(NOW_S - age_s, autopilot(*messages))
    assert adapter.autopilot is not None
    assert adapter.autopilot.kind is kind
    assert not adapter.drops
    return adapter


def local(
    mask: int, frame: int = 1, pos=(30.0, 40.0, -15.0), vel=(3.0, -1.0, 0.5), acc=(0.4, 0.3, -0.2), yaw=0.7, rate=0.25
) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(1, 1, 1, frame, mask, *pos, *vel, *acc, yaw, rate)


def globe(
    mask: int,
    frame: int = mavlink.MAV_FRAME_GLOBAL_INT,
    lat=473990000,
    lon=85420000,
    alt=503.25,
    vel=(3.0, -1.0, 0.5),
    acc=(0.4, 0.3, -0.2),
    yaw=0.7,
    rate=0.25,
) -> Any:
    return mavlink.MAVLink_set_position_target_global_int_message(
        1, 1, 1, frame, mask, lat, lon, alt, *vel, *acc, yaw, rate
    )


def on_the_wire(message: Any) -> Frame:
    (frame,) = Codec(1, 1).receive(APPLICATION.encode(message))
    return frame


# ------------------------------------------------------------------------------------------- what the autopilots follow

REJECTED = "goes on with what it follows"
HOLDS = "stops"
TERRAIN = "follows the terrain"


def body_to_ned() -> list[list[float]]:
    """From the quaternion, as both autopilots hold their attitude."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a / 2), math.cos(a / 2)) for a in (ROLL, PITCH, YAW))
    w = cr * cp * cy + sr * sp * sy
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def px4_follows(m: Any, home=HOME) -> Any:
    """Position, velocity, acceleration, yaw and yaw rate of the trajectory setpoint; nan is not followed."""
    mask = m.type_mask
    vel = [nan if mask & 8 << i else v for i, v in enumerate((m.vx, m.vy, m.vz))]
    acc = [nan if mask & 64 << i else v for i, v in enumerate((m.afx, m.afy, m.afz))]
    if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
        pos = [nan if mask & 1 << i else v for i, v in enumerate((m.x, m.y, m.z))]
        if m.coordinate_frame == 8:
            rotation = body_to_ned()
            pos = [nan] * 3
            if mask & (8 + 16 + 32):
                vel = [nan] * 3
            else:
                heading = math.atan2(rotation[1][0], rotation[0][0])
                x, y, z = vel
                vel = [
                    math.cos(heading) * x - math.sin(heading) * y,
                    math.sin(heading) * x + math.cos(heading) * y,
                    z,
                ]
            if mask & (64 + 128 + 256):
                acc = [nan] * 3
            else:
                acc = [sum(row[i] * acc[i] for i in range(3)) for row in rotation]
        elif m.coordinate_frame != 1:
            return REJECTED
    else:
        pos = [nan] * 3
        if not mask & 7:
            north, east = px4_projection(m.lat_int, m.lon_int)
            if m.coordinate_frame == 5:
                down = ORIGIN[2] * 1e-3 - m.alt
            elif m.coordinate_frame == 6:
                down = home[2] * 1e-3 - m.alt - ORIGIN[2] * 1e-3
            elif m.coordinate_frame == 11:
                return TERRAIN
            else:
                return REJECTED
            pos = [north, east, down]
    used = [any(v == v for v in group) for group in (pos, vel, acc)]
    if used[2] and mask & 512:
        return REJECTED
    if not any(used):
        return REJECTED
    return (*pos, *vel, *acc, nan if mask & 1024 else m.yaw, nan if mask & 2048 else m.yaw_rate)


def px4_projection(lat_int: int, lon_int: int) -> tuple[float, float]:
    """Azimuthal equidistant: the great circle's length, along its first bearing."""
    lat0, lon0, lat, lon = (math.radians(v * 1e-7) for v in (ORIGIN[0], ORIGIN[1], lat_int, lon_int))
    half = math.sin((lat - lat0) / 2) ** 2 + math.cos(lat0) * math.cos(lat) * math.sin((lon - lon0) / 2) ** 2
    distance = 2 * 6371000 * math.asin(math.sqrt(half))
    bearing = math.atan2(
        math.sin(lon - lon0) * math.cos(lat),
        math.cos(lat0) * math.sin(lat) - math.sin(lat0) * math.cos(lat) * math.cos(lon - lon0),
    )
    return distance * math.cos(bearing), distance * math.sin(bearing)


def copter_follows(m: Any, home=HOME) -> Any:
    """GUIDED's submode, its targets (north, east, up in cm) and its heading."""
    mask = m.type_mask
    pos_ignore, vel_ignore, acc_ignore = (bool(mask & bits) for bits in (0b111, 0b111000, 0b111000000))
    yaw_ignore, rate_ignore, force = bool(mask & 1024), bool(mask & 2048), bool(mask & 512)
    frame, is_local = m.coordinate_frame, m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    body = is_local and frame in (8, 9)
    if is_local and frame not in (1, 7, 8, 9):
        return HOLDS
    if force and not acc_ignore:
        return HOLDS

    def turned(v: list[float]) -> list[float]:
        if not body:
            return v
        c, s = math.cos(YAW), math.sin(YAW)
        return [v[0] * c - v[1] * s, v[0] * s + v[1] * c, v[2]]

    pos = vel = acc = [0.0, 0.0, 0.0]
    if not pos_ignore and is_local:
        pos = turned([m.x * 100, m.y * 100, -m.z * 100])
        if frame in (7, 8, 9):
            pos = [pos[0] + POSITION[0] * 100, pos[1] + POSITION[1] * 100, pos[2] - POSITION[2] * 100]
    elif not pos_ignore:
        if abs(m.lat_int) > 90e7 or abs(m.lon_int) > 180e7 or frame not in (0, 3, 5, 6, 10, 11):
            return HOLDS
        above = int(m.alt * 100) - ORIGIN[2] // 10 + (home[2] // 10 if frame in (3, 6) else 0)
        scale = math.cos(math.radians((m.lat_int + ORIGIN[0]) // 2 * 1e-7))
        pos = [
            (m.lat_int - ORIGIN[0]) * 1.1131884502145034,
            (m.lon_int - ORIGIN[1]) * 1.1131884502145034 * scale,
            above,
        ]
    if not vel_ignore:
        vel = [m.vx, m.vy, -m.vz]
        if any(v != v or abs(v) > 1000 for v in vel):
            return HOLDS
        vel = turned([v * 100 for v in vel])
    if not acc_ignore:
        acc = turned([m.afx * 100, m.afy * 100, -m.afz * 100])
    if not yaw_ignore and body:
        heading: tuple[Any, ...] = ("angle", math.cos(YAW_SP + m.yaw), math.sin(YAW_SP + m.yaw), 0.0)
    elif not yaw_ignore:
        heading = ("angle", math.cos(m.yaw), math.sin(m.yaw), 0.0 if rate_ignore else m.yaw_rate)
    elif not rate_ignore:
        heading = ("rate", m.yaw_rate)
    else:
        heading = ("default",)
    if not pos_ignore and not vel_ignore:
        if frame in (10, 11) and not is_local:
            return HOLDS
        return ("PosVelAccel", *pos, *vel, *(acc if is_local else [0.0] * 3), *heading)
    if pos_ignore and not vel_ignore:
        return ("VelAccel", *vel, *acc, *heading)
    if pos_ignore and vel_ignore and not acc_ignore:
        return ("Accel", *acc, *heading)
    if not pos_ignore and vel_ignore and acc_ignore:
        return TERRAIN if frame in (10, 11) and not is_local else ("Pos", *pos, *heading)
    return HOLDS


FOLLOWS = {PX4: px4_follows, COPTER: copter_follows}


def assert_same(followed: Any, wanted: Any, what: str) -> None:
    assert isinstance(followed, tuple), what
    assert len(followed) == len(wanted), what
    for a, b in zip(followed, wanted, strict=True):
        if isinstance(b, str):
            assert a == b, what
        elif b != b:
            assert a != a, what
        else:
            assert abs(a - b) <= 1e-6 * abs(b) + 1e-3, what


def check(adapter: AutopilotAdapter, kind: AutopilotKind, original: Any, home=HOME) -> type:
    """Send a message through, with no correction; the autopilot must follow what it would have followed."""
    frame = on_the_wire(original)
    message = frame.message
    what = f"{kind.name} frame {message.coordinate_frame} mask {message.type_mask:#05x}: {message}"
    wanted = FOLLOWS[kind](message, home)
    result = adapter.app_setpoint(NOW_S, frame, SOURCE, ShaperName.ZVD)
    if wanted is REJECTED:
        assert result is None, what
    elif wanted in (HOLDS, TERRAIN):
        assert result == UnmetSetpoint(NOW_S, SOURCE), what
    else:
        assert isinstance(result, AppSetpoint), what
        assert (result.t_mono_s, result.source, result.shaper) == (NOW_S, SOURCE, ShaperName.ZVD)
        values = (result.pos_ned_m, result.vel_ned_mps, result.acc_ned_mps2, result.yaw_rad, result.yaw_rate_radps)
        (sent,) = adapter.messages(Setpoint(100.0, result.use, *values))
        resent = on_the_wire(sent).message
        assert resent.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED
        assert_same(FOLLOWS[kind](resent, home), wanted, what)
    return type(result)


LOCAL_FRAMES = (1, 7, 8, 9, 0, 12)
GLOBAL_FRAMES = (5, 6, 11, 0, 3, 10, 1)


@pytest.mark.parametrize("frame", LOCAL_FRAMES)
@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_every_mask_in_every_local_frame_is_followed_as_if_it_had_come_directly(kind, frame):
    adapter = flying(kind)
    results = {check(adapter, kind, local(mask, frame)) for mask in range(4096)}
    accepted = frame in ((1, 8) if kind is PX4 else (1, 7, 8, 9))
    assert (AppSetpoint in results) == accepted
    assert (type(None) in results) == (kind is PX4)


@pytest.mark.parametrize("frame", GLOBAL_FRAMES)
@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_every_mask_in_every_global_frame_is_followed_as_if_it_had_come_directly(kind, frame):
    adapter = flying(kind)
    results = {check(adapter, kind, globe(mask, frame)) for mask in range(4096)}
    assert AppSetpoint in results  # even in a frame that is refused: it only matters to positions


def axes(values: Any) -> tuple[float | None, ...]:
    return tuple(None if v is None else pytest.approx(v, abs=1e-5) for v in values)


def simulated(kind: AutopilotKind, message: Any) -> Any:
    """What the simulated autopilot makes of a message, None if it does not follow it."""
    if kind is PX4:
        m = body_to_ned()
        w = math.sqrt(1.0 + m[0][0] + m[1][1] + m[2][2]) / 2
        q = (w, (m[2][1] - m[1][2]) / (4 * w), (m[0][2] - m[2][0]) / (4 * w), (m[1][0] - m[0][1]) / (4 * w))
        return setpoint_of(message, q)
    return local_target_of(message, POSITION, YAW)


@pytest.mark.parametrize(("kind", "frame"), [(PX4, 1), (PX4, 8), *((COPTER, frame) for frame in (1, 7, 8, 9))])
def test_the_simulated_autopilots_read_alike(kind, frame):
    adapter = flying(kind)
    for mask in range(4096):
        original = on_the_wire(local(mask, frame))
        result = adapter.app_setpoint(NOW_S, original, 0)
        followed = simulated(kind, original.message)
        assert isinstance(result, AppSetpoint) == (followed is not None), hex(mask)
        if not isinstance(result, AppSetpoint):
            continue
        (sent,) = adapter.messages(
            Setpoint(
                100.0,
                result.use,
                result.pos_ned_m,
                result.vel_ned_mps,
                result.acc_ned_mps2,
                result.yaw_rad,
                result.yaw_rate_radps,
            )
        )
        again = simulated(kind, on_the_wire(sent).message)
        nothing = (None, None, None)
        for name in ("pos_ned_m", "vel_ned_mps", "acc_ned_mps2"):
            assert (getattr(again, name) or nothing) == axes(getattr(followed, name) or nothing), hex(mask)
        if getattr(followed, "yaw_is_relative", False):
            assert math.remainder(again.yaw_rad - YAW_SP - followed.yaw_rad, 2 * math.pi) == pytest.approx(0, abs=1e-6)
            assert not again.yaw_is_relative
        else:
            assert (again.yaw_rad, again.yaw_rate_radps) == (followed.yaw_rad, followed.yaw_rate_radps)


any_float = st.one_of(st.floats(-30.0, 30.0, width=32), st.just(nan))
triples = st.tuples(any_float, any_float, any_float)


@settings(max_examples=500, deadline=None)
@given(st.integers(0, 0xFFFF), st.sampled_from([1, 8]), triples, triples, triples, any_float, any_float)
def test_px4_takes_nan_for_ignored(mask, frame, pos, vel, acc, yaw, rate):
    check(flying(PX4), PX4, local(mask, frame, pos, vel, acc, yaw, rate))
    check(flying(PX4), PX4, globe(mask, 5, alt=pos[2], vel=vel, acc=acc, yaw=yaw, rate=rate))


near = st.integers(-10_000_000, 10_000_000)


@settings(max_examples=200, deadline=None)
@given(near, near, st.floats(-400.0, 5000.0, width=32), st.sampled_from([5, 6]), st.sampled_from([PX4, COPTER]))
def test_a_global_position_is_put_where_the_autopilot_puts_it(d_lat, d_lon, alt, frame, kind):
    adapter = flying(kind)
    message = globe(0xFF8, frame, ORIGIN[0] + d_lat, ORIGIN[1] + d_lon, alt)
    result = adapter.app_setpoint(NOW_S, on_the_wire(message), 0)
    assert isinstance(result, AppSetpoint)
    followed = FOLLOWS[kind](on_the_wire(message).message)
    if kind is COPTER:
        followed = (followed[1] / 100, followed[2] / 100, -followed[3] / 100)
    # A centimetre where Copter cuts the altitude to whole ones; the arc's cosine costs PX4 a little near the origin.
    assert result.pos_ned_m == pytest.approx(followed[:3], rel=1e-7, abs=0.011)


def test_the_date_line_is_no_border_to_copter():
    adapter = flying(COPTER)
    adapter.receive(NOW_S, Autopilot()(mavlink.MAVLink_gps_global_origin_message(0, 1_799_990_000, 0)))
    result = adapter.app_setpoint(NOW_S, on_the_wire(globe(0xFF8, 5, 0, -1_799_990_000, 10.0)), 0)
    assert isinstance(result, AppSetpoint)
    assert result.pos_ned_m == pytest.approx((0.0, 20_000 * 0.011131884502145034, -10.0))


# --------------------------------------------------------------------------------------------- what cannot be resolved

VEL_ONLY = 0xDC7
POS_ONLY = 0xDF8
ACC_ONLY = 0xC3F


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (PX4, local(VEL_ONLY, 8)),
        (PX4, local(ACC_ONLY, 8)),
        (COPTER, local(VEL_ONLY, 8)),
        (COPTER, local(ACC_ONLY, 9)),
        (COPTER, local(POS_ONLY, 7)),
        (COPTER, local(POS_ONLY, 9)),
    ],
)
def test_what_depends_on_an_old_state_passes_unmet(kind, message):
    frame = on_the_wire(message)
    for age_s, resolved in ((0.0, True), (FRESH_S - 0.01, True), (FRESH_S + 0.01, False), (3.0, False)):
        result = flying(kind, age_s=age_s).app_setpoint(NOW_S, frame, SOURCE)
        assert isinstance(result, AppSetpoint) == resolved
        assert isinstance(result, UnmetSetpoint) != resolved


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_what_is_absolute_needs_no_state(kind):
    adapter = AutopilotAdapter(Link(), Thrust())
    adapter.receive(0.0, Autopilot()(px4_heartbeat() if kind is PX4 else copter_heartbeat()))
    assert isinstance(adapter.app_setpoint(0.0, on_the_wire(local(0xDC0)), 0), AppSetpoint)
    assert isinstance(adapter.app_setpoint(0.0, on_the_wire(globe(VEL_ONLY)), 0), AppSetpoint)
    for frame in (5, 6):
        assert adapter.app_setpoint(0.0, on_the_wire(globe(POS_ONLY, frame)), 9) == UnmetSetpoint(0.0, 9)


def test_an_offset_counts_from_where_the_vehicle_is_now():
    age_s = 0.1
    result = flying(COPTER, age_s=age_s).app_setpoint(NOW_S, on_the_wire(local(POS_ONLY, 7, pos=(1.0, 2.0, 3.0))), 0)
    assert isinstance(result, AppSetpoint)
    expected = [p + v * age_s + offset for p, v, offset in zip(POSITION, VELOCITY, (1.0, 2.0, 3.0), strict=True)]
    assert result.pos_ned_m == pytest.approx(expected)


def test_a_relative_heading_counts_from_the_heading_that_copter_holds_or_else_has():
    message = on_the_wire(local(0x9C7, 8, yaw=3.0))
    adapter = flying(COPTER)
    held = adapter.app_setpoint(NOW_S, message, 0)
    assert isinstance(held, AppSetpoint)
    assert held.yaw_rad == pytest.approx(YAW_SP + 3.0 - 2 * math.pi)
    later_s = NOW_S + FRESH_S + 0.05
    adapter.receive(later_s, Autopilot()(attitude(100.0 + FRESH_S + 0.05, ROLL, PITCH, YAW)))
    had = adapter.app_setpoint(later_s, message, 0)
    assert isinstance(had, AppSetpoint)
    assert had.yaw_rad == pytest.approx(YAW + 3.0 - 2 * math.pi)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (PX4, local(VEL_ONLY, vel=(inf, 0.0, 0.0))),
        (PX4, local(POS_ONLY, pos=(1e12, 0.0, 0.0))),
        (PX4, local(VEL_ONLY & ~0x400, yaw=inf)),
        (PX4, globe(POS_ONLY, alt=inf)),
        (COPTER, local(POS_ONLY, pos=(nan, 0.0, 0.0))),
        (COPTER, local(POS_ONLY, 9, pos=(nan, 0.0, 0.0))),
        (COPTER, local(ACC_ONLY, acc=(nan, 0.0, 0.0))),
        (COPTER, local(VEL_ONLY & ~0x400, yaw=nan)),
        (COPTER, local(VEL_ONLY & ~0x400, 8, yaw=nan)),
        (COPTER, globe(POS_ONLY, alt=nan)),
        (COPTER, globe(POS_ONLY, alt=inf)),
    ],
)
def test_what_no_vehicle_can_do_is_left_to_the_autopilot(kind, message):
    assert flying(kind).app_setpoint(NOW_S, on_the_wire(message), SOURCE) == UnmetSetpoint(NOW_S, SOURCE)


def test_px4s_altitude_above_home_is_resolved_only_where_its_sign_does_not_matter():
    message = globe(POS_ONLY, 6, alt=10.0)
    check(flying(PX4), PX4, message)
    far = (*HOME[:2], ORIGIN[2] + 2_000)
    frame = on_the_wire(message)
    assert isinstance(flying(PX4, home=far).app_setpoint(NOW_S, frame, 0), UnmetSetpoint)
    check(flying(COPTER, home=far), COPTER, message, far)


def test_an_unknown_autopilots_reading_is_not_guessed():
    adapter = AutopilotAdapter(Link(), Thrust())
    adapter.receive(0.0, Autopilot()(mavlink.MAVLink_heartbeat_message(2, 0, 129, 4, 4, 3)))
    assert adapter.app_setpoint(0.0, on_the_wire(local(VEL_ONLY)), 3) == UnmetSetpoint(0.0, 3)


def test_before_an_autopilot_is_known_nothing_is_met():
    adapter = AutopilotAdapter(Link(), Thrust())
    assert adapter.app_setpoint(0.0, on_the_wire(local(VEL_ONLY)), 3) is None


def test_a_restart_voids_what_was_known():
    adapter, autopilot = flying(PX4), Autopilot()
    frame = on_the_wire(globe(POS_ONLY))
    assert isinstance(adapter.app_setpoint(NOW_S, frame, 0), AppSetpoint)
    for i in range(100):
        adapter.receive(NOW_S + i * 0.01, autopilot(attitude(0.5 + i * 0.01)))
    assert isinstance(adapter.app_setpoint(NOW_S + 1.0, frame, 0), UnmetSetpoint)


# ------------------------------------------------------------------------------------- what else an autopilot follows


def command(number: int, *, integer: bool) -> Any:
    if integer:
        return mavlink.MAVLink_command_int_message(1, 1, 6, number, 0, 0, 0, 0, 0, 0, 0, 0, 10.0)
    return mavlink.MAVLink_command_long_message(1, 1, number, 0, 0, 0, 0, 0, 0, 0, 10.0)


def mission_item(current: int, *, integer: bool) -> Any:
    build = mavlink.MAVLink_mission_item_int_message if integer else mavlink.MAVLink_mission_item_message
    return build(1, 1, 0, 6, mavlink.MAV_CMD_NAV_WAYPOINT, current, 1, 0, 0, 0, 0, 10, 20, 10.0)


ATTITUDE = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, 0.5)
ACTUATORS = mavlink.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.0] * 8)


@pytest.mark.parametrize(
    ("message", "kinds"),
    [
        (ATTITUDE, {PX4, COPTER}),
        (ACTUATORS, {PX4}),
        (command(mavlink.MAV_CMD_NAV_TAKEOFF, integer=False), {COPTER}),
        (command(mavlink.MAV_CMD_DO_REPOSITION, integer=True), {COPTER}),
        (command(mavlink.MAV_CMD_CONDITION_YAW, integer=False), {COPTER}),
        (command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, integer=False), set()),
        (command(mavlink.MAV_CMD_DO_SET_HOME, integer=True), set()),
        (mission_item(2, integer=False), {COPTER}),
        (mission_item(2, integer=True), {COPTER}),
        (mission_item(3, integer=True), {COPTER}),
        (mission_item(0, integer=True), set()),
        (mission_item(1, integer=False), set()),
    ],
)
@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_what_takes_the_place_of_a_setpoint_is_told(kind, message, kinds):
    frame = on_the_wire(message)
    assert frame.msg_id in SETPOINT_IDS
    result = flying(kind).app_setpoint(NOW_S, frame, SOURCE)
    assert result == (UnmetSetpoint(NOW_S, SOURCE) if kind in kinds else None)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(SETPOINT_IDS)), st.binary(max_size=60), st.sampled_from([PX4, COPTER]))
def test_no_payload_raises_and_no_setpoint_is_beyond_what_can_be_flown(msg_id, payload, kind):
    raw = bytes((0xFD, len(payload), 0, 0, 0, 255, 190)) + msg_id.to_bytes(3, "little") + payload + b"\0\0"
    result = flying(kind).app_setpoint(NOW_S, Frame(raw, msg_id, 255, 190), SOURCE)
    if isinstance(result, AppSetpoint):
        values = (*result.pos_ned_m, *result.vel_ned_mps, *result.acc_ned_mps2, result.yaw_rad, result.yaw_rate_radps)
        assert all(math.isfinite(v) and abs(v) <= 1e7 for v in values)
        assert result.use & (SetpointUse.POS | SetpointUse.VEL | SetpointUse.ACC)


# ----------------------------------------------------------------------------------------------------- what is not sent


def test_copter_is_sent_nothing_that_would_make_it_stop_or_that_it_would_not_use():
    sent = set()
    for use in range(512):
        adapter = flying(COPTER)
        action = Setpoint(1.0, SetpointUse(use) | SetpointUse.YAW, (1, 2, 3), (4, 5, 6), (7, 8, 9), 0.5, 0.0)
        if adapter.messages(action):
            sent.add(use)
        assert adapter.drops == ({} if use in sent else {Drop.OUTGOING: 1})
    groups = [0, 0b111, 0b111000, 0b111000000]
    wholes = {a | b | c for a in groups for b in groups for c in groups}
    followed = {use for use in wholes if copter_follows(local(0xDFF & ~use)) is not HOLDS}
    assert sent == followed
    assert len(sent) == 6


def test_copter_is_sent_no_speed_that_it_calls_insane():
    adapter = flying(COPTER)
    for speed_mps, count in ((1000.0, 1), (1000.5, 0)):
        action = Setpoint(1.0, SetpointUse.VEL, (0, 0, 0), (0, -speed_mps, 0), (0, 0, 0), 0, 0)
        assert len(adapter.messages(action)) == count


def test_a_heading_alone_is_no_setpoint():
    adapter = flying(PX4)
    assert adapter.messages(Setpoint(1.0, SetpointUse.YAW, (0, 0, 0), (0, 0, 0), (0, 0, 0), 0.5, 0)) == []
    assert adapter.drops == {Drop.OUTGOING: 1}
