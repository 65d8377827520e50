"""Kept evidence decided again: what a rule names on the cases of a campaign or an exam, without driving any of them."""

import dataclasses
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.concealed.campaign.archive import answers_of
from calibration.diagnosis.decision.conclude import conclude
from calibration.diagnosis.decision.decide import Decision, decide
from calibration.diagnosis.decision.evidence import Evidence, from_json
from calibration.diagnosis.decision.levels import Levels, usual_levels
from qcar_twin import markdown

_GATHERED = ("cap", "wide", "least_spread")  # of the levels, what evidence is gathered with
FIGURES = {"steering_lag": ("servo_time_constant",), "payload": ("mass",)}
"""Effects of the own cars that are a figure which is not what was measured; its departure is a right answer, too."""


@dataclasses.dataclass(frozen=True)
class Kept:
  """A case whose evidence was kept.

  Attributes:
    name: of the case.
    kind: "null", "single", "pair", "outside", ...
    effects: for each effect that acts, the names that are right for it; empty where the catalogue has none.
    evidence: of the diagnosis.
    generator: that made it: "first" or "second" car, or an exam's.
  """

  name: str
  kind: str
  effects: tuple[frozenset[str], ...]
  evidence: Evidence
  generator: str = "first"

  @property
  def right(self) -> frozenset[str]:
    """All names that count as right."""
    return frozenset().union(*self.effects)


def kept_cases(results: Iterable[Mapping[str, Any]]) -> Iterator[Kept]:
  """Cases of answered campaigns and opened exams that kept their evidence; the others are left out."""
  for result in results:
    evidence = result["answer"].get("evidence")
    if evidence is None:
      continue
    truth = result["truth"]
    if isinstance(truth, Mapping):  # of an exam, whose table names all that is right
      name, kind, generator = result["name"], truth["kind"], truth["car"]["generator"]
      effects = tuple(frozenset(e["right"]) for e in truth["effects"])
    else:
      name, kind, generator = result["case"]["name"], result["case"]["kind"], result["case"].get("car", "first")
      effects = right_names(truth)
    yield Kept(name, kind, effects, from_json(evidence, name), generator)


def right_names(truth: Sequence[Mapping[str, Any]]) -> tuple[frozenset[str], ...]:
  """For each effect of a campaign's case the names that are right for it; empty where the catalogue has none."""
  own = lambda t: [t["id"], *FIGURES.get(t["id"], ())] if t.get("in_catalogue", True) else []
  return tuple(frozenset(t["right"] if "right" in t else own(t)) for t in truth)


def read_results(source: Path) -> list[dict[str, Any]]:
  """Answered cases of a campaign's folder or archive.

  Raises:
    UnreadableFile: an archive is damaged.
    FileNotFoundError: there is nothing.
  """
  if source.is_dir():
    return [json.loads(path.read_text()) for path in sorted(source.glob("*_*.json"))]
  return answers_of(source)


def replayed(case: Kept, levels: Levels) -> Decision:
  """What a rule says of a case."""
  return conclude(decide(case.evidence, levels), case.evidence, levels)


def table(cases: Sequence[Kept], rules: Mapping[str, Levels]) -> str:
  """How often each rule is right, and every case on which they differ, as Markdown.

  Raises:
    ValueError: a rule has another of the numbers that evidence was gathered with.
  """
  for (rule, levels), name in itertools.product(rules.items(), _GATHERED):
    if (asked := getattr(levels, name)) != (kept := getattr(usual_levels(), name)):
      raise ValueError(
        f"rule '{rule}' has {name} = {asked:g}, but kept evidence was gathered with {kept:g}, which no rule changes; "
        f"give it {name} = {kept:g}, or change levels.toml and diagnose the cases again"
      )
  said = {rule: [replayed(case, levels) for case in cases] for rule, levels in rules.items()}
  rows = []
  for what, kind, good in COUNTED:
    chosen = [k for k, case in enumerate(cases) if case.kind == kind]
    count = lambda rule, chosen=chosen, good=good: sum(good(cases[k], said[rule][k]) for k in chosen)
    if chosen:
      rows.append((what, *(f"{count(rule)} of {len(chosen)}" for rule in rules)))
  shown = lambda d: [f"{c.mechanism} ({c.probability:.2f})" for c in d.claims] + [x.name for x in d.departures]
  names = lambda d: ", ".join(shown(d)) or "-"
  apart = [
    (case.name, case.kind, " + ".join("/".join(sorted(e)) or "?" for e in case.effects) or "-", *map(names, told))
    for case, *told in zip(cases, *said.values(), strict=True)
    if len({tuple(said_names(d)) for d in told}) > 1
  ]
  tables = [markdown.table(("counted", *rules), rows)]
  if apart:
    tables.append(markdown.table(("case", "kind", "right", *rules), apart))
  return "\n\n".join("\n".join(lines) for lines in tables) + "\n"


def said_names(decision: Decision) -> list[str]:
  """Mechanisms that are claimed, strongest first, then figures that the driving contradicts."""
  return [c.mechanism for c in decision.claims] + [d.name for d in decision.departures]


def _names(decision: Decision) -> set[str]:
  return set(said_names(decision))


def _right_first(case: Kept, decision: Decision) -> bool:
  return any(name in case.right for name in said_names(decision)[:1])


COUNTED: tuple[tuple[str, str, Callable[[Kept, Decision], bool]], ...] = (
  ("without an effect: something claimed", "null", lambda _, d: bool(d.claims)),
  ("without an effect: a figure that departs", "null", lambda _, d: bool(d.departures)),
  ("without an effect: called unexplained", "null", lambda _, d: d.verdict == "unexplained"),
  ("one effect: right name first", "single", _right_first),
  ("one effect: a wrong name first", "single", lambda c, d: bool(_names(d)) and not _right_first(c, d)),
  ("one effect: a figure that departs and is not of it", "single", lambda c, d: not _departing(d) <= c.right),
  ("two effects: both named", "pair", lambda c, d: all(e & _names(d) for e in c.effects)),
  ("two effects: nothing false", "pair", lambda c, d: _names(d) <= c.right),
  ("outside the catalogue: said so", "outside", lambda _, d: d.verdict in ("unexplained", "partly_explained")),
  ("outside the catalogue: something claimed", "outside", lambda _, d: bool(_names(d))),
)
"""(what is counted, on which kind of cases, when it counts)."""


def _departing(decision: Decision) -> set[str]:
  return {d.name for d in decision.departures}
