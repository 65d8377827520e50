"""An IMU that lies upside down turns the sign of two channels: one cause, and the cure that it has."""

import re

import pytest

from calibration.log_check.check import check_log
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import folder_with, write_csv


def turned(*names):
  time, columns = wander(41)
  return time, columns | {name: -columns[name] for name in names}


def corrected(folder, text: str) -> DataSet:
  """The data set with what a cure says of its channels."""
  named = re.findall(r"(?:on|and on) (\w+)", text)
  mapped = "\n".join(f'{name} = {{ column = "{name}", scale = -1.0 }}' for name in named)
  manifest = folder / "dataset.toml"
  whole = manifest.read_text(encoding="utf-8").replace("[[recording]]", f"[channels]\n{mapped}\n\n[[recording]]", 1)
  manifest.write_text(whole, encoding="utf-8")
  return DataSet.load(folder)


@pytest.mark.parametrize(
  ("names", "cause"),
  [
    (("yaw_rate", "accel_y"), "the IMU lies upside down"),
    (("pose_y", "pose_yaw"), "the steering goes with them: the place is mirrored"),
    (("pose_y", "pose_yaw", "steering_command"), "the IMU lies upside down"),  # the same log seen in a mirror
  ],
)
def test_the_steering_says_which_it_is_and_the_cure_works(tmp_path, names, cause):
  (finding,) = check_log(DataSet.load(folder_with(tmp_path, *turned(*names)))).of("spoils")
  assert cause in finding.text
  cure = re.search(r"set scale = -1 (on \w+ and on \w+) in", finding.text)[1]
  assert check_log(corrected(tmp_path, cure)).of("spoils") == ()


def test_a_compass_without_a_place_counts_clockwise_and_the_cure_works(tmp_path):
  time, columns = turned("pose_yaw")
  columns = {name: value for name, value in columns.items() if name not in ("pose_x", "pose_y")}
  (finding,) = check_log(DataSet.load(folder_with(tmp_path, time, columns))).of("spoils")
  assert "the heading counts clockwise, as a compass does: set scale = -1 on pose_yaw in" in finding.text
  assert check_log(corrected(tmp_path, re.search(r"set scale = -1 (on \w+) in", finding.text)[1])).of("spoils") == ()


def test_new_counts_an_imu_the_other_way_and_leaves_the_steering_as_it_is(tmp_path):
  time, columns = turned("yaw_rate", "accel_y")
  write_csv(tmp_path / "run.csv", time, columns)
  text = propose("lab", [read_table(tmp_path / "run.csv")], wheelbase=0.256, mass=2.7).text
  assert 'yaw_rate = { column = "yaw_rate", scale = -1.0 }' in text
  assert 'accel_y = { column = "accel_y", scale = -1.0 }' in text and "upside down" in text
  assert 'steering_command = { column = "steering_command" }' in text
  (tmp_path / "dataset.toml").write_text(text, encoding="utf-8")
  assert check_log(DataSet.load(tmp_path)).of("spoils") == ()
