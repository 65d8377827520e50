"""How two files' clocks lie to each other, by the motion that both of them saw, or that one commanded."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.checks.time import turn_of
from qcar_twin.recordings.first_dataset.columns import Columns, Guess

Array = NDArray[np.float64]
PERIOD = 0.05  # s, of the grid on which motions are compared
_SMOOTH = 5  # points, 0.25 s, over which noise of a place is averaged away
_MOST = 1 << 18  # points, 3.6 h: of a longer log the beginning is compared
_OVERLAP = 0.5  # of the shorter file, that two files of one drive share
# share of the variance that noise has at most: of white noise averaged over 5 points neighbours differ by 2/5 of it
_NOISE = 0.5
_LATE = 0.5  # s, within which a car obeys: so far a lag that its commands gave may be out
_FELT = 0.5  # correlation of what two sensors of one motion felt, by which a lag is told; noise and slopes are in it
_LEAST = 60  # points, 3 s, that a correlation is worth


@dataclass(frozen=True)
class Motion:
  """Speed and turning from `start` on, s, on a grid, (k,), in any unit; NaN where unknown. None where nothing tells.

  Attributes:
    sensed: whether speed, and whether turning, was measured and not commanded.
    pushes: what accelerometers felt, (k,) each, along unknown axes.
  """

  start: float
  end: float
  speed: Array | None
  turning: Array | None
  sensed: tuple[bool, bool] = (True, True)
  pushes: tuple[Array, ...] = ()

  @property
  def size(self) -> int:
    """Points of its grid; 0 where nothing tells."""
    return max((len(values) for values in (self.speed, self.turning) if values is not None), default=0)


@dataclass(frozen=True)
class Fit:
  """How alike two motions are at their best.

  Attributes:
    alike: correlation at the best lag; NaN where nothing is compared.
    lag: s, to be added to the second file's clock.
    as_stamped: correlation where both clocks are taken as they are; NaN where they share too little time.
    again: the best correlation more than a second away from the best lag.
    commanded: whether commands alone tell the lag, which then has in it what the car takes to obey.
  """

  alike: float
  lag: float
  as_stamped: float
  again: float
  commanded: bool = False


def motion_of(columns: Columns, guesses: Mapping[str, Guess]) -> Motion:
  """What one file says of how the car moved: by its sensors or its path, else by its commands."""
  clock = guesses["time"]
  time = clock.scale * columns.tables[0].number(clock.column, "time")
  grid = np.arange(time[0], time[-1], PERIOD)[:_MOST]
  on_grid = lambda values: _on_grid(grid, time, values)
  known = {  # a pulse of 1500 us is straight on, and stands for 0
    channel: guess.scale * columns.tables[0].number(guess.column, channel) + guess.offset
    for channel, guess in guesses.items()
    if channel != "time"
  }
  speed = turning = None
  sensed = [True, True]
  if (wheels := next((known[c] for c in ("speed", "motor_speed") if c in known), None)) is not None:
    speed = np.abs(on_grid(wheels))
  elif {"pose_x", "pose_y"} <= known.keys():
    x, y = (_smooth(on_grid(known[name])) for name in ("pose_x", "pose_y"))
    speed = np.hypot(np.gradient(x), np.gradient(y))
  elif (drive := next((known[c] for c in DRIVE_COMMANDS if c in known), None)) is not None:
    speed, sensed[0] = np.abs(on_grid(drive)), False
  if "yaw_rate" in known:
    turning = on_grid(known["yaw_rate"])
  elif "pose_yaw" in known:
    turning = np.gradient(_smooth(on_grid(_unwrapped(known["pose_yaw"]))))
  elif "steering_command" in known:
    turning, sensed[1] = on_grid(known["steering_command"]) * (speed if speed is not None else 1.0), False
  pushes = tuple(_smooth(on_grid(known[name])) for name in ("accel_x", "accel_y") if name in known)
  smooth = lambda values: None if values is None else _smooth(values)
  return Motion(float(time[0]), float(time[-1]), smooth(speed), smooth(turning), (sensed[0], sensed[1]), pushes)


def _unwrapped(angle: Array) -> Array:
  there = np.isfinite(angle)
  known = angle[there]
  period = turn_of(known)
  whole = np.full(angle.size, np.nan)
  whole[there] = np.unwrap(known, period=period) if period else known
  return whole


def _on_grid(grid: Array, time: Array, values: Array) -> Array:
  there = np.isfinite(values)
  if not there.any():
    return np.full(grid.size, np.nan)
  return np.interp(grid, time[there], values[there], left=np.nan, right=np.nan)


def _smooth(values: Array) -> Array:
  if values.size < _SMOOTH:
    return values
  return np.convolve(np.pad(values, _SMOOTH // 2, mode="edge"), np.full(_SMOOTH, 1.0 / _SMOOTH), "valid")


def fit(one: Motion, other: Motion, turned: int = 0) -> Fit:
  """The lag at which two files' speed and turning go together best. Where something was sensed in both, that says the
  last half second of it: a car lags behind its commands. `turned`: 1 where both count turning one way, -1 where they
  count it against each other, 0 where it is unknown, and signs of turning are left aside."""
  scores = [_signed(r, turned) if turning else r for turning, r in _each(one, other)]
  if not scores:
    return Fit(np.nan, 0.0, np.nan, np.nan)
  count = max(len(r) for r in scores)
  mean = _mean([r for r in scores if len(r) == count])
  if not np.isfinite(mean).any():
    return Fit(np.nan, 0.0, np.nan, np.nan)
  lags = PERIOD * (np.arange(count) - (count - one.size)) + one.start - other.start
  best = int(np.nanargmax(mean))
  far = np.abs(lags - lags[best]) > 1.0
  at_zero = int(np.argmin(np.abs(lags)))
  stamped = float(mean[at_zero]) if abs(lags[at_zero]) <= PERIOD else np.nan
  again = float(np.nanmax(mean[far])) if np.isfinite(mean[far]).any() else np.nan
  near = np.abs(lags - lags[best]) < _LATE
  sensed = _sensed(one, other, near, turned) if not all((*one.sensed, *other.sensed)) else None
  fine, at = (mean, best) if sensed is None or len(sensed) != count else (sensed, int(np.nanargmax(sensed)))
  lag = float(lags[at]) + PERIOD * _top(fine[at - 1 : at + 2])
  return Fit(float(mean[best]), lag, stamped, again, sensed is None and not all((*one.sensed, *other.sensed)))


def _signed(correlation: Array, turned: int) -> Array:
  """Correlation of two turnings, (k,), as it counts."""
  return turned * correlation if turned else abs(correlation)


def _sensed(one: Motion, other: Motion, near: NDArray[np.bool_], turned: int) -> Array | None:
  """Mean correlation of what was measured in both, a wheel's speeding up and an accelerometer too, at the lags that are
  `near`, (k,), NaN at others; None where nothing was, or hardly goes together."""
  known = [
    _signed(r, turned) if turning else r
    for turning, r in _each(one, other)
    if one.sensed[turning] and other.sensed[turning]
  ]
  for a, b, turned_round in ((one, other, False), (other, one, True)):
    if a.speed is None or not a.sensed[0] or not b.pushes:
      continue
    gain = np.gradient(a.speed)
    felt = [correlations(*((push, gain) if turned_round else (gain, push)), _LEAST) for push in b.pushes]
    felt = [np.abs(r) for r in felt if len(r) == near.size and np.isfinite(r[near]).any()]
    known += [max(felt, key=lambda r: float(np.nanmax(r[near])))] if felt else []
  known = [np.where(near, r, np.nan) for r in known if len(r) == near.size]
  known = [r for r in known if np.isfinite(r).any() and np.nanmax(r) > _FELT]
  return _mean(known) if known else None


def _mean(scores: list[Array]) -> Array:
  """Of those that are known at each lag, (k,); NaN where none is."""
  both = np.stack(scores)
  known = np.isfinite(both).sum(axis=0)
  return np.nansum(both, axis=0) / np.where(known > 0, known, np.nan)


def _top(three: Array) -> float:
  """Where the parabola through three values, of which the middle one is the largest, has its top, in steps from it."""
  if three.size < 3 or not np.isfinite(three).all() or (bent := three[0] - 2.0 * three[1] + three[2]) == 0.0:
    return 0.0
  return float(np.clip(0.5 * (three[0] - three[2]) / bent, -0.5, 0.5))


def _each(one: Motion, other: Motion) -> Iterator[tuple[bool, Array]]:
  """Whether it is turning, and the correlations at every lag, of each motion that both have."""
  for a, b, turning in ((one.speed, other.speed, False), (one.turning, other.turning, True)):
    if a is not None and b is not None and min(a.size, b.size) >= _LEAST and _tells(a) and _tells(b):
      yield turning, correlations(a, b, max(_LEAST, int(_OVERLAP * min(a.size, b.size))))


def _tells(values: Array) -> bool:
  """Whether a motion, smoothed, is more than its noise: a speed that is kept, or a way straight on, tells nothing."""
  spread = float(np.nanvar(values))
  return spread > 0.0 and float(np.nanmean(np.diff(values) ** 2)) < _NOISE * 2.0 / _SMOOTH * spread


def correlations(a: Array, b: Array, least: int) -> Array:
  """Correlation of a with b at every shift of b, (len(a) + len(b) - 1,), the first with b's end on a's beginning; NaN
  where they share fewer than `least` points that are known."""
  count = a.size + b.size - 1
  size = 1 << int(np.ceil(np.log2(count)))
  known = [np.isfinite(v).astype(float) for v in (a, b)]
  filled = [np.where(k > 0.0, v - np.nanmean(v), 0.0) for v, k in zip((a, b), known, strict=True)]
  spectra = [  # by file of what is known, its values and their squares
    [np.fft.rfft(v, size) for v in (k[::turn], f[::turn], f[::turn] ** 2)]
    for k, f, turn in zip(known, filled, (1, -1), strict=True)
  ]
  slid = lambda v, w: np.fft.irfft(spectra[0][v] * spectra[1][w], size)[:count]
  shared = np.round(slid(0, 0))
  enough = np.maximum(shared, 1.0)
  sums = slid(1, 0), slid(0, 1)
  squares = slid(2, 0), slid(0, 2)
  spread = [np.maximum(square - total**2 / enough, 0.0) for square, total in zip(squares, sums, strict=True)]
  product = slid(1, 1) - sums[0] * sums[1] / enough
  loud = [s > 1e-3 * float(s.max()) for s in spread]  # a stretch in which nothing changes tells nothing
  there = (shared >= least) & loud[0] & loud[1]
  return np.where(there, product / np.sqrt(np.where(there, spread[0] * spread[1], 1.0)), np.nan)
