"""Which names the recordings speak for: a race of refits from the nominal car, then growth.

Selecting by linear algebra at the recalibrated car alone fails: recalibration bends the parameters to imitate what is
missing, and columns there no longer point at it. So names are ranked by one linearisation at the nominal car and
measured starts, too, and whatever is compared has been refitted from there. See docs/likelihood.md.
"""

import dataclasses
import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.likelihood.hypotheses import Option, Weighed, responses, weigh
from calibration.likelihood.levels import Levels
from calibration.likelihood.linear import Place
from calibration.likelihood.noise import Noise
from calibration.likelihood.readings import Readings
from calibration.likelihood.refit import Minimum, conclude, moved, prior_of, refit
from calibration.progress import Progress, silent
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

# effort, which decides nothing: more of it costs time and finds the same or better
FROM_NOMINAL, FROM_SCAN, KEPT = 2, 2, 2  # names in the race by either ranking, and those that are refitted to the end
BESIDE, NAMES = 1, 4  # names that are tried beside others in a round, and names at most
_FIRST, _LAST, _MORE, _NAMELESS = (
  2,
  4,
  3,
  7,
)  # linearisations of a racer, of one that is kept, beside others, of the base
_SAFE = 4.0  # times the level that a name is worth by a straight line, above which leaving it out is not tried
_OFF = 0.3  # of the typical size, off its null, that an amplitude begins at
_CLOSE = 2.0  # nats a linearisation brings at most where a refit ends


@dataclasses.dataclass(frozen=True)
class Setting:
  """What all refits share.

  Attributes:
    twin: on the reduced car; readings; base: what every model fits.
    options: named hypotheses.  nominal: parameters before any fit, (P,).
  """

  twin: Twin
  readings: Readings
  base: ParameterSet
  options: tuple[Option, ...]
  nominal: Array


@dataclasses.dataclass(frozen=True)
class Found:
  """Attributes:
  base: the minimum without a name.  best: with the names; the base where there are none.
  names: in the order in which they were found.
  level: nats that the largest of all hypotheses reaches by chance in a stated share of such data sets.
  scan: hypotheses at the base, by nats.  models: cost of every refitted set of names.
  """

  base: Minimum
  best: Minimum
  names: tuple[Option, ...]
  level: float
  scan: tuple[tuple[str, float], ...]
  models: dict[tuple[str, ...], float]
  minima: dict[tuple[str, ...], Minimum]
  simulations: int

  def has(self, names: Sequence[Option]) -> bool:
    """Whether a set of names was refitted."""
    return not names or _key(names) in self.minima

  def minimum(self, names: Sequence[Option]) -> Minimum:
    """Of a set of names that was refitted; the base of none."""
    return self.minima[_key(names)] if names else self.base

  def settled(self, names: Sequence[Option]) -> Minimum:
    """The same with slopes taken there."""
    m = self.minimum(names)
    twin, readings = m.place.twin, m.place.readings
    return conclude(twin, readings, m.noise, m.free, m.theta, m.starts, m.simulations, m.settled)


def search(setting: Setting, noise: Noise, levels: Levels, progress: Progress = silent) -> Found:
  """The names that a data set speaks for.

  Args:
    noise: of the sensors, with a start for the rest.
  """
  progress("recalibration")
  base = refit(setting.twin, setting.readings, noise, setting.base, setting.nominal, setting.readings.starts,
               steps=_NAMELESS, settled_at=_CLOSE)  # fmt: skip
  progress("scan")
  weighed, asked = scan(setting, base, levels)
  level = chance_level(weighed, levels)
  order = _best_of_each(asked, weighed.gain)
  table = tuple((asked[i].key, float(weighed.gain[i])) for i in order)
  log.info("level %.1f; scan: %s", level, table[:6])
  run = _Run(setting, base, levels, {(): base})
  if weighed.gain.max(initial=-np.inf) <= level:
    return run.found((), level, table)
  progress("race")
  first = rank_from_nominal(setting, base)
  log.info("from nominal: %s", [(o.key, round(g)) for o, g in first[:6]])
  racers = _without_doubles([*(o for o, _ in first[:FROM_NOMINAL]), *(asked[i] for i in order[:FROM_SCAN])])
  names = run.race(racers)
  progress("growth")
  while names and len(names) < NAMES:
    more = run.grown(names, [o for o, _ in first])
    if not more:
      break
    names = more
  return run.found(run.dropped(names, level), level, table)


@dataclasses.dataclass
class _Run:
  setting: Setting
  base: Minimum
  levels: Levels
  minima: dict[tuple[str, ...], Minimum]
  simulations: int = 0

  def fit(
    self, names: Sequence[Option], steps: int = _LAST, onwards: bool = False, near: Minimum | None = None
  ) -> Minimum:
    """Names refitted from the nominal car, or on from where a shorter refit or a model near by ended."""
    key, s = _key(names), self.setting
    known = self.minima.get(key)
    if known is not None and (known.settled or not onwards):
      return known
    free, theta, starts, noise = started(s, names), s.nominal.copy(), s.readings.starts, self.base.noise
    if known or near:
      begun = known or near
      assert begun is not None
      theta, starts, noise = begun.theta.copy(), begun.starts, begun.noise
      gone = set(begun.free.names) - set(free.names)
      for name in gone:
        theta[s.twin.parameters.index(name)] = s.nominal[s.twin.parameters.index(name)]
    fresh = [o for o in names if known is None and not (near and set(p.name for p in o.shapes) & set(near.free.names))]
    theta = hinted(s, fresh, theta, near)
    trusting = 0 if known or near else 1
    made = refit(
      s.twin, s.readings, noise, free, theta, starts, steps, (60, 40, 40), trusting=trusting, settled_at=_CLOSE
    )
    self.minima[key] = made
    self.simulations += made.simulations
    log.info("%s: cost %.1f, %.1f nats below the base", key, made.cost, self.base.cost - made.cost)
    return made

  def race(self, racers: Sequence[Option]) -> tuple[Option, ...]:
    """The best single name by refits; nothing where none beats the base."""
    racers = list(racers)
    costs = [self.fit([o], _FIRST).cost for o in racers]
    kept = [racers[i] for i in np.argsort(costs)[:KEPT]]
    last = [self.fit([o], _LAST, onwards=True).cost for o in kept]
    best = int(np.argmin(last))
    return (kept[best],) if last[best] < self.base.cost else ()

  def grown(self, names: tuple[Option, ...], others: Sequence[Option]) -> tuple[Option, ...]:
    """The names and one more, refitted together, where that is worth more than chance; () else."""
    here = self.fit(names)
    here = conclude(self.setting.twin, self.setting.readings, here.noise, here.free, here.theta, here.starts, 0, True)
    weighed, asked = scan(self.setting, here, self.levels, {o.name for o in names})
    level = chance_level(weighed, self.levels)
    order = [i for i in _best_of_each(asked, weighed.gain) if weighed.gain[i] > level]
    log.info(
      "beside %s: level %.1f, %s",
      [o.key for o in names],
      level,
      [(asked[i].key, round(weighed.gain[i])) for i in order[:4]],
    )
    if not order:
      return ()
    known = {o.name for o in names}
    tried = _without_doubles([*(asked[i] for i in order[:BESIDE]), *[o for o in others if o.name not in known][:1]])[
      :BESIDE
    ]
    made = [(self.fit([*names, o], _MORE, near=here), o) for o in tried]
    best, option = min(made, key=lambda m: m[0].cost)
    return (*names, option) if here.cost - best.cost > level else ()

  def dropped(self, names: tuple[Option, ...], level: float) -> tuple[Option, ...]:
    """The names without those that cost no more than the level to leave out.

    What a straight line promises to cost more than `_SAFE` times that is not refitted.
    """
    while len(names) > 1:
      here, loss = self.fit(names), []
      for left in names:
        loss.append(worth(here, left))
        if loss[-1] <= _SAFE * level:
          loss[-1] = self.fit([o for o in names if o is not left], _MORE, near=here).cost - here.cost
      if min(loss) > level:
        break
      names = tuple(o for i, o in enumerate(names) if i != int(np.argmin(loss)))
    return names if not names or self.base.cost - self.fit(names).cost > level else ()

  def found(self, names: tuple[Option, ...], level: float, table: tuple[tuple[str, float], ...]) -> Found:
    """The result."""
    models = {key: m.cost for key, m in self.minima.items()}
    best = self.fit(names) if names else self.base
    return Found(self.base, best, names, level, table, models, dict(self.minima),
                 self.simulations + self.base.simulations)  # fmt: skip


def chance_level(weighed: Weighed, levels: Levels) -> float:
  """Nats that the best hypothesis reaches by chance in the stated share of such data sets; never below even odds."""
  return max(float(np.quantile(weighed.chance, 1.0 - levels.family_wise)), 0.0)


def started(setting: Setting, names: Sequence[Option]) -> ParameterSet:
  """The base's free parameters and the names'."""
  free = setting.base
  for option in names:
    free = option.freed(free)
  return free


def hinted(setting: Setting, names: Sequence[Option], theta: Array, near: Minimum | None) -> Array:
  """Shapes at their starts, and amplitudes with a shape off their null, lest it have no slope."""
  present = set(near.free.names) if near else set()
  for option in names:
    for p in option.shapes:
      theta[setting.twin.parameters.index(p.name)] = p.nominal
    for p in option.amplitudes if option.shapes else ():
      if p.name not in present:
        theta[setting.twin.parameters.index(p.name)] = (p.null or 0.0) + _OFF * (p.typical or p.scale)
  return theta


def worth(at: Minimum, option: Option) -> float:
  """Nats that a name's amplitudes are from their null, by the curvature at a minimum."""
  index = [at.free.index(p.name) for p in option.amplitudes]
  away = at.values[index] - np.array([p.null or 0.0 for p in option.amplitudes])
  covariance = np.linalg.inv(at.precision)[np.ix_(index, index)]
  return 0.5 * float(away @ np.linalg.solve(covariance, away))


def _key(names: Sequence[Option]) -> tuple[str, ...]:
  return tuple(sorted(o.key for o in names))


def scan(
  setting: Setting, at: Minimum, levels: Levels, without: frozenset[str] | set[str] = frozenset()
) -> tuple[Weighed, list[Option]]:
  """All options weighed at a minimum."""
  asked = [o for o in setting.options if o.name not in without]
  columns, ends, where = responses(at.place, asked)
  made, _ = at.place.whiten(at.noise, at.place.residual, at.place.gap, at.starts, columns, ends)
  base = at.white.rows(slice(1, None))
  columns = shared(base, at.free, made.rows(slice(1, None)), asked)
  return _weighed(base, at.precision, at, columns, asked, where, levels), asked


def shared(base: Array, free: ParameterSet, columns: Array, asked: Sequence[Option]) -> Array:
  """Columns of options with the base's own where it has the parameter: then only a wider prior is asked for.

  Slopes over an age differ on either side of 0, as interpolated signals do; two of them would make a filter.
  """
  out = columns.copy()
  for k, p in enumerate(p for o in asked for p in o.amplitudes):
    if p.name in free:
      out[:, :, k] = base[:, :, free.index(p.name)]
  return out


def _weighed(
  base: Array, precision: Array, at: Minimum, columns: Array, asked: Sequence[Option], where: Sequence[slice],
  levels: Levels,
) -> Weighed:  # fmt: skip
  amplitudes = [p for o in asked for p in o.amplitudes]
  pull = -prior_of(at.free, at.values) / at.free.std
  width = np.array([p.std or p.scale for p in amplitudes])
  one_sided = np.array([p.lower >= (p.null or 0.0) for p in amplitudes])
  return weigh(base, precision, pull, at.place.readings.block, at.white.rows(0), columns, where, width, one_sided,
               levels.draws)  # fmt: skip


def rank_from_nominal(setting: Setting, base: Minimum) -> list[tuple[Option, float]]:
  """Names by what a straight line from the nominal car and the measured starts promises them, best first."""
  s = setting
  place = Place(s.twin, s.readings, base.noise, s.nominal, s.readings.starts)
  own = place.columns(*moved(place, list(s.base)))
  columns, ends, where = responses(place, s.options)
  both = np.concatenate([own[0], columns], axis=2), np.concatenate([own[1], ends], axis=2)
  white, _ = place.whiten(base.noise, place.residual, place.gap, place.starts, *both)
  rows, count = white.rows(slice(1, None)), len(s.base)
  below = rows[:, :, :count].reshape(-1, count)
  precision = below.T @ below + np.diag(s.base.std**-2)
  amplitudes = [p for o in s.options for p in o.amplitudes]
  width = np.array([p.std or p.scale for p in amplitudes])
  one_sided = np.array([p.lower >= (p.null or 0.0) for p in amplitudes])
  asked = shared(rows[:, :, :count], s.base, rows[:, :, count:], s.options)
  weighed = weigh(rows[:, :, :count], precision, np.zeros(count), s.readings.block, white.rows(0), asked, where, width,
                  one_sided, 1)  # fmt: skip
  return [(s.options[i], float(weighed.gain[i])) for i in _best_of_each(s.options, weighed.gain)]


def _best_of_each(asked: Sequence[Option], gain: Array) -> list[int]:
  """Indices by gain, the best start of every name alone."""
  seen: set[str] = set()
  order = []
  for i in np.argsort(-gain):
    if asked[i].name not in seen:
      seen.add(asked[i].name)
      order.append(int(i))
  return order


def _without_doubles(asked: Sequence[Option]) -> list[Option]:
  return list({o.name: o for o in reversed(asked)}.values())[::-1]
