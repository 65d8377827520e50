"""Lags of seconds: two sensors' means correlated over ten seconds either way, by FFT.

For every lag the sums over the windows where both have a value are exact (Padfield, Masked object registration in the
Fourier domain, IEEE Trans. Image Process. 21, 2012), so that gaps and the ends of a recording take no part.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_STEPS = 200  # windows that the one is moved either way: 10 s of windows every 0.05 s
_ALIKE = 0.95  # correlation that makes a far lag believable
_BETTER = 0.5  # of the variance that the best near lag leaves unexplained: at most so much is left at a far one
_HALF = 0.5  # of the windows must take part in a lag


def sums_by_lag(x: Array, y: Array, by: Array | None = None) -> Array:
  """Count, sums and sums of products of y(i) and by(i) x(i - lag), (lags, 6), of lags -_STEPS ... _STEPS; NaN takes no
  part.

  Args:
    x, y: means of the reference and of the compared sensor in windows at equal distances, (k,).
    by: what the reference is multiplied by where it acts, (k,), and which has the clock of `y`; ones where absent.
  """
  by = np.ones(len(y)) if by is None else by
  mx, my = np.isfinite(x).astype(float), (np.isfinite(y) & np.isfinite(by)).astype(float)
  x, y, by = np.where(mx > 0.0, x, 0.0), np.where(my > 0.0, y, 0.0), np.where(my > 0.0, by, 0.0)
  size = 1 << int(np.ceil(np.log2(len(x) + _STEPS + 1)))
  of = lambda a: np.fft.rfft(a, size)
  pair = lambda a, b: np.fft.irfft(of(a) * np.conj(of(b)), size)[np.arange(-_STEPS, _STEPS + 1)]
  products = (pair(my, mx), pair(by, x), pair(y, mx), pair(by * by, x * x), pair(y * by, x), pair(y * y, mx))
  return np.stack(products, axis=-1)


def wide_lag(
  sums: Sequence[Array], correlate: Callable[[Array], Array], step: float, near: tuple[float, float]
) -> tuple[float, bool]:
  """The lag far away at which two sensors agree much better than at any other, or to which they agree the better the
  nearer it comes, s; 0 where there is none, as where driving repeats itself. And whether at some lag far away they
  agree better, be it little, than at any near one.

  Args:
    sums: of each recording, (lags, 6).
    correlate: from sums (lags, 6) to correlations (lags,).
    step: s between lags.
    near: lags that are searched anyway, s.
  """
  total = np.sum(sums, axis=0)
  lags, count = step * np.arange(-_STEPS, _STEPS + 1), total[:, 0]
  enough = count >= max(_HALF * float(count[_STEPS]), 2.0)
  if not enough[_STEPS]:
    return 0.0, False
  alike = np.where(enough, correlate(np.where(enough[:, None], total, total[_STEPS])), 0.0)
  explained = alike**2
  inside = (lags >= near[0]) & (lags <= near[1])
  best = int(np.argmax(np.where(inside, 0.0, explained)))
  apart = np.abs(lags - lags[best]) > near[1] - near[0]
  far, other = float(explained[best]), float(explained[inside | apart].max())
  clear = far > _ALIKE**2 and 1.0 - far < _BETTER * (1.0 - other)
  nearest = int(np.argmax(np.where(inside, explained, 0.0)))
  # of sensors that speak once a second the peak is wide: one whose foot lies in what is searched is no other lag
  foot = explained[min(nearest, best) : max(nearest, best) + 1][:: 1 if best > nearest else -1]
  clear = clear or bool(far > _ALIKE**2 and (np.diff(foot) >= 0.0).all())
  # curves that change sides repeat themselves half a period on, with the other sign
  clear = clear and (explained[nearest] < _ALIKE**2 or alike[best] * alike[nearest] > 0.0)
  return float(lags[best]) if clear else 0.0, far > float(explained[inside].max())
