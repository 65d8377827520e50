"""Poses that jump for good, flicker, stop and catch up."""

import numpy as np
import pytest

from qcar_twin.recordings.checks.jumps import without_jumps
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream
from tests.qcar_twin.recordings.drives import drive, folder_with


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
