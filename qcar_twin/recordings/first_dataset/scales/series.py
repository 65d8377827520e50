"""What rows of numbers do: how often a clock goes back, how long values stay, how alike two are."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_LEAST = 10  # runs, from which a habit of the log is read


def behind(steps: Array) -> int:
  """Rows of a clock with these steps, (k - 1,), that are behind one before them: after a restart nearly all."""
  passed = np.r_[0.0, np.cumsum(steps)]
  return int(np.sum(passed < np.maximum.accumulate(passed)))


def correlation(a: Array, b: Array, least: int = 2) -> float:
  """Of the pairs that are both known, (k,) each; 0 where those are fewer than `least`, or one of them is constant."""
  both = np.isfinite(a) & np.isfinite(b)
  if both.sum() < least or a[both].std() == 0.0 or b[both].std() == 0.0:
    return 0.0
  return float(np.corrcoef(a[both], b[both])[0, 1])


def usual_run(columns: Iterable[Array], least: int = _LEAST) -> float:
  """Rows for which one value stays, median over the runs that begin and end within a log; 1 where there are few."""
  lengths = []
  for values in columns:
    there = values[np.isfinite(values)]
    starts = np.flatnonzero(np.r_[True, there[1:] != there[:-1]])
    lengths.append(np.diff(starts)[1:])
  runs = np.concatenate(lengths) if lengths else np.empty(0)
  return float(np.median(runs)) if runs.size >= least else 1.0
