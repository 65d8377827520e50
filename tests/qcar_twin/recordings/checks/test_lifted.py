"""Wheels that turn in the air: that recording is left out and said, and spoils no guess about the others."""

import numpy as np
import pytest

from qcar_twin.recordings.checks.pushes import is_lifted
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.recording import Recording, RecordingError
from tests.qcar_twin.recordings.drives import NOISE, VEHICLE, drive, write_csv, write_manifest

TRAVEL = VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"]


def on_a_stand(seed=0, seconds=12.0):
  """The same commands and wheels, and an IMU that lies still."""
  time, columns = drive(seconds, seed=seed)
  still = np.random.default_rng(seed)
  for name in ("accel_x", "accel_y", "yaw_rate"):
    columns[name] = NOISE[name] * still.standard_normal(time.size)
  return time, {name: values for name, values in columns.items() if not name.startswith("pose")}


def data_set(tmp_path, lifted):
  for seed, name in enumerate(("a.csv", "b.csv", "c.csv")):
    write_csv(tmp_path / name, *(on_a_stand(seed) if name in lifted else drive(seed=seed)))
  return write_manifest(tmp_path, ("a.csv", "b.csv", "c.csv"))


def test_a_car_on_a_stand_is_left_out(tmp_path):
  data = DataSet.load(data_set(tmp_path, ("b.csv",)))
  assert [r.name for r in data.recordings] == ["a", "c"]
  assert any(said.startswith("b.csv: the wheels speed up and slow down, and neither") for said in data.warnings)


def test_nothing_but_stands_is_refused(tmp_path):
  with pytest.raises(RecordingError, match="wheels in the air; give recordings of a car that drives"):
    DataSet.load(data_set(tmp_path, ("a.csv", "b.csv", "c.csv")))


def test_a_car_that_drives_straight_on_or_gently_is_none():
  time, columns = drive()
  straight = columns | {"yaw_rate": 0.01 * np.random.default_rng(1).standard_normal(time.size)}
  assert not is_lifted(Recording.from_columns("straight", time, straight), TRAVEL)
  turned = straight | {"accel_y": columns["accel_x"]}
  turned["accel_x"] = 0.02 * np.random.default_rng(2).standard_normal(time.size)  # an IMU that lies across
  pose = {name: values for name, values in turned.items() if not name.startswith("pose")}
  assert not is_lifted(Recording.from_columns("across", time, pose), TRAVEL)
  rolls = {"motor_speed": 100.0 + 0.5 * np.sin(time), "accel_x": 0.01 * np.cos(9.0 * time), "yaw_rate": 0.0 * time}
  assert not is_lifted(Recording.from_columns("steady", time, columns | rolls), TRAVEL)


def test_the_draft_goes_by_the_files_that_drive():
  """The sign of the steering is that of the drives, though most rows are of a stand."""
  tables = []
  for name, (time, columns) in {"a.csv": drive(20.0), "b.csv": on_a_stand(1, 60.0)}.items():
    columns = {"throttle": columns["motor_voltage"] / 8.0, "steer": -columns["steering_command"]} | {
      other: columns[channel]
      for other, channel in (
        ("motor_rad_s", "motor_speed"),
        ("acc_x", "accel_x"),
        ("acc_y", "accel_y"),
        ("gyro_z", "yaw_rate"),
      )
    }
    tables.append(Table(name, {"time": time, **columns}, {}))
  made = propose("lab", tables, wheelbase=0.256)
  steering = next(line for line in made.channels if line.startswith("steering_command"))
  assert "scale = -" in steering and made.text.count("[[recording]]") >= 2
