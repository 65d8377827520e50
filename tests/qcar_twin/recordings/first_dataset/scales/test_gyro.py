"""A gyro's counts, whose range what else turned tells."""

import numpy as np
import pytest

from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log, speed_of

G, DEGREE = 9.80665, np.pi / 180.0


def counted(folder, per_degree, *, motor=False, heading=False):
  time, own = drive(40.0)
  columns = {"throttle": own["motor_voltage"] / 8.0, "steer": own["steering_command"]}
  columns |= {"rpm": own["motor_speed"] * 60.0 / np.pi / 2.0} if motor else {"v": speed_of(own)}
  columns |= {"x": own["pose_x"], "y": own["pose_y"], "yaw": own["pose_yaw"]} if heading else {}
  columns |= {"gz": np.round(own["yaw_rate"] / DEGREE * per_degree)}
  upright = 16384.0 + 100.0 * np.sin(7.0 * time)
  columns |= {"ax": np.round(own["accel_x"] / G * 16384.0), "ay": np.round(own["accel_y"] / G * 16384.0)}
  return log(folder, time, columns | {"az": np.round(upright)})


@pytest.mark.parametrize("motor", [False, True])
@pytest.mark.parametrize("per_degree", [131.0, 65.5, 32.8, 1e3 / 8.75])
def test_forces_tell_the_range_and_a_person_the_maker(tmp_path, per_degree, motor):
  table, proposal = counted(tmp_path, per_degree, motor=motor)
  (question,) = [q for q in proposal.questions if "gyro's counts" in q]
  assert f"{per_degree:.4g}" in question.partition("to a deg/s")[0]
  assert table["channels"]["yaw_rate"]["scale"] == pytest.approx(DEGREE / per_degree, rel=0.2)


@pytest.mark.parametrize("per_degree", [131.0, 1e3 / 8.75, 1e3 / 4.375])
def test_a_heading_tells_both(tmp_path, per_degree):
  table, proposal = counted(tmp_path, per_degree, heading=True)
  assert not [q for q in proposal.questions if "gyro's counts" in q]
  assert table["channels"]["yaw_rate"]["scale"] == pytest.approx(DEGREE / per_degree, rel=1e-6)
