"""What a campaign counted, each share with its exact 95 % interval (Clopper and Pearson, Biometrika 26(4), 1934)."""

from collections.abc import Sequence

from scipy.stats import binomtest, chi2

from calibration.concealed.campaign.score import (
  Result,
  any_channel_surely_worse,
  any_channel_worse,
  both_seen,
  level,
  named,
  right_first,
  right_variables,
  said_so,
  truth_ids,
  worse_than_right_model,
)
from qcar_twin import markdown

CONFIDENCE = 0.95


def counts(results: Sequence[Result]) -> list[tuple[str, int, int]]:
  """(what was counted, how often, of how many)."""
  nulls, singles = ([r for r in results if r["case"]["kind"] == kind] for kind in ("null", "single"))
  pairs, outside = ([r for r in results if r["case"]["kind"] == kind] for kind in ("pair", "outside"))
  seen = [r for r in singles if level(r) != "invisible"]
  both = lambda r: named(r) >= truth_ids(r)
  wrong = lambda r: bool(r["answer"]["claims"]) and not right_first(r)
  rows = (
    ("sessions without an effect: something claimed", lambda r: bool(r["answer"]["claims"]), nulls),
    ("the same, with a probability above 0.8", _sure, nulls),
    ("sessions without an effect: called unexplained", lambda r: r["answer"]["verdict"] == "unexplained", nulls),
    ("single effects: right name first", right_first, singles),
    ("of those that the right model sees (20 nats or more)", right_first, seen),
    ("single effects: right name among the claims", lambda r: bool(named(r) & truth_ids(r)), singles),
    ("single effects: a wrong name first", wrong, singles),
    ("single effects: a wrong name claimed, first or not", lambda r: bool(named(r) - truth_ids(r)), singles),
    ("single effects: nothing claimed", lambda r: not r["answer"]["claims"], singles),
    ("pairs: both named", both, pairs),
    ("of those of which the right model sees each (20 nats or more)", both, [r for r in pairs if both_seen(r)]),
    ("pairs: nothing false", lambda r: named(r) <= truth_ids(r), pairs),
    ("outside the catalogue: said so", said_so, outside),
    ("the same, and by the right variables", right_variables, outside),
    ("a hold-out channel worse by more than 1 %", any_channel_worse, results),
    ("the same, beyond the change's 95 % interval", any_channel_surely_worse, results),
    ("worse by more than 1 % than before and than the right model's", worse_than_right_model, results),
  )  # fmt: skip
  return [(said, sum(map(test, chosen)), len(chosen)) for said, test, chosen in rows]


def _sure(result: Result) -> bool:
  return any(claim["probability"] > 0.8 for claim in result["answer"]["claims"])


def exact_interval(hits: int, of: int) -> tuple[float, float]:
  """Lower and upper end of a share's exact interval. Raises ValueError where nothing was counted."""
  if of < 1:
    raise ValueError("a share of nothing has no interval: count at least one case")
  limits = binomtest(hits, of).proportion_ci(CONFIDENCE, method="exact")
  return float(limits.low), float(limits.high)


def exact_rate(hits: int, exposure: float) -> tuple[float, float]:
  """Ends of the exact interval of a rate of `hits` in `exposure`, per its unit (Garwood, Biometrika 28(3/4), 1936)."""
  if not exposure > 0.0:
    raise ValueError("a rate over nothing has no interval: an exposure above 0 is needed")
  tail = 0.5 * (1.0 - CONFIDENCE)
  low = chi2.ppf(tail, 2 * hits) if hits else 0.0
  return 0.5 * float(low) / exposure, 0.5 * float(chi2.ppf(1.0 - tail, 2 * hits + 2)) / exposure


def interval_table(results: Sequence[Result]) -> str:
  """The counts as Markdown; what has no case is left out."""
  rows = []
  for said, hits, of in counts(results):
    if of:
      low, high = exact_interval(hits, of)
      rows.append((said, f"{hits} of {of}", f"{hits / of:.2f}", f"{low:.2f} to {high:.2f}"))
  return "\n".join(markdown.table(("counted", "cases", "share", "95 % interval"), rows)) + "\n"
