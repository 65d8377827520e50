"""Hypotheses weighed by linear algebra, on made-up Gaussian data."""

import numpy as np

from calibration.likelihood.hypotheses import weigh

WINDOWS, ROWS = 300, 10
BLOCKS = np.arange(WINDOWS) // 10


def weighed(effect: float, seed: int = 0, names: int = 20):
  rng = np.random.default_rng(seed)
  base, columns = rng.normal(size=(WINDOWS, ROWS, 3)), rng.normal(size=(WINDOWS, ROWS, names))
  residual = rng.normal(size=(WINDOWS, ROWS)) + effect * columns[..., 4] + base @ np.array([0.1, 0.0, -0.2])
  flat = base.reshape(-1, 3)
  precision = flat.T @ flat + np.eye(3)
  # the base at its own minimum
  move = np.asarray(np.linalg.solve(precision, flat.T @ residual.ravel()), dtype=np.float64)
  where = [slice(i, i + 1) for i in range(names)]
  return weigh(base, precision, -move, BLOCKS, residual - base @ move, columns, where, np.ones(names),
               np.zeros(names, dtype=bool), 600, seed)  # fmt: skip


def test_the_effect_that_is_there_comes_first_with_its_size():
  found = weighed(0.2)
  assert int(np.argmax(found.gain)) == 4
  assert np.isclose(found.size[4][0], 0.2, atol=0.06)
  assert found.gain[4] > np.quantile(found.chance, 0.98)


def test_without_an_effect_the_level_is_exceeded_as_seldom_as_stated():
  exceeded = [w.gain.max() > np.quantile(w.chance, 0.9) for w in (weighed(0.0, seed) for seed in range(60))]
  assert 0 <= np.sum(exceeded) <= 15  # binomial, 60 at 0.1: 6 on average, 15 once in 3000


def test_a_strong_effect_does_not_raise_its_own_level():
  weak, strong = (np.quantile(weighed(effect).chance, 0.98) for effect in (0.0, 3.0))
  assert strong < 2.0 * weak


def test_a_one_sided_amplitude_of_the_wrong_sign_is_worth_nothing():
  rng = np.random.default_rng(1)
  column = rng.normal(size=(WINDOWS, ROWS, 1))
  residual = -0.5 * column[..., 0] + rng.normal(size=(WINDOWS, ROWS))
  base = np.zeros((WINDOWS, ROWS, 1))
  found = weigh(base, np.eye(1), np.zeros(1), BLOCKS, residual, column, [slice(0, 1)], np.ones(1), np.ones(1, bool), 50)
  assert found.gain[0] < 0.0
