"""Where MuJoCo refuses a step that the surrogate promised, the fewest stretches are left to it."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.fitting.likelihood import misled

SIZE = 10  # values of a stretch
STRAIGHT, SPIN, CIRCLE = ("straight", 0.0), ("circle", 0.0), ("circle", 6.0)
START, TRIED = np.array([0.0]), np.array([2.0])


class Linear:
  """Residuals of three stretches that go with one parameter: 3 at its start, sloping by so much in each."""

  def __init__(self, slopes, exact=None):
    segments = SimpleNamespace(recording=("straight", "circle", "circle"), offset=np.array([0.0, 0.0, 6.0]))
    self.observations = SimpleNamespace(
      stretch=np.repeat(np.arange(3), SIZE), stretches=SimpleNamespace(segments=segments)
    )
    self.n_train = 3 * SIZE
    self.exact = exact or self
    self._slopes = np.repeat(np.asarray(slopes, float), SIZE)

  def fitted_residual(self, theta):
    return 3.0 + theta[:, :1] * self._slopes


@pytest.mark.parametrize(
  ("slopes", "left"),
  [
    ((-1.0, 1.0, -0.9), [SPIN]),
    ((-1.0, 1.0, 1.2), [CIRCLE, SPIN]),
    ((-0.2, -0.05, -0.2), [SPIN]),
    ((1.0, 1.0, 1.0), [STRAIGHT, SPIN, CIRCLE]),
  ],
)
def test_the_fewest_stretches_without_which_the_step_is_confirmed(slopes, left):
  assert misled(Linear((-1.0, -1.0, -1.0), Linear(slopes)), START, TRIED) == left


def slope(nats):
  """Of a stretch that comes down by so many nats on the way."""
  return 0.5 * (np.sqrt(9.0 - 2.0 * nats / SIZE) - 3.0)


def test_near_a_minimum_one_stretch_is_not_left_for_what_nobody_would_notice():
  """Without the stretch that misled, 2 nats are promised as 5 less 3, and MuJoCo says 5 too many."""
  promised, kept = ([slope(n) for n in nats] for nats in ((5.0, 20.0, -3.0), (1.0, -20.0, -6.0)))
  assert misled(Linear(promised, Linear(kept)), START, TRIED) == [SPIN]
