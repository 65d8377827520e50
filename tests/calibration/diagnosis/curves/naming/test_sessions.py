"""Contrasts between sessions."""

import numpy as np

from calibration.diagnosis.curves.naming.sessions import contrasts


def test_contrasts_of_shifts_and_of_what_they_share():
  names = ("mass", "steering_offset", "steering_offset@a", "steering_offset@b", "torque_per_volt@a")
  found = contrasts(names)
  assert set(found) == {"steering_offset", "steering_offset@a", "steering_offset@b", "torque_per_volt@a"}
  values = np.array([2.0, 0.01, 0.05, 0.03, 0.7])
  told = {name: float(weights @ values) for name, weights in found.items()}
  assert np.isclose(told["steering_offset"], 0.05)
  assert np.isclose(told["steering_offset@a"], 0.01) and np.isclose(told["steering_offset@b"], -0.01)
  assert told["torque_per_volt@a"] == 0.0


def test_what_stands_in_either_changes_no_contrast():
  names = ("trim", "trim@a", "trim@b", "trim@c")
  trade = np.array([1.0, -1.0, -1.0, -1.0])
  assert np.allclose([weights @ trade for weights in contrasts(names).values()], 0.0)


def test_without_shifts_there_is_none():
  assert contrasts(("mass", "steering_offset")) == {}
