"""Accelerometers of which all three axes were logged: gravity says in which unit, whatever it is."""

import numpy as np
import pytest

from qcar_twin.recordings.channels import GRAVITY
from qcar_twin.recordings.dataset import DataSet
from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log, speed_of

AXES = ("accSmooth[0]", "accSmooth[1]", "accSmooth[2]")


def felt(own, count, up=1.0, names=AXES):
  """Three accelerometers that read `count` a g, along x, y and z, the last upright."""
  noise = 0.03 * np.random.default_rng(3).standard_normal(own["accel_x"].size)
  axes = (own["accel_x"] / GRAVITY, own["accel_y"] / GRAVITY, up + noise)
  return {name: count * values for name, values in zip(names, axes, strict=True)}


def still_driven(names=("steer [rad]", "gyro_z [rad/s]")):
  """Time, what was driven, and columns without any speed, so that gravity alone tells the unit."""
  time, own = drive(20.0)
  return time, own, dict(zip(names, (own["steering_command"], own["yaw_rate"]), strict=True))


@pytest.mark.parametrize(
  ("count", "unit"),
  [(2048.0, "counts of 2048 a g"), (512.0, "counts of 51"), (64.0, "counts of 6"), (1.0, "in g"), (1000.0, "in mg")],
)
@pytest.mark.parametrize("up", [1.0, -1.0])
def test_gravity_says_what_an_accelerometer_counts_in(tmp_path, count, unit, up):
  time, own, columns = still_driven()
  table, proposal = log(tmp_path, time, columns | felt(own, count, up))
  for channel in ("accel_x", "accel_y"):
    assert table["channels"][channel]["scale"] == pytest.approx(GRAVITY / count, rel=0.02)
    line = next(line for line in proposal.channels if line.startswith(channel))
    assert "gravity reads" in line and "mostly along 'accSmooth[2]'" in line and unit in line
    assert "too much for" not in line, "a reason that gravity contradicts"


def test_an_accelerometer_in_si_or_with_a_unit_in_its_name_is_left_as_it_is(tmp_path):
  time, own, columns = still_driven()
  table, _ = log(tmp_path, time, columns | felt(own, GRAVITY))
  assert all("scale" not in table["channels"][name] for name in ("accel_x", "accel_y"))
  (tmp_path / "two").mkdir()
  table, _ = log(tmp_path / "two", time, columns | felt(own, 1000.0, names=("acc_x_mg", "acc_y_mg", "acc_z_mg")))
  assert table["channels"]["accel_x"]["scale"] == pytest.approx(GRAVITY / 1000.0)


@pytest.mark.parametrize("bias", [0.0, 0.3])
def test_an_accelerometer_whose_gravity_was_taken_off_tells_no_unit(tmp_path, bias):
  time, own, columns = still_driven()
  table, _ = log(tmp_path, time, columns | felt(own, GRAVITY, bias / GRAVITY))
  assert all("scale" not in table["channels"][name] for name in ("accel_x", "accel_y"))


def test_a_long_turn_of_1_m_s2_is_no_gravity(tmp_path):
  time, own, columns = still_driven()
  own["accel_y"] = 1.0 + 0.01 * own["accel_y"]
  table, _ = log(tmp_path, time, columns | felt(own, GRAVITY, 0.0))
  assert all("scale" not in table["channels"][name] for name in ("accel_x", "accel_y"))


def test_a_gyro_that_counts_to_the_right_beside_accelerometers_that_count_to_the_left(tmp_path):
  """As a flight controller's: no heading was logged, and gravity says which way the accelerometers lie."""
  time, own = drive(60.0)
  columns = {"throttle": own["motor_voltage"] / 8.0, "speed": speed_of(own), "gyro_x": 0.01 * own["accel_x"]}
  columns |= {"gyro_y": 0.01 * own["accel_y"], "gyro_z": -own["yaw_rate"], **felt(own, 2048.0)}
  table, _ = log(tmp_path, time, columns | {"steer": -own["steering_command"]})
  taken = table["channels"]
  assert taken["yaw_rate"] == {"column": "gyro_z", "scale": -1.0} and taken["accel_y"]["scale"] > 0.0
  assert taken["steering_command"]["scale"] == pytest.approx(-1.0, rel=0.1)


def test_a_sensor_that_lies_on_its_side_counts_in_any_unit_too(tmp_path):
  """Where the speed was logged, its axes are found as well: z is the car's left, and y upright."""
  time, own = drive(60.0)
  x, y, up = felt(own, 300.0).values()
  columns = {"throttle": own["motor_voltage"] / 8.0, "speed": speed_of(own), "steer [rad]": own["steering_command"]}
  columns |= {"gyro_z [rad/s]": own["yaw_rate"], "acc_x": x, "acc_y": up, "acc_z": -y}
  log(tmp_path, time, columns)
  run = DataSet.load(tmp_path).recordings[0]
  for channel in ("accel_x", "accel_y"):
    true = own[channel][: len(run[channel])]
    assert np.polyfit(true, run[channel].value, 1)[0] == pytest.approx(1.0, abs=0.05), channel
