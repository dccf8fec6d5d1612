"""Every mask in every frame through the whole engine: with a correction of zero an autopilot is told what it was told.

A vehicle hovers, by setpoints that it gets directly. What the engine lets through to it is kept from it and read as the
simulated autopilots read setpoints, whose readings are held against the autopilots' own in ``tests/link``.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from swingd.link.codec import Frame
from swingd.model.actions import Health
from swingd.model.parameters import SimulatedKind
from swingd.sim import geodesy
from swingd.sim.cascade import TrajectorySetpoint
from swingd.sim.copter import global_target_of, local_target_of
from swingd.sim.guided import GuidedTarget
from swingd.sim.plant import DT_S
from swingd.sim.px4 import global_setpoint_of, setpoint_of

from .flight import Flight, inline, local_setpoint, uncorrected

PX4, COPTER = SimulatedKind.PX4, SimulatedKind.ARDUPILOT
HOVER = local_setpoint(vel=(0.0, 0.0, 0.0))
SETPOINTS = (
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
)
MASKS = range(4096)
FILTER_HZ = 200.0
STEP_AT_MOST = 3
"""Simulation steps of 4 ms within which a filter step falls."""
VEL, ACC, YAW, YAW_RATE = (3.0, -1.0, 0.5), (0.4, 0.3, -0.2), 0.7, 0.25
LOCAL, OFFSET, BODY, BODY_OFFSET = 1, 7, 8, 9
GLOBAL_INT, RELATIVE_INT = 5, 6
Reading = TrajectorySetpoint | GuidedTarget


def local(frame: int, mask: int) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        1, 1, 1, frame, mask, 30.0, 40.0, -15.0, *VEL, *ACC, YAW, YAW_RATE
    )


def globe(frame: int, mask: int) -> Any:
    # Near the origin, where the simulated vehicles' map is everybody's.
    lat_deg, lon_deg, alt_m = geodesy.global_of((3.0, 4.0, -15.0))
    altitude_m = alt_m if frame == GLOBAL_INT else 15.0
    return mavlink.MAVLink_set_position_target_global_int_message(
        1, 1, 1, frame, mask, round(lat_deg * 1e7), round(lon_deg * 1e7), altitude_m, *VEL, *ACC, YAW, YAW_RATE
    )


class Probe:
    """A hovering vehicle that follows nothing of what passes the engine, and what it would have got."""

    def __init__(self, kind: SimulatedKind) -> None:
        self.kind = kind
        parameters = uncorrected(inline(autopilot=kind))
        # Quick steps, and so quick answers.
        estimator = replace(parameters.estimator, rate_hz=FILTER_HZ)
        self.flight = Flight(replace(parameters, estimator=estimator)).take_off()
        self.flight.connect(direct=True).setpoint = HOVER
        self.flight.run(0.5).enter_offboard().run(1.0)
        assert self.flight.health is Health.READY
        self.application = self.flight.connect()
        self.flight.withhold = self._withhold
        self.got: list[tuple[float, Frame]] = []

    def _withhold(self, frame: Frame) -> bool:
        held = frame.msg_id in SETPOINTS
        if held:
            self.got.append((self.flight.t_s, frame))
        return held

    def step(self, count: int = 1) -> None:
        self.flight.run(count * DT_S)

    def take(self) -> list[tuple[float, Frame]]:
        got, self.got = self.got, []
        return got

    def engage(self) -> None:
        """Have a setpoint met, as it is in the middle of a stream."""
        for _ in range(20):
            self.application.send(HOVER)
            self.step(STEP_AT_MOST)
            if {frame.component_id for _, frame in self.take()} == {191}:
                return
        pytest.fail(f"nothing is met: {self.flight.health}, {self.flight.texts}")

    def read(self, message: Any) -> Reading | None:
        """What the autopilot makes of a message, by what it last told of itself."""
        autopilot, view = self.flight.peer.autopilot, self.flight.engine.adapter.view
        assert view.attitude is not None
        roll, pitch, yaw = view.attitude.roll_rad, view.attitude.pitch_rad, view.attitude.yaw_rad
        is_local = message.get_msgId() == SETPOINTS[0]
        home_down_m = autopilot.home_ned_m[2]
        if self.kind is PX4 and is_local:
            return setpoint_of(message, quaternion(roll, pitch, yaw))
        if self.kind is PX4:
            return global_setpoint_of(message, home_down_m)
        here = view.position_ned_m(self.flight.t_s)
        assert here is not None
        return local_target_of(message, here, yaw) if is_local else global_target_of(message, home_down_m)


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a / 2), math.cos(a / 2)) for a in (roll, pitch, yaw))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def takes_a_correction(reading: Reading | None) -> bool:
    """Whether north and east are asked for together, in a way that a correction can enter (docs/inline.md)."""
    if isinstance(reading, TrajectorySetpoint):
        pairs = [
            [value is not None for value in group[:2]]
            for group in (reading.pos_ned_m, reading.vel_ned_mps, reading.acc_ned_mps2)
        ]
        return all(north == east for north, east in pairs) and any(north for north, _ in pairs)
    if reading is None:
        return False
    return reading.vel_ned_mps is not None or reading.pos_ned_m is None


def parts(reading: Reading, age_s: float, heading_rad: float) -> Iterator[float | None]:
    """Position, velocity, acceleration, yaw and yaw rate as they are after a time; None is not asked for."""
    pos, vel, acc = (
        list(group or (None, None, None)) for group in (reading.pos_ned_m, reading.vel_ned_mps, reading.acc_ned_mps2)
    )
    yaw, rate = reading.yaw_rad, reading.yaw_rate_radps
    if isinstance(reading, GuidedTarget):
        # Copter lets a target move by its own derivatives.
        for i in range(3):
            v, a = vel[i], acc[i] or 0.0
            if v is not None:
                vel[i] = v + a * age_s
                pos[i] = None if pos[i] is None else pos[i] + v * age_s + 0.5 * a * age_s**2
        if reading.yaw_is_relative and yaw is not None:
            yaw, rate = math.remainder(heading_rad + yaw, 2.0 * math.pi), None
        elif yaw is not None and rate is not None:
            yaw += rate * age_s
    yield from (*pos, *vel, *acc, yaw, rate)


def assert_same(probe: Probe, told: Reading, frame: Frame, age_s: float, original: Any) -> None:
    """The autopilot reads a frame of swingd's as it would read the original after a time."""
    what = f"{original.coordinate_frame=} {original.type_mask=:#05x} became {frame.message.to_dict()}"
    assert frame.component_id == 191, what
    assert frame.message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED, what
    again = probe.read(frame.message)
    assert again is not None, what
    heading_rad = probe.flight.engine.adapter.view.yaw_sp_rad(probe.flight.t_s)
    assert heading_rad is not None
    # Copter cuts altitudes to whole centimetres; PX4 takes the altitude of home with the wrong sign.
    slack_m = 0.02 + (2.0 * abs(probe.flight.peer.autopilot.home_ned_m[2]) if probe.kind is PX4 else 0.0)
    wanted, got = list(parts(told, age_s, heading_rad)), list(parts(again, 0.0, 0.0))
    for i, (a, b) in enumerate(zip(got, wanted, strict=True)):
        if a is None or b is None:
            assert a is b, what
        else:
            # The vehicle is not quite still between order and answer.
            assert abs(a - b) <= (slack_m if i < 3 else 0.005), what


@pytest.fixture(scope="module", params=[PX4, COPTER], ids=["PX4", "Copter"])
def probe(request: pytest.FixtureRequest) -> Probe:
    return Probe(request.param)


def walk(probe: Probe, frame: int, make: Callable[[int, int], Any]) -> int:
    """Send every mask; return how many were met."""
    met: list[Any] = []
    passing: list[Any] = []
    for mask in MASKS:
        message = make(frame, mask)
        (met if takes_a_correction(probe.read(message)) else passing).append(message)
    if met:
        probe.engage()
    for message in met:
        told, sent_s = probe.read(message), probe.flight.t_s
        assert told is not None
        probe.application.send(message)
        for _ in range(STEP_AT_MOST):
            probe.step()
            if probe.got:
                break
        got = probe.take()
        assert len(got) == 1, f"{message} became {[frame.message for _, frame in got]}"
        # The engine's clock at its answer is that of the end of the step.
        assert_same(probe, told, got[0][1], got[0][0] - sent_s, message)
    probe.engage()
    originals = [probe.application.send(message) for message in passing]
    probe.step()
    passed = [frame.raw for _, frame in probe.take() if frame.component_id == 190]
    assert passed == originals, "each once, in order, as it came"
    return len(met)


# Of the 512 ways to ignore axes those count whose groups are asked for as that autopilot takes them, each with and
# without yaw, yaw rate and FORCE, which only goes with no acceleration.
@pytest.mark.parametrize(
    ("frame", "px4", "copter"), [(LOCAL, 272, 676), (OFFSET, 0, 676), (BODY, 704, 676), (BODY_OFFSET, 0, 676)]
)
def test_every_mask_in_every_local_frame(probe: Probe, frame: int, px4: int, copter: int) -> None:
    assert walk(probe, frame, local) == (px4 if probe.kind is PX4 else copter)


@pytest.mark.parametrize(("frame", "px4", "copter"), [(GLOBAL_INT, 472, 676), (RELATIVE_INT, 472, 676)])
def test_every_mask_in_every_global_frame(probe: Probe, frame: int, px4: int, copter: int) -> None:
    assert walk(probe, frame, globe) == (px4 if probe.kind is PX4 else copter)


@pytest.mark.parametrize(
    ("mask", "goes_on"),
    [
        (0xFFF, {PX4}),  # nothing
        (0xE3F, {PX4}),  # an acceleration that is a force
        (0xDEF, set()),  # the velocity east alone
        (0xDBF, set()),  # the acceleration north alone
    ],
)
def test_what_passes_ends_the_repetition_unless_the_autopilot_does_not_take_it(
    probe: Probe, mask: int, goes_on: set[SimulatedKind]
) -> None:
    """PX4 goes on with what it had before one that it rejects, and so does swingd; Copter stops, and swingd with it."""
    probe.engage()
    probe.application.send(HOVER)
    original = probe.application.send(local(LOCAL, mask))
    probe.step(2 * STEP_AT_MOST)
    got = [frame for _, frame in probe.take()]
    assert [frame.raw for frame in got if frame.component_id == 190] == [original]
    assert any(frame.component_id == 191 for frame in got) == (probe.kind in goes_on)
