"""Poses that jump for good, flicker, stop and catch up."""

import numpy as np
import pytest

from qcar_twin.recordings.checks.jumps import without_jumps
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from tests.qcar_twin.recordings.drives import VEHICLE, drive, folder_with


def test_a_jump_for_good_cuts_the_recording(tmp_path):
  time, columns = drive()
  columns["pose_x"][700:] += 16.0
  columns["pose_y"][700:] -= 16.0
  data = DataSet.load(folder_with(tmp_path, time, columns))
  assert [(r.start, r.end) for r in data.recordings] == [(0.0, 6.99), (7.0, pytest.approx(11.99))]
  assert data.warnings == ("run.csv: the pose jumps by 22.6 m in 10 ms at 7 s; the recording is cut there",)


def test_single_wrong_poses_are_left_out(tmp_path):
  time, columns = drive()
  columns["pose_x"][[200, 201, 800]] += 5.0
  data = DataSet.load(folder_with(tmp_path, time, columns))
  (run,) = data.recordings
  assert (
    len(run["pose_x"]) == len(run["pose_yaw"]) == time.size - 3 and np.abs(np.diff(run["pose_x"].value)).max() < 0.1
  )
  assert data.warnings == ("run.csv: the pose jumps away and back, first at 2 s; wrong samples: 3, left out",)


def test_a_track_that_was_lost_and_catches_up_has_not_jumped(tmp_path):
  time, columns = drive()
  for name in ("pose_x", "pose_y"):
    columns[name][300:500] = columns[name][300]
  notes = DataSet.load(folder_with(tmp_path, time, columns)).warnings
  assert len(notes) == 1 and "pose_x, pose_y is frozen" in notes[0]


@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_a_wrong_pose_is_seen_by_the_longer_of_its_two_steps(ahead):
  """0.52 m along the way at 0.05 m a sample: one step is beyond ten times the usual, the other is not."""
  time = 0.1 * np.arange(100)
  along = 0.5 * time
  along[60] += ahead * 0.52
  streams = {"pose_x": Stream(time, along), "pose_y": Stream(time, np.zeros(100))}
  kept, jumps, notes = without_jumps(Recording("run", streams), 0.4)
  assert jumps == [] and len(notes) == 1 and "wrong samples: 1, left out" in notes[0]
  assert np.array_equal(kept["pose_x"].time, np.delete(time, 60))


def with_speed(tmp_path, factor, *, seconds=30.0, about=1.0, to=None):
  """A file with a speed whose unit changes by a factor halfway, beside the motor's, which slips about."""
  time, columns = drive(seconds)
  rolled = VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"] * columns["motor_speed"]
  columns["speed"] = rolled * np.where(time < 0.5 * seconds, 1.0, factor) * about
  manifest = folder_with(tmp_path, time, columns)
  if to is not None:
    path = tmp_path / "dataset.toml"
    path.write_text(path.read_text(encoding="utf-8").replace("[[recording]]", f"[[recording]]\nto = {to}"), "utf-8")
  return manifest


@pytest.mark.parametrize(("factor", "unit"), [(3.6, "km/h"), (1.0 / 3.6, "km/h"), (100.0, "cm/s")])
def test_a_unit_that_changes_in_mid_file_is_refused_with_its_time(tmp_path, factor, unit):
  with pytest.raises(RecordingError, match=rf"run.csv: speed is .* until 15 s .* \(of speed, .*{unit}"):
    DataSet.load(with_speed(tmp_path, factor))


def test_the_cure_for_it_works(tmp_path):
  (run,) = DataSet.load(with_speed(tmp_path, 3.6, to=15.0)).recordings
  assert run.end == pytest.approx(15.0, abs=0.02)


def test_a_tyre_that_slips_more_in_the_second_half_has_not_changed_its_unit(tmp_path):
  assert DataSet.load(with_speed(tmp_path, 0.7)).recordings
