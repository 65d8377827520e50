"""The second car as a plant: a drive that can be closed, repeatable, with errors that say what is wrong."""

import numpy as np
import pytest

from calibration.concealed.second_car.plant import SecondCarPlant

START = np.zeros((2, 7))


def driven(periods, **options):
  cars = SecondCarPlant(seconds=1.0, **options).begin(START)
  return np.stack([cars.step(np.array([(2.0, 0.1), (-2.0, 0.1)])).copy() for _ in range(periods)])


def test_it_drives_where_it_is_told_and_repeats_itself():
  signals = driven(80, noise=1.0, seed=4)
  np.testing.assert_array_equal(signals, driven(80, noise=1.0, seed=4))
  assert signals[-1, 0, 3] > 0.5 and signals[-1, 1, 3] < -0.5  # m/s
  assert signals[-1, 0, 5] > 0.1 > -0.1 > signals[-1, 1, 5]  # rad/s: to the left, in reverse clockwise
  assert np.abs(signals - driven(80, noise=1.0, seed=5)).max() > 1e-4


def test_wrong_shapes_and_a_drive_that_is_over_are_errors():
  with pytest.raises(ValueError, match="start must be"):
    SecondCarPlant().begin(np.zeros((2, 6)))
  cars = SecondCarPlant(seconds=0.02).begin(START)
  with pytest.raises(ValueError, match="commands must be"):
    cars.step(np.zeros((3, 2)))
  for _ in range(2):
    cars.step(np.zeros((2, 2)))
  with pytest.raises(IndexError, match="more `seconds`"):
    cars.step(np.zeros((2, 2)))
