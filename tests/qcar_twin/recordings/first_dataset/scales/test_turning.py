"""The scale of a steering by how the car turned."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.scales.turning import Turning
from qcar_twin.recordings.recording import Recording

WHEELBASE, SPEED = 0.3, 3.0


def slalom(frequency: float, angle: float, rate_limit: float) -> Recording:
  """A drive through a slalom at 3 m/s, its servo held to a rate, rad/s; the command is half of the angle."""
  time = np.arange(3000) / 50.0
  asked = angle * np.sin(2.0 * np.pi * frequency * time)
  turned = np.zeros(time.size)
  for k in range(1, time.size):
    turned[k] = turned[k - 1] + np.clip(asked[k] - turned[k - 1], -0.02 * rate_limit, 0.02 * rate_limit)
  rate = SPEED * np.tan(turned) / WHEELBASE
  columns = {"speed": np.full(time.size, SPEED), "steering_command": 0.5 * asked, "yaw_rate": rate}
  return Recording.from_columns("run", time, columns)


@pytest.mark.parametrize(("angle", "rate_limit"), [(0.06, 10.0), (0.2, 10.0), (0.2, 1.0)])
def test_a_slalom_tells_the_scale_of_its_steering_however_hard_it_was_driven(angle, rate_limit):
  """Beyond 2 m/s^2 across, the bins in which the car turned gently are those of a large angle that it lagged behind."""
  turned = Turning.of([slalom(0.6, angle, rate_limit)])
  assert turned.alike() > 0.9
  assert turned.ratio(WHEELBASE) == pytest.approx(2.0, rel=0.08)


def test_a_car_that_turns_whatever_its_steering_says_has_no_scale():
  time = np.arange(3000) / 50.0
  columns = {"speed": np.full(time.size, SPEED), "steering_command": 0.1 * np.sin(time), "yaw_rate": np.cos(3.1 * time)}
  assert abs(Turning.of([Recording.from_columns("run", time, columns)]).alike()) < 0.3
