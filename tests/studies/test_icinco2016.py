"""The study's claims, and its indicators against independent calculations."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.core import es_lkf
from swingd.core.constants import GRAVITY_MPS2
from swingd.core.planar_flight import PlanarFlightLog
from swingd.core.planar_rotorcraft import PlanarState
from swingd.model.errors import StudyError
from swingd.studies.icinco2016 import filters, paper, report, variations
from swingd.studies.icinco2016.cases import (
    CIRCLE_HEIGHT_M,
    CIRCLE_HZ,
    REGULATION,
    REGULATION_TORQUE,
    SCENARIOS,
    TORQUE_FOR_S,
    TORQUE_NM,
    VARIANTS,
)
from swingd.studies.icinco2016.flight import run
from swingd.studies.icinco2016.indicators import AXES, ESTIMATED_FROM_S, UNITS, indicators
from swingd.studies.icinco2016.study import as_object, fly_all, fly_and_judge, judge
from swingd.studies.seeds import mean_and_spread

SEED = 1
HALF = 0.5


@pytest.fixture(scope="module")
def flights():
    return fly_all(SEED)


@pytest.fixture(scope="module")
def figures(flights):
    return judge(flights, SEED)


def column(flight, first, count=1):
    return flight.column(first, count)


# ---- claims of the paper


@pytest.mark.parametrize("case", [scenario.name for scenario in SCENARIOS])
@pytest.mark.parametrize("rotational", [False, True])
def test_compensation_of_the_translation_halves_the_tracking_error_at_least(figures, case, rotational):
    without = figures[f"{case}/{'rotational' if rotational else 'none'}"]
    with_it = figures[f"{case}/{'both' if rotational else 'translational'}"]
    assert without["rho_x"] > 0.1
    assert with_it["error"] < HALF * without["error"]


@pytest.mark.parametrize("case", ["regulation_torque", "circle_torque", "circle_hook"])
def test_compensation_of_the_rotation_halves_it_wherever_the_load_turns_the_vehicle(figures, case):
    """With the translation compensated: without, the load's weight is the error whatever the pitch does."""
    assert figures[f"{case}/translational"]["rho_theta"] > 0.05
    assert figures[f"{case}/both"]["error_x_torque"] < HALF * figures[f"{case}/translational"]["error_x_torque"]


def test_without_torque_and_with_the_hook_at_the_centre_nothing_turns_the_vehicle(figures):
    """(23) is (16): there is nothing to compensate, and compensating costs nothing."""
    for variant in VARIANTS:
        assert figures[f"regulation/{variant}"]["rho_theta"] == 0.0
        assert "relative_theta" not in figures[f"regulation/{variant}"]
    assert figures["regulation/both"]["error"] == pytest.approx(figures["regulation/translational"]["error"], rel=0.1)


def test_conclusions_hold_with_what_was_chosen_varied_by_half(figures):
    found = {group: values for group, values in figures.items() if group.startswith(variations.GROUP)}
    # As chosen; four gains, torque, duration, and of the circle the frequency, each up and down.
    assert len(found) == 2 * (1 + 2 * 6) + 2
    for group, values in found.items():
        for layer in variations.RATIOS:
            assert values[layer] < HALF, (group, layer)


def test_the_uncompensated_circle_drifts_and_the_compensated_one_closes(flights):
    """Figures 8 and 10."""
    off_circle, gap = {}, {}
    for variant in ("translational", "both"):
        flight = flights["circle_torque", variant]
        x, z = column(flight, PlanarFlightLog.STATE, 2).T
        off = np.abs(np.hypot(x, z - CIRCLE_HEIGHT_M) - paper.RADIUS_M)
        settled, acts = flight.t_s > 10.0, (flight.t_s > 15.0) & (flight.t_s < 21.0)
        assert off[settled & (flight.t_s < 15.0)].max() < 0.05
        off_circle[variant] = off[acts].max()
        turn = round(1.0 / (CIRCLE_HZ * paper.DT_S))
        # Of the turn that begins where the torque ends.
        gap[variant] = np.hypot(x[-1] - x[-1 - turn], z[-1] - z[-1 - turn])
    assert off_circle["translational"] > 0.4
    assert gap["translational"] > 0.4
    assert off_circle["both"] < 0.1
    assert gap["both"] < 0.05


def test_the_weight_of_the_load_is_what_regulation_misses_without_compensation(flights, figures):
    """m_p g / (m_r kp) below the wanted height, the rod's swing aside; Figure 3's vehicle stays below 1 m as well."""
    sag_m = paper.LOAD_MASS_KG * GRAVITY_MPS2 / (paper.MASS_KG * REGULATION.gains.kp)
    assert figures["regulation/none"]["error_z"] == pytest.approx(sag_m, rel=0.01)
    assert column(flights["regulation", "none"], PlanarFlightLog.STATE + PlanarState.Z).max() < 1.0


def test_compensation_takes_the_swing_out_and_its_absence_lets_it_grow(flights, figures):
    assert figures["regulation/both"]["swing"] < 1.0
    rod = np.degrees(np.abs(column(flights["regulation", "none"], PlanarFlightLog.STATE + PlanarState.ROD)))
    t_s = flights["regulation", "none"].t_s
    assert rod[t_s > 25.0].max() > 1.2 * rod[(t_s > 5.0) & (t_s < 10.0)].max()
    # It is the lag of the inner layer that drives it: twice as fast, the swing dies away.
    fast = run(
        replace(REGULATION, gains=replace(REGULATION.gains, kp_pitch=100.0, kd_pitch=20.0)), VARIANTS["none"], SEED
    )
    rod = np.degrees(np.abs(column(fast, PlanarFlightLog.STATE + PlanarState.ROD)))
    assert rod[t_s > 25.0].max() < 0.4 * rod[(t_s > 5.0) & (t_s < 10.0)].max()


def test_told_the_wanted_force_the_filters_take_the_lag_of_the_pitch_for_a_disturbance(figures):
    """And compensating it drives the loop, although without compensation nothing is changed."""
    told = {
        variant: indicators(run(replace(REGULATION, told_wanted=True), VARIANTS[variant], SEED))
        for variant in ("none", "both")
    }
    assert told["none"]["error"] == pytest.approx(figures["regulation/none"]["error"], rel=1e-3)
    assert told["none"]["rmse_x"] > 2.0 * figures["regulation/none"]["rmse_x"]
    assert told["both"]["error"] > 10.0 * figures["regulation/both"]["error"]


# ---- how well rho is known


def noise_std(inertia):
    """Deviation of rho_hat by the measurements' noise alone: the settled filter, fed with nothing else."""
    A, B, Q = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    es_lkf.discretise(A, B, Q, inertia, paper.PROCESS_DENSITY, paper.DT_S)
    P_prior, P, K = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2))
    es_lkf.steady_state(P_prior, P, K, A, Q, np.full(2, paper.SENSOR_VAR))
    loop = (np.eye(3) - K @ np.eye(2, 3)) @ A
    cov = np.zeros((3, 3))
    for _ in range(4000):
        cov = loop @ cov @ loop.T + paper.SENSOR_VAR * K @ K.T
    return math.sqrt(cov[2, 2])


def test_the_error_of_rho_is_lag_and_noise_and_the_noise_is_what_riccati_says(flights, figures):
    for (case, variant), flight in flights.items():
        values = figures[f"{case}/{variant}"]
        judged = flight.t_s >= ESTIMATED_FROM_S
        for axis, name in enumerate(AXES):
            true, found = (
                column(flight, first + axis)[judged] for first in (PlanarFlightLog.RHO, PlanarFlightLog.RHO_ESTIMATE)
            )
            assert values[f"rmse_{name}"] == pytest.approx(math.sqrt(np.mean((found - true) ** 2)))
            parts = math.hypot(values[f"lag_{name}"], values[f"noise_{name}"])
            if VARIANTS[variant].translational and name == "z":
                # The estimate's noise goes into the thrust, and m_p / (m_r + m_p) of that into the rod's true pull.
                assert values["rmse_z"] < 0.95 * parts
            else:
                assert values[f"rmse_{name}"] == pytest.approx(parts, rel=0.05)
    assert figures["regulation/both"]["noise_theta"] == pytest.approx(noise_std(paper.INERTIA_KG_M2), rel=0.1)
    # x and z have the estimated pitch's error, too: it turns the thrust that the filter is told.
    for name in ("x", "z"):
        assert figures["regulation/both"][f"noise_{name}"] == pytest.approx(noise_std(paper.MASS_KG), rel=0.2)
    # The rule of thumb of the documentation, from the velocity alone.
    for inertia in (paper.MASS_KG, paper.INERTIA_KG_M2):
        density = paper.SENSOR_VAR * paper.DT_S
        bandwidth = (paper.PROCESS_DENSITY / (inertia**2 * density)) ** 0.25
        assert noise_std(inertia) == pytest.approx(
            math.sqrt(inertia**2 * density * bandwidth**3 / math.sqrt(8.0)), rel=0.15
        )


def test_with_the_printed_noise_ten_percent_are_in_reach_of_the_weight_alone(figures):
    for case in ("regulation_torque", "circle_torque"):
        assert figures[f"{case}/both"]["relative_z"] < 10.0
        assert figures[f"{case}/both"]["relative_x"] > 50.0
    best = {
        (var, name): min(figures[f"{filters.GROUP}R {var:g}/Q {density:g}"][name] for density in filters.DENSITIES)
        for var in filters.SENSOR_VARS
        for name in AXES
    }
    assert best[1e-3, "x"] > 40.0
    assert best[1e-3, "theta"] > 20.0
    # Sensors a hundred times better make it so.
    assert all(best[1e-7, name] < 10.0 for name in AXES)


def test_the_filter_alone_finds_what_the_one_in_the_loop_found(flights):
    """Constant gains on the logged flight, by the estimator's class, against the compiled recursion, without noise."""
    flight = flights["circle_torque", "both"]
    state = column(flight, PlanarFlightLog.STATE, 8)
    forces = filters._forces(flight)
    later = flight.t_s > 3.0
    for axis in range(3):
        measured = state[:, [axis, PlanarState.RATES + axis]]
        alone = filters.estimated(measured, forces[:, axis], axis, paper.PROCESS_DENSITY, paper.SENSOR_VAR)
        in_loop = column(flight, PlanarFlightLog.RHO_NOISELESS + axis)
        np.testing.assert_allclose(alone[later], in_loop[later], atol=0.02)


# ---- scenarios


def test_the_torque_acts_when_and_as_it_is_said(flights):
    flight = flights["circle_torque", "both"]
    rho = column(flight, PlanarFlightLog.RHO + 2)
    acts = (flight.t_s >= 15.0) & (flight.t_s < 15.0 + TORQUE_FOR_S)
    np.testing.assert_allclose(rho[acts], -TORQUE_NM, atol=1e-12)
    np.testing.assert_allclose(rho[~acts], 0.0, atol=1e-12)


def test_the_circle_is_the_printed_one_about_a_chosen_centre(flights):
    flight = flights["circle_torque", "none"]
    angle = 2.0 * math.pi * CIRCLE_HZ * flight.t_s
    wanted = column(flight, PlanarFlightLog.POS_SP, 2)
    np.testing.assert_allclose(wanted[:, 0], 4.0 * np.sin(angle), atol=1e-9)
    np.testing.assert_allclose(wanted[:, 1] - CIRCLE_HEIGHT_M, 4.0 * np.cos(angle), atol=1e-9)
    np.testing.assert_allclose(column(flight, PlanarFlightLog.STATE, 2)[0], wanted[0], atol=1e-12)


def test_a_rod_turns_over_where_the_torque_passes_the_limit_that_is_told():
    """(1 - cos gamma) / gamma has its maximum of 0.7246: pushed from rest, below it the rod comes back."""
    weight_nm = paper.LOAD_MASS_KG * GRAVITY_MPS2 * paper.ROD_LENGTH_M
    assert 1.5 * abs(TORQUE_NM) < 0.7246 * weight_nm

    def largest(torque_nm):
        def rate(_t_s, x):
            return [x[1], (torque_nm - weight_nm * math.sin(x[0])) / (paper.LOAD_MASS_KG * paper.ROD_LENGTH_M**2)]

        return solve_ivp(rate, (0.0, 4.0), [0.0, 0.0], rtol=1e-8).y[0].max()

    assert largest(0.72 * weight_nm) < math.pi
    assert largest(0.73 * weight_nm) > 2.0 * math.pi


def test_bounds_of_the_thrust_are_never_met(flights):
    for flight in flights.values():
        assert not column(flight, PlanarFlightLog.BOUNDED).any()


def test_every_compensation_meets_the_same_noise(flights):
    first = [column(flights["regulation", variant], PlanarFlightLog.ESTIMATE, 6)[0] for variant in VARIANTS]
    for other in first[1:]:
        np.testing.assert_array_equal(other, first[0])
    assert not np.array_equal(column(run(REGULATION, VARIANTS["none"], 2), PlanarFlightLog.ESTIMATE, 6)[0], first[0])


def test_indicators_by_hand(flights):
    flight = flights["regulation_torque", "translational"]
    found = indicators(flight)
    x, z = column(flight, PlanarFlightLog.STATE, 2).T
    late, torque = flight.t_s >= 10.0, flight.t_s >= 15.0
    assert found["error"] == pytest.approx(math.sqrt(np.mean((x[late] - 8.0) ** 2 + (z[late] - 3.0) ** 2)))
    assert found["error"] == pytest.approx(math.hypot(found["error_x"], found["error_z"]))
    assert found["peak_torque"] == pytest.approx(np.hypot(x[torque] - 8.0, z[torque] - 3.0).max())
    assert found["overshoot_x"] == pytest.approx(100.0 * (x[~torque].max() / 8.0 - 1.0))
    settled = found["settled"]
    distance = np.hypot(x - 8.0, z - 3.0)
    limit = 0.05 * math.hypot(8.0, 3.0)
    assert distance[(flight.t_s >= settled) & ~torque].max() <= limit
    assert distance[flight.t_s < settled - 0.005][-1] > limit
    assert set(found) == set(UNITS)
    assert indicators(flights["regulation", "none"])["settled"] == paper.TORQUE_AT_S
    assert "overshoot_x" not in indicators(flights["circle_torque", "both"])


def test_a_flight_that_diverges_is_an_error():
    wild = replace(REGULATION_TORQUE, gains=replace(REGULATION.gains, kp_pitch=-1e6))
    with pytest.raises(StudyError, match="regulation_torque, seed 1: the flight diverged"):
        run(wild, VARIANTS["both"], 1)


# ---- what comes out


def test_object_holds_every_case_and_index(figures):
    result = as_object(*mean_and_spread([figures]), 1)
    json.dumps(result, allow_nan=False)
    for scenario in SCENARIOS:
        assert result[scenario.name]["error"]["both"] == figures[f"{scenario.name}/both"]["error"]
    assert "both_std" not in result["regulation"]["error"]
    assert "both_std" in as_object(*mean_and_spread([figures, figures]), 2)["regulation"]["error"]
    assert result["variations"]["circle_torque"]["kp x 0.5"]["rotational"] < HALF
    assert set(result["filters"]["R 0.001"]["Q 1"]) == set(AXES)


def test_another_seed_is_another_noise(figures, monkeypatch):
    monkeypatch.setattr(filters, "SENSOR_VARS", (paper.SENSOR_VAR,))
    monkeypatch.setattr(variations, "FACTORS", ())
    assert fly_and_judge(SEED + 1)["circle_torque/both"] != figures["circle_torque/both"]


def test_command_writes_tables_and_prints_one_object(figures, tmp_path):
    done = CliRunner().invoke(app, ["study", "icinco2016", "--no-figures", "--json", "-o", str(tmp_path / "x")])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result == json.loads(json.dumps(as_object(*mean_and_spread([figures]), 1)))
    with (tmp_path / "x" / "tables.csv").open(encoding="utf-8") as file:
        rows = {(row["case"], row["compensation"], row["index"]): row for row in csv.DictReader(file)}
    row = rows["circle_torque", "both", "error"]
    assert float(row["ours"]) == pytest.approx(result["circle_torque"]["error"]["both"], rel=1e-5)
    assert row["unit"] == "m"
    page = (tmp_path / "x" / "tables.md").read_text(encoding="utf-8")
    assert all(f"## {scenario.name}" in page for scenario in SCENARIOS)


def test_tables_say_what_the_figures_are(figures):
    mean, spread = mean_and_spread([figures, figures])
    table = list(report.rows(mean, spread))
    headings, body = report.case_table("regulation_torque", table, 2)
    cells = {row[0]: dict(zip(headings, row, strict=True)) for row in body}
    assert headings == ("compensation", *VARIANTS)
    assert cells["settled [s]"]["none"] == "no"
    assert float(cells["error [m]"]["both"].split(" ± ")[0]) == pytest.approx(
        figures["regulation_torque/both"]["error"], rel=5e-3
    )
    assert cells["rho_theta [N m]"]["both"] == "0.083 ± 0"
    headings, body = report.variations_table(mean, spread, 2)
    cells = {row[0]: dict(zip(headings, row, strict=True)) for row in body}
    assert cells["circle_hz x 1.5"]["rotational, regulation"] == ""
    ratio = figures["variations/circle_torque/kp x 0.5"]["rotational"]
    assert float(cells["kp x 0.5"]["rotational, circle"].split(" ± ")[0]) == pytest.approx(ratio, rel=0.05)
    headings, body = report.filters_table(mean)
    assert len(body) == len(filters.SENSOR_VARS) * len(AXES)
    row = dict(zip(headings, body[0], strict=True))
    assert row["Q = 1"] == f"{figures['filters/R 0.001/Q 1']['x']:.0f}%"


def test_command_prints_its_tables(monkeypatch, tmp_path):
    monkeypatch.setattr(filters, "DENSITIES", (paper.PROCESS_DENSITY,))
    monkeypatch.setattr(filters, "SENSOR_VARS", (paper.SENSOR_VAR,))
    monkeypatch.setattr(variations, "FACTORS", (1.5,))
    done = CliRunner().invoke(app, ["study", "icinco2016", "--no-figures", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    for text in (*(scenario.name for scenario in SCENARIOS), report.VARIATIONS_TITLE[:60], "other variances R"):
        assert text in done.stdout
