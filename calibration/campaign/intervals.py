"""What a campaign counted, each share with its exact 95 % interval (Clopper and Pearson, Biometrika 26(4), 1934)."""

from collections.abc import Sequence

from scipy.stats import binomtest

from calibration.campaign.score import Result, level, named, right_first, truth_ids
from qcar_twin import markdown

CONFIDENCE = 0.95


def counts(results: Sequence[Result]) -> list[tuple[str, int, int]]:
  """(what was counted, how often, of how many) of sessions with no effect and with one."""
  nulls, singles = ([r for r in results if r["case"]["kind"] == kind] for kind in ("null", "single"))
  seen = [r for r in singles if level(r) != "invisible"]
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
  )  # fmt: skip
  return [(said, sum(map(test, chosen)), len(chosen)) for said, test, chosen in rows]


def _sure(result: Result) -> bool:
  return any(claim["probability"] > 0.8 for claim in result["answer"]["claims"])


def exact_interval(found: int, of: int) -> tuple[float, float]:
  """Lower and upper end of a share's exact interval. Raises ValueError where nothing was counted."""
  if of < 1:
    raise ValueError("a share of nothing has no interval: count at least one case")
  limits = binomtest(found, of).proportion_ci(CONFIDENCE, method="exact")
  return float(limits.low), float(limits.high)


def interval_table(results: Sequence[Result]) -> str:
  """The counts as Markdown; what has no case is left out."""
  rows = []
  for said, found, of in counts(results):
    if of:
      low, high = exact_interval(found, of)
      rows.append((said, f"{found} of {of}", f"{found / of:.2f}", f"{low:.2f} to {high:.2f}"))
  return "\n".join(markdown.table(("counted", "cases", "share", "95 % interval"), rows)) + "\n"
