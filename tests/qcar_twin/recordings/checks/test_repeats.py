"""The same driving in two recordings is found; a hold-out that repeats what was fitted is refused."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.recordings.checks.repeats import find_repeats
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from tests.qcar_twin.recordings.drives import STD, VEHICLE, drive, recording


def later(whole: Recording, start: float, end: float, by: float) -> Recording:
  """A part of a recording, logged with another clock."""
  part = whole.window(start, end)
  streams = {name: Stream(s.time + by, s.value) for name, s in part.streams.items()}
  return dataclasses.replace(part, streams=streams)


def test_a_part_that_was_cut_out_and_stamped_anew_is_found_with_its_times():
  whole = recording("whole")
  part = later(whole, 4.0, 7.0, by=100.0).replace(name="part")
  (repeat,) = find_repeats([whole, recording("other", seed=1), part])
  assert (repeat.first.name, repeat.second.name) == ("whole", "part")
  assert (repeat.start, repeat.end, repeat.at) == pytest.approx((4.0, 7.0, 104.0))


def test_drives_alike_are_not_the_same_drive():
  assert find_repeats([recording(f"run_{k}", seed=k) for k in range(4)]) == []


def test_standing_still_repeats_itself_and_is_no_drive():
  time = np.arange(400) / 100.0
  columns = {"motor_voltage": 0 * time, "motor_speed": 0 * time, "yaw_rate": 0 * time + 0.001}
  assert find_repeats([Recording.from_columns(name, time, columns) for name in ("a", "b")]) == []


def test_a_log_without_noisy_channels_is_told_by_its_speed():
  time, columns = drive()
  runs = [
    Recording.from_columns(name, time, {k: columns[k] for k in ("motor_voltage", "motor_speed")}) for name in "ab"
  ]
  (repeat,) = find_repeats(runs)
  assert repeat.channel == "motor_speed" and repeat.end - repeat.start > 11.9


@pytest.mark.parametrize("roles", [("identify", "holdout"), ("holdout", "validate")])
def test_a_holdout_that_repeats_a_fitted_run_is_refused(tmp_path, roles):
  whole = recording("whole", role=roles[0])
  part = later(whole, 4.0, 7.0, by=-4.0).replace(name="part", role=roles[1])
  write_dataset(tmp_path, "lab", VEHICLE, STD, [whole, part])
  with pytest.raises(RecordingError) as caught:
    DataSet.load(tmp_path)
  for text in (
    f"part.csv (role {roles[1]}) repeats whole.csv (role {roles[0]}): ",
    "from 4 s to 7 s there and from 0 s on here",
    "give both one role",
  ):
    assert text in str(caught.value)


def test_what_counts_twice_among_the_fitted_is_said(tmp_path):
  whole = recording("whole")
  write_dataset(tmp_path, "lab", VEHICLE, STD, [whole, later(whole, 4.0, 7.0, by=-4.0).replace(name="part")])
  (warning,) = DataSet.load(tmp_path).warnings
  assert warning.startswith("part.csv (role identify) repeats whole.csv") and warning.endswith("it counts twice")
