"""Two clocks of one drive of which one runs faster."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.parts.drift import Clock, Pair, drifts
from qcar_twin.recordings.first_dataset.parts.motion import PERIOD, Motion, fit
from tests.faults.wander import wander

FIRST = 1.7e9  # s, where the other's clock begins


def pair(seed: int, faster_by: float, noise: float = 0.02) -> Pair:
  """A drive that one file commands, by a clock that runs faster, and the other sees."""
  time, columns = wander(seed, seconds=50.0)
  random, grid = np.random.default_rng(seed), np.arange(0.0, time[-1], PERIOD)
  seen = lambda channel: np.interp(grid, time, columns[channel])
  noisy = lambda values: values + noise * random.standard_normal(values.size)
  other = Motion(FIRST, FIRST + grid[-1], noisy(seen("speed")), noisy(seen("yaw_rate")))
  own = grid[grid < grid[-1] - 2.0] / (1.0 + faster_by) + 2.0  # begins 2 s later, by its own clock at 30 s
  told = lambda channel: np.interp(own, time, columns[channel])
  turning = told("steering_command") * told("speed")
  car = Motion(30.0, 30.0 + PERIOD * own.size, told("speed"), turning, (False, False))
  return Pair(car, other, fit(car, other).lag, 0)


@pytest.mark.parametrize("faster_by", [0.0085, -0.005])
def test_a_clock_that_runs_faster_is_found_and_brought_to_the_other_s(faster_by):
  pairs = [pair(seed, faster_by) for seed in (1, 2, 3)]
  value, clocks = drifts(pairs)
  assert value == pytest.approx(faster_by, abs=0.001)
  for own, clock in zip(pairs, clocks, strict=True):
    told = np.array([30.0, 50.0, 70.0])  # by the car's clock, which is at 30 where the other's is 2 s on
    seen = FIRST + 2.0 + (told - 30.0) / (1.0 + faster_by) + own.lag
    np.testing.assert_allclose(clock.rate * told + clock.shift, seen, atol=0.04)


def test_clocks_that_run_alike_and_drives_that_tell_too_little_are_left_alone():
  alike = [pair(seed, 0.0) for seed in (1, 2, 3)]
  assert drifts(alike) == (0.0, (Clock(),) * 3)
  short = [one._replace(car=dataclasses.replace(one.car, speed=one.car.speed[:300], turning=one.car.turning[:300]))
           for one in [pair(1, 0.0085)]]  # fmt: skip
  assert drifts(short)[0] == 0.0
  assert drifts([]) == (0.0, ())
