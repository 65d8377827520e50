"""The scale of a steering by how the car turned."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.scales.turning import Turning
from qcar_twin.recordings.recording import Recording

WHEELBASE, SPEED = 0.3, 3.0


def stepped(angle: float, lag: float) -> Recording:
  """A drive at 3 m/s under steps of steering of all sizes up to an angle, 1 s each, behind a servo with a lag, s; the
  command is half of the angle."""
  time = np.arange(6000) / 50.0
  asked = np.repeat(np.random.default_rng(2).uniform(-angle, angle, 120), 50)
  turned = np.zeros(time.size)
  for k in range(1, time.size):
    turned[k] = turned[k - 1] + 0.02 / lag * (asked[k] - turned[k - 1])
  rate = SPEED * np.tan(turned) / WHEELBASE
  columns = {"speed": np.full(time.size, SPEED), "steering_command": 0.5 * asked, "yaw_rate": rate}
  return Recording.from_columns("run", time, columns)


@pytest.mark.parametrize(("angle", "lag"), [(0.06, 0.1), (0.3, 0.1), (0.3, 0.2)])
def test_the_scale_of_a_steering_is_told_however_hard_the_car_was_driven(angle, lag):
  """Beyond 2 m/s^2 across, the bins in which the car turned gently are those of large angles that it lagged behind."""
  turned = Turning.of([stepped(angle, lag)])
  assert turned.ratio(WHEELBASE) == pytest.approx(2.0, rel=0.15)


def test_a_car_that_turns_whatever_its_steering_says_has_no_scale():
  time = np.arange(3000) / 50.0
  columns = {"speed": np.full(time.size, SPEED), "steering_command": 0.1 * np.sin(time), "yaw_rate": np.cos(3.1 * time)}
  assert abs(Turning.of([Recording.from_columns("run", time, columns)]).alike()) < 0.3
