"""Start states: read off the samples that agree with each other, and eliminated from the least squares."""

import numpy as np
import pytest

from calibration.fitting.start_states import Elimination, level, start_state
from qcar_twin.plant import START
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import QCAR


def launch(rate: float, noise: float = 0.0, seed: int = 0) -> Stream:
  """A motor that has just been switched on: w = 200 (1 - exp(-t / 0.05 s)) rad/s."""
  time = np.arange(0.0, 1.0, 1.0 / rate)
  return Stream(
    time, 200.0 * (1.0 - np.exp(-time / 0.05)) + noise * np.random.default_rng(seed).standard_normal(len(time))
  )


def test_a_recording_that_begins_in_a_launch_begins_with_its_first_sample():
  stream = launch(100.0)
  line = np.polyval(np.polyfit(stream.time[:7], stream.value[:7], 1), 0.0)
  value, std = level(stream, 0.0, 0.5)
  assert line > 10.0 and abs(value) < 1.0 and std == pytest.approx(0.5, rel=0.5)


def test_steady_driving_is_averaged_and_its_deviation_is_what_it_errs_by():
  errors, stds = [], []
  for seed in range(200):
    stream = Stream(np.arange(0.0, 1.0, 0.01), 100.0 + np.random.default_rng(seed).standard_normal(100))
    value, std = level(stream, 0.5, 1.0)
    errors.append(value - 100.0)
    stds.append(std)
  assert np.std(errors) < 0.5  # of single samples it is 1
  assert np.std(errors) == pytest.approx(np.mean(stds), rel=0.35)


@pytest.mark.parametrize("rate", [100.0, 20.0])
def test_intervals_hold_in_a_launch(rate):
  """Somewhere in mid-launch at either rate: nearly all errors lie within three stated deviations."""
  time = np.linspace(0.03, 0.2, 40)
  z = [(v - 200.0 * (1.0 - np.exp(-t / 0.05))) / s for seed, t in enumerate(time)
       for v, s in [level(launch(rate, 1.0, seed), float(t), 1.0)]]  # fmt: skip
  assert np.mean(np.abs(z) < 3.0) >= 0.9


def test_sideslip_is_that_of_steady_cornering_and_is_known_to_its_own_size():
  time = np.arange(0.0, 2.0, 0.01)
  columns = {"motor_speed": np.full(200, 1.5 / QCAR.wheel_radius / QCAR.gear_ratio), "yaw_rate": np.full(200, 2.0)}
  start = start_state(Recording.from_columns("r", time, columns), 1.0, QCAR, 0.3, {})
  state, std = (dict(zip(START, a, strict=True)) for a in (start.value, start.std))
  kinematic = 2.0 * QCAR.cg_to_rear
  assert state["velocity_y"] < kinematic
  assert std["velocity_y"] == pytest.approx(kinematic - state["velocity_y"])


def test_elimination_is_the_least_squares_over_the_states_of_each_stretch():
  random = np.random.default_rng(1)
  stretch, scale = np.repeat([0, 1, 4], [30, 3, 40]), random.uniform(0.5, 2.0, 73)
  slopes, residual = random.standard_normal((73, 4)), random.standard_normal((2, 73))
  elimination = Elimination.of(slopes, scale, stretch)
  left = residual.copy()
  elimination.apply(left)
  for row in range(2):
    cost = 0.0
    for k in np.unique(stretch):
      rows = stretch == k
      u = slopes[rows] * scale[rows, None]
      z = -np.linalg.solve(u.T @ u + np.eye(4), u.T @ residual[row, rows])
      cost += np.sum((residual[row, rows] + u @ z) ** 2) + z @ z
    assert np.sum(left[row] ** 2) == pytest.approx(cost)
  part = residual[:, 30:33].copy()
  elimination.apply(part, 30)
  np.testing.assert_allclose(part, left[:, 30:33])


def test_a_start_that_is_known_takes_nothing_away():
  residual = np.ones((1, 10))
  Elimination.of(np.zeros((10, 4)), np.ones(10), np.zeros(10, dtype=np.int64)).apply(residual)
  np.testing.assert_array_equal(residual, 1.0)
