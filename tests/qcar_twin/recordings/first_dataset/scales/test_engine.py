"""An engine that idles while the car stands is no motor that a gear ties to the wheels."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import Table
from tests.faults.wander import wander

TIME, DRIVEN = wander(78)
IDLE, TOP = 1800.0, 7000.0  # rev/min


def drafted(turns) -> str:
  columns = {"time": TIME, "throttle": DRIVEN["motor_voltage"] / 8.0, "steer": DRIVEN["steering_command"]}
  columns |= {"rpm": turns, "speed [km/h]": 3.6 * DRIVEN["speed"], "gyro_z": DRIVEN["yaw_rate"]}
  return propose("lab", [Table("run.csv", columns, {})], wheelbase=0.256, wheel_radius=0.033).text


@pytest.mark.parametrize("idles", [True, False])
def test_an_engine_s_speed_is_left_out_and_a_motor_s_is_taken(idles):
  turns = TOP * DRIVEN["speed"] / DRIVEN["speed"].max()
  text = drafted(np.maximum(turns, IDLE) if idles else turns)
  assert ("motor_speed = {" in text) is not idles
  assert ("'rpm' is left out: it turns while the car stands, as an engine does" in text) is idles
  assert 'speed = { column = "speed [km/h]"' in text
