"""The closed loop of the study: signs in words, the law against the filters' estimates, noise, criterion, records."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.slung_flight import (
    NOISE_PER_SAMPLE,
    WHITE_PER_STEP,
    Feedback,
    FlightLog,
    FlightParam,
    Law,
    fly,
    swing_angles,
)
from swingd.model.errors import StudyError
from swingd.studies.drones2023.cases import CASE_1, CASE_3, PAYLOAD_CONTROLLER
from swingd.studies.drones2023.flight import DT_S, LawSettings, Sensors, Wind, run

L = FlightLog
JIT = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="needs compiled kernels")
SAMPLE_S = DT_S * CASE_1.control_every
OFF = LawSettings()
SILENT = Sensors(0.0, 0.0, 0.0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0)
CALM = replace(
    CASE_1, name="calm", sensors=SILENT, swing_rad=(0.0, 0.0), stop_chi_rad=0.0, stop_for_s=math.inf, duration_max_s=4.0
)
"""Hover without wind, noise or end."""


def swing(cable, cable_rate):
    out = np.full(4, np.nan)
    swing_angles(out, np.array([*cable, *cable_rate], dtype=float))
    return out


@pytest.mark.parametrize("seed", range(5))
def test_angles_are_those_of_the_cable_and_rates_their_derivatives(seed):
    rng = np.random.default_rng(seed)
    xi, zeta = rng.uniform(-1.3, 1.3, 2)
    length = rng.uniform(0.5, 20.0)
    cable = length * np.array([np.sin(zeta), -np.sin(xi) * np.cos(zeta), np.cos(xi) * np.cos(zeta)])
    rate = rng.normal(size=3)
    h = 1e-6
    slope = (swing(cable + h * rate, rate) - swing(cable - h * rate, rate))[:2] / (2.0 * h)
    np.testing.assert_allclose(swing(cable, rate), [xi, zeta, *slope], rtol=1e-7, atol=1e-9)


def test_a_load_ahead_is_a_positive_zeta_and_one_on_the_left_a_positive_xi():
    assert swing((1.0, 0.0, 5.0), (0.1, 0.0, 0.0))[1] > 0.0
    assert swing((0.0, -1.0, 5.0), (0.0, -0.1, 0.0))[0] > 0.0
    assert swing((0.0, 0.0, 5.0), (1.0, 0.0, 0.0))[3] == pytest.approx(0.2)
    assert swing((0.0, 0.0, 5.0), (0.0, -1.0, 0.0))[2] == pytest.approx(0.2)


@JIT
@pytest.mark.parametrize(
    ("yaw", "north", "east", "expected"),
    [
        (0.0, 2.0, 0.0, (0, -1)),  # forward: it trails
        (0.0, 0.0, 2.0, (1, 0)),  # to the right: it stays on the left
        (math.pi / 2, 0.0, 2.0, (0, -1)),  # nose east, eastwards is forward
        (math.pi / 2, 2.0, 0.0, (-1, 0)),  # and north to the left
    ],
)
def test_the_load_stays_behind_an_acceleration(yaw, north, east, expected):
    scenario = replace(
        CALM, yaw_rad=yaw, by_velocity=True, references=((0.0, north, east, 0.0),), duration_max_s=2.5
    )  # fmt: skip
    angles = run(scenario, OFF, 0).column(L.SWING, 4)[-1, :2]
    assert np.abs(angles).max() > 0.02
    np.testing.assert_array_equal(np.sign(np.round(angles, 3)), expected)


def pendulum_energy(lateral_sign, xi, zeta, duration_s, kp=9.0, kd=2.0, length=15.0):
    """Energy of the lateral and the longitudinal swing [J/kg] in both halves of a time, below a hook that obeys (16).

    A point mass on a rod, in Cartesian coordinates: rho'' = g - a - n (n . (g - a) + |rho'|^2 / L).
    """
    gravity = np.array([0.0, 0.0, GRAVITY_MPS2])

    def rate(_t, state):
        rho, rho_rate = state[:3], state[3:]
        xi, zeta, xi_rate, zeta_rate = swing(rho, rho_rate)
        hook = np.array([kp * zeta + kd * zeta_rate, lateral_sign * (kp * xi + kd * xi_rate), 0.0])
        n = rho / np.linalg.norm(rho)
        pull = gravity - hook
        return np.concatenate([rho_rate, pull - n * (n @ pull + rho_rate @ rho_rate / length)])

    start = length * np.array([np.sin(zeta), -np.sin(xi) * np.cos(zeta), np.cos(xi) * np.cos(zeta)])
    times = np.linspace(0.0, duration_s, 400)
    y = solve_ivp(rate, (0.0, duration_s), [*start, 0, 0, 0], t_eval=times, rtol=1e-8, atol=1e-9).y
    energies = 0.5 * (y[[4, 3]] ** 2 + GRAVITY_MPS2 / length * y[[1, 0]] ** 2)
    return [(energy[:200], energy[200:]) for energy in energies]


def test_the_law_damps_both_axes_and_as_printed_it_drives_the_lateral_one():
    lateral, longitudinal = pendulum_energy(-1.0, 0.1, 0.1, 40.0)
    assert lateral[1].max() < 0.1 * lateral[0].max()
    assert longitudinal[1].max() < 0.1 * longitudinal[0].max()
    lateral, longitudinal = pendulum_energy(+1.0, 0.01, 0.01, 40.0)
    assert lateral[1].max() > 4.0 * lateral[0].max()
    assert longitudinal[1].max() < 0.1 * longitudinal[0].max()


@JIT
@pytest.mark.parametrize("yaw", [0.0, math.pi / 2])
@pytest.mark.parametrize("axis", [0, 1], ids=["lateral", "longitudinal"])
def test_the_law_takes_energy_out_of_a_small_swing(yaw, axis):
    start = (0.08, 0.0) if axis == 0 else (0.0, 0.08)
    scenario = replace(CALM, swing_rad=start, yaw_rad=yaw, duration_max_s=14.0)

    def energy(law):
        angles = run(scenario, law, 0).column(L.SWING, 4)
        omega2 = GRAVITY_MPS2 / 15.0 * 170.0 / 70.0
        return angles[:, 2 + axis] ** 2 + omega2 * angles[:, axis] ** 2

    free, damped = energy(OFF), energy(PAYLOAD_CONTROLLER)
    assert damped[-1] < 0.1 * damped[0]
    # Over the last swing, so that it does not matter where in it the flights end.
    assert damped[-1250:].mean() < 0.5 * free[-1250:].mean()


@JIT
@pytest.mark.parametrize("feedback", list(Feedback))
def test_the_law_listens_to_its_filter(feedback):
    """(16) from the logged estimates, turned by the measured heading."""
    scenario = replace(CASE_1, yaw_rad=2.0, duration_max_s=6.0)
    flight = run(scenario, replace(PAYLOAD_CONTROLLER, feedback=feedback), 3)
    xi, zeta, xi_rate, zeta_rate = flight.column(L.EKF if feedback is Feedback.EKF else L.FGDF, 4).T
    forward, right = 9.0 * zeta + 2.0 * zeta_rate, -(9.0 * xi + 2.0 * xi_rate)
    yaw = flight.column(L.EULER_MEASURED, 3)[:, 2]
    north = np.cos(yaw) * forward - np.sin(yaw) * right
    east = np.sin(yaw) * forward + np.cos(yaw) * right
    asked = flight.column(L.ACC_PC, 3)
    np.testing.assert_allclose(asked, np.column_stack([north, east, 0.0 * north]), atol=1e-12)
    assert np.abs(asked).max() > 0.5
    np.testing.assert_array_equal(run(scenario, OFF, 3).column(L.ACC_PC, 3), 0.0)


PLACED = LawSettings(
    law=Law.PLACED, kp=9.0, kd=6.0, washout_s=5.0, leak_s=2.0, acc_max_mps2=0.5, jerk_max_mps3=1.5, vel_max_mps=0.3,
    pos_max_m=0.15,
)  # fmt: skip


def bounded(vector, size):
    length = math.hypot(*vector)
    return vector * (size / length) if length > size else vector


def by_definition(estimates, law):
    """Accelerations, velocities and displacements, heading frame, that the placed law asks for."""
    slow, acc, vel, pos = np.zeros((4, 2))
    asked = []
    for xi, zeta, xi_rate, zeta_rate in estimates:
        # Load from the vehicle per length, and its derivative.
        place = np.array([math.sin(zeta), -math.sin(xi) * math.cos(zeta)])
        rate = np.array(
            [
                math.cos(zeta) * zeta_rate,
                -math.cos(xi) * math.cos(zeta) * xi_rate + math.sin(xi) * math.sin(zeta) * zeta_rate,
            ]
        )
        wanted = law.kp * place + law.kd * rate
        slow = slow + SAMPLE_S / (SAMPLE_S + law.washout_s) * (wanted - slow)
        acc = acc + bounded(bounded(wanted - slow, law.acc_max_mps2) - acc, law.jerk_max_mps3 * SAMPLE_S)
        keep = math.exp(-SAMPLE_S / law.leak_s)
        vel = bounded(keep * vel + SAMPLE_S * acc, law.vel_max_mps)
        pos = bounded(keep * pos + SAMPLE_S * vel, law.pos_max_m)
        asked.append(np.concatenate([acc, vel, pos]))
    return np.array(asked)


@JIT
def test_the_placed_law_keeps_its_limits_and_moves_the_references():
    """What it adds to velocity and position shows in what a proportional autopilot makes of them."""
    proportional = replace(CALM.autopilot, vel_i_xy=0.0, vel_d_xy=0.0)
    scenario = replace(CALM, autopilot=proportional, yaw_rad=0.8, swing_rad=(0.2, 0.3), duration_max_s=8.0)
    flight = run(scenario, PLACED, 0)
    asked = by_definition(flight.column(L.EKF, 4), PLACED)
    yaw = flight.column(L.EULER_MEASURED, 3)[:, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    for column in (0, 2, 4):
        ahead, right = asked[:, column].copy(), asked[:, column + 1].copy()
        asked[:, column], asked[:, column + 1] = c * ahead - s * right, s * ahead + c * right
    np.testing.assert_allclose(flight.column(L.ACC_PC, 2), asked[:, :2], atol=1e-12)
    acc = np.hypot(*flight.column(L.ACC_PC, 2).T)
    jerk = np.hypot(*np.diff(flight.column(L.ACC_PC, 2), axis=0).T) / SAMPLE_S
    assert acc.max() == pytest.approx(0.5)
    assert jerk.max() == pytest.approx(1.5, rel=1e-2)
    assert np.hypot(*asked[:, 2:4].T).max() == pytest.approx(0.3)
    assert np.hypot(*asked[:, 4:6].T).max() == pytest.approx(0.15)
    error = flight.column(L.REFERENCE, 2) + asked[:, 4:6] - flight.column(L.POS, 2)
    velocity_sp = proportional.pos_p_xy * error + asked[:, 2:4]
    expected = proportional.vel_p_xy * (velocity_sp - flight.column(L.VEL, 2))
    np.testing.assert_allclose(flight.column(L.ACC_VC, 2), expected, atol=1e-12)


@JIT
def test_the_same_seed_is_the_same_flight():
    scenario = replace(CASE_3, duration_max_s=5.0)
    first = run(scenario, PAYLOAD_CONTROLLER, 7)
    np.testing.assert_array_equal(first.log, run(scenario, PAYLOAD_CONTROLLER, 7).log)
    other = run(scenario, PAYLOAD_CONTROLLER, 8)
    assert np.abs(other.column(L.WIND, 3) - first.column(L.WIND, 3)).max() > 0.1
    assert np.abs(other.column(L.EKF, 4) - first.column(L.EKF, 4)).max() > 1e-3


@JIT
def test_every_law_meets_the_same_noise():
    scenario = replace(CASE_1, duration_max_s=5.0)
    noises = []
    for law in (OFF, PAYLOAD_CONTROLLER, PLACED):
        flight = run(scenario, law, 4)
        noises.append(flight.column(L.EULER_MEASURED, 3) - flight.column(L.EULER, 3))
    np.testing.assert_allclose(noises[1], noises[0], atol=1e-14)
    np.testing.assert_allclose(noises[2], noises[0], atol=1e-14)
    assert noises[0].std() == pytest.approx(math.radians(0.5), rel=0.05)


@JIT
@pytest.mark.parametrize(
    ("sensors", "gain"),
    [
        (replace(SILENT, pos_xy_m=0.1, pos_z_m=0.02), lambda a: (a.vel_p_xy * a.pos_p_xy, a.vel_p_z * a.pos_p_z)),
        (replace(SILENT, vel_xy_mps=0.1, vel_z_mps=0.02), lambda a: (a.vel_p_xy, a.vel_p_z)),
    ],
    ids=["position", "velocity"],
)
def test_noise_of_position_and_velocity_reaches_the_autopilot(sensors, gain):
    """As a proportional one asks for accelerations by it; 0.1 across and 0.02 down."""
    proportional = replace(CALM.autopilot, vel_i_xy=0.0, vel_i_z=0.0, vel_d_xy=0.0, vel_d_z=0.0)
    flight = run(replace(CALM, autopilot=proportional, sensors=sensors), OFF, 1)
    p_pos = np.array([proportional.pos_p_xy, proportional.pos_p_xy, proportional.pos_p_z])
    p_vel = np.array([proportional.vel_p_xy, proportional.vel_p_xy, proportional.vel_p_z])
    silent = p_vel * (p_pos * (np.array(CALM.start_ned_m) - flight.column(L.POS, 3)) - flight.column(L.VEL, 3))
    noise = flight.column(L.ACC_VC, 3) - silent
    across, down = gain(proportional)
    np.testing.assert_allclose(noise.std(axis=0), (0.1 * across, 0.1 * across, 0.02 * down), rtol=0.08)
    np.testing.assert_allclose(np.corrcoef(noise.T), np.eye(3), atol=0.12)


@JIT
def test_noise_and_bias_of_the_accelerometer_reach_the_filters():
    """They stand in the thrust of Remark 1, which in a level hover is |m z - (m + m_l) g|."""
    bias = np.array([0.6, -0.4, 0.2])
    sensors = replace(SILENT, acc_bias_frd_mps2=tuple(bias))
    first_n = run(replace(CALM, sensors=sensors, duration_max_s=0.1), OFF, 0).column(L.THRUST_ESTIMATED)[0]
    assert first_n == pytest.approx(np.linalg.norm(70.0 * bias - (0.0, 0.0, 160.0 * GRAVITY_MPS2)), rel=1e-9)
    noisy_n = run(replace(CALM, sensors=replace(SILENT, acc_mps2=0.1)), OFF, 0).column(L.THRUST_ESTIMATED)
    assert noisy_n.std() == pytest.approx(70.0 * 0.1, rel=0.08)


@JIT
def test_the_linear_filter_knows_nothing_of_the_ekf():
    """Other settings of the one leave the other as it was."""
    scenario = replace(CASE_3, duration_max_s=4.0)
    other = replace(scenario, filters=replace(scenario.filters, ekf_measurement_noise=3.6e-3, load_mass_kg=90.0))
    one, two = run(scenario, OFF, 3), run(other, OFF, 3)
    assert np.abs(one.column(L.EKF, 7) - two.column(L.EKF, 7)).max() > 0.1
    np.testing.assert_allclose(two.column(L.FGDF, 4), one.column(L.FGDF, 4), rtol=1e-9, atol=1e-12)


@JIT
def test_a_flight_ends_when_the_load_has_hung_still_for_its_time():
    scenario = replace(
        CALM, swing_rad=(0.05, 0.04), stop_chi_rad=0.02, stop_for_s=4.0, stop_distance_m=0.15, duration_max_s=60.0
    )
    flight = run(scenario, PAYLOAD_CONTROLLER, 0)
    assert flight.finished
    chi = flight.column(L.CHI)
    distance = np.linalg.norm(flight.column(L.POS, 3) - scenario.start_ned_m, axis=1)
    for row in range(len(chi)):
        held = round(4.0 / SAMPLE_S)
        done = row + 1 >= held and np.all(chi[row + 1 - held : row + 1] < 0.02) and distance[row] < 0.15
        assert done == (row == len(chi) - 1)
    # Its time is in the manoeuvre's.
    last_swing_s = SAMPLE_S * np.flatnonzero(chi >= 0.02)[-1]
    assert flight.duration_s >= last_swing_s + 4.0 - 1e-9


@JIT
def test_still_time_counts_from_its_beginning_only():
    scenario = replace(CALM, stop_chi_rad=0.1, stop_for_s=2.0, stop_after_s=1.0, duration_max_s=10.0)
    assert run(scenario, OFF, 0).duration_s == pytest.approx(3.0 - SAMPLE_S)
    never = run(replace(scenario, stop_distance_m=0.0), OFF, 0)
    assert not never.finished
    assert never.duration_s == pytest.approx(10.0)


@JIT
def test_waypoints_are_taken_one_after_the_other_within_the_radius():
    places = ((0.0, 0.0, 0.0, -30.0), (0.0, 3.0, 0.0, -30.0), (0.0, 3.0, 2.0, -30.0))
    autopilot = replace(CALM.autopilot, pos_p_xy=0.4)
    flight = run(
        replace(CALM, autopilot=autopilot, references=places, accept_radius_m=0.5, duration_max_s=40.0), OFF, 0
    )
    legs = flight.column(L.LEG).astype(int)
    np.testing.assert_array_equal(np.unique(legs), [1, 2])  # the first is where it stands
    taken = np.flatnonzero(np.diff(legs))
    assert len(taken) == 1
    distance = np.linalg.norm(flight.column(L.POS, 3) - places[1][1:], axis=1)
    assert np.all(distance[: taken[0] + 1] > 0.5)
    assert distance[taken[0] + 1] <= 0.5
    np.testing.assert_array_equal(flight.column(L.REFERENCE, 3), np.array(places)[legs, 1:])
    assert np.linalg.norm(flight.column(L.POS, 3)[-1] - places[2][1:]) < 0.5


@JIT
def test_the_log_agrees_with_itself():
    scenario = replace(CASE_3, yaw_rad=0.7, duration_max_s=12.0, swing_rad=(0.2, -0.1))
    flight = run(scenario, OFF, 2)
    xi, zeta, *rates = flight.column(L.SWING, 4).T
    chi = flight.column(L.CHI)
    np.testing.assert_allclose(np.diff(flight.t_s), SAMPLE_S, rtol=1e-9)
    np.testing.assert_allclose(np.cos(chi), np.cos(xi) * np.cos(zeta), atol=1e-12)
    for angle, rate in ((xi, rates[0]), (zeta, rates[1]), (chi, flight.column(L.CHI_RATE))):
        between = 0.5 * (rate[1:] + rate[:-1])
        np.testing.assert_allclose(np.diff(angle) / SAMPLE_S, between, atol=2e-3)
    power = flight.column(L.SHAFT_POWER)
    gained = flight.column(L.ENERGY)[-1]
    assert gained == pytest.approx(np.trapezoid(power, dx=SAMPLE_S), rel=1e-4)
    moved = np.diff(flight.column(L.POS, 3), axis=0) / SAMPLE_S
    np.testing.assert_allclose(moved, 0.5 * (flight.column(L.VEL, 3)[1:] + flight.column(L.VEL, 3)[:-1]), atol=1e-3)


@JIT
def test_without_errors_the_ekf_finds_the_swing_and_the_thrust():
    """Right load, no noise, a load without drag: what is left is the elastic cable and a CG above the hook."""
    vehicle = replace(CALM.vehicle, load_drag_area_m2=0.0)
    filters = replace(CALM.filters, load_mass_kg=vehicle.load_mass_kg)
    scenario = replace(CALM, vehicle=vehicle, filters=filters, swing_rad=(0.1, -0.15), duration_max_s=15.0)
    flight = run(scenario, OFF, 0)
    error = (flight.column(L.EKF, 4) - flight.column(L.SWING, 4))[2500:]
    assert np.abs(flight.column(L.SWING, 2)[2500:]).max() > math.radians(2.0)
    assert np.abs(error[:, :2]).max() < math.radians(1.0)
    thrust = flight.column(L.THRUST)
    assert np.abs(flight.column(L.THRUST_ESTIMATED) / thrust - 1.0)[1:].max() < 0.05


@JIT
def test_thrust_is_what_acceleration_weight_and_disturbance_leave():
    """(14) of the paper, with the inertial acceleration from the log's velocities and the disturbance of before."""
    vehicle = replace(CALM.vehicle, imu_frd_m=(0.0, 0.0, 0.0))
    eager = replace(
        CALM.filters,
        ekf_initial_var=(1e-6, 1e-6, 1e-6, 1e-6, 2.0, 2.0, 2.0),
        ekf_process_noise=(1e-7, 1e-7, 1e-7, 1e-7, 20.0, 20.0, 20.0),
    )
    wind = Wind(steady_ned_mps=(-6.0, 3.0, 4.0))
    scenario = replace(CALM, vehicle=vehicle, filters=eager, wind=wind, yaw_rad=0.7, swing_rad=(0.1, 0.1))
    flight = run(scenario, OFF, 0)
    north, east, down = np.gradient(flight.column(L.VEL, 3), SAMPLE_S, axis=0).T
    yaw = flight.column(L.EULER, 3)[:, 2]
    z = np.array([np.cos(yaw) * north + np.sin(yaw) * east, np.cos(yaw) * east - np.sin(yaw) * north, down])
    disturbance = flight.column(L.EKF, 7)[:, 4:].T
    assert np.abs(disturbance[2]).max() > 5.0
    hanging = np.array([[0.0], [0.0], [(70.0 + 90.0) * GRAVITY_MPS2]])
    expected = np.linalg.norm(70.0 * z[:, 1:] - hanging - disturbance[:, :-1], axis=0)
    np.testing.assert_allclose(flight.column(L.THRUST_ESTIMATED)[100:], expected[99:], atol=0.5)


def gusty(**changes):
    wind = Wind(steady_ned_mps=(-2.0, 1.0, 0.0), at_6m_mps=8.0, span_m=2.38)
    return run(replace(CALM, wind=replace(wind, **changes), duration_max_s=3.0), OFF, 5)


@JIT
def test_turbulence_blows_along_its_wind():
    """Turned by 90 deg its gusts come from there: what was north is east, what was east is south."""
    mean = np.array([-2.0, 1.0, 0.0])
    along_north, along_east = gusty(), gusty(to_rad=math.pi / 2)
    for column, steady in ((L.WIND, mean), (L.GUST_RATE, np.zeros(3))):
        gusts, turned = along_north.column(column, 3) - steady, along_east.column(column, 3) - steady
        assert gusts.std(axis=0).min() > 1e-3
        expected = gusts * (1.0, -1.0, 1.0)
        np.testing.assert_allclose(turned[:, [1, 0, 2]], expected, atol=0.02 * np.abs(gusts).max())
    np.testing.assert_array_equal(gusty(at_6m_mps=0.0).column(L.WIND, 3) - mean, 0.0)


@JIT
def test_the_airs_rotation_does_not_depend_on_the_heading():
    rates = []
    for yaw in (0.0, 2.0):
        wind = Wind(at_6m_mps=8.0, to_rad=0.5, span_m=2.38)
        rates.append(run(replace(CALM, wind=wind, yaw_rad=yaw, duration_max_s=2.0), OFF, 5).column(L.GUST_RATE, 3))
    assert rates[0].std(axis=0).min() > 1e-3
    np.testing.assert_allclose(rates[1], rates[0], atol=0.02 * np.abs(rates[0]).max())


@JIT
def test_vehicle_and_load_have_gusts_of_their_own():
    """Four noises each: the vehicle's leave the load's air alone, and the load's the vehicle's."""
    vehicle, samples = CALM.vehicle, 1000
    f = np.zeros(FlightParam.SIZE)
    for name, value in {
        "DT": DT_S,
        "CONTROL_EVERY": CALM.control_every,
        "FILTER_EVERY": CALM.control_every,
        "STOP_FOR": math.inf,
        "TURBULENCE_WIND": 10.0,
        "TURBULENCE_SPEED": 10.0,
        "SPAN": 2.38,
        "LOAD_SPAN": 1.0,
        "FILTER_MASS": 70.0,
        "FILTER_LOAD_MASS": 100.0,
        "FILTER_LENGTH": 15.0,
        "EKF_R": 3.6e-5,
        "EKF_SCHEME": -1.0,
        "FGDF_R": 2.465e-4,
        "FGDF_FADING": 0.998,
    }.items():
        f[FlightParam[name]] = value
    white = np.random.default_rng(2).standard_normal((samples * CALM.control_every, WHITE_PER_STEP))

    def log(*blown):
        rows = np.full((samples, L.SIZE), np.nan)
        heard = np.zeros_like(white)
        for half in blown:
            heard[:, half] = white[:, half]
        written = fly(
            rows,
            vehicle.hovering(CALM.start_ned_m, 0.0, 0.0, 0.0),
            vehicle.packed(),
            vehicle.rotor_table(),
            vehicle.allocation(),
            CALM.autopilot.packed(vehicle, CALM.start_ned_m[2]),
            f,
            np.array(CALM.references),
            np.zeros((samples, NOISE_PER_SAMPLE)),
            heard,
        )
        assert written == samples
        return rows

    of_vehicle, of_load = slice(0, 4), slice(4, 8)
    only_load = log(of_load)
    wind, swing = slice(L.WIND, L.WIND + 3), slice(L.SWING, L.SWING + 2)
    np.testing.assert_array_equal(only_load[:, wind], 0.0)
    assert np.abs(only_load[:, swing]).max() > 1e-4
    np.testing.assert_allclose(log(of_vehicle, of_load)[:, wind], log(of_vehicle)[:, wind], atol=0.02)
    assert np.abs(log(of_vehicle)[:, wind]).max() > 0.5


@JIT
@pytest.mark.parametrize("law", [PAYLOAD_CONTROLLER, PLACED], ids=lambda law: law.law.name.lower())
@pytest.mark.parametrize("by_velocity", [False, True])
def test_north_is_a_direction_like_any_other(law, by_velocity):
    """Heading, references, wind and its gusts turned together: the same flight, turned."""
    in_body = replace(CASE_1.sensors, pos_xy_m=0.0, pos_z_m=0.0, vel_xy_mps=0.0, vel_z_mps=0.0)

    def turned(angle):
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        places = [(0.0, 0.0, -30.0), (1.0, 0.5, -30.0)] if not by_velocity else [(2.0, 1.0, 0.0), (-1.0, 2.0, 0.2)]
        scenario = replace(
            CALM,
            sensors=in_body,
            by_velocity=by_velocity,
            references=tuple((3.0 * k, *(turn @ place)) for k, place in enumerate(places)),
            yaw_rad=0.3 + angle,
            swing_rad=(0.1, -0.2),
            wind=Wind(tuple(turn @ (-2.0, 1.0, 0.0)), at_6m_mps=8.0, to_rad=0.4 + angle, span_m=2.38),
            duration_max_s=6.0,
        )
        return run(scenario, law, 1), turn

    flight, _ = turned(0.0)
    other, turn = turned(1.1)
    for column, count in ((L.SWING, 4), (L.FORCE, 3), (L.EKF, 7), (L.FGDF, 4), (L.ENERGY, 4)):
        one, two = flight.column(column, count), other.column(column, count)
        np.testing.assert_allclose(two, one, atol=1e-6 * np.abs(one).max())
    for column in (L.POS, L.VEL, L.WIND, L.GUST_RATE, L.ACC_VC, L.ACC_PC, L.REFERENCE):
        one, two = flight.column(column, 3), other.column(column, 3)
        np.testing.assert_allclose(two, one @ turn.T, atol=1e-6 * np.abs(one).max())
    assert np.ptp(flight.column(L.LEG)) == (1 if by_velocity else 0)


@JIT
def test_a_flight_that_diverges_is_named():
    """The explicit scheme on a step far too long."""
    scenario = replace(CASE_1, filters=replace(CASE_1.filters, every=1000), duration_max_s=60.0)
    with pytest.raises(StudyError, match=r"case1, seed 3: .*diverged.*finite"):
        run(scenario, OFF, 3)
