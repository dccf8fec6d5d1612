"""The cascade: signs in words, every stage against its formula, limits; by the wrench that its rotor speeds make."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swingd.core.constants import GRAVITY_MPS2
from swingd.core.multirotor import Rotor
from swingd.core.px4_cascade import CascadeInput, CascadeParam, CascadeState, cascade_update
from swingd.studies.drones2023.vehicles import OCTAROTOR, Autopilot

SAMPLE, C, M = CascadeInput, CascadeParam, CascadeState
DT_S = 0.004
WEIGHT_N = 170.0 * GRAVITY_MPS2
GAINS = Autopilot(
    pos_p_xy=0.5,
    pos_p_z=1.0,
    vel_p_xy=1.8,
    vel_i_xy=0.4,
    vel_d_xy=0.2,
    vel_p_z=4.0,
    vel_i_z=2.0,
    vel_d_z=0.1,
    vel_d_lag_s=0.05,
    speed_xy_max_mps=6.0,
    speed_up_max_mps=3.0,
    speed_down_max_mps=1.0,
    tilt_max_rad=0.6,
    att_p_tilt=4.0,
    att_p_yaw=2.0,
    rate_max_radps=2.0,
    rate_p_tilt=9.0,
    rate_p_yaw=4.0,
    rate_i=3.0,
    rate_d_tilt=0.3,
    rate_d_lag_s=0.02,
)
ROTORS = OCTAROTOR.rotor_table()


class Cascade:
    """A cascade in flight, and the wrench that it asks its rotors for."""

    def __init__(self, **gains):
        self.c = GAINS.packed(OCTAROTOR, -30.0)
        for name, value in gains.items():
            self.c[C[name]] = value
        self.s = np.zeros(M.SIZE)
        self.omega = np.full(8, np.nan)
        self.acc = np.full(3, np.nan)

    def update(self, dt_s=DT_S, **sample):
        """Give thrust [N] and moment, frd [N m], for a sample that is zero but for what is named."""
        i = np.zeros(SAMPLE.SIZE)
        for name, value in sample.items():
            value = np.atleast_1d(value)
            i[SAMPLE[name] : SAMPLE[name] + len(value)] = value
        cascade_update(self.omega, self.acc, self.s, i, self.c, OCTAROTOR.allocation(), ROTORS, dt_s)
        thrusts = self.c[C.DENSITY_RATIO] * ROTORS[:, Rotor.THRUST] * self.omega**2
        torques = self.c[C.DENSITY_RATIO] * ROTORS[:, Rotor.TORQUE] * self.omega**2
        forces = thrusts[:, None] * np.array([0.0, 0.0, -1.0])
        moment = np.cross(ROTORS[:, :3], forces).sum(axis=0)
        moment[2] += torques @ ROTORS[:, Rotor.SPIN]
        return thrusts.sum(), moment


INERTIA = np.diag(OCTAROTOR.inertia_kg_m2)


def test_without_error_the_rotors_hover():
    cascade = Cascade()
    thrust, moment = cascade.update()
    np.testing.assert_allclose(cascade.omega, OCTAROTOR.hovering((0.0, 0.0, -30.0), 0.0, 0.0, 0.0)[-8:], rtol=1e-12)
    assert thrust == pytest.approx(WEIGHT_N)
    np.testing.assert_allclose(moment, 0.0, atol=1e-9)
    np.testing.assert_array_equal(cascade.s, 0.0)


@pytest.mark.parametrize(
    ("yaw", "error", "turn"),
    [
        (0.0, (1.0, 0.0, 0.0), (0, -1, 0)),  # north is ahead: nose down
        (0.0, (0.0, 1.0, 0.0), (1, 0, 0)),  # east is to the right: roll right
        (math.pi / 2, (1.0, 0.0, 0.0), (-1, 0, 0)),  # nose east, north is to the left: roll left
        (math.pi / 2, (0.0, 1.0, 0.0), (0, -1, 0)),
        (math.pi, (1.0, 0.0, 0.0), (0, 1, 0)),  # north is behind: nose up
    ],
)
@pytest.mark.parametrize("reference", ["POS_SP", "VEL_SP", "ACC_SP"])
def test_it_tilts_towards_where_it_shall_go(yaw, error, turn, reference):
    """Nose down is a negative pitch, right side down a positive roll."""
    _, moment = Cascade().update(EULER=(0.0, 0.0, yaw), YAW_SP=yaw, **{reference: error})
    np.testing.assert_array_equal(np.sign(np.round(moment, 6)), turn)


def test_it_turns_towards_the_wanted_heading_by_the_shorter_way():
    """Clockwise is positive."""
    for yaw, wanted, sign in ((0.0, 0.3, 1), (0.0, -0.3, -1), (3.0, -3.0, 1), (-3.0, 3.0, -1)):
        _, moment = Cascade().update(EULER=(0.0, 0.0, yaw), YAW_SP=wanted)
        np.testing.assert_array_equal(np.sign(np.round(moment, 6)), (0, 0, sign))


def test_too_low_or_sinking_takes_more_thrust():
    assert Cascade().update(POS_SP=(0.0, 0.0, -1.0))[0] > WEIGHT_N
    assert Cascade().update(POS_SP=(0.0, 0.0, 1.0))[0] < WEIGHT_N
    assert Cascade().update(VEL=(0.0, 0.0, 0.2))[0] > WEIGHT_N


def test_velocity_control_does_not_look_at_positions():
    cascade = Cascade()
    cascade.update(BY_VELOCITY=1.0, POS=(3.0, 4.0, 5.0), POS_SP=(9.0, 9.0, 9.0))
    np.testing.assert_array_equal(cascade.acc, 0.0)


def test_acceleration_of_position_and_velocity_loops():
    cascade = Cascade()
    cascade.s[M.VEL_INTEGRAL : M.VEL_INTEGRAL + 3] = (0.11, -0.07, 0.05)
    velocity = np.array([0.4, -0.3, 0.2])
    cascade.s[M.VEL_SLOW : M.VEL_SLOW + 3] = velocity
    cascade.update(
        POS=(1.0, 2.0, -3.0), POS_SP=(2.0, 1.5, -3.5), VEL=velocity, VEL_SP=(0.3, 0.1, 0.0), ACC_SP=(9.0, 0, 0)
    )
    wanted = np.array([0.5, 0.5, 1.0]) * (1.0, -0.5, -0.5) + (0.3, 0.1, 0.0)
    expected = np.array([1.8, 1.8, 4.0]) * (wanted - velocity) + (0.11, -0.07, 0.05)
    np.testing.assert_allclose(cascade.acc, expected, rtol=1e-12)


def test_wanted_speed_is_limited_as_a_vector_and_by_direction():
    cascade = Cascade()
    cascade.update(POS_SP=(300.0, 400.0, 50.0))
    np.testing.assert_allclose(cascade.acc, (1.8 * 3.6, 1.8 * 4.8, 4.0 * 1.0), rtol=1e-12)
    cascade = Cascade()
    cascade.update(POS_SP=(0.0, 0.0, -50.0))
    assert cascade.acc[2] == pytest.approx(4.0 * -3.0)


def test_the_derivative_follows_a_steady_acceleration_after_its_lag():
    cascade = Cascade(VEL_P_XY=0.0, VEL_I_XY=0.0)
    lag_s, acceleration = GAINS.vel_d_lag_s, 1.5
    for k in range(1, 101):
        t_s = k * DT_S
        cascade.update(BY_VELOCITY=1.0, VEL=(acceleration * t_s, 0.0, 0.0))
        if k == 12:
            expected = -0.2 * acceleration * (1.0 - math.exp(-t_s / lag_s))
            assert cascade.acc[0] == pytest.approx(expected, rel=0.06)
    assert cascade.acc[0] == pytest.approx(-0.2 * acceleration, rel=1e-3)


def test_thrust_holds_the_height_whatever_the_tilt():
    """Its vertical part is the weight with the vertical acceleration, its direction the acceleration's with gravity."""
    acceleration = np.array([2.0, -3.0, -1.5])
    cascade = Cascade()
    down = np.array([-2.0, 3.0, GRAVITY_MPS2])
    down /= np.linalg.norm(down)
    thrust, _ = cascade.update(ACC_SP=acceleration)
    assert thrust * down[2] == pytest.approx(WEIGHT_N * (1.0 + 1.5 / GRAVITY_MPS2))


def wanted_attitude(acceleration, yaw):
    """ned_from_frd of a body whose thrust gives the horizontal acceleration, its nose straight above the heading."""
    down = np.array([-acceleration[0], -acceleration[1], GRAVITY_MPS2])
    nose = np.cross((-math.sin(yaw), math.cos(yaw), 0.0), down)
    down, nose = down / np.linalg.norm(down), nose / np.linalg.norm(nose)
    return Rotation.from_matrix(np.column_stack([nose, np.cross(down, nose), down]))


@pytest.mark.parametrize("seed", range(10))
def test_moment_is_that_of_the_attitude_and_rate_loops(seed):
    """Rate wanted: gain times sin(angle) about the axis of the remaining rotation; moment: inertia times PI."""
    rng = np.random.default_rng(seed)
    acceleration = np.array([*rng.uniform(-2.0, 2.0, 2), 0.0])
    yaw, yaw_sp = rng.uniform(-3.0, 3.0, 2) if seed == 0 else rng.uniform(-3.0, 3.0) + np.array([0.0, 0.2])
    roll, pitch = rng.uniform(-0.3, 0.3, 2)
    rate = rng.uniform(-0.2, 0.2, 3)
    integral = rng.uniform(-0.05, 0.05, 3)
    cascade = Cascade(RATE_MAX=10.0, ROTOR_THRUST_MAX=2000.0, WEIGHT=5 * WEIGHT_N)
    cascade.s[M.RATE_SLOW : M.RATE_SLOW + 3] = rate
    cascade.s[M.RATE_INTEGRAL : M.RATE_INTEGRAL + 3] = integral
    _, moment = cascade.update(ACC_SP=acceleration, EULER=(roll, pitch, yaw), YAW_SP=yaw_sp, RATE=rate)
    measured = Rotation.from_euler("ZYX", (yaw, pitch, roll))
    remaining = (measured.inv() * wanted_attitude(acceleration, yaw_sp)).as_rotvec()
    angle = np.linalg.norm(remaining)
    rate_sp = np.array([4.0, 4.0, 2.0]) * remaining * math.sin(angle) / angle
    expected = INERTIA * (np.array([9.0, 9.0, 4.0]) * (rate_sp - rate) + integral)
    np.testing.assert_allclose(moment, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        cascade.s[M.RATE_INTEGRAL : M.RATE_INTEGRAL + 3], integral + 3.0 * (rate_sp - rate) * DT_S, rtol=1e-9
    )


def test_wanted_rates_are_limited():
    _, moment = Cascade(RATE_MAX=0.05).update(EULER=(0.3, -0.3, 0.0))
    np.testing.assert_allclose(moment[:2], INERTIA[:2] * 9.0 * (-0.05, 0.05), rtol=1e-9)


def test_a_steady_angular_acceleration_is_braked_after_its_lag_in_roll_and_pitch():
    cascade = Cascade(RATE_P_TILT=0.0, RATE_P_YAW=0.0, RATE_I=0.0)
    acceleration, steps = 0.4, 60
    for k in range(1, steps + 1):
        _, moment = cascade.update(RATE=np.full(3, acceleration * k * DT_S))
    assert steps * DT_S > 10.0 * GAINS.rate_d_lag_s
    np.testing.assert_allclose(moment, INERTIA * (-0.3 * acceleration, -0.3 * acceleration, 0.0), rtol=1e-3, atol=1e-9)


def test_a_turning_body_is_braked():
    for axis in range(3):
        rate = np.zeros(3)
        rate[axis] = 0.1
        _, moment = Cascade().update(RATE=rate)
        np.testing.assert_array_equal(np.sign(np.round(moment, 6)), -np.sign(rate))


def test_tilt_is_limited():
    """Tilted by the limit and its way already, the body needs no moment for any greater acceleration."""
    direction = np.array([math.cos(1.0), math.sin(1.0), 0.0])
    at_limit = wanted_attitude(math.tan(GAINS.tilt_max_rad) * GRAVITY_MPS2 * direction, 0.0)
    yaw, pitch, roll = at_limit.as_euler("ZYX")
    for size in (7.0, 30.0, 1000.0):
        thrust, moment = Cascade().update(ACC_SP=size * direction, EULER=(roll, pitch, yaw))
        np.testing.assert_allclose(moment, 0.0, atol=1e-6)
        assert thrust == pytest.approx(WEIGHT_N / math.cos(GAINS.tilt_max_rad))
    _, moment = Cascade().update(ACC_SP=6.0 * direction, EULER=(roll, pitch, yaw))
    assert np.linalg.norm(moment) > 1.0


def test_velocity_integrators_run_until_the_tilt_is_at_its_limit():
    cascade = Cascade()
    cascade.update(BY_VELOCITY=1.0, VEL_SP=(1.0, -0.5, 0.3))
    np.testing.assert_allclose(cascade.s[:3], np.array([0.4, 0.4, 2.0]) * (1.0, -0.5, 0.3) * DT_S)
    cascade = Cascade()
    for _ in range(100):
        cascade.update(BY_VELOCITY=1.0, VEL_SP=(6.0, 0.0, 0.3))
    np.testing.assert_array_equal(cascade.s[:2], 0.0)
    assert cascade.s[2] == pytest.approx(2.0 * 0.3 * 100 * DT_S)


def test_the_vertical_integrator_is_bounded_by_gravity():
    cascade = Cascade()
    for vel_down, bound in ((1.0, GRAVITY_MPS2), (-3.0, -GRAVITY_MPS2)):
        for _ in range(20):
            cascade.update(dt_s=1.0, BY_VELOCITY=1.0, VEL_SP=(0.0, 0.0, vel_down))
        assert cascade.s[M.VEL_INTEGRAL + 2] == bound


def test_rotor_thrusts_stay_within_their_limits():
    cascade = Cascade(RATE_P_TILT=200.0)
    cascade.update(EULER=(0.5, -0.5, 0.0))
    thrusts = cascade.c[C.DENSITY_RATIO] * ROTORS[:, Rotor.THRUST] * cascade.omega**2
    assert thrusts.max() == pytest.approx(OCTAROTOR.rotor_thrust_max_n)
    assert thrusts.min() == 0.0


def test_it_never_lets_the_rotors_go():
    """However much it shall sink: a tenth of the weight."""
    thrust, _ = Cascade().update(ACC_SP=(0.0, 0.0, 30.0))
    assert thrust == pytest.approx(0.1 * WEIGHT_N)
