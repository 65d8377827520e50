"""The cases of an exam, decided by one digest, and the session of each."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..laboratory.written import Session, stream
from .described import WRAPPED, small_errors
from .effects import Concealed, Effect
from .nats import LEAST, MOST, Judge, Shown, sized
from .session import GENERATORS, make_exam_session, set_up

MIX = {"null": 40, "single": 40, "pair": 15, "outside": 10}
"""Shares of the kinds of cases."""


@dataclass(frozen=True)
class Case:
  """One session of an exam. `effects`: those to try in this order; which the session has is decided by what shows."""

  name: str
  kind: str  # of MIX
  generator: str
  seed: int
  effects: tuple[str, ...]


def effects_of(generator: str) -> dict[str, Effect]:
  """All that a generator's cars may hide. KeyError: no such generator."""
  if generator not in GENERATORS:
    raise KeyError(f"no generator '{generator}'; valid are: {', '.join(GENERATORS)}")
  own: Mapping[str, Effect] = GENERATORS[generator].effects
  return {**own, **WRAPPED}


def draw_cases(generator: str, digest: str, count: int) -> list[Case]:
  """Cases in an order that says nothing of their kind; names are numbers.

  Args:
    digest: any text that nobody chose; the same one gives the same cases.
  """
  rng = np.random.default_rng(seed_of(generator, digest))
  table = effects_of(generator)
  known = [name for name in table if table[name].right]
  foreign = [name for name in table if not table[name].right]
  kinds = [kind for kind, number in _shares(count).items() for _ in range(number)]
  orders = {"single": _cycled(rng, known), "outside": _cycled(rng, foreign)}
  cases = []
  for number, kind in enumerate(rng.permutation(kinds) if kinds else ()):
    effects = () if kind == "null" else _next(orders[kind]) if kind in orders else tuple(rng.permutation(known))
    seed = seed_of(generator, digest, str(number))
    cases.append(Case(f"case_{number:03d}", str(kind), generator, seed, tuple(map(str, effects))))
  return cases


def seed_of(*words: str) -> int:
  """48 bits of the words' SHA-256."""
  return int.from_bytes(hashlib.sha256("\n".join(words).encode()).digest()[:6], "big")


def make_case(case: Case) -> tuple[Session, dict]:
  """The session of a case, and its truth: "kind", "seed", "car", "effects" with "id", "right", "size", "nats"."""
  setting, rng = set_up(case.generator, case.seed, bench=True), stream(case.seed, 8)
  small, drawn = small_errors(stream(case.seed, 9)), []
  if case.kind != "null":
    judge = Judge.of(setting)
    drawn = [(one, straight, target, judge.absorbed([one])) for one, straight, target in _sized(case, judge, rng)]
  session = make_exam_session(
    case.generator, case.seed, concealed=[*small, *(d[0] for d in drawn)], bench=True
  )  # fmt: skip
  effects = [
    {"id": one.name, "right": one.effect.answers, "part": one.effect.part, "how": one.effect.how, "size": one.size,
     "unit": one.effect.unit, "nats": shown.nats, "nats_before_absorption": shown.before,
     "nats_first_order": straight.nats, "nats_wanted": target}
    for one, straight, target, shown in drawn
  ]  # fmt: skip
  truth = {"kind": case.kind, "seed": case.seed, "effects": effects, "car": session.truth["car"],
           "small_errors": {one.name: one.size for one in small}}  # fmt: skip
  return session, truth


def _sized(case: Case, judge: Judge, rng: np.random.Generator) -> list[tuple[Concealed, Shown, float]]:
  """One effect, or two of different parts of the car, each of as many nats as were drawn for it."""
  table, drawn = effects_of(case.generator), []
  for name in case.effects:
    effect = table[name]
    if any(effect.part == other.effect.part for other, _, _ in drawn):
      continue
    target = float(np.exp(rng.uniform(np.log(LEAST), np.log(MOST))))
    sign = float(rng.choice([-1.0, 1.0])) if effect.signed else 1.0
    hit = sized(judge, name, effect, sign, target)
    if hit is not None:
      drawn.append((*hit, target))
    if len(drawn) == (2 if case.kind == "pair" else 1):
      return drawn
  raise ValueError(f"{case.name}: no effect of {', '.join(case.effects)} shows {LEAST:g} nats in this session")


def _shares(count: int) -> dict[str, int]:
  """Cases of each kind, by the largest remainders."""
  exact = {kind: count * share / sum(MIX.values()) for kind, share in MIX.items()}
  out = {kind: int(value) for kind, value in exact.items()}
  for kind in sorted(exact, key=lambda k: out[k] - exact[k])[: count - sum(out.values())]:
    out[kind] += 1
  return out


def _cycled(rng: np.random.Generator, names: list[str]) -> list[str]:
  return [names[i] for i in rng.permutation(len(names))]


def _next(order: list[str]) -> tuple[str, ...]:
  """The order as it stands; its first goes to the end for the next one."""
  now = tuple(order)
  order.append(order.pop(0))
  return now
