"""Random streams of cars side by side: independent of who is beside them, and random."""

import numpy as np
import pytest
from scipy import stats

from qcar_twin.sensors.lidar import Room, ScanningLidar
from qcar_twin.sensors.streams import CarStreams
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors

SEEDS = (5, 11, 3, 2_000_000_011)


def draws(streams):
  count = streams.random(1 if streams._key.size == 1 else streams._key.size).shape[0]
  return [streams.standard_normal((3, count, 2)), streams.random((2, count)), streams.uniform(-1.0, 2.0, count)]


def test_a_car_alone_draws_what_it_draws_beside_others():
  together = draws(CarStreams(SEEDS, 7))
  for i, seed in enumerate(SEEDS):
    normal, pair, single = draws(CarStreams([seed], 7))
    np.testing.assert_array_equal(normal[:, 0], together[0][:, i])
    np.testing.assert_array_equal(pair[:, 0], together[1][:, i])
    assert single[0] == together[2][i]


def test_seeds_and_keys_tell_streams_apart():
  first, key, seed = (CarStreams(*args).random(1)[0] for args in (([5], 7), ([5], 8), ([6], 7)))
  assert len({first, key, seed}) == 3


def test_what_is_drawn_for_some_cars_leaves_the_others_where_they_were():
  streams, untouched = CarStreams(SEEDS, 1), CarStreams(SEEDS, 1)
  streams.only(np.array([True, False, False, True])).standard_normal((2, 4, 3))
  later, same = streams.random(4), untouched.random(4)
  np.testing.assert_array_equal(later[1:3], same[1:3])
  assert not np.any(later[[0, 3]] == same[[0, 3]])


def test_numbers_are_uniform_normal_and_uncorrelated():
  """Kolmogorov-Smirnov at 1e-6; correlations of 40 000 pairs within five standard errors of nothing."""
  streams = CarStreams(range(200), 0)
  uniform = np.stack([streams.random(200) for _ in range(200)])
  normal = streams.standard_normal((200, 200))
  assert stats.kstest(uniform.ravel(), "uniform").pvalue > 1e-6
  assert stats.kstest(normal.ravel(), "norm").pvalue > 1e-6
  for array in (uniform, normal):
    for a, b in ((array[1:], array[:-1]), (array[:, 1:], array[:, :-1])):
      assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 5.0 / np.sqrt(a.size)


def test_the_cars_lie_where_sensors_draw_them():
  with pytest.raises(ValueError, match="lie along 4 cars"):
    CarStreams(SEEDS).random(5)


def drive(suite, steps, restart=None):
  """Everything that arrives, by channel, (k, N, c); car 0 is restarted in one period."""
  signals, said = np.zeros((suite.count, 10)), {}
  signals[:, 3] = 0.5
  for k in range(steps):
    signals[:, 0] = 0.005 * k
    if k == restart:
      suite.restart(np.arange(suite.count) == 0, signals)
    for reading in suite.measure(signals):
      said.setdefault(reading.channels[0], []).append(reading.values)
  return {name: np.array(values) for name, values in said.items()}


@pytest.mark.parametrize("restart", [None, 25])
def test_a_car_senses_the_same_whoever_is_beside_it_and_is_restarted(restart):
  together = drive(SensorSuite(qcar_sensors(), 4, SEEDS), 60, restart)
  for i in (1, 2, 3):
    alone = drive(SensorSuite(qcar_sensors(), 1, [SEEDS[i]]), 60)
    for name, values in alone.items():
      np.testing.assert_array_equal(values[:, 0], together[name][:, i])


def test_a_scanning_lidar_does_too():
  sensors = {"lidar": ScanningLidar(Room.around(np.array([0.0, 0.5]), np.array([-0.2, 0.2])))}
  together = drive(SensorSuite(sensors, 3, SEEDS[:3]), 25)["pose_x"]
  alone = drive(SensorSuite(sensors, 1, [SEEDS[1]]), 25)["pose_x"]
  np.testing.assert_array_equal(together[:, 1], alone[:, 0])


def test_a_seed_for_every_car_or_one_for_all():
  with pytest.raises(ValueError, match="3 seeds for 4 cars"):
    SensorSuite(qcar_sensors(), 4, [1, 2, 3])
