"""Feed-forward between an application's setpoints and the correction: which it takes, how it blends, what it plans."""

import itertools
import math
from dataclasses import replace

import pytest

from swingd.model.events import AutopilotKind, SetpointUse, Vec3
from swingd.model.parameters import Parameters, ShaperName
from swingd.pipeline.feed_forward import CARRIED_MAX_S, FeedForward
from swingd.pipeline.merge import ACC_XY, POS_XY, VEL_XY, Reference

DT_S = 0.01
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
NO_SWING = ((0.0, 0.0), (0.0, 0.0))


def velocity(
    north: float = 0.0, east: float = 0.0, down: float = 0.0, use: SetpointUse = SetpointUse.VEL | SetpointUse.YAW
) -> Reference:
    return Reference(use, vel_ned_mps=(north, east, down), yaw_rad=0.7, yaw_rate_radps=0.1)


def follow(
    feed_forward: FeedForward,
    reference: Reference,
    duration_s: float,
    *,
    name: ShaperName = ShaperName.ZV,
    kind: AutopilotKind = PX4,
    fade: float = 1.0,
) -> list[Reference]:
    return [
        feed_forward.update(reference, name, kind=kind, fade=fade, dt_s=DT_S, place_m=(10.0, 20.0))
        for _ in range(round(duration_s / DT_S))
    ]


def hovering(kind: AutopilotKind = PX4) -> FeedForward:
    feed_forward = FeedForward(Parameters())
    follow(feed_forward, velocity(), 0.5, kind=kind)
    return feed_forward


@pytest.mark.parametrize(
    ("reference", "name", "fade"),
    [
        (velocity(3.0, 1.0, -0.5), ShaperName.NONE, 1.0),
        (velocity(3.0, 1.0, -0.5), ShaperName.ZV, 0.0),
        (Reference(ACC_XY, acc_ned_mps2=(1.0, 0.0, 0.0)), ShaperName.ZV, 1.0),
        (Reference(SetpointUse.POS_D | ACC_XY, pos_ned_m=(0.0, 0.0, -5.0)), ShaperName.EI, 1.0),
        (Reference(SetpointUse.VEL_N, vel_ned_mps=(1.0, 0.0, 0.0)), ShaperName.EI, 1.0),
    ],
    ids=["no shaper", "faded", "acceleration", "acceleration at an altitude", "half a velocity"],
)
def test_what_is_not_shaped_comes_back_as_it_is(reference: Reference, name: ShaperName, fade: float) -> None:
    feed_forward = hovering()
    follow(feed_forward, velocity(2.0), 0.5)
    for given in follow(feed_forward, reference, 0.1, name=name, fade=fade):
        assert given is reference
    assert feed_forward.swing == NO_SWING, "nothing is planned"


@pytest.mark.parametrize("kind", [PX4, ARDUPILOT])
@pytest.mark.parametrize("use", [VEL_XY, VEL_XY | SetpointUse.POS_D, SetpointUse.VEL | ACC_XY | SetpointUse.YAW_RATE])
def test_a_velocity_gets_an_acceleration_and_keeps_everything_else(kind: AutopilotKind, use: SetpointUse) -> None:
    feed_forward = hovering(kind)
    asked = replace(
        velocity(2.0, -1.0, -0.5, use=use), pos_ned_m=(1.0, 2.0, -6.0), acc_ned_mps2=(0.3, 0.3, 0.2), yaw_rad=1.1
    )
    given = follow(feed_forward, asked, 0.6, kind=kind)[-1]
    if kind is PX4:
        assert given.use == use | ACC_XY
    else:
        assert given.use == use | SetpointUse.VEL | SetpointUse.ACC, "whole groups"
    assert given.pos_ned_m == asked.pos_ned_m
    assert (given.yaw_rad, given.yaw_rate_radps) == (asked.yaw_rad, asked.yaw_rate_radps)
    assert given.vel_ned_mps[2] == (asked.vel_ned_mps[2] if use & SetpointUse.VEL_D else 0.0)
    assert given.acc_ned_mps2[2] == (asked.acc_ned_mps2[2] if use & SetpointUse.ACC_D else 0.0)
    assert 0.0 < given.vel_ned_mps[0] < 1.5
    assert -0.75 < given.vel_ned_mps[1] < 0.0
    assert given.acc_ned_mps2[0] > 0.5
    assert given.acc_ned_mps2[1] == pytest.approx(-0.5 * given.acc_ned_mps2[0])


def test_a_position_gets_velocity_and_acceleration_and_is_met_exactly() -> None:
    feed_forward = FeedForward(Parameters())
    here = Reference(POS_XY | SetpointUse.POS_D | SetpointUse.YAW, pos_ned_m=(10.0, 20.0, -6.0), yaw_rad=0.4)
    follow(feed_forward, here, 0.1)
    there = replace(here, pos_ned_m=(14.0, 18.0, -7.0))
    given = follow(feed_forward, there, 30.0)
    assert given[0].use == there.use | VEL_XY | ACC_XY
    assert given[0].pos_ned_m[:2] == pytest.approx((10.0, 20.0), abs=0.01)
    assert given[0].pos_ned_m[2] == -7.0, "the altitude is not shaped"
    assert given[-1].pos_ned_m == pytest.approx((14.0, 18.0, -7.0), abs=1e-6)
    assert given[-1].vel_ned_mps == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert given[-1].acc_ned_mps2 == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    for before, after in itertools.pairwise(given):
        for i in (0, 1):
            mean = 0.5 * (before.vel_ned_mps[i] + after.vel_ned_mps[i])
            assert after.pos_ned_m[i] - before.pos_ned_m[i] == pytest.approx(mean * DT_S, abs=1e-4), "consistent"


def test_a_position_with_velocity_moves_on_until_the_next_comes() -> None:
    """Ten a second: the motion that is planned does not stop in between, and stays at the mean delay behind."""
    feed_forward = FeedForward(Parameters())
    use = POS_XY | VEL_XY
    given = []
    for k in range(1500):
        age_s = (k % 10) * DT_S
        asked = Reference(use, pos_ned_m=(1.2 * (k * DT_S - age_s), 0.0, 0.0), vel_ned_mps=(1.2, 0.0, 0.0))
        given.append(
            feed_forward.update(asked, ShaperName.ZV, kind=PX4, fade=1.0, dt_s=DT_S, age_s=age_s).vel_ned_mps[0]
        )
    assert given[-500:] == pytest.approx([1.2] * 500, abs=1e-3)
    last = Reference(use, pos_ned_m=(18.0, 0.0, 0.0), vel_ned_mps=(1.2, 0.0, 0.0))
    for k in range(3000):
        final = feed_forward.update(last, ShaperName.ZV, kind=PX4, fade=1.0, dt_s=DT_S, age_s=k * DT_S)
    assert final.pos_ned_m[0] == pytest.approx(18.0 + 1.2 * CARRIED_MAX_S, abs=1e-6), "not for ever"
    assert final.vel_ned_mps[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("asked", [velocity(3.0, -2.0), Reference(POS_XY, pos_ned_m=(14.0, 18.0, 0.0))])
def test_the_fade_leads_from_what_is_asked_for_to_the_shaped(asked: Reference) -> None:
    feed_forwards = [hovering() for _ in range(3)]
    for _ in range(80):
        none, half, whole = (
            each.update(asked, ShaperName.ZV, kind=PX4, fade=fade, dt_s=DT_S, place_m=(10.0, 20.0))
            for each, fade in zip(feed_forwards, (1e-12, 0.5, 1.0), strict=True)
        )
        for part in ("pos_ned_m", "vel_ned_mps", "acc_ned_mps2"):
            original: Vec3 = getattr(asked, part)
            middle = [0.5 * (a + b) for a, b in zip(original, getattr(whole, part), strict=True)]
            assert getattr(none, part) == pytest.approx(original, abs=1e-9)
            assert getattr(half, part) == pytest.approx(middle, abs=1e-9)


def test_after_a_break_it_begins_at_what_is_asked_for_then() -> None:
    feed_forward = hovering()
    follow(feed_forward, velocity(3.0), 0.4)
    follow(feed_forward, velocity(3.0), 0.1, fade=0.0)
    given = follow(feed_forward, velocity(3.0), 1.0)
    assert all(one.vel_ned_mps[:2] == pytest.approx((3.0, 0.0), abs=1e-9) for one in given)
    assert all(one.acc_ned_mps2[:2] == pytest.approx((0.0, 0.0), abs=1e-9) for one in given)


def test_the_swing_that_is_planned_is_the_one_of_the_motion() -> None:
    """Signs: a vehicle that accelerates north leaves its load behind, and to the west if it accelerates east."""
    feed_forward = hovering()
    assert math.hypot(*feed_forward.swing[0]) < 1e-9
    sizes = []
    for k in range(800):
        follow(feed_forward, velocity(3.0, 1.5), DT_S)
        (north, east), (rate_n, _) = feed_forward.swing
        sizes.append(math.hypot(north, east))
        if k == 50:
            assert north < 0.0
            assert rate_n < 0.0
            assert east == pytest.approx(0.5 * north)
    assert math.degrees(max(sizes)) > 8.0
    assert math.degrees(max(sizes[400:])) < 0.05
    feed_forward.drop()
    assert feed_forward.swing == NO_SWING


@pytest.mark.parametrize("moment_s", [0.3, 1.2, 3.0])
def test_other_parameters_on_the_way_cause_no_jump(moment_s: float) -> None:
    feed_forward = hovering()
    given = follow(feed_forward, velocity(3.0), moment_s)
    known = Parameters()
    changed = replace(
        known,
        cable=replace(known.cable, length_m=1.8),
        payload=replace(known.payload, mass_kg=0.4),
        shaping=replace(known.shaping, acc_max_mps2=1.5),
    )
    feed_forward.configure(changed)
    given += follow(feed_forward, velocity(3.0), 20.0)
    speeds = [one.vel_ned_mps[0] for one in given]
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds)) < 3.0 * DT_S
    # The other load's pull is commanded at once: a tenth of a kilogramme of it at most.
    accelerations = [one.acc_ned_mps2[0] for one in given]
    moment = round(moment_s / DT_S)
    assert abs(accelerations[moment] - accelerations[moment - 1]) < 0.6
    assert speeds[-1] == pytest.approx(3.0, abs=1e-6)
    fresh = FeedForward(changed)
    follow(fresh, velocity(3.0), 0.1)
    for one, other in zip(follow(feed_forward, velocity(), 4.0), follow(fresh, velocity(), 4.0), strict=True):
        assert one.vel_ned_mps == pytest.approx(other.vel_ned_mps, abs=1e-6), "the step after it is the other load's"
