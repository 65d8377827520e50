"""The weights of what is claimed, from kept evidence: a logistic regression of "the name is there"."""

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import expit
from sklearn.linear_model import LogisticRegression

from calibration.concealed.campaign.replay import Kept, replayed, right_names, table
from calibration.concealed.campaign.score import expected_error
from calibration.diagnosis.decision.levels import Levels
from calibration.diagnosis.holdout_errors import ratio
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text

Array = NDArray[np.float64]

WEIGHTS = ("constant", "t", "margin")
_STEEPEST = 10.0  # log odds: a weight of held-out recordings that was fitted to too little ends there


@dataclasses.dataclass(frozen=True)
class Weighed:
  """N names that were weighed in cases: their figures (N, 2), whether they are there (N,), what each counts (N,)."""

  figures: Array
  right: NDArray[np.bool_]
  counts: Array


def weighed(cases: Sequence[Kept], levels: Levels) -> Weighed:
  """Names of cases; every generator counts once, and in it every case, however many names were weighed.

  Names at a bound are left out, since they are never claimed.
  """
  listed = [(case, [n for m in case.evidence.models for n in m.names if not n.at_bound]) for case in cases]
  listed = [(case, names) for case, names in listed if names]
  of = [case.generator for case, _ in listed]
  rows = [(case, name, 1.0 / len(names) / of.count(case.generator)) for case, names in listed for name in names]
  return Weighed(
    np.array([levels.figures(n.t, n.margin()) for _, n, _ in rows]).reshape(-1, 2),
    np.array([name.name in case.right for case, name, _ in rows], dtype=bool),
    np.array([count for *_, count in rows]),
  )


def fitted_weights(cases: Sequence[Kept], levels: Levels) -> dict[str, float]:
  """Constant and weights of `Levels.probability`.

  A unit Gaussian prior on the weights of standardised figures keeps them finite.

  Args:
    cases: with their evidence and the names that are right.
    levels: what limits the figures.

  Raises:
    ValueError: all names are right or all wrong.
  """
  seen = weighed(cases, levels)
  if len(set(seen.right.tolist())) < 2:
    raise ValueError(f"{len(cases)} cases weigh no name that is there and one that is not; answer more cases")
  middle, spread = seen.figures.mean(axis=0), seen.figures.std(axis=0) + 1e-9
  regression = LogisticRegression(C=1.0, max_iter=2000)
  regression.fit((seen.figures - middle) / spread, seen.right, sample_weight=seen.counts / seen.counts.mean())
  slopes = np.ravel(regression.coef_) / spread
  constant = float(np.ravel(regression.intercept_)[0] - slopes @ middle)
  return dict(zip(WEIGHTS, (constant, *map(float, slopes)), strict=True))


@dataclasses.dataclass(frozen=True)
class Stated:
  """N only claims of answers: their stated log odds, what they do to held-out recordings (`Levels.change`), whether
  they are right, (N,) each."""

  log_odds: Array
  change: Array
  right: NDArray[np.bool_]


def stated(results: Iterable[Mapping[str, Any]], levels: Levels) -> Stated:
  """Answers about no effect or one that claim one name, where held-out recordings were not asked before."""
  rows = []
  for result in results:
    answer, case = result["answer"], result.get("case", {})
    claims, fits = answer.get("claims", ()), answer.get("fit", {}).get("holdout") or {}
    asked = answer.get("evidence", {}).get("opened")
    if case.get("kind") not in ("null", "single") or len(claims) != 1 or not fits or asked:
      continue
    after, before = ({name: fit[key] for name, fit in fits.items()} for key in ("after", "before"))
    right = claims[0]["mechanism"] in frozenset().union(*right_names(result["truth"]))
    likely = claims[0]["probability"]
    rows.append((math.log(likely / (1.0 - likely)), levels.change(ratio(after, before)), right))
  log_odds, change, right = np.array(rows, dtype=np.float64).reshape(-1, 3).T
  return Stated(log_odds, change, right > 0.0)


def held_out_weight(seen: Stated) -> float:
  """What held-out recordings add to a claim's log odds: a logistic regression beside what was stated.

  Raises:
    ValueError: all claims are right or all wrong.
  """
  if len(set(seen.right.tolist())) < 2:
    raise ValueError(f"{len(seen.right)} answers claim no name that is right and one that is not; answer more cases")
  slope = lambda weight: float(seen.change @ (expit(seen.log_odds + weight * seen.change) - seen.right))
  if slope(0.0) >= 0.0:  # of the loss, which is convex
    return 0.0
  return _STEEPEST if slope(_STEEPEST) <= 0.0 else float(brentq(slope, 0.0, _STEEPEST))  # pyright: ignore[reportArgumentType]


def with_weights(levels: Levels, weights: Mapping[str, float]) -> Levels:
  """Levels with other weights."""
  return dataclasses.replace(levels, **weights)


def log_loss(cases: Sequence[Kept], levels: Levels) -> float:
  """Mean of -ln of the probability given to what is so, nats a name, counted as `weighed` does."""
  seen = weighed(cases, levels)
  logit = levels.constant + seen.figures @ [levels.t, levels.margin]
  return float(np.average(np.logaddexp(0.0, np.where(seen.right, -logit, logit)), weights=seen.counts))


def judged_apart(cases: Sequence[Kept], before: Levels, after: Levels) -> str:
  """Each generator's cases under the weights before, those fitted, and those fitted to the other generators alone.

  Returns:
    Markdown: per generator what is counted and where the three differ; then their log loss, and what the probabilities
    of claims by the last are worth.

  Raises:
    ValueError: without a generator all names of the others are right or all wrong.
  """
  parts, rows, stated = [], [], []
  generators = sorted({case.generator for case in cases})
  for generator in generators if len(generators) > 1 else ():
    own, others = ([c for c in cases if (c.generator == generator) == mine] for mine in (True, False))
    rules = {
      "before": before,
      "fitted": after,
      "fitted to the others": with_weights(before, fitted_weights(others, before)),
    }
    parts.append(f"{generator}: {len(own)} cases\n\n{table(own, rules)}")
    names = weighed(own, before).right
    rows.append(
      (generator, f"{names.sum()} of {len(names)}", *(f"{log_loss(own, rule):.3f}" for rule in rules.values()))
    )
    said = [(case, replayed(case, rules["fitted to the others"])) for case in own]
    stated += [(claim.probability, claim.mechanism in case.right) for case, told in said for claim in told.claims]
  if not rows:
    return "Cases are of one generator: nothing to leave out.\n"
  heads = ("generator", "names that are there", "log loss before", "fitted", "fitted to the others")
  return "\n".join([*parts, *markdown.table(heads, rows), "", _worth(stated)]) + "\n"


def _worth(stated: Sequence[tuple[float, bool]]) -> str:
  if not stated:
    return "Fitted to the others, nothing is claimed."
  probability, right = np.mean(stated, axis=0)
  return (
    f"Fitted to the others, {len(stated)} claims: mean probability {probability:.2f}, share right {right:.2f}, expected"
    f" calibration error {expected_error(stated):.2f}."
  )


def write_weights(weights: Mapping[str, float], source: str, command: str, file: Path) -> None:
  """Write the weights, where they come from and the command that made them into a file of levels; the rest stays."""
  text = file.read_text(encoding="utf-8")
  for name, value in weights.items():
    entry = re.compile(rf'(\[{name}\]\nvalue = )\S+(\nunit = "[^"\n]*"\nsource = )"[^"\n]*"(\ncommand = )"[^"\n]*"')
    text, count = entry.subn(lambda m, v=value: f'{m[1]}{v:.3f}{m[2]}"{source}"{m[3]}"{command}"', text)
    if count != 1:
      raise ValueError(f"{file}: has no table [{name}] with value, unit, source and command in this order; write one")
  write_text(file, text)
