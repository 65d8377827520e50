"""Whether a filter's covariances are those of its errors, block by block of its state.

The normalised squared error of a block of d states has the mean d. Its mean over N cars at one instant is
chi^2(d N) / N (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, Wiley 2001,
section 5.4.2): 95 % of the instants lie within that band. Above it the filter believes too much, below too little.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from qcar_twin import markdown

Array = NDArray[np.float64]
BLOCKS = {"position": 2, "yaw": 1, "speed": 1, "sideslip": 1, "yaw rate": 1}  # and how many states they are
CONFIDENCE = 0.95


def block_nees(position: Array, errors: Array, variances: Array) -> Array:
  """Normalised squared errors by block, (..., 5).

  Args:
    position: that of the position, (...).
    errors, variances: of yaw rad, speed m/s, sideslip rad, yaw rate rad/s, (..., 4).
  """
  return np.concatenate([position[..., None], errors**2 / variances], axis=-1)


def band(states: int, cars: int) -> tuple[float, float]:
  """Of the mean over so many cars of the normalised squared error of so many states."""
  tail = 0.5 * (1.0 - CONFIDENCE)
  low, high = chi2.ppf([tail, 1.0 - tail], states * cars) / cars
  return float(low), float(high)


def consistency_table(kinds: Mapping[tuple[str, str], Sequence[Array]]) -> list[str]:
  """A table of blocks: mean, and the share of instants within the band, by filter and linkage.

  Args:
    kinds: of each filter and linkage: of several drives (T, N, 5); their cars are judged together while all drive.
  """
  rows, cars = [], 0
  for (name, how), drives in kinds.items():
    shortest = min(len(one) for one in drives)
    together = np.concatenate([one[:shortest] for one in drives], axis=1)
    cars, means = together.shape[1], together.mean(axis=1)
    cells = []
    for column, states in zip(means.T, BLOCKS.values(), strict=True):
      low, high = band(states, cars)
      cells.append(f"{column.mean():.2f} ({100.0 * np.mean((column > low) & (column < high)):.0f} %)")
    rows.append((name, how, *cells))
  bands = {name: band(states, cars) for name, states in BLOCKS.items()}
  titles = [f"{name} [{low:.2f}, {high:.2f}]" for name, (low, high) in bands.items()]
  return [
    f"NEES by block of the state: its mean over {cars} cars of all paths and over time, and in brackets the share of"
    f" instants at which the cars' mean lies within its {100.0 * CONFIDENCE:.0f} % band, in the head of the column."
    " Position is the master's, 2 for a consistent filter, the rest EKF_BM's, 1. Below the band a filter believes too"
    " little, above too much.",
    "",
    *markdown.table(("filter", "linkage", *titles), rows),
  ]
