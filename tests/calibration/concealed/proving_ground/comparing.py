"""Two sessions against each other."""

import numpy as np


def same(a, b) -> bool:
  """Two sessions' recordings are equal bit for bit."""
  pairs = zip(a.recordings, b.recordings, strict=True)
  return all(
    x.name == y.name and x.channels == y.channels and all(np.array_equal(x[c].value, y[c].value) for c in x.channels)
    for x, y in pairs
  )


def differences(a, b) -> dict[str, float]:
  """Channel -> rms difference of two sessions."""
  return {
    c: float(
      np.sqrt(
        np.mean(np.concatenate([x[c].value - y[c].value for x, y in zip(a.recordings, b.recordings, strict=True)]) ** 2)
      )
    )
    for c in a.recordings[0].channels
  }
