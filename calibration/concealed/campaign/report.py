"""The campaign's own page: how often the right name came first, each aim, who was taken for whom, every case."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.concealed.campaign.figure import confusion_table
from calibration.concealed.campaign.page import AIMS
from calibration.concealed.campaign.score import Result, case_row, reliability, score, score_baselines, stated_claims
from calibration.concealed.campaign.wild_score import wild_tables, wild_verdict
from qcar_twin.pages import Section, Table, bars, heat_map, write_page

_CASE = ("case", "seed", "truth", "verdict", "claims", "top three")


def write_campaign(folder: Path, results: Sequence[Result], drawn: int, command: str) -> Path:
  """Write report.html; returns its path.

  Args:
    results: answered cases.
    drawn: how many the campaign has.
    command: that made them.
  """
  subtitle = f"{len(results)} of {drawn} sessions answered; made by {command}"
  return write_page(folder / "report.html", "Concealed cases", verdict(results), sections(results), subtitle)


def write_wild(folder: Path, results: Sequence[Result], drawn: int, command: str) -> Path:
  """The same of wild cars: errors over the oracle's, names and shapes that were counted, every case."""
  subtitle = f"{len(results)} of {drawn} sessions answered; made by {command}"
  tables = [Section(title, "", [Table("", columns, rows)]) for title, columns, rows in wild_tables(results)]
  return write_page(folder / "report.html", "Concealed wild cars", wild_verdict(results), tables, subtitle)


def verdict(results: Sequence[Result]) -> str:
  """The outcome in one sentence."""
  figures = score(results)
  parts = []
  if figures["singles"]:
    parts.append(f"the right name came first in {100.0 * (figures['right_first'] or 0.0):.0f} % of {figures['singles']}"
                " sessions with one effect")  # fmt: skip
  if figures["nulls"]:
    parts.append(f"something was claimed in {figures['nulls_with_claim']} of {figures['nulls']} sessions without any")
  if figures["pairs"]:
    parts.append(
      f"both names were found in {100.0 * (figures['pairs_both'] or 0.0):.0f} % of {figures['pairs']} with two"
    )
  text = "; ".join(parts) or "no session has been answered yet"
  return f"{text[:1].upper()}{text[1:]}."


def sections(results: Sequence[Result]) -> list[Section]:
  """Everything the page shows, in reading order."""
  figures = score(results)
  aims = [(meaning, "at most" if np.signbit(aim) else "at least", abs(aim), figures.get(name))
          for name, meaning, aim in AIMS]  # fmt: skip
  parts = [Section("Aims", "", [Table("", ("aim", "", "wanted", "found"), aims)])]
  if results:
    parts += [_confusion(results), _probabilities(results), _methods(results), _cases(results)]
  return parts


def _confusion(results: Sequence[Result]) -> Section:
  truths, answers, table = confusion_table(results)
  chart = heat_map(
    "First claims against the truth, in sessions; pairs count with their first effect that was claimed.",
    answers,
    truths,
    np.where(table > 0, table, np.nan),
    ("first claim", "truth", "sessions"),
    (0.0, float(table.max(initial=1))),
  )
  return Section("Confusion matrix", "", figures=[chart])


def _probabilities(results: Sequence[Result]) -> Section:
  rows = [
    (f"{low:g} to {high:g}", count, stated, right)
    for low, high, count, stated, right in reliability(stated_claims(results))
  ]
  known = [(name, stated or 0.0, right or 0.0) for name, count, stated, right in rows if count]
  values = {"before": [stated for _, stated, _ in known], "twin": [right for *_, right in known]}
  labels = {"before": "stated", "twin": "share right"}
  chart = bars(
    "Claims by the probability that was stated.", [r[0] for r in known], values, "probability", labels=labels
  )
  table = Table("", ("stated probability", "claims", "mean probability", "share right"), rows)
  return Section("Calibration of stated probabilities", "", [table], [chart] if known else [])


def _methods(results: Sequence[Result]) -> Section:
  rows = [(name.replace("_", " "), *row.values()) for name, row in score_baselines(results).items()]
  columns = ("method", "nulls with a claim", "right name", "wrong name", "hold-out error, median")
  return Section("Simpler methods on the same sessions", "", [Table("", columns, rows)])


def _cases(results: Sequence[Result]) -> Section:
  rows = [case_row(r) for r in sorted(results, key=lambda r: r["case"]["name"])]
  return Section("Every case", "", [Table("Cases", _CASE, rows)])
