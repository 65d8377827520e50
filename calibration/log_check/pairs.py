"""Two sensors of one motion: how late, how much too large and how far off one is against the other.

  compared(t) = scale * reference(t - lag) + bias

fitted to means over short windows, without a bias where neither can have one. The lag is where the residual is least;
the scale is Deming's, for noise in both (Fuller, Measurement Error Models, 1987, 1.3); deviations are the jackknife's
over blocks of driving (Efron, The Jackknife, the Bootstrap and Other Resampling Plans, 1982). No model of a car takes
part. The lag is sought within 0.5 s, or about where a search over ten seconds puts it (`wide_lag`); one at the edge of
its search is no estimate.

Only differences of ages show: a log whose commands are stamped late looks like one whose sensors speak early.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from calibration.fitting.noise import ChannelNoise
from calibration.log_check.motions import REGIMES, Motion, Wheels, regimes
from calibration.log_check.wide_lag import sums_by_lag, wide_lag
from qcar_twin.recordings.recording import Recording, Stream

Array = NDArray[np.float64]
_STEP = 0.01  # s between windows, and between the lags that are tried
LAGS = np.arange(-0.30, 0.505, _STEP)  # s, about the lag that the wide search gives
_WINDOW = 0.2  # s, at least; three samples of the slower sensor
_BLOCK = 3.0  # s of driving that are left out together: longer than any motion remembers
_LEAST_BLOCKS = 6
_LOUD = 3.0  # times its noise that a motion must be to be compared
_RESTS = 0.01  # m/s, rad/s or m/s^2: a change below it is no motion, however quiet the sensors
_MOVES = 0.1  # m/s or rad/s, from which a sensor alone shows that the car moved
_CORE, _CONCENTRATIONS = 0.75, 5  # share of the blocks that one line has to fit, and rounds of finding them
_ODD = 5.0  # times the median residual, beyond which a block is odd
_HIDES = 4.0  # times as much variance as without the odd blocks: then they hide what the others say
_UNRELATED, _STILL = 1e-9, 1e-30  # a correlation, and a variance in squared units, that are rounding
_NO_LAG = int(np.argmin(np.abs(LAGS)))


@dataclasses.dataclass(frozen=True)
class Estimate:
  """A number and its standard deviation."""

  value: float
  std: float

  def beyond(self, null: float, sigmas: float = 3.0) -> bool:
    """Whether it is further from a number than that many deviations."""
    return abs(self.value - null) > sigmas * self.std


_NOTHING = Estimate(np.nan, np.nan)


@dataclasses.dataclass(frozen=True)
class Comparison:
  """What two sensors of a motion say of each other.

  Attributes:
    lag: s, positive where the compared sensor is late; NaN where it lies at the edge of the search, and what else was
      fitted says nothing.
    scale, bias: of it, in the rate's unit.
    correlation: of the two, at that lag.
    whole: the same without leaving out what is odd.
    felt: share of the reference's motion that the compared sensor shows at that lag, by least squares.
    residual: its rms, in the rate's unit; noise: what their noise explains of it.
    seconds: compared.
    loud: standard deviation of the means, in the rate's unit: the reference's, by geometry the larger of the two.
    levels: noise of both sides' means, in the rate's unit.
    elsewhere: whether at some lag far away the two are more alike than at any near one, so that the lag says nothing.
    odd: s that are unlike all the rest and were left out of the fit: a place that was lost, a frame that was changed.
    where: these are, each a file and seconds on its clock.
    regimes: scale by how the car was driven, where there was enough of it.
    why_not: why they can't be compared; then all else is NaN.
  """

  motion: Motion
  lag: Estimate
  scale: Estimate
  bias: Estimate
  correlation: float
  residual: float
  noise: float
  seconds: float
  regimes: Mapping[str, Estimate]
  whole: float = np.nan
  felt: Estimate = _NOTHING
  loud: float = np.nan
  levels: tuple[float, float] = (np.nan, np.nan)
  elsewhere: bool = False
  odd: float = 0.0
  where: tuple[tuple[str, float, float], ...] = ()
  why_not: str = ""


def compare(
  motion: Motion, wheels: Wheels, recordings: Sequence[Recording], noise: Mapping[str, ChannelNoise]
) -> Comparison:
  """Compare the two sensors of a motion over all recordings that hold both."""
  names = [n for n in (*motion.compared, *motion.reference) if n in noise]
  window = max(_WINDOW, 3.0 / min(noise[n].rate for n in names))
  levels = motion.noise(noise, window)
  held = [r for r in recordings if motion.measured_in(r)]
  centre, elsewhere = _centre(motion, wheels, held, window)
  moved = centre if motion.acts else 0.0
  held = [_acted_later(r, motion.reference[0], moved) for r in held] if moved else held
  lags = LAGS + centre - moved
  blocks = [b for r in held for b in _blocks(motion, wheels, r, window, lags)]
  if len(blocks) < _LEAST_BLOCKS:
    return _unknown(motion, f"less than {_LEAST_BLOCKS * _BLOCK:g} s hold both", len(blocks) * _BLOCK)
  sums = np.stack([sums for sums, _, _ in blocks])
  loud = float(np.std(np.concatenate([reference for _, reference, _ in blocks])))
  own = _spread(sums[:, _NO_LAG]) if motion.kinematic else 0.0
  if loud < max(_LOUD * levels[1], _RESTS) and own < max(_LOUD * levels[0], _MOVES):
    said = f"the motion ({loud:.2g} {motion.unit}) is not {_LOUD:g} times the reference's noise ({levels[1]:.2g})"
    return _unknown(motion, said, len(blocks) * _BLOCK)
  ratio = (levels[0] / levels[1]) ** 2
  fitted = lambda s: _fit(s, ratio, lags, motion.unbiased)
  good = _alike(sums, fitted, lags)
  fit, spread = _jackknifed(sums[good], fitted)
  lag, scale, bias = (Estimate(float(v), float(s)) for v, s in zip(fit[:3], spread[:3], strict=True))
  inside = lags[1] < lag.value < lags[-2]
  return Comparison(
    motion=motion,
    lag=dataclasses.replace(lag, value=lag.value + moved) if inside else _NOTHING,
    scale=scale,
    bias=bias,
    correlation=float(fit[4]),
    whole=float(fitted(sums.sum(axis=0)[None])[0, 4]),
    felt=Estimate(float(fit[5]), float(spread[5])),
    residual=float(fit[3]),
    noise=float(np.hypot(levels[0], scale.value * levels[1])),
    seconds=len(blocks) * _BLOCK,
    regimes=_by_regime(motion, wheels, held, window, lag.value, ratio),
    loud=max(loud, own),
    levels=levels,
    elsewhere=elsewhere and centre == 0.0,
    odd=float(np.sum(~good)) * _BLOCK,
    where=tuple(span for (_, _, span), alike in zip(blocks, good, strict=True) if not alike),
  )


def _centre(motion: Motion, wheels: Wheels, recordings: Sequence[Recording], window: float) -> tuple[float, bool]:
  """The lag about which to search, s: 0, unless far away the two are much better alike; and whether they are better
  alike there at all."""
  sums = []
  for recording in recordings:
    begin = np.arange(recording.start, recording.end - window, 5.0 * _STEP)
    y, x = motion.of_compared(recording)(begin, window), motion.of_reference(recording)(begin, window)
    y = np.where(np.isin(regimes(wheels, recording, begin, window), motion.within), y, np.nan)
    by = None
    if motion.acts:
      x, by = (means(begin, window) for means in motion.acts(recording))
    if len(begin) > 1:
      sums.append(sums_by_lag(x, y, by))
  if not sums:
    return 0.0, False
  return wide_lag(sums, lambda s: _line(s, 1.0)[..., 3], 5.0 * _STEP, (LAGS[0], LAGS[-1]))


def _acted_later(recording: Recording, command: str, seconds: float) -> Recording:
  """The recording with the stamps of a command moved on."""
  stream = recording[command]
  moved = Stream(stream.time + seconds, stream.value)
  return dataclasses.replace(recording, streams={**recording.streams, command: moved})


def _blocks(
  motion: Motion, wheels: Wheels, recording: Recording, window: float, lags: Array
) -> list[tuple[Array, Array, tuple[str, float, float]]]:
  """Of every few seconds of a recording: sums over windows for every lag, (lags, 6), the reference's means, and where
  they are: file and seconds.

  Lags are as far apart as windows are, so that the reference's means at all lags are the same ones, moved.
  """
  first, last = recording.start - min(lags[0], 0.0), recording.end - window - max(lags[-1], 0.0)
  begin = np.arange(first, last, _STEP)
  if len(begin) < 2:
    return []
  compared = motion.of_compared(recording)(begin, window)
  at = begin[0] - lags[-1] + _STEP * np.arange(len(begin) + len(lags) - 1)
  shifted = sliding_window_view(motion.of_reference(recording)(at, window), len(lags))[:, ::-1]  # (k, lags)
  known = np.isfinite(compared) & np.isfinite(shifted).all(axis=1)
  known &= np.isin(regimes(wheels, recording, begin, window), motion.within)
  number, made = np.floor((begin - begin[0]) / _BLOCK), []
  for rows in _runs(number):
    rows = rows[known[rows]]
    if rows.size * _STEP >= 0.2 * _BLOCK:
      span = (recording.file or recording.name, float(begin[rows[0]]), float(begin[rows[-1]] + window))
      made.append((_sums(shifted[rows].T, compared[rows]), shifted[rows, _NO_LAG], span))
  return made


def _runs(label: Array) -> list[NDArray[np.intp]]:
  """Rows of each stretch of one label."""
  return np.split(np.arange(len(label)), np.flatnonzero(label[1:] != label[:-1]) + 1)


def _sums(x: Array, y: Array) -> Array:
  """Count, sums and sums of products of x, (..., k), and y, (k,) -> (..., 6)."""
  one, both = np.ones_like(x), np.broadcast_to(y, x.shape)
  return np.stack([np.sum(a, axis=-1) for a in (one, x, both, x * x, x * both, both * both)], axis=-1)


def _fit(sums: Array, ratio: float, lags: Array, unbiased: bool) -> Array:
  """Lag, scale, bias, rms residual, correlation and slope from sums, (n, lags, 6) -> (n, 6)."""
  lines = _line(sums, ratio, unbiased)
  strength, rows = np.abs(lines[..., 3]), np.arange(len(sums))
  best = np.argmax(strength, axis=1)
  return np.column_stack([_vertex(strength, best, lags), lines[rows, best]])


def _spread(sums: Array) -> float:
  """Standard deviation of the compared sensor's means from sums of blocks, (n, 6)."""
  count, _, y, _, _, yy = sums.sum(axis=0)
  return float(np.sqrt(max(yy / count - (y / count) ** 2, 0.0)))


def _alike(sums: Array, fit: Callable[[Array], Array], lags: Array) -> NDArray[np.bool_]:
  """Blocks that one line fits, (n,): all, unless few are so far off that they hide what the rest says.

  Least trimmed squares over three quarters of the blocks (Rousseeuw and Van Driessen, Data Mining and Knowledge
  Discovery 12, 2006); a block is odd beyond so many times their median residual.
  """
  core = np.arange(len(sums))
  for _ in range(_CONCENTRATIONS):
    residual = _residual(sums, fit(sums[core].sum(axis=0)[None])[0], lags)
    core = np.argsort(residual)[: int(np.ceil(_CORE * len(sums)))]
  good = np.less_equal(residual, _ODD * np.median(residual))
  whole = _residual(sums, fit(sums.sum(axis=0)[None])[0], lags)
  hidden = np.mean(whole**2) > _HIDES * np.mean(residual[good] ** 2)
  return np.asarray(good) if hidden and np.mean(good) >= _CORE else np.ones(len(sums), dtype=np.bool_)


def _residual(sums: Array, fit: Array, lags: Array) -> Array:
  """Rms residual of each block about a line, (n,)."""
  scale, bias = fit[1], fit[2]
  near = int(np.argmin(np.abs(lags - fit[0])))
  n, x, y, xx, xy, yy = np.moveaxis(sums[:, near], -1, 0)
  squares = yy + scale**2 * xx + n * bias**2 - 2.0 * (scale * xy + bias * y - scale * bias * x)
  return np.sqrt(np.maximum(squares / n, 0.0))


def _line(sums: Array, ratio: float, unbiased: bool = False) -> Array:
  """Deming's line: scale, bias, rms residual, correlation and the slope of least squares, (..., 6) -> (..., 5).

  Args:
    ratio: variance of the compared sensor's noise over that of the reference's.
    unbiased: whether the line goes through zero; correlation and slope are about the means all the same.
  """
  count, x, y, xx, xy, yy = np.moveaxis(sums, -1, 0)
  mx, my = x / count, y / count
  sxx, sxy, syy = xx / count - mx**2, xy / count - mx * my, yy / count - my**2
  correlation, slope = sxy / np.sqrt(np.maximum(sxx * syy, 1e-300)), sxy / np.maximum(sxx, _STILL)
  if unbiased:
    mx, my, sxx, sxy, syy = 0.0 * mx, 0.0 * my, xx / count, xy / count, yy / count
  apart, least = syy - ratio * sxx, _UNRELATED * np.sqrt(np.maximum(sxx, _STILL) * np.maximum(syy, _STILL))
  safe = np.where(np.abs(sxy) > least, sxy, least)
  scale = (apart + np.sqrt(apart**2 + 4.0 * ratio * sxy**2)) / (2.0 * safe)
  residual = np.sqrt(np.maximum(syy - 2.0 * scale * sxy + scale**2 * sxx, 0.0))
  return np.stack([scale, my - scale * mx, residual, correlation, slope], axis=-1)


def _vertex(height: Array, best: NDArray[np.intp], lags: Array) -> Array:
  """Lags at the tops of parabolas through the best lag and its neighbours, s, (n,)."""
  rows, i = np.arange(len(height)), np.clip(best, 1, len(lags) - 2)
  before, top, after = height[rows, i - 1], height[rows, i], height[rows, i + 1]
  bend = np.minimum(before - 2.0 * top + after, -1e-15)
  return lags[i] + np.clip(0.5 * (before - after) / bend, -1.0, 1.0) * _STEP


def _jackknifed(sums: Array, fit: Callable[[Array], Array]) -> tuple[Array, Array]:
  """An estimate from the sums of all blocks, (n, ...), and its standard deviation."""
  total = sums.sum(axis=0)
  return fit(total[None])[0], jackknife_std(fit(total[None] - sums))


def jackknife_std(without: Array) -> Array:
  """Standard deviation of an estimate by what it is without each block, (n, ...) -> (...)."""
  count = len(without)
  return np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0))


def _by_regime(
  motion: Motion, wheels: Wheels, recordings: Sequence[Recording], window: float, lag: float, ratio: float
) -> dict[str, Estimate]:
  """Scale at the common lag, by how the car was driven in each window."""
  sums: dict[str, list[Array]] = {}
  for recording in recordings:
    begin = np.arange(recording.start + max(lag, 0.0), recording.end - window, _STEP)
    y, x = motion.of_compared(recording)(begin, window), motion.of_reference(recording)(begin - lag, window)
    known, regime = np.isfinite(x) & np.isfinite(y), regimes(wheels, recording, begin, window)
    number = np.floor((begin - recording.start) / _BLOCK)
    for rows in _runs(number):
      rows = rows[known[rows]]
      for name in np.unique(regime[rows]):
        of_it = rows[regime[rows] == name]
        sums.setdefault(str(name), []).append(_sums(x[of_it], y[of_it]))
  line = lambda s: _line(s, ratio, motion.unbiased)
  enough = {name: np.stack(sums[name]) for name in REGIMES if len(sums.get(name, ())) >= _LEAST_BLOCKS}
  return {n: Estimate(*(float(v[0]) for v in _jackknifed(s, line))) for n, s in enough.items()}


def _unknown(motion: Motion, why: str, seconds: float) -> Comparison:
  return Comparison(motion, _NOTHING, _NOTHING, _NOTHING, np.nan, np.nan, np.nan, seconds, {}, why_not=why)
