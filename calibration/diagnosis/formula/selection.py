"""Which groups of terms a missing force is made of: stepwise, held out by recordings, and stable over their halves.

All of it is linear algebra on Gram matrices per group of data: what each term would change in the residual, less what
the model's own parameters can imitate of that.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.formula.dictionary import TRAVEL, Group

Array = NDArray[np.float64]

MOST = 3  # groups in a formula
_NATS = 2.0  # that a coefficient more must bring, as a mechanism more must in a search
_SAME = 1.0  # nats within which two terms say the same
_DRAWS, _FLIPS = 40, 300
_RIDGE = 1e-6  # of a column's own power
ENOUGH = 0.95  # of a held-out gain: what brings the rest is not worth a reader's time
_TRIED = 25  # groups, those that promise most, that are fitted for a held-out gain in a further step


@dataclasses.dataclass(frozen=True)
class Grams:
  """Products of columns with each other and with the target, by group of data.

  Attributes:
    inner: (G, D, D).
    pull: (G, D).
    owner: dictionary group of every column, (D,).
  """

  inner: Array
  pull: Array
  owner: NDArray[np.int64]

  @classmethod
  def of(cls, columns: Array, target: Array, group: NDArray[np.int64], owner: NDArray[np.int64]) -> "Grams":
    """Of columns (M, D), a target (M,) and the group of data of every value, (M,)."""
    members = [np.flatnonzero(group == kind) for kind in np.unique(group)]
    inner = np.stack([columns[m].T @ columns[m] for m in members])
    return cls(inner, np.stack([columns[m].T @ target[m] for m in members]), owner)

  def columns(self, chosen: Sequence[int]) -> NDArray[np.intp]:
    """Columns of dictionary groups."""
    return np.flatnonzero(np.isin(self.owner, list(chosen)))

  def some(self, rows: NDArray[np.intp]) -> "Grams":
    """Of some groups of data."""
    return Grams(self.inner[rows], self.pull[rows], self.owner)


def held_out(grams: Grams, columns: NDArray[np.intp]) -> Array:
  """Gain of each group of data when the coefficients are fitted to the others, nats, (G,)."""
  inner, pull = grams.inner[:, columns[:, None], columns], grams.pull[:, columns]
  whole = inner.sum(axis=0)
  ridge = _RIDGE * np.diag(np.maximum(np.diag(whole), 1e-12))
  rest = np.linalg.solve(whole + ridge - inner, (pull.sum(axis=0) - pull)[..., None])[..., 0]
  return np.einsum("gi,gi->g", rest, pull) - 0.5 * np.einsum("gi,gij,gj->g", rest, inner, rest)


def solved(grams: Grams, columns: NDArray[np.intp]) -> tuple[Array, Array]:
  """Coefficients and their standard deviations, (d,) each."""
  inner = grams.inner[:, columns[:, None], columns].sum(axis=0)
  inverse = np.linalg.inv(inner + _RIDGE * np.diag(np.maximum(np.diag(inner), 1e-12)))
  return inverse @ grams.pull[:, columns].sum(axis=0), np.sqrt(np.diag(inverse))


@dataclasses.dataclass(frozen=True)
class Chosen:
  """Groups of a formula.

  Attributes:
    members: dictionary groups, in the order they came in.
    gains: held out, of each group of data, nats, (G,).
  """

  members: tuple[int, ...]
  gains: Array

  @property
  def gain(self) -> float:
    return float(self.gains.sum())


def stepwise(grams: Grams, offered: Sequence[Group], most: int = MOST) -> list[Chosen]:
  """The best formula of each length: one group, two, ...

  The next one is the one with the largest held-out gain; a step that does not bring what its coefficients cost ends it.
  """
  steps: list[Chosen] = []
  for _ in range(most):
    before = steps[-1].members if steps else ()
    best = _next(grams, offered, before)
    cost = _NATS * (len(grams.columns(best.members)) - len(grams.columns(before))) + offered[best.members[-1]].nats
    if best.gain - cost <= (steps[-1].gain if steps else 0.0):
      break
    steps.append(best)
  return steps


def _next(grams: Grams, offered: Sequence[Group], before: tuple[int, ...]) -> Chosen:
  """The best group to add, less what it takes to say which one it is."""
  trials = [(*before, j) for j in range(len(offered)) if j not in before]
  if not before:
    gains = _alone(grams, trials)
  else:
    # what each would explain of the rest says which are worth an honest trial
    promise = _promise(grams, offered, before)
    trials = sorted(trials, key=lambda t: -promise[t[-1]])[:_TRIED]
    gains = [held_out(grams, grams.columns(t)) for t in trials]
  worth = [float(g.sum()) - offered[t[-1]].nats for g, t in zip(gains, trials, strict=True)]
  k = int(np.argmax(worth))
  mine = offered[trials[k][-1]].variables
  # of the same variables the one that is offered first: of a force that never drove backwards, the resistance
  alike = [i for i, t in enumerate(trials) if offered[t[-1]].variables == mine and worth[i] >= worth[k] - _SAME]
  k = min(alike, key=lambda i: trials[i][-1])
  return Chosen(trials[k], gains[k])


def _alone(grams: Grams, trials: Sequence[tuple[int, ...]]) -> list[Array]:
  """Held-out gains of single groups; those of one column all at once."""
  single, out = _held_out_alone(grams.pull, np.einsum("gii->gi", grams.inner)), []
  for (j,) in trials:
    columns = grams.columns((j,))
    out.append(single[:, columns[0]] if len(columns) == 1 else held_out(grams, columns))
  return out


def _promise(grams: Grams, offered: Sequence[Group], before: tuple[int, ...]) -> Array:
  """Nats that the strongest column of each group would explain of what the formula so far leaves, (groups,)."""
  inner, pull = grams.inner.sum(axis=0), grams.pull.sum(axis=0)
  kept = grams.columns(before)
  block = inner[np.ix_(kept, kept)]
  onto = np.linalg.solve(block + _RIDGE * np.diag(np.maximum(np.diag(block), 1e-12)), inner[kept])
  power = np.diag(inner) - np.einsum("kd,kd->d", inner[kept], onto)
  gains = 0.5 * (pull - onto.T @ pull[kept]) ** 2 / np.maximum(power, 1e-6 * np.diag(inner) + 1e-12)
  out = np.zeros(len(offered))
  np.maximum.at(out, grams.owner, gains)
  return out


def shortest(steps: Sequence[Chosen]) -> Chosen:
  """The shortest formula that holds all but a twentieth of the best one's held-out gain."""
  most = max(step.gain for step in steps)
  return next(step for step in steps if step.gain >= ENOUGH * most)


def rivals(grams: Grams, offered: Sequence[Group], found: Chosen, most: int) -> list[Chosen]:
  """Single groups that do as well as the formula's first one, to a twentieth of its gain, best first; itself among
  them. Of several that depend on the same variables the best one stands for all."""
  alone = _alone(grams, [(j,) for j in range(len(offered))])
  first = float(alone[found.members[0]].sum())
  order = sorted(range(len(offered)), key=lambda j: -float(alone[j].sum()))
  kept: dict[frozenset[str], Chosen] = {
    offered[found.members[0]].variables: Chosen(found.members[:1], alone[found.members[0]])
  }
  for j in order:
    if float(alone[j].sum()) < ENOUGH * first or len(kept) >= most:
      break
    kept.setdefault(offered[j].variables, Chosen((j,), alone[j]))
  return list(kept.values())


def siblings(grams: Grams, offered: Sequence[Group], found: Chosen, most: int) -> list[Chosen]:
  """Other single groups of the variables of the formula's first one, best first: |x| and x^2 differ by a shape that the
  model's own parameters may have bent, so only the simulator tells them apart."""
  mine = offered[found.members[0]]
  # the direction of travel is no power: where a car hardly drove backwards, the resistance stands, as in a first step
  said = lambda group: frozenset(tuple(sorted(f for f in t.factors if f != TRAVEL)) for t in group.terms)
  there = [j for j, group in enumerate(offered) if group.variables == mine.variables and not group.near]
  gains = _alone(grams, [(j,) for j in there])
  kept: dict[frozenset, Chosen] = {}
  for j, gain in sorted(zip(there, gains, strict=True), key=lambda pair: -float(pair[1].sum())):
    if gain.sum() > 0.0 and said(offered[j]) != said(mine):
      kept.setdefault(said(offered[j]), Chosen((j,), gain))
  return list(kept.values())[:most]


def stability(
  grams: Grams, offered: Sequence[Group], wanted: Sequence[frozenset[str]], random: np.random.Generator
) -> float:
  """Share of halves of the data in which the first group depends on one of these sets of variables, 0 to 1.

  Stability selection: Meinshausen and Buehlmann, Journal of the Royal Statistical Society B 72, 2010.
  """
  count, same = len(grams.inner), 0
  for _ in range(_DRAWS):
    half = grams.some(random.permutation(count)[: max(2, count // 2)])
    same += offered[_next(half, offered, ()).members[0]].variables in wanted
  return same / _DRAWS


def by_chance(
  columns: Array, target: Array, group: NDArray[np.int64], witness: NDArray[np.int64], random: np.random.Generator
) -> float:
  """Probability that the best of all columns gains as much, held out, on a target whose stretches have other signs.

  The largest held-out gain of all columns against its distribution under random signs: family-wise over everything that
  is offered (Westfall and Young, Resampling-based multiple testing, 1993).

  Args:
    columns, target: (M, D) and (M,).
    group: of data, of every value, (M,): what is left out together.
    witness: of every value, (M,): a second or so of driving whose sign is drawn.
    random: draws the signs.
  """
  first = np.unique(witness, return_index=True)[1]
  kinds, where = np.unique(group[first], return_inverse=True)
  score = np.stack([columns[witness == w].T @ target[witness == w] for w in witness[first]])
  power = np.stack([np.square(columns[group == kind]).sum(axis=0) for kind in kinds])
  into = np.zeros((len(kinds), len(first)))
  into[where, np.arange(len(first))] = 1.0
  gain = lambda signs: float(_held_out_alone(into @ (signs[:, None] * score), power).sum(axis=0).max())
  seen = gain(np.ones(len(first)))
  drawn = [gain(random.choice([-1.0, 1.0], size=len(first))) for _ in range(_FLIPS)]
  return float((1 + np.sum(np.array(drawn) >= seen)) / (1 + _FLIPS))


def _held_out_alone(pull: Array, power: Array) -> Array:
  """Held-out gains of single columns, (G, D), from their products with the target and themselves, (G, D)."""
  rest = (pull.sum(axis=0) - pull) / np.maximum((1.0 + _RIDGE) * power.sum(axis=0) - power, 1e-12)
  return rest * pull - 0.5 * rest**2 * power
