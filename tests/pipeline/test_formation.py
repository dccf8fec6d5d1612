"""Several vehicles and one load: clocks, frames, pose, motion, health; in virtual time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swingd.core.cooperative_flight import LoadLog
from swingd.estimation.cooperative_pose import CooperativePose, KnownAngles
from swingd.link import load_message
from swingd.model.actions import Health
from swingd.model.events import Attitude, AutopilotRestart, LocalPosition
from swingd.model.formation import (
    CableForce,
    CableSwing,
    ClockAnswer,
    DirectionSource,
    FormationParameters,
    LocalOrigin,
    RiggedTether,
    RiggedVehicle,
    SharedLoad,
    WinchTurned,
)
from swingd.pipeline.formation import Formation
from swingd.pipeline.formation.clock import ClockOffset
from swingd.pipeline.formation.geometry import cable_of, offset_ned_m, rotation_of
from swingd.pipeline.formation.sights import look, motion_of
from swingd.pipeline.formation.stream import SampleStream
from swingd.pipeline.formation.vehicle import VehicleInstant
from swingd.studies.cooperative import vehicles as v
from swingd.studies.cooperative.cases import EXPERIMENT, POSITION
from swingd.studies.cooperative.flight import SAMPLE_S, rotations, run

from .formation_flight import (
    HOST_S,
    ORIGINS_NED_M,
    Telling,
    fly_through,
    observed_forces,
    pendulum_swings,
    rig,
    swing_of,
    truth_at,
)

NOWHERE = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def flight():
    return run(EXPERIMENT, 6)


@pytest.fixture(scope="module")
def flown(flight):
    return fly_through(flight, rig(flight))


def errors(flight, reports):
    """Errors of position, attitude and velocity (n, 9), and the normalised squares (n, 2)."""
    rows, squares = [], []
    for report in reports:
        motion = report.motion
        pos, euler, vel = truth_at(flight, report)
        pose = np.array(
            [*(motion.pos_ned_m - pos), *(np.array([motion.roll_rad, motion.pitch_rad, motion.yaw_rad]) - euler)]
        )
        speed = motion.vel_ned_mps - vel
        rows.append([*pose, *speed])
        squares.append(
            [
                pose @ np.linalg.solve(motion.pose_cov, pose),
                speed @ np.linalg.solve(motion.motion_cov[:3, :3], speed),
            ]
        )
    return np.array(rows), np.array(squares)


# ---- a whole flight


def test_two_vehicles_with_clocks_and_frames_of_their_own_give_the_load_s_pose(flight, flown):
    reports = [report for report in flown.reports if report.t_mono_s > HOST_S + 1.0]
    assert {report.health for report in reports} == {Health.READY}
    found, squares = errors(flight, reports)
    rms = np.sqrt(np.mean(found**2, axis=0))
    assert (rms[:3] < 0.012).all()
    assert (np.degrees(rms[3:6]) < (2.0, 1.2, 2.5)).all()
    assert (rms[6:] < 0.06).all()
    # Errors that last, such as the direction's, are told as large as they may be; none is told as smaller than it is.
    assert 1.0 < squares[:, 0].mean() < 6.6
    assert 0.5 < squares[:, 1].mean() < 3.3


def test_the_force_on_the_vehicles_tells_the_direction_as_well(flight):
    flown = fly_through(flight, rig(flight, DirectionSource.FORCE), until_s=25.0)
    reports = [report for report in flown.reports if report.t_mono_s > HOST_S + 1.0]
    assert {report.health for report in reports} == {Health.READY}
    found, squares = errors(flight, reports)
    rms = np.sqrt(np.mean(found**2, axis=0))
    assert (rms[:3] < 0.018).all()
    assert (np.degrees(rms[3:6]) < (2.5, 1.2, 2.5)).all()
    assert 1.0 < squares[:, 0].mean() < 7.5


def of_uncertain_direction(parameters: FormationParameters) -> FormationParameters:
    vehicles = tuple(replace(vehicle, direction_std_rad=0.03) for vehicle in parameters.vehicles)
    return replace(parameters, vehicles=vehicles)


def test_what_each_vehicle_s_own_swingd_finds_of_the_force_is_enough(flight):
    parameters = of_uncertain_direction(rig(flight, DirectionSource.FORCE))
    quiet = Telling(force_n=0.0), Telling(boot_s=7e4, force_n=0.0)
    flown = fly_through(flight, parameters, quiet, forces=observed_forces(flight, 6, 0.5))
    reports = [report for report in flown.reports if report.t_mono_s > HOST_S + 3.0]
    assert {report.health for report in reports} == {Health.READY}
    rms = np.sqrt(np.mean(errors(flight, reports)[0] ** 2, axis=0))
    assert (rms[:3] < (0.03, 0.03, 0.01)).all()
    assert (np.degrees(rms[3:6]) < (3.5, 1.2, 2.5)).all()


def test_pendulum_filters_are_wrong_where_the_load_is_held_aside_and_that_is_noticed(flight):
    parameters = of_uncertain_direction(rig(flight))
    swings = pendulum_swings(flight, 6)
    aside = [np.degrees(np.sqrt(np.mean((s - swing_of(flight, k))[300:, 0] ** 2))) for k, s in enumerate(swings)]
    assert min(aside) > 10.0
    exact = Telling(swing_rad=0.0, swing_rate_radps=0.0), Telling(boot_s=7e4, swing_rad=0.0, swing_rate_radps=0.0)
    flown = fly_through(flight, parameters, exact, swings=swings, until_s=15.0)
    reports = flown.reports
    assert not any(report.health is Health.READY for report in reports)
    assert any("contradict" in report.reason for report in reports)


def test_the_pose_comes_at_its_rate_and_of_instants_that_only_advance(flown):
    instants = np.array([report.motion.t_mono_s for report in flown.reports if report.motion is not None])
    assert (np.diff(instants) > 0.0).all()
    delays = [r.t_mono_s - r.motion.t_mono_s for r in flown.reports if r.motion is not None]
    assert max(delays) < 0.15
    assert len(instants) > 1950


def test_the_load_s_rates_are_as_well_known_as_is_told(flight, flown):
    turned = rotations(flight.load(LoadLog.EULER))
    small = np.einsum("nji,njk->nik", turned[:-1], turned[1:])
    rates = np.column_stack([small[:, 2, 1], small[:, 0, 2], small[:, 1, 0]]) / SAMPLE_S
    reports = [r for r in flown.reports if r.motion is not None and r.t_mono_s > HOST_S + 1.0]
    instants = np.array([r.motion.t_mono_s - HOST_S for r in reports])
    truth = np.column_stack([np.interp(instants, flight.t_s[:-1] + 0.5 * SAMPLE_S, rates[:, k]) for k in range(3)])
    found = np.array([r.motion.rate_frd_radps for r in reports])
    told = np.array([np.sqrt(np.diag(r.motion.motion_cov)[3:]) for r in reports])
    normalised = np.mean(((found - truth) / told) ** 2, axis=0)
    assert (normalised < 1.2).all()
    # The yaw's rate comes from speeds that are known to 2 cm/s, 0.4 m apart.
    for axis, least in enumerate((0.9, 0.9, 0.6)):
        assert np.corrcoef(found[:, axis], truth[:, axis])[0, 1] > least, axis


def test_answers_to_timesync_tell_apart_what_delays_hide(flight):
    """One vehicle's frames take 150 ms longer: without answers it seems to be where it was."""
    moving = run(POSITION, 6)
    tellings = (Telling(delay_s=0.002), Telling(boot_s=5e4, delay_s=0.15))
    yaw_rms = []
    for answers in (True, False):
        flown = fly_through(moving, rig(moving), tellings, answers=answers, until_s=12.0)
        reports = [r for r in flown.reports if r.motion is not None and r.t_mono_s > HOST_S + 2.0]
        yaw_rms.append(np.sqrt(np.mean(errors(moving, reports)[0][:, 5] ** 2)))
    assert yaw_rms[0] < 0.6 * yaw_rms[1]


def test_a_silent_vehicle_degrades_then_faults_and_nothing_is_published_as_good(flight):
    flown = fly_through(flight, rig(flight), silent=(1, 5.0, 9.0), until_s=12.0)
    for report in flown.reports:
        t_s = report.t_mono_s - HOST_S
        if 1.0 < t_s < 5.0 or t_s > 10.0:
            assert report.health is Health.READY
        if 5.4 < t_s < 5.9:
            assert report.health is Health.DEGRADED
            assert report.reason.startswith("system 2: ")
            assert report.reason.endswith(" late")
            assert 0.2 < report.vehicles[1].age_s < 1.0
        if 6.2 < t_s < 9.0:
            assert report.health is Health.FAULT
            assert "system 2: lost" in report.reason
            assert report.motion is None
            assert report.vehicles[1].age_s > 1.0
            assert not report.vehicles[1].used
        message = load_message.odometry(report)
        assert (message is not None and message.quality == 100) == (report.health is Health.READY)
        if report.health is Health.FAULT:
            assert message is None
    stds = {round(r.t_mono_s - HOST_S, 2): r.motion and math.sqrt(r.motion.pose_cov[0, 0]) for r in flown.reports}
    assert stds[5.8] > 3.0 * stds[4.5]
    assert flown.reports[-1].resets == 1


def test_a_vehicle_that_reboots_comes_back_on_its_new_clock(flight):
    flown = fly_through(flight, rig(flight), reboot=(0, 5.0), until_s=14.0)
    assert flown.formation.tracks[0].restarts == 1
    healths = [r.health for r in flown.reports if 6.2 < r.t_mono_s - HOST_S < 9.5]
    assert set(healths) == {Health.FAULT}
    late = [r for r in flown.reports if r.t_mono_s > HOST_S + 11.5]
    assert {r.health for r in late} == {Health.READY}
    rms = np.sqrt(np.mean(errors(flight, late)[0] ** 2, axis=0))
    assert (rms[:3] < 0.015).all()


def test_configured_origins_do_as_well_as_global_ones_and_wrong_ones_are_noticed(flight):
    given_ = rig(flight)
    for shift_m, health in ((0.0, Health.READY), (0.2, Health.DEGRADED)):
        vehicles = tuple(
            replace(one, origin_ned_m=(origin[0], origin[1] + shift_m * k, origin[2]))
            for k, (one, origin) in enumerate(zip(given_.vehicles, ORIGINS_NED_M, strict=True))
        )
        flown = fly_through(flight, replace(given_, vehicles=vehicles), until_s=4.0)
        assert flown.reports[-1].health is health
        assert ("contradict" in flown.reports[-1].reason) == (health is Health.DEGRADED)
        assert flown.reports[-1].origin is None


# ---- vehicles that stand still


HOOKS = ((2.0, 0.0, -2.0), (-1.0, 1.8, -2.0), (-1.0, -1.8, -2.0))
ANCHORS = ((0.5, 0.0, 0.0), (-0.3, 0.4, 0.0), (-0.3, -0.4, 0.0))


def standing(**changes) -> FormationParameters:
    vehicles = tuple(
        RiggedVehicle(
            system_id=k + 1,
            link="udpin://:14600",
            tethers=(RiggedTether(float(np.linalg.norm(np.subtract(anchor, hook))), anchor),),
            origin_ned_m=NOWHERE,
        )
        for k, (hook, anchor) in enumerate(zip(HOOKS, ANCHORS, strict=True))
    )
    return replace(FormationParameters(vehicles), **changes)


def tell(formation: Formation, k: int, t_s: float, boot_s: float = 0.0, health: Health = Health.READY) -> None:
    line = np.subtract(ANCHORS[k], HOOKS[k]) / np.linalg.norm(np.subtract(ANCHORS[k], HOOKS[k]))
    xi, zeta = math.atan2(-line[1], line[2]), math.asin(line[0])
    stamp_s = t_s + boot_s
    formation.take(k, Attitude(t_s, stamp_s, 0.0, 0.0, 0.0))
    formation.take(k, LocalPosition(t_s, stamp_s, HOOKS[k], NOWHERE))
    formation.take(k, CableSwing(t_s, stamp_s, xi, zeta, 0.0, 0.0, 0.01, 0.01, health))


def stand(formation: Formation, seconds: float, who=(0, 1, 2), begin_s: float = 0.0, health=Health.READY):
    reports = []
    for step in range(round(seconds * 50)):
        t_s = begin_s + step * 0.02
        for k in who:
            tell(formation, k, t_s, 10.0 * k, health)
        reports.append(formation.step(t_s))
    return reports


def test_three_vehicles_with_a_tether_each_give_the_whole_pose():
    report = stand(Formation(standing()), 2.0)[-1]
    assert report.health is Health.READY
    assert report.motion.pos_ned_m == pytest.approx(NOWHERE, abs=1e-6)
    assert report.motion.ned_from_frd == pytest.approx(np.eye(3), abs=1e-6)
    assert report.motion.vel_ned_mps == pytest.approx(NOWHERE, abs=1e-9)
    assert report.motion.rate_frd_radps == pytest.approx(NOWHERE, abs=1e-9)


def test_the_others_go_on_without_a_third_as_far_as_they_tell_the_pose():
    held = SharedLoad(roll_std_rad=0.05, pitch_std_rad=0.05)
    for load, health in ((held, Health.DEGRADED), (SharedLoad(), Health.FAULT)):
        formation = Formation(standing(load=load))
        before = stand(formation, 2.0)[-1]
        after = stand(formation, 3.0, (0, 1), begin_s=2.0)[-1]
        assert before.health is Health.READY
        assert after.health is health
        if health is Health.DEGRADED:
            assert after.reason == "system 3: lost"
            assert after.motion.pos_ned_m == pytest.approx(NOWHERE, abs=1e-6)
            assert after.motion.pose_cov[0, 0] > before.motion.pose_cov[0, 0]
        else:
            assert after.motion is None
            assert after.reason == "tethers and known angles do not tell the whole pose"


def test_an_estimate_that_its_swingd_does_not_trust_is_not_used():
    formation = Formation(standing())
    stand(formation, 2.0)
    assert stand(formation, 1.0, begin_s=2.0, health=Health.DEGRADED)[-1].reason.startswith("system 1: its swingd is")
    assert stand(formation, 2.0, begin_s=3.0, health=Health.FAULT)[-1].health is Health.FAULT
    assert formation.refusals()[1]["swing_not_good"] == 100
    formation = Formation(standing())
    reason = stand(formation, 0.1, health=Health.INIT)[-1].reason
    assert "system 1: no good SWING (its swingd: init) heard" in reason


@pytest.mark.parametrize(
    ("force_ned_n", "why"),
    [
        ((0.0, 0.0, -19.0), "the cable is not taut"),  # the ground carries the vehicle
        ((0.01, 0.0, 0.02), "the cable is not taut"),
        ((3.0, 0.0, 0.1), "the cable is not taut"),
        ((0.3, 0.0, 0.5), "it is not known well enough"),
    ],
)
def test_a_force_that_no_taut_cable_has_is_not_used(force_ned_n, why):
    parameters = standing()
    vehicles = tuple(replace(one, direction=DirectionSource.FORCE) for one in parameters.vehicles)
    formation = Formation(replace(parameters, vehicles=vehicles))
    formation.take(0, Attitude(0.0, 0.0, 0.0, 0.0, 0.0))
    formation.take(0, CableForce(0.0, 0.0, force_ned_n, (0.4, 0.4, 0.4)))
    report = formation.step(0.1)
    assert f"good force in SWING ({why})" in report.reason
    assert formation.refusals()[1] == {"swing_not_good": 1}


def test_nothing_is_told_before_every_origin_is_known():
    parameters = standing()
    vehicles = tuple(replace(vehicle, origin_ned_m=None) for vehicle in parameters.vehicles)
    formation = Formation(replace(parameters, vehicles=vehicles))
    report = stand(formation, 2.0)[-1]
    assert report.health is Health.INIT
    assert "system 2: no GPS_GLOBAL_ORIGIN heard" in report.reason
    assert report.motion is None
    lat_rad, lon_rad = math.radians(47.0), math.radians(8.0)
    for k in range(3):
        formation.take(k, LocalOrigin(2.0, lat_rad, lon_rad, 400.0, 6.371e6))
    report = stand(formation, 2.0, begin_s=2.0)[-1]
    assert report.health is Health.READY
    assert report.origin.lat_rad == lat_rad
    formation.take(2, LocalOrigin(4.0, lat_rad + 1e-3, lon_rad, 400.0, 6.371e6))
    report = stand(formation, 2.0, begin_s=4.0)[-1]
    assert report.health is Health.FAULT
    assert "origin is over 2000 m" in report.reason


finite = st.floats(-1e9, 1e9)
anything = st.floats(allow_nan=True, allow_infinity=True)
vec = st.tuples(anything, anything, anything)
told = st.one_of(
    st.builds(Attitude, finite, anything, anything, anything, anything),
    st.builds(LocalPosition, finite, anything, vec, vec),
    st.builds(CableSwing, finite, *[anything] * 7, st.sampled_from(Health)),
    st.builds(CableForce, finite, anything, vec, vec),
    st.builds(WinchTurned, finite, anything, anything),
    st.builds(LocalOrigin, finite, *[anything] * 3, anything),
    st.builds(ClockAnswer, finite, anything, anything),
    st.builds(AutopilotRestart, finite, anything),
)


@given(st.lists(st.tuples(st.integers(0, 2), told), max_size=30))
def test_whatever_vehicles_tell_nothing_raises_and_no_pose_is_without_numbers(events):
    parameters = standing()
    by_force = replace(parameters.vehicles[2], direction=DirectionSource.FORCE)
    formation = Formation(replace(parameters, vehicles=(*parameters.vehicles[:2], by_force)))
    formation.take(2, Attitude(0.0, 20.0, 0.0, 0.0, 0.0))
    formation.take(2, CableForce(0.0, 20.0, (0.1, 0.2, 5.0), (0.1, 0.1, 0.1)))
    stand(formation, 0.2)
    for k, event in events:
        formation.take(k, event)
        report = formation.step(0.3)
        if report.motion is not None:
            assert np.isfinite(report.motion.pos_ned_m).all()
            assert np.isfinite(report.motion.pose_cov).all()
        load_message.load_pose(report)
        load_message.odometry(report)


# ---- parts


def test_the_motion_of_a_formation_that_turns_as_one_body_is_that_body_s():
    """Hooks, cables and load turn and move together: then the rates are known without the load."""
    rng = np.random.default_rng(3)
    attitude = rotation_of(np.array([0.1, -0.2, 0.7]))
    place, vel, rate = rng.uniform(-5.0, 5.0, 3), rng.uniform(-2.0, 2.0, 3), np.array([0.3, -0.5, 0.8])
    sightings = []
    for vehicle, hook, anchor in zip(standing().vehicles, HOOKS, ANCHORS, strict=True):
        arm = attitude @ np.array(hook)
        direction = attitude @ (np.subtract(anchor, hook) / vehicle.tethers[0].length_m)
        instant = VehicleInstant(
            hook_ned_m=place + arm,
            hook_vel_ned_mps=vel + np.cross(rate, arm),
            pos_var_m2=1e-4,
            vel_var_m2ps2=1e-4,
            direction_ned=direction,
            direction_rate_ned=np.cross(rate, direction),
            direction_cov=1e-4 * (np.eye(3) - np.outer(direction, direction)),
            rate_var_radps2=1e-4,
            yaw_rad=0.7,
            winch=0.0,
            winch_rate=0.0,
        )
        sightings.append(look(vehicle, instant, NOWHERE))
    solver = CooperativePose()
    solver.reset(0.7)
    _, pose = solver.solve([sight for one in sightings for sight in one.sights], KnownAngles())
    assert pose.pos_ned_m == pytest.approx(place, abs=1e-6)
    assert pose.ned_from_frd == pytest.approx(attitude, abs=1e-6)
    found_vel, found_rate, _ = motion_of(pose, sightings, math.inf, math.inf)
    assert found_vel == pytest.approx(vel, abs=1e-6)
    assert found_rate == pytest.approx(attitude.T @ rate, abs=1e-6)


def test_the_force_of_two_tethers_points_where_the_study_says(flight):
    parameters = rig(flight)
    for winch_m in (-0.05, 0.0, 0.07):
        for c in range(2):
            lean_rad = flight.scenario.lean_rad
            direction = np.array([0.0, v.SIDES[c] * math.sin(lean_rad), math.cos(lean_rad)])
            instant = VehicleInstant(
                np.zeros(3), np.zeros(3), 0.0, 0.0, direction, np.zeros(3), np.zeros((3, 3)), 0.0, 0.0, winch_m, 0.0
            )
            anchor = look(parameters.vehicles[c], instant, NOWHERE).sights[0].anchor_frd_m
            shape = v.triangle(v.TETHER_M - winch_m, v.TETHER_M + winch_m)
            expected = (shape.under(lean_rad), v.SIDES[c] * v.HALF_SPAN_M, -v.ANCHOR_UP_M)
            assert anchor == pytest.approx(expected, abs=1e-9)


def test_the_cable_s_direction_in_words():
    ahead, _ = cable_of(np.array([0.0, 0.2]))
    left, _ = cable_of(np.array([0.2, 0.0]))
    assert ahead[0] > 0.0
    assert left[1] < 0.0
    assert ahead[2] > 0.0


def test_the_derivative_of_the_cable_s_direction():
    at = np.array([0.3, -0.4])
    _, across = cable_of(at)
    for k in range(2):
        step = np.zeros(2)
        step[k] = 1e-6
        slope = (cable_of(at + step)[0] - cable_of(at - step)[0]) / 2e-6
        assert across[:, k] == pytest.approx(slope, abs=1e-9)


def test_a_clock_is_told_by_the_quickest_delivery_and_better_by_an_answer():
    rng = np.random.default_rng(1)
    clock = ClockOffset()
    assert clock.offset(0.0) is None
    for t_s in np.arange(0.0, 5.0, 0.02):
        clock.arrived(t_s + 0.05 + rng.exponential(0.02), t_s - 700.0)
    offset_s, _ = clock.offset(5.0)
    assert offset_s == pytest.approx(700.05, abs=2e-3)
    assert clock.answered(5.2, 5.1, 5.15 - 700.0)
    offset_s, better_s = clock.offset(5.2)
    assert offset_s == pytest.approx(700.0, abs=1e-9)
    assert better_s == pytest.approx(0.1 / math.sqrt(12.0), rel=1e-3)
    assert not clock.answered(5.3, 5.2, 5.25 - 600.0)  # another clock
    assert not clock.answered(5.3, 5.4, 5.25 - 700.0)  # before it was asked
    assert not clock.answered(9.3, 5.2, 5.25 - 700.0)
    # What was measured long ago counts no more, but is better than nothing.
    clock.arrived(60.0, 60.0 - 700.2)
    assert clock.offset(60.0)[0] == pytest.approx(700.2)
    assert clock.offset(500.0)[0] == pytest.approx(700.2)


def test_a_stamp_ahead_does_not_outweigh_an_answer():
    clock = ClockOffset()
    clock.arrived(1.0, 1.0 - 700.0)
    clock.arrived(1.1, 1.1 - 699.8)
    assert clock.offset(1.1)[0] == pytest.approx(699.8)
    assert clock.answered(1.2, 1.18, 1.19 - 700.0)
    assert clock.offset(1.2)[0] == pytest.approx(700.0)


def test_a_winch_with_a_clock_of_its_own_spoils_nothing():
    parameters = standing()
    winched = replace(parameters.vehicles[0], winch="WINCH")
    formation = Formation(replace(parameters, vehicles=(winched, *parameters.vehicles[1:])))
    formation.take(0, WinchTurned(0.0, 0.0, 0.1))
    tell(formation, 0, 0.0, boot_s=500.0)
    formation.take(0, WinchTurned(0.1, 3.0, 0.1))
    tell(formation, 0, 0.2, boot_s=500.0)
    assert formation.refusals()[1] == {"no_clock": 1, "late": 1}
    assert "system 1: no winch WINCH heard" in formation.step(0.2).reason


def test_samples_are_interpolated_by_value_and_rate_and_carried_on():
    def cubic(t):
        return np.array([1.0 + 2.0 * t - 3.0 * t**2 + 0.5 * t**3])

    def rate(t):
        return np.array([2.0 - 6.0 * t + 1.5 * t**2])

    stream = SampleStream()
    assert stream.at(0.0) is None
    for t_s in (0.0, 0.5, 0.8):
        assert stream.add(t_s, cubic(t_s), rate(t_s))
    assert not stream.add(0.8, cubic(0.8), rate(0.8))
    assert stream.at(-0.1) is None
    for t_s in (0.0, 0.2, 0.5, 0.7, 0.8):
        assert stream.at(t_s).value == pytest.approx(cubic(t_s), abs=1e-12)
    ahead = stream.at(1.0)
    assert ahead.value == pytest.approx(cubic(0.8) + 0.2 * rate(0.8))
    assert ahead.carried_s == pytest.approx(0.2)


def test_where_an_origin_lies_on_the_autopilot_s_sphere():
    def at(north_deg, east_deg, alt_m):
        return LocalOrigin(0.0, math.radians(47.0 + north_deg), math.radians(8.0 + east_deg), alt_m, 6.371e6)

    degree_m = math.radians(1.0) * 6.371e6
    assert offset_ned_m(at(0, 0, 400), at(0, 0, 400)) == NOWHERE
    north, east, down = offset_ned_m(at(1e-3, 0, 410), at(0, 0, 400))
    assert (north, east, down) == pytest.approx((1e-3 * degree_m, 0.0, -10.0), abs=1e-6)
    north, east, down = offset_ned_m(at(0, 1e-3, 400), at(0, 0, 400))
    assert (north, east) == pytest.approx((0.0, 1e-3 * degree_m * math.cos(math.radians(47.0))), abs=1e-3)
