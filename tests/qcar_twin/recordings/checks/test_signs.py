"""A sensor that reads both ways and never does so was logged as a size; a car that turned one way was not."""

import numpy as np
import pytest

from qcar_twin.recordings.checks.signs import sizes_near_zero
from qcar_twin.recordings.recording import Recording
from tests.faults.wander import wander

TIME, DRIVEN = wander(79)
NOISE = 0.02
RANDOM = np.random.default_rng(5).standard_normal((400, TIME.size))
RATE = DRIVEN["yaw_rate"] + NOISE * RANDOM[0]


def near(value, noise=NOISE):
  return sizes_near_zero([run(value)], "yaw_rate", noise)


def run(value):
  return Recording.from_columns("run", TIME, {"speed": DRIVEN["speed"], "yaw_rate": value})


def test_a_size_is_told_by_what_lies_near_zero():
  assert near(np.abs(RATE)) > 20
  assert near(RATE) == 0


@pytest.mark.parametrize(
  "value",
  [
    np.abs(DRIVEN["yaw_rate"]) + 0.1 + NOISE * RANDOM[1],  # turned to the left alone, zero off by five deviations
    np.round(np.abs(RATE) / 0.05) * 0.05,  # steps beyond its noise: 0 may be anything near it
    np.where(DRIVEN["speed"] > 0.5, 0.8 + NOISE * RANDOM[2], 0.0),  # a circle, and exactly 0 at rest
  ],
)
def test_a_car_that_turned_one_way_is_none(value):
  assert near(value) == 0


def test_a_zero_that_is_off_by_some_deviations_is_no_lost_sign():
  """Of 400 rests of a gyro, at each of several offsets, none is blamed."""
  for off in (0.5, 1.0, 2.0, 3.0, 4.0, 5.0):
    assert not any(near(NOISE * (off + one)) for one in RANDOM)
