"""Which car, or which day, is not like the others: estimates with their deviations in a hierarchy.

For every parameter, x_i = mu + a_car(i) + b_day(i) + e_i with e_i of the stated deviation s_i. Physics is shared, so
a_car and b_day are small; the odd one is that whose mean, seen from all others, is not.

  unit's mean m_u = sum w x / sum w, w = 1 / s^2       the others' mean m_o likewise
  scatter of the others about m_o over what they state: Q / (k - 2), k units in all
  t = (m_u - m_o) / sqrt(S (v_u + v_o)),  degrees of freedom d_0 + k - 2

S is the scatter drawn towards that of all parameters, (d_0 S_0 + Q) / (d_0 + k - 2), and at least 1. d_0 and S_0 come
by the method of moments on logarithms (Smyth, Statistical Applications in Genetics and Molecular Biology 3, 2004): few
cars tell little of one parameter's scatter, but much of all parameters' together. Each unit is judged by scatters
without it. So stated deviations that are too small by a common factor accuse few, and too large ones nobody.
Days are compared after each car's own mean is taken away, cars after each day's.
Accused are those that Holm's step-down procedure (Scandinavian Journal of Statistics 6, 1979) rejects over all units
and parameters of a kind. Where stated deviations are right, the probability of accusing anyone of equal cars is at most
LEVEL for cars, and LEVEL for days, whatever the correlations.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar
from scipy.special import digamma, polygamma
from scipy.stats import t as student

Array = NDArray[np.float64]
LEVEL = 0.05
FEWEST = 3  # units of a kind: two differ, but which of them is odd nobody can say
_ROUNDS = 5  # of taking away cars' and days' means in turn


@dataclasses.dataclass(frozen=True)
class Reading:
  """Parameters that one log gave: value and standard deviation by name."""

  car: str
  day: str
  values: Mapping[str, tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class Comparison:
  """One unit on one parameter against all other units.

  Attributes:
    kind: "car" or "day".  difference, std: from the others, and of that difference with the scatter of the others.
    chance: two-sided probability of as much among equal ones.
    accused: by Holm's procedure over its kind.
  """

  kind: str
  unit: str
  parameter: str
  value: float
  others: float
  difference: float
  std: float
  chance: float
  accused: bool = False

  @property
  def sentence(self) -> str:
    """For people."""
    share = f" ({100.0 * self.difference / abs(self.others):+.0f} %)" if self.others else ""
    size = f"{self.difference:+.3g} ± {self.std:.2g} from the others' {self.others:.3g}{share}"
    return f"{self.kind} {self.unit}: {self.parameter} is {size}, chance {self.chance:.1e}"


@dataclasses.dataclass(frozen=True)
class Spread:
  """One parameter over a fleet: means of all, what single logs state, and how they really scatter.

  Attributes:
    stated: root mean square of stated deviations.  between: standard deviation of the logs' values beyond what they
      state, by DerSimonian and Laird (Controlled Clinical Trials 7, 1986); 0 where they scatter no more than stated.
  """

  parameter: str
  logs: int
  mean: float
  stated: float
  scatter: float
  between: float


def compare(readings: Sequence[Reading]) -> list[Comparison]:
  """Every car and every day against the others, on every parameter that at least three of the kind have."""
  made: list[Comparison] = []
  for kind in ("car", "day"):
    tested = _tested(kind, readings)
    made += _holm(tested)
  return made


def _tested(kind: str, readings: Sequence[Reading]) -> list[Comparison]:
  rows: list[tuple[str, str, Array, Array, float, int]] = []
  for name in sorted({n for r in readings for n in r.values}):
    units, means, variances = _means(kind, name, readings)
    for k in range(len(units)) if len(units) >= FEWEST else ():
      rest = np.arange(len(units)) != k
      weight = 1.0 / variances[rest]
      centre = float(weight @ means[rest] / weight.sum())
      scatter = float(weight @ (means[rest] - centre) ** 2) / (len(units) - 2)
      pair = np.array([means[k], centre])
      rows.append((units[k], name, pair, np.array([variances[k], 1.0 / weight.sum()]), scatter, len(units) - 2))
  if not rows:
    return []
  seen_without = {
    unit: moderation(*(np.array([float(row[i]) for row in rows if row[0] == unit]) for i in (4, 5)))
    for unit in {row[0] for row in rows}
  }
  made = []
  for unit, name, (own, others), parts, scatter, own_freedom in rows:
    prior, typical = seen_without[unit]  # of all parameters, without this unit: the odd one widens nobody's own scale
    total = prior + own_freedom
    drawn = max(1.0, typical if np.isinf(prior) else (prior * typical + own_freedom * scatter) / total)
    std = float(np.sqrt(drawn * parts.sum()))
    chance = float(2.0 * student.sf(abs(own - others) / std, min(total, 1e6)))
    made.append(Comparison(kind, unit, name, float(own), float(others), float(own - others), std, chance))
  return made


def _means(kind: str, name: str, readings: Sequence[Reading]) -> tuple[list[str], Array, Array]:
  """Units, their weighted means with the other kind's deviations taken away, and the variances of these, (k,)."""
  rows = [r for r in readings if name in r.values]
  value = np.array([r.values[name][0] for r in rows])
  weight = np.array([r.values[name][1] for r in rows], dtype=np.float64) ** -2.0
  labels = {"car": [r.car for r in rows], "day": [r.day for r in rows]}
  own, other = labels[kind], labels["day" if kind == "car" else "car"]
  shifts = {label: 0.0 for label in other}
  units = sorted(set(own))
  inside = {unit: np.array([label == unit for label in own]) for unit in units}
  crossed = len(set(zip(own, other, strict=True))) > max(len(units), len(shifts))  # else nothing tells them apart
  means = np.zeros(len(units))
  for _ in range(_ROUNDS if crossed else 1):
    left = value - np.array([shifts[label] for label in other])
    means = np.array([np.average(left[inside[u]], weights=weight[inside[u]]) for u in units])
    if not crossed:
      break
    by_own = dict(zip(units, means, strict=True))
    rest = value - np.array([by_own[label] for label in own])
    for label in shifts:
      these = np.array([o == label for o in other])
      shifts[label] = float(np.average(rest[these], weights=weight[these]))
    middle = float(np.mean(list(shifts.values())))
    shifts = {label: shift - middle for label, shift in shifts.items()}
  return units, means, np.array([1.0 / weight[inside[u]].sum() for u in units])


def moderation(scatters: Array, freedom: Array) -> tuple[float, float]:
  """Degrees of freedom d_0 and typical value S_0 that scatters S of chi-square kind are drawn towards.

  With e = log S - psi(f / 2) + log(f / 2): psi'(d_0 / 2) = var e - mean psi'(f / 2), log S_0 = mean e + psi(d_0 / 2) -
  log(d_0 / 2). d_0 is infinite where they vary no more than chance makes them.
  """
  half = 0.5 * freedom
  logs = np.log(np.maximum(scatters, 1e-12)) - digamma(half) + np.log(half)
  excess = float(np.var(logs, ddof=1) if len(logs) > 1 else 0.0) - float(np.mean(polygamma(1, half)))
  if excess <= 1e-6:
    return np.inf, float(np.exp(np.mean(logs)))
  prior = 2.0 * root_scalar(lambda d: float(polygamma(1, d)) - excess, bracket=(1e-6, 1e7)).root
  return prior, float(np.exp(np.mean(logs) + digamma(0.5 * prior) - np.log(0.5 * prior)))


def _holm(tested: Sequence[Comparison]) -> list[Comparison]:
  """The same, those accused marked."""
  order = sorted(tested, key=lambda c: c.chance)
  accusing, made = True, []
  for place, one in enumerate(order):
    accusing = accusing and one.chance <= LEVEL / (len(order) - place)
    made.append(dataclasses.replace(one, accused=accusing))
  return made


def spreads(readings: Sequence[Reading]) -> list[Spread]:
  """Every parameter that two logs and more have."""
  made = []
  for name in sorted({n for r in readings for n in r.values}):
    value, std = (np.array([r.values[name][i] for r in readings if name in r.values]) for i in range(2))
    if len(value) < 2:
      continue
    weight = std**-2.0
    mean = float(weight @ value / weight.sum())
    excess = float(weight @ (value - mean) ** 2) - (len(value) - 1)
    between = np.sqrt(max(excess / (weight.sum() - (weight @ weight) / weight.sum()), 0.0))
    stated = float(np.sqrt(np.mean(std**2)))
    made.append(Spread(name, len(value), mean, stated, float(value.std(ddof=1)), float(between)))
  return made
