"""A trim of the steering is no other wheelbase."""

import numpy as np
import pytest

from tests.qcar_twin.recordings.drives import drive
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log, speed_of


@pytest.mark.parametrize("trim", [0.0, 0.06, -0.06])
def test_the_wheelbase_is_the_same_with_a_trim(tmp_path, trim):
  time, own = drive(60.0)
  angle = 0.3 * own["steering_command"]
  speed = speed_of(own)
  columns = {"throttle": own["motor_voltage"] / 8.0, "steer_rad": angle + trim, "speed [m/s]": speed}
  table, _ = log(tmp_path, time, columns | {"gyro_z": speed * np.tan(angle) / 0.4})
  vehicle = table["vehicle"]
  assert vehicle["cg_to_front"] + vehicle["cg_to_rear"] == pytest.approx(0.4, rel=0.02)


def test_of_a_car_on_one_circle_the_angle_tells_it(tmp_path):
  time, own = drive(60.0)
  speed = speed_of(own)
  columns = {"throttle": own["motor_voltage"] / 8.0, "steer_rad": np.full(time.size, 0.2), "speed [m/s]": speed}
  columns["steer_rad"][:10] = 0.0
  table, _ = log(tmp_path, time, columns | {"gyro_z": speed * np.tan(0.2) / 0.4})
  vehicle = table["vehicle"]
  assert vehicle["cg_to_front"] + vehicle["cg_to_rear"] == pytest.approx(0.4, rel=0.03)
