"""Logs and motion capture's takes of the same drives, by two clocks and two orders of names: the motion pairs them."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.parts.joined import joined
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import write_csv

SIDEWAYS = ("steering_command", "accel_y", "yaw_rate", "pose_y", "pose_yaw")
POSE = ("pose_x", "pose_y", "pose_yaw")
CUTS = ((1.5, 2.0), (-1.0, 0.5), (0.3, -2.5), (2.0, -1.0))  # s that a take begins before its log and ends after it
TAKES = ("one", "other", "further", "last")


def mirrored(drive):
  """The same drive with left and right exchanged."""
  time, columns = drive
  return time, {name: -values if name in SIDEWAYS else values for name, values in columns.items()}


def wander_and_its_mirror(count=1):
  return [first := wander(1, seconds=40.0), mirrored(first), *(wander(k, seconds=40.0) for k in range(2, 2 + count))]


def write(folder, k, drive, take, gyro=1.0, clock=1.7e9):
  """`log_k.csv` by the car's clock since power-up, and a take by another: the lag that was written, s."""
  time, columns = drive
  early, late = CUTS[k % len(CUTS)]
  inside = (time >= max(early, 0.0)) & (time <= time[-1] - max(late, 0.0))
  log = {name: values[inside] for name, values in columns.items() if name not in POSE}
  log["yaw_rate"] = gyro * log["yaw_rate"]
  write_csv(folder / f"log_{k}.csv", time[inside] + 1.2 + k, log)
  seen = np.arange(max(-early, 0.0), time[-1] - max(-late, 0.0), 0.01)
  poses = {name.removeprefix("pose_"): np.interp(seen, time, columns[name]) for name in POSE}
  write_csv(folder / f"{take}.csv", seen + clock + 1000.0 * k, poses)
  return 1.2 + k - clock - 1000.0 * k


def drives_of(folder):
  return joined([read_table(path, path.name) for path in sorted(folder.glob("*.csv"))])


def moved_by(said):
  """By log the take, and the seconds that were added to the take's clock."""
  words = [line.replace(",", "").replace(":", "").split() for line in said if "by their motion" in line]
  return {line[0]: (line[1], float(line[line.index("by", line.index("moves")) + 1])) for line in words}


@pytest.mark.parametrize("gyro", [1.0, -1.0])
@pytest.mark.parametrize("names", [TAKES, TAKES[::-1]])
def test_a_drive_and_its_mirror_are_told_apart_by_which_way_the_other_drives_turned(tmp_path, gyro, names):
  lags = {}
  for k, (drive, take) in enumerate(zip(wander_and_its_mirror(2), names, strict=True)):
    lags[f"log_{k}.csv"] = (f"{take}.csv", pytest.approx(write(tmp_path, k, drive, take, gyro), abs=0.02))
  assert moved_by(drives_of(tmp_path).said) == lags


def test_a_drive_and_its_mirror_alone_are_refused(tmp_path):
  for k, (drive, take) in enumerate(zip(wander_and_its_mirror(0), TAKES, strict=False)):
    write(tmp_path, k, drive, take)
  with pytest.raises(RecordingError, match="neither names nor clocks nor motion"):
    drives_of(tmp_path)


def test_a_take_that_fits_two_logs_is_refused(tmp_path):
  drives = [wander(1, seconds=40.0), wander(1, seconds=40.0), wander(2, seconds=40.0)]
  for k, (drive, take) in enumerate(zip(drives, TAKES, strict=False)):
    write(tmp_path, k, drive, take)
  with pytest.raises(RecordingError, match="neither names nor clocks nor motion"):
    drives_of(tmp_path)


def test_pairs_that_count_turning_differently_are_refused(tmp_path):
  """The log of the mirrored drive is there, and its take is not: by amounts alone the first drive's take fits it."""
  drive, other, further = wander_and_its_mirror()
  write(tmp_path, 0, drive, "one")
  write(tmp_path, 1, other, "other")
  write(tmp_path, 2, further, "further")
  (tmp_path / "log_0.csv").unlink()
  (tmp_path / "other.csv").unlink()
  with pytest.raises(RecordingError, match="neither names nor clocks nor motion"):
    drives_of(tmp_path)


def test_a_log_without_a_take_is_read_alone_beside_its_mirror(tmp_path):
  for k, (drive, take) in enumerate(zip(wander_and_its_mirror(), TAKES, strict=False)):
    write(tmp_path, k, drive, take)
  (tmp_path / "other.csv").unlink()
  said = drives_of(tmp_path).said
  assert "log_1.csv: is read alone, no other file is of its drive" in said
  assert {log: take for log, (take, _) in moved_by(said).items()} == {
    "log_0.csv": "one.csv",
    "log_2.csv": "further.csv",
  }
