"""Wheels' speeds without a unit: rad/s, rpm or over ground, by what else moved."""

import numpy as np
import pytest

from qcar_twin.vehicle.vehicle import QCAR
from tests.faults.falsities import wander
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log

R, RPM = QCAR.wheel_radius, 2.0 * np.pi / 60.0
METRES = {"rad/s": R, "rpm": RPM * R, "m/s": 1.0, "km/h": 1.0 / 3.6}


def logged(folder, unit, felt=True, place=False, names=("wheel_rl", "wheel_rr")):
  time, own = wander(4)
  columns = {"throttle": own["motor_voltage"] / 8.0, "steer": own["steering_command"], "gyro_z": own["yaw_rate"]}
  half = 0.085 * own["yaw_rate"]
  columns |= {name: (own["speed"] + side) / METRES[unit] for name, side in zip(names, (-half, half), strict=False)}
  columns |= {"ax": 3.0 * own["accel_x"], "ay": 3.0 * own["accel_y"]} if felt == "too much" else {}
  columns |= {"ax": own["accel_x"], "ay": own["accel_y"]} if felt is True else {}
  columns |= {name: own[name] for name in ("pose_x", "pose_y", "pose_yaw")} if place else {}
  return log(folder, time, columns)


@pytest.mark.parametrize("place", [False, True])
@pytest.mark.parametrize("unit", METRES)
def test_accelerometers_or_a_place_tell_it(tmp_path, unit, place):
  table, proposal = logged(tmp_path, unit, felt=not place, place=place)
  turns = unit in ("rad/s", "rpm")
  taken = table["channels"]["motor_speed" if turns else "speed"]
  assert taken["column"] == "mean of wheel_rl and wheel_rr" and not proposal.questions
  expected = METRES[unit] / (R * table["vehicle"]["gear_ratio"]) if turns else METRES[unit]
  assert taken.get("scale", 1.0) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("felt", [False, "too much"])
def test_where_nothing_shows_it_a_person_is_asked(tmp_path, felt):
  _, proposal = logged(tmp_path, "rad/s", felt=felt)
  (question,) = proposal.questions
  assert "is a wheel's speed and names no unit" in question and "for rad/s set scale = 0.033 on speed" in question


def test_revolutions_of_an_axle_are_none_of_the_motor(tmp_path):
  table, _ = logged(tmp_path, "rpm", names=("rear_rpm",))
  assert table["channels"]["motor_speed"]["scale"] == pytest.approx(RPM / QCAR.gear_ratio, rel=1e-4)


def test_revolutions_of_a_rear_motor_are_its_own(tmp_path):
  table, _ = logged(tmp_path, "rpm", names=("rear_motor_rpm",))
  assert table["channels"]["motor_speed"]["scale"] == pytest.approx(RPM, rel=1e-4)
