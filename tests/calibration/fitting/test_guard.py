"""Where MuJoCo refuses a step that the surrogate promised, the fewest stretches are left to it."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.fitting import recalibration
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


@dataclasses.dataclass(frozen=True)
class Minimum:
  theta: np.ndarray
  cost: float
  residual: np.ndarray


class Astray:
  """A problem whose surrogate promises 50 nats, of which MuJoCo finds 10, once; it is nothing else."""

  parameters = SimpleNamespace(nominal=np.zeros(1))
  exact = None

  def __init__(self):
    self.left = []

  def embed(self, names, values, nominal):
    return np.atleast_2d(values)

  def at(self, theta):
    return self

  def guarding(self, stretches):
    self.left.extend(stretches)
    return self

  def fitted_residual(self, theta):
    return np.zeros((1, 1))


@pytest.mark.parametrize("guard", [True, False])
def test_a_search_that_may_not_leave_anything_to_mujoco_ends_where_it_no_longer_confirms(monkeypatch, guard):
  """What it did confirm is kept either way."""
  costs = {0.0: 100.0, 1.0: 90.0}
  monkeypatch.setattr(recalibration, "_cost", lambda problem, base, theta: costs[float(theta[0])])
  tries = iter([Minimum(TRIED - 1.0, 50.0, np.zeros(1)), *[Minimum(TRIED - 1.0, 90.0, np.zeros(1))] * 2])
  monkeypatch.setattr(recalibration, "_fit", lambda *_args: next(tries))
  monkeypatch.setattr(recalibration, "misled", lambda *_args: [SPIN])
  known = SimpleNamespace(forget=lambda: None)
  problem = Astray()
  _, least = recalibration.descended(problem, SimpleNamespace(names=("p",)), START, 10.0, known, guard)
  assert (least.theta, least.cost) == (1.0, 90.0)
  assert problem.left == ([SPIN, SPIN] if guard else [])  # the problem at the anchor, and the one at the step
  assert len(list(tries)) == (0 if guard else 2)
