"""Where a correction enters a setpoint, by the rules of each autopilot."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.link.setpoints import pack
from swingd.model.actions import Setpoint
from swingd.model.events import AppSetpoint, AutopilotKind, SetpointUse
from swingd.pipeline.correction import NO_PUSH, Push
from swingd.pipeline.merge import Reference, carried, is_correctable, merge, reference_of

PX4, COPTER, OTHER = AutopilotKind.PX4, AutopilotKind.ARDUPILOT, AutopilotKind.OTHER
POS, VEL, ACC = SetpointUse.POS, SetpointUse.VEL, SetpointUse.ACC
YAW, YAW_RATE = SetpointUse.YAW, SetpointUse.YAW_RATE
USES = [SetpointUse(bits & ~0x200) for bits in range(4096) if not bits & 0x200]
PUSH = Push((1.0, -2.0), (0.3, 0.4), (-0.5, 0.25))


def axes(use: SetpointUse) -> list[tuple[bool, bool, bool]]:
    """Whether north, east and down of position, velocity and acceleration are asked for."""
    bits = [bool(use & 1 << bit) for bit in range(9)]
    return [(bits[i], bits[i + 1], bits[i + 2]) for i in (0, 3, 6)]


def reference(use: SetpointUse) -> Reference:
    return Reference(use, (30.0, 40.0, -15.0), (3.0, -1.0, 0.5), (0.4, 0.3, -0.2), 0.7, 0.25)


def packed(kind: AutopilotKind, merged: Reference) -> object | None:
    values = (merged.pos_ned_m, merged.vel_ned_mps, merged.acc_ned_mps2, merged.yaw_rad, merged.yaw_rate_radps)
    return pack(kind, 1, 1, Setpoint(1.0, merged.use, *values))


def test_what_px4_flies_axis_by_axis_takes_a_correction_where_north_and_east_go_together() -> None:
    for use in USES:
        pairs = [(north, east) for north, east, _ in axes(use)]
        expected = all(north == east for north, east in pairs) and (True, True) in pairs
        assert is_correctable(use, PX4) == expected, use


def test_what_copter_flies_in_groups_takes_a_correction_unless_it_is_a_place_alone() -> None:
    correctable = {POS | VEL, POS | VEL | ACC, VEL, VEL | ACC, ACC}
    for use in USES:
        assert is_correctable(use, COPTER) == (use & ~(YAW | YAW_RATE) in correctable), use


def test_of_an_unknown_autopilot_nothing_takes_a_correction() -> None:
    assert not any(is_correctable(use, OTHER) for use in USES)


@pytest.mark.parametrize("kind", [PX4, COPTER])
@pytest.mark.parametrize("push", [NO_PUSH, Push((0.0, -0.0), (-0.0, 0.0), (0.0, 0.0)), PUSH.scaled(0.0)])
def test_nothing_is_added_to_a_setpoint_by_no_push(kind: AutopilotKind, push: Push) -> None:
    for use in USES:
        assert merge(reference(use), push, kind) == reference(use)


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_what_is_corrected_is_followed(kind: AutopilotKind) -> None:
    count = 0
    for use in USES:
        if is_correctable(use, kind):
            count += 1
            merged = merge(reference(use), PUSH, kind)
            assert packed(kind, merged) is not None, use
            assert is_correctable(merged.use, kind), use
    assert count == {PX4: 56 * 4, COPTER: 5 * 4}[kind]


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_every_loop_above_the_acceleration_gets_its_share(kind: AutopilotKind) -> None:
    for use in filter(lambda use: is_correctable(use, kind), USES):
        before, after = reference(use), merge(reference(use), PUSH, kind)
        (pos, _, pos_d), (vel, _, vel_d), (acc, _, acc_d) = axes(use)
        merged_axes = axes(after.use)
        assert merged_axes[2][:2] == (True, True)
        assert after.acc_ned_mps2[:2] == ((1.4, -1.7) if acc else (1.0, -2.0))
        assert merged_axes[1][:2] == ((True, True) if pos or vel else (False, False))
        if pos or vel:
            assert after.vel_ned_mps[:2] == ((3.3, -0.6) if vel else (0.3, 0.4))
        assert merged_axes[0] == axes(use)[0]
        if pos:
            assert after.pos_ned_m[:2] == (29.5, 40.25)
        # Down, and the heading, are as they were; what Copter needs besides for whole groups asks for nothing.
        for asked, is_asked, value, was in (
            (pos_d, merged_axes[0][2], after.pos_ned_m[2], before.pos_ned_m[2]),
            (vel_d, merged_axes[1][2], after.vel_ned_mps[2], before.vel_ned_mps[2]),
            (acc_d, merged_axes[2][2], after.acc_ned_mps2[2], before.acc_ned_mps2[2]),
        ):
            if asked:
                assert is_asked
                assert value == was
            elif is_asked:
                assert kind is COPTER
                assert value == 0.0
        assert (after.yaw_rad, after.yaw_rate_radps) == (0.7, 0.25)
        assert after.use & (YAW | YAW_RATE) == use & (YAW | YAW_RATE)


def test_a_reference_is_what_the_application_asks_for() -> None:
    asked = AppSetpoint(1.0, POS | YAW, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0), 0.5, 0.6, 7)
    assert reference_of(asked) == Reference(POS | YAW, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0), 0.5, 0.6)


# ------------------------------------------------------------------------------------------------------------ carried


def test_px4_flies_what_it_was_given_last_as_it_stands() -> None:
    for use in USES[::7]:
        assert carried(reference(use), 0.3, PX4) == reference(use)


def test_at_once_nothing_has_moved() -> None:
    for use in USES[::7]:
        assert carried(reference(use), 0.0, COPTER) == reference(use)


@given(st.sampled_from([POS, POS | VEL, POS | VEL | ACC, VEL, VEL | ACC, ACC]), st.booleans(), st.booleans(), st.data())
def test_copter_moves_a_target_on_by_its_derivatives(
    use: SetpointUse, yaw: bool, rate: bool, data: st.DataObject
) -> None:
    """Step by step, as its position control does: the velocity by the acceleration, the place by the velocity."""
    use |= (YAW if yaw else SetpointUse.NONE) | (YAW_RATE if rate else SetpointUse.NONE)
    numbers = st.tuples(*[st.floats(-9.0, 9.0)] * 3)
    asked = Reference(use, *(data.draw(numbers) for _ in range(3)), data.draw(st.floats(-3.0, 3.0)), 0.4)
    steps, dt_s = 200, 0.0025
    pos, vel, heading = list(asked.pos_ned_m), list(asked.vel_ned_mps), asked.yaw_rad
    acc = asked.acc_ned_mps2 if use & ACC else (0.0, 0.0, 0.0)
    for _, i in itertools.product(range(steps), range(3)):
        if use & VEL:
            if use & POS:
                pos[i] += (vel[i] + 0.5 * acc[i] * dt_s) * dt_s
            vel[i] += acc[i] * dt_s
    if yaw and rate:
        heading += asked.yaw_rate_radps * steps * dt_s
    moved = carried(asked, steps * dt_s, COPTER)
    assert moved.use == use
    assert moved.pos_ned_m == pytest.approx(pos)
    assert moved.vel_ned_mps == pytest.approx(vel)
    assert moved.acc_ned_mps2 == asked.acc_ned_mps2
    assert math.remainder(moved.yaw_rad - heading, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert moved.yaw_rate_radps == 0.4
