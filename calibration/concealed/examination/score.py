"""Scores of a closed exam by a fixed rule, from its truths and answers alone.

A claim is right if its mechanism is one of those that the effect's entry in the generator's table names. So is the
departure of a figure of the car that the entry names: a slower servo is a servo that is not what was measured. Where
the table names none the effect is outside the catalogue, and right is to say that something is left unexplained. An
effect of positive size makes its figure larger: a figure that departs the other way is a wrong answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from qcar_twin.twin.mechanisms import catalogue

from ..campaign.intervals import exact_interval
from ..campaign.score import mean, said_so

Result = Mapping[str, Any]
VISIBLE = 20.0  # nats: a likelihood ratio of 5e8
NATS = (5.0, 20.0, 100.0, 500.0, np.inf)  # edges of the bins of power
THRESHOLDS = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95)
PROBABILITIES = (0.0, 0.5, 0.65, 0.8, 0.9, 1.0)  # edges of the bins of what was stated
SURE = 0.8


def of_kind(results: Sequence[Result], kind: str) -> list[Result]:
  return [r for r in results if r["truth"]["kind"] == kind]


def claims(result: Result) -> list[str]:
  """Mechanisms that were claimed, strongest first, then figures of the car that were said to contradict the driving."""
  answer = result["answer"]
  sizes = {name: effect["size"] for effect in result["truth"]["effects"] for name in effect["right"]}
  astray = lambda x: x["z"] * sizes.get(x["name"], x["z"]) < 0.0
  departures = [x["name"] + " (the other way)" * astray(x) for x in answer.get("departures", ())]
  return [c["mechanism"] for c in answer["claims"]] + departures


def right_names(result: Result) -> set[str]:
  """All names that count as right."""
  return {name for effect in result["truth"]["effects"] for name in effect["right"]}


def right_first(result: Result) -> bool:
  return claims(result)[:1] != [] and claims(result)[0] in right_names(result)


def right_or_alike(result: Result) -> bool:
  """Right first, or by a name that the first claim declares indistinguishable from it."""
  first = result["answer"]["claims"][:1]
  return right_first(result) or any({c["mechanism"], *c["indistinguishable_from"]} & right_names(result) for c in first)


def each_named(result: Result) -> bool:
  return all(set(effect["right"]) & set(claims(result)) for effect in result["truth"]["effects"])


def nothing_false(result: Result) -> bool:
  return set(claims(result)) <= right_names(result)


def sure(result: Result) -> bool:
  return any(claim["probability"] > SURE for claim in result["answer"]["claims"])


def least_nats(result: Result) -> float:
  """Of the effect of a case that shows least; none for a case without."""
  return min((effect["nats"] for effect in result["truth"]["effects"]), default=0.0)


def counts(results: Sequence[Result]) -> list[tuple[str, int, int]]:
  """(what was counted, how often, of how many); what has no case is left out."""
  nulls, singles, pairs, outside = (of_kind(results, kind) for kind in ("null", "single", "pair", "outside"))
  seen = lambda cases: [r for r in cases if least_nats(r) >= VISIBLE]
  wrong = lambda r: bool(claims(r)) and not right_first(r)
  rows: tuple[tuple[str, Callable[[Result], bool], list[Result]], ...] = (
    ("without an effect: something claimed", lambda r: bool(claims(r)), nulls),
    (f"the same, with a probability above {SURE:g}", sure, nulls),
    ("without an effect: called unexplained", lambda r: r["answer"]["verdict"] == "unexplained", nulls),
    ("one effect: right name first", right_first, singles),
    (f"of those of {VISIBLE:g} nats and more", right_first, seen(singles)),
    ("one effect: right, or declared indistinguishable from the first claim", right_or_alike, singles),
    ("one effect: right name among the claims", lambda r: bool(set(claims(r)) & right_names(r)), singles),
    ("one effect: a wrong name first", wrong, singles),
    ("one effect: nothing claimed", lambda r: not claims(r), singles),
    ("two effects: both named", each_named, pairs),
    (f"of those of which each has {VISIBLE:g} nats and more", each_named, seen(pairs)),
    ("two effects: nothing false", nothing_false, pairs),
    ("outside the catalogue: said so", said_so, outside),
    (f"of those of {VISIBLE:g} nats and more", said_so, seen(outside)),
    (f"outside the catalogue: a name with a probability above {SURE:g}", sure, outside),
  )
  return [(said, sum(map(test, chosen)), len(chosen)) for said, test, chosen in rows if chosen]


def power(results: Sequence[Result]) -> list[tuple[str, int, int]]:
  """Singles with the right name first, by their nats: (bin, right, cases)."""
  singles, rows = of_kind(results, "single"), []
  for low, high in zip(NATS[:-1], NATS[1:], strict=True):
    inside = [right_first(r) for r in singles if low <= least_nats(r) < high]
    if inside:
      rows.append((f"{low:g} and more" if np.isinf(high) else f"{low:g} to {high:g}", sum(inside), len(inside)))
  return rows


def best_name(result: Result) -> tuple[str, float]:
  """The likeliest single name that was weighed, claimed or not, and its probability."""
  rows = [r for r in result["answer"]["scored"] if len(r["set"]) == 1 and not r["at_bound"]]
  best = max(rows, key=lambda r: r["probability"], default=None)
  return ("", 0.0) if best is None else (best["name"], float(best["probability"]))


def characteristic(results: Sequence[Result]) -> list[tuple[float, float | None, float | None]]:
  """Receiver operating characteristic: (threshold, share of nulls accused, share of singles found by their name)."""
  nulls, singles = of_kind(results, "null"), of_kind(results, "single")
  named = lambda r, level: best_name(r)[1] >= level and best_name(r)[0] in right_names(r)
  return [
    (level, mean(best_name(r)[1] >= level for r in nulls), mean(named(r, level) for r in singles))
    for level in THRESHOLDS
  ]


def reliability(results: Sequence[Result]) -> list[tuple[str, int, float, float]]:
  """Claims by their stated probability: (bin, claims, mean probability, share right)."""
  stated = [(c["probability"], c["mechanism"] in right_names(r)) for r in results for c in r["answer"]["claims"]]
  rows = []
  for low, high in zip(PROBABILITIES[:-1], PROBABILITIES[1:], strict=True):
    inside = [(p, right) for p, right in stated if low <= p < high or p == high == 1.0]
    if inside:
      stated_mean, share = np.mean(inside, axis=0)
      rows.append((f"{low:g} to {high:g}", len(inside), float(stated_mean), float(share)))
  return rows


def _where(name: str) -> str:
  """The subsystem of a mechanism; a figure of the car is of none."""
  known = catalogue()
  return known[name].subsystem if name in known else "figure"


def confusion(results: Sequence[Result]) -> tuple[list[str], list[str], np.ndarray]:
  """Parts that effects are of (rows), subsystems of first claims (columns), in cases with one effect and none."""
  told = []
  for r in (*of_kind(results, "single"), *of_kind(results, "outside"), *of_kind(results, "null")):
    first = claims(r)[:1]
    part = r["truth"]["effects"][0]["part"] if r["truth"]["effects"] else "nothing"
    told.append((part, _where(first[0]) if first else "no claim"))
  rows, columns = (sorted({t[i] for t in told}, key=lambda n: (n in ("nothing", "no claim"), n)) for i in (0, 1))
  table = np.zeros((len(rows), len(columns)), dtype=int)
  for part, said in told:
    table[rows.index(part), columns.index(said)] += 1
  return rows, columns, table


def case_row(result: Result) -> tuple[str, ...]:
  """Name, kind, truth, verdict, claims, and whether that is right."""
  effects = result["truth"]["effects"]
  truth = ", ".join(f"{e['id']} {e['size']:.3g} {e['unit']} ({e['nats']:.0f} nats)" for e in effects) or "nothing"
  answer = result["answer"]
  named = [f"{c['mechanism']} ({c['probability']:.2f})" for c in answer["claims"]]
  said = ", ".join(named + [f"{x['name']} (z {x['z']:.1f})" for x in answer.get("departures", ())]) or "-"
  return result["name"], result["truth"]["kind"], truth, result["answer"]["verdict"], said, _mark(result)


def interval(hits: int, of: int) -> str:
  """The exact 95 % interval as text."""
  low, high = exact_interval(hits, of)
  return f"{low:.2f} to {high:.2f}"


def _mark(result: Result) -> str:
  right: dict[str, Callable[[Result], bool]] = {
    "null": lambda r: not claims(r), "single": right_first, "pair": each_named, "outside": said_so
  }  # fmt: skip
  return "right" if right[result["truth"]["kind"]](result) else "wrong"
