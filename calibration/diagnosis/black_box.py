"""What no law of a car is needed for: boosted trees on a twin's residual.

A reference, not a floor: on minutes of driving trees learn less than the right law would.
"""

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from calibration.diagnosis.circumstances import at_values, commands_and_state
from calibration.fitting.observations import CHANNELS, Observations
from qcar_twin.plant import Prediction

Array = NDArray[np.float64]


def boosted_residual(
  observations: Observations,
  prediction: Prediction,
  raw: Array,
  others: Observations,
  other_prediction: Prediction,
  other_raw: Array,
) -> Array:
  """What is left of other recordings' residuals once trees have taken off what they learnt, (M',).

  Where the twin flies apart there is nothing to learn; of a channel of which that is all, nothing is taken off.

  Args:
    observations, prediction, raw: recordings to learn from: the twin's signals (one vector) and
      predicted minus measured, (M,).
    others, other_prediction, other_raw: recordings to judge on.
  """
  grid, other_grid = commands_and_state(observations, prediction), commands_and_state(others, other_prediction)
  left = other_raw.copy()
  for name in set(observations.present) & set(others.present):
    rows, there = observations.select(name), others.select(name)
    usable = np.isfinite(raw[rows])
    if not usable.any():
      continue
    trees = HistGradientBoostingRegressor(
      max_iter=150, learning_rate=0.06, max_leaf_nodes=15, min_samples_leaf=40, l2_regularization=1.0, random_state=0
    )
    # on one thread: those of OpenMP wait for one another by spinning, tens of times as long where cores are busy
    with threadpool_limits(1, user_api="openmp"):
      trees.fit(at_values(grid, observations, name)[usable], raw[rows][usable])
      left[there] = other_raw[there] - trees.predict(at_values(other_grid, others, name))
  return left


def rms(observations: Observations, raw: Array) -> dict[str, float]:
  """Root mean square per channel."""
  return {
    CHANNELS[i]: float(np.sqrt(np.mean(raw[observations.channel == i] ** 2))) for i in np.unique(observations.channel)
  }
