"""Files of RaceLogic's VBOX."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.place import logs_of
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError

TITLES = ["satellites", "time", "latitude", "longitude", "velocity kmh", "heading", "height", "YawRate", "Lat_Acc"]
NAMES = "sats time lat long velocity heading height YawRate Lat_Acc"
ROWS = [
  "011 235959.50 +3127.4100000 +0061.9260000 036.000 090.00 +00122.40 +1.500000E+00 -2.0E-02",
  "011 000000.00 +3127.4100000 +0061.9255000 036.000 090.00 +00122.40 +1.600000E+00 -1.0E-02",
  "011 000000.50 -3127.4100000 -0061.9250000 036.000 359.50 +00122.40 +1.700000E+00 +0.0E+00",
]


def vbo(path, rows=ROWS, titles=TITLES, units=("deg/s", "g"), names=NAMES):
  lines = ["File created on 14/05/2024 at 10:12:13", "", "[header]", *titles, "", "[channel units]", *units, ""]
  lines += ["[comments]", "Log Rate (Hz) : 2.00", "", "[column names]", names, "", "[data]", *rows]
  path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")
  return path


def test_places_are_in_degrees_to_the_east_and_time_goes_on_over_midnight(tmp_path):
  table = read_table(vbo(tmp_path / "VBOX0001.VBO"))
  np.testing.assert_array_equal(table.columns["time [s]"], [86399.5, 86400.0, 86400.5])
  np.testing.assert_allclose(table.columns["latitude [deg]"], np.array([1, 1, -1]) * 3127.41 / 60.0)
  np.testing.assert_allclose(table.columns["longitude [deg]"], [-61.926 / 60.0, -61.9255 / 60.0, 61.925 / 60.0])
  assert table.columns["velocity [km/h]"][0] == 36.0 and table.columns["gps.heading [deg]"][2] == 359.5
  assert table.columns["YawRate [deg/s]"].tolist() == [1.5, 1.6, 1.7] and table.columns["Lat_Acc [g]"][0] == -0.02
  assert not table.notes


def test_units_are_of_the_last_channels_and_a_title_has_its_own(tmp_path):
  titles = [*TITLES[:4], "velocity knots", *TITLES[5:]]
  table = read_table(vbo(tmp_path / "a.vbo", titles=titles, units=["g"]))
  assert "velocity [knots]" in table and "YawRate" in table and "Lat_Acc [g]" in table
  table = read_table(vbo(tmp_path / "b.vbo", units=["(null)", "g"]))
  assert "YawRate" in table and "Lat_Acc [g]" in table


def test_titles_name_columns_without_names(tmp_path):
  table = read_table(vbo(tmp_path / "a.vbo", names=""))
  assert {"time [s]", "longitude [deg]", "velocity [km/h]", "YawRate [deg/s]"} <= set(table.columns)


def test_columns_of_words_and_a_last_row_that_is_cut_off_are_left_out_with_a_note(tmp_path):
  rows = [f"{row} on" for row in ROWS] + ["011 000001.00 +3127.41"]
  table = read_table(vbo(tmp_path / "a.vbo", rows, [*TITLES, "mode"], (), f"{NAMES} mode"))
  assert table.rows == 3 and "mode" not in table
  assert table.notes == (
    "a.vbo: column 'mode' holds no numbers; left out",
    "a.vbo: row 4 has 3 cells where [column names] has 10 ('011 000001.00 +3127.41'); left out",
  )


@pytest.mark.parametrize(
  ("row", "said"),
  [
    (ROWS[1].replace("036.000", "0x6"), r"a.vbo: column 'velocity' has '0x6' in row 2, which is not a number; correct"),
    (ROWS[1].replace("036.000", "0_6"), "'0_6' in row 2"),
    (ROWS[1][:30], r"a.vbo: a row does not fit its names: row 2 has 4 cells where .* has 9 .*; repair or delete it"),
    (ROWS[1].replace("000000.00", "247000.00"), "a.vbo: time is 247000 in row 2, which is no time of day HHMMSS.ss"),
    (ROWS[1].replace("+3127.4", "+6127.4"), "a.vbo: latitude is 6127.41 in row 2, and .* at most 5400"),
  ],
)
def test_a_bad_row_is_refused_by_its_number(tmp_path, row, said):
  with pytest.raises(RecordingError, match=said):
    read_table(vbo(tmp_path / "a.vbo", [ROWS[0], row, ROWS[2]]))


@pytest.mark.parametrize(
  ("text", "said"),
  [
    ("time,speed\n0,1\n", r"a.vbo: is no VBOX file: it has no section \[data\]; write it again"),
    ("[data]\n1 2\n", r"a.vbo: names no columns; add a section \[column names\]"),
    ("[column names]\ntime\n[data]\n1\n[data]\n1\n", r"a.vbo: has \[data\] twice"),
    ("[column names]\ntime velocity\n[data]\na b\n", r"a.vbo: \[data\] holds no numbers; write it again"),
    ("[column names]\ntime velocity\n[data]\n", "a.vbo: has column names but no rows"),
  ],
)
def test_what_is_none_is_refused(tmp_path, text, said):
  (tmp_path / "a.vbo").write_text(text, encoding="utf-8")
  with pytest.raises(RecordingError, match=said):
    read_table(tmp_path / "a.vbo")


def drive(seconds=60.0, rate=20.0):
  """Rows of a car that mostly goes straight on; its gyro and its force count to the right."""
  rows, x, y, yaw = [], 0.0, 0.0, 0.3
  for k in range(int(seconds * rate)):
    t = k / rate
    speed = 10.0 + 3.0 * np.sin(0.4 * t)
    turning = 0.3 * np.sin(0.9 * t) * (t > 0.7 * seconds)
    yaw += turning / rate
    x, y = x + speed * np.cos(yaw) / rate, y + speed * np.sin(yaw) / rate
    place = f"{3127.41 + y / 1854.7:+.7f} {61.926 - x / 1141.9:+.7f}"
    heading = np.degrees(0.5 * np.pi - yaw) % 360.0
    motion = f"{3.6 * speed:.3f} {heading:.2f} +00122.40 {-np.degrees(turning):.6E} {-speed * turning / 9.80665:.6E}"
    wheel = np.degrees(15.0 * 2.6 * turning / speed)
    rows.append(f"011 1012{t:05.2f} {place} {motion} {wheel:.6E} {20.0 + 5.0 * np.cos(0.4 * t):.3f}")
  return rows


def test_a_gyro_that_counts_to_the_right_is_told_by_the_compass(tmp_path):
  names, titles = f"{NAMES} Steering_Wheel_Angle Accelerator_Pedal", [*TITLES, "Steering", "Pedal"]
  path = vbo(tmp_path / "run.vbo", drive(), titles, ("deg/s", "g", "deg", "%"), names)
  assert logs_of([tmp_path]) == [path]
  (tmp_path / "dataset.toml").write_text(propose("car", [read_table(path)]).text, encoding="utf-8")
  runs = DataSet.load(tmp_path).recordings
  for run in runs:
    middles = run["pose_yaw"].time[1:-1]
    turned = np.gradient(run["pose_yaw"].value, run["pose_yaw"].time)[1:-1]
    np.testing.assert_allclose(run["yaw_rate"].interpolate(middles), turned, atol=0.1)
    assert np.ptp(run["pose_x"].value) > 10.0
