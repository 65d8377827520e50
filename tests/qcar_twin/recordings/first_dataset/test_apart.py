"""One table for each run of a file whose clock begins again, and folders in which text may be a log or a note."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.apart import runs_apart
from qcar_twin.recordings.first_dataset.place import logs_of
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError
from scripts import new
from tests.qcar_twin.recordings.drives import drive


def table(time, **columns):
  values = {"time": np.asarray(time, dtype=float), **{k: np.asarray(v) for k, v in columns.items()}}
  return Table("day/log.csv", values, {})


TWICE = np.r_[np.arange(120.0), np.arange(80.0)] / 50.0


def test_a_clock_that_begins_again_begins_a_run():
  speed = np.arange(200.0)
  runs = runs_apart([table(TWICE, speed=speed)])
  assert [each.label for each in runs.made] == ["day/log_1.csv", "day/log_2.csv"] and runs.tables == runs.made
  np.testing.assert_array_equal(runs.tables[1].columns["speed"], speed[120:])
  assert runs.said == ("day/log.csv: its clock begins again in row 121; read as 2 runs",)


@pytest.mark.parametrize(("column", "called"), [("run_id", ["A_1", "B"]), ("driver", ["1", "2"])])
def test_runs_are_called_after_the_column_that_says_run(column, called):
  runs = runs_apart([table(TWICE, speed=np.arange(200.0), **{column: np.array(["A 1"] * 120 + ["B"] * 80, object)})])
  assert [each.label for each in runs.made] == [f"day/log_{name}.csv" for name in called]


def test_a_column_that_changes_within_a_run_names_none():
  runs = runs_apart([table(TWICE, speed=np.arange(200.0), run=np.arange(200.0) // 7)])
  assert [each.label for each in runs.made] == ["day/log_1.csv", "day/log_2.csv"]


@pytest.mark.parametrize(
  "time",
  [
    np.arange(200.0) / 50.0,
    np.r_[np.arange(120.0), np.arange(60.0, 140.0)] / 50.0,  # to the middle, 1.2 s after the start
    np.r_[np.arange(195.0), np.arange(5.0)] / 50.0,  # for a few rows
  ],
  ids=["one run", "set back", "a few rows"],
)
def test_other_clocks_stay_whole(time):
  own = table(time, speed=np.arange(200.0))
  assert runs_apart([own]).tables == (own,) and not runs_apart([own]).made


def write(path, names, rows):
  path.parent.mkdir(parents=True, exist_ok=True)
  path.write_text("\n".join([names, *(" ".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n")


def test_new_writes_each_run_and_copies_the_other_logs(tmp_path, capsys):
  time, own = drive(6.0)
  names = ("motor_voltage", "motor_speed", "yaw_rate")
  rows = np.stack([time, *(own[name] for name in names)], axis=1)
  write(tmp_path / "logs" / "one.dat", " ".join(["time", *names]), rows)
  # faster and stronger, as drives of their own are
  write(tmp_path / "logs" / "two.dat", " ".join(["time", *names]), np.r_[rows * 1.1, rows[: time.size // 2] * 1.2])
  (tmp_path / "logs" / "notes.txt").write_text("rain\n" * 40)
  path = new.main(new.Config(tmp_path / "set", (tmp_path / "logs",)))
  said = capsys.readouterr().out
  assert "left out: notes.txt (name notes.txt itself if it is a log)" in said
  assert sorted(each.name for each in path.parent.iterdir()) == ["dataset.toml", "one.dat", "two_1.csv", "two_2.csv"]
  assert len(DataSet.load(path.parent).recordings) == 3
  assert f"two.dat: its clock begins again in row {time.size + 1}; read as 2 runs" in said


ROWS = [f"{20 * k} {k % 3} 1500" for k in range(60)]


@pytest.mark.parametrize("name", ["a.txt", "a.dat", "a.lvm", "a.log", "a.asc", "a.tab", "a.prn"])
def test_a_text_that_is_a_table_of_samples_is_a_log(tmp_path, name):
  (tmp_path / name).write_text("\n".join(["Starting...", "ms gas servo", *ROWS]))
  assert logs_of([tmp_path]) == [tmp_path / name]


@pytest.mark.parametrize(
  "lines",
  [
    ["The car, its wheels and 1 or 2 words."] * 60,
    ["ms gas servo", *ROWS[:10]],
    ["mass 2.7", "wheelbase 0.26"] * 15,
    ["a b", *(f"{k % 7} {k % 5}" for k in range(60))],  # numbers of nothing that is a channel, in no time
  ],
  ids=["prose", "few rows", "a list", "no clock and no channel"],
)
def test_a_note_is_left_out_and_said_and_is_read_where_it_is_named(tmp_path, capsys, lines):
  (tmp_path / "notes.txt").write_text("\n".join(lines))
  (tmp_path / "a.csv").write_text("time,speed\n0,1\n")
  (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8")
  assert logs_of([tmp_path]) == [tmp_path / "a.csv"]
  assert "left out: notes.txt, photo.jpg (name notes.txt itself if it is a log)" in capsys.readouterr().out
  assert logs_of([tmp_path / "notes.txt"]) == [tmp_path / "notes.txt"]


def test_a_folder_of_notes_holds_no_log(tmp_path):
  (tmp_path / "notes.txt").write_text("rain")
  with pytest.raises(RecordingError, match=r"holds no log but notes.txt \(name notes.txt itself if it is a log\)"):
    logs_of([tmp_path])


def test_an_autopilots_log_among_others_is_one(tmp_path):
  lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns", "FMT, 1, 9, IMU, Qf, TimeUS,GyrZ"]
  (tmp_path / "7.log").write_text("\n".join([*lines, *(f"IMU, {1000 * k}, {k % 5}" for k in range(50))]))
  assert logs_of([tmp_path]) == [tmp_path / "7.log"]
