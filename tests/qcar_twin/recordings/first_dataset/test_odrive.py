"""Logs of an ODrive's axes, whose API reference says the units: turns, turns/s and amperes."""

import math

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.unit_names import unit_of
from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log


def axis(own, stem="axis0."):
  """Columns of an axis in velocity control, from a motor's speed in rad/s."""
  turns = own["motor_speed"] / math.tau
  return {
    f"{stem}input_vel": np.repeat(turns[::50], 50),
    f"{stem}pos_estimate": np.cumsum(turns) / 100.0,
    f"{stem}vel_estimate": turns,
    f"{stem}Iq_setpoint": 2.0 * np.gradient(turns) + 0.5,
    f"{stem}Iq_measured": 2.0 * np.gradient(turns) + 0.5 + 0.01 * np.sin(9.0 * np.arange(turns.size)),
  }


@pytest.mark.parametrize(
  ("column", "unit"),
  [
    ("axis0.vel_estimate", ("rad/s", math.tau)),
    ("odrv0.axis1.encoder.vel_estimate", ("rad/s", math.tau)),
    ("axis0.controller.input_vel", ("rad/s", math.tau)),
    ("axis0.pos_estimate", ("rad", math.tau)),
    ("axis0.motor.current_control.Iq_measured", ("A", 1.0)),
    ("axis0.Iq_setpoint", ("A", 1.0)),
    ("wheel speed [turns/s]", ("rad/s", math.tau)),
  ],
)
def test_an_odrives_units_are_known_by_name(column, unit):
  said = unit_of(column)
  assert said is not None and said[1:] == pytest.approx(unit)


def test_an_estimate_of_another_maker_has_no_unit():
  assert unit_of("ekf.vel_estimate") is None and unit_of("input_vel") is None


@pytest.mark.parametrize("stem", ["axis0.", "odrv0.axis1.controller."])
def test_an_odrives_motor_speed_and_its_command(tmp_path, stem):
  time, own = drive(20.0)
  columns = {"steer [rad]": own["steering_command"], "gyro_z [rad/s]": own["yaw_rate"]}
  table, proposal = log(tmp_path, time, columns | axis(own, stem))
  channels, car = table["channels"], table["vehicle"]
  assert channels["motor_speed"] == {"column": f"{stem}vel_estimate", "scale": pytest.approx(math.tau)}
  assert "speed" not in channels and "motor_current" not in channels and not proposal.questions
  assert channels["armature_current"] == {"column": f"{stem}Iq_measured"}
  assert channels["speed_command"]["column"] == f"{stem}input_vel" and car["drive"] == "speed"
  travel = car["gear_ratio"] * car["wheel_radius"]
  assert channels["speed_command"]["scale"] == pytest.approx(math.tau * travel, rel=1e-4)
  line = next(line for line in proposal.channels if line.startswith("speed_command"))
  assert f"gear_ratio {car['gear_ratio']:.4g} and wheel_radius {car['wheel_radius']:.4g}" in line
  run = DataSet.load(tmp_path).recordings[0]
  assert run["motor_speed"].value == pytest.approx(own["motor_speed"][: len(run["motor_speed"])], abs=1e-3)
  command = np.interp(run["motor_speed"].time, run["speed_command"].time, run["speed_command"].value)
  assert np.median(command / (travel * run["motor_speed"].value)) == pytest.approx(1.0, abs=0.05)


def test_of_a_torque_controlled_axis_the_currents_setpoint_is_the_command(tmp_path):
  time, own = drive(20.0)
  columns = axis(own) | {"axis0.input_vel": np.zeros(time.size), "steer [rad]": own["steering_command"]}
  table, _ = log(tmp_path, time, columns | {"gyro_z [rad/s]": own["yaw_rate"]})
  assert (
    table["channels"]["motor_current"] == {"column": "axis0.Iq_setpoint"} and table["vehicle"]["drive"] == "current"
  )


def test_a_commanded_speed_in_rpm_of_the_motor_is_one_of_the_car(tmp_path):
  time, own = drive(20.0)
  rpm = own["motor_speed"] * 60.0 / math.tau
  columns = {"motor_rpm_cmd": np.repeat(rpm[::50], 50), "motor_rpm": rpm, "steer [rad]": own["steering_command"]}
  table, _ = log(tmp_path, time, columns | {"gyro_z [rad/s]": own["yaw_rate"]})
  travel = table["vehicle"]["gear_ratio"] * table["vehicle"]["wheel_radius"]
  assert table["channels"]["speed_command"]["scale"] == pytest.approx(math.tau / 60.0 * travel, rel=1e-4)
