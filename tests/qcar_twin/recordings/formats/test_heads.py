"""What stands above the numbers: motion capture's bodies and units, a stated rate, units and comments of names."""

import numpy as np
import pytest

from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.text.heads import stated_rate

STEPS = [(k, k / 50) for k in range(60)]
MOTIVE = [
  "Format Version,1.23,Take Name,a,Capture Frame Rate,100.0,Export Frame Rate,50.0,Capture Start Time,"
  "2024-02-03 01.02.03.500 PM,Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
  "",
  ",Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body Marker",
  ",Name,buggy,buggy,buggy,buggy,buggy,buggy,buggy,buggy,buggy:Marker1",
  ",ID,11,11,11,11,11,11,11,11,12",
  "",
  ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position",
  "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X",
]
VICON = ["Objects", "50", ",,buggy,,,other,,", "Frame,Sub Frame,RX,RY,TX,RX,RY,TX", ",,rad,rad,mm,rad,rad,mm"]


def read(tmp_path, lines, name="log.csv", encoding="utf-8"):
  (tmp_path / name).write_text("\n".join(lines) + "\n", encoding=encoding)
  return read_table(tmp_path / name)


def motive(**instead):
  head = list(MOTIVE)
  for old, new in instead.items():
    head[0] = head[0].replace(old, new)
  return [*head, *(f"{k},{t:.6f},0,{np.sin(t):.6f},0,{np.cos(t):.6f},1.5,2,3,0.1,7" for k, t in STEPS)]


def test_motives_columns_are_called_by_body_kind_and_axis_with_their_unit(tmp_path):
  table = read(tmp_path, motive())
  assert list(table.columns)[:11] == [
    "Frame", "Time (Seconds)", "buggy.Rotation.X", "buggy.Rotation.Y", "buggy.Rotation.Z", "buggy.Rotation.W",
    "buggy.Position.X [mm]", "buggy.Position.Y [mm]", "buggy.Position.Z [mm]", "buggy.Mean Marker Error [mm]",
    "buggy:Marker1.Position.X [mm]",
  ]  # fmt: skip
  assert table.rows == 60 and set(table.columns["buggy.Position.X [mm]"]) == {1.5}
  np.testing.assert_allclose(table.columns["buggy.Rotation.yaw"], 2.0 * np.arange(60) / 50, atol=1e-5)


def test_an_older_motives_rows_are_not_called_by_what_they_are(tmp_path):
  unnamed = [line.removeprefix(",Type").removeprefix(",Name").removeprefix(",ID") for line in motive()]
  older = [f",{line}" if line != named else line for line, named in zip(unnamed, motive(), strict=True)]
  assert list(read(tmp_path, older).columns) == list(read(tmp_path, motive(), "b.csv").columns)


def test_motives_clock_counts_from_when_the_take_began(tmp_path):
  began = 1706965323.5  # date -ud '2024-02-03 13:02:03.5' +%s.%1N
  np.testing.assert_allclose(read(tmp_path, motive()).columns["Time (Seconds)"], began + np.arange(60) / 50)
  undated = read(tmp_path, motive(**{"2024-02-03 01.02.03.500 PM": ""}))
  np.testing.assert_allclose(undated.columns["Time (Seconds)"], np.arange(60) / 50)


def test_motives_other_units_and_eulers_angles(tmp_path):
  table = read(tmp_path, motive(Millimeters="Meters", Quaternion="XYZ"))
  assert {"buggy.Position.X [m]", "buggy.Rotation.X [deg]"} <= set(table.columns)


def test_vicons_columns_are_called_by_subject_and_its_rate_gives_the_clock(tmp_path):
  table = read(tmp_path, [*VICON, *(f"{k + 5},0,0,0,{k},0,0,9" for k, _ in STEPS)])
  assert {"buggy.RX [rad]", "buggy.TX [mm]", "other.RX [rad]", "other.TX [mm]"} <= set(table.columns)
  assert set(table.columns["other.TX [mm]"]) == {9.0}
  np.testing.assert_allclose(table.columns["time by Frame at 50 Hz [s]"], np.arange(5, 65) / 50)


@pytest.mark.parametrize(
  ("line", "rate"),
  [
    ("# rate: 100 Hz", 100.0),
    ('"Sample Rate","100.000","Hz"', 100.0),
    ("sampling frequency = 0.2 kHz", 200.0),
    ("fs=50", 50.0),
    ("% Abtastrate: 12,5 Hz", 12.5),
    ("Sample Rate [Hz];250", 250.0),
    ("baud rate: 9600", None),
    ("GPS rate: 10 Hz", None),
    ("rate: 100 ms", None),
    ("the rate of 5 cars", None),
  ],
)
def test_a_rate_is_that_of_the_rows(line, rate):
  assert stated_rate([line]) == rate


def test_two_stated_rates_are_none():
  assert stated_rate(["rate: 50 Hz", "sample rate: 100 Hz"]) is None
  assert stated_rate(["rate: 50 Hz", "sample rate: 50 Hz"]) == 50.0


def test_a_counter_is_a_clock_by_a_stated_rate_and_lost_samples_are_gaps(tmp_path):
  rows = [f"{k + (k > 30) * 5},{k % 3},1.5" for k, _ in STEPS]
  table = read(tmp_path, ["# rate: 50 Hz", "sample,throttle,speed", *rows])
  time = table.columns["time by sample at 50 Hz [s]"]
  np.testing.assert_allclose(time[[0, 30, 31]], [0.0, 0.6, 0.72])
  without = read(tmp_path, ["# rate: 50 Hz", "throttle,speed", *(f"{k % 3},1.5" for k, _ in STEPS)])
  np.testing.assert_allclose(without.columns["time by row at 50 Hz [s]"], np.arange(60) / 50)


@pytest.mark.parametrize("clock", ["time", "Zeit", "elapsed", "stamp [ms]"])
def test_a_stated_rate_makes_no_clock_beside_one(tmp_path, clock):
  rows = [f"{k},{t},{k % 3}" for k, t in STEPS]
  assert list(read(tmp_path, ["# rate: 40 Hz", f"sample,{clock},speed", *rows]).columns) == ["sample", clock, "speed"]


def test_units_below_the_names_outweigh_what_a_name_seems_to_end_with(tmp_path):
  rows = [f"{t},{k % 3},20,{k},3" for k, t in STEPS]
  table = read(tmp_path, ["t,v_Rad,temp,motor_rpm,Status", "s,km/h,°C,rpm,-", *rows])
  assert list(table.columns) == ["t [s]", "v_Rad [km/h]", "temp [°C]", "motor_rpm", "Status"]


def test_names_and_units_in_comments(tmp_path):
  rows = [f"  {t:.2f}   {k % 3}   1.5" for k, t in STEPS]
  table = read(tmp_path, ["# made by a logger", "# t gas v", "# s % m/s", *rows], "log.dat")
  assert list(table.columns) == ["t [s]", "gas [%]", "v [m/s]"] and table.rows == 60
  assert list(read(tmp_path, ["# three words here", "# t gas v", *rows], "log.dat").columns) == ["t", "gas", "v"]


def test_labviews_head_of_two_parts(tmp_path):
  head = ["LabVIEW Measurement\t", "Separator\tTab", "Decimal_Separator\t,", "***End_of_Header***\t", "\t"]
  head += ["Channels\t2\t", "Samples\t60\t\t", "***End_of_Header***\t\t", "X_Value\tLenkung (°)\tGas (%)\tComment"]
  rows = [f"{t:.2f}\t{k % 3},5\t1,0\t".replace(".", ",") for k, t in STEPS]
  table = read(tmp_path, [*head, *rows], "log.lvm", "latin1")
  assert list(table.columns) == ["X_Value", "Lenkung (°)", "Gas (%)", "Comment"]
  np.testing.assert_allclose(table.columns["X_Value"], np.arange(60) / 50)


def test_words_of_a_serial_port_above_a_header_and_a_torn_row(tmp_path):
  rows = [f"{20 * k} {k % 3} 1500" for k in range(400)]
  lines = ["Starting...", "IMU found it", "ms gas servo", *rows[:250], "50 15", *rows[250:]]
  table = read(tmp_path, lines, "log.txt")
  assert list(table.columns) == ["ms", "gas", "servo"] and table.rows == 400
  assert table.notes == ("log.txt: row 251 has 2 cells where the header has 3 ('50 15'); left out",)
