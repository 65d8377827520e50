"""Operating region: one readable rule on the circumstances that holds most of the mismatch in the least time.

A regression tree of depth three proposes boxes; every node of it, not only its leaves, is a candidate
rule. The tree is grown on half of the blocks, and the shares of the rule are counted on the other half.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from sklearn.tree import DecisionTreeRegressor

Array = NDArray[np.float64]

_DEPTH = 3
_LEAST = 0.02  # share of the moments a region holds at least
_PER_CONDITION = 0.03  # a further condition must bring so much


@dataclasses.dataclass(frozen=True)
class Condition:
  """One bound on one circumstance: above or below a value."""

  feature: str
  above: bool
  value: float

  def holds(self, column: Array) -> NDArray[np.bool_]:
    return column > self.value if self.above else column <= self.value

  def __str__(self) -> str:
    return f"{self.feature} {'>' if self.above else '<='} {self.value:g}"


@dataclasses.dataclass(frozen=True)
class Region:
  """A rule with what it holds.

  Attributes:
    conditions: all must hold; empty: everywhere.
    units: unit of each feature in the conditions.
    share: of the evidence, 0 to 1, on blocks that did not shape the rule.
    samples: share of the driving time, on the same blocks.
  """

  conditions: tuple[Condition, ...]
  units: Mapping[str, str]
  share: float
  samples: float

  @property
  def rule(self) -> str:
    """E.g. "speed > 1.2 and abs(accel_y) > 3"; "everywhere" without conditions."""
    return " and ".join(map(str, self.conditions)) or "everywhere"


def find_region(
  features: Array, names: Sequence[str], units: Mapping[str, str], evidence: Array, block: NDArray[np.int64]
) -> Region:
  """The rule that holds most of the evidence in the least time.

  Args:
    features: circumstances of each moment, (K, F).
    names: F of them.
    units: by name.
    evidence: nats of each moment, (K,); may be negative.
    block: moments of one block belong together, (K,).
  """
  everywhere = Region((), units, 1.0, 1.0)
  number = np.unique(block, return_inverse=True)[1].reshape(-1)
  grown, tested = number % 2 == 0, number % 2 == 1
  if grown.sum() < 50 or tested.sum() < 50 or evidence[grown].sum() <= 0 or evidence[tested].sum() <= 0:
    return everywhere
  tree = DecisionTreeRegressor(max_depth=_DEPTH, min_samples_leaf=max(10, int(_LEAST * grown.sum())), random_state=0)
  # a few moments with huge evidence would otherwise cut out single skids
  tree.fit(features[grown], _clipped(evidence[grown]))
  best, worth = everywhere, 0.0
  for conditions in _rules(tree, names):
    own = _shares(conditions, features[grown], names, evidence[grown])
    value = own[0] - own[1] - _PER_CONDITION * len(conditions)
    if value > worth:
      worth, best = value, Region(conditions, units, *_shares(conditions, features[tested], names, evidence[tested]))
  return best


def _clipped(evidence: Array) -> Array:
  low, high = np.quantile(evidence, [0.01, 0.99])
  return np.clip(evidence, low, high)


def _shares(
  conditions: Sequence[Condition], features: Array, names: Sequence[str], evidence: Array
) -> tuple[float, float]:
  inside = np.ones(len(features), dtype=bool)
  for condition in conditions:
    inside &= condition.holds(features[:, list(names).index(condition.feature)])
  return float(np.clip(evidence[inside].sum() / evidence.sum(), 0.0, 1.0)), float(inside.mean())


def _rules(tree: DecisionTreeRegressor, names: Sequence[str]) -> list[tuple[Condition, ...]]:
  """Conditions of every node but the root, redundant bounds dropped."""
  inner = tree.tree_
  rules: list[tuple[Condition, ...]] = []

  def descend(node: int, path: tuple[Condition, ...]) -> None:
    if path:
      rules.append(_tightest(path))
    if inner.children_left[node] < 0:
      return
    name, value = str(names[int(inner.feature[node])]), _rounded(float(inner.threshold[node]))
    descend(inner.children_left[node], (*path, Condition(name, False, value)))
    descend(inner.children_right[node], (*path, Condition(name, True, value)))

  descend(0, ())
  return rules


def _tightest(path: Sequence[Condition]) -> tuple[Condition, ...]:
  kept: dict[tuple[str, bool], Condition] = {}
  for condition in path:
    kept[(condition.feature, condition.above)] = condition  # deeper bounds are tighter
  return tuple(kept.values())


def _rounded(value: float) -> float:
  """Two significant digits: a rule is for reading."""
  return float(f"{value:.2g}")
