"""Reward and ends, against the paper's equations written out by hand."""

import math

import numpy as np
import pytest

from qcar_twin.envs.task import Reward, TrackingTask
from qcar_twin.paths import path_from_pieces, path_named

WEIGHTS = Reward(m1=0.1, m2=0.2, m3=0.03, m4=0.04, m5=0.05, m6=0.5, lost_penalty=10.0, near=0.002, aligned=0.02)
TASK = TrackingTask(path_named("s"), reward=WEIGHTS)


def rewarded(task, *arguments):
  terms, lost = task.judge(*arguments)
  return np.sum(list(terms.values()), axis=0), lost


def pay(cross_track=0.0, heading=0.0, rate=0.0, difference=0.0):
  reward, lost = rewarded(TASK, *(np.array([float(x)]) for x in (cross_track, heading, rate, difference)))
  return float(reward[0]), bool(lost[0])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_cross_track_reward_is_flat_near_then_logarithmic_then_a_penalty(side):
  psi = -0.03 * math.log(0.02)
  assert pay(side * 0.001)[0] == pytest.approx(-0.1 * math.log(0.002) + psi)
  assert pay(side * 0.002)[0] == pytest.approx(-0.1 * math.log(0.002) + psi)
  assert pay(side * 0.05)[0] == pytest.approx(-0.2 * math.log(0.05) + psi)
  assert pay(side * 0.199) == (pytest.approx(-0.2 * math.log(0.199) + psi), False)
  assert pay(side * 0.2) == (pytest.approx(-10.0 + psi), True)


def test_heading_reward_is_flat_when_aligned():
  y = -0.1 * math.log(0.002)
  assert pay(heading=-0.02)[0] == pytest.approx(y - 0.03 * math.log(0.02))
  assert pay(heading=0.3)[0] == pytest.approx(y - 0.04 * math.log(0.3))


def test_effort_and_demonstrator_cost_by_their_size():
  base = pay()[0]
  assert pay(rate=-1.2)[0] == pytest.approx(base - 0.05 * 1.2)
  assert pay(difference=-0.1)[0] == pytest.approx(base - 0.5 * 0.1)


def test_a_state_that_is_not_finite_is_lost_and_its_reward_is_finite():
  reward, lost = pay(cross_track=np.nan, heading=np.nan)
  assert lost and math.isfinite(reward)


def test_reward_falls_with_the_error_when_both_weights_are_equal():
  task, zero = TrackingTask(path_named("s")), np.zeros(50)
  rewards, _ = rewarded(task, np.linspace(0.0, 0.25, 50), zero, zero, zero)
  assert np.all(np.diff(rewards) <= 0.0) and rewards[0] - rewards[-1] > 10.0


def test_starts_stay_within_their_bounds_and_are_beside_the_path():
  rng = np.random.default_rng(0)
  path = path_named("infinity")
  task = TrackingTask(path, start_offset=0.05, start_heading=0.1, speed=0.7)
  starts = np.stack([task.start_state(rng) for _ in range(200)])
  errors = path.errors(path.nearest(*starts[:, :2].T, near=np.zeros(200)), starts[:, :3], starts[:, 3:5], starts[:, 5])
  assert 0.045 < np.abs(errors.cross_track).max() <= 0.05 + 1e-6
  assert 0.09 < np.abs(errors.heading).max() <= 0.1 + 1e-3
  assert np.all(starts[:, 3] == 0.7) and np.all(starts[:, 4:] == 0.0)


def test_laps_count_on_closed_paths_only():
  assert TrackingTask(path_named("o"), laps=3).distance == pytest.approx(3 * path_named("o").length)
  line = path_from_pieces("line", [(2.0, 0.0, 0.0)])
  assert TrackingTask(line, laps=3).distance == pytest.approx(2.0)
  assert TrackingTask(line, speed=0.5).longest == 500


@pytest.mark.parametrize("wrong", [{"speed": 0.0}, {"period": -0.01}, {"lost": 0.001}])
def test_nonsense_is_refused(wrong):
  with pytest.raises(ValueError, match="positive|swap"):
    TrackingTask(path_named("s"), **wrong)
