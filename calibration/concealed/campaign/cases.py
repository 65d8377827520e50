"""The cases of a campaign, drawn from one seed: sessions with no effect, one, two, or one without a name."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration.concealed.proving_ground.effects import EFFECTS
from calibration.concealed.proving_ground.wild import draw_wild_effects
from calibration.concealed.second_car.effects import SECOND_EFFECTS, draw_size
from qcar_twin.twin.mechanisms import catalogue


@dataclasses.dataclass(frozen=True)
class Case:
  """One session of a campaign: effects as (id, size in multiples of typical)."""

  name: str
  kind: str  # null, single, pair, outside, wild
  seed: int
  effects: tuple[tuple[str, float], ...]
  noise: float
  design: str = "compact"
  car: str = "first"  # of the independent cars: first, second


NOISE_LEVELS = (0.5, 1.0, 2.0)  # that sessions without an effect take turns with


def draw_cases(seed: int, nulls: int, singles: int, pairs: int, outside: int, design: str = "compact") -> list[Case]:
  """Cases of a campaign, all decided by one seed.

  Nulls take turns with three noise levels. Singles go through the catalogue in a drawn order, at the
  typical size and at a third of it in turn. Pairs combine two subsystems at the typical size.
  """
  rng = np.random.default_rng(seed)
  tame = {name for name, kind in EFFECTS.items() if not kind.wild}
  known = sorted(set(catalogue()) & tame)
  foreign = sorted(tame - set(known))
  first = int(rng.integers(10**6, 10**8))
  cases = [
    Case(f"null_{i:02d}", "null", first + i, (), NOISE_LEVELS[i % 3], design)
    for i in range(nulls)
  ]  # fmt: skip
  order = [known[i] for i in rng.permutation(len(known))]
  for i in range(singles):
    effect = order[i % len(order)]
    cases.append(Case(f"single_{i:02d}", "single", first + 1000 + i, ((effect, (1.0, 1 / 3)[i % 2]),), 1.0, design))
  for i in range(pairs):
    cases.append(Case(f"pair_{i:02d}", "pair", first + 2000 + i, _pair(rng, known), 1.0, design))
  for i, k in enumerate(rng.permutation(len(foreign))[:outside]):
    cases.append(Case(f"outside_{i:02d}", "outside", first + 3000 + i, ((foreign[k], 1.0),), 1.0, design))
  return cases


def draw_wild_cases(seed: int, count: int) -> list[Case]:
  """Cars far from the QCar with four to eight effects at once, all decided by one seed; see proving_ground/wild.py."""
  first = int(np.random.default_rng(seed).integers(10**6, 10**8))
  signed = frozenset(name for name, kind in EFFECTS.items() if kind.signed)
  seeds = range(first, first + count)
  return [
    Case(f"wild_{i:02d}", "wild", s, draw_wild_effects(s, signed), 1.0, "wild") for i, s in enumerate(seeds)
  ]  # fmt: skip


def draw_second_cases(seed: int, nulls: int, singles: int, design: str = "compact") -> list[Case]:
  """Cases of the second car, for tests of transfer: sessions with no effect and with one, all decided by one seed.

  Nulls take turns with three noise levels; singles go through the second car's effects in a drawn order, at about the
  typical size and either sign where an effect has one.
  """
  rng = np.random.default_rng([seed, 2])
  first, kinds = int(rng.integers(10**6, 10**8)), sorted(SECOND_EFFECTS)
  order = [kinds[i] for i in rng.permutation(len(kinds))]
  cases = [
    Case(f"null_{i:02d}", "null", first + i, (), NOISE_LEVELS[i % 3], design, "second")
    for i in range(nulls)
  ]  # fmt: skip
  for i in range(singles):
    effect = order[i % len(order)]
    size = draw_size(effect, rng)
    cases.append(Case(f"single_{i:02d}", "single", first + 1000 + i, ((effect, size),), 1.0, design, "second"))
  return cases


def draw_steering_cases(seed: int, count: int, car: str = "first", design: str = "compact") -> list[Case]:
  """Cars for agents to drive: effects between steering command and wheels, at one and two typical sizes in turn; every
  fifth car conceals nothing. All decided by one seed.
  """
  rng = np.random.default_rng([seed, 3, ("first", "second").index(car)])
  there = {n for n, k in EFFECTS.items() if not k.wild} if car == "first" else set(SECOND_EFFECTS)
  known = sorted(name for name, m in catalogue().items() if name in there and m.subsystem == "steering")
  first, order = int(rng.integers(10**6, 10**8)), [known[i] for i in rng.permutation(len(known))]
  cases = []
  for i in range(count):
    number = i - (i + 1) // 5
    effects = () if i % 5 == 4 else ((order[number % len(order)], (1.0, 2.0)[number // len(order) % 2]),)
    cases.append(Case(f"{car}_{i:02d}", "single" if effects else "null", first + i, effects, 1.0, design, car))
  return cases


def _pair(rng: np.random.Generator, known: Sequence[str]) -> tuple[tuple[str, float], ...]:
  mechanisms = catalogue()
  while True:
    one, other = (known[int(i)] for i in rng.permutation(len(known))[:2])
    if mechanisms[one].subsystem != mechanisms[other].subsystem:
      return (one, 1.0), (other, 1.0)
