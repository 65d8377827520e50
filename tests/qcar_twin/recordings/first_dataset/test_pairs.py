"""Drives whose commands and motion capture lie in files of their own: who belongs together, and how clocks lie."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.joined import joined
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError
from scripts import new
from tests import ROOT
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import write_csv
from tests.qcar_twin.recordings.first_dataset.pairs import sample_columns, write_pair

EPOCH = 1.7e9
NAMES = ("free_drive_a", "free_drive_b", "excitation_a")
DRIVES = [sample_columns(ROOT / "data" / "sample" / f"{name}.csv") for name in NAMES]


def made(folder) -> DataSet:
  new.main(new.Config(folder / "lab", (folder / "logs",), wheelbase=0.256, mass=2.4))
  return DataSet.load(folder / "lab")


@pytest.mark.parametrize("shift", [0.0, -1.7, 2.3, -1764200000.0])
def test_each_drive_gets_its_own_capture_by_their_names(tmp_path, capsys, shift):
  for number, (time, columns) in enumerate(DRIVES, 1):
    write_pair(tmp_path / "logs", f"run{number}", time, columns, shift)
  data = made(tmp_path)
  said = capsys.readouterr().out
  assert "run2.csv, run2_mocap.csv: parts of one drive by their names, joined by their" in said
  assert sorted(p.name for p in (tmp_path / "lab").glob("*.csv")) == [f"run{n}_joined.csv" for n in (1, 2, 3)]
  for run, (time, columns) in zip(data.recordings, DRIVES, strict=True):
    known = np.isfinite(columns["pose_x"])
    seen = run["pose_x"].interpolate(time[known][5:-5] - run.origin[0])
    np.testing.assert_allclose(np.diff(seen), np.diff(columns["pose_x"][known][5:-5]), atol=0.03)


def test_names_that_differ_in_more_go_by_the_motion(tmp_path, capsys):
  for name, take, (time, columns) in zip("abc", ("take", "retake", "other"), DRIVES, strict=True):
    write_pair(tmp_path / "logs", name, time, columns, 0.4, capture=take)
  made(tmp_path)
  assert "b.csv, retake.csv: parts of one drive by their motion" in capsys.readouterr().out


def test_a_date_that_all_files_of_a_kind_have_names_no_drive(tmp_path, capsys):
  """The 3 of a date is in every name, and the third drive's file has no other 3 to go by."""
  for number, (time, columns) in enumerate(DRIVES, 1):
    write_pair(tmp_path / "logs", f"LOG{number}", time, columns, capture=f"Session on 03-05 at 15-{15 * number}")
  made(tmp_path)
  assert "parts of one drive by their names" not in capsys.readouterr().out


def test_a_name_against_the_motion_is_refused_and_renaming_cures_it(tmp_path):
  for number, (time, columns) in enumerate(DRIVES, 1):
    write_pair(tmp_path / "logs", f"run{number}", time, columns, capture=f"run{number % 3 + 1}_mocap")
  with pytest.raises(
    RecordingError, match=r"run1_mocap.csv: goes with run1.csv by its name, and by its motion with run3"
  ):
    made(tmp_path)
  for number in (1, 2, 3):
    (tmp_path / "logs" / f"run{number % 3 + 1}_mocap.csv").rename(tmp_path / "logs" / f"run{number}_seen.csv")
  assert len(made(tmp_path).recordings) == 3


def test_a_drive_without_a_capture_is_read_alone_and_a_capture_without_a_drive_left_out(tmp_path, capsys):
  for number, (time, columns) in enumerate(DRIVES, 1):
    write_pair(tmp_path / "logs", f"run{number}", time, columns)
  (tmp_path / "logs" / "run2_mocap.csv").unlink()
  (tmp_path / "logs" / "run3.csv").unlink()
  data = made(tmp_path)
  said = capsys.readouterr().out
  assert "run2.csv: is read alone" in said and "run3_mocap.csv: left out, no file of commands" in said
  assert ["pose_x" in run for run in data.recordings] == [True, False]


def test_what_nothing_tells_is_refused_with_names_that_would(tmp_path):
  time, columns = DRIVES[0]
  for name, take in zip("ab", ("take", "retake"), strict=True):
    write_pair(tmp_path / "logs", name, time, columns, capture=take)
  with pytest.raises(RecordingError, match="run1_car.csv and run1_mocap.csv"):
    made(tmp_path)


def test_drives_in_another_language_are_no_parts_of_one(tmp_path):
  """Their columns are known by their units alone, and are the same in every file."""
  names = {"motor_voltage": "Spannung [V]", "steering_command": "Winkel [rad]", "speed": "Tempo [m/s]"}
  for file, (time, columns) in zip("ab", DRIVES, strict=False):
    own = {**columns, "speed": 0.0033 * columns["motor_speed"]}
    write_csv(tmp_path / f"{file}.csv", time, {names[k]: own[k] for k in names} | {"Gierrate [rad/s]": own["yaw_rate"]})
  tables = [read_table(tmp_path / f"{file}.csv") for file in "ab"]
  assert joined(tables).made == ()


@pytest.mark.parametrize(("car", "capture"), [("pi_take{}", "Take {}"), ("log{}_car", "OptiTrack_00{}")])
def test_files_of_two_programs_are_paired_by_their_numbers(tmp_path, car, capture):
  """The car's clock is a date, and motion capture's begins with each take."""
  for number in (1, 2):
    time, columns = wander(number, seconds=30.0)
    write_pair(tmp_path, car.format(number), EPOCH + 60.0 * number + time, columns)
    path = tmp_path / f"{car.format(number)}_mocap.csv"
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    start = EPOCH + 60.0 * number + 0.05
    cells = [row.split(",", 1) for row in rows]
    text = "\n".join([head, *(f"{float(stamp) - start!r},{rest}" for stamp, rest in cells), ""])
    (tmp_path / f"{capture.format(number)}.csv").write_text(text, encoding="utf-8")
    path.unlink()
  drives = joined([read_table(path, path.name) for path in sorted(tmp_path.glob("*.csv"))])
  assert len(drives.made) == 2 and all("by their names, joined by their motion" in line for line in drives.said[:2])
  for number, table in enumerate(drives.made, 1):
    place = next(name for name in table.columns if name.endswith(".x"))
    seen = table.columns["time"][np.isfinite(table.columns[place])]
    assert seen[0] == pytest.approx(EPOCH + 60.0 * number + 0.05, abs=0.1)
