import gzip

import numpy as np
import pytest

from swingd.model.errors import LogFormatError
from swingd.record.truth import read_truth

PX4 = (
    "t_boot_s,swing_lateral_rad,swing_longitudinal_rad,swing_lateral_rate_rad_s,swing_longitudinal_rate_rad_s,"
    "tension_n,attached,taut\n"
    "1.00,0.1,-0.2,0.3,-0.4,5,1,1\n"
    "1.01,0.1,-0.2,0.3,-0.4,0,1,0\n"
    "1.02,nan,nan,nan,nan,0,0,0\n"
    "1.03,0.2,-0.3,0.3,-0.4,5,1,1\n"
)


@pytest.mark.parametrize("packed", [False, True])
def test_truth_is_valid_where_the_load_hangs_on_a_taut_cable(tmp_path, packed):
    path = tmp_path / "truth.csv.gz"
    path.write_bytes(gzip.compress(PX4.encode()) if packed else PX4.encode())
    truth = read_truth(path)
    assert truth.t_boot_s.tolist() == [1.0, 1.01, 1.02, 1.03]
    assert truth.valid.tolist() == [True, False, False, True]
    assert (truth.xi_rad[0], truth.zeta_rad[0]) == (0.1, -0.2)
    assert (truth.xi_rate_radps[0], truth.zeta_rate_radps[0]) == (0.3, -0.4)
    assert read_truth(path, start_s=1.01).valid.tolist() == [False, False, False, True]
    assert read_truth(path, end_s=1.02).valid.tolist() == [True, False, False, False]


def test_swingds_own_columns(tmp_path):
    path = tmp_path / "truth.csv"
    path.write_text("xi_rad,t_boot_s,zeta_rad,zeta_rate_radps,xi_rate_radps\n0.1,1,0.2,0.4,0.3\n0.5,2,,0.4,0.3\n")
    truth = read_truth(path)
    assert (truth.xi_rad[0], truth.zeta_rad[0], truth.xi_rate_radps[0], truth.zeta_rate_radps[0]) == (
        0.1,
        0.2,
        0.3,
        0.4,
    )
    assert truth.valid.tolist() == [True, False]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "line 1: no column t_boot_s, xi_rad"),
        ("a,b\n1,2\n", "line 1: no column t_boot_s, xi_rad"),
        (PX4.replace("swing_longitudinal_rad,", "x,"), "line 1: no column swing_longitudinal_rad;"),
        (PX4.splitlines()[0], "no rows"),
        (PX4 + "1.04,1\n", "line 6: 2 cells; expected 8"),
        (PX4 + "1.04,a bc,0,0,0,0,1,1\n", "line 6, column 2: 'a bc'; expected a number"),
        (PX4 + "1.03,0,0,0,0,0,1,1\n", "row 5: t_boot_s = 1.03; expected more than in the row before"),
        (PX4 + "nan,0,0,0,0,0,1,1\n", "row 5: t_boot_s = nan"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, text, expected):
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(LogFormatError) as error:
        read_truth(path)
    assert str(path) in str(error.value)
    assert expected in str(error.value)


def damaged_gzip() -> bytes:
    packed = bytearray(gzip.compress(1000 * b"abc", mtime=0))
    packed[14] ^= 0xFF
    return bytes(packed)


@pytest.mark.parametrize("line_end", ["\r", "\r\n"])
def test_lines_may_end_as_on_any_system(tmp_path, line_end):
    path = tmp_path / "truth.csv"
    path.write_bytes(PX4.replace("\n", line_end).encode())
    assert read_truth(path).t_boot_s.tolist() == [1.0, 1.01, 1.02, 1.03]


def test_a_cell_without_an_end_is_refused(tmp_path):
    path = tmp_path / "truth.csv"
    path.write_text(PX4 + '"' + 200_000 * "1")
    with pytest.raises(LogFormatError, match=r"line \d+: field larger than field limit"):
        read_truth(path)


@pytest.mark.parametrize(
    "data", [b"\xff\xfe\x00", b"\x1f\x8bgarbage", gzip.compress(PX4.encode(), mtime=0)[:-20], damaged_gzip()]
)
def test_files_that_are_no_text_are_refused(tmp_path, data):
    path = tmp_path / "truth.csv.gz"
    path.write_bytes(data)
    with pytest.raises(LogFormatError, match=r"truth\.csv\.gz"):
        read_truth(path)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "start_s", "end_s", "peaks_deg", "rms_deg"),
    [("dev_1", 17.76, 104.27, (37.9, 38.0), (8.89, 8.97)), ("dev_2", 17.85, 115.5, (39.7, 39.2), (10.76, 9.57))],
)
def test_px4_sitl_statistics_agree_with_its_description(flight_data, name, start_s, end_s, peaks_deg, rms_deg):
    truth = read_truth(flight_data(f"px4_sitl/{name}_truth.csv.gz"), start_s, end_s)
    xi, zeta = np.degrees(truth.xi_rad[truth.valid]), np.degrees(truth.zeta_rad[truth.valid])
    assert (np.abs(xi).max(), np.abs(zeta).max()) == pytest.approx(peaks_deg, abs=0.06)
    assert (np.sqrt(np.mean(xi**2)), np.sqrt(np.mean(zeta**2))) == pytest.approx(rms_deg, abs=0.01)
    smooth = np.gradient(truth.xi_rad, truth.t_boot_s)[truth.valid]
    assert np.std(smooth - truth.xi_rate_radps[truth.valid]) < 0.02
