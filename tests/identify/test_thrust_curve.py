"""Thrust curves from a stand and from hover: truth inside the intervals, what is unknown, the command, bad files."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from swingd.cli.main import app
from swingd.core.constants import GRAVITY_MPS2
from swingd.identify.thrust_curve import StandRow, fit_hover, fit_stand, hover_rows, is_stand_csv, read_stand
from swingd.model.errors import LogFormatError
from swingd.model.events import Attitude, Battery, Imu, Motors, Throttle
from swingd.model.parameters import Thrust

A, B, C, V0, N = 9.0, 2.0, 0.1, 16.0, 1.9


def thrust_n(x, voltage_v):
    return (voltage_v / V0) ** N * (A * x * x + B * x + C)


def stand(rng=None, noise_n=0.03, voltages=(16.6, 16.0, 15.0, 14.0)):
    rng = rng or np.random.default_rng(1)
    return [
        StandRow(x, thrust_n(x, u) + noise_n * rng.normal(), u)
        for u in voltages
        for x in np.linspace(0.1, 1.0, 10).tolist()
    ]


def test_an_exact_stand_gives_the_exact_curve():
    curve = fit_stand(stand(noise_n=0.0), Thrust(), 4, V0)
    found = [curve.quadratic_n.value, curve.linear_n.value, curve.offset_n.value, curve.exponent.value]
    assert found == pytest.approx([4 * A, 4 * B, 4 * C, N], rel=1e-6)
    assert curve.rms_n == pytest.approx(0.0, abs=1e-6)


def test_the_printed_curves_are_of_this_shape():
    """(28), (29) with x in percent: the square of the voltage, no offset."""
    rows = [
        StandRow(x, 0.8 * (u / 16.0) ** 2 * (0.0011 * (100 * x) ** 2 + 0.76 * 100 * x), u)
        for u in (16.0, 15.0, 14.0)
        for x in np.linspace(0.1, 0.8, 8).tolist()
    ]
    curve = fit_stand(rows, Thrust(), nominal_v=16.0)
    found = [curve.quadratic_n.value, curve.linear_n.value, curve.offset_n.value, curve.exponent.value]
    assert found == pytest.approx([0.8 * 11.0, 0.8 * 76.0, 0.0, 2.0], abs=1e-5)


def test_intervals_hold_the_truth_as_often_as_they_say():
    held = np.zeros(4)
    for seed in range(200):
        curve = fit_stand(stand(np.random.default_rng(seed)), Thrust(), 1, V0)
        values = (curve.quadratic_n, curve.linear_n, curve.offset_n, curve.exponent)
        held += [value.low <= true <= value.high for value, true in zip(values, (A, B, C, N), strict=True)]
    assert ((held > 0.90 * 200) & (held < 0.99 * 200)).all(), held


def test_without_voltages_that_differ_the_exponent_stays_configured():
    same = fit_stand(stand(voltages=(16.0, 16.1)), Thrust(voltage_exponent=1.5), 1)
    assert same.exponent is None
    assert same.exponent_used == 1.5
    assert "the voltage differed by 0.6 % only" in same.yaml()
    none = fit_stand([StandRow(row.throttle, row.thrust_n, math.nan) for row in stand(voltages=(16.0,))], Thrust())
    assert none.exponent is None
    assert none.voltage_nominal_v == Thrust().voltage_nominal_v
    assert "no voltage was measured" in none.yaml()


def hover(rng, load_kg=0.3, vehicle_kg=1.5, seconds=120):
    """Streams of a hover while the battery falls from 16.4 to 14.2 V; a manoeuvre in its middle."""
    weight_n = (vehicle_kg + load_kg) * GRAVITY_MPS2
    imu, attitudes, throttles, batteries = [], [], [], []
    for k in range(seconds * 20):
        t = k / 20.0
        voltage = 16.4 - 2.2 * t / seconds
        wild = 50.0 < t < 60.0
        lift = 1.3 if wild else 1.0
        # 4 rotors of `thrust_n` together.
        wanted = lift * weight_n / 4.0 / (voltage / V0) ** N
        x = (-B + math.sqrt(B * B + 4.0 * A * (wanted - C))) / (2.0 * A)
        felt = -(lift * weight_n - load_kg * GRAVITY_MPS2) / vehicle_kg + 0.1 * rng.normal()
        imu.append(Imu(t + 5.0, t, (0.05 * rng.normal(), 0.05 * rng.normal(), felt), (0.0, 0.4 * wild, 0.0)))
        attitudes.append(Attitude(t + 5.0, t, 0.02, 0.01, 0.0))
        throttles.append(Throttle(t + 5.0, t, x + 0.003 * rng.normal()))
        if k % 10 == 0:
            batteries.append(Battery(t + 5.0, voltage + 0.02 * rng.normal()))
    return imu, attitudes, throttles, batteries


def test_hover_at_falling_voltage_tells_scale_and_exponent():
    streams = hover(np.random.default_rng(3))
    rows = hover_rows(*streams, [(0.0, 120.0)], 1.5, 0.3)
    assert 100 < len(rows) < 112
    assert all(row.thrust_n == pytest.approx(1.8 * GRAVITY_MPS2, rel=0.02) for row in rows)
    guessed = Thrust(quadratic_n=4 * A * 1.2, linear_n=4 * B * 1.2, offset_n=4 * C * 1.2, voltage_nominal_v=V0)
    curve = fit_hover(rows, guessed)
    assert curve.exponent.value == pytest.approx(N, abs=0.05)
    assert curve.exponent.low < N < curve.exponent.high
    assert curve.quadratic_n.low < 4 * A < curve.quadratic_n.high
    assert curve.quadratic_n.value == pytest.approx(4 * A, rel=0.01)


def test_motor_outputs_are_taken_as_their_mean_and_hover_without_load_is_lighter():
    imu, attitudes, throttles, batteries = hover(np.random.default_rng(3), load_kg=0.0)
    motors = [Motors(t.t_mono_s, t.t_boot_s, (t.throttle - 0.1, t.throttle + 0.1)) for t in throttles]
    with_motors = hover_rows(imu, attitudes, motors, batteries, [(0.0, 120.0)], 1.5, 0.0)
    with_throttle = hover_rows(imu, attitudes, throttles, batteries, [(0.0, 120.0)], 1.5, 0.0)
    np.testing.assert_allclose([r.throttle for r in with_motors], [r.throttle for r in with_throttle])
    assert with_motors[0].thrust_n == pytest.approx(1.5 * GRAVITY_MPS2, rel=0.02)
    assert hover_rows(imu, attitudes, [], batteries, [(0.0, 120.0)], 1.5, 0.0) == []


def test_standing_on_the_ground_is_no_hover():
    guessed = Thrust(quadratic_n=4 * A, linear_n=4 * B, offset_n=4 * C, voltage_nominal_v=V0)
    rows = hover_rows(*hover(np.random.default_rng(3)), [(0.0, 120.0)], 1.5, 0.3)
    ground = [replace(row, throttle=0.05) for row in rows[:40]]
    with_ground, without = fit_hover([*ground, *rows], guessed), fit_hover(rows, guessed)
    assert with_ground.exponent == without.exponent
    assert with_ground.quadratic_n == without.quadratic_n
    with pytest.raises(
        LogFormatError, match=r"gives 0.89 N at throttle 0.05, where .* N were flown; expected the curve"
    ):
        fit_hover(ground, guessed)


def test_a_flight_without_hover_is_refused():
    with pytest.raises(LogFormatError, match="3 quiet seconds of hover; expected at least 20"):
        fit_hover(hover_rows(*hover(np.random.default_rng(3)), [(0.0, 4.0)], 1.5, 0.3), Thrust())


def written(path, rows, header="throttle,thrust_n,voltage_v"):
    path.write_text(
        "\n".join([header, *(",".join(f"{cell:.6g}" for cell in row) for row in rows)]) + "\n", encoding="utf-8"
    )
    return path


def run(*arguments):
    return CliRunner().invoke(app, ["calibrate", "thrust", *map(str, arguments)])


def test_the_command_fits_draws_and_prints_what_a_configuration_takes(tmp_path):
    source = written(tmp_path / "stand.csv", [(r.throttle, max(r.thrust_n, 0.0), r.voltage_v) for r in stand()])
    done = run(source, "--rotors", 4, "--nominal-voltage", V0, "-o", tmp_path / "curve.png")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "curve.png").stat().st_size > 10000
    block = done.stdout.split("to paste:\n\n")[1]
    config = tmp_path / "config.yaml"
    config.write_text(block, encoding="utf-8")
    checked = CliRunner().invoke(app, ["check", str(config)])
    assert checked.exit_code == 0, checked.output
    from swingd.config.loader import load_parameters

    told = load_parameters(config, ()).thrust
    assert told.quadratic_n == pytest.approx(4 * A, rel=0.05)
    assert told.voltage_exponent == pytest.approx(N, abs=0.05)
    assert told.voltage_nominal_v == V0


def test_the_command_prints_one_object(tmp_path):
    source = written(tmp_path / "stand.csv", [(r.throttle, max(r.thrust_n, 0.0), r.voltage_v) for r in stand()])
    done = run(source, "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["quadratic_n"]["low"] < said["quadratic_n"]["value"] < said["quadratic_n"]["high"]
    assert said["largest_error_percent"]["compensated"] < said["largest_error_percent"]["uncompensated"]
    assert said["yaml"].startswith("thrust:\n")
    assert not said["from_hover"]


def test_the_command_reads_a_flight_s_log(tmp_path):
    imu, attitudes, throttles, batteries = hover(np.random.default_rng(3))
    volts = np.interp(
        [s.t_boot_s for s in imu], [b.t_mono_s - 5.0 for b in batteries], [b.voltage_v for b in batteries]
    )
    names = [
        "t_boot_s", *(f"acc_{i}_frd_mps2" for i in "xyz"), *(f"gyro_{i}_frd_radps" for i in "xyz"),
        "roll_rad", "pitch_rad", "yaw_rad", "throttle", "voltage_v",
    ]  # fmt: skip
    rows = [
        (s.t_boot_s, *s.acc_frd_mps2, *s.gyro_frd_radps, a.roll_rad, a.pitch_rad, a.yaw_rad, t.throttle, u)
        for s, a, t, u in zip(imu, attitudes, throttles, volts, strict=True)
    ]
    log = written(tmp_path / "hover.csv", rows, ",".join(names))
    facts = {
        "vehicle.mass_kg": 1.5, "payload.mass_kg": 0.3, "cable.length_m": 1.5, "thrust.quadratic_n": 4 * A,
        "thrust.linear_n": 4 * B, "thrust.offset_n": 4 * C, "thrust.voltage_nominal_v": V0,
    }  # fmt: skip
    settings = [word for key, value in facts.items() for word in ("--set", f"{key}={value}")]
    done = run(log, *settings, "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["from_hover"]
    assert said["voltage_exponent"]["value"] == pytest.approx(N, abs=0.08)
    assert said["samples"] > 60


@pytest.mark.parametrize(
    ("rows", "header", "said"),
    [
        (
            [(0.1, 1.0, 16.0)] * 2 + [(1.3, 1.0, 16.0)] + [(0.2, 1.0, 16.0)] * 3,
            None,
            "line 4: throttle 1.3; expected 0 .. 1",
        ),
        ([(0.1, 1.0, 16.0)] + [(0.2, -2.0, 16.0)] * 5, None, "line 3: thrust_n -2; expected 0 .. 100000"),
        ([(0.1, 1.0, 16.0)] + [(0.2, 2.0, 0.0)] * 5, None, "line 3: voltage_v 0; expected 1 .. 1000"),
        ([(0.1, 1.0, 16.0)] + [(0.2, math.nan, 16.0)] * 5, None, "line 3: thrust_n nan; expected 0 .. 100000"),
        ([(0.1, 1.0, 16.0)] * 3, None, "3 rows; expected at least 5"),
        ([(0.1, 1.0, 16.0)] * 9, None, "1 different throttles; expected at least 4"),
        ([(0.1, 1.0)] * 9, "throttle,thrust_gf", "line 1: no column thrust_n; expected throttle, thrust_n"),
        ([(0.1, 1.0)] * 9, None, "line 2: 2 cells; expected 3"),
    ],
)
def test_a_bad_stand_is_refused_with_line_value_and_expectation(tmp_path, rows, header, said):
    source = written(tmp_path / "stand.csv", rows, header or "throttle,thrust_n,voltage_v")
    done = run(source)
    assert done.exit_code == 1
    assert said in done.stderr
    assert str(source) in done.stderr


def test_a_file_that_is_not_there_and_one_that_is_no_log(tmp_path):
    done = run(tmp_path / "none.csv")
    assert done.exit_code == 1
    assert "cannot be read" in done.stderr
    source = written(tmp_path / "other.csv", [(1.0, 2.0)], "a,b")
    assert not is_stand_csv(source)
    assert run(source).exit_code == 1


def test_blank_lines_do_not_shift_the_line_that_is_named(tmp_path):
    source = tmp_path / "stand.csv"
    source.write_text("throttle,thrust_n\n0.1,1\n\n0.2,2\n0.3,oops\n", encoding="utf-8")
    with pytest.raises(LogFormatError, match="line 5, column 2: 'oops'; expected a number"):
        read_stand(source)
    source.write_text("throttle,thrust_n\n0.1,1\n\n0.2,2\n3,1\n", encoding="utf-8")
    with pytest.raises(LogFormatError, match="line 5: throttle 3"):
        read_stand(source)
