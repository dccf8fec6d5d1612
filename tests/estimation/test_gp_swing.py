"""The GP-EKF as a swing estimator: frames, begin, sources that stay away, resets, any numbers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.core.gp_ekf import Source
from swingd.core.slts import SltsState
from swingd.core.status import Status
from swingd.estimation import GpSwing, LoadEstimator, SwingEkf, make_estimator
from swingd.estimation.acceleration_model import AccelerationModel, TrainedFor
from swingd.estimation.base import LoadMeasurement
from swingd.estimation.gp_swing import settings_of
from swingd.model.errors import ConfigurationError
from swingd.model.estimate import ResetReason
from swingd.model.parameters import Parameters

MASS_KG, PAYLOAD_KG, LENGTH_M, G = 2.0, 0.3, 1.5, 9.80665
HOVER_N = np.array([0.0, 0.0, -(MASS_KG + PAYLOAD_KG) * G])
DT_S = 0.01
START_S = 100.0


def gp(**changes):
    return GpSwing(replace(Parameters(), **changes))


class World:
    """A hook whose motion is given, the load below it as a point pendulum, and an estimator that is told of them."""

    def __init__(self, estimator, to_ned_rad=0.0):
        self.estimator, self.to_ned_rad = estimator, to_ned_rad
        self.t_s = START_S
        self.vehicle, self.vel, self.rel, self.rel_vel = np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(2)

    def run(self, duration_s, acc_ned=(0.0, 0.0), camera=False, sources=True):
        """Accelerate level; the thrust is what this takes with the load at small angles."""
        acc = np.array([*acc_ned, 0.0])
        c, s = math.cos(self.to_ned_rad), math.sin(self.to_ned_rad)
        for step in range(round(duration_s / DT_S)):
            rel_acc = acc[:2] - G / LENGTH_M * self.rel
            pull = PAYLOAD_KG * G / LENGTH_M * self.rel
            force = MASS_KG * acc + np.array([*pull, 0.0]) + HOVER_N
            self.rel_vel = self.rel_vel + DT_S * rel_acc
            self.rel = self.rel + DT_S * self.rel_vel
            self.vehicle = self.vehicle + DT_S * (self.vel + 0.5 * DT_S * acc)
            self.vel = self.vel + DT_S * acc
            self.t_s += DT_S
            level = np.array([c * force[0] + s * force[1], -s * force[0] + c * force[1], force[2]])
            self.estimator.stand(self.t_s, self.to_ned_rad)
            status = self.estimator.step(level, np.zeros(3), DT_S)
            assert status in (Status.OK, Status.GATED)
            if sources and step % 4 == 0:
                self.tell(Source.VEHICLE_POS, self.vehicle, 0.1)
                self.tell(Source.VEHICLE_VEL, self.vel, 0.1)
            if camera and step % 7 == 0:
                self.tell(Source.REL_POS, [*self.rel, -math.sqrt(LENGTH_M**2 - self.rel @ self.rel)], 0.06)
        return self

    def tell(self, source, value, std, late_s=0.0):
        return self.estimator.correct(LoadMeasurement(source, tuple(map(float, value)), (std,) * 3, self.t_s - late_s))


def test_it_is_chosen_by_name_and_takes_sources():
    parameters = Parameters()
    chosen = make_estimator(replace(parameters, estimator=replace(parameters.estimator, name="gp-ekf")))
    assert isinstance(chosen, GpSwing)
    assert isinstance(chosen, LoadEstimator)
    assert not isinstance(SwingEkf(parameters), LoadEstimator)


def test_before_the_first_position_it_runs_and_says_that_it_knows_nothing():
    estimator = gp()
    World(estimator).run(1.0, sources=False)
    assert estimator.load is None
    assert estimator.estimate().P[0, 0] > 0.5
    assert sum(estimator.resets.values()) == 0


@pytest.mark.parametrize("to_ned_rad", [0.0, 2.0])
def test_accelerating_north_the_load_trails_behind(to_ned_rad):
    """Level frame turned or not: the load is south of the vehicle, and the swing is that of the level frame."""
    world = World(gp(), to_ned_rad).run(1.0).run(0.6, acc_ned=(3.0, 0.0))
    load = world.estimator.load.x
    assert load[SltsState.REL_POS] == pytest.approx(world.rel[0], abs=0.03)
    assert load[SltsState.REL_POS] > 0.1
    assert load[SltsState.LOAD_POS] < world.vehicle[0]
    x = world.estimator.estimate().x
    # The horizontal part of the cable, hook to load, turned from level to ned.
    level = np.array([math.sin(x[1]), -math.sin(x[0]) * math.cos(x[1])])
    c, s = math.cos(to_ned_rad), math.sin(to_ned_rad)
    np.testing.assert_allclose([c * level[0] - s * level[1], s * level[0] + c * level[1]], -world.rel / LENGTH_M,
                               atol=0.03)  # fmt: skip


def test_its_tension_and_rates_are_those_of_the_pendulum():
    world = World(gp()).run(1.0).run(0.5, acc_ned=(2.0, 1.0))
    estimate = world.estimator.estimate()
    assert estimate.tension_n == pytest.approx(PAYLOAD_KG * G, rel=0.1)
    np.testing.assert_allclose(estimate.x_rate[:2], estimate.x[2:4], atol=1e-9)
    expected = (np.array([2.0, 1.0]) - G / LENGTH_M * world.rel) / LENGTH_M
    np.testing.assert_allclose(estimate.x_rate[2:], [expected[1], -expected[0]], atol=0.3)


def test_a_steady_wind_on_the_vehicle_is_not_taken_for_a_load_that_hangs_aside():
    """1 N looks like the pull of a load that hangs 20 deg aside; but such a load would swing, and none does."""
    world = World(gp()).run(1.0)
    step = world.estimator.step

    def pushed(force, acc, dt, **more):
        return step(force - np.array([1.0, 0.0, 0.0]), acc, dt, **more)

    world.estimator.step = pushed
    world.run(20.0)
    np.testing.assert_allclose(np.degrees(world.estimator.estimate().x[:2]), 0.0, atol=0.5)


def test_a_late_picture_counts_at_its_own_time():
    """Two that differ only in when the picture comes agree when it has come."""
    worlds = [World(gp()).run(1.0).run(0.5, acc_ned=(3.0, 0.0)) for _ in range(2)]
    now, later = worlds
    seen = [0.35, 0.05, -math.sqrt(LENGTH_M**2 - 0.35**2 - 0.05**2)]
    assert now.tell(Source.REL_POS, seen, 0.05) is Status.OK
    for world in worlds:
        world.run(0.1, acc_ned=(3.0, 0.0), sources=False)
    assert not np.allclose(now.estimator.estimate().x, later.estimator.estimate().x, atol=1e-3)
    assert later.tell(Source.REL_POS, seen, 0.05, late_s=0.1) is Status.OK
    for world in worlds:
        world.run(DT_S, acc_ned=(3.0, 0.0), sources=False)
    np.testing.assert_allclose(later.estimator.estimate().x, now.estimator.estimate().x, atol=1e-6)
    assert later.tell(Source.REL_POS, seen, 0.05, late_s=30.0) is Status.TOO_LATE


def test_where_positions_stay_away_its_angles_are_told_as_unknown():
    """Half a second is bridged; the filter itself goes on, and is known again with the first position."""
    world = World(gp()).run(15.0)
    before = world.estimator.estimate().P[0, 0]
    world.run(0.45, sources=False)
    assert world.estimator.estimate().P[0, 0] < 1.5 * before
    world.run(0.1, sources=False)
    assert world.estimator.estimate().P[0, 0] > 1.0
    world.run(15.0, sources=False)
    assert world.estimator.load.P[3, 3] > 4.0 * before * LENGTH_M**2
    world.run(0.1)
    assert world.estimator.estimate().P[0, 0] < 0.1


def told_nis(world, duration_s):
    """Largest that is told, a step at a time."""
    largest = 0.0
    for _ in range(round(duration_s / DT_S)):
        world.run(DT_S)
        largest = max(largest, world.estimator.estimate().nis)
    return largest


def test_before_it_runs_nothing_agrees_with_measurements():
    """So that the time in which a filter must have been consistent begins with it."""
    world = World(gp()).run(0.2, sources=False)
    assert world.estimator.estimate().nis > 100.0
    assert told_nis(world.run(0.2), 1.0) < 10.0


@pytest.mark.parametrize("late_s", [0.0, 0.08, 0.3])
def test_a_picture_of_something_else_tells_until_the_next_is_due_however_old_it_is(late_s):
    world = World(gp()).run(3.0)
    for _ in range(3):
        world.run(0.1)
        assert world.tell(Source.REL_POS, (1.2, 0.0, -0.9), 0.05, late_s) is Status.GATED
    assert told_nis(world, 0.05) > 30.0
    assert told_nis(world.run(0.2), 1.0) < 10.0


def test_pictures_of_something_else_never_make_it_forget_what_it_knows():
    world = World(gp()).run(3.0)
    for _ in range(50):
        world.run(0.1)
        assert world.tell(Source.REL_POS, (1.2, 0.0, -0.9), 0.05) is Status.GATED
    assert sum(world.estimator.resets.values()) == 0
    np.testing.assert_allclose(np.degrees(world.estimator.estimate().x[:2]), 0.0, atol=1.0)


def test_what_a_life_before_was_told_says_nothing_after_a_restart():
    world = World(gp()).run(3.0)
    world.tell(Source.REL_POS, (1.2, 0.0, -0.9), 0.05)
    world.estimator.reset(ResetReason.CLOCK)
    world.t_s = 5.0
    world.run(1.0)
    assert told_nis(world, 1.0) < 10.0


def test_a_cable_that_is_felt_elsewhere_than_it_is_believed_to_be_is_a_disagreement():
    """The vehicle is pulled to and fro as by a load at 0.7 rad; the filter is told of none of it but the acceleration.

    Where a camera sees the load hang still, it is wind.
    """

    def mean(pull_n, camera=False):
        world = World(gp()).run(3.0)
        step, nis = world.estimator.step, []

        def shaken(force, _acc, dt, **more):
            pulled = np.array([pull_n * math.sin(2.6 * world.t_s) / MASS_KG, 0.0, 0.0])
            status = step(force, pulled, dt, **more)
            nis.append(world.estimator.estimate().nis)
            return status

        world.estimator.step = shaken
        world.run(6.0, camera=camera)
        return np.mean(nis[200:])

    assert mean(0.7 * PAYLOAD_KG * G) > 20.0
    assert mean(0.7 * PAYLOAD_KG * G, camera=True) < 5.0
    assert mean(0.1 * PAYLOAD_KG * G) < 5.0


def test_a_wide_beginning_is_one_that_the_filter_can_begin_with():
    wide = replace(Parameters().estimator, swing_std_init_rad=1.5)
    world = World(gp(estimator=wide)).run(2.0)
    assert sum(world.estimator.resets.values()) == 0
    assert world.estimator.estimate().P[0, 0] < 0.1


def test_its_memory_covers_the_cameras_delay():
    slow = replace(Parameters().camera, source="landing_target", delay_s=0.5)
    fast = replace(Parameters().estimator, rate_hz=400.0)
    assert settings_of(replace(Parameters(), camera=slow, estimator=fast)).memory > 0.6 * (400.0 + 66.0 + 30.0)


def test_a_gap_begins_it_anew_below_where_the_vehicle_is_and_is_no_failure():
    world = World(gp()).run(2.0).run(0.5, acc_ned=(3.0, 0.0))
    world.t_s += 0.7
    world.vehicle = world.vehicle + 0.7 * world.vel
    world.tell(Source.VEHICLE_POS, world.vehicle, 0.1)
    world.tell(Source.VEHICLE_VEL, world.vel, 0.1)
    world.run(DT_S)
    assert world.estimator.resets[ResetReason.GAP] == 1
    assert world.estimator.load.x[0] == pytest.approx(world.vehicle[0], abs=0.1)


def test_a_reset_of_the_yaw_turns_the_cable_about_the_vehicle():
    """North was wrong by 0.4 rad; in the level frame, which the gyro holds, the load is where it was, and stays."""
    straight, turned = (World(gp()).run(1.0).run(0.5, acc_ned=(3.0, 1.0)) for _ in range(2))
    load = turned.estimator.load.x
    turned.estimator.turn(0.4)
    R = np.array([[math.cos(0.4), -math.sin(0.4)], [math.sin(0.4), math.cos(0.4)]])
    after = turned.estimator.load.x
    np.testing.assert_allclose(after[:2] + after[3:5], load[:2] + load[3:5], atol=1e-9)
    np.testing.assert_allclose(after[3:5], R @ load[3:5], atol=1e-9)
    turned.to_ned_rad, turned.rel, turned.rel_vel = 0.4, R @ turned.rel, R @ turned.rel_vel
    straight.run(0.3, acc_ned=(3.0, 1.0), sources=False)
    turned.run(0.3, acc_ned=tuple(R @ [3.0, 1.0]), sources=False)
    expected, told = straight.estimator.estimate(), turned.estimator.estimate()
    np.testing.assert_allclose(told.x[:4], expected.x[:4], atol=1e-6)
    np.testing.assert_allclose(told.P[:4, :4], expected.P[:4, :4], atol=1e-6)


def test_it_begins_anew_where_it_is_told_to_and_counts_that():
    world = World(gp()).run(1.0).run(0.4, acc_ned=(3.0, 0.0))
    world.estimator.reset(ResetReason.LIFT)
    assert world.estimator.load is None
    assert world.estimator.resets[ResetReason.LIFT] == 1
    world.run(0.05)
    assert abs(world.estimator.load.x[SltsState.REL_POS]) < 0.05
    # A position of long ago is none to begin at.
    world.estimator.reset(ResetReason.GAP)
    world.t_s += 5.0
    world.run(0.05, sources=False)
    assert world.estimator.load is None


def test_a_clock_that_goes_back_does_not_stop_it():
    world = World(gp()).run(1.0)
    world.estimator.reset(ResetReason.CLOCK)
    world.t_s = 2.0
    world.run(0.5)
    assert world.estimator.load is not None


def test_where_it_began_anew_between_two_steps_the_next_one_says_so():
    """Positions that are contradicted for over a second."""
    world = World(gp()).run(1.0)
    told = []
    step = world.estimator.step

    def noted(*inputs, **more):
        told.append(step(*inputs, **more))
        return Status.OK

    world.estimator.step = noted
    answers = set()
    for _ in range(40):
        world.run(0.03, sources=False)
        answers.add(world.tell(Source.VEHICLE_POS, world.vehicle + np.array([50.0, 0.0, 0.0]), 0.1))
    assert answers == {Status.OK, Status.GATED, Status.NOT_CONVERGED}
    assert told.count(Status.NOT_CONVERGED) == 1
    assert world.estimator.resets[ResetReason.INNOVATION] == 1


def test_what_was_learned_with_another_load_is_not_used_and_that_is_said():
    trained_for = TrainedFor(MASS_KG, PAYLOAD_KG, LENGTH_M)
    ones = np.ones((1, 2))
    learned = AccelerationModel(trained_for, np.ones((2, 4)), np.ones(2), np.zeros((1, 4)), ones, ones)
    told = replace(Parameters().gp_ekf, model="model.json", model_text=learned.to_json())
    assert gp(gp_ekf=told).note == ""
    heavy = gp(gp_ekf=told, payload=replace(Parameters().payload, mass_kg=0.9))
    assert heavy.note == "model.json is not used: trained for payload.mass_kg 0.3, configured is 0.9"
    assert heavy.note != gp().note == ""


def test_a_model_that_cannot_be_read_is_refused():
    broken = replace(Parameters().gp_ekf, model="model.json", model_text="{}")
    with pytest.raises(ConfigurationError, match=r"^model\.json: format: None given"):
        gp(gp_ekf=broken)


numbers = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, 1e300, -1e9, 1e-300])
triples = st.tuples(numbers, numbers, numbers)


@given(st.lists(st.tuples(st.sampled_from(Source), triples, triples, numbers), max_size=6), triples, numbers, numbers)
def test_any_numbers_are_answered(measurements, force, dt_s, yaw_rad):
    world = World(gp()).run(0.3)
    estimator = world.estimator
    for source, value, std, t_s in measurements:
        estimator.correct(LoadMeasurement(source, value, std, t_s))
    if math.isfinite(yaw_rad):
        estimator.turn(yaw_rad)
    world.t_s += DT_S
    estimator.stand(world.t_s, 0.0)
    estimator.step(np.array(force), np.zeros(3), dt_s)
    world.estimator.reset(ResetReason.START)
    estimate = world.run(0.1).estimator.estimate()
    assert np.isfinite(estimate.x).all()
    assert np.isfinite(estimate.P).all()
