"""The truth model against physics."""

from collections.abc import Callable
from dataclasses import replace
from math import cos, degrees, pi, radians, sin, sqrt

import numpy as np
import pytest

from swingd.core.slung_plant import (
    GRAVITY,
    PlantInput,
    PlantOutput,
    PlantParam,
    PlantState,
    slung_plant_derivative,
    slung_plant_step,
)
from swingd.model.errors import ConfigurationError
from swingd.model.parameters import Parameters
from swingd.sim.plant import DT_S, KICK_MAX_MPS, LEG_M, WINCH_MPS, WINCH_MPS2, Plant, rotation_matrix

from .rigs import iris, steps, with_vehicle

STOPPED = (0.0, 0.0, 0.0, 0.0)


def frictionless(parameters: Parameters, **simulation: float) -> Parameters:
    quiet = replace(
        parameters.simulation, **{"cable_damping_n_s_per_m": 0.0, "payload_drag_area_m2": 0.0, **simulation}
    )
    return replace(with_vehicle(parameters, drag_n_per_mps=0.0, drag_vertical_n_per_mps=0.0), simulation=quiet)


def hover_throttle(parameters: Parameters) -> float:
    thrust = parameters.thrust
    weight = (parameters.vehicle.mass_kg + parameters.payload.mass_kg) * GRAVITY
    a, b, c = thrust.quadratic_n, thrust.linear_n, thrust.offset_n - weight
    return (-b + sqrt(b * b - 4.0 * a * c)) / (2.0 * a)


def energy_j(plant: Plant, parameters: Parameters) -> float:
    """Kinetic, potential and elastic energy of both bodies, hook at the CG, no rotation."""
    x, simulation = plant.state, parameters.simulation
    m, ml = parameters.vehicle.mass_kg, parameters.payload.mass_kg
    pos, vel = np.array(x[0:3]), np.array(x[3:6])
    load, load_vel = np.array(x[17:20]), np.array(x[20:23])
    stretch = max(0.0, float(np.linalg.norm(load - pos)) - plant.cable_length_m)
    return float(
        0.5 * m * vel @ vel
        + 0.5 * ml * load_vel @ load_vel
        - GRAVITY * (m * pos[2] + ml * load[2])
        + 0.5 * simulation.cable_stiffness_n_per_m * stretch**2
    )


@pytest.mark.parametrize("kick", [(2.0, 0.0, 0.0), (0.0, 3.0, -1.0), (0.0, 0.0, -4.0)])
def test_energy_is_conserved_without_drag_and_damping(kick: tuple[float, float, float]) -> None:
    """A thrown dumbbell: taut, slack and snapping again."""
    parameters = frictionless(iris(load_kg=0.5))
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -200.0), zeta_rad=0.3)
    plant.kick(kick)
    before = energy_j(plant, parameters)
    kinetic = 0.5 * 0.5 * sum(k * k for k in kick)
    tensions = []
    for _ in range(steps(3.0)):
        plant.step(STOPPED, 16.2, spinning=False)
        tensions.append(plant.output[PlantOutput.TENSION])
    assert energy_j(plant, parameters) == pytest.approx(before, abs=2e-3 * kinetic)
    if kick[2] < 0.0:
        assert min(tensions) == 0.0
        assert max(tensions) > 5.0


def test_drag_and_cable_damping_only_take_energy() -> None:
    parameters = iris(load_kg=0.5)
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -200.0), zeta_rad=0.5)
    plant.kick((0.0, 2.0, -3.0))
    energies = []
    for _ in range(steps(3.0)):
        energies.append(energy_j(plant, parameters))
        plant.step(STOPPED, 16.2, spinning=False)
    assert max(np.diff(energies)) < 1e-9
    assert energies[-1] < energies[0] - 0.1


@pytest.mark.parametrize(("mass_kg", "load_kg", "length_m"), [(1.5, 0.3, 1.5), (2.0, 1.0, 3.0), (30.0, 0.3, 5.0)])
@pytest.mark.parametrize("axis", ["xi_rad", "zeta_rad"])
def test_swing_period_is_that_of_a_free_vehicle(mass_kg: float, load_kg: float, length_m: float, axis: str) -> None:
    """omega^2 = (g / L) (m + m_l) / m under constant thrust."""
    parameters = frictionless(iris(load_kg=load_kg, length_m=length_m))
    curve = replace(parameters.thrust, quadratic_n=parameters.thrust.quadratic_n * (mass_kg + load_kg))
    parameters = replace(with_vehicle(parameters, mass_kg=mass_kg), thrust=curve)
    throttle = hover_throttle(parameters)
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -50.0), rotors=throttle, **{axis: radians(2.0)})
    times, angles = [], []
    for _ in range(steps(10.0)):
        plant.step((throttle,) * 4, parameters.thrust.voltage_nominal_v, spinning=True)
        truth = plant.truth()
        times.append(truth.t_boot_s)
        angles.append(getattr(truth, axis))
    crossings = [
        times[i] - angles[i] * DT_S / (angles[i] - angles[i - 1])
        for i in range(1, len(angles))
        if angles[i] < 0.0 <= angles[i - 1]
    ]
    length = length_m + load_kg * GRAVITY / parameters.simulation.cable_stiffness_n_per_m
    expected = 2.0 * pi * sqrt(length / GRAVITY * mass_kg / (mass_kg + load_kg))
    assert len(crossings) >= 2
    assert np.diff(crossings).mean() == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, -135.0])
@pytest.mark.parametrize(("xi_deg", "zeta_deg"), [(10.0, 0.0), (-10.0, 0.0), (0.0, 20.0), (15.0, -25.0)])
def test_swing_angles_say_where_the_load_is(yaw_deg: float, xi_deg: float, zeta_deg: float) -> None:
    """zeta > 0: the load is ahead of the vehicle; xi > 0: it is to the left."""
    plant = Plant(iris())
    yaw = radians(yaw_deg)
    plant.place((3.0, -2.0, -20.0), yaw_rad=yaw, xi_rad=radians(xi_deg), zeta_rad=radians(zeta_deg))
    truth = plant.truth()
    assert degrees(truth.xi_rad) == pytest.approx(xi_deg, abs=1e-9)
    assert degrees(truth.zeta_rad) == pytest.approx(zeta_deg, abs=1e-9)
    assert cos(truth.chi_rad) == pytest.approx(cos(radians(xi_deg)) * cos(radians(zeta_deg)))
    north, east = (truth.load_pos_ned_m[i] - truth.pos_ned_m[i] for i in range(2))
    ahead = cos(yaw) * north + sin(yaw) * east
    left = sin(yaw) * north - cos(yaw) * east
    assert np.sign(round(ahead, 6)) == np.sign(zeta_deg)
    assert np.sign(round(left, 6)) == np.sign(xi_deg)


@pytest.mark.parametrize("yaw_rate", [0.0, 1.0, -2.0])
def test_rates_are_derivatives_of_the_heading_frame_angles(yaw_rate: float) -> None:
    parameters = iris()
    plant = Plant(with_vehicle(parameters, hook_frd_m=(0.05, -0.03, 0.1)))
    throttle = hover_throttle(parameters)
    plant.place((0.0, 0.0, -100.0), yaw_rad=0.4, xi_rad=0.2, zeta_rad=-0.3, rotors=throttle)
    plant.kick((0.5, 1.0, 0.0))
    plant._x[PlantState.RATE + 2] = yaw_rate
    rows = []
    for _ in range(steps(0.6)):
        plant.step((throttle,) * 4, 16.2, spinning=True)
        rows.append(plant.truth())
    for before, here, after in zip(rows, rows[1:], rows[2:], strict=False):
        for angle, rate in (("xi_rad", "xi_rate_radps"), ("zeta_rad", "zeta_rate_radps")):
            difference = (getattr(after, angle) - getattr(before, angle)) / (2.0 * DT_S)
            assert getattr(here, rate) == pytest.approx(difference, abs=2e-3)


def test_a_vehicle_and_load_in_free_fall_feel_nothing() -> None:
    plant = Plant(frictionless(iris()))
    plant.place((0.0, 0.0, -500.0))
    for _ in range(steps(0.5)):
        plant.step(STOPPED, 16.2, spinning=False)
    truth = plant.truth()
    # Together they fall with g; the stretch that the load's weight had left oscillates about their common motion.
    m, ml = 1.5, 0.3
    assert (m * truth.vel_ned_mps[2] + ml * truth.load_vel_ned_mps[2]) / (m + ml) == pytest.approx(GRAVITY * 0.5)
    plant.release()
    plant.step(STOPPED, 16.2, spinning=False)
    assert plant.truth().specific_force_frd_mps2 == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert plant.truth().acc_ned_mps2[2] == pytest.approx(GRAVITY)


def test_a_cable_only_pulls() -> None:
    """GIVEN a load thrown upwards WHEN the cable is slack THEN it does not push, and pulls again when it is taut."""
    plant = Plant(iris())
    plant.place((0.0, 0.0, -50.0), rotors=0.5)
    plant.kick((0.0, 0.0, -3.0))
    tensions, distances = [], []
    for _ in range(steps(1.0)):
        plant.step((0.55,) * 4, 16.2, spinning=True)
        truth = plant.truth()
        tensions.append(truth.tension_n)
        distances.append(np.linalg.norm(np.subtract(truth.load_pos_ned_m, truth.pos_ned_m)))
        assert truth.taut == (truth.tension_n > 0.0)
    slack = np.array(distances) < 1.5
    assert slack.sum() > 50
    assert not np.any(np.array(tensions)[slack])
    assert max(tensions[-100:]) > 0.5
    assert min(tensions) == 0.0


def test_vehicle_and_load_rest_on_the_ground() -> None:
    plant = Plant(iris())
    start = plant.truth()
    for _ in range(steps(5.0)):
        plant.step(STOPPED, 16.2, spinning=False)
    truth = plant.truth()
    assert truth.grounded
    assert not truth.taut
    assert truth.pos_ned_m == pytest.approx(start.pos_ned_m, abs=1e-6)
    assert truth.load_pos_ned_m == pytest.approx(start.load_pos_ned_m, abs=1e-6)
    assert truth.pos_ned_m[2] == pytest.approx(0.0, abs=0.005)
    assert truth.load_pos_ned_m[2] == pytest.approx(LEG_M, abs=0.005)
    assert truth.specific_force_frd_mps2 == pytest.approx((0.0, 0.0, -GRAVITY), abs=1e-6)


def test_a_dropped_vehicle_comes_to_rest_upright() -> None:
    plant = Plant(iris())
    plant.place((0.0, 0.0, -2.0), (1.0, 0.5, 0.0))
    for _ in range(steps(5.0)):
        plant.step(STOPPED, 16.2, spinning=False)
    truth = plant.truth()
    assert np.linalg.norm(truth.vel_ned_mps) < 0.01
    assert truth.pos_ned_m[2] == pytest.approx(0.0, abs=0.01)
    assert abs(truth.ned_from_frd[0]) > 0.99
    assert truth.load_pos_ned_m[2] == pytest.approx(LEG_M, abs=0.01)


def test_a_released_load_falls_and_has_no_swing() -> None:
    plant = Plant(iris())
    plant.place((0.0, 0.0, -30.0))
    plant.release()
    for _ in range(steps(1.0)):
        plant.step(STOPPED, 16.2, spinning=False)
    truth = plant.truth()
    assert not truth.attached
    assert truth.tension_n == 0.0
    assert np.isnan([truth.xi_rad, truth.zeta_rad, truth.chi_rad, truth.xi_rate_radps]).all()
    assert 0.97 * GRAVITY < truth.load_vel_ned_mps[2] < GRAVITY


def test_a_hook_ahead_of_the_cg_pulls_the_nose_down() -> None:
    parameters = with_vehicle(iris(), hook_frd_m=(0.1, 0.0, 0.0))
    throttle = hover_throttle(parameters)
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -30.0), rotors=throttle)
    plant.step((throttle,) * 4, 16.2, spinning=True)
    rates = plant.truth().rates_frd_radps
    expected = -0.1 * 0.3 * GRAVITY / 0.029125 * DT_S
    assert rates[1] == pytest.approx(expected, rel=0.05)
    assert abs(rates[0]) < 1e-9


@pytest.mark.parametrize(
    ("rotors", "axis", "sign"),
    [((0.5, 0.6, 0.6, 0.5), 0, 1), ((0.6, 0.5, 0.6, 0.5), 1, 1), ((0.6, 0.6, 0.5, 0.5), 2, 1)],
    ids=["left rotors up: rolls right", "front rotors up: nose up", "counter-clockwise rotors up: nose right"],
)
def test_rotors_turn_the_body(rotors: tuple[float, float, float, float], axis: int, sign: int) -> None:
    plant = Plant(iris())
    plant.place((0.0, 0.0, -30.0), rotors=0.55)
    for _ in range(10):
        plant.step(rotors, 16.2, spinning=True)
    rates = plant.truth().rates_frd_radps
    assert sign * rates[axis] > 0.02
    assert max(abs(rates[i]) for i in range(3) if i != axis) < 0.05 * abs(rates[axis])


def test_thrust_follows_curve_voltage_and_lag() -> None:
    parameters = iris(thrust_factor=0.9)
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -300.0))
    thrusts = []
    for _ in range(100):
        plant.step((0.5,) * 4, 14.0, spinning=True)
        thrusts.append(plant.truth().thrust_n)
    static = 0.9 * (14.0 / 16.2) ** 2 * (37.376 * 0.25 + 7.4752 * 0.5 + 0.37376)
    assert thrusts[-1] == pytest.approx(static, rel=1e-6)
    # First-order in the rotor's speed: after 12.5 ms 63.2 % of the throttle's way.
    x = 0.5 * (1.0 - np.exp(-0.012 / 0.0125))
    assert thrusts[2] == pytest.approx(0.9 * (14.0 / 16.2) ** 2 * (37.376 * x * x + 7.4752 * x + 0.37376), rel=1e-3)
    plant.step((0.5,) * 4, 14.0, spinning=False)
    assert plant.truth().thrust_n == 0.0


def test_imu_off_the_cg_feels_the_rotation() -> None:
    """Centripetal acceleration -r w^2 towards the CG."""
    x, y = np.zeros(PlantState.SIZE), np.zeros(PlantOutput.SIZE)
    p = np.array(Plant(with_vehicle(iris(), imu_frd_m=(0.1, 0.0, 0.0)))._p)
    p[PlantParam.RATE_DRAG] = 0.0
    u = np.zeros(PlantInput.SIZE)
    x[PlantState.QUAT] = 1.0
    x[PlantState.POS + 2] = x[PlantState.LOAD_POS + 2] = -100.0
    x[PlantState.RATE + 2] = 3.0
    slung_plant_derivative(np.zeros(PlantState.SIZE), y, x, u, p)
    assert y[PlantOutput.SPECIFIC_FORCE] == pytest.approx(-0.1 * 9.0)
    assert y[PlantOutput.SPECIFIC_FORCE + 1] == pytest.approx(0.0, abs=1e-12)


def test_wind_pushes_vehicle_and_load() -> None:
    parameters = iris(wind_ned_mps=(5.0, 0.0, 0.0))
    plant = Plant(parameters)
    throttle = hover_throttle(parameters)
    plant.place((0.0, 0.0, -50.0), rotors=throttle)
    plant.step((throttle,) * 4, 16.2, spinning=True)
    truth = plant.truth()
    assert truth.acc_ned_mps2[0] == pytest.approx(0.35 * 5.0 / 1.5, rel=0.02)
    assert truth.load_vel_ned_mps[0] == pytest.approx(0.5 * 1.225 * 0.0024 * 25.0 / 0.3 * DT_S, rel=0.05)


def test_gusts_have_the_configured_size_and_the_seed_decides_them() -> None:
    def winds(seed: int) -> np.ndarray:
        plant = Plant(iris(gust_std_mps=1.5, gust_time_constant_s=0.5, wind_ned_mps=(3.0, 0.0, 0.0), seed=seed))
        rows = []
        for _ in range(steps(120.0)):
            plant._blow()
            rows.append(plant.truth().wind_ned_mps)
        return np.array(rows)

    first = winds(1)
    assert first[:, 0].mean() == pytest.approx(3.0, abs=0.5)
    assert first[:, :2].std(axis=0) == pytest.approx([1.5, 1.5], rel=0.15)
    assert not first[:, 2].any()
    assert np.array_equal(first, winds(1))
    assert not np.array_equal(first, winds(2))


def test_the_integration_has_converged() -> None:
    """Four times finer sub-steps change two seconds of flight by less than a hundredth of a millimetre."""
    parameters = iris()
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -50.0), (2.0, 0.0, 0.0), xi_rad=0.4, zeta_rad=0.3, rotors=0.5)
    u = np.zeros(PlantInput.SIZE)
    u[:4] = (0.58, 0.58, 0.581, 0.58)
    u[PlantInput.THRUST_FACTOR] = u[PlantInput.ATTACHED] = 1.0
    results = []
    for substeps in (plant._substeps, 4 * plant._substeps):
        x, y = np.array(plant.state), np.zeros(PlantOutput.SIZE)
        for _ in range(steps(2.0)):
            slung_plant_step(x, y, u, plant._p, DT_S, substeps)
        results.append(x)
    assert results[0] == pytest.approx(results[1], abs=1e-5)


def test_a_step_may_be_cut() -> None:
    """Five fifths of a step are one step: the same flight, the same clock, the same winch and wind."""
    whole, cut = Plant(iris()), Plant(iris())
    for plant, parts in ((whole, 1), (cut, 5)):
        plant.place((0.0, 0.0, -50.0), (2.0, 0.0, 0.0), xi_rad=0.4, zeta_rad=0.3, rotors=0.5)
        plant.set_cable_length(2.0)
        for _ in range(steps(1.5) * parts):
            plant.step((0.58, 0.58, 0.581, 0.58), 16.2, spinning=True, dt_s=DT_S / parts)
    assert cut.t_s == pytest.approx(whole.t_s, abs=1e-9)
    assert cut.state == pytest.approx(whole.state, abs=2e-3)
    assert cut.cable_length_m == whole.cable_length_m == 2.0
    gusty = Plant(iris(gust_std_mps=1.5, gust_time_constant_s=0.5))
    winds = []
    for _ in range(steps(60.0) * 5):
        gusty._blow(DT_S / 5)
        winds.append(gusty.truth().wind_ned_mps[:2])
    assert np.std(winds, axis=0) == pytest.approx([1.5, 1.5], rel=0.2)


def test_a_light_load_on_a_stiff_cable_stays_finite() -> None:
    plant = Plant(iris(load_kg=0.01))
    plant.place((0.0, 0.0, -50.0), xi_rad=0.5, rotors=0.53)
    for _ in range(steps(2.0)):
        plant.step((0.53,) * 4, 16.2, spinning=True)
    assert np.isfinite(plant.state).all()
    assert plant.truth().tension_n < 1.0


def test_a_cable_that_cannot_be_integrated_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"cable_damping_n_s_per_m = 1000,.*0.005.*expected at most"):
        Plant(iris(load_kg=0.005, cable_damping_n_s_per_m=1000.0))


def test_parameters_reach_the_kernel() -> None:
    p = Plant(with_vehicle(iris(), hook_frd_m=(0.1, 0.2, 0.3)))._p
    assert p[PlantParam.MASS] == 1.5
    assert list(p[PlantParam.HOOK : PlantParam.HOOK + 3]) == [0.1, 0.2, 0.3]
    assert p[PlantParam.DRAG] == p[PlantParam.DRAG + 1] == 0.35
    assert p[PlantParam.DRAG + 2] == 0.1


# What may be changed while it runs


def hovering(parameters: Parameters, **place: float) -> tuple[Plant, float]:
    """A vehicle in the air under constant thrust that carries both bodies, and its throttle."""
    throttle = hover_throttle(parameters)
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -100.0), rotors=throttle, **place)
    return plant, throttle


def fly(plant: Plant, throttle: float, duration_s: float) -> list[float]:
    """Tension of every step."""
    tensions = []
    for _ in range(steps(duration_s)):
        plant.step((throttle,) * 4, 16.2, spinning=True)
        tensions.append(plant.output[PlantOutput.TENSION])
    return tensions


def test_a_hooked_load_hangs_taut_and_still_under_the_hook() -> None:
    """GIVEN a load that fell off a moving, turned, tilted vehicle WHEN it is hooked THEN it hangs there at rest."""
    parameters = with_vehicle(frictionless(iris()), hook_frd_m=(0.1, -0.05, 0.2))
    plant = Plant(parameters)
    plant.place((10.0, 20.0, -50.0), (3.0, -2.0, 0.5), yaw_rad=1.0, zeta_rad=0.5, rotors=0.5)
    plant._x[PlantState.RATE : PlantState.RATE + 3] = (0.2, -0.3, 0.5)
    plant.release()
    fly(plant, 0.5, 1.0)
    assert plant.truth().load_pos_ned_m[2] > -46.0
    plant.hook()
    truth = plant.truth()
    rotation = np.array(rotation_matrix(*truth.ned_from_frd))
    assert abs(rotation[2, 0]) > 0.2
    hook = np.array(truth.pos_ned_m) + rotation @ (0.1, -0.05, 0.2)
    below = np.array(truth.load_pos_ned_m) - hook
    assert below == pytest.approx((0.0, 0.0, 1.5 + 0.3 * GRAVITY / 2000.0), abs=1e-9)
    assert truth.attached
    assert truth.chi_rad == pytest.approx(0.0, abs=1e-6)
    assert (truth.xi_rate_radps, truth.zeta_rate_radps) == pytest.approx((0.0, 0.0), abs=1e-9)
    plant.step((0.5,) * 4, 16.2, spinning=True)
    assert plant.truth().taut


def test_hooking_in_hover_is_felt_as_the_load_s_weight_at_once() -> None:
    parameters = iris()
    plant, throttle = hovering(parameters)
    plant.release()
    fly(plant, throttle, 0.02)
    plant.place((0.0, 0.0, -100.0), rotors=throttle)
    plant.hook()
    tensions = fly(plant, throttle, 1.0)
    assert tensions == pytest.approx([0.3 * GRAVITY] * len(tensions), rel=0.02)


def test_a_load_hooked_near_the_ground_lies_there() -> None:
    plant = Plant(iris())
    fly(plant, 0.0, 1.0)
    plant.release()
    plant.hook()
    fly(plant, 0.0, 1.0)
    truth = plant.truth()
    assert truth.attached
    assert not truth.taut
    assert truth.grounded
    assert truth.load_pos_ned_m == pytest.approx((0.0, 0.0, LEG_M), abs=0.005)
    assert truth.load_vel_ned_mps == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_hooking_calms_a_load_that_swings() -> None:
    plant, throttle = hovering(iris(), xi_rad=0.6)
    fly(plant, throttle, 0.3)
    plant.hook()
    fly(plant, throttle, 1.0)
    assert plant.truth().chi_rad < radians(1.0)


def test_twice_the_load_pulls_twice_as_hard() -> None:
    parameters = iris(load_kg=0.4)
    plant, throttle = hovering(parameters)
    before = fly(plant, throttle, 0.5)[-1]
    plant.set_load_mass(0.8)
    heavy = replace(parameters, payload=replace(parameters.payload, mass_kg=0.8))
    tensions = fly(plant, hover_throttle(heavy), 1.0)
    assert before == pytest.approx(0.4 * GRAVITY, rel=0.01)
    assert tensions[-1] == pytest.approx(0.8 * GRAVITY, rel=0.02)
    # The old stretch carries half of the new weight: no blow beyond what a load let go there gives.
    assert max(tensions) < 0.8 * GRAVITY * 1.6
    assert plant.truth().load_mass_kg == plant.load_mass_kg == 0.8


def test_a_changed_mass_flies_like_one_that_was_always_so() -> None:
    """Sub-steps included: the lightest load is the fastest on its cable."""
    changed, always = Plant(iris(load_kg=0.5)), Plant(iris(load_kg=0.005))
    changed.set_load_mass(0.005)
    for plant in (changed, always):
        plant.place((0.0, 0.0, -50.0), xi_rad=0.5, rotors=0.53)
        fly(plant, 0.53, 1.0)
    assert changed.state == always.state


def periods_s(plant: Plant, throttle: float) -> float:
    """Mean period of the lateral swing over the next seconds."""
    crossings = []
    last = plant.truth().xi_rad
    for i in range(steps(6.0)):
        plant.step((throttle,) * 4, 16.2, spinning=True)
        here = plant.truth().xi_rad
        if last > 0.0 >= here:
            crossings.append((i - here / (here - last)) * DT_S)
        last = here
    return float(np.diff(crossings).mean())


@pytest.mark.parametrize("length_m", [0.8, 3.0])
def test_the_period_follows_the_cable_s_length(length_m: float) -> None:
    plant, throttle = hovering(frictionless(iris()), xi_rad=0.05)
    plant.set_cable_length(length_m)
    fly(plant, throttle, 4.0)
    assert plant.cable_length_m == plant.cable_target_m == plant.truth().cable_length_m == length_m
    expected = 2.0 * pi * sqrt(length_m / GRAVITY * 1.5 / 1.8)
    assert periods_s(plant, throttle) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("length_m", [0.5, 6.0])
def test_the_winch_is_smooth_and_on_time(length_m: float) -> None:
    plant, throttle = hovering(iris())
    fly(plant, throttle, 0.5)
    plant.set_cable_length(length_m)
    way = abs(length_m - 1.5)
    expected_s = way / WINCH_MPS + WINCH_MPS / WINCH_MPS2 if way > 1.0 else 2.0 * sqrt(way / WINCH_MPS2)
    lengths, tensions = [], []
    for _ in range(steps(expected_s + 1.0)):
        tensions += fly(plant, throttle, DT_S)
        lengths.append(plant.cable_length_m)
    speed = np.diff(lengths) / DT_S
    assert np.abs(speed).max() == pytest.approx(WINCH_MPS if way > 1.0 else sqrt(way * WINCH_MPS2), rel=0.02)
    assert np.abs(np.diff(speed)).max() < 2.0 * WINCH_MPS2 * DT_S
    assert np.argmax(np.array(lengths) == length_m) * DT_S == pytest.approx(expected_s, abs=0.05)
    assert lengths[-1] == length_m
    assert min(tensions) > 0.7 * 0.3 * GRAVITY
    assert max(tensions) < 1.3 * 0.3 * GRAVITY


@pytest.mark.parametrize("length_m", [0.7, 2.5])
def test_a_changed_length_gives_exactly_the_winch_s_work(length_m: float) -> None:
    """Falling freely and swinging hard: what both bodies gain is tension times cable reeled in, nothing more."""
    parameters = frictionless(iris(load_kg=0.5))
    plant = Plant(parameters)
    plant.place((0.0, 0.0, -500.0), zeta_rad=0.7)
    plant.kick((3.0, 2.0, 1.0))
    plant.set_cable_length(length_m)
    before, work, pulls = energy_j(plant, parameters), 0.0, [plant.output[PlantOutput.TENSION]]
    last_m = plant.cable_length_m
    for _ in range(steps(3.0)):
        plant.step(STOPPED, 16.2, spinning=False)
        pulls.append(plant.output[PlantOutput.TENSION])
        work += 0.5 * (pulls[-2] + pulls[-1]) * (last_m - plant.cable_length_m)
        last_m = plant.cable_length_m
    assert plant.cable_length_m == length_m
    assert abs(work) > 0.5
    assert energy_j(plant, parameters) - before == pytest.approx(work, rel=0.02)


def test_a_winch_that_is_told_to_turn_back_does() -> None:
    plant, throttle = hovering(iris())
    plant.set_cable_length(5.0)
    fly(plant, throttle, 2.0)
    out_m = plant.cable_length_m
    assert 2.0 < out_m < 4.0
    plant.set_cable_length(1.0)
    assert plant.cable_target_m == 1.0
    tensions = fly(plant, throttle, 6.0)
    assert plant.cable_length_m == 1.0
    assert min(tensions) > 0.5 * 0.3 * GRAVITY


def test_wind_and_gusts_change_at_once_and_end() -> None:
    plant = Plant(iris(wind_ned_mps=(1.0, 0.0, 0.0), gust_std_mps=3.0))
    fly(plant, 0.0, 1.0)
    assert plant.truth().wind_ned_mps[0] != 1.0
    plant.set_wind((-4.0, 2.0, 0.5))
    gust = np.subtract(plant.truth().wind_ned_mps, (-4.0, 2.0, 0.5))
    assert gust[:2].all()
    assert gust[2] == 0.0
    plant.set_gusts(0.0)
    assert plant.truth().wind_ned_mps == plant.mean_wind_ned_mps == (-4.0, 2.0, 0.5)
    fly(plant, 0.0, 0.1)
    assert plant.truth().wind_ned_mps == (-4.0, 2.0, 0.5)
    plant.set_gusts(2.0, 0.1)
    assert (plant.gust_std_mps, plant.gust_time_constant_s) == (2.0, 0.1)
    winds = []
    for _ in range(steps(30.0)):
        plant._blow()
        winds.append(plant.truth().wind_ned_mps)
    assert np.std(winds, axis=0) == pytest.approx((2.0, 2.0, 0.0), rel=0.15)
    assert np.mean(winds, axis=0) == pytest.approx((-4.0, 2.0, 0.5), abs=0.5)


def test_gusts_of_one_seed_are_the_same_whenever_they_begin() -> None:
    def winds(plant: Plant, seed: int) -> list[tuple[float, float, float]]:
        plant.set_gusts(2.0, 1.0, seed)
        out = []
        for _ in range(100):
            fly(plant, 0.0, DT_S)
            out.append(plant.truth().wind_ned_mps)
        return out

    one, other = Plant(iris(seed=1)), Plant(iris(seed=2, gust_std_mps=5.0))
    fly(other, 0.0, 1.0)
    first = winds(one, 7)
    assert first == winds(other, 7)
    assert first == winds(one, 7)
    assert first != winds(one, 8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.set_wind((0.0, 31.0, 0.0)), r"simulation.wind_ned_mps: 31 given; expected -30 to 30 m/s"),
        (lambda p: p.set_wind((0.0, 0.0, float("nan"))), r"simulation.wind_ned_mps: nan given"),
        (lambda p: p.set_gusts(-1.0), r"simulation.gust_std_mps: -1 given; expected 0 to 15 m/s"),
        (lambda p: p.set_gusts(1.0, 0.0), r"simulation.gust_time_constant_s: 0 given; expected 0.05 to 60 s"),
        (lambda p: p.set_gusts(1.0, 1.0, -1), r"simulation.seed: -1 given"),
        (lambda p: p.set_load_mass(0.0), r"payload.mass_kg: 0 given; expected 0.005 to 2000 kg"),
        (lambda p: p.set_load_mass(float("inf")), r"payload.mass_kg: inf given"),
        (lambda p: p.set_cable_length(0.0), r"cable.length_m: 0 given; expected 0.1 to 200 m"),
        (lambda p: p.kick((0.0, KICK_MAX_MPS + 1.0, 0.0)), r"kick: 0, 31, 0 given; expected each of -30 to 30 m/s"),
        (lambda p: p.kick((float("nan"), 0.0, 0.0)), r"kick: nan, 0, 0 given"),
    ],
)
def test_what_is_out_of_bounds_is_refused_and_changes_nothing(change: Callable[[Plant], None], message: str) -> None:
    parameters = iris(gust_std_mps=1.0, wind_ned_mps=(1.0, 2.0, 3.0))
    plant, untouched = Plant(parameters), Plant(parameters)
    with pytest.raises(ConfigurationError, match=message):
        change(plant)
    for one in (plant, untouched):
        fly(one, 0.0, 0.1)
    assert plant.truth() == untouched.truth()


def test_a_mass_too_light_for_its_cable_is_refused_and_changes_nothing() -> None:
    parameters = iris(load_kg=1.0, cable_damping_n_s_per_m=1000.0)
    plant, throttle = hovering(parameters)
    with pytest.raises(ConfigurationError, match=r"payload.mass_kg = 0.005.*expected at most"):
        plant.set_load_mass(0.005)
    assert plant.load_mass_kg == 1.0
    assert np.isfinite(fly(plant, throttle, 1.0)).all()
