"""The page a campaign leaves in the documents: aims, scores, simpler methods, every case, who was taken for whom."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.concealed.campaign.figure import draw_confusion
from calibration.concealed.campaign.intervals import interval_table
from calibration.concealed.campaign.nulls import spurious_table
from calibration.concealed.campaign.own_structure import own_table
from calibration.concealed.campaign.score import Result, score, score_table
from calibration.concealed.campaign.wild_score import wild_table, wild_verdict
from calibration.concealed.laboratory.designs import plan
from calibration.concealed.laboratory.manoeuvres import PERIOD
from qcar_twin import markdown

# figure of merit, what it is called, its aim: at least (+) or at most (-)
AIMS = (
  ("nulls_with_claim_share", "sessions without an effect in which something was claimed", -0.034),
  ("right_first", "single effects: right name first", 0.90),
  ("right_first_visible", "the same, of those the right model can see (20 nats or more)", 0.90),
  ("top_three_visible", "of those, in the top three of the ranking", 0.97),
  ("parameter_error_median", "error of the parameter, median", -0.15),
  ("subsystem_visible", "subsystem right, of the visible ones", 0.90),
  ("pairs_both", "pairs: both named", 0.75),
  ("pairs_nothing_false", "pairs: no false name", 0.85),
  ("outside_unknown", "outside the catalogue: unexplained or partly explained", 0.83),
  ("outside_right_variables", "the same, and its strongest property is one that the effect is a function of", 0.75),
  ("outside_sure_and_wrong", "outside the catalogue: a wrong name with probability above 0.8", -0.0),
  ("recovered_over_nulls", "share of the excess hold-out error removed, median (above what nulls reach)", 0.85),
  ("recovered_over_oracle", "the same above what the right model reaches", 0.85),
  ("calibration_error", "expected calibration error of the stated probabilities", -0.08),
  ("channels_worse", "cases with a claim in which a hold-out channel got worse by more than 1 %", -0.05),
  ("channels_worse_of_all_cases", "the same, of all cases", -0.05),
  ("channels_worse_beyond_chance", "of all cases, by more than 1 % and beyond the change's 95 % interval", -0.05),
)


def campaign_page(results: Sequence[Result], drawn: int, command: str, picture: Path) -> str:
  """Markdown of the whole campaign; draws a picture of the confusions.

  Args:
    results: answered cases.
    drawn: how many the campaign has.
    command: that made them.
    picture: PNG file, in the page's folder.
  """
  figures = score(results)
  lines = [
    "# Concealed cases",
    "",
    f"`{command}`: {len(results)} of {drawn} sessions of the {_car(results)}, made from a seed not used",
    "while what is measured here was built (which state that is: docs/results/README.md), diagnosed without sight of",
    f"their truth; each answer and its hash were written before the truth was looked at. {_designs(results)},",
    f"process noise, a noisy driver{_carried(results)}. A name is right if it is the first claim.",
    "",
  ]
  rows = []
  for name, meaning, aim in AIMS:
    value = figures.get(name)
    wanted = f"{'<=' if aim < 0 or str(aim) == '-0.0' else '>='} {abs(aim):.3g}"
    rows.append((meaning, wanted, "-" if value is None else f"{value:.3g}"))
  lines += markdown.table(("aim", "wanted", "found"), rows)
  lines += ["", "Shares with exact intervals:", "", interval_table(results)]
  draw_confusion(results, picture)
  lines += ["", f"![First claims against the truth]({picture.name})", "", "All figures:", "", score_table(results)]
  lines += ["What explained something on sessions without an effect, alone and held out:", "", spurious_table(results)]
  own = own_table(results)
  if own:
    lines += [
      "Claims of what was not concealed, and every such car has by itself (they count as wrong above):",
      "",
      own,
    ]
  return "\n".join(lines)


def wild_page(results: Sequence[Result], drawn: int, command: str) -> str:
  """Markdown of a campaign of wild cars; arguments as above."""
  said = f"`{command}`: {len(results)} of {drawn} sessions. {wild_verdict(results)}"
  return f"# Concealed wild cars\n\n{said}\n\n{wild_table(results)}"


def _second(results: Sequence[Result]) -> bool:
  """Whether the second car drove; answers from before there was one are the first's."""
  return any(result["case"].get("car") == "second" for result in results)


def _car(results: Sequence[Result]) -> str:
  return "second independent car (`calibration/concealed/second_car`)" if _second(results) else "independent car"


def _carried(results: Sequence[Result]) -> str:
  return "" if _second(results) else ", heat and charge carried along"


def _designs(results: Sequence[Result]) -> str:
  """The session designs that were driven, with their size."""
  said = []
  for name in dict.fromkeys(result["case"]["design"] for result in results):
    runs = plan(name, np.random.default_rng(0))  # the draw decides where free drives go, not how long they take
    said.append(f"{name} ({PERIOD * sum(run.ticks for run in runs):.0f} s of driving in {len(runs)} recordings)")
  return f"Session design: {' and '.join(said)}"
