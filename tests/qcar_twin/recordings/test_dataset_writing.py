"""Data sets written: what comes back is what went in, and nothing is half-written."""

import os

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset, write_recording
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from tests.qcar_twin.recordings.drives import STD, VEHICLE, drive, folder_with, recording


def test_what_is_written_comes_back_exactly(tmp_path):
  first = recording("straight_1", session="2024-08-30", manoeuvre="voltage_step")
  time = np.sort(np.random.default_rng(3).uniform(0.0, 7.0, 900)) + 1.7e9
  second = Recording(
    "äöü #2",
    {
      "motor_voltage": Stream(time[::9], np.random.default_rng(4).normal(size=100) / 3.0),
      "speed": Stream(time, np.random.default_rng(5).normal(size=900) * 1e-3),
    },
    role="holdout",
  )
  folder = write_dataset(
    tmp_path / "new" / "set",
    'a "quoted" name',
    VEHICLE,
    STD,
    [first, second],
    description="two\nlines \\ \x7f",
    command_timing="unknown",
    licence="MIT",
    source="here",
  )
  data = DataSet.load(folder)
  assert (data.name, data.description, data.command_timing) == ('a "quoted" name', "two\nlines \\ \x7f", "unknown")
  assert (data.licence, data.source) == ("MIT", "here")
  assert data.vehicle == VEHICLE and data.vehicle_std == STD
  for before, after in zip((first, second), data.recordings, strict=True):
    assert (before.name, before.role, before.manoeuvre, before.session) == (
      after.name,
      after.role,
      after.manoeuvre,
      after.session,
    )
    assert before.channels == after.channels
    for channel in before.channels:
      assert (before[channel].time == after[channel].time + after.origin[0]).all() and (
        before[channel].value == after[channel].value
      ).all()


def test_pieces_of_a_cut_recording_can_be_written_and_read(tmp_path):
  time, columns = drive()
  cut = DataSet.load(folder_with(tmp_path, np.where(time < 5.0, time, time + 3.0), columns))
  write_dataset(tmp_path / "copy", "copy", cut.vehicle, cut.vehicle_std, cut.recordings)
  assert [run.name for run in DataSet.load(tmp_path / "copy").recordings] == ["run#1", "run#2"]


def test_writing_again_replaces_and_leaves_other_files_alone(tmp_path):
  (tmp_path / "truth.toml").write_text("sealed")
  write_dataset(tmp_path, "one", VEHICLE, STD, [recording("a")])
  write_dataset(tmp_path, "two", VEHICLE, STD, [recording("a", seed=9)])
  assert DataSet.load(tmp_path).name == "two"
  assert sorted(os.listdir(tmp_path)) == ["a.csv", "dataset.toml", "truth.toml"]


@pytest.mark.parametrize(
  "change, text",
  [
    ({"recordings": ()}, "lists no recordings"),
    ({"recordings": "twice"}, "two recordings have one name, 'a'"),
    ({"recordings": "slash"}, "recording name '../a' cannot be a file name"),
    ({"command_timing": "before"}, "unknown command_timing 'before'; valid are: after_measurement, unknown"),
    ({"vehicle": VEHICLE | {"mass": -1.0}}, "[vehicle] mass must be positive, not -1"),
    ({"vehicle": VEHICLE | {"mass": float("nan")}}, "[vehicle] mass must be a finite number"),
    ({"vehicle_std": {"mass": 0.0}}, "[vehicle.std] mass must be positive"),
  ],
)
def test_a_refused_write_changes_nothing(tmp_path, change, text):
  runs = {"twice": [recording("a"), recording("a")], "slash": [recording("../a")]}
  given = {"name": "lab", "vehicle": VEHICLE, "vehicle_std": STD, "recordings": [recording("a")]} | change
  if isinstance(given["recordings"], str):
    given["recordings"] = runs[given["recordings"]]
  with pytest.raises(RecordingError) as caught:
    write_dataset(tmp_path / "new", **given)
  assert text in str(caught.value)
  assert not (tmp_path / "new").exists()


def test_an_interrupted_write_leaves_the_old_data_set_whole(tmp_path, monkeypatch):
  write_dataset(tmp_path, "old", VEHICLE, STD, [recording("a")])
  before = (tmp_path / "a.csv").read_bytes()
  monkeypatch.setattr(
    "qcar_twin.recordings.dataset_writer.write_recording", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
  )
  with pytest.raises(KeyboardInterrupt):
    write_dataset(tmp_path, "new", VEHICLE, STD, [recording("a", seed=5)])
  assert (tmp_path / "a.csv").read_bytes() == before and DataSet.load(tmp_path).name == "old"
  assert sorted(os.listdir(tmp_path)) == ["a.csv", "dataset.toml"]


def test_what_stopped_a_write_half_way_is_what_is_told(tmp_path, monkeypatch):
  replace = os.replace

  def filling_up(source, target):
    if str(target).endswith("dataset.toml"):
      raise OSError("disk full")
    replace(source, target)

  monkeypatch.setattr(os, "replace", filling_up)
  with pytest.raises(OSError, match="disk full"):
    write_dataset(tmp_path / "new", "new", VEHICLE, STD, [recording("a")])


def test_one_recording_can_be_written_as_csv(tmp_path):
  run = Recording("a", {"motor_voltage": Stream([0.0, 0.3], [1.0, 2.0]), "speed": Stream([0.1, 0.3], [0.5, 1 / 3])})
  path = write_recording(tmp_path / "a.csv", run)
  assert path.read_text() == "time,motor_voltage,speed\n0.0,1.0,\n0.1,,0.5\n0.3,2.0,0.3333333333333333\n"


def test_a_csv_that_cannot_be_written_leaves_no_temporary_file(tmp_path, monkeypatch):
  monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
  with pytest.raises(OSError, match="disk full"):
    write_recording(tmp_path / "a.csv", recording())
  assert list(tmp_path.iterdir()) == []
