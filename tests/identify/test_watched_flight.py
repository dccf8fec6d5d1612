"""Training logs from a flight and from what watched it: frames, clocks, gaps, and what is refused."""

import gzip
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swingd.identify.swing_log import read
from swingd.identify.watched_flight import Watched, read_watched, swing_rows
from swingd.model.actions import Health, SwingReport
from swingd.model.errors import LogFormatError
from swingd.model.events import Attitude, Vec3

ZERO = (0.0, 0.0, 0.0)
HEADER = "t_boot_s,veh_n_m,veh_e_m,load_n_m,load_e_m,veh_vn_m_s,veh_ve_m_s,attached,taut"


def report(t_s: float, applied: Vec3 = (0.1, 0.2, -22.0)) -> SwingReport:
    return SwingReport(
        t_s, 0.0, 0.0, 0.0, 0.0, ZERO, 0.01, 0.01, 22.0, 1.0, 1.0, ZERO, ZERO, Health.READY, applied_ned_n=applied
    )


def watched(times: np.ndarray, moving: bool = True) -> Watched:
    """The vehicle leads its load north by as many metres as the clock shows tenths of seconds past 10 s."""
    rel = np.column_stack([times - 10.0, np.full(times.size, 0.2)])
    return Watched(times, rel, np.column_stack([2.0 * times, times]) if moving else None)


def attitudes(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> list[Attitude]:
    return [Attitude(t, t, roll, pitch, yaw) for t in (0.0, 10.0, 20.0)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "truth.csv"


def test_the_steps_of_the_filter_get_what_was_seen_between_two_rows() -> None:
    rows = swing_rows(
        watched(np.arange(10.0, 11.0, 0.02)), [report(10.25 + 0.01 * k) for k in range(20)], attitudes(), ZERO
    )
    assert rows.rel_m[0] == pytest.approx((0.25, 0.2))
    assert rows.force_ned_n[0] == pytest.approx((0.1, 0.2, -22.0))
    assert rows.vel_mps is not None
    assert rows.vel_mps[0] == pytest.approx((20.5, 10.25))
    assert len(rows.t_s) == 20


@pytest.mark.parametrize(
    ("turned", "hook", "moved"),
    [
        ({}, (0.3, 0.1, 0.2), (0.3, 0.1)),
        ({"yaw": math.pi / 2}, (0.3, 0.0, 0.2), (0.0, 0.3)),
        ({"pitch": 0.2}, (0.0, 0.0, 0.5), (0.5 * math.sin(0.2), 0.0)),
        ({"roll": 0.2}, (0.0, 0.0, 0.5), (0.0, -0.5 * math.sin(0.2))),
    ],
)
def test_the_log_has_the_hook_and_not_the_centre_of_gravity(turned: dict[str, float], hook: Vec3, moved: Vec3) -> None:
    """Nose up: a hook below is ahead. Right side down: it is to the left."""
    rows = swing_rows(watched(np.arange(10.0, 11.0, 0.02)), [report(10.5)], attitudes(**turned), hook)
    assert rows.rel_m[0] - (0.5, 0.2) == pytest.approx(moved)


def test_a_heading_that_passes_south_is_interpolated_the_short_way() -> None:
    around = [Attitude(t, t, 0.0, 0.0, yaw) for t, yaw in ((10.0, 3.1), (11.0, -3.1))]
    rows = swing_rows(watched(np.arange(10.0, 11.0, 0.02)), [report(10.5)], around, (1.0, 0.0, 0.0))
    assert rows.rel_m[0] - (0.5, 0.2) == pytest.approx((-1.0, 0.0), abs=1e-3)


def test_steps_that_nobody_watched_are_left_out(file: Path) -> None:
    times = np.concatenate([np.arange(10.0, 12.0, 0.02), np.arange(13.0, 15.0, 0.02)])
    reports = [report(9.5 + 0.01 * k) for k in range(600)]
    rows = swing_rows(watched(times), reports, attitudes(), ZERO)
    assert rows.t_s[0] >= 10.0
    assert rows.t_s[-1] <= 15.0
    assert not ((rows.t_s > 12.0) & (rows.t_s < 13.0)).any()
    rows.write(file)
    assert len(read(file)) == 2
    with pytest.raises(
        LogFormatError,
        match="no step of the flight was watched with a known thrust; expected t_boot_s on the autopilot",
    ):
        swing_rows(watched(times), [report(500.0)], attitudes(), ZERO)
    with pytest.raises(LogFormatError, match="no step of the flight was watched"):
        swing_rows(watched(times), [], attitudes(), ZERO)


def test_a_thrust_that_was_inferred_teaches_nothing() -> None:
    times = np.arange(10.0, 12.0, 0.02)
    reports = [replace(report(10.1 + 0.01 * k), thrust_known=k % 2 == 0) for k in range(10)]
    assert len(swing_rows(watched(times), reports, attitudes(), ZERO).t_s) == 5
    with pytest.raises(LogFormatError, match="with a known thrust"):
        swing_rows(watched(times), reports[1::2], attitudes(), ZERO)


@pytest.mark.parametrize("moving", [True, False])
def test_what_is_written_is_read_by_the_training(file: Path, moving: bool) -> None:
    reports = [report(10.1 + 0.01 * k, (math.sin(k), 0.2, -22.0)) for k in range(80)]
    rows = swing_rows(watched(np.arange(10.0, 11.0, 0.02), moving), reports, attitudes(), ZERO)
    rows.write(file)
    (segment,) = read(file)
    assert (segment.vel_load_mps is not None) is moving
    assert segment.force_ned_n[5] == pytest.approx((math.sin(5), 0.2, -22.0), abs=1e-5)
    np.testing.assert_allclose(segment.v_mps[10:-10], [[1.0, 0.0]] * (len(segment.t_s) - 20), atol=1e-3)


def test_only_a_load_on_a_taut_cable_counts(file: Path) -> None:
    rows = ["10.00,1,2,3,4,0,0,1,1", "10.02,1,2,3,4,0,0,0,1", "10.04,1,2,3,4,0,0,1,0", "10.06,1,,3,4,0,0,1,1",
            "10.08,5,2,3,4,0.5,0,1,1"]  # fmt: skip
    file.write_bytes(gzip.compress("\n".join([HEADER, *rows]).encode()))
    seen = read_watched(file)
    assert seen.t_boot_s.tolist() == [10.0, 10.08]
    assert seen.rel_m.tolist() == [[-2.0, -2.0], [2.0, -2.0]]
    assert seen.vel_mps is not None
    assert seen.vel_mps.tolist() == [[0.0, 0.0], [0.5, 0.0]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_boot_s,veh_n_m\n1,2\n", r"line 1: no column veh_e_m, load_n_m, load_e_m; expected t_boot_s, veh_n_m"),
        (f"{HEADER}\n2,0,0,0,0,0,0,1,1\n1,0,0,0,0,0,0,1,1\n", r"t_boot_s = 1.0 after 2.0; expected it to rise"),
        (f"{HEADER}\n1,0,x,0,0,0,0,1,1\n", r"line 2, column 3: 'x'; expected a number"),
    ],
)
def test_what_is_no_such_table_is_refused(file: Path, text: str, said: str) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(LogFormatError, match=said):
        read_watched(file)
